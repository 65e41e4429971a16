"""From healthy recordings to a monitor: a nominal model by regression, and the smallest noise bounds that
explain every training window.

The model is x+ = A x + B u, y = C x + D u in the states that an ARX model of the given order needs: those of
all outputs together. Its coefficients are rounded to short decimals first and the bounds found afterwards, so
that they hold for the model as it is saved. What the constant of the regression says becomes the operating
point.

Where errors average out, the mean of several of them has a smaller bound than one of them: `average` finds it
too, of the same windows.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from jaxbound.estimation.method import ObserverMethod
from jaxbound.estimation.methods import observer_method
from jaxbound.models.arguments import table_argument
from jaxbound.models.faults import Fault
from jaxbound.models.numbers import is_real, is_whole
from jaxbound.models.system import LinearSystem, whole_lags
from jaxbound.recordings.means import with_every
from jaxbound.recordings.signals import Signals
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.studies.identification import advice
from jaxbound.studies.identification.bank import fitted_bank
from jaxbound.studies.identification.bounds import Means, Walks, verified
from jaxbound.studies.identification.candidates import (
    KINDS,
    FitProblem,
)
from jaxbound.studies.identification.closed_loop import closed_loops
from jaxbound.studies.identification.disturbances import (
    chosen_disturbances,
    refuse_unseen,
    wanted_biases,
    wanted_faults,
)
from jaxbound.studies.identification.fit_result import FitCheck, Fitted, Follows, PartLeftOut, Tradeoff
from jaxbound.studies.identification.following import followed, refuse_follow, sizes_in_training
from jaxbound.studies.identification.gauge import GaugeJudge
from jaxbound.studies.identification.judging import Judge, ObserverJudge, WindowJudge, explains
from jaxbound.studies.identification.left_out import LeftOut, tried, widest
from jaxbound.studies.identification.means import smallest_means
from jaxbound.studies.identification.outliers import refuse_outliers
from jaxbound.studies.identification.proof import Proof, proved
from jaxbound.studies.identification.records import (
    Records,
    input_ranges,
    names_of,
    opened,
    parted,
    read_each,
    read_records,
)
from jaxbound.studies.identification.signal_choice import (
    SignalProblem,
    TriedSignals,
    chosen_signals,
    products,
    refuse_unnamed,
)
from jaxbound.studies.identification.structure import DELAYS, ORDERS, acting_otherwise, structure
from jaxbound.studies.identification.trajectories import SETTLED, SMALLER, GivenUp, hidden_jumps
from jaxbound.studies.identification.window_tests import (
    AVERAGES,
    RAMP,
    WINDOWS,
    JudgedTest,
    TriedTest,
    WindowChoice,
    best_kind,
    best_test,
    searched_means,
    tried_tests,
)
from jaxbound.studies.tuning.widening import stated
from jaxbound.text.progress import in_part, reporter

__all__ = ["fit"]

AUTO, BANK = "auto", "bank"
HORIZON = 15
"""Of the windows where neither a horizon nor lags are asked for."""


@where_proofs_hold()
def fit(
    recordings: object,
    order: int | str = 2,
    horizon: int | None = None,
    *,
    delay: int | str = 1,
    lags: Sequence[int] | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    dt: float | None = None,
    every: str | None = None,
    direct: bool = False,
    safety: float = 1.25,
    held_out: float = 0.3,
    method: str = "auto",
    average: int | None = None,
    test: str | None = None,
    observer: str | ObserverMethod | None = None,
    follow: float | str = 0,
    disturbances: str | None = None,
    see: Fault | Sequence[Fault] = (),
    signals: str | None = None,
    name: str = "fitted",
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    progress: Callable[[float], object] | None = None,
) -> Fitted:
    """Find a nominal model and noise bounds from healthy recordings.

    The smallest bounds are those under which every window of the recordings is consistent, in the ratio of
    the outputs' residuals: `tune` moves each by its own. Each recording in turn is then judged by a fit to
    all others: by the largest factor that one of them asks for the bounds are wider, and by `safety` on top.
    They are verified: `detect` finds every window CONSISTENT, or an observer no FAULT. Of n recordings that
    are like the next one, one in n + 1 may still ask for more.

    Args:
        recordings: one or several of: a path, as `read` takes it; (u (T, m), y (T, p)) or (u, y, starts), u
            None without inputs; a table with the columns `inputs` and `outputs`; a Recording. NaN marks a
            missing sample. No window crosses gaps in the times of a file or a table, or `starts`.
        order: so many samples back determine the next one (of "filters": so many filters an output). order *
            p states. 0: a static model, y = D u and a constant, of windows of one sample unless horizon asks
            for more. "auto": whichever of 1 to 4 sees the smallest errors at the bounds that recordings which
            are left out ask for.
        delay: so many samples pass before inputs act (dead time), 1 of a plant that answers at the next one;
            (delay - 1) * m more states. "auto": of 1 to 6 and 8, chosen as the order is.
        horizon: s, the bounds are found for windows of s + 1 samples; None: as `test` says. Long windows see
            small faults; the model says for which it is made.
        lags: of windows that look at the outputs at some samples only, in place of horizon; see
            `parity_relations` and `suggest_lags`.
        inputs, outputs: names; needed with tables and paths. dt: sampling period in s; None: what the times
            of tables, paths or a Recording say, else 1. every: an interval of the clock, like "15min":
            samples are the means of what was recorded within each, and the model keeps it.
        direct: whether inputs act on the outputs of the same sample (D).
        safety: factor >= 1 on top: how much more than in the recordings healthy operation may deviate.
        held_out: the share of a single recording that is a block: its blocks are left out in turn, which says
            less of another day than recordings do. 0: nothing is left out, of several recordings either.
        method: "least squares" (ARX, one step ahead), "windows" (the same, refined over whole windows),
            "filters" (inputs through given filters that fade within a window, so that no state can follow a
            lasting error) or "auto": whichever sees the smallest jump and lasting error with bounds as wide
            as recordings that are left out ask for.
        average: of so many errors in a row, at most horizon + 1, the mean gets a bound too: an average of the
            model. Lasting errors show smaller where errors do average out. None: none.
        test: "auto": windows are chosen, too, in place of horizon, lags and average: whichever of 8, 16, 31,
            61 samples, means of 8 and 16, and lags of 61 sees the smallest errors, each at the bounds that
            recordings which are left out ask of it; `.check.tests` has them all. "bank": as many of them as
            see clearly smaller jumps, lasting errors or ramps than the others: the model states them as its
            `tests`, each with coefficients and bounds of its own, and `jb.monitor` is all of them; `observer`
            or `disturbances` has a set observer ("joint" if none is named) tried beside them. None: as
            horizon, lags and average say, or the observer; where these and follow are left out, "bank", or
            windows of 16 samples where nothing can be left out to choose by.
        observer: the method of a set observer ("zonotope", "joint", ..), see `jb.observer`: the bounds are
            those at which it follows every recording, instead of those of windows; horizon is then that of
            the windows which `method` looks at. Not with lags or average.
        follow: how strongly bounds grow with the distance of the inputs from their training: a weight, which
            writes `times`, an expression of the inputs, to the bounds of all outputs; "auto": .1, .3 or 0,
            whichever sees the smallest errors at the bounds that recordings which are left out ask for. 0:
            bounds are constant. Not with average or every.
        disturbances: "auto": process noise and offsets that drift get bounds beside the noise of the sensors,
            those of a trajectory that explains each recording from start to end, so that they hold for
            windows and observers alike; which of them, by the smallest fault that is then seen in the longest
            recording. Not with average, follow or test="auto". None: none.
        see: a bias or a drift of a signal, or several, of the size that is wanted: disturbances are chosen
            for these, and bounds are as much wider than `safety` as these still allow. Biases of two outputs
            or more: bounds of these sensors are in the ratio of these sizes, not of the residuals, without
            disturbances too. (): biases of each output.
        signals: "auto": inputs are chosen, too: one is dropped, or a square or a product of two joins them,
            wherever clearly smaller errors are then seen at the bounds that recordings which are left out ask
            for; `.check.signals` has all that were tried. A product is an input whose column is an
            expression, like "= `fan` * `lift`", so recordings must be tables. None: inputs are as given.
        name, units, columns: as of a LinearSystem; tables are read by these columns too. progress: called
            with the share of the work done.

    Returns:
        A Fitted: a LinearSystem with `.horizon` (but for an observer), provenance "fitted ..." and `.check`.

    Raises:
        ValueError: recordings that do not fit each other, too few samples, an output that stands still,
            options out of range.

    Example:
        >>> import jax, jaxbound as jb
        >>> true = jb.LinearSystem([[0.8]], [[0.5]], [[1]], noise=0.1)
        >>> u = jax.random.normal(jax.random.key(0), (300, 1))
        >>> model = jb.fit((u, jb.simulate(true, u, jax.random.key(1)).y), order=1, horizon=4)
        >>> abs(float(model.A[0][0]) - 0.8) < 0.05, float(model.noise[0]) < 0.15
        (True, True)
    """
    left_open = test is None and (horizon, lags, average, observer) == (None,) * 4 and not follow
    if observer is not None:
        observer = _observer(observer, lags, average)
    if order == 0:
        direct = True
    wanted = wanted_faults(disturbances, see, average, follow, test == AUTO)
    if test is not None:
        chosen_by_it: dict[str, object] = {"horizon": horizon, "lags": lags, "average": average}
        if test != BANK:
            chosen_by_it["observer"] = observer
        _refuse_beside_test(test, order, chosen_by_it, follow)
    horizon, lags = _window(horizon, lags, order)
    _check_options(order, delay, horizon, safety, held_out, method, average)
    columns = table_argument("columns", columns, "{'Q': 'Heater 1'}")
    units = table_argument("units", units, "{'T': 'degC'}")
    if not isinstance(direct, bool | np.bool_):
        raise ValueError(f"direct must be True or False, not {direct!r}")
    if direct and delay != 1:
        raise ValueError("direct inputs act at once: leave delay at 1, or direct out")
    columns, dt = with_every(columns, dt, every)
    report = reporter(progress, "fit")
    begin_with = names_of("inputs", inputs) or ()
    pool: dict[str, str] = {}
    if signals is not None:
        _refuse_signals(signals, inputs)
        pool = products(begin_with, columns)
    recordings = opened(recordings, (*begin_with, *pool), outputs, columns | pool, dt)
    tried_sets: tuple[TriedSignals, ...] = ()
    if signals is not None:
        refuse_unnamed(recordings, pool)
        begun = dict(order=order, delay=delay, direct=direct, horizon=horizon, held_out=held_out)
        reading = dict(inputs=begin_with, outputs=outputs, columns=columns, dt=dt, lags=lags)
        tried_sets, found = _tried_signals(
            recordings, pool, begun, reading, partial(in_part, report, 0.0, 0.4)
        )
        inputs, columns, units = _as_chosen(tried_sets, pool, columns, units)
        report = partial(in_part, report, 0.4, 0.6)
        if inputs == tuple(begin_with):
            order, delay = found
    if left_open and order != 0:
        records = read_records(recordings, inputs, outputs, columns, dt)[3]
        test = BANK if parted(records, held_out, WINDOWS[0].horizon + 1) else None
    asked: dict[str, Any] = dict(order=order, horizon=horizon, delay=delay, lags=lags, inputs=inputs)
    asked |= dict(outputs=outputs, dt=dt, direct=direct, safety=safety, held_out=held_out, method=method)
    asked |= dict(average=average, test=test, observer=observer, follow=follow, disturbances=disturbances)
    asked |= dict(wanted=wanted, name=name, units=units, columns=columns, tried_sets=tried_sets)
    if test == BANK:
        watching: dict[str, Any] | None = None
        if observer is not None or disturbances is not None:
            watching = {"observer": observer or observer_method("joint"), "disturbances": disturbances}
            watching["see"] = wanted
        if wanted:  # refused before anything is worked out
            refuse_unseen(wanted, *read_records(recordings, inputs, outputs, columns, dt)[:2])
        same: dict[str, Any] = dict(inputs=inputs, outputs=outputs, dt=dt, every=every, direct=direct)
        same |= dict(safety=safety, held_out=held_out, name=name, units=units, columns=columns)
        biases = [fault for fault in wanted if fault.kind == "bias"]
        if len(wanted_biases(wanted)) > 1:
            same["see"] = biases

        def fit_one(own: Mapping[str, Any], report: Callable[[float], object]) -> Fitted:
            return fit(recordings, **{**same, **own}, progress=report)

        asked |= dict(test=AUTO, observer=None, disturbances=None, wanted=biases)
        base, proofs = _fit_once(recordings, **asked, report=partial(in_part, report, 0.0, 0.4))
        if left_open and watching is None and not any(map(_is_known, base.check.left_out)):
            asked |= dict(test=None, wanted=wanted)
            return _fit_once(recordings, **asked, report=partial(in_part, report, 0.4, 0.6))[0]
        return fitted_bank(base, proofs, fit_one, watching, report)
    return _fit_once(recordings, **asked, report=report)[0]


def _fit_once(
    recordings: object,
    *,
    order: int | str,
    horizon: int,
    delay: int | str,
    lags: Sequence[int] | None,
    inputs: str | Sequence[str] | None,
    outputs: str | Sequence[str] | None,
    dt: float | None,
    direct: bool,
    safety: float,
    held_out: float,
    method: str,
    average: int | None,
    test: str | None,
    observer: ObserverMethod | None,
    follow: float | str,
    disturbances: str | None,
    wanted: Sequence[Fault],
    name: str,
    units: Mapping[str, str] | None,
    columns: Mapping[str, str],
    tried_sets: tuple[TriedSignals, ...],
    report: Callable[[float], object],
) -> tuple[Fitted, dict[WindowChoice, Proof]]:
    """Return (fitted, proofs): of one test, by arguments that go together, and the `Proof` of each of the
    windows that were tried and that floats have looked at whole.
    """
    inputs, outputs, dt, records = read_records(recordings, inputs, outputs, columns, dt)
    about = dict(dt=dt, inputs=inputs, outputs=outputs, units=units, columns=columns, name=name)
    refuse_follow(follow, about, average)
    refuse_unseen(wanted, inputs, outputs)
    biases = wanted_biases(wanted)
    resting = advice.inputs_at_rest(records, inputs, outputs, horizon)
    again = partial(read_each, recordings, inputs, outputs, columns, None)
    signals = Signals(inputs, outputs, dict(columns), dt)
    measured_so = refuse_outliers(records, signals, _least(order), _least(delay), again)
    tests: tuple[JudgedTest, ...] = ()
    proofs: dict[WindowChoice, Proof] = {}
    taken: TriedTest | None = None
    if test is not None:
        parts = parted(records, held_out, horizon + 1)
        order, delay = _structure(records, parts, horizon, order, delay, direct)
        kinds = _kinds(method, order, parts, inputs)
        every_test = tried_tests(
            records, (order, delay, direct), about, kinds, held_out, safety, lambda x: report(0.6 * x), biases
        )
        tests = tuple(one.judged for one in every_test)
        picked = best_test(tests)
        horizon, lags, average, _ = picked.window
        method = picked.method
        for one in every_test:
            if one.complete:
                proofs[one.judged.window] = partial(proved, one, records, safety)
                if one.judged is picked:
                    taken = one
    judge: Judge = WindowJudge()
    if observer is not None:
        judge = ObserverJudge({"method": observer})
    elif lags is None:
        about["horizon"] = horizon
    else:
        about["lags"] = lags
    sentences = [
        *measured_so,
        *resting,
        *advice.inputs_together(records, inputs),
        *advice.apart(records, inputs, outputs),
        *closed_loops(records, inputs, outputs),
    ]
    parts, trials = parted(records, held_out, horizon + 1), []
    order, delay = _structure(records, parts, horizon, order, delay, direct)
    sentences += acting_otherwise(records, order, delay, direct)
    problem = FitProblem.of(records, order, delay, horizon, direct, about, judge, biases)
    report(0.05)

    kinds = _kinds(method, order, parts, inputs)
    walks: Walks | None = None
    tradeoff: tuple[Tradeoff, ...] = ()
    follows = Follows()
    if disturbances is not None:
        disturbed = chosen_disturbances(
            problem, kinds, records, held_out, safety, wanted, lambda share: report(0.05 + 0.75 * share)
        )
        best, walks, tradeoff = disturbed.trial, (disturbed.G, disturbed.walks), disturbed.rows
        sentences += disturbed.sentences
        safety = disturbed.safety
    elif taken is not None:
        best = taken.trial
    else:
        if observer is None and not follow:  # the proved test for the best of them alone
            kinds = [best_kind(problem, kinds, records, parts)]
        for number, kind in enumerate(kinds):
            trials.append(tried(problem, kind, records, parts))
            report(0.05 + 0.75 * (number + 1) / len(kinds))
        best = min(trials, key=lambda trial: trial.blindness)  # the first one of equals
        best, follows, constant = followed(problem, best, records, parts, follow, average)
        sentences += constant
    chosen, smallest, left = best.candidate, best.bound, best.left
    means: np.ndarray | None = None
    bounds = judge
    if taken is not None:
        means, bounds = taken.means, GaugeJudge(every=True)
    elif average is not None:
        explained = partial(explains, parts=records)
        model = LinearSystem(**chosen.spec)
        guess = searched_means(problem, best, average, records)
        means = smallest_means(
            model, smallest, average, explained, lambda share: report(0.8 + 0.1 * share), guess
        )
    averaged: Means = {}
    lowered: dict[str, dict[int, float]] = {}
    if average is not None and means is not None:
        averaged = {i: (average, x) for i, x in enumerate(means) if x < AVERAGES * smallest[i]}
        sentences += [advice.no_average(x, average) for i, x in enumerate(outputs) if i not in averaged]
        lowered = {outputs[i]: {average: float(x)} for i, (_, x) in averaged.items()}
    if taken is not None or average is not None:
        pairs = zip(left, parts, strict=True)
        left = tuple(one.under(bounds, smallest, lowered, [part]) for one, part in pairs)

    # few digits are what a user reads in the model file: the model that is verified is the one that is saved
    spec = chosen.spec | {"ranges": input_ranges(records, inputs)}
    factor = widest(left)
    if any(np.isfinite(one.factor) for one in left):
        spec["left_out"] = stated(factor)
    model, used = verified(judge, spec, smallest, averaged, records, factor, safety, walks)
    jump, steady = sizes_in_training(judge, model, problem.scales, follows.most)
    hidden: dict[str, float] = {}
    if observer is not None and observer.sharp:
        try:
            hidden = hidden_jumps(model, SETTLED, RAMP)
        except GivenUp as end:
            sentences.append(f"what noise may hide from any test is not known: {end}; {SMALLER}")
    check = FitCheck(
        method=chosen.kind,
        order=order,
        delay=delay,
        factor=factor,
        safety=float(safety),
        smallest=_named(outputs, smallest),
        smallest_mean=_named(outputs, means),
        held_out=_held_out_summary([one.need / safety for one in left]),
        left_out=tuple(map(_part_left_out, left)),
        recordings=tuple(_summary(y, x) for (_, y, _), x in zip(records, used, strict=True)),
        used=tuple(used),
        held_out_used=tuple(one.need / (factor * safety) for one in left),
        jump=jump,
        steady=steady,
        follows=follows,
        tests=tests,
        signals=tried_sets,
        tradeoff=tradeoff,
        hidden=hidden,
        moved=dict(zip(outputs, map(float, problem.spans), strict=True)),
    )
    if tests and taken is None:
        tests = tuple(check.of(one) if one is picked else one for one in tests)
        check = dataclasses.replace(check, tests=tests)
        sentences.append(advice.COMPLETE_ONLY)
    sentences = [*advice.blind(model, check), *sentences, *advice.limits(model, check, held_out)]
    report(1.0)
    return Fitted(model, dataclasses.replace(check, sentences=tuple(sentences))), proofs


def _refuse_signals(signals: str, inputs: str | Sequence[str] | None) -> None:
    """Raise ValueError for another word than auto, or where there is no input to begin with."""
    if signals != AUTO:
        raise ValueError(f"signals must be auto, or left out for inputs as given, not {signals!r}")
    if not inputs:
        raise ValueError(
            "signals = 'auto' chooses among inputs and their products: name the inputs to begin with"
        )


def _tried_signals(
    recordings: object,
    pool: Mapping[str, str],
    begun: Mapping[str, Any],
    stated: Mapping[str, Any],
    report: Callable[[float], object],
) -> tuple[tuple[TriedSignals, ...], tuple[int, int]]:
    """Return (the sets of inputs that were tried on recordings, the order and delay of those as given).

    Args:
        pool: columns of products by their names. begun: order, delay, direct, horizon and held_out. stated:
            the arguments of `fit` that say how recordings are read, and lags.
    """
    inputs, columns = stated["inputs"], {**stated["columns"], **pool}
    every = (*inputs, *pool)
    _, outputs, dt, records = read_records(recordings, every, stated["outputs"], columns, stated["dt"])
    horizon, direct = begun["horizon"], begun["direct"]
    own = [(u[:, : len(inputs)], y, starts) for u, y, starts in records]
    advice.inputs_at_rest(own, inputs, outputs, horizon)
    parts = parted(own, begun["held_out"], horizon + 1)
    order, delay = _structure(own, parts, horizon, begun["order"], begun["delay"], direct)
    about: dict[str, Any] = dict(dt=dt, outputs=outputs, lags=stated["lags"])
    if stated["lags"] is None:
        about["horizon"] = horizon
    problem = SignalProblem(every, records, (order, delay, direct), horizon, begun["held_out"], about)
    return chosen_signals(problem, inputs, report), (order, delay)


def _as_chosen(
    tried_sets: Sequence[TriedSignals],
    pool: Mapping[str, str],
    columns: Mapping[str, str],
    units: Mapping[str, str] | None,
) -> tuple[tuple[str, ...], dict[str, str], dict[str, str]]:
    """Return (inputs, columns, units) of the choice."""
    inputs = [one for one in tried_sets if one.taken][-1].inputs
    dropped = set(tried_sets[0].inputs) - set(inputs)
    named = {name: column for name, column in columns.items() if name not in dropped}
    named |= {name: pool[name] for name in inputs if name in pool}
    return inputs, named, {name: unit for name, unit in (units or {}).items() if name not in dropped}


def _observer(
    observer: str | ObserverMethod, lags: Sequence[int] | None, average: int | None
) -> ObserverMethod:
    """Return the method of an observer; refuse what it has no use for."""
    for name, value in (("lags", lags), ("average", average)):
        if value is not None:
            raise ValueError(
                f"{name} is for windows: a fit for an observer looks at every sample, leave it out"
            )
    try:
        return observer_method(observer)
    except ValueError as e:
        raise ValueError(f"observer: {e}") from None


def _refuse_beside_test(
    test: str, order: int | str, windows: Mapping[str, object], follow: float | str
) -> None:
    """Raise ValueError for another word than auto or bank, or where windows are not to be chosen."""
    if test not in (AUTO, BANK):
        raise ValueError(f"test must be auto or bank, or left out for windows as horizon says, not {test!r}")
    for name, value in windows.items():
        if value is not None:
            raise ValueError(f"test = {test!r} chooses windows: leave {name} out, or test")
    if follow:
        raise ValueError(f"test = {test!r} compares constant bounds: leave follow out, or test")
    if order == 0:
        raise ValueError("a static model, order 0, is tested sample by sample: leave test out")


def _window(
    horizon: int | None, lags: Sequence[int] | None, order: int | str
) -> tuple[int, tuple[int, ...] | None]:
    """Return (horizon, lags) of the windows that are asked for."""
    usual = HORIZON
    if order == 0:
        usual = 0
    if lags is None:
        return usual if horizon is None else horizon, None
    if horizon is not None:
        raise ValueError("lags say by themselves how long a window is: leave horizon out")
    lags = whole_lags(lags)
    return lags[-1], lags


def _structure(
    records: Records, parts: Records, horizon: int, order: int | str, delay: int | str, direct: bool
) -> tuple[int, int]:
    """Return the order and the delay, chosen where that is left to the data."""
    orders: Sequence[int] = ORDERS
    delays: Sequence[int] = DELAYS
    if order != AUTO:
        orders = (int(order),)
    if delay != AUTO:
        delays = (int(delay),)
    if AUTO not in (order, delay):
        return orders[0], delays[0]
    return structure(records, parts, horizon, orders, delays, direct)


def _least(number: int | str) -> int:
    """Return an order or a delay, 1 at least; of one that the data choose the least."""
    if number == AUTO:
        return 1
    return max(int(number), 1)


def _check_options(
    order: int | str,
    delay: int | str,
    horizon: int,
    safety: float,
    held_out: float,
    method: str,
    average: int | None,
) -> None:
    """Raise ValueError if an option is out of range."""
    for name, value, least in (("order", order, 0), ("delay", delay, 1)):
        if value != AUTO and not (is_whole(value) and value >= least):
            raise ValueError(f"{name} must be a whole number >= {least}, or auto, not {value!r}")
    if order == AUTO:
        order = 1
    if order == 0 and method not in ("auto", KINDS[0]):
        raise ValueError(f"a static model, order 0, is fitted by {KINDS[0]}: leave method out")
    shortest = 0 if order == 0 else int(order) + 1
    if not is_whole(horizon) or horizon < shortest:
        raise ValueError(f"horizon must be a whole number above the order ({order}), not {horizon!r}")
    if not (is_real(safety) and np.isfinite(safety) and safety >= 1):
        raise ValueError(f"safety must be a factor >= 1, not {safety!r}")
    if not (is_real(held_out) and 0 <= held_out < 1):
        raise ValueError(f"held_out must be a share from 0 to below 1, not {held_out!r}")
    if method not in ("auto", *KINDS):
        raise ValueError(f"method must be auto, {', '.join(KINDS)}, not {method!r}")
    if average is not None and not (is_whole(average) and 2 <= average <= horizon + 1):
        raise ValueError(
            f"average must be a whole number from 2 to the {horizon + 1} samples of a window, not {average!r}"
        )


def _kinds(method: str, order: int, parts: Records, inputs: Sequence[str]) -> list[str]:
    """Return the KINDS that are tried."""
    if order == 0:
        return [KINDS[0]]
    if method != "auto":
        return [method]
    if not parts:  # nothing tells them apart
        return ["windows"]
    return [kind for kind in KINDS if inputs or kind != "filters"]


def _is_known(part: PartLeftOut) -> bool:
    """Return whether a part that was left out says how wide bounds must be."""
    return math.isfinite(part.factor)


def _part_left_out(one: LeftOut) -> PartLeftOut:
    return PartLeftOut(int(np.isfinite(one.need).sum()), one.factor, one.why)


def _named(outputs: Sequence[str], bounds: np.ndarray | None) -> dict[str, float]:
    if bounds is None:
        return {}
    return dict(zip(outputs, bounds.tolist(), strict=True))


def _summary(y: np.ndarray, used: np.ndarray) -> dict[str, float]:
    """Return the counts of a recording, and the largest share of the bounds that a window of it uses."""
    finite = used[np.isfinite(used)]
    largest = float(finite.max()) if len(finite) else math.nan
    return {"samples": len(y), "windows": len(finite), "used": largest}


def _held_out_summary(shares: Sequence[np.ndarray]) -> dict[str, float] | None:
    """Return the verdicts on held-out windows, each given by the share of the bounds that it needs."""
    every = np.concatenate([*shares, [np.nan]])
    every = every[np.isfinite(every)]
    if not len(every):
        return None
    return {"windows": len(every), "fault": float((every > 1).mean()), "growth": float(every.max())}
