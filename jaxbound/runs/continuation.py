"""How the next recording of a unit goes on where the one before ended: what windows look back on, and what an
observer carries.

Kept are the last samples, as many as a verdict waits for at the start, and of an observer what it carried
before these. They come before the next recording, which is then judged as if it were one with all those
before; verdicts of these samples, which were given already, are MISSING like any warm-up. What was kept
before the last recording stays as well: the same recording again, of a run that was stopped or made twice, is
judged as it was.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxbound.consistency.interface import Judged
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import TOLERATED_STEP
from jaxbound.relations.identity import identity
from jaxbound.relations.sentence import remembers
from jaxbound.sets.floats.status import Status

__all__ = ["Continuation", "alone", "beside", "followed"]

CONTENT, CARRY, WRITTEN = "content", "carry", "written"
ARRAYS = ("u", "y", "starts", "excluded", "time", "stamps")


class Continuation:
    """What is kept of one unit, in a file.

    Args:
        folder: of the files of all units. unit: its name. relations: of a model, or an observer. method: of
            the test. content: the digest of its recording, None where there is none.

    Raises:
        ValueError: what is kept is damaged, or of another model, horizon, version or method.
    """

    def __init__(
        self, folder: str | PathLike, unit: str, relations: Any, method: str, content: str | None
    ) -> None:
        readable = re.sub(r"[^A-Za-z0-9._-]+", "_", unit)[:60]
        name = f"{readable}-{blake2b(unit.encode(), digest_size=4).hexdigest()}.npz"
        self.relations, self.content = relations, content
        self.file = Checkpoint(Path(folder) / name, identity(relations, method=method))
        kept = self.file.load() or {}
        same = content is not None and str(kept.get(CONTENT, "")) == content
        self.past = _under("before" if same else "after", kept)

    def joined(self, recording: Recording) -> tuple[Recording, Any, int]:
        """Return (the Recording behind the last samples of the one before, what an observer carried before
        these, how many they are).

        Where it does not follow these, one sampling period behind the last, it comes back as it is, with a
        hint.
        """
        if not self.past:
            return recording, None, 0
        tail = _read(self.past, recording)
        apart = _apart(tail, recording, self.relations.model.dt)
        if apart:
            self.past = {}
            return replace(recording, hints=(apart, *recording.hints)), None, 0
        carry = None
        if remembers(self.relations):
            leaves = [self.past[f"{CARRY}{i}"] for i in range(len(jax.tree.leaves(self.relations.init())))]
            carry = jax.tree.unflatten(jax.tree.structure(self.relations.init()), leaves)
        starts = np.concatenate([tail.starts, np.asarray(recording.starts) + tail.samples])
        return replace(tail.followed(recording), starts=starts, hints=recording.hints), carry, tail.samples

    def save(self, recording: Recording, carry: Any) -> None:
        """Keep what the next recording needs. recording: as `joined` returned it; carry: as `followed`
        returns it, None of windows.
        """
        tail = recording.cut(max(recording.samples - max(self.relations.horizon, 1), 0), recording.samples)
        now = {name: np.asarray(x) for name in ARRAYS if (x := getattr(tail, name)) is not None} | {
            "origin": np.asarray(tail.origin)
        }
        now |= {f"{CARRY}{i}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(carry))}
        if tail.written is not None:
            now[WRITTEN] = _as_bytes(tail.written)
        self.file.path.parent.mkdir(parents=True, exist_ok=True)
        before = {f"before {name}": x for name, x in self.past.items()}
        self.file.save(
            **before,
            **{f"after {name}": x for name, x in now.items()},
            **{CONTENT: np.array(self.content or "")},
        )


def followed(observer: Any, given: Recording, carry: Any, known: int) -> tuple[Result, Any]:
    """Return (Result of what an observer says behind a carry, what it carries before the last samples that
    `Continuation` keeps).

    Args:
        given: (..., T, .) recordings of one length. carry: of all of them, None: they begin. known: samples
            that were judged before.
    """
    watch = observer.test()
    carry = watch.init() if carry is None else carry
    _, given = observer.recording(given)
    edge = max(given.samples - max(observer.horizon, 1), 0)
    between, first = watch.fold(carry, given.cut(0, edge)) if edge else (carry, None)
    _, last = watch.fold(between, given.cut(edge, given.samples))
    status, margin = (
        (np.concatenate([a, b], -1) for a, b in zip(first[:2], last[:2], strict=True)) if first else last[:2]
    )
    status, margin = np.array(status), np.array(margin)
    status[..., :known], margin[..., :known] = Status.MISSING, np.nan
    about = watch.method, watch.continued(carry), given.u, given.y, given.index, tuple(given.starts.tolist())
    return result_of(observer, Judged(status, margin), *about, aside=given.aside(observer.horizon)), between


def beside(observer: Any, carries: Sequence) -> Any:
    """Return what an observer carries of recordings side by side, from what it does of each alone, after as
    many samples.
    """
    lanes = len(observer.weights)
    apart = lambda x: np.asarray(x).reshape(*x.shape[:-1], lanes, x.shape[-1] // lanes)
    join = lambda *x: np.concatenate(list(map(apart, x)), -1).reshape(*x[0].shape[:-1], -1)
    others = jax.tree.map(lambda *x: np.concatenate(x, -1), *(tuple(x[2:]) for x in carries))
    return type(carries[0])(jax.tree.map(join, *(x[0] for x in carries)), carries[0][1], *others)


def alone(observer: Any, carry: Any, i: int) -> Any:
    """Return what an observer carries of recording i of those side by side: `beside` put the other way."""
    lanes = len(observer.weights)
    one = lambda x: np.asarray(x).reshape(*x.shape[:-1], lanes, x.shape[-1] // lanes)[..., i]
    return type(carry)(
        jax.tree.map(one, carry[0]), carry[1], *jax.tree.map(lambda x: x[..., i : i + 1], tuple(carry[2:]))
    )


def _under(kind, kept):
    """Return what is kept under a name."""
    return {name.removeprefix(f"{kind} "): x for name, x in kept.items() if name.startswith(f"{kind} ")}


def _read(past, like):
    """Return the last samples of the recording before, in seconds of the one that comes behind it."""
    arrays: dict[str, Any] = {name: past.get(name) for name in ARRAYS}
    written = _from_bytes(past[WRITTEN]) if WRITTEN in past else None
    arrays["time"] = arrays["time"] + (float(past["origin"]) - like.origin)  # NaN where nothing tells it
    index = None if like.index is None else arrays["time"] if arrays["stamps"] is None else arrays["stamps"]
    return replace(like, **arrays, written=written, index=index, hints=())


def _apart(tail, recording, dt):
    """Return why a recording does not follow the samples before it, as a sentence; "" where it does."""
    begin = "the recording begins anew, as if there were none before, which"
    if tail.y.dtype != recording.y.dtype:
        return f"{begin} was recorded in {tail.y.dtype}, not {recording.y.dtype}"
    if str(getattr(tail.written, "type", "")) != str(getattr(recording.written, "type", "")):
        return f"{begin} has its time written otherwise"
    step = recording.time[0] - tail.time[-1]
    if np.isnan(step):
        lacks = "no times" if recording.written is None else "times without a date"
        return f"{begin} has {lacks}: nobody knows whether it follows"
    if abs(step - dt) <= TOLERATED_STEP * dt:
        return ""
    return (
        f"{begin} ended {abs(step):.6g} s {'after' if step < 0 else 'before'} its first sample, not dt = "
        f"{dt:g} s before"
    )


def _as_bytes(column):
    """Return a pyarrow array as bytes."""
    import pyarrow as pa

    sink, batch = pa.BufferOutputStream(), pa.record_batch([column], ["time"])
    with pa.ipc.new_stream(sink, batch.schema) as stream:
        stream.write_batch(batch)
    return np.frombuffer(sink.getvalue(), np.uint8)


def _from_bytes(data):
    import pyarrow as pa

    with pa.ipc.open_stream(data.tobytes()) as stream:
        return stream.read_all().column(0).combine_chunks()
