"""Verdicts on windows of a model with uncertain parameters: refuted by strips or at vertices, explained by a
point, else bisected.

A window is a system of polynomials p(v, e) = 0 in parameters v and noises e within [-1, 1]
(`PolynomialReading.polynomials`).

FAULT: a direction separates 0 from a zonotope around all values of p, each neglected monomial a variable of
its own, or 0 is outside the range of a single multi-affine relation. CONSISTENT: a zero of p is proved to
exist near a point that a search found, or the range of a single relation has both signs; both need relations
that are proved to say all. What is neither is UNDECIDED; a budget of boxes cuts the parameters until one of
the two proofs holds on every part.

A window that lacks samples is tested by relations made for it: those without the lost rows, the lost inputs
being unknown. Their kernels are evaluated in NumPy, which takes less time than compiling those of a pattern.

Source: Ploix, Adrot 2006, sections 3-4; golden "Sound test".
"""

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations, Polynomials
from jaxbound.consistency.reading import Block, gather
from jaxbound.sets.floats.kernel import kernel, outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Boxes, Verdicts, explore, judged_in_blocks
from jaxbound.sets.strips import polynomials, varying

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
At: TypeAlias = tuple[jax.Array, ...]
"""(z, p, J, bend, R): a point, and what a proof there needs."""
Newton: TypeAlias = tuple[jax.Array, jax.Array, At, jax.Array]
"""(number of points, the next point, the last one, where a proof holds)."""


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
    # the commonest patterns first: relations are made for these
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


def by_vertices(relations: PolynomialRelations) -> bool:
    """Return whether the vertices of the box of parameters decide windows: a single relation's."""
    few = relations.count == 1 and len(relations.variables) <= VERTICES
    return few and polynomials.multiaffine(relations.exponents)


@kernel
def terms_of(reading: PolynomialReading, u: jax.Array, y: jax.Array) -> Polynomials:
    """Return the polynomials of windows, and one bound on the error of each row."""
    p = reading.polynomials(u, y)
    return p._replace(error=polynomials.row_error(*p, reading.exponents))


@kernel
def alone(reading: PolynomialReading, terms: Polynomials, proved: bool) -> tuple[jax.Array, jax.Array]:
    """Return (status, margin) where each relation is tested alone: by its vertices if it has few, else by the
    sum of all its parts.
    """
    value, error, spread, rad = terms
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
            c, G = polynomials.image(value[row], spread[row], rad, reading.exponents)
            margin = varying.refutes(c, G, error[row], jnp.ones_like(c))
            # a sum of parts holds the range, and may hold more: it refutes, and explains nothing
            inside = inside & False
        worst = jnp.minimum(worst, margin)
    decided = jnp.where(worst < 0, Status.FAULT, jnp.where(inside, Status.CONSISTENT, Status.UNDECIDED))
    return jnp.where(jnp.isnan(worst), Status.MISSING, decided).astype(jnp.int8), worst


class Hints(NamedTuple):
    """Hints of a search for boxes: a direction h (r, N), a point start (v, e), an axis along which to cut."""

    h: jax.Array
    start: jax.Array
    axis: jax.Array


@kernel
def candidates(
    reading: PolynomialReading, terms: Polynomials, mid: jax.Array, radius: jax.Array, owner: jax.Array
) -> tuple[Polynomials, tuple[jax.Array, jax.Array], Hints]:
    """Return (Polynomials, (c, G), Hints) of boxes mid +- radius (n, N) of windows `owner`, for `concluded`.

    The image is c + G [-1, 1]^q, up to the error.
    """
    value, error, spread, rad = terms
    value, rad, error = value[..., owner], rad[..., owner], error[..., owner]
    c, G = polynomials.image(value, spread, rad, reading.exponents, mid, radius)
    h, z = varying.farthest(c, G, error)
    lumps = len(reading.N) if reading.noisy and len(reading.exponents) > 1 else 0
    noises = z[len(z) - lumps - len(reading.noisy) : len(z) - lumps]
    start = jnp.concatenate([jnp.clip(mid + radius * z[: len(mid)], -1, 1), noises])
    # the parameter along which relations bend most: halving it tightens the image most
    axis = jnp.argmax(polynomials.bends(value, reading.exponents, radius), 0)
    return Polynomials(value, error, spread, rad), (c, G), Hints(h, start, axis)


@kernel
def concluded(
    reading: PolynomialReading,
    terms: Polynomials,
    image: tuple[jax.Array, jax.Array],
    hints: Hints,
    proved: bool,
) -> tuple[jax.Array, jax.Array]:
    """Return (margin, found) of boxes: refuted by a direction, explained by a zero near a start.

    Everything is an array here, so that the compiler cannot round a hint anew for each of its uses. proved:
    whether the relations say all, so that a zero is an explanation.
    """
    margin = varying.refutes(*image, terms.error, hints.h)
    found = _explained(reading, terms, hints.start, proved & (margin >= 0))
    return jnp.where(found, jnp.maximum(margin, LEAST), margin), found


@kernel
def _refuting(
    reading: PolynomialReading, terms: Polynomials, mid: jax.Array, radius: jax.Array, h: jax.Array
) -> jax.Array:
    value, error, spread, rad = terms
    c, G = polynomials.image(value, spread, rad, reading.exponents, mid, radius)
    return varying.refutes(c, G, error, h)


def _newton(reading: PolynomialReading, terms: Polynomials, z: jax.Array) -> tuple[jax.Array, At]:
    """Return (the next point of Newton's method, the At of this one)."""
    p, J, bend = polynomials.slopes(terms.value, terms.spread, terms.rad, reading.exponents, z)
    R = varying.right_inverse(J, z)
    # not onto a side: a proof needs room around the zero
    moved = jnp.clip(z - jnp.sum(R * p[None], 1), z - SHARE * (1 + z), z + SHARE * (1 - z))
    return moved, (z, p, J, bend, R)


def refined(reading: PolynomialReading, samples: Block, z: np.ndarray) -> np.ndarray:
    """Return points nearer to a zero than z (v, e) of windows, by some steps of Newton's method in NumPy."""
    with outside_xla():
        terms = terms_of(reading, *samples)
        for _ in range(2 * TRIED[-1]):
            z = np.asarray(_step(reading, terms, z))
    return z


@kernel
def _step(reading: PolynomialReading, terms: Polynomials, z: jax.Array) -> jax.Array:
    return _newton(reading, terms, z)[0]


def _explained(
    reading: PolynomialReading, terms: Polynomials, start: jax.Array, wanted: jax.Array
) -> jax.Array:
    """Say near which starts a zero is proved to exist, among the windows where that is wanted.

    Newton's method moves a point towards a zero and never onto the sides of the box, where it would have no
    room left. It is carried by a loop, so that values, slopes and proof are of one point. A proof is tried
    at the points of `TRIED`; what one of them proves stays proved, so that no window depends on another.
    """
    error, order = terms.error, max(1, *map(sum, reading.exponents))

    def proved(at: At) -> jax.Array:
        z, p, J, bend, R = at
        J_error = jnp.broadcast_to((order * error)[:, None], J.shape)
        return varying.holds(p, error, J, J_error, z, R, bend)

    def step(carry: Newton) -> Newton:
        number, z, at, found = carry
        tried = jnp.any(number == np.array(TRIED, np.int32))
        found = jax.lax.cond(tried, lambda: found | proved(at), lambda: found)
        moved, at = jax.lax.cond(
            jnp.any(wanted & ~found), lambda: _newton(reading, terms, z), lambda: (z, at)
        )
        return number + 1, moved, at, found

    def going(carry: Newton) -> jax.Array:
        number, *_, found = carry
        return (number <= TRIED[-1]) & jnp.any(wanted & ~found)

    first = jnp.clip(start, -SHARE, SHARE)
    shapes = jax.eval_shape(partial(_newton, reading, terms), first)[1]
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    *_, found = jax.lax.while_loop(going, step, (jnp.int32(0), first, nothing, jnp.zeros_like(wanted)))
    return wanted & found


def middle_of(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle of boxes, and radii that reach both ends."""
    mid = 0.5 * (lo + hi)
    return mid, np.maximum(hi - mid, mid - lo) * (1 + 4 * np.finfo(mid.dtype).eps)


class Leaves(NamedTuple):
    """Boxes lo, hi (n, K) of windows owner (K,), each with a direction h (r, K) that refutes it."""

    owner: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    h: np.ndarray

    def chosen(self, which: np.ndarray) -> "Leaves":
        """Return some of them."""
        return Leaves(*(x[..., which] for x in self))


def bisected(
    reading: PolynomialReading, samples: Block, proved: bool, budget: int, size: int = SEARCHED
) -> tuple[np.ndarray, np.ndarray, Leaves, np.ndarray]:
    """Return (status, margin, Leaves, points (v, e)) of windows, by bisection of their parameters.

    The margins are those of the whole box. The leaves of a FAULT are its whole box. A point is where a zero
    is proved, else the first that was tried.

    Args:
        size: windows, no fewer than there are, and boxes that are judged at once.
    """
    count, one = samples[1].shape[-1], np.ones(len(reading.size), samples[1].dtype)
    filled = (np.concatenate([x, np.repeat(x[..., :1], size - count, -1)], -1) for x in samples)
    terms = terms_of(reading, *filled)
    leaves: list[Leaves] = []
    levels: list[tuple[np.ndarray, np.ndarray]] = []

    def on_boxes(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> tuple[jax.Array, ...]:
        own, image, hints = candidates(reading, terms, *middle_of(lo, hi), owner)
        return *concluded(reading, own, image, hints, proved), *hints

    def judge(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[np.ndarray]:
        margin, found, h, start, axis = judged_in_blocks(on_boxes, lo, hi, owner, size)
        levels.append((margin, start))
        leaves.append(Leaves(owner, lo, hi, h).chosen(margin < 0))
        return Verdicts(~(margin < 0) & ~found, found, (start, start), None, axis)

    # of one box a window the first level is the last: what is cut behind it nobody looks at
    *_, cover = explore(judge, Boxes.repeated(-one, one, count), 200, budget, first=True)
    margin, points = levels[0]
    points[:, cover.proofs.owner] = cover.proofs.lo
    every = Leaves(*(np.concatenate(x, -1) for x in zip(*leaves, strict=True)))
    status = np.where(np.isnan(margin), np.int8(Status.MISSING), cover.status)
    return status, margin, every, points


def refuted_boxes(reading: PolynomialReading, samples: Block, leaves: Leaves) -> np.ndarray:
    """Return (K,) bool: in which boxes of windows (their samples on the last axis) a direction refutes them,
    in NumPy from the samples.
    """

    def refuting(lo: np.ndarray, hi: np.ndarray, at: np.ndarray) -> jax.Array:
        terms = terms_of(reading, *(x[..., leaves.owner[at]] for x in samples))
        margin: jax.Array = _refuting(reading, terms, *middle_of(lo, hi), leaves.h[:, at])
        return margin

    if not len(leaves.owner):
        return np.zeros(0, bool)
    with outside_xla():
        (margin,) = judged_in_blocks(refuting, leaves.lo, leaves.hi, np.arange(len(leaves.owner)), SEARCHED)
    return np.asarray(margin < 0)
