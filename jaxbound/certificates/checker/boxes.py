"""FAULT of a model with uncertain parameters: a tree of boxes of them, each with a combination of relations
that cannot be 0 in it.

The words are those of `proof`. A relation is a list of polynomials in the parameters, a polynomial a list of
[coefficient, number of a variable, ..], with a variable squared twice.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from itertools import product
from math import prod
from typing import Any

from jaxbound.certificates.checker.trajectories import follow, insist, limits, turned

__all__ = ["Polynomial", "contradict"]

LEAF = {"direction", "vertices", "low", "high"}
CUT = {"variable", "at", "below", "above"}


class Polynomial:
    """Numbers by monomial: (1, 1, 4) is v_1^2 v_4."""

    def __init__(self, terms: dict) -> None:
        self.terms = {m: x for m, x in terms.items() if x}

    def __add__(self, other: Any) -> "Polynomial":
        out = dict(self.terms)
        for m, x in _polynomial(other).terms.items():
            out[m] = out.get(m, F(0)) + x
        return Polynomial(out)

    def __mul__(self, other: Any) -> "Polynomial":
        out: dict = {}
        for m, x in self.terms.items():
            for n, y in _polynomial(other).terms.items():
                both = tuple(sorted(m + n))
                out[both] = out.get(both, F(0)) + x * y
        return Polynomial(out)

    __radd__, __rmul__ = __add__, __mul__

    def __eq__(self, other: object) -> bool:
        return self.terms == _polynomial(other).terms

    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        return bool(self.terms)

    def at(self, v: Any) -> F:
        """Return the value where variable i is v[i]."""
        return sum((prod([x, *(v[int(i)] for i in m)]) for m, x in self.terms.items()), F(0))

    def span(self, lo: Sequence[F], hi: Sequence[F]) -> tuple[F, F]:
        """Return (low, high), which holds all values over a box: each monomial around the middle by
        itself.
        """
        v = [
            Polynomial({(): (a + b) / 2, (i,): (b - a) / 2})
            for i, (a, b) in enumerate(zip(lo, hi, strict=True))
        ]
        whole = Polynomial({})
        for m, x in self.terms.items():
            whole = whole + prod([x, *(v[int(i)] for i in m)])
        low = high = whole.terms.pop((), F(0))
        for m, x in whole.terms.items():
            if all(m.count(i) % 2 == 0 for i in m):
                low, high = low + min(x, 0), high + max(x, 0)
            else:
                low, high = low - abs(x), high + abs(x)
        return low, high


def _polynomial(x):
    return x if isinstance(x, Polynomial) else Polynomial({(): x})


def contradict(c: dict[str, Any], given: Sequence[dict], proof: dict) -> None:
    """Check that no v within its bounds, and no errors, explain the samples."""
    count, relations = len(c["variables"]), []
    variables = [Polynomial({(i,): F(1)}) for i in range(count)]
    for r in given:
        insist(set(r) == {"h", "g", "k"}, "a number of a relation is missing or unknown")
        read: dict = {part: [[_read(p, count) for p in row] for row in r[part]] for part in ("h", "g", "k")}
        follow(c, read, variables)
        relations.append(_values(c, read))
    bounds = [c["uncertainties"][int(who)]["bound"] for who, _ in c["variables"]]
    _exclude(proof, relations, [-b for b in bounds], bounds)


def _read(terms, count):
    """Return the Polynomial of a list of [coefficient, number of a variable, ..]."""
    out = Polynomial({})
    for x, *m in terms:
        insist(all(i in range(count) for i in m), "a polynomial has an unknown variable")
        out = out + Polynomial({tuple(sorted(int(i) for i in m)): x})
    return out


def _values(c, read):
    """Return [value at the middles, half-widths times polynomials ..] of a relation."""
    middle, spread = Polynomial({}), list[Polynomial]()
    for h, g, k, u, (readings, w) in zip(*read.values(), c["u"], limits(c), strict=True):
        for x, ends in zip(h + g, readings + w, strict=True):
            insist(ends is not None or not x, "a relation needs a reading that is missing")
            lo, hi = ends or (F(0), F(0))
            middle, spread = middle + x * ((lo + hi) / 2), [*spread, x * ((hi - lo) / 2)]
        for x, value, offset in zip(k, u, c["offset_u"], strict=True):
            insist(value is not None or not x, "a relation needs an input that is missing")
            middle = middle + x * (offset - value) if x else middle
    return [middle, *spread]


def _exclude(proof, relations, lo, hi):
    """Check that in the box lo <= v <= hi some combination of the relations cannot be 0."""
    if "at" in proof:
        insist(set(proof) == CUT and proof["variable"] in range(len(lo)), "a cut is not known")
        i = int(proof["variable"])
        insist(lo[i] <= proof["at"] <= hi[i], "a box is cut outside of itself")
        _exclude(proof["below"], relations, lo, [*hi[:i], proof["at"], *hi[i + 1 :]])
        return _exclude(proof["above"], relations, [*lo[:i], proof["at"], *lo[i + 1 :]], hi)
    insist(set(proof) == LEAF and proof["vertices"] in (0, 1), "a leaf is not known")
    parts = []
    for part in turned(relations):
        parts.append(sum((a * x for a, x in zip(proof["direction"], part, strict=True)), Polynomial({})))
    middle, *spread = parts
    if proof["vertices"]:
        low, high = _at_vertices(middle, spread, lo, hi)
    else:
        low, high = middle.span(lo, hi)
        reach = sum((max(map(abs, p.span(lo, hi))) for p in spread), F(0))
        low, high = low - reach, high + reach
    insist([low, high] == [proof["low"], proof["high"]], "the range of a combination is wrong")
    insist(low > 0 or high < 0, "a combination may be 0")


def _at_vertices(middle, spread, lo, hi):
    """Return (low, high) over the vertices of a box: exact where no variable is squared."""
    monomials = [m for p in (middle, *spread) for m in p.terms]
    insist(all(len(set(m)) == len(m) for m in monomials), "vertices say nothing about powers")
    used, ends = sorted({i for m in monomials for i in m}), []
    for chosen in product(*((lo[i], hi[i]) for i in used)):
        v = dict(zip(used, chosen, strict=True))
        value, reach = middle.at(v), sum((abs(p.at(v)) for p in spread), F(0))
        ends += [value - reach, value + reach]
    return min(ends), max(ends)
