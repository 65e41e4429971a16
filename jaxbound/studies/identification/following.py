"""Bounds that follow the operating point: errors of a fitted model grow away from its training, and the
bounds of all outputs with them, by one factor of the inputs of the same sample,

    sqrt(1 + weight phi' P phi),    phi the inputs minus their mean in training,

P the inverse of the covariance of the inputs in training over their number, so that phi' P phi is 1 there on
average. It is written as a sum of squares with few digits (Cholesky), so the factor is at least 1 whatever
the digits, and the one that is written is the one that is tested.

How strongly bounds follow is chosen as methods are: by what is seen, on average over training, with bounds as
wide as recordings that are left out ask for, the factor of each of them from the others alone.
"""

import keyword
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxbound.models.numbers import is_real
from jaxbound.models.system import LinearSystem
from jaxbound.models.times import inputs_for_factors
from jaxbound.recordings.factors import read_factor
from jaxbound.studies.identification.candidates import Candidate, FitProblem, largest_need
from jaxbound.studies.identification.fit_result import Follows
from jaxbound.studies.identification.judging import Judge, Sizes
from jaxbound.studies.identification.left_out import LeftOut, Trial, widest
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.regression import Scales
from jaxbound.studies.identification.sizes import blindness

__all__ = ["WEIGHTS", "Leverage", "followed", "refuse_follow", "sizes_in_training"]

AUTO = "auto"
WEIGHTS = (0.0, 0.1, 0.3)
"""That are tried; larger ones lose what they gain."""
RIDGE = 1e-3
"""Added to the covariance of inputs in units of their spreads: of two that move together nobody knows what
they do where they part, but not that infinitely much.
"""
SMALL = 0.01
"""Coefficients that are left out, in units of the spread of an input."""


@dataclass(frozen=True, eq=False)
class Leverage:
    """How unlike its training a sample of the inputs is: |root ((u - middle) / spread)|^2.

    Fields: names: of q inputs. middle, spread (q,). root (q, q): upper triangular.
    """

    names: tuple[str, ...]
    middle: np.ndarray
    spread: np.ndarray
    root: np.ndarray

    @classmethod
    def of(cls, records: Records, inputs: Sequence[str], chosen: Sequence[str]) -> "Leverage | None":
        """Return the Leverage of those of the chosen inputs that move in recordings; None where none does."""
        u = _samples(records)
        columns = [i for i, name in enumerate(inputs) if name in chosen]
        if len(u) < 2:
            return None
        columns = [i for i in columns if np.ptp(u[:, i]) > 1e-9 * np.abs(u[:, i]).max()]
        if not columns:
            return None
        u = u[:, columns]
        middle, spread = u.mean(0), u.std(0)
        z = (u - middle) / spread
        P = np.linalg.inv(z.T @ z / len(z) + RIDGE * np.eye(len(columns))) / len(columns)
        names = tuple(inputs[i] for i in columns)
        return cls(names, middle, spread, np.linalg.cholesky(P).T)

    def text(self, weight: float) -> str:
        """Return the factor as an expression of the inputs, of few digits."""
        shifted = []
        for name, x, spread in zip(self.names, self.middle, self.spread, strict=True):
            places = 2 - int(np.floor(np.log10(spread)))
            shifted.append(_minus(_name(name), round(float(x), places)))
        squares = ["1"]
        for i, row in enumerate(self.root):
            terms = []
            for j in range(i, len(row)):
                coefficient = np.sqrt(weight) * row[j] / self.spread[j]
                if j == i or abs(row[j]) > SMALL:
                    terms.append(f"{coefficient:.3g}*{shifted[j]}")
            squares.append(f"({' + '.join(terms).replace('+ -', '- ')})**2")
        return f"sqrt({' + '.join(squares)})"


def _samples(records: Records) -> np.ndarray:
    """Return the inputs (N, m) of all samples that say something."""
    kept = []
    for u, y, _ in records:
        kept.append(u[np.isfinite(u).all(1) & np.isfinite(y).any(1)])
    return np.concatenate(kept)


def _name(name: str) -> str:
    """Return the name of a signal as an expression has it."""
    if name.isidentifier() and not keyword.iskeyword(name):
        return name
    return f"`{name}`"


def _minus(name: str, x: float) -> str:
    if x < 0:
        return f"({name} + {-x:.12g})"
    return f"({name} - {x:.12g})"


def refuse_follow(follow: float | str, about: Mapping[str, Any], average: int | None) -> None:
    """Raise ValueError if bounds cannot follow the operating point as asked for.

    Args:
        about: arguments of a LinearSystem beside its matrices. average: as of `fit`.
    """
    if follow == AUTO:
        return
    if not is_real(follow) or not (np.isfinite(follow) and follow >= 0):
        raise ValueError(f"follow must be a number >= 0, or auto, not {follow!r}")
    why = _hindrance(about, average)
    if follow and why:
        raise ValueError(f"{why}: leave follow out")


def _hindrance(about: Mapping[str, Any], average: int | None) -> str:
    """Return why bounds cannot follow anything; "": they can."""
    if average is not None:
        return "bounds on means and bounds that follow the operating point do not go together"
    if "every" in (about["columns"] or {}):
        return "samples that are means have no inputs of their own, which bounds could follow"
    if not _inputs(about):
        return "there is no input that bounds could follow, none that rests on no output"
    return ""


def _inputs(about: Mapping[str, Any]) -> tuple[str, ...]:
    return inputs_for_factors(about["inputs"], about["outputs"], about["columns"] or {})


def followed(
    problem: FitProblem,
    constant: Trial,
    records: Records,
    parts: Records,
    follow: float | str,
    average: int | None,
) -> tuple[Trial, Follows, list[str]]:
    """Return (trial, follows, sentences): the Trial of constant bounds, or in its place one whose bounds
    follow the operating point, as strongly as asked for.

    Args:
        follow: a weight, or "auto": of WEIGHTS the one with which the smallest errors are seen.
    """
    if not follow:
        return constant, Follows(), []
    why = _hindrance(problem.about, average)
    if follow == AUTO and not any(np.isfinite(one.factor) for one in constant.left):
        why = why or "no recording says, left out, how strongly bounds have to follow the operating point"
    if why:
        return (
            constant,
            Follows(),
            [f"{why}: they are constant; a weight does not ask, --follow 0.1, follow=0.1"],
        )
    weights = [float(x) for x in WEIGHTS if x] if follow == AUTO else [float(follow)]
    best, chosen = constant, Follows()
    for weight in weights:
        trial, follows = _tried(problem, constant, records, parts, weight)
        if follow != AUTO or trial.blindness < best.blindness:
            best, chosen = trial, follows
    return best, chosen, []


def _tried(
    problem: FitProblem, constant: Trial, records: Records, parts: Records, weight: float
) -> tuple[Trial, Follows]:
    """Return a Trial whose bounds follow the operating point, the models as they are."""
    full, judge = constant.candidate, problem.judge
    spec = full.spec | _times(problem, records, weight)
    follows = _in_training(spec, records, weight)
    model = LinearSystem(**spec, noise=full.spread.tolist())
    bound = largest_need(judge.needs(model, records)) * full.spread
    left = []
    for number, one in enumerate(constant.left):
        if one.model is not None:
            others = [*parts[:number], *parts[number + 1 :]]
            one = LeftOut(dict(one.model) | _times(problem, others, weight), one.need, one.why)
        left.append(one.under(judge, bound, {}, parts[number : number + 1]))
    covering = full.model(widest(left) * follows.mean * bound)  # constant: bounds as wide as on average
    seen = blindness(judge, covering, problem.scales, problem.spans)
    return Trial(Candidate(full.kind, spec, full.spread), bound, tuple(left), seen), follows


def _times(problem: FitProblem, records: Records, weight: float) -> dict[str, Any]:
    """Return the argument `times` of a LinearSystem that is fitted to recordings."""
    about = problem.about
    leverage = Leverage.of(records, about["inputs"], _inputs(about))
    if leverage is None:  # nothing moves in them: nothing is known of how errors grow
        return {}
    return {"times": dict.fromkeys(about["outputs"], leverage.text(weight))}


def _in_training(spec: Mapping[str, Any], records: Records, weight: float) -> Follows:
    """Return how the bounds of a model follow the operating point in its training."""
    if "times" not in spec:
        return Follows()
    (text,) = set(spec["times"].values())
    columns = dict(zip(spec["inputs"], _samples(records).T, strict=True))
    factor = read_factor(text).values(columns)
    return Follows(weight, float(factor.mean()), float(factor.max()))


def sizes_in_training(judge: Judge, model: LinearSystem, scales: Scales, most: float) -> tuple[Sizes, Sizes]:
    """Return (jump, steady) of `Judge.sizes` that are sure to be seen wherever training was.

    Args:
        most: the largest factor on the bounds of the model there.
    """
    jump, steady = judge.sizes(model.replace(times=None), scales)
    return {name: most * x for name, x in jump.items()}, {name: most * x for name, x in steady.items()}
