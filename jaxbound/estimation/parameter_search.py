"""The search for parameters that explain a whole recording: boxes are refuted by any window, or cut in two.

One list of boxes, worked off level by level; the host only drives. Of each box the windows that came closest
to refuting it are asked first, and those that refuted most, before all others. A box that no window refutes
at any corner is kept as it is: where it is cut decides nothing but how close the set comes.

Nothing is lost: a box is left out where a window refutes it, and NumPy sees the same; else it, or its two
halves, are among what is returned, whenever the search ends.

Source: Jaulin, Walter 1993, Set inversion via interval analysis (SIVIA), without its inner boxes.
"""

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from jaxbound.consistency.parameter_boxes import Ends, ParameterBoxes
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.sets.floats.kernel import outside_xla
from jaxbound.sets.paving.frontier import bisected
from jaxbound.text.progress import Progress

__all__ = ["ENDED", "FOUND", "STOPPED", "Explored", "explored"]

FOUND, ENDED, STOPPED = "found", "budget ended", "interrupted"
"""How a search ends: with boxes as small as was asked, after so many boxes, or by the user."""
NEAR = 16
"""Windows that are asked first for each box: of as many parts of the recording, the closest one each."""
BEST = 16
"""Windows that refuted most, which are asked with them."""
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


@dataclass(frozen=True, eq=False)
class Explored:
    """The end of a search.

    Fields: lo, hi (q, N): boxes left; refuted (W,): boxes that each window refuted; evaluated: boxes judged;
    status: one of FOUND, ENDED, STOPPED.
    """

    lo: np.ndarray
    hi: np.ndarray
    refuted: np.ndarray
    evaluated: int
    status: str


@dataclass
class _Boxes:
    """Boxes lo, hi (q, N) and near (N, NEAR), the windows that are asked first for each."""

    lo: np.ndarray
    hi: np.ndarray
    near: np.ndarray

    def __len__(self) -> int:
        return int(self.lo.shape[1])

    @property
    def ends(self) -> Ends:
        return self.lo, self.hi

    def take(self, which: np.ndarray) -> "_Boxes":
        """Return some of the boxes."""
        return _Boxes(self.lo[:, which], self.hi[:, which], self.near[which])


@dataclass
class _Search:
    """The state of a search: the windows, how often each refuted a box, which of them a level asks."""

    test: ParameterBoxes
    precision: float
    refuted: np.ndarray = field(init=False)
    level: int = 0

    def __post_init__(self) -> None:
        self.refuted = np.zeros(self.test.count, np.int64)

    @property
    def asked(self) -> np.ndarray:
        """The windows of this level: all, or some that are spread over the recording."""
        count = self.test.count
        step = -(-count // LOOKED)
        return np.arange(self.level % step, count, step)

    def first(self) -> _Boxes:
        """Return the whole box."""
        near = np.linspace(0, self.test.count - 1, NEAR).astype(int)
        return _Boxes(self.test.lo[:, None], self.test.hi[:, None], near[None])

    def left(self, boxes: _Boxes, windows: np.ndarray) -> tuple[_Boxes, np.ndarray]:
        """Return (the boxes that none of these windows refutes, the lean (N, q) of their parameters)."""
        best = np.argsort(-self.refuted, kind="stable")[:BEST]
        best = np.broadcast_to(best, (len(boxes), len(best)))
        boxes, _ = self._unrefuted(boxes, np.concatenate([boxes.near, best], 1), closely=True)
        parts, leans = [], []
        many = max(1, TOGETHER // len(windows))
        for start in range(0, len(boxes), many):
            some = boxes.take(np.arange(start, min(start + many, len(boxes))))
            every = np.broadcast_to(windows, (len(some), len(windows)))
            some, lean = self._unrefuted(some, every, closely=False)
            parts.append(some)
            leans.append(lean)
        if not parts:
            return boxes, np.zeros((0, len(boxes.lo)))
        return _together(parts), np.concatenate(leans)

    def _unrefuted(self, boxes: _Boxes, windows: np.ndarray, closely: bool) -> tuple[_Boxes, np.ndarray]:
        """Return (the boxes that none of their windows (N, K) refutes, the lean of their parameters), with
        the closest windows of K as those that are near.
        """
        count, many = windows.shape
        if not count:
            return boxes, np.zeros((0, len(boxes.lo)))
        box = np.repeat(np.arange(count), many)
        look = self.test.looked(boxes.ends, box, windows.ravel(), closely)
        margin = look.margin.reshape(count, many)
        out = np.flatnonzero(margin.min(1) < 0)
        if len(out):
            closest = margin[out].argmin(1)
            pair, window = out * many + closest, windows[out, closest]
            hint = None
            if look.hint is not None:
                hint = look.hint[:, pair]
            with outside_xla():
                told = self.test.looked(boxes.take(out).ends, np.arange(len(out)), window, closely, hint)
            proved = told.margin < 0
            if not proved.all():
                warn_doubtful(f"{int((~proved).sum())} of {len(out)} boxes of parameters are refuted by XLA")
            np.add.at(self.refuted, window[proved], 1)
            out = out[proved]
        kept = np.delete(np.arange(count), out)
        rest = boxes.take(kept)
        rest.near = np.take_along_axis(windows[kept], _closest(margin[kept]), 1)
        lean = np.ones((len(kept), len(boxes.lo)))
        if look.lean is not None:
            lean = look.lean.reshape(-1, count, many)[:, kept].max(2).T
        return rest, lean

    def at_corners(self, boxes: _Boxes, windows: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which boxes no window refutes at any corner; no proof of anything."""
        inside = self._open_corners(boxes, boxes.near, closely=True)
        chosen = np.flatnonzero(inside)
        corners = len(_corners(len(boxes.lo)))
        many = max(1, TOGETHER // (len(windows) * corners))
        for start in range(0, len(chosen), many):
            at = chosen[start : start + many]
            every = np.broadcast_to(windows, (len(at), len(windows)))
            inside[at] = self._open_corners(boxes.take(at), every, closely=False)
        return inside

    def _open_corners(self, boxes: _Boxes, windows: np.ndarray, closely: bool) -> np.ndarray:
        """Return (N,) bool: which boxes none of their windows (N, K) refutes at a corner."""
        signs = _corners(len(boxes.lo))
        count, many = windows.shape
        mid, radius = 0.5 * (boxes.lo + boxes.hi), 0.5 * (boxes.hi - boxes.lo)
        points = (mid[:, :, None] + radius[:, :, None] * signs.T[:, None]).reshape(len(mid), -1)
        points = np.clip(points, self.test.lo[:, None], self.test.hi[:, None])
        point = np.arange(count * len(signs)).repeat(many)
        window = windows.repeat(len(signs), 0).ravel()
        margin = self.test.looked((points, points), point, window, closely).margin
        return np.asarray(margin.reshape(count, -1).min(1) >= 0)

    def step(self, now: _Boxes, later: _Boxes, settled: _Boxes) -> tuple[_Boxes, _Boxes]:
        """Return (boxes to be judged, boxes that stay) once the boxes `now` are judged and cut."""
        asked = self.asked
        rest, lean = self.left(now, asked)
        inside = np.zeros(len(rest), bool)
        if len(rest):
            inside = self.at_corners(rest, asked)
        hull = _edges([rest, later, settled])
        axis = np.where(inside, -1, self.to_cut(rest, lean, hull))
        done = rest.take(np.flatnonzero(axis < 0))
        self.level += 1
        return _together([later, _halved(rest, axis)]), _together([settled, done])

    def to_cut(self, boxes: _Boxes, lean: np.ndarray, hull: np.ndarray) -> np.ndarray:
        """Return (N,): the axis along which each box is cut, -1 where it is small enough. hull: edges of what
        is left of the whole.
        """
        edge = boxes.hi - boxes.lo
        share = (edge / np.where(hull > 0, hull, 1)[:, None]).T
        shortest = LEAST * (self.test.hi - self.test.lo)
        helps = (share > self.precision) & (edge.T > shortest) & (lean > FLAT * self.precision)
        middle = 0.5 * boxes.lo + 0.5 * boxes.hi
        helps &= ((boxes.lo < middle) & (middle < boxes.hi)).T
        gain = np.where(helps, lean * share, -1.0)
        return np.where(helps.any(1), gain.argmax(1), -1)


def explored(
    test: ParameterBoxes,
    precision: float,
    budget: int,
    progress: Progress,
) -> Explored:
    """Return the Explored of a test: the boxes that no window refutes.

    Args:
        precision: boxes with no edge beyond this share of the hull of what is left are not cut. budget: boxes
            that are judged. progress: called with the share of the budget spent, and 1 at the end.
    """
    search = _Search(test, precision)
    status, evaluated, first = FOUND, 0, search.first()
    # (boxes to be judged, boxes that stay): one name, so that an interruption never finds half of a step
    state = first, _none(first)
    try:
        while len(state[0]):
            now, later = _split(state[0], budget - evaluated)
            if not len(now):
                status = ENDED
                break
            state = search.step(now, later, state[1])
            evaluated += len(now)
            progress(min(1.0, evaluated / budget))
        if test.count > LOOKED:
            every = _together(list(state))
            state = _none(every), search.left(every, np.arange(test.count))[0]
    except KeyboardInterrupt:
        status = STOPPED
    kept = _together(list(state))
    progress(1.0)
    return Explored(kept.lo, kept.hi, search.refuted, evaluated, status)


def _closest(margin: np.ndarray) -> np.ndarray:
    """Return (N, NEAR): of as many parts of the columns of margins (N, K), the place of the smallest."""
    edges = np.linspace(0, margin.shape[1], NEAR + 1).astype(int)
    places = []
    for first, stop in zip(edges[:-1], edges[1:], strict=True):
        first = min(first, margin.shape[1] - 1)
        places.append(first + margin[:, first : max(stop, first + 1)].argmin(1))
    return np.stack(places, 1)


def _corners(q: int) -> np.ndarray:
    """Return (K, q): the corners of [-1, 1]^q, or the middles of its faces."""
    if q <= CORNERS:
        return np.array(list(product((-1.0, 1.0), repeat=q)))
    return np.concatenate([np.eye(q), -np.eye(q)])


def _edges(parts: list[_Boxes]) -> np.ndarray:
    """Return (q,): the edges of the hull of boxes, 0 where there are none."""
    every = _together(parts)
    if not len(every):
        return np.zeros(len(every.lo))
    return np.asarray(every.hi.max(1) - every.lo.min(1))


def _halved(boxes: _Boxes, axis: np.ndarray) -> _Boxes:
    """Return both halves of the boxes that are cut along an axis >= 0."""
    cut = boxes.take(np.flatnonzero(axis >= 0))
    lo, hi, parent = bisected(*cut.ends, np.arange(len(cut)), axis[axis >= 0])
    return _Boxes(lo, hi, cut.near[parent])


def _split(boxes: _Boxes, count: int) -> tuple[_Boxes, _Boxes]:
    """Return the first boxes, at most so many, and the others."""
    every = np.arange(len(boxes))
    return boxes.take(every[:count]), boxes.take(every[count:])


def _together(parts: list[_Boxes]) -> _Boxes:
    """Return the boxes of several lists as one."""
    lo = np.concatenate([x.lo for x in parts], 1)
    hi = np.concatenate([x.hi for x in parts], 1)
    return _Boxes(lo, hi, np.concatenate([x.near for x in parts]))


def _none(boxes: _Boxes) -> _Boxes:
    """Return none of the boxes, in the same shape."""
    return boxes.take(np.zeros(0, int))
