"""Kernels of interval linear systems: preconditioning, elimination, iteration, comparison matrices.

One system lies in the leading axes, A (n, n, ...) and b (n, ...), a batch in the axis behind: a loop over rows is a pass over the batch.
A matrix that all systems share has a last axis of length 1 and is prepared once.

Preconditioning replaces M x = h by (C M) x = C h with C near the inverse of the middle of M. C may be any numbers: a solution of the
first system solves the second. So C is searched in plain floats, and C M, C h are enclosed.

A chain of interval operations has to be cut by barriers (`_held`): the compiler works a value out anew for each of its uses, which
doubles at every step of an elimination.

Source: Neumaier 1990, 1999 (comparison matrix, Hansen-Bliek-Rohn); Alhaj-Dibo, Maquin, Ragot 2004, appendix (Gauss, Gauss-Seidel,
Krawczyk).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets import rounding
from jaxbound.sets.interval import Interval, disjoint, intersection, mag, mid, mig, rad
from jaxbound.sets.interval import sum as interval_sum

__all__ = ["contract", "enclose", "factor", "preconditioner", "product", "times"]

SWEEPS = 100  # at most: Gauss-Seidel and Krawczyk stop where a sweep gains less than a thousandth of the width
_held = jax.lax.optimization_barrier


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Factored:
    """All of a square system that does not depend on its right-hand side: A, its triangular factors, its comparison matrix's bounds."""

    A: Interval  # (n, n, N)
    LU: Interval  # (n, n, N): below the diagonal what each row takes of the rows above, the eliminated rows on and above it
    inverse: tuple  # of the comparison matrix <A>: (near (n, n, N), v (n, N), omega (n, N)): |<A>^-1 - near| <= v omega'; NaN if unproved


def preconditioner(M, kind="midpoint"):
    """Return C (n, r, N): near the (pseudo-)inverse of the middle of M, or of its diagonal; None for none."""
    if kind == "none":
        return None
    middle = mid(M)
    r, n = middle.shape[:2]
    if kind == "diagonal":
        return jnp.stack([jnp.stack([(1 / middle[i, i] if i == j else jnp.zeros_like(middle[i, i])) for j in range(n)]) for i in range(n)])
    if r == n:
        return inverse(middle)
    normal = sum(middle[i, :, None] * middle[i, None] for i in range(r))
    near = inverse(normal)
    return sum(near[:, k, None] * middle[None, :, k] for k in range(n))


def inverse(a):
    """Return a float inverse of a (n, n, N): Gauss-Jordan, each step takes the row with the largest entry; no claim is made."""
    n, N = a.shape[0], a.shape[2]
    rows = jnp.concatenate([a, jnp.broadcast_to(jnp.eye(n, dtype=a.dtype)[..., None], a.shape)], 1)  # (n, 2n, N)
    index = jnp.arange(n)[:, None]

    def step(k, carry):
        rows, free, order = carry
        column = jax.lax.dynamic_index_in_dim(rows, k, 1, keepdims=False)
        place = _held(jnp.argmax(jnp.where(free, jnp.abs(column), -1), 0))
        pick = _held(index == place[None])
        pivot = _held(jnp.sum(jnp.where(pick[:, None], rows, 0), 0))
        head = jax.lax.dynamic_index_in_dim(pivot, k, 0)
        pivot = _held(pivot / jnp.where(head == 0, jnp.nan, head))
        rows = jnp.where(pick[:, None], pivot[None], rows - column[:, None] * pivot[None])
        return _held((rows, free & ~pick, order.at[k].set(place)))

    start = rows, jnp.ones((n, N), bool), jnp.zeros((n, N), jnp.int32 if jnp.arange(1).dtype == jnp.int32 else jnp.int64)
    rows, _, order = jax.lax.fori_loop(0, n, step, start)
    return _held(jnp.take_along_axis(rows[:, n:], order[:, None], 0))


def times(C, A):
    """Enclose C A for numbers C (n, r, N) and an Interval A (r, k, N) or (r, N)."""
    gamma, floor = rounding.product_error(A.shape[0], A.dtype)
    wide = len(A.shape) == 3
    middle, radius, size = _held((mid(A), rad(A), mag(A)))
    tail = (slice(None), None) if wide else (slice(None),)
    column = lambda X, j: X[:, j][tail]
    value = sum(column(C, j) * middle[j][None] for j in range(A.shape[0]))
    spread = sum(jnp.abs(column(C, j)) * (radius[j] + gamma * size[j])[None] for j in range(A.shape[0]))
    largest = floor * (1 + jnp.max(jnp.abs(C), (0, 1))) * (1 + jnp.max(size, (0, 1) if wide else 0))
    spread = spread + largest[(None,) * len(A.shape[:-1])]
    value, spread = _held((value, spread))
    known = (spread < jnp.inf) & (jnp.abs(value) < jnp.inf)
    return Interval(jnp.where(known, value - spread, -jnp.inf), jnp.where(known, value + spread, jnp.inf))


def factor(A):
    """Prepare a square system: triangular factors without exchange of rows, and bounds of the inverse of its comparison matrix."""
    n = A.shape[0]
    index = jnp.arange(n)

    def step(k, R):
        row, column = _at(R, k, 0), _at(R, k, 1)
        share = _held(over(column, _at(row, k, 0)[None]))
        less = minus(R, product(share[:, None], row[None]))
        below, right = (index > k)[:, None, None], (index > k)[None, :, None]
        return _held(_where(below & right, less, _where(below & (index == k)[None, :, None], share[:, None], R)))

    return Factored(A, jax.lax.fori_loop(0, n, step, A), comparison_inverse(A))


def _at(x, k, axis):
    return jax.tree.map(lambda a: jax.lax.dynamic_index_in_dim(a, k, axis, keepdims=False), x)


def _where(condition, x, y):
    return Interval(jnp.where(condition, x.lo, y.lo), jnp.where(condition, x.hi, y.hi))


def product(x, y):
    """Enclose x y for non-empty Intervals; everything where 0 meets infinity."""
    ends = [a * b for a in (x.lo, x.hi) for b in (y.lo, y.hi)]
    least = jnp.minimum(jnp.minimum(ends[0], ends[1]), jnp.minimum(ends[2], ends[3]))
    most = jnp.maximum(jnp.maximum(ends[0], ends[1]), jnp.maximum(ends[2], ends[3]))
    return _closed(least, most)


def minus(x, y):
    """Enclose x - y for non-empty Intervals."""
    return _closed(x.lo - y.hi, x.hi - y.lo)


def over(x, y):
    """Enclose every z with y' z = x' for some x' in x and y' in y, for non-empty Intervals: everything where y holds 0.

    (The set-based quotient by [0, 0] is empty, which would pass for a proof that there is no solution.)
    """
    least, most, far = mig(y), mag(y), 2.0 ** (np.finfo(y.dtype).maxexp // 2)
    sound = (least > 0) & (most < far)  # beyond, the compiler's reciprocal could be flushed
    lo, hi = (jnp.where(sound, end, 1) for end in (y.lo, y.hi))
    ends = [a / b for a in (x.lo, x.hi) for b in _held((lo, hi))]
    low = jnp.minimum(jnp.minimum(ends[0], ends[1]), jnp.minimum(ends[2], ends[3]))
    high = jnp.maximum(jnp.maximum(ends[0], ends[1]), jnp.maximum(ends[2], ends[3]))
    return _closed(jnp.where(sound, low, jnp.nan), jnp.where(sound, high, jnp.nan))


def _closed(lo, hi):
    """Round outward; NaN gives everything."""
    lo, hi = rounding.outward(lo, hi)
    return Interval(jnp.where(jnp.isnan(lo), -jnp.inf, lo), jnp.where(jnp.isnan(hi), jnp.inf, hi))


def comparison_inverse(A):
    """Return (near, v, omega) with |<A>^-1 - near| <= v omega' entry by entry, <A> the comparison matrix; NaN where none is proved.

    <A> has the least |a_ii| on its diagonal and -max|a_ij| beside it. v > 0 with <A> v > 0 proves that every matrix in A is regular and
    <A>^-1 >= 0. From <A>^-1 - near = <A>^-1 (I - <A> near) and |I - <A> near|_k <= omega_k <A> v. Source: Neumaier 1999; Rump 2013.
    """
    n = A.shape[0]
    eye = jnp.eye(n, dtype=A.dtype)[..., None]
    S = _held(jnp.where(eye > 0, mig(A), -mag(A)))
    near = inverse(S)
    v = _held(jnp.maximum(sum(near[:, k] for k in range(n)), rounding.tiny(A.dtype)))
    w = times(S, Interval(v, v)).lo
    off = minus(times(S, Interval(near, near)), Interval(jnp.broadcast_to(eye, near.shape), jnp.broadcast_to(eye, near.shape)))
    w, off = _held((w, mag(off)))
    omega = jnp.max(over(Interval(off, off), Interval(w, w)[:, None]).hi, 0)
    proved = jnp.all(w > 0, 0) & jnp.all(omega < jnp.inf, 0)
    return tuple(jnp.where(proved[(None,) * (x.ndim - 1)], x, jnp.nan) for x in _held((near, v, omega)))


def enclose(F, b, method, start):
    """Return an enclosure (n, N) of the solutions in the start box."""
    found = [_gauss(F, b)] if method in ("gauss", "intersection") else []
    if method != "gauss":
        solved, first = _held(_hansen_bliek_rohn(F, b))
        if method in ("hbr", "intersection"):
            found.append(solved)
        if method in ("gauss_seidel", "intersection"):  # its limit lies in Krawczyk's, which the intersection does not need
            found.append(_iterate(gauss_seidel, F.A, b, intersection(first, start)))
        if method == "krawczyk":
            found.append(_iterate(krawczyk, F.A, b, intersection(first, start)))
    box = start
    for other in found:
        box = intersection(box, other)
    return _held(box)


def _gauss(F, b):
    """Substitute forward and backward. Source: Alhaj-Dibo et al. 2004, appendix; a pivot that holds 0 gives everything."""
    n, index = b.shape[0], jnp.arange(b.shape[0])[:, None]

    def forward(k, y):
        return _held(_where(index > k, minus(y, product(_at(F.LU, k, 1), _at(y, k, 0)[None])), y))

    def backward(i, y):
        k = n - 1 - i
        column = _at(F.LU, k, 1)
        known = _held(over(_at(y, k, 0), _at(column, k, 0)))[None]
        return _held(_where(index < k, minus(y, product(column, known)), _where(index == k, known, y)))

    return jax.lax.fori_loop(0, n, backward, jax.lax.fori_loop(0, n, forward, b))


def _hansen_bliek_rohn(F, b):
    """Return the enclosure (b_i + [-beta_i, beta_i]) / (A_ii + [-alpha_i, alpha_i]), and |x| <= <A>^-1 |b| as a box.

    With N = <A>^-1: alpha_i = <A>_ii - 1 / N_ii and beta_i = (sum over k != i of N_ik |b_k|) / N_ii. Source: Neumaier 1999, theorem 2.1.
    """
    near, v, omega = F.inverse
    n = b.shape[0]
    eye = jnp.eye(n, dtype=near.dtype)[..., None] > 0
    slack = rounding.outward(*(v[:, None] * omega[None],) * 2)[1]
    above = jnp.maximum(rounding.outward(near + slack, near + slack)[1], 0)
    below = rounding.outward(near - slack, near - slack)[0]
    diagonal = lambda X: jnp.stack([X[i, i] for i in range(n)])
    point = lambda x: Interval(x, x)
    centre = Interval(diagonal(F.A.lo), diagonal(F.A.hi))
    least, one = mig(centre), jnp.ones_like(centre.lo)
    low = jnp.maximum(diagonal(below), over(point(one), point(least)).lo)
    alpha = jnp.maximum(minus(point(least), over(point(one), point(diagonal(above)))).hi, 0)
    above, low, alpha, size = _held((above, low, alpha, mag(b)))
    gamma, floor = rounding.product_error(n, b.dtype)
    floor = floor * (1 + jnp.max(above, (0, 1))) * (1 + jnp.max(size, 0))
    upward = lambda P: sum(P[:, k] * size[None, k] for k in range(n)) * (1 + gamma) + floor[None]
    beta = over(point(upward(jnp.where(eye, 0, above))), point(low)).hi
    total, beta = _held((upward(above), beta))
    x = over(Interval(*rounding.outward(b.lo - beta, b.hi + beta)), Interval(*rounding.outward(centre.lo - alpha, centre.hi + alpha)))
    unknown = jnp.isnan(total) | jnp.isnan(beta)
    free = lambda lo, hi: Interval(jnp.where(unknown, -jnp.inf, lo), jnp.where(unknown, jnp.inf, hi))
    return free(x.lo, x.hi), free(-total, total)


def gauss_seidel(A, b, x):
    """Solve each row for its own unknown, one after another, and intersect. Source: Alhaj-Dibo et al. 2004, appendix."""
    index = jnp.arange(b.shape[0])[:, None]

    def row(i, x):
        a = _at(A, i, 0)
        beside = _held(_where(index == i, Interval(jnp.zeros_like(x.lo), jnp.zeros_like(x.hi)), product(a, x)))
        known = _held(minus(_at(b, i, 0), interval_sum(beside)))
        return _held(_where(index == i, intersection(x, over(known, _at(a, i, 0))[None]), x))

    return jax.lax.fori_loop(0, b.shape[0], row, x)


def krawczyk(A, b, x):
    """Return (b + (I - A) x) intersected with x. Source: Alhaj-Dibo et al. 2004, appendix; Krawczyk 1969."""
    eye = jnp.broadcast_to(jnp.eye(A.shape[0], dtype=A.dtype)[..., None], A.shape)
    off = _held(product(minus(A, Interval(eye, eye)), x[None]))
    return intersection(x, minus(b, interval_sum(off, axis=1)))


def _iterate(step, A, b, x):
    """Repeat a contracting step; a system whose widths no longer shrink by a thousandth is left as it is, whatever its neighbours do."""
    shape = jnp.broadcast_shapes(x.shape, b.shape, A.shape[1:])
    b = jax.tree.map(lambda v: jnp.broadcast_to(v, shape), b)
    empty = jnp.any(x.is_empty, 0)
    x = Interval(jnp.broadcast_to(jnp.where(empty[None], 0, x.lo), shape), jnp.broadcast_to(jnp.where(empty[None], 0, x.hi), shape))

    def advance(carry):
        count, x, active, gone = carry
        new = step(A, b, x)
        lost = jnp.any(new.is_empty, 0)
        better = jnp.any((new.hi - new.lo < 0.999 * (x.hi - x.lo)) | ((new.hi - new.lo < jnp.inf) & (x.hi - x.lo == jnp.inf)), 0)
        keep = lambda a, c: jnp.where((active & ~lost)[None], a, c)
        return count + 1, Interval(keep(new.lo, x.lo), keep(new.hi, x.hi)), active & better & ~lost, gone | (active & lost)

    active = jnp.broadcast_to(~empty, shape[1:])
    _, x, _, gone = jax.lax.while_loop(lambda c: (c[0] < SWEEPS) & jnp.any(c[2]), advance, (0, x, active, ~active))
    return Interval(jnp.where(gone[None], jnp.inf, x.lo), jnp.where(gone[None], -jnp.inf, x.hi))


def contract(M, h, x):
    """Solve every row of M x = h for every unknown once, and intersect; a row that no x in the box fulfils leaves nothing."""
    r, n = M.shape[:2]
    gone = jnp.any(x.is_empty, 0)
    x = _where(gone[None], Interval(jnp.zeros_like(x.lo), jnp.zeros_like(x.hi)), x)
    eye = jnp.eye(n, dtype=M.dtype)[..., None] > 0

    def row(i, carry):
        x, gone = carry
        m, right = _at(M, i, 0), _at(h, i, 0)
        terms = _held(product(m, x))
        beside = _held(Interval(*(jnp.where(eye, 0, t[None]) for t in (terms.lo, terms.hi))))
        known = _held(minus(right[None], interval_sum(beside, axis=1)))
        new = intersection(x, over(known, m))
        lost = jnp.any(new.is_empty, 0) | disjoint(interval_sum(terms), right)
        return _held((_where(lost[None], x, new), gone | lost))

    shape = jnp.broadcast_shapes(x.shape, h.shape[-1:], M.shape[-1:])
    x = Interval(jnp.broadcast_to(x.lo, shape), jnp.broadcast_to(x.hi, shape))
    x, gone = jax.lax.fori_loop(0, r, row, (x, jnp.broadcast_to(gone, shape[-1:])))
    return Interval(jnp.where(gone[None], jnp.inf, x.lo), jnp.where(gone[None], -jnp.inf, x.hi))
