"""Recordings with seams: windows across are MISSING, all others are judged as if each piece stood alone."""

import numpy as np
import pandas as pd
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.consistency.drive import windows
from jaxbound.recordings.seams import all_starts, crossing


def simulated(rng, u):
    """Return healthy outputs of the paper's system, its errors just inside their bounds."""
    x, y = np.zeros(2), np.empty((len(u), 2))
    for k, v in enumerate(u[:, 0]):
        y[k] = x[0], x[0] + x[1]
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + v])
    error = lambda: 0.99 * rng.choice([-1, 1], y.shape)
    return y * (1 + error() * [0.02, 0.1]) + error() * [0.1, 0.01]


@pytest.mark.parametrize(
    "horizon, method",
    [
        (None, "joint"),
        (3, "joint"),
        (1, "box"),
        pytest.param(16, "joint", marks=pytest.mark.long),
    ],
)
def test_pieces_are_judged_as_if_they_stood_alone(rng, horizon, method):
    u = rng.uniform(-5, 5, (90, 1))
    y = simulated(rng, u)
    y[60] += 3
    r = jb.parity_relations(paper(), horizon)
    starts = [20, 21, 55]
    res = jb.detect(r, u, y, method=method, starts=starts)
    pieces = [
        jb.detect(r, *(x[a:b] for x in (u, y)), method=method)
        for a, b in zip([0, *starts], [*starts, 90], strict=True)
    ]
    np.testing.assert_array_equal(res.status, np.concatenate([p.status for p in pieces]))
    np.testing.assert_array_equal(res.margin, np.concatenate([p.margin for p in pieces]))


@pytest.mark.parametrize("how", [{"horizon": 1}, {"horizon": 5}, {"lags": (0, 1, 4)}])
def test_a_gap_at_any_sample_of_a_block(rng, how):
    """Blocks of 4 windows, so that gaps fall on each of their samples, and on the ends of a recording."""
    u = rng.uniform(-5, 5, (24, 1))
    y = simulated(rng, u)
    y[13] += 3
    relations = jb.parity_relations(paper(), **how)
    test, different = relations.test("joint", y.dtype), []
    given = lambda u, y, starts=(): jb.Recording(u, y, all_starts(starts, len(y)))
    judged = lambda *about: windows(test, given(*about), size=4).status
    for gap in range(24):
        parts = [judged(u[part], y[part]) for part in (slice(0, gap), slice(gap, 24))]
        if (judged(u, y, [gap]) != np.concatenate(parts)).any():
            different.append(gap)
    assert not different


def test_a_hole_raises_a_false_alarm_only_without_its_seam(rng):
    u = np.repeat([5.0, -5.0], 200)[:, None]
    y = simulated(rng, u)
    u, y = (np.delete(x, slice(150, 230), 0) for x in (u, y))
    r = jb.parity_relations(paper())
    assert np.flatnonzero(jb.detect(r, u, y).status == jb.Status.FAULT).tolist() == [150]
    assert jb.detect(r, u, y, starts=[150]).counts["FAULT"] == 0


def test_a_frame_with_a_gap_in_its_dates_is_split(rng):
    u = rng.uniform(-5, 5, (60, 1))
    y = simulated(rng, u)
    index = pd.date_range("2024-01-01", periods=40, freq="10ms").append(
        pd.date_range("2024-02-01", periods=20, freq="10ms")
    )
    frame = pd.DataFrame({"u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]}, index=index)
    r = jb.parity_relations(paper(), 3)
    res = jb.detect(r, frame, frame)
    np.testing.assert_array_equal(res.status, jb.detect(r, u, y, starts=[40]).status)
    assert np.flatnonzero(res.status == jb.Status.MISSING).tolist() == [0, 1, 2, 40, 41, 42]
    assert np.flatnonzero(np.isnan(jb.margins(r, frame, frame))).tolist() == [0, 1, 2, 40, 41, 42]


def test_a_batch_and_float32_keep_their_types(rng):
    u, y = rng.normal(size=(3, 30, 1)).astype(np.float32), rng.normal(size=(3, 30, 2)).astype(np.float32)
    r = jb.parity_relations(paper())
    res, plain = jb.detect(r, u, y, starts=[10]), jb.detect(r, u, y)
    assert (res.status.dtype, res.margin.dtype) == (plain.status.dtype, plain.margin.dtype)
    across = crossing(np.array([10]), r.horizon, 0, 30)
    assert (res.status[:, across] == jb.Status.MISSING).all() and np.isnan(res.margin[:, across]).all()
    np.testing.assert_array_equal(res.margin[:, ~across], plain.margin[:, ~across])


def test_hints_tell_of_splits_and_of_sensors_that_stand_still(rng):
    u = rng.uniform(-5, 5, (300, 1))
    y = simulated(rng, u)
    y[100:150, 1] = y[100, 1]
    r = jb.parity_relations(paper())
    split, frozen = jb.detect(r, u, y, starts=[40, 90]).hints
    assert split == "the recording is split in 3, first at sample 40: windows across are MISSING"
    assert frozen.startswith(
        f"y2 stays at exactly {y[100, 1]:.6g} for 50 samples from sample 100 to sample 149: a frozen sensor "
        f"can look"
    )
    batch = jb.detect(r, np.stack([u, u]), np.stack([y, simulated(rng, u)]))
    assert [h[:21] for h in batch.hints] == ["recording 0: y2 stays"]


def test_starts_that_are_no_sample_numbers_are_refused():
    with pytest.raises(ValueError, match="starts needs the numbers of samples"):
        jb.detect(jb.parity_relations(paper()), np.zeros((9, 1)), np.zeros((9, 2)), starts=np.zeros(9, bool))
