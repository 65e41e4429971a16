"""From the smallest bounds to those that are written: wider by what recordings that were left out ask for and
by a safety factor, rounded up, and verified by the proved test itself.
"""

import math
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.result import Result
from jaxbound.models.system import FOR_OBSERVER, LinearSystem
from jaxbound.relations.bounds import model_bounds
from jaxbound.studies.tuning.confidence import Risk
from jaxbound.studies.tuning.parametrization import Moving, Tunable, model_with, tuned_model
from jaxbound.studies.tuning.scaling import JoinedRecordings
from jaxbound.studies.tuning.tune_result import History, TuneResult, history_columns


def factors_text(factor: float, safety: float) -> str:
    """Return the factors on the smallest bounds as their provenance has them."""
    return f"factor {factor:.3g} of what was left out, safety factor {safety:g}"


def stated(factor: float) -> Fraction:
    """Return a factor as a model states it."""
    return Fraction(f"{factor:.4g}")


def stated_factor(relations: Tunable) -> float | None:
    """Return the factor that the fit of the model found for these windows; None where it found none."""
    model = tuned_model(relations)
    if relations.remembers or model.left_out is None:
        return None
    if (relations.horizon, relations.lags) != (model.horizon, model.lags):
        return None
    return float(model.left_out)


class Smallest(NamedTuple):
    """The smallest bounds that explain healthy data. Fields: values (b,), of those that move; others: as of a
    TuneResult.
    """

    values: np.ndarray
    scale: float
    left_out: tuple[float, ...]
    risk: Risk
    history: History
    steps: int = 0
    stopped: bool = False


def concluded(
    relations: Tunable,
    moved: Moving,
    found: Smallest,
    safety: float,
    good: JoinedRecordings,
    bad: JoinedRecordings | None,
) -> TuneResult:
    """Return the result of tuning relations, or an observer, whose smallest bounds are known: wider by the
    factors and rounded up, so that no healthy window is FAULT.
    """
    factor, is_known, notes = _factor(relations, found.left_out)
    left_out, wide = None, f"safety factor {safety:g}"
    if is_known:
        left_out, wide = stated(factor), factors_text(factor, safety)
    seen = f"{int((~good.without(relations.horizon)).sum())} healthy windows"
    if relations.remembers:
        seen = f"{len(good.y)} healthy samples {FOR_OBSERVER}"
    values, extra = found.values * (factor * safety), 1.0
    while True:
        short = moved.rounded_up(values * extra)
        model = model_with(relations, moved, short, f"fitted to {seen}, {wide}", left_out)
        final = _under(relations, moved, model, short)
        res = detect(final, good, margins="exact")
        proved = relations.linear is None or not (res.margin <= 0).any()
        if proved and not res.counts["FAULT"]:
            break
        extra *= 1.001  # only where a search ends early, or the test is not monotone (uncertain parameters)
        if extra > 2:
            raise ValueError(
                "the proved test refutes a healthy window even at twice the bounds that it accepted: look at "
                "that model"
            )
    faulty_counts = None
    if bad is not None:
        faulty_counts = _counts(detect(final, bad), bad, relations)
    return TuneResult(
        bounds=final.bounds,
        smallest=moved.bounds(found.values),
        scale=found.scale,
        factor=factor,
        safety=safety,
        left_out=found.left_out,
        start=relations.bounds,
        margin=res.margin,
        counts=_counts(res, good, relations),
        faulty_counts=faulty_counts,
        risk=found.risk,
        history=history_columns(found.history, len(moved.names)),
        names=moved.names,
        steps=found.steps,
        stopped=found.stopped,
        model=model,
        relations=final,
        notes=(*moved.notes, *notes),
    )


def _factor(relations: Tunable, left: Sequence[float]) -> tuple[float, bool, list[str]]:
    """Return (the factor that recordings which were left out ask for, whether something was left out, here or
    by the fit of the model, sentences).
    """
    by_fit = stated_factor(relations)
    if by_fit is not None:
        why = (
            f"the fit of the model left recordings out, and asked for bounds {by_fit:.3g} times the smallest"
        )
        return by_fit, True, [f"{why}: so wide they are"]
    own = list(filter(math.isfinite, left))
    if not own:
        why = "there is one recording, or none that can be left out: what another day asks for is unknown"
        return 1.0, False, [f"{why}; give each day as a recording of its own"]
    notes = []
    if "model" in tuned_model(relations).provenance:
        notes = [
            "a recording is left out of the bounds alone: the model may have been fitted to it, and then "
            "another day asks for more than the factor says"
        ]
    return max([1.0, *own]), True, notes


def _counts(res: Result, recordings: JoinedRecordings, relations: Tunable) -> dict[str, int]:
    """Return the counts of a result, of windows without the samples where none ends."""
    counts = dict(res.counts)
    if not relations.remembers:
        counts["MISSING"] -= int(recordings.across(relations.horizon).sum())
    return counts


def _under(relations: Tunable, moved: Moving, model: LinearSystem, short: Sequence[Decimal]) -> Tunable:
    """Return relations, or an observer, under the bounds of a model, of which those that moved are these."""
    if relations.remembers:
        return relations.of(model)
    return relations.with_bounds({**model_bounds(model), **_parameter_bounds(moved, short)})


def _parameter_bounds(moved: Moving, values: Sequence[Decimal]) -> dict[str, np.ndarray]:
    """Return the bounds of parameters, in the half-widths of the model that the relations were made for."""
    if "parameters" not in moved.rows:
        return {}
    flat = moved.fixed + moved.select @ np.array([float(v) for v in values])
    return {"parameters": flat[moved.rows["parameters"]]}
