"""From the coefficients of a regression to the matrices of a model: the states of an ARX model, or of
filters, as short decimals.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.studies.identification import filters, regression
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.regression import CompleteWindows, Scales

DIGITS = 6
"""Coefficients are rounded to this many digits behind the largest effect that they could have, relative to
the spread of the output.
"""


def realised(theta: ArrayLike, scales: Scales, order: int, direct: bool, m: int, p: int) -> dict[str, Any]:
    """Return A, B, C, D and the offset of a LinearSystem from standardised coefficients (see `regression`),
    rounded to short decimals.
    """
    A, B, D, c = regression.arx_coefficients(np.asarray(theta, np.float64), order, direct, m, p)
    to_y = scales.y_spread[:, None] / scales.y_spread[None]
    to_u = scales.y_spread[:, None] / scales.u_spread[None]
    A, D = [_short(a * to_y, to_y) for a in A], _short(D * to_u, to_u)
    B = [_short(b * to_u + a @ D, to_u) for a, b in zip(A, B, strict=True)]
    eye, none = np.eye(p), np.zeros((p, p))
    shift = np.eye(order * p, k=p)
    shift[:, :p] = np.vstack(A)  # what waits moves up by one sample
    # the constant as an operating point, the nearest to the middle of the data:
    # (I - sum A) y0 = (sum B + (I - sum A) D) u0 + c
    stay = eye - sum(A)
    moved = np.linalg.lstsq(np.hstack([stay / to_y, -(sum(B) + stay @ D) / to_u]), c, rcond=None)[0]
    y0, u0 = scales.y + moved[:p] * scales.y_spread, scales.u + moved[p:] * scales.u_spread
    return {
        "A": shift,
        "B": np.vstack(B) if m else None,
        "C": np.hstack([eye, *[none] * (order - 1)]),
        "D": D if direct and m else None,
        "offset": {"y": _short(y0, scales.y_spread), "u": _short(u0, scales.u_spread)},
    }


def realised_filters(
    records: Records, scales: Scales, poles: Sequence[float], direct: bool
) -> tuple[dict[str, Any], np.ndarray]:
    """Return (arguments of a LinearSystem, spread): each output has its own states, one a pole."""
    B, D, c, spread = filters.filtered(records, scales, poles, direct)
    p, to_u = len(c), scales.y_spread[:, None] / scales.u_spread[None]
    y0 = scales.y + c * scales.y_spread
    spec = {
        "A": np.diag(np.repeat(poles, p)),
        "B": np.concatenate([_short(b * to_u, to_u) for b in B]),
        "C": np.hstack([np.eye(p)] * len(poles)),
        "D": _short(D * to_u, to_u) if direct else None,
        "offset": {"y": _short(y0, scales.y_spread), "u": _short(scales.u, scales.u_spread)},
    }
    return spec, spread * scales.y_spread


def realised_static(windows: CompleteWindows, scales: Scales) -> tuple[dict[str, Any], np.ndarray]:
    """Return (arguments of a LinearSystem without states, spread) by least squares of single samples."""
    theta = regression.least_squares(windows, 0, True)
    _, _, D, c = regression.arx_coefficients(theta, 0, True, windows.u.shape[2], windows.y.shape[2])
    left = windows.y[:, 0] - windows.u[:, 0] @ np.asarray(D).T - np.asarray(c)
    to_u = scales.y_spread[:, None] / scales.u_spread[None]
    y0 = scales.y + np.asarray(c) * scales.y_spread
    spec = {
        "A": None,
        "B": None,
        "C": None,
        "D": _short(np.asarray(D) * to_u, to_u),
        "offset": {"y": _short(y0, scales.y_spread), "u": _short(scales.u, scales.u_spread)},
    }
    return spec, np.maximum(np.sqrt((left**2).mean(0)), 1e-9) * scales.y_spread


def _short(x: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return numbers rounded to DIGITS decimals behind the leading one of the size that they could have."""
    places = DIGITS - np.floor(np.log10(size)).astype(int)
    rounded = [float(f"{round(v, int(k)):.15g}") for v, k in np.broadcast(x, places)]
    return np.array(rounded).reshape(np.shape(x))
