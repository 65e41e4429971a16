"""Containment of a point, or of a whole zonotope, in a zonotope or constrained zonotope.

**A zonotope in a set** {c + G x : A x = b}. With M = [G; A] and D = [c2 - c, G2; b, 0], it is enough that
some X has M X = D and row sums of |X| at most 1: then c2 + G2 z = c + G x for x = X (1, z). Source:
Sadraddini, Tedrake, Linear encodings for polytope containment problems, 2019, theorem 3. X is looked for by
projections, in turn onto M X = D and onto rows of a sum of at most 1, and checked like a point
(`proof.rows_below`). The condition is sufficient, not necessary: co-NP-hard otherwise.

Not held is proved by one direction l: l'd + sum_j |l' D_j| > sum_j |l' M_j|, looked for by climbing: the
vertex of the inner set that is farthest along l, the direction that shows it to be outside most, its farthest
vertex, ..

Where both fail and the outer zonotope has few facets, these decide, in exact numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import singledispatch
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.comparisons import contains as contains_number
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.zonotopes import kernels, proof, search
from jaxbound.sets.zonotopes.constrained import AnySet, ConstrainedZonotope
from jaxbound.sets.zonotopes.decisions import Answer, Decision, contains_points, unscaled
from jaxbound.sets.zonotopes.facets import FEW, exact_strips
from jaxbound.sets.zonotopes.gauges import gauge_bounds
from jaxbound.sets.zonotopes.questions import Question, flat, numbers, traced
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = ["contains"]

STEPS = (16, 64, 256)
"""Projections between two looks at the proof."""
CLIMBS = 6


@singledispatch
def contains(
    Z: AnySet | Interval, inner: AnySet | ArrayLike
) -> Any:  # a Decision, or of an Interval an array of bool
    """Decide whether a set holds points, or a whole zonotope.

    Args:
        Z: a Zonotope or ConstrainedZonotope of n dimensions, or a batch of them with leading axes (...); an
            Interval.
        inner: points (..., N, n), any number of axes after those of the batch, or a Zonotope (with the same
            leading axes).

    Returns:
        A Decision with an answer a point, or a set. Its margin points in the answer's direction and does not
        overstate it: 1 - t, t the factor on the generators at which the point just belongs to Z; exact ones
            are worked out by `membership`. For a zonotope the
        condition for YES is sufficient, not necessary: what is neither that nor NO stays UNDECIDED unless the
            facets of Z are few.
        For an Interval: an array of bool, IEEE 1788 isMember. Inside jit and vmap: the same answer or
            UNDECIDED, without certificate.

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
    raise TypeError(
        f"an interval, a zonotope or a constrained zonotope is needed: this is {type(Z).__name__}"
    )


contains.register(Interval, contains_number)


@contains.register(Zonotope)
@contains.register(ConstrainedZonotope)
def _(Z: AnySet, inner: AnySet | ArrayLike) -> Decision:
    return (
        contains_set(Z, inner)
        if isinstance(inner, (Zonotope, ConstrainedZonotope))
        else contains_points(Z, inner)
    )


def contains_set(Z: AnySet, inner: AnySet) -> Decision:
    """Decide whether a set holds a whole zonotope: see `contains`."""
    outer, inside = numbers(Z, inner)
    if inside[3].shape[-1]:
        raise ValueError(
            "the inner set must be a zonotope: for one with constraints ask `intersects`, or enclose it first"
        )
    if outer[0].shape[-1] != inside[0].shape[-1]:
        raise ValueError(
            f"two sets must have one dimension: they have {outer[0].shape[-1]} and {inside[0].shape[-1]}"
        )
    batch = outer[0].shape[:-1]
    if inside[0].shape[:-1] != batch:
        raise ValueError(
            f"a batch needs as many inner as outer sets: leading axes are {batch} and {inside[0].shape[:-1]}"
        )
    refuse_unverified()
    question = Question("contains_set", (flat(outer, batch), flat(inside, batch)), None)
    answer, margin, direction, point = (_traced if traced(question) else _decided)(question)
    lay = lambda v: v.reshape((*batch, *v.shape[1:]))
    return Decision(
        lay(answer), lay(margin), None if traced(question) else question, lay(direction), lay(point)
    )


def _equations(question: Question) -> tuple[Any, Any]:
    """Return M (S, m, q) and D (S, m, 1 + p)."""
    (c, G, A, b), (c2, G2, _, _) = question.sets
    xp = proof.library(c)
    with np.errstate(over="ignore", invalid="ignore"):
        top = xp.concatenate([(c2 - c)[..., None], G2], 2)
    return xp.concatenate([G, A], 1), xp.concatenate(
        [top, xp.pad(b[..., None], ((0, 0), (0, 0), (0, G2.shape[2])))], 1
    )


def _decided(question: Question) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (answer (S,), margin (S,), direction (S, m), X (S, q, 1 + p)) on the host."""
    (M, D), finite = _equations(question), question.known()[:, 0]
    (S, _, q), image = M.shape, proof.image(np.where(np.isfinite(M), M, 0))
    D = image.scaled(np.where(finite[:, None, None], D, 0).swapaxes(1, 2)).swapaxes(1, 2)
    direction, least = _climb(image, D)
    X, most = np.full((S, q, D.shape[2]), np.nan), np.full(S, np.inf)
    rest = np.nonzero(~(least > 1))[0]
    X[rest], most[rest] = _encode(image.of(rest), D[rest])
    held, not_held = (most <= 1) & finite, (least > 1) & finite
    answer = np.where(not_held, Answer.NO, np.where(held, Answer.YES, Answer.UNDECIDED)).astype(np.int8)
    margin = np.where(not_held, 1 - least, np.where(held, 1 - most, 0.0))
    direction = np.where(not_held[:, None], unscaled(direction[:, None], image.powers)[:, 0], 0)
    (c, G, A, _), _ = question.sets
    if not A.shape[1] and math.comb(q, c.shape[1] - 1) <= FEW:
        for i in np.nonzero((answer == 0) & finite)[
            0
        ]:  # X stays: exact numbers may still make a certificate of it
            answer[i], margin[i], direction[i] = _by_facets(*(tuple(v[i] for v in x) for x in question.sets))
    return answer, margin, direction, X


def _encode(image: proof.Image[np.ndarray], D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (X, t): M X = D nearly, and t (S,) at least the largest row sum of |X| of a true solution near
    it.
    """
    with np.errstate(all="ignore"):
        best = image.R @ D
        Z, least, rest = best.copy(), proof.rows_below(image, D, best), np.arange(len(D))
        for steps in STEPS:
            rest = rest[
                ~(least[rest] <= 1) & np.isfinite(D[rest]).all((1, 2)) & np.isfinite(image.loss[rest])
            ]
            if not len(rest):
                break
            some = image.of(rest)
            X, Z[rest] = search.project_rows(some.M, some.R, D[rest], Z[rest], steps)
            X = X + some.R @ (D[rest] - some.M @ X)
            most = proof.rows_below(some, D[rest], X)
            better = most < least[rest]
            best[rest[better]], least[rest[better]] = X[better], most[better]
    return best, least


def _climb(image: proof.Image[np.ndarray], D: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (l (S, m), t): the directions found along which the inner sets reach farthest in terms of the
    outer, t at most that factor.
    """
    S, m, _ = D.shape
    l = kernels.starts(image.R)
    best, least, rest = np.zeros((S, m)), np.zeros(S), np.nonzero(np.isfinite(D).all((1, 2)))[0]
    for _ in range(CLIMBS):
        if not len(rest):
            break
        some, d = image.of(rest), D[rest]
        l[rest], far = kernels.farthest(d, l[rest])
        l[rest] = proof.unit(gauge_bounds(some, far, tight=True).l)
        lower = proof.reach_above(some, d, l[rest])
        at, lower = lower.argmax(1), lower.max(1)
        better = lower > least[rest] * (1 + 2.0**-20)
        rest, at, lower = rest[better], at[better], lower[better]
        best[rest], least[rest] = l[rest, at], lower
        rest = rest[~(lower > 1)]
    return best, least


def _traced(question: Question) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Decide as `_decided` does, inside jit."""
    (M, D), known = _equations(question), question.known()[:, 0]
    direction, X, least, most = kernels.contained(M, D)
    held, not_held = (most <= 1) & known, (least > 1) & known
    answer = jnp.where(not_held, int(Answer.NO), jnp.where(held, int(Answer.YES), 0)).astype(jnp.int8)
    return answer, jnp.where(not_held, 1 - least, jnp.where(held, 1 - most, 0)), direction, X


def _by_facets(outer: Sequence[np.ndarray], inner: Sequence[np.ndarray]) -> tuple[Answer, float, np.ndarray]:
    """Return (answer, margin, direction) by all facets of the outer zonotope, in exact numbers."""
    (c, G, _, _), (c2, G2, _, _) = outer, inner
    exact = lambda v: [Fraction(x) for x in v.tolist()]
    shift = [a - b for a, b in zip(exact(c2), exact(c), strict=True)]
    columns = [exact(g) for g in G2.T]
    dot = lambda v, w: sum((a * b for a, b in zip(v, w, strict=True)), Fraction(0))
    worst, direction = Fraction(0), np.zeros(len(c))
    for normal, width in exact_strips(Zonotope(cast(jax.Array, c), cast(jax.Array, G))):
        reach = abs(dot(normal, shift)) + sum((abs(dot(normal, g)) for g in columns), Fraction(0))
        sign = -1 if dot(normal, shift) < 0 else 1
        if reach > width and not width:
            return Answer.NO, -np.inf, np.array([float(sign * v) for v in normal])
        if width and reach / width > worst:
            worst, direction = reach / width, np.array([float(sign * v) for v in normal])
    return (Answer.YES if worst <= 1 else Answer.NO), float(1 - worst), direction
