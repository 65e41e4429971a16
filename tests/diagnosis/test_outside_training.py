"""The second word on a verdict is the same however samples come, and what it says changes no verdict unless
asked to.
"""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
import streaming_case
from result_case import CONSISTENT, FAULT, MISSING, synthetic
from systems import paper

import jaxbound as jb
from jaxbound.consistency.interface import Judged
from jaxbound.consistency.monitor import Monitor
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.region import Excursions
from jaxbound.models.region import Departure, Region
from jaxbound.runs.alarmbook import AlarmBook
from jaxbound.runs.digest import detect_dataset
from jaxbound.runs.judges import Live
from jaxbound.runs.summary import summarised

pytestmark = pytest.mark.compiled

SEEN = {"u1": (-0.5, 0.5)}


def case(T=400):
    """Return (u, y) of the paper's plant: jumps that leave [-.5, .5] at times, two sensor faults, and missing
    samples.
    """
    rng = np.random.default_rng(7)
    u = np.repeat(rng.uniform(-0.45, 0.45, T // 20), 20)[:, None]
    u[150:260] *= 2
    u[190:230] = -0.8
    u[40:45] = 0.7
    y, x = np.zeros((T, 2)), np.zeros(2)
    for k in range(T):
        y[k], x = (x[0], x[0] + x[1]), np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y += rng.uniform(-0.9, 0.9, y.shape) * (abs(y) * [0.02, 0.1] + [0.1, 0.01])
    y[170:330, 0] += 1.5
    y[360:365, 0] -= 3
    y[rng.integers(0, T, 9), 1] = np.nan
    u[rng.integers(0, T, 5)] = np.nan
    return u, y


def words_of(res):
    return [res.outside, res.outside_by, res.departure.reading]


def assert_same(found, res):
    for one, other in zip(found, words_of(res), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_input_that_leads_most_windows_out_is_named_first():
    region = Region(("a", "b", "c"), ("", "", "bar"), np.zeros(3), np.ones(3), 0, 1)
    by, reading = np.array([0, 2, 2, 1, 2]), np.array([1.5, 2.0, 3.0, 9.0, 2.0])
    counted = Excursions(region)
    counted.add(np.full(5, CONSISTENT), np.ones(5), Departure(reading - 1, by, reading, region))
    counted.add(np.array([FAULT]), -np.ones(1), Departure(np.ones(1), by[:1], reading[:1], region))
    found = counted.total()
    assert list(found.inputs.items()) == [("a", 1)] and found.words == "a at 1.5, training up to 1"
    counted = Excursions(region)
    counted.add(np.full(5, CONSISTENT), np.ones(5), Departure(reading - 1, by, reading, region))
    assert next(iter(counted.total().inputs.items())) == ("c", 3)
    assert counted.total().words == "c at 3 bar, training up to 1 bar"


def test_steps_and_bursts_say_what_detect_says():
    u, y = case()
    relations, starts = jb.parity_relations(paper(ranges=SEEN, extrapolation="1.1"), 5), [60, 160]
    res = jb.detect(relations, u, y, starts=starts)
    mon = Monitor(relations)
    for cuts in ([0, 3, 4, 200, 201, 400], [0, *range(140, 221), 400]):
        state, found = mon.init(), []
        for a, b in zip(cuts, cuts[1:], strict=False):
            state, verdict = mon.run(state, u[a:b], y[a:b], starts=[k - a for k in starts if a <= k < b])
            found.append(verdict)
        np.testing.assert_array_equal(np.concatenate([v.status for v in found]), res.status)
        parts = [(v.outside, v.departure.by, v.departure.reading) for v in found]
        assert_same([np.concatenate(part) for part in zip(*parts, strict=True)], res)
    assert (res.outside > 0).sum() > 50 and (res.outside == 0).sum() > 50
    state, one = mon.step(mon.init(), u[0], y[0])
    assert np.isnan(one.outside) and one.departure.by == -1


@pytest.mark.parametrize("family", ["windows", "observer"])
def test_pieces_of_a_pipe_say_what_detect_says(family):
    u, y = case()
    model = paper(ranges=SEEN, extrapolation="1.1")
    relations = jb.observer(model) if family == "observer" else jb.parity_relations(model, 5)
    res = jb.detect(relations, u, y)
    judge, found = Live(Monitor(relations)), []
    for a, b in ((0, 1), (1, 2), (2, 151), (151, 152), (152, 400)):
        piece = jb.Recording(u[a:b], y[a:b])
        found += [verdicts for _, verdicts in judge((a, piece))]
        kept, judge = judge.memory(), Live(Monitor(relations))
        judge.resume(kept)  # as a process that goes on
    np.testing.assert_array_equal(np.concatenate([v.status for v in found]), res.status)
    parts = [(v.departure.share, v.departure.by, v.departure.reading) for v in found]
    assert_same([np.concatenate(part) for part in zip(*parts, strict=True)], res)


@pytest.mark.parametrize("family", ["windows", "observer"])
@pytest.mark.parametrize("outside", ["fault", "undecided"])
def test_parts_of_a_large_recording_say_what_detect_says(family, outside, tmp_path, monkeypatch):
    streaming_case.shrink(monkeypatch)
    t, u, y = streaming_case.recording()
    u = u.copy()
    u[1000:1060] = 1.75
    folder = streaming_case.write(tmp_path / "run", t, u, y)
    model = paper(ranges={"u1": (-1, 1)}, columns={"time": "t"}, extrapolation="1.1")
    relations = jb.observer(model) if family == "observer" else jb.parity_relations(model, 2)
    res = jb.detect(relations, jb.read(folder, model), outside=outside)
    found = detect_dataset(relations, folder, tmp_path / "out", chunk=300, outside=outside)
    table = pq.read_table(tmp_path / "out/verdicts.parquet")
    share, reading = (table[name].to_numpy() for name in ("outside", "outside_at"))
    by = [("", "u1").index(name) - 1 for name in table["outside_by"].to_pylist()]
    assert_same([share, by, reading], res)
    assert table["status"].to_pylist() == [jb.Status(s).name for s in res.status]
    assert found.beyond == res.beyond and found.beyond.windows >= 25
    whole = {a.start: (a.outside, a.outside_by) for a in res.alarms()}
    kept = {a.start: (a.outside, a.outside_by) for a in found.alarms}
    assert kept.items() <= whole.items() and len(kept) >= min(len(whole), 200)
    assert (found.beyond.faults > 0) == (outside == "fault") and res.counts == found.counts


def test_parts_made_with_one_word_are_not_taken_for_those_of_another(tmp_path, monkeypatch):
    streaming_case.shrink(monkeypatch)
    folder = streaming_case.write(tmp_path / "run", *streaming_case.recording())
    relations = jb.parity_relations(paper(ranges={"u1": (-1, 1)}, columns={"time": "t"}), 2)
    for word, other in (("fault", "undecided"), ("undecided", "fault")):
        detect_dataset(relations, folder, tmp_path / word, part=(1, 3), outside=word)
        with pytest.raises(ValueError, match="is of another word outside training"):
            detect_dataset(relations, folder, tmp_path / word, outside=other)


@pytest.mark.parametrize("first, second", [((0.9, 0.7), (0.8, 0.6)), ((0.7, 0.8), (0.6, 0.9))])
def test_an_alarm_over_two_parts_has_the_farthest_of_both(first, second, tmp_path):
    """The part of which a window lies farther outside need not be the one of the deeper window."""
    region = Region.of(jb.parity_relations(paper(ranges={"u1": (0, 0.5)}), 1))
    source, relations = SimpleNamespace(dt=1.0), jb.parity_relations(paper(), 1)
    book = AlarmBook(AlarmRule(), source, relations, "joint", tmp_path / "alarms.csv", lambda at: None)
    book.region = region
    for k, readings in enumerate((first, second)):
        reading = np.array([*readings])
        departure = Departure((reading - 0.5) / 0.5, np.zeros(2, np.int16), reading, region)
        judged = Judged(np.full(2, FAULT, np.int8), np.array([-1.0, -2.0 + k]), departure=departure)
        time = np.arange(2.0 * k, 2.0 * k + 2)
        book.add(jb.Recording(np.zeros((2, 0)), np.zeros((2, 0)), time=time), judged)
    book.close()
    ((alarm,), _) = book.alarms()
    assert alarm.outside == 4 and alarm.outside_by == "u1 at 0.9, training up to 0.5"


def test_undecided_is_said_of_fault_outside_alone():
    u, y = case()
    relations = jb.parity_relations(paper(ranges=SEEN), 5)
    res, other = (jb.detect(relations, u, y, outside=word) for word in ("fault", "undecided"))
    gone = (res.status == FAULT) & (res.outside > 0)
    assert 0 < gone.sum() < (res.status == FAULT).sum()
    np.testing.assert_array_equal(other.status, np.where(gone, jb.Status.UNDECIDED, res.status))
    np.testing.assert_array_equal(other.margin, res.margin)
    assert (other.suspect == res.suspect).all(), "who wants to look still can"
    assert other.beyond.unclaimed == gone.sum() == res.beyond.faults and not other.beyond.faults
    assert len(other.alarms()) < len(res.alarms()) or other.alarms() != res.alarms()
    mon = Monitor(relations, outside="undecided")
    np.testing.assert_array_equal(mon.run(mon.init(), u, y)[1].status, other.status)
    plain = jb.parity_relations(paper(), 5)
    assert jb.detect(plain, u, y, outside="undecided").counts == res.counts, (
        "without ranges nothing is outside"
    )


def test_the_relations_of_a_bank_claim_nothing_outside_either():
    u, y = case()
    bank = jb.structured_relations(paper(ranges=SEEN))
    res, other = (jb.detect(bank, u, y, outside=word) for word in ("fault", "undecided"))
    out = res.outside > 0
    assert res.violated[out].any() and not other.violated[out].any() and not other.candidates[out].any()
    np.testing.assert_array_equal(other.violated[~out], res.violated[~out])
    for i in range(len(res.signatures.relations)):
        held = res.of(i) != FAULT
        np.testing.assert_array_equal(other.of(i)[held], res.of(i)[held])


def test_the_tests_of_a_monitor_claim_nothing_outside_either():
    u, y = case()
    tests = [{"name": "short", "horizon": 1}, {"name": "long", "horizon": 5}]
    bank = jb.monitor(paper(ranges=SEEN), tests)
    res, other = (jb.detect(bank, u, y, outside=word) for word in ("fault", "undecided"))
    gone = (res.status == FAULT) & (res.outside > 0)
    assert 0 < gone.sum() < (res.status == FAULT).sum()
    np.testing.assert_array_equal(other.status, np.where(gone, jb.Status.UNDECIDED, res.status))
    claimed = (res.statuses == FAULT) & ~(res.outside > 0)[:, None]
    np.testing.assert_array_equal(other.statuses == FAULT, claimed)
    mon = Monitor(bank, outside="undecided")
    state, found = mon.init(), []
    for a, b in ((0, 3), (3, 200), (200, 400)):
        state, verdict = mon.run(state, u[a:b], y[a:b])
        found.append((verdict.status, verdict.statuses, verdict.departure.share))
    for one, whole in zip(
        zip(*found, strict=True), (other.status, other.statuses, other.outside), strict=True
    ):
        np.testing.assert_array_equal(np.concatenate(one), whole)
    _, one = mon.step(mon.init(), u[0], y[0])
    assert one.status == MISSING and np.isnan(one.departure.share)


def test_words_that_it_cannot_be_are_refused():
    u, y = case()
    relations = jb.parity_relations(paper(), 5)
    for call in (
        lambda: jb.detect(relations, u, y, outside="missing"),
        lambda: Monitor(relations, outside="missing"),
    ):
        with pytest.raises(ValueError, match="outside must be one of fault, undecided, not 'missing'"):
            call()
    with pytest.raises(ValueError, match="outside is for windows"):
        Monitor(jb.observer(paper()), outside="undecided")


def placed(status, out):
    """Return a Result with given verdicts, of which the windows that end at samples `out` lie outside."""
    res = synthetic(status, model=paper(ranges={"u1": (0, 0.4)}))
    res.u[np.asarray(out, int) - 1, 0] = 1.0  # the paper's plant has no feedthrough
    horizon = res.relations.horizon
    missing = res.status == MISSING
    assert horizon >= 1 and missing[:horizon].all()
    return res


def sentence(res):
    return summarised(res, res.alarms(), str, hints=res.hints)


H = jb.parity_relations(paper()).horizon


def test_a_day_that_is_all_fault_is_news_to_the_model_where_it_lies_outside():
    res = placed([MISSING] * H + [FAULT] * 20, range(H, H + 20))
    told = sentence(res)
    assert told.verdict == "fault" and told.exit_code == 1
    assert told.sentence.startswith(
        "Fault proved, outside training: all 20 FAULT windows read inputs that this model has never seen, "
        "most by u1 at 1, training up to 0.4: their proofs rest on extrapolation. 20 of 20 windows (100 %) "
    )
    assert not any("extrapolation" in hint for hint in told.hints), "once is enough"
    assert any("never seen" in hint for hint in res.hints) and not any(
        "do not fit" in hint for hint in res.hints
    )


def test_a_day_that_is_all_fault_is_a_fault_where_it_lies_inside():
    res = placed([MISSING] * H + [FAULT] * 20, [])
    assert sentence(res).sentence == (
        "Fault proved: every one of the 20 windows with data is FAULT, within the region of training: a "
        "fault lasts all through, or the bounds are too tight: all bounds times about 2 would make every "
        "window consistent; or a column is in another unit, or another signal, than the model has there: "
        "compare `jaxbound info MODEL.toml`."
    )


def test_fault_windows_of_which_some_lie_outside_are_counted():
    status = [MISSING] * H + [CONSISTENT] * 30 + [FAULT] * 10
    told = sentence(placed(status, range(H + 36, H + 40))).sentence
    assert told.startswith("Fault proved: 10 of 40 windows (25 %) cannot be explained")
    beyond = placed(status, range(H + 36, H + 40)).beyond
    assert (
        f"; {beyond.faults} of the FAULT ones lie outside training, most by u1 at 1, training up to 0.4."
        in told
    )
    inside = sentence(placed(status, [])).sentence
    assert "training" not in inside
    outside = sentence(placed(status, range(H + 30, H + 40))).sentence
    assert outside.startswith("Fault proved, outside training: all 10 FAULT windows read inputs that")


def test_a_single_window_outside_is_one():
    status = [MISSING] * H + [CONSISTENT] * 20 + [FAULT]
    assert sentence(placed(status, [H + 20])).sentence.startswith(
        "Fault proved, outside training: the only FAULT window reads inputs that this model has never seen, "
        "most by u1 at 1, training up to 0.4: its proof rests on extrapolation. 1 of 21 windows"
    )


def test_an_alarm_says_how_much_of_it_lies_outside():
    u, y = case()
    res = jb.detect(jb.parity_relations(paper(ranges=SEEN), 5), u, y)
    fault = res.status == FAULT
    for alarm in res.alarms(2, 3, hold=2):
        own = slice(alarm.start, alarm.end + 1)
        out = np.where(fault[own] & (res.outside[own] > 0), res.outside[own], 0)
        assert alarm.outside == np.count_nonzero(out)
        reading = res.departure.reading[own][np.argmax(out)]
        assert (f"u1 at {reading:.4g}" in alarm.outside_by) if alarm.outside else not alarm.outside_by
    counts = Counter(bool(alarm.outside) for alarm in res.alarms())
    assert counts[True] and counts[False]
    assert jb.detect(jb.parity_relations(paper(), 5), u, y).alarms()[0].outside is None


def test_each_recording_of_a_batch_has_its_own_word():
    u, y = case()
    relations = jb.parity_relations(paper(ranges=SEEN), 5)
    calm = np.clip(u, -0.5, 0.5)
    both = jb.detect(relations, np.stack([calm, u]), np.stack([y, y]))
    assert both.beyond_of((0,)).windows == 0 < both.beyond_of((1,)).windows == both.beyond.windows
    assert_same([x[1] for x in words_of(both)], jb.detect(relations, u, y))
