"""Polynomials with exact coefficients, in variables that are named."""

from collections.abc import Mapping
from fractions import Fraction
from math import prod
from typing import TypeAlias

__all__ = ["Monomial", "Polynomial"]

Monomial: TypeAlias = tuple[str, ...]
"""("a", "a", "b") is a^2 b."""
Term: TypeAlias = "Polynomial | Fraction | int"


class Polynomial:
    """Coefficients by monomial."""

    def __init__(self, terms: Mapping[Monomial, Fraction]) -> None:
        self.terms: dict[Monomial, Fraction] = {m: x for m, x in terms.items() if x}

    @classmethod
    def of(cls, x: Term) -> "Polynomial":
        """Return a polynomial as it is, a number as a polynomial."""
        if isinstance(x, Polynomial):
            return x
        return cls({(): Fraction(x)})

    def __add__(self, other: Term) -> "Polynomial":
        out = dict(self.terms)
        for m, x in self.of(other).terms.items():
            out[m] = out.get(m, Fraction(0)) + x
        return Polynomial(out)

    def __mul__(self, other: Term) -> "Polynomial":
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
