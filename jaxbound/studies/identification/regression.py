"""A nominal model by regression: y_k = sum_i A_i y_{k-i} + sum_i B_i u_{k-i} + c, first one step ahead, then
over whole windows.

One step ahead is linear least squares. It fits the noise of the sensors too, and is poor over long windows.
Therefore the squared window residual is minimised next, from there on: what is left of a window of s + 1
samples once the best first state is taken out of it. That is the quantity, with another norm, whose size the
bounds must have. Source of the elimination of the first state inside a nonlinear least squares problem:
Golub, Pereyra 1973 (variable projection); the steps are those of Levenberg and Marquardt.

Everything is in standardised signals, (value - middle) / spread, so that neither units nor working points
matter.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.sizes import power
from jaxbound.studies.identification.records import Records

__all__ = [
    "Scales",
    "CompleteWindows",
    "coefficients",
    "growth",
    "least_squares",
    "refined",
    "scales_of",
    "windows_of",
]

Array = jax.Array | np.ndarray
STEPS, SETTLED = 60, 1e-6
"""Steps of the refinement at most, and the relative gain of one after which it ends."""
LEAST, MOST = 128, 1_024
"""Windows that the refinement is compiled for and looks at: of longer recordings, this many spread evenly."""


@dataclass(frozen=True)
class Scales:
    """Middle and spread of each input (m,) and output (p,); a spread of 0 is replaced by 1."""

    u: np.ndarray
    u_spread: np.ndarray
    y: np.ndarray
    y_spread: np.ndarray


@dataclass(frozen=True)
class CompleteWindows:
    """Complete windows: u (N, s + 1, m), y (N, s + 1, p), and the number of the recording of each, (N,)."""

    u: np.ndarray
    y: np.ndarray
    recording: np.ndarray


def scales_of(recordings: Records) -> Scales:
    """Return the Scales of recordings [(u (T, m), y (T, p), starts)], missing samples left out."""
    u, y = (np.concatenate([r[j] for r in recordings]) for j in (0, 1))
    middle = lambda x: np.nan_to_num(np.array([np.nanmean(c) if (~np.isnan(c)).any() else 0.0 for c in x.T]))
    spread = lambda x: np.array([np.nanstd(c) if (~np.isnan(c)).sum() > 1 else 0.0 for c in x.T])
    positive = lambda s, m: np.where(s > 1e-12 * (1 + abs(m)), s, 1.0)
    (mu, su), (my, sy) = ((middle(x), spread(x)) for x in (u, y))
    return Scales(mu, positive(su, mu), my, positive(sy, my))


def windows_of(recordings: Records, scales: Scales, horizon: int, most: int | None = None) -> CompleteWindows:
    """Return the windows of horizon + 1 samples, standardised, that are complete and cross no seam; at most
    `most` of them, spread evenly.

    Args:
        recordings: [(u (T, m), y (T, p), starts)], starts the numbers of samples that do not follow the one
            before.
    """
    found = []
    for number, (u, y, starts) in enumerate(recordings):
        if len(y) > horizon:
            gone = np.isnan(u).any(1) | np.isnan(y).any(1)
            before = np.append(0, np.cumsum(gone))
            first = np.flatnonzero(
                (before[horizon + 1 :] == before[: -horizon - 1])
                & ~crossing(starts, horizon, horizon, len(y))
            )
            found.append(np.stack([np.full(len(first), number), first], 1))
    chosen = np.concatenate(found) if found else np.zeros((0, 2), int)
    if most is not None and len(chosen) > most:
        chosen = chosen[np.linspace(0, len(chosen) - 1, most).astype(int)]
    gather = lambda j, middle, spread: np.concatenate(
        [
            (
                recordings[number][j][chosen[chosen[:, 0] == number, 1][:, None] + np.arange(horizon + 1)]
                - middle
            )
            / spread
            for number in range(len(recordings))
        ]
    )
    return CompleteWindows(
        gather(0, scales.u, scales.u_spread), gather(1, scales.y, scales.y_spread), chosen[:, 0]
    )


def least_squares(windows: CompleteWindows, order: int, direct: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (theta, singular): coefficients ((order (p + m) + direct m + 1), p), one step ahead, and how
    well the regressors span, (., ).

    Args:
        windows: of order + 1 samples. direct: whether u_k acts on y_k.
    """
    u, y = windows.u, windows.y
    past = [y[:, order - i] for i in range(1, order + 1)] + [
        u[:, order - i] for i in range(0 if direct else 1, order + 1)
    ]
    regressors = np.concatenate([*past, np.ones((len(y), 1))], 1)
    theta, _, _, singular = np.linalg.lstsq(regressors, y[:, order], rcond=1e-9)
    return theta, singular


def coefficients(
    theta: Array, order: int, direct: bool, m: int, p: int
) -> tuple[list[Array], list[Array], Array, Array]:
    """Return (A_1.., B_1.., D, c): lists of (p, p) and (p, m), (p, m), (p,)."""
    A = [theta[i * p : (i + 1) * p].T for i in range(order)]
    rest = theta[order * p :]
    B = [rest[i * m : (i + 1) * m].T for i in range(order + direct)]
    return A, B[direct:], B[0] if direct else np.zeros((p, m)), theta[-1]


@partial(jax.jit, static_argnames=("order", "direct"))
def _residuals(theta, u, y, there, weight, order, direct):
    """Return the residual (N, (s + 1) p) of the best first state, times weight (p,).

    Windows are u (N, s + 1, m), y (N, s + 1, p).

    there (N,): 1, or 0 for a window that only fills the array up.
    """
    N, count, p = y.shape
    A, B, D, c = coefficients(theta, order, direct, u.shape[2], p)
    states = order * p
    times = lambda M, v: jnp.sum(
        M[:, :, None] * v[None], 1
    )  # small matrices and long vectors: a dot is ten times slower here
    units = lambda x: jnp.pad(
        x, ((0, 0),) * (x.ndim - 1) + ((0, states),)
    )  # columns of their own: each unit of the first state, alone
    constant = c[:, None] * units(there)[None]

    def step(x, now):  # x (order, p, N + states): x[i] waits i samples to be added
        yk, uk = now
        out = x[0] + times(D, uk)
        later = jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])
        return later + jnp.stack(
            [times(A[i], out) + times(B[i], uk) + (constant if i == 0 else 0.0) for i in range(order)]
        ), yk - out

    start = jnp.concatenate([jnp.zeros((order, p, N)), jnp.eye(states).reshape(order, p, states)], 2)
    _, left = jax.lax.scan(
        step, start, (units(jnp.transpose(y, (1, 2, 0))), units(jnp.transpose(u, (1, 2, 0))))
    )
    left = (left * weight[None, :, None]).reshape(count * p, N + states)
    e = (left[:, :N] * there[None]).T
    Q = _orthonormal(left[:, N:])
    return e - (e @ Q) @ Q.T


def _orthonormal(M):
    """Return orthonormal columns that span those of M, which are independent: a first state is what the first
    samples show of it.

    Without LAPACK, for whose sake jax imports SciPy: that takes longer than a fit.
    """

    def step(Q, now):
        i, v = now
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            v = v - Q @ (v @ Q)
        return Q.at[:, i].set(v / jnp.sqrt(jnp.sum(v * v))), None

    return jax.lax.scan(step, jnp.zeros_like(M), (jnp.arange(M.shape[1]), M.T))[0]


@partial(jax.jit, static_argnames=("order", "direct"))
def _around(theta, u, y, there, weight, order, direct):
    """Return (J'J, J'e) of the residuals e and their slopes J: what a step needs, small whatever the number
    of windows.
    """
    f = lambda theta: (_residuals(theta, u, y, there, weight, order, direct),) * 2
    J, e = jax.jacfwd(f, has_aux=True)(theta)
    J = J.reshape(e.size, theta.size)
    return J.T @ J, J.T @ e.ravel()


def refined(
    theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool, room: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (theta, spread): coefficients that minimise the window residuals, each output weighed by its own
    spread (p,).

    Args:
        theta: where to begin, from `least_squares`. windows: of s + 1 samples. room: at least so many
            windows share a compilation.
    """
    given = _filled(windows, room)
    spread = window_spread(theta, windows, order, direct, room)
    for _ in range(2):  # the spreads are those of the result before
        theta = _marquardt(theta, given, 1 / spread, order, direct)
        spread = window_spread(theta, windows, order, direct, room)
    return theta, spread


def window_spread(theta: Any, windows: Any, order: int, direct: Any, room: int = 0) -> Any:
    """Return the root mean square (p,) of the window residuals of each output, standardised, each output
    weighed alike.
    """
    e = np.asarray(_residuals(theta, *_filled(windows, room), np.ones(windows.y.shape[2]), order, direct))[
        : len(windows.y)
    ]
    spread = np.sqrt((e.reshape(windows.y.shape) ** 2).mean((0, 1)))
    return np.maximum(np.where(np.isfinite(spread), spread, 1.0), 1e-9)


def _filled(windows, room):
    """Return (u, y, there), filled up to a power of two of windows, at least `room`: few sizes, few
    compilations.
    """
    more = power(max(len(windows.y), LEAST, room)) - len(windows.y)
    fill = lambda x: jax.device_put(np.concatenate([x, np.zeros((more, *x.shape[1:]))]))
    return fill(windows.u), fill(windows.y), fill(np.ones(len(windows.y)))


def growth(theta: np.ndarray, order: int) -> float:
    """Return the largest modulus of an eigenvalue of the model."""
    p = theta.shape[1]
    companion = np.eye(order * p, k=p)
    companion[:, :p] = theta[: order * p].reshape(order, p, p).transpose(0, 2, 1).reshape(order * p, p)
    return float(np.abs(np.linalg.eigvals(companion)).max()) if np.isfinite(companion).all() else np.inf


def _marquardt(theta, windows, weight, order, direct):
    given = *windows, weight, order, direct
    cost_of = lambda theta: np.square(_residuals(theta, *given)).sum()
    cost, damping, limit = (
        cost_of(theta),
        1e-3,
        max(1.0, growth(theta, order)),
    )  # no faster growth than the data asked for one step ahead
    for _ in range(STEPS):
        H, g = map(np.asarray, _around(theta, *given))
        size = np.diag(H) + 1e-9 * np.trace(H) / len(H)
        for _ in range(12):
            trial = theta - np.linalg.solve(H + damping * np.diag(size), g).reshape(theta.shape)
            after = cost_of(trial)
            if after < cost and growth(trial, order) <= limit:  # False for NaN
                break
            damping *= 4
        else:
            return theta
        gain, theta, cost, damping = 1 - after / cost, trial, after, max(damping / 8, 1e-12)
        if gain < SETTLED:
            break
    return theta
