"""The exchange search: is a window consistent, when its strips are too many to enumerate?

Rows y = E x + K u with x eliminated (`exact.frame`) say y_outer = R y_inner + K u. Each true y lies in [m - r, m + r], so with
z = m_outer - R m_inner - K u the rows are consistent iff some d has

    |d_i| <= r_i (inner rows),   |z_j - R_j d| <= r_j (outer rows)                                                  (primal)

and the factor t on all r at which they just become so is a Chebyshev problem in k unknowns, with the dual

    t = max over h of |h z| / (sum_j |h_j| r_j + sum_i |h R|_i r_i).                                                (dual)

**Search** (single exchange; Source: Stiefel 1959, the dual simplex method on references of k + 1 rows). A reference is k rows S, of which
P is the inverse, and a row e: with the other rows given, a_e = T_e a_S. It determines t and d; the row that d violates most enters. While
its multiplier grows, those of S cross zero one after the other; the row at whose crossing t is largest leaves (a long step: to stop at the
first crossing takes nearly twice as many exchanges), of several the one with the largest pivot. Plain floats, no claim.

**Proof** (`separation_verdict`). ANY h with a strict (dual) inequality proves the window inconsistent, any d that passes (primal) proves it
consistent; both are evaluated with the error bound of `rounding.search_error`. Since R and K are rationals rounded once, the
unbounded x cannot leak into either. The search hands h and d over as arrays, from one compiled function to another: within one, a compiler
may work a number out anew, and round it otherwise, for each of its uses.

Everything is written for a block of N windows, the last axis, and elementwise over it: a window's verdict does not depend on its block.
"""

from dataclasses import dataclass
from typing import TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.exact import linalg
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import largest, most, total

__all__ = ["Frame", "exchange_search", "frame_of", "separation_margin", "separation_search", "separation_verdict"]


Numbers: TypeAlias = jax.Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Frame:
    """An `exact.Frame` in floats.

    Fields: R (c, k), K (c, l) nearest to the exact ones; inner (k,), outer (c,) row numbers; used (c,) as there; real (k,): False where
    a column only fills up to a fixed width.
    """

    R: Numbers
    K: Numbers
    inner: Numbers
    outer: Numbers
    used: Numbers
    real: Numbers


def frame_of(exact_frame: linalg.Frame, dtype: DTypeLike, width: int | None = None) -> Frame:
    """Round an `exact.Frame`; fill its inner rows up to `width`."""
    c, k = len(exact_frame.outer), len(exact_frame.inner)
    width = k if width is None else width
    R = np.zeros((c, width), dtype)
    for j in range(c):
        R[j, :k] = [rounding.nearest_normal(x, dtype) for x in exact_frame.R[j]]
    K = np.array([[rounding.nearest_normal(x, dtype) for x in row] for row in exact_frame.K], dtype).reshape(c, -1)
    inner = np.array([*exact_frame.inner, *[0] * (width - k)], np.int32)
    return Frame(R, K, inner, np.array(exact_frame.outer, np.int32), np.array(exact_frame.used, bool), np.arange(width) < k)


def separation_margin(frame: Frame, mid: jax.Array, rad: jax.Array, known: jax.Array, steps: int = 1000) -> jax.Array:
    """Return 1 - t, unrounded and differentiable in mid, rad and known; NaN where no relation has its data, or an inner row has none.

    Args:
        frame: from `frame_of`. mid, rad: (rows, N), NaN in mid where absent. known: (l, N).
    """
    absent, missing = jnp.isnan(mid), jnp.isnan(known)
    z, r_outer, r_inner, present, complete = _image(frame, mid, rad, known, absent, missing)
    stop = jax.lax.stop_gradient  # the best h stays the best for a small change: envelope theorem
    h, _, _ = exchange_search(stop(frame.R), stop(z), stop(r_outer), stop(r_inner), present, jnp.ones_like(stop(z[0])), steps)
    return jnp.where(complete & present.any(0), 1 - _factor(total(h * z), _width(frame.R, h, r_outer, r_inner)), jnp.nan)


def separation_search(
    frame: Frame, mid: jax.Array, rad: jax.Array, known: jax.Array, one: jax.Array, steps: int, finer: jax.Array | float = 1.0
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h (c, N), d (k, N), done (N,)): candidates for the two proofs of `separation_verdict`, nearly optimal where done.

    Args:
        frame, mid, rad, known: as for `separation_margin`. one: N ones, traced. steps: at most so many exchanges.
        finer: factor on the share of the largest pivot below which none is taken: a small pivot spoils the inverse, but without it a
            search may go round in circles.
    """
    z, r_outer, r_inner, present, _ = _image(frame, mid, rad, known, jnp.isnan(mid), jnp.isnan(known))
    return exchange_search(frame.R, z / one[None], r_outer / one[None], r_inner / one[None], present, one, steps, finer)


def separation_verdict(
    frame: Frame,
    mid: jax.Array,
    rad: jax.Array,
    scale: jax.Array,
    known: jax.Array,
    known_scale: jax.Array,
    lift: jax.Array | float,
    one: jax.Array,
    h: jax.Array,
    d: jax.Array,
    done: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return (margin, settled): margin > 0 inside, < 0 outside (both proved), 0 where rounding or the number of steps left it open, NaN
    where no relation has its data.

    settled is False where more steps may tell, or better the size of the margin, or (if an inner row or a used known value is absent)
    another frame.

    Args:
        frame, mid, rad, known: as for `separation_margin`. scale (rows, N), known_scale (l, N): magnitudes as in `rounding.residual_error`.
        lift: at least every factor that multiplied a row after its own rounding. one: N ones, traced.
        h, d, done: from `separation_search`; any finite h and d will do, but they must be arrays, not expressions of the same function.
    """
    c, k = frame.R.shape
    absent, missing = jnp.isnan(scale), jnp.isnan(known_scale)  # NaN is absence, never overflow
    z, r_outer, r_inner, present, complete = _image(frame, mid, rad, known, absent, missing)
    z, r_outer, r_inner = z / one[None], r_outer / one[None], r_inner / one[None]  # see `exchange_search`
    real = frame.real[:, None] & ~absent[frame.inner]
    s_inner, s_outer = jnp.where(real, scale[frame.inner], 0), jnp.where(present, scale[frame.outer], 0)
    size = jnp.abs(frame.R)
    magnitude = s_outer + _product(size, s_inner)
    if len(known):
        magnitude += _product(jnp.abs(frame.K), jnp.where(missing, 0, known_scale))
    magnitude = magnitude / one[None]
    gamma, least = rounding.search_error(c, k, len(known), mid.dtype)
    floor = least * lift * (1 + jnp.max(size)) * (1 + jnp.max(jnp.abs(frame.K), initial=0))
    floor = floor * (1 + total(magnitude) + total([*s_inner, *jnp.where(missing, 0, known_scale)]))
    residual, width = jnp.abs(total(h * z)), _width(frame.R, h, r_outer, r_inner)
    outside = residual - width > gamma * total(jnp.abs(h) * magnitude) + floor
    gap = jnp.abs(z - _product(frame.R, d))
    excess = jnp.where(present, gap + gamma * magnitude + floor[None] - r_outer, -jnp.inf)
    excess = jnp.concatenate([excess, jnp.abs(d) + gamma * s_inner + floor[None] - r_inner]) / one[None]
    inside = most(excess) <= 0
    margin, eps = jnp.nan_to_num(1 - _factor(residual, width), nan=0.0), jnp.finfo(mid.dtype).eps  # NaN says absent: sums may overflow
    margin = jnp.where(outside, jnp.minimum(margin, -eps), jnp.where(inside, jnp.maximum(margin, eps), 0))
    margin = jnp.where(complete, margin, 0)
    nothing = complete & ~present.any(0)
    return jnp.where(nothing, jnp.nan, margin), nothing | (complete & done)


def _image(
    frame: Frame, mid: jax.Array, rad: jax.Array, known: jax.Array, absent: jax.Array, missing: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, Numbers, jax.Array]:
    """Return (z, r_outer, r_inner, present, complete); radii are 1 and middles 0 where there is no sample."""
    real = frame.real[:, None] & ~absent[frame.inner]
    present = frame.used[:, None] & ~absent[frame.outer]
    lacking = _product((frame.R != 0).astype(jnp.int32), (~real).astype(jnp.int32))
    if len(known):
        lacking += _product((frame.K != 0).astype(jnp.int32), missing.astype(jnp.int32))
    complete = jnp.sum(jnp.where(present, lacking, 0), 0) == 0
    m_inner, m_outer = jnp.where(real, mid[frame.inner], 0), jnp.where(present, mid[frame.outer], 0)
    z = m_outer - _product(frame.R, m_inner)
    if len(known):
        z -= _product(frame.K, jnp.where(missing, 0, known))
    return jnp.where(present, z, 0), jnp.where(present, rad[frame.outer], 1), jnp.where(real, rad[frame.inner], 1), present, complete


def _width(R: Numbers, h: jax.Array, r_outer: jax.Array, r_inner: jax.Array) -> jax.Array:
    """Return sum_j |h_j| r_j + sum_i |h R|_i r_i."""
    across = jnp.abs(_product(R.T, h))
    return total(jnp.abs(h) * r_outer) + total(across * r_inner)


def _factor(residual: jax.Array, width: jax.Array) -> jax.Array:
    """Return |residual| / width, 0 where no row takes part."""
    return jnp.abs(residual) / jnp.where(width > 0, width, 1)


def exchange_search(
    R: Numbers,
    z: jax.Array,
    r_outer: jax.Array,
    r_inner: jax.Array,
    present: Numbers,
    one: jax.Array,
    steps: int,
    finer: jax.Array | float = 1.0,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h (c, N), d (k, N), done (N,)) with max|h| = 1: nearly optimal in (dual) and (primal) where done.

    `/ one` in here is nothing but a sign to the compiler: it does not work out a quotient again for each of its uses.
    """
    c, k = R.shape
    N, dtype = z.shape[1], z.dtype
    rows = jnp.concatenate([R, jnp.eye(k, dtype=dtype)])
    value = jnp.concatenate([z, jnp.zeros_like(r_inner)])
    radius = jnp.concatenate([r_outer, r_inner])
    ones = jnp.where(r_inner == r_inner, one[None], 0)  # not a broadcast: by one, a division becomes a product
    weight = jnp.where(jnp.concatenate([present, jnp.ones_like(r_inner, bool)]), 1 / radius, 0) / one[None]
    slots = jnp.arange(k, dtype=jnp.int32)[:, None]
    close = 10 * rounding.unit(dtype) ** 0.75  # 1e-11 in float64
    alike = 64 * rounding.unit(dtype)
    dot = lambda x, y: total(x[i] * y[i] for i in range(k))

    def reference(P, signs, S_value, S_radius, T, own, radius_e):
        """Return the factor t, the multipliers on S, the signs of the errors there, and the point d where all are t times their radii."""
        t = jnp.abs(own) / (radius_e + dot(jnp.abs(T), S_radius))
        shares = jnp.abs(T) * S_radius / radius_e[None]
        signs = jnp.where(shares > close, -jnp.sign(own)[None] * jnp.sign(T), signs)  # a row whose multiplier is 0 keeps its sign
        on_S = (S_value - signs * t[None] * S_radius) / ones
        return t, shares, signs, total(P[:, s] * on_S[s][None] for s in range(k)) / ones

    def exchange(carry):
        P, row, column, ids, signs, S_value, S_radius, T, own, e, done, count = carry
        P = P - column[:, None] * row[None]  # of the exchange before: P is then read from memory by all its uses
        radius_e = _pick(radius, e) / one
        t, shares, signs, d = reference(P, signs, S_value, S_radius, T, own, radius_e)
        error = jnp.concatenate([z - _product(R, d), -d]) / one[None]
        worst, w = largest(jnp.abs(error) * weight / one[None], one)
        done = done | (worst <= t + close * (1 + t))
        enters = jnp.take(rows, w, 0, mode="clip").T / ones
        T_w = total(enters[i][None] * P[i] for i in range(k)) / ones
        sign_w = jnp.sign(_pick(error, w)) / one
        radius_w = _pick(radius, w) / one
        change = sign_w[None] * T_w * signs * S_radius / radius_w[None]
        worth = finer * close**0.5 * most(jnp.abs(change)) / one  # a smaller pivot would ruin P; such a row may as well change its sign
        rate = jnp.where(change > worth[None], change, 0) / ones
        step = shares / jnp.where(rate > 0, rate, 1) / ones  # of the multiplier of w, up to where that of a row of S is 0
        after = 1 + step + total(jnp.abs(shares[s][None] - step * change[s][None]) for s in range(k))
        slope = worst - t * total(change)
        gained = (t * (1 + total(shares)) / one)[None] + step * (slope / one)[None]
        factor = jnp.where(rate > 0, gained / after, -1) / ones  # t once that row has left: rises up to its maximum, then falls
        best = most(factor) / one
        _, q = largest(jnp.where(factor >= (best * (1 - alike))[None], jnp.abs(T_w), -1) / ones, one)
        swap = (best >= slope / (1 + total(jnp.abs(change)))) & ~done  # else e itself leaves
        T_q, T_wq = _pick(T, q) / one, _pick(T_w, q) / one
        by_w = jnp.abs(T_wq) * radius_e >= jnp.abs(T_q) * radius_w  # w and e stay, q leaves; the one with the larger pivot joins S
        joins, stays = jnp.where(by_w[None], T_w, T), jnp.where(by_w[None], T, T_w)
        pivot = jnp.where(by_w, T_wq, T_q)
        at_q = slots == q[None]
        row = (joins - at_q) * jnp.where(swap, 1 / jnp.where(pivot == 0, 1, pivot), 0)[None] / ones
        column = jnp.take_along_axis(P, q[None, None], 1, mode="clip")[:, 0] / ones
        new, kept = jnp.where(by_w, w, e), jnp.where(by_w, e, w)
        at_q &= swap[None]
        ids = jnp.where(at_q, new[None], ids)
        signs = jnp.where(at_q, jnp.where(by_w, sign_w, jnp.sign(own))[None], signs)
        S_value = jnp.where(at_q, (_pick(value, new) / one)[None], S_value) / ones
        S_radius = jnp.where(at_q, (_pick(radius, new) / one)[None], S_radius)
        e = jnp.where(done, e, jnp.where(swap, kept, w))
        T = jnp.where(done[None], T, jnp.where(swap[None], stays - jnp.where(by_w, T_q, T_wq)[None] * row, T_w)) / ones
        own = _pick(value, e) / one - dot(T, S_value)
        return P, row, column, ids, signs, S_value, S_radius, T, own, e, done, count + 1

    alone = z / (r_outer + _product(jnp.abs(R), r_inner))
    _, e = largest(jnp.where(present, jnp.abs(alone), -1) / one[None], one)
    P = jnp.broadcast_to(jnp.eye(k, dtype=dtype)[:, :, None], (k, k, N))
    nothing = jnp.zeros_like(r_inner)
    ids = jnp.broadcast_to(c + slots, (k, N))
    T = jnp.take(R, e, 0, mode="clip").T
    start = P, nothing, nothing, ids, jnp.ones_like(r_inner), nothing, r_inner, T, _pick(z, e), e, jnp.zeros(N, bool), 0
    going = lambda carry: (carry[-1] < steps) & ~jnp.all(carry[-2])
    P, row, column, ids, signs, S_value, S_radius, T, own, e, done, _ = jax.lax.while_loop(going, exchange, start)
    P = P - column[:, None] * row[None]
    _, _, _, d = reference(P, signs, S_value, S_radius, T, own, _pick(radius, e))
    outer = jnp.arange(c)[:, None]
    on_S = total(jnp.where(ids[s][None] == outer, T[s][None], 0) for s in range(k))
    h = jnp.where(present, jnp.where(e[None] == outer, 1, 0) - on_S, 0) / one[None]  # multipliers: 1 on e, -T on S
    top = most(jnp.abs(h))
    h = h / jnp.where(top > 0, top, 1)[None]
    return jnp.where(jnp.abs(h) > rounding.unit(dtype) ** 2, h, 0), d, done


def _product(R: Numbers, x: Numbers) -> jax.Array:
    """Return R x of a matrix (c, k) and rows (k, N), k > 0."""
    matrix, rows = cast(jax.Array, R), cast(jax.Array, x)
    return total(matrix[:, i, None] * rows[i][None] for i in range(len(rows)))


def _pick(rows: jax.Array, number: jax.Array) -> jax.Array:
    """Return for each window one of its rows."""
    return jnp.take_along_axis(rows, number[None], 0, mode="clip")[0]
