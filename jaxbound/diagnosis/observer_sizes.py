"""Which faults does a settled set observer see? From one recording without any error, since what an observer
adds up is linear.

The sets of an observer move with the data, but their widths and the gains depend on the bounds alone (without
tolerances). So a fault of size f shifts what each sample is off by f phi, in units of what its set and its
bounds allow; errors within the bounds shift it by 1 at most. f phi > 2 is always seen, f phi < 1 never is
where the errors happen to be 0. phi is measured on one recording that lies in the middle of all bounds, with
a small fault: each FAULT is a proof, these sizes are numbers in floats.
"""

from typing import Any

import numpy as np

from jaxbound.consistency.drive import drive
from jaxbound.estimation.set_observer import SetObserver, ZonotopeObserver
from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording

__all__ = ["least_seen", "shifts"]

LEAST, MOST = 100, 3000
"""Samples before the fault, in which the observer settles, and with it."""
SMALL = 1e-2
"""Shift of a reading, in units of its bounds, by the fault that is tried."""


def shifts(watch: SetObserver, fault: Fault) -> np.ndarray:
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
    if not isinstance(watch, ZonotopeObserver):
        raise NotImplementedError(
            f"what a {type(watch).__name__} sees is counted by jb.study, not worked out: its sets move with "
            f"the data"
        )
    if not isinstance(model, LinearSystem) or model.uncertainties or any(model.tolerance):
        raise NotImplementedError(
            "sizes that an observer sees are worked out for certain models without tolerances: others by "
            "jb.study"
        )
    A, B, C, D, G = (
        np.array(getattr(model, name), float).reshape(len(getattr(model, name)), -1) for name in "ABCDG"
    )
    poles = np.abs(np.linalg.eigvals(A)) if model.n else np.zeros(0)
    slow = max([-1 / np.log(p) for p in poles if 0 < p < 1 - 1e-9], default=1.0)
    count = int(np.clip(6 * slow, LEAST, MOST))
    inside, total = fault.signal in model.outputs, 2 * count
    level = max(float(x) for x in watch.bounds["noise"]) or 1.0
    size = SMALL * level * (1 if fault.kind == "bias" else 1 / count)
    grown = np.where(
        np.arange(total) < count, 0.0, size * (1 if fault.kind == "bias" else np.arange(total) - count + 1)
    )
    middle = (
        G @ np.array([float(lo + hi) / 2 for lo, hi in model.disturbance]) if model.g else np.zeros(model.n)
    )
    x, y = np.zeros(model.n), np.zeros((total, model.p))
    acts = np.zeros((total, model.m))
    if not inside:
        acts[:, model.inputs.index(fault.signal)] = grown
    for k in range(total):
        y[k] = C @ x + (D @ acts[k] if model.m else 0)
        x = A @ x + (B @ acts[k] if model.m else 0) + middle
    if inside:
        y[:, model.outputs.index(fault.signal)] += grown
    offset = {name: np.array([float(v) for v in model.offset[name]]) for name in "uy"}
    given = Recording.of(watch.signals, np.zeros((total, model.m)) + offset["u"], y + offset["y"])
    margin = np.asarray(drive(watch.telling(enclosures=False), given).margin)[count:]
    return np.where(np.isnan(margin), 0.0, 1 - margin) / size


def least_seen(watch: SetObserver, fault: Fault) -> tuple[float, int, Any]:
    """Return (size that is always seen, samples until then, phi) of a fault in a settled observer; inf, 0
    where none is.
    """
    phi = shifts(watch, fault)
    best = int(np.argmax(phi))
    return (float("inf"), 0, phi) if phi[best] <= 0 else (2 / float(phi[best]), best, phi)
