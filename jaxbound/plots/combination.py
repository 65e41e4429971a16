"""Relations over the windows of a recording: the one that a certificate states, and the readings that they
leave to each sensor. In floats and not rounded outward: for pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.exact_window import ExactWindow, exact_window
from jaxbound.models.rows import Row
from jaxbound.relations.parity import ParityRelation
from jaxbound.sets.intervals.interval import Interval

ROWS, BLOCK = 512, 64  # relations that expected readings are taken from, and those taken side by side


@dataclass(frozen=True)
class _Samples:
    """The true outputs of every window, less their offsets, as its samples tell alone.

    Fields: middle, half (N, (s+1)p), time-major; error (N, p): what noise, resolution and rounding may add to
    the last sample.
    """

    middle: np.ndarray
    half: np.ndarray
    error: np.ndarray


def combination(certificate: Certificate, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, width), each (T,), of the certificate's relation in every window of a recording u (T,
    m), y (T, p).

    A window that ends at sample k contradicts the relation where |value[k]| > width[k]; both are NaN where a
    sample that it needs is missing. In the certified window they are its residual and width. Not rounded
    outward: for pictures.

    Source: Adrot, Maquin, Ragot 2000, (7), (9).
    """
    window, model = certificate.window, certificate.window.model
    s, outputs, disturbed = window.horizon, (window.horizon + 1) * model.p, model.g * window.horizon
    samples = _samples(window, u, y)
    h, k = _floats(certificate.h), _floats(certificate.k)
    used = np.flatnonzero(h[:outputs])  # a sample that is not looked at may be missing
    value = samples.middle[:, used] @ h[used]
    width = samples.half[:, used] @ abs(h[used])

    for weight, row in zip(h[window.rows.single :], window.rows.of_sums, strict=True):
        if not weight:
            continue
        middle, half = _sum(window, samples, row)
        value = value + weight * middle
        width = width + abs(weight) * half

    middle, half = _disturbances(window)
    value = value + h[outputs : outputs + disturbed] @ middle
    width = width + abs(h[outputs : outputs + disturbed]) @ half
    known = np.flatnonzero(k)
    # inputs that the relation does not look at may be missing
    value = value - _inputs(window, u, len(value), len(k))[:, known] @ k[known]
    width = np.where(np.isnan(value), np.nan, width)
    return _from_sample(s, len(y), value), _from_sample(s, len(y), width)


def expected_readings(relations: ParityRelation, u: np.ndarray, y: np.ndarray) -> Interval:
    """Return the Interval (T, p) that holds each healthy reading, as far as the other samples of the window
    that ends with it tell.

    Every relation that contains the last sample of a sensor bounds it by the rest of the window; the first
    512 of them are intersected. NaN where none does, before the first full window, and where samples are
    missing; lo > hi where the rest of the window is a contradiction by itself. Not rounded outward: for
    pictures.

    Args:
        relations: with tolerances that may vary within a window. u: (T, m) inputs. y: (T, p) outputs.
    """
    model, s = relations.model, relations.horizon
    lo, hi = np.full((2, len(y), model.p), np.nan)
    rows = _rows_of_last_sample(relations)
    if len(y) <= s or not len(rows.outputs):
        return Interval(lo, hi)
    window = exact_window(relations, u[: s + 1], y[: s + 1])
    samples = _samples(window, u, y)
    least, most = (
        np.full((len(samples.middle), model.p), -np.inf),
        np.full((len(samples.middle), model.p), np.inf),
    )
    for first in range(0, len(rows.outputs), BLOCK):
        below, above = _bounded_by(rows.block(first), window, samples, u)
        # NaN of a relation that lacks a sample leaves what others say
        least, most = np.fmax(least, below), np.fmin(most, above)
    below, above = _readings(window, samples.error, least, most)
    lo[s:] = np.where(np.isfinite(below), below, np.nan)
    hi[s:] = np.where(np.isfinite(above), above, np.nan)
    return Interval(lo, hi)


@dataclass(frozen=True)
class _Rows:
    """Relations in floats: outputs (R, (s+1)p), disturbances (R, gs), inputs (R, known)."""

    outputs: np.ndarray
    disturbances: np.ndarray
    inputs: np.ndarray

    def block(self, first: int) -> "_Rows":
        """Return the rows from one on that fit into memory side by side."""
        part = slice(first, first + BLOCK)
        return _Rows(self.outputs[part], self.disturbances[part], self.inputs[part])


@lru_cache(maxsize=2)  # the stretches of a page ask for the same ones
def _rows_of_last_sample(relations: ParityRelation) -> _Rows:
    """Return the first relations that contain a last sample and no average."""
    p, s = relations.model.p, relations.horizon
    outputs, beyond = (s + 1) * p, (s + 1) * p + relations.model.g * s
    pairs = zip(relations.circuits, relations.circuits_known, strict=True)
    if not relations.circuits:
        pairs = zip(relations.W, relations.K, strict=True)
    fit = [(h, k) for h, k in pairs if any(h[s * p : outputs]) and not any(h[beyond:])][:ROWS]
    h = np.array([_floats(h[:beyond]) for h, _ in fit]).reshape(len(fit), beyond)
    k = np.array([_floats(k) for _, k in fit]).reshape(len(fit), -1)
    return _Rows(h[:, :outputs], h[:, outputs:], k)


def _bounded_by(
    rows: _Rows, window: ExactWindow, samples: _Samples, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi), each (N, p): where rows put the true value of the last sample of each output, less its
    offset, by the rest of its window; NaN where they do not.
    """
    p, h = window.model.p, rows.outputs
    missing = np.isnan(samples.middle)
    middle, half = np.where(missing, 0, samples.middle), np.where(missing, 0, samples.half)
    drift, spread = _disturbances(window)
    value = middle @ h.T + rows.disturbances @ drift
    value = value - _inputs(window, u, len(middle), rows.inputs.shape[1]) @ rows.inputs.T
    width = half @ abs(h).T + abs(rows.disturbances) @ spread
    lacking = missing @ (h != 0).T.astype(float)  # how many samples of each row are missing

    lo, hi = np.full((2, len(middle), p), np.nan)
    for i in range(p):
        own = slice(h.shape[1] - p + i, h.shape[1] - p + i + 1)
        through = np.flatnonzero(h[:, own])
        if not len(through):
            continue
        # h_own t + rest = 0 up to the width of the rest: t is bounded where h_own is not 0
        weight = h[through, own].T
        rest = value[:, through] - weight * middle[:, own]
        free = width[:, through] - abs(weight) * half[:, own]
        # no sample is missing but its own, which is what is asked for
        known = lacking[:, through] == missing[:, own]
        centre, reach = np.where(known, -rest / weight, np.nan), free / abs(weight)
        lo[:, i], hi[:, i] = np.fmax.reduce(centre - reach, 1), np.fmin.reduce(centre + reach, 1)
    return lo, hi


def _samples(window: ExactWindow, u: np.ndarray, y: np.ndarray) -> _Samples:
    """Return the ranges of the true outputs of all windows that the samples y (T, p) alone allow, u (T, m)
    with the factors on their noise.
    """
    every = np.lib.stride_tricks.sliding_window_view(np.asarray(y, float), window.horizon + 1, axis=0)
    every = np.moveaxis(every, 2, 1)  # (N, s + 1, p)
    noise, tolerance = _floats(window.claim["noise"])[None, None], _floats(window.tolerance)
    if window.model.factors:
        factors = np.ones(np.shape(y))
        for column, factor in enumerate(window.model.factors, window.model.m):
            factors[:, factor.number] = np.asarray(u, float)[:, column]
        windows = np.lib.stride_tricks.sliding_window_view(factors, window.horizon + 1, axis=0)
        noise = noise * np.moveaxis(windows, 2, 1)
    largest = np.fmax.reduce(abs(every), 1, keepdims=True, initial=0.0)
    recorded = float(window.claim["recorder"]) * (largest + noise) + float(window.claim["floor"])
    error = noise + _floats(window.claim["resolution"]) + recorded

    def stretched(v: np.ndarray) -> np.ndarray:
        # t = v / (1 + theta): the extreme theta depends on the sign of v
        return np.asarray(np.where(v > 0, v / (1 - tolerance), v / (1 + tolerance)))

    deviation = every - _floats(window.model.offset["y"])
    low, high = -stretched(error - deviation), stretched(error + deviation)
    flat = (len(every), -1)
    return _Samples(((low + high) / 2).reshape(flat), ((high - low) / 2).reshape(flat), error[:, -1])


def _readings(
    window: ExactWindow, error: np.ndarray, lo: np.ndarray, hi: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi), each (N, p), of the readings of sensors whose true values lie in [lo, hi]."""
    tolerance, offset = _floats(window.tolerance), _floats(window.model.offset["y"])
    least = np.minimum((1 - tolerance) * lo, (1 + tolerance) * lo)
    most = np.maximum((1 - tolerance) * hi, (1 + tolerance) * hi)
    return least - error + offset, most + error + offset


def _sum(window: ExactWindow, samples: _Samples, row: Row) -> tuple[np.ndarray | float, np.ndarray | float]:
    """Return (middle, half-width) of a weighted sum of true outputs in every window."""
    p, values, bound = window.model.p, row.values, float(window.model.averages[row.number].bound)
    if not values.measured:
        return 0.0, bound
    middle: np.ndarray | float = 0.0
    half: np.ndarray | float = bound
    for i, weights in values.parts:
        columns = p * (row.first + np.arange(len(weights))) + i
        middle = middle + samples.middle[:, columns] @ _floats(weights)
        # beyond noise, which the bound of the sum is about, each reading may be off by its rounding
        error = samples.half[:, columns[-1]] - float(window.claim["noise"][i])
        half = half + float(values.size_of(i)) * error
    return middle, half


def _disturbances(window: ExactWindow) -> tuple[np.ndarray, np.ndarray]:
    """Return (middle, half-width), each (gs,), of the disturbances of a window."""
    g, s = window.model.g, window.horizon
    ends = np.array([_floats(pair) for pair in window.claim["disturbance"]]).reshape(g, 2)
    return np.tile(ends.mean(1), s), np.tile((ends[:, 1] - ends[:, 0]) / 2, s)


def _inputs(window: ExactWindow, u: np.ndarray, count: int, known: int) -> np.ndarray:
    """Return the inputs (count, known) of all windows, less their offsets, as many as relations look at."""
    m = window.model.m
    if not known:
        return np.zeros((count, 0))
    deviation = np.asarray(u, float)[:, :m] - _floats(window.model.offset["u"])
    # relations that end early look at fewer samples of u than windows have
    lags = [deviation[lag : lag + count] for lag in range(known // m)]
    return np.concatenate(lags, 1)


def _floats(values: Sequence[Fraction]) -> np.ndarray:
    return np.array(values, float)


def _from_sample(s: int, samples: int, values: np.ndarray) -> np.ndarray:
    """Return values of windows by the sample at which each ends, NaN before the first one."""
    return np.concatenate([np.full(samples - len(values), np.nan), values])
