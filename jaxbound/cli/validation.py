"""A recording that is validated: read, judged and written with its report."""

import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np

from jaxbound.cli.evaluation import PAGE, Evaluation
from jaxbound.cli.terminal import door, usable_device
from jaxbound.cli.window import DetectRun, Step, stated_model
from jaxbound.consistency.searched import judging_device
from jaxbound.diagnosis.alarmrule import stated_rule
from jaxbound.diagnosis.hints import bound_hints, device_hints, outgrown
from jaxbound.estimation.validation import validate
from jaxbound.estimation.validation_observer import least_horizon
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.reports.validated import Validated
from jaxbound.reports.validation import write_page
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.sink import Outcome
from jaxbound.runs.sinks import close_all, open_sinks
from jaxbound.runs.summary import summarised


def evaluate_validation(work: Path, step: Step, run: DetectRun) -> Evaluation:
    """Read a recording, validate it and write everything into a folder, see `evaluate`."""
    seconds, start = {}, time.perf_counter()
    ask, data = run.ask, run.data
    with door():
        plant = stated_model(run.model, run.recording, ask)
        source = open_source(data, plant)
        content, recording = source.content, source.read(progress=lambda share: step("read", share))
        if ask.lags is not None:
            raise ValueError(
                f"lags are for other methods: {VALIDATION} takes every sample of a recording in turn"
            )
        horizon = least_horizon(plant.n, plant.p) if ask.horizon is None else ask.horizon
        _refuse_incomplete(data, recording, horizon)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()
        res, sinks = _validated(plant, recording, horizon), open_sinks(work)
        for sink in sinks:
            sink.add(recording, res)
        step("test", 1.0)
        alarms = res.alarms(stated_rule(run.alarm, plant, run.model), recording.instants)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    reaches = outgrown(plant, looks_back="validation")
    sure = (*device_hints(judging_device(remembers=True)), *bound_hints(plant))
    hints = (*recording.hints, *sure, *reaches, *_assumptions(res, recording))
    summary = summarised(res, alarms, recording.label, run.min_coverage, hints, outgrown=bool(reaches))
    close_all(sinks, Outcome(alarms, summary, plant, Path(data), content, ask, horizon))
    write_page(work / PAGE, res, recording, summary, seconds)
    seconds["report"] = time.perf_counter() - start
    return Evaluation(summary, plant, seconds)


def _assumptions(res: Validated, recording: Recording) -> Iterator[str]:
    """Yield sentences on what the verdicts of a validation rest on beside the bounds."""
    samples = "complete samples, here and behind each gap," if len(recording.starts) else "samples"
    yield (
        f"the first {res.horizon + 1} {samples} are taken to be free of faults: a fault there may stay "
        f"unseen, or blame a healthy sensor"
    )
    if res.model.m:
        yield "inputs are taken as recorded: where an actuator did something else, a healthy sensor is named"
    if res.first_fault is not None:
        yield (
            f"from {recording.label(res.first_fault)} on, the first FAULT, bands hold the true values only "
            f"if every faulty sample was found: a band may follow a sensor that stays wrong"
        )


def _validated(model: LinearSystem, recording: Recording, horizon: int) -> Validated:
    """Return the Validated of a recording."""
    found = validate(model, recording, horizon=horizon)
    return Validated(model, horizon, recording.y, jax.tree.map(np.asarray, found), recording.aside(horizon))


def _refuse_incomplete(data: Path | str, recording: Recording, horizon: int) -> None:
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
