"""One step of an observer that carries constrained zonotopes: all recordings side by side on the last axis,
one loop over time.

A set is {x = c + G xi + diag(r) eta : 0 in -b + A xi + diag(s) eta}, |xi|, |eta| <= 1. Its rows stand one
above the other, h = [c; -b], H = [G; A] with q columns, r = [r; s], n + k of them; r holds what rounding
adds. Everything below is done to rows.

**A sample** |m_i - C_i x - D_i v| <= s_i appends a row and a column, and loses nothing. The rows are handed
out: whoever proves that no xi has all rows below the first n at 0 refutes the samples.
**Constraints** beyond k are eliminated, each by one column: any multiple of a row that is 0 may be added to
the others; the column becomes 0 in all of them and what it was bounded by is forgotten. Before, rows are
turned into those of an elimination with full pivoting, where the columns that little is forgotten of show;
and columns are narrowed to the interval that each row alone leaves them (Scott et al., 4.2). **Columns**
beyond q are those that n + k others express with least loss: T R with |R| small, replaced by T diag(1 + sum
|R|). So is r.

All of these hold for any multipliers, intervals and R: what floats make of them is bounded and added to r, as
in `zonotope_steps`.

Sources: Scott, Raimondo, Marseglia, Braatz 2016, sections 3 and 4; Yang, Scott 2018 (which columns are
expressed by others).
"""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation import zonotope_steps as steps
from jaxbound.estimation.arrays import Array
from jaxbound.estimation.by_size import ascending, integers
from jaxbound.estimation.set_rounding import SetRounding, set_rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.unrolled import stored

__all__ = ["AskedRows", "HeldRows", "follow", "nothing"]

SMALL = 2.0**-24
"""Share of the largest entry below which an entry is no pivot."""
STEEP = 2.0**20
"""Multipliers beyond it are not used: rounding would take more than they give."""


class HeldRows(NamedTuple):
    """Sets before a sample is looked at.

    Fields: h (n + k, N), H (n + k, q, N), r (n + k, N); on (N,): whether there is one.
    """

    h: Array
    H: Array
    r: Array
    on: Array


class AskedRows(NamedTuple):
    """Rows with each of T samples: 0 in h + H xi + diag(r) eta.

    Fields: h, r (T, rows, N), H (T, rows, q + p, N), on (T, N): whether there are any. The first n rows are
    the state.
    """

    h: Array
    H: Array
    r: Array
    on: Array


class _Equations(NamedTuple):
    """The rows of N sets while a step changes them: h + H xi + diag(r) eta.

    Fields: h, r (rows, N), H (rows, columns, N).
    """

    h: jax.Array
    H: jax.Array
    r: jax.Array


_State: TypeAlias = tuple[steps.ZonotopeCarry, HeldRows, steps.Found, AskedRows]


def nothing(n: int, k: int, q: int, N: int, dtype: np.dtype) -> HeldRows:
    """Return the HeldRows of N recordings before the first sample, on the host."""
    return HeldRows(
        np.zeros((n + k, N), dtype),
        np.zeros((n + k, q, N), dtype),
        np.zeros((n + k, N), dtype),
        np.zeros(N, bool),
    )


@kernel(static_argnames=("enclosures",), compiler_options={"xla_cpu_multi_thread_eigen": False})
def follow(
    plant: steps.Numbers,
    start: steps.Start | None,
    carry: steps.ZonotopeCarry,
    held: HeldRows,
    known: steps.Read,
    stop: int,
    enclosures: int,
    restart: jax.Array | bool,
) -> _State:
    """Follow N recordings over the first `stop` of these samples, zonotopes (one weight) beside.

    Args:
        plant, start, carry, known, stop, enclosures, restart: as of `zonotope_steps.follow`, the samples as
            `read` returns them. held: the sets before the first of them.

    Returns:
        (carry, HeldRows, Found of the zonotopes, AskedRows); those of other samples mean nothing.
    """
    (R, q, N), (T, p, _), dtype = held.H.shape, known.mid.shape, known.mid.dtype
    n = len(plant.A)
    verdicts = steps.nothing_found(known, n, enclosures)
    programs = AskedRows(
        jnp.zeros((T, R + p, N), dtype),
        jnp.zeros((T, R + p, q + p, N), dtype),
        jnp.zeros((T, R + p, N), dtype),
        jnp.zeros((T, N), bool),
    )
    columns = q + p + plant.W.shape[1] + R
    terms = 4 * (R + p + columns + plant.B.shape[1] + 16)
    g = set_rounding(terms, terms, dtype)

    def step(k: jax.Array, state: _State) -> _State:
        carry, earlier, verdicts, programs = state
        now = steps.at_sample(known, k)
        carry = steps.begun_anew(carry, now.fresh)
        alive = carry.age >= 0
        before = _from_zonotope(earlier, carry, alive & ~(earlier.on & ~now.fresh))
        rows, present = _met(plant, before, now, g)
        own = AskedRows(*rows, alive & before.on & jnp.any(present, 0))
        carry, size, row = steps.sample(plant, start, carry, now, enclosures)
        gone = restart & carry.empty
        carry = steps.begun_anew(carry, gone)
        rows = _fewer_rows(n, p, rows, g)
        rows = _moved_on(plant, rows, now, g)
        rows = _fewer_columns(rows, q, g)
        carry = steps.step_of_time(plant, carry, size, now)
        bounded = jnp.all(jnp.abs(rows.h) + jnp.sum(jnp.abs(rows.H), 1) + rows.r <= g.most, 0)
        on = before.on & alive & ~gone & bounded & (carry.age >= 0)
        h, H, r = (jnp.where(_like(on, x), x, 0) for x in rows)
        return carry, HeldRows(h, H, r, on), steps.written(verdicts, row, k), steps.written(programs, own, k)

    state: _State = jax.lax.fori_loop(0, stop, step, (carry, held, verdicts, programs))
    return state


def _dot(M: Array, X: Array) -> jax.Array:
    """Return M X for M (r, n), X (n, ..., N)."""
    return jnp.sum(M.reshape(*M.shape, *[1] * (X.ndim - 1)) * X[None], 1)


def _each(M: jax.Array, X: jax.Array) -> jax.Array:
    """Return M X for M (r, n, N), X (n, q, N) or (n, N), recording by recording."""

    def add(i: jax.Array, out: jax.Array) -> jax.Array:
        column = jax.lax.dynamic_index_in_dim(M, i, 1).reshape(len(M), *[1] * (X.ndim - 2), -1)
        so_far: jax.Array = out + column * X[i][None]
        return so_far

    image: jax.Array = jax.lax.fori_loop(0, len(X), add, jnp.zeros((len(M), *X.shape[1:]), X.dtype))
    return image


def _sums(X: Array) -> jax.Array:
    """Return the sums of magnitudes along the columns."""
    return jnp.sum(jnp.abs(X), 1)


def _like(x: Array, X: Array) -> Array:
    """Return x (N,) with as many axes as X (.., N)."""
    return x.reshape(*[1] * (X.ndim - 1), -1)


def _from_zonotope(held: HeldRows, carry: steps.ZonotopeCarry, where: Array) -> HeldRows:
    """Begin, where there is none, with the set of the zonotope."""
    below = len(held.h) - len(carry.c)

    def pick(new: Array, old: Array) -> jax.Array:
        is_new = _like(where, old)
        return jnp.where(is_new, jnp.concatenate([new, jnp.zeros((below, *new.shape[1:]), new.dtype)]), old)

    return HeldRows(
        pick(carry.c, held.h),
        pick(carry.G, held.H),
        pick(carry.r, held.r),
        (held.on | where) & (carry.age >= 0),
    )


def _met(
    plant: steps.Numbers, held: HeldRows, now: steps.Read, g: SetRounding
) -> tuple[_Equations, jax.Array]:
    """Return (rows, present (p, N)) with a row and a column for each output, nothing but zeros where it is
    missing.
    """
    n, (_, _, N), p = len(plant.A), held.H.shape, len(now.mid)
    direct = _sums(plant.D) + jnp.sum(plant.wide_D, 1) > 0
    present = jnp.isfinite(now.rad) & (now.known[None] | ~direct[:, None])
    c, G, r = held.h[:n], held.H[:n], held.r[:n]
    size = jnp.abs(c) + _sums(G) + r
    v = jnp.where(now.known[None], now.v, 0)
    mid = jnp.where(present, now.mid, 0)
    rad = jnp.where(present, now.rad, 0)
    C, D = jnp.abs(plant.C), jnp.abs(plant.D)
    value = _dot(plant.C, c) + _dot(plant.D, v) - mid
    rows = _dot(plant.C, G)
    off = (
        _dot(C, r)
        + _dot(plant.wide_C + g.gamma * C, size)
        + _dot(plant.wide_D + g.gamma * D, jnp.abs(v))
        + g.gamma * jnp.abs(mid)
    )
    off = g.grown(off, _dot(D, jnp.where(now.known[None], now.slip, 0)))
    # rows are of the size 1, so that one measure finds the pivots of all
    share = stored(jnp.where(present, 1 / (rad + 2.0**-20 * _sums(rows) + g.least), 0))
    value, rows, own = share * value, share[:, None] * rows, share * rad
    off = jnp.where(present, g.grown(share * off, g.gamma * (jnp.abs(value) + _sums(rows) + own)), 0)
    columns = jnp.concatenate(
        [jnp.zeros((len(held.h), p, N), rows.dtype), jnp.eye(p, dtype=rows.dtype)[:, :, None] * own[:, None]]
    )
    H = jnp.concatenate([jnp.concatenate([held.H, rows]), columns], 1)
    h = jnp.concatenate([held.h, value])
    return stored(_Equations(h, H, jnp.concatenate([held.r, off]))), present


_Pivots: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""M, the column of each row's pivot, which rows have one, and which columns are free."""


def _pivoted(M: jax.Array, wide: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (M, columns (r, N), done (r, N)) after an elimination of the rows of M (r, .., N), full pivots
    among the first `wide` columns.

    columns: the pivot's of each row; done: whether there was one. In plain floats, no claim.
    """
    rows, _, N = M.shape
    count, bits = rows * wide, integers(M.dtype)
    below, number = power(count) - 1, jnp.arange(count, dtype=bits).reshape(rows, wide, 1)
    largest = SMALL * jnp.max(jnp.abs(M[:, :wide]), (0, 1))
    of_row, of_column = jnp.arange(rows)[:, None], jnp.arange(wide)[:, None]

    def step(_: jax.Array, state: _Pivots) -> _Pivots:
        M, columns, done, free = state
        key = jnp.where(~done[:, None] & free[None], jnp.abs(M[:, :wide]), 0)
        # one maximum finds size and place: the last digits of a size are the number of its entry
        key = (jax.lax.bitcast_convert_type(key, bits) & bits(~below)) | number
        best = jnp.max(key, (0, 1)) & bits(below)
        i, j = best // wide, best % wide
        here, there = of_row == i[None], of_column == j[None]
        row = jnp.sum(jnp.where(here[:, None], M, 0), 0)
        column = jnp.sum(jnp.where(there[None], M[:, :wide], 0), 1)
        pivot = jnp.sum(jnp.where(here, column, 0), 0)
        good = jnp.abs(pivot) > largest
        row = row / jnp.where(good, pivot, 1)[None]
        new = jnp.where(here[:, None], row[None], M - column[:, None] * row[None])
        mark = here & good[None]
        M = jnp.where(_like(good, M), new, M)
        columns = jnp.where(mark, j[None], columns)
        return M, columns, done | mark, free & ~(there & good[None])

    begin = M, jnp.zeros((rows, N), bits), jnp.zeros((rows, N), bool), jnp.ones((wide, N), bool)
    M, columns, done, _ = jax.lax.fori_loop(0, rows, step, begin)
    return M, columns, done


def _fewer_rows(n: int, p: int, rows: _Equations, g: SetRounding) -> _Equations:
    """Return the rows with p of those below the first n eliminated, and as many columns 0."""
    return _eliminated(n, p, _narrowed(n, _turned(n, rows, g), g), g)


def _turned(n: int, rows: _Equations, g: SetRounding) -> _Equations:
    """Return the rows with those below the first n as an elimination with full pivoting leaves them."""
    h, H, r = rows
    K, (_, Q, N) = len(h) - n, H.shape
    one = jnp.broadcast_to(jnp.eye(K, dtype=H.dtype)[:, :, None], (K, K, N))
    P = _pivoted(jnp.concatenate([H[n:], one], 1), Q)[0][:, Q:]
    P = jnp.where(jnp.all(jnp.abs(P) < STEEP, (0, 1), keepdims=True), P, one)
    size = jnp.abs(h[n:]) + _sums(H[n:])
    below = stored((_each(P, h[n:]), _each(P, H[n:]), g.grown(_each(jnp.abs(P), r[n:] + g.gamma * size))))
    return _Equations(*(jnp.concatenate([top[:n], x]) for top, x in zip(rows, below, strict=True)))


def _narrowed(n: int, rows: _Equations, g: SetRounding) -> _Equations:
    """Return the rows with each column narrowed to the interval that the rows below the first n leave it."""
    h, H, r = rows
    a, far = H[n:], (_sums(H[n:]) * g.up + r[n:])[:, None]
    fit = jnp.abs(a) > SMALL
    near = jnp.where(fit, a, 1)
    centre, reach = -h[n:, None] / near, (far - jnp.abs(a)) / jnp.abs(near)
    reach = g.grown(reach, g.gamma * (jnp.abs(centre) + far / jnp.abs(near)))
    hi = jnp.minimum(1, jnp.min(jnp.where(fit, centre + reach, jnp.inf), 0))
    lo = jnp.maximum(-1, jnp.max(jnp.where(fit, centre - reach, -jnp.inf), 0))
    some = (lo < hi) & (hi - lo < 2)
    middle = stored(jnp.where(some, 0.5 * (lo + hi), 0))
    share = stored(jnp.where(some, g.grown(0.5 * (hi - lo), g.gamma * (jnp.abs(lo) + jnp.abs(hi))), 1))
    moved = jnp.sum(H * middle[None], 1)
    off = g.grown(r, g.gamma * (jnp.abs(h) + 2 * _sums(H)))
    return stored(_Equations(h + moved, H * share[None], off))


def _eliminated(n: int, p: int, rows: _Equations, g: SetRounding) -> _Equations:
    """Return the rows without p of those below the first n, each eliminated by its largest column."""
    R, Q, N = rows.H.shape
    at = jnp.arange(R)[:, None]

    def eliminate(step: jax.Array, rows: _Equations) -> _Equations:
        h, H, r = rows
        a = jnp.abs(H[n:])
        size, top = jnp.sum(a, 1), jnp.max(a, 1)
        cost = jnp.where(size > 0, (jnp.abs(h[n:]) + size + r[n:]) / jnp.where(top > 0, top, 1), -1)
        last = R - 1 - step
        cost = jnp.where(at[n:] <= last, cost, jnp.inf)
        here = at == n + jnp.argmin(cost, 0, keepdims=True)
        row = jnp.sum(jnp.where(here[:, None], H, 0), 0)

        def of_row(x: jax.Array) -> jax.Array:
            return jnp.sum(jnp.where(here, x, 0), 0, keepdims=True)

        def dropped(x: jax.Array) -> jax.Array:
            """Put the last row in the place of this one, and zeros in its own."""
            is_last = (at == last).reshape(-1, *[1] * (x.ndim - 1))
            is_here = here.reshape(R, *[1] * (x.ndim - 2), N)
            return jnp.where(is_last, 0, jnp.where(is_here, jax.lax.dynamic_index_in_dim(x, last, 0), x))

        there = jnp.arange(Q)[:, None] == jnp.argmax(jnp.abs(row), 0, keepdims=True)
        pivot = jnp.sum(jnp.where(there, row, 0), 0, keepdims=True)
        f = jnp.sum(jnp.where(there[None], H, 0), 1) / jnp.where(pivot != 0, pivot, 1)
        f = stored(jnp.where(here | (pivot == 0), 0, f))
        whole = (
            jnp.abs(h)
            + _sums(H)
            + jnp.abs(f) * (jnp.abs(of_row(h)) + jnp.sum(jnp.abs(row), 0, keepdims=True))
        )
        r = g.grown(r, jnp.abs(f) * of_row(r), g.gamma * whole)
        gone = there & (pivot != 0)
        h = h - f * of_row(h)
        H = jnp.where(gone[None], 0, H - f[:, None] * row[None])
        return _Equations(dropped(h), dropped(H), dropped(r))

    h, H, r = jax.lax.fori_loop(0, p, eliminate, rows)
    return _Equations(h[: R - p], H[: R - p], r[: R - p])


def _moved_on(plant: steps.Numbers, rows: _Equations, now: steps.Read, g: SetRounding) -> _Equations:
    """Return the rows one sample later, with the columns of disturbances."""
    h, H, r = rows
    n, N, A, v = len(plant.A), h.shape[-1], jnp.abs(plant.A), jnp.abs(now.v)
    c, G = h[:n], H[:n]
    size = jnp.abs(c) + _sums(G) + r[:n]
    off = (
        _dot(plant.wide_A + g.gamma * A, size)
        + _dot(plant.wide_B + g.gamma * jnp.abs(plant.B), v)
        + _dot(jnp.abs(plant.B), now.slip)
    )
    off = g.grown(_dot(A, r[:n]), off, (plant.wide_w + g.gamma * jnp.abs(plant.w))[:, None])
    c = _dot(plant.A, c) + _dot(plant.B, now.v) + plant.w[:, None]
    W = jnp.concatenate([plant.W, jnp.zeros((len(h) - n, plant.W.shape[1]), plant.W.dtype)])
    moved = jnp.concatenate([_dot(plant.A, G), H[n:]])
    H = jnp.concatenate([moved, jnp.broadcast_to(W[:, :, None], (*W.shape, N))], 1)
    h = jnp.concatenate([c, h[n:]])
    return stored(_Equations(h, H, jnp.concatenate([off, r[n:]])))


def _fewer_columns(rows: _Equations, q: int, g: SetRounding) -> _Equations:
    """Return rows of q columns, of a set that holds this one: columns, and r, that others express with least
    loss.
    """
    h, H, r = rows
    R, Q, N = H.shape
    size = _sums(H)
    share = (1 / jnp.where(size > 0, size, 1))[:, None]
    slack = jnp.eye(R, dtype=H.dtype)[:, :, None] * r[:, None]
    X, columns, done = _pivoted(jnp.concatenate([H, slack], 1) * share, Q)
    X = jnp.where(done[:, None], X, 0)
    order = ascending(_loss(H, X, columns, done))
    kept = jnp.take_along_axis(H, order[None, Q - q :], 1)
    dropped = order[: Q - q, None] == jnp.arange(Q, dtype=order.dtype)[None, :, None]
    gone = jnp.sum(dropped.astype(jnp.int32), 0) > 0
    X = jnp.where(jnp.concatenate([gone, jnp.ones((R, N), bool)])[None], X, 0)
    X = jnp.where(jnp.all(jnp.abs(X) < STEEP, (0, 1), keepdims=True), X, 0)
    T = jnp.where(done[None], jnp.take_along_axis(H, columns[None], 1), 0)
    rest = jnp.concatenate([jnp.where(gone[None], H, 0), slack], 1)
    size = _sums(rest) + jnp.sum(jnp.abs(T) * _sums(X)[None], 1)
    grow = g.grown(1 + _sums(X))  # of the column that each row stands for
    is_column_of = (order[Q - q :, None] == columns[None]) & done[None]
    grow = stored(jnp.prod(jnp.where(is_column_of, grow[None], 1), 1))
    kept = kept * grow[None]
    left = g.grown(_sums(rest - _each(T, X)), g.gamma * (size + _sums(kept)))
    return _Equations(h, kept, left)


def _loss(H: jax.Array, X: jax.Array, columns: jax.Array, done: jax.Array) -> jax.Array:
    """Return (Q, N): how much larger a set becomes without each column, infinite for those that stay.

    Args:
        X (R, Q + R, N): the columns, and r, by those that the rows stand for. columns, done (R, N): of these.
    """
    Q = H.shape[1]
    stays = jnp.any((jnp.arange(Q)[None, :, None] == columns[:, None]) & done[:, None], 0)
    far = jnp.abs(X[:, :Q])
    loss = jnp.prod(1 + far, 0) - 1 - jnp.sum(far, 0)
    loss = jnp.maximum(loss, 0) + jnp.sum(jnp.abs(H), 0) * SMALL  # columns of zeros first
    # those that others are expressed by stay, whatever NaN
    return jnp.where(stays, jnp.inf, jnp.where(loss < 2.0**100, loss, 2.0**100))
