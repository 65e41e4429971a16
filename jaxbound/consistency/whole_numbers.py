"""Windows that rounding leaves open far from the boundary, decided in whole numbers: exact, whatever the
scales.

Where a sensor has no noise, its bound is what the recorder rounds away: as thin as the rounding of a residual
in floats, which then decides nothing. Samples and bounds are floats, coefficients rationals, so that a test
multiplied by all denominators compares integers. Rows i are known up to lo_i <= t_i <= hi_i, as in
`exact_window`; the bounds' floor, the smallest normal number, is left out of every CONSISTENT.

    strips      |sum_i h_i (hi_i + lo_i) - 2 k v| <= sum_i |h_i| (hi_i - lo_i)      for all of them, or not
    search      as in `separation`: h and d need only be nearly right and come from floats; z = m_outer - R
    m_inner - K v does not

Blocks of windows at once, as NumPy arrays of Python's integers: some microseconds a strip, so only windows
with such a set come here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, lcm
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import gather
from jaxbound.models.sensor import RECORDER_ULPS, input_slip
from jaxbound.models.window import runs as window_runs
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips import separation
from jaxbound.sets.strips.strips import status_of

__all__ = ["exact_search", "exact_strips", "settle", "thin"]

THIN = {np.dtype(np.float64): 2.0**26, np.dtype(np.float32): 2.0**12}
"""A bound is thin where it is less than so many roundoffs of its sample: a margin is then uncertain by 1e-6,
or in float32 by 0.01.
"""
UNDECIDED = np.int8(Status.UNDECIDED)  # an enumeration would be three times as slow to compare
BLOCK = 2**12
SEARCHES = (1.0, 3e-4, 0.03)
"""Searches for h and d, see `separation.exchange_search`."""


def thin(test: Any, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Say which windows u (lags, m, N), y (s + 1, p, N) have a bound so small that rounding leaves some far
    from the boundary open.

    So do windows whose sums may overflow, or bounds near underflow.
    """
    about = lambda x: np.asarray(x, y.dtype)[:, None]
    size, least = np.fmax.reduce(np.abs(y), 0), np.fmin.reduce(np.abs(y - about(test.offset_y)), 0)
    bound = about(test.noise) + about(test.resolution) + about(test.tolerance) * least
    small = ~(bound > THIN[y.dtype] * rounding.unit(y.dtype) * (size + np.abs(about(test.offset_y)))).all(0)
    small |= (size > np.sqrt(np.finfo(y.dtype).max)).any(0) | (bound < 2.0**40 * rounding.tiny(y.dtype)).any(
        0
    )
    return small & ~np.isinf(y).any((0, 1)) & ~np.isinf(u).any((0, 1))


def _wide(test, y):
    """Say whether no window of a recording is thin, by its largest sample and the smallest bound: cheaper
    than a look at each.
    """
    top = max(float(y.max()), -float(y.min()))  # compiled for whole registers, which fmax is not
    if np.isnan(top):
        top = max(float(np.fmax.reduce(y, None)), -float(np.fmin.reduce(y, None)))
    bound = (np.asarray(test.noise, np.float64) + np.asarray(test.resolution, np.float64)).min()
    scale = top + np.abs(np.asarray(test.offset_y, np.float64)).max()
    enough = max(
        THIN[y.dtype] * float(rounding.unit(y.dtype)) * scale, 2.0**40 * float(rounding.tiny(y.dtype))
    )
    return top < float(np.sqrt(np.finfo(y.dtype).max)) and bound > 1.01 * enough


def settle(
    relations: Any,
    test: Any,
    method: str,
    u: np.ndarray,
    y: np.ndarray,
    status: np.ndarray,
    margin: np.ndarray,
    progress: Callable | None = None,
) -> None:
    """Decide what strips of NumPy recordings u (T, m), y (T, p) left open though it may be far from the
    boundary.

    Args:
        method: "joint" or "box". status, margin: (T,), changed in place. progress: called with the share
            done, if this takes a while.
    """
    s = test.horizon
    open_ = status == UNDECIDED
    if not np.count_nonzero(open_) or _wide(test, y):
        return
    left = np.flatnonzero(open_ & (margin == 0))
    if len(left):
        left = left[thin(test, *gather(u, y, left - s, test.lags, s))]
    if len(left):
        strips = (
            (relations.circuits, relations.circuits_known)
            if method == "joint"
            else (relations.W, relations.K)
        )
        for first in range(0, len(left), BLOCK):
            part = left[first : first + BLOCK]
            margin[part] = exact_strips(relations, test, strips, *gather(u, y, part - s, test.lags, s))
            if progress is not None and len(left) > BLOCK:
                progress((first + len(part)) / len(left))
        status[left] = status_of(margin[left])


def exact_strips(relations: Any, test: Any, strips: tuple, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (N,) margins: > 0 inside, < 0 outside, both proved; 0: a missing input silences a strip; NaN: no
    strip has its data.

    Args:
        relations: a ParityRelation; test: its Reading, whose bounds count. strips: (h, k), exact rows over
            (Y, w) and over U.
        u (lags, m, N), y (s + 1, p, N): samples of N windows, NaN where missing.
    """
    return _strips(_rows_of(relations.model, test, u, y), strips, y.dtype)


def exact_search(relations: Any, test: Any, frame: Any, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (N,) margins as `exact_strips`, 0 too where no search came near enough.

    Args:
        frame: the `exact.Frame` of windows that miss these samples. The others as for `exact_strips`.
    """
    parts = [slice(i, i + BLOCK) for i in range(0, y.shape[2], BLOCK)]
    return np.concatenate(
        [
            _searched(_rows_of(relations.model, test, u[..., part], y[..., part]), frame, y.dtype)
            for part in parts
        ]
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows in integers, to be divided by `scale`, and multiplied by their entry of `factor`.

    Fields: twice, spread: hi + lo and hi - lo of each row, arrays (N,) of integers; factor: Fractions; known,
    slip (l, N): v and how far it may be off; absent (rows, N), missing (l, N): bool; scale: an integer;
    floor: a Fraction, at least what is left out of a row's half-width.
    """

    twice: list
    spread: list
    factor: list
    known: np.ndarray
    slip: np.ndarray
    absent: np.ndarray
    missing: np.ndarray
    scale: int
    floor: Fraction


def _rows_of(model, test, u, y):
    """Return the _Rows of windows u (lags, m, N), y (s + 1, p, N)."""
    samples, p, N = y.shape
    whole_y, y = y, test.seen(y)
    used = np.where(test.used()[:, :, None], whole_y, np.nan)
    shift = -int(np.log2(float(RECORDER_ULPS * rounding.unit(y.dtype))))  # a power of two
    bounds = [
        np.asarray(x, np.float64)
        for x in (test.noise, test.resolution, np.ravel(test.disturbance), test.average)
    ]
    slip = input_slip(np.where(np.isnan(u), 0, u))
    whole = lcm(*(x.denominator for x in (*model.offset["u"], *model.offset["y"])))
    power = max(0, shift + max(map(_places, (u, slip, used, *bounds))))
    integers = lambda x: _integers(x, power) * whole
    offset = {name: [int(x * whole) << power for x in values] for name, values in model.offset.items()}
    noise, resolution, w, average = map(integers, bounds)
    missing = np.isnan(u)
    Y, U = integers(np.where(np.isnan(used), 0, used)), integers(np.where(missing, 0, u))
    nothing, rows = np.zeros(0, object), samples * p
    twice, spread, factor = [nothing] * rows, [nothing] * rows, [Fraction(0)] * rows
    for i in range(p):
        sigma = Fraction(float(test.tolerance[i]))
        over, under = (int((1 + sign * sigma) * sigma.denominator) for sign in (1, -1))
        either = np.array([under, over], object)  # which may be too long for 64 bits
        rho = noise[i] + resolution[i] + ((np.abs(Y[:, i]).max(0) + noise[i]) >> shift)
        for j in range(samples):
            d = Y[j, i] - offset["y"][i]
            above, below = rho + d, rho - d
            hi = (
                above * either[(above > 0).astype(int)]
            )  # times (1 - sigma)(1 + sigma) and the denominator of sigma
            lo = -below * either[(below > 0).astype(int)]
            twice[j * p + i], spread[j * p + i] = hi + lo, hi - lo
            factor[j * p + i] = Fraction(sigma.denominator, over * under)
    for lo, hi in zip(*(np.tile(w[side::2], test.horizon) for side in (0, 1)), strict=True):
        twice.append(np.full(N, hi + lo, object))
        spread.append(np.full(N, hi - lo, object))
        factor.append(Fraction(1))
    slack, runs = Fraction(0), window_runs(model, test.horizon)
    for a, run in runs:  # a weighted sum of rows, weights as whole numbers over one denominator
        weights = model.averages[a].weights
        common = lcm(*(x.denominator for x in weights))
        f, size = [int(x * common) for x in weights], sum(map(abs, weights))
        half, middle = common * average[a] + np.zeros(N, object), np.zeros(N, object)
        slack = max(slack, 10 * (len(f) + size) * Fraction(float(rounding.tiny(y.dtype))))
        if run[0] < samples * p:
            i = run[0] % p
            rho = resolution[i] + ((np.abs(Y[:, i]).max(0) + noise[i]) >> shift)
            half = half + int(size * common) * rho
            middle = _total(x * (Y[j // p, i] - offset["y"][i]) for x, j in zip(f, run, strict=True))
        twice.append(2 * middle)
        spread.append(2 * half)
        factor.append(Fraction(1, common))
    known = U - np.array(offset["u"], object).reshape(1, -1, 1)
    largest = max(1 / (1 - Fraction(float(x))) for x in test.tolerance)
    known, slip, missing = (x.reshape(-1, N) for x in (known, integers(slip), missing))
    floor = max(2 * largest * Fraction(float(rounding.tiny(y.dtype))), slack)
    return _Rows(twice, spread, factor, known, slip, test.absent(whole_y), missing, whole << power, floor)


def _strips(rows, strips, dtype):
    N = rows.absent.shape[1]
    needed = np.array([[bool(x) for x in k] for k in strips[1]], bool).any(0)
    gauge, out, inside = np.full(N, -1.0), np.zeros(N, bool), ~rows.missing[needed].any(0)
    for h, k in zip(*strips, strict=True):
        support, inputs = (np.flatnonzero([bool(x) for x in v]) for v in (h, k))
        exact = [h[i] * rows.factor[i] for i in support] + [k[b] for b in inputs]
        common = lcm(*(x.denominator for x in exact))
        exact = [int(x * common) for x in exact]
        middle = _total(x * rows.twice[i] for i, x in zip(support, exact, strict=False))
        middle = abs(
            middle - _total(2 * x * rows.known[b] for b, x in zip(inputs, exact[len(support) :], strict=True))
        )
        width = _total(abs(x) * rows.spread[i] for i, x in zip(support, exact, strict=False))
        slip = _total(2 * abs(x) * rows.slip[b] for b, x in zip(inputs, exact[len(support) :], strict=True))
        floor = ceil(2 * rows.floor * sum(abs(h[i]) for i in support) * common * rows.scale)
        present = ~(rows.absent[support].any(0) | rows.missing[inputs].any(0))
        out |= present & (middle - width - slip > floor).astype(bool)
        inside &= (middle + slip <= width).astype(bool) | ~present
        gauge = np.where(present, np.maximum(gauge, _ratio(middle, width)), gauge)
    return np.where(gauge < 0, np.nan, _signed(1 - gauge, out, inside, dtype))


def _searched(rows, frame, dtype):
    """Search in floats, from exact z and radii, and compare in integers what is found."""
    c, k, N = len(frame.outer), len(frame.inner), rows.absent.shape[1]
    inner, outer = list(frame.inner), list(frame.outer)
    common = lcm(
        *(x.denominator for x in rows.factor), *(x.denominator for row in (*frame.R, *frame.K) for x in row)
    )
    R, K = ([[int(x * common) for x in row] for row in M] for M in (frame.R, frame.K))
    share = [int(x * common) for x in rows.factor]
    twice, spread = (
        [x * f for x, f in zip(values, share, strict=True)] for values in (rows.twice, rows.spread)
    )
    unit = 2 * rows.scale * common  # of twice and spread; z and outer radii are larger by `common` once more
    z = [
        common * twice[j]
        - _total(x * twice[i] for x, i in zip(R[a], inner, strict=True) if x)
        - _total(2 * x * common * v for x, v in zip(K[a], rows.known, strict=True) if x)
        for a, j in enumerate(outer)
    ]
    slip = [
        _total(2 * abs(x) * common * v for x, v in zip(row, rows.slip, strict=True) if x)
        + np.zeros(N, object)
        for row in K
    ]
    present = np.array(frame.used, bool)[:, None] & ~rows.absent[outer]
    real = ~rows.absent[inner]
    lacking = np.array([[bool(x) for x in row] for row in R], int).reshape(c, k) @ ~real
    lacking = (
        lacking
        + np.array([[bool(x) for x in row] for row in K], int).reshape(c, len(rows.known)) @ rows.missing
    )
    usable = (np.where(present, lacking, 0).sum(0) == 0) & present.any(0)
    top = max(abs(int(v)) for values in (z, *spread) for v in np.ravel(values))
    fold = 1 << max(0, top.bit_length() - (unit * common).bit_length() - 900)  # so that floats hold z / fold
    least = float(rounding.tiny(np.float64)) * 2.0**20
    floats = lambda values, over, fill, where: np.where(
        where, np.array([_quotient(v, over) for v in values]).reshape(len(values), N), fill
    )
    z_float = floats(z, unit * common * fold, 0.0, present)
    r_outer = np.maximum(floats([spread[j] for j in outer], unit * fold, 1.0, present), least)
    r_inner = np.maximum(floats([spread[i] for i in inner], unit * fold, 1.0, real), least)
    R_float = np.array([[float(x) for x in row] for row in frame.R]).reshape(c, k)
    out, inside, gauge = np.zeros(N, bool), np.zeros(N, bool), np.zeros(N)
    for finer in SEARCHES:
        left = np.flatnonzero(usable & ~out & ~inside)
        if not len(left):
            break
        fill = np.resize(left, -(-len(left) // 64) * 64)
        for part in np.split(fill, len(fill) // 64):
            given = (x[:, part] for x in (z_float, r_outer, r_inner, present))
            h, d, _ = map(np.asarray, _candidates(R_float, *given, np.ones(len(part)), finer))
            take = lambda values, part=part: [v[part] for v in values]
            z_i, slip_i, s_outer, s_inner = map(
                take, (z, slip, [spread[j] for j in outer], [spread[i] for i in inner])
            )
            h, d = np.where(present[:, part] & np.isfinite(h), h, 0), np.where(np.isfinite(d), d, 0)
            power = _places(h)
            h_i = _integers(h, power)
            across = [_total(R[a][i] * h_i[a] for a in range(c) if R[a][i]) for i in range(k)]
            width = _total(common * abs(x) * s for x, s in zip(h_i, s_outer, strict=True))
            width = width + _total(abs(x) * s for x, s in zip(across, s_inner, strict=True))
            residual = abs(_total(x * v for x, v in zip(h_i, z_i, strict=True)))
            lost = _total(abs(x) * v for x, v in zip(h_i, slip_i, strict=True))
            reach = _total(abs(x) * common for x in h_i) + _total(map(abs, across))
            out[part] |= (residual - width - lost > reach * ceil(unit * rows.floor)).astype(bool)
            gauge[part] = np.maximum(gauge[part], _ratio(residual, width))
            power = _places(d)
            d_i, one = _integers(d, power) * fold, 1 << power
            fits = ~out[part]
            for i in range(k):
                fits &= (abs(d_i[i]) * unit <= s_inner[i] * one).astype(bool) | ~real[i, part]
            for a in range(c):
                gap = abs(z_i[a] * one - unit * _total(R[a][i] * d_i[i] for i in range(k) if R[a][i]))
                fits &= (gap + slip_i[a] * one <= common * s_outer[a] * one).astype(bool) | ~present[a, part]
            inside[part] |= fits
    margin = np.where(usable, _signed(1 - gauge, out, inside, dtype), 0)
    return np.where(present.any(0), margin, np.nan)


@jax.jit
def _candidates(R, z, r_outer, r_inner, present, one, finer):
    radius, counts = (
        jnp.concatenate([r_outer, r_inner]),
        jnp.concatenate([present, jnp.ones_like(r_inner, bool)]),
    )
    return separation.exchange_search(R, z, radius, counts, one, 20 * (len(r_inner) + 10), finer)


def _signed(margin, out, inside, dtype):
    """Give margins the sign that was proved, 0 where none was."""
    least = np.finfo(dtype).eps
    return np.where(out, np.minimum(margin, -least), np.where(inside, np.maximum(margin, least), 0)).astype(
        dtype
    )


def _total(parts):
    """Add arrays of integers; 0 for none."""
    return sum(parts, 0)


def _ratio(x, y):
    """Return x / y of integers >= 0 as floats, 0 where both are 0."""
    cut = max(0, int(max(x.max(), y.max())).bit_length() - 1000)
    x, y = ((v >> cut).astype(np.float64) for v in (x, y))
    with np.errstate(divide="ignore"):
        return np.where(x == 0, 0, x / np.where((x == 0) & (y == 0), 1, y))


def _quotient(x, divisor):
    """Return integers divided by one as floats."""
    return np.array([int(v) / divisor for v in x], np.float64)


def _places(x):
    """Return the smallest n >= 0 for which all finite floats times 2^n are surely integers."""
    x = np.asarray(x, np.float64)
    x = x[np.isfinite(x) & (x != 0)]
    return max(0, 53 - int(np.frexp(x)[1].min())) if x.size else 0


def _integers(x, power):
    """Return finite floats times 2^power, which makes them integers, as an array of Python's."""
    mantissa, exponent = np.frexp(np.asarray(x, np.float64))
    return (mantissa * 2.0**53).astype(np.int64).astype(object) << np.where(
        mantissa == 0, 0, exponent + (power - 53)
    ).astype(object)
