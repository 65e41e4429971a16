"""A fitted model on the terminal and as JSON, and the signals that --inputs and --outputs name."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from jaxbound.cli.names import parted, unquoted
from jaxbound.cli.terminal import Conclusion, Row
from jaxbound.cli.tradeoff_table import disturbance_rows
from jaxbound.diagnosis.memory import slowest, suggest_lags
from jaxbound.models.region import text_outside
from jaxbound.recordings.expressions import CLOCK, expression
from jaxbound.studies.identification.fit_result import FitCheck, Fitted
from jaxbound.studies.identification.signal_choice import GIVEN
from jaxbound.studies.identification.trial import few_days
from jaxbound.studies.identification.window_tests import RAMP, JudgedTest, best_test
from jaxbound.text.units import without_unit

CHECKED = (
    "order delay method smallest safety factor left_out held_out signals smallest_mean tradeoff jump steady "
    "hidden"
).split()
"""Fields of a `FitCheck` that JSON has as they are."""
WIDEST = "recording sample when share where span rest cost missing stepping".split()
"""Fields of a `Widest` that JSON has as they are."""
Signal = str | tuple[str, str]  # a column of that name, or (name, column)
MEMORY = 1.5  # times the window that a plant must remember before longer windows are spoken of
SHOWN = 4
"""Sets of inputs that were not taken and are shown."""
ASSIGNED = re.compile(r"\s*([^=<>!`'\"]+?)\s*=(?!=)\s*(.+?)\s*")


def signal_columns(option: str, text: str) -> list[Signal]:
    """Return the signals of an option: names, or (name, column) where it says name=column or name=expression.

    Raises:
        ValueError: an empty entry.

    Example:
        >>> signal_columns("--inputs", "fan, lift=Tsup - `T mixed`, T1=Temperature 1")
        ['fan', ('lift', '= Tsup - `T mixed`'), ('T1', 'Temperature 1')]
    """
    if not text.strip():
        return []
    entries = parted(text)
    if not all(entries):
        raise ValueError(
            f"{option} needs names, or name=column or name=expression, with commas between them: {text!r} "
            f"has an empty entry"
        )
    return list(map(_signal_column, entries))


def named_units(
    inputs: list[Signal], outputs: list[Signal]
) -> tuple[list[Signal], list[Signal], dict[str, str]]:
    """Return (inputs, outputs, {signal: unit}): a column "T [degC]" is a signal T, if no other is.

    Example:
        >>> named_units(["Pump [%]"], [("T1", "Room (degC)"), "flow"])
        ([('Pump', 'Pump [%]')], [('T1', 'Room (degC)'), 'flow'], {'Pump': '%', 'T1': 'degC'})
    """
    signals = [*inputs, *outputs]
    bare = [without_unit(signal)[0] if isinstance(signal, str) else signal[0] for signal in signals]
    named: list[Signal] = []
    units = {}
    for signal, name in zip(signals, bare, strict=True):
        column = signal if isinstance(signal, str) else signal[1]
        unit = without_unit(column)[1]
        if not unit or bare.count(name) > 1:
            named.append(signal)
            continue
        named.append((name, column))
        units[name] = unit
    return named[: len(inputs)], named[len(inputs) :], units


def _signal_column(entry: str) -> Signal:
    """Read one entry of --inputs or --outputs."""
    if assigned := ASSIGNED.fullmatch(entry):
        name, column = assigned.groups()
        return name, _column_entry(column)
    if entry in CLOCK:
        return entry, f"= {entry}"
    return unquoted(entry)


def _column_entry(text: str) -> str:
    """Return the entry of a model file for a signal: "= expression", or the name of a column, which may have
    blanks in it.
    """
    if unquoted(text) != text:
        return unquoted(text)
    try:
        expression(text)
    except ValueError:
        return text
    if text.isidentifier() and text not in CLOCK:
        return text
    return f"= {text}"


@dataclass(frozen=True)
class FitConclusion(Conclusion):
    """The conclusion of a fit. Fields: model. files: the recordings that it was fitted to."""

    model: Fitted
    files: Sequence[Path]

    @property
    def headline(self) -> str:
        """The name of the model, and to how many recordings it was fitted."""
        count = len(self.model.check.recordings)
        return f"{self.model.name}: fitted to {count} recording{'s' * (count > 1)}"

    def plain(self) -> dict[str, Any]:
        """Return the knowledge of the fit beside that of its model."""
        model, check = self.model, self.model.check
        recordings = []
        for file, numbers in zip(self.files, check.recordings, strict=True):
            recordings.append({"data": str(file)} | numbers)
        return {
            "out": str(self.written[0]),
            "horizon": model.horizon,
            "states": model.n,
            "dt": model.dt,
            "noise": _bounds_by_output(model, model.noise),
            "resolution": _bounds_by_output(model, model.resolution),
            **{name: getattr(check, name) for name in CHECKED},
            "follow": check.follows,
            "widest": check.widest and {name: getattr(check.widest, name) for name in WIDEST},
            "average": _average(check),
            "inputs": model.inputs,
            "tests": [_plain_test(test, model) for test in check.tests],
            "means": {a.signal: float(a.bound) for a in model.averages},
            "disturbance": [float(high) for _, high in model.disturbance],
            "recordings": recordings,
            "warnings": check.sentences,
            "hints": self.hints,
        }

    def rows(self) -> Iterator[Row]:
        """Yield the fit, what was tried beside it, and what its bounds promise."""
        model, check, late = self.model, self.model.check, ""
        if check.delay > 1:
            late = f", a delay of {check.delay} samples"
        yield from (("caution", sentence) for sentence in check.sentences)
        yield "model", f"{model.n} states, order {check.order}{late}, coefficients by {check.method}"
        yield _tested(model)
        what = "sample" if model.horizon is None else "window"
        for file, numbers in zip(self.files, check.recordings, strict=True):
            yield str(file), _recording_text(numbers, what)
        if check.widest is not None:
            yield from check.widest.rows(self.files)
        yield from _tried_signals(model)
        yield from _tried_tests(model)
        yield from _left_out(check, self.files)
        if model.extrapolation:
            why = model.provenance["extrapolation"]
            yield "outside training", f"bounds are {text_outside(model)}, {why}"
        yield from _follows(check)
        yield from disturbance_rows(model)
        if not check.tests:  # else lags were tried
            yield from _memory(model)
        yield "safety", f"{check.safety:g} times these bounds"
        means = []
        for a in model.averages:
            means.append(f"{a.text} within {float(a.bound):.4g} {model.unit(a.signal)}".rstrip())
        if means:
            yield "averages", ", ".join(means)
        rounded = []
        for name, r in zip(model.outputs, model.resolution, strict=True):
            if r:
                rounded.append(f"{float(r):.6g} of {name}")
        if rounded:
            part = "that much of the bound is what the recorder rounds away"
            yield "resolution", f"{', '.join(rounded)}: {part}"

    def table(self) -> Iterator[Sequence[str]]:
        """Yield the bounds of each output, and the errors that are always seen with them."""
        model, check = self.model, self.model.check
        seen = ["jump always seen", "steady error always seen"]
        if not check.steady:
            seen = ["lasting jump always seen"]
        if check.hidden:
            seen = ["lasting jump: noise may hide", "always seen, by zonotopes alone"]
        yield ["output", "smallest bound", "written", *seen]
        sizes = list(filter(None, (check.hidden, check.jump, check.steady)))
        for name, noise, resolution in zip(model.outputs, model.noise, model.resolution, strict=True):
            bounds = f"{check.smallest[name]:.4g}", f"{float(noise + resolution):.4g}"
            yield [name, *bounds, *(_size(model, each, name) for each in sizes)]


def _average(check: FitCheck) -> int | None:
    """Return of how many errors in a row the test bounds the mean; None: it does not."""
    if not check.tests:
        return check.recipe.average
    return best_test(check.tests).window.average


def _is_taken(test: JudgedTest, model: Fitted) -> bool:
    """Return whether a test that was tried is that of the model, or one of those."""
    return test is best_test(model.check.tests) or test.window.text in [own.name for own in model.tests]


def _plain_test(test: JudgedTest, model: Fitted) -> dict[str, Any]:
    """Return the fields of a test that was tried, those of its windows first."""
    fields = {"name": test.window.text} | test.window._asdict() | test._asdict()
    for hidden in ("window", "blindness", "reach", "typical"):
        del fields[hidden]
    return fields | {"chosen": _is_taken(test, model)}


def _tried_signals(model: Fitted) -> Iterator[Row]:
    """Yield a line on each set of inputs that was taken, and on the best few of the others."""
    tried = model.check.signals
    if not tried:
        return
    others = sorted((one for one in tried if not one.taken), key=lambda one: one.blindness)
    for one in [*(one for one in tried if one.taken), *others[:SHOWN]]:
        jump, steady = _each_size(model, one.jump), _each_size(model, one.steady)
        text = f"needs {one.factor:.3g} times; sees jumps of {jump}; lasting errors of {steady}"
        if not np.isfinite(one.blindness):
            text = "fewer recordings can be left out"
        elif one.taken and one.change != GIVEN:
            text = f"taken: {text}"
        yield f"signals: {one.change}", text
    if len(others) > SHOWN:
        yield "signals", f"tried besides, none better: {len(others) - SHOWN}"


def _tried_tests(model: Fitted) -> Iterator[Row]:
    """Yield a line on each test that was tried: the factor it needs, and what it then sees."""
    for test in model.check.tests:
        jump, steady = _each_size(model, test.jump), _each_size(model, test.steady)
        text = (
            f"needs {test.factor:.3g} times; by {test.method}; sees jumps of {jump}; lasting errors of "
            f"{steady}; ramps, within {RAMP} samples, of {_each_size(model, test.ramp)}"
        )
        if _is_taken(test, model):
            text = f"chosen: {text}"
        yield f"test: {test.window.text}", text


def _bounds_by_output(model: Fitted, bounds: Iterable[SupportsFloat]) -> dict[str, float]:
    return dict(zip(model.outputs, map(float, bounds), strict=True))


def _each_size(model: Fitted, sizes: Mapping[str, float]) -> str:
    parts = []
    for name in model.outputs:
        text = f"{name} from {_size(model, sizes, name)}"
        if sizes[name] > model.check.moved.get(name, np.inf):
            text = f"{name} beyond all that it moved"
        parts.append(text)
    return ", ".join(parts)


def _size(model: Fitted, sizes: Mapping[str, float], name: str) -> str:
    if not np.isfinite(sizes[name]):
        return "never"
    return f"{sizes[name]:.3g} {model.unit(name)}".rstrip()


def _tested(model: Fitted) -> Row:
    """Return the line on the test that the bounds are for."""
    apart = f"{model.dt:g} s apart"
    if model.horizon is None:
        observer = model.check.recipe.window.observer
        flags = f"--test observer={observer}"
        return "observer", f"{observer}, samples {apart}: none is a FAULT; bounds for `detect {flags}`"
    samples = f"{model.horizon + 1}"
    if model.lags is not None:
        samples = f"{len(model.lags)} of {model.horizon + 1}"
    return "windows", f"{samples} samples, {apart}: all of them CONSISTENT, by the proved test"


def _recording_text(numbers: Mapping[str, float], what: str) -> str:
    if not numbers["windows"]:
        return f"no {what}"
    return f"{numbers['windows']} {what}s, {100 * numbers['used']:.3g} % of the bounds used"


def _left_out(check: FitCheck, files: Sequence[Path]) -> Iterator[Row]:
    """Yield lines on each recording, or block, that was left out, and on what that promises."""
    if not check.left_out:
        yield "left out", "nothing"
        return
    names = list(map(str, files))
    if len(files) == 1:
        names = [f"block {i + 1} of {len(check.left_out)}" for i in range(len(check.left_out))]
    for name, one in zip(names, check.left_out, strict=True):
        text = f"{one.factor:.3g} times the smallest bounds, by a fit to the others"
        if one.why:
            text = f"unknown: {one.why}"
        yield f"left out: {name}", text
    few = few_days(len(files))
    text = f"{check.factor / few:.3g}, the mean of these, times {few:.3g} for so few recordings"
    yield "factor", text
    count = 0
    if len(files) > 1:
        count = sum(not one.why for one in check.left_out)
    yield "promise", promise(check.factor, count)


def _follows(check: FitCheck) -> Iterator[Row]:
    """Yield a line on bounds that follow the operating point."""
    weight, mean, most = check.follows
    if weight:
        text = (
            f"the operating point, weight {weight:g}: in training bounds are 1 to {most:.3g} times those "
            f"below, {mean:.3g} on average; errors that are seen at {most:.3g} times"
        )
        yield "bounds follow", text


def promise(factor: float, count: int) -> str:
    """Return the promise of bounds that hold for so many recordings, each left out in turn; 0: for none."""
    text = f"bounds are {factor:.3g} times the smallest for these"
    if not count:
        return text
    return (
        f"{text}; of recordings like them one in {count + 1} may still ask for more, by more recordings fewer"
    )


def _memory(model: Fitted) -> Iterator[Row]:
    """Yield a line on lags where the plant remembers longer than its windows: they may see smaller lasting
    errors.
    """
    if model.horizon is None or model.lags is not None or slowest(model) < MEMORY * (model.horizon + 1):
        return
    try:
        lags = suggest_lags(model)
    except ValueError:  # none of them would help
        return
    sizes = []
    for name in model.outputs:
        sizes.append(f"{name} {lags.sizes[lags][name]:.3g} {model.unit(name)}".rstrip())
    yield (
        "memory",
        f"the plant remembers longer than a window: fitted again with "
        f"`--recipe lags={','.join(map(str, lags))}` it would see lasting errors from "
        f"about {', '.join(sizes)} on, if its bounds hardly grew",
    )
