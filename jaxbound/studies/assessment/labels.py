"""Labels of recordings in files: a column of the recording itself, or a CSV file of times and labels.

They are read by the door of recordings: the label of a column is an output that is computed by a condition,
so gaps, conditions and means over intervals are those of the recording.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxbound.recordings.csvtext import sniff
from jaxbound.recordings.read import read
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import RECORDING
from jaxbound.recordings.signals import SignalModel, Signals
from jaxbound.studies.assessment.truth import HEALTHY_WORDS, UNNAMED

LABELS = ("label", "labels", "fault", "anomaly", "faulty")
"""Names of the column of a file of labels, the likeliest first; else the one beside the time."""
SAMPLE = "sample"
FAULTY = "faulty"


def column_labels(path: object, model: SignalModel, column: str) -> np.ndarray:
    """Return the labels (T,) in a column of a recording: texts, see `Truth`.

    Args:
        path: of the recording. model: by which it is read. column: of numbers, 0 for healthy samples; or of
            texts, the name of a signal or a word for healthy ones. A mean over samples of which one is faulty
            is faulty.

    Raises:
        OSError, ValueError: no such file or column.
    """
    read_by = ("time", "where", "every", RECORDING)
    settings = {name: model.columns[name] for name in read_by if name in model.columns}
    return _read(path, column, settings, model.dt, _signals(model))[1]


def file_labels(path: Path, model: SignalModel, recording: Recording) -> np.ndarray:
    """Return the labels (T,) of a recording from a file: texts, see `Truth`.

    Args:
        path: a CSV file with a column of times, or of numbers of samples that is called "sample", and one of
            labels. A label holds from its row to the next one. model, recording: whose samples they are of.

    Raises:
        OSError, ValueError: no such file; no column of labels; times that are not those of the recording.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file of labels {path}")
    names = sniff(path).names
    settings = {}
    if SAMPLE in names:
        settings["time"] = SAMPLE
    label = _label_column(path, names)
    rows, labels = _read(path, label, settings, None, _signals(model), regular=False)
    at = np.searchsorted(*_axes(path, rows, recording, SAMPLE in names), "right") - 1
    stated = np.where(at >= 0, labels[np.maximum(at, 0)], "")
    return stated.astype(object)


def _signals(model: SignalModel) -> tuple[str, ...]:
    return (*model.outputs, *model.inputs)


def _label_column(path: Path, names: Sequence[str]) -> str:
    """Return the name of the column of labels."""
    for name in LABELS:
        if name in names:
            return name
    if len(names) == 2:
        return names[1]
    raise ValueError(
        f"{path} has no column that is called label: it has {', '.join(names)}, and a file of labels needs a "
        f"time, or {SAMPLE}, and a label"
    )


def _axes(
    path: Path, rows: Recording, recording: Recording, by_number: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return (times of the rows of labels, those of the samples), which can be compared."""
    if by_number:
        return np.asarray(rows.time), np.arange(recording.samples)
    if (rows.stamps is None) != (recording.stamps is None):
        raise ValueError(
            f"{path}: its times and those of {recording.source} are not of one kind, dates and numbers: give "
            f"labels by the times of the recording, or by a column {SAMPLE!r}"
        )
    if rows.stamps is not None and recording.stamps is not None:
        return rows.stamps, recording.stamps
    return np.asarray(rows.time), np.asarray(recording.time)


def _read(
    path: object,
    column: str,
    settings: Mapping[str, str],
    dt: float | None,
    signals: Sequence[str],
    regular: bool = True,
) -> tuple[Recording, np.ndarray]:
    """Return (a recording of labels, the labels of its rows as texts)."""
    name = f"`{column}`"
    numbers = {FAULTY: f"= {name} != 0"}
    try:
        rows = read(path, Signals((), (FAULTY,), {**settings, **numbers}, dt, regular))
        return rows, _texts(rows, ())
    except ValueError as e:
        if "number" not in str(e):
            raise
    healthy = [f"{name} != {word!r}" for word in HEALTHY_WORDS]
    texts = {FAULTY: f"= {' and '.join(healthy)}"}
    known = [signal for signal in signals if "'" not in signal and "`" not in signal]
    for number, signal in enumerate(known):
        texts[f"{FAULTY} {number}"] = f"= {name} == '{signal}'"
    rows = read(path, Signals((), tuple(texts), {**settings, **texts}, dt, regular))
    return rows, _texts(rows, known)


def _texts(rows: Recording, signals: Sequence[str]) -> np.ndarray:
    """Return labels (T,) of rows of (faulty, is this signal, ...)."""
    marked = np.nan_to_num(np.asarray(rows.y)) > 0
    labels = np.where(marked[:, 0], UNNAMED, "").astype(object)
    for number, signal in enumerate(signals):
        labels[marked[:, 1 + number]] = signal
    return labels
