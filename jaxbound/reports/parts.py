"""Parts of several pages: a model with its bounds, relations, and the versions and device of a result."""

import platform
import time
from collections.abc import Iterator, Mapping
from fractions import Fraction

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.exact.linalg import Vector
from jaxbound.models.modelfile import number_text
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.text.quantities import percent

DIGITS = 12  # of an exact number, beyond which it is rounded


def model_values(model: LinearSystem, bounds: Mapping[str, np.ndarray | Vector]) -> dict[str, object]:
    """Return the values of the macro `model_tables`: of a model with bounds {"tolerance", "noise"} (p,)."""
    return {
        "bounded": ("output", "column", "unit", "offset", *_headed(model)),
        "outputs": [(*_signal(model, "y", i), *_bounds(model, bounds, i)) for i in range(model.p)],
        "inputs": [(*_signal(model, "u", i), *_training(model, i)) for i in range(model.m)],
        "disturbances": [_disturbance(model, j) for j in range(model.g)],
        "parameters": list(map(_parameter_cells, model.uncertainties)),
        "matrices": list(_matrices(model)),
        "unknown": model.d,
        "direct_unknown": model.has_direct_unknown,
        "dt": f"{model.dt:g}",
        "states": ", ".join(model.states),
        "origin": _origin(model, "model"),
    }


def _origin(model: LinearSystem, field: str) -> str:
    return model.provenance.get(field, "origin not stated")


def _headed(model: LinearSystem) -> Iterator[str]:
    """Yield the heads of the columns of bounds, with their origins where there are bounds."""
    for field in ("tolerance", "noise", "resolution"):
        is_stated = field in model.provenance or any(getattr(model, field))
        yield f"{field} ({_origin(model, field)})" if is_stated else field


def _signal(model: LinearSystem, kind: str, i: int) -> tuple[str, str, str, str]:
    """Return the first cells of an input's ("u") or output's ("y") row."""
    name = {"u": model.inputs, "y": model.outputs}[kind][i]
    return name, model.column(name), model.unit(name), _short(model.offset[kind][i])


def _training(model: LinearSystem, i: int) -> tuple[str, str]:
    """Return the cells of where input i was in training, empty where it is not stated."""
    if model.inputs[i] not in model.ranges:
        return "", ""
    lo, hi = model.ranges[model.inputs[i]]
    return _short(lo), _short(hi)


def _bounds(model: LinearSystem, bounds: Mapping[str, np.ndarray | Vector], i: int) -> tuple[str, str, str]:
    """Return the cells of what the sensor of output i may do."""
    tolerance = float(bounds.get("tolerance", model.tolerance)[i])
    noise = float(bounds.get("noise", model.noise)[i])
    noises = f"± {noise:.6g}"
    text = model.times.get(model.outputs[i])
    if text is not None:
        noises = f"{noises} times {text}"
    return f"{percent(tolerance)} of the value", noises, f"± {_short(model.resolution[i])}"


def _disturbance(model: LinearSystem, j: int) -> tuple[str, str, str, str]:
    lo, hi = map(float, model.disturbance[j])
    return f"w{j + 1}", f"{lo:g}", f"{hi:g}", _origin(model, "disturbance")


def _parameter_cells(u: Uncertainty) -> tuple[str, str, str, str, str]:
    lo, hi = (f"{float(bound):.6g}" for bound in u.between)
    acts_on = ", ".join(letter for letter in "ABCD" if getattr(u, letter))
    return u.name, lo, hi, "varies" if u.varying else "is constant", acts_on


def _matrices(model: LinearSystem) -> Iterator[tuple[str, str, list[list[str]]]]:
    """Yield (letter, subscript, rows of texts) of the matrices that are there; D where it is not zero."""
    for name in ("A", "B", "C", "D", "G", "F", "D_v"):
        rows = getattr(model, name)
        if not rows or not rows[0] or (name[0] == "D" and not any(map(any, rows))):
            continue
        letter, _, subscript = name.partition("_")
        yield letter, subscript, [list(map(_short, row)) for row in rows]


def _short(x: Fraction) -> str:
    """Return an exact number as text, rounded where it is long."""
    text = number_text(x)
    if len(text) > DIGITS:
        return f"{float(x):.6g}"
    return text


def computed(
    method: str, rests_on: str, dtype: np.dtype, seconds: Mapping[str, float], evaluated: str = ""
) -> list[tuple[str, str]]:
    """Return the rows on method, versions, device and time. rests_on: the samples that a verdict looks at, in
    words. seconds: {stage: seconds}. evaluated: of a Result.
    """
    import jax

    from jaxbound import __version__

    device = jax.devices()[0]
    versions = (f"jaxbound {__version__}", f"jax {jax.__version__}", f"numpy {np.__version__}")
    kind = " ".join(dict.fromkeys((device.platform, device.device_kind)))
    return [
        ("method", f"{method}, {rests_on}"),
        ("versions", f"{', '.join(versions)}, Python {platform.python_version()}"),
        ("device and numbers", f"{kind}, {dtype.name}{evaluated and f', evaluated by {evaluated}'}"),
        ("seconds", ", ".join(f"{k} {v:.2f}" for k, v in seconds.items()) or "not measured"),
        ("written", time.strftime("%Y-%m-%d %H:%M:%S %z")),
    ]


def distinct_relations(relations: Relations) -> list[int]:
    """Return the indices of the relations that are not merely an earlier copy of another one."""
    if relations.linear is None:
        return list(range(relations.count))
    relations = relations.linear
    model, last = relations.model, {}
    count = (relations.horizon + 1) * model.p
    for j, (h, k) in enumerate(zip(relations.W, relations.K, strict=True)):
        disturbances = h[count : count + model.g * relations.horizon]
        parts = ((h[:count], model.p), (disturbances, model.g), (k, model.m))
        first = min(i // width for row, width in parts for i, x in enumerate(row) if x)
        shifted = [[(i - first * width, x) for i, x in enumerate(row) if x] for row, width in parts]
        last[tuple(map(tuple, shifted))] = j
    return sorted(last.values())
