"""The recordings that a model is fitted to: one or several, as arrays, tables or Recordings, of one sampling
period.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from jaxbound.recordings.arrays import holds_both, is_made
from jaxbound.recordings.recording import Recording, Signals
from jaxbound.recordings.seams import TOLERATED_DT
from jaxbound.recordings.table import as_table, is_table

__all__ = ["Records", "measured", "read_records"]

Records = list[tuple[np.ndarray, np.ndarray, np.ndarray]]
"""(u (T, m), y (T, p), starts) of each."""


def measured(records: Records) -> int:
    """Return in how many samples something was measured: those set aside by `where` are no part of a fit."""
    return sum(int((~np.isnan(y).all(1)).sum()) for _, y, _ in records)


def read_records(
    recordings: object,
    inputs: str | Sequence[str] | None,
    outputs: str | Sequence[str] | None,
    columns: Mapping[str, str] | None,
    dt: float | None,
) -> tuple[tuple[str, ...], tuple[str, ...], float, Records]:
    """Return (inputs, outputs, dt, [(u, y, starts)]) with names and float64 arrays."""
    pair = lambda r: (
        isinstance(r, tuple) and len(r) in (2, 3) and not isinstance(r[0], tuple) and not is_made(r[0])
    )
    recordings = (
        [recordings] if pair(recordings) or not isinstance(recordings, (list, tuple)) else list(recordings)
    )
    if not recordings:
        raise ValueError("there is no recording: give at least one")
    taken, shown, records, periods = _names(inputs), _names(outputs), [], []
    for number, r in enumerate(recordings):
        where = f"recording {number + 1}"
        if pair(r):
            parts = r
        elif holds_both(r):
            parts = (r,)
        else:
            raise ValueError(
                f"{where} must be a pair (u, y), a DataFrame or a Recording, not {type(r).__name__}"
            )
        taken, shown = named = _named(where, parts, taken, shown)
        try:
            given = Recording.of(Signals(*named, dict(columns or {}), dt), *parts).finite()
        except ValueError as e:
            raise ValueError(f"{where}: {e}") from None
        if given.y.ndim != 2:
            raise ValueError(
                f"{where}: y has shape {given.y.shape}, but time must be its first axis: give several "
                f"recordings as a list"
            )
        records.append((np.asarray(given.u, np.float64), np.asarray(given.y, np.float64), given.starts))
        periods += [] if given.dt is None else [(given.dt, where)]
    (low, first), (high, last) = (min(periods), max(periods)) if periods else ((dt or 1.0, ""),) * 2
    if high - low > TOLERATED_DT * low:
        raise ValueError(
            f"{last} has a sample every {high:g} s, {first} every {low:g} s, and a model has one sampling "
            f"period"
        )
    return *named, periods[0][0] if dt is None and periods else dt or 1.0, records


def _names(given: str | Sequence[str] | None) -> tuple[str, ...] | None:
    return (given,) if isinstance(given, str) else None if given is None else tuple(given)


def _named(
    where: str, parts: tuple, inputs: tuple | None, outputs: tuple | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of inputs and outputs: those not given are a Recording's own, or numbered."""
    tables = [is_table(as_table(x, where)) for x in parts[:2]]
    if (outputs is None and tables[-1]) or (inputs is None and len(parts) > 1 and tables[0]):
        raise ValueError(
            f"{where} is a DataFrame: say with inputs=[...] and outputs=[...] which of its columns are what"
        )
    if len(parts) == 1 and tables[0]:
        return inputs or (), outputs or ()
    if len(parts) == 1:
        inputs, outputs = (
            x or getattr(parts[0], side, None) or None
            for x, side in ((inputs, "inputs"), (outputs, "outputs"))
        )
        parts = parts[0].u, parts[0].y
    width = lambda x: 0 if x is None else np.shape(x)[-1] if np.ndim(x) > 1 else 1
    number = lambda letter, x: tuple(f"{letter}{i + 1}" for i in range(width(x)))
    inputs = number("u", parts[0]) if inputs is None else inputs
    return inputs, number("y", parts[1]) if outputs is None else outputs
