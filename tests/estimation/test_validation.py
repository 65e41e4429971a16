"""Data validation (Alhaj-Dibo, Maquin, Ragot 2004, section 5): the state stays inside, no false alarm, the
faulty sensor is found.
"""

import jax
import numpy as np
import pytest
from validation_case import faulty, inside, paper, record, reference_width, width

import jaxbound as jb
from jaxbound.models.intervals import as_intervals, stacked

Status = jb.Status


@pytest.mark.parametrize("method", [pytest.param("joint", marks=pytest.mark.long), "sequential"])
def test_the_paper_s_system(rng, method):
    """Fault-free, faults found and located, a missing sensor, a long loss."""
    m = paper()
    u, x, y = record(rng, m, 2)
    unit = reference_width(m, u, y) / 0.573
    healthy = jb.validate(m, u, y, method=method)
    assert inside(healthy, x).all() and not healthy.faulty.any()
    assert (np.asarray(healthy.status)[:, :2] == Status.MISSING).all() and not (
        np.asarray(healthy.status) == Status.FAULT
    ).any()
    # golden: design B .158, design A .225 in a run whose step 1 is .573 wide
    assert width(healthy) / unit < {"joint": 0.16, "sequential": 0.25}[method]
    assert ((np.asarray(healthy.output.lo) <= y) & (y <= np.asarray(healthy.output.hi)))[:, 2:].mean() > 0.5

    bad, truth = faulty(y, 10 * unit)
    found = jb.validate(m, u, bad, method=method)
    assert (np.asarray(found.faulty) == truth).all()  # all located, none else
    assert inside(found, x).all()
    assert ((np.asarray(found.status) == Status.FAULT) == truth.any(-1)).all()
    right = (np.asarray(found.corrected.lo) <= y) & (y <= np.asarray(found.corrected.hi))
    assert right[truth].all()  # the true sample lies in the corrected interval

    absent = np.where(truth, np.nan, y)
    lost = jb.validate(m, u, absent, method=method)
    assert inside(lost, x).all() and not lost.faulty.any()

    long = y.copy()
    long[:, 20:, 0] = np.nan
    found = jb.validate(m, u, long, method=method)
    spread = np.asarray(found.state.hi - found.state.lo).max(-1)
    assert inside(found, x).all() and spread[:, 60:].max() < 5 * unit


def test_regularity_of_the_four_systems_is_proved():
    M = stacked(paper(), 2)
    rows = np.array([[*range(8), last] for last in (8, 9, 10, 11)])
    assert (jb.solve_interval(M[rows], np.ones((4, 9)), "hbr").status == jb.Solvability.SOLVED).all()


def test_intervals_of_a_linear_system_hold_its_parameters():
    k = jb.Uncertainty("k", A=[[0.1]], between=(-1, 3))
    m = as_intervals(
        jb.LinearSystem([[0.5]], [[1]], [[1]], uncertainties=[k], noise="1/3", disturbance=([[2]], [[-1, 3]]))
    )
    assert float(m.A.lo[0, 0]) <= 0.4 < 0.8 <= float(m.A.hi[0, 0]) and float(m.A.hi[0, 0]) < 0.8 + 1e-15
    assert (float(m.w.lo[0]), float(m.w.hi[0])) == (-2.0, 6.0) and m.noise[0] * 3 >= 1


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: jb.interval_system([[0.5, 1]], None, [[1]]), "A must have shape"),
        (lambda: jb.interval_system([[[0.5, 0.4]]], None, [[1]]), "lo must be <= hi"),
        (lambda: jb.interval_system([[float("nan")]], None, [[1]]), "A: "),
        (lambda: jb.interval_system([[0.5]], None, [[1]], noise=-1), "noise must be >= 0"),
        (lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 3))), "y must have shape"),
        (lambda: jb.validate(paper(), np.ones((9, 2)), np.ones((9, 2))), "u must have shape"),
        (lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 2)), method="both"), "method must be"),
        (
            lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 2)), correction="mean"),
            "correction must be",
        ),
        (
            lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 2)), horizon=9),
            "choose a shorter horizon",
        ),
        (lambda: jb.validate(paper(), None, np.ones((9, 2)), horizon=0), "horizon must be"),
        (
            lambda: jb.validate(paper(), np.ones((9, 1)), np.full((9, 2), np.nan)),
            "no stretch of 3 complete samples",
        ),
        (
            lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 2)), horizon=1, method="sequential"),
            "horizon of at least",
        ),
        (lambda: jb.validate(paper(), np.full((9, 1), np.nan), np.ones((9, 2))), "needs every input"),
        (
            lambda: jb.validate(
                jb.LinearSystem([[1]], None, [[1]], unknown_inputs=[[1]]), None, np.ones((5, 1))
            ),
            "no unknown inputs",
        ),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()


def test_blocks_beside_each_other_compute_in_the_precision_of_who_asks():
    """A thread does not inherit `jax.enable_x64`: float64 asked for here alone is float64 in every block."""
    model = jb.interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=1e-9)
    y = np.tile(10 - 9 * 0.9 ** np.arange(8)[:, None], (600, 1, 2))
    u = np.ones((600, 8, 1))
    wide = jb.validate(model, u, y, method="sequential").state
    jax.config.update("jax_enable_x64", False)
    try:
        with jax.enable_x64(True):
            found = jb.validate(model, u, y, method="sequential").state
    finally:
        jax.config.update("jax_enable_x64", True)
    np.testing.assert_array_equal(found.lo, wide.lo)
    np.testing.assert_array_equal(found.hi, wide.hi)
