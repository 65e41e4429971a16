"""Counts of right and wrong alarms: of one detector, at one factor on its bounds and by one alarm rule."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.watch import often
from jaxbound.studies.assessment.truth import FAULTY, HEALTHY, Episode

DAY = 86400.0


class Rule(NamedTuple):
    """An alarm is on while k of the last n windows are FAULT."""

    k: int
    n: int

    def __str__(self) -> str:
        return f"{self.k}/{self.n}"


class Trial(NamedTuple):
    """A recording whose truth is known.

    Fields: tested: (T,) bool, a window ends here. kinds: (T,) HEALTHY, FAULTY or ASIDE. episodes: of faults.
    """

    tested: np.ndarray
    kinds: np.ndarray
    episodes: tuple[Episode, ...]


class Score(NamedTuple):
    """Counts over recordings.

    Fields:
        factor: on the bounds, or on the threshold of another detector. rule: of alarms.
        healthy: windows without a faulty sample; false: those of them in alarm; alarms: that began there.
        faulty: windows that end at a faulty sample; caught: those of them in alarm.
        episodes: stretches of one fault; delays: of each that is seen, samples from its onset to the alarm.
        dt: s between samples, None: not known.
    """

    factor: float
    rule: Rule
    healthy: int
    false: int
    alarms: int
    faulty: int
    caught: int
    episodes: int
    delays: tuple[int, ...]
    dt: float | None

    @property
    def false_share(self) -> float:
        """The share of healthy windows in alarm; nan without any."""
        return _share(self.false, self.healthy)

    @property
    def caught_share(self) -> float:
        """The share of faulty windows in alarm; nan without any."""
        return _share(self.caught, self.faulty)

    @property
    def missed_share(self) -> float:
        """The share of faulty windows without an alarm; nan without any."""
        return 1 - self.caught_share

    @property
    def alarms_a_day(self) -> float:
        """False alarms that begin on a day of healthy windows; nan where dt is not known."""
        if self.dt is None:
            return float("nan")
        return _share(self.alarms, self.healthy * self.dt / DAY)

    @property
    def delay(self) -> float:
        """The median over all faults of the samples from the onset to the alarm, inf for one never seen."""
        missed = self.episodes - len(self.delays)
        every = np.array([*self.delays, *[np.inf] * missed])
        if not len(every):
            return float("nan")
        return float(np.sort(every)[(len(every) - 1) // 2])


def _share(part: float, whole: float) -> float:
    if not whole:
        return float("nan")
    return part / whole


def counted(fault: np.ndarray, trial: Trial, factor: float, rule: Rule, dt: float | None) -> Score:
    """Return the Score of one recording. fault: (T,) bool, the windows that a detector calls faulty."""
    # no window before the first one is FAULT
    on = often(np.append(np.zeros(rule.n, bool), fault & trial.tested), rule.k, rule.n)
    begin = np.flatnonzero(on & ~np.append(False, on[:-1]))
    healthy, faulty = trial.tested & (trial.kinds == HEALTHY), trial.tested & (trial.kinds == FAULTY)
    delays = []
    for episode in trial.episodes:
        seen = np.flatnonzero(on[episode.start : episode.stop])
        if len(seen):
            delays.append(int(seen[0]))
    return Score(
        factor,
        rule,
        healthy=int(np.count_nonzero(healthy)),
        false=int(np.count_nonzero(healthy & on)),
        alarms=int(np.count_nonzero(trial.kinds[begin] == HEALTHY)),
        faulty=int(np.count_nonzero(faulty)),
        caught=int(np.count_nonzero(faulty & on)),
        episodes=len(trial.episodes),
        delays=tuple(delays),
        dt=dt,
    )


def total(scores: Iterable[Score]) -> Score:
    """Return the sum of Scores of one factor and one rule."""
    parts = list(scores)
    delays: list[int] = []
    for part in parts:
        delays += part.delays
    return parts[0]._replace(
        healthy=sum(part.healthy for part in parts),
        false=sum(part.false for part in parts),
        alarms=sum(part.alarms for part in parts),
        faulty=sum(part.faulty for part in parts),
        caught=sum(part.caught for part in parts),
        episodes=sum(part.episodes for part in parts),
        delays=tuple(delays),
    )
