"""The test of a command: the tests that the model states, one of them, or what --test asks for."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from jaxbound.cli.terminal import door
from jaxbound.consistency.interface import FAMILIES, GONE, METHODS, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.alarmrule import Stated
from jaxbound.models.modelfile import load_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.recordingformat import with_format
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.runs.ask import Ask
from jaxbound.runs.refusals import Refused

WINDOWS = "windows", METHODS[0]
"""The exact test of windows: as the command line calls it, and as the library does."""
R = TypeVar("R", bound=Any)
Step = Callable[[str, float], object]
"""Told of progress: a stage, and the share of it that is done."""


@dataclass(frozen=True)
class DetectRun:
    """A recording that is to be tested, as the options of `jaxbound detect` say.

    Fields:
        model, data: paths. out: folder of the report. ask: the test. recording: see
        `options.reading`. alarm: the rule of alarms.
        min_coverage: least share of decided windows. json: whether the conclusion is JSON.
        chunk: samples in memory at once. overlap: of an observer, samples before each part. part: (i, n), the
            i-th of n shares; None: all. merge: the parts are there, judged before. workers: see
            `engine`. words: of the command line.
    """

    model: Path
    data: Path | str
    out: Path
    ask: Ask = Ask()
    recording: Mapping[str, str] | None = None
    alarm: Stated = None
    min_coverage: float = 0.5
    json: bool = False
    chunk: int | None = None
    overlap: int | None = None
    part: tuple[int, int] | None = None
    merge: bool = False
    workers: Mapping[str, str] | None = None
    words: Sequence[str] = ()


def asked(kind: type[R], args: argparse.Namespace, ask: Ask) -> R:
    """Return the run of a command line, of a kind; an option and the field that it sets have one name."""
    given = vars(args) | {"ask": ask, "alarm": args.alarm}
    run: R = kind(**{f.name: given[f.name] for f in fields(kind)})
    return run


def asked_test(args: argparse.Namespace, *more: str, only: Sequence[str] = (), claims: bool = False) -> Ask:
    """Return the test that --test asks for.

    Args:
        more: methods beside those of all commands. only: the methods of a command that has fewer. claims:
            whether it claims faults, so that margins and outside mean something.

    Raises:
        Refused: fields that make no test, a method that the command does not have.
    """
    test = dict(args.test or {})
    for field in ("margins", "outside"):
        if field in test and not claims:
            raise Refused(f"--test: {field} is for detect and fleet, leave it out")
    # the command line speaks of windows, the library of the joint test
    called, name = WINDOWS
    if test.get("method") == called:
        test["method"] = name
    with door():
        ask = Ask.of_fields(test)
    if ask.method in GONE:
        raise Refused(f"method {ask.method!r} is gone: {GONE[ask.method].replace(name, called)}")
    known = only or (*METHODS, OBSERVER, *FAMILIES, *more)
    if ask.method not in known:
        words = ", ".join(known).replace(name, called, 1)
        raise Refused(f"method must be one of {words}, not {ask.method!r}")
    return ask


def windowed(model: LinearSystem, horizon: int | None, lags: Sequence[int] | None) -> LinearSystem:
    """Return the model with the lags that are asked for, or without its own lags where a horizon is.

    The report keeps the model that this returns.

    Raises:
        ValueError: no lags.
    """
    if lags is not None:
        return model.replace(horizon=None, lags=lags)
    return model if horizon is None or model.lags is None else model.replace(horizon=horizon)


def stated_model(path: Path | str, recording: Mapping[str, str] | None, ask: Ask) -> LinearSystem:
    """Return the model of a file, with the tests that are asked for.

    Args:
        recording: fields of --recording, which go before those of the file.

    Raises:
        OSError, ValueError: see `load_model`; no such test; an interval that is not its dt.
    """
    model = load_model(path)
    try:
        model = ask.chosen(model)
        if recording:
            model = model.replace(columns=with_format(model.columns, recording))
    except ValueError as e:
        raise ValueError(f"{path}: {e}{_other_every(recording)}") from None
    return model


def _other_every(recording: Mapping[str, str] | None) -> str:
    """Return the end of a sentence on means over another interval than the model's."""
    if not recording or "every" not in recording:
        return ""
    return f": fit a model with --recording every={recording['every']}"


def window_relations(
    model: LinearSystem, ask: Ask, source: object, samples: int | None, step: Step
) -> tuple[LinearSystem, Relations]:
    """Return (model, relations) of the windows that a command asks for, or (model, observer) of an observer.

    Args:
        ask: the test. source, samples: name and length of the recording, None where nobody knows.
        step: told how far relations are.

    Raises:
        ValueError: a recording without a whole window, windows without a relation; no observer.
    """
    # Parity relations go their own way: lags and a horizon change the model that a report keeps, and a
    # recording that is too short is refused before minutes of elimination.
    if ask.of(model).method in (*FAMILIES, MONITOR, OBSERVER):
        return model, ask.relations(model, lambda share: step("relations", share))
    return parity_windows(model, ask, source, samples, step)


def parity_windows(
    model: LinearSystem, ask: Ask, source: object, samples: int | None, step: Step
) -> tuple[LinearSystem, ParityRelation | UncertainRelations]:
    """Return (model, parity relations) of the windows that a command asks for; arguments and errors as of
    `window_relations`.
    """
    model = windowed(model, ask.horizon, ask.lags)
    refuse_short(source, samples, model.horizon if ask.horizon is None else ask.horizon)
    return model, parity_relations(model, ask.horizon, progress=lambda share: step("relations", share))
