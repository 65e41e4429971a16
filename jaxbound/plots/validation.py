"""Pictures of validated outputs: the band that the samples accepted allow, what the sensor showed, what to
use instead.
"""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from jaxbound.estimation.validation import Validation
from jaxbound.models.system import LinearSystem
from jaxbound.plots.bands import Band, draw_band, draw_bands, name_band, one_of, one_recording, one_signal
from jaxbound.plots.canvas import SAMPLES, bins, finish, stacked, style, thinning, time_axis
from jaxbound.plots.plot import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["ValidatedRecording", "plot_output", "plot_validation"]

NEAR = 600
"""Samples around the first fault of a long recording, drawn one by one below the whole."""


class ValidatedRecording(Protocol):
    """A Validation of one recording, with the model and the samples that it came from: y (T, p)."""

    @property
    def model(self) -> LinearSystem: ...  # noqa: D102
    @property
    def found(self) -> Validation: ...  # noqa: D102
    @property
    def y(self) -> np.ndarray: ...  # noqa: D102


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
        output, corrected = one_of(found.output, i), one_of(found.corrected, i)
        panels.append(Band(title, output, one_signal(y, i), wrong, corrected))
    return draw_bands(panels, time, "outputs")


def plot_output(res: ValidatedRecording, i: int, time: np.ndarray) -> "Figure":
    """Draw one output of a validated recording; the samples that are proved to be faulty are marked.

    Args:
        res: ValidatedRecording. i: number of the output. time: (T,) seconds or datetime64.

    Returns:
        A matplotlib Figure. Of more than 5000 samples, the extremes of 1200 bins are drawn; a bin with one
        faulty sample is marked. Below are the 600 samples around the first faulty one.
    """
    x, label, dates = time_axis(time)
    count, name, unit = len(x), res.model.outputs[i], res.model.unit(res.model.outputs[i])
    faulty, y = np.asarray(res.found.faulty)[:, i], res.y[:, i]
    whole = bins(count)
    spans, times = [whole], [x]
    if count > SAMPLES:
        first = max(min(int(np.argmax(faulty)) - NEAR // 4, count - NEAR), 0)
        spans.append(np.arange(first, first + NEAR))
        times.append(x[spans[1]])
    with style():
        fig, axes = stacked(
            len(spans), (11, 1.0 + 2.6 * len(spans)), [1] * len(spans), shared=len(spans) == 1
        )
        _draw(axes[0], res.found, i, y, x, whole, count)
        title = f"{name}: {_faults(faulty)}{thinning(count, len(whole), 'extremes')}"
        axes[0].set_title(title, pad=24, parse_math=False)
        if len(spans) > 1:
            _draw(axes[1], res.found, i, y, x, spans[1], spans[1][-1] + 1)
            near = "The first samples"
            if faulty.any():
                near = "The samples around the first faulty one"
            axes[1].set_title(near, pad=6)
        name_band(axes[0])
        if unit:
            name += f" [{unit}]"
        for ax, part in zip(axes, times, strict=True):
            ax.set_ylabel(name, parse_math=False)
            below = ""
            if ax is axes[-1]:
                below = label
            finish(fig, [ax], part, below, dates, top=0.7, gap=0.36)
    return fig


def _faults(faulty: np.ndarray) -> str:
    """Return "3 faulty samples in 2 stretches"."""
    total, stretches = int(faulty.sum()), int((np.diff(faulty.astype(int), prepend=0) == 1).sum())
    if not total:
        return "no faulty sample"
    return f"{total} faulty sample{'s' * (total > 1)} in {stretches} stretch{'es' * (stretches > 1)}"


def _draw(
    ax: "Axes", found: Validation, i: int, y: np.ndarray, x: np.ndarray, edges: np.ndarray, stop: int
) -> None:
    """Draw output i."""
    draw_band(
        ax,
        one_of(found.output, i),
        y,
        np.asarray(found.faulty)[:, i],
        x,
        edges,
        stop,
        one_of(found.corrected, i),
    )
