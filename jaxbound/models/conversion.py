"""State-space objects of python-control and scipy.signal, taken as they are.

Neither package is imported here: an object is recognised by the class it comes from. A continuous system is
discretised by zero-order hold, exp([[A, B], [0, 0]] dt) = [[A_d, B_d], [0, I]]: exact where the inputs are
constant between samples, rounded to nearest floats, and from then on those decimals are the model.
"""

import re
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NoReturn, Protocol, TypeAlias, cast

import numpy as np

from jaxbound.exact.exponential import exponential
from jaxbound.exact.linalg import rational
from jaxbound.models.system import LinearSystem
from jaxbound.models.times import refuse_factors


class StateSpace(Protocol):
    """A state-space object of python-control or scipy.signal: its matrices, arrays of numbers."""

    A: Any
    B: Any
    C: Any
    D: Any
    dt: Any


class LabelledStateSpace(StateSpace, Protocol):
    """The names that a system of python-control has beside its matrices."""

    name: str
    input_labels: Sequence[str]
    output_labels: Sequence[str]
    state_labels: Sequence[str]


ModelLike: TypeAlias = LinearSystem | StateSpace
"""What `as_model` takes."""


def as_model(obj: ModelLike, factors: bool = False) -> LinearSystem:
    """Return a LinearSystem as it is; convert a discrete state-space object of python-control or
    scipy.signal.

    Args:
        factors: whether the caller knows factors on the noise, the `times` of a model.

    Raises:
        TypeError: anything else. ValueError: a model with `times` where they are not known; what
            `from_control` and `from_scipy` refuse.

    Example:
        >>> m = LinearSystem([[0.5]], None, [[1]])
        >>> as_model(m) is m
        True
    """
    if isinstance(obj, LinearSystem):
        if not factors:
            refuse_factors(obj)
        return obj
    packages = _packages(obj)
    if "control" in packages:
        return from_control(cast("LabelledStateSpace", obj))
    if "scipy" in packages:
        return from_scipy(obj)
    raise TypeError(
        f"a model is a LinearSystem, or a state-space object of python-control or scipy.signal, not "
        f"{type(obj).__name__}"
    )


def from_control(sys: LabelledStateSpace, dt: float | None = None, **bounds: Any) -> LinearSystem:
    """Build a LinearSystem from a python-control StateSpace.

    Args:
        sys: control.StateSpace; labels that were given to its signals and states are kept as names.
        dt: sampling period in seconds. Needed if sys is continuous (it is then discretised by zero-order
            hold) or discrete without a period (dt=True); must not contradict the period that sys has.
        bounds: every other argument of `LinearSystem`: tolerance, noise, resolution, inputs, outputs, offset,
            ...

    Returns:
        A LinearSystem. One without bounds describes perfect sensors: give at least a noise or a tolerance.

    Raises:
        ValueError: no dt for a continuous system, a dt that contradicts, a system without a time base.
        TypeError: not a state-space object.

    Example:
        >>> import control
        >>> sys = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["heater"], outputs=["T"])
        >>> m = from_control(sys, dt=0.1, noise=0.05)
        >>> m.inputs, m.outputs, round(float(m.A[0][0]), 6)
        (('heater',), ('T',), 0.904837)
    """
    kinds = _packages(sys).get("control", set())
    if "StateSpace" not in kinds:
        _refuse(sys, kinds, "control.ss(sys)", "python-control")
    if sys.dt is None:
        raise ValueError(
            "sys has no time base (dt=None): set sys.dt to 0 (continuous) or to its sampling period in "
            "seconds"
        )
    names: dict[str, Any] = {
        "inputs": _given(sys.input_labels, r"u\[\d+\]"),
        "outputs": _given(sys.output_labels, r"y\[\d+\]"),
        "states": _given(sys.state_labels, r"x\[\d+\]"),
    }
    if not re.fullmatch(r"sys\[\d+\].*", sys.name):
        names["name"] = sys.name
    return _build(sys, sys.dt, dt, names, bounds)


def from_scipy(sys: StateSpace, dt: float | None = None, **bounds: Any) -> LinearSystem:
    """Build a LinearSystem from a scipy.signal StateSpace, as lti(A, B, C, D) or dlti(A, B, C, D, dt=...)
    return it.

    Args:
        sys: scipy.signal.StateSpace, continuous or discrete.
        dt: sampling period in seconds, as for `from_control`.
        bounds: every other argument of `LinearSystem`.

    Raises:
        ValueError, TypeError: as `from_control`.

    Example:
        >>> from scipy.signal import dlti
        >>> from_scipy(dlti([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1), noise=0.05).dt
        0.1
    """
    kinds = _packages(sys).get("scipy", set())
    if "StateSpace" not in kinds:
        _refuse(sys, kinds, "sys.to_ss()", "scipy.signal")
    own = sys.dt if "dlti" in kinds else 0
    return _build(sys, own, dt, {}, bounds)


def _packages(obj: object) -> dict[str, set[str]]:
    """Return {package: names of the classes of that package that obj is an instance of}."""
    found: dict[str, set[str]] = {}
    # by the names of its classes: asking isinstance would import packages that nobody else needs
    for c in type(obj).__mro__:
        found.setdefault(c.__module__.split(".")[0], set()).add(c.__name__)
    return found


def _refuse(sys: object, kinds: set[str], convert: str, package: str) -> NoReturn:
    transfer = {"TransferFunction", "ZerosPolesGain", "FrequencyResponseData"} & kinds
    advice = f": convert it first, {convert}" if transfer else ""
    raise TypeError(f"a state-space object of {package} is needed, not {type(sys).__name__}{advice}")


def _given(labels: Sequence[str], automatic: str) -> tuple[str, ...] | None:
    """Return the labels, or None if python-control made them up."""
    if all(re.fullmatch(automatic, label) for label in labels):
        return None
    return tuple(labels)


def _build(
    sys: StateSpace, own: float | bool, dt: float | None, names: dict[str, Any], bounds: dict[str, Any]
) -> LinearSystem:
    """Build the model; own is the period of sys: 0 continuous, True discrete without a period, else
    seconds.
    """
    A, B, C, D = (np.asarray(x, np.float64) for x in (sys.A, sys.B, sys.C, sys.D))
    if own is True:
        if dt is None:
            raise ValueError(
                "sys is discrete but does not say its sampling period: give it as dt=, in seconds"
            )
    elif own == 0:
        if dt is None:
            raise ValueError(
                "sys is continuous: give the sampling period as dt=, in seconds, to discretise it by "
                "zero-order hold"
            )
        if not 0 < float(dt) < np.inf:
            raise ValueError(f"dt must be a positive number of seconds, not {dt!r}")
        A, B = _hold(A, B, float(dt))
    elif dt is not None and float(dt) != float(own):
        raise ValueError(
            f"dt={dt} contradicts the sampling period of sys, {own:g} s: leave dt out, or resample sys first"
        )
    else:
        dt = own
    # a name that is given wins over a label
    return LinearSystem(A, B, C, D, dt, **{**names, **bounds})


def _hold(A: np.ndarray, B: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (A_d, B_d) of x+ = A_d x + B_d u for x' = A x + B u with u constant over dt."""
    n, block = len(A), np.vectorize(rational, otypes=[object])
    # exact up to e, then rounded: those floats are the model, no error is left to bound
    step, _ = hold(block(A), block(B), rational(dt))
    return step[:n, :n].astype(float), step[:n, n:].astype(float)


def hold(A: np.ndarray, B: np.ndarray, dt: Fraction) -> tuple[np.ndarray, Fraction]:
    """Return (X, e): an array near exp([[A, B], [0, 0]] dt), (n + m, n + m), and a bound of the error of each
    entry.

    Args:
        A (n, n), B (n, m): arrays of Fractions. dt: a Fraction.

    Encloses: A_d = X[:n, :n] and B_d = X[:n, n:] within e: x+ = A_d x + B_d u for x' = A x + B u with u
    constant over dt.
    """
    n, m = len(A), len(B[0])
    below = np.full((m, n + m), Fraction(0), object)
    return exponential(np.concatenate([np.concatenate([A, B], axis=1), below]) * dt)
