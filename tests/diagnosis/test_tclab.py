"""A real recording: the temperature control lab, healthy, with a fitted model; and jumps added to it."""

import json

import numpy as np
import pandas as pd
import pytest
from oracles import Plant, Windows

import jaxbound as jb
from jaxbound.sets.floats.status import Status

HALF, JUMP = 100, 2.0


@pytest.fixture(scope="module")
def plant(shared):
    """Return (relations at s = 4, u, y, oracle) of the hybrid run; the model speaks of deviations from its
    first sample.
    """
    spec = json.loads(shared("data/tclab/model.json").read_text())
    table = pd.read_csv(shared("data/tclab/mimo_hybrid_3s.csv"), skipinitialspace=True)
    u = table[["Heater 1", "Heater 2"]].to_numpy()
    y = table[["Temperature 1", "Temperature 2"]].to_numpy()
    numbers = dict(
        A=spec["A"], B=spec["B"], C=spec["C"], noise=spec["noise_bound"]["s4"], offset={"y": y[0].tolist()}
    )
    model = jb.LinearSystem(**numbers, dt=spec["dt"], inputs=spec["inputs"], outputs=spec["outputs"])
    return jb.parity_relations(model, horizon=4), u, y, Windows(Plant(**numbers), 4)


def jumps(y):
    """Return the onsets and the recordings (onset, T, 2) in which Temperature_1 jumps by 2 degC at each
    onset.
    """
    onsets = np.arange(HALF, len(y) - 5)
    faulty = np.repeat(y[None], len(onsets), 0)
    faulty[..., 0] += JUMP * (np.arange(len(y)) >= onsets[:, None])
    return onsets, faulty


def test_the_unseen_half_of_the_healthy_run_has_no_fault(plant):
    r, u, y, _ = plant
    res = jb.detect(r, u, y)
    late = res.status[HALF:]
    print(f"smallest margin {res.margin[HALF:].min():.3f}")
    assert len(late) == 101 and (late == Status.CONSISTENT).all()


def test_verdicts_on_real_data_equal_the_linear_program(plant):
    r, u, y, oracle = plant
    onsets, faulty = jumps(y)
    status = jb.detect(r, u, faulty).status
    ends = [(i, o + j) for i, o in enumerate(onsets) for j in (0, 2, 4)] + [(0, k) for k in range(4, HALF)]
    slack = oracle.slack(
        np.stack([u[k - 4 : k + 1] for _, k in ends]), np.stack([faulty[i, k - 4 : k + 1] for i, k in ends])
    )
    assert (abs(slack) > 1e-9).all()
    np.testing.assert_array_equal([status[end] == Status.FAULT for end in ends], slack > 0)


def test_tighter_bounds_would_not_hold(plant):
    """So that silence above is no triviality: two thirds of the noise bound are too little."""
    r, u, y, _ = plant
    assert (jb.detect(r.with_bounds({"noise": 0.732 * 2 / 3}), u, y).status == Status.FAULT).any()


def test_a_jump_of_two_degrees_is_found_within_three_samples_mostly_and_five_always(plant):
    r, u, y, _ = plant
    onsets, faulty = jumps(y)
    fault = jb.detect(r, u, faulty).status == Status.FAULT
    within = lambda n: np.array([fault[i, o : o + n].any() for i, o in enumerate(onsets)])
    print(f"within 3 samples {within(3).mean():.1%}, within 5 {within(5).mean():.1%} of {len(onsets)} onsets")
    assert within(3).mean() >= 0.9
    assert within(5).all()
    assert not any(fault[i, HALF:o].any() for i, o in enumerate(onsets))
