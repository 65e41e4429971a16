"""How recordings are written, as a value: what is stated of a file goes before what is found by looking."""

import codecs
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, TypeAlias

from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.signals import SignalModel
from jaxbound.text.units import time_unit

TABLE = "recording"
"""The table of a model file that states a format."""
RECORDING = f"[{TABLE}]"
"""Key of `columns` that holds the text of a format: no signal is called so."""
NAMED_SIGNS = {"comma": ",", "point": ".", "tab": "\t", "space": " ", "semicolon": ";", "apostrophe": "'"}
"""Signs that a command line and a reader hold sooner by their names."""
EQUAL = ("first", "last")


@dataclass(frozen=True)
class RecordingFormat:
    """How the files of a plant are written. `of` builds it. What is not stated is found by looking.

    Fields:
        header: row of the names of columns, counted from 1. skip: rows that are no data. comment: the sign
            that begins lines which are none. delimiter: between cells. decimal, thousands: signs in numbers.
            encoding: of text, as Python calls it.
        every: the interval whose means are samples. time: the column of times. time_format: of their texts,
            as `datetime.strptime` has it; that of a date alone says the order of day and month. time_unit: of
            their numbers: ns, us, ms, s, min, h or d. zone: of time stamps that name none, like
            "Europe/Berlin".
        missing: words and numbers that stand for missing samples. on, off: words for 1 and 0.
        hold: how long a sample stands for blank cells behind it, like "10min", in files that are written when
            a value changes; with dt known samples are that far apart then. deadband: the largest change that
            is not written, of all outputs, "0.5", or of some, "T1:0.5": as far the truth may be from a
            sample. equal: the row that counts among those of one time, "first" or "last".
        long: the columns of tags and of their values in files with a row a tag.
    """

    header: int | None = None
    skip: tuple[int, ...] = ()
    comment: str = ""
    delimiter: str = ""
    decimal: str = ""
    thousands: str = ""
    encoding: str = ""
    every: str = ""
    time: str = ""
    time_format: str = ""
    time_unit: str = ""
    zone: str = ""
    missing: tuple[str, ...] = ()
    on: tuple[str, ...] = ()
    off: tuple[str, ...] = ()
    hold: str = ""
    deadband: tuple[str, ...] = ()
    equal: str = ""
    long: tuple[str, ...] = ()

    @classmethod
    def of(cls, given: "Stated") -> "RecordingFormat":
        """Return the format that is stated, checked.

        Args:
            given: a format; a mapping with its fields, whose values may be texts as on a command line,
                several with commas between them; its `.text`; None: nothing is stated.

        Raises:
            ValueError: an unknown field; a value that is none.

        Example:
            >>> RecordingFormat.of({"decimal": "comma", "skip": "2,3", "missing": [-999, "Bad"]})
            RecordingFormat(skip=(2, 3), decimal=',', missing=('-999', 'Bad'))
        """
        if isinstance(given, RecordingFormat):
            return given
        table: Any = given or {}
        if isinstance(given, str):
            table = json.loads(given)
        stated: dict[str, Any] = {}
        for name, value in table.items():
            if name not in READERS:
                raise ValueError(f"{RECORDING} has no field {name!r}: it has {', '.join(READERS)}")
            try:
                stated[name] = READERS[name](value)
            except (ValueError, LookupError) as e:
                raise ValueError(f"{name} of {RECORDING} {e}") from None
        found = cls(**stated)
        if found.decimal and found.decimal == found.thousands:
            raise ValueError(f"{RECORDING} has {found.decimal!r} for decimals and for thousands")
        if bool(found.on) != bool(found.off):
            raise ValueError(f"{RECORDING} needs words for on and off, or none of both")
        _refuse_numbers("on", found.on, 1.0)
        _refuse_numbers("off", found.off, 0.0)
        return found

    @property
    def stated(self) -> dict[str, Any]:
        """The fields that are stated."""
        return {name: value for name, value in vars(self).items() if value not in (None, "", ())}

    @property
    def numbers(self) -> tuple[float, ...]:
        """The numbers that stand for missing samples."""
        return tuple(_numbers(self.missing).values())

    def deadbands(self, outputs: Sequence[str]) -> dict[str, Fraction]:
        """Return {output: its deadband}, 0 where none is stated.

        Raises:
            ValueError: one of a signal that is no output: a model takes an input as it is recorded.
        """
        bands = dict.fromkeys(outputs, Fraction(0))
        for text in self.deadband:
            name, _, number = text.rpartition(":")
            if name and name not in bands:
                raise ValueError(
                    f"deadband of {RECORDING} is for outputs, {name!r} is none: of an input, which counts as "
                    f"it is recorded, a disturbance takes what changes below it do"
                )
            bands |= dict.fromkeys([name] if name else outputs, Fraction(number))
        return bands

    def refuse_in(self, where: str, *names: str) -> None:
        """Raise ValueError if one of these fields is stated. where: it cannot be, like "a pipe"."""
        for name in names:
            if name in self.stated:
                raise ValueError(f"{name} of {RECORDING} is for CSV files, not for {where}")

    @property
    def wide(self) -> "RecordingFormat":
        """The format of the same cells with a column a tag."""
        if not self.long:
            return self
        return replace(self, long=(), header=None, skip=(), comment="", encoding="", equal="")

    @property
    def text(self) -> str:
        """The fields that are stated as text, from which `of` reads them."""
        return json.dumps(self.stated)

    def __repr__(self) -> str:
        return f"RecordingFormat({', '.join(f'{name}={value!r}' for name, value in self.stated.items())})"


UNSTATED = RecordingFormat()
Stated: TypeAlias = RecordingFormat | Mapping[str, Any] | str | None
"""A format, or what `RecordingFormat.of` reads it from."""


def with_format(columns: Mapping[str, str] | None, given: Stated) -> dict[str, str]:
    """Return `columns` of a model with a format beside what is stated; its time and every are of them."""
    columns = dict(columns or {})
    stated = RecordingFormat.of(columns.pop(RECORDING, None)).stated | RecordingFormat.of(given).stated
    for name in ("time", "every"):
        if name in stated:
            columns[name] = stated.pop(name)
    if stated:
        columns[RECORDING] = RecordingFormat.of(stated).text
    return columns


def without_deadband(columns: Mapping[str, str]) -> dict[str, str]:
    """Return `columns` of a model whose outputs have no bound by a deadband."""
    how = RecordingFormat.of(columns.get(RECORDING))
    return with_format({k: v for k, v in columns.items() if k != RECORDING}, replace(how, deadband=()))


class Formatted:
    """The signals of a model whose recordings are written in another format than it states.

    Args:
        model: whose signals. given: see `RecordingFormat.of`.
    """

    def __init__(self, model: SignalModel, given: Stated) -> None:
        self._model, self.columns = model, with_format(model.columns, given)

    def __getattr__(self, name: str) -> object:
        """Return an attribute of the model."""
        return getattr(self._model, name)


def agreed(formats: Iterable[RecordingFormat]) -> dict[str, Any]:
    """Return the fields that are the same in all of some formats that state them."""
    stated: dict[str, Any] = {}
    other: set[str] = set()
    for one in formats:
        for name, value in one.stated.items():
            if stated.setdefault(name, value) != value:
                other.add(name)
    return {name: value for name, value in stated.items() if name not in other}


def format_of(model: object) -> RecordingFormat:
    """Return the format that the columns of a model state."""
    columns: Mapping[str, str] = getattr(model, "columns", {})
    return RecordingFormat.of(columns.get(RECORDING))


def _numbers(words: Iterable[str]) -> dict[str, float]:
    """Return {word: number} of those that are numbers."""
    numbers = {}
    for word in words:
        try:
            numbers[word] = float(word.replace(",", "."))
        except ValueError:  # a word
            continue
    return numbers


def _refuse_numbers(name: str, words: Iterable[str], meant: float) -> None:
    """Refuse words for on or off that are other numbers: a column of numbers is read as it is."""
    for word, number in _numbers(words).items():
        if number != meant:
            remedy = "an expression like `pump - 1` makes 1 of 2"
            raise ValueError(
                f"{name} of {RECORDING} must be words: {word} is a number, read as it is; {remedy}"
            )


def _text(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"must be text, not {value!r}")
    return value


def _texts(value: object) -> tuple[str, ...]:
    """Return words or numbers as they are written."""
    if isinstance(value, str):
        return tuple(filter(None, map(str.strip, value.split(","))))
    if isinstance(value, Sequence):
        return tuple(map(str.strip, map(str, value)))
    return (str(value),)


def _row(value: object) -> int:
    text = str(value)
    if isinstance(value, bool) or not (text.isascii() and text.isdecimal()) or not 0 < int(text) < 10**9:
        raise ValueError(f"must be the number of a row, the first is 1, not {value!r}")
    return int(text)


def _rows(value: object) -> tuple[int, ...]:
    """Return numbers of rows."""
    return tuple(sorted(map(_row, _texts(value))))


def _sign(value: object) -> str:
    sign = NAMED_SIGNS.get(str(value), str(value))
    if len(sign) != 1 or sign.isalnum() or sign in '"\r\n':
        raise ValueError(f"must be one sign, or one of {', '.join(NAMED_SIGNS)}, not {value!r}")
    return sign


def _decimal(value: object) -> str:
    sign = _sign(value)
    if sign not in ".,":
        raise ValueError(f"must be point or comma, not {value!r}")
    return sign


def _encoding(value: object) -> str:
    """Return the name of an encoding.

    Raises:
        LookupError: there is none of that name.
    """
    return codecs.lookup(_text(value)).name


def _unit(value: object) -> str:
    """Return a unit of times."""
    unit = time_unit(f"t [{value}]")
    if not unit:
        raise ValueError(f"must be one of ns, us, ms, s, min, h, d, not {value!r}")
    return unit


def _zone(value: object) -> str:
    """Return the name of a zone."""
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    try:
        ZoneInfo(_text(value))
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise ValueError(f"must be a zone, like Europe/Berlin or UTC, not {value!r}") from None
    return str(value)


def _interval(value: object) -> str:
    """Return an interval of the clock."""
    try:
        seconds_of(_text(value))
    except ValueError as e:
        raise ValueError(str(e).removeprefix("every ")) from None
    return str(value)


def _bands(value: object) -> tuple[str, ...]:
    """Return deadbands as texts, "0.5" or "T1:0.5"."""
    if isinstance(value, Mapping):
        value = [f"{name}:{number}" for name, number in value.items()]
    bands = _texts(value)
    for text in bands:
        try:
            is_one = float(Fraction(text.rpartition(":")[2])) > 0
        except (ValueError, ArithmeticError):  # a zero below a fraction, or no float holds it
            is_one = False
        if not is_one:
            raise ValueError(f"must be a number above 0, 0.5, or one of an output, T1:0.5: not {text!r}")
    return bands


def _two(value: object) -> tuple[str, ...]:
    """Return two names of columns."""
    names = _texts(value)
    if len(names) != 2:
        raise ValueError(f"must be two columns, of the tags and of the values, not {value!r}")
    return names


def _which(value: object) -> str:
    if value not in EQUAL:
        raise ValueError(f"must be {' or '.join(EQUAL)}, not {value!r}")
    return str(value)


READERS: Mapping[str, Callable[[Any], Any]] = {
    "header": _row,
    "skip": _rows,
    "comment": _text,
    "delimiter": _sign,
    "decimal": _decimal,
    "thousands": _sign,
    "encoding": _encoding,
    "every": _interval,
    "time": _text,
    "time_format": _text,
    "time_unit": _unit,
    "zone": _zone,
    "missing": _texts,
    "on": _texts,
    "off": _texts,
    "hold": _interval,
    "deadband": _bands,
    "equal": _which,
    "long": _two,
}
"""{field: reader of its value}."""
