"""Strips with everything folded that no sample changes, against the same strips step by step and in whole
numbers.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.consistency import whole_numbers
from jaxbound.consistency.folded import folded_verdict, folds
from jaxbound.consistency.reading import gather
from jaxbound.consistency.strips import verdicts
from jaxbound.sets.floats.kernel import outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.strips import strip_margin, strip_verdict

N = 600
MODELS = {
    "section 5": {},
    "offsets": {"offset": {"u": [1000], "y": [1e6, -1e6]}},
    "exact gains": {"tolerance": [0, 0]},
    "coarse gains": {"tolerance": [0.9, 0.5], "resolution": "1/300"},
    "disturbed": {"disturbance": ([[1], [0.5]], 0.01)},
}


@jax.jit
def step_by_step(reading, u, y):
    """Return the proved margins as they are without folding."""
    return strip_verdict(reading.strips, *reading.block(*reading.windows(u, y)), reading.lift)


@jax.jit
def folded(reading, u, y):
    return folded_verdict(reading, *reading.columns(u, y))


@jax.jit
def unrounded(reading, u, y):
    rows = reading.block(*reading.windows(u, y))
    return strip_margin(reading.strips, rows.mid, rows.rad, rows.known)


def at_boundary(relations, reading, rng, dtype):
    """Return (u, y), every second window of them on the boundary or within 1e-3 of it."""
    du, dy = rng.normal(size=(N, 1)), rng.normal(size=(N, 2))
    offset_u, offset_y = np.asarray(reading.offset_u, float), np.asarray(reading.offset_y, float)

    def scaled(factors):
        each = np.repeat(factors, 2)[:, None]
        return (offset_u + du * each).astype(dtype), (offset_y + dy * each).astype(dtype)

    lo, hi = np.full(N // 2, 1e-6), np.full(N // 2, 1e6)
    for _ in range(60):
        middle = np.sqrt(lo * hi)
        inside = np.asarray(unrounded(reading, *scaled(middle)))[::2] > 0
        lo, hi = np.where(inside, middle, lo), np.where(inside, hi, middle)
    aside = rng.choice([-1, 0, 1], N // 2) * 10.0 ** rng.uniform(-16, -3, N // 2)
    return scaled(lo * (1 + aside))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", MODELS)
def test_folded_verdicts_are_never_less_sharp(name, dtype, rng):
    """Whatever is decided step by step is decided alike; margins differ in their last digits."""
    relations = jb.parity_relations(paper(**MODELS[name]))
    reading = relations.reading(dtype)
    u, y = at_boundary(relations, reading, rng, dtype)
    y[rng.random(y.shape) < 0.05] = np.nan
    u[rng.random(u.shape) < 0.05] = np.nan
    assert folds(reading)
    before, now = (np.asarray(f(reading, u, y)) for f in (step_by_step, folded))
    np.testing.assert_array_equal(np.isnan(now), np.isnan(before))
    decided = before != 0
    np.testing.assert_array_equal(np.sign(now[decided]), np.sign(before[decided]))
    margins = np.where(decided, unrounded(reading, u, y), 0)
    np.testing.assert_allclose(np.where(decided, now, 0), margins, rtol=1e-3, atol=1e4 * np.finfo(dtype).eps)


@pytest.mark.parametrize("name", MODELS)
def test_folded_verdicts_hold_in_whole_numbers(name, rng):
    relations = jb.parity_relations(paper(**MODELS[name]))
    reading = relations.reading(np.float64)
    u, y = at_boundary(relations, reading, rng, np.float64)
    margin = np.asarray(folded(reading, u, y))
    starts = np.arange(N - 1)
    exact = whole_numbers.exact_strip_margins(
        relations, reading, relations.strips("joint"), *gather(u, y, starts, 1, 1)
    )
    assert (margin != 0).sum() > N / 2
    np.testing.assert_array_equal(np.sign(margin[margin != 0]), np.sign(exact[margin != 0]))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_numbers_that_overflow_prove_nothing_wrong(dtype, rng):
    """Step by step and folded, both are proofs: they may differ in what they leave open, no more."""
    top, tiny = np.finfo(dtype).max, np.finfo(dtype).tiny
    corners = np.array(
        [0, -0.0, tiny, tiny / 4, 1, -1, top / 8, -top / 2, top, np.inf, -np.inf, np.nan], dtype
    )
    signs = set()
    for offset in ({}, {"offset": {"u": [1], "y": [float(top) / 4, -1]}}):
        reading = jb.parity_relations(paper(**offset)).reading(dtype)
        for _ in range(30):
            u, y = rng.choice(corners, (N, 1)), rng.choice(corners, (N, 2))
            before, now = (np.asarray(f(reading, u, y)) for f in (step_by_step, folded))
            assert not (np.sign(before) * np.sign(now) < 0).any()
            np.testing.assert_array_equal(np.isnan(now), np.isnan(before))
            infinite = np.isinf(y).any(1)
            # else a circuit without both is left
            needed = (infinite[1:] | infinite[:-1]) & ~np.isnan(u[:-1, 0])
            assert not (now[needed] > 0).any()
            signs |= set(np.sign(now).tolist())
    assert {-1, 0, 1} <= signs


@pytest.mark.compiled
def test_wide_vectors_give_the_same_bits(rng):
    """Alone for the widest vectors, within another program as XLA likes: margins are the same."""
    reading = jb.parity_relations(paper()).reading(np.float64)
    u, y = rng.normal(size=(N + 1, 1)), rng.normal(size=(N + 1, 2))
    alone = verdicts(reading, u, y)
    within = jax.jit(lambda *x: jax.tree.map(jnp.copy, verdicts(*x)))(reading, u, y)
    for x, z in zip(alone, within, strict=True):
        np.testing.assert_array_equal(x, z)


def test_folded_verdicts_outside_xla_are_the_same(rng):
    reading = jb.parity_relations(paper()).reading(np.float64)
    u, y = rng.normal(size=(N + 1, 1)), rng.normal(size=(N + 1, 2))
    y[::7] = np.nan
    compiled = np.asarray(verdicts(reading, u, y)[0])
    with outside_xla():
        np.testing.assert_array_equal(verdicts(reading, u, y)[0], compiled)
    assert {Status.MISSING, Status.FAULT} <= set(compiled.tolist())
