"""What multipliers of the samples of a window prove: an enclosure of one direction of one state, rounding included.

States x_(j+1) = A x_j + B v_j + w_j, samples m_j = C x_j + D v_j + delta_j, |delta_j| <= s_j, and a first state in a set. For every l:

    d x_J  =  sum_j l_j (m_j - D v_j - delta_j)  -  p_0 x_0  -  sum_j p_(j+1) (B v_j + w_j),
    p_j    =  C' l_j + A' p_(j+1) - d [j = J],

in which only delta, x_0 and w are unknown, each within its bounds. So d x_J lies in value +- bound; with d = 0 a value beyond its bound is
a contradiction. Where p_j is rounded, or A and C are intervals, the difference acts on x_j, of which bounds are known beforehand.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.estimation.window_search import Window
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

__all__ = ["Prior", "Samples", "enclosed", "window_of"]


class Prior(NamedTuple):
    """A set {c + S xi + diag(r) eta} of first states. Fields: c (n, N), S (n, n, N), r (n, N)."""

    c: Any
    S: Any
    r: Any


class Samples(NamedTuple):
    """What L samples say. Fields: mid, rad (L, p, N), v, slip (L, m, N): see `zonotope_steps.Read`; reach (L, n, N): at least |x|."""

    mid: Any
    rad: Any
    v: Any
    slip: Any
    reach: Any


def window_of(plant: Numbers, prior: Prior, samples: Samples) -> Window:
    """Return the Window that a search takes, rounded to nearest; plant in float64."""
    L, dtype, x = len(samples.mid), samples.mid.dtype, np.asarray(prior.c, np.float64)
    e = np.empty(samples.mid.shape)
    for j in range(L):
        e[j] = samples.mid[j] - plant.C @ x - plant.D @ samples.v[j]
        x = plant.A @ x + plant.B @ samples.v[j] + plant.w[:, None]
    seen = np.isfinite(samples.rad)
    least = 1e-9 * np.max(np.where(seen, samples.rad, 0), (0, 1), keepdims=True) + 1e-30  # a search divides by it
    S = prior.S + np.eye(len(prior.r))[:, :, None] * prior.r[None]
    s = np.where(seen, np.maximum(samples.rad, least), np.inf)
    p, rows = len(plant.C), np.arange(L * len(plant.C))
    flat = lambda x: x.reshape(len(rows), -1)
    given = plant.A, plant.W, S, np.tile(plant.C, (L, 1)), flat(np.where(seen, e, 0)), flat(s)
    return Window(*(np.asarray(x, dtype) for x in given), (rows // p).astype(np.int32), rows % p == p - 1, np.arange(p - 1, len(rows), p))


def enclosed(plant: Numbers, prior: Prior, samples: Samples, weight: Any, d: Any, J: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, bound), each (N,) in float64: d x_J lies in value +- bound for all that explains the samples.

    An infinite bound shows nothing. Worked out on the host: a program would be compiled for longer than most recordings take.

    Args:
        plant: in float64. weight (L p, N): multipliers, any. d (n, N), J (N,).
    """
    (L, p, N), (n, m), g = samples.mid.shape, plant.B.shape, plant.W.shape[1]
    terms = L * (n + m + p + g + 8) + n
    gamma, up = float(rounding.product_error(terms, np.float64)[0]), 1 + 8 * terms * float(rounding.unit(np.float64))
    prior, samples, weight, d = jax.tree.map(lambda x: np.asarray(x, np.float64), (prior, samples, weight, d))
    seen = np.isfinite(samples.rad)
    l = np.where(seen & (np.abs(weight := weight.reshape(seen.shape)) < 2.0**60), weight, 0)
    mid, s, V = np.where(seen, samples.mid, 0), np.where(seen, samples.rad, 0), np.abs(samples.v)
    pull = np.where(np.arange(L)[:, None, None] == J, d, 0)
    q = np.zeros((L + 1, n, N))  # of the state after each sample; the last one has none
    for j in reversed(range(L)):
        q[j] = plant.C.T @ l[j] + plant.A.T @ q[j + 1] - pull[j]
    first, q = q[0], q[1:]
    a, b, size = np.abs(q), np.abs(l), Numbers(*map(np.abs, plant))
    into, sums = lambda M, x: np.einsum("ij,ljN->liN", M, x), lambda x: x.sum((0, 1))
    column = lambda x: x[:, None]
    value = (
        sums(l * (mid - into(plant.D, samples.v))) - sums(q * (into(plant.B, samples.v) + column(plant.w))) - sums((first * prior.c)[None])
    )
    bound = sums(np.abs(into(plant.W.T, q)))
    bound += sums(a * (column(size.wide_w) + into(size.wide_B, V) + into(size.B, samples.slip)))
    bound += sums(b * (s + into(size.wide_D, V) + into(size.D, samples.slip)))
    whole = sums(a * (into(size.B, V) + column(size.w + size.W.sum(1)))) + sums(b * (np.abs(mid) + s + into(size.D, V)))
    off = into((size.wide_C + gamma * size.C).T, b) + into((size.wide_A + gamma * size.A).T, a) + gamma * np.abs(pull)
    with np.errstate(invalid="ignore", over="ignore"):
        bound += sums(np.where(off > 0, off * samples.reach, 0))
        a = np.abs(first)
        bound += np.abs((prior.S * first[:, None]).sum(0)).sum(0) + (a * prior.r).sum(0)
        whole += (a * (np.abs(prior.c) + np.abs(prior.S).sum(1) + prior.r)).sum(0)
        bound = up * (bound + gamma * whole) + 2.0**-500
    shown = (bound < np.inf) & (np.abs(value) < np.inf)
    return np.where(shown, value, 0), np.where(shown, bound, np.inf)
