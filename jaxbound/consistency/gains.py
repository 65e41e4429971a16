"""Constant tolerances over windows: gains are searched, and what given gains explain is asked of the exchange
search.

A reading is y = (1 + theta_i) t + delta, theta_i the same in all samples of output i. With gains g_i = 1 / (1
+ theta_i) a combination h of the relations is a strip that is linear in them,

    |sum_i g_i a_i - b| <= sum_i g_i e_i,  a_i = sum_j h_ij d_ij,  e_i = sum_j |h_ij| rho_i,
    b = k v,  d = y - offset                                                          (strip)

and disturbances are rows with the gain 1. At gains in the middle of a box the search either explains the
window, CONSISTENT, or brings the h that speaks most against these gains, which cuts away a part of the box
(`narrowed`, in NumPy from the samples). Nothing left proves FAULT; what is left is cut in two: one list of
boxes of p gains for all windows. A behaviour is one of given gains, a cut is true of all: either is a proof.

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999; narrowing by linear
inequalities: Davis 1987.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.constant import (
    LEAST,
    gain_bounds,
    keeps,
    narrowed,
    no_derivative,
    own_factor,
    signed,
)
from jaxbound.consistency.easy_gains import EasyGains, nominal
from jaxbound.consistency.exchange import PATIENCE, ExchangeTest, Settings, verdicts
from jaxbound.consistency.holes import HolesTest
from jaxbound.consistency.interface import (
    Again,
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
from jaxbound.consistency.strips_on_host import HostRows, row_errors
from jaxbound.exact.frames import ExactFrame
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.paving.frontier import Verdicts, explore
from jaxbound.sets.strips import separation

__all__ = ["GainsTest"]

T = TypeVar("T")
DEPTH = 40  # cuts of a box of gains
BOXES = 200  # at most for a window
FINER = 3e-4  # of the search, see `separation.separation_search`


class GainsTest(ExchangeTest):
    """Searches for gains, the same in all samples of a window, that explain it: FAULT and CONSISTENT are
    proofs.

    The sign of the margin is that of the verdict, its size that of gains that were tried: 1 - t, t not below
    the true factor. Where gains by least squares explain a window (`easy`) it may be larger than that of the
    search: neither is above the true one.

    Fields: listed: how kernels read all circuits, where these are few: at given gains their strips have
    smaller errors than a search; None: they are too many.
    """

    listed: Reading | None = None

    @cached_property
    def easy(self) -> Easy | None:  # type: ignore[override]  # of a property
        """Gains by least squares settle most windows of most recordings."""
        return easy_by(self.relations, self.reading, self.dtype, EasyGains, nominal(self.reading))

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Return all windows: `settle` makes the frames that they need."""
        return WindowTest.cases(self, u, y, starts)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin, open): of each window by one box of gains; the margin of one that is left open has
        no sign yet.
        """
        lo, hi, boxes = *_whole_box(self.reading), []
        for u, y in blocks:
            count = y.shape[-1]
            boxes.append((u, y, np.tile(lo[:, None], count), np.tile(hi[:, None], count)))
        judged = []
        for found in self._on_boxes(run, self.reading, boxes):
            size = found.size
            margin = np.where(found.keep, np.minimum(size, -LEAST), signed(size, found.proved))
            judged.append((margin.astype(self.dtype), found.keep & ~np.isnan(size)))
        return judged

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, again: Again, progress: Progress
    ) -> None:
        """Cut the box of gains of those windows that it does not decide as a whole; windows that lack samples
        on which the search is built are searched by a frame of the rows that are there.
        """
        (margin,), s = outs, self.horizon
        left = self._past_holes(u, y, margin, left, again)
        for frame, chosen in self._frames(u, y, left):
            shape = _rounded(self.relations, frame, self.dtype)
            at = left[chosen] + s
            reading = dataclasses.replace(self.reading, shape=shape)
            margin[at] = self._search(reading, *self._gather(u, y, left[chosen]), margin[at])

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

    def margins(self, given: Recording) -> jax.Array:
        """Raise: the best gains are found by a search that has no derivative."""
        raise no_derivative()

    def _search(self, reading: Reading, u: np.ndarray, y: np.ndarray, first: np.ndarray) -> np.ndarray:
        """Return the margins of windows u (lags, m, N), y (s + 1, p, N): 0 where the budget does not
        decide. first: their margins so far.
        """
        count = len(first)
        settings = Settings(reading, PATIENCE * (len(self.exact_frame.inner) + 10), FINER)
        run = partial(_alone, jax.device_put(settings))

        def judged(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[np.ndarray]:
            (found,) = self._on_boxes(run, reading, [(u[..., owner], y[..., owner], lo, hi)])
            return found.verdicts

        sizes = (self.block,)
        cover = explore(judged, *_whole_box(reading), count, DEPTH, BOXES, "kernel", first=True, sizes=sizes)
        status = cover.status(count)
        out = np.where(status == Status.UNDECIDED, 0, signed(first, np.zeros(count, bool)))
        size, owner = cover.proofs[0][0], cover.proofs[2]
        out[owner[::-1]] = signed(size[::-1], np.ones(len(owner), bool))
        return out.astype(self.dtype)

    def _on_boxes(self, run: Run, reading: Reading, boxes: Sequence[Arrays]) -> list["_Found"]:
        """Return the _Found of blocks of boxes (u, y, lo, hi) of gains, each of its own window."""
        asked, ones, middles = [], [], []
        bounds = gain_bounds(reading, np)
        for u, y, lo, hi in boxes:
            middle = (0.5 * lo + 0.5 * hi).astype(self.dtype)
            middles.append(np.clip(middle, bounds.inner_lo[:, None], bounds.inner_hi[:, None]))
            ones.append(np.ones(len(middle[0]), self.dtype))
            asked.append((ones[-1], u, y, middles[-1]))
        searched = run(candidates, asked)
        proved = run(verdicts, [(one, *hints) for one, hints in zip(ones, searched, strict=True)])
        found = []
        for box, gains, hints, (margin, _) in zip(boxes, middles, searched, proved, strict=True):
            margin = np.asarray(margin)
            if self.listed is not None:
                margin = np.where((margin <= 0) & keeps(self.listed, *box[:2], gains), LEAST, margin)
            found.append(_narrowed(reading, box, gains, np.asarray(hints[0]), margin))
        return found


class _Found(NamedTuple):
    """N boxes of gains: what is proved of them, and the size of the margin at the gains that were tried.

    Fields: keep (N,): neither refuted nor explained; proved: explained; size (N,), NaN where no relation has
    its data; lo, hi (g, N): the box without parts that cannot explain; axis (N,): along which to cut.
    """

    keep: np.ndarray
    proved: np.ndarray
    size: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    axis: np.ndarray

    @property
    def verdicts(self) -> Verdicts[np.ndarray]:
        """The same as a frontier takes it: the size of the margin stands for the proof."""
        size = self.size[None]
        return Verdicts(self.keep, self.proved, (size, size), (self.lo, self.hi), self.axis)


def _alone(constants: Settings, kernel: Callable[..., T], blocks: Sequence[Arrays]) -> list[T]:
    """Run a kernel on blocks, one after the other."""
    return [kernel(constants, *block) for block in blocks]


def _whole_box(reading: Reading) -> tuple[np.ndarray, np.ndarray]:
    """Return lo and hi (g,) of all gains."""
    bounds = gain_bounds(reading, np)
    return np.asarray(bounds.lo, np.float64), np.asarray(bounds.hi, np.float64)


@kernel
def candidates(
    given: Settings, one: jax.Array, u: jax.Array, y: jax.Array, gains: jax.Array
) -> tuple[jax.Array, ...]:
    """Return (h, d, done, *image) of windows read with gains (g, N); nothing is proved yet."""
    test = given.reading
    rows = dataclasses.replace(test, tolerance=jnp.zeros_like(test.tolerance)).block(u, y)
    mid, rad, scale, known, known_scale = (x / one[None] for x in rows)
    of = jnp.take(gains, _gain(test, np.arange(len(mid))), 0)  # of each row
    lift = jnp.max(gain_bounds(test, jnp).hi)
    scaled = (mid * of, rad * of, 2 * scale * of)  # twice: what the products round
    image = separation.separation_image(test.frame, *scaled, known, 2 * known_scale, lift, one)
    return *separation.separation_search(test.frame, image, one, given.steps, given.finer), *image


def _narrowed(reading: Reading, box: Arrays, gains: np.ndarray, h: np.ndarray, margin: np.ndarray) -> _Found:
    """Return the _Found of boxes (u, y, lo, hi), by combinations h (c, N) and by the margins of given gains,
    proved where they are > 0.
    """
    u, y, lo, hi = map(np.asarray, box)
    inside = margin > 0
    below, above, value, error = _sums(reading, u, y, h)
    out = np.zeros(len(margin), bool)
    low, high = lo, hi
    with np.errstate(all="ignore"):
        for slope, least in ((above, value - error), (-below, -value - error)):
            low, high, missed = narrowed(low, high, slope, least, np)
            out |= missed
        size = np.minimum(np.where(margin == 0, -1, margin), 1 - own_factor(reading, gains, np))
        axis = np.argmax(np.nan_to_num(np.abs(below + above)) * (high - low), 0)
    out = (out | (low > high).any(0)) & ~inside
    return _Found(~inside & ~out, inside, size, low, high, axis)


def _sums(
    reading: Reading, u: np.ndarray, y: np.ndarray, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (below, above (g, N), value, error (N,)) of combinations h (c, N) of outer rows, whatever they
    are: sum_i g_i below_i - error <= value <= sum_i g_i above_i + error, where gains g explain.

    In float64 from the samples; NaN where a sample is missing that a combination needs. Half of the error
    pays, as in `rounding.search_error`, for rows whose magnitudes the largest gain multiplies once more; the
    other half for cutting a box: a sum over gains, which are fewer than terms, a difference and a quotient.
    """
    frame, gains = reading.frame, len(reading.noise) + min(1, len(reading.disturbance))
    R, K, h = np.asarray(frame.R, float), np.asarray(frame.K, float), h.astype(float)
    outer, inner = np.asarray(frame.outer), np.asarray(frame.inner)
    order = np.concatenate([outer, inner])
    windows = HostRows(dataclasses.replace(reading, tolerance=0 * reading.tolerance), u, y)
    sizes, known_sizes = windows.sizes()
    gamma, floor, size = row_errors(R, K, (sizes[outer], sizes[inner], known_sizes), y.dtype)
    share = np.concatenate([h, -R.T @ h])
    lo, hi = (np.where(share == 0, 0, share * x[order]) for x in windows.ends())
    mine = (_gain(reading, order) == np.arange(gains)[:, None]).astype(float)
    below, above = mine @ np.minimum(lo, hi), mine @ np.maximum(lo, hi)
    reached = K.T @ h
    value = np.where(reached == 0, 0, reached * windows.known).sum(0)
    weights = np.abs(h)
    error = gamma * (weights * size).sum(0) + floor * (1 + weights.sum(0))
    return below, above, value, 4 * float(gain_bounds(reading, np).hi.max()) * error


def _gain(reading: Reading, rows: np.ndarray) -> np.ndarray:
    """Return the number of the gain of each row: that of its output, one more for disturbances."""
    p = len(reading.noise)
    return np.where(rows < p * (reading.horizon + 1), rows % p, p)


def _rounded(relations: LinearRelations, frame: ExactFrame, dtype: DTypeLike) -> separation.Frame:
    """Return a frame in floats, of one of few widths, so that few are compiled."""
    assert relations.frame is not None
    width, more = len(relations.frame.inner), len(frame.inner) - len(relations.frame.inner)
    if more > 0:
        width += power(more)
    return separation.frame_of(frame, dtype, width)
