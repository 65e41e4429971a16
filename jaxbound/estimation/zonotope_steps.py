"""One step of a set observer: zonotopes that hold the state, all recordings side by side on the last axis,
one loop over time.

A set is {c + G xi + diag(r) eta}, |xi|, |eta| <= 1, with q generators in G; r holds what rounding adds until
it becomes a generator.

**A sample** says |m - C x - D v| <= s of one output (`sensor.true_value`). For every number L, x lies in
c + L (m - C c - D v) + (I - L C) G xi + L s delta, |delta| <= 1. Taken is the L that makes the sum of squares
of all generators least, L = R C' / (C R C' + s^2) with R = G G': one output after the other, it is the gain
of the Kalman filter. With weight s^2 in place of s^2, weight > 1, samples count less: the set is wider, and
what is slow shows for longer. Several weights go side by side, each a recording of its own; what one of them
refutes is refuted. **A step of time** maps the set by A and adds generators of the disturbances. Then the
smallest generators (1-norm less the largest entry) go into a box, if there are more than q.

**Rounding.** Every result above is off by less than gamma (|c| + sum_j |G_j| + r + ..), with the magnitudes
of all that it is computed from, see `product_error`; the sum of these bounds, and what intervals instead of
numbers in A, B, C, D add, goes into r. Numbers beyond 2^300 (float32: 2^40) end the enclosure, as if the
state were not known; below it no product overflows, and 2^-500 (2^-46) covers what underflows.

Sources: Alamo, Bravo, Camacho 2005 (strips, Theorem 4 and section 5); Combastel 2015 (its gain); Girard 2005
(which generators stay).
"""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.estimation.free_inputs import known_again
from jaxbound.models.sensor import RECORDER_ULPS, lift, true_value
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.unrolled import stored, summed

__all__ = [
    "ZonotopeCarry",
    "Found",
    "Numbers",
    "Read",
    "Start",
    "begun_anew",
    "follow",
    "read",
    "sample",
    "step_of_time",
    "unknown",
]


class Numbers(NamedTuple):
    """A model in floats.

    Fields: A (n, n), B (n, m), C (p, n), D (p, m) and wide_A, .., what entries may be more or less; W (n, g)
    columns of disturbances, w (n,) their middle, wide_w (n,) what these may be off by; u0 (m,), wide_u0;
    tolerance, noise, y0 (p,). free: unknown inputs, or None.
    """

    A: Any
    wide_A: Any
    B: Any
    wide_B: Any
    C: Any
    wide_C: Any
    D: Any
    wide_D: Any
    W: Any
    w: Any
    wide_w: Any
    u0: Any
    wide_u0: Any
    tolerance: Any
    noise: Any
    y0: Any
    free: Any = None


class Start(NamedTuple):
    """The state x of the newest sample from the last h + 1 alone: x = K m + U v + w + W xi - K s delta.

    Fields: K (n, (h+1) p), U (n, (h+1) m), w (n,), W (n, h g), the oldest sample first; wide_K, wide_U, wide
    (n,): what x may be off by for each |m| + s and |v|, and beside.
    """

    K: Any
    U: Any
    w: Any
    W: Any
    wide_K: Any
    wide_U: Any
    wide: Any


class Read(NamedTuple):
    """What T samples say. Fields: mid, rad (T, p, N), radius infinite where there is none; v, slip (T, m, N)
    inputs less their offset, and what they may be off by; whole (T, N): whether every output is there; known:
    every input; fresh: does not follow the sample before.
    """

    mid: Any
    rad: Any
    v: Any
    slip: Any
    whole: Any
    known: Any
    fresh: Any


class ZonotopeCarry(NamedTuple):
    """What goes on from sample to sample: the set before a sample is looked at, and the last samples.

    Fields: c (n, N), G (n, q, N), r (n, N); age (N,): samples that the set rests on, -1 where there is none;
    empty (N,): contradicted; mid, rad (h, p, N), v, slip (h, m, N): the last samples; ready (N,): how many of
    these are whole and follow each other. weight (N,).
    """

    c: Any
    G: Any
    r: Any
    age: Any
    empty: Any
    mid: Any
    rad: Any
    v: Any
    slip: Any
    ready: Any
    weight: Any


def unknown(sizes: tuple[int, int, int, int, int], weight: np.ndarray) -> ZonotopeCarry:
    """Return the ZonotopeCarry of recordings before the first sample, on the host. sizes: n, q, p, m, h;
    weight (N,), in the dtype of all.
    """
    (n, q, p, m, h), N, dtype = sizes, len(weight), weight.dtype
    zero = lambda *shape: np.zeros((*shape, N), dtype)
    last = zero(h, p), zero(h, p), zero(h, m), zero(h, m)
    return ZonotopeCarry(
        zero(n),
        zero(n, q),
        zero(n),
        np.full(N, -1, np.int32),
        np.zeros(N, bool),
        *last,
        np.zeros(N, np.int32),
        weight,
    )


@kernel
def read(
    plant: Numbers, u: jax.Array, y: jax.Array, slip: jax.Array, fresh: jax.Array, rounded: jax.Array
) -> Read:
    """Return what samples u, slip (T, m, N), y (T, p, N) say. rounded: the unit roundoff of the type that y
    was recorded in.
    """
    mid, rad = [], []
    gamma, floor = rounding.residual_error(8, y.dtype)
    for i in range(y.shape[1]):
        sample = y[:, i]
        size = jnp.where(jnp.isnan(sample), 0, jnp.abs(sample))
        noise = plant.noise[i] + RECORDER_ULPS * rounded * (size + plant.noise[i])
        (middle,), (radius,), (scale,) = true_value(
            [sample], plant.tolerance[i], noise, jnp.zeros_like(noise), plant.y0[i], size
        )
        gone = jnp.isnan(sample) | ~(scale < _largest(y.dtype))
        mid.append(jnp.where(gone, 0, middle))
        rad.append(jnp.where(gone, jnp.inf, radius + gamma * scale + floor * (1 + lift(plant.tolerance))))
    middles, radii = jnp.stack(mid, 1), jnp.stack(rad, 1)
    all_along = lambda x: x[None, :, None]
    known = jnp.all(jnp.abs(u) < _largest(u.dtype), 1)
    v = jnp.where(jnp.isnan(u), 0, u) - all_along(plant.u0)
    off = (
        slip
        + all_along(plant.wide_u0)
        + 4 * rounding.unit(u.dtype) * (jnp.abs(u) + jnp.abs(all_along(plant.u0)))
        + rounding.tiny(u.dtype)
    )
    whole = jnp.all(jnp.isfinite(radii), 1) & known
    return Read(middles, radii, v, jnp.where(known[:, None], off, 0), whole, known, fresh)


class Found(NamedTuple):
    """What is found of T samples.

    Fields: status (T, N) int8; margin (T, N); age (T, N) int32, samples that the set rests on, 0 without one;
    states (T, 2 n, N), ends -lo, hi of the states; outputs (T, 4 p, N), of what perfect sensors would show:
    as the samples before allow, then with this one. Those that were not asked for are empty.
    """

    status: Any
    margin: Any
    age: Any
    states: Any
    outputs: Any


@kernel(
    static_argnames=("lanes", "enclosures", "also"), compiler_options={"xla_cpu_multi_thread_eigen": False}
)
def follow(
    plant: Numbers,
    start: Start | None,
    carry: ZonotopeCarry,
    samples: tuple,
    stop: int,
    lanes: int,
    enclosures: int,
    restart: jax.Array | bool,
    also: bool = False,
) -> tuple[ZonotopeCarry, Found, Read | None]:
    """Follow N / lanes recordings over the first `stop` of these samples.

    Args:
        start: how the state is found from samples alone, or None: where it is lost it stays so.
        samples: u, y, slip, fresh, rounded, as of `read`: one kernel with this, since a sample that comes
            alone pays for each call.
        lanes: weights side by side: recording i stands at i, i + N / lanes, .. enclosures: 0 none, 1 of
            states, 2 of outputs too.
        restart: whether the sample after a contradiction begins anew; else FAULT stays. also: whether what is
            read is wanted.

    Returns:
        (carry, Found, Read or None); what they have of other samples means nothing.
    """
    alone = read(plant, *samples)
    known = jax.tree.map(lambda x: jnp.tile(x, lanes), alone)
    (n, _, N), (T, p, _), dtype = carry.G.shape, known.mid.shape, known.mid.dtype
    room = lambda *width, dtype=dtype: jnp.zeros((T, *width, N), dtype)
    empty = Found(
        room(dtype=jnp.int8),
        room(),
        room(dtype=jnp.int32),
        room(2 * n * min(enclosures, 1)),
        room(4 * p * (enclosures // 2)),
    )

    def step(k, state):
        carry, found = state
        now = Read(*(jax.lax.dynamic_index_in_dim(x, k, 0, keepdims=False) for x in known))
        carry, size, out = sample(plant, start, begun_anew(carry, now.fresh), now, enclosures)
        carry = begun_anew(carry, restart & jnp.tile(jnp.any(carry.empty.reshape(lanes, -1), 0), lanes))
        carry = step_of_time(plant, carry, size, now)
        put = lambda old, new: jax.lax.dynamic_update_index_in_dim(old, new, k, 0)
        return carry, Found(*(put(old, new) for old, new in zip(found, out, strict=True)))

    return *jax.lax.fori_loop(0, stop, step, (carry, empty)), alone if also else None


def begun_anew(carry: ZonotopeCarry, where: jax.Array) -> ZonotopeCarry:
    """Forget what was before."""
    return carry._replace(
        age=jnp.where(where, -1, carry.age),
        empty=carry.empty & ~where,
        ready=jnp.where(where, 0, carry.ready),
    )


def sample(
    plant: Numbers, start: Start | None, carry: ZonotopeCarry, now: Read, enclosures: int
) -> tuple[ZonotopeCarry, jax.Array, Found]:
    """Look at one sample: return (carry with the set after it, its magnitudes (n, N), one row of `Found`)."""
    alive, (n, q, N), p = carry.age >= 0, carry.G.shape, len(now.mid)
    dtype, g = carry.c.dtype, _Bounds(plant, carry)
    direct = jnp.sum(jnp.abs(plant.D) + plant.wide_D, 1) > 0
    driven = (
        now.known[None] | ~direct[:, None]
    )  # else what a perfect sensor shows depends on what nobody knows
    seen = jnp.isfinite(now.rad) & driven
    through = jnp.where(now.known[None], _map(plant.D, now.v), 0)
    sizes = jnp.abs(plant.D)
    loose = jnp.where(
        now.known[None],
        g.up * (_map(plant.wide_D + g.gamma * sizes, jnp.abs(now.v)) + _map(sizes, now.slip)),
        0,
    )
    mid, rad = jnp.where(seen, now.mid, 0), jnp.where(seen, now.rad, 0)
    one = lambda x, i: jax.lax.dynamic_index_in_dim(x, i, 0, keepdims=False)

    def says(i, c, G, r, size):
        """Return of output i: (C_i G, its value at the middle, how far it reaches, what rounding and
        intervals add to that, magnitudes).
        """
        row, wide = one(plant.C, i), one(plant.wide_C, i)
        P = summed(lambda a, x: a * x, row, G)
        value = summed(lambda a, x: a * x, row, c) + one(through, i)
        whole = (
            summed(lambda a, x: abs(a) * x, row, size)
            + jnp.abs(one(through, i))
            + jnp.abs(one(mid, i))
            + one(rad, i)
        )
        slack = g.up * (summed(lambda a, x: a * x, wide, size) + one(loose, i) + g.gamma * whole) + g.least
        return (
            P,
            value,
            g.up * (jnp.sum(jnp.abs(P), 0) + summed(lambda a, x: abs(a) * x, row, r)) + slack,
            slack,
            whole,
        )

    sized = lambda c, G, r: jnp.abs(c) + g.up * jnp.sum(jnp.abs(G), 1) + r
    first = before = (carry.c, carry.G, carry.r, sized(carry.c, carry.G, carry.r))
    known = carry.c, jnp.concatenate([carry.G, jnp.zeros((n, p, N), dtype)], 1), carry.r
    there, lost, whole = seen, jnp.zeros(N, bool), jnp.zeros(N, bool)
    if plant.free is not None:
        whole = plant.free.first & (carry.age == 0)  # a first state in bounds is the state itself
        known, there, lost = known_again(
            plant.free, _Bounds(plant, carry, p), known, first[3], (mid, rad, through, loose), seen, whole
        )
        before = (*known, sized(*known))

    def output(i, state):
        """Test output i against the set before this sample and as it is by now, then meet its strip."""
        (c, G, r), size, ratio, wrong = state
        P, value, reach, slack, whole = says(i, c, G, r, size)
        _, alone, reach_alone, *_ = says(i, *before)
        tested, s = one(there, i), one(rad, i)
        e = one(mid, i) - value
        for far, bound in ((e, reach + s), (one(mid, i) - alone, reach_alone + s)):
            ratio = jnp.where(tested, jnp.maximum(ratio, jnp.abs(far) / bound), ratio)
            wrong |= tested & (jnp.abs(far) > g.up * bound)
        L = jnp.sum(G * P[None], 1) / (jnp.sum(P * P, 0) + carry.weight * s * s + g.least)[None]
        L = stored(
            jnp.where(tested[None] & (jnp.abs(L) < g.steepest), L, 0)
        )  # one number for all its uses: then any will do
        far = jnp.abs(L)
        added = summed(lambda a, x: abs(a) * x, one(plant.C, i), r) + slack + g.gamma * whole
        r = g.up * (r + far * added[None] + g.gamma * size) + g.least
        G = G - L[:, None] * P[None]
        column = L * s[None]
        if plant.free is not None:  # of an output that is used up already: its error, L being 0
            column = column + jax.lax.dynamic_index_in_dim(G, q + i, 1, keepdims=False)
        G = jax.lax.dynamic_update_index_in_dim(G, column, q + i, 1)
        c = c + L * e[None]
        largest = sized(
            c, G, 2 * r
        )  # what is summed may be rounded otherwise than what is kept, by less than r
        return (c, G, r), largest, ratio, wrong

    nothing = known, before[3], jnp.zeros(N, dtype), jnp.zeros(N, bool)
    (c, G, r), size, ratio, wrong = jax.lax.fori_loop(0, p, output, nothing)
    bounded = jnp.all(size <= g.most, 0)
    looked = alive & jnp.any(there, 0)
    empty = carry.empty | (looked & wrong)
    status = jnp.where(empty, Status.FAULT, jnp.where(looked, Status.UNDECIDED, Status.MISSING)).astype(
        jnp.int8
    )
    margin = jnp.where(looked, 1 - ratio, jnp.nan)
    age = jnp.where(alive & bounded & ~lost, carry.age + 1, -1)
    whole &= age == 1
    ends = jnp.zeros((0, N), dtype), jnp.zeros((0, N), dtype)
    ready = jnp.where(now.whole, carry.ready + 1, 0)
    carry = carry._replace(age=age, empty=empty)
    if start is not None:
        begin = (age < 0) & (ready > len(carry.mid))
        filled = lambda begun, size: (
            *begun,
            jnp.where(begin[None], sized(*begun[:3]), size),
        )  # of others nothing changes
        fill = lambda state: filled(_begun(plant, start, carry, now, begin, *state[:4]), state[4])
        c, G, r, age, size = jax.lax.cond(jnp.any(begin), fill, lambda state: state, (c, G, r, age, size))
        carry = carry._replace(age=age)
    if enclosures:
        sets = (first, before), (c, G, r)
        ends = _enclosures(
            plant, says, sized, *sets, wrong, alive, age >= 0, whole, driven, g, p * (enclosures // 2)
        )
    later = lambda past, x: jnp.concatenate([past, x[None]])[1:]
    past = {name: later(getattr(carry, name), getattr(now, name)) for name in ("mid", "rad", "v", "slip")}
    ready = jnp.minimum(ready, len(carry.mid))
    return (
        carry._replace(c=c, G=G, r=r, ready=ready, **past),
        size,
        Found(status, margin, jnp.maximum(age, 0), *ends),
    )


class _Bounds:
    """What bounds of rounding are made of. Fields: gamma: share of all magnitudes that one result may be off
    by; up: factor that covers the rounding of a sum of non-negative numbers; least: more than what underflows
    cost; most, steepest: largest numbers, and gains.
    """

    def __init__(self, plant, carry, more=0):
        """more: terms that sums have beyond those of a step."""
        (n, m), (p, _), (_, q, _), dtype = plant.B.shape, plant.C.shape, carry.G.shape, carry.G.dtype
        wide = dtype == np.float64
        number = lambda x: np.asarray(x, dtype)
        self.gamma = rounding.product_error(n + m + 8 + more, dtype)[0]
        self.up = number(
            1 + 4 * (q + p + plant.W.shape[1] + 4 * (n + m) + 64 + more) * float(rounding.unit(dtype))
        )
        self.least = number(2.0**-500 if wide else 2.0**-46)
        self.most, self.steepest = _largest(dtype), number(2.0**60 if wide else 2.0**20)


def _map(M, X):
    """Return M X for M (r, n), X (n, N)."""
    if not len(X):
        return jnp.zeros((len(M), X.shape[1]), X.dtype)
    return summed(lambda column, row: column[:, None] * row[None], M, X, axes=(1, 0))


def _begun(plant, start, carry, now, begin, c, G, r, age):
    """Return (c, G, r, age), where it begins those of the set that the last samples alone allow."""
    (n, wide, N), h = G.shape, len(carry.mid)
    g = _Bounds(plant, carry, start.K.shape[1] + start.U.shape[1] + start.W.shape[1])
    join = lambda name: jnp.concatenate([getattr(carry, name), getattr(now, name)[None]]).reshape(-1, N)
    mid, rad, v, slip = (join(name) for name in ("mid", "rad", "v", "slip"))
    rad = jnp.where(begin[None], rad, 0)
    K, U = jnp.abs(start.K), jnp.abs(start.U)
    centre = _map(start.K, mid) + _map(start.U, v) + start.w[:, None]
    whole = (
        _map(K, jnp.abs(mid) + rad)
        + _map(U, jnp.abs(v))
        + (jnp.abs(start.w) + jnp.sum(jnp.abs(start.W), 1))[:, None]
    )
    loose = _map(start.wide_K, jnp.abs(mid) + rad) + _map(start.wide_U, jnp.abs(v)) + start.wide[:, None]
    off = g.up * (_map(U, slip) + g.gamma * whole + loose) + g.least
    columns = [start.K[:, :, None] * rad[None], jnp.broadcast_to(start.W[:, :, None], (*start.W.shape, N))]
    found, off, _ = _reduced(jnp.concatenate([jnp.zeros((n, wide, N), G.dtype), *columns], 1), off, wide, g)
    pick = lambda new, old: jnp.where(begin.reshape(*[1] * (new.ndim - 1), N), new, old)
    return pick(centre, c), pick(found, G), pick(off, r), jnp.where(begin, h + 1, age)


def step_of_time(plant: Numbers, carry: ZonotopeCarry, size: jax.Array, now: Read) -> ZonotopeCarry:
    """Move the set on by one sample, and put its smallest generators into a box. size (n, N): at least what
    each state is.
    """
    g, A, (c, G, r), v = _Bounds(plant, carry), jnp.abs(plant.A), carry[:3], jnp.abs(now.v)
    N, q = c.shape[-1], G.shape[1] - len(plant.C)
    off = (
        _map(plant.wide_A + g.gamma * A, size)
        + _map(plant.wide_B + g.gamma * jnp.abs(plant.B), v)
        + _map(jnp.abs(plant.B), now.slip)
    )
    lift = lambda x: x[:, None]
    r = g.up * (_map(A, r) + off + lift(plant.wide_w + g.gamma * jnp.abs(plant.w))) + g.least
    c = _map(plant.A, c) + _map(plant.B, now.v) + lift(plant.w)
    moved = summed(lambda column, x: column[:, None, None] * x[None], plant.A, G, axes=(1, 0))
    G = jnp.concatenate([moved, jnp.broadcast_to(plant.W[:, :, None], (*plant.W.shape, N))], 1)
    G, r, reach = _reduced(G, r, q, g)
    bounded = jnp.all(jnp.abs(c) + g.up * reach + r <= g.most, 0)
    needed = jnp.any(plant.B != 0) | jnp.any(plant.wide_B != 0)
    lost = ~bounded | (needed & ~now.known)
    return carry._replace(c=c, G=G, r=r, age=jnp.where(lost, -1, carry.age))


def _reduced(G, r, q, g):
    """Return (q generators, r, sum of their sizes) of a set that holds the one of G (n, Q, N) and r.

    The smallest are in a box, if it has more than q.
    """
    n, Q, N = G.shape
    bits, below = (np.int64 if G.dtype == np.float64 else np.int32), power(Q) - 1
    sizes = list(
        jnp.abs(G)
    )  # row by row: a reduction over few rows is no vector code, and cost a quarter of a step
    key = jnp.maximum(
        reduce(jnp.add, sizes) - reduce(jnp.maximum, sizes), 0
    )  # for the order alone; its last digits count the columns
    key = (jax.lax.bitcast_convert_type(key, bits) & bits(~below)) | jnp.arange(Q, dtype=bits)[:, None]
    S = jnp.take_along_axis(G, (jnp.sort(key, 0) & bits(below))[None], 1)
    rest, some, kept = S[:, : Q - q], S[:, Q - q : Q - q + n], S[:, Q - q + n :]
    boxed, few, many = (jnp.sum(jnp.abs(x), 1) for x in (rest, some, kept))
    free = jnp.all(some == 0, (0, 1)) & jnp.any(r > 2.0**-36 * many, 0)  # r moved as a box would grow
    enough = jnp.all(boxed == 0, 0) & ~free
    box = g.up * (boxed + few + r) + g.least
    diagonal = jnp.eye(n, dtype=G.dtype)[:, :, None] * box[None]
    reach = jnp.where(enough[None], few, box) + many
    return (
        jnp.concatenate([jnp.where(enough[None, None], some, diagonal), kept], 1),
        jnp.where(enough[None], r, 0),
        reach,
    )


def _enclosures(plant, says, sized, before, after, wrong, tested, there, whole, driven, g, p):
    """Return the ends (2 n, N) of the states and (4 p, N) of the p outputs.

    before: the set, and what unknown inputs leave of it. driven (p, N): the outputs that no missing input
    acts on.
    """
    free, (state, before) = plant.free, before
    hull = lambda c, G, r, *_: _outward(c, jnp.sum(jnp.abs(G), 1) + r, g)
    inf = lambda x, where: jnp.where(where[None], x, jnp.inf)
    prior, now = inf(hull(*state), tested), inf(hull(*after), there)
    if free is not None:
        blind = lambda x, some: jnp.where(
            jnp.tile(some, len(x) // len(some))[:, None] & ~whole[None], jnp.inf, x
        )
        prior, now = blind(prior, free.before), blind(now, free.after)
    refuted = (wrong & tested)[None]
    states = jnp.where(refuted, prior, jnp.minimum(prior, now))
    if not p:
        return states, states[:0]

    def shown(values, where):
        value, reach = values
        y0 = plant.y0[:, None]
        ends = _outward(value + y0, reach + 4 * g.gamma * (jnp.abs(value) + jnp.abs(y0)), g)
        return inf(jnp.where(jnp.concatenate([driven, driven]), ends, jnp.inf), where)

    rows = jnp.arange(p)
    of = lambda sets: jax.lax.map(lambda i: says(i, *sets)[1:3], rows)
    first = shown(of(before), tested)
    if free is not None:
        first = blind(first, free.shown)
    second = shown(of((*after, sized(*after))), there)
    return states, jnp.concatenate([first, jnp.where(refuted, first, jnp.minimum(first, second))])


def _outward(middle, reach, g):
    """Return ends -lo, hi, one above the other."""
    reach = g.up * (reach + g.gamma * jnp.abs(middle)) + g.least
    return jnp.concatenate([reach - middle, reach + middle])


def _largest(dtype):
    """Return the largest number that a set may speak of."""
    return np.asarray(2.0**300 if dtype == np.float64 else 2.0**40, dtype)
