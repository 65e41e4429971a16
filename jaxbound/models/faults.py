"""Faults to put into a simulation."""

from dataclasses import dataclass

from jaxbound.recordings.expressions import missing_column
from jaxbound.recordings.signals import SignalModel
from jaxbound.text.objects import readable

KINDS = ("bias", "drift", "gain", "noise", "tolerance", "stuck", "dropout")


@readable
@dataclass(frozen=True)
class Fault:
    """A fault of one sensor or actuator for the samples start <= k < stop.

    Args:
        signal: the name of an output or input of the model. An actuator's fault changes what the plant
            receives, not what is recorded.
        kind: "bias": + size. "drift": + size per sample since the start. "gain": times 1 + size, and of an
            output the noise stays as it is (`NamedFault` has the equations). "noise": + a
            value uniform in [-size, size] each sample. "tolerance": theta is drawn in [-size, size] instead
            of the model's tolerance (outputs only). "stuck": keeps its first value. "dropout": an output is
            missing (NaN), an input is 0.
        size: in the unit of the signal; relative for "gain" and "tolerance"; unused by "stuck" and "dropout".
        start, stop: samples; stop None: to the end.

    Raises:
        ValueError: unknown kind, a size that is not finite, stop <= start.

    Example:
        >>> Fault("y1", kind="bias", size=0.2, start=140, stop=180)
        Fault(signal='y1', kind='bias', size=0.2, start=140, stop=180)
    """

    signal: str
    kind: str = "bias"
    size: float = 0.0
    start: int = 0
    stop: int | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind of fault must be one of {', '.join(KINDS)}, not {self.kind!r}")
        if not abs(self.size) < float("inf"):
            raise ValueError(f"size of a fault must be a finite number, not {self.size!r}")
        if self.start < 0 or (self.stop is not None and self.stop <= self.start):
            raise ValueError(f"a fault needs 0 <= start < stop: start {self.start}, stop {self.stop}")


def refuse_unknown_signal(model: SignalModel, signal: str, kind: str) -> None:
    """Raise ValueError for a signal that the model does not have, or that cannot have a fault of this
    kind.
    """
    known = model.outputs + model.inputs
    if signal not in known:
        for name in known:
            if model.column(name) == signal:
                raise ValueError(
                    f"{signal!r} is the column of the signal {name}: a fault names the signal, {name}"
                )
        raise ValueError(missing_column(signal, known, "the model", "signal"))
    if kind == "tolerance" and signal not in model.outputs:
        raise ValueError(f"a tolerance fault needs an output, {signal!r} is an input")
