"""Text that people and loggers write, drawn by hypothesis: in any dialect it is read as the numbers it was
written from, cut anywhere it says the same, and with anything changed it is read or refused in a sentence.

A failure is shrunk to the shortest text that fails, with a line that repeats it.
"""

import datetime
import tempfile
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

import jaxbound as jb
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.timestamps import CLOCKS, DATES

MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1)
BLANKS = ("", "NaN", "null", "NA")
ENDS = ("\n", "\r\n", "\r")
numbers = st.floats(-1e9, 1e9, allow_subnormal=False).map(lambda x: float(f"{x:.7g}"))
few = hypothesis.settings(max_examples=40)
many = hypothesis.settings(max_examples=80)


@st.composite
def dialects(draw):
    """Return how a table is written: delimiter, decimal sign, end of a line, quotes, mark, blank cells."""
    delimiter = draw(st.sampled_from(",;\t"))
    decimal = draw(st.sampled_from(".,")) if delimiter != "," else "."
    return {
        "delimiter": delimiter,
        "decimal": decimal,
        "end": draw(st.sampled_from(ENDS)),
        "quote": draw(st.sampled_from(['"', ""])),
        "mark": draw(st.sampled_from(["", "\ufeff"])),
        "blank": draw(st.sampled_from(BLANKS)),
        "last": draw(st.booleans()),
    }


def written(header, rows, dialect):
    """Return a table as text: numbers with the decimal sign of the dialect, None as its blank cell."""

    def cell(value):
        if value is None:
            value = dialect["blank"]
        if isinstance(value, float):
            value = repr(value).replace(".", dialect["decimal"])
        return dialect["quote"] + value + dialect["quote"]

    lines = [dialect["delimiter"].join(map(cell, row)) for row in (header, *rows)]
    return dialect["mark"] + dialect["end"].join(lines) + dialect["end"] * dialect["last"]


@st.composite
def tables(draw):
    """Return (text, u, y) of a recording: columns in any order, one more with words, samples missing."""
    dialect, count = draw(dialects()), draw(st.integers(3, 12))
    u = draw(st.lists(numbers, min_size=count, max_size=count))
    y = draw(st.lists(st.none() | numbers, min_size=count, max_size=count))
    y[0] = draw(numbers)  # a column without any number is refused
    columns = {"t": [0.5 * k for k in range(count)], "u1": u, "y1": y, "note": ["fine"] * count}
    names = draw(st.permutations(list(columns)))
    rows = list(zip(*(columns[name] for name in names), strict=True))
    whole = count if dialect["last"] else count - 1  # a line without its end may be cut: it is left out
    return written(names, rows, dialect), np.array(u[:whole]), np.array(y[:whole], float)


def read(text):
    """Return the Recording of a text, as the file that holds it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return jb.read(path, MODEL)


def from_pipe(data, cuts=()):
    """Return (time, u, y, starts, sentences) of bytes that come in pieces."""
    sentences = []
    pipe = PipeText(MODEL, lambda kind, sentence: sentences.append((kind, sentence)))
    edges = [0, *sorted(cuts), len(data)]
    pieces = [pipe.take(data[a:b]) for a, b in zip(edges, edges[1:], strict=False)]
    pieces = [piece for piece in pieces if piece is not None]
    first = np.cumsum([0, *(len(piece.time) for piece in pieces)])
    starts = [piece.starts + at for piece, at in zip(pieces, first, strict=False)]
    join = lambda name: np.concatenate([getattr(piece, name) for piece in pieces])
    return join("time"), join("u"), join("y"), np.concatenate(starts), sentences


@few
@hypothesis.given(tables())
def test_a_table_in_any_dialect_is_read_as_it_was_written(table):
    text, u, y = table
    r = read(text)
    np.testing.assert_array_equal(r.u[:, 0], u)
    np.testing.assert_array_equal(r.y[:, 0], y)
    np.testing.assert_array_equal(r.time, 0.5 * np.arange(len(u)))
    assert len(r.starts) == 0


@few
@hypothesis.given(tables(), st.data())
def test_bytes_cut_anywhere_give_the_samples_of_the_file(table, data):
    text = table[0].encode()
    cuts = data.draw(st.lists(st.integers(0, len(text)), max_size=6))
    r = read(text)
    for found, whole in zip(from_pipe(text, cuts), from_pipe(text), strict=True):
        np.testing.assert_array_equal(found, whole)
    time, u, y, starts, sentences = from_pipe(text, cuts)
    np.testing.assert_array_equal(time, r.time)
    np.testing.assert_array_equal(u, r.u)
    np.testing.assert_array_equal(y, r.y)
    assert starts.tolist() == [] and [s for kind, s in sentences if kind == "line"] == []


PLAIN = "t,u1,y1,note\n" + "".join(f"{0.5 * k},{k % 3},{k / 8},fine\n" for k in range(8))
CHANGES = st.lists(
    st.tuples(
        st.integers(0, len(PLAIN)),
        st.integers(0, 4),
        st.text(st.sampled_from('0123456789.,;\t\r\n"-+eE \0x:/\ufeff\u2028ä'), max_size=4),
    ),
    max_size=4,
)


def changed(text, changes):
    """Return text with pieces of it taken out and others put in."""
    for at, length, piece in changes:
        text = text[:at] + piece + text[at + length :]
    return text


def assert_sentence(error):
    """Check that an error is one line, short, without signs that a terminal would obey."""
    words = str(error)
    assert 10 < len(words) < 2300 and words.isprintable(), words


@many
@hypothesis.given(CHANGES)
def test_a_changed_table_is_a_recording_or_a_sentence(changes):
    text = changed(PLAIN, changes)
    try:
        r = read(text)
    except ValueError as error:
        assert_sentence(error)
    else:
        assert isinstance(r, Recording) and len(r.u) == len(r.y) == len(r.time)
        assert np.isfinite(r.time).all() and not np.isinf(r.y).any()


@many
@hypothesis.given(CHANGES, st.data())
def test_a_changed_stream_says_the_same_wherever_it_is_cut(changes, data):
    """Samples, seams, and sentences about lines; where it ends in an error, in the same one."""
    text = changed(PLAIN, changes).encode()
    cuts = data.draw(st.lists(st.integers(0, len(text)), max_size=4))
    try:
        whole = from_pipe(text)
    except ValueError as error:
        assert_sentence(error)
        with pytest.raises(ValueError) as again:
            from_pipe(text, cuts)
        assert str(again.value) == str(error)
    else:
        found = from_pipe(text, cuts)
        for a, b in zip(found[:4], whole[:4], strict=True):
            np.testing.assert_array_equal(a, b)
        assert [s for s in found[4] if s[0] == "line"] == [s for s in whole[4] if s[0] == "line"]


STAMPS = [f"{day}{gap}{clock}" for day in DATES for gap in (" ", "T") for clock in CLOCKS[:4]]
YEARS = datetime.datetime(1990, 1, 1), datetime.datetime(2049, 12, 31)  # which two digits of a year can say


@few
@hypothesis.given(
    st.sampled_from(STAMPS), st.datetimes(*YEARS), st.sampled_from([60, 90, 600, 3600, 86400, 100 * 86400])
)
def test_time_stamps_of_any_form_are_as_many_seconds_apart_as_their_moments(form, first, dt):
    """With the model's dt a form that can be read in two ways is read in the one that makes steps of it."""
    seconds = "%S" in form
    first = first.replace(microsecond=0, second=first.second if seconds else 0)
    step = dt if seconds else max(dt // 60, 1) * 60
    moments = [first + datetime.timedelta(seconds=step * k) for k in range(6)]
    text = "t,u1,y1\n" + "".join(f"{m.strftime(form)},1,{k}\n" for k, m in enumerate(moments))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        path.write_text(text)
        r = jb.read(path, MODEL.replace(dt=float(step)))
    np.testing.assert_array_equal(r.time, step * np.arange(6.0))
    assert len(r.starts) == 0
