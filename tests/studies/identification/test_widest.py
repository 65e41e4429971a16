"""Where the bounds of a fit come from, and what leaving out one time would give."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from jaxbound.plots.fit import plot_fit
from jaxbound.recordings.expressions import derived, expression, fails
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.widest import widest_of

SAMPLES, S = 100, 4
NAMES = ["monday.csv", "tuesday.csv", "wednesday.csv"]


def days(columns=None, times="dates"):
    """Return the Training of three days from 6:50:30 on, a sample a minute; u steps every 25 samples."""
    recordings = []
    for number in range(3):
        begin = pd.Timestamp("2026-03-02 06:50:30") + pd.Timedelta(days=number)
        u = np.arange(SAMPLES) // 25 % 2
        table = pd.DataFrame({"u": u + 0.0, "y": np.arange(SAMPLES) % 7 + 0.0})
        if times == "dates":
            table.index = pd.date_range(begin, periods=SAMPLES, freq="min")
        if times == "seconds":
            table.index = 60.0 * np.arange(SAMPLES)
        recordings.append(table)
    return Training.of(recordings, "u", "y", 60.0, columns or {})


def needs(high, days=(0, 1, 2)):
    """Return what windows of S + 1 samples need: .8 with one of these samples of these days, else .2."""
    used = []
    for number in range(3):
        wrong = np.isin(np.arange(SAMPLES), list(high) if number in days else [])
        need = 0.2 + 0.6 * (np.convolve(wrong, np.ones(S + 1))[:SAMPLES] > 0)
        need[:S] = np.nan
        used.append(need)
    used[1][50] += 0.05
    used[days[-1]][max(high) if high else 0] += 0.01
    return used


def rest_of(where, training, used):
    """Return the most that a window needs of whose samples a condition leaves out none."""
    most = []
    for recording, need in zip(training.again(), used, strict=True):
        e = expression(where)
        gone = fails(e.values(derived(e.columns, SAMPLES, np.arange(SAMPLES) * 60.0, recording.stamps)))
        for k in range(S, SAMPLES):
            if not gone[k - S : k + 1].any():
                most.append(need[k])
    return max(most)


def test_samples_at_one_time_of_each_day_are_proposed_to_be_left_out():
    training, used = days(), needs(range(10, 15))
    widest = widest_of(training, used, S)
    assert (widest.recording, widest.sample, widest.when) == (3, 14, "2026-03-04 07:04:30")
    assert widest.where == "time_of_day < 25200 or time_of_day > 25560"
    assert widest.span == "07:00 to 07:06 of each day"
    assert widest.rest == rest_of(widest.where, training, used) == 0.25
    assert widest.cost == 6 / SAMPLES
    label, text = list(widest.rows(NAMES))[1]
    assert label == "leave out" and "`--where 'time_of_day < 25200 or time_of_day > 25560'`" in text
    assert "wednesday.csv, the window that ends at 2026-03-04 07:04:30" in next(iter(widest.rows(NAMES)))[1]


@pytest.mark.parametrize("times", ["dates", "seconds"])
def test_samples_at_the_start_are_proposed_to_be_left_out(times):
    training, used = days(times=times), needs(range(5))
    widest = widest_of(training, used, S)
    assert widest.where == "time_since_start > 300"
    assert widest.rest == rest_of(widest.where, training, used)
    assert widest.span == "the first 5 min of each recording"


@pytest.mark.parametrize("high", [range(10, 40), []])
def test_nothing_is_proposed_that_leaves_out_much_or_gives_little(high):
    widest = widest_of(days(), needs(high), S)
    assert widest.where == "" and len(list(widest.rows(NAMES))) <= 2


@pytest.mark.parametrize("high", [range(10, 15), range(5)])
def test_one_event_of_one_day_is_no_time_to_leave_out(high):
    assert widest_of(days(), needs(high, days=(1,)), S).where == ""


def test_one_day_tells_no_time_of_the_day():
    training = days()
    alone = dataclasses.replace(training, recordings=training.recordings[:1], records=training.records[:1])
    assert widest_of(alone, needs(range(10, 15), days=(0,))[:1], S).where == ""
    assert widest_of(alone, needs(range(5), days=(0,))[:1], S).where == "time_since_start > 300"


def test_recordings_without_times_say_the_window_alone():
    widest = widest_of(days(times=""), needs(range(10, 15)), S)
    assert (widest.sample, widest.where) == (14, "")


def test_an_observer_says_the_sample_alone():
    assert widest_of(days(), needs(range(10, 15)), None).where == ""


def test_windows_without_a_step_are_named_where_they_need_less():
    widest = widest_of(days(), needs([25, 50, 75]), S)
    assert widest.where == "" and widest.stepping == "u" and widest.rest == pytest.approx(0.2)
    assert "those without a step of u" in list(widest.rows(NAMES))[1][1]


def test_the_condition_of_the_recordings_stays():
    widest = widest_of(days({"where": "y < 7"}), needs(range(10, 15)), S)
    assert widest.where == "(y < 7) and (time_of_day < 25200 or time_of_day > 25560)"


def test_nothing_asks_for_bounds_that_no_window_needs():
    assert widest_of(days(), [np.full(SAMPLES, np.nan)] * 3, S) is None


def test_the_picture_shades_what_is_left_out():
    used = needs(range(10, 15))
    check = SimpleNamespace(used=used, held_out=None, tradeoff=(), widest=widest_of(days(), used, S))
    (_, _, by_time, legend) = plot_fit(SimpleNamespace(check=check, horizon=S)).axes
    (shade,) = by_time.patches
    assert (shade.get_x(), shade.get_x() + shade.get_width()) == pytest.approx((7, 7.1))
    assert "left out: 07:00 to 07:06 of each day" in [t.get_text() for t in legend.get_legend().texts]
