"""The one way to write a file completely or not at all, and locks that die with their process."""

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import IO

__all__ = ["UNFINISHED", "lock", "locked", "refuse_link", "unshared", "whole"]

UNFINISHED = ".jaxbound-part"  # ends the name of a file that is being written


def refuse_link(path: str | PathLike, folder: bool = False, replaced: bool = False) -> None:
    """Refuse what is there under a name of ours and leads elsewhere: writing to it would write to what
    somebody else keeps there.

    Args:
        path: of a file. folder: it is a folder. replaced: another file takes its name, so that it may have a
            second name of its own.

    Raises:
        FileExistsError: a link, a file with a second name, or what is neither a plain file nor the folder
            that is wanted.
    """
    try:
        about = os.lstat(path)
    except FileNotFoundError:
        return
    if folder:
        ours = stat.S_ISDIR(about.st_mode)
    else:
        ours = stat.S_ISREG(about.st_mode) and (replaced or about.st_nlink <= 1)
    if ours:
        return
    raise FileExistsError(
        errno.EEXIST,
        "a link, or what jaxbound did not write, is in the way: move it, or choose another place",
        str(path),
    )


def lock(file: IO, shared: bool = False) -> None:
    """Keep other processes away from an open file until it is closed; where the system has no locks, nobody
    is.

    Args:
        file: that is open. shared: others may lock it too if they share it.

    Raises:
        BlockingIOError: another process has it.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks
        pass


def unshared(file: IO) -> bool:
    """Return whether nobody else shares the lock of a file any more; no other can then have it before it is
    closed.
    """
    try:
        lock(file)
    except BlockingIOError:
        return False
    return True


def locked(path: str | PathLike, shared: bool = False) -> IO:
    """Open a file that no other process has open so; a lock dies with its process, so a killed one leaves
    none.

    Args:
        path: of the file, which is made if it is not there. shared: as for `lock`.

    Returns:
        A binary file, to be closed.

    Raises:
        BlockingIOError: another process has it. FileExistsError: a link, see `refuse_link`.
    """
    while True:
        refuse_link(path)
        try:
            opened = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as e:
            if e.errno == errno.ELOOP:  # made since it was looked at
                continue
            raise
        file = open(opened, "r+b")
        try:
            lock(file, shared)
        except BlockingIOError:
            file.close()
            raise
        if os.path.exists(path) and os.path.samestat(os.stat(path), os.fstat(file.fileno())):
            return file
        file.close()  # whoever had it has taken it away in between


@contextmanager
def whole(path: str | PathLike, sync: bool = True, links: bool = True) -> Iterator[IO[bytes]]:
    """Give a binary file whose bytes are found at `path` once the block has ended well; else what was there
    stays.

    They are written beside it: what a killed process leaves there is taken over by the next one. Links are
    followed; a pipe or a device is no file to replace, and is written as it is.

    Args:
        path: of the file. sync: force it to the disk first. links: whether they are followed, as where a user
            named the file.

    Raises:
        ValueError: another process is writing it. FileExistsError: a link that is not followed.
    """
    if not links:
        refuse_link(path, replaced=True)
    if os.path.exists(path) and not os.path.isfile(path):
        with open(path, "wb") as device:
            yield device
        return
    path = Path(os.path.realpath(path))
    part = path.with_name(f".{path.name}{UNFINISHED}")
    try:
        file = locked(part)
    except BlockingIOError:
        raise ValueError(f"another process is writing {path}") from None
    with file:
        try:
            file.truncate(0)
            yield file
            file.flush()
            if sync:
                os.fsync(file.fileno())
            if path.exists():
                shutil.copymode(path, part)
            os.replace(part, path)
        except BaseException as e:
            part.unlink(missing_ok=True)
            if isinstance(e, OSError) and e.errno and e.filename is None:
                raise OSError(e.errno, os.strerror(e.errno), str(path)) from e
            raise
