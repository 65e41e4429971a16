"""Validation of recordings side by side without a gap: blocks for the kernel of `validation_windows`, and a
second decision of each FAULT outside XLA.
"""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.validation_result import Validation
from jaxbound.estimation.validation_windows import (
    Slid,
    ValidationCarry,
    ValidationSamples,
    begun,
    slide,
    weighted,
)
from jaxbound.models.intervals import IntervalSystem, stacked
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.sensor import input_slip, largest_error
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.linear_systems.ends import ends, interval_of
from jaxbound.sets.linear_systems.fixed_systems import Prepared, prepare

BLOCK = {"joint": 32, "sequential": 512}
"""Recordings side by side: linear programs of a block go on until the last is solved."""
WINDOWS = 1024
"""Windows side by side that NumPy decides again."""

HostCarry: TypeAlias = ValidationCarry[np.ndarray]
"""The carry between kernels, recordings on the first axis."""
_HostSamples: TypeAlias = ValidationSamples[np.ndarray]


class Stretch(NamedTuple):
    """Samples of N recordings that follow each other, and what is known before them.

    Fields: u (N, T, m), y (N, T, p) in the type of the model; recorded: the float type in which y was
    rounded; stops: (N,) how many samples count, the others fill the arrays up; first: the sample at which the
    first window ends; start: Interval (N, n) of the first state, or None; before: the carry of the windows
    before, or None.
    """

    u: np.ndarray
    y: np.ndarray
    recorded: np.dtype
    stops: np.ndarray
    first: int
    start: Interval | None = None
    before: HostCarry | None = None


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

    @property
    def weight(self) -> int:
        """How many windows of a small test NumPy evaluates in the time of one sample."""
        if self.method == "sequential":
            return 10
        return 8 + 3 * ((self.s + 1) * self.m.n) ** 2 // 4  # exchanges, of all unknowns

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

    @cached_property
    def first_window(self) -> Prepared:
        """The rows of a first window of which nothing is known, where they are always the same."""
        return _first_window(self.M, self.m.p)

    def __call__(self, stretch: Stretch) -> Slid[np.ndarray]:
        """Return (the carry behind the last sample, found, blamed) of each, see `slide`.

        Raises:
            ValueError: first windows that do not bound the state.
        """
        size = min(BLOCK[self.method], power(len(stretch.y)))
        samples, start = self._samples(stretch), self._start(stretch.start)

        def job(chosen: np.ndarray) -> Slid[np.ndarray]:
            given = samples, start, stretch.before
            some, first_state, carry = jax.tree.map(lambda a: np.moveaxis(a[chosen], 0, -1), given)
            if carry is None:
                carry = self._begun(some, first_state)
            last = int(stretch.stops.max())
            carries, ends_found, blamed = self._decided(some, carry, stretch.first, last)
            behind = jax.tree.map(lambda a: a[stretch.stops[chosen], ..., np.arange(len(chosen))], carries)
            return behind, np.moveaxis(ends_found, -1, 0), np.moveaxis(blamed, -1, 0)

        after, ends_found, blamed = jax.tree.map(
            lambda *parts: np.concatenate(parts)[: len(stretch.y)], *in_blocks(job, len(stretch.y), size)
        )
        bounded = np.isfinite(ends_found[:, stretch.first, :, : self.m.n]).all((-1, -2))
        if not bounded.all():
            raise ValueError(
                f"{(~bounded).sum()} of {bounded.size} first windows do not bound the state: give x0, or a "
                f"longer horizon"
            )
        return after, ends_found, blamed

    def validation(
        self, y: np.ndarray, tested: np.ndarray, found: np.ndarray, blamed: np.ndarray
    ) -> Validation:
        """Return the Validation of T samples.

        Args:
            y: (T, p). tested: (T,) bool: where a window ends. found, blamed: of `slide`, time first.
        """
        n, p = self.m.n, self.m.p
        absent, contradicted = np.isnan(y), blamed[:, p] & (not self.centre)
        below, above = -found[:, 0], found[:, 1].copy()
        of = np.cumsum([n, p, p])
        state, output, residual, corrected = map(Interval, np.split(below, of, -1), np.split(above, of, -1))
        for end in (residual.lo, residual.hi):
            end[absent & tested[:, None]] = np.nan
        status = np.where(contradicted, Status.FAULT, Status.UNDECIDED)
        status = np.where(~tested | (absent.all(-1) & ~contradicted), Status.MISSING, status).astype(np.int8)
        return Validation(state, output, residual, blamed[:, :p], corrected, status)

    def _decided(self, samples: _HostSamples, carry: HostCarry, first: int, stop: int) -> Slid[np.ndarray]:
        """Return the carries, ends and blame of `slide` for a block of recordings.

        A window that is FAULT is worked out again outside XLA, from its samples and the box that the windows
        before gave: nobody is blamed where that finds no contradiction.
        """
        carries, ends_found, blamed = self._slid(samples, carry, first, stop)
        at, recordings = np.nonzero(blamed[:, -1])
        if self.centre or is_outside_xla() or not len(at):
            return carries, ends_found, blamed
        rows = at + np.arange(-self.s, 1)[:, None]
        again = blamed.copy()

        def job(chosen: np.ndarray) -> np.ndarray:
            lanes = recordings[chosen]
            windows = jax.tree.map(lambda x: np.moveaxis(x[rows[:, chosen], ..., lanes], 1, -1), samples)
            entered = jax.tree.map(lambda x: np.moveaxis(x[at[chosen], ..., lanes], 0, -1), carries)
            _, _, wrong = self._slid(windows, entered, self.s, self.s + 1)
            return np.transpose(wrong[self.s])

        with outside_xla():
            blocks = in_blocks(job, len(at), min(WINDOWS, power(len(at))))
        again[at, :, recordings] = np.concatenate(blocks)[: len(at)]
        return carries, ends_found, blamed & again & again[:, -1:]

    def _slid(self, samples: _HostSamples, carry: HostCarry, first: int, stop: int) -> Slid[np.ndarray]:
        """Return the arrays of `slide` on the host."""
        if not is_outside_xla():
            refuse_unverified()
        M, s, method = jnp.asarray(ends(self.M)), self.s, self.method
        out = slide(self.plant, M, self.systems, samples, carry, first, stop, s, method, self.centre)
        arrays: Slid[np.ndarray] = jax.tree.map(np.asarray, out)
        return arrays

    def _begun(self, block: _HostSamples, start: np.ndarray | None) -> HostCarry:
        """Return the carry before the first windows of a block, from ends (2, n, N) of the first states or
        from these windows.
        """
        samples: _HostSamples = jax.tree.map(lambda x: x[: self.s + 1], block)
        systems = None
        if start is None and samples.weight is not None:
            systems = self._weighted_window(samples.weight)
        elif start is None and self.method == "joint":
            systems = self.first_window
        with outside_xla():
            carry: HostCarry = begun(self.plant, systems, start, samples, self.s, self.centre)
        return carry

    def _weighted_window(self, weight: np.ndarray) -> Prepared:
        """Return the rows of first windows as one system for each recording."""
        M = weighted(jnp.asarray(ends(self.M)), jnp.asarray(np.moveaxis(weight, 1, 0)), self.m.p)
        return _first_window(interval_of(np.asarray(M)), self.m.p)

    def _samples(self, stretch: Stretch) -> _HostSamples:
        """Return the arrays of a stretch, recordings on the first axis."""
        u, y, dtype = stretch.u, stretch.y, stretch.y.dtype
        weight = None
        if self.several is not None:
            weight = ends(self.several.columns(u.astype(dtype)), -2)
        # a point, unless it had to be narrowed, or may have been rounded
        given, slip = u.astype(np.float64), input_slip(u).astype(np.float64)
        lo, hi = rounding.round_down(given - slip, dtype), rounding.round_up(given + slip, dtype)
        pushed = ends(Interval(lo, hi), -2)
        error = largest_error(y, self.m.noise, stretch.recorded, self.s)
        return ValidationSamples(pushed, y, error, weight)

    def _start(self, x0: Interval | None) -> np.ndarray | None:
        """Return the ends (N, 2, n) of the first state, rounded outward."""
        if x0 is None:
            return None
        dtype = self.m.A.dtype
        return ends(Interval(rounding.round_down(x0.lo, dtype), rounding.round_up(x0.hi, dtype)), -2)


def _sensor_factor(m: IntervalSystem) -> Interval:
    """Return 1 / (1 + theta) for the relative errors of the sensors."""
    theta = [Fraction(v) for v in rounding.round_up(m.tolerance, m.A.dtype).tolist()]
    least = np.array([1 / (1 + v) for v in theta], object)
    most = np.array([1 / (1 - v) for v in theta], object)
    return Interval(rounding.round_down(least, m.A.dtype), rounding.round_up(most, m.A.dtype))


def _first_window(M: Interval, p: int) -> Prepared:
    """Prepare the rows of the first window as one system, without the newest samples if that will do: so
    these can be tested against it.
    """
    if M.shape[0] - p >= M.shape[1]:
        older = prepare(jax.tree.map(lambda a: a[:-p], M))
        if np.isfinite(older.scale.lo).all():
            return older
    return prepare(M)
