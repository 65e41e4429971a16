"""Frames and their changes against exact linear algebra by python-flint: the same relations, whatever rows
they stand on.
"""

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
    """Return the relations h y = k u, one of each used outer row, as rows (h, -k)."""
    out = []
    for j, used, R, K in zip(frame.outer, frame.used, frame.R, frame.K, strict=True):
        h = [Fraction(0)] * rows
        for i, x in zip(frame.inner, R, strict=True):
            h[i] = -x
        h[j] = Fraction(1)
        if used:
            out.append((j, h, [-x for x in K]))
    return out


def kernel_size(E, K, absent, missing):
    """Return how many independent relations need neither the rows `absent` nor the known values `missing`."""
    present = [i for i in range(len(E)) if i not in absent]
    unknown = [list(E[i]) + [K[i][b] for b in missing] for i in present]
    return len(present) - rational_matrix(unknown).rank()


def check(frame, E, K, absent=(), missing=()):
    """Its relations that are still there hold exactly, are independent, and are all there are."""
    usable = [(h, k) for j, h, k in as_relations(frame, len(E)) if j not in absent]
    assert len(usable) == kernel_size(E, K, absent, missing)  # independent: each has an outer row of its own
    if usable:
        H = rational_matrix([h for h, _ in usable])
        assert not any((H * rational_matrix(E)).entries())
        if K[0]:
            assert H * rational_matrix(K) == rational_matrix([[-x for x in k] for _, k in usable])
    for h, k in usable:
        assert not any(h[i] for i in absent) and not any(k[b] for b in missing)


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
    assert frame.inner == () and frame.outer == (0, 1) and frame.K == ((3,), (0,))


@pytest.mark.parametrize("name", CASES)
def test_a_changed_frame_holds_all_relations_that_need_nothing_absent(name, rng):
    E, K = equation(name)
    frame = frames.frame(E, K)
    for trial in range(30):
        absent = set(rng.permutation(len(E))[: rng.integers(0, 6)].tolist())
        if trial % 3 == 0:
            absent |= set(rng.choice(frame.inner, min(3, len(frame.inner)), replace=False).tolist())
        missing = tuple(sorted(rng.permutation(len(K[0]))[: rng.integers(0, 4)].tolist()))
        check(frames.reframe(frame, absent, missing), E, K, absent, missing)


@pytest.mark.parametrize("name", CASES)
def test_every_single_row_can_be_absent(name):
    E, K = equation(name)
    frame = frames.frame(E, K)
    for i in range(len(E)):
        check(frames.reframe(frame, {i}, ()), E, K, {i})


def test_rows_that_nothing_can_replace_keep_their_place_and_matter_to_nothing():
    E, K = equation("section 5")
    frame = frames.frame(E, K)
    everything = set(range(2, len(E)))  # two rows are left for two unknowns
    left = frames.reframe(frame, everything, ())
    assert kernel_size(E, K, everything, ()) == 0
    check(left, E, K, everything)


def test_the_oracle_finds_fewer_relations_without_a_row_that_matters():
    E, K = equation("section 5")
    assert kernel_size(E, K, (), ()) - 1 == kernel_size(E, K, {3}, ()) == kernel_size(E, K, (), (0,))


@pytest.mark.parametrize("seed", range(3))
def test_random_rows_of_low_rank(seed, rng):
    E = [
        [
            Fraction(int(a), int(b))
            for a, b in zip(rng.integers(-9, 10, 3), rng.integers(1, 9, 3), strict=True)
        ]
        for _ in range(9)
    ]
    E = [[*row, row[0] - 2 * row[2]] for row in E] + [[Fraction(0)] * 4] + [E[0] + [E[0][0] - 2 * E[0][2]]]
    K = [[Fraction(int(v)) for v in rng.integers(-3, 4, 2)] for _ in E]
    frame = frames.frame(tuple(map(tuple, E)), tuple(map(tuple, K)))
    check(frame, E, K)
    for _ in range(10):
        absent = set(rng.permutation(len(E))[:4].tolist())
        check(frames.reframe(frame, absent, (0, 1)), E, K, absent, (0, 1))
