"""The exact Chebyshev problem: by which factor must boxes grow until a point of a subspace lies in them?
Rationals, no rounding.

    t = min over z of max_i |b_i - E_i z| / r_i                 (primal: z)
      = max over h with h E = 0 of |h b| / sum_i |h_i| r_i      (dual: h, a circuit)

**Method** (single exchange; Source: Stiefel 1959, the dual simplex method on references of N + 1 rows, N the
rank of E). N independent rows S and one more row q determine a circuit h, its ratio t and a point z whose
errors on these rows are t times their radii. The row that z misses most enters, the one whose multiplier
first falls to zero leaves. Exchanges in floats say which rows the last reference is likely to have; fractions
begin there, usually to find that z keeps every row. What floats got wrong costs steps, never truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from operator import mul
from typing import NamedTuple

import numpy as np

from jaxbound.exact import linalg

SPREAD = 1e12
"""The largest radius over the smallest one that floats are told of."""
PATIENCE = 20
"""Exchanges for each row of a reference after which floats have lost their way; they take 2 to 4."""
TOLD = 1e-12
"""Share of the largest singular value up to which a direction counts as none."""


@dataclass(frozen=True)
class Optimum:
    """Fields: t, a Fraction; h (m,), coprime integers as Fractions with h E = 0 and |h b| = t sum |h_i| r_i,
    zeros where no circuit exists; z (N,) with |b_i - E_i z| <= t r_i for all i.
    """

    t: Fraction
    h: linalg.Vector
    z: linalg.Vector


def chebyshev(
    E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction], enough: Fraction | None = None
) -> Optimum:
    """Solve min over z of max |b_i - E_i z| / r_i exactly.

    A reference has one circuit h (h E = 0), t = |h b| / sum |h_i| r_i, and a z at which every error b_i - E_i
    z of the reference is t r_i with the sign of h_i. If no other error is larger, primal and dual are equal:
    that is the optimum. Else the worst row enters and one leaves, so that t grows.

    Args:
        E (m, N): rows of Fractions, of any rank. b, r (m,): Fractions, r > 0. enough: a factor above which t
            need not be the least: then it is a lower bound, with its h, and z is empty.

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
    likely, signs = _likely(E, b, r)
    reduced, pivots = linalg.row_reduce(_columns([E[i] for i in likely]))
    basis, last = [likely[j] for j in pivots], None
    shares: list[Fraction] = []  # E_last = shares E_basis
    for j in range(len(likely)):
        if j not in pivots:
            last, shares = likely[j], [row[j] for row in reduced]
            break
    steps = 0
    while True:
        t, h = Fraction(0), [Fraction(0)] * len(b)
        if last is not None:
            h[last] = Fraction(1)
            for i, x in zip(basis, shares, strict=True):
                h[i] = -x
            t = linalg.dot(h, b) / linalg.dot(map(abs, h), r)
            if t < 0:
                t, h = -t, [-x for x in h]
        if enough is not None and t > enough:
            return Optimum(t, linalg.primitive(h), ())
        for i, x in enumerate(h):
            if x:
                signs[i] = _sign(x)
        z = [Fraction(0)] * len(E[0])
        # E z = b - t (signs r) on the rows S
        for row, j in zip(*linalg.row_reduce([(*E[i], b[i], signs[i] * r[i]) for i in basis]), strict=True):
            z[j] = row[-2] - t * row[-1]
        missed = _missed(E, b, r, t, z)
        if not missed:
            if not any(h):
                h = _some_circuit(E, basis)
            return Optimum(t, linalg.primitive(h), tuple(z))
        steps += 1
        worst = min(missed)  # by number: cannot cycle
        if steps < PATIENCE * len(E[0]):
            worst = max(missed, key=lambda i: abs(missed[i]))  # noqa: B023
        signs[worst] = _sign(missed[worst])
        enters = _shares(E, basis, worst)
        if enters is None:
            basis.append(worst)
            shares.append(Fraction(0))
            continue
        place = _leaving(basis, [signs[worst] * signs[i] * x for i, x in zip(basis, enters, strict=True)], h)
        if last is None or place is None:
            last, shares = worst, enters
            continue
        basis[place] = worst
        shares = _shares(E, basis, last) or []  # a basis again, and its rank is that of the one before


def _missed(
    E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction], t: Fraction, z: Sequence[Fraction]
) -> dict[int, Fraction]:
    """Return {i: (b_i - E_i z) / r_i} of the rows where that is more than t, in whole numbers."""
    point, below = linalg.integers(z)
    missed = {}
    for i, (row, middle, radius) in enumerate(zip(E, b, r, strict=True)):
        numbers, over = linalg.integers(row)
        over *= below
        gap = middle.numerator * over - middle.denominator * sum(map(mul, numbers, point))
        gap, over = gap * radius.denominator, over * middle.denominator * radius.numerator
        if abs(gap) * t.denominator > t.numerator * over:
            missed[i] = Fraction(gap, over)
    return missed


def _some_circuit(E: linalg.Rows, basis: Sequence[int]) -> list[Fraction]:
    """Return some circuit, zeros where there is none. basis: independent rows."""
    own, h = list(basis), [Fraction(0)] * len(E)
    for i in range(len(E)):
        if i in own:
            continue
        shares = _shares(E, own, i)
        if shares is None:
            own.append(i)
            continue
        h[i] = Fraction(1)
        for j, x in zip(own, shares, strict=True):
            h[j] = -x
        break
    return h


def _shares(E: linalg.Rows, basis: Sequence[int], i: int) -> list[Fraction] | None:
    """Return row i as a sum of independent rows; None: it is none."""
    reduced, pivots = linalg.row_reduce(_columns([E[j] for j in (*basis, i)]))
    if len(basis) in pivots:
        return None
    return [row[-1] for row in reduced]


def _columns(E: linalg.Rows) -> linalg.Rows:
    """Return the columns of rows, times one number."""
    return linalg.transpose(linalg.over_one(E)[0])


def _leaving(basis: Sequence[int], speeds: Sequence[Fraction], h: Sequence[Fraction]) -> int | None:
    """Return the place in S of the row whose multiplier first falls to zero as that of the worst row grows;
    None: none does, and it takes the place of q.
    """
    falling: dict[int, tuple[bool, Fraction | bool, int]] = {}
    for place, (i, speed) in enumerate(zip(basis, speeds, strict=True)):
        if speed > 0:
            at_once = not h[i]
            falling[place] = at_once, at_once or speed / abs(h[i]), -i
    return max(falling, key=lambda place: falling[place], default=None)


def _sign(x: Fraction) -> int:
    """Return 1 or -1; of 0, -1."""
    if x > 0:
        return 1
    return -1


def _likely(E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction]) -> tuple[Sequence[int], list[int]]:
    """Return (rows that determine the optimum in floats, all where floats say nothing; the signs of the
    errors of all rows).
    """
    found = _float_optimum(E, b, r)
    if found is None or not found.rows:
        return range(len(b)), [1] * len(b)
    return found.rows, np.where(found.h > 0, 1, -1).tolist()


def likely_point(E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction]) -> tuple[Fraction, ...] | None:
    """Return a point z that may keep |b_i - E_i z| <= r_i, found in floats; None: floats know none."""
    found = _float_optimum(E, b, r)
    if found is None or found.t > 1 or not np.isfinite(found.z).all():
        return None
    return tuple(map(Fraction, found.z.tolist()))


def _float_optimum(E: linalg.Rows, b: Sequence[Fraction], r: Sequence[Fraction]) -> "Nearest | None":
    """Return the optimum in floats, None where numbers overflow."""
    try:
        rows = np.array([[*linalg.floats(row), float(x)] for row, x in zip(E, b, strict=True)])
        radii = np.array(list(map(float, r)))
    except OverflowError:
        return None
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # enough to search; the exact steps know better
        rows /= np.maximum(radii, radii.max() / SPREAD)[:, None]
        return nearest(rows[:, :-1], rows[:, -1])


class Nearest(NamedTuple):
    """Fields: t: about the least max |c - F z|; h: multipliers, h F near 0 and h c near t |h|; rows that
    determine it; z.
    """

    t: float
    h: np.ndarray
    rows: list[int]
    z: np.ndarray


def nearest(F: np.ndarray, c: np.ndarray) -> Nearest | None:
    """Return about the z of the least max |c - F z|; None where numbers overflow."""
    if not (np.isfinite(F).all() and np.isfinite(c).all()):
        return None
    span, sizes, right = np.linalg.svd(F, full_matrices=False)
    kept = sizes > TOLD * sizes.max(initial=0)
    span, back = span[:, kept], right[kept].T / sizes[kept]
    gap = c - span @ (span.T @ c)
    N = span.shape[1]
    if N == len(c) or not abs(gap).max() > 0:
        return Nearest(0.0, np.zeros(len(c)), [], back @ (span.T @ c))
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
        return Nearest(0.0, off, S.tolist(), back @ (span.T @ c))
    while True:  # as in `chebyshev`, in floats
        h = np.zeros(len(c))
        h[S], h[last] = -T[last], 1
        h *= np.copysign(1, h @ gap)
        signs = np.where(h, np.sign(h), signs)
        t, steps = h @ gap / abs(h).sum(), steps - 1
        off = gap - T @ (gap[S] - signs[S] * t)
        worst = np.argmax(abs(off))
        if abs(off[worst]) <= t * (1 + TOLD) or worst in (*S, last) or not steps:
            z = back @ (span.T @ (c - off))
            return Nearest(float(abs(off).max()), h, [*S.tolist(), int(last)], z)
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
