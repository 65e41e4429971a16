"""Continuations: the next recording of a unit goes on where the one before ended.

Kept are the last samples, as many as a window has before its last one, and of an observer, or a monitor of
several tests, what it carried before these. They come before the next recording, which is then judged as if
it were one with all those before; verdicts of these samples, which were given already, are MISSING like any
warm-up. What was kept before the last recording stays as well: the same recording again, of a run that was
stopped or made twice, is judged as it was.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import blake2b
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.consistency.interface import Judged, Observer, Relations, Verdicts, window_count, with_margins
from jaxbound.diagnosis.result import Result, found_by
from jaxbound.estimation.observation import State
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.recordings.columns import Arrow
from jaxbound.recordings.means import Unfinished
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.seams import TOLERATED_STEP, around
from jaxbound.recordings.selection import counted_from_start
from jaxbound.recordings.signals import SignalModel
from jaxbound.recordings.source import Source
from jaxbound.relations.identity import identity
from jaxbound.runs.ask import Ask
from jaxbound.sets.floats.status import Status

Arrays = Mapping[str, np.ndarray]
CONTENT, CARRY, WRITTEN, UNIT = "content", "carry", "written", "unit"
REST = "rest"  # before the names of samples that are in no mean yet
BYTES = 16  # of the digest in the name of a file: no two units share one
FORMER_BYTES = 4  # of an earlier jaxbound: two of 20 000 units did
ARRAYS = ("u", "y", "starts", "excluded", "time", "stamps")


class Joined(NamedTuple):
    """A recording behind the last samples of the one before.

    Fields: recording; carry: of an observer before these samples, None: it begins; known: how many of them
    there are, which were judged before.
    """

    recording: Recording
    carry: Any = None
    known: int = 0


class Continuation:
    """The end of the last recording of one unit, kept in a file for the next.

    Args:
        folder: of the files of all units. unit: its name. relations: of a model, or an observer. method: of
            the test. content: the digest of its recording, None where there is none.

    Raises:
        ValueError: what is kept is damaged, or of another unit, model, horizon, version or method.
    """

    def __init__(
        self, folder: str | PathLike[str], unit: str, relations: Relations, method: str, content: str | None
    ) -> None:
        self.relations, self.content, self.unit = relations, content, unit
        self.file = Checkpoint(Path(folder) / _file_of(unit, BYTES), identity(relations, method=method))
        _refuse_former(Path(folder) / _file_of(unit, FORMER_BYTES), self.file.path)
        kept = self.file.load() or {}
        if kept and str(kept.get(UNIT)) != unit:
            raise ValueError(
                f"{self.file.path} is of unit {str(kept.get(UNIT))!r}, not of {unit!r}: choose another "
                f"folder, or delete it to begin anew"
            )
        is_again = content is not None and str(kept.get(CONTENT, "")) == content
        self.past = _with_prefix("before" if is_again else "after", kept)
        self.rest: Unfinished | None = None

    def read(self, source: Source) -> Recording:
        """Return the recording of a source, of means with the interval that the one before began.

        Where no interval is over yet, its samples are kept for the next recording, too.
        """
        source = source.behind(_unfinished_in(self.past))
        try:
            return source.read()
        except ValueError:
            if source.rest is not None:
                self._save(self.past | _arrays_of(source.rest))
            raise
        finally:
            self.rest = source.rest

    def joined(self, recording: Recording) -> Joined:
        """Return a recording behind the last samples of the one before.

        Where it does not follow these, one sampling period behind the last, it comes back as it is, with a
        hint.
        """
        if "y" not in self.past:
            return Joined(recording)
        tail = _tail_before(self.past, recording)
        apart = _why_apart(tail, recording, self.relations.model)
        if apart:
            self.past = {}
            return Joined(replace(recording, hints=(apart, *recording.hints)))
        if not self.relations.remembers and not self.relations.horizon:
            return Joined(recording)  # windows of one sample look back at none
        whole = tail.followed(recording)
        starts = np.concatenate([tail.starts, np.asarray(recording.starts) + tail.samples])
        starts = np.union1d(starts, around(whole.excluded))
        return Joined(replace(whole, starts=starts, hints=recording.hints), self._carried(), tail.samples)

    def _carried(self) -> object:
        """Return the carry of an observer before the samples that are kept; None of windows."""
        if self.relations.observer is None:
            return None
        empty = self.relations.observer.init()
        leaves = [self.past[f"{CARRY}{i}"] for i in range(len(jax.tree.leaves(empty)))]
        return jax.tree.unflatten(jax.tree.structure(empty), leaves)

    def save(self, recording: Recording, carry: object) -> None:
        """Keep the samples and the carry that the next recording needs.

        Args:
            recording: as `joined` returned it. carry: as `followed` returns it, None of windows.
        """
        tail = recording.cut(_edge(self.relations, recording), recording.samples)
        now = {"origin": np.asarray(tail.origin)}
        for name in ARRAYS:
            array = getattr(tail, name)
            if array is not None:
                now[name] = np.asarray(array)
        for i, leaf in enumerate(jax.tree.leaves(carry)):
            now[f"{CARRY}{i}"] = np.asarray(leaf)
        if tail.written is not None:
            now[WRITTEN] = _arrow_bytes(tail.written)
        if self.rest is not None:
            now |= _arrays_of(self.rest)
        self._save(now)

    def keep(self, joined: Joined) -> None:
        """Keep a recording that is too short for a window, for the next."""
        carry = joined.carry
        if carry is None and self.relations.observer is not None:
            carry = self.relations.observer.init()
        self.save(joined.recording, carry)

    def _save(self, now: Arrays) -> None:
        """Keep arrays for the next recording, and those for this one again."""
        stored = {CONTENT: np.array(self.content or ""), UNIT: np.array(self.unit)}
        stored |= {f"before {name}": x for name, x in self.past.items()}
        stored |= {f"after {name}": x for name, x in now.items()}
        self.file.path.parent.mkdir(parents=True, exist_ok=True)
        self.file.save(**stored)


def _file_of(unit: str, size: int) -> str:
    """Return the name of the file of a unit, with a digest of so many bytes."""
    readable = re.sub(r"[^A-Za-z0-9._-]+", "_", unit)[:60]
    return f"{readable}-{blake2b(unit.encode(), digest_size=size).hexdigest()}.npz"


def _refuse_former(former: Path, now: Path) -> None:
    """Raise ValueError for the file of an earlier jaxbound, which does not say whose it is."""
    if former.exists() and not now.exists():
        raise ValueError(
            f"{former} was written by an earlier jaxbound and does not name its unit, so another's may be in "
            f"it: choose another folder, or delete it to begin anew"
        )


def followed(observer: Observer[Any], given: Joined, ask: Ask) -> tuple[Result, Any]:
    """Follow recordings behind a carry, by an observer.

    Args:
        given: (..., T, .) recordings of one length, side by side, and the carry of all of them.

    Returns:
        (Result of all of them, the carry before the last samples that `Continuation` keeps).
    """
    _, recording = observer.recording(given.recording)
    windows = window_count(recording.y.shape[:-1], observer.horizon)
    watch = with_margins(observer.test(dtype=recording.y.dtype), ask.margins, windows)
    assert watch.remembers, "an observer is its own test"
    carry = given.carry
    if carry is None:
        carry = watch.init()
    edge = _edge(observer, recording)  # the samples behind it are kept
    between, pieces = carry, []
    if edge:
        between, first = watch.followed(carry, recording.cut(0, edge))
        pieces.append(first)
    _, last = watch.followed(between, recording.cut(edge, recording.samples))
    pieces.append(last)
    judged = _judged(pieces, given.known)
    fresh = recording.cut(max(given.known - observer.horizon, 0), recording.samples)
    result = found_by(watch.continued(carry), recording, judged, ask.outside, observer)
    return replace(result, aside=fresh.aside(observer.horizon), known=given.known), between


def _edge(relations: Relations, recording: Recording) -> int:
    """Return the number of the first of the last samples that are kept: as many as the longest window has
    before its last one, one at least.
    """
    windows = [test.horizon for test in relations.parts.values()]
    return max(recording.samples - max(relations.horizon, 1, *windows), 0)


def _judged(pieces: Sequence[Verdicts], known: int) -> Judged:
    """Return the verdicts of an observer on pieces as those of one, without any on the first `known`
    samples.
    """
    status = np.concatenate([piece.status for piece in pieces], -1)
    margin = np.concatenate([piece.margin for piece in pieces], -1)
    status[..., :known], margin[..., :known] = Status.MISSING, np.nan
    judged = Judged(status, margin)
    if isinstance(pieces[0], Judged):
        columns = jax.tree.map(lambda *x: np.concatenate(x, -1), *map(attrgetter("columns"), pieces))
        judged = judged._replace(columns=columns)
    if getattr(pieces[0], "by", None) is None:
        return judged
    names = "by", "statuses", "test_margins"
    by, statuses, margins = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in names)
    by[:known], statuses[:known], margins[:known] = -1, Status.MISSING, np.nan
    return judged._replace(by=by, statuses=statuses, test_margins=margins)


def joined_carries(carries: Sequence[State]) -> State:
    """Return the carry of recordings side by side, from that of each alone after as many samples."""

    def together(*leaves: np.ndarray) -> np.ndarray:
        return np.concatenate(leaves, -1) if np.ndim(leaves[0]) else leaves[0]

    carry: State = jax.tree.map(together, *carries)
    return carry


def _with_prefix(kind: str, kept: Arrays) -> dict[str, np.ndarray]:
    """Return {name: array} of the arrays that are kept with a word before their name."""
    prefix = f"{kind} "
    return {name.removeprefix(prefix): x for name, x in kept.items() if name.startswith(prefix)}


def _arrays_of(rest: Unfinished) -> dict[str, np.ndarray]:
    """Return the samples that a recording left over, and how they are counted, as arrays."""
    return {f"{REST} {name}": x for name, x in rest.arrays().items()}


def _unfinished_in(past: Arrays) -> Unfinished | None:
    """Return the samples that `_arrays_of` made arrays of; None: none are kept."""
    rest = _with_prefix(REST, past)
    return Unfinished.of(rest) if rest else None


def _tail_before(past: Arrays, like: Recording) -> Recording:
    """Return the last samples of the recording before, in seconds of the one that comes behind it."""
    arrays: dict[str, Any] = {name: past.get(name) for name in ARRAYS}
    arrays["time"] = arrays["time"] + (float(past["origin"]) - like.origin)  # NaN where nothing tells it
    written = index = None
    if WRITTEN in past:
        written = _from_bytes(past[WRITTEN])
    if like.index is not None:
        index = arrays["time"] if arrays["stamps"] is None else arrays["stamps"]
    return replace(like, **arrays, written=written, index=index, hints=())


def _why_apart(tail: Recording, recording: Recording, model: SignalModel) -> str:
    """Return why a recording does not follow the samples before it, as a sentence; "" where it does."""
    begin, dt = "the recording begins anew, as if there were none before", model.dt or 1.0
    if tail.y.dtype != recording.y.dtype:
        return f"{begin}, which was recorded in {tail.y.dtype}, not {recording.y.dtype}"
    if str(getattr(tail.written, "type", "")) != str(getattr(recording.written, "type", "")):
        return f"{begin}, which has its time written otherwise"
    step = recording.time[0] - tail.time[-1]
    if np.isnan(step):
        lacks = "no times" if recording.written is None else "times without a date"
        return f"{begin}, which has {lacks}: nobody knows whether it follows"
    if abs(step - dt) > TOLERATED_STEP * dt:
        side = "after" if step < 0 else "before"
        return f"{begin}, which ended {abs(step):.6g} s {side} its first sample, not dt = {dt:g} s before"
    counted = counted_from_start(model)
    if counted:
        return f"{begin}: {counted!r} counts from the first sample of each recording"
    return ""


def _arrow_bytes(column: Arrow) -> np.ndarray:
    """Return a pyarrow array as bytes."""
    import pyarrow as pa

    sink, batch = pa.BufferOutputStream(), pa.record_batch([column], ["time"])
    with pa.ipc.new_stream(sink, batch.schema) as stream:
        stream.write_batch(batch)
    return np.frombuffer(sink.getvalue(), np.uint8)


def _from_bytes(data: np.ndarray) -> Arrow:
    import pyarrow as pa

    with pa.ipc.open_stream(data.tobytes()) as stream:
        return stream.read_all().column(0).combine_chunks()
