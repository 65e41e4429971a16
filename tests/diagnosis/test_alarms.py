"""Alarms from hand-made verdicts; the verdicts themselves never change."""

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status

RELATIONS, LONG = jb.parity_relations(paper()), jb.parity_relations(paper(), 3)


def result(pattern, margin=None, relations=RELATIONS):
    """Build a Result: F is FAULT, . CONSISTENT, ? UNDECIDED, - MISSING; margin -1 at each F unless given."""
    verdict = {".": Status.CONSISTENT, "F": Status.FAULT, "?": Status.UNDECIDED, "-": Status.MISSING}
    status = np.array([[verdict[c] for c in row] for row in np.atleast_1d(pattern)], np.int8)
    margin = np.where(status == 3, -1.0, 0.5) if margin is None else np.atleast_2d(np.array(margin, float))
    if isinstance(pattern, str):
        status, margin = status[0], margin[0]
    return jb.Result(
        status, margin, "joint", relations, np.zeros((*status.shape, 1)), np.zeros((*status.shape, 2))
    )


def spans(pattern, **rule):
    return [(a.start, a.end, a.windows) for a in result(pattern).alarms(**rule)]


@pytest.mark.parametrize(
    "pattern, expected",
    [
        ("......", []),
        ("F.....", [(0, 0, 1)]),
        (".....F", [(5, 5, 1)]),
        ("FFFFFF", [(0, 5, 6)]),
        (".FF..F", [(1, 2, 2), (5, 5, 1)]),
        (".F.F.F", [(1, 1, 1), (3, 3, 1), (5, 5, 1)]),
        ("-?F?-.", [(2, 2, 1)]),
        ("", []),
    ],
)
def test_by_default_each_run_of_faults_is_an_alarm(pattern, expected):
    assert spans(pattern) == expected


@pytest.mark.parametrize(
    "k, n, pattern, expected",
    [
        (2, 2, ".F.F.", []),
        (2, 2, ".FF..", [(2, 2, 1)]),  # starts where two in a row are reached
        (2, 3, ".F.F.....", [(3, 3, 1)]),  # at 3 the last three hold two, at 4 only one
        (2, 3, "FF.......", [(1, 2, 1)]),  # at 2 the last three still hold two
        (1, 3, ".F.......", [(1, 3, 1)]),
        (3, 5, "F.F.F....", [(4, 4, 1)]),
        (3, 5, "FFF......", [(2, 4, 1)]),
        (2, 4, "F........F", []),
        (1, 4, "F...F.....", [(0, 7, 2)]),
        (4, 4, "FFFF......", [(3, 3, 1)]),
    ],
)
def test_an_alarm_lasts_while_k_of_the_last_n_windows_are_fault(k, n, pattern, expected):
    assert spans(pattern, k=k, n=n) == expected


@pytest.mark.parametrize(
    "hold, pattern, expected",
    [
        (0, ".F......", [(1, 1, 1)]),
        (2, ".F......", [(1, 3, 1)]),
        (2, ".F..F...", [(1, 6, 2)]),  # quiet samples 2 and 3 are held
        (2, ".F...F..", [(1, 3, 1), (5, 7, 1)]),
        (9, ".F......", [(1, 7, 1)]),  # not beyond the recording
    ],
)
def test_hold_keeps_an_alarm_on_for_so_many_samples(hold, pattern, expected):
    assert spans(pattern, hold=hold) == expected


@pytest.mark.parametrize(
    "clear, pattern, expected",
    [
        (1, "F.F..F", [(0, 0, 1), (2, 2, 1), (5, 5, 1)]),
        (2, "F.F..F", [(0, 2, 2), (5, 5, 1)]),
        (3, "F.F..F", [(0, 5, 3)]),
        (3, "F..F......", [(0, 3, 2)]),  # the quiet end is not part of the alarm
    ],
)
def test_an_alarm_ends_only_after_clear_quiet_samples(clear, pattern, expected):
    assert spans(pattern, clear=clear) == expected


def test_quiet_samples_are_counted_after_the_hold():
    assert spans("F...F...", hold=2, clear=1) == [(0, 2, 1), (4, 6, 1)]
    assert spans("F...F...", hold=2, clear=2) == [(0, 6, 2)]


def brute_force(fault, k, n, hold, clear):
    """Walk through the samples one by one with a counter, as a programmable controller would."""
    on_now, alarms, start, last_on = False, [], None, None
    for i in range(len(fault)):
        if sum(fault[max(0, i - n + 1) : i + 1]) >= k:
            if not on_now:
                on_now, start = True, i
            last_on = i
        elif on_now and i - last_on - hold >= clear:
            alarms.append((start, last_on + hold))
            on_now = False
    if on_now:
        alarms.append((start, min(last_on + hold, len(fault) - 1)))
    return [(a, b, int(sum(fault[a : b + 1]))) for a, b in alarms]


def test_alarms_equal_a_walk_through_the_samples(rng):
    for _ in range(300):
        fault = rng.random(60) < rng.choice([0.05, 0.2, 0.5, 0.9])
        n = int(rng.integers(1, 6))
        rule = dict(
            k=int(rng.integers(1, n + 1)), n=n, hold=int(rng.integers(0, 5)), clear=int(rng.integers(1, 6))
        )
        assert spans("".join(".F"[int(f)] for f in fault), **rule) == brute_force(
            fault.astype(int).tolist(), **rule
        ), rule


def test_depth_is_the_worst_margin_of_the_faults_and_worst_its_sample():
    (alarm,) = result("F.FF", [-1.0, -9.0, -3.0, -2.0]).alarms(
        clear=2
    )  # a margin of a window that is no FAULT does not count
    assert (alarm.depth, alarm.worst, alarm.windows) == (-3.0, 2, 3)
    assert isinstance(alarm.depth, float) and isinstance(alarm.start, int) and isinstance(alarm.worst, int)


def test_each_alarm_has_a_depth_of_its_own():
    assert [(a.depth, a.worst) for a in result("FF..FF", [-1, -2, 0, 0, -4, -3]).alarms()] == [
        (-2, 1),
        (-4, 4),
    ]


@pytest.mark.parametrize(
    "pattern, expected",
    [
        ("..FFF", "still on at the last sample"),
        ("..FFF-", "no data after it"),
        ("..FF-.", "no data after it"),
        ("..FFF.", "its onset may have left the window: repaired or lasting"),
        ("..FFF?", "its onset may have left the window: repaired or lasting"),
        ("..FFFF.", "seen beyond its onset and no longer: repaired or hidden"),
    ],
)
def test_an_alarm_says_why_it_is_over(pattern, expected):
    assert [a.ended for a in result(pattern, relations=LONG).alarms()] == [expected]


@pytest.mark.parametrize(
    "rule, expected",
    [
        ({"clear": 2}, ("seen beyond", "still on")),
        ({"hold": 3}, ("seen beyond", "still on")),
        ({"k": 2, "n": 3}, ("seen beyond",)),
        ({}, ("its onset", "its onset", "still on")),
    ],
)
def test_what_an_alarm_rule_adds_does_not_count_as_seen(rule, expected):
    found = [a.ended for a in result("..FF.F......F", relations=LONG).alarms(**rule)]
    assert len(found) == len(expected) and all(a.startswith(b) for a, b in zip(found, expected, strict=True))


def test_alarms_of_a_batch_name_their_recording_and_come_in_order():
    res = result(["..F.", "....", "F..F"])
    assert [(a.recording, a.start) for a in res.alarms()] == [((0,), 2), ((2,), 0), ((2,), 3)]
    deep = jb.Result(res.status[None], res.margin[None], "joint", RELATIONS, res.u[None], res.y[None])
    assert [a.recording for a in deep.alarms()] == [(0, 0), (0, 2), (0, 2)]


def test_an_alarm_does_not_run_over_into_the_next_recording():
    assert [(a.recording, a.start, a.end) for a in result(["...F", "F..."]).alarms(hold=2, clear=3)] == [
        ((0,), 3, 3),
        ((1,), 0, 2),
    ]


def test_a_single_recording_has_no_index():
    assert result("F").alarms()[0].recording == ()


@pytest.mark.parametrize("shape", [(0,), (3, 0), (0, 5)])
def test_an_empty_result_has_no_alarms(shape):
    empty = jb.Result(
        np.zeros(shape, np.int8),
        np.zeros(shape),
        "joint",
        RELATIONS,
        np.zeros((*shape, 1)),
        np.zeros((*shape, 2)),
    )
    assert empty.alarms() == []


def test_grouping_leaves_the_verdicts_alone():
    res = result("F..F?-")
    before = res.status.copy()
    res.alarms(k=1, n=3, hold=2, clear=2)
    np.testing.assert_array_equal(res.status, before)


@pytest.mark.parametrize(
    "rule, message",
    [
        (dict(k=0), "k must be a whole number >= 1, not 0"),
        (dict(n=0), "n must be a whole number >= 1, not 0"),
        (dict(hold=-1), "hold must be a whole number >= 0, not -1"),
        (dict(clear=0), "clear must be a whole number >= 1, not 0"),
        (dict(k=1.5, n=2), "k must be a whole number >= 1, not 1.5"),
        (dict(k=True), "k must be a whole number >= 1, not True"),
        (dict(k=3, n=2), "k of n needs k <= n: 3 of 2"),
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(rule, message):
    with pytest.raises(ValueError, match=message):
        result("FF").alarms(**rule)
