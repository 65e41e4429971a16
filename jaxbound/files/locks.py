"""Locks on files that die with their process, so a killed one leaves none.

They are those of `flock`. Where the system has no such call (Windows), or the file system keeps no locks,
nobody is kept away: two commands at once are then for their user to avoid.
"""

import errno
import os
import stat
from os import PathLike
from typing import IO

from jaxbound.files.disk import open_unlinked

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def refuse_link(path: str | PathLike[str], folder: bool = False, replaced: bool = False) -> None:
    """Refuse a link under a name of ours: writing to it would write to somebody else's file.

    Args:
        path: of a file. folder: it is a folder. replaced: another file takes its name, so that it may have a
            second name of its own.

    Raises:
        FileExistsError: a link, a file with a second name, or neither a plain file nor the folder that is
            wanted.
    """
    try:
        about = os.lstat(path)
    except FileNotFoundError:
        return
    if folder:
        ours = stat.S_ISDIR(about.st_mode)
    else:
        ours = stat.S_ISREG(about.st_mode) and (replaced or about.st_nlink <= 1)
    if not ours:
        raise FileExistsError(
            errno.EEXIST,
            "a link, or what jaxbound did not write, is in the way: move it, or choose another place",
            str(path),
        )


def lock(file: IO[bytes], shared: bool = False) -> None:
    """Keep other processes away from an open file until it is closed.

    Args:
        file: that is open. shared: others may lock it too if they share it.

    Raises:
        BlockingIOError: another process has it.
    """
    if fcntl is None:
        return
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks
        pass


def unshared(file: IO[bytes]) -> bool:
    """Return whether nobody else shares the lock of a file; no other can then have it before it is closed."""
    try:
        lock(file)
    except BlockingIOError:
        return False
    return True


def let_go(file: IO[bytes]) -> None:
    """Close a file that is about to be renamed or removed, where an open one cannot be (Windows).

    Elsewhere it stays open, so that its lock covers the renaming.
    """
    if fcntl is None:
        file.close()


def locked(path: str | PathLike[str], shared: bool = False) -> IO[bytes]:
    """Open a file that no other process has open so.

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
            file = open_unlinked(path)
        except OSError as e:
            if e.errno == errno.ELOOP:  # made since it was looked at
                continue
            raise
        try:
            lock(file, shared)
        except BlockingIOError:
            file.close()
            raise
        if os.path.exists(path) and os.path.samestat(os.stat(path), os.fstat(file.fileno())):
            return file
        file.close()  # its last owner has taken it away in between
