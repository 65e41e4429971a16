"""Verdicts of recordings larger than memory: Parquet in, Parquet out, chunk by chunk, and on after an interruption.

Chunks overlap by the horizon, so every window is tested once, by the same compiled kernel, whatever the size of a chunk. Verdicts are
written in parts of a fixed number of samples, each completely or not at all, beside a note of what is being tested. The parts are all the
state there is: the same call goes on behind the last of them.
"""

import hashlib
import json
import os
import shutil
import time
from dataclasses import asdict
from pathlib import Path

import jax
import numpy as np

from jaxbound.columns import categories, to_arrow
from jaxbound.diagnosis.consistency import detect
from jaxbound.modelfile import model_text
from jaxbound.models.seams import Clock, tick
from jaxbound.models.stillness import Run, Runs, follow
from jaxbound.parquet import PARTIAL, VERDICTS
from jaxbound.sets.status import Status

__all__ = ["CHUNK", "PARTIAL", "VERDICTS", "kept", "part_files", "publish", "read_runs", "write_parts"]

CHUNK = 1_000_000  # samples in memory at once
LEAST = 2**16  # and at least so many: a call of the kernel takes them anyway
PART = 1_000_000  # samples in a file of verdicts
NOTE, RUNS = "_run.json", "runs"
STREAMED = ("joint", "box")


def write_parts(relations, source, out, method="joint", chunk=CHUNK, progress=None):
    """Test a ParquetSource and write its verdicts into parts in the folder `verdicts.partial` of `out`, going on where these end.

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
    folder = _resumed(relations, source, Path(out), method)
    seconds = dict.fromkeys(("read", "transfer", "compute", "write"), 0.0)
    try:
        _test(relations, source, folder, method, max(chunk, LEAST, s + 1), report, _Lap(seconds))
    except ValueError:  # data that must be changed first: what was found in them is of no use then
        shutil.rmtree(folder)
        raise
    finally:
        if not part_files(folder):
            shutil.rmtree(folder, ignore_errors=True)
    return folder, seconds


def _test(relations, source, folder, method, size, report, lap):
    s, samples, model = relations.horizon, source.samples, relations.model
    done = kept(folder, samples)
    first = max(done - s, 0)
    tail = [np.zeros((0, n), source.dtype) for n in (model.m, model.p)]
    clock, starts = Clock(model.dt, samples=first), np.zeros(0, np.int64)
    pending = _Pending(folder, done, model.inputs + model.outputs)
    report(done / samples)
    for start, table in source.tables(first, samples, size) if done < samples else ():
        lap("read")
        piece = source.chunk(start, table)
        tail = [np.concatenate(pair) for pair in zip(tail, (piece.u, piece.y), strict=True)]
        u, y = jax.block_until_ready(jax.device_put(tuple(tail)))
        lap("transfer")
        clock, seams = tick(clock, piece.time)
        stop = start + len(table)
        origin = stop - len(y)
        starts = np.concatenate([starts[starts > origin], seams[seams > origin]])
        found = detect(relations, u, y, method=method, starts=starts - origin)
        lap("compute")
        fresh = slice(done - stop, None)
        written = to_arrow(piece.time) if piece.written is None else piece.written
        pending.add(written[fresh], found.status[fresh], found.margin[fresh], np.concatenate([piece.u, piece.y], 1)[fresh], stop == samples)
        lap("write")
        tail, done = [x[len(x) - min(s, len(x)) :] for x in tail], stop
        report(done / samples)


def part_files(folder):
    """Return the complete parts of a folder of verdicts in order."""
    parts = sorted(Path(folder).glob("part-*.parquet"))
    expected = [f"part-{i:05d}.parquet" for i in range(len(parts))]
    return [p for p, name in zip(parts, expected, strict=True) if p.name == name]


def kept(folder, samples):
    """Return how many of the samples have their verdict in complete parts."""
    return min(PART * len(part_files(folder)), samples)


def read_runs(part):
    """Return the Runs of the inputs and outputs (`models.stillness`) up to the end of a part."""
    import pyarrow.parquet as pq

    def runs(counts, longest, last, **rest):
        return Runs(counts=np.array(counts), longest=tuple(Run(*r) for r in longest), last=Run(*last) if last else None, **rest)

    return [runs(**found) for found in json.loads(pq.read_schema(part).metadata[RUNS.encode()])]


def publish(out):
    """Turn the complete parts in `out` into its verdicts, in the place of older ones."""
    out = Path(out)
    (out / PARTIAL / NOTE).unlink()
    if (out / VERDICTS).is_dir():
        shutil.rmtree(out / VERDICTS)
    os.replace(out / PARTIAL, out / VERDICTS)


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
        before = read_runs(part_files(folder)[-1]) if done else [Runs()] * len(signals)
        self.folder, self.done, self.runs, self.held = folder, done, before, []

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

        with np.errstate(invalid="ignore"):
            suspect = (status == Status.FAULT) | (margin < 0)
        columns = {
            "time": written,
            "status": categories([x.name for x in Status], status),
            "margin": to_arrow(margin),
            "suspect": to_arrow(suspect),
        }
        self.runs = [follow(runs, np.ascontiguousarray(x)) for runs, x in zip(self.runs, signals.T, strict=True)]
        note = json.dumps([asdict(runs) for runs in self.runs], default=np.ndarray.tolist)
        table = pa.table(columns).replace_schema_metadata({RUNS: note})
        name = self.folder / f"part-{self.done // PART:05d}.parquet"
        fresh = name.with_suffix(f".{os.getpid()}")
        with open(fresh, "wb") as f:
            pq.write_table(table, f, use_dictionary=["status"])
            f.flush()
            os.fsync(f.fileno())
        os.replace(fresh, name)
        self.done += len(status)


def _resumed(relations, source, out, method):
    """Return the folder for the parts, new or with the parts of the same run; refuse those of another."""
    now = _note(relations, source, method)
    folder = out / PARTIAL
    try:
        before = json.loads((folder / NOTE).read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        before = None
    if before is None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        fresh = folder / f"{NOTE}.{os.getpid()}"
        fresh.write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
        os.replace(fresh, folder / NOTE)
    else:
        changed = [what for what in now if before.get(what) != now[what]]
        if changed:
            raise ValueError(
                f"{folder} holds an unfinished run with another {' and '.join(changed)}: choose another folder, "
                "or delete that one to begin anew"
            )
        for stray in folder.glob("part-*"):  # what a killed run was writing
            if stray.suffix != ".parquet":
                stray.unlink()
    return folder


def _note(relations, source, method):
    """Return what the verdicts depend on, in words and digests that fit into JSON."""
    from jaxbound import __version__

    digest = lambda x: hashlib.sha256(repr(x).encode()).hexdigest()
    files = [(source.name(f), f.stat().st_size, f.stat().st_mtime_ns) for f in source.files]
    bounds = {name: np.asarray(b).tolist() for name, b in relations.bounds.items()}
    return {
        "version of jaxbound": __version__,
        "model": digest((model_text(relations.model), relations.form, bounds)),
        "horizon": relations.horizon,
        "method": method,
        "data": f"{source.path.resolve()}, {len(files)} files, {digest(files)}",
    }
