"""The test of a command: the tests that the model states, the windows that --horizon or --lags ask for, or a
set observer.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from jaxbound.cli.options import MethodOptions
from jaxbound.consistency.interface import FAMILIES, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.alarmrule import EVERY_FAULT, AlarmRule
from jaxbound.models.modelfile import load_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.means import EVERY
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.uncertain import UncertainRelations

R = TypeVar("R", bound=Any)
Step = Callable[[str, float], object]
"""Told of progress: a stage, and the share of it that is done."""


@dataclass(frozen=True)
class DetectRun:
    """A recording that is to be tested, as the options of `jaxbound detect` say.

    Fields:
        model, data: paths. out: folder of the report. options: of the test. alarm: the rule of alarms.
        min_coverage: least share of decided windows. json: whether the conclusion is JSON.
        chunk: samples in memory at once. overlap: of an observer, samples before each part. part: (i, n), the
            i-th of n shares; None: all. merge: the parts are there, judged before. scheduler, workers: of
            dask, which then do the work. words: of the command line.
    """

    model: Path
    data: Path | str
    out: Path
    options: MethodOptions = MethodOptions()
    alarm: AlarmRule = EVERY_FAULT
    min_coverage: float = 0.5
    json: bool = False
    chunk: int | None = None
    overlap: int | None = None
    part: tuple[int, int] | None = None
    merge: bool = False
    scheduler: str | None = None
    workers: int | None = None
    words: Sequence[str] = ()


def asked(kind: type[R], args: argparse.Namespace, alarm: AlarmRule | None) -> R:
    """Return the run of a command line, of a kind; an option and the field that it sets have one name."""
    given = vars(args) | {"options": MethodOptions.of(args), "alarm": alarm}
    run: R = kind(**{f.name: given[f.name] for f in fields(kind)})
    return run


def windowed(model: LinearSystem, horizon: int | None, lags: tuple[int, ...] | None) -> LinearSystem:
    """Return the model with the lags that are asked for, or without its own lags where a horizon is.

    The report keeps the model that this returns.

    Raises:
        ValueError: no lags.
    """
    if lags is not None:
        return model.replace(horizon=None, lags=lags)
    return model if horizon is None or model.lags is None else model.replace(horizon=horizon)


def stated_model(path: Path | str, every: str | None) -> LinearSystem:
    """Return the model of a file, whose samples are means over an interval if one is asked for.

    Raises:
        OSError, ValueError: see `load_model`; an interval that is not its dt.
    """
    model = load_model(path)
    if every is None:
        return model
    try:
        return model.replace(columns={**model.columns, EVERY: every})
    except ValueError as e:
        raise ValueError(f"{path}: {e}: fit a model with --every {every}") from None


def window_relations(
    model: LinearSystem, options: MethodOptions, source: object, samples: int | None, step: Step
) -> tuple[LinearSystem, Relations]:
    """Return (model, relations) of the windows that a command asks for, or (model, observer) of an observer.

    Args:
        options: of the command. source, samples: name and length of the recording, None where nobody knows.
        step: told how far relations are.

    Raises:
        ValueError: a recording without a whole window, windows without a relation; no observer.
    """
    options.check()
    # Parity relations go their own way: lags and a horizon change the model that a report keeps, and a
    # recording that is too short is refused before minutes of elimination.
    if options.ask.of(model).method in (*FAMILIES, MONITOR, OBSERVER):
        return model, options.ask.relations(model, lambda share: step("relations", share))
    return parity_windows(model, options, source, samples, step)


def parity_windows(
    model: LinearSystem, options: MethodOptions, source: object, samples: int | None, step: Step
) -> tuple[LinearSystem, ParityRelation | UncertainRelations]:
    """Return (model, parity relations) of the windows that a command asks for; arguments and errors as of
    `window_relations`.
    """
    model = windowed(model, options.horizon, options.lags)
    refuse_short(source, samples, model.horizon if options.horizon is None else options.horizon)
    return model, parity_relations(model, options.horizon, progress=lambda share: step("relations", share))
