"""The demonstration: section 5 of Adrot, Maquin, Ragot 2000, from model and data to a report.

A second-order plant with two imperfect sensors and three faults: A, sensor 2 becomes less precise (16 %
instead of 10 %), B, extra noise of +- 0.35 on sensor 1, C, a bias of 0.2 on sensor 1.
"""

import shlex
import threading
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import cast

import jax
import numpy as np

from jaxbound.cli.evaluation import FILES_OF_A_WHOLE, evaluate
from jaxbound.cli.terminal import door, progress_bars, show, usable_device
from jaxbound.cli.window import DetectRun
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.result import Result
from jaxbound.models.faults import Fault
from jaxbound.models.modelfile import save_model
from jaxbound.models.simulate import Trajectory, simulate
from jaxbound.models.system import LinearSystem
from jaxbound.plots.canvas import to_png
from jaxbound.plots.figures import figure_1, figure_2
from jaxbound.relations.parity import parity_relations
from jaxbound.runs.outputs import output_folder
from jaxbound.sets.floats.status import Status

SAMPLES, HOLD = 201, 20
FAULTS = (
    Fault("y2", "tolerance", 0.16, 20, 60),
    Fault("y1", "noise", 0.35, 80, 120),
    Fault("y1", "bias", 0.2, 140, 180),
)
REFERENCE = {"A": (0.150, 0.063), "B": (0.230, 0.187), "C": (0.257, 0.238)}
"""Share of windows wholly inside each fault that are detected (joint test, box test): 5000 runs of an
independent NumPy program.
"""


def demo_model() -> LinearSystem:
    """Return the plant of section 5.

    Example:
        >>> print(parity_relations(demo_model()).text())
        r1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0
        r2: 4 y2[k-1] - 10 y1[k] + 5 y2[k] - 5 u1[k-1] = 0
    """
    return LinearSystem(
        [["0.8", "1"], ["0", "0.2"]],
        [[0], [1]],
        [[1, 0], [1, 1]],
        dt="0.01",
        tolerance=["0.02", "0.1"],
        noise=["0.1", "0.01"],
        columns={"time": "time"},
        name="Adrot 2000, section 5",
        provenance={
            "model": "paper",
            "tolerance": "paper",
            "noise": "paper",
            "resolution": "simulated data: none",
        },
    )


def demo_run(key: jax.Array, runs: int | None = None) -> Trajectory:
    """Simulate runs with the three faults: u piecewise constant in [-1, 1], 201 samples, unknowns uniform in
    their bounds.

    Args:
        key: a jax.random key. runs: None for one recording, else a batch of so many.

    Returns:
        A Trajectory.
    """
    k_input, k_run = jax.random.split(key)
    shape = () if runs is None else (runs,)
    levels = np.asarray(jax.random.uniform(k_input, (*shape, -(-SAMPLES // HOLD), 1), minval=-1, maxval=1))
    return simulate(demo_model(), np.repeat(levels, HOLD, -2)[..., :SAMPLES, :], k_run, faults=FAULTS)


def detection_rates(
    runs: int, key: jax.Array, progress: Callable[[float], object] | None = None
) -> tuple[dict[str, tuple[float, ...]], tuple[int, int]]:
    """Count how often each fault is detected, by all residuals together and by each of them alone.

    Args:
        runs: how many simulated runs. key: a jax.random key. progress: called with the share of the work
            done.

    Returns:
        ({"A": (joint, box), "B": .., "C": ..}, (false alarms, windows without a fault)); a rate is the share
        of the windows whose samples all have the fault.
    """
    report = progress or (lambda share: None)
    relations, run = parity_relations(demo_model()), demo_run(key, runs)
    report(0.6)
    faults = {}
    for method in ("joint", "box"):
        faults[method] = detect(relations, run.u, run.y, method=method).status == Status.FAULT
        report(0.8 if method == "joint" else 1.0)
    s = relations.horizon
    rates = {}
    for name, f in zip("ABC", FAULTS, strict=True):
        inside = slice(f.start + s, f.stop)
        shares = [float(status[:, inside].mean()) for status in faults.values()]
        rates[name] = tuple(shares)
    clean = np.ones(SAMPLES, bool)
    clean[:s] = False
    for f in FAULTS:
        clean[f.start : cast(int, f.stop) + s] = False  # each of them ends
    return rates, (int(faults["joint"][:, clean].sum()), runs * int(clean.sum()))


def rate_table(rates: dict[str, tuple[float, ...]]) -> Iterator[tuple[str, ...]]:
    """Yield the rates beside the reference as rows of text, the header first."""
    about = {"A": "A: tolerance of y2 16 %", "B": "B: noise of y1 0.35", "C": "C: bias of y1 0.2"}
    yield "fault", "all residuals together", "reference", "each residual alone", "reference"
    for name, found in rates.items():
        pairs = zip(found, REFERENCE[name], strict=True)
        yield about[name], *(f"{x:.3f}" for x in chain.from_iterable(pairs))


def write_run(path: Path, run: Trajectory) -> None:
    """Write a simulated recording as CSV with the columns time, u1, y1, y2: every float in full."""
    u, y = np.asarray(run.u), np.asarray(run.y)
    lines = [f"{k / 100:g},{','.join(map(repr, [*u[k].tolist(), *y[k].tolist()]))}" for k in range(len(u))]
    path.write_text("\n".join(["time,u1,y1,y2", *lines]) + "\n", encoding="utf-8")


def sections(
    directory: Path,
    run: Trajectory,
    res: Result,
    rates: dict[str, tuple[float, ...]],
    false_alarms: int,
    clean: int,
    runs: int,
) -> list[tuple[object, ...]]:
    """Write the two figures of the paper into a folder; return them and the detection rates as sections of
    the report.

    Args:
        directory: where figure_1.png and figure_2.png go. run: from `demo_run`, res: its Result.
        rates, false_alarms, clean: from `detection_rates` with so many runs.
    """
    pictures = {"figure_1.png": to_png(figure_1()), "figure_2.png": to_png(figure_2(run, res, FAULTS))}
    for name, data in pictures.items():
        (directory / name).write_bytes(data)
    return [
        (
            "The run",
            pictures["figure_2.png"],
            "Fig. 2 of the paper, redrawn: measurements and the true combinations of states behind them; "
            "grey where a fault is present; below, what is proved. The paper does not print its data, so "
            "the run is a new one.",
            None,
        ),
        (
            "How often are these faults seen?",
            None,
            f"Share of windows wholly inside each fault that are proved faulty, over {runs} simulated runs, "
            f"beside the rates of an independent program over 5000 runs. False alarms of all together: "
            f"{false_alarms} in {clean} windows without a fault.",
            list(rate_table(rates)),
        ),
        (
            "Why all residuals together",
            pictures["figure_1.png"],
            "Fig. 1 of the paper, redrawn from computation: residuals that share unknowns cannot take "
            "every combination of values in their box. Left: the set they can take, its box and two "
            "pavings. Right: the boxes that the adaptive test visits to judge one point.",
            None,
        ),
    ]


def demonstrate(out: Path, runs: int) -> int:
    """Run the demonstration into a folder, with rates of so many runs, and print its conclusion."""
    threading.Thread(target=_load_plotting, daemon=True).start()
    names = ("model.toml", "run.csv", *FILES_OF_A_WHOLE, "figure_1.png", "figure_2.png")
    stages = ("simulate", "read", "relations", "test", "report")
    with (
        door(OSError),
        output_folder(out, names) as folder,
        folder.work() as work,
        progress_bars(stages) as step,
    ):
        with door():
            usable_device()
        run = demo_run(jax.random.key(2000))
        rates, (false_alarms, clean) = detection_rates(
            runs, jax.random.key(5), lambda share: step("simulate", share)
        )
        save_model(demo_model(), work / "model.toml")
        write_run(work / "run.csv", run)

        evaluation = evaluate(
            work,
            step,
            DetectRun(work / "model.toml", work / "run.csv", out),
            sections=lambda res: sections(work, run, res, rates, false_alarms, clean, runs),
        )
    files = str(out / "model.toml"), str(out / "run.csv")
    again = ["jaxbound", "detect", *files, "--out", str(out)]
    rows = [
        ("false alarms", f"{false_alarms} in {clean} windows without a fault ({runs} runs)"),
        ("report", str(out / "report.html")),
        ("try it", shlex.join(again)),
    ]
    show(
        f"Section 5 of Adrot, Maquin, Ragot 2000. {evaluation.summary.sentence}",
        "bold",
        rows,
        rate_table(rates),
    )
    return 0


def _load_plotting() -> None:
    """Import matplotlib while the data are read: it takes as long as testing a million windows."""
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401
