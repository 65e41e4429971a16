"""Bounded disturbances, drawn anew each sample: the verdict of the program in which they are unknowns, short
windows and long.
"""

import jax
import numpy as np
import pytest
from boundary import GUST, LEAK, agree, at_boundary, last, moved, numbers, prepared
from oracles import MODELS, Plant, Windows, draw
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status

FEW, MANY = 400, 10_000
CASES = [("gust", 2, FEW), ("leak", 2, FEW)]
FULL = [("gust", 1), ("gust", 2)]
LONG = [("gust", 3), ("gust", 4), ("gust", 6), ("gust", 20), ("leak", 5)]


def key(rng):
    return jax.random.key(int(rng.integers(2**31)))


@pytest.mark.parametrize(
    "name, horizon, count",
    [
        *CASES,
        *(pytest.param(*case, MANY, marks=pytest.mark.long) for case in FULL),
        *(pytest.param(*case, MANY, marks=pytest.mark.long) for case in LONG),
    ],
)
def test_the_verdict_is_that_of_the_program(name, horizon, count, shared, rng):
    r, oracle, u, y = prepared(numbers(name, shared), horizon, count, rng)
    status = last(jb.detect(r, u, y).status)
    share = agree(status, oracle.slack(u, y))
    print(f"{count} windows, {share:.3f} of them FAULT, {(status == Status.UNDECIDED).sum()} UNDECIDED")
    assert 0.2 < share < 0.8


@pytest.mark.parametrize("s, count", [(1, 4), (2, 23), (3, 87), (4, 286)])
def test_section_5_driven_along_its_input_has_the_published_strips(s, count):
    assert len(jb.parity_relations(jb.LinearSystem(**GUST), s).circuits) == count


@pytest.mark.parametrize(
    "G, counts",
    [
        ([[0], [1]], (4, 23, 87)),
        ([[1], [1]], (4, 23, 87)),
        ([[1], [0]], (5, 31, 110)),
        ([[1], [2]], (5, 34, 154)),
    ],
)
def test_the_strips_are_all_vectors_of_minimal_support(G, counts):
    """A direction that one output does not see has fewer of them."""
    numbers = MODELS["paper"] | dict(disturbance=(G, 0.1))
    normal = lambda h: tuple(x / next(v for v in h if v) for x in h)
    for s, count in zip((1, 2, 3), counts, strict=True):
        found = {normal(h) for h in jb.parity_relations(jb.LinearSystem(**numbers), s).circuits}
        assert len(found) == count and found == {normal(h) for h in Plant(**numbers).circuits(s)}


@pytest.mark.parametrize("horizon", [2, pytest.param(6, marks=pytest.mark.long)])
def test_a_missing_output_gives_the_verdict_of_the_program_without_its_row(horizon, rng):
    rows = 2 * (horizon + 1)
    r, oracle, u, y = prepared(GUST, horizon, rows * 30, rng)
    y.reshape(len(y), -1)[np.arange(len(y)), np.arange(len(y)) % rows] = np.nan
    agree(last(jb.detect(r, u, y).status), oracle.slack(u, y))


def test_the_margin_is_the_gauge_of_the_program(rng):
    r, oracle, u, y = prepared(LEAK, 2, 30, rng)
    np.testing.assert_allclose(
        last(jb.detect(r, u, y).margin), 1 - oracle.gauge_by_program(u, y), rtol=1e-7, atol=1e-9
    )


def zero_disturbance(horizon, rng):
    u, y = rng.uniform(-1, 1, (200, 1)), rng.normal(size=(200, 2)) / 3
    return (
        jb.detect(jb.parity_relations(m, horizon), u, y)
        for m in (paper(), paper(disturbance=([[0], [1]], 0)))
    )


def test_a_disturbance_of_bound_zero_is_none(rng):
    without, still = zero_disturbance(2, rng)
    np.testing.assert_array_equal(without.status, still.status)
    np.testing.assert_allclose(without.margin, still.margin, rtol=1e-9, atol=1e-10)


def test_a_disturbance_of_bound_zero_never_gives_another_verdict_in_a_long_window(rng):
    """It may leave one undecided: a search has no use for radii of 0, and nothing lies inside them."""
    without, still = zero_disturbance(6, rng)
    decided = (still.status == Status.FAULT) | (still.status == Status.CONSISTENT)
    np.testing.assert_array_equal(without.status[decided], still.status[decided])
    assert decided.mean() > 0.5


def test_a_fault_free_recording_needs_the_disturbance_to_be_consistent(rng):
    """Simulated with a gust: FAULT for the model without it, never for the model with it."""
    u = rng.uniform(-1, 1, (50, 60, 1))
    y = jb.simulate(paper(disturbance=([[0], [1]], 1.0)), u, key(rng), at="vertices").y
    assert jb.detect(jb.parity_relations(paper(), 2), u, y).counts["FAULT"] > 100
    assert jb.detect(jb.parity_relations(paper(disturbance=([[0], [1]], 1.0)), 2), u, y).counts["FAULT"] == 0


def test_a_leak_only_takes(rng):
    """[0, w] is no |w| / 2 around zero: what pushes is a fault at once."""
    still = np.zeros((9, 1))
    leaking = paper(disturbance=([[0], [-1]], [[0, 1]]), noise=0.01, tolerance=0.0)
    taken, pushed = np.zeros((2, 9, 2))
    for y, w in ((taken, -0.9), (pushed, 0.9)):
        x = np.zeros(2)
        for k in range(9):
            y[k] = [x[0], x[0] + x[1]]
            x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + w])
    for horizon in (2, 6):
        r = jb.parity_relations(leaking, horizon)
        assert jb.detect(r, still, taken).counts["FAULT"] == 0
        assert jb.detect(r, still, pushed).counts["CONSISTENT"] == 0


@pytest.mark.parametrize(
    "name, horizon, dtype",
    [
        ("gust", 2, np.float64),
        pytest.param("gust", 6, np.float64, marks=pytest.mark.long),
        pytest.param("leak", 2, np.float32, marks=pytest.mark.long),
        pytest.param("gust", 6, np.float32, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("at", ["vertices", "uniform"])
def test_fault_free_windows_raise_no_fault(name, horizon, dtype, at, shared, rng):
    model = jb.LinearSystem(**numbers(name, shared))
    offset = [float(v) for v in model.offset["u"]]
    u = (np.repeat(rng.uniform(-1, 1, (50, 10, model.m)), 20, 1) + offset).astype(dtype)
    res = jb.detect(jb.parity_relations(model, horizon), u, jb.simulate(model, u, key(rng), at=at).y)
    assert res.counts["FAULT"] == 0 and res.counts["MISSING"] == 50 * horizon
    assert res.counts["CONSISTENT"] > (0 if at == "vertices" and horizon > 2 else 2000) - 1


@pytest.mark.parametrize(
    "name, horizon, dtype, step",
    [
        ("gust", 2, np.float64, 1e-9),
        ("gust", 6, np.float64, 1e-9),
        ("gust", 2, np.float32, 1e-3),
        pytest.param("gust", 6, np.float32, 1e-2, marks=pytest.mark.long),
    ],
)
def test_verdicts_are_sharp(name, horizon, dtype, step, shared, rng):
    spec = numbers(name, shared)
    oracle, r = Windows(Plant(**spec), horizon, dtype), jb.parity_relations(jb.LinearSystem(**spec), horizon)
    u, centre, y = draw(oracle.plant, horizon, 150, rng, level=3.0)
    factor, side = at_boundary(r, u, centre, y, 30), rng.choice([-1, 1], 150)
    u, y = u.astype(dtype), moved(centre, y, factor * (1 + 3 * side * step)).astype(dtype)
    gauge = oracle.gauge_by_program(u, y)
    status, clear = last(jb.detect(r, u, y).status), abs(gauge - 1) > step
    assert (abs(gauge - 1) < 10 * step).mean() > 0.9 and clear.mean() > 0.9
    wrong = np.where(gauge > 1, Status.CONSISTENT, Status.FAULT)
    assert not (status == wrong)[clear].any()
    found = np.mean(status[clear] == np.where(gauge > 1, Status.FAULT, Status.CONSISTENT)[clear])
    print(f"{found:.3f} decided at {step:g}")
    assert found > 0.99
