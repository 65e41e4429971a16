"""Long windows that are easy: least squares and a few steps prove most of them CONSISTENT.

In the words of `separation`, a window is consistent iff some d keeps the errors

    e = (z - R d, -d)                                                         outer rows, then inner ones

within their radii. The d of least squares is one fixed matrix times z, and where errors are spread it keeps
nearly all windows within their bounds; a few steps from it keep most of the others. What is left open goes to
the exchange search.

**Proof.** d is whatever floats make of it: of that very d all that is computed approximates the exact e. Its
error, whatever the compiler computes twice or contracts, is below

    on_rows S + on_inputs S_u + floor (1 + S + S_u),    S = max scale, S_u = max (|v| + |offset|),

with the numbers of `projection_of`; the exact e within the radii proves CONSISTENT.

**Steps** (`clipped_margin`). The excess of e beyond a share of the radii is projected, and d
moves by a multiple of that,

    x = e - clip(e, SHARE r),    d <- d + OVER (A'WA)^-1 A'W x,    A = (R, 1),

a step of majorisation and minimisation of |x|^2 (Hunter, Lange 2004), whose gradient is A'Wx. Where it
converges to an excess above 0, that is orthogonal to the columns of A, so h = W x of the outer rows
contradicts the window. There is nothing to factorise, no pivot, no gather; ANY d that passes is a
proof, and so is ANY h, which NumPy checks.

**Radii that differ from window to window**, as tolerances make them, need weights W of each window's own:
then (A'WA)^-1 A'W is no fixed matrix, but a small system that each window factorises once (`weighted`).

Everything is elementwise over N windows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import product, stored, summed
from jaxbound.sets.strips.weighted import TERMS, factored, solved

SHARE = 0.85
"""Part of the radii into which errors are clipped: aiming inside them, few steps reach a healthy window."""
OVER = 3.5
"""Factor on a step: few errors exceed their share, where a plain step is short."""
AHEAD = 3
"""Steps of a search of contiguous windows."""
SELDOM = 64
"""Such a search ends where at most one window in so many is left."""
STEPS = 5
"""Steps after which a window is left to the exchange search."""
CLEAR = 2.0**14
"""Distance from the boundary, in units of rounding, from which on a search decides, and beyond the bound of
its own errors: what any other search of the library proves too, so that verdicts do not depend on who is
asked.
"""
LIGHTEST = 1e-12
"""Least weight of a row in the projection, of a largest of 1."""
SAFE = 2.0
"""Factor on error bounds: for second-order terms, which are small where `MOST` holds."""
MOST = 1e-3
"""Above this share of a row's magnitude an error bound is given up: nothing is proved."""
FLUSHED = 2**20
"""More results than a window has that could each be flushed to zero."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Projection:
    """Matrices and error bounds of a projection of windows, of one frame.

    Fields: R (c, k), K (c, l); step (k, c + k), whose first c columns are P; speaks (c,): the diagonal of W
    for outer rows; off: (2,), on_rows and on_inputs; floor: see above; outer (c,), inner (k,): numbers of
    rows; weighted: whether windows have weights of their own.
    """

    R: np.ndarray
    K: np.ndarray
    step: np.ndarray
    speaks: np.ndarray
    off: np.ndarray
    floor: np.ndarray
    outer: tuple[int, ...] = field(metadata={"static": True})
    inner: tuple[int, ...] = field(metadata={"static": True})
    weighted: bool = field(metadata={"static": True})


class Rows(NamedTuple):
    """Rows of N windows for a search: mid, radius (c + k, N), the outer rows first; known (l, N); and
    scale, heaviest, known_size (N,), the largest scale, 1 / radius and |v| + |offset|.
    """

    mid: jax.Array
    radius: jax.Array
    known: jax.Array
    scale: jax.Array
    heaviest: jax.Array
    known_size: jax.Array


class Search(NamedTuple):
    """The state of a search: d (k, N), h (c, N), done (N,), steps taken."""

    d: jax.Array
    h: jax.Array
    done: jax.Array
    steps: jax.Array


def clipped_margin(given: Projection, rows: Rows, stretch: bool = False) -> tuple[jax.Array, jax.Array]:
    """Return (margin (N,), h (c, N)): a proved lower bound > 0 of the margin of windows that few steps
    explain; a margin < 0 where h speaks against the window, which is to be checked; 0 of all others.

    A window that lacks a sample of its rows is one of the others.

    Args:
        stretch: take fewer steps, none where d explains nearly all windows, and leave h 0.
    """
    R, c, radius = given.R, len(given.outer), rows.radius
    eps = jnp.finfo(radius.dtype).eps
    weight, least = stored(1 / radius), _least_squares(given, rows)
    z = stored(rows.mid[:c] - _product(R, rows.mid[c:]) - _product(given.K, rows.known))
    share = stored(SHARE * radius)
    steps, seldom = (AHEAD, SELDOM) if stretch else (STEPS, z.shape[1] + 1)

    def use(d: jax.Array) -> jax.Array:
        return jnp.max(jnp.abs(_errors(R, z, d)) * weight, 0)

    def going(carry: Search) -> jax.Array:
        return (carry.steps < steps) & (jnp.sum(~carry.done) * seldom > z.shape[1])

    def move(carry: Search) -> Search:
        e = _errors(R, z, carry.d)
        excess = stored(e - jnp.clip(e, -share, share))
        change = least.fitting(excess)
        further = stored(carry.d + OVER * change)
        if stretch:
            return Search(further, carry.h, use(further) < 1, carry.steps + 1)
        spoken = stored(least.weights[:c] * (excess[:c] - _product(R, change)))
        residual, width = _against(R, z, radius, spoken)
        reached = jnp.max(jnp.abs(e) * weight, 0) < 1 - 2 * CLEAR * eps
        done = carry.done | reached | (residual > (1 + 2 * CLEAR * eps) * width)
        h = jnp.where(carry.done[None], carry.h, spoken)
        return Search(jnp.where(done[None], carry.d, further), h, done, carry.steps + 1)

    d = least.fitting(z)
    done = use(d) < 1 if stretch else jnp.zeros_like(rows.scale, bool)
    start = d, jnp.zeros_like(z), done, jnp.zeros((), jnp.int32)
    found = jax.lax.while_loop(going, move, Search(*start))
    used, (on_rows, on_inputs), sizes = use(found.d), given.off, rows.scale + rows.known_size
    off = on_rows * rows.scale + on_inputs * rows.known_size + given.floor * (1 + sizes)
    inside = _explained(used, off * rows.heaviest, summed(jnp.abs, found.d))
    residual, width = _against(R, z, radius, found.h)
    # at a distance from the boundary at which any other search says the same, and NumPy proves it
    surely = (residual - 2 * off * summed(jnp.abs, found.h)) * (1 - CLEAR * eps)
    beyond = jnp.minimum(1 - surely / jnp.where(width > 0, width, 1), -eps)
    return jnp.where(inside > 0, inside, jnp.where(surely > width, beyond, 0)), found.h


class LeastSquares(NamedTuple):
    """The weights of least squares, (c + k, N) or of all windows (c + k, 1), and what maps errors (c + k, N)
    to the d (k, N) that fit them best.
    """

    weights: jax.Array
    fitting: Callable[[jax.Array], jax.Array]


def _least_squares(given: Projection, rows: Rows) -> LeastSquares:
    """Return the LeastSquares of windows: by one matrix, or with weights of their own."""
    if not given.weighted:
        weights = jnp.asarray(given.speaks)[:, None]
        return LeastSquares(weights, lambda x: stored(_product(given.step[:, : len(x)], x)))
    A = jnp.concatenate([given.R, jnp.eye(len(given.inner), dtype=given.R.dtype)])
    radius = rows.radius
    own = jnp.square(jnp.min(radius, 0)[None] / radius)
    weights = stored(jnp.maximum(own, jnp.finfo(radius.dtype).eps ** 0.75))
    factor = factored(A, weights)

    def fitting(x: jax.Array) -> jax.Array:
        weighted = stored(weights[: len(x)] * x)
        return solved(factor, _product(A.T[:, : len(x)], weighted))

    return LeastSquares(weights, fitting)


def _errors(R: np.ndarray, z: jax.Array, d: jax.Array) -> jax.Array:
    return jnp.concatenate([z - _product(R, d), -d])


def _explained(used: jax.Array, off: jax.Array, size: jax.Array) -> jax.Array:
    """Return the margin of windows whose errors are proved to use at most so much of their bounds; 0 of
    others.

    Args:
        size: a sum over d: a largest may leave out a NaN, a sum does not.
    """
    eps = jnp.finfo(used.dtype).eps
    margin = 1 - (used + off) * (1 + 16 * eps) - 4 * eps
    return jnp.where((size < jnp.inf) & (margin >= CLEAR * eps + off), margin, 0)


def _product(A: np.ndarray | jax.Array, x: jax.Array) -> jax.Array:
    """Return A x, its sums written out as a search needs them."""
    return product(A, x, TERMS)


def _against(R: np.ndarray, z: jax.Array, radius: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (|h z|, sum |h_j| r_j + sum |h R|_i r_i), (N,) each."""
    size = jnp.abs(jnp.concatenate([h, _product(R.T, h)]))
    return jnp.abs(summed(lambda a, b: a * b, h, z)), summed(lambda a, b: a * b, size, radius)


def projection_of(
    R: np.ndarray,
    K: np.ndarray,
    radius: np.ndarray,
    outer: Sequence[int],
    inner: Sequence[int],
    dtype: DTypeLike,
    weighted: bool = False,
) -> Projection | None:
    """Return the Projection of a frame; None where no bound on its rounding is of use.

    Args:
        R: (c, k), K (c, l): nearest to the exact ones. radius: (c + k,) >= 0, typical ones, outer rows first.
            outer, inner: numbers of rows. weighted: whether windows have weights of their own.

    Encloses: with u the unit roundoff and g(n) = SAFE n u, which bounds what a sum of n - 4 products loses
    (Higham 2002, lemma 3.1; 4 for a rounded coefficient and for what its factors lack), rows that are off by
    16 u S, or (n + 32) u of the magnitude of a sum of n samples (`Reading._summed`), and

        z            E_z = (18 u + g(k + l)) ((1 + |R|) S + |K| S_u)
        e            E_z + g(k) (|z| + |R| S) and 16 u S for the radius, for d within the radii
        h z - width  E_z + (g(c) + 20 u) |z| + (1 + |R|) (16 u + 2 g(c) + 2 g(k)) S, in units of sum |h|

    each at most a number times S and one times S_u; |A| is the largest row sum.
    """
    c, k = R.shape
    u = float(rounding.unit(dtype))
    size = np.maximum(np.asarray(radius, np.float64), LIGHTEST * max(np.max(radius), 1e-300))
    weight = np.maximum((size.min() / size) ** 2, LIGHTEST)
    A = np.concatenate([R.astype(np.float64), np.eye(k)])
    step = np.linalg.solve((A.T * weight) @ A, A.T * weight).astype(dtype)
    through, back, known = _row_sum(R), _row_sum(step), _row_sum(K)
    g, g_k, g_c = _lost(k + K.shape[1], u), _lost(k, u), _lost(c, u)
    z, on_rows = np.array([1 + through, known]), np.array([1.0, 0.0])  # on S, on S_u
    e_z = (18 * u + g) * z
    explained = e_z + g_k * (z + through * on_rows) + 16 * u * on_rows
    spoken = e_z + (g_c + 20 * u) * z + (1 + through) * (16 * u + 2 * g_c + 2 * g_k) * on_rows
    off = np.maximum(explained, spoken)
    if not np.isfinite(back) or not (off <= MOST * (1 + z)).all():
        return None
    floor = (
        FLUSHED * float(rounding.tiny(dtype)) * (1 + through) ** 2 * (1 + back) * (1 + known) * (2 + c + k)
    )
    return Projection(
        R,
        K,
        step,
        weight[:c].astype(dtype),
        (SAFE * off).astype(dtype),
        np.asarray(floor, dtype),
        tuple(outer),
        tuple(inner),
        weighted,
    )


def _lost(terms: int, u: float) -> float:
    return SAFE * (terms + 4) * u


def _row_sum(A: np.ndarray) -> float:
    return float(np.abs(A.astype(np.float64)).sum(1).max(initial=0)) * (1 + 1e-6)
