"""Pictures of validated outputs: the band that the samples accepted allow, what the sensor showed, what to
use instead.
"""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.estimation.validation import Validation
from jaxbound.plots.bands import Band, band_at, draw_bands, one_recording, one_signal
from jaxbound.plots.plot import plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@plot.register(Validation)
def plot_validation(
    found: Validation, time: np.ndarray | None = None, y: np.ndarray | None = None
) -> "Figure":
    """Draw every output of a validated recording below each other, at most 12.

    Args:
        found: of one recording. time: (T,) seconds or datetime64; None: the numbers of the samples. y: (T, p)
            what the sensors showed, which a Validation does not hold; None: the bands of the true values are
            drawn without it.

    Returns:
        A matplotlib Figure.

    Raises:
        ValueError: a batch of recordings, a time axis or samples of another shape.
    """
    faulty = np.asarray(found.faulty)
    p = faulty.shape[-1]
    time, y = one_recording("validation", "validate", faulty.shape[:-1], p, time, y)
    panels = []
    for i in range(p):
        title, wrong = f"y{i + 1}: {_faults(faulty[:, i])}", faulty[:, i]
        output, corrected = band_at(found.output, i), band_at(found.corrected, i)
        panels.append(Band(title, output, one_signal(y, i), wrong, corrected))
    return draw_bands(panels, time, "outputs")


def _faults(faulty: np.ndarray) -> str:
    """Return "3 faulty samples in 2 stretches"."""
    total, stretches = int(faulty.sum()), int((np.diff(faulty.astype(int), prepend=0) == 1).sum())
    if not total:
        return "no faulty sample"
    return f"{total} faulty sample{'s' * (total > 1)} in {stretches} stretch{'es' * (stretches > 1)}"
