"""The picture of a set of parameters: its boxes, for each pair of parameters."""

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.estimation.parameter_set import ParameterSet
from jaxbound.plots.canvas import ENVELOPE, FAULTY, INK, canvas, note, style
from jaxbound.plots.plot import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAIRS = 6
"""Pairs of parameters that are drawn at most."""
ACROSS = 3
SIDE = 3.7
"""Inches of one chart."""
AROUND = 0.15
"""What is drawn around the hull, as a share of it."""


@plot.register(ParameterSet)
def plot_parameters(found: ParameterSet) -> "Figure":
    """Draw a ParameterSet: the boxes for each pair of parameters, at most six; of one parameter its hull
    within the bounds that were searched.
    """
    pairs = list(combinations(range(len(found.names)), 2))[:PAIRS]
    with style():
        if not pairs:
            return _one(found)
        columns = min(len(pairs), ACROSS)
        rows = -(-len(pairs) // columns)
        fig = canvas((max(SIDE * columns, 5.2), SIDE * rows + 0.4), "constrained")
        axes = fig.subplots(rows, columns, squeeze=False).ravel()
        for ax, (i, j) in zip(axes, pairs, strict=False):
            _pair(ax, found, i, j)
        # the last row may not be full
        for ax in axes[len(pairs) :]:
            ax.set_visible(False)
        fig.suptitle(_title(found), x=0.02, ha="left", fontsize=10.5, color=INK)
    return fig


def _pair(ax: "Axes", found: ParameterSet, i: int, j: int) -> None:
    """Draw the boxes in the plane of two parameters, around their hull."""
    from matplotlib.collections import PolyCollection

    (a, b), (c, d) = zip(found.lo[:, [i, j]].T, found.hi[:, [i, j]].T, strict=True)
    # boxes that differ in other parameters only lie over each other: once is enough
    left, low, right, top = np.unique(np.stack([a, c, b, d], 1), axis=0).T
    corners = np.stack([np.stack([left, right, right, left], 1), np.stack([low, low, top, top], 1)], 2)
    ax.add_collection(PolyCollection(list(corners), facecolors=ENVELOPE, edgecolors=ENVELOPE, linewidths=0.3))
    for end in found.bounds[found.names[i]]:
        ax.axvline(end, color=INK, lw=0.8, ls=":")
    for end in found.bounds[found.names[j]]:
        ax.axhline(end, color=INK, lw=0.8, ls=":")
    ax.set(xlim=_limits(found, found.names[i]), ylim=_limits(found, found.names[j]))
    ax.set(xlabel=_label(found, i), ylabel=_label(found, j))
    if not len(found.lo):
        note(ax, "no value is left", FAULTY)


def _one(found: ParameterSet) -> "Figure":
    """Draw the boxes of one parameter, and the bounds that were searched."""
    fig = canvas((6.4, 1.7), "constrained")
    ax = fig.subplots()
    for lo, hi in zip(found.lo[:, 0], found.hi[:, 0], strict=True):
        ax.axvspan(lo, hi, color=ENVELOPE, lw=0)
    for end in found.bounds[found.names[0]]:
        ax.axvline(end, color=INK, lw=0.8, ls=":")
    if not len(found.lo):
        note(ax, "no value is left", FAULTY)
    lo, hi = found.bounds[found.names[0]]
    room = AROUND * (hi - lo)
    ax.set(xlim=(lo - room, hi + room), yticks=[], xlabel=_label(found, 0))
    ax.set_title(_title(found))
    return fig


def _limits(found: ParameterSet, name: str) -> tuple[float, float]:
    """Return the ends of an axis: of the hull and some room, or of all that was searched."""
    lo, hi = found.hull.get(name, found.bounds[name])
    # a parameter of one value still needs an axis of some width
    room = AROUND * (hi - lo) or 1.0
    return lo - room, hi + room


def _label(found: ParameterSet, i: int) -> str:
    """Return the name of a parameter and the bounds that were searched."""
    lo, hi = found.bounds[found.names[i]]
    return f"{found.names[i]}   (of {lo:g} to {hi:g})"


def _title(found: ParameterSet) -> str:
    """Return the title of a picture."""
    if not len(found.lo):
        return f"FAULT: no parameters explain all {found.windows} windows"
    left = f"{100 * found.share:.3g} % of the volume"
    return f"Parameters that may explain all {found.windows} windows: {left}"
