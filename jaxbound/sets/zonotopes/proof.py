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

**A zonotope** D [1, z], D (m, 1 + p): outside by one of its corners; inside by X (q, 1 + p) with M X = D and
row sums of |X| of at most 1, a column at a time as above (`gauge_below`, together).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding

Array = TypeVar("Array", np.ndarray, jax.Array)

SINGLE = 2**18
"""Products of numbers for which OpenBLAS stays on one thread; with two, 1000 points of 20 coordinates took
five times as long.
"""


def library(x: object) -> Any:
    """Return NumPy for its arrays, jax.numpy for what is inside jit."""
    return np if isinstance(x, np.ndarray) else jnp


def largest_size(x: Array, axis: int | tuple[int, ...]) -> Array:
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


def in_largest_entry(l: Array) -> Array:
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

    def scaled(self, d: Array) -> Array:
        """Return points d (S, N, m) in the rows' own scale; on the host NaN for a number that it would turn
        into 0 or infinity.
        """
        if library(d) is jnp:
            powers = jnp.broadcast_to(cast(jax.Array, self.powers)[:, None], d.shape)
            return cast(Array, rounding.scale(cast(jax.Array, d), powers))
        with np.errstate(over="ignore", under="ignore"):
            out = np.ldexp(d, self.powers[:, None])
        return cast(Array, np.where(((out == 0) & (d != 0)) | ~np.isfinite(out), np.nan, out))

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
        off += 2 * floor * (1 + largest_size(R, (1, 2)))[:, None, None]
        loss = largest_size(off.sum(2), 1) * up
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
            # the normal equations: far sooner solved than the singular values of a pseudo-inverse are found
            R = turned @ _solved(M @ turned, np.broadcast_to(np.eye(m), (S, m, m)))
            R = 2 * R - R @ (M @ R)  # a Newton step: what is lost by squaring the condition
            # a rank that rounding hides, or none: `measured` will say what it is worth
            bad = ~(abs(M @ R - np.eye(m)).sum(2).max(1) < 2.0**-10)
        if bad.any():
            R[bad] = np.linalg.pinv(M[bad])
    return R


def _solved(W: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return W^-1 B, (S, m, m) by (S, m, k), of NaN where there is no inverse; no claim is made."""
    try:
        return np.linalg.solve(W, B)
    except np.linalg.LinAlgError:
        regular = np.linalg.slogdet(W)[0] != 0
        return np.linalg.solve(np.where(regular[..., None, None], W, np.nan), B)


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
        slack += floor * 2 * (q + 1) * (3 + largest_size(d, 2))
        bound = xp.maximum((ahead - slack) / (width + slack) / more(d), 0)
        bound = xp.where(
            ahead - width > slack, xp.maximum(bound, 1 + 2 * rounding.unit(d.dtype)), xp.minimum(bound, 1)
        )
        return xp.where(xp.isfinite(ahead) & xp.isfinite(width) & xp.isfinite(slack), bound, 0)


def gauge_below(
    image: Image[Array], d: Array, x: Array, off: Array | float = 0.0, together: bool = False
) -> Array:
    """Return upper bounds (S, N) of the gauges of d (S, N, m), off by at most `off` and one rounding; at most
    1 only if proved inside.

    Args:
        x: (S, N, q), any points. together: x and d are columns of matrices X and D: bounds (S, 1) of the
            largest row sum of |X| with M X = D.
    """
    xp, (_, N, q) = library(d), x.shape
    gamma, floor = rounding.product_error(q + 4, d.dtype)
    with np.errstate(all="ignore"):
        size = largest_size(x, 2)[..., None]
        error = gamma * (size * image.sums[:, None] + abs(d)) + floor * 2 * (1 + size) + off
        # what the point misses the target by, and what rounding may hide of it
        short = abs(d - product(x, image.M.swapaxes(1, 2))) + error
        left = largest_size(short, 2) / (1 - image.loss[:, None]) * more(d)
        sizes, far = abs(x) + image.reach[:, None] * left[..., None], largest_size(d, 2)
        if together:
            up = 1 + rounding.product_error(N + 4, d.dtype)[0]
            sizes, far = sizes.sum(1)[:, None] * up, far.max(1)[:, None]
        bound = largest_size(sizes, 2) * more(d)
        bound = xp.where(xp.isfinite(bound) & xp.isfinite(image.loss)[:, None], bound, np.inf)
        return xp.where(far == 0, 0, bound) if xp is np else bound  # inside jit, what is read as 0 may not be


def unscaled(l: Array, powers: Array) -> Array:
    """Return directions (S, N, m), of entries of at most 1, for the rows as they were given."""
    xp, some = library(l), l != 0
    # rows were scaled by powers of two: a multiplier is scaled the other way
    top = xp.where(some, powers[:, None], -np.inf).max(2, initial=-np.inf, keepdims=True)
    shift = xp.where(some, powers[:, None] - top, 0)
    if xp is jnp:
        return cast(Array, xp.where(some, rounding.scale(cast(jax.Array, l), shift), 0))
    with np.errstate(under="ignore"):
        return cast(Array, np.ldexp(l, shift.astype(int)))
