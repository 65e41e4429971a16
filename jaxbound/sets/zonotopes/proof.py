"""Proofs that a point lies in a zonotope or outside of it: checks of given candidates.

The question is always whether some x in [-1, 1]^q has M x = d, for a set that its matrix M (m, q) holds and
points d. Whatever found the candidates (`zonotopes.search`), on whatever device and in whatever precision,
has no part in the proof. It is the same proof on the host, in float64, and inside jit (`zonotopes.kernels`),
in the precision of what is given: products are plain sums of products in some order, fused or not, numbers
below the smallest normal one perhaps read as 0, and `rounding.product_error` bounds them; that is the premise
here. Candidates must have one value for all their uses: NumPy arrays do, inside jit `kernels.settled` sees to
it.

**Outside** (`gauge_above`). Any l with l'd > sum_j |l' M_j|. In floats both sides together are off by at most
gamma (|l|'|d| + sum_j |l|'|M_j|) + floor (1 + max|l|)(1 + max|M| + max|d|), that of a sum of m + q products;
l has entries of at most 1. d, a difference of two floats rounded once, is off by u |d|, which gamma holds as
well; by how much more d may be off, `off` says.

**Inside** (`gauge_below`). Let R be such that every row sum of |1 - M R| is at most rho < 1 and x any point,
r = d - M x. Then y with M R y = r exists, max|y| <= max|r| / (1 - rho), and M (x + R y) = d: x_j moves by at
most reach_j max|y|, reach_j = sum_i |R_ji|. So min max|x| <= max_j (|x_j| + reach_j max|r| / (1 - rho)). A
set that is flat, or flat but for rounding, has no such R.

**A zonotope** D [1, z], D (m, 1 + p): outside by l with l'D_0 + sum_k |l'D_k| > sum_j |l'M_j|
(`reach_above`); inside by X (q, 1 + p) with M X = D and row sums of |X| of at most 1, a column at a time as
above (`rows_below`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding

__all__ = [
    "SMALL",
    "Image",
    "gauge_above",
    "gauge_below",
    "image",
    "largest",
    "library",
    "measured",
    "more",
    "product",
    "reach_above",
    "rows_below",
    "unit",
    "vertices",
]


Array = TypeVar("Array", np.ndarray, jax.Array)

SINGLE = 2**18
"""Products of numbers for which OpenBLAS stays on one thread; with two, 1000 points of 20 coordinates took
five times as long.
"""

SMALL = 24
"""Rows up to which equations are solved many at a time on the host; larger ones one by one, while they are in
the processor's cache.
"""


def library(x: object) -> Any:
    """Return NumPy for its arrays, jax.numpy for what is inside jit."""
    return np if isinstance(x, np.ndarray) else jnp


def largest(x: Array, axis: int | tuple[int, ...]) -> Array:
    """Return the largest |x|, infinite where one is NaN, which a compiled maximum of many numbers may
    overlook; 0 of none.
    """
    xp, size = library(x), abs(x).max(axis, initial=0)
    fine = np.isfinite(size) if xp is np else jnp.isfinite(x).all(axis)  # that of NumPy overlooks none
    return xp.where(fine, size, np.inf)


def product(A: Array, B: Array) -> Array:
    """Return A @ B, (S, N, k) by (S, k, j); on the host with points side by side in memory, and by blocks of
    them that do not wake threads.

    NumPy adds up and compares the few entries of points that lie so several times as fast.
    """
    if library(A) is jnp:
        return A @ B
    (S, N, k), j = A.shape, B.shape[2]
    left, right, points = B.swapaxes(1, 2), A.swapaxes(1, 2), SINGLE // max(k * j, 1)
    if not 8 <= points < N:
        return (left @ right).swapaxes(1, 2)
    out = np.empty((S, j, N))
    for start in range(0, N, points):
        np.matmul(left, right[..., start : start + points], out=out[..., start : start + points])
    return cast(Array, out.swapaxes(1, 2))


def unit(l: Array) -> Array:
    """Return directions (..., m), each in terms of its largest entry."""
    size = abs(l).max(-1, initial=0)[..., None]
    return l / library(l).where(size > 0, size, 1)


def more(x: Array) -> np.floating:
    """Return 1 and more than the few roundings of what it multiplies, each of a few u."""
    return 1 + 64 * rounding.unit(x.dtype)


@dataclass(frozen=True, eq=False)
class Image(Generic[Array]):
    """The image M [-1, 1]^q for each of S sets, rows scaled by powers of two so that no entry exceeds 1, and
    the numbers that proofs need of it.

    Fields: M (S, m, q) and powers (S, m), M = 2^powers times the rows given; R (S, q, m), a right inverse,
    nearly; reach (S, q) = row sums of |R|; loss (S,), at least every row sum of |1 - M R|, inf where that is
    of no use; sums (S, m), row sums of |M|.
    """

    M: Array
    powers: Array
    R: Array
    reach: Array
    loss: Array
    sums: Array

    def scaled(self, d: np.ndarray) -> np.ndarray:
        """Return points d (S, N, m) in the rows' own scale; NaN for a number that it would turn into 0 or
        infinity.
        """
        with np.errstate(over="ignore", under="ignore"):
            out = np.ldexp(d, self.powers[:, None])
        return np.where(((out == 0) & (d != 0)) | ~np.isfinite(out), np.nan, out)

    def of(self, sets: np.ndarray) -> Image[Array]:
        """Return the Image of some of the sets, by number."""
        return Image(*(x[sets] for x in (self.M, self.powers, self.R, self.reach, self.loss, self.sums)))


def image(M: ArrayLike) -> Image[np.ndarray]:
    """Build the Image of matrices M (S, m, q), any finite floats, on the host."""
    given = np.asarray(M, float)
    top = abs(given).max(2, initial=0)
    powers = np.where(top > 0, -np.frexp(top)[1], 0)
    scaled = np.ldexp(given, powers[..., None])
    return measured(scaled, powers, _right_inverse(scaled))


def measured(M: Array, powers: Array, R: Array) -> Image[Array]:
    """Return the Image of scaled matrices M (S, m, q), with any R (S, q, m) for right inverses."""
    xp, (_, m, q) = library(M), M.shape
    with np.errstate(all="ignore"):
        gamma, floor = rounding.product_error(q + 2, M.dtype)
        up = 1 + rounding.product_error(m, M.dtype)[0]
        off = abs(product(M, R) - xp.eye(m, dtype=M.dtype)[None]) + gamma * (product(abs(M), abs(R)) + 1)
        off += 2 * floor * (1 + largest(R, (1, 2)))[:, None, None]
        loss = largest(off.sum(2), 1) * up
        return Image(M, powers, R, abs(R).sum(2) * up, xp.where(loss < 0.5, loss, np.inf), abs(M).sum(2))


def _right_inverse(M: np.ndarray) -> np.ndarray:
    """Return R (S, q, m) with M R nearly 1, of least norm; the pseudo-inverse where there is none."""
    S, m, q = M.shape
    if not m or not q:
        return np.zeros((S, q, m))
    turned = M.swapaxes(1, 2)
    R, bad = np.zeros((S, q, m)), np.ones(S, bool)
    with np.errstate(all="ignore"):
        if m <= q:
            R = turned @ _inverse(M @ turned)[0]
            R = 2 * R - R @ (M @ R)  # a Newton step: what is lost by squaring the condition
            bad = ~(abs(M @ R - np.eye(m)).sum(2).max(1) < 2.0**-10)
        if bad.any():
            R[bad] = np.linalg.pinv(M[bad])
    return R


def _inverse(W: Array) -> tuple[Any, Any]:
    """Return (inverses of W (N, m, m), which of them there are)."""
    if library(W) is jnp:
        Q, U = jnp.linalg.qr(W)  # compiles in a third of the time that elimination takes
        inverse = jax.scipy.linalg.solve_triangular(U, Q.swapaxes(1, 2))
        return inverse, jnp.isfinite(inverse).all((1, 2))
    try:
        return np.linalg.inv(W), np.ones(len(W), bool)
    except np.linalg.LinAlgError:
        regular = np.linalg.slogdet(W)[0] != 0
        return np.linalg.inv(np.where(regular[:, None, None], W, np.eye(W.shape[1]))), regular


def gauge_above(image: Image[Array], d: Array, l: Array, off: Array | float = 0.0) -> Array:
    """Return lower bounds (S, N) of the gauges of d (S, N, m), off by at most `off` and one rounding; above 1
    only if proved outside.

    Args:
        l: (S, N, m), any directions of entries of at most 1.
    """
    xp, (_, m, q) = library(d), image.M.shape
    gamma, floor = rounding.product_error(m + q + 4, d.dtype)
    with np.errstate(all="ignore"):
        ahead, width = (l * d).sum(2), abs(product(l, image.M)).sum(2)
        slack = (abs(l) * (gamma * (image.sums[:, None] + abs(d)) + off)).sum(2) * (1 + gamma)
        slack += floor * 2 * (q + 1) * (3 + largest(d, 2))
        bound = xp.maximum((ahead - slack) / (width + slack) / more(d), 0)
        bound = xp.where(
            ahead - width > slack, xp.maximum(bound, 1 + 2 * rounding.unit(d.dtype)), xp.minimum(bound, 1)
        )
        return xp.where(xp.isfinite(ahead) & xp.isfinite(width) & xp.isfinite(slack), bound, 0)


def gauge_below(image: Image[Array], d: Array, x: Array, off: Array | float = 0.0) -> Array:
    """Return upper bounds (S, N) of the gauges of d (S, N, m), off by at most `off` and one rounding; at most
    1 only if proved inside.

    Args:
        x: (S, N, q), any points.
    """
    xp, q = library(d), image.M.shape[2]
    gamma, floor = rounding.product_error(q + 4, d.dtype)
    with np.errstate(all="ignore"):
        size = largest(x, 2)[..., None]
        error = gamma * (size * image.sums[:, None] + abs(d)) + floor * 2 * (1 + size) + off
        left = (
            largest(abs(d - product(x, image.M.swapaxes(1, 2))) + error, 2)
            / (1 - image.loss[:, None])
            * more(d)
        )
        bound = largest(abs(x) + image.reach[:, None] * left[..., None], 2) * more(d)
        bound = xp.where(xp.isfinite(bound) & xp.isfinite(image.loss)[:, None], bound, np.inf)
        return (
            cast(Array, np.where(abs(d).max(2, initial=0) == 0, 0, bound)) if xp is np else bound
        )  # inside jit, what is read as 0 may not be


def reach_above(image: Image[Array], D: Array, l: Array) -> Array:
    """Return lower bounds (S, N) of how far D [1, z] reaches in terms of M x, along directions l (S, N, m) of
    entries of at most 1.
    """
    xp, (_, m, p), q = library(D), D.shape, image.M.shape[2]
    gamma, floor = rounding.product_error(m + p + q + 4, D.dtype)
    with np.errstate(all="ignore"):
        along, width = l @ D, abs(l @ image.M).sum(2)
        ahead = along[..., 0] + abs(along[..., 1:]).sum(2)
        slack = gamma * (abs(l) * (image.sums + abs(D).sum(2))[:, None]).sum(2)
        slack += (floor * 2 * (p + q + 1) * (3 + largest(D, (1, 2))))[:, None]
        bound = xp.maximum((ahead - slack) / (width + slack) / more(D), 0)
        bound = xp.where(
            ahead - width > slack, xp.maximum(bound, 1 + 2 * rounding.unit(D.dtype)), xp.minimum(bound, 1)
        )
        return xp.where(xp.isfinite(ahead) & xp.isfinite(width) & xp.isfinite(slack), bound, 0)


def rows_below(image: Image[Array], D: Array, X: Array) -> Array:
    """Return upper bounds (S,) of the largest row sum of |X| with M X = D, of one near X (S, q, 1 + p)."""
    xp = library(D)
    gamma, floor = rounding.product_error(X.shape[1] + 4, D.dtype)
    with np.errstate(all="ignore"):
        size = largest(X, 1)[:, None]
        error = gamma * (image.sums[..., None] * size + abs(D)) + floor * 2 * (1 + size)
        left = largest(abs(D - image.M @ X) + error, 1).sum(1) / (1 - image.loss) * more(D)
        up = (1 + rounding.product_error(X.shape[2] + 4, D.dtype)[0]) * more(D)
        bound = largest(abs(X).sum(2) + image.reach * left[:, None], 1) * up
        return xp.where(xp.isfinite(bound) & xp.isfinite(image.loss), bound, np.inf)


def vertices(M: Array, d: Array, x: Array, s: Array) -> tuple[Array, Array]:
    """Return (x, l): the vertices of both programs that the near-optimal x (N, q) and freedom s (N, q) point
    to; no claim.

    The m - 1 freest entries are unknown, the others are at +-t: m equations for them and t. The last row of
    the inverse is l.

    Args: M (m, q) or (N, m, q), m <= q; d (N, m).
    """
    xp, (_, m), q = library(d), d.shape, x.shape[1]
    order = xp.argsort(-s, axis=1)
    rank = xp.argsort(order, axis=1)
    sign = xp.where(rank < m - 1, 0, xp.where(x < 0, -1.0, 1.0)).astype(d.dtype)
    chosen = xp.take_along_axis(xp.broadcast_to(M, (len(d), *M.shape[-2:])), order[:, None, : m - 1], 2)
    W = xp.concatenate([chosen, (M @ sign[..., None] if M.ndim == 3 else (sign @ M.T)[..., None])], 2)
    with np.errstate(all="ignore"):
        y, normal, regular = _solved(W, d)
        places = xp.where(rank < m - 1, q + rank, xp.arange(q)[None])
        out = xp.take_along_axis(xp.concatenate([sign * y[:, -1:], y[:, :-1]], 1), places, 1)
    return xp.where(regular[:, None], out, x), xp.where(regular[:, None], normal, 0)


def _solved(W: Array, d: Array) -> tuple[Any, Any, Any]:
    """Return (W^-1 d, the last rows of W^-1, which of W (N, m, m) are regular) for d (N, m)."""
    if library(W) is np and W.shape[1] > SMALL:
        return _solved_alone(cast(np.ndarray, W), cast(np.ndarray, d))
    inverse, regular = _inverse(W)
    y = inverse @ d[..., None]
    return (y + inverse @ (d[..., None] - W @ y))[..., 0], inverse[:, -1], regular


def _solved_alone(W: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from scipy.linalg.lapack import dgetrf, dgetrs

    y, normal, regular = np.zeros_like(d), np.zeros_like(d), np.zeros(len(d), bool)
    last = np.eye(W.shape[1])[-1]
    for i, (A, v) in enumerate(zip(W, d, strict=True)):
        factor, pivots, singular = dgetrf(
            A.T, overwrite_a=False
        )  # of the transpose: no copy in another order
        regular[i] = not singular
        if regular[i]:
            solve = lambda r, trans, factor=factor, pivots=pivots: dgetrs(factor, pivots, r, trans=trans)[0]
            y[i] = solve(v, 1)
            y[i] += solve(v - A @ y[i], 1)
            normal[i] = solve(last, 0)
    return y, normal, regular
