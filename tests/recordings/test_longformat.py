"""A row a tag: as one with a column a tag; tags with times of their own are held, or refused."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.recordingformat import RecordingFormat, with_format
from jaxbound.recordings.signals import Signals

T = 40


def model(dt=2.0, **stated):
    return Signals(("u",), ("y",), with_format({}, {"long": "tag,value"} | stated), dt)


def lines(rng, shuffled=False, delimiter=","):
    """Return (lines of a wide file, those of a long one with a third tag)."""
    u, y = rng.integers(0, 5, T), np.round(rng.normal(size=T), 2)
    sign = {",": ".", ";": ","}[delimiter]
    text = [str(v).replace(".", sign) for v in y]
    stamps = [f"2026-03-01 08:{2 * k // 60:02d}:{2 * k % 60:02d}" for k in range(T)]
    wide = [
        delimiter.join(["time", "u", "y"]),
        *(delimiter.join([*row]) for row in zip(stamps, map(str, u), text, strict=True)),
    ]
    rows = []
    for k in range(T):
        rows += [(stamps[k], "u", str(u[k])), (stamps[k], "y", text[k]), (stamps[k], "other", "x")]
    if shuffled:  # a tag after the other
        rows.sort(key=lambda row: row[1])
    return wide, [delimiter.join(["time", "tag", "value"]), *map(delimiter.join, rows)]


def put(path, rows):
    path.write_text("\n".join([*rows, ""]))
    return path


@pytest.mark.parametrize("delimiter", [",", ";"])
@pytest.mark.parametrize("shuffled", [False, True])
def test_a_row_a_tag_is_the_recording_with_a_column_a_tag(tmp_path, rng, shuffled, delimiter):
    wide, rows = lines(rng, shuffled, delimiter)
    one = jb.read(put(tmp_path / "wide.csv", wide), Signals(("u",), ("y",), {}, 2.0))
    other = jb.read(put(tmp_path / "long.csv", rows), model())
    np.testing.assert_array_equal(other.u, one.u)
    np.testing.assert_array_equal(other.y, one.y)
    np.testing.assert_array_equal(other.stamps, one.stamps)
    assert not len(other.starts)


def on_change(tmp_path):
    """Return a file in which u and y are written when they change, at times of their own."""
    rows = ["time,tag,value", "0,u,1", "0,y,10", "3,y,11", "7,u,2", "8,y,12", "30,y,13", "31,u,3"]
    return put(tmp_path / "run.csv", rows)


def test_tags_with_times_of_their_own_are_held_for_as_long_as_is_stated(tmp_path):
    path = on_change(tmp_path)
    with pytest.raises(ValueError, match="'u' at 50% of them: say how long"):
        jb.read(path, model())
    run = jb.read(path, model(hold="10s"))
    assert run.time.tolist() == list(range(0, 32, 2))
    nan = np.nan
    expected_u = [1, 1, 1, 1, 2, 2, 2, 2, 2, nan, nan, nan, nan, nan, nan, nan]
    expected_y = [10, 10, 11, 11, 12, 12, 12, 12, 12, 12, nan, nan, nan, nan, nan, 13]
    np.testing.assert_array_equal(run.u[:, 0], expected_u)
    np.testing.assert_array_equal(run.y[:, 0], expected_y)
    assert any("state its `deadband` beside hold" in hint for hint in run.hints)


def test_two_values_of_one_time_need_a_word(tmp_path, rng):
    _, rows = lines(rng)
    rows.insert(3, rows[2].rpartition(",")[0] + ",99")
    path = put(tmp_path / "run.csv", rows)
    with pytest.raises(ValueError, match="two values of one time"):
        jb.read(path, model())
    last, first = jb.read(path, model(equal="last")), jb.read(path, model(equal="first"))
    assert last.y[0, 0] == 99 and first.y[0, 0] != 99


def test_where_it_cannot_be_read_so_a_sentence_says_it(tmp_path, rng):
    with pytest.raises(ValueError, match="is for CSV files, not for a pipe"):
        PipeText(model(), lambda kind, sentence: None)
    wide, _ = lines(rng)
    import pandas as pd

    pd.read_csv(put(tmp_path / "wide.csv", wide)).to_parquet(tmp_path / "wide.parquet")
    with pytest.raises(ValueError, match="is for CSV files, not for Parquet"):
        jb.read(tmp_path / "wide.parquet", model())
    with pytest.raises(ValueError, match="two columns, of the tags and of the values"):
        RecordingFormat.of({"long": "tag"})


def test_look_and_fit_take_it_on_the_command_line(tmp_path, rng, capsys):
    _, rows = lines(rng)
    path = put(tmp_path / "run.csv", rows)
    found = jb.look(path, recording={"long": "tag,value"})
    assert [column.name for column in found.columns] == [
        "u",
        "y",
        "other",
    ] and "long=tag,value" in found.command
    assert 'long = ["tag", "value"]' in found.table
    assert main.main(["look", str(path), "--long", "tag,value"]) == 0
    assert "2 columns of numbers" in capsys.readouterr().out


@pytest.mark.parametrize("tag", ["a,b", "a;b"])
def test_a_name_of_a_tag_may_hold_a_comma_or_the_delimiter(tmp_path, tag):
    rows = [f'{2 * k};"{name}";{k + i}' for k in range(T) for i, name in enumerate((tag, "y"))]
    signals = Signals((tag,), ("y",), with_format({}, {"long": "tag,value"}), 2.0)
    run = jb.read(put(tmp_path / "run.csv", ["time;tag;value", *rows]), signals)
    assert run.u[:, 0].tolist() == list(range(T)) and run.y[:, 0].tolist() == list(range(1, T + 1))


@pytest.mark.parametrize(
    ("before", "more", "behind", "sentence"),
    [
        ([], ["2026-03-01 08:00:02,y,{y}"], [], "row 8 has the tag and the time of another row: left out"),
        ([], [",y,7.5"], [], "row 8 holds no time: left out"),
        ([], ["2026-03-01 08:00:02,,7.5"], [], "row 8 holds no tag: left out"),
        (
            ["# Logger 7", "Serial,12"],
            [],
            [],
            "row 3 holds the names of the columns: 2 rows above it left out",
        ),
        ([], [], ["Total rows: 120"], "row 122 holds no sample, behind the last: left out"),
        ([], [], [",y,7.5"], "row 122 holds no time: left out"),
    ],
)
def test_rows_that_are_no_samples_are_left_out_and_counted(tmp_path, rng, before, more, behind, sentence):
    wide, rows = lines(rng)
    one = jb.read(put(tmp_path / "wide.csv", wide), Signals(("u",), ("y",), {}, 2.0))
    more = [line.format(y=rows[5].split(",")[2]) for line in more]
    run = jb.read(put(tmp_path / "long.csv", [*before, *rows[:7], *more, *rows[7:], *behind]), model())
    np.testing.assert_array_equal(run.u, one.u)
    np.testing.assert_array_equal(run.y, one.y)
    np.testing.assert_array_equal(run.stamps, one.stamps)
    assert sentence in run.hints


@pytest.mark.parametrize(("equal", "value"), [("first", 1.0), ("last", 9.0)])
def test_the_value_that_does_not_count_is_said(tmp_path, equal, value):
    rows = ["time,tag,value", "0,u,1", "0,y,1", "0,y,9", "2,u,1", "2,y,2"]
    run = jb.read(put(tmp_path / "run.csv", rows), model(equal=equal))
    assert run.y[:, 0].tolist() == [value, 2]
    left = {"first": 4, "last": 3}[equal]
    assert f"row {left} has the tag and the time of another row: left out" in run.hints


def test_clocks_without_a_day_are_read_by_dt(tmp_path):
    rows = ["time,tag,value", "23:45,u,1", "23:45,y,1", "00:00,u,1", "00:00,y,2", "00:15,u,1", "00:15,y,3"]
    run = jb.read(put(tmp_path / "run.csv", rows), model(dt=900.0))
    assert run.y[:, 0].tolist() == [1, 2, 3] and run.time.tolist() == [0, 900, 1800]
