"""Inputs chosen by recordings that are left out: one is dropped, or a product of two or a square joins them.

Where a plant is not linear, a product that is computed from recorded inputs makes it so: the model stays
linear in its signals, so the test stays exact. Each round tries to drop each input, and to add those products
that the errors of one step ask for most; each set is judged as `window_tests` are, by the smallest errors
that are seen at the factor that recordings which are left out ask for, of coefficients that are fitted one
step ahead. A change is taken where these errors become clearly smaller, until none is.

Coefficients are those of one step ahead whichever `method` the model is fitted by in the end. Compared by
"windows", which fit a missing product away on the days that they have, sets with products look no better:
none was taken for an air handler, whose leak was then seen in .08 of the windows instead of in all, and two
tanks had more false alarms on unseen days. Compared by "auto", 25 of 26 simulated fits chose the same, for
three times the work.

A product is an input whose column is an expression, so it is computed from the recording as it was written,
before any mean is taken.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from os import PathLike
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.arrays import holds_both, is_made
from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.studies.identification import regression
from jaxbound.studies.identification.candidates import FitProblem
from jaxbound.studies.identification.gauge import GaugeJudge
from jaxbound.studies.identification.orders import ENOUGH
from jaxbound.studies.identification.recipe import KINDS, Recipe
from jaxbound.studies.identification.structure import delayed
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import tried

ASKED = 12
"""Products that are tried a round: those that explain most of the errors of one step."""
TOGETHER = 0.995
"""Correlation of two inputs above which nobody can tell them apart."""
ROUNDS = 4
"""Changes at most: each is chosen by the same few recordings."""
GIVEN = "as given"


class TriedSignals(NamedTuple):
    """A set of inputs that was tried, and what it is worth at the factor that recordings ask for which are
    left out.

    Fields: change: in words, of the set that the round began with. inputs: their names. factor: on the
    smallest bounds. jump, steady: {output: size}, the smallest errors that are sure to be seen at this
    factor, without a safety; inf: none. blindness: these sizes as one number, see `sizes.blindness`; inf
    where fewer recordings than before can be left out. taken: whether the model has this change. In floats,
    not proved.
    """

    change: str
    inputs: tuple[str, ...]
    factor: float
    jump: dict[str, float]
    steady: dict[str, float]
    blindness: float
    taken: bool = False


def products(inputs: Sequence[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Return {name: "= expression"} of all squares and products of two inputs.

    Args:
        columns: {input: column or "= expression"} where it is called otherwise.

    Raises:
        ValueError: a name of a column with a backtick in it.

    Example:
        >>> products(["fan", "lift"], {"lift": "= Tsup - Tmix"})["fan*lift"]
        '= `fan` * (Tsup - Tmix)'
    """
    columns_of = {name: _term(columns.get(name, name)) for name in inputs}
    found = {f"{name}**2": f"= {term}**2" for name, term in columns_of.items()}
    for (one, first), (other, second) in itertools.combinations(columns_of.items(), 2):
        found[f"{one}*{other}"] = f"= {first} * {second}"
    return {name: column for name, column in found.items() if name not in inputs}


def _term(column: str) -> str:
    """Return a column as a term of a product."""
    if is_expression(column):
        return f"({expression(column).text})"
    if "`" in column:
        raise ValueError(f"no expression can name the column {column!r}: its name has a backtick")
    return f"`{column}`"


def refuse_unnamed(recordings: object, names: Iterable[str]) -> None:
    """Raise ValueError for recordings without columns from which these products could be computed."""
    several: Sequence[object] = [recordings]
    if isinstance(recordings, list | tuple) and all(map(_has_columns, recordings)):
        several = recordings
    for one in several:
        if _has_columns(one):
            if not is_made(one) or set(names) <= set(getattr(one, "inputs", ())):
                continue
            raise ValueError(
                "signals = 'auto' computes products from columns, and a Recording keeps only the signals "
                "that it was read with: give a table, or its file to `jaxbound fit`"
            )
        raise ValueError(
            "signals = 'auto' writes products as expressions of columns, and arrays have none: give a table "
            "of inputs and outputs for each recording, or its file to `jaxbound fit`"
        )


def _has_columns(one: object) -> bool:
    """Return whether an object is a path, a table or a Recording."""
    return isinstance(one, str | PathLike) or (not isinstance(one, list | tuple) and holds_both(one))


@dataclass(frozen=True, eq=False)
class SignalProblem:
    """The recordings of a choice of inputs.

    Fields: training: with all columns as inputs. recipe: with an order, a delay and a window.
    """

    training: Training
    recipe: Recipe

    def judged(self, change: str, inputs: Sequence[str], least: int) -> tuple[TriedSignals, int]:
        """Return (what these inputs are worth, how many recordings tell a factor). least: that must."""
        problem = FitProblem.of(self.training.with_inputs(inputs), self.recipe, GaugeJudge())
        trial = tried(problem, KINDS[0])
        told = sum(np.isfinite(one.factor) for one in trial.left)
        blindness = trial.blindness
        if told < least:
            blindness = math.inf
        jump, steady = problem.sizes(trial.candidate.model(trial.factor * trial.bound))
        return TriedSignals(change, tuple(inputs), trial.factor, jump, steady, float(blindness)), told

    def asked(self, inputs: Sequence[str]) -> list[str]:
        """Return the products that explain most of the errors of one step, best first."""
        left = {}
        for name in self.training.inputs:
            if name in inputs or self._says_nothing(name, inputs):
                continue
            left[name] = self._missed([*inputs, name])
        return sorted(left, key=left.__getitem__)[:ASKED]

    def _says_nothing(self, name: str, inputs: Sequence[str]) -> bool:
        """Return whether a product stands still, or moves as one of the inputs does."""
        u = np.concatenate([u for u, _, _ in self.training.with_inputs([name, *inputs]).records])
        u = u[np.isfinite(u).all(1)]
        if len(u) < 2:
            return True
        own, others = u[:, 0], u[:, 1:]
        if np.ptp(own) <= 1e-9 * np.abs(own).max():
            return True
        moving = others[:, np.ptp(others, axis=0) > 0]
        together = [abs(np.corrcoef(own, other)[0, 1]) for other in moving.T]
        return max(together, default=0.0) > TOGETHER

    def _missed(self, inputs: Sequence[str]) -> float:
        """Return the sum of the squares of what one step leaves unexplained."""
        records = delayed(self.training.with_inputs(inputs).records, int(self.recipe.delay))
        order = int(self.recipe.order)
        steps = regression.windows_of(records, regression.scales_of(records), order)
        return regression.step_error(steps, order, self.recipe.direct)


def chosen_signals(
    problem: SignalProblem, inputs: Sequence[str], step: Callable[[float], object]
) -> tuple[TriedSignals, ...]:
    """Return all sets that were tried; the last one that is taken is the choice.

    Args:
        inputs: as given, where the choice begins. step: called with the share of the work done.

    Raises:
        ValueError: too few samples for the inputs as given.
    """
    begin, least = problem.judged(GIVEN, inputs, 0)
    best = begin._replace(taken=True)
    every_try = [best]
    for number in range(ROUNDS):
        changes = {
            f"without {name}": tuple(x for x in best.inputs if x != name) for name in _droppable(best.inputs)
        }
        changes |= {f"with {name}": (*best.inputs, name) for name in problem.asked(best.inputs)}
        tries = []
        for tried_so_far, (change, names) in enumerate(changes.items()):
            step((number + tried_so_far / len(changes)) / ROUNDS)
            try:
                tries.append(problem.judged(change, names, least)[0])
            except ValueError:  # too few samples for so many coefficients
                continue
        tries.sort(key=attrgetter("blindness"))
        if not tries or tries[0].blindness * ENOUGH > best.blindness:
            return (*every_try, *tries)
        best = tries[0]._replace(taken=True)
        every_try += [best, *tries[1:]]
    return tuple(every_try)


def _droppable(inputs: Sequence[str]) -> Sequence[str]:
    """Return the inputs that may go: one stays."""
    if len(inputs) < 2:
        return ()
    return inputs
