"""Certificates of samples that an observer refuted, without all samples before them."""

from typing import Any, NamedTuple

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source
from jaxbound.sets.floats.status import Status

__all__ = ["REACHES", "Refuted", "refuted_again"]

REACHES = (2**6, 2**12, 2**16)
"""So many samples before a sample that an observer refuted are read to see it refuted again, before all of
them are.
"""


class Refuted(NamedTuple):
    """A sample that an observer refuted.

    Fields: certificate: of the sample. part: the Recording up to it, as far as it was read. test: of a
    monitor the name of the test that the certificate is of, else "".
    """

    certificate: Any
    part: Recording
    test: str = ""


def refuted_again(observer: Relations, source: Source, k: int) -> Refuted:
    """Return the certificate of sample k, which an observer refuted, and what it rests on.

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
    last = len(res.status) - 1
    test = ""
    if isinstance(res, MonitorResult):
        test = res.test_at(last)
    return Refuted(res.explain(last), part, test)
