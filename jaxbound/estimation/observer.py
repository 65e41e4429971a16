"""Observers at the door: `observer` builds one of a model, `observe` follows a recording with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.drive import drive
from jaxbound.estimation.methods import ObserverMethod, observer_method
from jaxbound.estimation.observation import Observation
from jaxbound.estimation.observed_plant import ObservedModel, observed_plant
from jaxbound.estimation.set_observer import SetObserver, ZonotopeObserver
from jaxbound.estimation.zonotope_numbers import first_set
from jaxbound.recordings.table import Data
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.zonotopes.zonotope import Zonotope

ORDER = 20.0
WEIGHTS = (1.0, 30.0, 1000.0)
"""Sets side by side where nothing else is asked for: one for faults that are sudden, two for those that last
or grow slowly.
"""


@where_proofs_hold(compiled=False)
def observer(
    model: ObservedModel,
    method: str | ObserverMethod = "zonotope",
    order: float = ORDER,
    weight: float | Sequence[float] = WEIGHTS,
    restart: bool = True,
    x0: Interval | Zonotope | None = None,
    horizon: int | None = None,
    window: int | None = None,
) -> SetObserver[Any]:
    """Return an observer of a model, for `observe`, `detect`, `Monitor` and the shell.

    Args:
        model: a LinearSystem (uncertain parameters, tolerance, noise, disturbance, unknown inputs) or an
            `interval_system`. Unknown inputs are taken out of each sample by as many outputs as show them,
            the rest is tested. States that they move unseen are entire ("joint" refuses these). A sample with
            too few outputs for it ends the enclosure. Bounds of averages are used by "joint" alone, of runs
            that lie in a window and without unknown inputs; the others look at single samples.
        method: "zonotope", fast. "strips": one set, least after every sample, whatever weight is. "joint":
            with the zonotopes, every window of up to `window` samples is tested exactly, its first state
            within the set that the samples before it allow: sees faults that last or grow slowly almost as
            well as all samples together could, and costs .3 to 5 milliseconds a sample. With x0 it says
            CONSISTENT where it has a trajectory through all samples. Or its options as a value:
            `Joint(window=16)`, of `jaxbound.estimation`.
        order: generators of the zonotope for each state, >= 1: more is sharper and slower.
        weight: of the samples' bounds in the gain, > 0. 1 makes the set least, in the sum of squares of its
            generators; above 1 the observer believes a sample less and remembers longer, so that lasting and
            slow faults show. Several numbers: as many sets side by side, whose verdicts and intervals hold
            together; they cost as much more.
        restart: True: the sample after a contradiction begins anew, MISSING until the state is known again.
            False: a FAULT stays until a gap, since a contradiction holds for good.
        x0: Interval (n,) or Zonotope that holds the state at the very first sample; it need not be narrow.
            None: it can be anything, and is found from the first horizon + 1 samples in a row that are whole.
        horizon: of these; None: the least that shows all states.
        window: of a method that is given as "joint": samples, even; None: 32. Others take no notice.

    Raises:
        ValueError: states that the outputs do not show and no x0, an x0 that is not bounded or does not fit,
            an order below 1, a weight that is not positive; unknown inputs that explain whatever the outputs
            show, or with parameters that act on C; an unknown method, options that it refuses.
        TypeError: no model.

    Encloses: every state of every behaviour within the bounds that explains all samples since it began.

    Source: Alamo, Bravo, Camacho 2005; Combastel 2015; Girard 2005; see `zonotope_steps`. Unknown inputs:
    `models.unknown_directions`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1]], noise=0.1, disturbance=([[1]], 0.01))
        >>> found = jb.detect(jb.observer(m), [[1.0]] * 4, [[0.0], [1.0], [1.9], [5.0]])
        >>> [jb.Status(s).name for s in found.status]
        ['MISSING', 'UNDECIDED', 'UNDECIDED', 'FAULT']
    """
    options = observer_method(method, window=window)
    if not order >= 1:
        raise ValueError(f"the order of an observer must be at least 1: it is {order!r}")
    plant = observed_plant(model, horizon, x0 is not None)
    first = None
    if x0 is not None:
        first = first_set(x0, model.n, float(order), plant.dtype)
    weights = _checked_weights(weight)
    return options.observer(
        ZonotopeObserver(plant=plant, order=float(order), weights=weights, restart=bool(restart), x0=first)
    )


def _checked_weights(weight: float | Sequence[float]) -> np.ndarray:
    """Return weights (k,), k at least 1.

    Raises:
        ValueError: others than positive numbers.
    """
    weights = np.atleast_1d(np.asarray(weight, np.float64))
    positive = (weights > 0) & np.isfinite(weights)
    if weights.ndim > 1 or not len(weights) or not positive.all():
        raise ValueError(f"weight must be a positive number, or several: it is {weight!r}")
    return weights


@where_proofs_hold(compiled=False)
def observe(
    model: ObservedModel,
    u: Data,
    y: Data = None,
    order: float = ORDER,
    weight: float | Sequence[float] = WEIGHTS,
    restart: bool = True,
    x0: Interval | Zonotope | None = None,
    horizon: int | None = None,
    starts: ArrayLike = (),
    method: str | ObserverMethod = "zonotope",
    window: int | None = None,
) -> Observation:
    """Enclose the state at every sample by all samples since the start, and prove where nothing is left.

    Args:
        model, method, order, weight, restart, x0, horizon, window: as for `observer`.
        u: (..., T, m) or None.
        y: (..., T, p), tables as for `detect`; recordings on leading axes run side by side. A missing output
            says nothing; a missing input begins anew.
        starts: as for `detect`: the observer begins anew there.

    Returns:
        An Observation.

    Raises:
        ValueError: as `observer`, and shapes that do not fit. RuntimeError: where rounding has not been
            verified.

    Encloses: as `observer`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1]], noise=0.1, disturbance=([[1]], 0.01))
        >>> jb.observe(m, [[1.0]] * 4, [[0.0], [1.0], [1.9], [5.0]]).predicted.hi[3].round(2)
        array([2.81])
    """
    built = observer(model, method, order, weight, restart, x0, horizon, window)
    watch, recording = built.telling(enclosures=True).recording(u, y, starts)
    with sparing():
        observation: Observation = drive(watch, recording)
    return observation
