"""Sets side by side, one a weight, each of which holds the state: what they say together."""

import numpy as np

from jaxbound.estimation.zonotope_steps import Found
from jaxbound.sets.floats.status import Status

__all__ = ["emptied", "joined"]


def joined(found: Found) -> Found:
    """Return the verdict of sets side by side (.., lanes, N): one of them refutes for all, the state is in
    each.
    """
    if found.status.shape[-2] == 1:
        return Found(*(x[..., 0, :] for x in found))
    age = np.where((found.age > 0).all(-2), found.age.max(-2), 0)
    return Found(found.status.max(-2), found.margin.min(-2), age, found.states.min(-2), found.outputs.min(-2))


def emptied(found: Found, before: np.ndarray | None) -> Found:
    """Return Found with NaN for the ends of sets that are empty: behind a FAULT that stays, and where sets
    have nothing in common.

    Args:
        found: of T samples, (T, .., N). before: (N,), which recordings were refuted before these, where a
            FAULT stays; else None.
    """
    gone = np.zeros(found.status.shape, bool)
    if before is not None:
        fault = np.asarray(found.status) == Status.FAULT
        gone = fault & np.concatenate([np.broadcast_to(before, fault[:1].shape), fault[:-1]])
    kept = []
    for ends in (found.states, *np.split(found.outputs, 2, 1)):
        least, most = np.split(ends, 2, 1)
        kept.append(np.where((gone | (-least > most).any(1))[:, None], np.nan, ends))
    return found._replace(states=kept[0], outputs=np.concatenate(kept[1:], 1))
