"""The linear program of one window whose first state lies in a set, solved in plain floats: multipliers of
its samples, no claim.

A window has states x_0 = c + S xi, x_(j+1) = A x_j + W w_j + .., and samples |e_j - C x_j| <= s_j of L steps,
e_j and x_j less what the middle of everything predicts. All unknowns have the size 1:

    z = (xi, w, v),    v_j = (e_j - C x_j) / s_j,    every |z_i| <= 1,

and perhaps rows a = m + F_v v + F_w w of these, averages over several samples, that are at most 1 as well.

Two questions, both by a primal-dual interior point method (Mizuno, Todd, Ye 1993; Wright 1997, chapter 5, its
path at a fixed pace):

    gauge      t = min max_i |z_i|: below 1 the window is explained, above it is not
    support    max d x_J of one state, over all that explains the window

Its Newton steps are least-squares problems with weights, so one is a Kalman filter forward and its adjoint
backward (Bryson, Frazier 1963): work and memory grow with the length of the window alone, and sets of windows
lie side by side on the last axis. Averages are met behind it, all at once (Woodbury): one more right-hand
side each.

What comes out are multipliers, one a sample. Any numbers will do for the proof (`window`); these are
nearly the best ones.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.estimation.window import Image, WindowPlant, through

PACE = 0.15
"""Share of the complementarity that is left after a step."""
STEPS = 40
VERDICT = 0.02
"""Gap, relative, at which the search for a gauge is done: far enough for a verdict."""
CLOSE = {"float64": (1e-9, 1e-6), "float32": (1e-4, 1e-4)}
"""The same for a support, without and with strips: several bounds of one first state are nearly parallel, and
closer to the optimum their multipliers lose their digits.
"""
LOST = 1e-3
"""How far a sample may be off the trajectory of a search, as a share of the largest unknown."""
START = 0.3
"""Complementarity at which a support begins: directions are such that it is about 1."""
SOFT = 2.0**-20, 2.0**-10
"""Added to the weights of what averages hold, in float64 and float32: what nothing else holds would move
without end before they do.
"""
THIN = 1e-9
"""Share of the widest bound that a search takes for the narrowest, since it divides by it."""


class WindowProgram(NamedTuple):
    """N windows of L steps.

    Fields: A (n, n), C (p, n), T (t, n), W (n, g); S (n, k, N); scale (L, g, N): factors of W after each
    step; e, s (R, N): |e - c x_j| <= s of t strips of x_0, then of p outputs of each step, s infinite where
    there is none. Averages, at most 1 is m + (F_v s v + F_w w) / b: F_v (a, L p), F_w (a, L g); m (a, N); b
    (a, N), infinite where nothing is said.
    """

    A: Array
    C: Array
    T: Array
    W: Array
    S: Array
    scale: Array
    e: Array
    s: Array
    F_v: Array
    F_w: Array
    m: Array
    b: Array

    @property
    def steps(self) -> int:
        """How many steps a window has."""
        return (len(self.s) - len(self.T)) // len(self.C)


class _Path(NamedTuple):
    """The central path at one step, N programs side by side.

    Fields: z (K, N), t (1, N): the unknowns and their bound; up, down (K, N): multipliers of z <= t and -z <=
    t; mu (1, N): complementarity; gap (1, N): relative; weight (R + a, N) of samples and averages; done
    (1, N); step.
    """

    z: jax.Array
    t: jax.Array
    up: jax.Array
    down: jax.Array
    mu: jax.Array
    gap: jax.Array
    weight: jax.Array
    done: jax.Array
    step: jax.Array | int


def _thinnest(rad: np.ndarray) -> np.ndarray:
    """Return radii (R, N), none of which is far smaller than the largest."""
    largest = np.max(np.where(np.isfinite(rad), rad, 0), 0, initial=0)
    return np.asarray(np.maximum(rad, THIN * largest + 1e-30))


def program_of(plant: WindowPlant, image: Image, dtype: np.dtype) -> WindowProgram:
    """Return the WindowProgram of windows, rounded to nearest.

    What is left of a sample by which unknown inputs are taken out is that of a plant A' = M A, W' = [M W, -H
    s], whose disturbances are the errors that are used up.
    """
    M, _, H, _, used = plant.taking
    A, W, C = np.asarray(plant.plant.A), np.asarray(plant.plant.W), np.asarray(plant.plant.C)[~used]
    prior, runs, (L, _, N) = image.prior, plant.runs, image.m.shape
    seen, bounded = np.isfinite(image.rad), np.isfinite(prior.rad)
    s = _thinnest(image.rad.reshape(-1, N)).reshape(image.rad.shape)
    size = np.where(seen, s, 1)[:, used]
    S = prior.S + np.eye(len(A))[:, :, None] * prior.r[None]
    S = np.concatenate([np.einsum("ij,jkN->ikN", M, S), -H[:, used, None] * size[0][None]], 1)
    later = np.concatenate([size[1:], size[-1:]])
    scale = np.concatenate([np.ones((L, W.shape[1], N)), later], 1)
    # of a strip that says nothing the radius is infinite, and its middle means nothing
    off = np.where(bounded, prior.mid - through(plant.strips, prior.c), 0)
    e = np.where(seen, _prediction_errors(plant, image), 0)[:, ~used].reshape(-1, N)
    b = _thinnest(image.b)
    rows = np.concatenate([off, e]), np.concatenate([_thinnest(prior.rad), s[:, ~used].reshape(-1, N)])
    motion = M @ A, C, plant.strips, np.concatenate([M @ W, -H[:, used]], 1), S, scale
    F_v, F_w = runs.v.reshape(len(b), L * runs.v.shape[2]), runs.w.reshape(len(b), L * runs.w.shape[2])
    averages = F_v, F_w, runs.m[:, None] / b, b
    return WindowProgram(*(x.astype(dtype) for x in (*motion, *rows, *averages)))


def _prediction_errors(plant: WindowPlant, image: Image) -> np.ndarray:
    """Return (L, p, N): samples less what the middle of everything predicts."""
    M, _, H, *_ = plant.taking
    x, states = image.prior.c, np.empty(image.f.shape)
    for j in range(len(states)):
        states[j] = through(M, x) + through(H, image.m[j])
        x = through(plant.plant.A, states[j]) + image.f[j]
    return np.asarray(image.m - through(plant.plant.C, states))


def split(z: Array, window: WindowProgram) -> tuple[Array, Array, Array]:
    """Return xi (k, .., N), w (L, g, .., N), v (R, .., N) of all unknowns z (K, .., N); the effect of the
    last w is not looked at.
    """
    k, g, L = window.S.shape[1], window.W.shape[1], window.steps
    after = k + L * g
    return z[:k], z[k:after].reshape(L, g, *z.shape[1:]), z[after : after + len(window.s)]


def _unknowns(window: WindowProgram, z: jax.Array) -> jax.Array:
    """Return all unknowns (K, N) of the trajectory that the xi and w of z make: these, and the errors that it
    leaves.
    """
    first, N = window.S.shape[1], z.shape[-1]
    free = z[: len(z) - len(window.s) - len(window.b)]
    free = jnp.where(jnp.isfinite(free), free, 0)
    w = free[first:].reshape(window.scale.shape) * window.scale

    def move(x: jax.Array, drawn: jax.Array) -> tuple[jax.Array, jax.Array]:
        return _matrix_times(window.A, x) + _matrix_times(window.W, drawn), _matrix_times(window.C, x)

    x = jnp.sum(window.S * free[None, :first], 1)[:, None]
    _, shown = jax.lax.scan(move, x, w[:, :, None])
    errors = window.e - jnp.concatenate([_matrix_times(window.T, x)[:, 0], shown.reshape(-1, N)])
    known = jnp.concatenate([free, errors / window.s])
    if not len(window.b):
        return known
    seen = jnp.where(jnp.isfinite(window.s), errors, 0)[len(window.T) :]
    sums = window.F_v @ seen + window.F_w @ free[first:]
    return jnp.concatenate([known, window.m + sums / window.b])


def _matrix_times(M: Array, X: Array) -> jax.Array:
    """Return M X for M (r, n), X (n, a, N)."""
    return jnp.sum(M[:, :, None, None] * X[None], 1)


def _solved(
    window: WindowProgram, D: jax.Array, rho: jax.Array, d: jax.Array, J: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (dz, pulls), as `_filtered`, with the rows of averages behind theirs: (D da - rho) / b is the
    pull of one.
    """
    if not len(window.b):
        return _filtered(window, D, rho, d, J)
    (*_, F_v, F_w, _, b), (_, k, N) = window, rho.shape
    a, first = len(b), window.S.shape[1]
    after = len(D) - a - len(window.s)
    s = jnp.where(jnp.isfinite(window.s), window.s, 0)[:, None]

    def rows(z: jax.Array) -> jax.Array:
        """Return the averages of unknowns."""
        return (jnp.tensordot(F_v, s * z[after:], 1) + jnp.tensordot(F_w, z[first:after], 1)) / b[:, None]

    def back(x: jax.Array) -> jax.Array:
        """Return the pulls of averages as those of unknowns."""
        x = x / b[:, None]
        return jnp.concatenate(
            [
                jnp.zeros((first, *x.shape[1:]), x.dtype),
                jnp.tensordot(F_w.T, x, 1),
                s * jnp.tensordot(F_v.T, x, 1),
            ]
        )

    # one more right-hand side for each average (Woodbury)
    one = jnp.broadcast_to(jnp.eye(a, dtype=rho.dtype)[:, :, None], (a, a, N))
    more = jnp.concatenate([rho[:-a] + back(rho[-a:]), back(one)], 1)
    z, pulls = _filtered(
        window,
        jnp.where(D[:-a] > 0, D[:-a] + SOFT[D.dtype == np.float32], 0),
        more,
        jnp.concatenate([d, jnp.zeros((len(d), a, N), d.dtype)], 1),
        J,
    )
    root, values = jnp.sqrt(D[-a:])[:, None], rows(z)
    M = jnp.concatenate([one + root * values[:, k:] * jnp.swapaxes(root, 0, 1), root * values[:, :k]], 1)
    # a library's solver waits for threads that wait for it where blocks are searched side by side
    x = jax.lax.fori_loop(0, a, _eliminate, M)[:, a:]
    near, x = x / jnp.where(root > 0, root, 1), root * x

    def less(X: jax.Array) -> jax.Array:
        """Return X less the part that averages take."""
        return X[:, :k] - jnp.sum(X[:, k:, None] * x[None], 1)

    return jnp.concatenate([less(z), jnp.where(root > 0, near, less(values))]), jnp.concatenate(
        [less(pulls), (x - rho[-a:]) / b[:, None]]
    )


def _eliminate(i: jax.Array, M: jax.Array) -> jax.Array:
    """Return M (a, .., N) after pivot i; it is symmetric and at least 1: any order of pivots will do."""
    row = M[i] / jax.lax.dynamic_index_in_dim(M[i], i, 0)
    left = M - jax.lax.dynamic_index_in_dim(M, i, 1) * row[None]
    eliminated: jax.Array = jax.lax.dynamic_update_index_in_dim(left, row, i, 0)
    return eliminated


def _filtered(
    window: WindowProgram, D: jax.Array, rho: jax.Array, d: jax.Array, J: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (dz (K, k, N), pulls (R, k, N)): dz minimises sum_i D_i dz_i^2 / 2 - sum_i rho_i dz_i - d dx_J
    over the trajectories, by a Kalman filter forward and its adjoint backward.

    A pull is (D dv - rho) / s, the force of a sample on the states, without the digits that this formula
    would lose.

    Args:
        D (K, N): zero where there is no sample. rho (K, k, N). d (n, k, N), J (N,): the direction of a state,
            and its step.
    """
    A, C, T, W, S, scale, _, s, *_ = window
    n, t, L = len(A), len(T), window.steps
    D_xi, D_w, D_v = split(D, window)
    rho_xi, rho_w, rho_v = split(rho, window)
    s = jnp.where(jnp.isfinite(s), s, 1)[:, None]
    rows = _beside(_beside(D_v[:, None], s), rho_v)
    numbers = jnp.arange(L, dtype=J.dtype)

    def meet(M: jax.Array, now: tuple[Array, Array]) -> tuple[jax.Array, jax.Array]:
        """Meet (covariance, mean) M (n, n + k, N) with one row; return the gains too."""
        c, row = now
        D, s, rho = row[:1], row[1:2], row[2:]
        h = jnp.sum(c[:, None, None] * M, 0)
        far = s * s + D * jnp.sum(c[:, None] * h[:n], 0, keepdims=True)
        gain = jnp.concatenate([-D * h[:n], -s * rho - D * h[n:]]) / far
        return M + h[:n, None] * gain[None], gain

    def forward(M: jax.Array, now: tuple[Array, ...]) -> tuple[jax.Array, jax.Array]:
        """Meet M with one sample, and move it one step on."""
        rows, j, w, more, scale = now
        M, gains = jax.lax.scan(meet, M, (C, rows), unroll=True)
        pulled = jnp.sum(M[:, :n, None] * d[None], 1)  # a pull is like one more sample
        M = _matrix_times(A, _beside(M[:, :n], M[:, n:] + jnp.where((j == J)[None, None], pulled, 0)))
        w, more = w[:, None] / scale[:, None] ** 2, more / scale[:, None]
        by_A = jnp.sum(M[:, None, :n] * A[None, :, :, None], 2)
        by_W = jnp.sum(W[:, None, :, None] * W[None, :, :, None] / w[None, None, :, 0], 2)
        P = by_A + by_W
        return _beside(0.5 * (P + jnp.swapaxes(P, 0, 1)), M[:, n:] + _matrix_times(W, more / w)), gains

    def pull(q: jax.Array, now: tuple[Array, Array]) -> tuple[jax.Array, jax.Array]:
        """Pull the adjoint q (n, k, N) through one row."""
        c, gain = now
        by = jnp.sum(gain[:n, None] * q, 0) + gain[n:]
        return q + c[:, None, None] * by[None], by

    def backward(q: jax.Array, now: tuple[Array, Array]) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Pull the adjoint through one step and its sample."""
        gains, j = now
        into = _matrix_times(W.T, q)
        q = _matrix_times(A.T, q) + jnp.where((j == J)[None, None], d, 0)
        q, pulls = jax.lax.scan(pull, q, (C, gains), reverse=True, unroll=True)
        return q, (into, pulls)

    # covariance and mean are moved, and met with samples, as one
    first = jnp.sum(S[:, :, None] * (_beside(jnp.swapaxes(S, 0, 1), rho_xi) / D_xi[:, None])[None], 1)
    first, of_strips = jax.lax.scan(meet, first, (T, rows[:t]), unroll=True)
    samples = rows[t:].reshape(L, len(C), *rows.shape[1:])
    _, gains = jax.lax.scan(forward, first, (samples, numbers, D_w, rho_w, scale))
    q = jnp.zeros((n, *rho_xi.shape[1:]), rho_xi.dtype)
    q, (into, pulls) = jax.lax.scan(backward, q, (gains, numbers), reverse=True)
    q, first_pulls = jax.lax.scan(pull, q, (T, of_strips), reverse=True, unroll=True)
    pulls = jnp.concatenate([first_pulls, pulls.reshape(-1, *pulls.shape[2:])])
    xi = rho_xi + jnp.sum(S[:, :, None] * q[:, None], 0)
    w, v = rho_w + into * scale[:, :, None], rho_v + s * pulls
    seen = jnp.where(D > 0, D, 1)[:, None]
    return jnp.concatenate([xi, w.reshape(-1, *xi.shape[1:]), v]) / seen, pulls


def _beside(x: Array, y: Array) -> jax.Array:
    """Return arrays (r, .., N) one beside the other."""
    return jnp.concatenate([x, y], 1)


def searched(
    window: WindowProgram,
    z: np.ndarray | None = None,
    d: np.ndarray | None = None,
    J: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Return (multipliers (R + a, N), t (N,), z (K, N), lost (N,)) of the windows, t the largest |z_i|.

    xi, w and v move side by side in a search; where samples differ by many digits they may part, and its
    trajectory is lost.

    Args:
        z (K, N): where to begin: a gauge on the trajectory of its xi and w, None: of the middle; a support
            there, all |z_i| < 1. d (n, N), J (N,): the direction and step of a support; None for a gauge.
    """
    (n, k, N), dtype = window.S.shape, window.e.dtype
    if z is None:
        z = np.zeros((k + window.steps * window.W.shape[1] + len(window.s) + len(window.b), N))
    close, pull, at = VERDICT, np.zeros((n, 2, N)), np.zeros(N, np.int32)
    if d is not None and J is not None:
        at = np.asarray(J, np.int32)
        strips = bool(np.isfinite(window.s[: len(window.T)]).any())
        close, pull[:, 0] = CLOSE[dtype.name][strips], d
    found = _path(window, z.astype(dtype), pull.astype(dtype), at, d is None, np.asarray(close, dtype))
    return tuple(map(np.asarray, found))


@jax.jit
def _path(
    window: WindowProgram,
    z: jax.Array,
    pull: jax.Array,
    J: jax.Array,
    gauge: jax.Array | bool,
    close: jax.Array,
) -> tuple[jax.Array, ...]:
    """Follow the central path; return as `searched`."""
    bounds = jnp.concatenate([window.s, window.b])
    there = jnp.ones(z.shape, bool).at[len(z) - len(bounds) :].set(jnp.isfinite(bounds))
    z = jnp.where(gauge, _unknowns(window, z), z)

    def both(over: Callable[..., jax.Array], *pair: jax.Array) -> tuple[jax.Array, ...]:
        """Return the sums (1, N), or the largest, of both over the unknowns that there are."""
        return tuple(over(jnp.where(there, x, 0), 0)[None] for x in pair)

    count = jnp.sum(there, 0, dtype=pull.dtype)[None]

    def step(path: _Path) -> _Path:
        """Take one Newton step."""
        z, t, up, down, mu, gap, weight, done, k = path
        a, b = t - z, t + z
        D, E = jnp.where(there, up / a + down / b, 0), jnp.where(there, up / a - down / b, 0)
        rho = jnp.where(there, mu / b - mu / a, 0)
        found, pulls = _solved(window, D, jnp.stack([rho, E], 1), pull, J)
        p, q = found[:, 0], found[:, 1]
        barrier, steep = both(jnp.sum, mu / a + mu / b + E * p, D - E * q)
        dt = jnp.where(gauge, (barrier - 1) / steep, 0)
        dz = p + q * dt
        da, db = dt - dz, dt + dz
        d_up, d_down = mu / a - up - up / a * da, mu / b - down - down / b * db
        far, far_dual = both(jnp.max, jnp.maximum(-da / a, -db / b), jnp.maximum(-d_up / up, -d_down / down))
        longest = jnp.maximum(far, far_dual)
        finished = done | ((gap < 1e-4) & (longest > 50)) | ~(longest < jnp.inf)  # digits are used up
        alpha, beta = _length(far, finished), _length(far_dual, finished)
        z, up, down, t = (
            _moved(z, dz, alpha),
            _moved(up, d_up, beta),
            _moved(down, d_down, beta),
            _moved(t, dt, alpha),
        )
        weight = jnp.where(finished, weight, -pulls[:, 0] - pulls[:, 1] * dt)
        whole, gap = both(jnp.sum, up + down, up * (t - z) + down * (t + z))
        whole = jnp.where(gauge, whole, 1)
        gap = gap / whole
        settled = jnp.where(gauge, (gap < close * t) & (jnp.abs(1 - t) > gap), gap < close)
        done = finished | settled | ~jnp.isfinite(gap) | ~jnp.isfinite(t)
        slow = jnp.where(jnp.minimum(alpha, beta) > 0.3, PACE, 0.7)
        mu = jnp.where(done, mu, slow * gap / (2 * count) * whole)
        return _Path(z, t, up, down, mu, gap, weight, done, k + 1)

    def going(path: _Path) -> jax.Array:
        return (path.step < STEPS) & ~jnp.all(path.done)

    # begun inside: every unknown keeps a distance from its bound
    t = jnp.where(gauge, 1.25 * jnp.max(jnp.abs(z), 0) + 1e-3, 1)[None]
    mu = jnp.where(gauge, t / count, START)
    up, down = mu / (t - z), mu / (t + z)
    size = jnp.where(gauge, jnp.sum(jnp.where(there, up + down, 0), 0), 1)[None]
    gap = jnp.ones_like(t)
    weight = jnp.zeros((len(bounds), t.shape[1]), t.dtype)
    path = _Path(z, t, up / size, down / size, mu, gap, weight, jnp.zeros(t.shape, bool), 0)
    path = jax.lax.while_loop(going, step, path)
    weight = jnp.where(jnp.isfinite(path.weight), path.weight, 0)
    off = jnp.max(jnp.abs(jnp.where(there, path.z - _unknowns(window, path.z), 0)), 0)
    t = jnp.max(jnp.abs(jnp.where(there, path.z, 0)), 0)
    return weight, t, path.z, ~(off <= LOST * t)


def _length(far: jax.Array, finished: jax.Array) -> jax.Array:
    """Return the length of a step that stays within bounds; 0 of what is finished."""
    return jnp.where(finished, 0, jnp.minimum(1, 0.95 / jnp.where(far > 0, far, 1)))


def _moved(x: jax.Array, dx: jax.Array, by: jax.Array) -> jax.Array:
    """Return x moved on; where it does not move it stays, whatever NaN dx is."""
    return x + jnp.where(by > 0, by * dx, 0)
