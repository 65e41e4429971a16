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

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.estimation.multiple import validate_parts
from jaxbound.estimation.validation_observer import ValidatedModel, ValidationObserver
from jaxbound.estimation.validation_result import Validation
from jaxbound.models.multimodel import MultiModel
from jaxbound.recordings.read import recorded
from jaxbound.recordings.table import Data
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval

__all__ = ["Validation", "validate"]


@where_proofs_hold(compiled=False)
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
        x0: Interval (..., n) that holds the first state. None: the first complete window is taken to be
            fault-free.
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
        ValueError: shapes that do not fit, a first window that does not bound the state or is never complete,
            an unknown method. TypeError: no model.

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
    observer = ValidationObserver(model, horizon, method, x0, correction)
    recording = recorded(observer.signals, u, y, starts, narrow=False)
    with sparing():
        _, found = observer.either_way(partial(observer.fold, observer.init(), recording), recording)
    if not np.isfinite(found.state.lo).any():
        raise ValueError(
            f"no stretch of {observer.horizon + 1} complete samples in a row: choose a shorter horizon, or a "
            f"recording with fewer gaps"
        )
    return found
