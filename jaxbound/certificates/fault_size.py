"""The smallest size of one named fault alone that explains a window, exactly, or the proof that no size does.

A fault of an unknown x adds x push to the rows of a window (`supposed`). A relation h with h E = 0 that is r
-+ width without the fault is r - x h push -+ width with it, so it leaves an interval of x. Relations are
collected: where those that are there leave an x, the window with the x nearest to 0 is solved exactly, and
what is violated there is one more relation, for all faults and all onsets of this window. The end is an x
that explains the window while no smaller one does, or two relations that leave no x: a proof. There are
finitely many relations that a window can violate most, so there is an end.

Where a square of x moves the window (`cool` and `cool2`), x goes away from 0 on either side, over whatever a
relation rules out: r - x h first - x^2 h second leaves x up to a root, and from another on. Roots are rounded
away from 0 in the last of 12 digits, so such a size explains, and none smaller by more than that does.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from math import isqrt

from jaxbound.certificates.blame import rounded_up, rounded_witness
from jaxbound.certificates.exact_window import ExactWindow, Explanation
from jaxbound.certificates.supposed import Push, limits_of, push_of, size_at, unknown_at
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault

__all__ = ["FaultSize", "Scale"]

ZERO, ONE = Fraction(0), Fraction(1)
MOST_GAIN = 10**6
"""The largest gain error of a sensor that is looked at: at an infinite one nothing of the reading is left."""
DIGITS = 12
"""Of a root that is no fraction."""


@dataclass(frozen=True, eq=False)
class FaultSize:
    """A named fault, and whether it alone explains a window.

    Fields: fault; size: the smallest that does, signed, exact; None: none does, proved; since: the sample of
    the window from which on it is constant, None for an excluded one: from none; beyond: of an excluded one,
    the smallest size that would explain the window although its sign or bounds rule it out, None where none
    does; proof: the relations h, ((h, h), ..), two or one for each onset, that leave no smaller size;
    z: unknowns that explain the window with it. tried: of a parameter how many pairs of a size and an onset
    were tried: its size is the smallest of those that explain, and None is no proof.
    """

    fault: NamedFault
    size: Fraction | None
    since: int | None = None
    beyond: Fraction | None = None
    proof: tuple[tuple[Vector, ...], ...] = ()
    z: Vector | None = None
    tried: int = 0


@dataclass(frozen=True, eq=False)
class Cut:
    """A relation of a window without a fault. Fields: h; places, weights: where it is not 0, and its numbers
    there; residual, width.
    """

    h: Vector
    places: tuple[int, ...]
    weights: tuple[Fraction, ...]
    residual: Fraction
    width: Fraction

    def share(self, push: Vector) -> Fraction:
        """Return h push."""
        return linalg.dot(self.weights, [push[j] for j in self.places])

    def leaves(self, push: Vector) -> tuple[Fraction, Fraction] | None:
        """Return the (lowest, highest) x that the relation leaves, None where x does not touch it: it then
        leaves all or none.
        """
        share = self.share(push)
        if not share:
            return None
        ends = (self.residual - self.width) / share, (self.residual + self.width) / share
        return min(ends), max(ends)


@dataclass(eq=False)
class Range:
    """The x that relations leave. Fields: low, high: its ends, None: without end; by_low, by_high: the
    relations that set them, None where the sign or bounds of the size do; empty: no x is left.
    """

    low: Fraction | None
    high: Fraction | None
    by_low: Cut | None = None
    by_high: Cut | None = None

    @property
    def empty(self) -> bool:
        """Whether no x is left."""
        return self.low is not None and self.high is not None and self.low > self.high

    @property
    def nearest(self) -> Fraction:
        """The x nearest to 0."""
        if self.low is not None and self.low > 0:
            return self.low
        if self.high is not None and self.high < 0:
            return self.high
        return ZERO

    def meet(self, low: Fraction | None, high: Fraction | None, by: Cut | None) -> None:
        """Keep the x between two ends too, those that a relation leaves; None: those that are stated."""
        if low is not None and (self.low is None or low > self.low):
            self.low, self.by_low = low, by
        if high is not None and (self.high is None or high < self.high):
            self.high, self.by_high = high, by

    def side(self, sign: int) -> "Range":
        """Return the part of it with x of one sign."""
        part = Range(self.low, self.high)
        if sign > 0:
            part.meet(ZERO, None, None)
        else:
            part.meet(None, ZERO, None)
        return part

    def farthest(self, sign: int) -> Fraction | None:
        """Return the magnitude of its far end on one side of 0; None: without end."""
        end = self.high
        if sign < 0:
            end = self.low
        if end is None:
            return None
        return abs(end)

    @property
    def proof(self) -> tuple[Vector, ...]:
        """The relations that set its ends."""
        return tuple(cut.h for cut in (self.by_low, self.by_high) if cut is not None)


@dataclass(frozen=True, eq=False)
class Least:
    """The x nearest to 0 that explains a window. Fields: x; z: unknowns with it, None where none explains;
    proof: relations that leave none.
    """

    x: Fraction
    z: Vector | None
    proof: tuple[Vector, ...] = ()


@dataclass(eq=False)
class Scale:
    """The sizes of named faults of one window, and the relations that were collected for them.

    Fields: window; explanation: of the window without a fault; cuts: of relations that faults violate.
    """

    window: ExactWindow
    explanation: Explanation
    cuts: list[Cut] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._add(self.explanation.h)

    def weigh(self, fault: NamedFault, onsets: Iterable[int] = (0,)) -> FaultSize:
        """Return the FaultSize of a fault: of all onsets that of the smallest size.

        Args:
            fault: of the model of the window. onsets: samples of the window from one of which on it is
                constant; before that there is none.

        Raises:
            NotImplementedError: as `push_of`.
        """
        best: tuple[Fraction, Fraction, int, Vector] | None = None
        beyond: Fraction | None = None
        proofs = []
        for since in onsets:
            push = push_of(fault, self.window, since)
            limits = limits_of(fault, self.window, since)
            for ends in _ranges(fault):
                ends.meet(*limits, None)
                least = self._least(push, ends)
                if least.z is None:
                    proofs.append(least.proof)
                    continue
                size = size_at(fault, least.x)
                if best is None or abs(size) < best[0]:
                    best = abs(size), least.x, since, least.z
            if best is None and _is_bounded(fault):
                free = self._least(push, Range(*_widest(fault)))
                size = size_at(fault, free.x)
                if free.z is not None and (beyond is None or abs(size) < abs(beyond)):
                    beyond = size
        if best is None:
            return FaultSize(fault, None, None, beyond, tuple(proofs))
        _, x, since, z = best
        here = self.window.moved(push_of(fault, self.window, since).at(x))
        return FaultSize(fault, size_at(fault, x), since, None, tuple(proofs), rounded_witness(here, z))

    def _least(self, push: Push, ends: Range) -> "Least":
        """Return the x nearest to 0 of a range that explains the window."""
        if push.second:
            sides = []
            for sign in (1, -1):
                side = ends.side(sign)
                if not side.empty:
                    sides.append(self._curved(push, side, sign))
            explaining = [side for side in sides if side.z is not None]
            if explaining:
                return min(explaining, key=lambda least: abs(least.x))
            return Least(ZERO, None, tuple(h for side in sides for h in side.proof))
        left = ends
        for cut in self.cuts:
            if not _keeps(cut, push.first, left):
                return Least(ZERO, None, left.proof)
        while not left.empty:
            best = self.window.moved(push.at(left.nearest)).solve(self.explanation.reference)
            if best.factor <= 1:
                return Least(left.nearest, best.z)
            if not _keeps(self._add(best.h), push.first, left):
                break
        return Least(ZERO, None, left.proof)

    def _curved(self, push: Push, side: Range, sign: int) -> "Least":
        """Return the same on one side of 0, where x is squared, going away from 0."""
        size, most = abs(side.nearest), side.farthest(sign)
        used: dict[int, Vector] = {}
        while True:
            here = size
            for i, cut in enumerate(self.cuts):
                farther = _next_left(cut, push, sign, size)
                if farther != size:
                    used[i] = cut.h
                if farther is None or (most is not None and farther > most):
                    return Least(ZERO, None, tuple(used.values()))
                size = farther
            if size > here:
                continue
            best = self.window.moved(push.at(sign * size)).solve(self.explanation.reference)
            if best.factor <= 1:
                return Least(sign * size, best.z)
            self._add(best.h)

    def _add(self, h: Vector) -> Cut:
        """Collect one more relation."""
        _, residual, width = self.window.relation(h)
        places = tuple(j for j, x in enumerate(h) if x)
        cut = Cut(h, places, tuple(h[j] for j in places), residual, width)
        self.cuts.append(cut)
        return cut


def _keeps(cut: Cut, push: Vector, left: Range) -> bool:
    """Return whether a relation leaves some of the x that are left; they become fewer."""
    ends = cut.leaves(push)
    if ends is not None:
        left.meet(*ends, cut)
        return not left.empty
    if abs(cut.residual) <= cut.width:
        return True
    left.low, left.high, left.by_low, left.by_high = ONE, ZERO, cut, None  # violated whatever x is
    return False


def _next_left(cut: Cut, push: Push, sign: int, size: Fraction) -> Fraction | None:
    """Return the first |x| from a size on, on one side of 0, that a relation leaves; None: there is none."""
    slope, bend = sign * cut.share(push.first), cut.share(push.second)
    off = cut.residual - slope * size - bend * size * size
    if abs(off) <= cut.width:
        return size
    # the residual has to come to the end of the width that is nearer
    end = cut.residual - cut.width
    if off < 0:
        end = cut.residual + cut.width
    return _root_above(bend, slope, -end, size)


def _root_above(a: Fraction, b: Fraction, c: Fraction, low: Fraction) -> Fraction | None:
    """Return the first root of a s^2 + b s + c above low >= 0, rounded up; None where there is none."""
    if not a:
        if not b or -c / b <= low:
            return None
        return -c / b
    square = b * b - 4 * a * c
    if square < 0:
        return None
    # sqrt(p / q) = sqrt(p q) / q, of which isqrt gives the whole part
    fine = 10 ** (2 * DIGITS)
    whole = isqrt(square.numerator * square.denominator * fine * fine)
    roots = []
    for sign in (1, -1):
        ends = []
        for sqrt in (whole, whole + 1):
            ends.append((sign * Fraction(sqrt, square.denominator * fine) - b) / (2 * a))
        roots.append(max(ends))
    above = [root for root in roots if root > low]
    if not above:
        return None
    return rounded_up(min(above), DIGITS)


def _is_bounded(fault: NamedFault) -> bool:
    stated = (fault.sign, fault.least, fault.most, fault.between)
    return any(value is not None for value in stated)


def _widest(fault: NamedFault) -> tuple[Fraction | None, Fraction | None]:
    """Return the ends of x where nothing is stated of the size."""
    if fault.kind == "gain" and fault.output is not None:
        return unknown_at(fault, Fraction(MOST_GAIN)), None
    return None, None


def _ranges(fault: NamedFault) -> list[Range]:
    """Return the x that the sign and the bounds of a size leave: one range, or one on each side of 0."""
    if fault.sign is None and fault.least is None and fault.most is None:
        return [Range(*_widest(fault))]
    least = fault.least or ZERO
    signs = [1, -1]
    if fault.sign is not None:
        signs = [1 - 2 * (fault.sign == "-")]
    ranges = []
    for sign in signs:
        ends: list[Fraction | None] = [unknown_at(fault, sign * least), None]
        if fault.most is not None:
            ends[1] = unknown_at(fault, sign * fault.most)
        elif fault.kind == "gain" and fault.output is not None and sign > 0:
            ends[1] = unknown_at(fault, Fraction(MOST_GAIN))
        if (sign < 0) == _reversing(fault):
            ranges.append(Range(ends[0], ends[1]))
        else:
            ranges.append(Range(ends[1], ends[0]))
    return ranges


def _reversing(fault: NamedFault) -> bool:
    """Return whether x falls where the size grows."""
    return fault.kind == "gain" and fault.output is not None
