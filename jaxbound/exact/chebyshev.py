"""The exact Chebyshev problem: by which factor must boxes grow until a point of a subspace lies in them?
Rationals, no rounding.

    t = min over z of max_i |b_i - E_i z| / r_i                 (primal: z)
      = max over h with h E = 0 of |h b| / sum_i |h_i| r_i      (dual: h, a circuit)

**Method** (single exchange; Source: Stiefel 1959, the dual simplex method on references of N + 1 rows, N the
rank of E). N independent rows S and one more row q determine a circuit h, its ratio t and a point z whose
errors on these rows are t times their radii. The row that z misses most enters, the one whose multiplier
first falls to zero leaves. The search runs in floats; exact integers then go on from where it stopped,
usually for a single step, and accept an optimum only if z keeps every row. What floats got wrong costs steps,
never truth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm
from operator import mul
from typing import TypeAlias

import numpy as np

from jaxbound.exact import linalg

__all__ = ["Optimum", "Subspace", "chebyshev", "exchanged", "subspace"]

Reference: TypeAlias = tuple[tuple[int, int], ...]
"""Rows, each with the sign of its error."""
Rows: TypeAlias = Sequence[Sequence[Fraction]]
Integers: TypeAlias = Sequence[int]
System: TypeAlias = Sequence[Integers]
"""Rows of integers."""

PRIME = 2**61 - 1
"""Ranks are guessed modulo this prime; what rests on a guess is checked exactly."""


@dataclass(frozen=True)
class Optimum:
    """Fields: t, a Fraction; h (m,), coprime integers as Fractions with h E = 0 and |h b| = t sum |h_i| r_i,
    zeros where no circuit exists; z (N,) with |b_i - E_i z| <= t r_i for all i; reference: the rows that
    determine both and the signs of their errors, a start for a similar problem.
    """

    t: Fraction
    h: linalg.Vector
    z: linalg.Vector
    reference: Reference


@dataclass(frozen=True, eq=False)
class Subspace:
    """E prepared once for many problems. Build it with `subspace`.

    Fields: rows: E as integers, a row each multiplied by its entry of `scales`; columns, independent: of a
    regular minor of largest size.
    """

    rows: tuple[tuple[int, ...], ...]
    scales: tuple[int, ...]
    columns: list[int]
    independent: list[int]


def subspace(E: Rows) -> Subspace:
    """Return the Subspace of rows E (m, N) of Fractions."""
    rows, scales = zip(*map(linalg.integers, E), strict=True)
    return Subspace(rows, scales, *_independent(rows))


def chebyshev(
    E: Rows | Subspace, b: Sequence[Fraction], r: Sequence[Fraction], start: Reference | None = None
) -> Optimum:
    """Solve min over z of max |b_i - E_i z| / r_i exactly.

    Args:
        E (m, N): rows of Fractions, of any rank, or their `subspace`. b, r (m,): Fractions, r > 0. start: the
            reference of a similar problem.

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
    space = E
    if not isinstance(space, Subspace):
        space = subspace(space)
    common = lcm(*(x.denominator for x in (*b, *r)))
    right, radii = _whole(b, common, space.scales), _whole(r, common, space.scales)
    while True:
        kept = [[row[j] for j in space.columns] for row in space.rows]
        reference = _search(kept, right, radii, common, space.independent, start)
        t, h, z, reference = _settle(kept, right, radii, reference, space.independent)
        if _annihilates(h, space):
            break
        # the prime divided a minor: an exact rank, which takes longer, is never wrong
        columns = list(linalg.row_reduce(space.rows)[1])
        independent = list(linalg.row_reduce(linalg.transpose(space.rows))[1])
        space, start = Subspace(space.rows, space.scales, columns, independent), None
    out = [Fraction(0)] * len(space.rows[0])
    for j, x in zip(space.columns, z, strict=True):
        out[j] = x / common
    circuit = linalg.primitive(list(map(mul, h, space.scales)))
    return Optimum(t, circuit, tuple(out), reference)


def _whole(values: Sequence[Fraction], common: int, scales: Integers) -> list[int]:
    """Return numbers times a common denominator, each times the scale of its row."""
    return [x.numerator * (common // x.denominator) * f for x, f in zip(values, scales, strict=True)]


def _annihilates(h: Integers, space: Subspace) -> bool:
    """Return whether h E = 0 in the columns too that were taken for dependent ones."""
    unused = set(range(len(space.rows[0]))) - set(space.columns)
    return not any(_product(h, [row[j] for row in space.rows]) for j in unused)


def _product(a: Integers, b: Integers) -> int:
    """Return the sum of products of integers."""
    return sum(map(mul, a, b))


def _independent(rows: System) -> tuple[list[int], list[int]]:
    """Return (columns, rows) of a largest minor that is not zero modulo a prime."""
    work = [[x % PRIME for x in row] for row in rows]
    left, columns, pivots = list(range(len(work))), [], []
    for j in range(len(work[0])):
        i = next((i for i in left if work[i][j]), None)
        if i is None:
            continue
        left.remove(i)
        columns.append(j)
        pivots.append(i)
        inverse = pow(work[i][j], -1, PRIME)
        head = [(k, x * inverse % PRIME) for k, x in enumerate(work[i]) if x]
        for row in (work[a] for a in left):
            factor = row[j]
            if not factor:
                continue
            for k, x in head:
                row[k] = (row[k] - factor * x) % PRIME
    return columns, pivots


def _search(
    E: System, b: Integers, r: Integers, common: int, independent: list[int], start: Reference | None
) -> Reference:
    """Return a reference that is nearly optimal: rows S..., q, each with the sign of its error: by
    the exchange in floats.

    Source: the dual simplex method; a reference determines multipliers >= 0, and (z, t) with all its errors
    at t times their radii.
    """
    m, N = len(E), len(E[0])
    if N == m:
        return ()
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        F, c = _in_floats(E, b, r, common)
    if not np.isfinite(F).all() or not np.isfinite(c).all():
        return _plain(m, independent)
    found = exchanged(F, c, start)
    if found is None:
        return _plain(m, independent)
    return found[0]


def exchanged(F: np.ndarray, c: np.ndarray, start: Reference | None = None) -> tuple[Reference, float] | None:
    """Return (a reference that is nearly optimal, t) of rows F (m, N), orthonormal columns, and c (m,), over
    their radii; None where floats lose their way.
    """
    N = F.shape[1]
    # Many multipliers are zero where rows are sparse. A nudge, the same for all references, decides which of
    # them leaves: no cycles.
    nudge = np.append(1e-9 * np.random.default_rng(0).uniform(0.5, 1, N), 1)
    try:
        if start is None or len(start) != N + 1:
            own, signs = _spread_reference(F, c)
        else:
            own, signs = map(np.array, zip(*start, strict=True))
        for _ in range(50 + 20 * N):
            inverse = np.linalg.inv(np.column_stack([signs[:, None] * F[own], np.ones(N + 1)]))
            *z, t = inverse @ (signs * c[own])
            gap = c - F @ np.array(z)
            j = int(np.argmax(np.abs(gap)))
            if abs(gap[j]) <= t * (1 + 1e-12) + 1e-14 * np.abs(c).max():
                break
            multipliers, share = nudge @ inverse, np.append(np.sign(gap[j]) * F[j], 1) @ inverse
            ratio = np.where(share > 1e-10, share / np.maximum(multipliers, 1e-15), 0)
            leaves = int(np.argmax(ratio))
            own[leaves], signs[leaves] = j, np.sign(gap[j])
    except np.linalg.LinAlgError:
        return None
    # the row of the largest multiplier comes last: the others are independent
    last = int(np.argmax(np.abs(inverse[-1])))
    order = [*range(last), *range(last + 1, N + 1), last]
    return tuple((int(own[i]), int(signs[i])) for i in order), float(t)


def _in_floats(E: System, b: Integers, r: Integers, common: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, c): rows over their radii, with F orthonormal, and what they are to be near.

    Whatever the unit of integers is, it need not fit a float: a row is divided by its largest entry, and all
    numbers of the right by what brings the largest of them near 1.
    """
    m, N = len(E), len(E[0])
    tops = [max(map(abs, row), default=0) or 1 for row in E]
    sizes = [abs(x) // (top * common) for v in (b, r) for x, top in zip(v, tops, strict=True)]
    unit = common * max(1, *sizes)
    F = np.array([[x / top for x in row] for row, top in zip(E, tops, strict=True)]).reshape(m, N)
    c, radius = _over(b, tops, unit), _over(r, tops, unit)
    weight = 1 / np.maximum(radius, radius.max() * 1e-12)  # enough to search; the exact steps know better
    F, _ = np.linalg.qr(F * weight[:, None])
    return F, c * weight


def _over(values: Integers, tops: Integers, unit: int) -> np.ndarray:
    return np.array([x / (top * unit) for x, top in zip(values, tops, strict=True)])


def _plain(m: int, independent: list[int]) -> Reference:
    """Return a reference without any search."""
    other = next(i for i in range(m) if i not in independent)
    return tuple((i, 1) for i in (*independent, other))


def _spread_reference(F: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (rows, signs): N rows of F (m, N), each the farthest from the span of those before, and the
    worst at their z.
    """
    rest = F.copy()
    S: list[int] = []
    for _ in range(F.shape[1]):
        size = (rest**2).sum(1)
        size[S] = -1
        S.append(int(np.argmax(size)))
        axis = rest[S[-1]] / (np.linalg.norm(rest[S[-1]]) or 1)
        rest -= np.outer(rest @ axis, axis)
    inverse = np.linalg.inv(F[S])
    away = np.abs(c - F @ (inverse @ c[S]))
    away[S] = -1
    own = np.array([*S, np.argmax(away)])
    h = np.append(-F[own[-1]] @ inverse, 1)
    signs = np.where(h < 0, -1, 1)
    if h @ c[own] < 0:
        signs = -signs
    return own, signs


def _settle(
    E: System, b: Integers, r: Integers, reference: Reference, independent: list[int]
) -> tuple[Fraction, list[int], list[Fraction], Reference]:
    """Return (t, h, z, reference) of the optimum: exact exchanges on integers, from a reference on.

    A reference S, q has one circuit h (h E = 0), t = |h b| / sum |h_i| r_i, and a z at which every error
    b_i - E_i z of the reference is t r_i with the sign of h_i. If no other error is larger, primal and dual
    are equal: that is the optimum. Else the worst row enters and one leaves, so that t grows.
    """
    m = len(E)
    if not reference:  # as many rows as unknowns: everything fits
        Z, det = _regular(E, b)
        return Fraction(0), [0] * m, [Fraction(x, det) for x in Z], reference
    signs, steps = [1] * m, 0
    for i, sign in reference:
        signs[i] = sign
    *S, q = [i for i, _ in reference]
    while True:
        h = _circuit(E, b, S, q)
        if h is None:  # floats took dependent rows for independent ones
            *S, q = [i for i, _ in _plain(m, independent)]
            continue
        for i, x in h.items():
            if x:
                signs[i] = _sign(x)
        total = sum(x * b[i] for i, x in h.items())
        size = sum(abs(x) * r[i] for i, x in h.items())  # t = total / size
        Z, det = _regular([E[i] for i in S], [b[i] * size - signs[i] * total * r[i] for i in S])
        gaps = [b[i] * size * det - _product(E[i], Z) for i in range(m)]  # of z = Z / (det size)
        limit = total * abs(det)
        out = [i for i in range(m) if abs(gaps[i]) > limit * r[i]]
        if not out:
            circuit = [h.get(i, 0) for i in range(m)]
            z = [Fraction(x, det * size) for x in Z]
            return Fraction(total, size), circuit, z, tuple((i, signs[i]) for i in (*S, q))
        steps += 1
        worst = out[0]  # by number: cannot cycle
        if steps < 200:
            worst = max(out, key=lambda i: Fraction(abs(gaps[i]), r[i]))
        signs[worst] = _sign(gaps[worst] * det)
        leaves = _leaving(E, S, worst, signs, h)
        if leaves is None:
            q = worst
        else:
            S[S.index(leaves)] = worst


def _circuit(E: System, b: Integers, S: list[int], q: int) -> dict[int, int] | None:
    """Return the integers h with h E = 0 on rows S, q and h b >= 0; None where rows S are dependent, or q is
    one of them: floats may take a row twice, with either sign.
    """
    if q in S:
        return None
    solved = _solve(linalg.transpose([E[i] for i in S]), E[q])
    if solved is None:
        return None
    T, det = solved  # E_q det = T E_S
    h = {i: -x for i, x in zip(S, T, strict=True)} | {q: det}
    if sum(x * b[i] for i, x in h.items()) < 0:
        h = {i: -x for i, x in h.items()}
    return h


def _leaving(E: System, S: list[int], worst: int, signs: Integers, h: Mapping[int, int]) -> int | None:
    """Return the row of S whose multiplier first falls to zero as that of the worst row grows; None: none
    does, and it takes the place of q.
    """
    share, det = _regular(linalg.transpose([E[i] for i in S]), E[worst])
    falling = {}
    for i, x in zip(S, share, strict=True):
        speed = signs[worst] * signs[i] * x * _sign(det)
        if speed > 0:
            falling[i] = speed
    at_once = [i for i in falling if h[i] == 0]
    if at_once:
        return min(at_once)
    return max(falling, key=lambda i: (Fraction(falling[i], abs(h[i])), -i), default=None)


def _sign(x: int) -> int:
    """Return 1 or -1; of 0, -1."""
    if x > 0:
        return 1
    return -1


def _regular(M: System, right: Integers) -> tuple[Sequence[int], int]:
    """Solve a system that is known to be regular."""
    solved = _solve(M, right)
    assert solved is not None
    return solved


def _solve(M: System, right: Integers) -> tuple[Sequence[int], int] | None:
    """Return (x, det) of integers with M x = right * det, or None if M is singular.

    det is any common denominator; pivots come from the sparsest row, so that identity rows cost nothing.
    """
    left = [[*row, y] for row, y in zip(M, right, strict=True)]
    heads: list[tuple[int, list[int]]] = []
    while left:
        head = min(left, key=_crowd)
        left.remove(head)
        j = next((j for j, x in enumerate(head[:-1]) if x), None)
        if j is None:
            return None
        heads.append((j, head))
        left = [_without(row, head, j) for row in left]
    x = [Fraction(0)] * len(M)
    for j, head in reversed(heads):
        x[j] = (head[-1] - linalg.dot(head[:-1], x)) / head[j]
    return linalg.integers(x)


def _crowd(row: Integers) -> int:
    """Return how many numbers of a row, but the last, are not 0."""
    return sum(map(bool, row[:-1]))


def _without(row: list[int], head: list[int], j: int) -> list[int]:
    """Return a row without unknown j, by that of the pivot, and without a common factor."""
    f = row[j]
    if not f:
        return row
    combined = [head[j] * x - f * y for x, y in zip(row, head, strict=True)]
    common = gcd(*combined) or 1
    return [x // common for x in combined]
