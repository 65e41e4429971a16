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
from jaxbound.estimation.window_search import WindowAverages, WindowProgram
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

__all__ = ["Prior", "Samples", "enclosed", "reach_before", "window_of"]

STEEPEST = 2.0**60
"""Multipliers from it on are taken for 0: any will do, and these would overflow."""
THIN = 1e-9
"""Share of the widest bound that a search takes for the narrowest, since it divides by it."""


class Prior(NamedTuple):
    """A set {c + S xi + diag(r) eta} of first states that keep strips |mid - T x| <= rad as well.

    Fields: c (n, N), S (n, n, N), r (n, N), mid, rad (t, N), the radius infinite where there is none.
    """

    c: np.ndarray
    S: np.ndarray
    r: np.ndarray
    mid: np.ndarray
    rad: np.ndarray


class Samples(NamedTuple):
    """L samples of windows.

    Fields: mid, rad (L, p, N), v, slip (L, m, N): see `zonotope_steps.Read`; reach (L, n, N): at least |x|.
    """

    mid: np.ndarray
    rad: np.ndarray
    v: np.ndarray
    slip: np.ndarray
    reach: np.ndarray


class _TakenOut(NamedTuple):
    """The one way to take unknown inputs out of a sample.

    Fields: M (n, n), H (n, p): the state behind it is M x + H (m - D v - delta); used (p,): outputs that this
    uses up.
    """

    M: Array
    H: Array
    used: np.ndarray


class _Motion(NamedTuple):
    """The plant of a window, whose unknown inputs are taken out.

    Fields: A (n, n), W (n, g); S (n, k, N): of first states; scale (L, g, N): factors of W, or None.
    """

    A: Array
    W: Array
    S: np.ndarray
    scale: np.ndarray | None


def window_of(
    plant: Numbers, strips: np.ndarray, prior: Prior, samples: Samples, runs: AverageRows | None = None
) -> WindowProgram:
    """Return the WindowProgram that a search takes, rounded to nearest; plant and strips T (t, n) in float64.

    Strips and runs, of averages, go neither with each other nor with unknown inputs.
    """
    L, dtype, t = len(samples.mid), samples.mid.dtype, len(strips)
    taken, tested = _taken_out(plant), _tested(plant)
    e = _prediction_errors(plant, taken, prior, samples)
    present = np.isfinite(samples.rad)
    least = THIN * np.max(np.where(present, samples.rad, 0), (0, 1), keepdims=True) + 1e-30
    s = np.where(present, np.maximum(samples.rad, least), np.inf)
    S = prior.S + np.eye(len(prior.r))[:, :, None] * prior.r[None]
    motion = _Motion(plant.A, plant.W, S, None)
    if taken is not None:
        motion = _motion_taken_out(plant, taken, S, np.where(present, s, 1))

    def rows(of_strips: np.ndarray, of_samples: np.ndarray) -> np.ndarray:
        """Return numbers of strips and of the outputs that are tested as rows of the program."""
        flat = of_samples[:, tested].reshape(L * int(tested.sum()), -1)
        return np.concatenate([of_strips, flat]).astype(dtype)

    bounded = np.isfinite(prior.rad)
    thin = THIN * np.max(np.where(bounded, prior.rad, 0), 0, initial=0) + 1e-30
    off_strips = np.where(bounded, prior.mid - product(strips, np.asarray(prior.c, np.float64)), 0)
    p = int(tested.sum())
    number = np.arange(-t, L * p)
    last = (number >= 0) & (number % p == p - 1)
    averages = None
    if runs is not None:
        averages = _averages(runs, samples.rad, dtype)
    return WindowProgram(
        A=motion.A.astype(dtype),
        W=motion.W.astype(dtype),
        S=motion.S.astype(dtype),
        c=np.concatenate([strips, np.tile(plant.C[tested], (L, 1))]).astype(dtype),
        e=rows(off_strips, np.where(present, e, 0)),
        s=rows(np.where(bounded, np.maximum(prior.rad, thin), np.inf), s),
        step=np.maximum(number // p, -1).astype(np.int32),
        last=last,
        ends=np.flatnonzero(last),
        scale=motion.scale,
        averages=averages,
    )


def _prediction_errors(plant: Numbers, taken: _TakenOut | None, prior: Prior, samples: Samples) -> np.ndarray:
    """Return (L, p, N): samples less what the middle of everything predicts."""
    e, x = np.empty(samples.mid.shape), np.asarray(prior.c, np.float64)
    for j in range(len(e)):
        known = samples.mid[j] - product(plant.D, samples.v[j])
        if taken is not None:
            x = product(taken.M, x) + product(taken.H, known)
        e[j] = known - product(plant.C, x)
        x = product(plant.A, x) + product(plant.B, samples.v[j]) + plant.w[:, None]
    return e


def _motion_taken_out(plant: Numbers, taken: _TakenOut, S: np.ndarray, size: np.ndarray) -> _Motion:
    """Return the motion where errors of outputs that are used up are disturbances, as large as their bounds.

    Args:
        S (n, k, N): of first states. size (L, p, N): bounds of errors.
    """
    M, H, used = taken
    size = size[:, used]
    first = np.concatenate([np.einsum("ij,jkN->ikN", M, S), -H[:, used, None] * size[0][None]], 1)
    later = np.concatenate([size[1:], size[-1:]])
    of_disturbances = np.ones((len(size), plant.W.shape[1], later.shape[-1]))
    scale = np.concatenate([of_disturbances, later], 1).astype(size.dtype)
    return _Motion(M @ plant.A, np.concatenate([M @ plant.W, -H[:, used]], 1), first, scale)


def _averages(runs: AverageRows, rad: np.ndarray, dtype: np.dtype) -> WindowAverages:
    """Return the averages of a program, as parts of their bounds."""
    b = bounds_of(runs, rad)
    near = np.maximum(b, THIN * np.max(np.where(np.isfinite(b), b, 0), 0) + 1e-30)
    return WindowAverages(
        runs.v.reshape(len(b), -1).astype(dtype),
        runs.w.reshape(len(b), -1).astype(dtype),
        (runs.m[:, None] / near).astype(dtype),
        near.astype(dtype),
    )


def _taken_out(plant: Numbers) -> _TakenOut | None:
    """Return the one way to take unknown inputs out of a sample; None without any."""
    if plant.free is None:
        return None
    used = np.asarray(plant.free.used[:, 0] != 0)
    return _TakenOut(plant.free.M[..., 0], plant.free.H[..., 0], used)


def _tested(plant: Numbers) -> np.ndarray:
    """Return (p,) bool: the outputs that are left to test."""
    taken = _taken_out(plant)
    if taken is None:
        return np.ones(len(plant.C), bool)
    return ~taken.used


def reach_before(plant: Numbers, prior: Prior, samples: Samples) -> np.ndarray:
    """Return (L, n, N): at least the size of what A, B and w make of each state, before unknown inputs are
    added to it.
    """
    size = jax.tree.map(np.abs, plant)
    first = np.abs(prior.c) + added(np.abs(prior.S), 1) + prior.r

    def into(X: np.ndarray, x: np.ndarray) -> np.ndarray:
        return mapped(X, x[:-1].astype(np.float64), 1)

    with np.errstate(invalid="ignore", over="ignore"):
        known = np.where(np.isfinite(samples.reach), samples.reach, 1e300)
        moved = into(size.A + size.wide_A, known)
    moved += into(size.B + size.wide_B, np.abs(samples.v)) + into(size.B, samples.slip)
    drawn = (size.w + size.W.sum(1) + size.wide_w)[:, None]
    return np.concatenate([first[None], (moved + drawn) * (1 + 1e-9)])


class _Multipliers(NamedTuple):
    """The multipliers of a proof in float64, 0 where nothing is known.

    Fields: l (L, p, N): of samples; strip (t, N): of strips of the first state; runs (a, N): of averages.
    """

    l: np.ndarray
    strip: np.ndarray
    runs: np.ndarray


class _Adjoint(NamedTuple):
    """The coefficients p_j of the states, see the module.

    Fields: r (L, n, N): of the state behind its sample; q (L, n, N): of what A, B and w make of it, the last
    one 0; first (n, N): of the first state.
    """

    r: np.ndarray
    q: np.ndarray
    first: np.ndarray


class _OfRuns(NamedTuple):
    """The part of averages in a proof.

    Fields: on_delta (L, p, N), on_w (L, g, N): what they take of the multipliers of errors and of
    disturbances; value, bound, whole (N,): their sums, bounds and magnitudes.
    """

    on_delta: np.ndarray | float
    on_w: np.ndarray | float
    value: np.ndarray | float
    bound: np.ndarray | float
    whole: np.ndarray | float


WITHOUT_RUNS = _OfRuns(0, 0, 0, 0, 0)


def enclosed(
    plant: Numbers,
    strips: np.ndarray,
    prior: Prior,
    samples: Samples,
    weight: np.ndarray,
    d: np.ndarray,
    J: np.ndarray,
    before: bool = False,
    runs: AverageRows | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return (value, bound), each (N,) in float64: d x_J lies in value +- bound for all that explains the
    samples.

    An infinite bound shows nothing. Windows stand side by side in blocks of one size, so that none depends on
    those beside it. All on the host: a program would be compiled for longer than most recordings take.

    Args:
        plant, strips, runs: as of `window_of`. weight (R + a, N): multipliers of the rows of its program and
            of its runs, any. d (n, N), J (N,). before: whether x_J is the state before its sample is looked
            at; that is another one with unknown inputs alone.
    """
    (L, p, _), (n, m), g, t = samples.mid.shape, plant.B.shape, plant.W.shape[1], len(strips)
    terms = L * (2 * n + m + p + g + 8) + n + t * (n + 2)
    if runs is not None:
        terms += 4 * len(runs.m)
    gamma = float(rounding.product_error(terms, np.float64)[0])
    up = 1 + 8 * terms * float(rounding.unit(np.float64))
    prior, samples, weight, d = jax.tree.map(lambda x: np.asarray(x, np.float64), (prior, samples, weight, d))
    taken, size = _taken_out(plant), jax.tree.map(np.abs, plant)
    given = _multipliers(plant, prior, samples, weight, t, runs)
    pull = np.where(np.arange(L)[:, None, None] == J, d, 0)
    adjoint = _adjoint(plant, taken, strips, given, pull, before)
    off = _rounding_of_adjoint(size, strips, given, adjoint, pull, gamma)
    l = given.l
    if taken is not None:
        l = l - _each_step(taken.H.T, adjoint.r)
    value, bound, whole = _sums_of_window(plant, size, prior, samples, given, adjoint, l, runs)
    with np.errstate(invalid="ignore", over="ignore"):
        bound += _sums(np.where(off > 0, off * samples.reach, 0))
        if taken is not None:
            bound += _of_taking_out(plant, size, prior, samples, np.abs(adjoint.r), gamma, pull)
        a = np.abs(adjoint.first)
        bound += np.abs((prior.S * adjoint.first[:, None]).sum(0)).sum(0) + (a * prior.r).sum(0)
        whole += (a * (np.abs(prior.c) + np.abs(prior.S).sum(1) + prior.r)).sum(0)
        bound = up * (bound + gamma * whole) + 2.0**-500
    shown = (bound < np.inf) & (np.abs(value) < np.inf)  # not where it is NaN
    return np.where(shown, value, 0), np.where(shown, bound, np.inf)


def _each_step(M: Array, x: np.ndarray) -> np.ndarray:
    """Return M x for M (r, n) and each step of x (L, n, N)."""
    image: np.ndarray = np.einsum("ij,ljN->liN", M, x)
    return image


def _sums(x: np.ndarray) -> np.ndarray:
    """Return the sums (N,) over steps and signals."""
    sums: np.ndarray = x.sum((0, 1))
    return sums


def _multipliers(
    plant: Numbers, prior: Prior, samples: Samples, weight: np.ndarray, t: int, runs: AverageRows | None
) -> _Multipliers:
    """Return the multipliers of t strips, of samples and of runs, which stand in `weight` in this order."""
    L, _, N = samples.mid.shape
    count = 0
    if runs is not None:
        count = len(runs.m)
    of_samples, of_runs = np.split(weight[t:], [len(weight) - t - count])
    l = np.zeros(samples.rad.shape)
    l[:, _tested(plant)] = of_samples.reshape(L, -1, N)
    l = np.where(np.isfinite(samples.rad) & (np.abs(l) < STEEPEST), l, 0)
    within = np.isfinite(prior.rad) & (np.abs(weight[:t]) < STEEPEST)
    return _Multipliers(l, np.where(within, weight[:t], 0), of_runs)


def _adjoint(
    plant: Numbers,
    taken: _TakenOut | None,
    strips: np.ndarray,
    given: _Multipliers,
    pull: np.ndarray,
    before: bool,
) -> _Adjoint:
    """Return the adjoint states. pull (L, n, N): d at its step; before: as of `enclosed`."""
    L, n, N = pull.shape
    q, r = np.zeros((L + 1, n, N)), np.zeros((L, n, N))
    behind, ahead = pull, 0 * pull
    if before and taken is not None:
        behind, ahead = 0 * pull, pull
    for j in reversed(range(L)):
        r[j] = product(plant.C.T, given.l[j]) + product(plant.A.T, q[j + 1]) - behind[j]
        q[j] = r[j]
        if taken is not None:
            q[j] = product(taken.M.T, r[j]) - ahead[j]
    return _Adjoint(r, q[1:], q[0] + product(strips.T, given.strip))


def _rounding_of_adjoint(
    size: Numbers,
    strips: np.ndarray,
    given: _Multipliers,
    adjoint: _Adjoint,
    pull: np.ndarray,
    gamma: float,
) -> np.ndarray:
    """Return (L, n, N): by which the adjoint may be off, in what acts on each state."""
    off = (
        _each_step((size.wide_C + gamma * size.C).T, np.abs(given.l))
        + _each_step((size.wide_A + gamma * size.A).T, np.abs(adjoint.q))
        + gamma * np.abs(pull)
    )
    of_strips = product(np.abs(strips).T, np.abs(given.strip))
    off[0] += gamma * (of_strips + np.abs(adjoint.first))
    return np.asarray(off)


def _sums_of_window(
    plant: Numbers,
    size: Numbers,
    prior: Prior,
    samples: Samples,
    given: _Multipliers,
    adjoint: _Adjoint,
    l: np.ndarray,
    runs: AverageRows | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (value, bound, whole) (N,): the sums of samples, inputs and disturbances, their bounds, and the
    magnitudes that rounding takes a share of; of the first state its middle alone.

    Args:
        l (L, p, N): multipliers of samples, those that take unknown inputs out with them.
    """
    _, q, first = adjoint
    seen, strip = np.isfinite(samples.rad), given.strip
    mid, s, V = np.where(seen, samples.mid, 0), np.where(seen, samples.rad, 0), np.abs(samples.v)
    width = np.where(np.isfinite(prior.rad), prior.rad, 0)
    a, b = np.abs(q), np.abs(l)
    drawn = _each_step(plant.B, samples.v) + plant.w[:, None]
    value = (
        _sums(l * (mid - _each_step(plant.D, samples.v)))
        - _sums(q * drawn)
        - (first * prior.c).sum(0)
        + (strip * prior.mid).sum(0)
    )
    average = WITHOUT_RUNS
    if runs is not None:
        average = _of_runs(runs, samples.rad, s, given.runs)
    value = value + average.value
    bound = average.bound + _sums(np.abs(_each_step(plant.W.T, q) - average.on_w))
    bound = bound + (np.abs(strip) * width).sum(0)
    wide_w = size.wide_w[:, None]
    bound += _sums(a * (wide_w + _each_step(size.wide_B, V) + _each_step(size.B, samples.slip)))
    through = _each_step(size.wide_D, V) + _each_step(size.D, samples.slip)
    bound += _sums(np.abs(l - average.on_delta) * s + b * through)
    whole = (
        average.whole
        + _sums(a * (_each_step(size.B, V) + (size.w + size.W.sum(1))[:, None]))
        + _sums(b * (np.abs(mid) + s + _each_step(size.D, V)))
    )
    whole += (np.abs(strip) * (np.abs(prior.mid) + width)).sum(0)
    return value, bound, whole


def _of_runs(runs: AverageRows, rad: np.ndarray, s: np.ndarray, u: np.ndarray) -> _OfRuns:
    """Return the part of averages.

    Args:
        rad, s (L, p, N): radii of samples, infinite and 0 without one. u (a, N): multipliers.
    """
    b = bounds_of(runs, rad)
    bounded = np.isfinite(b)
    u = np.where(bounded & (np.abs(u) < STEEPEST), u, 0)
    b, size = np.where(bounded, b, 0), np.abs(u)
    whole = (
        (_turned(np.abs(runs.v), size) * s).sum((0, 1))
        + _turned(np.abs(runs.w), size).sum((0, 1))
        + (np.abs(runs.m)[:, None] * size).sum(0)
    )
    value, bound = (runs.m[:, None] * u).sum(0), (b * size).sum(0)
    return _OfRuns(_turned(runs.v, u), _turned(runs.w, u), value, bound, whole)


def _turned(F: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return F' x (L, p, N) for F (a, L, p), x (a, N)."""
    turned: np.ndarray = np.einsum("aLp,aN->LpN", F, x)
    return turned


def _of_taking_out(
    plant: Numbers,
    size: Numbers,
    prior: Prior,
    samples: Samples,
    r: np.ndarray,
    gamma: float,
    pull: np.ndarray,
) -> np.ndarray:
    """Return (N,): what rounding of M' r and H' r costs; infinite where an output is missing that is to be
    used up.
    """
    free, seen = size.free, np.isfinite(samples.rad)
    assert free is not None  # asked of plants with unknown inputs alone
    of_sample = _each_step((free.wide_H[..., 0] + gamma * free.H[..., 0]).T, r)
    value = (
        np.abs(np.where(seen, samples.mid, 0))
        + _each_step(size.D + size.wide_D, np.abs(samples.v))
        + _each_step(size.D, samples.slip)
    )
    value = np.where(seen, value + np.where(seen, samples.rad, 0), np.inf)
    of_state = _each_step((free.wide_M[..., 0] + gamma * free.M[..., 0]).T, r) + gamma * np.abs(pull)
    reach = reach_before(plant, prior, samples)
    cost: np.ndarray = _acting(of_sample, value) + _acting(of_state, reach)
    return cost


def _acting(x: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Return the sums (N,) of x >= 0 times numbers that may be infinite; where x is 0 these do not act."""
    acts = x > 0
    return _sums(np.where(acts, np.where(acts, x, 0) * np.where(acts, on, 0), 0))
