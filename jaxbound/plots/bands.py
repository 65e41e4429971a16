"""A band that holds a signal, and the samples of it: drawn alike wherever something is enclosed over time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.plots.canvas import (
    ENVELOPE,
    FAULTY,
    GRID,
    INK,
    PANELS,
    bins,
    finish,
    shade,
    stacked,
    style,
    thinning,
    time_axis,
)
from jaxbound.sets.intervals.interval import Interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class Band(NamedTuple):
    """One panel of a picture of bands, of one signal over (T,) samples.

    Fields: title. band: infinite where nothing is known, lo > hi where nothing is left. y: the samples; None:
    nothing was measured. faulty: which of them are marked. middle: a band whose middle stands in where a
    sample is faulty or missing, or None.
    """

    title: str
    band: Interval
    y: np.ndarray | None
    faulty: np.ndarray
    middle: Interval | None = None


def one_recording(
    what: str, made: str, shape: tuple[int, ...], p: int, time: np.ndarray | None, y: np.ndarray | None
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return (time (T,) or None, y (T, p) or None) as arrays, for a picture of one recording.

    Args:
        what, made: what is drawn and how it came to be, for sentences: "validation", "validate". shape: of
            its samples, (T,). p: outputs.

    Raises:
        ValueError: a batch of recordings, a time axis or samples of another shape.
    """
    if len(shape) != 1:
        raise ValueError(
            f"a plot shows one recording, this {what} has the shape {shape}: {made} and plot one of them"
        )
    if time is not None:
        time = np.asarray(time)
        if time.shape != shape:
            raise ValueError(
                f"time needs one entry for each of the {shape[0]} samples: its shape is {time.shape}"
            )
    if y is not None:
        y = np.asarray(y)
        if y.shape != (*shape, p):
            raise ValueError(
                f"y needs the samples that were {made.removesuffix('e')}ed, of shape {(*shape, p)}: its "
                f"shape is {y.shape}"
            )
    return time, y


def draw_bands(
    panels: Sequence[Band], time: np.ndarray | None, what: str, name: str = "by accepted samples"
) -> "Figure":
    """Draw bands of one recording below each other over one time axis, at most 12.

    Args:
        panels: of (T,) samples each. time: (T,) seconds or datetime64; None: the numbers of the samples.
            what: there are more of than are drawn, for the title: "outputs". name: of the band.

    Returns:
        A matplotlib Figure.
    """
    count, drawn = len(panels[0].faulty), panels[:PANELS]
    at, label, dates = np.arange(count), "sample", False
    if time is not None:
        at, label, dates = time_axis(time)
    edges = bins(count)
    thinned = thinning(count, len(edges), "extremes")
    with style():
        fig, axes = stacked(len(drawn), (11, 1.6 + 1.8 * len(drawn)), [1] * len(drawn))
        for ax, panel in zip(axes, drawn, strict=True):
            _draw(ax, panel, at[edges], edges, name)
            ax.set_title(panel.title + thinned, pad=6)
        if len(panels) > PANELS:
            more = f"; the first {PANELS} of {len(panels)} {what} are shown"
            axes[0].set_title(drawn[0].title + more + thinned, pad=6)
        _name_lines(axes[0], panels[0].y is not None)
        finish(fig, axes, at, label, dates, top=0.7, gap=0.36)
    return fig


def band_at(bands: Interval, i: int) -> Interval:
    """Return band i of bands (T, n)."""
    return Interval(np.asarray(bands.lo)[:, i], np.asarray(bands.hi)[:, i])


def one_signal(y: np.ndarray | None, i: int) -> np.ndarray | None:
    """Return the samples of one signal, None where there are none."""
    if y is None:
        return None
    return y[:, i]


def _name_lines(ax: "Axes", is_measured: bool) -> None:
    """Name the lines and areas above the axes; samples where some were measured."""
    named = {}
    for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
        if label != "FAULT" and (is_measured or not label.startswith("measured")):
            named[label] = handle
    ax.legend(named.values(), named, loc="lower right", ncols=4, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)


def _draw(ax: "Axes", panel: Band, at: np.ndarray, edges: np.ndarray, name: str) -> None:
    """Draw a band of that name and its samples: one by one, or the extremes of bins.

    Args:
        at: the time of each bin. edges: the sample at which it starts.
    """
    lo, hi = _finite(panel.band.lo), _finite(panel.band.hi)
    lo, hi = (np.where(lo > hi, np.nan, end) for end in (lo, hi))  # nothing is left
    faulty = panel.faulty
    y = panel.y
    if y is None:
        y = np.full(len(faulty), np.nan)
    # all that a bin allows at some sample of it
    lo, hi = np.fmin.reduceat(lo, edges), np.fmax.reduceat(hi, edges)
    shade(ax, at, np.maximum.reduceat(faulty, edges))
    ax.fill_between(at, lo, hi, color=ENVELOPE, alpha=0.35, lw=0, label=name)
    for edge in (lo, hi):
        ax.plot(at, edge, color="#0072b2", lw=0.6, alpha=0.8)
    healthy = _bin_extremes(np.where(faulty, np.nan, y), edges)
    wrong = _bin_extremes(np.where(faulty, y, np.nan), edges)
    # bins have two ends, samples are points
    if len(y) > len(edges):
        ax.fill_between(at, *healthy, color="#57606a", lw=0.5, alpha=0.7, label="measured")
        ax.fill_between(at, *wrong, color=FAULTY, lw=1.2, label="measured, faulty")
    else:
        ax.plot(at, healthy[0], color="#57606a", lw=0.8, marker=".", ms=2.5, label="measured")
        ax.plot(at, wrong[0], color=FAULTY, ls="", marker="x", ms=4, label="measured, faulty")
    if panel.middle is not None:
        centre = (_finite(panel.middle.lo) + _finite(panel.middle.hi)) / 2
        least, most = _bin_extremes(np.where(faulty | np.isnan(y), centre, np.nan), edges)
        ax.plot(at, (least + most) / 2, color=INK, lw=1.3, label="corrected")
    _limits(ax, lo, hi, np.concatenate(_bin_extremes(y, edges)))
    ax.grid(color=GRID, lw=0.7)


def _bin_extremes(y: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (least, most) of the samples of each bin."""
    return np.fmin.reduceat(y, edges), np.fmax.reduceat(y, edges)


def _finite(ends: ArrayLike) -> np.ndarray:
    """Return the ends of a band with NaN where it has none."""
    return np.where(np.isfinite(ends), ends, np.nan)


def _limits(ax: "Axes", lo: np.ndarray, hi: np.ndarray, y: np.ndarray) -> None:
    """Set limits that a band of the first samples, or one huge sample, does not spoil."""
    seen = np.isfinite(lo) & np.isfinite(hi)
    if not seen.any():
        return
    # the first bands are wide, since nothing is known yet: they may leave the picture
    bottom, top = float(np.quantile(lo[seen], 0.01)), float(np.quantile(hi[seen], 0.99))
    width = max(top - bottom, 1e-300)
    y = y[np.isfinite(y)]
    if len(y):
        least, most = float(y.min()), float(y.max())
        # a sample beyond two widths of the band may leave it as well
        bottom, top = max(min(bottom, least), bottom - 2 * width), min(max(top, most), top + 2 * width)
    pad = 0.06 * (top - bottom)
    ax.set_ylim(bottom - pad, top + pad)
