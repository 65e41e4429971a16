"""The picture of residuals: each with the interval that healthy sensors inside their bounds allow."""

from typing import TYPE_CHECKING

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.result import Result
from jaxbound.plots.canvas import (
    BOTTOM,
    ENVELOPE,
    FAULTY,
    GRID,
    INK,
    PANELS,
    SAMPLES,
    bins,
    finish,
    shade,
    stacked,
    style,
    thinning,
    time_axis,
    time_of,
)
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["distinct_relations", "plot_residuals"]

PANEL, BETWEEN, TOP = 1.5, 0.55, 1.0  # inches: of a panel, between two, and above all of them
TITLE = 125  # characters of a relation


def plot_residuals(res: Result, time: np.ndarray | None = None) -> "Figure":
    """Draw every residual with the interval that healthy sensors inside their bounds allow, FAULT windows
    shaded.

    Windows can be FAULT with every residual inside: the joint test sees more than each residual alone.

    Args:
        res, time: as for `plot`. Of long recordings, the worst window of each bin is drawn, and how much of
            its envelope each residual uses (above 1: outside).

    Returns:
        A matplotlib Figure with one panel a residual, at most 12.

    Raises:
        ValueError: as `plot`. TypeError: the Result of an observer. NotImplementedError: residuals
            without intervals, as a user's own.
    """
    relations = res.relations
    if relations.remembers:
        raise TypeError(
            "only parity relations have an interval for each residual: plot(res.observation, y=res.y) draws "
            "an observer's bands"
        )
    x, label, dates = time_axis(time_of(res, time))
    thinned = len(x) > SAMPLES
    picked = np.arange(len(x))
    if thinned:
        picked = _worst(res)
    # a window across a gap has a residual, but it says nothing
    missing = (res.status[picked] == Status.MISSING)[:, None]
    external, lo, hi = (np.where(missing, np.nan, form) for form in _forms(relations, res.u, res.y, picked))
    fault = np.maximum.reduceat(res.status, bins(len(x))) == Status.FAULT
    distinct = distinct_relations(relations)
    shown, lines = distinct[:PANELS], relations.text().splitlines()
    height = TOP + BOTTOM + PANEL * len(shown) + BETWEEN * (len(shown) - 1)

    with style():
        fig, axes = stacked(len(shown), (11, height), [1] * len(shown))
        for j, ax in zip(shown, axes, strict=True):
            shade(ax, x[picked], fault)
            _draw(ax, x[picked], external[:, j], lo[:, j], hi[:, j], thinned)
            ax.set_title(_cut(lines[j]), fontsize=9.5, parse_math=False)
        title = _title(relations, len(distinct)) + thinning(len(x), len(picked), "the worst window")
        fig.text(0.012, 1 - 0.3 / height, title, fontsize=10.5, color=INK, parse_math=False)
        handles, labels = axes[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="upper right", ncols=3, bbox_to_anchor=(0.93, 1 - 0.34 / height))
        finish(fig, axes, x[picked], label, dates, top=TOP, gap=BETWEEN / PANEL)
    return fig


def _draw(
    ax: "Axes", at: np.ndarray, value: np.ndarray, lo: np.ndarray, hi: np.ndarray, thinned: bool
) -> None:
    """Draw one residual and its envelope; of a thinned recording the share of the envelope that it uses."""
    name = "residual"
    if thinned:  # neighbours have nothing to do with each other: lines between them would be a thicket
        value = abs(value - (lo + hi) / 2) / ((hi - lo) / 2)
        lo, hi = np.zeros(len(at)), np.ones(len(at))
        name = "share of the envelope that the residual uses"
    ax.fill_between(at, lo, hi, color=ENVELOPE, alpha=0.35, lw=0, label="allowed by the bounds")
    for edge in (lo, hi):
        ax.plot(at, edge, color="#0072b2", lw=0.6, alpha=0.8)
    ax.plot(at, value, color=INK, lw=1.0, label=name)
    ax.grid(color=GRID, lw=0.7)
    beyond = _robust_limits(ax, value, lo, hi)
    if beyond:
        corner = ax.text(0.995, 0.99, f"{beyond} beyond the axis", fontsize=8.5, color=FAULTY)
        corner.set(ha="right", va="top", transform=ax.transAxes)


def _cut(line: str) -> str:
    """Return a relation as the title of a panel."""
    if len(line) <= TITLE:
        return line
    return line[: TITLE - 3] + " ..."


def _title(relations: Relations, distinct: int) -> str:
    """Return the title of a picture of so many distinct relations."""
    title = f"Residuals of {relations.model.name}"
    if distinct < relations.count:
        title += f", {distinct} of {relations.count}: the others are these, some samples earlier"
    if distinct > PANELS:
        title += f"; the first {PANELS} are shown"
    return title


def distinct_relations(relations: Relations) -> list[int]:
    """Return the indices of the relations that are not merely an earlier copy of another one."""
    if relations.linear is None:
        return list(range(relations.count))
    relations = relations.linear
    model, last = relations.model, {}
    count = (relations.horizon + 1) * model.p
    for j, (h, k) in enumerate(zip(relations.W, relations.K, strict=True)):
        disturbances = h[count : count + model.g * relations.horizon]
        parts = ((h[:count], model.p), (disturbances, model.g), (k, model.m))
        first = min(i // width for row, width in parts for i, x in enumerate(row) if x)
        shifted = [[(i - first * width, x) for i, x in enumerate(row) if x] for row, width in parts]
        last[tuple(map(tuple, shifted))] = j
    return sorted(last.values())


def _worst(res: Result) -> np.ndarray:
    """Return the index of the worst window of each bin: FAULT first, then the smallest margin."""
    key = np.where(np.isnan(res.margin), np.inf, res.margin) - np.where(res.status == Status.FAULT, 1e18, 0)
    edges = np.append(bins(len(key)), len(key))
    return np.array([a + int(np.argmin(key[a:b])) for a, b in zip(edges[:-1], edges[1:], strict=True)])


def _forms(relations: Relations, u: np.ndarray, y: np.ndarray, picked: np.ndarray) -> list[np.ndarray]:
    """Return residuals and envelopes (M, count) of the windows that end at the picked samples, in one padded
    stretch of fixed length.
    """
    s = relations.horizon
    rows, keep = picked, slice(0, len(picked))
    if len(picked) < len(y):  # each window by itself, one behind the other
        rows = (np.maximum(picked, s)[:, None] + np.arange(-s, 1)).ravel()
        keep = slice(s, len(rows), s + 1)
    u, y = _padded(u[rows]), _padded(y[rows])
    envelope = relations.internal(u, y)
    return [np.asarray(x)[keep] for x in (relations.external(u, y), envelope.lo, envelope.hi)]


def _padded(x: np.ndarray) -> np.ndarray:
    """Return samples filled up with NaN to a length that is compiled once."""
    return np.concatenate([x, np.full((max(SAMPLES - len(x), 0), x.shape[1]), np.nan, x.dtype)])


def _robust_limits(ax: "Axes", external: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> int:
    """Set limits that one huge residual does not spoil; return how many windows lie beyond them."""
    seen = np.isfinite(external) & np.isfinite(lo) & np.isfinite(hi)
    if not seen.any():
        return 0
    bottom, top = float(np.quantile(lo[seen], 0.002)), float(np.quantile(hi[seen], 0.998))
    width = max(top - bottom, 1e-300)
    least, most = float(external[seen].min()), float(external[seen].max())
    bottom, top = max(min(bottom, least), bottom - width), min(max(top, most), top + width)
    pad = 0.06 * (top - bottom)
    ax.set_ylim(bottom - pad, top + pad)
    return int(((external[seen] < bottom) | (external[seen] > top)).sum())
