"""Verdicts as the samples come: the tests of `detect`, one sample or a burst at a time.

A window needs its last samples only, so the state is these, and how many of them follow each other without a
seam. Few windows are judged by the same compiled functions as many, on a short block instead of a long one:
elementwise over windows, they give the same numbers whatever the block. Measured, not promised by the
compiler: from 4 windows on all blocks agree bit by bit (scalar code for 1 or 2 windows rounds otherwise), so
the short ones have 64 and 16. A verdict is a proof with any rounding.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.drive import windows
from jaxbound.consistency.interface import (
    Budget,
    Compensation,
    Observer,
    Relations,
    WindowTest,
    relations_of,
)
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import TOLERATED_STEP, all_starts
from jaxbound.recordings.table import one_row
from jaxbound.recordings.tabletime import unlabelled
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.text.objects import readable

__all__ = ["Monitor", "MonitorState", "Verdict"]

BURST = 8  # short blocks; more windows than in these are judged in long blocks


@readable
class MonitorState(NamedTuple):
    """What a Monitor remembers: a PyTree of NumPy arrays. `np.savez(file, **state._asdict())` saves it, and
    `mon.init()._replace(**np.load(file))` restores it.

    Fields: u (s, m), y (s, p): the last samples, NaN where there is none; follows: how many of them follow
    each other up to now, at most s;
    samples: how many there were in all; time: of the last one in s, NaN if not known.
    """

    u: np.ndarray
    y: np.ndarray
    follows: np.int64
    samples: np.int64
    time: np.float64


@readable
class Verdict(NamedTuple):
    """Of the window that ends at a sample: status (a `Status` as int8) and margin, as in the Result of
    `detect`; (N,) for N samples.

    CONSISTENT after FAULT does not say that a fault is repaired: see `Alarm`.
    """

    status: np.ndarray
    margin: np.ndarray


@readable
class Monitor:
    """Tests windows as their samples come: verdicts and margins are those of `detect` over the whole
    recording.

    Args:
        relations: from `parity_relations` or `residual` (whose signals have names), or a bank, as for
            `detect`; or an Observer, whose carry is then the state, and what it judges, of one sample or of
            N, the verdict.
        method, budget, compensation: as for `detect`.
        dtype: of the samples, float64 or float32; None: as JAX is configured. Outputs of a wider type are
            rounded to it; a narrower type is refused, since more was rounded away than the verdicts would
            allow for.

    Bit for bit with strips, and with the exchange search for windows without missing samples; where samples
    are missing in windows that need the search, margins agree to 1e-9. A sample costs about 0.1 ms, an
    exchange search 0.5 to 1 ms; slow, tens of milliseconds: an exchange search over missing samples,
    uncertain parameters, constant_tolerance. The first whole window compiles, and the first burst.

    Raises:
        TypeError: no relations. ValueError: a method, budget or compensation that they cannot be tested by.
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
        compensation: Compensation = 0.0,
    ) -> None:
        self._observer = relations if isinstance(relations, Observer) else None
        if self._observer is not None:
            self.relations, self.method = relations, "observer"
            return
        relations_of(relations, "a Monitor", "Monitor(parity_relations(model))")
        refuse_unverified()
        self.dtype = np.dtype(jax.dtypes.canonicalize_dtype(float if dtype is None else dtype))
        test = relations.test(method, self.dtype, budget, compensation)
        assert isinstance(test, WindowTest)
        self._test = test
        self.relations, self.method = self._test.relations, self._test.method
        model = self.relations.model
        self._names = model.inputs, model.outputs
        self._dt: float = np.nan if model.dt is None else model.dt

    def _head(self):
        return f"Monitor ({self.method}) of {repr(self.relations).splitlines()[0]}"

    def _rows(self):
        return {} if self._observer is not None else {"samples": str(self.dtype)}

    def init(self) -> Any:
        """Return the MonitorState before the first sample; of an Observer what it carries."""
        if self._observer is not None:
            return self._observer.init()
        s, m = self.relations.horizon, self.relations.model
        nothing = lambda n: np.full((s, n), np.nan, self.dtype)
        return MonitorState(nothing(m.m), nothing(m.p), np.int64(0), np.int64(0), np.float64(np.nan))

    def step(self, state: Any, u: Any, y: Any, *, new: bool = False, time: Any = None) -> tuple[Any, Any]:
        """Take the next sample.

        Args:
            state: from `init` or the step before. u: (m,) inputs, None for a model without; y: (p,) outputs;
                NaN marks a missing sample. A Series (a row of a DataFrame, whose label is its time) and a
                dict are taken by name.
            new: the sample does not follow the one before: windows across are MISSING. time: of the sample in
                s: it is then new where it is not dt (within 20 %) after the one before.

        Returns:
            (state, Verdict) of the window that ends at this sample; MISSING until there is one.

        Raises:
            ValueError: shapes that do not fit the model, an infinite sample, y narrower than dtype. The state
                given is still good.
        """
        starts, time = (0,) if new else (), None if time is None else [time]
        state, judged = self.run(state, one_row(u, "u"), one_row(y, "y"), starts=starts, time=time)
        if type(judged) is Verdict:
            return state, Verdict(judged.status[0], judged.margin[0])
        return state, jax.tree.map(lambda x: x[0], judged)  # of an Observer

    def run(
        self, state: Any, u: Any, y: Any = None, *, starts: Any = (), time: Any = None
    ) -> tuple[Any, Any]:
        """Take the next N samples at once.

        Args:
            state: as for `step`. u: (N, m), y: (N, p), or tables as for `detect`. starts: numbers, counted in
                these N, of samples that do not follow the one before. time: (N,) in s; None: as a table tells
                it.

        Returns:
            (state, Verdict of arrays (N,)): what N calls of `step` return.

        Raises:
            ValueError: as `step`.
        """
        if self._observer is not None:
            if time is not None:
                raise ValueError(
                    "an Observer has no clock: say with starts, or new, where samples do not follow each "
                    "other"
                )
            return self._observer.fold(
                state, Recording.of(self._observer.signals, u, y, starts, narrow=False)
            )
        s = self.relations.horizon
        u, y, starts, told = self._samples(u, y, starts)
        count, (seams, last) = len(y), self._seams(told, len(y), time, state)
        starts = np.concatenate([starts, seams]) if len(seams) else starts
        all_u, all_y = np.concatenate([state.u, u]), np.concatenate([state.y, y])
        seams_of_all = starts + s if len(starts) else starts
        if state.follows < s:
            seams_of_all = np.concatenate([[s - int(state.follows)], seams_of_all])
        status, margin = (
            self._judge(all_u, all_y, seams_of_all)
            if count
            else (np.zeros(0, np.int8), np.zeros(0, self.dtype))
        )
        follows = count - starts.max() if len(starts) else count + state.follows
        follows = (
            0 if told is not None and told.excluded is not None and told.excluded[-1:].any() else follows
        )
        keep = len(all_y) - s
        after = MonitorState(
            all_u[keep:].copy(),
            all_y[keep:].copy(),
            np.int64(min(follows, s)),
            state.samples + count,
            np.float64(last),
        )
        return after, Verdict(status, margin)

    def _samples(self, u, y, starts):
        """Return (u, y, starts), u and y in our dtype, and the Recording of what tables tell beside, or None;
        or refuse them.
        """
        inputs, outputs = self._names
        fits = lambda x, n: (
            type(x) is np.ndarray and x.dtype == self.dtype and x.ndim == 2 and x.shape[1] == n
        )
        told = None
        if not (fits(u, len(inputs)) and fits(y, len(outputs)) and len(u) == len(y)):
            told = Recording.of(self.relations.model, u, y, starts, regular=False)
            if told.y.dtype.itemsize < self.dtype.itemsize:
                raise ValueError(
                    f"y is in {told.y.dtype}, which rounds more than {self.dtype}, the type of this Monitor, "
                    f"allows for: "
                    f"build it as Monitor(relations, dtype=np.{told.y.dtype})"
                )
            u, y, starts = np.asarray(told.u, self.dtype), np.asarray(told.y, self.dtype), told.starts
            if y.ndim != 2:
                raise ValueError(
                    f"a Monitor follows one recording: y must have shape (N, {len(outputs)}), not {y.shape}"
                )
        else:
            starts = NOWHERE if type(starts) is tuple and not starts else all_starts(starts, len(y))
        if np.count_nonzero(np.isinf(u)) or np.count_nonzero(np.isinf(y)):
            Recording(u, y, starts, *self._names).finite()
        return u, y, starts, told

    def _seams(self, told, count, time, state):
        """Return the samples that do not follow the one before by their time, and the time of the last one,
        in s.
        """
        dt = self._dt
        if not count or (time is None and (told is None or told.time is None)):
            index = None if told is None else told.index
            counted = (
                index is not None and unlabelled(index) and not state.samples
            )  # the numbers of later rows go on from here
            return NOWHERE, (count - 1) * dt if counted and count else state.time
        if time is None:
            begin = told.origin + told.time[0]
            off = abs(begin - state.time - dt) - np.spacing(
                abs(begin)
            )  # rows of one table were looked at already
            return np.zeros(int(off > TOLERATED_STEP * dt), np.int64), told.origin + told.time[-1]
        time = np.asarray(time, np.float64).reshape(-1)
        if len(time) != count:
            raise ValueError(f"time needs one number a sample: {len(time)} for {count} samples")
        seams = ~(np.abs(np.diff(time, prepend=state.time) - dt) <= TOLERATED_STEP * dt)
        seams[0] &= not np.isnan(state.time)
        return np.flatnonzero(seams), time[-1]

    def _judge(self, u, y, starts):
        """Return (status, margin) of all windows in samples that begin with the s before the first of
        them.
        """
        s = self._test.horizon
        few = len(y) - s <= BURST * self._test.short
        judged = windows(self._test, u, y, starts, size=self._test.short if few else None)
        return judged.status[s:], judged.margin[s:]
