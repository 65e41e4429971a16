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

__all__ = ["Band", "draw_band", "draw_bands", "name_band", "one_of", "one_recording", "one_signal"]


class Band(NamedTuple):
    """One panel of a picture of bands: its title, and what `draw_band` takes, y None where nothing was
    measured.
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
            y = panel.y
            if y is None:
                y = np.full(count, np.nan)
            draw_band(ax, panel.band, y, panel.faulty, at, edges, count, panel.middle, name)
            ax.set_title(panel.title + thinned, pad=6, parse_math=False)
        if len(panels) > PANELS:
            more = f"; the first {PANELS} of {len(panels)} {what} are shown"
            axes[0].set_title(drawn[0].title + more + thinned, pad=6, parse_math=False)
        without = None
        if panels[0].y is None:
            without = "measured"
        name_band(axes[0], without)
        finish(fig, axes, at, label, dates, top=0.7, gap=0.36)
    return fig


def one_of(bands: Interval, i: int) -> Interval:
    """Return band i of bands (T, n)."""
    return Interval(np.asarray(bands.lo)[:, i], np.asarray(bands.hi)[:, i])


def one_signal(y: np.ndarray | None, i: int) -> np.ndarray | None:
    """Return the samples of one signal, None where there are none."""
    if y is None:
        return None
    return y[:, i]


def name_band(ax: "Axes", without: str | None = None) -> None:
    """Name the lines and areas above the axes; without the names that begin so."""
    handles, labels = ax.get_legend_handles_labels()
    drawn = dict(zip(labels, handles, strict=True))
    named = [name for name in drawn if name != "FAULT" and not (without and name.startswith(without))]
    ax.legend(
        [drawn[name] for name in named],
        named,
        loc="lower right",
        ncols=4,
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.2,
    )


def draw_band(
    ax: "Axes",
    band: Interval,
    y: np.ndarray,
    faulty: np.ndarray,
    x: np.ndarray,
    edges: np.ndarray,
    stop: int,
    middle: Interval | None = None,
    name: str = "by accepted samples",
) -> None:
    """Draw a band and the samples y of one signal, the bins that start at the samples `edges`, one sample
    each or the extremes of many.

    Args:
        band: (T,), infinite where nothing is known, lo > hi where nothing is left. y, faulty: (T,) samples,
            and which of them are marked.
        x: (T,) time. stop: the sample behind the last bin. middle: (T,), whose middle stands in where a
            sample is faulty or missing, or None. name: of the band.
    """
    lo, hi = (_finite(end)[:stop] for end in (band.lo, band.hi))
    lo, hi = (np.where(lo > hi, np.nan, end) for end in (lo, hi))  # nothing is left
    y, faulty = y[:stop], faulty[:stop]
    at, lo, hi = x[edges], np.fmin.reduceat(lo, edges), np.fmax.reduceat(hi, edges)
    healthy, wrong = np.where(faulty, np.nan, y), np.where(faulty, y, np.nan)
    shade(ax, at, np.maximum.reduceat(faulty, edges))
    ax.fill_between(at, lo, hi, color=ENVELOPE, alpha=0.35, lw=0, label=name)
    for edge in (lo, hi):
        ax.plot(at, edge, color="#0072b2", lw=0.6, alpha=0.8)
    if stop - edges[0] > len(edges):
        _fill(ax, at, healthy, edges, color="#57606a", lw=0.5, alpha=0.7, label="measured")
        _fill(ax, at, wrong, edges, color=FAULTY, lw=1.2, label="measured, faulty")
    else:
        ax.plot(at, healthy[edges], color="#57606a", lw=0.8, marker=".", ms=2.5, label="measured")
        ax.plot(at, wrong[edges], color=FAULTY, ls="", marker="x", ms=4, label="measured, faulty")
    if middle is not None:
        lower, upper = (_finite(end)[:stop] for end in (middle.lo, middle.hi))
        centre = np.where(faulty | np.isnan(y), (lower + upper) / 2, np.nan)
        drawn = (np.fmin.reduceat(centre, edges) + np.fmax.reduceat(centre, edges)) / 2
        ax.plot(at, drawn, color=INK, lw=1.3, label="corrected")
    _limits(ax, lo, hi, np.concatenate([np.fmin.reduceat(y, edges), np.fmax.reduceat(y, edges)]))
    ax.grid(color=GRID, lw=0.7)


def _finite(ends: ArrayLike) -> np.ndarray:
    """Return the ends of a band with NaN where it has none."""
    return np.where(np.isfinite(ends), ends, np.nan)


def _fill(
    ax: "Axes",
    at: np.ndarray,
    y: np.ndarray,
    edges: np.ndarray,
    color: str,
    lw: float,
    label: str,
    alpha: float | None = None,
) -> None:
    """Fill between the extremes of samples in each bin."""
    least, most = np.fmin.reduceat(y, edges), np.fmax.reduceat(y, edges)
    ax.fill_between(at, least, most, color=color, lw=lw, alpha=alpha, label=label)


def _limits(ax: "Axes", lo: np.ndarray, hi: np.ndarray, y: np.ndarray) -> None:
    """Set limits that a band of the first samples, or one huge sample, does not spoil."""
    seen = np.isfinite(lo) & np.isfinite(hi)
    if not seen.any():
        return
    bottom, top = float(np.quantile(lo[seen], 0.01)), float(np.quantile(hi[seen], 0.99))
    width = max(top - bottom, 1e-300)
    y = y[np.isfinite(y)]
    if len(y):
        least, most = float(y.min()), float(y.max())
        bottom, top = max(min(bottom, least), bottom - 2 * width), min(max(top, most), top + 2 * width)
    pad = 0.06 * (top - bottom)
    ax.set_ylim(bottom - pad, top + pad)
