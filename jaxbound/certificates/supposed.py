"""A named fault that is supposed: where it puts the ends of the rows of a window, in exact rationals.

    (Y, w) = E z + K U,    -F(a + b x + c x^2) <= a row <= F(a' + b' x + c' x^2)

The rows stay linear in the unknowns z. x is the size f of the fault; of the gain of a sensor it is 1 / (1 +
f). A fault that moves a row as a whole moves both of its ends. What a faulty sensor shows is defined in
`models.named_faults`: with |delta| <= rho a reading y says of the true value, in deviations from an offset o,

    (bias)  (1 + theta) t = y - o - f - delta        (gain)  (1 + theta) t = x (y - delta) - o

so ends are F(rho + y - o - f) and F(x y + |x| rho - o), F that of `exact_window`. An error of either sign in
each sample of a sensor moves both ends outward. An actuator moves every signal that is computed from its
column (`models.shared_columns`); an output that is computed from it was recorded wrong by as much.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple, TypeAlias

from jaxbound.certificates.exact_window import Ends, ExactWindow, stretched, unstretched
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.shared_columns import Follower, Polynomial, followers
from jaxbound.models.window import actions
from jaxbound.recordings.expressions import expression
from jaxbound.text.names import listed

ZERO, ONE = Fraction(0), Fraction(1)
Recorded: TypeAlias = list[Fraction | None]
"""Samples of a signal, None where one is missing."""
Moves: TypeAlias = tuple[Vector, Vector]
"""How far x moves each row, and how far its square does: () where x is not squared."""


class Side(NamedTuple):
    """F(a + b x + c x^2), F of a tolerance sigma; c is 0 beside one."""

    a: Fraction
    b: Fraction
    c: Fraction = ZERO
    sigma: Fraction = ZERO

    def at(self, x: Fraction) -> Fraction:
        """Return its value at x."""
        return stretched(self.a + (self.b + self.c * x) * x, self.sigma)


class Action(NamedTuple):
    """A signal that acts on states and on outputs. Fields: shares: how much x moves it at each sample."""

    on_states: Vector
    on_outputs: Vector
    shares: Sequence[Fraction]


Push: TypeAlias = Mapping[int, tuple[Side, Side]]
"""{row: (low, high)} of the rows whose ends [-low, high] a fault moves."""


def with_fault(window: ExactWindow, push: Push, x: Fraction) -> ExactWindow:
    """Return the window with a fault."""
    limits = list(window.limits)
    for row, (low, high) in push.items():
        limits[row] = -low.at(x), high.at(x)
    return window.with_limits(limits)


def _apart(ends: Ends, sigma: Fraction) -> Ends:
    """Return (-low, high) of a row before the tolerance of its sensor."""
    return unstretched(-ends[0], sigma), unstretched(ends[1], sigma)


def pushes_of(fault: NamedFault, window: ExactWindow, inverted: bool = False) -> list[Push]:
    """Return the Push of a fault on the rows of a window for each sample at which it may begin.

    Args:
        inverted: of the gain of a sensor, it is below 0.

    Raises:
        NotImplementedError: as `moves_of`; the gain of a sensor whose averages are bounded.
    """
    sigma = ZERO
    if fault.output is not None:
        if fault.kind == "gain":
            push = _push_of_gain(fault.output, window, inverted)
            count = window.model.p
            return [{j: push[j] for j in push if j >= since * count} for since in range(window.horizon + 1)]
        sigma = window.tolerance[window.model.outputs.index(fault.output)]
    apart = {row: _apart(ends, sigma) for row, ends in enumerate(window.limits) if ends is not None}
    pushes: list[Push] = []
    for first, second in moves_of(fault, window):
        push = {}
        for row, (low, high) in apart.items():
            b, c = first[row], ZERO
            if second:
                c = second[row]
            if b or c:
                push[row] = Side(low, b, c, sigma), Side(high, -b, -c, sigma)
        pushes.append(push)
    return pushes


def error_of(i: int, window: ExactWindow) -> Push:
    """Return the Push of an error of up to x, of either sign, in each sample of output i."""
    grows = dict.fromkeys(range(i, len(window.y), window.model.p), ONE)
    for number, row in enumerate(window.rows.of_sums, window.rows.single):
        if row.values.measured:
            grows[number] = row.values.size_of(i)
    push = {}
    for number, by in grows.items():
        ends = window.limits[number]
        if ends is not None and by:
            sigma = window.tolerance[i]  # 0 where averages have bounds
            low, high = _apart(ends, sigma)
            push[number] = Side(low, by, ZERO, sigma), Side(high, by, ZERO, sigma)
    return push


def _push_of_gain(name: str, window: ExactWindow, inverted: bool) -> Push:
    """Return the Push of the gain of an output, in x = 1 / (1 + f)."""
    model = window.model
    i = model.outputs.index(name)
    if any(row.values.measured and row.values.size_of(i) for row in window.rows.of_sums):
        raise NotImplementedError(
            f"its gain shows in the bounds on averages of {name}, where it is not followed"
        )
    sigma, offset = window.tolerance[i], model.offset["y"][i]
    push = {}
    for j, ends in enumerate(window.limits[: len(window.y)]):
        if j % model.p != i or ends is None:
            continue
        # an error of the gain acts on the reading, before its tolerance
        low, high = _apart(ends, sigma)  # rho - d, rho + d
        if inverted:
            low, high = -high, -low  # |x| = -x
        push[j] = Side(offset, low - offset, ZERO, sigma), Side(-offset, high + offset, ZERO, sigma)
    return push


def moves_of(fault: NamedFault, window: ExactWindow) -> list[Moves]:
    """Return how a fault moves the rows of a window, for each sample at which it may begin; of a sensor its
    readings, before any tolerance.

    Raises:
        NotImplementedError: an input that its size is multiplied by is missing; a signal that is computed
            from the actuator's column in a way that is not followed.
    """
    model, shares = window.model, _shares(fault, window)
    if fault.input is not None:
        first, second = _actions_of_actuator(fault.input, window, shares)
    else:
        of_states, own = dict(fault.states), [fault.output == name for name in model.outputs]
        on_states = tuple(of_states.get(name, ZERO) for name in model.states)
        first, second = [Action(on_states, tuple(map(Fraction, own)), shares)], []
    # most faults move rows in proportion: no squares to follow then
    squares: list[Vector] = [()] * (window.horizon + 1)
    if second:
        squares = _since_each(window, second)
    return list(zip(_since_each(window, first), squares, strict=True))


def _actions_of_actuator(
    name: str, window: ExactWindow, shares: Sequence[Fraction]
) -> tuple[list[Action], list[Action]]:
    """Return the actions of an input that is another than was recorded: those by x, and by its square."""
    model = window.model
    does: tuple[list[Action], list[Action]] = [], []
    for signal in followers(model, name):
        on_states: Vector = (ZERO,) * model.n
        if signal.is_input:
            own = linalg.identity(model.m)[signal.number]
            on_states, on_outputs = linalg.multiply(model.B, own), linalg.multiply(model.D, own)
        elif window.tolerance[signal.number]:
            raise NotImplementedError(
                f"{signal.signal} is computed from the same column and has a tolerance: give it as noise"
            )
        else:  # recorded from the same column, so wrong by as much
            on_outputs = linalg.scale(linalg.identity(model.p)[signal.number], -1)
        for power, by in zip(does, _powers(window, signal, shares), strict=False):
            power.append(Action(on_states, on_outputs, by))
    return does


def limits_of(
    fault: NamedFault, window: ExactWindow, since: int, endless: Fraction
) -> tuple[Fraction, Fraction]:
    """Return the lowest and the highest x that leave an actuator between what it can do."""
    low, high = -endless, endless
    if fault.between is None or fault.input is None:
        return low, high
    recorded = _input(window, window.model.inputs.index(fault.input))
    for u, share in list(zip(recorded, _shares(fault, window), strict=True))[since:]:
        if u is not None and share:
            least, most = sorted((end - u) / share for end in fault.between)
            low, high = max(low, least), min(high, most)
    return low, high


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
                weight = _polynomial_at(window, signal, polynomial, k)
            moved.append(weight * share ** (i + 1))
        by_power.append(moved)
    return by_power


def _polynomial_at(window: ExactWindow, signal: Follower, polynomial: Polynomial, k: int) -> Fraction:
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


def _since_each(window: ExactWindow, does: Sequence[Action]) -> list[Vector]:
    """Return how actions move the rows of a window, for each sample at which they may begin."""
    model, s = window.model, window.horizon
    # from the last sample back: a fault that begins earlier does all that a later one does, and more
    moved: Vector = (ZERO,) * len(window.limits)
    by_onset = [moved] * (s + 1)
    columns = [
        linalg.transpose(actions(model, s, on_states, on_outputs)) for on_states, on_outputs, _ in does
    ]
    for since in range(s, -1, -1):
        for action, samples in zip(does, columns, strict=True):
            moved = linalg.add_multiple(moved, action.shares[since], samples[since])
        by_onset[since] = moved
    return by_onset
