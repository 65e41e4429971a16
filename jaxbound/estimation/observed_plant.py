"""A model as set observers compute with it: worked out once, shared by every observer of it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import jax
import numpy as np

from jaxbound.estimation.piece import Piece
from jaxbound.estimation.set_rounding import largest_number
from jaxbound.estimation.zonotope_begin import beginning_horizon, price, zonotope_begin
from jaxbound.estimation.zonotope_numbers import free_numbers, numbers
from jaxbound.estimation.zonotope_steps import Numbers, Start
from jaxbound.models.arguments import whole_horizon
from jaxbound.models.intervals import IntervalSystem, as_intervals
from jaxbound.models.sensor import RECORDER_ULPS, true_range
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import Directions, unknown_directions, with_direct_states
from jaxbound.recordings.factors import raised
from jaxbound.sets.floats import rounding

ObservedModel: TypeAlias = LinearSystem | IntervalSystem


@dataclass(frozen=True, eq=False)
class ObservedPlant:
    """A model, and all that follows from it alone. Build it with `observed_plant`.

    Fields: model: as it was given; linear: the LinearSystem with a state for each unknown input that acts on
    an output at once, or None of an `interval_system`; system: with intervals as its entries; unknown: the
    directions of unknown inputs, or None; start: how samples alone show the state, or None; past: samples
    before the first that this takes; dtype: of all that kernels take.
    """

    model: ObservedModel
    linear: LinearSystem | None
    system: IntervalSystem
    unknown: Directions | None
    start: Start | None
    past: int
    dtype: np.dtype

    @cached_property
    def numbers(self) -> Numbers:
        """The model in floats of the dtype."""
        all_in_bounds = self.system.n == self.model.n
        free = free_numbers(self.unknown, self.linear, all_in_bounds, self.dtype)
        return numbers(self.linear, self.system, self.dtype, free)

    @cached_property
    def exact(self) -> Numbers:
        """The same numbers in float64."""
        numbers: Numbers = jax.tree.map(lambda x: np.asarray(x, np.float64), self.numbers)
        return numbers

    @cached_property
    def placed(self) -> tuple[Numbers, Start | None]:
        """The numbers and the start where kernels run: they are not copied there for each sample."""
        placed: tuple[Numbers, Start | None] = jax.device_put((self.numbers, self.start))
        return placed

    @cached_property
    def _errors(self) -> tuple[np.ndarray | np.floating, ...]:
        """(Factor of a row, factor on sizes, share of these, floor, unit, tiny, largest number) of `read`."""
        sigma = np.asarray(self.numbers.tolerance)[:, None]
        e, (gamma, floor) = 1 / ((1 - sigma) * (1 + sigma)), rounding.residual_error(8, self.dtype)
        unit, tiny = rounding.unit(self.dtype), rounding.tiny(self.dtype)
        floor = floor * (1 + np.max(e, initial=0))
        return e, e * (1 + sigma), gamma, floor, unit, tiny, largest_number(self.dtype)

    def read(self, u: np.ndarray, y: np.ndarray, slip: np.ndarray, fresh: np.ndarray, unit: float) -> Piece:
        """Return samples of N recordings as kernels take them, see `sensor.true_value`.

        Args:
            u, slip (T, m + q, N): inputs, q factors on noise behind them, and how far inputs may be off.
            y (T, p, N), fresh (T, N). unit: roundoff of the type in which y was recorded.
        """
        x, m, (e, lift, gamma, floor, own, tiny, most) = self.numbers, self.system.m, self._errors
        sigma, y0, u0 = (np.asarray(column)[:, None] for column in (x.tolerance, x.y0, x.u0))
        factors, u, slip = u[:, m:], u[:, :m], slip[:, :m]
        absent, bound, size = np.isnan(y), self._noise(factors), np.abs(y)
        with np.errstate(all="ignore"):
            rho = bound + RECORDER_ULPS * self.dtype.type(unit) * (size + bound)
            rho = rho + RECORDER_ULPS * own * (size + rho) + tiny
            mid, rad = true_range(y - y0, rho, sigma, e)
            scale = lift * (size + np.abs(y0)) + rad
            # written so that NaN is gone, too
            gone = absent | ~(scale < most)
            rad = rad + gamma * scale + floor
            given = np.abs(u)
            known = (given < most).all(1)
            off = slip + np.asarray(x.wide_u0)[:, None] + 4 * own * (given + np.abs(u0)) + tiny
        v = np.where(np.isnan(u), 0, u) - u0
        mid, rad, off = np.where(gone, 0, mid), np.where(gone, np.inf, rad), np.where(known[:, None], off, 0)
        return Piece(mid, rad, v, off, known, fresh, refuted=np.zeros_like(fresh))

    def _noise(self, factors: np.ndarray) -> np.ndarray:
        """Return the bounds (p, 1), or (T, p, N), of errors of samples, rounded up to the dtype.

        Args:
            factors: (T, q, N) on the noise of the outputs that have one; a resolution stays as it is.
        """
        if not factors.shape[1]:
            return np.asarray(self.numbers.noise)[:, None]
        assert isinstance(self.model, LinearSystem), "others have no factors"
        bounds = np.tile(self.system.noise[:, None], (len(factors), 1, factors.shape[-1]))
        for column, factor in enumerate(self.model.factors):
            noise = rounding.round_up(self.model.noise[factor.number])
            resolution = rounding.round_up(self.model.resolution[factor.number])
            scaled = np.nextafter(noise * factors[:, column].astype(np.float64), np.inf)
            bounds[:, factor.number] = np.nan_to_num(np.nextafter(scaled + resolution, np.inf))  # with y
        return raised(bounds, self.dtype)

    def __getstate__(self) -> dict[str, Any]:
        # another process may have other devices
        return {name: value for name, value in vars(self).items() if name != "placed"}


def observed_plant(model: ObservedModel, horizon: int | None, has_first: bool) -> ObservedPlant:
    """Return the ObservedPlant of a model.

    Args:
        horizon: h of the h + 1 samples that show the state; None: the least. has_first: whether bounds of the
            first state are given, so that samples need not show it.

    Raises:
        ValueError: samples that do not show the state, a horizon that is none; as `unknown_directions`.
        TypeError: no model.
    """
    linear = None
    if isinstance(model, LinearSystem):
        linear = with_direct_states(model) if model.d else model
    system = as_intervals(model if linear is None else linear, unknown_inputs=True, factors=True)
    unknown = None
    if isinstance(model, LinearSystem) and linear is not None and model.d:
        unknown = unknown_directions(linear)
    h = whole_horizon(horizon)
    price(system.n, system.p, h)
    if h is None:
        h = beginning_horizon(linear, system, unknown)
        if h is not None and h * system.p > system.n:  # more than the least that was priced
            price(system.n, system.p, h)
    dtype = np.dtype(jax.dtypes.canonicalize_dtype(np.float64))
    start = None if h is None else zonotope_begin(linear, system, int(h), dtype, unknown)
    if start is None and not has_first:
        if h is None:
            why = "the outputs do not show all states, however long one looks"
        else:
            why = f"{h + 1} samples do not show all states, or the parameters are too uncertain for it"
        raise ValueError(f"{why}: give x0, bounds of the first state")
    past = 0 if start is None or h is None else int(h)
    return ObservedPlant(model, linear, system, unknown, start, past, dtype)
