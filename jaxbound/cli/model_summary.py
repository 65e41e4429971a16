"""A model file's contents, and what can be detected and isolated with it, on the terminal and as JSON."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from jaxbound.cli.terminal import Conclusion, Row
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.detectability import GuaranteedSize, detectable
from jaxbound.diagnosis.isolability import FaultIsolability, isolability
from jaxbound.models.region import text_outside
from jaxbound.models.statedtests import StatedTest
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.signals import SignalModel
from jaxbound.relations.cost import elimination_seconds, relation_cost
from jaxbound.relations.decoupling import signatures, structured_relations
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import redundancy
from jaxbound.relations.sentence import main_terms
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.reports.parts import distinct_relations
from jaxbound.text.quantities import rough_duration

SENSOR_BOUNDS = ("tolerance", "noise", "resolution")
SIGNALS = 12
"""Up to here relations of minimal support are looked for and every pair of faults is listed."""
PAIRS = 4000
"""Readings of a window, times pairs of named faults, up to which these are told apart: seconds."""
PATIENCE = 60.0
"""Seconds, roughly, beyond which tables are left to whoever asks for them."""


@dataclass(frozen=True)
class ModelConclusion(Conclusion):
    """A model file in words: its contents, its relations, and the faults that they see and tell apart.

    Fields: model, relations: of its windows. bank: the monitor of its tests; None: it states none, or other
        windows are asked for.
    """

    model: LinearSystem
    relations: ParityRelation | UncertainRelations
    bank: MonitorBank | None = None

    @property
    def headline(self) -> str:
        """The name of the model."""
        return self.model.name

    def rows(self) -> Iterator[Row]:
        """Yield the contents of the file."""
        model, relations = self.model, self.relations
        offsets = model.offset["u"] + model.offset["y"]
        yield "states", f"{model.n}: {', '.join(model.states)}"
        yield "inputs", f"{model.m}: {_signals_text(model, model.inputs)}"
        yield "outputs", f"{model.p}: {_signals_text(model, model.outputs)}"
        yield "dt", f"{model.dt:g} s"
        yield "matrices", f"{_matrices_text(model)}   {_origin_in_brackets(model, 'model')}"
        yield from _bounds_rows(model)
        yield "offset", _nonzero_text(model.inputs + model.outputs, offsets)
        for name, column in model.columns.items():
            is_signal = name in model.inputs + model.outputs
            yield f"column of {name}" if is_signal else name, column
        yield from _relations_rows(relations)
        for test in model.tests:
            yield f"test {test.name}", _test_text(test)
        if model.alarms:
            yield "alarms", ", ".join(f"{name} {value}" for name, value in model.alarms.items())
        # long windows repeat a relation at each sample: it is shown once
        distinct = len(distinct_relations(relations))
        if distinct < relations.count:
            yield "", f"the {distinct} below and the same some samples earlier"

    def text(self) -> str:
        """Return the relations, and what they see and tell apart."""
        model, relations = self.model, self.relations
        lines = relations.text().splitlines()
        paragraphs = ["\n".join(main_terms(lines[j]) for j in distinct_relations(relations))]
        if not model.uncertainties:
            paragraphs.append(isolation_text(model, relations.horizon, relations.lags))
        if model.faults:
            paragraphs.append(_named_text(model, relations))
        if self.bank is not None:
            paragraphs.append(_sizes_by_tests(self.bank))
        return "\n\n".join(paragraphs)

    def plain(self) -> dict[str, Any]:
        """Return a model, its relations and the sizes that are guaranteed."""
        model, relations, bank = self.model, self.relations, self.bank
        parameters = []
        for parameter in model.uncertainties:
            low, high = map(float, parameter.between)
            parameters.append({"name": parameter.name, "between": [low, high], "varying": parameter.varying})
        plain: dict[str, Any] = {
            "name": model.name,
            "dt": model.dt,
            "horizon": relations.horizon,
            "states": list(model.states),
            "inputs": [_plain_signal(model, "u", i, name) for i, name in enumerate(model.inputs)],
            "outputs": [_plain_signal(model, "y", i, name) for i, name in enumerate(model.outputs)],
            "unknown_inputs": model.d,
            "disturbances": [[float(x) for x in ends] for ends in model.disturbance],
            "parameters": parameters,
            "provenance": dict(model.provenance),
            "times": dict(model.times),
            "tests": {test.name: _test_text(test) for test in model.tests},
            "alarms": dict(model.alarms),
            "relations": relations.text().splitlines(),
            "notes": list(relations.notes),
            "hints": self.hints,
        }
        # sizes are guaranteed where nothing that a reading depends on scales with it
        is_known = not model.uncertainties and not any(model.tolerance) and not model.factors
        if is_known and _seconds(model, relations.horizon) <= PATIENCE:
            sizes = _guaranteed_sizes(model, relations.horizon, relations.lags)
            plain["guaranteed"] = sizes
        if model.faults:
            apart = _named(model, relations)
            plain["named_faults"] = None
            if not isinstance(apart, str):
                plain["named_faults"] = apart.to_dict()
        if bank is not None:
            plain["guaranteed_by_tests"] = _plain_by_tests(bank)
        return plain


def _named(model: LinearSystem, relations: ParityRelation | UncertainRelations) -> FaultIsolability | str:
    """Return which of the named faults can be told apart by windows, or why that is not worked out."""
    readings = model.p * len(relations.lags or range(relations.horizon + 1))
    if readings * len(model.faults) ** 2 > PAIRS:
        return "that would take long; jb.isolability(model, model.faults) does it"
    try:
        return isolability(model, model.faults, **relations.span)
    except NotImplementedError as e:
        return str(e)


def _named_text(model: LinearSystem, relations: ParityRelation | UncertainRelations) -> str:
    """Return a paragraph on the named faults."""
    apart = _named(model, relations)
    if isinstance(apart, str):
        return f"(which named faults can be told apart is not worked out: {apart})"
    about = "named faults that fill a window, and which other one alone may explain them:"
    return f"{about}\n{apart.text()}"


def _sizes_by_tests(bank: MonitorBank) -> str:
    """Return lines on the guaranteed sizes of a monitor, and of each of its tests."""
    sizes = _guaranteed_by_tests(bank)
    if isinstance(sizes, str):
        return f"({sizes})"
    lines = ["its tests together detect a constant fault, whatever else happens, from this size on:"]
    for name, size in sizes.items():
        by = f", by {size.test}" * math.isfinite(size)
        others = ", ".join(f"{test} {own:.4g}" for test, own in size.tests.items())
        lines.append(f"{name}: {_amount(bank.model, name, size)}{by} ({others})")
    return "\n".join(lines)


def _amount(model: SignalModel, name: str, size: float) -> str:
    """Return a guaranteed size of a fault of a signal in its unit."""
    if math.isinf(size):
        return "never guaranteed"
    return f"{float(size):.4g} {model.unit(name)}".rstrip()


def _guaranteed_by_tests(bank: MonitorBank) -> dict[str, GuaranteedSize] | str:
    """Return {signal: size} of the constant faults that a monitor detects, or why they are not known."""
    # observers prove no size: what they cost is not asked
    seconds = 0.0
    for watch in bank.watches:
        if watch.relations.linear is not None:
            seconds += _seconds(watch.relations.linear.model, watch.relations.horizon)
    if seconds > PATIENCE:
        return "guaranteed sizes of the monitor take long: jb.detectable(monitor, signal) works them out"
    try:
        return {name: detectable(bank, name) for name in bank.model.outputs + bank.model.inputs}
    except (ValueError, NotImplementedError) as e:
        return f"no guaranteed sizes of the monitor: {e}"


def _test_text(test: StatedTest) -> str:
    """Return a test of the model's monitor, and when it watches."""
    if test.when is None:
        return test.words()
    return f"{test.words()}, when {test.when}"


def _signals_text(model: LinearSystem, names: Sequence[str]) -> str:
    signals = []
    for name in names:
        unit = model.unit(name)
        signals.append(f"{name} [{unit}]" if unit else name)
    return ", ".join(signals) or "none"


def _matrices_text(model: LinearSystem) -> str:
    direct = "present" if model.has_feedthrough else "zero"
    return f"A {model.n}x{model.n}, B {model.n}x{model.m}, C {model.p}x{model.n}, D {direct}"


def _bounds_rows(model: LinearSystem) -> Iterator[Row]:
    """Yield a row for each kind of bound."""
    for kind in SENSOR_BOUNDS:
        values = _nonzero_text(model.outputs, getattr(model, kind))
        yield kind, f"{values}   {_origin_in_brackets(model, kind)}".rstrip()
    for factor in model.factors:
        yield f"noise of {factor.output}", f"times {factor.text}"
    if model.g:
        ranges = []
        for j, (lo, hi) in enumerate(model.disturbance):
            ranges.append(f"w{j + 1} in [{float(lo):.6g}, {float(hi):.6g}]")
        yield "disturbance", f"{', '.join(ranges)}   {_origin_in_brackets(model, 'disturbance')}"
    for a in model.averages:
        yield "average", f"{a.text} within {float(a.bound):.6g}"
    if model.extrapolation:
        yield (
            "outside training",
            f"bounds {text_outside(model)}   {_origin_in_brackets(model, 'extrapolation')}",
        )
    if model.d:
        yield "unknown inputs", f"{model.d}, of which nothing is known"
    for parameter in model.uncertainties:
        low, high = map(float, parameter.between)
        how = "varies" if parameter.varying else "constant"
        yield "parameter", f"{parameter.name} in [{low:.6g}, {high:.6g}], {how}"


def _nonzero_text(names: Sequence[str], values: Sequence[Fraction]) -> str:
    """Return the numbers that are not 0 behind their names."""
    texts = [f"{name} {float(value):.6g}" for name, value in zip(names, values, strict=True) if value]
    return ", ".join(texts) or "none"


def _origin_in_brackets(model: LinearSystem, field: str) -> str:
    """Return the provenance of a field in brackets; of bounds that are 0 throughout there is none."""
    origin = model.provenance.get(field)
    if origin:
        return f"({origin})"
    if field in SENSOR_BOUNDS and not any(getattr(model, field)):
        return ""
    return "(origin not stated)"


def _relations_rows(relations: ParityRelation | UncertainRelations) -> Iterator[Row]:
    """Yield rows on the windows and on how many relations are tested."""
    s = relations.horizon
    yield "horizon", f"{s}: a window has {s + 1} samples"
    lags = relations.lags
    if lags:
        about = "so long before its last sample outputs are looked at"
        yield "lags", f"{', '.join(map(str, lags))}: {about}"
    yield "relations", f"{relations.count} independent, {relations.tested}"
    yield from (("note", note) for note in relations.notes)


def _plain_by_tests(bank: MonitorBank) -> dict[str, Any]:
    """Return {signal: {"size", "test", "tests"}} of a monitor; {} where its sizes are not known."""
    sizes, plain = _guaranteed_by_tests(bank), {}
    if isinstance(sizes, str):
        return {}
    for name, size in sizes.items():
        plain[name] = {"size": size, "test": size.test or None, "tests": size.tests}
    return plain


def _plain_signal(model: LinearSystem, side: str, i: int, name: str) -> dict[str, Any]:
    """Return an input (side "u") or an output ("y") as JSON has it."""
    signal: dict[str, Any] = {
        "name": name,
        "unit": model.unit(name),
        "column": model.column(name),
        "offset": float(model.offset[side][i]),
    }
    if side == "y":
        return signal | {kind: float(getattr(model, kind)[i]) for kind in SENSOR_BOUNDS}
    if name in model.ranges:
        signal["range"] = [float(x) for x in model.ranges[name]]
    return signal


def _seconds(model: LinearSystem, horizon: int) -> float:
    """Return about how long the tables of `isolation_text` take."""
    signals = model.outputs + model.inputs
    return len(signals) * (elimination_seconds(model, model.n, unknown=1) + relation_cost(model, horizon)[0])


def _guaranteed_sizes(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None) -> dict[str, float]:
    """Return {signal: size} of the constant faults that fill a window and are detected whatever else
    happens.
    """
    window: dict[str, Any] = {"lags": lags}
    if lags is None:
        window = {"horizon": max(horizon, redundancy(model).horizon)}
    return {name: float(detectable(model, name, **window)) for name in model.outputs + model.inputs}


def isolation_text(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None = None) -> str:
    """Return paragraphs on a certain model: its relations of fewest signals, which single faults they tell
    apart, guaranteed sizes.
    """
    signals = model.outputs + model.inputs
    if len(signals) > SIGNALS:
        return (
            f"(more than {SIGNALS} signals: jb.structured_relations(model, [...]) has the relations that "
            f"ignore those of your choice)"
        )
    seconds = _seconds(model, horizon)
    if seconds > PATIENCE:
        return (
            f"(signatures, isolability and guaranteed sizes are not worked out: that would take "
            f"{rough_duration(seconds)}; jb.isolability(model) and jb.detectable(model, signal, horizon) do "
            f"it)"
        )
    out = []
    try:
        bank = structured_relations(model)
    except ValueError as e:
        return f"(no table of signatures: {e})"
    if bank.count:
        out += [
            "relations of fewest signals, q the step to the next sample:",
            *map(main_terms, bank.text().splitlines()),
            "",
        ]
        out += [
            "how they react to a fault of one signal: 1 yes, t only while it changes, . not at all",
            signatures(bank).text(),
            "",
        ]
    out += [
        "a fault of the row shows although that of the column is ignored: 1 yes, t only while it changes, . "
        "no",
        isolability(model).text(),
        "",
    ]
    return "\n".join([*out, *_sizes(model, horizon, lags)])


def _sizes(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None) -> list[str]:
    """Return lines on the guaranteed sizes."""
    if any(model.tolerance):
        return [
            "guaranteed sizes depend on the operating range: jb.detectable(model, signal, "
            "operating_range=...)"
        ]
    last = max(horizon, redundancy(model).horizon) if lags is None else lags[-1]
    samples = last + 1
    lines = [
        f"a constant fault that fills a window of {samples} samples is detected, whatever else happens, from "
        f"this size on:"
    ]
    for name, size in _guaranteed_sizes(model, horizon, lags).items():
        lines.append(f"{name}: {_amount(model, name, size)}")
    return lines
