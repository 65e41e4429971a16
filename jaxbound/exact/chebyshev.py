"""The exact Chebyshev problem: by which factor must boxes grow until a point of a subspace lies in them?
Rationals, no rounding.

    t = min over z of max_i |b_i - E_i z| / r_i                 (primal: z)
      = max over h with h E = 0 of |h b| / sum_i |h_i| r_i      (dual: h, a circuit)

**Method** (single exchange; Source: Stiefel 1959, the dual simplex method on references of N + 1 rows, N the
rank of E). N independent rows S and one more row q determine a circuit h, its ratio t and a point z whose
errors on these rows are t times their radii. The row that z misses most enters, the one whose multiplier
first falls to zero leaves. The same exchanges in floats say which rows the last reference is likely
to have; exact integers begin there, usually for a single step, and accept an optimum only if z keeps every
row. What floats got wrong costs steps, never truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from operator import mul
from typing import NamedTuple

import numpy as np

from jaxbound.exact import linalg

__all__ = ["Optimum", "Reference", "chebyshev", "nearest"]

SPREAD = 1e12
"""The largest radius over the smallest one that floats are told of."""
PATIENCE = 20
"""Exchanges for each row of a reference after which floats have lost their way; they take 2 to 4."""
TOLD = 1e-12
"""Share of the largest singular value up to which a direction counts as none."""


class Reference(NamedTuple):
    """Fields: basis: rows S of E; rows: multiples of those of T, integers, with E = T' E_S; last: the row q,
    None where S is all rows; signs: of the errors of all rows, as far as they are known.
    """

    basis: list[int]
    rows: list[Sequence[int]]
    last: int | None
    signs: list[int]


@dataclass(frozen=True)
class Optimum:
    """Fields: t, a Fraction; h (m,), coprime integers as Fractions with h E = 0 and |h b| = t sum |h_i| r_i,
    zeros where no circuit exists; z (N,) with |b_i - E_i z| <= t r_i for all i; reference: what determines
    both, a start for other b and r.
    """

    t: Fraction
    h: linalg.Vector
    z: linalg.Vector
    reference: Reference


def chebyshev(
    E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction], start: Reference | None = None
) -> Optimum:
    """Solve min over z of max |b_i - E_i z| / r_i exactly.

    Args:
        E (m, N): rows of Fractions, of any rank. b, r (m,): Fractions, r > 0. start: the reference of a
            problem with the same E.

    Returns:
        An Optimum. Columns of E that depend on earlier ones get z = 0.

    Raises:
        ValueError: no row, or a radius that is not positive.

    Example:
        >>> one = Fraction(1)
        >>> best = chebyshev([[one], [one], [one]], [one * 0, one * 3, one * 1], [one, one, one])
        >>> best.t, best.z, best.h
        (Fraction(3, 2), (Fraction(3, 2),), (Fraction(1, 1), Fraction(-1, 1), Fraction(0, 1)))
    """
    if not len(b) or min(r) <= 0:
        raise ValueError("a Chebyshev problem needs at least one row, and radii > 0")
    common = lcm(*(x.denominator for x in (*b, *r)))
    middles, radii = ([int(x * common) for x in values] for values in (b, r))
    t, h, reference = _settled(middles, radii, start or _likely_reference(E, b, r))
    # E z = b - (errors) on the rows S
    system = []
    for i in reference.basis:
        system.append((*E[i], Fraction(middles[i], common) - reference.signs[i] * t * r[i]))
    z = [Fraction(0)] * len(E[0])
    for row, j in zip(*linalg.row_reduce(system), strict=True):
        z[j] = row[-1]
    return Optimum(t, linalg.primitive(h), tuple(z), reference)


def _likely_reference(E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction]) -> Reference:
    """Return the reference of the first independent rows in the order of `_likely`, and the first one that
    depends on them.
    """
    order, signs = _likely(E, b, r)
    reduced, pivots = linalg.row_reduce(linalg.transpose([E[i] for i in order]))
    basis = [order[j] for j in pivots]
    rows: list[Sequence[int]] = []
    for row in reduced:
        own = [0] * len(order)
        for i, x in zip(order, linalg.integers(row)[0], strict=True):
            own[i] = x
        rows.append(own)
    last = next((i for i in order if i not in basis), None)
    return Reference(basis, rows, last, signs)


def _likely(E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction]) -> tuple[list[int], list[int]]:
    """Return (all rows, those first that determine the optimum in floats; the signs of their errors)."""
    nothing = list(range(len(b))), [1] * len(b)
    try:
        rows = np.array([[*map(float, row), float(x)] for row, x in zip(E, b, strict=True)])
        radii = np.array(list(map(float, r)))
    except OverflowError:
        return nothing
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # enough to search; the exact steps know better
        rows /= np.maximum(radii, radii.max() / SPREAD)[:, None]
    found = nearest(rows[:, :-1], rows[:, -1])
    if found is None:
        return nothing
    _, h, reference = found
    others = np.setdiff1d(np.arange(len(b)), reference)
    return [*reference, *others.tolist()], np.where(h > 0, 1, -1).tolist()


def nearest(F: np.ndarray, c: np.ndarray) -> tuple[float, np.ndarray, list[int]] | None:
    """Return (t, h, rows): about the least max |c - F z|, and multipliers of the rows that determine it, h F
    near 0 and h c near t |h|; None where numbers overflow.
    """
    if not (np.isfinite(F).all() and np.isfinite(c).all()):
        return None
    span, sizes, _ = np.linalg.svd(F, full_matrices=False)
    span = span[:, sizes > TOLD * sizes.max(initial=0)]
    gap = c - span @ (span.T @ c)
    N = span.shape[1]
    if N == len(c) or not abs(gap).max() > 0:
        return 0.0, np.zeros(len(c)), []
    S, rest = np.zeros(N, int), span.copy()
    for k in range(N):  # rows that are far from a sum of those before
        S[k] = np.argmax((rest**2).sum(1))
        u = rest[S[k]] / np.linalg.norm(rest[S[k]])
        rest -= np.outer(rest @ u, u)
    T, signs, steps = span @ np.linalg.inv(span[S]), np.ones(len(c)), PATIENCE * (N + 1)
    off = gap - T @ gap[S]
    off[S] = 0
    last = np.argmax(abs(off))
    if not off[last]:
        return 0.0, off, S.tolist()
    while True:  # as `_settled`, in floats
        h = np.zeros(len(c))
        h[S], h[last] = -T[last], 1
        h *= np.copysign(1, h @ gap)
        signs = np.where(h, np.sign(h), signs)
        t, steps = h @ gap / abs(h).sum(), steps - 1
        off = gap - T @ (gap[S] - signs[S] * t)
        worst = np.argmax(abs(off))
        if abs(off[worst]) <= t * (1 + TOLD) or worst in (*S, last) or not steps:
            return float(abs(off).max()), h, [*S.tolist(), int(last)]
        signs[worst] = np.sign(off[worst])
        speed = signs[worst] * signs[S] * T[worst]
        until = np.full(N, np.inf)  # its multiplier is 0
        np.divide(abs(h[S]), speed, out=until, where=speed > TOLD)
        place = np.argmin(until)
        if until[place] == np.inf:
            last = worst
            continue
        S[place] = worst
        T[:, place] /= T[worst, place]
        T -= np.outer(T[:, place], np.where(np.arange(N) == place, 0, T[worst]))


def _settled(b: Sequence[int], r: Sequence[int], start: Reference) -> tuple[Fraction, list[int], Reference]:
    """Return (t, h, reference) of the optimum: exact exchanges on integers, from a reference on.

    A reference has one circuit h (h E = 0), t = |h b| / sum |h_i| r_i, and a z at which every error b_i - E_i
    z of the reference is t r_i with the sign of h_i. If no other error is larger, primal and dual are equal:
    that is the optimum. Else the worst row enters and one leaves, so that t grows.
    """
    m, steps = len(b), 0
    basis, rows, last, signs = list(start.basis), list(start.rows), start.last, list(start.signs)
    if last is None:  # as many rows as unknowns: everything fits
        return Fraction(0), [0] * m, start
    while True:
        shares = [Fraction(row[last], row[i]) for i, row in zip(basis, rows, strict=True)]
        *parts, own = linalg.integers([*shares, Fraction(1)])[0]
        h = [0] * m
        h[last] = own
        for i, x in zip(basis, parts, strict=True):
            h[i] = -x
        total, size = sum(map(mul, h, b)), sum(map(mul, map(abs, h), r))  # t = total / size
        if total < 0:
            total, h = -total, [-x for x in h]
        for i in (*basis, last):
            if h[i]:
                signs[i] = _sign(h[i])
        at = [(b[i] * size - signs[i] * total * r[i], row[i]) for i, row in zip(basis, rows, strict=True)]
        values, common = linalg.integers([Fraction(*x) for x in at])
        gaps = [x * size * common for x in b]  # of z, times size common
        for value, row in zip(values, rows, strict=True):
            gaps = [gap - value * x for gap, x in zip(gaps, row, strict=True)]
        limit = total * common
        out = [i for i in range(m) if abs(gaps[i]) > limit * r[i]]
        if not out:
            return Fraction(total, size), h, Reference(basis, rows, last, signs)
        steps += 1
        worst = out[0]  # by number: cannot cycle
        if steps < 200:
            worst = max(out, key=lambda i: Fraction(abs(gaps[i]), r[i]))
        signs[worst] = _sign(gaps[worst])
        place = _leaving(basis, rows, worst, signs, h)
        if place is None:
            last = worst
            continue
        basis[place] = worst
        for k, row in enumerate(rows):
            if k != place and row[worst]:
                rows[k] = linalg.cancel(row, rows[place], worst)


def _leaving(
    basis: Sequence[int], rows: Sequence[Sequence[int]], worst: int, signs: Sequence[int], h: Sequence[int]
) -> int | None:
    """Return the place in S of the row whose multiplier first falls to zero as that of the worst row grows;
    None: none does, and it takes the place of q.
    """
    falling: dict[int, tuple[bool, Fraction | bool, int]] = {}
    for place, (i, row) in enumerate(zip(basis, rows, strict=True)):
        speed = Fraction(signs[worst] * signs[i] * row[worst], row[i])
        if speed > 0:
            at_once = not h[i]
            falling[place] = at_once, at_once or speed / abs(h[i]), -i
    return max(falling, key=lambda place: falling[place], default=None)


def _sign(x: int) -> int:
    """Return 1 or -1; of 0, -1."""
    if x > 0:
        return 1
    return -1
