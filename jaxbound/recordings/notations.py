"""Columns whose numbers are written in another way than those of the file: 97,17 % or 35.010,0 or ON.

A column is read so only where every cell of it is, and where no other reading is left: a number with one sign
and three digits behind it may have decimals or thousands.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxbound.recordings.columns import Arrow, from_arrow
from jaxbound.recordings.csvtext import MISSING_CELLS
from jaxbound.recordings.recordingformat import RecordingFormat

TRUTHS = {"on": "off", "true": "false", "yes": "no"}
"""Words for 1 and 0, in lower case; others are stated."""
MINUS = "\u2212"
SPACES = "[ \u00a0\u202f\u2009]"
SIGNS = [(".", ""), (",", ""), (".", ","), (",", "."), (".", "'"), (",", "'"), (".", " "), (",", " ")]
"""Signs for decimals and thousands."""
SUFFIX = r"^[-+]?[0-9.,][0-9.,' ]*?(?:[eE][-+]?[0-9]+)?(?P<unit> ?[^-+0-9.,' eE][^0-9]*| [^0-9 ][^ ]*)?$"
LONGEST = 12  # letters of a unit
NO_UNIT = re.compile(r"[-+\u2212]|[-+]?[0-9.,]+|[eEdD][-+]?[0-9]+|[x*\u00d7\u00b7^].*")
"""What stands behind a number and belongs to it: 1.5 E3, 1.5 x10^3, 1.5 -3, 1.5 -."""


@dataclass(frozen=True)
class Notation:
    """How the cells of a column are written.

    Fields: decimal, thousands: signs; unit: behind each number; on, off: words for 1 and 0 in lower case.
    """

    decimal: str = "."
    thousands: str = ""
    unit: str = ""
    on: tuple[str, ...] = ()
    off: tuple[str, ...] = ()

    def numbers(self, cells: Arrow) -> tuple[np.ndarray, np.ndarray]:
        """Return (values (N,), NaN where there is none; whether each cell is null or holds one)."""
        import pyarrow as pa
        import pyarrow.compute as pc

        none = _mask(pc.is_null(cells))
        if self.on:
            words = pc.utf8_lower(cells)
            is_on, is_off = (
                _mask(pc.is_in(words, pa.array(self.on))),
                _mask(pc.is_in(words, pa.array(self.off))),
            )
            return np.where(is_on, 1.0, np.where(is_off, 0.0, np.nan)), is_on | is_off | none
        plain = _plain(cells)
        if self.unit:
            plain = pc.if_else(pc.ends_with(plain, self.unit), self.without_unit(cells), "")
        fits = _mask(pc.match_substring_regex(plain, self.pattern))
        if self.thousands:
            plain = pc.replace_substring(plain, self.thousands, "")
        plain = pc.utf8_ltrim(pc.replace_substring(plain, self.decimal, "."), "+")
        numbers = pc.if_else(pa.array(fits), plain, pa.scalar(None, pa.string()))
        return from_arrow(numbers.cast(pa.float64())), fits | none

    def without_unit(self, cells: Arrow) -> Arrow:
        """Return cells with usual signs for minus and blanks, and without the unit."""
        import pyarrow.compute as pc

        bare = pc.replace_substring_regex(_plain(cells), re.escape(self.unit) + "$", "")
        return pc.utf8_rtrim_whitespace(bare)

    def number(self, cell: str) -> float | None:
        """Return the number in one cell, None where it holds none: `numbers`, sooner."""
        text = re.sub(f"^{MINUS}", "-", re.sub(SPACES, " ", cell.strip()))
        if self.on:
            values = dict.fromkeys(self.off, 0.0) | dict.fromkeys(self.on, 1.0)
            return values.get(text.lower())
        if not text.endswith(self.unit):
            return None
        text = text.removesuffix(self.unit).rstrip()
        if re.match(self.pattern, text) is None:
            return None
        if self.thousands:
            text = text.replace(self.thousands, "")
        return float(text.replace(self.decimal, "."))

    def shows_signs(self, cell: str) -> bool:
        """Return whether a cell shows the signs of numbers: a whole one has none."""
        return bool(self.on) or not cell.strip().removesuffix(self.unit).strip(f"+-{MINUS} ").isdigit()

    @property
    def pattern(self) -> str:
        """The pattern of a number."""
        decimal = re.escape(self.decimal)
        whole = "[0-9]+"
        if self.thousands:
            whole = f"([0-9]+|[1-9][0-9]{{0,2}}({re.escape(self.thousands)}[0-9]{{3}})+)"
        return rf"^[-+]?({whole}({decimal}[0-9]*)?|{decimal}[0-9]+)([eE][-+]?[0-9]+)?$"

    @property
    def words(self) -> str:
        """The notation in words."""
        if self.on:
            return f"{', '.join(self.on)} is 1, {', '.join(self.off)} is 0"
        words = f"decimals behind {self.decimal!r}"
        if self.thousands:
            words += f", {self.thousands!r} for thousands"
        if self.unit:
            words += f", the unit {self.unit!r}"
        return words

    @property
    def stated(self) -> Mapping[str, object]:
        """The fields of a RecordingFormat that say so, without the unit, which every cell says."""
        if self.on:
            return {"on": self.on, "off": self.off}
        if self.thousands:
            return {"decimal": self.decimal, "thousands": self.thousands}
        if self.decimal != ".":
            return {"decimal": self.decimal}
        return {}


def notation_of(cells: Arrow, decimals: Sequence[str], how: RecordingFormat) -> Notation | None:
    """Return the only way in which all cells of a column are numbers; None where there is none, or several.

    Args:
        cells: (N,) trimmed texts, none null. decimals: signs that the numbers of the file have, the likeliest
            first. how: what is stated of them.
    """
    import pyarrow.compute as pc

    words = {*pc.unique(pc.utf8_lower(cells)).slice(0, 99).to_pylist()}
    for on, off in _truths(how):
        if words and words <= {*on, *off}:
            return Notation(on=on, off=off)
    plain = _plain(cells)
    parts = pc.extract_regex(plain, SUFFIX)
    if not len(plain) or parts.null_count:
        return None
    units = pc.unique(pc.utf8_trim_whitespace(pc.fill_null(pc.struct_field(parts, "unit"), ""))).to_pylist()
    if len(units) != 1 or len(units[0]) > LONGEST or NO_UNIT.fullmatch(units[0]):
        return None
    found: list[Notation] = []
    for decimal, thousands in _signs(how):
        notation = Notation(decimal, thousands, units[0])
        used = not thousands or _mask(pc.match_substring(plain, thousands)).any()
        if used and notation.numbers(cells)[1].all():
            found.append(notation)
    readings = {notation.numbers(cells)[0].tobytes() for notation in found}
    if len(readings) == 1:
        return found[0]
    likely = Notation(decimals[0], "", units[0])
    if likely in found and (len(decimals) == 1 or decimals[0] == ","):  # which other cells of the file show
        return likely
    return None


def noted_numbers(cells: Sequence[object], how: RecordingFormat) -> tuple[np.ndarray, str] | None:
    """Return (numbers (N,), NaN where there is none; the notation in words) of a column of a table, if all
    its cells are texts of one notation, None or NaN.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    texts: list[str | None] = []
    for cell in cells:
        if cell is None or cell != cell or str(cell).strip() in (*MISSING_CELLS, *how.missing):
            texts.append(None)
        elif isinstance(cell, str):
            texts.append(cell.strip())
        else:
            return None
    column = pa.array(texts, pa.string())
    known = pc.drop_null(column)
    notation = notation_of(known, (".",), how)
    if notation is None:
        return None
    return notation.numbers(column)[0], f"{known[0].as_py()}: {notation.words}"


def _truths(how: RecordingFormat) -> Iterable[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Yield words for 1 and for 0: what is stated, and usual pairs."""
    if how.on:
        yield tuple(map(str.lower, how.on)), tuple(map(str.lower, how.off))
    for on, off in TRUTHS.items():
        yield (on,), (off,)


def _signs(how: RecordingFormat) -> list[tuple[str, str]]:
    """Return the signs for decimals and thousands that may be."""
    signs = []
    for decimal, thousands in SIGNS:
        may_be = how.decimal in ("", decimal) and how.thousands != decimal
        if may_be and (not how.thousands or thousands in ("", how.thousands)):
            signs.append((decimal, thousands))
    return signs


def _plain(cells: Arrow) -> Arrow:
    """Return cells with usual signs for minus and blanks."""
    import pyarrow.compute as pc

    spaced = pc.replace_substring_regex(pc.utf8_trim_whitespace(cells), SPACES, " ")
    return pc.replace_substring_regex(spaced, f"^{MINUS}", "-")


def _mask(found: Arrow) -> np.ndarray:
    import pyarrow.compute as pc

    return np.asarray(pc.fill_null(found, False).to_numpy(zero_copy_only=False), bool)
