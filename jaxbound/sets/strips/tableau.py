"""The exchange search of `separation` where few relations stand against many inner rows: long disturbances,
few looks.

The same exchanges, of the same rows. But in place of the inverse of the k rows of a reference S, k x k
numbers, it carries the tableau M, c x k: every one of the c rows outside S as a combination of those of S. It
begins as R. What an exchange needs is read from it: T_e and T_w are rows, the errors outside S are values - M
on_S. If a row leaves at slot q and one joins from place j, with coefficients x,

    M <- M - (M_q + e_j) (x - e_q) / x_q

where place j becomes the row that has left. 30 relations of 177 rows: 4 400 numbers change in place of 21
600, and one product with them in place of three.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.unrolled import foremost, summed
from jaxbound.sets.strips.exchange_step import WRITTEN_OUT, closeness, long_step, picked, reference, scaled


def tableau_search(
    R: jax.Array | np.ndarray,
    z: jax.Array,
    radius: jax.Array,
    present: jax.Array | np.ndarray,
    one: jax.Array,
    steps: int,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (h (c, N), d (k, N), done (N,)): see `separation.exchange_search`, whose arguments these are."""
    R = jnp.asarray(R)
    (c, k), (_, N), dtype = R.shape, z.shape, z.dtype
    r_inner = radius[c:]
    nothing = jnp.zeros_like(r_inner)
    ones = jnp.where(
        r_inner == r_inner, one[None], 0
    )  # not a broadcast: by one, a division becomes a product
    slots, places = (jnp.arange(count, dtype=jnp.int32)[:, None] for count in (k, c))
    close = closeness(dtype)
    through = lambda M, x: summed(lambda column, a: column * a[None], M, x, axes=(1, 0), few=WRITTEN_OUT)

    def exchange(carry):
        M, row, column, basis, out, e, done, count = carry
        M = (
            M - column[:, None] * row[None]
        )  # of the exchange before: M is then read from memory by all its uses
        values, _, weight, _ = out
        value_e, radius_e, _, id_e = (x / one for x in picked(out, e))
        T = _row(M, e) / ones
        now = reference(basis, T, value_e, radius_e, one, ones)
        error = values - through(M, now.on_S)
        worst, w = foremost(jnp.abs(error) * weight / one[None])
        done = done | (worst <= now.t + close * (1 + now.t))
        value_w, radius_w, _, id_w = (x / one for x in picked(out, w))
        T_w, sign_w = _row(M, w) / ones, jnp.sign(picked(error, w)) / one
        q, swap, by_w, row, _, _ = long_step(
            now, (T, radius_e), (T_w, radius_w, sign_w, worst), basis[2], done, one, ones
        )
        joins = places == jnp.where(by_w, w, e)[None]
        column = (picked(M, q) + joins) / one[None]
        new = jnp.where(
            by_w[None],
            jnp.stack([sign_w, value_w, radius_w, id_w]),
            jnp.stack([jnp.sign(now.own), value_e, radius_e, id_e]),
        )
        _, value_q, radius_q, id_q = (x / one for x in picked(basis, q))
        left = jnp.stack([value_q, radius_q, 1 / radius_q, id_q])
        basis = jnp.where(
            ((slots == q[None]) & swap[None])[None], new[:, None], jnp.stack([now.signs, *basis[1:]])
        )
        out = jnp.where((joins & swap[None])[None], left[:, None], out)
        return M, row, column, basis, out, jnp.where(done | (swap & by_w), e, w), done, count + 1

    alone = jnp.abs(z) / (radius[:c] + through(jnp.abs(R)[:, :, None], r_inner))
    _, e = foremost(jnp.where(present[:c], alone, -1) / one[None])
    numbered = lambda first, count: jnp.broadcast_to(
        (first + jnp.arange(count, dtype=dtype))[:, None], (count, N)
    )
    basis = jnp.stack([jnp.ones_like(r_inner), nothing, r_inner, numbered(c, k)])
    out = (
        jnp.stack([z, radius[:c], jnp.where(present[:c], 1 / radius[:c], 0), numbered(0, c)])
        / one[None, None]
    )
    M = jnp.broadcast_to(R[:, :, None], (c, k, N))
    start = M, nothing, jnp.zeros_like(z), basis, out, e, jnp.zeros(N, bool), 0
    going = lambda carry: (carry[-1] < steps) & ~jnp.all(carry[-2])
    M, row, column, basis, out, e, done, _ = jax.lax.while_loop(going, exchange, start)
    M = M - column[:, None] * row[None]
    T, (value_e, radius_e, _, id_e) = _row(M, e), picked(out, e)
    on_S = reference(basis, T, value_e, radius_e, one, ones).on_S
    at = lambda wanted, numbers, x: summed(
        lambda number, a: jnp.where(number[None] == wanted, a[None], 0), numbers, x
    )
    d = at(c + slots, basis[3], on_S) + at(c + slots, out[3], through(M, on_S))
    h = jnp.where(present[:c], jnp.where(id_e[None] == places, 1, 0) - at(places, basis[3], T), 0) / one[None]
    return scaled(h), d, done


def _row(M: jax.Array, number: jax.Array) -> jax.Array:
    """Return for each window one row (k, N) of M (c, k, N)."""
    return jnp.take_along_axis(M, number.astype(jnp.uint32)[None, None], 0, mode="promise_in_bounds")[0]
