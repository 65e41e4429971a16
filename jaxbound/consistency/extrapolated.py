"""Windows outside the region of training, under the wider bounds that they have there.

All bounds of such a window are `extrapolation` times as wide as the model states them. The window is judged
by the same test under these bounds: what is said of it is proved of them, as inside.

An observer carries one set from sample to sample: no window of it has bounds that could be wider, and its
verdicts are those of the bounds as stated.
"""

from typing import NamedTuple, cast

import numpy as np

from jaxbound.consistency.interface import EXACT, Relations, WindowTest
from jaxbound.models.region import Region
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding

UP = 1 + 8 * np.finfo(float).eps
"""What rounding may take from a product and a sum."""


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
    factor = float(model.extrapolation or 1)
    bounds = {name: np.asarray(bound) for name, bound in relations.bounds.items()}
    rounds = rounding.round_up(list(model.resolution))  # beside the bounds: it stays, and they grow for it
    wider = {
        "noise": (factor * bounds["noise"] + (factor - 1) * rounds) * UP,
        "tolerance": np.minimum(factor * bounds["tolerance"] * UP, np.nextafter(1, 0)),
    }
    if "average" in bounds:
        more = np.zeros(len(model.averages))
        for number, average in enumerate(model.averages):
            measured, signal = average.place(model.outputs)
            if measured:
                more[number] = rounds[signal] * float(sum(map(abs, average.weights)))
        wider["average"] = (factor * bounds["average"] + (factor - 1) * more) * UP
    if "disturbance" in bounds:
        lo, hi = bounds["disturbance"].T
        more = (factor - 1) / 2 * (hi - lo) * UP
        wider["disturbance"] = np.stack([lo - more, hi + more], 1)
    return wider
