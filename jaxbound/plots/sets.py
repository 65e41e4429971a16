"""The picture of sets in the plane: their outlines."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxbound.plots.canvas import COLOURS, ENVELOPE, FAULTY, INK, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope
from jaxbound.sets.zonotopes.extents import support
from jaxbound.sets.zonotopes.shapes import vertices
from jaxbound.sets.zonotopes.zonotope import Zonotope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_set", "plot_sets"]

SERIES = (INK, FAULTY, COLOURS[Status.CONSISTENT], ENVELOPE, COLOURS[Status.UNDECIDED])
SIDES = 360  # of the polygon drawn around a constrained zonotope


@plot.register(Zonotope | ConstrainedZonotope)
def plot_set(S: Zonotope | ConstrainedZonotope, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw the outline of one set in the plane."""
    return plot_sets([S], ax)


@plot.register(list | tuple)
def plot_sets(sets: Sequence[Zonotope | ConstrainedZonotope], ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw the outlines of sets in the plane.

    Raises:
        ValueError: anything else than sets of two coordinates.
    """
    for S in sets:
        if not isinstance(S, Zonotope | ConstrainedZonotope) or np.shape(S.center) != (2,):
            raise ValueError(
                f"sets of two coordinates can be drawn, not {type(S).__name__} "
                f"{np.shape(getattr(S, 'center', ()))}: "
                "choose two with linear_map"
            )
    if ax is not None:
        _draw(ax, sets)
        return ax
    with style():
        fig = canvas((5.2, 4.6))
        _draw(fig.subplots(), sets)
        fig.subplots_adjust(left=0.14, right=0.97, top=0.97, bottom=0.13)
    return fig


def _draw(ax: "Axes", sets: Sequence[Zonotope | ConstrainedZonotope]) -> None:
    for number, S in enumerate(sets):
        outline, colour = _outline(S), SERIES[number % len(SERIES)]
        ax.fill(*outline.T, facecolor=colour, alpha=0.18)
        ax.plot(*np.concatenate([outline, outline[:1]]).T, color=colour, lw=1.6)
    ax.set_xlabel("first coordinate")
    ax.set_ylabel("second coordinate")
    ax.set_aspect("equal", "datalim")


def _outline(S: Zonotope | ConstrainedZonotope) -> np.ndarray:
    """Return the corners of a zonotope, or of a polygon that touches a constrained one on every side."""
    if isinstance(S, Zonotope):
        return vertices(S)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    far = np.asarray(jax.vmap(support, (None, 0))(S, normal.astype(S.center.dtype)))
    after = np.roll(far, -1)  # two neighbouring sides meet where both are touched
    along = (after - far * np.cos(angle[1])) / np.sin(angle[1])
    side = np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.asarray(far[:, None] * normal + along[:, None] * side)
