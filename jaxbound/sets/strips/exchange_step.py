"""One exchange of the search of `separation`: the error of a reference, and which row leaves it.

A reference is k rows S with values v and radii r, and a row e whose coefficients are T on those of S. It
determines the factor t and the signs of all errors. The row w, on S by T_w, is violated most and enters.
Everything is written for N windows, the last axis.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import foremost, highest, summed

WRITTEN_OUT = 24
"""Rows up to which what every exchange adds up, and what blocks of few windows do, is written out: loops take
a sixth longer there, and as long to compile."""


def closeness(dtype: DTypeLike) -> float:
    """Return how much the largest error may exceed t where a search is done: 1e-11 in float64."""
    return float(10 * rounding.unit(dtype) ** 0.75)


class Reference(NamedTuple):
    """The numbers that a reference determines: own (N,), the error of e; t (N,); shares (k, N), the
    multipliers on S; signs of the errors there; on_S (k, N), what the rows of S are where all errors are t
    times radii.
    """

    own: jax.Array
    t: jax.Array
    shares: jax.Array
    signs: jax.Array
    on_S: jax.Array


def reference(
    basis: jax.Array, T: jax.Array, value: jax.Array, radius: jax.Array, one: jax.Array, ones: jax.Array
) -> Reference:
    """Return the Reference of S, basis (4, k, N): signs, values, radii, numbers, and of e: T (k, N), value,
    radius (N,).

    one (N,), ones (k, N): traced ones; `/ one` is a sign to the compiler not to work out a quotient again for
    each of its uses.
    """
    signs, S_value, S_radius, _ = basis
    beyond = summed(lambda a, b: a * b, T, S_value, few=WRITTEN_OUT) / one
    reach = summed(lambda a, row: jnp.abs(a) * row, T, S_radius, few=WRITTEN_OUT) / one
    own, t = value - beyond, jnp.abs(value - beyond) / (radius + reach)
    shares = jnp.abs(T) * S_radius / radius[None]
    signs = jnp.where(
        shares > closeness(T.dtype), -jnp.sign(own)[None] * jnp.sign(T), signs
    )  # multiplier 0: a row keeps its sign
    return Reference(own, t, shares, signs, (S_value - signs * t[None] * S_radius) / ones)


def long_step(
    now: Reference,
    leader: tuple[jax.Array, ...],
    entering: tuple[jax.Array, ...],
    S_radius: jax.Array,
    done: jax.Array,
    one: jax.Array,
    ones: jax.Array,
) -> tuple[jax.Array, ...]:
    """Return (q, swap, by_w, row, stays, rest): the slot of S that is left, whether (else e itself leaves),
    whether w joins S (else e does, and w stays), and what changes: coefficients x on S become x - x_q row;
    stays (k, N) are those of what stays, rest (N,) its x_q.

    leader: (T, radius) of e. entering: (T, radius, sign of its error, the error over its radius) of w.
    """
    (T, radius_e), (T_w, radius_w, sign_w, worst) = leader, entering
    _, t, shares, signs, _ = now
    dtype = T.dtype
    added = lambda term, *rows: summed(term, *rows, few=WRITTEN_OUT)
    change = sign_w[None] * T_w * signs * S_radius / radius_w[None]
    worth = (
        closeness(dtype) ** 0.5 * highest(jnp.abs(change)) / one
    )  # a smaller pivot would ruin all; it may as well change sign
    rate = jnp.where(change > worth[None], change, 0) / ones
    step = (
        shares / jnp.where(rate > 0, rate, 1) / ones
    )  # of the multiplier of w, up to where that of a row of S is 0
    after = 1 + step + added(lambda share, way: jnp.abs(share[None] - step * way[None]), shares, change)
    held, changed, moved = (
        added(size, x) / one for size, x in ((jnp.asarray, shares), (jnp.asarray, change), (jnp.abs, change))
    )
    slope = (worst - t * changed) / one
    gained = (t * (1 + held))[None] + step * slope[None]
    factor = (
        jnp.where(rate > 0, gained / after, -1) / ones
    )  # t once that row has left: rises up to its maximum, then falls
    best = highest(factor) / one
    _, q = foremost(
        jnp.where(factor >= (best * (1 - 64 * rounding.unit(dtype)))[None], jnp.abs(T_w), -1) / ones
    )
    swap = (best >= slope / (1 + moved)) & ~done
    T_q, T_wq = (picked(x, q) / one for x in (T, T_w))
    by_w = (
        jnp.abs(T_wq) * radius_e >= jnp.abs(T_q) * radius_w
    )  # w and e stay, q leaves; the one with the larger pivot joins S
    joins, stays = jnp.where(by_w[None], T_w, T), jnp.where(by_w[None], T, T_w)
    pivot, rest = jnp.where(by_w, T_wq, T_q), jnp.where(by_w, T_q, T_wq)
    at_q = jnp.arange(len(T), dtype=jnp.int32)[:, None] == q[None]
    row = (joins - at_q) * jnp.where(swap, 1 / jnp.where(pivot == 0, 1, pivot), 0)[None] / ones
    return q, swap, by_w, row, stays, rest


def scaled(h: jax.Array) -> jax.Array:
    """Return multipliers (c, N) scaled to a largest of 1, without those that are rounding."""
    top = highest(jnp.abs(h))
    h = h / jnp.where(top > 0, top, 1)[None]
    return jnp.where(jnp.abs(h) > rounding.unit(h.dtype) ** 2, h, 0)


def picked(rows: jax.Array, number: jax.Array) -> jax.Array:
    """Return for each window one of its rows (..., rows, N)."""
    places = jnp.expand_dims(number.astype(jnp.uint32), range(rows.ndim - 1))
    return jnp.take_along_axis(rows, places, -2, mode="promise_in_bounds")[..., 0, :]
