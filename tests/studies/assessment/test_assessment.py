"""Right and wrong alarms are counted as a person would count them."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.studies.assessment.scores import Trial, counted
from jaxbound.studies.assessment.truth import ASIDE, FAULTY, HEALTHY, Episode, truth_of

NOISE, DECAY = 0.1, 0.5


@pytest.fixture(scope="module")
def model():
    return jb.LinearSystem([[DECAY]], None, [[1]], noise=NOISE, outputs=["level"], dt=2.0)


def decaying(rng, samples, spread):
    """Return (None, y) of a state that decays from 1, read with errors of up to `spread`."""
    truth = DECAY ** np.arange(samples, dtype=float)
    return None, (truth + rng.uniform(-spread, spread, samples))[:, None]


def needed(y):
    """Return the factors on the noise at which each pair of readings just becomes consistent: of the one
    relation y[k-1] / 2 = y[k], whose errors are 1.5 times the noise at most.
    """
    return abs(DECAY * y[:-1, 0] - y[1:, 0]) / (NOISE * (1 + DECAY))


def test_each_factor_counts_the_windows_that_need_more(model, rng):
    healthy, faulty = decaying(rng, 60, 0.3), decaying(rng, 60, 0.6)
    factors = (0.4, 0.8, 1.7)
    found = jb.assess(jb.parity_relations(model), [healthy], [faulty], factors=factors)
    for factor in (*factors, 1.0):
        score = found.marks.at(factor)
        assert score.false == (needed(healthy[1]) > factor).sum(), factor
        assert score.caught == (needed(faulty[1]) > factor).sum(), factor
    assert (found.score.healthy, found.score.faulty) == (59, 59)


def test_a_bank_has_the_curve_of_its_tests(model, rng):
    """It had one point: its margins were not asked."""
    healthy, faulty = decaying(rng, 60, 0.3), decaying(rng, 60, 0.6)
    tests = [{"name": "short", "horizon": 1}, {"name": "long", "horizon": 3, "factor": 1.3}]
    factors = (0.5, 0.8, 1.7)
    found = jb.assess(jb.monitor(model, tests), [healthy], [faulty], factors=factors)
    assert len(found.marks.curve) > 60
    watched = {**tests[0], "name": "set", "horizon": None, "observer": "zonotope", "latched": True}
    del watched["horizon"]
    followed = jb.assess(jb.monitor(model, [tests[0], watched]), [healthy], [faulty], factors=factors)
    for factor in factors:
        wider = model.replace(noise=factor * NOISE)
        for one, bank in ((found, tests), (followed, [tests[0], watched])):
            res = jb.detect(jb.monitor(wider, bank), *faulty)
            assert one.marks.at(factor).caught == res.counts["FAULT"], factor


def test_other_detectors_are_compared_at_as_few_false_alarms(model, rng):
    healthy, faulty = [decaying(rng, 60, 0.1) for _ in range(2)], decaying(rng, 60, 0.6)
    found = jb.assess(jb.parity_relations(model), healthy[:1], [faulty], training=healthy[1:])
    assert found.score.false == 0 and found.marks.equal is None
    for peer in found.peers:
        equal = peer.equal
        assert equal.false == 0 and (equal.factor <= 1 or peer.at(1.0).false > 0), peer.name
        assert max(peer.curve[peer.curve[:, 1] <= 0, 2]) <= equal.caught_share


def test_the_curve_falls_with_the_factor(model, rng):
    found = jb.assess(jb.parity_relations(model), [decaying(rng, 80, 0.3)], [decaying(rng, 80, 0.6)])
    factor, false, caught = found.marks.curve.T
    assert (np.diff(factor) > 0).all()
    assert (np.diff(false) <= 0).all() and (np.diff(caught) <= 0).all()
    assert false[-1] == 0 and caught[0] > 0.9


def test_an_observer_is_followed_once_a_factor(model, rng):
    watch = jb.observer(model)
    healthy = decaying(rng, 30, 0.3)
    found = jb.assess(watch, [healthy], factors=(1.0, 4.0))
    wider = jb.observer(model.replace(noise=4 * NOISE))
    for factor, seen in ((1.0, jb.detect(watch, *healthy)), (4.0, jb.detect(wider, *healthy))):
        assert found.marks.at(factor).false == seen.counts["FAULT"]
    assert found.marks.at(4.0).false < found.marks.at(1.0).false


def test_a_signal_in_the_labels_is_looked_for_among_the_candidates():
    model = jb.LinearSystem([[0.5]], None, [[1], [1], [1]], noise=0.1, outputs=["a", "b", "c"])
    y = np.tile(0.5 ** np.arange(8.0)[:, None], (1, 3))
    y[4:, 1] += 2.0
    labels = [""] * 4 + ["b"] * 4
    found = jb.assess(jb.parity_relations(model), [], [(None, y)], [labels])
    assert found.cases[0].named[0].candidates == ("b",)
    assert found.isolation == 1
    wrong = jb.assess(jb.parity_relations(model), [], [(None, y)], [["a" if x else "" for x in labels]])
    assert wrong.isolation == 0


def test_windows_that_still_hold_a_fault_count_as_neither():
    truth = truth_of([0, 0, 1, 1, 0, 0, 0, 0], 8)
    assert truth.kinds([], 2).tolist() == [HEALTHY, HEALTHY, FAULTY, FAULTY, ASIDE, ASIDE, HEALTHY, HEALTHY]
    assert truth.kinds([5], 2).tolist()[4:] == [ASIDE, HEALTHY, HEALTHY, HEALTHY]
    assert truth.kinds([], None).tolist()[4:] == [ASIDE] * 4


def test_labels_that_are_words_name_signals():
    assert truth_of(["0", "T1", "T1", "healthy", " T2 "], 5).episodes() == [
        Episode(1, 3, "T1"),
        Episode(4, 5, "T2"),
    ]
    assert truth_of([np.nan, 1.0], 2).episodes() == [Episode(1, 2, "")]


def test_alarms_are_counted_by_their_rule():
    fault = np.array([1, 0, 1, 1, 0, 0, 0, 1, 1, 1], bool)
    kinds = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1])
    trial = Trial(np.ones(10, bool), kinds, (Episode(6, 10, ""),))
    one = counted(fault, trial, 1.0, AlarmRule(), 8640.0)
    assert (one.false, one.alarms, one.caught, one.delays) == (3, 2, 3, (1,))
    assert one.alarms_a_day == pytest.approx(2 / 0.6)  # 6 healthy samples of a tenth of a day each
    two = counted(fault, trial, 1.0, AlarmRule(2, 3), None)
    assert (two.false, two.alarms, two.caught, two.delays) == (3, 1, 2, (2,))
    assert np.isnan(two.alarms_a_day)
    lasting = counted(fault, trial, 1.0, AlarmRule(latch=True), None)
    assert (lasting.false, lasting.alarms, lasting.caught) == (6, 1, 3)  # not on from before into the fault


def test_a_delay_counts_from_the_first_verdict_behind_the_onset():
    """A fault that was there when the recording began had the horizon of its windows in every delay."""
    tested, fault = np.arange(6) >= 3, np.arange(6) >= 4
    trial = Trial(tested, np.ones(6, int), (Episode(0, 6, ""),))
    assert counted(fault, trial, 1.0, AlarmRule(), 1.0).delays == (1,)


def test_the_delay_of_a_fault_that_is_not_seen_is_infinite():
    trial = Trial(np.ones(4, bool), np.ones(4, int), (Episode(0, 4, ""),))
    score = counted(np.zeros(4, bool), trial, 1.0, AlarmRule(), 1.0)
    assert (score.delay, score.missed_share) == (np.inf, 1.0)


@pytest.mark.parametrize(
    "changes, sentence",
    [
        (dict(labels=[[1, 0]]), "labels need one entry for each of the 4 samples"),
        (dict(labels=[None, None]), "labels are one for each faulty recording: 2 for 1"),
        (dict(rules=()), "there is no alarm rule"),
        (dict(rules=[(3, 2)]), "k of n needs k <= n: 3 of 2"),
        (dict(factors=[0.0]), "factors on bounds are > 0 and finite: 0"),
        (dict(faulty=()), "there is no recording to assess by"),
        (dict(faulty=[(None, [[1.0]])]), "the recordings hold no complete window of 2 samples"),
        (dict(training=[(None, [[1.0], [0.5]])]), "hold 1 windows of 2 samples: give longer ones"),
    ],
)
def test_what_cannot_be_assessed_is_refused(model, changes, sentence):
    given = dict(healthy=(), faulty=[(None, [[1.0], [0.5], [0.3], [0.1]])]) | changes
    with pytest.raises(ValueError, match=sentence):
        jb.assess(jb.parity_relations(model), given.pop("healthy"), given.pop("faulty"), **given)


def test_a_picture_has_a_curve_for_each_detector(model, rng):
    training = [decaying(rng, 80, 0.05)]
    found = jb.assess(
        jb.parity_relations(model), [decaying(rng, 40, 0.1)], [decaying(rng, 40, 0.9)], training=training
    )
    (ax,) = jb.plot(found).axes
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["PCA T2, Q", "forest, auto", "3 sigma", "CUSUM", "jaxbound"]
