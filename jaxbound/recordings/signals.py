"""Signals of a model as recordings see them: their names, columns, units and sampling period."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, cast


class Named(Protocol):
    """Names of signals, of a model or of whatever stands for one; the rest of a SignalModel may be absent."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""


class SignalModel(Named, Protocol):
    """Names of the signals of any model: by them recordings are read and verdicts are shown."""

    @property
    def m(self) -> int:
        """Number of inputs."""

    @property
    def p(self) -> int:
        """Number of outputs."""

    @property
    def columns(self) -> Mapping[str, str]:
        """{signal, "time" or "where": column of a recording} where it is called otherwise."""

    @property
    def dt(self) -> float | None:
        """Sampling period in s; None: not known."""

    @property
    def name(self) -> str:
        """Name of the model."""

    def column(self, signal: str) -> str:
        """Return the column of a recording that holds a signal."""

    def unit(self, signal: str) -> str:
        """Return the unit of a signal, or an empty string."""


@dataclass(frozen=True)
class Signals:
    """The names that reading needs where there is no model yet.

    Fields: inputs, outputs: names; columns: as of a LinearSystem; dt: sampling period in s, None: the median
    step of the recording; regular: whether its rows have to be a sampling period apart.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    columns: dict[str, str]
    dt: float | None = None
    regular: bool = True
    stated = "you gave"
    """Who says dt, in sentences."""
    name = ""

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def p(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def resolution(self) -> tuple[float, ...]:
        """The largest there is, for each output: nothing is stated that could be too small."""
        return (math.inf,) * len(self.outputs)

    def column(self, signal: str) -> str:
        """Return the column of a recording that holds a signal."""
        return self.columns.get(signal, signal)

    def unit(self, signal: str) -> str:
        """Return no unit: none is stated."""
        return ""


def signals_of(model: Named) -> SignalModel:
    """Return a model by whose names recordings are read: as it is, that of relations, an observer or a
    monitor, or Signals of one that has names only.
    """
    if not hasattr(model, "inputs"):
        model = getattr(model, "model", model)
    if hasattr(model, "column"):
        return cast(SignalModel, model)
    return Signals(tuple(model.inputs), tuple(model.outputs), {}, getattr(model, "dt", None))
