"""The commands `jaxbound detect` and `jaxbound demo`: from files to verdicts, a report and an exit code.

A report is written completely or not at all, see `outputs`.
"""

import argparse
import json
import re
import shlex
import threading
import time
from typing import cast

import jax
import numpy as np

from jaxbound.cli.engine import engine_of, refuse_engine
from jaxbound.cli.share import opened, refuse_shares, run_share
from jaxbound.cli.terminal import door, progress_bars, show, usable_device, write
from jaxbound.cli.validate import Validated
from jaxbound.cli.window import OBSERVER, observer_options, window_relations
from jaxbound.consistency.interface import METHODS
from jaxbound.diagnosis.again import again_hints
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.hints import bound_hints, outgrown
from jaxbound.estimation.validation import least_horizon, validate
from jaxbound.models.modelfile import load_model, save_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.read import kind_of, open_source
from jaxbound.reports.detection import write_report
from jaxbound.reports.validation import write_page
from jaxbound.runs.digest import digest
from jaxbound.runs.endings import ending_hints, sizes_seen
from jaxbound.runs.judges import Whole
from jaxbound.runs.loop import follow
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.refusals import Interrupted, Refused
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.sink import Outcome
from jaxbound.runs.sinks import Beside, close_all, file_names, open_sinks
from jaxbound.runs.streaming import CHUNK, PARTIAL, VERDICTS, all_parts, kept, publish, write_parts
from jaxbound.runs.summary import OUTSIDE, Evidence, Summary, Window, summarised
from jaxbound.text.quantities import percent, times

__all__ = ["conclude", "run_demo", "run_detect"]

FORMER = (
    "margin.png",
    "residuals.png",
    *(f"output{i}.png" for i in range(1, 13)),
)  # pictures of an earlier version, which do not belong to a new report
COLOUR = {
    "no fault": "bold green",
    "fault": "bold red",
    "too little evidence": "bold yellow",
    OUTSIDE: "bold yellow",
}


def run_detect(args: argparse.Namespace) -> int:
    """Run `jaxbound detect`; return the exit code."""
    if args.data == "-":
        refuse_engine(args, "is for Parquet: samples through a pipe are judged as they come")
        from jaxbound.cli import pipe

        return pipe.run(args)
    if args.out is None:
        raise Refused("the following arguments are required: --out; see jaxbound detect --help")
    if args.state is not None:
        raise Refused("--state is for samples that come through a pipe: give - as DATA")
    if args.method not in (*METHODS, OBSERVER, VALIDATION):
        raise Refused(
            f"--method must be one of {', '.join((*METHODS, OBSERVER, VALIDATION))}, not {args.method!r}"
        )
    with door(OSError):
        kind = kind_of(args.data)
    refuse_shares(args, kind)
    if args.method == VALIDATION or not kind.parts:
        refuse_engine(args, f"is for Parquet and other methods: {args.data} is read as a whole")
    if args.part is not None or args.merge:
        refuse_engine(args, "spreads the work itself: leave out --part and --merge")
    if args.part is not None:
        return run_share(args)
    if args.method == VALIDATION:
        if args.chunk is not None:
            raise Refused(f"--chunk is for other methods: {VALIDATION} reads {args.data} as a whole")
        found = _report(args, _validate, ("read", "test", "report"))
    elif kind.parts:
        names, inputs = (
            (VERDICTS, "alarms.csv", *file_names(whole=False), "report.html"),
            (args.model, args.data),
        )
        with (
            door(),
            output_folder(args.out, names, inputs) as folder,
            progress_bars(("relations", "test", "report")) as step,
        ):
            found = _stream(args, folder, step)
    elif args.chunk is not None:
        raise Refused(f"--chunk is for Parquet: {args.data} is read as a whole")
    else:
        found = _report(args, _evaluate, ("read", "relations", "test", "report"))
    return conclude(args, *found)


def _report(args, how, stages):
    """Let `how` read a recording as a whole, test it and write its report; return what the conclusion
    needs.
    """
    names, inputs = (*file_names(), "report.html"), (args.model, args.data)
    with door(OSError), output_folder(args.out, names, inputs) as folder:
        with folder.work() as work, progress_bars(stages) as step:
            found = how(args, work, step)
        for name in (VERDICTS, *FORMER):
            folder.remove(name)
    return found


def _stream(args, folder, step):
    """Test a Parquet recording chunk by chunk and write everything into the OutputFolder; return what the
    conclusion needs.
    """
    source, relations = opened(args, step)
    seconds: dict[str, float] = {}
    try:
        if args.merge:
            parts = all_parts(relations, source, args.out, args.method, args.overlap)
        else:
            chunk, progress = args.chunk or CHUNK, lambda share: step("test", share)
            with engine_of(args) as client:
                wanted = relations, source, args.out, args.method, chunk, progress
                parts, seconds = write_parts(*wanted, client=client, overlap=args.overlap)
        start = time.perf_counter()
        with folder.work() as work:
            progress = lambda share: step("report", 0.4 * share)
            sinks = open_sinks(work, whole=False)
            how = args.method, args.alarm, work / "alarms.csv", progress, sinks
            found = digest(relations, source, parts, *how)
            sizes = sizes_seen(found, found.alarms)
            reaches = outgrown(source.model, relations)
            hints = dict.fromkeys((*found.hints, *reaches, *ending_hints(found, found.alarms, sizes)))
            res = summarised(found, found.alarms, found.label, args.min_coverage, hints, sizes, bool(reaches))
            about = relations.model, args.data, source.content, args.method, relations.horizon
            close_all(sinks, Outcome(found.alarms, res, *about, observer_options(args)))
            write_report(
                work,
                found,
                found,
                found.alarms,
                res,
                seconds=seconds,
                progress=lambda share: step("report", 0.4 + 0.6 * share),
            )
    except KeyboardInterrupt:
        if done := kept(args.out / PARTIAL, source.samples):
            share, where = percent(done / source.samples), args.out / PARTIAL
            raise Interrupted(
                f"interrupted: {share} of the verdicts are kept in {where}; the same command goes on from "
                f"there"
            ) from None
        raise
    publish(folder)
    for name in ("verdicts.csv", *FORMER):
        folder.remove(name)
    seconds["report"] = time.perf_counter() - start
    return res, source.model, seconds


def _evaluate(args, work, step, extra=lambda res: ()):
    """Read, test and write everything into the folder `work`; return what the conclusion needs."""
    seconds, start = {}, time.perf_counter()
    with door():
        stated = load_model(args.model)
        source = open_source(args.data, stated)
        held, recording = source.content, source.read(progress=lambda share: step("read", share))
        model, relations = window_relations(stated, args, args.data, recording.samples, step)
        refuse_short(args.data, recording.samples, relations.horizon)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()
    with Beside(open_sinks(work)) as sinks:  # a million verdicts are written while the pictures are drawn
        test = lambda r: detect(relations, r, method=args.method, progress=lambda share: step("test", share))
        judge = Whole(test)
        with door():
            for _ in follow([recording], judge, [sinks]):
                step("test", 1.0)
        res = judge.verdicts
        alarms = res.alarms(*args.alarm)
        seconds["test"], start = time.perf_counter() - start, time.perf_counter()
        sizes = sizes_seen(res, alarms)
        reaches = outgrown(stated, relations)
        hints = dict.fromkeys((*res.hints, *reaches, *again_hints(res), *ending_hints(res, alarms, sizes)))
        found = summarised(res, alarms, recording.label, args.min_coverage, hints, sizes, bool(reaches))
        about = model, args.data, held, args.method, relations.horizon, observer_options(args)
        sinks.close(Outcome(alarms, found, *about))
        step("report", 0.1)
        write_report(
            work,
            res,
            recording,
            alarms,
            found,
            seconds=seconds,
            extra=extra(res),
            progress=lambda share: step("report", 0.1 + 0.8 * share),
        )
    step("report", 1.0)
    seconds["report"] = time.perf_counter() - start
    return found, model, seconds


def _validate(args, work, step):
    """Read, validate and write everything into the folder `work`; return what the conclusion needs."""
    seconds, start = {}, time.perf_counter()
    with door():
        model = load_model(args.model)
        source = open_source(args.data, model)
        held, recording = source.content, source.read(progress=lambda share: step("read", share))
        if args.lags is not None:
            raise ValueError(
                f"--lags is for other methods: {VALIDATION} takes every sample of a recording in turn"
            )
        horizon = least_horizon(model.n, model.p) if args.horizon is None else args.horizon
        _complete(args.data, recording, horizon)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()
        judge = Whole(lambda r: _validated(model, r, horizon))
        sinks = open_sinks(work)
        for _ in follow([recording], judge, sinks):
            step("test", 1.0)
    res = judge.verdicts
    alarms = res.alarms(*args.alarm)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    first = (
        f"the first {horizon + 1} "
        f"{'complete samples, here and behind each gap,' if len(recording.starts) else 'samples'}"
    )
    assumed = [
        f"{first} are taken to be free of faults: a fault there may stay unseen, or blame a healthy sensor"
    ]
    if model.m:
        assumed.append(
            "inputs are taken as recorded: where an actuator did something else, a healthy sensor is named"
        )
    if res.first_fault is not None:
        assumed.append(
            f"from {recording.label(res.first_fault)} on, the first FAULT, bands hold the true values only "
            f"if "
            "every faulty sample was found: a band may follow a sensor that stays wrong"
        )
    reaches = outgrown(model, res, "validation")
    hints = (*recording.hints, *bound_hints(model), *reaches, *assumed)
    summary = summarised(res, alarms, recording.label, args.min_coverage, hints, outgrown=bool(reaches))
    close_all(sinks, Outcome(alarms, summary, model, args.data, held, args.method, horizon))
    write_page(work, res, recording, summary, seconds=seconds, progress=lambda share: step("report", share))
    seconds["report"] = time.perf_counter() - start
    return summary, model, seconds


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


def conclude(
    args: argparse.Namespace, summary: Summary, model: LinearSystem, seconds: dict[str, float]
) -> int:
    """Print what was found and return the exit code."""
    if args.json:
        rounded = {k: round(v, 3) for k, v in seconds.items()}
        plain = summary.plain(data=str(args.data), seconds=rounded, out=str(args.out))
        write(json.dumps(plain, indent=2, allow_nan=False) + "\n")
        return summary.exit_code
    found, counts = cast(Evidence, summary.found), summary.counts  # a recording was tested
    rows = [
        (
            "samples" if found.remembers else "windows",
            ", ".join(
                f"{counts[s]} {s}" for s in ("FAULT", "CONSISTENT", "UNDECIDED", "MISSING") if counts[s]
            ),
        )
    ]
    if found.remembers:
        rows.append(
            (
                "tested",
                f"{percent(found.tested)} of {found.windows} samples, by an observer of all samples before "
                f"them",
            )
        )
    elif found.faulty is None:
        by = f"by the {found.method} test over {found.horizon + 1} samples each"
        rows.append(("decided", f"{percent(found.decided)} of {found.windows} windows, {by}"))
    else:
        rows.append(
            ("faulty", ", ".join(f"{name} in {n} samples" for name, n in found.faulty.items()) or "no sensor")
        )
    proved = counts["FAULT"] and found.faulty is None and not model.uncertainties
    command = f"jaxbound explain {shlex.quote(str(args.out))} --at "
    first = summary.first_alarm
    rows.append(("alarms", f"{found.alarms}" + (f", the first at {first}" if found.alarms else "")))
    if proved and found.alarms and re.fullmatch(r"\S+ s|\d{4}-\d\d-\d\d[ T][\d:.]+", first):
        rows[-1] = (
            "alarms",
            f"{rows[-1][1]}: {command}{shlex.quote(first.removesuffix(' s') + 's' * first.endswith(' s'))}",
        )
    if np.isfinite(summary.margin):
        at, margin = cast(Window, summary.worst).time, summary.margin
        what = (
            f"bounds needed: {times(1 - margin)} the stated ones"
            if margin < 0
            else f"{percent(1 - margin)} of the bounds are used"
        )
        if found.remembers:
            what = (
                f"beyond what the samples before allow by {times(1 - margin)}"
                if margin < 0
                else f"{percent(1 - margin)} of it is used"
            )
        rows.append(
            (
                "worst" if found.remembers else "worst window" if margin < 0 else "tightest",
                f"{at}: margin {margin:.3g}, {what}",
            )
        )
    if proved:
        rows.append(("proof" if summary.verdict == "fault" else "why", f"{command}{found.at}"))
    rows += [("hint", h) for h in summary.hints]
    rows += [
        ("seconds", ", ".join(f"{name} {s:.1f}" for name, s in seconds.items())),
        ("report", str(args.out / "report.html")),
    ]
    show(summary.sentence, COLOUR[summary.verdict], rows)
    return summary.exit_code


def _load_plotting():
    """Import matplotlib while the data are read: it takes as long as testing a million windows."""
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


def run_demo(args: argparse.Namespace) -> int:
    """Run `jaxbound demo`; return the exit code."""
    from jaxbound.cli import demo

    threading.Thread(target=_load_plotting, daemon=True).start()
    names = ("model.toml", "run.csv", *file_names(), "report.html", "figure_1.png", "figure_2.png")
    stages = ("simulate", "read", "relations", "test", "report")
    with (
        door(OSError),
        output_folder(args.out, names) as folder,
        folder.work() as work,
        progress_bars(stages) as step,
    ):
        with door():
            usable_device()
        run = demo.demo_run(jax.random.key(2000))
        rates, (false_alarms, clean) = demo.detection_rates(
            args.runs, jax.random.key(5), lambda share: step("simulate", share)
        )
        save_model(demo.demo_model(), work / "model.toml")
        demo.write_run(work / "run.csv", run)

        detecting = argparse.Namespace(
            model=work / "model.toml",
            data=work / "run.csv",
            horizon=None,
            lags=None,
            method="joint",
            alarm=(1, 1),
            order=None,
            latched=False,
            min_coverage=0.5,
        )
        extra = lambda res: demo.sections(work, run, res, rates, false_alarms, clean, args.runs)
        found, *_ = _evaluate(detecting, work, step, extra)
    again = [
        "jaxbound",
        "detect",
        *(str(args.out / f) for f in ("model.toml", "run.csv")),
        "--out",
        str(args.out),
    ]
    rows = [
        ("false alarms", f"{false_alarms} in {clean} windows without a fault ({args.runs} runs)"),
        ("report", str(args.out / "report.html")),
        ("try it", shlex.join(again)),
    ]
    show(f"Section 5 of Adrot, Maquin, Ragot 2000. {found.sentence}", "bold", rows, demo.rate_table(rates))
    return 0
