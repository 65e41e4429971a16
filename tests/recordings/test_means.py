"""Means over intervals of the clock: pandas says which, every door gives the same, pieces are the whole."""

import functools
import itertools
import json
from fractions import Fraction

import hypothesis
import numpy as np
import pandas as pd
import pytest
from hypothesis import strategies as st

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.models.watched import NO, UNKNOWN, YES
from jaxbound.recordings import meansource
from jaxbound.recordings.clockintervals import every_text, seconds_of
from jaxbound.recordings.means import recorded_model
from jaxbound.recordings.meanstream import MeansStream
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import open_source

MODEL = jb.LinearSystem(
    [[0.5]], [[1]], [[1]], dt=900, noise=0.1, columns={"every": "15min", "where": "fan > 0"}
)
PLAIN = MODEL.replace(columns={"every": "15min"})


def minutes(count=4000, begin="2024-03-01 07:53", seed=0):
    """Return a recording of one sample a minute, with samples and rows missing and a fan that stands."""
    rng = np.random.default_rng(seed)
    frame = pd.DataFrame({"time": pd.date_range(begin, periods=count, freq="min")})
    frame["u1"], frame["y1"], frame["fan"] = rng.normal(size=count), rng.normal(size=count), 1.0
    frame.loc[300:340, "fan"] = 0
    frame.loc[700, "y1"] = np.nan
    return frame.drop(index=[1000, 1001, 1500, *range(2000, 2100)], errors="ignore")


def expected(frame, column):
    """Return the means by pandas: of intervals in which all 15 samples are there, and the fan runs in all."""
    groups = frame.set_index("time").resample("15min")
    counts = (groups["u1"].count() == 15) & (groups["fan"].min() > 0)
    return groups[column].apply(lambda x: x.mean(skipna=False)).where(counts)


def written(frame, path, kind):
    """Return the path of a frame in a file, or in a folder of files, of this kind."""
    if kind == "csv":
        frame.to_csv(path / "run.csv", index=False)
        return path / "run.csv"
    if kind == "parquet":
        frame.to_parquet(path / "run.parquet", row_group_size=100)
        return path / "run.parquet"
    (path / "run").mkdir()
    for i, first in enumerate(range(0, len(frame), 777)):
        frame[first : first + 777].to_parquet(path / "run" / f"part-{i}.parquet")
    return path / "run"


@pytest.mark.parametrize("kind", ["csv", "parquet", "folder", "table", "two tables"])
def test_every_door_gives_the_means_of_pandas(tmp_path, kind):
    frame = minutes()
    if kind == "table":
        r = jb.Recording.of(MODEL, frame)
    elif kind == "two tables":
        indexed = frame.set_index("time")
        r = jb.Recording.of(MODEL, indexed[["u1", "fan"]], indexed[["y1", "fan"]])
    else:
        r = jb.read(written(frame, tmp_path, kind), MODEL)
    times = pd.DatetimeIndex(r.stamps)
    # the first interval, from 07:45 on, and the last are not whole
    assert times[0] == pd.Timestamp("2024-03-01 08:00") and times[-1] == pd.Timestamp("2024-03-04 02:15")
    assert (np.diff(times) == pd.Timedelta("15min")).all()
    for signal, column in ((r.u, "u1"), (r.y, "y1")):
        means = expected(frame, column).reindex(times).to_numpy()
        np.testing.assert_array_equal(np.isnan(signal[:, 0]), np.isnan(means))
        np.testing.assert_allclose(signal[:, 0], means, rtol=1e-12, atol=1e-15)
    stands = frame.set_index("time")["fan"].resample("15min").min().reindex(times) == 0
    np.testing.assert_array_equal(r.excluded, stands)
    assert r.dt == 900 and r.label(1) == "2024-03-01 08:15:00"
    np.testing.assert_array_equal(r.time, 900.0 * np.arange(len(times)))


@pytest.mark.parametrize("kind", ["csv", "parquet", "folder"])
@pytest.mark.parametrize(
    ("size", "overlap", "first", "stop"),
    [(7, 2, 0, None), (1000, 3, 0, None), (1, 0, 20, 60), (64, 16, 5, 200)],
)
def test_pieces_are_the_whole(tmp_path, monkeypatch, kind, size, overlap, first, stop):
    monkeypatch.setattr(meansource, "ROWS", 100)
    path = written(minutes(), tmp_path, kind)
    source, whole = open_source(path, MODEL), jb.read(path, MODEL)
    end, at = stop or source.samples, first
    for begin, piece in source.pieces(size, overlap, first, stop):
        assert begin == max(at - overlap, first) and begin + piece.samples == min(at + size, end)
        cut = whole.cut(begin, begin + piece.samples)
        for name in ("u", "y", "time", "stamps", "excluded"):
            np.testing.assert_array_equal(getattr(piece, name), getattr(cut, name), err_msg=name)
        np.testing.assert_array_equal(piece.across(1)[1:], cut.across(1)[1:])
        at = begin + piece.samples
    assert at == end


@hypothesis.settings(max_examples=40)
@hypothesis.given(
    st.lists(st.integers(1, 40), min_size=30, max_size=120),
    st.integers(0, 86_399),
    st.sampled_from(["10s", "30s", "1min", "7min"]),
)
def test_no_mean_is_of_other_samples_than_those_of_its_interval(steps, begin, every):
    """Steps of any length: what is not missing is the mean of all that pandas has there."""
    time = pd.Timestamp("2024-03-01") + pd.to_timedelta(begin + np.cumsum(steps), "s")
    frame = pd.DataFrame({"time": time, "u1": np.sin(np.arange(len(time))), "y1": np.arange(len(time)) / 7})
    model = PLAIN.replace(dt=seconds_of(every), columns={"every": every})
    try:
        r = jb.Recording.of(model, frame)
    except ValueError as e:
        assert "is shorter than the steps" in str(e) or "it is too short" in str(e)
        return
    means = frame.set_index("time")["y1"].resample(every, origin="start_day").mean()
    means = means.reindex(pd.DatetimeIndex(r.stamps)).to_numpy()
    there = ~np.isnan(r.y[:, 0])
    np.testing.assert_allclose(r.y[there, 0], means[there], rtol=1e-12, atol=1e-15)
    assert set(pd.DatetimeIndex(r.stamps)[there]) <= set(pd.DatetimeIndex(r.stamps)[~np.isnan(means)])


def irregular(count=3000, seed=1):
    """Return a logger that writes each one to two seconds, in whole ones."""
    rng = np.random.default_rng(seed)
    time = pd.Timestamp("2024-03-01 23:59") + pd.to_timedelta(np.cumsum(rng.integers(1, 3, count)), "s")
    return pd.DataFrame({"time": time, "u1": rng.normal(size=count), "y1": rng.normal(size=count)})


def test_irregular_steps_come_to_a_grid():
    frame = irregular()
    r = jb.Recording.of(PLAIN.replace(dt=2, columns={"every": "2s"}), frame)
    means = frame.set_index("time")["y1"].resample("2s").mean().reindex(pd.DatetimeIndex(r.stamps))
    np.testing.assert_allclose(r.y[:, 0], means, rtol=1e-12, atol=1e-15)
    assert not len(r.starts) and len(r.y) > 2000


def test_an_interval_without_a_sample_is_missing_and_a_long_gap_is_one():
    frame = irregular().drop(index=range(1000, 1006)).drop(index=range(2000, 2400))
    r = jb.Recording.of(PLAIN.replace(dt=2, columns={"every": "2s"}), frame)
    empty = np.isnan(r.y[:, 0])
    assert 3 <= empty[:900].sum() <= 7  # six samples are not there
    (seam,) = r.starts
    assert r.time[seam] - r.time[seam - 1] > 400  # no row for each of the 200 intervals or more between


def test_a_clock_that_goes_back_parts_the_intervals():
    """An hour in autumn comes twice: no interval has samples of both."""
    frame = minutes(900, "2024-10-27 00:00").drop(columns="fan")
    back = frame.assign(time=frame["time"].where(frame.index < 180, frame["time"] - pd.Timedelta("1h")))
    r = jb.Recording.of(PLAIN, back)
    (seam,) = r.starts
    assert pd.Timestamp(r.stamps[seam]) == pd.Timestamp("2024-10-27 02:00")
    np.testing.assert_allclose(r.y[seam, 0], frame["y1"][180:195].mean())
    np.testing.assert_allclose(r.y[seam - 1, 0], frame["y1"][165:180].mean())


def test_times_in_seconds_count_from_zero(tmp_path):
    time = np.round(0.7 + 0.1 * np.arange(100), 1)
    frame = pd.DataFrame({"time": time, "u1": 0.0, "y1": np.arange(100.0)})
    model = PLAIN.replace(dt=0.3, columns={"every": "300ms"})
    for kind in ("csv", "parquet"):
        r = jb.read(written(frame, tmp_path, kind), model)
        np.testing.assert_allclose(r.time, 0.9 + 0.3 * np.arange(len(r.time)), rtol=1e-12)
        np.testing.assert_allclose(r.y[:, 0], 3 + 3.0 * np.arange(len(r.time)))  # of samples 2, 3, 4 first


def test_means_of_many_large_numbers_are_known_to_the_last_digit():
    """What rounding a sum of 86 400 samples loses would be more than the 4 u that verdicts allow for."""
    y = 1e9 + np.random.default_rng(3).uniform(0, 1, (86_400, 2))
    frame = pd.DataFrame({"time": pd.date_range("2024-03-01", periods=86_400, freq="s"), "u1": 0.0})
    frame["y1"], frame["y2"] = y.T
    columns = {"every": "d"}
    model = jb.LinearSystem([[0.5]], [[1]], [[1], [1]], dt=86_400, noise=0.1, columns=columns)
    r = jb.Recording.of(model, frame)
    for mean, x in zip(r.y[0].tolist(), y.T, strict=True):
        exact = sum(map(Fraction, x.tolist())) / len(x)
        assert abs(Fraction(mean) - exact) <= Fraction(float(np.spacing(mean)))


@hypothesis.given(st.floats(-1e12, 1e12, allow_subnormal=False), st.integers(2, 60))
def test_the_mean_of_a_sensor_that_stands_still_stands_still(value, count):
    """Else a stuck signal would seem to move by its rounding."""
    time = pd.date_range("2024-03-01", periods=4 * count, freq="s")
    frame = pd.DataFrame({"time": time, "u1": 0.0, "y1": value})
    r = jb.Recording.of(PLAIN.replace(dt=count, columns={"every": f"{count}s"}), frame)
    assert (r.y == value).all()


def test_a_clock_that_is_set_back_within_an_interval_is_a_seam():
    """By its label the next interval follows, but more time went by."""
    frame = minutes(900, "2024-03-01 00:00").drop(columns="fan")
    back = frame.assign(time=frame["time"].where(frame.index < 130, frame["time"] - pd.Timedelta("5min")))
    r = jb.Recording.of(PLAIN, back)
    (seam,) = r.starts
    assert np.isnan(r.y[seam - 1 : seam + 1, 0]).all() and r.stamps[seam] == r.stamps[seam - 1]


def test_what_has_no_times_is_taken_for_means_already():
    u, y = np.ones((5, 1)), np.arange(5.0)[:, None]
    np.testing.assert_array_equal(jb.Recording.of(PLAIN, u, y).y, y)
    means = jb.Recording.of(MODEL, minutes())
    again = jb.Recording.of(MODEL, means)
    np.testing.assert_array_equal(again.y, means.y)
    np.testing.assert_array_equal(again.starts, means.starts)


def test_fit_keeps_the_interval_and_detect_judges_by_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("a.csv", "b.csv", "c.csv")):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.integers(0, 2, 200), 40).astype(float)
        x = np.zeros(len(u))
        for k in range(1, len(u)):
            x[k] = 0.98 * x[k - 1] + 0.02 * u[k - 1]
        time = pd.date_range("2024-03-01", periods=len(u), freq="s")
        frame = pd.DataFrame({"time": time, "u": u, "y": x + rng.uniform(-0.01, 0.01, len(u))})
        frame["y"] += np.where((seed == 2) & (frame.index > 6000), 0.5, 0)
        frame.to_csv(name, index=False)
    options = ["--inputs", "u", "--outputs", "y", "--every", "20s", "--recipe", "horizon=8"]
    assert main.main(["fit", "a.csv", "b.csv", *options, "--out", "plant.toml", "-q"]) == 0
    model = jb.load_model("plant.toml")
    assert model.dt == 20 and model.columns["every"] == "20s"
    tables = [pd.read_csv(name, parse_dates=["time"]) for name in ("a.csv", "b.csv")]
    same = jb.fit(tables, inputs="u", outputs="y", recording={"every": "20s"}, horizon=8, name="plant")
    assert same.replace(provenance=None) == model.replace(provenance=None)
    capsys.readouterr()
    assert main.main(["detect", "plant.toml", "c.csv", "--out", "whole", "--json"]) == 1
    whole = json.loads(capsys.readouterr().out)
    pd.read_csv("c.csv", parse_dates=["time"]).to_parquet("c.parquet", row_group_size=500)
    assert main.main(["detect", "plant.toml", "c.parquet", "--out", "parts", "--json"]) == 1
    parts = json.loads(capsys.readouterr().out)
    assert whole["counts"] == parts["counts"] and whole["counts"]["FAULT"] > 0
    assert main.main(["explain", "parts", "--at", "2024-03-01 01:40:00"]) == 0
    assert "2024-03-01 01:40:00, sample 300" in capsys.readouterr().out
    proof = ["verify", "parts/certificate-300.json", "--model", "plant.toml", "--data", "c.csv"]
    assert main.main(proof) == 0
    # the same by an option, of a model that does not say so
    jb.save_model(model.replace(columns={}), "silent.toml")
    capsys.readouterr()
    assert main.main(["detect", "silent.toml", "c.csv", "--out", "x", "--every", "20s", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["counts"] == whole["counts"]


@pytest.mark.parametrize(
    ("every", "dt", "sentence"),
    [
        ("15", 900, "every needs a number and a unit, ms, s, min, h or d, like '15min' or '2s': not '15'"),
        ("0s", 1, "every needs a number and a unit"),
        ("15min", 60, "every = '15min' is 900 s and dt = 60 s"),
    ],
)
def test_a_model_refuses_an_interval_that_is_none(every, dt, sentence):
    with pytest.raises(ValueError, match=sentence):
        PLAIN.replace(dt=dt, columns={"every": every})


def test_a_monitor_takes_means_but_no_tables_that_it_would_have_to_average():
    """Intervals that two tables share would be lost, and those around taken to follow each other."""
    monitor = jb.Monitor(jb.parity_relations(PLAIN))
    with pytest.raises(ValueError, match="means over 15min, which tables that come one by one are not"):
        monitor.run(monitor.init(), minutes())
    means = jb.Recording.of(PLAIN, minutes().drop(columns="fan"))
    _, verdicts = monitor.run(monitor.init(), means)
    np.testing.assert_array_equal(verdicts.status, jb.detect(monitor.relations, means).status)


def test_factors_on_noise_are_of_samples_and_not_of_means():
    with pytest.raises(ValueError, match="every = '15min' and times do not go together"):
        PLAIN.replace(times={"y1": "1 + abs(u1)"})


@pytest.mark.parametrize(
    ("every", "rows", "sentence"),
    [
        ("20s", slice(None), "every = '20s' is shorter than the steps of the recording, up to 60 s"),
        ("1h", slice(0, 50), "no interval of 1h is in the recording as a whole: it is too short"),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_an_interval_that_does_not_fit_is_said(tmp_path, every, rows, sentence, kind):
    path = written(minutes(900)[rows], tmp_path, kind)
    with pytest.raises(ValueError, match=sentence):
        jb.read(path, PLAIN.replace(dt=seconds_of(every), columns={"every": every}))


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_without_times_there_are_no_means(tmp_path, kind):
    path = written(minutes().drop(columns="time"), tmp_path, kind)
    with pytest.raises(ValueError, match="column of times|time column"):
        jb.read(path, PLAIN)
    with pytest.raises(ValueError, match="every = '15min' needs the times of the samples"):
        jb.fit((np.ones((99, 1)), np.ones((99, 1))), recording={"every": "15min"})
    with pytest.raises(ValueError, match=r"every is how .* recording=\{'every': '15min'\}"):
        jb.fit((np.ones((99, 1)), np.ones((99, 1))), every="15min")


def streamed(text, cuts, kill=False, model=MODEL):
    """Return the means of CSV that comes in pieces, one Recording of all; kill: another process takes over
    behind each piece, from what JSON keeps.
    """
    complain = lambda kind, sentence: None
    raw = recorded_model(model)
    stream, pieces, firsts, starts = MeansStream(PipeText(raw, complain), model), [], [], []
    for begin, end in itertools.pairwise([0, *cuts, len(text)]):
        arrivals = [text[begin:end], None]  # a signal behind it
        for first, piece in stream.pieces(iter(arrivals)):
            if piece.samples:
                firsts.append(first)
                pieces.append(piece)
                starts += (piece.starts + first).tolist()
        memory = stream.memory()
        if kill and memory is not None:
            memory = json.loads(json.dumps(memory))
            reading = PipeText(raw, complain, memory["reading"])
            stream = MeansStream(reading, model, memory)
    assert firsts == [0, *np.cumsum([piece.samples for piece in pieces])[:-1]]
    return functools.reduce(lambda one, other: one.followed(other), pieces), starts


@pytest.mark.parametrize("kill", [False, True])
def test_a_pipe_gives_the_means_of_the_file_as_intervals_end(tmp_path, rng, kill):
    frame = minutes()
    whole = jb.read(written(frame, tmp_path, "csv"), MODEL)
    text = frame.to_csv(index=False).encode()
    cuts = np.sort(rng.choice(np.arange(1, len(text)), 40, replace=False)).tolist()
    means, starts = streamed(text, cuts, kill)
    assert means.samples == whole.samples  # the rows behind the last whole interval begin another one
    for name in ("u", "y", "excluded", "time", "stamps"):
        np.testing.assert_array_equal(getattr(means, name), getattr(whole, name))
    assert means.written.to_pylist() == whole.written.to_pylist()
    assert starts == whole.starts.tolist()


def test_an_interval_comes_when_the_next_one_begins():
    frame = minutes(200, "2024-03-01 08:00").drop(columns="fan").assign(fan=1.0)
    lines = frame.to_csv(index=False).encode().splitlines(keepends=True)
    stream = MeansStream(PipeText(recorded_model(MODEL), print), MODEL)
    came = [(n, p.samples) for n, (_, p) in enumerate(stream.pieces(iter(lines))) if p.samples]
    assert came[0] == (100, 6)  # a hundred rows: 90 minutes are over
    assert came[1:] == [(minute + 1, 1) for minute in range(105, 200, 15)]


def test_a_recorder_that_skips_a_sample_now_and_then_loses_no_interval():
    """Steps of 1 s, one in twenty-five of 2 s, as test benches write them; 5 s are a hole all the same."""
    steps = np.where(np.arange(2000) % 25 == 7, 2.0, 1.0)
    steps[1204] = 5.0
    t = np.cumsum(steps)
    table = pd.DataFrame({"u1": np.sin(t), "y1": np.cos(t)}, index=pd.to_timedelta(t, "s"))
    model = PLAIN.replace(columns={"every": "10s"}, dt=10)
    r = jb.Recording.of(model, table)
    assert np.isnan(r.y[:, 0]).sum() == 1
    assert len(r.starts) == 0 and r.samples >= 206


@hypothesis.given(st.integers(1, 10**6), st.sampled_from([0.001, 1, 60, 3600, 86400]))
def test_an_interval_reads_as_it_is_written(number, unit):
    assert seconds_of(every_text(number * unit)) == pytest.approx(number * unit, rel=1e-12)


MODES = PLAIN.replace(
    tests=[{"name": "on", "when": "mode > 0", "horizon": 1}, {"name": "off", "when": "otherwise"}]
)


@pytest.mark.parametrize("kind", ["csv", "folder", "table", "pipe"])
def test_a_mode_holds_in_an_interval_where_it_holds_at_each_of_its_samples(tmp_path, rng, kind):
    """Else no mode does, "otherwise" neither: none of their models made such a mean. Where nobody knows the
    mode all along, one of them may have.
    """
    frame = minutes(1500).assign(mode=0.0)
    frame.loc[200:420, "mode"], frame.loc[[430, 615], "mode"] = 2.0, np.nan
    frame.loc[450:500, "mode"] = np.nan
    monitor = jb.monitor(MODES)
    if kind == "table":
        r = jb.Recording.of(monitor.model, frame)
    elif kind == "pipe":
        cuts = sorted(rng.choice(np.arange(1, 9000), 20, replace=False).tolist())
        r, _ = streamed(frame.to_csv(index=False).encode(), cuts, True, monitor.model)
    else:
        r = jb.read(written(frame, tmp_path, kind), monitor.model)
    groups = frame.set_index("time")["mode"].resample("15min")
    truth = []
    for begin in r.stamps:
        rows = groups.get_group(begin).to_numpy()
        whole, gone = len(rows) == 15, np.isnan(rows)
        if whole and gone.all():
            truth.append(UNKNOWN)
        else:
            truth.append(YES if whole and (rows > 0).all() else NO)
    is_off = [len(x) == 15 and (x == 0).all() for x in (groups.get_group(t).to_numpy() for t in r.stamps)]
    modes = monitor.modes_of(r.u)
    np.testing.assert_array_equal(modes[:, 0], truth)
    np.testing.assert_array_equal(modes[:, 1] == YES, is_off)
    assert {*truth} == {YES, NO, UNKNOWN} and ((modes == NO).all(1)).sum() == 7
    res = jb.detect(monitor, r)
    assert (res.status[(modes == NO).all(1)] == jb.Status.MISSING).all()
    assert (res.tests["on"].status != jb.Status.MISSING).any()
