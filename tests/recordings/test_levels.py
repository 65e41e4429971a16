"""Columns that are no levels: angles and counters, the same by every door and in pieces; who is suspected."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.expressions import expression, with_angles
from jaxbound.recordings.means import recorded_model
from jaxbound.recordings.meanstream import MeansStream
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import open_source
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.stream import Taken

T = 60
MODEL = Signals(
    ("flow",),
    ("north", "energy", "turn"),
    {
        "flow": "= rate(count, 65536)",
        "energy": "= rate(total)",
        "north": "= cos(angle(wind))",
        "turn": "= rate(angle(wind))",
    },
    2.0,
)


def frame(rng):
    """Return counters of which one runs over and one begins anew, a gap, a missing count, and a wind that
    turns, once so far that nobody knows which way.
    """
    table = pd.DataFrame({"time": np.arange(T) * 2.0, "wind": (340.0 + np.arange(T)) % 360})
    table.loc[50:, "wind"] = (table["wind"][50:] + 120) % 360
    table["count"] = ((65_400 + np.cumsum(rng.integers(1, 9, T))) % 65_536).astype(float)
    table["total"] = np.cumsum(rng.random(T))
    table.loc[30:, "total"] -= table["total"][30]
    table.loc[40:, "time"] += 100
    table.loc[20, "count"] = np.nan
    return table


def expected(table):
    """Return (u, y) by hand."""
    flow, energy, turn = np.full((3, len(table)), np.nan)
    for k in range(1, len(table)):
        step = table["time"][k] - table["time"][k - 1]
        if step != 2:
            continue
        flow[k] = (table["count"][k] - table["count"][k - 1]) % 65_536 / step
        if table["total"][k] >= table["total"][k - 1]:
            energy[k] = (table["total"][k] - table["total"][k - 1]) / step
        turned = (table["wind"][k] - table["wind"][k - 1] + 180) % 360 - 180
        if abs(turned) <= 90:
            turn[k] = np.radians(turned) / step
    return flow[:, None], np.stack([np.cos(np.radians(table["wind"])), energy, turn], 1)


def through_pipe(path, size, kill=False, model=MODEL):
    """Return the pieces of a pipe; kill: by a process each."""
    pipe, data, pieces = PipeText(model, lambda kind, sentence: None), path.read_bytes(), []
    for k in range(0, len(data), size):
        pieces.append(pipe.take(data[k : k + size]))
        memory = pipe.memory()
        if kill and memory is not None:
            pipe = PipeText(model, lambda kind, sentence: None, json.loads(json.dumps(memory)))
    return [piece for piece in pieces if piece is not None]


@pytest.mark.parametrize("size", [1, 97, 10_000])
def test_rates_and_angles_are_the_same_by_file_parquet_table_and_pipe(tmp_path, rng, size):
    table = frame(rng)
    u, y = expected(table)
    table.to_csv(tmp_path / "run.csv", index=False)
    table.to_parquet(tmp_path / "run.parquet", row_group_size=7)
    whole = jb.read(tmp_path / "run.csv", MODEL)
    np.testing.assert_allclose(whole.u, u, rtol=1e-12)
    np.testing.assert_allclose(whole.y, y, rtol=1e-12)
    parts = [piece for _, piece in open_source(tmp_path / "run.parquet", MODEL).pieces(min(size, T))]
    for pieces in ([jb.Recording.of(MODEL, table)], parts, through_pipe(tmp_path / "run.csv", size)):
        np.testing.assert_array_equal(np.concatenate([piece.u for piece in pieces]), whole.u)
        np.testing.assert_array_equal(np.concatenate([piece.y for piece in pieces]), whole.y)


def test_another_process_knows_the_last_row_where_a_rate_needs_it(tmp_path, rng):
    frame(rng).assign(state="on").to_csv(tmp_path / "run.csv", index=False)
    model = Signals(MODEL.inputs, MODEL.outputs, MODEL.columns | {"where": "state == 'on'"}, 2.0)
    once, killed = (through_pipe(tmp_path / "run.csv", 97, kill, model) for kill in (False, True))
    assert len(killed) > 10
    for name in ("u", "y"):
        whole, parts = (np.concatenate([getattr(piece, name) for piece in run]) for run in (once, killed))
        np.testing.assert_array_equal(parts, whole)


def test_a_sender_that_begins_again_and_stops_has_not_said_the_last_row(tmp_path, rng):
    frame(rng).to_csv(tmp_path / "run.csv", index=False)
    lines = (tmp_path / "run.csv").read_bytes().splitlines(keepends=True)
    pipe = PipeText(MODEL, lambda kind, sentence: None)
    whole = pipe.take(b"".join(lines))
    memory, pieces, known = None, [], bytearray()
    for first, stop in ((0, 16), (0, 8), (16, 40), (0, 61)):
        taken = Taken(partial(bytes, known))
        pipe = PipeText(MODEL, lambda kind, sentence: None, memory, taken)
        pieces.append(pipe.take(b"".join(lines[first:stop])))
        memory = pipe.memory()
        known += taken.fresh
    y = np.concatenate([piece.y for piece in pieces if piece is not None])
    np.testing.assert_array_equal(y, whole.y)


def test_a_rate_does_not_look_at_a_sample_that_is_left_out(tmp_path, rng):
    table = frame(rng)
    table.to_csv(tmp_path / "run.csv", index=False)
    model = Signals(MODEL.inputs, MODEL.outputs, MODEL.columns | {"where": "wind != 350"}, 2.0)
    whole, of_table = jb.read(tmp_path / "run.csv", model), jb.Recording.of(model, table)
    assert np.isnan(whole.u[[10, 11], 0]).all() and np.isnan(whole.y[10:12, 1:]).all()
    assert whole.y[11, 0] == 1.0 * np.cos(351 * (2 * np.pi / 360))
    np.testing.assert_array_equal(whole.u, of_table.u)
    np.testing.assert_array_equal(whole.y, of_table.y)


def test_a_counter_that_begins_anew_has_not_run_over():
    """From 40 000 to 0 it would have grown by 25 536 of 65 536: nobody knows."""
    step, x = np.ones(3), np.array([39_990.0, 40_000.0, 0.0])
    values = expression("rate(n, 65536)").values({"n": x, "= seconds since the sample before": step})
    np.testing.assert_array_equal(values, [np.nan, 10.0, np.nan])


MEANS = Signals(MODEL.inputs, MODEL.outputs, MODEL.columns | {"every": "30s"}, 30.0)


def means_of_all(table, behind_hole):
    """Return means over 15 samples by hand, missing where a sample is, and of the interval behind a hole."""
    u, y = expected(table)
    groups = pd.DataFrame(np.concatenate([u, y], 1)).groupby(table["time"] // 30)
    means = groups.mean().where(groups.count() == 15)
    means.loc[behind_hole] = np.nan
    return means.to_numpy()


@pytest.mark.parametrize("size", [1, 997, 100_000])
def test_means_of_rates_and_angles_are_the_same_by_file_parquet_table_and_pipe(tmp_path, rng, size):
    """Two counters run over within intervals, one begins anew; behind a hole at the end of an interval the
    first rate is of the hole, too.
    """
    count = 300
    table = pd.DataFrame({"time": np.arange(count) * 2.0, "wind": (340.0 + 7 * np.arange(count)) % 360})
    table["count"] = ((64_000 + np.cumsum(rng.integers(1, 99, count))) % 65_536).astype(float)
    table["total"] = np.cumsum(rng.random(count))
    table.loc[200:, "total"] -= table["total"][200]
    table.loc[100, "count"] = np.nan
    table = table.drop(index=range(140, 150)).reset_index(drop=True)
    means = means_of_all(table, behind_hole=10)
    table.to_csv(tmp_path / "run.csv", index=False)
    table.to_parquet(tmp_path / "run.parquet", row_group_size=7)
    whole = jb.read(tmp_path / "run.csv", MEANS)
    got = np.concatenate([whole.u, whole.y], 1)
    np.testing.assert_allclose(got, means, rtol=1e-12)
    assert np.isnan(got).sum(0).tolist() == [4, 2, 4, 3] and len(got) == 20
    parts = [piece for _, piece in open_source(tmp_path / "run.parquet", MEANS).pieces(min(size, count))]
    pipe = MeansStream(PipeText(recorded_model(MEANS), lambda kind, sentence: None), MEANS)
    data = (tmp_path / "run.csv").read_bytes()
    live = [piece for _, piece in pipe.pieces(data[k : k + size] for k in range(0, len(data), size))]
    for pieces in ([jb.Recording.of(MEANS, table)], parts, live):
        u, y = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in "uy")
        assert len(u) in (len(whole.u), len(whole.u) - 1)  # a stream does not know that the last is over
        np.testing.assert_array_equal(u, whole.u[: len(u)])
        np.testing.assert_array_equal(y, whole.y[: len(u)])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("angle(wind)", "jumps where it is once around"),
        ("abs(angle(wind))", "jumps where it is once around"),
        ("rate(3)", "gives rate no column"),
        ("sin(angle())", "gives angle no column"),
        ("rate(n, n)", "one number above 0"),
        ("rate(n, 8, 8)", "one number above 0"),
        ("sin(angle(wind, -1))", "one number above 0"),
        ("sin(angle(wind, 3*pi))", "like 400 of gon or 2.pi"),
        ("rate(angle(wind), 8)", "the angle says what is once around"),
        ("rate(1 - angle(wind))", "jumps where it is once around"),
    ],
)
def test_what_an_angle_and_a_rate_take(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        expression(text)


@pytest.mark.parametrize(("text", "turn"), [("", 360), (", 400", 400), (", 2*pi", 2 * np.pi)])
def test_an_angle_turns_the_shorter_way_around_and_nobody_knows_beyond_a_quarter(text, turn):
    x = np.array([359, 1, 350, 85, 176, 265, np.nan, 300, 320]) * (turn / 360)
    columns = {"W": x, "pi": np.zeros(9), "= seconds since the sample before": np.full(9, 0.5)}
    columns["= seconds since the sample before"][-1] = np.nan  # behind a gap
    turns = np.degrees(expression(f"rate(angle(W{text}))").values(columns)) * 0.5
    nan = np.nan
    np.testing.assert_allclose(turns, [nan, 2, -11, nan, nan, 89, nan, nan, nan], rtol=1e-9)
    both = expression(f"sin(angle(W{text}))**2 + cos(angle(W{text}))**2").values(columns)
    np.testing.assert_allclose(both[~np.isnan(x)], 1.0, rtol=1e-9)


def test_an_angle_stands_for_two_signals():
    names, columns = with_angles(
        ["d", "T", "s"], {"d": "=angle(`wind dir`, 400)", "s": "= angle(a) < angle(b)"}
    )
    assert names == ("d sin", "d cos", "T", "s")
    assert columns["d cos"] == "= cos(angle(`wind dir`, 400))"
    assert expression(columns["d sin"]).values({"wind dir": np.array([100.0])}) == pytest.approx([1.0])
