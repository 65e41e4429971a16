"""The paper's own test: pave the space of the unknowns theta and delta of a window.

Sound and slow; the exact joint test replaces it. Kept because it is the method of Adrot, Maquin, Ragot 2000,
section 4, and because it converges from outside to what the joint test computes.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Budget, LinearRelations, Open, WindowTest
from jaxbound.consistency.strips_on_host import host_strips
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.models.window import input_lags
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.intervals.interval import Interval, interval, matmul, sub
from jaxbound.sets.paving.paving import reaches

__all__ = ["PavingTest", "internal_form", "whole_windows"]

BUDGET = 3, 100_000
"""(q, boxes a window) of a paving where nothing else is asked."""


def internal_form(
    z: Any,
    y_lo: Any,
    y_hi: Any,
    tolerance: Any,
    rho: Any,
    W_lo: Any,
    W_hi: Any,
    w_lo: Any = (),
    w_hi: Any = (),
) -> Any:
    """Enclose p_int = W (mu, -w), mu = (theta y + rho delta) / (1 + theta), w = (w_hi + w_lo + (w_hi - w_lo)
    omega) / 2.

    z = (theta / tolerance, delta, omega) in [-1, 1]; `tolerance` has an entry a row, or one an output if
    theta is the same in all its rows. Source: (9); a disturbance w enters the relations as it is.
    """
    rows, shared = y_lo.shape[0], tolerance.shape[0]
    theta = z[:shared] * interval(tolerance)
    theta = Interval(*(jnp.tile(end, rows // shared) for end in (theta.lo, theta.hi)))
    mu = (theta * Interval(y_lo, y_hi) + interval(rho) * z[shared : shared + rows]) / (1 + theta)
    if len(w_lo):
        lo, hi = interval(w_lo), interval(w_hi)
        w = -0.5 * (hi + lo + (hi - lo) * z[shared + rows :])
        mu = Interval(*(jnp.concatenate(ends) for ends in ((mu.lo, w.lo), (mu.hi, w.hi))))
    return matmul(Interval(W_lo, W_hi), mu)


class PavingTest(WindowTest):
    """Paves the unknowns of each window: FAULT is a proof, anything else UNDECIDED. No gauge is measured, the
    margin is NaN.

    Args:
        budget: (q, boxes): stop at r > q - 1, and after so many boxes a window; None: `BUDGET`.
    """

    relations: LinearRelations

    padded = sharded = False
    block = short = 2**14

    def __init__(self, relations: LinearRelations, dtype: DTypeLike, budget: Budget = None) -> None:
        super().__init__(relations, "paving", dtype)
        self.q: float
        self.boxes: int
        if isinstance(budget, int):
            raise TypeError(f"the budget of the paving is a pair (q, boxes a window), not {budget}")
        self.q, self.boxes = BUDGET if budget is None else budget
        if self.boxes < 1:
            raise ValueError(f"the budget of the paving needs at least one box, not {self.boxes}")

    constants = None

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return input_lags(self.relations.model, self.horizon)

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> list:
        """Leave out windows with missing samples."""
        return whole_windows(self, u, y, starts)

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (status, margin) of windows."""
        windows = ([np.moveaxis(x, -1, 0) for x in block] for block in blocks)
        found = [_pave(self.relations, U, Y, self.q, self.boxes) for U, Y in windows]
        return [(status, np.full(len(status), np.nan, self.dtype)) for status in found]

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows one strip contradicts, in NumPy: what is excluded by boxes is by
        strips.
        """
        r = self.relations
        if r.frame is None:
            method, strips = "joint", (r.circuits, r.circuits_known)
        else:
            method, strips = "box", (r.W, r.K)
        host = host_strips(r.reading(np.float64, method), *strips, self.dtype, r.model.constant_tolerance)
        return np.asarray(host.contradicted(u, y, starts).any(0))


def whole_windows(test: WindowTest, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> list:
    """Return the cases of a test that takes whole windows alone: what is missing makes a window MISSING, what
    is infinite UNDECIDED.
    """
    lacking, endless = (
        _span(bad(u), starts, test.lags) | _span(bad(y), starts, test.horizon + 1)
        for bad in (np.isnan, np.isinf)
    )
    cases = [(test, starts[~lacking & ~endless]), (Open(test, np.nan), starts[endless])]
    return [(case, own) for case, own in cases if len(own)]


def _span(bad, starts, length):
    """Return whether any of so many samples from each of `starts` on is bad (T, channels)."""
    counted = np.concatenate([[0], np.cumsum(bad.any(1))])
    return counted[starts + length] > counted[starts]


def _pave(relations, U, Y, q, boxes):
    model, windows, dtype = relations.model, len(Y), Y.dtype
    count = power(max(windows, 128))
    U, Y = (np.concatenate([x, np.zeros((count - windows, *x.shape[1:]), dtype)]) for x in (U, Y))
    encloses = lambda exact: Interval(rounding.round_down(exact, dtype), rounding.round_up(exact, dtype))
    W, slip = encloses(relations.W), 2 * input_slip(U)  # 2: for the two differences
    given = (
        (Interval(Y, Y), encloses(model.offset["y"])),
        (Interval(U - slip, U + slip), encloses(model.offset["u"])),
    )
    flat, external = _external(given, W, encloses(relations.K))
    bounds = {k: rounding.round_up(relations.bounds[k], dtype) for k in ("tolerance", "noise")}
    largest = abs(Y).max(1) + bounds["noise"]
    rho = (
        bounds["noise"]
        + rounding.round_up(list(model.resolution), dtype)
        + (RECORDER_ULPS + 4) * rounding.unit(dtype) * largest
    )
    lo, hi = relations.bounds.get("disturbance", np.zeros((0, 2))).T
    w_lo, w_hi = (
        np.tile(x, relations.horizon) for x in (rounding.round_down(lo, dtype), rounding.round_up(hi, dtype))
    )
    rows = Y.shape[1]
    each = lambda x: np.broadcast_to(x, (count, *x.shape))
    tolerance = bounds["tolerance"] if model.constant_tolerance else np.tile(bounds["tolerance"], rows)
    args = (
        flat.lo,
        flat.hi,
        each(tolerance),
        np.tile(rho, rows),
        each(W.lo),
        each(W.hi),
        each(w_lo),
        each(w_hi),
    )
    edge = np.ones(len(tolerance) + flat.shape[1] + len(w_lo), dtype)
    filler = (np.arange(count) >= windows)[:, None]  # an empty target is excluded by the first box
    target = Interval(np.where(filler, np.inf, external.lo), np.where(filler, -np.inf, external.hi))
    return reaches(internal_form, Interval(-edge, edge), target, q, boxes, tuple(map(np.asarray, args)))[
        :windows
    ]


@kernel
def _external(given, W, K):
    """Return (measured (N, rows), p_ext (N, r)) of windows: their samples, offsets taken off, and what W and
    K make of them.
    """
    flat, known = (sub(samples, offset[None, None]) for samples, offset in given)
    flat, known = (
        jax.tree.map(lambda x: x.reshape(len(x), math.prod(x.shape[1:])), ends) for ends in (flat, known)
    )
    external = matmul(flat, Interval(W.lo.T[: flat.shape[1]], W.hi.T[: flat.shape[1]]))
    return flat, external - matmul(known, Interval(K.lo.T, K.hi.T)) if known.shape[1] else external
