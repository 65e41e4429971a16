"""What people bring that is not quite what was asked for: seeds, byte orders, float64 without x64, jit."""

import warnings

import jax
import numpy as np
import pytest
from result_case import biased

import jaxbound as jb
from jaxbound.random.keys import key_of
from jaxbound.text.warned import warn_once


@pytest.fixture(scope="module")
def run():
    return biased()[0]


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
