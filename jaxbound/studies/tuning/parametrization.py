"""Bounds as a vector of positive numbers: which of them move, what they weigh, and how they go back into
relations and model files.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Context, Decimal
from fractions import Fraction
from typing import TypeVar

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.models.system import LinearSystem
from jaxbound.models.window import bounded_sums, changed_sums
from jaxbound.relations.bounds import KINDS, model_bounds
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations

__all__ = ["Moving", "model_with", "moving", "unflatten"]

Flat = TypeVar("Flat", jax.Array, np.ndarray)
Sizes = tuple[tuple[str, int], ...]
"""How many entries bounds of each name have."""

DIGITS = 4  # of a bound in a model file: rounding up costs at most a thousandth
CEILING = 0.999  # of a tolerance while it moves


@dataclass(frozen=True)
class Moving:
    """The bounds that move: `fixed + select @ values`, flat, tolerance, noise, disturbance (lo, hi of each)
    and parameters in this order.

    Fields: names (b,), as a reader would call them; start (b,) > 0; weights (b,), of the total width; most
    (b,), what values stay below; fixed (flat,), select (flat, b): the latter has one 1, or for a lower end
    -1, in each row that moves. sizes: entries of each kind.
    notes: sentences on what does not move. p: outputs.
    """

    names: tuple[str, ...]
    start: np.ndarray
    weights: np.ndarray
    most: np.ndarray
    fixed: np.ndarray
    select: np.ndarray
    sizes: Sizes
    notes: tuple[str, ...]

    def bounds(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Return {name: array} with the moved bounds at `values`."""
        return unflatten(self.fixed + self.select @ np.asarray(values, np.float64), self.sizes)

    def total(self, values: np.ndarray) -> float:
        """Return the weighted sum of the bounds."""
        return float(self.weights @ values)

    def rounded_up(self, values: np.ndarray) -> list[Decimal]:
        """Return values >= these as short decimals."""
        up = Context(prec=DIGITS, rounding=ROUND_CEILING)
        return [up.create_decimal(Decimal(float(v))).normalize() for v in values]


def unflatten(flat: Flat, sizes: Sizes) -> dict[str, Flat]:
    """Return {name: array} from flat bounds; sizes: ((name, entries), ...)."""
    out, at = {}, 0
    for name, count in sizes:
        part = flat[at : at + count]
        out[name], at = part.reshape(-1, 2) if name == "disturbance" else part, at + count
    return out


def moving(
    relations: ParityRelation | UncertainRelations,
    which: str | Iterable[str] | None = None,
    weights: Mapping[str, ArrayLike] | None = None,
) -> Moving:
    """Say which bounds of relations move.

    Args:
        relations: with .bounds and .model. which: names of bounds, or one name; None: all that are not 0.
        weights: {name: a number or one per entry} of the total width; None, and names left out: 1 / the
            starting bound.

    Raises:
        ValueError: an unknown name, nothing that could move, a disturbance that excludes 0, weights that are
            not > 0.
    """
    bounds, model = relations.bounds, relations.model
    which = tuple(bounds) if which is None else (which,) if isinstance(which, str) else tuple(which)
    for name in (*which, *(weights or {})):
        if name not in bounds:
            raise ValueError(f"there is no bound {name!r} to move: this model has {', '.join(bounds)}")
    who = {"output": model.outputs, "disturbance": tuple(f"w{j + 1}" for j in range(model.g))}
    who["parameter"] = tuple(u.name for u in model.uncertainties)
    who["average"] = tuple(bounded.text for bounded in bounded_sums(model))
    names, start, scale, most, still, columns = [], [], [], [], [], []
    fixed: list[float] = []
    sizes = tuple((name, np.size(b)) for name, b in bounds.items())
    for name, _ in sizes:
        own = np.asarray(bounds[name], np.float64)
        given = None if weights is None or name not in weights else _weights(name, weights[name], own.shape)
        for i, signal in enumerate(who[KINDS[name]]):
            entry = own[i : i + 1] if name != "disturbance" else own[i]
            at, free = len(fixed), name in which
            if free and len(entry) == 2 and not entry[0] <= 0 <= entry[1]:
                raise ValueError(
                    f"{name} of {signal!r} lies in [{entry[0]:g}, {entry[1]:g}], away from 0, and cannot be "
                    f"scaled: take its "
                    "middle out of the model (as an input or offset), or leave it out of bounds="
                )
            fixed += [0.0] * len(entry) if free else list(entry)
            if not free:
                continue
            if not entry.any():
                still.append(f"{name} of {signal}")
            ends: list[tuple[int | None, float, str]] = (
                [(0, entry[0], "")]
                if len(entry) == 1
                else [(0, -entry[0], "lower end of "), (1, entry[1], "upper end of ")]
            )
            if len(entry) == 2 and -entry[0] == entry[1]:  # the ends of a symmetric bound move together
                ends = [(None, entry[1], "")]
            for end, value, side in ends:
                if value > 0:
                    names.append(f"{side}{name} of {signal}")
                    start.append(value)
                    per_end = given is not None and given.ndim == 2
                    weight = (
                        1 / value
                        if given is None
                        else given[i]
                        if end is None or not per_end
                        else given[i, end]
                    )
                    scale.append(
                        float(np.sum(weight)) * (0.5 if side and not per_end else 1)
                    )  # of half the width
                    most.append(CEILING if name == "tolerance" else np.inf)
                    columns.append(
                        [
                            (at + e, -1.0 if len(entry) == 2 and e == 0 else 1.0)
                            for e in ((0, 1) if end is None else (end,))
                        ]
                    )
    if not names:
        listed = " and ".join(which) or "nothing"
        raise ValueError(
            f"no bound can move: every entry of {listed} is 0, and 0 times a factor stays 0. Start from a "
            f"rough guess > 0"
        )
    select = np.zeros((len(fixed), len(names)))
    for b, entries in enumerate(columns):
        for row, sign in entries:
            select[row, b] = sign
    notes = (
        (f"{', '.join(still)} {'is' if len(still) == 1 else 'are'} 0 and stay{'s' * (len(still) == 1)} 0",)
        if still
        else ()
    )
    first, weight_of, top, rest = (np.array(x, np.float64) for x in (start, scale, most, fixed))
    return Moving(tuple(names), first, weight_of, top, rest, select, sizes, notes)


def _weights(name: str, given: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    try:
        given = np.broadcast_to(
            np.asarray(given, np.float64), shape if np.ndim(given) == len(shape) else shape[:1]
        )
    except ValueError:
        raise ValueError(
            f"the weights of {name} need one number, or one per entry {shape}: their shape is "
            f"{np.shape(given)}"
        ) from None
    if not ((given > 0) & (given < np.inf)).all():
        raise ValueError(f"weights must be > 0 and finite: those of {name} are {given.tolist()}")
    return given


def model_with(
    relations: ParityRelation | UncertainRelations, moved: Moving, values: Sequence[Decimal], source: str
) -> LinearSystem:
    """Return the model with the bounds of the relations, those that moved at `values` (Decimals), and their
    horizon.

    Args:
        relations: before tuning. moved: their Moving. source: provenance of every kind that moved.

    Raises:
        ValueError: a tolerance that would reach 1.
    """
    model, old = relations.model, model_bounds(relations.model)
    provenance, fractions, at = dict(model.provenance), [Fraction(v) for v in values], 0
    changes: dict[str, object] = {"provenance": provenance} | getattr(
        relations, "window", {"horizon": relations.horizon}
    )
    decimals = {
        "tolerance": model.tolerance,
        "noise": model.noise,
        "disturbance": [x for pair in model.disturbance for x in pair],
        "average": [bounded.bound for bounded in bounded_sums(model)],
    }
    for kind, count in moved.sizes:
        now, before = np.ravel(relations.bounds[kind]), np.ravel(old[kind])
        exact = list(
            decimals.get(kind, [Fraction(1)] * count)
        )  # a bound that nobody changed keeps the decimal that the user wrote
        exact = [
            x if a == b else Fraction(repr(float(a))) for x, a, b in zip(exact, now, before, strict=True)
        ]
        rows, at = moved.select[at : at + count], at + count
        for i, b in np.argwhere(rows):
            exact[i] = int(rows[i, b]) * fractions[b]
        if kind == "disturbance":
            changes[kind] = model.G, tuple(zip(exact[::2], exact[1::2], strict=True))
        elif kind == "average":
            changes |= changed_sums(model, exact)
        elif kind == "parameters":
            pairs = zip(model.uncertainties, exact, strict=True)
            changes["uncertainties"] = tuple(
                replace(u, between=(u.centre - k * u.radius, u.centre + k * u.radius)) for u, k in pairs
            )
        else:
            changes[kind] = exact
        if rows.any() and kind not in ("parameters", "average"):
            provenance[kind] = source
    return model.replace(**changes)
