"""A window whose sensor tolerances keep one value: exact rationals over unknowns and gains g_i = 1 / (1 +
theta_i), one an output.

    g_i (d_j - rho_j) <= (E z + K U)_j <= g_i (d_j + rho_j),   1 / (1 + sigma_i) <= g_i <= 1 / (1 - sigma_i)
    j: samples of output i

is linear in (z, g). If nothing keeps all of it, one combination h of the rows, with h E = 0, shows that for
all gains at once: the sum over i of g_i (h d -+ |h| rho)_i, whose ends lie at those of g, does not hold h K U
(Farkas' lemma, the sums over z and over a reading's two sides carried out).

Source: Adrot, Maquin, Ragot 2000, (7)-(9), with theta constant as in Adrot 1999.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from typing import ClassVar

from jaxbound.certificates.exact_window import Bound, Ends, ExactWindow, Explanation
from jaxbound.exact.linalg import Vector, scale

ZERO, ONE = Fraction(0), Fraction(1)


class ConstantWindow(ExactWindow):
    """An ExactWindow with one gain an output. Its unknowns are (z, gains of outputs with a tolerance)."""

    unweighed: ClassVar[str] = (
        "named faults are not weighed beside constant_tolerance: give the tolerance as noise"
    )

    @cached_property
    def free(self) -> list[int]:
        """The outputs whose gains are unknowns; the others are 1."""
        return [i for i, sigma in enumerate(self.tolerance) if sigma]

    def solve(self) -> Explanation:
        """Return the Explanation of this window: factor > 1 where no unknowns and gains keep all rows, its
        size that of no bound.
        """
        best = super().solve()  # both sides of a reading together: Farkas' lemma, see the module
        if any(best.h):
            return best
        h = ExactWindow(self.model, self.horizon, self.claim, self.whole, self.lags).solve().h
        return Explanation(best.factor, h, *self.relation(h), best.z)

    def bounds(self) -> Iterator[Bound]:
        """Yield the rows of the module in (z, g)."""
        p, none = self.model.p, (ZERO,) * len(self.free)
        for bound in super().bounds():
            if bound.number >= len(self.y):
                yield bound._replace(row=(*bound.row, *none))
                continue
            i, (lo, hi) = bound.number % p, self.known_limits(bound.number)
            # 0 <= E z + K U - g lo and 0 <= g hi - E z - K U: each is at most 2 reach
            reach = bound.radius * self.gain_ends(i)[1]
            for sign, value in ((1, -lo), (-1, hi)):
                middle = reach - sign * self.drive[bound.number]
                if i not in self.free:
                    middle -= value
                row = (*scale(bound.row, sign), *(value * (i == other) for other in self.free))
                yield Bound(bound.number, sign, row, middle, reach)
        nothing = (ZERO,) * len(self.unknown_columns()[0])
        for i in self.free:
            lo, hi = self.gain_ends(i)
            row = (*nothing, *(ONE * (i == other) for other in self.free))
            yield Bound(0, 0, row, (lo + hi) / 2, (hi - lo) / 2)

    def rows_at(self, z: Sequence[Fraction]) -> Vector:
        """Return the true (Y, w) at unknowns (z, gains)."""
        return super().rows_at(z[: len(z) - len(self.free)])

    def gains(self, z: Sequence[Fraction]) -> Vector:
        """Return the gain of every output at unknowns (z, gains)."""
        known = dict(zip(self.free, z[len(z) - len(self.free) :], strict=True))
        return tuple(known.get(i, ONE) for i in range(self.model.p))

    def limits_at(self, z: Sequence[Fraction]) -> list[Ends | None]:
        """Return the limits of each row at unknowns (z, gains)."""
        limits, gains = list(self.limits), self.gains(z)
        for j, ends in enumerate(limits[: len(self.y)]):
            if ends is not None:
                lo, hi = ends
                g = gains[j % self.model.p]
                limits[j] = g * lo, g * hi
        return limits

    def explained_by(self, z: Sequence[Fraction]) -> bool:
        """Return True if unknowns (z, gains) keep every row and gain within its limits."""
        for i, g in enumerate(self.gains(z)):
            lo, hi = self.gain_ends(i)
            if not lo <= g <= hi:
                return False
        return super().explained_by(z)
