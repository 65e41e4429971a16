"""A second opinion: windows drawn at random from what an accelerator judged are judged again on the CPU."""

from typing import Any

import jax
import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.sets.floats.probe import usable_devices
from jaxbound.sets.floats.status import Status

__all__ = ["COUNT", "again_hints", "again_said", "decided_again", "judged_elsewhere"]

COUNT = 1000


def decided_again(res: Any, count: int = COUNT, seed: int = 0) -> int:
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
    if res.relations.remembers:
        return 0
    s, status = res.relations.horizon, np.asarray(res.status)
    known = np.argwhere(status != Status.MISSING)
    some = known[np.random.default_rng(seed).permutation(len(known))[:count]]
    if not len(some):
        return 0
    *where, end = some.T
    cut = lambda x: np.asarray(x)[(*(i[:, None] for i in where), end[:, None] + np.arange(-s, 1))]
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        second = np.asarray(detect(res.relations, cut(res.u), cut(res.y), method=res.method).status)[:, -1]
    first = status[tuple(some.T)]
    proved = lambda x: (x == Status.FAULT) | (x == Status.CONSISTENT)
    wrong = proved(first) & proved(second) & (first != second)
    if wrong.any():
        k, names = (
            tuple(map(int, some[np.argmax(wrong)])),
            [Status(int(x[np.argmax(wrong)])).name for x in (first, second)],
        )
        raise RuntimeError(
            f"{int(wrong.sum())} of {len(some)} windows were decided otherwise on the CPU, first the one "
            f"that ends at {k[-1]}: {names[0]}, "
            f"there {names[1]}: this device proves nothing, run with JAX_PLATFORMS=cpu and please report it"
        )
    return len(some)


def again_hints(res: Any) -> tuple[str, ...]:
    """Return the sentence of a report on windows that were decided again; none where the CPU judged all of
    them. See `decided_again`.
    """
    devices = judged_elsewhere()
    return again_said(devices, decided_again(res)) if devices else ()


def judged_elsewhere() -> str:
    """Return the kinds of devices that judge, as text; "" where these are CPUs alone."""
    devices = {device.platform for device in usable_devices()}
    return "" if devices == {"cpu"} else ", ".join(sorted(devices))


def again_said(devices: str, count: int) -> tuple[str, ...]:
    """Return the sentence on so many windows that were judged on devices and decided again; none if there are
    no such.
    """
    return (
        (
            f"judged on {devices}; {count} windows drawn at random were decided again on the CPU, and none "
            f"differs",
        )
        if count
        else ()
    )
