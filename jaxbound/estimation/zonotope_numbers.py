"""What a set observer computes with: a model in floats, and how its state follows from a few samples
alone.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.free_inputs import Free
from jaxbound.estimation.zonotope_steps import Numbers, Start
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix
from jaxbound.exact.price import refuse_or_say
from jaxbound.models.intervals import IntervalSystem
from jaxbound.models.unknown_directions import Directions
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.zonotopes.reduction import reduce_order
from jaxbound.sets.zonotopes.zonotope import Zonotope

__all__ = [
    "ROUNDED",
    "first_set",
    "free_numbers",
    "least_horizon",
    "left_inverse",
    "middle",
    "numbers",
    "price",
    "start",
]

ROUNDED = 1 + 1e-9
"""Above what rounding does to a few thousand sums and products of numbers >= 0 in float64."""


def middle(x: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return (middle, how far the ends may be from it) in float64."""
    lo, hi = np.asarray(x.lo, np.float64), np.asarray(x.hi, np.float64)
    mid = 0.5 * lo + 0.5 * hi
    return mid, np.where(lo == hi, 0, np.nextafter(np.maximum(hi - mid, mid - lo), np.inf))


def numbers(model: Any, system: IntervalSystem, dtype: np.dtype, free: Free | None = None) -> Numbers:
    """Return the Numbers of a model, whose IntervalSystem is given, in floats of a dtype. free: see
    `free_numbers`.
    """
    both = {}
    for name in "ABCD":
        both[name], both["wide_" + name] = _narrowed(*middle(getattr(system, name)), dtype)
    if getattr(model, "g", 0):
        spread = [(hi - lo) / 2 for lo, hi in model.disturbance]
        columns, off = _floats([[a * x for a, x in zip(row, spread, strict=True)] for row in model.G], dtype)
        centre = [
            [
                sum(
                    (a * (hi + lo) / 2 for a, (lo, hi) in zip(row, model.disturbance, strict=True)),
                    Fraction(0),
                )
            ]
            for row in model.G
        ]
        w, off_w = _floats(centre, dtype)
        w, wide_w = w[:, 0], rounding.round_up((off.sum(1) + off_w[:, 0]) * ROUNDED, dtype)
    else:
        w, half = _narrowed(*middle(system.w), dtype)
        columns, wide_w = np.diag(half)[:, half > 0], np.zeros_like(w)
    u0, wide_u0 = _narrowed(*middle(system.offset["u"]), dtype)
    tolerance, noise = (rounding.round_up(x, dtype) for x in (system.tolerance, system.noise))
    y0 = middle(system.offset["y"])[0].astype(dtype)  # rounded once: `sensor.true_value` counts it
    return Numbers(
        **both,
        W=columns,
        w=w,
        wide_w=wide_w,
        u0=u0,
        wide_u0=wide_u0,
        tolerance=tolerance,
        noise=noise,
        y0=y0,
        free=free,
    )


def free_numbers(directions: Directions | None, model: Any, first: bool, dtype: np.dtype) -> Free | None:
    """Return what kernels know of unknown inputs. first: whether the bounds of a first state speak of all
    that moves it.
    """
    if directions is None:
        return None
    M, H = (
        [_floats(x, dtype) for x in some] for some in zip(*((w.M, w.H) for w in directions.ways), strict=True)
    )
    (near_M, off_M), (near_H, off_H) = (
        map(lambda parts: np.stack(parts, -1), zip(*x, strict=True)) for x in (M, H)
    )
    wide_M, wide_H = (rounding.round_up(x, dtype) for x in (off_M, off_H))
    used = np.array([[i in w.outputs for w in directions.ways] for i in range(model.p)])
    shown = np.array([any(row) for row in linalg.matmul(model.C, linalg.transpose(directions.rows))])
    return Free(
        near_M,
        wide_M,
        near_H,
        wide_H,
        used,
        np.array(directions.before),
        np.array(directions.after),
        shown,
        np.array(first),
    )


def first_set(x0: Any, n: int, order: float, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (centre (n,), generators (n, q), box (n,)) in a dtype, at most so many generators a state, of
    what holds the first state.
    """
    if isinstance(x0, Zonotope):
        c, G = np.asarray(x0.center, np.float64), np.asarray(x0.generators, np.float64)
    else:
        x0 = interval(x0)
        bounded = np.isfinite(x0.lo) & np.isfinite(x0.hi)
        c, r = (
            np.where(bounded, part, np.inf)
            for part in middle(jax.tree.map(lambda end: np.where(bounded, end, 0), x0))
        )
        G = np.diag(r) if r.ndim == 1 else r
    if c.shape != (n,):
        raise ValueError(f"x0 needs one interval for each of {n} states: its shape is {c.shape}")
    if not (np.isfinite(c).all() and np.isfinite(G).all()):
        raise ValueError("x0 must be bounded: give each state an interval, it need not be narrow; or no x0")
    near = c.astype(dtype), G.astype(dtype)
    off = np.abs(c - near[0]) + np.abs(G - near[1]).sum(1)
    fewer = reduce_order(Zonotope(*map(jnp.asarray, near)), order)
    return np.asarray(fewer.center), np.asarray(fewer.generators), rounding.round_up(off * ROUNDED, dtype)


def price(n: int, p: int, horizon: int | None) -> None:
    """Refuse the `start` of an observer that would take too long, or say how long it takes. horizon: None:
    the least that can do.

    Raises:
        ValueError: more than ten minutes, by what 8 to 32 states took on one core: right within a factor of
            two or so.
    """
    steps = -(-n // max(p, 1)) if horizon is None else horizon + 1
    seconds = 2.5e-6 * n * steps * p * (steps * p + n) * (1 + (steps * n / 10.0) ** 1.2)
    refuse_or_say(
        seconds,
        f"the equations of how {n} states follow from {steps} samples",
        "reduce the model first, or measure more of its states",
    )


def least_horizon(model: Any, system: IntervalSystem, directions: Directions | None = None) -> int | None:
    """Return the smallest h with which h + 1 samples show all states, at the middle of the model; None if
    none does.

    directions: of unknown inputs; the states are then those that are ever shown. What A has forgotten by then
    need not be.
    """
    (A, _), (C, _), M, _, places = _middle_parts(model, system, directions)
    A = A if directions is None else linalg.matmul(M, A)
    wanted, newest, found = system.n - len(places), C, 0
    rows: list = []
    for h in range(system.n + 1):
        rows += _without(newest, places)
        before, found = found, linalg.rank(rows)
        if found == wanted or (directions is not None and _forgotten(model, A, rows, h, places)):
            return h
        if found == before and directions is None:
            return None
        newest = linalg.matmul(newest, A)
    return None


def _forgotten(model, A, rows, h, places):
    """Say whether rows show all of x_0 that A^h makes anything of; only asked of a certain A."""
    if any(u.A is not None for u in model.uncertainties):
        return False
    power: Matrix = _identity(len(A))
    for _ in range(h):
        power = linalg.matmul(power, A)
    return linalg.rank([*rows, *_without(power, places)]) == linalg.rank(rows)


def _middle_parts(model, system, directions):
    """Return ((A, away), (C, away), M, H, places): exact matrices, floats that those of the plant are within,
    and see `Way`.
    """
    n = system.n
    if directions is None:
        parts = [middle(getattr(system, name)) for name in "AC"]
        return *((_exact(mid), away) for mid, away in parts), _identity(n), _zeros(n, system.p), ()
    spread = [
        [sum((abs(x) for x in some), Fraction(0)) for some in zip(*rows, strict=True)]
        for rows in zip(
            *([u.on("A") for u in model.uncertainties if u.A is not None] or [_zeros(n, n)]), strict=True
        )
    ]
    way = directions.ways[0]
    return (
        (model.A, rounding.round_up(np.array(spread, object))),
        (model.C, np.zeros((system.p, n))),
        way.M,
        way.H,
        directions.places,
    )


def _without(rows, places):
    """Return rows without some columns."""
    return [tuple(x for j, x in enumerate(row) if j not in places) for row in rows]


def start(
    model: Any, system: IntervalSystem, h: int, dtype: np.dtype, directions: Directions | None = None
) -> Start | None:
    """Return how the newest state follows from h + 1 samples alone; None if they do not show it, or
    parameters are too uncertain.

    With all of these samples one above the other, x the first state and q = B v + w of all steps,

        m = O x + T q + D v + delta,    newest state = A^h x + S q.

    K0 is a left inverse of O, K = A^h K0, both exact for the middle of the model, so that there

        newest state = K (m - D v - delta) + R q,    R = S - K T.

    Within the bounds of the model A^j is off by at most W_j, W_(j+1) = (|A| + wide) W_j + wide |A^j|, which
    bounds what O, T, S are off by; that acts on |x| <= (I - |K0| wide_O)^-1 |K0| (|m| + s + |D v| + |T q|),
    and on q.

    With unknown inputs all of this is said of the plant x+ = M (A x + B v + w) + H (m - D v - delta of the
    next sample), see `models.unknown_directions`: M A takes the place of A, and q holds samples, too.
    """
    n, p = system.n, system.p
    (A, ra), (C, rc), M, H, places = _middle_parts(model, system, directions)
    (B, rb), (D, rd) = (middle(getattr(system, name)) for name in "BD")
    float64 = numbers(model, system, np.dtype(np.float64))
    size = lambda rows, *shape: np.abs(np.array([[float(x) for x in row] for row in rows])).reshape(shape)
    most_M, most_H = size(M, n, n) * ROUNDED, size(H, n, p) * ROUNDED
    if directions is not None:
        A, ra = linalg.matmul(M, A), most_M @ ra * ROUNDED
    powers = [_identity(n)]
    for _ in range(h):
        powers.append(linalg.matmul(A, powers[-1]))
    seen = [linalg.matmul(C, P) for P in powers]
    O = tuple(row for rows in seen for row in rows)
    thin = _without(O, places)
    if linalg.rank(thin) < n - len(places):
        if directions is None or not _forgotten(model, A, thin, h, places):
            return None
        there = [j for j in range(n) if j not in places]
        kept = {there[i] for i in linalg.row_reduce(thin)[1]}
        places = tuple(j for j in range(n) if j not in kept)
    K0 = left_inverse(O, np.tile(system.noise, h + 1), places)
    K = linalg.matmul(powers[h], K0)
    K_first = size(K, n, (h + 1) * p)
    # R_j, how what happens at step j of h acts: A^(h-1-j) less what the samples behind it say of it, which is
    # R_(j+1) A - K_(j+1) C
    parts = [[row[i * p : (i + 1) * p] for row in K] for i in range(h + 1)]
    R: list = []
    for j in reversed(range(h)):
        R.insert(0, _less(linalg.matmul(R[0], A) if R else powers[0], linalg.matmul(parts[j + 1], C)))
    if directions is not None:  # samples are steps, too
        parts = [parts[0], *(_more(parts[j + 1], linalg.matmul(R[j], H)) for j in range(h))]
        K = _beside(parts, n)
    RM = R if directions is None else [linalg.matmul(x, M) for x in R]
    of_inputs = [linalg.matmul(x, _exact(B)) if B.size else [()] * n for x in RM] + [_zeros(n, system.m)]
    through = [linalg.matmul(x, _exact(D)) if D.size else [()] * n for x in parts]
    K_float, off_K = _floats(K, dtype)
    U, off_U = _floats(_beside([_less(a, b) for a, b in zip(of_inputs, through, strict=True)], n), dtype)
    W, off_W = _floats(
        _beside([linalg.matmul(x, _exact(float64.W)) if float64.W.size else [()] * n for x in RM], n), dtype
    )
    w, off_w = _floats(
        [[sum(v)] for v in zip(*(_times(x, float64.w) for x in RM), strict=True)] if R else _zeros(n, 1),
        dtype,
    )

    P, K0s, Ks = [size(x, n, n) for x in powers], size(K0, n, (h + 1) * p), size(K, n, (h + 1) * p)
    most, Bs, Ds = size(A, n, n) + ra, most_M @ (np.abs(B) + rb), np.abs(D) + rd
    middle_C = size(C, p, n)
    Cs = middle_C + rc
    away = [np.zeros((n, n))]
    for j in range(h):
        away.append(most @ away[j] + ra @ P[j])
    rows_off = [Cs @ x + rc @ y for x, y in zip(away, P, strict=True)]
    rows = [middle_C @ y + x for x, y in zip(rows_off, P, strict=True)]
    staircase = lambda blocks: np.block(
        [[blocks[i - 1 - j] if i > j else np.zeros((p, n)) for j in range(h)] for i in range(h + 1)]
    )
    T, T_off = (staircase(x) if h else np.zeros((p, 0)) for x in (rows, rows_off))
    O_off = np.concatenate(rows_off)
    bound = _inverse_above(K0s @ O_off * ROUNDED)
    if bound is None:
        return None
    S_off = np.concatenate([away[h - 1 - j] for j in range(h)], 1) if h else np.zeros((n, 0))
    each = lambda M, last: np.concatenate([np.kron(np.eye(h), M), np.zeros((h * len(M), last))], 1)
    B_all, rb_all, D_all, rd_all = (
        each(Bs, system.m),
        each(rb, system.m),
        np.kron(np.eye(h + 1), Ds),
        np.kron(np.eye(h + 1), rd),
    )
    H_all = np.concatenate([np.zeros((h * n, p)), np.kron(np.eye(h), most_H)], 1)
    pushed = np.tile(most_M @ (np.abs(float64.w) + np.abs(float64.W).sum(1) + float64.wide_w), h)
    RM_size = size(_beside(RM, n), n, h * n)
    on_x, on_q = away[h] + K_first @ O_off, S_off + K_first @ T_off
    of_x = on_x @ bound @ K0s
    of_q = on_q + of_x @ T
    wide_U = of_q @ (B_all + H_all @ D_all) + RM_size @ rb_all + Ks @ rd_all + of_x @ D_all
    wide = of_q @ pushed + RM_size @ np.tile(float64.wide_w, h)
    up = lambda x: rounding.round_up(x * ROUNDED, dtype)
    return Start(
        K_float,
        U,
        w[:, 0],
        W,
        up(of_x + of_q @ H_all + off_K),
        up(wide_U + off_U),
        up(wide + off_w[:, 0] + off_W.sum(1)),
    )


def left_inverse(O: Matrix, noise: np.ndarray, places: Sequence[int] = ()) -> Matrix:
    """Return K0 with K0 O x = x exactly, of least squares weighted by the noise of the rows, for x with 0 at
    some places.

    One elimination of (O, I) gives L with L O = I and N with N O = 0. Then K0 = L - L V N' (N V N')^-1 N, V =
    diag(1 / weights), which is (O' V^-1 O)^-1 O' V^-1, whose elimination would have twice the digits.
    """
    least = noise.max() * 1e-6
    weight = [
        Fraction(float(x))
        for x in (1 / np.maximum(noise / noise.max(), 1e-6) ** 2 if least else np.ones(len(noise)))
    ]
    thin, columns = _without(O, places), len(O[0]) - len(places)
    reduced, _ = linalg.row_reduce([(*row, *unit) for row, unit in zip(thin, _identity(len(O)), strict=True)])
    L, N = ([row[columns:] for row in some] for some in (reduced[:columns], reduced[columns:]))
    K0: Sequence[Sequence[Fraction]] = L
    if N:
        least_squares = linalg.transpose(
            [[x / v for x, v in zip(row, weight, strict=True)] for row in N]
        )  # V N'
        across = linalg.matmul(
            linalg.matmul(L, least_squares), linalg.inverse(linalg.matmul(N, least_squares))
        )
        K0 = _less(L, linalg.matmul(across, N))
    found = iter(map(tuple, K0))
    return tuple((Fraction(0),) * len(O) if j in places else next(found) for j in range(len(O[0])))


def _inverse_above(X):
    """Return a matrix M >= (I - X)^-1, entry by entry, for X >= 0; None if it is not proved to exist.

    If (I - X) M >= I for some M >= 0 then I - X has a non-negative inverse (its off-diagonal is <= 0), which
    M is not below.
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
    off = [
        [abs(x - Fraction(float(y))) for x, y in zip(row, numbers, strict=True)]
        for row, numbers in zip(rows, near, strict=True)
    ]
    return near, rounding.round_up(np.array([*off, None], object)[:-1].tolist()) if width else np.zeros(
        near.shape
    )


def _exact(a):
    return tuple(tuple(Fraction(float(x)) for x in row) for row in a)


def _identity(n):
    return tuple(tuple(Fraction(i == j) for j in range(n)) for i in range(n))


def _zeros(n, m):
    return [(Fraction(0),) * m] * n


def _less(a, b):
    """Return a matrix less another."""
    return [[x - y for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def _more(a, b):
    """Return a matrix plus another."""
    return [[x + y for x, y in zip(*rows, strict=True)] for rows in zip(a, b, strict=True)]


def _beside(blocks, n):
    """Return matrices of n rows side by side."""
    return [[x for block in blocks for x in block[i]] for i in range(n)]


def _times(rows, v):
    """Return a matrix times floats, exactly."""
    return [sum((a * Fraction(float(x)) for a, x in zip(row, v, strict=True)), Fraction(0)) for row in rows]
