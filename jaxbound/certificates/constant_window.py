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
from dataclasses import dataclass, field
from fractions import Fraction

from jaxbound.certificates.exact_window import DIGITS, Ends, ExactWindow, Explanation, readable_relation
from jaxbound.exact.chebyshev import Reference, chebyshev
from jaxbound.exact.linalg import Vector, dot, scale

__all__ = ["ConstantWindow"]

ZERO, ONE = Fraction(0), Fraction(1)


@dataclass
class _Sides:
    """The sides of all bounds as rows of a Chebyshev problem in (z, g): |middle - row (z, g)| <= radius.

    Fields: free: the gains that are unknowns, by their output; the others are 1. rows, middles, radii; signs:
    (row of (Y, w), sign) that each speaks of, sign 0: of a gain alone.
    """

    free: Sequence[int]
    rows: list[Vector] = field(default_factory=list)
    middles: list[Fraction] = field(default_factory=list)
    radii: list[Fraction] = field(default_factory=list)
    signs: list[tuple[int, int]] = field(default_factory=list)

    def add(
        self,
        place: tuple[int, int],
        unknowns: Vector,
        middle: Fraction,
        r: Fraction,
        gain: tuple[int | None, Fraction] = (None, ZERO),
    ) -> None:
        """Add middle - r <= sign unknowns z + g_i value <= middle + r; gain: (i, value)."""
        i, value = gain
        if i is not None and i not in self.free:
            middle -= value
        self.rows.append((*scale(unknowns, place[1]), *(value * (i == other) for other in self.free)))
        self.middles.append(middle)
        self.radii.append(r)
        self.signs.append(place)


class ConstantWindow(ExactWindow):
    """An ExactWindow with one gain an output."""

    def solve(self, start: Reference | None = None) -> Explanation:
        """Return the Explanation of this window: factor > 1 where no unknowns and gains keep all rows, its
        size that of no bound.
        """
        sides = self._sides()
        best = chebyshev(sides.rows, sides.middles, sides.radii, start)
        h = [ZERO] * len(self.limits)
        for (j, sign), x in zip(sides.signs, best.h, strict=True):
            h[j] += sign * x  # both sides of a reading together: Farkas' lemma, see the module
        if not any(h):
            h = list(super().solve().h)
        shown = readable_relation(h)
        z = best.z[: len(self.unknown_columns()[0])]  # the gains follow from it
        return Explanation(best.t, shown, *self.relation(shown), z, best.reference)

    def _sides(self) -> _Sides:
        """Return the rows of the module in (z, g)."""
        p, unknowns = self.model.p, self.unknown_columns()
        sides = _Sides([i for i, sigma in enumerate(self.tolerance) if sigma])
        for j, (d, rho) in enumerate(self.readings()):
            if d is None:
                continue
            i = j % p
            # 0 <= E z + K U + g (rho - d) and 0 <= g (rho + d) - E z - K U: each is at most 2 reach
            reach = rho * self._gain_ends(i)[1]
            sides.add((j, 1), unknowns[j], reach - self.drive[j], reach, (i, rho - d))
            sides.add((j, -1), unknowns[j], reach + self.drive[j], reach, (i, rho + d))
        for j in range(len(self.y), len(self.limits)):
            lo, hi = self.known_limits(j)
            sides.add((j, 1), unknowns[j], (lo + hi) / 2 - self.drive[j], (hi - lo) / 2)
        for i in sides.free:
            lo, hi = self._gain_ends(i)
            sides.add((0, 0), unknowns[0], (lo + hi) / 2, (hi - lo) / 2, (i, ONE))
        return sides

    def relation(self, h: Sequence[Fraction]) -> tuple[Vector, Fraction, Fraction]:
        """Return (k, residual, width) of a relation h that annihilates E and needs no missing sample, under
        any gains.
        """
        p, readings = self.model.p, self.readings()
        low, high = ZERO, ZERO
        for i in range(p):
            weights, deviations, errors = [], [], []
            for x, (d, rho) in zip(h[i : len(self.y) : p], readings[i::p], strict=True):
                if x and d is not None:
                    weights.append(x)
                    deviations.append(d)
                    errors.append(rho)
            # g (h d -+ |h| rho): linear in the gain, so extreme at its ends
            middle, reach = dot(weights, deviations), dot(map(abs, weights), errors)
            least, most = self._gain_ends(i)
            low += min(least * (middle - reach), most * (middle - reach))
            high += max(least * (middle + reach), most * (middle + reach))
        for number in range(len(self.y), len(h)):
            lo, hi = self.known_limits(number)
            x = h[number]
            low, high = low + min(x * lo, x * hi), high + max(x * lo, x * hi)
        return self.action(h), (low + high) / 2 - dot(h, self.drive), (high - low) / 2

    def gains(self, z: Sequence[Fraction]) -> Vector | None:
        """Return gains with which unknowns z keep every reading, or None."""
        p, true = self.model.p, self.rows_at(z)
        ends = [list(self._gain_ends(i)) for i in range(p)]
        for j, (d, rho) in enumerate(self.readings()):
            if d is None:
                continue
            lo, hi = ends[j % p]
            for slope, least in ((rho + d, true[j]), (rho - d, -true[j])):  # gain times slope >= least
                if slope > 0:
                    lo = max(lo, least / slope)
                elif slope < 0:
                    hi = min(hi, least / slope)
                elif least > 0:
                    return None
            ends[j % p] = [lo, hi]
        if any(lo > hi for lo, hi in ends):
            return None
        return tuple(_short(lo, hi) for lo, hi in ends)

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns z and some gains keep every row within its limits."""
        true = self.rows_at(z)
        for number in range(len(self.y), len(true)):
            lo, hi = self.known_limits(number)
            if not lo <= true[number] <= hi:
                return False
        return self.gains(z) is not None

    def _gain_ends(self, i: int) -> Ends:
        """Return (lo, hi) of 1 / (1 + theta)."""
        return 1 / (1 + self.tolerance[i]), 1 / (1 - self.tolerance[i])


def _short(lo: Fraction, hi: Fraction) -> Fraction:
    """Return a number between lo and hi, of few digits where one is."""
    middle = (lo + hi) / 2
    for digits in DIGITS:
        short = Fraction(f"{float(middle):.{digits}g}")
        if lo <= short <= hi:
            return short
    return middle
