"""The picture of a Result: the margin of every window over time, with a ribbon of verdicts and the alarms."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.consistency.interface import BOUNDS
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result
from jaxbound.plots.canvas import time_of
from jaxbound.plots.plot import plot
from jaxbound.plots.timeline import Timeline, plot_timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DRAWN = 2**16
"""Windows up to which a picture has exact margins; of more it has exact ones at FAULT windows alone."""


def draws_bounds(res: Result) -> bool:
    """Return whether the margins of CONSISTENT windows are bounds in a picture of a Result."""
    return res.margins == BOUNDS and len(res.margin) > DRAWN


def drawn_margins(res: Result) -> np.ndarray:
    """Return the margins (T,) that a picture of a Result has."""
    if draws_bounds(res):
        return res.reported
    return res.exact


def timeline_of(res: Result, x: np.ndarray, alarms: Sequence[Alarm]) -> Timeline:
    """Return the Timeline of a Result with these alarms. x: (T,) its time."""
    line = Timeline(len(x))
    line.add(0, x, res.status, drawn_margins(res))
    line.mark([a.worst for a in alarms])
    return line


@plot.register(Result)
def plot_result(
    res: Result,
    time: np.ndarray | None = None,
    alarms: Sequence[Alarm] | None = None,
    ax: "Axes | None" = None,
) -> "Figure | Axes":
    """Draw a Result of one recording: `plot` says what, and takes the same arguments."""
    if alarms is None:
        alarms = res.alarms()
    line = timeline_of(res, time_of(res, time), alarms)
    observes = res.relations.observes
    return plot_timeline(line, res.relations.model.name, len(alarms), ax, draws_bounds(res), observes)
