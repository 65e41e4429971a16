"""Errors that average out: bounds on combinations of consecutive samples of a sensor's error, or of a
disturbance.

One bound a sample lets an error sit at its limit for a whole window. |v| <= b and |mean of 16 consecutive v|
<= b16 say more:

    |sum_k f_k v_(j+k)| <= bound        for every run of len(f) consecutive samples that lies in a window

One more row of the same exact test each. v is what a reading is off by, noise and rounding together: what is
rounded away adds its own part to the bound. Of a run with a missing sample nothing is said.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from jaxbound.exact.linalg import Number, Vector
from jaxbound.models.plant import number
from jaxbound.models.rows import WeightedSum
from jaxbound.text.names import listed

__all__ = ["Average", "Averaged", "averages_of"]


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
        measured = self.signal in outputs
        return measured, list(outputs).index(self.signal) if measured else int(self.signal[1:]) - 1

    def weighted_sum(self, outputs: Sequence[str]) -> WeightedSum:
        """Return the sum that is bounded, its signal by its number."""
        measured, number = self.place(outputs)
        return WeightedSum(measured, ((number, self.weights),))

    @property
    def is_mean(self) -> bool:
        """Whether the sum is the mean of its samples."""
        return set(self.weights) == {Fraction(1, len(self.weights))}

    @property
    def text(self) -> str:
        """The name of the sum, for a reader."""
        of = "mean" if self.is_mean else "weighted sum"
        return f"{of} of {len(self.weights)} samples of {self.signal}"


Averaged: TypeAlias = Mapping[str, Mapping[int, Number] | Sequence[tuple[Any, Number]]] | Sequence[Average]
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
    out: list[Average] = []
    for signal, weights, bound in _listed(given):
        if signal not in (*outputs, *bounds):
            raise ValueError(
                f"averages speak of {signal!r}, but they are of outputs and disturbances: "
                f"{listed((*outputs, *bounds), str)}"
            )
        one = Average(
            signal,
            tuple(number(f"weights of an average of {signal!r}", x) for x in weights),
            number(f"bound of an average of {signal!r}", bound),
        )
        if len(one.weights) < 2 or not one.weights[0] or not one.weights[-1]:
            raise ValueError(
                f"an average of {signal!r} needs two samples or more, the first and last of weights other "
                f"than 0"
            )
        if one.bound < 0:
            raise ValueError(f"the bound of the {one.text} must be >= 0, not {float(one.bound):g}")
        lo, hi = bounds.get(signal, (Fraction(0), Fraction(0)))
        total = abs(sum(one.weights, Fraction(0))) * (Fraction(0) if lo <= 0 <= hi else min(abs(lo), abs(hi)))
        if total > one.bound:
            raise ValueError(
                f"no constant {signal} in [{float(lo):g}, {float(hi):g}] keeps the {one.text} within "
                f"{float(one.bound):g}"
            )
        out.append(one)
    return tuple(out)


def _listed(given):
    """Return [(signal, weights, bound)] of whatever form is given."""
    if given is None:
        return []
    if not isinstance(given, Mapping):
        if not all(isinstance(a, Average) for a in given):
            raise ValueError(
                "averages must be a table, like {'T1': {16: 0.1}}: 16 samples of the error of T1 have a mean "
                "of at most 0.1"
            )
        return [(a.signal, a.weights, a.bound) for a in given]
    found = []
    for signal, said in given.items():
        for samples, bound in said.items() if isinstance(said, Mapping) else said:
            if np.ndim(samples) == 0:
                if isinstance(samples, bool) or not isinstance(samples, (int, np.integer)) or samples < 2:
                    raise ValueError(
                        f"averages of {signal!r} need a whole number of samples >= 2, or weights, not "
                        f"{samples!r}"
                    )
                samples = [Fraction(1, int(samples))] * int(samples)
            found.append((str(signal), samples, bound))
    return found
