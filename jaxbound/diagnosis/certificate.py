"""One window in exact rational arithmetic: which relation is violated, and by how much."""

from fractions import Fraction

import numpy as np

from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.window import input_lags
from jaxbound.relations.parity import relation_text

__all__ = ["exact_rows", "worst_relation"]


def exact_rows(result, at):
    """Return the window that ends at index `at` as exact numbers: (mid, rad, known), None where a sample is missing."""
    r = result.relations
    at = at if isinstance(at, tuple) else (at,)
    model, s, k = r.model, r.horizon, at[-1]
    y, u = result.y[at[:-1]][k - s : k + 1], result.u[at[:-1]][k - s : k + 1]
    u_roundoff = Fraction(float(np.finfo(y.dtype).eps)) / 2
    samples = [[None if np.isnan(v) else Fraction(float(v)) for v in row] for row in y]
    mid, rad = [], []
    rho = []
    for i in range(model.p):
        noise = Fraction(float(r.bounds["noise"][i]))
        largest = max((abs(row[i]) for row in samples if row[i] is not None), default=Fraction(0))
        rho.append(noise + model.resolution[i] + RECORDER_ULPS * u_roundoff * (largest + noise))
    for row in samples:
        for i, v in enumerate(row):
            sigma = Fraction(float(r.bounds["tolerance"][i]))
            e = 1 / (1 - sigma**2)
            d = None if v is None else v - model.offset["y"][i]
            mid.append(None if d is None else e * (d + sigma * max(-rho[i], min(d, rho[i]))))
            rad.append(None if d is None else e * (rho[i] + sigma * max(abs(d), rho[i])))
    lags = input_lags(model, s)
    known = [None if np.isnan(v) else Fraction(float(v)) - model.offset["u"][i] for row in u[:lags] for i, v in enumerate(row)]
    return mid, rad, known


def worst_relation(result, at):
    """Return the relation of the window that the data violate most, as text, with its excess."""
    r = result.relations
    mid, rad, known = exact_rows(result, at)
    rows = zip(r.circuits, r.circuits_known, strict=True) if result.method != "box" else zip(r.W, r.K, strict=True)
    worst, factor = None, Fraction(-1)
    for h, k in rows:
        used = [i for i, x in enumerate(h) if x]
        if any(mid[i] is None for i in used) or any(x and v is None for x, v in zip(k, known, strict=True)):
            continue
        residual = sum(h[i] * mid[i] for i in used) - sum((x * v for x, v in zip(k, known, strict=True) if x), Fraction(0))
        width = sum(abs(h[i]) * rad[i] for i in used)
        gauge = abs(residual) / width if width else Fraction(10**30)
        if gauge > factor:
            worst, factor = (h, k), gauge
    return f"{relation_text(r.model, r.horizon, *worst)} fails: it would need bounds {float(factor):.4g} times as wide"
