"""What a detection by a set observer returns: verdicts, and the bands that they rest on."""

from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np

from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import Judged
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.estimation.set_observer import Observation, SetObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

__all__ = ["ObserverResult"]


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
        given = Recording.of(self.relations.signals, self.u, self.y, self.starts)
        return jax.tree.map(np.asarray, drive(self.relations.telling(enclosures=True), given))

    @cached_property
    def readings(self) -> Interval:
        """(..., T, p): what healthy sensors may show as far as the samples before tell. Not rounded outward:
        for pictures.
        """
        predicted, model = self.observation.predicted, self.relations.model
        rho, sigma = self.relations.bounds["noise"], self.relations.bounds["tolerance"]
        zero = model.offset["y"]
        offset = np.asarray(zero.lo) if isinstance(zero, Interval) else np.array([float(x) for x in zero])
        lo, hi = predicted.lo - offset, predicted.hi - offset
        ends = lambda end: ((1 - sigma) * end, (1 + sigma) * end)
        return Interval(np.minimum(*ends(lo)) - rho + offset, np.maximum(*ends(hi)) + rho + offset)


@result_of.register
def _(observer: SetObserver, judged: Judged, *about, **more):
    return ObserverResult(judged.status, judged.margin, *about, **more)
