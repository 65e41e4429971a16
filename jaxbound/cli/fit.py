"""The command `jaxbound fit`: from recordings to a model file, and the picture of a fit."""

import argparse
import json
import re

import numpy as np

from jaxbound.cli.terminal import door, progress_bars, show, write
from jaxbound.diagnosis.memory import slowest, suggest_lags
from jaxbound.files.whole import whole
from jaxbound.models.modelfile import model_text
from jaxbound.plots.canvas import to_png
from jaxbound.plots.fit import plot_fit
from jaxbound.recordings.expressions import expression
from jaxbound.recordings.read import read_signals
from jaxbound.runs.outputs import refuse_targets
from jaxbound.studies.identification.fitting import fit

__all__ = ["plot_fit", "run", "signals"]

MEMORY = 1.5  # times the window that a plant must remember before longer windows are spoken of
NAMED = re.compile(r"\s*([^=<>!`'\"]+?)\s*=(?!=)\s*(.+?)\s*")


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound fit`; return the exit code."""
    refuse_targets({"--out": args.out, "--plot": args.plot}, args.data, args.force)
    with door(), progress_bars(("read", "fit")) as step:
        inputs, outputs = signals("--inputs", args.inputs), signals("--outputs", args.outputs)
        about = {key: value for key, value in (("time", args.time), ("where", args.where)) if value}
        found = read_signals(args.data, inputs, outputs, about, args.dt, lambda share: step("read", share))
        names = [[name if isinstance(name, str) else name[0] for name in side] for side in (inputs, outputs)]
        model = fit(
            found,
            args.order,
            args.horizon,
            lags=args.lags,
            inputs=names[0],
            outputs=names[1],
            direct=args.direct,
            safety=args.safety,
            held_out=args.held_out,
            method=args.method,
            average=args.average,
            name=args.name or args.out.stem,
            progress=lambda share: step("fit", share),
            columns=about | dict(s for s in inputs + outputs if not isinstance(s, str)),
        )
        with whole(args.out) as f:
            f.write(model_text(model).encode())
        if args.plot:
            with whole(args.plot) as f:
                f.write(to_png(plot_fit(model)))
    hints = list(
        dict.fromkeys(
            h if len(found) == 1 else f"{path}: {h}"
            for path, r in zip(args.data, found, strict=True)
            for h in r.hints
        )
    )
    if args.json:
        write(json.dumps(_summary(model, args, hints), indent=1, allow_nan=False) + "\n")
    else:
        _tell(model, args, hints)
    return 0


def signals(option: str, text: str) -> list[str | tuple[str, str]]:
    """Return the signals of an option: names, or (name, column) where it says name=column or name=expression.

    Raises:
        ValueError: an empty entry.

    Example:
        >>> signals("--inputs", "fan, lift=Tsup - `T mixed`, T1=Temperature 1")
        ['fan', ('lift', '= Tsup - `T mixed`'), ('T1', 'Temperature 1')]
    """
    if not text.strip():
        return []
    entries = [e.strip() for e in re.split(r",(?=(?:[^`]*`[^`]*`)*[^`]*$)(?![^()]*\))", text)]
    if not all(entries):
        raise ValueError(
            f"{option} needs names, or name=column or name=expression, with commas between them: {text!r} "
            f"has an empty entry"
        )
    return [
        (match[1], _column(match[2])) if (match := NAMED.fullmatch(e)) else re.sub(r"^`([^`]+)`$", r"\1", e)
        for e in entries
    ]


def _column(text):
    """Return what a model file says of a signal: "= expression", or the name of a column, which may have
    blanks in it.
    """
    if re.fullmatch(r"`[^`]+`", text):
        return text[1:-1]
    try:
        expression(text)
    except ValueError:
        return text
    return text if text.isidentifier() else f"= {text}"


def _finite(x):
    return x if np.isfinite(x) else None


def _summary(model, args, hints):
    """Return what --json prints."""
    check, bounds, rounds = (
        model.check,
        *(dict(zip(model.outputs, map(float, x), strict=True)) for x in (model.noise, model.resolution)),
    )
    held_out = check.held_out and {k: _finite(v) for k, v in check.held_out.items()}
    return {
        "out": str(args.out),
        "order": args.order,
        "horizon": model.horizon,
        "states": model.n,
        "dt": model.dt,
        "method": check.method,
        "noise": bounds,
        "resolution": rounds,
        "smallest": check.smallest,
        "safety": check.safety,
        "held_out": held_out,
        "average": args.average,
        "means": {a.signal: float(a.bound) for a in model.averages},
        "smallest_mean": check.smallest_mean,
        "recordings": [
            {"data": str(path)} | {k: _finite(v) for k, v in r.items()}
            for path, r in zip(args.data, check.recordings, strict=True)
        ],
        "jump": {k: _finite(v) for k, v in check.jump.items()},
        "steady": {k: _finite(v) for k, v in check.steady.items()},
        "warnings": list(check.sentences),
        "hints": hints,
    }


def _memory(model):
    """Return a line on lags where the plant remembers longer than its windows: they may see smaller lasting
    errors.
    """
    if model.lags is not None or slowest(model) < MEMORY * (model.horizon + 1):
        return []
    try:
        found = suggest_lags(model)
    except ValueError:  # none of them would help
        return []
    sizes = ", ".join(
        f"{name} {found.sizes[found][name]:.3g} {model.unit(name)}".rstrip() for name in model.outputs
    )
    again = (
        f"fitted again with --lags {','.join(map(str, found))} it would see lasting errors from about "
        f"{sizes} on"
    )
    return [("memory", f"the plant remembers longer than a window: {again}, if its bounds hardly grew")]


def _tell(model, args, hints):
    """Print what was found."""
    check = model.check
    size = lambda x, name: "never" if not np.isfinite(x) else f"{x:.3g} {model.unit(name)}".rstrip()
    table = [("output", "smallest bound", "written", "jump always seen", "steady error always seen")]
    for name, *bounds in zip(model.outputs, model.noise, model.resolution, strict=True):
        sizes = (size(x[name], name) for x in (check.jump, check.steady))
        table.append((name, f"{check.smallest[name]:.4g}", f"{float(sum(bounds)):.4g}", *sizes))
    means = ", ".join(
        f"{a.text} within {float(a.bound):.4g} {model.unit(a.signal)}".rstrip() for a in model.averages
    )
    rounded = ", ".join(
        f"{float(r):.6g} of {name}" for name, r in zip(model.outputs, model.resolution, strict=True) if r
    )
    unseen = check.held_out
    looks = f"{model.horizon + 1}" if model.lags is None else f"{len(model.lags)} of {model.horizon + 1}"
    rows = [
        ("model", f"{model.n} states, order {args.order}, coefficients by {check.method}"),
        ("windows", f"{looks} samples, {model.dt:g} s apart: all of them CONSISTENT, by the proved test"),
        *[
            (
                f"{path}",
                f"{r['windows']} windows, {100 * r['used']:.3g} % of the bounds used"
                if r["windows"]
                else "no window",
            )
            for path, r in zip(args.data, check.recordings, strict=True)
        ],
        (
            "held out",
            "nothing"
            if unseen is None
            else f"a first fit, to the first {100 * (1 - args.held_out):.3g} % of each, found "
            f"{100 * unseen['fault']:.3g} % FAULT in "
            f"{unseen['windows']} windows of the rest, which used {100 * unseen['growth']:.3g} % of its "
            f"bounds; the model is fitted to all",
        ),
        *_memory(model),
        ("safety", f"{check.safety:g} times the smallest bounds"),
        *([("averages", means)] if means else []),
        *(
            [("resolution", f"{rounded}: that much of the bound is what the recorder rounds away")]
            if rounded
            else []
        ),
        ("written", str(args.out) + (f" and {args.plot}" if args.plot else "")),
        *[("caution", s) for s in check.sentences],
        *[("hint", h) for h in hints],
    ]
    show(
        f"{model.name}: fitted to {len(check.recordings)} recording{'s' * (len(check.recordings) > 1)}",
        "bold",
        rows,
        table=table,
    )
