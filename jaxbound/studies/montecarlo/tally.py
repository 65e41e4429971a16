"""Counts of scenarios, in whole numbers: the sums do not depend on the order or on how the work was
cut up.
"""

import numpy as np

from jaxbound.studies.montecarlo.proportions import proportion_interval, rate_interval


class TrialTally:
    """The counts of one Trial, per size.

    Fields, (S,) each: scenarios; detected: those with a FAULT window that the fault touches; hits, windows:
    FAULT windows and all windows wholly inside the fault, with the sums of their squares and products over
    scenarios; false, clean: FAULT windows and all windows without a faulty sample; alarmed: scenarios with
    one such. delays (S, T + 1): of the detected, by samples from the onset.
    """

    scenarios: np.ndarray
    detected: np.ndarray
    hits: np.ndarray
    windows: np.ndarray
    squares: np.ndarray
    crossed: np.ndarray
    squared: np.ndarray
    false: np.ndarray
    clean: np.ndarray
    alarmed: np.ndarray
    delays: np.ndarray

    def __init__(self, sizes: int, samples: int) -> None:
        """Begin at zero."""
        for name in TrialTally.__annotations__:
            setattr(self, name, np.zeros(sizes, np.int64))
        self.delays = np.zeros((sizes, samples + 1), np.int64)

    def add(
        self,
        which: np.ndarray,
        hits: np.ndarray,
        false: np.ndarray,
        delay: np.ndarray,
        windows: np.ndarray,
        clean: np.ndarray,
    ) -> None:
        """Take scenarios: the number of the size of each, and what was found. All (N,)."""
        sizes = len(self.scenarios)
        h, w = hits.astype(np.int64), windows.astype(np.int64)
        detected = delay >= 0
        parts = {
            "scenarios": None,
            "detected": detected,
            "hits": h,
            "windows": w,
            "squares": h * h,
            "crossed": h * w,
            "squared": w * w,
            "false": false,
            "clean": clean,
            "alarmed": false > 0,
        }
        for name, part in parts.items():
            total = np.bincount(which, part, sizes)  # its floats are exact below 2^53
            setattr(self, name, getattr(self, name) + total.astype(np.int64))
        np.add.at(self.delays, (which[detected], delay[detected]), 1)

    def share(self, confidence: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (share, lo, hi) of scenarios detected, (S,) each."""
        with np.errstate(invalid="ignore"):
            return self.detected / self.scenarios, *proportion_interval(
                self.detected, self.scenarios, confidence
            )

    def rate(self, confidence: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (rate, lo, hi) of FAULT windows among those wholly inside the fault, (S,) each."""
        return rate_interval(
            self.hits, self.windows, self.squares, self.crossed, self.squared, self.scenarios, confidence
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Return {name: array}."""
        return dict(vars(self))
