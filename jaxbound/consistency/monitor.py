"""Verdicts as the samples come: the tests of `detect`, one sample or a burst at a time.

A window needs its last samples only, so the state is these, and how many of them follow each other without a
seam. Few windows are judged by the same compiled functions as many, on a short block instead of a long one:
elementwise over windows, they give the same numbers whatever the block. Measured, not promised by the
compiler: from 4 windows on all blocks agree bit by bit (scalar code for 1 or 2 windows rounds otherwise), so
the short ones have 64 and 16. A verdict is a proof with any rounding.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias, TypeGuard

import jax
import numpy as np
from jax.typing import DTypeLike
from numpy.typing import ArrayLike

from jaxbound.consistency.claims import CLAIMED, UNCLAIMED, placed, refuse_outside
from jaxbound.consistency.drive import windows
from jaxbound.consistency.interface import (
    EXACT,
    OBSERVER,
    Budget,
    Judged,
    Observer,
    Relations,
    Starts,
    margins_for,
    relations_of,
)
from jaxbound.models.region import Region
from jaxbound.recordings.factors import factors_of, known, narrowed
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import TOLERATED_STEP, all_starts
from jaxbound.recordings.table import one_row
from jaxbound.recordings.tabletime import unlabelled
from jaxbound.sets.floats.kernel import UNCOUNTED, first_in_numpy, sparing
from jaxbound.sets.floats.probe import refuse_unusable
from jaxbound.text.objects import readable

BURST = 8  # short blocks; more windows than in these are judged in long blocks
State: TypeAlias = Any
"""A MonitorState, or what an Observer carries: a PyTree, for which JAX has no type."""


@readable
class MonitorState(NamedTuple):
    """The memory of a Monitor: a PyTree of NumPy arrays. `np.savez(file, **state._asdict())` saves it, and
    `mon.init()._replace(**np.load(file))` restores it.

    Fields: u (s, m), factors on noise behind the inputs, y (s, p): the last samples, NaN where there is none;
    follows: how many of them follow each other up to now, at most s;
    samples: how many there were in all; time: of the last one in s, NaN if not known.
    """

    u: np.ndarray
    y: np.ndarray
    follows: np.int64
    samples: np.int64
    time: np.float64


@readable
class PlacedState(NamedTuple):
    """The memory of a Monitor of several tests that claims no FAULT outside the region of training.

    Fields: carry: of the tests. u: (k, m) the last inputs, NaN before there are some.
    """

    carry: Any
    u: np.ndarray


@readable
class Monitor:
    """Tests windows as their samples come: verdicts and margins are those of `detect` over the whole
    recording.

    Args:
        relations: from `parity_relations` or `residual` (whose signals have names), or a bank, as for
            `detect`; or an Observer, whose carry is then the state, and what it judges, of one sample or of
            N, the verdict.
        method, budget, outside: as for `detect`.
        margins: "exact", or "bounds", as for `detect`.
        dtype: of the samples, float64 or float32; None: as JAX is configured. Outputs of a wider type are
            rounded to it; a narrower type is refused, since more was rounded away than the verdicts would
            allow for.

    Verdicts are those of `detect`, margins agree to 1e-9, those of strips bit for bit. A sample costs about
    0.1 ms, an exchange search 0.5 to 1 ms, over missing samples 3 to 6 ms; constant_tolerance as these; slow,
    tens of milliseconds: uncertain parameters. The first whole window compiles, and the first burst. Where
    windows are searched, NumPy judges the first 512 samples, fewer of a costly search, in some milliseconds
    each, and XLA compiles behind them; before the first by `jb.compile("always")`.

    Raises:
        TypeError: no relations. ValueError: a method or budget that they cannot be tested by;
            outside="undecided" of an Observer that is no `jb.monitor`: its verdicts are its own.
        RuntimeError: on a device where rounding has not been verified, see `detect`.

    Encloses: FAULT and CONSISTENT are proofs, as those of `detect`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> mon = jb.Monitor(jb.parity_relations(m))
        >>> state = mon.init()
        >>> for y in (1.0, 0.5, 0.8):
        ...     state, verdict = mon.step(state, None, [y])
        ...     print(jb.Status(verdict.status).name, verdict.margin.round(3))
        MISSING nan
        CONSISTENT 1.0
        FAULT -2.667
    """

    def __init__(
        self,
        relations: Relations,
        method: str = "joint",
        dtype: DTypeLike | None = None,
        budget: Budget = None,
        outside: str = CLAIMED,
        margins: str = EXACT,
    ) -> None:
        refuse_outside(outside)
        self.outside = outside
        self.relations: Relations = relations
        self.method = OBSERVER
        self._observer: Observer[Any] | None = None
        relations_of(relations, "a Monitor", "Monitor(parity_relations(model))")
        if relations.observer is not None:
            if outside != CLAIMED and not relations.parts:
                raise ValueError(
                    "outside is for windows: a Monitor hands on the verdicts of an Observer as they are"
                )
            self._observer = relations.observer.measured()
            if dtype is not None:
                self._observer = self._observer.typed(dtype)
            self.region = None
            if outside == UNCLAIMED:
                self.region = Region.of(relations)
            return
        refuse_unusable()
        self.dtype = np.dtype(jax.dtypes.canonicalize_dtype(float if dtype is None else dtype))
        test = relations.test(method, self.dtype, budget)
        assert not test.remembers, "no observer"
        self._test = test
        if margins_for(margins, 0) == EXACT:
            self._test = test.measured()
        self.relations, self.method = test.relations, test.method
        self.region = Region.of(self.relations)
        dt = self.relations.model.dt
        self._dt = np.nan if dt is None else dt

    def _head(self) -> str:
        return f"Monitor ({self.method}) of {repr(self.relations).splitlines()[0]}"

    def _rows(self) -> dict[str, str]:
        return {} if self._observer is not None else {"samples": str(self.dtype)}

    @property
    def margins_are(self) -> str:
        """The margins of windows, "exact" or "bounds"; of an Observer "exact"."""
        if self._observer is not None:
            return self._observer.margins_are
        return self._test.margins_are

    def init(self) -> State:
        """Return the MonitorState before the first sample; of an Observer its first carry."""
        if self._observer is not None and self.region is not None:
            back = self.region.horizon, len(known(self.relations.model))
            return PlacedState(self._observer.init(), np.full(back, np.nan))
        if self._observer is not None:
            return self._observer.init()
        s, model = self.relations.horizon, self.relations.model
        u, y = (np.full((s, channels), np.nan, self.dtype) for channels in (len(known(model)), model.p))
        return MonitorState(u, y, np.int64(0), np.int64(0), np.float64(np.nan))

    def step(
        self, state: State, u: object, y: object, *, new: bool = False, time: float | None = None
    ) -> tuple[State, Any]:
        """Take the next sample.

        Args:
            state: from `init` or the step before. u: (m,) inputs, None for a model without; y: (p,) outputs;
                NaN marks a missing sample. A Series (a row of a DataFrame, whose label is its time) and a
                dict are taken by name.
            new: the sample does not follow the one before: windows across are MISSING. time: of the sample in
                s: it is then new where it is not dt (within 20 %) after the one before.

        Returns:
            (state, Judged) of the window that ends at this sample; MISSING until there is one. CONSISTENT
            after FAULT does not say that a fault is repaired: see `Alarm`.

        Raises:
            ValueError: shapes that do not fit the model, an infinite sample, y narrower than dtype. The state
                given is still good.
        """
        starts: Starts = (0,) if new else ()
        times = None if time is None else [time]
        state, judged = self.run(state, one_row(u, "u"), one_row(y, "y"), starts=starts, time=times)
        return state, jax.tree.map(lambda x: x[0], judged)

    def run(
        self, state: State, u: object, y: object = None, *, starts: Starts = (), time: ArrayLike | None = None
    ) -> tuple[State, Any]:
        """Take the next N samples at once.

        Args:
            state: as for `step`. u: (N, m), y: (N, p), or tables as for `detect`. starts: numbers, counted in
                these N, of samples that do not follow the one before. time: (N,) in s; None: as a table tells
                it.

        Returns:
            (state, Judged of arrays (N,)): what N calls of `step` return.

        Raises:
            ValueError: as `step`.
        """
        if self._observer is not None:
            if time is not None:
                raise ValueError(
                    "an Observer has no clock: say with starts, or new, where samples do not follow each "
                    "other"
                )
            piece = Recording.of(self._observer.signals, u, y, starts, narrow=False)
            return self.follow(state, piece)
        own, s = self._piece(u, y, starts), self._test.horizon
        count, begun = len(own.y), own.starts
        seams, last = self._seams(own, time, state)
        if len(seams):
            begun = np.concatenate([begun, seams])
        all_u, all_y, first = own.u, own.y, 0
        if state.follows or count < s:  # else no window of these samples reaches back
            all_u, all_y, first = np.concatenate([state.u, own.u]), np.concatenate([state.y, own.y]), s
        broken = begun + first  # counted in all samples
        if state.follows < first:
            broken = np.concatenate([[s - int(state.follows)], broken])
        test, weight = self._test, math.inf  # strips compile in less time than NumPy takes for some dozens
        if test.gathered:
            weight = test.weight
        early = first_in_numpy(int(state.samples), count, weight, test.kind)
        verdict = self._judge(all_u, all_y, broken, first, first + early)
        follows = self._follows(own, begun, state)
        # a window needs its last samples only
        keep = len(all_y) - s
        u, y = all_u[keep:].copy(), all_y[keep:].copy()
        after = MonitorState(u, y, np.int64(follows), state.samples + count, np.float64(last))
        return after, verdict

    def follow(self, state: State, piece: Recording) -> tuple[State, Any]:
        """Take the next samples, a Recording; return (state, verdicts) as `run` does."""
        if self._observer is None:
            return self.run(state, piece.u, piece.y, starts=piece.starts)
        if self.region is not None:
            return self._placed(self._observer, self.region, state, piece)
        return self._observer.followed(state, piece)

    def _placed(
        self, tests: Observer[Any], region: Region, state: PlacedState, piece: Recording
    ) -> tuple[PlacedState, Any]:
        """Return (state, verdicts of a monitor's tests), which claim no FAULT outside the region."""
        carry, judged = tests.followed(state.carry, piece)
        u = np.concatenate([state.u, np.asarray(piece.u, np.float64)])
        after = PlacedState(carry, u[len(u) - len(state.u) :].copy())
        return after, placed(judged, region, u, self.outside)

    def _piece(self, u: object, y: object, starts: Starts) -> Recording:
        """Return samples in our dtype, with all that a table tells beside, or refuse them."""
        model = self.relations.model
        plain = not factors_of(model)
        if plain and self._fits(u, model.m) and self._fits(y, model.p) and len(u) == len(y):
            none = isinstance(starts, tuple) and not starts
            begins = NOWHERE if none else all_starts(starts, len(y))
            piece = Recording(u, y, begins, known(model), model.outputs)
        else:
            piece = self._of_table(u, y, starts)
        if np.count_nonzero(np.isinf(piece.u)) or np.count_nonzero(np.isinf(piece.y)):
            piece.finite()
        return piece

    def _fits(self, x: object, channels: int) -> TypeGuard[np.ndarray]:
        """Return whether x is an array as it will be judged: nothing to convert, which takes longest."""
        return type(x) is np.ndarray and x.dtype == self.dtype and x.ndim == 2 and x.shape[1] == channels

    def _of_table(self, u: object, y: object, starts: Starts) -> Recording:
        """Return samples of tables, or of anything else that `Recording.of` takes."""
        model = self.relations.model
        table = Recording.of(model, u, y, starts, regular=False)
        if table.y.dtype.itemsize < self.dtype.itemsize:
            raise ValueError(
                f"y is in {table.y.dtype}, which rounds more than {self.dtype}, the type of this Monitor, "
                f"allows for: "
                f"build it as Monitor(relations, dtype=np.{table.y.dtype})"
            )
        own_u, own_y = narrowed(model, np.asarray(table.u), self.dtype), np.asarray(table.y, self.dtype)
        if own_y.ndim != 2:
            raise ValueError(
                f"a Monitor follows one recording: y must have shape (N, {len(model.outputs)}), not "
                f"{own_y.shape}"
            )
        return replace(table, u=own_u, y=own_y)

    def _seams(
        self, piece: Recording, time: ArrayLike | None, state: MonitorState
    ) -> tuple[np.ndarray, float]:
        """Return the samples that do not follow the one before by their time, and the time of the last one,
        in s.
        """
        count, before = len(piece.y), float(state.time)
        if not count:
            return NOWHERE, before
        if time is not None:
            return self._seams_at(np.asarray(time, np.float64).reshape(-1), count, before)
        if piece.time is None:
            # the numbers of later rows go on from here
            if piece.index is not None and unlabelled(piece.index) and not state.samples:
                return NOWHERE, (count - 1) * self._dt
            return NOWHERE, before
        begin = piece.origin + piece.time[0]
        # rows of one table were looked at already
        off = abs(begin - before - self._dt) - np.spacing(abs(begin))
        return np.zeros(int(off > TOLERATED_STEP * self._dt), np.int64), piece.origin + piece.time[-1]

    def _seams_at(self, time: np.ndarray, count: int, before: float) -> tuple[np.ndarray, float]:
        """Return the same by the times (N,) of all samples."""
        if len(time) != count:
            raise ValueError(f"time needs one number a sample: {len(time)} for {count} samples")
        steps = np.diff(time, prepend=before)
        seams = ~(np.abs(steps - self._dt) <= TOLERATED_STEP * self._dt)
        seams[0] &= not np.isnan(before)
        return np.flatnonzero(seams), time[-1]

    def _follows(self, piece: Recording, begun: np.ndarray, state: MonitorState) -> int:
        """Return how many of the last samples follow each other, at most those that are kept."""
        if piece.excluded is not None and piece.excluded[-1:].any():
            return 0
        count = len(piece.y)
        follows = count - begun.max() if len(begun) else count + state.follows
        return int(min(follows, self._test.horizon))

    def _judge(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray, first: int, early: int) -> Judged:
        """Return the verdicts of all samples from the first on; those before it are known already.

        early: NumPy judges those before it, each by itself: the same bits, however a stream is cut.
        """
        with sparing(UNCOUNTED):
            parts = [self._ending(u, y, starts, end, end + 1) for end in range(first, early)]
        parts.append(self._ending(u, y, starts, early, len(y)))
        judged: Judged = jax.tree.map(lambda *x: np.concatenate(x), *parts)
        return placed(judged, self.region, u, self.outside)

    def _ending(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray, begin: int, end: int) -> Judged:
        """Return the verdicts of the windows that end from one sample to another."""
        size, low = None, max(begin - self._test.horizon, 0)
        if end - begin <= BURST * self._test.short:
            size = self._test.short
        own = starts[(starts > low) & (starts < end)] - low
        judged = windows(self._test, Recording(u[low:end], y[low:end], own), size=size)
        new = slice(begin - low, None)
        columns = {name: x[new] for name, x in judged.columns.items()}
        return Judged(judged.status[new], judged.margin[new], columns=columns)
