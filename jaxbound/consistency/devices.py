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

AXIS = "windows"
T = TypeVar("T")


def everywhere(constants: T, devices: Sequence[jax.Device]) -> T:
    """Return a PyTree of arrays placed on each of the devices, as `on_devices` takes it."""
    if len(devices) > 1:
        where: NamedSharding | jax.Device | None = NamedSharding(_mesh(devices), _sharding(0))
    elif default_device() is None:  # not committed to a device: JAX still chooses
        where = None
    else:
        where = devices[0]
    placed: T = jax.device_put(constants, where)
    return placed


def on_devices(
    kernel: Callable[..., T],
    constants: object,
    blocks: Sequence[Arrays],
    devices: Sequence[jax.Device],
    axis: int = 0,
) -> list[T]:
    """Start a kernel on blocks of windows, one a device.

    Args:
        kernel: a jitted function of (constants, *block) that returns arrays with one entry a window.
            constants: from `everywhere`.
        blocks: tuples of arrays of the same shapes, at most one a device. axis: 0 or -1, that of the windows
            in all arrays.

    Returns:
        [the kernel's result] for each block, on its device, as soon as the work is under way.
    """
    if len(devices) == 1:
        return [kernel(constants, *block) for block in blocks]
    mesh, count = _mesh(devices), len(blocks)
    # devices without work repeat the last block: nobody waits for them longer
    filled = [*blocks, *[blocks[-1]] * (len(devices) - count)]
    stacked = [_stacked(parts, mesh, axis) for parts in zip(*filled, strict=True)]
    together = _on_mesh
    if getattr(kernel, "wide", False):
        together = _wide_on_mesh
    out, tree = jax.tree.flatten(together(kernel, mesh, axis, constants, *stacked))
    of_device = []
    for x in out:
        # each result stays on its device: it is fetched when somebody reads it
        of_device.append({shard.device: shard.data for shard in x.addressable_shards})
    results = []
    for device in devices[:count]:
        results.append(jax.tree.unflatten(tree, [parts[device] for parts in of_device]))
    return results


def _all(kernel: Callable[..., T], mesh: Mesh, axis: int, constants: object, *stacked: jax.Array) -> T:
    """Run a kernel on blocks that are stacked along an axis, a block on each device."""

    def spec(x: jax.Array | jax.ShapeDtypeStruct) -> PartitionSpec:
        return _sharding(x.ndim, axis)

    blocks = []
    for x in stacked:
        shape = list(x.shape)
        shape[axis] //= mesh.size
        blocks.append(jax.ShapeDtypeStruct(shape, x.dtype))  # type: ignore[no-untyped-call]  # of JAX
    result = jax.eval_shape(kernel, constants, *blocks)
    alone = jax.shard_map(
        kernel,
        mesh=mesh,
        in_specs=(_sharding(0), *map(spec, stacked)),
        out_specs=jax.tree.map(spec, result),
        check_vma=False,
    )
    together: T = alone(constants, *stacked)
    return together


_on_mesh = jax.jit(_all, static_argnums=(0, 1, 2))
_wide_on_mesh = jax.jit(_all, static_argnums=(0, 1, 2), compiler_options=WIDE)


def _stacked(parts: Sequence[Array], mesh: Mesh, axis: int) -> jax.Array:
    """Return the array whose parts along an axis lie on one device each; only that part is sent to it."""
    devices = list(mesh.devices.flat)
    shape = list(parts[0].shape)
    shape[axis] *= len(devices)
    placed = jax.device_put(list(parts), devices)
    return jax.make_array_from_single_device_arrays(
        tuple(shape), NamedSharding(mesh, _sharding(len(shape), axis)), placed
    )


def _sharding(ndim: int, axis: int = 0) -> PartitionSpec:
    """Return the sharding of arrays of so many dimensions along an axis; 0: whole on each device."""
    names: list[str | None] = [None] * ndim
    if ndim:
        names[axis] = AXIS
    return PartitionSpec(*names)  # type: ignore[no-untyped-call]  # JAX has no types for it


def _mesh(devices: Sequence[jax.Device]) -> Mesh:
    return Mesh(np.array(devices), (AXIS,))
