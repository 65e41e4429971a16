"""The parameters that can explain a whole recording: a union of boxes, and its hull."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import floor, log10

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.exact.linalg import Number, rational
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.sets.floats import rounding
from jaxbound.text.objects import readable

EMPTY = "FAULT"
"""The status where no parameters are left."""
DIGITS = 4
"""Decimals of the width of a hull to which a narrowed model states its ends."""
NAMED = 8
"""Windows that are kept as those that refuted most."""


@readable
@dataclass(frozen=True, eq=False)
class ParameterSet:
    """Boxes in which all parameters lie that explain a whole recording. `parameters` returns it.

    Fields:
        names: of the q parameters. lo, hi (k, q): the boxes, in the units of the parameters; their union
            holds every value that explains all windows.
        bounds: {name: (lo, hi)} that were searched.
        status: "FAULT", proved: no value is left; "found": boxes are as small as was asked; "budget ended"
            or "interrupted": boxes are larger than that, and hold every value all the same.
        windows: how many windows were asked. evaluated: boxes judged.
        refuted: {sample at which a window ends: boxes that it refuted}, of the windows that refuted most.
        relations: that the recording was judged by.
    """

    names: tuple[str, ...]
    lo: np.ndarray
    hi: np.ndarray
    bounds: Mapping[str, tuple[float, float]]
    status: str
    windows: int
    evaluated: int
    refuted: Mapping[int, int]
    relations: Relations

    def _head(self) -> str:
        return f"ParameterSet: {self.status}, {len(self.lo)} boxes from {self.windows} windows"

    def _rows(self) -> dict[str, str]:
        rows = {}
        for name in self.names:
            lo, hi = self.bounds[name]
            rows[name] = f"none of [{lo:.6g}, {hi:.6g}]"
            if name in self.hull:
                least, most = self.hull[name]
                rows[name] = f"[{least:.6g}, {most:.6g}] of [{lo:.6g}, {hi:.6g}]"
        rows["left"] = f"{100 * self.share:.3g} % of the volume, {self.evaluated} boxes judged"
        if self.refuted:
            sample, boxes = next(iter(self.refuted.items()))
            rows["refuted most"] = f"the window that ends at sample {sample}: {boxes} boxes"
        return rows

    @property
    def hull(self) -> dict[str, tuple[float, float]]:
        """The ends of each parameter over all boxes, {name: (lo, hi)}; empty where no box is left."""
        if not len(self.lo):
            return {}
        ends = zip(self.lo.min(0).tolist(), self.hi.max(0).tolist(), strict=True)
        return dict(zip(self.names, ends, strict=True))

    @property
    def share(self) -> float:
        """The volume of the boxes as a share of what was searched; not rounded."""
        least, most = np.array([self.bounds[name] for name in self.names]).T
        whole = np.where(most > least, most - least, 1.0)
        edges = np.where(most > least, (self.hi - self.lo) / whole, 1.0)
        return min(1.0, float(edges.prod(1).sum()))

    def contains(self, values: Mapping[str, Number]) -> bool:
        """Say whether some box holds a value of each parameter; False is a proof that they explain not all.

        Args:
            values: {name: number}; a float means its shortest decimal, as in a model.

        Raises:
            ValueError: a name that is no parameter's, or a parameter without a number.
        """
        if set(values) != set(self.names):
            raise ValueError(f"the parameters are {list(self.names)}, not {sorted(values)}")
        inside = np.ones(len(self.lo), bool)
        for name, lo, hi in zip(self.names, self.lo.T, self.hi.T, strict=True):
            value = rational(values[name])
            # exactly lo <= value <= hi, since lo and hi are floats
            inside &= (lo <= rounding.round_down(value)) & (rounding.round_up(value) <= hi)
        return bool(inside.any())

    @property
    def model(self) -> LinearSystem:
        """The same model with the bounds of its parameters narrowed to the hull; its provenance says so.

        Raises:
            ValueError: no parameters are left, or the relations are no model's.
        """
        model = self.relations.model
        if not isinstance(model, LinearSystem):
            raise ValueError(
                "a residual has no model: relations.with_bounds({'parameters': ..}) narrows its unknowns to "
                "the hull"
            )
        if not len(self.lo):
            raise ValueError("no parameters are left that explain the recording: there is no model to narrow")
        narrowed = []
        for p in model.uncertainties:
            if p.name in self.hull:
                between = _short_ends(*self.hull[p.name], within=p.between)
                p = Uncertainty(p.name, p.A, p.B, p.C, p.D, p.varying, between)
            narrowed.append(p)
        origin = f"{', '.join(self.names)} narrowed by {self.windows} windows of a recording"
        stated = model.provenance.get("model", "")
        if stated:
            origin = f"{stated}; {origin}"
        return model.replace(uncertainties=narrowed, provenance={**model.provenance, "model": origin})


def _short_ends(lo: float, hi: float, within: tuple[Fraction, Fraction]) -> tuple[Fraction, Fraction]:
    """Return short decimals around an interval, none beyond another one."""
    least, most = Fraction(lo), Fraction(hi)
    tick = Fraction(10) ** (floor(log10(most - least)) - DIGITS)
    below, above = floor(least / tick) * tick, -floor(-most / tick) * tick
    return max(below, min(within[0], least)), min(above, max(within[1], most))
