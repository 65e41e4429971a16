"""Columns whose numbers are written in another way than those of the file: 97,17 % or 35.010,0 or ON.

A column is read so only where every cell of it is, and where no other reading is left: a number with one sign
and three digits behind it may have decimals or thousands.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxbound.recordings.columns import Arrow, from_arrow
from jaxbound.recordings.recordingformat import RecordingFormat

TRUTHS = {"on": "off", "true": "false", "yes": "no"}
"""Words for 1 and 0, in lower case; others are stated."""
MINUS = "\u2212"
SPACES = "[ \u00a0\u202f\u2009]"
SIGNS = [(".", ""), (",", ""), (".", ","), (",", "."), (".", "'"), (",", "'"), (".", " "), (",", " ")]
"""Signs for decimals and thousands."""
SUFFIX = r"^[-+]?[0-9.,][0-9.,' ]*?(?:[eE][-+]?[0-9]+)?(?P<unit> ?[^-+0-9.,' eE][^0-9]*| [^0-9 ][^ ]*)?$"
LONGEST = 12  # letters of a unit


@dataclass(frozen=True)
class Notation:
    """How the cells of a column are written.

    Fields: decimal, thousands: signs; unit: behind each number; truths: words in lower case and their values.
    """

    decimal: str = "."
    thousands: str = ""
    unit: str = ""
    truths: tuple[tuple[str, float], ...] = ()

    def numbers(self, cells: Arrow) -> tuple[np.ndarray, np.ndarray]:
        """Return (values (N,), NaN where there is none; whether each cell is null or holds one)."""
        import pyarrow as pa
        import pyarrow.compute as pc

        if self.truths:
            words = pc.utf8_lower(cells)
            values = np.full(len(cells), np.nan)
            for word, value in self.truths:
                values[_mask(pc.equal(words, word))] = value
            return values, ~np.isnan(values) | _mask(pc.is_null(cells))
        plain = _plain(cells)
        if self.unit:
            bare = pc.utf8_rtrim_whitespace(pc.replace_substring_regex(plain, re.escape(self.unit) + "$", ""))
            plain = pc.if_else(pc.ends_with(plain, self.unit), bare, "")
        fits = _mask(pc.match_substring_regex(plain, self.pattern))
        if self.thousands:
            plain = pc.replace_substring(plain, self.thousands, "")
        plain = pc.utf8_ltrim(pc.replace_substring(plain, self.decimal, "."), "+")
        values = from_arrow(
            pc.if_else(pa.array(fits), plain, pa.scalar(None, pa.string())).cast(pa.float64())
        )
        return values, fits | _mask(pc.is_null(cells))

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
        if self.truths:
            return ", ".join(f"{word} is {value:g}" for word, value in self.truths)
        said = [f"decimals behind {self.decimal!r}"]
        if self.thousands:
            said.append(f"{self.thousands!r} for thousands")
        if self.unit:
            said.append(f"the unit {self.unit!r}")
        return ", ".join(said)

    @property
    def stated(self) -> Mapping[str, object]:
        """The fields of a RecordingFormat that say so, without the unit, which every cell says."""
        if self.truths:
            on, off = ([word for word, x in self.truths if x == value] for value in (1, 0))
            return {"on": on, "off": off}
        if self.thousands or self.decimal != ".":
            return {
                name: sign for name, sign in vars(self).items() if name in ("decimal", "thousands") and sign
            }
        return {}


def notation_of(cells: Arrow, decimals: Sequence[str], how: RecordingFormat) -> Notation | None:
    """Return the only way in which all cells of a column are numbers; None where there is none, or several.

    Args:
        cells: (N,) trimmed texts, none null. decimals: signs that the numbers of the file have, the likeliest
            first. how: what is stated of them.
    """
    import pyarrow.compute as pc

    words = pc.unique(pc.utf8_lower(cells)).slice(0, 9).to_pylist()
    for truths in _truths(how):
        if words and set(words) <= set(dict(truths)):
            return Notation(truths=truths)
    plain = _plain(cells)
    parts = pc.extract_regex(plain, SUFFIX)
    if not len(plain) or parts.null_count:
        return None
    units = pc.unique(pc.utf8_trim_whitespace(pc.fill_null(pc.struct_field(parts, "unit"), ""))).to_pylist()
    if len(units) != 1 or len(units[0]) > LONGEST:
        return None
    found: list[Notation] = []
    for decimal, thousands in _signs(how):
        notation = Notation(decimal, thousands, units[0])
        used = not thousands or _mask(pc.match_substring(plain, thousands)).any()
        if used and notation.numbers(cells)[1].all():
            found.append(notation)
    readings = {notation.numbers(cells)[0].tobytes(): notation for notation in reversed(found)}
    if len(readings) == 1:
        return found[0]
    likely = [n for n in found if not n.thousands and n.decimal == decimals[0]]
    if likely and (len(decimals) == 1 or decimals[0] == ","):  # which other cells of the file show
        return likely[0]
    return None


def noted_numbers(cells: Sequence[object], how: RecordingFormat) -> tuple[np.ndarray, str] | None:
    """Return (numbers (N,), NaN where there is none; the notation in words) of a column of a table, if all
    its cells are texts of one notation, None or NaN.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    texts: list[str | None] = []
    for cell in cells:
        if isinstance(cell, str):
            texts.append(None if cell.strip() in how.missing else cell.strip())
        elif cell is None or cell != cell:
            texts.append(None)
        else:
            return None
    column = pa.array(texts, pa.string())
    known = pc.drop_null(column)
    notation = notation_of(known, (".",), how)
    if notation is None:
        return None
    return notation.numbers(column)[0], f"{known[0].as_py()!r}, read so: {notation.words}"


def _truths(how: RecordingFormat) -> Iterable[tuple[tuple[str, float], ...]]:
    """Yield words and their values: what is stated, and usual pairs."""
    if how.on:
        yield (*((w.lower(), 1.0) for w in how.on), *((w.lower(), 0.0) for w in how.off))
    for on, off in TRUTHS.items():
        yield (on, 1.0), (off, 0.0)


def _signs(how: RecordingFormat) -> list[tuple[str, str]]:
    """Return the signs for decimals and thousands that may be."""
    signs = [(d, t) for d, t in SIGNS if how.decimal in ("", d) and (not how.thousands or t == how.thousands)]
    if how.thousands:
        signs += [(d, "") for d in ".," if d != how.thousands and how.decimal in ("", d)]
    return signs


def _plain(cells: Arrow) -> Arrow:
    """Return cells with usual signs for minus and blanks."""
    import pyarrow.compute as pc

    spaced = pc.replace_substring_regex(pc.utf8_trim_whitespace(cells), SPACES, " ")
    return pc.replace_substring_regex(spaced, f"^{MINUS}", "-")


def _mask(found: Arrow) -> np.ndarray:
    import pyarrow.compute as pc

    return np.asarray(pc.fill_null(found, False).to_numpy(zero_copy_only=False), bool)
