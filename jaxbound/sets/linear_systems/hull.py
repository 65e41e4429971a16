"""Exact hulls of interval linear systems: a bounded dual simplex in plain floats finds multipliers, one
rounded evaluation proves.

In an orthant with signs S the solutions of M x = h are the polytope (Oettli, Prager 1964)

    (mid M - rad M S) x <= hi h,    (mid M + rad M S) x >= lo h,    x in the box.

For ANY numbers w, one per row, and any e:  e x = w (M x) + (e - w M) x  lies in  w h + (e - w M) X. So the
search for the best w may be rough; the bound is enclosed. It equals the linear program's optimum at the
optimal w. A w with w M = 0 to which 0 does not fit makes the bound cross the opposite one: that is the proof
that there is no solution.

Lanes: one linear program each, all in step; the targets are axis 0 of (t, ..., N).
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import largest, stored, total
from jaxbound.sets.intervals.interval import Interval, intersection
from jaxbound.sets.linear_systems.products import product

_held = jax.lax.optimization_barrier


def orthant_hull(M: Interval, h: Interval, box: Interval) -> Interval:
    """Return the hull (n, N) of the solutions in the box: the union over all 2^n orthants, each found by
    `tighten`.
    """
    n, N = box.shape
    signs = np.array(np.meshgrid(*[[1, -1]] * n, indexing="ij")).reshape(n, -1)  # (n, 2^n)
    count = signs.shape[1]
    positive = jnp.asarray(signs > 0)[:, :, None]
    lo, hi = box.lo[:, None], box.hi[:, None]
    part = Interval(jnp.where(positive, jnp.maximum(lo, 0), lo), jnp.where(positive, hi, jnp.minimum(hi, 0)))
    flat = Interval(*(jnp.broadcast_to(v, (n, count, N)).reshape(n, -1) for v in (part.lo, part.hi)))
    empty = jnp.any(flat.lo > flat.hi, 0)
    flat = Interval(jnp.where(empty[None], jnp.inf, flat.lo), jnp.where(empty[None], -jnp.inf, flat.hi))
    each = lambda v: v if v.shape[-1] == 1 else jnp.tile(v, (1,) * (v.ndim - 1) + (count,))
    found = tighten(jax.tree.map(each, M), jax.tree.map(each, h), flat, steps=20 * n)
    gone = jnp.any(found.lo > found.hi, 0)
    lo = jnp.where(gone[None], jnp.inf, found.lo).reshape(n, count, N)
    hi = jnp.where(gone[None], -jnp.inf, found.hi).reshape(n, count, N)
    return _held(Interval(jnp.min(lo, 1), jnp.max(hi, 1)))


def tighten(M: Interval, h: Interval, box: Interval, steps: int) -> Interval:
    """Bound every unknown from above and below over {x in box : M x = h}, at once by all rows.

    Args:
        M, h, box: Intervals (r, n, N or 1), (r, N), (n, N). A box with an infinite side comes back as it is.
        steps: exchanges at most for each bound.

    Returns:
        An Interval (n, N) inside the box, empty where it was proved that there is no solution.

    Encloses: every solution in the box, whatever the search finds.
    """
    n = box.shape[0]
    w = searched_multipliers(M, h, box, steps)
    targets = jnp.asarray(np.concatenate([np.eye(n), -np.eye(n)]), box.dtype)  # (2n, n): +x_j, then -x_j
    bound = _upper_bound(M, h, box, w, targets)
    new = Interval(-bound[n:], bound[:n])
    finite = jnp.all(jnp.isfinite(box.lo) & jnp.isfinite(box.hi), 0)[None]
    out = intersection(box, new)
    return Interval(jnp.where(finite, out.lo, box.lo), jnp.where(finite, out.hi, box.hi))


def _upper_bound(M: Interval, h: Interval, X: Interval, w: jax.Array, targets: jax.Array) -> jax.Array:
    """Return an upper bound (2n, N) of e x for each target e, by its multipliers w (2n, r, N); infinity where
    there is none.
    """
    r, n = M.shape[:2]
    gamma, floor = rounding.product_error(r + n + 2, X.dtype)
    (middle, radius, size), (hm, hr, hs) = _middle_and_size(M), _middle_and_size(h)
    e, reach, rows = targets[..., None], jnp.abs(w), range(r)
    most_w = 1 + jnp.max(reach, 1)
    far = floor * most_w * (1 + jnp.max(size, (0, 1)))[None]
    D = e - total([w[:, i, None] * middle[i][None] for i in rows])
    wide = radius + gamma * size
    spread = total([reach[:, i, None] * wide[i][None] for i in rows]) + gamma * jnp.abs(e) + far[:, None]
    side = jnp.asarray([-1, 1], X.dtype)[:, None, None, None]
    d = stored(side * D[None] + spread[None])  # the ends of e - w M, see `ends`
    value = total([w[:, i] * hm[i][None] + reach[:, i] * (hr[i] + gamma * hs[i])[None] for i in rows])
    value = stored(value + floor * most_w * (1 + jnp.max(hs, 0))[None])
    products = product(Interval(-d[0], d[1]), X[None]).hi
    found = rounding.outward_sum(*[jnp.concatenate([products, value[:, None]], 1)] * 2, 1)[1]
    return jnp.where(jnp.isnan(found), jnp.inf, found)


def _middle_and_size(x: Interval) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return middle, radius and size of x; `_upper_bound` counts their rounding as that of a factor; NaN
    where x is not bounded.
    """
    middle = 0.5 * x.lo + 0.5 * x.hi
    return middle, jnp.maximum(middle - x.lo, x.hi - middle), jnp.maximum(jnp.abs(x.lo), jnp.abs(x.hi))


def searched_multipliers(M: Interval, h: Interval, X: Interval, steps: int) -> jax.Array:
    """Search multipliers (2n, r, N) of the rows, in plain floats, by exchanges from the box: no claim is
    made.

    A vertex is n rows of P x <= c, the box's sides among them; T is the inverse of these rows, lam >= 0 what
    each adds to the target. The most violated row enters, the least ratio leaves. |x_j| is replaced by its
    chord over X_j, exact where the sign is known.
    """
    r, n = M.shape[:2]
    t, N = 2 * n, X.shape[1]
    unit, dtype = float(rounding.unit(X.dtype)), X.dtype
    P, c, scale = _half_spaces(M, h, X)
    own = np.r_[:n, :n]
    side = np.where(
        np.arange(n)[:, None] == own[None], np.where(np.arange(t) < n, 1.0, -1.0)[None], 1.0
    )  # (n, t): at hi, or at lo
    full = lambda a, shape: jnp.broadcast_to(jnp.asarray(a, dtype)[..., None], (*shape, N))
    T = full(np.eye(n)[:, :, None] * side[:, None], (n, n, t))  # x_i = sum_k T[i, k] c_k
    at = jnp.where(jnp.asarray(side[..., None] > 0), X.hi[:, None], -X.lo[:, None])
    # the tilt breaks ties between the rows that carry nothing yet
    lam = full((np.arange(n)[:, None] == own[None]) + 64 * unit * (1 + np.arange(n))[:, None], (n, t))
    which = jnp.broadcast_to(
        jnp.asarray(2 * r + np.arange(n)[:, None] + np.where(side > 0, 0, n), jnp.int32)[..., None], (n, t, N)
    )
    reach = jnp.max(jnp.maximum(jnp.abs(X.lo), jnp.abs(X.hi)), 0)[None]
    slots = jnp.arange(n, dtype=jnp.int32)[:, None, None]

    def exchange(carry):
        step, T, at, lam, which, ray, active = carry
        x = stored(total([T[:, k] * at[k][None] for k in range(n)]))  # (n, t, N)
        excess = stored(total([P[:, i, None] * x[i][None] for i in range(n)]) - c[:, None])  # (count, t, N)
        worst, enter = _largest(excess)
        row = stored(jnp.moveaxis(jnp.take_along_axis(P, enter[:, None], 0, mode="clip"), 1, 0))  # (n, t, N)
        value = stored(jnp.take_along_axis(c, enter, 0, mode="clip"))
        alpha = stored(total([row[i][None] * T[i] for i in range(n)]))  # (n, t, N)
        large = alpha > np.asarray(unit**0.6, dtype)
        least, place = _largest(stored(jnp.where(large, -lam / jnp.where(large, alpha, 1), -jnp.inf)))
        least = -least
        going = active & (worst > 64 * np.asarray(unit, dtype) * (reach + jnp.abs(value)))
        stuck = going & (least == jnp.inf)  # the entering row and the basis contradict each other
        moving = going & ~stuck
        leave = (slots == place[None]) & moving[None]
        pivot = jnp.where(moving, jnp.take_along_axis(alpha, place[None], 0, mode="clip")[0], 1)
        move = jnp.where(moving, least, 0)
        # a contradiction: as much of it as carries the bound across the box
        far = stored(jnp.where(stuck, 4 * (reach + 1) / jnp.where(stuck, worst, 1), 0))
        column = stored(
            jnp.take_along_axis(T, place[None, None], 1, mode="clip")[:, 0] / stored(pivot)[None]
        )  # (n, t, N)
        held = jnp.where(moving[None], alpha, 0)
        T = jnp.where(leave[None], column[:, None], T - column[:, None] * held[None])
        lam = jnp.where(leave, move[None], jnp.maximum(lam - move[None] * held, 0)) - far[None] * jnp.where(
            stuck[None], alpha, 0
        )
        at, which = jnp.where(leave, value[None], at), jnp.where(leave, enter[None], which)
        ray = (jnp.where(stuck, enter, ray[0]), jnp.where(stuck, far, ray[1]))
        return step + 1, T, at, lam, which, ray, moving

    ray = (jnp.full((t, N), -1, jnp.int32), jnp.zeros((t, N), dtype))
    start = (0, T, at, lam, which, ray, jnp.ones((t, N), bool))
    _, _, _, lam, which, ray, _ = jax.lax.while_loop(
        lambda s: (s[0] < steps) & jnp.any(s[-1]), exchange, start
    )
    number = jnp.arange(2 * r, dtype=jnp.int32)[:, None, None]
    taken = total([jnp.where(which[k][None] == number, lam[k][None], 0) for k in range(n)])
    taken = (taken + jnp.where(ray[0][None] == number, ray[1][None], 0)) * scale[:, None]  # (2r, t, N)
    w = stored(jnp.moveaxis(taken[:r] - taken[r:], 0, 1))
    return stored(jnp.where(jnp.isfinite(w), w, 0))


def _largest(rows: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the largest of the rows and the number of the first row that has it."""
    if len(rows) > 64:  # written out, they would take minutes to compile
        return jnp.max(rows, 0), jnp.argmax(rows, 0).astype(jnp.int32)
    return largest(list(rows), jnp.where(rows[0] == rows[0], np.ones((), rows.dtype), 0))


def _half_spaces(M: Interval, h: Interval, X: Interval) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return P (2r + 2n, n, N), c (2r + 2n, N) with P x <= c for the solutions in the box X, and the factors
    (2r, N) put on its rows.
    """
    r, n = M.shape[:2]
    middle, radius, _ = _middle_and_size(M)
    wide = X.hi - X.lo
    chord = (jnp.abs(X.hi) - jnp.abs(X.lo)) / jnp.where(wide > 0, wide, 1)
    slope = jnp.where(X.lo >= 0, 1, jnp.where(X.hi <= 0, -1, chord)).astype(X.dtype)
    shift = jnp.maximum(jnp.abs(X.hi) - slope * X.hi, 0)
    extra = sum(radius[:, j] * shift[j][None] for j in range(n))
    P = jnp.concatenate([middle - radius * slope[None], -middle - radius * slope[None]])
    c = jnp.concatenate([h.hi + extra, extra - h.lo])
    scale = _held(1 / jnp.maximum(jnp.max(jnp.abs(P), 1), rounding.tiny(X.dtype)))
    eye = jnp.broadcast_to(
        jnp.asarray(np.concatenate([np.eye(n), -np.eye(n)]), X.dtype)[..., None], (2 * n, n, P.shape[-1])
    )
    c = jnp.broadcast_to(c * scale, (2 * r, X.shape[1]))
    return _held((jnp.concatenate([P * scale[:, None], eye]), jnp.concatenate([c, X.hi, -X.lo]), scale))
