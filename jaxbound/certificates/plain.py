"""A model and samples as the checker takes them: exact numbers and names alone."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.models.rows import WeightedSum
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import bounded_sums

__all__ = ["plain_model", "plain_names", "plain_samples", "plain_sums"]

MATRICES = ("A", "B", "C", "D", "G", "F", "D_v")


def plain_model(model: LinearSystem) -> dict[str, Any]:
    """Return the numbers of a LinearSystem, matrices at the middle of its parameters, as
    `checker.claim.claimed` takes them.
    """
    bounded = bounded_sums(model)
    sums = [one.weighted_sum(model.outputs) for one in bounded]
    uncertainties = []
    for parameter in model.uncertainties:
        uncertainties.append(
            {letter: parameter.on(letter) for letter in "ABCD"} | {"varying": parameter.varying}
        )
    return {letter: getattr(model, letter) for letter in MATRICES} | {
        "offset_u": model.offset["u"],
        "offset_y": model.offset["y"],
        "tolerance": model.tolerance,
        "noise": model.noise,
        "resolution": model.resolution,
        "disturbance": model.disturbance,
        "averages": plain_sums(sums, [one.bound for one in bounded]),
        "constant": model.constant_tolerance,
        "uncertainties": uncertainties,
        "lags": model.lags,
    }


def plain_sums(sums: Sequence[WeightedSum], bounds: Sequence[Fraction]) -> list[dict[str, Any]]:
    """Return bounded sums as the checker takes them."""
    plain = []
    for values, bound in zip(sums, bounds, strict=True):
        one, *beside = [{"number": Fraction(number), "weights": weights} for number, weights in values.parts]
        entry: dict[str, Any] = {"output": Fraction(values.measured), **one, "bound": bound}
        if beside:
            entry["beside"] = beside
        plain.append(entry)
    return plain


def plain_names(
    model: LinearSystem, sample: int | list[int], times: Sequence[str] | None = None
) -> dict[str, Any]:
    """Return the names in a certificate of the window that ends at a sample. times: of its samples, as text,
    or None.
    """
    names: dict[str, Any] = {"model": model.name}
    names |= {kind: list(getattr(model, kind)) for kind in ("states", "inputs", "outputs")}
    names["units"] = dict(model.units)
    if model.uncertainties:
        names["parameters"] = [parameter.name for parameter in model.uncertainties]
    return names | {"sample": sample, "times": None if times is None else list(times)}


def plain_samples(x: np.ndarray) -> list[list[Fraction | None]]:
    """Return samples (T, k) as rows of exact numbers, None for NaN."""
    return [[None if np.isnan(v) else Fraction(float(v)) for v in row] for row in x]
