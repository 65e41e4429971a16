"""Sensor tolerances that keep one value over a window: search the gains, keep the exact strips for everything
else.

A reading is y = (1 + theta_i) t + delta, theta_i the same in all samples of output i, so the set of
explanations is no zonotope. But for given gains g_i = 1 / (1 + theta_i) it is one, whose strips are linear in
g: per circuit h (with k on the inputs)

    |sum_i g_i a_i - b| <= sum_i g_i e_i,  a_i = sum_j h_ij d_ij,  e_i = sum_j |h_ij| rho_i,
    b = k v,  d = y - offset                                                          (strip)

Disturbances are rows with the gain 1. A box of gains is narrowed by every strip to where it can hold; nothing
left proves FAULT, a point that keeps all strips proves CONSISTENT, and what is neither is cut in two: one
list of boxes of p gains for all windows of a recording.

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999; narrowing by linear
inequalities: Davis 1987.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from types import ModuleType
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.covers import status_of_cover
from jaxbound.consistency.interface import Again, Arrays, LinearTest, Outs, Progress, Run
from jaxbound.consistency.reading import Block, Reading, RowValues, Samples, gather
from jaxbound.consistency.strips_on_host import HostStrips, host_strips
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Verdicts, explore

__all__ = ["ConstantTest", "GainBounds", "gain_bounds", "gain_tolerance", "narrowed", "own_factor", "signed"]

BLOCK = 2**9
HELD = 2**26  # bytes of strips at most that a block keeps
ROUNDS = 2  # of narrowing a box of gains by all strips
HALVINGS = 8  # of the search for the margin
DEPTH = 64  # cuts of a box of gains
BOXES = 2000  # at most for a window that the first box leaves open
OPEN = 4  # beside the Status of a window: to be searched on
LEAST = 1e-6
"""The least size of a margin whose sign is proved."""
Carry = TypeVar("Carry")
Sums: TypeAlias = tuple[jax.Array, ...]
Triple: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]


class ConstantTest(LinearTest):
    """Searches for gains, the same in all samples of a window, that explain it: FAULT and CONSISTENT are
    proofs.

    The sign of the margin is that of the verdict, its size that of the best gains found: 1 - t, t not below
    the true factor, but seldom 30 % above it.
    """

    @property
    def block(self) -> int:
        """How many windows are judged at once: fewer where there are many strips, all of which are kept for a
        block.
        """
        entries = len(self.reading.strips.h) * 2 * (len(self.reading.noise) + 2)
        fitting = int(2 ** int(np.log2(HELD / (entries * self.dtype.itemsize))))
        return min(BLOCK, max(2**5, fitting))

    @property
    def short(self) -> int:  # type: ignore[override]  # nobody sets it, here least of all
        """How many windows are judged at once where there are few: another size, other bits."""
        return self.block

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (status, margin, open) of windows, each by one box of gains."""
        judged = []
        for status, margin in run(_first, blocks):
            judged.append((status, margin, np.asarray(status) == OPEN))
        return judged

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, again: Again, progress: Progress
    ) -> None:
        """Cut the box of gains of those windows that it does not decide as a whole."""
        if not len(left):
            return
        status, margin = outs
        at = left + self.horizon
        now = self._search(u, y, left)
        status[at] = now
        margin[at] = np.where(now == Status.UNDECIDED, 0, signed(margin[at], now == Status.CONSISTENT))

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows one strip contradicts whatever the gains, in NumPy; see
        `WindowTest.contradicted`.
        """
        return np.asarray(self._host.contradicted(u, y, starts).any(0))

    @cached_property
    def _host(self) -> HostStrips:
        r = self.relations
        reading = r.reading(np.float64, self.method)
        return host_strips(reading, *r.strips(self.method), constant=True)

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise NotImplementedError(
            "margins has no fast path for constant_tolerance, whose gains are searched for: use "
            "detect(...).margin"
        )

    def _search(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return the status of windows that one box of gains does not decide."""
        test, count = self.reading, len(starts)
        samples = gather(u, y, starts, self.lags, self.horizon)
        on_device = jax.device_put(test)
        bounds = gain_bounds(test, np)

        def judge(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[jax.Array]:
            of_boxes = (x[..., owner] for x in samples)  # any number of windows compiles once
            verdicts: Verdicts[jax.Array] = _boxes(on_device, *of_boxes, lo, hi)
            return verdicts

        sizes = (min(2**10, self.block),)
        lo, hi = np.asarray(bounds.lo), np.asarray(bounds.hi)
        cover = explore(judge, lo, hi, count, DEPTH, BOXES, "kernel", first=True, sizes=sizes)
        status = status_of_cover(cover, count)
        missing = np.isnan(samples[0]).any((0, 1))
        status[missing & (status == Status.CONSISTENT)] = Status.UNDECIDED
        return status


class GainBounds(NamedTuple):
    """Boxes of gains (g,): lo, hi holds [1 / (1 + sigma), 1 / (1 - sigma)]; inner_lo, inner_hi lies inside it
    and holds 1.
    """

    lo: jax.Array
    hi: jax.Array
    inner_lo: jax.Array
    inner_hi: jax.Array


def gain_bounds(reading: Reading, xp: ModuleType) -> GainBounds:
    """Return the boxes of gains of a test; xp: NumPy, or jax.numpy inside a kernel."""
    u4 = 4 * rounding.unit(reading.noise.dtype)
    low, high = 1 / (1 + reading.tolerance), 1 / (1 - reading.tolerance)
    fixed = reading.tolerance == 0
    ends = (xp.where(fixed, 1, low * (1 - u4)), xp.where(fixed, 1, high * (1 + u4)))
    inner = (xp.minimum(low * (1 + u4), 1), xp.maximum(high * (1 - u4), 1))
    one = xp.ones(min(1, len(reading.disturbance)), reading.noise.dtype)  # the gain of disturbances
    return GainBounds(*(xp.concatenate([x.astype(one.dtype), one]) for x in (*ends, *inner)))


@kernel
def _first(reading: Reading, u: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return (status or OPEN, margin) of windows u (lags, m, N), y (s + 1, p, N)."""
    strips, silent = _strips(reading, u, y)
    lo, hi = (jnp.repeat(end[:, None], y.shape[2], 1) for end in gain_bounds(reading, jnp)[:2])
    box = _judge(reading, strips, lo, hi)
    held = jnp.where(silent, Status.UNDECIDED, Status.CONSISTENT)
    status = jnp.where(box.out, Status.FAULT, jnp.where(box.fits, held, OPEN))
    margin = 1 - _factor(reading, strips, box.point)
    margin = jnp.where(status == OPEN, margin, signed(margin, box.fits))
    status = jnp.where(box.present, status, Status.MISSING).astype(jnp.int8)
    return status, jnp.where(box.present, margin, jnp.nan)


def signed(margin: Samples, inside: Samples) -> Samples:
    """Give a margin the sign that was proved."""
    if isinstance(margin, np.ndarray):
        return np.asarray(np.where(inside, np.maximum(margin, LEAST), np.minimum(margin, -LEAST)))
    return jnp.where(inside, jnp.maximum(margin, LEAST), jnp.minimum(margin, -LEAST))


@kernel
def _boxes(reading: Reading, u: jax.Array, y: jax.Array, lo: jax.Array, hi: jax.Array) -> Verdicts[jax.Array]:
    """Return the Verdicts on boxes of gains (p, N), each of its window u (lags, m, N), y (s + 1, p, N)."""
    strips, _ = _strips(reading, u, y)
    box = _judge(reading, strips, lo, hi)
    out, fits = box.out, box.fits
    return Verdicts(~out & ~fits, fits & ~out, (box.point, box.point), (box.lo, box.hi), box.axis)


class _Strip(NamedTuple):
    """One circuit over N windows, or all of them with one axis more in front.

    Fields: a, e (g, N), an entry a gain; b (N,); slack (N,), what rounding may change in one side; usable
    (N,), where that is small enough to compare; absent (N,), where a sample is missing.
    """

    a: jax.Array
    e: jax.Array
    b: jax.Array
    slack: jax.Array
    usable: jax.Array
    absent: jax.Array


def _strips(reading: Reading, u: jax.Array, y: jax.Array) -> tuple[_Strip, jax.Array]:
    """Return (strips of all circuits, whether a missing input silences one) of windows u (lags, m, N), y (s +
    1, p, N).
    """
    rows = dataclasses.replace(reading, tolerance=jnp.zeros_like(reading.tolerance)).block(u, y)

    def strip_of(circuit: Triple) -> _Strip:
        return _strip(reading, rows, *circuit)

    strips: _Strip = jax.lax.map(strip_of, (reading.strips.rows, reading.strips.h, reading.strips.k))
    return strips, reading.silenced(rows.known)


def _strip(
    reading: Reading, rows: RowValues[jax.Array], support: jax.Array, h: jax.Array, k: jax.Array
) -> _Strip:
    """Return the strip of one circuit; sums are loops, so that what compiles is small whatever the
    horizon.
    """
    mid, rad, scale, inputs, input_scale = rows
    p, outputs, windows = len(reading.noise), len(reading.noise) * (reading.horizon + 1), mid.shape[1]
    gains = p + min(1, len(reading.disturbance))
    gain = jnp.where(support < outputs, support % p, p)

    def term(j: jax.Array, total: Sums) -> Sums:
        a, e, magnitude = total
        i, share = support[j], jnp.where(jnp.arange(gains) == gain[j], h[j], 0)[:, None]
        return (
            a + share * mid[i][None],
            e + jnp.abs(share) * rad[i][None],
            magnitude + jnp.abs(h[j]) * scale[i],
        )

    def reach(j: jax.Array, total: Sums) -> Sums:
        def counted(x: jax.Array) -> jax.Array:  # a missing value counts only where it is used
            return jnp.where(k[j] == 0, 0, x)

        b, magnitude = total
        return b + counted(k[j] * inputs[j]), magnitude + counted(jnp.abs(k[j]) * input_scale[j])

    none = jnp.zeros((gains, windows), mid.dtype)
    a, e, magnitude = jax.lax.fori_loop(0, len(h), term, (none, none, none[0]))
    b = none[0]
    if len(k):
        b, magnitude = jax.lax.fori_loop(0, len(k), reach, (b, magnitude))
    slack, usable = _slack(reading, magnitude)
    return _Strip(a, e, b, slack, usable, jnp.isnan(magnitude))


def _slack(reading: Reading, magnitude: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Bound the rounding of one side of a strip, for any gains that count; return (it, where it is small
    enough to compare).

    A strip here has no more roundings than in `rounding.residual_error`, with the row g d for m: 3 u g (|y| +
    |offset|) instead of 5 u (1 + sigma) (..), then the coefficient, the product and the sum. Narrowing adds
    the sum over gains, a difference and a quotient; the factor 2 covers them for up to as many gains as
    terms.
    """
    strips = reading.strips
    terms = strips.h.shape[1] + strips.k.shape[1] + len(reading.noise)
    gamma, floor = rounding.residual_error(terms, magnitude.dtype)
    most = jnp.max(gain_bounds(reading, jnp).hi)
    usable = magnitude < np.asarray(2.0 ** (np.finfo(magnitude.dtype).maxexp // 2), magnitude.dtype)
    slack = 2 * (gamma * most * magnitude + floor * (1 + jnp.max(jnp.abs(strips.h))) * (1 + most))
    return jnp.where(usable, slack, 0), usable


def _fold(step: Callable[[Carry, _Strip], Carry], carry: Carry, strips: _Strip) -> Carry:
    """Run `step` over all circuits."""
    last: Carry = jax.lax.scan(lambda carry, strip: (step(carry, strip), None), carry, strips)[0]
    return last


class _Judgement(NamedTuple):
    """One box of gains (g, N) for each window.

    Fields: out: proved that no gains of the box keep all strips; fits: the gains `point`, within the
    tolerance, are proved to keep them; present: some circuit has all its data; lo, hi: the box without parts
    where a strip fails; axis: the gain that moves the strips most.
    """

    out: jax.Array
    fits: jax.Array
    present: jax.Array
    lo: jax.Array
    hi: jax.Array
    point: jax.Array
    axis: jax.Array


def _judge(reading: Reading, strips: _Strip, lo: jax.Array, hi: jax.Array) -> _Judgement:
    """Judge one box of gains (g, N) for each window."""

    def narrow(carry: Triple, strip: _Strip) -> Triple:
        lo, hi, out = carry
        usable = strip.usable
        for slope, least in (
            (strip.a + strip.e, strip.b - strip.slack),
            (strip.e - strip.a, -strip.b - strip.slack),
        ):
            lo, hi, missed = narrowed(lo, hi, jnp.where(usable[None], slope, 0), jnp.where(usable, least, -1))
            out = out | missed
        return lo, hi, out

    def keeps(carry: Triple, strip: _Strip) -> Triple:
        fits, present, lean = carry
        inside = jnp.abs(_dot(point, strip.a) - strip.b) + strip.slack <= _dot(point, strip.e)
        lean = jnp.maximum(lean, jnp.where(strip.usable[None], jnp.abs(strip.a), 0))
        return fits & (inside & strip.usable | strip.absent), present | ~strip.absent, lean

    none = jnp.zeros(lo.shape[1:], bool)
    lo, hi, out = jax.lax.fori_loop(0, ROUNDS, lambda _, carry: _fold(narrow, carry, strips), (lo, hi, none))
    out |= jnp.any(lo > hi, 0)
    point = jnp.clip(0.5 * lo + 0.5 * hi, *(x[:, None] for x in gain_bounds(reading, jnp)[2:]))
    fits, present, lean = _fold(keeps, (~out, none, jnp.zeros_like(lo)), strips)
    return _Judgement(out, fits, present, lo, hi, point, jnp.argmax(lean * (hi - lo), 0))


def _dot(x: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.sum(x * y, 0)


def narrowed(
    lo: jax.Array, hi: jax.Array, slope: jax.Array, least: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the box without parts where sum_i g_i slope_i < least, and whether nothing is left."""
    most = jnp.maximum(lo * slope, hi * slope)
    total = jnp.sum(most, 0)
    edge = (least[None] - (total[None] - most)) / jnp.where(slope == 0, 1, slope)
    down, up = rounding.outward(edge, edge)
    below = jnp.where(slope > 0, jnp.maximum(lo, down), lo)
    above = jnp.where(slope < 0, jnp.minimum(hi, up), hi)
    return below, above, total < least


def _factor(reading: Reading, strips: _Strip, guess: jax.Array) -> jax.Array:
    """Return t, the factor on all bounds at which the best gains found explain a window; not rounded.

    Bisection between a factor that some gains reach and one that is taken to be too small: where narrowing
    the gains by it leaves nothing, or the middle of what it leaves does not reach it.
    """
    sigma = gain_tolerance(reading)

    def factor(g: jax.Array) -> jax.Array:
        own = own_factor(g, sigma)

        def worst(t: jax.Array, strip: _Strip) -> jax.Array:
            needs = jnp.abs(_dot(g, strip.a) - strip.b) / _dot(g, strip.e)
            return jnp.maximum(t, jnp.where(strip.absent, 0, needs))

        return _fold(worst, own, strips)

    def halve(i: jax.Array, bracket: Sums) -> Sums:
        low, high, t, middle, empty = bracket
        new = factor(middle)
        better = (new < high) & ~empty
        high = jnp.where(better, new, high)
        low = jnp.where(i == 0, high / 32, jnp.where(better & (new <= t), low, t))
        t = jnp.sqrt(low * high)

        def narrow(carry: Triple, strip: _Strip) -> Triple:
            lo, hi, empty = carry
            for sign in (1, -1):
                slope = jnp.where(strip.absent[None], 0, t[None] * strip.e + sign * strip.a)
                lo, hi, missed = narrowed(lo, hi, slope, jnp.where(strip.absent, -1, sign * strip.b))
                empty = empty | missed
            return lo, hi, empty

        start = 1 / (1 + t[None] * sigma), 1 / jnp.maximum(1 - t[None] * sigma, 1e-3)
        lo, hi, empty = _fold(narrow, (*start, jnp.zeros_like(empty)), strips)
        return low, high, t, 0.5 * lo + 0.5 * hi, empty

    nothing = jnp.zeros_like(guess[0])
    start = nothing, nothing + jnp.inf, nothing, guess, nothing > 0
    best: jax.Array = jax.lax.fori_loop(0, HALVINGS + 1, halve, start)[1]
    return best


def gain_tolerance(reading: Reading) -> jax.Array:
    """Return sigma (g, 1) of each gain, 0 for that of disturbances."""
    none = jnp.zeros_like(reading.noise, shape=min(1, len(reading.disturbance)))
    return jnp.concatenate([reading.tolerance, none])[:, None]


def own_factor(g: jax.Array, sigma: jax.Array) -> jax.Array:
    """Return the factor on tolerances at which gains g (g, N) are within them."""
    return jnp.max(jnp.where(sigma > 0, jnp.abs(1 / g - 1) / jnp.where(sigma > 0, sigma, 1), 0), 0)
