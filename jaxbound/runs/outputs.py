"""Outputs of a command: files and folders, and which of those that are there it may replace.

An input is never an output. In a folder jaxbound replaces and removes only what it wrote there: a list,
.jaxbound.json, names these files with their size, time and digest; a file that was changed since, or that the
list does not name, is somebody's. New files are made in the folder itself, in .jaxbound-work, so that they
come into their places by renaming, all of them or none: no disk can run full between. A lock keeps a second
command away; it dies with its process, and what a killed one left in .jaxbound-work is removed by the next.
"""

import errno
import hashlib
import json
import os
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import Any

from jaxbound.files.locks import let_go, locked, refuse_link, unshared
from jaxbound.files.whole import UNFINISHED, put
from jaxbound.recordings.parquetfiles import SUFFIXES
from jaxbound.runs.refusals import Refused

LIST, WORK, LOCK = ".jaxbound.json", ".jaxbound-work", ".jaxbound-lock"
FULL = (errno.ENOSPC, errno.EDQUOT)
DIGESTED = 1 << 26  # bytes of the largest file that is known again by its content
LISTED = "written by jaxbound"
Place = str | PathLike[str]
Entry = list[Any] | None
"""[size, time of the last change, digest or None] of a file; None: of one that is being written, any fits."""


@contextmanager
def made(path: Place) -> Iterator[Path]:
    """Make a folder; remove it, and those above that are new too, if they are empty at the end."""
    path = Path(path)
    missing = [p for p in (path, *path.parents) if not p.exists()]
    try:
        if path.exists() and not path.is_dir():
            raise Refused(f"{path} is a file: a folder is needed")
        try:
            path.mkdir(parents=True, exist_ok=True)
            if not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as e:
            raise Refused(f"cannot write into {path}: {str(e.strerror).lower()}") from e
        yield path
    finally:
        for folder in missing:
            try:
                folder.rmdir()
            except OSError:
                break


@contextmanager
def output_folder(
    path: Place, names: Collection[str] = (), inputs: Iterable[Place] = ()
) -> Iterator["OutputFolder"]:
    """Give an OutputFolder that no other command writes into meanwhile; it is made if it is not there.

    Args:
        path: of the folder. names: what will be written there. inputs: paths of what is read.

    Raises:
        Refused: another command is at work there; one of the names belongs to an input or to a file that
            jaxbound did not write.
        FileExistsError: a link in the place of a file that jaxbound keeps there for itself.
    """
    with _kept_from_others(path):
        folder = OutputFolder(Path(path), inputs)
        folder.check(names)
        shutil.rmtree(folder.path / WORK, ignore_errors=True)  # of a command that was killed
        try:
            yield folder
        finally:
            folder.tidy()


@contextmanager
def shared_folder(path: Place, names: Collection[str] = (), inputs: Iterable[Place] = ()) -> Iterator[None]:
    """Make a folder into which several commands may write at once, each whole files of its own; no
    `output_folder` is given meanwhile.

    Args:
        path: of the folder. names: what will be written there. inputs: paths of what is read.

    Raises:
        Refused: a command that wants the folder for itself is at work there; one of the names belongs to an
            input.
    """
    with _kept_from_others(path, shared=True):
        OutputFolder(Path(path), inputs).check(names, foreign=False)
        yield


@contextmanager
def _kept_from_others(place: Place, shared: bool = False) -> Iterator[None]:
    """Make a folder and keep commands away from it; shared: only those that want it for themselves."""
    with made(place) as path:
        refuse_link(path / LIST, replaced=True)
        refuse_link(path / f".{LIST}{UNFINISHED}")
        refuse_link(path / WORK, folder=True)
        try:
            lock = locked(path / LOCK, shared)
        except BlockingIOError:
            raise Refused(
                f"another jaxbound{_holder(path / LOCK)} is writing into {path}: wait for it, or choose "
                f"another folder"
            ) from None
        with lock:
            try:
                lock.truncate(0)
                lock.write(str(os.getpid()).encode())
                lock.flush()
                yield
            except OSError as e:
                if e.errno in FULL:  # whichever file it was
                    raise OSError(e.errno, os.strerror(e.errno), str(path)) from e
                raise
            finally:
                if unshared(lock):
                    let_go(lock)
                    (path / LOCK).unlink(missing_ok=True)


def _holder(lock: Path) -> str:
    """Return the process that has a lock, for a sentence; "" where the file does not tell."""
    try:
        return f", process {int(lock.read_text())},"
    except (OSError, ValueError):
        return ""


class OutputFolder:
    """A folder of files, of which a list says which are jaxbound's. From `output_folder`.

    Fields: path: of the folder. inputs: paths of what is read. listed: {name: entries, of which one fits the
    file}. A file has two entries while it is replaced: whenever a process dies, one of them fits.
    """

    def __init__(self, path: Path, inputs: Iterable[Place] = ()) -> None:
        self.path, self.inputs = Path(path), [Path(p) for p in inputs]
        refuse_among_inputs(self.path, self.inputs)
        self.listed = self._read()

    @contextmanager
    def work(self) -> Iterator[Path]:
        """Give a folder to write into; once the block has ended well its files are in this one, else nothing
        is.
        """
        folder = self.path / WORK
        folder.mkdir()
        try:
            yield folder
            self.put({p.name: p for p in sorted(folder.iterdir())})
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def check(self, names: Collection[str], foreign: bool = True) -> None:
        """Raise Refused if a file or folder with one of these names is an input or, if `foreign`, not
        jaxbound's.
        """
        for name in (*names, WORK):
            self._refuse_input(name)
        if not foreign:
            return
        for name in names:
            stranger = self._stranger(name)
            if stranger is not None:
                why = "it was not written by jaxbound, or was changed since"
                raise Refused(
                    f"{self.path / stranger} is in the way: {why}; move it, or choose another folder"
                )

    def put(self, sources: Mapping[str, Path]) -> None:
        """Move files or folders of this file system into this folder, all or none.

        Args:
            sources: {name: path of what takes this name}.
        """
        sources = {name: p for name, p in sources.items() if not _is_same(p, self.path / name)}
        self.check(sources)
        before = self.path / WORK / ".before"
        new: dict[str, Entry] = {}
        moves: list[tuple[Path, Path]] = []
        for name, p in sources.items():
            new |= _entries_of(name, p)
            moves += [(self.path / name, before / name), (p, self.path / name)]
        # listed first: whoever is killed between leaves files that the next command may replace
        self._list(new)
        before.mkdir(parents=True, exist_ok=True)
        _move_all(moves)
        shutil.rmtree(before, ignore_errors=True)
        with suppress(OSError):
            (self.path / WORK).rmdir()

    def remove(self, name: str) -> None:
        """Remove a file or folder if it is jaxbound's and no input; else leave it."""
        path = self.path / name
        if not os.path.lexists(path) or self._stranger(name) or any(_is_within(path, p) for p in self.inputs):
            return
        if path.is_dir():
            for p in path.iterdir():
                p.unlink()
            path.rmdir()
        else:
            path.unlink()

    def claim(self, *names: str) -> None:
        """Put files on the list that will be written in place, whatever they hold then."""
        self._list(dict.fromkeys(names))

    def settle(self, *names: str) -> None:
        """Put claimed files on the list as they are now."""
        settled: dict[str, Entry] = {}
        for name in names:
            self.listed.pop(name, None)
            if (self.path / name).is_file():
                settled |= _entries_of(name, self.path / name)
        self._list(settled)

    def tidy(self) -> None:
        """Remove the list if nothing that it names is there."""
        if self.listed and not any(os.path.lexists(self.path / name) for name in self.listed):
            (self.path / LIST).unlink(missing_ok=True)

    def _list(self, new: Mapping[str, Entry]) -> None:
        """Add entries to the list; forget what fits no file any more."""
        listed: dict[str, list[Entry]] = {}
        for name, entries in self.listed.items():
            fitting = [entry for entry in entries if _is_listed(self.path / name, entry)]
            if fitting:
                listed[name] = fitting
        for name, entry in new.items():
            listed[name] = [entry, *listed.pop(name, [])]
        self.listed = listed
        put(self.path / LIST, json.dumps({LISTED: self.listed}, indent=1).encode(), links=False)

    def _read(self) -> dict[str, list[Entry]]:
        if not os.path.lexists(self.path / LIST):
            return {}
        try:
            listed = json.loads((self.path / LIST).read_bytes())[LISTED]
            return {str(name): list(entries) for name, entries in listed.items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise Refused(
                f"{self.path / LIST} is no list of jaxbound's files: move it, or choose another folder"
            ) from None

    def _stranger(self, name: str) -> str | None:
        """Return the name of a file that is not jaxbound's, in a folder of this name too; None: there is
        none.
        """
        path = self.path / name
        if path.is_dir() and not path.is_symlink():
            for inside in sorted(os.listdir(path)):
                stranger = self._stranger(f"{name}/{inside}")
                if stranger is not None:
                    return stranger
            return None
        if not os.path.lexists(path) or any(_is_listed(path, entry) for entry in self.listed.get(name, ())):
            return None
        return name

    def _refuse_input(self, name: str) -> None:
        for path in self.inputs:
            if _is_within(self.path / name, path):
                raise Refused(
                    f"{path} would be overwritten by {self.path / name}: an input is never an output, choose "
                    f"another folder"
                )


def _move_all(moves: Sequence[tuple[Path, Path]]) -> None:
    """Rename each path that is there, in order; where that fails, undo what was done."""
    try:
        for start, end in moves:
            if os.path.lexists(start):
                os.replace(start, end)
    except BaseException:
        for start, end in reversed(moves):
            if os.path.lexists(end) and not os.path.lexists(start):
                os.replace(end, start)
        raise


def _is_same(source: Path, target: Path) -> bool:
    """Return whether a file is there already, byte for byte."""
    if not source.is_file() or not target.is_file() or target.is_symlink():
        return False
    if source.stat().st_size != target.stat().st_size:
        return False
    return source.read_bytes() == target.read_bytes()


def _is_within(path: Path, other: Path) -> bool:
    """Return whether a file or folder, the other one, is `path`, by whatever name, or inside of it."""
    try:
        there = os.stat(path)
    except OSError:
        return False
    chain = (other, *Path(os.path.realpath(other)).parents)
    return any(os.path.samestat(there, os.stat(p)) for p in chain if os.path.exists(p))


def _entries_of(name: str, path: Path) -> dict[str, Entry]:
    """Return {name: entry} of a file, or of all files in a folder."""
    if not path.is_dir():
        about = path.stat()
        return {name: [about.st_size, about.st_mtime_ns, _digest(path, about.st_size)]}
    inside: dict[str, Entry] = {}
    for p in sorted(path.iterdir()):
        inside |= _entries_of(f"{name}/{p.name}", p)
    return inside


def _is_listed(path: Path, entry: Entry) -> bool:
    """Return whether a file is the one that was listed: claimed, untouched since, or a copy."""
    if path.is_symlink() or not path.is_file():
        return False
    if entry is None:
        return True
    size, time, digest = entry
    about = path.stat()
    if about.st_size != size:
        return False
    return about.st_mtime_ns == time or (digest is not None and _digest(path, size) == digest)


def _digest(path: Path, size: int) -> str | None:
    if size > DIGESTED:
        return None
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def refuse_among_inputs(folder: Path, inputs: Iterable[Place]) -> None:
    """Raise Refused for a folder of outputs that is a folder which is read; a report in one is no data."""
    for read in map(Path, inputs):
        if read.is_dir() and folder.exists() and folder.samefile(read):
            raise Refused(f"{folder} is read: an input is never an output, choose another folder")


def refuse_targets(targets: Mapping[str, Path | None], inputs: Iterable[Place], force: bool) -> None:
    """Raise Refused unless every file may be written: in a folder that exists, no input, and nothing that is
    lost.

    Args:
        targets: {option: path or None}. inputs: paths of what is read. force: files that are there may be
            replaced.
    """
    wanted = {option: path for option, path in targets.items() if path is not None}
    for option, path in wanted.items():
        in_folder = Path(os.path.realpath(path)).parent.is_dir()
        if not in_folder or (path.exists() and not path.is_file()):
            raise Refused(f"{option} {path} must be a file to write, in a folder that exists")
        for other in map(Path, inputs):
            is_part = path.suffix.lower() in SUFFIXES and other.is_dir() and _is_within(other, path)
            if is_part or _is_within(path, other):
                what = f"{'a part of ' * is_part}{other}, which is read"
                raise Refused(f"{option} {path} is {what}: an input is never an output, choose another name")
    if len({os.path.realpath(path) for path in wanted.values()}) < len(wanted):
        raise Refused(f"{' and '.join(wanted)} name the same file: give each a name of its own")
    for option, path in wanted.items():
        if path.exists() and not force:
            raise Refused(f"{option} {path} exists: --force replaces it, or choose another name")
