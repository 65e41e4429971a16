"""Certificates of decisions: exact numbers that anybody can check, one direction or one point a decision."""

from fractions import Fraction
from typing import Any

import jax
import numpy as np

from jaxbound.exact import linalg
from jaxbound.sets.zonotopes.feasibility import Found, feasible
from jaxbound.sets.zonotopes.questions import Question

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


def exactly(question: Question, at: tuple[int, int]) -> Found:
    """Answer one question in exact numbers: (x, None) or (None, l), as `feasibility.feasible`."""
    M, D = question.exact(at)
    return feasible(M, [row[0] for row in D])


def document(
    question: Question, at: tuple[int, int], answer: str, direction: np.ndarray, point: np.ndarray
) -> dict[str, Any]:
    """Return the certificate of one answer, a dict ready for JSON; see `Decision.certificate`."""
    meets = answer == MEETS[question.name]
    parts = ("center", "generators", "constraints", "offsets")
    numbers = {
        "sets": [{name: v[at[0]].tolist() for name, v in zip(parts, x, strict=True)} for x in question.sets],
        "point": None if question.points is None else question.points[at].tolist(),
        **_proof_entry(question, at, meets, direction, point),
    }
    numbers = jax.tree.map(Fraction, numbers)
    numbers["sum"] = sum(jax.tree.leaves(numbers), Fraction(0))
    return {
        "certificate": answer,
        "question": question.name,
        "statement": STATEMENTS[question.name, meets],
        "numbers": jax.tree.map(str, numbers),
    }


def _proof_entry(
    question: Question, at: tuple[int, int], meets: bool, direction: np.ndarray, point: np.ndarray
) -> dict[str, Any]:
    """Return {"x": ..}, {"X": ..} or {"l": ..}: the direction as it is where it proves the answer, else in
    exact numbers.
    """
    M, D = question.exact(at)
    whole = question.name == "contains_set"
    if meets and whole:
        return {"X": _matrix(M, D, point)}
    if not meets:
        l = [Fraction(v) for v in direction.tolist()]
        along = lambda W: linalg.matmul([l], W)[0] if W and W[0] else ()
        d, *spread = along(D) or (Fraction(0),)
        if d + sum(map(abs, spread)) > sum(map(abs, along(M))):
            return {"l": l}
        if whole:
            raise NotImplementedError(BY_FACETS)
    x, exact_l = exactly(question, at)
    assert (x is not None) == meets
    return {"x": x} if meets else {"l": exact_l}


def _matrix(M: list[list[Fraction]], D: list[list[Fraction]], near: np.ndarray) -> list[list[Fraction]]:
    """Return X with M X = D exactly, near a given one: its rows with most room are solved for."""
    order = np.argsort(abs(near).sum(1), kind="stable").tolist()
    _, pivots = linalg.row_reduce([[row[j] for j in order] for row in M])
    basis = [order[j] for j in pivots]
    X = [[Fraction(v) for v in row] for row in near.tolist()]
    if len(basis) == len(M):
        now = linalg.matmul(M, X)
        short = [[a - b for a, b in zip(*rows, strict=True)] for rows in zip(D, now, strict=True)]
        moves = linalg.matmul(linalg.inverse([[row[j] for j in basis] for row in M]), short)
        for j, move in zip(basis, moves, strict=True):
            X[j] = [a + b for a, b in zip(X[j], move, strict=True)]
    if len(basis) < len(M) or any(sum(map(abs, row)) > 1 for row in X):
        raise NotImplementedError(BY_FACETS)
    return X
