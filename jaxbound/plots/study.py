"""The charts of a Monte-Carlo study: how many scenarios are detected against the size of the fault, and how
soon; and their picture.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxbound.plots.canvas import COLOURS, FAULTY, GRID, INK, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status
from jaxbound.studies.montecarlo.scenarios import SIZELESS, Trial
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.montecarlo.tally import TrialTally
from jaxbound.text.quantities import finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FAULTS, CURVES = 8, 4
"""Faults whose charts are drawn, and sizes whose delays are."""
DELAYS = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 100000)
TONES = {"FAULT": FAULTY, "curve": INK}


@dataclass(frozen=True)
class StudyCurve:
    """A curve of shares.

    Fields: name. colour: "FAULT" or "curve". faint: how strongly it is drawn, 1 fully. x, share, and the ends
    of its intervals low and high, None: it has none.
    """

    name: str
    colour: str
    faint: float
    x: np.ndarray
    share: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None


@dataclass(frozen=True)
class StudyChart:
    """A chart of one fault.

    Fields: title. label: of the axis, "": a fault without a size. delays: whether it is one of delays, else
    of sizes. ends: of the axis. guaranteed: the size from which on no such fault stays hidden, or None.
    curves. ticks: of delays; None: those of matplotlib.
    """

    title: str
    label: str
    delays: bool
    ends: tuple[float, float]
    guaranteed: float | None
    curves: Sequence[StudyCurve]
    ticks: Sequence[int] | None = None


def study_charts(res: StudyResult) -> Iterator[StudyChart]:
    """Yield two charts of each fault, of at most 8: the shares against its size, and the shares detected so
    soon.
    """
    for trial, tally in zip(res.trials[:FAULTS], res.tallies, strict=False):
        yield _sizes(res, trial, tally)
        yield _delays(trial, tally)


def _sizes(res: StudyResult, trial: Trial, tally: TrialTally) -> StudyChart:
    """Return the chart of the shares against the size."""
    order = np.argsort(trial.sizes)
    x = np.asarray(trial.sizes, float)[order]
    least, most = float(x[0]), float(x[-1])
    guaranteed = finite(trial.guaranteed)
    if guaranteed is not None:
        least, most = min(least, guaranteed), max(most, guaranteed)
    # one size alone, or size 0, still needs an axis of some width
    room = 0.03 * (most - least) or abs(most) or 1.0
    curves = []
    for name, colour, ends in (
        ("scenarios detected", "FAULT", tally.share(res.confidence)),
        ("FAULT windows", "curve", tally.rate(res.confidence)),
    ):
        share, low, high = (np.asarray(end)[order] for end in ends)
        curves.append(StudyCurve(name, colour, 1, x, share, low, high))
    label = _size_label(res, trial)
    return StudyChart(trial.label, label, False, (least - room, most + room), guaranteed, curves)


def _size_label(res: StudyResult, trial: Trial) -> str:
    """Return the name of the axis of sizes: of a fault that has none, nothing."""
    if trial.fault is None or trial.fault.kind in SIZELESS:
        return ""
    unit = res.model.unit(trial.fault.signal)
    if not unit or trial.fault.kind in ("gain", "tolerance"):
        return "size"
    return f"size [{unit}]"


def _delays(trial: Trial, tally: TrialTally) -> StudyChart:
    """Return the chart of the shares detected within so many samples, for a few of the sizes."""
    sizes = len(trial.sizes)
    # nothing is detected later: the axis ends there
    last = int(np.max(np.flatnonzero(tally.delays.any(0)), initial=1))
    # the smallest and the largest size are among the few
    picked = np.unique(np.linspace(0, sizes - 1, min(CURVES, sizes)).round().astype(int))
    curves = []
    for rank, i in enumerate(picked):
        shares = np.cumsum(tally.delays[i, : last + 2]) / max(tally.scenarios[i], 1)
        faint = 1 - 0.2 * (len(picked) - 1 - rank)
        x = np.arange(len(shares))
        curves.append(StudyCurve(f"size {trial.sizes[i]:.4g}", "FAULT", faint, x, shares))
    ticks = [t for t in DELAYS if t <= last + 1]
    return StudyChart("detected by then", "samples from the onset", True, (0, last + 1), None, curves, ticks)


@plot.register(StudyResult)
def plot_study(res: StudyResult) -> "Figure":
    """Draw a StudyResult: a row for each fault.

    Left: the share of scenarios detected and of FAULT windows against the size, with their intervals, and the
    size from which on no such fault stays hidden. Right: the share detected within so many samples of the
    onset, for a few of the sizes.

    Returns:
        A matplotlib Figure, of at most 8 faults.
    """
    charts = list(study_charts(res))
    rows = len(charts) // 2
    false, clean = res.false_alarms
    title = (
        f"{res.scenarios} scenarios of {res.model.name}, unknowns {res.at}: {false} false alarms "
        f"in {clean} windows"
    )
    if len(res.trials) > FAULTS:
        title += f"; {len(res.trials) - FAULTS} more faults"
    with style():
        fig = canvas((11, 0.9 + 2.9 * rows), "constrained")
        for ax, chart in zip(fig.subplots(rows, 2, squeeze=False).ravel(), charts, strict=True):
            _draw(ax, chart)
        fig.suptitle(title, x=0.02, ha="left", fontsize=10.5, color=INK)
    return fig


def _draw(ax: "Axes", chart: StudyChart) -> None:
    """Draw a chart."""
    for curve in chart.curves:
        look: dict[str, Any] = {"color": TONES[curve.colour], "alpha": curve.faint, "label": curve.name}
        if curve.low is None or curve.high is None:
            ax.step(curve.x, curve.share, where="post", lw=1.4, **look)
            continue
        # rounding may put an end of the interval on the wrong side of the share
        bar = np.abs(np.nan_to_num([curve.share - curve.low, curve.high - curve.share]))
        ax.errorbar(curve.x, curve.share, bar, marker="o", ms=3.5, capsize=2, lw=1.4, **look)
    if chart.guaranteed is not None:
        name = f"guaranteed from {chart.guaranteed:.4g} on"
        ax.axvline(chart.guaranteed, color=COLOURS[Status.CONSISTENT], lw=1.4, ls="--", label=name)
    if chart.ticks is not None:
        ax.set_xscale("symlog", linthresh=10)
        ax.set_xticks(chart.ticks, map(str, chart.ticks))
        ax.set_xticks([], minor=True)
    elif not chart.label:
        ax.set_xticks([])
    ax.set(xlim=chart.ends, ylim=(-0.03, 1.05), xlabel=chart.label, ylabel="share")
    ax.set_title(chart.title)
    ax.grid(color=GRID, lw=0.6)
    ax.legend(fontsize=8, loc="lower right", frameon=True, edgecolor="none")
