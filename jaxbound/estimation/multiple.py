"""Multiple models whose partial outputs are all measured: every sub-model is validated alone, and one verdict
is made of all.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.estimation.validation_result import Validation
from jaxbound.models.multimodel import MultiModel
from jaxbound.recordings.arrays import float_array
from jaxbound.recordings.read import recorded
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.table import Data, as_table, is_table
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.intervals.interval import sum as interval_sum
from jaxbound.sets.linear_systems.products import product


def validate_parts(
    model: MultiModel,
    u: Data,
    y: Data,
    x0: Interval | None,
    validate: Callable[..., Validation],
    starts: ArrayLike = (),
) -> Validation:
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
    recording = _recording_of_parts(model, u, y, starts)
    inputs, outputs = np.asarray(recording.u), np.asarray(recording.y)
    outputs = outputs.reshape(*outputs.shape[:-1], len(model.models), model.models[0].p)
    if x0 is not None and (x0 := interval(x0)).shape[-1:] != (model.n,):
        raise ValueError(f"x0 needs one interval for each of {model.n} states: its shape is {x0.shape}")
    validated: list[Validation] = []
    begin = 0
    for i, part in enumerate(model.models):
        first = None
        if x0 is not None:
            first = x0[..., begin : begin + part.n]
        validated.append(validate(part, inputs, outputs[..., i, :], x0=first, starts=recording.starts))
        begin += part.n
    mu = model.mu(np.asarray(inputs, model.models[0].A.dtype))
    output, residual, corrected = _weighted_sum(mu, [(v.output, v.residual, v.corrected) for v in validated])
    # a weighted sum lacks what any of its parts lacks
    absent = jnp.where(jnp.isnan(jnp.asarray(outputs, output.lo.dtype)).any(-2), jnp.nan, 0)
    return replace(
        validated[0],
        state=jax.tree.map(lambda *a: jnp.concatenate(a, -1), *(v.state for v in validated)),
        output=output,
        residual=Interval(residual.lo + absent, residual.hi + absent),
        faulty=jnp.stack([jnp.asarray(v.faulty) for v in validated]).any(0),
        corrected=corrected,
        status=jnp.asarray(_agreed(np.stack([np.asarray(v.status) for v in validated]))),
    )


def _recording_of_parts(model: MultiModel, u: Data, y: Data, starts: ArrayLike) -> Recording:
    """Return the Recording, in the type it was recorded in, the outputs (..., T, L p) of all sub-models side
    by side.
    """
    count, p = len(model.models), model.models[0].p
    outputs: list[str] = []
    for i, part in enumerate(model.models):
        outputs += [f"{i + 1}.{name}" for name in part.outputs]
    y = as_table(y, "y", outputs)
    if not is_table(y) and y is not None:
        shape = np.shape(y)
        if shape[-2:] != (count, p) or len(shape) < 3:
            raise ValueError(
                f"y must have shape (..., T, {count}, {p}), each sub-model's own outputs: its shape is "
                f"{shape}"
            )
        y = float_array(y, "y").reshape(*shape[:-2], count * p)
    signals = Signals(model.models[0].inputs, tuple(outputs), {})
    return recorded(signals, u, y, starts, narrow=False)


def _agreed(each: np.ndarray) -> np.ndarray:
    """Return the status (...) of all sub-models, from that of each (L, ...): FAULT where any is, else what
    all say.
    """
    agreed = np.where((each == each[0]).all(0), each[0], Status.UNDECIDED)
    # one refuted sub-model refutes the sum of which it is a part
    return np.where((each == Status.FAULT).any(0), Status.FAULT, agreed).astype(np.int8)


@kernel
def _weighted_sum(mu: Interval, parts: Sequence[tuple[Interval, ...]]) -> tuple[Interval, ...]:
    """Return sum_i mu_i x_i for each of the Intervals x_i that the sub-models have."""
    mu = jax.tree.map(lambda end: jnp.moveaxis(end, -1, 0)[..., None], mu)
    sums = []
    for of_each in zip(*parts, strict=True):
        x = jax.tree.map(lambda *ends: jnp.stack(ends), *of_each)
        # not worked out together with its use
        share: Interval = jax.lax.optimization_barrier(product(mu, x))  # type: ignore[no-untyped-call]
        sums.append(interval_sum(share, axis=0))
    return tuple(sums)
