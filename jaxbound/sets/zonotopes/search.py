"""Search for the gauge of a point in a zonotope: no claim is made here, `zonotopes.proof` checks what is
found.

The gauge of d is t = min { max_j |x_j| : M x = d } = max { l' d : sum_j |l' M_j| <= 1 }, M (m, q). All
points of a set at once: their products become matrix products.

**Projections** (`project`). Douglas-Rachford between {x : M x = d} and the box [-1, 1]^q: where they meet,
the iterates tend to a common point, else their distance z - clip(z) tends to a vector M' l that separates
them. Settles what is some per cent away from the boundary in some ten steps of two products. Source: Douglas,
Rachford 1956; Bauschke, Combettes, Luke 2004 for what it does where they do not meet.

**Interior points** (`advance`), on the host. A predictor-corrector method (Mehrotra 1992) for the pair of
linear programs, with slacks a = t - x, b = t + x and multipliers u, w >= 0, u - w = M' l, sum(u + w) = 1.
With s = a b / (u b + w a), a Newton step solves (M diag(s) M') dl = f. Ten to twenty steps, whatever the
size. At the end s is large where |x_j| < t: the vertex is known (`vertices`).
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import jax
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes.proof import Array, largest, library, product, solved

__all__ = [
    "SMALL",
    "State",
    "advance",
    "beside",
    "project",
    "reached",
    "repeated",
    "start",
    "vertices",
]

T = TypeVar("T")
STEPS = 40
"""At most so many steps of interior points; ten to twenty are the rule."""
OUTER = 2**15
"""Numbers in the products of all pairs of rows of a matrix, up to which they are kept for all its points."""
MANY = 64
"""From so many small matrices on they are factored side by side on the host."""
SMALL = 24
"""Rows up to which equations are solved many at a time on the host; larger ones one by one, while they are in
the processor's cache.
"""


def project(
    M: Array, R: Array, d: Array, z: Array, steps: int, together: bool = False
) -> tuple[Array, Array, Array]:
    """Return (x, l, z) for each point after so many steps: a candidate point, a candidate direction, and
    where to go on from.

    Args:
        M: (S, m, q). R: right inverses of M, nearly, (S, q, m). d: (S, N, m). z: (S, N, q), R d at first.
            NumPy arrays stay on the host, where some steps take less time than to hand them to a device.
        together: the points are columns of one matrix, with sums of |x| along its rows of at most 1.
    """
    xp, turned, back = library(z), M.swapaxes(1, 2), R.swapaxes(1, 2)
    onto = lambda x: x + product(d - product(x, turned), back)
    within = _row_balls if together else lambda x: xp.clip(x, -1, 1)

    def step(z):
        y = within(z)
        return z + onto(2 * y - z) - y

    z = repeated(step, z, steps)
    y = within(z)
    return onto(y), product(z - y, R), z


def beside(M: Array, d: Array, z: Array, l: Array) -> Array:
    """Return directions l, but towards the point where it is beside the plane of a flat set: z is R d."""
    away = d - product(z, M.swapaxes(1, 2))
    flat = abs(away).max(2, initial=0) > rounding.unit(d.dtype) ** 0.5 * abs(d).max(2, initial=0)
    return library(d).where(flat[..., None], away, l)


def _row_balls(X: Array) -> Array:
    """Return the nearest columns (S, N, q) whose sums of |x| over all are at most 1 (Held, Wolfe, Crowder
    1974).
    """
    xp, size = library(X), abs(X)
    falling = -xp.sort(-size, 1)
    rank = xp.arange(1, X.shape[1] + 1, dtype=X.dtype)[None, :, None]
    level = ((xp.cumsum(falling, 1) - 1) / rank).max(1)[:, None]
    return xp.sign(X) * xp.maximum(size - xp.maximum(level, 0), 0)


def repeated(
    step: Callable[[T], T], state: T, most: int, going: Callable[[T], object] = lambda state: True
) -> T:
    """Return the state after at most so many steps, as long as it is going: on the host, or inside jit."""
    if isinstance(jax.tree.leaves(state)[0], jax.Array):
        counted = lambda carry: (carry[0] + 1, step(carry[1]))
        goes_on = lambda carry: (carry[0] < most) & going(carry[1])
        last: T = jax.lax.while_loop(goes_on, counted, (np.int32(0), state))[1]
        return last
    for _ in range(most):
        if not going(state):
            break
        state = step(state)
    return state


State: TypeAlias = tuple[np.ndarray, ...]
"""x (S, N, q), t (S, N), l (S, N, m), u and w (S, N, q) as above, points in terms of size (S, N), and whether
a point is done (S, N).
"""


def start(M: np.ndarray, R: np.ndarray, d: np.ndarray) -> State:
    """Return the first interior points for points d (S, N, m)."""
    x = product(d, R.swapaxes(1, 2))
    size = largest(x, 2)
    size = np.where((size > 0) & (size < np.inf), size, 1)
    even, t = np.full_like(x, 0.5 / M.shape[2]), np.full_like(size, 1.5)
    return x / size[..., None], t, np.zeros_like(d), even, even, size, ~np.isfinite(x.sum(2))


def reached(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (x, l, s) of a state: near-optimal for the two programs, and how free each x_j is."""
    x, t, l, u, w, size, _ = state
    a, b = t[..., None] - x, t[..., None] + x
    return x * size[..., None], l, a * b / (u * b + w * a)


def advance(M: np.ndarray, d: np.ndarray, state: State, enough: float) -> State:
    """Take one step of interior points; what is done stays.

    Args:
        enough: a point for which t < 1 - enough or l' d > 1 + enough is settled; inf to go on to the optimum.
    """
    turned = M.swapaxes(1, 2)
    x, t, l, u, w, size, done = state
    (_, m, q), eps, each = M.shape, np.finfo(x.dtype).eps, (..., None)
    total = lambda v: v.sum(2)
    a, b = t[each] - x, t[each] + x
    d = d / size[each]
    alpha, beta = u / a, w / b
    s = 1 / (alpha + beta)
    lean = (alpha - beta) * s
    solve = _solver(M, s, 4 * eps / m)
    v = product(lean, turned)
    lack, slope, rest = d - product(x, turned), product(l, M) - u + w, 1 - total(u + w)
    Nv = solve(v)
    curve, gap = total(4 * alpha * beta * s) + total(v * Nv), total(a * u + b * w)

    def newton(carry):
        """Take the step with a du + u da = ra and b dw + w db = rb; return what to correct it by, it, and how
        far it may go.
        """
        ra, rb, *_ = carry
        ra, rb = ra / a, rb / b
        h = slope - ra + rb
        f = solve(lack - product(s * h, turned))
        dt = (total(v * f) - (rest - total(lean * h) - total(ra + rb))) / curve
        dl = f - Nv * dt[each]
        dx = s * (product(dl, M) + h) + lean * dt[each]
        da, db = dt[each] - dx, dt[each] + dx
        du, dw = ra - alpha * da, rb - beta * db
        p, r = _room(((a, da), (b, db))), _room(((u, du), (w, dw)))
        ahead = total((a + p[each] * da) * (u + r[each] * du) + (b + p[each] * db) * (w + r[each] * dw))
        target = ((ahead / gap) ** 3 * gap / (2 * q))[each]
        return target - a * u - da * du, target - b * w - db * dw, dx, dt, dl, du, dw, p, r

    found = (-a * u, -b * w, x, t, l, u, w, t, t)
    found = newton(newton(found))
    *_, dx, dt, dl, du, dw, p, r = found
    p, r = 0.995 * p, 0.995 * r
    new = x + p[each] * dx, t + p * dt, l + r[each] * dl, u + r[each] * du, w + r[each] * dw
    keep = done | ~np.isfinite(total(new[0]) + total(new[2]) + new[1])
    x, t, l, u, w = (
        np.where(keep[each] if old.ndim == 3 else keep, old, now)
        for old, now in zip(state, new, strict=False)
    )
    least, most = total(l * d) / np.maximum(total(abs(product(l, M))), eps), abs(x).max(2)
    settled = (most * size < 1 - enough) | (least * size > 1 + enough)
    return x, t, l, u, w, size, keep | settled | (most - least <= 2.0**-16 * eps**0.5 * most)


def _room(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return how far all x + p dx stay positive, at most 1."""
    rooms = [np.where(dx < 0, -x / dx, 1).min(2) for x, dx in pairs]
    return np.minimum(np.minimum(*rooms), 1)


def _solver(M: np.ndarray, s: np.ndarray, room: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solver of (M diag(s) M' + room times its mean diagonal) f = r for each point, r (S, N, m)."""
    (S, m, q), N = M.shape, s.shape[1]
    if m > SMALL:
        return _one_by_one(M, s, room)
    if S == 1 and N > 1 and m * m * q <= OUTER:  # one matrix product for many points
        normal = product(s, (M[0, :, None] * M[0]).reshape(1, m * m, q).swapaxes(1, 2)).reshape(S, N, m, m)
    else:
        root = M[:, None] * np.sqrt(s)[:, :, None]
        normal = root @ root.swapaxes(2, 3)
    mean = np.trace(normal, axis1=2, axis2=3)[..., None, None]
    normal = normal + room * mean * np.eye(m, dtype=s.dtype)[None, None]
    if N == 1 or S * N < MANY:  # each by itself: the same bits whatever stands beside it
        return lambda r: solved(normal, r[..., None])[..., 0]
    solve = _factored(normal.reshape(S * N, m, m))
    return lambda r: solve(r.reshape(S * N, m)).reshape(S, N, m)


def _one_by_one(M: np.ndarray, s: np.ndarray, room: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solver as `_solver` does, for large matrices: each is made and factored while it is in the
    processor's cache.

    NumPy would multiply them on all threads, which on a machine with other work took seventy times as long as
    this.
    """
    from scipy.linalg.blas import dsyrk
    from scipy.linalg.lapack import dpotrf, dpotrs

    turned, factors = np.ascontiguousarray(M.swapaxes(1, 2)), []
    for i, j in np.ndindex(s.shape[:2]):
        normal = dsyrk(1.0, (turned[i] * np.sqrt(s[i, j])[:, None]).T)
        normal.T.flat[:: len(normal) + 1] += room * normal.trace()
        factors.append(dpotrf(normal, overwrite_a=True, clean=False)[0])
    flat = lambda r: r.reshape(-1, r.shape[2])
    return lambda r: np.array([dpotrs(L, v)[0] for L, v in zip(factors, flat(r), strict=True)]).reshape(
        r.shape
    )


def _factored(N: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solver of N f = r for r (P, m), N (P, m, m) positive definite, side by side."""
    L = np.array(N.transpose(1, 2, 0), order="C")
    m = len(L)
    for k in range(m):
        L[k:, k] -= np.einsum("ijp,jp->ip", L[k:, :k], L[k, :k])
        L[k:, k] /= np.sqrt(L[k, k])

    def solve(r):
        x = np.array(r.T, order="C")
        for k in range(m):
            x[k] /= L[k, k]
            x[k + 1 :] -= L[k + 1 :, k] * x[k]
        for k in reversed(range(m)):
            x[k] /= L[k, k]
            x[:k] -= L[k, :k] * x[k]
        return x.T

    return solve


def vertices(M: np.ndarray, d: np.ndarray, x: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, l): the vertices of both programs that the near-optimal x (S, N, q) and freedom s (S, N, q)
    point to; no claim.

    The m - 1 freest entries are unknown, the others are at +-t: m equations for them and t. The last row of
    the inverse is l.

    Args: M (S, m, q), m <= q; d (S, N, m).
    """
    shapes, (S, N, m), q = (x.shape, d.shape), d.shape, x.shape[2]
    d, x, s = (v.reshape(S * N, -1) for v in (d, x, s))
    # a set of one point is worked out as if others stood beside it
    each: Any = M[0] if S == 1 and N > 1 else np.repeat(M, N, 0)
    order = np.argsort(-s, axis=1)
    rank = np.argsort(order, axis=1)
    sign = np.where(rank < m - 1, 0, np.where(x < 0, -1.0, 1.0)).astype(d.dtype)
    chosen = np.take_along_axis(np.broadcast_to(each, (len(d), m, q)), order[:, None, : m - 1], 2)
    W = np.concatenate(
        [chosen, (each @ sign[..., None] if each.ndim == 3 else (sign @ each.T)[..., None])], 2
    )
    with np.errstate(all="ignore"):
        y = solved(W, d[..., None])[..., 0]
        normal = solved(W.swapaxes(1, 2), np.broadcast_to(np.eye(m, dtype=d.dtype)[:, -1:], (len(d), m, 1)))
        places = np.where(rank < m - 1, q + rank, np.arange(q)[None])
        out = np.take_along_axis(np.concatenate([sign * y[:, -1:], y[:, :-1]], 1), places, 1)
    return out.reshape(shapes[0]), normal.reshape(shapes[1])
