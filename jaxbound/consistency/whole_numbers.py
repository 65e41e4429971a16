"""Windows that rounding leaves open far from the boundary, decided in whole numbers: exact, whatever the
scales.

Where a sensor has no noise, its bound is what the recorder rounds away: as thin as the rounding of a residual
in floats, which then decides nothing. Samples and bounds are floats, coefficients rationals, so that a test
multiplied by all denominators compares integers. Rows i are known up to lo_i <= t_i <= hi_i (`whole_rows`);
the bounds' floor, the smallest normal number, is left out of every CONSISTENT.

    strips      |sum_i h_i (hi_i + lo_i) - 2 k v| <= sum_i |h_i| (hi_i - lo_i)      for all of them, or not
    search      as in `separation`: h and d need only be nearly right and come from floats; z = m_outer - R
    m_inner - K v does not

Blocks of windows at once, as NumPy arrays of Python's integers: some microseconds a strip, so only windows
with such a set come here.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, lcm

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array, LinearRelations, Progress
from jaxbound.consistency.reading import Reading, gather
from jaxbound.consistency.whole_rows import WholeRows, whole_rows
from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.integers import places, quotients, ratios, total, whole_floats
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips import separation
from jaxbound.sets.strips.strips import status_of

__all__ = ["exact_search", "exact_strips", "finite", "settle", "thin"]

THIN = {np.dtype(np.float64): 2.0**26, np.dtype(np.float32): 2.0**12}
"""A bound is thin where it is less than so many roundoffs of its sample: a margin is then uncertain by 1e-6,
or in float32 by 0.01.
"""
UNDECIDED = np.int8(Status.UNDECIDED)  # an enumeration would be three times as slow to compare
BLOCK = 2**12
HELD = 900
"""Bits of a float that z may have before the point."""
TOGETHER = 64
"""Windows that are searched for at once."""
SEARCHES = (1.0, 3e-4, 0.03)
"""Searches for h and d, see `separation.exchange_search`."""


def thin(reading: Reading, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Say which windows u (lags, m, N), y (s + 1, p, N) have a bound so small that rounding leaves some far
    from the boundary open.

    So do windows whose sums may overflow, or bounds near underflow.
    """

    def column(x: Array) -> np.ndarray:
        return np.asarray(x, y.dtype)[:, None]

    offset = column(reading.offset_y)
    size, least = np.fmax.reduce(np.abs(y), 0), np.fmin.reduce(np.abs(y - offset), 0)
    with np.errstate(invalid="ignore"):  # no tolerance of an infinite sample
        noise = column(reading.noise)
        if reading.times:
            noise = noise * _least_factors(reading, u, y)
        bound = noise + column(reading.resolution) + column(reading.tolerance) * least
    small = ~(bound > THIN[y.dtype] * rounding.unit(y.dtype) * (size + np.abs(offset))).all(0)
    small |= (size > np.sqrt(np.finfo(y.dtype).max)).any(0)
    small |= (bound < 2.0**40 * rounding.tiny(y.dtype)).any(0)
    return np.asarray(small & finite(u, y))


def finite(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Say which windows u (lags, m, N), y (s + 1, p, N) have no infinite sample, of which there is no whole
    number.
    """
    return np.asarray(~(np.isinf(y).any((0, 1)) | np.isinf(u).any((0, 1))))


def _least_factors(reading: Reading, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (p, N), the least factor on the noise of each output in windows; 1 where it has none."""
    least = np.ones(y.shape[1:], y.dtype)
    for i in reading.times:
        factor = reading.factor(u, i)
        if factor is not None:
            least[i] = factor.min(0)
    return least


def settle(
    relations: LinearRelations,
    reading: Reading,
    method: str,
    u: np.ndarray,
    y: np.ndarray,
    status: np.ndarray,
    margin: np.ndarray,
    progress: Progress | None = None,
) -> None:
    """Decide windows of NumPy recordings u (T, m), y (T, p) that strips left open far from the boundary.

    Args:
        method: "joint" or "box". status, margin: (T,), changed in place. progress: called with the share
            done, if this takes a while.
    """
    s = reading.horizon
    left = np.flatnonzero((status == UNDECIDED) & (margin == 0))
    if len(left):
        left = left[thin(reading, *gather(u, y, left - s, reading.lags, s))]
    if len(left):
        strips = relations.strips(method)
        for first in range(0, len(left), BLOCK):
            part = left[first : first + BLOCK]
            margin[part] = exact_strips(relations, reading, strips, *gather(u, y, part - s, reading.lags, s))
            if progress is not None and len(left) > BLOCK:
                progress((first + len(part)) / len(left))
        status[left] = status_of(margin[left])


def exact_strips(
    relations: LinearRelations, reading: Reading, strips: tuple[Matrix, Matrix], u: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return (N,) margins: > 0 inside, < 0 outside, both proved; 0: a missing input silences a strip; NaN: no
    strip has its data.

    Args:
        relations: of a window; reading: their Reading, whose bounds count. strips: (h, k), exact rows over
            (Y, w) and over U.
        u (lags, m, N), y (s + 1, p, N): samples of N windows, NaN where missing.
    """
    return _strips(whole_rows(relations.model, reading, u, y), strips, y.dtype)


def exact_search(
    relations: LinearRelations, reading: Reading, frame: ExactFrame, u: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return (N,) margins as `exact_strips`, 0 too where no search came near enough.

    Args:
        frame: the `ExactFrame` of windows that miss these samples. The others as for `exact_strips`.
    """
    margins = []
    for first in range(0, y.shape[2], BLOCK):
        part = slice(first, first + BLOCK)
        rows = whole_rows(relations.model, reading, u[..., part], y[..., part])
        margins.append(_searched(rows, frame, y.dtype))
    return np.concatenate(margins)


def _strips(rows: WholeRows, strips: tuple[Matrix, Matrix], dtype: np.dtype) -> np.ndarray:
    """Return (N,) margins of all strips (h, k) together."""
    N = rows.absent.shape[1]
    gauge, out, inside = np.full(N, -1.0), np.zeros(N, bool), ~_silenced(rows, strips[1])
    for h, k in zip(*strips, strict=True):
        strip = _whole_strip(rows, h, k)
        middle, width, slip = strip.reach(rows)
        present = strip.present(rows)
        out |= present & (middle - width - slip > strip.floor).astype(bool)
        inside &= (middle + slip <= width).astype(bool) | ~present
        gauge = np.where(present, np.maximum(gauge, ratios(middle, width)), gauge)
    return np.where(gauge < 0, np.nan, _signed(1 - gauge, out, inside, dtype))


def _silenced(rows: WholeRows, inputs: Matrix) -> np.ndarray:
    """Return (N,) bool: which windows miss an input that some strip needs."""
    needed = np.zeros(len(rows.missing), bool)
    for k in inputs:
        needed |= _nonzero(k)
    return np.asarray(np.any(rows.missing[needed], 0))


@dataclass(frozen=True)
class _WholeStrip:
    """One strip, its coefficients multiplied by their common denominator.

    Fields: support, inputs: numbers of rows and inputs; h, k: their coefficients; floor: at least the part of
    its width that rows leave out.
    """

    support: np.ndarray
    inputs: np.ndarray
    h: list[int]
    k: list[int]
    floor: int

    def reach(self, rows: WholeRows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (|middle|, half-width, how far inputs may be off) (N,), each times two."""
        behind = total(x * rows.twice[i] for i, x in zip(self.support, self.h, strict=True))
        driven = total(2 * x * rows.known[b] for b, x in zip(self.inputs, self.k, strict=True))
        width = total(abs(x) * rows.spread[i] for i, x in zip(self.support, self.h, strict=True))
        slip = total(2 * abs(x) * rows.slip[b] for b, x in zip(self.inputs, self.k, strict=True))
        return abs(behind - driven), width, slip

    def present(self, rows: WholeRows) -> np.ndarray:
        """Return (N,) bool: which windows have all samples that it needs."""
        return np.asarray(~(rows.absent[self.support].any(0) | rows.missing[self.inputs].any(0)))


def _whole_strip(rows: WholeRows, h: Vector, k: Vector) -> _WholeStrip:
    """Return the strip h (Y, w) = k U in whole numbers."""
    support, inputs = np.flatnonzero(_nonzero(h)), np.flatnonzero(_nonzero(k))
    on_rows = [h[i] * rows.factor[i] for i in support]
    on_inputs = [k[b] for b in inputs]
    common = _common((on_rows, on_inputs))
    size = sum(abs(h[i]) for i in support)
    floor = ceil(2 * rows.floor * size * common * rows.scale)
    whole_h, whole_k = _times((on_rows, on_inputs), common)
    return _WholeStrip(support, inputs, whole_h, whole_k, floor)


def _searched(rows: WholeRows, frame: ExactFrame, dtype: np.dtype) -> np.ndarray:
    """Return (N,) margins, by what a search in floats finds and integers prove."""
    image = _whole_image(rows, frame)
    N = rows.absent.shape[1]
    approximate, usable = _in_floats(image, frame), _usable(rows, frame, image)
    out, inside, gauge = np.zeros(N, bool), np.zeros(N, bool), np.zeros(N)
    for finer in SEARCHES:
        left = np.flatnonzero(usable & ~out & ~inside)
        if not len(left):
            break
        for part in _full_parts(left):
            windows = image.of(part)
            h, d = approximate.search(part, finer)
            contradicted, size = windows.contradicted(h)
            out[part] |= contradicted
            gauge[part] = np.maximum(gauge[part], size)
            # what is contradicted is not explained, whatever rounding makes of d
            inside[part] |= windows.explained(d, approximate.fold) & ~out[part]
    margin = np.where(usable, _signed(1 - gauge, out, inside, dtype), 0)
    return np.where(image.present.any(0), margin, np.nan)


def _full_parts(left: np.ndarray) -> list[np.ndarray]:
    """Return the numbers of windows in parts of one size, some of them twice: searches then compile once."""
    count = -(-len(left) // TOGETHER)
    return np.split(np.resize(left, count * TOGETHER), count)


@dataclass(frozen=True, eq=False)
class _WholeImage:
    """The set of a frame in integers: |z - R d| <= outer for some |d| <= inner.

    Radii and d are multiplied by `unit`, z and its slip by `unit` and `common`.

    Fields: R (c, k): entries times `common`; z, slip (c lists of (N,)): the value of each relation at the
    middles, and how far inputs may put it off; outer (c lists), inner (k lists): radii of rows; present (c,
    N), real (k, N): which rows there are; floor: at least what radii leave out.
    """

    R: list[list[int]]
    z: list[np.ndarray]
    slip: list[np.ndarray]
    outer: list[np.ndarray]
    inner: list[np.ndarray]
    present: np.ndarray
    real: np.ndarray
    unit: int
    common: int
    floor: int

    def of(self, part: np.ndarray) -> "_WholeImage":
        """Return the image of some windows."""

        def taken(values: list[np.ndarray]) -> list[np.ndarray]:
            return [v[part] for v in values]

        return replace(
            self,
            z=taken(self.z),
            slip=taken(self.slip),
            outer=taken(self.outer),
            inner=taken(self.inner),
            present=self.present[:, part],
            real=self.real[:, part],
        )

    def contradicted(self, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (which windows the combinations h (c, N) contradict, the gauges that they show)."""
        # searches leave numbers of absent rows open, and may fail
        h = np.where(self.present & np.isfinite(h), h, 0)
        whole = whole_floats(h, places(h))
        across = [self._column(i, whole) for i in range(len(self.inner))]
        width = total(self.common * abs(x) * s for x, s in zip(whole, self.outer, strict=True))
        width = width + total(abs(x) * s for x, s in zip(across, self.inner, strict=True))
        residual = abs(total(x * v for x, v in zip(whole, self.z, strict=True)))
        lost = total(abs(x) * v for x, v in zip(whole, self.slip, strict=True))
        reach = total(abs(x) * self.common for x in whole) + total(abs(x) for x in across)
        contradicted = (residual - width - lost > reach * self.floor).astype(bool)
        return contradicted, ratios(residual, width)

    def explained(self, d: np.ndarray, fold: int) -> np.ndarray:
        """Return which windows inner rows d (k, N), to be multiplied by `fold`, explain."""
        d = np.where(np.isfinite(d), d, 0)
        power = places(d)
        whole, one = whole_floats(d, power) * fold, 1 << power
        fits = np.ones(self.present.shape[1], bool)
        for i, radius in enumerate(self.inner):
            fits &= (abs(whole[i]) * self.unit <= radius * one).astype(bool) | ~self.real[i]
        for a, radius in enumerate(self.outer):
            moved = self.unit * total(x * whole[i] for i, x in enumerate(self.R[a]) if x)
            gap = abs(self.z[a] * one - moved)
            most = self.common * radius * one
            fits &= (gap + self.slip[a] * one <= most).astype(bool) | ~self.present[a]
        return fits

    def _column(self, i: int, whole: np.ndarray) -> np.ndarray:
        """Return the coefficients of an inner row in combinations."""
        return total(row[i] * whole[a] for a, row in enumerate(self.R) if row[i])


def _whole_image(rows: WholeRows, frame: ExactFrame) -> _WholeImage:
    """Return the image of windows in a frame."""
    inner, outer = list(frame.inner), list(frame.outer)
    common = lcm(_common((rows.factor,)), _common(frame.R), _common(frame.K))
    R, K, (share,) = _times(frame.R, common), _times(frame.K, common), _times((rows.factor,), common)
    twice = [x * f for x, f in zip(rows.twice, share, strict=True)]
    spread = [x * f for x, f in zip(rows.spread, share, strict=True)]
    nothing = np.zeros(rows.absent.shape[1], object)
    z, slip = [], []
    for a, j in enumerate(outer):
        through = total(x * twice[i] for x, i in zip(R[a], inner, strict=True) if x)
        driven = total(2 * x * common * v for x, v in zip(K[a], rows.known, strict=True) if x)
        z.append(common * twice[j] - through - driven)
        off = total(2 * abs(x) * common * v for x, v in zip(K[a], rows.slip, strict=True) if x)
        slip.append(off + nothing)
    unit = 2 * rows.scale * common
    return _WholeImage(
        R,
        z,
        slip,
        [spread[j] for j in outer],
        [spread[i] for i in inner],
        np.array(frame.used, bool)[:, None] & ~rows.absent[outer],
        ~rows.absent[inner],
        unit,
        common,
        ceil(unit * rows.floor),
    )


def _usable(rows: WholeRows, frame: ExactFrame, image: _WholeImage) -> np.ndarray:
    """Return (N,) bool: which windows have every inner row and input that their relations need."""
    c, k = len(frame.outer), len(frame.inner)
    through = np.array([_nonzero(row) for row in frame.R], int).reshape(c, k)
    driven = np.array([_nonzero(row) for row in frame.K], int).reshape(c, len(rows.known))
    lacking = through @ ~image.real + driven @ rows.missing
    return np.asarray((np.where(image.present, lacking, 0).sum(0) == 0) & image.present.any(0))


@dataclass(frozen=True, eq=False)
class _FloatImage:
    """A _WholeImage in float64, z and radii divided by `fold` so that floats hold them."""

    R: np.ndarray
    z: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    present: np.ndarray
    fold: int

    def search(self, part: np.ndarray, finer: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (h, d) of some windows, nearly right; see `separation.exchange_search`."""
        given = (x[:, part] for x in (self.z, self.outer, self.inner, self.present))
        h, d, _ = _candidates(self.R, *given, np.ones(len(part)), finer)
        return np.asarray(h), np.asarray(d)


def _in_floats(image: _WholeImage, frame: ExactFrame) -> _FloatImage:
    """Return the image in floats."""
    c, k = len(image.outer), len(image.inner)
    N = image.present.shape[1]
    top = max(abs(int(v)) for values in (*image.z, *image.outer, *image.inner) for v in values)
    fold = 1 << max(0, top.bit_length() - (image.unit * image.common).bit_length() - HELD)
    least = float(rounding.tiny(np.float64)) * 2.0**20

    def floats(values: list[np.ndarray], over: int, there: np.ndarray, otherwise: float) -> np.ndarray:
        quotients_of = np.array([quotients(v, over) for v in values]).reshape(len(values), N)
        return np.where(there, quotients_of, otherwise)

    return _FloatImage(
        np.array(frame.R, float).reshape(c, k),
        floats(image.z, image.unit * image.common * fold, image.present, 0.0),
        np.maximum(floats(image.outer, image.unit * fold, image.present, 1.0), least),
        np.maximum(floats(image.inner, image.unit * fold, image.real, 1.0), least),
        image.present,
        fold,
    )


@jax.jit
def _candidates(
    R: jax.Array,
    z: jax.Array,
    r_outer: jax.Array,
    r_inner: jax.Array,
    present: jax.Array,
    one: jax.Array,
    finer: float,
) -> tuple[jax.Array, ...]:
    radius = jnp.concatenate([r_outer, r_inner])
    counts = jnp.concatenate([present, jnp.ones_like(r_inner, bool)])
    return separation.exchange_search(R, z, radius, counts, one, 20 * (len(r_inner) + 10), finer)


def _signed(margin: np.ndarray, out: np.ndarray, inside: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Return margins with the sign that was proved, 0 where none was."""
    least = np.finfo(dtype).eps
    proved = np.where(out, np.minimum(margin, -least), np.where(inside, np.maximum(margin, least), 0))
    return proved.astype(dtype)


def _nonzero(row: Vector) -> np.ndarray:
    """Return which entries of a row are not 0."""
    return np.array(row, bool)


def _common(rows: Iterable[Iterable[Fraction]]) -> int:
    """Return the common denominator of rows of Fractions."""
    return lcm(*(x.denominator for row in rows for x in row))


def _times(rows: Iterable[Iterable[Fraction]], common: int) -> list[list[int]]:
    """Return rows multiplied by a number that makes them whole."""
    return [[int(x * common) for x in row] for row in rows]
