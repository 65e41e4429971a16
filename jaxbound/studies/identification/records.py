"""The recordings that a model is fitted to: one or several, as arrays, tables or Recordings, of one sampling
period.
"""

import itertools
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.models.signals import names_in
from jaxbound.recordings.arrays import holds_both, is_made
from jaxbound.recordings.clockintervals import every_text
from jaxbound.recordings.means import every_of
from jaxbound.recordings.read import read_signals
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import TOLERATED_DT
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.table import as_table, is_table

Record = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(u (T, m), y (T, p), starts)."""
Records = list[Record]
Names = tuple[str, ...]


def measured_count(records: Records) -> int:
    """Return in how many samples something was measured: those set aside by `where` are no part of a fit."""
    return sum(int((~np.isnan(y).all(1)).sum()) for _, y, _ in records)


def left_out_parts(records: Records, held_out: float, least: int) -> Records:
    """Return the parts that are left out in turn: the recordings; of a single one its blocks, none where a
    block has less than the least samples.

    Args:
        held_out: the share of its usable samples that a block of a single recording holds; 0: nothing is left
            out.
    """
    if not held_out:
        return []
    if len(records) > 1:
        return records
    ((u, y, starts),) = records
    usable = ~np.isnan(np.concatenate([u, y], 1)).any(1)
    count = max(round(1 / held_out), 2)
    cuts = [0, *(_cut(usable, i / count) for i in range(1, count)), len(y)]
    blocks = [_part(u, y, starts, first, stop) for first, stop in itertools.pairwise(cuts)]
    if min(len(y) for _, y, _ in blocks) < least:
        return []
    return blocks


def _cut(usable: np.ndarray, share: float) -> int:
    """Return the number of samples at the beginning that hold this share of all usable ones."""
    if not usable.any():
        return len(usable)
    counted = np.cumsum(usable)
    return int(np.searchsorted(counted, share * counted[-1]) + 1)


def _part(u: np.ndarray, y: np.ndarray, starts: np.ndarray, first: int, stop: int) -> Record:
    inside = (starts > first) & (starts < stop)
    return u[first:stop], y[first:stop], starts[inside] - first


def read_each(
    recordings: object,
    inputs: str | Sequence[str] | None,
    outputs: str | Sequence[str] | None,
    columns: Mapping[str, str] | None,
    dt: float | None,
) -> list[Recording]:
    """Return the recordings, with the names of inputs and outputs.

    Raises:
        OSError, ValueError: see `read_signals`; signals that are not named.
    """
    if is_pair(recordings) or not isinstance(recordings, list | tuple):
        recordings = [recordings]
    if not recordings:
        raise ValueError("there is no recording: give at least one")
    input_names, output_names = names_of("inputs", inputs), names_of("outputs", outputs)
    every = []
    for number, one in enumerate(recordings):
        where = f"recording {number + 1}"
        if isinstance(one, str | PathLike):
            if not output_names:
                raise ValueError(
                    f"{one} is a file: say which of its columns are what, "
                    f"fit({str(one)!r}, inputs=['heater'], outputs=['temperature'])"
                )
            (one,) = read_signals(one, input_names or (), output_names, dict(columns or {}), dt)
        parts = _parts(where, one)
        # names that the first recording has are those of all
        input_names, output_names = _named(where, parts, input_names, output_names)
        signals = Signals(input_names, output_names, dict(columns or {}), dt)
        recording = _read(where, signals, parts)
        _refuse_untimed(where, signals, recording)
        every.append(recording)
    return every


def is_pair(recording: object) -> bool:
    """Return whether an object is (u, y) or (u, y, starts), not several recordings."""
    if not isinstance(recording, tuple) or len(recording) not in (2, 3):
        return False
    return not isinstance(recording[0], tuple | str | PathLike) and not is_made(recording[0])


def _parts(where: str, recording: object) -> tuple[Any, ...]:
    """Return the arguments of `Recording.of` that a recording is."""
    if isinstance(recording, tuple) and is_pair(recording):
        return recording
    if holds_both(recording):
        return (recording,)
    kind = type(recording).__name__
    raise ValueError(f"{where} must be a pair (u, y), a DataFrame or a Recording, not {kind}")


def _read(where: str, signals: Signals, parts: tuple[Any, ...]) -> Recording:
    try:
        recording = Recording.of(signals, *parts).finite()
    except ValueError as e:
        raise ValueError(f"{where}: {e}") from None
    if recording.y.ndim != 2:
        raise ValueError(
            f"{where}: y has shape {recording.y.shape}, but time must be its first axis: give several "
            f"recordings as a list"
        )
    return recording


def _refuse_untimed(where: str, signals: Signals, recording: Recording) -> None:
    """Raise ValueError where means over intervals are asked for and nothing tells the time of a sample."""
    every = every_of(signals)
    if every is not None and recording.dt is None:
        raise ValueError(
            f"{where}: every = {every!r} needs the times of the samples: give a table with a column of them, "
            f"or a Recording"
        )


def sample_text(when: str, sample: int) -> str:
    """Return words for a sample: its time, as its owner writes it, and its number.

    Example:
        >>> sample_text("07:00", 60), sample_text("sample 60", 60)
        ('07:00 (sample 60)', 'sample 60')
    """
    number = f"sample {sample}"
    if when == number:
        return number
    return f"{when} ({number})"


def common_period(dt: float | None, recordings: Sequence[Recording]) -> float:
    """Return the sampling period: that which is asked for, else that of the first recording that has one."""
    periods: list[tuple[float, str]] = []
    for number, recording in enumerate(recordings, 1):
        if recording.dt is not None:
            periods.append((recording.dt, f"recording {number}"))
    if not periods:
        return dt or 1.0
    (low, first), (high, last) = min(periods), max(periods)
    if high - low > TOLERATED_DT * low:
        raise ValueError(
            f"{last} has a sample every {high:g} s, {first} every {low:g} s, and a model has one sampling "
            f"period: fit a model to each, or let the samples of all be means, every = {every_text(high)!r}"
        )
    if dt is None:
        return periods[0][0]
    return dt or 1.0


def names_of(field: str, given: str | Sequence[str] | None) -> Names | None:
    """Return the names of a field as a tuple; None where none are given."""
    if given is None:
        return None
    if isinstance(given, str):
        return (given,)
    return names_in(field, given)


def _named(
    where: str, parts: tuple[Any, ...], inputs: Names | None, outputs: Names | None
) -> tuple[Names, Names]:
    """Return the names of inputs and outputs: those not asked for are a Recording's own, or numbered."""
    tables = [is_table(as_table(x, where)) for x in parts[:2]]
    if (outputs is None and tables[-1]) or (inputs is None and len(parts) > 1 and tables[0]):
        raise ValueError(
            f"{where} is a DataFrame: say with inputs=[...] and outputs=[...] which of its columns are what"
        )
    if len(parts) == 1 and tables[0]:
        return inputs or (), outputs or ()
    if len(parts) == 1:
        recording = parts[0]
        inputs = inputs or getattr(recording, "inputs", None) or None
        outputs = outputs or getattr(recording, "outputs", None) or None
        parts = recording.u, recording.y
    if inputs is None:
        inputs = _numbered_names("u", parts[0])
    if outputs is None:
        outputs = _numbered_names("y", parts[1])
    return inputs, outputs


def _numbered_names(letter: str, x: ArrayLike | None) -> Names:
    """Return names such as u1, u2 of the columns of an array (T, m), of (T,) or of None."""
    if x is None:
        return ()
    count = np.shape(x)[-1] if np.ndim(x) > 1 else 1
    return tuple(f"{letter}{i + 1}" for i in range(count))
