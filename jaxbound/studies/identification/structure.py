"""Inputs that act later than at the next sample: in recordings, and in a model."""

from typing import Any

import numpy as np

from jaxbound.studies.identification.records import Record, Records


def delayed(records: Records, delay: int) -> Records:
    """Return recordings with the inputs of delay - 1 samples before; NaN where nobody recorded them."""
    return [_with_dead_time(record, delay - 1) for record in records]


def _with_dead_time(record: Record, samples: int) -> Record:
    u, y, starts = record
    if not samples:
        return record
    late = np.full_like(u, np.nan)
    late[samples:] = u[: max(len(u) - samples, 0)]
    for start in np.asarray(starts, int):  # nor do inputs cross a gap
        late[start : start + samples] = np.nan
    return late, y, starts


def chained(spec: dict[str, Any], delay: int) -> dict[str, Any]:
    """Return arguments of a LinearSystem whose inputs act `delay` samples later, where those of `spec` act
    one later: each input waits in delay - 1 states.
    """
    if delay == 1 or spec["B"] is None:
        return spec
    A, B, C = (np.asarray(spec[name], float) for name in "ABC")
    (n, m), waiting = B.shape, (delay - 1) * B.shape[1]
    whole = np.zeros((n + waiting, n + waiting))
    whole[:n, :n] = A
    whole[:n, n + waiting - m :] = B
    whole[n + m :, n : n + waiting - m] = np.eye(waiting - m)
    enters = np.zeros((n + waiting, m))
    enters[n : n + m] = np.eye(m)
    return spec | {"A": whole, "B": enters, "C": np.hstack([C, np.zeros((len(C), waiting))])}
