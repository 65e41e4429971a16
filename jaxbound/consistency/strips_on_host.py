"""Relations once more, in NumPy: which of them contradict a window, from the samples, with nothing that XLA
has worked out.

With rows between lo_i and hi_i (`host_rows`)

    least = sum_i min(h_i lo_i, h_i hi_i) - k v  <=  0  <=  sum_i max(h_i lo_i, h_i hi_i) - k v = most
    (strip)

in every behaviour, and least > error or most < -error contradicts: whatever h and k are, as long as they
cancel all that is unknown.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.consistency.host_rows import Ends, HostRows
from jaxbound.consistency.reading import Reading, gather
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.sets.floats import rounding

BLOCK = 2**13
"""Windows at once: their rows stay in the cache."""
SPARSE = 2
"""Windows whose samples are fewer than one in so many are gathered: what lies between takes time."""


class _HostStrip(NamedTuple):
    """One strip: rows and their coefficients h, inputs and their coefficients k."""

    rows: tuple[int, ...]
    h: tuple[float, ...]
    inputs: tuple[int, ...]
    k: tuple[float, ...]


@dataclass(frozen=True)
class HostStrips:
    """Strips and the bounds of a relation in float64, for NumPy. Build it with `host_strips`.

    Fields: strips; reading: in float64.
    """

    strips: tuple[_HostStrip, ...]
    reading: Reading

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (strips, N) bool: which strips contradict the windows of u (T, m), y (T, p) that start at
        `starts`, in rising order: of stretches where most samples belong to one, else gathered.
        """
        out = np.zeros((len(self.strips), len(starts)), bool)
        first, r = 0, self.reading
        with np.errstate(all="ignore"):
            while first < len(starts):
                begin, samples = int(starts[first]), r.horizon + 1
                stop = int(np.searchsorted(starts, begin + BLOCK))
                if SPARSE * (stop - first) * samples < min(BLOCK, len(y) - begin):
                    stop = min(first + BLOCK // samples, len(starts))
                    block = gather(u, y, starts[first:stop], r.lags, r.horizon)
                    out[:, first:stop] = self._of(*block)
                else:
                    span = slice(begin, int(starts[stop - 1]) + samples)
                    out[:, first:stop] = self._of(u[span], y[span])[:, starts[first:stop] - begin]
                first = stop
        return out

    def _of(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the same of the windows of one `HostRows`."""
        rows = HostRows(self.reading, u, y)
        out = np.empty((len(self.strips), rows.count), bool)
        for own, sums in zip(out, self.sums(rows), strict=True):
            own[:] = excludes_0(*sums)
        return out

    def sums(self, rows: HostRows) -> Iterator[tuple[Ends, Ends, Ends]]:
        """Yield (least, most, error) of each strip, as above: arrays (N,), or numbers for all windows."""
        every = [rows.row(i) for i in range(len(self.reading.window))]
        inputs = [rows.input(b) for b in range(rows.inputs)]
        for strip in self.strips:
            # what windows do not look at bounds nothing, and an infinite error excludes nothing
            if not all(self.reading.window.all[i].seen for i in strip.rows):
                yield 0.0, 0.0, np.inf
                continue
            least: Ends = 0.0
            most: Ends = 0.0
            size: Ends = 0.0
            slip: Ends = 0.0
            for i, c in zip(strip.rows, strip.h, strict=True):
                lo, hi, own = every[i]
                if c < 0:
                    # a negative coefficient turns the ends round
                    lo, hi = hi, lo
                least, most, size = least + c * lo, most + c * hi, size + abs(c) * own
            for b, c in zip(strip.inputs, strip.k, strict=True):
                value, off, own = inputs[b]
                least, most = least - c * value, most - c * value
                slip, size = slip + abs(c) * off, size + abs(c) * own
            terms, largest = len(strip.rows) + len(strip.inputs), max(map(abs, (*strip.h, *strip.k)))
            gamma, floor = rounding.residual_error(terms + 8, np.float64)
            yield least, most, slip + (float(gamma) * size + float(floor) * (1 + largest))


def host_strips(reading: Reading, exact_h: Matrix, exact_k: Matrix) -> HostStrips:
    """Return HostStrips of exact rows h over the rows of a window and k over its inputs; reading: of the
    relations, in float64.
    """
    strips = []
    for h, k in zip(exact_h, exact_k, strict=True):
        strips.append(_HostStrip(*_sparse(h), *_sparse(k)))
    return HostStrips(tuple(strips), reading)


def excludes_0(least: Ends, most: Ends, error: Ends) -> np.ndarray:
    """Return bool: no sum between these ends is 0, even off by an error; False where one is NaN, or so large
    that floats end.
    """
    with np.errstate(invalid="ignore"):
        above, below = (least > error) & (least < np.inf), (most < -error) & (most > -np.inf)
        return np.asarray(above | below)


def _sparse(row: Vector) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the places of the entries of a row that are not 0, and these in floats."""
    places = tuple(i for i, x in enumerate(row) if x)
    return places, tuple(float(rounding.fraction_to_float(row[i])) for i in places)
