"""A model file and a CSV file in their plainest forms, read by the standard library alone: what is not plain
is refused, never guessed.

A model is TOML as the page on model files describes it, without [matrices] E, decouple, where, and columns
that are expressions. Data are a UTF-8 CSV file with a header, a row for each sample, and an empty cell or nan
for a missing one.
"""

import csv
import struct
import tomllib
from collections.abc import Sequence
from datetime import datetime
from fractions import Fraction as F
from pathlib import Path
from typing import Any

from jaxbound.certificates.checker.claim import DOUBLE
from jaxbound.certificates.checker.trajectories import insist

__all__ = ["read_model", "read_samples"]

ZERO = F(0)
LATE = F(1, 2)
"""Share of a sampling period by which a step of time may differ from it, else it is a gap."""


def read_model(path: Path) -> tuple[dict[str, Any], dict[str, Any], list[str], str | None, F]:
    """Return (model, names, columns of inputs and outputs, column of the time or None, sampling period) of a
    model file.

    Raises:
        OSError, ValueError: it cannot be read, or is more than this reader understands: `jaxbound verify`
            reads every model.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8-sig"), parse_float=str)
    matrices = table["matrices"]
    for field in ("decouple", "where"):
        insist(
            field not in table, f"{path}: {field} is more than this script reads; jaxbound verify reads it"
        )
    insist("E" not in matrices, f"{path}: E is more than this script reads; jaxbound verify reads it")
    inputs, outputs, disturbances = (table.get(kind, []) for kind in ("inputs", "outputs", "disturbances"))
    states = [{"name": s} if isinstance(s, str) else s for s in table.get("states", [])]
    n, p = len(matrices.get("A", [])), len(matrices["C"] if "C" in matrices else matrices["D"])
    m = _width(matrices.get("B", [])) or _width(matrices.get("D", []))
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m), "G": (n, len(disturbances))}
    shapes |= {"F": (n, _width(matrices.get("F", []))), "D_v": (p, _width(matrices.get("F", [])))}
    model: dict[str, Any] = {}
    for letter, shape in shapes.items():
        model[letter] = _matrix(matrices.get(letter), *shape)
    model |= {
        f"offset_{side}": _each(signals, "offset", k)
        for side, signals, k in (("u", inputs, m), ("y", outputs, p))
    }
    model |= {bound: _each(outputs, bound, p) for bound in ("tolerance", "noise", "resolution")}
    model["disturbance"] = [_pair(d["bound"]) for d in disturbances]
    model["averages"] = _averages(outputs, True) + _averages(disturbances, False)
    model["constant"] = table.get("constant_tolerance", False)
    model["lags"] = None if "lags" not in table else sorted(int(lag) for lag in table["lags"])
    model["uncertainties"] = [
        _parameter(parameter, model, shapes) for parameter in table.get("uncertainty", [])
    ]
    names: dict[str, Any] = {"model": table.get("name", "model")}
    for kind, signals, letter, count in (
        ("states", states, "x", n),
        ("inputs", inputs, "u", m),
        ("outputs", outputs, "y", p),
    ):
        names[kind] = [s["name"] for s in signals] or [f"{letter}{i + 1}" for i in range(count)]
    names["units"] = {s["name"]: s["unit"] for s in inputs + outputs + states if "unit" in s}
    if model["uncertainties"]:
        names["parameters"] = [parameter["name"] for parameter in table["uncertainty"]]
    stated = {s["name"]: s.get("column", s["name"]) for s in inputs + outputs}
    columns = [stated.get(name, name) for name in names["inputs"] + names["outputs"]]
    for column in columns:
        insist(
            not column.startswith("="),
            f"{path}: the column {column!r} is more than this script reads; jaxbound verify reads it",
        )
    return model, names, columns, table.get("time"), F(str(table["dt"]))


def read_samples(
    path: Path,
    columns: Sequence[str],
    time: str | None,
    dt: F,
    last: int,
    count: int,
    precision: str = DOUBLE,
) -> tuple[list[list[F | None]], list[str] | None]:
    """Return (count rows of samples that end at sample `last`, the text of their times or None).

    Args:
        columns: of the signals. time: column of the time; None: the data have none. dt: sampling period in
            seconds. precision: float type
        to which a number of the file is rounded.

    Raises:
        OSError, ValueError: no such column or sample, a cell that is no number, a row of another width,
            samples across a gap in time.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        header, *rows = csv.reader(file, strict=True)
    header = [name.strip() for name in header]
    for column in (*columns, *([] if time is None else [time])):
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
        if time is not None:
            times.append(rows[k][header.index(time)].strip())
    if time is None:
        return samples, None
    for one, other in zip(times, times[1:], strict=False):
        step = _seconds(other) - _seconds(one)
        insist(
            abs(step - dt) <= LATE * dt,
            f"{path}: from {one} to {other} is no step of {dt} s: the samples lie across a gap in time",
        )
    return samples, times


def _cell(text, precision, path, k):
    """Return the number of a cell, the nearest float of a type exactly, None where it is missing."""
    if text.strip().lower() in ("", "nan"):
        return None
    try:
        value = float(text)
        exact = F(value)
    except (ValueError, OverflowError):
        raise ValueError(f"{path}: sample {k} has a cell {text!r}, which is no number") from None
    return exact if precision == DOUBLE else F(*struct.unpack("<f", struct.pack("<f", value)))


def _seconds(text):
    try:
        return F(text)
    except ValueError:
        pass
    moment = datetime.fromisoformat(text)
    return F(str((moment - datetime(1970, 1, 1, tzinfo=moment.tzinfo)).total_seconds()))


def _width(rows):
    return len(rows[0]) if rows else 0


def _matrix(rows, height, width):
    """Return rows of exact numbers, of zeros where there is no matrix."""
    if not rows:
        return [[ZERO] * width for _ in range(height)]
    insist(
        len(rows) == height and all(len(row) == width for row in rows),
        "a matrix has another shape than the others ask for",
    )
    return [[F(str(x)) for x in row] for row in rows]


def _each(signals, field, count):
    return [F(str(s.get(field, 0))) for s in signals] or [ZERO] * count


def _pair(bound):
    if isinstance(bound, list):
        lo, hi = bound
        return F(str(lo)), F(str(hi))
    return -F(str(bound)), F(str(bound))


def _averages(signals, measured):
    found = []
    for i, signal in enumerate(signals):
        for average in signal.get("averages", []):
            weights = (
                average["weights"]
                if "weights" in average
                else [F(1, average["samples"])] * average["samples"]
            )
            numbers = [F(str(x)) for x in weights]
            found.append(
                {"output": F(measured), "number": F(i), "weights": numbers, "bound": F(str(average["bound"]))}
            )
    return found


def _parameter(table, model, shapes):
    """Return a parameter as half its width times what it multiplies, and move the model to the middle of
    it.
    """
    lo, hi = (F(str(x)) for x in table.get("between", [-1, 1]))
    out: dict[str, Any] = {"varying": F(table.get("varying", True))}
    for letter in "ABCD":
        out[letter] = None
        if table.get(letter):
            change = _matrix(table[letter], *shapes[letter])
            out[letter] = [[(hi - lo) / 2 * x for x in row] for row in change]
            for row, by in zip(model[letter], change, strict=True):
                row[:] = [a + (lo + hi) / 2 * b for a, b in zip(row, by, strict=True)]
    return out
