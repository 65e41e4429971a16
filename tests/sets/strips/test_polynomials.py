"""Images, slopes and ranges of polynomials against the same worked out in exact rationals."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips import polynomials

EXPONENTS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (1, 1, 0), (0, 1, 2), (1, 1, 1))
CUBE = ((0, 0, 0), (3, 0, 0))
PLAIN = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1))
KERNELS = {
    name: kernel(f, static_argnums=3)
    for name, f in (("image", polynomials.image), ("slopes", polynomials.slopes))
}
vertex_margin, row_error = (
    kernel(f, static_argnames="exponents") for f in (polynomials.vertex_margin, polynomials.row_error)
)


def draw(rng, exponents, r=2, m=2, count=6, dtype="float64"):
    value, spread = rng.normal(size=(r, len(exponents), count)), rng.normal(size=(r, len(exponents), m))
    rad = abs(rng.normal(size=(m, count))) * 0.1
    value, spread, rad = (x.astype(dtype) for x in (value, spread, rad))
    error = row_error(value, 0 * value, spread, rad, exponents)
    return value, spread, rad, np.asarray(error)


def exact(value, spread, rad, exponents, v, e):
    """Return p_k(v, e) of one window, and its derivatives, in Fractions."""
    F = lambda x: Fraction(float(x))
    power = [np.prod([x**n for x, n in zip(v, a, strict=True)], initial=Fraction(1)) for a in exponents]
    weight = [
        [
            F(value[k, a]) + sum(F(spread[k, a, j]) * F(rad[j]) * e[j] for j in range(len(e)))
            for a in range(len(exponents))
        ]
        for k in (0, 1)
    ]
    p = [sum(w * x for w, x in zip(row, power, strict=True)) for row in weight]
    slope = lambda a, i: (
        np.prod([n * v[l] ** (n - 1) if l == i else v[l] ** n for l, n in enumerate(a)], initial=Fraction(1))
        if a[i]
        else 0
    )
    J = [
        [sum(w * slope(a, i) for w, a in zip(row, exponents, strict=True)) for i in range(len(v))]
        for row in weight
    ]
    J = [
        [*row, *(F(rad[j]) * sum(F(spread[k, a, j]) * x for a, x in enumerate(power)) for j in range(len(e)))]
        for k, row in enumerate(J)
    ]
    return p, J


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("whole", [True, False])
def test_the_image_of_a_box_holds_every_value(rng, whole, dtype):
    value, spread, rad, error = draw(rng, EXPONENTS, dtype=dtype)
    count, n = value.shape[2], 3
    lo = rng.integers(-8, 7, (n, count)) / 8
    hi = np.minimum(lo + rng.integers(1, 9, (n, count)) / 8, 1)
    mid, radius = ((lo + hi) / 2).astype(dtype), ((hi - lo) / 2).astype(dtype)
    c, G = (
        np.asarray(x)
        for x in KERNELS["image"](value, spread, rad, EXPONENTS, *(() if whole else (mid, radius)))
    )
    for k, trial in product(range(count), range(12)):
        corner = trial % 3 == 0
        pick = lambda a, b, corner=corner: Fraction(
            int(rng.choice([a * 16, b * 16]) if corner else rng.integers(a * 16, b * 16 + 1)), 16
        )
        v = [pick(-1, 1) if whole else pick(lo[i, k], hi[i, k]) for i in range(n)]
        e = [pick(-1, 1) for _ in range(2)]
        p, _ = exact(value[..., k], spread, rad[:, k], EXPONENTS, v, e)
        h = [Fraction(int(x)) for x in rng.integers(-5, 6, 2)]
        dot = lambda x, h=h: sum(a * Fraction(float(b)) for a, b in zip(h, x, strict=True))
        reach = sum(abs(dot(G[:, j, k])) for j in range(G.shape[1])) + sum(
            abs(a) * Fraction(float(b)) for a, b in zip(h, error[:, k], strict=True)
        )
        assert abs(sum(a * b for a, b in zip(h, p, strict=True)) - dot(c[:, k])) <= reach


def test_slopes_are_the_derivatives_and_bend_bounds_their_change(rng):
    """Of a cube times noises alone, at a corner, they change nearly as much as the bound allows."""
    for exponents, other in (
        (EXPONENTS, rng.integers(-16, 17, (5, 6)) / 16),
        (CUBE, np.full((5, 6), 15 / 16)),
    ):
        value, spread, rad, error = draw(rng, exponents)
        z = rng.integers(-16, 17, other.shape) / 16
        if exponents is CUBE:
            value, spread, z = 0 * value, abs(spread) * [[0], [1]], np.ones(z.shape)
        p, J, bend = (np.asarray(x) for x in KERNELS["slopes"](value, spread, rad, exponents, z))
        for k in range(value.shape[2]):
            at = lambda x, k=k: [Fraction(float(v)) for v in x[:, k]]
            wanted, slope = exact(value[..., k], spread, rad[:, k], exponents, at(z)[:3], at(z)[3:])
            _, there = exact(value[..., k], spread, rad[:, k], exponents, at(other)[:3], at(other)[3:])
            far = max(abs(a - b) for a, b in zip(at(z), at(other), strict=True))
            for i in range(2):
                assert abs(wanted[i] - Fraction(float(p[i, k]))) <= Fraction(float(error[i, k]))
                for j in range(5):
                    assert abs(slope[i][j] - Fraction(float(J[i, j, k]))) <= 3 * Fraction(float(error[i, k]))
                    assert abs(slope[i][j] - there[i][j]) <= far * Fraction(float(bend[i, k]))


def test_a_multiaffine_range_is_that_of_its_vertices(rng):
    value, spread, rad, error = draw(rng, PLAIN, count=12)
    value[:, 0] *= 4
    margin, inside = (np.asarray(x) for x in vertex_margin(value[:1], spread[:1], rad, PLAIN, error[:1]))
    orders, corners = np.array([sum(a) for a in PLAIN]), list(product((Fraction(-1), Fraction(1)), repeat=5))

    def ends(k, t):
        """Return the exact extremes over t times the box."""
        at = value[..., k] * t**orders, spread * (t**orders)[None, :, None], rad[:, k] * t
        values = [exact(*at, PLAIN, v[:3], v[3:])[0][0] for v in corners]
        return min(values), max(values)

    for k in range(12):
        least, most = ends(k, 1.0)
        assert (margin[k] < 0) == (least > 0 or most < 0) and inside[k] == (least < 0 < most)
        t = 1 - margin[k]
        if 2e-3 < t < 500:  # 0 just leaves the range
            assert (lambda e: e[0] > 0 or e[1] < 0)(ends(k, t * (1 - 1e-5))) and (lambda e: e[0] < 0 < e[1])(
                ends(k, t * (1 + 1e-5))
            )
