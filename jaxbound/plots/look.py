"""The picture of a recording that was looked at."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import ENVELOPE, FAULTY, GRID, INK, PANELS, canvas, label_time, style, time_axis
from jaxbound.plots.plot import plot
from jaxbound.recordings.look import Look, LookedColumn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 5 * PANELS
"""Columns that are drawn; of a recording with more, the first."""
GAP = 5  # usual steps between bins from which on there is a gap


@plot.register(Look)
def plot_look(found: Look) -> "Figure":
    """Draw a Look: each column of numbers over time, as the extremes of its bins; what should be asked of it
    is in its title.
    """
    drawn: list[LookedColumn] = []
    for column in found.columns:
        if column.curve is not None:
            drawn.append(column)
    at, label, dates = time_axis(found.axis)
    steps = np.diff(at)
    gaps = np.flatnonzero(steps > GAP * np.median(steps)) + 1  # no line leads across
    with style():
        rows = -(-max(len(drawn[:MOST]), 1) // 2)
        fig = canvas((11, 0.4 + 1.5 * rows), "constrained")
        axes = fig.subplots(rows, 2, squeeze=False)
        for ax, column in zip(axes.ravel(), drawn, strict=False):
            assert column.curve is not None, "it is drawn"
            low, high = column.curve
            for part in np.split(np.arange(len(at)), gaps):
                ax.fill_between(at[part], low[part], high[part], color=ENVELOPE, alpha=0.5, lw=0)
                for curve in (low, high):
                    ax.plot(at[part], curve[part], color=INK, lw=0.7)
            title, colour = column.name[:60], INK
            if column.findings:
                title, colour = f"{title}   {', '.join(column.marks)}", FAULTY
            ax.set_title(title, parse_math=False, color=colour)
            ax.grid(color=GRID, lw=0.7)
            label_time(ax, at, label, dates)
        for ax in axes.ravel()[len(drawn) :]:
            ax.set_visible(False)
        if len(drawn) > MOST:
            fig.suptitle(f"the first {MOST} of {len(drawn)} columns", x=0.02, ha="left", color=INK)
    return fig
