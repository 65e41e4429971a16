"""A recording as it stands in a file: its columns, the time of a sample as a reader would write it, and what its owner should know."""

import math
from dataclasses import dataclass

import numpy as np

from jaxbound.recordings.naming import listed
from jaxbound.recordings.seams import aside

__all__ = ["Recording", "missing_hints", "missing_samples", "missing_sentences", "refuse_short", "rounding_hints", "time_label"]


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording as it stands in a file.

    Fields:
        time: (T,) seconds: as in the file, or since the first sample where the file has time stamps.
        stamps: (T,) datetime64[ns], or None where time is in seconds.
        u, y: (T, m), (T, p) float64 in the order of the model's signals; NaN where a sample is missing.
        hints: sentences that the user should read.
        written: the time column as the file has it, a pyarrow array; None if the file has none.
        source: the name of the file.
        starts: numbers of the samples that do not follow the one before (`recordings.seams`).
        dt: sampling period in s, of the model, or found where there is none yet; None: not looked for.
        excluded: (T,) bool, samples that the model's `where` leaves out: NaN in u and y, with a start at either end of each stretch; or
            None where the model has no such condition.
    """

    time: np.ndarray
    stamps: np.ndarray | None
    u: np.ndarray
    y: np.ndarray
    hints: tuple = ()
    written: object = None
    source: str = ""
    starts: tuple = ()
    excluded: np.ndarray | None = None
    dt: float | None = None

    def aside(self, horizon):
        """Return how many windows of horizon + 1 samples have one that is left out."""
        return aside(self.excluded, horizon)

    def label(self, k):
        """Return the time of sample k as a reader of the file would write it."""
        written = self.written[k].as_py() if self.written is not None else None
        if isinstance(written, str):
            return written.strip()
        steps = np.abs(np.diff(self.time[:1000]))  # gaps and a clock that goes back are exceptions
        step = float(np.median(steps)) if len(steps) and np.median(steps) else 1.0
        return time_label(self.time[k], None if self.stamps is None else self.stamps[k], step)

    @property
    def axis(self):
        """The time for a plot: dates where there are, else seconds."""
        return self.time if self.stamps is None else self.stamps


def time_label(seconds, stamp, step):
    """Return the time of a sample as text: of its time stamp if it has one, else of its seconds to a hundredth of a step.

    Example:
        >>> time_label(0.30000000000000004, None, 0.01), time_label(0.0, np.datetime64("2017-09-12T08:00:00.500"), 1.0)
        ('0.3 s', '2017-09-12 08:00:00.500')
    """
    if stamp is not None:
        return str(stamp.astype("datetime64[ms]")).replace("T", " ").removesuffix(".000")
    text = f"{seconds:.{max(0, 2 - math.floor(math.log10(step)))}f}"
    return f"{text.rstrip('0').rstrip('.') if '.' in text else text} s"


def refuse_short(source, samples, horizon):
    """Raise ValueError if a recording has no whole window; horizon None: not known yet. To be asked before relations are worked out."""
    if horizon is not None and samples <= horizon:
        needs = f"{horizon + 1}" if horizon < 10**15 else "more than 1e+15"
        raise ValueError(f"{source}: the recording has {samples} samples, one window needs {needs}")


def missing_hints(model, u, y, excluded=None):
    """Return a sentence for each signal with missing samples. Args: u (T, m), y (T, p); excluded (T,) bool: samples that do not count."""
    if excluded is not None:
        u, y = u[~excluded], y[~excluded]
    return missing_sentences(missing_samples(model, u, y), len(y))


def missing_samples(model, u, y):
    """Return {signal: number of its missing samples}."""
    return {name: int(np.isnan(x[:, i]).sum()) for names, x in ((model.inputs, u), (model.outputs, y)) for i, name in enumerate(names)}


def missing_sentences(missing, samples):
    """Return a sentence for each signal of which samples are missing."""
    return [
        f"{count} of {samples} samples of {name} are missing: the windows around them are judged without them"
        for name, count in missing.items()
        if count
    ]


def rounding_hints(model, y):
    """Return sentences on outputs that the recorder seems to round more than the model states."""
    found = {}
    for i, name in enumerate(model.outputs):
        step = _step(y[:, i])
        if step and float(model.resolution[i]) < step / 2 * (1 - 1e-9):
            found.setdefault(f"{step:.6g}", []).append(name)
    return [
        f"every sample of {listed(names, str)} is a multiple of {step}, more than the resolution that the model states: "
        f"if the recorder rounds, add `resolution = {float(step) / 2:.6g}` there in the model file"
        for step, names in found.items()
    ]


def _step(x):
    """Return the largest step that all values are multiples of (counted from one of them), or 0: a recorder that rounds."""
    x = x[~np.isnan(x)]
    values = np.unique(x[:20_000])
    if len(values) < 3:
        return 0.0
    fits = lambda v, step, slack: (abs(v / step - np.rint(v / step)) <= slack).all()
    top, found = float(abs(x).max()), 0.0
    for places in range(10):
        if top * 10.0**places > 1e12:
            break
        if fits(values, 10.0**-places, 2e-15 * top * 10.0**places + 1e-9) and fits(x, 10.0**-places, 2e-15 * top * 10.0**places + 1e-9):
            found = 10.0**-places
            break
    gaps = np.diff(values)
    coarse = float(gaps.min())
    if coarse > max(1.5 * found, 1e-6 * top) and fits(gaps, coarse, 0.01):
        coarse = float((values[-1] - values[0]) / np.rint(gaps / coarse).sum())
        if fits(x - values[0], coarse, 0.02):
            return coarse
    return found
