"""Polynomials with exact coefficients, in variables that are numbered or named."""

from collections.abc import Mapping
from fractions import Fraction
from math import prod
from typing import Generic, TypeAlias, TypeVar

__all__ = ["Polynomial"]

Variable = TypeVar("Variable", int, str)
Term: TypeAlias = "Polynomial[Variable] | Fraction | int"


class Polynomial(Generic[Variable]):
    """Coefficients by monomial: (1, 1, 4) is v_1^2 v_4."""

    def __init__(self, terms: Mapping[tuple[Variable, ...], Fraction]) -> None:
        self.terms: dict[tuple[Variable, ...], Fraction] = {m: x for m, x in terms.items() if x}

    @classmethod
    def of(cls, x: "Term[Variable]") -> "Polynomial[Variable]":
        """Return a polynomial as it is, a number as a polynomial."""
        if isinstance(x, Polynomial):
            return x
        return cls({(): Fraction(x)})

    def __add__(self, other: "Term[Variable]") -> "Polynomial[Variable]":
        out = dict(self.terms)
        for m, x in self.of(other).terms.items():
            out[m] = out.get(m, Fraction(0)) + x
        return Polynomial(out)

    def __mul__(self, other: "Term[Variable]") -> "Polynomial[Variable]":
        out: dict[tuple[Variable, ...], Fraction] = {}
        for m, x in self.terms.items():
            for n, y in self.of(other).terms.items():
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

    def at(self, v: Mapping[Variable, Fraction]) -> Fraction:
        """Return the value where variable i is v[i]."""
        total = Fraction(0)
        for m, x in self.terms.items():
            total += x * prod(v[i] for i in m)
        return total
