"""The certificate of one verdict on a model with uncertain parameters, in exact rational arithmetic.

FAULT: a tree of boxes of the parameters, a leaf for each with a direction h over the relations: 0 is not in
the range of h p over it (`checker.boxes`). Mostly the whole box is the only leaf. CONSISTENT: parameters at
which what is left, a linear window, is explained by a first state and noise. Floats only propose boxes,
directions and points; ranges in fractions are those of the checker.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from jaxbound.certificates.checker.boxes import Parts, box_of, checked_relations, range_of
from jaxbound.certificates.exact_window import (
    Ends,
    ExactWindow,
    exact_window,
    rounded_witness,
    shorter,
)
from jaxbound.certificates.interface import (
    Index,
    Sample,
    certificate_of,
    nothing_to_explain,
)
from jaxbound.certificates.witness import Numbers, Witnessed, every_sample, in_rows
from jaxbound.consistency import parametric_windows
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Vector
from jaxbound.relations.polynomial import PolynomialMatrix
from jaxbound.relations.sentence import at_sample, main_terms, sum_text
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.relations.uncertain_window import Variable, uncertain_window
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import outside_xla
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips import polynomials
from jaxbound.text.objects import readable

BOXES = 2000
"""Boxes that the proof of one FAULT may look at."""
Tree: TypeAlias = dict[str, Any]
"""A box of the parameters that explains nothing, as a certificate shows it: a leaf {direction, vertices, low,
high}, or a cut {variable, at, below, above} with two more of them.
"""
Explained: TypeAlias = tuple[Vector, ExactWindow, Vector]
"""Parameters, a window at them, and unknowns that explain it."""


@readable
@dataclass(frozen=True, eq=False)
class UncertainCertificate(Witnessed):
    """A proof of the verdict of a window with uncertain parameters; every number is an exact Fraction.

    Fields:
        status: of the window, as detected. at: the index at which it ends, a tuple.
        relations: the UncertainRelations that the proof is about: for a window with missing samples those
            without them.
        proof: for FAULT a Tree: no parameters and errors within bounds explain the window; else None.
        window: the samples and bounds; for CONSISTENT at the parameters of the witness. z: its unknowns, or
            None.
        bounds: of the parameters, in half-widths. chosen: the variables of the witness, or ().
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
    chosen: Vector

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what the exact numbers say, also where the method of the detection left it
        UNDECIDED.
        """
        if self.proof is None:
            return Status.CONSISTENT
        return Status.FAULT

    @cached_property
    def leaves(self) -> tuple[Tree, ...]:
        """The leaf of each part of the parameters' box, () for CONSISTENT."""
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
        for variable, v in zip(self.relations.variables, self.chosen, strict=True):
            parameter = by_name[variable[0]]
            values[variable] = parameter.centre + parameter.radius * v
        return values

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
        names = [f"r{k + 1}" for k in range(self.relations.count)]
        return f"{sum_text(zip(self.leaves[0]['direction'], names, strict=True))} = 0"

    def __str__(self) -> str:
        """Return one sentence."""
        if self.z is not None:
            values = []
            for variable, x in (self.parameters or {}).items():
                values.append(f"{at_sample(*variable, self.relations.horizon)} = {float(x):.6g}")
            state = [f"{float(x):.6g}" for x in self.state or ()]
            return f"explained by {', '.join(values)} and the first state ({', '.join(state)})"
        if len(self.leaves) == 1:
            (leaf,) = self.leaves
            return (
                f"{main_terms(self.relation)} cannot hold: its left side is in [{float(leaf['low']):.6g}, "
                f"{float(leaf['high']):.6g}]"
            )
        return (
            f"no parameters within their bounds explain it: each of {len(self.leaves)} parts of their box "
            f"contradicts the relations"
        )

    def to_dict(
        self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True
    ) -> dict[str, Any]:
        """Return everything that a check needs, ready for JSON: as `Certificate.to_dict`, whose `errors` are
        not known here.

        numbers.uncertainties: what each parameter multiplies, its bound, whether it varies.
        numbers.variables: the parameter and the sample (null: constant) that each variable v is. A polynomial
        is a list of [coefficient, number of a variable, ..], with a variable squared twice.
        """
        numbers: Numbers = {"relations": [], "proof": None, "parameters": None}
        if self.proof is not None:
            numbers |= {"relations": _shown(self.relations, self.window), "proof": self.proof}
        if self.z is not None:
            numbers["parameters"] = [Fraction(0)] * len(self.window.claim["variables"])
            for number, value in zip(_numbers(self.relations, self.window), self.chosen, strict=True):
                numbers["parameters"][int(number)] = value
        return self._document(self.proves, numbers, times, sample)


def _shown(r: UncertainRelations, window: ExactWindow) -> list[Numbers]:
    """Return the polynomials of relations on the outputs, disturbances and inputs of each sample."""
    model, readings, number = r.model, (r.horizon + 1) * r.model.p, _numbers(r, window)
    nothing: list[Fraction] = []
    shown = []
    for k in range(r.count):
        on_rows = [_flat(r.N, k, j, number) for j in range(r.N.columns)]
        on_inputs = [_flat(r.K, k, j, number) for j in range(r.K.columns)]
        g = every_sample(r.horizon, on_rows[readings:], [nothing] * model.g)
        u = every_sample(r.horizon, on_inputs, [nothing] * model.m)
        shown.append({"h": in_rows(on_rows[:readings], model.p), "g": g, "k": u})
    return shown


def _numbers(relations: UncertainRelations, window: ExactWindow) -> list[Fraction]:
    """Return the number of each variable of relations among all of the parameters."""
    parameters = relations.model.uncertainties
    every = [(parameters[int(number)].name, lag) for number, lag in window.claim["variables"]]
    return [Fraction(every.index(v)) for v in relations.variables]


@certificate_of.register
def _(
    relations: UncertainRelations, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index
) -> UncertainCertificate:
    if np.isnan(y).all():
        raise nothing_to_explain(at)
    cases = list(parametric_windows.cases(relations, u, y, np.zeros(1, int)))
    if not cases:
        raise nothing_to_explain(at)
    case, _ = cases[0]  # without the samples that the window lacks
    assert case is not None  # a single pattern of missing samples
    p = _Proving(case, u, y)
    budget = 1
    if status in (Status.FAULT, Status.CONSISTENT):
        budget = BOXES
    proof, explained = _proof(p, u, y, status, budget)
    chosen: Vector = ()
    window, z = p.window, None
    if explained is not None:
        chosen, window, z = explained
    elif proof is None:
        raise NotImplementedError(
            f"neither a contradiction nor a behaviour is at hand for window {at[-1]}; a larger budget= of "
            f"boxes goes on where detect stopped"
        )
    if status is None:
        status = Status.CONSISTENT
        if proof is not None:
            status = Status.FAULT
    return UncertainCertificate(Status(status), at, case, proof, window, z, p.bounds, chosen)


class _Proving:
    """Relations and samples of one window, for a proof in fractions.

    Fields: relations, that need no missing sample; window; bounds of the uncertainties; numbers of the
    variables, size: their bounds; parts of the relations; box of all variables.
    """

    def __init__(self, relations: UncertainRelations, u: np.ndarray, y: np.ndarray) -> None:
        self.relations, self.window = relations, exact_window(relations, u, y)
        # bounds in the float type of the samples, as the kernels took them
        bounds = rounding.round_up(np.asarray(relations.bounds["parameters"], np.float64), y.dtype)
        self.bounds: Vector = tuple(map(Fraction, bounds.tolist()))
        claim = self.window.claim
        for parameter, bound in zip(claim["uncertainties"], self.bounds, strict=True):
            parameter["bound"] = bound
        self.parts: list[Parts] = checked_relations(claim, _shown(relations, self.window))
        self.numbers, self.box = _numbers(relations, self.window), box_of(claim)
        self.size: Vector = tuple(self.box[f"p{k}"][1] for k in self.numbers)

    def leaf(self, h: Vector, box: Mapping[str, Ends], few: bool = False) -> Tree | None:
        """Return the leaf of a direction over a box, None if it proves nothing. few: the vertices may be
        tried.
        """
        for vertices in (False, True)[: 1 + few]:
            low, high = range_of(h, self.parts, box, vertices)
            if low > 0 or high < 0:
                return {"direction": h, "vertices": Fraction(int(vertices)), "low": low, "high": high}
        return None

    def at(self, v: Vector) -> ExactWindow:
        """Return the window at parameters v: what is left is linear."""
        w, model = self.window, self.window.model
        E, H, V = (m.at(v) for m in uncertain_window(model, w.horizon)[1:])
        n, g = model.n, model.g * w.horizon
        rows = [(*e[:n], *x, *e[n:]) for e, x in zip(E, V, strict=True)]  # x, w, v as in `models.window`
        for i in range(g):  # disturbances are rows of their own
            own = [Fraction(0)] * len(rows[0])
            own[n + i] = Fraction(1)
            rows.append(tuple(own))
        K = H + linalg.zeros(g, len(w.u))
        return dataclasses.replace(w, own=(tuple(rows), K)).with_limits(w.limits)


def _proof(
    p: _Proving, u: np.ndarray, y: np.ndarray, status: Status | None, budget: int
) -> tuple[Tree | None, Explained | None]:
    """Return (a proof of FAULT, None), or (None, parameters and unknowns that explain the window), or (None,
    None) if neither was found.

    Each relation alone over the whole box comes first, which is the shortest proof; then the boxes,
    directions and the point that `bisected` found, in fractions.
    """
    r = p.relations
    few = polynomials.multiaffine(r.exponents) and len(p.size) <= parametric_windows.VERTICES
    if status != Status.CONSISTENT:
        for h in linalg.identity(r.count):
            leaf = p.leaf(h, p.box, few)
            if leaf is not None:
                return leaf, None
    reading = r.reading(y.dtype)
    samples = np.nan_to_num(u[: reading.lags])[..., None], np.nan_to_num(y)[..., None]
    with outside_xla():  # a single window is not worth a compilation
        found, _, leaves, points = parametric_windows.bisected(
            reading, samples, status != Status.FAULT, budget, size=32
        )
    if found[0] == Status.FAULT:
        return _tree_of(p, leaves, p.box), None
    if status == Status.FAULT:
        return None, None
    # a point at the edge of the box may explain in floats alone: others, nearer to its middle, are tried
    for start in (points, 0.5 * points, 0 * points):
        near = parametric_windows.refined(reading, samples, start)[: len(p.size), 0]
        explained = _explained(p, tuple(Fraction(x) * s for x, s in zip(near.tolist(), p.size, strict=True)))
        if explained is not None:
            return None, explained
    return None, None


def _tree_of(p: _Proving, leaves: parametric_windows.Leaves, box: Mapping[str, Ends]) -> Tree | None:
    """Return the proof that leaves, whose boxes fill one box, are; None where one of them proves nothing."""
    lo, hi = leaves.lo.min(1), leaves.hi.max(1)
    if len(leaves.owner) == 1:
        return _directed(p, leaves.h[:, 0], box)
    middle = 0.5 * (lo + hi)
    for i, at in enumerate(middle):
        below, above = leaves.hi[i] <= at, leaves.lo[i] >= at
        if not (below | above).all():
            continue
        cut, name = Fraction(float(at)) * p.size[i], f"p{p.numbers[i]}"
        low, high = box[name]
        first = _tree_of(p, leaves.chosen(below), {**box, name: (low, cut)})
        rest = _tree_of(p, leaves.chosen(above), {**box, name: (cut, high)})
        if first is None or rest is None:
            return None
        return {"variable": p.numbers[i], "at": cut, "below": first, "above": rest}
    raise AssertionError("boxes of a bisection are halves of halves")


def _directed(p: _Proving, h: np.ndarray, box: Mapping[str, Ends]) -> Tree | None:
    """Return the leaf of a direction in floats with as few digits as prove it, or None."""
    # a common factor changes no direction, and digits count beside the largest entry
    top = np.abs(h).max()
    if not 0 < top < np.inf:
        return None
    for short in shorter(list(map(Fraction, (h / top).tolist()))):
        leaf = p.leaf(short, box)
        if leaf is not None:
            return leaf
    return None


def _explained(p: _Proving, v: Vector) -> Explained | None:
    """Return the parameters, with as few digits as explain the window, or None."""
    for candidate in (*shorter(v), v):
        # rounding for readers must not leave the box of the parameters
        inside = tuple(max(-size, min(x, size)) for x, size in zip(candidate, p.size, strict=True))
        window = p.at(inside)
        best = window.solve()
        if best.t <= 1:
            return inside, window, rounded_witness(window, best.z)
    return None


def _leaves(proof: Tree) -> Iterator[Tree]:
    if "at" not in proof:
        yield proof
    else:
        yield from _leaves(proof["below"])
        yield from _leaves(proof["above"])


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
