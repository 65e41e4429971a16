"""A model and samples as the checker takes them: exact numbers and names alone."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.models.rows import WeightedSum
from jaxbound.models.system import LinearSystem

MATRICES = ("A", "B", "C", "D", "G", "F", "D_v")


def plain_model(model: LinearSystem) -> dict[str, Any]:
    """Return the numbers of a LinearSystem, matrices at the middle of its parameters, as
    `checker.claim.claim_of` takes them.
    """
    plain: dict[str, Any] = {letter: getattr(model, letter) for letter in MATRICES}
    plain |= {"offset_u": model.offset["u"], "offset_y": model.offset["y"]}
    for name in ("tolerance", "noise", "resolution", "disturbance", "lags"):
        plain[name] = getattr(model, name)
    bounded = model.averages
    sums = [one.weighted_sum(model.outputs) for one in bounded]
    plain["averages"] = plain_sums(sums, [one.bound for one in bounded])
    plain["constant"] = model.constant_tolerance
    plain["uncertainties"] = []
    for parameter in model.uncertainties:
        change: dict[str, Any] = {letter: parameter.on(letter) for letter in "ABCD"}
        plain["uncertainties"].append(change | {"varying": parameter.varying})
    return plain


def plain_sums(sums: Iterable[WeightedSum], bounds: Iterable[Fraction]) -> list[dict[str, Any]]:
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
    for kind in ("states", "inputs", "outputs"):
        names[kind] = list(getattr(model, kind))
    names["units"] = dict(model.units)
    if model.times:
        names["times_noise"] = dict(model.times)
    if model.uncertainties:
        names["parameters"] = [parameter.name for parameter in model.uncertainties]
    names["sample"], names["times"] = sample, None
    if times is not None:
        names["times"] = list(times)
    return names


def plain_samples(x: np.ndarray) -> list[list[Fraction | None]]:
    """Return samples (T, k) as rows of exact numbers, None for NaN."""
    return [list(exact_floats(row)) for row in x]


def plain_factors(model: LinearSystem, u: np.ndarray) -> list[list[Fraction]] | None:
    """Return the factors on the noise of each sample of each output, that stand behind the inputs in u (T,
    m), as T rows: 1 where an output has none, or where it is missing; None: the model has none.
    """
    if not model.factors:
        return None
    rows = [[Fraction(1)] * model.p for _ in range(len(u))]
    for column, factor in enumerate(model.factors, model.m):
        for row, value in zip(rows, exact_floats(u[:, column]), strict=True):
            if value is not None:
                row[factor.number] = value
    return rows


def exact_floats(values: ArrayLike) -> tuple[Fraction | None, ...]:
    """Return floats, row by row, as the fractions that they are, None for NaN."""
    exact: list[Fraction | None] = []
    for v in np.ravel(values).tolist():
        if np.isnan(v):
            exact.append(None)
        else:
            exact.append(Fraction(v))
    return tuple(exact)
