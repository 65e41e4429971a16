"""Data validation as an Observer: pieces of a recording as they come, each validated from where the one
before ended.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxbound.consistency.interface import Observer
from jaxbound.estimation.validation import ValidatedModel, complete_windows, prepared_slide
from jaxbound.estimation.validation_result import Validation, nothing_known
from jaxbound.estimation.validation_slide import HostCarry, Stretch
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import around
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

__all__ = ["ValidationObserver", "ValidationState"]


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
        with where_proofs_hold():
            self.model, self._slide = prepared_slide(model, horizon, method, correction)
        self.horizon, self.x0 = self._slide.s, x0

    @property
    def informed(self) -> bool:
        """Whether it knows the first state of a recording."""
        return self.x0 is not None

    def init(self) -> ValidationState:
        """Return the state before the first sample."""
        m = self._slide.m
        return ValidationState(np.zeros((0, m.m), m.A.dtype), np.zeros((0, m.p), m.A.dtype), None, True)

    def fold(self, carry: ValidationState, piece: Recording) -> tuple[ValidationState, Validation]:
        """Take the next samples (T, .) of a recording; return (carry, Validation of these samples)."""
        piece.finite()
        # as recorded: what was rounded away, or is narrowed, counts
        u, y = np.asarray(piece.u), np.asarray(piece.y)
        gone = _refuse_piece(carry, u, y)
        seams = np.asarray(piece.starts)
        if gone.any():
            seams = np.union1d(seams, around(gone))
        parts = []
        for a, b in zip([0, *seams.tolist()], [*seams.tolist(), len(y)], strict=True):
            if a in seams:
                carry = self.init()._replace(first=False)
            if a < b and gone[a]:
                parts.append(self._nothing(b - a))
            elif a < b:
                carry, part = self._carried_on(carry, u[a:b], y[a:b])
                parts.append(part)
        if not parts:
            return carry, self._nothing(0)
        return carry, _one_after_the_other(*parts)

    def _carried_on(
        self, carry: ValidationState, u: np.ndarray, y: np.ndarray
    ) -> tuple[ValidationState, Validation]:
        """Take samples that follow those before."""
        s, new = self.horizon, len(y)
        if len(carry.y):
            u, y = np.concatenate([carry.u, u]), np.concatenate([carry.y, y])
        stretch = Stretch(u, y.astype(self._slide.m.A.dtype), y.dtype)
        if carry.after is not None:
            cut = len(y) - new - s
            stretch = stretch._replace(before=carry.after, earlier=stretch.y[:cut])
        elif carry.first and self.x0 is not None:
            if len(y) <= s:
                return carry._replace(u=u, y=y), self._nothing(new)
            cut = 0
            stretch = stretch._replace(x0=self.x0)
        else:
            complete = complete_windows((~np.isnan(y)).all(-1), s)
            if not complete.any():
                keep = max(len(y) - s, 0)
                first = carry.first and not keep
                return ValidationState(u[keep:], y[keep:], None, first), self._nothing(new)
            cut = int(complete.argmax())
        result, after = self._slide(stretch._replace(u=u[cut:], y=stretch.y[cut:]))
        result = jax.tree.map(lambda x: np.asarray(x)[max(len(x) - new, 0) :], result)
        lacking = new - len(result.status)
        if lacking:
            result = _one_after_the_other(self._nothing(lacking), result)
        keep = max(len(y) - 2 * s, 0)
        return ValidationState(u[keep:], y[keep:], after, False), result

    def _nothing(self, count: int) -> Validation:
        """Return a Validation of samples of which nothing is known."""
        m = self._slide.m
        return nothing_known((count,), m.n, m.p, m.A.dtype)


def _refuse_piece(carry: ValidationState, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (T,) bool: the samples of which nothing is known.

    Raises:
        ValueError: another type or shape than that of one recording, inputs that are missing.
    """
    if len(carry.y) and carry.y.dtype != y.dtype:
        raise ValueError(
            f"y is in {y.dtype}, the samples before are in {carry.y.dtype}: a recording has one type"
        )
    if y.ndim != 2:
        raise ValueError(
            f"an observer follows one recording: y must have shape (T, {y.shape[-1]}), not {y.shape}"
        )
    gone = np.isnan(u).any(-1) & np.isnan(y).all(-1)
    if (np.isnan(u).any(-1) & ~gone).any():
        raise ValueError(f"validation needs every input: {int(np.isnan(u).sum())} samples of u are missing")
    return np.asarray(gone)


def _one_after_the_other(*parts: Validation) -> Validation:
    """Return Validations of samples that follow each other as one."""
    whole: Validation = jax.tree.map(lambda *x: np.concatenate([np.asarray(v) for v in x]), *parts)
    return whole
