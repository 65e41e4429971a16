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

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.estimation.free_inputs import Free, Reading, Sets, Spanned, known_again, times
from jaxbound.estimation.piece import Piece
from jaxbound.estimation.set_rounding import SetRounding, set_rounding
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.unrolled import stored, summed


class Numbers(NamedTuple):
    """A model in floats.

    Fields: A (n, n), B (n, m), C (p, n), D (p, m) and wide_A, .., by which entries may be more or less; W (n,
    g) columns of disturbances, w (n,) their middle, wide_w (n,) by which these may be off; u0 (m,), wide_u0;
    tolerance, noise, y0 (p,). free: unknown inputs, or None.
    """

    A: Array
    wide_A: Array
    B: Array
    wide_B: Array
    C: Array
    wide_C: Array
    D: Array
    wide_D: Array
    W: Array
    w: Array
    wide_w: Array
    u0: Array
    wide_u0: Array
    tolerance: Array
    noise: Array
    y0: Array
    free: Free | None = None


class Start(NamedTuple):
    """The state x of the newest sample from the last h + 1 alone: x = K m + U v + w + W xi - K s delta.

    Fields: K (n, (h+1) p), U (n, (h+1) m), w (n,), W (n, h g), the oldest sample first; wide_K, wide_U, wide
    (n,): by which x may be off for each |m| + s and |v|, and beside.
    """

    K: Array
    U: Array
    w: Array
    W: Array
    wide_K: Array
    wide_U: Array
    wide: Array


class ZonotopeCarry(NamedTuple):
    """The sets that go on from sample to sample, before a sample is looked at, and the last samples.

    Fields: c (n, N), G (n, q, N), r (n, N); age (N,): samples that the set rests on, -1 where there is none;
    empty (N,): contradicted; mid, rad (h, p, N), v, slip (h, m, N): the last samples; ready (N,): how many of
    these are whole and follow each other. weight (N,).
    """

    c: Array
    G: Array
    r: Array
    age: Array
    empty: Array
    mid: Array
    rad: Array
    v: Array
    slip: Array
    ready: Array
    weight: Array


class Found(NamedTuple):
    """The verdicts and sets of T samples.

    Fields: status (T, N) int8; margin (T, N); age (T, N) int32, samples that the set rests on, 0 without one;
    states (T, 2 n, N), ends -lo, hi of the states; outputs (T, 4 p, N), of what perfect sensors would show:
    as the samples before allow, then with this one. Those that were not asked for are empty. Of one sample
    all are without their first axis.
    """

    status: Array
    margin: Array
    age: Array
    states: Array
    outputs: Array


class _OutputStrip(NamedTuple):
    """The strip of an output, |e - C (x - c)| <= s where it is tested, and the place of its generator."""

    output: jax.Array
    place: jax.Array
    e: jax.Array
    s: jax.Array
    tested: jax.Array


class _Shown(NamedTuple):
    """One output of a set.

    Fields: P (q, N): C_i G; value (N,): at the middle; reach: how far it goes from there; slack: the part of
    rounding and intervals in that; whole: magnitudes.
    """

    P: Array
    value: Array
    reach: Array
    slack: Array
    whole: Array


def unknown(sizes: tuple[int, int, int, int, int], weight: np.ndarray) -> ZonotopeCarry:
    """Return the carry of recordings before the first sample, on the host.

    Args:
        sizes: n, q, p, m, h. weight (N,): in the dtype of all.
    """
    n, q, p, m, h = sizes
    N = len(weight)

    def zero(*shape: int) -> np.ndarray:
        return np.zeros((*shape, N), weight.dtype)

    return ZonotopeCarry(
        c=zero(n),
        G=zero(n, q),
        r=zero(n),
        age=np.full(N, -1, np.int32),
        empty=np.zeros(N, bool),
        mid=zero(h, p),
        rad=zero(h, p),
        v=zero(h, m),
        slip=zero(h, m),
        ready=np.zeros(N, np.int32),
        weight=weight,
    )


@kernel(static_argnames=("lanes", "enclosures"), compiler_options={"xla_cpu_multi_thread_eigen": False})
def follow_lanes(
    plant: Numbers,
    start: Start | None,
    carry: ZonotopeCarry,
    samples: Piece,
    stop: int,
    lanes: int,
    enclosures: bool,
    restart: jax.Array | bool,
) -> tuple[ZonotopeCarry, Found]:
    """Follow N / lanes recordings over the first `stop` of these samples.

    Args:
        start: how the state is found from samples alone, or None: where it is lost it stays so.
        lanes: weights of a recording, one behind the other. enclosures: whether states and outputs are
            enclosed: under XLA always, in one program for every verb, which takes no longer.
        restart: whether the sample after a contradiction begins anew; else FAULT stays.

    Returns:
        (carry, Found); what they have of other samples means nothing.
    """
    # each weight is a recording of its own: one kernel, whatever their number
    each = jax.tree.map(lambda x: jnp.repeat(x, lanes, -1), samples)

    def step(k: jax.Array, state: tuple[ZonotopeCarry, Found]) -> tuple[ZonotopeCarry, Found]:
        carry, rows = state
        now = jax.tree.map(lambda x: _row(x, k), each)
        carry, size, row = _sample(plant, start, _begun_anew(carry, now.fresh), now, enclosures)
        refuted = jnp.any(carry.empty.reshape(-1, lanes), 1)  # by any of its sets
        # the FAULT of this sample is kept; what is carried on knows nothing
        carry = _begun_anew(carry, restart & jnp.repeat(refuted, lanes))
        carry = _step_of_time(plant, carry, size, now)
        return carry, jax.tree.map(
            lambda old, new: jax.lax.dynamic_update_index_in_dim(old, new, k, 0), rows, row
        )

    carry, rows = jax.lax.fori_loop(0, stop, step, (carry, _nothing_found(each, plant, enclosures)))
    return carry, rows


def _nothing_found(known: Piece, plant: Numbers, enclosures: bool) -> Found:
    """Return the Found of samples before any is looked at."""
    (T, p, N), dtype = known.mid.shape, known.mid.dtype

    def zero(count: int) -> jax.Array:
        return jnp.zeros((T, count * enclosures, N), dtype)

    status, age = jnp.zeros((T, N), jnp.int8), jnp.zeros((T, N), jnp.int32)
    return Found(status, jnp.zeros((T, N), dtype), age, zero(2 * len(plant.A)), zero(4 * p))


def _begun_anew(carry: ZonotopeCarry, where: Array) -> ZonotopeCarry:
    """Forget the samples and sets before."""
    return carry._replace(
        age=jnp.where(where, -1, carry.age),
        empty=carry.empty & ~where,
        ready=jnp.where(where, 0, carry.ready),
    )


def _sample(
    plant: Numbers, start: Start | None, carry: ZonotopeCarry, now: Piece, enclosures: bool
) -> tuple[ZonotopeCarry, jax.Array, Found]:
    """Look at one sample: return (carry with the set after it, its magnitudes (n, N), one row of `Found`)."""
    alive, (n, q, N), p = carry.age >= 0, carry.G.shape, len(now.mid)
    dtype, g = carry.c.dtype, _rounding(plant, carry.G)
    outputs = _outputs(plant, now, g)
    first = before = _sized(g, carry.c, carry.G, carry.r)
    prior: Spanned = carry.c, jnp.concatenate([carry.G, jnp.zeros((n, p, N), dtype)], 1), carry.r
    there: Array = outputs.seen
    lost: Array = jnp.zeros(N, bool)
    whole: Array = jnp.zeros(N, bool)
    if plant.free is not None:
        whole = plant.free.first & (carry.age == 0)  # a first state in bounds is the state itself
        prior, there, lost = known_again(
            plant.free, _rounding(plant, carry.G, p), Sets(*prior, first.size), outputs, whole
        )
        before = _sized(g, *prior)

    def meet(i: jax.Array, state: tuple[Sets, jax.Array, jax.Array]) -> tuple[Sets, jax.Array, jax.Array]:
        """Test output i against the set before this sample and as it is by now, then meet its strip."""
        sets, ratio, wrong = state
        shown = _shown(plant, g, outputs, i, sets)
        alone = _shown(plant, g, outputs, i, before)
        tested, s = _row(there, i), _row(outputs.rad, i)
        # outputs one after the other: a later one is compared with what earlier ones left
        e = _row(outputs.mid, i) - shown.value
        # either set holds the state: the one that earlier outputs narrowed, and the one before the sample
        for far, bound in ((e, shown.reach + s), (_row(outputs.mid, i) - alone.value, alone.reach + s)):
            ratio = jnp.where(tested, jnp.maximum(ratio, jnp.abs(far) / bound), ratio)
            wrong |= tested & (jnp.abs(far) > g.up * bound)
        return _met(plant, g, carry.weight, sets, shown, _OutputStrip(i, q + i, e, s, tested)), ratio, wrong

    begin = Sets(*prior, before.size), jnp.zeros(N, dtype), now.refuted
    after, ratio, wrong = jax.lax.fori_loop(0, p, meet, begin)
    bounded = jnp.all(after.size <= g.most, 0)
    looked = alive & jnp.any(there, 0)
    empty = carry.empty | (looked & wrong)
    status = jnp.where(empty, Status.FAULT, jnp.where(looked, Status.UNDECIDED, Status.MISSING))
    status = status.astype(jnp.int8)
    # of the worst output: what all of them say together would take a linear program
    margin = jnp.where(looked, 1 - ratio, jnp.nan)
    age = jnp.where(alive & bounded & ~lost, carry.age + 1, -1)
    whole &= age == 1
    ends = jnp.zeros((0, N), dtype), jnp.zeros((0, N), dtype)
    past = carry.mid, carry.rad, carry.v, carry.slip
    mid, rad, v, slip = recent = [jnp.concatenate([x, new[None]]) for x, new in zip(past, now, strict=False)]
    # a beginning needs samples in a row that lack nothing
    ready = jnp.where(now.known & jnp.all(jnp.isfinite(now.rad), 0), carry.ready + 1, 0)
    if start is not None:
        begins = (age < 0) & (ready > len(carry.mid))
        after = _begun_where(plant, start, recent, g, begins, after)
        age = jnp.where(begins, len(carry.mid) + 1, age)
    if enclosures:
        sets = _Around(first, before, after, refuted=wrong, tested=alive, there=age >= 0, whole=whole)
        ends = _enclosures(plant, g, outputs, sets)
    ready = jnp.minimum(ready, len(carry.mid))
    return (
        ZonotopeCarry(
            *(after.c, after.G, after.r, age, empty, mid[1:], rad[1:], v[1:], slip[1:], ready, carry.weight)
        ),
        after.size,
        Found(status, margin, jnp.maximum(age, 0), *ends),
    )


def _outputs(plant: Numbers, now: Piece, g: SetRounding) -> Reading:
    """Return one sample of the outputs."""
    direct = jnp.sum(jnp.abs(plant.D) + plant.wide_D, 1) > 0
    # else what a perfect sensor shows depends on an input that nobody knows
    driven = now.known[None] | ~direct[:, None]
    seen = jnp.isfinite(now.rad) & driven
    through = jnp.where(now.known[None], _map(plant.D, now.v), 0)
    sizes = jnp.abs(plant.D)
    loose = jnp.where(
        now.known[None],
        g.up * (_map(plant.wide_D + g.gamma * sizes, jnp.abs(now.v)) + _map(sizes + plant.wide_D, now.slip)),
        0,
    )
    return Reading(driven, seen, through, loose, jnp.where(seen, now.mid, 0), jnp.where(seen, now.rad, 0))


def _sized(g: SetRounding, c: Array, G: Array, r: Array) -> Sets:
    """Return sets with at least the size of their states."""
    return Sets(c, G, r, jnp.abs(c) + g.up * jnp.sum(jnp.abs(G), 1) + r)


def _row(x: Array, i: jax.Array) -> jax.Array:
    """Return row i of an array."""
    row: jax.Array = jax.lax.dynamic_index_in_dim(x, i, 0, keepdims=False)
    return row


def _shown(plant: Numbers, g: SetRounding, outputs: Reading, i: jax.Array, sets: Sets) -> _Shown:
    """Return output i of sets."""
    row, wide = _row(plant.C, i), _row(plant.wide_C, i)
    P = summed(_product, row, sets.G)
    value = summed(_product, row, sets.c) + _row(outputs.through, i)
    whole = (
        summed(_size_times, row, sets.size)
        + jnp.abs(_row(outputs.through, i))
        + jnp.abs(_row(outputs.mid, i))
        + _row(outputs.rad, i)
    )
    slack = g.up * (summed(_product, wide, sets.size) + _row(outputs.loose, i) + g.gamma * whole) + g.least
    reach = g.up * (jnp.sum(jnp.abs(P), 0) + summed(_size_times, row, sets.r)) + slack
    return _Shown(P, value, reach, slack, whole)


def _product(a: jax.Array, x: jax.Array) -> jax.Array:
    """Return a x."""
    return a * x


def _size_times(a: jax.Array, x: jax.Array) -> jax.Array:
    """Return |a| x."""
    return abs(a) * x


def _met(
    plant: Numbers,
    g: SetRounding,
    weight: Array,
    sets: Sets,
    shown: _Shown,
    strip: _OutputStrip,
) -> Sets:
    """Return sets met with the strip of an output."""
    e, s, tested, place = strip.e, strip.s, strip.tested, strip.place
    P = shown.P
    # the Kalman gain, with generators in place of a covariance; least: no division by 0
    L = jnp.sum(sets.G * P[None], 1) / (jnp.sum(P * P, 0) + weight * s * s + g.least)[None]
    # one number for all its uses: then any will do
    L = stored(jnp.where(tested[None] & (jnp.abs(L) < g.steepest), L, 0))
    far = jnp.abs(L)
    added = summed(_size_times, _row(plant.C, strip.output), sets.r) + shown.slack + g.gamma * shown.whole
    r = g.up * (sets.r + far * added[None] + g.gamma * sets.size) + g.least
    # (I - L C) G, and L s as one generator more
    G = sets.G - L[:, None] * P[None]
    column = L * s[None]
    if plant.free is not None:  # of an output that is used up already: its error, L being 0
        column = column + jax.lax.dynamic_index_in_dim(G, place, 1, keepdims=False)
    G = jax.lax.dynamic_update_index_in_dim(G, column, place, 1)
    c = sets.c + L * e[None]
    # what is summed may be rounded otherwise than what is kept, by less than r
    return Sets(c, G, r, _sized(g, c, G, 2 * r).size)


def _begun_where(
    plant: Numbers,
    start: Start,
    recent: Sequence[jax.Array],
    g: SetRounding,
    begins: jax.Array,
    sets: Sets,
) -> Sets:
    """Return the sets, where it begins those that the last samples alone allow, with as many generators.

    Args:
        recent: mid, rad, v, slip of the last samples, the oldest first.
    """

    def begun(sets: Sets) -> Sets:
        mid, rad, v, slip = (x.reshape(-1, x.shape[-1]) for x in recent)
        rad = jnp.where(begins[None], rad, 0)
        n, wide, N = sets.G.shape
        h = _rounding(plant, sets.G, start.K.shape[1] + start.U.shape[1] + start.W.shape[1])
        K, U, size = jnp.abs(start.K), jnp.abs(start.U), jnp.abs(mid) + rad
        centre = _map(start.K, mid) + _map(start.U, v) + start.w[:, None]
        drawn = (jnp.abs(start.w) + jnp.sum(jnp.abs(start.W), 1))[:, None]
        whole = _map(K, size) + _map(U, jnp.abs(v)) + drawn
        loose = _map(start.wide_K, size) + _map(start.wide_U, jnp.abs(v)) + start.wide[:, None]
        off = h.up * (_map(U + start.wide_U, slip) + h.gamma * whole + loose) + h.least
        columns = [
            start.K[:, :, None] * rad[None],
            jnp.broadcast_to(start.W[:, :, None], (*start.W.shape, N)),
        ]
        generators = jnp.concatenate([jnp.zeros((n, wide, N), off.dtype), *columns], 1)
        G, off, _ = _reduced(generators, off, wide, h)
        new = _sized(g, centre, G, off)
        return Sets(*(jnp.where(begins, x, y) for x, y in zip(new, sets, strict=True)))

    after: Sets = jax.lax.cond(jnp.any(begins), begun, lambda sets: sets, sets)
    return after


def _rounding(plant: Numbers, G: Array, more: int = 0) -> SetRounding:
    """Return the factors for a plant and its sets. more: terms that sums have beyond those of a step."""
    (n, m), (p, _), (_, q, _) = plant.B.shape, plant.C.shape, G.shape
    terms = q + p + plant.W.shape[1] + 4 * (n + m) + 64 + more
    return set_rounding(n + m + 8 + more, terms, G.dtype)


def _map(M: Array, X: Array) -> jax.Array:
    """Return M X for M (r, n), X (n, N) or (n, q, N)."""
    if not len(X):
        return jnp.zeros((len(M), X.shape[1]), X.dtype)
    return times(M[..., None], X)


def _step_of_time(plant: Numbers, carry: ZonotopeCarry, size: jax.Array, now: Piece) -> ZonotopeCarry:
    """Move the set on by one sample, and put its smallest generators into a box.

    Args:
        size (n, N): at least the size of each state.
    """
    g, A, (c, G, r), v = _rounding(plant, carry.G), jnp.abs(plant.A), carry[:3], jnp.abs(now.v)
    N, q = c.shape[-1], G.shape[1] - len(plant.C)
    off = (
        _map(plant.wide_A + g.gamma * A, size)
        + _map(plant.wide_B + g.gamma * jnp.abs(plant.B), v)
        + _map(jnp.abs(plant.B) + plant.wide_B, now.slip)
    )
    # a box is moved by |A|; numbers of the model may be off, and inputs rounded
    r = g.up * (_map(A, r) + off + (plant.wide_w + g.gamma * jnp.abs(plant.w))[:, None]) + g.least
    c = _map(plant.A, c) + _map(plant.B, now.v) + plant.w[:, None]
    moved = _map(plant.A, G)
    G = jnp.concatenate([moved, jnp.broadcast_to(plant.W[:, :, None], (*plant.W.shape, N))], 1)
    # as many generators as before: kernels have one shape
    G, r, reach = _reduced(G, r, q, g)
    bounded = jnp.all(jnp.abs(c) + g.up * reach + r <= g.most, 0)
    # a missing input that moves no state is no loss
    needed = jnp.any(plant.B != 0) | jnp.any(plant.wide_B != 0)
    lost = ~bounded | (needed & ~now.known)
    return carry._replace(c=c, G=G, r=r, age=jnp.where(lost, -1, carry.age))


def _reduced(G: jax.Array, r: jax.Array, q: int, g: SetRounding) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (q generators, r, sum of their sizes) of a set that holds the one of G (n, Q, N) and r.

    The smallest are in a box, if it has more than q.
    """
    n, Q, N = G.shape
    # row by row: a reduction over few rows is no vector code, and cost a quarter of a step
    sizes = list(jnp.abs(G))
    length = jnp.maximum(reduce(jnp.add, sizes) - reduce(jnp.maximum, sizes), 0)
    # floats >= 0 are ordered as their bits are; their last digits count the generators: one sort, no ties
    bits, below = np.dtype(f"i{G.dtype.itemsize}").type, power(Q) - 1
    key = jax.lax.bitcast_convert_type(length, bits) & bits(~below)
    order = jnp.sort(key | jnp.arange(Q, dtype=bits)[:, None], 0) & bits(below)
    S = jnp.take_along_axis(G, order[None], 1)  # by their 1-norm less the largest entry
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


class _Around(NamedTuple):
    """The sets around one sample, and which of them hold.

    Fields: first: before it; before: without unknown inputs; after: with it; refuted, tested, there (N,):
    whether it contradicts the set before it, whether there is one, and one after it; whole (N,): whether the
    set before it is of the state itself.
    """

    first: Sets
    before: Sets
    after: Sets
    refuted: Array
    tested: Array
    there: Array
    whole: Array


def _enclosures(
    plant: Numbers, g: SetRounding, outputs: Reading, sets: _Around
) -> tuple[jax.Array, jax.Array]:
    """Return the ends (2 n, N) of the states and (4 p, N) of the outputs: infinite where nothing is known, or
    where unknown inputs moved them, but of a set of the state itself.
    """
    tested, there, free = sets.tested[None], sets.there[None], plant.free
    known, remembered, seen = tested, there, tested
    if free is not None:
        moved = (free.before, tested), (free.after, there), (free.shown, tested)
        known, remembered, seen = (x & (~at[:, None] | sets.whole[None]) for at, x in moved)
    refuted = (sets.refuted & sets.tested)[None]
    prior = _ends(g, *_reach_of_states(sets.first), known)
    now = _ends(g, *_reach_of_states(sets.after), remembered)
    first = _ends(g, *_outputs_of(plant, g, outputs, sets.before), seen & outputs.driven)
    after = _sized(g, *sets.after[:3])
    second = _ends(g, *_outputs_of(plant, g, outputs, after), there & outputs.driven)
    # behind a contradiction nothing is left: shown is what was allowed before it
    states = jnp.where(refuted, prior, jnp.minimum(prior, now))
    return states, jnp.concatenate([first, jnp.where(refuted, first, jnp.minimum(first, second))])


def _reach_of_states(sets: Sets) -> tuple[Array, Array]:
    """Return the middles of the states of sets, and how far they reach."""
    return sets.c, jnp.sum(jnp.abs(sets.G), 1) + sets.r


def _outputs_of(plant: Numbers, g: SetRounding, outputs: Reading, sets: Sets) -> tuple[Array, Array]:
    """Return the outputs of sets, as perfect sensors would show them, and how far they reach."""

    def value_and_reach(i: jax.Array) -> tuple[Array, Array]:
        shown = _shown(plant, g, outputs, i, sets)
        return shown.value, shown.reach

    value, reach = jax.lax.map(value_and_reach, jnp.arange(len(plant.C)))
    y0 = plant.y0[:, None]
    return value + y0, reach + 4 * g.gamma * (jnp.abs(value) + jnp.abs(y0))


def _ends(g: SetRounding, middle: Array, reach: Array, known: Array) -> jax.Array:
    """Return ends -lo, hi, one above the other, that are infinite where nothing is known."""
    reach = g.up * (reach + g.gamma * jnp.abs(middle)) + g.least
    ends = reach - middle, reach + middle
    return jnp.concatenate([jnp.where(known, end, jnp.inf) for end in ends])
