"""Columns that may be in another unit than others: one is the other but for the numbers of a unit, or it lies
between 0 and 1 where the likes of it go up to 100. These are hints: no proof uses them.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from jaxbound.text.units import same_unit, without_unit

ROWS, COLUMNS = 1000, 100  # that are looked at: enough for what holds in each row
FEW, VALUES = 50, 10  # rows, different numbers: fewer show nothing
ALIKE, LEVEL = 0.02, 0.2
"""Shares of its spread that a column may be off: where a factor is to be known, and where a level is, too."""
SHIFT = 0.05  # share of that level: where columns spread far, it is to be seen
ONE, SOME = 1.05, 0.3  # how far a fraction goes, and goes at least
PERCENT = re.compile(r"%|\bperc|\bpct|prozent", re.IGNORECASE)
LETTERS = 3  # of a name: shorter ones, like x1 and x2, are of anything


class UnitPair(NamedTuple):
    """A column is factor * another + shift. Fields: text: as what is of what."""

    factor: float
    shift: float
    text: str


UNIT_PAIRS = (
    UnitPair(1.8, 32.0, "degF of degC"),
    UnitPair(1.0, 273.15, "kelvin of degC"),
    UnitPair(1.8, -459.67, "degF of kelvin"),
    UnitPair(100.0, 0.0, "percent of a fraction or kPa of bar"),
    UnitPair(1e3, 0.0, "W of kW or Pa of kPa"),
    UnitPair(1e5, 0.0, "Pa of bar"),
    UnitPair(6.894757, 0.0, "kPa of psi"),
    UnitPair(14.503774, 0.0, "psi of bar"),
    UnitPair(3.6, 0.0, "m3/h of l/s or km/h of m/s"),
    UnitPair(60.0, 0.0, "l/min of l/s"),
    UnitPair(50 / 3, 0.0, "l/min of m3/h"),
)


def other_units(names: Sequence[str], *parts: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield (column, a sentence) where its unit may be another than that of the like of it.

    Args:
        names: of columns. parts: (T, p) each, their numbers, NaN where there is none.

    Example:
        >>> c = 20 + np.sin(np.arange(90.0))
        >>> list(other_units(["in", "out"], np.stack([c, 1.8 * c + 32], 1)))
        [('out', 'out is 1.8 * in + 32, as degF of degC: it may be in another unit')]
    """
    rows = np.unique(np.linspace(0, len(parts[0]) - 1, ROWS).astype(int))
    few = np.concatenate([np.asarray(x[rows], float) for x in parts], 1)[:, :COLUMNS]
    lively: dict[str, np.ndarray] = {}
    for name, x in zip(names, few.T, strict=False):
        if len(np.unique(x[np.isfinite(x)])) >= VALUES:
            lively[name] = x
    if lively:
        few = np.stack([*lively.values()], 1)
        yield from _by_unit_pairs([*lively], few[np.isfinite(few).all(1)])
        yield from _among_percents([*lively], few)


def _by_unit_pairs(names: Sequence[str], x: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield (column, a sentence) on columns (N, p) that are others but for the numbers of a unit."""
    if len(x) < FEW or len(names) < 2:
        return
    mean, products = x.mean(0), np.cov(x.T)
    variance = np.diag(products)
    off = np.empty((len(UNIT_PAIRS), len(names), len(names)))  # of the second name from the first
    for number, (factor, shift, _) in enumerate(UNIT_PAIRS):
        level = mean[None, :] - factor * mean[:, None] - shift
        spread = variance[None, :] - 2 * factor * products + factor**2 * variance[:, None]
        most = ALIKE * np.sqrt(variance)
        if shift:
            most = np.minimum(LEVEL * np.sqrt(variance), SHIFT * abs(shift))
        with np.errstate(all="ignore"):  # of one that does not move in these rows
            off[number] = np.sqrt(level**2 + np.maximum(spread, 0)) / most
    for j, name in enumerate(names):
        number, i = divmod(int(np.argmin(off[:, :, j])), len(names))
        factor, shift, text = UNIT_PAIRS[number]
        if not off[number, i, j] <= 1 or _units_differ(names[i], name):
            continue
        terms = [f"{factor:.6g} * {names[i]}".removeprefix("1 * "), f"{abs(shift):g}"]
        formula = (" - " if shift < 0 else " + ").join(terms[: 1 + (shift != 0)])
        yield name, f"{name} is {formula}, as {text}: it may be in another unit"


def _units_differ(one: str, other: str) -> bool:
    """Return whether the names of two columns state two units, so that nothing has to be said."""
    units = without_unit(one)[1], without_unit(other)[1]
    return all(units) and not same_unit(*units)


def _among_percents(names: Sequence[str], x: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield (column, a sentence) on columns (N, p) between 0 and 1 of which others are in percent."""
    low, high = np.nanmin(x, axis=0, initial=np.inf), np.nanmax(x, axis=0, initial=-np.inf)
    is_fraction = (low >= 0) & (high >= SOME) & (high <= ONE)
    of_percent = (low >= 0) & (high > 2 * ONE) & (high <= 100 * ONE)
    for i in np.flatnonzero(is_fraction).tolist():
        name, span = names[i], f"lies between {low[i]:.4g} and {high[i]:.4g}"
        if PERCENT.search(name):
            yield name, f"{name} {span}: it may be a fraction, though its name says percent"
            continue
        for j in np.flatnonzero(of_percent).tolist():
            if _stem(names[j]) == _stem(name) and not _units_differ(names[j], name):
                top = f"{names[j]} goes up to {high[j]:.4g}"
                yield name, f"{name} {span}, {top}: it may be a fraction where the other is in percent"
                break


def _stem(name: str) -> str:
    """Return the letters of a name, by which columns are alike; a name of few letters is like no other."""
    letters = re.sub(r"[\W\d_]+", "", without_unit(name)[0]).lower()
    return letters if len(letters) >= LETTERS else name
