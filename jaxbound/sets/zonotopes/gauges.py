"""Proved bounds of the gauge of points in M [-1, 1]^q: easy points first, only the others go on.

A few steps of projections for all points of a set at once (`search.project`), then interior points and the vertex that they point to
(`search.interior_point`, `proof.vertices`) for what is left, in blocks of sizes that depend on the shapes alone. The host looks at proofs
between the stages.
"""

from dataclasses import dataclass

import numpy as np

from jaxbound.sets.zonotopes import proof, search

__all__ = ["Bounds", "gauge_bounds"]

STEPS = (8, 24)
"""Steps of projections; at |gauge - 1| = 0.05 some 20 suffice in 5 to 100 dimensions."""
CLEAR = 2.0**-30
"""How far from 1 a gauge must be for the interior points to stop before the optimum."""
BLOCK = 2**19
"""Numbers in the largest array of a block of interior points."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """lower <= gauge <= upper (S, N), by the direction l (S, N, m) and the point x (S, N, q), in the scaled rows of an Image."""

    lower: np.ndarray
    upper: np.ndarray
    l: np.ndarray
    x: np.ndarray

    def take(self, at, image, d, l, x):
        """Check candidates for the points at (sets, numbers), and keep what is better."""
        lower, upper = proof.gauge_above(image, d, l), proof.gauge_below(image, d, x)
        lower, upper, l, x = (v.reshape(len(at[0]), *v.shape[2:]) for v in (lower, upper, l, x))
        better = lower > self.lower[at]
        self.lower[at], self.l[at] = np.where(better, lower, self.lower[at]), np.where(better[:, None], l, self.l[at])
        better = upper < self.upper[at]
        self.upper[at], self.x[at] = np.where(better, upper, self.upper[at]), np.where(better[:, None], x, self.x[at])


def gauge_bounds(image, d, tight=False):
    """Return Bounds for points d (S, N, m), scaled as by `Image.scaled`.

    Args:
        image: an Image of S sets. tight: work out both bounds up to rounding; otherwise stop where one is on its side of 1.
    """
    (S, m, q), N = image.M.shape, d.shape[1]
    found = Bounds(np.zeros((S, N)), np.full((S, N), np.inf), np.zeros((S, N, m)), np.zeros((S, N, q)))
    everywhere = tuple(x.ravel() for x in np.indices((S, N)))
    with np.errstate(all="ignore"):
        z = d @ image.R.swapaxes(1, 2)
        found.take(everywhere, image, d, d - z @ image.M.swapaxes(1, 2), z)
        open_at = _left(found, tight)
        if not tight and len(open_at[0]):
            open_at = _projected(image, d, z, found, open_at)
        if len(open_at[0]):
            _interior(image, d, found, open_at, tight)
    return found


def _left(found, tight):
    settled = (found.lower > 1) | (found.upper <= (0 if tight else 1))
    return np.nonzero(~settled if not tight else found.upper > 0)


def _projected(image, d, z, found, open_at):
    """Run the projections; return what they leave open."""
    S, N = found.lower.shape
    for steps in STEPS:
        if S == 1:  # only the points that are open
            some = _padded(open_at[1], _power(len(open_at[1])))
            x, l, new = (np.asarray(v, float) for v in search.project(image.M, image.R, d[:, some], z[:, some], steps))
            z[:, some] = new
            keep = slice(0, len(open_at[1]))
            found.take(open_at, image, d[:, open_at[1]], l[:, keep], _onto(image, d[:, open_at[1]], x[:, keep]))
        else:
            x, l, z = (np.asarray(v, float) for v in search.project(image.M, image.R, d, z, steps))
            found.take(tuple(v.ravel() for v in np.indices((S, N))), image, d, l, _onto(image, d, x))
        open_at = _left(found, False)
        if not len(open_at[0]):
            break
    return open_at


def _interior(image, d, found, open_at, tight):
    S, (m, q) = len(image.M), image.M.shape[1:]
    enough = np.inf if tight else CLEAR
    largest = max(1, _power(BLOCK // max(m * q, 1) + 1) // 2)
    for start in range(0, len(open_at[0]), min(largest, 1024)):
        at = tuple(x[start : start + min(largest, 1024)] for x in open_at)
        size = min(_power(len(at[0]), 4), min(largest, 1024))
        i, j = (_padded(x, size) for x in at)
        if S == 1:
            some, points = image, d[:, j]
        else:
            some, points = image.of(i), d[i, j][:, None]
        x, l, s = (np.asarray(v, float) for v in search.interior_point(some.M, some.R, points, enough))
        if S > 1:
            some = image.of(at[0])
            x, l, s, points = (v[: len(at[0])] for v in (x, l, s, points))
        else:
            x, l, s, points = (v[:, : len(at[0])] for v in (x, l, s, points))
        found.take(at, some, points, l, _onto(some, points, x))
        M = some.M[0] if S == 1 else some.M
        flat = (v.reshape(len(at[0]), -1) for v in (points, x, s))
        x, l = proof.vertices(M, *flat)
        found.take(at, some, points, l.reshape(points.shape), _onto(some, points, x.reshape(*points.shape[:2], q)))


def _onto(image, d, x):
    """Move candidates onto M x = d once more, in float64."""
    return x + (d - x @ image.M.swapaxes(1, 2)) @ image.R.swapaxes(1, 2)


def _power(count, base=2):
    """Return the smallest power of `base` that is not below count."""
    power = 1
    while power < count:
        power *= base
    return power


def _padded(numbers, size):
    return np.resize(numbers, size)
