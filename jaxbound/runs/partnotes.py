"""The metadata of a part of the verdicts: how signals stand still, their extremes, how many windows were
judged again.
"""

import base64
import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.plots.canvas import PANELS, bins, inside
from jaxbound.recordings.stillness import Run, Runs, follow, joined

__all__ = ["AGAIN", "EXTREMES", "RUNS", "Noted", "read_again", "read_extremes", "read_runs"]

NONE = '{"bin": 0, "low": [], "high": []}'  # an earlier jaxbound noted no extremes
RUNS, EXTREMES, AGAIN = b"runs", b"extremes", b"again"


class Noted:
    """The notes on signals of one recording.

    Args:
        samples: how many it has. model: with m inputs and p outputs.
    """

    def __init__(self, samples: int, model: Any) -> None:
        self.edges = bins(samples)
        outputs, inputs = range(model.m, model.m + model.p), range(model.m)
        self.shown = [*outputs, *inputs][:PANELS]  # in the order of a page

    def of(self, first: int, signals: np.ndarray) -> dict[bytes, str]:
        """Return {name: JSON} of the samples from number `first` on.

        Args:
            first: its number. signals: (n, k) inputs, outputs and, if the model has `where`, 1 where that
                holds.
        """
        runs = [follow(Runs(first), np.ascontiguousarray(x)) for x in signals.T]
        begun, _, edges = inside(self.edges, first, len(signals))
        extremes: dict[str, Any] = {"bin": begun, "low": [], "high": []}
        for i in self.shown:
            extremes["low"].append(_coded(np.fmin.reduceat(signals[:, i], edges)))
            extremes["high"].append(_coded(np.fmax.reduceat(signals[:, i], edges)))
        still = json.dumps([asdict(of) for of in runs], default=np.ndarray.tolist)
        return {RUNS: still, EXTREMES: json.dumps(extremes)}


def _coded(x):
    with np.errstate(over="ignore"):
        return base64.b64encode(x.astype("<f4").tobytes()).decode()


def read_runs(parts: Iterable[Path]) -> list[Runs]:
    """Return the Runs (`stillness`) of all parts: of inputs, outputs and, if the model has `where`, of 1
    where it holds.
    """

    def runs(counts, longest, last, first, **rest):
        one = lambda run: Run(*run) if run else None
        return Runs(
            counts=np.array(counts),
            longest=tuple(map(one, longest)),
            last=one(last),
            first=one(first),
            **rest,
        )

    notes = (json.loads(found[RUNS]) for found in map(_metadata, parts))
    return [
        reduce(joined, signal)
        for signal in zip(*([runs(**found) for found in note] for note in notes), strict=True)
    ]


def read_extremes(parts: Iterable[Path], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (low, high): (k, bins) extremes of the signals that a page shows, outputs first, NaN where
    samples are missing.

    Args:
        parts: all of a recording, in order. samples: how many it has.
    """
    low, high = np.full((2, PANELS, len(bins(samples))), np.nan)
    count = 0
    for note in map(_metadata, parts):
        found = json.loads(note.get(EXTREMES, NONE))
        for whole, name, least in ((low, "low", np.fmin), (high, "high", np.fmax)):
            for i, text in enumerate(found[name]):
                x = np.frombuffer(base64.b64decode(text), "<f4")
                here = slice(found["bin"], found["bin"] + len(x))
                whole[i, here] = least(whole[i, here], x)
        count = len(found["low"])
    return low[:count], high[:count]


def read_again(parts: Iterable[Path]) -> dict[str, int]:
    """Return {devices that judged: how many of their windows were decided again on the CPU}; see
    `diagnosis.again`.
    """
    found: Counter = Counter()
    for note in map(_metadata, parts):
        found.update(json.loads(note.get(AGAIN, "{}")))
    return dict(found)


def _metadata(part):
    import pyarrow.parquet as pq

    return pq.read_schema(part).metadata
