"""A recording against a model: read, tested and written with its report, as a whole or in parts.

A report is written completely or not at all, see `outputs`.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxbound.cli.engine import engine
from jaxbound.cli.share import opened_share
from jaxbound.cli.terminal import door, usable_device
from jaxbound.cli.window import DetectRun, Step, stated_model, window_relations
from jaxbound.diagnosis.alarmrule import AlarmRule, stated_rule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result
from jaxbound.diagnosis.severity import fitted
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.parquet import PARTIAL, VERDICTS
from jaxbound.recordings.read import open_source
from jaxbound.reports.detection import write_report
from jaxbound.runs.digest import Digest, digest
from jaxbound.runs.endings import concluded, sizes_seen
from jaxbound.runs.outputs import OutputFolder
from jaxbound.runs.refusals import Interrupted
from jaxbound.runs.sink import Outcome
from jaxbound.runs.sinks import close_all, file_names, open_sinks
from jaxbound.runs.streaming import all_parts, kept, publish, write_parts
from jaxbound.runs.summary import Summary
from jaxbound.text.quantities import percent

PAGE = "report.html"
FILES_OF_A_WHOLE = (*file_names(), PAGE)
FILES_OF_PARTS = (VERDICTS, "alarms.csv", *file_names(whole=False), PAGE)
# Pictures of an earlier version, which do not belong to a new report.
FORMER = ("margin.png", "residuals.png", *(f"output{i}.png" for i in range(1, 13)))


@dataclass(frozen=True)
class Evaluation:
    """A recording that was tested.

    Fields: summary: Summary. model: LinearSystem. seconds: {stage: its time}.
    """

    summary: Summary
    model: LinearSystem
    seconds: dict[str, float]


def evaluate_parts(folder: OutputFolder, step: Step, run: DetectRun) -> Evaluation:
    """Test a Parquet recording chunk by chunk and write everything into the folder of its report."""
    source, how = opened_share(run, step)
    out, relations = run.out, how.relations
    with door():
        rule = fitted(stated_rule(run.alarm, source.model, run.model), relations)
    seconds: dict[str, float] = {}
    try:
        if run.merge:
            parts = all_parts(how, source, out)
        else:
            progress = lambda share: step("test", share)
            with engine(run.workers) as client:
                parts, seconds = write_parts(how, source, out, progress, client=client)
        start = time.perf_counter()
        with folder.work() as work:
            progress = lambda share: step("report", 0.4 * share)
            sinks = open_sinks(work, whole=False)
            res = digest(how, source, parts, rule, work / "alarms.csv", progress, sinks)
            models = source.model, relations.model
            outcome = _outcome(run, res, rule, res.alarms, res.label, models, source.content)
            summary = outcome.summary
            close_all(sinks, outcome)
            write_report(work / PAGE, res, res, res.alarms, summary, seconds)
    except KeyboardInterrupt:
        if done := kept(out / PARTIAL, source.samples):
            share, where = percent(done / source.samples), out / PARTIAL
            raise Interrupted(
                f"interrupted: {share} of the verdicts are kept in {where}; the same command goes on from "
                f"there"
            ) from None
        raise
    publish(folder)
    for name in ("verdicts.csv", *FORMER):
        folder.remove(name)
    seconds["report"] = time.perf_counter() - start
    return Evaluation(summary, source.model, seconds)


def evaluate(
    work: Path,
    step: Step,
    run: DetectRun,
    sections: Callable[[Result], Sequence[tuple[object, ...]]] = lambda res: (),
) -> Evaluation:
    """Read a recording as a whole, test it and write everything into a folder.

    Args:
        work: the folder. sections: more sections of the report, made from the Result.
    """
    seconds, start = {}, time.perf_counter()
    ask, data = run.ask, run.data
    with door():
        stated = stated_model(run.model, run.recording, ask)
        source = open_source(data, ask.recorded(stated))
        content = source.content  # before it is read, so that what is written meanwhile does not pass for it
        recording = source.read(progress=lambda share: step("read", share))
        tested, relations = window_relations(stated, ask, data, recording.samples, step)
        refuse_short(data, recording.samples, relations.horizon)
        rule = fitted(stated_rule(run.alarm, stated, run.model), relations)
        seconds["read"], start = time.perf_counter() - start, time.perf_counter()
        usable_device()

    with door():
        res = ask.detect(relations, recording, lambda share: step("test", share))
    sinks = open_sinks(work)
    for sink in sinks:
        sink.add(recording, res)
    step("test", 1.0)
    alarms = res.alarms(rule=rule)
    seconds["test"], start = time.perf_counter() - start, time.perf_counter()
    outcome = _outcome(run, res, rule, alarms, recording.label, (stated, tested), content)
    summary = outcome.summary
    close_all(sinks, outcome)
    step("report", 0.1)
    write_report(work / PAGE, res, recording, alarms, summary, seconds, sections(res))
    step("report", 1.0)
    seconds["report"] = time.perf_counter() - start
    return Evaluation(summary, tested, seconds)


def _outcome(
    run: DetectRun,
    res: Result | Digest,
    rule: AlarmRule,
    alarms: Sequence[Alarm],
    label: Callable[[int], str],
    models: tuple[LinearSystem, Any],
    content: str | None,
) -> Outcome:
    """Return the Outcome of a run, with its Summary.

    Args:
        rule: of the alarms. label: the time of a sample by its number. models: as it is stated, and as it was
            tested. content: the digest of the recording.
    """
    relations, (stated, tested) = res.relations, models
    sizes = sizes_seen(res, alarms)
    return Outcome(
        alarms,
        # of the model as it is stated: lags took away the horizon that the bounds were found for
        concluded(res, alarms, stated, label, run.min_coverage, sizes),
        tested,
        Path(run.data),
        content,
        run.ask.of(stated),
        relations.horizon,
        rule.names,
    )
