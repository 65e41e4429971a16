"""Sets side by side, one a weight, each of which holds the state: what they say together."""

import numpy as np

from jaxbound.estimation.zonotope_steps import Found


def joined(found: Found, lanes: int) -> Found:
    """Return the verdict (.., N) of sets side by side (.., N lanes): one of them refutes for all, the state
    is in each.
    """
    if lanes == 1:
        return found
    # by lane: the last axis of a few is no vector code
    status, margin, age, states, outputs = (
        np.moveaxis(np.asarray(x).reshape(*x.shape[:-1], x.shape[-1] // lanes, lanes), -1, 0) for x in found
    )
    age = np.where((age > 0).all(0), age.max(0), 0)
    return Found(status.max(0), margin.min(0), age, states.min(0), outputs.min(0))


def emptied(found: Found, gone: np.ndarray) -> Found:
    """Return Found with NaN for the ends of sets that are empty: where all are `gone` (T, N), and where sets
    have nothing in common.
    """
    kept = []
    for ends in (found.states, *np.split(found.outputs, 2, 1)):
        least, most = np.split(ends, 2, 1)
        kept.append(np.where((gone | (-least > most).any(1))[:, None], np.nan, ends))
    return found._replace(states=kept[0], outputs=np.concatenate(kept[1:], 1))
