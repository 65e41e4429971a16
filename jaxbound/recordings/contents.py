"""Digests of recordings: by them a later command knows that it reads what was tested, whatever the dates of
files say.
"""

import hashlib
import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from jaxbound.recordings.parquetfiles import files_of

BLOCK = 1 << 24  # bytes that a thread takes at once
Digests = dict[tuple[Path, int], bytes]
"""{(file, first byte of a block): digest of the block}."""


def content(path: Path) -> str | None:
    """Return a digest of all bytes of a recording; of a folder, of its Parquet files and their names in it;
    None of a pipe.

    Args:
        path: of a file, or of a folder of Parquet files.

    Raises:
        OSError: a file that cannot be read. ValueError: a folder without Parquet files.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        return None  # what is read from it is gone
    return Contents(path).all()


class Contents:
    """Digests of the files of a recording, of which each block is read once, when it is first asked for.

    Blocks are digested side by side (`hashlib` lets go of the interpreter), so a large recording costs little
    more than to read it.

    Args:
        path: of a file, or of a folder of Parquet files. known: digests of blocks, to which others are added.
    """

    def __init__(self, path: Path, known: Digests | None = None) -> None:
        self.path, self.files = path, files_of(path)
        if known is None:
            known = {}
        self.known = known

    def all(self) -> str:
        """Return the digest of all bytes, and of the names and sizes of the files."""
        sizes = {file: file.stat().st_size for file in self.files}
        blocks = self._blocks([(file, 0, size or 1) for file, size in sizes.items()])
        whole = hashlib.blake2b(digest_size=32)
        for (file, at), digest in blocks.items():
            if at == 0:
                name = ""  # a file may be moved
                if self.path.is_dir():
                    name = file.relative_to(self.path).as_posix()
                whole.update(f"{len(name)} {name} {sizes[file]} ".encode())
            whole.update(digest)
        return whole.hexdigest()

    def of(self, spans: Iterable[tuple[Path, int, int]]) -> str:
        """Return a digest of all blocks with bytes in spans, (file, first byte, byte behind the last)
        each.
        """
        return hashlib.blake2b(b"".join(self._blocks(spans).values()), digest_size=32).hexdigest()

    def _blocks(self, spans: Iterable[tuple[Path, int, int]]) -> Digests:
        """Return the digests of the blocks in order."""
        wanted: dict[tuple[Path, int], None] = {}
        for file, first, stop in spans:
            for at in range(first // BLOCK * BLOCK, stop, BLOCK):
                wanted[file, at] = None
        new = [block for block in wanted if block not in self.known]
        if new:
            with ThreadPoolExecutor(min(len(new), os.cpu_count() or 1)) as threads:
                self.known.update(zip(new, threads.map(_digest_of_block, new), strict=True))
        return {block: self.known[block] for block in wanted}


def _digest_of_block(block: tuple[Path, int]) -> bytes:
    file, at = block
    with open(file, "rb", buffering=0) as f:
        f.seek(at)
        return hashlib.blake2b(f.read(BLOCK), digest_size=32).digest()
