"""The combination of samples that a certificate speaks of, over time, and what healthy sensors can make of
it.
"""

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.window import bounded_sums

__all__ = ["combination"]


def combination(certificate: Certificate, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, width), each (T,), of the certificate's relation in every window of a recording u (T,
    m), y (T, p).

    A window that ends at sample k contradicts the relation where |value[k]| > width[k]; both are NaN where a
    sample that it needs is missing. In the certified window they are its residual and width. Not rounded
    outward: for pictures.

    Source: Adrot, Maquin, Ragot 2000, (7), (9).
    """
    window, model = certificate.window, certificate.window.model
    s, p, m, g = window.horizon, model.p, model.m, model.g
    count = max(len(y) - s, 0)
    h, k = (np.array([float(x) for x in row]) for row in (certificate.h, certificate.k))
    value, width = np.zeros(count), np.zeros(count)
    for i in range(p):
        used = [j for j in range(s + 1) if h[j * p + i]]
        if not used:
            continue
        lo, hi = _limits(window, i, np.asarray(y[:, i], float), s, count)
        for j in used:
            low, high = lo(j), hi(j)
            value += h[j * p + i] * (low + high) / 2
            width += abs(h[j * p + i]) * (high - low) / 2
    for x, row in zip(h[window.rows.single :], window.rows.of_sums, strict=True):
        if not x:
            continue
        value_of, width_of = _summed(window, row, y, s, count)
        value += x * value_of
        width += abs(x) * width_of
    for j, x in enumerate(h[(s + 1) * p : (s + 1) * p + g * s]):
        low, high = map(float, window.disturbance[j % g])
        value += x * (low + high) / 2
        width += abs(x) * (high - low) / 2
    for j, x in enumerate(k):
        if x:
            lag, i = divmod(j, m)
            value -= x * (np.asarray(u[lag : lag + count, i], float) - float(model.offset["u"][i]))
    pad = np.full(len(y) - count, np.nan)
    return np.concatenate([pad, value]), np.concatenate([pad, np.where(np.isnan(value), np.nan, width)])


def _summed(window, row, y, s, count):
    """Return (middle, half-width) of a weighted sum of every window."""
    values, bound = row.values, float(bounded_sums(window.model)[row.number].bound)
    if not values.measured:
        return 0.0, bound
    middle, half = np.zeros(count), bound
    for i, weights in values.parts:
        least, most = _limits(window, i, np.asarray(y[:, i], float), s, count)
        for sample, weight in enumerate(map(float, weights), row.first):
            lo, hi = least(sample), most(sample)
            middle += weight * (lo + hi) / 2
        rho = (hi - lo) / 2 - float(window.noise[i])
        half = half + float(values.size_of(i)) * rho
    return middle, half


def _limits(window, i, y, s, count):
    """Return two functions of j: the least and the largest true value, less the offset, behind sample j of
    output i of every window.
    """
    tolerance, noise, resolution = (float(x[i]) for x in (window.tolerance, window.noise, window.resolution))
    offset, unit = float(window.model.offset["y"][i]), float(window.unit)
    largest = np.zeros(count)
    for j in range(s + 1):
        largest = np.fmax(largest, abs(y[j : j + count]))
    rho = noise + resolution + RECORDER_ULPS * unit * (largest + noise) + float(window.floor)

    def stretched(v):
        return np.where(v > 0, v / (1 - tolerance), v / (1 + tolerance))

    return (lambda j: -stretched(rho - y[j : j + count] + offset)), (
        lambda j: stretched(rho + y[j : j + count] - offset)
    )
