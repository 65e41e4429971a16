"""Two sets by the thousand: do they meet, is one in the other? Against linear programs, certificates and
exact numbers.
"""

from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import linprog
from zonotope_cases import FAR, KINDS, agree, confirmed, drawn, near, program

from jaxbound.sets import Answer, contains, intersects, zonotope
from jaxbound.sets.zonotopes.facets import exact_strips


def pairs(rng, n, q, kind, count):
    """Return (X, Y, gauges): pairs whose centers are at known factors of the distance at which they touch."""
    G, H = (np.array([drawn(rng, n, q, kind) for _ in range(count)]) for _ in range(2))
    t, shift = near(rng, count), rng.normal(size=(count, n)) * abs(G).sum(2)
    shift *= np.array(
        [f / program(np.hstack([g, -h]), s) for f, g, h, s in zip(t, G, H, shift, strict=True)]
    )[:, None]
    return zonotope(np.zeros((count, n)), G), zonotope(shift, H), t


def inclusions(rng, n, q, kind, count):
    """Return (outer, inner, least factors on the outer generators at which a linear program finds the
    condition for YES).
    """
    G = np.array([drawn(rng, n, q, kind) for _ in range(count)])
    inner = G @ (rng.normal(size=(count, q, 3)) * (rng.random((count, q, 3)) < 0.7))
    center = 0.5 * inner[..., 0] * rng.normal(size=(count, 1))
    t = near(rng, count)
    found = np.array([encoding(g, np.c_[c, h]) for g, c, h in zip(G, center, inner, strict=True)])
    size, t = t / np.where(found > 0, found, 1), np.where(found > 0, t, 0)  # 0: the inner set is the center
    return zonotope(np.zeros((count, n)), G), zonotope(center * size[:, None], inner * size[:, None, None]), t


def encoding(G, D):
    """Return the least t with M X = D for an X with row sums of |X| of at most t: Sadraddini, Tedrake
    2019.
    """
    (n, q), p = G.shape, D.shape[1]
    size = 2 * q * p  # X = positive - negative parts, one after another, and t
    equations = np.hstack([np.kron(G, np.eye(p)), -np.kron(G, np.eye(p)), np.zeros((n * p, 1))])
    rows = np.hstack([np.kron(np.eye(q), np.ones((1, p)))] * 2 + [-np.ones((q, 1))])
    found = linprog(
        np.r_[np.zeros(size), 1],
        A_ub=rows,
        b_ub=np.zeros(q),
        A_eq=equations,
        b_eq=D.ravel(),
        bounds=(0, None),
    )
    assert found.status == 0, found.message
    return found.fun


def exactly_held(G, shift, H):
    """Return whether a zonotope is in another, by all facets of that in exact numbers."""
    dot = lambda v, w: sum((a * Fraction(float(b)) for a, b in zip(v, w, strict=True)), Fraction(0))
    return all(
        abs(dot(normal, shift)) + sum(abs(dot(normal, h)) for h in H.T) <= width
        for normal, width in exact_strips(zonotope(0 * shift, G))
    )


def meets_wrong_and_open(rng, sizes, kinds, count):
    wrong = left = 0
    for n, q in sizes:
        for kind in kinds:
            X, Y, t = pairs(rng, n, q, kind, count)
            w, o = agree(intersects(X, Y), t, Answer.YES)
            wrong, left = wrong + w, left + o
    return wrong, left


def inclusions_wrong_and_open(rng, sizes, kinds, count):
    """Return (wrong by certificate or exact facets, left open where the condition for YES holds by 1e-6)."""
    wrong = left = 0
    for n, q in sizes:
        for kind in kinds:
            Z, Y, t = inclusions(rng, n, q, kind, count)
            found = contains(Z, Y)
            left += (
                ~found.yes & (t < 1 - 1e-6)
            ).sum()  # NO would be wrong, UNDECIDED open: YES is what a linear program proves
            wrong += (found.no & (t < 1 - FAR)).sum()
            for i in np.nonzero(found.answer)[0]:
                G, c, H = (np.asarray(v[i]) for v in (Z.generators, Y.center, Y.generators))
                if n == 2:
                    wrong += bool(found.yes[i]) != exactly_held(G, c, H)
                elif found.no[i]:
                    wrong += not confirmed(found, (i,))
                elif (
                    t[i] > 1 + FAR
                ):  # the condition is not necessary: all facets may say yes where it does not hold
                    wrong += not exactly_held(G, c, H)
    return wrong, left


def test_some_pairs_and_inclusions_are_decided_as_by_linear_programs_and_exact_numbers(rng):
    assert meets_wrong_and_open(rng, [(2, 5)], KINDS, 6) == (0, 0)
    assert inclusions_wrong_and_open(rng, [(2, 5)], ["general", "integer"], 6) == (0, 0)


@pytest.mark.long(
    by_day="sets/zonotopes/test_decisions::test_two_sets_meet_where_a_linear_program_says_so_and_are_separated_where_not"
)
def test_ten_thousand_pairs_of_sets_are_decided_as_by_linear_programs(rng):
    wrong, left = meets_wrong_and_open(rng, [(1, 3), (2, 5), (3, 8), (5, 9), (12, 24)], KINDS, 500)
    print(f"10000 pairs: {wrong} wrong, {left} open")
    assert wrong == 0 and left <= 10


@pytest.mark.long(
    by_day="sets/zonotopes/test_decisions::test_a_zonotope_shrunk_is_held_and_one_that_reaches_out_is_not"
)
def test_ten_thousand_inclusions_are_decided_as_by_linear_programs_and_exact_numbers(rng):
    wrong, left = inclusions_wrong_and_open(rng, [(1, 3), (2, 5), (3, 7), (5, 9)], KINDS, 625)
    print(f"10000 inclusions: {wrong} wrong, {left} open where the condition for YES holds")
    assert wrong == 0 and left <= 100
