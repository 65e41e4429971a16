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
from jaxbound.recordings.expressions import expression
from jaxbound.text.names import listed

__all__ = ["Moves", "Push", "Side", "error_of", "limits_of", "moves_of", "push_of", "with_fault"]

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
        return stretched(self.a + self.b * x + self.c * x * x, self.sigma)


Push: TypeAlias = Mapping[int, tuple[Side, Side]]
"""{row: (low, high)} of the rows whose ends [-low, high] a fault moves."""


def with_fault(window: ExactWindow, push: Push, x: Fraction) -> ExactWindow:
    """Return the window with a fault."""
    limits = list(window.limits)
    for row, (low, high) in push.items():
        limits[row] = -low.at(x), high.at(x)
    return window.with_limits(limits)


def _sides(
    ends: Ends, sigma: Fraction, low: tuple[Fraction, Fraction], high: tuple[Fraction, Fraction]
) -> tuple[Side, Side]:
    """Return the sides of a row with these ends, and the (b, c) of each."""
    lo, hi = ends
    return Side(unstretched(-lo, sigma), *low, sigma), Side(unstretched(hi, sigma), *high, sigma)


def push_of(fault: NamedFault, window: ExactWindow, since: int = 0, inverted: bool = False) -> Push:
    """Return the Push of a fault on the rows of a window.

    Args:
        since: the sample of the window at which it begins. inverted: of the gain of a sensor, it is below 0.

    Raises:
        NotImplementedError: as `moves_of`; the gain of a sensor whose averages are bounded.
    """
    sigma = ZERO
    if fault.output is not None:
        if fault.kind == "gain":
            return _push_of_gain(fault.output, window, since, inverted)
        sigma = window.tolerance[window.model.outputs.index(fault.output)]
    first, second = moves_of(fault, window, since)
    push = {}
    for row, (ends, b, c) in enumerate(
        zip(window.limits, first, second or (ZERO,) * len(first), strict=True)
    ):
        if ends is not None and (b or c):
            push[row] = _sides(ends, sigma, (b, c), (-b, -c))
    return push


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
            push[number] = _sides(ends, sigma, (by, ZERO), (by, ZERO))
    return push


def _push_of_gain(name: str, window: ExactWindow, since: int, inverted: bool) -> Push:
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
        if j % model.p != i or j // model.p < since or ends is None:
            continue
        low, high = unstretched(-ends[0], sigma), unstretched(ends[1], sigma)  # rho - d, rho + d
        if inverted:
            low, high = -high, -low  # |x| = -x
        push[j] = Side(offset, low - offset, ZERO, sigma), Side(-offset, high + offset, ZERO, sigma)
    return push


def moves_of(fault: NamedFault, window: ExactWindow, since: int = 0) -> Moves:
    """Return how a fault moves the rows of a window; of a sensor its readings, before any tolerance.

    Args:
        since: the sample of the window at which it begins.

    Raises:
        NotImplementedError: an input that its size is multiplied by is missing; a signal that is computed
            from the actuator's column in a way that is not followed.
    """
    model, shares = window.model, _shares(fault, window)
    shares[:since] = [ZERO] * since
    if fault.input is not None:
        return _moves_of_actuator(fault.input, window, shares)
    on_states: Vector = (ZERO,) * model.n
    on_outputs: Vector = (ZERO,) * model.p
    if fault.output is not None:
        on_outputs = linalg.identity(model.p)[model.outputs.index(fault.output)]
    else:
        shares_of = dict(fault.states)
        on_states = tuple(shares_of.get(name, ZERO) for name in model.states)
    return _response(window, on_states, on_outputs, shares), ()


def _moves_of_actuator(name: str, window: ExactWindow, shares: Sequence[Fraction]) -> Moves:
    """Return the moves of an input that is another than was recorded, and of what is computed from it."""
    model = window.model
    moves: list[Vector] = [(), ()]
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
        for i, by in enumerate(_powers(window, signal, shares)):
            moved = _response(window, on_states, on_outputs, by)
            moves[i] = linalg.add_multiple(moves[i] or (ZERO,) * len(moved), 1, moved)
    return moves[0], moves[1]


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
