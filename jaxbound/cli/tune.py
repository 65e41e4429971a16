"""The command `jaxbound tune`: the smallest bounds under which healthy recordings are consistent."""

import argparse
from functools import partial
from typing import TYPE_CHECKING, cast

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import (
    FORCE,
    JSON,
    Options,
    reading,
    share,
    test,
    whole_number,
)
from jaxbound.cli.terminal import INTERRUPTED, OK, Refused, door, progress_bars, say, some_device
from jaxbound.text.progress import in_part
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.studies.tuning.parametrization import Tunable

NAME = "tune"
HELP = "find the smallest bounds under which healthy recordings are consistent"
EXAMPLES = (
    (
        "jaxbound tune plant.toml healthy.csv --out tuned.toml",
        "the smallest bounds that explain healthy.csv, times 1.25",
    ),
    (
        "jaxbound tune plant.toml healthy.csv --faulty leak.csv --out tuned.toml",
        "those that leave most of leak.csv outside",
    ),
    (
        "jaxbound tune plant.toml a.csv b.csv --test observer=joint,latched=true --out tuned.toml",
        "one factor on all bounds, for `detect` with the same observer",
    ),
    (
        "jaxbound tune monitor.toml a.csv b.csv --out tuned.toml",
        "of a model with [[test]] tables: one factor a test",
    ),
)
ORDER = 2
"""By which healthy samples are compared with those around them."""
STEPS = 300
"""Of the search where none are asked for."""
CODES = (
    "exit codes: 0, 2 bad input, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM (the best "
    "bounds until then are written; the same command goes on)"
)
OPTIONS = Options(
    {
        "model MODEL.toml": "its bounds are the start; those at 0 stay 0",
        "healthy HEALTHY ...": "recordings without a fault: CSV or Parquet",
        "--faulty DATA ...": "recordings with a fault, to be left outside",
        "--out TUNED.toml": "the model with its new bounds",
        **test(),
        "--safety F": "factor on the smallest bounds (default: 1.25)",
        **FORCE,
    },
    {"steps": whole_number(0, 10**7), "safety": decimal, "calibrate": share},
    {"faulty": [], "safety": 1.25, "calibrate": 1 / 3},
    ("out",),
    more={
        **reading(),
        "--steps N": f"gradient steps (default: {STEPS}; 0: one factor on all bounds)",
        "--optimizer NAME": "of optax: adam (default), sgd, lion, ...",
        "--bounds A,B": "which move: noise, tolerance, disturbance, parameters (default: all)",
        "--calibrate F": "share of the data kept out of the search (default: 1/3)",
        "--plot PNG": "picture of the search and of the margins",
        **JSON,
    },
)


def run(args: argparse.Namespace) -> int:
    """Find bounds, write the model with them and describe them; return the exit code."""
    with swift_imports():
        import numpy as np

        from jaxbound.cli.tune_summary import (
            FactorConclusion,
            TuneConclusion,
            is_unfinished,
            optimizer,
            tuned_text,
        )
        from jaxbound.cli.window import asked_test, stated_model, window_relations
        from jaxbound.consistency.interface import OBSERVER
        from jaxbound.files.whole import put
        from jaxbound.models.modelfile import load_model
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.tune import plot_tuning
        from jaxbound.recordings.read import read
        from jaxbound.runs.outputs import refuse_targets
        from jaxbound.studies.identification.outliers import refuse_outliers
        from jaxbound.studies.tuning.tuning import MonitorTuneResult, TuneResult, tune

    state = args.out.with_name(args.out.name + ".state.npz")
    files = [*args.healthy, *args.faulty]
    inputs = [args.model, *files]
    goes_on = state.exists() and is_unfinished(args.out)
    refuse_targets({"--out": args.out, "--plot": args.plot}, inputs, args.force or goes_on)
    refuse_targets({"the state of --out,": state}, inputs, force=True)
    chosen = None
    if args.bounds is not None:
        chosen = [name.strip() for name in args.bounds.split(",")]
    ask = asked_test(args, only=("joint", OBSERVER))
    if ask.test is not None and not isinstance(ask.test, str):
        raise Refused("tune finds factors of tests that the model file states: state this one as a [[test]]")
    steps = args.steps
    if steps is None:
        steps = STEPS
    with door(), progress_bars(("read", "relations", "tune")) as step:
        model = stated_model(args.model, args.recording, ask)
        columns = ask.recorded(model)
        text, tests = args.model.read_text(encoding="utf-8-sig"), load_model(args.model).tests
        recordings = []
        for i, file in enumerate(files):
            report = partial(in_part, partial(step, "read"), i / len(files), 1 / len(files))
            recordings.append(read(file, columns, report))
        some_device()
        longest = int(np.argmax([recording.samples for recording in recordings]))
        samples = recordings[longest].samples
        model, relations = window_relations(model, ask, files[longest], samples, step)
        healthy = recordings[: len(args.healthy)]
        records = [(r.u[:, : model.m], r.y, r.starts) for r in healthy]
        notes = refuse_outliers(records, columns, ORDER, 1, lambda: healthy)
        faulty = recordings[len(args.healthy) :] or None
        if relations.parts:
            _refuse_search(args)
        tuning: TuneResult | MonitorTuneResult = tune(
            cast("Tunable", relations),  # or a monitor: --test names no other kind
            healthy,
            faulty,
            optimizer(args.optimizer or "adam", steps),
            steps,
            bounds=chosen,
            safety=args.safety,
            calibrate=args.calibrate,
            progress=lambda share: step("tune", share),
            state=None if relations.parts else state,
        )
        put(args.out, tuned_text(tuning, text, tests))
        if args.plot and isinstance(tuning, TuneResult):
            put(args.plot, to_png(plot_tuning(tuning)))
    hints = notes + [f"{file}: {hint}" for file, r in zip(files, recordings, strict=True) for hint in r.hints]
    if isinstance(tuning, MonitorTuneResult):
        FactorConclusion(tuning, written=[args.out], hints=hints).show(args.json)
        return OK
    written = list(filter(None, (args.out, args.plot)))
    TuneConclusion(tuning, args.healthy, written=written, hints=hints).show(args.json)
    if tuning.stopped:
        say(
            f"stopped after {tuning.steps} of {steps} steps: {args.out} has the best bounds until then; "
            f"the same command goes on"
        )
        return INTERRUPTED
    state.unlink(missing_ok=True)
    return OK


def _refuse_search(args: argparse.Namespace) -> None:
    """Refuse options of a search for several bounds: a test of a monitor has one factor.

    Raises:
        Refused: one of them is asked for.
    """
    for name in ("steps", "optimizer", "bounds", "plot"):
        if getattr(args, name):
            raise Refused(
                f"--{name} is for one test: the model states tests, and each gets one factor; ask for one "
                f"test by --test horizon=30 or observer=joint, or leave --{name} out"
            )
