"""Rows of verdicts as samples come: the text of verdicts.csv, and the file itself."""

import math
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.files.disk import sync, sync_folder
from jaxbound.files.locks import lock
from jaxbound.recordings.columns import Arrow, header_line, is_plain, moments, write_rows
from jaxbound.recordings.linetext import FEW
from jaxbound.recordings.recording import Recording
from jaxbound.runs.loop import Memory
from jaxbound.runs.refusals import Refused
from jaxbound.runs.sink import Verdicts
from jaxbound.runs.verdictfiles import named_columns, verdict_columns

VERDICTS = "verdicts.csv"
QUOTED = set(',"\r\n')  # in a cell
NOTHING = Judged(np.zeros(0, np.int8), np.zeros(0))
RECOGNISED = 80  # last bytes of verdicts.csv by which it is known again
UNFORCED = 1 << 13  # bytes that wait in the checkpoint before verdicts.csv is forced to the disk


class Text(Protocol):
    """The text of a table that grows.

    Fields: header: its first line.
    """

    header: bytes

    def of(self, piece: Recording, verdicts: Verdicts, /) -> bytes:
        """Return the rows of the last piece."""


class RowText:
    """The rows of the last verdicts, made once for all that write them.

    Fields: columns: of verdicts like those that come. names: of all columns. header: the line of them.
    """

    def __init__(self) -> None:
        self.begin(NOTHING)

    def begin(self, like: Verdicts) -> None:
        """Take the columns of the verdicts that come."""
        self.columns = named_columns(like)
        self.names = "time", *self.columns
        self.header = header_line(self.names)
        self.verdicts: Verdicts | None = None
        self.text = b""

    def of(self, piece: Recording, verdicts: Verdicts) -> bytes:
        """Return rows of verdicts.csv as `write_verdicts` writes them."""
        if verdicts is not self.verdicts:
            self.verdicts, self.text = verdicts, _row_text(piece.column, verdicts)
        return self.text


class RowFile:
    """verdicts.csv, or alarms.csv, as samples come, a sink. Each row is there once, whenever a process dies.

    Rows wait in the checkpoint until they are forced to the disk. So after a power cut, too, the next process
    cuts the file back to where it was on the disk for sure and writes what comes behind.

    Args:
        path: of the file. text: of its rows.

    Raises:
        Refused: another process is writing it, or it does not hold what the memory speaks of.
    """

    def __init__(self, path: Path, text: Text, state: Path) -> None:
        self.path, self.text, self.state = path, text, state
        self.file: IO[bytes] | None = None  # made when there is something to write
        self.forced, self.end = 0, b""  # bytes of the file that are on the disk, and the last of them
        self.written, self.fresh = b"", b""  # rows behind these: in the file, and to be written

    def add(self, piece: Recording, verdicts: Verdicts) -> None:
        """Take the rows of the next verdicts."""
        self.fresh += self.text.of(piece, verdicts)

    def memory(self) -> Memory:
        """Return how much is on the disk, and all rows behind that; None before there is a file."""
        if self.file is None and not self.fresh:
            return None
        if self.file is None:
            self._begin()
        rows = self.written + self.fresh
        return {"forced": self.forced, "end": _as_text(self.end), "rows": _as_text(rows)}

    def resume(self, memory: dict[str, Any]) -> None:
        """Bring the file to where the memory is."""
        self.forced, self.end = memory["forced"], _as_bytes(memory["end"])
        self.fresh = _as_bytes(memory["rows"])
        file = self._opened()
        file.seek(max(self.forced - len(self.end), 0))
        if file.read(len(self.end)) != self.end:
            file.close()
            raise Refused(
                f"{self.path} does not hold the verdicts that {self.state} speaks of: put it back, or delete "
                f"{self.state} to begin anew"
            )
        self.file = file
        file.truncate(self.forced)
        self.flush()

    def flush(self) -> None:
        """Write the rows, and force them to the disk once there are many."""
        if not self.fresh:
            return
        if self.file is None:
            self._begin()
        assert self.file is not None, "it was begun"
        _write_all(self.file, self.fresh)
        self.written, self.fresh = self.written + self.fresh, b""
        if len(self.written) > UNFORCED:
            self.force()

    def force(self) -> None:
        """Force all rows to the disk; without any, the header."""
        if self.file is None:
            self._begin()
            return
        sync(self.file)
        self.forced += len(self.written)
        self.end = (self.end + self.written[-RECOGNISED:])[-RECOGNISED:]
        self.written = b""

    def end_with(self, rows: bytes) -> None:
        """Write rows that stand until another process goes on: no checkpoint speaks of them."""
        self.fresh += rows
        self.flush()
        self.force()

    def close(self) -> None:
        """Close the file."""
        if self.file is not None:
            self.file.close()

    def _begin(self) -> None:
        """Begin the file anew."""
        self.file = self._opened()
        self.file.truncate(0)
        _write_all(self.file, self.text.header)
        self.written = self.text.header
        self.force()
        sync_folder(self.path.parent)

    def _opened(self) -> IO[bytes]:
        file = open(self.path, "a+b", buffering=0)
        try:
            lock(file)
        except BlockingIOError:
            file.close()
            raise Refused(f"another process is writing {self.path}: choose another folder") from None
        return file


def _row_text(written: Arrow, verdicts: Verdicts) -> bytes:
    """Return rows of verdicts.csv; written: the times as the recording has them, a pyarrow array."""
    import pyarrow as pa

    written = moments(written)
    if len(written) <= FEW and is_plain(written):  # by hand, which is sooner done
        cells = [map(_cell_text, x.tolist()) for x in (written, *named_columns(verdicts).values())]
        rows = list(zip(*cells, strict=True))
        if QUOTED.isdisjoint("".join(map("".join, rows))):
            return "".join(map("{}\n".format, map(",".join, rows))).encode()
    sink = pa.BufferOutputStream()
    write_rows(sink, {"time": written, **verdict_columns(verdicts)})
    return bytes(sink.getvalue().to_pybytes())


def _cell_text(x: float | str) -> str:
    """Return a cell as pyarrow writes it."""
    if isinstance(x, str):
        return x
    if isinstance(x, bool):
        return str(x).lower()
    return number_text(x)


def number_text(x: float) -> str:
    """Return a float as pyarrow writes it, NaN as nothing."""
    if math.isnan(x):
        return ""
    if x == 0 or 1e-4 <= abs(x) < 1e9:
        return repr(x).removesuffix(".0")
    import pyarrow as pa

    return str(pa.array([x]).cast(pa.string())[0].as_py())


def _as_text(data: bytes) -> str:
    """Return bytes as JSON holds them: Latin-1 has a character for each."""
    return data.decode("latin-1")


def _as_bytes(text: str) -> bytes:
    return text.encode("latin-1")


def _write_all(file: IO[bytes], data: bytes) -> None:
    """Write bytes into an unbuffered file, which may take a part of them at a time."""
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]
