"""The picture of a diagnosis: how large each named fault is at least, if it alone is the cause."""

from functools import partial
from typing import TYPE_CHECKING

from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.plots.canvas import FAULTY, GRID, INK, chart
from jaxbound.plots.plot import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INCHES = 0.42  # of a row


@plot.register(Diagnosis)
def plot_diagnosis(found: Diagnosis, ax: "Axes | None" = None) -> "Figure | Axes":
    """Draw a bar for each named fault that alone explains the windows, its size beside a usual one; the
    others say why they do not.
    """
    title = "No named fault explains this"
    if found.explains:
        title = f"Smallest size that explains it: {found.first}"
    size = (8.4, 1.3 + INCHES * max(len(found.lines), 1))
    return chart(partial(_draw, found), size, title, ax)


def _draw(found: Diagnosis, ax: "Axes") -> None:
    """Draw the rows of a diagnosis, the most plausible fault on top."""
    names: list[str] = []
    lengths = [float(share) for share in found.shares.values()]
    longest = max(lengths, default=1.0)
    for name, words, share in found.lines:
        if share is None:
            _said(ax, (0, len(names)), words)
        else:
            colour = INK
            if not names:
                colour = FAULTY
            ax.barh(len(names), float(share), color=colour, height=0.55)
            _said(ax, (float(share), len(names)), words, INK)
        names.append(name)
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(max(len(names), 1) - 0.4, -0.6)
    ax.set_xlim(0, 1.6 * longest)
    ax.set_xlabel("size beside a usual one: the range of its actuator in training, the span of its readings")
    ax.grid(axis="x", color=GRID)
    ax.set_axisbelow(True)


def _said(ax: "Axes", at: tuple[float, int], words: str, colour: str = "#777") -> None:
    """Write words behind a bar, or in its place."""
    ax.annotate(words, at, (5, 0), textcoords="offset points", va="center", fontsize=8.5, color=colour)
