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
from jaxbound.sets.zonotopes.constrained import AnySet, parts
from jaxbound.sets.zonotopes.kernels import settled
from jaxbound.sets.zonotopes.proof import library

__all__ = ["Question", "flat", "normal", "numbers", "traced"]


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
        """Return M (S, m, q) and d (S, N, m), the latter rounded once."""
        c, G, A, b = self.sets[0]
        xp = library(c)
        if self.name == "is_empty":
            return A, b[:, None]
        if self.points is not None:
            beside = xp.broadcast_to(b[:, None], (*self.points.shape[:2], b.shape[-1]))
            with np.errstate(over="ignore", invalid="ignore"):
                return xp.concatenate([G, A], 1), xp.concatenate([self.points - c[:, None], beside], 2)
        c2, G2, A2, b2 = self.sets[1]
        zeros = lambda rows, columns: xp.zeros((len(c), rows.shape[1], columns.shape[2]), c.dtype)
        M = xp.concatenate(
            [xp.concatenate(row, 2) for row in ([G, -G2], [A, zeros(A, G2)], [zeros(A2, G), A2])], 1
        )
        with np.errstate(over="ignore", invalid="ignore"):
            return M, xp.concatenate([c2 - c, b, b2], 1)[:, None]

    def known(self) -> Any:
        """Return (S, N), true where all numbers are finite: an overflow or NaN in a set, or a point, decides
        nothing.
        """
        known: Any = True
        for v in (v for x in self.sets for v in x):
            known = known & library(v).isfinite(v).all(tuple(range(1, v.ndim)))
        known = known[:, None] & self._distinct()
        return known if self.points is None else known & library(self.points).isfinite(self.points).all(2)

    def _distinct(self) -> Any:
        """Return (S, N) or True: inside jit, where centers and points differ by no less than what may be read
        as 0, or not at all.
        """
        c, *_ = self.sets[0]
        if library(c) is not jnp or (self.points is None and len(self.sets) < 2):
            return True
        others = self.sets[1][0][:, None] if self.points is None else self.points
        away = jnp.abs(others - c[:, None])
        return jnp.all((away >= 4 * rounding.tiny(c.dtype)) | (others == c[:, None]), 2)

    def exact(self, at: tuple[int, int]) -> tuple[list[list[Fraction]], list[list[Fraction]]]:
        """Return M and D of one question (set i, point j) in Fractions, nothing rounded: d is the first
        column of D.

        Of "contains_set" each generator of the inner set is one more column.
        """
        i, j = at
        (c, G, A, b), *others = [tuple(_exact(v[i]) for v in x) for x in self.sets]
        zero_rows = lambda rows, columns: [[Fraction(0)] * columns for _ in rows]
        less = lambda v, w: [x - y for x, y in zip(v, w, strict=True)]
        if self.name == "is_empty":
            return A, [[v] for v in b]
        if self.points is not None:
            return G + A, [[v] for v in less(_exact(np.asarray(self.points[i, j])), c) + b]
        ((c2, G2, A2, b2),) = others
        if self.name == "contains_set":
            columns = len(G2[0])
            return G + A, [
                [v, *row] for v, row in zip(less(c2, c) + b, G2 + zero_rows(b, columns), strict=True)
            ]
        q, q2 = len(G[0]), len(G2[0])
        M = [[*row, *(-v for v in other)] for row, other in zip(G, G2, strict=True)]
        M += [[*row, *zeros] for row, zeros in zip(A, zero_rows(A, q2), strict=True)]
        M += [[*zeros, *row] for row, zeros in zip(A2, zero_rows(A2, q), strict=True)]
        return M, [[v] for v in less(c2, c) + b + b2]


def _exact(x: np.ndarray) -> list[Any]:
    return [_exact(row) for row in x] if x.ndim > 1 else [Fraction(v) for v in x.tolist()]


def numbers(*sets: AnySet, points: ArrayLike | None = None) -> list[Parts]:
    """Return (c, G, A, b) of each set: in float64 on the host, exactly; of one dtype if some of them, or the
    points, are inside jit.
    """
    found = [parts(S) for S in sets]
    if not traced((found, points)):
        return [
            (np.asarray(c, float), np.asarray(G, float), np.asarray(A, float), np.asarray(b, float))
            for c, G, A, b in found
        ]
    leaves, tree = jax.tree.flatten(found)
    dtype = jnp.result_type(*leaves, *([] if points is None else [points]), np.float32)
    return jax.tree.unflatten(tree, settled(*(rounding.widened(normal(x), dtype) for x in leaves)))


def normal(x: Any) -> jax.Array:
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


def traced(tree: object) -> bool:
    """Return whether some of the arrays are inside jit, vmap or scan."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(tree))


def flat(sets: Parts, batch: tuple[int, ...]) -> Parts:
    """Give the parts of a set one batch axis in place of those of `batch`."""
    c, G, A, b = (x.reshape((math.prod(batch), *x.shape[len(batch) :])) for x in sets)
    return c, G, A, b
