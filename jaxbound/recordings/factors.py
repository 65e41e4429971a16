"""Factors on the bounds of outputs: numbers for each sample that are worked out from recorded columns.

A factor is known, as an input is, so it travels as one: behind the inputs, a column of u for each output that
has a factor. The number is worked out once, in float64, and is exact from there on; a narrower type rounds it
up. A condition, of which a monitor asks whether it holds, travels the same way: as 1, 0 or NaN.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from jaxbound.recordings.expressions import Expression, expression
from jaxbound.recordings.signals import Named

LARGEST = 2.0**60
"""A bound so many times as wide is none, and a product with it might overflow."""
IN_PART = 0.5
"""In place of 1 or 0: whether a condition holds changes within an interval that a sample is the mean over."""


@dataclass(frozen=True)
class Factor:
    """A factor on the noise bound of an output. Fields: number: of the output; output: its name; text: the
    expression.
    """

    number: int
    output: str
    text: str

    @property
    def name(self) -> str:
        """The name of its column behind the inputs, which tells it from every other."""
        return f"noise of {self.output} times {self.text}"

    @property
    def about(self) -> str:
        """The words for it in a sentence."""
        return f"the noise of {self.output!r} is times {self.text!r}"

    def numbers(self, values: np.ndarray) -> np.ndarray:
        """Return the numbers (..., T) that travel, of the values of the expression."""
        return values

    @property
    def expression(self) -> Expression:
        """The expression, read."""
        return read_factor(self.text)


@dataclass(frozen=True)
class Condition(Factor):
    """A condition that is asked for at each sample, of no output. Fields: text: the expression."""

    number: int = -1
    output: str = ""
    text: str = ""

    @property
    def name(self) -> str:
        """The name of its column behind the inputs."""
        return f"whether {self.text}"

    @property
    def about(self) -> str:
        """The words for it in a sentence."""
        return f"the condition of a test is {self.text!r}"

    def numbers(self, values: np.ndarray) -> np.ndarray:
        """Return 1 where the condition holds, 0 where it does not, NaN where nobody knows."""
        return np.where(np.isnan(values), np.nan, values != 0)


read_factor = lru_cache(maxsize=256)(expression)
"""Reads the expression of a factor, each text once."""


def factors_of(model: Named) -> tuple[Factor, ...]:
    """Return the factors of a model, in the order of their columns; none of a model that knows no factors."""
    factors: tuple[Factor, ...] = getattr(model, "factors", ())
    return factors


def known(model: Named) -> tuple[str, ...]:
    """Return the names of the columns of u in a Recording: the inputs, then the factors."""
    names = list(model.inputs)
    for factor in factors_of(model):
        names.append(factor.name)
    return tuple(names)


def with_factors(
    model: Named, u: np.ndarray, y: np.ndarray, values: Sequence[np.ndarray], first: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return (u, y) with the factors behind the inputs, and NaN in an output where its factor has no value.

    Args:
        u: (..., T, m) inputs. y: (..., T, p). values: (..., T) of each factor, NaN where it has none.
        first: number of the first sample, for sentences.

    Raises:
        ValueError: a factor that is negative, or too large for a bound.
    """
    shape = np.broadcast_shapes(u.shape[:-1], *(x.shape for x in values))
    numbers = [factor.numbers(x) for factor, x in zip(factors_of(model), values, strict=True)]
    columns = np.stack([np.broadcast_to(x, shape) for x in numbers], -1)
    _refuse(model, columns, first)
    inputs = np.broadcast_to(u, (*shape, u.shape[-1]))
    u = np.concatenate([inputs, raised(columns, u.dtype)], -1)
    return u, masked(model, u, y)


def masked(model: Named, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return outputs y, NaN where the factor that stands behind the inputs in u has no value."""
    xp: Any = np
    if isinstance(u, jax.core.Tracer) or isinstance(y, jax.core.Tracer):
        xp = jnp
    missing = xp.isnan(xp.asarray(u)[..., len(model.inputs) :])
    columns = np.full(y.shape[-1], missing.shape[-1])  # the last one: of outputs without a factor
    for j, factor in enumerate(factors_of(model)):
        if factor.number >= 0:
            columns[factor.number] = j
    nothing = xp.zeros((*missing.shape[:-1], 1), bool)
    lacking = xp.take(xp.concatenate([missing, nothing], -1), columns, -1)
    if xp is np and not (lacking & ~np.isnan(np.asarray(y))).any():
        return y
    silenced: np.ndarray = xp.where(lacking, xp.asarray(np.nan, y.dtype), y)
    return silenced


def followed_by(model: Named, u: np.ndarray) -> None:
    """Raise ValueError if the factors that stand behind the inputs in u are no factors."""
    if factors_of(model) and not isinstance(u, jax.core.Tracer):
        _refuse(model, np.asarray(u)[..., len(model.inputs) :], 0)


def _refuse(model: Named, columns: np.ndarray, first: int) -> None:
    """Raise ValueError at the first factor (..., T, q) that is negative or too large."""
    bad = (columns < 0) | (columns > LARGEST)
    if bad.any():
        *_, k, j = np.argwhere(bad)[0].tolist()
        factor, value = factors_of(model)[j], columns[bad][0]
        raise ValueError(
            f"{factor.about}, which must be >= 0 and is no bound beyond {LARGEST:.0e}: at sample {first + k} "
            f"it is {value:g}"
        )


def narrowed(model: Named, u: np.ndarray, dtype: DTypeLike) -> np.ndarray:
    """Return u in a float type: inputs are rounded to nearest, the factors behind them up."""
    m = len(model.inputs)
    if u.dtype == dtype:
        return u
    if not factors_of(model) or u.shape[-1] == m or isinstance(u, jax.core.Tracer):
        return u.astype(dtype)
    u = np.asarray(u)
    return np.concatenate([u[..., :m].astype(dtype), raised(u[..., m:], dtype)], -1)


def raised(x: np.ndarray, dtype: DTypeLike) -> np.ndarray:
    """Return the smallest numbers of a float type that are not below x >= 0: 0 or normal ones, since a kernel
    takes others for 0.
    """
    near = x.astype(dtype)
    near = np.where(near < x, np.nextafter(near, np.asarray(np.inf, dtype)), near)
    tiny = np.finfo(near.dtype).tiny
    return np.where((near > 0) & (near < tiny), tiny, near)


def by_name(model: Named, inputs: np.ndarray) -> dict[str, np.ndarray]:
    """Return {input: (..., T) float64} of inputs (..., T, m)."""
    return dict(zip(model.inputs, np.moveaxis(inputs.astype(np.float64), -1, 0), strict=True))
