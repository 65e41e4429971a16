"""Recordings as values: u, y, the seams between samples, the samples that do not count. Every verb builds one
first, by one door.

Tables in (`table`), checked arrays out. What a table says beyond its numbers is found here, so that no verb
can forget it: the names of its columns, gaps in the time of its rows, samples that the model's `where` leaves
out, samples that are masked or null.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.recordings.arrays import float_arrays, is_made, refuse_infinite, without_words
from jaxbound.recordings.clockintervals import seconds_of
from jaxbound.recordings.columns import moments, to_arrow
from jaxbound.recordings.expressions import find_column
from jaxbound.recordings.factors import known
from jaxbound.recordings.means import (
    FIRST,
    Grid,
    Rows,
    Unfinished,
    every_of,
    instants,
    is_period,
    means_of,
    midnight_of,
    recorded_model,
    refuse_every,
)
from jaxbound.recordings.recordingformat import UNSTATED, RecordingFormat
from jaxbound.recordings.seams import Clock, all_starts, around, aside, check_period, crossing, tick
from jaxbound.recordings.selection import looks_back, without_looks_of
from jaxbound.recordings.signals import Named, SignalModel, signals_of
from jaxbound.recordings.table import Data, as_table, is_table, paired
from jaxbound.recordings.tabletime import row_time
from jaxbound.recordings.timestamps import EPOCH, SECOND, from_epoch, row_label, time_label
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

NOWHERE = np.zeros(0, np.int64)
THE_MODEL = "the model has"
"""Who says dt, in sentences."""
Samples = tuple[np.ndarray, np.ndarray, np.ndarray | None]
"""(u, y, excluded)."""
Times = tuple[np.ndarray, np.ndarray | None, "pa.Array | None"]
"""(time in s, stamps, as they are written)."""
SINCE_1970 = 1e9  # a time in seconds that large is counted from 1970


@readable
@dataclass(frozen=True, eq=False)
class Recording:
    """One recording, or a batch of one length, as every verb takes it. `Recording.of` builds it of what a
    user holds, `jb.read` of a file.

    Fields:
        u, y: (..., T, m), (..., T, p) of one float dtype in the order of the model's signals; NaN where a
            sample is missing or does not count. Behind the inputs u has a column for each factor on the noise
            of an output. Tracers and jax arrays stay what they are.
        starts: (k,) whole numbers, ascending: samples that do not follow the one before. Windows across are
            MISSING.
        inputs, outputs: names of the columns of u and y; both empty: not known, they are taken by position.
        excluded: (T,) bool, samples that the model's `where` leaves out, with a start at either end of each
            stretch; None: it has none, or there was no table to look at.
        index: labels of the rows, of the table that y came from, else of that of u; of a file its times;
            None: there were none.
        time: (T,) seconds, of dates and time spans since the first sample; None where nothing tells it.
        origin: the instant at which `time` is 0, in s: since 1970 where there are dates, 0 of numbers; NaN:
            not known.
        dt: sampling period in s that the times of the rows show, or that a file is read by; None: there are
            none.
        stamps: (T,) datetime64[ns] where a file or an index has dates, else None.
        written: the time as the file has it, a pyarrow array; None: there was no file, or no time in it.
        hints: sentences that the user should read. source: name of the file. taken: how it was found to be
            written, as far as another file of the plant may not show it.
    """

    u: np.ndarray
    y: np.ndarray
    starts: np.ndarray = field(default_factory=lambda: NOWHERE)
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    excluded: np.ndarray | None = None
    index: pd.Index | np.ndarray | None = None
    time: Any = None
    origin: float = np.nan
    dt: Any = None
    stamps: np.ndarray | None = None
    written: pa.Array | None = None
    hints: tuple[str, ...] = ()
    source: str = ""
    taken: RecordingFormat = UNSTATED

    @classmethod
    def of(
        cls,
        model: Named,
        u: Data,
        y: Data = None,
        starts: ArrayLike = (),
        regular: bool = True,
        narrow: bool = True,
    ) -> Recording:
        """Return the Recording of a model's signals.

        Integers become floats.

        Args:
            model: with .inputs, .outputs and, where tables may be named otherwise, .columns, .column(signal),
                .dt (None: not known).
            u, y: arrays (..., T, m), or (..., T, m + q) with the q factors of the model behind its inputs;
                (..., T, p), masked or not; or tables: DataFrames of pandas or polars,
                tables of pyarrow, Datasets and labelled DataArrays of xarray, dicts of columns. Signals are
                taken by name, rows of two tables by the labels of their index. u is None for a model without
                inputs. y None: u holds both, a table or a Recording (or anything with .u and .y).
            starts: numbers of the samples that do not follow the one before; what tables tell of it is found:
                by an index of dates or time spans, else by the column by which `jb.read` would take the time
                from such a file, else by an index of numbers, which are seconds, or, whole ones, count the
                samples.
            regular: whether the rows must have the model's dt for their usual step. narrow: whether u takes
                the type of y, and both become float32 where jax runs with x64 off (`detect` counts that
                rounding); else each keeps the type it was recorded in.

        Raises:
            ValueError: a column that is not there, names that are not understood, text, a shape that does not
                fit the model or the other array, indexes that hold different rows, rows of several units, in
                disorder or of a wrong sampling period, starts that are no numbers of samples, a factor that
                is negative, or that needs columns which arrays do not have.
        """
        every = every_of(model)
        if every is not None:
            recorded = cls.of(recorded_model(signals_of(model)), u, y, starts, regular=False, narrow=narrow)
            if recorded.time is None or is_period(recorded.dt, every):
                return recorded  # means already
            if not regular:
                refuse_every(model, "tables that come one by one")
            if np.size(starts):
                raise ValueError(f"every = {every!r} and starts do not go together: times show the gaps")
            left = recorded.unfinished()
            grid, _ = left.over(every, rates=bool(looks_back(model)))
            means = recorded.averaged(grid, left.rows, len(model.inputs))
            _, seams = tick(Clock(seconds_of(every)), means.time)
            return replace(means, starts=_union(seams, around(means.excluded)))
        if y is None and is_made(u):
            return cls._of_recording(model, u, starts, narrow)
        is_one = u is y or y is None
        u = as_table(u, "u", model.inputs)
        if is_one and is_table(u):
            y = u
        else:
            y = as_table(y, "y", model.outputs)
        if y is None:
            if isinstance(u, Iterator):
                raise ValueError("u is a generator: jb.read(generator, model) makes a recording of it")
            raise ValueError("y is missing: give u and y, or one table or Recording that holds both")
        u, y, jumps = paired(u, y, model)
        u, y, excluded, hints = without_words(model, u, y)
        indexes = [x.index for x in (y, u) if hasattr(x, "iloc")]
        tables = {name: x for name, x in (("y", y), ("u", u)) if is_table(x)}
        u, y = float_arrays(model, u, y, narrow, tables, excluded)
        recording = cls(u, y, NOWHERE, known(model), tuple(model.outputs))._without(model, excluded)
        if indexes:
            recording = recording._timed(model, indexes[0], regular)
        if hints:
            recording = replace(recording, hints=tuple(hints))
        if not np.size(starts) and not len(jumps):
            return recording
        seams = _union(recording.starts, jumps, all_starts(starts, recording.samples))
        return replace(recording, starts=seams)

    def _without(self, model: Named, excluded: np.ndarray | None) -> Recording:
        """Return the recording without the samples that the model's `where` leaves out."""
        if excluded is None:
            return self
        out = (without_looks_of(excluded, model, names) for names in (self.inputs, self.outputs))
        u, y = (
            np.where(gone, np.array(np.nan, x.dtype), x)
            for gone, x in zip(out, (self.u, self.y), strict=True)
        )
        return replace(self, u=u, y=y, excluded=excluded, starts=_union(self.starts, around(excluded)))

    def _timed(self, model: Named, index: pd.Index, regular: bool) -> Recording:
        """Return the recording with the time that the labels of its rows tell."""
        dt, whose = getattr(model, "dt", None), getattr(model, "stated", THE_MODEL)
        rows = row_time(index, dt, whose, regular)
        return replace(
            self,
            index=index,
            time=rows.time,
            origin=rows.origin,
            dt=rows.dt,
            stamps=rows.stamps,
            starts=_union(self.starts, rows.seams),
        )

    @classmethod
    def filed(
        cls, model: SignalModel, samples: Samples, times: Times, source: str, dt: float | None
    ) -> Recording:
        """Return the Recording of samples as they stand in a file, without hints and starts.

        Args:
            model: whose signals they are. samples: (u, y, excluded). times: (time in s, stamps or None,
                written or None). source: its name. dt: sampling period in s, None: there is none.
        """
        u, y, excluded = samples
        time, stamps, written = times
        recording = cls(u, y, NOWHERE, known(model), tuple(model.outputs), excluded, source=source)
        recording = replace(recording, time=time, dt=dt, written=written)
        if written is None:
            return recording
        is_text = str(written.type) in ("string", "large_string")  # a clock without a date has no origin
        return recording._told(time, stamps, np.nan if is_text else 0.0)

    def _told(self, time: np.ndarray, stamps: np.ndarray | None, origin: float) -> Recording:
        """Return the recording with these times as labels of its rows. origin: where there are no dates."""
        index = time
        if stamps is not None and len(stamps):
            origin, index = float((stamps[0] - EPOCH) / SECOND - time[0]), stamps
        return replace(self, index=index, time=time, origin=origin, stamps=stamps)

    @classmethod
    def _of_recording(cls, model: Named, given: Data, starts: ArrayLike, narrow: bool) -> Recording:
        """Return the Recording of something that is one already: its signals, by their names if it has names,
        and its time, gaps and labels.
        """
        u, y = given.u, given.y
        own_starts, dt = getattr(given, "starts", ()), getattr(given, "dt", None)
        if is_table(as_table(u, "u")) or is_table(as_table(y, "y")):
            return cls.of(model, u, y, _union(own_starts, starts), narrow=narrow)
        names = [*getattr(given, "inputs", ()), *getattr(given, "outputs", ())]
        inputs, outputs = known(model), tuple(model.outputs)
        if names and not set(inputs) <= set(
            names
        ):  # without the factors: they are worked out where they can be
            inputs = tuple(model.inputs)
        if names and (given.inputs, given.outputs) != (inputs, outputs):
            signals = [x[..., i] for x in (u, y) for i in range(x.shape[-1])]
            u, y = _stack_of(inputs, names, signals, u), _stack_of(outputs, names, signals, y)
        seams = _union(own_starts, all_starts(starts, np.shape(y)[-2]))
        stated = getattr(model, "dt", None)
        if dt and stated:
            check_period(np.arange(2) * dt, stated, getattr(model, "stated", THE_MODEL))
        u, y = float_arrays(model, u, y, narrow)
        inputs = known(model)
        if isinstance(given, cls):
            return replace(given, u=u, y=y, starts=seams, inputs=inputs, outputs=outputs)
        excluded, index = getattr(given, "excluded", None), getattr(given, "index", None)
        return cls(u, y, seams, inputs, outputs, excluded, index, dt=dt)

    def unfinished(self, before: Unfinished | None = None) -> Unfinished:
        """Return the samples, none of which is in a mean yet, behind those that a recording before left over.

        Args:
            before: of the recording before; it counts if this one is known to be later.
        """
        if before is not None and np.isfinite(self.origin) and before.leads_to(self.time, self.dates, self.y):
            return before.followed(self.rows(before.origin))
        origin = midnight_of(self.dates)
        alone = self.rows(origin)
        return Unfinished(alone, alone.instant[:FIRST], origin)

    def rows(self, origin: np.datetime64 | None) -> Rows:
        """Return the samples as they are averaged. origin: what their instants count from."""
        excluded, broken = self.excluded, np.zeros(self.samples, bool)
        if excluded is None:
            excluded = np.zeros(self.samples, bool)
        return Rows(instants(self.time, self.dates, origin), self.u, self.y, excluded, broken)

    @property
    def dates(self) -> np.ndarray | None:
        """The stamps, or those of times in seconds since 1970; None of other times."""
        if self.stamps is None and self.samples and self.origin + self.time[0] > SINCE_1970:
            return from_epoch(self.origin + self.time, 1.0)
        return self.stamps

    def averaged(self, grid: Grid, rows: Rows, m: int, begin: int = 0, zero: int | None = None) -> Recording:
        """Return the means over intervals of the clock, without starts and hints, with the names of this
        recording.

        Args:
            grid: the intervals. rows, m, begin: see `means_of`. zero: see `Grid.time`; None: the first one.
        """
        u, y, excluded = means_of(grid, rows, m, begin)
        means = replace(self, u=u, y=y, starts=NOWHERE, dt=grid.every / 1e9, hints=(), written=None)
        if self.excluded is not None:
            means = replace(means, excluded=excluded)
        if zero is None:
            zero = int(grid.number[0])
        return means._told(grid.time(zero), grid.stamps, 0.0)

    def worded(self) -> Recording:
        """Return the recording with its dates as texts, as a file of text has them."""
        if self.stamps is None:
            return self
        return replace(self, written=moments(to_arrow(self.stamps)))

    def _head(self) -> str:
        names = f" of {self.source}" if self.source else ""
        return (
            f"Recording{names}: {self.y.shape[-2]} samples, u {tuple(self.u.shape)}, y "
            f"{tuple(self.y.shape)} {self.y.dtype}"
        )

    def _rows(self) -> dict[str, str]:
        rows = {}
        if self.inputs or self.outputs:
            rows = {"inputs": ", ".join(self.inputs), "outputs": ", ".join(self.outputs)}
        if self.time is not None and self.samples:
            rows["time"] = f"{self.label(0)} to {self.label(self.samples - 1)}"
        if len(self.starts):
            rows["gaps"] = f"{len(self.starts)}, the first before sample {int(self.starts[0])}"
        if isinstance(self.y, np.ndarray) and np.isnan(self.y).any():  # tracers have no numbers
            rows["missing"] = f"{int(np.isnan(self.y).sum())} samples of outputs"
        if self.excluded is not None:
            rows["excluded"] = f"{int(np.sum(self.excluded))} samples"
        return rows | {f"hint {i + 1}": hint for i, hint in enumerate(self.hints)}

    @property
    def samples(self) -> int:
        """The number of samples."""
        return int(self.y.shape[-2])

    @property
    def axis(self) -> np.ndarray | None:
        """The time for a plot: dates where there are, else seconds."""
        if self.stamps is not None:
            return self.stamps
        time: np.ndarray | None = self.time
        return time

    def label(self, k: int) -> str:
        """Return the time of sample k as its owner would write it."""
        written = None
        if self.written is not None:
            written = self.written[k].as_py()
        if isinstance(written, str):
            return written.strip()
        if self.time is None or (written is None and self.index is not None and self.stamps is None):
            return row_label(self.index, k)
        if self.stamps is not None:
            return time_label(self.time[k], self.stamps[k], 1.0)
        steps = np.abs(np.diff(self.time[:1000]))  # gaps and a clock that goes back are exceptions
        usual = 0.0
        if len(steps):
            usual = float(np.median(steps))
        return time_label(self.time[k], None, usual or 1.0)

    def cut(self, first: int, stop: int) -> Recording:
        """Return the samples first .. stop - 1, without hints."""
        starts = np.asarray(self.starts)
        parts: dict[str, Any] = {"starts": starts[(starts >= first) & (starts < stop)] - first, "hints": ()}
        for name in ("excluded", "index", "time", "stamps", "written"):
            whole = getattr(self, name)
            if whole is not None:
                parts[name] = whole[first:stop]
        return replace(self, u=self.u[..., first:stop, :], y=self.y[..., first:stop, :], **parts)

    @property
    def instants(self) -> np.ndarray:
        """(T,) times in s to a microsecond: since 1970 where there are dates, else as they count; where
        nothing tells a time the numbers of the samples.
        """
        if self.stamps is not None:
            return np.round((self.stamps - EPOCH) / SECOND, 6)
        if self.time is None:
            return np.arange(float(self.samples))
        origin = 0.0
        if np.isfinite(self.origin):
            origin = self.origin
        return np.round(origin + np.asarray(self.time, float), 6)

    @property
    def column(self) -> pa.Array:
        """The time as a column of a file: as it was written there, else dates, else seconds, else numbers of
        samples; a pyarrow array.
        """
        if self.written is not None:
            return self.written
        if self.stamps is not None:
            return to_arrow(self.stamps)
        if self.time is not None:
            return to_arrow(self.time)
        return to_arrow(np.arange(self.samples))

    def followed(self, other: Recording) -> Recording:
        """Return this recording and the one that comes behind it as one."""
        parts: dict[str, Any] = {"written": None}
        if self.written is not None and other.written is not None:
            import pyarrow as pa

            parts["written"] = pa.concat_arrays([self.written, other.written])
        for name in ("excluded", "index", "time", "stamps"):
            one, behind = getattr(self, name), getattr(other, name)
            parts[name] = None
            if one is not None and behind is not None and one.dtype.kind == behind.dtype.kind:
                parts[name] = np.concatenate([one, behind])
        u, y = np.concatenate([self.u, other.u], -2), np.concatenate([self.y, other.y], -2)
        starts = np.concatenate([self.starts, np.asarray(other.starts) + self.samples])
        return replace(self, u=u, y=y, starts=starts, **parts)

    def across(self, horizon: int) -> np.ndarray:
        """Return (T,) bool: True where the window of horizon + 1 samples that ends at a sample lies across a
        seam.
        """
        return crossing(self.starts, horizon, 0, self.y.shape[-2])

    def aside(self, horizon: int) -> int:
        """Return how many windows of horizon + 1 samples have one that does not count."""
        return aside(self.excluded, horizon)

    def finite(self) -> Recording:
        """Return the same recording; raise ValueError if a number of it is infinite."""
        refuse_infinite("u", self.u, self.inputs)
        refuse_infinite("y", self.y, self.outputs)
        return self


def _stack_of(
    wanted: Sequence[str], names: Sequence[str], signals: Sequence[np.ndarray], like: np.ndarray
) -> np.ndarray:
    """Return the wanted ones of signals (..., T) with these names as an array (..., T, n)."""
    if not wanted:
        return like[..., :0]
    places = [names.index(find_column(name, names, "the recording")) for name in wanted]
    return np.stack([signals[i] for i in places], -1)


def _union(*starts: ArrayLike) -> np.ndarray:
    """Return the numbers of samples of all, ascending, each once."""
    return np.unique(np.concatenate([np.asarray(x, np.int64) for x in starts]))
