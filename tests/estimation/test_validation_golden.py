"""Data validation against recomputed values of the 2004 paper and against set observers of others."""

import json

import numpy as np
import pytest
from validation_case import paper, record, reference_width, window_systems

import jaxbound as jb

ROWS = np.array([[*range(8), last] for last in (8, 9, 10, 11)])
"""The paper's four square systems: row 9 of the twelve, then 10, 11 and 12 in its place."""


@pytest.fixture(scope="module")
def golden(shared):
    return json.loads(shared("golden/alhajdibo2004_multimodel.json").read_text())


def ends(pairs):
    return tuple(np.array(pairs).T)


def wid(x):
    return np.asarray(x.hi) - np.asarray(x.lo)


def test_the_four_systems_of_the_golden_window_are_as_wide_as_recomputed(golden):
    window = golden["p4_golden_window"]
    M, _ = window_systems(paper(), np.zeros((1, 3, 1)), np.zeros((1, 3, 2)))
    h = jb.interval(np.array(window["H_lo"]), np.array(window["H_hi"]))
    found = jb.solve_interval(M[ROWS], h[ROWS], "hbr")
    assert (found.status == jb.Solvability.SOLVED).all()  # all four are proved to be regular
    for i, step in enumerate(window["steps"]):
        lo, hi = ends(step["hull_vertex"])
        assert (np.asarray(found.x.lo[i]) <= lo + 1e-9).all() and (
            hi - 1e-9 <= np.asarray(found.x.hi[i])
        ).all()
        for method in ("HBR", "I"):
            lo, hi = ends(step[method])
            assert wid(found.x[i]).mean() == pytest.approx((hi - lo).mean(), rel=0.02)


def recordings(window):
    """Return the golden window as a recording of three samples."""
    u, y = np.zeros((1, 3, 1)), np.array([window["y_points"]], float)
    u[:, :2, 0] = window["u"]
    return u, y


@pytest.mark.long(by_day="test_the_four_systems_of_the_golden_window_are_as_wide_as_recomputed")
def test_validation_of_the_golden_window_is_as_wide_as_recomputed(golden):
    window = golden["p4_golden_window"]
    u, y = recordings(window)
    exact = np.array(ends(window["joint_hull_12x9"]))[:, 6:]
    for method, golden_ends, most in (
        ("sequential", ends(window["intersection_I"]), 1.02),
        ("joint", exact, 1.02),
    ):
        last = jb.validate(paper(), u, y, method=method).state[0, 2]
        assert (np.asarray(last.lo) <= exact[0] + 1e-9).all() and (
            exact[1] - 1e-9 <= np.asarray(last.hi)
        ).all()
        lo, hi = (np.array(e)[-3:] for e in golden_ends)
        assert wid(last).mean() <= most * (hi - lo).mean()


def test_a_fault_in_the_golden_window_is_found_as_recomputed(golden):
    window = golden["p4_golden_window"]
    assert window["fault_y1_plus5"]["empty_vs_ref_step2_3_4"] == [False, True, False]
    u, y = recordings(window)
    y[:, 2, 0] += 5
    for method in ("sequential", "joint"):
        found = jb.validate(paper(), u, y, method=method)
        assert found.faulty[0, 2].tolist() == [True, False] and found.status[0, 2] == jb.Status.FAULT


@pytest.mark.long(by_day="test_a_fault_in_the_golden_window_is_found_as_recomputed")
def test_what_a_fault_inside_the_first_window_does(rng):
    """The newest samples of the first window are tested against its older ones; older ones are taken for
    sound: nothing finds them.

    A wrong reference then contradicts what comes: the recording is marked FAULT, whoever is blamed.
    """
    m = paper()
    u, x, y = record(rng, m, 16)
    size = 10 * reference_width(m, u, y) / 0.573
    for method in ("sequential", "joint"):
        newest, oldest = y.copy(), y.copy()
        newest[:, 2, 0] += size
        oldest[:, :2, 0] += size
        found = jb.validate(m, u, newest, method=method)
        assert (np.asarray(found.status)[:, 2] == jb.Status.FAULT).all()
        found = jb.validate(m, u, oldest, method=method)
        assert np.isfinite(found.state.lo[:, 2:]).all()
        assert (np.asarray(found.status)[:, :20] == jb.Status.FAULT).any(1).mean() > 0.9


@pytest.mark.parametrize("method", ["sequential", pytest.param("joint", marks=pytest.mark.long)])
@pytest.mark.parametrize("N, T", [(4, 91), pytest.param(16, 160, marks=pytest.mark.long)])
def test_several_sensors_fail_at_once_and_one_for_long(rng, N, T, method):
    m = paper()
    u, x, y = record(rng, m, N, T=T)
    size = 20 * reference_width(m, u, y) / 0.573
    both, truth = y.copy(), np.zeros(y.shape, bool)
    truth[:, 40:46] = True
    both[truth] += size
    long, gone = y.copy(), np.zeros(y.shape, bool)
    gone[:, 25 : T - 5, 0] = True
    long[gone] += size
    for bad, where in ((both, truth), (long, gone)):
        found = jb.validate(m, u, bad, method=method)
        assert (np.asarray(found.faulty) == where).all()
        assert ((np.asarray(found.state.lo) <= x) & (x <= np.asarray(found.state.hi)))[:, 2:].all()
        spread = wid(found.state)[:, 2:].max(-1)
        assert spread[:, -3:].max() < 2 * spread[:, :20].max()  # recovered
        assert spread.max() < size


def test_the_exact_hull_of_a_published_record_is_found(shared):
    """Eight set observers are printed; the best two equal the hull by linear programs. So does a window of
    three samples.
    """
    case = json.loads(shared("external/observer_2dim.json").read_text())[0]
    model = jb.LinearSystem(
        case["A"], None, case["C"], noise=case["V_radius"], disturbance=(case["W_generators"], 1)
    )
    found = jb.validate(
        model, None, np.array(case["y"]).T, horizon=2, x0=jb.interval([-3.0, -3.0], [3.0, 3.0])
    )
    last = np.stack([found.state.lo[-1], found.state.hi[-1]])
    exact = np.array(case["exact_hull_lp_here"]["x_19"]).T
    assert (last[0] <= exact[0] + 1e-12).all() and (exact[1] - 1e-12 <= last[1]).all()
    widths = [np.diff(np.array(box), axis=0).ravel() for box in case["cora_interval_of_last_set"].values()]
    assert (np.diff(last, axis=0).ravel() <= np.min(widths, 0) + 1e-9).all()
    assert not found.faulty.any()
