"""Numbers and polynomials, exact, and sums of their products: vectors and matrices are lists of either."""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import chain
from math import lcm, prod
from typing import Any, TypeAlias

Monomial: TypeAlias = tuple[str, ...]
"""("a", "a", "b") is a^2 b."""


class Polynomial:
    """Coefficients by monomial, in variables that are named."""

    def __init__(self, terms: Mapping[Monomial, Fraction]) -> None:
        self.terms: dict[Monomial, Fraction] = {m: x for m, x in terms.items() if x}

    @classmethod
    def of(cls, x: "Value | int") -> "Polynomial":
        """Return a polynomial as it is, a number as a polynomial."""
        if isinstance(x, Polynomial):
            return x
        return cls({(): Fraction(x)})

    def __add__(self, other: "Value | int") -> "Polynomial":
        out = dict(self.terms)
        for m, x in self.of(other).terms.items():
            out[m] = out.get(m, Fraction(0)) + x
        return Polynomial(out)

    def __mul__(self, other: "Value | int") -> "Polynomial":
        if not isinstance(other, Polynomial):
            return Polynomial({m: x * other for m, x in self.terms.items()})
        out: dict[Monomial, Fraction] = {}
        for m, x in self.terms.items():
            for n, y in other.terms.items():
                both = tuple(sorted(m + n))
                out[both] = out.get(both, Fraction(0)) + x * y
        return Polynomial(out)

    __radd__, __rmul__ = __add__, __mul__

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Polynomial | Fraction | int):
            return bool(self.terms == self.of(other).terms)
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]  # equal to numbers, whose hash it does not have

    def __bool__(self) -> bool:
        return bool(self.terms)

    def at(self, v: Mapping[str, Fraction]) -> Fraction:
        """Return the value where each variable is its entry of v."""
        total = Fraction(0)
        for m, x in self.terms.items():
            total += x * prod(v[i] for i in m)
        return total


Value: TypeAlias = Polynomial | Fraction
"""A number, or a polynomial in uncertain parameters or unknowns."""


def dot(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """Return the sum of products of numbers or polynomials; numbers over one denominator, reduced once."""
    total, over = 0, 1
    beyond: Value = Fraction(0)
    for x, y in zip(a, b, strict=True):
        if isinstance(x, Polynomial) or isinstance(y, Polynomial):
            beyond = beyond + x * y
        elif x and y:
            below = x.denominator * y.denominator
            common = lcm(over, below)
            total = total * (common // over) + x.numerator * y.numerator * (common // below)
            over = common
    return Fraction(total, over) + beyond


def combine(weights: Sequence[Any], *matrices: Iterable[Sequence[Any]]) -> list[Any]:
    """Return weights times the rows of matrices that stand above each other: h C + q A for (h, q), C, A."""
    return [dot(weights, column) for column in zip(*chain.from_iterable(matrices), strict=True)]


def scale(row: Iterable[Any], factor: Value | int) -> list[Any]:
    """Return factor * row."""
    return [factor * x for x in row]


def add_multiple(row: Iterable[Any], factor: Value | int, other: Iterable[Any]) -> list[Any]:
    """Return row + factor * other."""
    return [x + factor * y for x, y in zip(row, other, strict=True)]


def variables(prefix: str, count: int) -> list[Any]:
    """Return numbered variables as polynomials."""
    return [Polynomial({(f"{prefix}{i}",): Fraction(1)}) for i in range(count)]
