"""Every line of a CSV file is a row that is read, or is named in a sentence; a pipe of the same bytes says
the same.
"""

from functools import partial

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.recordings.csvlines import CountedLines, is_open, split_lines
from jaxbound.recordings.csvtext import UNENDED
from jaxbound.recordings.pipetext import PipeText
from jaxbound.runs.fleet import read_manifest

TIMED = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1)
ALONE = jb.LinearSystem([[0.5]], None, [[1]], dt=0.5, noise=0.1)
NAMED = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1, columns={"where": "note != 'off'"})
ROWS = [(0.5 * k, k % 7 / 4, k / 8) for k in range(40)]


def table(line="{},{},{}\n", head="t,u1,y1\n", rows=ROWS):
    return head + "".join(line.format(*row) for row in rows)


def edited(text, number, old, new):
    """Return text with something else in the line of this number, the header being 1."""
    lines = text.split("\n")
    assert old in lines[number - 1]
    lines[number - 1] = lines[number - 1].replace(old, new, 1)
    return "\n".join(lines)


def quoted(text):
    return "".join(",".join(f'"{cell}"' for cell in line.split(",")) + "\n" for line in text.splitlines())


PLAIN, SPARE = table(), table("{},{},{},fine\n", "t,u1,y1,note\n")
UNTIMED, COLUMN = table("{1},{2}\n", "u1,y1\n"), table("{2}\n", "y1\n")
SEMICOLON = table("{};{};{}\n", "t;u1;y1\n").replace(".", ",")

READ = {  # (text, model): 40 samples from a file as from a pipe
    "plain": (PLAIN, TIMED),
    "carriage returns": (PLAIN.replace("\n", "\r"), TIMED),
    "both": (PLAIN.replace("\n", "\r\n"), TIMED),
    "a carriage return too many": (PLAIN.replace("\n", "\r\r\n"), TIMED),
    "a carriage return too many, no time": (UNTIMED.replace("\n", "\r\r\n"), TIMED),
    "a carriage return too many, one column": (COLUMN.replace("\n", "\r\r\n"), ALONE),
    "all kinds of ends": (PLAIN.replace("5\n", "5\r").replace("0\n", "0\r\n"), TIMED),
    "no last end": (PLAIN[:-1], TIMED),
    "no last end, carriage returns": (PLAIN[:-1].replace("\n", "\r"), TIMED),
    "byte order mark": ("\ufeff" + PLAIN, TIMED),
    "byte order mark and blank lines": ("\ufeff\n \n" + PLAIN, TIMED),
    "quotes": (quoted(PLAIN), TIMED),
    "quotes and carriage returns": (quoted(PLAIN).replace("\n", "\r"), TIMED),
    "a delimiter in quotes": (edited(SPARE, 9, "fine", '"fine, ""really"""'), TIMED),
    "inches": (edited(SPARE, 9, "fine", 'a 5" pipe'), TIMED),
    "other quotes": (edited(edited(SPARE, 9, "fine", "'fine"), 12, "fine", "`fine\u201d"), TIMED),
    "words behind a quote": (edited(SPARE, 9, "fine", '"fine" they say'), TIMED),
    "separators of other kinds": (edited(SPARE, 9, "fine", "a\x0bb\x0cc\x1cd\u2028e\x85f"), TIMED),
    "blank lines": (PLAIN.replace("\n", "\n\n"), TIMED),
    "a line of one space": (PLAIN.replace("\n2.0,", "\n \n2.0,"), TIMED),
    "blanks at the end": (PLAIN + "\n \n\t\n", TIMED),
    "blanks at the end, no time": (UNTIMED + "\n \n\n", TIMED),
    "blanks below the header, no time": (UNTIMED.replace("\n", "\n\n \n", 1), TIMED),
    "a delimiter at the end": (table("{},{},{},\n", "t,u1,y1,\n"), TIMED),
    "one column": (COLUMN, ALONE),
    "semicolons": (SEMICOLON, TIMED),
    "semicolons and the line of Excel": ("sep=;\r\n" + SEMICOLON.replace("\n", "\r\n"), TIMED),
    "tabs": (SEMICOLON.replace(";", "\t"), TIMED),
    "a row of tabs alone": (SEMICOLON.replace(";", "\t").replace("t\tu1", "note\tu1") + "\t\t\n", TIMED),
    "one column with blank lines": (edited(edited(COLUMN, 9, "0.875", ""), 20, "2.25", " "), ALONE),
    "one column that ends in blank lines": (COLUMN + "\n\n", ALONE),
    "one column with a blank first line": (edited(COLUMN, 2, "0.0", ""), ALONE),
    "one column with carriage returns": (edited(COLUMN, 9, "0.875", "").replace("\n", "\r"), ALONE),
    "one column, blank lines, both": (edited(COLUMN, 9, "0.875", "").replace("\n", "\r\n"), ALONE),
    "text in quotes": (edited(SPARE, 9, "fine", '"off"'), NAMED),
}
MISSING = {
    "one column with blank lines": 2,
    "one column with a blank first line": 1,
    "one column with carriage returns": 1,
    "one column, blank lines, both": 1,
    "text in quotes": 1,
}
LENGTHS = {
    "a row of tabs alone": 41,
    "one column that ends in blank lines": 42,
    "no last end": 39,
    "no last end, carriage returns": 39,
}

OPEN = "has a quotation mark that is not closed"
BAD = {  # (text, model, number of the line, what is said of it): refused in a file, left out of a pipe
    "a quote before a number that is used": (edited(PLAIN, 9, ",0.875", ',"0.875'), TIMED, 9, OPEN),
    "a quote in a column that is not used": (edited(SPARE, 9, "fine", '"fine'), TIMED, 9, OPEN),
    "two of them": (edited(edited(SPARE, 9, "fine", '"fine'), 15, "fine", 'fine"'), TIMED, 9, OPEN),
    "at the end": (edited(SPARE, 41, "fine", '"fine'), TIMED, 41, OPEN),
    "in a text that is compared": (edited(SPARE, 41, "fine", '"off'), NAMED, 41, OPEN),
    "a quote in the first row": (edited(SPARE, 2, "fine", '"fine'), TIMED, 2, OPEN),
    "a quote and carriage returns": (edited(SPARE, 9, "fine", '"fine').replace("\n", "\r"), TIMED, 9, OPEN),
    "a quote without a time": (
        edited(table("{1},{2},fine\n", "u1,y1,note\n"), 9, "fine", '"fine'),
        TIMED,
        9,
        OPEN,
    ),
    "a quote in one column": (edited(COLUMN, 9, "0.875", '"0.875'), ALONE, 9, OPEN),
    "a cell over two lines": (edited(SPARE, 9, "fine", '"fine\nreally"'), TIMED, 9, OPEN),
    "a blank line without a time": (
        UNTIMED.replace("\n0.5,2.0\n", "\n\n0.5,2.0\n"),
        TIMED,
        18,
        "is blank, and without a column of times",
    ),
    "a space without a time": (
        UNTIMED.replace("\n0.5,2.0\n", "\n \n0.5,2.0\n"),
        TIMED,
        18,
        "is blank, and without a column of times",
    ),
    "too few cells": (edited(PLAIN, 9, ",0.875", ""), TIMED, 9, "has 2 cells, the header has 3 columns"),
    "too many cells": (
        edited(PLAIN, 9, "0.875", "0.875,1"),
        TIMED,
        9,
        "has 4 cells, the header has 3 columns",
    ),
    "too few cells below blank lines": (
        edited("\n\n" + PLAIN.replace("\n", "\n\n"), 19, ",0.875", ""),
        TIMED,
        19,
        "has 2 cells",
    ),
    "a word": (edited(PLAIN, 9, "0.875", "off"), TIMED, 9, "of column 'y1' holds 'off'"),
    "a NUL": (edited(PLAIN, 9, "0.875", "0.875\0"), TIMED, 9, ""),
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.csv"


def from_pipe(text, model, cuts=()):
    """Return (pieces, sentences) of a stream that comes in these pieces."""
    said = []
    pipe = PipeText(model, lambda kind, sentence: said.append((kind, sentence)))
    edges = [0, *cuts, len(text)]
    found = [pipe.take(text[a:b]) for a, b in zip(edges, edges[1:], strict=False)]
    pipe.refuse_empty()
    return [piece for piece in found if piece is not None], said


def join(pieces, name):
    return np.concatenate([getattr(piece, name) for piece in pieces])


@pytest.mark.parametrize("case", READ)
@pytest.mark.parametrize("step", [1, 7, 10**6])
def test_a_file_and_a_pipe_read_the_same_rows(path, case, step):
    text, model = READ[case]
    path.write_bytes(text.encode())
    r = jb.read(path, model)
    pieces, said = from_pipe(text.encode(), model, range(step, len(text.encode()), step))
    assert r.samples == LENGTHS.get(case, 40) and not [x for kind, x in said if kind == "line"]
    for name in ("u", "y", "time"):
        np.testing.assert_array_equal(getattr(r, name), join(pieces, name))
    known = ~np.isnan(r.y[:40, 0])
    np.testing.assert_array_equal(r.y[:40, 0][known], np.array(ROWS[: len(known)])[known, 2])
    assert np.count_nonzero(~known) == MISSING.get(case, 0) and len(r.starts) == (
        2 if case == "text in quotes" else 0
    )


@pytest.mark.parametrize("case", ["plain", "carriage returns", "both", "quotes", "one column", "semicolons"])
def test_a_last_line_cut_anywhere_is_left_out_and_said_by_both(path, case):
    """Of `..,4.875` that is cut to `..,4.8`, nothing shows that a digit is missing."""
    text, model = READ[case]
    body = text.rstrip("\r\n")
    last = max(body.rfind("\n"), body.rfind("\r")) + 1
    for stop in range(last + 1, len(body) + 1):
        path.write_text(body[:stop], newline="")
        r = jb.read(path, model)
        assert r.samples == 39 and [h for h in r.hints if "line end" in h] == [f"row 41, the last, {UNENDED}"]
        said = []
        pipe = PipeText(model, lambda kind, sentence, said=said: said.append((kind, sentence)))
        assert sum(piece.samples for _, piece in pipe.pieces([body[:stop].encode()])) == 39
        assert [x for x in said if x[0] == "line"] == [("line", f"the last line {UNENDED}")]


def test_a_complete_last_line_is_taken_and_a_blank_one_not_missed(path):
    for end in ("\n", "\r", "\r\n", "\n  ", "\n\n"):
        path.write_text(PLAIN[:-1] + end, newline="")
        r = jb.read(path, TIMED)
        assert r.samples == 40 and not [h for h in r.hints if "line end" in h], end


def test_means_say_it_too(path):
    path.write_text(PLAIN[:-1])
    means = jb.read(path, TIMED.replace(dt=2, columns={"every": "2s"}))
    assert f"row 41, the last, {UNENDED}" in means.hints


def test_a_file_whose_only_row_has_no_line_end_is_refused(path):
    path.write_text("t,u1,y1\n0,1,2")
    with pytest.raises(ValueError, match="row 2, the only one, has no line end"):
        jb.read(path, TIMED)


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("step", [3, 10**6])
def test_a_line_that_is_no_row_is_named_by_both(path, case, step):
    text, model, number, what = BAD[case]
    path.write_bytes(text.encode())
    with pytest.raises(ValueError, match=f"row {number} {what}" if "NUL" not in case else "binary") as caught:
        jb.read(path, model)
    assert "\n" not in str(caught.value)
    pieces, said = from_pipe(text.encode(), model, range(step, len(text.encode()), step))
    lines = [x for kind, x in said if kind == "line"]
    assert lines[0].startswith(f"line {number} {what}") and len(lines) == 1 + (
        case == "a cell over two lines"
    )
    left = join(pieces, "y")[:, 0]
    assert len(left) == 40 - ("blank" not in what) and set(left) <= {row[2] for row in ROWS}
    if 2 < number < 40:
        starts = np.concatenate(
            [
                p.starts + at
                for p, at in zip(pieces, np.cumsum([0, *(len(p.y) for p in pieces)]), strict=False)
            ]
        )
        assert starts.tolist() == [16 if number == 18 else 7], (
            "the samples around the line do not follow each other"
        )


@pytest.mark.parametrize("text", [COLUMN, table("{2},fine\n", "y1,note\n")], ids=["one column", "two"])
def test_no_row_of_a_long_file_is_lost(path, text):
    """A cell that began with a quotation mark took what follows to the end of the block with it: here, a
    fault.
    """
    head, *rows = (text * 2000).replace(text.split("\n")[0] + "\n", "").splitlines()
    path.write_text(text.split("\n")[0] + "\n" + "\n".join([head, *rows]) + "\n")
    assert jb.read(path, ALONE).samples == 80_000
    for at in (3, 40_000, 79_999):
        changed = [head, *rows]
        changed[at] = changed[at].replace(",fine", ',"fine') if ",fine" in changed[at] else f'"{changed[at]}'
        path.write_text(text.split("\n")[0] + "\n" + "\n".join(changed) + "\n")
        with pytest.raises(ValueError, match=f"row {at + 2} has a quotation mark that is not closed"):
            jb.read(path, ALONE)


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "\r\r\n"])
@pytest.mark.parametrize("size", [64, 1 << 20, (1 << 20) + 1])
def test_lines_are_counted_wherever_blocks_end(tmp_path, end, size):
    rows = [f"{k}" * (k % 5) for k in range(300)] + ["x"]
    data = (end.join(rows)).encode()
    for tail, more in ((b"", -1), (end.encode(), 0), (end.encode() * 3, 2), ((end + "y").encode(), 0)):
        (tmp_path / "x").write_bytes(data + tail)
        with open(tmp_path / "x", "rb") as f:
            counted = CountedLines(f)
            blocks = b"".join(iter(partial(counted.read, size), b""))
        whole = 301 + min(more, 0)
        assert (counted.lines, counted.last, counted.unended) == (301 + more, whole, tail[-1:] in b"y"), tail
        assert split_lines(blocks)[:301] == [row.encode() for row in rows[:whole]]


@pytest.mark.parametrize(
    ("line", "opened"),
    [
        ("", False),
        ("a,b", False),
        ('"a",b', False),
        ('"a,b', True),
        ('a,"b', True),
        ('a"b,c', False),
        ('"a""b"', False),
        ('"a""b', True),
        ('"a"b"c,d', False),
        ('a"b,"c', True),
        ('"""', True),
        ('""""', False),
        ('"",""', False),
        ('"a,",b"', False),
        ('x,"' + '""' * 50_000, True),
    ],
)
def test_a_quotation_mark_that_is_not_closed(line, opened):
    assert is_open(line.encode(), b",") is opened


class TestManifest:
    ROWS = "unit,model,recording\nP-1,m.toml,1.csv\nP-2,m.toml,2.csv\nP-3,m.toml,3.csv\n"

    def read(self, path, text):
        path.write_bytes(text.encode())
        return [unit.name for unit in read_manifest(path)]

    @pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "\r\r\n"])
    def test_line_ends(self, path, end):
        assert self.read(path, self.ROWS.replace("\n", end)) == ["P-1", "P-2", "P-3"]

    @pytest.mark.parametrize("mark", ["\x0b", "\x0c", "\x1c", "\x85", "\u2028"])
    def test_other_separators_are_part_of_a_name(self, path, mark):
        assert self.read(path, self.ROWS.replace("P-2", f"P{mark}2")) == ["P-1", f"P{mark}2", "P-3"]

    @pytest.mark.parametrize("row, cell", [(2, "1.csv"), (3, "P-2"), (4, "3.csv"), (4, "P-3")])
    def test_a_stray_quotation_mark_takes_no_unit_away(self, path, row, cell):
        """Before, the units between two of them vanished: neither tested nor listed."""
        with pytest.raises(ValueError, match=f"row {row} has a quotation mark that is not closed"):
            self.read(path, self.ROWS.replace(cell, f'"{cell}'))
        with pytest.raises(ValueError, match="row 2 has a quotation mark that is not closed"):
            self.read(path, self.ROWS.replace("1.csv", '"1.csv').replace("3.csv", '3.csv"'))

    def test_cells_in_quotes(self, path):
        assert self.read(path, self.ROWS.replace("P-2", '"P, 2"').replace("m.toml", '"m.toml"')) == [
            "P-1",
            "P, 2",
            "P-3",
        ]
