"""Sizes of errors that a fitted monitor is sure to see: jumps, and errors that last."""

from collections.abc import Sequence

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import parity_relations
from jaxbound.studies.identification.regression import Scales

__all__ = ["blindness", "visible_sizes"]

Sizes = dict[str, float]
"""{output: size}."""


def visible_sizes(model: LinearSystem, scales: Scales) -> tuple[Sizes, Sizes]:
    """Return (jump, steady): sizes of an error of one output that no noise hides.

    A jump begins in the middle of a window, a steady error fills it. A size is inf where the model can
    follow.
    """
    assert model.horizon is not None, "a fitted model has one"
    count, p = model.horizon + 1, model.p
    samples = np.arange(count)
    acts = np.stack([samples >= count // 2, samples >= 0])
    wrong = acts[:, None, :, None] * np.diag(scales.y_spread)[None, :, None]  # (2, p, s + 1, p)
    y = np.array(model.offset["y"], float) + wrong
    u = None
    if model.m:
        u = np.broadcast_to(np.array(model.offset["u"], float), (2, p, count, model.m))
    margin = detect(parity_relations(model), u, y, margins="exact").margin[..., -1]
    with np.errstate(divide="ignore"):  # a need grows with the size; healthy noise takes 1 of it
        sizes = np.where(1 - margin > 1e-9, 2 * scales.y_spread / (1 - margin), np.inf)
    jump, steady = (dict(zip(model.outputs, row, strict=True)) for row in sizes.tolist())
    return jump, steady


def blindness(model: LinearSystem, scales: Scales, spans: Sequence[float]) -> float:
    """Return the sizes of a jump and of a lasting error that are seen, summed over outputs in their spreads.

    Beyond the span of an output it does not count how blind the monitor is for it.
    """
    total = 0.0
    for sizes in visible_sizes(model, scales):
        for name, span, spread in zip(model.outputs, spans, scales.y_spread, strict=True):
            total += min(sizes[name], span) / spread
    return total
