"""The region of training: between which ends each input of a model moved in the data that it was fitted to.

Bounds that were found from data hold where the data were. A window that reads inputs outside of them has
bounds that are wider by a factor of the model, and by more the farther outside they lie
(`consistency.extrapolated`); what is said of it rests on extrapolation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple, Protocol

import jax
import numpy as np

from jaxbound.exact.linalg import Number
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import input_lags
from jaxbound.recordings.signals import SignalModel
from jaxbound.text.objects import readable

GRADES = 0.25, 0.5
"""Widths of its range that an input lies outside, from which on bounds are wider by one more power of the
factor. An air handler of two days needed three times its bounds on a third, at .4 widths, and no more at .1.
"""
ROUNDED = 1e-6
"""Share of a range that is no excess: computed signals and narrower floats round."""
UNIT = 2.0**-23
"""Relative step of float32, in which a recording may be kept."""
TOGETHER = 512
"""Samples that are compared at once."""
FEWEST, MOST = 4, 17  # digits of a number


class Reach(Protocol):
    """How far a verdict looks back, as Relations say it."""

    @property
    def model(self) -> SignalModel:
        """The plant, where there is one."""

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""

    @property
    def remembers(self) -> bool:
        """Whether verdicts rest on all samples before, as those of an observer."""


@readable
class Departure(NamedTuple):
    """How far windows lie outside the region of training.

    Fields: share: (..., T) the largest excess of an input over the samples that a window reads, in widths of
    its range; 0 inside, inf of an input that never moved in training, NaN where the window is MISSING. by:
    (..., T) the number of this input, -1 where none lies outside. reading: (..., T) its sample there, else
    NaN. region: that they are outside of.
    """

    share: np.ndarray
    by: np.ndarray
    reading: np.ndarray
    region: "Region"

    def cut(self, at: int | slice | np.ndarray | tuple[int, ...]) -> "Departure":
        """Return the same of some windows."""
        return Departure(self.share[at], self.by[at], self.reading[at], self.region)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of `by`, which is -1 where none is meant: that stands first."""
        return ("", *self.region.inputs)

    @property
    def grade(self) -> np.ndarray:
        """(..., T): how many of GRADES a window lies beyond, -1 inside."""
        return np.where(self.share > 0, _grade(self.share), -1)

    def words(self, at: int, test: str = "") -> str:
        """Return the words on one of (N,) windows, "" of one inside. test: see `Region.words`."""
        if not self.share[at] > 0:
            return ""
        return self.region.words(int(self.by[at]), float(self.reading[at]), test)


@jax.tree_util.register_static
@dataclass(frozen=True, eq=False)
class Region:
    """The region of training of a model's windows.

    Fields: inputs, units: of all inputs. lo, hi: (m,) their ends, NaN where none are stated. horizon: windows
    have horizon + 1 samples, of which they read the first `lags` of u. Those of an observer, which rests on
    all samples before, are of the step that led to the sample. wider: {test: its `extrapolation`, 1 where its
    bounds outside are as inside}; "" for the name of a single one.
    """

    inputs: tuple[str, ...]
    units: tuple[str, ...]
    lo: np.ndarray
    hi: np.ndarray
    horizon: int
    lags: int
    wider: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, relations: Reach) -> "Region | None":
        """Return the region of relations, or of an observer; None: their model states no range."""
        model = relations.model
        if not isinstance(model, LinearSystem) or not model.ranges:
            return None
        horizon = relations.horizon
        if relations.remembers:
            horizon = int(model.n > 0)
        tests = getattr(relations, "parts", {}) or {"": relations}
        wider = {name: _wider(part) for name, part in tests.items()}
        for part in tests.values():  # of a monitor as far as its longest window
            if not part.remembers:
                horizon = max(horizon, part.horizon)
        return replace(cls.between(model, model.ranges, horizon), wider=wider)

    @classmethod
    def between(
        cls, model: LinearSystem, ranges: Mapping[str, tuple[Number, Number]], horizon: int
    ) -> "Region":
        """Return the region of windows of a model, between the ends of some of its inputs."""
        nowhere = (np.nan, np.nan)
        lo, hi = np.array([ranges.get(name, nowhere) for name in model.inputs], float).reshape(-1, 2).T
        units = tuple(map(model.unit, model.inputs))
        return cls(model.inputs, units, lo, hi, horizon, input_lags(model, horizon))

    def departure(self, u: np.ndarray, missing: np.ndarray) -> Departure:
        """Return how far each window lies outside.

        Args:
            u: (..., T, m) or with factors behind, all samples that windows read; one that is missing is not
                outside.
            missing: (..., T) bool, windows without a verdict.

        An excess within the rounding of float32, or below a millionth of the range, is none.
        """
        share = np.zeros(missing.shape)
        by, reading = np.full(missing.shape, -1, np.int16), np.full(missing.shape, np.nan)
        for j in self._leaving(u):
            over, farthest = self._excess(np.asarray(u[..., j], np.float64), j)
            further = over > share
            share = np.where(further, over, share)
            by, reading = np.where(further, np.int16(j), by), np.where(further, farthest, reading)
        if missing.any():
            share[missing], by[missing], reading[missing] = np.nan, -1, np.nan
        return Departure(share, by, reading, self)

    def words(self, by: int, reading: float, test: str = "") -> str:
        """Return an input's sample outside, beside the end of its range.

        Args:
            test: the name of that which judged, of a monitor; "": of some of its tests.

        Example:
            >>> region = Region(("valve",), ("",), np.array([0.0]), np.array([0.39]), 0, 1)
            >>> region.words(0, 1.0)
            'valve at 1, training up to 0.39'
        """
        lo, hi = float(self.lo[by]), float(self.hi[by])
        side, end, over = "up to", hi, reading - hi
        if reading < lo:
            side, end, over = "from", lo, lo - reading
        if lo == hi:
            side = "always at"
        unit = f" {self.units[by]}".rstrip()
        return (
            f"{self.inputs[by]} at {_apart(reading, end)}{unit}, training {side} {_apart(end, reading)}{unit}"
            f"{self._wider_words(test, over / (hi - lo) if hi > lo else np.inf)}"
        )

    def _wider_words(self, test: str, share: float) -> str:
        """Return the words on bounds so many widths outside, "" where they are as inside."""
        factors = set(self.wider.values())
        if test in self.wider:
            factors = {self.wider[test]}
        most = max(factors, default=1.0)
        if most == 1:
            return ""
        at_most = "up to " * (len(factors) > 1)
        most **= 1 + int(_grade(share))
        return f", where bounds are {at_most}{most:.3g} times as wide"

    @cached_property
    def tolerated(self) -> np.ndarray:
        """(m,): the excess of each input that rounding explains."""
        largest = np.maximum(np.abs(self.lo), np.abs(self.hi))
        return np.asarray(np.maximum(ROUNDED * (self.hi - self.lo), UNIT * largest))

    def _leaving(self, u: np.ndarray) -> list[int]:
        """Return the inputs of which some sample (..., T, m) lies outside."""
        if not u.size:
            return []
        inputs = len(self.inputs)  # factors on bounds may stand behind them
        samples = np.asarray(u)[..., :inputs].reshape(-1, inputs)
        least, most = _extreme(np.fmin, samples), _extreme(np.fmax, samples)
        beyond = (least < self.lo - self.tolerated) | (most > self.hi + self.tolerated)
        return list(np.flatnonzero(beyond).tolist())

    def _excess(self, x: np.ndarray, j: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (excess of windows in widths of the range, the sample that has it) of an input (..., T)."""
        read = _later(x, self.horizon + 1 - self.lags)
        low, high = _trailing(np.fmin, read, self.lags), _trailing(np.fmax, read, self.lags)
        below, above = self.lo[j] - low, high - self.hi[j]
        excess = np.fmax(below, above)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(excess > self.tolerated[j], excess / (self.hi[j] - self.lo[j]), 0.0)
        return share, np.where(below > above, low, high)


def factors_outside(model: LinearSystem) -> tuple[Fraction, ...]:
    """Return how many times as wide the bounds of a model are before the first of GRADES and beyond each;
    none: as inside.
    """
    least = model.extrapolation or 1
    if least == 1:
        return ()
    return tuple(least**power for power in range(1, len(GRADES) + 2))


def text_outside(model: LinearSystem) -> str:
    """Return how wide the bounds of a model are outside, in words.

    Example:
        >>> text_outside(LinearSystem([[0.5]], [[1]], [[1]], extrapolation=1.2))
        '1.2 times as wide, and more the farther outside, up to 1.728 times'
    """
    factors = factors_outside(model)
    if not factors:
        return "as wide as inside"
    first, *_, last = map(float, factors)
    return f"{first:.6g} times as wide, and more the farther outside, up to {last:.6g} times"


def _grade(share: np.ndarray | float) -> np.ndarray:
    """Return how many of GRADES excesses in widths lie beyond."""
    return np.searchsorted(np.array(GRADES), share)


def _wider(test: Reach) -> float:
    """Return the `extrapolation` of a test; bounds of an observer stay."""
    model = test.model
    if test.remembers or not isinstance(model, LinearSystem):
        return 1.0
    return float(model.extrapolation or 1)


def _extreme(extreme: np.ufunc, samples: np.ndarray) -> np.ndarray:
    """Return the extreme of each column (m,) of samples (N, m), of many together: 100 times as fast."""
    whole = len(samples) // TOGETHER * TOGETHER
    if whole:
        rows = samples[:whole].reshape(-1, TOGETHER * samples.shape[1])
        first = extreme.reduce(rows, 0).reshape(TOGETHER, -1)
        samples = np.concatenate([first, samples[whole:]])
    return np.asarray(extreme.reduce(samples, 0))


def _later(x: np.ndarray, count: int) -> np.ndarray:
    """Return samples (..., T) so many samples later, NaN before them."""
    nothing = np.full((*x.shape[:-1], min(count, x.shape[-1])), np.nan)
    return np.concatenate([nothing, x[..., : x.shape[-1] - nothing.shape[-1]]], -1)


def _trailing(extreme: np.ufunc, x: np.ndarray, count: int) -> np.ndarray:
    """Return the extreme of each sample (..., T) and of those before it, so many together."""
    if not count:
        return np.full(x.shape, np.nan)
    together = 1
    while together < count:  # of twice as many each time: an extreme does not mind what it sees twice
        step = min(together, count - together)
        x = np.concatenate([x[..., :step], extreme(x[..., step:], x[..., : max(x.shape[-1] - step, 0)])], -1)
        together += step
    return x


def _apart(x: float, other: float) -> str:
    """Return a number with as many digits as tell it from another."""
    whole = len(str(int(min(abs(x), 1e15))))  # 12345, and not 1.234e+04
    for digits in range(max(FEWEST, whole), MOST):
        text = f"{x:.{digits}g}"
        if text != f"{other:.{digits}g}":
            return text
    return f"{x:.{MOST}g}"
