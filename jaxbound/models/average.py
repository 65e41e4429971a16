"""Errors that average out: bounds on combinations of consecutive samples of a sensor's error, or of a
disturbance.

One bound a sample lets an error sit at its limit for a whole window. |v| <= b and |mean of 16 consecutive v|
<= b16 say more:

    |sum_k f_k v_(j+k)| <= bound        for every run of len(f) consecutive samples that lies in a window

One more row of the same exact test each. v is what a reading is off by, noise and rounding together: what is
rounded away adds its own part to the bound. Of a run with a missing sample nothing is said. Where the noise
of a sensor is times a factor f, so is the bound: times the mean of f over the run, by the weights.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.exact.linalg import Number, Vector
from jaxbound.models.numbers import is_whole, number
from jaxbound.models.rows import WeightedSum
from jaxbound.text.names import listed


@dataclass(frozen=True)
class Average:
    """A bound on a weighted sum of consecutive samples.

    Fields: signal: an output, or w1, w2, ..; weights: of the samples, the oldest first; bound: of the sum, in
    the unit of the signal.
    """

    signal: str
    weights: Vector
    bound: Fraction

    def place(self, outputs: Sequence[str]) -> tuple[bool, int]:
        """Return (whether it is of an output, the number of that output or disturbance)."""
        if self.signal in outputs:
            return True, list(outputs).index(self.signal)
        return False, int(self.signal[1:]) - 1

    def weighted_sum(self, outputs: Sequence[str]) -> WeightedSum:
        """Return the sum that is bounded, its signal by its number."""
        measured, number = self.place(outputs)
        return WeightedSum(measured, ((number, self.weights),))

    def rounded_away(self, outputs: Sequence[str], resolution: Vector) -> Fraction:
        """Return the part that rounding adds to the bound; of a disturbance, which nobody reads, 0."""
        measured, number = self.place(outputs)
        if not measured:
            return Fraction(0)
        return resolution[number] * sum(map(abs, self.weights), Fraction(0))

    @property
    def is_mean(self) -> bool:
        """Whether the sum is the mean of its samples."""
        # exact: 1/3 is a third, and no weights that are nearly equal are taken for a mean
        return set(self.weights) == {Fraction(1, len(self.weights))}

    @property
    def text(self) -> str:
        """The name of the sum, for a reader."""
        of = "mean" if self.is_mean else "weighted sum"
        return f"{of} of {len(self.weights)} samples of {self.signal}"


Averaged: TypeAlias = (
    Mapping[str, Mapping[int, Number] | Sequence[tuple[int | Sequence[Number], Number]]] | Sequence[Average]
)
"""{signal: {samples: bound on their mean} or [(weights, bound)]}."""


def averages_of(
    given: Averaged | None, outputs: Sequence[str], disturbance: Sequence[tuple[Fraction, Fraction]]
) -> tuple[Average, ...]:
    """Return the averages of a model, checked.

    Args:
        given: as the argument of a LinearSystem. outputs: names. disturbance: bounds (lo, hi).

    Raises:
        ValueError: an unknown signal, less than two samples, weights that are all 0, a bound that is not >=
            0, a bound under which a disturbance could not last.
    """
    bounds = {f"w{j + 1}": ends for j, ends in enumerate(disturbance)}
    averages = []
    for signal, weights, bound in _stated_averages(given):
        if signal not in (*outputs, *bounds):
            raise ValueError(
                f"averages speak of {signal!r}, but they are of outputs and disturbances: "
                f"{listed((*outputs, *bounds), str)}"
            )
        average = Average(
            signal,
            tuple(number(f"weights of an average of {signal!r}", x) for x in weights),
            number(f"bound of an average of {signal!r}", bound),
        )
        _refuse(average, bounds.get(signal))
        averages.append(average)
    return tuple(averages)


def _refuse(average: Average, ends: tuple[Fraction, Fraction] | None) -> None:
    """Raise ValueError for an average that says nothing, or too much. ends: bounds of a disturbance."""
    signal, weights, bound = average.signal, average.weights, average.bound
    if len(weights) < 2 or not weights[0] or not weights[-1]:
        raise ValueError(
            f"an average of {signal!r} needs two samples or more, the first and last of weights other than 0"
        )
    if bound < 0:
        raise ValueError(f"the bound of the {average.text} must be >= 0, not {float(bound):g}")
    # an error of a sensor, and a disturbance that may be 0, can always keep a bound
    if ends is None or ends[0] <= 0 <= ends[1]:
        return
    lo, hi = ends
    least = abs(sum(weights, Fraction(0))) * min(abs(lo), abs(hi))  # of a disturbance that lasts
    if least > bound:
        raise ValueError(
            f"no constant {signal} in [{float(lo):g}, {float(hi):g}] keeps the {average.text} within "
            f"{float(bound):g}"
        )


def _pairs(
    signal: str, stated: Mapping[int, Number] | Sequence[tuple[int | Sequence[Number], Number]]
) -> list[tuple[int | Sequence[Number], Number]]:
    """Return [(samples or weights, bound)] of a signal."""
    if isinstance(stated, Mapping):
        return list(stated.items())
    try:
        return [(weights, bound) for weights, bound in stated]
    except (TypeError, ValueError):
        raise ValueError(
            f"averages of {signal!r} must be a table, like {{16: 0.1}}, or a list of (weights, bound), like "
            f"[([1, 1, -1, -1], 0.1)], not {stated!r}"
        ) from None


def _stated_averages(given: Averaged | None) -> list[tuple[str, Sequence[Number], Number]]:
    """Return [(signal, weights, bound)] of averages in any of their forms."""
    if given is None:
        return []
    rows: list[tuple[str, Sequence[Number], Number]] = []
    if isinstance(given, Mapping):
        for signal, stated in given.items():
            for samples, bound in _pairs(signal, stated):
                rows.append((str(signal), _weights(signal, samples), bound))
        return rows
    given_ones: Iterable[object] = (given,)
    if isinstance(given, Iterable):
        given_ones = given
    for average in given_ones:
        if not isinstance(average, Average):
            raise ValueError(
                f"averages must be a table, like {{'T1': {{16: 0.1}}}}: 16 samples of the error of T1 have a "
                f"mean of at most 0.1; not {given!r}"
            )
        rows.append((average.signal, average.weights, average.bound))
    return rows


def _weights(signal: str, samples: int | Sequence[Number]) -> Sequence[Number]:
    """Return the weights of a sum: as stated, or those of the mean of so many samples."""
    if np.ndim(cast("ArrayLike", samples)) > 0:
        return cast("Sequence[Number]", samples)
    if not is_whole(samples) or samples < 2:
        raise ValueError(
            f"averages of {signal!r} need a whole number of samples >= 2, or weights, not {samples!r}"
        )
    return [Fraction(1, int(samples))] * int(samples)
