"""Results with given verdicts, and one of the paper's system with a bias: what pictures, sentences and pages
are tested with.
"""

import jax
import numpy as np
from systems import paper

import jaxbound as jb
from jaxbound.diagnosis.result import Result
from jaxbound.recordings.recording import Recording

FAULT, MISSING, CONSISTENT, UNDECIDED = (
    jb.Status.FAULT,
    jb.Status.MISSING,
    jb.Status.CONSISTENT,
    jb.Status.UNDECIDED,
)


def biased():
    """Return (result, recording) of the paper's system with a bias."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, 15), 20)[:, None]
    t = jb.simulate(paper(), u, jax.random.key(0), faults=[jb.Fault("y1", "bias", 1.0, 100, 150)])
    u, y = np.asarray(t.u), np.asarray(t.y)
    return jb.detect(jb.parity_relations(paper()), u, y), Recording(
        u, y, time=0.01 * np.arange(len(u)), source="run.csv"
    )


def synthetic(status, margin=None, model=None, method="joint"):
    """Return a Result with given verdicts."""
    r = jb.parity_relations(model or paper())
    status = np.asarray(status, np.int8)
    margin = (
        np.where(status == FAULT, -1.0, np.where(status == MISSING, np.nan, 0.5))
        if margin is None
        else np.asarray(margin, float)
    )
    n = len(status)
    return Result(status, margin, method, r, np.zeros((n, r.model.m)), np.zeros((n, r.model.p)))


def recording_of(res):
    return Recording(res.u, res.y, time=res.relations.model.dt * np.arange(len(res.status)))
