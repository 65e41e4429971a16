"""YES or NO to a question about sets {center + generators x : every |x_i| <= 1, constraints x = offsets},
checked in fractions.

YES shows an x, NO a combination l of the equations that no x keeps.
"""

from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.claim import numbers
from jaxbound.certificates.checker.trajectories import add, dots, insist, turned

__all__ = ["decide"]


def decide(document: dict[str, Any]) -> None:
    """Check equations M x = d of what was asked, and an x in [-1, 1]^q or a direction l with l d > sum |l
    M|.
    """
    seen: list[F] = []
    c, yes = numbers(document["numbers"], seen), {"YES": True, "NO": False}[document["certificate"]]
    insist(sum(seen) == 2 * c["sum"], "the numbers do not add up: one was changed")
    first, *others = c["sets"]
    G, A, b = first["generators"], first["constraints"], first["offsets"]
    insist(all(len(row) == len(G[0]) for row in G + A), "a row of a set is too short")
    if document["question"] == "is_empty":
        M, D, yes = A, [[v] for v in b], not yes
    elif document["question"] == "contains":
        M, D = G + A, [[v] for v in add(c["point"], [-v for v in first["center"]]) + b]
    else:
        (second,) = others
        G2, A2 = second["generators"], second["constraints"]
        shift = add(second["center"], [-v for v in first["center"]])
        if document["question"] == "contains_set":
            insist(not A2, "the inner set must be a zonotope")
            M, D = (
                G + A,
                [[v, *row] for v, row in zip(shift + b, G2 + [[F(0)] * len(G2[0]) for _ in b], strict=True)],
            )
        else:
            insist(document["question"] == "intersects", "this question is not known")
            M = [row + [-v for v in other] for row, other in zip(G, G2, strict=True)]
            M += [row + [F(0)] * len(G2[0]) for row in A] + [[F(0)] * len(G[0]) + row for row in A2]
            D = [[v] for v in shift + b + second["offsets"]]
    if yes:
        X = c["X"] if "X" in c else [[v] for v in c["x"]]
        insist([dots(turned(X), row) for row in M] == D, "x does not keep the equations")
        insist(all(sum(map(abs, row)) <= 1 for row in X), "x is out of its bounds")
    else:
        along, (d, *spread) = dots(turned(M), c["l"]), dots(turned(D), c["l"])
        insist(d + sum(map(abs, spread)) > sum(map(abs, along)), "the equations might hold")
