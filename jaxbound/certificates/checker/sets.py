"""YES or NO to a question about sets {center + generators x : every |x_i| <= 1, constraints x = offsets},
checked in fractions.

Each question asks whether equations M x = d have a solution with every |x_i| <= 1. YES shows one, NO a
combination l of the equations that none keeps. Whether a zonotope lies in a set is asked of its center and of
each generator: M X = [d, ..] with the sum of every |row of X| at most 1.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.claim import checksum, numbers
from jaxbound.certificates.checker.polynomial import add_multiple, combine, scale
from jaxbound.certificates.checker.words import Document, Matrix, insist

STATEMENTS = {
    "contains": (
        "l times the equations of a point in the set cannot hold: the point is outside",
        "the point is center + generators x, x keeps the constraints and every |x_i| <= 1",
    ),
    "contains_set": (
        "along l the inner set reaches farther than the outer one",
        "inner center and generators are those of the outer set times X, rows of |X| add up to at most 1",
    ),
    "intersects": (
        "l times the equations of a common point cannot hold: there is none",
        "x gives a point of both sets",
    ),
    "is_empty": (
        "l times the constraints cannot hold: the set is empty",
        "x keeps the constraints and every |x_i| <= 1: the set is not empty",
    ),
}
"""What is proved of each question where its equations have no solution, and where they have one."""


def decide(document: Document) -> None:
    """Check equations M X = D of a question, and an X within its bounds or a direction that separates."""
    every: list[F] = []
    c = numbers(document["numbers"], every)
    solvable = {"YES": True, "NO": False}[document["certificate"]]
    insist(checksum(every) == checksum([2 * c["sum"]]), "the numbers do not add up: one was changed")
    if document["question"] == "is_empty":
        solvable = not solvable
    sentence = STATEMENTS[document["question"]][solvable]
    insist(document["statement"] == sentence, f"the statement must be: {sentence}")
    M, D = _equations(document["question"], c)
    if solvable:
        X = c.get("X")
        if X is None:
            X = _column(c["x"])
        insist([combine(row, X) for row in M] == D, "x does not keep the equations")
        insist(all(sum(map(abs, row)) <= 1 for row in X), "x is out of its bounds")
        return
    # a solution has l M x = l d, and |l M x| <= sum |l M|; of a set, the point farthest along l has none
    along, (d, *spread) = combine(c["l"], M), combine(c["l"], D)
    insist(d + sum(map(abs, spread)) > sum(map(abs, along)), "the equations might hold")


def _equations(question: str, c: Document) -> tuple[Matrix, Matrix]:
    """Return (M, D) of a question about the sets of a certificate."""
    first, *others = c["sets"]
    G, A, b = first["generators"], first["constraints"], first["offsets"]
    insist(all(len(row) == len(G[0]) for row in G + A), "a row of a set is too short")
    if question == "is_empty":  # A x = b
        return A, _column(b)
    if question == "contains":  # G x = point - center, A x = b
        return G + A, _column(add_multiple(c["point"], -1, first["center"]) + b)
    (second,) = others
    G2, A2 = second["generators"], second["constraints"]
    shift = add_multiple(second["center"], -1, first["center"])
    if question == "contains_set":  # G X = [shift, G2], A X = [b, 0]
        insist(not A2, "the inner set must be a zonotope")
        inner = G2 + _zeros(len(b), len(G2[0]))
        return G + A, [[v, *row] for v, row in zip(shift + b, inner, strict=True)]
    insist(question == "intersects", "this question is not known")
    # G x - G2 x2 = shift, A x = b, A2 x2 = b2
    M = _side_by_side(G, [scale(row, -1) for row in G2])
    M += _side_by_side(A, _zeros(len(A), len(G2[0])))
    M += _side_by_side(_zeros(len(A2), len(G[0])), A2)
    return M, _column(shift + b + second["offsets"])


def _column(values: Sequence[Any]) -> list[list[Any]]:
    return [[v] for v in values]


def _zeros(height: int, width: int) -> Matrix:
    return [[F(0)] * width for _ in range(height)]


def _side_by_side(left: Matrix, right: Matrix) -> Matrix:
    return [[*a, *b] for a, b in zip(left, right, strict=True)]
