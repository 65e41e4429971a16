"""Scenarios simulated and tested in one kernel: nothing but counts leaves the processor's cache.

A block of scenarios steps through time together. At each step the kernel draws the unknowns, moves the plant
(`recursion.step`), applies the fault, and gives the newest window to the test that `detect` uses
(`folded_verdict`, with its proof). The window of step k is tested at step k + 1: its samples are then the
loop's carry, numbers in memory that all their uses share, not expressions that a compiler may round
differently for each.

The limit, for two outputs and windows of two samples: two calls of Threefry, some 150 operations on integers,
and some 170 on floats for a sample and its window; with vectors of 256 bits and two units about 30 cycles, 80
million windows a second and core at 2.5 GHz.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.folded import folded_verdict
from jaxbound.consistency.reading import Reading
from jaxbound.random.threefry import Array
from jaxbound.studies.montecarlo import draws, recursion, scenarios
from jaxbound.studies.montecarlo.recursion import FloatPlant
from jaxbound.studies.montecarlo.scenarios import Act

__all__ = [
    "BLOCK",
    "Course",
    "count_block",
    "move",
    "prepared",
    "recorded_input",
    "replay_block",
    "unknown_draws",
]

Unknowns = tuple[list[Array], list[Array], list[Array], Array | None]
"""theta, delta and the disturbances' shares, a list over signals of (N,), and what a noise fault draws."""

BLOCK = 4096
"""Scenarios in a block: what a step works on stays in a core's cache, and a step takes much longer than to
start it.
"""


@dataclass(frozen=True)
class Course:
    """The static numbers of a study's scenarios: samples of each, steps that a level of the inputs holds,
    unknowns at vertices or not.
    """

    samples: int
    hold: int
    vertices: bool


def unknown_draws(
    course: Course, act: Act, plant: FloatPlant, key: tuple[Array, Array], numbers: Array, k: Array
) -> Unknowns:
    """Return (theta, delta, share, extra) of step k: relative errors (None where there is no tolerance),
    noises, disturbances, fault.
    """
    p, g = plant.shape[2:]
    count = 2 * p + g + (act.kind == "noise")
    bits = draws.words(
        key, numbers, draws.STEPS + jnp.asarray(k, jnp.uint32) * np.uint32(-(-count // 2)), count
    )
    each = [draws.share(b, plant.noise.dtype, course.vertices) for b in bits[: 2 * p + g]]
    extra = None
    if act.kind == "noise":
        extra = draws.share(bits[-1], plant.noise.dtype)
    # the two of an output share their rounds
    return each[: 2 * p : 2], each[1 : 2 * p : 2], each[2 * p :], extra


def levels(course: Course, limits: Array, key: tuple[Array, Array], numbers: Array) -> jax.Array:
    """Return the inputs of each hold, an array (holds, m, N), uniform within limits (m, 2)."""
    calls = -(-len(limits) // 2)
    hold = (
        jnp.arange(-(-course.samples // course.hold) + 1, dtype=jnp.uint32)[:, None]
        + jnp.zeros_like(numbers)[None]
    )
    bits = draws.words(
        key, jnp.broadcast_to(numbers[None], hold.shape), draws.INPUTS + hold * np.uint32(calls), len(limits)
    )
    if not bits:
        return jnp.zeros((len(hold), 0, len(numbers)), limits.dtype)
    out = []
    for word, (lo, hi) in zip(bits, limits, strict=True):
        level = draws.share(word, limits.dtype)
        out.append(jnp.clip(lo + 0.5 * (1 + level) * (hi - lo), lo, hi))
    return jnp.stack(out, 1)


def prepared(
    course: Course, act: Act, limits: Array, key: tuple[Array, Array], numbers: Array
) -> tuple[Array, Array, Array]:
    """Return (inputs of each hold, sizes, onsets) of scenarios."""
    (bits,) = draws.words(key, numbers, draws.ONSETS, 1)
    size = act.sizes[numbers % np.uint32(act.sizes.shape[0])]
    return levels(course, limits, key, numbers), size, (act.first + bits % act.span).astype(jnp.int32)


def move(
    act: Act,
    plant: FloatPlant,
    unknowns: Unknowns,
    size: Array,
    onset: Array,
    u: list[Array],
    k: Array,
    x: list[Array],
    held: Array,
) -> tuple[list[Array], list[Array], Array]:
    """Return (x+, y, held) of step k for N scenarios, with the fault: lists over states and outputs.
    unknowns: from `unknown_draws`.
    """
    theta, delta, share, extra = unknowns
    since, stuck = k - onset, held
    on = (since >= 0) & (since < act.length)
    p = plant.shape[2]

    def faulty(values: list[Array], errors: Sequence[Array], channel: Array, dropped: float) -> list[Array]:
        """Return signals with the fault, where it is one of theirs; keep the value that one sticks to.
        errors: what a gain does not multiply.
        """
        nonlocal stuck
        if act.kind in ("none", "tolerance"):
            return values
        out: list[Array] = []
        for i, (value, error) in enumerate(zip(values, errors, strict=True)):
            mine = on & (channel == i)
            if act.kind == "stuck":
                stuck = jnp.where(mine & (since == 0), value, stuck)
            changed = scenarios.changed(act, value, error, size, since, extra, stuck, dropped)
            out.append(jnp.where(mine, changed, value))
        return out

    tolerances = [plant.tolerance[i] for i in range(p)]
    if act.kind == "tolerance":
        tolerances = [jnp.where(on & (act.output == i), size, t) for i, t in enumerate(tolerances)]
    applied = faulty(u, [jnp.zeros_like(v) for v in u], act.input, 0.0)
    theta = [b * r for b, r in zip(tolerances, theta, strict=True)]
    noise = [b * r for b, r in zip(plant.noise, delta, strict=True)]
    x, y = recursion.step(plant, x, applied, theta, noise, share)
    shown = faulty(y, noise, act.output, jnp.nan)
    return x, shown, stuck


def recorded_input(u: Array | None, inputs: Array, k: Array, course: Course) -> list[Array]:
    """Return the m recorded inputs of step k, each (N,): given ones (T, m), or those of the hold."""
    if u is not None:
        now = u[jnp.minimum(k, course.samples - 1)]
        return [jnp.broadcast_to(now[i], inputs.shape[-1:]) for i in range(u.shape[1])]
    return list(inputs[k // course.hold])


@partial(jax.jit, static_argnums=0)
def count_block(
    course: Course,
    reading: Reading,
    plant: FloatPlant,
    act: Act,
    limits: Array,
    u: Array | None,
    key: Array,
    numbers: Array,
) -> tuple[Array, Array, Array, Array]:
    """Simulate and test N scenarios.

    Args:
        course: a Course. reading: a Reading with Strips. plant, act: see `recursion`, `scenarios`.
        limits: (m, 2) of the inputs.
        u: None, or (T, m) inputs for all. key: (2,) uint32. numbers: (N,) uint32, of the scenarios.

    Returns:
        hits: FAULT windows wholly inside the fault; false: FAULT windows without a faulty sample; delay:
            samples from the onset to the
        end of the first FAULT window that the fault touches, -1 if there is none; onset. All (N,) int32.
    """
    s, (n, m, p, _) = reading.horizon, plant.shape
    pair = key[0], key[1]
    inputs, size, onset = prepared(course, act, limits, pair, numbers)
    zero = jnp.zeros_like(size)
    none = jnp.zeros_like(onset)

    def now(carry: Any, k: jax.Array) -> tuple[Any, None]:
        x, ys, us, held, margin, hits, false, delay = carry
        end = k - 2  # of the window that this margin belongs to
        fault, stop = (margin < 0) & (end >= s), onset + act.length
        touched = (end >= onset) & (end - s < stop)
        hits = hits + (fault & (end - s >= onset) & (end < stop))
        false = false + (fault & ~touched)
        delay = jnp.where(fault & touched & (delay < 0), end - onset, delay)
        margin = folded_verdict(reading, us[: reading.lags], ys)
        u_now = recorded_input(u, inputs, k, course)
        unknowns = unknown_draws(course, act, plant, pair, numbers, k)
        x, y, held = move(act, plant, unknowns, size, onset, u_now, k, x, held)
        return (x, [*ys[1:], y], [*us[1:], u_now], held, margin, hits, false, delay), None

    start = [zero] * n, [[zero] * p] * (s + 1), [[zero] * m] * (s + 1), zero, zero, none, none, none - 1
    carry, _ = jax.lax.scan(now, start, jnp.arange(course.samples + 2, dtype=jnp.int32))
    return *carry[-3:], onset


@partial(jax.jit, static_argnums=0)
def replay_block(
    course: Course, plant: FloatPlant, act: Act, limits: Array, u: Array | None, key: Array, numbers: Array
) -> tuple[Array, Array, Array]:
    """Return the recordings that `count_block` tests: u (N, T, m), y (N, T, p), onset (N,)."""
    pair = key[0], key[1]
    inputs, size, onset = prepared(course, act, limits, pair, numbers)
    zero = jnp.zeros_like(size)

    def now(
        carry: tuple[list[Array], Array], k: jax.Array
    ) -> tuple[tuple[list[Array], Array], tuple[jax.Array, jax.Array]]:
        x, held = carry
        u_now = recorded_input(u, inputs, k, course)
        unknowns = unknown_draws(course, act, plant, pair, numbers, k)
        x, y, held = move(act, plant, unknowns, size, onset, u_now, k, x, held)
        return (x, held), (jnp.stack([*u_now, zero])[:-1], jnp.stack(y))

    start: tuple[list[Array], Array] = [zero] * plant.shape[0], zero
    _, (us, ys) = jax.lax.scan(now, start, jnp.arange(course.samples, dtype=jnp.int32))
    return jnp.moveaxis(us, 2, 0), jnp.moveaxis(ys, 2, 0), onset
