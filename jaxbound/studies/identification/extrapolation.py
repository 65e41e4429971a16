"""How much wider bounds have to be outside of training, by recordings that are left out.

A recording that is left out moves its inputs beyond the others. The largest need of its windows there, over
the largest of those within the ranges of the others, is what extrapolation costs on that day, the root of it
where bounds have a higher power of the factor; bounds of 1 hold whatever the days ask for. Of several days
the geometric mean counts, as of the factor on all bounds: a day that is unlike the others is so inside, too.
Few days say little of it: what two of them told of a third was 1.0 where it needed 1.5 (an air handler), or
six (a plant that is not linear).
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxbound.models.region import Region
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import Trial, few_days
from jaxbound.studies.tuning.widening import stated

FEW_DAYS_OUTSIDE = 1.5
"""Factor for two recordings on top of what they ask for outside, its root of order n - 1 for n."""


class Extrapolation(NamedTuple):
    """The factor on bounds outside of training, how many windows of how many recordings tell it, and the
    factor for few recordings in it.
    """

    factor: float
    windows: int
    recordings: int
    few: float

    @property
    def text(self) -> str:
        """The words of its provenance."""
        few = f"times {self.few:.3g} for so few recordings"
        if not self.recordings:
            return f"assumed: {few}: none, left out, reaches beyond the others"
        many = f"{self.windows} windows of {self.recordings} recording{'s' * (self.recordings > 1)}"
        told = f"needs of {many} outside the ranges of the others, over those inside"
        return f"fitted: {told}, {few}"


def extrapolation(trial: Trial, training: Training) -> Extrapolation | None:
    """Return the factor that windows outside the ranges of other recordings ask for, and few of
    them; None: nothing was left out whole, or no wider bounds are asked for.

    Args:
        trial: of windows. An observer rests on all samples before, which lie on both sides.
    """
    logs, windows, records = [], 0, training.records
    if not trial.left:
        return None
    left = trial.left
    if len(left) != len(records):  # blocks of one recording, which say nothing of another day
        left = ()
    for number, (one, (u, _, _)) in enumerate(zip(left, records, strict=False)):
        if one.model is None:
            continue
        model = LinearSystem(**one.model, noise=trial.bound.tolist())
        assert model.horizon is not None, "an observer has none"
        others = dataclasses.replace(training, records=[*records[:number], *records[number + 1 :]])
        region = Region.between(model, others.ranges, model.horizon)
        known = np.isfinite(one.need)
        grade = region.departure(u, ~known).grade
        out = grade >= 0
        if out.any() and (known & ~out).any():
            needs = np.maximum(one.need[out] / max(one.need[known & ~out].max(), 1.0), 1.0)
            logs.append(float((np.log(needs) / (1 + grade[out])).max()))
            windows += int(out.sum())
    few = few_days(len(records), FEW_DAYS_OUTSIDE)
    factor = few * math.exp(sum(logs) / max(len(logs), 1))
    if stated(factor) == 1:
        return None
    return Extrapolation(factor, windows, len(logs), few)
