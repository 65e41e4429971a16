"""Validation of recordings side by side without a gap: blocks for the kernels of `validation_windows`, and a
second decision of each FAULT outside XLA.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.validation_result import Validation
from jaxbound.estimation.validation_windows import (
    Signalled,
    ValidationCarry,
    begun,
    signalled,
    slide,
    weighted,
)
from jaxbound.models.intervals import IntervalSystem, stacked
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.sensor import largest_error
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.linear_systems.ends import ends, interval_of
from jaxbound.sets.linear_systems.fixed_systems import Prepared, prepare

__all__ = ["HostCarry", "Slide", "Stretch", "compiled_length"]

PIECE, AGAIN = 256, 8
"""Samples that are validated outside XLA from a FAULT on, and how often in a recording."""
BLOCK = {"joint": 32, "sequential": 512}
"""Recordings side by side: linear programs of a block go on until the last is solved."""
SHORTEST = 16
"""Samples that a kernel is compiled for, at least."""


HostCarry: TypeAlias = ValidationCarry[np.ndarray]
"""The carry between kernels, recordings on the first axis."""


class Stretch(NamedTuple):
    """Samples that follow each other, and what is known before them.

    Fields: u (..., T, m), y (..., T, p) in the type of the model; recorded: the float type in which y was
    rounded; x0: Interval (..., n) of the first state, or None; before: the carry of the windows before, or
    None: with it the first s samples are those before the new ones; earlier: y of the s before these, which
    say how large samples get in the windows of the first, or None.
    """

    u: np.ndarray
    y: np.ndarray
    recorded: np.dtype
    x0: Interval | None = None
    before: HostCarry | None = None
    earlier: np.ndarray | None = None

    @property
    def outputs(self) -> np.ndarray:
        """Outputs with those before them."""
        if self.earlier is None:
            return self.y
        return np.concatenate([self.earlier, self.y], -2)


class _Samples(NamedTuple):
    """The arrays of recordings that kernels take, recordings first on the host, last in a block.

    Fields: ends (N, 2, T, .) of inputs; y, error (N, T, p); weight: of columns, or None; start: ends (N, 2,
    n) of the first state, or None; before: see Stretch.
    """

    u: np.ndarray
    y: np.ndarray
    error: np.ndarray
    weight: np.ndarray | None
    start: np.ndarray | None
    before: HostCarry | None


_Slid: TypeAlias = tuple[HostCarry, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Slide:
    """The validation of one plant, for stretches of recordings.

    Fields: several: a MultiModel, or None; m: the IntervalSystem; s: windows have s + 1 samples; method,
    centre: as of `validate`.
    """

    several: MultiModel | None
    m: IntervalSystem
    s: int
    method: str
    centre: bool

    @cached_property
    def plant(self) -> dict[str, np.ndarray]:
        """The ends of the model, as kernels take them."""
        m = self.m
        signals = {"A": m.A, "B": m.B, "C": m.C, "D": m.D, "w": m.w}
        signals |= {"u0": m.offset["u"], "y0": m.offset["y"], "factor": _sensor_factor(m)}
        if m.moves is not None and self.method == "joint":
            signals |= {"H": m.moves[2], "d": m.moves[3]}
        return {name: ends(x) for name, x in signals.items()}

    @cached_property
    def M(self) -> Interval:
        """The rows of a window, see `intervals.stacked`."""
        moves = None
        if self.method == "joint":
            moves = self.m.moves
        rows: Interval = jax.tree.map(lambda a: np.asarray(a)[..., None], stacked(self.m, self.s, moves))
        return rows

    @cached_property
    def systems(self) -> Prepared | None:
        """The square systems of the sequential method, or None."""
        if self.method != "sequential":
            return None
        return prepare(self.M, self.m.p * (self.s + 1) - self.m.n + 1)

    def __call__(self, stretch: Stretch) -> tuple[Validation, HostCarry]:
        """Return (Validation, carry) of a stretch, with UNDECIDED for each FAULT that is not seen again
        outside XLA.

        Searches for bounds end elsewhere where numbers are rounded otherwise: that FAULT samples in a row
        begin with one that NumPy sees, or that it sees one among those before, is enough, and where it sees
        none nothing is warned of.
        """
        result, after = self._by_kernels(stretch)
        fault = np.asarray(result.status) == Status.FAULT
        if is_outside_xla() or not fault.any():
            return result, after
        seen_again = fault & self._seen_again(stretch, fault)
        begins = fault & ~np.concatenate([np.zeros_like(fault[..., :1]), fault[..., :-1]], -1)
        proved = fault & (_latest(seen_again) >= _latest(begins))
        status = np.where(fault & ~proved, np.int8(Status.UNDECIDED), result.status)
        blamed = np.asarray(result.faulty) & proved[..., None]
        return replace(result, status=jnp.asarray(status), faulty=jnp.asarray(blamed)), after

    def _seen_again(self, stretch: Stretch, fault: np.ndarray) -> np.ndarray:
        """Return the samples (..., T) that are FAULT where this is worked out again.

        Outside XLA are `PIECE` samples from a FAULT on, then from the next one behind them, `AGAIN` times at
        most. What comes before each is judged by XLA, by the program that is compiled.
        """
        T, again, stop = stretch.y.shape[-2], fault.copy(), 0
        anywhere: np.ndarray = np.any(fault.reshape(-1, T), 0)
        for _ in range(AGAIN):
            if not anywhere[stop:].any():
                break
            first = stop + int(anywhere[stop:].argmax())
            if first < PIECE:  # from the beginning, where that is near
                first = 0
            stop = min(max(first, self.s) + PIECE, T)
            begin, piece = self._piece(stretch, first, stop)
            with outside_xla():
                result, _ = self._by_kernels(piece)
            again[..., first:stop] = np.asarray(result.status)[..., first - begin :] == Status.FAULT
        return again

    def _piece(self, stretch: Stretch, first: int, stop: int) -> tuple[int, Stretch]:
        """Return (the number of its first sample, the stretch that ends with samples first .. stop - 1)."""
        if not first:
            return 0, stretch._replace(u=stretch.u[..., :stop, :], y=stretch.y[..., :stop, :])
        _, carry = self._by_kernels(stretch, upto=first)
        begin = first - self.s
        past = stretch._replace(y=stretch.y[..., :begin, :]).outputs
        piece = Stretch(
            stretch.u[..., begin:stop, :],
            stretch.y[..., begin:stop, :],
            stretch.recorded,
            before=carry,
            earlier=past[..., -self.s :, :],
        )
        return begin, piece

    def _by_kernels(self, stretch: Stretch, upto: int | None = None) -> tuple[Validation, HostCarry]:
        """Return (Validation, carry) of a stretch, each FAULT decided once.

        Args:
            upto: the carry is that behind so many samples, and what is found of others means nothing; None:
                behind all.
        """
        *lead, T, _ = stretch.y.shape
        count = int(np.prod(lead))
        stop = T
        if upto is not None:
            stop = upto
        shared = self.systems
        if self.method == "joint" and stretch.x0 is None and stretch.before is None and self.several is None:
            shared = _first_window(self.M, self.m.p)
        samples = self._samples(stretch, tuple(lead))
        size = min(BLOCK[self.method], power(count))

        def job(chosen: np.ndarray) -> _Slid:
            block = jax.tree.map(lambda a: np.moveaxis(a[chosen], 0, -1), samples)
            out = self._block(block, shared, stop)
            found: _Slid = jax.tree.map(lambda a: np.moveaxis(np.asarray(a), -1, 0), out)
            return found

        after, ends_found, blamed = jax.tree.map(
            lambda *parts: np.concatenate(parts)[:count], *in_blocks(job, count, size)
        )
        ends_found, blamed = (a[:, :T].reshape(*lead, T, *a.shape[2:]) for a in (ends_found, blamed))
        return self._validation(stretch, ends_found, blamed), after

    def _samples(self, stretch: Stretch, lead: tuple[int, ...]) -> _Samples:
        """Return the arrays of a stretch, recordings on one axis, time filled up."""
        m, (u, y, recorded, x0, before, _), dtype = self.m, stretch, stretch.y.dtype
        count = int(np.prod(lead))

        def flat(a: np.ndarray) -> np.ndarray:
            return a.reshape(count, *a.shape[len(lead) :])

        start = weight = None
        if x0 is not None:
            start = flat(self._start(x0, lead, dtype))
        error = largest_error(stretch.outputs, m.noise, recorded, self.s)[..., -y.shape[-2] :, :]
        # a point, unless it had to be narrowed
        pushed = ends(Interval(rounding.round_down(u, dtype), rounding.round_up(u, dtype)), -3)
        if self.several is not None:
            weight = flat(_filled_up(ends(self.several.columns(u.astype(dtype)), -3)))
        return _Samples(
            flat(_filled_up(pushed)), flat(_filled_up(y)), flat(_filled_up(error)), weight, start, before
        )

    def _start(self, x0: Interval, lead: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """Return the ends (*lead, 2, n) of the first state, rounded outward.

        Raises:
            ValueError: another number of states.
        """
        n, x0 = self.m.n, interval(x0)
        if x0.shape[-1:] != (n,):
            raise ValueError(f"x0 needs one interval for each of {n} states: its shape is {x0.shape}")
        near = Interval(rounding.round_down(x0.lo, dtype), rounding.round_up(x0.hi, dtype))
        return ends(jax.tree.map(lambda a: np.broadcast_to(a, (*lead, n)), near), -2)

    def _block(self, block: _Samples, systems: Prepared | None, stop: int) -> _Slid:
        """Return (carry, found, blamed) of recordings side by side, see `slide`."""
        m, s, M = self.m, self.s, jnp.asarray(ends(self.M))
        signals, carry = signalled(self.plant, block.u, block.y, block.error), block.before
        if carry is None:
            first = _of_first_window(signals, s)
            if block.weight is not None and block.start is None:
                rows = weighted(M, jnp.asarray(block.weight[:, : s + 1]), m.p)
                systems = _first_window(interval_of(np.asarray(rows)), m.p)
            carry = begun(self.plant, systems, first, block.start, s, m.n, self.method, self.centre)
        out: _Slid = slide(
            self.plant, M, self.systems, signals, block.weight, carry, stop, s, self.method, self.centre
        )
        return out

    def _validation(self, stretch: Stretch, ends_found: np.ndarray, blamed: np.ndarray) -> Validation:
        """Return the Validation of ends (..., T, 2, n + 3 p) and of who is blamed (..., T, p + 1).

        Raises:
            ValueError: first windows that do not bound the state.
        """
        s, n, p = self.s, self.m.n, self.m.p
        bounded = np.isfinite(ends_found[..., s, :, :n]).all((-1, -2))
        if not bounded.all():
            raise ValueError(
                f"{(~bounded).sum()} of {bounded.size} first windows do not bound the state: give x0, or a "
                f"longer horizon"
            )
        absent = np.isnan(stretch.y)
        residuals = ends_found[..., s:, :, n + p : n + 2 * p]
        residuals[np.broadcast_to(absent[..., s:, None, :], residuals.shape)] = np.nan
        parts = np.split(ends_found, np.cumsum([n, p, p]), -1)
        state, output, residual, corrected = (Interval(-a[..., 0, :], a[..., 1, :]) for a in parts)
        contradicted = blamed[..., p] & (not self.centre)
        status = np.where(contradicted, Status.FAULT, Status.UNDECIDED)
        status = np.where(absent.all(-1) & ~contradicted, Status.MISSING, status).astype(np.int8)
        status[..., :s] = Status.MISSING
        result = Validation(state, output, residual, blamed[..., :p], corrected, status)
        placed: Validation = jax.tree.map(jnp.asarray, result)
        return placed


def compiled_length(count: int) -> int:
    """Return the samples that a kernel is compiled for where there are so many: few numbers."""
    return max(SHORTEST, power(count))


def _latest(which: np.ndarray) -> np.ndarray:
    """Return (..., T): the last sample up to each that is one of these; -1 before the first."""
    return np.maximum.accumulate(np.where(which, np.arange(which.shape[-1]), -1), -1)


def _sensor_factor(m: IntervalSystem) -> Interval:
    """Return 1 / (1 + theta) for the relative errors of the sensors."""
    theta = [Fraction(v) for v in rounding.round_up(m.tolerance, m.A.dtype).tolist()]
    least = np.array([1 / (1 + v) for v in theta], object)
    most = np.array([1 / (1 - v) for v in theta], object)
    return Interval(rounding.round_down(least, m.A.dtype), rounding.round_up(most, m.A.dtype))


def _filled_up(a: np.ndarray) -> np.ndarray:
    """Return samples (..., T, .) and as many zeros behind that few lengths are compiled."""
    more = compiled_length(a.shape[-2]) - a.shape[-2]
    return np.concatenate([a, np.zeros((*a.shape[:-2], more, a.shape[-1]), a.dtype)], -2)


def _first_window(M: Interval, p: int) -> Prepared:
    """Prepare the rows of the first window as one system, without the newest samples if that will do: so
    these can be tested against it.
    """
    if M.shape[0] - p >= M.shape[1]:
        older = prepare(jax.tree.map(lambda a: a[:-p], M))
        if np.isfinite(older.scale.lo).all():
            return older
    return prepare(M)


def _of_first_window(signals: Signalled, s: int) -> Signalled:
    """Return the signals of the first s + 1 samples."""
    absent, *rest = (np.asarray(a) for a in signals)
    seen, pushed, drive, through = (jnp.asarray(a[:, : s + 1]) for a in rest)
    return Signalled(jnp.asarray(absent[: s + 1]), seen, pushed, drive, through)
