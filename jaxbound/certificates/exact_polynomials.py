"""One window of a model with uncertain parameters in exact rationals: ranges of its relations over boxes, and
zeros of them.

With parameters |v_i| <= size_i and rows z_j = mid_j + rad_j e_j, |e_j| <= 1, relation k of a healthy window
says

    p_k(v, e) = P_k(v) + sum_j e_j Q_kj(v) = 0,     P_k = N_k(v) mid - K_k(v) U,   Q_kj = N_kj(v) rad_j.

Polynomials are {alpha: Fraction}. Over a box of v, a direction h over the relations gives the range of h p,
from which 0 is absent only if no v in the box explains the window. It is bounded monomial by monomial around
the middle of the box, or, where no variable has an exponent above 1, exactly at the vertices, where h P -+
sum_j |h Q_j| has its extremes.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from typing import TypeAlias

import numpy as np

from jaxbound.certificates.exact_window import Ends, ExactWindow, exact_window, known_inputs
from jaxbound.exact.chebyshev import Subspace, subspace
from jaxbound.exact.linalg import Matrix, Vector, add_multiple, multiply, scale, zeros
from jaxbound.models.system import LinearSystem
from jaxbound.relations.polynomial import Exponents, PolynomialMatrix
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.relations.uncertain_window import uncertain_window
from jaxbound.sets.floats import rounding

__all__ = ["FixedWindow", "Point", "PolynomialWindow", "polynomial_window"]

ZERO, ONE = Fraction(0), Fraction(1)
HALVINGS = 90

Polynomial: TypeAlias = dict[Exponents, Fraction]
Point: TypeAlias = tuple[Vector, Vector]
"""(v, e): parameters, and where each row lies within its limits."""


@dataclass(frozen=True)
class FixedWindow(ExactWindow):
    """A window at chosen parameters: fixed is its (E, K), variables the parameters."""

    fixed: tuple[Matrix, Matrix] = ((), ())
    variables: Vector = ()

    @property
    def forms(self) -> tuple[Matrix, Matrix]:
        """(E, K) at these parameters."""
        return self.fixed

    def space(self, rows: Sequence[int]) -> Subspace:
        """Return the Subspace of some rows over all unknowns."""
        columns = self.unknown_columns()
        return subspace([columns[i] for i in rows])


@dataclass(frozen=True, eq=False)
class PolynomialWindow:
    """Relations and samples of one window. Fields: relations, that need no missing sample; window; bounds of
    the uncertainties.
    """

    relations: UncertainRelations
    window: ExactWindow
    bounds: Vector

    @cached_property
    def size(self) -> tuple[Fraction, ...]:
        """The bounds of the variables."""
        names = [u.name for u in self.relations.model.uncertainties]
        return tuple(self.bounds[names.index(name)] for name, _ in self.relations.variables)

    @cached_property
    def parts(self) -> tuple[list[Polynomial], list[list[Polynomial]]]:
        """(P, Q): P[k] and Q[j][k] of the module; a row j that is missing has no part."""
        r = self.relations
        middles, radii = [], []
        for ends in self.window.limits:
            lo, hi = ends or (ZERO, ZERO)
            middles.append((lo + hi) / 2)
            radii.append((hi - lo) / 2)
        P: list[Polynomial] = [{} for _ in range(r.count)]
        Q: list[list[Polynomial]] = [[{} for _ in range(r.count)] for _ in radii]
        for alpha, entries in r.N.terms.items():  # N mid, N rad
            for (k, j), x in entries.items():
                P[k][alpha] = P[k].get(alpha, ZERO) + x * middles[j]
                if radii[j]:
                    Q[j][k][alpha] = x * radii[j]
        inputs = known_inputs(r.model, self.window.u)
        for alpha, entries in r.K.terms.items():  # - K U
            for (k, j), x in entries.items():
                P[k][alpha] = P[k].get(alpha, ZERO) - x * inputs[j]
        return P, Q

    def spread(self, h: Vector, lo: Vector, hi: Vector, vertices: bool) -> Ends:
        """Return (low, high), which holds h p over the box lo <= v <= hi and all e: exact if `vertices`."""
        P, Q = self.parts
        whole, noise = _mixed(h, P), [_mixed(h, q) for q in Q if any(q)]
        if vertices:
            least, most = _extremes_at_vertices(whole, noise, lo, hi)
            return least[0], most[0]
        middles = [(a + b) / 2 for a, b in zip(lo, hi, strict=True)]
        radii = [(b - a) / 2 for a, b in zip(lo, hi, strict=True)]
        low, high = _span(_on_box(whole, middles, radii))
        for q in noise:
            reach = max(map(abs, _span(_on_box(q, middles, radii))))
            low, high = low - reach, high + reach
        return low, high

    def at(self, v: Vector) -> FixedWindow:
        """Return the FixedWindow at parameters v: what is left is linear."""
        w, model = self.window, self.window.model
        E, H, V = (m.at(v) for m in _matrices(model, w.horizon))
        n, g = model.n, model.g * w.horizon
        rows = [(*e[:n], *x, *e[n:]) for e, x in zip(E, V, strict=True)]  # x, w, v as in `models.window`
        for i in range(g):  # disturbances are rows of their own
            own = [ZERO] * len(rows[0])
            own[n + i] = ONE
            rows.append(tuple(own))
        K = H + zeros(g, len(w.u))
        fields = {field.name: getattr(w, field.name) for field in dataclasses.fields(ExactWindow)}
        fields["drive"] = multiply(K, known_inputs(model, w.u))
        return FixedWindow(**fields, fixed=(tuple(rows), K), variables=tuple(v))

    def zero(self) -> Vector:
        """Return v where the single relation, multi-affine, nearly vanishes on the way from its least to its
        largest value over the box.
        """
        P, Q = self.parts
        lowest, highest = _extremes_at_vertices(P[0], [q[0] for q in Q], scale(self.size, -1), self.size)
        below, above = ZERO, ONE
        for _ in range(HALVINGS):
            t = (below + above) / 2
            v, e = (_between(a, b, t) for a, b in zip(lowest[1], highest[1], strict=True))
            if _at(P[0], v) + sum((x * _at(q[0], v) for x, q in zip(e, Q, strict=True)), ZERO) > 0:
                above = t
            else:
                below = t
        return _between(lowest[1][0], highest[1][0], below)


def _between(a: Vector, b: Vector, t: Fraction) -> Vector:
    """Return a + t (b - a)."""
    return add_multiple(a, t, add_multiple(b, -1, a))


def _extremes_at_vertices(
    P: Polynomial, Q: Sequence[Polynomial], lo: Vector, hi: Vector
) -> tuple[tuple[Fraction, Point], tuple[Fraction, Point]]:
    """Return the extremes of P + sum_j e_j Q_j over the vertices of a box, each with a place where it is."""
    ends: list[tuple[Fraction, Point]] = []
    for v in product(*zip(lo, hi, strict=True)):
        middle, slopes = _at(P, v), [_at(q, v) for q in Q]
        reach, toward = sum(map(abs, slopes), ZERO), tuple(Fraction((x > 0) - (x < 0)) for x in slopes)
        ends += [(middle - reach, (v, scale(toward, -1))), (middle + reach, (v, toward))]
    return min(ends), max(ends)


def polynomial_window(relations: UncertainRelations, u: np.ndarray, y: np.ndarray) -> PolynomialWindow:
    """Return the PolynomialWindow of samples u (s+1, m), y (s+1, p); the relations must need none that is
    missing.
    """
    bounds = rounding.round_up(np.asarray(relations.bounds["parameters"], np.float64), y.dtype)
    return PolynomialWindow(relations, exact_window(relations, u, y), tuple(map(Fraction, bounds.tolist())))


@lru_cache(maxsize=16)
def _matrices(
    model: LinearSystem, horizon: int
) -> tuple[PolynomialMatrix, PolynomialMatrix, PolynomialMatrix]:
    """Return (E, H, V) of `uncertain_window`."""
    return uncertain_window(model, horizon)[1:]


def _mixed(h: Sequence[Fraction], polynomials: Iterable[Polynomial]) -> Polynomial:
    """Return sum_k h_k polynomial_k."""
    out: Polynomial = {}
    for x, polynomial in zip(h, polynomials, strict=True):
        if not x:
            continue
        for alpha, c in polynomial.items():
            out[alpha] = out.get(alpha, ZERO) + x * c
    return {alpha: c for alpha, c in out.items() if c}


def _at(polynomial: Polynomial, v: Sequence[Fraction]) -> Fraction:
    """Return the value at v."""
    value = ZERO
    for alpha, c in polynomial.items():
        for x, e in zip(v, alpha, strict=True):
            if e:
                c *= x**e
        value += c
    return value


def _on_box(polynomial: Polynomial, middle: Sequence[Fraction], radius: Sequence[Fraction]) -> Polynomial:
    """Return the polynomial in w of v = middle + radius w."""
    for i, (m, r) in enumerate(zip(middle, radius, strict=True)):
        out: Polynomial = {}
        for alpha, c in polynomial.items():
            for d in range(alpha[i] + 1):
                factor = math.comb(alpha[i], d) * m ** (alpha[i] - d) * r**d  # the binomial theorem
                if factor:
                    beta = (*alpha[:i], d, *alpha[i + 1 :])
                    out[beta] = out.get(beta, ZERO) + c * factor
        polynomial = out
    return polynomial


def _span(polynomial: Polynomial) -> Ends:
    """Return (low, high), which holds all values over [-1, 1]^n: each monomial by itself."""
    low = high = ZERO
    for alpha, c in polynomial.items():
        if not any(alpha):
            low, high = low + c, high + c
        elif all(e % 2 == 0 for e in alpha):
            low, high = low + min(c, ZERO), high + max(c, ZERO)
        else:
            low, high = low - abs(c), high + abs(c)
    return low, high
