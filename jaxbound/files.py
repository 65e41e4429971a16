"""Recordings from files and results into files: CSV.

A million rows are parsed column by column by pyarrow, only the columns that the model names; when that fails, a second, slow pass finds
the row and says what stands there. Rows are counted as a spreadsheet does: the header is row 1.
"""

import csv
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxbound.columns import from_arrow, to_arrow, valid, words, write_columns
from jaxbound.models.recording import missing_column
from jaxbound.sets.status import Status
from jaxbound.timestamps import check_steps, parse_stamps, read_numbers

__all__ = ["Recording", "read_recording", "write_alarms", "write_verdicts"]

WORDS = ("NaN", "nan", "NAN", "null", "NULL", "Null", "NA", "N/A", "n/a", "#N/A", "None", "none")
MISSING_CELLS = ("", " ", *WORDS, *(f" {x}" for x in WORDS))
ENOUGH = 1 << 18  # bytes of a file that show how it is written
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|infinity)|nan", re.IGNORECASE)
TIMES = (r"(date[ _-]?time|time[ _-]?stamp|time|zeit)\b.*", r"t(\s*[\[(/,].*)?", r"(date|datum)\b.*")
SIGNATURES = {
    b"PAR1": "a Parquet file",
    b"\x1f\x8b": "a gzip file",
    b"PK\x03\x04": "a zip file or an Excel workbook",
    b"\x89HDF": "an HDF5 file",
    b"ARROW1": "an Arrow file",
}


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
    """

    time: np.ndarray
    stamps: np.ndarray | None
    u: np.ndarray
    y: np.ndarray
    hints: tuple = ()
    written: object = None
    source: str = ""

    def label(self, k):
        """Return the time of sample k as a reader of the file would write it."""
        written = self.written[k].as_py() if self.written is not None else None
        if isinstance(written, str):
            return written.strip()
        if self.stamps is not None:
            return str(self.stamps[k].astype("datetime64[ms]")).replace("T", " ").removesuffix(".000")
        step = float(self.time[-1] - self.time[0]) / max(len(self.time) - 1, 1) or 1.0
        text = f"{self.time[k]:.{max(0, 2 - math.floor(math.log10(step)))}f}"  # to a hundredth of a step
        return f"{text.rstrip('0').rstrip('.') if '.' in text else text} s"

    @property
    def axis(self):
        """The time for a plot: dates where there are, else seconds."""
        return self.time if self.stamps is None else self.stamps


@dataclass(frozen=True)
class _Layout:
    path: Path
    names: list
    delimiter: str
    decimal: str
    encoding: str
    skip: int  # lines before the data
    first: list  # cells of the first data row
    hints: list = field(default_factory=list)

    def row(self, k):
        """Return how the user finds sample k."""
        return f"row {k + self.skip + 1}"


def read_recording(path, model, progress=None):
    """Read the signals of a model from a CSV file.

    Delimiter `,`, `;` or tab; decimal comma with the latter two. Blank, NaN, null and NA cells are missing samples. Columns that the model
    does not name are ignored. Time in seconds, as time stamps or as an epoch; without a time column the samples are dt apart.

    Args:
        path: of the file. model: a LinearSystem. progress: called with the share of the work done.

    Returns:
        A Recording.

    Raises:
        OSError: no such file. NotImplementedError: a folder, Parquet, standard input.
        ValueError: anything that is not a regular recording of this model: what, and in which row.
    """
    path = Path(path)
    report = progress or (lambda share: None)
    _refuse(path)
    try:
        return _read(path, model, report)
    except ValueError as e:
        raise ValueError(f"{path}: {e}") from None


def _read(path, model, report):
    layout = _sniff(path)
    signals = [_column(layout, model, s) for s in model.inputs + model.outputs]
    time_name = _time_column(layout, model, signals)
    wanted = list(dict.fromkeys(signals + ([time_name] if time_name is not None else [])))
    for name in wanted:
        if layout.names.count(name) > 1:
            raise ValueError(f"{layout.names.count(name)} columns are called {name!r}: a signal needs exactly one")
    report(0.05)
    index = {name: layout.names.index(name) for name in wanted}
    text_time = time_name is not None and not _is_number(layout.first[index[time_name]], layout.decimal)
    table = _parse(layout, index, time_name if text_time else None)
    report(0.7)
    count = len(table[wanted[0]])
    if count < 2:
        raise ValueError("the file has one row of data: a recording has at least two")
    hints = list(layout.hints)
    written = table[time_name] if time_name is not None else None
    if written is not None and written.null_count:
        first = layout.row(int(np.argmin(valid(written))))
        raise ValueError(f"{first} has no time: every row needs one, {written.null_count} do not have it")
    arrays = {s: _values(layout, s, table[s]) for s in dict.fromkeys(signals)}
    if written is None:
        time, stamps = np.arange(count) * model.dt, None
        hints.append(f"the file has no time column: the rows are taken to be dt = {model.dt:g} s apart")
    elif text_time:
        time, stamps, hint = parse_stamps(written, model.dt, layout.row)
        hints += [hint] if hint else []
    else:
        time, stamps, hint = read_numbers(_values(layout, time_name, written), model.dt)
        hints += [hint] if hint else []
    stack = lambda names: np.stack([arrays[s] for s in names], 1) if names else np.zeros((count, 0))
    u, y = stack(signals[: model.m]), stack(signals[model.m :])
    recording = Recording(time, stamps, u, y, (), written, path.name)
    check_steps(time, model.dt, recording.label, layout.row)
    report(0.9)
    hints += _missing_hints(model, u, y) + _rounding_hints(model, y)
    report(1.0)
    return Recording(time, stamps, u, y, tuple(hints), written, path.name)


def _refuse(path):
    if str(path) == "-":
        raise NotImplementedError("reading from standard input is not implemented yet: give the name of a CSV file")
    if path.is_dir():
        raise NotImplementedError(f"{path} is a folder: folders of recordings are not implemented yet, give one CSV file")
    if not path.exists():
        raise FileNotFoundError(f"there is no data file {path}")
    if path.suffix.lower() in (".parquet", ".pq"):
        raise NotImplementedError(f"{path}: Parquet is not implemented yet, give a CSV file")


def _sniff(path):
    """Look at the first lines of the file and find out how it is written."""
    with open(path, "rb") as f:
        head = f.read(ENOUGH)
    if not head.strip(b"\xef\xbb\xbf \t\r\n"):
        raise ValueError("the file is empty")
    for magic, kind in SIGNATURES.items():
        if head.startswith(magic):
            if magic == b"PAR1":
                raise ValueError("this is a Parquet file, which is not implemented yet: give a CSV file")
            raise ValueError(f"this is {kind}, not text: give a CSV file")
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise ValueError("the file is in UTF-16: save it as UTF-8")
    if b"\0" in head:
        raise ValueError("this is a binary file, or text in UTF-16: give a CSV file in UTF-8")
    hints, encoding = [], "utf-8"
    try:
        text = head.removeprefix(b"\xef\xbb\xbf")
        text = (text if len(head) < ENOUGH else text[: text.rfind(b"\n") + 1]).decode()
    except UnicodeDecodeError:
        if sum(b < 9 for b in head) or sum(b > 127 for b in head) > len(head) // 4:
            raise ValueError("this is not a text file: give a CSV file in UTF-8") from None
        encoding, text = "cp1252", head.decode("cp1252", "replace")
        hints.append("the file is not in UTF-8: it is read as Windows-1252, which matters for column names only")
    lines = re.split(r"\r\n|\n|\r", text)
    skip = next(i for i, line in enumerate(lines) if line.strip())
    delimiter = None
    if (m := re.fullmatch(r"sep=(.)\s*", lines[skip])) and len(lines) > skip + 1:  # as Excel writes it
        delimiter, skip = m[1], skip + 1
    header = lines[skip]
    delimiter = delimiter or next((d for d in (";", "\t", ",") if d in header), ",")
    names = [name.strip() for name in _cells(header, delimiter)]
    data = [_cells(line, delimiter) for line in lines[skip + 1 : skip + 200] if line.strip()]
    decimal = "," if delimiter != "," and any(re.fullmatch(r"\s*[-+]?\d*,\d+([eE].*)?\s*", c) for row in data for c in row) else "."
    if all(_is_number(name, decimal) for name in names):
        raise ValueError(f"the first row must hold the names of the columns: it holds numbers ({', '.join(names[:3])})")
    if not data:
        raise ValueError("the file has a header but no row of data")
    first = data[0] + [""] * (len(names) - len(data[0]))
    return _Layout(path, names, delimiter, decimal, encoding, skip + 1, first, hints)


def _cells(line, delimiter):
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])


def _is_number(cell, decimal):
    return NUMBER.fullmatch(cell.strip().replace(decimal, ".")) is not None


def _column(layout, model, signal):
    """Return the name of the column that holds a signal."""
    named = model.column(signal)
    if named in layout.names:
        return named
    if signal in layout.names:
        return signal
    raise ValueError(missing_column(named, layout.names, "the recording"))


def _time_column(layout, model, signals):
    """Return the name of the time column: the one that the model names, or one that looks like it, or None."""
    if "time" in model.columns:
        if model.columns["time"] not in layout.names:
            raise ValueError(missing_column(model.columns["time"], layout.names, "the recording"))
        return model.columns["time"]
    free = [name for name in layout.names if name not in signals]
    for pattern in TIMES:
        for name in free:
            if re.fullmatch(pattern, name.lower()):
                return name
    unnamed = layout.names[0] == "" and layout.first[0] and not _is_number(layout.first[0], layout.decimal)
    return "" if unnamed else None


def _parse(layout, index, text):
    """Return {column: pyarrow array} of the wanted columns; `text` is the one that is not a number."""
    import pyarrow as pa
    import pyarrow.csv as pc

    key = {name: f"f{i}" for name, i in index.items()}
    read = pc.ReadOptions(column_names=[f"f{i}" for i in range(len(layout.names))], skip_rows=layout.skip, encoding=layout.encoding)
    failure = None
    for decimal in (layout.decimal, "," if layout.decimal == "." else ".") if layout.delimiter != "," else (".",):
        convert = pc.ConvertOptions(
            include_columns=list(key.values()), decimal_point=decimal, null_values=list(MISSING_CELLS), strings_can_be_null=True,
            column_types={k: pa.string() if name == text else pa.float64() for name, k in key.items()})  # fmt: skip
        try:
            table = pc.read_csv(layout.path, read, pc.ParseOptions(delimiter=layout.delimiter, newlines_in_values=False), convert)
            return {name: table[k].combine_chunks() for name, k in key.items()}
        except pa.ArrowInvalid as e:
            failure = failure or e
    raise ValueError(_bad_row(layout, index, text) or str(failure).splitlines()[0])


def _bad_row(layout, index, text):
    """Return a sentence on the first row that cannot be read: the slow second pass."""
    with open(layout.path, encoding="utf-8-sig" if layout.encoding == "utf-8" else layout.encoding, errors="replace", newline="") as f:
        reader = csv.reader(f, delimiter=layout.delimiter)
        for row in reader:
            if reader.line_num <= layout.skip or not row:
                continue
            if len(row) != len(layout.names):
                return f"row {reader.line_num} has {len(row)} cells, the header has {len(layout.names)} columns"
            for name, i in index.items():
                cell = row[i]
                if name != text and cell not in MISSING_CELLS and not _is_number(cell, layout.decimal):
                    return f"row {reader.line_num} of column {name!r} holds {cell.strip()[:60]!r}, which is not a number"
    return None


def _values(layout, name, column):
    """Return a column as floats, NaN where a sample is missing; refuse infinity and a column without any number."""
    x = from_arrow(column)
    if np.isinf(x).any():
        k = int(np.argmax(np.isinf(x)))
        raise ValueError(f"{layout.row(k)} of column {name!r} is infinite or too large for a number (leave a missing sample blank)")
    if np.isnan(x).all():
        raise ValueError(f"column {name!r} holds no number at all: all {len(x)} cells are blank or NaN")
    return x


def _missing_hints(model, u, y):
    out = []
    for names, x in ((model.inputs, u), (model.outputs, y)):
        for i, name in enumerate(names):
            if missing := int(np.isnan(x[:, i]).sum()):
                out.append(f"{missing} of {len(x)} samples of {name} are missing: the windows around them are judged without them")
    return out


def _rounding_hints(model, y):
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


def write_verdicts(path, result, recording=None):
    """Write one row a sample: time (as the recording has it), status, margin (blank where there is none), suspect.

    Args:
        path: of the CSV file to write. result: of one recording. recording: from `read_recording`; None: sample numbers.
    """
    written = to_arrow(np.arange(len(result.status))) if recording is None else recording.written
    columns = {
        "time": to_arrow(recording.time) if written is None else written,
        "status": words([x.name for x in Status], result.status),
        "margin": to_arrow(result.margin),
        "suspect": to_arrow(result.suspect),
    }
    write_columns(path, columns)


def write_alarms(path, alarms, recording, dt):
    """Write one row an alarm: start and end (time of the recording), duration in s, FAULT windows, depth and when it was reached.

    `factor` is how many times wider the bounds would have to be; an alarm of a single sample lasts dt.
    """
    starts, ends, worst = (np.array([getattr(a, f) for a in alarms], np.int64) for f in ("start", "end", "worst"))
    written = recording.written if recording.written is not None else to_arrow(recording.time)
    depth = np.array([a.depth for a in alarms], np.float64)
    columns = {
        "start": written.take(to_arrow(starts)),
        "end": written.take(to_arrow(ends)),
        "duration_s": to_arrow(np.round(recording.time[ends] - recording.time[starts] + dt, 9)),
        "first_sample": to_arrow(starts),
        "last_sample": to_arrow(ends),
        "windows": to_arrow(np.array([a.windows for a in alarms], np.int64)),
        "depth": to_arrow(depth),
        "factor": to_arrow(1 - depth),
        "worst": written.take(to_arrow(worst)),
    }
    write_columns(path, columns)
