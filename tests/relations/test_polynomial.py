"""The algebra of polynomial matrices against evaluation at exact points."""

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from jaxbound.relations.polynomial import PolynomialMatrix, constant, monomials, stacked


def draw(rng, rows, columns, variables=3, terms=5):
    found = {}
    for _ in range(terms):
        alpha = tuple(int(e) for e in rng.integers(0, 3, variables))
        places = {
            (int(rng.integers(rows)), int(rng.integers(columns))): Fraction(int(rng.integers(1, 9)), 7)
            for _ in range(3)
        }
        found.setdefault(alpha, {}).update(places)
    return PolynomialMatrix(rows, columns, variables, found)


def values(P, point):
    return np.array(P.at(point), object).reshape(P.rows, P.columns)


@pytest.fixture
def points(rng):
    return [tuple(Fraction(int(x), 11) for x in rng.integers(-20, 21, 3)) for _ in range(4)]


def test_products_and_sums_are_those_of_the_values(rng, points):
    P, Q, R = draw(rng, 2, 3), draw(rng, 3, 4), draw(rng, 2, 3)
    for v in points:
        assert (values(P @ Q, v) == values(P, v) @ values(Q, v)).all()
        assert (values(P + R, v) == values(P, v) + values(R, v)).all()


def test_stacked_and_picked_are_those_of_the_values(rng, points):
    P, Q, R, S = draw(rng, 2, 3), draw(rng, 2, 1), draw(rng, 1, 3), draw(rng, 1, 1)
    whole = stacked([[P, Q], [R, S]])
    for v in points:
        assert (
            values(whole, v) == np.block([[values(P, v), values(Q, v)], [values(R, v), values(S, v)]])
        ).all()
        assert (
            values(whole.pick(rows=[2, 0], columns=[3, 1]), v) == values(whole, v)[[2, 0]][:, [3, 1]]
        ).all()


def test_what_cancels_leaves_no_term(rng):
    P = draw(rng, 2, 2)
    minus = constant(((-1, 0), (0, -1)), 3) @ P
    assert (P + minus).terms == {} and (P + minus).order == 0
    assert (P @ PolynomialMatrix(2, 4, 3, {})).columns == 4


@pytest.mark.parametrize("variables, order", [(1, 4), (3, 2), (4, 3), (0, 2)])
def test_monomials_are_all_of_them_once_by_order(variables, order):
    found = monomials(variables, order)
    assert len(set(found)) == len(found) == comb(variables + order, order)
    assert [sum(a) for a in found] == sorted(sum(a) for a in found)


def test_terms_come_by_order_the_first_variables_first():
    v = lambda *alpha: PolynomialMatrix(1, 1, 2, {alpha: {(0, 0): Fraction(1)}})
    assert list((v(0, 1) + v(1, 0) + v(2, 0) + v(0, 0) + v(0, 2) + v(1, 1)).terms) == [
        (0, 0),
        (1, 0),
        (0, 1),
        (2, 0),
        (1, 1),
        (0, 2),
    ]


def test_a_coefficient_that_is_not_there_is_zero():
    assert constant(((1, 2),), 2).coefficient((1, 0)) == ((0, 0),)
