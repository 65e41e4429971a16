"""Proved bounds of the gauge of points in M [-1, 1]^q: easy points first, only the others go on.

A few steps of projections for all points of a set at once (`search.project`), then interior points and the
vertex that they point to (`search.advance`, `proof.vertices`) for what is left, in blocks. Proofs are looked
at between the stages. All of it is NumPy: nothing is compiled, so the first question takes no longer than the
next.
"""

from dataclasses import dataclass

import numpy as np

from jaxbound.sets.zonotopes import proof, search

__all__ = ["Bounds", "gauge_bounds"]

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


def gauge_bounds(image: proof.Image[np.ndarray], d: np.ndarray, tight: bool = False) -> Bounds:
    """Return Bounds for points d (S, N, m), scaled as by `Image.scaled`.

    Args:
        image: an Image of S sets. tight: work out both bounds up to rounding; otherwise stop where one is on
            its side of 1.
    """
    (S, m, q), N = image.M.shape, d.shape[1]
    found = Bounds(
        np.zeros((S, N)), np.full((S, N), np.inf), *(np.zeros((S, k, N)).swapaxes(1, 2) for k in (m, q))
    )
    d = _beside(d)
    with np.errstate(all="ignore"):
        z = _start(image, d, found)
        if tight or (~_settled(found, False)).any():
            if not tight:
                _projected(image, d, z, found)
            _interior(image, d, found, tight)
    return found


def _settled(found: Bounds, tight: bool) -> np.ndarray:
    return (found.lower > 1) | (found.upper <= 1) if not tight else found.upper == 0


def _start(image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds) -> np.ndarray:
    """Try the point of least norm and the direction that its clipped entries point to; return it (S, N,
    q).
    """
    back, turned = image.R.swapaxes(1, 2), image.M.swapaxes(1, 2)
    z = proof.product(d, back)
    y = np.clip(z, -1, 1)
    near = y + proof.product(d - proof.product(y, turned), back)
    x = np.where(
        (abs(near).max(2, initial=0) < abs(2 * near - z).max(2, initial=0))[..., None], near, 2 * near - z
    )
    l = proof.product(z - y, image.R)
    if not np.isfinite(image.loss).all():  # flat sets: points may be beside the plane
        beside = d - proof.product(z, turned)
        flat = abs(beside).max(2, initial=0) > 2.0**-30 * abs(d).max(2, initial=0)
        flat &= ~np.isfinite(image.loss)[:, None]
        l, x = np.where(flat[..., None], beside, l), np.where(flat[..., None], z, x)
    sets, points = np.ogrid[: d.shape[0], : d.shape[1]]
    found.take((sets, points), image, d, l, x)
    return z


def _gathered(left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (sets (S, 1), points (S, N)): the sets with something left, as many points of each as of that
    with most.
    """
    i = np.nonzero(left.any(1))[0]
    return i[:, None], np.argsort(~left[i], axis=1, kind="stable")[:, : left.sum(1).max()]


def _projected(image: proof.Image[np.ndarray], d: np.ndarray, z: np.ndarray, found: Bounds) -> None:
    """Run the projections, on what they leave open of each set."""
    before = d.size
    for steps in STEPS:
        left = ~_settled(found, False)
        fruitless = (
            d.shape[1] > 1 and left.sum() > FRUITLESS * before
        )  # of one point a set: others are none of its business
        if not left.any() or (steps > STEPS[0] and fruitless):
            break  # they are near the boundary, where projections take too long
        before = left.sum()
        at = _gathered(left)
        some, points = _of(image, at[0]), _beside(d[at])
        x, l, z[at] = search.project(some.M, some.R, points, _beside(z[at]), steps)
        found.take(at, some, points, l, x)


def _interior(image: proof.Image[np.ndarray], d: np.ndarray, found: Bounds, tight: bool) -> None:
    """Run interior points on what is left, in blocks: of sets, or of points of one set."""
    left = ~_settled(found, tight)
    if not left.any():
        return
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
    (m, q), enough, rows = image.M.shape[1:], np.inf if tight else CLEAR, lambda v: v.reshape(-1, v.shape[2])
    some, points = _of(image, at[0]), _beside(d[at])
    state = search.start(some.M, some.R, points)
    few = m > proof.SMALL  # a look inverts a matrix a point, which takes longer than a step
    for steps in (
        ((search.STEPS,) if few else TIGHT) if tight else (6 + m // 16, *((search.STEPS,) if few else LATER))
    ):
        for _ in range(steps):
            if state[-1].all():
                break
            state = search.advance(some.M, points, state, enough)
        x, l, s = search.reached(state)
        found.take(at, some, points, l, _onto(some, points, x))
        if m <= q:
            one = (
                len(some.M) == 1 and points.shape[1] > 1
            )  # a set of one point is worked out as if others stood beside it
            M = some.M[0] if one else np.repeat(some.M, points.shape[1], 0)
            x, l = proof.vertices(M, rows(points), rows(x), rows(s))
            x, l = x.reshape(*points.shape[:2], q), l.reshape(points.shape)
            found.take(at, some, points, l, _onto(some, points, x))
        left = ~state[-1] & ~_settled(found, tight)[at]
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
