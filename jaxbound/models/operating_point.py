"""A model with factors on its noise at one operating point: a model without them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from jaxbound.exact.linalg import Number
from jaxbound.models.numbers import number
from jaxbound.models.system import LinearSystem
from jaxbound.text.names import listed


def at_factors(model: LinearSystem, factors: Mapping[str, Number] | None) -> LinearSystem:
    """Return a model with its noise at one value of each of its factors, and without them.

    Args:
        factors: {output: value >= 0}, one for each output that has a factor; None: no output has one.

    Raises:
        ValueError: a factor that is missing, negative, or of an output that has none.
    """
    stated: dict[str, Any] = dict(factors or {})
    named = list(model.times)
    if sorted(stated) != sorted(named):
        raise ValueError(
            f"the model has factors on the noise of {listed(named) or 'no output'}: give factors, the "
            f"largest value of each, for these and no others"
        )
    noise = list(model.noise)
    for factor in model.factors:
        value = number(f"factor of {factor.output!r}", stated[factor.output])
        if value < 0:
            raise ValueError(f"the factor on the noise of {factor.output!r} must be >= 0, not {value}")
        noise[factor.number] *= value
        stated[factor.output] = value
    averages = [replace(one, bound=stated.get(one.signal, 1) * one.bound) for one in model.averages]
    return model.replace(noise=noise, averages=averages, times=None)
