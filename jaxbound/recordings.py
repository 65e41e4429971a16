"""A recording as it stands in a file: its columns, the time of a sample as a reader would write it, and what its owner should know."""

import math
import re
from dataclasses import dataclass

import numpy as np

from jaxbound.models.recording import missing_column

__all__ = [
    "Recording", "missing_hints", "missing_samples", "missing_sentences", "rounding_hints", "signal_columns", "time_column", "time_label",
]  # fmt: skip

TIMES = (r"(date[ _-]?time|time[ _-]?stamp|time|zeit)\b.*", r"t(\s*[\[(/,].*)?", r"(date|datum)\b.*")


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
        starts: numbers of the samples that do not follow the one before (`models.seams`).
    """

    time: np.ndarray
    stamps: np.ndarray | None
    u: np.ndarray
    y: np.ndarray
    hints: tuple = ()
    written: object = None
    source: str = ""
    starts: tuple = ()

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


def signal_columns(names, model):
    """Return the columns that hold the inputs and outputs of a model, one each.

    Args:
        names: of the columns that there are.

    Raises:
        ValueError: a column is not there, or there twice.
    """
    signals = []
    for signal in model.inputs + model.outputs:
        named = model.column(signal)
        if named not in names and signal not in names:
            raise ValueError(missing_column(named, names, "the recording"))
        signals.append(named if named in names else signal)
    for name in signals:
        _refuse_twice(names, name)
    return signals


def time_column(names, model, signals):
    """Return the name of the time column: the one that the model names, or one that looks like it, or None.

    Raises:
        ValueError: the model names a column that is not there, or the column is there twice.
    """
    named = model.columns.get("time")
    if named is not None and named not in names:
        raise ValueError(missing_column(named, names, "the recording"))
    free = [name for name in names if name not in signals]
    likely = [name for pattern in TIMES for name in free if re.fullmatch(pattern, name.lower())]
    found = named if named is not None else likely[0] if likely else None
    if found is not None:
        _refuse_twice(names, found)
    return found


def _refuse_twice(names, name):
    if (count := list(names).count(name)) > 1:
        raise ValueError(f"{count} columns are called {name!r}: a signal needs exactly one")


def missing_hints(model, u, y):
    """Return a sentence for each signal with missing samples. Args: u (T, m), y (T, p)."""
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
        f"every sample of {', '.join(names)} is a multiple of {step}, more than the resolution that the model states: "
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
