"""Validation of multiple models: the state stays inside, no false alarm, the faulty sensor is found; the
paper's scenario.
"""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.estimation.multiple import validate_parts
from jaxbound.sets.intervals.interval import Interval

Status = jb.Status

A = [
    [[0.51, -0.18, -0.23], [0.12, 0.81, -0.1], [0.29, -0.31, 0.55]],
    [[0.44, 0.29, 0.2], [0.325, 0.32, -0.2], [0.09, -0.09, 0.35]],
]
B = [[[0.5], [-0.28], [1.1]], [[0.78], [-1.25], [1.4]]]
C = [
    [
        [[-5.25, -5.05], [-1.78, -1.065], 1.12],
        [[0.89, 1.12], [0.16, 0.22], [-5, -4.5]],
        [[-2, -1.75], [-1.83, -1.3], [0.8, 1]],
    ],
    [
        [[-6.75, -6.2], [-2.5, -1.28], [1, 1.08]],
        [[1.85, 2.05], [0.14, 0.15], [-5.2, -4.5]],
        [[-2.1, -2], [-1.31, -1.3], [1.91, 2.09]],
    ],
]
FAULTS = ((10, 20), (40, 50), (60, 70))


def gaussians(u):
    """Return the activations: normalised, centres -1.25 and 0.25, sigma 0.75 (the paper draws them, without
    numbers).
    """
    g = np.exp(-(((u - np.array([-1.25, 0.25])) / 0.75) ** 2) / 2)
    return g / g.sum(-1, keepdims=True)


def linear(u):
    return np.stack([u[..., 0], 1 - u[..., 0]], -1)


def paper(**options):
    """Return the multiple model of section VI."""
    return jb.MultiModel([jb.interval_system(*m) for m in zip(A, B, C, strict=True)], gaussians, **options)


def small(**options):
    """Return two sub-models of one state, seen by two sensors."""
    models = [
        jb.interval_system([[a]], [[b]], [[[c, c + 0.1]], [[-2 * c, -1.9 * c]]])
        for a, b, c in ((0.8, 1, 2), (0.5, -1, 1))
    ]
    return jb.MultiModel(models, linear, **options)


def record(rng, m, u, push=0.0):
    """Draw recordings (x, y, parts) with C anew each sample, half of the time at vertices, and a disturbance
    of each state.
    """
    count, T, _ = u.shape
    L, n, p = len(m.models), m.models[0].n, m.models[0].p
    x, parts = np.zeros((count, T, L, n)), np.zeros((count, T, L, p))
    x[:, 0] = rng.normal(size=(count, L, n))
    for i, model in enumerate(m.models):
        lo, hi = np.asarray(model.C.lo), np.asarray(model.C.hi)
        A, B = np.asarray(model.A.mid), np.asarray(model.B.mid)
        for k in range(T):
            share = rng.random((count, p, n))
            share = np.where(rng.random((count, 1, 1)) < 0.5, share, share < 0.5)
            parts[:, k, i] = np.einsum("kij,kj->ki", lo + share * (hi - lo), x[:, k, i])
            if k + 1 < T:
                x[:, k + 1, i] = x[:, k, i] @ A.T + u[:, k] @ B.T + rng.uniform(-push, push, (count, n))
    y = np.einsum("ktl,ktlp->ktp", m.weights(u), parts)
    return x.reshape(count, T, L * n), y, parts


def faulty(y, size, stretches=FAULTS):
    """Add a fault of a size to each sensor in turn; return also where."""
    bad, truth = y.copy(), np.zeros((*y.shape[:2], y.shape[-1]), bool)
    for i, (a, b) in enumerate(stretches):
        bad[:, a : b + 1, ..., i] += size
        truth[:, a : b + 1, i] = True
    return bad, truth


def inside(found, x):
    return ((np.asarray(found.state.lo) <= x) & (x <= np.asarray(found.state.hi))).all(-1)


def box(n, size=10.0):
    return jb.interval(np.full(n, -size), np.full(n, size))


def test_parts_are_weighed_and_the_verdict_is_the_worst(rng):
    T, given = 4, {}
    band = lambda m: Interval(*np.sort(rng.normal(size=(2, T, 2)), 0))
    said = [[0, 1, 2, 2], [0, 3, 2, 1]]

    def fake(m, u, y, x0, starts):
        i = len(given)
        found = jb.Validation(
            *(band(m) for _ in range(3)), rng.random((T, 2)) < 0.3, band(m), np.array(said[i], np.int8)
        )
        given[i] = found, y, x0
        return found

    m, u = small(partial=True), rng.uniform(0, 1, (T, 1))
    y = rng.normal(size=(T, 2, 2))
    y[2, 1, 0] = np.nan
    out = validate_parts(m, u, y, box(2), fake)
    (first, y1, x1), (second, y2, x2) = given.values()
    np.testing.assert_array_equal(np.stack([y1, y2], 1), y)
    assert x1.shape == x2.shape == (1,)
    assert out.status.tolist() == [0, 3, 2, 2]
    np.testing.assert_array_equal(out.faulty, first.faulty | second.faulty)
    mu = linear(u)
    exact = lambda k, j, end: sum(
        Fraction(float(mu[k, i])) * Fraction(float(getattr(v.output, end)[k, j]))
        for i, v in enumerate((first, second))
    )
    for k in range(T):
        for j in range(2):
            lo, hi = Fraction(float(out.output.lo[k, j])), Fraction(float(out.output.hi[k, j]))
            assert (
                exact(k, j, "lo") - Fraction(1, 10**12)
                < lo
                <= exact(k, j, "lo")
                <= exact(k, j, "hi")
                <= hi
                < exact(k, j, "hi") + Fraction(1, 10**12)
            )
    assert (
        np.isnan(out.residual.lo[2, 0])
        and np.isfinite(np.delete(np.asarray(out.residual.lo).ravel(), 4)).all()
    )
    np.testing.assert_array_equal(out.state.lo, np.concatenate([first.state.lo, second.state.lo], -1))


@pytest.mark.long(by_day="test_parts_are_weighed_and_the_verdict_is_the_worst")
def test_two_small_models(rng):
    """One compiled shape for all claims: fault-free, located, found too when the sensor is lost, weights that
    are less certain.
    """
    m, T, stretches = small(), 60, ((10, 20), (35, 45))
    u = rng.uniform(0, 1, (8, T, 1))
    x, y, _ = record(rng, m, u)
    healthy = jb.validate(m, u, y, x0=box(2))
    s = 1
    assert (
        inside(healthy, x).all()
        and not healthy.faulty.any()
        and not (np.asarray(healthy.status) == Status.FAULT).any()
    )
    bad, truth = faulty(y, 6.0, stretches)
    found = jb.validate(m, u, bad, x0=box(2))
    assert (np.asarray(found.faulty) == truth).all() and inside(found, x).all()
    right = (np.asarray(found.output.lo) <= y) & (y <= np.asarray(found.output.hi))
    assert right[:, s:].all()  # where the sensor lies, the interval still holds what it should have shown
    lost = jb.validate(m, u, np.where(truth, np.nan, y), x0=box(2))
    assert inside(lost, x).all() and not lost.faulty.any()
    loose = jb.MultiModel(
        m.models, lambda u: jb.interval(np.maximum(linear(u) - 0.01, 0), np.minimum(linear(u) + 0.01, 1))
    )
    blurred = jb.validate(loose, u, y, x0=box(2))
    assert inside(blurred, x).all() and float(blurred.output.wid[:, s:].mean()) > float(
        healthy.output.wid[:, s:].mean()
    )

    moved, shown, _ = record(rng, m, u, push=0.3)
    unit = jb.Uncertainty
    pushed = [
        jb.LinearSystem(
            [[a]],
            [[b]],
            [[f"{c + 0.05}"], [f"{-1.95 * c}"]],
            disturbance=([[1]], ["0.3"]),
            uncertainties=[unit("c1", C=[["0.05"], [0]]), unit("c2", C=[[0], [f"{0.05 * c}"]])],
        )
        for a, b, c in (("0.8", 1, 2), ("0.5", -1, 1))
    ]
    kept = jb.validate(jb.MultiModel(pushed, linear), u, shown, x0=box(2))
    assert inside(kept, moved).all() and not kept.faulty.any()
    assert jb.validate(m, u, shown, x0=box(2)).faulty.any()  # models that claim to be exact blame a sensor


@pytest.mark.long(by_day="test_parts_are_weighed_and_the_verdict_is_the_worst")
def test_partial_outputs_of_two_small_models(rng):
    m, T, stretches = small(partial=True), 60, ((10, 20), (35, 45))
    u = rng.uniform(0, 1, (8, T, 1))
    x, y, parts = record(rng, m, u)
    healthy = jb.validate(m, u, parts, method="sequential")
    assert inside(healthy, x)[:, 1:].all() and not healthy.faulty.any()
    assert ((np.asarray(healthy.output.lo) <= y) & (y <= np.asarray(healthy.output.hi)))[:, 1:].all()
    bad, truth = faulty(parts, 6.0, stretches)
    found = jb.validate(m, u, bad, method="sequential")
    assert (np.asarray(found.faulty) == truth).all() and inside(found, x)[:, 1:].all()
    assert ((np.asarray(found.status) == Status.FAULT) == truth.any(-1)).all()


def fits_the_state(m, u, x, y):
    """Return where a sample fits a healthy sensor even if the state is known: no method can accuse it."""
    weighted = np.repeat(gaussians(u), 3, -1) * x
    C = [np.concatenate([np.asarray(getattr(model.C, end)) for model in m.models], 1) for end in ("lo", "hi")]
    middle, radius = (C[0] + C[1]) / 2, (C[1] - C[0]) / 2
    return (
        abs(y - np.einsum("pj,ktj->ktp", middle, weighted))
        <= np.einsum("pj,ktj->ktp", radius, abs(weighted)) + 1e-9
    )


@pytest.mark.long(by_day="test_parts_are_weighed_and_the_verdict_is_the_worst")
@pytest.mark.parametrize(("s", "count"), [(1, 64), (3, 8)])
def test_the_paper_s_scenario_from_the_mixture_alone(rng, s, count):
    m = paper()
    u = rng.uniform(-2, 1, (count, 100, 1))
    x, y, _ = record(rng, m, u)
    healthy = jb.validate(m, u, y, horizon=s, x0=box(6))
    assert (
        inside(healthy, x)[:, s:].all()
        and not healthy.faulty.any()
        and not (np.asarray(healthy.status) == Status.FAULT).any()
    )
    print(f"s={s}: {count} fault-free recordings, mean width {float(healthy.state.wid[:, s:].mean()):.4f}")
    for size in (2.0, 4.0, 8.0):
        bad, truth = faulty(y, size)
        found = jb.validate(m, u, bad, horizon=s, x0=box(6))
        blamed, hidden = np.asarray(found.faulty), truth & fits_the_state(m, u, x, bad)
        rates = ", ".join(f"{blamed[..., i][truth[..., i]].mean():.1%}" for i in range(3))
        print(
            f"s={s} f={size:g}: located {rates}; {hidden.sum()} of {truth.sum()} fit the state itself, "
            f"missed {(truth & ~blamed).sum()}, "
            f"others blamed {(blamed & ~truth).sum()}, inside {inside(found, x)[:, s:].mean():.2%}"
        )
        complete = ~(truth & ~blamed).any(
            (1, 2)
        )  # the promise: where every faulty sample was found, the state is inside
        assert not (blamed & ~truth)[complete].any() and inside(found, x)[complete][:, s:].all()
        if size >= 4:
            assert not (blamed & ~truth).any() and blamed[truth & ~hidden].mean() > (
                0.99 if size == 4 else 0.999
            )


@pytest.mark.long(by_day="test_parts_are_weighed_and_the_verdict_is_the_worst")
def test_the_paper_s_scenario_where_partial_outputs_are_measured(rng):
    m = paper(partial=True)
    u = rng.uniform(-2, 1, (64, 100, 1))
    x, _, parts = record(rng, m, u)
    for method in ("sequential", "joint"):
        healthy = jb.validate(m, u, parts, method=method)
        assert inside(healthy, x)[:, 1:].all() and not healthy.faulty.any()
        for size in (1.0, 2.0, 4.0, 8.0):
            bad, truth = faulty(parts, size)
            found = jb.validate(m, u, bad, method=method)
            blamed = np.asarray(found.faulty)
            rates = ", ".join(f"{blamed[..., i][truth[..., i]].mean():.1%}" for i in range(3))
            others, held = (blamed & ~truth).sum(), inside(found, x)[:, 1:].mean()
            print(f"{method} f={size:g}: located {rates}; others blamed {others}, inside {held:.2%}")
        assert (blamed == truth).all() and inside(found, x)[:, 1:].all()


@pytest.mark.long(by_day="test_parts_are_weighed_and_the_verdict_is_the_worst")
def test_a_plant_that_is_off_needs_uncertain_models(rng):
    m, u = paper(), rng.uniform(-2, 1, (16, 100, 1))
    off = jb.MultiModel(
        [jb.interval_system(1.002 * np.array(a), b, c) for a, b, c in zip(A, B, C, strict=True)], gaussians
    )
    x, y, _ = record(rng, off, u)
    wide = lambda a: jb.interval(
        np.array(a) - 0.002 * abs(np.array(a)), np.array(a) + 0.002 * abs(np.array(a)) + 1e-15
    )
    loose = jb.MultiModel(
        [jb.interval_system(wide(a), b, c) for a, b, c in zip(A, B, C, strict=True)], gaussians
    )
    exact, honest = (jb.validate(model, u, y, horizon=1, x0=box(6)) for model in (m, loose))
    width = float(honest.state.wid[:, 1:].mean())
    print(
        f"inside: exact {inside(exact, x).mean():.1%}, honest {inside(honest, x).mean():.1%}; width "
        f"{width:.3f}"
    )
    assert inside(exact, x).mean() < 0.5 and inside(honest, x)[:, 1:].all() and not honest.faulty.any()
