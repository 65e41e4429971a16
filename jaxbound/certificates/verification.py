"""Certificates against the model and the recording that they are to be about: read here, checked by
`checker`, without JAX.
"""

from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.certificates.checker.claim import claimed
from jaxbound.certificates.checker.proof import confirm
from jaxbound.certificates.checker.script import fewer_averages, stated_lags
from jaxbound.certificates.plain import plain_model, plain_names, plain_samples
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording

__all__ = ["verify", "window_of"]


def verify(
    document: dict[str, Any], model: LinearSystem, u: Any, y: Any = None, x0: Any = None, begin: int = 0
) -> None:
    """Raise an exception unless a certificate proves what it says of this model and this recording.

    The inequalities are built anew from both, in exact fractions. Of the certificate only multipliers or a
    witness are used; all else that it shows must be what model and recording say.

    Args:
        document: what `to_dict` of a certificate returned, or JSON of it. model: the plant with its bounds.
        u, y: the recording, as `detect` takes it. x0: bounds of the first state, as an observer took them;
            None: none.
        begin: number of the first sample in u and y, where they are cut out of a longer recording.

    Raises:
        ValueError: it proves something else, or nothing; says what differs. ArithmeticError, LookupError,
            TypeError: it is damaged.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10")
        >>> c = jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1)
        >>> verify(c.to_dict(), m, None, [[1.0], [0.8]])
        >>> verify(c.to_dict(), m, None, [[1.0], [0.5]])
        Traceback (most recent call last):
        ValueError: the certificate is about something else: numbers.y[1][0] is 0.8, model and data say 1/2
    """
    sample, last, count = window_of(document)
    recording = Recording.of(model, u, y)
    place = tuple(sample[:-1]) if isinstance(sample, list) else ()
    stop = last - begin + 1
    if len(place) != recording.y.ndim - 2 or not 0 <= stop - count < stop <= recording.y.shape[-2]:
        raise ValueError(f"the recording has no {count} samples that end at sample {last}")
    if recording.across(count - 1)[stop - 1]:
        raise ValueError(
            f"the {count} samples that end at sample {last} do not follow each other: there is a gap among "
            f"them"
        )
    first = None
    if "first_state" in document["numbers"]:
        if x0 is None or stop - count != 0 or begin != 0:
            raise ValueError(
                "bounds of a first state count at the first sample of the recording only, and must be given: "
                "x0"
            )
        first = [
            [Fraction(float(lo)), Fraction(float(hi))]
            for lo, hi in zip(np.asarray(x0.lo), np.asarray(x0.hi), strict=True)
        ]
    given, part = plain_model(model), slice(stop - count, stop)
    inputs, outputs = (plain_samples(np.asarray(x)[place][part]) for x in (recording.u, recording.y))
    precision, lags = str(recording.y.dtype), stated_lags(document, given)
    claim = claimed(fewer_averages(document, given), inputs, outputs, precision, lags, first)
    shown = document["names"]["times"]
    times = None if shown is None else [recording.label(j) for j in range(part.start, part.stop)]
    confirm(document, plain_names(model, sample, times), claim)


def window_of(document: dict[str, Any]) -> tuple[int | list[int], int, int]:
    """Return (what a certificate calls its sample, the number of its last sample, how many samples its window
    has).

    Raises:
        ValueError: a certificate of something else than a window of a LinearSystem.
    """
    if "question" in document:
        raise ValueError(
            "this is a certificate about sets, which holds its question: no model or recording belongs to it"
        )
    if "box" in document["numbers"]:
        raise ValueError(
            "this is a certificate of a residual, which is a program of its user: nobody but that program "
            "can check it"
        )
    sample = document["names"]["sample"]
    whole = sample if isinstance(sample, list) else [sample]
    if not whole or any(type(i) is not int or i < 0 for i in whole):
        raise ValueError(f"the certificate names no sample: {sample!r}")
    return sample, whole[-1], len(document["numbers"]["y"])
