"""The paper's own test: pave the space of the unknowns theta and delta of a window.

Sound and slow; the exact joint test replaces it. Kept because it is the method of Adrot, Maquin, Ragot 2000, section 4, and
because it converges from outside to what the joint test computes.
"""

import functools

import numpy as np

from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.window import input_lags
from jaxbound.sets import rounding
from jaxbound.sets.interval import Interval, add, interval, matmul
from jaxbound.sets.paving import pave
from jaxbound.sets.status import Status

__all__ = ["internal_form", "pave_windows"]


def internal_form(z, y_lo, y_hi, tolerance, rho, W_lo, W_hi):
    """Enclose p_int = W mu, mu = (theta y + rho delta) / (1 + theta), z = (theta / tolerance, delta) in [-1, 1]. Source: (9)."""
    rows = y_lo.shape[0]
    y, sigma, rho, W = Interval(y_lo, y_hi), interval(tolerance), interval(rho), Interval(W_lo, W_hi)
    mu = []
    for i in range(rows):
        theta, delta = z[i] * sigma[i], z[rows + i]
        mu.append((theta * y[i] + rho[i] * delta) / (1 + theta))
    return [functools.reduce(add, (W[r, i] * mu[i] for i in range(rows))) for r in range(W.shape[0])]


def pave_windows(relations, u, y, q, max_boxes, progress):
    """Return (status, margin) of all windows by adaptive paving; windows with NaN are MISSING. The margin is NaN: no gauge is measured."""
    model, s, dtype = relations.model, relations.horizon, y.dtype
    status = np.full(y.shape[:-1], Status.MISSING, np.int8)
    if y.shape[-2] > s:
        Y, U = (np.moveaxis(np.lib.stride_tricks.sliding_window_view(x, s + 1, -2), -1, -2) for x in (y, u))  # (..., N, s + 1, channels)
        U = U[..., : input_lags(model, s), :]
        usable = ~(np.isnan(Y).any((-1, -2)) | np.isnan(U).any((-1, -2)))
        found = np.zeros(usable.shape, np.int8)
        if usable.any():
            found[usable] = _pave(relations, U[usable], Y[usable], q, max_boxes, progress)
        status[..., s:] = found
    return status, np.full(status.shape, np.nan, dtype)


def _pave(relations, U, Y, q, max_boxes, progress):
    model, windows, dtype = relations.model, len(Y), Y.dtype
    count = 2 ** max(windows - 1, 127).bit_length()  # powers of two, so that few sizes compile
    U, Y = (np.concatenate([x, np.zeros((count - windows, *x.shape[1:]), dtype)]) for x in (U, Y))
    encloses = lambda exact: interval(rounding.round_down(exact, dtype), rounding.round_up(exact, dtype))
    W = encloses(relations.W)
    flat = interval(Y) - encloses(model.offset["y"])[None, None]
    flat = Interval(flat.lo.reshape(count, -1), flat.hi.reshape(count, -1))
    external = matmul(flat, Interval(W.lo.T, W.hi.T))
    if model.m and U.shape[1]:
        known = interval(U) - encloses(model.offset["u"])[None, None]
        K = encloses(relations.K)
        external = external - matmul(Interval(known.lo.reshape(count, -1), known.hi.reshape(count, -1)), Interval(K.lo.T, K.hi.T))
    bounds = {k: rounding.round_up(v, dtype) for k, v in relations.bounds.items()}
    largest = abs(Y).max(1) + bounds["noise"]
    rho = bounds["noise"] + rounding.round_up(list(model.resolution), dtype) + (RECORDER_ULPS + 4) * rounding.unit(dtype) * largest
    rows = Y.shape[1]
    each = lambda x: np.broadcast_to(x, (count, *x.shape))
    args = (flat.lo, flat.hi, each(np.tile(bounds["tolerance"], rows)), np.tile(rho, rows), each(W.lo), each(W.hi))
    edge = np.ones(2 * flat.shape[1], dtype)
    filler = (np.arange(count) >= windows)[:, None]  # an empty target is excluded by the first box
    target = Interval(np.where(filler, np.inf, external.lo), np.where(filler, -np.inf, external.hi))
    budget = max_boxes + count - windows
    return pave(internal_form, interval(-edge, edge), target, q=q, max_boxes=budget, args=args, progress=progress).status[:windows]
