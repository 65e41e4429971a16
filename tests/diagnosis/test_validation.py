"""Data validation (Alhaj-Dibo, Maquin, Ragot 2004, section 5): the state stays inside, no false alarm, the faulty sensor is found."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.models.intervals import as_intervals, stacked

Status = jb.Status


def paper():
    """Return the model of section 5."""
    A = [[0.45, -0.29, [0.19, 0.21]], [[-0.084, -0.076], 0.66, -0.08], [0.12, [0.114, 0.126], 0.37]]
    C = [[-5.25, [-1.576, -1.423], 1.2], [[0.949, 1.051], 0.2, -5]]
    return jb.interval_system(A, [[1], [-0.8], [[0.949, 1.051]]], C)


def record(rng, m, count, T=91, kind="steps"):
    """Draw recordings (u, x, y) with parameters anew each sample, half of the time at vertices."""
    steps = np.repeat(rng.uniform(-3, 3, (count, T // 10 + 1)), 10, 1)[:, :T, None]
    u = steps if kind == "steps" else rng.uniform(-2, 2, (count, T, 1))
    x, y = np.zeros((count, T, m.n)), np.zeros((count, T, m.p))
    x[:, 0] = rng.normal(size=(count, m.n))

    def draw(X):
        lo, hi = np.asarray(X.lo), np.asarray(X.hi)
        share = rng.random((count, *lo.shape))
        share = np.where(rng.random((count, 1, 1)) < 0.5, share, share < 0.5)
        return lo + share * (hi - lo)

    for k in range(T):
        y[:, k] = np.einsum("kij,kj->ki", draw(m.C), x[:, k])
        if k + 1 < T:
            x[:, k + 1] = np.einsum("kij,kj->ki", draw(m.A), x[:, k]) + np.einsum("kij,kj->ki", draw(m.B), u[:, k])
    return u, x, y


def inside(found, x):
    return ((np.asarray(found.state.lo) <= x) & (x <= np.asarray(found.state.hi))).all(-1)


def width(found):
    return float((np.asarray(found.state.hi) - np.asarray(found.state.lo))[:, 2:].mean())


def reference_width(m, u, y):
    """Return the mean width of step 1 by Gauss, which is .573 in the golden run: what widths are compared by, as they grow with |x|."""
    k = np.arange(2, y.shape[1])
    ends = [[-b * u[:, k - j] for j in (2, 1)] for b in (np.asarray(m.B.lo)[:, 0], np.asarray(m.B.hi)[:, 0])]
    samples = [y[:, k - 2], y[:, k - 1][..., :1]]
    right = [np.concatenate([*(f(a, b) for a, b in zip(*ends, strict=True)), *samples], -1) for f in (np.minimum, np.maximum)]
    return float(jb.solve_interval(stacked(m, 2)[:9], jb.interval(*right), "gauss").x.wid.mean())


def faulty(y, size):
    """Add the faults of the paper: y1 on 20..30, y2 on 50..60."""
    bad, truth = y.copy(), np.zeros(y.shape, bool)
    truth[:, 20:31, 0] = truth[:, 50:61, 1] = True
    bad[truth] += size
    return bad, truth


@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_the_paper_s_system(rng, method):
    """One compiled shape for all claims: fault-free, faults found and located, a missing sensor, a long loss."""
    m = paper()
    u, x, y = record(rng, m, 12)
    unit = reference_width(m, u, y) / 0.573
    healthy = jb.validate(m, u, y, method=method)
    assert inside(healthy, x)[:, 2:].all() and not healthy.faulty.any()
    assert (np.asarray(healthy.status)[:, :2] == Status.MISSING).all() and not (np.asarray(healthy.status) == Status.FAULT).any()
    # golden: design B .158, design A .225 in a run whose step 1 is .573 wide
    assert width(healthy) / unit < {"joint": 0.16, "sequential": 0.25}[method]
    assert ((np.asarray(healthy.output.lo) <= y) & (y <= np.asarray(healthy.output.hi)))[:, 2:].mean() > 0.5

    bad, truth = faulty(y, 10 * unit)
    found = jb.validate(m, u, bad, method=method)
    assert (np.asarray(found.faulty) == truth).all()  # all located, none else
    assert inside(found, x)[:, 2:].all()
    assert ((np.asarray(found.status) == Status.FAULT) == truth.any(-1)).all()
    right = (np.asarray(found.corrected.lo) <= y) & (y <= np.asarray(found.corrected.hi))
    assert right[truth].all()  # the true sample lies in the corrected interval

    absent = np.where(truth, np.nan, y)
    lost = jb.validate(m, u, absent, method=method)
    assert inside(lost, x)[:, 2:].all() and not lost.faulty.any()

    long = y.copy()
    long[:, 20:, 0] = np.nan
    found = jb.validate(m, u, long, method=method)
    spread = np.asarray(found.state.hi - found.state.lo).max(-1)
    assert inside(found, x)[:, 2:].all() and spread[:, 60:].max() < 5 * unit

    first, _ = faulty(np.roll(y, -20, 1), 0)
    first[:, :3, 0] += 10 * unit  # inside the window that is taken to be fault-free: nothing is promised, and nothing breaks
    assert np.isfinite(jb.validate(m, u, first, method=method).state.lo[:, 2:]).all()


def test_regularity_of_the_four_systems_is_proved():
    M = stacked(paper(), 2)
    rows = np.array([[*range(8), last] for last in (8, 9, 10, 11)])
    assert (jb.solve_interval(M[rows], np.ones((4, 9)), "hbr").status == jb.Solvability.SOLVED).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["steps", "random"])
@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_many_fault_free_recordings_give_no_alarm(rng, method, kind):
    m = paper()
    u, x, y = record(rng, m, 200 if method == "joint" else 3000, kind=kind)
    found = jb.validate(m, u, y, method=method)
    assert inside(found, x)[:, 2:].all() and not found.faulty.any() and not (np.asarray(found.status) == Status.FAULT).any()


def test_intervals_of_a_linear_system_hold_its_parameters():
    k = jb.Uncertainty("k", A=[[0.1]], between=(-1, 3))
    m = as_intervals(jb.LinearSystem([[0.5]], [[1]], [[1]], uncertainties=[k], noise="1/3", disturbance=([[2]], [[-1, 3]])))
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
        (lambda: jb.validate(paper(), np.ones((9, 1)), np.ones((9, 2)), horizon=9), "horizon must be"),
        (lambda: jb.validate(paper(), np.ones((9, 1)), np.full((9, 2), np.nan)), "must be complete"),
        (lambda: jb.validate(paper(), np.full((9, 1), np.nan), np.ones((9, 2))), "needs every input"),
        (lambda: jb.validate(jb.LinearSystem([[1]], None, [[1]], unknown_inputs=[[1]]), None, np.ones((5, 1))), "without unknown inputs"),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()
