"""Pictures of what a set observer encloses: each output before its sample is looked at, and each state."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.estimation.observer import Observation
from jaxbound.plots.bands import draw_band, name_band
from jaxbound.plots.canvas import PANELS, bins, finish, stacked, style, thinning, time_axis
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_observation"]


@plot.register(Observation)
def plot_observation(found: Observation, time: np.ndarray | None = None, y: np.ndarray | None = None) -> "Figure":
    """Draw the band that each output must lie in as far as the samples before tell, then the band of each state; at most 12 panels.

    Args:
        found: of one recording. time: (T,) seconds or datetime64; None: the numbers of the samples. y: (T, p) what the sensors showed,
            which may leave the band by what their bounds allow; None: the bands alone.

    Returns:
        A matplotlib Figure; samples where nothing is left are shaded.

    Raises:
        ValueError: a batch of recordings, a time axis or samples of another shape.
    """
    status, p = np.asarray(found.status), found.predicted.shape[-1]
    if status.ndim != 1:
        raise ValueError(f"a plot shows one recording, this observation has the shape {status.shape}: observe and plot one of them")
    x = np.arange(len(status)) if time is None else np.asarray(time)
    if x.shape != status.shape:
        raise ValueError(f"time needs one entry for each of the {len(status)} samples: its shape is {x.shape}")
    shown = np.full((len(status), p), np.nan) if y is None else np.asarray(y)
    if shown.shape != (len(status), p):
        raise ValueError(f"y needs the samples that were observed, of shape {(len(status), p)}: its shape is {shown.shape}")
    panels = [(f"y{i + 1}, as the samples before allow", _one(found.predicted, i), shown[:, i]) for i in range(p)]
    nothing = np.full(len(status), np.nan)
    panels += [(f"state x{i + 1}", _one(found.state, i), nothing) for i in range(found.state.shape[-1])]
    at, label, dates = (x, "sample", False) if time is None else time_axis(x)
    edges, wrong = bins(len(x)), status == Status.FAULT
    drawn = panels[:PANELS]
    with style():
        fig, axes = stacked(len(drawn), (11, 1.6 + 1.8 * len(drawn)), [1] * len(drawn))
        for i, (ax, (title, band, samples)) in enumerate(zip(axes, drawn, strict=True)):
            draw_band(ax, band, samples, wrong, at, edges, len(x), name="enclosure")
            more = f"; the first {PANELS} of {len(panels)} bands are shown" if i == 0 and len(panels) > PANELS else ""
            ax.set_title(f"{title}{more}{thinning(len(x), len(edges), 'extremes')}", pad=6)
        name_band(axes[0], None if y is not None else "measured")
        finish(fig, axes, at, label, dates, top=0.7, gap=0.36)
    return fig


def _one(band, i):
    return Interval(np.asarray(band.lo)[:, i], np.asarray(band.hi)[:, i])
