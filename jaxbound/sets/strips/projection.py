"""Long windows that are easy: one fixed projection proves most of them CONSISTENT.

In the words of `separation`, a window is consistent iff some d keeps the errors

    e = (z - R d, -d)                                                         outer rows, then inner ones

within their radii. The d of least squares is one fixed matrix times z, d = P z, and where errors are spread
it keeps nearly all windows within their bounds. Nothing is searched, nothing gathered: what is left open goes
to the exchange search.

**z without the inputs' matrix.** Let f be the answer of the plant at rest to the inputs of the window. Then
rows - f follow from an initial state alone, so z = (m - f)_outer - R (m - f)_inner. An output of f is a fixed
combination of some outputs just before it and of the inputs since: a recursion of few terms, where rows of K
have one for every input of the window.

**Proof.** P is whatever its floats are, so d* = P z* is a point for the exact z*, and all that is computed
approximates the exact e* = (z* - R d*, -d*). Its error, whatever the compiler computes twice or contracts, is
below

    on_rows S + on_inputs S_u + floor (1 + S + S_u),    S = max scale, S_u = max (|v| + |offset|),

with the numbers of `projection_of`; e* within the radii proves CONSISTENT.

**What it leaves open** (`clipped_margin`). The excess of e beyond a share of the radii is projected, and d
moves by a multiple of that,

    x = e - clip(e, SHARE r),    d <- d + OVER (A'WA)^-1 A'W x,    A = (R, 1),

a step of majorisation and minimisation of |x|^2 (Hunter, Lange 2004), whose gradient is A'Wx. Where it
converges to an excess above 0, that is orthogonal to the columns of A, so h = W x of the outer rows
contradicts the window. There is nothing to factorise, no pivot, no gather; ANY d that passes is a
proof, and so is ANY h, which NumPy checks.

**Radii that differ from window to window**, as tolerances make them, need weights W of each window's own:
then (A'WA)^-1 A'W is no fixed matrix, but a small system that each window factorises once (`weighted`).

Everything is elementwise over N windows: the projection in lists of columns, which a compiler fuses into one
loop, the search in arrays, of which many uses are made.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import most, product, stored, summed, total
from jaxbound.sets.strips.weighted import TERMS, factored, solved

__all__ = [
    "Columns",
    "Forced",
    "Projection",
    "Rows",
    "WindowColumns",
    "clipped_margin",
    "forced_outputs",
    "projected_margin",
    "projection_of",
]

Columns: TypeAlias = Sequence[jax.Array]
WRITTEN_OUT = 256
"""Entries of a matrix up to which a product is written out term by term."""
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
class Forced:
    """The answer f of outputs to inputs from rest, as a recursion.

    Fields: first (J p, J m): f of the first J samples on their inputs; own (p, b): each later f on the
    `basis` of the J samples before it; driven (p, (J + 1) m): on the inputs since the first of these; basis:
    (sample of these, output), b of them; order: J; direct: 1 where an input acts on outputs at once, else 0.
    """

    first: np.ndarray
    own: np.ndarray
    driven: np.ndarray
    basis: tuple[tuple[int, int], ...] = field(metadata={"static": True})
    order: int = field(metadata={"static": True})
    direct: int = field(metadata={"static": True})


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Projection:
    """Matrices and error bounds of a projection of windows, of one frame.

    Fields: R (c, k), K (c, l); step (k, c + k), whose first c columns are P; speaks (c,): the diagonal of W
    for outer rows; forced: None where no input acts; projected, searched: (2,), on_rows and on_inputs of the
    error bound of e for d*, and of e and h z for any d within the radii and any h; floor: see above; outer
    (c,), inner (k,): numbers of rows; weighted: whether windows have weights of their own.
    """

    R: np.ndarray
    K: np.ndarray
    step: np.ndarray
    speaks: np.ndarray
    forced: Forced | None
    projected: np.ndarray
    searched: np.ndarray
    floor: np.ndarray
    outer: tuple[int, ...] = field(metadata={"static": True})
    inner: tuple[int, ...] = field(metadata={"static": True})
    weighted: bool = field(metadata={"static": True})


class WindowColumns(NamedTuple):
    """Rows of N windows for a projection: columns (N,), or scalars that are the same in all windows.

    Fields: mid, weight: of the outer rows, then of the inner ones, mid less f, weight = 1 / radius; scale,
    heaviest, known: (N,), the largest scale, weight and |v| + |offset|.
    """

    mid: Columns
    weight: Columns
    scale: jax.Array
    heaviest: jax.Array
    known: jax.Array


def projected_margin(given: Projection, columns: WindowColumns) -> jax.Array:
    """Return a proved lower bound > 0 of the margin (N,) of windows that the d of least squares explains; 0
    of all others.

    A window that lacks a sample of its rows is one of the others.
    """
    c = len(given.outer)
    z = _less(columns.mid[:c], _times(given.R, columns.mid[c:]))
    d = _times(given.step[:, :c], z)
    errors = [*_less(z, _times(given.R, d)), *d]
    used = most([jnp.abs(e) * weight for e, weight in zip(errors, columns.weight, strict=True)])
    off = _off(given, given.projected, columns.scale, columns.known)
    return _explained(used, off * columns.heaviest, jnp.abs(total(d)))


def _off(given: Projection, bound: np.ndarray, scale: jax.Array, known: jax.Array) -> jax.Array:
    """Return an error bound (N,)."""
    return bound[0] * scale + bound[1] * known + given.floor * (1 + scale + known)


def _less(a: Columns, b: Columns) -> list[jax.Array]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _times(A: np.ndarray | jax.Array, x: Columns) -> list[jax.Array]:
    """Return the columns A x, each added up in order: written out, or in loops where A is large."""
    rows, count = A.shape
    if rows * count <= WRITTEN_OUT:
        return [total([A[j, i] * x[i] for i in range(count)]) for j in range(rows)]
    stacked = jnp.stack(jnp.broadcast_arrays(*x))
    product = summed(lambda column, row: column[:, None] * row[None], A, stacked, axes=(1, 0))
    return list(product)


def forced_outputs(
    given: Forced, inputs: Sequence[Columns], driven: Sequence[Columns]
) -> list[list[jax.Array]]:
    """Return f, the columns of each output at each sample: [sample][output].

    Args:
        inputs: of the first J samples, [sample][input]. driven: for each later sample what the inputs add,
            [sample][output].
    """
    outputs = len(given.own)
    f: list[list[jax.Array]] = []
    for j in range(min(given.order, len(inputs) + 1 - given.direct)):
        terms = [v for now in inputs[: j + given.direct] for v in now]
        if not terms:
            f.append([jnp.zeros(())] * outputs)
            continue
        f.append(_times(given.first[j * outputs : (j + 1) * outputs, : len(terms)], terms))
    for later, added in enumerate(driven):
        before = [f[later + j][i] for j, i in given.basis]
        f.append([x + y for x, y in zip(added, _times(given.own, before), strict=True)])
    return f


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
    z = stored(_relations(given, rows.mid, rows.known))
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
    used, off = use(found.d), _off(given, given.searched, rows.scale, rows.known_size)
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


def _relations(given: Projection, mid: jax.Array, known: jax.Array) -> jax.Array:
    """Return z (c, N) of rows."""
    c = len(given.outer)
    return mid[:c] - _product(given.R, mid[c:]) - _product(given.K, known)


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
    forced: Forced | None,
    samples: int,
    dtype: DTypeLike,
    spread: float = 1.0,
    terms: int = 1,
    weighted: bool = False,
) -> Projection | None:
    """Return the Projection of a frame; None where no bound on its rounding is of use.

    Args:
        R: (c, k), K (c, l): nearest to the exact ones. radius: (c + k,) >= 0, typical ones, outer rows first.
            outer, inner: numbers of rows. forced: f. samples: of a window. spread, terms: of the largest sum
            in a row, the sum of |weights|, and how many these are. weighted: whether windows have weights of
            their own.

    Encloses: with u the unit roundoff and g(n) = SAFE n u, which bounds what a sum of n - 4 products loses
    (Higham 2002, lemma 3.1; 4 for a rounded coefficient and for what its factors lack):

        f   E_f <= G (g(driven terms) D S_u + g(own terms) a F S_u), F = G D bounds |f| / S_u;
            D, a: largest sums of |driven| (or |first|) and |own| in a row, G: of the answer of the recursion
            to what is added at each sample
        f   of a row that weighs n samples with the sum of |weights| w: w (E_f + g(n) F S_u), at most w F S_u
        m   16 u S and 2 u (|m| + |f|) for the difference: e_v; of a sum of samples, off by (n + 4) u of their
            magnitude and its radius by (n + 8) u, 16 u S is (n + 32) u of it (`Reading._summed`)
        z   (1 + |R|) e_v + g(k) (1 + |R|) V, V = S + F S_u
        d   |P| E_z + g(c) |P| |z|
        e   E_z + |R| E_d + g(k) (|z| + |R| |d|) and 16 u S for the radius

    of a search, where z has the terms of R and K: E_z = (18 u + g(k + l)) ((1 + |R|) S + |K| S_u),

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
    loss, grown = _forced_loss(forced, samples, u)
    if terms > 1:
        loss, grown = spread * (loss + _lost(terms, u) * grown), spread * grown
    through, back = _row_sum(R), _row_sum(step)
    if not np.isfinite(grown) or not np.isfinite(back):
        return None
    g_k, g_c = _lost(k, u), _lost(c, u)
    V = np.array([1.0, grown])  # on S, on S_u
    e_v = np.array([16 * u, loss]) + 2 * u * V
    z = (1 + through) * V
    e_z = (1 + through) * e_v + g_k * z
    d = back * z
    e_d = back * e_z + g_c * d
    own = np.array([16 * u, 0.0])  # of a radius, which is not above the scale
    projected = e_z + (1 + through) * e_d + g_k * (z + through * d) + own
    K_sum, g = _row_sum(K), _lost(k + K.shape[1], u)
    z = np.array([1 + through, K_sum])
    e_z = (16 * u + g) * z + 2 * u * z
    explained = e_z + g_k * (z + through * np.array([1.0, 0.0])) + own
    spoken = e_z + (g_c + 20 * u) * z + (1 + through) * (own + 2 * (g_c + g_k) * np.array([1.0, 0.0]))
    searched = np.maximum(explained, spoken)
    if not (np.maximum(projected, searched) <= MOST * (1 + z + d + V)).all():
        return None
    floor = (
        FLUSHED
        * float(rounding.tiny(dtype))
        * (1 + through) ** 2
        * (1 + back)
        * (1 + grown + _row_sum(K))
        * (2 + c + k)
    )
    return Projection(
        R,
        K,
        step,
        weight[:c].astype(dtype),
        forced,
        (SAFE * projected).astype(dtype),
        (SAFE * searched).astype(dtype),
        np.asarray(floor, dtype),
        tuple(outer),
        tuple(inner),
        weighted,
    )


def _forced_loss(forced: Forced | None, samples: int, u: float) -> tuple[float, float]:
    """Return (E_f, F) in units of S_u; infinite where the recursion loses too much."""
    if forced is None:
        return 0.0, 0.0
    outputs, terms = len(forced.own), len(forced.basis)
    gain = _answer(forced, samples, outputs)
    driven = max(_row_sum(forced.first), _row_sum(forced.driven))
    lost, own = _lost(terms, u), _row_sum(forced.own)
    grown = gain * driven
    if not gain * lost * own < MOST:
        return np.inf, np.inf
    inputs = max(forced.first.shape[1], forced.driven.shape[1])
    return gain * (_lost(inputs, u) * driven + lost * own * SAFE * grown), SAFE * grown


def _answer(forced: Forced, samples: int, outputs: int) -> float:
    """Return the largest sum of magnitudes with which f at a sample answers to what is added at each one."""
    rows = [np.zeros((outputs, samples * outputs)) for _ in range(samples)]
    for j in range(samples):
        rows[j][:, j * outputs : (j + 1) * outputs] = np.eye(outputs)
        if j >= forced.order:
            before = np.stack([rows[j - forced.order + a][i] for a, i in forced.basis])
            rows[j] = rows[j] + forced.own.astype(np.float64) @ before
    return 1.01 * max(np.abs(row).sum(1).max() for row in rows)


def _lost(terms: int, u: float) -> float:
    return SAFE * (terms + 4) * u


def _row_sum(A: np.ndarray) -> float:
    return float(np.abs(A.astype(np.float64)).sum(1).max(initial=0)) * (1 + 1e-6)
