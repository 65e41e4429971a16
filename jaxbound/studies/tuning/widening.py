"""From the smallest bounds to those that are written: wider by what recordings that were left out ask for and
by a safety factor, rounded up, and verified by the proved test itself.
"""

from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.result import Result
from jaxbound.models.system import LinearSystem
from jaxbound.relations.bounds import model_bounds
from jaxbound.studies.tuning.parametrization import Moving, Tunable, model_with, tuned_model
from jaxbound.studies.tuning.scaling import JoinedRecordings

__all__ = ["Wider", "accepted", "stated", "stated_factor", "widened"]


class Wider(NamedTuple):
    """Factors on the smallest bounds.

    Fields: factor, safety: as of a TuneResult. known: whether something was left out, here or by the fit of
    the model. notes: sentences.
    """

    factor: float
    safety: float
    known: bool
    notes: tuple[str, ...]

    @classmethod
    def of(cls, relations: Tunable, left: Sequence[float], safety: float) -> "Wider":
        """Return the factors that recordings which were left out ask for."""
        by_fit = stated_factor(relations)
        own = [x for x in left if np.isfinite(x)]
        notes = []
        if by_fit is not None:
            notes.append(
                f"the fit of the model left recordings out, and asked for bounds {by_fit:.3g} times the "
                f"smallest: so wide they are"
            )
        elif not own:
            notes.append(
                "there is one recording, or none that can be left out: what another day asks for is unknown; "
                "give each day as a recording of its own"
            )
        elif "model" in tuned_model(relations).provenance:
            notes.append(
                "a recording is left out of the bounds alone: the model may have been fitted to it, and then "
                "another day asks for more than the factor says"
            )
        factor = max([1.0, *own]) if by_fit is None else by_fit
        return cls(factor, safety, bool(own) or by_fit is not None, tuple(notes))

    @property
    def text(self) -> str:
        """The factors, for the provenance of bounds."""
        if not self.known:
            return f"safety factor {self.safety:g}"
        return widened(self.factor, self.safety)

    @property
    def left_out(self) -> Fraction | None:
        """The factor that a model states."""
        if not self.known:
            return None
        return stated(self.factor)


def widened(factor: float, safety: float) -> str:
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


def accepted(
    relations: Tunable,
    moved: Moving,
    smallest: np.ndarray,
    wider: Wider,
    good: JoinedRecordings,
    source: str,
) -> tuple[LinearSystem, Tunable, Result]:
    """Return a model with the moved bounds, wider than the smallest and rounded up, its relations, and their
    verdicts on healthy windows, none of which is FAULT.
    """
    values, extra = smallest * (wider.factor * wider.safety), 1.0
    while extra <= 2:
        short = moved.rounded_up(values * extra)
        model = model_with(relations, moved, short, source, wider.left_out)
        final = _under(relations, moved, model, short)
        res = detect(final, good.u, good.y, starts=good.starts, margins="exact")
        proved = relations.linear is None or not (res.margin <= 0).any()
        if proved and not res.counts["FAULT"]:
            return model, final, res
        extra *= 1.001  # only where a search ends early, or the test is not monotone (uncertain parameters)
    raise ValueError(
        "the proved test refutes a healthy window even at twice the bounds that it accepted: look at that "
        "model"
    )


def _under(relations: Tunable, moved: Moving, model: LinearSystem, short: Sequence[Decimal]) -> Tunable:
    """Return relations, or an observer, under the bounds of a model, of which those that moved are these."""
    if relations.remembers:
        return relations.of(model)
    return relations.with_bounds({**model_bounds(model), **_parameters(moved, short)})


def _parameters(moved: Moving, values: Sequence[Decimal]) -> dict[str, np.ndarray]:
    """Return the bounds of parameters, in the half-widths of the model that the relations were made for."""
    if "parameters" not in moved.rows:
        return {}
    flat = moved.fixed + moved.select @ np.array([float(v) for v in values])
    return {"parameters": flat[moved.rows["parameters"]]}
