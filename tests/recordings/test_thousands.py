"""Signs for thousands in whole numbers are never read as decimals beside numbers that have none, and
decimals are read as they are.
"""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.recordingformat import with_format

MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1, noise=0.1)


def by_thousands(x, sign="."):
    return f"{x:,}".replace(",", sign)


def text_of(cells, delimiter=";", others="0"):
    return (
        delimiter.join(["t", "u1", "y1"])
        + "\n"
        + "".join(f"{k}{delimiter}{others}{delimiter}{cell}\n" for k, cell in enumerate(cells))
    )


def from_pipe(text, size=10**6, model=MODEL):
    """Return (y, sentences) of a stream that comes in pieces."""
    said = []
    pipe = PipeText(model, lambda kind, sentence: said.append(sentence))
    pieces = [pipe.take(text.encode()[at : at + size]) for at in range(0, len(text.encode()), size)]
    return np.concatenate([piece.y[:, 0] for piece in pieces if piece is not None]), said


POWER = [998, 1002, 1010, 1004, 999, 990, 1250, 20_400, 987]
DOUBTED = {
    "by points": ([by_thousands(x) for x in POWER], ";", "0"),
    "by commas": ([by_thousands(x, ",") for x in POWER], "\t", "0"),
    "by points, tabs": ([by_thousands(x) for x in POWER], "\t", "0"),
    "below zero": ([by_thousands(-x) for x in POWER], ";", "0"),
    "beside decimals of another column": ([by_thousands(x) for x in POWER], ";", "20.5"),
    "with blank cells": (["", *(f" {by_thousands(x)} " for x in POWER), "NaN"], ";", "0"),
    "none ends in 0": (["998", "1.002", "997", "1.004"], ";", "0"),
    "on and off": (["12", "2.500", "12", "2.510"], ";", "0"),
    "late": (["998"] * 500 + ["1.000"], ";", "0"),
}
DECIMALS = {
    "of fixed length": ["1.002", "0.998", "35.120", "20.000"],
    "of fixed length above one": ["1.002", "35.120", "20.000", "998.125"],
    "of any length": ["3", "1.002", "1.05", "7"],
    "few, beside whole ones": ["20", "20", "21.375", "20", "22"],
    "beside large whole ones": ["1500", "1.002", "998"],
    "with zeros": ["0", "1.250", "0", "2.500"],
    "whole": ["998", "1002", "20400"],
    "eighths": ["12", "12.125", "12.25", "13"],
}


@pytest.mark.parametrize("case", DOUBTED)
def test_a_column_that_can_be_read_in_two_ways_is_refused_with_both_rows(tmp_path, case):
    (tmp_path / "run.csv").write_text(text_of(*DOUBTED[case]))
    with pytest.raises(ValueError, match=r"column 'y1' holds \S+ in row \d+.*: write whole numbers without"):
        jb.read(tmp_path / "run.csv", MODEL)


def test_points_in_a_file_with_decimal_commas_are_for_thousands(tmp_path):
    text = text_of(["35.120", "35.240", "36.123"]).replace("\n", ";0,5\n").replace("y1;0,5", "y1;note")
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(ValueError, match="column 'y1' holds 35.120 in row 2: write whole numbers without"):
        jb.read(tmp_path / "run.csv", MODEL)
    (tmp_path / "run.csv").write_text(text_of(["35.120", "35.240"], others="0,5"))
    with pytest.raises(ValueError, match="holds '35.120', which is not a number: write it without signs for"):
        jb.read(tmp_path / "run.csv", MODEL)


@pytest.mark.parametrize("case", DECIMALS)
@pytest.mark.parametrize("sign, delimiter", [(".", ";"), (".", "\t"), (".", ","), (",", ";"), (",", "\t")])
def test_decimals_are_read_as_they_are(tmp_path, case, sign, delimiter):
    cells = [cell.replace(".", sign) for cell in DECIMALS[case]]
    text = text_of(cells, delimiter)
    (tmp_path / "run.csv").write_text(text)
    expected = [float(cell) for cell in DECIMALS[case]]
    np.testing.assert_array_equal(jb.read(tmp_path / "run.csv", MODEL).y[:, 0], expected)
    for size in (10**6, 9):
        y, said = from_pipe(text, size)
        np.testing.assert_array_equal(y, expected)
        assert not [sentence for sentence in said if "thousands" in sentence]


def test_a_column_of_which_nothing_tells_is_said(tmp_path):
    (tmp_path / "run.csv").write_text(text_of(["35.120", " 36.200", ""]))
    said = "column 'y1' is read as decimals, like 35.120: if points are for thousands, write it without them"
    assert jb.read(tmp_path / "run.csv", MODEL).hints[0] == said
    for cells, delimiter in ((["35.120", "0.250"], ";"), (["35,120", "36,200"], ";"), (["35.120"] * 2, ",")):
        (tmp_path / "run.csv").write_text(text_of(cells, delimiter))
        assert "thousands" not in " ".join(jb.read(tmp_path / "run.csv", MODEL).hints)
    (tmp_path / "run.csv").write_text(text_of(["35,120", "36,200"], "\t"))
    assert (
        jb.read(tmp_path / "run.csv", MODEL)
        .hints[0]
        .endswith("if commas are for thousands, write it without them")
    )


@pytest.mark.parametrize(
    ("cells", "delimiter", "others"),
    [
        (["481", "1,184", "378"], "\t", "55.61"),
        (["1,184", "6,710", "23,136"], "\t", "5.6"),
        (["47", "-1,346", "513"], ";", "55.6"),
        (["481 kW", "1,184 kW", "1,378 kW"], "\t", "55,61"),
        (["1.183", "833", "160"], ",", '"68,2"'),
    ],
)
def test_a_sign_that_is_no_decimal_sign_of_another_column_may_be_for_thousands(
    tmp_path, cells, delimiter, others
):
    (tmp_path / "run.csv").write_text(text_of(cells, delimiter, others))
    with pytest.raises(
        ValueError, match=r"column 'y1' holds -?1.\d{3}.* in row \d.*: write whole numbers without"
    ):
        jb.read(tmp_path / "run.csv", MODEL)


@pytest.mark.parametrize("size", [10**6, 9])
def test_a_pipe_leaves_out_a_line_behind_whole_numbers(size):
    y, said = from_pipe(text_of(["998", "1.002", "999", "1.010", "997"]), size)
    assert y.tolist() == [998, 999, 997]
    assert said[0].startswith("line 3 of column 'y1' holds 1.002 behind whole numbers: write whole numbers")


def test_numbers_with_two_signs_have_one_reading(tmp_path):
    for cell, value in (("1.234.567", 1234567), ("35.010,5", 35010.5), ("1'234", 1234), ("1 234", 1234)):
        (tmp_path / "run.csv").write_text(text_of(["1", cell, "2"]))
        run = jb.read(tmp_path / "run.csv", MODEL)
        assert run.y[:, 0].tolist() == [1, value, 2] and "for thousands" in " ".join(run.hints), cell


def test_a_file_with_blank_lines_whose_cells_are_looked_at_again_is_read(tmp_path):
    text = text_of(["35.120", "36.200", "35.125"])
    (tmp_path / "run.csv").write_text(text.replace("\n1;", "\n\n1;"))
    assert jb.read(tmp_path / "run.csv", MODEL).y[:, 0].tolist() == [35.12, 36.2, 35.125]


LATE = {  # (cells, delimiter, what is stated, numbers)
    "behind commas": (["998,5"] * 20 + ["1.002,5", "1.002"] + ["997,5"] * 20, ";", {}, None),
    "behind points": (["998.5"] * 20 + ["1,002", "12,001.25"] + ["997.5"] * 20, "\t", {}, None),
    "quoted": (["998.5"] * 20 + ['"1,002"'] + ["997.5"] * 3, ",", {}, None),
    "by apostrophes": (["998.5"] * 20 + ["1'002"] + ["997.5"] * 20, ",", {}, None),
    "by blanks": (["998,5"] * 20 + ["1 002"] + ["997,5"] * 20, ";", {}, None),
    "stated": (["998"] * 20 + ["1.002"] + ["997"] * 20, ";", {"thousands": "."}, None),
    "stated commas": (["998"] * 20 + ["1.002"] + ["997"] * 20, ";", {"decimal": ","}, None),
    "decimals": (["998,5"] * 20 + ["1,002"] + ["997,5"] * 20, ";", {}, 1.002),
}


@pytest.mark.parametrize("size", [10**6, 9])
@pytest.mark.parametrize("case", LATE)
def test_signs_for_thousands_that_come_late_are_read_from_a_pipe_as_from_a_file(tmp_path, case, size):
    cells, delimiter, stated, number = LATE[case]
    model = MODEL.replace(columns=with_format({}, stated))
    text = text_of(cells, delimiter)
    (tmp_path / "run.csv").write_text(text)
    expected = jb.read(tmp_path / "run.csv", model).y[:, 0].tolist()
    assert int(expected[20]) == int(number or 1002)
    y, said = from_pipe(text, size, model)
    assert (y.tolist(), said) == (expected, [])


def test_signs_of_two_kinds_and_units_that_come_late_are_left_out_with_their_row():
    for cells in (["998,5", "1.002,5", "1'003,5"], ["998,5", "1 %"], ["998,5", "ON"], ["998", "1.002,5"]):
        y, said = from_pipe(text_of(cells))
        assert len(y) == len(cells) - 1
        assert f"line {len(cells) + 1} of column 'y1' holds {cells[-1]!r}, which is not a number" in said[0]


@pytest.mark.parametrize(
    "first, then", [("998,5", "1.000"), ("998.5", "1,000"), ("998", "1.000"), ("1.002", "998")]
)
@pytest.mark.parametrize("beside", ["", "999"])
def test_zeros_behind_a_sign_for_thousands_are_never_lost_in_a_burst(tmp_path, first, then, beside):
    """Cells that are read at once show their signs, too, where their numbers do not."""
    cells = [first] * 12 + [then, beside or then] * 12
    text = text_of(cells)
    (tmp_path / "run.csv").write_text(text)
    try:
        known = jb.read(tmp_path / "run.csv", MODEL).y[:, 0]
    except ValueError as e:
        known = np.where(np.array(cells) == then, np.nan, [float(cell) for cell in cells])
        assert "write whole numbers without signs for thousands" in str(e)
    for size in (10**6, len(text_of(cells[:12])), 60):
        said, pieces = [], []
        model = MODEL.replace(columns={"where": "t >= 0"})
        pipe = PipeText(model, lambda kind, sentence, said=said: said.append(sentence))
        for at in range(0, len(text), size):
            piece = pipe.take(text[at : at + size].encode())
            pieces += [] if piece is None else [piece]
            pipe = PipeText(model, pipe.complain, pipe.memory()) if pieces else pipe  # another process
        time = np.concatenate([piece.time for piece in pieces]).astype(int)
        np.testing.assert_array_equal(np.concatenate([piece.y[:, 0] for piece in pieces]), known[time])
        assert len(time) + pipe.lost == len(cells) and (np.isfinite(known).all() or said)
