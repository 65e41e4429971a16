"""Boxes of parameters that keep one value over a recording: a window refutes those that cannot explain it.

A test here takes pairs (box, window), a block of them at once, and says of each how far the window is from
refuting the box, and a direction: hints. What it refutes it proves in NumPy, from the samples.

The windows of a model with uncertain parameters are systems of polynomials p(v, e) = 0, see
`parametric_windows`: a box of v is refuted where a direction separates 0 from a zonotope around all values of
p over the box. Parameters that vary from sample to sample stay in their whole box.
"""

from fractions import Fraction
from typing import NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.parametric_windows import (
    SEARCHED,
    Leaves,
    middle_of,
    refuted_boxes,
    samples_of,
    terms_of,
)
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations, Polynomials
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.paving.frontier import judged_in_blocks
from jaxbound.sets.strips import polynomials, varying

PAIRS = 2**11
"""Pairs of a box and a window at once where each is a formula."""
Ends: TypeAlias = tuple[np.ndarray, np.ndarray]
"""lo and hi of boxes."""


class Look(NamedTuple):
    """The windows' word on boxes, no claim.

    Fields: margin (P,), < 0 where the window refutes the box, the less the closer; h (r, P): directions by
    which NumPy sees it; lean (n, P): the share of each unknown in the room that the box leaves the window.
    """

    margin: np.ndarray
    h: np.ndarray
    lean: np.ndarray


class ParameterBoxes:
    """Windows of one recording as a test of boxes of parameters, each in a range of its own.

    Fields: names of the parameters; lo, hi (n,): the box of all unknowns of a window that is searched; place
    (q,): which unknown each parameter is, -1 where it acts on no window; count: of windows.
    """

    names: tuple[str, ...]
    lo: np.ndarray
    hi: np.ndarray
    place: np.ndarray
    count: int
    searched = False
    """Whether a closer look sees more."""

    def looked(self, lo: np.ndarray, hi: np.ndarray, window: np.ndarray, closely: bool) -> Look:
        """Return the Look of windows (P,), by number, on boxes (n, P).

        closely: whether what takes long is tried too; it pays for the windows that are near to refuting.
        """
        raise NotImplementedError

    def refuted(self, leaves: Leaves) -> np.ndarray:
        """Return (K,) bool: in which boxes a direction refutes a window, in NumPy from the samples."""
        raise NotImplementedError

    def units(self, lo: np.ndarray, hi: np.ndarray) -> Ends:
        """Return lo, hi (N, q) of the parameters of boxes (n, N) in their units, rounded outward."""
        raise NotImplementedError


class PolynomialBoxes(ParameterBoxes):
    """Windows of a model with uncertain parameters; boxes are in half-widths of the parameters' bounds.

    Args:
        relations: of the model. u (T, m), y (T, p): all samples. starts: of the windows, which lack none.
    """

    def __init__(
        self, relations: PolynomialRelations, u: np.ndarray, y: np.ndarray, starts: np.ndarray
    ) -> None:
        self._radii = _constant(relations, y.dtype)
        self.reading = relations.reading(y.dtype)
        self.names = tuple(p.name for p in self._radii)
        self.count = len(starts)
        self.hi = np.ones(len(self.reading.size), y.dtype)
        self.lo = -self.hi
        variables = {name: number for number, (name, _) in enumerate(relations.variables)}
        self.place = np.array([variables.get(name, -1) for name in self.names], int)
        self._samples = samples_of(self.reading, u, y, starts)
        r, monomials = self.reading.count, len(polynomials.closure(self.reading.exponents)) - 1
        self.searched = not varying.few_strips(r, monomials + len(self.reading.noisy) + r)

    def looked(self, lo: np.ndarray, hi: np.ndarray, window: np.ndarray, closely: bool) -> Look:
        """Return the Look of windows (P,) on boxes (n, P): of all relations together, or not closely and
        where their strips are too many, of two relations at a time.
        """
        size, direction = PAIRS, _strip
        if closely and self.searched:
            size, direction = SEARCHED, _farthest

        def one(lo: np.ndarray, hi: np.ndarray, window: np.ndarray) -> tuple[jax.Array, ...]:
            terms = terms_of(self.reading, *(x.take(window, -1) for x in self._samples))
            c, G, lean = _image_on(self.reading, terms, *middle_of(lo, hi))
            h = direction(c, G, terms.error)
            return _refutes(c, G, terms.error, h), h, lean

        margin, h, lean = judged_in_blocks(one, lo, hi, window, size)
        # NaN refutes nothing, and is no hint that a closer look would
        return Look(np.nan_to_num(margin, nan=1.0), h, lean)

    def refuted(self, leaves: Leaves) -> np.ndarray:
        """Return (K,) bool: in which boxes a direction refutes a window, in NumPy from the samples."""
        return refuted_boxes(self.reading, self._samples, leaves)

    def units(self, lo: np.ndarray, hi: np.ndarray) -> Ends:
        """Return lo, hi (N, q) of the parameters of boxes (n, N) in their units, rounded outward."""
        ends = []
        for x, whole, rounded in ((lo, -1, rounding.round_down), (hi, 1, rounding.round_up)):
            columns = []
            for (p, radius), i in zip(self._radii.items(), self.place, strict=True):
                row = np.full(x.shape[1], whole, x.dtype)
                if i >= 0:
                    row = x[i]
                # boxes share their ends: fractions are made once for each number that occurs
                few, which = np.unique(row, return_inverse=True)
                exact = [p.centre + radius * Fraction(float(v)) for v in few]
                columns.append(rounded(exact, np.float64)[which.ravel()])
            ends.append(np.stack(columns, -1))
        return ends[0], ends[1]


def _constant(relations: PolynomialRelations, dtype: DTypeLike) -> dict[Uncertainty, Fraction]:
    """Return {parameter that keeps one value: the radius that kernels multiply its variable by}."""
    radii = {}
    model = cast("LinearSystem", relations.model)
    sizes = rounding.round_up(np.asarray(relations.bounds["parameters"], np.float64), dtype)
    for p, size in zip(model.uncertainties, sizes, strict=True):
        if not p.varying:
            radii[p] = p.radius * Fraction(float(size))
    return radii


@kernel
def _image_on(
    reading: PolynomialReading, terms: Polynomials, mid: jax.Array, radius: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (c, G, lean) of windows on boxes mid +- radius (n, P)."""
    value, _, spread, rad = terms
    c, G = polynomials.image(value, spread, rad, reading.exponents, mid, radius)
    size = jnp.sum(jnp.abs(G), 1)
    share = jnp.abs(G[:, : len(mid)]) / jnp.where(size > 0, size, 1)[:, None]
    return c, G, jnp.max(share, 0)


@kernel
def _farthest(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    return varying.farthest(c, G, error)[0]


_strip = kernel(varying.strip)
_refutes = kernel(varying.refutes)
