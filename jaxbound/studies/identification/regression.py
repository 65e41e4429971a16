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
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.sizes import power
from jaxbound.studies.identification.records import Record, Records

__all__ = [
    "Scales",
    "CompleteWindows",
    "all_or_nothing",
    "coefficients",
    "complete_windows",
    "growth",
    "information",
    "least_squares",
    "refined",
    "scales_of",
    "step_error",
    "window_residuals",
    "windows_of",
]

Array: TypeAlias = jax.Array | np.ndarray
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
    u, u_spread = _middle_and_spread(np.concatenate([u for u, _, _ in recordings]))
    y, y_spread = _middle_and_spread(np.concatenate([y for _, y, _ in recordings]))
    return Scales(u, u_spread, y, y_spread)


def _middle_and_spread(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean and the standard deviation of each column, missing samples left out; 1 where that is
    next to nothing.
    """
    middle, spread = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    for i, column in enumerate(x.T):
        present = int((~np.isnan(column)).sum())
        if present:
            middle[i] = np.nan_to_num(np.nanmean(column))
        if present > 1:
            spread[i] = np.nanstd(column)
    return middle, np.where(spread > 1e-12 * (1 + abs(middle)), spread, 1.0)


def windows_of(recordings: Records, scales: Scales, horizon: int, most: int | None = None) -> CompleteWindows:
    """Return the windows of horizon + 1 samples, standardised, that are complete and cross no seam; at most
    `most` of them, spread evenly.

    Args:
        recordings: [(u (T, m), y (T, p), starts)], starts the numbers of samples that do not follow the one
            before.
    """
    numbers, firsts = [np.zeros(0, int)], [np.zeros(0, int)]
    for number, (u, y, starts) in enumerate(recordings):
        first = complete_windows(u, y, starts, horizon)
        numbers.append(np.full(len(first), number))
        firsts.append(first)
    recording, begin = np.concatenate(numbers), np.concatenate(firsts)
    if most is not None and len(begin) > most:
        chosen = np.linspace(0, len(begin) - 1, most).astype(int)
        recording, begin = recording[chosen], begin[chosen]
    us, ys = [], []
    for number, (u, y, _) in enumerate(recordings):
        at = begin[recording == number][:, None] + np.arange(horizon + 1)
        us.append((u[at] - scales.u) / scales.u_spread)
        ys.append((y[at] - scales.y) / scales.y_spread)
    return CompleteWindows(np.concatenate(us), np.concatenate(ys), recording)


def complete_windows(u: np.ndarray, y: np.ndarray, starts: np.ndarray, horizon: int) -> np.ndarray:
    """Return the first samples of the windows of a recording that are complete and cross no seam."""
    if len(y) <= horizon:
        return np.zeros(0, int)
    gone = np.asarray(np.isnan(u).any(1) | np.isnan(y).any(1))
    whole = _in_windows(gone, horizon) == 0
    return np.flatnonzero(whole & ~crossing(starts, horizon, horizon, len(y)))


def all_or_nothing(record: Record, horizon: int) -> bool:
    """Return whether each window of a recording that crosses no seam is complete, or without any output."""
    u, y, starts = record
    if len(y) <= horizon:
        return True
    touched = np.asarray(np.isnan(u).any(1) | np.isnan(y).any(1))
    seen = np.asarray((~np.isnan(y)).any(1))
    lacking, looked_at = _in_windows(touched, horizon) > 0, _in_windows(seen, horizon) > 0
    return not (lacking & looked_at & ~crossing(starts, horizon, horizon, len(y))).any()


def _in_windows(chosen: np.ndarray, horizon: int) -> np.ndarray:
    """Return how many samples of each window are chosen, of (T,) bool."""
    before = np.append(0, np.cumsum(chosen))
    return np.asarray(before[horizon + 1 :] - before[: -horizon - 1])


def least_squares(windows: CompleteWindows, order: int, direct: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return (theta, singular): coefficients ((order (p + m) + direct m + 1), p), one step ahead, and how
    well the regressors span, (., ).

    Args:
        windows: of order + 1 samples. direct: whether u_k acts on y_k.
    """
    theta, _, _, singular = np.linalg.lstsq(
        _regressors(windows, order, direct), windows.y[:, order], rcond=1e-9
    )
    return theta, singular


def step_error(windows: CompleteWindows, order: int, direct: bool) -> float:
    """Return the sum of the squares that `least_squares` leaves of windows of order + 1 samples."""
    theta, _ = least_squares(windows, order, direct)
    left = windows.y[:, order] - _regressors(windows, order, direct) @ theta
    return float(np.square(left).sum())


def _regressors(windows: CompleteWindows, order: int, direct: bool) -> np.ndarray:
    """Return the regressors (N, order (p + m) + direct m + 1) of windows of order + 1 samples."""
    u, y = windows.u, windows.y
    past = [y[:, order - i] for i in range(1, order + 1)]
    past += [u[:, order - i] for i in range(not direct, order + 1)]
    return np.concatenate([*past, np.ones((len(y), 1))], 1)


def information(records: Records, scales: Scales, order: int, direct: bool) -> np.ndarray:
    """Return the mean of the products of regressors, a matrix: what a step says of the coefficients."""
    regressors = _regressors(windows_of(records, scales, order), order, direct)
    return np.asarray(regressors.T @ regressors / max(len(regressors), 1))


def coefficients(
    theta: Array, order: int, direct: bool, m: int, p: int
) -> tuple[list[Array], list[Array], Array, Array]:
    """Return (A_1.., B_1.., D, c): lists of (p, p) and (p, m), (p, m), (p,)."""
    A = [theta[i * p : (i + 1) * p].T for i in range(order)]
    rest = theta[order * p :]
    B = [rest[i * m : (i + 1) * m].T for i in range(order + direct)]
    D: Array = np.zeros((p, m))
    if direct:
        D, *B = B
    return A, B, D, theta[-1]


@partial(jax.jit, static_argnames=("order", "direct"))
def _residuals(
    theta: Array, u: Array, y: Array, there: Array, weight: Array, order: int, direct: bool
) -> jax.Array:
    """Return the residual (N, (s + 1) p) of the best first state, times weight (p,).

    Windows are u (N, s + 1, m), y (N, s + 1, p).

    there (N,): 1, or 0 for a window that only fills the array up.
    """
    N, count, p = y.shape
    A, B, D, c = coefficients(theta, order, direct, u.shape[2], p)
    states = order * p

    def units(x: Array) -> jax.Array:
        """Return x with columns of their own: each unit of the first state, alone."""
        return jnp.pad(x, ((0, 0),) * (x.ndim - 1) + ((0, states),))

    constant = c[:, None] * units(there)[None]

    def step(x: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        yk, uk = now  # x (order, p, N + states): x[i] waits i samples to be added
        out = x[0] + _times_unrolled(D, uk)
        later = jnp.concatenate([x[1:], jnp.zeros_like(x[:1])])
        added = []
        for i in range(order):
            moved = _times_unrolled(A[i], out) + _times_unrolled(B[i], uk)
            added.append(moved + (constant if i == 0 else 0.0))
        return later + jnp.stack(added), yk - out

    start = jnp.concatenate([jnp.zeros((order, p, N)), jnp.eye(states).reshape(order, p, states)], 2)
    samples = units(jnp.transpose(y, (1, 2, 0))), units(jnp.transpose(u, (1, 2, 0)))
    _, left = jax.lax.scan(step, start, samples)
    left = (left * weight[None, :, None]).reshape(count * p, N + states)
    e = (left[:, :N] * there[None]).T
    Q = _orthonormal(left[:, N:])
    return e - (e @ Q) @ Q.T


def _times_unrolled(M: Array, v: jax.Array) -> jax.Array:
    """Return M v of a small matrix and long vectors, of which a dot is ten times slower here."""
    return jnp.sum(M[:, :, None] * v[None], 1)


def _orthonormal(M: jax.Array) -> jax.Array:
    """Return orthonormal columns that span those of M, which are independent: a first state is what the first
    samples show of it.

    Without LAPACK, for whose sake jax imports SciPy: that takes longer than a fit.
    """

    def step(Q: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        i, v = now
        for _ in range(2):  # twice is enough (Kahan, Parlett)
            v = v - Q @ (v @ Q)
        return Q.at[:, i].set(v / jnp.sqrt(jnp.sum(v * v))), None

    return jax.lax.scan(step, jnp.zeros_like(M), (jnp.arange(M.shape[1]), M.T))[0]


@partial(jax.jit, static_argnames=("order", "direct"))
def _slopes(
    theta: Array, u: Array, y: Array, there: Array, weight: Array, order: int, direct: bool
) -> tuple[jax.Array, jax.Array]:
    """Return (J'J, J'e) of the residuals e and their slopes J: what a step needs, small whatever the number
    of windows.
    """

    def twice(theta: Array) -> tuple[jax.Array, jax.Array]:
        e: jax.Array = _residuals(theta, u, y, there, weight, order, direct)
        return e, e

    J, e = jax.jacfwd(twice, has_aux=True)(theta)
    J = J.reshape(e.size, theta.size)
    return J.T @ J, J.T @ e.ravel()


def refined(
    theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool, room: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (theta, spread): coefficients that minimise the window residuals, each output weighed by its own
    spread (p,).

    Outputs of a window are simulated from its best first state on, without those that were measured: an
    output error method over s + 1 samples.

    Args:
        theta: where to begin, from `least_squares`. windows: of s + 1 samples. room: at least so many
            windows share a compilation.
    """
    filled = _filled(windows, room)
    spread = window_spread(theta, windows, order, direct, room)
    for _ in range(2):  # the spreads are those of the result before
        theta = _marquardt(theta, filled, 1 / spread, order, direct)
        spread = window_spread(theta, windows, order, direct, room)
    return theta, spread


def window_spread(
    theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool, room: int = 0
) -> np.ndarray:
    """Return the root mean square (p,) of the window residuals of each output, standardised, each output
    weighed alike.
    """
    own = window_residuals(theta, windows, order, direct, room)
    spread = np.sqrt((own**2).mean((0, 1)))
    return np.maximum(np.where(np.isfinite(spread), spread, 1.0), 1e-9)


def window_residuals(
    theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool, room: int = 0
) -> np.ndarray:
    """Return the window residuals (N, s + 1, p), standardised, each output weighed alike; room: as of
    `refined`.
    """
    u, y, there = _filled(windows, room)
    left = np.asarray(_residuals(theta, u, y, there, np.ones(y.shape[2]), order, direct))
    return left[: len(windows.y)].reshape(windows.y.shape)


def _filled(windows: CompleteWindows, room: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (u, y, there), filled up to a power of two of windows, at least `room`: few sizes, few
    compilations.
    """
    more = power(max(len(windows.y), LEAST, room)) - len(windows.y)
    filled = []
    for x in (windows.u, windows.y, np.ones(len(windows.y))):
        filled.append(jax.device_put(np.concatenate([x, np.zeros((more, *x.shape[1:]))])))
    u, y, there = filled
    return u, y, there


def growth(theta: np.ndarray, order: int) -> float:
    """Return the largest modulus of an eigenvalue of the model."""
    p = theta.shape[1]
    companion = np.eye(order * p, k=p)
    companion[:, :p] = theta[: order * p].reshape(order, p, p).transpose(0, 2, 1).reshape(order * p, p)
    if not np.isfinite(companion).all():
        return np.inf
    return float(np.abs(np.linalg.eigvals(companion)).max())


def _marquardt(
    theta: np.ndarray,
    windows: tuple[jax.Array, jax.Array, jax.Array],
    weight: np.ndarray,
    order: int,
    direct: bool,
) -> np.ndarray:
    """Return coefficients that minimise the squares of weighted residuals, from some others on."""

    def cost_of(theta: np.ndarray) -> np.floating:
        left = np.asarray(_residuals(theta, *windows, weight, order, direct))
        cost: np.floating = np.square(left).sum()
        return cost

    cost, damping = cost_of(theta), 1e-3
    limit = max(1.0, growth(theta, order))  # no faster growth than the data asked for one step ahead
    for _ in range(STEPS):
        H, g = (np.asarray(x) for x in _slopes(theta, *windows, weight, order, direct))
        size = np.diag(H) + 1e-9 * np.trace(H) / len(H)
        for _ in range(12):
            trial = theta - np.linalg.solve(H + damping * np.diag(size), g).reshape(theta.shape)
            after = cost_of(trial)
            if after < cost and growth(trial, order) <= limit:  # False for NaN
                break
            damping *= 4
        else:
            return theta
        gain = 1 - after / cost
        theta, cost, damping = trial, after, max(damping / 8, 1e-12)
        if gain < SETTLED:
            break
    return theta
