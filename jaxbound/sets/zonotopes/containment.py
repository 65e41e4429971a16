"""Containment of a whole zonotope in a zonotope or constrained zonotope.

With M = [G; A] and D = [c2 - c, G2; b, 0] it is enough that some X has M X = D and row sums of |X| at most 1:
then c2 + G2 z = c + G x for x = X (1, z). Source: Sadraddini, Tedrake, Linear encodings for polytope
containment problems, 2019, theorem 3. X is looked for by projections, in turn onto M X = D and onto rows of a
sum of at most 1. The condition is sufficient, not necessary: co-NP-hard otherwise.

Not held is proved by one corner of the inner set that is outside, looked for by climbing: the direction that
shows a corner to be outside most, the corner that is farthest along it, ..

Where both fail and the outer zonotope has few facets, these decide, in exact numbers.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes import proof, search
from jaxbound.sets.zonotopes.proof import Array, library, product

STARTS, CLIMBS = 16, 6
"""Directions along the axes, and others as many; how often they change."""
CHUNK, CHUNKS = 16, 21
"""Projections between two looks at the sums of rows, and how many of them."""


def contained(
    image: proof.Image[Array],
    D: Array,
    directions: Callable[[Array], Array],
    settled: Callable[..., tuple[Array, ...]],
) -> tuple[Any, Any, Any, Any]:
    """Return (lower, upper, l, X) for zonotopes D [1, z], columns D (S, 1 + p, m) as they are given: not held
    if lower (S, 1) is above 1, held if upper (S, 1) is not, by l (S, 1, m) and X (S, 1 + p, q).

    Args:
        directions: gives to points (S, N, m) those that show them to be outside most. settled: see
            `kernels.settled`.
    """
    xp, D = library(D), image.scaled(D)
    l, corner, off, reach = _climbed(image, D)
    best = proof.in_largest_entry(directions(corner))
    l = xp.where((proof.gauge_above(image, corner, best, off) > reach[:, None])[..., None], best, l)
    X = _encoded(image, D, ~(reach > 1) & xp.isfinite(image.loss))
    l, corner, X = settled(l, corner, X)
    lower, upper = proof.gauge_above(image, corner, l, off), proof.gauge_below(image, D, X, together=True)
    l = xp.where((l * D[:, :1]).sum(2)[..., None] < 0, -l, l)
    return lower, upper, proof.unscaled(l, image.powers), X


def _climbed(image: proof.Image[Array], D: Array) -> tuple[Any, Any, Any, Any]:
    """Return (l, corner, off (S, 1, m), gauge (S,)): the corner found to be farthest outside, or its opposite
    in the image, which is symmetric, and by how much its entries may be off.
    """
    xp, (S, _, m), dtype = library(D), D.shape, D.dtype
    gamma, floor = rounding.product_error(D.shape[1], dtype)
    off = (gamma * abs(D).sum(1) + 2 * floor * (1 + proof.largest_size(D, (1, 2)))[:, None])[:, None]

    def climb(state):
        l, best, corner, least, going = state
        # the corner farthest along l: each generator on the side that l sees
        turns = xp.where(product(l, D.swapaxes(1, 2)) < 0, -1, 1).astype(dtype)
        far = xp.where(going[:, None, None], product(turns, D), np.nan)
        z = product(far, image.R.swapaxes(1, 2))
        l = search.project(image.M, image.R, far, z, CHUNK)[1]
        l = proof.in_largest_entry(search.towards_point(image.M, image.R, far, z, l))
        reach = proof.gauge_above(image, far, l, off)
        at = reach.argmax(1)[:, None]
        top = xp.take_along_axis(reach, at, 1)[:, 0]
        # by more than rounding: else a climb could go in a circle
        better = top > least * (1 + 2.0**-20)
        chosen = lambda new, old: xp.where(
            better[:, None, None], xp.take_along_axis(new, at[..., None], 1), old
        )
        least = xp.where(better, top, least)
        return l, chosen(l, best), chosen(far, corner), least, better & ~(top > 1)

    # the same directions for every set: an answer does not depend on its place in a batch
    fixed: np.ndarray = np.concatenate(
        [np.eye(m)[:STARTS], np.random.default_rng(0).normal(size=(STARTS, m))]
    )
    some = xp.broadcast_to(xp.asarray(fixed, dtype), (S, *fixed.shape))
    none = xp.zeros((S, 1, m), dtype)
    start = xp.concatenate([some, image.R.sum(1)[:, None]], 1), none, none, none[:, 0, 0], xp.ones(S, bool)
    _, l, corner, least, _ = search.iterated(climb, start, CLIMBS, lambda state: state[-1].any())
    return l, corner, off, least


def _encoded(image: proof.Image[Array], D: Array, wanted: Array) -> Array:
    """Return X (S, 1 + p, q) with X M' = D nearly, and sums over |X|'s columns of at most 1 where they were
    found; only where wanted.
    """
    xp, turned, back = library(D), image.M.swapaxes(1, 2), image.R.swapaxes(1, 2)
    sums = lambda X: proof.largest_size(abs(X).sum(1), 1)

    def more(state):
        Z, best, least, going = state
        X, _, Z = search.project(image.M, image.R, D, Z, CHUNK, together=True)
        X = X + product(D - product(X, turned), back)
        size = sums(X)
        better = size < least
        best, least = xp.where(better[:, None, None], X, best), xp.where(better, size, least)
        return Z, best, least, going & (least > 1 - rounding.unit(D.dtype) ** 0.5)

    X = product(D, back)
    found: Array = search.iterated(more, (X, X, sums(X), wanted), CHUNKS, lambda state: state[-1].any())[1]
    return found
