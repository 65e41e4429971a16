"""Verdicts on windows of a model with uncertain parameters: refuted by strips or at vertices, explained by a
point, else bisected.

A window is a system of polynomials p(v, e) = 0 in parameters v and noises e within [-1, 1]
(`PolynomialReading.polynomials`).

FAULT: a direction separates 0 from a zonotope around all values of p, each neglected monomial a variable of
its own, or 0 is outside the range of a single multi-affine relation. CONSISTENT: a zero of p is proved to
exist near a point that a search found, or the range of a single relation has both signs; both need relations
that are proved to say all. What is neither is UNDECIDED; `paving` cuts the box of parameters until one of the
two proofs holds on every part.

A window that lacks samples is tested by relations made for it: those without the lost rows, the lost inputs
being unknown. All that are no more than those of a whole window, in monomials that the loss of one sample
brings about, share one compiled shape.

Source: Ploix, Adrot 2006, sections 3-4; golden "Sound test".
"""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import gather
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Verdicts, explore
from jaxbound.sets.strips import polynomials, varying
from jaxbound.sets.strips.gauge import gauge_search

__all__ = [
    "BLOCK",
    "LEAST",
    "SEARCHED",
    "VERTICES",
    "at_vertices",
    "bisected",
    "candidates",
    "cases",
    "concluded",
    "farthest",
    "finite",
    "judged_by",
    "judged_whole",
    "linear_image",
    "on_boxes",
    "on_whole",
    "samples_of",
    "terms_of",
]

BLOCK = 2**11
"""Windows at once where each relation is a formula."""
SEARCHED = 2**9
"""Windows or boxes at once where directions and points are searched for: what a processor keeps close."""
VERTICES = 8
"""Variables up to which the vertices of the box are enumerated."""
PATTERNS = 64
"""Patterns of missing samples for which relations are made."""
NEWTON = 7
"""Steps of Newton's method; beyond them hardly anything more is proved."""
SHARE = 0.99
"""How far towards a side of the box one of them may go."""
LEAST = 1e-6


def cases(
    relations: Any, u: np.ndarray, y: np.ndarray, starts: np.ndarray
) -> Iterator[tuple[Any, np.ndarray]]:
    """Yield (relations, numbers of the windows that they fit): windows that lack the same samples lack the
    same rows and inputs.

    Beyond `PATTERNS` patterns, the rarest windows come with None. Windows that have no relation left are not
    mentioned.
    """
    if not len(starts):
        return
    inputs, outputs = (
        np.isnan(x).reshape(-1, len(starts)).T
        for x in gather(u, y, starts, relations.reading(y.dtype).window.lags, relations.horizon)
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
        case = relations.without(
            *(set(np.flatnonzero(x).tolist()) for x in np.split(patterns[number], [rows]))
        )
        if case is not None:
            yield case, broken[which.ravel() == number]


def samples_of(test: Any, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Any:
    """Return the samples (lags, m, N) and (s + 1, p, N) of windows; unneeded ones that are missing become
    0.
    """
    return finite(gather(u, y, starts, test.window.lags, test.horizon))


def finite(windows: Any) -> Any:
    """Return samples with 0 for those that are missing, and not needed."""
    return tuple(np.nan_to_num(x, nan=0.0, posinf=np.inf, neginf=-np.inf) for x in windows)


def judged_by(relations: Any, method: str) -> str:
    """Return how a block is judged: "vertices", "zonotope", "linearized" or "box"."""
    if method in ("linearized", "box"):
        return method
    exact = (
        relations.count == 1
        and polynomials.multiaffine(relations.exponents)
        and len(relations.variables) <= VERTICES
    )
    return "vertices" if exact else "zonotope"


def judged_whole(test: Any, samples: Any, kind: str, proved: bool, allowance: Any) -> Any:
    """Return (status, margin) of a block of windows."""
    terms = terms_of(test, *samples)
    if kind == "vertices":
        return at_vertices(test, terms, proved)
    if kind == "box":
        return _box(test, terms, proved)
    if kind == "linearized":
        return _suspected(test, *_linear(test, terms, allowance))
    return on_whole(test, terms, proved)[:2]


def _noise_part(test, z):
    """Return the noises among the columns of an image."""
    m = len(test.noisy) + (0 if test.spare is None else len(test.spare))
    lumps = len(test.N) if m and len(test.exponents) > 1 else 0
    return z[len(z) - lumps - m : len(z) - lumps]


def _status(margin, inside):
    decided = jnp.where(margin < 0, Status.FAULT, jnp.where(inside, Status.CONSISTENT, Status.UNDECIDED))
    return jnp.where(jnp.isnan(margin), Status.MISSING, decided).astype(jnp.int8)


@kernel
def terms_of(test: Any, u: Any, y: Any) -> Any:
    """Return (value, spread, rad, error): a window's polynomials, and one bound on the error of each row."""
    value, error, spread, rad = test.polynomials(u, y)
    return value, spread, rad, polynomials.row_error(value, error, spread, rad, test.exponents)


def linear_image(test: Any, terms: Any, allowance: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (c, G, error) of the whole box of parameters without all that is of order 2; `allowance` is a
    generator in each row.
    """
    value, spread, rad, error = terms
    c, G = polynomials.image(value, spread, rad, test.exponents, linear=True)
    own = jnp.broadcast_to(jnp.asarray(allowance, c.dtype), (len(c),))[:, None] * jnp.ones_like(c)
    return (
        c,
        jnp.concatenate([G, jnp.where(np.eye(len(c), dtype=bool)[:, :, None], own[:, None], 0)], 1),
        error,
    )


@kernel
def _linear(test, terms, allowance):
    """Return (c, G, error, h) of the linearized test: see `linear_image`."""
    c, G, error = linear_image(test, terms, allowance)
    r, q, _ = G.shape
    return c, G, error, None if varying.strip_count(r, q, alone=True) else farthest(c, G)[0]


@kernel
def _suspected(test, c, G, error, h):
    margin = _outside(c, G, error, h)
    return jnp.where(jnp.isnan(margin), Status.MISSING, Status.UNDECIDED).astype(jnp.int8), margin


@kernel
def at_vertices(test: Any, terms: Any, proved: Any) -> tuple[jax.Array, jax.Array]:
    """Return (status, margin) of a single multi-affine relation: see `polynomials.vertex_margin`."""
    value, spread, rad, error = terms
    margin, inside = polynomials.vertex_margin(value, spread, rad, test.exponents, error)
    return _status(margin, inside & proved), margin


@kernel
def _box(test, terms, proved):
    """Return (status, margin) where each relation is tested alone: by its vertices if it has few, else by the
    sum of all its parts.
    """
    value, spread, rad, error = terms
    few = polynomials.multiaffine(test.exponents) and len(test.size) <= VERTICES
    worst = jnp.full_like(value[0, 0], jnp.inf)
    inside = jnp.asarray(proved) & (value.shape[0] == 1)
    for k in range(value.shape[0]):
        row = slice(k, k + 1)
        if few:
            margin, holds = polynomials.vertex_margin(
                value[row], spread[row], rad, test.exponents, error[row]
            )
            inside = inside & holds
        else:
            margin = varying.strip_margins(
                *polynomials.image(value[row], spread[row], rad, test.exponents), error[row]
            )
            inside = inside & False
        worst = jnp.minimum(worst, margin)
    return _status(worst, inside), worst


def _outside(c, G, error, h):
    """Return the margin, < 0 is a proof: by all strips where they are few or h is None, else by the direction
    h, an array.
    """
    few = h is None or varying.strip_count(*G.shape[:2])
    return varying.strip_margins(c, G, error) if few else varying.refutes(c, G, error, h)


def farthest(c: jax.Array, G: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (h, z), candidates for a direction and a point: see `gauge_search`."""
    size = varying.row_sizes(c, G)
    h, z, _ = gauge_search(*varying.scaled(c, G, size), jnp.ones_like(c[0]))
    return h / size, z


@kernel
def candidates(test: Any, terms: Any, mid: Any, radius: Any, owner: Any) -> tuple:
    """Return (terms, c, G, h, start, axis) of boxes mid +- radius (n, N) of windows `owner`: what `concluded`
    proves something by.

    The image is c + G [-1, 1]^q, up to the error; start (v, e) and h are candidates for a point and a
    direction; axis is where to cut.
    """
    value, spread, rad, error = terms
    value, rad, error = value[..., owner], rad[..., owner], error[..., owner]
    c, G = polynomials.image(value, spread, rad, test.exponents, mid, radius)
    h, z = farthest(c, G)
    start = jnp.concatenate([jnp.clip(mid + radius * z[: len(mid)], -1, 1), _noise_part(test, z)])
    return (
        (value, spread, rad, error),
        c,
        G,
        h,
        start,
        jnp.argmax(polynomials.bends(value, test.exponents, radius), 0),
    )


@kernel
def concluded(
    test: Any, terms: Any, c: jax.Array, G: jax.Array, h: jax.Array, start: jax.Array, proved: Any
) -> tuple[jax.Array, ...]:
    """Return (status, margin, found, open) of boxes: refuted by a direction or strips, explained by a zero
    near a start.

    Everything is an array here, so that the compiler cannot round a candidate anew for each of its uses.
    proved: whether the relations say all, so that a zero is an explanation.
    """
    margin = _outside(c, G, terms[3], h)
    found = _explained(test, terms, start, proved & (margin >= 0))
    return (
        _status(margin, found),
        jnp.where(found, jnp.maximum(margin, LEAST), margin),
        found,
        ~(margin < 0) & ~found,
    )


def _explained(test, terms, start, wanted):
    """Return where a zero is proved to exist near start, among the windows where that is wanted.

    Newton's method moves a point towards a zero and never onto the sides of the box, where it would have no
    room left. It is carried by a loop, so that values, slopes and proof are of one point.
    """
    value, spread, rad, error = terms
    order = max(1, *map(sum, test.exponents))

    def newton(_, carry):
        z = carry[0]
        p, J, bend = polynomials.slopes(value, spread, rad, test.exponents, z)
        R = varying.right_inverse(J, z)
        moved = jnp.clip(z - jnp.sum(R * p[None], 1), z - SHARE * (1 + z), z + SHARE * (1 - z))
        return moved, (z, p, J, bend, R)

    first = jnp.clip(start, -SHARE, SHARE)
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(newton, 0, (first,))[1])
    z, p, J, bend, R = jax.lax.fori_loop(
        0, jnp.where(jnp.any(wanted), NEWTON + 1, 0), newton, (first, nothing)
    )[1]
    J_error = jnp.broadcast_to((order * error)[:, None], J.shape)
    return wanted & varying.holds(p, error, J, J_error, z, R, bend)


def on_boxes(test: Any, terms: Any, mid: Any, radius: Any, owner: Any, proved: Any) -> tuple:
    """Return (status, margin, found, open, start, h, axis) of boxes: see `candidates` and `concluded`."""
    terms, c, G, h, start, axis = candidates(test, terms, mid, radius, owner)
    return *concluded(test, terms, c, G, h, start, proved), start, h, axis


def on_whole(test: Any, terms: Any, proved: Any) -> tuple:
    """Return the same of the whole box of parameters, for each window of a block."""
    count, dtype = terms[0].shape[-1], terms[0].dtype
    one = np.ones((len(test.size), count), dtype)
    return on_boxes(test, terms, 0 * one, one, np.arange(count, dtype=np.int32), proved)


def bisected(test: Any, samples: Any, proved: bool, budget: int) -> np.ndarray:
    """Return the status of windows, at most a block, by bisection of their parameters, in blocks of boxes as
    large as those of windows.
    """
    count, n, dtype = samples[1].shape[-1], len(test.size), samples[1].dtype
    samples = [np.concatenate([x, np.repeat(x[..., :1], SEARCHED - count, -1)], -1) for x in samples]
    on_device = jax.device_put(test)
    terms = terms_of(on_device, *samples)
    grow = 1 + 4 * np.finfo(dtype).eps

    def judge(lo, hi, owner):
        mid = 0.5 * (lo + hi)
        found, keep, _, _, axis = on_boxes(
            on_device, terms, mid, np.maximum(hi - mid, mid - lo) * grow, owner, proved
        )[2:]
        return Verdicts(keep, found, (mid, mid), None, axis) if proved else Verdicts(keep, axis=axis)

    one = np.ones(n, dtype)
    found = explore(judge, -one, one, count, 200, budget, "kernel", first=True, sizes=(SEARCHED,))
    status = np.where(
        np.bincount(found.owner, minlength=count) == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED)
    )
    status[found.proofs[2]] = Status.CONSISTENT
    return status
