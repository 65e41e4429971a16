"""The push of a named fault on the rows of a window, in exact rationals.

    (Y, w) = E z + K U + x push

push is known, so the rows stay linear in (z, x). x is the size of the fault, but for the gain of a sensor: y
/ (1 + f) is what the sensor would have shown, and is y + x y with x = 1 / (1 + f) - 1.

A bias is one of what the sensor sees: where it has a tolerance theta, a reading is (1 + theta) (true + f) +
delta.
"""

from collections.abc import Sequence
from fractions import Fraction

from jaxbound.certificates.exact_window import ExactWindow
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.models.named_faults import NamedFault

__all__ = ["push_of", "size_at", "unknown_at"]

ZERO, ONE = Fraction(0), Fraction(1)


def push_of(fault: NamedFault, window: ExactWindow, since: int = 0) -> Vector:
    """Return the push of a fault on the rows of a window, for an unknown x = 1.

    Args:
        since: the sample of the window at which it begins.

    Raises:
        NotImplementedError: an input that its size is multiplied by is missing; the gain of a sensor with a
            tolerance.
    """
    model = window.model
    on_states: Vector = (ZERO,) * model.n
    on_outputs: Vector = (ZERO,) * model.p
    if fault.output is not None:
        i = model.outputs.index(fault.output)
        on_outputs = linalg.identity(model.p)[i]
        if fault.kind == "gain" and window.tolerance[i]:
            raise NotImplementedError(
                f"the gain of {fault.output} and its tolerance are one number: give the tolerance as noise"
            )
    elif fault.input is not None:
        j = model.inputs.index(fault.input)
        on_states = tuple(row[j] for row in model.B)
        on_outputs = tuple(row[j] for row in model.D)
    else:
        shares_of = dict(fault.states)
        on_states = tuple(shares_of.get(name, ZERO) for name in model.states)
    shares = _shares(fault, window)
    shares[:since] = [ZERO] * since
    return _response(window, on_states, on_outputs, shares)


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
    recorded = list(window.u[model.inputs.index(by) :: model.m])
    newest_counts = fault.output is not None or model.has_feedthrough
    if fault.times is not None and (None in recorded or (newest_counts and len(recorded) < samples)):
        raise NotImplementedError(f"a sample of {fault.times} is missing, which its size is multiplied by")
    # an input that is missing is an unknown of the window: whatever its gain, nothing more is known of it
    shares = [x or ZERO for x in recorded]
    return shares + [ZERO] * (samples - len(shares))


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
