"""The picture of a Monte-Carlo study: how many scenarios are detected against the size of the fault, and how
soon.
"""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import COLOURS, FAULTY, GRID, INK, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status
from jaxbound.studies.montecarlo.scenarios import Trial
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.montecarlo.tally import TrialTally

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_study"]

FAULTS, CURVES = 8, 4
SEEN = COLOURS[Status.CONSISTENT]


@plot.register(StudyResult)
def plot_study(res: StudyResult) -> "Figure":
    """Draw a StudyResult: a row for each fault.

    Left: the share of scenarios detected and of FAULT windows against the size, with their intervals, and the
    size from which on no such fault stays hidden. Right: the share detected within so many samples of the
    onset, for a few of the sizes.

    Returns:
        A matplotlib Figure, of at most 8 faults.
    """
    shown = list(zip(res.trials, res.tallies, strict=True))[:FAULTS]
    with style():
        fig = canvas((11, 0.9 + 2.9 * len(shown)))
        axes = fig.subplots(len(shown), 2, squeeze=False)
        for (trial, tally), (left, right) in zip(shown, axes, strict=True):
            _draw_sizes(left, res, trial, tally)
            _draw_delays(right, trial, tally)
        false, clean = res.false_alarms
        title = (
            f"{res.scenarios} scenarios of {res.model.name}, unknowns {res.at}: {false} false alarms "
            f"in {clean} windows"
        )
        if len(res.trials) > FAULTS:
            title += f"; {len(res.trials) - FAULTS} more faults"
        height = fig.get_figheight()
        fig.suptitle(
            title,
            x=0.02,
            y=1 - 0.12 / height,
            va="top",
            ha="left",
            fontsize=10.5,
            color=INK,
            parse_math=False,
        )
        fig.subplots_adjust(
            left=0.07, right=0.98, top=1 - 0.75 / height, bottom=0.55 / height, hspace=0.5, wspace=0.16
        )
    return fig


def _draw_sizes(ax: "Axes", res: StudyResult, trial: Trial, tally: TrialTally) -> None:
    """Draw the share of scenarios detected, and of FAULT windows, against the size of the fault."""
    order = np.argsort(trial.sizes)
    share, rate = map(np.nan_to_num, tally.share(res.confidence)), tally.rate(res.confidence)
    for (value, low, high), colour, name in (
        (share, FAULTY, "scenarios detected"),
        (rate, INK, "windows in the fault that are FAULT"),
    ):
        x = trial.sizes[order]
        bar = np.abs(np.stack([value - low, high - value]))[:, order]
        ax.errorbar(x, value[order], bar, color=colour, marker="o", ms=3.5, lw=1.4, capsize=2, label=name)
    if np.isfinite(trial.guaranteed):
        ax.axvline(
            trial.guaranteed, color=SEEN, lw=1.4, ls="--", label=f"guaranteed from {trial.guaranteed:.4g} on"
        )
    ax.set_ylim(-0.03, 1.05)
    ax.grid(color=GRID, lw=0.6)
    ax.set_title(trial.label, parse_math=False)
    label = "size of the fault"
    if trial.fault is not None and trial.fault.kind not in ("gain", "tolerance"):
        unit = res.model.unit(trial.fault.signal)
        if unit:
            label += f" [{unit}]"
    ax.set_xlabel(label, parse_math=False)
    ax.set_ylabel("share")
    if trial.fault is None or trial.fault.kind in ("stuck", "dropout"):
        ax.set_xticks([])
        ax.set_xlabel("")
    ax.legend(fontsize=8, loc="lower right", frameon=True, edgecolor="none")


def _draw_delays(ax: "Axes", trial: Trial, tally: TrialTally) -> None:
    """Draw the share of scenarios detected within so many samples, for a few sizes."""
    sizes = len(trial.sizes)
    picked = np.unique(np.linspace(0, sizes - 1, min(CURVES, sizes)).round().astype(int))
    last = int(np.max(np.flatnonzero(tally.delays.any(0)), initial=1))
    for rank, i in enumerate(picked):
        curve = np.cumsum(tally.delays[i, : last + 2]) / max(tally.scenarios[i], 1)
        tone = 0.25 + 0.75 * (rank + 1) / len(picked)
        ax.step(
            np.arange(len(curve)),
            curve,
            where="post",
            color=FAULTY,
            alpha=tone,
            lw=1.4,
            label=f"size {trial.sizes[i]:.4g}",
        )
    ax.set_ylim(-0.03, 1.05)
    ax.set_xscale("symlog", linthresh=10)
    ticks = [t for t in (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000) if t <= last + 1]
    ax.set_xticks(ticks, [str(t) for t in ticks])
    ax.set_xticks([], minor=True)
    ax.set_xlim(0, last + 1)
    ax.grid(color=GRID, lw=0.6)
    ax.set_xlabel("samples from the onset")
    ax.set_title("detected by then")
    ax.legend(fontsize=8, loc="lower right", frameon=True, edgecolor="none")
