"""Strips of a few circuits: many known values are summed in a loop, with the same result."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips.strips import Strips, strip_margin, strip_verdict

margin = kernel(strip_margin)
CIRCUITS, ROWS, WINDOWS = 9, 3, 5


def strips(rng, known):
    h, k = rng.normal(size=(CIRCUITS, ROWS)), rng.normal(size=(CIRCUITS, known))
    return Strips(np.tile(np.arange(ROWS), (CIRCUITS, 1)), h, k, None)


def box(rng, known):
    return (jnp.asarray(rng.normal(size=(count, WINDOWS))) for count in (ROWS, ROWS, known))


def test_many_known_values_count_as_in_the_formula(rng):
    given = strips(rng, 100)
    mid, rad, known = box(rng, 100)
    rad, known = abs(rad) + 0.1, known.at[7, 2].set(jnp.nan)
    for k, missing in ((given.k, [2]), (np.where(np.arange(100) == 7, 0, given.k), [])):
        own = Strips(given.rows, given.h, k, None)
        used = np.where((k != 0)[:, :, None], k[:, :, None] * np.asarray(known)[None], 0).sum(1)
        gauge = (abs(given.h @ np.asarray(mid) - used) / (abs(given.h) @ np.asarray(rad))).max(0)
        found = margin(own, mid, rad, known)
        assert np.flatnonzero(np.isnan(found)).tolist() == missing
        np.testing.assert_allclose(found, 1 - gauge, rtol=1e-12, atol=1e-12)


def test_what_underflow_may_take_decides_nothing():
    """|x| <= 2 of the smallest normal numbers: each product may lose one."""
    tiny, one = np.finfo(float).tiny, np.ones((1, 1))
    mid, none = tiny * np.array([[0.0, 1, 3, 1e9, -1e9]]), np.zeros((0, 5))
    given = Strips(np.zeros((1, 1), np.int32), one, np.zeros((1, 0)), None)
    found = kernel(strip_verdict)(given, mid, 2 * tiny + 0 * mid, abs(mid), none, none, 1.0)
    assert np.sign(found).tolist() == [0, 0, 0, -1, -1]


def test_the_program_does_not_grow_with_the_number_of_known_values(rng):
    sizes = []
    for known in (70, 280):
        sizes.append(len(str(jax.make_jaxpr(strip_margin)(strips(rng, known), *box(rng, known)))))
    assert sizes[1] < 1.1 * sizes[0]
