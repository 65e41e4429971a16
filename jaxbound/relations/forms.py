"""Residuals of whole recordings and the intervals that bounds allow them: for pictures, not rounded."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Relations, Starts
from jaxbound.recordings.read import recorded

__all__ = ["Forms", "forms"]

Forms: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]
"""(external, lowest, highest internal form), each (T, count)."""
R = TypeVar("R")


def forms(
    kernel: Callable[[R, jax.Array, jax.Array], Forms],
    relations: Relations,
    reading: Callable[[DTypeLike], R],
    u: object,
    y: object,
    starts: Starts,
) -> Forms:
    """Return the Forms (..., T, count) that kernel(reading(dtype), u (T, m), y (T, p)) makes of recordings;
    NaN where there is no window.
    """
    given = recorded(relations.model, u, y, starts)
    # jnp.asarray would compile a copy for each shape
    on_device: tuple[jax.Array, jax.Array] = jax.device_put((given.u, given.y))
    inputs, outputs = on_device
    if outputs.shape[-2] <= relations.horizon:
        nothing = jnp.full((*outputs.shape[:-1], relations.count), jnp.nan, outputs.dtype)
        return nothing, nothing, nothing
    for _ in range(outputs.ndim - 2):
        kernel = jax.vmap(kernel, (None, 0, 0))
    external, lo, hi = kernel(reading(outputs.dtype), inputs, outputs)
    across = np.flatnonzero(given.across(relations.horizon))
    if not len(across):
        return external, lo, hi
    return _blanked(external, across), _blanked(lo, across), _blanked(hi, across)


def _blanked(form: jax.Array, samples: np.ndarray) -> jax.Array:
    """Return a form with NaN at some samples."""
    return form.at[..., samples, :].set(jnp.nan)
