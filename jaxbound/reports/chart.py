"""The charts of a report: signals, margin and violated combination over time, as paths for its templates and
as numbers for its script.

The whole recording is there in at most `VALUES` numbers (extremes of bins where it is longer), and a stretch
around each of the deepest alarms sample by sample: so a page has a size that does not grow with the
recording.
"""

import base64
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxbound.reports.clock import Clock, ticks
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval

__all__ = ["Piece", "Row", "band_key", "coded", "drawn", "even_marks", "piece_of", "pieces_of", "plain"]

VALUES = 80_000  # numbers of the whole recording in a page
POINTS = 1000  # of a line that is drawn
WIDTH, HEIGHT = 1000, 100  # of a chart, in its own units
FAR = 10.0  # how far a chart of a combination reaches, in what the bounds allow
ENCLOSED = ("band", "faulty", "instead")
HUGE = 1e150  # a number that is drawn
SPREAD = 0.02  # share of the ends of a band that its chart need not show, at either side
GAP = 2.5  # usual steps between two points that are not joined


@dataclass(frozen=True)
class Row:
    """One chart below the others.

    Fields: key: of its numbers; name; unit; kind: "signal", "margin", "combination" or "enclosed": a signal
    with key:band, the ends of what holds its true value, key:faulty, its samples that are proved to be wrong,
    and key:instead, what is to be used in their place.
    """

    key: str
    name: str
    unit: str = ""
    kind: str = "signal"


@dataclass(frozen=True)
class Piece:
    """A stretch of a recording: x (n,) s; status (n,), the worst of each bin; low, high: {key: (n,)},
    extremes of each bin.

    binned: whether a point is a bin, from its x to the next; else it is a sample.
    """

    x: np.ndarray
    status: np.ndarray
    low: dict
    high: dict
    binned: bool = False

    def reduced(self, most: int) -> "Piece":
        """Return the same stretch as the extremes of at most so many bins."""
        if len(self.x) <= most:
            return self
        edges = np.linspace(0, len(self.x), most, endpoint=False).astype(int)
        low = {key: np.fmin.reduceat(z, edges) for key, z in self.low.items()}
        high = {key: np.fmax.reduceat(z, edges) for key, z in self.high.items()}
        return Piece(self.x[edges], np.maximum.reduceat(self.status, edges), low, high, True)

    def cut(self, first: int, stop: int) -> "Piece":
        """Return the points first .. stop - 1."""
        take = lambda z: {key: value[first:stop] for key, value in z.items()}
        return Piece(
            self.x[first:stop], self.status[first:stop], take(self.low), take(self.high), self.binned
        )


def pieces_of(
    x: np.ndarray,
    status: np.ndarray,
    series: Mapping[str, np.ndarray],
    bands: Mapping[str, Interval] | None = None,
) -> Piece:
    """Return the Piece of a whole recording, in no more numbers than a page takes. series: {key: (T,)};
    bands: of `band_key`s.
    """
    exact = piece_of(x, status, series, bands)
    numbers = len(series) + 2 * len(bands or {})
    return exact if len(x) * numbers <= VALUES else exact.reduced(VALUES // (2 * numbers))


def piece_of(
    x: np.ndarray,
    status: np.ndarray,
    series: Mapping[str, np.ndarray],
    bands: Mapping[str, Interval] | None = None,
) -> Piece:
    """Return a stretch sample by sample; series, bands as of `pieces_of`: none where nothing is known, or
    nothing left (lo > hi).
    """
    there = lambda band: (
        np.isfinite(band.lo) & np.isfinite(band.hi) & (np.asarray(band.lo) <= np.asarray(band.hi))
    )
    low, high = (
        {key: np.where(there(band), getattr(band, end), np.nan) for key, band in (bands or {}).items()}
        for end in ("lo", "hi")
    )
    return Piece(np.asarray(x, float), np.asarray(status), {**series, **low}, {**series, **high})


def band_key(key: str) -> str:
    """Return the key of the band that is drawn behind the row with a key."""
    return f"{key}:{ENCLOSED[0]}"


def drawn(rows: Sequence[Row], piece: Piece, clock: Clock, marked: Sequence[float] = ()) -> dict[str, Any]:
    """Return what the macro `chart` shows of a Piece: paths, limits, ticks. marked: times to be marked above,
    in s.
    """
    points = piece.reduced(POINTS)
    first, last = float(points.x[0]), float(points.x[-1])
    across = (points.x - first) / ((last - first) or 1.0) * WIDTH
    joined = (
        np.diff(across, prepend=across[:1]) <= GAP * np.median(np.diff(across))
        if len(across) > 2
        else np.ones(len(across), bool)
    )
    fault = points.status == Status.FAULT
    axis = _Axis(across, joined, points.binned)
    panels = [
        _panel(row, points, axis, fault)
        for row in rows
        if row.key in points.low or band_key(row.key) in points.low
    ]
    at = [
        {"left": 100 * (x - first) / ((last - first) or 1.0), "text": text}
        for x, text in ticks(clock, first, last)
    ]
    ribbon = {status.name: axis.spans(points.status == status) for status in Status}
    marks = sorted({round(100 * (x - first) / ((last - first) or 1.0), 2) for x in marked})
    return {
        "panels": panels,
        "binned": points.binned,
        "ticks": at,
        "marked": marks,
        "ribbon": ribbon,
        "from": clock.text(first),
        "to": clock.text(last),
    }


class _Axis:
    """Points across a chart and what is drawn at them.

    across (n,): where each sample is, or each bin begins; joined (n,): to the one before; bins: whether they
    are bins.
    """

    def __init__(self, across, joined, bins):
        self.across, self.joined, self.bins = across, joined, bins
        self.half = np.median(np.diff(across)) / 2 if len(across) > 1 else WIDTH / 2

    def line(self, low, high):
        """Return the path of a line through samples, or of the area between the extremes of bins."""
        if self.bins:
            return self.area(low, high)
        out = []
        for first, stop in self._stretches(np.isfinite(low)):
            places = zip(self.across[first:stop].tolist(), low[first:stop].tolist(), strict=True)
            there = [f"{_number(x)} {_number(y)}" for x, y in places]
            out.append(f"M{'L'.join(there)}" if len(there) > 1 else f"M{there[0]}h0")
        return "".join(out)

    def area(self, low, high):
        """Return the path of the areas between two lines, in steps where they are extremes of bins."""
        out = []
        for first, stop in self._stretches(np.isfinite(low) & np.isfinite(high)):
            x, lower, upper = (z[first:stop].tolist() for z in (self.across, low, high))
            if self.bins:
                edges = [*x, min(x[-1] + 2 * self.half, WIDTH)]
                steps = (*zip(upper, edges[1:], strict=True), *zip(lower[::-1], x[::-1], strict=True))
                there = "".join(f"V{_number(y)}H{_number(to)}" for y, to in steps)
                out.append(f"M{_number(x[0])} {there.removeprefix('V')}Z")
            else:
                corners = (*zip(x, upper, strict=True), *zip(x[::-1], lower[::-1], strict=True))
                out.append(f"M{'L'.join(f'{_number(i)} {_number(j)}' for i, j in corners)}Z")
        return "".join(out)

    def dots(self, on, down):
        """Return the path of dots at the points that are on, in the middle of their bins."""
        across = self.across[on] + self.half * self.bins
        return "".join(
            f"M{_number(x)} {_number(y)}h0" for x, y in zip(across.tolist(), down[on].tolist(), strict=True)
        )

    def spans(self, on):
        """Return the path of boxes of full height over the points that are on."""
        before, after = (0.0, 2 * self.half) if self.bins else (self.half, self.half)
        out = []
        for run in _runs(on):
            left, right = max(self.across[run][0] - before, 0.0), min(self.across[run][-1] + after, WIDTH)
            out.append(f"M{left:.2f} 0H{right:.2f}V{HEIGHT}H{left:.2f}Z")
        return "".join(out)

    def _stretches(self, on):
        """Yield (first, stop) of the points that are on and joined."""
        edges = np.flatnonzero(on & ~self.joined)
        for run in _runs(on):
            yield from itertools.pairwise(
                [run.start, *edges[(edges > run.start) & (edges < run.stop)], run.stop]
            )


def _panel(row, points, axis, fault):
    nothing = np.full(len(points.x), np.nan)
    ends_of = lambda key: (
        np.clip(np.asarray(z.get(key, nothing), float), -HUGE, HUGE) for z in (points.low, points.high)
    )
    if row.kind == "enclosed":
        return _enclosed(
            row, axis, *map(list, map(ends_of, (row.key, *(f"{row.key}:{what}" for what in ENCLOSED))))
        )
    low, high = ends_of(row.key)
    least, most = ends_of(band_key(row.key))
    if row.kind == "margin":
        low, high = squeezed(low), squeezed(high)
    bottom, top = _limits(row, np.concatenate([low, _usual(least)]), np.concatenate([high, _usual(most)]))
    beyond = (abs(low) > 1) | (abs(high) > 1)  # windows that this combination proves, not all that are FAULT
    shaded = {"combination": beyond, "margin": fault, "signal": fault}[row.kind]
    peak = np.where(abs(high) > abs(low), high, low) if row.kind == "combination" else low
    out = shaded & np.isfinite(low) & (row.kind != "signal")
    band = [float(_down(v, bottom, top)) for v in (1.0, -1.0)] if row.kind == "combination" else None
    hull = (
        axis.area(_down(least, bottom, top), _down(most, bottom, top))
        if band_key(row.key) in points.low
        else None
    )
    return {
        "row": row,
        "line": axis.line(_down(low, bottom, top), _down(high, bottom, top)),
        "binned": axis.bins,
        "band": band,
        "shade": axis.spans(shaded),
        "out": axis.dots(out, _down(peak, bottom, top)),
        "hull": hull,
        "instead": "",
        "marks": _places(row, bottom, top),
        "empty": not (np.isfinite(low).any() or hull),
    }


def _places(row, bottom, top):
    return [{"top": float(_down(v, bottom, top)), "text": text} for v, text in _marks(row, bottom, top)]


def _enclosed(row, axis, shown, band, faulty, instead):
    """Return what is drawn of a signal and of the band that holds its true value: [lowest, highest] of
    each.
    """
    known = np.isfinite(band[0]) & np.isfinite(band[1])
    least, most = robust_limits(*shown)
    if known.any():  # a band of the first samples, or one huge sample, spoils nothing
        lo, hi = float(np.quantile(band[0][known], 0.01)), float(np.quantile(band[1][known], 0.99))
        wide = max(hi - lo, 1e-9 * max(abs(lo), abs(hi)), 1e-300)
        lowest, highest = (np.fmin.reduce(shown[0], initial=lo), np.fmax.reduce(shown[1], initial=hi))
        least, most = max(lowest, lo - 2 * wide) - 0.06 * wide, min(highest, hi + 2 * wide) + 0.06 * wide
    down = lambda ends: (_down(ends[0], least, most), _down(ends[1], least, most))
    wrong = np.isfinite(faulty[0])
    lower, upper = down(faulty)
    out = axis.dots(wrong, lower) + axis.dots(wrong & (upper != lower), upper)
    return {
        "row": row,
        "line": axis.line(*down(shown)),
        "binned": axis.bins,
        "band": None,
        "shade": axis.spans(wrong),
        "out": out,
        "hull": axis.area(*down(band)),
        "instead": axis.line(*down(instead)),
        "marks": _places(row, least, most),
        "empty": not (known.any() or np.isfinite(shown[0]).any()),
    }


def _limits(row, low, high):
    """Return (bottom, top) of a chart."""
    if row.kind == "signal":
        return robust_limits(low, high)
    least, most = (float(end(z[np.isfinite(z)], initial=0.0)) for end, z in ((np.min, low), (np.max, high)))
    if row.kind == "margin":
        return least - 0.08, 1.06
    reach = min(max(-least, most, 1.2), FAR)
    return -1.08 * reach, 1.08 * reach


def squeezed(margin: np.ndarray) -> np.ndarray:
    """Return margins with those below -1 on a logarithmic scale: -10 becomes -2, -100 becomes -3."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(margin < -1, -1 - np.log10(np.minimum(-np.maximum(margin, -1e15), 1e15)), margin)


def robust_limits(low: np.ndarray, high: np.ndarray) -> tuple[float, float]:
    """Return (bottom, top) of a chart that one huge value does not spoil."""
    low, high = low[np.isfinite(low)], high[np.isfinite(high)]
    if not len(low) or not len(high):
        return 0.0, 1.0
    bottom, top = float(np.quantile(low, 0.002)), float(np.quantile(high, 0.998))
    reach = max((top - bottom) / 2, 1e-9 * max(abs(bottom), abs(top)), 1e-300)
    bottom, top = max(float(low.min()), bottom - reach), min(float(high.max()), top + reach)
    pad = 0.06 * (top - bottom) or abs(top) * 0.01 or 1.0
    return bottom - pad, top + pad


def _down(value, bottom, top):
    """Return places on a chart, counted from its top."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.clip((top - value) / (top - bottom), 0, 1) * HEIGHT


def _marks(row, bottom, top):
    """Return the lines across a chart: (value, text)."""
    if row.kind == "combination":
        return [(1.0, "1"), (-1.0, "-1")] if top > 4 else [(1.0, "1"), (0.0, "0"), (-1.0, "-1")]
    if row.kind == "margin":
        powers = range(max(int(-bottom), 0))
        return [
            (1.0, "1"),
            (0.0, "0"),
            *((-1.0 - n, f"-{10.0**n:g}") for n in powers[:: 1 + len(powers) // 5]),
        ]
    return even_marks(bottom, top)


def even_marks(bottom: float, top: float) -> list[tuple[float, str]]:
    """Return two to five round numbers between two, with their texts."""
    step = 10.0 ** np.floor(np.log10((top - bottom) / 2))
    step *= next(n for n in (5, 2, 1) if n == 1 or (top - bottom) / (n * step) >= 2)
    return [
        (n * step, f"{n * step:.6g}")
        for n in range(int(np.ceil(bottom / step)), int(np.floor(top / step)) + 1)
    ]


def _number(x):
    return f"{x:.1f}".removesuffix(".0")


def _usual(ends):
    """Return the ends of a band without its widest, as it begins."""
    seen = ends[np.isfinite(ends)]
    return (
        seen[(np.quantile(seen, SPREAD) <= seen) & (seen <= np.quantile(seen, 1 - SPREAD))]
        if len(seen)
        else seen
    )


def _runs(on):
    """Return slices of the stretches that are on."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(on, np.int8), [0]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def plain(piece: Piece) -> dict[str, Any]:
    """Return a Piece as JSON has it: numbers as base64 of float32, times as (first, step) where they are
    even.
    """
    step = np.diff(piece.x)
    even = len(step) == 0 or np.allclose(step, step[0], rtol=0, atol=1e-3 * abs(step[0]))
    x = [float(piece.x[0]), float(step[0]) if len(step) else 1.0] if even else coded(piece.x, "<f8")
    both = {
        key: [coded(piece.low[key])] + ([] if piece.high[key] is piece.low[key] else [coded(piece.high[key])])
        for key in piece.low
    }
    return {
        "n": len(piece.x),
        "binned": piece.binned,
        "x": x,
        "status": "".join(map(str, piece.status.tolist())),
        "series": both,
    }


def coded(values: np.ndarray, kind: str = "<f4") -> str:
    """Return numbers as base64 of a float type."""
    with np.errstate(over="ignore"):
        return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode()
