"""The signals of a model and their sensors: what they are called, where they are recorded, and how far a
recorded sample may be off.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias, cast

import jax
import numpy as np

from jaxbound.exact.linalg import Number, Vector
from jaxbound.models.arguments import listed_argument, table_argument
from jaxbound.models.numbers import number, ordered_pair
from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.recordings.means import EVERY
from jaxbound.recordings.recordingformat import RECORDING, UNSTATED, RecordingFormat
from jaxbound.text.names import listed

Each: TypeAlias = Number | Sequence[Number] | np.ndarray | jax.Array
"""One number for all, or one for each."""
Names: TypeAlias = str | Sequence[str] | None
"""Names as they are given; None: numbered."""
Words: TypeAlias = tuple[tuple[str, str], ...]
"""Pairs (name, text) in one order, whatever the order of the table they came from."""


@dataclass(frozen=True)
class ModelSignals:
    """The signals of a model. Build it with `model_signals`.

    Fields: inputs, outputs, states: names; input_offset (m,), output_offset (p,): the operating point; units,
    columns: of signals by name; ranges: (name, lowest, highest) of the inputs whose range is known.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    input_offset: Vector
    output_offset: Vector
    units: Words
    columns: Words
    ranges: tuple[tuple[str, Fraction, Fraction], ...] = ()


@dataclass(frozen=True)
class Sensors:
    """The bounds of the sensors of a model, one number an output. Build it with `sensors`; the fields are
    those of a LinearSystem, times as pairs (output, expression).
    """

    tolerance: Vector
    noise: Vector
    resolution: Vector
    constant_tolerance: bool
    times: Words = ()


def model_signals(
    sizes: tuple[int, int, int],
    names: tuple[Names, Names, Names],
    offset: Mapping[str, Each] | None,
    units: Mapping[str, str] | None,
    columns: Mapping[str, str] | None,
    ranges: Mapping[str, tuple[Number, Number]] | None = None,
) -> ModelSignals:
    """Check the arguments of a LinearSystem that speak of its signals and return them in one form.

    Args:
        sizes: (m, p, n), numbers of inputs, outputs and states. names: of these. The rest: as of a
            LinearSystem.

    Raises:
        ValueError: a wrong number of names, a name used twice, a unit or column of a signal that the model
            does not have.
    """
    m, p, n = sizes
    inputs, outputs, states = names
    input_names = named("inputs", inputs, m, "u")
    output_names = named("outputs", outputs, p, "y")
    state_names = named("states", states, n, "x")
    recorded = input_names + output_names
    # states may be called like outputs, which they often are
    twice = sorted({x for x in recorded if recorded.count(x) > 1})
    if twice:
        raise ValueError(f"a signal name may stand for one signal only: {listed(twice)} is used twice")
    offset = table_argument("offset", offset, "{'u': [20], 'y': [35.5]}")
    unknown = set(offset) - {"u", "y"}
    if unknown:
        raise ValueError(f"offset has the fields 'u' and 'y', not {sorted(unknown)}")
    input_offset = _vector("offset u", offset.get("u", 0), input_names)
    output_offset = _vector("offset y", offset.get("y", 0), output_names)
    texts = words("columns", columns, (*recorded, "time", "where", EVERY, RECORDING))
    for name, text in texts:
        if name == EVERY:
            seconds_of(text)
        elif name == RECORDING:
            RecordingFormat.of(text)
        elif name == "where" or (name != "time" and is_expression(text)):
            expression(text)  # refuses what it cannot read
    return ModelSignals(
        input_names,
        output_names,
        state_names,
        input_offset,
        output_offset,
        units=words("units", units, recorded + state_names),
        columns=texts,
        ranges=_ranges(ranges, input_names),
    )


def refuse_other_every(columns: Words, dt: float, has_factors: bool) -> None:
    """Raise ValueError if samples are means over another interval than dt, in s, or have factors on noise."""
    every = dict(columns).get(EVERY)
    if every is not None and has_factors:
        raise ValueError(
            f"every = {every!r} and times do not go together: a factor on noise is of a sample, no mean"
        )
    if every is not None and abs(seconds_of(every) - dt) > 1e-9 * dt:
        raise ValueError(
            f"every = {every!r} is {seconds_of(every):g} s and dt = {dt:g} s: samples that are means over an "
            f"interval are that far apart"
        )


def _ranges(
    table: Mapping[str, tuple[Number, Number]] | None, inputs: tuple[str, ...]
) -> tuple[tuple[str, Fraction, Fraction], ...]:
    """Return (name, lowest, highest) of every input whose range is stated, in the order of the inputs."""
    stated = table_argument("ranges", table, "{'Q': (0, 100)}")
    unknown = sorted(set(stated) - set(inputs))
    if unknown:
        raise ValueError(f"ranges speaks of {listed(unknown)}, but the model's inputs are {listed(inputs)}")
    ranges = []
    for name in inputs:
        if name in stated:
            ranges.append((name, *ordered_pair(f"the range of {name!r}", stated[name])))
    return tuple(ranges)


def sensors(
    outputs: tuple[str, ...],
    tolerance: Each,
    noise: Each,
    resolution: Each | None,
    constant_tolerance: bool | np.bool_,
    how: RecordingFormat = UNSTATED,
) -> Sensors:
    """Check the arguments of a LinearSystem that speak of its sensors and return them exactly. how: by the
    deadband that it states a sample may be off, so an output without a resolution has that.

    Raises:
        ValueError: a number that is not finite, a wrong number of them, a negative bound, a tolerance >= 1, a
            resolution below the deadband.
    """
    if not isinstance(constant_tolerance, (bool, np.bool_)):
        raise ValueError(f"constant_tolerance must be True or False, not {constant_tolerance!r}")
    return Sensors(
        _bound("tolerance", tolerance, outputs),
        _bound("noise", noise, outputs),
        _with_deadbands(_bound("resolution", 0 if resolution is None else resolution, outputs), outputs, how),
        bool(constant_tolerance),
    )


def _with_deadbands(resolution: Vector, outputs: tuple[str, ...], how: RecordingFormat) -> Vector:
    """Return the resolutions, the deadband of an output where it has none."""
    bands, both = how.deadbands(outputs), []
    for name, stated in zip(outputs, resolution, strict=True):
        if 0 < stated < bands[name]:
            raise ValueError(
                f"the resolution of {name!r}, {float(stated):g}, is below its deadband, "
                f"{float(bands[name]):g}: it is what is rounded away and the deadband, "
                f"{float(stated + bands[name]):g} in all"
            )
        both.append(stated or bands[name])
    return tuple(both)


def words(field: str, table: Mapping[str, str] | None, known: Collection[str]) -> Words:
    """Return a table of texts as pairs in the order of the names that are known.

    Raises:
        ValueError: a name that is not known.
    """
    texts = {str(k): str(v) for k, v in table_argument(field, table, "{name: text}").items()}
    unknown = sorted(set(texts) - set(known))
    if unknown:
        raise ValueError(f"{field} speaks of {listed(unknown)}, but the model knows only {listed(known)}")
    return tuple((name, texts[name]) for name in dict.fromkeys(known) if name in texts)


def _bound(field: str, value: Each, outputs: tuple[str, ...]) -> Vector:
    bounds = _vector(field, value, outputs)
    for output, b in zip(outputs, bounds, strict=True):
        if b < 0:
            raise ValueError(f"{field} must be >= 0: output {output!r} has {float(b):g}")
        if field == "tolerance" and b >= 1:
            raise ValueError(
                f"tolerance is relative and must be below 1 (2 % is 0.02): output {output!r} has {float(b):g}"
            )
    return bounds


def _vector(field: str, value: Each, names: tuple[str, ...]) -> Vector:
    if isinstance(value, str | Fraction) or np.asarray(value, object).ndim == 0:
        return (number(field, cast("Number", value)),) * len(names)
    values = list(cast("Sequence[Number]", value))
    if len(values) != len(names):
        raise ValueError(
            f"{field} needs one number, or one for each of {listed(names, str)}: {len(values)} given"
        )
    return tuple(number(f"{field} of {s!r}", x) for s, x in zip(names, values, strict=True))


def names_in(field: str, stated: Iterable[object]) -> tuple[str, ...]:
    """Return names as a tuple; raise ValueError for what is no list of them."""
    return tuple(map(str, listed_argument(field, stated, "['T1', 'T2']")))


def named(field: str, stated: Names, count: int, letter: str) -> tuple[str, ...]:
    """Return the names of as many signals: those stated, or numbered with a letter.

    Raises:
        ValueError: another number of names, a name used twice.
    """
    if stated is None:
        return tuple(f"{letter}{i + 1}" for i in range(count))
    names = (stated,) if isinstance(stated, str) else names_in(field, stated)
    if len(names) != count:
        raise ValueError(f"{field} needs {count} names, one for each: {len(names)} given")
    if len(set(names)) < count:
        raise ValueError(f"{field} must have different names: {listed(names)}")
    return names
