"""Kernels of interval linear systems: elimination, comparison matrices, sweeps over the rows.

One system lies in the leading axes, A (n, n, ...) and b (n, ...), a batch in the axis behind: every step is a
pass over the batch. A matrix that all systems share has a last axis of length 1 and is prepared once.

Preconditioning (`linear_products`) replaces M x = h by (C M) x = C h with C near the inverse of the middle of
M. C may be any numbers: a solution of the first system solves the second. So C is searched in plain floats,
and C M, C h are enclosed.

Source: Neumaier 1990, 1999 (comparison matrix, Hansen-Bliek-Rohn); Alhaj-Dibo, Maquin, Ragot 2004, appendix
(Gauss, Gauss-Seidel).
"""

from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import apart, most, total
from jaxbound.sets.intervals.comparisons import disjoint
from jaxbound.sets.intervals.interval import Interval, intersection, mag, mig
from jaxbound.sets.intervals.interval import sum as interval_sum
from jaxbound.sets.linear_systems.products import (
    entry_at,
    extremes,
    minus,
    over,
    product,
    reciprocal,
    solved_for,
    times,
    where,
)

SWEEPS = 100  # at most: they stop where one gains less than 1e-4 of the width


class ComparisonInverse(NamedTuple):
    """Bounds |<A>^-1 - near| <= v omega' of the inverse of a comparison matrix, NaN where none is proved.

    Fields: near (n, n, N), v (n, N) > 0, omega (n, N).
    """

    near: jax.Array
    v: jax.Array
    omega: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Factored:
    """All of a square system that does not depend on its right-hand side: A, its triangular factors, its
    comparison matrix's bounds.
    """

    A: Interval  # (n, n, N)
    lefts: tuple[Interval, ...]  # (n - k, n - k, N): what is left of A after k steps of the elimination
    reciprocals: tuple[Interval, ...]  # (N,): 1 / their first entry
    shares: tuple[Interval, ...]  # (n - 1 - k, N): what each row below takes of row k
    inverse: ComparisonInverse  # of <A>


def factored(A: Interval) -> Factored:
    """Prepare a square system: triangular factors without exchange of rows, and bounds of the inverse of its
    comparison matrix.
    """
    lefts, reciprocals, shares = [A], [_reciprocal(A)], []
    for _ in range(1, A.shape[0]):
        shares.append(_shares(lefts[-1], reciprocals[-1]))
        lefts.append(_eliminated(lefts[-1], shares[-1]))
        reciprocals.append(_reciprocal(lefts[-1]))
    return Factored(A, tuple(lefts), tuple(reciprocals), tuple(shares), comparison_inverse(A))


_reciprocal = apart(lambda x: reciprocal(x[0, 0]))
_eliminated = apart(lambda x, shares: _less(x[1:, 1:], shares[:, None], x[0, 1:][None], True))
_substituted = apart(lambda y, shares: _less(y[1:], shares, y[0][None], True))


@apart
def _shares(x: Interval, over_pivot: Interval) -> Interval:
    """Enclose the share that each row takes of the first one, and widen it by gamma of its size.

    The products of a share s with y are then wide enough for their own rounding: where s y is largest (or
    least), s moved outward by gamma mag(s), which adds (or takes) gamma mag(s) |y| >= gamma |s y|.
    """
    s = product(_unless_infinite(x[1:, 0]), over_pivot[None])
    wider = rounding.product_error(1, s.dtype)[0] * jnp.maximum(jnp.abs(s.lo), jnp.abs(s.hi))
    return Interval(s.lo - wider, s.hi + wider)


def _less(x: Interval, s: Interval, y: Interval, widened: bool = False) -> Interval:
    """Enclose x - s y; an end that overflowed stays infinite, or NaN, until `_unless_infinite`.

    The rounding of a product, of the difference, and of the bound are u each, or tiny; gamma and the floor
    hold many times that.
    """
    gamma, floor = rounding.product_error(1, x.dtype)
    least, greatest = extremes(s, y)
    lo, hi = x.lo - greatest, x.hi - least
    slack = lambda end, part: gamma * (jnp.abs(end) if widened else jnp.abs(end) + jnp.abs(part)) + floor
    return Interval(lo - slack(lo, greatest), hi + slack(hi, least))


def _unless_infinite(x: Interval) -> Interval:
    known = (jnp.abs(x.lo) < jnp.inf) & (jnp.abs(x.hi) < jnp.inf)
    return Interval(jnp.where(known, x.lo, jnp.nan), jnp.where(known, x.hi, jnp.nan))


def comparison_inverse(A: Interval) -> ComparisonInverse:
    """Return bounds of <A>^-1, <A> the comparison matrix.

    <A> has the least |a_ii| on its diagonal and -max|a_ij| beside it. v > 0 with <A> v > 0 proves that every
    matrix in A is regular and <A>^-1 >= 0. From <A>^-1 - near = <A>^-1 (I - <A> near) and |I - <A> near|_k <=
    omega_k <A> v. Source: Neumaier 1999; Rump 2013.
    """
    n = A.shape[0]
    eye = jnp.eye(n, dtype=A.dtype)
    S = _comparison(A, eye[..., None])
    near = jax.lax.fori_loop(
        0, n, lambda k, a: solved_for(a, entry_at(eye, k, 0)[:, None], k), S
    )  # pivots of such a matrix need no exchange
    v = apart(lambda near: jnp.maximum(total([near[:, k] for k in range(n)]), rounding.tiny(near.dtype)))(
        near
    )
    both = jnp.concatenate([near, v[:, None]], 1)
    image = times(S, Interval(both, both))
    w = image.lo[:, n]
    return _proved(near, v, w, _largest_quotient(image, _reciprocal_of(w), eye[..., None]))


_comparison = apart(lambda A, eye: jnp.where(eye > 0, mig(A), -mag(A)))
_reciprocal_of = apart(lambda w: reciprocal(Interval(w, w)).hi)


@apart
def _largest_quotient(x: Interval, over_w: jax.Array, eye: jax.Array) -> jax.Array:
    """Return an upper bound (n, N) of the largest |x - I| / w over the rows, over_w >= 1 / w > 0; NaN where
    it is unknown.
    """
    n = len(eye)
    off = jnp.maximum(jnp.abs(x.lo[:, :n] - eye), jnp.abs(x.hi[:, :n] - eye)) + 4 * rounding.tiny(x.dtype)
    largest = most([off[i] * over_w[i][None] for i in range(n)])
    return rounding.outward(largest, largest, 8)[1]  # a difference, a sum and a product


@apart
def _proved(near: jax.Array, v: jax.Array, w: jax.Array, omega: jax.Array) -> ComparisonInverse:
    proved = (most(list(-w)) < 0) & (most(list(omega)) < jnp.inf)
    known = (jnp.where(proved[(None,) * (x.ndim - 1)], x, jnp.nan) for x in (near, v, omega))
    return ComparisonInverse(*known)


def enclosed_solutions(F: Factored, b: Interval, method: str, start: Interval) -> Interval:
    """Return an enclosure (n, N) of the solutions in the start box: "gauss", "hbr", or of both boxes what
    sweeps over the rows leave.
    """
    boxes = []
    if method != "hbr":
        boxes.append(_gauss(F, b))
    if method != "gauss":
        above, low, divisor = hansen_bliek_rohn(F.A, F.inverse)
        boxes.append(_hbr_box(b, _beside(above, b), low, divisor))
    box = _all_of(start, *boxes)
    return box if method in ("gauss", "hbr") else _swept(F.A, b, box)


_all_of = apart(lambda box, *others: reduce(intersection, others, box))


def _gauss(F: Factored, b: Interval) -> Interval:
    """Substitute forward and backward. Source: Alhaj-Dibo et al. 2004, appendix; a pivot that holds 0 gives
    everything.
    """
    right = [b]
    x: list[Interval] = []
    for share in F.shares:
        right.append(_substituted(right[-1], share))
    for left, over_pivot, y in zip(reversed(F.lefts), reversed(F.reciprocals), reversed(right), strict=True):
        x.insert(0, _solved(y, left, x, over_pivot))
    return Interval(jnp.stack([v.lo for v in x]), jnp.stack([v.hi for v in x]))


@apart
def _solved(y: Interval, left: Interval, x: list[Interval], over_pivot: Interval) -> Interval:
    """Enclose y_0 minus all terms of the first row that are known, over its pivot."""
    y = reduce(lambda y, j: _less(y, left[0, j + 1], x[j]), range(len(x)), y[0])
    return product(_unless_infinite(y), over_pivot)


def hansen_bliek_rohn(A: Interval, N: ComparisonInverse) -> tuple[jax.Array, jax.Array, Interval]:
    """Return upper bounds of N = <A>^-1, lower bounds of N_ii, and A_ii + [-alpha_i, alpha_i].

    The enclosure (b_i + [-beta_i, beta_i]) / (A_ii + [-alpha_i, alpha_i]) has alpha_i = <A>_ii - 1 / N_ii and
    beta_i = (sum over k != i of N_ik |b_k|) / N_ii. Source: Neumaier 1999, theorem 2.1.
    """
    return _above(N), *_divisor(A, N)


def _slack(v: jax.Array, omega: jax.Array) -> jax.Array:
    return rounding.outward(v * omega, v * omega)[1]


@apart
def _above(N: ComparisonInverse) -> jax.Array:
    """Return an upper bound of the inverse of the comparison matrix."""
    bound = N.near + _slack(N.v[:, None], N.omega[None])
    return jnp.maximum(rounding.outward(bound, bound)[1], 0)


@apart
def _divisor(A: Interval, N: ComparisonInverse) -> tuple[jax.Array, Interval]:
    """Return lower bounds of N_ii, and A_ii + [-alpha_i, alpha_i]."""
    n = A.shape[0]
    diagonal = lambda X: jnp.stack([X[i, i] for i in range(n)])
    point = lambda x: Interval(x, x)
    centre, slack = Interval(diagonal(A.lo), diagonal(A.hi)), _slack(N.v, N.omega)
    least, middle = mig(centre), diagonal(N.near)
    one = jnp.ones_like(least)
    above = jnp.maximum(rounding.outward(middle + slack, middle + slack)[1], 0)
    below = rounding.outward(middle - slack, middle - slack)[0]
    alpha = jnp.maximum(minus(point(least), over(point(one), point(above))).hi, 0)
    return jnp.maximum(below, over(point(one), point(least)).lo), minus(centre, Interval(-alpha, alpha))


@apart
def _beside(above: jax.Array, b: Interval) -> jax.Array:
    """Return an upper bound of N |b| without the diagonal of N. See `_ball`."""
    n, eye = len(above), jnp.eye(len(above), dtype=bool)[..., None]
    gamma, floor = rounding.product_error(n, b.dtype)
    size = mag(b) * (1 + gamma) + np.sqrt(floor)
    others = jnp.where(eye, 0, above) + np.sqrt(floor)
    return total([others[:, k] * size[k][None] for k in range(n)])


@apart
def _hbr_box(b: Interval, beside: jax.Array, low: jax.Array, divisor: Interval) -> Interval:
    beta = over(*[Interval(x, x) for x in (beside, low)]).hi
    x = over(minus(b, Interval(-beta, beta)), divisor)
    return Interval(jnp.where(jnp.isnan(beside), -jnp.inf, x.lo), jnp.where(jnp.isnan(beside), jnp.inf, x.hi))


def _swept(A: Interval, b: Interval, x: Interval) -> Interval:
    """Repeat `contract`; a system whose widths no longer shrink by 1e-4 is left as it is, whatever its
    neighbours do.
    """
    shape = jnp.broadcast_shapes(x.shape, b.shape, A.shape[1:])
    wide = lambda v: jax.tree.map(lambda a: jnp.broadcast_to(a, shape), v)
    b, empty = wide(b), jnp.any(x.is_empty, 0)
    x = wide(where(empty[None], Interval(jnp.zeros_like(x.lo), jnp.zeros_like(x.hi)), x))

    def advance(carry):
        count, x, active, gone = carry
        return count + 1, *_progress(contract(A, b, x), x, active, gone)

    active = jnp.broadcast_to(~empty, shape[1:])
    _, x, _, gone = jax.lax.while_loop(
        lambda c: (c[0] < SWEEPS) & jnp.any(c[2]), advance, (0, x, active, ~active)
    )
    return Interval(jnp.where(gone[None], jnp.inf, x.lo), jnp.where(gone[None], -jnp.inf, x.hi))


@apart
def _progress(
    new: Interval, x: Interval, active: jax.Array, gone: jax.Array
) -> tuple[Interval, jax.Array, jax.Array]:
    lost = jnp.any(new.is_empty, 0)
    better = jnp.any(
        (new.hi - new.lo < 0.9999 * (x.hi - x.lo)) | ((new.hi - new.lo < jnp.inf) & (x.hi - x.lo == jnp.inf)),
        0,
    )
    return where((active & ~lost)[None], new, x), active & better & ~lost, gone | (active & lost)


def contract(M: Interval, h: Interval, x: Interval) -> Interval:
    """Solve every row of M x = h for every unknown once, and intersect; a row that no x in the box fulfils
    leaves nothing.
    """
    n, shape = M.shape[1], jnp.broadcast_shapes(x.shape, h.shape[-1:], M.shape[-1:])
    gone = jnp.any(x.is_empty, 0)
    x = where(gone[None], Interval(jnp.zeros_like(x.lo), jnp.zeros_like(x.hi)), x)
    eye = jnp.eye(n, dtype=bool)[..., None]

    def row(i, carry):
        x, gone = carry
        m, right = entry_at(M, i, 0), entry_at(h, i, 0)
        terms = _terms(m, x)
        new = _each(x, terms, m, right, eye)
        return _kept_sweep(new, x, terms, right, gone)

    x = Interval(jnp.broadcast_to(x.lo, shape), jnp.broadcast_to(x.hi, shape))
    x, gone = jax.lax.fori_loop(0, M.shape[0], row, (x, jnp.broadcast_to(gone, shape[-1:])))
    return Interval(jnp.where(gone[None], jnp.inf, x.lo), jnp.where(gone[None], -jnp.inf, x.hi))


_terms = apart(product)


@apart
def _each(x: Interval, terms: Interval, m: Interval, right: Interval, eye: jax.Array) -> Interval:
    beside = Interval(*(jnp.where(eye, 0, t[None]) for t in (terms.lo, terms.hi)))
    return intersection(x, over(minus(right[None], interval_sum(beside, axis=1)), m))


@apart
def _kept_sweep(
    new: Interval, x: Interval, terms: Interval, right: Interval, gone: jax.Array
) -> tuple[Interval, jax.Array]:
    lost = jnp.any(new.is_empty, 0) | disjoint(interval_sum(terms), right)
    return where(lost[None], x, new), gone | lost
