"""Constant tolerances over long windows: gains are searched, and what given gains explain is asked of the
exchange search.

With g_i = 1 / (1 + theta_i) the same in all samples of output i, each combination h of the relations is a
strip that is linear in the gains (`constant`). Where circuits are too many to be looked at one by one, those
that count are found: at the middle of a box of gains the search either explains the window, CONSISTENT, or
brings the h that speaks most against these gains, which cuts away a part of the box. Nothing left proves
FAULT; what is left is cut in two. A behaviour is one of given gains, a cut is true of all: either is a proof.
"""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.constant import gain_bounds, gain_tolerance, narrowed, own_factor, signed
from jaxbound.consistency.easy_gains import EasyGains, nominal
from jaxbound.consistency.exchange import PATIENCE, ExchangeTest, Settings
from jaxbound.consistency.holes import HolesTest
from jaxbound.consistency.interface import (
    Again,
    Array,
    Arrays,
    Cases,
    Easy,
    LinearRelations,
    Outs,
    Progress,
    Run,
    WindowTest,
)
from jaxbound.consistency.projection import easy_by
from jaxbound.consistency.reading import Block, Reading
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.exact.frames import ExactFrame
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, kernel, outside_xla
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.paving.frontier import Verdicts, explore, in_blocks
from jaxbound.sets.strips import separation

__all__ = ["GainsTest"]

DEPTH = 40  # cuts of a box of gains
BOXES = 200  # at most for a window
FINER = 3e-4  # of the search, see `separation.separation_search`


class GainsTest(ExchangeTest):
    """Searches for gains, the same in all samples of a long window, that explain it: FAULT and CONSISTENT are
    proofs.

    The sign of the margin is that of the verdict, its size that of gains that were tried: 1 - t, t not below
    the true factor. Where gains by least squares explain a window (`easy`) it may be larger than that of the
    search: neither is above the true one.
    """

    @cached_property
    def easy(self) -> Easy | None:  # type: ignore[override]  # of a property
        """Gains by least squares settle most windows of most recordings."""
        return easy_by(self.relations, self.reading, self.dtype, EasyGains, nominal(self.reading))

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Return all windows: `settle` makes the frames that they need."""
        return WindowTest.cases(self, u, y, starts)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open, *hints): of each window by one box of gains."""
        boxes = [self._boxed(*block) for block in blocks]
        searched = run(candidates, boxes)
        to_conclude = []
        for (one, _, _, lo, hi), found in zip(boxes, searched, strict=True):
            to_conclude.append((one, lo, hi, *found))
        judged = []
        conclusions = run(concluded, to_conclude)
        for found, (margin, settled, _) in zip(searched, conclusions, strict=True):
            judged.append((margin, ~np.asarray(settled), settled, *found[4:7]))
        return judged

    def refuted(self, u: np.ndarray, y: np.ndarray, *hints: np.ndarray) -> np.ndarray:
        """Return which windows no gains explain, by the hints of a search; and those that are left open,
        whose margins have no sign yet.
        """
        settled, *found = hints
        some = np.flatnonzero(settled)
        if not len(some):
            return ~settled
        at = np.resize(some, max(self.block, len(some)))  # one size, so that the program is written down once
        with outside_xla():
            one, *box = self._boxed(u[..., at], y[..., at])
            *rows, image = prepared(self.constants, one, *box)
            of = (x[..., at] for x in found)
            margin, proved, _ = concluded(self.constants, one, *box[2:], *rows, *of, *image)
        refuted = ~settled
        refuted[some] = (np.asarray(proved) & (np.asarray(margin) < 0))[: len(some)]
        return refuted

    def _boxed(self, u: np.ndarray, y: np.ndarray) -> Arrays:
        """Return (ones, u, y, lo, hi): windows, each with the whole box of gains."""
        bounds, count = gain_bounds(self.reading, np), y.shape[-1]
        lo, hi = (np.repeat(np.asarray(x)[:, None], count, 1) for x in (bounds.lo, bounds.hi))
        return np.ones(count, self.dtype), u, y, lo, hi

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, again: Again, progress: Progress
    ) -> None:
        """Cut the box of gains of those windows that it does not decide as a whole, with frames that fit the
        samples that are there.
        """
        (margin,), s = outs, self.horizon
        left = self._past_holes(u, y, margin, left, again)
        for frame, chosen in self._frames(u, y, left):
            shape = _rounded(self.relations, frame, self.dtype)
            reading = dataclasses.replace(self.reading, shape=shape)
            at = left[chosen] + s
            us, ys = self._gather(u, y, left[chosen])
            first = margin[at]
            margin[at] = self._search(reading, us, ys, first)
            self._confirm(reading, us, ys, margin, at, first)

    def _past_holes(
        self, u: np.ndarray, y: np.ndarray, margin: np.ndarray, left: np.ndarray, again: Again
    ) -> np.ndarray:
        """Decide windows that lack samples and need no search for gains, in place; return the starts of the
        others.

        What gains of 1 explain is consistent; what no gains explain that differ from sample to sample is not.
        """
        reading = self.relations.reading(np.float64)
        nominal = dataclasses.replace(reading, tolerance=jnp.zeros_like(reading.tolerance))
        lacking = self._lacking(u, y, left)
        starts, others = left[lacking], left[~lacking]
        again(HolesTest(self.relations, self.dtype, nominal), starts)
        starts = starts[margin[starts + self.horizon] <= 0]
        at = starts + self.horizon
        sizes = margin[at]
        again(HolesTest(self.relations, self.dtype), starts)
        margin[at] = np.where(margin[at] < 0, sizes, 0)
        return np.concatenate([others, starts[margin[at] == 0]])

    def _confirm(
        self,
        reading: Reading,
        u: np.ndarray,
        y: np.ndarray,
        margin: np.ndarray,
        at: np.ndarray,
        first: np.ndarray,
    ) -> None:
        """Search once more outside XLA for the gains of windows for which there were none."""
        wrong = np.flatnonzero(margin[at] < 0)
        if not len(wrong) or is_outside_xla():
            return
        with outside_xla():
            again = self._search(reading, u[..., wrong], y[..., wrong], first[wrong])
        doubtful = at[wrong[~(again < 0)]]
        if len(doubtful):
            margin[doubtful] = 0
            warn_doubtful(
                f"{len(doubtful)} windows are FAULT by XLA, the first of them ends at sample "
                f"{int(doubtful[0])}"
            )

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise NotImplementedError(
            "margins has no fast path for constant_tolerance, whose gains are searched for: use "
            "detect(...).margin"
        )

    def _search(self, reading: Reading, u: np.ndarray, y: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return the margins of windows u (lags, m, N), y (s + 1, p, N): 0 where the budget does not
        decide. first: their margins so far.
        """
        count, bounds = len(first), gain_bounds(reading, np)
        settings = Settings(reading, PATIENCE * (len(self.exact_frame.inner) + 10), FINER)
        constants = jax.device_put(settings)

        def judged(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> _Conclusion:
            one = np.ones(len(owner), self.dtype)
            found = candidates(constants, one, u[..., owner], y[..., owner], lo, hi)
            conclusion: _Conclusion = concluded(constants, one, lo, hi, *found)
            return conclusion

        def verdicts(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[jax.Array]:
            return judged(lo, hi, owner)[2]

        def margins(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> jax.Array:
            return judged(lo, hi, owner)[0]

        lo, hi, sizes = np.asarray(bounds.lo), np.asarray(bounds.hi), (self.block,)
        cover = explore(verdicts, lo, hi, count, DEPTH, BOXES, "kernel", first=True, sizes=sizes)
        left = np.bincount(cover.owner, minlength=count) > 0
        out = np.where(left, 0, signed(first, np.zeros(count, bool)))
        gains, _, owner = cover.proofs
        which, at = np.unique(owner, return_index=True)
        if len(which):
            (size,) = in_blocks(margins, gains[:, at], gains[:, at], which, sizes)
            out[which] = signed(size, np.ones(len(which), bool))
        return out.astype(self.dtype)


_Conclusion = tuple[jax.Array, jax.Array, Verdicts[jax.Array]]
_Prepared = tuple[jax.Array, jax.Array, jax.Array, jax.Array, separation.Image]


@kernel
def candidates(
    given: Settings, one: jax.Array, u: jax.Array, y: jax.Array, lo: jax.Array, hi: jax.Array
) -> tuple[jax.Array, ...]:
    """Return (gains, mid, rad, known, h, d, done, *image) at the middle of a box of gains lo, hi (g, N) a
    window; nothing is proved yet.
    """
    *rows, image = _prepared(given, one, u, y, lo, hi)
    found = separation.separation_search(given.reading.frame, image, one, given.steps, given.finer)
    return *rows, *found, *image


def _prepared(
    given: Settings, one: jax.Array, u: jax.Array, y: jax.Array, lo: jax.Array, hi: jax.Array
) -> _Prepared:
    """Return (gains, mid, rad, known, image) at the middle of a box of gains."""
    test = given.reading
    inner = (x[:, None] for x in gain_bounds(test, jnp)[2:])
    gains = jnp.clip(0.5 * lo + 0.5 * hi, *inner) / one[None]
    rows = dataclasses.replace(test, tolerance=jnp.zeros_like(test.tolerance)).block(u, y)
    mid, rad, scale, known, known_scale = (x / one[None] for x in rows)
    of = jnp.take(gains, _gain(test, jnp.arange(len(mid))), 0)  # of each row
    lift = jnp.max(gain_bounds(test, jnp).hi)
    scaled = (mid * of, rad * of, 2 * scale * of)  # twice: what the products round
    image = separation.separation_image(test.frame, *scaled, known, 2 * known_scale, lift, one)
    return gains, mid, rad, known, image


prepared = kernel(_prepared)
"""The same without a search, for hints that are there."""


@kernel
def concluded(
    given: Settings,
    one: jax.Array,
    lo: jax.Array,
    hi: jax.Array,
    gains: jax.Array,
    mid: jax.Array,
    rad: jax.Array,
    known: jax.Array,
    h: jax.Array,
    d: jax.Array,
    done: jax.Array,
    *rest: jax.Array,
) -> _Conclusion:
    """Return (margin, settled, Verdicts) of boxes of gains lo, hi (g, N), from the candidates in their
    middle.
    """
    test, image = given.reading, separation.Image(*rest)
    margin, _ = separation.separation_verdict(test.frame, image, one, h, d, done)
    own = own_factor(gains, gain_tolerance(test))
    inside, nothing = margin > 0, jnp.isnan(margin)
    a, e, b, slack, usable = _strip(test, image, h, mid, rad, known)
    out = jnp.zeros_like(inside)
    low, high = lo, hi
    for slope, least in ((a + e, b - slack), (e - a, -b - slack)):
        low, high, missed = narrowed(
            low, high, jnp.where(usable[None], slope, 0), jnp.where(usable, least, -1)
        )
        out |= missed & usable
    out |= jnp.any(low > high, 0)
    out &= ~nothing & ~inside
    size = jnp.minimum(jnp.where(margin == 0, -1, margin), 1 - own)
    size = jnp.where(
        nothing, jnp.nan, jnp.where(inside | out, signed(size, inside), jnp.where(size < 0, size, -1e-6))
    )
    axis = jnp.argmax(jnp.where(usable[None], jnp.abs(a), 1) * (high - low), 0)
    open_ = ~inside & ~out & ~nothing
    return size, ~open_, Verdicts(open_, inside, (gains, gains), (low, high), axis)


def _gain(reading: Reading, rows: jax.Array) -> jax.Array:
    """Return the number of the gain of each row: that of its output, one more for disturbances."""
    p = len(reading.noise)
    return jnp.where(rows < p * (reading.horizon + 1), rows % p, p)


def _strip(
    reading: Reading, image: separation.Image, h: jax.Array, mid: jax.Array, rad: jax.Array, known: jax.Array
) -> tuple[jax.Array, ...]:
    """Return (a, e (g, N), b, slack (N,), usable) of the combination h (c, N): |sum_i g_i a_i - b| <= sum_i
    g_i e_i where gains explain.

    The rounded coefficients on rows, h and -h R, are sums of c products, and a sum over c + k rows follows:
    no more than twice the roundings that `rounding.search_error` counts, at magnitudes that the largest gain
    multiplies once more.
    """
    frame, gains = reading.frame, len(reading.noise) + min(1, len(reading.disturbance))
    c, k = frame.R.shape
    order = jnp.concatenate([frame.outer, frame.inner])
    present = image.present
    h = jnp.where(present[:c], h, 0)

    def through(matrix: Array) -> jax.Array:
        def add(j: jax.Array, total: jax.Array) -> jax.Array:
            return total + matrix[j][:, None] * h[j][None]

        sums: jax.Array = jax.lax.fori_loop(0, c, add, jnp.zeros((matrix.shape[1], h.shape[1]), h.dtype))
        return sums

    def taken(x: jax.Array) -> jax.Array:
        return jnp.where(present, jnp.take(x, order, 0, mode="clip"), 0)

    share = jnp.concatenate([h, -through(frame.R)])
    mine = jax.nn.one_hot(_gain(reading, order), gains, dtype=bool, axis=0)[:, :, None]
    a = jnp.sum(jnp.where(mine, (share * taken(mid))[None], 0), 1)
    e = jnp.sum(jnp.where(mine, (jnp.abs(share) * taken(rad))[None], 0), 1)
    there = jnp.where(jnp.isnan(known), 0, known)
    if len(known):
        b = jnp.sum(through(frame.K) * there, 0)
    else:
        b = jnp.zeros_like(h[0])
    most = jnp.max(gain_bounds(reading, jnp).hi)
    gamma, _ = rounding.search_error(c, k, len(known), h.dtype)
    rounded = gamma * jnp.sum(jnp.abs(h) * image.magnitude[:c], 0)
    slack = 4 * most * (rounded + image.floor * (1 + jnp.sum(jnp.abs(h), 0)))
    usable = image.complete & present[:c].any(0)
    usable &= slack < np.asarray(2.0 ** (np.finfo(h.dtype).maxexp // 2), h.dtype)
    return a, e, b, jnp.where(usable, slack, 0), usable


def _rounded(relations: LinearRelations, frame: ExactFrame, dtype: DTypeLike) -> separation.Frame:
    """Return a frame in floats, of one of few widths, so that few are compiled."""
    assert relations.frame is not None
    width, more = len(relations.frame.inner), len(frame.inner) - len(relations.frame.inner)
    if more > 0:
        width += power(more)
    return separation.frame_of(frame, dtype, width)
