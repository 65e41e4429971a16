"""Windows that lack samples or inputs, decided in NumPy from the one frame of their relations.

Rows y_outer = R y_inner + K u hold whatever is missing. A row without a sample bounds nothing; an inner row
without one, or a missing input, is an unknown f without bounds, whose column F is one of R or of K:

    |z - R d - F f| <= r (outer rows with a sample),   |d| <= r (inner rows with one).

**Search.** In units of the radii this is a Chebyshev problem: the least t = max |b - B x|, x = (d, f), over
the rows that are there. Each f is exchanged for a row that tells it; from there the single exchange of
`sets.strips.separation` goes on, with a B of each window's own. Plain floats, no claim.

**Proof.** Any (d, f) that satisfies all rows proves the window consistent. Any h with

    |h z| > sum |h_j| r_j + sum |h R|_i r_i + sum |h F|_a V_a

proves it inconsistent, if |f| <= V in every behaviour: h F is 0 but for rounding. V comes from the rows J
that tell f: with P near the inverse of F_J and G = |1 - P F_J|, f = P (z - R d - e)_J + (1 - P F_J) f, so
that |f| <= c + G |f| with c = |P| (|z| + |R| r + r)_J, and |f| <= 2 c where G c <= c / 2. Where rows do not
tell each f apart, fractions make h F = 0 exact for that one h. Errors are those of `rounding.search_error`,
twice for an h that is rounded. What stays open, whole numbers decide where elimination is cheap (`exchange`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Arrays, LinearRelations, Run, SignedTest
from jaxbound.consistency.reading import Block, Reading
from jaxbound.consistency.strips_on_host import HostRows, contradicts, row_errors
from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.linalg import dot, row_reduce
from jaxbound.models.sensor import input_slip
from jaxbound.sets.floats import rounding
from jaxbound.sets.strips.chebyshev import fitted

__all__ = ["TOLD", "Given", "HolesTest", "explained", "refuted"]

HELD = 2**21
"""Numbers of the problems that are searched at once."""
TOLD = 1e-9
"""Share of its column that a pivot has at least: less tells nothing."""
FEW, WORK = 24, 2**11
"""Unknowns, and coefficients, with which one combination is worked out in fractions: milliseconds."""
UNIT, LEAST = float(rounding.unit(np.float64)), float(rounding.tiny(np.float64))
"""The unit roundoff in which all is worked out here, and the smallest normal number."""


class HolesTest(SignedTest):
    """Decides windows whatever they lack; both verdicts are proofs.

    Recordings in float32, too, are worked out in float64.

    Args:
        relations, dtype: as of `ExchangeTest`. reading: how windows are read in float64; None: as the
            relations do.
    """

    sharded = padded = False
    block = 64

    def __init__(self, relations: LinearRelations, dtype: DTypeLike, reading: Reading | None = None) -> None:
        super().__init__(relations, "joint", dtype)
        self.reading = relations.reading(np.float64) if reading is None else reading

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return the margins of blocks of windows."""
        with np.errstate(all="ignore"):
            return [(self._margins(u, y),) for u, y in blocks]

    def _margins(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the margins (N,) of windows u (lags, m, N), y (s + 1, p, N): NaN where no relation has its
        data, 0 where nothing is proved.
        """
        given = self.given(u, y)
        frame, (c, k) = self.relations.frame, given.R.shape
        assert frame is not None
        width = k + given.most
        size = max(1, HELD // ((c + width) * width))
        parts = [np.arange(i, min(i + size, y.shape[2])) for i in range(0, y.shape[2], size)]
        return np.concatenate([self.decided(given.of_windows(part), frame, y.dtype) for part in parts])

    def given(self, u: np.ndarray, y: np.ndarray) -> "Given":
        """Return the rows of windows."""
        return Given.of(HostRows(self.reading, u, y), self.reading, u)

    def decided(self, given: "Given", frame: ExactFrame, dtype: np.dtype) -> np.ndarray:
        """Return the margins (N,) of windows."""
        return _decided(given, frame, dtype)


@dataclass(frozen=True, eq=False)
class Given:
    """The rows of N windows, ordered as a frame has them, windows on the last axis.

    Fields: R, K: of the frame; lo, hi (c + k, N): ends of the outer rows, then of the inner ones, NaN without
    a sample; known (l, N): inputs, 0 where missing; lost (l, N): which are missing and used by a row that is
    there; off (c, N): how far rows may be off since inputs were rounded; size (k, N), magnitude (c, N): what
    rounding errors of inner rows, and of z, are relative to; gamma, floor (N,): of `rounding.search_error`;
    most: inputs that a window has lost.
    """

    R: np.ndarray
    K: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    known: np.ndarray
    lost: np.ndarray
    off: np.ndarray
    size: np.ndarray
    magnitude: np.ndarray
    gamma: float
    floor: np.ndarray
    most: int

    @classmethod
    def of(cls, rows: HostRows, reading: Reading, u: np.ndarray) -> "Given":
        """Return the rows of windows with inputs u (lags, m, N), as the frame of a reading orders them."""
        frame = reading.frame
        R, K = np.asarray(frame.R), np.asarray(frame.K)
        c, order = len(R), np.concatenate([frame.outer, frame.inner])
        lo, hi = rows.ends()
        lo, hi = lo[order], hi[order]
        lo[:c][~np.asarray(frame.used)] = hi[:c][~np.asarray(frame.used)] = np.nan
        missing = np.isnan(rows.known)
        used = (K != 0).T.astype(float) @ ~(np.isnan(lo) & np.isnan(hi))[:c] > 0
        sizes, known_size = rows.sizes()
        size = sizes[order]
        gamma, floor, magnitude = row_errors(R, K, (size[:c], size[c:], known_size), np.float64)
        known, lost = np.where(missing, 0, rows.known), missing & used
        most = int(lost.sum(0).max(initial=0))
        slip = np.nan_to_num(input_slip(reading.inputs(u)).astype(float)).reshape(known.shape)
        off = (1 + gamma) * (np.abs(K) @ slip)
        return cls(R, K, lo, hi, known, lost, off, size[c:], magnitude, gamma, floor, most)

    def of_windows(self, part: np.ndarray | slice) -> "Given":
        """Return the rows of some windows."""
        names = "lo", "hi", "known", "lost", "off", "size", "magnitude", "floor"
        return replace(self, **{name: getattr(self, name)[..., part] for name in names})

    @property
    def hull(self) -> "Given":
        """The same with ends that hold in every behaviour."""
        return self

    def excludes(self, weights: np.ndarray, value: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Return (N,) bool: whether weighted rows, less a value, are never 0; see `contradicts`."""
        return contradicts(weights, self.lo, self.hi, value, error)

    @cached_property
    def there(self) -> np.ndarray:
        """(c + k, N): which rows have a sample; an infinite one has an end, and nothing is proved of it."""
        return np.asarray(~(np.isnan(self.lo) & np.isnan(self.hi)))

    @cached_property
    def middle(self) -> np.ndarray:
        """(c + k, N): the middles of rows, 0 without a sample."""
        return np.where(self.there, (self.lo + self.hi) / 2, 0)

    @cached_property
    def radius(self) -> np.ndarray:
        """(c + k, N): the radii of rows, 0 without a sample."""
        return np.where(self.there, (self.hi - self.lo) / 2, 0)

    @cached_property
    def z(self) -> np.ndarray:
        """(c, N): what outer rows are beyond those that the middles of inner ones give."""
        c = len(self.R)
        return np.asarray(self.middle[:c] - self.R @ self.middle[c:] - self.K @ self.known)

    @cached_property
    def slots(self) -> np.ndarray:
        """(n, N): the numbers of the inputs that are lost, then l."""
        order = np.argsort(~self.lost, axis=0, kind="stable")[: self.most]
        return np.where(np.take_along_axis(self.lost, order, 0), order, len(self.lost))

    @cached_property
    def columns(self) -> np.ndarray:
        """(N, c, k + n): the columns of d, or f, of inner rows, then those of lost inputs; 0 in rows that are
        not there.
        """
        c, N = len(self.R), self.lo.shape[1]
        K = np.concatenate([self.K, np.zeros((c, 1))], 1)
        lost = K[:, self.slots].transpose(2, 0, 1)
        whole = np.concatenate([np.broadcast_to(self.R, (N, *self.R.shape)), lost], 2)
        return np.where(self.there[:c].T[:, :, None], whole, 0)

    @cached_property
    def free(self) -> np.ndarray:
        """(N, k + n): which columns are unknowns without bounds."""
        c = len(self.R)
        return np.concatenate([~self.there[c:].T, self.slots.T < len(self.lost)], 1)


def _decided(given: Given, frame: ExactFrame, dtype: np.dtype) -> np.ndarray:
    """Return the margins (N,) of windows."""
    c, k = given.R.shape
    least = np.finfo(dtype).eps
    free, columns = given.free & given.columns.any(1), given.columns
    # in units of the radii: of unknowns without bounds, of their largest coefficient
    unit = np.maximum(given.radius[:c].T, LEAST)
    bounded = np.concatenate([given.radius[c:].T, np.ones_like(free[:, k:], float)], 1)
    largest = np.abs(columns / unit[:, :, None]).max(1)
    scale = np.where(given.free, 1 / np.where(largest > 0, largest, 1), bounded)
    B = columns * scale[:, None, :] / unit[:, :, None]
    fit = fitted(B, given.z.T / unit, given.there[:c].T, free, TOLD)
    h = np.where(given.there[:c], fit.h.T / unit.T, 0)
    top = np.abs(h).max(0, initial=0)
    h /= np.where(top > 0, top, 1)
    inside = explained(given, (fit.x * scale).T)
    open_ = np.flatnonzero((fit.t > 1) & ~inside & ~fit.idle)
    outside = np.zeros_like(inside)
    if len(open_):
        outside[open_] = refuted(given.of_windows(open_), frame, h[:, open_], fit.telling[open_], free[open_])
    margin = np.nan_to_num(1 - fit.t, nan=0.0)
    margin = np.where(outside, np.minimum(margin, -least), np.where(inside, np.maximum(margin, least), 0))
    return np.where(fit.idle, np.nan, margin).astype(dtype)


def refuted(
    given: Given, frame: ExactFrame, h: np.ndarray, telling: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """Return (N,) bool: which windows combinations h (c, N) contradict, or those near them that are exact.

    Args:
        telling: (N, k + n), the outer row that tells each unknown. free: which are without bounds.
    """
    outside = _contradicted(given, h, free, _reach(given.hull, telling, free))
    for w in np.flatnonzero(~outside):
        exact = _exactly(given, frame, h[:, w], telling[w], free[w], int(w))
        if exact is not None:
            one = slice(w, w + 1)
            outside[one] = _contradicted(given.of_windows(one), exact[:, None], free[one], np.zeros((1, 1)))
    return outside


def explained(given: Given, x: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows x (k + n, N), the deviations of inner rows and what lost inputs are,
    explains.
    """
    c, k = given.R.shape
    known = np.concatenate([given.known, np.zeros((1, given.known.shape[1]))])
    np.put_along_axis(known, given.slots, x[k:], 0)
    known, inner = known[:-1], given.middle[c:] + x[:k]
    values = np.concatenate([given.R @ inner + given.K @ known, inner])
    sizes, unknown = np.abs(given.R) @ np.abs(inner) + np.abs(given.K) @ np.abs(known), np.abs(known).sum(0)
    sizes = np.concatenate([given.magnitude + sizes, given.size + np.abs(inner)])
    error = given.gamma * sizes + given.floor * (1 + sizes.sum(0) + unknown)
    error[:c] += given.off
    within = (given.lo + error <= values) & (values <= given.hi - error)
    return np.asarray(np.all(within | ~given.there, 0))


def _contradicted(given: Given, h: np.ndarray, free: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which windows combinations h (c, N) contradict, each number of them rounded once.

    Args:
        free: (N, k + n), which unknowns are without bounds. reach: of them, V; 0 where exact h cancels them.
    """
    c, k = given.R.shape
    weights = np.concatenate([h, np.where(given.there[c:], -(given.R.T @ h), 0)])
    value = ((given.K.T @ h) * given.known).sum(0)
    off = 2 * given.gamma * given.magnitude + given.floor + given.off
    error = (np.abs(h) * off).sum(0) + given.floor
    F = np.where(free[:, None, :], given.columns, 0)
    through = np.abs(np.einsum("jn,njf->nf", h, F))
    # entries of F may be off by LEAST, see `rounding.nearest_normals`
    rounded = UNIT * np.abs(F) + LEAST * (F != 0)
    through += 4 * (c + 4) * np.einsum("jn,njf->nf", np.abs(h), rounded)
    through += LEAST * np.einsum("jn,njf->nf", h != 0, F != 0)
    error += np.where(through * reach > 0, through * reach, 0).sum(1)
    error *= 1 + 64 * (c + k) * UNIT
    # infinite where the reach of an unknown is not known
    return given.excludes(weights, value, error)


def _exactly(
    given: Given, frame: ExactFrame, h: np.ndarray, telling: np.ndarray, free: np.ndarray, w: int
) -> np.ndarray | None:
    """Return the combination near h (c,) in which every unknown without bounds cancels exactly, None where
    there is none, or fractions would take too long.

    Where unknowns are told together by fewer rows than they are, as inputs in a gap of all outputs, no bound
    of a single one exists, and none is needed.
    """
    c, k = given.R.shape
    columns = np.flatnonzero(free)
    inputs = given.slots[:, w]
    live, own = columns[telling[columns] >= 0], telling[columns[telling[columns] >= 0]]
    others = np.setdiff1d(np.flatnonzero(h), own)
    if len(live) > FEW or len(columns) * (len(others) + len(own)) > WORK:
        return None

    def coefficient(j: int, column: int) -> Fraction:
        row, place = (frame.R[j], column) if column < k else (frame.K[j], int(inputs[column - k]))
        return row[place]

    weights = [Fraction(float(h[j])) for j in others]
    system = []
    for f in live:
        rest = dot(weights, [coefficient(j, f) for j in others])
        system.append([*(coefficient(j, f) for j in own), -rest])
    reduced, pivots = row_reduce(system)
    if pivots != tuple(range(len(live))):
        return None
    weights += [row[-1] for row in reduced]
    rows = [*others, *own]
    for f in columns[telling[columns] < 0]:
        if dot(weights, [coefficient(j, f) for j in rows]):
            return None
    exact = np.zeros(c)
    exact[rows] = list(map(float, weights))
    return exact


def _reach(given: Given, telling: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Return (N, k + n), at least the size of each unknown without bounds in every behaviour: V; infinite
    where rows do not tell.
    """
    c, k = given.R.shape
    q = free.shape[1]
    rows = np.where(telling < 0, 0, telling)
    F = np.take_along_axis(given.columns, rows[:, :, None], 1)
    own = free & (telling >= 0)
    both = own[:, :, None] & own[:, None, :]
    F = np.where(both, F, np.eye(q))
    usable = np.isfinite(F).all((1, 2)) & (np.linalg.cond(F, 1) < 1 / UNIT)
    P = np.linalg.inv(np.where(usable[:, None, None], F, np.eye(q)))
    size = np.abs(given.z) + given.radius[:c] + np.abs(given.R) @ given.radius[c:]
    size = size + given.gamma * given.magnitude + given.floor + given.off
    size = np.where(own, np.take_along_axis(size.T, rows, 1), 0)
    c_bound = (np.abs(P) @ size[:, :, None])[:, :, 0]
    c_bound = np.where(own, c_bound * (1 + 8 * q * UNIT) + LEAST, 0)
    rounded = np.abs(P) @ (UNIT * np.abs(F) + LEAST * (F != 0))
    G = np.abs(np.eye(q) - P @ F) + 4 * (q + 4) * (rounded + UNIT * np.eye(q))
    G = np.where(both, G, 0)
    # what has no telling row has no bound, and what shares rows with it neither
    blind = (free & (telling < 0)).any(1) | ~usable
    holds = np.all((G @ c_bound[:, :, None])[:, :, 0] <= 0.49 * c_bound, 1) & ~blind
    return np.where(own & holds[:, None], 2 * c_bound * (1 + 1e-9), np.inf)
