"""Alarms by a rule, as verdicts come: compared with a walk through the samples, one by one."""

import json

import numpy as np
import pytest

from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.suspects import Suspect
from jaxbound.diagnosis.watch import ACKNOWLEDGED, BEGINS, ENDS, LASTING, OPPOSITE, Seen, Watch

UP, DOWN = Suspect(("T1",), 2.0, 1), Suspect(("T1",), 1.5, -1)
OTHER = Suspect(("T2", "T1"), 1.0, 1)


def seen(fault, margin=None, first=0, proved=None):
    fault = np.asarray(fault, bool)
    if margin is None:
        margin = np.where(fault, -1.0, 0.5)
    instant = np.arange(len(fault)) + float(first)
    missing = np.zeros(len(fault), bool)
    return Seen.of(fault, np.asarray(margin, float), missing, instant=instant, proved=proved)


def of(suspects):
    """Return what a Watch asks for suspects, from {sample: suspect}."""
    return lambda k, test: suspects[k]


def flags(pattern):
    return np.array([c != "." for c in pattern])


def walked(fault, rule):
    """Walk through the samples with counters; return (start, end, windows) of alarms, neighbours merged."""
    spans, start, last = [], None, None
    for i in range(len(fault)):
        if sum(fault[max(0, i - rule.n + 1) : i + 1]) >= rule.k:
            start = i if start is None else start
            last = i
        elif start is not None and i - last - rule.hold >= rule.clear:
            spans.append((start, last + rule.hold))
            start = None
    if start is not None:
        spans.append((start, min(last + rule.hold, len(fault) - 1)))
    found = []
    for a, b in spans:
        windows = int(sum(fault[a : b + 1]))
        if found and rule.merge and a - found[-1][1] <= rule.merge:
            found[-1] = (found[-1][0], b, found[-1][2] + windows)
        else:
            found.append((a, b, windows))
    return found


def alarms(watch, pieces):
    """Return the alarms that a Watch makes of pieces, in the order in which they begin; resumed between."""
    events = []
    for piece in pieces:
        again = Watch(watch.rule, watch.blame)
        again.resume(json.loads(json.dumps(watch.memory())))
        watch = again
        events += watch.events(watch.add(piece))
    events += watch.events(watch.finish())
    over = [event.alarm for event in events if event.kind == ENDS]
    return sorted(over, key=lambda alarm: alarm.number), events


def cut(rng, fault, margin):
    edges = [0, *sorted(rng.integers(0, len(fault) + 1, rng.integers(0, 6))), len(fault)]
    return [seen(fault[a:b], margin[a:b], a) for a, b in zip(edges, edges[1:], strict=False)]


def test_alarms_are_those_of_a_walk_through_the_samples_cut_anywhere(rng):
    for _ in range(300):
        fault = rng.random(60) < rng.choice([0.05, 0.2, 0.5, 0.9])
        margin = np.where(fault, -rng.random(60), 0.5)
        n = int(rng.integers(1, 6))
        k, hold, clear, merge = int(rng.integers(1, n + 1)), *rng.integers([0, 1, 0], [5, 6, 9]).tolist()
        rule = AlarmRule(k, n, hold, clear, merge)
        found, events = alarms(Watch(rule), cut(rng, fault, margin))
        assert [(a.start, a.end, a.windows) for a in found] == walked(fault.tolist(), rule), rule
        for a in found:
            inside = np.flatnonzero(fault[a.start : a.end + 1]) + a.start
            if not merge:
                assert (a.worst, a.depth) == (inside[np.argmin(margin[inside])], margin[inside].min())
            assert a.last == inside[-1] and fault[a.first] and a.start - n < a.first <= a.start
        assert [e.sample for e in events] == sorted(e.sample for e in events)
        assert [e.sample for e in events if e.kind == BEGINS] == [a.start for a in found]


def test_when_an_alarm_is_known_to_be_over_does_not_depend_on_the_pieces(rng):
    for _ in range(40):
        proved = rng.random(80) < rng.choice([0.2, 0.6])
        fault = proved & (rng.random(80) < rng.choice([0.5, 1.0]))
        blames = [(UP, DOWN, OTHER)[rng.integers(3)] for _ in range(80)]
        n = int(rng.integers(1, 4))
        k, hold, clear, merge = int(rng.integers(1, n + 1)), *rng.integers([0, 1, 0], [2, 3, 6]).tolist()
        latch, times = bool(rng.random() < 0.6), (rng.integers(0, 160, 3) / 2).tolist()
        given = times if latch and rng.random() < 0.5 else ()
        rule = AlarmRule(k, n, hold, clear, merge, latch=latch, suspects=True, acknowledged=given)
        told = []
        for edges in (sorted(rng.integers(0, 81, 4)), range(81), ()):
            edges = [0, *edges, 80]
            pieces = []
            for a, b in zip(edges, edges[1:], strict=False):
                pieces.append(seen(fault[a:b], first=a, proved=proved[a:b]))
            _, events = alarms(Watch(rule, of(blames)), pieces)
            told.append([(e.sample, e.kind, e.number, e.kind == ENDS and e.alarm.end) for e in events])
            told[-1] += [(e.alarm.start, e.alarm.ended) for e in events]
        assert told[0] == told[1] == told[2], rule


def test_alarms_of_different_suspects_overlap_and_are_two():
    blame = {2: UP, 6: OTHER, 10: UP}
    found, _ = alarms(Watch(AlarmRule(merge=9), of(blame)), [seen(flags("..FF..F...F....."))])
    spans = [(a.start, a.end, a.suspect.first, a.windows) for a in found]
    assert spans == [(2, 10, "T1", 3), (6, 6, "T2", 1)]


def test_a_latched_alarm_lasts_to_the_end_where_nothing_speaks_for_a_repair():
    (alarm,), _ = alarms(Watch(AlarmRule(latch=True), lambda k, test: UP), [seen(flags("..F...F....."))])
    assert (alarm.start, alarm.end, alarm.windows, alarm.ended) == (2, 11, 2, LASTING)


def test_an_opposite_jump_of_the_same_signal_and_size_ends_a_latched_alarm():
    blame = {2: UP, 6: DOWN, 9: UP}
    found, events = alarms(Watch(AlarmRule(latch=True), of(blame)), [seen(flags("..F...F..F.."))])
    assert [(a.start, a.end, a.ended) for a in found] == [(2, 6, f"{OPPOSITE} of T1"), (9, 11, LASTING)]
    assert [(e.sample, e.kind) for e in events] == [(2, BEGINS), (7, ENDS), (9, BEGINS), (11, ENDS)]


@pytest.mark.parametrize(
    "second", [UP, Suspect(("T1",), 0.9, -1), Suspect(("T1",), 4.1, -1), Suspect(("T1",), 2.0, 0), OTHER]
)
def test_no_other_jump_ends_a_latched_alarm(second):
    blame = {2: UP, 6: second}
    found, _ = alarms(Watch(AlarmRule(latch=True), of(blame)), [seen(flags("..F...F....."))])
    assert found[0].ended == LASTING and found[0].end == 11


def test_a_jump_and_its_end_in_one_stretch_end_the_alarm():
    blame = {2: UP, 5: DOWN}
    (alarm,), _ = alarms(Watch(AlarmRule(latch=True), of(blame)), [seen(flags("..FFFF......"))])
    assert (alarm.end, alarm.ended) == (5, f"{OPPOSITE} of T1")


def test_suspects_are_asked_for_at_the_first_and_last_fault_alone():
    asked = []
    watch = Watch(AlarmRule(latch=True), lambda k, test: asked.append(k) or UP)
    watch.add(seen(np.ones(1000, bool)))
    watch.add(seen(np.zeros(9, bool)))
    assert asked == [0, 999]


def test_pending_alarms_are_told_as_if_the_recording_ended_and_go_on():
    watch = Watch(AlarmRule(latch=True), lambda k, test: UP)
    watch.add(seen(flags("..F..")))
    assert [(alarm.end, alarm.ended) for alarm in watch.pending()] == [(4, LASTING)]
    watch.add(seen(flags("...")))
    assert [alarm.end for alarm in watch.pending()] == [7]


def latched_walk(fault, rule, times):
    """Walk through the samples; return (start, end, ended) of alarms that nothing but times end."""
    found, start, since = [], None, 0

    def acknowledge(last, behind):
        nonlocal start, since
        if start is not None:
            found.append((start, last, ACKNOWLEDGED))
            start, since = None, behind

    for i in range(len(fault)):
        if any(i - 1 < t < i for t in times):
            acknowledge(i - 1, i)
        if start is None and sum(fault[max(since, i - rule.n + 1) : i + 1]) >= rule.k:
            start = i
        if i in times:
            acknowledge(i, i + 1)
    if start is not None:
        found.append((start, len(fault) - 1, LASTING))
    return found


def test_acknowledgements_end_latched_alarms_and_what_is_proved_behind_them_makes_new_ones(rng):
    for _ in range(200):
        fault = rng.random(60) < rng.choice([0.05, 0.3, 0.8])
        fault[-5:] = False  # nothing is on at the end
        n = int(rng.integers(1, 5))
        times = rng.integers(0, 130, rng.integers(1, 9)) / 2
        rule = AlarmRule(int(rng.integers(1, n + 1)), n, latch=True, acknowledged=times.tolist())
        found, events = alarms(Watch(rule), cut(rng, fault, fault - 0.5))
        expected = latched_walk(fault.tolist(), rule, times)
        assert [(a.start, a.end, a.ended) for a in found] == expected, rule
        assert [e.sample for e in events if e.kind == ENDS and e.alarm.ended == ACKNOWLEDGED] == [
            int(np.ceil(times[times >= start].min())) for start, _, ended in expected if ended == ACKNOWLEDGED
        ]


def test_a_late_acknowledgement_ends_the_alarms_that_had_begun_by_then_and_no_other(tmp_path):
    file = tmp_path / "seen.txt"
    file.write_text("# time, who\n")
    watch = Watch(AlarmRule(latch=True, acknowledged=file), of({2: UP, 6: OTHER}))
    watch.add(seen(flags("..F...F.")))
    with file.open("a") as operator:
        operator.write("5, J. Smith\n5")
    (over,) = watch.add(seen(flags("..."), first=8))
    assert (over.sure, over.suspect.first, over.end, over.ended) == (8, "T1", 7, ACKNOWLEDGED)
    with file.open("a") as operator:
        operator.write("0\n")  # the line is complete: 50, which lies ahead
    assert not watch.add(seen(flags("..."), first=11))


def test_an_acknowledgement_in_a_stretch_takes_the_jump_back_in_it_for_the_end():
    blame = {2: UP, 4: DOWN, 5: DOWN}
    rule = AlarmRule(latch=True, acknowledged=[4])
    found, _ = alarms(Watch(rule, of(blame)), [seen(flags("..FFFF.."))])
    assert [(a.start, a.end, a.ended) for a in found] == [(2, 4, f"{OPPOSITE} of T1"), (5, 7, LASTING)]


def in_alarm(rule, fault, proved, blames):
    """Return the numbers of the samples that alarms by a rule last over."""
    windows = seen(fault, proved=proved)
    found, _ = alarms(Watch(rule, of(blames)), [windows])
    return {sample for alarm in found for sample in range(alarm.start, alarm.end + 1)}


def test_a_stricter_rule_is_never_longer_in_alarm(rng):
    """More of n, k of fewer, no latch, a smaller merge, a larger least: whoever says so in fewer places."""
    suspects = [UP, DOWN, OTHER, OTHER._replace(jump=-1), Suspect()]
    for _ in range(400):
        proved = rng.random(40) < rng.choice([0.1, 0.3, 0.6])
        blames = [suspects[i] for i in rng.integers(0, len(suspects), 40)]
        loose, strict = proved & (rng.random((2, 40)) < rng.choice([0.5, 0.9, 1.0]))
        n = int(rng.integers(1, 6))
        k, hold, clear, merge = int(rng.integers(1, n + 1)), *rng.integers([0, 1, 0], [3, 4, 9]).tolist()
        rule = AlarmRule(k, n, hold, clear, merge, latch=bool(rng.random() < 0.7))
        fewer = int(rng.integers(k, n + 1))
        stricter = AlarmRule(
            int(rng.integers(k, fewer + 1)),
            fewer,
            int(rng.integers(0, hold + 1)),
            int(rng.integers(1, clear + 1)),
            int(rng.integers(0, merge + 1)),
            latch=rule.latch and bool(rng.random() < 0.7),
            suspects=bool(rng.random() < 0.5),
        )
        longer = in_alarm(rule, loose, proved, blames)
        assert in_alarm(stricter, loose & strict, proved, blames) <= longer, (stricter, rule)


def test_suspects_of_many_runs_are_asked_for_now_and_then():
    """A FAULT in every second of 20 000 windows asked 10 000 times in exact rationals."""
    asked = []
    fault = np.arange(20_000) % 2 == 0
    (alarm,), _ = alarms(Watch(AlarmRule(latch=True), lambda k, test: asked.append(k) or UP), [seen(fault)])
    assert (alarm.start, alarm.windows, alarm.ended) == (0, 10_000, LASTING)
    assert asked[:256] == list(range(0, 512, 2)) and len(asked) < 256 + 20_000 // 256 + 2
