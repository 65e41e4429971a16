"""Boxes of the unknowns of a residual that keep one value over a recording, refuted window by window.

The other unknowns, errors of sensors among them, may be anything in their box in each window: a box of
parameters is refuted where an inclusion function of the residual, over the box, over theirs and over all
samples that round to the recorded ones, leaves 0 out.
"""

import contextlib
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.bisection import ResidualRelations, Thick, thick
from jaxbound.consistency.parameter_boxes import Ends, Look, ParameterBoxes
from jaxbound.consistency.parametric_windows import SEARCHED, Leaves
from jaxbound.consistency.reading import gather
from jaxbound.sets.floats.kernel import kernel, outside_xla
from jaxbound.sets.inclusion.functions import forgets, frozen
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.paving.existence import components
from jaxbound.sets.paving.frontier import judged_in_blocks

PAIRS = 2**12
"""Pairs of a box and a window at once."""


class ResidualBoxes(ParameterBoxes):
    """Windows of a residual; boxes are of its constant unknowns, in their own units.

    Args:
        relations: the residual. constant: {name: number of the unknown}. u (T, m), y (T, p): all samples.
        starts: of the windows, which lack none.
    """

    def __init__(
        self,
        relations: ResidualRelations,
        constant: Mapping[str, int],
        u: np.ndarray,
        y: np.ndarray,
        starts: np.ndarray,
    ) -> None:
        dtype = np.result_type(relations.box.dtype, y.dtype)
        self.names, self.count = tuple(constant), len(starts)
        self.place = np.array(list(constant.values()), int)
        self.lo, self.hi = np.asarray(relations.box.lo, dtype), np.asarray(relations.box.hi, dtype)
        self._f = Thick(frozen(relations.f))
        U, Y = gather(u, y, starts, relations.horizon + 1, relations.horizon)
        U, Y = np.moveaxis(U, -1, 0), np.moveaxis(Y, -1, 0)
        self._windows = tuple(np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in thick(U, Y))

    def looked(self, lo: np.ndarray, hi: np.ndarray, window: np.ndarray, closely: bool) -> Look:
        """Return the Look of windows (P,) on boxes (n, P); it needs no directions."""
        (margin,) = judged_in_blocks(self._margin, lo, hi, window, PAIRS)
        return Look(margin, np.zeros((0, len(window))), np.ones_like(lo))

    def refuted(self, leaves: Leaves) -> np.ndarray:
        """Return (K,) bool: which boxes a window refutes, in NumPy from the samples."""
        out = np.zeros(len(leaves.owner), bool)
        # a primitive of a newer jax, which NumPy does not know, refutes nothing
        with outside_xla(), contextlib.suppress(NotImplementedError):
            if len(out):
                (margin,) = judged_in_blocks(self._margin, leaves.lo, leaves.hi, leaves.owner, SEARCHED)
                out = np.asarray(margin < 0)
        return out

    def units(self, lo: np.ndarray, hi: np.ndarray) -> Ends:
        """Return lo, hi (N, q) of the parameters of boxes (n, N)."""
        return lo[self.place].T.astype(np.float64), hi[self.place].T.astype(np.float64)

    def _margin(self, lo: np.ndarray, hi: np.ndarray, window: np.ndarray) -> jax.Array:
        margin: jax.Array = _outside(self._f, lo, hi, tuple(x.take(window, -1) for x in self._windows))
        return margin


@forgets
@kernel(static_argnums=0)
def _outside(f: Callable[..., Any], lo: jax.Array, hi: jax.Array, args: tuple[jax.Array, ...]) -> jax.Array:
    """Return the margin (P,) of boxes (n, P): < 0 where the image leaves 0 out, a bound that is NaN excludes
    nothing.
    """

    def image(lo: jax.Array, hi: jax.Array, *own: jax.Array) -> list[Interval]:
        return components(f, Interval(lo, hi), own)

    worst = jnp.ones_like(lo[0])
    least = np.finfo(lo.dtype).eps
    for x in jax.vmap(image, in_axes=-1)(lo, hi, *args):
        out = (x.lo > 0) | (x.hi < 0)
        off, room = jnp.maximum(x.lo, -x.hi), 0.5 * (x.hi - x.lo)
        # how far 0 lies outside, in half-widths of the image; inside it is how near to a side
        share = -off / jnp.where(room > 0, room, 1)
        near = jnp.maximum(jnp.nan_to_num(share, nan=1.0), 0)
        worst = jnp.minimum(worst, jnp.where(out, jnp.minimum(share, -least), near))
    return worst
