"""Proved bounds of the gauge of points in M [-1, 1]^q: easy points first, only the others go on.

A few steps of projections for all points of a set at once (`search.project`), then the optimum of each point
that is left: one by one where they are few, side by side in a compiled search where they are many. Every
candidate is checked in NumPy. With few points left nothing is compiled, but each takes some .7 ms.
"""

from dataclasses import dataclass

import numpy as np

from jaxbound.sets.zonotopes import containment, proof, search

STEPS = 20
"""Steps of projections; at |gauge - 1| = 0.05 they suffice in 5 to 100 dimensions."""
FEW, LANES = 512, 256
"""Points up to which a linear program each takes less time than the compilation of a search of many; how many
such a search takes side by side.
"""
CLOSE = 2.0**-20
"""How much more than the lower bound an upper one may be where both are wanted."""


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
        l = proof.in_largest_entry(l)
        lower, upper = proof.gauge_above(image, d, l), proof.gauge_below(image, d, x)
        for bound, new, better, proves, what in (
            (self.lower, lower, lower > self.lower[at], self.l, l),
            (self.upper, upper, upper < self.upper[at], self.x, x),
        ):
            where = tuple(v[better] for v in np.broadcast_arrays(*at))
            bound[where], proves[where] = new[better], what[better]

    def left(self, tight: bool) -> np.ndarray:
        """Return (S, N), true where a point is not settled: both bounds are wanted, or which side of 1."""
        if tight:
            return self.upper > (1 + CLOSE) * self.lower
        return ~((self.lower > 1) | (self.upper <= 1))


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
        _projected(image, d, found, some, tight)
        for many in (True, False):
            left = found.left(tight) & some
            if left.any() and (left.sum() > FEW) == many:
                _optima(image, d, found, left, many)
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
    return containment.contained(image, D, lambda far: gauge_bounds(image, far, True).l, lambda *x: x)


def _projected(
    image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds, some: np.ndarray, tight: bool
) -> None:
    """Try the points of least norm, and run the projections on what is left open of each set."""
    z = proof.product(d, image.R.swapaxes(1, 2))
    x, l, _ = search.project(image.M, image.R, d, z, 0)
    far, l = (
        2 * x - z,
        search.towards_point(image.M, image.R, d, z, l),
    )  # beyond the nearest point of the box, as far
    # whichever of the two is nearer to the box is the better candidate
    x = np.where((abs(x).max(2, initial=0) < abs(far).max(2, initial=0))[..., None], x, far)
    found.take((np.ogrid[: len(d), :1][0], np.ogrid[:1, : d.shape[1]][1]), image, d, l, x)
    left = found.left(False) & some
    if tight or not left.any():
        return
    sets = np.nonzero(left.any(1))[0]  # as many points of each as of that with most
    at = sets[:, None], np.argsort(~left[sets], axis=1, kind="stable")[:, : left.sum(1).max()]
    chosen, points = image if len(sets) == len(image.M) else image.of(sets), _beside(d[at])
    x, l, _ = search.project(chosen.M, chosen.R, points, _beside(z[at]), STEPS)
    found.take(at, chosen, points, l, x)


def _optima(
    image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds, left: np.ndarray, many: bool
) -> None:
    """Search for the optimum of each point that is left: many side by side, or one after another."""
    sets, points = np.nonzero(left)
    for i in range(0, len(sets), LANES):
        at = sets[i : i + LANES, None], points[i : i + LANES, None]
        some = image.of(at[0][:, 0])
        each = d[at[0][:, 0], at[1][:, 0]]
        if many:
            whole = np.arange(LANES) % len(each)  # one program for blocks of any length
            l, x = (np.asarray(v)[: len(each)] for v in search.exchanged(some.M[whole], each[whole]))
        else:
            l, x = (np.array(v) for v in zip(*map(search.program, some.M, each), strict=True))
        each, x = each[:, None], x[:, None]
        # the optimum of a search in floats misses the equations a little: moved onto them
        x = x + proof.product(each - proof.product(x, some.M.swapaxes(1, 2)), some.R.swapaxes(1, 2))
        found.take(at, some, each, l[:, None], x)


def _beside(x: np.ndarray) -> np.ndarray:
    """Return x (S, N, k) with points side by side in memory: see `proof.product`."""
    return np.ascontiguousarray(x.swapaxes(1, 2)).swapaxes(1, 2)
