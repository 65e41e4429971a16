"""A recording that is validated: its verdict, the columns of its file, and its report."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import jax
import numpy as np

from jaxbound.cli.evaluation import Evaluation
from jaxbound.cli.options import MethodOptions
from jaxbound.cli.terminal import door, usable_device
from jaxbound.diagnosis.alarms import Alarm, group_alarms
from jaxbound.diagnosis.hints import bound_hints, outgrown
from jaxbound.estimation.validation import Validation, least_horizon, validate
from jaxbound.models.modelfile import load_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.columns import to_arrow, words
from jaxbound.recordings.read import open_source
from jaxbound.reports.validation import write_page
from jaxbound.runs.judges import Whole
from jaxbound.runs.loop import follow
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.sink import Outcome
from jaxbound.runs.sinks import close_all, open_sinks
from jaxbound.runs.summary import Evidence, evidence, summarised
from jaxbound.runs.verdictfiles import columns_of
from jaxbound.sets.floats.status import Status

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

    relations = property(lambda self: self, doc="Where reports look for the model and the horizon.")
    status = property(lambda self: np.asarray(self.found.status), doc="(T,) int8.")
    margin = property(lambda self: np.full(len(self.y), np.nan), doc="(T,): validation measures none.")

    @property
    def counts(self) -> dict[str, int]:
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def blamed(self) -> dict[str, int]:
        """{output: number of its faulty samples}, those without any left out."""
        return {
            name: int(n)
            for name, n in zip(self.model.outputs, np.asarray(self.found.faulty).sum(0), strict=True)
            if n
        }

    @property
    def first_fault(self) -> int | None:
        """The first sample that is FAULT, None if there is none."""
        fault = self.status == Status.FAULT
        return int(np.argmax(fault)) if fault.any() else None

    def alarms(self, k: int = 1, n: int = 1) -> list[Alarm]:
        """Group FAULT windows. See `Result.alarms`."""
        return group_alarms(self, k, n, 0, 1, 0)

    def explain(self, at: int) -> NoReturn:
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError(
            "validation has no certificate of a single window: its verdict rests on all samples before it"
        )

    def stretches(self) -> list[tuple[int, int, int]]:
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, out = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            out += [(i, int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
        return sorted(out, key=lambda s: s[1:])


@evidence.register(Validated)
def _(res, alarms):
    first = res.first_fault
    ended = dict(Counter(a.ended for a in alarms))
    about = dict(aside=res.aside, at=first, first=first, alarms=len(alarms), ended=ended, faulty=res.blamed)
    return Evidence(res.method, res.horizon, len(res.y), res.counts, **about)


@columns_of.register
def _(res: Validated):
    """Return status, and for each output whether it is faulty, its band and its corrected value; the states'
    bands.

    A bound that is not known, as in the first samples, is blank.
    """
    blank = lambda x: to_arrow(np.where(np.isfinite(x), x, np.nan))
    band = lambda name, x, i: {
        f"{name}.lo": blank(np.asarray(x.lo)[:, i]),
        f"{name}.hi": blank(np.asarray(x.hi)[:, i]),
    }
    columns = {"status": words([s.name for s in Status], res.status)}
    found = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = (np.asarray(end)[:, i] for end in (found.corrected.lo, found.corrected.hi))
        known = np.isfinite(lo) & np.isfinite(hi)
        columns[f"faulty.{name}"] = to_arrow(np.asarray(found.faulty)[:, i])
        columns |= band(f"output.{name}", found.output, i)
        columns[f"corrected.{name}"] = blank(
            np.where(known, np.where(known, lo, 0) / 2 + np.where(known, hi, 0) / 2, np.nan)
        )
        columns |= band(f"corrected.{name}", found.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= band(f"state.{name}", found.state, i)
    return columns


def evaluate_validation(
    work: Path,
    step: Callable[[str, float], object],
    model: Path,
    data: Path | str,
    options: MethodOptions,
    *,
    alarm: tuple[int, int] = (1, 1),
    min_coverage: float = 0.5,
) -> Evaluation:
    """Read a recording, validate it and write everything into a folder, see `evaluate`."""
    seconds, start = {}, time.perf_counter()
    with door():
        plant = load_model(model)
        source = open_source(data, plant)
        held, recording = source.content, source.read(progress=lambda share: step("read", share))
        if options.lags is not None:
            raise ValueError(
                f"--lags is for other methods: {VALIDATION} takes every sample of a recording in turn"
            )
        horizon = least_horizon(plant.n, plant.p) if options.horizon is None else options.horizon
        _complete(data, recording, horizon)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()
        judge, sinks = Whole(lambda r: _validated(plant, r, horizon)), open_sinks(work)
        for _ in follow([recording], judge, sinks):
            step("test", 1.0)
    res = judge.verdicts
    alarms = res.alarms(*alarm)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    first = (
        f"the first {horizon + 1} "
        f"{'complete samples, here and behind each gap,' if len(recording.starts) else 'samples'}"
    )
    assumed = [
        f"{first} are taken to be free of faults: a fault there may stay unseen, or blame a healthy sensor"
    ]
    if plant.m:
        assumed.append(
            "inputs are taken as recorded: where an actuator did something else, a healthy sensor is named"
        )
    if res.first_fault is not None:
        assumed.append(
            f"from {recording.label(res.first_fault)} on, the first FAULT, bands hold the true values only "
            f"if every faulty sample was found: a band may follow a sensor that stays wrong"
        )
    reaches = outgrown(plant, res, "validation")
    hints = (*recording.hints, *bound_hints(plant), *reaches, *assumed)
    summary = summarised(res, alarms, recording.label, min_coverage, hints, outgrown=bool(reaches))
    close_all(sinks, Outcome(alarms, summary, plant, Path(data), held, options.method, horizon))
    write_page(work, res, recording, summary, seconds=seconds, progress=lambda share: step("report", share))
    seconds["report"] = time.perf_counter() - start
    return Evaluation(summary, plant, seconds)


def _validated(model, recording, horizon):
    """Return the Validated of a recording."""
    found = validate(model, recording, horizon=horizon)
    return Validated(model, horizon, recording.y, jax.tree.map(np.asarray, found), recording.aside(horizon))


def _complete(data, recording, horizon):
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
