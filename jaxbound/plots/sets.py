"""The picture of sets in the plane: their outlines."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import jax
import numpy as np

from jaxbound.plots.canvas import LINES, chart
from jaxbound.plots.plot import plot
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope
from jaxbound.sets.zonotopes.extents import support
from jaxbound.sets.zonotopes.shapes import vertices
from jaxbound.sets.zonotopes.zonotope import Zonotope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    return chart(partial(_draw, sets), (5.2, 4.6), "", ax)


def _draw(sets: Sequence[Zonotope | ConstrainedZonotope], ax: "Axes") -> None:
    for number, S in enumerate(sets):
        outline, colour = _outline(S), LINES[number % len(LINES)]
        ax.fill(*outline.T, facecolor=colour, alpha=0.18)
        ax.plot(*np.concatenate([outline, outline[:1]]).T, color=colour, lw=1.6)
    ax.set(xlabel="first coordinate", ylabel="second coordinate")
    ax.set_aspect("equal", "datalim")


def _outline(S: Zonotope | ConstrainedZonotope) -> np.ndarray:
    """Return the corners of a zonotope, or of a polygon that touches a constrained one on every side."""
    if isinstance(S, Zonotope):
        return vertices(S)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    # support functions give tangents: the polygon lies around the set, never inside
    far = np.asarray(jax.vmap(support, (None, 0))(S, normal.astype(S.center.dtype)))
    after = np.roll(far, -1)  # two neighbouring sides meet where both are touched
    along = (after - far * np.cos(angle[1])) / np.sin(angle[1])
    side = np.column_stack([-normal[:, 1], normal[:, 0]])
    return np.asarray(far[:, None] * normal + along[:, None] * side)
