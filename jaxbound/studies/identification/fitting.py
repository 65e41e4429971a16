"""From healthy recordings to a monitor: a nominal model by regression, and the smallest noise bounds that
explain every training window.

The model is x+ = A x + B u, y = C x + D u in the states that an ARX model of the given order needs: those of
all outputs together. Its coefficients are rounded to short decimals first and the bounds found afterwards, so
that they hold for the model as it is saved. What the constant of the regression says becomes the operating
point.

Where errors average out, the mean of several of them has a smaller bound than one of them: `average` finds it
too, of the same windows.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from os import PathLike
from typing import overload

from jaxbound.models.arguments import table_argument, taking_fields
from jaxbound.models.conversion import ModelLike
from jaxbound.recordings.expressions import with_angles
from jaxbound.recordings.means import every_step
from jaxbound.recordings.recordingformat import RecordingFormat, Stated, with_format
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.studies.identification.adding import MOST, Widened, widen
from jaxbound.studies.identification.advice import inputs_at_rest
from jaxbound.studies.identification.bank import fitted_bank
from jaxbound.studies.identification.disturbances import refuse_unseen
from jaxbound.studies.identification.fit_result import Fitted
from jaxbound.studies.identification.following import hindrance
from jaxbound.studies.identification.orders import settled
from jaxbound.studies.identification.recipe import AUTO, Recipe, recipe_of
from jaxbound.studies.identification.records import left_out_parts, names_of
from jaxbound.studies.identification.search import fitted, on_recordings
from jaxbound.studies.identification.signal_choice import (
    SignalProblem,
    TriedSignals,
    chosen_signals,
    products,
    refuse_unnamed,
)
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.widest import widest_of
from jaxbound.studies.identification.window_tests import WINDOWS
from jaxbound.text.progress import in_part, reporter

SHOWN = {"latch": True}
"""The rule of alarms of a fitted model: windows forget the onset of a fault that lasts, alarms do not."""


@overload
def fit(
    recordings: object,
    recipe: Recipe | str | PathLike[str] | None = ...,
    *,
    inputs: str | Sequence[str] | None = ...,
    outputs: str | Sequence[str] | None = ...,
    dt: float | None = ...,
    name: str = ...,
    units: Mapping[str, str] | None = ...,
    columns: Mapping[str, str] | None = ...,
    recording: Stated = ...,
    progress: Callable[[float], object] | None = ...,
    add: None = ...,
    most: None = ...,
    **fields: object,
) -> Fitted: ...


@overload
def fit(
    recordings: object,
    *,
    add: ModelLike | str | PathLike[str],
    most: float | None = ...,
    progress: Callable[[float], object] | None = ...,
) -> Widened: ...


@taking_fields(Recipe)
def fit(
    recordings: object,
    recipe: Recipe | str | PathLike[str] | None = None,
    *,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    dt: float | None = None,
    name: str = "fitted",
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    recording: Stated = None,
    progress: Callable[[float], object] | None = None,
    add: ModelLike | str | PathLike[str] | None = None,
    most: float | None = None,
    **fields: object,
) -> Fitted | Widened:
    """Find a nominal model and noise bounds from healthy recordings.

    The smallest bounds are those under which every window of the recordings is consistent, in the ratio of
    the outputs' residuals: `tune` moves each by its own. Each recording in turn is then judged by a fit to
    all others: by the geometric mean of the factors that they ask for, each of the test that asks most, the
    bounds of all tests are wider, somewhat more for few recordings, and by `safety` on top.
    They are verified: `detect` finds every window CONSISTENT, or an observer no FAULT. Of n recordings that
    are like the next one, one in n + 1 may still ask for more.

    Args:
        recordings: one or several of: a path, as `read` takes it; (u (T, m), y (T, p)) or (u, y, starts), u
            None without inputs; a table with the columns `inputs` and `outputs`; a Recording. NaN marks a
            missing sample. No window crosses gaps in the times of a file or a table, or `starts`.
        recipe: how to fit, and for which test: see `Recipe`; or the path of a model file that `fit` wrote, to
            fit as it was fitted. None: what is chosen by recordings that are left out.
        inputs, outputs: names; needed with tables and paths. dt: sampling period in s; None: what the times
            of tables, paths or a Recording say, else 1.
        name, units, columns: as of a LinearSystem; tables are read by these columns too. Of a column
            "= angle(wind)" the signal becomes two, its sine and its cosine. recording: how files are written,
            see `RecordingFormat`; {"every": "15min"}: samples are the means of what was recorded within
            intervals of the clock, and the model keeps it. progress: called with the share of the work done.
        add: a model, or the path of its file, that is widened by the recordings instead: each of its tests
            just enough to hold them, proved; most: more than so many times, by default 3, is refused, for a
            fault would be learnt.
        fields: fields of the recipe that are to differ from it, like order=1, horizon=30.

    Returns:
        A Fitted: a LinearSystem with `.horizon` (but for an observer), provenance "fitted ..." and `.check`.
        With add, a Widened: its .model, and what the widening costs.

    Raises:
        ValueError: recordings that do not fit each other, too few samples, an output that stands still,
            fields of a recipe that are unknown, out of range or do not go together.

    Example:
        >>> import jax, jaxbound as jb
        >>> true = jb.LinearSystem([[0.8]], [[0.5]], [[1]], noise=0.1)
        >>> u = jax.random.normal(jax.random.key(0), (300, 1))
        >>> model = jb.fit((u, jb.simulate(true, u, jax.random.key(1)).y), order=1, horizon=4)
        >>> abs(float(model.A[0][0]) - 0.8) < 0.05, float(model.noise[0]) < 0.15
        (True, True)
    """
    if add is not None:
        new = {"recipe": recipe, "inputs": inputs, "outputs": outputs, "recording": recording, "dt": dt}
        for field, value in {**new, "units": units, "columns": columns, **fields}.items():
            if value is not None:
                raise ValueError(f"add widens a model as it is: leave {field} out")
        return widen(add, recordings, MOST if most is None else most, progress)
    if most is not None:
        raise ValueError("most is for add: safety=1.5 makes bounds of a new model wider")
    for field, value in fields.items():
        if field in RecordingFormat.__dataclass_fields__:
            raise ValueError(
                f"{field} is how recordings are read, no way to fit: recording={{{field!r}: {value!r}}}"
            )
    plan = recipe_of(recipe, fields)
    columns = table_argument("columns", columns, "{'Q': 'Heater 1'}")
    units = table_argument("units", units, "{'T': 'degC'}")
    columns = with_format(columns, recording)
    dt = every_step(columns, dt)
    inputs = begin_with = names_of("inputs", inputs)
    if begin_with is not None:
        begin_with, columns = with_angles(begin_with, columns)
        inputs = begin_with
    outputs = names_of("outputs", outputs)
    if outputs is not None:
        outputs, columns = with_angles(outputs, columns)
    pool: dict[str, str] = {}
    if plan.signals is not None:
        if not begin_with:
            raise ValueError(
                "signals = 'auto' chooses among inputs and their products: name the inputs to begin with"
            )
        pool = products(begin_with, columns)
        refuse_unnamed(recordings, pool)
        inputs = (*begin_with, *pool)
    training = Training.of(recordings, inputs, outputs, dt, columns | pool)
    training = dataclasses.replace(training, units=units, name=name)
    return _fitted(training, plan, begin_with or (), reporter(progress, "fit"))


@where_proofs_hold(compiled=False)
@sparing(False)
def _fitted(
    training: Training, plan: Recipe, begin_with: Sequence[str], report: Callable[[float], object]
) -> Fitted:
    """Return the fit of recordings. begin_with: the inputs, without their products."""
    signals: tuple[TriedSignals, ...] = ()
    if plan.signals is not None:
        step = partial(in_part, report, 0.0, 0.4)
        training, plan, signals = _with_signals(training, plan, begin_with, step)
        report = partial(in_part, report, 0.4, 0.6)
    # only now: the choice of signals may have dropped an input
    refuse_unseen(plan.faults, training.inputs, training.outputs)
    why, sentences = hindrance(training) if plan.follow else "", on_recordings(training, plan)
    asked = plan
    if why and plan.follow != AUTO:
        raise ValueError(f"{why}: leave follow out")
    if why:
        asked, sentences = dataclasses.replace(plan, follow=0), [*sentences, f"{why}: they are constant"]
    can_choose = plan.is_open and left_out_parts(training.records, plan.held_out, WINDOWS[0].horizon + 1)
    if can_choose or plan.test is not None:
        model = fitted_bank(training, asked, sentences, report)
    else:
        model = fitted(training, asked, sentences, report)
    widest = widest_of(training, model.check.used, model.horizon)
    check = dataclasses.replace(model.check, signals=signals, recipe=plan, widest=widest)
    return Fitted(model.replace(alarms=SHOWN), check)


def _with_signals(
    training: Training, plan: Recipe, inputs: Sequence[str], report: Callable[[float], object]
) -> tuple[Training, Recipe, tuple[TriedSignals, ...]]:
    """Return (training, recipe, tried): with the inputs that were chosen, and all sets that were tried.

    Args:
        training: with all products. inputs: those to begin with.
    """
    begun = training.with_inputs(inputs)
    inputs_at_rest(begun.records, begun.inputs, begun.outputs, plan.window.horizon)
    windowed = dataclasses.replace(plan, observer=None, average=None, disturbances=None, see=())
    structured = settled(begun, windowed)
    tried_sets = chosen_signals(SignalProblem(training, structured), inputs, report)
    chosen = [one for one in tried_sets if one.taken][-1].inputs
    if chosen == tuple(inputs):
        plan = dataclasses.replace(plan, order=structured.order, delay=structured.delay)
    return training.with_inputs(chosen), dataclasses.replace(plan, signals=None), tried_sets
