"""The primitives of JAX that move numbers, in NumPy: shapes, parts of arrays, gathers, scatters and sorts."""

import math
import operator
from collections.abc import Callable
from functools import partial

import numpy as np

from jaxbound.sets.floats.numpy_primitives import Entries, Function, entering, identity

SMALL = 2**12
"""Numbers up to which an array may be copied, or kept longer than it is needed."""

MOVED: Entries = {}
_entry = partial(entering, MOVED)


@_entry("iota")
def _iota(params):
    shape, dimension = params["shape"], params["dimension"]
    along = np.arange(shape[dimension], dtype=params["dtype"])
    along = along.reshape([-1 if i == dimension else 1 for i in range(len(shape))])
    return lambda: np.broadcast_to(along, shape)


@_entry("platform_index")
def _platform_branch(params):
    """Return the branch of a CPU, or the one for all that is not named."""
    index = next(i for i, names in enumerate(params["platforms"]) if names is None or "cpu" in names)
    return lambda: np.asarray(index, np.int32)


@_entry("broadcast_in_dim")
def _broadcast(params):
    shape, dimensions = params["shape"], params["broadcast_dimensions"]
    if not shape:
        return identity
    lined_up = tuple(slice(None) if i in dimensions else None for i in range(len(shape)))
    small = math.prod(shape) <= SMALL

    def broadcast(x):
        if x.shape == shape:
            return x
        if not small:
            return np.broadcast_to(x[lined_up], shape)
        out = np.empty(shape, x.dtype)  # NumPy takes longer to say that it needs no copy
        out[...] = x[lined_up]
        return out

    return broadcast


def _method_with(name: str, parameter: str) -> Callable[[dict], Function]:
    """Return an entry for a method of arrays that takes one parameter."""
    return lambda params: operator.methodcaller(name, params[parameter])


MOVED["reshape"] = _method_with("reshape", "new_sizes")
MOVED["squeeze"] = _method_with("squeeze", "dimensions")
MOVED["transpose"] = _method_with("transpose", "permutation")
MOVED["rev"] = lambda params: lambda x: np.flip(x, params["dimensions"])
MOVED["tile"] = lambda params: lambda x: np.tile(x, params["reps"])
MOVED["concatenate"] = lambda params: lambda *parts: np.concatenate(parts, params["dimension"])
MOVED["stack"] = lambda params: lambda *parts: np.stack(parts, params["axis"])
MOVED["unstack"] = lambda params: lambda x: list(np.moveaxis(x, params["axis"], 0))


@_entry("split")
def _split(params):
    ends = np.cumsum(params["sizes"])[:-1]
    return lambda x: np.split(x, ends, params["axis"])


@_entry("pad")
def _padded(params):
    def padded(x, value):
        shape, source, place = [], [], []
        for n, (low, high, between) in zip(x.shape, params["padding_config"], strict=True):
            shape.append(low + high + n + max(n - 1, 0) * between)
            at = low + (between + 1) * np.arange(n)
            kept = (at >= 0) & (at < shape[-1])
            source.append(np.flatnonzero(kept))
            place.append(at[kept])
        out = np.full(shape, value, x.dtype)
        out[np.ix_(*place)] = x[np.ix_(*source)]
        return out

    return padded


@_entry("slice")
def _sliced(params):
    first, stop = params["start_indices"], params["limit_indices"]
    steps = params["strides"] or (1,) * len(first)
    where = tuple(map(slice, first, stop, steps))
    return lambda x: x[where]


def _corner(starts, shape, sizes):
    """Return the slices of a part of an array, moved inside where it begins outside."""
    corner = []
    for at, n, size in zip(starts, shape, sizes, strict=True):
        at = 0 if n == size else min(max(int(at), 0), n - size)
        corner.append(slice(at, at + size))
    return tuple(corner)


@_entry("dynamic_slice")
def _dynamic_slice(params):
    sizes = params["slice_sizes"]
    return lambda x, *starts: x[_corner(starts, x.shape, sizes)]


@_entry("dynamic_update_slice")
def _dynamic_update_slice(params):
    def updated(x, part, *starts):
        out = np.array(x)
        out[_corner(starts, x.shape, part.shape)] = part
        return out

    return updated


@_entry("sort")
def _sorted(params):
    axis, keys = params["dimension"], params["num_keys"]

    def sort(*arrays):
        if len(arrays) == 1:
            return (np.sort(arrays[0], axis, kind="stable"),)
        order = np.argsort(arrays[keys - 1], axis, kind="stable")
        for key in reversed(arrays[: keys - 1]):
            again = np.argsort(np.take_along_axis(key, order, axis), axis, kind="stable")
            order = np.take_along_axis(order, again, axis)
        return tuple(np.take_along_axis(x, order, axis) for x in arrays)

    return sort


@_entry("gather")
def _gather(params):
    numbers, sizes, mode = params["dimension_numbers"], params["slice_sizes"], str(params["mode"])

    def gathered(x, indices):
        at, outside = _places(
            x.shape,
            indices,
            numbers.start_index_map,
            numbers.operand_batching_dims,
            numbers.start_indices_batching_dims,
            numbers.collapsed_slice_dims,
            sizes,
        )
        found = x[at]
        lead = indices.ndim - 1
        if "FILL" in mode and outside.any():
            fill = params["fill_value"]
            if fill is None:
                fill = np.nan if x.dtype.kind == "f" else 0
            gone = outside.reshape((*outside.shape, *(1,) * (found.ndim - lead)))
            found = np.where(gone, np.asarray(fill, x.dtype), found)
        batch = iter(range(lead))
        rest = iter(range(lead, found.ndim))
        return found.transpose(
            [next(rest) if i in numbers.offset_dims else next(batch) for i in range(found.ndim)]
        )

    return gathered


def _places(shape, indices, index_map, operand_batch, index_batch, left_out, sizes):
    """Return (index arrays of the parts of an array that start at `indices`, which of these starts lie
    outside).
    """
    lead = indices.shape[:-1]
    window_axes = [i for i in range(len(shape)) if i not in (*left_out, *operand_batch)]
    outside = np.zeros(lead, bool)
    at = []
    for axis, (n, size) in enumerate(zip(shape, sizes, strict=True)):
        if axis in operand_batch:
            along = index_batch[operand_batch.index(axis)]
            start = np.arange(n).reshape([-1 if i == along else 1 for i in range(len(lead))])
        elif axis in index_map:
            start = indices[..., index_map.index(axis)].astype(np.int64)
            outside |= (start < 0) | (start > n - size)
            start = np.clip(start, 0, n - size)
        else:
            start = np.zeros((1,) * len(lead), np.int64)
        start = start.reshape((*start.shape, *(1,) * len(window_axes)))
        if axis in window_axes:
            start = start + np.arange(size).reshape([-1 if i == axis else 1 for i in window_axes])
        at.append(start)
    return tuple(at), outside


def _scattered(combine: Function) -> Callable[[dict], Function]:
    def make(params):
        numbers, mode = params["dimension_numbers"], str(params["mode"])

        def scattered(x, indices, updates):
            out, lead = np.array(x), indices.ndim - 1
            windows = [i for i in range(updates.ndim) if i in numbers.update_window_dims]
            batch = [i for i in range(updates.ndim) if i not in windows]
            updates = updates.transpose(*batch, *windows)
            lengths = iter(updates.shape[lead:])
            gone = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
            sizes = [1 if i in gone else next(lengths) for i in range(x.ndim)]
            at, outside = _places(
                x.shape,
                indices,
                numbers.scatter_dims_to_operand_dims,
                numbers.operand_batching_dims,
                numbers.scatter_indices_batching_dims,
                numbers.inserted_window_dims,
                sizes,
            )
            if "CLIP" not in mode and outside.any():
                inside = ~outside
                at = tuple(np.broadcast_to(i, updates.shape)[inside] for i in at)
                updates = updates[inside]
            combine(out, at, updates)
            return out

        return scattered

    return make


def _assign(out, at, updates):
    out[at] = updates


MOVED["scatter"] = _scattered(_assign)
MOVED["scatter-add"] = MOVED["scatter_add"] = _scattered(np.add.at)
MOVED["scatter-mul"] = MOVED["scatter_mul"] = _scattered(np.multiply.at)
MOVED["scatter-min"] = MOVED["scatter_min"] = _scattered(np.minimum.at)
MOVED["scatter-max"] = MOVED["scatter_max"] = _scattered(np.maximum.at)
