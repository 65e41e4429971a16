"""Pictures of results. They take results, never the other way round. Each file registers with `plot` what it
draws.
"""

from jaxbound.plots import (
    assessment,
    bank,
    diagnosis,
    fit,
    observation,
    parameters,
    result,
    sets,
    signatures,
    study,
    tune,
    validation,
)

__all__ = [
    "assessment",
    "bank",
    "diagnosis",
    "fit",
    "observation",
    "parameters",
    "result",
    "sets",
    "signatures",
    "study",
    "tune",
    "validation",
]
