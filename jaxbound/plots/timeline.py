"""The picture of a recording of any length: its margin over time, a ribbon of verdicts, and where its alarms
are.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.diagnosis.observed import shown_name
from jaxbound.plots.canvas import (
    CALM,
    COLOURS,
    ENVELOPE,
    FAULTY,
    GRID,
    INK,
    SAMPLES,
    bins,
    finish,
    inside,
    label_time,
    note,
    shade,
    stacked,
    style,
    thinning,
    time_axis,
)
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FACTORS = (0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 5)
STEEP = -4
"""Margin below which the axis is logarithmic."""


class Timeline:
    """The extremes of a recording of any length, given piece by piece: what a picture of it can show.

    Fields: samples; bins: where each bin starts, one sample each up to 5000; x: its time; status: the worst
    of each bin; low, high: the extremes of its margin, NaN where there is none; marked: whether the deepest
    window of an alarm lies in it.
    """

    def __init__(self, samples: int) -> None:
        """Begin a recording of so many samples."""
        self.samples, self.bins = samples, bins(samples)
        self.x: np.ndarray | None = None
        self.status = np.zeros(len(self.bins), np.int8)
        self.low, self.high = np.full((2, len(self.bins)), np.nan)
        self.marked = np.zeros(len(self.bins), bool)

    def add(self, start: int, x: np.ndarray, status: np.ndarray, margin: np.ndarray) -> None:
        """Take the samples from number `start` on: their time (seconds or datetime64), status and margin."""
        begun, stop, edges = inside(self.bins, start, len(x))
        first = begun + (self.bins[begun] < start)  # the first may have begun in an earlier piece
        put = slice(begun, stop)
        margin = np.where(np.isneginf(margin), -1e15, margin)
        if self.x is None:
            self.x = np.empty(len(self.bins), x.dtype)
        # the time of a bin is that of its first sample, which an earlier piece may have had
        self.x[first:stop] = x[self.bins[first:stop] - start]
        self.status[put] = np.maximum(self.status[put], np.maximum.reduceat(status, edges))
        # a bin that two pieces share keeps the extremes of both; NaN stands for no margin
        self.low[put] = np.fmin(self.low[put], np.fmin.reduceat(margin, edges))
        self.high[put] = np.fmax(self.high[put], np.fmax.reduceat(margin, edges))

    def mark(self, samples: Sequence[int] | np.ndarray) -> None:
        """Mark the bins in which these samples lie."""
        self.marked[np.searchsorted(self.bins, np.asarray(samples, np.int64), "right") - 1] = True


def plot_timeline(
    line: Timeline,
    name: str,
    alarms: int,
    ax: "Axes | None" = None,
    bounded: bool = False,
    observes: bool = False,
) -> "Figure | Axes":
    """Draw a complete Timeline of a model of that name, `alarms` is how many there are;
    into `ax` the margin alone; `bounded`: margins of CONSISTENT windows are bounds, which the title says;
    `observes`: UNDECIDED is what healthy samples are.
    """
    if bounded:
        name = f"{name}, above 0 a lower bound"
    assert line.x is not None, "a Timeline is drawn when all its samples were added"
    at, label, dates = time_axis(line.x)
    if ax is not None:
        _chart(ax, line, at, name, alarms)
        label_time(ax, at, label, dates)
        return ax
    with style():
        fig, (margin, ribbon) = stacked(2, (11, 4.3), [12, 1])
        _chart(margin, line, at, name, alarms)
        _ribbon(ribbon, at, line.status, observes)
        finish(fig, [margin, ribbon], at, label, dates)
    return fig


def _chart(ax: "Axes", line: Timeline, at: np.ndarray, name: str, alarms: int) -> None:
    """Draw the margin and the alarms."""
    shade(ax, at, line.status == Status.FAULT)
    if np.isnan(line.low).all():
        words = "no margin is measured"
        if (line.status == Status.MISSING).all():
            words = "no window has usable data"
        note(ax, words)
        ax.set_yticks([])
    else:
        _margin(ax, at, line.low, line.high, line.samples > SAMPLES)
    if alarms:
        _mark_alarms(ax, at[line.marked], alarms)
    title = f"Margin of {name}" + thinning(line.samples, len(at), "extremes")
    ax.set_title(title, pad=16, parse_math=False)


def _margin(ax: "Axes", x: np.ndarray, low: np.ndarray, high: np.ndarray, thinned: bool) -> None:
    """Draw the margin, and on the right the factor on the bounds that it stands for: 1 - margin."""
    if thinned:
        ax.fill_between(x, low, high, color=ENVELOPE, alpha=0.5, lw=0)
    ax.plot(x, low, color=INK, lw=0.9)
    with np.errstate(invalid="ignore"):
        # marked by dots: the line of a single sample would be too thin to see
        out = low < 0
    ax.plot(x[out], low[out], ls="", marker="o", ms=2.6, color=FAULTY, zorder=3)
    ax.axhline(0, color="#30363d", lw=1.1, zorder=2)
    right = ax.twinx()
    lowest = float(np.nanmin(low))
    if lowest < STEEP:
        _steep_scale(ax, right, lowest)
    else:
        _even_scale(ax, right, lowest)
    for side, text in ((ax, "margin   (< 0: outside the bounds)"), (right, "bounds needed to explain it")):
        side.minorticks_off()
        side.set_ylabel(text)
    ax.grid(color=GRID, lw=0.7, axis="y")


def _steep_scale(ax: "Axes", right: "Axes", lowest: float) -> None:
    """Scale margins far below 0 by their logarithm, with a tick at some powers of ten."""
    # even to -1, where bounds twice as wide would do, by powers of ten below
    size = float(np.log10(-lowest))
    for side in (ax, right):
        side.set_yscale("symlog", linthresh=1, linscale=max(0.6, 0.35 * size))
        side.set_ylim(lowest * 1.6, 1.25)
    margins = [(1.0, "1"), (0.5, "0.5"), (0.0, "0"), (-1.0, "-1")]
    factors = [(1.0, "×1"), (2.0, "×2")]
    powers = range(int(np.ceil(size)) + 1)
    # four labels at most: more would lie over each other
    for n in powers[:: max(1, len(powers) // 4)][1:]:
        margins.append((-(10.0**n), f"-1e{n}"))
        factors.append((10.0**n, f"×1e{n}"))
    _ticks(ax, margins)
    _ticks(right, [(1 - factor, text) for factor, text in factors])


def _even_scale(ax: "Axes", right: "Axes", lowest: float) -> None:
    """Scale margins around 0 evenly, with the factors that fit as ticks of the right side."""
    bottom = min(lowest, 0)
    pad = 0.06 * (1 - bottom)
    for side in (ax, right):
        side.set_ylim(bottom - pad, 1 + pad)
    _ticks(right, [(1 - f, f"×{f:g}") for f in FACTORS if 1 - f >= bottom - pad])


def _ticks(ax: "Axes", ticks: Sequence[tuple[float, str]]) -> None:
    ax.set_yticks([at for at, _ in ticks], [text for _, text in ticks])


def _mark_alarms(ax: "Axes", x: np.ndarray, count: int) -> None:
    ax.plot(
        x,
        np.full(len(x), 1.02),
        ls="",
        marker="v",
        ms=4,
        color=FAULTY,
        transform=ax.get_xaxis_transform(),
        clip_on=False,
    )
    text = f"{count} alarm" + "s" * (count != 1)
    ax.text(1.0, 1.055, text, ha="right", transform=ax.transAxes, fontsize=9.5, color=FAULTY)


def _ribbon(ax: "Axes", x: np.ndarray, status: np.ndarray, observes: bool) -> None:
    """Draw a strip in the colour of the worst verdict of each bin, with a legend of the verdicts that
    occur.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    colours, names = dict(COLOURS), {s: s.name for s in Status}
    if observes:  # of a healthy sample: nothing to warn of
        colours[Status.UNDECIDED] = CALM
        names[Status.UNDECIDED] = shown_name(Status.UNDECIDED, remembers=True)
    # each verdict reaches half way to its neighbours: times need not be even
    edges = np.concatenate([x[:1], x[1:] - (x[1:] - x[:-1]) / 2, x[-1:]])
    shades = ListedColormap([colours[s] for s in Status])
    ax.pcolormesh(edges, [0, 1], status[None, :], cmap=shades, vmin=-0.5, vmax=3.5)
    ax.set_yticks([])
    ax.set_ylabel("verdict", rotation=0, ha="right", va="center")
    present = [s for s in Status if (status == s).any()]
    handles = [Patch(color=colours[s], label=names[s]) for s in present]
    ax.figure.legend(handles=handles, loc="lower left", ncols=4, fontsize=9, bbox_to_anchor=(0.066, 0.0))
