"""Verdicts on windows of a model with uncertain parameters: refuted by strips or at vertices, explained by a point, else bisected.

A window is a system of polynomials p(v, e) = 0 in parameters v and noises e within [-1, 1] (`PolynomialReading.polynomials`).

FAULT: a direction separates 0 from a zonotope around all values of p, each neglected monomial a variable of its own, or 0 is outside the
range of a single multi-affine relation. CONSISTENT: a zero of p is proved to exist near a point that a search found, or the range of a
single relation has both signs; both need relations that are proved to say all. What is neither is UNDECIDED; `paving` cuts the box of
parameters until one of the two proofs holds on every part.

A window that lacks samples is tested by relations made for it: those without the lost rows, the lost inputs being unknown.

Source: Ploix, Adrot 2006, sections 3-4; golden "Sound test".
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import gather
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Verdicts, explore
from jaxbound.sets.strips import polynomials, varying
from jaxbound.sets.strips.gauge import gauge_search

__all__ = [
    "BLOCK", "LEAST", "VERTICES", "at_vertices", "bisected", "cases", "explained", "farthest", "finite", "image_of", "judged_by",
    "judged_whole", "on_boxes", "on_whole", "samples_of", "terms_of",
]  # fmt: skip

BLOCK = 2**11
VERTICES = 8
"""Variables up to which the vertices of the box are enumerated."""
PATTERNS = 64
"""Patterns of missing samples for which relations are made."""
NEWTON = 4
LEAST = 1e-6


def cases(relations: Any, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Iterator[tuple[Any, np.ndarray]]:
    """Yield (relations, numbers of the windows that they fit): windows that lack the same samples lack the same rows and inputs.

    Beyond `PATTERNS` patterns, the rarest windows come with None. Windows that have no relation left are not mentioned.
    """
    if not len(starts):
        return
    inputs, outputs = (
        np.isnan(x).reshape(-1, len(starts)).T for x in gather(u, y, starts, relations.reading(y.dtype).window.lags, relations.horizon)
    )
    lost, rows = np.concatenate([outputs, inputs], 1), outputs.shape[1]
    whole = ~lost.any(1)
    if whole.any():
        yield relations, np.flatnonzero(whole)
    broken = np.flatnonzero(~whole)
    if not len(broken):
        return
    patterns, which, often = np.unique(lost[broken], axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(-often, kind="stable")
    rare = np.isin(which.ravel(), order[PATTERNS:])
    if rare.any():
        yield None, broken[rare]
    for number in order[:PATTERNS]:
        case = relations.without(*(set(np.flatnonzero(x).tolist()) for x in np.split(patterns[number], [rows])))
        if case is not None:
            yield case, broken[which.ravel() == number]


def samples_of(test: Any, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Any:
    """Return the samples (lags, m, N) and (s + 1, p, N) of windows; unneeded ones that are missing become 0."""
    return finite(gather(u, y, starts, test.window.lags, test.horizon))


def finite(windows: Any) -> Any:
    """Return samples with 0 for those that are missing, and not needed."""
    return tuple(np.nan_to_num(x, nan=0.0, posinf=np.inf, neginf=-np.inf) for x in windows)


def judged_by(relations: Any, method: str) -> str:
    """Return how a block is judged: "vertices", "zonotope", "linearised" or "box"."""
    if method in ("linearised", "box"):
        return method
    exact = relations.count == 1 and polynomials.multiaffine(relations.exponents) and len(relations.variables) <= VERTICES
    return "vertices" if exact else "zonotope"


def judged_whole(test: Any, samples: Any, kind: str, proved: bool, allowance: Any) -> Any:
    """Return (status, margin) of a block of windows."""
    terms = terms_of(test, *samples)
    if kind == "vertices":
        margin, inside = at_vertices(test, *terms)
        return _status(margin, inside & proved), margin
    if kind == "box":
        return _box(test, *terms, proved)
    if kind == "linearised":
        linear = image_of(test, *terms, True, allowance)
        margin = varying.strip_margins(*linear) if varying.strip_count(*linear[1].shape[:2]) else outside(*linear)[0]
        return jnp.where(jnp.isnan(margin), Status.MISSING, Status.UNDECIDED).astype(jnp.int8), margin
    margin, start, _ = on_whole(test, terms)
    inside = explained(test, terms, start) if proved else margin < -np.inf
    return _status(margin, inside), jnp.where(inside, jnp.maximum(margin, LEAST), margin)


def _noise_part(test, z):
    """Return the noises among the columns of an image."""
    m, lumps = len(test.noisy), len(test.N) if test.noisy and len(test.exponents) > 1 else 0
    return z[len(z) - lumps - m : len(z) - lumps]


@jax.jit
def _status(margin, inside):
    decided = jnp.where(margin < 0, Status.FAULT, jnp.where(inside, Status.CONSISTENT, Status.UNDECIDED))
    return jnp.where(jnp.isnan(margin), Status.MISSING, decided).astype(jnp.int8)


@jax.jit
def terms_of(test: Any, u: Any, y: Any) -> Any:
    """Return (value, spread, rad, error): a window's polynomials, and one bound on the error of each row."""
    value, error, spread, rad = test.polynomials(u, y)
    return value, spread, rad, polynomials.row_error(value, error, spread, rad, test.exponents)


@partial(jax.jit, static_argnums=5)
def image_of(test: Any, value: Any, spread: Any, rad: Any, error: Any, linear: bool, allowance: Any) -> Any:
    """Return (c, G, error) of the whole box of parameters; linear: with `allowance` as a generator of its own in each row."""
    c, G = polynomials.image(value, spread, rad, test.exponents, linear=linear)
    if linear:
        own = jnp.broadcast_to(jnp.asarray(allowance, c.dtype), (len(c),))[:, None] * jnp.ones_like(c)
        G = jnp.concatenate([G, *[jnp.where(jnp.arange(len(c))[:, None] == k, own, 0)[:, None] for k in range(len(c))]], 1)
    return c, G, error


@jax.jit
def at_vertices(test: Any, value: Any, spread: Any, rad: Any, error: Any) -> Any:
    """Return (margin, inside) of a single multi-affine relation: see `polynomials.vertex_margin`."""
    return polynomials.vertex_margin(value, spread, rad, test.exponents, error)


@partial(jax.jit, static_argnums=5)
def _box(test, value, spread, rad, error, proved):
    """Return (status, margin) where each relation is tested alone: by its vertices if it has few, else by the sum of all its parts."""
    few = polynomials.multiaffine(test.exponents) and len(test.size) <= VERTICES
    worst, all_inside = None, None
    for k in range(value.shape[0]):
        row = slice(k, k + 1)
        if few:
            margin, inside = polynomials.vertex_margin(value[row], spread[row], rad, test.exponents, error[row])
        else:
            margin = varying.strip_margins(*polynomials.image(value[row], spread[row], rad, test.exponents), error[row])
            inside = jnp.zeros_like(margin, bool)
        worst = margin if worst is None else jnp.minimum(worst, margin)
        all_inside = inside if all_inside is None else all_inside & inside
    return _status(worst, all_inside & (proved and value.shape[0] == 1)), worst


def outside(c: jax.Array, G: jax.Array, error: jax.Array) -> tuple[jax.Array, ...]:
    """Return (margin, z, h): < 0 is a proof; z a candidate for a point, h for a direction."""
    h, z = farthest(c, G)
    if varying.strip_count(*G.shape[:2]):
        return varying.strip_margins(c, G, error), z, h
    return varying.refutes_jit(c, G, error, h), z, h


def farthest(c: jax.Array, G: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (h, z), candidates for a direction and a point: see `gauge_search`."""
    size = varying.row_sizes(c, G)
    h, z, _ = gauge_search(*varying.scaled(c, G, size), jnp.ones_like(c[0]))
    return h / size, z


def explained(test: Any, terms: Any, z: jax.Array) -> jax.Array:
    """Return where a zero near z, or near the middle, is proved to exist."""
    found: Any = False
    for start in (z, 0 * z):
        z = start
        for _ in range(NEWTON):
            z = _newton(test, *terms, z)
        p, J, bend, p_error, J_error = _slopes(test, *terms, z)
        found = found | varying.holds_jit(p, p_error, J, J_error, z, varying.right_inverse_jit(J, z), bend)
    return found


@jax.jit
def _newton(test, value, spread, rad, error, z):
    """Move z towards a zero, within the box."""
    p, J, _ = polynomials.slopes(value, spread, rad, test.exponents, z)
    R = varying.right_inverse(J, z)
    return jnp.clip(z - sum(R[:, k] * p[k][None] for k in range(len(p))), -1, 1)


@jax.jit
def _slopes(test, value, spread, rad, error, z):
    p, J, bend = polynomials.slopes(value, spread, rad, test.exponents, z)
    order = max(1, *map(sum, test.exponents))
    return p, J, bend, error, jnp.broadcast_to((order * error)[:, None], J.shape)


def bisected(test: Any, samples: Any, proved: bool, budget: int) -> np.ndarray:
    """Return the status of windows by bisection of their parameters."""
    count, n = samples[1].shape[-1], len(test.size)
    filled = power(max(count, 128))
    samples = [np.concatenate([x, np.repeat(x[..., :1], filled - count, -1)], -1) for x in samples]
    terms, on_device = terms_of(test, *samples), jax.device_put(test)
    judge = lambda lo, hi, owner: _boxes(on_device, terms, lo, hi, owner, proved)
    one = np.ones(n, samples[1].dtype)
    sizes = (2**7, BLOCK) if count <= 2**7 else (BLOCK,)  # what is compiled already serves many windows best
    found = explore(judge, -one, one, count, 200, budget, "kernel", first=True, sizes=sizes)
    status = np.where(np.bincount(found.owner, minlength=count) == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
    status[found.proofs[2]] = Status.CONSISTENT
    return status


def _boxes(test, terms, lo, hi, owner, proved):
    """Return the Verdicts on boxes of parameters (n, N), of windows `owner`."""
    terms, mid, radius = _gathered(*terms, lo, hi, owner)
    margin, start, _, axis = on_boxes(test, terms, mid, radius)
    keep = ~(margin < 0)
    if not proved:
        return Verdicts(np.asarray(keep), axis=np.asarray(axis))
    found = explained(test, terms, start)
    return Verdicts(keep & ~found, found, (mid, mid), None, axis)


def on_boxes(test: Any, terms: Any, mid: Any, radius: Any) -> tuple:
    """Return (margin, start, h, axis) of boxes mid +- radius (n, N) and the terms of their windows.

    margin < 0 is a proof; start (v, e) and h are candidates for a point and a direction; axis is where to cut.
    """
    c, G, axis = _box_image(test, *terms, mid, radius)
    margin, z, h = outside(c, G, terms[3])
    return margin, jnp.concatenate([jnp.clip(mid + radius * z[: len(mid)], -1, 1), _noise_part(test, z)]), h, axis


def on_whole(test: Any, terms: Any) -> tuple:
    """Return (margin, start, h) of the whole box of parameters: see `on_boxes`."""
    margin, z, h = outside(*image_of(test, *terms, False, 0.0))
    return margin, jnp.concatenate([z[: len(test.size)], _noise_part(test, z)]), h


@jax.jit
def _gathered(value, spread, rad, error, lo, hi, owner):
    mid = 0.5 * (lo + hi)
    radius = jnp.maximum(hi - mid, mid - lo) * (1 + 4 * jnp.finfo(lo.dtype).eps)
    return (value[..., owner], spread, rad[..., owner], error[..., owner]), mid, radius


@jax.jit
def _box_image(test, value, spread, rad, error, mid, radius):
    c, G = polynomials.image(value, spread, rad, test.exponents, mid, radius)
    return c, G, jnp.argmax(polynomials.bends(value, test.exponents, radius), 0)
