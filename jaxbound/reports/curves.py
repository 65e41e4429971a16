"""Charts of shares against sizes and delays: curves with intervals as paths for the templates, in the units
of `chart`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxbound.reports.chart import HEIGHT, WIDTH

__all__ = ["Curve", "share_chart"]

BOTTOM, TOP = -0.03, 1.05  # of a chart of shares
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Curve:
    """A share over something. Fields: name; kind: how it looks; x, share (n,); low, high (n,): its interval,
    or None: a staircase.
    """

    name: str
    kind: str
    x: np.ndarray
    share: np.ndarray
    low: np.ndarray | None = None
    high: np.ndarray | None = None


def share_chart(
    title: str,
    label: str,
    curves: Sequence[Curve],
    ticks: Sequence[tuple[float, str]],
    ends: tuple[float, float],
    guaranteed: float = np.inf,
) -> dict[str, Any]:
    """Return what the macro `shares` shows.

    Args:
        title, label: above it, and below its axis. curves: of shares. ticks: (x, text). ends: of the axis.
            guaranteed: x of a line.
    """
    first, last = ends
    across = lambda x: (np.asarray(x, float) - first) / ((last - first) or 1.0) * WIDTH
    down = lambda share: (TOP - np.clip(np.nan_to_num(share), 0, 1)) / (TOP - BOTTOM) * HEIGHT
    drawn = [{"name": c.name, "kind": c.kind, **_paths(c, across(c.x), down)} for c in curves]
    return {
        "title": title,
        "label": label,
        "curves": drawn,
        "ticks": [{"left": float(across(x)) / WIDTH * 100, "text": text} for x, text in ticks],
        "marks": [{"top": float(down(v)), "text": f"{v:g}"} for v in SHARES],
        "guaranteed": float(across(guaranteed)) if first <= guaranteed <= last else None,
    }


def _paths(curve, across, down):
    """Return the line of a Curve, its points, and the bars of their intervals."""
    level = down(curve.share)
    points = list(zip(across.tolist(), level.tolist(), strict=True))
    if curve.low is None:
        line = "".join(f"{f'H{x:.1f}V' if i else f'M{x:.1f} '}{y:.1f}" for i, (x, y) in enumerate(points))
        return {"line": line, "dots": "", "bars": ""}
    bars = zip(across.tolist(), down(curve.low).tolist(), down(curve.high).tolist(), strict=True)
    return {
        "line": "".join(f"{'L' if i else 'M'}{x:.1f} {y:.1f}" for i, (x, y) in enumerate(points)),
        "dots": "".join(f"M{x:.1f} {y:.1f}h0" for x, y in points),
        "bars": "".join(f"M{x:.1f} {a:.1f}V{b:.1f}" for x, a, b in bars),
    }
