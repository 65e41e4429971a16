"""The certificate of one verdict, in exact rational arithmetic: the violated relation, or a state that explains the window."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from jaxbound.models import window
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.relations.parity import relation_text
from jaxbound.sets.status import Status

__all__ = ["Certificate", "explain"]


@dataclass(frozen=True, eq=False)
class Certificate:
    """Why a window has its verdict; every number is an exact Fraction, so that anybody can check it.

    Fields:
        status: of the window.
        relation: the tightest relation of the window, as text.
        h, k: its coefficients on the (s+1)p recorded samples (time-major) and on the inputs: h Y - k U = 0 for an exact plant.
        residual, width: the value of the relation at the middles of the samples' intervals and the largest that the bounds allow; FAULT
            because |residual| > width.
        factor: |residual| / width, the factor on all bounds at which the window just becomes consistent.
        state: for CONSISTENT, a first state of the window that keeps every sample within its bounds (the witness); else None.
    """

    status: Status
    relation: str
    h: tuple
    k: tuple
    residual: Fraction
    width: Fraction
    factor: Fraction
    state: tuple | None

    def __str__(self):
        """Return one sentence."""
        if self.status == Status.FAULT:
            return f"{self.relation} cannot hold: it would need bounds {float(self.factor):.4g} times as wide"
        if self.state is not None:
            return f"explained by the first state ({', '.join(f'{float(x):.6g}' for x in self.state)})"
        return f"{self.relation} holds to {float(self.factor):.4g} of its bounds"


def explain(result, at):
    """Return the Certificate of the window that ends at index `at`. See `Result.explain`."""
    status = Status(int(result.status[at]))
    if status == Status.MISSING:
        raise ValueError(f"window {at} is MISSING: there is nothing to explain")
    r = result.relations
    mid, rad, known = _exact_window(result, at if isinstance(at, tuple) else (at,))
    best = None
    for h, k in zip(*((r.W, r.K) if result.method == "box" else (r.circuits, r.circuits_known)), strict=True):
        used = [i for i, x in enumerate(h) if x]
        if any(mid[i] is None for i in used) or any(x and v is None for x, v in zip(k, known, strict=True)):
            continue
        residual = sum(h[i] * mid[i] for i in used) - sum((x * v for x, v in zip(k, known, strict=True) if x), Fraction(0))
        width = sum(abs(h[i]) * rad[i] for i in used)
        if best is None or abs(residual) / width > best[0]:
            best = abs(residual) / width, h, k, residual, width
    factor, h, k, residual, width = best
    state = _witness(r, mid, rad, known) if status == Status.CONSISTENT else None
    return Certificate(status, relation_text(r.model, r.horizon, h, k), h, k, residual, width, factor, state)


def _exact_window(result, at):
    """Return (mid, rad, known) of a window as in `models.sensor`, None where a sample is missing."""
    r = result.relations
    model, s, k = r.model, r.horizon, at[-1]
    y, u = (x[at[:-1]][k - s : k + 1] for x in (result.y, result.u))
    roundoff = Fraction(float(np.finfo(y.dtype).eps)) / 2
    exactly = lambda v: None if np.isnan(v) else Fraction(float(v))
    mid, rad = [None] * y.size, [None] * y.size
    for i in range(model.p):
        sigma, noise = (Fraction(float(r.bounds[name][i])) for name in ("tolerance", "noise"))
        samples = [exactly(v) for v in y[:, i]]
        largest = max((abs(v) for v in samples if v is not None), default=Fraction(0))
        rho = noise + model.resolution[i] + RECORDER_ULPS * roundoff * (largest + noise) + Fraction(float(np.finfo(y.dtype).tiny))
        e = 1 / (1 - sigma**2)
        for j, v in enumerate(samples):
            if v is not None:
                d = v - model.offset["y"][i]
                mid[j * model.p + i] = e * (d + sigma * max(-rho, min(d, rho)))
                rad[j * model.p + i] = e * (rho + sigma * max(abs(d), rho))
    lags = window.input_lags(model, s)
    known = [None if (x := exactly(v)) is None else x - model.offset["u"][i] for row in u[:lags] for i, v in enumerate(row)]
    return mid, rad, known


def _witness(relations, mid, rad, known):
    """Return a state with |mid - O x - H u| <= rad in every row that has its data, checked exactly, or None if the search found none.

    Lawson's iteration for the Chebyshev problem min over x of max |b - O x| / rad: weighted least squares, weights times residuals.
    """
    O, H = window.first_form(relations.model, relations.horizon)
    rows = [i for i, m in enumerate(mid) if m is not None and not any(x and v is None for x, v in zip(H[i], known, strict=True))]
    b = [mid[i] - sum((x * v for x, v in zip(H[i], known, strict=True) if x), Fraction(0)) for i in rows]
    matrix = np.array([[float(x / rad[i]) for x in O[i]] for i in rows])
    target = np.array([float(v / rad[i]) for v, i in zip(b, rows, strict=True)])
    weights = np.full(len(rows), 1 / len(rows))
    for _ in range(2000):
        root = np.sqrt(weights)
        x = np.linalg.lstsq(matrix * root[:, None], target * root, rcond=None)[0]
        size = np.abs(target - matrix @ x)
        if size.max() <= 1:
            state = tuple(Fraction(float(v)) for v in x)
            if all(abs(v - sum(a * c for a, c in zip(O[i], state, strict=True))) <= rad[i] for v, i in zip(b, rows, strict=True)):
                return state
        weights = weights * size
        weights /= weights.sum() or 1
    return None
