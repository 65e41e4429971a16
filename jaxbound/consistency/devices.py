"""Blocks of windows on every device of this process.

A block is what the kernel takes on one device. On D devices one program runs D blocks at once, each device
the very kernel of one device on a block of its own: no number depends on D, nothing passes between devices,
and one compilation serves all of them.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxbound.consistency.interface import Array, Arrays
from jaxbound.sets.floats.kernel import WIDE
from jaxbound.sets.floats.probe import default_device

__all__ = ["everywhere", "on_devices"]

AXIS = "devices"
EACH = PartitionSpec(AXIS)  # type: ignore[no-untyped-call]  # JAX has no types for it
EVERY = PartitionSpec()  # type: ignore[no-untyped-call]
T = TypeVar("T")


def everywhere(constants: T, devices: Sequence[jax.Device]) -> T:
    """Return a PyTree of arrays placed on each of the devices, as `on_devices` takes it."""
    if len(devices) > 1:
        where: NamedSharding | jax.Device | None = NamedSharding(_mesh(devices), EVERY)
    elif default_device() is None:  # not committed to a device: JAX still chooses
        where = None
    else:
        where = devices[0]
    placed: T = jax.device_put(constants, where)
    return placed


def on_devices(
    kernel: Callable[..., T], constants: object, blocks: Sequence[Arrays], devices: Sequence[jax.Device]
) -> list[T]:
    """Start a kernel on blocks of windows, one a device.

    Args:
        kernel: a jitted function of (constants, *block) that returns arrays. constants: from `everywhere`.
        blocks: tuples of arrays of the same shapes, at most one a device.

    Returns:
        [the kernel's result] for each block, on its device, as soon as the work is under way.
    """
    if len(devices) == 1:
        return [kernel(constants, *block) for block in blocks]
    mesh, count = _mesh(devices), len(blocks)
    # devices without work repeat the last block: nobody waits for them longer
    filled = [*blocks, *[blocks[-1]] * (len(devices) - count)]
    stacked = [_stacked(parts, mesh) for parts in zip(*filled, strict=True)]
    together = _on_mesh
    if getattr(kernel, "wide", False):
        together = _wide_on_mesh
    out, tree = jax.tree.flatten(together(kernel, mesh, constants, *stacked))
    of_device = []
    for x in out:
        of_device.append({shard.device: shard.data[0] for shard in x.addressable_shards})
    results = []
    for device in devices[:count]:
        results.append(jax.tree.unflatten(tree, [parts[device] for parts in of_device]))
    return results


def _all(kernel: Callable[..., T], mesh: Mesh, constants: object, *stacked: jax.Array) -> T:
    """Run a kernel on blocks (devices, ...), each on its device; return the results (devices, ...)."""

    def alone(constants: object, *blocks: jax.Array) -> T:
        result = kernel(constants, *(x[0] for x in blocks))
        own: T = jax.tree.map(lambda x: x[None], result)
        return own

    specs = (EVERY, *[EACH] * len(stacked))
    together: T = jax.shard_map(alone, mesh=mesh, in_specs=specs, out_specs=EACH, check_vma=False)(
        constants, *stacked
    )
    return together


_on_mesh = jax.jit(_all, static_argnums=(0, 1))
_wide_on_mesh = jax.jit(_all, static_argnums=(0, 1), compiler_options=WIDE)


def _stacked(parts: Sequence[Array], mesh: Mesh) -> jax.Array:
    """Return the array (devices, ...) whose parts lie on one device each; only that part is sent to it."""
    devices = list(mesh.devices.flat)
    placed = jax.device_put([part[None] for part in parts], devices)
    shape = len(devices), *parts[0].shape
    return jax.make_array_from_single_device_arrays(shape, NamedSharding(mesh, EACH), placed)


def _mesh(devices: Sequence[jax.Device]) -> Mesh:
    return Mesh(np.array(devices), (AXIS,))
