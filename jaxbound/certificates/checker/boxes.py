"""Relations at the samples, over a box of uncertain parameters and of gains that keep their
value: a relation is P(v) + sum_j e_j Q_j(v) = 0 for some v in the box and some |e_j| <= 1.

A polynomial is shown as a list of [coefficient, number of a variable, ..], with a variable squared twice.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction as F
from itertools import product
from math import prod
from typing import Any, TypeAlias

from jaxbound.certificates.checker.polynomial import Polynomial, Value, combine, variables
from jaxbound.certificates.checker.trajectories import Error, limits, multipliers
from jaxbound.certificates.checker.words import Document, Ends, insist

LEAF = {"direction", "vertices", "low", "high"}
CUT = {"variable", "at", "below", "above"}

Parts: TypeAlias = list[Value]
"""[P, Q_1, Q_2, ..] of a relation."""
Box: TypeAlias = Mapping[str, Ends]
"""(lo, hi) of each parameter or gain."""


def relation_range(c: Document, r: Document, error: Error = None) -> Ends:
    """Return (low, high) of a relation of an exact plant at the samples: no trajectory keeps them unless 0 is
    in it.
    """
    ends = limits(c, error)
    parts = _parts(c, r, ends, [])
    return _at_vertices(*_polynomials(parts), ends)


def contradict(c: Document, shown: Sequence[Document], proof: Document) -> None:
    """Check that no v within its bounds, and no errors, explain the samples.

    Each relation holds for every trajectory at every v, so a healthy window has a v and errors at which all
    of them are 0.
    """
    _check_excluded(proof, checked_relations(c, shown), box_of(c))


def box_of(c: Document) -> dict[str, Ends]:
    """Return the bounds of every v."""
    ends = limits(c)
    return {name: ends[name] for name in (f"p{k}" for k in range(len(c["variables"])))}


def checked_relations(c: Document, shown: Sequence[Document]) -> list[Parts]:
    """Return the parts of relations at the samples, checked to hold for every trajectory."""
    ends, count, relations = limits(c), len(c["variables"]), []
    for r in shown:
        insist(set(r) == {"h", "g", "k"}, "a number of a relation is missing or unknown")
        read: Document = {"h": [], "g": [], "k": []}
        for name, rows in r.items():
            for row in rows:
                read[name].append([_polynomial(terms, count) for terms in row])
        relations.append(_parts(c, read, ends, variables("p", count)))
    return relations


def range_of(direction: Sequence[F], relations: Sequence[Parts], box: Box, vertices: bool) -> Ends:
    """Return (low, high), which holds a combination of relations over a box: at its vertices, or by
    monomials.
    """
    P, Q = _polynomials(combine(direction, relations))
    if vertices:
        return _at_vertices(P, Q, box)
    return _by_monomials(P, Q, box)


def _parts(c: Document, r: Document, ends: Mapping[str, Ends], v: Sequence[Value]) -> Parts:
    """Return the middle of what samples and bounds allow of a relation, and how far each may move it."""
    found, of_inputs = multipliers(c, r, v)
    middle, spread = -1 * of_inputs, []
    for name, x in found.items():
        there = not x or name in ends or name.startswith("step")
        insist(there, "the relation needs a reading that is missing, or what has no bounds")
    for name, (lo, hi) in ends.items():
        x = found.get(name, F(0))
        if x and "constant" in c and name[0] == "y":
            x = Polynomial({("g" + name.split("_")[1],): F(1)}) * x
        middle = middle + x * ((lo + hi) / 2)
        spread.append(x * ((hi - lo) / 2))
    return [middle, *spread]


def _polynomial(terms: Any, count: int) -> Polynomial:
    out = Polynomial({})
    for x, *m in terms:
        insist(set(m) <= set(range(count)), "a polynomial has an unknown variable")
        out = out + Polynomial({tuple(sorted(f"p{int(i)}" for i in m)): x})
    return out


def _polynomials(parts: Sequence[Value]) -> tuple[Polynomial, list[Polynomial]]:
    P, *Q = map(Polynomial.of, parts)
    return P, [q for q in Q if q]


def _check_excluded(proof: Document, relations: Sequence[Parts], box: Box) -> None:
    """Check that in a box of v some combination of the relations cannot be 0."""
    if "at" not in proof:
        return _exclude_at_once(proof, relations, box)
    insist(set(proof) == CUT and proof["variable"] in range(len(box)), "a cut is not known")
    name, at = f"p{int(proof['variable'])}", proof["at"]
    lo, hi = box[name]
    insist(lo <= at <= hi, "a box is cut outside of itself")
    # the two parts together are the box
    _check_excluded(proof["below"], relations, {**box, name: (lo, at)})
    _check_excluded(proof["above"], relations, {**box, name: (at, hi)})


def _exclude_at_once(leaf: Document, relations: Sequence[Parts], box: Box) -> None:
    """Check that one combination l of the relations, l P + sum_j e_j l Q_j, is not 0 anywhere in a box."""
    insist(set(leaf) == LEAF and leaf["vertices"] in (0, 1), "a leaf is not known")
    low, high = range_of(leaf["direction"], relations, box, leaf["vertices"] == 1)
    insist([low, high] == [leaf["low"], leaf["high"]], "the range of a combination is wrong")
    insist(low > 0 or high < 0, "a combination may be 0")


def _by_monomials(P: Polynomial, Q: Sequence[Polynomial], box: Box) -> Ends:
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


def _at_vertices(P: Polynomial, Q: Sequence[Polynomial], box: Box) -> Ends:
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
