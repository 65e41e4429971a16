"""Margins without proof: few programs, whatever is asked of them."""

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb


@pytest.mark.parametrize("horizon", [1, pytest.param(8, marks=pytest.mark.long)])
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
