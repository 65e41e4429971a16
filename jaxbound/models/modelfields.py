"""The fields of a model file, in ONE table: where a field stands, how it is called, and of what kind it is.

A new field is one line of `FIELDS`, checked and spelled from then on; `_stated` takes its value from a
`LinearSystem`, `model_arguments` gives it to one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from jaxbound.models.average import Average
from jaxbound.models.filevalues import (
    AVERAGES,
    BOUND,
    MATRIX,
    NOISE,
    NUMBER,
    RANGE,
    SHARES,
    TEXT,
    TRUTH,
    Table,
    ValueKind,
    as_list,
    checked_table,
    in_list,
    known_fields,
)
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.statedalarms import ALARMS
from jaxbound.models.statedtests import stated_tests
from jaxbound.models.system import ORIGINS, LinearSystem, matrices_at_zero
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.recordings.recordingformat import READERS, TABLE, format_of, with_format

LISTS = ("inputs", "outputs", "disturbances", "uncertainty", "fault")
"""Places of which a file has several, each a table of its own."""


@dataclass(frozen=True)
class Entry:
    """One table of a model file.

    Fields: place: its name, "" for the fields above all tables. number: of several of that name.
    """

    place: str
    number: int = 0


def _read_names(field: str, where: str, value: object) -> list[Any]:
    return [TEXT.read(field, where, name) for name in as_list(field, value)]


def _read_states(field: str, where: str, value: object) -> list[Table]:
    states = []
    for i, state in enumerate(as_list(field, value)):
        table = {"name": state} if isinstance(state, str) else state
        states.append(_read_entry(Entry("states", i), table))
    return states


def _spelled_states(states: list[tuple[str, str | None]]) -> str:
    texts = []
    for name, unit in states:
        spelled = TEXT.spell(name)
        if unit is not None:
            spelled = f"{{name = {spelled}, unit = {TEXT.spell(unit)}}}"
        texts.append(spelled)
    return in_list(texts)


def _spelled_format(value: object) -> str:
    """Return a field of `[recording]`: a number, a text or several."""
    if isinstance(value, tuple):
        return in_list(map(_spelled_format, value))
    if isinstance(value, str):
        return TEXT.spell(value)
    return str(value)


WHOLE = ValueKind(lambda field, where, value: value, str)  # LinearSystem says what is wrong with it
LAGS = ValueKind(lambda field, where, value: as_list(field, value), lambda lags: in_list(map(str, lags)))
NAMES = ValueKind(_read_names, lambda names: in_list(map(TEXT.spell, names)))
STATES = ValueKind(_read_states, _spelled_states)
FORMAT = ValueKind(lambda field, where, value: value, _spelled_format)  # `RecordingFormat` checks it


SIGNAL = {"name": TEXT, "unit": TEXT}
MATRICES = {"A": MATRIX, "B": MATRIX, "C": MATRIX, "D": MATRIX}
FIELDS: Mapping[str, Mapping[str, ValueKind]] = {
    "": {
        "name": TEXT,
        "dt": NUMBER,
        "every": TEXT,
        "horizon": WHOLE,
        "lags": LAGS,
        "left_out": NUMBER,
        "extrapolation": NUMBER,
        "time": TEXT,
        "where": TEXT,
        "constant_tolerance": TRUTH,
        "states": STATES,
        "decouple": NAMES,
    },
    "states": SIGNAL,
    TABLE: dict.fromkeys(READERS, FORMAT),
    "inputs": {**SIGNAL, "column": TEXT, "offset": NUMBER, "range": RANGE},
    "outputs": {
        **SIGNAL,
        "column": TEXT,
        "offset": NUMBER,
        "tolerance": NUMBER,
        "noise": NOISE,
        "resolution": NUMBER,
        "averages": AVERAGES,
    },
    "disturbances": {"bound": BOUND, "averages": AVERAGES},
    "uncertainty": {"name": TEXT, "varying": TRUTH, "between": RANGE, **MATRICES},
    "fault": {
        "name": TEXT,
        "output": TEXT,
        "input": TEXT,
        "states": SHARES,
        "A": MATRIX,
        "B": MATRIX,
        "C": MATRIX,
        "kind": TEXT,
        "times": TEXT,
        "sign": TEXT,
        "least": NUMBER,
        "most": NUMBER,
        "between": RANGE,
        "unit": TEXT,
    },
    "alarms": ALARMS,
    "matrices": {**MATRICES, "G": MATRIX, "F": MATRIX, "D_v": MATRIX, "E": MATRIX},
}
"""{table, "" above all tables: {field: kind of its value}}, in the order in which they are written."""
READ_BY = ("every", "time", "where")
"""Fields above all tables by which recordings are read, once for all tests."""
BY_NAME = {"unit": "units", "column": "columns", "range": "ranges"}
"""{field of a signal: argument of a LinearSystem that has it by the name of the signal}."""
EACH = ("tolerance", "noise", "resolution")
"""Bounds that have a number for each output."""
TABLES = (
    *LISTS,
    TABLE,
    "alarms",
    "matrices",
    "provenance",
    "fit",
    "test",
)  # fit: its recipe, for `fit` alone


def field_names(place: str) -> tuple[str, ...]:
    """Return the names that a table of a model file may hold. place: its name, "" above all tables."""
    if place == "provenance":
        return ORIGINS
    names = tuple(FIELDS[place])
    if not place:
        return names + TABLES
    return names


def value_texts(model: LinearSystem) -> dict[Entry, dict[str, str]]:
    """Return {table: {field: text of its value}} of the file of a model, in its order; its provenance stands
    behind them.
    """
    whole = {}
    for place, tables in _stated(model).items():
        for number, table in enumerate(tables):
            texts = {}
            for name, kind in FIELDS[place].items():
                if table.get(name) is not None:
                    texts[name] = kind.spell(table[name])
            whole[Entry(place, number)] = texts
    return whole


def _stated(model: LinearSystem) -> dict[str, list[Table]]:
    """Return the tables of the file of a model, {place: tables}; a value that is None is left out.

    The model is written decoupled and solved for x+, its matrices at the value 0 of every parameter.
    """
    top = {name: model.columns.get(name) for name in READ_BY} | {
        "name": model.name,
        "dt": Fraction(repr(model.dt)),
        "horizon": model.horizon,
        "lags": model.lags,
        "left_out": model.left_out,
        "extrapolation": model.extrapolation,
        "constant_tolerance": model.constant_tolerance or None,
        "states": [(name, model.units.get(name)) for name in model.states],
    }
    if model.lags is not None:
        top["horizon"] = None  # the largest of the lags says it
    tables: dict[str, list[Table]] = {"": [top], "inputs": [], "outputs": []}
    file_format = format_of(model).stated
    if file_format:
        tables = {"": [top], TABLE: [file_format], "inputs": [], "outputs": []}
    for place, side in (("inputs", "u"), ("outputs", "y")):
        for name, offset in zip(getattr(model, place), model.offset[side], strict=True):
            table: Table = {"name": name, "offset": offset or None}
            for field, argument in BY_NAME.items():
                table[field] = getattr(model, argument).get(name)
            tables[place].append(table)
    for i, table in enumerate(tables["outputs"]):
        for bound in EACH:
            table[bound] = getattr(model, bound)[i] or None
        if table["name"] in model.times:
            table["noise"] = model.noise[i], model.times[table["name"]]
        table["averages"] = _averages(model, table["name"])
    disturbances = enumerate(model.disturbance, 1)
    tables["disturbances"] = [{"bound": b, "averages": _averages(model, f"w{j}")} for j, b in disturbances]
    tables["uncertainty"] = [dict(vars(parameter)) for parameter in model.uncertainties]
    for table in tables["uncertainty"]:
        # what is usual is not written: a file shows what somebody stated
        if table["varying"]:
            del table["varying"]
        if table["between"] == (-1, 1):
            del table["between"]
    if model.alarms:
        tables["alarms"] = [dict(model.alarms)]
    tables["fault"] = []
    for fault in model.faults:
        table = {name: value for name, value in vars(fault).items() if value != ()}
        if fault.kind == fault.usual_kind:
            del table["kind"]
        tables["fault"].append(table)
    matrices: dict[str, object] = dict(matrices_at_zero(model))
    written = {
        "A": model.n,
        "B": model.n and model.m,
        "C": model.n,
        "D": model.has_feedthrough or not model.n,
        "G": model.g,
        "F": model.d,
        "D_v": model.has_direct_unknown,
    }
    matrices |= {"G": model.G, "F": model.F, "D_v": model.D_v}
    tables["matrices"] = [{letter: rows for letter, rows in matrices.items() if written[letter]}]
    return tables


def _averages(model: LinearSystem, signal: str) -> list[Average] | None:
    """Return the averages of an output or of a disturbance, None where there are none."""
    return [average for average in model.averages if average.signal == signal] or None


def model_arguments(document: Table) -> dict[str, Any]:
    """Return the arguments of the `LinearSystem` that a model file states.

    Args:
        document: the file as TOML has it, decimals as texts.

    Raises:
        ValueError: with a sentence that names the field.
    """
    document = known_fields("the model", document, field_names(""))
    tables = {"matrices": [_read_matrices(document)]}
    if "dt" not in document:
        raise ValueError("dt is missing: the sampling period in seconds")
    tables["states"] = STATES.read("states", "", document.get("states", []))
    for place in LISTS:
        listed = as_list(place, document.get(place, []))
        tables[place] = [_read_entry(Entry(place, i), table) for i, table in enumerate(listed)]
    _refuse_half_of_a_pair(tables)
    top = {name: kind.read(name, "", document[name]) for name, kind in FIELDS[""].items() if name in document}
    arguments = _of_signals(tables) | _assembled(top, tables)
    arguments["columns"] |= {name: top[name] for name in READ_BY if name in top}
    arguments["columns"] = with_format(
        arguments["columns"], checked_table(f"[{TABLE}]", document.get(TABLE, {}))
    )
    for name in ("name", "lags", "left_out", "extrapolation", "constant_tolerance"):
        if name in top:
            arguments[name] = top[name]
    tests = stated_tests(as_list("test", document.get("test", [])))
    alarms = checked_table("[alarms]", document.get("alarms", {}))
    return arguments | {"provenance": _read_provenance(document), "tests": tests, "alarms": alarms}


def _read_matrices(document: Table) -> Table:
    if "matrices" not in document:
        raise ValueError(
            "the table [matrices] is missing: it holds A, B, C and, if there is a direct path, D"
        )
    matrices = checked_table("[matrices]", document["matrices"])
    matrices = known_fields("[matrices]", matrices, field_names("matrices"))
    is_static = "D" in matrices and "A" not in matrices and "C" not in matrices
    if not is_static:
        for letter in ("A", "C"):
            if letter not in matrices:
                raise ValueError(f"[matrices] needs {letter}")
    for letter, rows in matrices.items():
        MATRIX.read(letter, "", rows)
    return matrices


def _read_provenance(document: Table) -> Table:
    table = checked_table("[provenance]", document.get("provenance", {}))
    return known_fields("[provenance]", table, ORIGINS)


def _read_entry(entry: Entry, table: object) -> Table:
    """Check one table of several; return its values."""
    where = f"number {entry.number + 1} of {entry.place}"
    title = where  # with the name, where there is one: then a sentence goes on behind a comma
    if isinstance(table, dict) and "name" in table and entry.place != "disturbances":
        where = f"{where}, {table['name']!r}"
        title = f"{where},"
    table = known_fields(title, checked_table(title, table), field_names(entry.place))
    if entry.place == "disturbances":
        if "bound" not in table:
            raise ValueError(f"{where} needs a bound: a number for |w| <= bound, or [lowest, highest]")
    elif "name" not in table:
        raise ValueError(f"{where} needs a name")
    return {name: FIELDS[entry.place][name].read(name, where, value) for name, value in table.items()}


def _refuse_half_of_a_pair(tables: Mapping[str, list[Table]]) -> None:
    """Raise ValueError where G stands without bounds of disturbances, or D_v without F."""
    (matrices,) = tables["matrices"]
    # either half alone would silently drop the disturbance
    if ("G" in matrices) != bool(tables["disturbances"]):
        half = "the blocks are" if "G" in matrices else "G is"
        raise ValueError(
            f"a disturbance needs both G in [matrices] and, for each column of G, a [[disturbances]] block "
            f"with its bound: {half} missing"
        )
    if "D_v" in matrices and "F" not in matrices:
        raise ValueError(
            "D_v says how unknown inputs act on the outputs: it needs F beside it, zeros where they do not "
            "act on a state"
        )


def _of_signals(tables: Mapping[str, list[Table]]) -> dict[str, Any]:
    """Return the arguments that have a value for each signal, 0 where a file says nothing."""
    inputs, outputs = tables["inputs"], tables["outputs"]
    named = [*inputs, *outputs, *tables["states"]]
    arguments: dict[str, Any] = {}
    for field, argument in BY_NAME.items():
        arguments[argument] = _field_by_name(named, field)
    arguments["offset"] = {}
    for side, signals in (("u", inputs), ("y", outputs)):
        if signals:
            arguments["offset"][side] = [signal.get("offset", 0) for signal in signals]
    if outputs:
        for bound in EACH:
            arguments[bound] = [output.get(bound, 0) for output in outputs]
        arguments["times"] = {}
        for i, bound in enumerate(arguments["noise"]):
            if isinstance(bound, tuple):
                # a bound with its factor is one field of the file, and two arguments of a model
                arguments["noise"][i], arguments["times"][outputs[i]["name"]] = bound
    return arguments


def _field_by_name(tables: Iterable[Table], field: str) -> dict[str, Any]:
    """Return {name of a table: value of a field} of those that have it."""
    return {table["name"]: table[field] for table in tables if field in table}


def _assembled(top: Table, tables: Mapping[str, list[Table]]) -> dict[str, Any]:
    """Return the arguments that several fields make together."""
    (matrices,) = tables["matrices"]
    arguments: Table = {letter: matrices.get(letter) for letter in ("A", "B", "C", "D", "E")}
    arguments |= {"dt": top["dt"], "horizon": top.get("horizon"), "decouple": top.get("decouple", [])}
    for place in ("inputs", "outputs", "states"):
        arguments[place] = [table["name"] for table in tables[place]] or None
    if tables["disturbances"]:
        arguments["disturbance"] = matrices["G"], [table["bound"] for table in tables["disturbances"]]
    if "D_v" in matrices:
        arguments["unknown_inputs"] = matrices["F"], matrices["D_v"]
    elif "F" in matrices:
        arguments["unknown_inputs"] = matrices["F"]
    arguments["uncertainties"] = [Uncertainty(**table) for table in tables["uncertainty"]]
    arguments["faults"] = [NamedFault(**table) for table in tables["fault"]]
    averages = _field_by_name(tables["outputs"], "averages")
    for i, table in enumerate(tables["disturbances"]):
        if "averages" in table:
            averages[f"w{i + 1}"] = table["averages"]
    arguments["averages"] = averages
    return arguments
