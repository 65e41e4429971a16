"""Operations on zonotopes enclose what exact rationals give, entry by entry: eagerly, compiled and batched,
degenerate sets included.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import in_blocks

from jaxbound import sets
from jaxbound.exact.linalg import transpose
from jaxbound.sets import ConstrainedZonotope, Interval, Zonotope

SHAPES = [(2, 0), (3, 7)]
FLOAT32_BY_NIGHT = [np.float64, pytest.param(np.float32, marks=pytest.mark.long)]
CASES = [("eager", np.float64), ("vmap", np.float32)]  # compiling is what takes time
CASES += [
    pytest.param(way, dtype, marks=pytest.mark.long)
    for way, dtype in (("jit", np.float64), ("vmap", np.float64), ("eager", np.float32), ("jit", np.float32))
]
every_way = pytest.mark.parametrize(("way", "dtype"), CASES)  # `test_algebra_many` has more shapes


def three(x):
    x = np.asarray(x)
    return np.stack([0 * x, x, x])


WAYS = {
    "eager": lambda f, *sets_: f(*sets_),
    "jit": lambda f, *sets_: jax.jit(f)(*sets_),
    "vmap": lambda f, *sets_: jax.tree.map(
        lambda x: np.asarray(x)[1], jax.jit(jax.vmap(f))(*jax.tree.map(three, sets_))
    ),
}


def shapes(dtype, way="eager"):
    """Return what to try: few in float32, under jit and vmap."""
    return SHAPES if way == "eager" and dtype == np.float64 else [(3, 7)]


def rational(a):
    a = np.asarray(a)  # of jax, every entry would be an operation to compile
    return [rational(x) for x in a] if a.ndim else Fraction(float(a))


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def image(S, x):
    """Return c + G x exactly, for the generators that x speaks of."""
    c, G = rational(S.center), rational(S.generators)
    return [ci + dot(row[: len(x)], x) for ci, row in zip(c, G, strict=True)]


def drawn(rng, n, q, dtype, scale=None):
    """Return a zonotope with zero, repeated and tiny generators among others."""
    G = rng.normal(size=(n, q)) * 10.0 ** rng.integers(-3, 4, (1, q))
    if q > 2:
        G[:, 0], G[:, 1] = 0, G[:, 2]
    c = rng.normal(size=n) * (100 if scale is None else scale)
    return Zonotope(jnp.asarray(c.astype(dtype)), jnp.asarray(G.astype(dtype)))


def coefficients(rng, q):
    """Return rational coefficients, at a corner for half of the draws."""
    corner = rng.integers(0, 2)
    return [
        Fraction(int(2 * v - 1)) if corner else Fraction(float(w))
        for v, w in zip(rng.integers(0, 2, q), rng.uniform(-1, 1, q), strict=True)
    ]


def off(S, x, point, first=None):
    """Return whether `point` is c + G x and the last n generators, which are along the axes, make up for the
    rest.
    """
    n = len(S.center)
    G = np.asarray(S.generators)
    assert (G[:, -n:] == np.diag(np.diag(G[:, -n:]))).all() and (np.diag(G[:, -n:]) >= 0).all()
    return all(
        abs(p - y) <= Fraction(float(e))
        for p, y, e in zip(point, image(S, x), np.diag(G[:, -n:]), strict=True)
    )


def sharp(S, *others):
    """Return whether the generators for rounding are small beside the set."""
    n, u = len(S.center), float(np.finfo(S.center.dtype).eps)
    G, c = np.asarray(S.generators, float), np.asarray(S.center, float)
    size = sum(np.abs(np.asarray(x, float)).sum() for x in others) + np.abs(G[:, :-n]).sum() + np.abs(c).sum()
    return (np.diag(G[:, -n:]) <= 1000 * u * size + 1e-30).all()


@every_way
def test_linear_map_encloses_exact_images(way, dtype, rng):
    for n, q in shapes(dtype, way):
        Z, M, v = (
            drawn(rng, n, q, dtype),
            rng.normal(size=(3, n)).astype(dtype),
            rng.normal(size=3).astype(dtype),
        )
        plain, moved = WAYS[way](lambda S, M=M, v=v: (sets.linear_map(M, S), sets.linear_map(M, S, v)), Z)
        for _ in range(5):
            x = coefficients(rng, q)
            exact = [dot(row, image(Z, x)) for row in rational(M)]
            assert off(plain, x, exact) and off(
                moved, x, [a + b for a, b in zip(exact, rational(v), strict=True)]
            )
        assert plain.center.dtype == dtype and plain.generators.shape == (3, q + 3)
        assert sharp(plain, np.abs(M) @ np.abs(np.column_stack([Z.center, Z.generators]))) and sharp(
            moved, M @ np.asarray(Z.center), v, np.abs(M) @ np.abs(np.column_stack([Z.center, Z.generators]))
        )


@pytest.mark.parametrize("dtype", FLOAT32_BY_NIGHT)
def test_an_interval_matrix_maps_under_every_matrix_inside(dtype, rng):
    for n, q in shapes(dtype):
        Z, lo = drawn(rng, n, q, dtype), rng.normal(size=(2, n)).astype(dtype)
        hi = (lo + rng.exponential(size=(2, n))).astype(dtype)
        S = sets.linear_map(Interval(jnp.asarray(lo), jnp.asarray(hi)), Z)
        for _ in range(5):
            x, corner = coefficients(rng, q), np.where(rng.integers(0, 2, (2, n)), hi, lo)
            assert off(S, x, [dot(row, image(Z, x)) for row in rational(corner)])


@every_way
def test_sums_scales_and_products_enclose_exact_ones(way, dtype, rng):
    for n, q in shapes(dtype, way):
        Z, Y, a = drawn(rng, n, q, dtype), drawn(rng, n, 3, dtype, 1e-3), dtype(rng.normal())
        x, y = coefficients(rng, q), coefficients(rng, 3)
        both = [s + t for s, t in zip(image(Z, x), image(Y, y), strict=True)]
        of_two = lambda S, T: (sets.minkowski_sum(S, T), sets.cartesian_product(S, T))
        v = np.asarray(Y.center)
        of_one = lambda S, a=a, v=v: (sets.scale(S, a), sets.translate(S, v))
        (total, pair), (scaled, moved) = WAYS[way](of_two, Z, Y), WAYS[way](of_one, Z)
        assert off(total, x + y, both) and sharp(total)
        assert off(scaled, x, [Fraction(float(a)) * s for s in image(Z, x)])
        assert off(moved, x, [s + t for s, t in zip(image(Z, x), rational(Y.center), strict=True)])
        assert image(pair, x + y) == image(Z, x) + image(Y, y) and pair.generators.shape == (2 * n, q + 3)


@pytest.mark.parametrize("dtype", FLOAT32_BY_NIGHT)
def test_the_hull_of_two_sets_encloses_every_mixture(dtype, rng):
    for n, q in shapes(dtype):
        Z, Y = drawn(rng, n, q, dtype), drawn(rng, n, 4, dtype)
        S, wide = sets.convex_hull(Z, Y), max(q, 4)
        for _ in range(5):
            share = Fraction(float(rng.uniform()))
            x, y = (
                coefficients(rng, q) + [Fraction(0)] * (wide - q),
                coefficients(rng, 4) + [Fraction(0)] * (wide - 4),
            )
            point = [
                share * a + (1 - share) * b for a, b in zip(image(Z, x[:q]), image(Y, y[:4]), strict=True)
            ]
            # share p + (1 - share) r = middle + half the difference: coefficients (2 share - 1, (a + b), (a -
            # b)) with a, b weighted
            a, b = [share * v for v in x], [(1 - share) * v for v in y]
            s = (
                [2 * share - 1]
                + [v + w for v, w in zip(a, b, strict=True)]
                + [v - w for v, w in zip(a, b, strict=True)]
            )
            assert max(map(abs, s)) <= 1 and off(S, s, point)


@every_way
def test_an_intersection_holds_every_common_point(way, dtype, rng):
    for n, q in shapes(dtype, way)[-3:]:
        Z, Y, M = (
            drawn(rng, n, q, dtype, 1),
            drawn(rng, 2, 3, dtype, 1),
            rng.normal(size=(2, n)).astype(dtype),
        )
        x, y = coefficients(rng, q), coefficients(rng, 3)
        p = [dot(row, image(Z, x)) for row in rational(M)]
        exact = image(Y, y)
        near = np.array(
            [float(a - b) for a, b in zip(p, exact, strict=True)]
        )  # Y moves so that M p is the point of y, nearly
        Y = Zonotope(jnp.asarray(np.asarray(Y.center) + near.astype(dtype)), Y.generators)
        C = WAYS[way](lambda S, T, M=M: sets.intersection(S, T, M), Z, Y)
        rows, b, size = rational(C.constraints), rational(C.offsets), np.asarray(C.constraints)
        slack = -np.diag(size[:, q + 3 :])
        gap = [abs(a - e) for a, e in zip(p, image(Y, y), strict=True)]  # what they miss each other by
        for row, offset, s, g in zip(rows, b, slack, gap, strict=True):
            assert abs(dot(row[: q + 3], x + y) - offset) <= Fraction(float(s)) + g
        assert (np.asarray(C.center) == np.asarray(Z.center)).all() and not np.asarray(C.generators)[
            :, q:
        ].any()


@pytest.mark.parametrize("dtype", FLOAT32_BY_NIGHT)
def test_strips_and_half_spaces_keep_what_they_hold(dtype, rng):
    for n, q in shapes(dtype)[-3:]:
        Z, M = drawn(rng, n, q, dtype, 1), rng.normal(size=(3, n)).astype(dtype)
        x = coefficients(rng, q)
        at = [dot(row, image(Z, x)) for row in rational(M)]
        lo, hi = (np.array([float(v) for v in at]) + s * np.array([0.5, np.inf, 1e-3]) for s in (-1, 1))
        hi[1] = float(at[1]) + 0.1
        Y = sets.interval(
            np.nextafter(lo.astype(dtype), dtype(-np.inf)), np.nextafter(hi.astype(dtype), dtype(np.inf))
        )
        C = sets.intersection(Z, Y, M)
        rows = list(
            zip(
                rational(C.constraints),
                rational(C.offsets),
                -np.diag(np.asarray(C.constraints)[:, q:]),
                strict=True,
            )
        )
        assert all(abs(dot(row[:q], x) - b) <= Fraction(float(s)) for row, b, s in rows)
        for gain in (None, rng.normal(size=(n, 3)).astype(dtype), np.zeros((n, 3), dtype)):
            S = sets.strip_intersection(Z, Y, M, gain)
            y = [(dot(row[:q], x) - b) / Fraction(float(s)) for row, b, s in rows]
            assert off(S, x + y, image(Z, x))


@every_way
def test_eliminated_constraints_leave_every_point(way, dtype, rng):
    for n, q, k, keep in [(1, 4, 1, 0)] if (way, dtype) == CASES[0] else [(2, 6, 3, 1), (2, 8, 8, 3)][-1:]:
        x = [Fraction(int(v), 8) for v in rng.integers(-8, 9, q)]
        A = rng.integers(-9, 10, (k, q)).astype(dtype)  # so that A x = b holds exactly
        b = np.array([float(dot(row, x)) for row in rational(A)], dtype)
        S = ConstrainedZonotope(
            *(jnp.asarray(v.astype(dtype)) for v in (rng.normal(size=n), rng.normal(size=(n, q)), A, b))
        )
        found = WAYS[way](lambda C, keep=keep: sets.eliminate_constraints(C, keep), S)
        rest = [abs(p - y) for p, y in zip(image(S, x), image(found, x), strict=True)]
        errors = np.diag(np.asarray(found.generators)[:, q:])
        if keep:
            rest += [
                abs(dot(row[:q], x) - e)
                for row, e in zip(rational(found.constraints), rational(found.offsets), strict=True)
            ]
            errors = np.concatenate([errors, np.diag(np.asarray(found.constraints)[:, q + n :])])
            assert found.constraints.shape == (keep, q + n + keep)
        assert (
            all(r <= Fraction(float(e)) for r, e in zip(rest, errors, strict=True)) and (errors < 1e-2).all()
        )


def supported(S, d):
    """Return max d . p exactly over a Zonotope."""
    return dot(d, rational(S.center)) + sum(
        (abs(dot(d, g)) for g in transpose(rational(S.generators))), Fraction(0)
    )


@every_way
@pytest.mark.parametrize("method", ["girard", "combastel", "pca", "last"])
def test_a_reduced_set_reaches_as_far_everywhere(way, method, dtype, rng):
    for n, q in [(1, 5), (3, 13)][way != "eager" :]:
        Z = drawn(rng, n, q, dtype)
        S = WAYS[way](lambda Z, method=method: sets.reduce_order(Z, 2.5, method), Z)
        assert S.generators.shape == (n, int(2.5 * n)) and S.generators.dtype == dtype
        for _ in range(40):
            d = rational(rng.normal(size=n))
            assert supported(S, d) >= supported(Z, d)
        for axis in np.eye(n):  # no wider than a box around the whole, along the axes
            far = supported(Z, rational(axis))
            assert method == "pca" or supported(S, rational(axis)) - far <= 100 * float(
                np.finfo(dtype).eps
            ) * (abs(far) + 100)


def test_a_flat_set_is_reduced_within_its_plane_but_for_rounding(rng):
    G = np.array([[1.0], [2.0], [3.0]]) @ rng.normal(size=(1, 9))
    S = sets.reduce_order(Zonotope(jnp.asarray(np.zeros(3)), jnp.asarray(G)), 2, "pca")
    for normal in ([3, 0, -1], [2, -1, 0]):
        assert supported(S, rational(normal)) < 1e-12 * np.abs(G).sum()


def test_reduced_constraints_keep_their_points(rng):
    n, q, k = 2, 14, 2
    x = [Fraction(int(v), 8) for v in rng.integers(-8, 9, q)]
    A = rng.integers(-9, 10, (k, q)).astype(float)
    b = np.array([float(dot(row, x)) for row in rational(A)])
    S = ConstrainedZonotope(*map(jnp.asarray, (rng.normal(size=n), rng.normal(size=(n, q)), A, b)))
    R = sets.reduce_order(S, 2)
    assert R.generators.shape == (n, 8) and R.constraints.shape == (k, 8)
    lifted = lambda T: Zonotope(np.r_[T.center, -np.asarray(T.offsets)], np.r_[T.generators, T.constraints])
    for _ in range(40):
        d = rational(rng.normal(size=n + k))
        assert supported(lifted(R), d) >= supported(lifted(S), d)


def test_a_set_small_enough_is_not_reduced():
    Z = sets.zonotope([0.0, 0.0], [[1.0, 2.0], [3.0, 4.0]])
    assert sets.reduce_order(Z, 1) is Z and sets.eliminate_constraints(Z) is Z


@pytest.mark.parametrize("dtype", FLOAT32_BY_NIGHT)
def test_supports_and_boxes_enclose_and_are_tight(dtype, rng):
    for n, q in shapes(dtype):
        Z = drawn(rng, n, q, dtype)
        box = sets.interval_hull(Z)
        for i, axis in enumerate(np.eye(n)):
            far, near = supported(Z, rational(axis)), -supported(Z, rational(-axis))
            room = 100 * float(np.finfo(dtype).eps) * float(far - near + abs(far) + abs(near)) + 1e-30
            lo, hi = float(box.lo[i]), float(box.hi[i])
            assert hi - room <= far <= hi and lo <= near <= lo + room
        d = rng.normal(size=n).astype(dtype)
        assert supported(Z, rational(d)) <= Fraction(float(sets.support(Z, d)))


def program(S, d):
    """Return max d . p over a constrained zonotope by HiGHS, None where it is empty."""
    from scipy.optimize import linprog

    G, A, b = (np.asarray(x, float) for x in (S.generators, S.constraints, S.offsets))
    found = linprog(-(G.T @ d), A_eq=A, b_eq=b, bounds=[(-1, 1)] * G.shape[1])
    return None if found.status else float(np.asarray(S.center) @ d) - found.fun


@pytest.fixture(scope="module")
def supports():
    """Return a function of sets of two coordinates, four unknowns and two constraints, and of directions: one
    program for all, that of the published set with constraints.
    """
    support = jax.jit(jax.vmap(sets.support))
    return lambda *parts: in_blocks(
        lambda *parts: support(ConstrainedZonotope(*parts[:4]), parts[4]), 4, *parts
    )


def test_supports_with_constraints_are_those_of_a_linear_program(supports, rng):
    A, x = rng.normal(size=(40, 2, 4)), rng.uniform(-1, 1, (40, 4))
    parts = rng.normal(size=(40, 2)), rng.normal(size=(40, 2, 4)), A, np.einsum("skq,sq->sk", A, x)
    directions = rng.normal(size=(40, 2))
    for S, d, found in zip(zip(*parts, strict=True), directions, supports(*parts, directions), strict=True):
        best = program(ConstrainedZonotope(*S), d)
        assert best - 1e-9 <= found <= best + 1e-8 * (1 + abs(best))


@pytest.mark.long(by_day="test_supports_with_constraints_are_those_of_a_linear_program")
def test_supports_and_boxes_with_many_constraints_are_those_of_linear_programs(rng):
    n, q, k = 3, 12, 8
    for _ in range(20):
        A, x = rng.normal(size=(k, q)), rng.uniform(-1, 1, q)
        S = ConstrainedZonotope(*map(jnp.asarray, (rng.normal(size=n), rng.normal(size=(n, q)), A, A @ x)))
        d = rng.normal(size=n)
        best, found = program(S, d), float(sets.support(S, d))
        assert best - 1e-9 <= found <= best + 1e-8 * (1 + abs(best))
    box = sets.interval_hull(S)
    assert all(
        abs(float(box.hi[i]) - program(S, e)) < 1e-7 and abs(float(box.lo[i]) + program(S, -e)) < 1e-7
        for i, e in enumerate(np.eye(n))
    )


def test_repeated_constraints_and_points_have_supports_too(supports):
    once = [1.0, 1.0, 0.0, 0.0]
    S = [0.0, 0.0], [[1.0, 0.5, 0.0, 0.0], [0.0] * 4], [once, once], [2.0, 2.0]  # only x = (1, 1, .., ..)
    assert 1.5 <= supports(*(np.array([part]) for part in (*S, [1.0, 0.0])))[0] < 1.5 + 1e-6


def test_a_support_along_zero_proves_sets_empty_under_jit_and_vmap(supports, rng):
    A, x = rng.normal(size=(20, 2, 4)), rng.uniform(-1, 1, (20, 4))
    b = np.einsum("skq,sq->sk", A, x)
    b[10:, 0] = np.abs(A[10:, 0]).sum(1) * 1.001
    far = supports(np.zeros((20, 2)), rng.normal(size=(20, 2, 4)), A, b, np.zeros((20, 2)))
    assert (far[:10] >= 0).all() and (far[10:] < 0).all()


EMPTY = [(np.inf, -np.inf), (2.0, 1.0), (np.inf, np.inf)]


@pytest.mark.parametrize("bounds", EMPTY, ids=["empty", "lo above hi", "infinite point"])
@pytest.mark.parametrize("center", [0.0, 1e9], ids=["near", "far"])
def test_nothing_is_in_an_empty_interval_nor_in_a_strip_of_negative_width(bounds, center):
    Z, Y = (
        sets.zonotope([center, 1.0], np.eye(2)),
        Interval(*(jnp.array([b, s]) for b, s in zip(bounds, (-9.0, 9.0), strict=True))),
    )
    assert sets.is_empty(sets.intersection(Z, Y, np.array([[1.0, 1.0], [1.0, 0.0]]))).yes


@pytest.mark.parametrize("bounds", [(np.nan, np.nan), (np.nan, 9.0), (-9.0, np.nan), (-np.inf, np.nan)])
def test_a_bound_that_is_no_number_takes_nothing_away(bounds):
    Z, Y = sets.zonotope([0.0, 1.0], np.eye(2)), Interval(*(jnp.array([b]) for b in bounds))
    common, around = sets.intersection(Z, Y, [[1.0, 1.0]]), sets.strip_intersection(Z, Y, [[1.0, 1.0]])
    corners = [[x, y] for x in (-0.99, 0.99) for y in (0.01, 1.99)]
    assert sets.contains(common, corners).yes.all() and sets.contains(around, corners).yes.all()


def test_a_matrix_or_factor_with_a_bound_that_is_no_number_bounds_nothing():
    Z, N = sets.zonotope([1.0], [[1.0]]), Interval(jnp.array([np.nan]), jnp.array([np.nan]))
    for S in (
        sets.linear_map(Interval(N.lo[None], N.hi[None]), Z),
        sets.linear_map([[1.0]], Z, N),
        sets.translate(Z, N),
        sets.scale(Z, N),
    ):
        assert not np.isfinite(np.asarray(S.generators)).all()
    assert not sets.support(Z, N) < np.inf


def test_an_empty_box_is_no_zonotope():
    with pytest.raises(
        ValueError, match=r"an empty box is no zonotope: 1 of 2 coordinates are empty, first at \(1,\)"
    ):
        sets.from_interval(Interval(jnp.array([0.0, np.inf]), jnp.array([1.0, -np.inf])))


def test_a_box_becomes_a_zonotope_that_holds_it(rng):
    lo = rng.normal(size=4)
    box = sets.interval(lo, lo + rng.exponential(size=4))
    Z = sets.from_interval(box)
    for i, axis in enumerate(np.eye(4)):
        assert supported(Z, rational(axis)) >= Fraction(float(box.hi[i])) and -supported(
            Z, rational(-axis)
        ) <= Fraction(float(box.lo[i]))


def test_an_overflow_is_never_a_small_set():
    Z = sets.linear_map([[1e308, 1e308]], sets.zonotope([1e308, 1.0], [[1e308], [1.0]]))
    assert not np.isfinite(np.asarray(Z.generators)).all()


def test_a_scan_needs_no_sort_and_compiles_once(rng):
    A, noise = np.array([[0.9, 0.2], [-0.1, 0.8]]), sets.zonotope([0.0, 0.0], [[0.1, 0.0], [0.0, 0.1]])

    @jax.jit
    def run(Z):
        def step(Z, _):
            return sets.reduce_order(
                sets.minkowski_sum(noise, sets.linear_map(A, Z)), 6, "last"
            ), sets.interval_hull(Z).hi

        return jax.lax.scan(step, Z, length=50)

    Z, far = run(Zonotope(jnp.asarray(np.ones(2)), jnp.asarray(np.zeros((2, 12)))))
    assert np.isfinite(np.asarray(far)).all() and Z.generators.shape == (2, 12)


@pytest.mark.parametrize(
    "call, sentence",
    [
        (lambda Z: sets.linear_map(np.eye(3), Z), "must have shape"),
        (lambda Z: sets.linear_map(np.eye(2), Z, [1.0]), "offset must have shape"),
        (lambda Z: sets.minkowski_sum(Z, sets.zonotope([0.0], [[1.0]])), "one dimension"),
        (lambda Z: sets.scale(Z, [1.0, 2.0, 3.0]), "factor"),
        (lambda Z: sets.reduce_order(Z, 0.5), "at least 1"),
        (lambda Z: sets.reduce_order(Z, 1, "pca"), "at least 2"),
        (lambda Z: sets.reduce_order(Z, 2, "sort"), "method must be one of"),
        (lambda Z: sets.intersection(Z, sets.interval([0.0], [1.0])), "2 coordinates"),
        (lambda Z: sets.intersection(Z, Z, np.eye(3)), "shape"),
        (lambda Z: sets.support(Z, [1.0]), "direction"),
        (lambda Z: sets.linear_map(np.eye(2), Zonotope(jnp.zeros((5, 2)), jnp.zeros((5, 2, 3)))), "vmap"),
        (lambda Z: sets.eliminate_constraints(Z, keep=-1), "keep"),
        (lambda Z: sets.from_interval(sets.interval(0.0, 1.0)), "shape"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call(sets.zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]]))


def test_what_is_no_set_is_refused():
    with pytest.raises(TypeError, match="zonotope is needed: this is ndarray"):
        sets.linear_map(np.eye(2), np.eye(2))
    box = sets.constrained_zonotope([0.0], [[1.0]], [[1.0]], [0.0])
    for call in (
        lambda: sets.strip_intersection(box, sets.interval([0.0], [1.0]), [[1.0]]),
        lambda: sets.convex_hull(box, box),
    ):
        with pytest.raises(TypeError, match="constraints|exact"):
            call()


# numbers of two dtypes, and those that are none


def _small(dtype):
    """Return a set around 0 whose numbers are subnormal in float32, a subnormal number being what compiled
    code converts to 0.
    """
    return Zonotope(jnp.zeros(1, dtype), jnp.full((1, 1), 1e-40, dtype))


NARROW, WIDE = _small(np.float32), _small(np.float64)
ONE = np.ones((1, 1))


@pytest.mark.parametrize(
    "reach",
    [
        lambda: sets.linear_map(ONE, NARROW).generators[0],
        lambda: sets.cartesian_product(WIDE, NARROW).generators[1],
        lambda: sets.intersection(WIDE, NARROW).constraints[0, 1:],
        lambda: sets.interval_hull(Zonotope(WIDE.center, NARROW.generators)).hi,
        *(
            pytest.param(f, marks=pytest.mark.long)
            for f in (
                lambda: sets.linear_map(ONE.astype(np.float32), WIDE, np.zeros(1, np.float32)).generators[0],
                lambda: sets.scale(NARROW, np.float64(1.0)).generators[0],
                lambda: sets.translate(NARROW, np.zeros(1)).generators[0],
                lambda: sets.minkowski_sum(NARROW, WIDE).generators[0] / 2,
                lambda: sets.convex_hull(NARROW, WIDE).generators[0],
                lambda: sets.support(NARROW, ONE[0])[None],
                lambda: (
                    sets.reduce_order(
                        Zonotope(WIDE.center, jnp.concatenate([NARROW.generators] * 2, 1)), 1
                    ).generators[0]
                    / 2
                ),
                lambda: sets.eliminate_constraints(
                    ConstrainedZonotope(WIDE.center, NARROW.generators, 0 * ONE, np.zeros(1))
                ).generators[0],
            )
        ),
    ],
)
def test_what_only_the_narrower_dtype_calls_subnormal_is_kept(reach):
    assert np.abs(np.asarray(reach(), float)).sum() >= float(np.float32(1e-40)) * (1 - 1e-9)


def test_a_set_whose_own_arrays_differ_in_dtype_is_read_in_the_wider():
    Z = Zonotope(jnp.zeros(1, np.float32), 0.1 * ONE)
    assert sets.cartesian_product(Z, Z).generators[0, 0] == 0.1


def test_a_vector_in_a_list_moves_a_narrow_set_by_at_least_all_it_says():
    S = sets.translate(sets.zonotope(np.zeros(1, np.float32), np.ones((1, 0), np.float32)), [0.1])
    gap = abs(Fraction(0.1) - Fraction(float(S.center[0])))
    assert S.center.dtype == np.float32 and 0 < gap <= Fraction(float(S.generators[0, 0]))


BAD = [Zonotope(jnp.array([bad, 0.0]), jnp.eye(2)) for bad in (np.nan, np.inf)]
BAD += [Zonotope(jnp.zeros(2), jnp.array([[1.0, bad], [0.0, 1.0]])) for bad in (np.nan, np.inf)]


@pytest.mark.parametrize(
    "Z", BAD, ids=["nan center", "infinite center", "nan generator", "infinite generator"]
)
def test_what_is_no_number_bounds_nothing(Z):
    assert not sets.support(Z, [1.0, 1.0]) < np.inf and not sets.support(Z, [0.0, 0.0]) < 0
    assert not (sets.interval_hull(Z).hi < np.inf).all()


@pytest.mark.parametrize(
    "f",
    [
        sets.volume,
        sets.strips,
        sets.vertices,
        lambda Z: sets.membership(Z, np.zeros((1, 2))),
        lambda Z: sets.minkowski_difference(Z, sets.zonotope([0.0, 0.0], np.eye(2))),
        lambda Z: sets.minkowski_difference(sets.zonotope([0.0, 0.0], np.eye(2)), Z),
    ],
)
def test_what_is_no_number_is_refused_where_exact_numbers_are_needed(f):
    for Z in BAD:
        with pytest.raises(ValueError, match="must be finite: 1 of"):
            f(Z)
