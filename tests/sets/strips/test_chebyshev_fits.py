"""Chebyshev fits against linear programs by SciPy."""

import numpy as np
import pytest
from scipy.optimize import linprog

from jaxbound.sets.strips.chebyshev import _Search, fitted


def least(B, b, radius, there, free):
    """Return the least t with |b - B x| <= t r where there are rows, |x_i| <= t r_i where x_i is not free."""
    q = B.shape[1]
    rows = np.concatenate([B[there], np.eye(q)[~free]])
    values = np.concatenate([b[there], np.zeros((~free).sum())])
    ones = radius[np.r_[there, ~free]][:, None]
    found = linprog(
        [0] * q + [1],
        np.block([[rows, -ones], [-rows, -ones]]),
        np.r_[values, -values],
        bounds=[(None, None)] * q + [(0, None)],
    )
    return found.fun


@pytest.mark.parametrize("c, q", [(6, 1), (20, 4), (9, 7), (12, 12)])
def test_the_largest_error_is_that_of_the_program(c, q, rng):
    B, b = rng.normal(size=(40, c, q)), 3 * rng.normal(size=(40, c))
    there, free = rng.random((40, c)) < 0.9, rng.random((40, q)) < 0.2
    radius = 10.0 ** rng.uniform(-2, 1, (40, c + q))
    fit = fitted(B, np.concatenate([b, np.zeros((40, q))], 1), radius, there, free, 1e-9)
    assert not fit.idle.all()
    for n in np.flatnonzero(~fit.idle):
        np.testing.assert_allclose(
            fit.t[n], least(B[n], b[n], radius[n], there[n], free[n]), rtol=1e-7, atol=1e-9
        )
        errors = np.r_[np.where(there[n], b[n] - B[n] @ fit.x[n], 0), np.where(free[n], 0, fit.x[n])]
        np.testing.assert_allclose((np.abs(errors) / radius[n]).max(), fit.t[n], rtol=1e-7, atol=1e-9)
        through = fit.h[n] @ B[n]
        width = np.abs(fit.h[n]) @ radius[n, :c] + np.abs(np.where(free[n], 0, through)) @ radius[n, c:]
        np.testing.assert_allclose(abs(fit.h[n] @ np.where(there[n], b[n], 0)), fit.t[n] * width, atol=1e-7)
        np.testing.assert_allclose(through[free[n]], 0, atol=1e-7 * max(1, width))


@pytest.mark.parametrize("off, factored", [(1e-5, 0), (1.0, 1)])
def test_an_inverse_is_mended_without_a_factorisation_unless_it_is_lost(rng, monkeypatch, off, factored):
    """From 100 rows on a library factors by threads, which wait for each other on a busy machine."""
    inverse, asked = np.linalg.inv, []
    rows = rng.normal(size=(3, 12, 5))
    rows[2] = 1.0  # no basis: what was carried stays
    S = np.array([rng.permutation(12)[:5] for _ in range(3)])
    basis = np.take_along_axis(rows, S[:, :, None], 1)
    P = np.concatenate([inverse(basis[:2]), rng.normal(size=(1, 5, 5))])
    search = _Search(rows, *np.ones((2, 3, 12)), np.ones((3, 12), bool), P.copy(), S, P[0], S[0])
    search.P[1] += off
    monkeypatch.setattr(np.linalg, "inv", lambda x: asked.append(len(x)) or inverse(x))
    search.polished()
    np.testing.assert_allclose(basis[:2] @ search.P[:2], np.broadcast_to(np.eye(5), (2, 5, 5)), atol=1e-8)
    np.testing.assert_array_equal(search.P[2], P[2])
    assert sum(asked) == factored


def test_without_a_row_beside_those_that_tell_there_is_nothing_to_fit():
    B = np.ones((1, 2, 2)) + np.eye(2)
    fit = fitted(B, np.ones((1, 4)), np.ones((1, 4)), np.ones((1, 2), bool), np.ones((1, 2), bool), 1e-9)
    assert fit.idle.all() and (fit.telling >= 0).all()


def test_unknowns_that_rows_do_not_tell_apart_are_not_told_by_rounding(rng):
    """Inputs in a gap, of which rows behind it see what is left of two modes: one goes fast."""
    left = np.array([[0.9], [0.1]]) ** np.arange(20)[::-1]
    F, all_rows = rng.normal(size=(50, 12, 2)) @ left, np.ones((50, 12), bool)
    b = np.concatenate([rng.normal(size=(50, 12)), np.zeros((50, 20))], 1)
    fit = fitted(F, b, np.ones((50, 32)), all_rows, np.ones((50, 20), bool), 1e-9)
    assert not fit.idle.any() and ((fit.telling >= 0).sum(1) == 2).all()


def test_rows_without_unknowns_are_as_far_off_as_the_worst_of_them():
    values, radius = np.array([[1.0, -6, 2]]), np.array([[1.0, 2, 4]])
    there, free = np.ones((1, 3), bool), np.ones((1, 0), bool)
    assert fitted(np.zeros((1, 3, 0)), values, radius, there, free, 0.0).t == [3]
