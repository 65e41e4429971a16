"""Certificates of samples that an observer refuted, without all samples before them."""

from typing import Any, NamedTuple

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.diagnosis.result import Result
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Source
from jaxbound.sets.floats.status import Status

REACHES = (2**6, 2**12, 2**16)
"""So many samples before a sample that an observer refuted are read to see it refuted again, before all of
them are.
"""


class Spoken(NamedTuple):
    """The word of a run's files on a sample. Fields: status: its name; test: of a monitor the name of the
    test that speaks; "": not known.
    """

    status: str = ""
    test: str = ""


NOBODY = Spoken()


class Refuted(NamedTuple):
    """A sample that an observer refuted.

    Fields: certificate: of the sample. part: the Recording up to it, as far as it was read.
    """

    certificate: Any
    part: Recording


def refuted_again(observer: Relations, source: Source, k: int, spoken: Spoken = NOBODY) -> Refuted:
    """Return the certificate of sample k, which an observer refuted, and what it rests on.

    Read are as many samples before it as are needed: an observer that begins later knows less, but nothing
    that is wrong.

    Args:
        source: of the recording, see `open_source`. spoken: of a monitor, what its run said of the sample:
            the certificate is of the same test.

    Raises:
        NotImplementedError: as `Result.explain` of an observer.
    """
    for reach in (*REACHES, k + 1):
        part = source.read(max(k + 1 - reach, 0), k + 1)
        res = detect(observer, part)
        if reach > k or _is_said(res, spoken):
            break
    last = len(res.status) - 1
    if not isinstance(res, MonitorResult):
        return Refuted(res.explain(last), part)
    test = res.test_at(last)
    if spoken.test in res.names and res.status[last] != Status.MISSING:
        test = spoken.test
    if not test:
        return Refuted(res.explain(last), part)  # says why there is none
    return Refuted(res.tests[test].explain(last).of_test(test), part)


def _is_said(res: Result, spoken: Spoken) -> bool:
    """Whether the last sample is refuted again, of a monitor by the test that its run names."""
    if not isinstance(res, MonitorResult) or spoken.test not in res.names:
        return bool(res.status[-1] == Status.FAULT)
    status = int(res.statuses[-1, res.names.index(spoken.test)])
    if spoken.status == Status.FAULT.name:
        return status == Status.FAULT
    return status != Status.MISSING
