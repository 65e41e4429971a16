"""A window whose sensor tolerances keep one value: exact rationals over unknowns and gains g_i = 1 / (1 +
theta_i), one an output.

    g_i (d_j - rho_j) <= (E z + K U)_j <= g_i (d_j + rho_j),   1 / (1 + sigma_i) <= g_i <= 1 / (1 - sigma_i)
    j: samples of output i

is linear in (z, g). If nothing keeps all of it, one combination h of the rows, with h E = 0, shows that for
all gains at once: the sum over i of g_i (h d -+ |h| rho)_i, whose ends lie at those of g, does not hold h K U
(Farkas' lemma, the sums over z and over a reading's two sides carried out).

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from jaxbound.certificates.blame import DIGITS
from jaxbound.certificates.exact_window import ExactWindow, Explanation
from jaxbound.exact import linalg
from jaxbound.exact.chebyshev import chebyshev
from jaxbound.exact.linalg import dot

__all__ = ["ConstantWindow"]

ZERO, ONE = Fraction(0), Fraction(1)


class ConstantWindow(ExactWindow):
    """An ExactWindow with one gain an output."""

    def solve(self, start: Any = None) -> Explanation:
        """Return the Explanation of this window: factor > 1 where no unknowns and gains keep all rows, its
        size that of no bound.
        """
        (E, K), missing, p = self.forms, self.missing_inputs, self.model.p
        unknowns = [(*e, *(k[j] for j in missing)) for e, k in zip(E, K, strict=True)]
        own = lambda i, value: tuple(value if j == i else ZERO for j in range(p))
        rows, middles, radii, signs = [], [], [], []

        def add(j, sign, row, gain, middle, radius):
            signs.append((j, sign))
            rows.append((*(sign * x for x in row), *gain))
            middles.append(middle)
            radii.append(radius)

        for j, (d, rho) in enumerate(self.readings()):
            if d is None:
                continue
            reach = rho * self._ends(j % p)[1]  # both sides of a reading lie in [0, 2 reach]
            add(j, 1, unknowns[j], own(j % p, rho - d), reach - self.drive[j], reach)
            add(j, -1, unknowns[j], own(j % p, rho + d), reach + self.drive[j], reach)
        for j in range(len(self.y), len(self.limits)):
            lo, hi = self.known_limits(j)
            add(j, 1, unknowns[j], (ZERO,) * p, (lo + hi) / 2 - self.drive[j], (hi - lo) / 2)
        for i in range(p):
            lo, hi = self._ends(i)
            if lo < hi:
                add(0, 0, unknowns[0], own(i, ONE), (lo + hi) / 2, (hi - lo) / 2)
        rows, middles = self._with_known_gains(rows, middles)
        best = chebyshev(rows, middles, radii, start)
        found = [ZERO] * len(self.limits)
        for (j, sign), x in zip(signs, best.h, strict=True):
            found[j] += sign * x
        h = linalg.presentable(linalg.primitive(found)) if any(found) else super().solve().h
        return Explanation(best.t, tuple(h), *self.relation(h), best.z[: len(unknowns[0])], best.reference)

    def relation(self, h: Sequence[Fraction]) -> tuple[tuple[Fraction, ...], Fraction, Fraction]:
        """Return (k, residual, width) of a relation h that annihilates E and needs no missing sample, under
        any gains.
        """
        p, low, high = self.model.p, ZERO, ZERO
        used = [(j, h[j], d, rho) for j, (d, rho) in enumerate(self.readings()) if h[j] and d is not None]
        for i in range(p):
            mine = [(x, d, rho) for j, x, d, rho in used if j % p == i]
            middle = dot([x for x, _, _ in mine], [d for _, d, _ in mine])
            reach = dot([abs(x) for x, _, _ in mine], [rho for _, _, rho in mine])
            low += min(g * (middle - reach) for g in self._ends(i))
            high += max(g * (middle + reach) for g in self._ends(i))
        for number, x in enumerate(h[len(self.y) :], len(self.y)):
            lo, hi = self.known_limits(number)
            low, high = low + min(x * lo, x * hi), high + max(x * lo, x * hi)
        return self.action(h), (low + high) / 2 - dot(h, self.drive), (high - low) / 2

    def gains(self, z: Sequence[Fraction]) -> tuple[Fraction, ...] | None:
        """Return gains with which unknowns z keep every reading, or None."""
        p, true = self.model.p, self.rows_at(z)
        ends = [list(self._ends(i)) for i in range(p)]
        for j, (d, rho) in enumerate(self.readings()):
            if d is None:
                continue
            for slope, least in ((rho + d, true[j]), (rho - d, -true[j])):  # gain times slope >= least
                if slope > 0:
                    ends[j % p][0] = max(ends[j % p][0], least / slope)
                elif slope < 0:
                    ends[j % p][1] = min(ends[j % p][1], least / slope)
                elif least > 0:
                    return None
        return tuple(_short(lo, hi) for lo, hi in ends) if all(lo <= hi for lo, hi in ends) else None

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns z and some gains keep every row within its limits."""
        true = self.rows_at(z)
        for number in range(len(self.y), len(true)):
            lo, hi = self.known_limits(number)
            if not lo <= true[number] <= hi:
                return False
        return self.gains(z) is not None

    def _ends(self, i):
        return 1 / (1 + self.tolerance[i]), 1 / (1 - self.tolerance[i])

    def _with_known_gains(self, rows, middles):
        """Take the gains that are known to be 1 to the other side."""
        known = [i - self.model.p for i in range(self.model.p) if not self.tolerance[i]]
        moved = [m - sum((row[i] for i in known), ZERO) for row, m in zip(rows, middles, strict=True)]
        return [[x for i, x in enumerate(row, -len(row)) if i not in known] for row in rows], moved


def _short(lo, hi):
    """Return a number between lo and hi, of few digits where one is."""
    middle = (lo + hi) / 2
    rounded = (Fraction(f"{float(middle):.{digits}g}") for digits in DIGITS)
    return next((x for x in rounded if lo <= x <= hi), middle)
