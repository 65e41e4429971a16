"""Certificates against the model and the recording that they are to be about: read here, checked by
`checker`, without JAX.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from jaxbound.certificates.checker.command import against
from jaxbound.certificates.checker.words import Matrix
from jaxbound.certificates.plain import (
    plain_factors,
    plain_model,
    plain_names,
    plain_samples,
)
from jaxbound.models.region import factors_outside
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import model_of, with_tests
from jaxbound.models.watched import NO, UNKNOWN, modes_at
from jaxbound.recordings.factors import known, masked
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status


def verify(
    document: dict[str, Any], model: LinearSystem, u: Any, y: Any = None, x0: Any = None, begin: int = 0
) -> None:
    """Raise an exception unless a certificate proves what it says of this model and this recording.

    The inequalities are built anew from both, in exact fractions. Of the certificate only multipliers or a
    witness are used; all else that it shows must be what model and recording say.

    Args:
        document: what `to_dict` of a certificate returned, or JSON of it. model: the plant with its bounds;
            of a certificate of a monitor with its tests, of which it names one.
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
    sample, last, count = named_window(document)  # refuses what nobody can check
    document, tested = of_test(document, model)
    recording = Recording.of(tested.recorded, u, y)
    place: tuple[int, ...] = ()
    if isinstance(sample, list):
        place = tuple(sample[:-1])
    stop = last - begin + 1
    start = stop - count
    if len(place) != recording.y.ndim - 2 or not 0 <= start < stop <= recording.y.shape[-2]:
        raise ValueError(f"the recording has no {count} samples that end at sample {last}")
    if recording.across(count - 1)[stop - 1]:
        raise ValueError(
            f"the {count} samples that end at sample {last} do not follow each other: there is a gap among "
            f"them"
        )
    first: Matrix | None = None
    if "first_state" in document["numbers"]:
        if x0 is None or start != 0 or begin != 0:
            raise ValueError(
                "bounds of a first state count at the first sample of the recording only, and must be given: "
                "x0"
            )
        first = _bounds_of_state(x0)
    plain, model = plain_model(tested.model), tested.model
    u = np.asarray(recording.u)[place][start:stop]
    tested.insist_watched(u, document["certificate"], [recording.label(j) for j in range(start, stop)])
    u = u[:, [known(tested.recorded).index(name) for name in known(model)]]
    # factors on noise stand behind the inputs, and are no inputs of the plant
    inputs, factors = plain_samples(u[:, : model.m]), plain_factors(model, u)
    # where a factor is missing its output says nothing: as detect takes it
    outputs = plain_samples(masked(model, u, np.asarray(recording.y)[place][start:stop]))
    times = None
    if document["names"]["times"] is not None:
        times = [recording.label(j) for j in range(start, stop)]
    names = plain_names(model, sample, times)
    try:
        against(document, plain, inputs, outputs, str(recording.y.dtype), names, first, factors)
    except ValueError as e:
        if not factors_outside(model) or document["certificate"] == Status.FAULT.name:
            raise
        raise ValueError(
            f"{e}: of windows outside training that only the wider bounds there explain, extrapolation "
            f"{float(factors_outside(model)[0]):g}, nothing is confirmed"
        ) from None


@dataclass(frozen=True, eq=False)
class Tested:
    """The subject of a certificate. Fields: model: the plant with the bounds of its test. recorded: the model
    by which recordings are read. conditions: of all tests of it; when: of this test, None: it always watches.
    name: of this test.
    """

    model: LinearSystem
    recorded: LinearSystem
    conditions: tuple[str, ...] = ()
    when: str | None = None
    name: str = ""

    def insist_watched(self, u: np.ndarray, verdict: str, labels: Sequence[str]) -> None:
        """Raise ValueError unless the condition of the test holds at all samples of a window.

        Where nobody knows it, a behaviour that explains is one of the mode of the test, while a FAULT of one
        test proves nothing: another mode may hold.

        Args:
            u: (s + 1, .), as recorded. verdict: of the certificate. labels: the times of the samples.
        """
        if self.when is None:
            return
        own = modes_at(self.recorded, self.conditions, u)[:, self.conditions.index(self.when)]
        for mode, why in ((NO, "does not hold"), (UNKNOWN, "has no value, so that another mode may hold,")):
            if mode in own and (mode == NO or verdict == Status.FAULT.name):
                where = labels[own.tolist().index(mode)]
                raise ValueError(f"test {self.name!r} watches when {self.when}, which {why} at {where}")


def of_test(document: dict[str, Any], model: LinearSystem) -> tuple[dict[str, Any], Tested]:
    """Return (a certificate without the name of its test, its subject): of a model without tests that
    model, whatever its monitor called the windows.

    Raises:
        ValueError: the model states no such test; it states tests, and the certificate names none.
    """
    if "test" not in document:
        if model.tests:
            raise ValueError(
                "the certificate names no test, and the model states tests with bounds of their own: of a "
                "report give tested_model.toml in its folder, of other windows the model without its tests"
            )
        return document, Tested(model, model)
    certificate = dict(document)
    name = certificate.pop("test")
    if not model.tests:
        return certificate, Tested(model, model)
    conditions = tuple(dict.fromkeys(test.when for test in model.tests if test.when is not None))
    for test in model.tests:
        if test.name == name:
            own = model_of(model, test)
            return certificate, Tested(own, with_tests(model), conditions, test.when, test.name)
    raise ValueError(f"the certificate is of test {name!r}, which the model does not state")


def _bounds_of_state(x0: Any) -> Matrix:  # an Interval of any kind, from a user
    """Return [lo, hi] of each state."""
    pairs = plain_samples(np.stack([np.asarray(x0.lo), np.asarray(x0.hi)], axis=-1))
    if any(None in pair for pair in pairs):
        raise ValueError("bounds of a first state must be numbers, not NaN")
    return cast(Matrix, pairs)


def named_window(document: dict[str, Any]) -> tuple[int | list[int], int, int]:
    """Return (the sample that a certificate names, the number of its last sample, how many samples its window
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
    whole = sample
    if not isinstance(sample, list):
        whole = [sample]
    if not whole or any(type(i) is not int or i < 0 for i in whole):
        raise ValueError(f"the certificate names no sample: {sample!r}")
    return sample, whole[-1], len(document["numbers"]["y"])
