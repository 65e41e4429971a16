"""Ten thousand random sets an operation, batched, against exact rationals: one point of each, at a corner of
its coefficients or within.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound import sets
from jaxbound.sets import ConstrainedZonotope, Interval, Zonotope

MANY = {
    (1, 3): 2500,
    (2, 5): 1500,
    (4, 9): 700,
    (12, 20): 200,
    (30, 40): 60,
    (50, 55): 40,
}  # twice, once in each dtype


def exact(x):
    x = np.asarray(x)  # of jax, every entry would be an operation to compile
    return [exact(v) for v in x] if x.ndim else Fraction(float(x))


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def draw(rng, count, n, q, dtype):
    """Return a batch of zonotopes with zero, repeated, tiny and huge generators among others."""
    G = rng.normal(size=(count, n, q)) * 10.0 ** rng.integers(-6, 7, (count, 1, q))
    kind = rng.integers(0, 4, count)
    G[kind == 1, :, 0] = 0
    G[kind == 2, :, 1] = G[kind == 2, :, 0]
    G[kind == 3, n // 2] = 0  # flat
    return Zonotope(jnp.asarray(rng.normal(size=(count, n)) * 10, dtype), jnp.asarray(G, dtype))


def coefficients(rng, count, q):
    x = rng.uniform(-1, 1, (count, q))
    return np.where(rng.integers(0, 2, (count, 1)), np.sign(x), x)


def image(c, G, x):
    return [a + dot(row, x) for a, row in zip(exact(c), exact(G), strict=True)]


def made_up(c, G, x, point):
    """Return whether the last n generators, along the axes, make up for the difference between c + G x and
    the point.
    """
    n, error = len(c), np.diag(np.asarray(G)[:, -len(c) :])
    return (
        all(
            abs(a - b) <= Fraction(float(e))
            for a, b, e in zip(point, image(c, G[:, : len(x)], x), error, strict=True)
        )
        and len(error) == n
    )


def each(S):
    """Return the sets of a batch as tuples of arrays."""
    return zip(*(np.asarray(x) for x in jax.tree.leaves(S)), strict=True)


def linear_map(rng, Z, x):
    M = rng.normal(size=(len(x), 2, Z.center.shape[1])).astype(Z.center.dtype)
    found = jax.vmap(sets.linear_map)(M, Z)
    return all(
        made_up(c, G, exact(w), [dot(row, image(*z, exact(w))) for row in exact(m)])
        for (c, G), z, m, w in zip(each(found), each(Z), M, x, strict=True)
    )


def interval_map(rng, Z, x):
    lo = rng.normal(size=(len(x), 2, Z.center.shape[1])).astype(Z.center.dtype)
    hi = (lo + rng.exponential(size=lo.shape)).astype(lo.dtype)
    found, at = (
        jax.vmap(sets.linear_map)(Interval(jnp.asarray(lo), jnp.asarray(hi)), Z),
        np.where(rng.integers(0, 2, lo.shape), lo, hi),
    )
    return all(
        made_up(c, G, exact(w), [dot(row, image(*z, exact(w))) for row in exact(m)])
        for (c, G), z, m, w in zip(each(found), each(Z), at, x, strict=True)
    )


def minkowski_sum(rng, Z, x):
    Y, y = draw(rng, len(x), Z.center.shape[1], 3, Z.center.dtype), coefficients(rng, len(x), 3)
    found = jax.vmap(sets.minkowski_sum)(Z, Y)
    both = lambda z, v, w, t: [a + b for a, b in zip(image(*z, exact(w)), image(*v, exact(t)), strict=True)]
    return all(
        made_up(c, G, exact([*w, *t]), both(z, v, w, t))
        for (c, G), z, v, w, t in zip(each(found), each(Z), each(Y), x, y, strict=True)
    )


def scale(rng, Z, x):
    factor = rng.normal(size=Z.center.shape).astype(Z.center.dtype)
    found = jax.vmap(sets.scale)(Z, factor)
    return all(
        made_up(c, G, exact(w), [f * p for f, p in zip(exact(a), image(*z, exact(w)), strict=True)])
        for (c, G), z, a, w in zip(each(found), each(Z), factor, x, strict=True)
    )


def translate(rng, Z, x):
    v = rng.normal(size=Z.center.shape).astype(Z.center.dtype)
    found = jax.vmap(sets.translate)(Z, v)
    moved = lambda z, w, a: [p + b for p, b in zip(image(*z, exact(w)), exact(a), strict=True)]
    return all(
        made_up(c, G, exact(w), moved(z, w, a))
        for (c, G), z, w, a in zip(each(found), each(Z), x, v, strict=True)
    )


def cartesian_product(rng, Z, x):
    Y, y = draw(rng, len(x), 2, 3, Z.center.dtype), coefficients(rng, len(x), 3)
    found = jax.vmap(sets.cartesian_product)(Z, Y)
    return all(
        image(c, G, exact([*w, *t])) == image(*z, exact(w)) + image(*v, exact(t))
        for (c, G), z, v, w, t in zip(each(found), each(Z), each(Y), x, y, strict=True)
    )


def from_interval(rng, Z, x):
    """The corners of boxes around the sets."""
    box = jax.vmap(sets.interval_hull)(Z)
    found = jax.vmap(sets.from_interval)(box)
    far = lambda c, g: (Fraction(float(c)) - Fraction(float(g)), Fraction(float(c)) + Fraction(float(g)))
    held = lambda c, g, lo, hi: far(c, g)[0] <= Fraction(float(lo)) and Fraction(float(hi)) <= far(c, g)[1]
    return all(
        all(held(*v) for v in zip(c, np.diag(G), lo, hi, strict=True))
        for (c, G), lo, hi in zip(each(found), box.lo, box.hi, strict=True)
    )


def intersection(rng, Z, x):
    """Another set is moved so that it shares the point, but for the rounding of the move, which its smallest
    generators make up for.
    """
    n, dtype = Z.center.shape[1], Z.center.dtype
    M, H, y = (
        rng.normal(size=(len(x), 2, n)).astype(dtype),
        rng.normal(size=(len(x), 2, 2)).astype(dtype),
        coefficients(rng, len(x), 2),
    )
    at = [[dot(row, image(*z, exact(w))) for row in exact(m)] for m, z, w in zip(M, each(Z), x, strict=True)]
    c = np.array(
        [
            [float(p - q) for p, q in zip(p, image(np.zeros(2), h, exact(t)), strict=True)]
            for p, h, t in zip(at, H, y, strict=True)
        ]
    )
    c = c.astype(dtype)
    gap = [
        [p - q for p, q in zip(p, image(v, h, exact(t)), strict=True)]
        for p, v, h, t in zip(at, c, H, y, strict=True)
    ]
    axes = np.array(
        [np.diag([np.nextafter(abs(dtype.type(float(v))), dtype.type(np.inf)) * 2 for v in g]) for g in gap],
        dtype,
    )
    rest = [
        [v / Fraction(float(e)) for v, e in zip(g, np.diag(a), strict=True)]
        for g, a in zip(gap, axes, strict=True)
    ]
    Y = Zonotope(jnp.asarray(c), jnp.asarray(np.concatenate([H, axes], 2)))
    found = jax.vmap(sets.intersection)(Z, Y, M)

    def held(S, w, t, r):
        rows, own = exact(S[2]), exact([*w, *t]) + r
        return all(
            abs(dot(row[: len(own)], own) - b) <= -row[len(own) + i]
            for i, (row, b) in enumerate(zip(rows, exact(S[3]), strict=True))
        )

    return all(held(S, w, t, r) for S, w, t, r in zip(each(found), x, y, rest, strict=True))


def convex_hull(rng, Z, x):
    Y, y, share = (
        draw(rng, len(x), Z.center.shape[1], x.shape[1], Z.center.dtype),
        coefficients(rng, *x.shape),
        rng.uniform(size=len(x)),
    )
    found = jax.vmap(sets.convex_hull)(Z, Y)

    def held(c, G, z, v, w, t, s):
        s = Fraction(float(s))
        a, b = [s * p for p in exact(w)], [(1 - s) * p for p in exact(t)]
        point = [s * p + (1 - s) * r for p, r in zip(image(*z, exact(w)), image(*v, exact(t)), strict=True)]
        return made_up(
            c,
            G,
            [
                2 * s - 1,
                *(p + r for p, r in zip(a, b, strict=True)),
                *(p - r for p, r in zip(a, b, strict=True)),
            ],
            point,
        )

    return all(
        held(c, G, z, v, w, t, s)
        for (c, G), z, v, w, t, s in zip(each(found), each(Z), each(Y), x, y, share, strict=True)
    )


def strip_intersection(rng, Z, x):
    """The strip goes through the point: its place in it is one more coefficient."""
    n, dtype = Z.center.shape[1], Z.center.dtype
    C, gain = (rng.normal(size=s).astype(dtype) for s in ((len(x), 1, n), (len(x), n, 1)))
    at = np.array(
        [[float(dot(exact(m[0]), image(*z, exact(w))))] for m, z, w in zip(C, each(Z), x, strict=True)]
    )
    half = np.abs(at) * 1e-3 + rng.exponential(size=at.shape)
    Y = Interval(jnp.asarray(at - half, dtype), jnp.asarray(at + half, dtype))
    rows, found = jax.vmap(sets.intersection)(Z, Y, C), jax.vmap(sets.strip_intersection)(Z, Y, C, gain)

    def held(c, G, z, S, w):
        row, offset = exact(S[2][0]), Fraction(float(S[3][0]))
        place = (dot(row[:-1], exact(w)) - offset) / -row[-1]
        return abs(place) <= 1 and made_up(c, G, [*exact(w), place], image(*z, exact(w)))

    return all(
        held(c, G, z, S, w) for (c, G), z, S, w in zip(each(found), each(Z), each(rows), x, strict=True)
    )


def eliminate_constraints(rng, Z, x):
    """Integers, so that the equations hold exactly."""
    whole = rng.integers(-8, 9, x.shape) / 8
    A = rng.integers(-9, 10, (len(x), 2, x.shape[1])).astype(float)
    S = ConstrainedZonotope(
        Z.center, Z.generators, *(jnp.asarray(v, Z.center.dtype) for v in (A, (A @ whole[..., None])[..., 0]))
    )
    found = jax.vmap(sets.eliminate_constraints)(S)
    return all(
        made_up(c, G, exact(w), image(*z, exact(w)))
        for (c, G), z, w in zip(each(found), each(Z), whole, strict=True)
    )


def reductions(method):
    def check(rng, Z, x):
        """What a reduced set reaches is no less, along random directions and the axes."""
        found = jax.vmap(lambda S: sets.reduce_order(S, 2, method))(Z)
        far = lambda c, G, d: (
            dot(d, exact(c)) + sum((abs(dot(d, g)) for g in exact(np.transpose(G))), Fraction(0))
        )
        axes = [*exact(np.eye(Z.center.shape[1])[:2]), *exact(rng.normal(size=(3, Z.center.shape[1])))]
        return all(far(*s, d) >= far(*z, d) for s, z in zip(each(found), each(Z), strict=True) for d in axes)

    return check


def supports(rng, Z, x):
    d = rng.normal(size=Z.center.shape).astype(Z.center.dtype)
    found, box = jax.vmap(sets.support)(Z, d), jax.vmap(sets.interval_hull)(Z)
    return all(
        dot(exact(a), p := image(*z, exact(w))) <= Fraction(float(s))
        and all(
            Fraction(float(low)) <= v <= Fraction(float(high)) for low, v, high in zip(lo, p, hi, strict=True)
        )
        for s, a, z, lo, hi, w in zip(found, d, each(Z), box.lo, box.hi, x, strict=True)
    )


CHECKS = {
    f.__name__: f
    for f in (
        linear_map,
        interval_map,
        minkowski_sum,
        scale,
        translate,
        cartesian_product,
        from_interval,
        convex_hull,
        intersection,
        strip_intersection,
        eliminate_constraints,
        supports,
    )
}
CHECKS |= {f"reduce_order {m}": reductions(m) for m in ("girard", "combastel", "pca", "last")}


@pytest.mark.long(by_day="sets/zonotopes/test_algebra::test_linear_map_encloses_exact_images")
@pytest.mark.parametrize("name", CHECKS)
def test_every_random_set_is_held(name, rng):
    for (n, q), count in MANY.items():
        for dtype in (np.float64, np.float32):
            Z, x = draw(rng, count, n, q, dtype), coefficients(rng, count, q)
            assert CHECKS[name](rng, Z, x), (name, n, q, dtype)
    print(f"{name}: {2 * sum(MANY.values())} sets, 0 unsound")
