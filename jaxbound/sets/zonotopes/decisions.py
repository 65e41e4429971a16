"""Yes or no, proved, for zonotopes and constrained zonotopes: does it hold a point, is it empty, do two of
them meet?

Each question asks whether some x in [-1, 1]^q has M x = d:

    p in {c + G x : A x = b}                 M = [G; A],                        d = [p - c; b]
    {c + G x : A x = b} is not empty         M = A,                             d = b
    two of them meet                         M = [G1 -G2; A1 0; 0 A2],          d = [c2 - c1; b1; b2]

and t, the least max|x_j| with M x = d, says how far it is from the other answer. The work is
`gauges.bounds`; what is left of a single question, on the boundary or in a flat set, is settled in
exact numbers (`feasibility`), of a batch it stays UNDECIDED. Inside jit and vmap the work is
`kernels.bounds`, in the dtype of the sets, and what is left stays UNDECIDED, as do all sets with an entry
below the smallest normal number, which compiled code reads as 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import singledispatch
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.comparisons import contains as contains_number
from jaxbound.sets.intervals.comparisons import subset
from jaxbound.sets.intervals.interval import Interval, interval, mid, rad
from jaxbound.sets.zonotopes import certificate, gauges, kernels, proof
from jaxbound.sets.zonotopes.constrained import AnySet, ConstrainedZonotope
from jaxbound.sets.zonotopes.facets import FEW, by_facets
from jaxbound.sets.zonotopes.questions import Question, flat, normal, numbers
from jaxbound.sets.zonotopes.zonotope import Zonotope, refuse_infinite
from jaxbound.text.objects import readable

Pair: TypeAlias = tuple[np.ndarray | jax.Array, np.ndarray | jax.Array]
EXACT = 100_000
"""How large m^2 (m + q) may be for exact numbers: a second or so."""


class Answer(IntEnum):
    """The answer to a question about sets: each is proved but UNDECIDED, which rounding did not settle.

    Example:
        >>> Answer(1)
        <Answer.YES: 1>
    """

    NO = -1
    UNDECIDED = 0
    YES = 1


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Decision:
    """Answers with proofs, one a question.

    Fields: answer (...,) int8, see `Answer`; margin (...,), a bound of how far the other answer is, with the
    sign of this one: |1 - t|, t the factor on all generators (for constrained sets, on all |x_i| <= 1) at
    which the answer changes; 0 where undecided or on the boundary. question, None inside jit and vmap;
    direction (..., m), the combination of equations that proves what misses; point (..., q), the x that
    proves what meets.

    `bool` of a single decision is its answer, and an error where there is none.
    """

    answer: np.ndarray | jax.Array
    margin: np.ndarray | jax.Array
    question: Question | None
    direction: np.ndarray | jax.Array
    point: np.ndarray | jax.Array

    @property
    def yes(self) -> np.ndarray | jax.Array:
        """Return whether yes is proved."""
        return self.answer == Answer.YES

    @property
    def no(self) -> np.ndarray | jax.Array:
        """Return whether no is proved."""
        return self.answer == Answer.NO

    def __bool__(self) -> bool:
        if self.answer.shape or not self.answer:
            raise ValueError(
                "neither yes nor no: ask .yes or .no, which are False where a decision is UNDECIDED"
            )
        return bool(self.yes)

    def certificate(self, at: int | tuple[int, ...] = ()) -> dict[str, Any]:
        """Return the proof of one answer, ready for JSON: all its numbers as exact text, to be checked by
        fractions alone.

        Args:
            at: which of the answers, an index.

        Raises:
            ValueError: it is UNDECIDED, or was taken inside jit or vmap. NotImplementedError: no short proof
                is known (a zonotope in another by all facets of that).
        """
        if self.question is None:
            raise ValueError(
                "a decision taken inside jit or vmap keeps no sets: ask again outside for a certificate"
            )
        answer = Answer(int(self.answer[at]))
        if answer == Answer.UNDECIDED:
            raise ValueError("an answer that is UNDECIDED has no certificate")
        at = tuple(np.arange(self.answer.size).reshape(self.answer.shape)[at].ravel().tolist())
        if len(at) != 1:
            raise ValueError(f"a certificate is of one answer: these are {len(at)}")
        one = lambda v: v.reshape((self.answer.size, *v.shape[self.answer.ndim :]))[at[0]]
        where = divmod(at[0], self.answer.size // len(self.question.sets[0][0]))
        return certificate.document(self.question, where, answer.name, one(self.direction), one(self.point))

    def __repr__(self) -> str:
        if is_traced(self.answer):
            return f"Decision({self.answer})"
        if not self.answer.shape:
            return f"Decision({Answer(int(self.answer)).name}, margin={float(self.margin):.6g})"
        return f"Decision({self.yes.sum()} yes, {self.no.sum()} no, {(self.answer == 0).sum()} undecided)"


@singledispatch
def contains(
    Z: AnySet | Interval, inner: AnySet | Interval | ArrayLike
) -> Any:  # a Decision, or of an Interval an array of bool
    """Decide whether a set holds points, or a whole zonotope.

    Args:
        Z: a Zonotope or ConstrainedZonotope of n dimensions, or a batch of them with leading axes (...); an
            Interval.
        inner: points (..., N, n), any number of axes after those of the batch, or a Zonotope or an Interval
            (with the same leading axes).

    Returns:
        A Decision with an answer a point, or a set. Its margin points in the answer's direction and does not
        overstate it: 1 - t, t the factor on the generators at which the point just belongs to Z; exact ones
            are worked out by `membership`. For a zonotope the
        condition for YES is sufficient, not necessary: what is neither that nor NO stays UNDECIDED unless the
            facets of Z are few.
        For an Interval: an array of bool, IEEE 1788 isMember, or subset of another one. Inside jit and vmap:
            the same answer or UNDECIDED, without certificate.

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


@contains.register(Interval)
def _(Z: Interval, inner: AnySet | Interval | ArrayLike) -> Decision | jax.Array:
    if isinstance(inner, Interval):
        return subset(inner, Z)
    if isinstance(inner, Zonotope | ConstrainedZonotope):
        return _contains_set(Z, inner)
    return contains_number(Z, inner)


@contains.register(Zonotope)
@contains.register(ConstrainedZonotope)
def _(Z: AnySet, inner: AnySet | Interval | ArrayLike) -> Decision:
    if isinstance(inner, Zonotope | ConstrainedZonotope | Interval):
        return _contains_set(Z, inner)
    return _contains_points(Z, inner)


def _contains_points(Z: AnySet, points: ArrayLike) -> Decision:
    """Decide for each point whether the set holds it; see `contains`."""
    points = points if isinstance(points, jax.Array) else np.asarray(points)
    (sets,) = numbers(Z, points=points)
    batch, n = sets[0].shape[:-1], sets[0].shape[-1]
    lead = points.shape[:-1]
    if points.ndim < 1 or points.shape[-1] != n or lead[: len(batch)] != batch:
        raise ValueError(
            f"points must have shape ({', '.join(map(str, (*batch, '...', n)))}): their shape is "
            f"{points.shape}"
        )
    if not isinstance(points, jax.core.Tracer):
        refuse_infinite(points=points)
    off: jax.Array | float = 0.0
    if not is_traced(sets):
        points = np.asarray(points, float)
    else:
        dtype = sets[0].dtype
        if isinstance(
            points, np.ndarray
        ):  # where there is only float32, numbers of float64 become their middle and radius
            box = interval(points)
            points, off = mid(box), rad(box).astype(dtype).reshape(math.prod(batch), -1, n)
            off = jnp.pad(off, ((0, 0), (0, 0), (0, sets[3].shape[-1])))
        (points,) = kernels.settled(rounding.widened(normal(points), dtype))
    question = Question("contains", (flat(sets, batch),), points.reshape(math.prod(batch), -1, n))
    return _decide(question, lead, Answer.YES, off)


def _contains_set(Z: AnySet | Interval, inner: AnySet | Interval) -> Decision:
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
    question = Question("contains_set", (flat(outer, batch), flat(inside, batch)), None)
    return _decide(question, batch, Answer.YES)


def is_empty(Z: AnySet | Interval) -> Decision:
    """Decide whether a constrained zonotope is empty.

    Args:
        Z: a ConstrainedZonotope or Zonotope, or a batch of them with leading axes (...).

    Returns:
        A Decision (...,). Its margin is t - 1, t the least bound on all |x_i| at which the set is not empty.
        Inside jit and vmap: the same answer or UNDECIDED, without certificate.

    Example:
        >>> from jaxbound.sets import constrained_zonotope
        >>> is_empty(constrained_zonotope([0.0], [[1.0, 2.0]], [[1.0, 1.0]], [3.0]))
        Decision(YES, margin=0.5)
    """
    (sets,) = numbers(Z)
    batch = sets[0].shape[:-1]
    return _decide(Question("is_empty", (flat(sets, batch),), None), batch, meets=Answer.NO)


def intersects(X: AnySet | Interval, Y: AnySet | Interval) -> Decision:
    """Decide whether two zonotopes or constrained zonotopes have a point in common.

    Args:
        X, Y: sets of one dimension, or batches of them whose leading axes broadcast.

    Returns:
        A Decision (...,). Its margin is 1 - t, t the factor on the generators of both at which they just
        touch. Inside jit and vmap: the same answer or UNDECIDED, without certificate.

    Example:
        >>> from jaxbound.sets import zonotope
        >>> bool(intersects(zonotope([0.0], [[1.0]]), zonotope([3.0], [[1.0]])))
        False
    """
    pair = numbers(X, Y)
    n, batches = [x[0].shape[-1] for x in pair], [x[0].shape[:-1] for x in pair]
    if n[0] != n[1]:
        raise ValueError(f"two sets must have one dimension: they have {n[0]} and {n[1]}")
    try:
        batch = np.broadcast_shapes(*batches)
    except ValueError:
        raise ValueError(
            f"leading axes of two sets must broadcast: they are {batches[0]} and {batches[1]}"
        ) from None
    xp = proof.library(pair[0][0])
    wide = tuple(
        tuple(xp.broadcast_to(v, (*batch, *v.shape[len(b) :])) for v in x)
        for x, b in zip(pair, batches, strict=True)
    )
    return _decide(Question("intersects", tuple(flat(x, batch) for x in wide), None), batch, meets=Answer.YES)


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Separation:
    """A hyperplane between two sets, or a common point.

    Fields: apart, the Decision, its answer YES where the hyperplane is proved and NO where a common point is;
    normal (..., n) and offset (...,): normal . x < offset < normal . y for all x of X, y of Y, NaN where not
    proved; point (..., n): a common point to rounding (the exact one is in the certificate), NaN where not
    proved.
    """

    apart: Decision
    normal: np.ndarray | jax.Array
    offset: np.ndarray | jax.Array
    point: np.ndarray | jax.Array


def separate(X: AnySet | Interval, Y: AnySet | Interval) -> Separation:
    """Find a hyperplane between two sets, or a point that they share.

    Args:
        X, Y: as for `intersects`.

    Returns:
        A Separation. If one of the sets is empty, the normal may be 0.

    Example:
        >>> from jaxbound.sets import zonotope
        >>> found = separate(zonotope([0.0], [[1.0]]), zonotope([3.0], [[1.0]]))
        >>> found.normal * 1.0 < found.offset < found.normal * 2.0
        array([ True])
    """
    (first, second), meet = numbers(X, Y), intersects(X, Y)
    # one question, two names: what separates is what proves that they do not meet
    apart = Decision(-meet.answer, -meet.margin, meet.question, meet.direction, meet.point)
    (c, G, A, b), (c2, G2, A2, b2) = first, second
    xp, n, k, q = proof.library(c), c.shape[-1], b.shape[-1], G.shape[-1]
    settled: Callable = kernels.settled if xp is jnp else lambda *x: x
    direction: Any = meet.direction  # of NumPy or of jax
    (l,) = settled(proof.in_largest_entry(direction))
    normal, of_first, of_second = l[..., :n], l[..., n : n + k], l[..., n + k :]
    with np.errstate(all="ignore"):
        top = _reach((normal, of_first), (c, -b), (G, A))
        bottom = -_reach((-normal, of_second), (c2, -b2), (G2, A2))
        top, bottom, offset = settled(top, bottom, (top + bottom) / 2)
        point = c + (G @ meet.point[..., :q, None])[..., 0]
    proved, shared = meet.no & (top < offset) & (offset < bottom), meet.yes
    return Separation(
        apart,
        xp.where(proved[..., None], normal, np.nan),
        xp.where(proved, offset, np.nan),
        xp.where(shared[..., None], point, np.nan),
    )


def _reach(l: Pair, e: Pair, W: Pair) -> np.ndarray | jax.Array:
    """Return an upper bound of l (e + W x) for every |x| <= 1, l of entries of at most 1, each in two
    parts.
    """
    xp = proof.library(e[0])
    sides, middle, rows = xp.concatenate(l, -1), xp.concatenate(e, -1), xp.concatenate(W, -2)
    (m, q), dot = rows.shape[-2:], lambda v, w: (v * w).sum(-1)
    gamma, floor = rounding.product_error(m + q + 4, rows.dtype)
    # entries of l are at most 1, so that these magnitudes hold all that is summed
    size = abs(middle) + abs(rows).sum(-1)
    error = gamma * dot(abs(sides), size) + floor * 2 * (1 + q) * (1 + size.max(-1, initial=0))
    return dot(sides, middle) + abs((sides[..., None, :] @ rows)[..., 0, :]).sum(-1) + error


def _decide(question: Question, shape: tuple[int, ...], meets: Answer, off: ArrayLike = 0.0) -> Decision:
    """Answer a question; `meets` is the answer where there is an x; its points are off by at most `off`
    beyond one rounding.
    """
    refuse_unverified()
    (M, D), known, inside_jit = question.equations(), question.known(), is_traced(question)
    whole, xp = question.name == "contains_set", proof.library(M)
    if inside_jit:
        lower, upper, l, x = kernels.contained(M, D) if whole else kernels.bounds(M, D, off)
    else:
        M, D = np.where(np.isfinite(M), M, 0), np.where(known[..., None], D, 0)
        lower, upper, l, x = gauges.contained(M, D) if whole else gauges.bounds(M, D)
    met, missed = (upper <= 1) & known, (lower > 1) & known
    room = xp.where(met, 1 - upper, xp.where(missed, 1 - lower, 0.0))
    if not inside_jit:
        _exactly(question, known & ~(met | missed), met, missed, room, l, x)
    answer = xp.where(met, int(meets), xp.where(missed, -int(meets), 0)).astype(np.int8)
    if whole:
        l, x = l[:, 0], x.swapaxes(1, 2)
    lay = lambda v: v.reshape((*shape, *v.shape[1 if whole else 2 :]))
    answer, room = (v.reshape(shape) for v in (answer, room * int(meets)))
    return Decision(answer, room, None if inside_jit else question, lay(l), lay(x))


def _exactly(
    question: Question,
    left: np.ndarray,
    met: np.ndarray,
    missed: np.ndarray,
    room: np.ndarray,
    l: np.ndarray,
    x: np.ndarray,
) -> None:
    """Decide open questions (S, N) in exact numbers: a single one, or containment in a set of few
    facets.
    """
    c, G, A, _ = question.sets[0]
    m, q = l.shape[2], x.shape[2]
    if question.name == "contains_set":
        few = not A.shape[1] and math.comb(q, c.shape[1] - 1) <= FEW
        for i in np.flatnonzero(left) if few else ():  # x stays: exact numbers may still make a certificate
            met[i], room[i], l[i] = by_facets(*(tuple(v[i] for v in part) for part in question.sets))
            missed[i] = ~met[i]
    elif left.size == 1 and left.all() and m * m * (m + q) <= EXACT:
        point, direction = certificate.exactly(question, (0, 0))
        if point is not None:
            met[:], x[0, 0] = True, [float(v) for v in point]
        if direction is not None:
            top = max(map(abs, direction))
            missed[:], l[0, 0] = True, [float(v / top) for v in direction]
