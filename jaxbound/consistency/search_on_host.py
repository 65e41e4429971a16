"""Long windows searched and decided in NumPy, whatever samples or inputs they lack, from the one frame of
their relations; and what floats leave open, in whole numbers.

**Search.** This is a Chebyshev problem: the least t = max |b - B x| / r, x = (d, f), over the rows that are
there. Each f is exchanged for a row that tells it; from there the single exchange of
`sets.strips.separation` goes on, with a B of each window's own. Plain floats, no claim.

**Proof** (`check`). The bound V of an unknown f comes from the rows J that tell f: with P near the inverse of
F_J and G = |1 - P F_J|, f = P (z - R d - e)_J + (1 - P F_J) f, so that |f| <= c + G |f| with c = |P| (|z| +
|R| r + r)_J, and |f| <= 2 c where G c <= c / 2. Where rows do not tell each f apart, and in whole numbers,
fractions make h F = 0 exact for that one h.

**Whole numbers.** Where a sensor has no noise, its bound is what the recorder rounds away: as thin as the
rounding of a residual in floats, which then decides nothing. Multipliers and unknowns need only be nearly
right, and come from floats; z does not. An unknown f found so is off by its own rounding, which may be more
than a radius: the next search begins with what the one before found.
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import lcm
from typing import NamedTuple

import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.check import LEAST, UNIT, HostImage, contradicted, explained
from jaxbound.consistency.interface import Arrays, LinearRelations, Run, SignedTest
from jaxbound.consistency.reading import Block, Reading
from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.integers import places, whole_floats
from jaxbound.exact.linalg import dot, row_reduce
from jaxbound.sets.strips.chebyshev import fitted

HELD = 2**21
"""Numbers of the problems that are searched at once."""
TOGETHER = 2**8
"""Windows that are asked in whole numbers at once."""
ROUNDS = 3
"""Searches for what whole numbers prove."""
TOLD = 1e-9
"""Share of its column that a pivot has at least: less tells nothing."""
LARGEST = 2**1000
"""Larger multipliers end in no float."""
FEW, WORK = 24, 2**11
"""Unknowns, and coefficients, with which one combination is worked out in fractions: milliseconds."""


class HolesTest(SignedTest):
    """Decides windows whatever they lack; both verdicts are proofs.

    Recordings in float32, too, are worked out in float64.

    Args:
        relations, dtype: as of `ExchangeTest`.
    """

    sharded = padded = False
    confirms = on_host = True
    block = 64
    least: float | None = None
    """The least size of a margin whose sign is proved; None: the precision of the type."""

    def __init__(self, relations: LinearRelations, dtype: DTypeLike) -> None:
        super().__init__(relations, "joint", dtype)
        self.reading = relations.reading(np.float64)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return the margins of blocks of windows; without a device."""
        return [(self.searched(u, y),) for u, y in blocks]

    @np.errstate(all="ignore")
    def searched(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the margins (N,) of windows u (lags, m, N), y (s + 1, p, N): NaN where no relation has its
        data, 0 where nothing is proved.
        """
        image = self.image(u, y)
        frame, (c, k) = self.relations.frame, image.R.shape
        assert frame is not None
        width = k + image.most
        size = max(1, HELD // max(1, (c + width) * width))
        margins = []
        for first in range(0, y.shape[2], size):
            margins.append(self.decided(image.of_windows(slice(first, first + size)), frame, y.dtype))
        return np.concatenate(margins)

    def image(self, u: np.ndarray, y: np.ndarray) -> HostImage:
        """Return the rows of windows."""
        return HostImage.of(self.reading, u, y)

    def hints(self, image: HostImage) -> tuple["Found", HostImage]:
        """Return the hints of a search, and the rows that its unknowns may explain."""
        return _searched(image), image

    def decided(self, image: HostImage, frame: ExactFrame, dtype: np.dtype) -> np.ndarray:
        """Return the margins (N,) of windows."""
        found, near = self.hints(image)
        inside = explained(near, found.x)
        # a proof needs more than rounding, which t > 1 shows; to ask the others takes fractions
        open_ = np.flatnonzero((found.t > 1) & ~inside & ~found.idle)
        outside = np.zeros_like(inside)
        if len(open_):
            some, h, telling = image.of_windows(open_), found.h[:, open_], found.telling[open_]
            outside[open_] = _refuted(some, frame, h, telling)
        return _signed(found.t, found.idle, inside, outside, dtype, self.least)


class Found(NamedTuple):
    """Hints: t (N,); x (k + n, N); h (c, N); telling, idle as of a `Fit`."""

    t: np.ndarray
    x: np.ndarray
    h: np.ndarray
    telling: np.ndarray
    idle: np.ndarray


def whole_margins(relations: LinearRelations, reading: Reading, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (N,) margins of windows u (lags, m, N), y (s + 1, p, N) in whole numbers: > 0 inside, < 0
    outside, both proved; 0 where no search came near enough, NaN where no relation has its data.

    Args:
        reading: of the relations, whose bounds count.
    """
    frame, margins = relations.frame, [np.zeros(0, y.dtype)]
    assert frame is not None
    for first in range(0, y.shape[2], TOGETHER):
        part = slice(first, first + TOGETHER)
        image = HostImage.whole(relations.model, reading, frame, u[..., part], y[..., part])
        with np.errstate(all="ignore"):
            margins.append(_decided_exactly(image, frame, y.dtype))
    return np.concatenate(margins)


def _decided_exactly(image: HostImage, frame: ExactFrame, dtype: np.dtype) -> np.ndarray:
    """Return the margins (N,) of windows in whole numbers."""
    t, (inside, outside, idle) = np.zeros(image.lo.shape[1]), np.zeros((3, image.lo.shape[1]), bool)
    left, c = np.arange(len(t)), len(image.R)
    for number in range(ROUNDS):
        # as shares of the largest number: floats hold no more than 1e308, whole numbers do
        top, values, radius = _in_floats(image)
        found = _searched(image, values, radius)
        x = np.where(np.isfinite(found.x), found.x, 0)
        power = places(x)
        x, finer = whole_floats(x, power) * top, ("lo", "hi", "known", "off")
        shifted = {name: getattr(image, name) << power for name in finer}
        scaled = replace(image, start=image.middle << power, **shifted)
        inside[left] |= explained(scaled, x)
        outside[left] |= _refuted(image, frame, found.h, found.telling) & ~inside[left]
        t[left], idle[left] = found.t, found.idle
        open_ = np.flatnonzero(~idle[left] & (~(inside | outside)[left] | (number == 0)))
        if not len(open_):
            break
        # the next search begins where this one ended: it finds the digits that were lost
        left, x, image = left[open_], x[:, open_] >> power, image.of_windows(open_)
        middle = image.middle.copy()
        middle[c:] += x[: len(middle) - c]
        image = replace(image, start=middle, known=image.known_with(x[len(middle) - c :]))
    return _signed(t, idle, inside, outside, dtype)


def _in_floats(image: HostImage) -> tuple[np.ndarray, ...]:
    """Return (top (N,), values (c + k, N) and radii of rows) of whole numbers: floats, as shares of `top`."""
    radius, c = image.radius, len(image.R)
    z = np.where(image.there[:c], image.z, 0)
    top = np.maximum(np.concatenate([np.abs(z) // image.scale, radius]).max(0), 1)
    own = np.where(image.there[c:], ((image.lo + image.hi) // 2 - image.middle)[c:], 0)
    values = np.concatenate([z, image.scale * own]) / (image.scale * top)
    return top, np.asarray(values, float), np.asarray(radius / top, float)


def _searched(image: HostImage, values: np.ndarray | None = None, radius: np.ndarray | None = None) -> Found:
    """Return the hints of windows; values, radius: of rows, in other units than those of an image in
    floats.
    """
    c, k = image.R.shape
    if values is None or radius is None:
        values, radius = np.concatenate([image.z, np.zeros((k, image.lo.shape[1]))]), image.radius
    free, columns = image.acting, image.columns
    radius = np.maximum(radius.T, LEAST)
    # of unknowns without bounds, in units of their largest coefficient over a radius
    largest = np.abs(columns / radius[:, :c, None]).max(1)
    scale = np.where(image.free & (largest > 0), 1 / np.where(largest > 0, largest, 1), 1)
    lost = np.ones((len(free), free.shape[1] - k))
    own = np.where(image.free, 1, np.concatenate([radius[:, c:], lost], 1))
    b, radii = np.concatenate([values.T, 0 * lost], 1), np.concatenate([radius[:, :c], own], 1)
    fit = fitted(columns * scale[:, None, :], b, radii, image.there[:c].T, free, TOLD)
    h = np.where(image.there[:c], fit.h.T, 0)
    top = np.abs(h).max(0, initial=0)
    return Found(fit.t, (fit.x * scale).T, h / np.where(top > 0, top, 1), fit.telling, fit.idle)


def _signed(
    t: np.ndarray,
    idle: np.ndarray,
    inside: np.ndarray,
    outside: np.ndarray,
    dtype: np.dtype,
    least: float | None = None,
) -> np.ndarray:
    """Return margins with the sign that was proved, 0 where none was, NaN where no row tells anything. least:
    the size of those whose sign is proved, at least; None: the precision of the type.
    """
    margin = np.nan_to_num(1 - t, nan=0.0)
    if least is None:
        least = float(np.finfo(dtype).eps)
    margin = np.where(outside, np.minimum(margin, -least), np.where(inside, np.maximum(margin, least), 0))
    return np.where(idle, np.nan, margin).astype(dtype)


def _refuted(image: HostImage, frame: ExactFrame, h: np.ndarray, telling: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows combinations h (c, N) contradict, or those near them that are exact.

    Args:
        telling: (N, k + n), the outer row that tells each unknown.
    """
    free = image.acting
    lacking = free.any(1)
    if image.exact:
        known = np.where(np.isfinite(h), h, 0)
        outside = contradicted(image, whole_floats(known, places(known)), np.zeros((1, 1))) & ~lacking
    else:
        reach = np.zeros((1, 1))
        if lacking.any():
            reach = _reach(image.hull, telling, free)
        outside = contradicted(image, h, reach)
    for w in np.flatnonzero(lacking & ~outside):
        own = _exact_combination(image, frame, h[:, w], telling[w], free[w], int(w))
        if own is not None:
            one = slice(w, w + 1)
            outside[one] = contradicted(image.of_windows(one), own[:, None], np.zeros((1, 1)))
    return outside


def _exact_combination(
    image: HostImage, frame: ExactFrame, h: np.ndarray, telling: np.ndarray, free: np.ndarray, w: int
) -> np.ndarray | None:
    """Return the combination near h (c,) in which every unknown without bounds cancels exactly, None where
    there is none, or fractions would take too long; whole where the image is.

    Where unknowns are told together by fewer rows than they are, as inputs in a gap of all outputs, no bound
    of a single one exists, and none is needed.
    """
    c, k = image.R.shape
    columns = np.flatnonzero(free)
    inputs = image.slots[:, w]
    live, own = columns[telling[columns] >= 0], telling[columns[telling[columns] >= 0]]
    there = image.there[:c, w].astype(bool)
    others = np.setdiff1d(np.flatnonzero(there & np.isfinite(h) & (h != 0)), own)
    # a row that tells an unknown has to be there itself
    if not there[own].all():
        return None
    if len(live) > FEW or len(columns) * (len(others) + len(own)) > WORK:
        return None

    def coefficient(j: int, column: int) -> Fraction:
        row, place = (frame.R[j], column) if column < k else (frame.K[j], int(inputs[column - k]))
        return row[place]

    weights = [Fraction(float(h[j])) for j in others]
    system = []
    for f in live:
        rest = dot(weights, [coefficient(j, f) for j in others])
        system.append([*(coefficient(j, f) for j in own), -rest])
    # the rows that tell are weighed so that each unknown cancels
    reduced, pivots = row_reduce(system)
    if pivots != tuple(range(len(live))):
        return None
    weights += [row[-1] for row in reduced]
    rows = [*others, *own]
    # unknowns that are told together with others have to cancel too, with nothing left to choose
    for f in columns[telling[columns] < 0]:
        if dot(weights, [coefficient(j, f) for j in rows]):
            return None
    exact = np.zeros(c, image.lo.dtype)
    if image.exact:
        common = lcm(*(x.denominator for x in weights))
        exact[rows] = [int(x * common) for x in weights]
        return exact
    if max(map(abs, weights), default=0) > LARGEST:
        return None
    exact[rows] = list(map(float, weights))
    return exact


def _reach(image: HostImage, telling: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return (N, k + n), at least the size of each unknown without bounds in every behaviour: V; infinite
    where rows do not tell.
    """
    c, reach = len(image.R), np.full(free.shape, np.inf)
    own = free & (telling >= 0)
    # the few that are told, first: of large matrices the library's threads would wait for each other
    first = np.argsort(~own, axis=1, kind="stable")[:, : own.sum(1).max(initial=1)]
    own, rows = (np.take_along_axis(x, first, 1) for x in (own, np.maximum(telling, 0)))
    q = own.shape[1]
    F = np.take_along_axis(np.take_along_axis(image.columns, rows[:, :, None], 1), first[:, None], 2)
    both = own[:, :, None] & own[:, None, :]
    F = np.where(both, F, np.eye(q))
    usable = np.isfinite(F).all((1, 2)) & (np.linalg.cond(F, 1) < 1 / UNIT)
    P = np.linalg.inv(np.where(usable[:, None, None], F, np.eye(q)))
    size = np.abs(image.z) + image.radius[:c] + np.abs(image.R) @ image.radius[c:]
    size = size + image.gamma * image.magnitude + image.floor + image.off
    size = np.where(own, np.take_along_axis(size.T, rows, 1), 0)
    c_bound = (np.abs(P) @ size[:, :, None])[:, :, 0]
    c_bound = np.where(own, c_bound * (1 + 8 * q * UNIT) + LEAST, 0)
    rounded = np.abs(P) @ (UNIT * np.abs(F) + LEAST * (F != 0))
    G = np.abs(np.eye(q) - P @ F) + 4 * (q + 4) * (rounded + UNIT * np.eye(q))
    G = np.where(both, G, 0)
    # what has no telling row has no bound, and what shares rows with it neither
    blind = (free & (telling < 0)).any(1) | ~usable
    holds = np.all((G @ c_bound[:, :, None])[:, :, 0] <= 0.49 * c_bound, 1) & ~blind
    np.put_along_axis(reach, first, np.where(own & holds[:, None], 2 * c_bound * (1 + 1e-9), np.inf), 1)
    return reach
