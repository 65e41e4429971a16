"""The smallest factor on given bounds at which every healthy window is explained, enclosed between two
verdicts of the proved test.

Along a ray of bounds the sets of explanations grow, so a window that is explained at one factor is explained
at every larger one. The factor of a recording is that of its worst window; a few windows that are worst
somewhere are searched, then all are tested again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, NoReturn

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.diagnosis.detection import detect, margins
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.arrays import holds_both
from jaxbound.recordings.factors import known
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.recordings.seams import crossing
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning.parametrization import Moving

FEW = 16  # worst windows that a test of all adds to those searched
LEAST, MOST = 1e-12, 1e15  # factors looked at
NEAR_ONE = 0.999999  # of a tolerance
NEAR = 1e-3  # to the logarithm of the largest factor: closer it is tried itself
DOUBLE = math.log(2)


@dataclass(frozen=True, eq=False)
class JoinedRecordings(Recording):
    """Recordings laid end to end, as one.

    Fields: first: where each recording begins; entries: where each of those that were given begins, a batch
    is one.
    """

    first: np.ndarray = field(default_factory=lambda: NOWHERE)
    entries: np.ndarray = field(default_factory=lambda: NOWHERE)

    def split(self, number: int) -> tuple["JoinedRecordings", "JoinedRecordings"]:
        """Return (one of the entries, all others)."""
        own = np.zeros(len(self.y), bool)
        own[self.entries[number] : [*self.entries, len(own)][number + 1]] = True
        return self._where(own), self._where(~own)

    def _where(self, chosen: np.ndarray) -> "JoinedRecordings":
        """Return the chosen samples, of whole entries."""
        before = np.cumsum(chosen) - chosen  # how many chosen ones come before each sample

        def kept(at: np.ndarray) -> np.ndarray:
            at = at[at < len(chosen)]  # an entry without a sample
            return np.asarray(before[at[chosen[at]]])

        starts = kept(np.union1d(self.starts, self.first))
        return replace(
            self,
            u=self.u[chosen],
            y=self.y[chosen],
            starts=starts[starts > 0],
            first=kept(self.first),
            entries=kept(self.entries),
        )

    def across(self, horizon: int) -> np.ndarray:
        """Return (T,) bool: no window of horizon + 1 samples ends here."""
        return crossing([0, *self.starts], horizon, 0, len(self.y))

    def without(self, horizon: int) -> np.ndarray:
        """Return (T,) bool: no window ends here, or one in which nothing at all was measured."""
        samples = len(self.y)
        if samples <= horizon:
            return np.ones(samples, bool)
        measured = np.cumsum(np.append(0, ~np.isnan(self.y).all(1)))
        empty = np.ones(samples, bool)
        empty[horizon:] = measured[horizon + 1 :] == measured[: samples - horizon]
        empty |= self.across(horizon)
        return empty

    def gather(self, ends: ArrayLike, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Return u (N, s + 1, m), y (N, s + 1, p) of the windows that end at these samples."""
        at = np.asarray(ends)[:, None] + np.arange(-horizon, 1)
        return self.u.take(at, 0), self.y.take(at, 0)

    def place(self, end: int) -> str:
        """Return words for the sample at which a window ends."""
        number = int(np.searchsorted(self.first, end, "right")) - 1
        place = f"sample {end - self.first[number]}"
        if len(self.first) > 1:
            place += f" of recording {number + 1}"
        return place


def joined_recordings(
    model: LinearSystem, horizon: int, given: object, what: str = "healthy"
) -> JoinedRecordings:
    """Lay recordings end to end.

    Args:
        given: a tuple (u, y) or (u, y, starts), batched or not, a table or a Recording that holds both, or a
            list of these. what: their name in sentences.

    Raises:
        ValueError: anything else, samples that do not fit the model or are infinite, not one complete window.
    """
    us, ys, starts, first, entries, at = [], [], [], [], [], 0
    for parts in _parts_of_each(given, what):
        recording = Recording.of(model, *parts).finite()
        length = recording.y.shape[-2]
        entries.append(at)
        u, y = _end_to_end(recording.u), _end_to_end(recording.y)
        for begin in range(at, at + len(y), max(length, 1)):
            first.append(begin)
            starts += [begin, *(begin + recording.starts)]
        at += len(y)
        us.append(u)
        ys.append(y)
    inner = np.unique(np.array([start for start in starts if 0 < start < at], np.int64))
    joined = JoinedRecordings(
        np.concatenate(us),
        np.concatenate(ys),
        inner,
        known(model),
        model.outputs,
        first=np.array(first),
        entries=np.array(entries),
    )
    if joined.without(horizon).all():
        raise ValueError(
            f"the {what} data hold no window of {horizon + 1} samples in a row: give longer recordings, or a "
            f"shorter horizon"
        )
    return joined


def both_recordings(
    model: LinearSystem, horizon: int, healthy: object, faulty: object
) -> tuple[JoinedRecordings, JoinedRecordings | None]:
    """Return healthy recordings and faulty ones, if there are some.

    Raises:
        ValueError: as `joined_recordings`; a faulty one that is a healthy one: no bounds can tell them apart.
    """
    good = joined_recordings(model, horizon, healthy)
    if faulty is None:
        return good, None
    bad = joined_recordings(model, horizon, faulty, "faulty")
    seen = {piece: i for i, piece in enumerate(_contents(good))}
    for j, piece in enumerate(_contents(bad)):
        if piece in seen:
            raise ValueError(
                f"faulty recording {j + 1} is the same as healthy recording {seen[piece] + 1}: no bounds "
                f"can tell them apart"
            )
    return good, bad


def _contents(recordings: JoinedRecordings) -> list[tuple[bytes, bytes]]:
    """Return the numbers of each recording."""
    inner = recordings.first[1:]
    pieces = zip(np.split(recordings.u, inner), np.split(recordings.y, inner), strict=True)
    return [(u.tobytes(), y.tobytes()) for u, y in pieces]


def _parts_of_each(given: object, what: str) -> list[tuple[Any, ...]]:
    """Return the arguments of `Recording.of` of each recording."""
    several: list[tuple[Any, ...]] = []
    for one in given if isinstance(given, list) else [given]:
        parts = one if isinstance(one, tuple) else (one,)
        if len(parts) not in (2, 3) and not (len(parts) == 1 and holds_both(parts[0])):
            several.clear()
            break
        several.append(parts)
    if not several:
        raise ValueError(
            f"{what} needs a tuple (u, y) or a list of such tuples, one a recording; (u, y, starts) where "
            f"samples are lost"
        )
    return several


def _end_to_end(x: np.ndarray | jax.Array) -> np.ndarray:
    """Return recordings (..., T, c) as one (T, c)."""
    return np.asarray(x).reshape(math.prod(x.shape[:-1]), x.shape[-1])


def factors(relations: ParityRelation | UncertainRelations, windows: JoinedRecordings) -> np.ndarray:
    """Return (T,) the factors t = 1 - margin of all windows, NaN where there is none or it has no data."""
    if relations.uncertain:  # the test gives the windows that it leaves open no size
        t = 1 - np.asarray(margins(relations, windows.u, windows.y))
        return np.where(windows.across(relations.horizon), np.nan, t)
    return 1 - detect(relations, windows, margins="exact").margin


def worst(t: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers of the `count` largest entries that are not NaN, the largest first."""
    t = np.where(np.isnan(t), -np.inf, t)
    top = np.arange(len(t))
    if count < len(t):
        top = np.argpartition(t, -count)[-count:]
    top = top[t[top] > -np.inf]
    return top[np.argsort(-t[top], kind="stable")]


def smallest_scale(
    relations: ParityRelation | UncertainRelations,
    moved: Moving,
    values: np.ndarray,
    windows: JoinedRecordings,
) -> tuple[float, float]:
    """Enclose the smallest factor on `values` at which the proved test accepts every window.

    Args:
        relations: parity or uncertain ones. moved: a Moving. values: (b,) its values at the factor 1.
            windows: JoinedRecordings.

    Returns:
        (low, high): at low the test proves some window inconsistent, so the true factor is above; at high it
        proves every window consistent (with uncertain parameters, or a missing input: it refutes none).

    Raises:
        ValueError: no factor explains some window, a tolerance would reach 1, or nothing is needed.
    """
    values = np.asarray(values, np.float64)
    tolerances = moved.most < np.inf
    limit = MOST
    if tolerances.any():
        limit = min(MOST, NEAR_ONE / values[tolerances].max())

    def judge(scale: float, u: np.ndarray, y: np.ndarray, starts: ArrayLike = ()) -> _Judgement:
        scaled = relations.with_bounds(moved.bounds(scale * values))
        res = detect(scaled, u, y, starts=starts, margins="exact")
        refuted = bool((res.status == Status.FAULT).any())
        least = float(np.nanmin(res.margin, initial=1.0))
        accepted = not refuted if relations.uncertain else least > 0
        return _Judgement(accepted, refuted, 1 - least, res.margin)

    close = 64 * float(np.finfo(windows.y.dtype).eps)
    few = np.zeros(0, np.int64)  # worst windows, which are searched
    low, scale, grow = 0.0, min(1.0, limit), close
    while True:
        every = judge(scale, windows.u, windows.y, windows.starts)
        if len(few) and every.accepted:
            return low * (1 - LEAST), scale  # the test was of bounds within a rounding of low
        searched = len(few) > 0
        few = np.union1d(few, worst(-every.margin, FEW))
        if not len(few):
            raise ValueError("no healthy window has any data: all are MISSING")
        u, y = windows.gather(few, relations.horizon)
        bracket = _Bracket(partial(judge, u=u, y=y), limit, close)
        outcome = bracket.search(scale)
        if outcome != "found":
            last = np.nan_to_num(judge(limit, u, y).margin[..., -1], nan=np.inf)
            _refuse_factors(outcome, moved, values, windows, int(few[np.argmin(last)]))
        low, high = bracket.proved, math.exp(bracket.high)
        if searched:  # a search may end otherwise in company
            scale, grow = max(high, scale * (1 + grow)), 4 * grow
        else:
            scale, grow = high, close


class _Judgement(NamedTuple):
    """The verdict of the proved test on windows under one factor: t is that of the worst one."""

    accepted: bool
    refuted: bool
    t: float
    margin: np.ndarray


def _refuse_factors(
    why: str, moved: Moving, values: np.ndarray, windows: JoinedRecordings, end: int
) -> NoReturn:
    """Raise ValueError where no factor is the smallest. end: of the window that is worst at the largest."""
    if why == "nothing":
        raise ValueError(
            "the bounds that stay explain every healthy window without those that move: there is nothing to "
            "tune"
        )
    tolerances = [i for i, top in enumerate(moved.most) if top < np.inf]
    where = f"the healthy window that ends at {windows.place(end)}"
    if tolerances:
        name = moved.names[max(tolerances, key=lambda i: values[i])]
        raise ValueError(
            f"{name} would reach 1 before {where} is explained: let a noise bound move too, or look at that "
            f"window"
        )
    raise ValueError(
        f"no size of {', '.join(moved.names)} explains {where}: let other bounds move too, or look at that "
        f"window"
    )


class _Bracket:
    """Two factors with the smallest one that is accepted between them, relatively `close`.

    In the usual case t is inversely proportional to the factor, so that the secant of log t over the
    logarithm of the factor lands on the crossing.

    low, high: logarithms of the largest factor that is not accepted, of the smallest that is; proved: the
    largest factor that is refuted.
    """

    def __init__(self, judge: Callable[[float], _Judgement], limit: float, close: float) -> None:
        """Begin without any factor."""
        self.judge, self.limit, self.close = judge, math.log(limit), close
        self.low, self.high, self.proved = -math.inf, math.inf, 0.0

    def search(self, x: float) -> str:
        """Search from a factor on: return "found", or "never" or "nothing" where there is no such pair."""
        from scipy.optimize import brentq

        at = min(math.log(x), self.limit)
        while self.high == math.inf:
            log_t = self._look(at)
            if self.high == math.inf:
                if at >= self.limit:
                    return "never"
                room = self.limit - at
                if room > NEAR:  # at the limit itself, where a tolerance is 1, a test may say nothing
                    room /= 2
                at += min(log_t + DOUBLE, 10 * DOUBLE, room)
        while self.low == -math.inf:
            if at < math.log(LEAST):
                return "nothing"
            at += max(log_t - DOUBLE, -10 * DOUBLE)
            log_t = self._look(at)
        brentq(self._look, self.low, self.high, xtol=self.close)
        self._prove()
        return "found"

    def _look(self, at: float) -> float:
        """Judge a factor and move the end that it belongs to; return log t, its sign that of the verdict."""
        accepted, refuted, t, _ = self.judge(math.exp(at))
        if refuted:
            self.proved = max(self.proved, math.exp(at))
        if accepted:
            self.high = min(self.high, at)
            return min(math.log(max(t, 1e-300)), -1e-300)
        self.low = max(self.low, at)
        return max(math.log(max(t, 1.0)), 1e-300)

    def _prove(self) -> None:
        """Look for a factor that is refuted: one that is neither lies between it and those accepted."""
        step, low = self.close, math.exp(self.low)
        while self.proved < low * (1 - step):
            if self.judge(low * (1 - step)).refuted:
                self.proved = low * (1 - step)
                return
            step = 4 * step if step < 0.25 else 0.5 * (1 + step)
