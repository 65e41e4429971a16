"""The result of a fit: a model, and what is known of it beyond its numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.following import Follows
from jaxbound.studies.identification.recipe import Recipe, recipe_text
from jaxbound.studies.identification.signal_choice import TriedSignals
from jaxbound.studies.identification.widest import Widest
from jaxbound.studies.identification.window_tests import JudgedTest
from jaxbound.text.objects import readable


class PartLeftOut(NamedTuple):
    """A recording, or a block of one, that was left out of a fit.

    Fields: windows: how many it has. factor: on the smallest bounds, which they need under a fit to all
    others, of several tests that which needs most; nan where `why` says why there is none.
    """

    windows: int
    factor: float
    why: str


class Tradeoff(NamedTuple):
    """Disturbances that a fit looked at, and what would be seen under their bounds.

    Fields: method: of the coefficients. process, drift: bounds of process noise, and of how far an offset
        moves a sample, in shares of the noise of the sensors. noise: {output: bound}, with the factor and the
        safety. factor: that recordings ask for which are left out; safety: on top of it. sizes: {"T1:bias":
        size} from which on a fault, added to the longest recording, is seen by its end; inf: never. chosen:
        whether the model has them.
    """

    method: str
    process: float
    drift: float
    noise: dict[str, float]
    factor: float
    safety: float
    sizes: dict[str, float]
    chosen: bool


@readable
@dataclass(frozen=True, eq=False)
class FitCheck:
    """The knowledge of a fit beyond its model.

    Fields:
        method: how the coefficients were found, order, delay: of the model, see `fit`.
        factor, safety: the factors on the smallest bounds, of all tests: as the recordings ask for, each left
            out in turn, see `factor_of`, and on top. smallest: those bounds, {output: bound}. smallest_mean:
            those of the mean of `average` errors in a row, {} where it was not asked for.
        left_out: a `PartLeftOut` for each recording, or each block of a single one.
        held_out: all of these together: {"windows", "fault", "growth"}: how many windows, the share that
            would be FAULT with `safety` alone, and the factor by which these bounds would have had to be
            wider; None if nothing was left out.
        recordings: one {"samples", "windows", "used"} each: used is the largest share of the final bounds
            that a window needs.
        jump: {output: size}: a jump of one output in the middle of a window from which on the window is FAULT
            whatever the noise does; of several tests that of the one that sees the smallest.
        hidden: {output: size} of a lasting jump that noise can hide from any test of all samples, of a fit
            for an observer that is sharper than zonotopes, by which its `jump` is; {} of others.
        steady: the same for an error that fills the window; inf if the model can follow it.
        used, held_out_used: one array (T,) a recording, the share of the bounds that each window needs (nan
            where there is none): of the final model, and of the fits to all others.
        follows: how the bounds follow the operating point, see `fit`; jump and steady are sizes under the
            largest factor on them in training.
        tests: a `JudgedTest` for each of the windows that a choice was made of; () where there was none.
        signals: a `TriedSignals` for each set of inputs that a choice was made of, round by round; () where
            there was none.
        tradeoff: of a fit with disturbances, those that were looked at; a setting that cannot see more than
            the best is left out.
        moved: {output: between its lowest and its highest sample in all recordings}.
        recipe: the `Recipe` that makes the same fit of the same recordings again.
        widest: the window that asks for the widest bounds, and what leaving out samples like it would give:
            a `Widest`; of several tests that of the first. None: no window needs any.
        sentences: what the user should know, above all why the data may not carry a monitor.
    """

    method: str
    order: int
    delay: int
    factor: float
    safety: float
    smallest: dict[str, float]
    held_out: dict[str, float] | None
    left_out: tuple[PartLeftOut, ...]
    recordings: tuple[dict[str, float], ...]
    jump: dict[str, float]
    steady: dict[str, float]
    used: tuple[np.ndarray, ...] = field(repr=False)
    held_out_used: tuple[np.ndarray, ...] = field(repr=False)
    sentences: tuple[str, ...] = ()
    smallest_mean: dict[str, float] = field(default_factory=dict)
    follows: Follows = Follows()
    tests: tuple[JudgedTest, ...] = ()
    signals: tuple[TriedSignals, ...] = ()
    tradeoff: tuple[Tradeoff, ...] = ()
    moved: dict[str, float] = field(default_factory=dict)
    hidden: dict[str, float] = field(default_factory=dict)
    recipe: Recipe = Recipe()
    widest: Widest | None = None

    def of(self, test: JudgedTest) -> JudgedTest:
        """Return a test with the numbers of this fit, which is for it and has looked at windows that lack
        samples, too.
        """
        grown = [self.steady[name] / size for name, size in test.steady.items() if np.isfinite(size)]
        return test._replace(
            factor=self.factor,
            smallest=self.smallest,
            smallest_mean=self.smallest_mean,
            jump=self.jump,
            steady=self.steady,
            left_out=tuple(one.factor for one in self.left_out),
            ramp={name: max(grown, default=1.0) * size for name, size in test.ramp.items()},
        )


class Fitted(LinearSystem):
    """A LinearSystem that `fit` made: with `.check`, a FitCheck, which is no part of its value."""

    check: FitCheck

    def __init__(self, model: LinearSystem, check: FitCheck) -> None:
        super().__init__(**model._arguments())
        object.__setattr__(self, "check", check)

    def _notes(self) -> dict[str, dict[str, str]]:
        """Return the table of the recipe, see `LinearSystem._notes`."""
        return {"fit": recipe_text(self.check.recipe)}
