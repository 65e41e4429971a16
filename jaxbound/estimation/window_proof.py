"""The proof that multipliers of the samples of a window give: an enclosure of one direction of one state,
rounding included.

States x_(j+1) = A x_j + B v_j + w_j, samples m_j = C x_j + D v_j + delta_j, |delta_j| <= s_j, and a first
state in a set. For every l:

    d x_J  =  sum_j l_j (m_j - D v_j - delta_j)  -  p_0 x_0  -  sum_j p_(j+1) (B v_j + w_j),
    p_j    =  C' l_j + A' p_(j+1) - d [j = J],

in which only delta, x_0 and w are unknown, each within its bounds. So d x_J lies in value +- bound; with d =
0 a value beyond its bound is a contradiction. Where p_j is rounded, or A and C are intervals, the difference
acts on x_j, of which bounds are known beforehand.

With unknown inputs x_(j+1) is what A, B and w make of x_j only before the sample; behind it the state is M of
that and H (m - D v - delta), see `models.unknown_directions`. The first state is that before its sample. So
p_j goes on as M' p_j, and l_j - H' p_j replaces l_j.

A run of an average (`window_runs`) has a multiplier u of its own: |m + sum F_v delta + sum F_w w| <= b, so
that of -sum l delta - sum p w all but u (m +- b) is left to l - F_v' u and W' p - F_w' u.
"""

from typing import NamedTuple

import jax
import numpy as np

from jaxbound.estimation.arrays import Array
from jaxbound.estimation.ordered import added, mapped, product
from jaxbound.estimation.window_runs import AverageRows, bounds_of
from jaxbound.estimation.window_search import WindowProgram
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

__all__ = ["Prior", "Samples", "enclosed", "reach_before", "window_of"]


class Prior(NamedTuple):
    """A set {c + S xi + diag(r) eta} of first states that keep strips |mid - T x| <= rad as well.

    Fields: c (n, N), S (n, n, N), r (n, N), mid, rad (t, N), the radius infinite where there is none.
    """

    c: Array
    S: Array
    r: Array
    mid: Array
    rad: Array


class Samples(NamedTuple):
    """L samples of windows.

    Fields: mid, rad (L, p, N), v, slip (L, m, N): see `zonotope_steps.Read`; reach (L,
    n, N): at least |x|.
    """

    mid: Array
    rad: Array
    v: Array
    slip: Array
    reach: Array


def window_of(
    plant: Numbers, strips: np.ndarray, prior: Prior, samples: Samples, runs: AverageRows | None = None
) -> WindowProgram:
    """Return the WindowProgram that a search takes, rounded to nearest; plant and strips T (t, n) in float64.

    Strips and runs, of averages, go neither with each other nor with unknown inputs.
    """
    L, dtype, x = len(samples.mid), samples.mid.dtype, np.asarray(prior.c, np.float64)
    M, H, tested = _taken_out(plant)
    e = np.empty(samples.mid.shape)
    for j in range(L):
        known = samples.mid[j] - product(plant.D, samples.v[j])
        x = x if M is None else product(M, x) + product(H, known)
        e[j] = known - product(plant.C, x)
        x = product(plant.A, x) + product(plant.B, samples.v[j]) + plant.w[:, None]
    seen = np.isfinite(samples.rad)
    least = (
        1e-9 * np.max(np.where(seen, samples.rad, 0), (0, 1), keepdims=True) + 1e-30
    )  # a search divides by it
    S = prior.S + np.eye(len(prior.r))[:, :, None] * prior.r[None]
    s = np.where(seen, np.maximum(samples.rad, least), np.inf)
    A, W, scale = plant.A, plant.W, None
    if M is not None:  # the errors of outputs that are used up are disturbances, as large as their bounds
        used = ~tested
        size = np.where(seen, s, 1)[:, used]
        S = np.concatenate([np.einsum("ij,jkN->ikN", M, S), -H[:, used, None] * size[0][None]], 1)
        A, W = M @ A, np.concatenate([M @ W, -H[:, used]], 1)
        later = np.concatenate([size[1:], size[-1:]])
        scale = np.concatenate([np.ones((L, plant.W.shape[1], later.shape[-1])), later], 1).astype(dtype)
    p, t = int(tested.sum()), len(strips)
    rows = np.arange(-t, L * p)
    last = (rows >= 0) & (rows % p == p - 1)
    held = np.isfinite(prior.rad)
    thin = 1e-9 * np.max(np.where(held, prior.rad, 0), 0, initial=0) + 1e-30
    flat = lambda strip, x: np.concatenate([strip, x[:, tested].reshape(L * p, -1)])
    first = (
        np.where(held, prior.mid - product(strips, np.asarray(prior.c, np.float64)), 0),
        np.where(held, np.maximum(prior.rad, thin), np.inf),
    )
    rows_of = np.concatenate([strips, np.tile(plant.C[tested], (L, 1))])
    given = A, W, S, rows_of, flat(first[0], np.where(seen, e, 0)), flat(first[1], s)
    A, W, S, c, e, s = (np.asarray(x, dtype) for x in given)
    averages = None
    if runs is not None:
        b = bounds_of(runs, samples.rad)
        near = np.maximum(b, 1e-9 * np.max(np.where(np.isfinite(b), b, 0), 0) + 1e-30)
        averages = tuple(
            x.astype(dtype)
            for x in (*(x.reshape(len(b), -1) for x in runs[:2]), runs.m[:, None] / near, near)
        )
    return WindowProgram(
        A,
        W,
        S,
        c,
        e,
        s,
        np.maximum(rows // p, -1).astype(np.int32),
        last,
        np.flatnonzero(last),
        scale,
        averages,
    )


def _taken_out(plant):
    """Return (M, H, the outputs (p,) that are left to test) of the one way to take unknown inputs out; None,
    None, all without any.
    """
    if plant.free is None:
        return None, None, np.ones(len(plant.C), bool)
    return plant.free.M[..., 0], plant.free.H[..., 0], plant.free.used[:, 0] == 0


def reach_before(plant: Numbers, prior: Prior, samples: Samples) -> np.ndarray:
    """Return (L, n, N): at least the size of what A, B and w make of each state, before unknown inputs are
    added to it.
    """
    size = jax.tree.map(np.abs, plant)
    first = np.abs(prior.c) + added(np.abs(prior.S), 1) + prior.r
    into = lambda X, wide, x: mapped(X + wide, x[:-1].astype(np.float64), 1)
    with np.errstate(invalid="ignore", over="ignore"):
        moved = into(size.A, size.wide_A, np.where(np.isfinite(samples.reach), samples.reach, 1e300))
    moved += into(size.B, size.wide_B, np.abs(samples.v)) + into(size.B, 0, samples.slip)
    return np.concatenate(
        [first[None], (moved + (size.w + size.W.sum(1) + size.wide_w)[:, None]) * (1 + 1e-9)]
    )


def enclosed(
    plant: Numbers,
    strips: np.ndarray,
    prior: Prior,
    samples: Samples,
    weight: Array,
    d: np.ndarray,
    J: np.ndarray,
    before: bool = False,
    runs: AverageRows | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, bound), each (N,) in float64: d x_J lies in value +- bound for all that explains the
    samples.

    An infinite bound shows nothing. Windows stand side by side in blocks of one size, so that none depends on
    those beside it. All on the
    host: a program would be compiled for longer than most recordings take.

    Args:
        plant, strips, runs: as of `window_of`. weight (R + a, N): multipliers of the rows of its program and
            of its runs, any. d (n, N), J (N,). before: whether x_J is the state before its sample is looked
            at; that is another one with unknown inputs alone.
    """
    (L, p, N), (n, m), g = samples.mid.shape, plant.B.shape, plant.W.shape[1]
    t = len(strips)
    terms = L * (2 * n + m + p + g + 8) + n + t * (n + 2) + 4 * (0 if runs is None else len(runs.m))
    M, H, tested = _taken_out(plant)
    gamma, up = (
        float(rounding.product_error(terms, np.float64)[0]),
        1 + 8 * terms * float(rounding.unit(np.float64)),
    )
    prior, samples, weight, d = jax.tree.map(lambda x: np.asarray(x, np.float64), (prior, samples, weight, d))
    seen = np.isfinite(samples.rad)
    l = np.zeros(seen.shape)
    of_runs = weight[len(weight) - (0 if runs is None else len(runs.m)) :]
    l[:, tested] = weight[t : len(weight) - len(of_runs)].reshape(L, -1, N)
    l = np.where(seen & (np.abs(l) < 2.0**60), l, 0)
    within = np.isfinite(prior.rad) & (np.abs(weight[:t]) < 2.0**60)
    strip, width = np.where(within, weight[:t], 0), np.where(within, prior.rad, 0)
    mid, s, V = np.where(seen, samples.mid, 0), np.where(seen, samples.rad, 0), np.abs(samples.v)
    pull = np.where(np.arange(L)[:, None, None] == J, d, 0)
    q, r = (
        np.zeros((L + 1, n, N)),
        np.zeros((L, n, N)),
    )  # of the state after each sample; the last one has none
    behind, ahead = (0 * pull, pull) if before and M is not None else (pull, 0 * pull)
    for j in reversed(range(L)):
        r[j] = product(plant.C.T, l[j]) + product(plant.A.T, q[j + 1]) - behind[j]
        q[j] = r[j] if M is None else product(M.T, r[j]) - ahead[j]
    first, q, size = q[0] + product(strips.T, strip), q[1:], jax.tree.map(np.abs, plant)
    into, sums = lambda M, x: np.einsum("ij,ljN->liN", M, x), lambda x: x.sum((0, 1))
    off = (
        into((size.wide_C + gamma * size.C).T, np.abs(l))
        + into((size.wide_A + gamma * size.A).T, np.abs(q))
        + gamma * np.abs(pull)
    )
    off[0] += gamma * (product(np.abs(strips).T, np.abs(strip)) + np.abs(first))
    if M is not None:
        l = l - into(H.T, r)
    a, b = np.abs(q), np.abs(l)
    column = lambda x: x[:, None]
    drawn = into(plant.B, samples.v) + column(plant.w)
    value = (
        sums(l * (mid - into(plant.D, samples.v)))
        - sums(q * drawn)
        - (first * prior.c).sum(0)
        + (strip * prior.mid).sum(0)
    )
    on_delta, on_w, m, reach, size_m = (
        (0, 0, 0, 0, 0) if runs is None else _of_runs(runs, samples.rad, s, of_runs)
    )
    value = value + m
    bound = reach + sums(np.abs(into(plant.W.T, q) - on_w)) + (np.abs(strip) * width).sum(0)
    bound += sums(a * (column(size.wide_w) + into(size.wide_B, V) + into(size.B, samples.slip)))
    bound += sums(np.abs(l - on_delta) * s + b * (into(size.wide_D, V) + into(size.D, samples.slip)))
    whole = (
        size_m
        + sums(a * (into(size.B, V) + column(size.w + size.W.sum(1))))
        + sums(b * (np.abs(mid) + s + into(size.D, V)))
    )
    whole += (np.abs(strip) * (np.abs(prior.mid) + width)).sum(0)
    with np.errstate(invalid="ignore", over="ignore"):
        bound += sums(np.where(off > 0, off * samples.reach, 0))
        if M is not None:
            bound += _of_taking_out(plant, size, prior, samples, np.abs(r), gamma, pull)
        a = np.abs(first)
        bound += np.abs((prior.S * first[:, None]).sum(0)).sum(0) + (a * prior.r).sum(0)
        whole += (a * (np.abs(prior.c) + np.abs(prior.S).sum(1) + prior.r)).sum(0)
        bound = up * (bound + gamma * whole) + 2.0**-500
    shown = (bound < np.inf) & (np.abs(value) < np.inf)  # not where it is NaN
    return np.where(shown, value, 0), np.where(shown, bound, np.inf)


def _of_runs(runs, rad, s, u):
    """Return (what runs take of the multipliers of errors (L, p, N), of disturbances (L, g, N), value, bound,
    magnitudes (N,)).
    """
    b = bounds_of(runs, rad)
    u = np.where(np.isfinite(b) & (np.abs(u) < 2.0**60), u, 0)
    b, size, turned = np.where(np.isfinite(b), b, 0), np.abs(u), lambda F, x: np.einsum("aLp,aN->LpN", F, x)
    whole = (
        (turned(np.abs(runs.v), size) * s).sum((0, 1))
        + turned(np.abs(runs.w), size).sum((0, 1))
        + (np.abs(runs.m)[:, None] * size).sum(0)
    )
    return turned(runs.v, u), turned(runs.w, u), (runs.m[:, None] * u).sum(0), (b * size).sum(0), whole


def _of_taking_out(plant, size, prior, samples, r, gamma, pull):
    """Return (N,) what rounding of M' r and H' r costs; infinite where an output is missing that is to be
    used up.
    """
    free, into = size.free, lambda X, x: np.einsum("ij,ljN->liN", X, x)
    seen = np.isfinite(samples.rad)
    of_sample = into((free.wide_H[..., 0] + gamma * free.H[..., 0]).T, r)
    value = (
        np.abs(np.where(seen, samples.mid, 0))
        + into(size.D + size.wide_D, np.abs(samples.v))
        + into(size.D, samples.slip)
    )
    value = np.where(seen, value + np.where(seen, samples.rad, 0), np.inf)
    of_state = into((free.wide_M[..., 0] + gamma * free.M[..., 0]).T, r) + gamma * np.abs(pull)
    reach = reach_before(plant, prior, samples)
    acts = lambda x, on: np.where(x > 0, np.where(x > 0, x, 0) * np.where(x > 0, on, 0), 0).sum((0, 1))
    return acts(of_sample, value) + acts(of_state, reach)
