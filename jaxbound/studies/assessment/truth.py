"""The truth about a recording: which of its samples are faulty, and by which signal."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.seams import all_starts

HEALTHY, FAULTY, ASIDE = range(3)
"""Kinds of samples; those aside are healthy again, but a window that ends there still holds a fault."""
HEALTHY_WORDS = ("", "0", "0.0", "healthy", "normal", "none", "no fault", "False", "false")
"""Labels that say that there is no fault."""
UNNAMED = "?"


class Episode(NamedTuple):
    """Faulty samples in a row, start .. stop - 1, and the signal that their labels name, "" for none."""

    start: int
    stop: int
    signal: str


@dataclass(frozen=True, eq=False)
class Truth:
    """Labels of the samples of a recording, (T,) texts: "" healthy, "?" faulty, else a signal's name."""

    labels: np.ndarray

    @property
    def faulty(self) -> np.ndarray:
        """(T,) bool."""
        return np.asarray(self.labels != "")

    def episodes(self) -> list[Episode]:
        """Return the stretches of one label."""
        if not len(self.labels):
            return []
        edges = np.flatnonzero(self.labels[1:] != self.labels[:-1]) + 1
        bounds = [0, *edges.tolist(), len(self.labels)]
        found = []
        for start, stop in zip(bounds[:-1], bounds[1:], strict=True):
            label = str(self.labels[start])
            if label:
                found.append(Episode(start, stop, label.replace(UNNAMED, "")))
        return found

    def kinds(self, starts: ArrayLike, horizon: int | None) -> np.ndarray:
        """Return (T,) HEALTHY, FAULTY or ASIDE.

        Args:
            starts: of the recording, samples that do not follow the one before. horizon: of the windows;
                None: verdicts rest on all samples since a gap.
        """
        count = len(self.labels)
        at = np.arange(count)
        last = np.maximum.accumulate(np.where(self.faulty, at, -1))
        begun = np.zeros(count, int)
        begun[all_starts(starts, count)] = all_starts(starts, count)
        since = np.maximum.accumulate(begun)
        if horizon is not None:
            since = np.maximum(since, at - horizon)
        kinds = np.where((last >= 0) & (last >= since), ASIDE, HEALTHY)
        return np.where(self.faulty, FAULTY, kinds)


def truth_of(labels: ArrayLike | Sequence[str] | None, samples: int) -> Truth:
    """Return the Truth of labels.

    Args:
        labels: (T,) numbers, 0 or NaN for healthy; or texts, those of HEALTHY_WORDS for healthy, anything
            else names the signal. None: all samples are faulty. samples: T.

    Raises:
        ValueError: another number of labels.

    Example:
        >>> truth_of([0, 1, 1, 0], 4).episodes()
        [Episode(start=1, stop=3, signal='')]
        >>> truth_of(["", "T1", "T1"], 3).kinds([], 1).tolist()
        [0, 1, 1]
    """
    if labels is None:
        return Truth(np.full(samples, UNNAMED, object))
    stated = np.asarray(labels)
    if stated.shape != (samples,):
        raise ValueError(
            f"labels need one entry for each of the {samples} samples of a recording: their shape is "
            f"{stated.shape}"
        )
    if stated.dtype.kind in "biuf":
        marked = np.nan_to_num(stated.astype(float)) != 0
        return Truth(np.where(marked, UNNAMED, "").astype(object))
    texts = np.array([str(label).strip() for label in stated], object)
    texts[np.isin(texts, HEALTHY_WORDS)] = ""
    return Truth(texts)
