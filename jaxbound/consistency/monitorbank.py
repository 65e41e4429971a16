"""Several tests of one plant behind one verdict: windows, lags and observers, each with bounds of its own,
each always or under a condition.

Each test judges the samples as it does alone. Where its condition fails it sees none: where a condition
begins or ceases to hold, or is no longer known, windows are MISSING and observers begin anew.

A condition without a value leaves the mode open. What a test proves there it proves for its own mode, so it
is FAULT only where every mode that may hold is refuted by one of its tests: the modes are the conditions that
are stated, one of them "otherwise", so that one of them holds, and none changes while nobody knows it (where
it becomes unknown, and known again, it may). Without "otherwise" there may be a mode that no test speaks of:
nothing is proved while the mode is unknown.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import (
    BOUNDS,
    EXACT,
    MONITOR,
    Bounds,
    Budget,
    Columns,
    Judged,
    Observer,
    Relations,
    Watch,
)
from jaxbound.consistency.monitor import Monitor
from jaxbound.models.statedtests import OTHERWISE
from jaxbound.models.system import LinearSystem
from jaxbound.models.watched import NO, UNKNOWN, YES, modes_at, watched
from jaxbound.recordings.factors import factors_of, known, masked
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.probe import default_device, where_proofs_hold
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.threads import inherited
from jaxbound.text.objects import readable

Piece = TypeVar("Piece", bound=Recording)
BEFORE = np.int8(-1)
"""In place of NO, YES and UNKNOWN before the first sample."""
SIDE_BY_SIDE = 2**14
"""Samples up to which the tests judge on a thread each: of so few, compiling takes longest."""


@readable
class BankState(NamedTuple):
    """The memory of a bank: a PyTree of NumPy arrays and numbers.

    Fields: tests: the MonitorState of each test of windows, the carry of each observer. modes: (C,) int8,
    whether each condition held at the last sample.
    """

    tests: tuple[Any, ...]
    modes: np.ndarray


@readable
class MonitorBank(Observer[BankState]):
    """Tests of one plant behind one verdict; `jb.monitor` builds it of a model file.

    A sample is FAULT where any test proves it, MISSING where all are, else UNDECIDED where any test that
    speaks is, else CONSISTENT. The margin is the least of those that speak.

    Args:
        model: the plant, whose signals all tests read. watches: the tests, each name once.

    Encloses: FAULT is a proof that the samples contradict model and bounds of a test whose condition holds.
    """

    method: ClassVar[str] = MONITOR
    untuned: ClassVar[str | None] = None

    def __init__(self, model: LinearSystem, watches: Sequence[Watch]) -> None:
        if not watches:
            raise ValueError("a monitor needs a test: the model states none")
        self.watches = tuple(watches)
        conditions = [watch.when for watch in self.watches if watch.when is not None]
        self.conditions = tuple(dict.fromkeys(conditions))
        models = [watch.relations.model for watch in self.watches]
        self.model = watched(model, models, conditions)  # type: ignore[misc]
        self.exact = False
        self.dtype = np.dtype(jax.dtypes.canonicalize_dtype(float))

    @property
    def plant(self) -> LinearSystem:
        """The model whose signals all tests read, with the columns of their conditions."""
        assert isinstance(self.model, LinearSystem), "it was built of one"
        return self.model

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the tests, in the order of `by`."""
        return tuple(watch.name for watch in self.watches)

    @property
    def parts(self) -> Mapping[str, Relations]:
        """The tests by their names."""
        return MappingProxyType({watch.name: watch.relations for watch in self.watches})

    @property
    def horizon(self) -> int:
        """How many samples at the start have no verdict."""
        return min(watch.relations.horizon for watch in self.watches)

    @property
    def reach(self) -> int:
        """How many samples before its last the longest window has."""
        return max(watch.relations.horizon for watch in self.watches)

    @property
    def looks_back(self) -> int | None:
        """How many samples before a sample its verdict depends on; None: on all, as observers and conditions
        do, which know what was before.
        """
        if self.conditions or any(watch.relations.remembers for watch in self.watches):
            return None
        return self.reach

    @property
    def count(self) -> int:
        """The number of tests."""
        return len(self.watches)

    @property
    def bounds(self) -> Bounds:
        """Those of the first test; each has its own."""
        return self.watches[0].relations.bounds

    @property
    def made(self) -> tuple[object, ...] | None:
        """The tests, as far as verdicts depend on them; None where one cannot be told from others."""
        parts: list[object] = ["monitor"]
        for watch in self.watches:
            relations = watch.relations
            if relations.made is None:
                return None
            about = relations.model, dict(relations.bounds), relations.made, relations.horizon
            parts.append((watch.name, watch.when, *about))
        return tuple(parts)

    @property
    def restart(self) -> bool:
        """Whether every observer begins anew behind a FAULT."""
        return not any(watch.relations.latched for watch in self.watches)

    @property
    def informed(self) -> bool:
        """Whether some observer knows more of the first sample of a recording than of one behind a gap."""
        return any(watch.relations.informed for watch in self.watches)

    @property
    def searched(self) -> bool:
        """Whether a search decides windows of some test."""
        return any(watch.relations.searched for watch in self.watches)

    @property
    def complete(self) -> bool:
        """Whether one of the conditions holds at each sample."""
        return OTHERWISE in self.conditions

    def _head(self) -> str:
        return f"{type(self).__name__} of {len(self.watches)} tests"

    def _rows(self) -> dict[str, str]:
        rows = {"model": repr(self.model)}
        for line in self.text().splitlines():
            name, _, words = line.partition(": ")
            rows[name] = words
        return rows

    def text(self) -> str:
        """Return a line on each test."""
        lines = []
        for watch in self.watches:
            line = f"{watch.name}: {watch.about}"
            if watch.when is not None:
                line += f", when {watch.when}"
            lines.append(line)
        return "\n".join(lines)

    @property
    def margins_are(self) -> str:
        """The margins of the tests, "exact", or "bounds" as those of some windows."""
        for one in self.monitors:
            if one.margins_are == BOUNDS:
                return BOUNDS
        return EXACT

    def measured(self) -> Self:
        """Return the same bank with exact margins."""
        return self._changed(True, self.dtype)

    def typed(self, dtype: DTypeLike) -> Self:
        """Return the same bank for samples in a float dtype."""
        return self._changed(self.exact, dtype)

    def test(
        self,
        method: str = "joint",
        dtype: DTypeLike | None = None,
        budget: Budget = None,
    ) -> Self:
        """Return the bank for samples in a float dtype; it knows one method."""
        super().test(method, dtype, budget)
        return self if dtype is None else self.typed(dtype)

    def _changed(self, exact: bool, dtype: DTypeLike) -> Self:
        """Return the same bank with other margins, or for other samples, which builds its tests anew."""
        if (exact, np.dtype(dtype)) == (self.exact, self.dtype):
            return self
        same = copy.copy(self)
        vars(same).pop("monitors", None)
        same.exact, same.dtype = exact, np.dtype(dtype)
        return same

    @cached_property
    def monitors(self) -> tuple[Monitor, ...]:
        """The Monitor of each test."""
        kind = EXACT if self.exact else BOUNDS
        return tuple(Monitor(watch.relations, dtype=self.dtype, margins=kind) for watch in self.watches)

    def init(self) -> BankState:
        """Return the memory before the first sample."""
        return BankState(
            tuple(one.init() for one in self.monitors), np.full(len(self.conditions), BEFORE, np.int8)
        )

    def fold(self, carry: BankState, piece: Recording) -> tuple[BankState, Judged]:
        """Take the next samples; return (memory, their verdicts, with those of each test)."""
        modes, device = self.modes_of(np.asarray(piece.u)), default_device()
        monitors = self.monitors  # built once, and not by each thread

        def judged(number: int) -> tuple[Any, np.ndarray, np.ndarray, Columns]:
            one, state = monitors[number], carry.tests[number]
            own = self.seen_by(number, piece, modes, carry.modes)
            with jax.default_device(device):
                after, found = one.follow(state, own)
            status, margin = np.asarray(found.status), np.asarray(found.margin)
            if own.excluded is not None:
                status = np.where(own.excluded, np.int8(Status.MISSING), status)
                margin = np.where(own.excluded, np.nan, margin)
            return after, status, margin, getattr(found, "columns", {})

        tests = range(self.count)
        if self.count > 1 and 1 < piece.samples <= SIDE_BY_SIDE:
            with ThreadPoolExecutor(self.count) as pool:
                found_by_test = list(pool.map(inherited(judged), tests))
        else:
            found_by_test = list(map(judged, tests))
        states, statuses, margins, numbers = zip(*found_by_test, strict=True)
        last = modes[-1] if len(modes) else carry.modes
        # columns that lie together: all that is made of them is made test by test
        columns = np.stack(statuses).T, np.stack(margins).T
        together = combined(*columns, self.conditions_of, modes, self.complete)
        assert together.by is not None, "these are several tests"
        return BankState(states, last), together._replace(columns=_columns_that_speak(numbers, together.by))

    def followed(self, carry: BankState, piece: Recording) -> tuple[BankState, Judged]:
        """Return the verdicts of `fold`, on the CPU as those of any observer; what compiles asks for the
        probe.
        """
        with where_proofs_hold(compiled=False):
            return self.fold(carry, piece)

    @property
    def conditions_of(self) -> tuple[int, ...]:
        """The number of the condition of each test, -1 of a test that always watches."""
        places = []
        for watch in self.watches:
            places.append(-1 if watch.when is None else self.conditions.index(watch.when))
        return tuple(places)

    def modes_of(self, u: np.ndarray) -> np.ndarray:
        """Return (T, C) int8: whether each condition holds at each sample, as `models.watched.modes_at`."""
        return modes_at(self.plant, self.conditions, u)

    def seen_by(
        self, number: int, piece: Piece, modes: np.ndarray, before: np.ndarray | None = None
    ) -> Piece:
        """Return the samples of a piece as a test sees them: with its columns of u, without those at which
        its condition fails.

        Args:
            number: of the test. modes: of the samples. before: of the sample before them; None: there is
                none.
        """
        watch = self.watches[number]
        u, y, starts = np.asarray(piece.u), np.asarray(piece.y), np.asarray(piece.starts, np.int64)
        model = watch.relations.model
        columns, own = known(self.model), known(model)
        if own != columns:
            u = u[:, [columns.index(name) for name in own]]
        if factors_of(model):
            y = masked(model, u, y)
        excluded = piece.excluded
        c = self.conditions_of[number]
        if c >= 0:
            if before is None:
                before = np.full(modes.shape[1], BEFORE)
            changes = np.diff(modes, axis=0, prepend=before[None]) != 0
            # what is unknown may have changed wherever more, or less, is known of any mode
            edges = changes[:, c] | (changes.any(1) & (modes[:, c] == UNKNOWN))
            starts = np.union1d(starts, np.flatnonzero(edges))
            fails = modes[:, c] == NO
            u, y = np.where(fails[:, None], np.nan, u), np.where(fails[:, None], np.nan, y)
            excluded = fails if excluded is None else fails | excluded
        return replace(piece, u=u, y=y, starts=starts, excluded=excluded, inputs=own)


def _columns_that_speak(numbers: Sequence[Columns], by: np.ndarray) -> Columns:
    """Return the columns of the tests that speak; NaN where none does, or it has no such column."""
    columns = {name: np.full(len(by), np.nan) for name in dict.fromkeys(chain(*numbers))}
    for number, own in enumerate(numbers):
        for name, x in own.items():
            columns[name] = np.where(by == number, x, columns[name])
    return columns


def combined(
    statuses: np.ndarray,
    margins: np.ndarray,
    conditions: Sequence[int],
    modes: np.ndarray,
    complete: bool,
) -> Judged:
    """Return the verdicts of a bank from those of its tests.

    Args:
        statuses: (T, tests) int8, margins: (T, tests), of each test by itself. conditions: (tests,) the
            number of its condition, -1: none. modes: (T, C), whether each holds; a test has no verdict where
            its condition fails. complete: whether one of them holds at each sample.
    """
    statuses = claimed(statuses, conditions, modes, complete)
    tests = range(len(conditions))
    # the order of Status: a FAULT of any test is that of all, MISSING is where no test speaks
    status = np.full(len(statuses), Status.MISSING, np.int8)
    for i in tests:
        np.maximum(status, statuses[:, i], out=status)
    free = status != Status.FAULT
    largest = np.finfo(margins.dtype).max
    least, by = np.full(len(status), np.inf, margins.dtype), np.full(len(status), -1, np.int16)
    for i in tests:
        own = statuses[:, i]
        eligible = (own == Status.FAULT) | (free & (own != Status.MISSING))
        rank = np.where(eligible, np.fmin(margins[:, i], largest), np.inf)
        less = rank < least
        by[less], least = i, np.minimum(rank, least)
    counting = _counting(margins, conditions, modes, complete)
    return Judged(status, _least(counting), by=by, statuses=statuses, test_margins=margins)


def claimed(statuses: np.ndarray, conditions: Sequence[int], modes: np.ndarray, complete: bool) -> np.ndarray:
    """Return statuses with UNDECIDED in place of FAULT that is proved for one mode of several. Args: as of
    `combined`.
    """
    unknown = (modes == UNKNOWN).any(1)
    if not unknown.any():
        return statuses
    refuted = np.zeros(modes.shape, bool)
    for number, c in enumerate(conditions):
        if c >= 0:
            refuted[:, c] |= statuses[:, number] == Status.FAULT
    every = ((modes == NO) | refuted).all(1) & ~(modes == YES).any(1)
    certain = every & complete
    statuses = statuses.copy()
    for number, c in enumerate(conditions):
        if c >= 0:
            bare = (modes[:, c] == UNKNOWN) & ~certain & (statuses[:, number] == Status.FAULT)
            statuses[bare, number] = Status.UNDECIDED
    return statuses


def _counting(
    margins: np.ndarray, conditions: Sequence[int], modes: np.ndarray, complete: bool
) -> np.ndarray:
    """Return the margins (T, k) of which the least is that of the bank: of tests that watch for sure, and of
    the mode that holds best where it is unknown; NaN where a mode may hold that no test measures.
    """
    unknown = (modes == UNKNOWN).any(1)
    if not unknown.any():
        return margins
    sure = margins.copy()
    best = np.full(len(margins), -np.inf, margins.dtype)
    for c in range(modes.shape[1]):
        own = [number for number, condition in enumerate(conditions) if condition == c]
        open_ = modes[:, c] == UNKNOWN
        mode = _least(margins[:, own])
        best = np.where(open_, np.maximum(best, mode), best)  # NaN stays
        sure[np.ix_(open_, own)] = np.nan
    surely = (modes == YES).any(1)
    best[~unknown | ((best < 0) & (surely | (not complete)))] = np.nan
    return np.concatenate([sure, best[:, None]], 1)


def _least(margins: np.ndarray) -> np.ndarray:
    """Return the least margin (T,) of (T, k), NaN where there is none."""
    least = np.full(len(margins), np.nan, margins.dtype)
    for column in margins.T:
        np.fmin(least, column, out=least)
    return least
