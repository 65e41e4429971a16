"""Multiple models whose partial outputs are all measured: every sub-model is validated alone, and one verdict
is made of all.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.models.multimodel import MultiModel
from jaxbound.recordings.arrays import floats
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.table import as_table, is_table
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.intervals.interval import sum as interval_sum
from jaxbound.sets.linear_systems.kernels import product

__all__ = ["validate_parts"]

_held = jax.lax.optimization_barrier


def validate_parts(
    model: MultiModel, u: Any, y: Any, x0: Interval | None, validate: Callable, starts: ArrayLike = ()
) -> Any:
    """Validate every sub-model by its own partial outputs, and weigh what is found.

    Args:
        model: a MultiModel with partial=True. u: (..., T, m) or None. y: (..., T, L, p): C_i x_i as measured,
            for each of L sub-models.
        x0: Interval (..., n) of all states, or None. starts: as for `validate`, a function of (sub-model, u,
            y (..., T, p), x0=, starts=).

    Returns:
        A Validation: state of all sub-models; output, residual and corrected weighted as y is, of sum_i mu_i
        C_i x_i; faulty where a sensor is in any sub-model; status FAULT where any is, MISSING or CONSISTENT
        where all are.

    Raises:
        ValueError: y or x0 of another shape, weights that are none.

    Source: the multiple-model paper, (8)-(15) and section V.
    """
    p = model.models[0].p
    count = len(model.models)
    inputs, outputs = (
        model.models[0].inputs,
        tuple(f"{i + 1}.{name}" for i, m in enumerate(model.models) for name in m.outputs),
    )
    y = as_table(y, "y", outputs)
    if not is_table(y) and y is not None:
        if (shape := np.shape(y))[-2:] != (count, p) or len(shape) < 3:
            raise ValueError(
                f"y must have shape (..., T, {count}, {p}), each sub-model's own outputs: its shape is "
                f"{shape}"
            )
        y = floats(y, "y").reshape(*shape[:-2], count * p)
    given = Recording.of(
        Signals(inputs, outputs, {}), u, y, starts, narrow=False
    )  # in the type it was recorded in
    u, y = np.asarray(given.u), np.asarray(given.y).reshape(*given.y.shape[:-1], count, p)
    states = np.cumsum([0, *(m.n for m in model.models)])
    if x0 is not None and (x0 := interval(x0)).shape[-1:] != (model.n,):
        raise ValueError(f"x0 needs one interval for each of {model.n} states: its shape is {x0.shape}")
    first = lambda i: None if x0 is None else x0[..., states[i] : states[i + 1]]
    local = [
        validate(m, u, y[..., i, :], x0=first(i), starts=given.starts) for i, m in enumerate(model.models)
    ]
    output, residual, corrected = _weighed(
        model.mu(np.asarray(u, model.models[0].A.dtype)), [(v.output, v.residual, v.corrected) for v in local]
    )
    absent = jnp.where(jnp.isnan(jnp.asarray(y, output.lo.dtype)).any(-2), jnp.nan, 0)
    each = np.stack([np.asarray(v.status) for v in local])
    agreed = np.where((each == each[0]).all(0), each[0], Status.UNDECIDED)
    return replace(
        local[0],
        state=jax.tree.map(lambda *a: jnp.concatenate(a, -1), *(v.state for v in local)),
        output=output,
        residual=Interval(residual.lo + absent, residual.hi + absent),
        faulty=jnp.stack([v.faulty for v in local]).any(0),
        corrected=corrected,
        status=jnp.asarray(np.where((each == Status.FAULT).any(0), Status.FAULT, agreed).astype(np.int8)),
    )


@kernel
def _weighed(mu, local):
    """Return sum_i mu_i x_i for each of the Intervals x_i that the sub-models have."""
    weigh = lambda *parts: interval_sum(
        _held(Interval(*(jnp.stack(e) for e in zip(*_ends(mu, parts), strict=True)))), axis=0
    )
    return tuple(weigh(*parts) for parts in zip(*local, strict=True))


def _ends(mu, parts):
    for i, x in enumerate(parts):
        share = _held(product(mu[..., i : i + 1], x))
        yield share.lo, share.hi
