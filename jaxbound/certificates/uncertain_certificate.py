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
PART = parametric_windows.SEARCHED


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
_Place: TypeAlias = list[Any]
"""A part of a proof that is being built: [], [Leaf] or [variable, at, place, place]."""
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
    if method == "paving" or status == Status.FAULT:
        budget = BOXES
    proof, explained = _proof(p, u, y, status, budget)
    window: ExactWindow = p.window
    z = None
    if explained is not None:
        window, z = explained
    elif proof is None:
        hint = "; method 'paving' goes on where this one stops"
        if method == "paving":
            hint = ""
        raise NotImplementedError(
            f"neither a contradiction nor a behaviour is at hand for window {at[-1]}{hint}"
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

    The cheapest ways come first: each relation alone over the whole box, the zero of a single one, then the
    direction and the point that floats propose, then a bisection.
    """
    count, lo = p.relations.count, tuple(-x for x in p.size)
    few = polynomials.multiaffine(p.relations.exponents) and len(p.size) <= parametric_windows.VERTICES
    fault, consistent = status != Status.CONSISTENT, status != Status.FAULT
    if fault:
        for h in identity(count):
            leaf = _leaf(p, h, lo, p.size, few)
            if leaf is not None:
                return leaf, None
    if consistent and count == 1 and few:
        explained = _explained(p, p.zero_between(*p.ends()))
        if explained is not None:
            return None, explained
    boxes = _Boxes(p, u, y)
    start, direction = boxes.whole()
    if fault:
        leaf = _directed(p, direction, lo, p.size)
        if leaf is not None:
            return leaf, None
    if consistent:
        explained = boxes.point(start)
        if explained is not None:
            return None, explained
    if budget <= 1:
        return None, None
    return boxes.cut(budget, fault, consistent)


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


def _explained(p: PolynomialWindow, v: Vector | None) -> Explained | None:
    """Return (FixedWindow, z) of parameters with as few digits as explain the window, or None."""
    if v is None:
        return None
    candidates = [tuple(Fraction(f"{float(x):.{digits}g}") for x in v) for digits in DIGITS]
    for candidate in (*candidates, v):
        inside = [max(-size, min(x, size)) for x, size in zip(candidate, p.size, strict=True)]
        window = p.at(tuple(inside))
        best = window.solve()
        if best.factor <= 1:
            return window, rounded_witness(window, best.z)
    return None


class _Boxes:
    """Proposals of floats for boxes of the parameters of one window, by the kernels of the detection."""

    def __init__(self, p: PolynomialWindow, u: np.ndarray, y: np.ndarray) -> None:
        self.p, self.test = p, p.relations.reading(y.dtype)
        inputs, outputs = np.nan_to_num(u[: self.test.window.lags]), np.nan_to_num(y)
        self.samples = inputs[..., None], outputs[..., None]

    def terms(self, count: int) -> Any:  # arrays of a kernel
        """Return the terms of the window, so many times."""
        u, y = (np.repeat(x, count, -1) for x in self.samples)
        return parametric_windows.terms_of(self.test, u, y)

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (start of a search for a zero, direction) of the whole box."""
        boxes = parametric_windows.on_whole(self.test, self.terms(parametric_windows.SEARCHED), False)
        _, _, _, _, start, h, _ = boxes
        return np.asarray(start)[..., 0], np.asarray(h)[..., 0]

    def point(self, start: np.ndarray) -> Explained | None:
        """Return (FixedWindow, z) near a start or near the middle, or None."""
        n = len(self.p.size)
        noise = np.zeros(len(self.p.window.limits))
        noise[list(self.test.noisy)] = np.clip(start[n:], -1, 1)
        near = self.p.near(np.clip(start[:n], -1, 1), noise)
        return _explained(self.p, near) or _explained(self.p, self.p.near(np.zeros(n), 0 * noise))

    def cut(self, budget: int, fault: bool, consistent: bool) -> tuple[Tree | None, Explained | None]:
        """Return a proof or a point as `_proof` does, from a bisection of the box.

        Boxes of one generation are judged together. A place is where the part of the proof for a box is to
        stand: it gets a Leaf, or (variable, at) and two places for the halves of the box.
        """
        one = np.ones((len(self.p.size), 1), self.test.N.dtype)
        root: _Place = []
        lo, hi, places, seen = -one, one, [root], 0
        terms = self.terms(PART)
        while places and seen < budget:
            seen += len(places)
            margin, start, h, axis, inside = self._judged(terms, lo, hi, consistent)
            halves: list[tuple[int, int, float]] = []  # (box, variable, where it is cut)
            after: list[_Place] = []
            for k, place in enumerate(places):
                if fault and margin[k] < 0:
                    leaf = _directed(self.p, h[:, k], self._exact(lo[:, k]), self._exact(hi[:, k]))
                    if leaf is not None:
                        place.append(leaf)
                        continue
                if inside[k]:
                    explained = self.point(start[:, k])
                    if explained is not None:
                        return None, explained
                i = int(axis[k])
                middle = 0.5 * (lo[i, k] + hi[i, k])
                below: _Place = []
                above: _Place = []
                place += [i, Fraction(float(middle)) * self.p.size[i], below, above]
                halves.append((k, i, middle))
                after += [below, above]
            if not halves:
                return _assembled(root), None
            lo, hi, places = *_halved(lo, hi, halves), after
        return None, None

    def _exact(self, ends: np.ndarray) -> Vector:
        """Return a corner of a box from units of the bounds."""
        return tuple(Fraction(float(x)) * s for x, s in zip(ends, self.p.size, strict=True))

    def _judged(self, terms: Any, lo: np.ndarray, hi: np.ndarray, consistent: bool) -> list[np.ndarray]:
        """Return [margin, start, h, axis, whether a point is proved to exist] of boxes (n, N), some at a
        time.
        """
        parts = []
        for k in range(0, lo.shape[1], PART):
            parts.append(self._part(terms, lo[:, k : k + PART], hi[:, k : k + PART], consistent))
        return [np.concatenate(columns, -1) for columns in zip(*parts, strict=True)]

    def _part(self, terms: Any, lo: np.ndarray, hi: np.ndarray, consistent: bool) -> list[np.ndarray]:
        """Return the same of at most PART boxes, filled up so that no kernel is compiled anew."""
        count = lo.shape[1]
        fill = ((0, 0), (0, PART - count))
        mid, radius = np.pad(0.5 * (lo + hi), fill, mode="edge"), np.pad(0.5 * (hi - lo), fill, mode="edge")
        owner = np.arange(PART, dtype=np.int32)
        boxes = parametric_windows.on_boxes(self.test, terms, mid, radius, owner, consistent)
        _, margin, inside, _, start, h, axis = boxes
        return [np.asarray(x)[..., :count] for x in (margin, start, h, axis, inside)]


def _halved(
    lo: np.ndarray, hi: np.ndarray, halves: Sequence[tuple[int, int, float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi) of the two halves of some boxes, side by side."""
    cut = [k for k, _, _ in halves]
    lo, hi = np.repeat(lo[:, cut], 2, 1), np.repeat(hi[:, cut], 2, 1)
    for j, (_, i, middle) in enumerate(halves):
        hi[i, 2 * j] = lo[i, 2 * j + 1] = middle
    return lo, hi


def _assembled(place: _Place) -> Tree:
    """Return the Leaf or Cut of a place of the bisection."""
    if len(place) == 1:
        leaf: Leaf = place[0]
        return leaf
    variable, at, below, above = place
    return Cut(variable, at, _assembled(below), _assembled(above))


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
