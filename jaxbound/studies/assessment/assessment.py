"""A monitor against recordings whose truth is known: how often it cries wolf, what it misses and how late it
is, over factors on its bounds and over alarm rules, beside other detectors on the same windows.

A window with the margin m is explained by bounds 1 - m times as wide and wider, so one test with exact
margins gives the verdicts at every factor. An observer carries a set that depends on its bounds: it follows
each recording once a factor.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.interface import Relations, relations_of
from jaxbound.diagnosis import monitoring
from jaxbound.diagnosis.alarmrule import AlarmRule, RuleLike, rule_of
from jaxbound.diagnosis.monitoring import Watchable
from jaxbound.diagnosis.result import Result
from jaxbound.models.arguments import listed_argument
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.studies.assessment.detectors import Detector, Flags, Monitored, Verdicts
from jaxbound.studies.assessment.peers import peers_of
from jaxbound.studies.assessment.scores import Score, Trial, counted, total
from jaxbound.studies.assessment.truth import Episode, Truth, truth_of
from jaxbound.text.objects import readable
from jaxbound.text.progress import reporter

FACTORS = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
POINTS = 65
"""Factors of a curve, quantiles of what windows need."""
EXPLAINED = 20
"""Faults of a recording whose first alarm is explained, an exact certificate each."""


@readable
class Naming(NamedTuple):
    """A fault whose label names a signal, and what its first alarm says.

    Fields: signal: of the label. candidates: signals that alone explain the worst window of the alarm, the
    most plausible first.
    """

    signal: str
    candidates: tuple[str, ...]

    @property
    def first(self) -> bool:
        """Whether the signal is the most plausible candidate."""
        return self.candidates[:1] == (self.signal,)

    @property
    def among(self) -> bool:
        """Whether the signal is a candidate."""
        return self.signal in self.candidates


@readable
@dataclass(frozen=True, eq=False)
class Case:
    """One faulty recording, at the bounds as they are and by the first alarm rule.

    Fields: name. score: its Score. named: a Naming of each fault that was seen and whose label names a
        signal, of the first 20.
    """

    name: str
    score: Score
    named: tuple[Naming, ...] = ()


@readable
@dataclass(frozen=True, eq=False)
class Marks:
    """One detector over factors and alarm rules.

    Fields: name, note: how it was made. scores: a Score for each factor of the table and each rule, the first
        rule first. curve: (F, 3), rows of (factor, share of healthy windows in alarm, share of faulty windows
        in alarm) by the first rule, from the smallest factor on. equal: of another detector the Score by the
        first rule at the smallest factor with no more healthy windows in alarm than of the monitor; None: of
        the monitor.
    """

    name: str
    note: str
    scores: tuple[Score, ...]
    curve: np.ndarray
    equal: Score | None = None

    def at(self, factor: float, rule: RuleLike | None = None) -> Score:
        """Return the Score at a factor by a rule, the first one by default.

        Raises:
            ValueError: a factor or a rule that was not asked for.
        """
        for score in self.scores:
            if score.factor == factor and (rule is None or rule_of(rule) == score.rule):
                return score
        raise ValueError(f"there is no score of {self.name} at factor {factor:g} by the rule {rule}")


@readable
@dataclass(frozen=True, eq=False)
class Assessment:
    """Right and wrong alarms on recordings whose truth is known. Build it with `assess`.

    Fields: marks: of the monitor. peers: of other detectors, on the same windows. cases: of each faulty
        recording. rules: as given. relations: as given.
    """

    marks: Marks
    cases: tuple[Case, ...]
    rules: tuple[RuleLike, ...]
    peers: tuple[Marks, ...] = ()
    relations: Relations | None = field(default=None, repr=False)

    @property
    def score(self) -> Score:
        """The Score at the bounds as they are, by the first rule."""
        return self.marks.at(1.0)

    @property
    def named(self) -> tuple[Naming, ...]:
        """The faults of all recordings whose labels name a signal."""
        found: list[Naming] = []
        for case in self.cases:
            found += case.named
        return tuple(found)

    @property
    def isolation(self) -> float:
        """The share of these whose signal is the most plausible candidate; nan without any."""
        if not self.named:
            return float("nan")
        return float(np.mean([naming.first for naming in self.named]))


class _Judged(NamedTuple):
    """A recording, its truth and the verdicts of the monitor."""

    recording: Recording
    trial: Trial
    verdicts: Verdicts


def assess(
    relations: Watchable,
    healthy: Sequence[Any],
    faulty: Sequence[Any] = (),
    labels: Sequence[ArrayLike | Sequence[str] | None] | None = None,
    *,
    rules: Sequence[RuleLike] = ((1, 1),),
    factors: Sequence[float] = FACTORS,
    method: str = "joint",
    training: Sequence[Any] | None = None,
    names: Sequence[str] | None = None,
    progress: Callable[[float], object] | None = None,
) -> Assessment:
    """Count right and wrong alarms on recordings whose truth is known.

    A healthy window holds no faulty sample; one that ends at a faulty sample is faulty; the others, healthy
    again at their end, count as neither. Shares are of windows, a false alarm begins in a healthy one.

    Args:
        relations: as for `detect`.
        healthy, faulty: recordings, each a path, a Recording or a tuple (u, y) or (u, y,
            starts).
        labels: of each faulty recording (T,) numbers, 0 for healthy samples, or texts, the name of the faulty
            signal or "" (`truth.HEALTHY_WORDS`); None, or None of a recording: every sample is faulty.
        rules: (k, n), an alarm is on while k of the last n windows are FAULT; or an AlarmRule, of which k, n
            and latch count. The first one makes the curve and the cases.
        factors: > 0, on all bounds; 1 is always among them. At 1 verdicts are those of `detect`; elsewhere a
            window is outside if 1 - margin exceeds the factor, as computed, not proved. Of an observer each
            costs a test.
        method: as of `detect`.
        training: healthy recordings on which other detectors are trained, those that the bounds were found
            from; None: no other detectors.
        names: of the faulty recordings. progress: called with the share of the work done.

    Returns:
        An Assessment; `jb.plot` draws its curves.

    Raises:
        ValueError: no recording, labels that do not fit, rules or factors that are none; no complete window.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> good, bad = (None, [[1.0], [0.5], [0.3]]), (None, [[1.0], [0.5], [0.9], [0.45]])
        >>> found = assess(jb.parity_relations(m), [good], [bad], [[0, 0, 1, 1]])
        >>> found.score.false, found.score.healthy, found.score.caught, found.score.faulty
        (0, 3, 1, 2)
        >>> found.marks.at(3.0).caught
        1
    """
    relations = relations_of(
        relations, "assess", "assess(parity_relations(model), healthy, faulty)", watched=monitoring.monitor
    )
    (ruled, wanted), report = _checked(rules, factors), reporter(progress, "assess")
    healthy = listed_argument("healthy", healthy, "[(u, y)]")
    faulty = listed_argument("faulty", faulty, "[(u, y)]")
    recordings = [_recording(relations, one) for one in (*healthy, *faulty)]
    if not recordings:
        raise ValueError("there is no recording to assess by: give healthy ones, or faulty ones, or both")
    truths = _truths(recordings, len(healthy), labels)
    monitor = Monitored(relations, method)
    peers: Sequence[Detector] = ()
    if training is not None:
        peers = _trained(relations, listed_argument("training", training, "[(u, y)]"))
    judged = []
    for number, recording in enumerate(recordings):
        verdicts = monitor.flags(recording)
        judged.append(_Judged(recording, _trial(recording, verdicts, truths[number], relations), verdicts))
        report(0.6 * (number + 1) / len(recordings))
    _refuse_untested(judged, relations)
    trials = [one.trial for one in judged]
    marks = _marks(monitor, [one.verdicts for one in judged], trials, ruled, wanted, relations.model.dt)
    compared = []
    for number, peer in enumerate(peers):
        flags = [peer.flags(one.recording) for one in judged]
        own = _marks(peer, flags, trials, ruled, wanted, relations.model.dt)
        compared.append(replace(own, equal=_at_most(marks.at(1.0).false, flags, trials, own.scores[0])))
        report(0.6 + 0.3 * (number + 1) / len(peers))
    cases = []
    titles = names or [f"faulty recording {number + 1}" for number in range(len(faulty))]
    for title, one in zip(titles, judged[len(healthy) :], strict=True):
        cases.append(_case(title, one, ruled[0], relations.model.dt))
    report(1.0)
    return Assessment(marks, tuple(cases), tuple(rules), tuple(compared), relations)


def _checked(rules: Sequence[RuleLike], factors: Sequence[float]) -> tuple[list[AlarmRule], list[float]]:
    """Return (the rules, the factors in order, 1 among them); refuse what is no rule and no factor."""
    factors = listed_argument("factors", factors, "[0.5, 2]")
    if not listed_argument("rules", rules, "[(1, 1), (3, 5)]"):
        raise ValueError("there is no alarm rule: give at least one, like (1, 1)")
    ruled = []
    for rule in map(rule_of, rules):
        ruled.append(AlarmRule(rule.k, rule.n, latch=rule.latch))
    wanted = sorted({1.0, *map(float, factors)})
    if not (np.isfinite(wanted).all() and wanted[0] > 0):
        raise ValueError(f"factors on bounds are > 0 and finite: {', '.join(f'{f:g}' for f in factors)}")
    return ruled, wanted


def _recording(relations: Relations, given: object) -> Recording:
    """Return a recording that a user gives: its samples on the host."""
    parts = given if isinstance(given, tuple) else (given,)
    _, recording = relations.recording(*parts)
    if np.ndim(recording.y) != 2:
        raise ValueError(
            f"a recording to assess by has outputs (T, p), this one {np.shape(recording.y)}: give each as "
            f"one of its own"
        )
    return recording


def _truths(
    recordings: Sequence[Recording], healthy: int, labels: Sequence[ArrayLike | Sequence[str] | None] | None
) -> list[Truth]:
    """Return the Truth of each recording, of which the first `healthy` ones have no fault."""
    faulty = recordings[healthy:]
    own: Sequence[ArrayLike | Sequence[str] | None] = [None] * len(faulty)
    if labels is not None:
        own = listed_argument("labels", labels, "[[0, 0, 1]]")
    if len(own) != len(faulty):
        raise ValueError(f"labels are one for each faulty recording: {len(own)} for {len(faulty)}")
    truths = [truth_of(np.zeros(recording.samples), recording.samples) for recording in recordings[:healthy]]
    for recording, stated in zip(faulty, own, strict=True):
        truths.append(truth_of(stated, recording.samples))
    return truths


def _trial(recording: Recording, verdicts: Verdicts, truth: Truth, relations: Relations) -> Trial:
    """Return the Trial of a recording."""
    horizon = None
    if not relations.remembers:
        horizon = relations.horizon
    kinds = truth.kinds(recording.starts, horizon)
    return Trial(verdicts.tested, kinds, tuple(truth.episodes()))


def _refuse_untested(judged: Sequence[_Judged], relations: Relations) -> None:
    """Raise ValueError where no recording has a window."""
    if not any(one.trial.tested.any() for one in judged):
        raise ValueError(
            f"the recordings hold no complete window of {relations.horizon + 1} samples: give longer ones, "
            f"or a shorter horizon"
        )


def _trained(relations: Relations, training: Sequence[Any]) -> Sequence[Detector]:
    """Return other detectors, trained on recordings."""
    model = relations.model
    if not isinstance(model, LinearSystem):
        raise ValueError(
            f"other detectors take their order from a LinearSystem, not from {type(model).__name__}"
        )
    return peers_of(model, [_recording(relations, one) for one in training], max(relations.horizon, 1))


def _marks(
    detector: Detector,
    flags: Sequence[Flags],
    trials: Sequence[Trial],
    rules: Sequence[AlarmRule],
    wanted: Sequence[float],
    dt: float | None,
) -> Marks:
    """Return the Marks of a detector from its flags of all recordings."""

    def score(factor: float, rule: AlarmRule) -> Score:
        return _scored(flags, trials, factor, rule, dt)

    factors = detector.factors(wanted)
    scores = [score(factor, rule) for rule in rules for factor in factors]
    curve = []
    for factor in sorted({*factors, *_quantiles(flags)}):
        point = score(factor, rules[0])
        curve.append((factor, point.false_share, point.caught_share))
    return Marks(detector.name, detector.note, tuple(scores), np.array(curve))


def _scored(
    flags: Sequence[Flags], trials: Sequence[Trial], factor: float, rule: AlarmRule, dt: float | None
) -> Score:
    """Return the Score over all recordings."""
    parts = []
    for one, trial in zip(flags, trials, strict=True):
        parts.append(counted(one.faults(factor), trial, factor, rule, dt))
    return total(parts)


def _at_most(false: int, flags: Sequence[Flags], trials: Sequence[Trial], like: Score) -> Score | None:
    """Return the Score at the smallest factor with so many healthy windows in alarm at most, by halving what
    windows need; None where that is not known. like: a Score by the same rule.
    """
    candidates = _needs(flags)
    low, high = 0, len(candidates) - 1
    if high < 0:
        return None
    while low < high:
        middle = (low + high) // 2
        if _scored(flags, trials, float(candidates[middle]), like.rule, like.dt).false <= false:
            high = middle
        else:
            low = middle + 1
    return _scored(flags, trials, float(candidates[high]), like.rule, like.dt)


def _quantiles(flags: Sequence[Flags]) -> list[float]:
    """Return the factors of a curve where one number a window says when it becomes quiet; else none."""
    every = _needs(flags)
    if not len(every):
        return []
    return list(np.quantile(every, np.linspace(0, 1, POINTS)).tolist())


def _needs(flags: Sequence[Flags]) -> np.ndarray:
    """Return the factors at which windows become quiet, ascending; none where not all are known."""
    parts = []
    for one in flags:
        if one.needs is None:
            return np.zeros(0)
        parts.append(one.needs)
    every = np.concatenate(parts)
    return np.sort(every[np.isfinite(every) & (every > 0)])


def _case(name: str, one: _Judged, rule: AlarmRule, dt: float | None) -> Case:
    """Return the Case of a faulty recording."""
    score = counted(one.verdicts.faults(1.0), one.trial, 1.0, rule, dt)
    labelled = [episode for episode in one.trial.episodes if episode.signal]
    return Case(name, score, _namings(one.verdicts.result, labelled[:EXPLAINED], rule))


def _namings(result: Result, episodes: Sequence[Episode], rule: AlarmRule) -> tuple[Naming, ...]:
    """Return a Naming of each fault that has an alarm whose worst window is explained."""
    if not episodes:
        return ()
    alarms = result.alarms(rule.k, rule.n)
    found = []
    for episode in episodes:
        for alarm in alarms:
            if alarm.end < episode.start or alarm.start >= episode.stop:
                continue
            try:
                found.append(Naming(episode.signal, tuple(alarm.candidates)))
            except NotImplementedError:  # no certificate of this kind of window, or it names nobody
                pass
            break
    return tuple(found)
