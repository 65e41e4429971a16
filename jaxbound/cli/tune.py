"""The command `jaxbound tune`, and the picture of a TuneResult."""

import argparse
import hashlib
import json
from fractions import Fraction

import numpy as np

from jaxbound.cli.terminal import INTERRUPTED, door, progress_bars, say, show, write
from jaxbound.cli.window import window_relations
from jaxbound.files.whole import whole
from jaxbound.models.modelfile import load_model, model_text, number_text
from jaxbound.plots.canvas import to_png
from jaxbound.plots.tune import plot_tuning
from jaxbound.recordings.read import read
from jaxbound.runs.outputs import refuse_targets
from jaxbound.studies.tuning.tuning import tune

__all__ = ["OPTIMIZERS", "plot_tuning", "run"]

OPTIMIZERS = ("adam", "adabelief", "adagrad", "lion", "nadam", "rmsprop", "sgd", "yogi")
MARK = b"# The search was interrupted: the same command goes on and replaces this file. %s\n"
RATE = 0.1  # of the first step, on the logarithms of the bounds


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound tune`; return the exit code."""
    state = args.out.with_name(args.out.name + ".state.npz")
    inputs = [args.model, *args.healthy, *args.faulty]
    refuse_targets(
        {"--out": args.out, "--plot": args.plot},
        inputs,
        args.force or (state.exists() and _unfinished(args.out)),
    )
    refuse_targets({"the state of --out,": state}, inputs, force=True)
    chosen = None if args.bounds is None else [name.strip() for name in args.bounds.split(",")]
    with door(), progress_bars(("read", "relations", "tune")) as step:
        model, files = load_model(args.model), [*args.healthy, *args.faulty]
        report = lambda i: lambda share: step("read", (i + share) / len(files))
        recordings = [read(file, model, report(i)) for i, file in enumerate(files)]
        longest = int(np.argmax([r.samples for r in recordings]))
        model, relations = window_relations(model, args, files[longest], recordings[longest].samples, step)
        healthy, faulty = recordings[: len(args.healthy)], recordings[len(args.healthy) :] or None
        res = tune(
            relations,
            healthy,
            faulty,
            _optimizer(args.optimizer, args.steps),
            args.steps,
            bounds=chosen,
            safety=args.safety,
            calibrate=args.calibrate,
            progress=lambda share: step("tune", share),
            state=state,
        )
        with whole(args.out) as f:
            f.write(_text_of(res))
        if args.plot:
            with whole(args.plot) as f:
                f.write(to_png(plot_tuning(res)))
    hints = [f"{path}: {hint}" for path, x in zip(files, recordings, strict=True) for hint in x.hints]
    if args.json:
        write(json.dumps(_summary(res, args, hints), indent=1) + "\n")
    else:
        _tell(res, args, hints)
    if res.stopped:
        say(
            f"stopped after {res.steps} of {args.steps} steps: {args.out} has the best bounds until then; "
            f"the same command goes on"
        )
        return INTERRUPTED
    state.unlink(missing_ok=True)
    return 0


def _text_of(res):
    """Return the model file: that of an interrupted search begins with a line by which the next call knows
    that nobody has changed it.
    """
    text = model_text(res.model).encode()
    return MARK % hashlib.sha256(text).hexdigest().encode() + text if res.stopped else text


def _unfinished(path):
    """Return whether a file is as an interrupted search has left it."""
    text = path.read_bytes().split(b"\n", 1)[-1] if path.is_file() else b""
    return path.is_file() and path.read_bytes() == MARK % hashlib.sha256(text).hexdigest().encode() + text


def _optimizer(name, steps):
    """Return an optax optimiser by name, with a step that falls to nothing; None for the default one."""
    if name not in OPTIMIZERS:
        raise ValueError(f"--optimizer must be one of {', '.join(OPTIMIZERS)}, not {name!r}")
    if name == "adam" or not steps:
        return None
    import optax

    return getattr(optax, name)(optax.cosine_decay_schedule(RATE, steps))


def _entries(res):
    """Yield (name, start, smallest, written), texts: of every bound that moved."""
    model, relations = res.model, res.relations
    signals = {
        "tolerance": model.outputs,
        "noise": model.outputs,
        "disturbance": tuple(f"w{j + 1}" for j in range(model.g)),
    }
    written = {"tolerance": model.tolerance, "noise": model.noise, "disturbance": model.disturbance}
    for kind, now in relations.bounds.items():
        names = signals.get(kind, tuple(u.name for u in model.uncertainties))
        for i, signal in enumerate(names):
            if not any(name.endswith(f"{kind} of {signal}") for name in res.names):
                continue
            exact = written[kind][i] if kind in written else Fraction(repr(float(now[i])))
            yield (
                f"{kind} of {signal}",
                *(_text(x[kind][i]) for x in (res.start, res.smallest)),
                _exact(exact),
            )


def _text(x):
    return " to ".join(f"{v:.6g}" for v in np.ravel(x))


def _exact(x):
    return number_text(x) if isinstance(x, Fraction) else " to ".join(map(number_text, x))


def _summary(res, args, hints):
    """Return what --json prints."""
    plain = lambda bounds: {kind: np.asarray(x).tolist() for kind, x in bounds.items()}
    risk = res.risk
    return {
        "out": str(args.out),
        "horizon": res.relations.horizon,
        "scale": res.scale,
        "safety": res.safety,
        "bounds": plain(res.bounds),
        "smallest": plain(res.smallest),
        "start": plain(res.start),
        "steps": res.steps,
        "stopped": res.stopped,
        "healthy": res.counts,
        "faulty": res.faulty_counts,
        "caught": res.caught,
        "least_margin": float(np.nanmin(res.margin)),
        "risk": {
            "blocks": risk.blocks,
            "windows_in_a_block": risk.length,
            "average": risk.average,
            "rate": risk.rate,
            "confidence": risk.confidence,
            "guide_only": risk.guide,
            "text": risk.text,
        },
        "notes": list(res.notes),
        "hints": hints,
    }


def _tell(res, args, hints):
    """Print what was found."""
    counted = lambda counts: ", ".join(f"{n} {name}" for name, n in counts.items() if n)
    rows = [
        (
            "scale",
            f"{res.scale:.9g} times the starting bounds: no smaller ones in this direction explain the "
            f"healthy data",
        ),
        ("safety", f"{res.safety:g}, on top of the smallest bounds" + ("" if res.safety > 1 else " (none)")),
        (
            "healthy",
            f"{counted(res.counts)} windows of {res.relations.horizon + 1} samples, by the proved test",
        ),
        *(
            [("faulty", f"{counted(res.faulty_counts)}: {res.caught:.1%} proved faulty")]
            if res.faulty_counts
            else []
        ),
        ("steps", str(res.steps)),
        ("written", str(args.out) + (f" and {args.plot}" if args.plot else "")),
        ("elsewhere", res.statement),
        *[("note", note) for note in res.notes],
        *[("hint", hint) for hint in hints],
    ]
    table = [("bound", "start", "smallest", "written"), *_entries(res)]
    show(f"{res.model.name}: bounds tuned", "bold", rows, table=table)
