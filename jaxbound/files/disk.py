"""The disk itself: when bytes are on it, and opening a file without following a link.

POSIX has calls for both that Windows lacks. There a folder cannot be forced to the disk (the file system
keeps its own journal of names), and a link that appears between looking and opening is followed.
"""

import os
from os import PathLike
from pathlib import Path
from typing import IO

NO_LINKS: int | None = getattr(os, "O_NOFOLLOW", None)
"""The flag that opens a file and no link; None where the system has none."""
FOLDERS: int | None = getattr(os, "O_DIRECTORY", None)
"""The flag that opens a folder; None where folders cannot be opened."""


def sync(file: IO[bytes]) -> None:
    """Force an open file to the disk: after this its bytes survive a power cut."""
    file.flush()
    os.fsync(file.fileno())


def sync_folder(path: str | PathLike[str]) -> None:
    """Force the names in a folder to the disk, where the system knows how.

    A file that was renamed or made is on the disk for sure only once its folder is.
    """
    if FOLDERS is None:
        return
    number = os.open(path, os.O_RDONLY | FOLDERS)
    try:
        os.fsync(number)
    except OSError:  # a file system that forces files alone, as some on a network do
        pass
    finally:
        os.close(number)


def open_unlinked(path: str | PathLike[str]) -> IO[bytes]:
    """Open a file for reading and writing, make it if it is not there, and follow no link.

    Raises:
        OSError: with the number ELOOP, a link has taken the name.
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0)
    if NO_LINKS is not None:
        flags |= NO_LINKS
    return open(os.open(Path(path), flags, 0o666), "r+b")
