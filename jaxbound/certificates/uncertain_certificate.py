"""The certificate of one verdict on a model with uncertain parameters, in exact rational arithmetic.

FAULT: a tree of boxes of the parameters, a leaf for each with a direction h over the relations: 0 is not in
the range of h p over it (`exact_polynomials`). Mostly the whole box is the only leaf. CONSISTENT: parameters
at which what is left, a linear window, is explained by a first state and noise. Floats only propose boxes,
directions and points.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

import numpy as np

from jaxbound.certificates.exact_polynomials import FixedWindow, PolynomialWindow, polynomial_window
from jaxbound.certificates.exact_window import DIGITS, ExactWindow, rounded_witness
from jaxbound.certificates.interface import Index, Sample, WindowCertificate, certify, nothing_to_explain
from jaxbound.certificates.witness import Numbers, Witnessed, rows_of
from jaxbound.consistency import parametric_windows
from jaxbound.exact.linalg import Vector, identity
from jaxbound.relations.polynomial import PolynomialMatrix
from jaxbound.relations.sentence import main_terms
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.relations.uncertain_window import Variable
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips import polynomials
from jaxbound.text.objects import readable

__all__ = ["Leaf", "UncertainCertificate"]

BOXES = 2000
"""Boxes that the proof of one FAULT may look at."""


@dataclass(frozen=True)
class Leaf:
    """A box of the parameters that explains nothing.

    Fields: lo, hi: the box, in half-widths of the parameters; direction: the numbers h of a combination of
    the relations; low, high: what holds all its values over the box, without 0; vertices: whether these are
    the extremes over all vertices, or bounds of each monomial.
    """

    lo: Vector
    hi: Vector
    direction: Vector
    low: Fraction
    high: Fraction
    vertices: bool


@dataclass(frozen=True)
class Cut:
    """Two boxes instead of one: v_variable <= at, and the rest; each part is a Leaf or a Cut."""

    variable: int
    at: Fraction
    below: "Leaf | Cut"
    above: "Leaf | Cut"


Tree: TypeAlias = Leaf | Cut
Explained: TypeAlias = tuple[FixedWindow, Vector]
"""A window at chosen parameters, and unknowns that explain it."""


@readable
@dataclass(frozen=True, eq=False)
class UncertainCertificate(Witnessed, WindowCertificate):
    """A proof of the verdict of a window with uncertain parameters; every number is an exact Fraction.

    Fields:
        status: of the window, as detected. at: the index at which it ends, a tuple.
        relations: the UncertainRelations that the proof is about: for a window with missing samples those
            without them.
        proof: for FAULT a Leaf, or a Cut with more of them: no parameters and errors within bounds explain
            the window; else None.
        window: the samples and bounds; for CONSISTENT at the parameters of the witness. z: its unknowns, or
            None.
        bounds: of the parameters, in half-widths.
        state, outputs, disturbances, unknown_inputs, inputs: of the witness, as in `Certificate`.
        errors, candidates: empty, the smallest errors of single sensors are not known here.
    """

    status: Status
    at: Index
    relations: UncertainRelations
    proof: Tree | None
    window: ExactWindow
    z: Vector | None
    bounds: Vector
    errors: ClassVar[Mapping[str, Fraction | float]] = MappingProxyType({})
    candidates: ClassVar[tuple[str, ...]] = ()

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what the exact numbers say, also where the method of the detection left it
        UNDECIDED.
        """
        if self.proof is None:
            return Status.CONSISTENT
        return Status.FAULT

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """The Leaf of each part of the parameters' box, () for CONSISTENT."""
        if self.proof is None:
            return ()
        return tuple(_leaves(self.proof))

    @property
    def parameters(self) -> dict[Variable, Fraction] | None:
        """{(name, sample of the window, or None for a constant one): value in the unit of `between`} of the
        witness, or None.
        """
        if self.z is None:
            return None
        by_name = {u.name: u for u in self.relations.model.uncertainties}
        values = {}
        for variable, v in self._values().items():
            parameter = by_name[variable[0]]
            values[variable] = parameter.centre + parameter.radius * v
        return values

    def _values(self) -> dict[Variable, Fraction]:
        """Return the variables of the relations at the witness."""
        if not isinstance(self.window, FixedWindow):
            return {}
        return dict(zip(self.relations.variables, self.window.variables, strict=True))

    @property
    def relation(self) -> str:
        """The combination of relations that is violated, as text; "" where it differs from part to part of
        the box.
        """
        if len(self.leaves) != 1:
            return ""
        lines = self.relations.text().split("\n")
        if len(lines) == 1:
            return lines[0].split(": ", 1)[1]
        return _combination(self.leaves[0].direction)

    def __str__(self) -> str:
        """Return one sentence."""
        if self.z is not None:
            values = [f"{self._variable(v)} = {float(x):.6g}" for v, x in (self.parameters or {}).items()]
            state = [f"{float(x):.6g}" for x in self.state or ()]
            return f"explained by {', '.join(values)} and the first state ({', '.join(state)})"
        if len(self.leaves) == 1:
            (leaf,) = self.leaves
            return (
                f"{main_terms(self.relation)} cannot hold: its left side is in [{float(leaf.low):.6g}, "
                f"{float(leaf.high):.6g}]"
            )
        return (
            f"no parameters within their bounds explain it: each of {len(self.leaves)} parts of their box "
            f"contradicts the relations"
        )

    def _variable(self, variable: Variable) -> str:
        """Return a variable as a reader would write it: "a[k-1]", of a constant parameter its name."""
        (name, lag), s = variable, self.relations.horizon
        if lag is None:
            return name
        if lag == s:
            return f"{name}[k]"
        return f"{name}[k-{s - lag}]"

    def to_dict(
        self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True
    ) -> dict[str, Any]:
        """Return everything that a check needs, ready for JSON: as `Certificate.to_dict`, whose `errors` are
        not known here.

        numbers.uncertainties: what each parameter multiplies, its bound, whether it varies.
        numbers.variables: the parameter and the sample (null: constant) that each variable v is. A polynomial
        is a list of [coefficient, number of a variable, ..], with a variable squared twice.
        """
        r, parameters = self.relations, self.window.model.uncertainties
        names = [parameter.name for parameter in parameters]
        variables = _variables(r)
        number = [Fraction(variables.index(v)) for v in r.variables]
        numbers: Numbers = {"uncertainties": [], "variables": [], "relations": [], "proof": None}
        for parameter, bound in zip(parameters, self.bounds, strict=True):
            change: Numbers = {letter: parameter.on(letter) for letter in "ABCD"}
            change |= {"bound": bound, "varying": Fraction(int(parameter.varying))}
            numbers["uncertainties"].append(change)
        for name, lag in variables:
            numbers["variables"].append([Fraction(names.index(name)), None])
            if lag is not None:
                numbers["variables"][-1][1] = Fraction(lag)
        if self.proof is not None:
            numbers["relations"] = [self._polynomial_dict(k, number) for k in range(r.count)]
            numbers["proof"] = _tree(self.proof, number)
        numbers["parameters"] = None
        if self.z is not None:
            chosen = self._values()
            numbers["parameters"] = [chosen.get(v, Fraction(0)) for v in variables]
        return self._document(self.proves, numbers, times, sample)

    def _polynomial_dict(self, k: int, number: Sequence[Fraction]) -> Numbers:
        """Return the polynomials of one relation on the outputs, disturbances and inputs of each sample."""
        r, model = self.relations, self.relations.model
        on_rows = [_flat(r.N, k, j, number) for j in range(r.N.columns)]
        on_inputs = [_flat(r.K, k, j, number) for j in range(r.K.columns)]
        readings = (r.horizon + 1) * model.p
        nothing: list[Fraction] = []
        return {
            "h": rows_of(on_rows[:readings], model.p),
            "g": self._every_sample(on_rows[readings:], [nothing] * model.g),
            "k": self._every_sample(on_inputs, [nothing] * model.m),
        }


def _variables(relations: UncertainRelations) -> list[Variable]:
    """Return every variable of the parameters, those that do not matter to the relations too."""
    variables: list[Variable] = []
    for parameter in relations.model.uncertainties:
        if parameter.varying:
            variables += [(parameter.name, lag) for lag in range(relations.horizon + 1)]
        else:
            variables.append((parameter.name, None))
    return variables


def _combination(direction: Vector) -> str:
    """Return "r1 - 0.5 r2 = 0" for the multipliers of relations."""
    text = ""
    for k, x in enumerate(direction):
        if not x:
            continue
        sign = "+"
        if x < 0:
            sign = "-"
        size = f"{float(abs(x)):.6g} "
        if abs(x) == 1:
            size = ""
        text += f" {sign} {size}r{k + 1}"
    text = text.removeprefix(" + ")
    if text.startswith(" - "):
        text = "-" + text[3:]
    return text + " = 0"


@certify.register
def _(
    relations: UncertainRelations,
    u: np.ndarray,
    y: np.ndarray,
    method: str = "joint",
    status: Status | None = None,
    at: Index | None = None,
) -> UncertainCertificate:
    if at is None:
        at = (relations.horizon,)
    if np.isnan(y).all():
        raise nothing_to_explain(at)
    cases = list(parametric_windows.cases(relations, u, y, np.zeros(1, int)))
    if not cases:
        raise nothing_to_explain(at)
    case, _ = cases[0]  # without the samples that the window lacks
    assert case is not None  # a single pattern of missing samples
    p = polynomial_window(case, u, y)
    budget = 1
    if status in (Status.FAULT, Status.CONSISTENT):
        budget = BOXES
    proof, explained = _proof(p, u, y, status, budget)
    window: ExactWindow = p.window
    z = None
    if explained is not None:
        window, z = explained
    elif proof is None:
        raise NotImplementedError(
            f"neither a contradiction nor a behaviour is at hand for window {at[-1]}; a larger budget= of "
            f"boxes goes on where detect stopped"
        )
    if status is None:
        status = Status.CONSISTENT
        if proof is not None:
            status = Status.FAULT
    return UncertainCertificate(Status(status), at, case, proof, window, z, p.bounds)


def _proof(
    p: PolynomialWindow, u: np.ndarray, y: np.ndarray, status: Status | None, budget: int
) -> tuple[Tree | None, Explained | None]:
    """Return (a proof of FAULT, None), or (None, parameters and unknowns that explain the window), or (None,
    None) if neither was found.

    Each relation alone over the whole box comes first, which is the shortest proof, and the zero of a single
    one; then the boxes, directions and the point that `bisected` found, in fractions.
    """
    r, lo = p.relations, tuple(-x for x in p.size)
    few = polynomials.multiaffine(r.exponents) and len(p.size) <= parametric_windows.VERTICES
    if status != Status.CONSISTENT:
        for h in identity(r.count):
            leaf = _leaf(p, h, lo, p.size, few)
            if leaf is not None:
                return leaf, None
    if status != Status.FAULT and r.count == 1 and few:
        explained = _explained(p, p.zero())
        if explained is not None:
            return None, explained
    reading = r.reading(y.dtype)
    samples = np.nan_to_num(u[: reading.lags])[..., None], np.nan_to_num(y)[..., None]
    found, leaves, points = parametric_windows.bisected(reading, samples, status != Status.FAULT, budget)
    if found[0] == Status.FAULT:
        return _tree_of(p, leaves), None
    if status == Status.FAULT:
        return None, None
    for start in (points, 0.5 * points, 0 * points):
        near = parametric_windows.refined(reading, samples, start)[: len(p.size), 0]
        explained = _explained(p, tuple(Fraction(x) * s for x, s in zip(near.tolist(), p.size, strict=True)))
        if explained is not None:
            return None, explained
    return None, None


def _tree_of(p: PolynomialWindow, leaves: parametric_windows.Leaves) -> Tree | None:
    """Return the proof that leaves, whose boxes fill one box, are; None where one of them proves nothing."""
    lo, hi = leaves.lo.min(1), leaves.hi.max(1)
    if len(leaves.owner) == 1:
        ends = [[Fraction(float(x)) * s for x, s in zip(end, p.size, strict=True)] for end in (lo, hi)]
        return _directed(p, leaves.h[:, 0], *map(tuple, ends))
    middle = 0.5 * (lo + hi)
    for i, at in enumerate(middle):
        below, above = leaves.hi[i] <= at, leaves.lo[i] >= at
        if not (below | above).all():
            continue
        first = _tree_of(p, leaves.chosen(below))
        rest = _tree_of(p, leaves.chosen(above))
        if first is None or rest is None:
            return None
        return Cut(i, Fraction(float(at)) * p.size[i], first, rest)
    raise AssertionError("boxes of a bisection are halves of halves")


def _leaf(p: PolynomialWindow, h: Vector, lo: Vector, hi: Vector, few: bool = False) -> Leaf | None:
    """Return the Leaf of a direction, or None if it proves nothing. few: the vertices may be tried."""
    ways = [False]
    if few:
        ways.append(True)
    for vertices in ways:
        low, high = p.spread(h, lo, hi, vertices)
        if low > 0 or high < 0:
            return Leaf(lo, hi, h, low, high, vertices)
    return None


def _directed(p: PolynomialWindow, h: np.ndarray, lo: Vector, hi: Vector) -> Leaf | None:
    """Return the Leaf of a direction in floats with as few digits as prove it, or None."""
    top = np.abs(h).max()
    if not 0 < top < np.inf:
        return None
    for digits in (2, *DIGITS):
        short = tuple(Fraction(f"{x:.{digits}g}") for x in (h / top).tolist())
        leaf = _leaf(p, short, lo, hi)
        if leaf is not None:
            return leaf
    return None


def _explained(p: PolynomialWindow, v: Vector) -> Explained | None:
    """Return (FixedWindow, z) of parameters with as few digits as explain the window, or None."""
    candidates = [tuple(Fraction(f"{float(x):.{digits}g}") for x in v) for digits in DIGITS]
    for candidate in (*candidates, v):
        inside = [max(-size, min(x, size)) for x, size in zip(candidate, p.size, strict=True)]
        window = p.at(tuple(inside))
        best = window.solve()
        if best.factor <= 1:
            return window, rounded_witness(window, best.z)
    return None


def _leaves(proof: Tree) -> Iterator[Leaf]:
    if isinstance(proof, Leaf):
        yield proof
    else:
        yield from _leaves(proof.below)
        yield from _leaves(proof.above)


def _tree(proof: Tree, number: Sequence[Fraction]) -> Numbers:
    """Return a proof as a tree of numbers."""
    if isinstance(proof, Leaf):
        return {
            "direction": proof.direction,
            "vertices": Fraction(int(proof.vertices)),
            "low": proof.low,
            "high": proof.high,
        }
    return {
        "variable": number[proof.variable],
        "at": proof.at,
        "below": _tree(proof.below, number),
        "above": _tree(proof.above, number),
    }


def _flat(matrix: PolynomialMatrix, k: int, j: int, number: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the polynomial of one entry as a list of [coefficient, number of a variable, ..]."""
    terms = []
    for alpha, part in matrix.terms.items():
        if (k, j) not in part:
            continue
        term = [part[k, j]]
        for i, exponent in enumerate(alpha):
            term += [number[i]] * exponent
        terms.append(term)
    return terms
