"""A user's own residual: f(z, u_window, y_window) = 0 for some z in a box, f any JAX function.

It puts any model with bounded unknowns into the form of the library: parameters that stay constant over the
window, an unknown first state, sensor errors and disturbances are all entries of z.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.consistency.bisection import BisectionTest, ResidualRelations, flat
from jaxbound.consistency.interface import Budget, Starts, WindowTest, refuse_options
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import recorded
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.table import as_table, is_table
from jaxbound.sets.intervals.interval import Interval, interval, mid
from jaxbound.text.objects import readable


@dataclass(frozen=True)
class Channels:
    """Names of the signals that a residual reads; None: those of the recording."""

    stated_inputs: tuple[str, ...] | None
    stated_outputs: tuple[str, ...] | None
    dt: float
    name: str

    inputs = property(lambda self: self.stated_inputs or (), doc="Names of the inputs, as far as known.")
    outputs = property(lambda self: self.stated_outputs or (), doc="Names of the outputs, as far as known.")

    m = property(lambda self: len(self.inputs), doc="Number of inputs.")
    p = property(lambda self: len(self.outputs), doc="Number of outputs.")

    @property
    def named(self) -> bool:
        """Whether the signals have names."""
        return self.stated_inputs is not None and self.stated_outputs is not None

    @property
    def columns(self) -> dict[str, str]:
        """The columns that are stated: none."""
        return {}

    def column(self, signal: str) -> str:
        """Return the column of a signal: its name."""
        return signal

    def unit(self, signal: str) -> str:
        """Return no unit: none is stated."""
        return ""

    def of(self, u: object, y: object) -> Self:
        """Return these channels with the names that are missing taken from the columns of u and y, or
        numbered.
        """
        inputs, outputs = self.stated_inputs, self.stated_outputs
        if y is None and not self.named:
            if not (hasattr(u, "inputs") and hasattr(u, "outputs")):
                raise ValueError(
                    "nothing says which columns are what: name the signals, residual(f, box, s, inputs=, "
                    "outputs=)"
                )
            inputs, outputs = inputs or u.inputs, outputs or u.outputs
        if inputs is None:
            inputs = _names(u, "u")
        if outputs is None:
            outputs = _names(y, "y")
        return dataclasses.replace(self, stated_inputs=inputs, stated_outputs=outputs)


def _names(data: object, letter: str) -> tuple[str, ...]:
    """Return the names of the columns of a table, numbers where there are none."""
    table = as_table(data, letter)
    if table is None:
        return ()
    if is_table(table):
        return tuple(table.select_dtypes(exclude=["datetime", "datetimetz", "timedelta"]).columns)
    if np.ndim(table) < 2:
        return (f"{letter}1",)
    return tuple(f"{letter}{i + 1}" for i in range(np.shape(table)[-1]))


@readable
@dataclass(frozen=True, eq=False)
class Residual(ResidualRelations):
    """f(z, u_window, y_window) = 0 for some z in a box. Build it with `residual`.

    Fields: f; box: Interval (n,); horizon s: a window has s + 1 samples; model: Channels, the names of the
    signals.
    """

    f: Callable[..., Any]
    box: Interval
    horizon: int
    model: Channels

    @property
    def bounds(self) -> dict[str, np.ndarray]:
        """{"parameters": (n, 2)}: lo and hi of every unknown."""
        return {"parameters": np.stack([np.asarray(self.box.lo), np.asarray(self.box.hi)], 1)}

    def with_bounds(self, bounds: Mapping[str, ArrayLike]) -> Self:
        """Return the same residual over another box.

        Args:
            bounds: {"parameters": (n, 2)}, lo and hi of every unknown.

        Raises:
            ValueError: another name, a wrong shape, NaN, lo > hi, an infinite bound.
        """
        if set(bounds) != {"parameters"}:
            raise ValueError(f"the bounds of a residual are ['parameters'], not {sorted(bounds)}")
        wanted, given = (*self.box.shape, 2), np.shape(bounds["parameters"])
        if given != wanted:
            raise ValueError(
                f"parameters needs lo and hi for each unknown, shape {wanted}: its shape is {given}"
            )
        lo, hi = np.moveaxis(np.asarray(bounds["parameters"]), -1, 0)
        return dataclasses.replace(self, box=_checked_box(interval(lo, hi)))

    def named_like(self, model: LinearSystem) -> Self:
        """Return the residual with the names of a plant, in its order, for signals without names; see
        `Channels`.
        """
        channels = self.model
        inputs = model.inputs if channels.stated_inputs is None else channels.inputs
        outputs = model.outputs if channels.stated_outputs is None else channels.outputs
        named = dataclasses.replace(channels, stated_inputs=inputs, stated_outputs=outputs)
        return dataclasses.replace(self, model=named)

    def recording(self, u: object, y: object = None, starts: Starts = ()) -> tuple[Self, Recording]:
        """Return (relations, recording): the residual with the names of the signals that it lacks, taken from
        what becomes a Recording.
        """
        model = self.model.of(u, y)
        signals = Signals(model.inputs, model.outputs, {})
        return dataclasses.replace(self, model=model), recorded(signals, u, y, starts)

    def test(self, method: str, dtype: DTypeLike, budget: Budget = None) -> WindowTest:
        """Return the WindowTest by which a method decides windows; see `detect`.

        Raises:
            ValueError: a method or budget that these relations cannot be tested by.
        """
        if method == "box":
            raise ValueError("method 'box' is for parity relations: a residual is decided as a whole")
        refuse_options(method, budget, adaptive=True)
        return BisectionTest(self, method, dtype, budget)

    def shape(self, m: int, p: int) -> int:
        """Return the number of residuals for windows of m inputs and p outputs.

        Raises:
            ValueError: f returns nothing, or something that is not a float.
        """
        samples, dtype = self.horizon + 1, self.box.dtype
        shapes = self.box.shape, (samples, m), (samples, p)
        # a class of JAX without types
        arguments = [jax.ShapeDtypeStruct(x, dtype) for x in shapes]  # type: ignore[no-untyped-call]
        # traced, not run: f may be slow, or refuse samples that are no plant's
        out = jax.eval_shape(flat(self.f), *arguments)
        if not out.size or not jnp.issubdtype(out.dtype, jnp.floating):
            raise ValueError(f"f must return at least one float, not {out.size} of type {out.dtype}")
        return int(out.size)

    @property
    def count(self) -> int:
        """Number of residuals.

        Raises:
            ValueError: the signals have no names yet.
        """
        if not self.model.named:
            raise ValueError(
                "the number of residuals depends on that of the signals: name them, residual(f, box, s, "
                "inputs=, outputs=)"
            )
        return self.shape(self.model.m, self.model.p)

    def external(self, u: object, y: object = None, starts: Starts = ()) -> jax.Array:
        """Return f at the middle of the box, (..., T, count), NaN where a window is incomplete. Not rounded:
        for plots and studies.

        Args:
            u: (..., T, m) inputs (None without inputs). y: (..., T, p) outputs; starts: as for `detect`.
        """
        recording = self.recording(u, y, starts)[1]
        on_device: tuple[jax.Array, jax.Array] = jax.device_put((recording.u, recording.y))
        inputs, outputs = on_device
        s, lead, length = self.horizon, outputs.shape[:-2], outputs.shape[-2]
        count = self.shape(inputs.shape[-1], outputs.shape[-1])
        if length <= s:
            return jnp.full((*lead, length, count), jnp.nan, outputs.dtype)
        rows = np.arange(length - s)[:, None] + np.arange(s + 1)[None]
        many = math.prod(lead) * len(rows)
        windows = [x[..., rows, :].reshape(many, s + 1, x.shape[-1]) for x in on_device]
        residuals = jax.vmap(flat(self.f), (None, 0, 0))(mid(self.box), *windows)
        residuals = residuals.reshape(*lead, length - s, count)
        first = jnp.full((*lead, s, count), jnp.nan, residuals.dtype)
        residuals = jnp.concatenate([first, residuals], -2)
        if not len(recording.starts):
            return residuals
        return jnp.where(recording.across(s)[:, None], jnp.nan, residuals)

    def text(self) -> str:
        """Return the relation as a reader would write it."""
        s, name = self.horizon, getattr(self.f, "__name__", "f")
        if name == "<lambda>":
            name = "f"
        span = f"[k-{s}..k]" if s else "[k]"
        ends = zip(np.asarray(self.box.lo).tolist(), np.asarray(self.box.hi).tolist(), strict=True)
        box = " x ".join(f"[{lo:g}, {hi:g}]" for lo, hi in ends)
        return f"{name}(z, u{span}, y{span}) = 0 for some z in {box}"


def residual(
    f: Callable[[jax.Array, jax.Array, jax.Array], Any],
    box: Interval,
    horizon: int = 0,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    dt: float = 1.0,
    name: str = "residual",
) -> Residual:
    """Describe healthy windows by an equation that must hold for some value of bounded unknowns.

    Args:
        f: a JAX function of z (n,), u_window (s + 1, m) and y_window (s + 1, p), first sample first; returns
            a float, an array of r or a list of them, all of which must be 0 for one z. What `inclusion`
            supports may be used.
        box: Interval (n,), bounded: where the unknowns are. Errors of the sensors are unknowns like any
            other.
        horizon: s >= 0, a window has s + 1 samples.
        inputs, outputs: names of the signals, for DataFrames with more columns and for reports; None: those
            of the recording.
        dt, name: for reports.

    Returns:
        A Residual for `detect`.

    Raises:
        ValueError: a box that is empty, unbounded or of another shape, a horizon that is no whole number >=
            0, names given twice.

    Example:
        >>> import jaxbound as jb
        >>> # the gain is uncertain by 1 %, the sensor by 0.1
        >>> drift = lambda z, u, y: y[1, 0] - (1 + z[0]) * y[0, 0] ** 2 - z[1]
        >>> r = jb.residual(drift, jb.interval([-0.01, -0.1], [0.01, 0.1]), horizon=1)
        >>> [jb.Status(int(k)).name for k in jb.detect(r, None, [[1.0], [1.05], [1.3], [2.0]]).status]
        ['MISSING', 'CONSISTENT', 'FAULT', 'FAULT']
    """
    if not callable(f):
        raise TypeError(f"residual needs a function of (z, u_window, y_window), not {type(f).__name__}")
    if isinstance(horizon, bool) or not isinstance(horizon, int | np.integer) or horizon < 0:
        raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
    channels = Channels(_stated("inputs", inputs), _stated("outputs", outputs), float(dt), str(name))
    return Residual(f, _checked_box(interval(box)), int(horizon), channels)


def _stated(kind: str, names: Sequence[str] | None) -> tuple[str, ...] | None:
    """Return names as a user states them, refused where one stands twice; None: of the recording."""
    if names is None:
        return None
    if isinstance(names, str) or len(set(names)) != len(names):
        raise ValueError(f"{kind} must be different names, not {names!r}")
    return tuple(names)


def _checked_box(box: Interval) -> Interval:
    """Return the box, or refuse one that is empty, unbounded or of another shape."""
    lo, hi = np.asarray(box.lo), np.asarray(box.hi)
    if lo.ndim != 1 or not len(lo) or not (np.isfinite(lo) & np.isfinite(hi)).all() or (lo > hi).any():
        raise ValueError(f"box must be a bounded, non-empty Interval of shape (n,): its shape is {lo.shape}")
    return box
