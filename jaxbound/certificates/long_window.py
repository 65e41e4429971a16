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
from jaxbound.certificates.exact_window import ExactWindow, Explanation, exact_samples
from jaxbound.certificates.interface import certify
from jaxbound.exact import linalg
from jaxbound.exact.linalg import dot
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import unknown_directions, with_direct_states
from jaxbound.relations.bounds import model_bounds
from jaxbound.relations.sentence import relation_text
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = ["LongCertificate", "LongWindow", "Stretch", "exceeds", "stretch"]

ZERO = Fraction(0)
DIGITS = 30
"""Bits of a multiplier, beside the largest."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """What is proved of horizon + 1 samples in a row, in the place of relations: bounds of a model, and
    perhaps of the first state.

    Fields: model, without averages or uncertainties; horizon; bounds: as of `parity_relations`; first: ((lo,
    hi), ..) of the first state, or None; lags: None.
    """

    model: LinearSystem
    horizon: int
    bounds: Any
    first: tuple | None = None
    lags: tuple | None = None


def stretch(model: LinearSystem, horizon: int, first: Sequence | None = None) -> Stretch:
    """Return the Stretch of a model. first: (n, 2) floats or Fractions, bounds of the state of its first
    sample, or None.
    """
    plain = model.replace(averages=()) if model.averages else model
    ends = None if first is None else tuple((Fraction(lo), Fraction(hi)) for lo, hi in first)
    return Stretch(plain, horizon, model_bounds(plain), ends)


@dataclass(frozen=True, eq=False)
class LongWindow(ExactWindow):
    """An ExactWindow that is never written out as one matrix. first: bounds of the first state, or None."""

    first: tuple | None = None

    def backward(self, h: Sequence[Fraction]) -> tuple[tuple, tuple, tuple]:
        """Return (x (n,), g (s g,), k (l,)): what multipliers h ((s+1) p,) of the outputs leave of the first
        state, the disturbances and the inputs.
        """
        m, p, inputs = self.model, self.model.p, len(self.u) // max(self.model.m, 1)
        q: tuple = (ZERO,) * m.n
        g: list = []
        k: list = []
        turned = {name: linalg.transpose(getattr(m, name)) if m.n else () for name in "ABCDG"}
        for j in range(self.horizon, -1, -1):
            row = h[j * p : (j + 1) * p]
            if j < self.horizon:
                g[:0] = [-dot(column, q) for column in turned["G"]]
            if j < inputs:
                k[:0] = [dot(d, row) + dot(b, q) for d, b in zip(turned["D"], turned["B"], strict=True)]
            q = tuple(dot(c, row) + dot(a, q) for c, a in zip(turned["C"], turned["A"], strict=True))
        return q, tuple(g), tuple(k)

    def relation(self, h: Sequence[Fraction]) -> tuple[tuple[Fraction, ...], Fraction, Fraction]:
        """Return (k, residual, width) of a relation h of outputs and disturbances, with what it leaves of a
        first state that has bounds.
        """
        left, _, k = self.backward(h[: len(self.y)])
        if self.first is None and any(left):
            raise ValueError("the relation leaves the first state over")
        if self._unknown_left(h):
            raise ValueError("the relation leaves an unknown input over")
        used = [(x, *self.known_limits(i)) for i, x in enumerate(h) if x]
        used += [(-x, *ends) for x, ends in zip(left, self.first or (), strict=False) if x]
        known = [
            ZERO if v is None else v - self.model.offset["u"][j % self.model.m] for j, v in enumerate(self.u)
        ]
        ends = [x * (lo + hi) / 2 for x, lo, hi in used], [abs(x) * (hi - lo) / 2 for x, lo, hi in used]
        total = lambda terms: dot(terms, [Fraction(1)] * len(terms))
        return k, total(ends[0]) - dot(k, known), total(ends[1])

    def multipliers(self) -> tuple[Fraction, ...]:
        """Return about the multipliers of the outputs that are violated most; exact ones that leave nothing
        of a free first state.
        """
        _, floats = _program(self)
        largest = max(np.abs(floats).max(initial=0), 1e-300)
        h = [Fraction(round(float(x) / largest * 2**DIGITS), 2**DIGITS) for x in floats]
        taken = self._taken_out()
        if self.model.d and None in taken[2][1:]:  # outputs are missing that unknown inputs are taken out by
            return (ZERO,) * len(h)
        h, _ = self._without_unknown(h, taken)
        if self.first is None:
            h, _ = self._without_unknown(self._corrected(h, taken), taken)
        return tuple(h)

    def _corrected(self, h, taken):
        """Return multipliers changed in as many places as there are states, so that the first state does not
        count.
        """
        (plant, hidden, _), p = taken, self.model.p
        seen: list[Sequence[Fraction]] = []
        wanted: list[int] = []
        for j in range(self.horizon + 1):
            rows = self._on_first(j, taken)
            for i in range(p):
                if self.y[j * p + i] is not None and linalg.rank([*seen, rows[i]]) > len(seen):
                    seen.append(rows[i])
                    wanted.append(j * p + i)
            if len(seen) == plant.n - hidden:
                break
        left = [[x] for x in self._without_unknown(h, taken)[1]]
        if len(seen) == plant.n - hidden:
            across = linalg.matmul(seen, linalg.transpose(seen))
            for at, (x,) in zip(
                wanted, linalg.matmul(linalg.inverse(across), linalg.matmul(seen, left)), strict=True
            ):
                h[at] -= x
        return h

    def _taken_out(self):
        """Return (model with a state for what acts on outputs at once, dimensions that no output shows, H of
        each sample or None).
        """
        m, p, plant = self.model, self.model.p, with_direct_states(self.model)
        found = unknown_directions(plant)
        if found is None:
            none: Any = [[ZERO] * p] * plant.n if m.d else None
            return plant, 0, [none] * (self.horizon + 1)
        there = lambda way, j: all(self.y[j * p + i] is not None for i in way.outputs)
        H = [next((way.H for way in found.ways if there(way, j)), None) for j in range(self.horizon + 1)]
        if self.first is None or plant.n == m.n:
            H[0] = None  # no unknown input came before it
        return plant, len(found.hidden), H

    def _without_unknown(self, h, taken):
        """Return (multipliers h with those changed that take unknown inputs out, what they leave of the first
        state).
        """
        (plant, _, H), p, h = taken, self.model.p, list(h)
        A, C, q = linalg.transpose(plant.A), linalg.transpose(plant.C), (ZERO,) * plant.n
        for j in range(self.horizon, -1, -1):
            q = tuple(dot(c, h[j * p : (j + 1) * p]) + dot(a, q) for c, a in zip(C, A, strict=True))
            if H[j] is not None:
                change = [dot(column, q) for column in linalg.transpose(H[j])]
                h[j * p : (j + 1) * p] = [x - y for x, y in zip(h[j * p : (j + 1) * p], change, strict=True)]
                q = tuple(x - dot(c, change) for x, c in zip(q, C, strict=True))
        return h, q

    def _on_first(self, j, taken):
        """Return how the multipliers of sample j act on the first state, others changed with them, (p, n)."""
        plant, _, H = taken
        rows = plant.C
        for i in range(j, -1, -1):
            if H[i] is not None:
                through = linalg.matmul(linalg.matmul(rows, H[i]), plant.C)
                rows = [
                    [x - y for x, y in zip(*pair, strict=True)] for pair in zip(rows, through, strict=True)
                ]
            rows = linalg.matmul(rows, plant.A) if i else rows
        return rows

    def _unknown_left(self, h):
        """Say whether an unknown input would count in a relation."""
        m, p = self.model, self.model.p
        if not m.d:
            return False
        A, C, F, D_v, q = *(linalg.transpose(x) for x in (m.A, m.C, m.F, m.D_v)), (ZERO,) * m.n
        for j in range(self.horizon, -1, -1):
            row = h[j * p : (j + 1) * p]
            if any(dot(d, row) + dot(f, q) for d, f in zip(D_v, F, strict=True)):
                return True
            q = tuple(dot(c, row) + dot(a, q) for c, a in zip(C, A, strict=True))
        return False


def exceeds(about: Stretch, u: np.ndarray, y: np.ndarray) -> float:
    """Return about the factor on all bounds at which samples u (s+1, m), y (s+1, p) can just be explained: >
    1 where they contradict.
    """
    return _program(_long_window(about, u, y))[0]


def _long_window(about: Stretch, u: np.ndarray, y: np.ndarray) -> LongWindow:
    samples = exact_samples(about, u, y)
    return LongWindow(**samples, drive=(), first=about.first)


def _program(window: LongWindow) -> tuple[float, np.ndarray]:
    """Return (factor, multipliers of the outputs ((s+1) p,)) in floats, from a linear program in all states
    and disturbances.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, kron, vstack

    m, s = window.model, window.horizon
    names = ("A", "B", "C", "D", "G", "F", "D_v")
    A, B, C, D, G, F, D_v = (
        np.array([[float(x) for x in row] for row in getattr(m, a)]).reshape(len(getattr(m, a)), -1)
        for a in names
    )
    n, g, p, free = m.n, m.g, m.p, (s + 1) * (m.n + m.d)
    inputs = np.zeros((s + 1, m.m))
    offset = [float(x) for x in m.offset["u"]]
    for j, v in enumerate(window.u):
        inputs[j // m.m, j % m.m] = 0 if v is None else float(v) - offset[j % m.m]
    there = [i for i, ends in enumerate(window.limits[: (s + 1) * p]) if ends is not None]
    ends = np.array([[float(v) for v in window.known_limits(i)] for i in there]).reshape(-1, 2)
    w_ends = np.array([[float(v) for v in pair] for pair in window.disturbance] * s).reshape(-1, 2)
    w_mid, w_rad = w_ends.mean(1), np.diff(w_ends, axis=1)[:, 0] / 2
    # scaled: states by nothing, disturbances by their half-widths; variables (states, unknown inputs,
    # disturbances, factor)
    moves = pushed = None
    if s:
        steps = kron(eye_array(s, s + 1), A) - kron(eye_array(s, s + 1, k=1), np.eye(n))
        noise = kron(eye_array(s), G) @ _diagonal(w_rad) if g else csr_array((s * n, 0))
        moves = hstack([steps, kron(eye_array(s, s + 1), F), noise, csr_array((s * n, 1))])
        pushed = -(inputs[:s] @ B.T + (w_mid.reshape(s, g) @ G.T if g else 0)).ravel()
    mid, rad = ends.mean(1), np.diff(ends, axis=1)[:, 0] / 2
    through = (inputs @ D.T).ravel()[there] if D.size else np.zeros(len(there))
    seen = (
        _diagonal(1 / rad)
        @ csr_array(hstack([kron(eye_array(s + 1), C), kron(eye_array(s + 1), D_v)]))[there]
    )
    ones = lambda count: -np.ones((count, 1))
    sides = [hstack([sign * seen, csr_array((len(there), s * g)), ones(len(there))]) for sign in (1, -1)]
    right = [sign * (mid - through) / rad for sign in (1, -1)]
    if g:
        sides += [
            hstack([csr_array((s * g, free)), sign * eye_array(s * g), ones(s * g)]) for sign in (1, -1)
        ]
        right += [np.zeros(s * g)] * 2
    if window.first is not None:
        x = np.array([[float(v) for v in pair] for pair in window.first])
        middle, half = x.mean(1), np.diff(x, axis=1)[:, 0] / 2
        sides += [
            hstack([sign * eye_array(n, free), csr_array((n, s * g)), -half[:, None]]) for sign in (1, -1)
        ]
        right += [sign * middle for sign in (1, -1)]
    cost = np.append(np.zeros(free + s * g), 1.0)
    ends_of_all = [(None, None)] * (free + s * g) + [(0, None)]
    found = linprog(
        cost, vstack(sides), np.concatenate(right), moves, pushed, bounds=ends_of_all, method="highs"
    )
    if found.status != 0:
        return 0.0, np.zeros((s + 1) * p)
    marks, count = found.ineqlin.marginals, len(there)
    h = np.zeros((s + 1) * p)
    h[there] = (marks[:count] - marks[count : 2 * count]) / rad
    return float(found.fun), h


def _diagonal(x):
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

    @property
    def sensor_errors(self) -> tuple:  # type: ignore[override]
        """Empty: not worked out."""
        return ()

    @property
    def candidates(self) -> tuple[str, ...]:  # type: ignore[override]
        """Empty: not worked out."""
        return ()

    def _relation_dict(self, h, output=0, error=None):
        w = self.window
        x = {} if w.first is None else {"x": tuple(-v for v in w.backward(h)[0])}
        return super()._relation_dict(h, output, error) | x

    def _document(self, verdict, numbers, times, sample):
        w = self.window
        return super()._document(
            verdict, numbers if w.first is None else {"first_state": w.first, **numbers}, times, sample
        )


@certify.register
def _(relations: Stretch, u, y, method="joint", status=None, at=None):
    at = (relations.horizon,) if at is None else at
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
    found = Explanation(factor, h, k, residual, width, (), ())
    text = relation_text(window.model, window.horizon, h, k)
    return LongCertificate(Status.FAULT, at, text, h, k, residual, width, factor, window, found, None)
