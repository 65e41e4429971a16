"""A recording that is validated: its verdict, the columns of its file, and its report."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, cast

import jax
import numpy as np

from jaxbound.cli.evaluation import Evaluation
from jaxbound.cli.terminal import door, usable_device
from jaxbound.cli.window import DetectRun, Step, stated_model
from jaxbound.consistency.interface import Relations
from jaxbound.consistency.searched import judging_device
from jaxbound.diagnosis.alarmrule import EVERY_FAULT, AlarmRule
from jaxbound.diagnosis.alarms import Alarm, group_alarms
from jaxbound.diagnosis.hints import bound_hints, device_hints, outgrown
from jaxbound.estimation.validation import Validation, validate
from jaxbound.estimation.validation_observer import least_horizon
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import to_arrow, words
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.sample_axis import Place
from jaxbound.reports.validation import write_page
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.sink import Outcome
from jaxbound.runs.sinks import close_all, open_sinks
from jaxbound.runs.summary import Evidence, evidence, summarised
from jaxbound.runs.verdictfiles import columns_of
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["Validated", "evaluate_validation"]


@dataclass(frozen=True, eq=False)
class Validated:
    """A Validation of one recording with what a report needs beside it.

    Fields: model: LinearSystem. horizon: windows have horizon + 1 samples. y: (T, p) as recorded. found:
    Validation, NumPy inside.
    aside: how many windows are MISSING because the model's `where` leaves out a sample of theirs.
    """

    model: LinearSystem
    horizon: int
    y: np.ndarray
    found: Validation
    aside: int = 0
    method = "validation"
    remembers = False  # a page says of it that it looks at windows

    @property
    def relations(self) -> Relations:
        """The value itself, in which reports look for the model and the horizon."""
        return cast(Relations, self)  # it has those two, and `remembers`: no more is asked of it there

    @property
    def status(self) -> np.ndarray:
        """(T,) int8."""
        return np.asarray(self.found.status)

    @property
    def margin(self) -> np.ndarray:
        """(T,): validation measures none."""
        return np.full(len(self.y), np.nan)

    @property
    def departure(self) -> None:
        """None: of a validation it is not said where its inputs lie."""

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def blamed(self) -> dict[str, int]:
        """{output: number of its faulty samples}, those without any left out."""
        counts = np.asarray(self.found.faulty).sum(0).tolist()
        return {name: n for name, n in zip(self.model.outputs, counts, strict=True) if n}

    @property
    def first_fault(self) -> int | None:
        """The first sample that is FAULT, None if there is none."""
        fault = self.status == Status.FAULT
        if not fault.any():
            return None
        return int(np.argmax(fault))

    def alarms(self, rule: AlarmRule = EVERY_FAULT, instants: np.ndarray | None = None) -> list[Alarm]:
        """Group FAULT windows. See `Result.alarms`; a validation says which sensors are faulty itself.
        instants: (T,) times by which alarms are acknowledged.
        """
        if rule.suspects or rule.least is not None:
            raise ValueError(
                "validation names the faulty sensors itself, and no sizes: leave out --suspects and --least"
            )
        return group_alarms(self, rule.fitted(self.model), 0, instants=instants)

    def when(self, k: int) -> None:
        """Return None: a validation is given the samples alone."""

    def explain(self, at: Place) -> NoReturn:
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError(
            "validation has no certificate of a single window: its verdict rests on all samples before it"
        )

    def stretches(self) -> list[tuple[int, int, int]]:
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, stretches = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            # A stretch begins where the flag rises and ends before it falls.
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            for begin, end in edges.reshape(-1, 2):
                stretches.append((i, int(begin), int(end) - 1))
        return sorted(stretches, key=lambda stretch: stretch[1:])


@evidence.register(Validated)
def _(res: Validated, alarms: Sequence[Alarm]) -> Evidence:
    first = res.first_fault
    return Evidence(
        res.method,
        res.horizon,
        len(res.y),
        res.counts,
        aside=res.aside,
        at=first,
        first=first,
        alarms=len(alarms),
        ended=dict(Counter(a.ended for a in alarms)),
        faulty=res.blamed,
    )


@columns_of.register(Validated)
def _(res: Validated) -> dict[str, "pa.Array"]:
    """Return the status, for each output its faults, its band and its corrected value, and bands of states.

    A bound that is not known, as in the first samples, is blank.
    """
    columns = {"status": words([s.name for s in Status], res.status)}
    validation = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = _ends(validation.corrected, i)
        is_known = np.isfinite(lo) & np.isfinite(hi)
        middle = np.where(is_known, lo, 0) / 2 + np.where(is_known, hi, 0) / 2
        columns[f"faulty.{name}"] = to_arrow(np.asarray(validation.faulty)[:, i])
        columns |= _band(f"output.{name}", validation.output, i)
        columns[f"corrected.{name}"] = _blank(np.where(is_known, middle, np.nan))
        columns |= _band(f"corrected.{name}", validation.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= _band(f"state.{name}", validation.state, i)
    return columns


def _band(name: str, bounds: Interval, i: int) -> dict[str, "pa.Array"]:
    """Return the two columns of the bounds of signal i."""
    lo, hi = _ends(bounds, i)
    return {f"{name}.lo": _blank(lo), f"{name}.hi": _blank(hi)}


def _ends(bounds: Interval, i: int) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(bounds.lo)[:, i], np.asarray(bounds.hi)[:, i]


def _blank(x: np.ndarray) -> "pa.Array":
    """Return numbers as a column, nothing where they are not finite."""
    return to_arrow(np.where(np.isfinite(x), x, np.nan))


def evaluate_validation(work: Path, step: Step, run: DetectRun) -> Evaluation:
    """Read a recording, validate it and write everything into a folder, see `evaluate`."""
    seconds, start = {}, time.perf_counter()
    options, data = run.options, run.data
    with door():
        plant = stated_model(run.model, options.every)
        source = open_source(data, plant)
        content, recording = source.content, source.read(progress=lambda share: step("read", share))
        if options.lags is not None:
            raise ValueError(
                f"--lags is for other methods: {VALIDATION} takes every sample of a recording in turn"
            )
        horizon = least_horizon(plant.n, plant.p) if options.horizon is None else options.horizon
        _complete(data, recording, horizon)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()
        res, sinks = _validated(plant, recording, horizon), open_sinks(work)
        for sink in sinks:
            sink.add(recording, res)
        step("test", 1.0)
        alarms = res.alarms(run.alarm, recording.instants)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    reaches = outgrown(plant, looks_back="validation")
    sure = (*device_hints(judging_device(remembers=True)), *bound_hints(plant))
    hints = (*recording.hints, *sure, *reaches, *_assumptions(res, recording))
    summary = summarised(res, alarms, recording.label, run.min_coverage, hints, outgrown=bool(reaches))
    close_all(sinks, Outcome(alarms, summary, plant, Path(data), content, options.method, horizon))
    write_page(work, res, recording, summary, seconds=seconds, progress=lambda share: step("report", share))
    seconds["report"] = time.perf_counter() - start
    return Evaluation(summary, plant, seconds)


def _assumptions(res: Validated, recording: Recording) -> list[str]:
    """Return sentences on what the verdicts of a validation rest on beside the bounds."""
    samples = "complete samples, here and behind each gap," if len(recording.starts) else "samples"
    sentences = [
        f"the first {res.horizon + 1} {samples} are taken to be free of faults: a fault there may stay "
        f"unseen, or blame a healthy sensor"
    ]
    if res.model.m:
        sentences.append(
            "inputs are taken as recorded: where an actuator did something else, a healthy sensor is named"
        )
    if res.first_fault is not None:
        sentences.append(
            f"from {recording.label(res.first_fault)} on, the first FAULT, bands hold the true values only "
            f"if every faulty sample was found: a band may follow a sensor that stays wrong"
        )
    return sentences


def _validated(model: LinearSystem, recording: Recording, horizon: int) -> Validated:
    """Return the Validated of a recording."""
    found = validate(model, recording, horizon=horizon)
    return Validated(model, horizon, recording.y, jax.tree.map(np.asarray, found), recording.aside(horizon))


def _complete(data: Path | str, recording: Recording, horizon: int) -> None:
    """Raise ValueError if a sample that validation cannot do without is missing; where nothing is known there
    is a gap, which it can.
    """
    u, y, needs = recording.u, recording.y, "every sample of every input is needed"
    known = ~(np.isnan(u).any(1) & np.isnan(y).all(1))
    lost = [(recording.inputs, np.isnan(u) & known[:, None], needs)]
    if known[: horizon + 1].all() and not recording.across(horizon)[horizon]:
        begin = f"the first {horizon + 1} samples say where the state is: begin the recording later"
        lost.append((recording.outputs, np.isnan(y[: horizon + 1]), begin))
    for names, missing, why in lost:
        for k, j in np.argwhere(missing)[:1]:
            raise ValueError(
                f"{data}: {names[j]} is missing at {recording.label(k)}, and for validation {why}"
            )
