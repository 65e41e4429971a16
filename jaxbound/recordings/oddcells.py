"""Cells that hold no number where one is needed.

A spreadsheet's error is a missing sample, and is counted. Other words are refused, with the place of the
first, unless `where` leaves their rows out: those may hold anything.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import compress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxbound.recordings.thousands import GROUPED
from jaxbound.text.names import listed

if TYPE_CHECKING:
    import pandas as pd

ERRORS = ("#VALUE!", "#DIV/0!", "#N/A", "#REF!", "#NUM!", "#NAME?", "#NULL!")
"""The errors of a spreadsheet."""
MANY = 10  # words that a sentence repeats at most
LONGEST = 60  # letters of a word in a sentence


class OddWords(ValueError):
    """Cells of a column hold words. Fields: words: these, each once."""

    def __init__(self, sentence: str, words: Sequence[str]) -> None:
        super().__init__(sentence)
        self.words = words


class OddCells(NamedTuple):
    """The cells of one column that are no numbers.

    Fields: rows (K,): their numbers, ascending; words: what they hold.
    """

    rows: np.ndarray
    words: Sequence[str]

    def among(self, excluded: np.ndarray | None, errors: bool) -> "OddCells":
        """Return those that are errors of a spreadsheet, or the other words, in rows that `where`, (N,) bool
        or None, does not leave out.
        """
        chosen = []
        for k, word in zip(self.rows.tolist(), self.words, strict=True):
            if (word in ERRORS) == errors and (excluded is None or not excluded[k]):
                chosen.append((k, word))
        return OddCells(np.array([k for k, _ in chosen], np.int64), [word for _, word in chosen])

    def without(self, missing: Sequence[str]) -> "OddCells":
        """Return those that hold none of some words."""
        return self.at(np.array([word not in missing for word in self.words], bool))

    def at(self, chosen: np.ndarray) -> "OddCells":
        """Return some of them, (K,) bool."""
        return OddCells(self.rows[chosen], list(compress(self.words, chosen)))


Odd = Mapping[str, OddCells]
"""{column: its cells that are no numbers}."""


def no_number(where: str, column: str, word: str) -> str:
    """Return a sentence on one cell. where: it is, like "row 7"."""
    held = f"{where} of column {column!r} holds {word[:LONGEST]!r}, which is not a number"
    if GROUPED.fullmatch(word):
        return f"{held}: write it without signs for thousands"
    return f"{held}: leave a missing sample blank, or leave the row out by `where`"


def thousands(column: str, found: Sequence[str]) -> str:
    """Return a sentence on a column with signs for thousands, or decimals. found: cells, like "998 in row
    7".
    """
    held = f"column {column!r} holds {' and '.join(found)}"
    return f"{held}: write whole numbers without signs for thousands, and decimals all with as many digits"


def refuse_odd(odd: Odd, excluded: np.ndarray | None, row: Callable[[int], str]) -> None:
    """Raise ValueError if a word, no spreadsheet's error, stands in a row that counts.

    Args:
        odd: of each column. excluded: (N,) bool, rows that `where` leaves out, or None. row: number of a row
            -> "row 7".
    """
    found: list[tuple[int, int, str, str]] = []
    for place, (column, cells) in enumerate(odd.items()):
        counting = cells.among(excluded, errors=False)
        for k, word in zip(counting.rows.tolist(), counting.words, strict=True):
            found.append((k, place, column, word))
    if not found:
        return
    (k, _, column, word), *others = sorted(found)
    sentence = no_number(row(k), column, word)
    if others:
        words = list(dict.fromkeys(word[:LONGEST] for *_, word in others))
        sentence += f"; {len(others)} more cells hold {listed(words[:MANY])}, too"
    raise OddWords(sentence, list(dict.fromkeys([word, *(other for *_, other in others)])))


def error_hints(odd: Odd, excluded: np.ndarray | None, row: Callable[[int], str]) -> Iterator[str]:
    """Yield a sentence for each column with errors of a spreadsheet in rows that count; as `refuse_odd`."""
    for column, cells in odd.items():
        errors = cells.among(excluded, errors=True)
        if not errors.words:
            continue
        one = f"{len(errors.words)} cells of column {column!r} hold"
        if len(errors.words) == 1:
            one = f"one cell of column {column!r} holds"
        first = f"the first {errors.words[0]} in {row(int(errors.rows[0]))}"
        yield f"{one} an error of a spreadsheet, {first}: missing samples"


def unsaid_hints(odd: Odd, columns: Sequence[str], row: Callable[[int], str]) -> Iterator[str]:
    """Yield a sentence for each column of the condition in which words leave open whether a row counts."""
    for column in columns:
        cells = odd.get(column)
        if cells is not None and cells.words:
            count = f"{len(cells.words)} cells of column {column!r}, in the condition, hold no number"
            first = f"the first {cells.words[0][:LONGEST]!r} in {row(int(cells.rows[0]))}"
            yield f"{count}, {first}: their rows are left out"


def odd_of_frame(cells: "pd.Series") -> tuple["pd.Series", OddCells]:
    """Return (the numbers of a column, NaN where there is none, its cells that are no numbers)."""
    import pandas as pd

    try:
        numbers = pd.to_numeric(cells, errors="coerce")
    except OverflowError:
        raise ValueError(f"column {cells.name!r} holds a number that is too large to compute with") from None
    odd = np.flatnonzero((cells.notna() & numbers.isna()).to_numpy(bool))
    return numbers, _cells_at(cells, odd)


def texts_of_frame(cells: "pd.Series") -> OddCells:
    """Return the cells of a column that are texts, whatever they hold."""
    return _cells_at(cells, np.flatnonzero([isinstance(cell, str) for cell in cells]))


def _cells_at(cells: "pd.Series", rows: np.ndarray) -> OddCells:
    return OddCells(rows, [str(word).strip() for word in cells.iloc[rows]])
