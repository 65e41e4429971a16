"""Margins without proof: few programs, whatever is asked of them."""

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.consistency import unproved


@pytest.mark.parametrize("horizon", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_a_gradient_of_margins_is_few_programs(horizon, rng, caplog):
    """What is not in one of them is done operation by operation, each compiled alone."""
    r = jb.parity_relations(paper(), horizon)
    u, y, noise = rng.uniform(-1, 1, (12, 1)), rng.normal(size=(12, 2)), np.array([0.1, 0.1])
    with jax.log_compiles():
        slope = jax.vjp(lambda noise: jb.margins(r.with_bounds({"noise": noise}), u, y), noise)[1](
            np.ones(12)
        )[0]
    programs = [m.split()[4] for m in caplog.messages if m.startswith("Finished XLA compilation")]
    assert np.isfinite(slope).all() and (slope != 0).any()
    assert len(programs) <= 4, programs


def test_a_search_compiles_where_the_compiler_does_not_know_how_to_be_quick(rng, monkeypatch):
    """Another jaxlib may have dropped the option: what is found and its derivative are then those of the
    usual way.
    """
    r = jb.parity_relations(paper(), 5)
    u, y = rng.uniform(-1, 1, (12, 1)), rng.normal(size=(12, 2))
    slope = jax.grad(lambda y: jax.numpy.nansum(jb.margins(r, u, y)))
    quick = slope(y)
    asked = jax.jit(unproved._search_flat, static_argnums=0, compiler_options={"xla_no_such_option": False})
    monkeypatch.setattr(unproved, "_alone_quickly", asked)
    np.testing.assert_allclose(slope(y), quick, rtol=1e-9, atol=1e-12)
    assert np.abs(quick).max() > 0


def test_a_search_of_which_the_compiler_says_anything_else_is_not_repeated(monkeypatch):
    def fails(*given):
        raise jax.errors.JaxRuntimeError("out of memory")

    monkeypatch.setattr(unproved, "_alone_quickly", fails)
    with pytest.raises(jax.errors.JaxRuntimeError, match="out of memory"):
        unproved._searched(None, np.ones(2), np.ones((2, 1)), np.ones((2, 1)))
