"""Frames against exact linear algebra by python-flint: the same relations, whatever rows they stand on."""

from fractions import Fraction

import pytest
from oracles import MODELS, Plant, rational_matrix

from jaxbound.exact import frames

GUST = dict(disturbance=([[0], [1]], 0.1))
CASES = {
    "section 5": (MODELS["paper"], 6),
    "no input": (MODELS["no input"], 3),
    "offsets": (MODELS["offsets"], 3),
    "disturbance": (MODELS["paper"] | GUST, 4),
    "unstable": (dict(A=[["1.5", "0.3"], [0, "-1.4"]], B=[[1], [0]], C=[[1, 0], [1, -1]]), 9),
    "vanishing": (dict(A=[["1e-200", 1], [0, "1e-180"]], B=[[0], [1]], C=[[1, 0], [1, 1]]), 4),
    "deficient": (
        dict(A=[[0.5, 0, 0], [0, 0.8, 1], [0, 0, 0.2]], B=[[0], [0], [1]], C=[[0, 1, 0], [0, 2, 0]]),
        3,
    ),
}


def equation(name):
    numbers, s = CASES[name]
    return Plant(**numbers).equation(s)


def as_relations(frame, rows):
    """Return the relations h y = k u, one of each outer row, as rows (h, -k)."""
    out = []
    for j, R, K in zip(frame.outer, frame.R, frame.K, strict=True):
        h = [Fraction(0)] * rows
        for i, x in zip(frame.inner, R, strict=True):
            h[i] = -x
        h[j] = Fraction(1)
        out.append((h, [-x for x in K]))
    return out


def check(frame, E, K):
    """Its relations hold exactly, are independent, and are all there are."""
    relations = as_relations(frame, len(E))
    # independent: each has an outer row of its own
    assert len(relations) == len(E) - rational_matrix(E).rank()
    if relations:
        H = rational_matrix([h for h, _ in relations])
        assert not any((H * rational_matrix(E)).entries())
        if K[0]:
            assert H * rational_matrix(K) == rational_matrix([[-x for x in k] for _, k in relations])


@pytest.mark.parametrize("name", CASES)
def test_a_frame_holds_all_relations_and_nothing_else(name):
    E, K = equation(name)
    check(frames.frame(E, K), E, K)


@pytest.mark.parametrize("name", CASES)
def test_no_coefficient_of_a_frame_exceeds_two(name):
    frame = frames.frame(*equation(name))
    assert max(abs(x) for row in frame.R for x in row) <= 2
    assert sorted(frame.inner + frame.outer) == list(range(len(frame.inner) + len(frame.outer)))


def test_a_frame_without_unknowns_has_no_inner_rows():
    frame = frames.frame(((Fraction(0),), (Fraction(0),)), ((Fraction(3),), (Fraction(0),)))
    assert frame.inner == () and frame.outer == (0, 1) and [*map(tuple, frame.K)] == [(3,), (0,)]


def test_random_rows_of_low_rank(rng):
    for _ in range(3):
        E = [
            [
                Fraction(int(a), int(b))
                for a, b in zip(rng.integers(-9, 10, 3), rng.integers(1, 9, 3), strict=True)
            ]
            for _ in range(9)
        ]
        E = (
            [[*row, row[0] - 2 * row[2]] for row in E]
            + [[Fraction(0)] * 4]
            + [E[0] + [E[0][0] - 2 * E[0][2]]]
        )
        K = [[Fraction(int(v)) for v in rng.integers(-3, 4, 2)] for _ in E]
        frame = frames.frame(tuple(map(tuple, E)), tuple(map(tuple, K)))
        check(frame, E, K)
