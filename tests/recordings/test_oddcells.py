"""Cells that hold no numbers: spreadsheets' errors are missing samples, rows that `where` leaves out may hold
anything, other words are refused where they stand.
"""

import re

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.recordings.oddcells import ERRORS
from jaxbound.recordings.pipetext import PipeText

HEAD = "time,u1,y1,fan\n"
MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, columns={"where": "fan > 0"})
EVERY_ROW = MODEL.replace(columns=None)


def table(changes=(), count=30, model=MODEL):
    """Return CSV text of a recording with some cells changed, {(row, column): text}; the header is row 1."""
    rows = [[str(k), str(k % 7), str(k / 8), "0" if 9 <= k < 15 else "1"] for k in range(count)]
    for (row, column), text in dict(changes).items():
        rows[row - 2][HEAD.strip().split(",").index(column)] = text
    return HEAD + "".join(",".join(row) + "\n" for row in rows)


def from_file(text, model, tmp_path):
    (tmp_path / "run.csv").write_text(text)
    return jb.read(tmp_path / "run.csv", model)


def from_table(text, model, tmp_path):
    (tmp_path / "run.csv").write_text(text)
    frame = pd.read_csv(tmp_path / "run.csv", keep_default_na=False, na_values=[""])
    return jb.Recording.of(model, frame)


def from_pipe(text, model, tmp_path):
    sentences = []
    pipe = PipeText(model, lambda kind, sentence: sentences.append(sentence))
    r = pipe.take(text.encode())
    assert not sentences, sentences
    return r


DOORS = pytest.mark.parametrize("door", [from_file, from_table, from_pipe])


@DOORS
@pytest.mark.parametrize("word", ["#VALUE!", "Bad", "No Data", "-- off --", "inf?"])
def test_rows_that_are_left_out_may_hold_anything(tmp_path, door, word):
    r = door(table({(12, "y1"): word, (13, "u1"): word, (12, "u1"): word}), MODEL, tmp_path)
    plain = door(table(), MODEL, tmp_path)
    for name in ("u", "y", "excluded", "time", "starts"):
        np.testing.assert_array_equal(getattr(r, name), getattr(plain, name), err_msg=name)
    assert "spreadsheet" not in " ".join(r.hints)


@DOORS
@pytest.mark.parametrize("word", ERRORS)
def test_errors_of_a_spreadsheet_are_missing_samples(tmp_path, door, word):
    r = door(table({(5, "y1"): word, (6, "y1"): word, (12, "y1"): word}), MODEL, tmp_path)
    plain = door(table({(5, "y1"): "", (6, "y1"): "", (12, "y1"): ""}), MODEL, tmp_path)
    np.testing.assert_array_equal(r.y, plain.y)
    np.testing.assert_array_equal(r.u, plain.u)
    if door is not from_pipe:
        row = "row 5" if door is from_file else "row 3"
        said = f"2 cells of column 'y1' hold an error of a spreadsheet, the first {word} in {row}: missing"
        assert said in " ".join(r.hints)


@DOORS
def test_a_condition_that_holds_a_word_leaves_the_row_out(tmp_path, door):
    r = door(table({(20, "fan"): "Bad", (20, "u1"): "Bad"}), MODEL, tmp_path)
    assert r.excluded[18] and not r.excluded[17] and not r.excluded[19]
    if door is from_file:
        assert (
            "1 cells of column 'fan', in the condition, hold no number, the first 'Bad' in row 20"
            in " ".join(r.hints)
        )


@pytest.mark.parametrize("door", [from_file, from_table])
def test_a_word_that_counts_is_refused_with_its_place(tmp_path, door):
    text = table({(12, "y1"): "Bad", (20, "u1"): "off", (18, "y1"): "No Data", (21, "y1"): "#REF!"})
    first = "row 18" if door is from_file else "row 16"
    with pytest.raises(
        ValueError, match=f"{first} of column 'y1' holds 'No Data', which is not a number"
    ) as e:
        door(text, MODEL, tmp_path)
    assert "leave the row out by `where`; 1 more cells hold 'off', too" in str(e.value)
    assert "Bad" not in str(e.value) and "REF" not in str(e.value)
    with pytest.raises(ValueError, match="holds 'Bad'"):
        door(text, EVERY_ROW, tmp_path)


@pytest.mark.parametrize("word", ["1_0", "1e1_0", "\u0661\u0660", "\uff11\uff10", "0x10", "1 0"])
def test_what_only_python_takes_for_a_number_is_none(tmp_path, word):
    text = table({(12, "y1"): word})
    for door in (from_file, from_table):
        with pytest.raises(ValueError, match=f"of column 'y1' holds '{word}', which is not a number"):
            door(text, EVERY_ROW, tmp_path)
    for cut in (len(text), 40):  # many lines at once, and few
        sentences = []
        pipe = PipeText(EVERY_ROW, lambda kind, sentence, said=sentences: said.append(sentence))
        for at in range(0, len(text.encode()), cut):
            pipe.take(text.encode()[at : at + cut])
        assert sentences[0].startswith(f"line 12 of column 'y1' holds '{word}', which is not a number")


def test_a_line_of_a_pipe_that_counts_is_left_out_with_a_sentence(tmp_path):
    sentences = []
    pipe = PipeText(MODEL, lambda kind, sentence: sentences.append(sentence))
    r = pipe.take(table({(12, "y1"): "Bad", (20, "y1"): "Bad"}).encode())
    assert r.samples == 29 and len(sentences) == 2  # the line, and the seam behind it
    assert sentences[0].startswith("line 20 of column 'y1' holds 'Bad', which is not a number")


def test_a_pipe_cut_anywhere_says_the_same(tmp_path):
    data = table({(12, "y1"): "Bad", (13, "y1"): "#REF!", (20, "u1"): "#N/A"}).encode()
    whole = from_file(data.decode(), MODEL, tmp_path)
    for size in (1, 17, 60):
        pipe = PipeText(MODEL, lambda kind, sentence: pytest.fail(sentence))
        pieces = [pipe.take(data[k : k + size]) for k in range(0, len(data), size)]
        pieces = [piece for piece in pieces if piece is not None]
        np.testing.assert_array_equal(np.concatenate([piece.y for piece in pieces]), whole.y)
        np.testing.assert_array_equal(np.concatenate([piece.u for piece in pieces]), whole.u)
        np.testing.assert_array_equal(np.concatenate([piece.excluded for piece in pieces]), whole.excluded)


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_commas_and_words_together(tmp_path, delimiter):
    plain = table({(12, "y1"): "", (12, "u1"): "", (5, "y1"): ""})
    text = table({(12, "y1"): "Bad", (12, "u1"): "n. v.", (5, "y1"): "#DIV/0!"})
    expected = from_file(plain, MODEL, tmp_path)
    r = from_file(text.replace(",", delimiter).replace(".", ","), MODEL, tmp_path)
    np.testing.assert_array_equal(r.y, expected.y)
    np.testing.assert_array_equal(r.u, expected.u)


@pytest.mark.parametrize("row", [12, 20])
def test_infinite_numbers_are_refused_only_where_they_count(tmp_path, row):
    text = table({(row, "y1"): "inf"})
    if row == 12:
        assert np.isnan(from_file(text, MODEL, tmp_path).y[10])
    else:
        with pytest.raises(ValueError, match="row 20 of column 'y1' is infinite"):
            from_file(text, MODEL, tmp_path)


def test_a_number_among_words_keeps_all_its_digits(tmp_path):
    """Numbers that are read as texts first are the numbers that are read at once."""
    numbers = np.random.default_rng(1).normal(size=28) * 10.0 ** np.arange(-14, 14)
    changes = {(k + 2, "y1"): repr(x) for k, x in enumerate(numbers.tolist())}
    changes |= {(2, "u1"): "+3", (3, "u1"): " 4 ", (4, "u1"): "1.", (5, "u1"): ".5", (6, "u1"): "1E-3"}
    plain = from_file(table({**changes, (2, "u1"): "3"}), EVERY_ROW, tmp_path)
    r = from_file(table({**changes, (31, "u1"): "#NUM!"}), EVERY_ROW, tmp_path)
    np.testing.assert_array_equal(r.y, plain.y)
    np.testing.assert_array_equal(r.u[:-1], plain.u[:-1])


def test_a_whole_column_of_words_is_named(tmp_path):
    text = table({(k, "y1"): "open" for k in range(2, 32)})
    with pytest.raises(ValueError, match="row 2 of column 'y1' holds 'open', which is not a number"):
        from_file(text, MODEL, tmp_path)


def test_the_shell_says_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    changes = {(k + 2, "u1"): str(x) for k, x in enumerate(rng.integers(0, 5, 400).tolist())}
    changes |= {(k + 2, "y1"): f"{x:.3f}" for k, x in enumerate(rng.normal(size=400).tolist())}
    (tmp_path / "run.csv").write_text(table({**changes, (12, "y1"): "Bad", (40, "y1"): "#VALUE!"}, 400))
    command = [
        "fit",
        "run.csv",
        "--inputs",
        "u1",
        "--outputs",
        "y1",
        "--out",
        "m.toml",
        "--recipe",
        "horizon=4",
    ]
    assert main.main([*command, "--where", "fan > 0"]) == 0
    out = re.sub(r"\s+", " ", capsys.readouterr().out)
    assert "one cell of column 'y1' holds an error of a spreadsheet, the first #VALUE! in row 40" in out
    assert main.main([*command, "--force"]) == 2
    err = capsys.readouterr().err
    assert "row 12 of column 'y1' holds 'Bad', which is not a number" in err and err.count("\n") == 1
