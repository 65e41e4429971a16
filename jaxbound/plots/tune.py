"""The picture of a search for bounds."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import COLOURS, FAULTY, GRID, INK, LINES, canvas, note, style
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning.tuning import TuneResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@plot.register(TuneResult)
def plot_tuning(res: TuneResult) -> "Figure":
    """Draw a TuneResult: its bounds and their width over the steps, and the margins of the healthy windows at
    the end.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    history, margin = res.history, res.margin[~np.isnan(res.margin)]
    with style():
        fig = canvas((11, 3.6), "constrained")
        width, bounds, last = fig.subplots(1, 3)
        if len(history["step"]) > 1:
            width.plot(history["step"], history["width"], color=INK)
            if not np.isnan(history["outside"]).all():
                share = width.twinx()
                share.plot(history["step"], history["outside"], color=FAULTY)
                share.set_ylim(0, 1.02)
                share.tick_params(axis="y", colors=FAULTY)
                width.set_title("Width; share of faulty windows outside")
            else:
                width.set_title("Smallest width in this direction / start")
            start = history["values"][0] / history["width"][0]
            for i, name in enumerate(res.names):
                values = history["values"][:, i] / start[i]
                bounds.plot(history["step"], values, color=LINES[i % len(LINES)], label=name)
            bounds.set_yscale("log")
            bounds.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            bounds.yaxis.set_major_formatter(FuncFormatter(lambda x, at: f"{x:g}"))
            bounds.yaxis.set_minor_locator(NullLocator())
            bounds.legend(fontsize=7.5)
        else:
            for ax in (width, bounds):
                note(ax, "one factor on all bounds:\nno steps")
                ax.set(xticks=[], yticks=[])
        bounds.set_title("Each bound / start")
        for ax in (width, bounds):
            ax.set_xlabel("step")
            ax.grid(axis="y", color=GRID)
        last.hist(margin, bins=40, color=COLOURS[Status.CONSISTENT])
        last.axvline(0, color=FAULTY, lw=1)
        last.set_yscale("log")
        last.set_title(f"Margins of {len(margin)} healthy windows")
        last.set_xlabel("margin at the tuned bounds, < 0: outside")
    return fig
