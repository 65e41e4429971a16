"""Bounds of a fitted model: rounded up to few digits, and verified by the proved test itself."""

import math
from fractions import Fraction

import numpy as np

from jaxbound.models.system import FOR_OBSERVER, TO_THE_END, LinearSystem
from jaxbound.recordings.hints import recorded_step
from jaxbound.recordings.recordingformat import format_of
from jaxbound.studies.identification.extrapolation import extrapolation
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.records import Records, measured_count
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import Trial
from jaxbound.studies.tuning.widening import factors_text, stated

ATTEMPTS = 20
"""Times that bounds are widened where rounding left a window undecided."""
WIDER = 1.001


def rounded_up(x: float, digits: int = 3) -> float:
    """Return the next number of few digits that is not below x > 0.

    Example:
        >>> rounded_up(0.12341), rounded_up(0.5)
        (0.124, 0.5)
    """
    unit = 10.0 ** (math.floor(math.log10(x)) - digits + 1)
    return float(f"{math.ceil(x / unit * (1 - 1e-12)) * unit:.12g}")


def verified(
    judge: Judge, trial: Trial, training: Training, safety: float
) -> tuple[LinearSystem, list[np.ndarray]]:
    """Return (model, used): the model that no window contradicts by the proved test, and the share of its
    bounds that each window uses.

    A bound is what the recorder rounds, as the resolution, and noise for the rest. Where the bound is smaller
    than that, nothing is rounded: the plant itself moves in steps. No bound is smaller than a deadband that
    is stated, which is part of the resolution.

    Args:
        trial: with the smallest bounds, and the factor that recordings ask for which are left out. safety: by
            which bounds are wider on top.

    Raises:
        ValueError: no bounds hold, not those that are a little wider either.
    """
    records, factor = training.records, trial.factor
    spec = trial.candidate.spec | {"ranges": training.ranges, "columns": training.columns}
    if np.isfinite(trial.asked).any():
        spec["left_out"] = stated(factor)
    beyond, windows = None, not {"horizon", "lags"}.isdisjoint(spec)
    if windows:
        beyond = extrapolation(trial, training)
    if beyond is not None:
        spec["extrapolation"] = stated(beyond.factor)
    several = "s" * (len(records) > 1)
    source = f"fitted to {measured_count(records)} samples in {len(records)} recording{several}"
    meant = ""
    if trial.walks is not None:
        meant = f" {TO_THE_END}"
    elif not windows:
        meant = f" {FOR_OBSERVER}"
    wide = factors_text(factor, safety)
    origin = {"model": source, "noise": f"{source}{meant}, {wide}"}
    if beyond is not None:
        origin["extrapolation"] = beyond.text
    directions, walks = trial.walks or (np.zeros((0, 0)), np.zeros(0))
    wider = factor * safety
    bounds = [rounded_up(x * wider) for x in trial.bound]
    pushes = [rounded_up(x * wider) for x in walks]
    means = {}
    for name, own in trial.averages.items():
        means[name] = {samples: rounded_up(x * wider) for samples, x in own.items()}
    steps = dict(zip(spec["outputs"], _resolutions(records, len(bounds)), strict=True))
    bands = format_of(training).deadbands(training.outputs)
    for _ in range(ATTEMPTS):
        exact = dict(zip(spec["outputs"], [Fraction(repr(x)) for x in bounds], strict=True))
        exact = {name: max(x, bands[name]) for name, x in exact.items()}
        steps = {name: _below(steps[name], x - bands[name]) for name, x in exact.items()}
        rounds = {name: bands[name] + step for name, step in steps.items()}
        if any(rounds.values()):
            origin["resolution"] = "as the recordings are rounded"
        if any(bands.values()):
            origin["resolution"] = "the deadband that is stated, and as the recordings are rounded"
        disturbance = None
        if pushes:
            disturbance = directions, pushes
            origin["disturbance"] = f"{source}, {wide}"
        averages = {}
        for name, own in means.items():
            averages[name] = {n: max(Fraction(repr(x)) - rounds[name], Fraction(0)) for n, x in own.items()}
        model = LinearSystem(
            **spec,
            noise=[x - rounds[name] for name, x in exact.items()],
            resolution=list(rounds.values()),
            disturbance=disturbance,
            provenance=origin,
            averages=averages,
        )
        holds, used = judge.shares(model, records)
        if holds:
            return model, used
        bounds = [rounded_up(WIDER * x) for x in bounds]
        pushes = [rounded_up(WIDER * x) for x in pushes]
        means = {name: {n: rounded_up(WIDER * x) for n, x in own.items()} for name, own in means.items()}
    raise ValueError(
        "no bounds were found that are proved to hold for these recordings: choose a lower order, or a "
        "shorter horizon"
    )


def _below(rounding: Fraction, bound: Fraction) -> Fraction:
    """Return the rounding of a recorder if that is less than the bound, else 0."""
    if rounding < bound:
        return rounding
    return Fraction(0)


def _resolutions(records: Records, p: int) -> list[Fraction]:
    """Return half a step of what the recorder rounds each output to, Fractions of few digits; 0 where no step
    is seen.
    """
    y = np.concatenate([r[1] for r in records])
    return [Fraction(f"{recorded_step(y[:, i]) / 2:.6g}") for i in range(p)]
