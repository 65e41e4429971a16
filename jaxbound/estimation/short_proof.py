"""The shortest window of the last samples that proves a FAULT of an observer."""

from contextlib import suppress
from typing import Any, Protocol, TypeAlias

import numpy as np

from jaxbound.certificates.interface import Judgement
from jaxbound.certificates.long_window import exceeds, stretch
from jaxbound.consistency.drive import drive
from jaxbound.estimation.observation import Observation
from jaxbound.estimation.observed_plant import ObservedModel
from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.status import Status

LONGEST, SHORT, CLEARLY = 512, 8, 1 + 1e-6
"""Steps of the longest window that a certificate speaks of, of the longest of parity relations, and the
factor it must be beyond.
"""
AVERAGED = 64
"""The longest of parity relations where averages are bounded, which a `Stretch` does not know."""
WindowProof: TypeAlias = tuple[Any, np.ndarray, np.ndarray]
"""(relations of a window, u, y): a stretch, or parity relations."""


class ObservedResult(Judgement, Protocol):
    """A Result of an observer, with what `detect` has of it."""

    @property
    def observation(self) -> Observation:
        """The enclosures."""


def short_proof(
    model: ObservedModel,
    first_box: np.ndarray | None,
    result: ObservedResult,
    at: tuple[int, ...],
    status: Status,
) -> WindowProof:
    """Return (relations, u, y) of the shortest of some windows that end at a sample and prove its
    FAULT.

    A chain of sets is long and nobody reads it; most contradictions show in the last samples. Tried are 2, 3,
    5, 9, .. of them, up to all since the observer began. A few are a window of parity relations, more are a
    `Stretch`: one relation among all of them.

    Args:
        model: that is observed. first_box: (n, 2) bounds of the first state, or None. result: of `detect`,
            with its observation. at: index of the sample. status: its verdict.

    Raises:
        NotImplementedError: a verdict other than FAULT, no such window.
    """
    k = at[-1]
    if status != Status.FAULT:
        raise NotImplementedError(
            f"an observer exhibits no behaviour: {status.name} at sample {k} has no certificate, FAULT has"
        )
    if not isinstance(model, LinearSystem):
        raise NotImplementedError(
            "certificates are given for a LinearSystem, whose numbers are exact: an interval_system has none"
        )
    u, y = (np.asarray(x)[at[:-1]][: k + 1] for x in (result.u, result.y))
    absolute = int(result.observation.since[at])
    # of an observer that goes on, it may lie before this recording
    since = absolute - int(result.relations.begin().samples)
    for h in sorted({*(2**i for i in range(LONGEST.bit_length())), k - since}):
        if h > min(k - since, k, LONGEST):
            break
        bounded = first_box if h == k - since and absolute == 0 else None
        proof = _window_proof(model, h, u[k - h :], y[k - h :], bounded)
        if proof is not None:
            relations, u, y = proof
            return relations, np.asarray(u), np.asarray(y)
    many = f"no window of up to {min(LONGEST, k - since, k) + 1} samples proves this alone"
    raise NotImplementedError(
        f"{many}: the FAULT at sample {k} rests on all since {since if since >= 0 else 'a recording before'}"
    )


def _window_proof(
    model: LinearSystem, h: int, u: np.ndarray, y: np.ndarray, first_box: np.ndarray | None
) -> WindowProof | None:
    """Return the proof by the h + 1 samples u, y, if there is one. first_box: bounds of their first state."""
    relations: Any = None
    longest = SHORT
    if model.averages:
        longest = AVERAGED
    if first_box is None and h <= longest:  # parity relations know no bounds of a state
        with suppress(ValueError):  # there are none yet, or large models are too dear for them
            relations = parity_relations(model, h)
    if relations is not None:
        relations, recording = relations.recording(u, y, ())
        status = drive(relations.test("joint", recording.y.dtype), recording).status
        return (relations, recording.u, recording.y) if status[-1] == Status.FAULT else None
    if model.uncertainties:  # parity relations alone know these
        return None
    about = stretch(model, h, None if first_box is None else list(first_box))
    return (about, u, y) if exceeds(about, u, y) > CLEARLY else None
