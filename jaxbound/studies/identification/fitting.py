"""From healthy recordings to a monitor: a nominal model by regression, and the smallest noise bounds that
explain every training window.

The model is x+ = A x + B u, y = C x + D u in the states that an ARX model of the given order needs: those of
all outputs together. Its coefficients are rounded to short decimals first and the bounds found afterwards, so
that they hold for the model as it is saved. What the constant of the regression says becomes the operating
point.

Where errors average out, the mean of several of them has a smaller bound than one of them: `average` finds it
too, of the same windows.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.models.system import LinearSystem, whole_lags
from jaxbound.recordings.hints import recorded_step
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification import filters, regression
from jaxbound.studies.identification.means import smallest_means
from jaxbound.studies.identification.realisation import realised, realised_filters
from jaxbound.studies.identification.records import measured, read_records
from jaxbound.text.objects import readable

__all__ = ["FitCheck", "Fitted", "fit"]

EXACT, LEAST = 1e-14, 1e-3
"""The least noise, as a share of the largest sample, and of what is needed of it: for a plant that fits
exactly.
"""
KINDS = ("least squares", "windows", "filters")
AVERAGES = 0.95
"""Share of the bound of a sample from which on that of a mean says nothing."""
FALSE_SHARE, CONTRADICTION, FEW = 0.02, 3.0, 10
"""Above this share of FAULT in held-out windows, this factor between the bounds of two recordings, below this
number of windows that do not overlap, the user is told that the data do not carry the monitor."""


@readable
@dataclass(frozen=True, eq=False)
class FitCheck:
    """What is known of a fit beyond its model.

    Fields:
        method: how the coefficients were found, see `fit`.
        safety: the factor on the smallest bounds. smallest: those, {output: bound}. smallest_mean: those of
            the mean of `average` errors in a row, {} where it was not asked for.
        held_out: what a first fit, to the first parts of the recordings, made of their last parts:
            {"windows", "fault", "growth"}: how many windows, the share in FAULT, and the factor by which the
            bounds would have had to be wider; None if nothing was held out. The model itself was fitted to
            everything afterwards.
        recordings: one {"samples", "windows", "used"} each: used is the largest share of the final bounds
            that a window needs.
        jump: {output: size}: a jump of one output in the middle of a window from which on the window is FAULT
            whatever the noise does.
        steady: the same for an error that fills the window; inf if the model can follow it.
        used, held_out_used: one array (T,) a recording, the share of the bounds that each window needs (nan
            where there is none): of the final model, and of the first fit on the held-out parts.
        sentences: what the user should know, above all why the data may not carry a monitor.
    """

    method: str
    safety: float
    smallest: dict[str, float]
    held_out: dict[str, float] | None
    recordings: tuple[dict[str, float], ...]
    jump: dict[str, float]
    steady: dict[str, float]
    used: tuple[np.ndarray, ...] = field(repr=False)
    held_out_used: tuple[np.ndarray, ...] = field(repr=False)
    sentences: tuple[str, ...] = ()
    smallest_mean: dict[str, float] = field(default_factory=dict)


class Fitted(LinearSystem):
    """A LinearSystem that `fit` made: with `.check`, a FitCheck, which is no part of its value."""

    check: FitCheck

    def __init__(self, model: LinearSystem, check: FitCheck) -> None:
        vars(self).update(vars(model), check=check)


def fit(
    recordings: object,
    order: int = 2,
    horizon: int | None = None,
    *,
    lags: Sequence[int] | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    dt: float | None = None,
    direct: bool = False,
    safety: float = 1.25,
    held_out: float = 0.3,
    method: str = "auto",
    average: int | None = None,
    name: str = "fitted",
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    progress: Callable[[float], object] | None = None,
) -> Fitted:
    """Find a nominal model and noise bounds from healthy recordings.

    The smallest bounds are those under which every window of the recordings is consistent, in the ratio of
    the outputs' residuals: `tune` moves each by its own. They are multiplied by `safety` and verified:
    `detect` finds every window CONSISTENT.

    Args:
        recordings: one or several of: (u (T, m), y (T, p)) or (u, y, starts), u None without inputs; a table
            with the columns `inputs` and `outputs`; a Recording. NaN marks a missing sample. No window
            crosses gaps in the times of a table, or `starts`.
        order: so many samples back determine the next one (of "filters": so many filters an output). order *
            p states.
        horizon: s, the bounds are found for windows of s + 1 samples; None: 15. Long windows see small
            faults; the model says for which it is made.
        lags: of windows that look at the outputs at some samples only, in place of horizon; see
            `parity_relations` and `suggest_lags`.
        inputs, outputs: names; needed with tables. dt: sampling period in s; None: what the times of tables
            or a Recording say, else 1.
        direct: whether inputs act on the outputs of the same sample (D).
        safety: factor >= 1 on the smallest bounds: how much more than in the recordings healthy operation may
            deviate.
        held_out: the last share of each recording, kept back from a first fit to see what it makes of data
            that it has not seen. 0: none.
        method: "least squares" (ARX, one step ahead), "windows" (the same, refined over whole windows),
            "filters" (inputs through given filters that fade within a window, so that no state can follow a
            lasting error) or "auto": whichever sees the smallest jump and lasting error when its bounds cover
            the held-out parts too.
        average: of so many errors in a row, at most horizon + 1, the mean gets a bound too: an average of the
            model. Lasting errors show smaller where errors do average out. None: none.
        name, units, columns: as of a LinearSystem; tables are read by these columns too. progress: called
            with the share of the work done.

    Returns:
        A Fitted: a LinearSystem with `.horizon`, provenance "fitted ..." and `.check`.

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
    if lags is not None:
        if horizon is not None:
            raise ValueError("lags say by themselves how long a window is: leave horizon out")
        lags = whole_lags(lags)
    horizon = (15 if lags is None else lags[-1]) if horizon is None else horizon
    _check_options(order, horizon, safety, held_out, method, average)
    report = progress or (lambda share: None)
    inputs, outputs, dt, records = read_records(recordings, inputs, outputs, columns, dt)
    about = dict(dt=dt, inputs=inputs, outputs=outputs, units=units, columns=columns, name=name)
    about |= {"horizon": horizon} if lags is None else {"lags": lags}
    refuse_unverified()  # at the end the bounds are verified
    scales = regression.scales_of(records)
    sentences = _standing_still(records, inputs, outputs)
    room = len(
        regression.windows_of(records, scales, horizon, regression.MOST).y
    )  # a first fit to a part of them compiles nothing new
    candidate = lambda records, kind: _candidate(records, scales, order, horizon, direct, kind, about, room)
    heads, tails = _parts(records, held_out, horizon)
    kinds = [k for k in KINDS if inputs or k != "filters"] if method == "auto" else [method]
    spans = [np.nanmax(y) - np.nanmin(y) for y in np.concatenate([r[1] for r in records]).T]
    kind, first = "windows" if method == "auto" else method, ()
    report(0.05)
    explained = lambda parts: lambda relations: _consistent(_tested(relations, parts))
    if tails:
        found = []
        for i, kind in enumerate(kinds):
            spec, relations, spread = candidate(heads, kind)
            own, unseen = _needs(relations, heads), _needs(relations, tails)
            blindness = _blindness(
                LinearSystem(**spec, noise=np.fmax(_most(own), _most(unseen)) * spread), scales, spans
            )
            found.append((blindness, i, spec, _most(own) * spread, tuple(x / _most(own) for x in unseen)))
            report(0.05 + 0.5 * (i + 1) / len(kinds))
        _, i, spec, bound, unseen = min(found, key=lambda f: f[:2])
        if average is not None:
            head = LinearSystem(**spec)
            first_means = smallest_means(
                head, bound, average, explained(heads), lambda share: report(0.55 + 0.2 * share)
            )
            averages = {name: {average: x} for name, x in zip(outputs, first_means, strict=True)}
            unseen = _needs(parity_relations(head.replace(noise=bound, averages=averages)), tails)
        kind, first = kinds[i], tuple(x / safety for x in unseen)
    spec, relations, spread = candidate(records, kind)
    smallest = spread * _most(_needs(relations, records))
    means: np.ndarray | None = None
    report(0.8)
    if average is not None:
        means = smallest_means(
            LinearSystem(**spec),
            smallest,
            average,
            explained(records),
            lambda share: report(0.8 + 0.1 * share),
        )
    named = lambda bounds: dict(zip(outputs, bounds.tolist(), strict=True))
    spec |= {"ranges": _ranges(records, inputs)}
    kept = (
        {} if means is None else {i: (average, x) for i, x in enumerate(means) if x < AVERAGES * smallest[i]}
    )
    model, used = _verified(spec, [_rounded_up(x * safety) for x in smallest], kept, records, safety)
    largest = lambda x: float(np.nanmax(x)) if np.isfinite(x).any() else math.nan
    jump, steady = _visible(model, scales)
    check = FitCheck(
        method=kind,
        safety=float(safety),
        smallest=named(smallest),
        smallest_mean={} if means is None else named(means),
        held_out=_unseen(first),
        recordings=tuple(
            {"samples": len(r[1]), "windows": int(np.isfinite(x).sum()), "used": largest(x)}
            for r, x in zip(records, used, strict=True)
        ),
        used=tuple(used),
        held_out_used=first,
        jump=jump,
        steady=steady,
    )
    if average is not None:
        sentences += [
            f"errors of {name} do not average out: the mean of {average} in a row is as large as one of "
            f"them, and gets no bound"
            for i, name in enumerate(outputs)
            if i not in kept
        ]
    report(1.0)
    return Fitted(
        model, dataclasses.replace(check, sentences=(*sentences, *_judged(model, check, held_out, spans)))
    )


def _check_options(order, horizon, safety, held_out, method, average):
    whole = lambda x: isinstance(x, (int, np.integer)) and not isinstance(x, bool)
    if not whole(order) or order < 1:
        raise ValueError(f"order must be a whole number >= 1, not {order!r}")
    if not whole(horizon) or horizon <= order:
        raise ValueError(f"horizon must be a whole number above the order ({order}), not {horizon!r}")
    if not (np.isfinite(safety) and safety >= 1):
        raise ValueError(f"safety must be a factor >= 1, not {safety!r}")
    if not 0 <= held_out < 1:
        raise ValueError(f"held_out must be a share from 0 to below 1, not {held_out!r}")
    if method not in ("auto", *KINDS):
        raise ValueError(f"method must be auto, {', '.join(KINDS)}, not {method!r}")
    if average is not None and not (whole(average) and 2 <= average <= horizon + 1):
        raise ValueError(
            f"average must be a whole number from 2 to the {horizon + 1} samples of a window, not {average!r}"
        )


def _standing_still(records, inputs, outputs):
    """Return sentences on inputs that do not move; refuse outputs that do not."""
    stack = [np.concatenate([r[j] for r in records]) for j in (0, 1)]
    still = lambda x: len(np.unique(x[~np.isnan(x)])) < 2
    for name, y in zip(outputs, stack[1].T, strict=True):
        if still(y):
            raise ValueError(
                f"{name} stands still in all recordings: nothing can be learnt of it; leave it out, or look "
                f"at the sensor"
            )
    return [
        f"{name} never moves in these recordings: what it does to the outputs is unknown, and the model says "
        f"nothing; record a step of it"
        for name, u in zip(inputs, stack[0].T, strict=True)
        if still(u)
    ]


def _parts(records, held_out, horizon):
    """Return (heads, tails): the recordings cut in two, tails empty where none holds a window."""
    if not held_out:
        return records, []
    cut = [_cut(~(np.isnan(u).any(1) | np.isnan(y).any(1)), 1 - held_out) for u, y, _ in records]
    part = lambda r, lo, hi: (r[0][lo:hi], r[1][lo:hi], r[2][(r[2] > lo) & (r[2] < hi)] - lo)
    heads = [part(r, 0, c) for r, c in zip(records, cut, strict=True)]
    tails = [part(r, c, len(r[1])) for r, c in zip(records, cut, strict=True)]
    whole = lambda parts: any(len(y) > horizon for _, y, _ in parts)
    return (heads, tails) if whole(heads) and whole(tails) else (records, [])


def _cut(usable, share):
    """Return the number of samples at the beginning that hold this share of all usable ones."""
    counted = np.cumsum(usable)
    return int(np.searchsorted(counted, share * counted[-1]) + 1) if usable.any() else len(usable)


def _candidate(records, scales, order, horizon, direct, kind, about, room):
    """Return (spec, relations, spread): the arguments of a LinearSystem, its relations, and the root mean
    square of its window residuals.

    The spread is in the unit of each output, and the noise bound of the relations.
    """
    p, m = len(about["outputs"]), len(about["inputs"])
    steps = regression.windows_of(records, scales, order)
    unknowns = order * (p + m) + direct * m + 1
    windows = regression.windows_of(records, scales, horizon, regression.MOST)
    if len(steps.y) < 2 * unknowns or not len(windows.y):
        total = f"{measured(records)}, in {len(records)} recording{'s' * (len(records) > 1)}"
        raise ValueError(
            f"too few samples: {total}, hold {len(windows.y)} complete windows of {horizon + 1} samples, and "
            f"{len(steps.y)} steps "
            f"for {unknowns} coefficients an output, twice as many of which are needed: record longer, or "
            f"choose a lower order or horizon"
        )
    digits = EXACT * np.array(
        [np.nanmax(np.abs(y)) for y in np.concatenate([y for _, y, _ in records]).T]
    )  # where all fits exactly
    if kind == "filters":
        spec, spread = realised_filters(records, scales, filters.poles_of(order, horizon), direct)
        spread = np.maximum(spread, digits)
        return (
            spec | about,
            parity_relations(LinearSystem(**spec | about)).with_bounds({"noise": spread}),
            spread,
        )
    theta, _ = regression.least_squares(steps, order, direct)
    spread = regression.window_spread(theta, windows, order, direct, room)
    if kind == "windows":
        theta, spread = regression.refined(theta, windows, order, direct, room)
    spec, spread = (
        realised(theta, scales, order, direct, m, p) | about,
        np.maximum(spread * scales.y_spread, digits),
    )
    return spec, parity_relations(LinearSystem(**spec)).with_bounds({"noise": spread}), spread


def _rounded_up(x, digits=3):
    """Return the next number of few digits that is not below x > 0."""
    unit = 10.0 ** (math.floor(math.log10(x)) - digits + 1)
    return float(f"{math.ceil(x / unit * (1 - 1e-12)) * unit:.12g}")


def _tested(relations, parts):
    """Return (status, need) of each recording, (T,) each: verdicts, and the factor on the bounds that a
    window needs, nan for none.
    """
    found = []
    for u, y, starts in parts:
        if len(y) > relations.horizon:
            res = detect(relations, u if u.shape[1] else None, y, starts=starts)
            found.append((res.status, 1 - res.margin))
        else:
            found.append((np.zeros(len(y), np.int8), np.full(len(y), np.nan)))
    return found


def _needs(relations, parts):
    return [need for _, need in _tested(relations, parts)]


def _most(needs):
    found = np.concatenate(needs)
    return max(float(np.nanmax(found)), LEAST) if np.isfinite(found).any() else math.nan


def _ranges(records, inputs):
    """Return {input: (lowest, highest)} of what was recorded; an input that never moved, or was never
    recorded, has none.
    """
    u = np.concatenate([r[0] for r in records])
    seen = {name: x[np.isfinite(x)] for name, x in zip(inputs, u.T, strict=True)}
    return {
        name: (float(x.min()), float(x.max())) for name, x in seen.items() if len(x) and x.min() < x.max()
    }


def _resolutions(records, p):
    """Return half a step of what the recorder rounds each output to, Fractions of few digits; 0 where no step
    is seen.
    """
    y = np.concatenate([r[1] for r in records])
    return [Fraction(f"{recorded_step(y[:, i]) / 2:.6g}") for i in range(p)]


def _consistent(found):
    """Say whether every window of what `_tested` returns is CONSISTENT."""
    return all(np.isin(status, (Status.MISSING, Status.CONSISTENT)).all() for status, _ in found)


def _verified(spec, bounds, means, records, safety):
    """Return (model, used): the model under which every window is CONSISTENT by the proved test, and the
    share of its bounds used.

    A bound is what the recorder rounds, as the resolution, and noise for the rest. Where the bound is smaller
    than that, nothing is
    rounded: the plant itself moves in steps. means: {number of the output: (samples, smallest bound of their
    mean)}.
    """
    rounds = _resolutions(records, len(bounds))
    total, count = measured(records), len(records)
    source = f"fitted to {total} samples in {count} recording{'s' * (count > 1)}"
    held = {i: _rounded_up(x * safety) for i, (_, x) in means.items()}
    for _ in range(20):
        exact = [Fraction(repr(x)) for x in bounds]
        rounds = [r if r < x else Fraction(0) for r, x in zip(rounds, exact, strict=True)]
        noise = [x - r for x, r in zip(exact, rounds, strict=True)]
        origin = {"model": source, "noise": f"{source}, safety factor {safety:g}"}
        origin |= {"resolution": "as the recordings are rounded"} if any(rounds) else {}
        averages = {
            spec["outputs"][i]: {n: max(Fraction(repr(held[i])) - rounds[i], Fraction(0))}
            for i, (n, _) in means.items()
        }
        model = LinearSystem(**spec, noise=noise, resolution=rounds, provenance=origin, averages=averages)
        found = _tested(parity_relations(model), records)
        if _consistent(found):
            break
        bounds, held = (
            [_rounded_up(1.001 * x) for x in bounds],
            {i: _rounded_up(1.001 * x) for i, x in held.items()},
        )
    return model, [need for _, need in found]


def _unseen(shares):
    """Return what the held-out windows, each with the share of the bounds that it needs, say."""
    found = np.concatenate([*shares, [np.nan]])
    found = found[np.isfinite(found)]
    return (
        {"windows": len(found), "fault": float((found > 1).mean()), "growth": float(found.max())}
        if len(found)
        else None
    )


def _visible(model, scales):
    """Return (jump, steady), {output: size} each, of an error of one output that no noise hides: from
    mid-window on, and all through it.
    """
    count, p = model.horizon + 1, model.p
    acts = np.stack([np.arange(count) >= count // 2, np.ones(count, bool)])
    wrong = acts[:, None, :, None] * np.diag(scales.y_spread)[None, :, None]  # (2, p, s + 1, p)
    y = np.array(model.offset["y"], float) + wrong
    u = np.broadcast_to(np.array(model.offset["u"], float), (2, p, count, model.m))
    margin = detect(parity_relations(model), u if model.m else None, y).margin[..., -1]
    with np.errstate(divide="ignore"):  # a need grows with the size; healthy noise takes 1 of it
        sizes = np.where(1 - margin > 1e-9, 2 * scales.y_spread / (1 - margin), np.inf)
    return [dict(zip(model.outputs, row, strict=True)) for row in sizes.tolist()]


def _blindness(model, scales, spans):
    """Return how large a jump and a lasting error must be to be seen, summed over outputs in their spreads.

    Beyond the span of an output it does not count how blind the monitor is for it.
    """
    return sum(
        min(size[name], span) / spread
        for size in _visible(model, scales)
        for name, span, spread in zip(model.outputs, spans, scales.y_spread, strict=True)
    )


def _judged(model, check, held_out, spans):
    """Return sentences on what the data do not carry."""
    out = []
    percent = lambda x: f"{100 * x:.3g} %"
    whole = sum(r["windows"] for r in check.recordings) // (model.horizon + 1)
    if whole < FEW:
        out.append(
            f"the recordings hold only {whole} windows of {model.horizon + 1} samples that do not overlap: "
            f"bounds from so little "
            "history may not last; record longer, or choose a shorter horizon"
        )
    if check.held_out is None:
        why = (
            "nothing was held out"
            if not held_out
            else "the recordings are too short to hold a part of them out"
        )
        out.append(f"{why}: what the monitor makes of data that it has not seen is unknown")
    elif check.held_out["fault"] > FALSE_SHARE:
        out.append(
            f"{percent(check.held_out['fault'])} of {check.held_out['windows']} held-out windows would be "
            f"FAULT under the bounds of the "
            f"first {percent(1 - held_out)} of the recordings, which would have to be "
            f"{check.held_out['growth']:.2f} times as wide: the "
            "recordings do not show all of healthy operation; record more of it, or raise the safety factor"
        )
    shares = {i: r["used"] for i, r in enumerate(check.recordings) if r["windows"]}
    if len(shares) > 1:
        low, high = min(shares, key=shares.__getitem__), max(shares, key=shares.__getitem__)
        if shares[high] > CONTRADICTION * shares[low]:
            out.append(
                f"recording {high + 1} needs bounds {shares[high] / shares[low]:.1f} times as wide as "
                f"recording {low + 1}: they "
                "contradict each other; look at what was different, or fit a model to each"
            )
    for i, name in enumerate(model.outputs):
        if check.jump[name] > spans[i]:
            unit = f" {model.unit(name)}".rstrip()
            out.append(
                f"the monitor is blind for {name}: no jump below {check.jump[name]:.3g}{unit} is sure to be "
                f"seen, but in all "
                f"recordings {name} moved by {spans[i]:.3g}{unit} only"
            )
        elif check.steady[name] > spans[i]:
            size, unit = check.steady[name], f" {model.unit(name)}".rstrip()
            sure = "however large" if math.isinf(size) else f"below {size:.3g}{unit}"
            out.append(
                f"an error of {name} that was there before the recording began and never changes may stay "
                f"unseen, {sure}, and in all "
                f"recordings {name} moved by {spans[i]:.3g}{unit} only: within {model.horizon + 1} samples "
                f"the model can follow it; a "
                "longer horizon sees smaller ones"
            )
    return out
