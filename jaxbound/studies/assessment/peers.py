"""Detectors that people come from, trained on healthy recordings: PCA, an isolation forest, and a threshold
and a CUSUM on one-step errors.

Each gives one number a window: how many times as high its threshold would have to be for it to stay quiet.
The thresholds are those of textbooks, none is chosen by a fault.

    PCA T2, Q      principal components of windows that hold 90 % of the variance; limits of 99 %
    forest         scikit-learn's isolation forest on the same windows
    3 sigma        errors of a least-squares ARX of the same signals, in standard deviations of the training
    CUSUM          the same errors summed, two-sided: slack .5, limit 5 standard deviations
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.studies.assessment.detectors import Detector, Needs
from jaxbound.studies.identification import regression

VARIANCE, LEVEL = 0.9, 0.99
SIGMAS = 3.0
AS_RECORDED = regression.Scales(np.zeros(1), np.ones(1), np.zeros(1), np.ones(1))
SLACK, LIMIT = 0.5, 5.0
"""Of a CUSUM, in standard deviations: Montgomery, Introduction to statistical quality control, 9.1."""


class Samples(NamedTuple):
    """A recording as arrays: u (T, m), y (T, p), starts (numbers of samples behind gaps)."""

    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray

    @classmethod
    def of(cls, recording: Recording) -> "Samples":
        """Return those of a Recording."""
        return cls(np.asarray(recording.u), np.asarray(recording.y), np.asarray(recording.starts, int))

    def windows(self, horizon: int) -> np.ndarray:
        """Return (T - s, (s + 1)(m + p)): all signals of each window in a row."""
        x = np.concatenate([self.u, self.y], 1)
        count = max(len(x) - horizon, 0)
        lagged = [x[j : j + count] for j in range(horizon + 1)]
        return np.asarray(np.stack(lagged, 1).reshape(count, -1))

    def usable(self, horizon: int) -> np.ndarray:
        """Return the first samples of the windows across no gap with every sample."""
        u, y = (np.where(np.isfinite(x), x, np.nan) for x in (self.u, self.y))
        return regression.complete_windows(u, y, self.starts, horizon)


def _training_windows(training: Sequence[Samples], horizon: int) -> np.ndarray:
    rows = [samples.windows(horizon)[samples.usable(horizon)] for samples in training]
    return np.concatenate(rows)


class OnWindows(Detector):
    """A detector of windows. A subclass states `scores` of rows of numbers; 1 is its threshold."""

    horizon: int

    def scores(self, rows: np.ndarray) -> np.ndarray:
        """Return (N,) for the rows (N, .) of windows."""
        raise NotImplementedError

    def flags(self, recording: Recording) -> Needs:
        """Judge a recording."""
        return Needs(self.needs(Samples.of(recording)))

    def needs(self, samples: Samples) -> np.ndarray:
        """Return (T,), NaN where no window ends."""
        out = np.full(len(samples.y), np.nan)
        known = samples.usable(self.horizon)
        if len(known):
            out[self.horizon + known] = self.scores(samples.windows(self.horizon)[known])
        return out


class Forest(OnWindows):
    """An isolation forest.

    Raises:
        ValueError: scikit-learn is not installed.
    """

    def __init__(
        self, training: Sequence[Samples], horizon: int, contamination: float | str = "auto", seed: int = 0
    ) -> None:
        try:
            from sklearn.ensemble import IsolationForest
        except ImportError:
            raise ValueError(
                "an isolation forest needs scikit-learn: pip install 'jaxbound[bench]', or leave other "
                "detectors out"
            ) from None
        self.horizon, self.name = horizon, f"forest, {contamination}"
        self.note = f"isolation forest of scikit-learn, contamination {contamination}"
        seen = _training_windows(training, horizon)
        self._forest = IsolationForest(contamination=contamination, random_state=seed).fit(seen)

    def scores(self, rows: np.ndarray) -> np.ndarray:
        """Return the anomaly score relative to the forest's own limit."""
        return np.asarray(self._forest.score_samples(rows) / self._forest.offset_)


class Principal(OnWindows):
    """Principal components: T2 within them and Q beside them, each relative to its limit; the larger counts.

    Source: Jackson, Mudholkar 1979, limit of Q; Hotelling's T2 by the F distribution.
    """

    def __init__(self, training: Sequence[Samples], horizon: int) -> None:
        from scipy.stats import f, norm

        self.horizon, self.name = horizon, "PCA T2, Q"
        rows = _training_windows(training, horizon)
        count = len(rows)
        self._centre, spread = rows.mean(0), rows.std(0)
        self._scale = np.where(spread > 0, spread, 1.0)
        _, singular, directions = np.linalg.svd((rows - self._centre) / self._scale, full_matrices=False)
        variances = singular**2 / max(count - 1, 1)
        share = np.cumsum(variances) / variances.sum()
        kept = min(int(np.searchsorted(share, VARIANCE)) + 1, count - 2)
        self.note = f"{kept} principal components of windows, limits of {100 * LEVEL:g} %"
        self._directions, self._variances = directions[:kept], variances[:kept]
        ratio = kept * (count**2 - 1) / (count * (count - kept))
        self._most_t2 = ratio * f.ppf(LEVEL, kept, count - kept)
        first, second, third = (np.sum(variances[kept:] ** power) for power in (1, 2, 3))
        self._most_q = np.inf  # nothing lies beside the components
        if first > 0:
            h = 1 - 2 * first * third / (3 * second**2)
            z = norm.ppf(LEVEL)
            inner = z * np.sqrt(2 * second * h**2) / first + 1 + second * h * (h - 1) / first**2
            self._most_q = first * inner ** (1 / h)

    def scores(self, rows: np.ndarray) -> np.ndarray:
        """Return the larger of T2 and Q relative to their limits."""
        x = (rows - self._centre) / self._scale
        inside = x @ self._directions.T
        t2 = np.sum(inside**2 / self._variances, 1)
        q = np.sum(x**2, 1) - np.sum(inside**2, 1)
        return np.asarray(np.maximum(t2 / self._most_t2, q / self._most_q))


class OneStep:
    """One-step errors of a least-squares ARX model with a constant, and their size in training."""

    def __init__(self, training: Sequence[Samples], order: int, direct: bool) -> None:
        self.order, self.direct = order, direct
        windows = regression.windows_of(list(training), AS_RECORDED, order)
        self._theta = regression.least_squares(windows, order, direct)
        errors = regression.step_errors(self._theta, windows, order, direct)
        self.sigma, self.largest = errors.std(0), abs(errors).max(0)

    def errors(self, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (..., T, p) in the units of y, NaN where samples are missing. u (T, m), y (..., T, p)."""
        batch = y.reshape(-1, *y.shape[-2:])
        out = np.full(batch.shape, np.nan)
        first = np.arange(max(y.shape[-2] - self.order, 0))
        at = first[:, None] + np.arange(self.order + 1)
        for number, one in enumerate(batch):
            windows = regression.CompleteWindows(u[at], one[at], first)
            out[number, self.order :] = regression.step_errors(self._theta, windows, self.order, self.direct)
        return out.reshape(y.shape)

    def relative(self, samples: Samples) -> np.ndarray:
        """Return (T, p) in standard deviations, NaN where samples are missing or lie across a gap."""
        errors = self.errors(samples.u, samples.y) / np.where(self.sigma > 0, self.sigma, 1.0)
        known = np.zeros(len(samples.y), bool)
        known[self.order + samples.usable(self.order)] = True
        return np.where(known[:, None], errors, np.nan)


class Threshold(Detector):
    """A fixed threshold on one-step errors."""

    name = "3 sigma"

    def __init__(self, errors: OneStep) -> None:
        self._errors = errors
        self.note = f"one-step errors of an ARX of order {errors.order} outside 3 standard deviations"

    def flags(self, recording: Recording) -> Needs:
        """Judge a recording."""
        relative = abs(self._errors.relative(Samples.of(recording)))
        return Needs(relative.max(1) / SIGMAS)


class Cusum(Detector):
    """Two-sided cumulative sums of one-step errors, begun anew behind gaps and missing samples."""

    name = "CUSUM"

    def __init__(self, errors: OneStep) -> None:
        self._errors = errors
        self.note = (
            f"two-sided sums of one-step errors of an ARX of order {errors.order}, slack {SLACK:g} and limit "
            f"{LIMIT:g} standard deviations"
        )

    def flags(self, recording: Recording) -> Needs:
        """Judge a recording."""
        relative = self._errors.relative(Samples.of(recording))
        out = np.full(len(relative), np.nan)
        up = down = np.zeros(relative.shape[1])
        for k, error in enumerate(relative):
            if np.isnan(error).any():
                up = down = np.zeros(relative.shape[1])
                continue
            up = np.maximum(0, up + error - SLACK)
            down = np.maximum(0, down - error - SLACK)
            out[k] = max(up.max(), down.max()) / LIMIT
        return Needs(out)


def peers_of(
    model: LinearSystem, training: Sequence[Recording], horizon: int
) -> list[Principal | Forest | Threshold | Cusum]:
    """Return the detectors, trained on recordings.

    Args:
        model: whose order is theirs too. training: healthy recordings. horizon: of the windows.

    Raises:
        ValueError: no window of the training; scikit-learn is not installed.
    """
    samples = list(map(Samples.of, training))
    usable = sum(len(one.usable(horizon)) for one in samples)
    if usable < 3:
        raise ValueError(
            f"the recordings to train other detectors on hold {usable} windows of {horizon + 1} samples: "
            f"give longer ones"
        )
    order = max(1, -(-model.n // model.p))
    direct = any(any(row) for row in model.D)
    errors = OneStep(samples, order, direct)
    return [Principal(samples, horizon), Forest(samples, horizon), Threshold(errors), Cusum(errors)]
