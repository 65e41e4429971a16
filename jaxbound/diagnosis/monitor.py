"""Verdicts as the samples come: the tests of `detect`, one sample or a burst at a time.

A window needs its last samples only, so the state is these, and how many of them follow each other without a seam. Few windows are judged
by the same compiled functions as many, on a short block instead of a long one: elementwise over windows, they give the same numbers
whatever the block. Measured, not promised by the compiler: from 4 windows on all blocks agree bit by bit (scalar code for 1 or 2 windows
rounds otherwise), so the short ones have 64 and 16. A verdict is a proof with any rounding.
"""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from jaxbound.consistency import drive, exchange, whole_numbers
from jaxbound.diagnosis import detection
from jaxbound.diagnosis.detection import METHODS, detect
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import TOLERATED_STEP, all_starts, crossing
from jaxbound.recordings.table import one_row, unlabelled
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.separation import Frame

__all__ = ["Monitor", "MonitorState", "Verdict"]

SHORT, SHORT_SEARCH = 64, 16  # windows in a short block: strips; the exchange search, whose work grows with the block
BURST = 8  # short blocks; more windows than in these are judged in long blocks


NOWHERE = np.zeros(0, np.int64)


class MonitorState(NamedTuple):
    """What a Monitor remembers: a PyTree of NumPy arrays. `np.savez(file, **state._asdict())` saves it, and
    `mon.init()._replace(**np.load(file))` restores it.

    Fields: u (s, m), y (s, p): the last samples, NaN where there is none; follows: how many of them follow each other up to now, at most s;
    samples: how many there were in all; time: of the last one in s, NaN if not known.
    """

    u: np.ndarray
    y: np.ndarray
    follows: np.ndarray
    samples: np.ndarray
    time: np.ndarray


class Verdict(NamedTuple):
    """Of the window that ends at a sample: status (a `Status` as int8) and margin, as in the Result of `detect`; (N,) for N samples.

    CONSISTENT after FAULT does not say that a fault is repaired: see `Alarm`.
    """

    status: np.ndarray
    margin: np.ndarray


class Monitor:
    """Tests windows as their samples come: verdicts and margins are those of `detect` over the whole recording.

    Args:
        relations: from `parity_relations`.
        method: "joint" or "box", with uncertain parameters also "linearised"; see `detect`.
        dtype: of the samples, float64 or float32; None: as JAX is configured. Outputs of a wider type are rounded to it; a narrower type is
            refused, since more was rounded away than the verdicts would allow for.

    Bit for bit with strips, and with the exchange search for windows without missing samples; where samples are missing in windows that
    need the search, margins agree to 1e-9. A sample costs about 0.1 ms, an exchange search 0.5 to 1 ms; slow, tens of milliseconds: an
    exchange search over missing samples, uncertain parameters, constant_tolerance. The first sample compiles, the first burst once more.

    Raises:
        TypeError: no relations from `parity_relations`. ValueError: an unknown method, or one that shares a budget among all windows.
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

    def __init__(self, relations, method="joint", dtype=None):
        if not isinstance(relations, ParityRelation | UncertainRelations):
            raise TypeError(f"a Monitor needs relations from parity_relations, not {type(relations).__name__}; test others with detect")
        uncertain = isinstance(relations, UncertainRelations)
        methods = ("joint", "box", "linearised") if uncertain else ("joint", "box")
        if method not in methods:
            why = "gives one budget to all windows of a recording" if method in METHODS else "is unknown"
            raise ValueError(f"method {method!r} {why}: a Monitor of this model tests by {' or '.join(methods)}")
        refuse_unverified()
        self.relations, self.method = relations, method
        self.dtype = np.dtype(jax.dtypes.canonicalize_dtype(float if dtype is None else dtype))
        self._test = self._on_device = None
        if isinstance(relations, ParityRelation) and not relations.model.constant_tolerance:
            self._test = relations.test(method, self.dtype)
            self._on_device = jax.device_put(self._test)

    def init(self):
        """Return the MonitorState before the first sample."""
        s, m = self.relations.horizon, self.relations.model
        nothing = lambda n: np.full((s, n), np.nan, self.dtype)
        return MonitorState(nothing(m.m), nothing(m.p), np.int64(0), np.int64(0), np.float64(np.nan))

    def step(self, state, u, y, *, new=False, time=None):
        """Take the next sample.

        Args:
            state: from `init` or the step before. u: (m,) inputs, None for a model without; y: (p,) outputs; NaN marks a missing sample. A
                Series (a row of a DataFrame, whose label is its time) and a dict are taken by name.
            new: the sample does not follow the one before: windows across are MISSING. time: of the sample in s: it is then new where it
                is not dt (within 20 %) after the one before.

        Returns:
            (state, Verdict) of the window that ends at this sample; MISSING until there is one.

        Raises:
            ValueError: shapes that do not fit the model, an infinite sample, y narrower than dtype. The state given is still good.
        """
        u, y = (one_row(x, name) for x, name in ((u, "u"), (y, "y")))
        state, (status, margin) = self.run(state, u, y, starts=(0,) if new else (), time=None if time is None else [time])
        return state, Verdict(status[0], margin[0])

    def run(self, state, u, y=None, *, starts=(), time=None):
        """Take the next N samples at once.

        Args:
            state: as for `step`. u: (N, m), y: (N, p), or tables as for `detect`. starts: numbers, counted in these N, of samples that do
                not follow the one before. time: (N,) in s; None: as the index of a table tells it.

        Returns:
            (state, Verdict of arrays (N,)): what N calls of `step` return.

        Raises:
            ValueError: as `step`.
        """
        s = self.relations.horizon
        given = self._recording(u, y, starts)
        u, y = given.u, given.y
        count, (seams, last) = len(y), self._seams(given, time, state)
        starts = np.concatenate([given.starts, seams]) if len(seams) else given.starts
        all_u, all_y = np.concatenate([state.u, u]), np.concatenate([state.y, y])
        across = np.zeros(count, bool)
        if len(starts) or state.follows < s:
            across = crossing([s - int(state.follows), *(starts + s)], s, s, s + count)
        status, margin = self._judge(all_u, all_y, across) if count else (np.zeros(0, np.int8), np.zeros(0, self.dtype))
        if across.any():
            status, margin = np.where(across, np.int8(Status.MISSING), status), np.where(across, self.dtype.type(np.nan), margin)
        follows = count - starts.max() if len(starts) else count + state.follows
        follows = 0 if given.excluded is not None and given.excluded[-1:].any() else follows
        keep = len(all_y) - s
        after = MonitorState(all_u[keep:].copy(), all_y[keep:].copy(), np.int64(min(follows, s)), state.samples + count, np.float64(last))
        return after, Verdict(status, margin)

    def _recording(self, u, y, starts):
        """Return what is given as a Recording of our dtype, or refuse it."""
        model = self.relations.model
        fits = lambda x, n: type(x) is np.ndarray and x.dtype == self.dtype and x.ndim == 2 and x.shape[1] == n
        if fits(u, model.m) and fits(y, model.p) and len(u) == len(y):
            given = Recording(u, y, all_starts(starts, len(y)) if np.size(starts) else NOWHERE, model.inputs, model.outputs)
        else:
            given = Recording.of(model, u, y, starts, regular=False)
            if given.y.dtype.itemsize < self.dtype.itemsize:
                raise ValueError(
                    f"y is in {given.y.dtype}, which rounds more than {self.dtype}, the type of this Monitor, allows for: "
                    f"build it as Monitor(relations, dtype=np.{given.y.dtype})"
                )
            given = replace(given, u=np.asarray(given.u, self.dtype), y=np.asarray(given.y, self.dtype))
            if given.y.ndim != 2:
                raise ValueError(f"a Monitor follows one recording: y must have shape (N, {model.p}), not {given.y.shape}")
        return given.finite() if np.isinf(given.u).any() or np.isinf(given.y).any() else given

    def _seams(self, given, time, state):
        """Return the samples that do not follow the one before by their time, and the time of the last one, in s."""
        dt, count = self.relations.model.dt, len(given.y)
        if not count or (time is None and given.time is None):
            counted = given.index is not None and unlabelled(given.index) and not state.samples  # the numbers of later rows go on from here
            return NOWHERE, (count - 1) * dt if counted and count else state.time
        if time is None:
            off = abs(given.origin - state.time - dt) - np.spacing(abs(given.origin))  # rows of one table were looked at already
            return np.zeros(int(off > TOLERATED_STEP * dt), np.int64), given.origin + given.time[-1]
        time = np.asarray(time, np.float64).reshape(-1)
        if len(time) != count:
            raise ValueError(f"time needs one number a sample: {len(time)} for {count} samples")
        seams = ~(np.abs(np.diff(time, prepend=state.time) - dt) <= TOLERATED_STEP * dt)
        seams[0] &= not np.isnan(state.time)
        return np.flatnonzero(seams), time[-1]

    def _judge(self, u, y, across):
        """Return (status, margin) of all windows in samples that begin with the s before the first of them; those across need none."""
        s, search = self.relations.horizon, self._test is not None and isinstance(self._test.shape, Frame)
        count, size = len(y) - s, SHORT_SEARCH if search else SHORT
        if self._test is None or count > BURST * size:
            found = detect(self.relations, u, y, self.method)
            return found.status[s:], found.margin[s:]
        judge = self._searched if search else self._in_strips
        parts = [judge(u, y, across, first, size) for first in range(0, count, size)]
        status, margin = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        if self.method == "box" and self.relations.count > 1:
            status = np.where(status == Status.CONSISTENT, np.int8(Status.UNDECIDED), status)
        return status, margin

    def _in_strips(self, u, y, across, first, size):
        """Return (status, margin) of at most `size` windows, tested circuit by circuit."""
        stop = min(first + size, len(y) - (s := self.relations.horizon)) + s
        blocks = (drive.padded(x, first, stop, size + s) for x in (u, y))
        status, margin = (np.array(x)[: stop - s - first] for x in detection.verdicts(self._on_device, *blocks))
        status, margin = (np.concatenate([np.zeros(s, x.dtype), x]) for x in (status, margin))  # the first window ends at sample s
        whole_numbers.settle(self.relations, self._test, self.method, u[first:stop], y[first:stop], status, margin)
        return status[s:], margin[s:]

    def _searched(self, u, y, across, first, size):
        """Return (status, margin) of at most `size` windows, tested by the exchange search; what it leaves open, as `detect` does."""
        s, test = self.relations.horizon, self._test
        chosen = np.arange(first, min(first + size, len(y) - s))
        if len(chosen) == 1:
            windows = [np.repeat(x[first : first + lags, :, None], size, 2) for x, lags in ((u, test.lags), (y, s + 1))]
        else:
            windows = test.gather(u, y, np.concatenate([chosen, np.repeat(chosen[:1], size - len(chosen))]))
        one, given = np.ones(size, self.dtype), (self._on_device, 2 * len(test.shape.inner) + 6, 1.0)
        margin, settled = exchange.verdicts(given, one, *windows, *exchange.candidates(given, one, *windows))
        margin, settled = np.array(margin)[: len(chosen)], np.asarray(settled)[: len(chosen)]
        for i in np.flatnonzero((~settled | (margin == 0)) & ~across[chosen]):
            window = [x[chosen[i] : chosen[i] + s + 1] for x in (u, y)]
            nothing = np.isnan(window[1]).all()
            margin[i] = np.nan if nothing else exchange.exchange_windows(self.relations, *window, None)[1][s]
        decided = np.where(margin < 0, Status.FAULT, np.where(margin > 0, Status.CONSISTENT, Status.UNDECIDED))
        return np.where(np.isnan(margin), Status.MISSING, decided).astype(np.int8), margin
