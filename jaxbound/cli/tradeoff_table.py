"""The faults of --see, and the trade-off between bounds and faults that are seen, as table and JSON."""

import math
from collections.abc import Iterator
from typing import SupportsFloat

from jaxbound.cli.names import parted, unquoted
from jaxbound.models.faults import Fault
from jaxbound.models.testmodels import model_of
from jaxbound.studies.identification.fit_result import Fitted
from jaxbound.text.quantities import decimal


def wanted_faults(text: str) -> tuple[Fault, ...]:
    """Return the faults of --see.

    Raises:
        ValueError: an entry that is not signal:kind:size.

    Example:
        >>> wanted_faults("T1:bias:2, `flow, cold`:drift:0.05")[1].signal
        'flow, cold'
    """
    faults = []
    for entry in parted(text):
        if not entry:
            continue
        parts = entry.rsplit(":", 2)
        try:
            signal, kind, size = parts
            faults.append(Fault(unquoted(signal), kind, decimal(size)))
        except ValueError as e:
            why = "needs signal:kind:size, like T1:bias:2"
            if str(e).startswith(("kind of", "size of")):
                why = str(e)
            raise ValueError(f"{entry}: {why}") from None
    return tuple(faults)


def disturbance_rows(model: Fitted) -> Iterator[tuple[str, str]]:
    """Yield lines on the disturbances of a fit and on those that it looked at, the chosen one marked."""
    if model.check.tradeoff:
        bounds = [f"w{j + 1} {float(high):.3g}" for j, (_, high) in enumerate(_disturbance(model))]
        text = "none: bounds of the sensors alone see the smallest faults"
        if bounds:
            text = f"{', '.join(bounds)} a sample"
        yield "disturbances", f"{text}; shares of the noise below:"
    for choice in model.check.tradeoff:
        star = ""
        if choice.chosen:
            star = "* "
        sizes = []
        for fault, size in choice.sizes.items():
            sizes.append(f"{fault} {_size(size)}")
        noise = [f"{name} {bound:.3g}" for name, bound in choice.noise.items()]
        yield (
            f"{star}process {choice.process:g}, drift {choice.drift:g}",
            f"{choice.method}: factor {choice.factor:.3g}, safety {choice.safety:.4g}, "
            f"noise {', '.join(noise)}; sees {', '.join(sizes)}",
        )


def _disturbance(model: Fitted) -> tuple[tuple[SupportsFloat, SupportsFloat], ...]:
    """Return the bounds of disturbances of a fit, or of a test of its bank."""
    found = model.disturbance
    for test in model.tests:
        found = found or model_of(model, test).disturbance
    return found


def _size(size: float) -> str:
    if math.isinf(size):
        return "never"
    return f"from {size:.3g}"
