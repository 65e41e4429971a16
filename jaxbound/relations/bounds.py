"""The bounds of relations at the door: checked, given their shape, rounded so that they are never tighter
than what the user wrote.
"""

from collections.abc import Mapping
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.consistency.reading import Reading
from jaxbound.models import window
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import Strips

__all__ = ["Bounds", "changed_bounds", "checked_bound", "float_bound", "model_bounds", "reading"]

Bounds: TypeAlias = dict[str, np.ndarray | jax.Array]
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
    sums = window.bounded_sums(model)
    if sums:
        bounds["average"] = rounding.round_up([bounded.bound for bounded in sums])
    for bound in bounds.values():
        bound.setflags(write=False)
    return {**bounds}


def checked_bound(model: LinearSystem, name: str, value: ArrayLike) -> np.ndarray | jax.Array:
    """Check one entry of `bounds` and give it its shape: an array of its own, which nobody writes.

    Raises:
        ValueError: a wrong shape, a negative bound, a tolerance >= 1, lo > hi, NaN or infinity.
    """
    kind = KINDS[name]
    if kind == "output":
        names = model.outputs
    elif kind == "disturbance":
        names = tuple(f"w{j + 1}" for j in range(model.g))
    elif kind == "average":
        names = tuple(bounded.text for bounded in window.bounded_sums(model))
    else:
        names = tuple(u.name for u in model.uncertainties)
    shape = np.shape(value)
    allowed = ((), (len(names),), (len(names), 2))[: 3 if kind == "disturbance" else 2]
    if shape not in allowed:
        raise ValueError(f"{name} needs one number or one per {kind} ({len(names)}): its shape is {shape}")
    if isinstance(value, jax.core.Tracer):
        traced = value if len(shape) == 2 else jnp.broadcast_to(value, (len(names),))
        return jnp.stack([-traced, traced], 1) if kind == "disturbance" and len(shape) < 2 else traced
    given = np.array(value, np.float64)
    top = 1 if name == "tolerance" else np.inf
    spread = given if len(shape) == 2 else np.broadcast_to(given, (len(names),))
    for who, b in zip(names, spread, strict=True):
        if len(shape) == 2 and not -np.inf < b[0] <= b[1] < np.inf:
            raise ValueError(f"{name} needs lo <= hi, both finite: {kind} {who!r} has [{b[0]:g}, {b[1]:g}]")
        if len(shape) < 2 and not 0 <= b < top:
            raise ValueError(f"{name} must be in [0, {top}): {kind} {who!r} has {b:g}")
    if kind == "disturbance" and len(shape) < 2:
        spread = np.stack([-spread, spread], 1)
    spread.setflags(write=False)
    return spread


def float_bound(bound: np.ndarray | jax.Array, dtype: DTypeLike) -> np.ndarray | jax.Array:
    """Return a bound in a float dtype, rounded up."""
    return (
        bound.astype(dtype)
        if isinstance(bound, jax.core.Tracer)
        else rounding.round_up(np.asarray(bound, np.float64), dtype)
    )


def changed_bounds(model: LinearSystem, old: Bounds, new: Mapping[str, ArrayLike]) -> Bounds:
    """Return the bounds `old` with the entries of `new` in their place, checked as in `checked_bound`;
    ValueError for an unknown name.
    """
    unknown = sorted(set(new) - set(old))
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
    nearest = np.vectorize(float, otypes=[np.float64])
    taken = lambda x: cast("jax.Array", x)  # kernels take arrays of NumPy too
    return Reading(
        cast("Strips | Frame", shape),  # None for a PolynomialReading: only windows are read by it
        taken(float_bound(bounds["tolerance"], dtype)),
        taken(float_bound(bounds["noise"], dtype)),
        taken(rounding.round_up(list(model.resolution), dtype)),
        taken(lo_hi.astype(dtype)),
        nearest(model.offset["u"]).astype(dtype),
        nearest(model.offset["y"]).astype(dtype),
        window.window_rows(model, horizon, lags),
        window.input_lags(model, horizon),
        taken(float_bound(bounds.get("average", np.zeros(0)), dtype)),
    )
