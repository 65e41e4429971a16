"""Verdicts that a killed process leaves neither twice nor not at all.

Before the rows of a burst are appended to verdicts.csv, a note is appended to the state file: how long
verdicts.csv is, the rows that come next and everything needed to go on behind them. Whenever the process is
killed, the next one takes the last note that is whole, cuts verdicts.csv back to that length and appends
these rows: however often it is done, the file is the same. Now and then the state file is replaced by one
with the last note alone. Files are forced to the disk only at the end, so this is no promise for a machine
that loses its
power: then the lengths may not fit, and the state is refused.
"""

import json
import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from jaxbound.files.checkpoint import refuse_other
from jaxbound.files.locks import lock
from jaxbound.files.whole import whole
from jaxbound.runs.refusals import Refused

__all__ = ["STATE", "VERDICTS", "Journal"]

STATE, VERDICTS = "monitor.jsonl", "verdicts.csv"
HEADER = b"time,status,margin,suspect\n"
KNOWN = 80  # last bytes of verdicts.csv by which it is known again
LARGEST = 1 << 22  # bytes of notes, about, before only the last is kept


class Journal:
    """The state file and verdicts.csv; a context in which they are open.

    Args:
        out: folder for verdicts.csv, or None. state: path of the state file; None: in `out`, or nowhere.
        identity: {what verdicts depend on: text}; a state with another is refused.

    Fields: before: what was remembered last, or None; pending: the rows of the last burst before a kill,
    which may not have been printed.

    Raises:
        ValueError: a state that is none, or another model's; verdicts that are not those that the state
            speaks of; another process on them.
    """

    def __init__(
        self, out: str | PathLike | None, state: str | PathLike | None, identity: Mapping[str, str]
    ) -> None:
        self.verdicts = None if out is None else Path(out) / VERDICTS
        self.path: Any = Path(state) if state is not None else None if out is None else Path(out) / STATE
        self.identity, self.before, self.pending = identity, None, b""
        self.file: Any = None  # open while rows are written
        self.notes: Any = None
        self.length, self.end, self.noted = 0, b"", 0

    def __enter__(self) -> "Journal":
        if self.path is not None and self.path.exists():
            self._restore()
            self._open()
        return self

    def __exit__(self, *error: object) -> None:
        for file in (self.file, self.notes):
            if file is not None:
                file.close()

    def add(self, memory: Any, rows: bytes = b"") -> None:
        """Remember what there is after a burst (fit for JSON), then append its rows."""
        if self.file is None:
            self._open()
        if self.path is not None:
            self._save(memory, rows)
        if self.file is not None and rows:
            self._append(rows)

    def finish(self, memory: Any) -> None:
        """Remember the end: everything is written and printed."""
        if self.file is not None:
            os.fsync(self.file.fileno())
        if self.path is not None:
            self._save(memory, b"", True)

    def _append(self, rows):
        _write(self.file, rows)
        self.length, self.end = self.length + len(rows), (self.end + rows[-KNOWN:])[-KNOWN:]

    def _save(self, memory, rows, sync=False):
        text = lambda b: b.decode("latin-1")
        note = {
            "identity": self.identity,
            "length": self.length,
            "end": text(self.end),
            "rows": text(rows),
            "memory": memory,
        }
        data = json.dumps(note).encode() + b"\n"
        if self.notes is None or self.noted > LARGEST or sync:
            with whole(self.path, sync) as f:
                f.write(data)
            if self.notes is not None:
                self.notes.close()
            self.notes, self.noted = open(self.path, "ab", buffering=0), 0  # noqa: SIM115
        else:
            _write(self.notes, data)
        self.noted += len(data)

    def _restore(self):
        try:
            *_, last, torn = self.path.read_bytes().rsplit(b"\n", 2)
            note = json.loads(last)
            identity, self.before, self.length = note["identity"], note["memory"], note["length"]
            self.pending, self.end = note["rows"].encode("latin-1"), note["end"].encode("latin-1")
        except (ValueError, KeyError, TypeError):
            raise Refused(
                f"{self.path} is no state of jaxbound detect: choose another, or delete it to begin anew"
            ) from None
        refuse_other(self.path, identity, self.identity)

    def _open(self):
        """Open verdicts.csv, if it is wanted, and bring it to where the state is."""
        if self.verdicts is None:
            return
        self.file = open(self.verdicts, "a+b", buffering=0)  # noqa: SIM115
        try:
            self._begin()
        except BaseException:
            self.file.close()
            raise

    def _begin(self):
        try:
            lock(self.file)
        except BlockingIOError:
            raise Refused(f"another process is writing {self.verdicts}: choose another folder") from None
        if self.before is None:
            self.file.truncate(0)
            self._append(HEADER)
            return
        self.file.seek(max(self.length - len(self.end), 0))
        if not self.end or self.file.read(len(self.end)) != self.end:
            raise Refused(
                f"{self.verdicts} does not hold the verdicts that {self.path} speaks of: put it back, or "
                f"delete {self.path} "
                "to begin anew"
            )
        self.file.truncate(self.length)
        self._append(self.pending)


def _write(file, data):
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]
