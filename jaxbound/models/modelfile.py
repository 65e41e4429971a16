"""Model files: TOML in, TOML out, every decimal kept exactly.

Numbers are read as text (`0.1` is one tenth, not its nearest float) and written as text: as a decimal where a
finite one exists, else as a fraction in quotes, `"1/3"`. Saving and loading again therefore gives the same
model, Fraction by Fraction.
"""

import difflib
import json
import re
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

from jaxbound.files.whole import whole
from jaxbound.models.system import LinearSystem
from jaxbound.models.template import template
from jaxbound.models.uncertainty import Uncertainty, centred

__all__ = ["load_model", "model_text", "number_text", "save_model", "template"]

TOP = (
    "name",
    "dt",
    "horizon",
    "lags",
    "time",
    "where",
    "constant_tolerance",
    "states",
    "inputs",
    "outputs",
    "disturbances",
    "uncertainty",
    "decouple",
    "matrices",
    "provenance",
)
STATE = ("name", "unit")
INPUT = ("name", "unit", "column", "offset", "range")
OUTPUT = ("name", "unit", "column", "offset", "tolerance", "noise", "resolution", "averages")
DISTURBANCE = ("bound", "averages")
AVERAGE = ("samples", "weights", "bound")
MATRICES = ("A", "B", "C", "D", "G", "F", "D_v", "E")
PROVENANCE = ("model", "tolerance", "noise", "resolution", "disturbance")
RECORDED = (".csv", ".parquet", ".pq", ".tsv", ".xlsx")  # ends of names of what is no model
UNCERTAINTY = ("name", "varying", "between", "A", "B", "C", "D")


def load_model(path: str | PathLike[str]) -> LinearSystem:
    """Read a LinearSystem from a TOML file; `jaxbound info --template` prints a commented one.

    Args:
        path: of the file, UTF-8.

    Raises:
        OSError: no such file, or it cannot be read.
        ValueError: not TOML (names the line), an unknown field (names the nearest), numbers that do not make
            a model.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "tank.toml"
        >>> _ = path.write_text(template())
        >>> load_model(path).outputs
        ('level', 'flow')
    """
    import tomllib

    path, text = Path(path), ""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: a model file is needed")
    if not path.exists():
        raise FileNotFoundError(f"there is no model file {path}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        return _model(tomllib.loads(text, parse_float=str))
    except UnicodeDecodeError:
        raise ValueError(
            f"{path}: this is not a text file in UTF-8, so it is no model file{_swapped(path)}"
        ) from None
    except tomllib.TOMLDecodeError as e:
        raise ValueError(
            f"{path}: this is not valid TOML: {e}{_swapped(path) or _comma(text, str(e))}"
        ) from None
    except RecursionError:
        raise ValueError(f"{path}: this is no model file: its lists are nested too deeply") from None
    except ValueError as e:
        raise ValueError(f"{path}: {e}") from None


def _swapped(path):
    """Return what to add where a recording was given for a model."""
    return "; it looks like a recording: the model comes first" if path.suffix.lower() in RECORDED else ""


def _comma(text, failure):
    """Return what to add where the line that TOML stumbles over has a number with a decimal comma."""
    at = re.search(r"at line (\d+)", failure)
    line = text.splitlines()[int(at[1]) - 1 : int(at[1])] if at else []
    found = re.search(r"=\s*([-+]?\d+),(\d+)\s*(#.*)?$", line[0]) if line else None
    return f"; write {found[1]}.{found[2]} with a point" if found else ""


def save_model(model: LinearSystem, path: str | PathLike[str]) -> None:
    """Write a LinearSystem to a TOML file from which `load_model` reads the very same model.

    What the file held before is replaced, completely or not at all; only the commands of the shell ask first.

    Args:
        model: a LinearSystem. path: of the file to write.

    Raises:
        TypeError: not a LinearSystem. OSError: it cannot be written.
    """
    if not isinstance(model, LinearSystem):
        raise TypeError(f"save_model needs a LinearSystem, not {type(model).__name__}")
    with whole(path) as f:
        f.write(model_text(model).encode())


def number_text(x: Fraction | int) -> str:
    """Return an exact number as text that reads back as the same number: a decimal if there is a finite one,
    else "p/q".

    Example:
        >>> [number_text(Fraction(x)) for x in ("1/8", "1/3", "3e-9", "-2")]
        ['0.125', '1/3', '3e-9', '-2']
    """
    x = Fraction(x)
    twos, fives, rest = 0, 0, x.denominator
    while rest % 2 == 0:
        rest, twos = rest // 2, twos + 1
    while rest % 5 == 0:
        rest, fives = rest // 5, fives + 1
    if rest != 1:
        return f"{x.numerator}/{x.denominator}"
    places = max(twos, fives)
    digits = str(abs(x.numerator) * 10**places // x.denominator)
    sign, shift = "-" if x < 0 else "", 0
    if places == 0 and len(digits) > 15:
        kept = digits.rstrip("0")
        shift = len(digits) - len(kept)
        return f"{sign}{digits}" if shift < 6 else f"{sign}{_mantissa(kept)}e{len(digits) - 1}"
    if places > len(digits) + 4:
        return f"{sign}{_mantissa(digits)}e{len(digits) - 1 - places}"
    digits = digits.rjust(places + 1, "0")
    return f"{sign}{digits[:-places]}.{digits[-places:]}" if places else f"{sign}{digits}"


def _mantissa(digits):
    return f"{digits[0]}.{digits[1:]}" if len(digits) > 1 else digits


def _model(table):
    table = _known("the model", table, TOP)
    if "matrices" not in table:
        raise ValueError(
            "the table [matrices] is missing: it holds A, B, C and, if there is a direct path, D"
        )
    matrices = _known("[matrices]", _table("[matrices]", table["matrices"]), MATRICES)
    for letter in ("A", "C") if "D" not in matrices or "A" in matrices or "C" in matrices else ():
        if letter not in matrices:
            raise ValueError(f"[matrices] needs {letter}")
    if "dt" not in table:
        raise ValueError("dt is missing: the sampling period in seconds")
    for letter, rows in matrices.items():
        _rows(letter, rows)
    states = [{"name": s} if isinstance(s, str) else s for s in _list("states", table.get("states", []))]
    states = [_signal("states", i, s, STATE) for i, s in enumerate(states)]
    inputs = [_signal("inputs", i, s, INPUT) for i, s in enumerate(_list("inputs", table.get("inputs", [])))]
    outputs = [
        _signal("outputs", i, s, OUTPUT) for i, s in enumerate(_list("outputs", table.get("outputs", [])))
    ]
    averages = {s["name"]: _averages(s["name"], s["averages"]) for s in outputs if "averages" in s}
    for i, d in enumerate(_list("disturbances", table.get("disturbances", []))):
        if isinstance(d, dict) and "averages" in d:
            averages[f"w{i + 1}"] = _averages(f"number {i + 1} of disturbances", d["averages"])
    disturbances = [
        _disturbance(i, d) for i, d in enumerate(_list("disturbances", table.get("disturbances", [])))
    ]
    uncertainties = [
        _uncertainty(i, u) for i, u in enumerate(_list("uncertainty", table.get("uncertainty", [])))
    ]
    if ("G" in matrices) != bool(disturbances):
        raise ValueError(
            "a disturbance needs both G in [matrices] and, for each column of G, a [[disturbances]] block "
            "with its bound: "
            f"{'the blocks are' if 'G' in matrices else 'G is'} missing"
        )
    if "D_v" in matrices and "F" not in matrices:
        raise ValueError(
            "D_v says how unknown inputs act on the outputs: it needs F beside it, zeros where they do not "
            "act on a state"
        )
    columns = {s["name"]: s["column"] for s in inputs + outputs if "column" in s}
    columns |= {key: _string(key, table[key]) for key in ("time", "where") if key in table}
    ranges = {s["name"]: s["range"] for s in inputs if "range" in s}
    offset = {
        side: [s.get("offset", 0) for s in signals]
        for side, signals in (("u", inputs), ("y", outputs))
        if signals
    }
    bounds = {
        bound: [s.get(bound, 0) for s in outputs] for bound in ("tolerance", "noise", "resolution") if outputs
    }
    names = lambda signals: [s["name"] for s in signals] or None
    return LinearSystem(
        matrices.get("A"),
        matrices.get("B"),
        matrices.get("C"),
        matrices.get("D"),
        _number("dt", table["dt"]),
        inputs=names(inputs),
        outputs=names(outputs),
        states=names(states),
        units={s["name"]: s["unit"] for s in inputs + outputs + states if "unit" in s},
        offset=offset,
        columns=columns,
        ranges=ranges,
        **bounds,
        disturbance=(matrices["G"], disturbances) if disturbances else None,
        unknown_inputs=(matrices["F"], matrices["D_v"]) if "D_v" in matrices else matrices.get("F"),
        uncertainties=uncertainties,
        E=matrices.get("E"),
        decouple=[_string("decouple", name) for name in _list("decouple", table.get("decouple", []))],
        constant_tolerance=_truth("constant_tolerance", table.get("constant_tolerance", False)),
        provenance=_known("[provenance]", _table("[provenance]", table.get("provenance", {})), PROVENANCE),
        name=_string("name", table.get("name", "model")),
        horizon=table.get("horizon"),
        lags=None if "lags" not in table else _list("lags", table["lags"]),
        averages=averages,
    )


def _known(where, table, fields):
    """Return the table if it has known fields only."""
    for field in [f for f in table if f not in fields]:
        near = difflib.get_close_matches(field, fields, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(
            f"{where} has the unknown field {field!r}{hint}{'' if hint else ';'} known fields are "
            f"{', '.join(fields)}"
        )
    return table


def _table(where, value):
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table of fields")
    return value


def _list(field, value):
    if not isinstance(value, list):
        of = {"states": " of names", "decouple": " of names", "lags": " of whole numbers"}
        raise ValueError(f"{field} must be a list" + of.get(field, f": write [[{field}]] above each of them"))
    return value


def _string(field, value):
    if not isinstance(value, str):
        raise ValueError(f"{field} must be text in quotes, not {value!r}")
    return value


def _number(field, value):
    """Return the number as it stands in the file if floats can hold it; the length of an exact one is not
    bounded by anything else.
    """
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ValueError(f"{field} must be a number, not {value!r}")
    size = re.fullmatch(r"[^eE]*[eE]([-+]?[\d_]+)", value) if isinstance(value, str) else None
    try:
        fits = not (size and abs(int(size[1])) > 400) and (
            float(Fraction(value)) != 0 or Fraction(value) == 0
        )
    except (ValueError, ZeroDivisionError):
        return value  # LinearSystem says what is wrong with it
    except OverflowError:
        fits = False
    if not fits:
        raise ValueError(f"{field} is {str(value)[:40]}, which is too large or too small to compute with")
    return value


def _truth(field, value):
    if not isinstance(value, bool):
        raise ValueError(f"{field} must be true or false, not {value!r}")
    return value


def _signal(field, index, table, fields):
    """Check one [[inputs]], [[outputs]] or states entry."""
    where = f"number {index + 1} of {field}" + (
        f", {table['name']!r}," if isinstance(table, dict) and "name" in table else ""
    )
    table = _known(where, _table(where, table), fields)
    if "name" not in table:
        raise ValueError(f"{where} needs a name")
    for key, value in table.items():
        if key == "averages":
            _averages(where.rstrip(","), value)
        elif key == "range":
            if not isinstance(value, list) or len(value) != 2:
                raise ValueError(f"range of {where.rstrip(',')} must be [lowest, highest]")
            for end in value:
                _number(f"range of {where.rstrip(',')}", end)
        else:
            (_string if key in ("name", "unit", "column") else _number)(
                f"{key} of {where.rstrip(',')}", value
            )
    return table


def _disturbance(index, table):
    """Return the bound of one [[disturbances]] entry: a number, or a pair of them."""
    where = f"number {index + 1} of disturbances"
    table = _known(where, _table(where, table), DISTURBANCE)
    if "bound" not in table:
        raise ValueError(f"{where} needs a bound: a number for |w| <= bound, or [lowest, highest]")
    bound = table["bound"]
    return (
        [_number(f"bound of {where}", x) for x in bound]
        if isinstance(bound, list)
        else _number(f"bound of {where}", bound)
    )


def _averages(where, entries):
    """Return [(samples or weights, bound)] of a list of averages."""
    if not isinstance(entries, list):
        raise ValueError(f"averages of {where} must be a list, like [{{samples = 16, bound = 0.1}}]")
    found = []
    for entry in entries:
        entry = _known(f"an average of {where}", _table(f"an average of {where}", entry), AVERAGE)
        if "bound" not in entry or ("samples" in entry) == ("weights" in entry):
            raise ValueError(
                f"an average of {where} needs samples (how many consecutive ones) or weights (a list of "
                f"them), and a bound"
            )
        weights = entry.get("samples", entry.get("weights"))
        if isinstance(weights, list):
            weights = [_number(f"weights of {where}", x) for x in weights]
        elif "weights" in entry:
            raise ValueError(
                f"weights of an average of {where} must be a list of numbers, the oldest sample first"
            )
        found.append((weights, _number(f"bound of an average of {where}", entry["bound"])))
    return found


def _rows(field, rows):
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise ValueError(f"{field} must be a list of rows, like [[1, 0], [0, 1]]")
    for row in rows:
        for x in row:
            _number(field, x)


def _uncertainty(index: int, table: Any) -> Uncertainty:
    """Return one [[uncertainty]] entry."""
    where = f"number {index + 1} of uncertainty" + (
        f", {table['name']!r}," if isinstance(table, dict) and "name" in table else ""
    )
    table = _known(where, _table(where, table), UNCERTAINTY)
    if "name" not in table:
        raise ValueError(f"{where} needs a name")
    where = where.rstrip(",")
    for letter in "ABCD":
        if letter in table:
            _rows(f"{letter} of {where}", table[letter])
    between = table.get("between", [-1, 1])
    if not isinstance(between, list) or len(between) != 2:
        raise ValueError(f"between of {where} must be [lowest, highest]")
    return Uncertainty(
        _string(f"name of {where}", table["name"]),
        table.get("A"),
        table.get("B"),
        table.get("C"),
        table.get("D"),
        varying=_truth(f"varying of {where}", table.get("varying", True)),
        between=[_number(f"between of {where}", x) for x in between],
    )


def model_text(model: LinearSystem) -> str:
    """Return the TOML text of a model, from which `load_model` reads the very same model."""
    quote = lambda s: json.dumps(s, ensure_ascii=False).replace("\x7f", "\\u007f")
    number = lambda x: f'"{t}"' if "/" in (t := number_text(x)) else t
    rows = lambda a: "[\n" + "".join(f"    [{', '.join(map(number, row))}],\n" for row in a) + "]"

    def averages(signal):
        found = []
        for a in (a for a in model.averages if a.signal == signal):
            of = (
                f"samples = {len(a.weights)}"
                if a.is_mean
                else f"weights = [{', '.join(map(number, a.weights))}]"
            )
            found.append(f"{{{of}, bound = {number(a.bound)}}}")
        return [f"averages = [{', '.join(found)}]"] if found else []

    out = [f"name = {quote(model.name)}", f"dt = {number(Fraction(repr(model.dt)))}  # s"]
    if model.lags is not None:
        out.append(f"lags = [{', '.join(map(str, model.lags))}]")
    elif model.horizon is not None:
        out.append(f"horizon = {model.horizon}")
    out += [f"{key} = {quote(model.columns[key])}" for key in ("time", "where") if key in model.columns]
    if model.constant_tolerance:
        out.append("constant_tolerance = true")
    states = [
        f"{{name = {quote(s)}, unit = {quote(model.units[s])}}}" if s in model.units else quote(s)
        for s in model.states
    ]
    out.append(f"states = [{', '.join(states)}]")
    for side, field, names in (("u", "inputs", model.inputs), ("y", "outputs", model.outputs)):
        for i, name in enumerate(names):
            out += ["", f"[[{field}]]", f"name = {quote(name)}"]
            out += [
                f"{key} = {quote(about[name])}"
                for key, about in (("unit", model.units), ("column", model.columns))
                if name in about
            ]
            if model.offset[side][i]:
                out.append(f"offset = {number(model.offset[side][i])}")
            if name in model.ranges and side == "u":
                out.append(f"range = [{', '.join(map(number, model.ranges[name]))}]")
            if side == "y":
                bounds = (
                    ("tolerance", model.tolerance),
                    ("noise", model.noise),
                    ("resolution", model.resolution),
                )
                out += [f"{key} = {number(bound[i])}" for key, bound in bounds if bound[i]]
                out += averages(name)
    for j, (lo, hi) in enumerate(model.disturbance):
        out += [
            "",
            "[[disturbances]]",
            f"bound = {number(hi) if lo == -hi else f'[{number(lo)}, {number(hi)}]'}",
            *averages(f"w{j + 1}"),
        ]
    for u in model.uncertainties:
        out += ["", "[[uncertainty]]", f"name = {quote(u.name)}"]
        out += [] if u.varying else ["varying = false"]
        out += [] if u.between == (-1, 1) else [f"between = [{', '.join(map(number, u.between))}]"]
        out += [f"{letter} = {rows(getattr(u, letter))}" for letter in "ABCD" if getattr(u, letter)]
    A, B, C, D = (centred(getattr(model, letter), model.uncertainties, letter, sign=-1) for letter in "ABCD")
    out += ["", "[matrices]"]
    if model.n:
        out += [f"A = {rows(A)}", *([f"B = {rows(B)}"] if model.m else []), f"C = {rows(C)}"]
    if model.has_feedthrough or not model.n:
        out.append(f"D = {rows(D)}")
    if model.g:
        out.append(f"G = {rows(model.G)}")
    if model.d:
        out.append(f"F = {rows(model.F)}")
    if model.has_direct_unknown:
        out.append(f"D_v = {rows(model.D_v)}")
    if model.provenance:
        out += ["", "[provenance]", *(f"{key} = {quote(value)}" for key, value in model.provenance.items())]
    return "\n".join(out) + "\n"
