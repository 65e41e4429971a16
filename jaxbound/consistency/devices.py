"""Blocks of windows on every device of this process.

A block is what the kernel takes on one device. On D devices one program runs D blocks at once, each device
the very kernel of one device on a block of its own: no number depends on D, nothing passes between devices,
and one compilation serves all of them.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxbound.sets.floats.probe import default_device

__all__ = ["everywhere", "on_devices"]

AXIS = "windows"


def everywhere(constants: Any, devices: Sequence[jax.Device]) -> Any:
    """Return a PyTree of arrays placed on each of the devices, as `on_devices` takes it."""
    if len(devices) == 1:
        return jax.device_put(constants, None if default_device() is None else devices[0])
    return jax.device_put(constants, NamedSharding(_mesh(devices), PartitionSpec()))


def on_devices(
    kernel: Callable, constants: Any, blocks: list[tuple], devices: Sequence[jax.Device], axis: int = 0
) -> list:
    """Start a kernel on blocks of windows, one a device.

    Args:
        kernel: a jitted function of (constants, *block) that returns arrays with one entry a window.
            constants: from `everywhere`.
        blocks: tuples of arrays of the same shapes, at most one a device. axis: 0 or -1, that of the windows
            in all arrays.

    Returns:
        [what the kernel returns] for each block, on its device, as soon as the work is under way.
    """
    if len(devices) == 1:
        return [kernel(constants, *block) for block in blocks]
    mesh, count = _mesh(devices), len(blocks)
    blocks = [
        *blocks,
        *blocks[-1:] * (len(devices) - count),
    ]  # devices without work repeat the last block: nobody waits for them longer
    stacked = [_stacked(parts, mesh, axis) for parts in zip(*blocks, strict=True)]
    out, tree = jax.tree.flatten(_on_mesh(kernel, mesh, axis, constants, *stacked))
    parts = [{shard.device: shard.data for shard in x.addressable_shards} for x in out]
    return [jax.tree.unflatten(tree, [part[device] for part in parts]) for device in devices[:count]]


@partial(jax.jit, static_argnums=(0, 1, 2))
def _on_mesh(kernel, mesh, axis, constants, *stacked):
    share = lambda x: jax.ShapeDtypeStruct(
        [n // (mesh.size if i == axis % x.ndim else 1) for i, n in enumerate(x.shape)], x.dtype
    )
    spec = lambda x: _spec(x.ndim, axis)
    result = jax.eval_shape(kernel, constants, *map(share, stacked))
    alone = jax.shard_map(
        kernel,
        mesh=mesh,
        in_specs=(PartitionSpec(), *map(spec, stacked)),
        out_specs=jax.tree.map(spec, result),
        check_vma=False,
    )
    return alone(constants, *stacked)


def _stacked(parts, mesh, axis):
    """Return the array whose parts along an axis lie on one device each; only that part is sent to it."""
    devices = list(mesh.devices.flat)
    shape = list(parts[0].shape)
    shape[axis] *= len(devices)
    placed = jax.device_put(list(parts), devices)
    return jax.make_array_from_single_device_arrays(
        tuple(shape), NamedSharding(mesh, _spec(len(shape), axis)), placed
    )


def _spec(ndim, axis):
    return PartitionSpec(*(AXIS if i == axis % ndim else None for i in range(ndim)))


def _mesh(devices):
    return Mesh(np.array(devices), (AXIS,))
