"""The command `jaxbound explain`: the certificate of one window of a report, for people and as JSON.

Only the samples of that window are read again (a CSV file: all), tested as they were, and proved anew in
exact rationals.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxbound.certificates.interface import certify
from jaxbound.certificates.uncertain_certificate import UncertainCertificate
from jaxbound.cli.terminal import LOUDNESS, VERBOSE, door, show, write
from jaxbound.cli.window import OBSERVER
from jaxbound.estimation.observer import observer
from jaxbound.models.rows import Kind
from jaxbound.recordings.read import open_source
from jaxbound.relations.parity import parity_relations
from jaxbound.relations.sentence import main_terms, row_name
from jaxbound.runs.contradiction import refuted_again
from jaxbound.runs.outputs import output_folder
from jaxbound.runs.refusals import Refused
from jaxbound.runs.runfile import VALIDATION, load_run
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent
from jaxbound.text.quantities import times as factor_text

__all__ = ["certificate_of", "readable", "run"]


def certificate_of(directory: str | Path, at: str) -> tuple[Any, int, list[str]]:
    """Return (Certificate, sample number, labels of the times of the window) of one window of a report.

    Args:
        directory: that `jaxbound detect` wrote. at: the sample at which the window ends, as text: its number,
            or its time.

    Raises:
        OSError, ValueError, NotImplementedError: with a sentence for the user.
    """
    return _certified(directory, at)[:3]


def _certified(directory, at):
    """Return what `certificate_of` does, and a sentence, or "", where the number that was asked for could be
    meant as a time.
    """
    model, data, method, horizon, options = load_run(Path(directory))
    if method == VALIDATION:
        raise ValueError(
            f"{directory} was validated, where a verdict rests on all samples before it: there is a "
            f"certificate of a window "
            "only by other methods: jaxbound detect --method joint, to another folder"
        )
    source = open_source(data, model)
    axis = _Axis(source)
    k = axis.find(at)
    if k < horizon:
        raise ValueError(
            f"sample {k} is too early: the first window ends at sample {horizon}, {axis.label(horizon)}"
        )
    try:
        if method == OBSERVER:
            found, part = refuted_again(observer(model, **options), source, k)
        else:
            relations, part = (
                parity_relations(model, horizon if model.lags is None else None),
                source.read(k - horizon, k + 1),
            )
            if part.across(horizon)[horizon]:
                raise ValueError("a window across a gap in time is MISSING")
            found = certify(relations, part.u, part.y, method)
    except ValueError as e:
        raise ValueError(f"{axis.label(k)} (sample {k}): {e}") from None
    labels = [part.label(j) for j in range(part.samples - found.window.horizon - 1, part.samples)]
    return found, k, labels, axis.also_a_time(at)


class _Axis:
    """The samples of a Source by number and by time; only those that are asked for are read, where it can."""

    def __init__(self, source):
        self.source, self.samples = source, source.samples
        self.stamped = self._one(0).stamps is not None

    def label(self, k):
        """Return the time of sample k as text."""
        return self._one(k).label(0)

    def find(self, text):
        """Return the number of the sample that a text names: a whole number is a sample, anything else a
        time.
        """
        text = text.strip()
        if text.removeprefix("-").isdecimal():
            if not 0 <= int(text) < self.samples:
                other = f"; for the time write --at {text}s" if self.also_a_time(text) else ""
                raise ValueError(
                    f"there is no sample {text}: the recording has {self.samples}, numbered from 0{other}"
                )
            return int(text)
        if (k := self.source.find(text)) is not None:
            return k
        wanted = self._parsed(text)
        low, high = 0, self.samples - 1  # the last sample that is not later
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._time(middle) <= wanted else (low, middle - 1)
        near = min((k for k in (low, low + 1) if k < self.samples), key=lambda k: abs(self._time(k) - wanted))
        step = abs(self._time(self.samples - 1) - self._time(0)) / max(self.samples - 1, 1)
        if abs(self._time(near) - wanted) > step / 2:
            ends = f"the recording runs from {self.label(0)} to {self.label(self.samples - 1)}"
            raise ValueError(f"no sample lies at {text}: the nearest is at {self.label(near)}; {ends}")
        return near

    def also_a_time(self, text):
        """Return a sentence where the number of a sample is a time of the recording, too, and of another
        sample; else "".
        """
        text = text.strip()
        if not text.isdecimal() or self.stamped or not self.label(0).endswith(" s"):
            return ""
        if (
            not self._time(0) <= int(text) <= self._time(self.samples - 1)
            or self.label(min(int(text), self.samples - 1)) == f"{text} s"
        ):
            return ""
        return f"sample {text}; for the time write --at {text}s"

    def _parsed(self, text):
        try:
            if self.stamped:
                return np.datetime64(text.replace(" ", "T").removesuffix("Z"), "ns")
            return float(text.removesuffix("s"))
        except ValueError:
            like = f"its time as alarms.csv has it, like {self.label(0)}"
            raise ValueError(f"--at {text} names no sample: give its number, or {like}") from None

    def _time(self, k):
        return self._one(k).axis[0]

    def _one(self, k):
        return self.source.read(k, k + 1)


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound explain DIR --at TIME [--json]`; return the exit code.

    Prints the certificate readably and writes it to DIR/certificate-SAMPLE.json; with --json, prints that
    JSON and writes nothing.
    """
    with door():
        certificate, k, labels, asked = _certified(args.report, args.at)
        text = certificate.to_json(labels, k)
    if args.json:
        write(text + "\n")
        return 0
    path = args.report / f"certificate-{k}.json"
    try:
        with door(OSError), output_folder(args.report) as folder, folder.work() as work:
            (work / path.name).write_text(text + "\n", encoding="utf-8")
    except Refused as e:
        raise Refused(f"{e}; --json prints the certificate instead") from e
    whole = args.all or LOUDNESS.get() == VERBOSE
    headline, rows, table = readable(certificate, k, labels)
    if not whole:
        rows = [(name, main_terms(text)) for name, text in rows]
        rows.append(
            (
                "all of it",
                f"--all: every coefficient, and what the {len(labels)} samples say, {len(table) - 1} rows",
            )
        )
    if asked:
        rows.insert(0, ("asked for", asked))
    show(headline, "bold", [*rows, ("certificate", str(path))], table if whole else None, last=True)
    return 0


def readable(
    certificate: Any, k: int, labels: Sequence[str]
) -> tuple[str, list[tuple[str, str]], list[tuple[str, ...]]]:
    """Return (headline, rows of (name, text), table with its header first) of a certificate, for people."""
    c, model = certificate, certificate.window.model
    unit = lambda name: f" {model.unit(name)}" if model.unit(name) else ""
    fault = c.proves == Status.FAULT
    status = "" if c.status == c.proves else f" ({c.status.name} for the method of the report)"
    headline = f"{c.proves.name} proved: the window from {labels[0]} to {labels[-1]}, sample {k}{status}"
    if isinstance(c, UncertainCertificate):
        rows = _uncertain(c, unit)
    elif fault:
        rows = [
            ("violated", c.relation),
            ("", f"is {number(c.residual)} at the samples, and the bounds allow ± {number(c.width)}"),
            (
                "bounds needed",
                f"{'at least ' if c.window.constant else ''}{factor_text(float(c.factor))} the stated ones",
            ),
        ]
        for name, e in c.errors.items():
            said = (
                "no error of this sensor alone explains the window"
                if e == math.inf
                else (
                    f"an error of {number(e)}{unit(name)} of this sensor alone would explain the window, no "
                    f"smaller one: the least, "
                    "not the size of the fault"
                )
            )
            rows.append((f"{name} wrong?", said))
        rows += [
            (
                f"{name} wrong?",
                "an actuator that did something else than was recorded would alone explain the window",
            )
            for name in c.candidates
            if name in model.inputs
        ]
    else:
        state = ", ".join(
            f"{name} {number(x)}{unit(name)}" for name, x in zip(model.states, c.state, strict=True)
        )
        rows = [
            ("tightest", c.relation),
            ("", f"{percent(float(c.factor))} of the bounds are used"),
            ("first state", state),
        ]
        if model.g:
            rows.append(("disturbance", "; ".join(", ".join(map(number, row)) for row in c.disturbances)))
        if model.d:
            rows.append(("unknown input", "; ".join(", ".join(map(number, row)) for row in c.unknown_inputs)))
    return headline, rows, _samples(c, labels)


def _uncertain(c, unit):
    """Return the rows (name, text) of a certificate of a model with uncertain parameters."""
    if c.z is None:
        rows = [
            (
                "violated",
                c.relation
                or f"a combination of relations in each of {len(c.leaves)} parts of the parameters' box",
            )
        ]
        if len(c.leaves) == 1:
            (leaf,) = c.leaves
            rows.append(
                (
                    "",
                    f"is in [{number(leaf.low)}, {number(leaf.high)}] at these samples, whatever the "
                    f"parameters",
                )
            )
        return rows
    s = c.relations.horizon
    at = lambda lag: "" if lag is None else f"[k-{s - lag}]" if lag < s else "[k]"
    rows = [
        ("parameters", ", ".join(f"{name}{at(lag)} {number(x)}" for (name, lag), x in c.parameters.items()))
    ]
    model = c.window.model
    return [
        *rows,
        (
            "first state",
            ", ".join(f"{n} {number(x)}{unit(n)}" for n, x in zip(model.states, c.state, strict=True)),
        ),
    ]


def _samples(c, labels):
    """Return the table of the samples: what was read, what it says of the true value, and its part in the
    proof.
    """
    w, model = c.window, c.window.model
    if c.z is None and isinstance(c, UncertainCertificate):
        rows: list[tuple[str, ...]] = [("time", "signal", "reading", "true value from", "to")]
        for (j, i), y, x in zip(np.ndindex(len(labels), model.p), w.y, w.limits, strict=False):
            ends = ("", "") if x is None else [number(end + model.offset["y"][i]) for end in x]
            rows.append((labels[j], model.outputs[i], "missing" if y is None else number(y), *ends))
        return rows
    last = "coefficient" if c.z is None else "explained by"
    rows, limits = [("time", "signal", "reading", "true value from", "to", last)], w.limits
    for j, label in enumerate(labels):
        for i, name in enumerate(model.outputs):
            row, offset = j * model.p + i, model.offset["y"][i]
            part = number(c.h[row]) if c.z is None else number(c.outputs[j][i])
            if w.y[row] is None:
                rows.append((label, name, "missing", "", "", part if c.z is not None else ""))
            elif c.z is not None or c.h[row]:
                lo, hi = limits[row]
                rows.append((label, name, number(w.y[row]), number(lo + offset), number(hi + offset), part))
        for i, name in enumerate(model.inputs):
            row = j * model.m + i
            if row < len(w.u) and (c.z is not None or c.k[row]):
                part = number(-c.k[row]) if c.z is None else number(c.inputs[j][i])
                rows.append((label, name, "missing" if w.u[row] is None else number(w.u[row]), "", "", part))
    if c.z is None:
        for x, row, ends in zip(c.h, w.rows, limits, strict=True):
            if x and row.kind is not Kind.READING:
                lo, hi = ends
                rows.append((labels[row.last], row_name(model, row), "", number(lo), number(hi), number(x)))
    return rows


def number(x: Any) -> str:
    """Return an exact number as a reader wants it: the smallest normal number, which widens every radius, is
    nothing.
    """
    return f"{float(x) if abs(x) > 1e-300 else 0.0:.6g}"
