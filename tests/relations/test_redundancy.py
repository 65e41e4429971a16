"""Minimal polynomial relations: the paper's example, golden's corrections, and degrees of random systems by
python-flint.
"""

import itertools
import json
from fractions import Fraction

import flint
import numpy as np
import pytest
from oracles import Plant, rational_matrix, times

import jaxbound as jb
from jaxbound.relations import shift

SCALES = (1, Fraction(1000), Fraction(1, 1000))


@pytest.fixture(scope="module")
def ragot(shared):
    return json.loads(shared("golden/ragot1993.json").read_text())


def example(ragot, unknown=("v",)):
    """Return the paper's system with some of v, u1, u2 unknown."""
    s = ragot["system"]
    columns = {"v": s["F"], "u1": [row[0] for row in s["B"]], "u2": [row[1] for row in s["B"]]}
    F = [list(row) for row in zip(*(columns[name] for name in unknown), strict=True)] if unknown else None
    return jb.LinearSystem(s["A"], s["B"], s["C"], unknown_inputs=F)


def polynomial_rows(rows):
    """Read golden's rows, numbers by ascending powers, as rows of polynomials."""
    return [
        tuple(shift.trim([Fraction(x) for x in column]) for column in zip(*row, strict=True)) for row in rows
    ]


def rank_over_q(rows, q):
    return rational_matrix([list(shift.at(row, Fraction(q))) for row in rows]).rank()


def same_module(rows, others):
    """Two bases of equal degrees span the same module iff they span the same space of window relations."""
    longest = max(map(shift.degree, (*rows, *others)))

    def space(rows):
        out = []
        for row in rows:
            numbers = shift.coefficients(row)
            for late in range(longest + 1 - len(numbers) + 1):
                padded = [[Fraction(0)] * len(row)] * late + [list(x) for x in numbers]
                padded += [[Fraction(0)] * len(row)] * (longest + 1 - len(padded))
                out.append([x for now in padded for x in now])
        return out

    a, b = space(rows), space(others)
    ranks = {rational_matrix(x).rank() for x in (a, b, a + b)}
    return len(ranks) == 1


def test_the_basis_of_the_example_is_the_papers(ragot):
    r = jb.redundancy(example(ragot))
    printed = polynomial_rows([ragot["residual_rows_ascending_q_coefs"][name] for name in ("r2", "r3", "r1")])
    expected = sorted(shift.presentable_row(row) for row in printed)
    assert sorted(r.rows) == expected and r.degrees.tolist() == [1, 1, 2]
    assert r.text().splitlines()[-1] == "r3: (q^2 - 2 q) y1 - (2 q^2 - 4 q + 2) y3 + (2 q - 2) u2 = 0"
    assert r.My.shape == (3, 3, 4) and r.Mu.shape == (3, 3, 2)
    np.testing.assert_array_equal(r.My[2].astype(float), [[0, 0, -2, 0], [-2, 0, 4, 0], [1, 0, -2, 0]])
    np.testing.assert_array_equal(r.Mu[2].astype(float), [[0, -2], [0, 2], [0, 0]])


@pytest.mark.parametrize("method", ["window", "elimination"])
@pytest.mark.parametrize("unknown", ["v", "", "u1", "u2", "u1,v", "u2,v", "u1,u2", "u1,u2,v"])
def test_indices_and_module_are_golden_for_every_choice_of_unknown_inputs(ragot, unknown, method):
    known = ragot["forney_and_window"][unknown or "none"]
    r = jb.redundancy(example(ragot, [x for x in unknown.split(",") if x]), method)
    golden = polynomial_rows(
        [
            [y + [Fraction(x) for x in u] for y, u in zip(b["My"], b["Mu"], strict=True)]
            for b in known["basis"]
        ]
    )
    assert r.degrees.tolist() == known["forney"] and same_module(r.rows, golden)


@pytest.mark.parametrize(
    "bank, unknown, rows",
    [
        ("bank1", ("u1",), ("r11(u1 unknown,v=0)", "r12(u1 and v unknown ok)", "r13(u1 unknown,v=0)")),
        ("bank2", ("u2",), ("r21(u2 unknown,v=0)", "r22(u2 unknown,v=0)", "r23(u2 and v unknown ok)")),
        ("sensors alone", ("u1", "u2", "v"), ("sensor_only",)),
    ],
)
def test_the_printed_banks_span_the_module(ragot, bank, unknown, rows):
    printed = polynomial_rows([ragot["residual_rows_ascending_q_coefs"][name] for name in rows])
    assert same_module(jb.redundancy(example(ragot, unknown)).rows, printed), bank


def product(a, b):
    """Return the product of two matrices of polynomials in q."""
    out = []
    for row in a:
        total = [[Fraction(0)] * 20 for _ in b[0]]
        for x, other in zip(row, b, strict=True):
            for place, y in zip(total, other, strict=True):
                for (i, one), (j, two) in itertools.product(enumerate(x), enumerate(y)):
                    place[i + j] += one * two
        out.append(tuple(map(shift.trim, total)))
    return tuple(out)


def test_combinations_of_the_example(ragot):
    """Golden's corrections: W of the paper and the better one, W M_u, and the stable form of the second W."""
    by_degree = jb.redundancy(example(ragot)).rows
    r3, r2, r1 = (next(row for row in by_degree if row[i]) for i in (3, 1, 0))
    r3 = tuple(tuple(-c for c in p) for p in r3)
    M = (r1, r2, r3)
    p = lambda *numbers: shift.trim([Fraction(x) for x in numbers])
    zero, one = (), p(1)
    printed = ((one, p(-2, 2), p(4, -4)), (zero, zero, p(-1)), (one, zero, zero))
    better = ((one, p(-2, 2), p(4, -4)), (zero, zero, p(-1)), (zero, one, p(-2)))
    known = lambda W: tuple(row[4:] for row in product(W, M))
    assert known(printed) == ((zero, zero), (one, zero), (zero, p(-2, 2)))
    assert known(better) == ((zero, zero), (one, zero), (zero, p(-1)))
    names = ("e1", "e2", "e3_improved")
    assert list(product(better, M)) == polynomial_rows(
        [ragot["residual_rows_ascending_q_coefs"][name] for name in names]
    )
    stable = ((one, zero, zero), (zero, one, p(-2)), (zero, zero, p(-1)))
    isolating = tuple(
        tuple(row[i] for i in (0, 1, 4)) for row in product(stable, M)
    )  # outputs 1 and 2 and input 1
    assert isolating == ((p(0, -2, 1), zero, zero), (zero, p(-1, 1), zero), (zero, zero, one))
    assert (
        rank_over_q([tuple(row[i] for i in (1, 3, 4)) for row in M], 7) == 2
    )  # outputs 2 and 4 and input 1: not isolable


def test_relations_vanish_on_the_golden_trajectory(ragot):
    t = ragot["trajectory"]
    r = jb.redundancy(example(ragot))
    W, K = r.windows()
    Y, U = t["Y_healthy"], t["U"]
    for k in range(r.horizon, len(Y)):
        y = [Fraction(x) for row in Y[k - r.horizon : k + 1] for x in row]
        u = [Fraction(x) for row in U[k - r.horizon : k] for x in row]
        assert times(W, [[x] for x in y]) == times(K, [[x] for x in u])


def test_where_unknown_inputs_do_not_show_at_once_only_the_window_finds_relations(ragot):
    for case in ragot["matching_condition"].values():
        m = jb.LinearSystem(case["A"], None, case["C"], unknown_inputs=case["F"])
        (expected,) = case["basis"]
        r = jb.redundancy(m)
        assert r.degrees.tolist() == case["forney"] == [expected[0]]
        rows = polynomial_rows([[expected[1][j : j + 2] for j in range(0, 6, 2)]])
        assert same_module(r.rows, rows)
        if case["rankCF"]:
            assert same_module(jb.redundancy(m, "elimination").rows, r.rows)
        else:
            with pytest.raises(
                ValueError,
                match=r"needs rank\(C F\) = rank F, .* rank\(C F\) is 0, rank F is 1; use method='window'",
            ):
                jb.redundancy(m, "elimination")


def random_system(rng, n, p, m, d, sparse, direct):
    """Return the keywords of a random system: decimals of one digit, or sparse small integers, scaled up and
    down by a thousand.
    """
    draw = lambda r, c: [
        [Fraction(int(x), 1 if sparse else 10) for x in row]
        for row in rng.integers(-9, 10, (r, c)) * (rng.uniform(size=(r, c)) < (0.3 if sparse else 1.0))
    ]
    scale = [SCALES[i] for i in rng.integers(0, 3, n)]
    own = [SCALES[i] for i in rng.integers(0, 3, d)]
    A = [[x * scale[i] / scale[j] for j, x in enumerate(row)] for i, row in enumerate(draw(n, n))]
    B = [[x * scale[i] for x in row] for i, row in enumerate(draw(n, m))]
    F = [[x * scale[i] * own[j] for j, x in enumerate(row)] for i, row in enumerate(draw(n, d))]
    C = [[x / scale[j] for j, x in enumerate(row)] for row in draw(p, n)]
    D_v = [[x * own[j] for j, x in enumerate(row)] for row in draw(p, d)] if direct else [[0] * d] * p
    return dict(A=A, B=B, C=C, unknown_inputs=(F, D_v))


def degrees_by_flint(plant, longest):
    """Return the Forney indices from the nullities d_h of windows: their number of value h is d_h - 2 d_{h-1}
    + d_{h-2}.
    """
    A, F, power = rational_matrix(plant.A), rational_matrix(plant.F), rational_matrix(plant.C)
    on_state, on_unknown, none = (
        [power],
        [rational_matrix(plant.D_v)],
        rational_matrix([[Fraction(0)] * plant.d] * plant.p),
    )
    for _ in range(longest):
        on_unknown.append(power * F)
        power = power * A
        on_state.append(power)
    null = [0, 0]
    for h in range(longest + 1):
        rows = []
        for j in range(h + 1):
            blocks = [on_state[j], *(on_unknown[j - k] if k <= j else none for k in range(h + 1))]
            rows += [sum(parts, []) for parts in zip(*(block.tolist() for block in blocks), strict=True)]
        null.append(len(rows) - flint.fmpq_mat(len(rows), len(rows[0]), sum(rows, [])).rank())
    return [h for h in range(longest + 1) for _ in range(null[h + 2] - 2 * null[h + 1] + null[h])]


@pytest.mark.parametrize("count, largest", [(60, 5), pytest.param(500, 10, marks=pytest.mark.long)])
def test_degrees_of_random_systems_are_exact_and_the_elimination_agrees_or_says_why_not(count, largest, rng):
    agreed = refused = 0
    for i in range(count):
        n, p = int(rng.integers(1, largest + 1)), int(rng.integers(2, 5))
        d = int(rng.integers(1, min(3, p) + 1))
        spec = random_system(rng, n, p, 1, d, sparse=i % 2, direct=i % 5 == 0)
        plant, m = Plant(**spec), jb.LinearSystem(**spec)
        r, expected = jb.redundancy(m), degrees_by_flint(plant, n)
        assert r.degrees.tolist() == expected
        if r.count and n <= 5:
            E, H = plant.equation(r.horizon)
            W, K = r.windows()
            assert not any(x for row in times(W, E) for x in row) and [list(k) for k in K] == times(W, H)
        shows = (
            rational_matrix(times(plant.C, plant.F)).rank() == rational_matrix(plant.F).rank()
        ) and not m.has_direct_unknown
        if shows:
            assert jb.redundancy(m, "elimination").degrees.tolist() == expected
            agreed += 1
        else:
            with pytest.raises(ValueError, match="use method='window'"):
                jb.redundancy(m, "elimination")
            refused += 1
    assert agreed > count / 10 and refused > count / 10


def test_golden_random_systems(ragot):
    for name, case in ragot["random_systems"].items():
        a = case["matrices"]  # its D is that of the unknown inputs
        r = jb.redundancy(jb.LinearSystem(a["A"], None, a["C"], unknown_inputs=(a["F"], a["D"])))
        assert r.degrees.tolist() == case["forney_exact"], name


def test_an_unknown_method_is_refused(ragot):
    with pytest.raises(ValueError, match="method must be one of window, elimination, not 'svd'"):
        jb.redundancy(example(ragot), "svd")
    with pytest.raises(ValueError, match="D_v is not zero; use method='window'"):
        jb.redundancy(
            jb.LinearSystem([[1]], None, [[1], [1]], unknown_inputs=([[1]], [[0], [1]])), "elimination"
        )
