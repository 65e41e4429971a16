"""The linear program of one window whose first state lies in a set, solved in plain floats: multipliers of its samples, no claim.

A window has states x_0 = c + S xi, x_(j+1) = A x_j + W w_j + .., and samples |e_j - C x_j| <= s_j of L steps, e_j and x_j less what the
middle of everything predicts. All unknowns have the size 1:

    z = (xi, w, v),    v_j = (e_j - C x_j) / s_j,    every |z_i| <= 1.

Two questions, both by a primal-dual interior point method (Mizuno, Todd, Ye 1993; Wright 1997, chapter 5, its path at a fixed pace):

    gauge      t = min max_i |z_i|: below 1 the window is explained, above it is not
    support    max d x_J of one state, over all that explains the window

Its Newton steps are least-squares problems with weights, so one is a Kalman filter forward and its adjoint backward (Bryson, Frazier
1963): work and memory grow with the length of the window alone, and sets of windows lie side by side on the last axis.

What comes out are multipliers, one a sample. Any numbers will do for the proof (`window_proof`); these are nearly the best ones.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

__all__ = ["Window", "searched"]

PACE = 0.15
"""Share of the complementarity that is left after a step."""
STEPS = 40
START = 0.3
"""Complementarity at which a support begins: directions are such that it is about 1."""


class Window(NamedTuple):
    """N windows of L steps. Fields: A (n, n), C (p, n), W (n, g); S (n, n, N); e, s (L, p, N), s infinite where there is no sample."""

    A: Any
    C: Any
    W: Any
    S: Any
    e: Any
    s: Any


class _Point(NamedTuple):
    """Fields: xi (n, N), w (L - 1, g, N), v (L, p, N), or anything that has one entry for each of these; t (N,)."""

    xi: Any
    w: Any
    v: Any


def _dot(M, X):
    """Return M X for M (r, n), X (n, ..., N)."""
    return jnp.sum(M.reshape(*M.shape, *[1] * (X.ndim - 1)) * X[None], 1)


def _solved(window, D, rho, d, J):
    """Return (dz, pulls (L, p, k, N)): dz minimises sum_i D_i dz_i^2 / 2 - sum_i rho_i dz_i - d dx_J over the trajectories, for k rho.

    A pull is (D dv - rho) / s, what a sample does to the states, without the digits that this formula would lose.

    D: a _Point (.., N), zero for v where there is no sample; rho: (.., k, N), d (n, k, N), J (N,) the step of the state that d speaks of.
    """
    A, C, W, S, _, s = window
    L, p, _ = s.shape
    near = jnp.where(jnp.isfinite(s), s, 1)
    P = jnp.sum(S[:, None] * (S / D.xi[None])[None], 2)
    x = jnp.sum(S[:, :, None] * (rho.xi / D.xi[:, None])[None], 1)

    def forward(carry, now):
        x, P = carry
        w, rho_w, D_v, rho_v, size, j = now
        gains, faults = [], []
        for i in range(p):
            c = C[i]
            Pc = jnp.sum(P * c[None, :, None], 1)
            far = size[i] ** 2 + D_v[i] * jnp.sum(c[:, None] * Pc, 0)
            K, fault = Pc * (D_v[i] / far)[None], -size[i][None] * rho_v[i] - D_v[i][None] * jnp.sum(c[:, None, None] * x, 0)
            fault = fault / far[None]
            x, P = x + Pc[:, None] * fault[None], P - K[:, None] * Pc[None]
            gains.append(K)
            faults.append(fault)
        x = x + jnp.where((j == J)[None, None], jnp.sum(P[:, :, None] * d[None], 1), 0)  # a pull is like one more sample
        x, P = _dot(A, x), _dot(A, jnp.moveaxis(_dot(A, jnp.moveaxis(P, 0, 1)), 0, 1))
        x = x + jnp.sum(W[:, :, None, None] * (rho_w / w[:, None])[None], 1)
        P = P + jnp.sum((W[:, None] * W[None])[..., None] / w[None, None], 2)
        return (x, 0.5 * (P + jnp.swapaxes(P, 0, 1))), (jnp.stack(gains), jnp.stack(faults))

    last = lambda a: jnp.concatenate([a, jnp.ones_like(a[:1])])  # nothing comes after the last sample
    given = last(D.w), last(rho.w), D.v, rho.v, near, jnp.arange(L)
    _, (gains, faults) = jax.lax.scan(forward, (x, P), given)

    def backward(q, now):
        gains, faults, j = now
        q = _dot(A.T, q) + jnp.where((j == J)[None, None], d, 0)
        pulls = []
        for i in reversed(range(p)):
            pulls.append(faults[i] - jnp.sum(gains[i][:, None] * q, 0))
            q = q + C[i][:, None, None] * pulls[-1][None]
        return q, (q, jnp.stack(pulls[::-1]))

    q, (after, pulls) = jax.lax.scan(backward, jnp.zeros_like(x), (gains, faults, jnp.arange(L)), reverse=True)
    xi = (rho.xi + jnp.sum(S[:, :, None] * q[:, None], 0)) / D.xi[:, None]
    w = (rho.w + jnp.sum(W[None, :, :, None, None] * after[1:, :, None], 1)) / D.w[:, :, None]
    return _moved(window, xi, w), pulls


def _moved(window, xi, w):
    """Return the _Point of xi (n, k, N), w (L - 1, g, k, N), v being how samples change with them."""
    A, C, W, S, _, s = window

    def step(x, w):
        return _dot(A, x) + jnp.sum(W[:, :, None, None] * w[None], 1), x

    x = jnp.sum(S[:, :, None] * xi[None], 1)
    end, before = jax.lax.scan(step, x, w)
    x = jnp.concatenate([before, end[None]])
    return _Point(xi, w, -jnp.sum(C[None, :, :, None, None] * x[:, None], 2) / s[:, :, None])


@jax.jit
def searched(window: Window, d: jax.Array, J: jax.Array, gauge: jax.Array, xi: jax.Array, w: jax.Array, close: jax.Array) -> tuple:
    """Return (multipliers (L, p, N), t (N,), xi, w) of the windows, t the largest |z_i|.

    Args:
        d (n, N), J (N,): the direction and step of a support; nothing to a gauge. gauge (N,): which question.
        xi (n, N), w (L - 1, g, N): where to begin, anywhere for a gauge, with all |z_i| < 1 for a support.
        close: gap at which a window is done, relative.
    """
    seen = jnp.isfinite(window.s)
    there = _Point(jnp.ones_like(xi, bool), jnp.ones_like(w, bool), seen)
    each = lambda x: jax.tree.map(lambda ok: x.reshape(*[1] * (ok.ndim - 1), -1), there)
    mapped = lambda f, *trees: jax.tree.map(lambda ok, *x: jnp.where(ok, f(*x), 0), there, *trees)
    total = lambda tree: sum(jnp.sum(x, tuple(range(x.ndim - 1))) for x in jax.tree.leaves(tree))
    weighed = lambda e, x: total(jax.tree.map(lambda e, x: e * x, e, x))
    top = lambda tree: jnp.max(jnp.stack([jnp.max(x.reshape(-1, x.shape[-1]), 0) for x in jax.tree.leaves(tree) if x.size]), 0)
    largest = lambda tree: top(jax.tree.map(jnp.abs, tree))
    count = total(jax.tree.map(lambda ok: ok.astype(xi.dtype), there))
    begun = _moved(window, xi[..., None, :], w[..., None, :])
    z = _Point(xi, w, jnp.where(seen, window.e / window.s + begun.v[:, :, 0], 0))
    t = jnp.where(gauge, 1.25 * largest(z) + 1e-3, 1)
    mu = jnp.where(gauge, t / count, START)
    up, down = (mapped(lambda mu, t, z: mu / (t + sign * z), each(mu), each(t), z) for sign in (-1, 1))  # noqa: B023
    size = jnp.where(gauge, total(up) + total(down), 1)
    up, down = (jax.tree.map(lambda x, size: x / size, tree, each(size)) for tree in (up, down))
    pull = jnp.stack([jnp.where(gauge[None], 0, d), jnp.zeros_like(d)], 1)

    def step(state):
        z, t, up, down, mu, gap, weight, done, k = state
        room = lambda t, z: jax.tree.map(lambda ok, t, z: jnp.where(ok, t - z, 1), there, each(t), z)
        a, b = room(t, z), room(t, jax.tree.map(jnp.negative, z))
        D, E = (mapped(lambda u, a, v, b: u / a + sign * v / b, up, a, down, b) for sign in (1, -1))  # noqa: B023
        rho = mapped(lambda mu, a, b: mu / b - mu / a, each(mu), a, b)
        found, pulls = _solved(window, D, jax.tree.map(lambda x, y: jnp.stack([x, y], -2), rho, E), pull, J)
        p, q = (mapped(lambda x: x[..., i, :], found) for i in (0, 1))  # noqa: B023
        barrier = total(mapped(lambda mu, a, b: mu / a + mu / b, each(mu), a, b))
        dt = jnp.where(gauge, (barrier - 1 + weighed(E, p)) / (total(D) - weighed(E, q)), 0)
        dz = jax.tree.map(lambda p, q, dt: p + q * dt, p, q, each(dt))
        pulled = -pulls[:, :, 0] - pulls[:, :, 1] * dt[None, None]
        da, db = (jax.tree.map(lambda dt, dz: dt + sign * dz, each(dt), dz) for sign in (-1, 1))  # noqa: B023
        slope = lambda u, a, da: mapped(lambda mu, u, a, da: mu / a - u - u / a * da, each(mu), u, a, da)
        d_up, d_down = slope(up, a, da), slope(down, b, db)
        steep = lambda x, dx: top(mapped(lambda x, dx: -dx / jnp.where(x > 0, x, 1), x, dx))
        far, far_dual = jnp.maximum(steep(a, da), steep(b, db)), jnp.maximum(steep(up, d_up), steep(down, d_down))
        finished = done | ((gap < 1e-4) & (jnp.maximum(far, far_dual) > 50))  # digits are used up
        length = lambda far: jnp.where(finished, 0, jnp.minimum(1, 0.95 / jnp.where(far > 0, far, 1)))
        alpha, beta = length(far), length(far_dual)
        move = lambda x, dx, by: jax.tree.map(lambda x, dx, by: x + jnp.where(by > 0, by * dx, 0), x, dx, each(by))
        z, up, down, t = move(z, dz, alpha), move(up, d_up, beta), move(down, d_down, beta), t + jnp.where(alpha > 0, alpha * dt, 0)
        weight = jnp.where(finished[None, None], weight, pulled)
        whole = total(up) + total(down)
        gap = weighed(up, room(t, z)) + weighed(down, room(t, jax.tree.map(jnp.negative, z)))  # where there is no sample up is 0
        gap = jnp.where(gauge, gap / whole, gap)
        settled = jnp.where(gauge, (gap < close * t) & (jnp.abs(1 - t) > gap), gap < close)
        done = finished | settled | ~jnp.isfinite(gap) | ~jnp.isfinite(t)
        slow = jnp.where(jnp.minimum(alpha, beta) > 0.3, PACE, 0.7)
        mu = jnp.where(done, mu, slow * gap / (2 * count) * jnp.where(gauge, whole, 1))
        return z, t, up, down, mu, gap, weight, done, k + 1

    going = lambda state: (state[-1] < STEPS) & ~jnp.all(state[-2])
    begin = z, t, up, down, mu, jnp.ones_like(t), jnp.zeros_like(window.e), jnp.zeros(t.shape, bool), 0
    z, *_, weight, _, _ = jax.lax.while_loop(going, step, begin)
    return jnp.where(jnp.isfinite(weight), weight, 0), largest(z), z.xi, z.w
