"""Scenarios written out as recordings and given to `detect`: for whatever the fused kernel has no room for.

Long windows whose combinations are searched for, uncertain parameters, unknown inputs, gains that stay
constant, sensors without noise, and unknowns that an adversary chose. What a study counts is the same.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import AUTO, Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.models.simulate import simulate
from jaxbound.models.system import LinearSystem
from jaxbound.random.threefry import Array
from jaxbound.sets.floats.status import Status
from jaxbound.studies.montecarlo import kernel, scenarios

__all__ = ["count_recordings", "recording_block", "simulate_block"]


def recording_block(course: kernel.Course, samples_at_once: int = 2**17) -> int:
    """Return how many scenarios are written out at once: a function of their length alone."""
    return max(1, min(kernel.BLOCK, samples_at_once // course.samples))


def count_recordings(
    relations: Relations,
    act: scenarios.Act,
    u: np.ndarray,
    y: np.ndarray,
    onset: np.ndarray,
    method: str = "joint",
    margins: str = AUTO,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (hits, false, delay) as `kernel.count_block` does, of recordings u (N, T, m), y (N, T, p) with
    onsets (N,). margins: as of `detect`.
    """
    s, end = relations.horizon, np.arange(y.shape[1])[None]
    fault = detect(relations, u, y, method, margins=margins).status == Status.FAULT
    start, length = np.asarray(onset)[:, None], int(act.length)
    touched = (end >= start) & (end - s < start + length)
    if relations.remembers:  # each sample behind the onset rests on faulty ones
        s, touched = 0, end >= start
    hits = (fault & (end - s >= start) & (end < start + length)).sum(1)
    seen = fault & touched
    delay = np.where(seen.any(1), seen.argmax(1) - start[:, 0], -1)
    return hits.astype(np.int32), (fault & ~touched).sum(1).astype(np.int32), delay.astype(np.int32)


def simulate_block(
    course: kernel.Course,
    model: LinearSystem,
    act: scenarios.Act,
    limits: np.ndarray,
    u: np.ndarray | None,
    key: np.ndarray,
    numbers: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return recordings u (N, T, m), y (N, T, p) and onsets (N,) simulated by `simulate`; the unknowns depend
    on the block as a whole.

    Args:
        as for `kernel.replay_block`, with a LinearSystem in place of the plant.
    """
    pair = key[0], key[1]
    inputs, size, onset = kernel.prepared(course, act, limits, pair, numbers)
    T, size, onset = course.samples, size[:, None], onset[:, None]
    if u is not None:
        recorded = np.broadcast_to(np.asarray(u), (len(numbers), *u.shape))
    elif model.m:
        recorded = np.repeat(np.moveaxis(np.asarray(inputs), 2, 0), course.hold, 1)[:, :T]
    else:
        recorded = np.zeros((len(numbers), T, 0), inputs.dtype)
    since = jnp.arange(T, dtype=jnp.int32)[None] - onset
    on = (since >= 0) & (since < act.length)
    own = jax.random.fold_in(jax.random.wrap_key_data(jnp.asarray(key)), numbers[0])
    k_run, k_extra = jax.random.split(own)
    extra = jax.random.uniform(k_extra, since.shape, size.dtype, -1, 1)

    def faulty(values: jax.Array, channel: Array, dropped: float) -> jax.Array:
        """Return signals (N, T, c) with the fault, where it is one of theirs."""
        i = int(channel)
        if i < 0 or act.kind in ("none", "tolerance"):
            return values
        value = values[..., i]
        held = jnp.take_along_axis(value, jnp.minimum(onset, T - 1), 1)
        changed = scenarios.changed(act, value, size, since, extra, held, dropped)
        return values.at[..., i].set(jnp.where(on, changed, value))

    applied = faulty(jnp.asarray(recorded), act.input, 0.0)
    run = simulate(model, applied, k_run, at="vertices" if course.vertices else "uniform")
    y = faulty(run.y, act.output, jnp.nan)
    if act.kind == "tolerance":
        i = int(act.output)
        offset = float(model.offset["y"][i])
        true = (y[..., i] - offset - run.noise[..., i]) / (1 + run.theta[..., i])
        if course.vertices:
            extra = jnp.where(extra < 0, -1, 1)
        theta = size * extra
        y = y.at[..., i].set(jnp.where(on, offset + true + theta * true + run.noise[..., i], y[..., i]))
    return recorded, np.asarray(y), np.asarray(onset)[:, 0]
