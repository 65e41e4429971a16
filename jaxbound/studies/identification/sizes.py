"""How blind a fitted monitor is: sizes of errors that it is sure to see, as one number."""

from collections.abc import Sequence

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.regression import Scales

__all__ = ["blindness"]


def blindness(judge: Judge, model: LinearSystem, scales: Scales, spans: Sequence[float]) -> float:
    """Return the sizes of a jump and of a lasting error that are seen, summed over outputs in their spreads.

    Beyond the span of an output it does not count how blind the monitor is for it.
    """
    total = 0.0
    for sizes in judge.sizes(model, scales):
        for name, span, spread in zip(model.outputs, spans, scales.y_spread, strict=True):
            total += min(sizes.get(name, 0.0), span) / spread
    return total
