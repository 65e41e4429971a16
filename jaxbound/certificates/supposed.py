"""The push of a named fault on the rows of a window, in exact rationals.

    (Y, w) = E z + K U + x first + x^2 second

Both are known, so the rows stay linear in z, and, but for a square, in x. x is the size of the fault, but for
the gain of a sensor: y / (1 + f) is what the sensor would have shown, y + x y with x = 1 / (1 + f) - 1.

A bias is one of what the sensor sees: where it has a tolerance theta, a reading is (1 + theta) (true + f) +
delta. An actuator moves every signal that is computed from its column (`models.shared_columns`); an output
that is computed from it was recorded wrong by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from jaxbound.certificates.exact_window import ExactWindow
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.shared_columns import Follower, Polynomial, followers
from jaxbound.recordings.expressions import expression
from jaxbound.text.names import listed

__all__ = ["Push", "limits_of", "push_of", "size_at", "unknown_at"]

ZERO, ONE = Fraction(0), Fraction(1)
Recorded: TypeAlias = list[Fraction | None]
"""Samples of a signal, None where one is missing."""


@dataclass(frozen=True, eq=False)
class Push:
    """How a fault moves the rows of a window. Fields: first, second: for x and for its square; second is
    empty where x is not squared.
    """

    first: Vector
    second: Vector = ()

    def at(self, x: Fraction) -> Vector:
        """Return how far an x moves each row."""
        moved = linalg.scale(self.first, x)
        if self.second:
            moved = linalg.add_multiple(moved, x * x, self.second)
        return moved


def push_of(fault: NamedFault, window: ExactWindow, since: int = 0) -> Push:
    """Return the Push of a fault on the rows of a window.

    Args:
        since: the sample of the window at which it begins.

    Raises:
        NotImplementedError: an input that its size is multiplied by is missing; the gain of a sensor with a
            tolerance; a signal that is computed from the actuator's column in a way that is not followed.
    """
    model = window.model
    shares = _shares(fault, window)
    shares[:since] = [ZERO] * since
    if fault.input is not None:
        return _push_of_actuator(fault.input, window, shares)
    on_states: Vector = (ZERO,) * model.n
    on_outputs: Vector = (ZERO,) * model.p
    if fault.output is not None:
        i = model.outputs.index(fault.output)
        on_outputs = linalg.identity(model.p)[i]
        if fault.kind == "gain" and window.tolerance[i]:
            raise NotImplementedError(
                f"the gain of {fault.output} and its tolerance are one number: give the tolerance as noise"
            )
    else:
        shares_of = dict(fault.states)
        on_states = tuple(shares_of.get(name, ZERO) for name in model.states)
    return Push(_response(window, on_states, on_outputs, shares))


def limits_of(
    fault: NamedFault, window: ExactWindow, since: int = 0
) -> tuple[Fraction | None, Fraction | None]:
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
    """Return the factor of x at each sample: 1, a recorded input, or minus the reading of a sensor whose gain
    is wrong.
    """
    samples, model = window.horizon + 1, window.model
    if fault.kind == "gain" and fault.output is not None:
        i = model.outputs.index(fault.output)
        return [-(y or ZERO) for y in window.whole[i :: model.p]]
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


def size_at(fault: NamedFault, x: Fraction) -> Fraction:
    """Return the size of a fault from its unknown x."""
    if fault.kind == "gain" and fault.output is not None:
        return ONE / (ONE + x) - ONE
    return x


def unknown_at(fault: NamedFault, size: Fraction) -> Fraction:
    """Return the unknown x of a size, the inverse of `size_at`."""
    return size_at(fault, size)  # 1 / (1 + .) - 1 is its own inverse
