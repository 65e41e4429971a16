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
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array, Compensation
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.consistency.reading import Block, gather
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
    "Terms",
    "at_vertices",
    "bisected",
    "block_of",
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
TRIED = 1, 2, 8
"""Points of Newton's method at which a proof is tried: the start, the next, which settle most windows, and
the last, beyond which hardly anything more is proved.
"""
SHARE = 0.99
"""How far towards a side of the box one of them may go."""
LEAST = 1e-6


Family = TypeVar("Family", bound=PolynomialRelations)
StatusAndMargin: TypeAlias = tuple[jax.Array, jax.Array]
"""(status, margin) of windows."""
At: TypeAlias = tuple[jax.Array, ...]
"""(z, p, J, bend, R): a point, and what a proof there needs."""
Newton: TypeAlias = tuple[jax.Array, jax.Array, At, jax.Array]
"""(number of points, the next point, the last one, where a proof holds)."""


class Terms(NamedTuple):
    """Polynomials of windows, see `PolynomialReading.polynomials`, with one bound on the error of each row.

    Fields: value (count, K, N); spread (count, K, R); rad (R, N); error (count, N).
    """

    value: jax.Array
    spread: jax.Array
    rad: jax.Array
    error: jax.Array


def cases(
    relations: Family, u: np.ndarray, y: np.ndarray, starts: np.ndarray
) -> Iterator[tuple[Family | None, np.ndarray]]:
    """Yield (relations, numbers of the windows that they fit): windows that lack the same samples lack the
    same rows and inputs.

    Beyond `PATTERNS` patterns, the rarest windows come with None. Windows that have no relation left are not
    mentioned.
    """
    if not len(starts):
        return
    count = len(starts)
    windows = gather(u, y, starts, relations.reading(y.dtype).lags, relations.horizon)
    inputs, outputs = (np.isnan(x).reshape(-1, count).T for x in windows)
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
        gone, silent = (np.flatnonzero(x).tolist() for x in np.split(patterns[number], [rows]))
        case = relations.without(set(gone), set(silent))
        if case is not None:
            yield case, broken[which.ravel() == number]


def samples_of(reading: PolynomialReading, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Block:
    """Return the samples (lags, m, N) and (s + 1, p, N) of windows; unneeded ones that are missing become
    0.
    """
    return finite(gather(u, y, starts, reading.lags, reading.horizon))


def finite(windows: Block) -> Block:
    """Return samples with 0 for those that are missing, and not needed."""
    u, y = windows
    return (
        np.nan_to_num(u, nan=0.0, posinf=np.inf, neginf=-np.inf),
        np.nan_to_num(y, nan=0.0, posinf=np.inf, neginf=-np.inf),
    )


def judged_by(relations: PolynomialRelations, method: str) -> str:
    """Return how a block is judged: "vertices", "zonotope", "linearized" or "box"."""
    if method in ("linearized", "box"):
        return method
    few = relations.count == 1 and len(relations.variables) <= VERTICES
    if few and polynomials.multiaffine(relations.exponents):
        return "vertices"
    return "zonotope"


def block_of(kind: str) -> int:
    """Return how many windows are judged at once, by how they are judged."""
    return SEARCHED if kind == "zonotope" else BLOCK


def judged_whole(
    reading: PolynomialReading, samples: Block, kind: str, proved: bool, allowance: Compensation
) -> StatusAndMargin:
    """Return (status, margin) of a block of windows."""
    judged: StatusAndMargin
    terms = terms_of(reading, *samples)
    if kind == "vertices":
        judged = at_vertices(reading, terms, proved)
    elif kind == "box":
        judged = _box(reading, terms, proved)
    elif kind == "linearized":
        judged = _suspected(*_linear(reading, terms, allowance))
    else:
        status, margin, *_ = on_whole(reading, terms, proved)
        judged = status, margin
    return judged


def _noise_part(reading: PolynomialReading, z: jax.Array) -> jax.Array:
    """Return the noises among the columns of an image."""
    own = len(reading.noisy)
    if reading.spare is not None:
        own += len(reading.spare)
    lumps = len(reading.N) if own and len(reading.exponents) > 1 else 0
    return z[len(z) - lumps - own : len(z) - lumps]


def _status(margin: jax.Array, inside: jax.Array) -> jax.Array:
    decided = jnp.where(margin < 0, Status.FAULT, jnp.where(inside, Status.CONSISTENT, Status.UNDECIDED))
    return jnp.where(jnp.isnan(margin), Status.MISSING, decided).astype(jnp.int8)


@kernel
def terms_of(reading: PolynomialReading, u: jax.Array, y: jax.Array) -> Terms:
    """Return the polynomials of windows, and one bound on the error of each row."""
    value, error, spread, rad = reading.polynomials(u, y)
    return Terms(value, spread, rad, polynomials.row_error(value, error, spread, rad, reading.exponents))


def linear_image(
    reading: PolynomialReading, terms: Terms, allowance: Compensation
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (c, G, error) of the whole box of parameters without all that is of order 2; `allowance` is a
    generator in each row.
    """
    value, spread, rad, error = terms
    c, G = polynomials.image(value, spread, rad, reading.exponents, linear=True)
    own = jnp.broadcast_to(jnp.asarray(allowance, c.dtype), (len(c),))[:, None] * jnp.ones_like(c)
    columns = jnp.where(np.eye(len(c), dtype=bool)[:, :, None], own[:, None], 0)
    return c, jnp.concatenate([G, columns], 1), error


@kernel
def _linear(
    reading: PolynomialReading, terms: Terms, allowance: Compensation
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array | None]:
    """Return (c, G, error, h) of the linearized test: see `linear_image`; h: None where strips are few."""
    c, G, error = linear_image(reading, terms, allowance)
    r, q, _ = G.shape
    if varying.strip_count(r, q, alone=True):
        return c, G, error, None
    return c, G, error, farthest(c, G)[0]


@kernel
def _suspected(c: jax.Array, G: jax.Array, error: jax.Array, h: jax.Array | None) -> StatusAndMargin:
    margin = _outside(c, G, error, h)
    return jnp.where(jnp.isnan(margin), Status.MISSING, Status.UNDECIDED).astype(jnp.int8), margin


@kernel
def at_vertices(reading: PolynomialReading, terms: Terms, proved: bool) -> StatusAndMargin:
    """Return (status, margin) of a single multi-affine relation: see `polynomials.vertex_margin`."""
    value, spread, rad, error = terms
    margin, inside = polynomials.vertex_margin(value, spread, rad, reading.exponents, error)
    return _status(margin, inside & proved), margin


@kernel
def _box(reading: PolynomialReading, terms: Terms, proved: bool) -> StatusAndMargin:
    """Return (status, margin) where each relation is tested alone: by its vertices if it has few, else by the
    sum of all its parts.
    """
    value, spread, rad, error = terms
    few = polynomials.multiaffine(reading.exponents) and len(reading.size) <= VERTICES
    worst = jnp.full_like(value[0, 0], jnp.inf)
    inside = jnp.asarray(proved) & (value.shape[0] == 1)
    for k in range(value.shape[0]):
        row = slice(k, k + 1)
        if few:
            margin, holds = polynomials.vertex_margin(
                value[row], spread[row], rad, reading.exponents, error[row]
            )
            inside = inside & holds
        else:
            margin = varying.strip_margins(
                *polynomials.image(value[row], spread[row], rad, reading.exponents), error[row]
            )
            inside = inside & False
        worst = jnp.minimum(worst, margin)
    return _status(worst, inside), worst


def _outside(c: jax.Array, G: jax.Array, error: jax.Array, h: jax.Array | None) -> jax.Array:
    """Return the margin, < 0 is a proof: by all strips where they are few or h is None, else by the direction
    h, an array.
    """
    margin: jax.Array
    r, q, _ = G.shape
    if h is None or varying.strip_count(r, q):
        margin = varying.strip_margins(c, G, error)
    else:
        margin = varying.refutes(c, G, error, h)
    return margin


def farthest(c: jax.Array, G: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (h, z), candidates for a direction and a point: see `gauge_search`."""
    size = varying.row_sizes(c, G)
    h, z, _ = gauge_search(*varying.scaled(c, G, size), jnp.ones_like(c[0]))
    return h / size, z


class Candidates(NamedTuple):
    """Hints of a search for boxes: their polynomials, the image c + G [-1, 1]^q, a direction h, a point start
    (v, e), and the axis along which to cut.
    """

    terms: Terms
    c: jax.Array
    G: jax.Array
    h: jax.Array
    start: jax.Array
    axis: jax.Array


@kernel
def candidates(
    reading: PolynomialReading, terms: Terms, mid: jax.Array, radius: jax.Array, owner: jax.Array
) -> Candidates:
    """Return the hints by which `concluded` proves something, of boxes mid +- radius (n, N) of windows
    `owner`.

    The image is c + G [-1, 1]^q, up to the error; start (v, e) and h are candidates for a point and a
    direction; axis is where to cut.
    """
    value, spread, rad, error = terms
    value, rad, error = value[..., owner], rad[..., owner], error[..., owner]
    c, G = polynomials.image(value, spread, rad, reading.exponents, mid, radius)
    h, z = farthest(c, G)
    start = jnp.concatenate([jnp.clip(mid + radius * z[: len(mid)], -1, 1), _noise_part(reading, z)])
    axis = jnp.argmax(polynomials.bends(value, reading.exponents, radius), 0)
    return Candidates(Terms(value, spread, rad, error), c, G, h, start, axis)


@kernel
def concluded(
    reading: PolynomialReading,
    terms: Terms,
    c: jax.Array,
    G: jax.Array,
    h: jax.Array,
    start: jax.Array,
    proved: bool,
) -> tuple[jax.Array, ...]:
    """Return (status, margin, found, open) of boxes: refuted by a direction or strips, explained by a zero
    near a start.

    Everything is an array here, so that the compiler cannot round a candidate anew for each of its uses.
    proved: whether the relations say all, so that a zero is an explanation.
    """
    margin = _outside(c, G, terms[3], h)
    found = _explained(reading, terms, start, proved & (margin >= 0))
    status = _status(margin, found)
    size = jnp.where(found, jnp.maximum(margin, LEAST), margin)
    return status, size, found, ~(margin < 0) & ~found


def _explained(reading: PolynomialReading, terms: Terms, start: jax.Array, wanted: jax.Array) -> jax.Array:
    """Say near which starts a zero is proved to exist, among the windows where that is wanted.

    Newton's method moves a point towards a zero and never onto the sides of the box, where it would have no
    room left. It is carried by a loop, so that values, slopes and proof are of one point. A proof is tried
    at the points of `TRIED`; what one of them proves stays proved, so that no window depends on another.
    """
    value, spread, rad, error = terms
    order = max(1, *map(sum, reading.exponents))

    def newton(z: jax.Array) -> tuple[jax.Array, At]:
        p, J, bend = polynomials.slopes(value, spread, rad, reading.exponents, z)
        R = varying.right_inverse(J, z)
        moved = jnp.clip(z - jnp.sum(R * p[None], 1), z - SHARE * (1 + z), z + SHARE * (1 - z))
        return moved, (z, p, J, bend, R)

    def proved(at: At) -> jax.Array:
        z, p, J, bend, R = at
        J_error = jnp.broadcast_to((order * error)[:, None], J.shape)
        return varying.holds(p, error, J, J_error, z, R, bend)

    def step(carry: Newton) -> Newton:
        number, z, at, found = carry
        tried = jnp.any(number == np.array(TRIED, np.int32))
        found = jax.lax.cond(tried, lambda: found | proved(at), lambda: found)
        moved, at = jax.lax.cond(jnp.any(wanted & ~found), lambda: newton(z), lambda: (z, at))
        return number + 1, moved, at, found

    def going(carry: Newton) -> jax.Array:
        number, *_, found = carry
        return (number <= TRIED[-1]) & jnp.any(wanted & ~found)

    first = jnp.clip(start, -SHARE, SHARE)
    shapes = jax.eval_shape(newton, first)[1]
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    *_, found = jax.lax.while_loop(going, step, (jnp.int32(0), first, nothing, jnp.zeros_like(wanted)))
    return wanted & found


def on_boxes(
    reading: PolynomialReading, terms: Terms, mid: Array, radius: Array, owner: np.ndarray, proved: bool
) -> tuple[jax.Array, ...]:
    """Return (status, margin, found, open, start, h, axis) of boxes: see `candidates` and `concluded`."""
    own, c, G, h, start, axis = candidates(reading, terms, mid, radius, owner)
    return *concluded(reading, own, c, G, h, start, proved), start, h, axis


def on_whole(reading: PolynomialReading, terms: Terms, proved: bool) -> tuple[jax.Array, ...]:
    """Return the same of the whole box of parameters, for each window of a block."""
    count, dtype = terms.value.shape[-1], terms.value.dtype
    one = np.ones((len(reading.size), count), dtype)
    return on_boxes(reading, terms, 0 * one, one, np.arange(count, dtype=np.int32), proved)


def bisected(reading: PolynomialReading, samples: Block, proved: bool, budget: int) -> np.ndarray:
    """Return the status of windows, at most a block, by bisection of their parameters, in blocks of boxes as
    large as those of windows.
    """
    count, n, dtype = samples[1].shape[-1], len(reading.size), samples[1].dtype
    filled = (np.concatenate([x, np.repeat(x[..., :1], SEARCHED - count, -1)], -1) for x in samples)
    on_device = jax.device_put(reading)
    terms = terms_of(on_device, *filled)
    grow = 1 + 4 * np.finfo(dtype).eps

    def judge(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[jax.Array]:
        mid = 0.5 * (lo + hi)
        radius = np.maximum(hi - mid, mid - lo) * grow
        _, _, found, keep, _, _, axis = on_boxes(on_device, terms, mid, radius, owner, proved)
        if not proved:
            return Verdicts(keep, axis=axis)
        return Verdicts(keep, found, (mid, mid), None, axis)

    one = np.ones(n, dtype)
    cover = explore(judge, -one, one, count, 200, budget, "kernel", first=True, sizes=(SEARCHED,))
    return cover.status(count)
