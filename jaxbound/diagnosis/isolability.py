"""Which faults can be told apart: signals by structure, or named faults by their sizes and the bounds.

Fault A of size a, constant over a window, and a healthy behaviour differ from fault B of size x and another
healthy behaviour by at most the two half-widths of each row, if one recording is to fit both:

    |a A - x B - E z| <= 2 r  for some z and x

This is a window of twice the bounds that shows a A: where no x explains it (`certificates.fault_size`), A of
this size is never taken for B alone, whatever state, noise, disturbances and unknown inputs do.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, overload

from jaxbound.certificates.checker.claim import claim_of
from jaxbound.certificates.diagnosis import amount
from jaxbound.certificates.exact_window import Ends, ExactWindow
from jaxbound.certificates.fault_size import Scale
from jaxbound.certificates.plain import plain_model
from jaxbound.certificates.supposed import Moves, moves_of
from jaxbound.diagnosis.detectability import operating_reach, row_widths
from jaxbound.exact.chebyshev import chebyshev
from jaxbound.exact.linalg import Vector, add_multiple, scale, zeros
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.named_faults import PARAMETER, NamedFault, named_faults
from jaxbound.models.shared_columns import followers
from jaxbound.models.system import LinearSystem
from jaxbound.relations.decoupling import Isolability
from jaxbound.relations.decoupling import isolability as of_signals
from jaxbound.relations.parity import parity_relations
from jaxbound.text.objects import readable

ZERO = Fraction(0)


@readable
@dataclass(frozen=True, eq=False)
class FaultIsolability:
    """Named faults that windows tell apart, if each is alone and fills the window that shows it.

    Fields:
        model. faults: those that were weighed. times: how many detectable sizes each has.
        detectable: {fault: the size from which on it is seen, whatever else happens}; None: never.
        explained: {(fault, other): the smallest size of the other alone that may explain the window}, of the
            pairs that cannot be told apart for certain; of all others it is proved that they can.
        unweighed: {fault: why it was not weighed}.
    """

    model: LinearSystem
    faults: tuple[NamedFault, ...]
    times: Fraction
    detectable: Mapping[str, Fraction | None]
    explained: Mapping[tuple[str, str], Fraction]
    unweighed: Mapping[str, str]

    def confused(self, fault: str) -> dict[str, Fraction]:
        """Return {other fault: its smallest size} of those that a fault may be taken for."""
        return {other: size for (name, other), size in self.explained.items() if name == fault}

    def text(self) -> str:
        """Return a line for each fault: from which size on it is seen, and what it may be taken for at
        `times` that size.
        """
        by_name = {fault.name: fault for fault in self.faults}
        lines = []
        for name, size in self.detectable.items():
            if size is None:
                lines.append(f"{name}: no size of it is sure to be seen")
                continue
            others = []
            for other, needed in self.confused(name).items():
                others.append(f"{other} ({amount(self.model, by_name[other], needed)})")
            seen, times = amount(self.model, by_name[name], size), f"{float(self.times):g}"
            named = ", ".join(others) or "no other"
            lines.append(f"{name}: seen from {seen} on; at {times} times that taken for: {named}")
        lines += [f"{name}: not weighed, {why}" for name, why in self.unweighed.items()]
        return "\n".join(lines)

    def to_dict(self) -> list[dict[str, Any]]:
        """Return an entry for each fault, ready for JSON."""
        entries: list[dict[str, Any]] = []
        for name, size in self.detectable.items():
            confused = {other: float(needed) for other, needed in self.confused(name).items()}
            entry: dict[str, Any] = {"fault": name, "seen_from": None, "taken_for": confused}
            if size is not None:
                entry["seen_from"] = float(size)
            entries.append(entry)
        for name, why in self.unweighed.items():
            entries.append({"fault": name, "not_weighed": why})
        return entries

    def _rows(self) -> dict[str, str]:
        return dict(line.split(": ", 1) for line in self.text().splitlines())


@overload
def isolability(model: ModelLike, faults: None = None) -> Isolability: ...


@overload
def isolability(
    model: ModelLike,
    faults: Sequence[NamedFault],
    *,
    times: float = 2,
    horizon: int | None = None,
    lags: Sequence[int] | None = None,
) -> FaultIsolability: ...


def isolability(
    model: ModelLike,
    faults: Sequence[NamedFault] | None = None,
    *,
    times: float = 2,
    horizon: int | None = None,
    lags: Sequence[int] | None = None,
) -> Isolability | FaultIsolability:
    """Return which single faults are detectable, and which pairs can be told apart.

    Args:
        model: a LinearSystem, unknown inputs included. Without faults its bounds do not matter.
        faults: a list of NamedFault, like `model.faults`; None: of each signal, doing what it likes.
        times: of named faults: each has so many times the size from which on it is sure to be seen.
        horizon, lags: of the windows of named faults, as for `parity_relations`.

    Returns:
        Without faults an Isolability, weakly and for constant faults. Of named faults a FaultIsolability:
        whether the window that a fault of this size fills may be explained by another one alone, beginning at
        any of its samples. Exact; .explained has the pairs. What an actuator can do at most (`between`)
        depends on what it does, so it is not used. Inputs that a size is multiplied by stand still at the
        largest magnitude in their range of training.

    Raises:
        ValueError: a fault names a signal that the model does not have. NotImplementedError: of named faults,
            a model with tolerances, factors or uncertain parameters.

    Example:
        >>> import jaxbound as jb
        >>> print(isolability(jb.LinearSystem([[1]], [[1]], [[1], [2]])).text())
           seen y1 y2 u1
        y1    1  -  t  1
        y2    1  t  -  1
        u1    1  1  1  -
        >>> m = jb.LinearSystem(None, None, None, [[1], [1], [1]], noise=0.1, inputs=["u"])
        >>> faults = [jb.NamedFault("u is off", input="u"), jb.NamedFault("y1 is off", output="y1")]
        >>> print(isolability(m, faults).text())
        u is off: seen from +0.2 of u on; at 2 times that taken for: no other
        y1 is off: seen from +0.2 of y1 on; at 2 times that taken for: u is off (+0.2 of u)
    """
    if faults is None:
        return of_signals(model)
    model = as_model(model)
    if any(model.tolerance) or model.factors or model.uncertainties:
        raise NotImplementedError(
            "named faults are told apart beforehand without tolerances, factors on noise and uncertain "
            "parameters: give them as noise or disturbance"
        )
    relations = parity_relations(model, horizon, lags=lags)
    healthy = _difference(model, relations.horizon, relations.lags)
    weighed, unweighed = {}, {}
    for fault in named_faults(faults, model.inputs, model.outputs, model.states):
        why = _depends(model, fault)
        if why:
            unweighed[fault.name] = why
            continue
        bare = copy(fault)
        vars(bare)["between"] = None
        try:
            weighed[fault.name] = bare, moves_of(bare, healthy)[0]
        except NotImplementedError as e:
            unweighed[fault.name] = str(e)
    detectable: dict[str, Fraction | None] = {}
    explained: dict[tuple[str, str], Fraction] = {}
    for name, (fault, moves) in weighed.items():
        size = detectable[name] = _detectable(healthy, moves[0])
        if size is None:
            continue
        for sign in _signs(fault):
            shown = _showing(healthy, moves, sign * Fraction(times) * size)
            best = shown.solve()
            if best.t <= 1:
                continue
            sizes = Scale(shown, best.h)
            for other, (another, _) in weighed.items():
                if other == name:
                    continue
                needed = sizes.weigh(another, range(relations.horizon + 1)).size
                pair = name, other
                if needed is not None and (pair not in explained or abs(needed) < abs(explained[pair])):
                    explained[pair] = needed
    about = tuple(fault for fault, _ in weighed.values())
    return FaultIsolability(model, about, Fraction(times), detectable, explained, unweighed)


def _depends(model: LinearSystem, fault: NamedFault) -> str:
    """Return why what a fault does is not known beforehand; "": it is."""
    if fault.kind == "gain" and fault.output is not None:
        return f"it depends on the readings of {fault.output}"
    if fault.kind == PARAMETER:
        return "it multiplies states that nobody knows beforehand"
    factor = fault.times
    if fault.kind == "gain":
        factor = fault.input
    if factor is not None and factor not in model.ranges:
        return f"it depends on {factor}, whose range is not stated"
    if fault.input is not None:
        for signal in followers(model, fault.input):
            if not signal.is_input:
                return f"it depends on the readings of {signal.signal}"
    return ""


def _signs(fault: NamedFault) -> tuple[int, ...]:
    """Return the signs that the size of a fault may have."""
    if fault.sign is None:
        return (1, -1)
    return (1 - 2 * (fault.sign == "-"),)


def _difference(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None) -> ExactWindow:
    """Return the difference of two healthy behaviours: twice the bounds around 0."""
    values = []
    for name in model.inputs:
        values.append(max(model.ranges.get(name, (ZERO,)), key=abs))
    samples, nothing = horizon + 1, [ZERO] * model.p
    plain = plain_model(model) | {"tolerance": nothing}
    claim = claim_of(plain, [values] * samples, [nothing] * samples, lags=lags)
    window = ExactWindow(model, horizon, claim, (), lags)
    rows = window.rows
    ends: list[Ends | None] = [None] * len(list(rows))
    widths = row_widths(model, rows, operating_reach(model, None))
    for i in rows.seen:
        ends[i] = -widths[i], widths[i]
    E, K = window.forms
    return replace(window, own=(E, zeros(len(K), len(window.u)))).with_limits(ends)


def _showing(healthy: ExactWindow, moves: Moves, x: Fraction) -> ExactWindow:
    """Return the window that shows a fault of size x."""
    first, second = moves
    shift = scale(first, x)
    if second:
        shift = add_multiple(shift, x * x, second)
    limits: list[Ends | None] = []
    for ends, by in zip(healthy.limits, shift, strict=True):
        if ends is not None:
            ends = ends[0] + by, ends[1] + by
        limits.append(ends)
    return healthy.with_limits(limits)


def _detectable(healthy: ExactWindow, push: Vector) -> Fraction | None:
    """Return the size from which on a push shows whatever else happens; None: it never does for certain."""
    E, shown, widths = [], [], []
    for row, pair, by in zip(healthy.unknown_columns(), healthy.limits, push, strict=True):
        if pair is not None:
            E.append(row)
            shown.append(by)
            widths.append(pair[1])
    best = chebyshev(E, shown, widths)
    if not best.t:
        return None
    return 1 / best.t
