"""What a command writes: files and folders, and which of those that are there it may replace.

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
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from jaxbound.files.locks import let_go, locked, refuse_link, unshared
from jaxbound.files.whole import UNFINISHED, whole
from jaxbound.recordings.parquetfiles import SUFFIXES
from jaxbound.runs.refusals import Refused

__all__ = ["OutputFolder", "made", "output_folder", "refuse_targets", "shared_folder"]

LIST, WORK, LOCK = ".jaxbound.json", ".jaxbound-work", ".jaxbound-lock"
FULL = (errno.ENOSPC, errno.EDQUOT)
DIGESTED = 1 << 26  # bytes of the largest file that is known again by its content


@contextmanager
def made(path: str | PathLike) -> Iterator[Path]:
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
    path: str | PathLike, names: Iterable[str] = (), inputs: Iterable[str | PathLike] = ()
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
def shared_folder(
    path: str | PathLike, names: Iterable[str] = (), inputs: Iterable[str | PathLike] = ()
) -> Iterator[None]:
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
def _kept_from_others(path, shared=False):
    """Make a folder and keep commands away from it; shared: only those that want it for themselves."""
    with made(path) as path:
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


def _holder(lock):
    try:
        return f", process {int(lock.read_text())},"
    except (OSError, ValueError):
        return ""


class OutputFolder:
    """A folder of files, of which a list says which are jaxbound's. From `output_folder`.

    Fields: path: of the folder. inputs: paths of what is read. listed: {name: entries, of which one fits the
    file}.
    """

    def __init__(self, path: Path, inputs: Iterable[str | PathLike] = ()) -> None:
        self.path, self.inputs = Path(path), [Path(p) for p in inputs]
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

    def check(self, names: Iterable[str], foreign: bool = True) -> None:
        """Raise Refused if what is called by one of these names is an input or, if `foreign`, not
        jaxbound's.
        """
        for name in (*names, WORK):
            self._refuse_input(name)
        for name in names if foreign else ():
            if stranger := self._stranger(name):
                why = "it was not written by jaxbound, or was changed since"
                raise Refused(
                    f"{self.path / stranger} is in the way: {why}; move it, or choose another folder"
                )

    def put(self, sources: Mapping[str, Path]) -> None:
        """Move files or folders of this file system into this folder, all or none.

        Args:
            sources: {name: path of what takes this name}.
        """
        sources = {name: p for name, p in sources.items() if not self._same(p, self.path / name)}
        self.check(sources)
        self._list([entry for name, p in sources.items() for entry in _entries(name, p)])
        before = self.path / WORK / ".before"
        before.mkdir(parents=True, exist_ok=True)
        moves = [
            pair
            for name, p in sources.items()
            for pair in ((self.path / name, before / name), (p, self.path / name))
        ]
        try:
            for start, end in moves:
                if os.path.lexists(start):
                    os.replace(start, end)
        except BaseException:
            for start, end in reversed(moves):
                if os.path.lexists(end) and not os.path.lexists(start):
                    os.replace(end, start)
            raise
        shutil.rmtree(before, ignore_errors=True)
        with suppress(OSError):
            (self.path / WORK).rmdir()

    def remove(self, name: str) -> None:
        """Remove a file or folder if it is jaxbound's and no input; else leave it."""
        path = self.path / name
        if not os.path.lexists(path) or self._stranger(name) or any(map(_within(path), self.inputs)):
            return
        if path.is_dir():
            for p in path.iterdir():
                p.unlink()
            path.rmdir()
        else:
            path.unlink()

    def claim(self, *names: str) -> None:
        """Put files on the list that will be written in place, whatever they hold then."""
        self._list([(name, None) for name in names])

    def settle(self, *names: str) -> None:
        """Put claimed files on the list as they are now."""
        self.listed = {name: told for name, told in self.listed.items() if name not in names}
        self._list(
            [
                entry
                for name in names
                if (self.path / name).is_file()
                for entry in _entries(name, self.path / name)
            ]
        )

    def tidy(self) -> None:
        """Remove the list if nothing that it names is there."""
        if self.listed and not any(os.path.lexists(self.path / name) for name in self.listed):
            (self.path / LIST).unlink(missing_ok=True)

    def _list(self, entries):
        """Add (name, entry) to the list; forget what fits no file any more."""
        fits = {name: [e for e in told if _fits(self.path / name, e)] for name, told in self.listed.items()}
        new = {name: [e, *fits.pop(name, [])] for name, e in entries}
        self.listed = {name: told for name, told in (fits | new).items() if told}
        with whole(self.path / LIST, links=False) as f:
            f.write(json.dumps({"written by jaxbound": self.listed}, indent=1).encode())

    def _read(self):
        if not os.path.lexists(self.path / LIST):
            return {}
        try:
            told = json.loads((self.path / LIST).read_bytes())["written by jaxbound"]
            return {str(name): list(entries) for name, entries in told.items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise Refused(
                f"{self.path / LIST} is no list of jaxbound's files: move it, or choose another folder"
            ) from None

    def _stranger(self, name):
        """Return the name of what is not jaxbound's in a file or folder, or None."""
        path = self.path / name
        if path.is_dir() and not path.is_symlink():
            return next(filter(None, (self._stranger(f"{name}/{p}") for p in sorted(os.listdir(path)))), None)
        if not os.path.lexists(path) or any(_fits(path, e) for e in self.listed.get(name, ())):
            return None
        return name

    def _refuse_input(self, name):
        for path in self.inputs:
            if _within(self.path / name)(path):
                raise Refused(
                    f"{path} would be overwritten by {self.path / name}: an input is never an output, choose "
                    f"another folder"
                )

    def _same(self, source, target):
        """Return whether a file is there already, byte for byte."""
        plain = source.is_file() and target.is_file() and not target.is_symlink()
        return (
            plain
            and source.stat().st_size == target.stat().st_size
            and source.read_bytes() == target.read_bytes()
        )


def _within(path):
    """Return a function that tells whether a file or folder is `path`, by whatever name, or inside it."""
    try:
        there = os.stat(path)
    except OSError:
        return lambda other: False
    chain = lambda other: (p for p in (other, *Path(os.path.realpath(other)).parents) if os.path.exists(p))
    return lambda other: any(os.path.samestat(there, os.stat(p)) for p in chain(other))


def _entries(name, path):
    """Return (name, entry) of a file, or of all files in a folder."""
    if path.is_dir():
        return [entry for p in sorted(path.iterdir()) for entry in _entries(f"{name}/{p.name}", p)]
    about = path.stat()
    return [(name, [about.st_size, about.st_mtime_ns, _digest(path, about.st_size)])]


def _fits(path, entry):
    """Return whether a file is the one that was listed: claimed, untouched since, or a copy."""
    if path.is_symlink() or not path.is_file():
        return False
    if entry is None:
        return True
    size, time, digest = entry
    about = path.stat()
    return about.st_size == size and (
        about.st_mtime_ns == time or (digest is not None and _digest(path, size) == digest)
    )


def _digest(path, size):
    return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest() if size <= DIGESTED else None


def refuse_targets(targets: Mapping[str, Path | None], inputs: Iterable[str | PathLike], force: bool) -> None:
    """Raise Refused unless every file may be written: in a folder that exists, no input, and nothing that is
    lost.

    Args:
        targets: {option: path or None}. inputs: paths of what is read. force: files that are there may be
            replaced.
    """
    wanted = {option: path for option, path in targets.items() if path is not None}
    for option, path in wanted.items():
        if (
            path.is_dir()
            or not Path(os.path.realpath(path)).parent.is_dir()
            or (path.exists() and not path.is_file())
        ):
            raise Refused(f"{option} {path} must be a file to write, in a folder that exists")
        for other in map(Path, inputs):
            part = path.suffix.lower() in SUFFIXES and other.is_dir() and _within(other)(path)
            if part or _within(path)(other):
                what = f"{'a part of ' * part}{other}, which is read"
                raise Refused(f"{option} {path} is {what}: an input is never an output, choose another name")
    if len({os.path.realpath(path) for path in wanted.values()}) < len(wanted):
        raise Refused(f"{' and '.join(wanted)} name the same file: give each a name of its own")
    for option, path in wanted.items():
        if path.exists() and not force:
            raise Refused(f"{option} {path} exists: --force replaces it, or choose another name")
