"""The linear model and its bounds: what an engineer knows of a plant, kept as exact decimals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import FrozenInstanceError, dataclass, fields, replace
from fractions import Fraction
from functools import cached_property
from inspect import signature
from types import MappingProxyType
from typing import Any, Generic, NoReturn, TypeVar, overload

import numpy as np

from jaxbound.exact.linalg import Matrix, MatrixLike, Number, Vector
from jaxbound.models.arguments import whole_horizon, whole_lags
from jaxbound.models.average import Average, Averaged, averages_of
from jaxbound.models.named_faults import NamedFault, named_faults
from jaxbound.models.numbers import number
from jaxbound.models.plant import Plant, plant, refuse_state_space
from jaxbound.models.signals import (
    Each,
    ModelSignals,
    Sensors,
    Words,
    model_signals,
    refuse_other_every,
    sensors,
    words,
)
from jaxbound.models.statedalarms import stated_alarms
from jaxbound.models.statedtests import StatedTest, StatedTests, stated_tests
from jaxbound.models.times import times_of
from jaxbound.models.uncertainty import Uncertainty, centred
from jaxbound.models.unknown import Bounded, Coupling, Given, without_descriptor
from jaxbound.recordings.factors import Factor
from jaxbound.recordings.recordingformat import RECORDING, RecordingFormat
from jaxbound.text.objects import readable
from jaxbound.text.units import without_unit

FOR_OBSERVER = "for an observer"
"""Words in the provenance of bounds from data that were found for one, not for windows."""
TO_THE_END = "from start to end"
"""Words in the provenance of bounds that explain whole recordings: they hold for windows and observers."""
ORIGINS = ("tolerance", "noise", "resolution", "disturbance", "model", "extrapolation")
"""Of which a model may state where they come from."""

T = TypeVar("T")


class _Of(Generic[T]):
    """A field of one of the parts, read as an attribute of the model."""

    def __init__(self, part: str) -> None:
        self.part = part

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, model: None, owner: type) -> _Of[T]: ...

    @overload
    def __get__(self, model: LinearSystem, owner: type) -> T: ...

    def __get__(self, model: LinearSystem | None, owner: type) -> _Of[T] | T:
        return self if model is None else getattr(getattr(model, self.part), self.name)


@readable
@dataclass(init=False, eq=False, repr=False)
class LinearSystem:
    """A discrete-time linear model with imperfect sensors.

        x+ = A x + B u + G w + F v,    y = (1 + theta) (C x + D u + D_v v) + noise + rounding of the recording
        lo_j <= w_j <= hi_j,  |theta_i| <= tolerance_i,  |noise_i| <= noise_i,  |rounding_i| <= resolution_i,
        v any number, all drawn anew each sample

    Every number is kept exactly: a float means its shortest decimal; Fraction, Decimal, int and str ("1/3")
    are taken as they are. A model is a value of three parts, .plant, .sensors and .signals: equal where all
    numbers and texts are, and never changed; `model.replace(noise=..)` is a changed copy.

    Args:
        A, B, C, D: matrices (n, n), (n, m), (p, n), (p, m); B None: no inputs; D None: zero; A, B, C None: no
            states, y = D u.
        dt: sampling period in seconds.
        tolerance: relative sensor tolerance in [0, 1), one number or one per output.
        constant_tolerance: True if each theta keeps one value over a window (the gain error of a sensor),
            False if it is drawn anew.
        noise: absolute noise bound >= 0, in the unit of the output, one number or one per output.
        times: {output: expression}: the noise of an output is its bound times the value of an expression at
            each sample, {"T1": "1 + 0.5*abs(fan - 0.6)"}: over inputs of the model, by their names and as
            recorded, and over other columns of the recording, never over what an output is read from. Where
            it has no value, that sample of the output counts as missing. Also kept as .factors.
        resolution: what the recording itself rounds away (half a step of a quantised sensor), in the unit of
            the output, one number or one per output. On top of it, every sample is taken to be known to 4 u
            (largest |y_i| in the window + noise_i), u the unit roundoff of the recording's float type: a sum,
            a product and a final rounding of a perfect plant are within 3 u of this.
        averages: errors that average out, {signal: {samples: bound on the mean of so many consecutive ones}},
            of the error of an output or of a disturbance "w1", "w2", ..: {"T1": {16: 0.1}}; or {signal:
            [(weights, bound)]}, any sum of consecutive samples, the oldest first. An output then needs
            tolerance 0. Kept as `Average`.
        disturbance: (G, bound): G (n, g) says how unmeasured, bounded inputs w act on the states; bound (g,)
            or one number means |w| <= bound, bound (g, 2) means lo <= w <= hi (a leak is [0, w]). Kept as .G
            and .disturbance, g pairs (lo, hi).
        unknown_inputs: F (n, d), or a pair (F, D_v (p, d)): how inputs that nobody knows, not even a bound,
            act on the states and outputs. Kept as .F and .D_v.
        inputs, outputs, states: names; default u1.., y1.., x1...
        units: {name: unit}, for reports.
        offset: {"u": (m,), "y": (p,)}: operating point; the model speaks of u - offset and y - offset (the
            tolerance too).
        columns: {name: column} where a recording calls a signal otherwise, or "= an expression" over its
            columns, like "= `Supply Temp` - `Mixed Temp`"; "time": the column of its time stamps; "where": a
            condition, like "fan > 0": samples for which it does not hold are no part of the recording, and
            windows with them are MISSING; "every": an interval of dt, like "15min": samples are the means of
            what was recorded within each; "[recording]": how files are written, the text of
            a `RecordingFormat`.
        ranges: {input: (lowest, highest)}: between which it moved in the recordings that the model was fitted
            to; verdicts say which windows lie outside, see `Result.outside`, and `study` moves it there.
        provenance: {"noise": "datasheet" | "fitted" | "assumed", ...}: where a bound comes from, for reports.
        name: of the plant, for reports.
        horizon: of the windows for which the bounds were found (`jb.fit`): `parity_relations` takes it where
            none is asked for.
        lags: of these windows, where they look at the outputs at some samples only; the horizon is then the
            largest of them.
        left_out: how many times as wide as the smallest bounds those for a recording that was left out of the
            fit have to be, >= 1: `jb.fit` finds it, `jb.tune` keeps it. None: not known.
        extrapolation: how many times as wide as stated all bounds are for windows that read inputs outside
            their `ranges`, >= 1: `jb.fit` finds it; by its square and cube the farther outside. None, 1: as
            wide as stated.
        uncertainties: a sequence of `Uncertainty`: bounded parameters that change A, B, C, D. The given
            matrices are those at the value 0 of every parameter; .A, .B, .C, .D are kept at the middle of
            their bounds.
        decouple: names of uncertainties whose bounds are not to be trusted: they become unknown inputs.
        tests: of `jb.monitor`, one a mapping with the fields of a `[[test]]` table of a model file: {"name":
            "slow", "lags": [0, 1, 2, 4], "factor": 1.2}. Kept as .tests; whatever tests by this model in
            another way takes no notice.
        alarms: the rule by which commands make alarms, a mapping with the fields of the `[alarms]` table of
            a model file: {"rule": "3/5", "latch": True}. No verdict depends on it.
        faults: a sequence of `NamedFault`: what may break, in the words of whoever reads an alarm. No verdict
            depends on them: they are the candidates of a `Diagnosis`. None named: a bias of every sensor, an
            offset of every actuator.
        E: (r, n) of a descriptor system E x+ = A x + B u + ..., A, B, G, F (r, .) then. The model keeps the
            states that E determines; what no equation drives becomes unknown inputs. Not together with
            uncertainties.

    Raises:
        ValueError: shapes that do not fit, a number that is not finite, a negative bound, a tolerance >= 1, a
            name used twice, a factor that rests on an output.

    Source: Adrot, Maquin, Ragot 2000, (1)-(2).

    Example:
        >>> A, B, C = [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]]
        >>> m = LinearSystem(A, B, C, tolerance=[0.02, 0.1], noise=[0.1, 0.01])
        >>> m.n, m.m, m.p, m.outputs
        (2, 1, 2, ('y1', 'y2'))
        >>> m == m.replace(noise=["0.10", "1/100"]), m == m.replace(noise=0.1)
        (True, False)
    """

    plant: Plant
    sensors: Sensors
    signals: ModelSignals
    origins: Words
    name: str
    horizon: int | None
    lags: tuple[int, ...] | None
    averages: tuple[Average, ...]
    left_out: Fraction | None
    extrapolation: Fraction | None
    tests: tuple[StatedTest, ...]
    alarms: Mapping[str, Any]
    faults: tuple[NamedFault, ...]

    A = _Of[Matrix]("plant")
    B = _Of[Matrix]("plant")
    C = _Of[Matrix]("plant")
    D = _Of[Matrix]("plant")
    G = _Of[Matrix]("plant")
    F = _Of[Matrix]("plant")
    D_v = _Of[Matrix]("plant")
    disturbance = _Of[tuple[tuple[Fraction, Fraction], ...]]("plant")
    uncertainties = _Of[tuple[Uncertainty, ...]]("plant")
    dt = _Of[float]("plant")
    n = _Of[int]("plant")
    m = _Of[int]("plant")
    p = _Of[int]("plant")
    g = _Of[int]("plant")
    d = _Of[int]("plant")
    tolerance = _Of[Vector]("sensors")
    noise = _Of[Vector]("sensors")
    resolution = _Of[Vector]("sensors")
    constant_tolerance = _Of[bool]("sensors")
    inputs = _Of[tuple[str, ...]]("signals")
    outputs = _Of[tuple[str, ...]]("signals")
    states = _Of[tuple[str, ...]]("signals")

    def __init__(
        self,
        A: MatrixLike | None,
        B: MatrixLike | None = None,
        C: MatrixLike | None = None,
        D: MatrixLike | None = None,
        dt: Number = 1.0,
        *,
        tolerance: Each = 0.0,
        noise: Each = 0.0,
        times: Mapping[str, str] | None = None,
        constant_tolerance: bool | np.bool_ = False,
        resolution: Each | None = None,
        E: MatrixLike | None = None,
        unknown_inputs: Coupling | None = None,
        disturbance: Bounded | None = None,
        uncertainties: Uncertainty | Sequence[Uncertainty] = (),
        decouple: str | Sequence[str] = (),
        inputs: str | Sequence[str] | None = None,
        outputs: str | Sequence[str] | None = None,
        states: str | Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        offset: Mapping[str, Each] | None = None,
        columns: Mapping[str, str] | None = None,
        ranges: Mapping[str, tuple[Number, Number]] | None = None,
        provenance: Mapping[str, str] | None = None,
        name: str = "model",
        horizon: int | None = None,
        lags: Sequence[int] | None = None,
        averages: Averaged | None = None,
        left_out: Number | None = None,
        extrapolation: Number | None = None,
        tests: StatedTests | None = None,
        alarms: Mapping[str, Any] | None = None,
        faults: Sequence[NamedFault] = (),
    ) -> None:
        refuse_state_space(A)
        given = Given(A, B, C, D, disturbance, unknown_inputs)
        if E is not None:
            if np.size(np.asarray(uncertainties, object)):
                raise ValueError(
                    "E and uncertainties do not go together: solve the equations for x+ first, or decouple "
                    "the parameters"
                )
            given, states = without_descriptor(E, given, states)
        parts = plant(given, dt, uncertainties, decouple)
        sizes, names = (parts.m, parts.p, parts.n), (inputs, outputs, states)
        signals = model_signals(sizes, names, offset, units, columns, ranges)
        refuse_other_every(signals.columns, parts.dt, bool(times))
        length, sparse = _window(horizon, lags)
        how = RecordingFormat.of(dict(signals.columns).get(RECORDING))
        measured = sensors(signals.outputs, tolerance, noise, resolution, constant_tolerance, how)
        factors = times_of(times, signals, measured, bool(parts.uncertainties))
        measured = replace(measured, times=factors)
        vars(self).update(
            plant=parts,
            sensors=measured,
            signals=signals,
            origins=words("provenance", provenance, ORIGINS),
            name=str(name),
            horizon=length,
            lags=sparse,
            averages=_averages(averages, parts, measured, signals.outputs),
            left_out=_factor("left_out", left_out),
            extrapolation=_factor("extrapolation", extrapolation),
            tests=stated_tests(tests),
            alarms=stated_alarms(alarms),
            faults=named_faults(faults, signals.inputs, signals.outputs, signals.states),
        )

    def replace(self, **changes: Any) -> LinearSystem:
        """Return a copy of the model with some of the arguments changed that it could have been built from.

        Args:
            changes: any arguments of `LinearSystem`. Matrices are those at the value 0 of every parameter, as
                they are there.

        Raises:
            ValueError, TypeError: as `LinearSystem`.

        Example:
            >>> m = LinearSystem([[0.8]], None, [[1]], noise=0.1)
            >>> m.replace(noise="1/3", name="tank").noise
            (Fraction(1, 3),)
        """
        if "horizon" in changes or "lags" in changes:  # another window altogether
            changes = {"horizon": None, "lags": None, "left_out": None, **changes}
        return LinearSystem(**{**self._arguments(), **changes})

    __replace__ = replace  # copy.replace(model, noise=..), from Python 3.13 on

    def _notes(self) -> dict[str, dict[str, str]]:
        """Return {table: {field: TOML}} that a file of the model has besides: how it was made."""
        return {}

    def _arguments(self) -> dict[str, Any]:
        """Return arguments that build this very model."""
        own = matrices_at_zero(self) | {
            "unknown_inputs": (self.F, self.D_v) if self.d else None,
            "disturbance": (self.G, self.disturbance) if self.g else None,
            "horizon": self.horizon if self.lags is None else None,
        }
        return own | {name: getattr(self, name) for name in ARGUMENTS if name not in own}

    @property
    def times(self) -> Mapping[str, str]:
        """The factors on the noise that are stated, {output: expression}."""
        return MappingProxyType(dict(self.sensors.times))

    @cached_property
    def factors(self) -> tuple[Factor, ...]:
        """The same in the order of the columns that they have behind the inputs of a Recording."""
        return tuple(Factor(self.outputs.index(name), name, text) for name, text in self.sensors.times)

    @property
    def offset(self) -> Mapping[str, Vector]:
        """The operating point, {"u": (m,), "y": (p,)}."""
        return MappingProxyType({"u": self.signals.input_offset, "y": self.signals.output_offset})

    @property
    def units(self) -> Mapping[str, str]:
        """The units that are stated, {name: unit}."""
        return MappingProxyType(dict(self.signals.units))

    @property
    def columns(self) -> Mapping[str, str]:
        """The columns that are stated, {name: column}."""
        return MappingProxyType(dict(self.signals.columns))

    @property
    def ranges(self) -> Mapping[str, tuple[Fraction, Fraction]]:
        """The ranges of inputs that are stated, {input: (lowest, highest)}."""
        return MappingProxyType({name: (lo, hi) for name, lo, hi in self.signals.ranges})

    @property
    def provenance(self) -> Mapping[str, str]:
        """The origins of bounds that are stated, {field: origin}."""
        return MappingProxyType(dict(self.origins))

    @property
    def has_feedthrough(self) -> bool:
        """True if D is not zero: the newest input of a window then matters."""
        if any(map(any, self.D)):
            return True
        return any(u.D is not None and any(map(any, u.D)) for u in self.uncertainties)

    @property
    def has_direct_unknown(self) -> bool:
        """True if D_v is not zero: the newest unknown input of a window then matters."""
        return any(map(any, self.D_v))

    def column(self, signal: str) -> str:
        """Return the column of a recording that holds a signal."""
        return self.columns.get(signal, signal)

    def unit(self, signal: str) -> str:
        """Return the unit of a signal: the one that is stated, else that of its column, "Pump [%]", or ""."""
        if signal in self.units:
            return self.units[signal]
        if signal in self.columns:
            return without_unit(self.columns[signal])[1]
        return ""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LinearSystem):
            return NotImplemented
        if self is other:
            return True
        return all(getattr(self, f.name) == getattr(other, f.name) for f in fields(LinearSystem))

    def __hash__(self) -> int:
        # a few numbers tell models apart; those of large matrices would cost more
        return hash((self.name, self.sensors, self.signals))

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise FrozenInstanceError(
            f"a LinearSystem is a value: {name} cannot be set; model.replace(noise=..) makes a changed copy"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise FrozenInstanceError(
            f"a LinearSystem is a value: {name} cannot be deleted; model.replace(noise=..) makes a changed "
            f"copy"
        )

    def _rows(self) -> dict[str, str]:
        """Return {name: text} of outputs and of uncertain parameters, for `readable`."""
        rows = {}
        bounds = zip(self.outputs, self.tolerance, self.noise, self.resolution, strict=True)
        for name, tolerance, noise, resolution in bounds:
            rows[name] = (
                f"tolerance {float(tolerance):.4g}, noise {float(noise):.4g}, "
                f"resolution {float(resolution):.4g} {self.unit(name)}"
            )
            if name in self.times:
                rows[name] += f", noise times {self.times[name]}"
        for u in self.uncertainties:
            rows[u.name] = repr(u)
        return rows

    def __repr__(self) -> str:
        window = ""
        if self.lags is not None:
            window = f", lags {self.lags}"
        elif self.horizon is not None:
            window = f", horizon {self.horizon}"
        signals = f"inputs {list(self.inputs)}, outputs {list(self.outputs)}"
        return f"{type(self).__name__}({self.name!r}: {self.n} states, {signals}, dt={self.dt:g} s{window})"


ARGUMENTS = tuple(name for name in signature(LinearSystem).parameters if name not in ("E", "decouple"))
"""Arguments by which a model is built anew: it is solved for x+, and decoupled."""


def matrices_at_zero(model: LinearSystem) -> dict[str, Matrix]:
    """Return A, B, C, D by their letters, at the value 0 of every uncertain parameter."""
    middle = {"A": model.A, "B": model.B, "C": model.C, "D": model.D}
    return {letter: centred(rows, model.uncertainties, letter, sign=-1) for letter, rows in middle.items()}


def _averages(
    given: Averaged | None, parts: Plant, measured: Sensors, outputs: tuple[str, ...]
) -> tuple[Average, ...]:
    """Return the averages of a model; refuse what they do not go together with."""
    averages = averages_of(given, outputs, parts.disturbance)
    if averages and (parts.uncertainties or measured.constant_tolerance):
        what = "uncertainties" if parts.uncertainties else "constant_tolerance"
        raise ValueError(
            f"averages and {what} do not go together: they are tested beside exact models and tolerances "
            f"drawn anew"
        )
    for average in averages:
        signal = average.signal
        if signal in outputs and measured.tolerance[outputs.index(signal)]:
            raise ValueError(
                f"averages of {signal!r} need its tolerance to be 0: a relative error of samples that "
                f"differ has no mean; give the tolerance as noise"
            )
    return averages


def _factor(name: str, value: Number | None) -> Fraction | None:
    """Return a factor on bounds, checked."""
    if value is None:
        return None
    factor = number(name, value)
    if factor < 1:
        raise ValueError(f"{name} must be a factor >= 1, not {value!r}")
    return factor


def _window(horizon: int | None, lags: Sequence[int] | None) -> tuple[int | None, tuple[int, ...] | None]:
    """Return the horizon and the lags of the windows for which bounds were found, checked."""
    horizon = whole_horizon(horizon)
    if lags is None:
        return horizon, None
    lags = whole_lags(lags)
    if horizon not in (None, lags[-1]):
        raise ValueError(
            f"lags up to {lags[-1]} say by themselves how long a window is: leave the horizon {horizon} out"
        )
    return lags[-1], lags
