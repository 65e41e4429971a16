"""Bounds of a fitted model: rounded up to few digits, and verified by the proved test itself."""

import math
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.models.system import FOR_OBSERVER, TO_THE_END, LinearSystem
from jaxbound.recordings.hints import recorded_step
from jaxbound.studies.identification.judging import Judge
from jaxbound.studies.identification.records import Records, measured
from jaxbound.studies.tuning.widening import widened

__all__ = ["Means", "Walks", "rounded_up", "verified"]

Means = dict[int, tuple[int, float]]
"""{number of an output: (samples, smallest bound of the mean of so many errors)}."""

Walks = tuple[np.ndarray, np.ndarray]
"""(G (n, g), smallest bounds (g,)) of disturbances."""

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
    judge: Judge,
    spec: dict[str, Any],
    smallest: np.ndarray,
    means: Means,
    records: Records,
    factor: float,
    safety: float,
    walks: Walks | None = None,
) -> tuple[LinearSystem, list[np.ndarray]]:
    """Return (model, used): the model that no window contradicts by the proved test, and the share of its
    bounds that each window uses.

    A bound is what the recorder rounds, as the resolution, and noise for the rest. Where the bound is smaller
    than that, nothing is rounded: the plant itself moves in steps.

    Args:
        spec: arguments of a LinearSystem. smallest: (p,), the smallest bounds; means: those of means. factor,
            safety: by which they are wider, as a recording that is left out asks for, and on top. walks: of
            disturbances.

    Raises:
        ValueError: no bounds hold, not those that are a little wider either.
    """
    wider = factor * safety
    bounds = [rounded_up(x * wider) for x in smallest]
    rounds = _resolutions(records, len(bounds))
    recordings = f"{len(records)} recording{'s' * (len(records) > 1)}"
    source = f"fitted to {measured(records)} samples in {recordings}"
    meant = ""
    if walks is not None:
        meant = f" {TO_THE_END}"
    elif "horizon" not in spec and "lags" not in spec:
        meant = f" {FOR_OBSERVER}"
    lowered = {i: rounded_up(x * wider) for i, (_, x) in means.items()}
    disturbance, pushes = None, []
    if walks is not None:
        pushes = [rounded_up(x * wider) for x in walks[1]]
    for _ in range(ATTEMPTS):
        exact = [Fraction(repr(x)) for x in bounds]
        rounds = [_below(r, x) for r, x in zip(rounds, exact, strict=True)]
        noise = [x - r for x, r in zip(exact, rounds, strict=True)]
        origin = {"model": source, "noise": f"{source}{meant}, {widened(factor, safety)}"}
        if any(rounds):
            origin["resolution"] = "as the recordings are rounded"
        if walks is not None and pushes:
            disturbance = (walks[0], pushes)
            origin["disturbance"] = f"{source}, {widened(factor, safety)}"
        averages = {}
        for i, (samples, _) in means.items():
            rest = max(Fraction(repr(lowered[i])) - rounds[i], Fraction(0))
            averages[spec["outputs"][i]] = {samples: rest}
        model = LinearSystem(
            **spec,
            noise=noise,
            resolution=rounds,
            disturbance=disturbance,
            provenance=origin,
            averages=averages,
        )
        holds, used = judge.shares(model, records)
        if holds:
            return model, used
        bounds = [rounded_up(WIDER * x) for x in bounds]
        pushes = [rounded_up(WIDER * x) for x in pushes]
        lowered = {i: rounded_up(WIDER * x) for i, x in lowered.items()}
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
