"""How much wider bounds have to be outside of training, by recordings that are left out.

A recording that is left out moves its inputs beyond the others. The largest need of its windows there, over
the largest of those within the ranges of the others, is what extrapolation costs on that day; bounds of 1
hold whatever the days ask for. Of several days the geometric mean counts, as of the factor on all bounds: a
day that is unlike the others is so inside, too.
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from jaxbound.models.region import Region
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import Trial
from jaxbound.studies.tuning.widening import stated


class Extrapolation(NamedTuple):
    """The factor on bounds outside of training, and how many windows of how many recordings tell it."""

    factor: float
    windows: int
    recordings: int

    @property
    def text(self) -> str:
        """The words of its provenance."""
        many = f"{self.windows} windows of {self.recordings} recording{'s' * (self.recordings > 1)}"
        return f"fitted: needs of {many} outside the ranges of the others, over those inside"


def extrapolation(trial: Trial, training: Training) -> Extrapolation | None:
    """Return the factor that windows outside the ranges of other recordings ask for; None: none are known, or
    they ask for no wider bounds.
    """
    logs, windows, records = [], 0, training.records
    if len(trial.left) != len(records):
        return None
    for number, (one, (u, _, _)) in enumerate(zip(trial.left, records, strict=True)):
        if one.model is None:
            continue
        model = LinearSystem(**one.model, noise=trial.bound.tolist())
        if model.horizon is None:  # an observer rests on all samples before, which lie on both sides
            return None
        others = dataclasses.replace(training, records=[*records[:number], *records[number + 1 :]])
        region = Region.between(model, others.ranges, model.horizon)
        known = np.isfinite(one.need)
        out = region.departure(u, ~known).share > 0
        if out.any() and (known & ~out).any():
            inside, outside = one.need[known & ~out].max(), one.need[out].max()
            logs.append(math.log(max(outside, 1.0) / max(inside, 1.0)))
            windows += int(out.sum())
    factor = math.exp(sum(logs) / max(len(logs), 1))
    if stated(max(factor, 1.0)) == 1:
        return None
    return Extrapolation(factor, windows, len(logs))
