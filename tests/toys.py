"""The least that somebody writes to add a test of windows, an observer and a source of recordings."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from jaxbound.consistency import Judged, Observer, Relations, WindowTest
from jaxbound.consistency.interface import refuse_options
from jaxbound.recordings.source import Source

MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
LIMIT = 1.0


@jax.jit
def moved(limit, u, y):
    """Return (status, margin, move) of windows of two samples: does the output move by more than a limit?"""
    move = abs(y[1, 0] - y[0, 0])
    margin = 1 - move / limit
    status = jnp.where(margin < 0, jb.Status.FAULT, jb.Status.CONSISTENT)
    return jnp.where(jnp.isnan(margin), jb.Status.MISSING, status).astype(jnp.int8), margin, move


class StepTest(WindowTest):
    """Tests how far the output moves from one sample to the next."""

    block, short, lags = 256, 16, 2
    columns = {"move": (np.float32, np.nan)}

    @property
    def constants(self):
        return jnp.asarray(self.relations.bounds["step"], self.dtype)

    def judge(self, run, blocks):
        return run(moved, blocks)


class Steps(Relations):
    """The output moves by at most a limit from one sample to the next."""

    horizon = 1

    def __init__(self, model, limit=LIMIT):
        self.model, self.bounds = model, {"step": np.asarray(limit)}
        self.made = ("steps",)

    def test(self, method, dtype, budget=None):
        refuse_options("joint" if method == "steps" else method, budget)
        return StepTest(self, method, dtype)


class Spread(Observer):
    """The output stays within a limit of the first one that there is."""

    method = "spread"

    def __init__(self, model, limit=LIMIT):
        self.model, self.bounds = model, {"limit": np.asarray(limit)}
        self.made = ("spread",)

    def init(self):
        return np.full(1, np.nan)

    def fold(self, carry, piece):
        status, margin = np.zeros(piece.samples, np.int8), np.full(piece.samples, np.nan)
        for k, y in enumerate(piece.y[:, 0]):
            first = np.nan if k in piece.starts else carry[0]
            carry = np.array([y if np.isnan(first) else first])
            margin[k] = 1 - abs(y - first) / self.bounds["limit"]
            faulty = jb.Status.FAULT if margin[k] < 0 else jb.Status.UNDECIDED
            status[k] = jb.Status.MISSING if np.isnan(margin[k]) else faulty
        return carry, Judged(status, margin, columns={"move": self.bounds["limit"] * (1 - margin)})


class JsonLines(Source):
    """A recording with one JSON object a line."""

    @classmethod
    def takes(cls, data):
        return str(data).endswith(".jsonl")

    def whole(self, progress=None):
        rows = [json.loads(line) for line in Path(self.data).read_text().splitlines()]
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        return jb.Recording.of(self.model, columns)


def recorded(samples=60):
    """Return outputs (samples, 1) that jump at sample 30, and one that is missing."""
    y = 0.1 * np.sin(np.arange(samples))[:, None]
    y[30:] += 5
    y[20] = np.nan
    return y
