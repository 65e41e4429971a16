"""Pictures of what a set observer encloses: each output before its sample is looked at, and each state."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.estimation.observation import Observation
from jaxbound.plots.bands import Band, band_at, draw_bands, one_recording, one_signal
from jaxbound.plots.plot import plot
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@plot.register(Observation)
def plot_observation(
    found: Observation, time: np.ndarray | None = None, y: np.ndarray | None = None
) -> "Figure":
    """Draw the band that each output must lie in as far as the samples before tell, then the band of each
    state; at most 12 panels.

    Args:
        found: of one recording. time: (T,) seconds or datetime64; None: the numbers of the samples. y: (T, p)
            what the sensors showed, which may leave the band by what their bounds allow; None: the bands
            alone.

    Returns:
        A matplotlib Figure; samples where nothing is left are shaded.

    Raises:
        ValueError: a batch of recordings, a time axis or samples of another shape.
    """
    status, p = np.asarray(found.status), found.predicted.shape[-1]
    time, y = one_recording("observation", "observe", status.shape, p, time, y)
    wrong, panels = status == Status.FAULT, []
    for i in range(p):
        title = f"y{i + 1}, as the samples before allow"
        panels.append(Band(title, band_at(found.predicted, i), one_signal(y, i), wrong))
    for i in range(found.state.shape[-1]):
        panels.append(Band(f"state x{i + 1}", band_at(found.state, i), None, wrong))
    return draw_bands(panels, time, "bands", "enclosure")
