"""Sensor tolerances that keep one value over a window: search the gains, keep the exact strips for everything else.

A reading is y = (1 + theta_i) t + delta, theta_i the same in all samples of output i, so the set of explanations is no zonotope. But
for given gains g_i = 1 / (1 + theta_i) it is one, whose strips are linear in g: per circuit h (with k on the inputs)

    |sum_i g_i a_i - b| <= sum_i g_i e_i,    a_i = sum_j h_ij d_ij,  e_i = sum_j |h_ij| rho_i,  b = k v,    d = y - offset      (strip)

Disturbances are rows with the gain 1. A box of gains is narrowed by every strip to where it can hold; nothing left proves FAULT, a point
that keeps all strips proves CONSISTENT, and what is neither is cut in two: one list of boxes of p gains for all windows of a recording.

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999; narrowing by linear inequalities: Davis 1987.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import WindowTest
from jaxbound.consistency.reading import gather
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Verdicts, explore

__all__ = ["ConstantTest"]

BLOCK = 2**11
ROUNDS = 2  # of narrowing a box of gains by all strips
HALVINGS = 8  # of the search for the margin
DEPTH = 64  # cuts of a box of gains
BOXES = 2000  # at most for a window that the first box leaves open
OPEN = 4  # beside the Status of a window: to be searched on


class ConstantTest(WindowTest):
    """Searches for gains, the same in all samples of a window, that explain it: FAULT and CONSISTENT are proofs.

    The sign of the margin is that of the verdict, its size that of the best gains found: 1 - t, t not below the true factor, but seldom
    30 % above it.

    Raises:
        NotImplementedError: relations that are too many to be tested one by one.
    """

    block = BLOCK

    def __init__(self, relations: Any, method: str, dtype: Any) -> None:
        super().__init__(relations, method, dtype)
        if method == "joint" and relations.frame is not None:
            raise NotImplementedError(
                f"horizon {relations.horizon} is too long for constant_tolerance, whose relations are tested one by one: choose a shorter "
                "one, or leave constant_tolerance out (wider bounds, that still give no false alarm)"
            )

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (status, margin, open) of windows, each by one box of gains."""
        said = ((np.asarray(status), margin) for status, margin in run(_first, blocks))
        return [(status, margin, status == OPEN) for status, margin in said]

    def settle(self, u: np.ndarray, y: np.ndarray, outs: list, left: np.ndarray, again: Callable, progress: Callable) -> None:
        """Cut the box of gains of those windows that it does not decide as a whole."""
        if len(left):
            status, margin = outs
            at = left + self.horizon
            status[at] = self._search(u, y, left)
            margin[at] = np.where(status[at] == Status.UNDECIDED, 0, _signed(margin[at], status[at] == Status.CONSISTENT))

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise NotImplementedError("margins has no fast path for constant_tolerance, whose gains are searched for: use detect(...).margin")

    def _search(self, u, y, starts):
        """Return the status of windows that one box of gains does not decide."""
        test, given = self.reading, gather(u, y, starts, self.lags, self.horizon)
        count = power(max(len(starts), 128))
        fill = lambda x: np.concatenate([x, np.repeat(x[..., :1], count - len(starts), -1)], -1)
        windows, on_device = jax.device_put((tuple(map(fill, given)), test))
        lo, hi = (np.asarray(x) for x in _gains(test, np)[:2])
        judge = partial(_boxes, on_device, *windows)
        found = explore(judge, lo, hi, len(starts), DEPTH, BOXES, "kernel", first=True, sizes=(2**10,))
        status = np.where(np.bincount(found.owner, minlength=len(starts)) == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
        status[found.proofs[2]] = Status.CONSISTENT
        missing = np.isnan(given[0]).any((0, 1)) if given[0].size else np.zeros(len(starts), bool)
        return np.where((status == Status.CONSISTENT) & missing, np.int8(Status.UNDECIDED), status)


def _gains(test, xp):
    """Return (lo, hi, inner_lo, inner_hi): a box of gains that holds [1 / (1 + sigma), 1 / (1 - sigma)], and one inside it that holds 1."""
    u4 = 4 * rounding.unit(test.noise.dtype)
    low, high = 1 / (1 + test.tolerance), 1 / (1 - test.tolerance)
    fixed = test.tolerance == 0
    ends = (xp.where(fixed, 1, low * (1 - u4)), xp.where(fixed, 1, high * (1 + u4)))
    inner = (xp.minimum(low * (1 + u4), 1), xp.maximum(high * (1 - u4), 1))
    one = xp.ones(min(1, len(test.disturbance)), test.noise.dtype)  # the gain of disturbances
    return tuple(xp.concatenate([x.astype(one.dtype), one]) for x in (*ends, *inner))


@jax.jit
def _first(test, u, y):
    """Return (status or OPEN, margin) of windows u (lags, m, N), y (s + 1, p, N)."""
    rows, silent = _rows(test, u, y)
    lo, hi = ([jnp.broadcast_to(x, y.shape[2:]) for x in end] for end in _gains(test, jnp)[:2])
    out, fits, present, _, _, point, _ = _judge(test, rows, lo, hi)
    status = jnp.where(out, Status.FAULT, jnp.where(fits, jnp.where(silent, Status.UNDECIDED, Status.CONSISTENT), OPEN))
    margin = 1 - _factor(test, rows, point)
    margin = jnp.where(status == OPEN, margin, _signed(margin, fits))
    return jnp.where(present, status, Status.MISSING).astype(jnp.int8), jnp.where(present, margin, jnp.nan)


def _signed(margin, inside):
    """Give a margin the sign that was proved."""
    least = 1e-6
    return np.where(inside, np.maximum(margin, least), np.minimum(margin, -least)) if isinstance(margin, np.ndarray) else jnp.where(
        inside, jnp.maximum(margin, least), jnp.minimum(margin, -least))  # fmt: skip


@jax.jit
def _boxes(test, u, y, lo, hi, owner):
    """Return the Verdicts on boxes of gains (p, N), of windows `owner`."""
    rows, _ = _rows(test, u[..., owner], y[..., owner])
    out, fits, _, lo, hi, point, axis = _judge(test, rows, list(lo), list(hi))
    return Verdicts(~out & ~fits, fits & ~out, (jnp.stack(point),) * 2, (jnp.stack(lo), jnp.stack(hi)), axis)


def _rows(test, u, y):
    """Return (d, rho and their magnitudes, a row each; whether a missing input silences a circuit)."""
    readings = dataclasses.replace(test, tolerance=jnp.zeros_like(test.tolerance))
    rows = readings.rows(list(map(list, u)), list(map(list, y)))
    return tuple(jnp.stack(x) if x else x for x in rows), test.silenced(rows[3])


def _fold(test, rows, step, carry, times=1):
    """Run `step` over (a, e, b, magnitude) of all circuits, so many times."""
    body = lambda carry, circuit: (step(carry, _strip(test, rows, *circuit)), None)
    circuits = [jnp.concatenate([x] * times) for x in (test.shape.rows, test.shape.h, test.shape.k)]
    return jax.lax.scan(body, carry, circuits)[0]


def _strip(test, rows, support, h, k) -> tuple:
    """Return (a, e, b, magnitude) of one circuit: a and e one entry a gain; magnitude is NaN where a sample is absent."""
    mid, rad, scale, known, known_scale = rows
    p, outputs = len(test.noise), len(test.noise) * (test.horizon + 1)
    gains = p + min(1, len(test.disturbance))
    a: list[Any] = [0.0] * gains
    e: list[Any] = [0.0] * gains
    b: Any = 0.0
    magnitude: Any = 0.0
    for x, i in zip(h, support, strict=True):
        mine = jnp.where(i < outputs, i % p, p)
        for g in range(gains):
            share = jnp.where(mine == g, x, 0)
            a[g] += share * mid[i]
            e[g] += jnp.abs(share) * rad[i]
        magnitude += jnp.abs(x) * scale[i]
    for j in range(len(known)):  # a missing value counts only where it is used
        b += jnp.where(k[j] == 0, 0, k[j] * known[j])
        magnitude += jnp.where(k[j] == 0, 0, jnp.abs(k[j]) * known_scale[j])
    like = jnp.zeros_like(magnitude)
    return [x + like for x in a], [x + like for x in e], b + like, magnitude


def _slack(test, magnitude):
    """Return what rounding may change in one side of a strip, for any gains that count, and where that is small enough to compare.

    A strip here has no more roundings than in `rounding.residual_error`, with the row g d for m: 3 u g (|y| + |offset|) instead of
    5 u (1 + sigma) (..), then the coefficient, the product and the sum. Narrowing adds the sum over gains, a difference and a quotient;
    the factor 2 covers them for up to as many gains as terms.
    """
    terms = test.shape.h.shape[1] + test.shape.k.shape[1] + len(test.noise)
    gamma, floor = rounding.residual_error(terms, magnitude.dtype)
    most = jnp.max(_gains(test, jnp)[1])
    usable = magnitude < np.asarray(2.0 ** (np.finfo(magnitude.dtype).maxexp // 2), magnitude.dtype)
    slack = 2 * (gamma * most * magnitude + floor * (1 + jnp.max(jnp.abs(test.shape.h))) * (1 + most))
    return jnp.where(usable, slack, 0), usable


def _judge(test, rows, lo, hi):
    """Judge one box of gains for each window: (out, fits, present, lo, hi, point, axis).

    out: proved that no gains of the box keep all strips. fits: the gains `point`, within the tolerance, are proved to keep them. present:
    some circuit has all its data. lo, hi: the box without parts where a strip fails. axis: the gain that moves the strips most.
    """

    def narrow(carry, strip):
        lo, hi, out = carry
        a, e, b, magnitude = strip
        slack, usable = _slack(test, magnitude)
        sides = ([x + y for x, y in zip(a, e, strict=True)], b - slack), ([y - x for x, y in zip(a, e, strict=True)], -b - slack)
        for slope, least in sides:
            slope = [jnp.where(usable, x, 0) for x in slope]
            lo, hi, missed = _narrowed(lo, hi, slope, jnp.where(usable, least, -1))
            out = out | missed
        return lo, hi, out

    def keeps(carry, strip):
        fits, present, lean = carry
        a, e, b, magnitude = strip
        slack, usable = _slack(test, magnitude)
        inside = jnp.abs(_dot(point, a) - b) + slack <= _dot(point, e)
        lean = [jnp.maximum(x, jnp.where(usable, jnp.abs(y), 0)) for x, y in zip(lean, a, strict=True)]
        absent = jnp.isnan(magnitude)
        return fits & (inside & usable | absent), present | ~absent, lean

    none = jnp.zeros_like(lo[0], bool)
    lo, hi, out = _fold(test, rows, narrow, (lo, hi, none), ROUNDS)
    for low, high in zip(lo, hi, strict=True):
        out |= low > high
    inner = _gains(test, jnp)[2:]
    point = [jnp.clip(0.5 * low + 0.5 * high, *ends) for low, high, *ends in zip(lo, hi, *inner, strict=True)]
    fits, present, lean = _fold(test, rows, keeps, (~out, none, [jnp.zeros_like(x) for x in lo]))
    effect = jnp.stack([x * (high - low) for x, low, high in zip(lean, lo, hi, strict=True)])
    return out, fits, present, lo, hi, point, jnp.argmax(effect, 0)


def _dot(x, y):
    return sum(a * b for a, b in zip(x, y, strict=True))


def _narrowed(lo, hi, slope, least):
    """Return the box without parts where sum_i g_i slope_i < least, and whether nothing is left."""
    most = [jnp.maximum(low * x, high * x) for low, high, x in zip(lo, hi, slope, strict=True)]
    total = sum(most)
    below, above = [], []
    for low, high, x, part in zip(lo, hi, slope, most, strict=True):
        edge = (least - (total - part)) / jnp.where(x == 0, 1, x)
        down, up = rounding.outward(edge, edge)
        below.append(jnp.where(x > 0, jnp.maximum(low, down), low))
        above.append(jnp.where(x < 0, jnp.minimum(high, up), high))
    return below, above, total < least


def _factor(test, rows, guess):
    """Return t, the factor on all bounds at which the best gains found explain a window; not rounded.

    Bisection between a factor that some gains reach and one that is taken to be too small: where narrowing the gains by it leaves
    nothing, or the middle of what it leaves does not reach it.
    """
    sigma = [*test.tolerance, *[jnp.zeros_like(test.noise[0])] * min(1, len(test.disturbance))]
    needs = lambda g, strip: jnp.abs(_dot(g, strip[0]) - strip[2]) / _dot(g, strip[1])

    def factor(g):
        own = jnp.zeros_like(g[0])
        for x, s in zip(g, sigma, strict=True):
            own = jnp.maximum(own, jnp.where(s > 0, jnp.abs(1 / x - 1) / jnp.where(s > 0, s, 1), 0))
        return _fold(test, rows, lambda t, strip: jnp.maximum(t, jnp.where(jnp.isnan(strip[3]), 0, needs(g, strip))), own)

    def halve(i, bracket):
        low, high, t, middle, empty = bracket
        new = factor(middle)
        better = (new < high) & ~empty
        high = jnp.where(better, new, high)
        low = jnp.where(i == 0, high / 32, jnp.where(better & (new <= t), low, t))
        t = jnp.sqrt(low * high)
        lo = [1 / (1 + t * s) for s in sigma]
        hi = [1 / jnp.maximum(1 - t * s, 1e-3) for s in sigma]

        def narrow(carry, strip):
            a, e, b, magnitude = strip
            lo, hi, empty = carry
            present = ~jnp.isnan(magnitude)
            for sign in (1, -1):
                slope = [jnp.where(present, t * y + sign * x, 0) for x, y in zip(a, e, strict=True)]
                lo, hi, missed = _narrowed(lo, hi, slope, jnp.where(present, sign * b, -1))
                empty = empty | missed
            return lo, hi, empty

        lo, hi, empty = _fold(test, rows, narrow, (lo, hi, jnp.zeros_like(empty)))
        return low, high, t, [0.5 * x + 0.5 * y for x, y in zip(lo, hi, strict=True)], empty

    nothing = jnp.zeros_like(guess[0])
    start = nothing, nothing + jnp.inf, nothing, guess, nothing > 0
    return jax.lax.fori_loop(0, HALVINGS + 1, halve, start)[1]
