"""The result of tuning: bounds, where they come from, and what they promise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.relations.bounds import Bounds
from jaxbound.studies.tuning.confidence import Risk
from jaxbound.studies.tuning.parametrization import Tunable
from jaxbound.text.objects import readable

History: TypeAlias = list[np.ndarray]
"""(step, width, share of faulty windows outside, values ..), (3 + b,), of each look at all windows."""


@readable
@dataclass(frozen=True, eq=False)
class TuneResult:
    """Bounds that were tuned, how, and what is known of them.

    Fields:
        bounds: {name: array}, smallest times factor times safety, rounded up to four digits: those of .model.
        smallest: {name: array}, at which every healthy window is proved to be consistent. For use with
            `with_bounds`.
        scale: their size, the weighted mean of smallest / starting bounds, rounded down: along this direction
            no smaller bounds explain the healthy data, for a little below it `detect` finds a FAULT. With one
            bound, or no steps, the smallest factor on all of them.
        factor, safety: the factors on the smallest bounds: that of the model, .left_out, or as the recordings
            ask for, each left out in turn; and on top.
        left_out: how many times as wide as the smallest bounds of the others those for each recording have to
            be; nan where nobody can say; () of a single one, or where the model states its factor.
        start: {name: array}, where they came from.
        margin: (T,) of the healthy samples laid end to end, at .bounds, by the proved test; NaN where no
            window ends.
        counts: {status name: healthy windows} at .bounds; FAULT is 0. faulty_counts: the same of the faulty
            windows, or None.
        statement, risk: what is known about healthy data not seen, in sentences and as a Risk.
        history: {"step": (k,), "width": (k,) of the smallest bounds in this direction relative to the start,
            "outside": (k,) share of faulty windows outside (NaN without any), "values": (k, b)}; names: (b,),
            of the bounds that moved.
        steps: made. stopped: True if interrupted: this is the best until then.
        model: the LinearSystem with .bounds, for `save_model`. relations: those of its horizon, or its
            observer, for `detect`.
        notes: sentences on what did not move.
    """

    bounds: Bounds
    smallest: dict[str, np.ndarray]
    scale: float
    factor: float
    safety: float
    left_out: tuple[float, ...]
    start: Bounds
    margin: np.ndarray
    counts: dict[str, int]
    faulty_counts: dict[str, int] | None
    risk: Risk
    history: dict[str, np.ndarray]
    names: tuple[str, ...]
    steps: int
    stopped: bool
    model: LinearSystem
    relations: Tunable
    notes: tuple[str, ...]

    @property
    def statement(self) -> str:
        """Sentences about healthy data that were not seen."""
        return self.risk.text

    @property
    def caught(self) -> float | None:
        """The share of faulty windows that are FAULT at .bounds, or None."""
        return caught_of(self.faulty_counts)


def caught_of(counts: Mapping[str, int] | None) -> float | None:
    """Return the share of faulty windows with a verdict that are FAULT; None without faulty windows.

    Args:
        counts: {status name: number of windows}, or None.
    """
    if counts is None:
        return None
    return counts["FAULT"] / max(sum(counts.values()) - counts["MISSING"], 1)


def history_columns(history: History, count: int) -> dict[str, np.ndarray]:
    """Return a history of `count` bounds as arrays, see TuneResult."""
    rows = np.array(history).reshape(-1, 3 + count)
    step, width, outside = rows[:, :3].T
    return {"step": step.astype(int), "width": width, "outside": outside, "values": rows[:, 3:]}
