"""Simulate a plant whose unknowns stay within their bounds, in about twice the digits of the recording.

The state is carried in double-word arithmetic and every matrix entry as the sum of two floats, so that a
recorded sample is the exact trajectory's within its resolution even where it is the difference of large
levels (a plain recursion was off by 120 times that).
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
from jaxbound.models.draws import normal_draws, uniform_draws
from jaxbound.models.faults import Fault, refuse_unknown_signal
from jaxbound.models.system import LinearSystem
from jaxbound.random.keys import key_of
from jaxbound.recordings.arrays import inputs_of, refuse_infinite
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.sizes import power
from jaxbound.text.objects import readable

__all__ = ["Trajectory", "simulate"]

FEW, TINY = 2**16, 2**10
"""Samples of all recordings up to which as many as the next power of two, or of four, are compiled for: few
shapes serve all.
"""


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A simulated recording. x (..., T, n) states (minus nothing: in the model's own deviation units), u
    (..., T, m) recorded inputs, y (..., T, p) recorded outputs, theta, noise (..., T, p), disturbance (...,
    T, g), unknown_input (..., T, d) and parameters (..., T, q): the unknowns that were drawn; parameters in
    [-1, 1], the middle of each being 0.
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
    """Simulate x+ = A x + B u + G w + F v, y = (1 + theta) (C x + D u + D_v v) + noise with w, theta and
    noise within their bounds; uncertain parameters, within theirs, change A, B, C, D.

    Args:
        model: a LinearSystem.
        u: (..., T, m) inputs as recorded, offset included; leading axes are recordings of their own. A model
            without inputs needs (..., T, 0). A table gives them by name.
            Its float dtype is that of the recording (float32 as it is, anything else the default float).
        key: a jax.random key, or a whole number.
        x0: (n,) or (..., n) first state; default 0.
        at: "uniform" draws w, theta, noise and parameters uniformly; "vertices" at one of their bounds each
            sample. Averages that the model bounds are kept by moving draws as little as they need
            (`models.averaging`). With constant_tolerance a recording has one theta an output, and a parameter
            that does not vary keeps one value.
        faults: a sequence of Fault.
        unknown_input: v, (..., T, d) of the model's unknown inputs; default: drawn from a standard normal
            distribution.

    Returns:
        A Trajectory. Without faults y is within the model's resolution of an exact trajectory with unknowns
        inside the bounds (half an ulp of y beyond what the noise explains), so `detect` never calls it FAULT.

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
        raise ValueError(
            f"x0 must have shape ({model.n},) or {(*batch, model.n)}: its shape is {start.shape}"
        )
    v: Any = None if unknown_input is None else _host(unknown_input).astype(dtype)
    if v is not None and v.shape != (*batch, T, model.d):
        raise ValueError(f"unknown_input must have shape {(*batch, T, model.d)}: its shape is {v.shape}")
    lo, hi = zip(*model.disturbance, strict=True) if model.g else ((), ())
    numbers = {
        "matrices": _columns([_double(_blocks(model, of), dtype) for of in (model, *model.uncertainties)]),
        "offset_u": _double([model.offset["u"]], dtype),
        "offset_y": _double([model.offset["y"]], dtype),
    }
    bounds: dict[str, Any] = {
        "varying": np.array([p.varying for p in model.uncertainties], bool),
        "lo": rounding.round_up(list(lo), dtype),
        "hi": rounding.round_down(list(hi), dtype),
        "tolerance": rounding.round_down(list(model.tolerance), dtype),
        "noise": rounding.round_down(list(model.noise), dtype),
    }
    places, bounds["averages"] = places_of(model, dtype)
    sizes = np.array([f.size for f in faults], dtype)
    kinds = tuple(
        (
            f.kind,
            model.outputs.index(f.signal) if f.signal in model.outputs else None,
            model.inputs.index(f.signal) if f.signal in model.inputs else None,
        )
        for f in faults
    )
    count = math.prod(batch)
    longer = _length(T, count) - T
    base = 4 if count * (T + longer) <= TINY else 2
    more = power(count, base) - count if 1 < count and count * (T + longer) <= FEW else 0
    padded = lambda v: _library(v).pad(
        v.reshape(count, *v.shape[len(batch) :]), ((0, more), (0, longer), (0, 0))
    )
    active = np.pad(_switches(model, faults, T), ((0, 0), (0, longer)))
    start = _library(start).broadcast_to(start, (*batch, model.n)).reshape(count, model.n)
    start = _library(start).pad(start, ((0, more), (0, 0)))
    widths = {
        0: model.p,
        1: model.p,
        2: len(kinds) if "noise" in [f.kind for f in faults] else 0,
        3: model.g,
        5: len(model.uncertainties),
    }
    streams = tuple(stream for stream, width in widths.items() if width)
    key = key_of(key)
    draws = uniform_draws(key, streams, count + more, (T + longer) * max(widths.values()), dtype)
    v = normal_draws(key, count + more, (T + longer, model.d), dtype) if v is None else padded(v)
    arrays = draws, padded(given), start, v
    run = _recorded if _library(*arrays) is np else _recorded_within
    out = run(
        kinds,
        streams,
        places,
        at == "vertices",
        model.constant_tolerance,
        numbers,
        bounds,
        sizes,
        active,
        *arrays,
    )
    return Trajectory(*_cut(out, batch, T))


def _library(*arrays: object) -> Any:
    """Return NumPy for what is on the host, where nothing is compiled, jax.numpy for what is inside jit."""
    return jnp if any(isinstance(x, jax.core.Tracer) for x in arrays) else np


def _host(x: ArrayLike) -> Any:
    return _library(x).asarray(x)


def _length(T: int, count: int) -> int:
    """Return the number of samples that is compiled for: of few sizes, and no more than an eighth beyond T
    where there is much to do.
    """
    step = 64 * power(-(-T // 64), 4 if T * count <= TINY else 2)
    if T * count > FEW:
        step = max(step // 16, 1)
    return -(-T // step) * step


def _cut(out: tuple[jax.Array, ...], batch: tuple[int, ...], T: int) -> tuple[jax.Array, ...]:
    """Cut the samples that were asked for out of those that were compiled for, on the host."""
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
            raise ValueError(
                f"the fault of {f.signal!r} starts at sample {f.start}, but there are {T} samples"
            )
        k = np.arange(T)
        rows.append((k >= f.start) & (k < (T if f.stop is None else f.stop)))
    return np.array(rows, bool).reshape(len(faults), T)


def _blocks(model: LinearSystem, of: Any) -> list[list[Fraction]]:
    """Return the exact rows [A B G F; C D 0 D_v] of a model, or of what an uncertainty changes in it."""
    widths = {
        "A": model.n,
        "B": model.m,
        "C": model.n,
        "D": model.m,
        "G": model.g,
        "F": model.d,
        "D_v": model.d,
        "": model.g,
    }

    def row(letter: str, i: int) -> Sequence[Fraction]:
        matrix = (
            ()
            if not letter
            else getattr(of, letter)
            if of is model
            else of.on(letter)
            if letter in "ABCD"
            else ()
        )
        return matrix[i] if matrix else [Fraction(0)] * widths[letter]

    upper = [[x for letter in ("A", "B", "G", "F") for x in row(letter, i)] for i in range(model.n)]
    return upper + [[x for letter in ("C", "D", "", "D_v") for x in row(letter, i)] for i in range(model.p)]


def _double(a, dtype):
    """Return exact numbers as a pair of float arrays whose sum is accurate to twice the digits."""
    shape = len(a), len(a[0]) if a else 0
    hi = np.array([[float(x) for x in row] for row in a], np.float64).astype(dtype).reshape(shape)
    lo = np.array(
        [
            [float(x - Fraction(float(h))) for x, h in zip(row, top, strict=True)]
            for row, top in zip(a, hi, strict=True)
        ],
        np.float64,
    )
    return hi, lo.astype(dtype).reshape(shape)


def _columns(pairs):
    """Return double-word matrices (r, c) side by side, turned: (c, matrices, r, 1)."""
    return tuple(np.stack(part).transpose(2, 0, 1)[..., None] for part in zip(*pairs, strict=True))


def _total(terms):
    """Add double-word numbers (c, ...) along the first axis, by halves: there is little to compile."""
    count = len(terms[0])
    if count < 2:
        return tuple(jnp.sum(v, 0) for v in terms)
    half = count // 2
    total = _total(rounding.dd_add(*(tuple(v[start : start + half] for v in terms) for start in (0, half))))
    return rounding.dd_add(total, tuple(v[-1] for v in terms)) if count % 2 else total


def _apply(matrices, vectors):
    """Multiply double-word matrices, turned, (c, matrices, r, 1) with double-word vectors (c, N)."""
    return _total(rounding.dd_mul(matrices, tuple(v[:, None, None] for v in vectors)))


def _recorded(kinds, streams, places, vertices, constant, numbers, bounds, sizes, active, draws, u, x0, v):
    """Return (x, u, y, theta, noise, w, v, parameters) of recordings (N, T, .): by NumPy but for the
    trajectory, or inside jit.
    """
    each = dict(zip(streams, draws, strict=True))
    theta, noise, w, parameters, extra = _unknowns(kinds, each, vertices, constant, bounds, sizes, active, u)
    if places:
        noise, w = kept_averages(
            places, bounds["averages"], noise, w, (bounds["noise"], bounds["lo"], bounds["hi"])
        )
    applied = _faulty(kinds, sizes, active, u, extra, 2, 0.0)
    last = lambda x: _library(x).moveaxis(x, 0, 2)  # recordings: they fill a vector
    x, y = _trajectory(numbers, x0.T, tuple(map(last, (applied, w, v, theta, noise, parameters))))
    first = lambda x: (
        jnp.moveaxis(x, 2, 0) if isinstance(x, jax.core.Tracer) else np.moveaxis(np.asarray(x), 2, 0)
    )
    return (
        first(x),
        u,
        _faulty(kinds, sizes, active, first(y), extra, 1, np.nan),
        theta,
        noise,
        w,
        v,
        parameters,
    )


_recorded_within = partial(jax.jit, static_argnums=(0, 1, 2, 3, 4))(_recorded)


@jax.jit
def _trajectory(numbers, x0, along):
    """Return states (T, n, N) and outputs (T, p, N) from first states (n, N) and what acts (T, ., N): one
    program for every fault.
    """
    single = lambda v: (v, jnp.zeros_like(v))
    offset_u, offset_y = (
        tuple(part[0, :, None] for part in numbers[name]) for name in ("offset_u", "offset_y")
    )
    n = len(x0)

    def step(x, now):
        inputs, w, v, theta, noise, parameters = now
        deviation = rounding.dd_add(rounding.two_sum(inputs, -offset_u[0]), single(-offset_u[1]))
        signals = tuple(
            jnp.concatenate(part) for part in zip(x, deviation, single(w), single(v), strict=True)
        )
        both = _apply(numbers["matrices"], signals)  # of the model, and of what each parameter moves
        if len(parameters):
            moved = rounding.dd_mul(single(parameters[:, None]), tuple(part[1:] for part in both))
            both = rounding.dd_add(tuple(part[0] for part in both), _total(moved))
        else:
            both = tuple(part[0] for part in both)
        after, true = (tuple(part[rows] for part in both) for rows in (slice(n), slice(n, None)))
        y = rounding.dd_add(
            true, rounding.dd_mul(single(theta), true)
        )  # not (1 + theta) t: XLA turns (theta + 1) - 1 into theta
        y = rounding.dd_add(rounding.dd_add(y, single(noise)), offset_y)
        return after, (x[0], y[0])

    return jax.lax.scan(step, single(x0), along)[1]


def _unknowns(kinds, draws, vertices, constant, bounds, sizes, active, u):
    """Draw theta, noise, disturbances, parameters and the noise of faults of recordings. draws: by stream."""
    count, T, p = u.shape[0], u.shape[1], len(bounds["noise"])
    xp = _library(u, *draws.values())

    def drawn(stream, width, anywhere=False):
        x = (
            draws[stream][:, : T * width].reshape(count, T, width)
            if stream in draws
            else xp.zeros((count, T, width), u.dtype)
        )
        return xp.where(x < 0, -1, 1).astype(x.dtype) if vertices and not anywhere else x

    signs = drawn(0, p)
    signs = signs[:, :1] if constant else signs
    tolerance = xp.broadcast_to(bounds["tolerance"], (T, p))
    for (kind, output, _), size, on in zip(kinds, sizes, active, strict=True):
        if kind == "tolerance":
            tolerance = xp.where(on[:, None] & (np.arange(p) == output)[None], size, tolerance)
    lo, hi = bounds["lo"][None, None], xp.maximum(bounds["lo"], bounds["hi"])[None, None]
    share = drawn(3, lo.shape[2])
    w = xp.where(share == 1, hi, xp.clip(lo + 0.5 * (share + 1) * (hi - lo), lo, hi))
    each = drawn(5, len(bounds["varying"]))
    parameters = xp.where(bounds["varying"][None, None], each, each[:, :1])
    extra = drawn(2, len(kinds), anywhere=True)
    return tolerance[None] * signs, bounds["noise"][None, None] * drawn(1, p), w, parameters, extra


def _faulty(kinds, sizes, active, signals, extra, side, dropped):
    """Apply the faults of one side, in order, to signals (N, T, c): 1 outputs, 2 inputs. extra (N, T,
    faults): the noise of faults.
    """
    xp = _library(signals, extra)
    for i, fault in enumerate(kinds):
        c = fault[side]
        if c is None or fault[0] == "tolerance":
            continue
        x, size, on = signals[:, :, c], sizes[i], active[i]
        with np.errstate(over="ignore", invalid="ignore"):
            changed = _changed(xp, fault[0], x, size, on, extra[:, :, i], dropped)
        here = on[:, None] & (np.arange(signals.shape[2]) == c)[None]
        signals = xp.where(here[None], changed[:, :, None], signals)
    return signals


def _changed(xp, kind, x, size, on, extra, dropped):
    """Return one signal (N, T) with its fault."""
    if kind == "stuck":
        return xp.broadcast_to(xp.take(x, xp.argmax(on), 1)[:, None], x.shape)
    if kind == "dropout":
        return xp.full_like(x, dropped)
    if kind == "gain":
        return x * (1 + size)
    since = (xp.cumsum(on) - 1).astype(x.dtype)[None]
    return x + {"bias": size, "drift": size * since, "noise": size * extra}[kind]
