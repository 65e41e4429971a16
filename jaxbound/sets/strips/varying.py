"""Zonotopes that differ from window to window: is 0 in c + G [-1, 1]^q ?

The set lies in a strip across every direction h, |h c| <= sum_j |h g_j|, and is the intersection of the
strips whose h is orthogonal to r - 1 generators. Here the generators depend on the data, so that h does too.
Source: Ploix, Adrot 2006, (15)-(17).

**Few rows** (`strip_margins`). Up to three rows all strips are unrolled into one pass. |h g| for h
orthogonal to a and b is the determinant |a b g|: worked out once, it counts in three strips. Generators may
be parallel, zero, fewer than r - 1 or span less than R^r: where they may, unit vectors without weight stand
beside them, so that a subset that is too small is completed: one of them lies outside any plane.

**Many rows**: a search (`gauge.gauge_search`) proposes one h (`refutes`).

**Proof.** Whatever h is, a strict |h c| > sum_j |h g_j| puts 0 outside. Given |true row i - computed row i|
<= E_i over the whole box, E_i including gamma M_i, M_i = |c_i| + sum_j |g_ij|, it is enough that

    |h c| - sum_j |h g_j| > sum_i |h_i| E_i    (refutes)

as computed: gamma is that of `rounding.product_error` for the longest chain of roundings. The h of a strip of
r - 1 columns a, b, .. is taken as exact, its entries are minors; sum_i |h_i| E_i, and the rounding of the
minors with it, is at most the permanent of (|a|, |b|, .., E), which is at most e s_a s_b .. prod_i D_i with
s_a = sum_i |a_i| / D_i, for any D_i >= E_i / e.

That 0 is inside is proved by a point (`holds`): near z, with R a right inverse of G, w -> w - (c + G (z + R
w)) maps a box of w into itself, so that c + G x = 0 for some x = z + R w (Brouwer); x is in [-1, 1]^q if
there is room. The same for curved images, whose J is G at z.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import most, summed, total
from jaxbound.sets.strips.clipped import Hints, clipped_hints, explains, gram_inverse, symmetric_inverse
from jaxbound.sets.strips.gauge import gauge_search

__all__ = [
    "affine_error",
    "holds",
    "refutes",
    "right_inverse",
    "row_sizes",
    "scaled",
    "strip_count",
    "strip_margins",
    "zonotope_margins",
]

UNROLLED = {1: 300, 2: 300, 3: 60}
"""Determinants, by rows, up to which strips are written out; beyond, compiling takes longer than a search
loses.
"""
FLAT = 2.0**10
"""How many times its error the widest strip must measure for the generators to span three dimensions."""
STEPS = 6, 24
"""Steps of projections on all windows, and on what the first leave; a search for the rest."""
NEAR = 0.97
"""Gauge known after some steps from which on a window is left to a search: projections creep there."""
EASY = 2**9
"""Windows at once of which projections are made."""
AHEAD = 2
"""Blocks under way at once: more only take memory."""
BLOCK, HELD = 2**11, 2**17
"""Windows at once; a quarter where the tableaus of their search hold more numbers than HELD: they should stay
in the cache.
"""


Test: TypeAlias = tuple[jax.Array, jax.Array | int, jax.Array]
"""|h c|, sum |h g_j| and the slack of their comparison."""


def strip_count(r: int, q: int) -> int:
    """Return how many strips `strip_margins` tests for r rows and q generators, unit vectors included; 0
    where a search is to be preferred.
    """
    return math.comb(q + r, r - 1) if math.comb(q, r) <= UNROLLED.get(r, -1) else 0


def affine_error(
    c: jax.Array, G: jax.Array, c_error: jax.Array | None = None, G_error: jax.Array | None = None
) -> jax.Array:
    """Return E (r, N): at least |true row - computed row| over [-1, 1]^q, if c and G are off by up to c_error
    and G_error.

    Args:
        c, c_error: (r, N). G, G_error: (r, q, N). None: exact.
    """
    error = jnp.zeros_like(c) if c_error is None else c_error
    return (
        error
        if G_error is None
        else error + total(jnp.swapaxes(G_error, 0, 1)) * (1 + 4 * G.shape[1] * rounding.unit(c.dtype))
    )


def strip_margins(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    """Return 1 - gauge (N,) of 0 for up to three rows: < 0 is proved outside, anything else is not refuted.

    The gauge t is the factor on G at which 0 just belongs to the set, not above the true one. NaN stays NaN.

    Args:
        c (r, N), G (r, q, N), error (r, N): a bound as from `affine_error`.

    Example:
        >>> c, G = jnp.array([[1.0], [0.5]]), jnp.array([[[0.5], [0.0]], [[0.0], [1.0]]])
        >>> strip_margins(c, G, 0 * c)
        Array([-1...], dtype=float...)
    """
    return _strip_margins(c, G, error)


@kernel
def _strip_margins(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    margin = _strips(c, G, error)
    if len(c) < 3:
        return margin
    complete = lambda: jnp.where(margin > 1, jnp.minimum(1, _completed_strips(c, G, error)), margin)
    return jax.lax.cond(jnp.any(margin > 1), complete, lambda: margin)


def _strips(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    """Return the margin of all strips; in three dimensions of those that two generators fix, 2 where these
    generators may be flat.
    """
    across, unit, slack = _scales(c, G, error)
    r, q = G.shape[:2]
    g = [[G[i, j] for i in range(r)] for j in range(q)]
    tests: list[Test] = []  # (|h c|, sum |h g|, its slack)
    width: dict[object, jax.Array] = {}
    if r == 1:
        tests.append((jnp.abs(c[0]), total(jnp.abs(x[0]) for x in g), slack(1)))
    elif r == 2:
        for j in range(q):
            for k in range(j + 1, q):
                _add(width, jnp.abs(g[j][0] * g[k][1] - g[j][1] * g[k][0]), j, k)
            tests.append((jnp.abs(g[j][0] * c[1] - g[j][1] * c[0]), width.get(j, 0), slack(across[j])))
        tests += [(jnp.abs(c[i]), total(jnp.abs(x[i]) for x in g), slack(unit[1 - i])) for i in range(2)]
    else:
        for j in range(q):
            for k in range(j + 1, q):
                h = [g[j][m - 2] * g[k][m - 1] - g[j][m - 1] * g[k][m - 2] for m in range(3)]
                for i in range(k + 1, q):
                    _add(
                        width,
                        jnp.abs(h[0] * g[i][0] + h[1] * g[i][1] + h[2] * g[i][2]),
                        (j, k),
                        (j, i),
                        (k, i),
                    )
                residual = jnp.abs(h[0] * c[0] + h[1] * c[1] + h[2] * c[2])
                tests.append((residual, width.get((j, k), 0), slack(across[j] * across[k])))
    margin = _worst(tests, slack(0), c[0])
    if r < 3:
        return margin
    solid = jnp.full_like(c[0], -jnp.inf)
    for _, size, loss in tests:
        solid = jnp.maximum(solid, size - FLAT * loss)
    return jnp.where((solid > 0) | (margin < 0), margin, jnp.where(jnp.isnan(margin), margin, 2))


def _completed_strips(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    """Return the margin of the strips in three dimensions that a generator and a unit vector, or two unit
    vectors, fix.
    """
    across, unit, slack = _scales(c, G, error)
    q = G.shape[1]
    tests: list[Test] = []
    for m in range(3):
        a, b = m - 2, m - 1
        width: dict[object, jax.Array] = {}
        for j in range(q):
            for k in range(j + 1, q):
                _add(width, jnp.abs(G[a, j] * G[b, k] - G[b, j] * G[a, k]), j, k)
            tests.append(
                (jnp.abs(G[a, j] * c[b] - G[b, j] * c[a]), width.get(j, 0), slack(across[j] * unit[m]))
            )
        tests.append((jnp.abs(c[m]), total(jnp.abs(G[m, j]) for j in range(q)), slack(unit[a] * unit[b])))
    return _worst(tests, slack(0), c[0])


def _scales(c, G, error):
    """Return (s of each generator, s of each unit vector, product of s -> slack of a strip)."""
    r, q = G.shape[:2]
    sizes = (total(jnp.abs(G[i, j]) for j in range(q)) for i in range(r))
    E, M = zip(*(_with_rounding(c[i], size, error[i], r, q) for i, size in enumerate(sizes)), strict=True)
    share = most([jnp.where(m > 0, e / jnp.where(m > 0, m, 1), 0) for e, m in zip(E, M, strict=True)])
    share = jnp.where(share > 0, share, 1)
    size = [
        jnp.maximum(e / share, rounding.tiny(c.dtype) ** 0.4) for e in E
    ]  # any will do: two reciprocals should not overflow
    kappa, unit = math.prod(size) * share, [1 / m for m in size]
    floor = _floor(c.dtype, r, q) * math.prod([1 + m + e for m, e in zip(M, E, strict=True)])
    return (
        [total(jnp.abs(G[i, j]) * unit[i] for i in range(r)) for j in range(q)],
        unit,
        lambda s: kappa * s + floor,
    )


def _worst(tests: Iterable[Test], floor: jax.Array, like: jax.Array) -> jax.Array:
    excess, gauge = jnp.full_like(like, -jnp.inf), jnp.zeros_like(like)
    for residual, width, slack in tests:
        short = residual - slack
        excess = jnp.maximum(excess, short - width)
        gauge = jnp.maximum(gauge, short / (width + floor))
    return _signed(gauge, excess)


def _add(width, term, *strips):
    for strip in strips:
        width[strip] = width[strip] + term if strip in width else term


def refutes(c: jax.Array, G: jax.Array, error: jax.Array, h: jax.Array) -> jax.Array:
    """Return 1 - |h c| / sum_j |h g_j| (N,): < 0 is proof that 0 is outside, for any finite h (r, N) that is
    an array, not an expression.

    Args: as for `strip_margins`.
    """
    r, q = G.shape[:2]
    E, _ = _with_rounding(c, summed(jnp.abs, G, axes=(1,)), error, r, q)
    floor = (
        _floor(c.dtype, r, q)
        * (1 + jnp.max(jnp.abs(h), 0))
        * (1 + jnp.max(jnp.abs(c), 0) + jnp.max(jnp.abs(G), (0, 1)))
    )
    residual = jnp.abs(summed(lambda x, row: x * row, h, c))
    width = summed(jnp.abs, summed(lambda x, row: x[None] * row, h, G))
    short = residual - (summed(lambda x, e: jnp.abs(x) * e, h, E) + floor)
    return _signed(short / (width + floor), short - width)


def _with_rounding(
    c: jax.Array, size: jax.Array, error: jax.Array, r: int, q: int
) -> tuple[jax.Array, jax.Array]:
    """Return (E, M): E with the rounding of a strip test, M the size |c_i| + sum_j |g_ij|; of one row, or of
    all.
    """
    gamma, floor = rounding.product_error(q + 2 * r + 8, c.dtype)
    M = jnp.abs(c) + size
    return (1 + 2 * gamma) * error + gamma * M + floor, M


def _floor(dtype: DTypeLike, r: int, q: int) -> np.floating:
    return rounding.product_error((q + 1) * r * r, dtype)[1]


def _signed(gauge: jax.Array, excess: jax.Array) -> jax.Array:
    """Return 1 - gauge, < 0 exactly where the excess is > 0."""
    least = jnp.finfo(gauge.dtype).eps
    return jnp.where(excess > 0, jnp.minimum(1 - gauge, -least), jnp.maximum(1 - gauge, 0))


def right_inverse(J: jax.Array, z: jax.Array) -> jax.Array:
    """Return R (q, r, N), nearly J R = 1, that moves most the variables with most room in [-1, 1]; 0 where
    none was found. No claim.

    Args: J (r, q, N), z (q, N).
    """
    r, q = J.shape[:2]
    room = jnp.maximum(1 - jnp.abs(z), 0)
    size = jnp.sum(jnp.abs(J) * room[None], 1)
    scale = 1 / jnp.where(size > 0, size, 1)
    K = J * scale[:, None]
    gram = total((K[:, i] * room[i][None])[:, None] * K[:, i][None] for i in range(q))
    inverse = symmetric_inverse(gram)
    R = room[:, None] * total(K[k][:, None] * inverse[k][None] for k in range(r)) * scale[None]
    return jnp.where(jnp.isfinite(R), R, 0)


def holds(
    F: jax.Array,
    F_error: jax.Array,
    J: jax.Array,
    J_error: jax.Array,
    z: jax.Array,
    R: jax.Array,
    curvature: ArrayLike = 0.0,
) -> jax.Array:
    """Return whether an x in [-1, 1]^q near z with f(x) = 0 is proved to exist, (N,) bool.

    Args:
        F, F_error: f(z) and a bound on its error, (r, N). J, J_error: the derivative at z and a bound on its
            error, (r, q, N). z (q, N).
        R: from `right_inverse`; any will do. All these must be arrays, not expressions of the same function.
        curvature: (r, N) or a number, at least max_i |J(x) - J(z)|_i / max_i |x_i - z_i| on the box; 0 for an
            affine f.

    Proof: with w_k = 2 (size_k) max_l (|F_l| + F_error_l) / size_l, |x - z| <= |R| w and every mean
    derivative on the way from z to x is within J_error + curvature |R| w of J. If |F| + F_error + |1 - J R| w
    <= w row by row, w -> w - f(z + R w) maps the box into itself. All terms are positive: each sum is raised
    by its own relative rounding.
    """
    r, q = J.shape[:2]
    gamma, floor = rounding.product_error(q + r + 8, F.dtype)
    up = 1 + 4 * gamma
    size = jnp.sum(jnp.abs(J), 1) + jnp.abs(F) + floor
    bend = jnp.broadcast_to(jnp.asarray(curvature, F.dtype), F.shape)
    gap = (jnp.abs(F) + F_error) * up + floor
    w = jnp.max(gap / size, 0)[None] * 2 * up * size
    reach = jnp.sum(jnp.abs(R) * w[None], 1) * up + floor
    far = jnp.max(reach, 0)
    top = 1 + jnp.max(jnp.abs(R), (0, 1))
    inside = jnp.all(jnp.abs(z) + reach * up <= 1 - 4 * rounding.unit(F.dtype), 0)

    slack = gamma * jnp.abs(J) + J_error + (bend * far[None])[:, None]
    off = jnp.abs(jnp.sum(J[:, :, None] * R[None], 1) - jnp.eye(r, dtype=F.dtype)[:, :, None])
    spread = jnp.sum(slack[:, :, None] * jnp.abs(R)[None], 1)
    loss = gap + jnp.sum((off + spread + (floor * top[None] * (1 + size))[:, None]) * w[None], 1)
    return inside & jnp.all(loss * up <= w, 0)


def zonotope_margins(
    c: ArrayLike,
    G: ArrayLike,
    c_error: ArrayLike | None = None,
    G_error: ArrayLike | None = None,
    margins: str = "exact",
) -> np.ndarray:
    """Return the margin 1 - gauge (N,) of 0 in each of N zonotopes c + G [-1, 1]^q: > 0 proved inside, < 0
    proved outside, 0 unknown.

    The gauge is the factor on G at which 0 just belongs to the set. A set that is flat, or flat but for
    rounding, can be proved to miss 0, but not to hold it. NaN where a number of the window is NaN.

    Args:
        c (r, N), G (r, q, N); c_error, G_error: bounds >= 0 on the errors of their entries.
        margins: "exact", or "bounds": of the windows that a few projections decide, which is several times
            as fast, the margin is at least as far from 0 as what is returned.

    Raises:
        ValueError: shapes that do not fit, other margins.

    Source: Ploix, Adrot 2006, section 4, made rank-aware.

    Example:
        >>> import numpy as np
        >>> zonotope_margins(np.array([[1.0, 3.0], [0.0, 0.0]]), np.repeat(np.eye(2)[..., None] * 2, 2, -1))
        array([ 0.5, -0.5]...)
    """
    c, G = np.asarray(c), np.asarray(G)
    if c.ndim != 2 or G.ndim != 3 or c.shape != (G.shape[0], G.shape[2]) or not G.shape[0] or not G.shape[1]:
        raise ValueError(
            f"zonotope_margins needs c (r, N) and G (r, q, N), r and q at least 1: their shapes are "
            f"{c.shape} and {G.shape}"
        )
    errors = [
        np.zeros(x.shape, x.dtype) if e is None else np.asarray(e, x.dtype)
        for x, e in ((c, c_error), (G, G_error))
    ]
    for name, x, e in (("c_error", c, errors[0]), ("G_error", G, errors[1])):
        if e.shape != x.shape:
            raise ValueError(
                f"{name} must have the shape {x.shape} of what it bounds: its shape is {e.shape}"
            )
    if margins not in ("exact", "bounds"):
        raise ValueError(f'margins must be "exact" or "bounds", not {margins!r}')
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(c, G, np.float32))
    given = [x.astype(dtype, copy=False) for x in (c, G, *errors)]
    r, q = G.shape[:2]
    if margins == "exact":
        size = BLOCK if r * (q + r) * BLOCK <= HELD else BLOCK // 4
        return _in_blocks(_margins, given, size)
    return _easy_first(given, G_error is not None)


def _easy_first(given: list[np.ndarray], uncertain: bool) -> np.ndarray:
    """Return bounds of the margins of all windows: by a few projections, by more of them, by a search.

    uncertain: whether generators have errors.
    """
    c, G, error, G_error = given
    if uncertain:
        error = _in_blocks(affine_error_jit, given, EASY)
    out, left = np.zeros(c.shape[1], c.dtype), np.arange(c.shape[1])
    for steps in STEPS:
        out[left] = _in_blocks(partial(_projected, steps=steps), _chosen([c, G, error], left), EASY)
        left = left[out[left] == 0]
    left = np.flatnonzero(~(abs(out) > 0))
    out[left] = _in_blocks(_margins, _chosen(given, left), EASY)
    return out


def _chosen(given: list[np.ndarray], windows: np.ndarray) -> list[np.ndarray]:
    """Return the arrays of some windows; the arrays themselves where that is all."""
    if len(windows) == given[0].shape[-1]:
        return given
    return [np.take(x, windows, -1) for x in given]


def _in_blocks(judge: Callable[..., jax.Array], given: list[np.ndarray], size: int) -> np.ndarray:
    """Return the results (.., N) of a function of blocks of one size for all N windows."""
    count = given[0].shape[-1]
    judged: list[jax.Array | np.ndarray] = []
    for start in range(0, count, size):
        block = [np.ascontiguousarray(x[..., start : start + size]) for x in given]
        lacking = start + size - count
        if lacking > 0:
            block = [np.concatenate([x, np.zeros((*x.shape[:-1], lacking), x.dtype)], -1) for x in block]
        judged.append(judge(*jax.device_put(block)))  # what is contiguous is not copied again
        if len(judged) > AHEAD:
            judged[-AHEAD - 1] = np.asarray(judged[-AHEAD - 1])
    if not judged:
        return np.zeros(0, given[0].dtype)
    return np.concatenate(judged, -1)[..., :count]


def _projected(c: jax.Array, G: jax.Array, error: jax.Array, steps: int) -> jax.Array:
    """Return bounds of the margins of one block that projections prove; elsewhere 0 where more steps may
    tell, NaN where they hardly will.
    """
    return _by_hints(c, G, error, clipped_hints(c, G, steps))


@kernel
def _by_hints(c: jax.Array, G: jax.Array, error: jax.Array, hints: Hints) -> jax.Array:
    outside = refutes(c, G, error, hints.h)
    inside = explains(c, G, error, hints.gram, hints.inverse, hints.z)
    found = jnp.where(outside < 0, outside, inside)
    return jnp.where((found == 0) & (hints.low > NEAR), jnp.nan, found)


def _margins(c: jax.Array, G: jax.Array, c_error: jax.Array, G_error: jax.Array) -> jax.Array:
    """Return the margins of one block."""
    r, q = G.shape[:2]
    error, one = affine_error_jit(c, G, c_error, G_error), jnp.ones_like(c[0])
    size = row_sizes(c, G)
    h, z, _ = gauge_search(*scaled(c, G, size), one)
    outside = strip_margins(c, G, error) if strip_count(r, q) else refutes_jit(c, G, error, h / size)
    gap, z, J_error = _polished(c, G, c_error, G_error, z)
    inside = explains(c, G, error, *gram_inverse(G), z) > 0
    if not bool(jnp.all(inside | (outside < 0))):  # on the boundary, and in flat sets
        inside = inside | holds_jit(*gap, G, J_error, z, right_inverse_jit(G, z))
    return _settled(outside, inside)


@kernel
def row_sizes(c: jax.Array, G: jax.Array) -> jax.Array:
    """Return |c_i| + sum_j |g_ij| (r, N), 1 where it is 0."""
    size = jnp.abs(c) + jnp.sum(jnp.abs(G), 1)
    return jnp.where(size > 0, size, 1)


@kernel
def scaled(c: jax.Array, G: jax.Array, size: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return c and G with the rows divided by their sizes, as `gauge.gauge_search` needs them."""
    return c / size, G / size[:, None]


@kernel
def _polished(
    c: jax.Array, G: jax.Array, c_error: jax.Array, G_error: jax.Array, z: jax.Array
) -> tuple[tuple[jax.Array, jax.Array], jax.Array, jax.Array]:
    """Return ((c + G z, its error), z, error of G)."""
    r, q = G.shape[:2]
    gamma, floor = rounding.product_error(q + 2, c.dtype)
    z = jnp.clip(z, -1, 1)
    F = c + jnp.sum(G * z[None], 1)
    error = (
        affine_error(c, G, c_error, G_error)
        + gamma * (jnp.abs(c) + jnp.sum(jnp.abs(G * z[None]), 1))
        + 2 * floor
    )
    return (F, error), z, G_error


@kernel
def _settled(margin: jax.Array, inside: jax.Array) -> jax.Array:
    least = jnp.finfo(margin.dtype).eps
    return jnp.where(
        margin < 0,
        margin,
        jnp.where(inside, jnp.maximum(margin, least), jnp.where(jnp.isnan(margin), margin, 0)),
    )


refutes_jit, holds_jit, right_inverse_jit = kernel(refutes), kernel(holds), kernel(right_inverse)
affine_error_jit = kernel(affine_error)
