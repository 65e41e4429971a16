"""What a recording holds, as a digest: by it a later command knows that it reads what was tested, whatever the dates of files say."""

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor

from jaxbound.recordings.parquetfiles import files_of

__all__ = ["content"]

BLOCK = 1 << 24  # bytes that a thread takes at once


def content(path):
    """Return a digest of all bytes of a recording; of a folder, of its Parquet files and their names in it; None of a pipe.

    Blocks are digested side by side (`hashlib` lets go of the interpreter), so a large recording costs little more than to read it.

    Args:
        path: of a file, or of a folder of Parquet files.

    Raises:
        OSError: a file that cannot be read. ValueError: a folder without Parquet files.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        return None  # what is read from it is gone
    files, whole = files_of(path), hashlib.blake2b(digest_size=32)
    blocks = [(i, at) for i, file in enumerate(files) for at in range(0, file.stat().st_size or 1, BLOCK)]
    with ThreadPoolExecutor(min(len(blocks), os.cpu_count() or 1)) as threads:
        for (i, at), digest in zip(blocks, threads.map(lambda block: _digest(files[block[0]], block[1]), blocks), strict=True):
            if at == 0:
                name = files[i].relative_to(path).as_posix() if path.is_dir() else ""  # a file may be moved
                whole.update(f"{len(name)} {name} {files[i].stat().st_size} ".encode())
            whole.update(digest)
    return whole.hexdigest()


def _digest(file, at):
    with open(file, "rb", buffering=0) as f:
        f.seek(at)
        return hashlib.blake2b(f.read(BLOCK), digest_size=32).digest()
