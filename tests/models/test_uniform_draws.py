"""What the host draws is what `jax.random` does, bit for bit."""

import jax
import numpy as np
import pytest

from jaxbound.models import draws


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_few_numbers_are_those_of_jax_random(dtype, module_seed):
    streams, size, dtype = (0, 1, 3), 70, np.dtype(dtype)
    for key in (jax.random.key(module_seed), jax.random.key(2**40 + 3), jax.random.PRNGKey(7)):
        found = draws.uniform_draws(key, streams, 5, size, dtype)
        keys = jax.random.split(key, 5)
        wanted = [
            [jax.random.uniform(jax.random.fold_in(k, s), (size,), dtype, -1, 1) for k in keys]
            for s in streams
        ]
        assert isinstance(found, np.ndarray) and found.dtype == dtype
        np.testing.assert_array_equal(found, wanted)


def test_many_numbers_and_those_of_other_keys_begin_as_few_do(monkeypatch):
    few = draws.uniform_draws(jax.random.key(3), (1, 5), 3, 40, np.dtype(float))
    monkeypatch.setattr(draws, "FEW", 0)
    np.testing.assert_array_equal(
        draws.uniform_draws(jax.random.key(3), (1, 5), 5, 70, np.dtype(float))[:, :3, :40], few
    )
    assert draws.uniform_draws(jax.random.key(3, impl="rbg"), (1,), 2, 8, np.dtype(float)).shape == (1, 2, 8)
