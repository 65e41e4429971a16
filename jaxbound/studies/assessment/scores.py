"""Counts of right and wrong alarms: of one detector, at one factor on its bounds and by one alarm rule."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.watch import often
from jaxbound.studies.assessment.truth import FAULTY, HEALTHY, Episode

DAY = 86400.0


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
        factor: on the bounds, or on the threshold of another detector. k, n: the alarm rule. latch: whether
            alarms stay on to the end of a fault, or of the healthy windows that they began in.
        healthy: windows without a faulty sample; false: those of them in alarm; alarms: that began there.
        faulty: windows that end at a faulty sample; caught: those of them in alarm.
        episodes: stretches of one fault; delays: of each that is seen, samples from the first verdict behind
            its onset to the alarm.
        dt: s between samples, None: not known.
    """

    factor: float
    k: int
    n: int
    healthy: int
    false: int
    alarms: int
    faulty: int
    caught: int
    episodes: int
    delays: tuple[int, ...]
    dt: float | None
    latch: bool = False

    @property
    def rule(self) -> AlarmRule:
        """The alarm rule."""
        return AlarmRule(self.k, self.n, latch=self.latch)

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
        """The median over all faults of the samples from the first verdict to the alarm, inf for one never
        seen.
        """
        missed = self.episodes - len(self.delays)
        every = np.array([*self.delays, *[np.inf] * missed])
        if not len(every):
            return float("nan")
        return float(np.sort(every)[(len(every) - 1) // 2])


def rule_text(score: Score) -> str:
    """Return an alarm rule in short."""
    return f"{score.k}/{score.n}{' latched' * score.latch}"


def _share(part: float, whole: float) -> float:
    if not whole:
        return float("nan")
    return part / whole


def in_alarm(fault: np.ndarray, trial: Trial, rule: AlarmRule) -> tuple[np.ndarray, np.ndarray]:
    """Return ((T,) bool, whether an alarm is on; the sample at which each begins).

    One that latches is over where the truth changes: whoever knows it acknowledges there.
    """
    on = often(np.append(np.zeros(rule.n, bool), fault), rule.k, rule.n)
    if rule.latch:
        onsets = [episode.start for episode in trial.episodes]
        edges = np.union1d(np.flatnonzero(np.diff(trial.kinds)) + 1, onsets).astype(int)
        on = np.concatenate([np.logical_or.accumulate(part) for part in np.split(on, edges)])
    return on, np.flatnonzero(on & ~np.append(False, on[:-1]))


def counted(fault: np.ndarray, trial: Trial, factor: float, rule: AlarmRule, dt: float | None) -> Score:
    """Return the Score of one recording. fault: (T,) bool, the windows that a detector calls faulty."""
    on, begin = in_alarm(fault & trial.tested, trial, rule)
    healthy, faulty = trial.tested & (trial.kinds == HEALTHY), trial.tested & (trial.kinds == FAULTY)
    delays = []
    for episode in trial.episodes:
        own = slice(episode.start, episode.stop)
        first = np.flatnonzero(trial.tested[own] & on[own])
        if len(first):
            delays.append(int(first[0] - np.argmax(trial.tested[own])))
    return Score(
        factor,
        rule.k,
        rule.n,
        latch=rule.latch,
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
