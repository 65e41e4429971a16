"""The smallest factor on given bounds at which every healthy window is explained, enclosed between two
verdicts of the proved test.

Along a ray of bounds the sets of explanations grow, so a window that is explained at one factor is explained
at every larger one. The factor of a recording is that of its worst window; a few windows that are worst
somewhere are searched, then all are tested again.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.diagnosis.detection import detect, margins
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.arrays import holds_both
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import crossing
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning.parametrization import Moving

__all__ = ["JoinedRecordings", "factors", "smallest_scale", "worst", "joined_recordings"]

FEW = 16  # worst windows that a test of all adds to those searched
LEAST, MOST = 1e-12, 1e15  # factors looked at
NEAR_ONE = 0.999999  # of a tolerance


@dataclass(frozen=True)
class JoinedRecordings:
    """Recordings laid end to end.

    Fields: u (T, m), y (T, p) NumPy; starts: samples (0 apart) that do not follow the one before; first:
    where each recording begins.
    """

    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray
    first: np.ndarray

    def across(self, horizon: int) -> np.ndarray:
        """Return (T,) bool: no window of horizon + 1 samples ends here."""
        return crossing([0, *self.starts], horizon, 0, len(self.y))

    def without(self, horizon: int) -> np.ndarray:
        """Return (T,) bool: no window ends here, or one in which nothing at all was measured."""
        seen = np.cumsum(np.append(0, ~np.isnan(self.y).all(1)))
        empty = np.ones(len(self.y), bool)
        empty[horizon:] = (
            seen[horizon + 1 :] == seen[: len(self.y) - horizon] if len(self.y) > horizon else True
        )
        return empty | self.across(horizon)

    def gather(self, ends: ArrayLike, horizon: int) -> tuple[np.ndarray, np.ndarray]:
        """Return u (N, s + 1, m), y (N, s + 1, p) of the windows that end at these samples."""
        at = np.asarray(ends)[:, None] + np.arange(-horizon, 1)
        return self.u.take(at, 0), self.y.take(at, 0)

    def place(self, end: int) -> str:
        """Return words for the sample at which a window ends."""
        number = int(np.searchsorted(self.first, end, "right")) - 1
        return f"sample {end - self.first[number]}" + (
            f" of recording {number + 1}" if len(self.first) > 1 else ""
        )


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
    several = [
        one if isinstance(one, tuple) else (one,) for one in (given if isinstance(given, list) else [given])
    ]
    if not several or not all(
        len(one) in (2, 3) or (len(one) == 1 and holds_both(one[0])) for one in several
    ):
        raise ValueError(
            f"{what} needs a tuple (u, y) or a list of such tuples, one a recording; (u, y, starts) where "
            f"samples are lost"
        )
    us, ys, starts, first, at = [], [], [], [], 0
    for one in several:
        given_one = Recording.of(model, *one).finite()
        u, y, length, seams = given_one.u, given_one.y, given_one.y.shape[-2], given_one.starts
        u, y = (np.asarray(x).reshape(int(np.prod(x.shape[:-1])), x.shape[-1]) for x in (u, y))
        for begin in range(at, at + len(y), max(length, 1)):
            first.append(begin)
            starts += [begin, *(begin + seams)]
        at += len(y)
        us.append(u)
        ys.append(y)
    inner = np.unique(np.array([s for s in starts if 0 < s < at], np.int64))
    found = JoinedRecordings(np.concatenate(us), np.concatenate(ys), inner, np.array(first))
    if found.without(horizon).all():
        raise ValueError(
            f"the {what} data hold no window of {horizon + 1} samples in a row: give longer recordings, or a "
            f"shorter horizon"
        )
    return found


def factors(relations: ParityRelation | UncertainRelations, windows: JoinedRecordings) -> np.ndarray:
    """Return (T,) the factors t = 1 - margin of all windows, NaN where there is none or it has no data."""
    if isinstance(relations, UncertainRelations):  # the test gives the windows that it leaves open no size
        t = 1 - np.asarray(margins(relations, windows.u, windows.y))
        return np.where(windows.across(relations.horizon), np.nan, t)
    return 1 - detect(relations, windows.u, windows.y, starts=windows.starts).margin


def worst(t: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers of the `count` largest entries that are not NaN, the largest first."""
    t = np.where(np.isnan(t), -np.inf, t)
    top = np.argpartition(t, -count)[-count:] if count < len(t) else np.arange(len(t))
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
    limit = min(MOST, NEAR_ONE / values[tolerances].max()) if tolerances.any() else MOST
    uncertain = isinstance(relations, UncertainRelations)

    def judge(scale, u, y, starts=()):
        """Return (accepted, refuted, the worst factor t, margins)."""
        res = detect(relations.with_bounds(moved.bounds(scale * values)), u, y, starts=starts)
        refuted = bool((res.status == Status.FAULT).any())
        least = float(np.nanmin(res.margin, initial=1.0))
        return (not refuted if uncertain else least > 0), refuted, 1 - least, res.margin

    few, low, scale, close = (
        np.zeros(0, np.int64),
        0.0,
        min(1.0, limit),
        64 * float(np.finfo(windows.y.dtype).eps),
    )
    grow = close
    while True:
        accepted, _, _, margin = judge(scale, windows.u, windows.y, windows.starts)
        if len(few) and accepted:
            return low * (1 - LEAST), scale  # the test was of bounds within a rounding of low
        before = few
        few = np.union1d(few, worst(-margin, FEW))
        if not len(few):
            raise ValueError("no healthy window has any data: all are MISSING")
        batch = windows.gather(few, relations.horizon)
        found = _root(lambda x, batch=batch: judge(x, *batch)[:3], scale, limit, close)
        if isinstance(found, str):
            _refuse(found, moved, values, windows, int(few[np.argmin(_last(judge(limit, *batch)[3]))]))
        low, high = found
        scale, grow = (
            (max(high, scale * (1 + grow)), 4 * grow) if len(before) else (high, close)
        )  # a search may end otherwise in company


def _last(margin):
    """Return the margins of windows that were a recording each."""
    return np.nan_to_num(margin[..., -1], nan=np.inf)


def _refuse(why, moved, values, windows, end):
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


def _root(judge, x, limit, close):
    """Return (low, high): refuted at low, accepted at high, relatively `close`; "nothing" or "never" where
    there is no such pair.

    judge: factor -> (accepted, refuted, t). In the usual case t is inversely proportional to the factor: the
    secant of log t over log x lands on the crossing, and both sides of it are tried.
    """
    low, high, proved = (
        (0.0, math.inf),
        (math.inf, -math.inf),
        0.0,
    )  # (factor, log t), and the largest factor that is refuted

    def look(at):
        nonlocal low, high, proved
        accepted, refuted, t = judge(at)
        proved = max(proved, at if refuted else 0.0)
        if accepted:
            high = min(high, (at, min(math.log(max(t, 1e-300)), -1e-300)))
        else:
            low = max(low, (at, math.log(max(t, 1.0))))
        return t

    while high[0] == math.inf:
        t = look(x)
        if high[0] == math.inf:
            if x >= limit:
                return "never"
            x = min(limit, x * (min(t * (1 + close), 1e3) if t > 1 + close else 2))
    while low[0] == 0:
        if x < LEAST:
            return "nothing"
        x *= max(t * (1 - close), 1e-3) if t < 1 - 2 * close else 0.5
        t = look(x)
    while high[0] > low[0] * (1 + close):
        span, reach = math.log(high[0] / low[0]), close / 4
        guess = low[0] * math.exp(span * low[1] / (low[1] - high[1]))
        while reach < span:
            for at in (guess * (1 - reach), guess * (1 + reach)):
                if low[0] < at < high[0]:
                    look(at)
            if low[0] < guess < high[0]:  # it lies between two factors that were tried
                break
            reach *= 64
        if math.log(high[0] / low[0]) > 0.5 * span:
            look(math.sqrt(low[0] * high[0]))
    step = close
    while proved < low[0] * (1 - step):  # what is neither accepted nor refuted lies between them
        if judge(low[0] * (1 - step))[1]:
            return low[0] * (1 - step), high[0]
        step = 4 * step if step < 0.25 else 0.5 * (1 + step)
    return proved, high[0]
