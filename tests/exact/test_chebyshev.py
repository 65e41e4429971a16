"""The exact Chebyshev problem: primal and dual agree in rationals, which proves the optimum; HiGHS agrees in
floats.
"""

from fractions import Fraction

import numpy as np
import pytest
from oracles import Program

from jaxbound.exact import chebyshev as module
from jaxbound.exact.chebyshev import chebyshev, likely_point, nearest


def draw(rng, rows, unknowns, digits=2):
    E = [
        [Fraction(int(x), 10**digits) for x in rng.integers(-(10**digits), 10**digits, unknowns)]
        for _ in range(rows)
    ]
    b = [Fraction(float(x)) for x in rng.normal(size=rows)]
    return E, b, [Fraction(float(x)) for x in rng.uniform(0.01, 1, rows)]


def assert_optimal(E, b, r, best):
    """The dual value is a lower bound, the primal one an upper bound: equal, both are the optimum."""
    dot = lambda x, y: sum((p * q for p, q in zip(x, y, strict=True)), Fraction(0))
    assert all(abs(v - dot(row, best.z)) <= best.t * w for row, v, w in zip(E, b, r, strict=True))
    assert all(dot(best.h, column) == 0 for column in zip(*E, strict=True))
    assert abs(dot(best.h, b)) == best.t * dot(map(abs, best.h), r)
    assert any(best.h) or best.t == 0


@pytest.mark.parametrize("shape", [(1, 0), (3, 0), (3, 1), (4, 3), (12, 2), (20, 6), (40, 9)])
def test_primal_and_dual_meet_exactly(shape, rng):
    for _ in range(5):
        case = draw(rng, *shape)
        assert_optimal(*case, chebyshev(*case))


def test_the_factor_is_that_of_a_linear_program(rng):
    for _ in range(10):
        E, b, r = draw(rng, 15, 4)
        scaled = np.array([[float(x / w) for x in row] for row, w in zip(E, r, strict=True)])
        target, one, free = (
            np.array([float(v / w) for v, w in zip(b, r, strict=True)]),
            np.ones((15, 1)),
            np.full(15, np.inf),
        )
        program = Program(
            np.vstack([np.hstack([scaled, one]), np.hstack([scaled, -one])]), np.r_[np.zeros(4), 1.0]
        )
        expected = program.solve(np.r_[target, -free][None], np.r_[free, target][None])[0]
        assert float(chebyshev(E, b, r).t) == pytest.approx(expected, rel=1e-7)


def test_sparse_rows_with_many_zero_multipliers(rng):
    """As a disturbance gives them: an identity below, so that most references are degenerate."""
    for _ in range(5):
        n = 8
        upper = [
            [Fraction(int(x)) if j <= i // 2 else Fraction(0) for j, x in enumerate(rng.integers(-3, 4, n))]
            for i in range(2 * n)
        ]
        E = upper + [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
        _, b, r = draw(rng, len(E), 0)
        assert_optimal(E, b, r, chebyshev(E, b, r))


def test_columns_that_depend_on_others(rng):
    E, b, r = draw(rng, 12, 3)
    E = [[row[0], row[1], row[0] - 2 * row[1], Fraction(0), row[2]] for row in E]
    best = chebyshev(E, b, r)
    assert_optimal(E, b, r, best)
    assert best.z[2] == best.z[3] == 0


def test_ties_and_points_on_the_subspace(rng):
    one = Fraction(1)
    E = [[one, Fraction(i)] for i in range(6)]
    best = chebyshev(E, [Fraction(i % 2) for i in range(6)], [one] * 6)
    assert_optimal(E, [Fraction(i % 2) for i in range(6)], [one] * 6, best)
    b = [3 * row[0] - 2 * row[1] for row in E]
    best = chebyshev(E, b, [one] * 6)
    assert best.t == 0 and best.z == (3, -2)


def test_as_many_rows_as_unknowns_fit_whatever_they_are(rng):
    E, b, r = draw(rng, 4, 4)
    best = chebyshev(E, b, r)
    assert best.t == 0 and not any(best.h)
    assert all(sum(x * y for x, y in zip(row, best.z, strict=True)) == v for row, v in zip(E, b, strict=True))
    near = nearest(np.array(E, float), np.array(b, float))
    assert near.t == 0 and near.z == pytest.approx(np.array(best.z, float))


def test_radii_of_any_size(rng):
    E, b, r = draw(rng, 14, 3)
    r[2], r[5], r[9] = Fraction(2) ** -1022, Fraction(10) ** 30, Fraction(1, 10**15)
    assert_optimal(E, b, r, chebyshev(E, b, r))


def test_powers_of_an_unstable_plant(rng):
    E = [
        [Fraction(13, 10) ** k, Fraction(7, 10) ** k, Fraction(k) * Fraction(13, 10) ** k] for k in range(25)
    ]
    _, b, r = draw(rng, 25, 0)
    assert_optimal(E, b, r, chebyshev(E, b, r))


def test_a_bad_search_does_not_spoil_the_optimum(rng, monkeypatch):
    E, b, r = draw(rng, 12, 3)
    expected = chebyshev(E, b, r).t
    monkeypatch.setattr(module, "nearest", lambda F, c: module.Nearest(0.0, np.ones(12), [7, 2], None))
    best = chebyshev(E, b, r)
    assert_optimal(E, b, r, best)
    assert best.t == expected


def test_radii_must_be_positive():
    one = Fraction(1)
    with pytest.raises(ValueError, match="needs at least one row, and radii > 0"):
        chebyshev([[one], [one]], [one, one], [one, Fraction(0)])
    with pytest.raises(ValueError, match="needs at least one row"):
        chebyshev([], [], [])


def test_numbers_beyond_what_floats_hold_are_solved_too():
    one, huge = Fraction(1), Fraction(10) ** 400
    best = chebyshev([[one], [one], [one]], [0 * one, 3 * huge, one * huge], [huge, huge, huge])
    assert best.t == Fraction(3, 2) and best.z == (Fraction(3, 2) * huge,)


def test_radii_of_which_floats_see_some_only():
    """Radii of 1e-2 beside 1e-15."""
    first = ["0.9", "-0.1", "0.18", "-0.02", "0.036", "-0.004", "0.0072", "-0.0008"]
    E = [tuple(map(Fraction, row)) for row in zip(first, [0] * 6 + ["0.18", "-0.02"], strict=True)]
    b = [28.790000000000003, -3.2, 5.7700000000000005, -0.64, 1.1620000000000004, -0.128]
    b = list(map(Fraction, [*b, -0.020488471716176352, 0.002400000000000004]))
    r = [0.010000000000023665, 1.4210854715202005e-15] * 3
    r = list(map(Fraction, [*r, 0.0011115282838108926, 1.4210854715202005e-15]))
    assert_optimal(E, b, r, chebyshev(E, b, r))


def test_radii_beyond_each_other_in_floats_are_left_to_the_exact_steps():
    E = [[Fraction(1)], [Fraction(2)], [Fraction(1)]]
    b, r = [Fraction(0), Fraction(10) ** 300, Fraction(1)], [Fraction(10) ** -9] * 3
    assert_optimal(E, b, r, chebyshev(E, b, r))


def test_rows_of_zeros_are_no_rows_of_a_reference(rng):
    """Where everything fits, floats see the rest of a rounding."""
    for _ in range(50):
        rows = [[Fraction(int(x), 7) for x in row] for row in rng.integers(-9, 10, (3, 2))]
        rows[1] = [Fraction(0)] * 2
        best = chebyshev(
            rows, [Fraction(3), Fraction(0), Fraction(3)], [Fraction(1), Fraction(1), Fraction(2)]
        )
        assert_optimal(
            rows, [Fraction(3), Fraction(0), Fraction(3)], [Fraction(1), Fraction(1), Fraction(2)], best
        )


def test_a_point_that_no_float_holds_is_none():
    assert likely_point([[Fraction(1, 10**200)]], [Fraction(10**200)], [Fraction(1)]) is None


def test_there_is_a_circuit_wherever_rows_depend_on_each_other():
    """Also where everything fits: who explains a window shows a relation that holds."""
    one = Fraction(1)
    cases = [([[one], [one]], [-1000, -1000], [4, 2]), ([[one, 0], [0, one], [0, one]], [3, 5, 5], [1, 1, 1])]
    for E, b, r in cases:
        best = chebyshev(E, list(map(Fraction, b)), list(map(Fraction, r)))
        assert best.t == 0 and any(best.h)
        assert not any(sum(x * row[j] for x, row in zip(best.h, E, strict=True)) for j in range(len(E[0])))
    assert not any(chebyshev([[one, 0], [0, one]], [one, one], [one, one]).h)


def test_a_factor_that_is_enough_is_proved_by_the_first_circuit_above_it(rng, monkeypatch):
    monkeypatch.setattr(module, "_float_optimum", lambda *about: None)  # which finds the last one at once
    dot, stopped = lambda x, y: sum((p * q for p, q in zip(x, y, strict=True)), Fraction(0)), 0
    for _ in range(5):
        E, b, r = draw(rng, 30, 4)
        best = chebyshev(E, b, r)
        early = chebyshev(E, b, r, enough=best.t / 2)
        assert best.t / 2 < early.t <= best.t and early.z == ()
        assert not any(dot(early.h, column) for column in zip(*E, strict=True))
        assert abs(dot(early.h, b)) == early.t * dot(map(abs, early.h), r)
        assert chebyshev(E, b, r, enough=best.t) == best
        stopped += early.t < best.t
    assert stopped
