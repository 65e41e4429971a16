"""Windows outside the region of training, under the wider bounds that they have there.

All bounds of such a window are `extrapolation` times as wide as the model states them. The window is judged
by the same test under these bounds: what is said of it is proved of them, as inside.

An observer carries one set from sample to sample: no window of it has bounds that could be wider, and its
verdicts are those of the bounds as stated.
"""

from fractions import Fraction
from typing import NamedTuple, cast

import numpy as np

from jaxbound.consistency.interface import EXACT, Relations, WindowTest
from jaxbound.models.region import Region
from jaxbound.models.system import LinearSystem
from jaxbound.models.widths import widened, widened_ends
from jaxbound.sets.floats import rounding


class Extrapolated(NamedTuple):
    """The region of training, and relations under the bounds that windows outside it have."""

    region: Region
    relations: Relations


def extrapolated(relations: Relations) -> Extrapolated | None:
    """Return relations as they are outside of training; None: bounds there are as they are inside."""
    model = getattr(relations, "model", None)  # kinds of proofs know relations of others
    if not isinstance(model, LinearSystem) or (model.extrapolation or 1) == 1 or relations.remembers:
        return None
    region = Region.of(relations)
    if region is None:
        return None
    try:
        return Extrapolated(region, relations.with_bounds(_wider(relations, model)))
    except NotImplementedError:
        return None


def outside_test(test: WindowTest) -> tuple[Region, WindowTest] | None:
    """Return the region of training of a test and the same test of windows outside; None: bounds there are as
    they are inside.
    """
    kind = test.margins_are
    if kind not in test.outside:  # made once: a stream asks at every sample
        test.outside[kind], found = None, extrapolated(test.relations)
        if found is not None:
            other = test.under(found.relations)
            test.outside[kind] = found.region, other.measured() if kind == EXACT else other
    return cast(tuple[Region, WindowTest] | None, test.outside[kind])


def _wider(relations: Relations, model: LinearSystem) -> dict[str, np.ndarray]:
    """Return the bounds outside of training. Ranges of uncertain parameters stay as they are."""
    factor = model.extrapolation or Fraction(1)
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
