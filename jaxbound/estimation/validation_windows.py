"""Sliding windows of data validation: one loop over time, all recordings side by side on the last axis.

A window holds s + 1 samples. It starts from the box of the window before, moved on by the model; the newest
samples are tested against it; what does not fit is left out, here and in the windows to come, and what the
box implies stands in for it.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import most, stored
from jaxbound.sets.linear_systems.ends import added, interval_of, negative, none, product, subtracted, total
from jaxbound.sets.linear_systems.fixed_systems import solutions
from jaxbound.sets.linear_systems.hull import tighten

__all__ = ["Carry", "Said", "begun", "said", "slide", "weighted"]

STEPS = 20
"""Exchanges at most for one bound of the joint method, beside six for each unknown."""


class Carry(NamedTuple):
    """The states and samples that windows of N recordings hand on.

    Fields: X (2, (s+1) n, N) ends that hold the states of the next window. gone (s, p, N): its samples but
    the newest that are left out.
    moved: these samples, ends (2, s, p, N), if any may have been moved; else None.
    """

    X: jax.Array
    gone: jax.Array
    moved: jax.Array | None


class Said(NamedTuple):
    """The signals of a model as samples show them.

    Fields: absent (T, p, N); ends (2, T, ., N) of C x, H u + d, B
    u + w, and D u + y0.
    """

    absent: jax.Array
    seen: jax.Array
    pushed: jax.Array
    drive: jax.Array
    through: jax.Array


@kernel
def said(plant: Mapping[str, jax.Array], u: jax.Array, y: jax.Array, error: jax.Array) -> Said:
    """Return the signals that T samples show.

    Args:
        plant: ends of A, B, C, D, w, u0, y0, factor, perhaps H, d (see `IntervalSystem`); factor: 1 / (1 +
            theta).
        u: ends (2, T, m, N). y, error: (T, p, N), see `sensor.largest_error`.
    """
    absent = jnp.isnan(y)
    lift = lambda name: plant[name][:, None, :, None]
    v = subtracted(u, lift("u0"))
    wide = lambda x: jnp.broadcast_to(x, (2, u.shape[1], x.shape[2], u.shape[3]))
    nothing = jnp.zeros((2, 1, 1, 1), y.dtype)
    on = lambda name: (
        total(product(plant[name][:, None, ..., None], v[:, :, None]), axis=3) if u.shape[2] else nothing
    )
    through = on("D")
    point = jnp.where(absent, 0, y)[None] * jnp.asarray([-1, 1], y.dtype)[:, None, None, None]
    seen = product(added(subtracted(point, lift("y0")), error[None]), lift("factor"))
    drive = added(on("B"), lift("w"))
    pushed = added(on("H"), lift("d")) if "H" in plant else drive
    return Said(
        absent,
        *stored((subtracted(seen, through), wide(pushed), wide(drive), wide(added(through, lift("y0"))))),
    )


@kernel(static_argnames=("s", "n", "method", "centre"))
def begun(
    plant: Mapping[str, jax.Array],
    systems: Any,
    known: Said,
    start: jax.Array | None,
    s: int,
    n: int,
    method: str,
    centre: bool,
) -> Carry:
    """Return the Carry before the first window, of what s + 1 samples say.

    Args:
        systems: for "joint" without a start the first window's rows as one system, perhaps without the newest
            samples.
        start: ends (2, n, N) that hold the first state; None: it comes from the first window.
    """
    if start is not None:
        grow = lambda x, drive: (_predict(plant, x, drive), x)
        last, before = jax.lax.scan(grow, start, jnp.moveaxis(known.drive[:, :s], 1, 0))
        X = jnp.concatenate([_rows(jnp.moveaxis(before, 0, 1)), last], 1)
    elif method == "joint":
        right = jnp.concatenate([_rows(negative(known.pushed[:, :s])), _rows(known.seen)], 1)
        X = solutions(systems, interval_of(right[:, : systems.C.shape[2]]))[:, 0]
    else:
        X = jnp.full((2, (s + 1) * n, known.seen.shape[-1]), jnp.inf, known.seen.dtype)
    return Carry(X, known.absent[:s], known.seen[:, :s] if centre else None)


@kernel(static_argnames=("s", "method", "centre"))
def slide(
    plant: Mapping[str, jax.Array],
    M: jax.Array,
    systems: Any,
    known: Said,
    weight: jax.Array | None,
    carry: Carry,
    stop: int,
    s: int,
    method: str,
    centre: bool,
) -> tuple[Carry, jax.Array, jax.Array]:
    """Validate N recordings, the windows that end at samples s, s + 1, .., stop - 1.

    Args:
        plant: as for `said`. M: ends (2, r, (s+1) n, 1), see `intervals.stacked`. systems: the square systems
            of M for "sequential".
        known: what `said` returned for T samples. weight: None or ends (2, T, n, N) that multiply the columns
            of C.
        carry: from `begun`, or what this returned for the samples up to the first s of these, to go on from
            there.
        centre: whether a faulty sample is moved to the middle of what it should have shown, and taken for
            sound: nothing is proved then.

    Returns:
        (carry, found, blamed): ends found (T, 2, n + 3 p, N) of states, outputs, residuals and corrected
        samples; blamed (T, p + 1, N)
        bool: the faulty sensors, and whether the samples contradict the model. Infinite and False before the
            first window and from stop on.
    """
    n, p, (T, _, N) = plant["A"].shape[1], plant["C"].shape[1], known.absent.shape

    def show(x, first):
        """Enclose C x for the states x (2, j, n, N) of samples first, first + 1, .."""
        if weight is not None:
            x = stored(product(x, _part(weight, first, x.shape[1])))
        return stored(total(product(plant["C"][:, None, ..., None], x[:, :, None]), axis=3))

    def window(k, state):
        (X, gone, moved), found, blamed = state
        newest = _part(known.seen, k, 1)
        samples = jnp.concatenate([moved, newest], 1) if centre else _part(known.seen, k - s, s + 1)
        gone = jnp.concatenate([gone, _part(known.absent, k, 1, 0)])
        implied = show(X.reshape(2, s + 1, n, N), k - s)
        residual = stored(subtracted(newest[:, 0], implied[:, s]))
        alone = ((residual[0] < 0) | (residual[1] < 0)) & ~gone[s]
        gone = gone.at[s].set(gone[s] | alone)
        h = stored(
            jnp.concatenate(
                [_rows(negative(_part(known.pushed, k - s, s))), _rows(jnp.where(gone, implied, samples))], 1
            )
        )
        if method == "joint":
            rows = M if weight is None else weighted(M, _part(weight, k - s, s + 1), p)
            X, together, unclear = _joint(rows, p, h, X)
        else:
            X, together, unclear = _sequential(systems, p, h, X)
        faulty = alone | (together & ~gone[s])
        gone = gone.at[s].set(gone[s] | faulty | unclear[None])
        output = show(X[:, None, s * n :], k)[:, 0]
        corrected = jnp.where(gone[s], output, jnp.minimum(output, newest[:, 0]))
        corrected = jnp.where(none(corrected), output, corrected)
        if centre:
            shift = jnp.where(faulty, _mid(output) - _mid(newest[:, 0]), 0)
            gone = gone.at[s].set(gone[s] & ~faulty)
            moved = jnp.concatenate([samples[:, 1:s], newest + jnp.stack([-shift, shift])[:, None]], 1)
        through = known.through[:, k]
        out = stored(
            jnp.concatenate([X[:, s * n :], added(output, through), residual, added(corrected, through)], 1)
        )
        wrong = jnp.concatenate([faulty, (jnp.any(faulty, 0) | unclear)[None]])
        X = jnp.concatenate([X[:, n:], _predict(plant, X[:, s * n :], known.drive[:, k])], 1)
        return Carry(X, gone[1:], moved), found.at[k].set(out), blamed.at[k].set(wrong)

    found = jnp.full((T, 2, n + 3 * p, N), jnp.inf, known.seen.dtype)
    return jax.lax.fori_loop(s, stop, window, (carry, found, jnp.zeros((T, p + 1, N), bool)))


def weighted(M: jax.Array, weight: jax.Array, p: int) -> jax.Array:
    """Multiply the columns of the C rows of M, ends (2, r, (s+1) n, 1), the last p (s+1), by weight (2, s+1,
    n, N).
    """
    _, s, _, N = weight.shape
    moves = M[:, : -p * s]
    moves = jnp.broadcast_to(moves, (*moves.shape[:3], N))
    return stored(jnp.concatenate([moves, product(M[:, -p * s :], weight.reshape(2, 1, -1, N))], 1))


def _transform(A, x):
    """Enclose A x for ends A (2, r, n, N or 1), x (2, n, N)."""
    return stored(total(product(A, x[:, None]), axis=2))


def _predict(plant, x, drive):
    return stored(added(_transform(plant["A"][..., None], x), drive))


def _rows(x):
    return x.reshape(2, -1, x.shape[-1])


def _part(x, first, count, axis=1):
    return jax.lax.dynamic_slice_in_dim(x, first, count, axis)


def _mid(x):
    return 0.5 * x[1] - 0.5 * x[0]


def _joint(M, p, h, X):
    """Tighten the box by all rows. Where they contradict each other, by fewer of the newest p rows.

    All but one are tried, then none, then (p > 2) one alone. To blame is a row without which alone the
    contradiction ends, and one that alone contradicts the older rows and the box, if these agree. Returns the
    states, who is blamed, and where there is a contradiction but nobody to blame.
    """
    r, (_, n, N) = M.shape[1], X.shape
    eye = np.eye(p, dtype=bool)
    kept = jnp.asarray(
        np.concatenate([np.ones((1, p), bool), ~eye, np.zeros((1, p), bool), eye if p > 2 else eye[:0]])
    )
    implied = _transform(M[:, r - p :], X)  # what the box says of the newest rows adds nothing
    newest = h[:, r - p :]

    def more(carry):
        i, contradiction, *_ = carry
        return (i == 0) | ((i < kept.shape[0]) & jnp.any(contradiction))

    def attempt(carry):
        i, contradiction, fits, found = carry
        rows = jnp.concatenate([h[:, : r - p], jnp.where(kept[i][:, None], newest, implied)], 1)
        tight = tighten(interval_of(M), interval_of(rows), interval_of(X), STEPS + 6 * n)
        box = jnp.stack([-tight.lo, tight.hi])
        fit = ~jnp.any(none(box), 0)
        found = jnp.where(fit & ((i == 0) | (contradiction & (i <= p))), box, found)
        return i + 1, jnp.where(i == 0, ~fit, contradiction), fits.at[i].set(fit), found

    start = 0, jnp.zeros(N, bool), jnp.zeros((kept.shape[0], N), bool), X
    _, contradiction, fits, found = jax.lax.while_loop(more, attempt, start)
    without, last = fits[1 : p + 1], fits[p + 1]
    alone = fits[p + 2 :] if p > 2 else without[::-1] if p == 2 else fits[:1]
    single = jnp.sum(without, 0) == 1
    blamed = (contradiction & last)[None] & ((single[None] & without) | ~alone)
    return jnp.where(contradiction & ~single, X, found), blamed, contradiction & ~jnp.any(blamed, 0)


def _sequential(systems, p, h, X):
    """Compare the newest row's systems with the reference: the box and the systems of older rows. Source:
    step i of the paper.

    Returns as `_joint`; older rows that contradict the box are a fault of nobody in particular, as are newest
    ones that only contradict each other.
    """
    boxes = jnp.moveaxis(stored(solutions(systems, interval_of(h))), 1, 0)  # (q, 2, n, N)
    old, new = boxes[:-p], boxes[-p:]
    least = lambda parts: -most([-x for x in parts])
    reference = least([X, *old])
    lost = jnp.any(none(reference), 0)
    unbounded = ~jnp.all(jnp.isfinite(X), (0, 1))  # the first window: its first system is all there is
    reference = stored(jnp.where(lost, jnp.where(unbounded, boxes[0], X), reference))
    apart = -(new + negative(reference)[None])
    blamed = stored(most([apart[:, side, i] for side in (0, 1) for i in range(X.shape[1])])) > 0
    taken = jnp.where(blamed[:, None, None], jnp.inf, new)
    state = stored(least([reference, *taken]))
    torn = jnp.any(none(state), 0)
    return jnp.where(torn, reference, state), blamed, lost | torn
