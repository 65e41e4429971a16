"""The sizes of one named fault alone that explain a window, exactly: the smallest and the largest, or the
proof that no size does. The smallest error of one sensor alone is one of them.

A relation h with h E = 0 lies between two ends that samples and bounds give; 0 has to lie there, too. With a
fault of an unknown x that is supposed (`supposed`) the upper end is

    c + sum_i |h_i| F_i(a_i + b_i x + c_i x^2),

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

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import chain
from math import isqrt
from typing import NamedTuple, Self

from jaxbound.certificates.exact_window import ExactWindow, Explanation, rounded_up, rounded_witness
from jaxbound.certificates.supposed import Push, Side, error_of, limits_of, push_of, with_fault
from jaxbound.exact.linalg import Vector, dot
from jaxbound.models.named_faults import NamedFault

__all__ = ["FaultSize", "Scale", "SensorError"]

ZERO, ONE = Fraction(0), Fraction(1)
DIGITS = 12
"""Of a root that is no fraction."""
MOST_GAIN = Fraction(10**6)
"""The largest gain error of a sensor that is looked at."""
DEAD = Fraction(10**400)
"""1 / |1 + f| from which on a gain of a sensor counts as 0: no float is smaller."""
FAR = Fraction(10**12)
"""The largest size that is looked at of a fault without any bound."""


@dataclass(frozen=True)
class SensorError:
    """Fields: output, its number; size: the smallest error that explains the window, in the unit of the
    output, None where no error does;
    h: the relation that proves it, violated by any smaller one; enough: size rounded up; window: with an
    error of that size; z: unknowns that explain one of `enough`.
    """

    output: int
    size: Fraction | None
    h: Vector
    enough: Fraction | None = None
    window: ExactWindow | None = None
    z: Vector | None = None


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


class Path(NamedTuple):
    """Sizes of one sign of a fault, of magnitudes from `least` to `most`, None: without end.

    The unknown x is the size; of the gain of a sensor it is 1 / (1 + size); inverted: that is below 0.
    """

    push: Push
    sign: int
    least: Fraction = ZERO
    most: Fraction | None = None
    is_gain: bool = False
    inverted: bool = False

    @property
    def forward(self) -> int:
        """The sign of x along growing magnitudes, 1 or -1."""
        if self.is_gain:
            return -self.sign
        return self.sign

    def x(self, magnitude: Fraction | None) -> Fraction | None:
        """Return the unknown at a magnitude; None: without end."""
        if magnitude is None:
            return None
        size = self.sign * magnitude
        if not self.is_gain:
            return size
        if size != -1:
            return 1 / (1 + size)
        if self.inverted:
            return -DEAD
        return None

    def size(self, x: Fraction) -> Fraction:
        """Return the size of an unknown."""
        if self.is_gain:
            return ONE / x - ONE
        return x

    def within(self, least: Fraction, most: Fraction | None = None) -> Self | None:
        """Return the part of it between two magnitudes; None: there is none."""
        begin, end = max(self.least, least), self.most
        if most is not None and (end is None or most < end):
            end = most
        if (end is not None and end < begin) or self.x(begin) is None:
            return None
        return self._replace(least=begin, most=end)


@dataclass(frozen=True, eq=False)
class End:
    """The upper end of a relation as a fault grows along a Path: at t it is c + m t + q t^2 + the terms.

    Fields: c, m, q; terms: (weight, Side in t) of rows with a tolerance whose ends the fault moves.
    """

    c: Fraction
    m: Fraction
    q: Fraction
    terms: tuple[tuple[Fraction, Side], ...]

    def next_kept(self, t: Fraction) -> Fraction | None:
        """Return the first t' >= t at which the end is not below 0; None: there is none."""
        kinks = {-side.a / side.b for _, side in self.terms if side.b}
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
        for weight, side in self.terms:
            slope = weight / (ONE - side.sigma)
            if side.a + side.b * inside < 0:
                slope = weight / (ONE + side.sigma)
            c += slope * side.a
            m += slope * side.b
        return c, m


def ends_of(cut: Cut, push: Push, forward: int, window: ExactWindow) -> list[End]:
    """Return the End of a relation h, and that of -h, in t = forward x."""
    used = [(cut.h[row], sides, window.known_limits(row)) for row, sides in push.items() if cut.h[row]]
    ends = []
    for sign in (1, -1):
        steady, m, q, terms = [], [], [], []
        for h, (low, high), (lo, hi) in used:
            side, end = high, hi
            if sign * h < 0:
                side, end = low, -lo
            weight = abs(h)
            if side.sigma:
                terms.append((weight, side._replace(b=forward * side.b)))
                steady.append((weight, -end))  # what its side says instead
                continue
            m.append((weight, side.b))
            if side.a != end:
                steady.append((weight, side.a - end))
            if side.c:
                q.append((weight, side.c))
        c = sign * cut.residual + cut.width + _summed(steady)
        ends.append(End(c, forward * _summed(m), _summed(q), tuple(terms)))
    return ends


def _summed(products: Sequence[tuple[Fraction, Fraction]]) -> Fraction:
    if not products:
        return ZERO
    return dot(*zip(*products, strict=True))


class Reached(NamedTuple):
    """The first x of a path that explains a window. Fields: x, z: unknowns with it; z None: none explains.
    proof: relations that leave none, by their numbers; last: the one that leaves the least, or none.
    """

    x: Fraction
    z: Vector | None
    proof: Mapping[int, Vector]
    last: Vector


@dataclass(eq=False)
class Scale:
    """The sizes of named faults of one window, and the relations that were collected for them.

    Fields: window; explanation: of the window without a fault; cuts: of relations that faults violate;
    pushes: of a fault, its first sample and whether it is inverted.
    """

    window: ExactWindow
    explanation: Explanation
    cuts: list[Cut] = field(default_factory=list)
    pushes: dict[tuple[NamedFault, int, bool], Push] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._add(self.explanation.h)

    def error(self, i: int) -> SensorError:
        """Return the SensorError of output i."""
        push = error_of(i, self.window)
        size, z, _, h = self._reached(Path(push, 1))
        if z is None:
            return SensorError(i, None, h)
        if not size:
            return SensorError(i, size, h)
        enough = rounded_up(size)
        wider = with_fault(self.window, push, enough)
        z = rounded_witness(wider, wider.solve(self.explanation.reference).z)  # fewer digits than at `size`
        return SensorError(i, size, h, enough, with_fault(self.window, push, size), z)

    def weigh(self, fault: NamedFault, onsets: Iterable[int] = (0,)) -> FaultSize:
        """Return the FaultSize of a fault: of all onsets that of the smallest size.

        Args:
            fault: of the model of the window. onsets: samples of the window from one of which on it is
                constant; before that there is none.

        Raises:
            NotImplementedError: as `push_of`.
        """
        paths = {since: list(self._paths(fault, since)) for since in onsets}
        best: tuple[Fraction, int, Path, Fraction, Vector] | None = None
        beyond: Fraction | None = None
        proofs = []
        for since, own in paths.items():
            proof: dict[int, Vector] = {}
            for path in own:
                nearer: Path | None = path
                if best is not None:
                    nearer = path.within(ZERO, abs(best[0]))
                if nearer is None:
                    continue
                x, z, passed, _ = self._reached(nearer)
                if z is None:
                    proof |= passed
                elif best is None or abs(path.size(x)) < abs(best[0]):
                    best = path.size(x), since, path, x, z
            proofs.append(tuple(proof.values()))
            if best is None and _is_bounded(fault):
                beyond = self._beyond(fault, since, beyond)
        if best is None:
            return FaultSize(fault, None, None, beyond, tuple(proofs))
        size, since, path, x, z = best
        z = rounded_witness(with_fault(self.window, path.push, x), z)
        largest = self._largest(chain.from_iterable(paths.values()), size)
        return FaultSize(fault, size, since, z=z, largest=largest)

    def _largest(self, paths: Iterable[Path], size: Fraction) -> Fraction | None:
        """Return the largest size of the sign of the smallest that explains; None: without end."""
        for path in paths:
            farther = path.within(abs(size))
            if farther is None or path.sign * size < 0:
                continue
            x, z, *_ = self._reached(farther, backward=True)
            if z is None:
                continue
            if farther.x(farther.most) is None and abs(x) >= FAR:
                return None
            size = path.size(x)
        return size

    def _beyond(self, fault: NamedFault, since: int, known: Fraction | None) -> Fraction | None:
        """Return the smaller of a size and of the smallest that explains, whatever is stated of it."""
        for path in self._paths(fault, since, stated=False):
            x, z, *_ = self._reached(path)
            if z is not None and (known is None or abs(path.size(x)) < abs(known)):
                known = path.size(x)
        return known

    def _paths(self, fault: NamedFault, since: int, stated: bool = True) -> Iterator[Path]:
        """Yield the sizes of a fault that begins at a sample of the window as paths; stated: those that keep
        what is stated of it.

        Raises:
            NotImplementedError: as `push_of`.
        """
        signs, least, most = [1, -1], ZERO, None
        low, high = None, None
        if stated:
            least, most = fault.least or ZERO, fault.most
            low, high = limits_of(fault, self.window, since)
        if stated and fault.sign is not None:
            signs = [1 - 2 * (fault.sign == "-")]
        is_gain = fault.kind == "gain" and fault.output is not None
        every = []
        for sign in signs:
            path = Path(self._push(fault, since), sign, is_gain=is_gain)
            begin, end = (low, high)[::sign]
            if begin is not None:
                path = path._replace(least=max(ZERO, sign * begin))
            if end is not None:
                path = path._replace(most=sign * end)
            if is_gain and sign < 0:
                path = path._replace(most=ONE)
                every.append(Path(self._push(fault, since, True), sign, ONE, None, is_gain, inverted=True))
            every.append(path)
        if is_gain and most is None:
            most = MOST_GAIN
        for path in every:
            part = path.within(least, most)
            if part is not None:
                yield part

    def _push(self, fault: NamedFault, since: int, inverted: bool = False) -> Push:
        """Return the Push of a fault, worked out once."""
        about = fault, since, inverted
        if about not in self.pushes:
            self.pushes[about] = push_of(fault, self.window, since, inverted)
        return self.pushes[about]

    def _reached(self, path: Path, backward: bool = False) -> Reached:
        """Return the first x of a path that explains the window; backward: from the largest size on."""
        forward, start, stop = path.forward, path.x(path.least), path.x(path.most)
        assert start is not None, "a path begins at a size"
        t, end = forward * start, None
        if stop is not None:
            end = forward * stop
        if backward:
            if end is None:
                end = max(t, ONE) * FAR
            forward, t, end = -forward, -end, -t
        passed: dict[int, Vector] = {}
        ends: list[End] = []
        best, last = self.explanation, self.explanation.h
        while True:
            for cut in self.cuts[len(ends) // 2 :]:
                ends += ends_of(cut, path.push, forward, self.window)
            here = t
            for i, upper in enumerate(ends):
                farther = upper.next_kept(t)
                if farther == t:
                    continue
                last = passed[i // 2] = self.cuts[i // 2].h
                if farther is None or (end is not None and farther > end):
                    return Reached(forward * t, None, passed, last)
                t = farther
            if t > here:
                continue
            best = with_fault(self.window, path.push, forward * t).solve(best.reference)
            if best.factor <= 1:
                return Reached(forward * t, best.z, passed, last)
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
