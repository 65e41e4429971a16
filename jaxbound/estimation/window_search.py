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

What comes out are multipliers, one a sample. Any numbers will do for the proof (`window_proof`); these are
nearly the best ones.
"""

import math
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.arrays import Array
from jaxbound.estimation.ordered import product

__all__ = ["WindowAverages", "WindowProgram", "followed", "middle", "searched", "split"]

PACE = 0.15
"""Share of the complementarity that is left after a step."""
STEPS = 40
START = 0.3
"""Complementarity at which a support begins: directions are such that it is about 1."""
SOFT = 2.0**-20, 2.0**-10
"""Added to the weights of what averages hold, in float64 and float32: what nothing else holds would move
without end before they do.
"""


class WindowAverages(NamedTuple):
    """Averages in a window: at most 1 is m + (F_v s v + F_w w) / b.

    Fields: F_v (a, R), F_w (a, L g); m (a, N); b (a, N), infinite where nothing is said.
    """

    F_v: Array
    F_w: Array
    m: Array
    b: Array


class WindowProgram(NamedTuple):
    """N windows of L steps, whose samples are R rows in order of time.

    Fields: A (n, n); W (n, g); S (n, k, N); c (R, n), e, s (R, N): |e - c x_j| <= s of a row at step j, s
    infinite where there is no sample; step (R,): its j; last (R,): whether it is the last row of a step,
    which each has; ends (L,): the numbers of these rows. scale (L, g, N): factors of W after each step, or
    None. averages: see WindowAverages, or None.
    """

    A: Array
    W: Array
    S: Array
    c: Array
    e: Array
    s: Array
    step: Array
    last: Array
    ends: Array
    scale: Array | None = None
    averages: WindowAverages | None = None


class _Path(NamedTuple):
    """The central path at one step, N programs side by side.

    Fields: z (K, N), t (1, N): the unknowns and their bound; up, down (K, N): multipliers of z <= t and -z <=
    t; mu (1, N): complementarity; gap (1, N): relative; weight (R + a, 1, N) of samples and averages; done
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


def split(z: Array, window: WindowProgram) -> tuple[Array, Array, Array]:
    """Return xi (k, .., N), w (L, g, .., N), v (R, .., N) of all unknowns z (K, .., N); the effect of the
    last w is not looked at.
    """
    k, g, L = window.S.shape[1], window.W.shape[1], len(window.ends)
    after = k + L * g
    return z[:k], z[k:after].reshape(L, g, *z.shape[1:]), z[after : after + len(window.c)]


def middle(window: WindowProgram) -> np.ndarray:
    """Return the unknowns z (K, N) of the trajectory with xi = 0, w = 0."""
    free = np.zeros((window.S.shape[1] + len(window.ends) * window.W.shape[1], window.e.shape[-1]))
    return _unknowns(window, free, window.e)


def followed(window: WindowProgram, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (z (K, N), off (N,)): the unknowns of the trajectory that the xi and w of z make, and how far
    the v of z are from its own.

    A search moves them side by side; where samples differ by many digits, it may lose the trajectory.
    """
    z = np.where(np.isfinite(z), z, 0).astype(np.float64)
    xi, w, v = split(z, window)
    free = z[: len(xi) + len(w) * w.shape[1]]
    if window.scale is not None:
        w = w * window.scale
    x, j, errors = (window.S * xi[None]).sum(1), 0, np.empty(window.e.shape)
    for row, step in enumerate(window.step.tolist()):
        if step > j:
            x, j = product(window.A, x) + product(window.W, w[j]), step
        errors[row] = window.e[row] - (window.c[row][:, None] * x).sum(0)
    off = np.where(np.isfinite(window.s), np.abs(errors / window.s - v), 0).max(0)
    return _unknowns(window, free, errors), off


def _unknowns(window: WindowProgram, free: np.ndarray, errors: Array) -> np.ndarray:
    """Return z (K, N) of xi and w, which are free, and of the errors (R, N) that they leave."""
    known: list[Array] = [free, errors / window.s]
    if window.averages is not None:
        F_v, F_w, m, b = window.averages
        w = free[window.S.shape[1] :]
        seen = np.where(np.isfinite(window.s), errors, 0)
        known.append(m + (product(F_v, seen) + product(F_w, w)) / b)
    return np.concatenate(known)


def _dot(M: Array, X: Array) -> jax.Array:
    """Return M X for M (r, n), X (n, a, N)."""
    return jnp.sum(M[:, :, None, None] * X[None], 1)


def _times(F: Array, X: Array) -> jax.Array:
    """Return F X for F (a, n), X (n, ..), as one product of matrices."""
    return jnp.reshape(F @ X.reshape(len(X), math.prod(X.shape[1:])), (len(F), *X.shape[1:]))


def _solved(
    window: WindowProgram, D: jax.Array, rho: jax.Array, d: jax.Array, J: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (dz, pulls), as `_filtered`, with the rows of averages behind theirs: (D da - rho) / b is the
    pull of one.
    """
    if window.averages is None:
        return _filtered(window, D, rho, d, J)
    (F_v, F_w, _, b), (_, k, N) = window.averages, rho.shape
    a, first = len(b), window.S.shape[1]
    after = len(D) - a - len(window.c)
    s = jnp.where(jnp.isfinite(window.s), window.s, 0)[:, None]

    def rows(z: jax.Array) -> jax.Array:
        """Return the averages of unknowns."""
        return (_times(F_v, s * z[after:]) + _times(F_w, z[first:after])) / b[:, None]

    def back(x: jax.Array) -> jax.Array:
        """Return the pulls of averages as those of unknowns."""
        x = x / b[:, None]
        return jnp.concatenate(
            [jnp.zeros((first, *x.shape[1:]), x.dtype), _times(F_w.T, x), s * _times(F_v.T, x)]
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


_Row: TypeAlias = tuple[Array, jax.Array, Array, Array]
"""Of one row of a sample: c, its weight, radius and right-hand sides or its gains, its step, whether it is
the last of that step."""


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
    A, W, S, c, _, s, step, last, ends, scale, _ = window
    n = len(A)
    D_xi, D_w, D_v = split(D, window)
    rho_xi, rho_w, rho_v = split(rho, window)
    s = jnp.where(jnp.isfinite(s), s, 1)[:, None]

    def moved(M: jax.Array, j: jax.Array) -> jax.Array:
        """Return (covariance, mean) M (n, n + k, N) one step later."""
        pulled = jnp.sum(M[:, :n, None] * d[None], 1)  # a pull is like one more sample
        M = _dot(A, _beside(M[:, :n], M[:, n:] + jnp.where((j == J)[None, None], pulled, 0)))
        w, more = D_w[j][:, None], rho_w[j]
        if scale is not None:
            w, more = w / scale[j][:, None] ** 2, more / scale[j][:, None]
        by_A = jnp.sum(M[:, None, :n] * A[None, :, :, None], 2)
        by_W = jnp.sum(W[:, None, :, None] * W[None, :, :, None] / w[None, None, :, 0], 2)
        P = by_A + by_W
        return _beside(0.5 * (P + jnp.swapaxes(P, 0, 1)), M[:, n:] + _dot(W, more / w))

    def forward(M: jax.Array, now: _Row) -> tuple[jax.Array, jax.Array]:
        """Meet (covariance, mean) with one row of a sample, and move them behind the last of a step."""
        c, row, j, last = now
        D, s, rho = row[:1], row[1:2], row[2:]
        h = jnp.sum(c[:, None, None] * M, 0)
        far = s * s + D * jnp.sum(c[:, None] * h[:n], 0, keepdims=True)
        gain = jnp.concatenate([-D * h[:n], -s * rho - D * h[n:]]) / far
        return jax.lax.cond(last, moved, lambda M, j: M, M + h[:n, None] * gain[None], j), gain

    def backward(q: jax.Array, now: _Row) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        """Pull the adjoint q (n, k, N) through one row of a sample."""
        c, gain, j, last = now
        into = _dot(W.T, q)
        q = jnp.where(last, _dot(A.T, q) + jnp.where((j == J)[None, None], d, 0), q)
        pull = gain[n:] + jnp.sum(gain[:n, None] * q, 0)
        return q + c[:, None, None] * pull[None], (into, pull)

    # covariance and mean are moved, and met with samples, as one
    first = jnp.sum(S[:, :, None] * (_beside(jnp.swapaxes(S, 0, 1), rho_xi) / D_xi[:, None])[None], 1)
    rows = _beside(_beside(D_v[:, None], s), rho_v)
    _, gains = jax.lax.scan(forward, first, (c, rows, step, last))
    q = jnp.zeros((n, *rho_xi.shape[1:]), rho_xi.dtype)
    q, (into, pulls) = jax.lax.scan(backward, q, (c, gains, step, last), reverse=True)
    xi = rho_xi + jnp.sum(S[:, :, None] * q[:, None], 0)
    into = into[ends]
    if scale is not None:
        into = into * scale[:, :, None]
    w, v = rho_w + into, rho_v + s * pulls
    seen = jnp.where(D > 0, D, 1)[:, None]
    return jnp.concatenate([xi, w.reshape(-1, *xi.shape[1:]), v]) / seen, pulls


def _beside(x: Array, y: Array) -> jax.Array:
    """Return arrays (r, .., N) one beside the other."""
    return jnp.concatenate([x, y], 1)


def searched(
    window: WindowProgram,
    z: np.ndarray,
    close: float,
    d: np.ndarray | None = None,
    J: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (multipliers (R + a, N), t (N,), z (K, N)) of the windows, t the largest |z_i|.

    Args:
        z (K, N): where to begin, a trajectory with its v; all |z_i| < 1 for a support. close: gap at which a
            window is done, relative. d (n, N), J (N,): the direction and step of a support; None for a gauge.
    """
    (K, N), dtype = z.shape, window.e.dtype
    there = _there(window, K, N)
    if d is None or J is None:
        begin, pull, steps = _gauge_begin(window, z, there), np.zeros((len(window.A), 2, N)), np.zeros(N)
    else:
        begin, pull, steps = _support_begin(z), np.stack([d, np.zeros_like(d)], 1), J
    weight, z = _path(
        window,
        there,
        tuple(np.asarray(x, dtype) for x in begin),
        np.asarray(pull, dtype),
        steps.astype(np.int32),
        d is None,
        np.asarray(close, dtype),
    )
    weight, z = np.asarray(weight), np.asarray(z)
    return np.where(np.isfinite(weight), weight, 0), np.abs(np.where(there, z, 0)).max(0), z


def _there(window: WindowProgram, K: int, N: int) -> np.ndarray:
    """Return (K, N) bool: which unknowns there are, all but those of missing samples and averages."""
    there = np.ones((K, N), bool)
    bounds = [window.s]
    if window.averages is not None:
        bounds.append(window.averages[-1])
    there[K - sum(map(len, bounds)) :] = np.isfinite(np.concatenate(bounds))
    return there


def _gauge_begin(window: WindowProgram, z: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (z, t, up, down, mu) at which the search for a gauge begins: t above all unknowns."""
    t = 1.25 * np.abs(z).max(0) + 1e-3
    mu = t / there.sum(0)
    up, down = mu / (t - z), mu / (t + z)
    size = np.where(there, up + down, 0).sum(0)
    return z, t[None], up / size, down / size, mu[None]


def _support_begin(z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (z, t, up, down, mu) at which the search for a support begins: all bounds are 1."""
    t, mu = np.ones(z.shape[1]), np.full(z.shape[1], START)
    return z, t[None], mu / (t - z) / 1.0, mu / (t + z) / 1.0, mu[None]


@jax.jit
def _path(
    window: WindowProgram,
    there: jax.Array,
    begin: tuple[jax.Array, ...],
    pull: jax.Array,
    J: jax.Array,
    gauge: jax.Array | bool,
    close: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Follow the central path; return (multipliers, z)."""

    def sums(x: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
        """Return the sums (1, N) of both over the unknowns that there are."""
        return tuple(jnp.sum(jnp.where(there[:, None], _pair(x, y), 0), 0)[:, None])

    def largest(x: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
        """Return the largest (1, N) of both over the unknowns that there are."""
        return tuple(jnp.max(jnp.where(there[:, None], _pair(x, y), 0), 0)[:, None])

    count = jnp.sum(there, 0, dtype=pull.dtype)[None]
    rows = len(window.c)
    if window.averages is not None:
        rows += len(window.averages[-1])

    def step(path: _Path) -> _Path:
        """Take one Newton step."""
        z, t, up, down, mu, gap, weight, done, k = path
        a, b = t - z, t + z
        D, E = jnp.where(there, up / a + down / b, 0), jnp.where(there, up / a - down / b, 0)
        rho = jnp.where(there, mu / b - mu / a, 0)
        found, pulls = _solved(window, D, _pair(rho, E), pull, J)
        p, q = found[:, 0], found[:, 1]
        barrier, steep = sums(mu / a + mu / b + E * p, D - E * q)
        dt = jnp.where(gauge, (barrier - 1) / steep, 0)
        dz = p + q * dt
        da, db = dt - dz, dt + dz
        d_up, d_down = mu / a - up - up / a * da, mu / b - down - down / b * db
        far, far_dual = largest(jnp.maximum(-da / a, -db / b), jnp.maximum(-d_up / up, -d_down / down))
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
        whole, gap = sums(up + down, up * (t - z) + down * (t + z))
        whole = jnp.where(gauge, whole, 1)
        gap = gap / whole
        settled = jnp.where(gauge, (gap < close * t) & (jnp.abs(1 - t) > gap), gap < close)
        done = finished | settled | ~jnp.isfinite(gap) | ~jnp.isfinite(t)
        slow = jnp.where(jnp.minimum(alpha, beta) > 0.3, PACE, 0.7)
        mu = jnp.where(done, mu, slow * gap / (2 * count) * whole)
        return _Path(z, t, up, down, mu, gap, weight, done, k + 1)

    def going(path: _Path) -> jax.Array:
        return (path.step < STEPS) & ~jnp.all(path.done)

    z, t, up, down, mu = begin
    gap = jnp.ones_like(t)
    weight = jnp.zeros((rows, *t.shape[1:]), t.dtype)
    path = _Path(z, t, up, down, mu, gap, weight, jnp.zeros(t.shape, bool), 0)
    path = jax.lax.while_loop(going, step, path)
    return path.weight, path.z


def _pair(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return both, one beside the other on the second axis."""
    return jnp.stack([x, y], 1)


def _length(far: jax.Array, finished: jax.Array) -> jax.Array:
    """Return the length of a step that stays within bounds; 0 of what is finished."""
    return jnp.where(finished, 0, jnp.minimum(1, 0.95 / jnp.where(far > 0, far, 1)))


def _moved(x: jax.Array, dx: jax.Array, by: jax.Array) -> jax.Array:
    """Return x moved on; where it does not move it stays, whatever NaN dx is."""
    return x + jnp.where(by > 0, by * dx, 0)
