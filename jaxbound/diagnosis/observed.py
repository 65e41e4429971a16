"""The result of a detection by a set observer: verdicts, and the bands that they rest on."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.estimation.observation import Observation
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

NOT_REFUTED = "UNDECIDED (not refuted)"
"""UNDECIDED for readers, where it is what a healthy sample is."""


def shown_name(status: Status, remembers: bool) -> str:
    """Return the name of a verdict for readers. remembers: whether an observer says it.

    Example:
        >>> shown_name(Status.UNDECIDED, True), shown_name(Status.FAULT, True)
        ('UNDECIDED (not refuted)', 'FAULT')
    """
    if remembers and status == Status.UNDECIDED:
        return NOT_REFUTED
    return status.name


@readable
@dataclass(frozen=True, eq=False)
class ObserverResult(Result):
    """A Result of a set observer: entry k rests on all samples from where the observer began to sample k.

    FAULT: they contradict the model and its bounds, a proof. UNDECIDED: they are not refuted. MISSING: the
    state is not known yet, or there is no sample. margin: as of an Observation, of sample k given those
    before.
    """

    @cached_property
    def observation(self) -> Observation:
        """The Observation of the same samples, worked out at the first call: bands of states and outputs, and
        since when.
        """
        if not self.apart:
            return self._observed(self.u, self.y, self.starts)
        u, y, lead = np.asarray(self.u), np.asarray(self.y), self.status.shape[:-1]
        each = []
        for at, starts in zip(np.ndindex(*lead), self.apart, strict=True):
            each.append(self._observed(u[at], y[at], starts))

        def together(*parts: np.ndarray) -> np.ndarray:
            return np.stack(parts).reshape(*lead, *parts[0].shape)

        observation: Observation = jax.tree.map(together, *each)
        return observation

    def _observed(self, u: np.ndarray, y: np.ndarray, starts: tuple[int, ...]) -> Observation:
        """Return the Observation of a recording, or of a batch with the same gaps."""
        recording = Recording.of(self.relations.signals, u, y, starts)
        observation = self.relations.telling(enclosures=True).enclosed(recording)
        on_host: Observation = jax.tree.map(np.asarray, observation)
        return on_host

    @cached_property
    def readings(self) -> Interval:
        """(..., T, p): what healthy sensors may show as far as the samples before tell. Not rounded outward:
        for pictures.
        """
        predicted, model = self.observation.predicted, self.relations.model
        rho, sigma = self.relations.bounds["noise"], self.relations.bounds["tolerance"]
        zero = model.offset["y"]
        if isinstance(zero, Interval):
            offset = np.asarray(zero.lo)
        else:
            offset = np.array(list(map(float, zero)))
        lo, hi = predicted.lo - offset, predicted.hi - offset  # a reading is (1 + theta) t + delta
        least = np.minimum((1 - sigma) * lo, (1 + sigma) * lo)
        most = np.maximum((1 - sigma) * hi, (1 + sigma) * hi)
        return Interval(least - rho + offset, most + rho + offset)


@result_of.register(SetObserver)
def _(family: SetObserver[Any], judged: Judged, result: Result) -> ObserverResult:
    return ObserverResult(**vars(result))
