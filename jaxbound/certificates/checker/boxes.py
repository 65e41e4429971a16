"""FAULT of a model with uncertain parameters: a tree of boxes of them, each with a combination of relations
that cannot be 0 in it.

The letters are those of `proof`. A relation is a list of polynomials in the parameters, a polynomial a list
of [coefficient, number of a variable, ..], with a variable squared twice.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from itertools import product
from math import prod
from typing import Any, TypeAlias

from jaxbound.certificates.checker.polynomial import Polynomial
from jaxbound.certificates.checker.trajectories import follow, limits
from jaxbound.certificates.checker.vectors import dots, turned
from jaxbound.certificates.checker.words import Claim, Document, Ends, Relation, insist

__all__ = ["contradict"]

LEAF = {"direction", "vertices", "low", "high"}
CUT = {"variable", "at", "below", "above"}

Parts: TypeAlias = "list[Polynomial[int]]"
"""[P, Q_1, Q_2, ..]: a relation at the samples is P(v) + sum_j e_j Q_j(v) for some |e_j| <= 1."""


def contradict(c: Claim, shown: Sequence[Document], proof: Document) -> None:
    """Check that no v within its bounds, and no errors, explain the samples.

    Each relation holds for every trajectory at every v, so a healthy window has a v and errors at which all
    of them are 0.
    """
    count = len(c["variables"])
    variables = [Polynomial({(i,): F(1)}) for i in range(count)]
    relations = []
    for r in shown:
        insist(set(r) == {"h", "g", "k"}, "a number of a relation is missing or unknown")
        relation: Relation = {
            "h": _read(r["h"], count),
            "g": _read(r["g"], count),
            "k": _read(r["k"], count),
        }
        follow(c, relation, variables)
        relations.append(_at_samples(c, relation))
    hi = [c["uncertainties"][int(parameter)]["bound"] for parameter, _ in c["variables"]]
    lo = [-bound for bound in hi]
    _exclude(proof, relations, lo, hi)


def _read(rows: Sequence[Sequence[Document]], count: int) -> list[Parts]:
    """Return rows of lists of [coefficient, number of a variable, ..] as rows of polynomials."""
    read = []
    for row in rows:
        read.append([_polynomial(terms, count) for terms in row])
    return read


def _polynomial(terms: Any, count: int) -> Polynomial[int]:
    out = Polynomial[int]({})
    for x, *m in terms:
        insist(all(i in range(count) for i in m), "a polynomial has an unknown variable")
        out = out + Polynomial({tuple(sorted(map(int, m))): x})
    return out


def _at_samples(c: Claim, r: Relation) -> Parts:
    """Return a relation with samples and bounds put in: t and w lie within their limits, u is known.

    sum h t + g w - k u = P + sum_j e_j Q_j, with P from the middles of the limits, Q from their half-widths.
    """
    middle, spread = Polynomial[int]({}), []
    for h, g, k, u, (readings, w) in zip(r["h"], r["g"], r["k"], c["u"], limits(c), strict=True):
        for x, ends in zip([*h, *g], [*readings, *w], strict=True):
            if ends is None:
                insist(not x, "a relation needs a reading that is missing")
                continue
            lo, hi = ends
            middle = middle + x * ((lo + hi) / 2)
            spread.append(x * ((hi - lo) / 2))
        for x, value, offset in zip(k, u, c["offset_u"], strict=True):
            if not x:
                continue
            if value is None:
                raise ValueError("a relation needs an input that is missing")
            middle = middle + x * (offset - value)
    return [middle, *spread]


def _exclude(proof: Document, relations: Sequence[Parts], lo: Sequence[F], hi: Sequence[F]) -> None:
    """Check that in the box lo <= v <= hi some combination of the relations cannot be 0."""
    if "at" not in proof:
        return _exclude_at_once(proof, relations, lo, hi)
    insist(set(proof) == CUT and proof["variable"] in range(len(lo)), "a cut is not known")
    i, at = int(proof["variable"]), proof["at"]
    insist(lo[i] <= at <= hi[i], "a box is cut outside of itself")
    # the two parts together are the box
    _exclude(proof["below"], relations, lo, [*hi[:i], at, *hi[i + 1 :]])
    _exclude(proof["above"], relations, [*lo[:i], at, *lo[i + 1 :]], hi)


def _exclude_at_once(leaf: Document, relations: Sequence[Parts], lo: Sequence[F], hi: Sequence[F]) -> None:
    """Check that one combination l of the relations, l P + sum_j e_j l Q_j, is not 0 anywhere in a box."""
    insist(set(leaf) == LEAF and leaf["vertices"] in (0, 1), "a leaf is not known")
    middle, *spread = map(Polynomial[int].of, dots(turned(relations), leaf["direction"]))
    if leaf["vertices"]:
        low, high = _at_vertices(middle, spread, lo, hi)
    else:
        low, high = _by_monomials(middle, spread, lo, hi)
    insist([low, high] == [leaf["low"], leaf["high"]], "the range of a combination is wrong")
    insist(low > 0 or high < 0, "a combination may be 0")


def _by_monomials(P: Polynomial[int], Q: Parts, lo: Sequence[F], hi: Sequence[F]) -> Ends:
    """Return (low, high), which holds P + sum_j e_j Q_j over a box: the range of P and the sizes of all Q."""
    low, high = _span(P, lo, hi)
    for q in Q:
        reach = max(map(abs, _span(q, lo, hi)))
        low, high = low - reach, high + reach
    return low, high


def _span(p: Polynomial[int], lo: Sequence[F], hi: Sequence[F]) -> Ends:
    """Return (low, high), which holds all values over a box: each monomial around the middle by itself."""
    v = []  # v_i = middle_i + radius_i z_i, with |z_i| <= 1
    for i, (a, b) in enumerate(zip(lo, hi, strict=True)):
        v.append(Polynomial({(): (a + b) / 2, (i,): (b - a) / 2}))
    around = Polynomial[int]({})
    for m, x in p.terms.items():
        around = around + prod((v[i] for i in m), start=Polynomial({(): x}))
    low = high = around.terms.pop((), F(0))
    for m, x in around.terms.items():
        if all(m.count(i) % 2 == 0 for i in m):  # a square: its values are in [0, 1]
            low, high = low + min(x, F(0)), high + max(x, F(0))
        else:
            low, high = low - abs(x), high + abs(x)
    return low, high


def _at_vertices(P: Polynomial[int], Q: Parts, lo: Sequence[F], hi: Sequence[F]) -> Ends:
    """Return (low, high) of P + sum_j e_j Q_j over the vertices of a box: its range where no variable is
    squared, since it is then extreme at a vertex.
    """
    monomials = [m for p in (P, *Q) for m in p.terms]
    insist(all(len(set(m)) == len(m) for m in monomials), "vertices say nothing about powers")
    used = sorted({i for m in monomials for i in m})
    ends = []
    for vertex in product(*((lo[i], hi[i]) for i in used)):
        v = dict(zip(used, vertex, strict=True))
        value, reach = P.at(v), sum((abs(q.at(v)) for q in Q), F(0))
        ends += [value - reach, value + reach]
    return min(ends), max(ends)
