"""Numbers tell the time in the unit that their name, range and step say, whoever reads them; else a sentence
asks for it.
"""

import datetime
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import jaxbound as jb
from jaxbound.recordings.counting import counting_of, read_numbers
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import read_signals
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import with_format
from jaxbound.recordings.seams import usual_period

MODEL = jb.LinearSystem([[0.5]], None, [[1]], dt=60, noise=0.1)
MINUTES = np.r_[0:40, 43:80].astype(float)  # rows that a gap follows
START = datetime.datetime(2026, 3, 2, 0, 0)
SINCE_1970 = START.replace(tzinfo=datetime.UTC).timestamp()


def from_file(name, cells, folder):
    (folder / "run.csv").write_text(f"{name},y1\n" + "".join(f"{cell},0\n" for cell in cells))
    return jb.read(folder / "run.csv", MODEL)


def from_table(name, cells, folder):
    return Recording.of(MODEL, pd.DataFrame({name: np.array(cells, float), "y1": 0.0}))


def from_index(name, cells, folder):
    index = pd.Index(np.array(cells, float), name=name)
    return Recording.of(MODEL, pd.DataFrame({"y1": np.zeros(len(cells))}, index=index))


def from_parquet(name, cells, folder):
    pq.write_table(
        pa.table({name: np.array(cells, float), "y1": np.zeros(len(cells))}), folder / "run.parquet"
    )
    return jb.read(folder / "run.parquet", MODEL)


def from_pipe(name, cells, folder):
    pipe = PipeText(MODEL, lambda kind, sentence: None)
    lines = [f"{name},y1\n", *(f"{cell},0\n" for cell in cells)]
    pieces = [pipe.take(line.encode()) for line in lines[:7]]  # the first rows one by one
    memory = pipe.memory()
    pipe = PipeText(MODEL, lambda kind, sentence: None, memory)
    pieces += [pipe.take("".join(lines[7:]).encode())]
    whole, starts = None, []
    for piece in pieces:
        if piece is not None:
            starts.append(piece.starts + (0 if whole is None else whole.samples))
            whole = piece if whole is None else whole.followed(piece)
    return replace(whole, starts=np.concatenate(starts))


DOORS = [from_file, from_table, from_index, from_parquet, from_pipe]
UNITS = {
    "Time [h]": 60,
    "time_min": 1,
    "t (ms)": 1 / 60_000,
    "Zeit in Minuten": 1,
    "time/s": 1 / 60,
    "Time_us": 1 / 60_000_000,
    "t_ns": 1 / 60e9,
    "timestamp_days": 1440,
    "Time since start - hours": 60,
    "time": 1 / 60,
}
DAYS = {
    "days of Excel, all digits": ("time", 25569.0, 10),
    "days of Excel, as it shows them": ("Zeit", 25569.0, 5),
    "days of MATLAB": ("t", 719529.0, 8),
    "days of MATLAB, in short": ("t", 719529.0, 4),
    "Julian days": ("timestamp", 2440587.5, 8),
    "days by name": ("Time [d]", 25569.0, 8),
    "dates": ("Date", 25569.0, 8),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", UNITS)
def test_a_unit_in_the_name_is_that_of_the_time(tmp_path, door, name):
    for first in (0.0, 7.0):
        r = door(name, [repr(float(x)) for x in (first + MINUTES) / UNITS[name]], tmp_path)
        np.testing.assert_allclose(np.asarray(r.time) - r.time[0], 60 * MINUTES, atol=1e-6)
        assert r.starts.tolist() == [40] and r.stamps is None


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("case", DAYS)
def test_days_of_a_calendar_are_dates(tmp_path, door, case):
    name, zero, decimals = DAYS[case]
    cells = [f"{zero + (SINCE_1970 + 60 * k) / 86400:.{decimals}f}" for k in MINUTES]
    r = door(name, cells, tmp_path)
    off = 0.6 * 86400 / 10**decimals + 1e-4
    shown = slice(1, None) if door is from_pipe else slice(None)  # one number alone may be in seconds
    np.testing.assert_allclose(np.asarray(r.time)[shown], 60 * MINUTES[shown], atol=2 * off)
    if door is not from_pipe:
        np.testing.assert_allclose(r.instants, SINCE_1970 + 60 * MINUTES, atol=off)
    assert r.starts.tolist() == [40]


SHOWN = [
    (case, period) for case in DAYS for period in (5, 10, 60, 300, 900) if DAYS[case][2] > 4 or period > 10
]


@pytest.mark.parametrize("case, period", SHOWN)
def test_days_show_their_sampling_period(tmp_path, case, period):
    name, zero, decimals = DAYS[case]
    stamps = [f"{zero + (SINCE_1970 + period * k) / 86400:.{decimals}f}" for k in range(200)]
    (tmp_path / "run.csv").write_text(f"{name},y1\n" + "".join(f"{stamp},0\n" for stamp in stamps))
    (r,) = read_signals(tmp_path / "run.csv", [], ["y1"])
    assert r.dt == period and len(r.starts) == 0
    assert any("the time column is read in d" in hint for hint in r.hints)


@pytest.mark.parametrize(
    "first, step, name, dt",
    [
        (46083.0, 1.0, "time", None),
        (46083.5, 60.0, "time", None),
        (46083.0, 0.25, "t", None),
        (46083.0, 0.001, "time [s]", None),
        (46083.0, 0.001, "t", 0.001),
        (46083.25, 60.0, "t", 60.0),
        (0.0, 60.0, "Time (UTC)", None),
        (36000.0, 60.0, "time of day", None),
        (1.7e9, 60.0, "Time [min]", None),  # an epoch, whatever the name
        (1.7e12, 60_000.0, "t_s", None),
    ],
)
def test_seconds_and_epochs_stay_what_they_are(first, step, name, dt):
    assert not counting_of(first + step * np.arange(200), dt, name).unit


def test_what_may_be_days_or_seconds_is_asked():
    with pytest.raises(ValueError, match="46083 and so on, may be days or seconds: say which .*'time .d.'"):
        read_numbers(46083 + 0.00137 * np.arange(200), None, "time")


@pytest.mark.parametrize(
    "form, period, name",
    [
        ("%H%M%S", 1, "time"),
        ("%H%M%S", 60, "time"),
        ("%H%M%S", 20, "time"),
        ("%H%M", 60, "time"),
        ("%H%M", 300, "Time (HHMM)"),
        ("%H%M%S", 600, "hhmmss"),
    ],
)
@pytest.mark.parametrize("begin", ["01:00", "08:15", "23:10"])
def test_digits_of_a_clock_are_no_seconds(form, period, name, begin):
    first = datetime.datetime.fromisoformat(f"2026-03-02 {begin}")
    moments = [first + datetime.timedelta(seconds=period * k) for k in range(300)]
    del moments[150:160]
    digits = np.array([float(m.strftime(form)) for m in moments])
    time, stamps, hint = read_numbers(digits, None, name)
    expected = [(m - first).total_seconds() for m in moments]
    np.testing.assert_array_equal(time - time[0], expected)
    assert usual_period(time) == period and stamps is None and "the digits of a clock" in hint


@pytest.mark.parametrize(
    "values",
    [
        np.arange(400.0),
        np.arange(0, 6000, 100.0),
        np.arange(0, 60.0),
        np.r_[0:30, 100:130].astype(float),
        np.r_[0:50, 200:240, 1000:1050].astype(float),
        np.arange(100) / 2,
    ],
)
def test_seconds_are_no_digits_of_a_clock(values):
    for dt in (None, 1.0, 60.0):
        time, _, hint = read_numbers(values, dt, "time")
        np.testing.assert_array_equal(time, values)
        assert not hint


def test_one_jump_from_59_to_100_is_asked_unless_the_name_says_it():
    values = np.r_[30:60, 100:130].astype(float)
    with pytest.raises(ValueError, match="30 and so on, may be seconds or digits of a clock: write 8:01:30"):
        read_numbers(values, None, "time")
    np.testing.assert_array_equal(read_numbers(values, None, "time [s]")[0], values)
    np.testing.assert_array_equal(np.diff(read_numbers(values, None, "time hhmm")[0]), 60.0)


@pytest.mark.parametrize("form, period", [("%M:%S.%f", 0.5), ("%M:%S.%f", 1), ("%M:%S", 10)])
def test_minutes_and_seconds_are_no_hours(tmp_path, form, period):
    moments = [START + datetime.timedelta(seconds=period * k) for k in range(400)]
    cells = [m.strftime(form)[:7] for m in moments]
    (tmp_path / "run.csv").write_text("time,y1\n" + "".join(f"{cell},0\n" for cell in cells))
    (r,) = read_signals(tmp_path / "run.csv", [], ["y1"])
    assert r.dt == period and len(r.starts) == 0
    assert any("are read as minutes and seconds: a gap of whole hours cannot be seen" in h for h in r.hints)


def test_two_numbers_with_a_colon_are_hours_or_seconds_as_somebody_says(tmp_path):
    (tmp_path / "run.csv").write_text("time,y1\n" + "".join(f"00:{k:02d},0\n" for k in range(60)))
    hour = jb.read(tmp_path / "run.csv", MODEL)
    second = jb.read(tmp_path / "run.csv", MODEL.replace(dt=1))
    assert hour.time[-1] == 59 * 60 and second.time[-1] == 59
    with pytest.raises(ValueError, match="may be hours and minutes, or minutes and seconds: say which, by"):
        read_signals(tmp_path / "run.csv", [], ["y1"])
    for form, dt in (("%H:%M", 60), ("%M:%S", 1)):
        columns = with_format({}, {"time_format": form})
        assert read_signals(tmp_path / "run.csv", [], ["y1"], columns)[0].dt == dt


def test_recordings_of_which_one_counts_hours_are_told_so(tmp_path):
    for name, scale in (("a.csv", 1), ("b.csv", 3600)):
        cells = [f"{60 * k / scale!r},{k % 3}\n" for k in range(50)]
        (tmp_path / name).write_text("time,y1\n" + "".join(cells))
    with pytest.raises(
        ValueError, match="if the time of .*b.csv is in h, call its column so, like 'time .h.'"
    ) as e:
        read_signals([tmp_path / "a.csv", tmp_path / "b.csv"], [], ["y1"])
    assert "keep one of" not in str(e.value)


def test_temperatures_are_no_times(tmp_path):
    names = ("T_s", "T_min", "T_h", "t_d", "Time_constant")
    (tmp_path / "run.csv").write_text(",".join((*names, "y1")) + "\n" + "20.5,20,21,5,3,0\n" * 9)
    assert jb.read(tmp_path / "run.csv", MODEL).hints[0].startswith("the file has no time column")
