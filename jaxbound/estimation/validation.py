"""Data validation: where can the state be, which sensor does not fit, and what should it have said?

Every window is an interval linear system in its states (`models.intervals.stacked`). The states found so far,
propagated by the model, are a box; the newest samples are tested against it one by one and together; a sensor
that does not fit is left out from there on, and the interval that the state gives for its output stands in
for it.

What is promised: if the first window is fault-free (or x0 holds), the parameters are within bounds and every
faulty sample was found, the true state is inside. A fault too small to be proved is accepted, and may move
the enclosure past the true state. Nobody can promise more. In the first window the newest samples are tested
against its older ones; a fault in these is taken for the truth, until what comes contradicts it: then the
recording is marked FAULT, but sound sensors may be blamed.

Source: Alhaj-Dibo, Maquin, Ragot 2004.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.multiple import validate_parts
from jaxbound.estimation.validation_windows import Said, begun, said, slide, weighted
from jaxbound.models.intervals import as_intervals, stacked
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.sensor import largest_error
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import around
from jaxbound.recordings.signals import Signals
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.linear_systems.ends import ends, interval_of
from jaxbound.sets.linear_systems.fixed_systems import prepare
from jaxbound.text.objects import readable

__all__ = ["Validation", "nothing_said", "prepared", "validate"]

PIECE, AGAIN = 256, 8
"""Samples that are validated outside XLA from a FAULT on, and how often in a recording."""
BLOCK = {"joint": 32, "sequential": 512}
"""Recordings side by side: linear programs of a block go on until the last is solved."""


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Validation:
    """The states, outputs and verdicts of `validate`, time first: entry k comes from the window that ends at
    k.

    Fields: state Interval (..., T, n). output Interval (..., T, p): what a perfect sensor would show.
    residual Interval (..., T, p): the sample minus what the samples before it allow. faulty (..., T, p) bool:
    sensors whose residual excludes 0, that contradict the samples before them in a sharper test, or without
    which alone a contradiction of all sensors ends. corrected Interval (..., T, p): `output`, where a sample
    was accepted also within what it says; corrected.mid is the point value. status (..., T) int8, see
    `Status`: FAULT is a proof that not all samples of the window fit the model, those before being as
    accepted (if nobody is to blame, its newest samples are left out); UNDECIDED: nothing was proved; MISSING:
    no sample, and the first s. CONSISTENT is never said: it would need a behaviour from the first sample on
    that explains all, and an enclosure holds points that none reaches. `detect` proves it, window by window.
    """

    state: Interval
    output: Interval
    residual: Interval
    faulty: jax.Array | np.ndarray
    corrected: Interval
    status: jax.Array | np.ndarray

    @property
    def margin(self) -> np.ndarray:
        """(..., T), NaN: validation measures none."""
        return np.full(np.shape(self.status), np.nan)


def validate(
    model: Any,
    u: Any,
    y: Any = None,
    horizon: int | None = None,
    method: str = "joint",
    x0: Interval | None = None,
    correction: str = "interval",
    starts: ArrayLike = (),
) -> Validation:
    """Enclose the state over time, find the sensor that does not fit, and say what it should have shown.

    Args:
        model: `interval_system(...)`, a LinearSystem (uncertain parameters, tolerance, noise, disturbance; no
            unknown inputs), or a MultiModel (its .state holds the states of all sub-models; joint only,
            unless its partial outputs are measured).
        u: (..., T, m) or None. y: (..., T, p), or (..., T, L, p) for the partial outputs of a MultiModel;
            NaN: that sample is absent. Recordings on leading axes run side by side. Tables as for `detect`;
                partial outputs are called like "1.y1", "2.y1" there.
        horizon: s of windows of s + 1 samples; None: the smallest with s >= n / p and p (s + 1) > n.
        method: "joint": the newest samples, the older ones and the propagated state at once, by the hull of
            their linear programs. "sequential": the paper's square systems, one for each further row, against
            a reference; wider, faster.
        x0: Interval (..., n) that holds the first state. None: the first window is taken to be fault-free,
            and must be complete.
        correction: what stands in for a faulty sample. "interval": all that the state allows there. "centre":
            the middle of it, as if it had been measured; the paper's, and not a proof: the true state may be
            outside, `faulty` is a suspicion, and nothing is FAULT.
        starts: as for `detect`. What comes behind a gap is a recording of its own: it begins with its first
            complete window, taken to be fault-free; x0 is that of the first.

    Returns:
        A Validation.

    Encloses: every state of every behaviour within the bounds that gives the samples accepted as sound,
    rounding included; nothing with correction="centre".

    Raises:
        ValueError: shapes that do not fit, a first window that does not bound the state, an unknown method.
            TypeError: no model.

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
    if isinstance(model, MultiModel) and model.partial:
        options: dict[str, Any] = dict(horizon=horizon, method=method, correction=correction)
        return validate_parts(model, u, y, x0, partial(validate, **options), starts)
    signals, slides = prepared(model, horizon, method, correction)
    given = Recording.of(signals, u, y, starts, narrow=False)
    u, y, s, n = np.asarray(given.u), np.asarray(given.y, slides.m.A.dtype), slides.s, slides.m.n
    run = partial(slides, recorded=given.y.dtype)
    T = y.shape[-2]
    left_out = (
        (np.isnan(u).any(-1) & np.isnan(y).all(-1)).reshape(-1, T).all(0)
    )  # nothing is known there: like a gap
    left_out |= False if given.excluded is None else given.excluded
    seams = np.union1d(given.starts, around(left_out)) if left_out.any() else given.starts
    if not np.isfinite(u[..., ~left_out, :]).all():
        gone = (~np.isfinite(u[..., ~left_out, :])).sum()
        raise ValueError(f"validate needs every input: {gone} samples of u are missing or infinite")
    if np.isinf(y).any():
        raise ValueError(
            f"y must be numbers, or NaN where a sample is absent: {np.isinf(y).sum()} are infinite"
        )
    if T <= s:
        raise ValueError(f"horizon must be a whole number >= 1 with more samples than it ({T}), not {s!r}")
    gapless = not len(seams) or seams[0] > s
    if x0 is None and gapless and np.isnan(y[..., : s + 1, :]).any():
        raise ValueError(
            f"the first {s + 1} samples must be complete, or x0 must say where the first state is"
        )
    if not len(seams):
        return run(u, y, x0=x0)[0]
    return _piecewise(run, u, y, x0, seams, left_out, s, n)


def prepared(model: Any, horizon: int | None, method: str, correction: str) -> tuple[Any, "_Slide"]:
    """Return (the signals that are read, what validates them) of a model; the rest as for `validate`, which
    says what is refused.
    """
    several = isinstance(model, MultiModel)
    m = model.joined() if several else as_intervals(model)
    if method not in ("joint", "sequential"):
        raise ValueError(f"method must be 'joint' or 'sequential', not {method!r}")
    if correction not in ("interval", "centre"):
        raise ValueError(f"correction must be 'interval' or 'centre', not {correction!r}")
    if several and method == "sequential":
        raise ValueError("a MultiModel has another matrix in every window: use method='joint'")
    s = least_horizon(m.n, m.p) if horizon is None else horizon
    if isinstance(s, bool) or not isinstance(s, (int, np.integer)) or s < 1:
        raise ValueError(f"horizon must be a whole number >= 1, not {s!r}")
    if method == "sequential" and s * m.p < m.n:
        raise ValueError(
            f"the square systems need a horizon of at least n / p ({-(-m.n // m.p)}), not {s}: see (9) of "
            f"the paper"
        )
    signals = model if hasattr(model, "columns") and not several else Signals(m.inputs, m.outputs, {})
    return signals, _Slide(model if several else None, m, int(s), method, correction == "centre")


class _Slide:
    """Validates recordings side by side, without a gap. multiple: a MultiModel, or None; m: the
    IntervalSystem.
    """

    def __init__(self, multiple, m, s, method, centre):
        self.multiple, self.m, self.s, self.method, self.centre = multiple, m, s, method, centre
        signals = {name: getattr(m, name) for name in "ABCDw"} | {
            "u0": m.offset["u"],
            "y0": m.offset["y"],
            "factor": _factor(m),
        }
        if m.moves and method == "joint":
            signals |= {"H": m.moves[2], "d": m.moves[3]}
        self.plant = {name: ends(x) for name, x in signals.items()}

    @cached_property
    def M(self):
        """The rows of a window, see `intervals.stacked`."""
        M = stacked(self.m, self.s, self.m.moves if self.method == "joint" else None)
        return jax.tree.map(lambda a: np.asarray(a)[..., None], M)

    @cached_property
    def systems(self):
        """The square systems of the sequential method, or None."""
        return (
            prepare(self.M, self.m.p * (self.s + 1) - self.m.n + 1) if self.method == "sequential" else None
        )

    def __call__(self, u, y, recorded, x0=None, before=None, earlier=None):
        """Return (Validation, carry) of `judged`, with UNDECIDED for each FAULT that is not seen again
        outside XLA.

        Searches for bounds end elsewhere where numbers are rounded otherwise: that FAULT samples in a row
        begin with one that NumPy sees, or that it sees one among those before, is enough, and where it sees
        none nothing is warned of.
        """
        result, after = self.judged(u, y, recorded, x0, before, earlier)
        faulty = np.asarray(result.status) == Status.FAULT
        if is_outside_xla() or not faulty.any():
            return result, after
        seen = faulty & self._seen_again(u, y, recorded, x0, before, earlier, faulty)
        place = np.arange(faulty.shape[-1])
        begins = faulty & ~np.concatenate([np.zeros_like(faulty[..., :1]), faulty[..., :-1]], -1)
        latest = lambda which: np.maximum.accumulate(np.where(which, place, -1), -1)
        proved = faulty & (latest(seen) >= latest(begins))
        status = np.where(faulty & ~proved, np.int8(Status.UNDECIDED), result.status)
        blamed = np.asarray(result.faulty) & proved[..., None]
        return replace(result, status=jnp.asarray(status), faulty=jnp.asarray(blamed)), after

    def _seen_again(self, u, y, recorded, x0, before, earlier, faulty):
        """Return which samples are FAULT where this is worked out again.

        Outside XLA are `PIECE` samples from a FAULT on, then from the next one behind them, `AGAIN` times at
        most. What comes before each is judged by XLA, by the program that is compiled.
        """
        s, T, seen, stop = self.s, y.shape[-2], faulty.copy(), 0
        some = faulty.reshape(-1, T).any(0)
        for _ in range(AGAIN):
            if not some[stop:].any():
                break
            first = stop + int(some[stop:].argmax())
            first = 0 if first < PIECE else first  # from the beginning, where that is near
            stop = min(max(first, s) + PIECE, T)
            begin, known, start, carry = 0, earlier, x0, before
            if first:
                _, carry = self.judged(u, y, recorded, x0, before, earlier, upto=first)
                begin, start = first - s, None
                past = (
                    y[..., :begin, :] if earlier is None else np.concatenate([earlier, y[..., :begin, :]], -2)
                )
                known = past[..., -s:, :]
            with outside_xla():
                piece, _ = self.judged(
                    u[..., begin:stop, :], y[..., begin:stop, :], recorded, start, carry, known
                )
            seen[..., first:stop] = np.asarray(piece.status)[..., first - begin :] == Status.FAULT
        return seen

    def judged(self, u, y, recorded, x0=None, before=None, earlier=None, upto=None):
        """Return (Validation, what goes on from here) of u (..., T, m), y (..., T, p) in the type of the
        model.

        Args:
            recorded: the float type in which y was rounded.
            before: what this returned, to go on: then the first s samples are those before the new ones.
                earlier: y of the s before these, which say how large samples get in the windows of the first.
            upto: what goes on is from behind so many samples, and what is found of others means nothing;
                None: from behind all.
        """
        m, s, dtype = self.m, self.s, y.dtype
        *lead, T, _ = y.shape
        count = int(np.prod(lead))
        if x0 is not None:
            x0 = interval(x0)
            if x0.shape[-1:] != (m.n,):
                raise ValueError(f"x0 needs one interval for each of {m.n} states: its shape is {x0.shape}")
            x0 = Interval(rounding.round_down(x0.lo, dtype), rounding.round_up(x0.hi, dtype))
            x0 = ends(jax.tree.map(lambda a: np.broadcast_to(a, (*lead, m.n)), x0), -2)
        known = y if earlier is None else np.concatenate([earlier, y], -2)
        error = largest_error(known, m.noise, recorded, s)[..., known.shape[-2] - T :, :]
        pushed = ends(
            Interval(rounding.round_down(u, dtype), rounding.round_up(u, dtype)), -3
        )  # a point, unless it had to be narrowed
        weight = ends(self.multiple.columns(u.astype(dtype)), -3) if self.multiple else None
        flat = lambda a: None if a is None else a.reshape(count, *a.shape[len(lead) :])
        given = (*(flat(_filled_up(a)) for a in (pushed, y, error, weight)), flat(x0), before)
        shared = self.systems
        if self.method == "joint" and x0 is None and before is None and not self.multiple:
            shared = _first_window(self.M, m.p)
        M = jnp.asarray(ends(self.M))

        def kernel(u, y, error, weight, start, carry):
            known, systems = said(self.plant, u, y, error), shared
            if carry is None:
                if self.multiple and start is None:
                    systems = _first_window(
                        interval_of(np.asarray(weighted(M, weight[:, : s + 1], m.p))), m.p
                    )
                first = Said(
                    *(
                        jnp.asarray(
                            np.asarray(a)[: s + 1] if a is known.absent else np.asarray(a)[:, : s + 1]
                        )
                        for a in known
                    )
                )
                carry = begun(self.plant, systems, first, start, s, m.n, self.method, self.centre)
            return slide(
                self.plant,
                M,
                self.systems,
                known,
                weight,
                carry,
                T if upto is None else upto,
                s,
                self.method,
                self.centre,
            )

        after, found, blamed = _blocks(kernel, given, count, min(BLOCK[self.method], power(count)))
        found, wrong = (a[:, :T].reshape(*lead, T, *a.shape[2:]) for a in (found, blamed))
        parts = np.split(found, np.cumsum([m.n, m.p, m.p]), -1)
        state, output, residual, corrected = (Interval(-a[..., 0, :], a[..., 1, :]) for a in parts)
        bounded = np.isfinite(found[..., s, :, : m.n]).all((-1, -2))
        if not bounded.all():
            raise ValueError(
                f"{(~bounded).sum()} of {count} first windows do not bound the state: give x0, or a longer "
                f"horizon"
            )
        absent = np.isnan(y)
        for end in (residual.lo, residual.hi):
            end[..., s:, :][absent[..., s:, :]] = np.nan
        status = np.where(wrong[..., m.p] & (not self.centre), Status.FAULT, Status.UNDECIDED)
        status = np.where(absent.all(-1) & (status != Status.FAULT), Status.MISSING, status).astype(np.int8)
        status[..., :s] = Status.MISSING
        result = Validation(state, output, residual, wrong[..., : m.p], corrected, status)
        return jax.tree.map(jnp.asarray, result), after


def _factor(m):
    """Return 1 / (1 + theta) for the relative errors of the sensors."""
    theta = [Fraction(v) for v in rounding.round_up(m.tolerance, m.A.dtype).tolist()]
    return Interval(
        *(
            f(np.array([1 / (1 + sign * v) for v in theta], object), m.A.dtype)
            for f, sign in ((rounding.round_down, 1), (rounding.round_up, -1))
        )
    )


def _filled_up(a):
    """Return samples (..., T, .) and as many zeros behind that few lengths are compiled."""
    if a is None:
        return None
    more = max(16, power(a.shape[-2])) - a.shape[-2]
    return np.concatenate([a, np.zeros((*a.shape[:-2], more, a.shape[-1]), a.dtype)], -2)


def nothing_said(shape: tuple[int, ...], n: int, p: int, dtype: np.dtype) -> Validation:
    """Return a Validation of samples (*shape) of which nothing is known: every interval is entire."""
    entire = lambda size: Interval(
        np.full((*shape, size), -np.inf, dtype), np.full((*shape, size), np.inf, dtype)
    )
    return Validation(
        entire(n),
        entire(p),
        entire(p),
        np.zeros((*shape, p), bool),
        entire(p),
        np.full(shape, Status.MISSING, np.int8),
    )


def _piecewise(run, u, y, x0, starts, left_out, s, n):
    """Validate each piece between gaps as a recording of its own; elsewhere every interval is entire.

    Pieces are filled up behind their end to few lengths, with absent samples: few compilations, and no sample
    tells of those before it.
    """
    batch, (T, p) = y.shape[:-2], y.shape[-2:]
    whole = (~np.isnan(y)).all(-1).reshape(-1, T).all(0)
    groups: dict[tuple, list] = {}
    for a, b in zip([0, *starts.tolist()], [*starts.tolist(), T], strict=True):
        if a == b or left_out[a]:
            continue
        known = x0 is not None and a == 0
        complete = (
            np.convolve(whole[a:b], np.ones(s + 1, int), "valid") == s + 1 if b - a > s else np.zeros(0, bool)
        )
        if known and b - a > s or complete.any():
            begin = a if known else a + int(complete.argmax())
            groups.setdefault((known, max(16, power(b - begin))), []).append((begin, b))
    if not groups:
        raise ValueError(
            f"no stretch of {s + 1} complete samples in a row: the windows reach across gaps, or samples are "
            f"missing in all"
        )
    out = nothing_said((*batch, T), n, p, y.dtype)
    for (known, length), pieces in groups.items():
        rows = np.minimum(
            np.array([a for a, _ in pieces])[:, None] + np.arange(length),
            np.array([b for _, b in pieces])[:, None] - 1,
        )
        behind = np.arange(length) >= np.array([b - a for a, b in pieces])[:, None]
        take = lambda x, rows=rows: np.moveaxis(x[..., rows, :], -3, 0)
        some = np.where(behind.reshape(len(pieces), *[1] * len(batch), length, 1), np.nan, take(y)).astype(
            y.dtype
        )
        found, _ = run(take(u), some, x0=x0 if known else None)
        for to, value in zip(jax.tree.leaves(out), jax.tree.leaves(found), strict=True):
            for i, (a, b) in enumerate(pieces):
                at = (*[slice(None)] * len(batch), slice(a, b))
                to[at] = np.asarray(value[i])[(*[slice(None)] * len(batch), slice(0, b - a))]
    return jax.tree.map(jnp.asarray, out)


def least_horizon(n: int, p: int) -> int:
    """Return the smallest s with s >= n / p and p (s + 1) > n, for n states and p outputs. Source: (9) of the
    paper, section 2.
    """
    s = max(-(-n // p), 1)
    return s + (p * (s + 1) <= n)


def _first_window(M, p):
    """Prepare the rows of the first window as one system, without the newest samples if that will do: so
    these can be tested against it.
    """
    if M.shape[0] - p >= M.shape[1]:
        older = prepare(jax.tree.map(lambda a: a[:-p], M))
        if np.isfinite(older.scale.lo).all():
            return older
    return prepare(M)


def _blocks(kernel, given, count, size):
    """Run a kernel on blocks. What is given and returned has recordings on its first axis, the kernel has
    them on the last.
    """

    def block(chosen):
        found = kernel(*jax.tree.map(lambda a: np.moveaxis(a[chosen], 0, -1), given))
        return jax.tree.map(lambda a: np.moveaxis(np.asarray(a), -1, 0), found)

    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *in_blocks(block, count, size))
