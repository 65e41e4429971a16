"""The command `jaxbound fit`: from recordings to a model file, and the picture of a fit."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import FORCE, JSON, Options, reading, sampling
from jaxbound.cli.terminal import OK, Refused, door, hushed, progress_bars, some_device
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.recordings.recording import Recording
    from jaxbound.recordings.signals import Signals

NAME = "fit"
HELP = "find a model and its bounds from healthy recordings"
EXAMPLES = (
    ("jaxbound fit healthy.csv --inputs heater --outputs T1,T2 --out plant.toml", "signals are columns"),
    (
        "jaxbound fit a.csv b.csv --inputs 'Q=Heater 1' --outputs 'lift=`T out`-`T room`' --where 'fan > 0' "
        "--out plant.toml",
        "names for columns, a signal computed from columns, only while the fan runs",
    ),
    ("jaxbound fit may.csv june.csv --recipe plant.toml --out new.toml", "as plant.toml was fitted"),
    (
        "jaxbound fit --add monday.csv plant.toml",
        "monday was healthy: wider bounds hold it, too",
    ),
)
CODES = (
    "exit codes: 0, 2 bad input or usage, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM "
    "(nothing is written)"
)
OPTIONS = Options(
    {
        "data DATA ...": "healthy recordings: CSV files, Parquet files or folders",
        "--add": "one of DATA is a model file: it gets bounds just wide enough for the others, and stays as "
        "it is else; without --out that file is changed",
        "--inputs A,B": "columns; or name=column, or name=expression like lift=Tsup-Tmix; names with commas "
        "or = in backticks or double quotes; wind=angle(W) becomes wind sin and wind cos, of degrees "
        "(radians: angle(W,2*pi)), and rate(angle(W)) is how fast it turns, in radians a second; rate(n) is "
        "the growth of a counter in a second, rate(n,65536) of one that begins at 0 again there",
        "--outputs C,D": "as --inputs: what the model is to explain; these and their columns may be left out "
        "with a --recipe from a model file",
        "--recipe RECIPE": "how to fit, and for which test, like order=1,horizon=30 (windows of 31 samples) "
        "or a model file, to fit as it was fitted; order, delay: numbers or auto (default: 2, 1); "
        "direct=true: inputs act at once; horizon, lags=0,1,2,4, average=8: windows; test=bank: all "
        "that see what others miss, auto: the best (default: bank, where nothing else says what is tested); "
        "observer, disturbances=auto, see=T1:bias:2: bounds of an observer, of disturbances, for these "
        "faults; follow=auto: bounds follow the operating point; signals=auto: choose inputs; method: least "
        "squares, windows, filters, auto; safety (default: 1.25); held_out (default: 0.3)",
        "--out MODEL.toml": "the model file to write",
    },
    {"dt": decimal, "most": decimal},
    {"inputs": "", "outputs": ""},
    more={
        "--where EXPR": "condition on columns: samples where it does not hold are no part of the recording",
        **reading("as recorded", "; dt=60: the sampling period in s (default: the median step of the time)"),
        "--dt SECONDS": argparse.SUPPRESS,
        "--name NAME": "of the plant (default: that of the model file)",
        "--most F": "with --add: bounds that have to grow by more are refused, for a fault would be learnt "
        "(default: 3)",
        "--plot PNG": "picture: how much of the bounds each window needs",
        **FORCE,
        **JSON,
    },
)
NEW = ("inputs", "outputs", "recipe", "where", "recording", "dt", "name", "plot")
"""Options that a model which is widened has no use for."""


def run(args: argparse.Namespace) -> int:
    """Fit a model to recordings, or widen one by them; write and describe it; return the exit code."""
    if args.add:
        return _add(args)
    if args.most is not None:
        raise Refused("--most is for --add: --recipe safety=1.5 makes bounds of a new model wider")
    if args.out is None:
        raise Refused("--out is needed: the model file to write")
    with swift_imports():
        from jaxbound.cli.fit_summary import FitConclusion
        from jaxbound.files.whole import put
        from jaxbound.models.modelfile import model_text
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.fit import plot_fit
        from jaxbound.recordings.read import read_signals
        from jaxbound.runs.outputs import refuse_targets
        from jaxbound.studies.identification.fitting import fit
        from jaxbound.studies.identification.recipe import recipe_of
        from jaxbound.studies.identification.signal_choice import products

    refuse_targets({"--out": args.out, "--plot": args.plot}, args.data, args.force)
    with door(), hushed(), progress_bars(("read", "fit")) as step:
        file, fields = _recipe(args.recipe or {})
        recipe = recipe_of(file, fields)
        signals, units, name = _signals(args, file)
        inputs, columns = signals.inputs, dict(signals.columns)
        pool = products(inputs, columns) if recipe.signals else {}
        recordings = read_signals(
            args.data,
            (*inputs, *pool),
            signals.outputs,
            columns | pool,
            signals.dt,
            lambda share: step("read", share),
        )
        some_device()
        model = fit(
            recordings,
            recipe,
            inputs=inputs,
            outputs=signals.outputs,
            name=name,
            units=units,
            columns=columns,
            progress=lambda share: step("fit", share),
        )
        put(args.out, model_text(model).encode())
        if args.plot:
            put(args.plot, to_png(plot_fit(model)))
    hints = _hints(args.data, recordings)
    written = list(filter(None, (args.out, args.plot)))
    FitConclusion(model, args.data, written=written, hints=hints).show(args.json)
    return OK


def _add(args: argparse.Namespace) -> int:
    """Widen a model file by recordings, write and describe it; return the exit code."""
    with swift_imports():
        from jaxbound.cli.widening_summary import WideningConclusion
        from jaxbound.files.whole import put
        from jaxbound.models.modelfile import changed_text
        from jaxbound.runs.outputs import refuse_targets
        from jaxbound.studies.identification.adding import MOST, widen

    for name in NEW:
        if getattr(args, name):
            raise Refused(f"--{name} is for a new model: with --add the model file says it")
    models = [path for path in args.data if path.suffix == ".toml"]
    days = [path for path in args.data if path.suffix != ".toml"]
    if len(models) != 1 or not days:
        raise Refused("--add needs one model file and recordings, like --add monday.csv plant.toml")
    (model,) = models
    out = args.out or model
    if args.out is not None:
        refuse_targets({"--out": out}, args.data, args.force)
    with door(), progress_bars(("widen",)) as step:
        some_device()
        most = MOST if args.most is None else args.most
        widened = widen(model, days, most, progress=lambda share: step("widen", share))
        written = []
        if args.out is not None or widened.changed:
            text = changed_text(model.read_text(encoding="utf-8-sig"), widened.model)
            put(out, text.encode())
            written = [out]
    hints = _hints(days, widened.days)
    WideningConclusion(widened, written=written, hints=hints).show(args.json)
    return OK


def _recipe(said: Mapping[str, Any]) -> tuple[Path | None, dict[str, Any]]:
    """Return (the model file whose recipe is asked for, if any, the fields that differ from it).

    Raises:
        ValueError: no model file, or faults that are none.
    """
    from jaxbound.cli.tradeoff_table import wanted_faults

    fields = dict(said)
    if "see" in fields:
        fields["see"] = wanted_faults(fields["see"])
    file = fields.pop("file", None)
    if file is None:
        return None, fields
    if not file.endswith(".toml"):
        raise ValueError(f"--recipe needs fields, like order=1,horizon=30, or a model file: not {file!r}")
    return Path(file), fields


def _signals(args: argparse.Namespace, file: Path | None) -> tuple["Signals", dict[str, str], str]:
    """Return (signals, units, name of the plant) of the command, or of the model file whose recipe it
    repeats.
    """
    from jaxbound.cli.fit_summary import named_units, signal_columns
    from jaxbound.models.modelfile import load_model
    from jaxbound.recordings.expressions import with_angles
    from jaxbound.recordings.recordingformat import with_format
    from jaxbound.recordings.signals import Signals

    recording, dt = sampling(args)
    own: dict[str, str] = {}
    if args.where:
        own["where"] = args.where
    if file is not None and not args.outputs:
        if args.inputs:
            raise ValueError(f"--inputs without --outputs: give both, or none for the signals of {file}")
        model = load_model(file)
        columns = with_format(dict(model.columns) | own, recording)
        signals = Signals(model.inputs, model.outputs, columns, dt or model.dt)
        return signals, dict(model.units), args.name or model.name
    if not args.outputs:
        raise ValueError("--outputs is needed: the columns that the model is to explain")
    inputs, outputs = signal_columns("--inputs", args.inputs), signal_columns("--outputs", args.outputs)
    inputs, outputs, units = named_units(inputs, outputs)
    columns = own | dict(signal for signal in (*inputs, *outputs) if not isinstance(signal, str))
    input_names, columns = with_angles(_names(inputs), with_format(columns, recording))
    output_names, columns = with_angles(_names(outputs), columns)
    signals = Signals(input_names, output_names, columns, dt)
    return signals, units, args.name or args.out.stem


def _names(signals: Sequence[str | tuple[str, str]]) -> tuple[str, ...]:
    """Return the names of signals, some with a column."""
    return tuple(signal if isinstance(signal, str) else signal[0] for signal in signals)


def _hints(data: Sequence[Path], recordings: Sequence["Recording"]) -> list[str]:
    """Return the hints of recordings, each once; of several recordings with the file that it is about."""
    hints = []
    for file, recording in zip(data, recordings, strict=True):
        for hint in recording.hints:
            hints.append(hint if len(recordings) == 1 else f"{file}: {hint}")
    return list(dict.fromkeys(hints))
