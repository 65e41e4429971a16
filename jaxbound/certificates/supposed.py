"""A named fault that is supposed: what it does to the rows of a window, in exact rationals.

    (Y, w) = E z + K U + x first + x^2 second,    -F(a + b x) <= a row <= F(a' + b' x)

The rows stay linear in the unknowns z. x is the size f of the fault; of the gain of a sensor it is 1 / (1 +
f). What a faulty sensor shows is defined in `models.named_faults`: with |delta| <= rho a reading y says of
the true value, in deviations from an offset o,

    (bias)  (1 + theta) t = y - o - f - delta        (gain)  (1 + theta) t = x (y - delta) - o

so ends are F(rho + y - o - f) and F(x y + |x| rho - o), F that of `exact_window`. A bias beside no tolerance
moves the row as a whole. An actuator moves every signal that is computed from its column
(`models.shared_columns`); an output that is computed from it was recorded wrong by as much.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import NamedTuple, Self, TypeAlias

from jaxbound.certificates.exact_window import ExactWindow, stretched
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.shared_columns import Follower, Polynomial, followers
from jaxbound.recordings.expressions import expression
from jaxbound.text.names import listed

__all__ = ["Line", "Path", "Push", "at_any_size", "paths_of", "push_of"]

ZERO, ONE = Fraction(0), Fraction(1)
MOST_GAIN = Fraction(10**6)
"""The largest gain error of a sensor that is looked at."""
DEAD = Fraction(10**400)
"""1 / |1 + f| from which on a gain of a sensor counts as 0: no float is smaller."""
FAR = Fraction(10**12)
"""The largest size that is looked at of a fault without any bound."""
Recorded: TypeAlias = list[Fraction | None]
"""Samples of a signal, None where one is missing."""


class Line(NamedTuple):
    """F(a + b x), F of a tolerance sigma."""

    a: Fraction
    b: Fraction
    sigma: Fraction

    def at(self, x: Fraction) -> Fraction:
        """Return its value at x."""
        return stretched(self.a + self.b * x, self.sigma)


@dataclass(frozen=True, eq=False)
class Push:
    """How a fault moves the rows of a window. Fields: first, second: for x and for its square; second is
    empty where x is not squared. ends: {row: (low, high)} of the rows whose ends x moves: [-low, high].
    """

    first: Vector
    second: Vector = ()
    ends: Mapping[int, tuple[Line, Line]] = field(default_factory=dict)

    def at(self, x: Fraction) -> Vector:
        """Return how far an x moves each row."""
        moved = linalg.scale(self.first, x)
        if self.second:
            moved = linalg.add_multiple(moved, x * x, self.second)
        return moved

    def window(self, window: ExactWindow, x: Fraction) -> ExactWindow:
        """Return the window with the fault."""
        moved = window.moved(self.at(x))
        if self.ends:
            limits = list(window.limits)
            for row, (low, high) in self.ends.items():
                limits[row] = -low.at(x), high.at(x)
            vars(moved)["limits"] = limits
        return moved


@dataclass(frozen=True, eq=False)
class Path:
    """Sizes of one sign of a fault, the smallest magnitude first: the unknown is x = forward t, and t grows
    from `start` to `stop`.

    Fields: push; sign: of the sizes; forward: 1 or -1; start, stop: t, stop None: without end. is_gain:
    whether x is 1 / (1 + f).
    """

    push: Push
    sign: int
    forward: int
    start: Fraction
    stop: Fraction | None
    is_gain: bool = False

    def x(self, t: Fraction) -> Fraction:
        """Return the unknown at t."""
        return self.forward * t

    def size(self, t: Fraction) -> Fraction:
        """Return the size f at t."""
        if self.is_gain:
            return ONE / self.x(t) - ONE
        return self.x(t)

    def until(self, stop: Fraction | None) -> Self:
        """Return the part of it up to a t; None: all."""
        if stop is None or (self.stop is not None and self.stop <= stop):
            return self
        return replace(self, stop=stop)

    def of_sizes_to(self, most: Fraction) -> Self | None:
        """Return the part of it of sizes up to a magnitude; None: there is none."""
        end = self._at(most)
        if end is None:
            return self
        if end < self.start:
            return None
        return self.until(end)

    def of_sizes_from(self, least: Fraction) -> Self | None:
        """Return the part of it of sizes from a magnitude on; None: there is none."""
        begin = self._at(least)
        if begin is None or (self.stop is not None and self.stop < begin):
            return None
        return replace(self, start=max(begin, self.start))

    def _at(self, magnitude: Fraction) -> Fraction | None:
        """Return t of a size of a magnitude, below `start` where it comes before; None: behind the end."""
        x = self.sign * magnitude
        if self.is_gain:
            left, inverted = ONE + x, self.x(self.start) < 0
            if left <= 0 and not inverted:
                return None
            if left >= 0 and inverted:
                return self.start - 1
            x = ONE / left
        return self.forward * x

    @property
    def reversed(self) -> Self:
        """The same sizes, the largest magnitude first."""
        far = self.stop
        if far is None:
            far = max(self.start, ONE) * FAR
        return replace(self, forward=-self.forward, start=-far, stop=-self.start)


def at_any_size(fault: NamedFault) -> NamedFault:
    """Return the same fault with nothing stated of its size."""
    free = copy(fault)
    vars(free).update(sign=None, least=None, most=None, between=None)
    return free


def paths_of(fault: NamedFault, window: ExactWindow, since: int = 0) -> list[Path]:
    """Return the sizes of a fault on a window as paths, those of the smallest magnitudes first.

    Args:
        since: the sample of the window at which it begins.

    Raises:
        NotImplementedError: as `push_of`.
    """
    least, most = fault.least or ZERO, fault.most
    signs = [1, -1]
    if fault.sign is not None:
        signs = [1 - 2 * (fault.sign == "-")]
    paths = []
    if fault.kind == "gain" and fault.output is not None:
        for sign in signs:
            paths += _gain_paths(push_of(fault, window, since), sign, least, most)
        if -1 in signs and (most is None or most >= 1):
            paths.append(_inverted_path(push_of(fault, window, since, inverted=True), least, most))
        return paths
    push = push_of(fault, window, since)
    ends = _limits_of(fault, window, since)
    for sign in signs:
        begin, end = ends[::sign]
        start = least
        if begin is not None:
            start = max(start, sign * begin)
        path = Path(push, sign, sign, start, most)
        if end is not None:
            path = path.until(sign * end)
        if path.stop is None or path.stop >= start:
            paths.append(path)
    return paths


def _gain_paths(push: Push, sign: int, least: Fraction, most: Fraction | None) -> list[Path]:
    """Return the path of a sensor's gain 1 + f > 0, in x = 1 / (1 + f), or none."""
    start = ONE + sign * least
    if start <= 0:
        return []
    if sign > 0:
        largest = MOST_GAIN
        if most is not None:
            largest = most
        return [Path(push, sign, -1, -1 / start, -1 / (ONE + largest), is_gain=True)]
    path = Path(push, sign, 1, 1 / start, None, is_gain=True)
    if most is not None and most < 1:
        path = path.until(1 / (ONE - most))
    return [path]


def _inverted_path(push: Push, least: Fraction, most: Fraction | None) -> Path:
    """Return the path of a sensor's gain 1 + f <= 0."""
    start, largest = -DEAD, MOST_GAIN
    if least > 1:
        start = max(start, 1 / (ONE - least))
    if most is not None:
        largest = most
    stop = start
    if largest > 1:
        stop = max(start, 1 / (ONE - largest))
    return Path(push, -1, 1, start, stop, is_gain=True)


def push_of(fault: NamedFault, window: ExactWindow, since: int = 0, inverted: bool = False) -> Push:
    """Return the Push of a fault on the rows of a window.

    Args:
        since: the sample of the window at which it begins. inverted: of the gain of a sensor, it is below 0.

    Raises:
        NotImplementedError: an input that its size is multiplied by is missing; the gain of a sensor whose
            averages are bounded; a signal that is computed from the actuator's column in a way that is not
            followed.
    """
    model = window.model
    if fault.output is not None and fault.kind == "gain":
        return _push_of_gain(fault.output, window, since, inverted)
    shares = _shares(fault, window)
    shares[:since] = [ZERO] * since
    if fault.input is not None:
        return _push_of_actuator(fault.input, window, shares)
    on_states: Vector = (ZERO,) * model.n
    on_outputs: Vector = (ZERO,) * model.p
    if fault.output is not None:
        i = model.outputs.index(fault.output)
        if window.tolerance[i]:
            return _push_behind_tolerance(i, window, shares)
        on_outputs = linalg.identity(model.p)[i]
    else:
        shares_of = dict(fault.states)
        on_states = tuple(shares_of.get(name, ZERO) for name in model.states)
    return Push(_response(window, on_states, on_outputs, shares))


def _push_behind_tolerance(i: int, window: ExactWindow, shares: Sequence[Fraction]) -> Push:
    """Return the Push of a bias of an output that has a tolerance, whose averages have no bounds."""
    ends = {}
    for j, (d, rho) in enumerate(window.readings()):
        share = shares[j // window.model.p]
        if j % window.model.p == i and d is not None and share:
            sigma = window.tolerance[i]
            ends[j] = Line(rho - d, share, sigma), Line(rho + d, -share, sigma)
    return Push((ZERO,) * len(window.limits), (), ends)


def _push_of_gain(name: str, window: ExactWindow, since: int, inverted: bool) -> Push:
    """Return the Push of the gain of an output, in x = 1 / (1 + f)."""
    model = window.model
    i = model.outputs.index(name)
    if any(row.values.measured and row.values.size_of(i) for row in window.rows.of_sums):
        raise NotImplementedError(
            f"its gain shows in the bounds on averages of {name}, where it is not followed"
        )
    sigma, offset = window.tolerance[i], model.offset["y"][i]
    ends = {}
    for j, (d, rho) in enumerate(window.readings()):
        if j % model.p != i or j // model.p < since or d is None:
            continue
        if inverted:
            rho = -rho  # |x| = -x
        y = d + offset
        ends[j] = Line(offset, rho - y, sigma), Line(-offset, rho + y, sigma)
    return Push((ZERO,) * len(window.limits), (), ends)


def _limits_of(fault: NamedFault, window: ExactWindow, since: int) -> tuple[Fraction | None, Fraction | None]:
    """Return the lowest and the highest x that leave an actuator between what it can do; None: no end."""
    low: Fraction | None = None
    high: Fraction | None = None
    if fault.between is None or fault.input is None:
        return low, high
    least, most = fault.between
    recorded = _input(window, window.model.inputs.index(fault.input))
    for u, share in list(zip(recorded, _shares(fault, window), strict=True))[since:]:
        if u is None or not share:
            continue
        ends = sorted([(least - u) / share, (most - u) / share])
        if low is None or ends[0] > low:
            low = ends[0]
        if high is None or ends[1] < high:
            high = ends[1]
    return low, high


def _push_of_actuator(name: str, window: ExactWindow, shares: Sequence[Fraction]) -> Push:
    """Return the Push of an input that is another than was recorded, and of what is computed from it."""
    model = window.model
    first: Vector = (ZERO,) * len(window.limits)
    second: Vector = ()
    for signal in followers(model, name):
        by_power = _powers(window, signal, shares)
        on_states: Vector = (ZERO,) * model.n
        if signal.is_input:
            on_states = tuple(row[signal.number] for row in model.B)
            on_outputs = tuple(row[signal.number] for row in model.D)
        elif window.tolerance[signal.number]:
            raise NotImplementedError(
                f"{signal.signal} is computed from the same column and has a tolerance: give it as noise"
            )
        else:  # recorded from the same column, so wrong by as much
            on_outputs = linalg.scale(linalg.identity(model.p)[signal.number], -1)
        first = linalg.add_multiple(first, 1, _response(window, on_states, on_outputs, by_power[0]))
        if len(by_power) > 1:
            moved = _response(window, on_states, on_outputs, by_power[1])
            second = linalg.add_multiple(second or (ZERO,) * len(first), 1, moved)
    return Push(first, second)


def _powers(window: ExactWindow, signal: Follower, shares: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return by how much a signal moves at each sample, for x and perhaps for its square."""
    model = window.model
    if signal.powers is None or len(signal.powers) > 2:
        raise NotImplementedError(
            f"{signal.signal} is computed from the same column, by more than sums and products of up to two"
        )
    if len(signal.powers) > 1 and "every" in model.columns:
        raise NotImplementedError(f"{signal.signal} is the mean of a square of the same column")
    if signal.is_input:
        own = _input(window, signal.number)
    else:
        own = list(window.whole[signal.number :: model.p])
    by_power = []
    for i, polynomial in enumerate(signal.powers):
        moved = []
        for k, share in enumerate(shares):
            weight = ZERO  # a signal that is missing is an unknown of the window, or says nothing
            if share and own[k] is not None:
                weight = _weight(window, signal, polynomial, k)
            moved.append(weight * share ** (i + 1))
        by_power.append(moved)
    return by_power


def _weight(window: ExactWindow, signal: Follower, polynomial: Polynomial, k: int) -> Fraction:
    """Return the value of a polynomial in recorded columns at a sample."""
    model, total = window.model, ZERO
    columns: dict[str, Fraction | None] = {}
    for j, name in enumerate(model.inputs):
        columns.setdefault(model.column(name).strip(), _input(window, j)[k])
    for names, coefficient in polynomial.items():
        product = coefficient
        for name in names:
            value = columns.get(name)
            if value is None:
                return _quotient(window, signal, columns.get(signal.column), k)
            product *= value
        total += product
    return total


def _quotient(window: ExactWindow, signal: Follower, factor: Fraction | None, k: int) -> Fraction:
    """Return the factor beside the column in a signal that is their product: its value over that of the
    column.
    """
    model = window.model
    if not signal.products or not factor:
        text = model.column(signal.signal)
        there = {model.column(name).strip() for name in model.inputs}
        lost = [name for name in expression(text).columns if name not in there]
        raise NotImplementedError(
            f"{signal.signal} is computed from the same column and from {listed(lost or [signal.column])}, "
            f"of which the window has no sample: make it an input"
        )
    if signal.is_input:
        value = _input(window, signal.number)[k]
    else:
        value = window.whole[k * model.p + signal.number]
    assert value is not None, "a signal that is missing has no weight"
    return value / factor


def _input(window: ExactWindow, j: int) -> Recorded:
    """Return the samples of an input, None behind the last that the window reads."""
    recorded = list(window.u[j :: window.model.m])
    return recorded + [None] * (window.horizon + 1 - len(recorded))


def _shares(fault: NamedFault, window: ExactWindow) -> list[Fraction]:
    """Return the factor of x at each sample: 1, or a recorded input."""
    samples, model = window.horizon + 1, window.model
    by = fault.times
    if fault.kind == "gain":
        by = fault.input
    if by is None:
        return [ONE] * samples
    recorded = _input(window, model.inputs.index(by))
    missing = recorded
    if fault.output is None and not model.has_feedthrough:
        missing = recorded[:-1]  # what the newest sample of an input does shows later
    if fault.times is not None and None in missing:
        raise NotImplementedError(f"a sample of {fault.times} is missing, which its size is multiplied by")
    # an input that is missing is an unknown of the window: whatever its gain, nothing more is known of it
    return [x or ZERO for x in recorded]


def _response(
    window: ExactWindow, on_states: Vector, on_outputs: Vector, shares: Sequence[Fraction]
) -> Vector:
    """Return how the rows of a window are moved by a signal that acts on states and outputs."""
    model = window.model
    state: Vector = (ZERO,) * model.n
    moved: list[Fraction] = []
    for share in shares:
        outputs: Vector = (ZERO,) * model.p
        if any(state):
            outputs = linalg.multiply(model.C, state)
        moved += linalg.add_multiple(outputs, share, on_outputs)
        if model.n:
            state = linalg.add_multiple(linalg.multiply(model.A, state), share, on_states)
    moved += [ZERO] * (model.g * window.horizon)
    for row in window.rows.of_sums:
        total = ZERO
        for term in window.rows.terms(row):
            total += term.weight * moved[term.row]
        moved.append(total)
    return tuple(moved)
