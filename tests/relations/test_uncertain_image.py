"""Zonotopes and polynomials of windows against the same worked out in exact rationals."""

from fractions import Fraction

import jax
import numpy as np
import pytest
from uncertain_systems import EXAMPLE, SYSTEMS, entry, relations, trajectory

import jaxbound as jb
from jaxbound.models import window
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips import polynomials

NOISY = dict(
    noise=[0.05, "0.01"], tolerance=[0.02, 0], offset={"u": [1], "y": [2, "1/3"]}, resolution=[0, "1/300"]
)
LEAKY = dict(NOISY, disturbance=([[1], [0], [0.5]], [[-0.1, 0.3]]))
CASES = [
    ("n3p2_mixed3_h3", {}),
    ("n3p2_mixed3_h3", dict(noise=[0.05, 0])),
    ("n3p2_var3_h2", NOISY),
    ("n3p2_inv3_h3", LEAKY),
    ("n3p1_var2_h4", {}),
    ("n2p1_Btwo_h3", dict(tolerance=0.1)),
]
QUICK = [(5, "float64"), (3, "float32")]
TYPES = [
    (c, d) if (c, d) in QUICK else pytest.param(c, d, marks=pytest.mark.long)
    for c in range(len(CASES))
    for d in ("float32", "float64")
]


def rows(r, y, dtype):
    """Return the exact (mid, rad) of the true outputs and disturbances of one window y (s + 1, p)."""
    m, ulps = r.model, 4 * Fraction(float(np.finfo(dtype).eps)) / 2
    y, mid, rad = np.vectorize(lambda v: Fraction(float(v)), otypes=[object])(y), [], []
    largest = [max(abs(v) for v in y[:, i]) for i in range(m.p)]
    for sample in y:
        for i, v in enumerate(sample):
            rho = (
                m.noise[i]
                + m.resolution[i]
                + ulps * (largest[i] + m.noise[i])
                + Fraction(float(np.finfo(dtype).tiny))
            )
            d, sigma = v - m.offset["y"][i], m.tolerance[i]
            hi, lo = (
                max((d + rho) / (1 + sigma), (d + rho) / (1 - sigma)),
                min((d - rho) / (1 + sigma), (d - rho) / (1 - sigma)),
            )
            mid.append((hi + lo) / 2), rad.append((hi - lo) / 2)
    for lo, hi in m.disturbance * r.horizon:
        mid.append((lo + hi) / 2), rad.append((hi - lo) / 2 + Fraction(float(np.finfo(dtype).tiny)))
    return mid, rad


def known(r, u):
    lags = window.input_lags(r.model, r.horizon)
    return [Fraction(float(v)) - r.model.offset["u"][i] for sample in u[:lags] for i, v in enumerate(sample)]


def exact_terms(r, u, y, dtype):
    """Return value[i][a], spread[i][a][j] of all rows j, rad[j], exact."""
    mid, rad = rows(r, y, dtype)
    U, N, K = known(r, u), [], []
    for alpha in r.exponents:
        N.append(r.N.coefficient(alpha)), K.append(r.K.coefficient(alpha))
    dot = lambda a, b: sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))
    count, terms = r.count, range(len(r.exponents))
    return (
        [[dot(N[a][i], mid) - dot(K[a][i], U) for a in terms] for i in range(count)],
        [[N[a][i] for a in terms] for i in range(count)],
        rad,
    )


def draw_windows(r, rng, dtype, count=7):
    """Draw windows, if nothing else is asked for always as many: more would be compiled anew."""
    s = r.horizon
    u, y = (
        rng.normal(size=(s + 1, r.model.m, count)),
        rng.normal(size=(s + 1, r.model.p, count)) * 10.0 ** rng.integers(-2, 3, count),
    )
    return u.astype(dtype), y.astype(dtype)


def _both(test, u, y):
    value, error, spread, rad = test.polynomials(u, y)
    c, G = polynomials.image(value, spread, rad, test.exponents)
    return c, G, polynomials.row_error(value, error, spread, rad, test.exponents)


def image(r, u, y, how="kernel"):
    """Return (c, G, bound (count, N)) of windows: their zonotopes and how far off, in all, these can be."""

    if how == "kernel":
        return tuple(map(np.asarray, kernel(_both)(r.reading(y.dtype), u, y)))
    with jax.disable_jit():
        return tuple(map(np.asarray, _both(r.reading(y.dtype), jax.numpy.asarray(u), jax.numpy.asarray(y))))


@pytest.mark.long(by_day="test_image_is_the_exact_zonotope_within_its_error")
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_image_out_of_jit_is_the_exact_zonotope_within_its_error(dtype, rng):
    check_image(5, dtype, rng, "eager")


@pytest.mark.parametrize("case, dtype", TYPES)
def test_image_is_the_exact_zonotope_within_its_error(case, dtype, rng):
    check_image(case, dtype, rng, "kernel")


def check_image(case, dtype, rng, how):
    name, changes = CASES[case]
    r = relations(name, **changes)
    u, y = draw_windows(r, rng, dtype, count=2 if how == "eager" else 5)
    c, G, bound = image(r, u, y, how)
    noisy, alphas, n = r.reading(np.dtype(dtype)).noisy, r.exponents, len(r.variables)
    units = [tuple(int(i == j) for j in range(n)) for i in range(n)]
    monomials = [a for a in alphas if sum(a) > 1]
    assert G.shape == (r.count, n + len(monomials) + (len(noisy) + r.count if noisy else 0), y.shape[2])
    for k in range(y.shape[2]):
        value, spread, rad = exact_terms(r, u[..., k], y[..., k], dtype)
        for i in range(r.count):
            by = dict(zip(alphas, value[i], strict=True))
            even = [a for a in monomials if all(e % 2 == 0 for e in a)]
            columns = [by.get(a, Fraction(0)) for a in units] + [
                by[a] / 2 if a in even else by[a] for a in monomials
            ]
            mixed = sum((sum(abs(x[j]) for x in spread[i][1:]) * rad[j] for j in noisy), Fraction(0))
            columns += [spread[i][0][j] * rad[j] for j in noisy] + [
                mixed if q == i else Fraction(0) for q in range(r.count) if noisy
            ]
            off = sum(
                (sum(abs(x[j]) for x in spread[i]) * rad[j] for j in range(len(rad)) if j not in noisy),
                Fraction(0),
            )
            off += abs(Fraction(float(c[i, k])) - value[i][0] - sum(by[a] / 2 for a in even))
            off += sum(abs(Fraction(float(g)) - x) for g, x in zip(G[i, :, k], columns, strict=True))
            assert off <= Fraction(float(bound[i, k]))


@pytest.mark.parametrize("case, dtype", TYPES)
def test_polynomials_are_the_exact_ones_within_their_errors(case, dtype, rng):
    name, changes = CASES[case]
    r = relations(name, **changes)
    u, y = draw_windows(r, rng, dtype, count=3)
    value, error, spread, rad = (np.asarray(x) for x in r.polynomials(u, y))
    noisy = r.reading(np.dtype(dtype)).noisy
    for k in range(y.shape[2]):
        exact_value, exact_spread, exact_rad = exact_terms(r, u[..., k], y[..., k], dtype)
        for i in range(r.count):
            for a in range(len(r.exponents)):
                off = abs(Fraction(float(value[i, a, k])) - exact_value[i][a])
                off += sum(
                    (
                        abs(
                            Fraction(float(spread[i, a, q])) * Fraction(float(rad[q, k]))
                            - exact_spread[i][a][j] * exact_rad[j]
                        )
                        for q, j in enumerate(noisy)
                    ),
                    Fraction(0),
                )
                assert off <= Fraction(float(error[i, a, k]))


@pytest.mark.parametrize("name, changes", CASES)
def test_the_polynomials_of_a_healthy_window_vanish_at_what_made_it(name, changes, rng):
    """With the very parameters and noises, exactly; and what made the window is within the box."""
    r, (matrices, parameters, h) = relations(name, **changes), SYSTEMS[name]
    m = r.model
    draw = lambda count: [
        Fraction(int(x), 2**10) for x in rng.choice([-(2**10), 2**10, *range(-1000, 1000, 77)], count)
    ]
    for _ in range(6):
        values = {
            (p["name"], k): draw(1)[0]
            for p in parameters
            for k in (range(h) if p.get("varying", True) else [None])
        }
        u = [draw(1) for _ in range(h)]
        w = [
            [(lo + hi) / 2 + (hi - lo) / 2 * x for (lo, hi), x in zip(m.disturbance, draw(m.g), strict=True)]
            for _ in range(h)
        ]
        deviation = [[x - m.offset["u"][0] for x in row] for row in u]
        G = [[float(x) for x in row] for row in m.G] if m.g else None
        true = trajectory(matrices, parameters, values, draw(m.n), deviation, w, G)
        y = [
            (1 + m.tolerance[j % m.p] * t) * x + m.noise[j % m.p] * e + m.offset["y"][j % m.p]
            for j, (x, t, e) in enumerate(zip(true, draw(len(true)), draw(len(true)), strict=True))
        ]
        recorded = np.array(y, float).reshape(h, m.p)  # within the resolution of the recorder
        value, spread, rad = exact_terms(r, np.array(u, float), recorded, "float64")
        mid, _ = rows(r, recorded, "float64")
        z = [*true, *(x for row in w[: r.horizon] for x in row)]
        xi = [(x - c) / q for x, c, q in zip(z, mid, rad, strict=True)]
        assert all(abs(x) <= 1 for x in xi)
        v = [values[name] for name in r.variables]
        power = [np.prod([x**e for x, e in zip(v, a, strict=True)], initial=Fraction(1)) for a in r.exponents]
        for i in range(r.count):
            total = sum(c * p for c, p in zip(value[i], power, strict=True))
            total += sum(
                n[j] * p * rad[j] * xi[j]
                for n, p in zip(spread[i], power, strict=True)
                for j in range(len(rad))
            )
            assert total == 0


@pytest.mark.parametrize("dtype, size", [("float64", 1e-13), ("float32", 1e-4)])
def test_errors_are_small(dtype, size, rng):
    r = relations("n3p2_mixed3_h3", noise=0.01)
    u, y = draw_windows(r, rng, dtype)
    _, error, _, _ = (np.asarray(x) for x in r.polynomials(u, y))
    assert (error < size * (1 + abs(y).max((0, 1)) + abs(u).max((0, 1)))).all()


def test_a_missing_sample_silences_only_the_relations_that_need_it(rng):
    r = relations("n3p2_mixed3_h3", noise=0.1)
    u, y = draw_windows(r, rng, "float64")
    before = [np.asarray(x) for x in r.polynomials(u, y)]
    for j in range(6):
        y[j // 2, j % 2, j] = np.nan
    after = [np.asarray(x) for x in r.polynomials(u, y)]
    uses = np.array([[any((i, j) in m for m in r.N.terms.values()) for j in range(6)] for i in range(3)])
    assert not uses.all() and uses.any()
    assert (np.isnan(after[0][:, 0])[:, :6] == uses).all() and not np.isnan(after[0][:, 0, 6]).any()
    assert all(np.isfinite(x).all() for x in (after[0][:, 1:], *after[1:]))
    for x, z in zip(before, after, strict=True):
        assert x.shape[-1] != 7 or (x[..., 6] == z[..., 6]).all()
    u[0, 0, 6] = np.nan
    needs = [any((i, 0) in m for m in r.K.terms.values()) for i in range(3)]
    assert np.isnan(np.asarray(r.polynomials(u, y)[0])[:, 0, 6]).tolist() == needs


@pytest.mark.parametrize("size", [np.inf, -np.inf, 1e308])
def test_an_infinite_sample_is_not_a_missing_one(size, rng):
    r = relations("n3p2_mixed3_h3", noise=0.1)
    u, y = draw_windows(r, rng, "float64")
    y[1, 0, 0] = size
    value, error, _, _ = (np.asarray(x) for x in r.polynomials(u, y))
    assert not np.isnan(value).any() and np.isfinite(error[..., 1:]).all()
    assert np.isfinite(size) or np.isinf(error[..., 0]).all()


def test_bounds_of_parameters_scale_the_box(rng):
    twice = [jb.Uncertainty("th", A=[[0.2, 0], [0, 0]]), jb.Uncertainty("vt", C=[[0.05, 0]], varying=False)]
    other = jb.parity_relations(jb.LinearSystem(**EXAMPLE, uncertainties=twice, noise=0.1))
    r = relations("n2p1_paper_h3", noise=0.1).with_bounds({"parameters": [2, 0.5]})
    u, y = draw_windows(r, rng, "float64")
    for mine, theirs in zip(r.polynomials(u, y), other.polynomials(u, y), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)


def test_a_wider_box_is_no_longer_proved_to_be_described_completely():
    r = relations("n2p1_paper_h3")
    assert r.complete == r.with_bounds({"parameters": [1, 0.5], "noise": 3}).complete == "proved"
    assert r.with_bounds({"parameters": 1.5}).complete == "sampled"


@pytest.mark.parametrize(
    "bounds, message",
    [
        (
            {"parameters": [1, 2, 3]},
            r"parameters needs one number or one per parameter \(2\): its shape is \(3,\)",
        ),
        ({"parameters": [1, -1]}, r"parameters must be in \[0, inf\): parameter 'vt' has -1"),
        ({"parameters": np.nan}, "parameter 'th' has nan"),
        ({"parameter": 1}, r"bounds are \['noise', 'parameters', 'tolerance'\], not \['parameter'\]"),
    ],
)
def test_bounds_that_mean_nothing_are_refused(bounds, message):
    with pytest.raises(ValueError, match=message):
        relations("n2p1_paper_h3").with_bounds(bounds)


def test_a_second_call_and_another_model_of_the_shape_do_not_trace(rng):
    r = relations("n2p1_paper_h3", noise=0.1)
    parameters = [
        jb.Uncertainty("th", A=[[0.2, 0], [0, 0]]),
        jb.Uncertainty("vt", C=[[0.05, 0]], varying=False),
    ]
    other = jb.LinearSystem(**EXAMPLE, uncertainties=parameters, noise=1)
    traces = []
    count = jax.jit(lambda test, u, y: (traces.append(1), test.polynomials(u, y))[1])
    u, y = draw_windows(r, rng, "float64")
    for some in (r, r.with_bounds({"noise": 0.3, "parameters": 2}), jb.parity_relations(other)):
        count(some.reading(y.dtype), u, y)
    assert len(traces) == 1


def test_polynomials_are_differentiable_in_the_bounds(rng):
    r = relations("n2p1_paper_h3", noise=0.1)
    u, y = draw_windows(r, rng, "float64")

    def total(bounds):
        value, _, spread, rad = r.with_bounds(bounds).polynomials(u, y)
        return abs(value).sum() + abs(spread).sum() * rad.sum()

    slope, total = kernel(jax.grad(total))(r.bounds), kernel(total)
    for name, i in (("parameters", 0), ("parameters", 1), ("noise", 0)):
        moved = {k: np.array(v) for k, v in r.bounds.items()}
        moved[name][i] += 1e-6
        assert slope[name][i] == pytest.approx(float(total(moved) - total(r.bounds)) / 1e-6, rel=1e-4)


def test_external_is_the_residual_at_the_middle_of_all_bounds(rng):
    r = relations("n3p2_mixed3_h3", **NOISY)
    u, y = rng.normal(size=(9, 1)), rng.normal(size=(9, 2))
    out = np.asarray(r.external(u, y))
    assert np.isnan(out[:2]).all() and out.shape == (9, 3)
    zero = (0,) * len(r.variables)
    for k in range(2, 9):
        Y = [
            Fraction(float(v)) - r.model.offset["y"][i] for row in y[k - 2 : k + 1] for i, v in enumerate(row)
        ]
        U = known(r, u[k - 2 : k + 1])
        dot = lambda a, b: sum((p * q for p, q in zip(a, b, strict=True)), Fraction(0))
        exact = [
            float(dot(n, Y) - dot(g, U))
            for n, g in zip(r.N.coefficient(zero), r.K.coefficient(zero), strict=True)
        ]
        np.testing.assert_allclose(out[k], exact, atol=1e-13)


def test_healthy_residuals_are_inside_their_internal_forms(rng):
    r = relations("n3p2_mixed3_h3", noise=0.02)
    t = jb.simulate(
        r.model, rng.uniform(0, 2, (3, 200, 1)), jax.random.key(int(rng.integers(99))), at="vertices"
    )
    external, internal = np.asarray(r.external(t.u, t.y))[:, 2:], r.internal(t.u, t.y)
    lo, hi = np.asarray(internal.lo)[:, 2:], np.asarray(internal.hi)[:, 2:]
    assert ((lo <= external) & (external <= hi)).all()
    assert (abs(external - (lo + hi) / 2) > (hi - lo) / 4).any()  # the bounds bite: half of them would not do
    assert np.isnan(internal.lo[:, :2]).all()


def test_relations_of_a_long_entry_print_powers_and_products():
    m = jb.LinearSystem(
        [[0.5]],
        [[1]],
        [[1]],
        uncertainties=[jb.Uncertainty("a", A=[[0.1]], B=entry((1, 1), (0, 0, -0.2)), varying=False)],
    )
    assert jb.parity_relations(m).text() == "r1: (0.5 + 0.1 a) y1[k-1] - y1[k] + (1 - 0.2 a) u1[k-1] = 0"
