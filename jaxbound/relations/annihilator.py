"""Polynomial matrices Omega(v) with Omega(v) E(v) = 0 for every v: the unknown state is eliminated whatever
the parameters are.

Omega is searched order by order. Of one order r, its coefficients are the unknowns of homogeneous equations,
one for each monomial gamma of the product and each column of E,

    sum over alpha of Omega_[gamma - alpha] E_[alpha] = 0,      gamma = alpha + beta, |beta| <= r
    (9)-(10)

whose null space is exact and sparse. Multiples v^beta g of what a lower order has found are no new relations
and are removed. The search stops when the relations found have full rank at the middle, at vertices and at
random points of the box: neither the size of a null space nor its rank at a random point would do (three
relations of full generic rank may be two at the nominal model).

Source: Ploix, Adrot 2006, section 3.
"""

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import comb, lcm
from typing import TypeAlias

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.sparse import null_space, pivot_columns
from jaxbound.relations.polynomial import Exponents, PolynomialMatrix, Terms, graded, monomials
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.probe import refuse_other_modes
from jaxbound.text.progress import Progress, in_part, reporter

Relation: TypeAlias = dict[tuple[Exponents, int], Fraction]
"""{(exponents, column): coefficient}."""
Kept: TypeAlias = tuple[int, Relation, Relation]
"""A relation that was found: its order, itself in all variables and in those that are used."""
Points: TypeAlias = list[tuple[Fraction, ...]]

LARGEST = 30_000
"""Unknowns of one null space beyond which the search gives up."""
LONGEST = 600
"""Monomials up to which a box that leaves a rank open is bisected."""


@dataclass(frozen=True)
class Step:
    """One order of the search: unknowns and equations, dimension of the null space, new relations in it; the
    others are multiples of relations of lower orders.
    """

    order: int
    unknowns: int
    equations: int
    kernel: int
    new: int


def annihilator(
    E: PolynomialMatrix, progress: Progress | None = None
) -> tuple[PolynomialMatrix, tuple[Step, ...], str]:
    """Return (Omega, steps, complete): relations that span the left null space of E(v) at every v of [-1,
    1]^q.

    Args:
        E: a PolynomialMatrix. progress: called with the share done of all orders that may have to be looked
            at.

    Returns:
        Omega: a PolynomialMatrix (count, E.rows), few relations of low order first. steps: a Step for each
            order. complete: "proved"
        if their rank is full over the whole box, "sampled" if that holds at all points tried, "partial" if
        the search gave up.

    Source: Ploix, Adrot 2006, (8)-(10).
    """
    target = E.rows - generic_rank(E)
    if target == 0:
        return PolynomialMatrix(0, E.rows, E.variables, {}), (), "proved"
    points = _points(E.variables)
    relations: list[Kept] = []
    steps: list[Step] = []
    variables = [i for i in range(E.variables) if any(a[i] for a in E.terms)]
    small = _in_used_variables(E, variables)
    # relations of at most this order, the minors of E, span it everywhere
    highest = max(1, E.columns * E.order)
    work = _work_of_orders(len(variables), E.rows, highest)
    report, done = reporter(progress, "relations"), 0.0
    for order in range(highest + 1):
        betas = monomials(len(variables), order)
        # order 0 is looked at whatever it costs: relations with constant numbers are the best
        if len(betas) * E.rows > LARGEST and order:
            return _matrix(relations, E), tuple(steps), "partial"
        part = work[order] / sum(work)
        fresh, step = _one_order(small, betas, order, relations, partial(in_part, report, done, part))
        done += part
        steps.append(step)
        for g in fresh:
            relations.append((order, _in_all_variables(g, variables, E.variables), g))
        # floats first: whether these few span everywhere is proved only of those that seem to
        if fresh and len(relations) >= target and _spans(_matrix(relations, E), points, target)[0]:
            chosen = _matrix(_fewest(relations, E, points, target), E)
            proof, where = rank_over_box(chosen, target)
            if proof != "drops" or where is None:
                complete = "proved" if proof == "proved" else "sampled"
                return chosen, tuple(steps), complete
            # the point where the rank drops joins those that a choice has to pass: the search goes on
            points.append(where)
    return _matrix(relations, E), tuple(steps), "partial"


def _work_of_orders(variables: int, rows: int, highest: int) -> list[float]:
    """Return the work on each order that may have to be looked at, in no unit: nearly as its unknowns."""
    work = []
    for order in range(highest + 1):
        unknowns = rows * comb(variables + order, order)
        if unknowns > LARGEST and order:
            break
        work.append(unknowns**1.2)
    return work


def _in_used_variables(E: PolynomialMatrix, used: list[int]) -> PolynomialMatrix:
    """Return E over the variables that it depends on."""
    terms = {}
    for exponents, entries in E.terms.items():
        terms[tuple(exponents[i] for i in used)] = entries
    return PolynomialMatrix(E.rows, E.columns, len(used), terms)


def _in_all_variables(relation: Relation, used: list[int], count: int) -> Relation:
    """Return a relation in the variables `used` as one in all of them."""
    found = {}
    for (beta, j), x in relation.items():
        exponents = [0] * count
        for i, e in zip(used, beta, strict=True):
            exponents[i] = e
        found[tuple(exponents), j] = x
    return found


def constraints(E: PolynomialMatrix, order: int) -> tuple[list[dict[int, int]], int]:
    """Return (equations, size): what the coefficients of a relation of one order must satisfy, in whole
    numbers, and how many these are.

    Unknown b * E.rows + j is the coefficient of monomial b (`monomials`) at row j of E; an equation of zeros
    counts, but is not returned.

    Source: Ploix, Adrot 2006, (9)-(10).
    """
    # one scale for all: equations in whole numbers, which are reduced without fractions
    scale = lcm(*(x.denominator for entries in E.terms.values() for x in entries.values()))
    whole = [(a, [(k, int(x * scale)) for k, x in entries.items()]) for a, entries in E.terms.items()]
    equations: dict[tuple[Exponents, int], dict[int, int]] = {}
    for b, beta in enumerate(monomials(E.variables, order)):
        for alpha, entries in whole:
            gamma = tuple(map(int.__add__, alpha, beta))
            for (j, c), x in entries:
                row = equations.setdefault((gamma, c), {})
                row[b * E.rows + j] = row.get(b * E.rows + j, 0) + x
    return list(equations.values()), len({gamma for gamma, _ in equations}) * E.columns


def _one_order(
    E: PolynomialMatrix, betas: list[Exponents], order: int, kept: list[Kept], progress: Progress
) -> tuple[list[Relation], Step]:
    """Return the relations {(beta, column): x} of one order that are no multiples of those kept, and the
    Step.
    """
    equations, size = constraints(E, order)
    kernel = null_space(equations, len(betas) * E.rows, progress)
    leads = {min(row): i for i, row in enumerate(kernel)}  # coordinates of a solution: its values there
    number = {beta: b for b, beta in enumerate(betas)}
    last = len(kernel) - 1
    multiples = []
    for low, _, g in kept:
        for beta in betas:
            # monomials come by their order: all that follow are too high
            if sum(beta) > order - low:
                break
            multiple = {}
            for (b, j), x in g.items():
                k = number[tuple(map(int.__add__, beta, b))] * E.rows + j
                if k in leads:
                    multiple[last - leads[k]] = x
            multiples.append(multiple)
    # the last coordinate of a multiple: the others come first
    spanned = {last - c for c in pivot_columns(multiples)}
    fresh = [row for i, row in enumerate(kernel) if i not in spanned]
    found = []
    for row in fresh:
        found.append({(betas[k // E.rows], k % E.rows): x for k, x in row.items()})
    return found, Step(order, len(betas) * E.rows, size, len(kernel), len(fresh))


def _matrix(kept: Sequence[Kept], E: PolynomialMatrix) -> PolynomialMatrix:
    """Return relations as a matrix, each divided by its largest coefficient at v = 0 (or anywhere), the first
    one positive.
    """
    terms: Terms = {}
    for i, (_, g, _) in enumerate(kept):
        nominal = [abs(x) for (beta, _), x in g.items() if not any(beta)]
        divisor = max(nominal or map(abs, g.values()))
        first = min(g, key=_place)
        if g[first] < 0:
            divisor = -divisor
        for (beta, j), x in g.items():
            terms.setdefault(beta, {})[i, j] = x / divisor
    ordered = {beta: terms[beta] for beta in sorted(terms, key=graded)}
    return PolynomialMatrix(len(kept), E.rows, E.variables, ordered)


def _place(coefficient: tuple[Exponents, int]) -> tuple[int, Exponents, int]:
    """Return the key by which coefficients (monomial, column) are sorted."""
    beta, column = coefficient
    return *graded(beta), column


def _fewest(kept: list[Kept], E: PolynomialMatrix, points: Points, target: int) -> list[Kept]:
    """Return as few relations as are well conditioned at all points; of these, where a choice is left, the
    lowest orders.
    """
    if len(kept) <= target:
        return kept
    most = _spans(_matrix(kept, E), points, target)[1]
    for count in range(target, len(kept)):
        choices = itertools.islice(itertools.combinations(kept, count), 2000)
        for some in sorted(choices, key=_total_order)[:50]:
            spans, smallest = _spans(_matrix(some, E), points, target)
            if spans and smallest > most / 2:
                return list(some)
    return kept


def _total_order(some: Sequence[Kept]) -> int:
    """Return the sum of the orders of relations."""
    return sum(order for order, _, _ in some)


def _spans(P: PolynomialMatrix, points: Points, target: int) -> tuple[bool, float]:
    """Return whether the rank of P is at least the target at all points, and the smallest singular value that
    makes it so.
    """
    powers = np.array(list(P.terms), float).reshape(len(P.terms), P.variables)
    values = np.array([P.coefficient(a) for a in P.terms], float)
    at = np.einsum("pa,aij->pij", np.prod(np.array(points, float)[:, None, :] ** powers, -1), values)
    singular = np.linalg.svd(at, compute_uv=False)
    largest, deciding = singular[:, 0], singular[:, target - 1]
    smallest = deciding.min()
    # what floats doubt is asked in fractions
    for v, plain in zip(points, deciding > 1e-7 * largest, strict=True):
        if not plain and linalg.rank(P.at(v)) < target:
            return False, smallest
    return True, smallest


def generic_rank(E: PolynomialMatrix) -> int:
    """Return the rank of E at almost every v: its largest rank at a few random points."""
    if not E.columns or not E.rows:
        return 0
    draw = random.Random(7)
    # a random point misses the largest rank only on a set without volume; two make sure
    return max(linalg.rank(E.at(_random_point(draw, E.variables))) for _ in range(2))


def _random_point(draw: random.Random, q: int) -> tuple[Fraction, ...]:
    """Return a point of [-1, 1]^q, as Fractions."""
    return tuple(Fraction(draw.randrange(-999, 1000), 1000) for _ in range(q))


def _points(q: int) -> Points:
    """Return the middle, up to 64 vertices and 8 random points of [-1, 1]^q, as Fractions."""
    draw = random.Random(11)
    points = [(Fraction(0),) * q]
    if q <= 6:
        for signs in itertools.product((-1, 1), repeat=q):
            points.append(tuple(map(Fraction, signs)))
    else:
        for _ in range(64):
            points.append(tuple(Fraction(draw.choice((-1, 1))) for _ in range(q)))
    for _ in range(8):
        points.append(_random_point(draw, q))
    return points


def rank_over_box(P: PolynomialMatrix, rank: int) -> tuple[str, tuple[Fraction, ...] | None]:
    """Decide whether P(v) has at least a given rank for every v in [-1, 1]^q, and return ("proved" | "drops"
    | "open", where).

    On a box v = c + r w, L P R = I + sum over alpha of N_alpha w^alpha, with fixed matrices L and R from the
    singular vectors at its centre. Where the |N_alpha| add up to less than 1 in every row, I + N is regular
    and the rank at least that large; else the box is bisected. Done in floats: each N_alpha is a sum of
    products L T P R, T the binomial matrix that moves the monomials to the box, and `rounding.product_error`,
    with one more product for each further factor, bounds what rounding does to it.

    Returns:
        "drops" with a point where the exact rank is smaller; "open" with a point close to what up to 1000
        boxes did not settle.
    """
    if rank == 0:
        return "proved", None
    refuse_other_modes()
    points = _points(P.variables)
    if not _spans(P, points, rank)[0]:
        return "drops", next(v for v in points if linalg.rank(P.at(v)) < rank)
    alphas = _divisors(P)
    values = np.array([P.coefficient(a) for a in alphas], float)
    powers = np.array(alphas, int).reshape(len(alphas), P.variables)
    gamma, _ = rounding.product_error(len(alphas) + P.rows + P.columns + 4 * P.order + 8, np.float64)
    most = min(1000, 30_000 // len(alphas))
    queue, boxes = [(np.zeros(P.variables), np.ones(P.variables))], 0
    while queue:
        centre, radius = queue.pop()
        boxes += 1
        here, size = values, abs(values)
        if boxes > 1:
            T = _moved(powers, centre, radius)
            here, size = np.einsum("ka,aij->kij", T, values), np.einsum("ka,aij->kij", abs(T), size)
        left, singular, right = np.linalg.svd(here[0], full_matrices=False)
        exactly = tuple(map(Fraction, centre.tolist()))
        # L would divide by it: the centre itself is asked, exactly
        if singular[rank - 1] <= 1e-9 * singular[0]:
            drops = linalg.rank(P.at(exactly)) < rank
            return "drops" if drops else "open", exactly
        L, R = left.T[:rank] / singular[:rank, None], right[:rank].T
        N = L @ here @ R
        # what is left of the identity at the centre is rounding, and counts in the bound
        N[0] -= np.eye(rank)
        bound = abs(N) + gamma * (abs(L) @ size @ abs(R) + 1)
        # |w| <= 1: each row of N adds up to less than 1, so I + N is regular all over the box
        if bound.sum((0, 2)).max() < 1 - gamma:
            continue
        # the box is cut where its variable moves N most
        influence = np.array([bound[powers[:, k] > 0].sum() for k in range(P.variables)])
        if boxes >= most or len(alphas) > LONGEST or not influence.size or not influence.max() > 0:
            return "open", exactly
        half = radius * np.where(np.arange(P.variables) == influence.argmax(), 0.5, 1)
        queue += [(centre + s * (radius - half), half) for s in (-1, 1)]
    return "proved", None


def _divisors(P: PolynomialMatrix) -> list[Exponents]:
    """Return all monomials that divide one of P, by their order."""
    found = set()
    for exponents in P.terms:
        found |= set(itertools.product(*(range(e + 1) for e in exponents)))
    return sorted(found, key=lambda a: (sum(a), a))


def _moved(powers: np.ndarray, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return T (K, K) with (centre + radius w)^alpha = sum over low of T[low, alpha] w^low, for all exponents
    `powers` (K, q).
    """
    top = powers.max(initial=0) + 1
    binomial = np.array([[comb(e, k) for e in range(top)] for k in range(top)], float)  # 0 where k > e
    rest = np.maximum(powers[None] - powers[:, None], 0)
    moved: np.ndarray = np.prod(binomial[powers[:, None], powers[None]] * centre**rest, -1)
    moved *= np.prod(radius**powers, -1)[:, None]
    return moved
