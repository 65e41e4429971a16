"""Residuals of whole recordings and the intervals that bounds allow them: for pictures, not rounded."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Relations, Starts
from jaxbound.recordings.read import recorded
from jaxbound.sets.intervals.interval import Interval

Forms: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]
"""(external, lowest, highest internal form), each (T, count)."""
R = TypeVar("R")


class Formed(Relations):
    """Relations whose residuals have an external and an internal form."""

    def external(self, u: object, y: object = None, starts: Starts = ()) -> jax.Array:
        """Return the residuals (..., T, count) at the middle of all bounds, NaN where a window is incomplete.
        Not rounded: for plots and studies.

        Args:
            u: (..., T, m) inputs (None without inputs). y: (..., T, p) outputs; starts: as for `detect`.

        Source: Adrot 2000, (7), (14).
        """
        return self._forms(u, y, starts)[0]

    def internal(self, u: object, y: object = None, starts: Starts = ()) -> Interval:
        """Return the Interval (..., T, count) that each residual alone may have when the plant is healthy.
        Not rounded: for plots.

        Source: Adrot 2000, (9), (15), with mu in [y - t_hi, y - t_lo]; of uncertain parameters, every
        monomial and noise at its worst by itself, Ploix, Adrot 2006, (14).
        """
        _, lo, hi = self._forms(u, y, starts)
        return Interval(lo, hi)

    def _forms(self, u: object, y: object, starts: Starts) -> Forms:
        """Return both forms of recordings."""
        raise NotImplementedError


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
    return jnp.asarray(form).at[..., samples, :].set(jnp.nan)


def over_samples(x: jax.Array, s: int) -> jax.Array:
    """Return (count, N) over windows as (N + s, count) over samples, NaN before the first window ends."""
    return jnp.pad(x.T, ((s, 0), (0, 0)), constant_values=jnp.nan)
