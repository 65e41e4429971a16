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

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation import zonotope_steps as steps
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.unrolled import stored

__all__ = ["AskedRows", "HeldRows", "follow", "nothing"]

SMALL = 2.0**-24
"""Share of the largest entry below which an entry is no pivot."""


class HeldRows(NamedTuple):
    """Sets before a sample is looked at. Fields: h (n + k, N), H (n + k, q, N), r (n + k, N); on (N,):
    whether there is one.
    """

    h: Any
    H: Any
    r: Any
    on: Any


class AskedRows(NamedTuple):
    """Rows with each of T samples: 0 in h + H xi + diag(r) eta. Fields: h, r (T, rows, N), H (T, rows, q + p,
    N), on (T, N): whether there are any. The first n rows are the state.
    """

    h: Any
    H: Any
    r: Any
    on: Any


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
) -> tuple[steps.ZonotopeCarry, HeldRows, steps.Found, AskedRows]:
    """Follow N recordings over the first `stop` of these samples, zonotopes (one weight) beside; args and
    Found as of theirs.
    """
    (R, q, N), (T, p, _), dtype = held.H.shape, known.mid.shape, known.mid.dtype
    n = len(plant.A)
    room = lambda *shape, dtype=dtype: jnp.zeros((T, *shape, N), dtype)
    found = steps.Found(
        room(dtype=jnp.int8),
        room(),
        room(dtype=jnp.int32),
        room(2 * n * min(enclosures, 1)),
        room(4 * p * (enclosures // 2)),
    )
    asked = AskedRows(room(R + p), room(R + p, q + p), room(R + p), room(dtype=bool))
    g = _Bounds(R + p, q + p + plant.W.shape[1] + R, plant.B.shape[1], dtype)

    def step(k, state):
        carry, held, found, asked = state
        now = steps.Read(*(jax.lax.dynamic_index_in_dim(x, k, 0, keepdims=False) for x in known))
        carry = steps.begun_anew(carry, now.fresh)
        alive = carry.age >= 0
        held = _from_zonotope(held, carry, alive & ~(held.on & ~now.fresh))
        h, H, r, seen = _met(plant, held, now, g)
        out = AskedRows(h, H, r, alive & held.on & jnp.any(seen, 0))
        carry, size, told = steps.sample(plant, start, carry, now, enclosures)
        gone = restart & carry.empty
        carry = steps.begun_anew(carry, gone)
        h, H, r = _fewer_rows(n, p, h, H, r, g)
        h, H, r = _moved(plant, h, H, r, now, g)
        h, H, r = _fewer_columns(h, H, r, q, g)
        carry = steps.step_of_time(plant, carry, size, now)
        bounded = jnp.all(jnp.abs(h) + jnp.sum(jnp.abs(H), 1) + r <= g.most, 0)
        on = held.on & alive & ~gone & bounded & (carry.age >= 0)
        clean = lambda x: jnp.where(_like(on, x), x, 0)
        put = lambda old, new: jax.tree.map(
            lambda a, b: jax.lax.dynamic_update_index_in_dim(a, b, k, 0), old, new
        )
        return carry, HeldRows(clean(h), clean(H), clean(r), on), put(found, told), put(asked, out)

    return jax.lax.fori_loop(0, stop, step, (carry, held, found, asked))


class _Bounds:
    """As those of `zonotope_steps`: gamma, up, least, most; `own` is what sums of one product cost."""

    def __init__(self, rows, columns, inputs, dtype):
        wide, terms = dtype == np.float64, 4 * (rows + columns + inputs + 16)
        self.gamma = rounding.product_error(terms, dtype)[0]
        self.up = np.asarray(1 + 4 * terms * float(rounding.unit(dtype)), dtype)
        self.least, self.most = (
            np.asarray(2.0**-500 if wide else 2.0**-46, dtype),
            np.asarray(2.0**300 if wide else 2.0**40, dtype),
        )

    def grown(self, *terms):
        """Return at least the sum of terms >= 0."""
        return self.up * sum(terms) + self.least


def _dot(M, X):
    """Return M X for M (r, n), X (n, ..., N)."""
    return jnp.sum(M.reshape(*M.shape, *[1] * (X.ndim - 1)) * X[None], 1)


def _each(M, X):
    """Return M X for M (r, n, N), X (n, q, N) or (n, N), recording by recording."""
    add = lambda i, out: (
        out + jax.lax.dynamic_index_in_dim(M, i, 1).reshape(len(M), *[1] * (X.ndim - 2), -1) * X[i][None]
    )
    return jax.lax.fori_loop(0, len(X), add, jnp.zeros((len(M), *X.shape[1:]), X.dtype))


def _sums(X):
    return jnp.sum(jnp.abs(X), 1)


def _like(x, X):
    """Return x (N,) with as many axes as X (.., N)."""
    return x.reshape(*[1] * (X.ndim - 1), -1)


def _from_zonotope(held, carry, where):
    """Begin, where there is none, with the set of the zonotope."""
    below = len(held.h) - len(carry.c)
    full = lambda x: jnp.concatenate([x, jnp.zeros((below, *x.shape[1:]), x.dtype)])
    pick = lambda new, old: jnp.where(_like(where, old), full(new), old)
    return HeldRows(
        pick(carry.c, held.h),
        pick(carry.G, held.H),
        pick(carry.r, held.r),
        (held.on | where) & (carry.age >= 0),
    )


def _met(plant, held, now, g):
    """Return (h, H, r, seen (p, N)) with a row and a column for each output, nothing but zeros where it is
    missing.
    """
    n, (_, _, N), p = len(plant.A), held.H.shape, len(now.mid)
    direct = _sums(plant.D) + jnp.sum(plant.wide_D, 1) > 0
    seen = jnp.isfinite(now.rad) & (now.known[None] | ~direct[:, None])
    c, G, r = held.h[:n], held.H[:n], held.r[:n]
    size, v = jnp.abs(c) + _sums(G) + r, jnp.where(now.known[None], now.v, 0)
    mid, rad, C, D = (
        jnp.where(seen, now.mid, 0),
        jnp.where(seen, now.rad, 0),
        jnp.abs(plant.C),
        jnp.abs(plant.D),
    )
    value, rows = _dot(plant.C, c) + _dot(plant.D, v) - mid, _dot(plant.C, G)
    off = (
        _dot(C, r)
        + _dot(plant.wide_C + g.gamma * C, size)
        + _dot(plant.wide_D + g.gamma * D, jnp.abs(v))
        + g.gamma * jnp.abs(mid)
    )
    off = g.grown(off, _dot(D, jnp.where(now.known[None], now.slip, 0)))
    share = stored(jnp.where(seen, 1 / (rad + 2.0**-20 * _sums(rows) + g.least), 0))
    value, rows, own = share * value, share[:, None] * rows, share * rad
    off = jnp.where(seen, g.grown(share * off, g.gamma * (jnp.abs(value) + _sums(rows) + own)), 0)
    columns = jnp.concatenate(
        [jnp.zeros((len(held.h), p, N), rows.dtype), jnp.eye(p, dtype=rows.dtype)[:, :, None] * own[:, None]]
    )
    H = jnp.concatenate([jnp.concatenate([held.H, rows]), columns], 1)
    return *stored((jnp.concatenate([held.h, value]), H, jnp.concatenate([held.r, off]))), seen


def _pivoted(M, wide):
    """Return (M, columns (r, N), done (r, N)) after an elimination of the rows of M (r, .., N), full pivots
    among the first `wide` columns.

    columns: the pivot's of each row; done: whether there was one. In plain floats, no claim.
    """
    rows, _, N = M.shape
    count, bits = rows * wide, (np.int64 if M.dtype == np.float64 else np.int32)
    below, number = power(count) - 1, jnp.arange(rows * wide, dtype=bits).reshape(rows, wide, 1)
    largest = SMALL * jnp.max(jnp.abs(M[:, :wide]), (0, 1))
    of_row, of_column = jnp.arange(rows)[:, None], jnp.arange(wide)[:, None]

    def step(_, state):
        M, columns, done, free = state
        key = jnp.where(~done[:, None] & free[None], jnp.abs(M[:, :wide]), 0)
        best = jnp.max((jax.lax.bitcast_convert_type(key, bits) & bits(~below)) | number, (0, 1)) & bits(
            below
        )
        i, j = best // wide, best % wide
        here, there = of_row == i[None], of_column == j[None]
        row = jnp.sum(jnp.where(here[:, None], M, 0), 0)
        column = jnp.sum(jnp.where(there[None], M[:, :wide], 0), 1)
        pivot = jnp.sum(jnp.where(here, column, 0), 0)
        good = jnp.abs(pivot) > largest
        row = row / jnp.where(good, pivot, 1)[None]
        new = jnp.where(here[:, None], row[None], M - column[:, None] * row[None])
        mark = here & good[None]
        return (
            jnp.where(_like(good, M), new, M),
            jnp.where(mark, j[None], columns),
            done | mark,
            free & ~(there & good[None]),
        )

    begin = M, jnp.zeros((rows, N), bits), jnp.zeros((rows, N), bool), jnp.ones((wide, N), bool)
    return jax.lax.fori_loop(0, rows, step, begin)[:3]


def _fewer_rows(n, p, h, H, r, g):
    """Return (h, H, r) with p rows below the first n eliminated, and as many columns 0."""
    K, (_, Q, N) = len(h) - n, H.shape
    one = jnp.broadcast_to(jnp.eye(K, dtype=H.dtype)[:, :, None], (K, K, N))
    P = _pivoted(jnp.concatenate([H[n:], one], 1), Q)[0][:, Q:]
    P = jnp.where(jnp.all(jnp.abs(P) < 2.0**20, (0, 1), keepdims=True), P, one)
    size = jnp.abs(h[n:]) + _sums(H[n:])
    below = stored((_each(P, h[n:]), _each(P, H[n:]), g.grown(_each(jnp.abs(P), r[n:] + g.gamma * size))))
    h, H, r = (jnp.concatenate([top[:n], x]) for top, x in zip((h, H, r), below, strict=True))

    # what each row alone leaves of each column
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
    state = stored((h + moved, H * share[None], off))

    at = jnp.arange(n + K)[:, None]

    def eliminate(step, state):
        h, H, r = state
        a = jnp.abs(H[n:])
        size, top = jnp.sum(a, 1), jnp.max(a, 1)
        cost = jnp.where(size > 0, (jnp.abs(h[n:]) + size + r[n:]) / jnp.where(top > 0, top, 1), -1)
        last = n + K - 1 - step
        cost = jnp.where(at[n:] <= last, cost, jnp.inf)
        here = at == n + jnp.argmin(cost, 0, keepdims=True)
        row = jnp.sum(jnp.where(here[:, None], H, 0), 0)
        of_row = lambda x: jnp.sum(jnp.where(here, x, 0), 0, keepdims=True)
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
        h, H = h - f * of_row(h), jnp.where(gone[None], 0, H - f[:, None] * row[None])
        drop = lambda x: jnp.where(
            (at == last).reshape(-1, *[1] * (x.ndim - 1)),
            0,
            jnp.where(
                here.reshape(len(at), *[1] * (x.ndim - 2), N), jax.lax.dynamic_index_in_dim(x, last, 0), x
            ),
        )
        return drop(h), drop(H), drop(r)

    h, H, r = jax.lax.fori_loop(0, p, eliminate, state)
    return h[: n + K - p], H[: n + K - p], r[: n + K - p]


def _moved(plant, h, H, r, now, g):
    """Return (h, H, r) one sample later, with the columns of disturbances."""
    n, N, A, v = len(plant.A), h.shape[-1], jnp.abs(plant.A), jnp.abs(now.v)
    c, G = h[:n], H[:n]
    size, lift = jnp.abs(c) + _sums(G) + r[:n], lambda x: x[:, None]
    off = (
        _dot(plant.wide_A + g.gamma * A, size)
        + _dot(plant.wide_B + g.gamma * jnp.abs(plant.B), v)
        + _dot(jnp.abs(plant.B), now.slip)
    )
    off = g.grown(_dot(A, r[:n]), off, lift(plant.wide_w + g.gamma * jnp.abs(plant.w)))
    c = _dot(plant.A, c) + _dot(plant.B, now.v) + lift(plant.w)
    W = jnp.concatenate([plant.W, jnp.zeros((len(h) - n, plant.W.shape[1]), plant.W.dtype)])
    H = jnp.concatenate(
        [jnp.concatenate([_dot(plant.A, G), H[n:]]), jnp.broadcast_to(W[:, :, None], (*W.shape, N))], 1
    )
    return stored((jnp.concatenate([c, h[n:]]), H, jnp.concatenate([off, r[n:]])))


def _fewer_columns(h, H, r, q, g):
    """Return (h, H (.., q, N), r) of a set that holds this one: columns, and r, that others express with
    least loss.
    """
    R, Q, N = H.shape
    size = _sums(H)
    share = (1 / jnp.where(size > 0, size, 1))[:, None]
    slack = jnp.eye(R, dtype=H.dtype)[:, :, None] * r[:, None]
    X, columns, done = _pivoted(jnp.concatenate([H, slack], 1) * share, Q)
    X = jnp.where(done[:, None], X, 0)
    base = jnp.any((jnp.arange(Q)[None, :, None] == columns[:, None]) & done[:, None], 0)
    far = jnp.abs(X[:, :Q])
    loss = jnp.prod(1 + far, 0) - 1 - jnp.sum(far, 0)
    loss = jnp.maximum(loss, 0) + jnp.sum(jnp.abs(H), 0) * SMALL  # columns of zeros first
    loss = jnp.where(
        base, jnp.inf, jnp.where(loss < 2.0**100, loss, 2.0**100)
    )  # those that others are expressed by stay, whatever NaN
    bits, below = (np.int64 if H.dtype == np.float64 else np.int32), power(Q) - 1
    key = (jax.lax.bitcast_convert_type(loss, bits) & bits(~below)) | jnp.arange(Q, dtype=bits)[:, None]
    order = jnp.sort(key, 0) & bits(below)
    kept = jnp.take_along_axis(H, order[None, Q - q :], 1)
    gone = (
        jnp.sum((order[: Q - q, None] == jnp.arange(Q, dtype=bits)[None, :, None]).astype(jnp.int32), 0) > 0
    )
    X = jnp.where(jnp.concatenate([gone, jnp.ones((R, N), bool)])[None], X, 0)
    X = jnp.where(jnp.all(jnp.abs(X) < 2.0**20, (0, 1), keepdims=True), X, 0)
    T = jnp.where(done[None], jnp.take_along_axis(H, columns[None], 1), 0)
    rest = jnp.concatenate([jnp.where(gone[None], H, 0), slack], 1)
    size = _sums(rest) + jnp.sum(jnp.abs(T) * _sums(X)[None], 1)
    grow = g.grown(1 + _sums(X))  # of the column that each row stands for
    which = (order[Q - q :, None] == columns[None]) & done[None]
    grow = stored(jnp.prod(jnp.where(which, grow[None], 1), 1))
    kept = kept * grow[None]
    left = g.grown(_sums(rest - _each(T, X)), g.gamma * (size + _sums(kept)))
    return h, kept, left
