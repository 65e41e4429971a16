"""The fast recursion: each of its windows is explained exactly by unknowns within the bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import MODELS
from study_case import GUST, noises, simple

import jaxbound as jb
from jaxbound.models.window import model_matrices
from jaxbound.studies.montecarlo import recursion

SAMPLES, N = 60, 40


def run(model, rng, vertices, horizon, dtype=np.float64, inputs=1.0):
    """Return (room, x, u, y, theta, w), arrays over (time, signal, scenario) as a compiled scan makes
    them.
    """
    highest = np.full(model.m, inputs)
    room = recursion.rounding_room(model, horizon, highest, SAMPLES, dtype)
    assert recursion.fits(model, room)
    plant = recursion.plant_of(model, room, dtype)
    n, m, p, g = plant.shape
    draw = lambda *shape: (rng.choice([-1.0, 1.0], shape) if vertices else rng.uniform(-1, 1, shape)).astype(
        dtype
    )
    offset = np.array([float(x) for x in model.offset["u"]])[None, :, None]
    u = (offset + rng.uniform(-inputs, inputs, (SAMPLES, m, N))).astype(dtype)
    theta, delta = plant.tolerance[:, None] * draw(SAMPLES, p, N), plant.noise[:, None] * draw(SAMPLES, p, N)
    shares = draw(SAMPLES, g, N)

    @jax.jit
    def scan(u, theta, delta, shares):
        def now(x, given):
            u, theta, delta, share = given
            after, y = recursion.step(plant, list(x), list(u), list(theta), list(delta), list(share))
            return jnp.stack(after), (x, jnp.stack(y))

        return jax.lax.scan(now, jnp.zeros((n, N), dtype), (u, theta, delta, shares))[1]

    x, y = scan(u, theta, delta, shares)
    half = plant.hi - plant.lo
    w = (
        np.clip(plant.lo[:, None] + (1 + shares) * 0.5 * half[:, None], plant.lo[:, None], plant.hi[:, None])
        if g
        else shares
    )
    return room, np.asarray(x), u, np.asarray(y), theta, w


CASES = [("paper", 1), ("offsets", 3), ("feedthrough", 2), ("three states", 4), ("no input", 5), ("gust", 3)]


@pytest.mark.parametrize(("name", "s", "vertices"), [*[(*case, True) for case in CASES], ("gust", 2, False)])
def test_every_window_is_explained_exactly_within_the_bounds(name, s, vertices, rng):
    model = jb.LinearSystem(**MODELS.get(name, GUST))
    room, x, u, y, theta, w = run(model, rng, vertices, s)
    for _ in range(25):
        i, k = rng.integers(N), rng.integers(SAMPLES - s)
        part = lambda a, i=i, k=k: a[k : k + s + 1, :, i]
        needed, plant = noises(name, s, x[k, :, i], part(u), part(y), part(theta), part(w))
        for row in needed:
            for value, rho, resolution in zip(row, plant.noise, plant.resolution, strict=True):
                assert abs(value) <= rho + resolution
    assert (room < 1e-11).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_room_is_needed_and_no_more_than_some_hundred_times_what_is(dtype, rng):
    """The noise that rounding really costs comes within a factor of 300 of the room: the bound is not
    idle.
    """
    model, s = jb.LinearSystem(**MODELS["paper"]), 1
    room, x, u, y, theta, w = run(model, rng, True, s, dtype)
    limit = np.array([float(v) for v in recursion.plant_of(model, room, dtype).noise])
    most = np.zeros(2)
    for i in range(N):
        for k in range(0, SAMPLES - s, 13):
            part = lambda a, i=i, k=k: a[k : k + s + 1, :, i]
            needed, _ = noises("paper", s, x[k, :, i], part(u), part(y), part(theta), part(w))
            most = np.maximum(
                most, [max(float(abs(row[j]) - float(limit[j])) for row in needed) for j in range(2)]
            )
    assert (most <= room).all() and (most > room / 300).all()


def test_no_noise_a_growing_state_and_what_is_not_certain_do_not_fit():
    fits = lambda m: recursion.fits(m, recursion.rounding_room(m, 1, np.ones(m.m), 200, np.float64))
    assert fits(simple())
    assert not fits(simple(noise=0)) and fits(simple(noise=0, resolution=0.01))
    assert not fits(simple(A=[[1.3]]))
    assert not fits(simple(uncertainties=[jb.Uncertainty("k", B=[[0.1]])])) and not fits(
        simple(constant_tolerance=True)
    )


def test_reach_is_what_the_worst_inputs_come_to(rng):
    model = jb.LinearSystem(**GUST)
    A, B, C, _, G = model_matrices(model, "ABCDG")
    states, outputs = recursion.largest_reach(model, np.ones(1), 50)
    drive, power, x = np.hstack([B, 0.05 * G]), np.eye(2), np.zeros(2)
    for _ in range(50):
        x, power = x + abs(power @ drive).sum(1), power @ A
    np.testing.assert_allclose(states, x, rtol=2e-3)
    assert (outputs > abs(C) @ x * 0.5).all()
