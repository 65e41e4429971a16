"""The proof of a test whose bounds floats have found: a model that no recording contradicts."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.bounds import verified
from jaxbound.studies.identification.judging import Sizes, WindowJudge
from jaxbound.studies.identification.records import Records, input_ranges
from jaxbound.studies.identification.regression import scales_of
from jaxbound.studies.identification.window_tests import TriedTest
from jaxbound.studies.tuning.widening import stated

__all__ = ["Proof", "Proved", "proved"]


class Proved(NamedTuple):
    """A model under which every window is CONSISTENT.

    Fields: jump, steady: {output: size} of errors that are sure to be seen, see `Judge.sizes`.
    """

    model: LinearSystem
    jump: Sizes
    steady: Sizes


Proof = Callable[[], Proved]


def proved(test: TriedTest, records: Records, safety: float) -> Proved:
    """Return the Proved of windows that were tried on recordings. safety: see `fit`."""
    trial, judged, judge = test.trial, test.judged, WindowJudge()
    spec = trial.candidate.spec | {"ranges": input_ranges(records, trial.candidate.spec["inputs"])}
    if any(np.isfinite(one.factor) for one in trial.left):
        spec["left_out"] = stated(judged.factor)
    averaged = {}
    for i, name in enumerate(spec["outputs"]):
        if judged.window.average is not None and name in judged.smallest_mean:
            averaged[i] = judged.window.average, judged.smallest_mean[name]
    model, _ = verified(judge, spec, trial.bound, averaged, records, judged.factor, safety)
    return Proved(model, *judge.sizes(model, scales_of(records)))
