"""The recordings of a fit as it looks at them, and the signals that they are read by."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from jaxbound.recordings.recording import Recording
from jaxbound.recordings.recordingformat import agreed, with_format, without_deadband
from jaxbound.studies.identification.records import Names, Records, common_period, read_each
from jaxbound.studies.identification.regression import Scales, scales_of


@dataclass(frozen=True, eq=False)
class Training:
    """Healthy recordings, and arguments of a LinearSystem that they settle.

    Fields: recordings: as `read_each` takes them, or has read them. records: their samples. Others:
    as of a LinearSystem.
    """

    recordings: object
    inputs: Names
    outputs: Names
    dt: float
    records: Records
    columns: Mapping[str, str]
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = "fitted"

    @classmethod
    def of(
        cls,
        recordings: object,
        inputs: str | Sequence[str] | None,
        outputs: str | Sequence[str] | None,
        dt: float | None,
        columns: Mapping[str, str],
    ) -> "Training":
        """Return the Training that reads recordings by these signals."""
        every, records = read_each(recordings, inputs, outputs, columns, dt), []
        for one in every:
            records.append((np.asarray(one.u, np.float64), np.asarray(one.y, np.float64), one.starts))
        columns = with_format(columns, agreed(recording.taken for recording in every))
        names = every[0].inputs, every[0].outputs
        return cls(every, *names, common_period(dt, every), records, columns)

    def with_inputs(self, inputs: Sequence[str]) -> "Training":
        """Return the training with some of its inputs."""
        places = [self.inputs.index(name) for name in inputs]
        records = [(u[:, places], y, starts) for u, y, starts in self.records]
        gone = set(self.inputs) - set(inputs)
        columns = {name: column for name, column in self.columns.items() if name not in gone}
        units = {name: unit for name, unit in self.units.items() if name not in gone}
        return dataclasses.replace(self, inputs=tuple(inputs), records=records, columns=columns, units=units)

    @property
    def about(self) -> dict[str, Any]:
        """The arguments of a LinearSystem whose bounds are found: a deadband is part of these."""
        names = ("dt", "inputs", "outputs", "units", "name")
        return {name: getattr(self, name) for name in names} | {"columns": without_deadband(self.columns)}

    def again(self) -> list[Recording]:
        """Return the recordings with the times of their samples."""
        return read_each(self.recordings, self.inputs, self.outputs, self.columns, None)

    @property
    def days(self) -> int:
        """How many recordings there are."""
        return len(self.records)

    @cached_property
    def scales(self) -> Scales:
        """The middle and the spread of each signal."""
        return scales_of(self.records)

    @cached_property
    def spans(self) -> tuple[float, ...]:
        """How far each output moves, between its lowest and its highest sample."""
        y = np.concatenate([y for _, y, _ in self.records])
        return tuple(np.nanmax(y, axis=0) - np.nanmin(y, axis=0))

    @property
    def span_of(self) -> dict[str, float]:
        """{output: how far it moves}."""
        return dict(zip(self.outputs, map(float, self.spans), strict=True))

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The lowest and the highest number of each input; of one that never moved the number twice."""
        u = np.concatenate([u for u, _, _ in self.records])
        ranges = {}
        for name, x in zip(self.inputs, u.T, strict=True):
            x = x[np.isfinite(x)]
            if len(x):
                ranges[name] = float(x.min()), float(x.max())
        return ranges
