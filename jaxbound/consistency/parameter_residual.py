"""Boxes of the unknowns of a residual that keep one value over a recording, refuted window by window.

The other unknowns, errors of sensors among them, may be anything in their box in each window: a box of
parameters is refuted where an inclusion function of the residual, over the box, over theirs and over all
samples that round to the recorded ones, leaves 0 out.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.bisection import ResidualRelations, Thick, thick
from jaxbound.consistency.parameter_boxes import Ends, Hint, Look, ParameterBoxes, blocks_of, joined
from jaxbound.consistency.parametric_windows import SEARCHED
from jaxbound.consistency.reading import gather
from jaxbound.sets.floats.kernel import is_outside_xla, kernel
from jaxbound.sets.inclusion.functions import forgets, frozen
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.paving.existence import components

__all__ = ["ResidualBoxes"]

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
        self._place = np.array(list(constant.values()), int)
        whole = np.asarray(relations.box.lo, dtype), np.asarray(relations.box.hi, dtype)
        self._whole = whole
        self.lo, self.hi = (x[self._place] for x in whole)
        self._f = Thick(frozen(relations.f))
        U, Y = gather(u, y, starts, relations.horizon + 1, relations.horizon)
        U, Y = np.moveaxis(U, -1, 0), np.moveaxis(Y, -1, 0)
        self._windows = tuple(np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in thick(U, Y))

    def looked(
        self, boxes: Ends, box: np.ndarray, window: np.ndarray, closely: bool, hint: Hint = None
    ) -> Look:
        """Return the Look of windows (P,) on boxes (P,), numbers both."""
        lo, hi = self._unknowns(boxes)
        margins, size = [], PAIRS
        if is_outside_xla():
            size = SEARCHED
        for chosen, count in blocks_of(len(box), size):
            at, own = box[chosen], [x.take(window[chosen], -1) for x in self._windows]
            margins.append((_outside(self._f, lo[:, at], hi[:, at], tuple(own)), count))
        return Look(np.nan_to_num(joined(margins), nan=np.inf), None, None)

    def units(self, boxes: Ends) -> Ends:
        """Return lo, hi (N, q) of boxes in the units of the parameters."""
        lo, hi = boxes
        return lo.T.astype(np.float64), hi.T.astype(np.float64)

    def _unknowns(self, boxes: Ends) -> Ends:
        """Return lo and hi (n, N) of all unknowns, those that are no parameters in their whole box."""
        wide = []
        for whole, x in zip(self._whole, boxes, strict=True):
            ends = np.repeat(whole[:, None], x.shape[1], 1)
            ends[self._place] = x
            wide.append(ends)
        lo, hi = wide
        return lo, hi


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
        share = -off / jnp.where(room > 0, room, 1)
        near = jnp.maximum(jnp.nan_to_num(share, nan=1.0), 0)
        worst = jnp.minimum(worst, jnp.where(out, jnp.minimum(share, -least), near))
    return worst
