"""The picture of a bank of relations on a recording: which are violated, and which single faults explain
that.
"""

from collections.abc import Sequence
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
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@plot.register(BankResult)
def plot_bank(res: BankResult, time: np.ndarray | None = None) -> "Figure":
    """Draw the relations violated and the candidates of one recording, each as a raster over time."""
    if time is None and res.relations is None:  # residuals from elsewhere have no sampling period
        at, label, dates = np.arange(len(res.status)), "sample", False
    else:
        at, label, dates = time_axis(time_of(res, time))
    bins = np.unique(np.linspace(0, len(at), min(len(at), BINS), endpoint=False).astype(int))
    # a raster needs the end of its last bin too
    edges = np.append(at[bins], at[-1:])
    # a bin with one violated window is drawn as violated
    violated, able = (np.maximum.reduceat(on, bins, axis=0).T for on in (res.violated, res.candidates))
    relations, faults = res.signatures.relations, res.faults
    # rows of both charts are equally high
    heights = [len(relations), len(faults)]
    with style():
        fig, (top, bottom) = stacked(2, (11, 1.6 + 0.2 * sum(heights)), heights)
        top.set_title("Relations violated, each a proof")
        _raster(top, edges, violated, relations, FAULTY)
        bottom.set_title("Single faults that explain them")
        _raster(bottom, edges, able, faults, COLOURS[Status.UNDECIDED])
        finish(fig, [top, bottom], at, label, dates, gap=0.5)
    return fig


def _raster(ax: "Axes", edges: np.ndarray, on: np.ndarray, names: Sequence[str], colour: str) -> None:
    """Draw a row for each name, coloured in the bins in which it is on."""
    from matplotlib.colors import ListedColormap

    rows, colours = np.arange(len(names) + 1), ListedColormap([PALE, colour])
    ax.pcolormesh(edges, rows, on, cmap=colours, vmin=0, vmax=1, shading="flat")
    ax.set_yticks(rows[:-1] + 0.5, names, fontsize=8)
    ax.hlines(rows[1:-1], edges[0], edges[-1], color=GRID, lw=0.6)
    ax.invert_yaxis()
    ax.tick_params(axis="y", length=0)
