"""The fields of a model file, in ONE table: where a field stands, how it is called, of what kind it is, and
where a `LinearSystem` has it.

A new field is one line of `FIELDS`, read and written from then on. Arguments that several fields make
together (F and D_v, G and its bounds) are assembled in `model_arguments`.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Protocol

from jaxbound.exact.linalg import Matrix
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
    as_table,
    in_list,
    known_fields,
)
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.statedtests import stated_tests
from jaxbound.models.system import LinearSystem, matrices_at_zero
from jaxbound.models.uncertainty import Uncertainty

__all__ = ["FIELDS", "LISTS", "Entry", "Field", "entries", "field_names", "model_arguments", "value_texts"]

LISTS = ("inputs", "outputs", "disturbances", "uncertainty", "fault")
"""Places of which a file has several, each a table of its own."""
PROVENANCE = ("model", "tolerance", "noise", "resolution", "disturbance")


@dataclass(frozen=True)
class Entry:
    """One table of a model file.

    Fields: place: its name, "" for the fields above all tables. number: of several of that name.
    """

    place: str
    number: int = 0


class Home(Protocol):
    """The place of a field's values in a `LinearSystem`."""

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the values of a field, those of all tables of a place, into the arguments of a LinearSystem."""

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the value of a field to write; None: it is left out."""


@dataclass(frozen=True)
class Elsewhere:
    """The home of a field that `model_arguments` assembles with others: here is only how it is written."""

    written: Callable[[LinearSystem, Entry], object]

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Leave the values to `model_arguments`."""

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the value of a field to write; None: it is left out."""
        return self.written(model, entry)


@dataclass(frozen=True)
class Argument:
    """An argument of the same name; unwritten: the value that is left out of a file."""

    unwritten: object = None

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the value of a field into the arguments."""
        for table in tables:
            if name in table:
                arguments[name] = table[name]

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the value to write; None: it is left out."""
        value = getattr(model, name)
        return None if value == self.unwritten else value


@dataclass(frozen=True)
class BySignal:
    """An argument that maps names of signals, or of fields above all tables, to values."""

    argument: str

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the values of the signals that have some into the argument."""
        values = arguments.setdefault(self.argument, {})
        for table in tables:
            if name in table:
                values[table["name"] if place else name] = table[name]

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the value of a signal; None: it has none."""
        key = _signals(model, entry)[entry.number] if entry.place else name
        return getattr(model, self.argument).get(key)


@dataclass(frozen=True)
class OfEachOutput:
    """An argument of the same name that has a number for each output, 0 where a file says nothing."""

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the numbers of all outputs into the argument."""
        if tables:
            arguments[name] = [table.get(name, 0) for table in tables]

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the number of an output; None: it is 0."""
        return getattr(model, name)[entry.number] or None


@dataclass(frozen=True)
class NoiseOfEachOutput:
    """The noise of each output, 0 where a file says nothing, and the factors on it."""

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the bounds of all outputs and their factors into the arguments."""
        bounds, times = [], {}
        for table in tables:
            bound = table.get(name, 0)
            if isinstance(bound, tuple):
                bound, times[table["name"]] = bound
            bounds.append(bound)
        if tables:
            arguments |= {name: bounds, "times": times}

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the bound of an output, with its factor where it has one; None: it is 0."""
        bound, output = model.noise[entry.number], model.outputs[entry.number]
        if output in model.times:
            return bound, model.times[output]
        return bound or None


@dataclass(frozen=True)
class OffsetOf:
    """The operating point of inputs ("u") or outputs ("y"), 0 where a file says nothing."""

    side: str

    def collect(self, arguments: dict[str, Any], name: str, place: str, tables: list[Table]) -> None:
        """Put the numbers of all signals of a side into the argument."""
        offset = arguments.setdefault("offset", {})
        if tables:
            offset[self.side] = [table.get(name, 0) for table in tables]

    def value(self, model: LinearSystem, name: str, entry: Entry) -> object:
        """Return the number of a signal; None: it is 0."""
        return model.offset[self.side][entry.number] or None


@dataclass(frozen=True)
class Field:
    """A field of a model file.

    Fields: place: its table, "" above all tables. name: of the field. kind: of its value. home: of its value.
    """

    place: str
    name: str
    kind: ValueKind
    home: Home


def _read_raw(field: str, where: str, value: object) -> object:
    return value  # LinearSystem says what is wrong with it


def _read_lags(field: str, where: str, value: object) -> list[Any]:
    return as_list(field, value)


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


def _spelled_whole(x: int) -> str:
    return str(x)


WHOLE = ValueKind(_read_raw, _spelled_whole)
LAGS = ValueKind(_read_lags, lambda lags: in_list(map(str, lags)))
NAMES = ValueKind(_read_names, lambda names: in_list(map(TEXT.spell, names)))
STATES = ValueKind(_read_states, _spelled_states)


def _period(model: LinearSystem, entry: Entry) -> Fraction:
    return Fraction(repr(model.dt))


def _horizon(model: LinearSystem, entry: Entry) -> int | None:
    if model.lags is not None:
        return None  # the largest of the lags says it
    return model.horizon


def _states(model: LinearSystem, entry: Entry) -> list[tuple[str, str | None]]:
    return [(name, model.units.get(name)) for name in model.states]


def _signals(model: LinearSystem, entry: Entry) -> tuple[str, ...]:
    return {"inputs": model.inputs, "outputs": model.outputs, "states": model.states}[entry.place]


def _signal_name(model: LinearSystem, entry: Entry) -> str:
    return _signals(model, entry)[entry.number]


def _averages(model: LinearSystem, entry: Entry) -> list[Average] | None:
    """Return the averages of an output or of a disturbance, None where there are none."""
    if entry.place == "disturbances":
        signal = f"w{entry.number + 1}"
    else:
        signal = model.outputs[entry.number]
    return [average for average in model.averages if average.signal == signal] or None


def _disturbance(model: LinearSystem, entry: Entry) -> tuple[Fraction, Fraction]:
    return model.disturbance[entry.number]


def _parameter(name: str, unwritten: object = None) -> Elsewhere:
    """Return the home of a field of an uncertain parameter."""

    def value(model: LinearSystem, entry: Entry) -> object:
        stated = getattr(model.uncertainties[entry.number], name)
        return None if stated == unwritten else stated

    return Elsewhere(value)


def _named_fault(name: str) -> Elsewhere:
    """Return the home of a field of a named fault."""

    def value(model: LinearSystem, entry: Entry) -> object:
        fault = model.faults[entry.number]
        if name == "kind" and fault.kind == fault.usual_kind:
            return None
        stated: object = getattr(fault, name)
        if stated == ():  # no states, no coefficients of a parameter
            return None
        return stated

    return Elsewhere(value)


def _matrix(letter: str) -> Elsewhere:
    """Return the home of a matrix: in a file it is that at the value 0 of every parameter."""

    def value(model: LinearSystem, entry: Entry) -> Matrix | None:
        is_written = {
            "A": model.n,
            "B": model.n and model.m,
            "C": model.n,
            "D": model.has_feedthrough or not model.n,
        }
        if not is_written[letter]:
            return None
        return matrices_at_zero(model)[letter]

    return Elsewhere(value)


def _state_disturbances(model: LinearSystem, entry: Entry) -> Matrix | None:
    return model.G if model.g else None


def _unknown_on_states(model: LinearSystem, entry: Entry) -> Matrix | None:
    return model.F if model.d else None


def _unknown_on_outputs(model: LinearSystem, entry: Entry) -> Matrix | None:
    return model.D_v if model.has_direct_unknown else None


def _unwritten(model: LinearSystem, entry: Entry) -> None:
    return None


FIELDS = (
    Field("", "name", TEXT, Argument()),
    Field("", "dt", NUMBER, Elsewhere(_period)),
    Field("", "every", TEXT, BySignal("columns")),
    Field("", "horizon", WHOLE, Elsewhere(_horizon)),
    Field("", "lags", LAGS, Argument()),
    Field("", "left_out", NUMBER, Argument()),
    Field("", "time", TEXT, BySignal("columns")),
    Field("", "where", TEXT, BySignal("columns")),
    Field("", "constant_tolerance", TRUTH, Argument(unwritten=False)),
    Field("", "states", STATES, Elsewhere(_states)),
    Field("", "decouple", NAMES, Elsewhere(_unwritten)),  # the model that is written is decoupled
    Field("states", "name", TEXT, Elsewhere(_signal_name)),
    Field("states", "unit", TEXT, BySignal("units")),
    Field("inputs", "name", TEXT, Elsewhere(_signal_name)),
    Field("inputs", "unit", TEXT, BySignal("units")),
    Field("inputs", "column", TEXT, BySignal("columns")),
    Field("inputs", "offset", NUMBER, OffsetOf("u")),
    Field("inputs", "range", RANGE, BySignal("ranges")),
    Field("outputs", "name", TEXT, Elsewhere(_signal_name)),
    Field("outputs", "unit", TEXT, BySignal("units")),
    Field("outputs", "column", TEXT, BySignal("columns")),
    Field("outputs", "offset", NUMBER, OffsetOf("y")),
    Field("outputs", "tolerance", NUMBER, OfEachOutput()),
    Field("outputs", "noise", NOISE, NoiseOfEachOutput()),
    Field("outputs", "resolution", NUMBER, OfEachOutput()),
    Field("outputs", "averages", AVERAGES, Elsewhere(_averages)),
    Field("disturbances", "bound", BOUND, Elsewhere(_disturbance)),
    Field("disturbances", "averages", AVERAGES, Elsewhere(_averages)),
    Field("uncertainty", "name", TEXT, _parameter("name")),
    Field("uncertainty", "varying", TRUTH, _parameter("varying", unwritten=True)),
    Field("uncertainty", "between", RANGE, _parameter("between", unwritten=(-1, 1))),
    *(Field("uncertainty", letter, MATRIX, _parameter(letter)) for letter in "ABCD"),
    Field("fault", "name", TEXT, _named_fault("name")),
    Field("fault", "output", TEXT, _named_fault("output")),
    Field("fault", "input", TEXT, _named_fault("input")),
    Field("fault", "states", SHARES, _named_fault("states")),
    *(Field("fault", letter, MATRIX, _named_fault(letter)) for letter in "ABC"),
    Field("fault", "kind", TEXT, _named_fault("kind")),
    Field("fault", "times", TEXT, _named_fault("times")),
    Field("fault", "sign", TEXT, _named_fault("sign")),
    Field("fault", "least", NUMBER, _named_fault("least")),
    Field("fault", "most", NUMBER, _named_fault("most")),
    Field("fault", "between", RANGE, _named_fault("between")),
    Field("fault", "unit", TEXT, _named_fault("unit")),
    *(Field("matrices", letter, MATRIX, _matrix(letter)) for letter in "ABCD"),
    Field("matrices", "G", MATRIX, Elsewhere(_state_disturbances)),
    Field("matrices", "F", MATRIX, Elsewhere(_unknown_on_states)),
    Field("matrices", "D_v", MATRIX, Elsewhere(_unknown_on_outputs)),
    Field("matrices", "E", MATRIX, Elsewhere(_unwritten)),  # the model that is written is solved for x+
)
TABLES = (*LISTS, "matrices", "provenance", "fit", "test")  # fit: how it was made, which `fit` reads


def field_names(place: str) -> tuple[str, ...]:
    """Return the names that a table of a model file may hold. place: its name, "" above all tables."""
    if place == "provenance":
        return PROVENANCE
    names = tuple(field.name for field in FIELDS if field.place == place)
    if not place:
        return names + TABLES
    return names


def entries(model: LinearSystem) -> Iterator[Entry]:
    """Yield the tables of the file of a model, in their order; its provenance stands behind them."""
    yield Entry("")
    counts = {
        "inputs": model.m,
        "outputs": model.p,
        "disturbances": model.g,
        "uncertainty": len(model.uncertainties),
        "fault": len(model.faults),
    }
    for place, count in counts.items():
        for number in range(count):
            yield Entry(place, number)
    yield Entry("matrices")


def value_texts(model: LinearSystem, entry: Entry) -> dict[str, str]:
    """Return {field: text of its value} of the fields of a table that are written."""
    texts = {}
    for field in FIELDS:
        if field.place == entry.place:
            value = field.home.value(model, field.name, entry)
            if value is not None:
                texts[field.name] = field.kind.spell(value)
    return texts


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
    top = {field.name: field for field in FIELDS if not field.place}
    tables["states"] = top["states"].kind.read("states", "", document.get("states", []))
    for place in LISTS:
        listed = as_list(place, document.get(place, []))
        tables[place] = [_read_entry(Entry(place, i), table) for i, table in enumerate(listed)]
    _refuse_half_of_a_pair(tables)
    tables[""] = [
        {name: top[name].kind.read(name, "", value) for name, value in document.items() if name in top}
    ]
    arguments: dict[str, Any] = {}
    for place in (*LISTS, "states", "matrices", ""):
        for field in FIELDS:
            if field.place == place:
                field.home.collect(arguments, field.name, place, tables[place])
    arguments |= _assembled(tables) | {"provenance": _read_provenance(document)}
    return arguments | {"tests": stated_tests(as_list("test", document.get("test", [])))}


def _read_matrices(document: Table) -> Table:
    if "matrices" not in document:
        raise ValueError(
            "the table [matrices] is missing: it holds A, B, C and, if there is a direct path, D"
        )
    matrices = as_table("[matrices]", document["matrices"])
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
    table = as_table("[provenance]", document.get("provenance", {}))
    return known_fields("[provenance]", table, PROVENANCE)


def _read_entry(entry: Entry, table: object) -> Table:
    """Check one table of several; return its values."""
    where = f"number {entry.number + 1} of {entry.place}"
    title = where  # with the name, where there is one: then a sentence goes on behind a comma
    if isinstance(table, dict) and "name" in table and entry.place != "disturbances":
        where = f"{where}, {table['name']!r}"
        title = f"{where},"
    table = known_fields(title, as_table(title, table), field_names(entry.place))
    if entry.place == "disturbances":
        if "bound" not in table:
            raise ValueError(f"{where} needs a bound: a number for |w| <= bound, or [lowest, highest]")
    elif "name" not in table:
        raise ValueError(f"{where} needs a name")
    kinds = {field.name: field.kind for field in FIELDS if field.place == entry.place}
    return {name: kinds[name].read(name, where, value) for name, value in table.items()}


def _refuse_half_of_a_pair(tables: Mapping[str, list[Table]]) -> None:
    """Raise ValueError where G stands without bounds of disturbances, or D_v without F."""
    (matrices,) = tables["matrices"]
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


def _assembled(tables: Mapping[str, list[Table]]) -> dict[str, Any]:
    """Return the arguments that several fields make together."""
    (top,) = tables[""]
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
    averages = {table["name"]: table["averages"] for table in tables["outputs"] if "averages" in table}
    for i, table in enumerate(tables["disturbances"]):
        if "averages" in table:
            averages[f"w{i + 1}"] = table["averages"]
    arguments["averages"] = averages
    return arguments
