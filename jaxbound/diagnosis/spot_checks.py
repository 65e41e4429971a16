"""A second opinion: windows drawn at random from what an accelerator judged are judged again on the CPU."""

import jax
import numpy as np

from jaxbound.consistency.searched import NOT_REFUTED, judging_device
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.hints import device_hints
from jaxbound.diagnosis.result import Result
from jaxbound.sets.floats.status import Status

__all__ = ["COUNT", "again_hints", "again_said", "decided_again", "judged_elsewhere"]

COUNT = 1000


def decided_again(res: Result, count: int = COUNT, seed: int = 0) -> int:
    """Decide windows of a Result again on the CPU.

    Args:
        res: a Result of windows. count: how many windows, drawn at random from those with data. seed: of the
            draw.

    Returns:
        How many were decided again; 0 for an observer, whose verdicts rest on all samples before.

    Raises:
        RuntimeError: a window is FAULT in one place and CONSISTENT in the other. UNDECIDED contradicts
            nothing.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> decided_again(jb.detect(jb.parity_relations(m), None, [[1.0], [0.5], [0.9]]))
        2
    """
    relations = res.relations
    if relations.remembers:
        return 0
    status = np.asarray(res.status)
    tested = np.argwhere(status != Status.MISSING)
    some = tested[np.random.default_rng(seed).permutation(len(tested))[:count]]
    if not len(some):
        return 0
    *recordings, ends = some.T
    samples = (*(i[:, None] for i in recordings), ends[:, None] + np.arange(-relations.horizon, 1))
    u, y = np.asarray(res.u)[samples], np.asarray(res.y)[samples]
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        second = np.asarray(detect(relations, u, y, method=res.method).status)[:, -1]
    first = status[tuple(some.T)]
    wrong = _proved(first) & _proved(second) & (first != second)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise RuntimeError(
            f"{int(wrong.sum())} of {len(some)} windows were decided otherwise on the CPU, first the one "
            f"that ends at {int(ends[k])}: {Status(int(first[k])).name}, there "
            f"{Status(int(second[k])).name}: this device proves nothing, run with JAX_PLATFORMS=cpu and "
            f"please report it"
        )
    return len(some)


def _proved(status: np.ndarray) -> np.ndarray:
    return np.isin(status, (Status.FAULT, Status.CONSISTENT))


def again_hints(res: Result) -> tuple[str, ...]:
    """Return the sentence of a report on windows that were decided again; none where the CPU judged all of
    them. See `decided_again`.
    """
    devices = judged_elsewhere()
    if not devices:
        return ()
    if NOT_REFUTED in devices:  # nothing of it is believed that the host has not proved
        return again_said(devices, 0)
    return again_said(devices, decided_again(res))


def judged_elsewhere() -> str:
    """Return the devices that judge windows, in words; "" where these are CPUs alone."""
    return judging_device()


def again_said(devices: str, count: int) -> tuple[str, ...]:
    """Return the sentence on so many windows that were judged on devices and decided again; none if there are
    no such.
    """
    if hints := device_hints(devices):
        return hints
    if not count:
        return ()
    return (
        f"judged on {devices}; {count} windows drawn at random were decided again on the CPU, and none "
        f"differs",
    )
