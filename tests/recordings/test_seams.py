"""Seams in time: found the same in one piece and in chunks, each with its sentence."""

from dataclasses import astuple

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.read import read_signals
from jaxbound.recordings.seams import Clock, all_starts, check_period, crossing, irregular, seam_hints, tick


def patched(rng, count, seams, dt=0.5):
    """Return times dt apart with jitter, and the samples at which they jump by more than jitter."""
    steps = dt * (1 + rng.uniform(-0.15, 0.15, count))
    where = np.sort(rng.choice(np.arange(1, count), seams, replace=False))
    steps[where] = rng.choice([0.0, 0.3 * dt, 1.3 * dt, 40 * dt, -3 * dt, -700.0], seams)
    return np.cumsum(steps), where


def ticked(time, cuts, dt=0.5):
    clock, starts = Clock(dt), []
    for part in np.split(time, cuts):
        clock, fresh = tick(clock, part)
        starts += fresh.tolist()
    return clock, starts


class TestTick:
    def test_every_jump_is_found_and_no_jitter(self, rng):
        time, where = patched(rng, 2000, 60)
        assert ticked(time, [])[1] == where.tolist()

    def test_chunks_find_the_same(self, rng):
        time, where = patched(rng, 500, 40)
        whole, starts = ticked(time, [])
        for _ in range(20):
            cuts = np.sort(rng.integers(0, 501, 30))  # empty chunks and chunks of one sample among them
            clock, found = ticked(time, cuts)
            assert found == starts == where.tolist()
            assert (clock.samples, clock.last) == (500, time[-1])
            assert {s.kind: astuple(s) for s in clock.seams} == {s.kind: astuple(s) for s in whole.seams}

    def test_seams_are_counted_by_kind(self):
        clock, _ = tick(Clock(1.0), np.array([0, 1, 5, 6, 6, 6, 6.5, 7.5, 3, 4, 14, 15]))
        assert {s.kind: (s.count, s.sample, s.step) for s in clock.seams} == {
            "gap": (2, 10, 10.0),
            "early": (1, 6, 0.5),
            "repeated": (2, 4, 0.0),
            "backward": (1, 8, -4.5),
        }

    @pytest.mark.parametrize("step, seam", [(1.2, False), (0.8, False), (1.2001, True), (0.7999, True)])
    def test_twenty_percent_is_jitter(self, step, seam):
        assert len(tick(Clock(1.0), np.array([0, step, step + 1]))[1]) == seam


@pytest.mark.parametrize("horizon", [0, 1, 2, 7])
def test_a_window_crosses_exactly_the_seams_inside_it(rng, horizon):
    starts = rng.choice(100, 12, replace=False)
    expected = [any(k - horizon < s <= k for s in starts) for k in range(100)]
    assert crossing(starts, horizon, 0, 100).tolist() == expected
    for first, stop in [(30, 60), (99, 100), (50, 50)]:
        assert crossing(starts, horizon, first, stop).tolist() == expected[first:stop]


class TestSentences:
    def hints(self, *steps):
        time = np.cumsum([0, *np.repeat(1.0, 20), *steps])
        clock, _ = tick(Clock(1.0), time)
        return list(seam_hints(clock, lambda k: f"{time[k]:g} s", lambda k: f"row {k + 2}"))

    def test_nothing_to_say(self):
        assert self.hints(1, 1.1) == []

    @pytest.mark.parametrize(
        "steps, sentence",
        [
            ([30], "the recording has a gap of 30 s before row 23 (50 s)"),
            ([30, 1, 45], "the recording has 2 gaps, the longest, 45 s, before row 25 (96 s)"),
            ([0.25], "row 23 (20.25 s) comes only 0.25 s after the row before it"),
            ([0.25, 0.5], "2 rows come too soon, the first, row 23 (20.25 s), after 0.25 s"),
            ([0], "row 23 (20 s) repeats the time of the row before it"),
            ([0, 0], "2 rows repeat the time of the row before, the first is row 23 (20 s)"),
            ([-5], "the clock goes back by 5 s before row 23 (15 s)"),
            ([-5, -6], "the clock goes back 2 times, the farthest, 6 s, before row 24 (9 s)"),
        ],
    )
    def test_each_kind(self, steps, sentence):
        assert self.hints(*steps) == [
            f"{sentence}: the recording is split there, and windows across are MISSING"
        ]

    def test_mostly_irregular_time_is_none(self):
        label, where = lambda k: f"{k}.", lambda k: f"row {k}"
        half = tick(Clock(1.0), np.array([0, 1, 2, 5, 8.0]))[0]
        assert irregular(half, label, where) == ""
        more = tick(half, np.array([9.5]))[0]
        assert irregular(more, label, where) == (
            "the recording is not regular: 3 of 5 steps differ from dt = 1 s by more than 20%; "
            "row 3 (3.), for one, comes 3 s after the row before it"
        )

    @pytest.mark.parametrize(
        "time, message",
        [
            (
                np.arange(9) * 2.0,
                "the model has dt = 1 s, but the rows of the recording are 2 s apart: fit again, "
                "with healthy recordings 2 s apart$",
            ),
            (np.arange(9) * 1000.0, "apart: is its time in ms\\? Then call its column so, like 'time .ms.'$"),
            (
                np.arange(9) / 60,
                "apart: is its time in min.*'time .min.'; else keep one of every 60 rows, let",
            ),
            (np.arange(9) / 3600, "apart: is its time in h.*'time .h.'; else let samples be means"),
            (np.arange(9) / 86400, "apart: is its time in d.*'time .d.'; else let samples be means"),
            (np.arange(9) / 100, "apart: let samples be means .*, or fit again, .* recordings 0.01 s apart$"),
            (np.arange(9) // 3 * 1.0, "0 s apart: more than half of the rows repeat the time"),
            (
                np.arange(9) / 3,
                r"apart: keep one of every 3 rows, .* \(--every 1s\), or fit again, with healthy recordings "
                r"0.333 s apart$",
            ),
            (np.arange(27.0) * 5 % 27, "4 of 27 rows go back in time: sort them by time"),
            (-np.arange(9.0), "the rows run backwards in time, the newest first: sort them by time"),
        ],
    )
    def test_another_period_is_refused(self, time, message):
        with pytest.raises(ValueError, match=message):
            check_period(time, 1.0)

    def test_a_single_sample_has_no_period(self):
        check_period(np.array([3.0]), 1.0)


@pytest.mark.parametrize("starts", [[1.5], [True, False], [[1]], ["a"], [9], [3, -1]])
def test_starts_that_are_no_sample_numbers_are_refused(starts):
    with pytest.raises(ValueError, match="starts needs the numbers of samples"):
        all_starts(starts, 9)


class TestStepsThatVary:
    """A logger that writes each one to two seconds: a sentence names them and the interval that serves."""

    STEPS = 'its steps vary from 1 s to 2 s: .* every = "2s" \\(--every 2s\\)'

    @pytest.fixture
    def path(self, tmp_path):
        time = np.cumsum(np.random.default_rng(1).integers(1, 3, 300))
        rows = "".join(f"{t},{t % 7},{t % 5}\n" for t in time)
        (tmp_path / "run.csv").write_text("time,u1,y1\n" + rows)
        pd.read_csv(tmp_path / "run.csv").to_parquet(tmp_path / "run.parquet")
        return tmp_path / "run.csv"

    def test_under_another_period(self, path):
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1.5, noise=0.1)
        for one in (path, path.with_suffix(".parquet")):
            with pytest.raises(ValueError, match=self.STEPS):
                jb.read(one, model)

    def test_where_there_is_no_model(self, path):
        """Half of the steps are no gaps in 1 s or 2 s, but hardly a window is without one."""
        for one in (path, path.with_suffix(".parquet")):
            with pytest.raises(ValueError, match="the recording is not regular: .*" + self.STEPS):
                read_signals(one, ["u1"], ["y1"])
        with pytest.raises(ValueError, match="the recording is not regular: .*" + self.STEPS):
            jb.fit(pd.read_csv(path), inputs="u1", outputs="y1")

    def test_where_few_do(self, tmp_path):
        time = np.cumsum(np.where(np.arange(300) % 7, 1, 2))
        pd.DataFrame({"time": time, "y1": time % 5}).to_csv(tmp_path / "run.csv", index=False)
        (r,) = read_signals(tmp_path / "run.csv", [], ["y1"])
        assert "42 of 299 steps of the recording are not dt = 1 s: " in r.hints[1] and "2s" in r.hints[1]

    def test_gaps_are_no_steps(self, tmp_path):
        time = np.cumsum(np.where(np.arange(300) % 4, 1, 3600))
        pd.DataFrame({"time": time, "y1": time % 5}).to_csv(tmp_path / "run.csv", index=False)
        (r,) = read_signals(tmp_path / "run.csv", [], ["y1"])
        assert "--every" not in " ".join(r.hints) and len(r.starts) == 74

    def test_the_interval_that_is_named_serves(self, path):
        (r,) = read_signals(path, ["u1"], ["y1"], {"every": "2s"})
        assert not len(r.starts) and not np.isnan(r.y).any() and r.dt == 2
