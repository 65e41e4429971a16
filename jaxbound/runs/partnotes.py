"""The metadata of a part of the verdicts: runs and extremes of signals, the device that judged."""

import base64
import json
from collections.abc import Iterable
from dataclasses import asdict
from functools import reduce
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.plots.canvas import PANELS, bins, inside
from jaxbound.recordings.factors import known
from jaxbound.recordings.stillness import Run, Runs, follow_runs, joined_runs
from jaxbound.runs.counts import CountsByTest

RUNS, EXTREMES, DEVICE, TESTS = b"runs", b"extremes", b"device", b"tests"


class Noted:
    """The notes on signals of one recording.

    Args:
        samples: how many it has. relations: that are tested.
    """

    def __init__(self, samples: int, relations: Relations) -> None:
        self.edges, self.relations, model = bins(samples), relations, relations.model
        columns = len(known(model))
        outputs, inputs = range(columns, columns + model.p), range(model.m)
        self.shown = [*outputs, *inputs][:PANELS]  # in the order of a page

    def of(self, first: int, signals: np.ndarray) -> dict[bytes, str]:
        """Return {name: JSON} of the samples from number `first` on.

        Args:
            first: its number. signals: (n, k) inputs, outputs and, if the model has `where`, 1 where that
                holds.
        """
        runs = [follow_runs(Runs(first), np.ascontiguousarray(x)) for x in signals.T]
        begun, _, edges = inside(self.edges, first, len(signals))
        extremes: dict[str, Any] = {"bin": begun, "low": [], "high": []}
        for i in self.shown:
            extremes["low"].append(_coded(np.fmin.reduceat(signals[:, i], edges)))
            extremes["high"].append(_coded(np.fmax.reduceat(signals[:, i], edges)))
        still = json.dumps([asdict(signal) for signal in runs], default=np.ndarray.tolist)
        return {RUNS: still, EXTREMES: json.dumps(extremes)}


def _coded(x: np.ndarray) -> str:
    """Return numbers as text; a float64 beyond float32 becomes infinite, which a picture clips."""
    with np.errstate(over="ignore"):
        return base64.b64encode(x.astype("<f4").tobytes()).decode()


def read_runs(parts: Iterable[Path]) -> list[Runs]:
    """Return the Runs (`stillness`) of all parts: of inputs, outputs and, if the model has `where`, of 1
    where it holds.
    """
    notes = [json.loads(_metadata(part)[RUNS]) for part in parts]
    every = [list(map(_runs_from, note)) for note in notes]
    return [reduce(joined_runs, signal) for signal in zip(*every, strict=True)]


def _runs_from(note: dict[str, Any]) -> Runs:
    """Return the Runs of one signal from the fields that `asdict` wrote."""
    runs = {"counts": np.array(note["counts"]), "longest": tuple(starmap(Run, note["longest"]))}
    for end in ("last", "first"):
        if note[end] is not None:
            runs[end] = Run(*note[end])
    return Runs(**note | runs)


def read_extremes(parts: Iterable[Path], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (low, high): (k, bins) extremes of the signals that a page shows, outputs first, NaN where
    samples are missing.

    Args:
        parts: all of a recording, in order. samples: how many it has.
    """
    low, high = np.full((2, PANELS, len(bins(samples))), np.nan)
    count = 0
    for metadata in map(_metadata, parts):
        note = json.loads(metadata[EXTREMES])
        _take_extremes(low, note["bin"], note["low"], np.fmin)
        _take_extremes(high, note["bin"], note["high"], np.fmax)
        count = len(note["low"])
    return low[:count], high[:count]


def _take_extremes(whole: np.ndarray, first: int, texts: list[str], extreme: np.ufunc) -> None:
    """Take the extremes of one part, in the bins from `first` on, into those of the recording (k, bins)."""
    for i, text in enumerate(texts):
        x = np.frombuffer(base64.b64decode(text), "<f4")
        here = slice(first, first + len(x))
        whole[i, here] = extreme(whole[i, here], x)


def read_devices(parts: Iterable[Path]) -> list[str]:
    """Return the devices that judged, as `judging_device` names them, each once; none where CPUs did."""
    devices = {metadata.get(DEVICE, b"").decode() for metadata in map(_metadata, parts)}
    return sorted(devices - {""})


def read_by_test(parts: Iterable[Path], bank: Relations) -> CountsByTest:
    """Return the counts of each test of a monitor in all parts, in order."""
    counted = CountsByTest(bank)
    for metadata in map(_metadata, parts):
        counted.join(json.loads(metadata[TESTS]))
    return counted


def _metadata(part: Path) -> dict[bytes, bytes]:
    import pyarrow.parquet as pq

    metadata: dict[bytes, bytes] = pq.read_schema(part).metadata
    return metadata
