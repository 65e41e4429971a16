"""The checkpoint of a run without an end: after a kill or a power cut the next process goes on behind it.

It is one row in an SQLite file, replaced behind each piece: the position of the source, the carry of the
judge, the memory of each sink. The file is in WAL mode with full synchronisation, so a checkpoint that was
saved is on the disk, and one that was being saved is not seen. Sinks hand on only what is in the checkpoint
already (see `loop.follow`), so a sink that knows from its memory what was to be handed on neither loses nor
doubles anything.
"""

import json
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from jaxbound.files.checkpoint import refuse_other
from jaxbound.recordings.stream import Taken
from jaxbound.runs.loop import Memory, Remembering
from jaxbound.runs.refusals import Refused
from jaxbound.runs.sink import Sink

STATE, FORMER = "monitor.sqlite", "monitor.jsonl"  # in the folder of a run; the latter of an earlier jaxbound
OURS = 0x6A786264  # "jxbd", the mark of our files among those of SQLite
SYNCHRONOUS = "FULL"
TABLE = "CREATE TABLE IF NOT EXISTS checkpoint (id INTEGER PRIMARY KEY, identity TEXT, memory TEXT)"
TAKEN = "CREATE TABLE IF NOT EXISTS taken (id INTEGER PRIMARY KEY, digests BLOB)"
HEADER, MARK = 100, slice(68, 72)  # bytes that begin each file of SQLite, and where a program puts its mark
NO_STATE = "{} is no state of jaxbound detect: choose another, or delete it to begin anew"
FORMER_STATE = (
    "{} is the state of an earlier jaxbound, from which this one cannot go on: choose {}, or delete it to "
    "begin anew"
)


class Journal:
    """The file of the checkpoint; a context in which nobody else has it.

    Args:
        path: of the file; it is made when something is saved first. identity: {what verdicts depend on:
            text}; a checkpoint with another is refused.

    Fields: before: what was saved last, None if nothing was. taken: the samples of the source, whose digests
    are saved with the memory, each once.

    Raises:
        Refused: the file is none of ours, or of an earlier jaxbound; another process has it. ValueError: a
            checkpoint of another model, method or version.
    """

    def __init__(self, path: Path, identity: Mapping[str, str]) -> None:
        self.path, self.identity = path, identity
        self.before: Any = None
        self.taken = Taken(self._digests)
        self.database: sqlite3.Connection | None = None

    def __enter__(self) -> "Journal":
        if self.path.exists():
            _refuse_foreign(self.path)
            self._open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        if self.database is not None:
            self.database.close()
            self.database = None

    def save(self, memory: Memory) -> None:
        """Put a memory into the place of the one before; once this returns it survives a power cut."""
        if self.database is None:
            self._open()
        assert self.database is not None
        row = json.dumps(dict(self.identity)), json.dumps(memory)
        with self.database:
            self.database.execute("BEGIN")
            self.database.execute("REPLACE INTO checkpoint VALUES (1, ?, ?)", row)
            if self.taken.fresh:
                self.database.execute("INSERT INTO taken (digests) VALUES (?)", (bytes(self.taken.fresh),))
        self.taken.fresh.clear()

    def _digests(self) -> bytes:
        """Return the digests of all samples that were taken until now."""
        if self.database is None:
            return b""
        return b"".join(digests for (digests,) in self.database.execute("SELECT digests FROM taken"))

    def _open(self) -> None:
        try:
            self.database = _connected(self.path)
            self.database.execute(TABLE)
            self.database.execute(TAKEN)
            row = self.database.execute("SELECT identity, memory FROM checkpoint").fetchone()
            if row is not None:
                identity, self.before = map(json.loads, row)
        except sqlite3.OperationalError as e:
            self.close()
            if _code(e) in ("SQLITE_BUSY", "SQLITE_LOCKED"):
                raise Refused(f"another process is writing {self.path}: choose another place") from None
            raise OSError(None, str(e), str(self.path)) from e
        except (sqlite3.DatabaseError, ValueError, TypeError):
            self.close()
            raise Refused(NO_STATE.format(self.path)) from None
        if row is not None:
            try:
                refuse_other(self.path, identity, self.identity)
            except ValueError:
                self.close()
                raise


def _connected(path: Path) -> sqlite3.Connection:
    """Return a connection that keeps other processes away, where the file system can."""
    try:
        return _prepared(sqlite3.connect(path, timeout=0, isolation_level=None))
    except sqlite3.OperationalError as e:
        if not _code(e).endswith("LOCK") and _code(e) != "SQLITE_PROTOCOL":
            raise
    unlocked = f"{path.absolute().as_uri()}?nolock=1"
    return _prepared(sqlite3.connect(unlocked, timeout=0, isolation_level=None, uri=True))


def _prepared(database: sqlite3.Connection) -> sqlite3.Connection:
    """Set how a database is locked and written; this is when the lock is taken."""
    try:
        # before WAL, which then needs no memory shared with other processes, which networks lack
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute(f"PRAGMA application_id = {OURS}")  # and before WAL: it stands in the file itself
        database.execute("PRAGMA journal_mode = WAL")
        database.execute(f"PRAGMA synchronous = {SYNCHRONOUS}")
        database.execute("BEGIN IMMEDIATE")
        database.execute("COMMIT")
    except sqlite3.Error:
        database.close()
        raise
    return database


def _code(e: sqlite3.Error) -> str:
    """Return the name of an error of SQLite."""
    return str(getattr(e, "sqlite_errorname", ""))


def refuse_former_state(folder: Path) -> None:
    """Raise Refused if a folder holds the state of an earlier jaxbound, and none of this one."""
    former = folder / FORMER
    if former.exists() and not (folder / STATE).exists():
        raise Refused(FORMER_STATE.format(former, "another folder"))


def _refuse_foreign(path: Path) -> None:
    """Raise Refused if a file is not empty and none of ours, before anything is written into it."""
    with open(path, "rb") as file:
        beginning = file.read(HEADER)
    if beginning.startswith(b'{"identity"'):
        raise Refused(FORMER_STATE.format(path, "another"))
    mark = int.from_bytes(beginning[MARK], "big")
    if beginning and (not beginning.startswith(b"SQLite format 3\0") or mark != OURS):
        raise Refused(NO_STATE.format(path))


class Position(Remembering, Protocol):
    """The source of a run that goes on: it remembers its position.

    Fields: replaying: whether the sender begins again, and all that it sends was judged before.
    """

    replaying: bool


class Resuming(Remembering, Protocol):
    """A judge that goes on from its memory."""

    def resume(self, memory: dict[str, Any], /) -> None:
        """Go on from a memory."""


class LiveCheckpoint:
    """The one checkpoint of a source, a judge and sinks together.

    Args:
        journal: where it is saved. source: made from `journal.before["source"]`. judge, sinks: {name: sink}.
    """

    def __init__(
        self, journal: Journal, source: Position, judge: Resuming, sinks: Mapping[str, Sink | Resuming]
    ) -> None:
        self.journal, self.source, self.judge, self.sinks = journal, source, judge, sinks

    def resume(self) -> None:
        """Let judge and sinks go on from what was saved last.

        Raises:
            Refused: a development version of the same number saved something else.
        """
        try:
            self.judge.resume(self.journal.before["judge"])
            for name, sink in self.sinks.items():
                memory = self.journal.before["sinks"].get(name)
                if memory is not None:
                    sink.resume(memory)
        except (LookupError, TypeError) as e:
            raise Refused(FORMER_STATE.format(self.journal.path, "another")) from e

    def save(self) -> None:
        """Save all memories, if the source has a position that one can go on from."""
        if not self.source.replaying:
            self.finish()

    def finish(self) -> None:
        """Save all memories at the end, where everything was handed on."""
        position = self.source.memory()
        if position is None:
            return
        sinks = {name: sink.memory() for name, sink in self.sinks.items()}
        self.journal.save({"source": position, "judge": self.judge.memory(), "sinks": sinks})
