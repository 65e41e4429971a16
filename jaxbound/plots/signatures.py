"""The pictures of what faults do to relations: tables as heat maps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import INK, PALE, chart
from jaxbound.plots.plot import plot
from jaxbound.relations.decoupling import Isolability, Signatures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HALF = "#8fb8d8"
WIDTH = 6.4  # inches, for the title


@dataclass(frozen=True)
class _Table:
    """A table of faults. Fields: level (rows, columns) -1 to 2; columns, rows, legend: names."""

    level: np.ndarray
    columns: Sequence[str]
    rows: Sequence[str]
    legend: Sequence[str]

    def plot(self, title: str, ax: "Axes | None") -> "Figure | Axes":
        """Return the picture of the table."""
        width = max(WIDTH, 2.2 + 0.62 * len(self.columns))
        return chart(self._draw, (width, 1.8 + 0.34 * len(self.rows)), title, ax)

    def _draw(self, ax: "Axes") -> None:
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Patch

        colours = ListedColormap(["white", PALE, HALF, INK])
        columns, rows = np.arange(len(self.columns) + 1), np.arange(len(self.rows) + 1)
        ax.pcolormesh(columns, rows, self.level, cmap=colours, vmin=-1.5, vmax=2.5, edgecolor="white", lw=2)
        ax.set_xticks(columns[:-1] + 0.5, self.columns)
        ax.set_yticks(rows[:-1] + 0.5, self.rows)
        ax.invert_yaxis()
        ax.xaxis.tick_top()
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        patches = [
            Patch(color=c, label=label) for c, label in zip((PALE, HALF, INK), self.legend, strict=True)
        ]
        ax.legend(handles=patches, loc="upper center", ncols=3, bbox_to_anchor=(0.5, 0.0), fontsize=9)


@plot.register(Signatures)
def plot_signatures(table: Signatures, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw which relation reacts to which fault, and whether to its changes only."""
    level = table.weak.astype(int) + table.constant
    title = f"Which relation reacts to which fault: two faults differ in at least {table.distance}"
    names = table.faults, table.relations
    return _Table(level, *names, ("no reaction", "to changes", "reacts")).plot(title, ax)


@plot.register(Isolability)
def plot_isolability(found: Isolability, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw which fault shows at all, and which shows whatever another one does."""
    seen = found.detectable.astype(int) + found.detectable_constant
    level = found.isolable.astype(int) + found.isolable_constant
    level[np.arange(len(level)), np.arange(len(level))] = -1
    title = "Does the fault of the row show, whatever that of the column does?"
    columns = ("no other", *found.faults)
    table = _Table(np.column_stack([seen, level]), columns, found.faults, ("no", "its changes", "yes"))
    return table.plot(title, ax)
