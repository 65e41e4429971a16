"""`plot` with all that it draws: who draws one thing imports its file alone, not what makes the others."""

from jaxbound.plots import (
    assessment,
    bank,
    diagnosis,
    fit,
    look,
    observation,
    parameters,
    result,
    sets,
    signatures,
    study,
    tune,
    validation,
)
from jaxbound.plots.plot import plot

__all__ = [
    "assessment",
    "bank",
    "diagnosis",
    "fit",
    "look",
    "observation",
    "parameters",
    "plot",
    "result",
    "sets",
    "signatures",
    "study",
    "tune",
    "validation",
]
