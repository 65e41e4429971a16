"""Questions about zonotopes and constrained zonotopes, as equations M x = d for x in [-1, 1]^q: rounded once,
or exact.
"""

import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.zonotopes.constrained import AnySet, exact, parts
from jaxbound.sets.zonotopes.kernels import settled
from jaxbound.sets.zonotopes.proof import library

Parts: TypeAlias = tuple[Any, Any, Any, Any]
"""(c, G, A, b), of NumPy on the host, of jax inside jit."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Question:
    """A question, "contains", "contains_set", "is_empty" or "intersects", about sets [(c, G, A, b)] with one
    batch axis.

    Fields: name; sets; points (S, N, n), None for all but "contains".
    """

    name: str = field(metadata={"static": True})
    sets: tuple[Parts, ...]
    points: np.ndarray | jax.Array | None

    def equations(self) -> tuple[Any, Any]:
        """Return M (S, m, q) and D (S, N, m), the latter rounded once, for all points at once.

        Of "contains_set" D holds the difference of the centers, then the generators of the inner set.
        """
        (c, G, A, b), *others = self.sets
        xp, (S, k) = library(c), b.shape
        if self.name == "is_empty":
            return A, b[:, None]
        M = xp.concatenate([G, A], 1)
        with np.errstate(over="ignore", invalid="ignore"):
            if self.points is not None:
                beside = xp.broadcast_to(b[:, None], (*self.points.shape[:2], k))
                return M, xp.concatenate([self.points - c[:, None], beside], 2)
            c2, G2, A2, b2 = others[0]
            apart = xp.concatenate([c2 - c, b], 1)[:, None]
            p = G2.shape[2]
            if self.name == "contains_set":
                columns = xp.concatenate([G2, xp.zeros((S, k, p), c.dtype)], 1)
                return M, xp.concatenate([apart, columns.swapaxes(1, 2)], 1)
        first = xp.concatenate([M, xp.zeros((S, len(A2[0]), M.shape[2]), c.dtype)], 1)
        second = xp.concatenate([-G2, xp.zeros((S, k, p), c.dtype), A2], 1)
        return xp.concatenate([first, second], 2), xp.concatenate([apart, b2[:, None]], 2)

    def known(self) -> np.ndarray | jax.Array:
        """Return (S, N), true where all numbers are finite: an overflow or NaN in a set, or a point, decides
        nothing. Inside jit, too, where centers and points differ by less than what may be read as 0.
        """
        c, points = self.sets[0][0], self.points
        xp, known = library(c), np.ones(len(c), bool)
        for v in (v for x in self.sets for v in x):
            known = known & xp.isfinite(v).all(tuple(range(1, v.ndim)))
        others = self.sets[-1][0][:, None] if points is None else points
        known = known[:, None] & xp.isfinite(others).all(2)
        if xp is np:
            return known
        away = jnp.abs(others - c[:, None])
        return known & jnp.all((away >= 4 * rounding.tiny(c.dtype)) | (others == c[:, None]), 2)

    def exact(self, at: tuple[int, int]) -> tuple[list[list[Fraction]], list[list[Fraction]]]:
        """Return M and the columns D of one question (set i, point j) in Fractions, nothing rounded."""
        i, j = at
        sets: Any = tuple(tuple(_fractions(v[i : i + 1]) for v in x) for x in self.sets)
        points = None if self.points is None else _fractions(self.points[i : i + 1, j : j + 1])
        M, D = Question(self.name, sets, points).equations()
        return M[0].tolist(), D[0].T.tolist()


_fractions = np.vectorize(Fraction, otypes=[object])


def numbers(*sets: AnySet | Interval, points: ArrayLike | None = None) -> list[Parts]:
    """Return (c, G, A, b) of each set: in float64 on the host, exactly; of one dtype if some of them, or the
    points, are inside jit.
    """
    found = [parts(exact(S)) for S in sets]
    if not is_traced(found, points):
        return [
            (np.asarray(c, float), np.asarray(G, float), np.asarray(A, float), np.asarray(b, float))
            for c, G, A, b in found
        ]
    leaves, tree = jax.tree.flatten(found)
    dtype = jnp.result_type(*leaves, *([] if points is None else [points]), np.float32)
    return jax.tree.unflatten(tree, settled(*(rounding.widened(normal(x), dtype) for x in leaves)))


def normal(x: ArrayLike) -> jax.Array:
    """Return x with NaN for numbers below the smallest normal one, of which nothing is decided inside jit: it
    would read them as 0.
    """
    x = jnp.asarray(x)
    if not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    info = jnp.finfo(x.dtype)
    bits = jax.lax.bitcast_convert_type(x, jnp.dtype(f"uint{info.bits}"))  # a comparison would read 0, too
    of_size = bits << 1
    return jnp.where((of_size != 0) & (of_size >> (info.nmant + 1) == 0), jnp.nan, x)


def flat(sets: Parts, batch: tuple[int, ...]) -> Parts:
    """Give the parts of a set one batch axis in place of those of `batch`."""
    c, G, A, b = (x.reshape((math.prod(batch), *x.shape[len(batch) :])) for x in sets)
    return c, G, A, b
