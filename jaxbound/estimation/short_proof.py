"""The shortest window of the last samples that proves a FAULT of an observer."""

from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from jaxbound.certificates.interface import Index, Judgement, WindowCertificate, certify
from jaxbound.certificates.long_window import SHORT, stretch
from jaxbound.consistency.drive import drive
from jaxbound.estimation.observation import Observation
from jaxbound.estimation.observed_plant import ObservedModel
from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.status import Status

LONGEST = 512
"""Steps of the longest window that a certificate speaks of."""
AVERAGED = 64
"""Of the longest whose averages count: a stretch of samples knows no bounds on averages."""


class ObservedResult(Judgement, Protocol):
    """A Result of an observer, with what `detect` has of it."""

    @property
    def observation(self) -> Observation:
        """The enclosures."""


def short_proof(
    model: ObservedModel, first_box: np.ndarray | None, result: ObservedResult, at: Index, status: Status
) -> WindowCertificate:
    """Return the certificate of the shortest of some windows that end at a sample and prove its FAULT.

    A chain of sets is long and nobody reads it; most contradictions show in the last samples. Tried are 2, 3,
    5, 9, .. of them, up to all since the observer began.

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
    longest = min(k - since, k, LONGEST)
    for h in sorted({*(2**i for i in range(LONGEST.bit_length())), k - since}):
        first = first_box if h == k - since and absolute == 0 else None
        if h > longest or (model.uncertainties and h > SHORT):
            break
        with suppress(NotImplementedError, ValueError):  # of these samples alone nothing is proved
            about: Any = stretch(model, h, first)
            # relations alone know these; kernels say sooner than fractions: nothing
            if model.uncertainties or (model.averages and h <= AVERAGED):
                about, recording = parity_relations(model, h).recording(u[k - h :], y[k - h :])
                if drive(about.test("joint", y.dtype), recording).status[-1] != Status.FAULT:
                    continue
            return certify(about, u[k - h :], y[k - h :], status=status, at=at)
    many = f"no window of up to {longest + 1} samples proves this alone"
    raise NotImplementedError(
        f"{many}: the FAULT at sample {k} rests on all since {since if since >= 0 else 'a recording before'}"
    )
