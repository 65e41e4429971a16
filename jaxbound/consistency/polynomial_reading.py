"""Uncertain relations as kernels read them, and the polynomials of every window.

With the true outputs and disturbances z_j = mid_j + rad_j xi_j, |xi_j| <= 1, a healthy window satisfies for
some v in the box

    sum over alpha of v^alpha (N_alpha z - K_alpha U) = 0.

Source: Ploix, Adrot 2006, (6), (14).
"""

# mypy: allow-empty-bodies
# of members that are declared for whoever checks types, and have their values elsewhere

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.interface import Relations
from jaxbound.consistency.reading import Reading
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import total

Exponents: TypeAlias = tuple[tuple[int, ...], ...]
"""Monomials v^alpha, an exponent for each variable; the first is the constant."""


class Polynomials(NamedTuple):
    """The relations of N windows as polynomials in v and xi: see `PolynomialReading.polynomials`.

    Fields: value, error (count, K, N), or one error (count, N) of each row; spread (count, K, R); rad (R, N).
    """

    value: jax.Array
    error: jax.Array
    spread: jax.Array
    rad: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PolynomialReading:
    """Uncertain relations in floats: arrays are traced, so models of one shape share a compilation.

    Fields: window, how rows z are read; N (count, K, R) and K (count, K, l), nearest to the exact
    coefficients; size (nv,), the bounds |v_i| <= size_i; exponents, K tuples of which the first is all zeros;
    noisy, the rows whose xi_j is kept as a variable: the others are known to a few units roundoff, which
    count as rounding.
    """

    window: Reading
    N: jax.Array
    K: jax.Array
    size: jax.Array
    exponents: Exponents = field(metadata={"static": True})
    noisy: tuple[int, ...] = field(metadata={"static": True})

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""
        return self.window.horizon

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return self.window.lags

    @property
    def count(self) -> int:
        """Number of relations."""
        return self.N.shape[0]

    def polynomials(self, u: jax.Array, y: jax.Array) -> Polynomials:
        """Return (value, error, spread, rad): the relations of every window as polynomials in v and xi within
        [-1, 1].

        A window is consistent with the relations iff for some |v_i| <= 1 and |xi_j| <= 1, all relations k at
        once,

            sum_a value[k, a] v^exponents[a] + sum_j (sum_a spread[k, a, j] v^exponents[a]) rad[j] xi_j = 0.

        Args:
            u: (lags or more, m, N) and y: (s + 1, p, N), samples of N windows as recorded, NaN where missing;
                one dtype.

        Returns:
            value (count, K, N), where value[k, 0] is NaN if relation k needs a missing sample (what else is
            said of k then means nothing); error (count, K, N); spread (count, K, R') and rad (R', N) for the
            noisy rows.

        Encloses: with coefficients and bounds as exact as the model's, in real arithmetic, the value of
        relation k at v and xi is within sum_a error[k, a] |v^exponents[a]| of the above. With an infinite
        sample all errors are infinite.

        Proof: value is a sum of products as in `rounding.residual_error`, each factor of size^alpha one more
        rounding of a coefficient; a coefficient or product that is flushed costs tiny times the magnitudes
        that it multiplies, which `floor` counts. The bound is taken twice: for value, and for the noise
        terms, whose magnitudes are part of `scale`.
        """
        mid, rad, scale, known, known_scale = self.window.block(u[: self.window.lags], y)
        N, coefficients = self._scaled(self.N), self._scaled(jnp.concatenate([self.N, -self.K], 2))
        x, magnitude = jnp.concatenate([mid, known]), jnp.concatenate([scale, known_scale])
        gone = jnp.isnan(magnitude)
        # then the radius is finite: it is part of the magnitude
        fine = jnp.isfinite(x) & jnp.isfinite(magnitude)
        x, magnitude = jnp.where(fine, x, 0), jnp.where(fine, magnitude, 0)
        rad = jnp.where(fine[: len(rad)], rad, 0)
        # an infinite sample: nothing is proved, and nothing is missing
        broken = jnp.any(~fine & ~gone, 0)
        value, size = _times(coefficients, x), _times(abs(coefficients), magnitude)
        absent = jnp.any(jnp.any(coefficients != 0, 1)[..., None] & gone[None], 1)
        order = max(map(sum, self.exponents))
        gamma, least = rounding.residual_error(self.N.shape[2] + self.K.shape[2] + order + 2, mid.dtype)
        floor = (least * (1 + jnp.sum(magnitude, 0)) * self._lift(order))[None, None]
        error = jnp.where(broken[None, None], jnp.inf, 2 * (gamma * size + floor))
        # known to a few roundings: cheaper as an error than as a variable of its own
        quiet = np.array([j for j in range(mid.shape[0]) if j not in self.noisy], int)
        if len(quiet):
            rest = jnp.sum(jnp.sum(abs(N[:, :, quiet]), 1)[..., None] * rad[quiet][None], 1)
            error = error.at[:, 0].add((1 + gamma) * rest)
        noisy = np.array(self.noisy, int)
        value = value.at[:, 0].set(jnp.where(absent, jnp.nan, value[:, 0]))
        return Polynomials(value, error, N[:, :, noisy], rad[noisy])

    def _scaled(self, coefficients: jax.Array) -> jax.Array:
        """Return coefficients for v in [-1, 1]: times size^alpha."""
        powers, exponents = jnp.ones(len(self.exponents), self.size.dtype), np.array(self.exponents, int)
        for i in range(exponents.shape[1]):
            for e in range(exponents[:, i].max(initial=0)):
                powers = powers * jnp.where(exponents[:, i] > e, self.size[i], 1)
        return coefficients * powers[None, :, None]

    def _lift(self, order: int) -> jax.Array:
        """Return at least every factor that multiplies something after its own rounding."""
        power = jnp.ones((), self.size.dtype)
        for _ in range(order):
            power = power * jnp.maximum(1, jnp.max(self.size, initial=0))
        lift = self.window.lift
        return lift * (1 + jnp.max(abs(self.N), initial=0) + jnp.max(abs(self.K), initial=0)) * power


def _times(coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Return (count, K, N): coefficients (count, K, R) times x (R, N), term by term."""
    return total(coefficients[:, :, j, None] * x[j][None, None] for j in range(len(x)))


class PolynomialRelations(Relations):
    """Relations polynomial in uncertain parameters: `relations.uncertain` has them."""

    uncertain: ClassVar[bool] = True
    untuned: ClassVar[str | None] = None

    if TYPE_CHECKING:

        @property
        def variables(self) -> tuple[tuple[str, int | None], ...]:
            """((name of the parameter, lag or None), ..): what the polynomials are in."""

        @property
        def complete(self) -> str:
            """Whether the relations say all that can be said: "proved", "sampled" or "partial"."""

    @property
    def exponents(self) -> Exponents:
        """The monomials of the relations and all that divide one of them, orders ascending."""
        raise NotImplementedError

    def reading(self, dtype: DTypeLike, method: str = "joint") -> PolynomialReading:
        """Return the PolynomialReading of these relations in a float dtype."""
        raise NotImplementedError

    def without(self, rows: Collection[int], inputs: Collection[int]) -> Self | None:
        """Return relations of the same window that need neither these of its rows nor these of its inputs, or
        None if there are none.
        """
        raise NotImplementedError
