"""Bounds against the smallest fault that is seen, for the disturbances that a fit looked at."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import FAULTY, GRID, LINES
from jaxbound.studies.identification.fit_result import FitCheck

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_tradeoff(ax: "Axes", legend: "Axes", check: FitCheck) -> None:
    """Draw the size of each fault from which on it is seen over the bound of the first output, as wide as a
    recording asks for that is left out; the choice is marked. Neighbours differ in more than their bounds:
    no line joins them.
    """
    name = next(iter(check.smallest))
    rows = sorted(check.tradeoff, key=lambda row: row.noise[name])
    bounds = np.array([row.noise[name] for row in rows])
    handles = []
    for number, fault in enumerate(rows[0].sizes):
        sizes = np.array([row.sizes[fault] for row in rows])
        sizes[~np.isfinite(sizes)] = np.nan
        colour = LINES[number % len(LINES)]
        size = 8 - 2 * (number % 3)  # of outputs that share an offset the sizes are often the same
        (line,) = ax.plot(bounds, sizes, ls="none", color=colour, marker="o", ms=size, label=fault)
        handles.append(line)
    chosen = next(row.noise[name] for row in rows if row.chosen)
    handles.append(ax.axvline(chosen, color=FAULTY, lw=1, label="chosen"))
    ax.set_title("Smallest fault seen in the longest recording, of each choice of disturbances")
    ax.set_xlabel(f"bound on the noise of {name}, as left-out recordings and safety ask for")
    ax.set_ylim(bottom=0)
    ax.grid(axis="y", color=GRID)
    legend.axis("off")
    legend.legend(handles=handles, loc="center left")
