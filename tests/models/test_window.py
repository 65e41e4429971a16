"""The two static forms of a window, against the golden matrices and an exact simulation."""

from fractions import Fraction

import pytest
from oracles import MODELS, Plant, rational_matrix, times

import jaxbound as jb
from jaxbound.models import window

EVERY = [(name, s) for name in MODELS for s in (0, 1, 2, 3)]


def model(name):
    return jb.LinearSystem(**MODELS[name])


def rows(a):
    return [list(r) for r in a]


def from_golden(a):
    return [[Fraction(x) for x in r] for r in a]


@pytest.mark.parametrize("s", [1, 2, 3])
def test_first_form_of_section_5_is_the_golden_one(s, golden):
    O, H = window.first_form(model("paper"), s)
    expected = golden["p0"]["static"]["value"][f"s{s}"]
    assert rows(O) == from_golden(expected["C"])
    assert rows(H) == from_golden(expected["H"])


@pytest.mark.parametrize("name, s", EVERY)
def test_first_form_is_the_response_to_each_state_and_input(name, s):
    O, H = window.first_form(model(name), s)
    assert (rows(O), rows(H)) == Plant(**MODELS[name]).window(s)


@pytest.mark.parametrize("name, s", EVERY)
def test_second_form_holds_along_every_exact_trajectory(name, s, rng):
    plant = Plant(**MODELS[name])
    L, M, N, F = window.second_form(model(name), s)
    draw = lambda count: [Fraction(int(v), 64) for v in rng.integers(-999, 999, count)]
    states, u = [draw(plant.n)], [draw(plant.m) for _ in range(s + 1)]
    y = [v for row in plant.trajectory(states[0], u) for v in row]
    for now in u[:-1]:
        states.append(
            [
                sum(a * x for a, x in zip(A, states[-1], strict=True))
                + sum(b * v for b, v in zip(B, now, strict=True))
                for A, B in zip(plant.A, plant.B, strict=True)
            ]
        )
    X, U = [x for state in states for x in state], [v for row in u[: plant.lags(s)] for v in row]
    value = lambda matrix, vector: [
        sum((a * b for a, b in zip(row, vector, strict=True)), Fraction(0)) for row in matrix
    ]
    assert value(M, X) == value(N, U)
    assert [a + b for a, b in zip(value(L, X), value(F, U), strict=True)] == y


@pytest.mark.parametrize("name", MODELS)
def test_a_window_uses_the_newest_input_only_with_feedthrough(name):
    assert window.input_lags(model(name), 3) == (4 if name in ("feedthrough", "offsets") else 3)


@pytest.mark.parametrize("s", [1, 2, 3])
def test_both_forms_have_the_same_left_nullity(s, golden):
    L, M, _, _ = window.second_form(model("paper"), s)
    O, _ = window.first_form(model("paper"), s)
    expected = golden["p0"]["static"]["value"][f"s{s}"]
    stacked = rational_matrix(rows(L) + rows(M))
    assert (rational_matrix(rows(O)).rank(), stacked.rank()) == (expected["rank_C"], expected["rank_Ctilde"])
    assert [stacked.nrows(), stacked.ncols()] == expected["shape_Ctilde"]


def test_the_states_of_a_window_solve_the_dynamics():
    m, s = model("paper"), 2
    _, M, N, _ = window.second_form(m, s)
    power, block = (
        rows([[1, 0], [0, 1]]),
        [],
    )  # A_s = [I; A; A^2], B_s: M A_s = 0, N = M B_s (Adrot 2000, before (18))
    for _ in range(s + 1):
        block += power
        power = times(rows(m.A), power)
    zero = [Fraction(0)] * 2
    AB = times(rows(m.A), rows(m.B))
    inputs = [
        zero,
        zero,
        [m.B[0][0], Fraction(0)],
        [m.B[1][0], Fraction(0)],
        [AB[0][0], m.B[0][0]],
        [AB[1][0], m.B[1][0]],
    ]
    assert all(x == 0 for row in times(rows(M), block) for x in row)
    assert times(rows(M), inputs) == rows(N)
