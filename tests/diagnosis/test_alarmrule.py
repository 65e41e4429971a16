"""The rule of alarms: what it refuses, which windows count by size, which signal is suspect."""

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.diagnosis import acknowledged
from jaxbound.diagnosis.alarmrule import AlarmRule, rule_of
from jaxbound.diagnosis.watch import LASTING, OPPOSITE
from jaxbound.recordings.signals import Signals

NOISE = 0.1


def one():
    """Return relations y[k-1] = 2 y[k]: off by r they need an error of (|r| - .3) / 3 of the sensor."""
    model = jb.LinearSystem([[0.5]], None, [[1]], noise=NOISE, outputs=["T1"], dt=1)
    return jb.parity_relations(model)


def two():
    """Return relations of two sensors of two plants that do not see each other."""
    model = jb.LinearSystem(
        [[0.5, 0], [0, 0.5]], None, [[1, 0], [0, 1]], noise=NOISE, outputs=["T1", "T2"], dt=1
    )
    return jb.parity_relations(model)


@pytest.mark.parametrize(
    "rule, message",
    [
        (dict(merge="10 parsecs"), "merge: needs a number and a unit"),
        (dict(merge=-1), "merge must be a whole number >= 0, not -1"),
        (dict(least=0), "a least size is a number > 0 in the unit of its output: least 0"),
        (dict(least={"T1": "much"}), "T1 'much'"),
        (dict(least=float("inf")), "a least size is finite"),
        (dict(k=2), "k of n needs k <= n: 2 of 1"),
        (dict(acknowledged=[3]), "give latch, too"),
        (dict(latch=True, acknowledged=["soon"]), "neither seconds nor a known time stamp"),
        (dict(latch=True, acknowledged=["12:30"]), "has no date"),
        (dict(latch=True, acknowledged=["3/4/2017 8:00"]), "write the year first"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(rule, message):
    with pytest.raises(ValueError, match=message):
        AlarmRule(**rule)


def test_an_interval_of_the_clock_is_counted_in_samples():
    assert AlarmRule(merge="10min").fitted(one().model).merge == 600
    with pytest.raises(ValueError, match="needs the sampling period"):
        AlarmRule(merge="10min").fitted(Signals((), ("T1",), {}, None))


def test_one_number_is_the_least_size_of_all_outputs_and_a_wrong_name_is_refused():
    assert AlarmRule(least=2).fitted(two().model).least == {"T1": 2, "T2": 2}
    with pytest.raises(ValueError, match="'T3' is none of 'T1', 'T2'"):
        AlarmRule(least={"T3": 1}).fitted(two().model)


def test_k_of_n_is_a_rule_too_and_two_rules_are_one_too_many():
    assert rule_of((3, 5)) == AlarmRule(3, 5) and rule_of(AlarmRule(latch=True)).latch
    res = jb.detect(one(), None, [[1.0], [0.8]])
    with pytest.raises(ValueError, match="give the rule alone"):
        res.alarms(k=1, n=2, rule=AlarmRule())
    with pytest.raises(ValueError, match="by its name: alarms"):
        res.alarms(AlarmRule(latch=True))


@pytest.mark.parametrize("size, counts", [(0.29, [1, 4]), (0.31, [4]), (0.69, [4]), (0.71, [])])
def test_an_alarm_begins_where_the_smallest_error_reaches_the_size(size, counts):
    """Off by 1.2 and by 2.4: errors of .3 and .7, by hand."""
    y = [[2.0], [0.4], [0.2], [0.1], [-1.15]]  # 2 - .8 = 1.2; .4 - .4 = 0; .2 - .2 = 0; .1 + 2.3 = 2.4
    res = jb.detect(one(), None, y)
    assert np.flatnonzero(res.status == jb.Status.FAULT).tolist() == [1, 4]
    assert [a.start for a in res.alarms(rule=AlarmRule(least=size))] == counts
    assert np.flatnonzero(res.status == jb.Status.FAULT).tolist() == [1, 4]


def test_windows_of_a_batch_and_beside_each_other_count_by_their_own_size(rng):
    """The smallest errors of windows of one relation are known by hand, overlapping or not."""
    y = np.cumsum(rng.normal(0, 1, (3, 40)), 1)
    need = (np.abs(y[:, :-1] - 2 * y[:, 1:]) - 3 * NOISE) / 3
    res = jb.detect(one(), None, y[..., None])
    found = set()
    for a in res.alarms(rule=AlarmRule(least=0.5)):
        found |= {(a.recording[0], k) for k in range(a.start, a.end + 1)}
    assert found == {(i, k + 1) for i, k in np.argwhere(need > 0.5)}


def test_the_size_is_that_of_the_named_output_and_another_fault_counts_whatever_its_size():
    res = jb.detect(two(), None, [[2.0, 2.0], [0.4, 1.0], [0.2, 0.5], [0.1, 0.85]])
    assert np.flatnonzero(res.status == jb.Status.FAULT).tolist() == [1, 3]
    found = res.alarms(rule=AlarmRule(least={"T1": 0.5}, suspects=True))
    assert [(a.start, a.suspects) for a in found] == [(3, ("T2",))]
    assert found[0].size == pytest.approx((1.2 - 0.3) / 3)


def test_a_rule_of_sizes_or_suspects_is_refused_where_windows_do_not_tell_them():
    residuals = jb.evaluate([[0.1], [3.0]], [1.0], [[1]])
    with pytest.raises(ValueError, match="tell no errors of sensors"):
        residuals.alarms(rule=AlarmRule(least=1))
    observed = jb.detect(jb.observer(paper()), [[0.0], [0.0]], [[0.0, 0.0], [0.5, 0.0]])
    for rule in (AlarmRule(least=1), AlarmRule(suspects=True)):
        with pytest.raises(ValueError, match="more than one window|windows of a plant"):
            observed.alarms(rule=rule)
    (alarm,) = observed.alarms(rule=AlarmRule(latch=True))
    assert alarm.suspects == () and alarm.start == 1


@pytest.mark.parametrize("end, ended", [(20, LASTING), (10, f"{OPPOSITE} of T1")])
def test_a_bias_that_begins_latches_until_its_end_is_seen(end, ended):
    """A plant at rest, one sensor 3 too high from sample 5 on: windows of two samples see its jumps alone."""
    model = jb.LinearSystem([[1.0]], None, [[1]], noise=NOISE, outputs=["T1"], dt=1)
    y = np.zeros((20, 1))
    y[5:end] = 3
    res = jb.detect(jb.parity_relations(model), None, y)
    (alarm,) = res.alarms(rule=AlarmRule(latch=True))
    assert (alarm.start, alarm.end, alarm.ended, alarm.suspect) == (5, min(end, 19), ended, "T1")
    assert alarm.windows == 2 - (end == 20)


def several():
    """Return a monitor of the two plants: windows of two samples, and an observer with wider bounds."""
    tests = [{"name": "windows", "horizon": 1}, {"name": "state", "observer": "zonotope", "factor": 1.5}]
    return jb.monitor(two().model, tests)


def jumps():
    """Return y of two sensors that are off for one sample each, the first one twice."""
    y = np.zeros((40, 2))
    y[8, 0], y[14, 0], y[20, 1] = 0.5, 3, 3
    return y


def test_alarms_of_a_monitor_name_the_suspects_of_the_test_that_speaks():
    """A window is off by 2 * 3: an error of (2 * 3 - .3) / 3 of its sensor, by hand, would explain it."""
    res = jb.detect(several(), None, jumps())
    found = res.alarms(rule=AlarmRule(suspects=True))
    assert [(a.start, a.suspect) for a in found] == [(8, "T1"), (14, "T1"), (20, "T2")]
    assert found[1].size == pytest.approx((2 * 3 - 3 * NOISE) / 3)


def test_a_monitor_counts_by_size_what_its_windows_prove_of_it():
    res = jb.detect(several(), None, jumps())
    assert [a.start for a in res.alarms(rule=AlarmRule(least={"T1": 1}))] == [14, 20]
    assert [a.start for a in res.alarms(rule=AlarmRule(least={"T1": 3}))] == [20]


def test_one_alarm_of_a_component_is_open_while_another_component_has_its_own():
    found = jb.detect(several(), None, jumps()).alarms(rule=AlarmRule(latch=True))
    spans = [(a.start, a.end, a.suspect) for a in found]
    assert spans[-1] == (20, 39, "T2") and {name for _, _, name in spans} == {"T1", "T2"}


@pytest.mark.parametrize("options", [{"latch": True}, {"merge": 30}])
def test_tests_that_name_the_same_component_have_one_open_alarm_of_it_at_once(options, rng):
    """Two sensors are off by turns, for two samples each; windows and lags both prove it and name them."""
    tests = [{"name": "jumps", "horizon": 1}, {"name": "lasting", "lags": [0, 2, 4], "factor": 1.5}]
    y = rng.uniform(-0.09, 0.09, (80, 2))
    for i, k in enumerate(range(5, 75, 12)):
        y[k : k + 2, i % 2] += 1
    res = jb.detect(jb.monitor(two().model, tests), None, y)
    found = res.alarms(rule=jb.AlarmRule(**options))
    assert {res.test_at(k) for k in np.flatnonzero(res.status == jb.Status.FAULT)} == {"jumps", "lasting"}
    spans = {name: [(a.start, a.end) for a in found if a.suspect == name] for name in ("T1", "T2")}
    for own in spans.values():
        assert own and all(end < start for (_, end), (start, _) in zip(own, own[1:], strict=False))
    assert spans["T1"][0][0] < spans["T2"][0][0] < spans["T1"][-1][1], "those of two components overlap"


def test_a_monitor_of_observers_names_no_suspects():
    bank = jb.monitor(two().model, [{"name": "state", "observer": "zonotope"}])
    res = jb.detect(bank, None, jumps())
    for rule in (AlarmRule(suspects=True), AlarmRule(least=1)):
        with pytest.raises(ValueError, match="no test of this monitor"):
            res.alarms(rule=rule)


def test_the_cause_of_an_alarm_is_that_of_the_window_in_which_it_begins():
    """Off by 1.2: a bias from the last sample on moves 2 y[k] alone, so one of (1.2 - .3) / 2, and one from
    the first on both, so one of 1.2 + .3, by hand.
    """
    named = jb.NamedFault("probe slips", output="T1")
    r = jb.parity_relations(one().model.replace(faults=[named]))
    (alarm,) = jb.detect(r, None, [[2.0], [0.4], [0.2]]).alarms(rule=AlarmRule(suspects=True))
    assert alarm.cause == "probe slips: -0.45 to -1.5 of T1"
    (plain,) = jb.detect(one(), None, [[2.0], [0.4], [0.2]]).alarms(rule=AlarmRule(suspects=True))
    assert plain.cause == ""


@pytest.mark.parametrize(
    "text, message",
    [
        (None, "is no file"),
        ("1\n2", "has no end"),
        ("1\nsoon, I said\n", "'soon'"),
        ("1_0\n", "'1_0'"),
        ("\u0661\n", "'\u0661'"),
    ],
)
def test_a_file_of_acknowledgements_is_checked_before_it_is_followed(tmp_path, text, message):
    if text is not None:
        (tmp_path / "seen.txt").write_text(text)
    rule = AlarmRule(latch=True, acknowledged=tmp_path / "seen.txt")
    with pytest.raises(ValueError, match=message):
        rule.fitted(one().model)


def test_the_times_of_a_rule_are_read_once(monkeypatch):
    asked = []
    read = acknowledged.instant_of
    monkeypatch.setattr(acknowledged, "instant_of", lambda time: (asked.append(time), read(time))[1])
    rule = AlarmRule(latch=True, acknowledged=[3])
    result = jb.detect(one(), None, [[0.0], [0.0], [3.0], [3.0], [3.0]])
    for _ in range(2):
        assert result.alarms(rule=rule)[0].ended == "acknowledged"
    assert asked == [3]


def test_the_size_of_an_alarm_is_that_of_its_worst_window():
    """A fault that grows was shown by the size at which it began."""
    y = [
        [0.0],
        [0.0],
        [0.5],
        [1.5],
        [0.5],
    ]  # off by 1, 2.5 and .5: errors of .23, .73 and .07
    (alarm,) = jb.detect(one(), None, y).alarms(rule=AlarmRule(latch=True))
    assert (alarm.start, alarm.worst) == (2, 3) and alarm.size == pytest.approx(2.2 / 3)
    assert alarm.size == float(alarm.errors["T1"])
