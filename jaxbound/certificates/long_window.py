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

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.certificates.exact_window import Ends, ExactWindow, Explanation, exact_samples, known_inputs
from jaxbound.certificates.fault_size import SensorError
from jaxbound.certificates.interface import Index, Sample, certify
from jaxbound.certificates.witness import Numbers
from jaxbound.consistency.interface import Bounds
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector, add_multiple, dot, multiply, transpose
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import Way, unknown_directions, with_direct_states
from jaxbound.relations.bounds import model_bounds
from jaxbound.relations.sentence import relation_text
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress

__all__ = ["LongCertificate", "LongWindow", "Stretch", "exceeds", "stretch"]

ZERO = Fraction(0)
DIGITS = 30
"""Bits of a multiplier, beside the largest."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Bounds of a model, and perhaps of the first state, over horizon + 1 samples in a row, in the place of
    relations.

    Fields: model, without averages or uncertainties; horizon; bounds: as of `parity_relations`; first: ((lo,
    hi), ..) of the first state, or None; lags: None.
    """

    model: LinearSystem
    horizon: int
    bounds: Bounds
    first: tuple[Ends, ...] | None = None
    lags: tuple[int, ...] | None = None


def stretch(
    model: LinearSystem, horizon: int, first: Sequence[Sequence[float | Fraction]] | None = None
) -> Stretch:
    """Return the Stretch of a model. first: (n, 2) floats or Fractions, bounds of the state of its first
    sample, or None.
    """
    plain = model
    if model.averages:
        plain = model.replace(averages=())
    ends = None
    if first is not None:
        ends = tuple((Fraction(lo), Fraction(hi)) for lo, hi in first)
    return Stretch(plain, horizon, model_bounds(plain), ends)


@dataclass(frozen=True)
class TakenOut:
    """The way in which multipliers of outputs are changed so that no unknown input counts: see
    `models.unknown_directions`.

    Fields: plant, with a state for what acts on outputs at once; hidden: dimensions of it that no output
    shows; H: of each sample, None where none is needed or where outputs are missing.
    """

    plant: LinearSystem
    hidden: int
    H: list[Matrix | None]


@dataclass(frozen=True, eq=False)
class LongWindow(ExactWindow):
    """An ExactWindow that is never written out as one matrix. first: bounds of the first state, or None."""

    first: tuple[Ends, ...] | None = None

    def outputs_at(self, h: Sequence[Fraction], j: int) -> Sequence[Fraction]:
        """Return the multipliers of the outputs of sample j."""
        p = self.model.p
        return h[j * p : (j + 1) * p]

    def backward(self, h: Sequence[Fraction]) -> tuple[Vector, Vector, Vector]:
        """Return (x (n,), g (s g,), k (l,)): what multipliers h ((s+1) p,) of the outputs leave of the first
        state, the disturbances and the inputs.
        """
        m, inputs = self.model, len(self.u) // max(self.model.m, 1)
        A, B, C, D, G = (_columns(m, name) for name in "ABCDG")
        q: Vector = (ZERO,) * m.n
        of_disturbances, of_inputs = [], []
        for j in range(self.horizon, -1, -1):
            row = self.outputs_at(h, j)
            if j < self.horizon:
                of_disturbances.append(linalg.scale(multiply(G, q), -1))  # g_j = -(q after j) G
            if j < inputs:
                of_inputs.append(_sum(multiply(D, row), multiply(B, q)))  # k_j = h_j D + (q after j) B
            q = _sum(multiply(C, row), multiply(A, q))  # q = h_j C + q A
        return q, _in_order(of_disturbances), _in_order(of_inputs)

    def relation(self, h: Sequence[Fraction]) -> tuple[Vector, Fraction, Fraction]:
        """Return (k, residual, width) of a relation h of outputs and disturbances, with what it leaves of a
        first state that has bounds.
        """
        left, _, k = self.backward(h[: len(self.y)])
        if self.first is None and any(left):
            raise ValueError("the relation leaves the first state over")
        if self._leaves_unknown_input(h):
            raise ValueError("the relation leaves an unknown input over")
        used = [(x, self.known_limits(i)) for i, x in enumerate(h) if x]
        if self.first is not None:
            used += [(-x, ends) for x, ends in zip(left, self.first, strict=True) if x]  # 0 = q + x
        weights = [x for x, _ in used]
        sums, widths = [lo + hi for _, (lo, hi) in used], [hi - lo for _, (lo, hi) in used]
        residual = dot(weights, sums) / 2 - dot(k, known_inputs(self.model, self.u))
        return k, residual, dot(map(abs, weights), widths) / 2

    def multipliers(self) -> Vector:
        """Return about the multipliers of the outputs that are violated most; exact ones that leave nothing
        of a free first state.
        """
        _, floats = _program(self)
        largest = max(np.abs(floats).max(initial=0), 1e-300)
        h: Vector = tuple(Fraction(round(float(x) / largest * 2**DIGITS), 2**DIGITS) for x in floats)
        way = self._taken_out()
        if self.model.d and None in way.H[1:]:  # outputs are missing that unknown inputs are taken out by
            return (ZERO,) * len(h)
        h, _ = self._without_unknown(h, way)
        if self.first is None:
            h, _ = self._without_unknown(self._corrected(h, way), way)
        return h

    def _corrected(self, h: Vector, way: TakenOut) -> Vector:
        """Return multipliers changed in as many places as there are states, so that the first state does not
        count.
        """
        places, rows = self._independent(way)
        if len(rows) != way.plant.n - way.hidden:
            return h
        # the change d in these places has d rows = q: d = (rows rows')^-1 rows q
        _, left = self._without_unknown(h, way)
        across = linalg.matmul(rows, transpose(rows))
        change = multiply(linalg.inverse(across), multiply(rows, left))
        corrected = list(h)
        for place, x in zip(places, change, strict=True):
            corrected[place] -= x
        return tuple(corrected)

    def _independent(self, way: TakenOut) -> tuple[list[int], list[Vector]]:
        """Return (numbers of the first outputs that together tell the first state, how they act on it)."""
        places: list[int] = []
        rows: list[Vector] = []
        for j in range(self.horizon + 1):
            for i, row in enumerate(self._on_first(j, way), j * self.model.p):
                if self.y[i] is not None and linalg.rank([*rows, row]) > len(rows):
                    places.append(i)
                    rows.append(row)
            if len(rows) == way.plant.n - way.hidden:
                break
        return places, rows

    def _taken_out(self) -> TakenOut:
        """Return the way by which unknown inputs are taken out of this window."""
        plant = with_direct_states(self.model)
        directions = unknown_directions(plant)
        if directions is None:
            nothing = None
            if self.model.d:
                nothing = linalg.zeros(plant.n, self.model.p)
            return TakenOut(plant, 0, [nothing] * (self.horizon + 1))
        H = [self._first_way(directions.ways, j) for j in range(self.horizon + 1)]
        if self.first is None or plant.n == self.model.n:
            H[0] = None  # no unknown input came before it
        return TakenOut(plant, len(directions.hidden), H)

    def _first_way(self, ways: Sequence[Way], j: int) -> Matrix | None:
        """Return H of the first way whose outputs are all there at sample j, or None."""
        for way in ways:
            if all(self.y[j * self.model.p + i] is not None for i in way.outputs):
                return way.H
        return None

    def _without_unknown(self, h: Sequence[Fraction], way: TakenOut) -> tuple[Vector, Vector]:
        """Return (multipliers h with those changed that take unknown inputs out, what they leave of the first
        state).
        """
        A, C = transpose(way.plant.A), transpose(way.plant.C)
        q: Vector = (ZERO,) * way.plant.n
        changed: list[Vector] = []
        for j in range(self.horizon, -1, -1):
            row: Vector = tuple(self.outputs_at(h, j))
            q = _sum(multiply(C, row), multiply(A, q))
            H = way.H[j]
            if H is not None:
                change = multiply(transpose(H), q)
                row = add_multiple(row, -1, change)
                q = add_multiple(q, -1, multiply(C, change))
            changed.append(row)
        return _in_order(changed), q

    def _on_first(self, j: int, way: TakenOut) -> Matrix:
        """Return how the multipliers of sample j act on the first state, others changed with them, (p, n)."""
        rows = way.plant.C
        for i in range(j, -1, -1):
            H = way.H[i]
            if H is not None:
                through = linalg.matmul(linalg.matmul(rows, H), way.plant.C)
                rows = tuple(add_multiple(row, -1, by) for row, by in zip(rows, through, strict=True))
            if i:
                rows = linalg.matmul(rows, way.plant.A)
        return rows

    def _leaves_unknown_input(self, h: Sequence[Fraction]) -> bool:
        """Return whether an unknown input would count in a relation: h_j D_v + (q after j) F is not 0."""
        m = self.model
        if not m.d:
            return False
        A, C, F, D_v = transpose(m.A), transpose(m.C), transpose(m.F), transpose(m.D_v)
        q: Vector = (ZERO,) * m.n
        for j in range(self.horizon, -1, -1):
            row = self.outputs_at(h, j)
            if any(_sum(multiply(D_v, row), multiply(F, q))):
                return True
            q = _sum(multiply(C, row), multiply(A, q))
        return False


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


def exceeds(about: Stretch, u: np.ndarray, y: np.ndarray) -> float:
    """Return about the factor on all bounds at which samples u (s+1, m), y (s+1, p) can just be explained: >
    1 where they contradict.
    """
    return _program(_long_window(about, u, y))[0]


def _long_window(about: Stretch, u: np.ndarray, y: np.ndarray) -> LongWindow:
    samples = exact_samples(about, u, y)
    return LongWindow(**samples, drive=(), first=about.first)


def _program(window: LongWindow) -> tuple[float, np.ndarray]:
    """Return (factor, multipliers of the outputs ((s+1) p,)) in floats, from a linear program in all states,
    unknown inputs, disturbances and the factor:

        least t >= 0 with x+ = A x + B u + G w + F v, |C x + D u + D_v v - middle| <= t half-width,
        |w - middle| <= t half-width, and the same of a first state that has bounds
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, kron, vstack

    m, s = window.model, window.horizon
    A, B, C, D, G, F, D_v = (_floats(m, name) for name in ("A", "B", "C", "D", "G", "F", "D_v"))
    n, g, p, free = m.n, m.g, m.p, (s + 1) * (m.n + m.d)
    inputs = _float_inputs(window)
    w_mid, w_rad = _middles(window.disturbance * s)
    # disturbances are scaled by their half-widths
    moves = pushed = None
    if s:
        steps = kron(eye_array(s, s + 1), A) - kron(eye_array(s, s + 1, k=1), np.eye(n))
        noise, drift = csr_array((s * n, 0)), np.zeros((s, n))
        if g:
            noise, drift = kron(eye_array(s), G) @ _diagonal(w_rad), w_mid.reshape(s, g) @ G.T
        moves = hstack([steps, kron(eye_array(s, s + 1), F), noise, csr_array((s * n, 1))])
        pushed = -(inputs[:s] @ B.T + drift).ravel()

    there = [i for i, ends in enumerate(window.limits[: (s + 1) * p]) if ends is not None]
    mid, rad = _middles([window.known_limits(i) for i in there])
    through = np.zeros(len(there))
    if D.size:
        through = (inputs @ D.T).ravel()[there]
    on_outputs = hstack([kron(eye_array(s + 1), C), kron(eye_array(s + 1), D_v)])
    seen = _diagonal(1 / rad) @ csr_array(on_outputs)[there]
    bounded = [(hstack([seen, csr_array((len(there), s * g))]), (mid - through) / rad, np.ones(len(there)))]
    if g:
        bounded.append(
            (hstack([csr_array((s * g, free)), eye_array(s * g)]), np.zeros(s * g), np.ones(s * g))
        )
    if window.first is not None:
        middle, half = _middles(window.first)
        bounded.append((hstack([eye_array(n, free), csr_array((n, s * g))]), middle, half))
    sides, right = [], []
    for rows, middle, half in bounded:
        for sign in (1, -1):  # sign (rows z - middle) <= t half
            sides.append(hstack([sign * rows, -half[:, None]]))
            right.append(sign * middle)
    cost = np.append(np.zeros(free + s * g), 1.0)
    ends = [(None, None)] * (free + s * g) + [(0, None)]
    best = linprog(cost, vstack(sides), np.concatenate(right), moves, pushed, bounds=ends, method="highs")
    if best.status != 0:
        return 0.0, np.zeros((s + 1) * p)
    marks, count = best.ineqlin.marginals, len(there)
    h = np.zeros((s + 1) * p)
    h[there] = (marks[:count] - marks[count : 2 * count]) / rad
    return float(best.fun), h


def _floats(model: LinearSystem, name: str) -> np.ndarray:
    rows = getattr(model, name)
    return np.array([list(map(float, row)) for row in rows]).reshape(len(rows), -1)


def _float_inputs(window: LongWindow) -> np.ndarray:
    """Return the inputs (s + 1, m) in deviations, 0 where one is missing or matters to no output."""
    m = window.model.m
    inputs = np.zeros((window.horizon + 1, m))
    offset = list(map(float, window.model.offset["u"]))
    for j, v in enumerate(window.u):
        if v is not None:
            inputs[j // m, j % m] = float(v) - offset[j % m]
    return inputs


def _middles(ends: Sequence[Ends]) -> tuple[np.ndarray, np.ndarray]:
    """Return (middles, half-widths) of pairs in floats."""
    pairs = np.array([[float(lo), float(hi)] for lo, hi in ends]).reshape(-1, 2)
    return pairs.mean(1), np.diff(pairs, axis=1)[:, 0] / 2


def _diagonal(x: np.ndarray) -> Any:  # of scipy.sparse, which has no types
    from scipy.sparse import diags_array

    return diags_array(x)


@readable
@dataclass(frozen=True, eq=False)
class LongCertificate(Certificate):
    """A Certificate of many samples: one relation among all since an observer began, or among the last of
    them.

    Fields: as of a Certificate. Which sensor alone could be wrong is not worked out: errors and candidates
    are empty.
    """

    window: LongWindow

    def work_out(self, progress: Progress | None = None) -> None:
        """Work out nothing: errors and candidates are empty."""

    @property
    def sensor_errors(self) -> tuple[SensorError, ...]:
        """Empty: not worked out."""
        return ()

    @property
    def candidates(self) -> tuple[str, ...]:
        """Empty: not worked out."""
        return ()

    def diagnose(self, faults: Sequence[NamedFault] | None = None) -> Diagnosis:
        """Raise NotImplementedError: not worked out."""
        raise NotImplementedError(
            "named faults are weighed on windows, and an observer's verdict rests on all samples since it "
            "began: detect with a horizon or lags for a diagnosis"
        )

    def _relation_dict(self, h: Vector, window: ExactWindow) -> Numbers:
        numbers = super()._relation_dict(h, window)
        if self.window.first is not None:
            numbers["x"] = linalg.scale(self.window.backward(h)[0], -1)
        return numbers

    def _document(
        self, verdict: Status, proof: Numbers, times: Sequence[str] | None, sample: Sample
    ) -> dict[str, Any]:
        if self.window.first is not None:
            proof = {"first_state": self.window.first, **proof}
        return super()._document(verdict, proof, times, sample)


@certify.register
def _(
    relations: Stretch,
    u: np.ndarray,
    y: np.ndarray,
    method: str = "joint",
    status: Status | None = None,
    at: Index | None = None,
) -> LongCertificate:
    if at is None:
        at = (relations.horizon,)
    window = _long_window(relations, u, y)
    rows = window.multipliers()
    h = (*rows, *window.backward(rows)[1])
    k, residual, width = window.relation(h)
    if not any(h) or not width or abs(residual) <= width:
        raise NotImplementedError(
            f"no relation of these {relations.horizon + 1} samples is found that proves the FAULT at "
            f"{at[-1]} alone"
        )
    factor = abs(residual) / width
    best = Explanation(factor, h, k, residual, width, (), ())
    text = relation_text(window.model, window.horizon, h, k)
    return LongCertificate(Status.FAULT, at, text, h, k, residual, width, factor, window, best, None)
