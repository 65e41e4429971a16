"""Strips, membership, support and hull of zonotopes against exact rationals and linear programs."""

from fractions import Fraction
from itertools import combinations, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import MODES, Counted, misses
from zonotope_cases import degenerate, each_dtype, margin, program

from jaxbound import sets
from jaxbound.sets import support
from jaxbound.sets import zonotope as factory
from jaxbound.sets.zonotopes.zonotope import Zonotope

# strips


def brute_strips(G):
    """Return the strips of a solid zonotope as {(primitive normal, width)}: normals are orthogonal to n - 1
    independent generators.
    """
    n, q = G.shape
    found = set()
    for chosen in combinations(range(q), n - 1):
        columns = G[:, chosen]
        normal = [
            int(round((-1) ** i * np.linalg.det(np.delete(columns, i, 0)))) if n > 1 else 1 for i in range(n)
        ]
        if any(normal):
            top = Fraction(max(map(abs, normal)))
            unit = [x / top for x in normal]
            sign = -1 if next(x for x in unit if x) < 0 else 1
            found.add(
                (
                    *(sign * x for x in unit),
                    sum(abs(sum(sign * x * int(g) for x, g in zip(unit, c, strict=True))) for c in G.T),
                )
            )
    return found


def signed(normal):
    return [x * (-1 if next(v for v in normal if v) < 0 else 1) for x in normal]


@pytest.mark.parametrize("n", [1, 2, 3])
def test_strips_of_a_solid_zonotope_are_the_nearest_floats_to_the_exact_ones(rng, n):
    for _ in range(25):
        G = degenerate(rng, n, rng.integers(n, 6))
        if np.linalg.matrix_rank(G) < n:
            G = np.hstack([G, np.eye(n, dtype=int)])
        want = {tuple(map(float, row)) for row in brute_strips(G)}
        normals, widths = sets.strips(factory(np.zeros(n), G * 1.0))
        assert {
            (*signed(row), w) for row, w in zip(normals.tolist(), widths.tolist(), strict=True)
        } == want and len(widths) == len(want)


def test_a_flat_zonotope_has_as_many_zero_strips_as_dimensions_missing(rng):
    for _ in range(25):
        n, q = rng.integers(2, 5), rng.integers(1, 4)
        G = degenerate(rng, n, q)
        normals, widths = sets.strips(factory(np.zeros(n), G * 1.0))
        missing = n - np.linalg.matrix_rank(G)
        assert (widths == 0).sum() == missing and (widths[len(widths) - missing :] == 0).all()
        assert (
            abs(normals[len(widths) - missing :] @ G).max(initial=0) < 1e-12
            and (abs(normals).max(1) == 1).all()
        )


def test_a_point_has_one_zero_strip_a_dimension():
    for Z in (factory([1.0, 2.0], np.zeros((2, 0))), factory([1.0, 2.0], np.zeros((2, 3)))):
        normals, widths = sets.strips(Z)
        assert (widths == 0).all() and abs(np.linalg.det(normals)) == 1


def test_strips_of_decimal_generators_are_those_of_the_exact_floats():
    G = np.array([[0.1, 0.3, 0.0], [0.2, 0.6, 1e-3]])  # the first two are parallel as decimals, not as floats
    assert len(sets.strips(factory([0.0, 0.0], G))[1]) == (
        2 if Fraction(0.1) * Fraction(0.6) == Fraction(0.3) * Fraction(0.2) else 3
    )


# margins


def test_margins_are_one_minus_the_gauge_of_the_linear_program(rng):
    for _ in range(30):
        n = rng.integers(1, 4)
        q = rng.integers(1, 6)
        G = degenerate(rng, n, q) * 0.25
        solid = np.linalg.matrix_rank(G) == n
        G = G * rng.choice([1.0, 0.1, 1 / 3]) if solid else G  # rounding would make a flat one solid
        center = rng.normal(size=n).round(3)
        points = np.vstack([rng.uniform(-1.5, 1.5, (4, q)) @ G.T, rng.normal(size=(2, n)) * 4])
        got = sets.membership(factory(center, G), center + points)
        for m, p in zip(got, points, strict=True):
            gauge = program(G, p)
            if solid:
                assert abs(1 - m - gauge) <= 1e-7 * (1 + gauge) and (m > 0) == (gauge < 1)
            # exact floats seldom lie in the plane: outside is -inf or past the gauge, inside is never proved
            else:
                assert m <= 0 and (m == -np.inf or m == 0 or abs(1 - m - gauge) <= 1e-7 * (1 + gauge))
                assert gauge < np.inf or m == -np.inf


def integer_gauge(G, p):
    """Return the exact gauge of an integer point in a solid zonotope around 0."""
    return max(
        abs(sum(x * int(v) for x, v in zip(row[:-1], p, strict=True))) / row[-1] for row in brute_strips(G)
    )


@pytest.mark.parametrize("scale", [1.0, 2.0**300, 0.1])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_points_on_the_boundary_in_exact_arithmetic_never_get_a_wrong_sign(rng, n, scale):
    for _ in range(8):
        G = np.hstack([degenerate(rng, n, 3), np.diag(rng.integers(1, 4, n))])
        signs = np.sign(rng.normal(size=(6, n)) @ G)
        vertices = (
            np.where(signs == 0, 1, signs) @ G.T
        )  # integers: on the boundary, or inside where a sign was free
        gauges = [integer_gauge(G, v) for v in vertices]
        Z = factory(np.zeros(n), G * scale)
        if scale == 0.1:  # then the floats are neither: their exact gauge decides
            exact = np.array([[Fraction(float(x)) for x in row] for row in np.asarray(Z.generators)])
            gauges = [exact_gauge(exact, [Fraction(float(x)) for x in v * scale]) for v in vertices]
        m = sets.membership(Z, vertices * scale)
        assert all(
            not (got > 0 and g > 1) and not (got < 0 and g <= 1) for got, g in zip(m, gauges, strict=True)
        )
        assert all(got == 0 for got, g in zip(m, gauges, strict=True) if g == 1)


def exact_gauge(G, p):
    """Return the exact gauge of a rational point in a solid zonotope of rational generators, normals by
    cofactors.
    """
    n, q = G.shape
    worst = Fraction(0)
    for chosen in combinations(range(q), n - 1):
        c = G[:, chosen]
        normal = (
            [Fraction(1)] if n == 1 else [c[1, 0], -c[0, 0]] if n == 2 else list(np.cross(c[:, 0], c[:, 1]))
        )
        width = sum(abs(sum(x * g for x, g in zip(normal, column, strict=True))) for column in G.T)
        if width:
            worst = max(worst, abs(sum(x * v for x, v in zip(normal, p, strict=True))) / width)
    return worst


@each_dtype
@pytest.mark.parametrize("n", [1, 2, 3])
def test_signs_are_right_for_floats_an_instant_from_the_boundary(rng, n, dtype):
    wrong = settled = 0
    for _ in range(8):
        G = rng.normal(size=(n, n + 2)).astype(dtype)
        center = (rng.normal(size=n) * 10.0 ** rng.integers(-2, 3)).astype(dtype)
        x = np.sign(rng.normal(size=(6, n)) @ G)
        step = 1 + rng.choice([-1, 1], (6, 1)) * 10.0 ** rng.uniform(
            -17 if dtype == np.float64 else -8, -2, (6, 1)
        )
        points = (center + (x * step) @ G.T.astype(float)).astype(dtype)
        exact_G = np.array([[Fraction(float(v)) for v in row] for row in G])
        for m, p in zip(sets.membership(factory(center, G), points), points, strict=True):
            gauge = exact_gauge(
                exact_G, [Fraction(float(v)) - Fraction(float(c)) for v, c in zip(p, center, strict=True)]
            )
            wrong += (m > 0 and gauge > 1) or (m < 0 and gauge <= 1)
            settled += m != 0
    assert wrong == 0 and settled > 10


def test_float64_points_keep_their_sign_in_a_float32_zonotope(rng):
    G = rng.normal(size=(2, 4)).astype(np.float32)
    points = (
        np.sign(rng.normal(size=(200, 2)) @ G) * (1 + rng.uniform(-1, 1, (200, 1)) * 3e-7)
    ) @ G.T.astype(float)
    exact_G = np.array([[Fraction(float(v)) for v in row] for row in G])
    for m, p in zip(sets.membership(factory(np.zeros(2, np.float32), G), points), points, strict=True):
        gauge = exact_gauge(exact_G, [Fraction(v) for v in p.tolist()])
        assert not (m > 0 and gauge > 1) and not (m < 0 and gauge <= 1)


def test_margins_settle_all_but_a_thin_shell():
    Z = factory([1.0, -2.0], [[1.0, 0.5, 0.0], [0.0, 1.0, 3.0]])
    v = np.array([2.5, 2.0]) - [1, -2]
    for step in (1e-13, 1e-10, 1e-3):
        assert (
            margin(Z, np.array([1, -2]) + v * (1 - step)) > 0 > margin(Z, np.array([1, -2]) + v * (1 + step))
        )


def test_a_flat_zonotope_tells_its_plane_from_the_rest_and_the_gauge_within():
    Z = factory([0.0, 0.0, 0.0], [[1.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    assert sets.membership(Z, [[0, 0, 1e-3], [3, 0, 0], [0.5, 1, 0], [3, 0, 1]]).tolist() == [
        -np.inf,
        -2,
        0,
        -np.inf,
    ]


def test_a_point_is_outside_of_another_point_and_undecided_on_itself():
    for q in (0, 2):
        assert sets.membership(
            factory([1.0, 2.0], np.zeros((2, q))), [[1, 2], [1, 3], [-1e9, 2]]
        ).tolist() == [0, -np.inf, -np.inf]


def test_points_beyond_the_range_of_floats_are_never_inside():
    Z = factory([0.0, 0.0], [[1.0, 1.0], [-1.0, 1.0]])
    assert (sets.membership(Z, np.array([[1.7e308, 1.7e308], [-1.7e308, 1e308], [1e308, 0]])) <= 0).all()


def test_coefficients_that_a_float_cannot_span_are_refused():
    with pytest.raises(ValueError, match="coefficients .* float64"):
        sets.membership(factory([0.0], [[1e-310]]), [[0.0]])


# support and hull


def exact_support(center, G, d):
    f = lambda a: [Fraction(float(x)) for x in a]
    dot = lambda a, b: sum(x * y for x, y in zip(f(a), f(b), strict=True))
    return dot(d, center) + sum(abs(dot(d, g)) for g in np.asarray(G).T)


ONCE_EACH = [("jit", np.float32), ("vmap", np.float64)]  # eagerly: the published cases


@pytest.mark.parametrize(("mode", "dtype"), ONCE_EACH)
def test_support_is_an_upper_bound_and_tight(rng, mode, dtype):
    n, q = 3, 5
    center, G = (rng.normal(size=s).astype(dtype) for s in ((20, n), (20, n, q)))
    d = (rng.normal(size=(20, n)) * 10.0 ** rng.integers(-3, 4, (20, 1))).astype(dtype)
    if mode == "vmap":
        got = jax.jit(jax.vmap(lambda c, g, d: sets.support(Zonotope(c, g), d)))(center, G, d)
    else:
        run = MODES[mode](lambda c, g, d: sets.support(Zonotope(c, g), d))
        center, G, d = center[:4], G[:4], d[:4]
        got = np.array([run(*each) for each in zip(center, G, d, strict=True)])
    for value, *each in zip(got.tolist(), center, G, d, strict=True):
        exact = exact_support(*each)
        size = exact_support(abs(each[0]), abs(each[1]), abs(each[2]))
        assert exact <= value and Fraction(value) - exact <= 40 * Fraction(float(np.finfo(dtype).eps)) * size


def test_support_bounds_a_direction_that_the_dtype_cannot_hold():
    Z = factory(np.array([3.0], np.float32), np.array([[5.0]], np.float32))
    for d in (0.1, 0.3, -0.7):
        assert float(support(Z, np.array([d]))) >= 3 * Fraction(d) + 5 * abs(Fraction(d))


@pytest.mark.parametrize(("mode", "dtype"), ONCE_EACH)
def test_the_hull_encloses_the_exact_box_tightly(rng, mode, dtype):
    center, G = (rng.normal(size=s).astype(dtype) for s in ((20, 3), (20, 3, 5)))
    if mode == "vmap":
        box = jax.jit(jax.vmap(Zonotope.hull))(Zonotope(center, G))
    else:
        run = MODES[mode](Zonotope.hull)
        box = jax.tree.map(
            lambda *rows: np.stack(rows),
            *[run(Zonotope(c, g)) for c, g in zip(center[:4], G[:4], strict=True)],
        )
    e = np.eye(3)
    for lo, hi, c, g in zip(
        np.asarray(box.lo).tolist(), np.asarray(box.hi).tolist(), center, G, strict=False
    ):
        ends = [(-exact_support(c, g, -row), exact_support(c, g, row)) for row in e]
        assert not misses(lo, hi, ends)
        slack = 40 * float(np.finfo(dtype).eps) * (1 + max(map(abs, lo + hi)))
        assert all(
            b - hi_i >= -slack and lo_i - a >= -slack for (a, b), lo_i, hi_i in zip(ends, lo, hi, strict=True)
        )


def test_a_zonotope_without_generators_has_the_hull_and_support_of_its_center():
    Z = factory([1.0, -2.0], np.zeros((2, 0)))
    assert sets.contains(Z.hull(), np.array([1.0, -2.0])).all() and (Z.hull().wid < 1e-14).all()
    assert -1 <= float(support(Z, np.ones(2))) < -1 + 1e-14


def test_all_vertices_of_a_cube_are_in_it_and_its_hull():
    Z = factory(np.zeros(3), np.eye(3))
    corners = np.array(list(product([-1.0, 1.0], repeat=3)))
    assert (sets.membership(Z, corners) == 0).all() and (np.asarray(Z.hull().hi) < 1 + 1e-14).all()
    assert (sets.membership(Z, corners * 0.999) > 0).all() and (sets.membership(Z, corners * 1.001) < 0).all()


# the door


@pytest.mark.parametrize(
    ("center", "generators", "message"),
    [
        ([0.0, 0.0], [[1.0, 2.0]], r"shapes are \(2,\) and \(1, 2\)"),
        ([[0.0]], [[1.0]], r"shapes are \(1, 1\) and \(1, 1\)"),
        ([0.0], [1.0], r"shapes are \(1,\) and \(1,\)"),
        ([], np.zeros((0, 2)), r"shapes are \(0,\)"),
        ([np.nan], [[1.0]], "center must be finite: 1 of 1"),
        ([0.0], [[np.inf, 1.0]], "generators must be finite: 1 of 2"),
    ],
)
def test_the_factory_refuses_what_is_no_zonotope(center, generators, message):
    with pytest.raises(ValueError, match=message):
        factory(center, generators)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([0.0, 0.0], r"shape \(N, 2\): their shape is \(2,\)"),
        ([[0.0]], r"their shape is \(1, 1\)"),
        ([[0.0, 0.0], [0.0, np.nan]], r"first at \(1, 1\)"),
        ([[np.inf, 0.0]], "must be finite"),
    ],
)
def test_membership_refuses_points_that_do_not_fit(points, message):
    with pytest.raises(ValueError, match=message):
        sets.membership(factory([0.0, 0.0], np.eye(2)), points)


@pytest.mark.parametrize("direction", [[1.0], [[1.0, 0.0]], 1.0, [1.0, 2.0, 3.0]])
def test_support_refuses_a_direction_of_another_shape(direction):
    with pytest.raises(ValueError, match="direction must have shape"):
        sets.support(factory([0.0, 0.0], np.eye(2)), direction)


@pytest.mark.parametrize("direction", [[np.nan, 1.0], [np.inf, 0.0]])
def test_support_refuses_a_direction_that_is_not_finite(direction):
    with pytest.raises(ValueError, match="finite|NaN"):
        sets.support(factory([0.0, 0.0], np.eye(2)), direction)


def test_strips_of_traced_generators_are_refused():
    with pytest.raises(TypeError, match="outside jit"):
        jax.jit(lambda G: sets.strips(Zonotope(jnp.zeros(2), G)))(jnp.eye(2))


@pytest.mark.parametrize(
    ("center", "generators", "dtype"),
    [
        ([0], [[1]], np.float64),
        (np.zeros(1, np.float32), np.ones((1, 1), np.float32), np.float32),
        (np.zeros(1, np.float32), np.ones((1, 1)), np.float64),
        (np.zeros(1, int), np.ones((1, 1), int), np.float64),
    ],
)
def test_the_dtype_is_the_wider_of_both(center, generators, dtype):
    Z = factory(center, generators)
    assert Z.center.dtype == Z.generators.dtype == dtype


def test_a_zonotope_is_a_tree_of_center_and_generators():
    assert [leaf.shape for leaf in jax.tree.leaves(factory([0.0, 0.0], np.ones((2, 5))))] == [(2,), (2, 5)]


@pytest.mark.parametrize(
    "kernel", [lambda Z: Z.hull(), lambda Z: sets.support(Z, Z.center)], ids=["hull", "support"]
)
def test_a_second_call_does_not_trace(kernel):
    counted = Counted(kernel)
    compiled = jax.jit(counted)
    for shift in (0.0, 1.0):
        compiled(factory(np.zeros(2) + shift, np.eye(2)))
    assert counted.count == 1
