"""Tuned bounds: the model file that gets them, and their description on the terminal and as JSON."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxbound.cli.fit_summary import promise
from jaxbound.cli.terminal import Conclusion, Row, Table
from jaxbound.models.modelfile import changed_text, number_text
from jaxbound.models.statedtests import StatedTest
from jaxbound.studies.tuning.tuning import MonitorTuneResult, TuneResult

if TYPE_CHECKING:
    from optax import GradientTransformation

OPTIMIZERS = ("adam", "adabelief", "adagrad", "lion", "nadam", "rmsprop", "sgd", "yogi")
MARK = b"# The search was interrupted: the same command goes on and replaces this file. %s\n"
TUNED = "scale factor left_out safety bounds smallest start steps stopped caught notes".split()
"""Fields of a `TuneResult` that JSON has as they are."""
RATE = 0.1  # of the first step, on the logarithms of the bounds


def tuned_text(tuning: TuneResult | MonitorTuneResult, text: str, tests: Sequence[StatedTest]) -> bytes:
    """Return the text of a model file with the bounds that were found; its comments stay.

    That of an interrupted search begins with a line by which the next call knows that nobody has changed it.

    Args:
        tests: of the file, also those that were not tuned.
    """
    found = {test.name: test for test in tuning.model.tests}
    model = tuning.model.replace(tests=[found.get(test.name, test) for test in tests])
    tuned = changed_text(text, model).encode()
    if isinstance(tuning, TuneResult) and tuning.stopped:
        return _mark(tuned) + tuned
    return tuned


def is_unfinished(path: Path) -> bool:
    """Return whether a file is as an interrupted search has left it."""
    if not path.is_file():
        return False
    # by its digest: a file that somebody has edited since is not replaced
    content = path.read_bytes()
    text = content.split(b"\n", 1)[-1]
    return content == _mark(text) + text


def _mark(text: bytes) -> bytes:
    return MARK % hashlib.sha256(text).hexdigest().encode()


def optimizer(name: str, steps: int) -> "GradientTransformation | None":
    """Return an optax optimiser by name, with a step that falls to nothing; None for the default one.

    Raises:
        ValueError: another name.
    """
    if name not in OPTIMIZERS:
        raise ValueError(f"--optimizer must be one of {', '.join(OPTIMIZERS)}, not {name!r}")
    if name == "adam" or not steps:
        return None
    import optax

    return getattr(optax, name)(optax.cosine_decay_schedule(RATE, steps))


@dataclass(frozen=True)
class FactorConclusion(Conclusion):
    """The conclusion of a monitor's search: a factor for each test."""

    tuning: MonitorTuneResult

    @property
    def headline(self) -> str:
        """The name of the model."""
        return f"{self.tuning.model.name}: one factor a test"

    def plain(self) -> dict[str, Any]:
        """Return the factors, and of each test that watches something what it rests on."""
        tuning = self.tuning
        tests: dict[str, dict[str, Any]] = {}
        for name, factor in tuning.factors.items():
            tests[name] = {"start": float(tuning.start[name]), "factor": float(factor)}
            one = tuning.tests.get(name)
            if one is not None:
                tests[name] |= {
                    "scale": one.scale,
                    "left_out": one.left_out,
                    "healthy": one.counts,
                    "faulty": one.faulty_counts,
                    "caught": one.caught,
                    "text": one.statement,
                }
        return {
            "out": str(self.written[0]),
            "tests": tests,
            "healthy": tuning.counts,
            "faulty": tuning.faulty_counts,
            "caught": tuning.caught,
            "notes": tuning.notes,
            "hints": self.hints,
        }

    def table(self) -> Iterator[Sequence[str]]:
        """Yield the factors of each test."""
        tuning = self.tuning
        yield "test", "factor", "smallest", "left out", "written", "healthy", "caught"
        for name, factor in tuning.factors.items():
            one = tuning.tests.get(name)
            start, new = f"{float(tuning.start[name]):.6g}", number_text(factor)
            if one is None:
                yield name, start, "", "", new, "it watches nothing", ""
                continue
            smallest = f"{one.scale * float(tuning.start[name]):.6g}"
            caught = ""
            if one.caught is not None:
                caught = f"{one.caught:.1%}"
            healthy = _counts_text(one.counts)
            yield name, start, smallest, f"{one.factor:.3g}", new, healthy, caught

    def rows(self) -> Iterator[Row]:
        """Yield the counts of all tests together."""
        return _counted_rows(self.tuning, "samples, by the monitor")


@dataclass(frozen=True)
class TuneConclusion(Conclusion):
    """The conclusion of a search for bounds. Fields: tuning; healthy: the files they were tuned to."""

    tuning: TuneResult
    healthy: Sequence[Path]

    @property
    def headline(self) -> str:
        """The name of the model."""
        return f"{self.tuning.model.name}: bounds tuned"

    def plain(self) -> dict[str, Any]:
        """Return the bounds that were found, and what they rest on."""
        tuning, risk = self.tuning, self.tuning.risk
        return {
            "out": str(self.written[0]),
            "horizon": tuning.relations.horizon,
            **{name: getattr(tuning, name) for name in TUNED},
            "healthy": tuning.counts,
            "faulty": tuning.faulty_counts,
            "least_margin": float(np.nanmin(tuning.margin)),
            "risk": {
                "blocks": risk.blocks,
                "windows_in_a_block": risk.length,
                "average": risk.average,
                "rate": risk.rate,
                "confidence": risk.confidence,
                "guide_only": risk.guide,
                "text": risk.text,
            },
            "hints": self.hints,
        }

    def table(self) -> Table:
        """Return the bounds that moved."""
        return [("bound", "start", "smallest", "written"), *_moved_bounds(self.tuning)]

    def rows(self) -> Iterator[Row]:
        """Yield the counts and factors that the bounds rest on."""
        tuning = self.tuning
        reason = "no smaller ones in this direction explain the healthy data"
        safety = f"{tuning.safety:g} times these bounds"
        if tuning.safety <= 1:
            safety += " (none)"
        window = f"windows of {tuning.relations.horizon + 1} samples, by the proved test"
        if tuning.relations.remembers:
            window = "samples, by the observer"
        yield "scale", f"{tuning.scale:.9g} times the starting bounds: {reason}"
        for file, factor in zip(self.healthy, tuning.left_out, strict=False):  # a single one is not left out
            text = "unknown: it, or the others, hold no window"
            if np.isfinite(factor):
                text = f"{factor:.3g} times the smallest bounds of the others"
            yield f"left out: {file}", text
        known = int(np.isfinite(tuning.left_out).sum())
        if known:
            yield "promise", promise(tuning.factor, known)
        yield "safety", safety
        elsewhere = ("steps", str(tuning.steps)), ("elsewhere", tuning.statement)
        yield from _counted_rows(tuning, window, elsewhere)


def _counted_rows(
    tuning: TuneResult | MonitorTuneResult, what: str, more: Sequence[Row] = ()
) -> Iterator[Row]:
    """Yield the counts of healthy and of faulty recordings, more, and notes. what: is counted."""
    yield "healthy", f"{_counts_text(tuning.counts)} {what}"
    if tuning.faulty_counts:
        yield "faulty", f"{_counts_text(tuning.faulty_counts)}: {tuning.caught:.1%} proved faulty"
    yield from more
    yield from (("note", note) for note in tuning.notes)


def _counts_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {name}" for name, n in counts.items() if n)


def _moved_bounds(tuning: TuneResult) -> Iterator[tuple[str, str, str, str]]:
    """Yield (name, start, smallest, written), texts: of every bound that moved."""
    model, relations = tuning.model, tuning.relations
    signals = {
        "tolerance": model.outputs,
        "noise": model.outputs,
        "disturbance": tuple(f"w{j + 1}" for j in range(model.g)),
    }
    exact: dict[str, Sequence[Fraction | tuple[Fraction, Fraction]]]
    exact = {"tolerance": model.tolerance, "noise": model.noise, "disturbance": model.disturbance}
    parameters = tuple(u.name for u in model.uncertainties)
    for kind, bounds in relations.bounds.items():
        for i, signal in enumerate(signals.get(kind, parameters)):
            name = f"{kind} of {signal}"
            if not any(moved.endswith(name) for moved in tuning.names):
                continue
            written = exact[kind][i] if kind in exact else Fraction(repr(float(bounds[i])))
            start, smallest = tuning.start[kind][i], tuning.smallest[kind][i]
            yield name, _rounded_text(start), _rounded_text(smallest), _exact_text(written)


def _rounded_text(bound: np.ndarray | jax.Array) -> str:
    """Return a bound, or its two ends, with six digits."""
    return " to ".join(f"{end:.6g}" for end in np.ravel(bound))


def _exact_text(bound: Fraction | tuple[Fraction, Fraction]) -> str:
    """Return a bound, or its two ends, as the model file has it."""
    if isinstance(bound, Fraction):
        return number_text(bound)
    return " to ".join(map(number_text, bound))
