"""Certificates of samples that an observer refuted, without all samples before them."""

from typing import Any

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source
from jaxbound.sets.floats.status import Status

__all__ = ["REACHES", "refuted_again"]

REACHES = (2**6, 2**12, 2**16)
"""So many samples before a sample that an observer refuted are read to see it refuted again, before all of
them are.
"""


def refuted_again(observer: Relations, source: Source, k: int) -> tuple[Any, Recording]:
    """Return (Certificate of sample k, which an observer refuted, the Recording up to it).

    Read are as many samples before it as are needed: an observer that begins later knows less, but nothing
    that is wrong.

    Args:
        source: of the recording, see `open_source`.

    Raises:
        NotImplementedError: as `Result.explain` of an observer.
    """
    for reach in (*REACHES, k + 1):
        part = source.read(max(k + 1 - reach, 0), k + 1)
        res = detect(observer, part)
        if res.status[-1] == Status.FAULT or reach > k:
            break
    return res.explain(len(res.status) - 1), part
