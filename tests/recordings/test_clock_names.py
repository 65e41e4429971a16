"""Time of day and time since the start as signals and in conditions: the same by every door, in pieces."""

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.recordings.expressions import expression
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import open_source

T = 3000
COLUMNS = {
    "u1": "= sin(2*pi*time_of_day/86400)",
    "u2": "= level * time_since_start",
    "where": "time_since_start >= 600 and time_of_day < 86000",
}
MODEL = jb.LinearSystem([[0.5]], [[1, 1]], [[1]], dt=60, noise=0.1, columns=COLUMNS)


def frame(kind="text"):
    """Return two days with a gap; kind: how the time is written."""
    time = pd.date_range("2024-03-01 17:07:30", periods=T, freq="min")
    time += pd.to_timedelta(np.where(np.arange(T) < 1200, 0, 7200), "s")
    written = {"text": time, "epoch": (time - pd.Timestamp(0)) // pd.Timedelta("1ms")}
    written["american"] = time.strftime("%m/%d/%Y %I:%M:%S %p")
    return pd.DataFrame({"time": written[kind], "level": np.cos(np.arange(T)), "y1": np.arange(T) % 9}), time


def expected(time):
    """Return (u, excluded) by pandas."""
    since = np.asarray((time - time[0]).total_seconds())
    clock = np.asarray((time - time.normalize()).total_seconds())
    u = np.stack([np.sin(2 * np.pi * clock / 86400), np.cos(np.arange(T)) * since], 1)
    excluded = ~((since >= 600) & (clock < 86000))
    u[excluded] = np.nan
    return u, excluded


def written(table, path, kind):
    if kind == "csv":
        table.to_csv(path / "run.csv", index=False)
        return path / "run.csv"
    (path / "run").mkdir()
    for first in range(0, T, 800):
        table[first : first + 800].to_parquet(path / "run" / f"{first}.parquet", row_group_size=100)
    return path / "run"


@pytest.mark.parametrize(
    ("kind", "time"),
    [("csv", "text"), ("csv", "epoch"), ("csv", "american"), ("folder", "text"), ("folder", "epoch")],
)
def test_files_and_their_pieces(tmp_path, kind, time):
    table, times = frame(time)
    u, excluded = expected(times)
    source = open_source(written(table, tmp_path, kind), MODEL)
    whole = source.read()
    np.testing.assert_allclose(whole.u, u, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(whole.excluded, excluded)
    for begin, piece in source.pieces(333, 5, 100, 2500):
        cut = whole.cut(begin, begin + piece.samples)
        np.testing.assert_array_equal(piece.u, cut.u)
        np.testing.assert_array_equal(piece.excluded, cut.excluded)


@pytest.mark.parametrize(
    ("time", "size"),
    [
        ("text", 700),
        ("epoch", 700),
        ("text", 20_011),
        ("epoch", 20_011),
        ("american", 20_011),
        ("text", 10**6),
    ],
)
def test_a_pipe_that_another_process_goes_on_with(tmp_path, time, size):
    table, times = frame(time)
    data = table.to_csv(index=False).encode()
    memory, u, excluded = None, [], []
    for first in range(0, len(data), size):
        pipe = PipeText(MODEL, lambda kind, sentence: None, memory)
        piece = pipe.take(data[first : first + size])
        memory = pipe.memory() or memory
        assert memory is not None, "there is a row in the first bytes"
        if piece is not None:
            u.append(piece.u)
            excluded.append(piece.excluded)
    all_of_it, left_out = expected(times)
    np.testing.assert_allclose(np.concatenate(u), all_of_it, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(np.concatenate(excluded), left_out)


@pytest.mark.parametrize("indexed", [False, True])
def test_tables(indexed):
    table, times = frame()
    if indexed:
        table = table.set_index("time")
    r = jb.Recording.of(MODEL, table)
    u, excluded = expected(times)
    np.testing.assert_allclose(r.u, u, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(r.excluded, excluded)


@pytest.mark.parametrize("kind", ["csv", "folder", "table", "pipe"])
def test_seconds_begin_with_the_first_sample(tmp_path, kind):
    model = MODEL.replace(columns={"u1": "= level", "u2": "= time_since_start"})
    table = frame()[0].assign(time=500 + 60.0 * np.arange(T))
    if kind == "table":
        r = jb.Recording.of(model, table)
    elif kind == "pipe":
        pipe = PipeText(model, lambda kind, sentence: None)
        data = table.to_csv(index=False).encode()
        pieces = [pipe.take(data[:5000]), pipe.take(data[5000:])]
        np.testing.assert_allclose(np.concatenate([p.u[:, 1] for p in pieces]), 60.0 * np.arange(T))
        return
    else:
        source = open_source(written(table, tmp_path, kind), model)
        np.testing.assert_allclose(source.read(1000, 1010).u[:, 1], 60.0 * np.arange(1000, 1010))
        r = source.read()
    np.testing.assert_allclose(r.u[:, 1], 60.0 * np.arange(T))


@pytest.mark.parametrize("kind", ["csv", "folder", "table"])
def test_a_column_of_that_name_is_the_column(tmp_path, kind):
    model = MODEL.replace(columns={"u1": "= pi + 0", "u2": "= time_of_day * 1"})
    table = frame()[0].assign(pi=4.0, time_of_day=7.0)
    r = jb.Recording.of(model, table) if kind == "table" else jb.read(written(table, tmp_path, kind), model)
    np.testing.assert_array_equal(r.u, np.tile([4.0, 7.0], (T, 1)))


@pytest.mark.parametrize("kind", ["csv", "folder", "table"])
def test_a_time_of_day_needs_dates(tmp_path, kind):
    table = frame()[0].assign(time=60.0 * np.arange(T))
    with pytest.raises(ValueError, match="time_of_day needs dates: "):
        if kind == "table":
            jb.Recording.of(MODEL, table)
        else:
            jb.read(written(table, tmp_path, kind), MODEL)
    with pytest.raises(ValueError, match="needs the times of the samples|needs dates"):
        jb.Recording.of(MODEL, table.drop(columns="time"))


def test_a_reading_of_a_generator_does_not_know_the_start():
    with pytest.raises(ValueError, match="time_since_start is of a file or a pipe"):
        jb.read(iter([frame()[0]]), MODEL)
    aging = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=60, noise=0.1, times={"y1": "1 + time_since_start"})
    with pytest.raises(ValueError, match="time_since_start is of a file or a pipe"):
        jb.read(iter([frame()[0]]), aging)


def test_means_are_of_what_the_clock_said_at_each_sample(tmp_path):
    table, times = frame()
    model = MODEL.replace(dt=900, columns={**COLUMNS, "every": "15min"})
    u, _ = expected(times)
    means = pd.DataFrame(u, index=times).resample("15min")
    means = means.mean().where(means.count() == 15)
    for r in (jb.Recording.of(model, table), jb.read(written(table, tmp_path, "folder"), model)):
        there = means.reindex(pd.DatetimeIndex(r.stamps)).to_numpy()
        np.testing.assert_allclose(r.u, there, rtol=1e-9, atol=1e-9)


def test_the_shell_takes_the_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table, _ = frame()
    table.assign(y1=np.sin(np.arange(T) / 200) + np.random.default_rng(1).uniform(-1, 1, T)).to_csv(
        "run.csv", index=False
    )
    signals = ["--inputs", "sun=sin(2*pi*time_of_day/86400),time_since_start,level", "--outputs", "y1"]
    where = ["--where", "time_of_day > 3600"]
    assert (
        main.main(["fit", "run.csv", *signals, *where, "--recipe", "horizon=5", "--out", "m.toml", "-q"]) == 0
    )
    model = jb.load_model("m.toml")
    assert model.column("sun") == "= sin(2*pi*time_of_day/86400)"
    assert model.column("time_since_start") == "= time_since_start"
    assert main.main(["detect", "m.toml", "run.csv", "--out", "out", "-q"]) == 0


def test_clock_names_are_no_columns_that_are_read():
    e = expression("sin(2*pi*time_of_day) + `Heater 1`").among(["Heater 1", "time"])
    assert e.read == ("Heater 1",) and e.clock == {"pi", "time_of_day"}
