"""Data validation: where can the state be, which sensor does not fit, and what should it have said?

Every window is an interval linear system in its states (`models.intervals.stacked`). The states found so far, propagated by the model,
are a box; the newest samples are tested against it one by one and together; a sensor that does not fit is left out from there on, and the
interval that the state gives for its output stands in for it.

What is promised: if the first window is fault-free (or x0 holds), the parameters are within bounds and every faulty sample was found, the
true state is inside. A fault too small to be proved is accepted, and may move the enclosure past the true state. Nobody can promise more.
In the first window the newest samples are tested against its older ones; a fault in these is taken for the truth, until what comes
contradicts it: then the recording is marked FAULT, but sound sensors may be blamed.

Source: Alhaj-Dibo, Maquin, Ragot 2004.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.diagnosis.multiple import validate_parts
from jaxbound.diagnosis.validation_windows import slide, weighted
from jaxbound.models import recording
from jaxbound.models.intervals import as_intervals, stacked
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.sensor import largest_error
from jaxbound.sets import rounding
from jaxbound.sets.fixed_systems import prepare
from jaxbound.sets.interval import Interval, interval
from jaxbound.sets.probe import refuse_unverified

__all__ = ["Validation", "validate"]

BLOCK = {"joint": 32, "sequential": 512}
"""Recordings side by side: linear programs of a block go on until the last is solved."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Validation:
    """What `validate` found, time first: entry k comes from the window that ends at sample k.

    Fields: state Interval (..., T, n). output Interval (..., T, p): what a perfect sensor would show. residual Interval (..., T, p): the
    sample minus what the samples before it allow. faulty (..., T, p) bool: sensors whose residual excludes 0, that contradict the samples
    before them in a sharper test, or without which alone a contradiction of all sensors ends. corrected Interval (..., T, p): `output`,
    where a sample was accepted also within what it says; corrected.mid is the point value. status (..., T) int8, see `Status`: FAULT is
    a proof that not all samples of the window fit the model, those before being as accepted (if nobody is to blame, its newest samples
    are left out); UNDECIDED: nothing was proved; MISSING: no sample, and the first s. CONSISTENT is never said: it would need a behaviour
    from the first sample on that explains all, and an enclosure holds points that none reaches. `detect` proves it, window by window.
    """

    state: Interval
    output: Interval
    residual: Interval
    faulty: jax.Array
    corrected: Interval
    status: jax.Array


def validate(model, u, y, horizon=None, method="joint", x0=None, correction="interval"):
    """Enclose the state over time, find the sensor that does not fit, and say what it should have shown.

    Args:
        model: `interval_system(...)`, a LinearSystem (uncertain parameters, tolerance, noise, disturbance; no unknown inputs), or a
            MultiModel (its .state holds the states of all sub-models; joint only, unless its partial outputs are measured).
        u: (..., T, m) or None. y: (..., T, p), or (..., T, L, p) for the partial outputs of a MultiModel; NaN: that sample is absent.
            Recordings on leading axes run side by side.
        horizon: s of windows of s + 1 samples; None: the smallest with s >= n / p and p (s + 1) > n.
        method: "joint": the newest samples, the older ones and the propagated state at once, by the hull of their linear programs.
            "sequential": the paper's square systems, one for each further row, against a reference; wider, faster.
        x0: Interval (..., n) that holds the first state. None: the first window is taken to be fault-free, and must be complete.
        correction: what stands in for a faulty sample. "interval": all that the state allows there. "centre": the middle of it, as if it
            had been measured; the paper's, and not a proof: the true state may be outside, `faulty` is a suspicion, and nothing is FAULT.

    Returns:
        A Validation.

    Encloses: every state of every behaviour within the bounds that gives the samples accepted as sound, rounding included; nothing with
    correction="centre".

    Raises:
        ValueError: shapes that do not fit, a first window that does not bound the state, an unknown method. TypeError: no model.

    Source: Alhaj-Dibo, Maquin, Ragot 2004, (6)-(11).

    Example:
        >>> from jaxbound import interval_system
        >>> m = interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)
        >>> y = np.tile(10 - 9 * 0.9 ** np.arange(8)[:, None], 2)
        >>> y[5, 1] += 2
        >>> validate(m, np.ones((8, 1)), y).faulty[5].tolist()
        [False, True]
    """
    refuse_unverified()
    several = isinstance(model, MultiModel)
    if several and model.partial:
        return validate_parts(model, u, y, x0, partial(validate, horizon=horizon, method=method, correction=correction))
    m = model.joined() if several else as_intervals(model)
    if method not in ("joint", "sequential"):
        raise ValueError(f"method must be 'joint' or 'sequential', not {method!r}")
    if correction not in ("interval", "centre"):
        raise ValueError(f"correction must be 'interval' or 'centre', not {correction!r}")
    recorded = recording.recorded_type(y, "y")
    y = np.asarray(y, m.A.dtype)
    if y.ndim < 2 or y.shape[-1] != m.p:
        raise ValueError(f"y must have shape (..., T, {m.p}), time before outputs: its shape is {y.shape}")
    *lead, T, _ = y.shape
    u = np.zeros((*y.shape[:-1], 0), y.dtype) if u is None else np.asarray(u)
    u = u if np.issubdtype(u.dtype, np.floating) else u.astype(np.float64)
    if u.shape[-1:] != (m.m,) or u.shape[:-1] != y.shape[:-1]:
        raise ValueError(f"u must have shape {(*y.shape[:-1], m.m)} to fit y and the model: its shape is {u.shape}")
    if not np.isfinite(u).all():
        raise ValueError(f"validate needs every input: {(~np.isfinite(u)).sum()} samples of u are missing or infinite")
    if np.isinf(y).any():
        raise ValueError(f"y must be numbers, or NaN where a sample is absent: {np.isinf(y).sum()} are infinite")
    s = least_horizon(m.n, m.p) if horizon is None else horizon
    if several and method == "sequential":
        raise ValueError("a MultiModel has another matrix in every window: use method='joint'")
    if not isinstance(s, (int, np.integer)) or s < 1 or T <= s:
        raise ValueError(f"horizon must be a whole number >= 1 with more samples than it ({T}), not {s!r}")
    if x0 is None and np.isnan(y[..., : s + 1, :]).any():
        raise ValueError(f"the first {s + 1} samples must be complete, or x0 must say where the first state is")
    if method == "sequential" and s * m.p < m.n:
        raise ValueError(f"the square systems need a horizon of at least n / p ({-(-m.n // m.p)}), not {s}: see (9) of the paper")
    count = int(np.prod(lead))
    flat = lambda a: None if a is None else jax.tree.map(lambda v: np.asarray(v).reshape(count, *v.shape[len(lead) :]), a)
    if x0 is not None:
        x0 = interval(x0)
        if x0.shape[-1:] != (m.n,):
            raise ValueError(f"x0 needs one interval for each of {m.n} states: its shape is {x0.shape}")
        x0 = jax.tree.map(lambda a: np.broadcast_to(np.asarray(a, y.dtype), (*lead, m.n)), x0)
    plant = {name: getattr(m, name) for name in "ABCDw"} | {"u0": m.offset["u"], "y0": m.offset["y"]}
    if m.moves and method == "joint":
        plant |= {"H": m.moves[2], "d": m.moves[3]}
    plant |= {"tolerance": rounding.round_up(m.tolerance, y.dtype)}
    error = largest_error(y, m.noise, recorded, int(s))
    pushed = Interval(rounding.round_down(u, y.dtype), rounding.round_up(u, y.dtype))  # a point, unless it had to be narrowed
    u = u.astype(y.dtype)
    M = stacked(m, int(s), m.moves if method == "joint" else None)
    given = flat(pushed), flat(y), flat(error), flat(model.columns(u) if several else None), flat(x0)
    shared = None
    if method == "sequential":
        shared = prepare(M[..., None], m.p * (s + 1) - m.n + 1)
    elif x0 is None and not several:
        shared = _first_window(M[..., None], m.p)

    def kernel(u, y, error, weight, start):
        systems = shared
        if several and start is None:
            early = jax.tree.map(lambda a: np.moveaxis(a[:, : s + 1], 0, -1), weight)
            systems = _first_window(weighted(M[..., None], early, m.p), m.p)
        return slide(plant, M, systems, u, y, error, weight, start, int(s), method, correction == "centre")

    found, bounded = _blocks(kernel, given, count, min(BLOCK[method], 1 << (count - 1).bit_length()))
    if not bounded.all():
        raise ValueError(f"{(~bounded).sum()} of {count} first windows do not bound the state: give x0, or a longer horizon")
    state, output, residual, corrected, faulty, status = jax.tree.map(lambda a: jnp.asarray(a.reshape(*lead, *a.shape[1:])), found)
    return Validation(state, output, residual, faulty, corrected, status)


def least_horizon(n, p):
    """Return the smallest s with s >= n / p and p (s + 1) > n, for n states and p outputs. Source: (9) of the paper, section 2."""
    s = max(-(-n // p), 1)
    return s + (p * (s + 1) <= n)


def _first_window(M, p):
    """Prepare the rows of the first window as one system, without the newest samples if that will do: so these can be tested against it."""
    if M.shape[0] - p >= M.shape[1]:
        older = prepare(M[:-p])
        if np.isfinite(older.scale.lo).all():
            return older
    return prepare(M)


def _blocks(kernel, given, count, size):
    """Run blocks of one size, on all cores: what a block works on stays in the cache, and another number of recordings traces nothing."""

    def block(first):
        chosen = np.minimum(np.arange(first, first + size), count - 1)
        found = jax.tree.map(np.asarray, kernel(*jax.tree.map(lambda a: a[chosen], given)))
        return jax.tree.map(lambda a: a[: count - first], found)

    done = [block(0)]  # compiled here, once
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # compiled code runs outside the interpreter's lock
        done += threads.map(block, range(size, count, size))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *done) if len(done) > 1 else done[0]
