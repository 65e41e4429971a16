"""Bounds as a vector of positive numbers: which of them move, what they weigh, and how they go back into
relations and model files.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, Context, Decimal
from fractions import Fraction
from typing import Any, NamedTuple, TypeAlias, TypeVar

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.arguments import listed_argument, table_argument
from jaxbound.models.system import LinearSystem
from jaxbound.relations.bounds import KINDS, model_bounds
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations

Flat = TypeVar("Flat", jax.Array, np.ndarray)
Tunable: TypeAlias = ParityRelation | UncertainRelations | SetObserver[Any]
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

    @property
    def rows(self) -> dict[str, slice]:
        """{name: slice of the flat bounds}."""
        rows, at = {}, 0
        for name, count in self.sizes:
            rows[name] = slice(at, at + count)
            at += count
        return rows

    def total(self, values: np.ndarray) -> float:
        """Return the weighted sum of the bounds."""
        return float(self.weights @ values)

    def rounded_up(self, values: np.ndarray) -> list[Decimal]:
        """Return values >= these as short decimals."""
        up = Context(prec=DIGITS, rounding=ROUND_CEILING)
        return [up.create_decimal(Decimal(float(v))).normalize() for v in values]


def unflatten(flat: Flat, sizes: Sizes) -> dict[str, Flat]:
    """Return {name: array} from flat bounds; sizes: ((name, entries), ...)."""
    bounds, at = {}, 0
    for name, count in sizes:
        part = flat[at : at + count]
        bounds[name] = part.reshape(-1, 2) if name == "disturbance" else part
        at += count
    return bounds


def moving(
    relations: Tunable,
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
    bounds, model = relations.bounds, tuned_model(relations)
    chosen = _chosen(which, bounds)
    for name in (*chosen, *table_argument("weights", weights, "{'noise': 2}")):
        if name not in bounds:
            raise ValueError(f"there is no bound {name!r} to move: this model has {', '.join(bounds)}")
    owners = _owners(model)
    fixed: list[float] = []
    still: list[str] = []
    names: list[str] = []
    ends: list[_End] = []
    weighed: list[float] = []
    most: list[float] = []
    for name, own in bounds.items():
        entries = np.asarray(own, np.float64)
        stated = None
        if weights is not None and name in weights:
            stated = _entry_weights(name, weights[name], entries.shape)
        for i, signal in enumerate(owners[KINDS[name]]):
            entry, first = np.atleast_1d(entries[i]), len(fixed)
            if name not in chosen:
                fixed += entry.tolist()
                continue
            fixed += [0.0] * len(entry)
            label = f"{name} of {signal}"
            if not entry.any():
                still.append(label)
            for end in _ends(entry, name, signal):
                if end.value > 0:
                    names.append(f"{end.side}{label}")
                    ends.append(end._replace(first=first))
                    weighed.append(_weight(end, None if stated is None else stated[i]))
                    most.append(CEILING if name == "tolerance" else np.inf)
    if not names:
        listed = " and ".join(chosen) or "nothing"
        raise ValueError(
            f"no bound can move: every entry of {listed} is 0, and 0 times a factor stays 0. Start from a "
            f"rough guess > 0"
        )
    select = np.zeros((len(fixed), len(ends)))
    for column, end in enumerate(ends):
        for number, sign in end.entries:
            select[end.first + number, column] = sign
    return Moving(
        names=tuple(names),
        start=np.array([end.value for end in ends]),
        weights=np.array(weighed),
        most=np.array(most),
        fixed=np.array(fixed),
        select=select,
        sizes=tuple((name, np.size(own)) for name, own in bounds.items()),
        notes=_notes(still),
    )


class _End(NamedTuple):
    """A number of a bound: its value; entries: (number, sign) of the entries that it stands for; side: the
    end of a disturbance, in words; first: the number of the first entry among all bounds.
    """

    value: float
    entries: tuple[tuple[int, float], ...]
    side: str = ""
    first: int = 0


def _chosen(which: str | Iterable[str] | None, bounds: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the bounds that move."""
    if which is None:
        return tuple(bounds)
    if isinstance(which, str):
        return (which,)
    return listed_argument("bounds", which, "['noise', 'disturbance']")


def _owners(model: LinearSystem) -> dict[str, tuple[str, ...]]:
    """Return the names of what has bounds, by their kind."""
    return {
        "output": model.outputs,
        "disturbance": tuple(f"w{j + 1}" for j in range(model.g)),
        "parameter": tuple(u.name for u in model.uncertainties),
        "average": tuple(bounded.text for bounded in model.averages),
    }


def _ends(entry: np.ndarray, name: str, signal: str) -> list[_End]:
    """Return the numbers of a bound: one, or the two ends of a disturbance that is not symmetric."""
    if len(entry) == 1:
        return [_End(float(entry[0]), ((0, 1.0),))]
    low, high = entry.tolist()
    if not low <= 0 <= high:
        raise ValueError(
            f"{name} of {signal!r} lies in [{low:g}, {high:g}], away from 0, and cannot be scaled: take its "
            "middle out of the model (as an input or offset), or leave it out of bounds="
        )
    if -low == high:  # both move together
        return [_End(high, ((0, -1.0), (1, 1.0)))]
    return [_End(-low, ((0, -1.0),), "lower end of "), _End(high, ((1, 1.0),), "upper end of ")]


def _weight(end: _End, stated: np.ndarray | None) -> float:
    """Return the weight of a number in the total width. stated: of its entry, or of both of its ends."""
    if stated is not None and stated.ndim:
        return float(sum(stated[number] for number, _ in end.entries))
    weight = 1 / end.value if stated is None else float(stated)
    return 0.5 * weight if end.side else weight  # one end is half of the width


def _notes(still: list[str]) -> tuple[str, ...]:
    """Return the sentence on bounds that are 0, if there are some."""
    if not still:
        return ()
    if len(still) == 1:
        return (f"{still[0]} is 0 and stays 0",)
    return (f"{', '.join(still)} are 0 and stay 0",)


def _entry_weights(name: str, given: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return the weights of a bound, one an entry, or one an end of each, checked."""
    try:
        stated = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"weights must be numbers, like {{'noise': 2}}, not { {name: given} }") from None
    try:
        weights = np.broadcast_to(stated, shape if stated.ndim == len(shape) else shape[:1])
    except ValueError:
        raise ValueError(
            f"the weights of {name} need one number, or one per entry {shape}: their shape is {stated.shape}"
        ) from None
    if not ((weights > 0) & (weights < np.inf)).all():
        raise ValueError(f"weights must be > 0 and finite: those of {name} are {weights.tolist()}")
    return weights


def model_with(
    relations: Tunable,
    moved: Moving,
    values: Sequence[Decimal],
    source: str,
    left_out: Fraction | None = None,
) -> LinearSystem:
    """Return the model with the bounds of the relations, those that moved at `values` (Decimals), and their
    horizon.

    Args:
        relations: before tuning. moved: their Moving. source: provenance of every kind that moved. left_out:
            of the model, the factor that these bounds hold.

    Raises:
        ValueError: a tolerance that would reach 1.
    """
    model = tuned_model(relations)
    old = model_bounds(model)
    provenance, at = dict(model.provenance), 0
    changes: dict[str, object] = {"provenance": provenance, "left_out": left_out, **relations.span}
    for kind, count in moved.sizes:
        rows, at = moved.select[at : at + count], at + count
        exact = _decimals(model, kind, np.ravel(relations.bounds[kind]), np.ravel(old[kind]))
        for i, b in np.argwhere(rows):
            exact[i] = int(rows[i, b]) * Fraction(values[b])
        changes |= _changes(model, kind, exact)
        if rows.any() and kind not in ("parameters", "average"):
            provenance[kind] = source
    return model.replace(**changes)


def tuned_model(relations: Tunable) -> LinearSystem:
    """Return the model of relations or of an observer."""
    model = relations.model
    assert isinstance(model, LinearSystem), "tune refuses others at its door"
    return model


def _decimals(model: LinearSystem, kind: str, now: np.ndarray, before: np.ndarray) -> list[Fraction]:
    """Return bounds exactly: one that nobody changed keeps the decimal that the user wrote.

    Args:
        now, before: the bounds of relations, and of the model, as floats.
    """
    stated = {
        "tolerance": list(model.tolerance),
        "noise": list(model.noise),
        "disturbance": [end for pair in model.disturbance for end in pair],
        "average": [bounded.bound for bounded in model.averages],
    }
    exact = stated.get(kind, [Fraction(1)] * len(now))
    for i in np.flatnonzero(now != before):
        exact[i] = Fraction(repr(float(now[i])))
    return exact


def _changes(model: LinearSystem, kind: str, exact: list[Fraction]) -> dict[str, object]:
    """Return the changes of `LinearSystem.replace` that give a model other bounds of a kind."""
    if kind == "disturbance":
        return {kind: (model.G, tuple(zip(exact[::2], exact[1::2], strict=True)))}
    if kind == "average":
        pairs = zip(model.averages, exact, strict=True)
        return {"averages": [replace(average, bound=bound) for average, bound in pairs]}
    if kind != "parameters":
        return {kind: exact}
    parameters = []
    for u, factor in zip(model.uncertainties, exact, strict=True):
        between = u.centre - factor * u.radius, u.centre + factor * u.radius
        parameters.append(replace(u, between=between))
    return {"uncertainties": tuple(parameters)}
