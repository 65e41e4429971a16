"""A fleet of monitors of several tests whose recordings come one after the other: what is said is what is
said of one recording.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.diagnosis.alarmrule import EVERY_FAULT
from jaxbound.runs.ask import Ask
from jaxbound.runs.fleet import FleetTest, Unit, detect_fleet

T, GAP = 120, 80
START = pd.Timestamp("2026-03-01 10:00")
M = jb.Status.MISSING
AVERAGES = {"outputs": [{"name": name, "averages": [{"samples": 4, "bound": 0.08}]} for name in ("y1", "y2")]}
MIXED = (
    {"name": "windows", "horizon": 3},
    {"name": "lags", "lags": [0, 1, 6], "factor": 1.2},
    {"name": "means", "horizon": 5, "model": AVERAGES},
    {"name": "all", "observer": "zonotope", "latched": True},
)
MODES = (
    {"name": "windows", "horizon": 3, "factor": 1.5},
    {"name": "first", "lags": [0, 1, 4], "when": "mode == 1"},
    {"name": "evening", "horizon": 3, "when": "mode == 2 and time_of_day < 86000"},
    {"name": "rest", "observer": "zonotope", "when": "otherwise"},
)
MATRICES = [["0.9", "0.05"], [0, "0.9"]], [[0], ["0.1"]], [[1, 0], [0, 1]]
NOISE = {"disturbance": ([[1, 0], [0, 1]], "0.005"), "inputs": "u1", "outputs": ["y1", "y2"]}


def plant(tests, **more):
    return jb.LinearSystem(*MATRICES, noise="0.1", tests=tests, **({"dt": 1} | NOISE | more))


def table(rng, step=1, each=1):
    """Return T samples, of `each` rows with a step in s: four jumps, missing samples, and a gap."""
    x, y, u = np.zeros(2), np.zeros((T, 2)), rng.uniform(0, 2, (T, 1)).round(3)
    for k in range(T):
        y[k] = x
        x = np.array([0.9 * x[0] + 0.05 * x[1], 0.9 * x[1] + 0.1 * u[k, 0]]) + rng.uniform(-4e-3, 4e-3, 2)
    y = (y + rng.uniform(-0.07, 0.07, y.shape)).round(6)
    for onset in rng.integers(10, T, 4):
        y[onset : onset + 6, 1] += 0.4
    y[rng.integers(0, T, 4), rng.integers(0, 2, 4)] = np.nan
    mode = np.repeat(rng.choice([0.0, 1.0, 2.0, 3.0, np.nan], T), rng.integers(1, 25, T))[:T]
    mode[::4] = np.nan_to_num(mode[::4], nan=1.0)  # a file needs a number in each column
    seconds = step * (np.arange(T * each) + 150 * each * (np.arange(T * each) >= GAP * each))
    columns = {"u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1], "mode": mode}
    columns = {name: np.repeat(x, each) for name, x in columns.items()}
    return pd.DataFrame({"time": START + pd.to_timedelta(seconds, "s"), **columns})


def judged(folder, frame, state=None, alarm=EVERY_FAULT, **how):
    """Return (UnitResult, MonitorResult, Recording, alarms) of a fleet of one unit."""
    kept = []
    frame.to_csv(folder / "run.csv", index=False)
    unit = Unit("unit", folder / "plant.toml", folder / "run.csv")
    page = lambda _, res, recording, alarms, summary: kept.append((res, recording, alarms)) or ""
    (result,) = detect_fleet([unit], FleetTest(Ask(**how), alarm, state=state), page)
    return result, *(kept or [(None, None, None)])[0]


def known_of(res, samples):
    """Return how many samples of a Result were judged before."""
    known = len(res.status) - samples
    for name, nothing in (("status", M), ("by", -1), ("statuses", M)):
        assert (getattr(res, name)[:known] == nothing).all()
    for name in ("margin", "test_margins"):
        assert np.isnan(getattr(res, name)[:known]).all()
    return known


def same(res, known, whole, first, stop):
    """Check that samples are judged as in one recording that is all of them."""
    for name in ("status", "by", "statuses"):
        np.testing.assert_array_equal(getattr(res, name)[known:], getattr(whole, name)[first:stop], name)
    for name in ("margin", "test_margins", "outside"):
        one, other = getattr(res, name)[known:], getattr(whole, name)[first:stop]
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12, err_msg=name)


def part_of(whole, first, stop, known):
    """Return the Result of some samples, behind others without a verdict."""
    here, fresh = slice(first - known, stop), np.arange(first - known, stop) >= first
    about = {"starts": (), "index": whole.index[here]}
    for name, nothing in (("status", M), ("by", -1), ("margin", np.nan)):
        about[name] = np.where(fresh, getattr(whole, name)[here], nothing)
    about |= {name: getattr(whole, name)[here] for name in ("u", "y", "statuses", "test_margins")}
    return replace(whole, **about)


@pytest.mark.parametrize(
    ("cases", "tests", "more", "each"),
    [
        (1, MIXED, {}, 1),
        (2, MIXED, {}, 1),
        (2, MODES, {"columns": {"where": "mode != 3"}, "ranges": {"u1": (0, "1.8")}}, 1),
        (2, MODES, {"dt": 3, "columns": {"every": "3 s"}}, 3),
    ],
    ids=["mixed", "mixed, twice", "where", "every"],
)
def test_recordings_one_after_the_other_are_judged_as_one(tmp_path, rng, cases, tests, more, each):
    jb.save_model(plant(tests, **more), tmp_path / "plant.toml")
    (tmp_path / "seen.txt").write_text(f"{START + pd.Timedelta(50 * each, 's')}\n")
    rule = jb.AlarmRule(2, 3, latch=True, acknowledged=tmp_path / "seen.txt")
    how = {"margins": "exact", "alarm": rule, "outside": "undecided"}
    faults = seen = 0
    for case in range(cases):
        frame = table(rng, each=each)
        _, whole, _, _ = judged(tmp_path, frame, **how)
        cuts = [0, *np.sort(rng.choice(range(12, T - 3, 4), 3, replace=False)), T]
        counted = np.zeros((len(tests), 4), int)
        spoken = np.zeros(len(tests), int)
        for first, stop in zip(cuts, cuts[1:], strict=False):
            piece = frame.iloc[first * each : stop * each]
            state = tmp_path / f"state {case}"
            result, res, recording, alarms = judged(tmp_path, piece, state=state, **how)
            assert res is not None, result.summary.sentence
            known = known_of(res, stop - first)
            same(res, known, whole, first, stop)
            anew = any(hint.startswith("the recording begins anew") for hint in result.summary.hints)
            assert anew == (first == GAP) and (known > 0) == (first > 0 and not anew)
            assert recording.label(known) == str(piece["time"].iloc[0])
            found = result.summary.found
            assert found.windows + found.aside == stop - first - (not known) * found.horizon
            expected = part_of(whole, first, stop, known).alarms(rule=rule)
            assert [replace(a, depth=0.0) for a in alarms] == [replace(a, depth=0.0) for a in expected]
            for i, test in enumerate(found.tests.values()):
                counted[i] += [test.counts[s.name] - known * (s == M) for s in jb.Status]
                spoken[i] += test.speaks
            if first == cuts[1 + case]:
                again, twice, _, same_alarms = judged(tmp_path, piece, state=state, **how)
                np.testing.assert_array_equal(twice.statuses, res.statuses)
                plain, before = again.summary.plain(), result.summary.plain()
                assert plain | {"hints": 0} == before | {"hints": 0} and same_alarms == alarms
        expected = [np.bincount(column, minlength=4) for column in whole.statuses.T]
        np.testing.assert_array_equal(counted, expected)
        np.testing.assert_array_equal(spoken, np.bincount(whole.by + 1, minlength=len(tests) + 1)[1:])
        seen += np.count_nonzero(whole.statuses != M, 0)
        faults += np.count_nonzero(whole.status == jb.Status.FAULT)
    assert faults and seen.all(), "each test judges, and some prove"


def test_a_state_of_other_tests_and_one_that_is_damaged_are_refused(tmp_path, rng):
    jb.save_model(plant(MIXED), tmp_path / "plant.toml")
    frame, how = table(rng), {"state": tmp_path / "state"}
    judged(tmp_path, frame.iloc[:30], **how)
    jb.save_model(plant(MIXED[:3]), tmp_path / "plant.toml")
    other, *_ = judged(tmp_path, frame.iloc[30:60], **how)
    alone, *_ = judged(tmp_path, frame.iloc[30:60], horizon=3, **how)
    for result in (other, alone):
        assert result.verdict == "not tested" and "is of another model" in result.summary.sentence
    (kept,) = (tmp_path / "state").iterdir()
    kept.write_bytes(kept.read_bytes()[:400])
    damaged, *_ = judged(tmp_path, frame.iloc[30:60], **how)
    assert damaged.verdict == "not tested" and "is damaged, or no state" in damaged.summary.sentence


@pytest.mark.parametrize("columns", [{}, {"where": "time_since_start >= 0"}])
def test_what_counts_from_the_start_of_a_recording_begins_anew(tmp_path, rng, columns):
    tests = MODES
    if not columns:
        tests = [{"name": "late", "horizon": 3, "when": "time_since_start > 5"}]
    jb.save_model(plant(tests, columns=columns), tmp_path / "plant.toml")
    frame = table(rng)
    for first in (0, 30):
        piece = frame.iloc[first : first + 30]
        result, res, *_ = judged(tmp_path, piece, state=tmp_path / "state")
        same(res, 0, judged(tmp_path, piece)[1], 0, 30)
        hint = [hint for hint in result.summary.hints if "time_since_start" in hint and "anew" in hint]
        assert len(hint) == (first > 0), "counts from the first sample of each recording"


def test_the_page_of_a_unit_that_goes_on_counts_its_new_samples(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    jb.save_model(plant(MODES), "plant.toml")
    (tmp_path / "units.csv").write_text("unit,model,recording\npump,plant.toml,run.csv\n")
    frame = table(rng).ffill()
    frame["mode"] = 1.0 + (np.arange(T) >= 20)
    frame.loc[44:49, "y2"] += 1.0
    for first, stop in ((0, 42), (42, 56)):
        frame.iloc[first:stop].to_csv("run.csv", index=False)
        code = main.main(["fleet", "units.csv", "--state", "state", "--out", f"out{first}"])
    page = next((tmp_path / "out42/units").iterdir()).read_text()
    assert code == 1 and "No test has a verdict at 0 of 14 samples" in page and "(here the first 4)" in page


def test_a_fault_behind_another_recording_is_proved_by_the_samples_of_both(tmp_path, rng):
    jb.save_model(plant(MIXED), tmp_path / "plant.toml")
    frame = table(rng)
    frame.loc[10:12, "y2"] += 1.0  # behind it the observer is latched
    frame.loc[28:, "y2"] += 1.0
    for first in (0, 30):
        _, res, *_ = judged(tmp_path, frame.iloc[first : first + 30], state=tmp_path / "state")
    assert res.known == 6
    observed_as_told(res, "all")
    for test in list(res.tests.values())[:3]:
        at = int(np.flatnonzero(test.status == jb.Status.FAULT)[0])
        assert at < 6 + test.relations.horizon and test.explain(at).proves == jb.Status.FAULT


def observed_as_told(res, name):
    """Check that the bands of an observer are those that its verdicts rest on."""
    test = res.tests[name]
    np.testing.assert_array_equal(test.observation.status[res.known :], test.status[res.known :])
    margin = test.observation.margin[res.known :]
    np.testing.assert_allclose(margin, test.margin[res.known :], rtol=1e-9, atol=1e-12)


def test_an_observer_under_a_condition_goes_on_in_the_result_of_its_test(tmp_path, rng):
    jb.save_model(plant(MODES), tmp_path / "plant.toml")
    frame = table(rng).assign(mode=0.0)
    for first in (0, 30):
        _, res, *_ = judged(tmp_path, frame.iloc[first : first + 30], state=tmp_path / "state")
    observed_as_told(res, "rest")


@pytest.mark.parametrize("how", [{}, {"horizon": 3}])
def test_windows_across_samples_that_are_set_aside_at_the_end_are_missing(tmp_path, rng, how):
    jb.save_model(plant(MIXED, columns={"where": "mode != 3"}), tmp_path / "plant.toml")
    frame = table(rng).assign(mode=3.0 * ((np.arange(T) >= 22) & (np.arange(T) < 30)))
    _, whole, *_ = judged(tmp_path, frame.iloc[:60], **how)
    for first in (0, 30):
        _, res, *_ = judged(tmp_path, frame.iloc[first : first + 30], state=tmp_path / "state", **how)
    np.testing.assert_array_equal(res.status[-30:], whole.status[30:])


def test_a_window_of_one_sample_is_judged_once(tmp_path, rng):
    """The last sample of each recording was judged again with the next one."""
    doubled = jb.LinearSystem([["0.9"]], None, [[1], [1]], noise="0.1", dt=1, outputs=["y1", "y2"])
    jb.save_model(doubled, tmp_path / "plant.toml")
    frame = table(rng).drop(columns=["u1", "mode"])
    for first in (0, 30):
        result, res, *_ = judged(
            tmp_path, frame.iloc[first : first + 30], state=tmp_path / "state", horizon=0
        )
        assert len(res.status) == 30 and not any("anew" in hint for hint in result.summary.hints)
