"""Faults that are guaranteed to be seen: the smallest constant fault that no noise, disturbance or unknown
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

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from types import MappingProxyType
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.interface import OBSERVER, Relations
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.diagnosis.observer_sizes import least_seen
from jaxbound.estimation.observer import observer
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import chebyshev
from jaxbound.exact.linalg import Number, Row, Vector, dot
from jaxbound.exact.price import SECONDS
from jaxbound.models import window
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault
from jaxbound.models.operating_point import at_factors
from jaxbound.models.rows import Kind, WindowRows
from jaxbound.models.sensor import RECORDER_ULPS
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.expressions import find_column
from jaxbound.relations.cost import affordable, relation_cost
from jaxbound.relations.lags import over_all_rows
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.sentence import relation_text
from jaxbound.text.names import listed

ZERO = Fraction(0)
ROUNDING = RECORDER_ULPS + 256
"""Unit roundoffs of a reading that a verdict may lose: what the recording rounds away, and the error bounds
of up to some 100 terms.
"""
UNIT = Fraction(1, 2**53)
NEGLIGIBLE = 10**6
SETTLED = 4
"""Longer windows that bring less than 0.1 % after which the search for the best horizon ends."""
OperatingRange: TypeAlias = ArrayLike | Mapping[str, Number] | None
"""One number, one for each output, or {output: number}."""
Seen: TypeAlias = tuple[Fraction, Vector]
"""(size from which on a fault is always seen, the relation that sees it)."""
EFFORT = 10**6
"""Cubed rows of a window, times signals, up to which `always_seen` works: about a second of exact
arithmetic.
"""


class GuaranteedSize(float):
    """A size of a fault, in the unit of its signal; inf where no size is guaranteed to be seen.

    Attributes: horizon: of the window that sees it; relation: as text, the one that sees it best; sizes:
    {horizon: size} of all that were tried. Of a monitor: test: the name of the test that sees it, tests:
    {name: size} of each whose size is known, where it watches.
    """

    horizon: int
    relation: str
    sizes: dict[int, float]
    test: str = ""
    tests: Mapping[str, float] = MappingProxyType({})


def _guaranteed(size: float, horizon: int, relation: str, sizes: dict[int, float]) -> GuaranteedSize:
    guaranteed = GuaranteedSize(size)
    guaranteed.horizon, guaranteed.relation, guaranteed.sizes = horizon, relation, sizes
    return guaranteed


def detectable(
    model: ModelLike | SetObserver[Any] | MonitorBank,
    fault: str | Fault,
    horizon: int | None = None,
    operating_range: OperatingRange = None,
    lags: Sequence[int] | None = None,
    method: str = "joint",
    factors: Mapping[str, Number] | None = None,
) -> GuaranteedSize:
    """Return the smallest size of a constant fault that is guaranteed to be detected.

    Args:
        model: a LinearSystem; with method "observer" also an `observer`, whose settings then count; or a
            `jb.monitor`, which sees what any of its tests sees: a test with a condition where it watches, and
            where every mode has one, of which the largest size counts.
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
        factors: {output: the largest value of its factor in the window}, of a model whose noise is times
            factors; of windows with larger ones nothing is said.

    Returns:
        A GuaranteedSize, a float: `detect` with method "joint", in float64, calls every complete window FAULT
        throughout which a bias of this size or more, of either sign, acts on the signal, whatever the state,
        noise, disturbances and unknown inputs. Without tolerances no smaller number has this property (but
        for rounding); with them a smaller one may. With "observer" a size from which on the observer finds
        FAULT within .horizon samples of the onset, whatever the errors: worked out in floats from one
        recording (`observer_sizes`), so a number to plan by, while each FAULT is a proof; .sizes: {samples
        since the onset: size}.

    Raises:
        ValueError: a signal that the model does not have, an operating range that is missing or not positive,
            factors that are missing or negative.
        NotImplementedError: another kind of fault, an uncertain model; with "observer" one with tolerances; a
            monitor of such tests alone.

    Example:
        >>> from jaxbound import LinearSystem
        >>> m = LinearSystem([["1/2"]], [[1]], [[1], [1]], noise=0.1)
        >>> size = detectable(m, "y1", horizon=0)
        >>> round(size, 6), size.horizon, size.relation
        (0.4, 0, 'y1[k] - y2[k] = 0')
    """
    anything: Any = model
    if getattr(model, "parts", ()):
        if horizon is not None or lags is not None or method != "joint":
            raise ValueError("horizon, lags and method are for one test: a monitor has tests of its own")
        return _by_tests(anything, fault, operating_range, factors)
    if method == OBSERVER or getattr(model, "remembers", False):
        return _observed(anything, fault, (horizon, operating_range, lags), factors)
    if method != "joint":
        raise ValueError(
            f"method must be joint or {OBSERVER}, not {method!r}: sizes of others are counted by jb.study"
        )
    model = at_factors(as_model(anything, factors=True), factors)
    signal = _constant_fault(model, fault)
    reach = operating_reach(model, operating_range)
    if horizon is None and lags is None:
        horizon, lags = model.horizon, None
        if model.lags is not None:
            horizon, lags = None, model.lags
    relations = parity_relations(model, horizon, lags=lags)  # says so if there is none
    first = relations.horizon
    horizons = [first]
    if horizon is None and relations.lags is None:
        shorter = [s for s in range(first) if linalg.left_null_space(window.unbounded(model, s))]
        horizons = [*shorter, *range(first, first + 4 * model.n + 12)]
    return _least_size(model, signal, horizons, reach, relations.lags)


def _least_size(
    model: LinearSystem, signal: str, horizons: Sequence[int], reach: Vector, lags: tuple[int, ...] | None
) -> GuaranteedSize:
    """Return the GuaranteedSize of the best of some horizons, up to where longer ones see no more."""
    tried: dict[int, float] = {}
    best: tuple[int, Seen] | None = None
    for s in horizons:
        if best is None:
            affordable(model, s)
        elif relation_cost(model, s)[0] > SECONDS:
            break
        seen = _size(model, signal, s, reach, lags)
        tried[s] = math.inf
        if seen is not None:
            tried[s] = float(seen[0])
            if best is None or seen[0] < best[1][0] * Fraction(999, 1000):
                best = s, seen
        if best is not None and s >= best[0] + SETTLED:
            break
    if best is None:
        return _guaranteed(math.inf, horizons[0], "", tried)
    s, (size, h) = best
    return _guaranteed(math.nextafter(float(size), math.inf), s, _text(model, s, h), tried)


def _constant_fault(model: LinearSystem, fault: str | Fault) -> str:
    """Return the signal of a constant fault; raise an exception where its size cannot be worked out."""
    signal, kind = fault, "bias"
    if isinstance(fault, Fault):
        signal, kind = fault.signal, fault.kind
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
    return str(signal)


def _observed(
    model: ModelLike | SetObserver[Any],
    fault: str | Fault,
    of_windows: Sequence[object],
    factors: Mapping[str, Number] | None,
) -> GuaranteedSize:
    """Return the GuaranteedSize of a set observer. of_windows: options that it does not take."""
    if any(x is not None for x in of_windows):
        raise ValueError(
            "horizon, operating_range and lags are for windows: an observer looks at every sample"
        )
    watch: SetObserver[Any] | None = getattr(model, "observer", None)
    if watch is None:
        watch = observer(at_factors(as_model(cast(ModelLike, model), factors=True), factors))
    elif isinstance(watch.model, LinearSystem) and (watch.model.times or factors):
        watch = watch.of(at_factors(watch.model, factors))
    if not isinstance(fault, Fault):
        fault = Fault(fault)
    names = watch.model.outputs + watch.model.inputs
    if fault.signal not in names:
        raise ValueError(f"the model has no signal {fault.signal!r}: it has {listed(names, str)}")
    size, delay, phi = least_seen(watch, fault)
    best = np.maximum.accumulate(phi)
    sizes = {}
    for k in range(delay + 1):
        if best[k] > 0 and (k == 0 or best[k] > best[k - 1]):  # later samples that see less say nothing
            sizes[k] = 2 / float(best[k])
    return _guaranteed(size, delay, "", sizes)


def _by_tests(
    bank: MonitorBank,
    fault: str | Fault,
    operating_range: OperatingRange,
    factors: Mapping[str, Number] | None,
) -> GuaranteedSize:
    """Return the smallest GuaranteedSize of the tests of a monitor."""
    if factors and not any(getattr(watch.relations.model, "factors", ()) for watch in bank.watches):
        at_factors(bank.plant.replace(tests=None), factors)  # refuses them
    sizes: dict[str, GuaranteedSize] = {}
    unknown: NotImplementedError | None = None
    for watch in bank.watches:
        try:
            sizes[watch.name] = _of_test(watch.relations, fault, operating_range, factors)
        except NotImplementedError as e:
            unknown = e
        except ValueError as e:
            raise ValueError(f"test {watch.name!r}: {e}") from None
    if not sizes and unknown is not None:
        raise unknown
    least: dict[str | None, GuaranteedSize] = {}  # of each mode, the first of equals; None: of any
    for watch in bank.watches:
        if watch.name in sizes:
            own = sizes[watch.name]
            least[watch.when] = min(least.get(watch.when, own), own)
    best = least.pop(None, None)
    if bank.complete and len(least) == len(bank.conditions):  # whatever the mode, one of its tests sees it
        worst = max(map(least.__getitem__, bank.conditions))
        if best is None or worst < best:
            best = worst
    if best is None:
        best = _guaranteed(math.inf, bank.reach, "", {})
    best.tests = MappingProxyType({name: float(size) for name, size in sizes.items()})
    for name, size in sizes.items():
        if size is best:
            best.test = name
    return best


def _of_test(
    relations: Relations,
    fault: str | Fault,
    operating_range: OperatingRange,
    factors: Mapping[str, Number] | None,
) -> GuaranteedSize:
    """Return the GuaranteedSize of one test of a monitor."""
    model = relations.model
    if not getattr(model, "factors", ()):
        factors = None  # those of other tests
    if relations.remembers:
        return detectable(cast(SetObserver[Any], relations), fault, factors=factors)
    if relations.linear is None:
        raise NotImplementedError(
            f"what {type(relations).__name__} see is counted by jb.study, not worked out: guaranteed sizes "
            f"are known of windows of certain models, and of observers"
        )
    model = relations.linear.model
    return detectable(model, fault, operating_range=operating_range, factors=factors, **relations.span)


def always_seen(
    relations: Relations, method: str = "joint", readings: ArrayLike | None = None
) -> dict[str, float] | None:
    """Return {signal: size of a lasting error from which on every complete window that it fills is FAULT};
    inf: no size is sure to be seen.

    Args:
        relations: from `parity_relations`. method: of the test. readings: (T, p), NaN where missing: with a
            tolerance, how large they get.

    Returns:
        The sizes of `detectable` at the horizon of the relations, outputs first; None where they are not
        known: another method than "joint", an uncertain model, noise times factors, or windows so long that
            more than about a second would be spent.

    Example:
        >>> from jaxbound import LinearSystem
        >>> sizes = always_seen(parity_relations(LinearSystem([["1/2"]], None, [[1], [1]], noise=0.1), 0))
        >>> {signal: round(size, 6) for signal, size in sizes.items()}
        {'y1': 0.4, 'y2': 0.4}
    """
    if relations.linear is None or method != "joint" or not is_affordable(relations):
        return None
    model = relations.linear.model
    if model.uncertainties or model.factors:
        return None
    reach = None
    if any(model.tolerance):
        if readings is None or not np.size(readings):
            return None
        offset = np.array(model.offset["y"], float)
        deviations = abs(np.asarray(readings, float) - offset)
        reach = np.fmax.reduce(deviations, axis=0, initial=np.finfo(np.float32).tiny).tolist()
    sizes, most = {}, operating_reach(model, reach)
    for signal in model.outputs + model.inputs:
        sizes[signal] = float(_least_size(model, signal, [relations.horizon], most, relations.lags))
    return sizes


def is_affordable(relations: Relations) -> bool:
    """Return whether windows are so short that sizes of all signals take no more than about a second; of
    others nothing is asked.
    """
    if relations.linear is None:
        return True
    model, s = relations.linear.model, relations.horizon
    rows = (s + 1) * model.p + s * model.g
    return bool(rows**3 * (1 + model.d) * (model.p + model.m) <= EFFORT)


def _text(model: LinearSystem, s: int, h: Vector) -> str:
    """Return a relation of windows of s + 1 samples as a reader would write it."""
    h = linalg.presentable(linalg.primitive(h))
    K = window.unknowns(model, s)[1]
    k: Vector = ()
    if K[0]:
        (k,) = linalg.matmul((h,), K)
    return relation_text(model, s, h, k)


def operating_reach(model: LinearSystem, stated: OperatingRange) -> Vector:
    """Return the largest reading (deviation from the offset) of each output as a Fraction, from
    `operating_range` of `detectable`.
    """
    if stated is None:
        if any(model.tolerance):
            raise ValueError(
                "a tolerance makes a sensor less certain the larger its readings are: give operating_range, "
                "the largest of them"
            )
        ends = [abs(end) for pair in model.disturbance for end in pair]
        return (NEGLIGIBLE * max((*model.noise, *model.resolution, *ends), default=ZERO),) * model.p
    sizes = _by_output(model, stated)
    if len(sizes) != model.p:
        raise ValueError(
            f"operating_range needs one number, or one for each of {listed(model.outputs, str)}: "
            f"{len(sizes)} given"
        )
    reach = tuple(map(linalg.rational, sizes))
    if min(reach) <= 0:
        raise ValueError(f"operating_range must be positive, not {float(min(reach)):g}")
    return reach


def _by_output(model: LinearSystem, stated: Any) -> Sequence[Number]:  # a table by name has no common type
    """Return the numbers of an operating range, one for each output."""
    if isinstance(stated, Mapping) or hasattr(stated, "index") and hasattr(stated, "keys"):
        names = list(stated.keys())
        return [stated[find_column(name, names, "operating_range")] for name in model.outputs]
    if np.ndim(stated) == 0:
        return list(np.broadcast_to(np.asarray(stated, object), (model.p,)))  # a float32 stays one
    return cast("Sequence[Number]", stated)


def visible_sizes(
    relations: Redundancy | ParityRelation, operating_range: OperatingRange = None
) -> np.ndarray:
    """Return the smallest constant fault of each signal that each relation alone is guaranteed to see, (R,
    N): outputs, then inputs.

    Args:
        relations: a Redundancy, or a ParityRelation. operating_range: as for `detectable`.

    Returns:
        An array of sizes, rounded up; inf where no size is guaranteed.
    """
    parity = cast(ParityRelation, getattr(relations, "relations", relations))
    model = parity.model
    reach, signals = operating_reach(model, operating_range), model.outputs + model.inputs
    sizes = np.full((parity.count, len(signals)), math.inf)
    for j, signal in enumerate(signals):
        shift, widths, spread = window_shift(model, signal, parity.horizon, reach)
        for c, h in enumerate(parity.W):
            size = _least(h, shift, widths, spread)
            if size is not None:
                sizes[c, j] = math.nextafter(float(size), math.inf)
    return sizes


def _least(h: Vector, shift: Row, widths: Row, spread: Row) -> Fraction | None:
    """Return the size f from which on a relation h cannot hold, None if it always may: there
    f |h phi| = |h| (widths + f spread).
    """
    slope = abs(dot(h, shift)) - dot(map(abs, h), spread)
    if slope <= 0:
        return None
    return dot(map(abs, h), widths) / slope


def window_shift(
    model: LinearSystem, signal: str, s: int, reach: Sequence[Fraction], lags: tuple[int, ...] | None = None
) -> tuple[list[Fraction], list[Fraction], list[Fraction]]:
    """Return for each row that a window looks at: its shift by a fault of size 1, twice its half-width, and
    what the fault adds to that.
    """
    rows = window.window_rows(model, s, lags)
    every = row_widths(model, rows, reach)
    widths = [every[i] for i in rows.seen]
    shift = []
    if signal not in model.outputs:
        K = window.unknowns(model, s)[1]
        driven = model.inputs.index(signal)
        for i in rows.seen:
            moved = K[i][driven :: model.m]
            shift.append(Fraction(sum(moved.numbers), moved.over))
        return shift, widths, [ZERO] * len(widths)
    j = model.outputs.index(signal)
    stretch = 1 / (1 - model.tolerance[j] ** 2)
    for i in rows.seen:
        weights = [x.weight for x in rows.terms(rows.all[i]) if x.measured and x.number == j]
        shift.append(stretch * sum(weights, ZERO))
    return shift, widths, [model.tolerance[j] * x for x in shift]


def row_widths(model: LinearSystem, rows: WindowRows, reach: Sequence[Fraction]) -> list[Fraction]:
    """Return twice the half-width of each row at the end of the operating range."""
    floor = Fraction(float(np.finfo(np.float64).tiny))
    rounded, of_output = [], []
    for i, tolerance in enumerate(model.tolerance):
        size = reach[i] + abs(model.offset["y"][i]) + model.noise[i]
        rounded.append(model.resolution[i] + ROUNDING * UNIT * size)
        rho = model.noise[i] + rounded[i] + floor
        of_output.append(2 * (rho + tolerance * max(reach[i], rho)) / (1 - tolerance * tolerance))
    of_disturbance = [hi - lo + 2 * floor for lo, hi in model.disturbance]
    bounds = [bounded.bound for bounded in model.averages]
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


def _size(
    model: LinearSystem, signal: str, s: int, reach: Vector, lags: tuple[int, ...] | None
) -> Seen | None:
    """Return the smallest size that a window of horizon s always sees, and the relation that sees it; None
    where none is.

    Each relation that is violated at f gives a smaller f at which it just holds: there are finitely many.
    """
    E = window.unknowns(model, s)[0]
    looked_at = window.window_rows(model, s, lags).seen
    shift, widths, spread = window_shift(model, signal, s, reach, lags)
    space = [E[i] for i in looked_at]
    best = chebyshev(space, shift, widths)
    if best.t == 0:
        return None
    if not any(spread):
        return 1 / best.t, over_all_rows(best.h, looked_at, model, s)
    f = NEGLIGIBLE / best.t  # larger than any that matters: what no size shows is not seen
    first = True
    while True:
        radii = linalg.add_multiple(widths, f, spread)
        best = chebyshev(space, linalg.scale(shift, f), radii)
        if best.t < 1 or (best.t == 1 and first):
            return None
        size = _least(best.h, shift, widths, spread)
        assert size is not None, "a relation that is violated at a size sees that size"
        if best.t == 1:
            return size, over_all_rows(best.h, looked_at, model, s)
        f, first = size, False
