"""The paper's own test: pave the space of the unknowns theta and delta of a window.

Sound and slow; the exact joint test replaces it. Kept because it is the method of Adrot, Maquin, Ragot 2000,
section 4, and because it converges from outside to what the joint test computes.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import (
    Arrays,
    Budget,
    Cases,
    LinearRelations,
    LinearTest,
    Open,
    Run,
    WindowTest,
)
from jaxbound.consistency.reading import Block
from jaxbound.consistency.strips_on_host import host_strips
from jaxbound.exact.linalg import Matrix
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.models.window import input_lags
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.intervals.interval import Interval, interval, matmul, sub
from jaxbound.sets.paving.paving import reaches

__all__ = ["BoxTest", "PavingTest", "internal_form", "span"]

BUDGET = 3, 100_000
"""(q, boxes a window) of a paving where nothing else is asked."""


Numbers: TypeAlias = jax.Array | np.ndarray


def internal_form(
    z: Interval,
    y_lo: Numbers,
    y_hi: Numbers,
    tolerance: Numbers,
    rho: Numbers,
    W_lo: Numbers,
    W_hi: Numbers,
    w_lo: Numbers | tuple[()] = (),
    w_hi: Numbers | tuple[()] = (),
) -> Interval:
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
        mu = Interval(jnp.concatenate((mu.lo, w.lo)), jnp.concatenate((mu.hi, w.hi)))
    return matmul(Interval(W_lo, W_hi), mu)


class BoxTest(WindowTest):
    """One way to decide whole windows, with every sample, by boxes of their unknowns; without a margin."""

    padded = sharded = False
    constants = None

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Leave out windows with missing samples."""
        return _whole_windows(self, u, y, starts)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin) of windows."""
        judged = []
        for u, y in blocks:
            status = self._judged(np.moveaxis(u, -1, 0), np.moveaxis(y, -1, 0))
            judged.append((status, np.full(len(status), np.nan, self.dtype)))
        return judged

    def _judged(self, U: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """Return the status of windows U (N, lags, m), Y (N, s + 1, p)."""
        raise NotImplementedError


class PavingTest(BoxTest, LinearTest):
    """Paves the unknowns of each window: FAULT is a proof, anything else UNDECIDED. No gauge is measured, the
    margin is NaN.

    Args:
        budget: (q, boxes): stop at r > q - 1, and after so many boxes a window; None: `BUDGET`.
    """

    block = short = 2**14

    def __init__(self, relations: LinearRelations, dtype: DTypeLike, budget: Budget = None) -> None:
        super().__init__(relations, "paving", dtype)
        self.q: int
        if isinstance(budget, int):
            raise TypeError(f"the budget of the paving is a pair (q, boxes a window), not {budget}")
        self.q, self.boxes = BUDGET if budget is None else budget
        if self.boxes < 1:
            raise ValueError(f"the budget of the paving needs at least one box, not {self.boxes}")

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return input_lags(self.relations.model, self.horizon)

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows one strip contradicts, in NumPy: what is excluded by boxes is by
        strips.
        """
        r = self.relations
        method = "joint" if r.frame is None else "box"
        reading, constant = r.reading(np.float64, method), r.model.constant_tolerance
        host = host_strips(reading, *r.strips(method), constant)
        return np.asarray(host.contradicted(u, y, starts).any(0))

    def _judged(self, U: np.ndarray, Y: np.ndarray) -> np.ndarray:
        """Return the status of windows U (N, lags, m), Y (N, s + 1, p), their number filled up to a power of
        two.
        """
        r, model, dtype = self.relations, self.relations.model, Y.dtype
        windows, count = len(Y), power(max(len(Y), 128))
        U, Y = _with_filler(U, count), _with_filler(Y, count)
        W, slip = _enclosed(r.W, dtype), 2 * input_slip(U)  # 2: for the two differences
        outputs = Interval(Y, Y), _enclosed(model.offset["y"], dtype)
        inputs = Interval(U - slip, U + slip), _enclosed(model.offset["u"], dtype)
        flat, external = _external((outputs, inputs), W, _enclosed(r.K, dtype))
        tolerance = rounding.round_up(r.bounds["tolerance"], dtype)
        noise = rounding.round_up(r.bounds["noise"], dtype)
        largest = abs(Y).max(1) + noise
        recorder = (RECORDER_ULPS + 4) * rounding.unit(dtype) * largest
        rho = noise + rounding.round_up(list(model.resolution), dtype) + recorder
        lo, hi = r.bounds.get("disturbance", np.zeros((0, 2))).T
        w_lo = np.tile(rounding.round_down(lo, dtype), r.horizon)
        w_hi = np.tile(rounding.round_up(hi, dtype), r.horizon)
        rows = Y.shape[1]
        if not model.constant_tolerance:
            tolerance = np.tile(tolerance, rows)
        of_all = [np.broadcast_to(x, (count, *x.shape)) for x in (tolerance, W.lo, W.hi, w_lo, w_hi)]
        args = flat.lo, flat.hi, of_all[0], np.tile(rho, rows), *of_all[1:]
        edge = np.ones(len(tolerance) + flat.shape[1] + len(w_lo), dtype)
        filler = (np.arange(count) >= windows)[:, None]  # an empty target is excluded by the first box
        target = Interval(np.where(filler, np.inf, external.lo), np.where(filler, -np.inf, external.hi))
        box = Interval(-edge, edge)
        status = reaches(internal_form, box, target, self.q, self.boxes, tuple(map(np.asarray, args)))
        return status[:windows]


def _whole_windows(test: WindowTest, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
    """Return the cases of a test that takes whole windows alone: what is missing makes a window MISSING, what
    is infinite UNDECIDED.
    """
    counted, lengths = (u, y), (test.lags, test.horizon + 1)
    lacking, endless = np.zeros(len(starts), bool), np.zeros(len(starts), bool)
    for x, length in zip(counted, lengths, strict=True):
        lacking |= span(np.isnan(x), starts, length)
        endless |= span(np.isinf(x), starts, length)
    cases = [(test, starts[~lacking & ~endless]), (Open(test, np.nan), starts[endless])]
    return [(case, own) for case, own in cases if len(own)]


def span(bad: np.ndarray, starts: np.ndarray, length: int) -> np.ndarray:
    """Return whether any of so many samples from each of `starts` on is bad (T, channels)."""
    counted = np.concatenate([[0], np.cumsum(bad.any(1))])
    return np.asarray(counted[starts + length] > counted[starts])


def _with_filler(x: np.ndarray, count: int) -> np.ndarray:
    """Return an array with zeros behind it, so that there are so many entries."""
    return np.concatenate([x, np.zeros((count - len(x), *x.shape[1:]), x.dtype)])


def _enclosed(exact: Matrix | Sequence[Fraction], dtype: DTypeLike) -> Interval:
    """Return exact numbers as an Interval of floats."""
    return Interval(rounding.round_down(exact, dtype), rounding.round_up(exact, dtype))


@kernel
def _external(
    given: tuple[tuple[Interval, Interval], tuple[Interval, Interval]], W: Interval, K: Interval
) -> tuple[Interval, Interval]:
    """Return (measured (N, rows), p_ext (N, r)) of windows: their samples without offsets, and their product
    with W and K.
    """
    measured, known = (sub(samples, offset[None, None]) for samples, offset in given)
    measured, known = _one_row_a_window(measured), _one_row_a_window(known)
    rows = measured.shape[1]
    external = matmul(measured, Interval(W.lo.T[:rows], W.hi.T[:rows]))
    if known.shape[1]:
        external = external - matmul(known, Interval(K.lo.T, K.hi.T))
    return measured, external


def _one_row_a_window(x: Interval) -> Interval:
    """Return samples (N, s + 1, channels) as (N, rows)."""
    shape = len(x.lo), math.prod(x.shape[1:])
    return Interval(x.lo.reshape(shape), x.hi.reshape(shape))
