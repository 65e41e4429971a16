"""Certificates of long windows: what contradicts all samples since an observer began, as one relation among
them.

An observer moves a set through time and meets it with each sample by multipliers of its own. Followed
backward, these say how much each sample and each disturbance counts: one relation h Y + g w = k U that holds
for every behaviour, whatever the first state, and that the samples violate. The multipliers that violate it
most are the dual of a linear program over the same samples, sparse in all states; it is solved in floats.
Rounded to short numbers, and corrected where the first state would be left over, they are exact, and what
they prove is checked in fractions: nothing rests on the program.

    q = h_j C + q A backward,   g_j = -(q after j) G,   k_j = h_j D + (q after j) B,   0 = q + x,   x: of
    bounds of the first state

With unknown inputs also h_j D_v + (q after j) F = 0: the multipliers of the outputs that they are taken out
by follow from the others, see `models.unknown_directions`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeVar

import numpy as np

from jaxbound.certificates.certificate import Certificate, of_window
from jaxbound.certificates.exact_window import (
    Ends,
    ExactWindow,
    Stretch,
    known_inputs,
    window_of,
)
from jaxbound.certificates.interface import Index, certificate_of
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector, add_multiple, multiply, transpose
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import unknown_directions, with_direct_states
from jaxbound.models.window import model_matrices
from jaxbound.relations.bounds import model_bounds
from jaxbound.relations.sentence import relation_text
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

T = TypeVar("T")
ZERO = Fraction(0)
DIGITS = 30
"""Bits of a multiplier, beside the largest."""
SHORT = 8
"""Steps of the longest stretch whose rows are written out, if its first state has no bounds."""


def stretch(
    model: LinearSystem, horizon: int, first: Iterable[Iterable[float | Fraction]] | None = None
) -> Stretch:
    """Return the Stretch of a model. first: (n, 2) floats or Fractions, bounds of the state of its first
    sample, or None.
    """
    plain, ends = model, None
    if model.averages and (horizon > SHORT or first is not None):  # a LongWindow has no rows for them
        plain = model.replace(averages=())
    if first is not None:
        ends = tuple((Fraction(lo), Fraction(hi)) for lo, hi in first)
    return Stretch(plain, horizon, model_bounds(plain), ends)


class Left(NamedTuple):
    """The multipliers that those of outputs leave of the first state (n,), of disturbances (s g,), inputs
    (l,) and unknown inputs.
    """

    first: Vector
    disturbances: Vector
    inputs: Vector
    unknown: Vector


@dataclass(frozen=True, eq=False)
class LongWindow(ExactWindow):
    """An ExactWindow that is never written out as one matrix."""

    @property
    def unweighed(self) -> str:
        """Why no fault of it is weighed."""
        return (
            "named faults are weighed on windows, and an observer's verdict rests on all samples since it "
            "began: detect with a horizon or lags for a diagnosis"
        )

    def of_first(self, h: Sequence[Fraction]) -> Vector:
        """Return the multipliers x of the first state where it has bounds."""
        if self.first is None:
            return ()
        return linalg.scale(self.backward(h[: len(self.y)]).first, -1)

    def outputs_at(self, h: Sequence[T], j: int) -> tuple[T, ...]:
        """Return the entries of the outputs of sample j."""
        p = self.model.p
        return tuple(h[j * p : (j + 1) * p])

    def backward(self, h: Sequence[Fraction]) -> Left:
        """Return the multipliers that those of the outputs, h ((s+1) p,), leave."""
        return _backward(self, tuple(h))

    def action(self, h: Sequence[Fraction]) -> Vector:
        """Return k, what a relation h does with the inputs."""
        return self.backward(h[: len(self.y)]).inputs

    def multipliers(self) -> Vector:
        """Return about the multipliers of the outputs that are violated most; exact ones that leave nothing
        of a free first state.
        """
        t, floats = program(self)
        if t <= 1:
            return (ZERO,) * len(self.y)
        # a common factor changes no relation: digits are kept beside the largest multiplier
        largest = max(np.abs(floats).max(initial=0), 1e-300)
        # a few bits: certificates are read, and any multipliers prove what they prove
        h: Vector = tuple(Fraction(round(float(x) / largest * 2**DIGITS), 2**DIGITS) for x in floats)
        _, H, needed = self._way
        # without them some unknown input would be left over, whatever the other multipliers are
        if needed and None in H[1:]:  # outputs are missing that take unknown inputs out
            return (ZERO,) * len(h)
        h, left = self._without_unknown(h)
        if self.first is not None or not any(left):
            return h
        # the first outputs that tell the first state are changed, so that nothing is left of it
        changes: list[Vector] = []
        rows: list[Vector] = []
        for i, sample in enumerate(self.y):
            if sample is None:
                continue
            change, row = self._without_unknown([Fraction(i == place) for place in range(len(self.y))])
            changes.append(change)
            rows.append(row)
            # what is left is to be a combination of what these outputs do to the first state
            solved, pivots = linalg.row_reduce(transpose([*rows, left]))
            if len(rows) in pivots:
                continue
            for shares, j in zip(solved, pivots, strict=True):
                h = add_multiple(h, -shares[-1], changes[j])
            return h
        return (ZERO,) * len(h)

    @cached_property
    def _way(self) -> tuple[LinearSystem, list[Matrix | None], bool]:
        """(the plant, with a state for what acts on outputs at once; H of each sample, by which multipliers
        of outputs change so that no unknown input counts, None where there is none; whether one is needed):
        see `models.unknown_directions`.
        """
        plant = with_direct_states(self.model)
        directions = unknown_directions(plant)
        H: list[Matrix | None] = [None] * (self.horizon + 1)
        if directions is None:
            return plant, H, False
        for j in range(self.horizon + 1):
            readings = self.outputs_at(self.y, j)
            fitting = (way.H for way in directions.ways if None not in [readings[i] for i in way.outputs])
            H[j] = next(fitting, None)
        if self.first is None or plant.n == self.model.n:
            H[0] = None  # no unknown input came before it
        return plant, H, True

    def _without_unknown(self, h: Sequence[Fraction]) -> tuple[Vector, Vector]:
        """Return (multipliers h with those changed that take unknown inputs out, what they leave of the first
        state).
        """
        plant, H, _ = self._way
        A, C = transpose(plant.A), transpose(plant.C)
        q: Vector = (ZERO,) * plant.n
        changed: list[Vector] = []
        for j in range(self.horizon, -1, -1):
            row = self.outputs_at(h, j)
            if any(row) or any(q):
                q = _sum(multiply(C, row), multiply(A, q))
                of_sample = H[j]
                if of_sample is not None:
                    change = multiply(transpose(of_sample), q)
                    row, q = add_multiple(row, -1, change), add_multiple(q, -1, multiply(C, change))
            changed.append(row)
        return _in_order(changed), q


@lru_cache(maxsize=1)  # all numbers of a relation are asked one after the other
def _backward(window: LongWindow, h: Vector) -> Left:
    m, inputs = window.model, len(window.u) // max(window.model.m, 1)
    A, B, C, D, G, F, D_v = (_columns(m, name) for name in ("A", "B", "C", "D", "G", "F", "D_v"))
    q: Vector = (ZERO,) * m.n
    of_disturbances, of_inputs, of_unknown = [], [], []
    for j in range(window.horizon, -1, -1):
        row = window.outputs_at(h, j)
        if j < window.horizon:
            of_disturbances.append(linalg.scale(multiply(G, q), -1))  # g_j = -(q after j) G
        if j < inputs:
            of_inputs.append(_sum(multiply(D, row), multiply(B, q)))  # k_j = h_j D + (q after j) B
        of_unknown.append(_sum(multiply(D_v, row), multiply(F, q)))
        q = _sum(multiply(C, row), multiply(A, q))  # q = h_j C + q A
    return Left(q, _in_order(of_disturbances), _in_order(of_inputs), _in_order(of_unknown))


def _columns(model: LinearSystem, name: str) -> Matrix:
    """Return the columns of a matrix; none without states, whose matrices have lost their width."""
    if not model.n:
        return ()
    return transpose(getattr(model, name))


def _sum(a: Vector, b: Vector) -> Vector:
    return add_multiple(a, 1, b)


def _in_order(rows: Sequence[Vector]) -> Vector:
    """Return rows that were collected backward in time as one vector, the first sample first."""
    return tuple(x for row in reversed(rows) for x in row)


def program(window: LongWindow) -> tuple[float, np.ndarray]:
    """Return (factor, multipliers of the outputs ((s+1) p,)) in floats, from a linear program in all states,
    unknown inputs, disturbances and the factor:

        least t >= 0 with x+ = A x + B u + G w + F v, |C x + D u + D_v v - middle| <= t half-width,
        |w - middle| <= t half-width, and the same of a first state that has bounds
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, diags_array, eye_array, hstack, kron, vstack

    m, s = window.model, window.horizon
    A, B, C, D, G, F, D_v = model_matrices(m, ("A", "B", "C", "D", "G", "F", "D_v"))
    n, free, g, every = m.n, (s + 1) * (m.n + m.d), s * m.g, eye_array(s + 1)
    inputs, known = np.zeros((s + 1, m.m)), known_inputs(m, window.u)
    inputs.flat[: len(known)] = list(map(float, known))
    w_mid, w_rad = _middles(window.claim["disturbance"])
    # disturbances are scaled by their half-widths
    pushed = [csr_array((s * n, 0))] * (not g) + [kron(eye_array(s), G * w_rad)] * (g > 0)
    steps = kron(eye_array(s, s + 1), A) - kron(eye_array(s, s + 1, k=1), np.eye(n))
    moves = hstack([steps, kron(eye_array(s, s + 1), F), *pushed, csr_array((s * n, 1))])

    there = [i for i, ends in enumerate(window.limits[: (s + 1) * m.p]) if ends is not None]
    mid, rad = _middles([window.true_limits(i) for i in there])
    seen = hstack([kron(every, C), kron(every, D_v), csr_array(((s + 1) * m.p, g))]).tocsr()[there]
    first_mid, first_rad = _middles(window.first or ())
    first = eye_array(len(first_mid), free + g)
    # in units of half-widths: t is compared with 1 in every row
    rows = vstack([diags_array(1 / rad) @ seen, eye_array(g, free + g, k=free), first])
    middle = np.concatenate([(mid - (inputs @ D.T).ravel()[there]) / rad, np.zeros(g), first_mid])
    half = np.concatenate([np.ones(len(there) + g), first_rad])
    best = linprog(
        np.eye(free + g + 1)[-1],
        hstack([vstack([rows, -rows]), -np.tile(half, 2)[:, None]]),  # +-(rows z - middle) <= t half
        np.concatenate([middle, -middle]),
        moves,
        -np.ravel(inputs[:s] @ B.T + w_mid @ G.T),
        bounds=(None, None),
        method="highs",
    )
    h = np.zeros((s + 1) * m.p)
    # the program failed: no multipliers, so nothing is claimed
    if best.status != 0:
        return 0.0, h
    # dual values of the two sides of a row: their difference is its multiplier, in half-widths
    upper, lower = np.split(best.ineqlin.marginals, 2)
    h[there] = (upper - lower)[: len(there)] / rad
    return float(best.fun), h


def _middles(ends: Sequence[Ends]) -> tuple[np.ndarray, np.ndarray]:
    """Return (middles, half-widths) of pairs in floats."""
    pairs = np.array([[float(lo), float(hi)] for lo, hi in ends]).reshape(-1, 2)
    return pairs.mean(1), np.diff(pairs, axis=1)[:, 0] / 2


@readable
@dataclass(frozen=True, eq=False)
class LongCertificate(Certificate):
    """A Certificate of many samples: one relation among all since an observer began, or among the last of
    them.

    Fields: as of a Certificate. Which sensor alone could be wrong is not worked out: errors and candidates
    are empty.
    """

    window: LongWindow


@certificate_of.register
def _(relations: Stretch, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index) -> Certificate:
    if relations.horizon <= SHORT and relations.first is None:
        return of_window(relations, u, y, status, at)
    window = window_of(LongWindow, relations, u, y, relations.first)
    rows = window.multipliers()
    left = window.backward(rows)
    h, over = (*rows, *left.disturbances), any(left.unknown)
    if relations.first is None:
        # a first state without bounds times anything is without bounds
        over |= any(left.first)
    k, residual, width = window.relation(h)
    if over or not any(h) or not width or abs(residual) <= width:
        raise NotImplementedError(
            f"no relation of these {relations.horizon + 1} samples is found that proves the FAULT at "
            f"{at[-1]} alone"
        )
    factor = abs(residual) / width
    text = relation_text(window.model, window.horizon, h, k)
    return LongCertificate(Status.FAULT, at, text, h, k, residual, width, factor, window, None)
