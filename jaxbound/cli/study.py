"""The command `jaxbound study`: a Monte-Carlo study of a monitor, from a model file to tables and a page."""

import argparse
import time
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping
from typing import Any

from jaxbound.cli.command import swift_imports
from jaxbound.cli.names import parted, unquoted
from jaxbound.cli.options import ENGINE, JSON, Options, test, whole_number
from jaxbound.cli.terminal import LOUDNESS, OK, QUIET, Refused, door, progress_bars, say, usable_device
from jaxbound.text.quantities import decimal

NAME = "study"
HELP = "simulate a million scenarios and count what is detected"
EXAMPLES = (
    (
        "jaxbound study plant.toml --faults T1:bias,T2:drift --n 10000 --out study/",
        "sizes around those that are guaranteed",
    ),
    (
        "jaxbound study plant.toml --faults T1:bias --sizes 0.1:1:10 --scenario at=vertices --out study/",
        "ten sizes; unknowns at their bounds",
    ),
)
CODES = (
    "exit codes: 0, 2 bad input, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM (the same "
    "command goes on)"
)
MOST_SIZES = 10_000  # of a fault
PATIENCE = 20.0
"""Seconds that a study may take without being announced."""
OPTIONS = Options(
    {
        "model MODEL.toml": "the plant and the bounds of its monitor",
        "--faults F,F": "like y1:bias,y2:gain,u1:bias; kinds as in a simulation; a name with commas in "
        "backticks",
        "--sizes LO:HI:COUNT": "or numbers with commas (default: twelve around the guaranteed size)",
        "--n N": "scenarios, spread over faults and sizes (default: 100000)",
        "--out DIR": "folder for summary.csv, delays.parquet and report.html",
        **test(),
    },
    {"n": whole_number(1), "seed": whole_number()},
    {"n": 100_000, "seed": 0},
    ("faults", "out"),
    more={
        "--scenario A=1,B=2": "samples=200; onset=LO:HI, where the fault starts (default: the second "
        "quarter); at=uniform, vertices of their bounds, or adversarial: unknowns; input_range=LO:HI, levels "
        "of the inputs, one pair for all or one each with commas (default: the ranges of the model file, "
        "else from 1 below the operating point to 1 above); hold=20, samples that a level lasts",
        "--seed K": "of the scenarios (default: 0)",
        **ENGINE,
        "--rows": "keep a row for each scenario in DIR/scenarios/",
        **JSON,
    },
)


def run(args: argparse.Namespace) -> int:
    """Count the detections of a monitor, write tables and a page; return the exit code."""
    start = time.perf_counter()
    with swift_imports():
        from jaxbound.cli.engine import engine
        from jaxbound.cli.study_summary import FILES, StudyConclusion, write_study
        from jaxbound.cli.window import asked_test, stated_model, window_relations
        from jaxbound.consistency.interface import METHODS
        from jaxbound.runs.outputs import output_folder
        from jaxbound.studies.montecarlo.montecarlo import study

    sizes = _sizes(args.sizes)
    scenario, ask = _scenario(args.scenario or {}), asked_test(args)
    faults = [_fault_text(fault) for fault in parted(args.faults) if fault]
    stages = progress_bars(("relations", "study", "report"))
    with (
        door(),
        output_folder(args.out, FILES, (args.model,)) as folder,
        stages as step,
        engine(args.workers) as client,
    ):
        model = stated_model(args.model, None, ask)
        usable_device()
        model, relations = window_relations(model, ask, "--scenario samples", scenario["samples"], step)
        result = study(
            model,
            faults,
            args.n,
            args.seed,
            relations,
            sizes=sizes,
            method=ask.method if ask.method in METHODS else METHODS[0],
            progress=_Announced(args.n, scenario["samples"], lambda share: step("study", share)),
            out=args.out,
            rows=args.rows,
            client=client,
            **scenario,
        )
        seconds = time.perf_counter() - start
        step("report", 0.2)
        with folder.work() as work:
            write_study(work, result, args.seed, seconds)
        folder.remove("study.png")  # of an earlier version
        step("report", 1.0)
    StudyConclusion(result, args.out / "report.html", seconds).show(args.json)
    return OK


def _fault_text(text: str) -> str:
    """Return signal:kind, of a signal that may stand in backticks or double quotes.

    Example:
        >>> _fault_text("`Q1=Heater, left`:bias"), _fault_text("AHU: Supply:gain"), _fault_text('"a, b"')
        ('Q1=Heater, left:bias', 'AHU: Supply:gain', 'a, b')
    """
    signal, colon, kind = text.rpartition(":")
    # the whole text is quoted: a fault by its name, colons and all
    if not colon or unquoted(text) != text:
        return unquoted(text)
    return f"{unquoted(signal)}:{kind}"


class _Announced:
    """Progress of a study that says once, when a first part of it is counted, how long the rest will take."""

    def __init__(self, scenarios: int, samples: int, step: Callable[[float], object]):
        self.work = f"{scenarios} scenarios of {samples} samples"
        self.step = step
        self.first: tuple[float, float] | None = None  # (time, share) behind the first part
        self.is_said = LOUDNESS.get() == QUIET

    def __call__(self, share: float) -> None:
        from jaxbound.text.quantities import rough_duration

        self.step(share)
        now = time.monotonic()
        if self.first is None:
            self.first = now, share  # what is compiled is compiled now
            return
        then, done = self.first
        if self.is_said or share <= done:
            return
        # by what came behind the first part, in which programs were compiled
        left = (1 - share) * (now - then) / (share - done)
        self.is_said = share > done + 0.02 or now - then > 1
        if self.is_said and left > PATIENCE:
            say(f"{self.work}: {rough_duration(left)} to go; stopped, the same command goes on")


def _sizes(text: str | None) -> list[float] | None:
    """Read sizes: lo:hi:count, or numbers with commas."""
    import numpy as np

    if text is None:
        return None
    try:
        if ":" not in text:
            return [decimal(x) for x in text.split(",")]
        lo, hi, count = text.split(":")
        if not (count.isascii() and count.isdecimal()):
            raise ValueError
        if int(count) > MOST_SIZES:
            raise Refused(f"--sizes asks for {int(count)} sizes of a fault: at most {MOST_SIZES} are studied")
        return list(np.linspace(decimal(lo), decimal(hi), int(count)).tolist())
    except ValueError:
        raise Refused(
            f"--sizes needs lo:hi:count, like 0.1:1:10, or numbers with commas, not {text!r}"
        ) from None


def _onset_range(text: str) -> tuple[int, int]:
    """Read the first and last sample of an onset: lo:hi."""
    pairs = _ranges_in(text)
    if len(pairs) > 1 or not all(x.is_integer() for x in pairs[0]):
        raise ArgumentTypeError(f"needs two whole numbers lo:hi, not {text!r}")
    low, high = pairs[0]
    return int(low), int(high)


def _ranges_in(text: str) -> list[tuple[float, ...]]:
    """Read lo:hi, or several such pairs with commas."""
    try:
        pairs = [tuple(map(decimal, part.split(":"))) for part in text.split(",")]
    except ValueError:
        pairs = [()]
    if any(len(pair) != 2 for pair in pairs):
        raise ArgumentTypeError(f"needs lo:hi, like -1:1, not {text!r}")
    return pairs


def _levels(text: str) -> object:
    """Read the range of all inputs, or one of each."""
    pairs = _ranges_in(text)
    if len(pairs) == 1:
        return pairs[0]
    return pairs


SCENARIO: dict[str, Callable[[str], object]] = {
    "samples": whole_number(1, 10**6),
    "onset": _onset_range,
    "at": str,
    "input_range": _levels,
    "hold": whole_number(1),
}
USUAL = {"samples": "200", "at": "uniform", "hold": "20"}


def _scenario(said: Mapping[str, str]) -> dict[str, Any]:
    """Return the keywords of `study` that --scenario says."""
    from jaxbound.models.filevalues import known_fields  # imports what a help does not wait for

    scenario: dict[str, Any] = {}
    with door():
        known_fields("--scenario", dict(said), tuple(SCENARIO))
    for name, text in {**USUAL, **said}.items():
        try:
            scenario[name] = SCENARIO[name](text)
        except ArgumentTypeError as e:
            raise Refused(f"{name} of --scenario {e}") from None
    return scenario
