"""The exchange search: is a window consistent, when its strips are too many to enumerate?

Rows y = E x + K u with x eliminated (`exact.frames`) say y_outer = R y_inner + K u. Each true y lies in [m -
r, m + r], so with z = m_outer - R m_inner - K u the rows are consistent iff some d has

    |d_i| <= r_i (inner rows),  |z_j - R_j d| <= r_j (outer rows)                      (primal)

and the factor t on all r at which they just become so is a Chebyshev problem in k unknowns, with the dual

    t = max over h of |h z| / (sum_j |h_j| r_j + sum_i |h R|_i r_i).                       (dual)

**Search** (single exchange; Source: Stiefel 1959, the dual simplex method on references of k + 1 rows). A
reference is k rows S, of which P is the inverse, and a row e: with the other rows given, a_e = T_e a_S. It
determines t and d; the row that d violates most enters. While its multiplier grows, those of S cross zero one
after the other; the row at whose crossing t is largest leaves (a long step: to stop at the first crossing
takes nearly twice as many exchanges), of several the one with the largest pivot. Plain floats, no claim.

**Proof** (`separation_verdict`). ANY h with a strict (dual) inequality proves the window inconsistent, any d
that passes (primal) proves it consistent; both are evaluated with the error bound of `rounding.search_error`.
Since R and K are rationals rounded once, the unbounded x cannot leak into either. The search hands h and d
over as arrays, from one compiled function to another: within one, a compiler may work a number out anew, and
round it otherwise, for each of its uses.

Everything is written for a block of N windows, the last axis, and elementwise over it: a window's verdict
does not depend on its block.
"""

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.exact.frames import ExactFrame
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import foremost, product, stored, summed
from jaxbound.sets.strips.exchange_step import WRITTEN_OUT, closeness, long_step, picked, reference, scaled
from jaxbound.sets.strips.tableau import tableau_search

Numbers: TypeAlias = jax.Array | np.ndarray
PATIENCE = 1000
"""Exchanges after which a search for a margin ends, found or not."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Frame:
    """An `ExactFrame` in floats.

    Fields: R (c, k), K (c, l) nearest to the exact ones; inner (k,), outer (c,) row numbers.
    """

    R: Numbers
    K: Numbers
    inner: Numbers
    outer: Numbers


def frame_of(exact_frame: ExactFrame, dtype: DTypeLike) -> Frame:
    """Round an `ExactFrame`."""
    c, k = len(exact_frame.outer), len(exact_frame.inner)
    R, K = (rounding.nearest_normals(rows, dtype).reshape(c, -1) for rows in (exact_frame.R, exact_frame.K))
    return Frame(
        R.reshape(c, k), K, np.array(exact_frame.inner, np.int32), np.array(exact_frame.outer, np.int32)
    )


def separation_margin(frame: Frame, mid: jax.Array, rad: jax.Array, known: jax.Array) -> jax.Array:
    """Return 1 - t, unrounded and differentiable in mid, rad and known; NaN where no relation has its data,
    or an inner row has none.

    Args:
        frame: from `frame_of`. mid, rad: (rows, N), NaN in mid where absent. known: (l, N).
    """
    # the best combination stays the best for a small change: envelope theorem
    best = _best(*jax.lax.stop_gradient((frame, mid, rad, known)))
    used = lambda weight, x: jnp.sum(weight * jnp.where(weight == 0, 0, x), 0)
    residual, width = used(best, jnp.concatenate([mid, known])), used(jnp.abs(best[: len(rad)]), rad)
    return jnp.where(width > 0, 1 - _factor(residual, width), jnp.nan)


def _best(frame: Frame, mid: jax.Array, rad: jax.Array, known: jax.Array) -> jax.Array:
    """Return the combinations of rows and known values (rows + l, N) that speak most against windows, 0 where
    there is none.
    """
    c, k = frame.R.shape
    (own, radius), present, complete = _ordered(
        frame, jnp.stack([mid, rad]), jnp.isnan(mid), jnp.isnan(known)
    )
    z = own[:c] - _times(_matrix(frame), jnp.concatenate([own[c:], jnp.where(jnp.isnan(known), 0, known)]))
    z, radius = jnp.where(present[:c], z, 0), jnp.where(present, radius, 1)
    h, _, _ = exchange_search(frame.R, z, radius, present, jnp.ones_like(mid[0]), PATIENCE)
    through = -_times(jnp.swapaxes(_matrix(frame), 0, 1), h)
    order = jnp.concatenate([frame.outer, frame.inner])
    there = (order[None] == jnp.arange(len(mid), dtype=order.dtype)[:, None]).astype(h.dtype)
    best = jnp.concatenate([_times(there, jnp.concatenate([h, through[:k]])), through[k:]])
    return jnp.where(complete & present[:c].any(0), best, 0)


def _times(A: Numbers, x: jax.Array) -> jax.Array:
    """Return A x where nothing is proved: one kernel, where sums in order are a loop."""
    return jnp.matmul(A, x, precision="highest")


class Image(NamedTuple):
    """The arrays that a search and its proofs need of N windows: arrays, the windows on the last axis.

    z (c, N); radius, magnitude, present (c + k, N) of the outer rows, then the inner ones: without a sample
    radii are 1, all else 0;
    magnitude: what rounding errors are relative to. floor (N,): more than what underflows cost. complete
    (N,): all samples on which the frame is built are there.
    """

    z: jax.Array
    radius: jax.Array
    magnitude: jax.Array
    present: jax.Array
    floor: jax.Array
    complete: jax.Array


def separation_image(
    frame: Frame,
    mid: jax.Array,
    rad: jax.Array,
    scale: jax.Array,
    known: jax.Array,
    known_scale: jax.Array,
    lift: jax.Array | float,
    one: jax.Array,
) -> Image:
    """Return the Image of N windows.

    Args:
        frame, mid, rad, known: as for `separation_margin`. scale (rows, N), known_scale (l, N): magnitudes as
            in `rounding.residual_error`.
        lift: at least every factor that multiplied a row after its own rounding. one: N ones, traced, see
            `exchange_search`.
    """
    c, k = frame.R.shape
    missing = jnp.isnan(known_scale)  # NaN is absence, never overflow
    (mid, rad, scale), present, complete = _ordered(
        frame, jnp.stack([mid, rad, scale]), jnp.isnan(scale), missing
    )
    inner = jnp.concatenate(
        [jnp.stack([mid[c:], scale[c:]]), jnp.where(missing[None], 0, jnp.stack([known, known_scale]))], 1
    )
    matrix = _matrix(frame)
    inner = inner / one[None, None]
    both = summed(
        lambda columns, rows: columns[..., None] * rows[:, None],
        jnp.stack([matrix, jnp.abs(matrix)]),
        inner,
        axes=(2, 1),
        few=WRITTEN_OUT,
    )
    both = stored(both)
    z = jnp.where(present[:c], mid[:c] - both[0], 0) / one[None]
    magnitude = jnp.concatenate([scale[:c] + both[1], scale[c:]]) / one[None]
    _, least = rounding.search_error(c, k, len(known), mid.dtype)
    floor = least * lift * (1 + jnp.max(jnp.abs(frame.R))) * (1 + jnp.max(jnp.abs(frame.K), initial=0))
    floor = floor * (1 + _total(magnitude[:c]) + _total(inner[1]))
    return Image(z, jnp.where(present, rad, 1) / one[None], magnitude, present, floor, complete)


def separation_verdict(
    frame: Frame, image: Image, one: jax.Array, h: jax.Array, d: jax.Array, done: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (margin, settled): margin > 0 inside, < 0 outside (both proved), 0 where rounding or the number
    of steps left it open, NaN where no relation has its data.

    settled is False where more steps may tell, or better the size of the margin, or (if an inner row or a
    used known value is absent) another frame.

    Args:
        frame: from `frame_of`. image: from `separation_image`. one: N ones, traced. h, d, done: from
            `exchange_search`; any finite h and d will do. All of them must be arrays, not expressions of
            the same function.
    """
    z, radius, magnitude, present, floor, complete = image
    c, k = frame.R.shape
    gamma, _ = rounding.search_error(c, k, frame.K.shape[1], z.dtype)
    residual = jnp.abs(_dot(h, z)) / one
    through = summed(lambda row, x: row[:, None] * x[None], frame.R, h)
    width = _dot(jnp.abs(jnp.concatenate([h, through])), radius) / one
    outside = residual - width > gamma * _dot(jnp.abs(h), magnitude[:c]) + floor
    outside &= residual < jnp.inf  # a sum that overflows says nothing
    gap = jnp.concatenate([z - product(frame.R, d), d])
    within = (
        jnp.abs(gap) + gamma * magnitude + floor[None] - radius <= 0
    )  # false for NaN, which a largest may leave out
    inner = jnp.arange(len(radius))[:, None] >= c
    inside = jnp.all(within | ~(present | inner), 0)
    margin, eps = (
        jnp.nan_to_num(1 - _factor(residual, width), nan=0.0),
        jnp.finfo(z.dtype).eps,
    )  # NaN says absent: sums may overflow
    margin = jnp.where(outside, jnp.minimum(margin, -eps), jnp.where(inside, jnp.maximum(margin, eps), 0))
    margin = jnp.where(complete, margin, 0)
    nothing = complete & ~present[:c].any(0)
    return jnp.where(nothing, jnp.nan, margin), nothing | (complete & done)


def _ordered(
    frame: Frame, rows: jax.Array, absent: jax.Array, missing: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (rows (.., c + k, N), 0 without a sample, outer ones first; present, which have one; complete
    (N,)).
    """
    c = len(frame.outer)
    order = jnp.concatenate([frame.outer, frame.inner]).astype(jnp.uint32)
    take = lambda x, axis: jnp.take(x, order, axis, mode="clip")
    present = ~take(absent, 0)
    gone = jnp.concatenate([~present[c:], missing]).astype(jnp.float32)
    lacking = (_matrix(frame) != 0).astype(
        jnp.float32
    ) @ gone  # a count of at most c + k + l: exact, in whatever order
    complete = ~jnp.any(present[:c] & (lacking > 0), 0)
    return jnp.where(present[None], take(rows, 1), 0), present, complete


def _matrix(frame: Frame) -> jax.Array:
    """Return the coefficients (c, k + l) on inner rows and known values."""
    return jnp.concatenate([frame.R, frame.K], 1)


def _total(rows: jax.Array) -> jax.Array:
    return summed(lambda x: x, rows, few=2 * WRITTEN_OUT)


def _dot(x: jax.Array, y: jax.Array) -> jax.Array:
    return summed(lambda a, b: a * b, x, y)


def _factor(residual: jax.Array, width: jax.Array) -> jax.Array:
    """Return |residual| / width, 0 where no row takes part."""
    return jnp.abs(residual) / jnp.where(width > 0, width, 1)


def exchange_search(
    R: Numbers,
    z: jax.Array,
    radius: jax.Array,
    present: Numbers,
    one: jax.Array,
    steps: int,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h (c, N), d (k, N), done (N,)) with max|h| = 1: nearly optimal in (dual) and (primal) where
    done.

    z, radius, present: as of an `Image`. one: N ones, traced; `/ one` in here is nothing but a sign to the
    compiler: it does not work out a quotient again for each of its uses. steps: at most so many exchanges.
    Where inner rows are the more, a tableau of the others takes the place of the inverse: `tableau`.
    """
    c, k = R.shape
    if k > c:  # up to 1.7 times as fast as the inverse, which then has more numbers than the tableau
        return tableau_search(R, z, radius, present, one, steps)
    N, dtype = z.shape[1], z.dtype
    rows = jnp.concatenate([R, jnp.eye(k, dtype=dtype)])
    r_inner = radius[c:]
    nothing = jnp.zeros_like(r_inner)
    table = jnp.stack([jnp.concatenate([z, nothing]), radius]) / one[None, None]
    ones = jnp.where(
        r_inner == r_inner, one[None], 0
    )  # not a broadcast: by one, a division becomes a product
    counts = present | (
        jnp.arange(c + k)[:, None] >= c
    )  # an inner row without a sample has the window given up elsewhere
    weight = jnp.where(counts, 1 / radius, 0) / one[None]
    slots = jnp.arange(k, dtype=jnp.int32)[:, None]
    close = closeness(dtype)
    through = lambda P, x: summed(lambda column, a: column * a[None], P, x, axes=(1, 0), few=WRITTEN_OUT)

    def exchange(carry):
        P, row, column, basis, T, leader, done, count = carry
        P = (
            P - column[:, None] * row[None]
        )  # of the exchange before: P is then read from memory by all its uses
        _, value_e, radius_e, e = leader
        now = reference(basis, T, value_e, radius_e, one, ones)
        d = through(P, now.on_S) / ones
        error = jnp.concatenate([z - product(R, d, WRITTEN_OUT), d])
        worst, w = foremost(jnp.abs(error) * weight / one[None])
        done = done | (worst <= now.t + close * (1 + now.t))
        enters = jnp.take(rows, w, 0, mode="clip").T / ones
        T_w = summed(lambda a, row: a[None] * row, enters, P, few=WRITTEN_OUT) / ones
        value_w, radius_w = (picked(x, w) / one for x in table)
        sign_w = jnp.sign(value_w - summed(lambda a, b: a * b, enters, d, few=WRITTEN_OUT)) / one
        q, swap, by_w, row, stays, rest = long_step(
            now, (T, radius_e), (T_w, radius_w, sign_w, worst), basis[2], done, one, ones
        )
        at_q = slots == q[None]
        column = picked(P, q) / ones
        entering = jnp.stack([sign_w, value_w, radius_w, w.astype(dtype)])
        leading = jnp.stack([jnp.sign(now.own), value_e, radius_e, e])
        new = jnp.where(by_w[None], entering, leading)
        basis = jnp.stack([now.signs, *basis[1:]])
        basis = jnp.where((at_q & swap[None])[None], new[:, None], basis)
        kept = jnp.where((swap & by_w)[None], leading, entering)
        leader = jnp.where(done[None], leading, kept)
        T = jnp.where(done[None], T, jnp.where(swap[None], stays - rest[None] * row, T_w)) / ones
        return P, row, column, basis, T, leader, done, count + 1

    alone = z / (radius[:c] + product(jnp.abs(R), r_inner))
    _, e = foremost(jnp.where(present[:c], jnp.abs(alone), -1) / one[None])
    P = jnp.broadcast_to(jnp.eye(k, dtype=dtype)[:, :, None], (k, k, N))
    basis = jnp.stack(
        [jnp.ones_like(r_inner), nothing, r_inner, jnp.broadcast_to((c + slots).astype(dtype), (k, N))]
    )
    leader = jnp.stack([jnp.zeros_like(one), *picked(table, e), e.astype(dtype)])
    start = P, nothing, nothing, basis, jnp.take(R, e, 0, mode="clip").T, leader, jnp.zeros(N, bool), 0
    going = lambda carry: (carry[-1] < steps) & ~jnp.all(carry[-2])
    P, row, column, basis, T, leader, done, _ = jax.lax.while_loop(going, exchange, start)
    P, e = P - column[:, None] * row[None], leader[3]
    d = through(P, reference(basis, T, leader[1], leader[2], one, ones).on_S)
    outer = jnp.arange(c)[:, None]
    on_S = summed(lambda number, a: jnp.where(number[None] == outer, a[None], 0), basis[3], T)
    h = (
        jnp.where(present[:c], jnp.where(e[None] == outer, 1, 0) - on_S, 0) / one[None]
    )  # multipliers: 1 on e, -T on S
    return scaled(h), d, done
