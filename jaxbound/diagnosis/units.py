"""Mistakes of units: kelvin for degC, percent for a fraction. A hint on a recording that the model does not
explain; no verdict changes.

Where most windows are FAULT, some hundred windows are tested again with signals converted: a conversion that
makes nearly all of them consistent is worth a sentence. A dead signal explained by a factor of 1/1000 is not:
it must do better than zero.
"""

from typing import Any

import numpy as np

from jaxbound.consistency.drive import drive
from jaxbound.recordings.recording import Recording
from jaxbound.relations.parity import ParityRelation
from jaxbound.sets.floats.status import Status

__all__ = ["unit_hints"]

MOST, NEARLY_ALL = (
    0.5,
    0.95,
)  # share of FAULT windows that makes us look, share of CONSISTENT ones that makes us speak
STRETCHES, LONG = 4, 64  # parts of the recording that are tested again, and their windows
GROUPS = 40  # signals and groups of them that are tried at most

CELSIUS, FAHRENHEIT, KELVIN = (
    ("degC", "°C", "C", "Celsius"),
    ("degF", "°F", "F", "Fahrenheit"),
    ("K", "kelvin", "Kelvin"),
)
TEMPERATURES = {unit: kind for kind in (CELSIUS, FAHRENHEIT, KELVIN) for unit in kind}
# as text, factor, shift, what the signal looks like, units that the model may have (None: any but a
# temperature)
CONVERSIONS = (
    ("{} - 273.15", 1.0, -273.15, "kelvin where the model has degC", CELSIUS),
    ("{} + 273.15", 1.0, 273.15, "degC where the model has kelvin", KELVIN),
    ("({} - 32) * 5 / 9", 5 / 9, -160 / 9, "degF where the model has degC", CELSIUS),
    ("{} * 9 / 5 + 32", 9 / 5, 32.0, "degC where the model has degF", FAHRENHEIT),
    ("{} * 9 / 5 - 459.67", 9 / 5, -459.67, "kelvin where the model has degF", FAHRENHEIT),
    (
        "{} / 100",
        1e-2,
        0.0,
        "percent where the model has a fraction, or another factor of 100, as kPa for bar",
        None,
    ),
    (
        "{} * 100",
        1e2,
        0.0,
        "a fraction where the model has percent, or another factor of 100, as bar for kPa",
        None,
    ),
    ("{} / 1000", 1e-3, 0.0, "Pa where the model has kPa, or another factor of 1000", None),
    ("{} * 1000", 1e3, 0.0, "kPa where the model has Pa, or another factor of 1000", None),
    ("{} / 100000", 1e-5, 0.0, "Pa where the model has bar", None),
    ("{} * 100000", 1e5, 0.0, "bar where the model has Pa", None),
)
DIFFERENCES = (  # only where the unit says that it is a temperature: 5/9 is like many another error of scale
    ("{} * 5 / 9", 5 / 9, 0.0, "a difference in degF where the model has kelvin", CELSIUS + KELVIN),
    ("{} * 9 / 5", 9 / 5, 0.0, "a difference in kelvin where the model has degF", FAHRENHEIT),
)


def unit_hints(result: Any) -> list[str]:
    """Return a sentence, or none, on signals that seem to be recorded in another unit than the model has.

    Args:
        result: of `detect`, of one recording. Only the joint test of a model without uncertain parameters is
            looked at.

    Returns:
        A list of at most one sentence: which signals, which conversion, and what share of windows it makes
            consistent.
    """
    relations, status = result.relations, np.asarray(result.status)
    if (
        result.method != "joint"
        or not isinstance(relations, ParityRelation)
        or relations.model.constant_tolerance
        or status.ndim != 1
    ):
        return []
    tested = np.flatnonzero(status != Status.MISSING)
    now = float(np.mean(status[tested] == Status.FAULT)) if len(tested) else 0.0
    if now <= MOST:
        return []
    model, length = relations.model, min(len(status), relations.horizon + LONG)
    starts = np.unique(
        np.clip(
            tested[(np.linspace(0, 1, STRETCHES) * (len(tested) - 1)).astype(int)] - length // 2,
            0,
            len(status) - length,
        )
    )
    at = starts[:, None] + np.arange(length)
    mask = status[at] != Status.MISSING
    mask[:, : relations.horizon] = False
    if not mask.any():
        return []
    signals, rest = (
        np.concatenate([result.u, result.y], 1)[at],
        np.array([*model.offset["u"], *model.offset["y"]], float),
    )
    tries = []
    for group in _groups(model):
        tries.append((group, None, _changed(signals, group, 0.0, 0.0)))
        tries += [(group, c, _changed(signals, group, c[1], c[2])) for c in _conversions(model, group)]
    found = np.stack([x for _, _, x in tries]).astype(result.y.dtype)
    given = Recording(
        found[..., : model.m], found[..., model.m :], np.zeros(0, np.int64), model.inputs, model.outputs
    )
    again = drive(relations.test("joint", found.dtype), given).status == Status.CONSISTENT
    share = again[:, mask].mean(1)
    zero = {group: x for (group, c, _), x in zip(tries, share, strict=True) if c is None}
    level = np.abs(np.nan_to_num(found - rest))[..., model.m :].mean(
        (1, 2, 3)
    )  # of alternatives that explain as much, the nearest to rest
    for i in np.lexsort((level, -np.round(share, 2))):
        group, conversion, _ = tries[i]
        if share[i] < NEARLY_ALL:
            return []
        if conversion is not None and (conversion[1] > 1 or conversion[2] or zero[group] < NEARLY_ALL):
            names = [(model.inputs + model.outputs)[j] for j in group]
            converted = " and ".join(conversion[0].format(name) for name in names[:3]) + (
                " and so on" if len(names) > 3 else ""
            )
            looks = f"{' and '.join(names)} look{'s' * (len(names) == 1)} like {conversion[3]}"
            return [
                f"{looks}: with {converted}, {100 * share[i]:.0f} % of the windows are consistent, instead "
                f"of "
                f"{100 * (1 - now):.0f} %; the verdicts are those of the recording as it is"
            ]
    return []


def _conversions(model, group):
    """Return the conversions that the units of the signals, where they are stated, do not rule out."""
    units = {model.unit((model.inputs + model.outputs)[j]) for j in group} - {""}
    if not units:
        return CONVERSIONS
    allowed = lambda c: all(unit not in TEMPERATURES if c[4] is None else unit in c[4] for unit in units)
    return [c for c in CONVERSIONS + DIFFERENCES if allowed(c)]


def _groups(model):
    """Return tuples of signal numbers that may share a mistake: each alone, those of one unit, all outputs,
    all inputs.
    """
    names = model.inputs + model.outputs
    together = [
        tuple(j for j, name in enumerate(names) if model.unit(name) == unit)
        for unit in dict.fromkeys(model.units.values())
    ]
    together += [tuple(range(model.m, len(names))), tuple(range(model.m)), tuple(range(len(names)))]
    groups = [(j,) for j in range(len(names))] + [group for group in together if len(group) > 1]
    return list(dict.fromkeys(groups))[:GROUPS]


def _changed(signals, group, factor, shift):
    """Return the signals with those of a group converted."""
    out = signals.copy()
    out[..., list(group)] = factor * out[..., list(group)] + shift
    return out
