"""Mistakes of units and of columns: kelvin for degC, percent for a fraction, one signal in the place of
another. A hint on a recording that the model does not explain; no verdict changes.

Where most windows are FAULT, some hundred windows are tested again with signals converted or exchanged: a
change that makes nearly all of them consistent is worth a sentence. A dead signal explained by a factor of
1/1000 is not: it must do better than zero.
"""

import itertools
from collections.abc import Iterator
from functools import partial, singledispatch
from typing import NamedTuple, TypeAlias

import numpy as np

from jaxbound.certificates.interface import Judgement
from jaxbound.consistency.drive import as_stated
from jaxbound.consistency.interface import AUTO, EXACT, margins_for, window_count
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.expressions import is_expression
from jaxbound.recordings.recording import NOWHERE, Recording
from jaxbound.relations.parity import ParityRelation
from jaxbound.sets.floats.kernel import sparing, tried_in_numpy
from jaxbound.sets.floats.status import Status

MOST, NEARLY_ALL = 0.5, 0.95
"""Share of FAULT windows that makes us look, share of CONSISTENT ones that makes us speak."""
FEW, MANY = 16, 256
"""Windows by which a conversion is left out, and those that are tested again."""
WORK = 2**13
"""Windows of a small test that are judged at most for each of three looks: one that searches among many
disturbances costs hundreds of them.
"""
GROUPS = 40
"""Signals and groups of them that are tried at most."""

Group: TypeAlias = tuple[int, ...]
"""Numbers of signals, inputs first, that share a mistake."""


class Conversion(NamedTuple):
    """A way in which a signal may be meant: factor * signal + shift.

    Fields: text of the conversion, with {} for the signal; factor, shift; looks: like what the signal looks;
    units: that the model may have, None: any but a temperature.
    """

    text: str
    factor: float
    shift: float
    looks: str
    units: tuple[str, ...] | None = None


CELSIUS = ("degC", "°C", "C", "Celsius")
FAHRENHEIT = ("degF", "°F", "F", "Fahrenheit")
KELVIN = ("K", "kelvin", "Kelvin")
PERCENT = "percent where the model has a fraction, or another factor of 100, as kPa for bar"
FRACTION = "a fraction where the model has percent, or another factor of 100, as bar for kPa"
CONVERSIONS = (
    Conversion("{} - 273.15", 1.0, -273.15, "kelvin where the model has degC", CELSIUS),
    Conversion("{} + 273.15", 1.0, 273.15, "degC where the model has kelvin", KELVIN),
    Conversion("({} - 32) * 5 / 9", 5 / 9, -160 / 9, "degF where the model has degC", CELSIUS),
    Conversion("{} * 9 / 5 + 32", 9 / 5, 32.0, "degC where the model has degF", FAHRENHEIT),
    Conversion("{} * 9 / 5 - 459.67", 9 / 5, -459.67, "kelvin where the model has degF", FAHRENHEIT),
    Conversion("{} / 100", 1e-2, 0.0, PERCENT),
    Conversion("{} * 100", 1e2, 0.0, FRACTION),
    Conversion("{} / 1000", 1e-3, 0.0, "Pa where the model has kPa, or another factor of 1000"),
    Conversion("{} * 1000", 1e3, 0.0, "kPa where the model has Pa, or another factor of 1000"),
    Conversion("{} / 100000", 1e-5, 0.0, "Pa where the model has bar"),
    Conversion("{} * 100000", 1e5, 0.0, "bar where the model has Pa"),
)
# only where the unit says that it is a temperature: 5/9 is like many another error of scale
DIFFERENCES = (
    Conversion("{} * 5 / 9", 5 / 9, 0.0, "a difference in degF where the model has kelvin", CELSIUS + KELVIN),
    Conversion("{} * 9 / 5", 9 / 5, 0.0, "a difference in kelvin where the model has degF", FAHRENHEIT),
)
DEAD = Conversion("0", 0.0, 0.0, "a dead signal")
EXCHANGED = Conversion("{}", 1.0, 0.0, "exchanged")
"""Of a group whose first half stands in the columns of its second, and the other way round."""


@singledispatch
def unit_hints(result: Judgement) -> list[str]:
    """Return a sentence, or none, on signals that seem to be recorded in another unit, or in another column,
    than the model has.

    Args:
        result: of `detect`, of one recording. Only the joint test of a model without uncertain parameters is
            looked at, of a monitor its tests.

    Returns:
        A list of at most one sentence: which signals, which conversion, and what share of windows it makes
            consistent.
    """
    relations, status = result.relations, np.asarray(result.status)
    if result.method != "joint" or relations.linear is None or status.ndim != 1:
        return []
    if relations.model.constant_tolerance or relations.model.factors:  # which inputs in other units change
        return []
    tested = np.flatnonzero(status != Status.MISSING)
    if not len(tested):
        return []
    faulty = float(np.mean(status[tested] == Status.FAULT))
    if faulty <= MOST:
        return []
    signals, tries = np.concatenate([result.u, result.y], 1), _tries(relations.model)
    many = _spread(tested, MANY)
    # of a wrong one all of the first are outside: one more than nearly all leaves room for
    wrong = int((1 - NEARLY_ALL) * len(many)) + 1
    share, left = np.zeros(len(tries)), np.arange(len(tries))
    weight = relations.test("joint", signals.dtype).weight
    for count, least in ((wrong, 1), (FEW, FEW), (MANY, FEW)):
        able = [tries[i] for i in left]
        count = min(count, len(many), int(WORK // (weight * max(len(able), 1))))
        if not able or count < min(least, len(many)):  # a word on fewer windows would be a guess
            return []
        windows = _converted_windows(signals, _spread(many, count), relations.horizon, able)
        consistent = _consistent(relations, windows)
        share[left] = consistent.mean(1)
        left = left[np.count_nonzero(~consistent, axis=1) < min(wrong, count)]
    few = _converted_windows(signals, _spread(many, FEW), relations.horizon, tries)
    best = _best(relations.model, tries, few, share)
    if best is None:
        return []
    group, conversion = tries[best]
    names = [(relations.model.inputs + relations.model.outputs)[j] for j in group]
    return [_sentence(names, conversion, float(share[best]), faulty)]


def _spread(numbers: np.ndarray, count: int) -> np.ndarray:
    """Return so many of some numbers, evenly spread; all where there are fewer."""
    return np.asarray(numbers[np.unique(np.linspace(0, len(numbers) - 1, count).astype(int))])


def _tries(model: LinearSystem) -> list[tuple[Group, Conversion]]:
    """Return groups with what is tried on each: dead first, then each conversion that its units allow."""
    tries = [(group, EXCHANGED) for group in _exchanges(model)]
    for group in _groups(model):
        tries += [(group, DEAD), *((group, conversion) for conversion in _conversions(model, group))]
    return tries


def _converted_windows(
    signals: np.ndarray, ends: np.ndarray, horizon: int, tries: list[tuple[Group, Conversion]]
) -> np.ndarray:
    """Return the windows (tries, N, s + 1, inputs and outputs) that end at some samples, converted."""
    windows = signals[ends[:, None] + np.arange(-horizon, 1)]
    return np.stack([_converted_signals(windows, group, conversion) for group, conversion in tries])


def _consistent(relations: ParityRelation, converted: np.ndarray) -> np.ndarray:
    """Return which windows (tries, N, s + 1, inputs and outputs) are CONSISTENT under the bounds as stated:
    the wider ones outside of training would explain too many. Little is compiled for a hint alone.
    """
    model = relations.model
    u, y = np.split(converted, [model.m], -1)
    given = Recording(u, y, NOWHERE, model.inputs, model.outputs)
    test = relations.test("joint", y.dtype)
    count = window_count(y.shape[:-1], test.horizon)
    if margins_for(AUTO, count) == EXACT:
        test = test.measured()
    with sparing():
        work = count * test.weight
        judged = tried_in_numpy(partial(as_stated, test, given), work, ("hint", test.kind))
        status = (judged or as_stated(test, given)).status[..., -1]
    return np.asarray(status == Status.CONSISTENT)


def _best(
    model: LinearSystem, tries: list[tuple[Group, Conversion]], windows: np.ndarray, share: np.ndarray
) -> int | None:
    """Return the number of the conversion to speak of: of those that explain most, the one whose outputs are
    nearest to rest; None where none explains enough.
    """
    rest = np.array([*model.offset["u"], *model.offset["y"]], float)
    level = np.abs(np.nan_to_num(windows - rest))[..., model.m :].mean((1, 2, 3))
    dead = {group: x for (group, conversion), x in zip(tries, share, strict=True) if conversion is DEAD}
    for i in np.lexsort((level, -np.round(share, 2))):
        group, conversion = tries[i]
        if share[i] < NEARLY_ALL:
            return None
        if conversion is DEAD:
            continue
        # a factor below 1 explains no more than a dead signal where that explains as much
        if conversion.factor > 1 or conversion.shift or dead.get(group, 0.0) < NEARLY_ALL:
            return int(i)
    return None


def _sentence(names: list[str], conversion: Conversion, share: float, faulty: float) -> str:
    """Return the hint on signals that seem to be in another unit."""
    converted = " and ".join(map(conversion.text.format, names[:3]))
    if len(names) > 3:
        converted += " and so on"
    look = "look"
    if len(names) == 1:
        look = "looks"
    what = f"{' and '.join(names)} {look} like {conversion.looks}: with {converted}"
    if conversion is EXCHANGED:
        half = len(names) // 2
        one, other = ", ".join(names[:half]), ", ".join(names[half:])
        what = f"the columns of {one} and of {other} look exchanged: with each in the place of the other"
    return (
        f"{what}, {100 * share:.0f} % of the windows are consistent, instead of {100 * (1 - faulty):.0f} %; "
        f"the verdicts are those of the recording as it is"
    )


def _conversions(model: LinearSystem, group: Group) -> tuple[Conversion, ...]:
    """Return the conversions that the units of the signals, where they are stated, do not rule out."""
    names = model.inputs + model.outputs
    units = {model.unit(names[j]) for j in group} - {""}
    known: tuple[Conversion, ...] = CONVERSIONS
    if units:
        known = tuple(c for c in CONVERSIONS + DIFFERENCES if _allowed(c, units))
    # what is computed of columns, mostly a difference, has no zero that a unit moves
    computed = any(is_expression(model.columns.get(names[j], "")) for j in group)
    return tuple(c for c in known if not (computed and c.shift))


def _allowed(conversion: Conversion, units: set[str]) -> bool:
    if conversion.units is None:
        return not units & {*CELSIUS, *FAHRENHEIT, *KELVIN}
    return units <= set(conversion.units)


def _groups(model: LinearSystem) -> list[Group]:
    """Return tuples of signal numbers that may share a mistake: each alone, those of one unit, all outputs,
    all inputs.
    """
    names = model.inputs + model.outputs
    count = len(names)
    groups: list[Group] = [(j,) for j in range(count)]
    together = [
        tuple(j for j, name in enumerate(names) if model.unit(name) == unit)
        for unit in dict.fromkeys(model.units.values())
    ]
    together += [tuple(range(model.m, count)), tuple(range(model.m)), tuple(range(count))]
    groups += [group for group in together if len(group) > 1]
    return list(dict.fromkeys(groups))[:GROUPS]


def _exchanges(model: LinearSystem) -> Iterator[Group]:
    """Yield groups of signal numbers whose halves may stand in each other's columns: each two, and where
    there are as many, all inputs and all outputs.
    """
    yield from itertools.islice(itertools.combinations(range(model.m + model.p), 2), GROUPS)
    if model.m == model.p > 1:
        yield tuple(range(2 * model.m))


def _converted_signals(signals: np.ndarray, group: Group, conversion: Conversion) -> np.ndarray:
    """Return the signals with those of a group converted."""
    changed = signals.copy()
    if conversion is EXCHANGED:
        half = len(group) // 2
        changed[..., list(group)] = signals[..., [*group[half:], *group[:half]]]
        return changed
    changed[..., list(group)] = conversion.factor * signals[..., list(group)] + conversion.shift
    return changed
