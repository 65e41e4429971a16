"""Rows of a window: each is one line of what its samples and bounds say.

    lo <= sum of weights times true values <= hi

| kind | true values | lo, hi |
|---|---|---|
| READING | one output at one sample | from the reading, its tolerance, noise, resolution and rounding |
| DISTURBANCE | one disturbance at one sample | from its bounds |
| SUM | consecutive samples of outputs, or of disturbances | from a bound on a weighted sum of errors |

A row says where its values stand; the numbers lo and hi belong to samples and bounds. Three evaluators work
them out: `consistency.reading` in floats inside kernels, `consistency.host_rows` in NumPy, in floats or whole
numbers, and `certificates.checker` in fractions. What else is known of each sample, as a factor on its
bound would be, reaches them beside the samples, at the places that a row names. How the plant ties true
values together is no matter of rows (`window.unknowns`): matrices may change from sample to sample and rows
stay.

Rows are time-major: outputs y_k, then y_{k+1}, ..; disturbances w_k .. w_{k+s-1}; then sums, one bound after
the other. With lags a sum is looked at where it ends at a sample that is looked at; it uses every sample of
its run.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

import numpy as np

from jaxbound.exact.linalg import Vector

ONE = (Fraction(1),)


class Kind(Enum):
    """Kinds of rows: they differ in how lo and hi come about."""

    READING = "reading"
    DISTURBANCE = "disturbance"
    SUM = "sum"


@dataclass(frozen=True)
class WeightedSum:
    """A weighted sum of consecutive samples of some signals.

    Fields: measured: whether of outputs, else of disturbances; parts: ((number of the signal, weights), ..),
    the oldest sample first, as many weights for each signal, no signal twice.
    """

    measured: bool
    parts: tuple[tuple[int, Vector], ...]

    @property
    def samples(self) -> int:
        """Number of consecutive samples."""
        return len(self.parts[0][1])

    @property
    def terms(self) -> int:
        """Number of all weights."""
        return self.samples * len(self.parts)

    @property
    def size(self) -> Fraction:
        """The sum of the magnitudes of all weights."""
        return sum((self.size_of(signal) for signal, _ in self.parts), Fraction(0))

    def size_of(self, number: int) -> Fraction:
        """Return the sum of the magnitudes of the weights of one signal."""
        return self._sizes.get(number, Fraction(0))

    @cached_property
    def _sizes(self) -> dict[int, Fraction]:
        sizes: dict[int, Fraction] = defaultdict(Fraction)
        for signal, weights in self.parts:
            sizes[signal] += sum(map(abs, weights))
        return sizes


class Term(NamedTuple):
    """One true value of a row, and its weight. Fields: row: number of the value's own row in the window."""

    row: int
    measured: bool
    number: int
    sample: int
    weight: Fraction


@dataclass(frozen=True)
class Row:
    """One line of a window. Fields: kind; number: of its output, disturbance or bounded sum; first: sample of
    the window with which it begins; values: what it weighs; seen: whether the window looks at it.
    """

    kind: Kind
    number: int
    first: int
    values: WeightedSum
    seen: bool = True

    @property
    def last(self) -> int:
        """The last sample that it speaks of."""
        return self.first + self.values.samples - 1


@dataclass(frozen=True)
class WindowRows:
    """All rows of windows of horizon + 1 samples. Build it with `window.window_rows`.

    Fields: outputs, disturbances: how many; horizon; lags: so many samples before its last a window looks at
    outputs, None: always; sums: what bounds speak of beside single samples.
    """

    outputs: int
    disturbances: int
    horizon: int
    lags: tuple[int, ...] | None = None
    sums: tuple[WeightedSum, ...] = ()

    def __hash__(self) -> int:
        """Return a hash of sizes alone: kernels ask for it at each call, and fractions are slow to hash."""
        return hash((self.outputs, self.disturbances, self.horizon, self.lags, len(self.sums)))

    def __iter__(self) -> Iterator[Row]:
        return iter(self.all)

    def __len__(self) -> int:
        return self.single + sum(len(self.runs(number)) for number in range(len(self.sums)))

    @property
    def readings(self) -> int:
        """Number of rows that are readings: the first ones."""
        return (self.horizon + 1) * self.outputs

    @property
    def single(self) -> int:
        """Number of rows that speak of one sample: all before the sums."""
        return self.readings + self.horizon * self.disturbances

    @cached_property
    def all(self) -> tuple[Row, ...]:
        """Every row, in order."""
        rows = []
        of_output = [WeightedSum(True, ((i, ONE),)) for i in range(self.outputs)]
        for sample in range(self.horizon + 1):
            for i, values in enumerate(of_output):
                rows.append(Row(Kind.READING, i, sample, values, self.looked_at(sample)))
        of_disturbance = [WeightedSum(False, ((j, ONE),)) for j in range(self.disturbances)]
        # the last sample of a window is moved by no disturbance of it: w acts on the next state
        for sample in range(self.horizon):
            for j, values in enumerate(of_disturbance):
                rows.append(Row(Kind.DISTURBANCE, j, sample, values))
        for number in range(len(self.sums)):
            rows.extend(self.runs(number))
        return tuple(rows)

    @property
    def of_sums(self) -> tuple[Row, ...]:
        """The rows of sums, the last ones."""
        return self.all[self.single :]

    def runs(self, number: int) -> list[Row]:
        """Return the rows of one sum: all runs of its samples that lie in a window."""
        values = self.sums[number]
        samples = self.horizon + 1 if values.measured else self.horizon
        rows = []
        for first in range(samples - values.samples + 1):
            # nobody measures a disturbance: its sums are looked at wherever they lie
            seen = not values.measured or self.looked_at(first + values.samples - 1)
            rows.append(Row(Kind.SUM, number, first, values, seen))
        return rows

    def looked_at(self, sample: int) -> bool:
        """Return whether a window looks at the outputs at one of its samples."""
        return self.lags is None or self.horizon - sample in self.lags

    @cached_property
    def seen(self) -> tuple[int, ...]:
        """The numbers of the rows that the window looks at."""
        return tuple(i for i, row in enumerate(self.all) if row.seen)

    def terms(self, row: Row) -> list[Term]:
        """Return the true values that a row weighs, signal by signal."""
        found = []
        before, width = (0, self.outputs) if row.values.measured else (self.readings, self.disturbances)
        for number, weights in row.values.parts:
            for sample, weight in enumerate(weights, row.first):
                own = before + sample * width + number
                found.append(Term(own, row.values.measured, number, sample, weight))
        return found

    @cached_property
    def kept(self) -> np.ndarray:
        """(s + 1,) bool: the samples at which a window looks at the outputs."""
        return np.array([self.looked_at(sample) for sample in range(self.horizon + 1)], bool)

    @cached_property
    def used(self) -> np.ndarray:
        """(s + 1, p) bool: the samples of outputs that are looked at, alone or in a sum."""
        used = np.repeat(self.kept[:, None], self.outputs, 1)
        for row in self.of_sums:
            if row.values.measured:
                for i, _ in row.values.parts:
                    # of every run, looked at or not: the largest sample is then never too small
                    used[row.first : row.last + 1, i] = True
        return used

    def absent(self, y: np.ndarray) -> np.ndarray:
        """Return (rows, N) bool: which rows windows y (s + 1, p, N) lack: not looked at, or without a
        sample.
        """
        missing, N = np.isnan(y), y.shape[2]
        absent = np.zeros((len(self), N), bool)
        # rows are time-major, as y is
        absent[: self.readings] = (missing | ~self.kept[:, None, None]).reshape(-1, N)
        for number, row in enumerate(self.of_sums, self.single):
            if not row.seen:
                absent[number] = True
            elif row.values.measured:
                for i, _ in row.values.parts:
                    absent[number] |= missing[row.first : row.last + 1, i].any(0)
        return absent
