"""Windows outside the region of training, under the wider bounds that they have there.

All bounds of such a window are `extrapolation` times as wide as the model states them, by its square and its
cube the farther outside the inputs lie (`region.GRADES`). The window is judged by the same test under these
bounds: what is said of it is proved of them, as inside.

An observer carries one set from sample to sample: no window of it has bounds that could be wider, and its
verdicts are those of the bounds as stated.
"""

from dataclasses import dataclass, field
from fractions import Fraction
from typing import cast

import numpy as np

from jaxbound.consistency.interface import EXACT, Relations, WindowTest
from jaxbound.models.region import Region, factors_outside
from jaxbound.models.system import LinearSystem
from jaxbound.models.widths import widened, widened_ends
from jaxbound.sets.floats import rounding


@dataclass(frozen=True, eq=False)
class Extrapolated:
    """Relations outside of training. Fields: region: of training. inside: relations as they are stated."""

    region: Region
    inside: Relations
    made: dict[int, Relations] = field(default_factory=dict, repr=False)

    def relations(self, grade: int) -> Relations:
        """Return the relations under the bounds beyond so many of GRADES."""
        if grade not in self.made:
            self.made[grade] = self.inside.with_bounds(_wider(self.inside, grade))
        return self.made[grade]


def extrapolated(relations: Relations) -> Extrapolated | None:
    """Return relations as they are outside of training; None: bounds there are as they are inside."""
    # kinds of proofs know relations of others, and a stretch of an observer
    model, remembers = getattr(relations, "model", None), getattr(relations, "remembers", True)
    if not isinstance(model, LinearSystem) or not factors_outside(model) or remembers:
        return None
    region = Region.of(relations)
    if region is None:
        return None
    found = Extrapolated(region, relations)
    try:
        found.relations(0)
    except NotImplementedError:
        return None
    return found


class OutsideTest:
    """A test of windows outside of training. Fields: beyond: its relations there."""

    def __init__(self, test: WindowTest, beyond: Extrapolated) -> None:
        self.beyond, self._inside = beyond, test
        self._made: dict[int, WindowTest] = {}

    def test(self, grade: int) -> WindowTest:
        """Return the test under the bounds beyond so many of GRADES."""
        if grade not in self._made:
            other = self._inside.under(self.beyond.relations(grade))
            self._made[grade] = other.measured() if self._inside.margins_are == EXACT else other
        return self._made[grade]


def outside_test(test: WindowTest) -> OutsideTest | None:
    """Return the same test of windows outside of training; None: bounds there are as they are inside."""
    kind = test.margins_are
    if kind not in test.outside:  # made once: a stream asks at every sample
        beyond = extrapolated(test.relations)
        test.outside[kind] = None if beyond is None else OutsideTest(test, beyond)
    return cast(OutsideTest | None, test.outside[kind])


def _wider(relations: Relations, grade: int) -> dict[str, np.ndarray]:
    """Return the bounds beyond so many of GRADES. Ranges of uncertain parameters stay as they are."""
    model = cast(LinearSystem, relations.model)
    factor = factors_outside(model)[grade]
    # of relations, not of the model: `tune` may have moved them
    bounds = {name: tuple(map(Fraction, np.ravel(x).tolist())) for name, x in relations.bounds.items()}
    wider = {
        "noise": rounding.round_up(widened(bounds["noise"], factor, model.resolution)),
        "tolerance": np.minimum(rounding.round_up(widened(bounds["tolerance"], factor)), np.nextafter(1, 0)),
    }
    if "average" in bounds:
        rounds = tuple(average.rounded_away(model.outputs, model.resolution) for average in model.averages)
        wider["average"] = rounding.round_up(widened(bounds["average"], factor, rounds))
    if "disturbance" in bounds:
        ends = bounds["disturbance"]
        pairs = [widened_ends(ends[i : i + 2], factor) for i in range(0, len(ends), 2)]
        lo, hi = zip(*pairs, strict=True)
        wider["disturbance"] = np.stack([rounding.round_down(lo), rounding.round_up(hi)], 1)
    return wider
