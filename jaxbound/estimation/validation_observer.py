"""Data validation as an Observer: pieces of a recording as they come, each validated from where the one
before ended.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.consistency.interface import Observer
from jaxbound.estimation.validation import Validation, nothing_said, prepared
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import around
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

__all__ = ["ValidationObserver", "ValidationState"]


class ValidationState(NamedTuple):
    """The samples and the enclosure that an observer carries on.

    Fields: u, y: the last samples, at most 2 s; after: of the last
    window, None before the first;
    first: whether the first of these samples is the very first, of which x0 speaks.
    """

    u: np.ndarray
    y: np.ndarray
    after: Any
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
        model: Any,
        horizon: int | None = None,
        method: str = "joint",
        x0: Interval | None = None,
        correction: str = "interval",
    ) -> None:
        refuse_unverified()
        self.signals, self._slide = prepared(model, horizon, method, correction)
        self.model = self.signals
        self.horizon, self.x0 = self._slide.s, x0

    def init(self) -> ValidationState:
        """Return the state before the first sample."""
        m, dtype = self._slide.m, self._slide.m.A.dtype
        return ValidationState(
            np.zeros((0, m.B.shape[1]), dtype), np.zeros((0, m.C.shape[0]), dtype), None, True
        )

    def fold(self, carry: ValidationState, piece: Recording) -> tuple[ValidationState, Validation]:
        """Take the next samples (T, .) of a recording; return (carry, Validation of these samples)."""
        piece.finite()
        u, y = (
            np.asarray(piece.u),
            np.asarray(piece.y),
        )  # as recorded: what was rounded away, or is narrowed, counts
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
            raise ValueError(
                f"validation needs every input: {int(np.isnan(u).sum())} samples of u are missing"
            )
        seams = np.union1d(piece.starts, around(gone)) if gone.any() else piece.starts
        parts = []
        for a, b in zip([0, *seams.tolist()], [*seams.tolist(), len(y)], strict=True):
            carry = self.init()._replace(first=False) if a in seams else carry
            if a < b and gone[a]:
                parts.append(self._nothing(b - a))
            elif a < b:
                carry, found = self._on(carry, u[a:b], y[a:b])
                parts.append(found)
        if not parts:
            return carry, self._nothing(0)
        return carry, jax.tree.map(lambda *x: np.concatenate([np.asarray(v) for v in x]), *parts)

    def _on(self, carry, u, y):
        """Take samples that follow those before."""
        s, new = self.horizon, len(y)
        u, y = (np.concatenate([a, b]) if len(a) else b for a, b in ((carry.u, u), (carry.y, y)))
        slide, exact = partial(self._slide, recorded=y.dtype), y.astype(self._slide.m.A.dtype)
        known = carry.first and self.x0 is not None
        if carry.after is not None:
            cut = len(y) - new - s
            found, after = slide(u[cut:], exact[cut:], before=carry.after, earlier=exact[:cut])
        else:
            whole = (~np.isnan(y)).all(-1)
            ready = (
                np.convolve(whole, np.ones(s + 1, int), "valid") == s + 1 if len(y) > s else np.zeros(0, bool)
            )
            if not (ready.any() or (known and len(y) > s)):
                keep = 0 if known else max(len(y) - s, 0)
                return ValidationState(u[keep:], y[keep:], None, carry.first and not keep), self._nothing(new)
            cut = 0 if known else int(ready.argmax())
            found, after = slide(u[cut:], exact[cut:], x0=self.x0 if known else None)
        keep = max(len(y) - 2 * s, 0)
        said = jax.tree.map(lambda x: np.asarray(x)[max(len(x) - new, 0) :], found)
        lacking = new - len(said.status)
        if lacking:
            said = jax.tree.map(lambda *x: np.concatenate(x), self._nothing(lacking), said)
        return ValidationState(u[keep:], y[keep:], after, False), said

    def _nothing(self, count):
        m = self._slide.m
        return nothing_said((count,), m.n, m.C.shape[0], m.A.dtype)
