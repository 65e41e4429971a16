"""Faults that a settled set observer sees: from one recording without any error, since an observer adds up
linearly.

The sets of an observer move with the data, but their widths and the gains depend on the bounds alone (without
tolerances). So a fault of size f shifts what each sample is off by f phi, in units of what its set and its
bounds allow; errors within the bounds shift it by 1 at most. f phi > 2 is always seen, f phi < 1 never is
where the errors happen to be 0. phi is measured on one recording that lies in the middle of all bounds, with
a small fault: each FAULT is a proof, these sizes are numbers in floats.
"""

from typing import Any

import numpy as np

from jaxbound.consistency.drive import drive
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import model_matrices
from jaxbound.recordings.recording import Recording

LEAST, MOST = 100, 3000
"""Samples before the fault, in which the observer settles, and with it."""
STEADY = 1 - 1e-9
"""Magnitude of a pole from which on it counts as one that remembers for ever."""
SMALL = 1e-2
"""Shift of a reading, in units of its bounds, by the fault that is tried."""


def shifts(watch: SetObserver[Any], fault: Fault) -> np.ndarray:
    """Return phi (T,) of the samples since the onset of a bias or a drift of size 1: how far each is off, in
    units of what is allowed.

    Args:
        watch: of a LinearSystem without tolerances or uncertainties. fault: kind "bias", or "drift" (its size
            is a sample's).

    Raises:
        NotImplementedError: other models, other kinds.
    """
    model = watch.model
    if fault.kind not in ("bias", "drift"):
        raise NotImplementedError(
            f"what an observer sees of a fault of kind {fault.kind!r} is counted by jb.study, not worked out"
        )
    if getattr(watch, "hulls", True):
        raise NotImplementedError(
            f"what a {type(watch).__name__} sees is counted by jb.study, not worked out: its sets move with "
            f"the data"
        )
    if not isinstance(model, LinearSystem) or model.uncertainties or any(model.tolerance):
        raise NotImplementedError(
            "sizes that an observer sees are worked out for certain models without tolerances: others by "
            "jb.study"
        )
    settle = _settled(model)
    level = max(map(float, watch.bounds["noise"])) or 1.0
    size, since = SMALL * level, np.arange(2 * settle) - settle
    grown: np.ndarray = np.ones(len(since))  # the fault in units of its size
    if fault.kind == "drift":
        size, grown = size * (1 / settle), since + 1.0
    course = np.where(since < 0, 0.0, size * grown)
    u, y = _recorded(model, fault, course)
    margin = np.asarray(drive(watch.telling(enclosures=False), Recording.of(watch.signals, u, y)).margin)
    return np.where(np.isnan(margin), 0.0, 1 - margin)[settle:] / size


def _settled(model: LinearSystem) -> int:
    """Return the samples in which an observer of a plant settles: six of its slowest time constants."""
    steady = [slow for slow in time_constants(model) if slow < np.inf]
    return int(np.clip(6 * max(steady, default=1.0), LEAST, MOST))


def time_constants(model: LinearSystem) -> list[float]:
    """Return the time constants of a plant in samples; inf of a pole that integrates or is unstable."""
    if not model.n:
        return []
    poles = np.abs(np.linalg.eigvals(np.array(model.A, float)))
    poles = poles[poles > 0]
    return list(np.where(poles > STEADY, np.inf, -1 / np.log(np.minimum(poles, STEADY))).tolist())


def _recorded(model: LinearSystem, fault: Fault, course: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (u, y) of a plant in the middle of all its bounds, with a fault of this course in time."""
    A, B, C, D, G = model_matrices(model, "ABCDG")
    total = len(course)
    acts = np.zeros((total, model.m))  # what the actuators do beside u
    if fault.signal in model.inputs:
        acts[:, model.inputs.index(fault.signal)] = course
    middle = np.zeros(model.n)
    if model.g:
        middle = G @ np.array([float(lo + hi) / 2 for lo, hi in model.disturbance])
    x, y = np.zeros(model.n), np.zeros((total, model.p))
    for k in range(total):
        y[k] = C @ x
        x = A @ x
        if model.m:
            y[k] += D @ acts[k]
            x = x + B @ acts[k]
        x = x + middle
    if fault.signal in model.outputs:
        y[:, model.outputs.index(fault.signal)] += course
    u = np.zeros((total, model.m)) + np.array(model.offset["u"], float)
    return u, y + np.array(model.offset["y"], float)


def least_seen(watch: SetObserver[Any], fault: Fault) -> tuple[float, int, np.ndarray]:
    """Return (size that is always seen, samples until then, phi) of a fault in a settled observer; inf, 0
    where none is.
    """
    phi = shifts(watch, fault)
    best = int(np.argmax(phi))
    if phi[best] <= 0:
        return float("inf"), 0, phi
    return 2 / float(phi[best]), best, phi
