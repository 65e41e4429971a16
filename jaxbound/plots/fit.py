"""The picture of a fit."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import COLOURS, FAULTY, GRID, INK, LINES, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.plots.tradeoff import draw_tradeoff
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification.fit_result import FitCheck, Fitted

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HOUR = 3600


@plot.register(Fitted)
def plot_fit(model: Fitted) -> "Figure":
    """Draw a Fitted: the share of the bounds that each window needs, in the recordings and, by fits
    to all others, in those that were left out; where a condition on the time would make bounds narrower, the
    same over that time; with disturbances, the trade-off between bounds and faults.
    """
    check, what, apart = model.check, "a window needs", "each left out"
    if model.horizon is None:  # an observer: one factor a recording
        what, apart = "a sample needs", "each left out, as a whole"
    rows = [(f"{what}: final model, all recordings", check.used, INK)]
    if check.held_out is not None:
        alone = f"{what}: {apart}, by a fit to the others"
        rows.append((alone, check.held_out_used, COLOURS[Status.UNDECIDED]))
    leaves_out = check.widest is not None and check.widest.where != ""
    panels = len(rows) + leaves_out + bool(check.tradeoff)
    with style():
        fig = canvas((11, 0.6 + 2.1 * panels), "constrained")
        axes = fig.subplots(panels, 2, squeeze=False, width_ratios=(3, 1))
        for (title, parts, colour), (line, bars) in zip(rows, axes[: len(rows)], strict=True):
            edges = np.cumsum([0, *map(len, parts)])
            every = np.concatenate(parts)
            bins = np.unique(np.linspace(0, len(every), min(len(every), 4000), endpoint=False).astype(int))
            line.plot(bins, np.fmax.reduceat(every, bins), color=colour, lw=0.9)
            line.axhline(1, color=FAULTY, lw=1)
            for edge in edges[1:-1]:
                line.axvline(edge, color=GRID, lw=1.2)
            line.set_xlim(0, max(len(every), 1))
            line.set_title(f"Share of the bounds that {title}")
            bars.hist(every[np.isfinite(every)], bins=30, color=colour)
            bars.axvline(1, color=FAULTY, lw=1)
            for ax in (line, bars):
                ax.grid(axis="y", color=GRID)
                ax.set_ylim(bottom=0)
        axes[len(rows) - 1][0].set_xlabel("sample, recordings one after the other")
        axes[len(rows) - 1][1].set_xlabel("share, > 1: FAULT")
        if leaves_out:
            _draw_left_out(axes[len(rows)][0], axes[len(rows)][1], check)
        if check.tradeoff:
            draw_tradeoff(axes[-1][0], axes[-1][1], check)
    return fig


def _draw_left_out(ax: "Axes", legend: "Axes", check: FitCheck) -> None:
    """Draw the share of the bounds that each window needs over the time that a condition looks at, a colour
    a recording; what the condition leaves out is shaded.
    """
    widest = check.widest
    assert widest is not None, "it says what is left out"
    low, high = np.maximum(widest.stretch, 0) / HOUR
    handles: list[Artist] = [ax.axvspan(low, high, color=GRID, label=f"left out: {widest.span}")]
    for number, (clock, used) in enumerate(zip(widest.clock, check.used, strict=True)):
        ax.plot(clock / HOUR, used, ls="none", marker=".", ms=3, color=LINES[number % len(LINES)])
    handles.append(ax.axhline(widest.rest, color=INK, lw=1, label="the most that other windows need"))
    ax.set_title("Share of the bounds that a window needs: final model, by the time of its end")
    ax.set_xlabel(f"h, {widest.counted}")
    ax.grid(axis="y", color=GRID)
    ax.set_ylim(bottom=0)
    legend.axis("off")
    legend.legend(handles=handles, loc="center left")
