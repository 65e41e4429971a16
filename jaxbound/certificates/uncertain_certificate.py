"""The certificate of one verdict on a model with uncertain parameters, in exact rational arithmetic.

FAULT: a tree of boxes of the parameters, a leaf for each with a direction h over the relations: 0 is not in
the range of h p over it (`exact_polynomials`). Mostly the whole box is the only leaf. CONSISTENT: parameters
at which what is left, a linear window, is explained by a first state and noise. Floats only propose boxes,
directions and points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from jaxbound.certificates.blame import DIGITS, rounded_witness
from jaxbound.certificates.exact_polynomials import polynomial_window
from jaxbound.certificates.interface import WindowCertificate, certify
from jaxbound.certificates.witness import Witnessed, rows_of
from jaxbound.consistency import parametric_windows
from jaxbound.relations.sentence import main_terms
from jaxbound.relations.uncertain import UncertainRelations
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

    lo: tuple
    hi: tuple
    direction: tuple
    low: Fraction
    high: Fraction
    vertices: bool


@dataclass(frozen=True)
class Cut:
    """Two boxes instead of one: v_variable <= at, and the rest; each part is a Leaf or a Cut."""

    variable: int
    at: Fraction
    below: object
    above: object


@readable
@dataclass(frozen=True, eq=False)
class UncertainCertificate(Witnessed, WindowCertificate):
    """Why a window of a model with uncertain parameters has its verdict; every number is an exact Fraction.

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
    at: tuple
    relations: UncertainRelations
    proof: Leaf | Cut | None
    window: Any
    z: tuple | None
    bounds: tuple
    errors: ClassVar[MappingProxyType] = MappingProxyType({})
    candidates: ClassVar = ()

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what the exact numbers say, also where the method of the detection left it
        UNDECIDED.
        """
        return Status.CONSISTENT if self.proof is None else Status.FAULT

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """The Leaf of each part of the parameters' box, () for CONSISTENT."""
        return tuple(_leaves(self.proof)) if self.proof is not None else ()

    @property
    def parameters(self) -> Any:
        """{(name, sample of the window, or None for a constant one): value in the unit of `between`} of the
        witness, or None.
        """
        if self.z is None:
            return None
        by_name = {u.name: u for u in self.relations.model.uncertainties}
        values = zip(self.relations.variables, self.window.variables, strict=True)
        return {key: by_name[key[0]].centre + by_name[key[0]].radius * v for key, v in values}

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
        terms = [(x, f"r{k + 1}") for k, x in enumerate(self.leaves[0].direction) if x]
        text = "".join(
            f" {'-' if x < 0 else '+'} {'' if abs(x) == 1 else f'{float(abs(x)):.6g} '}{name}"
            for x, name in terms
        )
        return text[3:] + " = 0" if text[1] == "+" else "-" + text[3:] + " = 0"

    def __str__(self) -> str:
        """Return one sentence."""
        if self.z is not None:
            s = self.relations.horizon
            at = lambda lag: "" if lag is None else f"[k-{s - lag}]" if lag < s else "[k]"
            values = ", ".join(
                f"{name}{at(lag)} = {float(x):.6g}" for (name, lag), x in self.parameters.items()
            )
            return (
                f"explained by {values} and the first state "
                f"({', '.join(f'{float(x):.6g}' for x in self.state or ())})"
            )
        if len(self.leaves) == 1:
            (leaf,) = self.leaves
            return (
                f"{main_terms(self.relation)} cannot hold: its left side is in [{float(leaf.low):.6g}, "
                f"{float(leaf.high):.6g}]"
            )
        return (
            f"no parameters within their bounds explain it: each of {len(self.leaves)} parts of their "
            f"box "
            f"contradicts the relations"
        )

    def to_dict(self, times: Sequence[str] | None = None, sample: Any = None, errors: bool = True) -> dict:
        """Return everything that a check needs, ready for JSON: as `Certificate.to_dict`, whose `errors` are
        not known here.

        numbers.uncertainties: what each parameter multiplies, its bound, whether it varies.
        numbers.variables: the parameter and the sample (null: constant) that each variable v is. A polynomial
        is a list of [coefficient, number of a variable, ..], with a variable squared twice.
        """
        r, parameters = self.relations, self.window.model.uncertainties
        variables = [
            (u.name, lag) for u in parameters for lag in (range(r.horizon + 1) if u.varying else [None])
        ]
        names, number = [u.name for u in parameters], [Fraction(variables.index(v)) for v in r.variables]
        chosen = dict(zip(r.variables, self.window.variables, strict=True)) if self.z is not None else {}
        numbers = {
            "uncertainties": [
                {letter: u.on(letter) for letter in "ABCD"}
                | {"bound": bound, "varying": Fraction(int(u.varying))}
                for u, bound in zip(parameters, self.bounds, strict=True)
            ],
            "variables": [
                [Fraction(names.index(name)), None if lag is None else Fraction(lag)]
                for name, lag in variables
            ],
            "relations": [self._polynomial_dict(k, number) for k in range(r.count)]
            if self.proof is not None
            else [],
            "proof": None if self.proof is None else _tree(self.proof, number),
            "parameters": None if self.z is None else [chosen.get(v, Fraction(0)) for v in variables],
        }
        return self._document(self.proves, numbers, times, sample)

    def _polynomial_dict(self, k, number):
        """Return the polynomials of one relation on the outputs, disturbances and inputs of each sample."""
        r, model = self.relations, self.relations.model
        rows = (r.horizon + 1) * model.p
        row = lambda matrix, span: [_flat(matrix, k, j, number) for j in span]
        return {
            "h": rows_of(row(r.N, range(rows)), model.p),
            "g": self._every_sample(row(r.N, range(rows, r.N.columns)), [[]] * model.g),
            "k": self._every_sample(row(r.K, range(r.K.columns)), [[]] * model.m),
        }


@certify.register
def _(relations: UncertainRelations, u, y, method="joint", status=None, at=None):
    at = (relations.horizon,) if at is None else at
    nothing = ValueError(f"window {at[-1]} is MISSING: there is nothing to explain")
    found = list(parametric_windows.cases(relations, u, y, np.zeros(1, int))) if not np.isnan(y).all() else []
    if not found:
        raise nothing
    case, _ = found[0]
    assert case is not None  # a single pattern of missing samples
    relations = case
    p = polynomial_window(relations, u, y)
    proof, point = _proof(p, u, y, status, BOXES if method == "paving" or status == Status.FAULT else 1)
    if proof is None and point is None:
        hint = "" if method == "paving" else "; method 'paving' goes on where this one stops"
        raise NotImplementedError(
            f"neither a contradiction nor a behaviour is at hand for window {at[-1]}{hint}"
        )
    window, z = (p.window, None) if point is None else point
    proved = Status.CONSISTENT if proof is None else Status.FAULT
    return UncertainCertificate(
        proved if status is None else Status(status), at, relations, proof, window, z, p.bounds
    )


def _proof(p, u, y, status, budget):
    """Return (proof, None) or (None, (FixedWindow, z)), or (None, None) if neither was found."""
    r, lo = p.relations, tuple(-x for x in p.size)
    whole, few = (
        (lo, p.size),
        polynomials.multiaffine(p.relations.exponents) and len(p.size) <= parametric_windows.VERTICES,
    )
    fault, consistent = status != Status.CONSISTENT, status != Status.FAULT
    alone = [tuple(Fraction(int(k == i)) for i in range(r.count)) for k in range(r.count)]
    if fault:
        for h in alone:
            if (leaf := _leaf(p, h, *whole, few)) is not None:
                return leaf, None
    if (
        consistent
        and r.count == 1
        and few
        and (point := _explained(p, p.zero_between(*p.ends()))) is not None
    ):
        return None, point
    boxes = _Boxes(p, u, y)
    _, start, h = boxes.whole()
    if fault and (leaf := _directed(p, h, *whole)) is not None:
        return leaf, None
    if consistent and (point := boxes.point(start)) is not None:
        return None, point
    return boxes.cut(budget, fault, consistent) if budget > 1 else (None, None)


def _leaf(p, h, lo, hi, few=False):
    """Return the Leaf of a direction, or None if it proves nothing."""
    for vertices in (False, True)[: 1 + few]:
        low, high = p.spread(h, lo, hi, vertices)
        if low > 0 or high < 0:
            return Leaf(lo, hi, h, low, high, vertices)
    return None


def _directed(p, h, lo, hi):
    """Return the Leaf of a direction in floats with as few digits as prove it, or None."""
    top = np.abs(h).max()
    if not 0 < top < np.inf:
        return None
    for digits in (2, *DIGITS):
        leaf = _leaf(p, tuple(Fraction(f"{x:.{digits}g}") for x in (h / top).tolist()), lo, hi)
        if leaf is not None:
            return leaf
    return None


def _explained(p, v):
    """Return (FixedWindow, z) of parameters with as few digits as explain the window, or None."""
    if v is None:
        return None
    for digits in (*DIGITS, None):
        short = v if digits is None else (Fraction(f"{float(x):.{digits}g}") for x in v)
        window = p.at([max(-size, min(x, size)) for x, size in zip(short, p.size, strict=True)])
        found = window.solve()
        if found.factor <= 1:
            return window, rounded_witness(window, found.z)
    return None


class _Boxes:
    """What floats propose for boxes of the parameters of one window, by the kernels of the detection."""

    def __init__(self, p, u, y):
        self.p, self.test = p, p.relations.reading(y.dtype)
        self.samples = [x[..., None] for x in (np.nan_to_num(u[: self.test.window.lags]), np.nan_to_num(y))]

    def terms(self, count):
        """Return the terms of the window, so many times."""
        return parametric_windows.terms_of(self.test, *(np.repeat(x, count, -1) for x in self.samples))

    def whole(self):
        """Return (margin, start, h) of the whole box."""
        said = parametric_windows.on_whole(self.test, self.terms(parametric_windows.SEARCHED), False)
        return [np.asarray(said[k])[..., 0] for k in (1, 4, 5)]

    def point(self, start):
        """Return (FixedWindow, z) near a start or near the middle, or None."""
        n = len(self.p.size)
        e = np.zeros(len(self.p.window.limits))
        e[list(self.test.noisy)] = np.clip(start[n:], -1, 1)
        for v, noise in ((np.clip(start[:n], -1, 1), e), (np.zeros(n), 0 * e)):
            if (found := _explained(self.p, self.p.near(v, noise))) is not None:
                return found
        return None

    def cut(self, budget, fault, consistent):
        """Return what `_proof` does, from a bisection of the box."""
        terms, one = self.terms(PART), np.ones((len(self.p.size), 1), self.test.N.dtype)
        root: list = []
        lo, hi, places, seen = -one, one, [root], 0
        exact = lambda ends: tuple(Fraction(float(x)) * s for x, s in zip(ends, self.p.size, strict=True))
        while places and seen < budget:
            seen += len(places)
            now = [slice(k, k + PART) for k in range(0, len(places), PART)]
            said = [self._part(terms, lo[:, part], hi[:, part], consistent) for part in now]
            margin, start, h, axis, inside = (np.concatenate(x, -1) for x in zip(*said, strict=True))
            left, new = [], []
            for k, place in enumerate(places):
                leaf = (
                    _directed(self.p, h[:, k], exact(lo[:, k]), exact(hi[:, k]))
                    if fault and margin[k] < 0
                    else None
                )
                if leaf is not None:
                    place.append(leaf)
                    continue
                if inside[k] and (point := self.point(start[:, k])) is not None:
                    return None, point
                i, middle = int(axis[k]), 0.5 * (lo[axis[k], k] + hi[axis[k], k])
                place += [i, exact(np.full(len(lo), middle))[i], [], []]
                left.append((k, i, middle))
                new.extend(place[2:])
            if not left:
                return _assembled(root), None
            kept = [k for k, _, _ in left]
            lo, hi, places = np.repeat(lo[:, kept], 2, 1), np.repeat(hi[:, kept], 2, 1), new
            for j, (_, i, middle) in enumerate(left):
                hi[i, 2 * j] = lo[i, 2 * j + 1] = middle
        return None, None

    def _part(self, terms, lo, hi, consistent):
        """Return (margin, start, h, axis, whether a point is proved to exist) of boxes (n, N)."""
        count = lo.shape[1]
        mid, radius = (
            np.pad(x, ((0, 0), (0, PART - count)), mode="edge") for x in (0.5 * (lo + hi), 0.5 * (hi - lo))
        )
        said = parametric_windows.on_boxes(
            self.test, terms, mid, radius, np.arange(PART, dtype=np.int32), consistent
        )
        return [np.asarray(said[k])[..., :count] for k in (1, 4, 5, 6, 2)]


def _assembled(place):
    """Return the Leaf or Cut of a place of the bisection."""
    if len(place) == 1:
        return place[0]
    variable, at, below, above = place
    return Cut(variable, at, _assembled(below), _assembled(above))


def _leaves(proof):
    if isinstance(proof, Leaf):
        return [proof]
    return _leaves(proof.below) + _leaves(proof.above)


def _tree(proof, number):
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


def _flat(matrix, k, j, number):
    """Return the polynomial of one entry as a list of [coefficient, number of a variable, ..]."""
    entries = [(alpha, part[k, j]) for alpha, part in matrix.terms.items() if (k, j) in part]
    return [[x, *(number[i] for i, e in enumerate(alpha) for _ in range(e))] for alpha, x in entries]
