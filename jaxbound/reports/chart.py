"""The numbers of the charts of a page: what its script draws, and a picture for readers without scripts.

The whole recording is there in at most `VALUES` numbers (extremes of bins where it is longer), and stretches
of it sample by sample: so a page has a size that does not grow with the recording.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxbound.plots.canvas import to_png
from jaxbound.reports.clock import AxisClock
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.characters import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VALUES = 80_000  # numbers of the whole recording in a page
DPI = 80  # of the picture for readers without scripts


@dataclass(frozen=True)
class ChartRow:
    """One chart below the others.

    Fields: key: of its numbers; name; unit; kind: "signal", "margin", "combination" or "enclosed"; steps:
    whether a sample holds until the next one; training: an input's ends there, None: not stated.
    A key:band is drawn behind a chart. "enclosed": a signal with
    key:faulty, its samples that are proved to be wrong, and key:instead, what is to be used in their place.
    """

    key: str
    name: str
    unit: str = ""
    kind: str = "signal"
    steps: bool = False
    training: tuple[float, float] | None = None


@dataclass(frozen=True)
class ChartPiece:
    """A stretch of a recording: x (n,) s; status (n,), the worst of each bin; low, high: {key: (n,)},
    extremes of each bin.

    binned: whether a point is a bin, from its x to the next; else it is a sample.
    """

    x: np.ndarray
    status: np.ndarray
    low: dict[str, np.ndarray]
    high: dict[str, np.ndarray]
    binned: bool = False

    def reduced(self, most: int) -> "ChartPiece":
        """Return the same stretch as the extremes of at most so many bins."""
        if len(self.x) <= most:
            return self
        edges = np.linspace(0, len(self.x), most, endpoint=False).astype(int)
        low = {key: np.fmin.reduceat(z, edges) for key, z in self.low.items()}
        high = {key: np.fmax.reduceat(z, edges) for key, z in self.high.items()}
        return ChartPiece(self.x[edges], np.maximum.reduceat(self.status, edges), low, high, True)

    def fitting(self) -> "ChartPiece":
        """Return the same stretch in no more numbers than a page takes."""
        twice = [key for key, high in self.high.items() if high is not self.low[key]]
        if len(self.x) * (len(self.low) + len(twice)) <= VALUES:
            return self
        return self.reduced(VALUES // (2 * len(self.low)))

    def cut(self, first: int, stop: int) -> "ChartPiece":
        """Return the points first .. stop - 1."""
        part = slice(first, stop)
        low = {key: z[part] for key, z in self.low.items()}
        high = {key: z[part] for key, z in self.high.items()}
        return ChartPiece(self.x[part], self.status[part], low, high, self.binned)


@dataclass(frozen=True)
class Charts:
    """The charts of a page: of the whole recording, and closer ones that its script moves.

    Fields:
        rows: charts from top to bottom. clock: how times are written. samples: of the recording. last: time
            of the last one, in s. whole: a ChartPiece of all. near: stretches sample by sample, as `plain`
            returns them.
        begin, end: the time that is shown closer at first, in s. about: its place, in words. alarms: [number,
            begin, end, worst, in s] of each; alarm: the number of the one that is shown at first; -1: none.
    """

    rows: Sequence[ChartRow]
    clock: AxisClock
    samples: int
    last: float
    step: float
    whole: ChartPiece
    near: Sequence[Mapping[str, Any]]
    begin: float
    end: float
    about: str
    alarms: Sequence[Sequence[float]] = field(default=())
    alarm: int = -1

    @property
    def ends(self) -> tuple[str, str]:
        """Begin and end as texts."""
        return self.clock.text(self.begin), self.clock.text(self.end)

    def plain(self) -> dict[str, Any]:
        """Return the charts as JSON has them."""
        named = [
            asdict(row) | {"name": printable(row.name), "unit": printable(row.unit)} for row in self.rows
        ]
        return {
            "clock": self.clock.plain(),
            "rows": named,
            "samples": self.samples,
            "last": self.last,
            "step": self.step,
            "whole": plain(self.whole),
            "near": list(self.near),
            "alarms": self.alarms,
            "alarm": self.alarm,
            "from": self.begin,
            "to": self.end,
            "about": self.about,
        }


def piece_of(
    x: np.ndarray,
    status: np.ndarray,
    series: Mapping[str, np.ndarray],
    bands: Mapping[str, Interval] | None = None,
) -> ChartPiece:
    """Return a stretch sample by sample. series: {key: (T,)}; bands: of `band_key`s, not drawn where nothing
    is known, or nothing left (lo > hi).
    """
    low, high = dict(series), dict(series)
    for key, band in (bands or {}).items():
        lo, hi = np.asarray(band.lo), np.asarray(band.hi)
        there = np.isfinite(lo) & np.isfinite(hi) & (lo <= hi)
        low[key], high[key] = np.where(there, lo, np.nan), np.where(there, hi, np.nan)
    return ChartPiece(np.asarray(x, float), np.asarray(status), low, high)


def band_key(key: str) -> str:
    """Return the key of the band that is drawn behind the row with a key."""
    return f"{key}:band"


def plain(piece: ChartPiece) -> dict[str, Any]:
    """Return a ChartPiece as JSON has it: numbers as base64 of float32, times as (first, step) where they are
    even.
    """
    series = {}
    for key, low in piece.low.items():
        high = piece.high[key]
        ends = (low,) if high is low else (low, high)
        series[key] = [coded(end) for end in ends]
    return {
        "n": len(piece.x),
        "binned": piece.binned,
        "x": _times(piece.x),
        "status": "".join(map(str, piece.status.tolist())),
        "series": series,
        "combined": [],
    }


def _times(x: np.ndarray) -> list[float] | str:
    """Return times as JSON has them."""
    if len(x) == 1:
        return [float(x[0]), 1.0]
    step = np.diff(x)
    if np.allclose(step, step[0], rtol=0, atol=1e-3 * abs(step[0])):
        return [float(x[0]), float(step[0])]
    return coded(x, "<f8")


def median_step(x: np.ndarray) -> float:
    """Return the usual step of times (n,), 1 of a single one."""
    return float(np.median(np.diff(x))) if len(x) > 1 else 1.0


def coded(values: np.ndarray, kind: str = "<f4") -> str:
    """Return numbers as base64 of a float type."""
    with np.errstate(over="ignore"):
        return base64.b64encode(np.asarray(values).astype(kind).tobytes()).decode()


def picture_of(figure: "Figure") -> bytes:
    """Return a figure as PNG bytes."""
    return to_png(figure, DPI)
