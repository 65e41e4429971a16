"""Sparse exact null spaces against python-flint."""

from fractions import Fraction

import flint
import numpy as np
import pytest

from jaxbound.exact.sparse import null_space, pivot_columns


def system(rng, equations, unknowns, density, largest=9):
    """Return random sparse equations, some of them combinations of others, and the same as a flint matrix."""
    rows = rng.integers(-largest, largest + 1, (equations, unknowns)) * (
        rng.random((equations, unknowns)) < density
    )
    if equations > 4:
        rows[-2:] = rows[:2] * 3 - rows[2:4]
    dense = (
        flint.fmpz_mat(equations, unknowns, [int(x) for x in rows.ravel()])
        if equations
        else flint.fmpz_mat(0, unknowns)
    )
    return [{j: int(x) for j, x in enumerate(row) if x} for row in rows], dense


@pytest.mark.parametrize(
    "equations, unknowns, density",
    [(3, 5, 0.5), (30, 20, 0.2), (40, 60, 0.05), (25, 25, 0.3), (60, 12, 0.3), (5, 40, 0.02)],
)
def test_null_space_is_complete_and_reduced(equations, unknowns, density, rng):
    for _ in range(5):
        rows, dense = system(rng, equations, unknowns, density)
        kept = [dict(row) for row in rows]
        found = null_space(rows, unknowns)
        assert rows == kept  # what was given is not touched
        assert len(found) == unknowns - dense.rank()
        for solution in found:
            assert all(
                sum((x * solution.get(j, 0) for j, x in row.items()), Fraction(0)) == 0 for row in rows
            )
        firsts = [min(solution) for solution in found]
        assert firsts == sorted(set(firsts)) and all(s[f] == 1 for s, f in zip(found, firsts, strict=True))
        assert all(f not in s or s[f] == 1 and min(s) == f for s in found for f in firsts)


def test_null_space_does_not_depend_on_the_order_or_scale_of_the_equations(rng):
    rows, _ = system(rng, 20, 25, 0.15)
    shuffled = [{k: -7 * x for k, x in rows[i].items()} for i in rng.permutation(20)]
    assert null_space(rows, 25) == null_space(shuffled, 25)


def test_no_equation_leaves_every_unknown_free():
    assert null_space([], 2) == [{0: 1}, {1: 1}] == null_space([{}], 2)


def test_pivot_columns_are_those_of_the_echelon_form(rng):
    for _ in range(20):
        rows, dense = system(rng, 8, 12, 0.3)
        echelon, rank = flint.fmpq_mat(dense).rref()
        expected = [next(j for j in range(12) if echelon[i, j] != 0) for i in range(rank)]
        assert pivot_columns([{k: Fraction(x) for k, x in row.items()} for row in rows]) == expected


def test_numbers_may_grow_without_bound():
    rows = [{i: 10**9 + i, i + 1: -(10**9) - i * i - 1} for i in range(30)]
    (solution,) = null_space(rows, 31)
    exact = Fraction(1)
    for i in range(30):
        assert solution[i] == exact
        exact *= Fraction(10**9 + i, 10**9 + i * i + 1)
    assert np.isclose(float(solution[30]), float(exact), rtol=1e-15)
