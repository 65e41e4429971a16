"""Which faults are guaranteed to be seen? The smallest constant fault that no noise, disturbance or unknown
input can hide.

A fault f shifts the rows of a window by f phi. Two behaviours can share a recording iff their rows differ by
at most the two half-widths,

    |f phi - E z| <= 2 r  for some z,
    so f is always seen iff f t > 2,  t = min over z of max_i |phi_i - (E z)_i| / r_i,

a Chebyshev problem whose dual is the relation that sees the fault best. Where f < 2 / t, the errors that are
half the difference hide it.

With a tolerance sigma a reading says less the larger it is, and a bias of the reading is one of the true
value within e (1 -+ sigma) f, e = 1 / (1 - sigma^2): r is taken at the end of the operating range, and
widened by e sigma f / 2 on the rows of the faulty sensor. The size is then enough, but not the smallest.
"""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.diagnosis.observer_sizes import least_seen
from jaxbound.estimation.observer import observer
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import chebyshev, subspace
from jaxbound.exact.linalg import dot
from jaxbound.exact.price import SECONDS
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault
from jaxbound.models.rows import Kind
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.expressions import find_column
from jaxbound.relations.cost import affordable, relation_cost
from jaxbound.relations.lags import over_all_rows
from jaxbound.relations.parity import parity_relations
from jaxbound.relations.sentence import relation_text, remembers
from jaxbound.text.names import listed

__all__ = ["GuaranteedSize", "always_seen", "detectable", "operating_reach", "visible_sizes", "window_shift"]

ZERO = Fraction(0)
ROUNDING = RECORDER_ULPS + 256
"""Unit roundoffs of a reading that a verdict may lose: what the recording rounds away, and the error bounds
of up to some 100 terms.
"""
UNIT = Fraction(1, 2**53)
NEGLIGIBLE = 10**6
SETTLED = 4
"""Longer windows that bring less than 0.1 % after which the search for the best horizon ends."""
EFFORT = 10**6
"""Cubed rows of a window, times signals, up to which `always_seen` works: about a second of exact
arithmetic.
"""


class GuaranteedSize(float):
    """A size of a fault, in the unit of its signal; inf where no size is guaranteed to be seen.

    Attributes: horizon: of the window that sees it; relation: as text, the one that sees it best; sizes:
    {horizon: size} of all that were tried.
    """

    horizon: int
    relation: str
    sizes: dict


def detectable(
    model: ModelLike | SetObserver,
    fault: str | Fault,
    horizon: int | None = None,
    operating_range: Any = None,
    lags: Sequence[int] | None = None,
    method: str = "joint",
) -> GuaranteedSize:
    """Return the smallest size of a constant fault that is guaranteed to be detected.

    Args:
        model: a LinearSystem; with method "observer" also an `observer`, whose settings then count.
        fault: the name of an output or input, or a Fault of kind "bias"; its size and times do not matter.
        horizon: of the window, which the fault must fill; None: that of the model, or its lags, or up to
            where longer windows see no smaller faults.
        lags: of the window in place of horizon, as for `parity_relations`.
        operating_range: largest |reading - offset| of the outputs, one number, one per output or {output:
            number}, with the fault. Needed with a tolerance;
            without one, readings are assumed below a million times the bounds, so that the rounding of the
            recording does not matter.
        method: "joint": of windows. "observer": of a set observer that has settled when the fault begins, a
            bias or a drift (its size is a sample's), on a certain model without tolerances; no horizon,
            operating_range or lags.

    Returns:
        A GuaranteedSize, a float: `detect` with method "joint", in float64, calls every complete window FAULT
        throughout which a bias of this size or more, of either sign, acts on the signal, whatever the state,
        noise, disturbances and unknown inputs. Without tolerances no smaller number has this property (but
        for rounding); with them a smaller one may. With "observer" a size from which on the observer finds
        FAULT within .horizon samples of the onset, whatever the errors: worked out in floats from one
        recording (`observer_sizes`), so a number to plan by, while each FAULT is a proof; .sizes: {samples
        since the onset: size}.

    Raises:
        ValueError: a signal that the model does not have, an operating range that is missing or not positive.
        NotImplementedError: another kind of fault, an uncertain model; with "observer" one with tolerances.

    Example:
        >>> from jaxbound import LinearSystem
        >>> m = LinearSystem([["1/2"]], [[1]], [[1], [1]], noise=0.1)
        >>> size = detectable(m, "y1", horizon=0)
        >>> round(size, 6), size.horizon, size.relation
        (0.4, 0, 'y1[k] - y2[k] = 0')
    """
    if method == SetObserver.method or isinstance(model, SetObserver):
        return _observed(model, fault, (horizon, operating_range, lags))
    if method != "joint":
        raise ValueError(
            f"method must be joint or {SetObserver.method}, not {method!r}: sizes of others are counted by "
            f"jb.study"
        )
    model = as_model(model)
    signal, kind = (fault.signal, fault.kind) if isinstance(fault, Fault) else (fault, "bias")
    if signal not in model.outputs + model.inputs:
        raise ValueError(
            f"the model has no signal {signal!r}: it has {listed(model.outputs + model.inputs, str)}"
        )
    if kind != "bias":
        raise NotImplementedError(f"guaranteed sizes are known for faults of kind 'bias', not {kind!r}")
    if model.uncertainties:
        raise NotImplementedError(
            "guaranteed sizes of an uncertain model are not implemented: leave its uncertainties out, or "
            "decouple them"
        )
    reach = operating_reach(model, operating_range)
    if horizon is None and lags is None:
        horizon, lags = (model.horizon, None) if model.lags is None else (None, model.lags)
    relations = parity_relations(model, horizon, lags=lags)  # says so if there is none
    first, lags = relations.horizon, relations.lags
    tried, best = {}, None
    for s in (first,) if horizon is not None or lags is not None else range(first + 4 * model.n + 12):
        if s < first and not linalg.left_null_space(window.unbounded(model, s)):
            continue
        if best is None:
            affordable(model, s)
        elif relation_cost(model, s)[0] > SECONDS:
            break
        size, h = _size(model, signal, s, reach, lags)
        tried[s] = size
        if size is not None and (best is None or size < best[0] * Fraction(999, 1000)):
            best = size, s, h
        if best is not None and s >= best[1] + SETTLED:
            break
    number = math.inf if best is None else math.nextafter(float(best[0]), math.inf)
    out = GuaranteedSize(number)
    out.horizon = first if best is None else best[1]
    out.sizes = {s: math.inf if x is None else float(x) for s, x in tried.items()}
    out.relation = "" if best is None else _text(model, *best[1:])
    return out


def _observed(model, fault, windows):
    """Return the GuaranteedSize of a set observer."""
    if any(x is not None for x in windows):
        raise ValueError(
            "horizon, operating_range and lags are for windows: an observer looks at every sample"
        )
    watch = model if isinstance(model, SetObserver) else observer(as_model(model))
    fault = fault if isinstance(fault, Fault) else Fault(fault)
    names = watch.model.outputs + watch.model.inputs
    if fault.signal not in names:
        raise ValueError(f"the model has no signal {fault.signal!r}: it has {listed(names, str)}")
    size, delay, phi = least_seen(watch, fault)
    out = GuaranteedSize(size)
    best = np.maximum.accumulate(phi)
    out.horizon, out.relation = delay, ""
    out.sizes = {
        k: 2 / float(best[k]) for k in range(delay + 1) if best[k] > 0 and (k == 0 or best[k] > best[k - 1])
    }
    return out


def always_seen(
    relations: Any, method: str = "joint", readings: ArrayLike | None = None
) -> dict[str, float] | None:
    """Return {signal: size of a lasting error from which on every complete window that it fills is FAULT};
    inf: no size is sure to be seen.

    Args:
        relations: from `parity_relations`. method: of the test. readings: (T, p), NaN where missing: with a
            tolerance, how large they get.

    Returns:
        The sizes of `detectable` at the horizon of the relations, outputs first; None where they are not
        known: another method than "joint", an uncertain model, or windows so long that more than about a
            second would be spent.

    Example:
        >>> from jaxbound import LinearSystem
        >>> sizes = always_seen(parity_relations(LinearSystem([["1/2"]], None, [[1], [1]], noise=0.1), 0))
        >>> {signal: round(size, 6) for signal, size in sizes.items()}
        {'y1': 0.4, 'y2': 0.4}
    """
    if remembers(relations):
        return None
    model, s = relations.model, relations.horizon
    signals, rows = model.outputs + model.inputs, (s + 1) * model.p + s * model.g
    if method != "joint" or model.uncertainties or rows**3 * (1 + model.d) * len(signals) > EFFORT:
        return None
    reach = None
    if any(model.tolerance):
        if readings is None or not np.size(readings):
            return None
        offset = np.array(model.offset["y"], float)
        reach = np.fmax.reduce(
            abs(np.asarray(readings, float) - offset), axis=0, initial=np.finfo(np.float32).tiny
        ).tolist()
    return {
        signal: float(detectable(model, signal, operating_range=reach, **relations.window))
        for signal in signals
    }


def _text(model, s, h):
    h = linalg.presentable(linalg.primitive(h))
    K = window.unknowns(model, s)[1]
    k = linalg.matmul((h,), K)[0] if K[0] else ()
    return relation_text(model, s, h, k)


def operating_reach(model: LinearSystem, given: Any) -> tuple[Fraction, ...]:
    """Return the largest reading (deviation from the offset) of each output as a Fraction, from
    `operating_range` of `detectable`.
    """
    if given is None:
        if any(model.tolerance):
            raise ValueError(
                "a tolerance makes a sensor less certain the larger its readings are: give operating_range, "
                "the largest of them"
            )
        most = max(
            (*model.noise, *model.resolution, *(max(abs(lo), abs(hi)) for lo, hi in model.disturbance)),
            default=ZERO,
        )
        return (NEGLIGIBLE * most,) * model.p
    if isinstance(given, Mapping) or hasattr(given, "index") and hasattr(given, "keys"):
        given = [given[find_column(name, list(given.keys()), "operating_range")] for name in model.outputs]
    given = np.broadcast_to(np.asarray(given, object), (model.p,)) if np.ndim(given) == 0 else given
    if len(given) != model.p:
        raise ValueError(
            f"operating_range needs one number, or one for each of {listed(model.outputs, str)}: "
            f"{len(given)} given"
        )
    reach = tuple(linalg.rational(x) for x in given)
    if min(reach) <= 0:
        raise ValueError(f"operating_range must be positive, not {float(min(reach)):g}")
    return reach


def visible_sizes(relations: Any, operating_range: Any = None) -> np.ndarray:
    """Return the smallest constant fault of each signal that each relation alone is guaranteed to see, (R,
    N): outputs, then inputs.

    Args:
        relations: a Redundancy, or a ParityRelation. operating_range: as for `detectable`.

    Returns:
        An array of sizes, rounded up; inf where no size is guaranteed.
    """
    relations = getattr(relations, "relations", relations)
    model = relations.model
    reach, signals = operating_reach(model, operating_range), model.outputs + model.inputs
    out = np.full((relations.count, len(signals)), math.inf)
    for j, signal in enumerate(signals):
        shift, widths, spread = window_shift(model, signal, relations.horizon, reach)
        for c, h in enumerate(relations.W):
            if (size := _least(h, shift, widths, spread)) is not None:
                out[c, j] = math.nextafter(float(size), math.inf)
    return out


def _least(h, shift, widths, spread):
    """Return the size from which on a relation h cannot hold, None if it always may."""
    slope = abs(dot(h, shift)) - dot(map(abs, h), spread)
    return dot(map(abs, h), widths) / slope if slope > 0 else None


def window_shift(
    model: LinearSystem, signal: str, s: int, reach: Sequence[Fraction]
) -> tuple[list, list, list]:
    """Return for each row of a window: its shift by a fault of size 1, twice its half-width, and what the
    fault adds to that.
    """
    rows = window.window_rows(model, s)
    widths = _widths(model, rows, reach)
    if signal not in model.outputs:
        K = window.unknowns(model, s)[1]
        driven = model.inputs.index(signal)
        return [sum(row[driven :: model.m], ZERO) for row in K], widths, [ZERO] * len(widths)
    i = model.outputs.index(signal)
    stretch = 1 / (1 - model.tolerance[i] ** 2)
    shift = []
    for row in rows:
        moved = [x.weight for x in rows.terms(row) if x.measured and x.number == i]
        shift.append(stretch * sum(moved, ZERO))
    return shift, widths, [model.tolerance[i] * x for x in shift]


def _widths(model, rows, reach):
    """Return twice the half-width of each row at the end of the operating range."""
    floor = Fraction(float(np.finfo(np.float64).tiny))
    rounded, of_output = [], []
    for i, tolerance in enumerate(model.tolerance):
        size = reach[i] + abs(model.offset["y"][i]) + model.noise[i]
        rounded.append(model.resolution[i] + ROUNDING * UNIT * size)
        rho = model.noise[i] + rounded[i] + floor
        of_output.append(2 * (rho + tolerance * max(reach[i], rho)) / (1 - tolerance * tolerance))
    of_disturbance = [hi - lo + 2 * floor for lo, hi in model.disturbance]
    bounds = [bounded.bound for bounded in window.bounded_sums(model)]
    widths = []
    for row in rows:
        if row.kind is Kind.READING:
            widths.append(of_output[row.number])
        elif row.kind is Kind.DISTURBANCE:
            widths.append(of_disturbance[row.number])
        else:
            values = row.values
            half = bounds[row.number] + 10 * (values.terms + values.size) * floor
            if values.measured:
                half += sum((values.size_of(i) * rounded[i] for i, _ in values.parts), ZERO)
            widths.append(2 * half)
    return widths


def _size(model, signal, s, reach, lags):
    """Return the smallest size that a window of horizon s always sees, None where none is, and the relation
    that sees it.
    """
    E = window.unknowns(model, s)[0]
    seen = window.window_rows(model, s, lags).seen
    shift, widths, spread = ([x[i] for i in seen] for x in window_shift(model, signal, s, reach))
    space, size = subspace([E[i] for i in seen]), None
    best = chebyshev(space, shift, widths)
    if best.t == 0:
        return None, None
    f = 1 / best.t if not any(spread) else NEGLIGIBLE / best.t
    while True:  # each relation that is violated at f gives a smaller f at which it just holds: finitely many
        best = chebyshev(
            space,
            [f * x for x in shift],
            [w + f * x for w, x in zip(widths, spread, strict=True)],
            best.reference,
        )
        if best.t < 1 or (best.t == 1 and size is None and any(spread)):
            return size, None
        f = _least(best.h, shift, widths, spread)
        if best.t == 1:
            return f, over_all_rows(best.h, seen, model, s)
        size = f
