"""Proved bounds of the gauge of points in M [-1, 1]^q: easy points first, only the others go on.

A few steps of projections for all points of a set at once (`search.project`), then interior points and the
vertex that they point to (`search.advance`, `search.vertices`) for what is left, in blocks. Proofs are looked
at between the stages. All of it is NumPy: nothing is compiled, so the first question takes no longer than the
next.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from jaxbound.sets.zonotopes import containment, proof, search

__all__ = ["Bounds", "bounds", "contained", "gauge_bounds"]

STEPS = (6, 20)
"""Steps of projections between two looks at the proofs; at |gauge - 1| = 0.05 some 20 suffice in 5 to 100
dimensions.
"""
FRUITLESS = 0.8
"""The share of points still open after some steps from which on more of them are not worth it."""
CLEAR = 2.0**-30
"""How far from 1 a gauge must be for the interior points to stop before the optimum."""
LATER = (3, 3, 4, 8, 16)
"""Steps of interior points between looks at the proofs, after the first six or more."""
TIGHT = (12, 6, 22)
"""The same where all go on to the optimum."""
BLOCK, LARGEST = 2**19, 1024
"""Numbers in the largest array of a block of interior points; points in it."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of a gauge, lower <= gauge <= upper (S, N), by the direction l (S, N, m) and the point x (S, N,
    q).
    """

    lower: np.ndarray
    upper: np.ndarray
    l: np.ndarray
    x: np.ndarray

    def take(
        self,
        at: tuple[np.ndarray, np.ndarray],
        image: proof.Image[np.ndarray],
        d: np.ndarray,
        l: np.ndarray,
        x: np.ndarray,
    ) -> None:
        """Check candidates for the points at (sets, numbers), two arrays of their leading shape, and keep
        what is better.
        """
        l = proof.unit(l)
        lower, upper = proof.gauge_above(image, d, l), proof.gauge_below(image, d, x)
        for bound, new, better, proves, what in (
            (self.lower, lower, lower > self.lower[at], self.l, l),
            (self.upper, upper, upper < self.upper[at], self.x, x),
        ):
            where = tuple(v[better] for v in np.broadcast_arrays(*at))
            bound[where], proves[where] = new[better], what[better]

    def left(self, tight: bool) -> np.ndarray:
        """Return (S, N), true where a point is not settled: both bounds are wanted, or which side of 1."""
        return self.upper > 0 if tight else ~((self.lower > 1) | (self.upper <= 1))


def gauge_bounds(image: proof.Image[np.ndarray], d: np.ndarray, tight: bool = False) -> Bounds:
    """Return Bounds for points d (S, N, m), scaled as by `Image.scaled`; none for points that are NaN.

    Args:
        image: an Image of S sets. tight: work out both bounds up to rounding; otherwise stop where one is on
            its side of 1.
    """
    (S, m, q), N = image.M.shape, d.shape[1]
    found = Bounds(
        np.zeros((S, N)), np.full((S, N), np.inf), *(np.zeros((S, k, N)).swapaxes(1, 2) for k in (m, q))
    )
    d, some = _beside(d), np.isfinite(d).all(2)
    with np.errstate(all="ignore"):
        _projected(image, d, found, some, () if tight else STEPS)
        left = found.left(tight) & some
        if left.any():
            _interior(image, d, found, left, tight)
    return found


def bounds(M: np.ndarray, d: np.ndarray, tight: bool = False) -> tuple[np.ndarray, ...]:
    """Return (lower, upper, l, x) as `gauge_bounds`, of finite M (S, m, q) and d (S, N, m) as they are given,
    as is l.
    """
    image = proof.image(M)
    found = gauge_bounds(image, image.scaled(d), tight)
    return found.lower, found.upper, proof.unscaled(found.l, image.powers), found.x


def contained(M: np.ndarray, D: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (lower, upper, l, X) as `containment.contained`."""
    image = proof.image(M)
    directions = lambda far: proof.unit(gauge_bounds(image, far, tight=True).l)
    return containment.contained(image, D, directions, lambda *x: x)


def _gathered(left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (sets (S, 1), points (S, N)): the sets with something left, as many points of each as of that
    with most.
    """
    i = np.nonzero(left.any(1))[0]
    return i[:, None], np.argsort(~left[i], axis=1, kind="stable")[:, : left.sum(1).max()]


def _projected(
    image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds, some: np.ndarray, stages: tuple[int, ...]
) -> None:
    """Try the points of least norm, and run the projections on what is left open of each set."""
    z, before = proof.product(d, image.R.swapaxes(1, 2)), np.inf
    at = np.ogrid[: len(d), :1][0], np.ogrid[:1, : d.shape[1]][1]
    for steps in (0, *stages):
        if steps:
            left = found.left(False) & some
            # near the boundary projections take too long; of one point a set, others are none of its business
            if not left.any() or (d.shape[1] > 1 and left.sum() > FRUITLESS * before):
                break
            at, before = _gathered(left), left.sum()
        chosen, points = (_of(image, at[0]), _beside(d[at])) if steps else (image, d)
        x, l, z[at] = search.project(chosen.M, chosen.R, points, _beside(z[at]), steps)
        if not steps:  # beyond the nearest point of the box the other side of it, as far
            far, l = 2 * x - z, search.beside(image.M, d, z, l)
            x = np.where((abs(x).max(2, initial=0) < abs(far).max(2, initial=0))[..., None], x, far)
        found.take(at, chosen, points, l, x)


def _interior(
    image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds, left: np.ndarray, tight: bool
) -> None:
    """Run interior points on what is left, in blocks: of sets, or of points of one set."""
    sets, points = _gathered(left)
    most = min(max(1, BLOCK // max(image.M[0].size, 1)), LARGEST)
    wide = min(points.shape[1], most)
    high = max(1, most // wide)
    for i in range(0, len(sets), high):
        for j in range(0, points.shape[1], wide):
            _vertices(image, d, found, (sets[i : i + high], points[i : i + high, j : j + wide]), tight)


def _vertices(
    image: proof.Image[np.ndarray],
    d: np.ndarray,
    found: Bounds,
    at: tuple[np.ndarray, np.ndarray],
    tight: bool,
) -> None:
    """Look at the vertices that the points `at` tend to, now and then: most are known long before the
    optimum.
    """
    (m, q), enough = image.M.shape[1:], np.inf if tight else CLEAR
    some, points = _of(image, at[0]), _beside(d[at])
    state = search.start(some.M, some.R, points)
    stages = TIGHT if tight else (6 + m // 16, *LATER)
    for steps in stages[:1] + (search.STEPS,) if m > search.SMALL else stages:  # where a look takes long
        going = lambda state: not state[-1].all()
        step = partial(search.advance, some.M, points, enough=enough)
        state = search.repeated(step, state, steps, going)
        x, l, s = search.reached(state)
        found.take(at, some, points, l, _onto(some, points, x))
        if m <= q:
            x, l = search.vertices(some.M, points, x, s)
            found.take(at, some, points, l, _onto(some, points, x))
        left = ~state[-1] & found.left(tight)[at]
        if not left.any():
            break
        sets, _ = keep = _gathered(left)
        at, points, some = (at[0][sets[:, 0]], at[1][keep]), _beside(points[keep]), _of(some, sets)
        state = tuple(_beside(v[keep]) if v.ndim == 3 else v[keep] for v in state)


def _of(image: proof.Image[np.ndarray], sets: np.ndarray) -> proof.Image[np.ndarray]:
    """Return the Image of the sets (S, 1) numbered, uncopied where that is all."""
    return image if len(sets) == len(image.M) else image.of(sets[:, 0])


def _onto(image: proof.Image[np.ndarray], d: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Move candidates onto M x = d once more, in float64."""
    return x + proof.product(d - proof.product(x, image.M.swapaxes(1, 2)), image.R.swapaxes(1, 2))


def _beside(x: np.ndarray) -> np.ndarray:
    """Return x (S, N, k) with points side by side in memory: see `proof.product`."""
    return np.ascontiguousarray(x.swapaxes(1, 2)).swapaxes(1, 2)
