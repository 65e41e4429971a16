"""Verdicts of recordings larger than memory: Parquet in, Parquet out, chunk by chunk, and on after an interruption.

Chunks overlap by the horizon, so every window is tested once, by the same compiled kernel, whatever the size of a chunk. Verdicts are
written in parts of a fixed number of samples, each completely or not at all, beside a note of what is being tested. A part says nothing of
those before it, and the parts are all the state there is: the same call makes those that are not there.
"""

import json
import os
import re
import time
from contextlib import suppress
from dataclasses import asdict
from functools import reduce
from pathlib import Path

import jax
import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.result import suspected
from jaxbound.models.fingerprint import fingerprint
from jaxbound.recordings.columns import categories, to_arrow
from jaxbound.recordings.keeping import UNFINISHED, whole
from jaxbound.recordings.parquet import PARTIAL, VERDICTS
from jaxbound.recordings.seams import Clock, around, tick
from jaxbound.recordings.stillness import Run, Runs, follow, joined
from jaxbound.relations.identity import differences, identity
from jaxbound.sets.floats.status import Status

__all__ = ["CHUNK", "PARTIAL", "VERDICTS", "forget_parts", "kept", "part_files", "publish", "read_runs", "write_parts"]

CHUNK = 1_000_000  # samples in memory at once
LEAST = 2**16  # and at least so many: a call of the kernel takes them anyway
PART = 1_000_000  # samples in a file of verdicts
NOTE, RUNS = "_run.json", "runs"
OURS = re.compile(rf"part-\d{{5,}}\.(parquet|\d+)|{NOTE}(\.\d+)?|\.(part-\d{{5,}}\.parquet|{NOTE}){UNFINISHED}")
STREAMED = ("joint", "box")


def write_parts(relations, source, out, method="joint", chunk=CHUNK, progress=None):
    """Test a ParquetSource and write its verdicts into parts in the folder `verdicts.partial` of `out`, those that are not there yet.

    Args:
        As `digest.detect_dataset`; source: from `open_parquet`.

    Returns:
        (folder of the parts, {"read", "transfer", "compute", "write"}: seconds). On a CPU, transfer is the copying of columns into the
        arrays that the kernel reads.
    """
    if method not in STREAMED:
        raise ValueError(f"Parquet is tested by method {' or '.join(STREAMED)}, not {method!r}, whose budget is one for all windows")
    s, report = relations.horizon, progress or (lambda share: None)
    if source.samples <= s:
        raise ValueError(f"{source.path}: the recording has {source.samples} samples, one window needs {s + 1}")
    folder = _begun(relations, source, Path(out), method)
    seconds = dict.fromkeys(("read", "transfer", "compute", "write"), 0.0)
    share = lambda done: report(done / source.samples)
    try:
        for parts in _missing(folder, range(-(-source.samples // PART))):
            _test(relations, source, folder, method, max(chunk, LEAST, s + 1), share, _Lap(seconds), parts)
        source.unchanged()
        report(1.0)
    except ValueError:  # data that must be changed first: what was found in them is of no use then
        forget_parts(folder)
        raise
    except BaseException:
        if not part_files(folder):
            forget_parts(folder)
        raise
    return folder, seconds


def _missing(folder, numbers):
    """Return the ranges of numbers of parts that are not there."""
    left = np.array([i for i in numbers if not (folder / _name(i)).exists()], int)
    stretches = np.split(left, np.flatnonzero(np.diff(left) > 1) + 1) if len(left) else []
    return [range(int(x[0]), int(x[-1]) + 1) for x in stretches]


def _name(number):
    return f"part-{number:05d}.parquet"


def _test(relations, source, folder, method, size, report, lap, parts):
    s, model, done, end = relations.horizon, relations.model, parts.start * PART, min(parts.stop * PART, source.samples)
    first = max(done - s, 0)
    tail = [np.zeros((0, n), source.dtype) for n in (model.m, model.p)]
    condition, left_out = source.plan.where is not None, np.zeros(0, bool)
    clock, starts = Clock(model.dt, samples=first), np.zeros(0, np.int64)
    pending = _Pending(folder, done, model.m + model.p + condition)
    report(done)
    for start, table in source.tables(first, end, size):
        lap("read")
        piece = source.chunk(start, table)
        tail = [np.concatenate(pair) for pair in zip(tail, (piece.u, piece.y), strict=True)]
        u, y = jax.block_until_ready(jax.device_put(tuple(tail)))
        lap("transfer")
        clock, seams = tick(clock, piece.time)
        stop = start + len(table)
        origin = stop - len(y)
        starts = np.concatenate([starts[starts > origin], seams[seams > origin]])
        left_out = np.concatenate([left_out, piece.excluded])[-len(y) :] if condition else left_out
        found = detect(relations, u, y, method=method, starts=np.concatenate([starts - origin, around(left_out)]))
        lap("compute")
        fresh = slice(done - stop, None)
        written = to_arrow(piece.time) if piece.written is None else piece.written
        part_of_it = [np.where(piece.excluded, np.nan, 1)[:, None]] if condition else []
        signals = np.concatenate([piece.u, piece.y, *part_of_it], 1)
        pending.add(written[fresh], found.status[fresh], found.margin[fresh], signals[fresh], stop == end)
        lap("write")
        tail, done = [x[len(x) - min(s, len(x)) :] for x in tail], stop
        report(done)


def part_files(folder):
    """Return the complete parts of a folder of verdicts in order."""
    return sorted(Path(folder).glob("part-*.parquet"))


def kept(folder, samples):
    """Return how many of the samples have their verdict in complete parts."""
    return min(PART * len(part_files(folder)), samples)


def read_runs(parts):
    """Return the Runs (`stillness`) of all parts: of the inputs, the outputs and, if the model has `where`, of 1 where it holds and
    NaN elsewhere.
    """
    import pyarrow.parquet as pq

    def runs(counts, longest, last, first, **rest):
        one = lambda run: Run(*run) if run else None
        return Runs(counts=np.array(counts), longest=tuple(map(one, longest)), last=one(last), first=one(first), **rest)

    notes = (json.loads(pq.read_schema(part).metadata[RUNS.encode()]) for part in parts)
    return [reduce(joined, signal) for signal in zip(*([runs(**found) for found in note] for note in notes), strict=True)]


def publish(folder):
    """Turn the complete parts in an `outputs.OutputFolder` into its verdicts, in the place of older ones."""
    folder.put({VERDICTS: folder.path / PARTIAL})
    (folder.path / VERDICTS / NOTE).unlink()


def forget_parts(parts):
    """Remove what `write_parts` wrote into a folder, and the folder if nothing else is in it."""
    for file in _ours(parts):
        file.unlink(missing_ok=True)
    with suppress(OSError):
        parts.rmdir()


def _ours(parts):
    """Return the files in a folder of parts that are called as `write_parts` calls them."""
    return [parts / name for name in (os.listdir(parts) if parts.is_dir() else ()) if OURS.fullmatch(name)]


class _Lap:
    """Adds the time since the last call to a name."""

    def __init__(self, seconds):
        self.seconds, self.last = seconds, time.perf_counter()

    def __call__(self, name):
        now = time.perf_counter()
        self.seconds[name], self.last = self.seconds[name] + now - self.last, now


class _Pending:
    """Verdicts on their way into parts of PART samples."""

    def __init__(self, folder, done, signals):
        self.folder, self.done, self.signals, self.held = folder, done, signals, []

    def add(self, written, status, margin, signals, last):
        """Take the next verdicts and their samples; write the parts that they complete, and what is left if they are the last."""
        import pyarrow as pa

        self.held.append((written, status, margin, signals))
        while (rows := sum(len(x[1]) for x in self.held)) >= PART or (last and rows):
            written, *rest = zip(*self.held, strict=True)
            whole = (pa.concat_arrays(written), *map(np.concatenate, rest))
            self._write(*(x[:PART] for x in whole))
            self.held = [tuple(x[PART:] for x in whole)]

    def _write(self, written, status, margin, signals):
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {
            "time": written,
            "status": categories([x.name for x in Status], status),
            "margin": to_arrow(margin),
            "suspect": to_arrow(suspected(status, margin)),
        }
        runs = [follow(Runs(self.done), np.ascontiguousarray(x)) for x in signals.T]
        note = json.dumps([asdict(of) for of in runs], default=np.ndarray.tolist)
        table = pa.table(columns).replace_schema_metadata({RUNS: note})
        with whole(self.folder / _name(self.done // PART)) as f:
            pq.write_table(table, f, use_dictionary=["status"], write_page_checksum=True)
        self.done += len(status)


def _begun(relations, source, out, method):
    """Return the folder for the parts, new or with parts of the same run; refuse those of another."""
    now, folder = _note(relations, source, method), out / PARTIAL
    try:
        before = json.loads((folder / NOTE).read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        before = None
    if before is not None and (changed := differences(before, now)):
        raise ValueError(
            f"{folder} holds an unfinished run with another {changed}: choose another folder, or delete that one to begin anew"
        )
    _clear(folder, begun=before is not None)
    if before is None:
        folder.mkdir(parents=True, exist_ok=True)
        with whole(folder / NOTE) as f:
            f.write((json.dumps(now, indent=1) + "\n").encode())
    return folder


def _clear(folder, begun):
    """Remove what a killed run was writing; refuse a folder with anything else, in one that was not begun parts too."""
    there, ours = sorted(os.listdir(folder)) if folder.is_dir() else [], {p.name for p in _ours(folder)}
    strangers = [name for name in there if name not in ours or (name.endswith(".parquet") and not begun)]
    if strangers or (folder.exists() and not folder.is_dir()):
        what = f"holds {strangers[0]}, which was not written by jaxbound" if strangers else "is a file"
        raise ValueError(f"{folder} {what}: move it, or choose another folder")
    for file in _ours(folder):
        if file.suffix != ".parquet" and file.name != NOTE:
            file.unlink()


def _note(relations, source, method):
    """Return what the verdicts depend on, in words and digests that fit into JSON."""
    files = [(source.name(f), f.stat().st_size) for f in source.files]
    data = f"{source.path.resolve()}, {len(files)} files, {fingerprint(files)}"
    return identity(relations, method=method, data=data, **{"content of the data": source.content})
