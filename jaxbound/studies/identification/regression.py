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
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.seams import crossing
from jaxbound.sets.floats.one_thread import times
from jaxbound.studies.identification.records import Records

STEPS, SETTLED = 60, 1e-6
"""Steps of the refinement at most, and the relative gain of one after which it ends."""
MOST = 1_024
"""Windows that the refinement looks at: of longer recordings, this many spread evenly."""


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
    return windows_without(np.asarray(np.isnan(u).any(1) | np.isnan(y).any(1)), starts, horizon)


def windows_without(gone: np.ndarray, starts: np.ndarray, horizon: int) -> np.ndarray:
    """Return the first samples of the windows of a recording that hold no sample that is gone, (T,) bool, and
    cross no seam.
    """
    if len(gone) <= horizon:
        return np.zeros(0, int)
    whole = in_windows(gone, horizon) == 0
    return np.flatnonzero(whole & ~crossing(starts, horizon, horizon, len(gone)))


def completeness(records: Records, horizon: int) -> float:
    """Return the share of complete windows among those with a verdict; 1 where there are none."""
    complete = sum(len(complete_windows(*record, horizon)) for record in records)
    judged = _judged(records, horizon)
    return complete / judged if judged else 1.0


def reached(records: Records, horizon: int) -> float:
    """Return the share of the samples with an output at which a window ends that has a verdict."""
    return _judged(records, horizon) / max(_judged(records, 0), 1)


def _judged(records: Records, horizon: int) -> int:
    """Return how many windows have an output at all and cross no seam."""
    count = 0
    for _, y, starts in records:
        if len(y) > horizon:
            seen = in_windows(np.asarray((~np.isnan(y)).any(1)), horizon) > 0
            count += int((seen & ~crossing(starts, horizon, horizon, len(y))).sum())
    return count


def in_windows(chosen: np.ndarray, horizon: int) -> np.ndarray:
    """Return how many samples of each window are chosen, of (T,) bool."""
    before = np.append(0, np.cumsum(chosen))
    return np.asarray(before[horizon + 1 :] - before[: -horizon - 1])


def least_squares(windows: CompleteWindows, order: int, direct: bool) -> np.ndarray:
    """Return theta: coefficients ((order (p + m) + direct m + 1), p), one step ahead.

    Args:
        windows: of order + 1 samples. direct: whether u_k acts on y_k.
    """
    regressors = _regressors(windows, order, direct)
    return np.asarray(np.linalg.lstsq(regressors, windows.y[:, order], rcond=1e-9)[0])


def step_errors(theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool) -> np.ndarray:
    """Return the errors (N, p) of one step in windows of order + 1 samples."""
    return np.asarray(windows.y[:, order] - _regressors(windows, order, direct) @ theta)


def step_error(windows: CompleteWindows, order: int, direct: bool) -> float:
    """Return the sum of the squares that `least_squares` leaves of windows of order + 1 samples."""
    left = step_errors(least_squares(windows, order, direct), windows, order, direct)
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


def arx_coefficients(
    theta: np.ndarray, order: int, direct: bool, m: int, p: int
) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray, np.ndarray]:
    """Return (A_1.., B_1.., D, c): lists of (p, p) and (p, m), (p, m), (p,)."""
    A = [theta[i * p : (i + 1) * p].T for i in range(order)]
    rest = theta[order * p :]
    B = [rest[i * m : (i + 1) * m].T for i in range(order + direct)]
    D = np.zeros((p, m))
    if direct:
        D, *B = B
    return A, B, D, theta[-1]


class Responses(NamedTuple):
    """Windows of a model whose first state is 0, and what a first state adds.

    Fields: through (s + 1, p, s + 1, p): from an entry of the recursion at one sample to the outputs at
    another; driven (N, s + 1, p): the outputs by inputs and constant; free (s + 1, p, n): columns of outputs.
    """

    through: np.ndarray
    driven: np.ndarray
    free: np.ndarray


def responses(theta: np.ndarray, u: np.ndarray, p: int, order: int, direct: bool) -> Responses:
    """Return the Responses of windows u (N, s + 1, m)."""
    count = u.shape[1]
    A, B, D, c = arx_coefficients(theta, order, direct, u.shape[2], p)
    impulse = np.zeros((count + 1, p, p))  # the last one stays 0
    impulse[0] = np.eye(p)
    for k in range(1, count):
        for lag, a in enumerate(A[:k], 1):
            impulse[k] += a @ impulse[k - lag]
    later = np.arange(count)[:, None] - np.arange(count)
    through = impulse[np.where(later >= 0, later, count)].transpose(0, 2, 1, 3)
    enters = u @ D.T
    for lag, b in enumerate(B, 1):
        enters[:, lag:] += u[:, :-lag] @ b.T
    enters[:, 1:] += c
    driven = times(enters.reshape(len(u), -1), through.reshape(count * p, -1).T).reshape(len(u), count, p)
    # what a state waits for enters at the first samples, one after the other
    free = through[:, :, :order].reshape(count, p, order * p)
    return Responses(through, driven, free)


def _residuals(
    theta: np.ndarray, u: np.ndarray, y: np.ndarray, weight: np.ndarray, order: int, direct: bool
) -> np.ndarray:
    """Return the residual (N, (s + 1) p) of the best first state, times weight (p,).

    Windows are u (N, s + 1, m), y (N, s + 1, p).
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a model that explodes is not taken
        answer = responses(theta, u, y.shape[2], order, direct)
        left = ((y - answer.driven) * weight).reshape(len(y), -1)
        Q, _ = np.linalg.qr((answer.free * weight[:, None]).reshape(left.shape[1], -1))
        return np.asarray(left - times(times(left, Q), Q.T))


def _slopes(
    theta: np.ndarray, u: np.ndarray, y: np.ndarray, weight: np.ndarray, order: int, direct: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return (J'J, J'e) of the residuals e and their slopes J: what a step needs, small whatever the number
    of windows.

    With r = e + O x, x the best first state, P = I - Q Q' and O = Q R, the slopes of e = P r are

        de = P (dr - dO x) - Q R^-T dO' e

    of which the first part is orthogonal to the second, and e to it. An entry of theta acts on the outputs
    through the recursion, by the regressor that it multiplies. Source: Golub, Pereyra 1973.
    """
    N, count, p = y.shape
    through, driven, free = responses(theta, u, p, order, direct)
    n = free.shape[2]
    left = ((y - driven) * weight).reshape(N, -1)
    Q, R = np.linalg.qr((free * weight[:, None]).reshape(count * p, n))
    explained = times(left, Q)
    e = left - times(explained, Q.T)
    state = np.linalg.solve(R, explained.T)
    fitted = driven + (state.T @ free.reshape(-1, n).T).reshape(y.shape)
    regressors = _of_each_sample(fitted, u, order, direct)
    own = _of_each_sample(free.transpose(2, 0, 1), np.zeros((n, count, 0)), order, direct)[:, :, :n]
    weighted = through * weight[:, None, None]
    moved = weighted.transpose(3, 0, 1, 2).reshape(p, count * p, count)  # by an entry of each output
    moved_out = moved - Q @ (Q.T @ moved)
    width = regressors.shape[2]
    rows = regressors.reshape(-1, width)
    H, g = np.zeros((width, p, width, p)), np.zeros((width, p))
    turned = np.zeros((p, n, N, n))
    for a in range(p):
        toward = times(e, moved[a])
        g[:, a] = -toward.ravel() @ rows
        pulled = np.tensordot(own, toward, (1, 1)).reshape(n, -1)
        turned[a] = np.linalg.solve(R.T, pulled).reshape(n, n, N).swapaxes(1, 2)
        for b in range(a + 1):
            both = times(moved_out[a].T, moved_out[b]) @ regressors
            H[:, a, :, b] = (regressors.swapaxes(1, 2) @ both).sum(0)
            H[:n, a, :n, b] += turned[a].reshape(-1, n).T @ turned[b].reshape(-1, n)
            H[:, b, :, a] = H[:, a, :, b].T
    return H.reshape(width * p, -1), g.ravel()


def _of_each_sample(y: np.ndarray, u: np.ndarray, order: int, direct: bool) -> np.ndarray:
    """Return the regressors (N, s + 1, rows of theta) of each sample of windows, 0 before their first one."""
    past = [_delayed(y, lag) for lag in range(1, order + 1)]
    past += [_delayed(u, lag) for lag in range(not direct, order + 1)]
    constant = np.ones((*y.shape[:2], 1))
    constant[:, 0] = 0
    return np.concatenate([*past, constant], 2)


def _delayed(x: np.ndarray, lag: int) -> np.ndarray:
    """Return samples (N, s + 1, n) that much later, 0 before the first one."""
    moved = np.zeros_like(x)
    moved[:, lag:] = x[:, : x.shape[1] - lag]
    return moved


def refined_coefficients(
    theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return (theta, spread): coefficients that minimise the window residuals, each output weighed by its own
    spread (p,).

    Outputs of a window are simulated from its best first state on, without those that were measured: an
    output error method over s + 1 samples.

    Args:
        theta: where to begin, from `least_squares`. windows: of s + 1 samples.
    """
    spread = window_spread(theta, windows, order, direct)
    for _ in range(2):  # the spreads are those of the result before
        theta = _marquardt(theta, windows, 1 / spread, order, direct)
        spread = window_spread(theta, windows, order, direct)
    return theta, spread


def window_spread(theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool) -> np.ndarray:
    """Return the root mean square (p,) of the window residuals of each output, standardised, each output
    weighed alike.
    """
    own = window_residuals(theta, windows, order, direct)
    spread = np.sqrt((own**2).mean((0, 1)))
    return np.maximum(np.where(np.isfinite(spread), spread, 1.0), 1e-9)


def window_residuals(theta: np.ndarray, windows: CompleteWindows, order: int, direct: bool) -> np.ndarray:
    """Return the window residuals (N, s + 1, p), standardised, each output weighed alike."""
    left = _residuals(theta, windows.u, windows.y, np.ones(windows.y.shape[2]), order, direct)
    return left.reshape(windows.y.shape)


def courses(horizon: int) -> np.ndarray:
    """Return (2, s + 1) bool: a jump begins in the middle of a window, a steady error fills it."""
    samples = np.arange(horizon + 1)
    return np.stack([samples >= len(samples) // 2, samples >= 0])


def growth(theta: np.ndarray, order: int) -> float:
    """Return the largest modulus of an eigenvalue of the model."""
    p = theta.shape[1]
    companion = np.eye(order * p, k=p)
    companion[:, :p] = theta[: order * p].reshape(order, p, p).transpose(0, 2, 1).reshape(order * p, p)
    if not np.isfinite(companion).all():
        return np.inf
    return float(np.abs(np.linalg.eigvals(companion)).max())


def _marquardt(
    theta: np.ndarray, windows: CompleteWindows, weight: np.ndarray, order: int, direct: bool
) -> np.ndarray:
    """Return coefficients that minimise the squares of weighted residuals, from some others on."""

    def cost_of(theta: np.ndarray) -> np.floating:
        left = _residuals(theta, windows.u, windows.y, weight, order, direct)
        cost: np.floating = np.square(left).sum()
        return cost

    cost, damping = cost_of(theta), 1e-3
    limit = max(1.0, growth(theta, order))  # no faster growth than the data asked for one step ahead
    for _ in range(STEPS):
        H, g = _slopes(theta, windows.u, windows.y, weight, order, direct)
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
