"""The command `jaxbound study`: a Monte-Carlo study of a monitor, from a model file to tables and a page."""

import argparse
import json
import time

import jax
import numpy as np

from jaxbound.cli.engine import engine_of
from jaxbound.cli.terminal import LOUDNESS, QUIET, door, progress_bars, say, show, usable_device, write
from jaxbound.cli.window import OBSERVER, window_relations
from jaxbound.models.modelfile import load_model
from jaxbound.recordings.columns import texts, to_arrow, write_columns
from jaxbound.reports.study import COLUMNS, HEAD, sentence, study_page, study_rows
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.refusals import Refused
from jaxbound.studies.montecarlo.montecarlo import study
from jaxbound.studies.montecarlo.study_result import delay_table, study_table
from jaxbound.text.characters import cell
from jaxbound.text.quantities import rough_duration

__all__ = ["run"]

NAMES = ("summary.csv", "summary.parquet", "delays.parquet", "report.html")
MOST = 10_000  # sizes of a fault
PATIENCE = 20.0
"""Seconds that a study may take without being announced."""


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound study`; return the exit code."""
    start = time.perf_counter()
    sizes, span = _sizes(args.sizes), _pairs("--input-range", args.input_range)
    onset = _pairs("--onset", args.onset)
    if onset is not None and (len(onset) > 1 or not all(x.is_integer() for x in onset[0])):
        raise Refused(f"--onset needs two whole numbers lo:hi, not {args.onset!r}")
    faults = [f.strip() for f in args.faults.split(",") if f.strip()]
    stages = progress_bars(("relations", "study", "report"))
    with (
        door(),
        output_folder(args.out, NAMES, (args.model,)) as folder,
        stages as step,
        engine_of(args) as client,
    ):
        model = load_model(args.model)
        usable_device()
        model, relations = window_relations(model, args, "--samples", args.samples, step)
        span = span[0] if span is not None and len(span) == 1 else span
        onset = None if onset is None else tuple(map(int, onset[0]))
        by, progress = (
            "joint" if args.method == OBSERVER else args.method,
            _Announced(args, lambda share: step("study", share)),
        )
        res = study(
            model,
            faults,
            args.n,
            args.seed,
            relations,
            samples=args.samples,
            sizes=sizes,
            onset=onset,
            at=args.at,
            input_range=span,
            hold=args.hold,
            method=by,
            progress=progress,
            out=args.out,
            rows=args.rows,
            client=client,
        )
        counted = time.perf_counter() - start
        step("report", 0.2)
        with folder.work() as work:
            _write(work, res, args.seed, counted)
        folder.remove("study.png")  # of an earlier version
        step("report", 1.0)
    _conclude(args, res, counted)
    return 0


class _Announced:
    """Progress of a study that says once, when a first part of it is counted, how long the rest will take."""

    def __init__(self, args, step):
        self.args, self.step, self.first, self.said = args, step, None, LOUDNESS.get() == QUIET

    def __call__(self, share):
        self.step(share)
        now = time.monotonic()
        if self.first is None:
            self.first = now, share  # what is compiled is compiled now
        elif not self.said and share > self.first[1]:
            left = (1 - share) * (now - self.first[0]) / (share - self.first[1])
            self.said = share > self.first[1] + 0.02 or now - self.first[0] > 1
            if self.said and left > PATIENCE:
                work = f"{self.args.n} scenarios of {self.args.samples} samples"
                say(f"{work}: {rough_duration(left)} to go; stopped, the same command goes on")


def _sizes(text):
    """Read sizes: lo:hi:count, or numbers with commas."""
    if text is None:
        return None
    try:
        if ":" in text:
            lo, hi, count = text.split(":")
            if int(count) > MOST:
                raise Refused(f"--sizes asks for {int(count)} sizes of a fault: at most {MOST} are studied")
            return np.linspace(float(lo), float(hi), int(count)).tolist()
        return [float(x) for x in text.split(",")]
    except ValueError:
        raise Refused(
            f"--sizes needs lo:hi:count, like 0.1:1:10, or numbers with commas, not {text!r}"
        ) from None


def _pairs(option, text):
    """Read lo:hi, or several such pairs with commas."""
    if text is None:
        return None
    try:
        pairs = [tuple(map(float, part.split(":"))) for part in text.split(",")]
    except ValueError:
        pairs = [()]
    if any(len(p) != 2 for p in pairs):
        raise Refused(f"{option} needs lo:hi, like -1:1, not {text!r}")
    return pairs


def _write(work, res, seed, seconds):
    """Write the tables and the page of a study."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    found, delays = study_table(res), delay_table(res)
    write_columns(work / "summary.csv", {name: _column(x, cell) for name, x in found.items()})
    columns = {name: _column(x) for name, x in delays.items()}
    columns["delay"] = columns["delay"].cast(pa.int64())
    for name, table in (("summary", {name: _column(x) for name, x in found.items()}), ("delays", columns)):
        pq.write_table(pa.Table.from_arrays(list(table.values()), list(table)), work / f"{name}.parquet")
    (work / "report.html").write_text(study_page(res, seed, seconds), encoding="utf-8")


def _column(values, written=str):
    """Return numbers, or texts as they are written, as a pyarrow array."""
    if values.dtype != object:
        return to_arrow(values)
    names = list(dict.fromkeys(values))
    return texts([written(name) for name in names]).take(to_arrow(np.array([names.index(v) for v in values])))


def _conclude(args, res, seconds):
    if args.json:
        false, clean = res.false_alarms
        known = lambda x: None if isinstance(x, float) and not np.isfinite(x) else x
        columns = {name: list(map(known, x.tolist())) for name, x in study_table(res).items()}
        cells = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        told = {
            "scenarios": res.scenarios,
            "samples": res.samples,
            "at": res.at,
            "horizon": res.horizon,
            "false_alarms": false,
            "clean_windows": clean,
            "cells": cells,
            "report": str(args.out / "report.html"),
        }
        write(json.dumps(told, indent=1, default=float) + "\n")
        return
    speed = (
        f"{res.scenarios * res.samples / max(seconds, 1e-9) / 1e6:.3g} million samples a second on "
        f"{jax.local_device_count()} device"
    )
    rows = [
        ("study", sentence(res)),
        ("columns", COLUMNS),
        ("seconds", f"{seconds:.1f}, {speed}"),
        ("report", str(args.out / "report.html")),
    ]
    show(res.model.name, "bold", rows, table=[HEAD, *study_rows(res)])
