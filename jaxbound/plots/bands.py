"""Pictures of validated outputs: the band that holds the true value, what the sensor showed, and what to use where it is faulty."""

import numpy as np

from jaxbound.plots.canvas import BINS, ENVELOPE, FAULTY, GRID, INK, SAMPLES, finish, shade, stacked, style, thinning, time_axis

__all__ = ["plot_output"]

NEAR = 600
"""Samples around the first fault of a long recording, drawn one by one below the whole."""


def plot_output(res, i, time):
    """Draw one output of a validated recording; the samples that are proved to be faulty are marked.

    Args:
        res: Validated. i: number of the output. time: (T,) seconds or datetime64.

    Returns:
        A matplotlib Figure. Of more than 5000 samples, the extremes of 1200 bins are drawn; a bin with one faulty sample is marked. Below
        are the 600 samples around the first faulty one.
    """
    x, label, dates = time_axis(time)
    count, name, unit = len(x), res.model.outputs[i], res.model.unit(res.model.outputs[i])
    faulty = np.asarray(res.found.faulty)[:, i]
    stretches = sum(j == i for j, *_ in res.stretches())
    total, es = int(faulty.sum()), "es" * (stretches > 1)
    many = f"{total} faulty sample{'s' * (total > 1)} in {stretches} stretch{es}" if stretches else "no faulty sample"
    with style():
        if count <= SAMPLES:
            fig, axes = stacked(1, (11, 3.6), [1])
            whole, near, title = np.arange(count), [], f"{name}: {many}"
        else:
            fig, axes = stacked(2, (11, 6.2), [1, 1], shared=False)
            whole = np.linspace(0, count, BINS, endpoint=False).astype(int)
            title = f"{name}: {many}{thinning(count, BINS, 'extremes')}"
            first = max(min(int(np.argmax(faulty)) - NEAR // 4, count - NEAR), 0)
            near = np.arange(first, first + NEAR)
            _draw(axes[1], res, i, x, near, near[-1] + 1)
            axes[1].set_title("The samples around the first faulty one" if stretches else "The first samples", pad=6)
        _draw(axes[0], res, i, x, whole, count)
        axes[0].set_title(title, pad=24, parse_math=False)
        drawn = dict(zip(*reversed(axes[0].get_legend_handles_labels()), strict=True))
        drawn.pop("FAULT", None)
        axes[0].legend(drawn.values(), drawn, loc="lower right", ncols=4, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        for ax in axes:
            ax.set_ylabel(f"{name} [{unit}]" if unit else name, parse_math=False)
        for ax, part in zip(axes, (x, x[near] if len(axes) > 1 else x), strict=False):
            finish(fig, [ax], part, label if ax is axes[-1] else "", dates, top=0.7, gap=0.36)
    return fig


def _draw(ax, res, i, x, edges, stop):
    """Draw the bins that start at the samples `edges`, one sample each or the extremes of many."""
    finite = lambda end: np.where(np.isfinite(end), end, np.nan)[:stop]
    lo, hi = (finite(np.asarray(end)[:, i]) for end in (res.found.output.lo, res.found.output.hi))
    lower, upper = (finite(np.asarray(end)[:, i]) for end in (res.found.corrected.lo, res.found.corrected.hi))
    y, faulty = res.y[:stop, i], np.asarray(res.found.faulty)[:stop, i]
    least, most = (lambda a: np.fmin.reduceat(a, edges)), (lambda a: np.fmax.reduceat(a, edges))
    at, lo, hi = x[edges], least(lo), most(hi)
    centre = np.where(faulty | np.isnan(y), (lower + upper) / 2, np.nan)
    healthy, wrong = np.where(faulty, np.nan, y), np.where(faulty, y, np.nan)
    shade(ax, at, np.maximum.reduceat(faulty, edges))
    ax.fill_between(at, lo, hi, color=ENVELOPE, alpha=0.35, lw=0, label="true value")
    for edge in (lo, hi):
        ax.plot(at, edge, color="#0072b2", lw=0.6, alpha=0.8)
    if stop - edges[0] > len(edges):
        ax.fill_between(at, least(healthy), most(healthy), color="#57606a", lw=0.5, alpha=0.7, label="measured")
        ax.fill_between(at, least(wrong), most(wrong), color=FAULTY, lw=1.2, label="measured, faulty")
    else:
        ax.plot(at, healthy[edges], color="#57606a", lw=0.8, marker=".", ms=2.5, label="measured")
        ax.plot(at, wrong[edges], color=FAULTY, ls="", marker="x", ms=4, label="measured, faulty")
    ax.plot(at, (least(centre) + most(centre)) / 2, color=INK, lw=1.3, label="corrected")
    _limits(ax, lo, hi, np.concatenate([least(y), most(y)]))
    ax.grid(color=GRID, lw=0.7)


def _limits(ax, lo, hi, y):
    """Set limits that a band of the first samples, or one huge sample, does not spoil."""
    seen = np.isfinite(lo) & np.isfinite(hi)
    if not seen.any():
        return
    bottom, top = float(np.quantile(lo[seen], 0.01)), float(np.quantile(hi[seen], 0.99))
    width = max(top - bottom, 1e-300)
    y = y[np.isfinite(y)]
    if len(y):
        bottom, top = max(min(bottom, float(y.min())), bottom - 2 * width), min(max(top, float(y.max())), top + 2 * width)
    pad = 0.06 * (top - bottom)
    ax.set_ylim(bottom - pad, top + pad)
