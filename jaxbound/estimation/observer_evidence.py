"""Certificates of set observers: which window of the last samples proves a FAULT of theirs."""

from typing import Any

import numpy as np

from jaxbound.certificates.interface import evidence
from jaxbound.certificates.long_window import exceeds, stretch
from jaxbound.consistency.drive import drive
from jaxbound.estimation.observer import SetObserver
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.status import Status

__all__: list[str] = []

LONGEST, SHORT, CLEARLY = 512, 8, 1 + 1e-6
"""Steps of the longest window that a certificate speaks of, of the longest of parity relations, and the
factor it must be beyond.
"""


@evidence.register
def _window(
    observer: SetObserver, result: Any, at: tuple, status: Status
) -> tuple[Any, str, np.ndarray, np.ndarray]:
    """Return (relations, method, u, y) of the shortest of some windows that end at a sample and prove its
    FAULT.

    A chain of sets is long and nobody reads it; most contradictions show in the last samples. Tried are 2, 3,
    5, 9, .. of them, up to all since the observer began. A few are a window of parity relations, more are a
    `Stretch`: one relation among all of them.

    Raises:
        NotImplementedError: a verdict other than FAULT, no such window.
    """
    k = at[-1]
    if status != Status.FAULT:
        raise NotImplementedError(
            f"an observer exhibits no behaviour: {status.name} at sample {k} has no certificate, FAULT has"
        )
    u, y = (np.asarray(x)[at[:-1]][: k + 1] for x in (result.u, result.y))
    absolute = int(result.observation.since[at])
    since = absolute - int(
        result.relations.init().samples
    )  # of an observer that goes on, before this recording
    if not hasattr(observer.model, "uncertainties"):
        raise NotImplementedError(
            "certificates are given for a LinearSystem, whose numbers are exact: an interval_system has none"
        )
    for h in sorted({*(2**i for i in range(LONGEST.bit_length())), k - since}):
        if h > min(k - since, k, LONGEST):
            break
        last = u[k - h :], y[k - h :]
        if observer.model.uncertainties:
            found = _shown(observer.model, h, *last) if h <= SHORT else None
        else:
            first = observer.first_box if h == k - since and absolute == 0 else None
            about = stretch(observer.model, h, None if first is None else list(first))
            found = (about, *last) if exceeds(about, *last) > CLEARLY else None
            found = found and (
                (_shown(observer.model, h, *last) if h <= SHORT and first is None else None) or found
            )
        if found is not None:
            relations, u, y = found
            return relations, "joint", np.asarray(u), np.asarray(y)
    many = f"no window of up to {min(LONGEST, k - since, k) + 1} samples proves this alone"
    raise NotImplementedError(
        f"{many}: the FAULT at sample {k} rests on all since {since if since >= 0 else 'a recording before'}"
    )


def _shown(model, h, u, y):
    """Return (relations, u, y) where the window of these samples is FAULT by its relations, else None."""
    try:
        relations = parity_relations(model, h)
    except ValueError:  # without a relation yet
        return None
    relations, given = relations.recording(u, y, ())
    wrong = drive(relations.test("joint", given.y.dtype), given).status[-1] == Status.FAULT
    return (relations, given.u, given.y) if wrong else None
