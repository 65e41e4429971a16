"""Signs for thousands: 1.002 beside 998 is a thousand and two, or little more than one.

Decimals that a program writes as short as it can have three digits now and then, and some have fewer; whole
numbers by thousands always have three, of which some end in 0. Where a column shows no decimal of another
length, nothing is guessed: files of one plant must not be read in two ways.
"""

import re
from collections.abc import Callable

import numpy as np

from jaxbound.recordings.columns import Arrow

GROUPED = re.compile(r"[-+]?[0-9]{1,3}([.,' \u00a0\u202f][0-9]{3})+([.,][0-9]+)?")
"""A number with signs for thousands, as spreadsheets show it."""
SIGNED = re.compile("[.,]")
CLOSER = 10  # times that one reading must be closer to the samples around it to be the one


def may_be_grouped(values: np.ndarray) -> bool:
    """Return whether numbers, read as decimals, may be whole ones with signs for thousands: only then their
    texts are looked at.
    """
    x = np.abs(values[np.isfinite(values)])
    thousandths = 1000 * x
    if (x >= 1000).any() or ((x > 0) & (x < 1)).any():
        return False
    return bool((np.abs(thousandths - np.round(thousandths)) < 1e-6).all())


def in_doubt(cells: Arrow, values: np.ndarray, sign: str, is_other: bool = False) -> list[int]:
    """Return the places of two cells of a column that can be read in two ways: one with the sign, one
    without; the first alone where the sign is not the file's; [] where there is no doubt.

    Args:
        cells: (N,) texts. values: (N,) as decimals. sign: "." or ",". is_other: whether other cells of the
            file show that its decimal sign is another.
    """
    import pyarrow.compute as pc

    cells = pc.fill_null(pc.utf8_trim_whitespace(cells), "")
    point = re.escape(sign)
    signed = _matching(cells, point)
    groups = _matching(cells, rf"^[-+]?[1-9][0-9]{{0,2}}({point}[0-9]{{3}})+$")
    small = _matching(cells, r"^[-+]?0*[1-9][0-9]{0,2}$")
    large = _matching(cells, r"^[-+]?0*[1-9][0-9]{3,}$")
    if (signed & ~groups).any() or large.any() or not groups.any():
        return []
    first = int(np.argmax(groups))
    if is_other:
        return [first]
    if not small.any():
        return []
    if not _matching(cells, rf"{point}[0-9]*0$").any() and _closer_as_decimals(values, groups, small):
        return []
    beside = np.flatnonzero(small)
    return [first, int(beside[np.argmin(np.abs(beside - first))])]


def all_grouped(cells: Arrow, sign: str) -> str:
    """Return the first cell of a column of which every number could be a whole one with such signs for
    thousands, "" of any other: nothing tells them from decimals.
    """
    import pyarrow.compute as pc

    known = pc.utf8_trim_whitespace(pc.drop_null(cells))
    if (
        not len(known)
        or not _matching(known, rf"^[-+]?[1-9][0-9]{{0,2}}({re.escape(sign)}[0-9]{{3}})+$").all()
    ):
        return ""
    return str(known[0].as_py())


class Doubt:
    """The doubt on one column of a stream, whose lines come a few at a time: a cell with a sign is left out
    behind one without, and one without behind one with a sign, unless they lie close as decimals, until some
    decimal has another length.

    Args:
        small, grouped: the last numbers without a sign and with one. over: whether the doubt is.
    """

    def __init__(self, small: float = 0.0, grouped: float = 0.0, over: bool = False) -> None:
        self.small, self.grouped, self.over = small, grouped, over

    def next_odd(self, values: np.ndarray, signed: np.ndarray, cells: Callable[[int], str]) -> str:
        """Return the first cell that is in doubt and what it comes behind, "" where none is, and take the
        numbers before it.

        Args:
            values: (N,) the next numbers, as decimals. signed: (N,) bool, False where their texts have no
                sign for sure. cells: number of one of them -> its text.
        """
        known = np.flatnonzero(np.isfinite(values) & (values != 0))
        suspects = map(cells, known[signed[known]].tolist())
        if not len(known) or self.over:
            return ""
        if not self.grouped and not any(map(SIGNED.search, suspects)):
            whole = np.abs(values[known])  # as most columns of whole numbers go on
            self.small, self.over = float(whole[-1]), bool((whole >= 1000).any())
            return ""
        for k in known:
            if self.over:
                break
            x, cell = abs(float(values[k])), cells(int(k)).strip()
            if SIGNED.search(cell):
                self.over = not is_grouped(cell)
                if not self.over and self.small and not _is_close(x, self.small):
                    return f"{cell} behind whole numbers"
                self.grouped = x
            else:
                self.over = x >= 1000
                if not self.over and self.grouped and not _is_close(self.grouped, x):
                    return f"{cell} behind {self.grouped:.3f}"
                self.small = x
        return ""


def is_grouped(cell: str) -> bool:
    """Return whether a number with one sign may be a whole one, by thousands."""
    return re.fullmatch(r"[-+]?[1-9][0-9]{0,2}[.,][0-9]{3}", cell) is not None


def _is_close(grouped: float, small: float) -> bool:
    """Return whether a number with a sign lies close to one without as a decimal."""
    return CLOSER * abs(grouped - small) < abs(1000 * grouped - small)


def _matching(cells: Arrow, pattern: str) -> np.ndarray:
    import pyarrow.compute as pc

    return np.asarray(pc.match_substring_regex(cells, pattern).to_numpy(zero_copy_only=False), bool)


def _closer_as_decimals(values: np.ndarray, groups: np.ndarray, small: np.ndarray) -> bool:
    """Return whether numbers with a sign lie closer to those without, next to them, as decimals."""
    known = groups | small
    x, kind = values[known], groups[known]
    beside = kind[1:] != kind[:-1]
    apart = np.abs(np.diff(x))[beside].sum()
    by_thousands = np.abs(np.diff(np.where(kind, 1000 * x, x)))[beside].sum()
    return bool(CLOSER * apart < by_thousands)
