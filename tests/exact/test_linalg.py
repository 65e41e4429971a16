"""Exact linear algebra, against python-flint, brute force and the values of the papers."""

from decimal import Decimal
from fractions import Fraction
from itertools import combinations
from math import comb, gcd

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits

OBSERVABILITY = [[1, 0], [1, 1], ["4/5", 1], ["4/5", "6/5"]]  # Adrot 2000, section 5, horizon 1


# what an independent library says


def as_flint(a, columns):
    return flint.fmpq_mat(len(a), columns, [flint.fmpq(x.numerator, x.denominator) for row in a for x in row])


def flint_rank(a, columns):
    return as_flint(a, columns).rank()


def left_null_vectors(rows):
    """Return a basis of {h : h a = 0} of an integer matrix by flint, one list of ints a vector."""
    transposed = flint.fmpz_mat([list(column) for column in zip(*rows, strict=True)])
    basis, nullity = transposed.nullspace()
    return [[int(basis[i, j]) for i in range(len(rows))] for j in range(nullity)]


def brute_circuits(rows):
    """Return all h with h a = 0 and minimal support: subsets by size, those that hold a smaller support left
    out.
    """
    found = {}
    for size in range(1, len(rows) + 1):
        for subset in combinations(range(len(rows)), size):
            if any(set(support) <= set(subset) for support in found):
                continue
            null = left_null_vectors([rows[i] for i in subset])
            if null:
                assert len(null) == 1 and all(null[0])
                found[subset] = null[0]
    return found


def small_matrix(rng):
    """Draw an integer matrix, often degenerate: zero rows, repeated rows, too little rank."""
    m, n = rng.integers(1, 7), rng.integers(1, 4)
    a = rng.integers(-3, 4, (m, n))
    kind = rng.integers(0, 5)
    if kind == 1:
        a[rng.integers(0, m)] = 0
    if kind == 2 and m > 1:
        a[0] = rng.choice([1, -2]) * a[1]
    if kind == 3:
        a = np.outer(rng.integers(-2, 3, m), rng.integers(-2, 3, n))
    if kind == 4:
        a[:, 0] = 0
    return a.tolist()


def is_zero(a):
    return not any(x for row in a for x in row)


def proportional(a, b):
    return all(x * w == y * v for x, y in zip(a, b, strict=True) for v, w in zip(a, b, strict=True))


# rational


@pytest.mark.parametrize(
    ("value", "want"),
    [
        (0.1, Fraction(1, 10)),
        (-2.5e-3, Fraction(-1, 400)),
        (1e300, Fraction(10) ** 300),
        (5e-324, Fraction(5, 10**324)),
        (np.float64(0.1), Fraction(1, 10)),
        (np.float32(0.1), Fraction(1, 10)),
        (np.float16(0.1), Fraction(1, 10)),
        (np.array(0.1, np.float32), Fraction(1, 10)),
        (3, Fraction(3)),
        (np.int8(-3), Fraction(-3)),
        (2**70 + 1, Fraction(2**70 + 1)),
        (True, Fraction(1)),
        ("1/3", Fraction(1, 3)),
        ("0.2", Fraction(1, 5)),
        (" 1e-3 ", Fraction(1, 1000)),
        (Decimal("0.1"), Fraction(1, 10)),
        (Fraction(2, 7), Fraction(2, 7)),
    ],
    ids=lambda x: type(x).__name__,
)
def test_rational_reads_numbers_exactly_and_floats_as_their_shortest_decimal(value, want):
    assert linalg.rational(value) == want and type(linalg.rational(value)) is Fraction


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rational_reads_jax_scalars_as_their_shortest_decimal(dtype):
    assert linalg.rational(jnp.asarray(0.1, dtype)) == Fraction(1, 10)


@pytest.mark.parametrize(
    "value",
    [
        np.nan,
        np.inf,
        -np.inf,
        np.float32(np.nan),
        Decimal("NaN"),
        Decimal("Infinity"),
        "",
        "abc",
        "nan",
        "1/0",
        None,
        [1],
        1j,
        object(),
    ],
    ids=lambda x: type(x).__name__,
)
def test_rational_refuses_what_is_no_finite_number(value):
    with pytest.raises(ValueError, match="is not a finite number"):
        linalg.rational(value)


@pytest.mark.parametrize(
    "a",
    [
        [[0.1, 2], ["1/3", Decimal("0.5")]],
        np.array([[0.1, 2], [1 / 3, 0.5]], object),
        ((0.1, 2), (Fraction(1, 3), "1/2")),
    ],
    ids=["lists", "objects", "tuples"],
)
def test_matrix_reads_nested_sequences(a):
    m = linalg.matrix(a)
    assert m[0] == (Fraction(1, 10), Fraction(2)) and m[1][1] == Fraction(1, 2)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
@pytest.mark.parametrize("build", [np.asarray, jnp.asarray], ids=["numpy", "jax"])
def test_matrix_reads_an_array_as_the_shortest_decimals_of_its_dtype(dtype, build):
    assert linalg.matrix(build(np.array([[0.1, 0.3]], dtype))) == ((Fraction(1, 10), Fraction(3, 10)),)


def test_matrix_makes_a_vector_a_column():
    assert (
        linalg.matrix([1, "1/2"]) == ((Fraction(1),), (Fraction(1, 2),)) == linalg.matrix(np.array([1, 0.5]))
    )


def test_matrix_refuses_ragged_rows():
    with pytest.raises(ValueError, match=r"different lengths: \[2, 1\]"):
        linalg.matrix([[1, 2], [3]])


# linear algebra


def test_row_reduce_agrees_with_flint(rng):
    for _ in range(40):
        a = linalg.matrix(small_matrix(rng))
        reduced, rank = as_flint(a, len(a[0])).rref()
        ours, pivots = linalg.row_reduce(a)
        theirs = [
            [Fraction(int(reduced[i, j].p), int(reduced[i, j].q)) for j in range(len(a[0]))]
            for i in range(rank)
        ]
        assert [list(r) for r in ours] == theirs and len(pivots) == rank == linalg.rank(a)


def test_left_null_space_is_a_basis_of_all_that_annihilates(rng):
    for _ in range(40):
        rows = small_matrix(rng)
        a = linalg.matrix(rows)
        W = linalg.left_null_space(a)
        assert len(W) == len(left_null_vectors(rows)) == len(a) - linalg.rank(a)
        assert not W or is_zero(linalg.matmul(W, a)) and flint_rank(W, len(a)) == len(W)


def test_inverse_times_the_matrix_is_the_identity(rng):
    for _ in range(10):
        a = linalg.matrix((rng.integers(-5, 6, (4, 4)) + 20 * np.eye(4, dtype=int)).tolist())
        assert linalg.matmul(linalg.inverse(a), a) == linalg.matrix(np.eye(4, dtype=int))


def test_inverse_refuses_a_singular_matrix():
    with pytest.raises(ValueError, match="singular"):
        linalg.inverse(linalg.matrix([[1, 2], [2, 4]]))


@pytest.mark.parametrize("a", [[[1, 0, 2], [0, 1, 3]], [[1, 0], [0, 1], [1, 1]]])
def test_inverse_refuses_a_matrix_that_is_not_square(a):
    with pytest.raises(ValueError, match="square"):
        linalg.inverse(linalg.matrix(a))


def test_matmul_agrees_with_flint(rng):
    for _ in range(10):
        fractions = lambda: [
            [Fraction(int(n), int(d)) for n, d in zip(*rng.integers(1, 9, (2, 3)), strict=True)]
            for _ in range(3)
        ]
        a, b = linalg.matrix(fractions()), linalg.matrix(fractions())
        assert as_flint(linalg.matmul(a, b), 3) == as_flint(a, 3) * as_flint(b, 3)


def test_matmul_refuses_shapes_that_do_not_fit():
    with pytest.raises(ValueError, match="a row of 2 numbers times a matrix of 1 rows"):
        linalg.matmul(linalg.matrix([[1, 2]]), linalg.matrix([[1, 2]]))


def test_empty_matrices_have_empty_answers():
    assert linalg.row_reduce(()) == ((), ()) and linalg.rank(()) == 0
    assert linalg.left_null_space(()) == () == circuits(()) == linalg.minimal_span(())
    assert linalg.left_null_space(((), ())) == linalg.matrix([[1, 0], [0, 1]])


def test_primitive_scales_to_coprime_integers_with_a_positive_head():
    assert linalg.primitive(linalg.matrix([["0", "-2/3", "4/9"]])[0]) == (0, 3, -2)
    assert linalg.primitive((Fraction(0),) * 2) == (0, 0)


# minimal span


def test_minimal_span_gives_the_relations_of_the_paper():
    W = linalg.minimal_span(linalg.left_null_space(linalg.matrix(OBSERVABILITY)))
    assert W == linalg.matrix([[1, -5, 5, 0], [0, 4, -10, 5]])


def test_minimal_span_keeps_the_row_space_with_different_starts_and_ends(rng):
    for _ in range(40):
        a = linalg.matrix(rng.integers(-2, 3, (rng.integers(1, 5), rng.integers(1, 7))).tolist())
        W = linalg.minimal_span(a)
        assert len(W) == linalg.rank(a) == linalg.rank([*a, *W])
        spans = [[j for j, x in enumerate(row) if x] for row in W]
        assert len({s[0] for s in spans}) == len({s[-1] for s in spans}) == len(W)
        assert [s[0] for s in spans] == sorted(s[0] for s in spans)
        assert all(x.denominator == 1 for row in W for x in row) and all(
            gcd(*map(int, row)) == 1 for row in W
        )


def test_no_basis_spans_fewer_columns_than_the_minimal_one(rng):
    for _ in range(10):
        a = linalg.matrix(rng.integers(-2, 3, (3, 6)).tolist())
        W = linalg.minimal_span(a)
        span = lambda row: max(j for j, x in enumerate(row) if x) - min(j for j, x in enumerate(row) if x)
        best = sum(map(span, W))
        mixtures = [
            linalg.matmul(linalg.matrix(rng.integers(-2, 3, (len(W), len(W))).tolist()), W) for _ in range(30)
        ]
        bases = [mixed for mixed in mixtures if linalg.rank(mixed) == len(W)]
        assert bases and min(sum(map(span, basis)) for basis in bases) >= best


# circuits


def test_circuits_of_the_paper_are_those_of_the_golden_file(golden):
    want = golden["p0"]["static"]["value"]["circuits_s1_drop_col"]
    want = {linalg.primitive(tuple(map(Fraction, row))) for row in want}
    assert set(circuits(linalg.matrix(OBSERVABILITY))) == want and len(want) == 4


@pytest.mark.parametrize("horizon", range(1, 7))
def test_the_paper_system_has_as_many_circuits_as_subsets_of_n_plus_1_rows(horizon):
    A, C = linalg.matrix([[0.8, 1], [0, 0.2]]), linalg.matrix([[1, 0], [1, 1]])
    rows, power = [], linalg.matrix([[1, 0], [0, 1]])
    for _ in range(horizon + 1):
        rows += linalg.matmul(C, power)
        power = linalg.matmul(A, power)
    found = circuits(tuple(rows))
    assert (
        len(found) == len(set(found)) == comb(2 * (horizon + 1), 3) == [4, 20, 56, 120, 220, 364][horizon - 1]
    )
    assert is_zero(linalg.matmul(found, rows))


def test_circuits_are_all_minimal_dependencies_found_by_brute_force(rng):
    for _ in range(60):
        rows = small_matrix(rng)
        found, want = circuits(linalg.matrix(rows)), brute_circuits(rows)
        supports = [tuple(i for i, x in enumerate(h) if x) for h in found]
        assert supports == sorted(want)
        for h, support in zip(found, supports, strict=True):
            assert proportional([h[i] for i in support], want[support]) and h == linalg.primitive(h)


def test_circuits_of_fractions_are_those_of_the_scaled_rows(rng):
    rows = [
        [Fraction(int(x), int(d)) for x in row]
        for row, d in zip(rng.integers(-3, 4, (5, 2)), rng.integers(1, 7, 5), strict=True)
    ]
    assert is_zero(linalg.matmul(circuits(linalg.matrix(rows)), rows))
    assert len(circuits(linalg.matrix(rows))) == len(
        circuits(linalg.matrix([[x * 420 for x in row] for row in rows]))
    )


@pytest.mark.parametrize(
    ("a", "count"),
    [
        ([[0, 0], [1, 0], [0, 1]], 1),
        ([[0], [0]], 2),
        ([[1, 2], [1, 2], [1, 2]], 3),
        ([[1, 0], [0, 1]], 0),
        ([[], []], 2),
    ],
    ids=["zero row", "only zero rows", "repeated rows", "independent rows", "no columns"],
)
def test_circuits_of_degenerate_matrices(a, count):
    assert len(circuits(linalg.matrix(a))) == count


def test_numbers_do_not_depend_on_the_precision_of_jax():
    with jax.enable_x64(False):
        assert linalg.matrix(np.array([[0.1]])) == ((Fraction(1, 10),),)


def test_products_and_multiples_are_those_of_fractions(rng):
    a, b = (tuple(Fraction(int(x), int(y)) for x, y in rng.integers(1, 50, (9, 2)) - [25, 0]) for _ in "ab")
    factor = Fraction(-3, 7)
    assert linalg.dot(a, b) == sum(x * y for x, y in zip(a, b, strict=True))
    assert linalg.multiply((a, b), b) == (linalg.dot(a, b), linalg.dot(b, b))
    assert linalg.add_multiple(a, factor, b) == tuple(x + factor * y for x, y in zip(a, b, strict=True))
    assert linalg.scale(a, factor) == linalg.add_multiple(linalg.zeros(1, 9)[0], factor, a)
    assert linalg.matmul(linalg.identity(9), linalg.transpose((a,))) == linalg.transpose((a,))
    assert linalg.dot((), ()) == 0


@pytest.mark.parametrize("x", ["1e400", "-1e-400", Decimal("1e400")])
def test_a_decimal_far_outside_the_floats_is_refused(x):
    with pytest.raises(ValueError, match="is not a finite number"):
        linalg.rational(x)


def test_a_row_in_whole_numbers_is_the_row_of_its_fractions():
    row, third = linalg.Whole.reduced([2, -4, 0], -6), Fraction(1, 3)
    assert list(row) == [-third, 2 * third, 0] and row[1] == 2 * third and list(row[1:]) == [2 * third, 0]
    assert linalg.integers(row) == ((-1, 2, 0), 3)
    assert linalg.over_one([row, [Fraction(1, 2)]]) == ([(-2, 4, 0), (3,)], 6)
