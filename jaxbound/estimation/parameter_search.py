"""The search for parameters that explain a whole recording: boxes are refuted by any window, or cut in two.

Of each box the windows that refuted most are asked first, then all, then those that came closest once more,
closely. A box that no window refutes at any corner is kept as it is: where it is cut decides nothing but how
close the set comes. All of this is a hint: a box is left out where NumPy sees a window refute it.

Source: Jaulin, Walter 1993, Set inversion via interval analysis (SIVIA), without its inner boxes.
"""

from itertools import product

import numpy as np

from jaxbound.consistency.parameter_boxes import ParameterBoxes
from jaxbound.consistency.parametric_windows import Leaves
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.sets.paving.frontier import Boxes, Verdicts, explore
from jaxbound.text.progress import Progress

FOUND, ENDED, STOPPED = "found", "budget ended", "interrupted"
"""How a search ends: with boxes as small as was asked, after so many boxes, or by the user."""
NEAR = 16
"""Windows that are asked closely for each box: those that refuted most, those that came closest."""
LOOKED = 2**14
"""Windows that are asked for one level of boxes; all of them at the end."""
TOGETHER = 2**20
"""Pairs of a box and a window at once."""
CORNERS = 4
"""Parameters up to which all corners of a box are tried; else the middles of its faces."""
LEAST = 2.0**-40
"""The shortest edge, as a share of the whole, that is cut."""
FLAT = 0.25
"""An edge is not cut whose parameter has no more than so many times the precision as its share in the room of
any window: the errors of sensors hide it.
"""
Closest = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""(window (N,), margin (N,), h (r, N), lean (n, N)) of boxes: the window that is closest to refuting each."""


class Search:
    """A search for the boxes that no window refutes, and its end.

    Args:
        test: the windows. precision: boxes with no edge beyond this share of the hull of what is left are not
            cut.

    Fields: lo, hi (n, N): boxes left; refuted (W,): boxes that each window refuted; evaluated: boxes judged;
    status: one of FOUND, ENDED, STOPPED; level; cut: how many boxes the last level cut; ends: of the hull of
    those that are cut no more.
    """

    def __init__(self, test: ParameterBoxes, precision: float) -> None:
        self.test, self.precision = test, precision
        self.refuted = np.zeros(test.count, np.int64)
        self.level = self.cut = self.evaluated = 0
        self.ends = np.full_like(test.lo, np.inf), np.full_like(test.lo, -np.inf)
        self.status = STOPPED

    def run(self, budget: int, progress: Progress) -> None:
        """Search until boxes are small enough, `budget` boxes are judged, or the user interrupts.

        Args:
            progress: called with the share of the budget spent, and 1 at the end.
        """
        test = self.test
        try:
            for cover in explore(self.judge, Boxes.repeated(test.lo, test.hi, 1), 2**30, budget):
                boxes, self.evaluated = cover.boxes, int(cover.evaluated[0])
                progress(min(1.0, self.evaluated / budget))
            if test.count > LOOKED and len(boxes.owner):
                boxes = boxes.chosen(self.left(boxes.lo, boxes.hi, np.arange(test.count))[0])
            self.status = FOUND
            if self.cut:
                self.status = ENDED
        except KeyboardInterrupt:
            pass
        self.lo, self.hi = boxes.lo, boxes.hi
        progress(1.0)

    def judge(self, lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[np.ndarray]:
        """Return the Verdicts on the boxes of a level, by all windows or some spread over the recording."""
        step = -(-self.test.count // LOOKED)
        # other windows at each level: all have their turn
        windows = np.arange(self.level % step, self.test.count, step)
        keep, lean = self.left(lo, hi, windows)
        axis = np.full(len(keep), -1)
        if keep.any():
            axis[keep] = self.to_cut(lo[:, keep], hi[:, keep], lean[:, keep], windows)
        self.level, self.cut = self.level + 1, int((axis >= 0).sum())
        return Verdicts(keep, axis=axis)

    def left(self, lo: np.ndarray, hi: np.ndarray, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (which boxes none of these windows refutes, the lean (n, N) of their unknowns)."""
        window, margin, h, lean = self.closest(lo, hi, windows)
        out = np.flatnonzero(margin < 0)
        proved = self.test.refuted(Leaves(window, lo, hi, h).chosen(out))
        if not proved.all():
            warn_doubtful(f"{int((~proved).sum())} of {len(out)} boxes of parameters are refuted by XLA")
        np.add.at(self.refuted, window[out[proved]], 1)
        keep = np.ones(len(window), bool)
        keep[out[proved]] = False
        return keep, lean

    def closest(self, lo: np.ndarray, hi: np.ndarray, windows: np.ndarray, together: int = 1) -> Closest:
        """Return the Closest of boxes (n, N): of so many together none is asked on once one is refuted."""
        many, parts = max(1, TOGETHER // (len(windows) * together)) * together, []
        for start in range(0, lo.shape[1], many):
            some = slice(start, start + many)
            parts.append(self._closest(lo[:, some], hi[:, some], windows, together))
        window, margin, h, lean = (np.concatenate(x, -1) for x in zip(*parts, strict=True))
        return window, margin, h, lean

    def _closest(self, lo: np.ndarray, hi: np.ndarray, windows: np.ndarray, together: int) -> Closest:
        left, nearest = np.arange(lo.shape[1]), None
        # a window that refuted many boxes is likely to refute the next
        best = np.argsort(-self.refuted, kind="stable")[:NEAR]
        asked = np.broadcast_to(best, (len(left), len(best)))
        for closely in (True, False, True)[: 2 + self.test.searched]:
            count, many = asked.shape
            each = np.repeat(left, many)
            look = self.test.looked(lo[:, each], hi[:, each], asked.ravel(), closely)
            margin, lean = look.margin.reshape(count, many), look.lean.reshape(-1, count, many).max(2)
            place = margin.argmin(1)
            pair = np.arange(count) * many + place
            now = asked[np.arange(count), place], look.margin[pair], look.h[:, pair], lean
            if nearest is None:
                nearest = now
            else:
                now = *now[:3], np.maximum(lean, nearest[3][:, left])
                for old, new in zip(nearest, now, strict=True):
                    old[..., left] = new
            still = (now[1] >= 0).reshape(-1, together).all(1).repeat(together)
            left, asked = left[still], asked[still]
            if not len(left):
                break
            if closely:
                asked = np.broadcast_to(windows, (len(left), len(windows)))
            else:
                order = np.argsort(margin[still], 1, kind="stable")[:, :NEAR]
                asked = np.take_along_axis(asked, order, 1)
        assert nearest is not None
        return nearest

    def to_cut(self, lo: np.ndarray, hi: np.ndarray, lean: np.ndarray, windows: np.ndarray) -> np.ndarray:
        """Return (N,): the axis along which each box is cut, -1 where it is small enough, or no window
        refutes it at any corner.
        """
        axes = self.test.place[self.test.place >= 0]
        least, most = np.minimum(self.ends[0], lo.min(1)), np.maximum(self.ends[1], hi.max(1))
        hull, edge = (most - least)[:, None], hi - lo
        share = edge / np.where(hull > 0, hull, 1)
        middle = 0.5 * lo + 0.5 * hi
        helps = (share > self.precision) & (lean > FLAT * self.precision) & (lo < middle) & (middle < hi)
        # floats would not tell the halves apart much longer
        helps &= edge > LEAST * (self.test.hi - self.test.lo)[:, None]
        helps &= np.isin(np.arange(len(lo)), axes)[:, None]
        axis = np.where(helps.any(0), np.where(helps, lean * share, -1.0).argmax(0), -1)
        inside, signs = np.flatnonzero(axis >= 0), _cube_points(len(axes)).T
        if len(inside):
            points = middle[axes][:, inside, None] + 0.5 * edge[axes][:, inside, None] * signs[:, None]
            low, high = (np.repeat(x[:, inside], signs.shape[1], 1) for x in (lo, hi))
            low[axes] = high[axes] = np.clip(points.reshape(len(axes), -1), low[axes], high[axes])
            margin = self.closest(low, high, windows, signs.shape[1])[1]
            inside = inside[margin.reshape(len(inside), -1).min(1) >= 0]
        axis[inside] = -1
        ended = axis < 0
        if ended.any():
            least, most = self.ends
            self.ends = np.minimum(least, lo[:, ended].min(1)), np.maximum(most, hi[:, ended].max(1))
        return axis


def _cube_points(q: int) -> np.ndarray:
    """Return (K, q): the corners of [-1, 1]^q, or the middles of its faces."""
    if q <= CORNERS:
        return np.array(list(product((-1.0, 1.0), repeat=q)))
    return np.concatenate([np.eye(q), -np.eye(q)])
