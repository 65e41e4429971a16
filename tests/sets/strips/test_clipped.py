"""Projections in place of a search: what they prove is true, and a search agrees."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxbound.sets.strips import clipped, varying

SHAPES = [
    (4, 16),
    *(pytest.param(r, q, marks=pytest.mark.slow) for r, q in ((1, 4), (2, 6), (3, 9), (5, 20), (6, 40))),
]


def drawn(rng, r, q, count):
    """Return c (r, N), G (r, q, N): points inside and outside, some within 1e-3 of the boundary."""
    G, c = rng.normal(size=(r, q, count)), rng.normal(size=(r, count))
    t = 1 - varying.zonotope_margins(c, G)
    factor = rng.uniform(0.3, 1.7, count)
    factor[::3] = 1 + 1e-3 * rng.uniform(-1, 1, len(factor[::3]))
    return c * factor / t, G


def on_the_boundary(rng, r, q, count):
    """Return c (r, N), G (r, q, N), x (q, N), small whole numbers: G x = -c at the vertex x of the box that
    speaks most against a direction.
    """
    G, h = rng.integers(-9, 10, (r, q, count)), rng.integers(1, 10, (r, count))
    x = np.where(np.einsum("rn,rqn->qn", h, G) >= 0, 1, -1)
    return -np.einsum("rqn,qn->rn", G, x).astype(float), G.astype(float), x.astype(float)


@pytest.mark.parametrize(("r", "q"), SHAPES)
def test_what_is_easy_has_the_verdict_of_a_search_and_a_margin_no_larger(rng, r, q):
    c, G = drawn(rng, r, q, 1500)
    exact, bounds = varying.zonotope_margins(c, G), varying.zonotope_margins(c, G, margins="bounds")
    np.testing.assert_array_equal(np.sign(bounds), np.sign(exact))
    assert (abs(bounds) <= abs(exact) * (1 + 1e-9) + 1e-12).all()
    assert (abs(bounds) < 0.99 * abs(exact)).mean() > 0.1  # some were easy
    assert 300 < (bounds < 0).sum() < 1200


def test_no_point_explains_what_is_outside_by_a_hair(rng):
    r, q, count = 4, 16, 600
    c, G, x = on_the_boundary(rng, r, q, count)
    c = c * (1 + 2.0**-44)  # exact: whole numbers of few digits
    gram, inverse = clipped.gram_inverse(jnp.asarray(G))
    error = jnp.zeros_like(c)
    hints = clipped.clipped_hints(c, G, 30)
    for z in (x, x * (1 - 2.0**-53), x * (1 + 2.0**-44), np.clip(hints.z, -1, 1), hints.z):
        for wrong in (1.0, 0.0, 1e-3, 1e300, np.nan, rng.normal(size=inverse.shape)):
            assert not (np.asarray(clipped.explains(c, G, error, gram, inverse * wrong, z)) > 0).any()


def test_no_point_explains_what_is_beside_a_flat_set(rng):
    """However near to the middle of the box it is, and whatever stands for the inverse."""
    G = rng.integers(-9, 10, (4, 16, 600)).astype(float)
    G[3] = G[:3].sum(0)
    c, z = np.zeros((4, 600)), np.zeros((16, 600))
    c[3] = 1e-6
    gram = np.einsum("rqn,sqn->rsn", G, G)
    pseudo = np.moveaxis(np.linalg.pinv(np.moveaxis(gram, -1, 0)), 0, -1)
    for inverse in (0 * gram, pseudo, 1e-3 * pseudo, clipped.gram_inverse(G)[1]):
        assert not (np.asarray(clipped.explains(c, G, 0 * c, gram, inverse, z)) > 0).any()


def test_a_point_explains_what_is_inside_by_little(rng):
    c, G, x = on_the_boundary(rng, 4, 16, 600)
    gram, inverse = clipped.gram_inverse(jnp.asarray(G))
    share = 1 - 2.0**-32
    room = np.asarray(clipped.explains(c * share, G, jnp.zeros_like(c), gram, inverse, x * share))
    assert (room > 0).all()
    assert (room < 2.0**-32).all()


def test_errors_of_the_entries_count_against_a_point(rng):
    c, G, x = on_the_boundary(rng, 4, 16, 600)
    gram, inverse = clipped.gram_inverse(jnp.asarray(G))
    share = 1 - 2.0**-20
    error = 2.0**-19 * abs(c) + 1e-300  # with it the point may lie outside
    room = clipped.explains(c * share, G, error, gram, inverse, x * share)
    assert not (np.asarray(room)[(c != 0).all(0)] > 0).any()


def test_a_window_has_the_same_bound_alone_and_beside_others(rng):
    c, G = drawn(rng, 4, 16, 700)
    together = varying.zonotope_margins(c, G, margins="bounds")
    easy = np.argsort(-together)[:90]  # alone they take no step
    alone = varying.zonotope_margins(c[:, easy], G[..., easy], margins="bounds")
    np.testing.assert_array_equal(alone, together[easy])


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200, 1e-200])
def test_numbers_that_say_little_are_judged_as_by_a_search_and_disturb_no_other(rng, bad):
    c, G = drawn(rng, 4, 16, 300)
    usual = varying.zonotope_margins(c, G, margins="bounds")
    at = np.arange(0, 300, 7)
    G[rng.integers(0, 4, len(at)), :, at] = bad
    exact, bounds = varying.zonotope_margins(c, G), varying.zonotope_margins(c, G, margins="bounds")
    np.testing.assert_array_equal(np.sign(bounds), np.sign(exact))
    np.testing.assert_array_equal(np.delete(bounds, at), np.delete(usual, at))


@pytest.mark.slow
def test_float32_contradicts_nothing_that_float64_proves(rng):
    c, G = drawn(rng, 4, 16, 1500)
    single = varying.zonotope_margins(c.astype(np.float32), G.astype(np.float32), margins="bounds")
    double = varying.zonotope_margins(
        c.astype(np.float32).astype(float), G.astype(np.float32).astype(float), margins="bounds"
    )
    assert single.dtype == np.float32
    assert not (np.sign(single) * np.sign(double) < 0).any()
    assert (single != 0).mean() > 0.95


def test_a_second_call_compiles_nothing(rng):
    c, G = drawn(rng, 4, 16, 900)
    kernels = clipped.clipped_hints, clipped.explains, varying._by_hints, varying.gauge_search
    varying.zonotope_margins(c[:, :600], G[..., :600], margins="bounds")
    before = [kernel._cache_size() for kernel in kernels]
    varying.zonotope_margins(c, G, margins="bounds")
    assert [kernel._cache_size() for kernel in kernels] == before


def test_other_margins_are_refused():
    with pytest.raises(ValueError, match='margins must be "exact" or "bounds"'):
        varying.zonotope_margins(np.zeros((1, 2)), np.ones((1, 3, 2)), margins="fast")
