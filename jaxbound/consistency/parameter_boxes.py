"""Boxes of parameters that keep one value over a recording: a window refutes those that cannot explain it.

A test here takes pairs (box, window), a block of them at once, and says of each how far the window is from
refuting the box. What it refutes it proves; it looks once more in NumPy, from the samples.

The windows of a model with uncertain parameters are systems of polynomials p(v, e) = 0, see
`parametric_windows`: a box of v is refuted where a direction separates 0 from a zonotope around all values of
p over the box. Parameters that vary from sample to sample stay in their whole box.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.parametric_windows import BLOCK, SEARCHED, Terms, samples_of, terms_of
from jaxbound.consistency.polynomial_reading import PolynomialReading, PolynomialRelations
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, kernel
from jaxbound.sets.strips import polynomials, varying

__all__ = ["Ends", "Hint", "Look", "ParameterBoxes", "PolynomialBoxes", "blocks_of", "joined"]

PAIRS = 2**13
"""Pairs of a box and a window at once where each is a formula."""
Ends: TypeAlias = tuple[np.ndarray, np.ndarray]
"""lo and hi (q, N) of N boxes."""
Hint: TypeAlias = np.ndarray | None
"""Directions (r, P) by which a look refutes without a search; None: there are none."""


class Look(NamedTuple):
    """The windows' word on boxes.

    Fields: margin (P,), < 0 where the window refutes the box, the less the closer; lean (q, P): the share of
    each parameter in the room that the box leaves the window, None: not known; hint (r, P): directions by
    which another look sees it without a search, None: it needs none.
    """

    margin: np.ndarray
    lean: np.ndarray | None
    hint: Hint


class ParameterBoxes:
    """Windows of one recording as a test of boxes of parameters, each in a range of its own.

    Fields: names of the parameters; lo, hi (q,): the box that is searched; count: of windows.
    """

    names: tuple[str, ...]
    lo: np.ndarray
    hi: np.ndarray
    count: int

    def looked(
        self, boxes: Ends, box: np.ndarray, window: np.ndarray, closely: bool, hint: Hint = None
    ) -> Look:
        """Return the Look of windows (P,) on boxes (P,), numbers both; outside XLA from the samples.

        closely: whether what takes long is tried too; it pays for the windows that are near to refuting.
        hint: of a Look before, where nothing is to be searched again; None: there is none.
        """
        raise NotImplementedError

    def units(self, boxes: Ends) -> Ends:
        """Return lo, hi (N, q) of boxes in the units of the parameters, rounded outward."""
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
        self.lo, self.hi = -np.ones(len(self.names), y.dtype), np.ones(len(self.names), y.dtype)
        self._place = _places(relations, self.names)
        self._samples = u, y, starts
        self._searched = _is_searched(self.reading)
        self._terms = self._of_all_windows()

    def looked(
        self, boxes: Ends, box: np.ndarray, window: np.ndarray, closely: bool, hint: Hint = None
    ) -> Look:
        """Return the Look of windows (P,) on boxes (P,): all relations together, or not closely and where
        their strips are too many, two relations at a time.
        """
        mid, radius = self._variables(boxes)
        searched = closely and self._searched
        size = PAIRS
        if searched or is_outside_xla():
            size = SEARCHED
        margins, leans, hints = [], [], []
        for chosen, count in blocks_of(len(box), size):
            at, own = box[chosen], self._own(window[chosen])
            c, G, lean = _image_on(self.reading, own, mid[:, at], radius[:, at])
            h = None
            if hint is not None:
                h = cast("jax.Array", hint[:, chosen])
            elif searched:
                h = _directions(c, G, own.error)
                hints.append((h, count))
            margins.append((_refuting(c, G, own.error, h), count))
            leans.append((lean, count))
        lean = np.zeros((len(self.names), len(box)), self.lo.dtype)
        seen = self._place >= 0
        lean[seen] = joined(leans)[self._place[seen]]
        margin = np.nan_to_num(joined(margins), nan=np.inf)
        if not hints:
            return Look(margin, lean, None)
        return Look(margin, lean, joined(hints))

    def _own(self, window: np.ndarray) -> Terms:
        """Return the polynomials of some windows; outside XLA from their samples."""
        if not is_outside_xla():
            return _taken(self._terms, window)
        u, y, starts = self._samples
        terms: Terms = terms_of(self.reading, *samples_of(self.reading, u, y, starts[window]))
        return terms

    def units(self, boxes: Ends) -> Ends:
        """Return lo, hi (N, q) of boxes in the units of the parameters, rounded outward."""
        ends = []
        for x, rounded in zip(boxes, (rounding.round_down, rounding.round_up), strict=True):
            columns = []
            for (p, radius), row in zip(self._radii.items(), x, strict=True):
                few, which = np.unique(row, return_inverse=True)
                exact = [p.centre + radius * Fraction(float(v)) for v in few]
                columns.append(rounded(exact, np.float64)[which.ravel()])
            ends.append(np.stack(columns, -1))
        lo, hi = ends
        return lo, hi

    def _variables(self, boxes: Ends) -> Ends:
        """Return the middle and the radius (n, N) of all variables, those that vary in their whole box."""
        lo, hi = boxes
        mid = 0.5 * (lo + hi)
        radius = np.maximum(hi - mid, mid - lo) * (1 + 4 * np.finfo(mid.dtype).eps)
        shape = len(self.reading.size), lo.shape[1]
        mids, radii = np.zeros(shape, mid.dtype), np.ones(shape, mid.dtype)
        seen = self._place >= 0
        mids[self._place[seen]], radii[self._place[seen]] = mid[seen], radius[seen]
        return mids, radii

    def _of_all_windows(self) -> Terms:
        """Return the polynomials of all windows, on the host."""
        u, y, starts = self._samples
        parts = []
        for chosen, count in blocks_of(len(starts), BLOCK):
            terms = terms_of(self.reading, *samples_of(self.reading, u, y, starts[chosen]))
            parts.append((terms, count))
        whole = []
        for name in ("value", "rad", "error"):
            whole.append(joined([(getattr(terms, name), count) for terms, count in parts]))
        value, rad, error = whole
        return _terms(value, np.asarray(parts[0][0].spread), rad, error)


def _constant(relations: PolynomialRelations, dtype: DTypeLike) -> dict[Uncertainty, Fraction]:
    """Return {parameter that keeps one value: the radius that kernels multiply its variable by}."""
    radii = {}
    model = cast("LinearSystem", relations.model)
    sizes = rounding.round_up(np.asarray(relations.bounds["parameters"], np.float64), dtype)
    for p, size in zip(model.uncertainties, sizes, strict=True):
        if not p.varying:
            radii[p] = p.radius * Fraction(float(size))
    return radii


def _places(relations: PolynomialRelations, names: Sequence[str]) -> np.ndarray:
    """Return (q,): which variable of the relations each parameter is, -1 where it acts on none of them."""
    places = {}
    for number, (name, _) in enumerate(relations.variables):
        places[name] = number
    return np.array([places.get(name, -1) for name in names], int)


def _is_searched(reading: PolynomialReading) -> bool:
    """Return whether directions are searched for: where strips of a box's image are too many."""
    r, n = reading.count, len(reading.size)
    monomials = len(polynomials.closure(reading.exponents)) - 1
    noises = len(reading.noisy)
    if noises and n:
        noises += r  # how they change with the parameters
    return not varying.few_strips(r, monomials + noises)


def blocks_of(total: int, size: int) -> Iterator[tuple[np.ndarray, int]]:
    """Yield (numbers, how many of them count) in blocks of one size, the last one filled up."""
    for first in range(0, total, size):
        count = min(size, total - first)
        yield first + np.minimum(np.arange(size), count - 1), count


def joined(parts: Sequence[tuple[object, int]]) -> np.ndarray:
    """Return the columns that count of blocks, on the host."""
    return np.concatenate([np.asarray(x)[..., :count] for x, count in parts], -1)


def _taken(terms: Terms, window: np.ndarray) -> Terms:
    """Return the polynomials of some windows: looked up on the host, nothing compiles for their number."""
    value, spread, rad, error = map(np.asarray, terms)
    return _terms(value.take(window, -1), spread, rad.take(window, -1), error.take(window, -1))


def _terms(*parts: np.ndarray) -> Terms:
    """Return polynomials in arrays of the host, which kernels take too."""
    return Terms(*(cast("jax.Array", x) for x in parts))


@kernel
def _image_on(
    reading: PolynomialReading, terms: Terms, mid: jax.Array, radius: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (c, G, lean) of boxes mid +- radius (n, P), each with polynomials of its own."""
    value, spread, rad, _ = terms
    c, G = polynomials.image(value, spread, rad, reading.exponents, mid, radius)
    size = jnp.sum(jnp.abs(G), 1)
    share = jnp.abs(G[:, : len(mid)]) / jnp.where(size > 0, size, 1)[:, None]
    return c, G, jnp.max(share, 0)


@kernel
def _directions(c: jax.Array, G: jax.Array, error: jax.Array) -> jax.Array:
    """Return directions (r, P) that may separate 0 from c + G [-1, 1]^q."""
    return varying.farthest(c, G, error)[0]


@kernel
def _refuting(c: jax.Array, G: jax.Array, error: jax.Array, h: jax.Array | None) -> jax.Array:
    """Return the margin (P,), < 0 proves that 0 is outside: by a direction that is an array; without one by
    all strips, of two rows at a time where those of all are too many.
    """
    if h is not None:
        return varying.refutes(c, G, error, h)
    r, q, _ = G.shape
    if varying.few_strips(r, q):
        return varying.strip_margins(c, G, error)
    rows = 1
    if varying.few_strips(2, q):
        rows = 2
    parts = []
    for first in range(0, r, rows):
        part = slice(min(first, r - rows), first + rows)
        parts.append(varying.strip_margins(c[part], G[part], error[part]))
    return jnp.min(jnp.stack(parts), 0)
