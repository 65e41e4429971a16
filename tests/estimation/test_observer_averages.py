"""Bounds of averages inside windows that remember: proofs are those of linear programs with one more row for
each run.
"""

import jax
import numpy as np
import pytest
from observer_case import inside
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.certificates import verify

pytestmark = pytest.mark.usefixtures("searched_in_numpy")

STILL = jb.LinearSystem(
    [["0.95", "0.1"], [0, "0.9"]],
    [[0], [1]],
    [[1, 0]],
    noise="0.5",
    disturbance=([[1, 0], [0, 1]], ["0.05", ["-0.02", "0.04"]]),
    averages={"y1": {6: "0.05"}, "w2": {4: "0.015"}},
)
HOW = {
    "method": "joint",
    "window": 16,
    "order": 6,
    "restart": False,
    "x0": jb.interval([-5.0, -5.0], [5.0, 5.0]),
}


def ends(model, u, y, x0, averages):
    """Return the least and largest of each last state, by programs in the first state, disturbances and
    errors; None: nothing explains.
    """
    A, B, C, G = (np.array(getattr(model, name), float) for name in "ABCG")
    n, g, p, T = model.n, model.g, model.p, len(y)
    lo, hi = np.array(model.disturbance, float).T
    count = n + g * (T - 1)
    X, f, rows, right, errors = np.eye(n, count), np.zeros(n), [], [], []
    for k in range(T):
        if k:
            X, f = A @ X, A @ f + B @ u[k - 1]
            X[:, n + g * (k - 1) : n + g * k] += G
        errors.append((-C @ X, y[k] - C @ f))
        rows += [*errors[-1][0], *-errors[-1][0]]
        noise = np.array(model.noise, float)
        right += [*(noise - errors[-1][1]), *(noise + errors[-1][1])]
    for average in model.averages if averages else ():
        measured, i = average.place(model.outputs)
        weights = np.array(average.weights, float)
        for first in range(T - (not measured) - len(weights) + 1):
            steps = range(first, first + len(weights))
            if measured:
                row, known = (
                    sum(w * errors[k][part][i] for w, k in zip(weights, steps, strict=True))
                    for part in (0, 1)
                )
            else:
                row, known = (
                    sum(w * np.eye(count)[n + g * k + i] for w, k in zip(weights, steps, strict=True)),
                    0.0,
                )
            rows += [row, -row]
            right += [float(average.bound) - known, float(average.bound) + known]
    bounds = [*zip(*x0, strict=True), *[(a, b) for _ in range(T - 1) for a, b in zip(lo, hi, strict=True)]]
    keep = ~np.isnan(right)
    out = np.zeros((2, n))
    for i in range(n):
        for side, sign in enumerate((1, -1)):
            found = linprog(
                sign * X[i], np.array(rows)[keep], np.array(right)[keep], bounds=bounds, method="highs"
            )
            if found.status == 2:
                return None
            assert found.status == 0 and p == 1
            out[side, i] = sign * found.fun + f[i]
    return out


def drawn(N, T, seed):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(N, T, 1))
    found = jb.simulate(STILL, u, jax.random.key(seed), x0=rng.uniform(-3, 3, (N, 2)), at="vertices")
    return u, np.asarray(found.x, np.float64), np.array(found.y)


def test_faults_that_only_averages_show_are_those_of_programs():
    """An offset within the noise, or little beyond it: what one window over all samples proves, and its
    states, are those of HiGHS.
    """
    N, T, x0 = 24, 14, ([-5.0, -5.0], [5.0, 5.0])
    u, _, y = drawn(N, T, 2)
    y[:, 5:, 0] += np.linspace(0, 0.6, N)[:, None]
    y[:, 3, 0] = np.where(np.arange(N) % 5 == 4, np.nan, y[:, 3, 0])
    found = jb.observe(STILL, u, y, **HOW)
    wrong = np.asarray(found.status == jb.Status.FAULT)
    proved = refuted = alone = 0
    apart = []
    for j in range(0, N, 2):
        exact = ends(STILL, u[j], y[j], x0, True)
        proved += wrong[j, -1]
        if exact is None:
            refuted, alone = refuted + 1, alone + (ends(STILL, u[j], y[j], x0, False) is not None)
        else:
            assert not wrong[j, -1]
            lo, hi = np.asarray(found.state.lo[j, -1]), np.asarray(found.state.hi[j, -1])
            assert (lo <= exact[0] + 1e-9).all() and (exact[1] - 1e-9 <= hi).all()
            apart.append(max((exact[0] - lo).max(), (hi - exact[1]).max()))
    print(
        f"{proved} of {refuted} contradictions proved, {alone} by averages alone; ends of states off by "
        f"{np.round(np.sort(apart), 6)}"
    )
    assert refuted > 3 and alone >= 2 and proved == refuted and max(apart) < 1e-6


def test_a_fault_that_only_averages_show_has_a_certificate():
    """A jump within the noise: no window of few samples proves it, nor any without the averages."""
    u, y = np.zeros((18, 1)), np.where(np.arange(18) < 14, 0.4, -0.4)[:, None]
    how = {"method": "joint", "window": 16, "order": 6}
    found = jb.detect(jb.observer(STILL, **how), u, y)
    without = jb.detect(jb.observer(STILL.replace(averages=None), **how), u, y)
    assert found.status[-1] == jb.Status.FAULT and (without.status != jb.Status.FAULT).all()
    document = found.explain(17).to_dict()
    assert len(document["numbers"]["y"]) > 9 and "averages" in document["numbers"]
    verify(document, STILL, u, y)


def fault_free(seeds, N, T):
    """Return how many fault-free samples were observed, with gaps and missing samples."""
    samples = 0
    for seed in seeds:
        u, x, y = drawn(N, T, seed)
        y[np.random.default_rng(seed).random(y.shape) < 0.03] = np.nan
        found = jb.observe(STILL, u, y, starts=[T // 2], **{**HOW, "restart": bool(seed % 2)})
        assert inside(found, x).all() and not (found.status == jb.Status.FAULT).any()
        assert not (found.status == jb.Status.CONSISTENT).any(), "a trajectory is not asked for its averages"
        samples += y[..., 0].size
    return samples


def test_draws_that_keep_averages_are_never_a_fault():
    assert fault_free([3], 24, 14) == 24 * 14


@pytest.mark.long(by_day="test_draws_that_keep_averages_are_never_a_fault")
def test_many_draws_that_keep_averages_are_never_a_fault():
    assert fault_free(range(30), 64, 60) > 100_000


def test_the_bound_of_a_mean_that_follows_a_factor_refutes_nothing_that_it_allows():
    """Errors of .12 that last: within .05 times a factor of 3."""
    u, y = np.zeros((40, 1)), np.full((40, 1), 0.12)
    constant = jb.LinearSystem([["0.5"]], [[1]], [[1]], noise="0.5", averages={"y1": {6: "0.05"}})
    assert jb.detect(jb.observer(constant, method="joint", window=16), u, y).counts["FAULT"]
    followed = constant.replace(times={"y1": "3 + u1"})
    assert not jb.detect(jb.observer(followed, method="joint", window=16), u, y).counts["FAULT"]
