"""Data validation: where can the state be, which sensor does not fit, and what should it have said?

Every window is an interval linear system in its states (`models.intervals.stacked`). The states found so far,
propagated by the model, are a box; the newest samples are tested against it one by one and together; a sensor
that does not fit is left out from there on, and the interval that the state gives for its output stands in
for it.

What is promised: if the first window is fault-free (or x0 holds), the parameters are within bounds and every
faulty sample was found, the true state is inside. A fault too small to be proved is accepted, and may move
the enclosure past the true state. Nobody can promise more. In the first window the newest samples are tested
against its older ones; a fault in these is taken for the truth, until what comes contradicts it: then the
recording is marked FAULT, but sound sensors may be blamed.

Source: Alhaj-Dibo, Maquin, Ragot 2004.
"""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.estimation.counts import is_whole
from jaxbound.estimation.multiple import validate_parts
from jaxbound.estimation.validation_result import Validation, nothing_known
from jaxbound.estimation.validation_slide import Slide, Stretch, compiled_length
from jaxbound.models.intervals import IntervalSystem, as_intervals
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import around
from jaxbound.recordings.signals import SignalModel, Signals
from jaxbound.recordings.table import Data
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval

__all__ = ["Validation", "complete_windows", "least_horizon", "prepared_slide", "validate"]

ValidatedModel: TypeAlias = LinearSystem | IntervalSystem | MultiModel


@where_proofs_hold()
def validate(
    model: ValidatedModel,
    u: Data,
    y: Data = None,
    horizon: int | None = None,
    method: str = "joint",
    x0: Interval | None = None,
    correction: str = "interval",
    starts: ArrayLike = (),
) -> Validation:
    """Enclose the state over time, find the sensor that does not fit, and say what it should have shown.

    Args:
        model: `interval_system(...)`, a LinearSystem (uncertain parameters, tolerance, noise, disturbance; no
            unknown inputs), or a MultiModel (its .state holds the states of all sub-models; joint only,
            unless its partial outputs are measured).
        u: (..., T, m) or None. y: (..., T, p), or (..., T, L, p) for the partial outputs of a MultiModel;
            NaN: that sample is absent. Recordings on leading axes run side by side. Tables as for `detect`;
                partial outputs are called like "1.y1", "2.y1" there.
        horizon: s of windows of s + 1 samples; None: the smallest with s >= n / p and p (s + 1) > n.
        method: "joint": the newest samples, the older ones and the propagated state at once, by the hull of
            their linear programs. "sequential": the paper's square systems, one for each further row, against
            a reference; wider, faster.
        x0: Interval (..., n) that holds the first state. None: the first window is taken to be fault-free,
            and must be complete.
        correction: what stands in for a faulty sample. "interval": all that the state allows there. "centre":
            the middle of it, as if it had been measured; the paper's, and not a proof: the true state may be
            outside, `faulty` is a suspicion, and nothing is FAULT.
        starts: as for `detect`. What comes behind a gap is a recording of its own: it begins with its first
            complete window, taken to be fault-free; x0 is that of the first.

    Returns:
        A Validation.

    Encloses: every state of every behaviour within the bounds that gives the samples accepted as sound,
    rounding included; nothing with correction="centre".

    Raises:
        ValueError: shapes that do not fit, a first window that does not bound the state, an unknown method.
            TypeError: no model.

    Source: Alhaj-Dibo, Maquin, Ragot 2004, (6)-(11).

    Example:
        >>> from jaxbound import interval_system
        >>> m = interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)
        >>> y = np.tile(10 - 9 * 0.9 ** np.arange(8)[:, None], 2)
        >>> y[5, 1] += 2
        >>> validate(m, np.ones((8, 1)), y).faulty[5].tolist()
        [False, True]
    """
    if isinstance(model, MultiModel) and model.partial:
        validate_one = partial(validate, horizon=horizon, method=method, correction=correction)
        return validate_parts(model, u, y, x0, validate_one, starts)
    signals, slide = prepared_slide(model, horizon, method, correction)
    recording = Recording.of(signals, u, y, starts, narrow=False)
    inputs, outputs = np.asarray(recording.u), np.asarray(recording.y, slide.m.A.dtype)
    left_out = _left_out(inputs, outputs, recording.excluded)
    seams = np.asarray(recording.starts)
    if left_out.any():
        seams = np.union1d(seams, around(left_out))
    _refuse(inputs[..., ~left_out, :], outputs, seams, slide.s, has_first=x0 is not None)
    stretch = Stretch(inputs, outputs, recording.y.dtype, x0)
    if not len(seams):
        return slide(stretch)[0]
    return _piecewise(slide, stretch, seams, left_out)


def _left_out(u: np.ndarray, y: np.ndarray, excluded: np.ndarray | None) -> np.ndarray:
    """Return (T,) bool: the samples of which nothing is known in any recording; they are like a gap."""
    unknown = np.asarray(np.isnan(u).any(-1) & np.isnan(y).all(-1))
    left_out = np.asarray(unknown.reshape(-1, y.shape[-2]).all(0))
    if excluded is not None:
        left_out |= excluded
    return left_out


def _refuse(u: np.ndarray, y: np.ndarray, seams: np.ndarray, s: int, has_first: bool) -> None:
    """Raise ValueError for samples that cannot be validated. u: of the samples that are not left out."""
    T = y.shape[-2]
    if not np.isfinite(u).all():
        raise ValueError(
            f"validate needs every input: {(~np.isfinite(u)).sum()} samples of u are missing or infinite"
        )
    if np.isinf(y).any():
        raise ValueError(
            f"y must be numbers, or NaN where a sample is absent: {np.isinf(y).sum()} are infinite"
        )
    if T <= s:
        raise ValueError(f"horizon must be a whole number >= 1 with more samples than it ({T}), not {s!r}")
    gapless = not len(seams) or seams[0] > s
    if not has_first and gapless and np.isnan(y[..., : s + 1, :]).any():
        raise ValueError(
            f"the first {s + 1} samples must be complete, or x0 must say where the first state is"
        )


def prepared_slide(
    model: ValidatedModel, horizon: int | None, method: str, correction: str
) -> tuple[SignalModel, Slide]:
    """Return (the signals that are read, the Slide) of a model.

    Args:
        model, horizon, method, correction: as for `validate`, which says what is refused.
    """
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


def _piecewise(slide: Slide, stretch: Stretch, seams: np.ndarray, left_out: np.ndarray) -> Validation:
    """Validate each piece between gaps as a recording of its own; elsewhere every interval is entire."""
    u, y = stretch.u, stretch.y
    pieces = _pieces(y, stretch.x0 is not None, seams, left_out, slide.s)
    if not pieces:
        raise ValueError(
            f"no stretch of {slide.s + 1} complete samples in a row: the windows reach across gaps, or "
            f"samples are missing in all"
        )
    out = nothing_known(y.shape[:-1], slide.m.n, y.shape[-1], y.dtype)
    for (known, length), spans in pieces.items():
        rows = _rows_of(spans, length)
        some = Stretch(_stacked_pieces(u, rows), _filled_pieces(y, rows, spans), stretch.recorded)
        if known:
            some = some._replace(x0=stretch.x0)
        result, _ = slide(some)
        for to, values in zip(jax.tree.leaves(out), jax.tree.leaves(result), strict=True):
            _put(to, np.asarray(values), spans, y.ndim - 2)
    placed: Validation = jax.tree.map(jnp.asarray, out)
    return placed


Span: TypeAlias = tuple[int, int]
"""The first sample of a piece, and the one behind its last."""


def _pieces(
    y: np.ndarray, has_first: bool, seams: np.ndarray, left_out: np.ndarray, s: int
) -> dict[tuple[bool, int], list[Span]]:
    """Return {(whether x0 speaks of it, length that it is filled up to): pieces that can be validated}."""
    T = y.shape[-2]
    whole = (~np.isnan(y)).all(-1).reshape(-1, T).all(0)
    pieces: dict[tuple[bool, int], list[Span]] = {}
    for a, b in zip([0, *seams.tolist()], [*seams.tolist(), T], strict=True):
        if a == b or left_out[a]:
            continue
        known = has_first and a == 0
        begin = a
        if not known:
            complete = complete_windows(whole[a:b], s)
            if not complete.any():
                continue
            begin = a + int(complete.argmax())
        elif b - a <= s:
            continue
        pieces.setdefault((known, compiled_length(b - begin)), []).append((begin, b))
    return pieces


def complete_windows(whole: np.ndarray, s: int) -> np.ndarray:
    """Return bool: at which of T samples, whole (T,) or not, a window of s + 1 whole ones begins."""
    if len(whole) <= s:
        return np.zeros(0, bool)
    complete: np.ndarray = np.convolve(whole, np.ones(s + 1, int), "valid") == s + 1
    return complete


def _rows_of(spans: list[Span], length: int) -> np.ndarray:
    """Return (pieces, length): the samples of each piece, its last one again behind its end."""
    begins, stops = np.array(spans).T
    rows: np.ndarray = np.minimum(begins[:, None] + np.arange(length), stops[:, None] - 1)
    return rows


def _stacked_pieces(x: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return samples (pieces, ..., length, .) of pieces, from x (..., T, .)."""
    return np.moveaxis(x[..., rows, :], -3, 0)


def _filled_pieces(y: np.ndarray, rows: np.ndarray, spans: list[Span]) -> np.ndarray:
    """Return the outputs of pieces, absent behind their ends: no sample tells of those before it."""
    begins, stops = np.array(spans).T
    behind = np.arange(rows.shape[1]) >= (stops - begins)[:, None]
    behind = behind.reshape(len(spans), *[1] * (y.ndim - 2), rows.shape[1], 1)
    filled: np.ndarray = np.where(behind, np.nan, _stacked_pieces(y, rows)).astype(y.dtype)
    return filled


def _put(out: np.ndarray, values: np.ndarray, spans: list[Span], leading: int) -> None:
    """Write the values of pieces to their places in a recording, behind so many leading axes."""
    before = (slice(None),) * leading
    for of_piece, (a, b) in zip(values, spans, strict=True):
        out[(*before, slice(a, b))] = of_piece[(*before, slice(0, b - a))]


def least_horizon(n: int, p: int) -> int:
    """Return the smallest s with s >= n / p and p (s + 1) > n, for n states and p outputs. Source: (9) of the
    paper, section 2.
    """
    s = max(-(-n // p), 1)
    if p * (s + 1) <= n:
        s += 1
    return s
