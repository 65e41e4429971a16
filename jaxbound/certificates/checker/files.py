"""A model file and a CSV file in their plainest forms, read by the standard library alone: what is not plain
is refused, never guessed.

A model is TOML as the page on model files describes it, without [matrices] E, decouple, where, every, factors
on noise, columns that are expressions, and conditions that are more than a column beside a number. Data are a
UTF-8 CSV file with a header, a row for each sample, and an empty cell or nan for a missing one.
"""

import csv
import re
import struct
import tomllib
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta
from fractions import Fraction as F
from operator import eq, ge, gt, le, lt, ne
from pathlib import Path
from typing import NamedTuple

from jaxbound.certificates.checker.claim import DOUBLE
from jaxbound.certificates.checker.polynomial import add_multiple, scale
from jaxbound.certificates.checker.words import Document, Ends, Matrix, Samples, Vector, insist

MORE = "is more than this script reads; jaxbound verify reads it"
LATE = F(1, 2)
"""Share of a sampling period by which a step of time may differ from it, else it is a gap."""
EPOCHS = (10**11, 10**3), (10**14, 10**6), (10**17, 10**9)
"""(a number from which on a time is no longer in seconds, how many of its unit a second has)."""
CONDITION = re.compile(
    r"(?P<name>[A-Za-z_]\w*)\s*(?P<sense>[<>]=?|[=!]=)\s*(?P<number>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?)"
)
COMPARED = dict(zip(("<", "<=", "==", "!=", ">=", ">"), (lt, le, eq, ne, ge, gt), strict=True))
CLOCK = ("time_of_day", "time_since_start", "pi")
"""Names in a condition that need no column."""
CALLED = re.compile(
    r"(date[ _-]?time|time[ _-]?stamp|time|zeit(stempel|punkt)?|horodatage|heure|fecha|hora|tiempo|tijd|"
    r"tijdstip|tid|czas|date|datum|data)\b|t(\s*[\[(/,].*)?$"
)
STAMP = re.compile(
    r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}|\d{8}T|\d{1,2}:\d{2}|(19|2[01])\d{10}(\d\d)?$|"
    r"\d{1,2}[- ][a-z]{3}[- ]\d{2,4}|[a-z]{3} \d{1,2},? \d{4}",
    re.IGNORECASE,
)
"""What a column of times is called, and what its cells look like: of any format, so that none is overlooked
that jaxbound reads.
"""


class Condition(NamedTuple):
    """A condition of a test: a column beside a number. Fields: column; holds; number; text: as stated."""

    column: str
    holds: Callable[[F, F], bool]
    number: F
    text: str


class Model(NamedTuple):
    """A model file. Fields: numbers: see `claim.claim_of`; names: of a certificate; columns: of inputs and
    outputs; time: column of the time, or None; dt: sampling period; condition: of the test, or None.
    """

    numbers: Document
    names: Document
    columns: list[str]
    time: str | None
    dt: F
    condition: Condition | None


def read_model(path: Path, test: object = None) -> Model:
    """Return the Model of a model file, with the condition of a test that has the numbers of the file itself.

    Args:
        test: its name; None: the certificate names none.

    Raises:
        OSError, ValueError: it cannot be read, states no such test, or is more than this reader understands:
            `jaxbound verify` reads every model.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8-sig"), parse_float=str)
    matrices = table["matrices"]
    insist("C" in matrices or "D" in matrices, f"{path}: C, or D where there are no states, is missing")
    for field in ("decouple", "where", "every", "recording"):
        insist(field not in table, f"{path}: {field} {MORE}")
    insist("E" not in matrices, f"{path}: E {MORE}")
    inputs, outputs = table.get("inputs", []), table.get("outputs", [])
    disturbances = table.get("disturbances", [])
    at_once: Matrix = matrices.get("D", [])
    n, p = len(matrices.get("A", [])), len(matrices.get("C", at_once))
    m, d = _width(matrices.get("B", [])) or _width(at_once), _width(matrices.get("F", []))
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    shapes |= {"G": (n, len(disturbances)), "F": (n, d), "D_v": (p, d)}
    numbers: Document = {name: _matrix(matrices.get(name), *shape) for name, shape in shapes.items()}
    numbers["offset_u"], numbers["offset_y"] = _each(inputs, "offset", m), _each(outputs, "offset", p)
    for signal in outputs:
        insist(not isinstance(signal.get("noise"), dict), f"{path}: a factor on noise {MORE}")
    for bound in ("tolerance", "noise", "resolution"):
        numbers[bound] = _each(outputs, bound, p)
    numbers["disturbance"] = [_pair(signal["bound"]) for signal in disturbances]
    numbers["averages"] = _averages(outputs, True) + _averages(disturbances, False)
    numbers["constant"], numbers["lags"] = table.get("constant_tolerance", False), None
    if "lags" in table:
        numbers["lags"] = sorted(map(int, table["lags"]))
    # each moves the model to the middle of its range
    numbers["uncertainties"] = [_parameter(one, numbers, shapes) for one in table.get("uncertainty", [])]

    names = _names(table, {"states": ("x", n), "inputs": ("u", m), "outputs": ("y", p)})
    stated = {signal["name"]: signal.get("column", signal["name"]) for signal in inputs + outputs}
    columns = [stated.get(name, name) for name in names["inputs"] + names["outputs"]]
    for column in columns:
        insist(not column.startswith("="), f"{path}: the column {column!r} {MORE}")
    of_inputs = dict(zip(names["inputs"], columns, strict=False))
    condition = _condition(path, table.get("test", []), test, of_inputs)
    return Model(numbers, names, columns, table.get("time"), F(str(table["dt"])), condition)


def _condition(path: Path, tests: list[Document], name: object, columns: dict[str, str]) -> Condition | None:
    """Return the condition of a test; None: it always watches, or the file states no tests."""
    if not tests:
        return None
    insist(
        name is not None,
        f"the certificate names no test, and {path} states tests with bounds of their own: give "
        f"tested_model.toml of the report",
    )
    found = [one for one in tests if one["name"] == name]
    insist(len(found) == 1, f"the certificate is of test {name!r}, which the model does not state")
    for field in ("factor", "lags", "model"):
        insist(field not in found[0], f"{path}: {field} of a test {MORE}")
    text = found[0].get("when")
    if text is None:
        return None
    stated = CONDITION.fullmatch(text.strip())
    if stated is None or stated["name"] in CLOCK:
        raise ValueError(f"{path}: when = {text!r} of a test {MORE}")
    column, sense, number = stated.group("name", "sense", "number")
    return Condition(columns.get(column, column), COMPARED[sense], F(float(number)), text)


def _names(table: Document, kinds: dict[str, tuple[str, int]]) -> Document:
    """Return the names of a model and of its signals, those that it does not state by letter and number."""
    names: Document = {"model": table.get("name", "model")}
    units: dict[str, str] = {}
    for kind, (letter, count) in kinds.items():
        numbered = [f"{letter}{i + 1}" for i in range(count)]
        names[kind] = []
        for signal in table.get(kind, []):
            if isinstance(signal, str):
                signal = {"name": signal}
            names[kind].append(signal["name"])
            if "unit" in signal:
                units[signal["name"]] = signal["unit"]
        names[kind] = names[kind] or numbered
    names["units"] = units
    if table.get("uncertainty"):
        names["parameters"] = [parameter["name"] for parameter in table["uncertainty"]]
    return names


def read_samples(
    path: Path, model: Model, last: int, count: int, precision: str = DOUBLE
) -> tuple[Samples, list[str] | None]:
    """Return (count rows of samples that end at sample `last`, the text of their times or None).

    Args:
        model: its columns; a time that is None is the column that looks like it, if there is one.
        precision: float type to which a number of the file is rounded.

    Raises:
        OSError, ValueError: no such column or sample, a cell that is no number, a row of another width,
            samples across a gap in time, or at which the condition is not known to hold.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        header, *rows = csv.reader(file, strict=True)
    header = list(map(str.strip, header))
    time = model.time or _likely_time(header, rows, model.columns)
    wanted = [*model.columns, *filter(None, (time, model.condition and model.condition.column))]
    for column in wanted:
        found = header.count(column)
        insist(found == 1, f"{path}: there must be one column {column!r}, there are {found}")
    insist(
        count - 1 <= last < len(rows),
        f"{path}: there are no {count} samples that end at sample {last} among its {len(rows)} rows",
    )
    samples, times = [], []
    for k in range(last - count + 1, last + 1):
        width = len(rows[k])
        insist(width == len(header), f"{path}: sample {k} has {width} cells, the header {len(header)}")
        cells = dict(zip(header, rows[k], strict=True))
        samples.append([_cell(cells[column], precision, path, k) for column in model.columns])
        if model.condition is not None:
            column, holds, number, when = model.condition
            cell = _cell(cells[column], DOUBLE, path, k)
            known = cell is not None and holds(cell, number)
            insist(known, f"the test watches when {when}, which is not known to hold at sample {k}")
        if time is not None:
            times.append(cells[time].strip())
    if time is None:
        return samples, None
    for one, other in zip(times, times[1:], strict=False):
        (begin, zoned), (end, also) = _seconds(one), _seconds(other)
        insist(zoned == also, f"{path}: of {one} and {other} one alone has an offset from UTC")
        insist(
            abs(end - begin - model.dt) <= LATE * model.dt,
            f"{path}: from {one} to {other} is no step of {model.dt} s: the samples lie across a gap in time",
        )
    return samples, times


def _cell(text: str, precision: str, path: Path, k: int) -> F | None:
    """Return the number of a cell, the nearest float of a type exactly, None where it is missing."""
    if text.strip().lower() in ("", "nan"):
        return None
    try:
        value = float(text)
        exact = F(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{path}: sample {k} has a cell {text!r}, which is no number") from None
    if precision == DOUBLE:
        return exact
    return F(*struct.unpack("<f", struct.pack("<f", value)))


def _likely_time(header: Sequence[str], rows: Sequence[Sequence[str]], columns: Sequence[str]) -> str | None:
    """Return the column that is called like a time, or else holds time stamps; None: there is none.

    Raises:
        ValueError: there are several.
    """
    called, stamped = [], []
    for i, name in enumerate(header):
        if name in columns:
            continue
        if CALLED.match(name.lower()):
            called.append(name)
        elif any(STAMP.match(cell.strip()) for row in rows for cell in row[i : i + 1]):
            stamped.append(name)
    called = called or stamped
    insist(len(called) < 2, f"{' and '.join(called)} look like times: name the column of the time by --time")
    return next(iter(called), None)


def _seconds(text: str) -> tuple[F, bool]:
    """Return (a time of the data in seconds, whether it has an offset from UTC): a number of seconds, or of
    milliseconds and less since 1970, or a time stamp in ISO 8601.

    Raises:
        ValueError: another one.
    """
    try:
        number = F(text)
    except ValueError:
        pass
    else:
        # no run lasts 3 000 years: so large a number is in milliseconds, or finer
        finer = [unit for least, unit in EPOCHS if abs(number) >= least]
        return number / max(finer, default=1), False
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"{text!r} is a time that this script does not read: jaxbound verify may, --time names the column"
        ) from None
    offset = moment.utcoffset()
    since = moment.replace(tzinfo=None) - (offset or timedelta(0)) - datetime(1970, 1, 1)
    return F(str(since.total_seconds())), offset is not None


def _width(rows: Sequence[Sequence[object]]) -> int:
    return len(next(iter(rows), ()))


def _matrix(rows: Sequence[Sequence[object]] | None, height: int, width: int) -> Matrix:
    """Return rows of exact numbers, of zeros where there is no matrix."""
    if not rows:
        return [[F(0)] * width for _ in range(height)]
    insist(
        len(rows) == height and all(len(row) == width for row in rows),
        "a matrix has another shape than the others ask for",
    )
    return [_exact(row) for row in rows]


def _exact(values: Iterable[object]) -> Vector:
    return [F(str(x)) for x in values]


def _each(signals: Sequence[Document], field: str, count: int) -> Vector:
    """Return a field of each signal, 0 where it is not stated, or where no signal is."""
    return _exact(signal.get(field, 0) for signal in signals) or [F(0)] * count


def _pair(bound: object) -> Ends:
    """Return (lo, hi) of a bound that is a pair, or a size of either sign."""
    if isinstance(bound, list):
        lo, hi = _exact(bound)
        return lo, hi
    size = F(str(bound))
    return -size, size


def _averages(signals: Sequence[Document], measured: bool) -> list[Document]:
    averages = []
    for i, signal in enumerate(signals):
        for average in signal.get("averages", []):
            weights, bound = average.get("weights"), F(str(average["bound"]))
            if weights is None:
                weights = [F(1, average["samples"])] * average["samples"]
            entry = {"output": F(measured), "number": F(i), "weights": _exact(weights), "bound": bound}
            averages.append(entry)
    return averages


def _parameter(table: Document, model: Document, shapes: dict[str, tuple[int, int]]) -> Document:
    """Return a parameter as half its width times what it multiplies, and move the model to the middle of
    it.
    """
    lo, hi = _exact(table.get("between", [-1, 1]))
    out: Document = {"varying": F(table.get("varying", True))}
    for letter in "ABCD":
        out[letter] = None
        if not table.get(letter):
            continue
        change = _matrix(table[letter], *shapes[letter])
        out[letter] = [scale(by, (hi - lo) / 2) for by in change]
        for row, by in zip(model[letter], change, strict=True):
            row[:] = add_multiple(row, (lo + hi) / 2, by)
    return out
