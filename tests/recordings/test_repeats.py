"""Rows that repeat the row before are one row, in a file and in a pipe; others of one time are not."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.signals import Signals

MODEL = Signals((), ("a", "b"), {}, 1.0)
ROWS = [f"2026-03-01 08:00:{k:02d},{k % 7}.5,{k % 3 if k % 5 else ''}" for k in range(40)]


def file(path, rows):
    path.write_text("\n".join(["time,a,b", *rows, ""]))
    return path


@pytest.mark.parametrize("size", [1, 37, 10_000])
def test_each_row_twice_is_one_row(tmp_path, size):
    once = jb.read(file(tmp_path / "once.csv", ROWS), MODEL)
    path = file(tmp_path / "twice.csv", [row for row in ROWS for _ in range(2)])
    twice = jb.read(path, MODEL)
    np.testing.assert_array_equal(twice.y, once.y)
    np.testing.assert_array_equal(twice.stamps, once.stamps)
    assert (
        not len(twice.starts) and "40 rows repeat the row before, the first is row 3: left out" in twice.hints
    )
    sentences = []
    pipe = PipeText(MODEL, lambda kind, sentence: sentences.append(sentence))
    data = path.read_bytes()
    pieces = [pipe.take(data[k : k + size]) for k in range(0, len(data), size)]
    np.testing.assert_array_equal(np.concatenate([p.y for p in pieces if p is not None]), once.y)
    assert sentences.count("line 3 repeats the line before: left out") == 1 and pipe.no_rows == 40


def test_rows_of_one_time_that_differ_stay_and_are_a_seam(tmp_path):
    rows = [*ROWS[:10], ROWS[9].replace("2.5", "3.5"), *ROWS[10:]]
    run = jb.read(file(tmp_path / "run.csv", rows), MODEL)
    assert run.samples == 41 and run.starts.tolist() == [10]


def test_a_word_is_not_lost_in_a_row_that_repeats(tmp_path):
    rows = [*ROWS[:11], ROWS[10] + "bad", *ROWS[11:]]
    with pytest.raises(ValueError, match="bad"):
        jb.read(file(tmp_path / "run.csv", rows), MODEL)


def test_rows_that_differ_in_a_column_that_nobody_reads_are_two(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{row},{unit}" for row in ROWS[:8] for unit in ("left", "left")]
    path.write_text("\n".join(["time,a,b,unit", *rows, ""]))
    assert jb.read(path, MODEL).samples == 8
    rows[9] = rows[9].replace("left", "right")
    path.write_text("\n".join(["time,a,b,unit", *rows, ""]))
    assert jb.read(path, MODEL).samples == 9
    pipe = PipeText(MODEL, lambda kind, sentence: None)
    assert pipe.take(path.read_bytes()).samples == 9


def test_a_row_that_repeats_an_error_of_a_spreadsheet_is_one_row(tmp_path):
    rows = [*ROWS[:9], "2026-03-01 08:00:09,#N/A,1", "2026-03-01 08:00:09,#N/A,1", *ROWS[10:]]
    run = jb.read(file(tmp_path / "run.csv", rows), MODEL)
    assert run.samples == 40 and not len(run.starts) and np.isnan(run.y[9, 0])
    assert "row 12 repeats the row before: left out" in run.hints
