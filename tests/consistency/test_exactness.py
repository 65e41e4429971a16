"""The joint verdict is exact: it is the linear program's, right up to the boundary, and beyond the program's
digits the exact one.
"""

from functools import cache

import numpy as np
import pytest
from oracles import MODELS, Plant, Windows, draw

import jaxbound as jb
from jaxbound.sets.floats.status import Status

NEAR = 1e-6


@cache
def windows_of(name, horizon):
    return Windows(Plant(**MODELS[name]), horizon)


@cache
def relations_of(name, horizon):
    return jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon=horizon)


def sample(oracle, count, rng):
    """Return windows: a third anywhere, a third on either side of the boundary, a good third within 1e-6 of
    it.
    """
    u, centre, y = draw(oracle.plant, oracle.s, count, rng)
    near, around = slice(0, int(0.36 * count)), slice(int(0.36 * count), 2 * count // 3)
    factor = oracle.crossing(u, centre, y)
    factor = np.where(np.isfinite(factor), factor, 1)
    factor[near] *= 1 + NEAR * rng.uniform(-1, 1, len(factor[near]))
    factor[around] *= rng.uniform(0.5, 1.5, len(factor[around]))
    factor[2 * count // 3 :] = 1
    return u, centre + factor[:, None, None] * (y - centre)


def true_faults(oracle, u, y):
    """Return (N,) bool by HiGHS, by exact rationals where HiGHS has no digits left, and how many of the
    latter there were.
    """
    slack = oracle.slack(u, y)
    fault = slack > 0
    close = np.flatnonzero(abs(slack) < 1e-9 * (1 + abs(y).max((1, 2))))
    for i in close:
        fault[i] = oracle.plant.gauge(oracle.s, u[i], y[i], circuits=oracle.exact_circuits) > 1
    return fault, len(close)


def compare(name, horizon, count, rng):
    oracle = windows_of(name, horizon)
    u, y = sample(oracle, count, rng)
    res = jb.detect(relations_of(name, horizon), u if oracle.plant.m else None, y)
    status = res.status[:, -1]
    fault, exact = true_faults(oracle, u, y)
    undecided = status == Status.UNDECIDED
    near = abs(oracle.gauge(u, y) - 1)
    print(
        f"{name} s={horizon}: {count} windows, {fault.mean():.1%} outside, {(near < NEAR).mean():.1%} within "
        f"{NEAR:g}, "
        f"{exact} by rationals, {undecided.sum()} undecided, nearest decided {near[~undecided].min():.1e}"
    )
    assert 0.3 <= fault.mean() <= 0.7
    assert (near < NEAR).mean() > 0.3
    assert (near[undecided] < 1e-11).all()
    decided = ~undecided
    assert np.array_equal(status[decided] == Status.FAULT, fault[decided])
    assert np.isin(status[decided], (Status.FAULT, Status.CONSISTENT)).all()


@pytest.mark.parametrize("horizon", [1, 2, 3, 4])
def test_joint_verdict_of_the_paper_equals_the_linear_program(horizon, rng):
    compare("paper", horizon, 1_000, rng)


@pytest.mark.long(by_day="test_joint_verdict_of_the_paper_equals_the_linear_program")
@pytest.mark.parametrize("horizon", [1, 2, 3, 4])
def test_joint_verdict_of_the_paper_equals_the_linear_program_a_hundred_thousand_times(horizon, rng):
    compare("paper", horizon, 30_000, rng)


@pytest.mark.parametrize(
    "name, horizon",
    [("noise only", 2), ("three states", 2), ("feedthrough", 2), ("offsets", 1), ("no input", 2)],
)
def test_joint_verdict_of_other_models_equals_the_linear_program(name, horizon, rng):
    compare(name, horizon, 1_000, rng)


@pytest.mark.long(by_day="test_joint_verdict_of_other_models_equals_the_linear_program")
@pytest.mark.parametrize("horizon", [1, 2, 3])
@pytest.mark.parametrize("name", [name for name in MODELS if name != "paper"])
def test_joint_verdict_of_other_models_equals_the_linear_program_ten_thousand_times(name, horizon, rng):
    compare(name, horizon, 10_000 if horizon < 3 else 3_000, rng)


@pytest.mark.parametrize(
    "name, horizon",
    [
        ("paper", 1),
        ("paper", 2),
        ("paper", 3),
        ("noise only", 1),
        ("three states", 2),
        ("feedthrough", 1),
        ("offsets", 1),
    ],
)
def test_verdicts_down_to_the_last_digits_equal_exact_rationals(name, horizon, rng):
    oracle = windows_of(name, horizon)
    count = 200 if horizon < 3 else 60
    u, centre, y = draw(oracle.plant, horizon, count, rng, level=1.0)
    factor = oracle.crossing(u, centre, y)
    factor = np.where(np.isfinite(factor), factor, 1) * (
        1 + rng.choice([-1, 1], count) * 10 ** rng.uniform(-16, -10, count)
    )
    y = centre + factor[:, None, None] * (y - centre)
    status = jb.detect(relations_of(name, horizon), u, y).status[:, -1]
    gauge = [oracle.plant.gauge(horizon, u[i], y[i], circuits=oracle.exact_circuits) for i in range(count)]
    outside, excess = np.array([g > 1 for g in gauge]), np.array([abs(float(g - 1)) for g in gauge])
    undecided = status == Status.UNDECIDED
    print(
        f"{(excess < 1e-13).mean():.0%} within 1e-13; undecided {undecided.sum()} of {count}, "
        f"farthest {excess[undecided].max(initial=0):.1e}; nearest decided {excess[~undecided].min():.1e}"
    )
    assert (excess[undecided] < 1e-11).all()
    assert np.array_equal(status[~undecided] == Status.FAULT, outside[~undecided])
    assert undecided.any() and (~undecided).any()


@pytest.mark.parametrize(
    "name, horizon",
    [("paper", 1), ("paper", 2), ("paper", 4), ("three states", 2), ("feedthrough", 2), ("offsets", 1)],
)
def test_margin_equals_one_minus_the_gauge_of_the_linear_program(name, horizon, rng):
    oracle = windows_of(name, horizon)
    u, _, y = draw(oracle.plant, horizon, 150, rng)
    margin = jb.detect(relations_of(name, horizon), u, y).margin[:, -1]
    gauge = oracle.gauge_by_program(u, y)
    worst = abs(margin - (1 - gauge)).max()
    print(f"worst difference {worst:.1e} of margins {margin.min():.3g} .. {margin.max():.3g}")
    assert np.allclose(margin, 1 - gauge, rtol=1e-7, atol=1e-9)
    assert (margin < 0).any() and (margin > 0).any()


@pytest.mark.parametrize("name, horizon", [("paper", 1), ("paper", 3), ("three states", 2), ("offsets", 1)])
def test_margin_equals_the_exact_gauge_to_rounding(name, horizon, rng):
    oracle = windows_of(name, horizon)
    u, _, y = draw(oracle.plant, horizon, 60, rng)
    margin = jb.detect(relations_of(name, horizon), u, y).margin[:, -1]
    gauge = np.array(
        [
            float(1 - oracle.plant.gauge(horizon, u[i], y[i], circuits=oracle.exact_circuits))
            for i in range(len(u))
        ]
    )
    print(f"worst difference {abs(margin - gauge).max():.1e}")
    assert np.allclose(margin, gauge, rtol=1e-11, atol=1e-11)


def test_fast_margins_equal_the_proved_ones(rng):
    oracle = windows_of("paper", 2)
    u, _, y = draw(oracle.plant, 2, 2000, rng)
    proved, fast = (
        jb.detect(relations_of("paper", 2), u, y).margin[:, -1],
        np.asarray(jb.margins(relations_of("paper", 2), u, y))[:, -1],
    )
    assert np.allclose(proved, fast, rtol=1e-12, atol=1e-12)


def test_the_oracles_agree_with_each_other(rng):
    oracle = windows_of("offsets", 1)
    u, _, y = draw(oracle.plant, 1, 100, rng)
    by_program, by_circuits = oracle.gauge_by_program(u, y), oracle.gauge(u, y)
    exact = [float(oracle.plant.gauge(1, u[i], y[i])) for i in range(20)]
    assert np.allclose(by_program, by_circuits, rtol=1e-8)
    assert np.allclose(by_circuits[:20], exact, rtol=1e-11)
    assert np.array_equal(oracle.slack(u, y) > 0, by_circuits > 1)
