"""A nominal model without a memory in which an error could hide: inputs through a few given filters, straight
to each output.

    y = c + D u + sum_j x_j,    x_j+ = a_j x_j + B_j u

A regression on past outputs likes slow poles: its free first state then follows whatever the plant does, a
constant error of a sensor or a leaking valve included. Here the poles are given, and so fast that what the
first state of a window was has faded at its end; the rest is linear least squares, with the first states of
each stretch of the recordings eliminated. It needs inputs that explain the outputs.
"""

from collections.abc import Sequence

import numpy as np

from jaxbound.studies.identification.regression import Scales

FADED, RATIO = 0.05, 3.0
"""What is left of a first state after a window, at the slowest pole; how many times faster the next one
is.
"""
RIDGE = 1e-2
"""Weight, relative to the samples, that keeps coefficients small which the data do not tell apart."""


def poles_of(order: int, horizon: int) -> list[float]:
    """Return the `order` poles of windows of horizon + 1 samples, slowest first, as short decimals.

    Example:
        >>> poles_of(2, 30)
        [0.905, 0.7411]
    """
    return [round(FADED ** (RATIO**j / horizon), 3 + j) for j in range(order)]


def filtered(
    records: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    scales: Scales,
    poles: Sequence[float],
    direct: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (B (order, p, m), D (p, m), c (p,), spread (p,)) in standardised signals; spread: root mean
    square of what is left.

    Args:
        records: [(u (T, m), y (T, p), starts)]. scales: Scales of them. poles: those of each output. direct:
            whether D may differ from 0.
    """
    rows = []
    for u, y, starts in records:
        u, y = (u - scales.u) / scales.u_spread, (y - scales.y) / scales.y_spread
        for first, stop in _stretches(u, starts):
            rows += _without_first_states(u[first:stop], y[first:stop], poles, direct)
    m, p = records[0][0].shape[1], records[0][1].shape[1]
    width = (len(poles) + direct) * m + 1
    regressors = np.concatenate([np.zeros((0, width)), *(r[0] for r in rows)])
    target = np.concatenate([np.zeros((0, p)), *(r[1] for r in rows)])
    size, spread, samples = np.ones(width), np.ones(p), max(len(target), 1)
    if len(target):
        size = np.maximum(np.sqrt((regressors**2).mean(0)), 1e-9)
    weight = np.append(np.full(width - 1, RIDGE), 0.0)  # the constant is free
    scaled = regressors / size
    normal = scaled.T @ scaled / samples + np.diag(weight**2)
    theta = np.linalg.lstsq(normal, scaled.T @ target / samples, rcond=None)[0] / size[:, None]
    left = target - regressors @ theta
    if len(target):
        spread = np.sqrt((left**2).mean(0))
    parts = theta[:-1].T.reshape(p, len(poles) + direct, m)
    D = np.zeros((p, m))
    if direct:
        D, parts = parts[:, 0], parts[:, 1:]
    return np.moveaxis(parts, 1, 0), D, theta[-1], np.maximum(spread, 1e-9)


def _stretches(u: np.ndarray, starts: np.ndarray) -> list[tuple[int, int]]:
    """Return [(first, stop)] of the stretches whose samples follow each other and have all inputs."""
    gone = np.isnan(u).any(1)
    cuts = np.zeros(len(u) + 1, bool)
    cuts[[0, len(u), *np.asarray(starts, int)]] = True
    cuts[1:-1] |= gone[1:] != gone[:-1]
    at = np.flatnonzero(cuts)
    return [(a, b) for a, b in zip(at[:-1], at[1:], strict=True) if not gone[a]]


def _without_first_states(
    u: np.ndarray, y: np.ndarray, poles: Sequence[float], direct: bool
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return [(regressors, targets)] of the samples with all outputs, first states taken out; [] if there are
    too few.
    """
    complete = ~np.isnan(y).any(1)
    if complete.sum() <= 2 * len(poles):
        return []
    columns = [_through(u, a) for a in poles]
    if direct:
        columns.insert(0, u)
    regressors = np.hstack([*columns, np.ones((len(u), 1))])[complete]
    faded = np.array(poles)[None] ** np.arange(len(u))[:, None]
    Q, _ = np.linalg.qr(faded[complete])
    target = y[complete]
    return [(regressors - Q @ (Q.T @ regressors), target - Q @ (Q.T @ target))]


def _through(u: np.ndarray, a: float) -> np.ndarray:
    """Return x with x+ = a x + u, x_0 = 0: u (T, m) with an impulse response that ends where a^k is below
    rounding.
    """
    response = np.append(0.0, a ** np.arange(min(len(u), int(np.log(1e-16) / np.log(a)) + 1)))
    return np.stack([np.convolve(column, response)[: len(u)] for column in u.T], 1)
