"""What a set observer computes with: a model in floats, and how its state follows from a few samples alone."""

from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.estimation.zonotope_steps import Numbers, Start
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix
from jaxbound.models.intervals import IntervalSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval

__all__ = ["ROUNDED", "least_horizon", "middle", "numbers", "start"]

ROUNDED = 1 + 1e-9
"""Above what rounding does to a few thousand sums and products of numbers >= 0 in float64."""


def middle(x: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return (middle, how far the ends may be from it) in float64."""
    lo, hi = np.asarray(x.lo, np.float64), np.asarray(x.hi, np.float64)
    mid = 0.5 * lo + 0.5 * hi
    return mid, np.where(lo == hi, 0, np.nextafter(np.maximum(hi - mid, mid - lo), np.inf))


def numbers(model: Any, system: IntervalSystem, dtype: np.dtype) -> Numbers:
    """Return the Numbers of a model, whose IntervalSystem is given, in floats of a dtype."""
    both = {}
    for name in "ABCD":
        both[name], both["wide_" + name] = _narrowed(*middle(getattr(system, name)), dtype)
    if getattr(model, "g", 0):
        spread = [(hi - lo) / 2 for lo, hi in model.disturbance]
        columns, off = _floats([[a * x for a, x in zip(row, spread, strict=True)] for row in model.G], dtype)
        centre = [[sum((a * (hi + lo) / 2 for a, (lo, hi) in zip(row, model.disturbance, strict=True)), Fraction(0))] for row in model.G]
        w, off_w = _floats(centre, dtype)
        w, wide_w = w[:, 0], rounding.round_up((off.sum(1) + off_w[:, 0]) * ROUNDED, dtype)
    else:
        w, half = _narrowed(*middle(system.w), dtype)
        columns, wide_w = np.diag(half)[:, half > 0], np.zeros_like(w)
    u0, wide_u0 = _narrowed(*middle(system.offset["u"]), dtype)
    tolerance, noise = (rounding.round_up(x, dtype) for x in (system.tolerance, system.noise))
    y0 = middle(system.offset["y"])[0].astype(dtype)  # rounded once: `sensor.true_value` counts it
    return Numbers(**both, W=columns, w=w, wide_w=wide_w, u0=u0, wide_u0=wide_u0, tolerance=tolerance, noise=noise, y0=y0)


def least_horizon(system: IntervalSystem) -> int | None:
    """Return the smallest h with which h + 1 samples show all states, at the middle of the model; None if none does."""
    A, C = _exact(middle(system.A)[0]), _exact(middle(system.C)[0])
    rows, newest, found = [], C, 0
    for h in range(system.n):
        rows += newest
        before, found = found, linalg.rank(rows)
        if found in (system.n, before):
            return h if found == system.n else None
        newest = linalg.matmul(newest, A)
    return None


def start(model: Any, system: IntervalSystem, h: int, dtype: np.dtype) -> Start | None:
    """Return how the newest state follows from h + 1 samples alone; None if they do not show it, or parameters are too uncertain.

    With all of these samples one above the other, x the first state and q = B v + w of all steps,

        m = O x + T q + D v + delta,    newest state = A^h x + S q.

    K0 is a left inverse of O, K = A^h K0, both exact for the middle of the model, so that there

        newest state = K (m - D v - delta) + R q,    R = S - K T.

    Within the bounds of the model A^j is off by at most W_j, W_(j+1) = (|A| + wide) W_j + wide |A^j|, which bounds what O, T, S are off by;
    that acts on |x| <= (I - |K0| wide_O)^-1 |K0| (|m| + s + |D v| + |T q|), and on q.
    """
    n, p = system.n, system.p
    (A, ra), (B, rb), (C, rc), (D, rd) = (middle(getattr(system, name)) for name in "ABCD")
    float64 = numbers(model, system, np.dtype(np.float64))
    powers = [_identity(n)]
    for _ in range(h):
        powers.append(linalg.matmul(_exact(A), powers[-1]))
    seen = [linalg.matmul(_exact(C), P) for P in powers]
    O = tuple(row for rows in seen for row in rows)
    if linalg.rank(O) < n:
        return None
    K0 = _left_inverse(O, np.tile(system.noise, h + 1))
    K = linalg.matmul(powers[h], K0)
    # R_j, how what happens at step j of h acts: A^(h-1-j) less what the samples behind it say of it
    parts = [[row[i * p : (i + 1) * p] for row in K] for i in range(h + 1)]
    R = [_less(powers[h - 1 - j], *(linalg.matmul(parts[i], seen[i - 1 - j]) for i in range(j + 1, h + 1))) for j in range(h)]
    of_inputs = [linalg.matmul(x, _exact(B)) if B.size else [()] * n for x in R] + [_zeros(n, system.m)]
    through = [linalg.matmul(x, _exact(D)) if D.size else [()] * n for x in parts]
    K_float, off_K = _floats(K, dtype)
    U, off_U = _floats(_beside([_less(a, b) for a, b in zip(of_inputs, through, strict=True)], n), dtype)
    W, off_W = _floats(_beside([linalg.matmul(x, _exact(float64.W)) if float64.W.size else [()] * n for x in R], n), dtype)
    w, off_w = _floats([[sum(v)] for v in zip(*(_times(x, float64.w) for x in R), strict=True)] if R else _zeros(n, 1), dtype)

    size = lambda rows, *shape: np.abs(np.array([[float(x) for x in row] for row in rows])).reshape(shape)
    P, K0s, Ks = [size(x, n, n) for x in powers], size(K0, n, (h + 1) * p), size(K, n, (h + 1) * p)
    most, Bs, Cs, Ds = (np.abs(x) + r for x, r in ((A, ra), (B, rb), (C, rc), (D, rd)))
    away = [np.zeros((n, n))]
    for j in range(h):
        away.append(most @ away[j] + ra @ P[j])
    rows_off = [Cs @ x + rc @ y for x, y in zip(away, P, strict=True)]
    rows = [np.abs(C) @ y + x for x, y in zip(rows_off, P, strict=True)]
    staircase = lambda blocks: np.block([[blocks[i - 1 - j] if i > j else np.zeros((p, n)) for j in range(h)] for i in range(h + 1)])
    T, T_off = (staircase(x) if h else np.zeros((p, 0)) for x in (rows, rows_off))
    O_off = np.concatenate(rows_off)
    bound = _inverse_above(K0s @ O_off * ROUNDED)
    if bound is None:
        return None
    S_off = np.concatenate([away[h - 1 - j] for j in range(h)], 1) if h else np.zeros((n, 0))
    each = lambda M, last: np.concatenate([np.kron(np.eye(h), M), np.zeros((h * len(M), last))], 1)
    B_all, rb_all, D_all, rd_all = each(Bs, system.m), each(rb, system.m), np.kron(np.eye(h + 1), Ds), np.kron(np.eye(h + 1), rd)
    pushed = np.tile(np.abs(float64.w) + np.abs(float64.W).sum(1) + float64.wide_w, h)
    R_size = size(_beside(R, n), n, h * n)
    on_x, on_q = away[h] + Ks @ O_off, S_off + Ks @ T_off
    of_x = on_x @ bound @ K0s
    wide_U = on_q @ B_all + R_size @ rb_all + Ks @ rd_all + of_x @ (T @ B_all + D_all)
    wide = on_q @ pushed + R_size @ np.tile(float64.wide_w, h) + of_x @ T @ pushed
    up = lambda x: rounding.round_up(x * ROUNDED, dtype)
    return Start(K_float, U, w[:, 0], W, up(of_x + off_K), up(wide_U + off_U), up(wide + off_w[:, 0] + off_W.sum(1)))


def _left_inverse(O: Matrix, noise: np.ndarray) -> Matrix:
    """Return K0 with K0 O = I exactly, of least squares weighted by the noise of the rows."""
    least = noise.max() * 1e-6
    weight = [Fraction(float(x)) for x in (1 / np.maximum(noise / noise.max(), 1e-6) ** 2 if least else np.ones(len(noise)))]
    across = linalg.transpose([[x * v for x in row] for row, v in zip(O, weight, strict=True)])
    return linalg.matmul(linalg.inverse(linalg.matmul(across, O)), across)


def _inverse_above(X):
    """Return a matrix M >= (I - X)^-1, entry by entry, for X >= 0; None if it is not proved to exist.

    If (I - X) M >= I for some M >= 0 then I - X has a non-negative inverse (its off-diagonal is <= 0), which M is not below.
    """
    n = len(X)
    try:
        M = np.linalg.inv(np.eye(n) - X)
    except np.linalg.LinAlgError:
        return None
    M = M + 1e-6 * np.abs(M).sum(1, keepdims=True)
    rest = M - X @ M - np.eye(n)
    proved = (M >= 0).all() and (rest > 1e-9 * (M + X @ M + np.eye(n))).all()
    return M if proved else None


def _narrowed(mid, away, dtype):
    """Return (mid, away) in floats of a dtype, the second not too small."""
    nearest = mid.astype(dtype)
    away = away + np.abs(mid - nearest.astype(np.float64))
    return nearest, rounding.round_up(np.where(away > 0, np.nextafter(away, np.inf), 0), dtype)


def _floats(rows, dtype):
    """Return (floats of a dtype, at least what they are off by in float64) of exact rows."""
    width = len(rows[0]) if len(rows) else 0
    near = np.array([[float(x) for x in row] for row in rows]).reshape(len(rows), width).astype(dtype)
    off = [[abs(x - Fraction(float(y))) for x, y in zip(row, numbers, strict=True)] for row, numbers in zip(rows, near, strict=True)]
    return near, rounding.round_up(np.array([*off, None], object)[:-1].tolist()) if width else np.zeros(near.shape)


def _exact(a):
    return tuple(tuple(Fraction(float(x)) for x in row) for row in a)


def _identity(n):
    return tuple(tuple(Fraction(i == j) for j in range(n)) for i in range(n))


def _zeros(n, m):
    return [(Fraction(0),) * m] * n


def _less(first, *others):
    """Return a matrix less others."""
    return [[a - sum(rest, Fraction(0)) for a, *rest in zip(*rows, strict=True)] for rows in zip(first, *others, strict=True)]


def _beside(blocks, n):
    """Return matrices of n rows side by side."""
    return [[x for block in blocks for x in block[i]] for i in range(n)]


def _times(rows, v):
    """Return a matrix times floats, exactly."""
    return [sum((a * Fraction(float(x)) for a, x in zip(row, v, strict=True)), Fraction(0)) for row in rows]
