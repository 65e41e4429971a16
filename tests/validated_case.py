"""A validated recording made up of given bands: what its verdict, its columns, its page and its pictures are
tested with.
"""

import numpy as np

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.reports.validated import Validated
from jaxbound.sets.intervals.interval import Interval

Status = jb.Status
MODEL = jb.LinearSystem(
    [["0.5"]],
    [[1]],
    [[1], [2]],
    noise="0.1",
    uncertainties=[jb.Uncertainty("a", A=[["0.05"]])],
    units={"y1": "bar"},
    name="two & two",
)


def found_in(T=60, faulty=(20, 21, 22, 40), missing=0):
    """Return a Validated made up of given bands: the truth is 1 +- 0.5, y1 shows 4 where it is faulty."""
    band = lambda k, width: Interval(
        *(
            np.concatenate([np.full((1, k), side * np.inf), np.full((T - 1, k), 1 + side * width)])
            for side in (-1, 1)
        )
    )
    bad = np.zeros((T, 2), bool)
    bad[list(faulty), 0] = True
    status = np.where(bad.any(1), Status.FAULT, Status.UNDECIDED).astype(np.int8)
    status[: 1 + missing] = Status.MISSING
    y = np.where(bad, 4.0, 1.0)
    return Validated(
        MODEL, 1, y, jb.Validation(band(1, 0.5), band(2, 0.5), band(2, 3), bad, band(2, 0.25), status)
    )


def recording_of(res):
    return Recording(np.ones((len(res.y), 1)), res.y, time=np.arange(len(res.y)) * 1.0, source="run.csv")
