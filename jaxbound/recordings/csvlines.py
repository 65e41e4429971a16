r"""The lines of a CSV file without its parser: how many there are, which are blank, where a quotation mark
stays open.

A line is a row. It ends at \n, \r\n or \r, also at \r\r\n, which a program writes whose carriage returns were
added twice; the characters that Unicode calls line ends are part of a cell, and so is a quotation mark inside
of a cell. One that begins a cell and is not closed on its line would take the lines behind it into the cell:
such a line is refused. What stands behind the last end is no row: it may be cut, and a cut number is another.
"""

import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import IO

import numpy as np

BOM = b"\xef\xbb\xbf"
BLOCK = 1 << 20  # bytes looked at at once
PATIENCE = 1.0  # s, with a thread that holds a file that is read


@contextmanager
def let_go(file: object) -> Iterator[None]:
    """Wait at the end until no thread of pyarrow holds a file that was given to it.

    Its readers end on their own time: one that lets go of a file while the interpreter ends aborts the
    process, whatever its exit code was to be.
    """
    before = sys.getrefcount(file)
    try:
        yield
    finally:
        until = time.monotonic() + PATIENCE
        while sys.getrefcount(file) > before and time.monotonic() < until:
            time.sleep(0)  # the thread needs the interpreter for it


class CountedLines:
    r"""A binary file that counts its lines while somebody reads it, in which \r\r\n has become \n.

    A last line without its end may have been cut while it was written, also inside of a number: it is none of
    the lines, and nobody reads it.

    Args:
        file: open for reading, not yet read.

    Fields: lines: how many there are; last: number of the last that holds more than blanks; open_end: whether
    a block ends in a line with an open quotation mark, where a parser would not notice it; unended: at the
    end, whether a line without its end was left out.
    """

    closed = False  # what pyarrow asks of a file

    def __init__(self, file: IO[bytes], delimiter: str = ",") -> None:
        self._file, self._delimiter, self._held = file, delimiter.encode(), b""
        self.lines = self._trailing = 0
        self.open_end = self.unended = False

    @property
    def last(self) -> int:
        """The number of the last line that holds more than blanks."""
        return self.lines - self._trailing + 1

    def read(self, size: int = BLOCK) -> bytes:
        r"""Return the next bytes, about so many, to the end of a line; nothing at the end.

        No \r is parted from what follows it.
        """
        data = b""
        while not data:
            more = self._file.read(size)
            held = self._held + more
            end = _last_end(held, len(held.rstrip(b"\r")) if more else len(held))
            data, self._held = held[:end], held[end:]
            if not more:
                self.unended |= bool(self._held.strip())
                self._held = b""
                break
        if data:
            data = self._counted(data)
        return data

    def _counted(self, data: bytes) -> bytes:
        bytes_of = np.frombuffer(data, np.uint8)
        ends = np.count_nonzero(bytes_of == 10)
        if b"\r" in data:
            returns = bytes_of == 13
            if (returns[1:] & returns[:-1]).any() and b"\r\r\n" in data:
                return self._counted(_with_newlines(data))
            ends += np.count_nonzero(returns) - np.count_nonzero(returns[:-1] & (bytes_of[1:] == 10))
        self.lines += int(ends)
        filled = data.rstrip(b" \r\n")
        if filled:
            self._trailing = len(line_ends(data[len(filled) :])) - 1
        else:
            self._trailing += int(ends)
        if b'"' in data:
            stop = len(data.rstrip(b"\r\n"))
            self.open_end |= is_open(data[_last_end(data, stop) : stop], self._delimiter)
        return data


def _last_end(data: bytes, stop: int) -> int:
    """Return the place behind the last line end before `stop`, 0 where there is none."""
    return max(data.rfind(b"\n", 0, stop), data.rfind(b"\r", 0, stop)) + 1


def split_lines(data: bytes) -> list[bytes]:
    r"""Return the lines of bytes, without their ends.

    Example:
        >>> split_lines(b"a\nb\r\nc\rd\r\r\n\n")
        [b'a', b'b', b'c', b'd', b'']
    """
    lines = line_ends(data)
    return lines if lines[-1] else lines[:-1]


def line_ends(data: bytes) -> list[bytes]:
    """Return the lines of bytes and what stands behind the last end, perhaps nothing."""
    return _with_newlines(data).split(b"\n")


def _with_newlines(data: bytes) -> bytes:
    r"""Return bytes in which \n ends each line."""
    if b"\r" not in data:
        return data
    if b"\r\r\n" in data:
        data = re.sub(rb"\r\r+\n", b"\n", data)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def lines_of(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the lines of a file, without their ends; not one that has none."""
    counted = CountedLines(file)
    while block := counted.read():
        yield from line_ends(block)[:-1]


def is_open(line: bytes, delimiter: bytes) -> bool:
    r"""Return whether a quotation mark begins a cell of a line and is not closed in it.

    Example:
        >>> is_open(b'1,"2', b","), is_open(b'1,5" pipe', b","), is_open(b'"a ""b"" c",2', b",")
        (True, False, False)
    """
    return b'"' in line and _without_open_quotes(delimiter).fullmatch(line) is None


@cache
def _without_open_quotes(delimiter: bytes) -> re.Pattern[bytes]:
    d = re.escape(delimiter)
    quoted = rb'"(?:[^"]|"")*+"(?:[^"' + d + rb"][^" + d + rb"]*+)?+"
    cell = rb"(?:" + quoted + rb'|(?!")[^' + d + rb"]*+)"
    return re.compile(cell + rb"(?:" + d + cell + rb")*+", re.DOTALL)
