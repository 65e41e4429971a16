"""Scenarios written out as recordings and given to `detect`: for whatever the fused kernel has no room for.

Long windows whose combinations are searched for, uncertain parameters, unknown inputs, gains that stay
constant, sensors without noise, and unknowns that an adversary chose. What a study counts is the same.
"""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import AUTO, Relations
from jaxbound.consistency.monitorbank import MonitorBank, combined
from jaxbound.diagnosis.detection import detect
from jaxbound.models.simulate import Acts, recorded_inputs, simulated
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status
from jaxbound.studies.montecarlo import kernel, scenarios


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
    onsets (N,). margins: as of `detect`. Of a monitor all are (N, 1 + tests): of itself, then of each of
    its tests.
    """
    if not relations.parts:
        fault = _faulty(relations, u, y, method, margins)
        return _fault_counts(relations, act, fault, onset)
    columns = []
    for fault in _faulty_by_test(cast(MonitorBank, relations), u, y, margins):
        columns.append(_fault_counts(relations, act, fault, onset))
    hits, false, delay = (np.stack(each, 1) for each in zip(*columns, strict=True))
    return hits, false, delay


def _fault_counts(
    relations: Relations, act: scenarios.Act, fault: np.ndarray, onset: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (hits, false, delay), (N,) each, of windows (N, T) that are FAULT."""
    s, end = relations.horizon, np.arange(fault.shape[1])[None]
    start, length = np.asarray(onset)[:, None], int(act.length)
    touched = (end >= start) & (end - s < start + length)
    if relations.remembers:  # each sample behind the onset rests on faulty ones
        s, touched = 0, end >= start
    hits = (fault & (end - s >= start) & (end < start + length)).sum(1)
    seen = fault & touched
    delay = np.where(seen.any(1), seen.argmax(1) - start[:, 0], -1)
    return hits.astype(np.int32), (fault & ~touched).sum(1).astype(np.int32), delay.astype(np.int32)


def _faulty_by_test(bank: MonitorBank, u: np.ndarray, y: np.ndarray, margins: str) -> list[np.ndarray]:
    """Return which samples (N, T) are FAULT: of a monitor, then of each of its tests."""
    given = Recording.of(bank.model, u, y)
    shape = y.shape[:-1]
    samples = shape[0] * shape[1]
    flat = Recording(
        np.asarray(given.u).reshape(samples, given.u.shape[-1]),
        np.asarray(given.y).reshape(samples, y.shape[-1]),
        np.arange(1, shape[0]) * shape[1],
        given.inputs,
        given.outputs,
    )
    modes, statuses = bank.modes_of(flat.u), []
    for number, watch in enumerate(bank.watches):
        own = bank.seen_by(number, flat, modes)
        if watch.when is None:
            u_own, y_own = own.u.reshape(*shape, own.u.shape[-1]), own.y.reshape(y.shape)
            fault = _faulty(watch.relations, u_own, y_own, "joint", margins).ravel()
        else:  # each scenario has modes of its own, so that they lie end to end
            res = detect(watch.relations, own.u, own.y, margins=margins, starts=own.starts)
            fault = (res.status == Status.FAULT) & ~np.asarray(own.excluded)
        statuses.append(np.where(fault, np.int8(Status.FAULT), np.int8(Status.UNDECIDED)))
    every = np.stack(statuses, -1)
    found = combined(every, np.zeros(every.shape), bank.conditions_of, modes, bank.complete)
    assert found.statuses is not None, "a monitor has tests"
    together = [found.status, *np.moveaxis(found.statuses, -1, 0)]
    return [(status == Status.FAULT).reshape(shape) for status in together]


def _faulty(relations: Relations, u: np.ndarray, y: np.ndarray, method: str, margins: str) -> np.ndarray:
    """Return which windows (N, T) are FAULT."""
    return np.asarray(detect(relations, u, y, method, margins=margins).status == Status.FAULT)


def simulate_block(scene: kernel.Scene, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return recordings u (N, T, m), y (N, T, p) and onsets (N,) simulated by `simulate`; the unknowns depend
    on the block as a whole.

    Args:
        scene: with a LinearSystem in place of the plant.
    """
    inputs, size, onset = map(np.asarray, kernel.prepared(scene, numbers))
    course, act, u, model = scene.course, scene.act, scene.u, scene.plant
    T = course.samples
    if u is not None:
        recorded = np.broadcast_to(np.asarray(u), (len(numbers), *u.shape))
    elif model.m:
        recorded = np.repeat(np.moveaxis(inputs, 2, 0), course.hold, 1)[:, :T]
    else:
        recorded = np.zeros((len(numbers), T, 0), inputs.dtype)
    since = np.arange(T)[None] - onset[:, None]
    on = (since >= 0) & (since < act.length)
    channels = act.channels
    acts = Acts(channels, size[None, :, None][: len(channels)], on[None][: len(channels)])
    own = jax.random.fold_in(jax.random.wrap_key_data(jnp.asarray(scene.key)), numbers[0])
    at = "vertices" if course.vertices else "uniform"
    run = simulated(model, recorded_inputs(model, recorded), jax.random.split(own)[0], acts, at)
    return recorded, np.asarray(run.y), onset
