"""Simulate a plant whose unknowns stay within their bounds, in about twice the digits of the recording.

The state is carried in double-word arithmetic and every matrix entry as the sum of two floats, so that a recorded sample is the exact
trajectory's within its resolution even where it is the difference of large levels (a plain recursion was off by 120 times that).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.arrays import inputs_of, refuse_infinite
from jaxbound.recordings.expressions import missing_column
from jaxbound.sets.floats import rounding

__all__ = ["Trajectory", "simulate"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A simulated recording. x (..., T, n) states (minus nothing: in the model's own deviation units), u (..., T, m) recorded
    inputs, y (..., T, p) recorded outputs, theta, noise (..., T, p), disturbance (..., T, g), unknown_input (..., T, d) and parameters
    (..., T, q): the unknowns that were drawn; parameters in [-1, 1], the middle of each being 0.
    """

    x: jax.Array
    u: jax.Array
    y: jax.Array
    theta: jax.Array
    noise: jax.Array
    disturbance: jax.Array
    unknown_input: jax.Array | None = None
    parameters: jax.Array | None = None


def simulate(
    model: ModelLike,
    u: object,
    key: jax.Array,
    x0: ArrayLike | None = None,
    at: str = "uniform",
    faults: Sequence[Fault] = (),
    unknown_input: ArrayLike | None = None,
) -> Trajectory:
    """Simulate x+ = A x + B u + G w + F v, y = (1 + theta) (C x + D u + D_v v) + noise with w, theta and noise within their bounds;
    uncertain parameters, within theirs, change A, B, C, D.

    Args:
        model: a LinearSystem.
        u: (..., T, m) inputs as recorded, offset included; leading axes are recordings of their own. A model without inputs
            needs (..., T, 0). A table gives them by name.
            Its float dtype is that of the recording (float32 as it is, anything else the default float).
        key: a jax.random key.
        x0: (n,) or (..., n) first state; default 0.
        at: "uniform" draws w, theta, noise and parameters uniformly; "vertices" at one of their bounds each sample.
            With constant_tolerance a recording has one theta an output, and a parameter that does not vary keeps one value.
        faults: a sequence of Fault.
        unknown_input: v, (..., T, d) of the model's unknown inputs; default: drawn from a standard normal distribution.

    Returns:
        A Trajectory. Without faults y is within the model's resolution of an exact trajectory with unknowns inside the bounds
        (half an ulp of y beyond what the noise explains), so `detect` never calls it FAULT.

    Raises:
        ValueError: shapes that do not fit, a signal that the model does not have, an unknown `at`.

    Example:
        >>> import jax, jaxbound as jb
        >>> m = jb.LinearSystem([[0.8]], [[1]], [[1]], noise=0.1)
        >>> simulate(m, jnp.ones((50, 1)), jax.random.key(0)).y.shape
        (50, 1)
    """
    model = as_model(model)
    if at not in ("uniform", "vertices"):
        raise ValueError(f"at must be 'uniform' or 'vertices', not {at!r}")
    u = np.zeros(0) if u is None else inputs_of(model, u)
    if u.ndim < 2 or u.shape[-1] != model.m:
        raise ValueError(f"u must have shape (..., T, {model.m}), time first: its shape is {u.shape}")
    u = jnp.asarray(u, jax.dtypes.canonicalize_dtype(u.dtype))
    refuse_infinite("u", u, model.inputs) if not isinstance(u, jax.core.Tracer) else None
    batch, (T, _) = u.shape[:-2], u.shape[-2:]
    x0 = jnp.zeros((model.n,), u.dtype) if x0 is None else jnp.asarray(x0, u.dtype)
    if x0.shape[-1:] != (model.n,) or (x0.ndim > 1 and x0.shape[:-1] != batch):
        raise ValueError(f"x0 must have shape ({model.n},) or {(*batch, model.n)}: its shape is {x0.shape}")
    x0 = jnp.broadcast_to(x0, (*batch, model.n))
    if unknown_input is not None:
        unknown_input = jnp.asarray(unknown_input, u.dtype)
        if unknown_input.shape != (*batch, T, model.d):
            raise ValueError(f"unknown_input must have shape {(*batch, T, model.d)}: its shape is {unknown_input.shape}")
        unknown_input = unknown_input.reshape(math.prod(batch), T, model.d)
    active = _switches(model, faults, T)
    lo, hi = zip(*model.disturbance, strict=True) if model.g else ((), ())
    numbers = {
        "G": _double(model.G, u.dtype), "lo": rounding.round_up(list(lo), u.dtype), "hi": rounding.round_down(list(hi), u.dtype),
        "F": _double(model.F, u.dtype), "D_v": _double(model.D_v, u.dtype),
        "A": _double(model.A, u.dtype), "B": _double(model.B, u.dtype), "C": _double(model.C, u.dtype), "D": _double(model.D, u.dtype),
        "tolerance": rounding.round_down(list(model.tolerance), u.dtype), "noise": rounding.round_down(list(model.noise), u.dtype),
        "offset_u": _double([model.offset["u"]], u.dtype), "offset_y": _double([model.offset["y"]], u.dtype)}  # fmt: skip
    numbers["varying"] = np.array([p.varying for p in model.uncertainties], bool)
    numbers["parameters"] = [
        {letter: _double(rows, u.dtype) for letter in "ABCD" if (rows := p.on(letter)) is not None} for p in model.uncertainties
    ]
    sizes = np.array([f.size for f in faults], u.dtype)
    kinds = tuple((f.kind, model.outputs.index(f.signal) if f.signal in model.outputs else None,
                   model.inputs.index(f.signal) if f.signal in model.inputs else None) for f in faults)  # fmt: skip
    run = partial(_simulate, at == "vertices", model.constant_tolerance, kinds)
    count = math.prod(batch)
    flat = [v.reshape(count, *v.shape[len(batch) :]) for v in (u, x0)]
    keys = jax.random.split(key, count)
    out = run(numbers, sizes, active, keys, *flat, unknown_input)
    return Trajectory(*(v.reshape(*batch, *v.shape[1:]) for v in out))


def _switches(model: LinearSystem, faults: Sequence[Fault], T: int) -> np.ndarray:
    """Return (faults, T) bool: where each fault acts."""
    rows = []
    for f in faults:
        if f.signal not in model.outputs + model.inputs:
            raise ValueError(missing_column(f.signal, model.outputs + model.inputs, "the model"))
        if f.kind == "tolerance" and f.signal not in model.outputs:
            raise ValueError(f"a tolerance fault needs an output, {f.signal!r} is an input")
        if f.start >= T:
            raise ValueError(f"the fault of {f.signal!r} starts at sample {f.start}, but there are {T} samples")
        k = np.arange(T)
        rows.append((k >= f.start) & (k < (T if f.stop is None else f.stop)))
    return np.array(rows, bool).reshape(len(faults), T)


def _double(a, dtype):
    """Return exact numbers as a pair of float arrays whose sum is accurate to twice the digits."""
    shape = len(a), len(a[0]) if a else 0
    hi = np.array([[float(x) for x in row] for row in a], np.float64).astype(dtype).reshape(shape)
    lo = np.array(
        [[float(x - Fraction(float(h))) for x, h in zip(row, top, strict=True)] for row, top in zip(a, hi, strict=True)], np.float64
    )
    return hi, lo.astype(dtype).reshape(shape)


def _apply(matrix, vector):
    """Multiply a double-word matrix (r, c) with a double-word vector (c,)."""
    hi, lo = matrix
    total = (jnp.zeros_like(hi, shape=hi.shape[:1]),) * 2
    for j in range(hi.shape[1]):
        total = rounding.dd_add(total, rounding.dd_mul((hi[:, j], lo[:, j]), (vector[0][j], vector[1][j])))
    return total


def _uncertain(numbers, parameters, letter, vector):
    """Multiply a vector with a matrix of the model at the parameters of this sample."""
    total = _apply(numbers[letter], vector)
    for i, part in enumerate(numbers["parameters"]):
        if letter in part:
            value = (parameters[i], jnp.zeros_like(parameters[i]))
            total = rounding.dd_add(total, rounding.dd_mul(value, _apply(part[letter], vector)))
    return total


@partial(jax.jit, static_argnums=(0, 1, 2))
def _simulate(vertices, constant, kinds, numbers, sizes, active, keys, u, x0, v):
    return jax.vmap(partial(_one, vertices, constant, kinds, numbers, sizes, active))(keys, u, x0, v)


def _one(vertices, constant, kinds, numbers, sizes, active, key, u, x0, v):
    T, p = u.shape[0], numbers["C"][0].shape[0]
    k_theta, k_noise, k_fault = jax.random.split(key, 3)
    k_w = jax.random.fold_in(key, 3)
    draw = (lambda k, s: jax.random.rademacher(k, s, u.dtype)) if vertices else (lambda k, s: jax.random.uniform(k, s, u.dtype, -1, 1))
    signs = jnp.broadcast_to(draw(k_theta, (1, p)), (T, p)) if constant else draw(k_theta, (T, p))
    tolerance = jnp.broadcast_to(numbers["tolerance"], (T, p))
    for (kind, output, _), size, on in zip(kinds, sizes, active, strict=True):
        if kind == "tolerance":
            tolerance = tolerance.at[:, output].set(jnp.where(on, size, tolerance[:, output]))
    theta = tolerance * signs
    noise = numbers["noise"][None] * draw(k_noise, (T, p))
    lo, hi = numbers["lo"][None], jnp.maximum(numbers["lo"], numbers["hi"])[None]
    share = draw(k_w, (T, lo.shape[1]))
    w = jnp.where(share == 1, hi, jnp.clip(lo + 0.5 * (share + 1) * (hi - lo), lo, hi))
    v = jax.random.normal(jax.random.fold_in(key, 4), (T, numbers["F"][0].shape[1]), u.dtype) if v is None else v
    extra = jax.random.uniform(k_fault, (len(kinds), T), u.dtype, -1, 1)
    each = draw(jax.random.fold_in(key, 5), (T, len(numbers["parameters"])))
    parameters = jnp.where(numbers["varying"][None], each, each[:1])
    applied = _faulty(u, kinds, sizes, active, extra, lambda f: f[2], dropped=0.0)

    single = lambda v: (v, jnp.zeros_like(v))
    offset_u, offset_y = (tuple(part[0] for part in numbers[name]) for name in ("offset_u", "offset_y"))

    def step(x, now):
        inputs, w, v, theta, noise, parameters = now
        deviation = rounding.dd_add(rounding.two_sum(inputs, -offset_u[0]), single(-offset_u[1]))
        mapped = lambda letter, vector: _uncertain(numbers, parameters, letter, vector)
        true = rounding.dd_add(mapped("C", x), mapped("D", deviation))
        true = rounding.dd_add(true, _apply(numbers["D_v"], single(v))) if len(v) else true
        y = rounding.dd_add(true, rounding.dd_mul(single(theta), true))  # not (1 + theta) t: XLA turns (theta + 1) - 1 into theta
        y = rounding.dd_add(rounding.dd_add(y, single(noise)), offset_y)
        after = rounding.dd_add(mapped("A", x), mapped("B", deviation))
        after = rounding.dd_add(after, _apply(numbers["F"], single(v))) if len(v) else after
        return rounding.dd_add(after, _apply(numbers["G"], single(w))) if len(lo) else after, (x[0], y[0])

    _, (x, y) = jax.lax.scan(step, single(x0), (applied, w, v, theta, noise, parameters))
    return x, u, _faulty(y, kinds, sizes, active, extra, lambda f: f[1], dropped=jnp.nan), theta, noise, w, v, parameters


def _faulty(signals, kinds, sizes, active, extra, channel, dropped):
    """Apply the faults of one side, in order, to (T, c) signals."""
    for i, fault in enumerate(kinds):
        c = channel(fault)
        if c is None or fault[0] == "tolerance":
            continue
        x, size, on = signals[:, c], sizes[i], active[i]
        since = jnp.cumsum(on) - 1
        changed = {
            "bias": x + size,
            "drift": x + size * since,
            "gain": x * (1 + size),
            "noise": x + size * extra[i],
            "stuck": jnp.broadcast_to(x[jnp.argmax(on)], x.shape),
            "dropout": jnp.full_like(x, dropped),
        }[fault[0]]  # what is not chosen is never compiled
        signals = signals.at[:, c].set(jnp.where(on, changed, x))
    return signals
