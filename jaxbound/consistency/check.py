"""The check: what multipliers, or unknowns, prove of windows, in NumPy: in float64 or in whole numbers.

Rows y_outer = R y_inner + K u hold whatever is missing. A row without a sample bounds nothing; an inner row
without one, or a missing input, is an unknown f without bounds, whose column F is one of R or of K:

    |z - R d - F f| <= r (outer rows with a sample),   |d| <= r (inner rows with one).

Any (d, f) that satisfies all rows proves a window consistent. Any h with

    |h z| > sum |h_j| r_j + sum |h R|_i r_i + sum |h F|_a V_a

proves it inconsistent, if |f| <= V in every behaviour. Errors of float64 are those of
`rounding.search_error`, twice for an h that is rounded. In whole numbers there are none: then h F has to be
0, and the outer rows, R and K are times a number that makes R and K whole.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from jaxbound.consistency.host_rows import Ends, HostRows, doubles
from jaxbound.consistency.reading import Reading
from jaxbound.consistency.strips_on_host import excludes_0
from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.linalg import over_one
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding

ALONE = 2**19
"""Products of numbers that one thread sums up: for more the library starts threads, which wait for each other
where others are at work, five times as long as they compute."""
UNIT, LEAST = float(rounding.unit(np.float64)), float(rounding.tiny(np.float64))
"""The unit roundoff of float64, and the smallest normal number."""


@dataclass(frozen=True, eq=False)
class HostImage:
    """The rows of N windows, ordered as a frame has them, windows on the last axis.

    Fields: R (c, k), K (c, l): of the frame, times `scale`; lo, hi, there (c + k, N): ends of the outer rows,
    then of the inner ones, and which have a sample; known (l, N): inputs, 0 where missing; lost (l, N): which
    are missing and used by a row that is there; most: of one window at most; off (c, N): how far rows may be
    off since inputs were rounded; size (k, N), magnitude (c, N): what rounding errors of inner rows, and of
    z, are relative to; gamma, floor (N,): of `rounding.search_error`, 0 of whole numbers; left (c, 1): at
    least what these leave out of the bounds of what a multiplier of 1 weighs; start (c + k, N): as of
    `middle`, or None.
    """

    R: np.ndarray
    K: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    there: np.ndarray
    known: np.ndarray
    lost: np.ndarray
    most: int
    off: np.ndarray
    size: np.ndarray
    magnitude: np.ndarray
    gamma: float
    floor: np.ndarray
    scale: int = 1
    left: Ends = 0
    start: np.ndarray | None = None

    @classmethod
    def of(cls, reading: Reading, u: np.ndarray, y: np.ndarray, certain: bool = False) -> Self:
        """Return the rows of windows u (lags, m, N), y (s + 1, p, N) in float64, as the frame of a reading
        orders them; certain: as of `HostRows`.
        """
        frame, rows = reading.frame, HostRows(reading, u, y, certain)
        R, K, order = doubles(frame.R), doubles(frame.K), np.concatenate([frame.outer, frame.inner])
        of_rows, of_inputs = rows.sizes()
        outer, inner = of_rows[order[: len(R)]], of_rows[order[len(R) :]]
        gamma, floor = map(float, rounding.search_error(len(R), len(R.T), len(K.T), np.float64))
        # an underflow may be multiplied by a number of R or K on its way into a row
        largest = 1 + max(np.abs(R).max(initial=0), np.abs(K).max(initial=0))
        floors = floor * largest * largest * (1 + outer.sum(0) + inner.sum(0) + of_inputs.sum(0))
        magnitude = outer + _times(np.abs(R), inner) + _times(np.abs(K), of_inputs)
        ends = cls._ends(rows, R, K, order)
        # the sum of slips is itself a sum of rounded numbers
        ends["off"] = (1 + gamma) * ends["off"]
        return cls(R, K, **ends, size=inner, magnitude=magnitude, gamma=gamma, floor=floors)

    @classmethod
    def whole(
        cls, model: LinearSystem, reading: Reading, frame: ExactFrame, u: np.ndarray, y: np.ndarray
    ) -> Self:
        """Return the rows of windows of a model in whole numbers."""
        rows, c, k = HostRows(reading, u, y, model=model), len(frame.outer), len(frame.inner)
        # one number for all rows: a combination of them stays whole
        numbers, scale = over_one([*frame.R, *frame.K])
        R, K = np.array(numbers[:c], object).reshape(c, k), np.array(numbers[c:], object).reshape(c, -1)
        order = np.array([*frame.outer, *frame.inner], int)
        size, magnitude, floor = (np.zeros((count, y.shape[2])) for count in (k, c, 1))
        # what a row leaves out of its bound reaches z through the row, and through those of R
        left = rows.floor() * (scale + np.abs(R).sum(1, keepdims=True))
        return cls(
            R,
            K,
            **cls._ends(rows, R, K, order),
            size=size,
            magnitude=magnitude,
            gamma=0,
            floor=floor[0],
            scale=scale,
            left=left,
        )

    @staticmethod
    def _ends(rows: HostRows, R: np.ndarray, K: np.ndarray, order: np.ndarray) -> dict[str, Any]:
        """Return the fields that have no rounding errors."""
        there = ~rows.absent()[order]
        lo, hi = (np.where(there, x[order], 0) for x in rows.ends())
        known, slips, missing = rows.known()
        lost = missing
        if missing.any():
            # an input that no row here looks at may be anything, and is no unknown
            lost = missing & ((K != 0).T.astype(float) @ there[: len(R)] > 0)
        off = _times(np.abs(K), np.where(missing, 0, slips))
        known, most = np.where(missing, 0, known), int(lost.sum(0).max(initial=0))
        return {"lo": lo, "hi": hi, "there": there, "known": known, "lost": lost, "most": most, "off": off}

    def of_windows(self, part: np.ndarray | slice) -> Self:
        """Return the rows of some windows."""
        names = "lo", "hi", "there", "known", "lost", "off", "size", "magnitude", "floor"
        start = None if self.start is None else self.start[..., part]
        return replace(self, start=start, **{name: getattr(self, name)[..., part] for name in names})

    def known_with(self, lost: np.ndarray) -> np.ndarray:
        """Return the inputs (l, N), those that are lost (n, N) from `known` on."""
        # a row more, into which windows with fewer lost inputs write
        known = np.concatenate([self.known, np.zeros((1, self.known.shape[1]), self.known.dtype)])
        np.put_along_axis(known, self.slots, np.take_along_axis(known, self.slots, 0) + lost, 0)
        return known[:-1]

    @property
    def exact(self) -> bool:
        """Whether these are whole numbers."""
        return self.lo.dtype == object

    @property
    def hull(self) -> "HostImage":
        """The same with ends that hold in every behaviour."""
        return self

    def excludes(self, weights: np.ndarray, value: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Return (N,) bool: whether weighted rows (c + k, N), less a value, are never 0, even off by an
        error.
        """
        low, high = weights * self.lo, weights * self.hi
        return excludes_0(np.minimum(low, high).sum(0) - value, np.maximum(low, high).sum(0) - value, error)

    @cached_property
    def middle(self) -> np.ndarray:
        """(c + k, N): what unknowns are counted from: the middles of rows, 0 without a sample, or `start`."""
        if self.start is not None:
            return self.start
        return self._half(self.lo + self.hi)

    @cached_property
    def radius(self) -> np.ndarray:
        """(c + k, N): the radii of rows, 0 without a sample."""
        return self._half(self.hi - self.lo)

    def _half(self, x: np.ndarray) -> np.ndarray:
        """Return half of numbers, which whole ones have."""
        if self.exact:
            return np.asarray(x // 2)
        return np.asarray(x / 2)

    @cached_property
    def z(self) -> np.ndarray:
        """(c, N): `scale` times what outer rows are beyond those that the middles of inner ones give."""
        c = len(self.R)
        return np.asarray(
            self.scale * self.middle[:c] - _times(self.R, self.middle[c:]) - _times(self.K, self.known)
        )

    @cached_property
    def slots(self) -> np.ndarray:
        """(n, N): the numbers of the inputs that are lost, then l."""
        # stable: the lost ones come first, in their order
        order = np.argsort(~self.lost, axis=0, kind="stable")[: self.most]
        return np.where(np.take_along_axis(self.lost, order, 0), order, len(self.lost))

    @cached_property
    def columns(self) -> np.ndarray:
        """(N, c, k + n): the columns of d, or f, of inner rows, then those of lost inputs; 0 in rows that are
        not there.
        """
        c, N = len(self.R), self.lo.shape[1]
        R, K = ((M / self.scale).astype(float) for M in (self.R, self.K))
        lost = np.concatenate([K, np.zeros((c, 1))], 1)[:, self.slots].transpose(2, 0, 1)
        whole = np.concatenate([np.broadcast_to(R, (N, *R.shape)), lost], 2)
        # a row without a sample tells nothing of any unknown
        return np.where(self.there[:c].T[:, :, None], whole, 0)

    @cached_property
    def free(self) -> np.ndarray:
        """(N, k + n): which columns are unknowns without bounds."""
        c = len(self.R)
        return np.concatenate([~self.there[c:].T, self.slots.T < len(self.lost)], 1)

    @cached_property
    def acting(self) -> np.ndarray:
        """(N, k + n): which of these act on an outer row."""
        return self.free & self.columns.any(1)


def contradicted_by(reading: Reading, u: np.ndarray, y: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows u (lags, m, N), y (s + 1, p, N) are contradicted by combinations h (c,
    N) of the outer rows of the frame of a reading: whatever they are, what is said here is proved. Of a
    window that lacks an inner row, or an input, nothing is said.
    """
    image = HostImage.of(reading, u, y)
    return contradicted(image, doubles(h), np.where(image.free, np.inf, 0))


def contradicted(image: HostImage, h: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows combinations h (c, N) contradict, each number of them rounded once.

    Args:
        reach: (N, k + n), of unknowns without bounds their V; 0 where h cancels them exactly.
    """
    (c, k), h = image.R.shape, np.where(image.there[: len(h)], h, 0)
    # y_outer - R y_inner = K u: h weighs outer rows, and -R'h the inner ones
    weights = np.concatenate([image.scale * h, np.where(image.there[c:], -_times(image.R.T, h), 0)])
    value = (_times(image.K.T, h) * image.known).sum(0)
    off = image.off + image.left
    if not image.exact:
        # twice: h was rounded once as well
        off = off + 2 * image.gamma * image.magnitude + image.floor
    error = (np.abs(h) * off).sum(0)
    if not image.exact:
        error = error + image.floor
        if reach.any():
            error = error + _leaked(image, h, reach)
        # the sums of this bound are rounded too
        error = error * (1 + 64 * (c + k) * UNIT)
    return image.excludes(weights, value, error)


def _leaked(image: HostImage, h: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return (N,), at least what unknowns without bounds add to combinations; infinite where the reach of one
    is not known.
    """
    F = np.where(image.free[:, None, :], image.columns, 0)
    through = np.abs(np.einsum("jn,njf->nf", h, F))
    # entries of F may be off by LEAST, see `rounding.nearest_normals`
    rounded = UNIT * np.abs(F) + LEAST * (F != 0)
    through += 4 * (len(h) + 4) * np.einsum("jn,njf->nf", np.abs(h), rounded)
    through += LEAST * np.einsum("jn,njf->nf", h != 0, F != 0)
    return np.asarray(np.where(through * reach > 0, through * reach, 0).sum(1))


def explained(image: HostImage, x: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows x (k + n, N), the deviations of inner rows and of lost inputs from what
    they are taken for, explains.
    """
    c, k = image.R.shape
    known, inner = image.known_with(x[k:]), image.middle[c:] + x[:k]
    values = np.concatenate([_times(image.R, inner) + _times(image.K, known), inner])
    error = np.zeros(values.shape, values.dtype)
    if not image.exact:
        sizes = _times(np.abs(image.R), np.abs(inner)) + _times(np.abs(image.K), np.abs(known))
        sizes = np.concatenate([image.magnitude + sizes, image.size + np.abs(inner)])
        # unknowns of any size: what rounding adds is relative to what they are, not to the samples
        error = image.gamma * sizes + image.floor * (1 + sizes.sum(0) + np.abs(known).sum(0))
    error[:c] += image.off
    scale = np.where(np.arange(c + k) < c, np.array(image.scale, values.dtype), 1)[:, None]
    within = (scale * image.lo + error <= values) & (values <= scale * image.hi - error)
    return np.asarray(np.all(within.astype(bool) | ~image.there, 0))


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return A x (a, N), as many columns at a time as one thread works out: rows of x whole in memory."""
    x, count = np.ascontiguousarray(x), max(1, ALONE // max(1, A.size))
    out = np.empty((len(A), x.shape[1]), x.dtype)
    for first in range(0, x.shape[1], count):
        np.matmul(A, x[:, first : first + count], out=out[:, first : first + count])
    return out
