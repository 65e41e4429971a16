"""FAULT of a model with uncertain parameters: a tree of boxes of them, each with a combination of relations
that cannot be 0 in it.

The letters are those of `proof`. A relation is a list of polynomials in the parameters, a polynomial a list
of [coefficient, number of a variable, ..], with a variable squared twice.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction as F
from itertools import product
from math import prod
from typing import Any, TypeAlias

from jaxbound.certificates.checker.inequalities import added_up, multipliers, rows_of
from jaxbound.certificates.checker.polynomial import Polynomial
from jaxbound.certificates.checker.vectors import dots, turned
from jaxbound.certificates.checker.words import Claim, Document, Ends, Relation, insist

__all__ = ["contradict"]

LEAF = {"direction", "vertices", "low", "high"}
CUT = {"variable", "at", "below", "above"}

Parts: TypeAlias = list[Polynomial]
"""[P, Q_1, Q_2, ..]: a relation at the samples is P(v) + sum_j e_j Q_j(v) for some |e_j| <= 1."""
Box: TypeAlias = Mapping[str, Ends]
"""(lo, hi) of each parameter."""


def contradict(c: Claim, shown: Sequence[Document], proof: Document) -> None:
    """Check that no v within its bounds, and no errors, explain the samples.

    Each relation holds for every trajectory at every v, so a healthy window has a v and errors at which all
    of them are 0: its rows lo <= row <= hi, each times its multiplier, add up to a polynomial of v.
    """
    rows = rows_of(c)
    box = {f"p{k}": (-bound, bound) for k, bound in enumerate(_bounds(c))}
    variables = [Polynomial({(name,): F(1)}) for name in box]
    relations = []
    for r in shown:
        insist(set(r) == {"h", "g", "k"}, "a number of a relation is missing or unknown")
        relation: Relation = {
            "h": _read(r["h"], len(box)),
            "g": _read(r["g"], len(box)),
            "k": _read(r["k"], len(box)),
        }
        found = multipliers(c, relation, rows, variables)
        middle, spread = added_up(rows, found) * F(-1), []
        insist({name for m in middle.terms for name in m} <= set(box), "a relation leaves an unknown over")
        for row, x in zip(rows, found, strict=True):
            if row.lo is not None and row.hi is not None:
                middle = middle + x * ((row.lo + row.hi) / 2)
                spread.append(x * ((row.hi - row.lo) / 2))
        relations.append([middle, *spread])
    _exclude(proof, relations, box)


def _bounds(c: Claim) -> list[F]:
    """Return the bound of each variable."""
    return [c["uncertainties"][int(parameter)]["bound"] for parameter, _ in c["variables"]]


def _read(rows: Sequence[Sequence[Any]], count: int) -> list[Parts]:
    """Return rows of lists of [coefficient, number of a variable, ..] as rows of polynomials."""
    return [[_polynomial(terms, count) for terms in row] for row in rows]


def _polynomial(terms: Any, count: int) -> Polynomial:
    out = Polynomial({})
    for x, *m in terms:
        insist(all(i in range(count) for i in m), "a polynomial has an unknown variable")
        out = out + Polynomial({tuple(sorted(f"p{int(i)}" for i in m)): x})
    return out


def _exclude(proof: Document, relations: Sequence[Parts], box: Box) -> None:
    """Check that in a box of v some combination of the relations cannot be 0."""
    if "at" not in proof:
        return _exclude_at_once(proof, relations, box)
    insist(set(proof) == CUT and proof["variable"] in range(len(box)), "a cut is not known")
    name, at = f"p{int(proof['variable'])}", proof["at"]
    lo, hi = box[name]
    insist(lo <= at <= hi, "a box is cut outside of itself")
    # the two parts together are the box
    _exclude(proof["below"], relations, {**box, name: (lo, at)})
    _exclude(proof["above"], relations, {**box, name: (at, hi)})


def _exclude_at_once(leaf: Document, relations: Sequence[Parts], box: Box) -> None:
    """Check that one combination l of the relations, l P + sum_j e_j l Q_j, is not 0 anywhere in a box."""
    insist(set(leaf) == LEAF and leaf["vertices"] in (0, 1), "a leaf is not known")
    middle, *spread = map(Polynomial.of, dots(turned(relations), leaf["direction"]))
    if leaf["vertices"]:
        low, high = _at_vertices(middle, spread, box)
    else:
        low, high = _by_monomials(middle, spread, box)
    insist([low, high] == [leaf["low"], leaf["high"]], "the range of a combination is wrong")
    insist(low > 0 or high < 0, "a combination may be 0")


def _by_monomials(P: Polynomial, Q: Parts, box: Box) -> Ends:
    """Return (low, high), which holds P + sum_j e_j Q_j over a box: the range of P and the sizes of all Q."""
    low, high = _span(P, box)
    for q in Q:
        reach = max(map(abs, _span(q, box)))
        low, high = low - reach, high + reach
    return low, high


def _span(p: Polynomial, box: Box) -> Ends:
    """Return (low, high), which holds all values over a box: each monomial around the middle by itself."""
    v = {}  # v_i = middle_i + radius_i z_i, with |z_i| <= 1
    for name, (lo, hi) in box.items():
        v[name] = Polynomial({(): (lo + hi) / 2, (name,): (hi - lo) / 2})
    around = Polynomial({})
    for m, x in p.terms.items():
        around = around + prod((v[i] for i in m), start=Polynomial({(): x}))
    low = high = around.terms.pop((), F(0))
    for m, x in around.terms.items():
        if all(m.count(i) % 2 == 0 for i in m):  # a square: its values are in [0, 1]
            low, high = low + min(x, F(0)), high + max(x, F(0))
        else:
            low, high = low - abs(x), high + abs(x)
    return low, high


def _at_vertices(P: Polynomial, Q: Parts, box: Box) -> Ends:
    """Return (low, high) of P + sum_j e_j Q_j over the vertices of a box: its range where no variable is
    squared, since it is then extreme at a vertex.
    """
    monomials = [m for p in (P, *Q) for m in p.terms]
    insist(all(len(set(m)) == len(m) for m in monomials), "vertices say nothing about powers")
    used = sorted({i for m in monomials for i in m})
    ends = []
    for vertex in product(*(box[name] for name in used)):
        v = dict(zip(used, vertex, strict=True))
        value, reach = P.at(v), sum((abs(q.at(v)) for q in Q), F(0))
        ends += [value - reach, value + reach]
    return min(ends), max(ends)
