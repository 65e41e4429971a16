"""The certificate of one window of a report, proved anew from its samples in exact rationals."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.certificates.interface import certify
from jaxbound.cli.window import Step
from jaxbound.consistency.interface import FAMILIES, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.hints import outgrown_by
from jaxbound.models.region import Region
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.sample_axis import SampleAxis
from jaxbound.runs.ask import Ask
from jaxbound.runs.contradiction import NOBODY, Spoken, refuted_again
from jaxbound.runs.runfile import VALIDATION, is_outgrown, load_run
from jaxbound.runs.verdictfiles import spoken_of
from jaxbound.sets.floats.status import Status
from jaxbound.text.names import listed, quoted


@dataclass(frozen=True)
class Explained:
    """The certificate of one window of a report.

    Fields:
        certificate: that `certify` gives. sample: the last of the window. labels: the times of its samples.
        outgrown: its bounds were found from data for shorter windows, so that a FAULT proves no fault.
        training: whether its inputs lie in the region of training, in words; "": the model states no ranges.
        ambiguity: a sentence, or "", where the number that was asked for could be meant as a time.
    """

    certificate: Any
    sample: int
    labels: list[str]
    outgrown: bool
    training: str
    ambiguity: str


def explain_window(directory: str | Path, at: str, step: Step, test: str | None = None) -> Explained:
    """Return the certificate of one window of a report.

    Args:
        directory: that `jaxbound detect` wrote. at: the sample at which the window ends, as text: its number,
            or its time. step: told of progress, by "relations" and "proof". test: of a monitor, the name of
            the one to ask; None: the one that spoke.

    Raises:
        OSError, ValueError, NotImplementedError: with a sentence for the user.
    """
    model, data, method, horizon, options = load_run(Path(directory))
    if method == VALIDATION:
        raise ValueError(
            f"{directory} was validated, where a verdict rests on all samples before it: there is a "
            f"certificate of a window only by other methods: jaxbound detect --method windows, to another "
            f"folder"
        )
    ask = Ask(method, _asked_horizon(model, method, horizon), options=options)
    known = [one.name for one in model.tests]
    if test is not None and test not in known:
        there = "it is of one test without a name"
        if known:
            there = f"it has {listed(known)}"
        raise ValueError(f"there is no test {quoted(test)} in this report: {there}")
    source = open_source(data, ask.recorded(model))
    axis = SampleAxis(source)
    k = axis.find(at)
    if k < horizon:
        raise ValueError(
            f"sample {k} is too early: the first window ends at sample {horizon}, {axis.label(horizon)}"
        )
    try:
        relations = ask.relations(model, lambda share: step("relations", share))
        step("proof", 0.0)
        if method in (OBSERVER, MONITOR):
            spoken = NOBODY
            if method == MONITOR:
                spoken = spoken_of(Path(directory), k)
            if test is not None:  # all that is needed to see it refuted is read, or all there is
                spoken = Spoken(Status.FAULT.name, test)
            certificate, part = refuted_again(relations, source, k, spoken)
        else:
            part = source.read(k - horizon, k + 1)
            if part.across(horizon)[horizon]:
                raise ValueError("a window across a gap in time is MISSING")
            certificate = certify(relations, part.u, part.y)
    except ValueError as e:
        raise ValueError(f"{axis.label(k)} (sample {k}): {e}") from None
    # an observer read more than the certificate needs: the labels are of its window
    first = part.samples - certificate.window.horizon - 1
    labels = [part.label(j) for j in range(first, part.samples)]
    beyond = is_outgrown(Path(directory))
    if certificate.test:  # the bounds are its own
        beyond = outgrown_by(relations, certificate.test)
    training = _training(relations, part, certificate.test)
    return Explained(certificate, k, labels, beyond, training, axis.also_a_time(at))


def _training(relations: Relations, part: Recording, test: str) -> str:
    """Return whether the window that ends with a recording lies in the region of training, in words. test: of
    a monitor the name of the one that it is of.
    """
    region = Region.of(relations)
    if region is None:
        return ""
    u = np.asarray(part.u, np.float64)
    words = region.departure(u, np.zeros(len(u), bool)).words(-1, test)
    if words:
        return f"outside it: {words}"
    return "its inputs are within the ranges of training"


def _asked_horizon(model: LinearSystem, method: str, horizon: int) -> int | None:
    """Return the horizon that makes the relations of a run anew, from the horizon that they had."""
    if method in (OBSERVER, MONITOR):
        return None  # its options have one where the user gave one
    if model.lags is not None and method not in FAMILIES:
        return None  # the lags of the model say how long a window is
    return horizon
