"""Parallelotopes {x : lo <= D x <= hi} that hold what sets of states do, rounded outward, recordings on the
last axis.
"""

import numpy as np

from jaxbound.estimation.window import OFF, Prior, through
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

SLOW = 0.1
"""Share of a mode that is left, above which a strip bounds it."""
ROUNDED = 1 + 1e-9
"""Above what rounding does to the sums of a few hundred numbers >= 0 in float64."""


def added(X: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return the sums of X along an axis, added up in order; 0 of nothing.

    NumPy adds pairwise where an axis of one recording lies last: of a recording these are the same bits,
    whatever stands beside it.
    """
    sums: np.ndarray
    if X.shape[axis]:
        sums = np.add.accumulate(X, axis).take(-1, axis)
    else:
        sums = X.sum(axis)
    return sums


def lasting(A: np.ndarray, C: np.ndarray, steps: int) -> np.ndarray:
    """Return directions T (t, n) to bound beside a parallelotope's: slow modes, and what the outputs will
    show. None of a single state.

    Args:
        A (n, n), C (p, n): of the plant. steps: until then. A mode is slow if more than `SLOW` of it is left.
    """
    values, V = np.linalg.eig(A.T)
    slow = [
        v.real if x.imag >= 0 else v.imag for x, v in zip(values, V.T, strict=True) if abs(x) ** steps > SLOW
    ]
    rows: list[np.ndarray] = []
    for row in (*slow, *(C @ np.linalg.matrix_power(A, steps))):
        # directions that are nearly one already bounded add nothing
        length = np.linalg.norm(row)
        if (
            len(A) > 1
            and 0 < length < np.inf
            and all(abs(row @ other) < (1 - 1e-6) * length for other in rows)
        ):
            rows.append(row / length)
    return np.reshape(rows, (-1, len(A)))


def template(
    D: np.ndarray, c: np.ndarray, G: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (lo, hi), each (r, N), of D x over the sets c (k, n, N), G (k, n, q, N), r (k, n, N), all of
    which hold x, and at least |x| (n, N), rounded outward.
    """
    c, G, r = (x.astype(np.float64) for x in (c, G, r))
    most = np.abs(c) + added(np.abs(G), 2) + r
    turned = through(D, np.moveaxis(G, 2, 0))  # generator by generator
    mid, reach = through(D, c), added(np.abs(turned)) + through(np.abs(D), r)
    reach = (reach + OFF * through(np.abs(D), most)) * ROUNDED + 2.0**-500
    return (mid - reach).max(0), (mid + reach).min(0), most.min(0) * ROUNDED


def parallelotope(
    back: np.ndarray, rows: np.ndarray, lo: np.ndarray, hi: np.ndarray, most: np.ndarray, dtype: np.dtype
) -> Prior:
    """Return the Prior that holds every x with lo <= rows x <= hi and |x| <= most: x = back (D x) + (I - back
    D) x, D the first n of the rows; the others are strips.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        mid, rad = (lo + hi) / 2, np.maximum(hi - lo, 0) / 2
        # what a middle lost by rounding is put on its radius
        rad = (rad + OFF * np.abs(mid)) * ROUNDED
        n, bounded = len(back), np.isfinite(mid) & np.isfinite(rad)
        near = np.where(bounded, mid, 0).astype(dtype)[n:]
        of_strips = (rad[n:] + np.abs(near - mid[n:])) * ROUNDED + 2.0**-100
        of_strips = rounding.round_up(np.where(bounded[n:], of_strips, np.inf), dtype)
        D, mid, rad = rows[:n], mid[:n], rad[:n]
        # x = back (D x) + rest, and D x lies in a box: its sides are columns of back
        c, S = through(back, mid), back[:, :, None] * rad[None]
        rest = np.abs(np.eye(n) - back @ D) + OFF * np.abs(back) @ np.abs(D)
        off = through(rest, most) + through(OFF * np.abs(back), np.abs(mid) + rad)
        near_c, near_S = c.astype(dtype), S.astype(dtype)
        off = off + np.abs(c - near_c) + added(np.abs(S - near_S), 1)
        off = np.where(off < 2.0**100, off * ROUNDED + 2.0**-100, np.inf)
    return Prior(near_c, near_S, rounding.round_up(off, dtype), near, of_strips)


def principal(x: Numbers, steps: int, blocks: int, dtype: np.dtype) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (D, back), (n, n) each, back about the inverse of D, after 0, 1, .. blocks: principal directions
    of a Kalman filter.

    Any would do; these are rounded as they come. x: the model, in float64; steps: samples of a block.
    """
    size = max(float(np.max(x.noise, initial=0)), float(np.abs(x.W).max(initial=0)), 1e-6)
    # variances of uniform errors: a third of the squared bound
    R, Q = (x.noise + x.tolerance * size) ** 2 / 3 + (1e-9 * size) ** 2, x.W @ x.W.T / 3
    P, out = np.eye(len(x.A)) * (1e4 * size) ** 2, []
    for _ in range(blocks + 1):
        values, V = np.linalg.eigh(P)
        most = values.max()
        if most <= 0:  # samples without an error show every state
            most = (1e-9 * size) ** 2
        root = np.sqrt(np.maximum(values, 1e-14 * most))
        out.append(((V / root).T.astype(dtype).astype(np.float64), V * root))
        for _ in range(steps):
            if x.free is not None:
                M, H = np.asarray(x.free.M[..., 0]), np.asarray(x.free.H[..., 0])
                P = M @ P @ M.T + (H * R) @ H.T + np.eye(len(M)) * (1e-6 * size) ** 2
            shown = np.asarray(x.C @ P)
            # where outputs without an error show the same, the gain of least norm
            P = P - shown.T @ np.linalg.pinv(shown @ x.C.T + np.diag(R), hermitian=True) @ shown
            # made symmetric: rounding would drive it apart over thousands of steps
            P = np.asarray(x.A @ (P + P.T) @ x.A.T / 2 + Q)
    return out
