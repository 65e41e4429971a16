"""Trajectories that explain the samples of windows, proved: rounding acts against them."""

from typing import TypeVar

import jax
import numpy as np

from jaxbound.estimation.ordered import product
from jaxbound.estimation.parallelotope import OFF
from jaxbound.estimation.window_proof import Prior, Samples
from jaxbound.estimation.zonotope_steps import Numbers

__all__ = ["explained"]

LESS = 1 - 1e-9
"""The share of its bounds that a trajectory may use: the rest covers what floats are off by."""

Tree = TypeVar("Tree")


def explained(
    plant: Numbers, path: Prior, samples: Samples, xi: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (ok (N,), x (n, N), off (n, N)): whether a trajectory is proved to keep all bounds, the state in
    the middle of the window, and how far the exact one may be off it.

    The trajectory is the exact one of these xi and w, made a little smaller than 1; floats follow it to
    within `off`. Rounding that widens an enclosure makes a bound tighter here.

    Args:
        plant: in float64. path: the sets of the first states. samples: of L steps. xi (k, N), w (L, g, N).
    """
    path, samples, xi, w = _in_float64((path, samples, xi, w))
    xi, w = (np.clip(np.nan_to_num(x), -LESS, LESS) for x in (xi, w))
    x, off = path.c + (path.S * xi[None]).sum(1), path.r.copy()
    # a side so short that rounding of the centre is as long cannot be made smaller
    sides_seen = 1e-9 * np.abs(path.S) > 1e-14 * np.abs(path.c)[:, None]
    ok = ((path.S == 0) | sides_seen).all((0, 1))
    L = len(samples.mid)
    middle = x, off
    for j in range(L):
        now = Samples(*(part[j] for part in samples))
        if j == L // 2:
            middle = x, off
        ok &= _keeps_bounds(plant, now, x, off)
        if j + 1 < L:
            off = _off_later(plant, now, x, off)
            x = product(plant.A, x) + product(plant.B, now.v) + plant.w[:, None] + product(plant.W, w[j])
    return ok, *middle


def _keeps_bounds(plant: Numbers, now: Samples, x: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Return (N,): whether each output of one sample is within its bounds of states x +- off."""
    size_C, size_D, size_v = np.abs(plant.C), np.abs(plant.D), np.abs(now.v)
    size = np.abs(x)
    away = np.abs(now.mid - product(plant.C, x) - product(plant.D, now.v))
    away = away + product(size_C, off) + product(plant.wide_C, size + off)
    away = away + product(plant.wide_D, size_v) + product(size_D, now.slip)
    away = away + OFF * (np.abs(now.mid) + product(size_C, size) + product(size_D, size_v))
    seen = np.isfinite(now.rad)
    kept: np.ndarray = (~seen | (away <= LESS * np.where(seen, now.rad, 1))).all(0)
    return kept


def _off_later(plant: Numbers, now: Samples, x: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Return (n, N): how far off the state one step later may be."""
    size_A, size_B, size_v = np.abs(plant.A), np.abs(plant.B), np.abs(now.v)
    size = np.abs(x)
    later = (
        product(size_A, off)
        + product(plant.wide_A, size + off)
        + product(plant.wide_B, size_v)
        + product(size_B, now.slip)
        + plant.wide_w[:, None]
    )
    drawn = (np.abs(plant.w) + np.abs(plant.W).sum(1))[:, None]
    return np.asarray(later + OFF * (product(size_A, size) + product(size_B, size_v) + drawn))


def _in_float64(tree: Tree) -> Tree:
    """Return arrays in float64."""
    out: Tree = jax.tree.map(lambda x: np.asarray(x, np.float64), tree)
    return out
