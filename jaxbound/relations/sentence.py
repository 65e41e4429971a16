"""Relations as a reader would write them."""

import re
from collections.abc import Iterable
from fractions import Fraction

from jaxbound.consistency.interface import Relations
from jaxbound.exact.linalg import Vector
from jaxbound.models.region import Reach
from jaxbound.models.rows import Kind, Row
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows

LABEL = re.compile(r"(?:[^\s:]+: )+")
FEW = 8
"""Relations that are shown at a prompt."""


def looked_at(relations: Reach) -> str:
    """Say on which samples a verdict of relations, or of an observer, rests."""
    tests = getattr(relations, "parts", {})
    if tests:
        return f"{len(tests)} tests: {', '.join(tests)}"
    if relations.remembers:
        return "everything since it began"
    return f"windows of {relations.horizon + 1} samples"


def few_lines(relations: Relations) -> dict[str, str]:
    """Return the rows by which relations show themselves at a prompt: their model, and each of few."""
    rows = {"model": repr(relations.model)}
    if relations.count <= FEW:
        for i, line in enumerate(relations.text().splitlines(), 1):
            rows[str(i)] = main_terms(line)
    return rows


def main_terms(relation: str, most: int = 6) -> str:
    """Return a long relation by its largest terms, in their order, "..." where others stand; any other text
    as it is.

    So are the sums in brackets that multiply a signal. A name in front, "r1: ", stays.

    Example:
        >>> main_terms("2 a[k-1] - 0.1 b[k] + c[k] = 0", most=2)
        '2 a[k-1] + c[k] + ... = 0'
        >>> main_terms("0.5 AHU: T[k-1] + AHU: T[k] - 0.1 AHU: u[k] = 0", most=2)
        '0.5 AHU: T[k-1] + AHU: T[k] + ... = 0'
        >>> main_terms("r1: (q^2 - 0.1 q + 3) a - b = 0", most=2)
        'r1: (q^2 + 3 + ...) a - b = 0'
    """
    named = LABEL.match(relation)
    begun = named.end() if named else 0  # a signal may have a colon in its name, too
    left, equals, right = relation[begun:].partition(" = ")
    if not equals:
        return relation
    return f"{relation[:begun]}{_largest(left, most)} = {right}"


def _largest(total: str, most: int) -> str:
    """Return a sum by its largest terms."""
    terms = _terms(total)
    by_size = sorted(range(len(terms)), key=lambda i: -_size(terms[i][1]))
    # in the order of the relation: a reader finds each again
    kept = sorted(by_size[:most])
    text = ""
    for i in kept:
        sign, term = terms[i]
        text += f" {sign} {_inside(term, most)}"
    if len(kept) < len(terms):
        text += " + ..."
    return text.removeprefix(" ").removeprefix("+ ")


def _terms(total: str) -> list[tuple[str, str]]:
    """Return [(sign, term)] of a sum; what stands in brackets is one term."""
    found, depth, sign, begun = [], 0, "+", 0
    if total.startswith("- "):
        sign, begun = "-", 2
    for i, letter in enumerate(total):
        depth += (letter == "(") - (letter == ")")
        # a sign counts where it joins two terms: not that of an exponent, nor one in brackets
        if i > begun and not depth and total[i - 1 : i + 2] in (" + ", " - "):
            found.append((sign, total[begun : i - 1]))
            sign, begun = letter, i + 2
    return [*found, (sign, total[begun:])]


def _inside(term: str, most: int) -> str:
    """Return a term whose bracket in front, if there is one, is shortened."""
    inner, closed, behind = term.removeprefix("(").partition(")")
    if not term.startswith("(") or not closed or "(" in inner:
        return term
    return f"({_largest(inner, most)}){behind}"


def _size(term: str) -> float:
    """Return how large the factor of a term is: of a sum in brackets its largest."""
    if term.startswith("("):
        return max(_size(each) for _, each in _terms(term[1:].partition(")")[0]))
    factor = term.lstrip("-").split(" ")[0]
    try:
        return abs(float(factor))
    except ValueError:
        return 1.0


def relation_text(model: LinearSystem, horizon: int, h: Vector, k: Vector) -> str:
    """Return one relation h Y - k U = 0 as text."""
    at = sample_names(horizon)
    terms = []
    for x, row in zip(h, window_rows(model, horizon), strict=False):  # stated relations may leave rows out
        if x:
            name = row_name(model, row)
            if row.kind is Kind.SUM:
                name = f"({name})"
            terms.append((x, name + at[row.last]))
    for i, x in enumerate(k):
        if x:
            terms.append((-x, model.inputs[i % model.m] + at[i // model.m]))
    return f"{sum_text(terms)} = 0"


def sum_text(terms: Iterable[tuple[Fraction, str]]) -> str:
    """Return a sum of (factor, name) as text."""
    return joined(((x < 0, _factor(abs(x)) + name) for x, name in terms if x), "- ")


def joined(terms: Iterable[tuple[bool, str]], minus: str = "-") -> str:
    """Return a sum as text, of (whether a term is negative, its size); minus: the sign of the first term."""
    out = ""
    for negative, size in terms:
        if out:
            out += (" + ", " - ")[negative] + size
        else:
            out = negative * minus + size
    return out


def bracketed(total: str, terms: int) -> str:
    """Return a sum of so many terms as a factor in front of a name: in brackets, or nothing for 1."""
    if total == "1":
        return ""
    if terms > 1:
        return f"({total}) "
    return f"{total} "


def at_sample(name: str, lag: int | None, horizon: int) -> str:
    """Return the name of a value at a sample of a window; None: it keeps one value."""
    if lag is None:
        return name
    return name + sample_names(horizon)[lag]


def sample_names(horizon: int) -> list[str]:
    """Return the places of the samples of a window in text: [k-1], [k] of two."""
    return [f"[k-{lag}]" for lag in range(horizon, 0, -1)] + ["[k]"]


def row_name(model: LinearSystem, row: Row) -> str:
    """Return the name of the values that a row speaks of."""
    if row.kind is Kind.READING:
        return model.outputs[row.number]
    if row.kind is Kind.DISTURBANCE:
        return f"w{row.number + 1}"
    return model.averages[row.number].text


def _factor(size: Fraction) -> str:
    """Return the factor of a term, nothing for 1."""
    if size == 1:
        return ""
    return f"{number_text(size)} "


def number_text(x: Fraction) -> str:
    """Return a whole number as it is, another one to six digits."""
    if x.denominator == 1:
        return str(x)
    return f"{float(x):.6g}"
