"""Constant tolerances over long windows: gains are searched, and what given gains explain is asked of the
exchange search.

With g_i = 1 / (1 + theta_i) the same in all samples of output i, each combination h of the relations is a
strip that is linear in the gains (`constant`). Where circuits are too many to be looked at one by one, those
that count are found: at the middle of a box of gains the search either explains the window, CONSISTENT, or
brings the h that speaks most against these gains, which cuts away a part of the box. Nothing left proves
FAULT; what is left is cut in two. A behaviour is one of given gains, a cut is true of all: either is a proof.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.constant import gain_bounds, narrowed, signed
from jaxbound.consistency.exchange import PATIENCE, ExchangeTest, rounded_frame
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, kernel, outside_xla
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
    the true factor.
    """

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (margin, open): of each window by one box of gains."""
        given = []
        for u, y in blocks:
            lo, hi = (
                np.repeat(np.asarray(x)[:, None], y.shape[-1], 1) for x in gain_bounds(self.reading, np)[:2]
            )
            given.append((np.ones(y.shape[-1], self.dtype), u, y, lo, hi))
        searched = run(candidates, given)
        judged = run(
            concluded, [(block[0], *block[3:], *found) for block, found in zip(given, searched, strict=True)]
        )
        return [
            self._decided(block, found, np.asarray(margin), np.asarray(settled))
            for block, found, (margin, settled, _) in zip(given, searched, judged, strict=True)
        ]

    def _decided(self, block, found, margin, settled):
        """Return (margin, open) of a block; the margin of a window that is left open has no sign yet."""
        proved = self._twice.decided(np.where(settled, margin, 0), partial(self._again, block, found))
        return np.where(settled, proved, margin), ~settled

    def _again(self, block, found, at):
        """Return the margins of some windows of a block, in NumPy from their samples, by what the search
        found for them; 0: open.
        """
        one, *samples, lo, hi = (x[..., at] for x in block)
        hints = (np.asarray(x)[..., at] for x in found[4:7])
        gains, mid, rad, known, *image = prepared(self.constants, one, *samples, lo, hi)
        margin, settled, _ = concluded(self.constants, one, lo, hi, gains, mid, rad, known, *hints, *image)
        return np.where(settled, margin, 0)

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: list, left: np.ndarray, again: Callable, progress: Callable
    ) -> None:
        """Cut the box of gains of those windows that it does not decide as a whole, with frames that fit the
        samples that are there.
        """
        (margin,), s = outs, self.horizon
        for frame, chosen in self._frames(u, y, left):
            reading = dataclasses.replace(
                self.reading, shape=rounded_frame(self.relations, frame, self.dtype)
            )
            at = left[chosen] + s
            us, ys = self._gather(u, y, left[chosen])
            first = margin[at]
            margin[at] = self._search(reading, us, ys, first)
            self._confirm(reading, us, ys, margin, at, first)

    def _confirm(self, reading, u, y, margin, at, first):
        """Search once more outside XLA for the gains of windows for which none were found."""
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

    def _search(self, reading, u, y, margin):
        """Return the margins of windows u (lags, m, N), y (s + 1, p, N): 0 where the budget does not
        decide.
        """
        assert self.relations.frame is not None
        constants = jax.device_put((reading, PATIENCE * (len(self.relations.frame.inner) + 10), FINER))
        lo, hi = (np.asarray(x) for x in gain_bounds(reading, np)[:2])
        first = np.array(margin)

        def judged(lo, hi, owner):
            one = np.ones(len(owner), self.dtype)
            found = candidates(constants, one, u[..., owner], y[..., owner], lo, hi)
            return concluded(constants, one, lo, hi, *found)

        found = explore(
            lambda *box: judged(*box)[2],
            lo,
            hi,
            len(margin),
            DEPTH,
            BOXES,
            "kernel",
            first=True,
            sizes=(self.block,),
        )
        out = np.where(
            np.bincount(found.owner, minlength=len(margin)) > 0, 0, signed(first, np.zeros(len(margin), bool))
        )
        gains, _, owner = found.proofs
        which, at = np.unique(owner, return_index=True)
        if len(which):
            sizes = in_blocks(lambda *box: judged(*box)[0], gains[:, at], gains[:, at], which, (self.block,))[
                0
            ]
            out[which] = signed(sizes, np.ones(len(which), bool))
        return out.astype(self.dtype)


@kernel
def candidates(given: Any, one: jax.Array, u: jax.Array, y: jax.Array, lo: jax.Array, hi: jax.Array) -> tuple:
    """Return (gains, mid, rad, known, h, d, done, *image) at the middle of a box of gains lo, hi (g, N) a
    window; nothing is proved yet.
    """
    test, steps, finer = given
    gains, mid, rad, known, image = _prepared(given, one, u, y, lo, hi)
    found = separation.separation_search(test.shape, image, one, steps, finer)
    return gains, mid, rad, known, *found, *image


def _prepared(given, one, u, y, lo, hi):
    """Return (gains, mid, rad, known, image) at the middle of a box of gains."""
    test, *_ = given
    inner = (x[:, None] for x in gain_bounds(test, jnp)[2:])
    gains = jnp.clip(0.5 * lo + 0.5 * hi, *inner) / one[None]
    rows = dataclasses.replace(test, tolerance=jnp.zeros_like(test.tolerance)).block(u, y)
    mid, rad, scale, known, known_scale = (x / one[None] for x in rows)
    of = jnp.take(gains, _gain(test, jnp.arange(len(mid))), 0)  # of each row
    lift = jnp.max(gain_bounds(test, jnp)[1])
    scaled = (mid * of, rad * of, 2 * scale * of)  # twice: what the products round
    return (
        gains,
        mid,
        rad,
        known,
        separation.separation_image(test.shape, *scaled, known, 2 * known_scale, lift, one),
    )


@kernel
def prepared(*given: Any) -> tuple:
    """Return what `candidates` returns but for (h, d, done), which are searched for."""
    gains, mid, rad, known, image = _prepared(*given)
    return gains, mid, rad, known, *image


@kernel
def concluded(
    given: Any, one: jax.Array, lo: jax.Array, hi: jax.Array, gains: jax.Array, *found: jax.Array
) -> tuple:
    """Return (margin, settled, Verdicts) of boxes of gains lo, hi (g, N), from what `candidates` found in
    their middle.
    """
    test, *_ = given
    mid, rad, known, h, d, done, *rest = found
    frame, image = test.shape, separation.Image(*rest)
    margin, _ = separation.separation_verdict(frame, image, one, h, d, done)
    sigma = jnp.concatenate(
        [test.tolerance, jnp.zeros_like(gains[:, 0], shape=len(gains) - len(test.tolerance))]
    )[:, None]
    own = jnp.max(jnp.where(sigma > 0, jnp.abs(1 / gains - 1) / jnp.where(sigma > 0, sigma, 1), 0), 0)
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


def _gain(test, rows):
    """Return the number of the gain of each row: that of its output, one more for disturbances."""
    p = len(test.noise)
    return jnp.where(rows < p * (test.horizon + 1), rows % p, p)


def _strip(test, image, h, mid, rad, known):
    """Return (a, e (g, N), b, slack (N,), usable) of the combination h (c, N): |sum_i g_i a_i - b| <= sum_i
    g_i e_i where gains explain.

    The rounded coefficients on rows, h and -h R, are sums of c products, and a sum over c + k rows follows:
    no more than twice the roundings that `rounding.search_error` counts, at magnitudes that the largest gain
    multiplies once more.
    """
    frame, gains = test.shape, len(test.noise) + min(1, len(test.disturbance))
    c, k = frame.R.shape
    order = jnp.concatenate([frame.outer, frame.inner])
    present = image.present
    h = jnp.where(present[:c], h, 0)
    through = lambda matrix: jax.lax.fori_loop(
        0,
        c,
        lambda j, total: total + matrix[j][:, None] * h[j][None],
        jnp.zeros((matrix.shape[1], h.shape[1]), h.dtype),
    )
    share = jnp.concatenate([h, -through(frame.R)])
    taken = lambda x: jnp.where(present, jnp.take(x, order, 0, mode="clip"), 0)
    mine = jax.nn.one_hot(_gain(test, order), gains, dtype=bool, axis=0)[:, :, None]
    a = jnp.sum(jnp.where(mine, (share * taken(mid))[None], 0), 1)
    e = jnp.sum(jnp.where(mine, (jnp.abs(share) * taken(rad))[None], 0), 1)
    there = jnp.where(jnp.isnan(known), 0, known)
    b = jnp.sum(through(frame.K) * there, 0) if len(known) else jnp.zeros_like(h[0])
    most = jnp.max(gain_bounds(test, jnp)[1])
    gamma, _ = rounding.search_error(c, k, len(known), h.dtype)
    slack = (
        4
        * most
        * (gamma * jnp.sum(jnp.abs(h) * image.magnitude[:c], 0) + image.floor * (1 + jnp.sum(jnp.abs(h), 0)))
    )
    usable = (
        image.complete
        & present[:c].any(0)
        & (slack < np.asarray(2.0 ** (np.finfo(h.dtype).maxexp // 2), h.dtype))
    )
    return a, e, b, jnp.where(usable, slack, 0), usable
