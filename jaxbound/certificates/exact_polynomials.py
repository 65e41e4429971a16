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

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import product
from typing import Any

import numpy as np

from jaxbound.certificates.exact_window import ExactWindow, exact_window
from jaxbound.exact.chebyshev import subspace
from jaxbound.exact.linalg import dot
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.relations.uncertain_window import uncertain_window
from jaxbound.sets.floats import rounding

__all__ = ["FixedWindow", "PolynomialWindow", "polynomial_window"]

ZERO, ONE = Fraction(0), Fraction(1)
HALVINGS = 90
REFINEMENTS, ENOUGH = 10, 1e-30


@dataclass(frozen=True)
class FixedWindow(ExactWindow):
    """A window at chosen parameters: forms are its (E, K), variables the parameters."""

    forms: tuple = ()
    variables: tuple = ()

    def space(self, rows: Sequence[int]) -> Any:
        """Return the Subspace of some rows over all unknowns."""
        E, K = self.forms
        return subspace([E[i] + tuple(K[i][j] for j in self.missing_inputs) for i in rows])


@dataclass(frozen=True, eq=False)
class PolynomialWindow:
    """Relations and samples of one window. Fields: relations, that need no missing sample; window; bounds of
    the uncertainties.
    """

    relations: UncertainRelations
    window: ExactWindow
    bounds: tuple

    @cached_property
    def size(self) -> tuple[Fraction, ...]:
        """The bounds of the variables."""
        names = [u.name for u in self.relations.model.uncertainties]
        return tuple(self.bounds[names.index(name)] for name, _ in self.relations.variables)

    @cached_property
    def parts(self) -> tuple[list[dict], list[list[dict]]]:
        """(P, Q): P[k] and Q[j][k], polynomials {alpha: Fraction}; a row j that is missing has no part."""
        r, limits, offset = self.relations, self.window.limits, self.window.model.offset["u"]
        mid = [ZERO if x is None else (x[0] + x[1]) / 2 for x in limits]
        rad = [ZERO if x is None else (x[1] - x[0]) / 2 for x in limits]
        U = [ZERO if v is None else v - offset[j % r.model.m] for j, v in enumerate(self.window.u)]
        P: list[dict] = [{} for _ in range(r.count)]
        Q: list[list[dict]] = [[{} for _ in range(r.count)] for _ in limits]
        for matrix, values, sign in ((r.N, mid, 1), (r.K, U, -1)):
            for alpha, entries in matrix.terms.items():
                for (k, j), x in entries.items():
                    P[k][alpha] = P[k].get(alpha, ZERO) + sign * x * values[j]
                    if sign == 1 and rad[j]:
                        Q[j][k][alpha] = x * rad[j]
        return P, Q

    def spread(
        self, h: Sequence[Fraction], lo: Sequence[Fraction], hi: Sequence[Fraction], vertices: bool
    ) -> tuple[Fraction, Fraction]:
        """Return (low, high), which holds h p over the box lo <= v <= hi and all e: exact if `vertices`."""
        P, Q = self.parts
        whole, noise = _mixed(h, P), [_mixed(h, q) for q in Q if any(q)]
        if vertices:
            ends = []
            for v in product(*zip(lo, hi, strict=True)):
                middle, reach = _at(whole, v), sum(abs(_at(q, v)) for q in noise)
                ends += [middle - reach, middle + reach]
            return min(ends), max(ends)
        middle, radius = (
            zip(*(((b + a) / 2, (b - a) / 2) for a, b in zip(lo, hi, strict=True)), strict=True)
            if lo
            else ((), ())
        )
        low, high = _span(_on_box(whole, middle, radius))
        reach = sum(max(map(abs, _span(_on_box(q, middle, radius)))) for q in noise)
        return low - reach, high + reach

    def at(self, v: Sequence[Fraction]) -> FixedWindow:
        """Return the FixedWindow at parameters v: what is left is linear."""
        w, s = self.window, self.window.horizon
        model, (_, E, H, V) = w.model, _matrices(w.model, s)
        E, H, V = (m.at(v) for m in (E, H, V))
        n, g = model.n, model.g * s
        rows = [(*e[:n], *x, *e[n:]) for e, x in zip(E, V, strict=True)]
        width = len(rows[0]) - n - g
        rows += [
            (ZERO,) * n + tuple(ONE if i == j else ZERO for j in range(g)) + (ZERO,) * width for i in range(g)
        ]
        K = tuple(H) + (((ZERO,) * len(w.u),) * g)
        known = [ZERO if x is None else x - model.offset["u"][j % model.m] for j, x in enumerate(w.u)]
        names = {f: getattr(w, f) for f in ExactWindow.__dataclass_fields__}
        names["drive"] = tuple(dot(row, known) for row in K)
        return FixedWindow(**names, forms=(tuple(rows), K), variables=tuple(v))

    def zero_between(self, lo_end: tuple, hi_end: tuple) -> tuple[Fraction, ...]:
        """Return v where the single relation vanishes on the way from (v, e) with p <= 0 to (v, e) with p >=
        0, nearly.
        """
        P, Q = self.parts[0][0], [q[0] for q in self.parts[1]]
        below, above = ZERO, ONE
        (v0, e0), (v1, e1) = lo_end, hi_end
        mix = lambda a, b, t: tuple(x + t * (y - x) for x, y in zip(a, b, strict=True))
        for _ in range(HALVINGS):
            t = (below + above) / 2
            v, e = mix(v0, v1, t), mix(e0, e1, t)
            value = _at(P, v) + sum((x * _at(q, v) for x, q in zip(e, Q, strict=True) if q and x), ZERO)
            below, above = (below, t) if value > 0 else (t, above)
        return mix(v0, v1, below)

    def ends(self) -> list[tuple]:
        """Return ((v, e) where the single relation is least over the box, (v, e) where it is largest):
        multi-affine relations only.
        """
        P, Q = self.parts[0][0], [q[0] for q in self.parts[1]]
        found = []
        for v in product(*((-x, x) for x in self.size)):
            middle, reach = _at(P, v), [_at(q, v) for q in Q]
            toward = tuple(ZERO if not x else ONE if x > 0 else -ONE for x in reach)
            total = sum(map(abs, reach), ZERO)
            found += [(middle - total, v, tuple(-x for x in toward)), (middle + total, v, toward)]
        return [(v, e) for _, v, e in (min(found, key=lambda x: x[0]), max(found, key=lambda x: x[0]))]

    def near(self, v: np.ndarray, e: np.ndarray) -> tuple[Fraction, ...] | None:
        """Return v near the given one, within its box, where p(v, e) = 0 almost exactly for some e, or None:
        Newton's method, exact values.

        Args: v (floats, in units of size), e (floats, one for each row).
        """
        P, Q = self.parts
        x, n = [Fraction(float(a)) for a in (*v, *e)], len(v)
        for _ in range(REFINEMENTS):
            point = [a * s for a, s in zip(x[:n], self.size, strict=True)]
            noise = [(b, q) for b, q in zip(x[n:], Q, strict=True) if b]
            p = [
                _at(row, point) + sum((b * _at(q[k], point) for b, q in noise), ZERO)
                for k, row in enumerate(P)
            ]
            J, room = self._slopes(list(map(float, x))), np.maximum(1 - np.abs(list(map(float, x))), 0)
            scale = np.abs(J) @ room
            if not (scale > 0).all():
                return None
            gap = np.array([float(a / Fraction(b)) for a, b in zip(p, scale.tolist(), strict=True)])
            if np.abs(gap).max() < ENOUGH:
                break
            K = J / scale[:, None]
            step = room * (K.T @ np.linalg.lstsq(K * room @ K.T, gap, rcond=None)[0])
            x = [max(-ONE, min(a - Fraction(d), ONE)) for a, d in zip(x, step.tolist(), strict=True)]
        return tuple(a * s for a, s in zip(x[:n], self.size, strict=True))

    def _slopes(self, x):
        """Return the derivative of p by (v / size, e), floats (count, n + rows)."""
        P, Q = self.parts
        n, size = len(self.size), list(map(float, self.size))
        v, e = [a * s for a, s in zip(x, size, strict=False)], x[n:]
        power = lambda alpha, i: math.prod(
            a**b for l, (a, b) in enumerate(zip(v, alpha, strict=True)) if b and l != i
        )
        slope = lambda f, i: (
            sum(float(c) * a[i] * v[i] ** (a[i] - 1) * power(a, i) for a, c in f.items() if a[i]) * size[i]
        )
        value = lambda f: sum(float(c) * power(a, None) for a, c in f.items())
        by_v = [
            [slope(f, i) + sum(b * slope(q[k], i) for b, q in zip(e, Q, strict=True) if b) for i in range(n)]
            for k, f in enumerate(P)
        ]
        return np.array([[*row, *(value(q[k]) for q in Q)] for k, row in enumerate(by_v)])


def polynomial_window(relations: UncertainRelations, u: np.ndarray, y: np.ndarray) -> PolynomialWindow:
    """Return the PolynomialWindow of samples u (s+1, m), y (s+1, p); the relations must need none that is
    missing.
    """
    bounds = rounding.round_up(np.asarray(relations.bounds["parameters"], np.float64), y.dtype)
    return PolynomialWindow(relations, exact_window(relations, u, y), tuple(map(Fraction, bounds.tolist())))


@lru_cache(maxsize=16)
def _matrices(model, horizon):
    return uncertain_window(model, horizon)


def _mixed(h, polynomials):
    """Return sum_k h_k polynomial_k."""
    out: dict = {}
    for x, polynomial in zip(h, polynomials, strict=True):
        for alpha, c in polynomial.items() if x else ():
            out[alpha] = out.get(alpha, ZERO) + x * c
    return {alpha: c for alpha, c in out.items() if c}


def _at(polynomial, v):
    """Return the value at v."""
    return sum(
        (
            c * math.prod((x**e for x, e in zip(v, alpha, strict=True) if e), start=ONE)
            for alpha, c in polynomial.items()
        ),
        ZERO,
    )


def _on_box(polynomial, middle, radius):
    """Return the polynomial in w of v = middle + radius w."""
    for i, (m, r) in enumerate(zip(middle, radius, strict=True)):
        out: dict = {}
        for alpha, c in polynomial.items():
            for d in range(alpha[i] + 1):
                factor = math.comb(alpha[i], d) * m ** (alpha[i] - d) * r**d
                if factor:
                    beta = (*alpha[:i], d, *alpha[i + 1 :])
                    out[beta] = out.get(beta, ZERO) + c * factor
        polynomial = out
    return polynomial


def _span(polynomial):
    """Return (low, high), which holds all values over [-1, 1]^n: each monomial by itself."""
    low = high = ZERO
    for alpha, c in polynomial.items():
        if not any(alpha):
            low, high = low + c, high + c
        elif all(e % 2 == 0 for e in alpha):
            low, high = low + min(c, 0), high + max(c, 0)
        else:
            low, high = low - abs(c), high + abs(c)
    return low, high
