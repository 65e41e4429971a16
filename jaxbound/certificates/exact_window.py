"""One window in exact rationals: the limits that samples and bounds set, and how far the model is from
keeping them.

    (Y, w) = E z + K U,   z = (first state, disturbances, unknown inputs, missing inputs)      rows: true
    outputs Y, disturbances w
    lo <= (Y, w) <= hi                                                           what samples and bounds say

The sensors' intervals are those of `models.sensor`, here as lo, hi: a reading y = (1 + theta) t + delta with
|theta| <= sigma, |delta| <= rho says t in [-f(rho - y), f(rho + y)], f(v) = v / (1 - sigma) for v > 0, else v
/ (1 + sigma).

Where tolerances keep one value, the gains g_i = 1 / (1 + theta_i) of outputs that have one are unknowns
behind z, and

    g_i (d_j - rho_j) <= (E z + K U)_j <= g_i (d_j + rho_j),   1 / (1 + sigma_i) <= g_i <= 1 / (1 - sigma_i)
    j: samples of output i

is linear in (z, g). If nothing keeps all of it, one combination h of the rows, with h E = 0, shows that for
all gains at once: the sum over i of g_i (h d -+ |h| rho)_i, whose ends lie at those of g, does not hold h K U
(Farkas' lemma, the sums over z and over a reading's two sides carried out).

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999.
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import chain
from typing import NamedTuple, Self, TypeAlias, TypeVar

import numpy as np

from jaxbound.certificates.checker.claim import claim_of
from jaxbound.certificates.checker.trajectories import limits as checked_limits
from jaxbound.certificates.checker.words import Document
from jaxbound.certificates.plain import exact_floats, plain_factors, plain_model, plain_samples
from jaxbound.consistency.interface import Bounds
from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import Optimum, chebyshev, likely_point
from jaxbound.exact.linalg import Row, Rows, Vector, Whole, dot
from jaxbound.models import window
from jaxbound.models.rows import WindowRows
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import window_rows
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations

ZERO, ONE = Fraction(0), Fraction(1)
DIGITS = (4, 8, 12, 17)
"""Of numbers that are rounded for readers, as few as will do."""
LARGEST = Fraction(10**300)
"""Of a number that is rounded for readers."""
Ends: TypeAlias = tuple[Fraction, Fraction]
"""(lo, hi) of a number."""
Samples: TypeAlias = tuple[Fraction | None, ...]
"""Samples of a window, time-major, None where one is missing."""
W = TypeVar("W", bound="ExactWindow")


@dataclass(frozen=True, eq=False)
class Stretch:
    """Bounds of a model, and perhaps of the first state, over horizon + 1 samples in a row, in the place of
    relations.

    Fields: model, without averages or uncertainties; horizon; bounds: as of `parity_relations`; first: ((lo,
    hi), ..) of the first state, or None; lags: None.
    """

    model: LinearSystem
    horizon: int
    bounds: Bounds
    first: tuple[Ends, ...] | None = None
    lags: tuple[int, ...] | None = None


Bounded: TypeAlias = ParityRelation | UncertainRelations | Stretch
"""What a window is cut for: relations, or a stretch in their place."""


class Bound(NamedTuple):
    """A bound on unknowns z: |middle - row z| <= radius.

    Fields: number of the row of (Y, w) that it speaks of; sign: of it, 0 where it bounds a gain alone.
    """

    number: int
    sign: int
    row: Row
    middle: Fraction
    radius: Fraction


@dataclass(frozen=True, eq=False)
class ExactWindow:
    """The samples and bounds of one window, every number a Fraction.

    Fields: model, horizon; claim: all that a certificate of it is about, the samples and bounds
    (`checker.claim`); whole ((s+1)p,): all samples, also those that nobody looks at, None where missing;
    lags: of the relations; own: (E, K) of its rows, where a parameter is another, None: those of the model.
    """

    model: LinearSystem
    horizon: int
    claim: Document
    whole: Samples
    lags: tuple[int, ...] | None = None
    own: tuple[Rows, Rows] | None = None

    @property
    def unweighed(self) -> str:
        """Why no fault of it is weighed; "": they are."""
        if not self.constant:
            return ""
        return "named faults are not weighed beside constant_tolerance: give the tolerance as noise"

    def with_limits(self, limits: Iterable[Ends | None]) -> Self:
        """Return the window with other limits of its rows: what is supposed, bounds do not know."""
        # limits are no field: those of the claim are worked out at their first use, and these take their
        # place
        other = copy(self)
        vars(other)["limits"] = list(limits)
        return other

    def without_input(self, i: int) -> Self:
        """Return the window with every sample of input i missing: whatever the actuator did."""
        u = [list(row) for row in self.claim["u"]]
        for row in u:
            row[i] = None
        return replace(self, claim=self.claim | {"u": u}).with_limits(self.limits)

    @cached_property
    def rows(self) -> WindowRows:
        """The rows of the window: see `models.rows`."""
        return window_rows(self.model, self.horizon, self.lags)

    @cached_property
    def u(self) -> Samples:
        """The inputs (l,) on which outputs depend, time-major, None where missing."""
        rows = self.claim["u"][: window.input_lags(self.model, self.horizon)]
        return tuple(chain.from_iterable(rows))

    @cached_property
    def y(self) -> Samples:
        """The outputs ((s+1)p,) that are looked at, time-major, None where missing."""
        return tuple(chain.from_iterable(self.claim["y"]))

    @property
    def first(self) -> Sequence[Ends] | None:
        """The bounds of the first state, or None."""
        return self.claim.get("first_state")

    @cached_property
    def tolerance(self) -> Vector:
        """The relative error (p,) of each output."""
        return tuple(self.claim["tolerance"])

    @cached_property
    def drive(self) -> Vector:
        """The part of the inputs that are there in each row."""
        return linalg.multiply(self.forms[1], known_inputs(self.model, self.u))

    @cached_property
    def limits(self) -> list[Ends | None]:
        """The ends (lo, hi) of each row of (Y, w), as the checker has them, in deviations from the offset;
        None where a sample is missing.
        """
        ends, limits = checked_limits(self.claim), []
        for row in self.rows.all[: self.rows.single]:
            letter = "w"
            if row.values.measured:
                letter = "y"
            limits.append(ends.get(f"{letter}{row.first}_{row.number}"))
        return limits + [ends.get(f"average{i}") for i in range(len(self.rows.of_sums))]

    def known_limits(self, number: int) -> Ends:
        """Return (lo, hi) of a row that has its samples."""
        ends = self.limits[number]
        assert ends is not None, f"row {number} lacks a sample"
        return ends

    def solve(self) -> Optimum:
        """Return the nearest that a window comes to its bounds: t, the factor on all of them at which it just
        becomes consistent; h of the tightest relation h (Y, w) = k U of an exact plant, zeros where there is
        none; z: unknowns that keep all rows within t times their bounds. Among gains t is > 1 where no
        unknowns keep all rows, its size that of no bound.
        """
        best = self._nearest(self.bounds())
        # gains have rows of their own, which make no relation among samples
        if self.gained and not any(best.h):  # explained: of gains of 1 the tightest relation is shown
            best = replace(best, h=self._nearest(self._bounds_of_rows()).h)
        return best

    def _nearest(self, bounds: Iterable[Bound]) -> Optimum:
        """Return the optimum of bounds, with multipliers of the rows."""
        numbers, signs, rows, middles, radii = zip(*bounds, strict=True)
        best = chebyshev(rows, middles, radii)
        h = [ZERO] * len(self.limits)
        for i, sign, x in zip(numbers, signs, best.h, strict=True):
            h[i] += sign * x  # both sides of a reading together: Farkas' lemma, see the module
        if any(h):  # the same relation in numbers that people can read: coprime, or divided by the largest
            h = [*linalg.presentable(linalg.primitive(h))]
        return replace(best, h=tuple(h))

    def is_explained(self) -> bool:
        """Return whether unknowns explain the window: those that floats propose, or the exact optimum."""
        _, _, rows, middles, radii = zip(*self.bounds(), strict=True)
        proposed = likely_point(rows, middles, radii)
        # floats propose, fractions check: far cheaper than the exact optimum, which nobody reads here
        if proposed is not None and self.explained_by(rounded_witness(self, proposed)):
            return True
        return chebyshev(rows, middles, radii, enough=ONE).t <= 1

    @cached_property
    def gained(self) -> list[int]:
        """The outputs whose gains are unknowns; the others are 1."""
        if not self.constant:
            return []
        return [i for i, sigma in enumerate(self.tolerance) if sigma]

    def bounds(self) -> Iterator[Bound]:
        """Yield the bounds of the unknowns, of gains too, by each row that has its samples."""
        if not self.gained:
            yield from self._bounds_of_rows()
            return
        p, none = self.model.p, (ZERO,) * len(self.gained)
        own = dict(zip(self.gained, linalg.identity(len(self.gained)), strict=True))
        for bound in self._bounds_of_rows():
            if bound.number >= len(self.y):
                yield bound._replace(row=(*bound.row, *none))
                continue
            i, (lo, hi) = bound.number % p, self.known_limits(bound.number)
            # 0 <= E z + K U - g lo and 0 <= g hi - E z - K U: each is at most 2 reach
            reach = bound.radius * self.gain_ends(i)[1]
            for sign, value in ((1, -lo), (-1, hi)):
                middle = reach - sign * self.drive[bound.number]
                if i not in own:
                    middle -= value
                row = (*linalg.scale(bound.row, sign), *linalg.scale(own.get(i, none), value))
                yield Bound(bound.number, sign, row, middle, reach)
        nothing = (ZERO,) * len(self.unknown_columns()[0])
        for i, unit in own.items():
            lo, hi = self.gain_ends(i)
            yield Bound(0, 0, (*nothing, *unit), (lo + hi) / 2, (hi - lo) / 2)

    def _bounds_of_rows(self) -> Iterator[Bound]:
        """Yield |middle - row z| <= radius of each row that has its samples, at gains of 1."""
        for number, (row, ends) in enumerate(zip(self.unknown_columns(), self.limits, strict=True)):
            if ends is not None:
                lo, hi = ends
                yield Bound(number, 1, row, (lo + hi) / 2 - self.drive[number], (hi - lo) / 2)

    @property
    def forms(self) -> tuple[Rows, Rows]:
        """(E, K): (Y, w) = E z + K U, with z = (first state, disturbances, unknown inputs)."""
        return self.own or window.unknowns(self.model, self.horizon)

    def unknown_columns(self) -> Rows:
        """Return E with the columns of the missing inputs, which are unknowns as well, behind it."""
        E, K = self.forms
        missing = self.missing_inputs
        if not missing:
            return E
        rows = []
        for both in zip(E, K, strict=True):
            (row, driven), over = linalg.over_one(both)
            # a missing input acts as it would: K has its column
            rows.append(Whole((*row, *(driven[j] for j in missing)), over))
        return rows

    @property
    def constant(self) -> bool:
        """Whether a tolerance keeps one value over the window: then samples together say more than these
        limits, see the module.
        """
        return "constant" in self.claim

    @property
    def missing_inputs(self) -> tuple[int, ...]:
        """The numbers of the inputs that are missing and matter."""
        missing = [j for j, v in enumerate(self.u) if v is None]
        # an input that no row depends on would be a column of zeros
        K = [linalg.integers(row)[0] for row in self.forms[1]]
        return tuple(j for j in missing if any(row[j] for row in K))

    def action(self, h: Sequence[Fraction]) -> Vector:
        """Return k, what a relation h does with the inputs: h (Y, w) = k U, so k = h K."""
        weights, rows = [], []
        for x, row in zip(h, self.forms[1], strict=True):
            if x:  # a relation uses few of all rows
                weights.append(x)
                rows.append(row)
        if not rows:
            return (ZERO,) * len(self.u)
        return linalg.matmul([weights], rows)[0]

    def gain_ends(self, number: int) -> Ends:
        """Return (lo, hi) of 1 / (1 + theta) of a reading whose theta keeps its value, which its limits leave
        out; else (1, 1).
        """
        if not self.constant or number >= len(self.y):
            return ONE, ONE
        sigma = self.claim["tolerance"][number % self.model.p]
        return 1 / (1 + sigma), 1 / (1 - sigma)

    def reach(self, h: Sequence[Fraction]) -> Ends:
        """Return (lo, hi) of h (Y, w) within the limits, under any gains."""
        # rows of one gain are summed first: one theta cannot be at both of its ends at once
        sums: dict[int, Ends] = {}  # of the rows of each gain: linear in it, so extreme at its ends
        for number, x in enumerate(h):
            if x:
                own = len(self.y)
                if number < own:
                    own = number % self.model.p
                lo, hi = sums.get(own, (ZERO, ZERO))
                ends = [x * end for end in self.known_limits(number)]
                sums[own] = lo + min(ends), hi + max(ends)
        scaled = [_times(ends, self.gain_ends(own)) for own, ends in sums.items()]
        return sum((lo for lo, _ in scaled), ZERO), sum((hi for _, hi in scaled), ZERO)

    def true_limits(self, number: int) -> Ends:
        """Return (lo, hi) of a row that has its samples, under any gain."""
        return _times(self.known_limits(number), self.gain_ends(number))

    def relation(self, h: Sequence[Fraction]) -> tuple[Vector, Fraction, Fraction]:
        """Return (k, residual, width) of a relation h that annihilates E and needs no missing sample.

        h (Y, w) - k U is residual -+ width within the limits.
        """
        k, (lo, hi) = self.action(h), self.reach(h)
        for x, ends in zip(self.of_first(h), self.first or (), strict=True):
            lo, hi = lo + min(x * end for end in ends), hi + max(x * end for end in ends)
        return k, (lo + hi) / 2 - dot(k, known_inputs(self.model, self.u)), (hi - lo) / 2

    def rows_at(self, z: Sequence[Fraction]) -> Vector:
        """Return the true (Y, w) = E z + K U, in deviations, at unknowns z = (x, w, v, missing inputs, g)."""
        moved = linalg.multiply(self.unknown_columns(), z[: len(z) - len(self.gained)])
        return linalg.add_multiple(moved, 1, self.drive)

    def of_first(self, h: Sequence[Fraction]) -> Vector:
        """Return the multipliers of bounds of the first state: none here."""
        return ()

    def gains(self, z: Sequence[Fraction]) -> Vector:
        """Return the gain of every output at unknowns z; () where none is unknown."""
        if not self.gained:
            return ()
        known = dict(zip(self.gained, z[len(z) - len(self.gained) :], strict=True))
        return tuple(known.get(i, ONE) for i in range(self.model.p))

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns z keep every row, and gain, within its limits."""
        gains = self.gains(z)
        for i, g in enumerate(gains):
            lo, hi = self.gain_ends(i)
            if not lo <= g <= hi:
                return False
        for number, (ends, v) in enumerate(zip(self.limits, self.rows_at(z), strict=True)):
            g = ONE
            if gains and number < len(self.y):
                g = gains[number % self.model.p]
            if ends is not None and not g * ends[0] <= v <= g * ends[1]:
                return False
        return True


def _times(ends: Ends, gain: Ends) -> Ends:
    """Return (lo, hi) of a number between ends times a gain > 0."""
    return min(ends[0] * g for g in gain), max(ends[1] * g for g in gain)


def stretched(v: Fraction, sigma: Fraction) -> Fraction:
    """Return f(v) = v / (1 - sigma) for v > 0, else v / (1 + sigma): the largest t of a reading, increasing
    in v.
    """
    if v > 0:
        return v / (1 - sigma)
    return v / (1 + sigma)


def unstretched(v: Fraction, sigma: Fraction) -> Fraction:
    """Return the number of which f of `stretched` is v."""
    if v > 0:
        return v * (1 - sigma)
    return v * (1 + sigma)


def rounded_witness(window: ExactWindow, z: Vector) -> Vector:
    """Return z with as few digits as still explain the window."""
    states = window.model.n
    for candidate in shorter(z):
        short = list(candidate)
        for j, (lo, hi) in enumerate(window.claim["disturbance"] * window.horizon, states):
            short[j] = max(lo, min(short[j], hi))
        if window.explained_by(short):
            return tuple(short)
    return z


def shorter(values: Sequence[Fraction]) -> Iterator[Vector]:
    """Yield numbers rounded for readers, of few digits first; none where they are beyond floats."""
    if all(abs(v) <= LARGEST for v in values):
        for digits in DIGITS:
            yield tuple(Fraction(f"{float(v):.{digits}g}") for v in values)


def rounded_up(x: Fraction, digits: int = 4) -> Fraction:
    """Return a number of few digits that is not below x > 0."""
    # the power of ten of x, from its digits alone: x may be beyond floats
    unit = Fraction(10) ** (len(str(x.numerator)) - len(str(x.denominator)) - digits)
    return -(-x // unit) * unit


def known_inputs(model: LinearSystem, u: Sequence[Fraction | None]) -> Vector:
    """Return inputs in deviations from their offsets, 0 for those that are missing."""
    known = []
    for j, v in enumerate(u):
        if v is None:
            known.append(ZERO)
        else:
            known.append(v - model.offset["u"][j % model.m])
    return tuple(known)


def exact_window(relations: Bounded, u: np.ndarray, y: np.ndarray) -> ExactWindow:
    """Return the window of samples u (s+1, m), factors on noise behind them, y (s+1, p). The bounds are those
    that the kernel takes, to the last bit.
    """
    return window_of(ExactWindow, relations, u, y)


def window_of(
    kind: type[W], relations: Bounded, u: np.ndarray, y: np.ndarray, first: Sequence[Ends] | None = None
) -> W:
    """Return the same as a kind of window; first: bounds of the first state, or None."""
    model, bounds = relations.model, relations.bounds
    plain = plain_model(model)
    for name in ("tolerance", "noise"):
        plain[name] = exact_floats(bounds[name])
    pairs = np.reshape(bounds.get("disturbance", ()), (-1, 2))
    plain["disturbance"] = plain_samples(pairs)
    for average, bound in zip(plain["averages"], exact_floats(bounds.get("average", ())), strict=True):
        average["bound"] = bound
    inputs, outputs, factors = plain_samples(u[:, : model.m]), plain_samples(y), plain_factors(model, u)
    claim = claim_of(plain, inputs, outputs, str(y.dtype), relations.lags, first, factors)
    return kind(model, relations.horizon, claim, exact_floats(y), relations.lags)
