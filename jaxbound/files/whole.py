"""The one way to write a file completely or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import IO

from jaxbound.files.disk import sync as force
from jaxbound.files.disk import sync_folder
from jaxbound.files.locks import let_go, locked, refuse_link

UNFINISHED = ".jaxbound-part"  # ends the name of a file that is being written


def put(path: str | PathLike[str], data: bytes, links: bool = True) -> None:
    """Write bytes to a file, all or nothing; arguments and errors as of `whole`."""
    with whole(path, links=links) as file:
        file.write(data)


@contextmanager
def whole(path: str | PathLike[str], sync: bool = True, links: bool = True) -> Iterator[IO[bytes]]:
    """Give a binary file whose bytes are found at `path` once the block has ended well, else nothing changes.

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
                force(file)
            if path.exists():
                shutil.copymode(path, part)
            let_go(file)
            os.replace(part, path)
            if sync:
                sync_folder(path.parent)
        except BaseException as e:
            let_go(file)
            part.unlink(missing_ok=True)
            if isinstance(e, OSError) and e.errno and e.filename is None:
                raise OSError(e.errno, os.strerror(e.errno), str(path)) from e
            raise
