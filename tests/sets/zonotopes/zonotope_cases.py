"""What the tests of zonotopes share."""

import check_certificate
import numpy as np
import pytest
from corners import DTYPES
from scipy.optimize import linprog
from scipy.spatial import HalfspaceIntersection

from jaxbound import sets
from jaxbound.sets import zonotope as factory

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])


def build(case):
    return factory(np.array(case.get("c", np.zeros(len(case["G"]))), float), np.array(case["G"], float))


def padded(case, n, q, thick=0.0):
    """Return the set of a case in n coordinates and of q generators: new coordinates are within `thick` of 0,
    new generators are 0.
    """
    G = np.array(case["G"], float)
    c, out = np.zeros(n), np.zeros((n, q))
    c[: len(G)] = case.get("c", 0)
    out[: len(G), : G.shape[1]] = G
    out[range(len(G), n), range(q - n + len(G), q)] = thick
    return factory(c, out)


def margin(Z, point):
    return float(sets.membership(Z, np.array([point], float))[0])


def polytope(Z):
    """Return the vertices of a solid zonotope from its strips, by an independent halfspace intersection."""
    normals, widths = sets.strips(Z)
    center = np.asarray(Z.center)
    sides = [np.r_[s * n, -s * n @ center - w] for n, w in zip(normals, widths, strict=True) for s in (1, -1)]
    return HalfspaceIntersection(np.array(sides), center).intersections


def widths_along(Z, normals):
    """Return how far Z reaches along each normal: sum |normal . g|."""
    return abs(normals @ np.asarray(Z.generators)).sum(1)


def degenerate(rng, n, q):
    """Draw small integer generators: general, with zero and parallel columns, dependent, and flat ones."""
    G = rng.integers(-4, 5, (n, q))
    kind = rng.integers(0, 5)
    if kind == 1:
        G[:, rng.integers(0, q)] = 0
    if kind == 2 and q > 1:
        G[:, 0] = rng.choice([-2, 1, 3]) * G[:, 1]
    if kind == 3 and n > 1:
        G[-1] = G[:-1].sum(0) - 2 * G[0]  # flat
    if kind == 4:
        G = np.outer(rng.integers(-2, 3, n), rng.integers(-2, 3, q))  # a segment
    return G


def program(G, p):
    """Return the gauge by linear programming: min t, G x = p, |x| <= t; inf where p is outside the plane."""
    n, q = G.shape
    inequalities = np.vstack([np.hstack([s * np.eye(q), -np.ones((q, 1))]) for s in (1, -1)])
    equations = np.hstack([G, np.zeros((n, 1))])
    found = linprog(
        np.r_[np.zeros(q), 1],
        A_ub=inequalities,
        b_ub=np.zeros(2 * q),
        A_eq=equations,
        b_eq=p,
        bounds=(None, None),
    )
    assert found.status in (0, 2), found.message
    return found.fun if found.status == 0 else np.inf


FAR = 1e-7  # what a linear program in floats can tell


def drawn(rng, n, q, kind):
    """Return generators: as they come, small integers, with repeated and zero columns, or of very different
    lengths.
    """
    if kind == "integer":
        return np.hstack([degenerate(rng, n, q - n), np.diag(rng.integers(1, 4, n))]) * 1.0
    G = rng.normal(size=(n, q))
    if kind == "repeated":
        G[:, -1] = 0
        G[:, 0] = G[:, 1] * rng.choice([1, -2, 0.5])
    return G * 10.0 ** rng.uniform(-3, 3, q) if kind == "uneven" else G


KINDS = ["general", "integer", "repeated", "uneven"]


def near(rng, count):
    """Return factors around 1, half of them within 1e-6."""
    away = np.where(
        rng.random(count) < 0.5, 10.0 ** rng.uniform(-8.5, -6, count), rng.uniform(0.01, 0.9, count)
    )
    return 1 + rng.choice([-1, 1], count) * away


def agree(decision, t, meets):
    """Return (wrong, left open) of answers, t the gauges by a linear program; where the two differ, exact
    numbers decide.
    """
    held, missed = decision.answer == meets, decision.answer == -meets
    differ = (held & (t > 1)) | (missed & (t < 1))
    wrong = [at for at in np.argwhere(differ) if abs(t[*at] - 1) > 1e-6 or not confirmed(decision, tuple(at))]
    return len(wrong), ((decision.answer == 0) & (abs(t - 1) > 1e-9)).sum()


def confirmed(decision, at):
    try:
        check_certificate.confirm(decision.certificate(at))
    except ValueError:
        return False
    return True
