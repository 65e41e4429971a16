"""Parallelotopes {x : lo <= D x <= hi} that hold what sets of states do, rounded outward, recordings on the
last axis.
"""

import numpy as np

from jaxbound.estimation.ordered import added, mapped
from jaxbound.estimation.window_proof import Prior
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

__all__ = ["OFF", "ROUNDED", "lasting", "parallelotope", "principal", "strip", "template"]

SLOW = 0.1
"""Share of a mode that is left, above which a strip bounds it."""
ROUNDED, OFF = 1 + 1e-9, 1e-12
"""Above what rounding does to the sums of a few hundred numbers >= 0 in float64; share of magnitudes above
what it does to any.
"""


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
        length = np.linalg.norm(row)
        if (
            len(A) > 1
            and 0 < length < np.inf
            and all(abs(row @ other) < (1 - 1e-6) * length for other in rows)
        ):
            rows.append(row / length)
    return np.reshape(rows, (-1, len(A)))


def template(D: np.ndarray, c: np.ndarray, G: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi), each (r, N), of D x over the sets c (k, n, N), G (k, n, q, N), r (k, n, N), all of
    which hold x, rounded outward.
    """
    c, G, r = (x.astype(np.float64) for x in (c, G, r))
    mid, size = mapped(D, c, 1), np.abs(D)
    reach = added(np.abs(mapped(D, G, 1)), 2) + mapped(size, r, 1)
    size = mapped(size, np.abs(c) + added(np.abs(G), 2) + r, 1)
    reach = (reach + OFF * size) * ROUNDED + 2.0**-500
    return (mid - reach).max(0), (mid + reach).min(0)


def strip(lo: np.ndarray, hi: np.ndarray, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Return (mid, rad) in a dtype that hold lo .. hi; an infinite radius where this is not bounded."""
    with np.errstate(invalid="ignore"):
        mid, rad = (lo + hi) / 2, np.maximum(hi - lo, 0) / 2
        bounded = np.isfinite(mid) & np.isfinite(rad)
        near = np.where(bounded, mid, 0).astype(dtype)
        rad = (rad + OFF * np.abs(mid) + np.abs(near - mid)) * ROUNDED + 2.0**-100
    return near, rounding.round_up(np.where(bounded, rad, np.inf), dtype)


def parallelotope(
    D: np.ndarray,
    back: np.ndarray,
    lo: np.ndarray,
    hi: np.ndarray,
    reach: np.ndarray,
    strips: tuple[np.ndarray, np.ndarray],
    dtype: np.dtype,
) -> Prior:
    """Return the Prior that holds every x with lo <= D x <= hi and |x| <= reach, and strips: x = back (D x) +
    (I - back D) x.
    """
    mid, rad = (lo + hi) / 2, np.maximum(hi - lo, 0) / 2
    rad = (rad + OFF * np.abs(mid)) * ROUNDED
    c, S = mapped(back, mid), back[:, :, None] * rad[None]
    rest = np.abs(np.eye(len(D)) - back @ D) + OFF * np.abs(back) @ np.abs(D)
    most = np.where(np.isfinite(reach), reach.astype(np.float64), 1e300)
    off = mapped(rest, most) + mapped(OFF * np.abs(back), np.abs(mid) + rad)
    with np.errstate(over="ignore"):
        near = Prior(c.astype(dtype), S.astype(dtype), off, *strips)
    off = off + np.abs(c - near.c) + added(np.abs(S - near.S), 1)
    off = np.where(off < 2.0**100, off * ROUNDED + 2.0**-100, np.inf)
    return near._replace(r=rounding.round_up(off, dtype))


def principal(x: Numbers, steps: int, blocks: int, dtype: np.dtype) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (D, back), (n, n) each, back about the inverse of D, after 0, 1, .. blocks: principal directions
    of a Kalman filter.

    Any would do; these are rounded as they come. x: the model, in float64; steps: samples of a block.
    """
    size = max(float(np.max(x.noise, initial=0)), float(np.abs(x.W).max(initial=0)), 1e-6)
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
            K = _gain(shown @ x.C.T + np.diag(R), shown)
            P = P - K @ x.C @ P
            P = np.asarray(x.A @ (P + P.T) @ x.A.T / 2 + Q)
    return out


def _gain(S: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return (S^-1 X)'; where outputs without an error show the same, that of least norm."""
    try:
        gain = np.linalg.solve(S, X)
    except np.linalg.LinAlgError:
        gain = np.linalg.pinv(S, hermitian=True) @ X
    return np.asarray(gain.T)
