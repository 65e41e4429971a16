"""Sensor tolerances that keep one value over a window: exact strips of all circuits, for some gains.

For given gains g_i = 1 / (1 + theta_i) the explanations of a window are a zonotope, whose strips are linear
in g (`gains`). A few good gains are looked for: where they keep all strips the window is CONSISTENT. One
strip that no gains keep proves FAULT, in NumPy; what is neither is searched (`gains.GainsTest`).

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999.
"""

import dataclasses
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import (
    Again,
    Array,
    Arrays,
    LinearRelations,
    Outs,
    Progress,
    Run,
    SignedTest,
    WindowTest,
)
from jaxbound.consistency.reading import Block, Reading, RowValues
from jaxbound.consistency.strips_on_host import host_strips
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel

__all__ = [
    "LEAST",
    "ConstantTest",
    "GainBounds",
    "gain_bounds",
    "no_derivative",
    "signed",
]

BLOCK = 2**9
HELD = 2**26  # bytes of strips at most that a block keeps
HALVINGS = 8  # of the search for the margin
LEAST = 1e-6
"""The least size of a margin whose sign is proved."""
Carry = TypeVar("Carry")
Bracket: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
Triple: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]


class ConstantTest(SignedTest):
    """Tries gains, the same in all samples of a window, by all strips: FAULT and CONSISTENT are proofs.

    The sign of the margin is that of the verdict, its size that of the best gains found: 1 - t, t not below
    the true factor, but seldom 30 % above it.

    Args:
        search: makes the test that is asked of windows left open; its `outputs` are margins.
    """

    by_kernels = confirms = True

    def __init__(
        self, relations: LinearRelations, method: str, dtype: DTypeLike, search: Callable[[], WindowTest]
    ) -> None:
        super().__init__(relations, method, dtype)
        self._search = search
        self.weight = 1 + len(self.reading.strips.h) // 8  # one strip after the other

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
        """Return (margin, open) of windows: all that are not CONSISTENT are open."""
        judged = []
        for margin in map(np.asarray, run(_first, blocks)):
            judged.append((margin, margin <= 0))
        return judged

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, again: Again, progress: Progress
    ) -> None:
        """Contradict windows by one strip, whatever the gains, or search them."""
        (margin,) = outs
        at = left + self.horizon
        sizes = margin[at]
        refuted = self._contradicted(u, y, left)
        margin[at] = np.where(refuted, -1, 0)
        again(self._search(), left[~refuted])
        settled = np.abs(margin[at]) > 0  # not where it is NaN, which proves nothing
        margin[at] = np.where(settled, signed(sizes, margin[at] > 0), 0)

    def _contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows one strip contradicts whatever the gains, in NumPy."""
        r = self.relations
        reading = r.reading(np.float64, self.method)
        host = host_strips(reading, *r.strips(self.method), constant=True)
        return np.asarray(host.contradicted(u, y, starts).any(0))

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise no_derivative()


def no_derivative() -> NotImplementedError:
    """Return why gains have no fast path."""
    return NotImplementedError(
        "margins has no fast path for constant_tolerance, whose gains are searched for: use "
        "detect(...).margin"
    )


class GainBounds(NamedTuple):
    """Boxes of gains (g,): lo, hi holds [1 / (1 + sigma), 1 / (1 - sigma)]; inner_lo, inner_hi lies inside it
    and holds 1.
    """

    lo: Array
    hi: Array
    inner_lo: Array
    inner_hi: Array


def gain_bounds(reading: Reading, xp: ModuleType) -> GainBounds:
    """Return the boxes of gains of a test; xp: NumPy, or jax.numpy inside a kernel."""
    u4 = 4 * rounding.unit(reading.noise.dtype)
    low, high = 1 / (1 + reading.tolerance), 1 / (1 - reading.tolerance)
    fixed = reading.tolerance == 0
    ends = (xp.where(fixed, 1, low * (1 - u4)), xp.where(fixed, 1, high * (1 + u4)))
    inner = (xp.minimum(low * (1 + u4), 1), xp.maximum(high * (1 - u4), 1))
    one = xp.ones(min(1, len(reading.disturbance)), reading.noise.dtype)  # the gain of disturbances
    return GainBounds(*(xp.concatenate([x.astype(one.dtype), one]) for x in (*ends, *inner)))


def _tolerance(reading: Reading) -> jax.Array:
    """Return sigma (g, 1) of each gain, 0 for that of disturbances."""
    none = jnp.zeros(min(1, len(reading.disturbance)), reading.noise.dtype)
    sigma: jax.Array = jnp.concatenate([reading.tolerance, none])[:, None]
    return sigma


def signed(margin: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Give a margin the sign that was proved."""
    return np.asarray(np.where(inside, np.maximum(margin, LEAST), np.minimum(margin, -LEAST)))


@kernel
def _first(reading: Reading, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the margins of windows u (lags, m, N), y (s + 1, p, N): > 0 proves CONSISTENT, NaN says that no
    strip has its samples.
    """
    strips = _strips(reading, u, y)
    factor, gains = _best(reading, strips)
    fits = _kept(reading, strips, gains)
    margin = jnp.where(fits, jnp.maximum(1 - factor, LEAST), jnp.minimum(1 - factor, -LEAST))
    return jnp.where(jnp.all(strips.absent, 0), jnp.nan, margin)


class _Strips(NamedTuple):
    """C circuits over N windows; of one of them, the same without the first axis.

    Fields: a, e (C, g, N), an entry a gain; b (C, N); slack (C, N), what rounding may change in one side;
    usable (C, N), where that is small enough to compare; absent (C, N), where a sample is missing;
    silent (C, N), where an input is.
    """

    a: jax.Array
    e: jax.Array
    b: jax.Array
    slack: jax.Array
    usable: jax.Array
    absent: jax.Array
    silent: jax.Array

    def at(self, gains: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return both sides (N,) of one strip at gains (g, N)."""
        return jnp.abs(jnp.sum(gains * self.a, 0) - self.b), jnp.sum(gains * self.e, 0)


def _strips(reading: Reading, u: jax.Array, y: jax.Array) -> _Strips:
    """Return the strips of all circuits."""
    rows = dataclasses.replace(reading, tolerance=jnp.zeros_like(reading.tolerance)).block(u, y)

    def strip_of(circuit: Triple) -> _Strips:
        return _strip(reading, rows, *circuit)

    strips: _Strips = jax.lax.map(strip_of, (reading.strips.rows, reading.strips.h, reading.strips.k))
    return strips


def _fold(step: Callable[[Carry, _Strips], Carry], carry: Carry, strips: _Strips) -> Carry:
    """Run `step` over all circuits."""
    last: Carry = jax.lax.scan(lambda carry, strip: (step(carry, strip), None), carry, strips)[0]
    return last


def _kept(reading: Reading, strips: _Strips, gains: jax.Array) -> jax.Array:
    """Return (N,) bool: whether gains, clipped to their tolerance, are proved to keep all strips of windows;
    not where a circuit lacks an input.
    """
    gains = jnp.clip(gains, *(x[:, None] for x in gain_bounds(reading, jnp)[2:]))

    def keeping(fits: jax.Array, strip: _Strips) -> jax.Array:
        off, room = strip.at(gains)
        return fits & ((off + strip.slack <= room) & strip.usable | strip.absent) & ~strip.silent

    return _fold(keeping, jnp.ones_like(strips.absent[0]), strips)


def _strip(reading: Reading, rows: RowValues, support: jax.Array, h: jax.Array, k: jax.Array) -> _Strips:
    """Return the strip of one circuit.

    It has no more roundings than in `rounding.residual_error`, with the row g d for m: 3 u g (|y| + |offset|)
    instead of 5 u (1 + sigma) (..), then the coefficient, the product and the sum. The factor 2 covers the
    sum over gains, for up to as many gains as terms.
    """
    mid, rad, scale = (jnp.take(x, support, 0) for x in (rows.mid, rows.rad, rows.scale))
    p = len(reading.noise)
    gain = jnp.where(support < p * (reading.horizon + 1), support % p, p)
    most = gain_bounds(reading, jnp).hi
    share = jnp.where(gain[None] == jnp.arange(len(most))[:, None], h[None], 0)[:, :, None]
    used, k = (k != 0)[:, None], k[:, None]  # a missing value counts only where it is used
    b = jnp.sum(jnp.where(used, k * rows.known, 0), 0)
    magnitude = jnp.sum(jnp.abs(h)[:, None] * scale, 0)
    magnitude += jnp.sum(jnp.where(used, jnp.abs(k) * rows.known_scale, 0), 0)
    gamma, floor = rounding.residual_error(len(h) + len(k) + p, magnitude.dtype)
    usable = magnitude < np.asarray(2.0 ** (np.finfo(magnitude.dtype).maxexp // 2), magnitude.dtype)
    highest = jnp.max(most)
    slack = 2 * (gamma * highest * magnitude + floor * (1 + jnp.max(jnp.abs(h))) * (1 + highest))
    a, e = jnp.sum(share * mid[None], 1), jnp.sum(jnp.abs(share) * rad[None], 1)
    return _Strips(
        a,
        e,
        b,
        jnp.where(usable, slack, 0),
        usable,
        jnp.isnan(magnitude),
        jnp.any(used & jnp.isnan(rows.known), 0),
    )


def _narrowed(
    lo: jax.Array, hi: jax.Array, slope: jax.Array, least: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return boxes lo, hi (g, N) without parts where sum_i g_i slope_i < least; NaN leaves all as it is."""
    most = jnp.maximum(slope * lo, slope * hi)
    edge = (least[None] - (jnp.sum(most, 0)[None] - most)) / slope
    slip = 8 * np.finfo(edge.dtype).eps * jnp.abs(edge)
    low = jnp.where(slope > 0, jnp.fmax(lo, edge - slip), lo)
    return low, jnp.where(slope < 0, jnp.fmin(hi, edge + slip), hi)


def _best(reading: Reading, strips: _Strips) -> tuple[jax.Array, jax.Array]:
    """Return t, the factor on all bounds at which the best gains found explain a window, and these gains; not
    rounded.

    Bisection between a factor that some gains reach and one that is taken to be too small: where narrowing
    the gains by it leaves nothing, or the middle of what it leaves does not reach it.
    """
    sigma = _tolerance(reading)
    used = jnp.where(sigma > 0, sigma, 1)

    def factor(gains: jax.Array) -> jax.Array:
        def worst(t: jax.Array, strip: _Strips) -> jax.Array:
            off, room = strip.at(gains)
            return jnp.maximum(t, jnp.where(strip.absent, 0, off / room))

        own = jnp.max(jnp.where(sigma > 0, jnp.abs(1 / gains - 1) / used, 0), 0)
        return _fold(worst, own, strips)

    def left(t: jax.Array) -> tuple[jax.Array, jax.Array]:
        def narrow(box: tuple[jax.Array, jax.Array], strip: _Strips) -> tuple[jax.Array, jax.Array]:
            lo, hi = box
            for sign in (1, -1):
                lo, hi = _narrowed(lo, hi, t[None] * strip.e + sign * strip.a, sign * strip.b)
            return lo, hi

        wide = t[None] * sigma
        lo, hi = _fold(narrow, (1 / (1 + wide), 1 / jnp.maximum(1 - wide, 1e-3)), strips)
        return 0.5 * lo + 0.5 * hi, jnp.any(lo > hi, 0)

    def halve(i: jax.Array, bracket: Bracket) -> Bracket:
        low, high, t, best = bracket
        middle, empty = left(t)
        new = factor(middle)
        better = (new < high) & ~empty
        high, best = jnp.where(better, new, high), jnp.where(better[None], middle, best)
        low = jnp.where(i == 0, high / 32, jnp.where(better & (new <= t), low, t))
        return low, high, jnp.sqrt(low * high), best

    one = jnp.ones_like(strips.b[0])
    gains = jnp.ones_like(strips.a[0])
    start = 0 * one, factor(gains), one, gains
    _, high, _, best = jax.lax.fori_loop(0, HALVINGS + 1, halve, start)
    return high, best
