"""The pictures of what faults do to relations: tables as heat maps."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import INK, PALE, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.relations.decoupling import Isolability, Signatures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_isolability", "plot_signatures"]

HALF = "#8fb8d8"


@plot.register(Signatures)
def plot_signatures(table: Signatures, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw which relation reacts to which fault, and whether to its changes only."""
    level = table.weak.astype(int) + table.constant
    title = f"Which relation reacts to which fault: two faults differ in at least {table.distance}"
    return _heat_map(level, table.faults, table.relations, ("no reaction", "to changes", "reacts"), title, ax)


@plot.register(Isolability)
def plot_isolability(found: Isolability, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw which fault shows at all, and which shows whatever another one does."""
    seen = found.detectable.astype(int) + found.detectable_constant
    level = found.isolable.astype(int) + found.isolable_constant
    level[np.arange(len(level)), np.arange(len(level))] = -1
    title = "Does the fault of the row show, whatever that of the column does?"
    legend = ("no", "its changes", "yes")
    return _heat_map(
        np.column_stack([seen, level]), ("no other", *found.faults), found.faults, legend, title, ax
    )


def _heat_map(
    level: np.ndarray,
    columns: Sequence[str],
    rows: Sequence[str],
    legend: Sequence[str],
    title: str,
    ax: "Axes | None",
) -> "Figure | Axes":
    from matplotlib.patches import Patch

    patches = [Patch(color=c, label=label) for c, label in zip((PALE, HALF, INK), legend, strict=True)]
    if ax is not None:
        _table(ax, level, columns, rows)
        ax.set_title(title)
        ax.legend(handles=patches, loc="upper center", ncols=3, bbox_to_anchor=(0.5, 0.0), fontsize=9)
        return ax
    with style():
        fig = canvas((2.2 + 0.62 * len(columns), 1.5 + 0.34 * len(rows)))
        _table(fig.subplots(), level, columns, rows)
        fig.suptitle(title, x=0.02, ha="left", fontsize=10.5, color=INK)
        fig.legend(handles=patches, loc="lower left", ncols=3, bbox_to_anchor=(0.01, 0.0), fontsize=9)
        height = fig.get_figheight()
        fig.subplots_adjust(
            left=0.9 / fig.get_figwidth(), right=0.98, top=1 - 0.75 / height, bottom=0.45 / height
        )
    return fig


def _table(ax: "Axes", level: np.ndarray, columns: Sequence[str], rows: Sequence[str]) -> None:
    from matplotlib.colors import ListedColormap

    ax.pcolormesh(
        np.arange(len(columns) + 1),
        np.arange(len(rows) + 1),
        level,
        cmap=ListedColormap(["white", PALE, HALF, INK]),
        vmin=-1.5,
        vmax=2.5,
        edgecolor="white",
        lw=2,
    )
    ax.set_xticks(np.arange(len(columns)) + 0.5, columns)
    ax.set_yticks(np.arange(len(rows)) + 0.5, rows)
    ax.invert_yaxis()
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
