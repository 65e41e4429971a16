"""The sizes of one named fault alone that explain a window, exactly: the smallest and the largest, or the
proof that no size does.

A relation h with h E = 0 lies between two ends that samples and bounds give; 0 has to lie there, too. With a
fault of an unknown x that is supposed (`supposed`) the upper end is

    c + m x + q x^2 + sum_i |h_i| F_i(a_i + b_i x),

where the sum is over rows whose ends x moves, and so it is of -h. It is piecewise linear, or a parabola, so
the x that a relation leaves are known exactly. From 0 on, in either direction, x goes to the next that all
relations leave which are there; the window with that x is solved exactly, and what is violated there is one
more relation, for all faults and all onsets of this window. The end is an x that explains the window while no
smaller one does, or a relation that leaves no x farther on: with those that were passed a proof. There are
finitely many relations that a window can violate most, so there is an end. The largest size is found from the
other side.

Roots of a parabola (a square of x moves the window: `cool` and `cool2`) are rounded on in the last of 12
digits, so such a size explains, and none smaller by more than that does.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import isqrt
from types import MappingProxyType
from typing import NamedTuple

from jaxbound.certificates.blame import rounded_up, rounded_witness
from jaxbound.certificates.exact_window import ExactWindow, Explanation
from jaxbound.certificates.supposed import Line, Path, at_any_size, paths_of
from jaxbound.exact.linalg import Vector, dot
from jaxbound.models.named_faults import NamedFault

__all__ = ["FaultSize", "Scale"]

ZERO, ONE = Fraction(0), Fraction(1)
DIGITS = 12
"""Of a root that is no fraction."""


@dataclass(frozen=True, eq=False)
class FaultSize:
    """A named fault, and whether it alone explains a window.

    Fields: fault; size: the smallest that does, signed, exact; None: none does, proved; largest: of the same
    sign, that does, exact; None: there is no end, or it is not known; varies: of several windows, no one size
    explains all: `size` is the most that one of them takes; since: the sample of
    the window from which on it is constant, None for an excluded one: from none; beyond: of an excluded one,
    the smallest size that would explain the window although its sign or bounds rule it out, None where none
    does; proof: the relations h, ((h, h, ..), ..), for each onset, that leave no size;
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
    largest: Fraction | None = None
    varies: bool = False

    def and_of(self, other: "FaultSize") -> "FaultSize":
        """Return the FaultSize of two windows with sizes of one sign: those that explain both."""
        one, two = self, other
        if abs(two.size or ZERO) > abs(one.size or ZERO):
            one, two = other, self
        ends = [each.largest for each in (one, two) if each.largest is not None]
        largest = min(ends, key=abs, default=None)
        varies = one.varies or two.varies or (largest is not None and abs(largest) < abs(one.size or ZERO))
        return replace(one, largest=largest, varies=varies)


class Cut(NamedTuple):
    """A relation of a window without a fault. Fields: h; residual, width."""

    h: Vector
    residual: Fraction
    width: Fraction


@dataclass(frozen=True, eq=False)
class End:
    """The upper end of a relation as a fault grows along a Path: at t it is c + m t + q t^2 + the terms.

    Fields: c, m, q; terms: (weight, Line in t) of rows whose ends the fault moves.
    """

    c: Fraction
    m: Fraction
    q: Fraction
    terms: tuple[tuple[Fraction, Line], ...]

    def next_kept(self, t: Fraction) -> Fraction | None:
        """Return the first t' >= t at which the end is not below 0; None: there is none."""
        kinks = {-line.a / line.b for _, line in self.terms if line.b and line.sigma}
        for stop in [*sorted(kink for kink in kinks if kink > t), None]:
            c, m = self._piece(t, stop)
            if c + m * t + self.q * t * t >= 0:
                return t
            root = _root_above(self.q, m, c, t)
            if root is not None and (stop is None or root <= stop):
                return root
            if stop is not None:
                t = stop
        return None

    def _piece(self, begin: Fraction, stop: Fraction | None) -> tuple[Fraction, Fraction]:
        """Return (c, m) between two kinks, with the terms: each is linear there."""
        c, m = self.c, self.m
        inside = begin + 1
        if stop is not None:
            inside = (begin + stop) / 2
        for weight, line in self.terms:
            slope = weight / (ONE - line.sigma)
            if line.a + line.b * inside < 0:
                slope = weight / (ONE + line.sigma)
            c += slope * line.a
            m += slope * line.b
        return c, m


def ends_of(cut: Cut, path: Path, window: ExactWindow) -> tuple[End, End]:
    """Return the End of a relation h, and that of -h."""
    push, forward = path.push, path.forward
    m, q = -forward * dot(cut.h, push.first), ZERO
    if push.second:
        q = -dot(cut.h, push.second)
    most = {1: cut.residual + cut.width, -1: cut.width - cut.residual}
    terms: dict[int, list[tuple[Fraction, Line]]] = {1: [], -1: []}
    for row, (low, high) in push.ends.items():
        h = cut.h[row]
        if not h:
            continue
        lo, hi = window.known_limits(row)
        for side in (1, -1):
            most[side] -= max(side * h * lo, side * h * hi)  # what the terms say instead
            line = (high, low)[side * h < 0]
            terms[side].append((abs(h), line._replace(b=forward * line.b)))
    return End(most[1], m, q, tuple(terms[1])), End(most[-1], -m, -q, tuple(terms[-1]))


class Reached(NamedTuple):
    """The first t of a path that explains a window. Fields: t, z: unknowns with it; None where none explains.
    proof: relations that leave none, by their numbers.
    """

    t: Fraction = ZERO
    z: Vector | None = None
    proof: Mapping[int, Vector] = MappingProxyType({})


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
            NotImplementedError: as `paths_of`.
        """
        onsets = tuple(onsets)
        best: tuple[Fraction, int, Path, Fraction, Vector] | None = None
        beyond: Fraction | None = None
        proofs = []
        for since in onsets:
            proof: dict[int, Vector] = {}
            for path in paths_of(fault, self.window, since):
                if best is not None:
                    nearer = path.of_sizes_to(abs(best[0]))
                    if nearer is None:
                        continue
                    path = nearer
                reached = self._reached(path)
                if reached.z is None:
                    proof |= reached.proof
                    continue
                size = path.size(reached.t)
                if best is None or abs(size) < abs(best[0]):
                    best = size, since, path, reached.t, reached.z
            proofs.append(tuple(proof.values()))
            if best is None and _is_bounded(fault):
                beyond = self._beyond(fault, since, beyond)
        if best is None:
            return FaultSize(fault, None, None, beyond, tuple(proofs))
        size, since, path, t, z = best
        here = path.push.window(self.window, path.x(t))
        largest = self._largest(fault, onsets, size)
        return FaultSize(fault, size, since, z=rounded_witness(here, z), largest=largest)

    def _largest(self, fault: NamedFault, onsets: Sequence[int], size: Fraction) -> Fraction | None:
        """Return the largest size of the sign of the smallest that explains, whatever its onset; None:
        without end.
        """
        for since in onsets:
            for path in paths_of(fault, self.window, since):
                farther = path.of_sizes_from(abs(size))
                if farther is None or path.sign * size < 0:
                    continue
                back = farther.reversed
                reached = self._reached(back)
                if reached.z is None:
                    continue
                if farther.stop is None and reached.t == back.start:
                    return None
                size = back.size(reached.t)
        return size

    def _beyond(self, fault: NamedFault, since: int, known: Fraction | None) -> Fraction | None:
        """Return the smaller of a size and of the smallest that explains, whatever is stated of it."""
        for path in paths_of(at_any_size(fault), self.window, since):
            reached = self._reached(path)
            if reached.z is None:
                continue
            size = path.size(reached.t)
            if known is None or abs(size) < abs(known):
                known = size
        return known

    def _reached(self, path: Path) -> Reached:
        """Return the first t of a path that explains the window."""
        t, ends = path.start, list[End]()
        passed: dict[int, Vector] = {}
        while True:
            for cut in self.cuts[len(ends) // 2 :]:
                ends += ends_of(cut, path, self.window)
            here = t
            for i, end in enumerate(ends):
                farther = end.next_kept(t)
                if farther != t:
                    passed[i // 2] = self.cuts[i // 2].h
                if farther is None or (path.stop is not None and farther > path.stop):
                    return Reached(proof=passed)
                t = farther
            if t > here:
                continue
            best = path.push.window(self.window, path.x(t)).solve(self.explanation.reference)
            if best.factor <= 1:
                return Reached(t, best.z)
            self._add(best.h)

    def _add(self, h: Vector) -> None:
        """Collect one more relation."""
        _, residual, width = self.window.relation(h)
        self.cuts.append(Cut(h, residual, width))


def _root_above(a: Fraction, b: Fraction, c: Fraction, low: Fraction) -> Fraction | None:
    """Return the first root of a t^2 + b t + c above low, rounded up where it is no fraction; None where
    there is none.
    """
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
