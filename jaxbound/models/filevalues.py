"""The kinds of values in a model file: each is checked on the way in and spelled on the way out.

Numbers are read as text (`0.1` is one tenth, not its nearest float) and written as text: as a decimal where a
finite one exists, else as a fraction in quotes, `"1/3"`.
"""

import difflib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from jaxbound.exact.linalg import Matrix
from jaxbound.models.average import Average

Table: TypeAlias = dict[str, Any]
"""A table as TOML has it."""
Stated: TypeAlias = tuple[int | str | list[int | str], int | str]
"""(samples or weights, bound) of an average."""

AVERAGE = ("samples", "weights", "bound")
TIMES = ("bound", "times")
LARGEST_EXPONENT = 400  # no float is that large, and an exact number would take as many digits
LONG = 15  # digits of a whole number that is written without an exponent


@dataclass(frozen=True)
class ValueKind:
    """A kind of value.

    Fields:
        read: (its field, where that stands or "", value as TOML has it) -> value as `LinearSystem` takes it.
            Raises ValueError with a sentence that names the field.
        spell: value of a model -> text of TOML.
    """

    read: Callable[[str, str, Any], Any]
    spell: Callable[[Any], str]


def known_fields(where: str, table: Table, fields: Sequence[str]) -> Table:
    """Return the table if it has known fields only.

    Raises:
        ValueError: another field, with the nearest of the known ones.
    """
    for field in table:
        if field in fields:
            continue
        near = difflib.get_close_matches(field, fields, n=1, cutoff=0.5)
        known = f"known fields are {', '.join(fields)}"
        if near:
            known = f"did you mean {near[0]!r}? {known}"
        raise ValueError(f"{where} has the unknown field {field!r}; {known}")
    return table


def checked_table(where: str, value: object) -> Table:
    """Return a table, checked."""
    if not isinstance(value, dict):
        raise ValueError(f"{where} must be a table of fields")
    return value


def as_list(field: str, value: object) -> list[Any]:
    """Return a list, checked."""
    if isinstance(value, list):
        return value
    elements = {"states": " of names", "decouple": " of names", "lags": " of whole numbers"}
    raise ValueError(
        f"{field} must be a list" + elements.get(field, f": write [[{field}]] above each of them")
    )


def in_list(texts: Iterable[str]) -> str:
    """Return texts as a list on one line."""
    return f"[{', '.join(texts)}]"


def _named(field: str, where: str) -> str:
    return f"{field} of {where}" if where else field


def _read_text(field: str, where: str, value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{_named(field, where)} must be text in quotes, not {value!r}")
    return value


def _quoted(text: str) -> str:
    # JSON and TOML quote alike, but for DEL, which TOML does not allow in a text
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _read_number(field: str, where: str, value: object) -> int | str:
    """Return the number as it stands in the file, if floats can hold it: nothing else bounds the length of an
    exact one.
    """
    name = _named(field, where)
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ValueError(f"{name} must be a number, not {value!r}")
    try:
        fits = _fits_a_float(value)
    except (ValueError, ZeroDivisionError):
        return value  # LinearSystem says what is wrong with it
    if not fits:
        raise ValueError(f"{name} is {str(value)[:40]}, which is too large or too small to compute with")
    return value


def _fits_a_float(value: int | str) -> bool:
    # The exponent comes first: a Fraction of 1e999999999 would take all memory.
    if isinstance(value, str):
        exponent = re.fullmatch(r"[^eE]*[eE]([-+]?[\d_]+)", value)
        if exponent and abs(int(exponent[1])) > LARGEST_EXPONENT:
            return False
    exact = Fraction(value)
    try:
        # a number that floats would take for 0 is refused: kernels would see another model
        return float(exact) != 0 or exact == 0
    except OverflowError:
        return False


def _spelled(x: Fraction) -> str:
    text = number_text(x)
    if "/" in text:
        return f'"{text}"'
    return text


def _read_truth(field: str, where: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{_named(field, where)} must be true or false, not {value!r}")
    return value


def _read_range(field: str, where: str, value: object) -> list[int | str]:
    name = _named(field, where)
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{name} must be [lowest, highest]")
    return [_read_number(name, "", end) for end in value]


def _spelled_range(ends: Iterable[Fraction]) -> str:
    return in_list(map(_spelled, ends))


def _read_bound(field: str, where: str, value: object) -> int | str | list[int | str]:
    """Return the bound of a disturbance: a number b for |w| <= b, or a pair of them."""
    name = _named(field, where)
    if isinstance(value, list):
        return [_read_number(name, "", x) for x in value]
    return _read_number(name, "", value)


def _spelled_bound(ends: tuple[Fraction, Fraction]) -> str:
    low, high = ends
    if low == -high:
        return _spelled(high)
    return _spelled_range(ends)


def _read_noise(field: str, where: str, value: object) -> int | str | tuple[int | str, str]:
    """Return the bound of a noise, with the expression of its factor where it has one."""
    if not isinstance(value, dict):
        return _read_number(field, where, value)
    name = _named(field, where)
    table = known_fields(name, value, TIMES)
    for part in TIMES:
        if part not in table:
            raise ValueError(f'{name} needs {part}: {{bound = 0.4, times = "1 + 0.5*abs(fan - 0.6)"}}')
    return _read_number("bound", name, table["bound"]), _read_text("times", name, table["times"])


def _spelled_noise(bound: Fraction | tuple[Fraction, str]) -> str:
    if not isinstance(bound, tuple):
        return _spelled(bound)
    size, times = bound
    return f"{{bound = {_spelled(size)}, times = {_quoted(times)}}}"


def _read_matrix(field: str, where: str, value: object) -> list[list[int | str]]:
    name = _named(field, where)
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        raise ValueError(f"{name} must be a list of rows, like [[1, 0], [0, 1]]")
    return [[_read_number(name, "", x) for x in row] for row in value]


def _spelled_matrix(rows: Matrix) -> str:
    lines = [f"    {in_list(map(_spelled, row))},\n" for row in rows]
    return f"[\n{''.join(lines)}]"


def _read_averages(field: str, where: str, value: object) -> list[Stated]:
    """Return [(samples or weights, bound)] of a list of averages."""
    if not isinstance(value, list):
        raise ValueError(f"{_named(field, where)} must be a list, like [{{samples = 16, bound = 0.1}}]")
    return [_read_average(where, entry) for entry in value]


def _read_average(where: str, entry: object) -> Stated:
    table = known_fields(f"an average of {where}", checked_table(f"an average of {where}", entry), AVERAGE)
    if "bound" not in table or ("samples" in table) == ("weights" in table):
        raise ValueError(
            f"an average of {where} needs samples (how many consecutive ones) or weights (a list of them), "
            f"and a bound"
        )
    bound = _read_number("bound", f"an average of {where}", table["bound"])
    if "samples" in table and not isinstance(table["samples"], list):
        return table["samples"], bound
    weights = table.get("samples", table.get("weights"))
    if not isinstance(weights, list):
        raise ValueError(
            f"weights of an average of {where} must be a list of numbers, the oldest sample first"
        )
    return [_read_number("weights", where, x) for x in weights], bound


def _spelled_averages(averages: Iterable[Average]) -> str:
    entries = []
    for average in averages:
        over = f"weights = {in_list(map(_spelled, average.weights))}"
        if average.is_mean:
            over = f"samples = {len(average.weights)}"
        entries.append(f"{{{over}, bound = {_spelled(average.bound)}}}")
    return in_list(entries)


def _read_shares(field: str, where: str, value: object) -> dict[str, int | str]:
    """Return {state: share} of a table of them, or of a list of names."""
    name = _named(field, where)
    if isinstance(value, list):
        return {_read_text(field, where, state): 1 for state in value}
    if not isinstance(value, dict):
        raise ValueError(f'{name} must be a list of names, or a table like {{"tank1" = -1, "tank2" = 1}}')
    return {state: _read_number(name, "", share) for state, share in value.items()}


def _spelled_shares(shares: Iterable[tuple[str, Fraction]]) -> str:
    return f"{{{', '.join(f'{_quoted(state)} = {_spelled(share)}' for state, share in shares)}}}"


TEXT = ValueKind(_read_text, _quoted)
NUMBER = ValueKind(_read_number, _spelled)
TRUTH = ValueKind(_read_truth, json.dumps)
RANGE = ValueKind(_read_range, _spelled_range)
SHARES = ValueKind(_read_shares, _spelled_shares)
BOUND = ValueKind(_read_bound, _spelled_bound)
NOISE = ValueKind(_read_noise, _spelled_noise)
MATRIX = ValueKind(_read_matrix, _spelled_matrix)
AVERAGES = ValueKind(_read_averages, _spelled_averages)


def number_text(x: Fraction | int) -> str:
    """Return an exact number as text that reads back as the same number: a decimal if there is a finite one,
    else "p/q".

    Example:
        >>> [number_text(Fraction(x)) for x in ("1/8", "1/3", "3e-9", "-2")]
        ['0.125', '1/3', '3e-9', '-2']
    """
    x = Fraction(x)
    places = _decimal_places(x.denominator)
    if places is None:
        return f"{x.numerator}/{x.denominator}"
    digits = str(abs(x.numerator) * 10**places // x.denominator)
    sign = "-" if x < 0 else ""
    if places == 0:
        return f"{sign}{_whole_number_text(digits)}"
    # 1e-9 is easier to read than nine zeros
    if places > len(digits) + 4:
        return f"{sign}{_mantissa(digits)}e{len(digits) - 1 - places}"
    digits = digits.rjust(places + 1, "0")
    return f"{sign}{digits[:-places]}.{digits[-places:]}"


def _decimal_places(denominator: int) -> int | None:
    """Return how many decimals a fraction with this denominator has, None where they never end."""
    twos = fives = 0
    # a fraction ends as a decimal iff its denominator has no prime but 2 and 5
    while denominator % 2 == 0:
        denominator, twos = denominator // 2, twos + 1
    while denominator % 5 == 0:
        denominator, fives = denominator // 5, fives + 1
    if denominator != 1:
        return None
    return max(twos, fives)


def _whole_number_text(digits: str) -> str:
    """Return a whole number, a long one with an exponent where that makes it shorter."""
    mantissa = digits.rstrip("0")
    if len(digits) <= LONG or len(digits) - len(mantissa) < 6:
        return digits
    return f"{_mantissa(mantissa)}e{len(digits) - 1}"


def _mantissa(digits: str) -> str:
    if len(digits) == 1:
        return digits
    return f"{digits[0]}.{digits[1:]}"
