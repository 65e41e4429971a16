"""Simulate a plant whose unknowns stay within their bounds, in about twice the digits of the recording.

The state is carried in double-word arithmetic and every matrix entry as the sum of two floats, so that a recorded sample is the exact
trajectory's within its resolution even where it is the difference of large levels (a plain recursion was off by 120 times that).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.models.averaging import kept_averages, places_of
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault, refuse_unknown_signal
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.arrays import inputs_of, refuse_infinite
from jaxbound.recordings.objecttext import readable
from jaxbound.recordings.seeds import key_of
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.sizes import power

__all__ = ["Trajectory", "simulate"]

FEW = 2**16
"""Samples of all recordings up to which as many as the next power of two are compiled for: few shapes serve all."""


@readable
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
    key: jax.Array | int,
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
        key: a jax.random key, or a whole number.
        x0: (n,) or (..., n) first state; default 0.
        at: "uniform" draws w, theta, noise and parameters uniformly; "vertices" at one of their bounds each sample.
            Averages that the model bounds are kept by moving draws as little as they need (`models.averaging`).
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
    given: Any = np.zeros(0) if u is None else inputs_of(model, u)
    if given.ndim < 2 or given.shape[-1] != model.m:
        raise ValueError(f"u must have shape (..., T, {model.m}), time first: its shape is {given.shape}")
    dtype = jax.dtypes.canonicalize_dtype(given.dtype)
    given = _host(given).astype(dtype)
    refuse_infinite("u", given, model.inputs) if not isinstance(given, jax.core.Tracer) else None
    batch, (T, _) = given.shape[:-2], given.shape[-2:]
    start: Any = np.zeros((model.n,), dtype) if x0 is None else _host(x0).astype(dtype)
    if start.shape[-1:] != (model.n,) or (start.ndim > 1 and start.shape[:-1] != batch):
        raise ValueError(f"x0 must have shape ({model.n},) or {(*batch, model.n)}: its shape is {start.shape}")
    v: Any = None if unknown_input is None else _host(unknown_input).astype(dtype)
    if v is not None and v.shape != (*batch, T, model.d):
        raise ValueError(f"unknown_input must have shape {(*batch, T, model.d)}: its shape is {v.shape}")
    lo, hi = zip(*model.disturbance, strict=True) if model.g else ((), ())
    numbers = {
        "matrix": tuple(part.T[..., None] for part in _double(_blocks(model, model), dtype)),
        "parts": _columns([_double(_blocks(model, p), dtype) for p in model.uncertainties]),
        "varying": np.array([p.varying for p in model.uncertainties], bool),
        "lo": rounding.round_up(list(lo), dtype), "hi": rounding.round_down(list(hi), dtype),
        "tolerance": rounding.round_down(list(model.tolerance), dtype), "noise": rounding.round_down(list(model.noise), dtype),
        "offset_u": _double([model.offset["u"]], dtype), "offset_y": _double([model.offset["y"]], dtype)}  # fmt: skip
    sizes = np.array([f.size for f in faults], dtype)
    kinds = tuple((f.kind, model.outputs.index(f.signal) if f.signal in model.outputs else None,
                   model.inputs.index(f.signal) if f.signal in model.inputs else None) for f in faults)  # fmt: skip
    count = math.prod(batch)
    longer = _length(T, count) - T
    more = power(count) - count if 1 < count and count * (T + longer) <= FEW else 0
    padded = lambda v: _library(v).pad(v.reshape(count, *v.shape[len(batch) :]), ((0, more), (0, longer), (0, 0)))
    active = np.pad(_switches(model, faults, T), ((0, 0), (0, longer)))
    start = _library(start).broadcast_to(start, (*batch, model.n)).reshape(count, model.n)
    start = _library(start).pad(start, ((0, more), (0, 0)))
    widths = {0: model.p, 1: model.p, 2: len(kinds) if "noise" in [f.kind for f in faults] else 0, 3: model.g, 5: len(numbers["varying"])}
    streams = [stream for stream, width in widths.items() if width]
    size = (T + longer) * max(widths.values())
    key = key_of(key)
    draws = _draws(key, np.array(streams), count + more, size, dtype)
    v = _normal(key, count + more, (T + longer, model.d), dtype) if v is None else padded(v)
    how = np.array([at == "vertices", model.constant_tolerance])
    places, numbers["averages"] = places_of(model, dtype)
    out = _simulate(kinds, tuple(streams), places, how, numbers, sizes, active, draws, padded(given), start, v)
    return Trajectory(*_cut(out, batch, T))


def _library(x: object) -> Any:
    """Return NumPy for what is on the host, where nothing is compiled, jax.numpy for what is inside jit."""
    return jnp if isinstance(x, jax.core.Tracer) else np


def _host(x: ArrayLike) -> Any:
    return _library(x).asarray(x)


def _length(T: int, count: int) -> int:
    """Return the number of samples that is compiled for: of few sizes, and no more than an eighth beyond T where there is much to do."""
    step = 1 << max(T - 1, 63).bit_length()
    if T * count > FEW:
        step = max(step // 16, 1)
    return -(-T // step) * step


def _cut(out: tuple[jax.Array, ...], batch: tuple[int, ...], T: int) -> tuple[jax.Array, ...]:
    """Return what was asked for of what was compiled for; on the host, where nothing is compiled."""
    cut = lambda v: v[: math.prod(batch), :T].reshape(*batch, T, v.shape[2])
    if any(isinstance(v, jax.core.Tracer) for v in out):
        return tuple(map(cut, out))
    return tuple(jax.device_put([cut(np.asarray(v)) for v in out]))


def _switches(model: LinearSystem, faults: Sequence[Fault], T: int) -> np.ndarray:
    """Return (faults, T) bool: where each fault acts."""
    rows = []
    for f in faults:
        refuse_unknown_signal(model, f.signal, f.kind)
        if f.start >= T:
            raise ValueError(f"the fault of {f.signal!r} starts at sample {f.start}, but there are {T} samples")
        k = np.arange(T)
        rows.append((k >= f.start) & (k < (T if f.stop is None else f.stop)))
    return np.array(rows, bool).reshape(len(faults), T)


def _blocks(model: LinearSystem, of: Any) -> list[list[Fraction]]:
    """Return the exact rows [A B G F; C D 0 D_v] of a model, or of what an uncertainty changes in it."""
    widths = {"A": model.n, "B": model.m, "C": model.n, "D": model.m, "G": model.g, "F": model.d, "D_v": model.d, "": model.g}

    def row(letter: str, i: int) -> Sequence[Fraction]:
        matrix = () if not letter else getattr(of, letter) if of is model else of.on(letter) if letter in "ABCD" else ()
        return matrix[i] if matrix else [Fraction(0)] * widths[letter]

    upper = [[x for letter in ("A", "B", "G", "F") for x in row(letter, i)] for i in range(model.n)]
    return upper + [[x for letter in ("C", "D", "", "D_v") for x in row(letter, i)] for i in range(model.p)]


def _double(a, dtype):
    """Return exact numbers as a pair of float arrays whose sum is accurate to twice the digits."""
    shape = len(a), len(a[0]) if a else 0
    hi = np.array([[float(x) for x in row] for row in a], np.float64).astype(dtype).reshape(shape)
    lo = np.array(
        [[float(x - Fraction(float(h))) for x, h in zip(row, top, strict=True)] for row, top in zip(a, hi, strict=True)], np.float64
    )
    return hi, lo.astype(dtype).reshape(shape)


def _columns(pairs):
    """Return double-word matrices (r, c) side by side, turned: (c, matrices, r, 1)."""
    return tuple(np.stack(part).transpose(2, 0, 1)[..., None] for part in zip(*pairs, strict=True)) if pairs else None


def _total(terms):
    """Add double-word numbers (c, ...) along the first axis, by halves: there is little to compile."""
    count = len(terms[0])
    if count < 2:
        return tuple(jnp.sum(v, 0) for v in terms)
    half = count // 2
    total = _total(rounding.dd_add(*(tuple(v[start : start + half] for v in terms) for start in (0, half))))
    return rounding.dd_add(total, tuple(v[-1] for v in terms)) if count % 2 else total


def _apply(matrix, vectors):
    """Multiply double-word matrices, turned, (c, ..., 1) with double-word vectors (c, N)."""
    between = (1,) * (matrix[0].ndim - 2)
    return _total(rounding.dd_mul(matrix, tuple(v.reshape(len(v), *between, v.shape[1]) for v in vectors)))


@partial(jax.jit, static_argnums=(2, 3, 4))
def _draws(key, streams, recordings, size, dtype):
    """Return uniform draws (streams, recordings, size) in [-1, 1): one program for every model, and longer ones begin with the shorter."""
    keys = jax.random.split(key, recordings)
    keys = jax.vmap(lambda stream: jax.vmap(lambda k: jax.random.fold_in(k, stream))(keys))(streams)
    return jax.vmap(jax.vmap(lambda k: jax.random.uniform(k, (size,), dtype, -1, 1)))(keys)


def _normal(key, recordings, shape, dtype):
    """Return unknown inputs (recordings, *shape) that nobody gave."""
    if not shape[1]:
        return np.zeros((recordings, *shape), dtype)
    return _normal_draws(key, recordings, shape, dtype)


@partial(jax.jit, static_argnums=(1, 2, 3))
def _normal_draws(key, recordings, shape, dtype):
    return jax.vmap(lambda k: jax.random.normal(jax.random.fold_in(k, 4), shape, dtype))(jax.random.split(key, recordings))


@partial(jax.jit, static_argnums=(0, 1, 2))
def _simulate(kinds, streams, places, how, numbers, sizes, active, draws, u, x0, v):
    n = x0.shape[1]
    theta, noise, w, parameters, extra = _unknowns(kinds, dict(zip(streams, draws, strict=True)), how, numbers, sizes, active, u)
    if places:
        noise, w = kept_averages(places, numbers["averages"], noise, w, (numbers["noise"], numbers["lo"], numbers["hi"]))
    faulty = lambda signals, side, dropped: jax.vmap(lambda s, e: _faulty(kinds, sizes, active, s, e, side, dropped))(signals, extra)
    applied = faulty(u, 2, 0.0)

    single = lambda v: (v, jnp.zeros_like(v))
    offset_u, offset_y = (tuple(part[0, :, None] for part in numbers[name]) for name in ("offset_u", "offset_y"))

    def step(x, now):
        inputs, w, v, theta, noise, parameters = now
        deviation = rounding.dd_add(rounding.two_sum(inputs, -offset_u[0]), single(-offset_u[1]))
        signals = tuple(jnp.concatenate(part) for part in zip(x, deviation, single(w), single(v), strict=True))
        both = _apply(numbers["matrix"], signals)
        if len(parameters):
            moved = rounding.dd_mul(single(parameters[:, None]), _apply(numbers["parts"], signals))
            both = rounding.dd_add(both, _total(moved))
        after, true = (tuple(part[rows] for part in both) for rows in (slice(n), slice(n, None)))
        y = rounding.dd_add(true, rounding.dd_mul(single(theta), true))  # not (1 + theta) t: XLA turns (theta + 1) - 1 into theta
        y = rounding.dd_add(rounding.dd_add(y, single(noise)), offset_y)
        return after, (x[0], y[0])

    along = [jnp.moveaxis(signal, 0, 2) for signal in (applied, w, v, theta, noise, parameters)]  # recordings last: they fill a vector
    x, y = (jnp.moveaxis(signal, 2, 0) for signal in jax.lax.scan(step, single(x0.T), along)[1])
    return x, u, faulty(y, 1, jnp.nan), theta, noise, w, v, parameters


def _unknowns(kinds, draws, how, numbers, sizes, active, u):
    """Return what recordings draw, from `draws` by stream: theta, noise, disturbances, parameters, and the noise of faults."""
    count, T, p = u.shape[0], u.shape[1], len(numbers["noise"])
    vertices, constant = how

    def drawn(stream, width, anywhere=False):
        x = draws[stream][:, : T * width].reshape(count, T, width) if stream in draws else jnp.zeros((count, T, width), u.dtype)
        return x if anywhere else jnp.where(vertices, jnp.where(x < 0, -1, 1).astype(x.dtype), x)

    signs = drawn(0, p)
    signs = jnp.where(constant, signs[:, :1], signs)
    tolerance = jnp.broadcast_to(numbers["tolerance"], (T, p))
    for (kind, output, _), size, on in zip(kinds, sizes, active, strict=True):
        if kind == "tolerance":
            tolerance = tolerance.at[:, output].set(jnp.where(on, size, tolerance[:, output]))
    lo, hi = numbers["lo"][None, None], jnp.maximum(numbers["lo"], numbers["hi"])[None, None]
    share = drawn(3, lo.shape[2])
    w = jnp.where(share == 1, hi, jnp.clip(lo + 0.5 * (share + 1) * (hi - lo), lo, hi))
    each = drawn(5, len(numbers["varying"]))
    parameters = jnp.where(numbers["varying"][None, None], each, each[:, :1])
    extra = jnp.moveaxis(drawn(2, len(kinds), anywhere=True), 1, 2)
    return tolerance[None] * signs, numbers["noise"][None, None] * drawn(1, p), w, parameters, extra


def _faulty(kinds, sizes, active, signals, extra, side, dropped):
    """Apply the faults of one side, in order, to (T, c) signals: 1 outputs, 2 inputs."""
    for i, fault in enumerate(kinds):
        c = fault[side]
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
