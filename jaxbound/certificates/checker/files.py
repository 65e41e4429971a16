"""A model file and a CSV file in their plainest forms, read by the standard library alone: what is not plain
is refused, never guessed.

A model is TOML as the page on model files describes it, without [matrices] E, decouple, where, every, factors
on noise, columns that are expressions, and conditions that are more than a column beside a number. Data are a
UTF-8 CSV file with a header, a row for each sample, and an empty cell or nan for a missing one.
"""

import csv
import operator
import re
import struct
import tomllib
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from fractions import Fraction as F
from pathlib import Path
from typing import NamedTuple

from jaxbound.certificates.checker.claim import DOUBLE
from jaxbound.certificates.checker.words import Document, Ends, Matrix, Samples, Vector, insist

__all__ = ["Condition", "read_condition", "read_model", "read_samples"]

ZERO = F(0)
LATE = F(1, 2)
"""Share of a sampling period by which a step of time may differ from it, else it is a gap."""
EPOCHS = (10**11, 10**3), (10**14, 10**6), (10**17, 10**9)
"""(a number from which on a time is no longer in seconds, how many of its unit a second has)."""
CONDITION = re.compile(
    r"(?P<name>[A-Za-z_]\w*)\s*(?P<sense>[<>]=?|[=!]=)\s*(?P<number>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d{1,2})?)"
)
COMPARED = {
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">=": operator.ge,
    ">": operator.gt,
}
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


def read_model(path: Path) -> tuple[Document, Document, list[str], str | None, F]:
    """Return (model, names, columns of inputs and outputs, column of the time or None, sampling period) of a
    model file.

    Raises:
        OSError, ValueError: it cannot be read, or is more than this reader understands: `jaxbound verify`
            reads every model.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8-sig"), parse_float=str)
    matrices = table["matrices"]
    insist("C" in matrices or "D" in matrices, f"{path}: C, or D where there are no states, is missing")
    for field, place in (("decouple", table), ("where", table), ("every", table), ("E", matrices)):
        insist(
            field not in place, f"{path}: {field} is more than this script reads; jaxbound verify reads it"
        )
    inputs, outputs, disturbances = (table.get(kind, []) for kind in ("inputs", "outputs", "disturbances"))
    shapes = _shapes(matrices, len(disturbances))
    n, (p, m) = shapes["A"][0], shapes["D"]
    model: Document = {}
    for letter, shape in shapes.items():
        model[letter] = _matrix(matrices.get(letter), *shape)
    model["offset_u"], model["offset_y"] = _each(inputs, "offset", m), _each(outputs, "offset", p)
    for signal in outputs:
        insist(
            not isinstance(signal.get("noise"), dict),
            f"{path}: a factor on noise is more than this script reads; jaxbound verify reads it",
        )
    for bound in ("tolerance", "noise", "resolution"):
        model[bound] = _each(outputs, bound, p)
    model["disturbance"] = [_pair(signal["bound"]) for signal in disturbances]
    model["averages"] = _averages(outputs, True) + _averages(disturbances, False)
    model["constant"] = table.get("constant_tolerance", False)
    model["lags"] = None
    if "lags" in table:
        model["lags"] = sorted(map(int, table["lags"]))
    model["uncertainties"] = []
    for parameter in table.get("uncertainty", []):  # each moves the model to the middle of its range
        model["uncertainties"].append(_parameter(parameter, model, shapes))

    names = _names(table, n, m, p)
    columns = {signal["name"]: signal.get("column", signal["name"]) for signal in inputs + outputs}
    read = [columns.get(name, name) for name in names["inputs"] + names["outputs"]]
    for column in read:
        insist(
            not column.startswith("="),
            f"{path}: the column {column!r} is more than this script reads; jaxbound verify reads it",
        )
    return model, names, read, table.get("time"), F(str(table["dt"]))


def _shapes(matrices: Document, disturbances: int) -> dict[str, tuple[int, int]]:
    """Return the shape of each matrix, from those that a model file states."""
    at_once: Matrix = matrices.get("D", [])
    n, p = len(matrices.get("A", [])), len(matrices.get("C", at_once))
    m = _width(matrices.get("B", [])) or _width(at_once)
    d = _width(matrices.get("F", []))
    return {
        "A": (n, n),
        "B": (n, m),
        "C": (p, n),
        "D": (p, m),
        "G": (n, disturbances),
        "F": (n, d),
        "D_v": (p, d),
    }


class Condition(NamedTuple):
    """A condition of a test: a column beside a number. Fields: column; holds: asked with both; number; text:
    as the model states it.
    """

    column: str
    holds: Callable[[F, F], bool]
    number: F
    text: str

    def insist_holds(self, cell: F | None, k: int) -> None:
        """Raise ValueError unless it holds at sample k."""
        known = cell is not None and self.holds(cell, self.number)
        insist(known, f"the test watches when {self.text}, which is not known to hold at sample {k}")


def read_condition(path: Path, test: object, columns: Sequence[str]) -> Condition | None:
    """Return the condition of a test that has the numbers of the model file itself; None: it always watches,
    or the file states no tests.

    Args:
        test: its name; None: the certificate names none. columns: of the inputs and outputs.

    Raises:
        ValueError: no such test, or none that this reader understands.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8-sig"), parse_float=str)
    tests = table.get("test", [])
    if not tests:
        return None
    insist(
        test is not None,
        f"the certificate names no test, and {path} states tests with bounds of their own: give "
        f"tested_model.toml of the report",
    )
    found = [one for one in tests if one["name"] == test]
    insist(len(found) == 1, f"the certificate is of test {test!r}, which the model does not state")
    more = "of a test is more than this script reads; jaxbound verify reads it"
    for field in ("factor", "lags", "model"):
        insist(field not in found[0], f"{path}: {field} {more}")
    text = found[0].get("when")
    if text is None:
        return None
    stated = CONDITION.fullmatch(text.strip())
    if stated is None or stated["name"] in CLOCK:
        raise ValueError(f"{path}: when = {text!r} {more}")
    name, sense, number = stated.group("name", "sense", "number")
    inputs = [signal["name"] for signal in table.get("inputs", [])]
    column = {name: name, **dict(zip(inputs, columns, strict=False))}[name]
    return Condition(column, COMPARED[sense], F(float(number)), text)


def _names(table: Document, n: int, m: int, p: int) -> Document:
    """Return the names of a model and of its signals, those that it does not state by number."""
    stated: dict[str, list[Document]] = {"states": []}
    for state in table.get("states", []):
        if isinstance(state, str):
            state = {"name": state}
        stated["states"].append(state)
    stated["inputs"], stated["outputs"] = table.get("inputs", []), table.get("outputs", [])
    names: Document = {"model": table.get("name", "model")}
    for kind, letter, count in (("states", "x", n), ("inputs", "u", m), ("outputs", "y", p)):
        numbered = [f"{letter}{i + 1}" for i in range(count)]
        names[kind] = [signal["name"] for signal in stated[kind]] or numbered
    names["units"] = {}
    for signal in stated["inputs"] + stated["outputs"] + stated["states"]:
        if "unit" in signal:
            names["units"][signal["name"]] = signal["unit"]
    if table.get("uncertainty"):
        names["parameters"] = [parameter["name"] for parameter in table["uncertainty"]]
    return names


def read_samples(
    path: Path,
    columns: Sequence[str],
    time: str | None,
    dt: F,
    last: int,
    count: int,
    precision: str = DOUBLE,
    condition: Condition | None = None,
) -> tuple[Samples, list[str] | None]:
    """Return (count rows of samples that end at sample `last`, the text of their times or None).

    Args:
        columns: of the signals. time: column of the time; None: the one that looks like it, if there is one.
            dt: sampling period in seconds. precision: float type to which a number of the file is rounded.
        condition: that has to hold at each of them; None: there is none.

    Raises:
        OSError, ValueError: no such column or sample, a cell that is no number, a row of another width,
            samples across a gap in time, or at which the condition is not known to hold.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        header, *rows = csv.reader(file, strict=True)
    header = [name.strip() for name in header]
    wanted = list(columns)
    if condition is not None:
        wanted.append(condition.column)
    if time is None:
        time = _likely_time(header, rows, columns)
    if time is not None:
        wanted.append(time)
    for column in wanted:
        insist(
            header.count(column) == 1,
            f"{path}: there must be one column {column!r}, there are {header.count(column)}",
        )
    insist(
        count - 1 <= last < len(rows),
        f"{path}: there are no {count} samples that end at sample {last} among its {len(rows)} rows",
    )
    samples, times = [], []
    for k in range(last - count + 1, last + 1):
        insist(
            len(rows[k]) == len(header),
            f"{path}: sample {k} has {len(rows[k])} cells, the header {len(header)}",
        )
        samples.append([_cell(rows[k][header.index(column)], precision, path, k) for column in columns])
        if condition is not None:
            condition.insist_holds(_cell(rows[k][header.index(condition.column)], DOUBLE, path, k), k)
        if time is not None:
            times.append(rows[k][header.index(time)].strip())
    if time is None:
        return samples, None
    for one, other in zip(times, times[1:], strict=False):
        (begin, zoned), (end, also) = _seconds(one), _seconds(other)
        insist(zoned == also, f"{path}: of {one} and {other} one alone has an offset from UTC")
        insist(
            abs(end - begin - dt) <= LATE * dt,
            f"{path}: from {one} to {other} is no step of {dt} s: the samples lie across a gap in time",
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
    free = [i for i, name in enumerate(header) if name not in columns]
    called = [header[i] for i in free if CALLED.match(header[i].lower())]
    if not called:
        stamped = {i for row in rows for i, cell in enumerate(row) if STAMP.match(cell.strip())}
        called = [header[i] for i in free if i in stamped]
    insist(len(called) < 2, f"{' and '.join(called)} look like times: name the column of the time by --time")
    if not called:
        return None
    return called[0]


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
        finer = [unit for least, unit in EPOCHS if abs(number) >= least]
        return number / max(finer, default=1), False
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(
            f"{text!r} is a time that this script does not read: jaxbound verify may, --time names the column"
        ) from None
    since = datetime(1970, 1, 1)
    zoned = moment.tzinfo is not None
    if zoned:
        since = since.replace(tzinfo=UTC)  # an instant, whatever the offset of its clock
    return F(str((moment - since).total_seconds())), zoned


def _width(rows: Sequence[Sequence[object]]) -> int:
    if not rows:
        return 0
    return len(rows[0])


def _matrix(rows: Sequence[Sequence[object]] | None, height: int, width: int) -> Matrix:
    """Return rows of exact numbers, of zeros where there is no matrix."""
    if not rows:
        return [[ZERO] * width for _ in range(height)]
    insist(
        len(rows) == height and all(len(row) == width for row in rows),
        "a matrix has another shape than the others ask for",
    )
    return [_exact(row) for row in rows]


def _exact(values: Iterable[object]) -> Vector:
    return [F(str(x)) for x in values]


def _each(signals: Sequence[Document], field: str, count: int) -> Vector:
    """Return a field of each signal, 0 where it is not stated, or where no signal is."""
    return _exact(signal.get(field, 0) for signal in signals) or [ZERO] * count


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
            if "weights" in average:
                weights = _exact(average["weights"])
            else:
                weights = [F(1, average["samples"])] * average["samples"]
            bound = F(str(average["bound"]))
            averages.append({"output": F(measured), "number": F(i), "weights": weights, "bound": bound})
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
        out[letter] = []
        for row, by in zip(model[letter], change, strict=True):
            out[letter].append([(hi - lo) / 2 * x for x in by])
            row[:] = [a + (lo + hi) / 2 * b for a, b in zip(row, by, strict=True)]
    return out
