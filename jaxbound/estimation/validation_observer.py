"""Data validation as an Observer: pieces of a recording as they come, each validated from where the one
before ended.
"""

import math
from typing import NamedTuple, TypeAlias

import jax
import numpy as np

from jaxbound.consistency.drive import end_to_end
from jaxbound.consistency.interface import Observer
from jaxbound.estimation.validation_result import Validation
from jaxbound.estimation.validation_slide import HostCarry, Slide, Stretch
from jaxbound.models.intervals import IntervalSystem, as_intervals
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.numbers import is_whole
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import around
from jaxbound.recordings.signals import SignalModel, Signals
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.text.objects import readable

ValidatedModel: TypeAlias = LinearSystem | IntervalSystem | MultiModel
SHORTEST = 16
"""Samples that a kernel is compiled for, at least."""


class ValidationState(NamedTuple):
    """The samples and the enclosure that an observer carries on.

    Fields: u, y: the last samples, at most 2 s; after: of the last window, None before the first; first:
    whether the first of these samples is the very first, of which x0 speaks.
    """

    u: np.ndarray
    y: np.ndarray
    after: HostCarry | None
    first: bool


@readable
class ValidationObserver(Observer[ValidationState]):
    """Encloses the state, finds the sensor that does not fit: `validate`, sample by sample.

    Args:
        model, horizon, method, x0, correction: as for `validate`; x0 is that of the very first sample.

    After a gap it begins anew, with the first complete window. What is said of a window is what `validate`
    says of the whole recording, up to the last digits: how large samples get is known up to now alone.

    Raises:
        ValueError: as `validate`.

    Encloses: as `validate`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)
        >>> observer = ValidationObserver(m)
        >>> y = np.tile(10 - 9 * 0.9 ** np.arange(8)[:, None], 2)
        >>> y[5, 1] += 2
        >>> carry, found = observer.init(), []
        >>> for k in range(8):
        ...     sample = Recording.of(observer.signals, np.ones((1, 1)), y[k : k + 1])
        ...     carry, judged = observer.fold(carry, sample)
        ...     found.append(judged.faulty[0].tolist())
        >>> found[5]
        [False, True]
    """

    horizon: int
    model: SignalModel

    def __init__(
        self,
        model: ValidatedModel,
        horizon: int | None = None,
        method: str = "joint",
        x0: Interval | None = None,
        correction: str = "interval",
    ) -> None:
        with where_proofs_hold(compiled=False):
            self.model, self._slide = _prepared(model, horizon, method, correction)
        self.horizon, self.x0, self.weight = self._slide.s, None, self._slide.weight
        if x0 is not None:
            self.x0 = interval(x0)
            if self.x0.shape[-1:] != (self._slide.m.n,):
                raise ValueError(
                    f"x0 needs one interval for each of {self._slide.m.n} states: its shape is "
                    f"{self.x0.shape}"
                )

    @property
    def informed(self) -> bool:
        """Whether it knows the first state of a recording."""
        return self.x0 is not None

    def init(self) -> ValidationState:
        """Return the state before the first sample."""
        m = self._slide.m
        return ValidationState(np.zeros((0, m.m), m.A.dtype), np.zeros((0, m.p), m.A.dtype), None, True)

    def fold(self, carry: ValidationState, piece: Recording) -> tuple[ValidationState, Validation]:
        """Take the next samples (T, .) of a recording, or recordings (..., T, .) that begin side by side, of
        which nothing is carried on; return (carry, Validation of these samples).

        Raises:
            ValueError: another type than that of the samples before, several recordings behind samples of
                one, inputs that are missing, first windows that do not bound the state.
        """
        piece.finite()
        # as recorded: what was rounded away, or is narrowed, counts
        *lead, T, _ = np.shape(piece.y)
        u, y, old, s = end_to_end(piece.u), end_to_end(piece.y), len(carry.y), self.horizon
        if old and carry.y.dtype != y.dtype:
            raise ValueError(
                f"y is in {y.dtype}, the samples before are in {carry.y.dtype}: a recording has one type"
            )
        if old and lead:
            raise ValueError(
                f"an observer goes on with one recording: y must have shape (T, {y.shape[-1]}), not "
                f"{np.shape(piece.y)}"
            )
        count, m = math.prod(lead), self._slide.m
        gone = np.concatenate([np.zeros(old, bool), _left_out(u, y, piece.excluded)])
        u = np.concatenate([carry.u.astype(u.dtype), u])
        y = np.concatenate([carry.y.astype(y.dtype), y])
        first = T * np.arange(count)
        seams = (old + first[:, None] + piece.starts).ravel()
        begins = np.unique(np.concatenate([first, seams, around(gone)])).astype(int)
        known = np.isin(begins, first) & ~np.append(gone, False)[begins] & self.informed & carry.first
        start = self.x0
        if start is not None and count:
            own = np.minimum(begins // max(T, 1), count - 1)
            start = jax.tree.map(lambda x: np.broadcast_to(x, (*lead, m.n)).reshape(-1, m.n)[own], start)
        whole, after = self._in_pieces(u, y, begins, start, known, carry.after, old)
        judged: Validation = jax.tree.map(lambda x: x[old:].reshape(*lead, T, *x.shape[1:]), whole)
        if lead:
            return self.init()._replace(first=False), judged
        waits = after is None and bool(known[-1])
        keep = int(begins[-1])
        if not waits:
            keep = max(len(y) - 2 * s, keep)
        return ValidationState(u[keep:], y[keep:], after, waits), judged

    def _in_pieces(
        self,
        u: np.ndarray,
        y: np.ndarray,
        begins: np.ndarray,
        start: Interval | None,
        known: np.ndarray,
        before: HostCarry | None,
        old: int,
    ) -> tuple[Validation, HostCarry | None]:
        """Validate pieces that follow each other, those of one length side by side.

        Args:
            u: (T, m). y: (T, p), as recorded. begins: the first sample of each piece, 0 that of the first.
            start: Interval (pieces, n), believed of the pieces that are `known`.
            before: of the first piece the carry behind so many `old` samples.

        Returns:
            (Validation of T samples, the carry behind the last one, None where its piece has no window).
        """
        s, m, T = self.horizon, self._slide.m, len(y)
        stops = np.append(begins[1:], T)
        whole = np.cumsum(np.append(0, ~np.isnan(y).any(-1)))
        complete = np.append(np.flatnonzero(whole[s + 1 :] - whole[: -s - 1] == s + 1), T)
        at = np.where(known, begins, complete[np.searchsorted(complete, begins)])
        fits, kinds = at + s < stops, known.astype(int)  # 2: goes on
        if before is not None:
            at[0], kinds[0], fits[0] = 0, 2, stops[0] > old
        # few lengths, so that few kernels are compiled
        lengths = np.maximum(list(map(power, (stops - at).tolist())), SHORTEST)
        ends_found = np.full((T, 2, m.n + 3 * m.p), np.inf, m.A.dtype)
        tested, blamed = np.zeros(T, bool), np.zeros((T, m.p + 1), bool)
        after = None
        if len(begins) == 1:
            after = before
        for kind, length in sorted(set(zip(kinds[fits].tolist(), lengths[fits].tolist(), strict=True))):
            chosen = np.flatnonzero(fits & (kinds == kind) & (lengths == length))
            rows = at[chosen, None] + np.arange(length)
            inside = rows < stops[chosen, None]
            rows = np.minimum(rows, stops[chosen, None] - 1)
            samples = np.where(inside[..., None], y[rows], np.nan).astype(m.A.dtype)
            stretch = Stretch(u[rows], samples, y.dtype, (stops - at)[chosen], s)
            if kind == 1 and start is not None:
                stretch = stretch._replace(start=start[chosen])
            if kind == 2:
                stretch = stretch._replace(first=old, before=before)
            behind, of_pieces, wrong = self._slide(stretch)
            judged = inside & (np.arange(length) >= stretch.first)
            places = rows[judged]
            ends_found[places], blamed[places], tested[places] = of_pieces[judged], wrong[judged], True
            if chosen[-1] == len(begins) - 1:
                after = jax.tree.map(lambda x: x[-1:], behind)
        return self._slide.validation(y, tested, ends_found, blamed), after


def _left_out(u: np.ndarray, y: np.ndarray, excluded: np.ndarray | None) -> np.ndarray:
    """Return (T,) bool: the samples of which nothing is known; they are like a gap. excluded: of each of some
    recordings that are laid end to end.

    Raises:
        ValueError: inputs that are missing beside a sample.
    """
    lacking = np.isnan(u).any(-1)
    gone = lacking & np.isnan(y).all(-1)
    if excluded is not None:
        gone |= np.resize(excluded, len(gone))
    if (lacking & ~gone).any():
        raise ValueError(f"validation needs every input: {int(np.isnan(u).sum())} samples of u are missing")
    return np.asarray(gone)


def _prepared(
    model: ValidatedModel, horizon: int | None, method: str, correction: str
) -> tuple[SignalModel, Slide]:
    """Return (the signals that are read, the Slide) of a model; `validate` says what is refused."""
    several = None
    if isinstance(model, MultiModel):
        several, m = model, model.joined()
    else:
        m = as_intervals(model)
    if method not in ("joint", "sequential"):
        raise ValueError(f"method must be 'joint' or 'sequential', not {method!r}")
    if correction not in ("interval", "centre"):
        raise ValueError(f"correction must be 'interval' or 'centre', not {correction!r}")
    if several is not None and method == "sequential":
        raise ValueError("a MultiModel has another matrix in every window: use method='joint'")
    s = horizon
    if s is None:
        s = least_horizon(m.n, m.p)
    if not is_whole(s) or s < 1:
        raise ValueError(f"horizon must be a whole number >= 1, not {s!r}")
    if method == "sequential" and s * m.p < m.n:
        raise ValueError(
            f"the square systems need a horizon of at least n / p ({-(-m.n // m.p)}), not {s}: see (9) of "
            f"the paper"
        )
    slide = Slide(several, m, int(s), method, centre=correction == "centre")
    if isinstance(model, MultiModel):  # its `columns` are a function
        return Signals(m.inputs, m.outputs, {}), slide
    return model, slide


def least_horizon(n: int, p: int) -> int:
    """Return the smallest s with s >= n / p and p (s + 1) > n, for n states and p outputs. Source: (9) of the
    paper, section 2.
    """
    s = max(-(-n // p), 1)
    if p * (s + 1) <= n:
        s += 1
    return s
