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
from copy import copy
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import chain
from math import isqrt
from typing import NamedTuple, Self, TypeAlias

from jaxbound.certificates.exact_window import ExactWindow, rounded_up, rounded_witness
from jaxbound.certificates.supposed import Push, Side, error_of, limits_of, pushes_of, with_fault
from jaxbound.exact.linalg import Vector, dot
from jaxbound.models.named_faults import NamedFault

ZERO, ONE = Fraction(0), Fraction(1)
DIGITS = 12
"""Of a root that is no fraction."""
MOST_GAIN = Fraction(10**6)
"""The largest gain error of a sensor that is looked at."""
ENDLESS = Fraction(10**400)
"""A size, or a 1 / |1 + f| of the gain of a sensor, that no float has."""
Cut: TypeAlias = tuple[Vector, Fraction, Fraction]
"""(h, residual, width) of a relation of a window without a fault."""
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
    does; z: unknowns that explain the window with it. tried: of a parameter how many pairs of a size and an
    onset were tried: its size is the smallest of those that explain, and None is no proof.
    """

    fault: NamedFault
    size: Fraction | None
    since: int | None = None
    beyond: Fraction | None = None
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
        # what is too large for one window is too large for both
        largest = min(ends, key=abs, default=None)
        varies = one.varies or two.varies or (largest is not None and abs(largest) < abs(one.size or ZERO))
        return replace(one, largest=largest, varies=varies)


class Path(NamedTuple):
    """Sizes of one sign of a fault, from the one that is nearest to 0 to the farthest.

    The unknown x is the size; of the gain of a sensor it is 1 / (1 + size), which has no end near -1.
    side: of a gain the sign of 1 + size, 0 of another fault.
    """

    push: Push
    near: Fraction
    far: Fraction
    side: int = 0

    def x(self, size: Fraction) -> Fraction:
        """Return the unknown at a size."""
        if not self.side:
            return size
        # 1 / (1 + size) has no value there: x is farther than any float on that side
        if size == -1:
            return self.side * ENDLESS
        return 1 / (1 + size)

    def size(self, x: Fraction) -> Fraction:
        """Return the size of an unknown."""
        if self.side:
            return ONE / x - ONE
        return x

    def between(self, least: Fraction, most: Fraction) -> Self | None:
        """Return the part of it between two magnitudes; None: there is none."""
        least, most = max(least, abs(self.near)), min(most, abs(self.far))
        if most < least:
            return None
        sign = 1
        if self.far + self.near < 0:
            sign = -1
        return self._replace(near=sign * least, far=sign * most)


Paths: TypeAlias = Mapping[int, Sequence[Path]]
"""The sizes of a fault that begins at a sample of the window."""


class End(NamedTuple):
    """The upper end of a relation h as a fault grows along a Path, in t = forward x: whole at x + the sum of
    all weight * side.

    Fields: h; whole; forward; bent: (weight, Side) of the rows of a sensor with a tolerance.
    """

    h: Vector
    whole: Side
    forward: int
    bent: Sequence[tuple[Fraction, Side]]

    def at(self, t: Fraction) -> Fraction:
        """Return its value."""
        x = self.forward * t
        return self.whole.at(x) + sum((weight * side.at(x) for weight, side in self.bent), ZERO)

    def next_kept(self, t: Fraction) -> Fraction | None:
        """Return the first t' >= t at which the end is not below 0; None: there is none."""
        if self.at(t) >= 0:
            return t
        # the end is a parabola from one kink to the next: each is searched for its root alone
        kinks = {-side.a / (self.forward * side.b) for _, side in self.bent if side.b}
        for stop in [*sorted(kink for kink in kinks if kink > t), None]:
            # a parabola between two kinks: through three of its points
            step = ONE
            if stop is not None:
                step = (stop - t) / 2
            low, middle, high = (self.at(t + k * step) for k in range(3))
            bend = (high - 2 * middle + low) / (2 * step * step)
            root = _root_above(bend, (middle - low) / step - bend * step, low, ZERO)
            if root is not None and (stop is None or t + root <= stop):
                return t + root
            if stop is not None:
                t = stop
                if self.at(t) >= 0:  # the root was rounded past it
                    return t
        return None


def ends_of(cut: Cut, push: Push, forward: int, window: ExactWindow) -> Iterator[End]:
    """Yield the End of a relation h, and that of -h, in t = forward x."""
    h, residual, width = cut
    for sign in (1, -1):
        weights, moved, bent = [ONE], [Side(sign * residual + width, ZERO)], []
        for row, (low, high) in push.items():
            if h[row]:
                side, end = high, window.known_limits(row)[1]
                if sign * h[row] < 0:
                    side, end = low, -window.known_limits(row)[0]
                if side.sigma:
                    bent.append((abs(h[row]), side))
                    side = Side(ZERO, ZERO)
                weights.append(abs(h[row]))
                moved.append(side._replace(a=side.a - end))
        a, b, c, _ = (dot(weights, values) for values in zip(*moved, strict=True))
        yield End(h, Side(a, b, c), forward, bent)


class Reached(NamedTuple):
    """The first x of a path that explains a window. Fields: x, z: unknowns with it; z None: none explains.
    passed: the last relation that leaves no smaller one, None: there was none.
    """

    x: Fraction
    z: Vector | None
    passed: Vector | None


@dataclass(eq=False)
class Scale:
    """The sizes of named faults of one window, and the relations that were collected for them.

    Fields: window; h: the relation that it violates most; cuts: relations that faults violate; errors,
    without: what was worked out of outputs and of inputs.
    """

    window: ExactWindow
    h: Vector
    cuts: list[Cut] = field(default_factory=list)
    errors: dict[int, SensorError] = field(default_factory=dict)
    without: dict[int, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._add(self.h)

    def _add(self, h: Vector) -> None:
        """Collect one more relation."""
        self.cuts.append((h, *self.window.relation(h)[1:]))

    def explained_without(self, i: int) -> bool:
        """Return whether something explains the window, whatever the actuator of input i did."""
        if i not in self.without:
            self.without[i] = self.window.without_input(i).is_explained()
        return self.without[i]

    def error(self, i: int) -> SensorError:
        """Return the SensorError of output i."""
        if i not in self.errors:
            self.errors[i] = self._error(i)
        return self.errors[i]

    def _error(self, i: int) -> SensorError:
        push = error_of(i, self.window)
        size, z, passed = self._reached(Path(push, ZERO, ENDLESS))
        h = passed or self.h
        if z is None:
            return SensorError(i, None, h)
        if not size:
            return SensorError(i, size, h)
        # few digits that people read, and still enough: more of the error explains as well
        enough = rounded_up(size)
        wider = with_fault(self.window, push, enough)
        z = rounded_witness(wider, wider.solve().z)  # fewer digits than at `size`
        return SensorError(i, size, h, enough, with_fault(self.window, push, size), z)

    def weigh(self, fault: NamedFault, onsets: Iterable[int] = (0,)) -> FaultSize:
        """Return the FaultSize of a fault: of all onsets that of the smallest size.

        Args:
            fault: of the model of the window. onsets: samples of the window from one of which on it is
                constant; before that there is none.

        Raises:
            NotImplementedError: as `pushes_of`.
        """
        paths = self._paths(fault, onsets)
        smallest = self._smallest(fault, paths)
        if smallest.size is not None:
            return replace(smallest, largest=self._largest(paths, smallest.size))
        # what is stated of the fault may be all that rules it out: the same fault without that
        bare = copy(fault)
        vars(bare).update(sign=None, least=None, most=None, between=None)
        if bare != fault:
            smallest = replace(smallest, beyond=self._smallest(bare, self._paths(bare, paths)).size)
        return smallest

    def _smallest(self, fault: NamedFault, paths: Paths) -> FaultSize:
        """Return the FaultSize of a fault without its largest size."""
        found, most = None, ENDLESS
        for since, own in paths.items():
            for path in own:
                # farther than the smallest that was found nothing is searched
                nearer = path.between(ZERO, most)
                if nearer is None:
                    continue
                x, z, _ = self._reached(nearer)
                if z is not None and (found is None or abs(path.size(x)) < most):
                    most, found = abs(path.size(x)), (since, path, x, z)
        if found is None:
            return FaultSize(fault, None)
        since, path, x, z = found
        z = rounded_witness(with_fault(self.window, path.push, x), z)
        return FaultSize(fault, path.size(x), since, z=z)

    def _largest(self, paths: Paths, size: Fraction) -> Fraction | None:
        """Return the largest size of the sign of the smallest that explains; None: without end."""
        for path in chain.from_iterable(paths.values()):
            farther = path.between(abs(size), ENDLESS)
            if farther is None or farther.far * size < 0:
                continue
            x, z, _ = self._reached(farther, backward=True)
            if z is None:
                continue
            if farther.side >= 0 and abs(farther.x(farther.far)) == ENDLESS and abs(x) >= FAR:
                return None
            size = path.size(x)
        return size

    def _paths(self, fault: NamedFault, onsets: Iterable[int]) -> Paths:
        """Return the sizes of a fault as paths, for each sample of the window at which it begins.

        Raises:
            NotImplementedError: as `pushes_of`.
        """
        signs, most = [1, -1], ENDLESS
        if fault.most is not None:
            most = fault.most
        if fault.sign is not None:
            signs = [1 - 2 * (fault.sign == "-")]
        pushes = pushes_of(fault, self.window)
        is_gain = fault.kind == "gain" and fault.output is not None
        if is_gain:
            most = min(most, MOST_GAIN)
            inverted = pushes_of(fault, self.window, inverted=True)
        by_onset: dict[int, list[Path]] = {}
        for since in onsets:
            low, high = limits_of(fault, self.window, since, ENDLESS)
            by_onset[since] = []
            for sign in signs:
                near, far = (sign * end for end in (low, high)[::sign])
                paths = [Path(pushes[since], ZERO, sign * ENDLESS, int(is_gain))]
                # below -1 a gain turns the sign: 1 / (1 + f) jumps there from one end to the other
                if is_gain and sign < 0:
                    paths = [
                        Path(inverted[since], -ONE, -ENDLESS, -1),
                        Path(pushes[since], ZERO, -ONE, 1),
                    ]
                for path in paths:
                    part = path.between(max(fault.least or ZERO, near), min(most, far))
                    if part is not None:
                        by_onset[since].append(part)
        return by_onset

    def _reached(self, path: Path, backward: bool = False) -> Reached:
        """Return the first x of a path that explains the window; backward: from the largest size on."""
        t, end = path.x(path.near), path.x(path.far)
        forward = 1
        if end < t:
            forward = -1
        t, end = forward * t, forward * end
        if backward:
            # the far end may have no bound: begun at FAR times the near one
            forward, t, end = -forward, -min(end, max(t, ONE) * FAR), -t
        passed: Vector | None = None
        ends: list[End] = []
        while True:
            here = t
            # relations first, which cost a few products: a program only where none of them is violated
            for number in range(2 * len(self.cuts)):
                if number == len(ends):
                    ends += ends_of(self.cuts[number // 2], path.push, forward, self.window)
                farther = ends[number].next_kept(t)
                if farther == t:
                    continue
                passed = ends[number].h
                if farther is None or (farther > end and ends[number].at(end) < 0):
                    self.cuts.insert(0, self.cuts.pop(number // 2))  # likely to end the next path, too
                    return Reached(forward * t, None, passed)
                t = min(farther, end)  # a root is rounded on
            # a relation was passed: perhaps an earlier one is violated now, which costs no program
            if t > here:
                continue
            best = with_fault(self.window, path.push, forward * t).solve()
            if best.t <= 1:
                return Reached(forward * t, best.z, passed)
            # the relation that this size violates: it rules out smaller ones as well
            self._add(best.h)


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
    # digits behind the point of the root: twice as many as are kept
    fine = 10 ** (2 * DIGITS)
    whole = isqrt(square.numerator * square.denominator * fine * fine)
    roots = []
    for sign in (1, -1):
        ends = []
        for sqrt in (whole, whole + 1):
            ends.append((sign * Fraction(sqrt, square.denominator * fine) - b) / (2 * a))
        # rounded up: at a smaller t the end might still be below 0
        roots.append(max(ends))
    above = [root for root in roots if root > low]
    if not above:
        return None
    return rounded_up(min(above), DIGITS)
