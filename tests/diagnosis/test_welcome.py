"""What people bring that is not quite what was asked for: seeds, byte orders, float64 without x64, jit."""

import warnings

import jax
import numpy as np
import pytest
from result_case import biased

import jaxbound as jb
from jaxbound.estimation.validation import validate
from jaxbound.random.keys import key_of
from jaxbound.text.warned import warn_once


@pytest.fixture(scope="module")
def run():
    return biased()[0]


@pytest.fixture
def tank(tmp_path):
    """Return a plant with two tests, the path of its file, that of a recording and its (u, y)."""
    tests = [{"name": "jumps", "horizon": 1}, {"name": "drifts", "horizon": 6, "factor": 1.5}]
    model = jb.LinearSystem(
        [[0.9]], [[1]], [[1]], noise=0.1, dt=1, inputs="pump", outputs="level", tests=tests
    )
    u, y = np.zeros((7, 1)), np.array([[9], [8.1], [7.3], [6.6], [5.9], [5.9], [5.3]])
    jb.save_model(model, tmp_path / "plant.toml")
    rows = [f"{k},{a[0]},{b[0]}" for k, (a, b) in enumerate(zip(u, y, strict=True))]
    (tmp_path / "run.csv").write_text("\n".join(["time,pump,level", *rows, ""]))
    return model, tmp_path / "plant.toml", tmp_path / "run.csv", (u, y)


def test_a_plant_is_watched_by_its_own_monitor_and_a_recording_may_be_a_path(tank):
    model, file, run, (u, y) = tank
    wanted = jb.detect(jb.monitor(model), u, y)
    assert wanted.status.tolist() == [0, 1, 1, 1, 1, 3, 3]
    for plant in (model, file, str(file)):
        for recording in ((u, y), (run,), (str(run),), ({"pump": u[:, 0], "level": y[:, 0]},)):
            result = jb.detect(plant, *recording)
            np.testing.assert_array_equal(result.status, wanted.status)
            np.testing.assert_array_equal(result.margin, wanted.margin)
            assert result.tests["drifts"].status[-1] == jb.Status.FAULT
    assert jb.detect(model, run).when(6) == 6
    found = jb.assess(model, [run], [])
    assert found.score.false == 2 and found.score.healthy == 6


def test_every_verb_that_takes_samples_reads_a_path(tank):
    model, _, run, (u, y) = tank
    r = jb.parity_relations(model)
    residual = jb.residual(
        lambda z, u, y: y[1] - 0.9 * y[0] - z,
        jb.interval([-0.2], [0.2]),
        horizon=1,
        inputs=["pump"],
        outputs=["level"],
    )
    for verb in (
        lambda *given: jb.detect(jb.observer(model), *given).status,
        lambda *given: jb.detect(residual, *given).status,
        lambda *given: jb.margins(r, *given),
        lambda *given: jb.observe(model, *given).state.lo,
        lambda *given: validate(model, *given).state.lo,
        lambda *given: r.external(*given),
    ):
        np.testing.assert_array_equal(verb(run), verb(u, y))
    leaking = jb.LinearSystem([[0.9]], None, [[1]], noise=0.1, dt=1, outputs="level", unknown_inputs=[[-1]])
    leaks = [jb.unknown_inputs(leaking, *given).values.lo for given in ((run,), (None, y))]
    np.testing.assert_array_equal(*leaks)
    with pytest.raises(ValueError, match="a path holds inputs and outputs"):
        jb.detect(model, run, run)
    with pytest.raises(FileNotFoundError, match="there is no data file"):
        jb.detect(model, "nowhere.csv")


@pytest.mark.parametrize("kind", [">f8", "<f8"])
def test_arrays_of_any_byte_order_are_judged_alike(run, kind):
    res = jb.detect(run.relations, run.u.astype(kind), run.y.astype(kind))
    np.testing.assert_array_equal(res.status, run.status)
    np.testing.assert_array_equal(res.margin, run.margin)
    Z = jb.zonotope(np.ones(2, kind), np.eye(2, dtype=kind))
    assert float(Z.center.sum()) == 2 and jb.interval(np.ones(2, kind)).lo.dtype == np.float64


def test_seeds_may_be_whole_numbers():
    Z = jb.zonotope([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]])
    for seed in (3, np.int64(3)):
        np.testing.assert_array_equal(jb.sets.sample(Z, seed, 4), jb.sets.sample(Z, jax.random.key(3), 4))
    m, u = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1), np.zeros((9, 1))
    np.testing.assert_array_equal(jb.simulate(m, u, 3).y, jb.simulate(m, u, jax.random.key(3)).y)
    assert key_of(jax.random.PRNGKey(3)).shape == (2,)
    for wrong in ("3", 3.0, None, True):
        with pytest.raises(TypeError, match="key must be a jax.random key or a whole number, not"):
            key_of(wrong)


def test_float64_without_x64_is_said_once_and_only_where_it_costs(run):
    m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
    with jax.enable_x64(False):
        r = jb.parity_relations(m)
        warn_once.cache_clear()
        with pytest.warns(
            UserWarning, match="rounded to float32.*2.4e-07 of the largest sample.*jax_enable_x64"
        ) as said:
            jb.detect(r, None, [[1.0], [0.8]])
        assert said[0].filename == __file__  # of whoever can do something about it
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            jb.detect(r, None, [[1.0], [0.7]])
            jb.detect(r, None, [[1.0], [0.5]])
            jb.detect(r, None, np.array([[1.0], [0.8]], np.float32))


def test_what_it_costs_is_what_the_bounds_take():
    from jaxbound.models.sensor import RECORDER_ULPS

    assert f"{RECORDER_ULPS * np.finfo(np.float32).eps / 2:.1e}" == "2.4e-07"


def test_detect_inside_a_transformation_says_what_to_use(run):
    says = "cannot run inside jit, vmap or grad.*margins"
    with pytest.raises(TypeError, match=says):
        jax.jit(jb.detect)(run.relations, run.u, run.y)
    with pytest.raises(TypeError, match=says):
        jax.vmap(lambda y: jb.detect(run.relations, run.u, y).margin)(run.y[None])
