"""The command `jaxbound evaluate`: right and wrong alarms on recordings whose truth is known."""

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import (
    JSON,
    Options,
    reading,
    rule,
    test,
)
from jaxbound.cli.terminal import OK, Refused, door, progress_bars, usable_device
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    import numpy as np

    from jaxbound.diagnosis.alarmrule import AlarmRule
    from jaxbound.models.system import LinearSystem
    from jaxbound.recordings.recording import Recording
    from jaxbound.runs.ask import Ask
    from jaxbound.studies.assessment.assessment import Assessment

NAME = "evaluate"
HELP = "count false and missed alarms on recordings whose truth is known"
EXAMPLES = (
    (
        "jaxbound evaluate plant.toml --healthy monday.csv --faulty leak.csv",
        "false alarms, missed alarms and delays, over factors on the bounds; all of leak.csv is faulty",
    ),
    (
        "jaxbound evaluate plant.toml --healthy monday.csv --faulty leak.csv --labels anomaly --alarm 1/1 "
        "3/5 --out study/",
        "labels in a column of leak.csv, two alarm rules, a picture of the curves",
    ),
    (
        "jaxbound evaluate plant.toml --healthy monday.csv --faulty leak.csv --peers friday.csv --compare "
        "other.toml",
        "beside PCA, an isolation forest, a CUSUM and a threshold trained on friday.csv, and another model",
    ),
)
CODES = (
    "exit codes: 0 whatever is found, 2 bad input or usage, 70 internal error, 130 interrupted, 129 by "
    "SIGHUP, 143 by SIGTERM (nothing is written)"
)
FILES = ("evaluation.json", "curve.csv", "roc.png")
OPTIONS = Options(
    {
        "model MODEL.toml": "the plant and its bounds",
        "--healthy DATA ...": "recordings without a fault that no bound was found from",
        "--faulty DATA ...": "recordings with faults",
        "--labels FILE|COLUMN ...": "which samples of --faulty are faulty: a CSV file of time (or sample) "
        "and label, one for all or one each, a label holds until the next row; or a column of them. Labels: "
        "0 for healthy, 1, or the name of the faulty signal (default: all samples)",
        **test(),
        "--out DIR": "folder for evaluation.json, curve.csv and roc.png",
    },
    {"alarm": rule},
    dict.fromkeys(("healthy", "faulty", "labels", "compare", "peers"), []),
    more={
        "--alarm k/n ...": "alarm rules, k FAULT among n windows, or plain: no alarm latches, which they do "
        "else where the model's [alarms] say so; the first one makes the curve (default: that of the model, "
        "else plain)",
        "--factors A,B": "factors on all bounds (default: 0.5,0.7,1,1.5,2,3; an observer is followed once "
        "for each)",
        "--compare OTHER.toml ...": "models beside this one",
        "--peers TRAINING ...": "PCA, an isolation forest, a CUSUM and a threshold too, trained on these "
        "healthy recordings: those that the model was fitted to (needs scikit-learn)",
        **reading(),
        **JSON,
    },
)


def run(args: argparse.Namespace) -> int:
    """Assess models on recordings, print and write what was counted; return the exit code."""
    with swift_imports():
        from jaxbound.cli.assessment_summary import AssessmentConclusion, write_assessment
        from jaxbound.cli.window import asked_test, stated_model
        from jaxbound.runs.outputs import output_folder

    factors = _factors(args.factors)
    _refuse_incomplete(args)
    ask = asked_test(args)
    models = [args.model, *args.compare]
    inputs = [*models, *args.healthy, *args.faulty, *args.peers]
    with ExitStack() as stack:
        stack.enter_context(door())
        folder = None
        if args.out is not None:
            folder = stack.enter_context(output_folder(args.out, FILES, inputs))
        step = stack.enter_context(progress_bars(("read", "relations", "test")))
        found = []
        plants = [stated_model(model, args.recording, ask) for model in models]
        rules, hints = _rules(args, plants[0])
        for number, (model, stated) in enumerate(zip(models, plants, strict=True)):
            assessment, said = _assessed(args, (model, stated), ask, rules, factors, number == 0, step)
            found.append(assessment)
            hints += said
        named = {str(model): one for model, one in zip(models, found, strict=True)}
        hints = list(dict.fromkeys(hints))
        written = []
        if args.out is not None:
            written = [args.out / file for file in FILES]
        conclusion = AssessmentConclusion(named, args.out, written=written, hints=hints)
        if folder is not None:
            with folder.work() as work:
                write_assessment(work, named, conclusion.plain())
    conclusion.show(args.json)
    return OK


def _factors(text: str | None) -> list[float] | None:
    """Read numbers with commas."""
    if text is None:
        return None
    try:
        return list(map(decimal, text.split(",")))
    except ValueError:
        raise Refused(f"--factors needs numbers with commas, like 0.5,1,2, not {text!r}") from None


def _rules(args: argparse.Namespace, model: "LinearSystem") -> "tuple[list[AlarmRule], list[str]]":
    """Return (the rules of alarms that are asked for, else that of the model, hints)."""
    from jaxbound.diagnosis.alarmrule import stated_rule

    asked = [{"rule": text} for text in args.alarm or ()]
    rules = [stated_rule(one, model, args.model) for one in asked or [{}]]
    others = sorted(model.alarms.keys() - {"rule", "latch"})
    hints = []
    if others:
        hints = [f"{args.model}: alarms are counted by k of n and latch, without {', '.join(others)}"]
    return rules, hints


def _refuse_incomplete(args: argparse.Namespace) -> None:
    """Raise Refused for options that do not go together."""
    if not args.healthy and not args.faulty:
        raise Refused("there is no recording to evaluate by: give --healthy, --faulty, or both")
    if args.labels and not args.faulty:
        raise Refused("--labels are those of --faulty: give recordings with faults")
    if len(args.labels) not in (0, 1, len(args.faulty)):
        raise Refused(
            f"--labels needs one file or column for all of --faulty, or one each: {len(args.labels)} for "
            f"{len(args.faulty)}"
        )
    trained = {file.resolve() for file in args.peers}
    # a detector shown what it was trained on would look better than it is
    for file in (*args.healthy, *args.faulty):
        if file.resolve() in trained:
            raise Refused(f"{file} is in --peers too: what detectors were trained on does not test them")


def _assessed(
    args: argparse.Namespace,
    model: "tuple[Path, LinearSystem]",
    ask: "Ask",
    rules: "list[AlarmRule]",
    factors: list[float] | None,
    with_peers: bool,
    step: Callable[[str, float], object],
) -> "tuple[Assessment, list[str]]":
    """Return (the counts of a model, hints).

    Args:
        model: its path, and itself. rules: of alarms. factors: on all bounds.
    """
    from jaxbound.cli.window import window_relations
    from jaxbound.diagnosis.hints import outgrown
    from jaxbound.recordings.read import read
    from jaxbound.studies.assessment.assessment import FACTORS, assess

    path, stated = model
    files = [*args.healthy, *args.faulty]
    # other detectors depend on no model: once, beside the first one, will do
    training: list[Path] = []
    if with_peers:
        training = args.peers
    recordings = []
    for number, file in enumerate([*files, *training]):
        recordings.append(read(file, ask.recorded(stated)))
        step("read", (number + 1) / (len(files) + len(training)))
    usable_device()
    healthy, faulty = recordings[: len(args.healthy)], recordings[len(args.healthy) : len(files)]
    labels = []
    for number, (file, recording) in enumerate(zip(args.faulty, faulty, strict=True)):
        labels.append(_labels(args.labels, number, file, stated, recording))
    # a horizon that no recording fills is refused by name, before anything is tested
    longest = max(recording.samples for recording in recordings[: len(files)])
    _, relations = window_relations(stated, ask, "every recording", longest, step)
    assessment = assess(
        relations,
        healthy,
        faulty,
        labels,
        rules=rules,
        factors=factors or FACTORS,
        method=ask.method,
        training=recordings[len(files) :] or None,
        names=list(map(str, args.faulty)),
        progress=lambda share: step("test", share),
    )
    hints = [f"{path}: {hint}" for hint in outgrown(stated, relations)]
    for file, recording in zip(files, recordings, strict=False):
        hints += [f"{file}: {hint}" for hint in recording.hints]
    return assessment, hints


def _labels(
    stated: Sequence[str], number: int, file: Path, model: "LinearSystem", recording: "Recording"
) -> "np.ndarray | None":
    """Return the labels of one faulty recording; None: every sample is faulty."""
    from jaxbound.studies.assessment.labels import column_labels, file_labels

    if not stated:
        return None
    name = stated[min(number, len(stated) - 1)]
    if Path(name).exists():
        return file_labels(Path(name), model, recording)
    return column_labels(file, model, name)
