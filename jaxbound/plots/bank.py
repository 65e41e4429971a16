"""The picture of a bank of relations on a recording: which are violated, and which single faults explain
that.
"""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.diagnosis.isolation import BankResult
from jaxbound.plots.canvas import (
    BINS,
    COLOURS,
    FAULTY,
    GRID,
    PALE,
    finish,
    stacked,
    style,
    time_axis,
    time_of,
)
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_bank"]


@plot.register(BankResult)
def plot_bank(res: BankResult, time: np.ndarray | None = None) -> "Figure":
    """Draw the relations violated and the candidates of one recording, each as a raster over time."""
    from matplotlib.colors import ListedColormap

    x = np.arange(len(res.status)) if time is None and res.relations is None else time_of(res, time)
    at, label, dates = (x, "sample", False) if time is None and res.relations is None else time_axis(x)
    bins = np.unique(np.linspace(0, len(x), min(len(x), BINS), endpoint=False).astype(int))
    gather = lambda on: np.maximum.reduceat(on, bins, axis=0).T
    edges = np.append(at[bins], at[-1:])
    table = res.signatures
    assert table is not None, "only a field that follows others with a default has one"
    with style():
        count = len(table.relations)
        fig, (top, bottom) = stacked(2, (11, 1.6 + 0.2 * (count + len(res.faults))), [count, len(res.faults)])
        panels = (
            (top, gather(res.violated), table.relations, FAULTY, "Relations violated, each a proof"),
            (
                bottom,
                gather(res.candidates),
                res.faults,
                COLOURS[Status.UNDECIDED],
                "Single faults that explain them",
            ),
        )
        for ax, on, names, colour, title in panels:
            ax.pcolormesh(
                edges,
                np.arange(len(names) + 1),
                on,
                cmap=ListedColormap([PALE, colour]),
                vmin=0,
                vmax=1,
                shading="flat",
            )
            ax.set_yticks(np.arange(len(names)) + 0.5, names, fontsize=8)
            ax.set_title(title)
            ax.hlines(np.arange(1, len(names)), edges[0], edges[-1], color=GRID, lw=0.6)
            ax.invert_yaxis()
            ax.tick_params(axis="y", length=0)
        finish(fig, [top, bottom], at, label, dates, gap=0.5)
    return fig
