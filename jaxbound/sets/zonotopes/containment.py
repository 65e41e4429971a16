"""Does a zonotope or constrained zonotope hold a point, or a whole zonotope?

**A zonotope in a set** {c + G x : A x = b}. With M = [G; A] and D = [c2 - c, G2; b, 0], it is enough that some X has M X = D and row sums
of |X| at most 1: then c2 + G2 z = c + G x for x = X (1, z). Source: Sadraddini, Tedrake, Linear encodings for polytope containment
problems, 2019, theorem 3. X is looked for by projections, in turn onto M X = D and onto rows of a sum of at most 1, and checked like a
point (`proof.gauge_below`, a column at a time). The condition is sufficient, not necessary: co-NP-hard otherwise.

Not held is proved by one direction l: l'd + sum_j |l' D_j| > sum_j |l' M_j|, looked for by climbing: the vertex of the inner set that is
farthest along l, the direction that shows it to be outside most, its farthest vertex, ..

Where both fail and the outer zonotope has few facets, these decide, in exact numbers.
"""

import math
from fractions import Fraction
from functools import singledispatch

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.comparisons import contains as contains_number
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.zonotopes import proof
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope
from jaxbound.sets.zonotopes.decisions import Answer, Decision, contains_points
from jaxbound.sets.zonotopes.facets import FEW, exact_strips
from jaxbound.sets.zonotopes.gauges import gauge_bounds
from jaxbound.sets.zonotopes.questions import Question, flat, parts
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = ["contains"]

STEPS = (16, 64, 256)
"""Projections between two looks at the proof."""
STARTS, CLIMBS = 16, 6


@singledispatch
def contains(Z, inner):
    """Decide whether a set holds points, or a whole zonotope.

    Args:
        Z: a Zonotope or ConstrainedZonotope of n dimensions, or a batch of them with leading axes (...); an Interval.
        inner: points (..., N, n), any number of axes after those of the batch, or a Zonotope (with the same leading axes).

    Returns:
        A Decision with an answer a point, or a set. Its margin points in the answer's direction and does not overstate it: 1 - t, t the
        factor on the generators at which the point just belongs to Z; exact ones are worked out by `membership`. For a zonotope the
        condition for YES is sufficient, not necessary: what is neither that nor NO stays UNDECIDED unless the facets of Z are few.
        For an Interval: an array of bool, IEEE 1788 isMember.

    Raises:
        ValueError: shapes that do not fit, NaN or infinity.

    Example:
        >>> from jaxbound.sets import zonotope
        >>> Z = zonotope([0.0, 0.0], [[1.0, 1.0], [0.0, 1.0]])
        >>> contains(Z, [[0.5, 0.5], [3.0, 0.0]]).yes
        array([ True, False])
        >>> bool(contains(Z, zonotope([0.5, 0.0], [[0.5], [0.5]])))
        True
    """
    raise TypeError(f"an interval, a zonotope or a constrained zonotope is needed: this is {type(Z).__name__}")


contains.register(Interval, contains_number)


@contains.register(Zonotope)
@contains.register(ConstrainedZonotope)
def _(Z, inner):
    return contains_set(Z, inner) if isinstance(inner, (Zonotope, ConstrainedZonotope)) else contains_points(Z, inner)


def contains_set(Z, inner):
    """Decide whether a set holds a whole zonotope: see `contains`."""
    outer, inside = parts(Z), parts(inner)
    if inside[3].shape[-1]:
        raise ValueError("the inner set must be a zonotope: for one with constraints ask `intersects`, or enclose it first")
    if outer[0].shape[-1] != inside[0].shape[-1]:
        raise ValueError(f"two sets must have one dimension: they have {outer[0].shape[-1]} and {inside[0].shape[-1]}")
    batch = outer[0].shape[:-1]
    if inside[0].shape[:-1] != batch:
        raise ValueError(f"a batch needs as many inner as outer sets: leading axes are {batch} and {inside[0].shape[:-1]}")
    refuse_unverified()
    question = Question("contains_set", (flat(outer, batch), flat(inside, batch)), None)
    solid = not outer[3].shape[-1]
    each = [_one(*(tuple(v[i] for v in x) for x in question.sets), solid) for i in range(math.prod(batch))]
    answer, margin, direction, point = (np.array(v).reshape((*batch, *np.shape(v[0]))) for v in zip(*each, strict=True))
    return Decision(answer.astype(np.int8), margin, question, direction, point)


def _one(outer, inner, solid):
    """Return (answer, margin, direction (m,), X (q, 1 + p))."""
    (c, G, A, b), (c2, G2, _, _) = outer, inner
    M = np.concatenate([G, A])
    D = np.concatenate([np.c_[c2 - c, G2], np.c_[b, np.zeros((len(b), G2.shape[1]))]])
    image = proof.image(M[None])
    D = image.scaled(D.T[None])[0].T
    l, least = _climb(image, D)
    if least > 1:
        return Answer.NO, 1 - least, np.ldexp(l, image.powers[0]), np.full((G.shape[1], D.shape[1]), np.nan)
    X, most = _encode(image, D)
    if most <= 1:
        return Answer.YES, 1 - most, np.zeros(len(M)), X
    answer, margin, direction = Answer.UNDECIDED, 0.0, np.zeros(len(M))
    if solid and math.comb(G.shape[1], len(c) - 1) <= FEW:
        answer, margin, direction = _by_facets(outer, inner)
    return answer, margin, direction, X  # exact numbers may still make a certificate of it


def _encode(image, D):
    """Return (X, t): M X = D nearly, and t at least the largest row sum of |X| of a true solution near it."""
    M, R = image.M[0], image.R[0]
    best, least = R @ D, np.inf
    if not np.isfinite(image.loss[0]) or not np.isfinite(D).all():
        return best, least
    Z = R @ D
    for steps in (0, *STEPS):
        X, Z = (np.asarray(v, float) for v in _project_rows(M, R, D, Z, steps))
        X = X + R @ (D - M @ X)
        most = _row_sums(image, D, X)
        best, least = (X, most) if most < least else (best, least)
        if least <= 1:
            break
    return best, least


def _row_sums(image, D, X):
    gamma, floor = rounding.product_error(X.shape[0] + 4, float)
    size = abs(X).max(0, initial=0)
    error = gamma * (image.sums[0][:, None] * size + abs(D)) + floor * 2 * (1 + size)
    left = (abs(D - image.M[0] @ X) + error).max(0, initial=0)
    up = (1 + rounding.product_error(X.shape[1] + 4, float)[0]) * proof.UP
    return (abs(X).sum(1) + image.reach[0] * (left.sum() / (1 - image.loss[0]))).max(initial=0) * up


@jax.jit
def _project_rows(M, R, D, Z, steps):
    """Run Douglas-Rachford between M X = D and rows of |X| with sums of at most 1; return the candidate and where to go on from."""
    onto = lambda X: X + R @ (D - M @ X)

    def step(_, Z):
        Y = _row_balls(Z)
        return Z + onto(2 * Y - Z) - Y

    Z = jax.lax.fori_loop(0, steps, step, Z)
    Y = _row_balls(Z)
    near, reflected = onto(Y), onto(2 * Y - Z)
    sums = lambda X: jnp.max(jnp.sum(jnp.abs(X), 1))
    return jnp.where(sums(near) < sums(reflected), near, reflected), Z


def _row_balls(X):
    """Return the nearest rows with sums of |x| of at most 1 (Held, Wolfe, Crowder 1974)."""
    size = jnp.abs(X)
    falling = -jnp.sort(-size, 1)
    rank = jnp.arange(1, X.shape[1] + 1, dtype=X.dtype)[None]
    level = jnp.max((jnp.cumsum(falling, 1) - 1) / rank, 1, keepdims=True)
    return jnp.sign(X) * jnp.maximum(size - jnp.maximum(level, 0), 0)


def _climb(image, D):
    """Return (l, t): the direction found along which the inner set reaches farthest in terms of the outer one, t at most that factor."""
    m, p = D.shape
    if not np.isfinite(D).all():
        return np.zeros(m), 0.0
    rng = np.random.default_rng(0)  # any directions will do; the same ones each time
    l = np.concatenate([np.eye(m)[:STARTS], rng.normal(size=(STARTS, m)), image.R[0].sum(0)[None]])
    best, least = np.zeros(m), 0.0
    for _ in range(CLIMBS):
        reach = l @ D
        l = l * np.where(reach[:, :1] < 0, -1, 1)
        reach = l @ D
        far = D[:, 0] + np.where(reach[:, 1:] < 0, -1, 1) @ D[:, 1:].T
        found = gauge_bounds(image, far[None], tight=True)
        lower, at = _reached(image, D, found.l[0])
        if lower <= least * (1 + 2.0**-20):
            break
        best, least = found.l[0, at], lower
        if least > 1:
            break
        l = found.l[0]
    return best, least


def _reached(image, D, l):
    """Return (lower bound of (l'd + sum |l'D_j|) / sum |l'M_j| for the best of directions l (N, m), its number)."""
    ends = np.where((l @ D)[:, 1:] < 0, -1, 1)
    with np.errstate(all="ignore"):
        gamma, floor = rounding.product_error(D.shape[0] + D.shape[1] + image.M.shape[2] + 4, float)
        size = np.where(abs(l).max(1, initial=0) > 0, abs(l).max(1, initial=0), 1)
        l = l / size[:, None]
        ahead = (l * D[:, 0]).sum(1) + ((l @ D[:, 1:]) * ends).sum(1)
        width = abs(l @ image.M[0]).sum(1)
        slack = gamma * (abs(l) @ (image.sums[0] + abs(D).sum(1))) + floor * 2 * (3 + abs(D).max(initial=0))
        bound = np.where(ahead - width > slack, np.maximum((ahead - slack) / (width + slack) / proof.UP, 1 + 2.0**-52), 0)
        bound = np.where(bound > 1, bound, np.clip((ahead - slack) / (width + slack) / proof.UP, 0, 1))
    bound = np.where(np.isfinite(bound), bound, 0)
    return bound.max(), int(bound.argmax())


def _by_facets(outer, inner):
    """Return (answer, margin, direction) by all facets of the outer zonotope, in exact numbers."""
    (c, G, _, _), (c2, G2, _, _) = outer, inner
    exact = lambda v: [Fraction(x) for x in v.tolist()]
    shift = [a - b for a, b in zip(exact(c2), exact(c), strict=True)]
    columns = [exact(g) for g in G2.T]
    dot = lambda v, w: sum((a * b for a, b in zip(v, w, strict=True)), Fraction(0))
    worst, direction = Fraction(0), np.zeros(len(c))
    for normal, width in exact_strips(Zonotope(c, G)):
        reach = abs(dot(normal, shift)) + sum((abs(dot(normal, g)) for g in columns), Fraction(0))
        sign = -1 if dot(normal, shift) < 0 else 1
        if reach > width and not width:
            return Answer.NO, -np.inf, np.array([float(sign * v) for v in normal])
        if width and reach / width > worst:
            worst, direction = reach / width, np.array([float(sign * v) for v in normal])
    return (Answer.YES if worst <= 1 else Answer.NO), float(1 - worst), direction
