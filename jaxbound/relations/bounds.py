"""The bounds of relations at the door: checked, given their shape, rounded so that they are never tighter
than what the user wrote.
"""

from collections.abc import Mapping, Sequence
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.consistency.interface import Array
from jaxbound.consistency.reading import Reading
from jaxbound.models import window
from jaxbound.models.arguments import table_argument
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import Strips

Bounds: TypeAlias = dict[str, Array]
"""{"tolerance": (p,), "noise": (p,), ..}, see `model_bounds`."""

KINDS = {
    "tolerance": "output",
    "noise": "output",
    "disturbance": "disturbance",
    "parameters": "parameter",
    "average": "average",
}


def model_bounds(model: LinearSystem) -> Bounds:
    """Return the bounds of a model as floats: "tolerance", "noise", and what it has of "disturbance" (g, 2),
    "parameters", "average".
    """
    bounds: dict[str, np.ndarray] = {
        "tolerance": rounding.round_up(list(model.tolerance)),
        "noise": rounding.round_up(list(model.noise)),
    }
    if model.g:
        lo, hi = zip(*model.disturbance, strict=True)
        bounds["disturbance"] = np.stack([rounding.round_down(list(lo)), rounding.round_up(list(hi))], 1)
    if model.uncertainties:
        bounds["parameters"] = np.ones(len(model.uncertainties))
    sums = model.averages
    if sums:
        bounds["average"] = rounding.round_up([bounded.bound for bounded in sums])
    # one array for all who ask: nobody may write into it
    for bound in bounds.values():
        bound.setflags(write=False)
    return {**bounds}


def checked_bound(model: LinearSystem, name: str, value: ArrayLike) -> Array:
    """Check one entry of `bounds` and give it its shape: an array of its own, which nobody writes.

    Raises:
        ValueError: a wrong shape, a negative bound, a tolerance >= 1, lo > hi, NaN or infinity.
    """
    kind = KINDS[name]
    names = _names(model, kind)
    paired = kind == "disturbance"  # lo and hi, where others are half-widths
    allowed: list[tuple[int, ...]] = [(), (len(names),)]
    if paired:
        allowed.append((len(names), 2))
    shape = np.shape(value)
    if shape not in allowed:
        raise ValueError(f"{name} needs one number or one per {kind} ({len(names)}): its shape is {shape}")
    if isinstance(value, jax.core.Tracer):
        # jax.grad differentiates in bounds: there is no number to check
        return _traced(cast("jax.Array", value), len(names), paired)  # a Tracer stands for an Array
    given = np.array(value, np.float64)
    if len(shape) == 2:
        _refuse_pairs(name, kind, names, given)
        spread = given
    else:
        spread = np.broadcast_to(given, (len(names),))
        _refuse_sizes(name, kind, names, spread)
        if paired:
            spread = np.stack([-spread, spread], 1)
    spread.setflags(write=False)
    return spread


def _names(model: LinearSystem, kind: str) -> tuple[str, ...]:
    """Return the names of all that a kind of bound speaks of."""
    if kind == "output":
        return model.outputs
    if kind == "disturbance":
        return tuple(f"w{j + 1}" for j in range(model.g))
    if kind == "average":
        return tuple(bounded.text for bounded in model.averages)
    return tuple(u.name for u in model.uncertainties)


def _traced(value: jax.Array, count: int, paired: bool) -> jax.Array:
    """Return a tracer in the shape of a bound: of its numbers nothing is known."""
    if value.ndim == 2:
        return value
    sizes = jnp.broadcast_to(value, (count,))
    if not paired:
        return sizes
    return jnp.stack([-sizes, sizes], 1)


def _refuse_pairs(name: str, kind: str, names: Sequence[str], pairs: np.ndarray) -> None:
    """Raise ValueError unless lo <= hi, both finite."""
    for who, (lo, hi) in zip(names, pairs, strict=True):
        if not -np.inf < lo <= hi < np.inf:
            raise ValueError(f"{name} needs lo <= hi, both finite: {kind} {who!r} has [{lo:g}, {hi:g}]")


def _refuse_sizes(name: str, kind: str, names: Sequence[str], sizes: np.ndarray) -> None:
    """Raise ValueError unless sizes are >= 0 and finite, and tolerances below 1."""
    top = 1 if name == "tolerance" else np.inf
    for who, size in zip(names, sizes, strict=True):
        if not 0 <= size < top:
            raise ValueError(f"{name} must be in [0, {top}): {kind} {who!r} has {size:g}")


def float_bound(bound: Array, dtype: DTypeLike) -> Array:
    """Return a bound in a float dtype, rounded up."""
    if isinstance(bound, jax.core.Tracer):
        return bound.astype(dtype)
    return rounding.round_up(np.asarray(bound, np.float64), dtype)


def changed_bounds(model: LinearSystem, old: Bounds, new: Mapping[str, ArrayLike]) -> Bounds:
    """Return the bounds `old` with the entries of `new` in their place, checked as in `checked_bound`;
    ValueError for an unknown name.
    """
    unknown = sorted(set(table_argument("bounds", new, "{'noise': 0.1}")) - set(old))
    if unknown:
        raise ValueError(f"bounds are {sorted(old)}, not {unknown}")
    return {name: checked_bound(model, name, new.get(name, value)) for name, value in old.items()}


def reading(
    shape: Strips | Frame | None,
    model: LinearSystem,
    horizon: int,
    bounds: Bounds,
    dtype: DTypeLike,
    lags: tuple[int, ...] | None = None,
) -> Reading:
    """Return the Reading of a model under such bounds, rounded so that none is tighter. lags: see
    `parity_relations`.
    """
    lo_hi = bounds.get("disturbance", np.zeros((0, 2)))
    if not isinstance(lo_hi, jax.core.Tracer):
        lo_hi = np.stack([rounding.round_down(lo_hi[:, 0], dtype), rounding.round_up(lo_hi[:, 1], dtype)], 1)
    lags_of_u, acting = window.input_lags(model, horizon), None
    if model.factors:
        lags_of_u, acting = horizon + 1, lags_of_u
    return Reading(
        cast("Strips | Frame", shape),  # None for a PolynomialReading: only windows are read by it
        _taken(float_bound(bounds["tolerance"], dtype)),
        _taken(float_bound(bounds["noise"], dtype)),
        _taken(rounding.round_up(list(model.resolution), dtype)),
        _taken(lo_hi.astype(dtype)),
        _taken(np.array(list(map(float, model.offset["u"])), dtype)),
        _taken(np.array(list(map(float, model.offset["y"])), dtype)),
        window.window_rows(model, horizon, lags),
        lags_of_u,
        _taken(float_bound(bounds.get("average", np.zeros(0)), dtype)),
        tuple(factor.number for factor in model.factors),
        acting,
    )


def _taken(x: Array) -> jax.Array:
    """Return an array as kernels take it, one of NumPy too."""
    return cast("jax.Array", x)  # on the host: compiled kernels are handed arrays of either kind
