"""Simulated recordings against trajectories in exact rationals; unknowns inside their bounds; shapes, keys,
refusals.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest
from oracles import MODELS, Plant
from systems import paper

import jaxbound as jb
from jaxbound.models import simulate as module
from jaxbound.sets.floats.kernel import kernel, outside_xla

pytestmark = pytest.mark.usefixtures("simulated_by_xla")

HARD = {
    **MODELS,
    "unstable": dict(
        A=[[1.25, 0.3], [0, 1.1]], B=[[0.5], [1]], C=[[1, 0], [1, -1]], tolerance=[0.01, 0], noise=[0.5, 0.01]
    ),
    "difference of levels": dict(
        A=[["1", "1e-3"], ["0", "1"]], B=[[1e-6], [1e-3]], C=[[1, -1], [1e5, -99999.9]], noise=[1e-3, 1e-2]
    ),
    "far offset": dict(
        A=[[0.9, 0], [0.1, 0.5]],
        B=[[1], [0]],
        C=[[1, 0], [0.1, 1]],
        tolerance=[0.02, 0],
        noise=[0.1, 0.05],
        offset={"u": [1e6], "y": [1e6, -273.15]},
    ),
    "thirds": dict(
        A=[["1/3", "2/3"], ["-1/7", "8/9"]],
        B=[["1/11"], ["1/13"]],
        C=[["1/3", "-1/3"], ["1/7", 0]],
        D=[["1/9"], [0]],
        noise="1/3",
    ),
}
START = {
    "unstable": [1.5, -2.25],
    "difference of levels": [1e6, 1e6],
    "far offset": [0.3, 7.0],
    "thirds": [1000.1, 999.7],
}
BATCH, LARGE = (3, 40), (2500, 201)  # few shapes, because each compiles


def build(name):
    return jb.LinearSystem(**HARD[name])


def inputs(name, shape, rng, dtype=np.float64):
    plant = Plant(**HARD[name])
    return (rng.uniform(-1, 1, (*shape, plant.m)) + [float(v) for v in plant.offset_u]).astype(dtype)


def key(rng):
    return jax.random.key(int(rng.integers(2**31)))


def exact_outputs(plant, x0, t):
    """Return y (T, p) before it was rounded, from the unknowns that a Trajectory says were drawn."""
    u = [[Fraction(float(v)) - plant.offset_u[i] for i, v in enumerate(row)] for row in np.asarray(t.u)]
    true = plant.trajectory([Fraction(float(v)) for v in x0], u)
    theta, noise = ([[Fraction(float(v)) for v in row] for row in np.asarray(a)] for a in (t.theta, t.noise))
    return [
        [(1 + theta[k][i]) * v + noise[k][i] + plant.offset_y[i] for i, v in enumerate(row)]
        for k, row in enumerate(true)
    ]


TWO_STATES = (
    "paper",
    "noise only",
    "feedthrough",
    "unstable",
    "difference of levels",
    "far offset",
    "thirds",
)
KINDS = (("uniform", np.float64), ("vertices", np.float64), ("vertices", np.float32))
CASES = [(name, at, dtype) for name in TWO_STATES for at, dtype in KINDS]
CASES += [("offsets", "vertices", np.float64), ("no input", "vertices", np.float64)]
CASES += [pytest.param("three states", "uniform", np.float32, marks=pytest.mark.long)]


def worst_error(plant, x0, t):
    """Return the largest distance of a recorded sample from the exact one, in units of half an ulp (unit
    roundoff times the sample).
    """
    u, worst = Fraction(float(np.finfo(t.y.dtype).eps)) / 2, 0.0
    for got, row in zip(np.asarray(t.y), exact_outputs(plant, x0, t), strict=True):
        for a, b in zip(got, row, strict=True):
            worst = max(
                worst, float(abs(Fraction(float(a)) - b) / (u * abs(b))) if b else float(a != 0) * np.inf
            )
    return worst


@pytest.mark.parametrize("name, at, dtype", CASES)
def test_samples_are_an_exact_trajectory_rounded_once(name, at, dtype, rng):
    plant = Plant(**HARD[name])
    x0 = np.array(START.get(name, [1.0] * plant.n), dtype)
    t = jb.simulate(build(name), inputs(name, BATCH, rng, dtype), key(rng), x0=x0, at=at)
    assert t.y.dtype == dtype
    worst = max(worst_error(plant, x0, jax.tree.map(lambda v, i=i: v[i], t)) for i in range(3))
    print(f"worst error {worst:.6f} half ulps")
    assert worst < 1 + 1e-4


def test_samples_stay_exact_when_the_model_is_a_constant_of_a_compiled_function(rng):
    """XLA rewrites sums with constants: (theta + 1) - 1 became theta, and samples were off by 476 half
    ulps.
    """
    plant, u = Plant(**HARD["offsets"]), inputs("offsets", (40,), rng)
    t = jax.jit(jax.vmap(lambda k: jb.simulate(build("offsets"), u, k, x0=[3.0, -2.0])))(
        jax.random.split(key(rng), 3)
    )
    assert (
        max(worst_error(plant, [3.0, -2.0], jax.tree.map(lambda v, i=i: v[i], t)) for i in range(3))
        < 1 + 1e-4
    )


def test_samples_stay_exact_in_a_large_batch(rng):
    plant, u = Plant(**HARD["far offset"]), inputs("far offset", LARGE, rng)
    t = jax.tree.map(np.asarray, jb.simulate(build("far offset"), u, key(rng)))
    assert (
        max(worst_error(plant, [0, 0], jax.tree.map(lambda v, i=i: v[i], t)) for i in rng.choice(2500, 2))
        < 1 + 1e-4
    )


@pytest.mark.parametrize("name", ["difference of levels", "unstable"])
def test_a_plain_recursion_is_not_an_exact_trajectory(name, rng):
    plant, u, x = Plant(**HARD[name]), inputs(name, (40,), rng), np.array(START[name])
    A, B, C = (np.array([[float(v) for v in row] for row in a]) for a in (plant.A, plant.B, plant.C))
    y, zero = [], np.zeros((40, 2))
    for now in u:
        y.append(C @ x)
        x = A @ x + B @ now
    assert worst_error(plant, START[name], jb.Trajectory(None, u, np.array(y), zero, zero, None)) > 3


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["paper", "noise only", "thirds"])
def test_unknowns_stay_within_the_models_exact_bounds(name, dtype, rng):
    plant = Plant(**HARD[name])
    t = jb.simulate(build(name), inputs(name, BATCH, rng, dtype), key(rng), at="vertices")
    for drawn, bound in ((t.theta, plant.tolerance), (t.noise, plant.noise)):
        for column, b in zip(np.asarray(drawn).reshape(-1, plant.p).T, bound, strict=True):
            assert max(abs(Fraction(float(v))) for v in column) <= b


def test_vertices_are_the_bounds_themselves_in_both_signs(rng):
    t = jb.simulate(paper(), inputs("paper", BATCH, rng), key(rng), at="vertices")
    for drawn, bound in ((t.theta, [0.02, 0.1]), (t.noise, [0.1, 0.01])):
        drawn = np.asarray(drawn).reshape(-1, 2)
        np.testing.assert_allclose(abs(drawn), np.tile(bound, (120, 1)), rtol=2e-16)
        assert (abs(np.sign(drawn).mean(0)) < 0.5).all()


def test_uniform_draws_fill_their_interval(rng):
    t = jb.simulate(paper(), inputs("paper", LARGE, rng), key(rng))
    for drawn, bound in ((t.theta, [0.02, 0.1]), (t.noise, [0.1, 0.01])):
        scaled = np.asarray(drawn).reshape(-1, 2) / bound
        assert (abs(scaled) <= 1).all() and (abs(scaled).max(0) > 0.999).all()
        assert (abs(scaled.std(0) - 3**-0.5) < 0.005).all() and (abs(scaled.mean(0)) < 0.01).all()
        assert abs(np.corrcoef(scaled.T)[0, 1]) < 0.01


def test_unknowns_are_drawn_anew_each_sample_and_recording(rng):
    t = jb.simulate(paper(), inputs("paper", BATCH, rng), key(rng))
    for drawn in (np.asarray(t.theta), np.asarray(t.noise)):
        assert len(np.unique(drawn)) == drawn.size


def test_states_follow_the_plant(rng):
    t = jb.simulate(paper(), inputs("paper", BATCH, rng), key(rng), x0=[3.0, -4.0])
    x, u = np.asarray(t.x), np.asarray(t.u)
    np.testing.assert_array_equal(x[:, 0], [[3, -4]] * 3)
    np.testing.assert_allclose(
        x[:, 1:], x[:, :-1] @ [[0.8, 0], [1, 0.2]] + u[:, :-1] * [0, 1], rtol=0, atol=1e-14
    )


def test_the_first_state_is_zero_unless_given(rng):
    assert not np.asarray(jb.simulate(paper(), inputs("paper", BATCH, rng), key(rng)).x)[:, 0].any()


@pytest.mark.parametrize("batch", [(), (3,), (3, 1), (0,)])
def test_leading_axes_are_recordings(batch, rng):
    t = jb.simulate(paper(), inputs("paper", (*batch, 40), rng), key(rng))
    assert (t.x.shape, t.u.shape, t.y.shape) == ((*batch, 40, 2), (*batch, 40, 1), (*batch, 40, 2))
    assert t.theta.shape == t.noise.shape == t.y.shape


def test_each_recording_may_start_in_a_state_of_its_own(rng):
    x0 = rng.normal(size=(3, 2))
    t = jb.simulate(paper(), inputs("paper", BATCH, rng), key(rng), x0=x0)
    np.testing.assert_array_equal(np.asarray(t.x)[:, 0], x0)


def test_a_model_without_inputs_takes_an_empty_u(rng):
    t = jb.simulate(build("no input"), np.zeros((*BATCH, 0)), key(rng), x0=[1.0, 2.0], at="vertices")
    assert t.y.shape == (*BATCH, 2) and t.u.shape == (*BATCH, 0)


def test_one_key_gives_one_recording(rng):
    u, k = inputs("paper", BATCH, rng), key(rng)
    first, again, other = (jb.simulate(paper(), u, j).y for j in (k, k, jax.random.fold_in(k, 1)))
    np.testing.assert_array_equal(first, again)
    assert (np.asarray(first) != np.asarray(other)).all()


@pytest.mark.parametrize("u", [[[[1]] * 40] * 3, np.ones((3, 40, 1), int), np.ones((3, 40, 1), np.float16)])
def test_lists_integers_and_half_floats_become_the_default_float(u, rng):
    assert jb.simulate(paper(), u, key(rng)).y.dtype == np.float64


def test_a_second_simulation_of_another_plant_of_the_shape_does_not_trace(rng):
    u = inputs("paper", BATCH, rng)
    jb.simulate(paper(), u, key(rng))
    traced = module._trajectory._cache_size()
    jb.simulate(
        paper(A=[[0.5, 0.1], [0, 0.3]], noise=0.7, offset={"y": [1, 2]}), u + 1, key(rng), x0=[1.0, 1.0]
    )
    assert module._trajectory._cache_size() == traced


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(at="corners"), "at must be 'uniform' or 'vertices', not 'corners'"),
        (
            dict(u=np.zeros((20, 2))),
            r"u must have shape \(\.\.\., T, 1\), time first: its shape is \(20, 2\)",
        ),
        (dict(u=np.zeros(20)), r"its shape is \(20,\)"),
        (dict(u=np.array([[0.0], [np.inf]])), "u must be finite .* first in 'u1' at sample 1"),
        (dict(x0=np.zeros(3)), r"x0 must have shape \(2,\)"),
        (dict(x0=np.zeros((5, 2))), r"x0 must have shape \(2,\)"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    given = dict(u=np.zeros((20, 1)), x0=None, at="uniform") | change
    with pytest.raises(ValueError, match=message):
        jb.simulate(paper(), given.pop("u"), jax.random.key(0), **given)


def test_something_that_is_no_model_is_refused():
    with pytest.raises(TypeError, match="a model is a LinearSystem, or .* not dict"):
        jb.simulate({}, np.zeros((5, 1)), jax.random.key(0))


def test_numpy_follows_a_plant_to_the_same_bits(rng, monkeypatch):
    """As most other tests have it."""
    u, k = inputs("paper", (64,), rng), key(rng)
    by_xla = jb.simulate(paper(), u, k)
    monkeypatch.setattr(module, "_trajectory", kernel(module._trajectory.__wrapped__))
    with outside_xla():
        in_numpy = jb.simulate(paper(), u, k)
    np.testing.assert_array_equal(in_numpy.x, by_xla.x)
    np.testing.assert_array_equal(in_numpy.y, by_xla.y)


def test_recordings_of_many_lengths_are_compiled_once_and_begin_alike(rng):
    u, k = inputs("paper", (64,), rng), key(rng)
    whole, traced = jb.simulate(paper(), u, k), module._trajectory._cache_size()
    for T in (1, 7, 63):
        part = jb.simulate(paper(), u[:T], k)
        for name in ("x", "u", "y", "theta", "noise"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[:T])
    assert module._trajectory._cache_size() == traced
    assert [module._length(T, 1) for T in (0, 64, 65, 5000, 70_000)] == [0, 64, 256, 8192, 73_728]
