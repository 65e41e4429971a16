"""Certificates of decisions: exact numbers that anybody can check, one direction or one point a decision."""

from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.exact import linalg
from jaxbound.sets.zonotopes.feasibility import Found, feasible
from jaxbound.sets.zonotopes.questions import Question

__all__ = ["document", "exactly"]

BY_FACETS = "this answer was proved by all facets of the outer set, of which no short certificate is known"
MEETS = {"contains": "YES", "contains_set": "YES", "intersects": "YES", "is_empty": "NO"}
STATEMENTS = {
    ("contains", True): "the point is center + generators x, x keeps the constraints and every |x_i| <= 1",
    ("contains", False): "l times the equations of a point in the set cannot hold: the point is outside",
    (
        "contains_set",
        True,
    ): "inner center and generators are those of the outer set times X, rows of |X| add up to at most 1",
    ("contains_set", False): "along l the inner set reaches farther than the outer one",
    ("intersects", True): "x gives a point of both sets",
    ("intersects", False): "l times the equations of a common point cannot hold: there is none",
    ("is_empty", True): "x keeps the constraints and every |x_i| <= 1: the set is not empty",
    ("is_empty", False): "l times the constraints cannot hold: the set is empty",
}


def exactly(question: Question, at: tuple[int, int], guess: np.ndarray) -> Found:
    """Answer one question in exact numbers, from a guess (q,) of x: (x, None) or (None, l), as
    `feasibility.feasible`.
    """
    M, D = question.exact(at)
    return feasible(M, [row[0] for row in D], guess.tolist(), np.argsort(abs(guess), kind="stable").tolist())


def document(
    question: Question, at: tuple[int, int], answer: str, direction: np.ndarray, point: np.ndarray
) -> dict[str, Any]:
    """Return the certificate of one answer, a dict ready for JSON; see `Decision.certificate`."""
    meets = answer == MEETS[question.name]
    if question.name == "contains_set":
        found = {
            "X" if meets else "l": _matrix(question, at, point)
            if meets
            else _direction(question, at, direction)
        }
    else:
        found = _either(question, at, meets, direction, point)
    parts = ("center", "generators", "constraints", "offsets")
    numbers = {
        "sets": [{name: v[at[0]].tolist() for name, v in zip(parts, x, strict=True)} for x in question.sets],
        "point": None if question.points is None else question.points[at].tolist(),
        **found,
    }
    exact_numbers = _exact(numbers)
    exact_numbers["sum"] = sum(_leaves(exact_numbers), Fraction(0))
    return {
        "certificate": answer,
        "question": question.name,
        "statement": STATEMENTS[question.name, meets],
        "numbers": _text(exact_numbers),
    }


def _either(
    question: Question, at: tuple[int, int], meets: bool, direction: np.ndarray, point: np.ndarray
) -> dict[str, Any]:
    """Return {"x": ..} or {"l": ..}: the direction as it is where it proves the answer, else in exact
    numbers.
    """
    if not meets:
        try:
            return {"l": _direction(question, at, direction)}
        except NotImplementedError:
            pass
    x, l = exactly(question, at, point)
    assert (x is not None) == meets
    return {"x": x} if meets else {"l": l}


def _direction(question: Question, at: tuple[int, int], direction: np.ndarray) -> list[Fraction]:
    M, D = question.exact(at)
    l = [Fraction(v) for v in direction.tolist()]
    along = lambda W: linalg.matmul([l], W)[0] if W and W[0] else ()
    d, *spread = along(D)
    if d + sum(map(abs, spread)) <= sum(map(abs, along(M))):
        raise NotImplementedError(BY_FACETS)
    return l


def _matrix(question: Question, at: tuple[int, int], X: np.ndarray) -> list[list[Fraction]]:
    """Return X with M X = D exactly, near a given one: its rows with most room are solved for."""
    M, D = question.exact(at)
    order = np.argsort(abs(X).sum(1), kind="stable").tolist()
    _, pivots = linalg.row_reduce([[row[j] for j in order] for row in M])
    if len(pivots) < len(M):
        raise NotImplementedError(BY_FACETS)
    basis = [order[j] for j in pivots]
    out = _exact(X.tolist())
    rest = [j for j in range(len(X)) if j not in basis]
    known = linalg.matmul([[row[j] for j in rest] for row in M], [out[j] for j in rest]) if rest else None
    short = [
        [v - (0 if known is None else known[i][k]) for k, v in enumerate(row)] for i, row in enumerate(D)
    ]
    for j, row in zip(
        basis, linalg.matmul(linalg.inverse([[row[j] for j in basis] for row in M]), short), strict=True
    ):
        out[j] = list(row)
    if any(sum(map(abs, row)) > 1 for row in out):
        raise NotImplementedError(BY_FACETS)
    return out


def _exact(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _exact(v) for k, v in tree.items()}
    return (
        tree
        if tree is None or isinstance(tree, Fraction)
        else [_exact(v) for v in tree]
        if isinstance(tree, list)
        else Fraction(tree)
    )


def _leaves(tree: Any) -> list[Fraction]:
    branches = tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else None
    if branches is None:
        return [] if tree is None else [tree]
    return [leaf for branch in branches for leaf in _leaves(branch)]


def _text(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _text(v) for k, v in tree.items()}
    return [_text(v) for v in tree] if isinstance(tree, list) else None if tree is None else str(tree)
