"""What a detection returns."""

from dataclasses import dataclass

import numpy as np

from jaxbound.diagnosis import certificate
from jaxbound.diagnosis.alarms import group_alarms
from jaxbound.relations.parity import ParityRelation
from jaxbound.sets.status import Status

__all__ = ["Result"]


@dataclass(frozen=True, eq=False)
class Result:
    """Verdicts of all windows; entry k belongs to the window that ends at sample k.

    Fields:
        status: (..., T) int8, see `Status`. FAULT is a proof; so is CONSISTENT for method "joint" (or a single relation).
        margin: (..., T), 1 - t with t the common factor on all half-widths at which the window just becomes consistent; t = 3: the
            bounds would have to be three times as wide. For method "box" of the worst residual alone. NaN where MISSING.
        method, relations: as given to `detect`.
        u, y: the recording as it was tested.
        index: the index of the DataFrame that y came from, or None.
    """

    status: np.ndarray
    margin: np.ndarray
    method: str
    relations: ParityRelation
    u: np.ndarray
    y: np.ndarray
    index: object = None

    @property
    def suspect(self):
        """(..., T) bool: outside the set as computed, proved or not. Every FAULT is suspect."""
        with np.errstate(invalid="ignore"):
            return (self.status == Status.FAULT) | (self.margin < 0)

    @property
    def counts(self):
        """{status name: number of windows}."""
        found = np.bincount(self.status.ravel(), minlength=4)
        return {s.name: int(found[s]) for s in Status}

    def alarms(self, k=1, n=1, hold=0, clear=1):
        """Group FAULT windows into alarms; the verdicts themselves stay as they are.

        An alarm starts where k of the last n windows are FAULT, stays on for `hold` samples after that ceases, and ends once `clear`
        samples in a row are quiet.

        Args:
            k, n: 1 <= k <= n. hold: >= 0. clear: >= 1. All in samples.

        Returns:
            A list of Alarm in order of time (of recording and time for a batch).

        Raises:
            ValueError: numbers outside these ranges.
        """
        return group_alarms(self, k, n, hold, clear)

    def explain(self, at):
        """Return the Certificate of the window that ends at index `at` (an int, or a tuple for a batch), in exact rationals.

        For FAULT the violated relation with its coefficients, bounds and excess; for CONSISTENT a state that explains the window.

        Raises:
            ValueError: the window is MISSING.
        """
        return certificate.explain(self, at)

    def to_pandas(self):
        """Return a DataFrame with the columns status (names), margin and suspect, one row a sample.

        Raises:
            ValueError: a batch of recordings; index the result's arrays instead.
        """
        import pandas as pd

        if self.status.ndim != 1:
            raise ValueError(f"to_pandas is for one recording, this result has the shape {self.status.shape}: build a frame for each")
        names = pd.Categorical.from_codes(self.status, [s.name for s in Status])
        return pd.DataFrame({"status": names, "margin": self.margin, "suspect": self.suspect}, index=self.index)
