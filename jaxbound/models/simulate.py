"""Simulate a plant whose unknowns stay within their bounds, in about twice the digits of the recording.

The state is carried in double-word arithmetic and every matrix entry as the sum of two floats, so that a
recorded sample is the exact trajectory's within its resolution even where it is the difference of large
levels (a plain recursion was off by 120 times that).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from types import ModuleType
from typing import NamedTuple, TypedDict, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from jaxbound.exact.linalg import Matrix, beside, zeros
from jaxbound.models.averaging import AverageNumbers, Places, kept_averages, places_of
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.draws import normal_draws, uniform_draws
from jaxbound.models.faults import Fault, refuse_unknown_signal
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.random.keys import key_of
from jaxbound.random.threefry import Array
from jaxbound.recordings.arrays import float_array, inputs_of, refuse_infinite
from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.rounding import Pair
from jaxbound.sets.floats.sizes import power
from jaxbound.text.objects import readable

FEW, TINY = 2**16, 2**10
"""Samples of all recordings up to which as many as the next power of two, or of four, are compiled for: few
shapes serve all.
"""
THETA, NOISE, FAULT_NOISE, DISTURBANCE, PARAMETER = 0, 1, 2, 3, 5
"""Streams of random numbers; the fourth has the normal ones of unknown inputs (`draws`)."""


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
        ValueError: shapes that do not fit, a signal that the model does not have, an unknown `at`; a factor
            on noise without a value, or over more than inputs: u may have the factors behind its inputs.

    Example:
        >>> import jax, jaxbound as jb
        >>> m = jb.LinearSystem([[0.8]], [[1]], [[1]], noise=0.1)
        >>> simulate(m, jnp.ones((50, 1)), jax.random.key(0)).y.shape
        (50, 1)
    """
    model = as_model(model, factors=True)
    if at not in ("uniform", "vertices"):
        raise ValueError(f"at must be 'uniform' or 'vertices', not {at!r}")
    recorded = recorded_inputs(model, u)
    acts = _acts(model, faults, recorded.columns.shape[-2], recorded.columns.dtype)
    return simulated(model, recorded, key, acts, at, x0, unknown_input)


class Recorded(NamedTuple):
    """Inputs as they are recorded. Fields: columns (..., T, m), with factors on noise behind them; factors
    (..., T, p); None where the model has none.
    """

    columns: Array
    factors: Array | None


class Channel(NamedTuple):
    """A fault as a kernel sees it: its kind, and the number of its output or of its input."""

    kind: str
    output: int | None
    input: int | None


class Acts(NamedTuple):
    """Faults of recordings.

    Fields: channels: of each. sizes (faults, N or 1, 1); active (faults, N or 1, T) bool: where each acts.
    """

    channels: tuple[Channel, ...]
    sizes: np.ndarray
    active: np.ndarray


def simulated(
    model: LinearSystem,
    recorded: Recorded,
    key: jax.Array | int,
    acts: Acts,
    at: str,
    x0: ArrayLike | None = None,
    unknown_input: ArrayLike | None = None,
) -> Trajectory:
    """Return the Trajectory of `simulate`, of faults that may differ from recording to recording."""
    columns, factors = recorded
    inputs = columns[..., : model.m]
    *leading, T, _ = inputs.shape
    batch, dtype = tuple(leading), inputs.dtype
    start = _first_states(model, x0, batch, dtype)
    v = _stated_unknown_input(unknown_input, (*batch, T, model.d), dtype)

    # All is filled up to sizes that serve many simulations, and cut again at the end.
    count, samples = _compiled_sizes(math.prod(batch), T)
    start = _filled(start[..., None, :], count, 1)[:, 0]
    channels = acts.channels
    widths = {
        THETA: model.p,
        NOISE: model.p,
        FAULT_NOISE: len(channels) if any(c.kind == "noise" for c in channels) else 0,
        DISTURBANCE: model.g,
        PARAMETER: len(model.uncertainties),
    }
    streams = tuple(stream for stream, width in widths.items() if width)
    key = key_of(key)
    # one call for all streams: each recording has the same draws, however many stand beside it
    draws = uniform_draws(key, streams, count, samples * max(widths.values()), dtype)
    if v is None:
        v = normal_draws(key, count, (samples, model.d), dtype)
    else:
        v = _filled(v, count, samples)

    places, averages = places_of(model, dtype)
    bounds = _bounds(model, averages, dtype)
    if factors is not None:
        # inward: no draw lies beyond its bound
        bounds["noise"] = np.nextafter(bounds["noise"] * _filled(factors, count, samples), 0, dtype=dtype)
    rules = _Rules(channels, streams, places, at == "vertices", model.constant_tolerance)
    sizes = _for_all(acts.sizes, count)
    active = np.pad(_for_all(acts.active, count), ((0, 0), (0, 0), (0, samples - T)))
    u = _filled(inputs, count, samples)
    given = _Given(_plant_numbers(model, dtype), bounds, sizes, active, draws, u, start, v)
    run = _recorded if _library(draws, u, start, v) is np else _recorded_within
    run_of = Trajectory(*_cut(run(rules, given), batch, T))
    if factors is None:
        return run_of
    return replace(run_of, u=cast("jax.Array", columns))


def _for_all(x: np.ndarray, count: int) -> np.ndarray:
    """Return numbers (faults, N, .) of so many recordings; those of (faults, 1, .) are of all."""
    if x.shape[1] == 1:
        return x
    return np.pad(x, ((0, 0), (0, count - x.shape[1]), (0, 0)))


class _PlantNumbers(TypedDict):
    """The numbers of a plant, as pairs of floats: its matrices turned, and its operating point."""

    matrices: tuple[np.ndarray, np.ndarray]
    offset_u: tuple[np.ndarray, np.ndarray]
    offset_y: tuple[np.ndarray, np.ndarray]


class _Bounds(TypedDict):
    """The bounds of what is drawn, rounded inward; varying: whether parameters are drawn anew each sample."""

    varying: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    tolerance: np.ndarray
    noise: np.ndarray
    averages: AverageNumbers


class _Rules(NamedTuple):
    """The static part of a simulation. Fields: channels: of faults. streams: of random numbers. places: of
    averages. vertices: whether each draw is an end. constant: whether a recording has one theta an output.
    """

    channels: tuple[Channel, ...]
    streams: tuple[int, ...]
    places: Places
    vertices: bool
    constant: bool


class _Given(NamedTuple):
    """The numbers of a simulation. Fields: sizes, active: as of `Acts`. draws (streams, N, .); u (N, T, m);
    x0 (N, n); v (N, T, d).
    """

    numbers: _PlantNumbers
    bounds: _Bounds
    sizes: Array
    active: Array
    draws: Array
    u: Array
    x0: Array
    v: Array


def recorded_inputs(model: LinearSystem, u: object) -> Recorded:
    """Return inputs as they are given in the float type of the simulation, checked."""
    if not model.factors:
        return Recorded(_checked_inputs(model, u), None)
    if model.averages:
        raise ValueError("simulate draws noise times a factor only where no errors average out")
    inputs: Array = float_array(u, "u")
    shape = inputs.shape[:-1]
    given = _host(Recording.of(model, inputs, np.zeros((*shape, model.p), inputs.dtype)).u)
    refuse_infinite("u", given, known(model))
    # conditions of a monitor are numbered so
    if any(factor.number < 0 for factor in model.factors):
        raise ValueError("simulate draws samples of one mode: give it the model, and not that of its monitor")
    factors = np.ones((*shape, model.p), given.dtype)
    for column, factor in enumerate(model.factors, model.m):
        factors[..., factor.number] = given[..., column]
    if np.isnan(factors).any():
        raise ValueError("simulate needs every factor on noise: an input, or an expression, has no value")
    return Recorded(given, factors)


def _checked_inputs(model: LinearSystem, u: object) -> Array:
    """Return inputs (..., T, m) in the float type of the simulation, checked."""
    given = inputs_of(model, u)
    if given is None:
        given = np.zeros(0)
    if given.ndim < 2 or given.shape[-1] != model.m:
        raise ValueError(f"u must have shape (..., T, {model.m}), time first: its shape is {given.shape}")
    inputs = _host(given).astype(jax.dtypes.canonicalize_dtype(given.dtype))
    if not isinstance(inputs, jax.core.Tracer):
        refuse_infinite("u", inputs, model.inputs)
    return inputs


def _first_states(
    model: LinearSystem, x0: ArrayLike | None, batch: tuple[int, ...], dtype: np.dtype
) -> Array:
    """Return the first states (*batch, n), checked."""
    start: Array = np.zeros((model.n,), dtype)
    if x0 is not None:
        start = _host(x0).astype(dtype)
    if start.shape[-1:] != (model.n,) or (start.ndim > 1 and start.shape[:-1] != batch):
        raise ValueError(
            f"x0 must have shape ({model.n},) or {(*batch, model.n)}: its shape is {start.shape}"
        )
    spread: Array = _library(start).broadcast_to(start, (*batch, model.n))
    return spread


def _stated_unknown_input(v: ArrayLike | None, shape: tuple[int, ...], dtype: np.dtype) -> Array | None:
    """Return unknown inputs (..., T, d) that are not to be drawn, checked."""
    if v is None:
        return None
    stated = _host(v).astype(dtype)
    if stated.shape != shape:
        raise ValueError(f"unknown_input must have shape {shape}: its shape is {stated.shape}")
    return stated


def _library(*arrays: object) -> ModuleType:
    """Return NumPy for what is on the host, where nothing is compiled, jax.numpy for what is inside jit."""
    for x in arrays:
        if isinstance(x, jax.core.Tracer):
            return jnp
    return np


def _host(x: ArrayLike) -> Array:
    """Return an array on the host, or as it is inside jit."""
    array: Array = _library(x).asarray(x)
    return array


def _compiled_sizes(count: int, T: int) -> tuple[int, int]:
    """Return the numbers of recordings and of samples that are compiled for."""
    # few sizes, so that a study and its last, shorter part share a program
    samples = _length(T, count)
    if count <= 1 or count * samples > FEW:
        return count, samples
    return power(count, 4 if count * samples <= TINY else 2), samples


def _length(T: int, count: int) -> int:
    """Return the number of samples that is compiled for: of few sizes, and no more than an eighth beyond T
    where there is much to do.
    """
    step = 64 * power(-(-T // 64), 4 if T * count <= TINY else 2)
    if T * count > FEW:
        # what is padded is simulated too: of much work an eighth at most
        step = max(step // 16, 1)
    return -(-T // step) * step


def _filled(v: Array, count: int, samples: int) -> Array:
    """Return recordings (..., T, c) as (count, samples, c), zeros where there are none."""
    recordings, (T, width) = math.prod(v.shape[:-2]), v.shape[-2:]
    room = (0, count - recordings), (0, samples - T), (0, 0)
    filled: Array = _library(v).pad(v.reshape(recordings, T, width), room)
    return filled


def _cut(out: tuple[Array, ...], batch: tuple[int, ...], T: int) -> tuple[jax.Array, ...]:
    """Cut the samples that were asked for out of those that were compiled for, on the host."""
    within = any(isinstance(v, jax.core.Tracer) for v in out)
    pieces = []
    for v in out:
        array = v if within else np.asarray(v)
        pieces.append(array[: math.prod(batch), :T].reshape(*batch, T, v.shape[2]))
    return tuple(pieces if within else jax.device_put(pieces))


def channel_of(model: LinearSystem, fault: Fault) -> Channel:
    """Return a fault with the number of its signal."""
    refuse_unknown_signal(model, fault.signal, fault.kind)
    if fault.signal in model.outputs:
        return Channel(fault.kind, model.outputs.index(fault.signal), None)
    return Channel(fault.kind, None, model.inputs.index(fault.signal))


def _acts(model: LinearSystem, faults: Sequence[Fault], T: int, dtype: np.dtype) -> Acts:
    """Return the Acts of faults in all recordings alike."""
    channels = tuple(channel_of(model, f) for f in faults)
    active = np.zeros((len(faults), 1, T), bool)
    for i, f in enumerate(faults):
        if f.start >= T:
            raise ValueError(
                f"the fault of {f.signal!r} starts at sample {f.start}, but there are {T} samples"
            )
        active[i, :, f.start : f.stop] = True
    return Acts(channels, np.array([f.size for f in faults], dtype)[:, None, None], active)


def _plant_numbers(model: LinearSystem, dtype: np.dtype) -> _PlantNumbers:
    """Return the numbers of a model: its matrices, then what each parameter changes in them."""
    pairs = [_double(_model_blocks(model), dtype)]
    for u in model.uncertainties:
        pairs.append(_double(_changed_blocks(model, u), dtype))
    return {
        "matrices": _columns(pairs),
        "offset_u": _double([model.offset["u"]], dtype),
        "offset_y": _double([model.offset["y"]], dtype),
    }


def _bounds(model: LinearSystem, averages: AverageNumbers, dtype: np.dtype) -> _Bounds:
    """Return the bounds of a model in floats that lie within them."""
    return {
        "varying": np.array([p.varying for p in model.uncertainties], bool),
        # inward: what is drawn must lie within the exact bounds
        "lo": rounding.round_up([lo for lo, _ in model.disturbance], dtype),
        "hi": rounding.round_down([hi for _, hi in model.disturbance], dtype),
        "tolerance": rounding.round_down(list(model.tolerance), dtype),
        "noise": rounding.round_down(list(model.noise), dtype),
        "averages": averages,
    }


def _model_blocks(model: LinearSystem) -> Matrix:
    """Return the exact rows [A B G F; C D 0 D_v] of a model."""
    states = beside(model.A, model.B, model.G, model.F)
    return states + beside(model.C, model.D, zeros(model.p, model.g), model.D_v)


def _changed_blocks(model: LinearSystem, u: Uncertainty) -> Matrix:
    """Return the changes of those rows by an uncertain parameter at its upper bound."""
    n, m, p, others = model.n, model.m, model.p, model.g + model.d
    states = beside(u.on("A") or zeros(n, n), u.on("B") or zeros(n, m), zeros(n, others))
    return states + beside(u.on("C") or zeros(p, n), u.on("D") or zeros(p, m), zeros(p, others))


def _double(a: Sequence[Sequence[Fraction]], dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return exact numbers as a pair of float arrays whose sum is accurate to twice the digits."""
    shape = len(a), len(a[0]) if a else 0
    hi, lo = np.zeros(shape, dtype), np.zeros(shape, dtype)
    for i, row in enumerate(a):
        for j, x in enumerate(row):
            hi[i, j] = float(x)
            lo[i, j] = float(x - Fraction(float(hi[i, j])))
    return hi, lo


def _columns(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return double-word matrices (r, c) side by side, turned: (c, matrices, r, 1)."""
    hi, lo = (np.stack(part).transpose(2, 0, 1)[..., None] for part in zip(*pairs, strict=True))
    return hi, lo


def _total(terms: Pair) -> Pair:
    """Add double-word numbers (c, ...) along the first axis, by halves: there is little to compile."""
    count = len(terms[0])
    if count < 2:
        return jnp.sum(terms[0], 0), jnp.sum(terms[1], 0)
    half = count // 2
    first, second = _at(terms, slice(half)), _at(terms, slice(half, 2 * half))
    total = _total(rounding.dd_add(first, second))
    if count % 2:
        return rounding.dd_add(total, _at(terms, -1))
    return total


def _at(pair: Pair, where: int | slice) -> Pair:
    """Return the same entries of both words."""
    return pair[0][where], pair[1][where]


def _single(v: jax.Array) -> Pair:
    """Return floats as double-word numbers."""
    return v, jnp.zeros_like(v)


def _column(row: Pair) -> Pair:
    """Return double-word numbers (1, c) as (c, 1)."""
    return row[0][0, :, None], row[1][0, :, None]


def _apply(matrices: Pair, vectors: Pair) -> Pair:
    """Multiply double-word matrices, turned, (c, matrices, r, 1) with double-word vectors (c, N)."""
    return _total(rounding.dd_mul(matrices, (vectors[0][:, None, None], vectors[1][:, None, None])))


def _recorded(rules: _Rules, given: _Given) -> tuple[Array, ...]:
    """Return (x, u, y, theta, noise, w, v, parameters) of recordings (N, T, .): by NumPy but for the
    trajectory, or inside jit.
    """
    u, v, bounds = given.u, given.v, given.bounds
    theta, noise, w, parameters, extra = _unknowns(rules, given)
    if rules.places:
        within = bounds["noise"], bounds["lo"], bounds["hi"]
        noise, w = kept_averages(rules.places, bounds["averages"], noise, w, within)
    applied = _with_faults(rules, given, u, np.zeros(u.shape, u.dtype), extra, measured=False)
    along = tuple(_recordings_last(x) for x in (applied, w, v, theta, noise, parameters))
    states, outputs = _trajectory(given.numbers, given.x0.T, along)
    y = _with_faults(rules, given, _recordings_first(outputs), noise, extra, measured=True)
    return _recordings_first(states), u, y, theta, noise, w, v, parameters


_recorded_within = partial(jax.jit, static_argnums=0)(_recorded)


def _recordings_last(x: Array) -> Array:
    """Return (N, T, c) as (T, c, N): recordings fill a vector."""
    moved: Array = _library(x).moveaxis(x, 0, 2)
    return moved


def _recordings_first(x: jax.Array) -> Array:
    """Return (T, c, N) as (N, T, c), on the host unless inside jit."""
    if isinstance(x, jax.core.Tracer):
        return jnp.moveaxis(x, 2, 0)
    return np.moveaxis(np.asarray(x), 2, 0)


@jax.jit
def _trajectory(numbers: _PlantNumbers, x0: Array, along: tuple[Array, ...]) -> tuple[jax.Array, jax.Array]:
    """Return states (T, n, N) and outputs (T, p, N) from first states (n, N) and what acts (T, ., N): one
    program for every fault.
    """
    # in a kernel all of these are traced
    matrices, level_u, level_y = cast(
        "tuple[Pair, Pair, Pair]", (numbers["matrices"], numbers["offset_u"], numbers["offset_y"])
    )
    start, acting = cast("tuple[jax.Array, tuple[jax.Array, ...]]", (x0, along))
    offset_u, offset_y = _column(level_u), _column(level_y)
    n = len(start)

    def step(x: Pair, now: tuple[jax.Array, ...]) -> tuple[Pair, tuple[jax.Array, jax.Array]]:
        inputs, w, v, theta, noise, parameters = now
        deviation = rounding.dd_add(rounding.two_sum(inputs, -offset_u[0]), _single(-offset_u[1]))
        high, low = zip(x, deviation, _single(w), _single(v), strict=True)
        signals = jnp.concatenate(high), jnp.concatenate(low)
        both = _apply(matrices, signals)  # of the model, and of what each parameter moves
        rows = _at(both, 0)
        if len(parameters):
            moved = rounding.dd_mul(_single(parameters[:, None]), _at(both, slice(1, None)))
            rows = rounding.dd_add(rows, _total(moved))
        after, true = _at(rows, slice(n)), _at(rows, slice(n, None))
        # not (1 + theta) t: XLA turns (theta + 1) - 1 into theta
        y = rounding.dd_add(true, rounding.dd_mul(_single(theta), true))
        y = rounding.dd_add(rounding.dd_add(y, _single(noise)), offset_y)
        return after, (x[0], y[0])

    return jax.lax.scan(step, _single(start), acting)[1]


def _unknowns(rules: _Rules, given: _Given) -> tuple[Array, Array, Array, Array, Array]:
    """Draw theta, noise, disturbances, parameters and the noise of faults of recordings."""
    bounds = given.bounds
    draws: dict[int, Array] = dict(zip(rules.streams, given.draws, strict=True))
    (count, T, _), p = given.u.shape, bounds["noise"].shape[-1]
    xp = _library(given.u, *draws.values())

    def drawn(stream: int, width: int) -> Array:
        """Return draws (N, T, width) in [-1, 1); zeros where a stream has none."""
        if stream not in draws:
            nothing: Array = xp.zeros((count, T, width), given.u.dtype)
            return nothing
        return draws[stream][:, : T * width].reshape(count, T, width)

    def extreme(x: Array) -> Array:
        """Return draws, each moved to one of its ends where that is asked for."""
        if not rules.vertices:
            return x
        signs: Array = xp.where(x < 0, -1, 1).astype(x.dtype)
        return signs

    signs = extreme(drawn(THETA, p))
    if rules.constant:
        signs = signs[:, :1]
    tolerance = xp.broadcast_to(bounds["tolerance"], (1, T, p))
    for channel, size, on in zip(rules.channels, given.sizes, given.active, strict=True):
        if channel.kind == "tolerance":
            here = on[:, :, None] & (np.arange(p) == channel.output)
            tolerance = xp.where(here, size[:, :, None], tolerance)
    lo, hi = bounds["lo"][None, None], xp.maximum(bounds["lo"], bounds["hi"])[None, None]
    share = extreme(drawn(DISTURBANCE, lo.shape[2]))
    w = xp.where(share == 1, hi, xp.clip(lo + 0.5 * (share + 1) * (hi - lo), lo, hi))
    # a parameter that keeps its value has that of the first sample
    each = extreme(drawn(PARAMETER, len(bounds["varying"])))
    parameters = xp.where(bounds["varying"][None, None], each, each[:, :1])
    extra = drawn(FAULT_NOISE, len(rules.channels))
    largest = bounds["noise"]
    if largest.ndim == 1:  # else one for each sample
        largest = largest[None, None]
    noise = largest * extreme(drawn(NOISE, p))
    return tolerance * signs, noise, w, parameters, extra


def _with_faults(
    rules: _Rules, given: _Given, signals: Array, errors: Array, extra: Array, measured: bool
) -> Array:
    """Apply faults, in order, to signals (N, T, c): to outputs, if they are measured, or to inputs.

    Args:
        errors: (N, T, c), what a gain does not multiply. extra: (N, T, faults), the noise of faults.
    """
    xp = _library(signals, extra)
    for i, (channel, size, on) in enumerate(zip(rules.channels, given.sizes, given.active, strict=True)):
        c = channel.output if measured else channel.input
        if c is None or channel.kind == "tolerance":
            continue
        x, error = signals[:, :, c], errors[:, :, c]
        if channel.kind == "dropout":
            changed = xp.full_like(x, np.nan if measured else 0.0)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                changed = _changed(channel.kind, x, error, size, on, extra[:, :, i])
        here = on[:, :, None] & (np.arange(signals.shape[2]) == c)
        signals = xp.where(here, changed[:, :, None], signals)
    return signals


def _changed(kind: str, x: Array, error: Array, size: Array, on: Array, extra: Array) -> Array:
    """Return one signal (N, T) with its fault, as `models.named_faults` defines it; error: its noise."""
    xp = _library(x, on, extra)
    if kind == "stuck":
        # what a sensor showed at the onset is what it goes on showing
        onset = xp.broadcast_to(xp.argmax(on, 1)[:, None], (len(x), 1))
        changed: Array = xp.broadcast_to(xp.take_along_axis(x, onset, 1), x.shape)
    elif kind == "gain":
        # a gain is one of the true value: the noise on top of it is not multiplied
        changed = x + size * (x - error)
    elif kind == "bias":
        changed = x + size
    elif kind == "drift":
        changed = x + size * (xp.cumsum(on, 1) - 1).astype(x.dtype)
    else:
        changed = x + size * extra
    return changed
