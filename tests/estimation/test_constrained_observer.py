"""Constrained zonotopes carried in time: what they prove is what linear programs over all samples prove, and
little is missed.
"""

import json

import jax
import numpy as np
import pytest
from observer_case import PLANT, fault_free, jumps_near_the_boundary, program, recorded

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.sets import zonotope

HOW = {"method": "constrained"}


def test_it_proves_what_programs_over_all_samples_refute_and_nothing_else():
    proved, possible, wider = jumps_near_the_boundary(**HOW)
    assert possible >= 10 and proved >= 0.9 * possible and np.mean(wider) < 1.2


def test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault(rng):
    assert fault_free(rng, (0, 5), 16, 40, **HOW) == 2 * 16 * 40


@pytest.mark.long
def test_a_hundred_thousand_fault_free_samples(rng):
    assert fault_free(rng, range(48), 32, 70, **HOW) > 100_000


def test_in_pieces_and_in_a_batch_it_says_the_same():
    """The sample after a contradiction begins anew, wherever a piece ends."""
    u, _, y = recorded(PLANT, 40, 5, N=24, at="uniform")
    y[1, 20:] += 3
    y[1, 30:] -= 6
    whole = jb.observe(PLANT, u, y, **HOW)
    watch = jb.observer(PLANT, **HOW).telling(enclosures=True)
    carry, pieces = watch.init(), []
    for a, b in ((0, 7), (7, 8), (8, 23), (23, 40)):
        carry, told = watch.fold(carry, Recording.of(PLANT, u[:, a:b], y[:, a:b]))
        pieces.append(told)
    pieces = jax.tree.map(lambda *x: np.concatenate(x, 1), *pieces)
    for a, b in zip(jax.tree.leaves(pieces), jax.tree.leaves(whole), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    alone = jb.observe(PLANT, u[1], y[1], **HOW)
    np.testing.assert_array_equal(alone.status, whole.status[1])
    np.testing.assert_allclose(alone.state.hi, whole.state.hi[1], rtol=1e-6, atol=1e-6)
    fault = np.asarray(whole.status) == jb.Status.FAULT
    assert fault[1, 20:30].any() and fault[1, 30:].any() and not fault[[0, *range(2, 24)]].any()
    first = int(fault[1].argmax())
    assert whole.status[1, first + 1] == jb.Status.MISSING and whole.since[1, first + 3] > first


@pytest.mark.slow
def test_widths_of_published_examples(shared):
    """CORA's linearSysDT example with all its constraints, and ZETA's demonstration, drawn anew, with as many
    as it keeps.
    """
    case = json.loads(shared("external/observer_2dim.json").read_text())[0]
    model = jb.LinearSystem(
        case["A"], None, case["C"], noise=case["V_radius"][0], disturbance=(case["W_generators"], 1)
    )
    y, x0 = np.array(case["y"]).T, zonotope([0.0, 0.0], case["R0_generators"])
    state = jb.observe(model, None, y, x0=x0, order=30, constraints=20, **HOW).state
    want = np.array(case["cora_interval_of_last_set"]["CZN-A"])
    lo, hi = np.asarray(state.lo)[-1], np.asarray(state.hi)[-1]
    print(want[0] - lo, hi - want[1])
    assert (lo <= want[0]).all() and (want[1] <= hi).all() and (hi - lo < 1.03 * (want[1] - want[0])).all()

    case = json.loads(shared("external/set_estimation.json").read_text())["zeta_linear_estimation"]
    k, order = case["constraints_max"], (case["generators_max"] - case["constraints_max"]) / 2
    w, v = case["w_radius"][0], case["v_radius"][0]
    model = jb.LinearSystem(case["A"], None, case["C"], noise=str(v), disturbance=([[1, 0], [0, 1]], str(w)))
    u, x0 = np.zeros((12, 31, 0)), zonotope(case["x0_center"], case["x0_generators"])
    first = np.broadcast_to(np.array(case["true_x0"], float), (12, 2))
    y = np.asarray(jb.simulate(model, u, jax.random.key(30), x0=first, at="uniform").y)
    corner = np.abs(case["x0_generators"]).sum(1)
    box = case["x0_center"] - corner, case["x0_center"] + corner
    ours = jb.observe(model, u, y, x0=x0, order=order, constraints=k, **HOW).state
    zonotopes = jb.observe(model, u, y, x0=x0).state
    wide = []
    for j in range(12):
        for k in (10, 20, 30):
            lo, hi = program(model, u[j], y[j, : k + 1], box)
            assert (ours.lo[j, k] <= lo + 1e-9).all() and (hi - 1e-9 <= ours.hi[j, k]).all()
            wide.append([(x.hi[j, k] - x.lo[j, k]) / (hi - lo) for x in (ours, zonotopes)])
    mean = np.mean(wide, 0)
    print(f"widths over the exact ones: {mean[0]}, of zonotopes {mean[1]}")
    assert (mean[0] < 1.3).all() and (mean[0] < 0.7 * mean[1]).all()


def test_what_it_cannot_take_is_said():
    with pytest.raises(ValueError, match="constraints must be a whole number"):
        jb.observer(PLANT, constraints=0, **HOW)
    moved = jb.LinearSystem([["0.9"]], None, [[1], [1]], noise="0.1", unknown_inputs=[[1]])
    with pytest.raises(ValueError, match="takes no unknown inputs"):
        jb.observer(moved, **HOW)
    assert jb.observer(PLANT, **HOW).made != jb.observer(PLANT, constraints=9, **HOW).made
