"""The picture of an assessment: faulty windows in alarm against healthy ones in alarm, over factors on the
bounds.
"""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.plots.canvas import FAULTY, GRID, INK, LINES, canvas, style
from jaxbound.plots.plot import plot
from jaxbound.studies.assessment.assessment import Assessment, Marks
from jaxbound.studies.assessment.scores import rule_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@plot.register(Assessment)
def plot_assessment(res: Assessment) -> "Figure":
    """Draw an Assessment: its curve and those of other detectors, a mark at the bounds or thresholds as they
    are.

    Returns:
        A matplotlib Figure. A curve needs healthy and faulty windows both; without them its chart is empty.
    """
    with style():
        fig = canvas((6.4, 5.2), "constrained")
        ax = fig.subplots()
        for number, peer in enumerate(res.peers):
            _draw(ax, peer, LINES[1 + number % (len(LINES) - 1)], 1.2)
        _draw(ax, res.marks, INK, 2.0)
        ax.set_title(f"Alarms by the rule {rule_text(res.score)}; marks: bounds and thresholds as they are")
        ax.set(xlabel="healthy windows in alarm", ylabel="faulty windows in alarm")
        ax.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        ax.grid(color=GRID, lw=0.6)
        ax.legend(fontsize=8, loc="lower right")
    return fig


def _draw(ax: "Axes", marks: Marks, colour: str, width: float) -> None:
    """Draw the curve of one detector and its own point."""
    _, false, caught = np.transpose(marks.curve)
    ax.plot(false, caught, color=colour, lw=width, label=marks.name)
    own = marks.at(1.0)
    ax.plot([own.false_share], [own.caught_share], "o", color=colour, mec=FAULTY, ms=6)
