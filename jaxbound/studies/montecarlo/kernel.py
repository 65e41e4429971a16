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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.folded import folded_verdict
from jaxbound.consistency.reading import Reading
from jaxbound.random.threefry import Array
from jaxbound.studies.montecarlo import draws, recursion
from jaxbound.studies.montecarlo.scenarios import Act

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Scene:
    """The numbers that all scenarios of one fault share.

    Fields: plant, act: see `recursion`, `scenarios`. limits: (m, 2) of the inputs. u: None, or (T, m) inputs
    for all. key: (2,) uint32. course: static.
    """

    plant: Any
    act: Act
    limits: Array
    u: Array | None
    key: Array
    course: Course = field(metadata={"static": True})

    @property
    def words(self) -> tuple[Array, Array]:
        """The key as Threefry takes it."""
        return self.key[0], self.key[1]


class Begun(NamedTuple):
    """Scenarios as they begin: inputs (holds, m, N) of each hold; size, onset (N,) of the fault."""

    inputs: Array
    size: Array
    onset: Array


def unknown_draws(scene: Scene, numbers: Array, k: Array) -> Unknowns:
    """Return (theta, delta, share, extra) of step k: relative errors, noises, disturbances, fault."""
    act, plant, course = scene.act, scene.plant, scene.course
    p, g = plant.shape[2:]
    count = 2 * p + g + (act.kind == "noise")
    bits = draws.words(
        scene.words, numbers, draws.STEPS + jnp.asarray(k, jnp.uint32) * np.uint32(-(-count // 2)), count
    )
    each = [draws.numbers_from_bits(b, plant.noise.dtype, course.vertices) for b in bits[: 2 * p + g]]
    extra = None
    if act.kind == "noise":
        extra = draws.numbers_from_bits(bits[-1], plant.noise.dtype)
    # the two of an output share their rounds
    return each[: 2 * p : 2], each[1 : 2 * p : 2], each[2 * p :], extra


def levels(scene: Scene, numbers: Array) -> jax.Array:
    """Return the inputs of each hold, an array (holds, m, N), uniform within the limits."""
    course, limits = scene.course, scene.limits
    calls = -(-len(limits) // 2)
    hold = (
        jnp.arange(-(-course.samples // course.hold) + 1, dtype=jnp.uint32)[:, None]
        + jnp.zeros_like(numbers)[None]
    )
    bits = draws.words(
        scene.words,
        jnp.broadcast_to(numbers[None], hold.shape),
        draws.INPUTS + hold * np.uint32(calls),
        len(limits),
    )
    if not bits:
        return jnp.zeros((len(hold), 0, len(numbers)), limits.dtype)
    out = []
    for word, (lo, hi) in zip(bits, limits, strict=True):
        level = draws.numbers_from_bits(word, limits.dtype)
        out.append(jnp.clip(lo + 0.5 * (1 + level) * (hi - lo), lo, hi))
    return jnp.stack(out, 1)


def prepared(scene: Scene, numbers: Array) -> Begun:
    """Return the inputs, sizes and onsets of scenarios."""
    act = scene.act
    (bits,) = draws.words(scene.words, numbers, draws.ONSETS, 1)
    size = act.sizes[numbers % np.uint32(act.sizes.shape[0])]
    return Begun(levels(scene, numbers), size, (act.first + bits % act.span).astype(jnp.int32))


def move(
    scene: Scene, begun: Begun, unknowns: Unknowns, k: Array, x: list[Array], held: Array
) -> tuple[list[Array], list[Array], list[Array], Array]:
    """Return (u, x+, y, held) of step k for N scenarios, with the fault: lists over inputs, states and
    outputs. unknowns: from `unknown_draws`.
    """
    act, plant, u = scene.act, scene.plant, recorded_input(scene, begun.inputs, k)
    size, onset = begun.size, begun.onset
    theta, delta, share, extra = unknowns
    since, stuck = k - onset, held
    on = (since >= 0) & (since < act.length)
    p = plant.shape[2]

    def faulty(values: list[Array], errors: Sequence[Array], channel: Array, dropped: float) -> list[Array]:
        """Return signals with the fault, where it is one of theirs; keep the value that one sticks to.
        errors: what a gain does not multiply. dropped: what is left of a missing sample.
        """
        nonlocal stuck
        if act.kind in ("none", "tolerance"):
            return values
        out: list[Array] = []
        for i, (value, error) in enumerate(zip(values, errors, strict=True)):
            mine = on & (channel == i)
            if act.kind == "noise":
                assert extra is not None, "a noise fault draws"
                changed = value + size * extra
            elif act.kind == "shift":
                grown = act.bias + act.drift * since.astype(value.dtype) + act.gain * (value - error)
                changed = value + size * grown
            elif act.kind == "stuck":
                changed = stuck = jnp.where(mine & (since == 0), value, stuck)
            else:
                changed = jnp.full_like(value, dropped)
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
    return u, x, shown, stuck


def recorded_input(scene: Scene, inputs: Array, k: Array) -> list[Array]:
    """Return the m recorded inputs of step k, each (N,): given ones (T, m), or those of the hold."""
    u = scene.u
    if u is not None:
        now = u[jnp.minimum(k, scene.course.samples - 1)]
        return [jnp.broadcast_to(now[i], inputs.shape[-1:]) for i in range(u.shape[1])]
    return list(inputs[k // scene.course.hold])


@jax.jit
def count_block(constants: tuple[Reading, Scene], numbers: Array) -> tuple[Array, Array, Array, Array]:
    """Simulate and test N scenarios.

    Args:
        constants: a Reading with Strips, and the Scene. numbers: (N,) uint32, theirs.

    Returns:
        hits: FAULT windows wholly inside the fault; false: FAULT windows without a faulty sample; delay:
            samples from the onset to the
        end of the first FAULT window that the fault touches, -1 if there is none; onset. All (N,) int32.
    """
    reading, scene = constants
    s, (n, m, p, _) = reading.horizon, scene.plant.shape
    begun = prepared(scene, numbers)
    onset = begun.onset
    zero = jnp.zeros_like(begun.size)
    none = jnp.zeros_like(onset)

    def now(carry: Any, k: jax.Array) -> tuple[Any, None]:
        x, ys, us, held, margin, hits, false, delay = carry
        end = k - 2  # of the window that this margin belongs to
        fault, stop = (margin < 0) & (end >= s), onset + scene.act.length
        touched = (end >= onset) & (end - s < stop)
        hits = hits + (fault & (end - s >= onset) & (end < stop))
        false = false + (fault & ~touched)
        delay = jnp.where(fault & touched & (delay < 0), end - onset, delay)
        margin = folded_verdict(reading, us[: reading.lags], ys)
        unknowns = unknown_draws(scene, numbers, k)
        u_now, x, y, held = move(scene, begun, unknowns, k, x, held)
        return (x, [*ys[1:], y], [*us[1:], u_now], held, margin, hits, false, delay), None

    start = [zero] * n, [[zero] * p] * (s + 1), [[zero] * m] * (s + 1), zero, zero, none, none, none - 1
    carry, _ = jax.lax.scan(now, start, jnp.arange(scene.course.samples + 2, dtype=jnp.int32))
    return *carry[-3:], onset


def drawn(scene: Scene, numbers: Array) -> tuple[jax.Array, Array]:
    """Return the unknowns (T, 2p + g, N) of scenarios, and the extra draws of a noise fault (T, N)."""

    def now(_: None, k: jax.Array) -> tuple[None, tuple[jax.Array, Array]]:
        theta, delta, share, extra = unknown_draws(scene, numbers, k)
        if extra is None:
            extra = jnp.zeros_like(delta[0])
        return None, (jnp.stack([*theta, *delta, *share]), extra)

    unknowns: tuple[jax.Array, Array]
    unknowns = jax.lax.scan(now, None, jnp.arange(scene.course.samples, dtype=jnp.int32))[1]
    return unknowns


def recorded_scene(
    scene: Scene, begun: Begun, unknowns: Callable[[jax.Array], Unknowns]
) -> tuple[jax.Array, jax.Array]:
    """Return (u (T, m, N), y (T, p, N)) recorded with the unknowns of each step k."""
    zero = jnp.zeros_like(begun.size)

    def now(
        carry: tuple[list[Array], Array], k: jax.Array
    ) -> tuple[tuple[list[Array], Array], tuple[jax.Array, jax.Array]]:
        x, held = carry
        u, x, y, held = move(scene, begun, unknowns(k), k, x, held)
        return (x, held), (jnp.stack([*u, zero])[:-1], jnp.stack(y))

    start: tuple[list[Array], Array] = [zero] * scene.plant.shape[0], zero
    steps = jnp.arange(scene.course.samples, dtype=jnp.int32)
    signals: tuple[jax.Array, jax.Array] = jax.lax.scan(now, start, steps)[1]
    return signals


@jax.jit
def replay_block(scene: Scene, numbers: Array) -> tuple[Array, Array, Array]:
    """Return the recordings that `count_block` tests: u (N, T, m), y (N, T, p), onset (N,)."""
    begun = prepared(scene, numbers)
    us, ys = recorded_scene(scene, begun, partial(unknown_draws, scene, numbers))
    return jnp.moveaxis(us, 2, 0), jnp.moveaxis(ys, 2, 0), begun.onset
