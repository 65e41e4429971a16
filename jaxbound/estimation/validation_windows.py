"""Sliding windows of data validation: one scan over time, all recordings side by side on the last axis.

A window holds s + 1 samples. It starts from the box of the window before, moved on by the model; the newest samples are tested against it;
what does not fit is left out, here and in the windows to come, and what the box implies stands in for it.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.unrolled import most, stored
from jaxbound.sets.intervals.interval import Interval, intersection, interval, mid
from jaxbound.sets.linear_systems.fixed_systems import solutions
from jaxbound.sets.linear_systems.hull import tighten
from jaxbound.sets.linear_systems.kernels import minus, over, product

__all__ = ["slide", "weighted"]

STEPS = 20
"""Exchanges at most for one bound of the joint method, beside six for each unknown."""


@partial(jax.jit, static_argnames=("s", "method", "centre"))
def slide(
    plant: dict[str, Any],
    M: Interval,
    systems: Any,
    u: jax.Array,
    y: jax.Array,
    error: Interval,
    weight: Interval | None,
    start: Interval | None,
    before: Any,
    s: int,
    method: str,
    centre: bool = False,
) -> tuple:
    """Validate N recordings.

    Args:
        plant: dict of Intervals A, B, C, D, w, u0, y0, perhaps H, d (see `IntervalSystem`), and an array tolerance.
        M: Interval (r, (s+1) n), see `intervals.stacked`.
        systems: the square systems of M, or for "joint" the first window's rows as one, perhaps without the newest samples.
        u, y, error: Interval (N, T, m), (N, T, p), (N, T, p): see `sensor.largest_error`. weight: None or an Interval (N, T, n) that
            multiplies the columns of C.
        start: Interval (N, n) that holds the first state; None: it comes from the first window.
        before: what this returned for the samples up to the first s of these, to go on from there; None: they are the first.
        centre: whether a faulty sample is moved to the middle of what it should have shown, and taken for sound: nothing is proved then.

    Returns:
        ((state, output, residual, corrected) Intervals, faulty, status, each (N, T, ..)), (N,) whether the first window is bounded, and
        what goes on from here: (states of the last window, its last s samples that are left out, these samples if any was moved), (N, ..).
    """
    u, y, error, weight = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), (u, y, error, weight))
    n, p, (T, _, N) = plant["A"].shape[0], plant["C"].shape[0], y.shape
    absent = jnp.isnan(y)
    seen, pushed, drive, through = _said(plant, u, jnp.where(absent, 0, y), error)
    M = M[..., None]

    def predict(x, k):
        return stored(_plus(stored(_transform(plant["A"][..., None], x)), jax.tree.map(lambda a: a[k], drive)))

    def show(x, first):
        """Enclose C x for the states x (j, n, N) of samples first, first + 1, .."""
        if weight is not None:
            x = stored(product(x, _part(weight, first, x.shape[0])))
        return stored(_sum(stored(product(plant["C"][None, ..., None], x[:, None])), axis=2))

    def right(k, samples):
        moved = _part(pushed, k - s, s)
        return stored(_stack(_rows(Interval(-moved.hi, -moved.lo)), _rows(samples)))

    gone, moved = absent[:s], seen[:s] if centre else None
    if before is not None:
        X, gone, moved = jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), before)
    elif start is not None:
        grow = lambda x, k: (predict(x, k), x)
        last, before = jax.lax.scan(grow, jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), start), jnp.arange(s))
        X = _stack(_rows(before), last)
    elif method == "joint":
        X = solutions(systems, right(s, seen[: s + 1])[: systems.C.shape[2]])[0]
    else:
        X = Interval(*(jnp.full(((s + 1) * n, N), end, y.dtype) for end in (-jnp.inf, jnp.inf)))

    def window(carry, k):
        X, gone, begun, moved = carry  # the states of the last window; (s, p, N): its samples left out; its samples, if any was moved
        X = _where(begun, _stack(X[n:], predict(X[s * n :], k - 1)), X)
        samples = _stack(moved, seen[k][None]) if centre else _part(seen, k - s, s + 1)
        gone = jnp.concatenate([gone, absent[k][None]])
        implied = show(jax.tree.map(lambda a: a.reshape(s + 1, n, N), X), k - s)
        residual = minus(samples[s], implied[s])
        alone = ((residual.lo > 0) | (residual.hi < 0)) & ~gone[s]
        gone = gone.at[s].set(gone[s] | alone)
        h = right(k, _where(gone, implied, samples))
        if method == "joint":
            rows = M if weight is None else weighted(M, _part(weight, k - s, s + 1), p)
            X, together, unclear = _joint(rows, p, h, X)
        else:
            X, together, unclear = _sequential(systems, p, h, X)
        faulty = alone | (together & ~gone[s])
        gone = gone.at[s].set(gone[s] | faulty | unclear[None])
        output = show(X[None, s * n :], k)[0]
        corrected = _where(gone[s], output, intersection(output, samples[s]))
        corrected = _where(corrected.is_empty, output, corrected)
        missing = jnp.where(absent[k], jnp.nan, 0)
        residual = Interval(residual.lo + missing, residual.hi + missing)
        if centre:
            shift = jnp.where(faulty, mid(output) - mid(samples[s]), 0)
            gone = gone.at[s].set(gone[s] & ~faulty)
            moved = _stack(samples[1:s], Interval(samples.lo[s] + shift, samples.hi[s] + shift)[None])
        out = X[s * n :], output, residual, corrected, faulty, jnp.any(faulty, 0) | unclear
        return (X, gone[1:], jnp.ones((), bool), moved), out

    carry = X, gone, jnp.full((), before is not None), moved
    (X, gone, _, moved), found = jax.lax.scan(window, carry, jnp.arange(s, T))
    state, output, residual, corrected, faulty, fault = found
    bounded = jnp.all(jnp.isfinite(state.lo[0]) & jnp.isfinite(state.hi[0]), 0)
    output, corrected = (_plus(_plus(x, through[s:]), plant["y0"][None, :, None]) for x in (output, corrected))
    proved = jnp.zeros_like(fault) if centre else fault
    status = jnp.where(proved, Status.FAULT, jnp.where(jnp.all(absent[s:], 1), Status.MISSING, Status.UNDECIDED)).astype(jnp.int8)
    entire = Interval(-jnp.inf, jnp.inf)
    fills = *(entire,) * 4, False, int(Status.MISSING)
    warm_up = lambda a, fill: jnp.moveaxis(jnp.concatenate([jnp.full((s, *a.shape[1:]), fill, a.dtype), a]), -1, 0)
    found = jax.tree.map(warm_up, (state, output, residual, corrected, faulty, status), fills)
    return found, bounded, jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), (X, gone, moved))


def weighted(M: Interval, weight: Interval, p: int) -> Interval:
    """Multiply the columns of the C rows of M (r, (s+1) n, 1), the last p (s+1), by weight (s+1, n, N)."""
    s, _, N = weight.shape
    w = jax.tree.map(lambda a: a.reshape(1, -1, N), weight)
    moves = jax.tree.map(lambda a: jnp.broadcast_to(a, (*a.shape[:2], N)), M[: -p * s])
    return stored(_stack(moves, product(M[-p * s :], w)))


def _said(plant, u, y, e):
    """Return what the samples, known up to e, say of C x, H u + d, B u + w, and D u: Intervals (T, ., N)."""
    point = lambda a: Interval(a, a)
    lift = lambda x: x[None, :, None]
    v = stored(minus(u, lift(plant["u0"])))
    nothing = interval(jnp.zeros((1, 1, 1), y.dtype))
    on = lambda name: _sum(stored(product(plant[name][None, ..., None], v[:, None])), axis=2) if u.shape[1] else nothing
    wide = lambda x: jax.tree.map(lambda a: jnp.broadcast_to(a, (u.shape[0], *a.shape[1:-1], u.shape[2])), x)
    through = on("D")
    theta = plant["tolerance"][None, :, None]
    seen = minus(minus(point(y), lift(plant["y0"])), Interval(-e, e))
    seen = over(stored(seen), minus(interval(jnp.ones_like(theta)), Interval(-theta, theta)))
    drive = _plus(on("B"), lift(plant["w"]))
    pushed = _plus(on("H"), lift(plant["d"])) if "H" in plant else drive
    return stored((minus(seen, through), wide(pushed), wide(drive), wide(through)))


def _transform(A, x):
    """Enclose A x for A (r, n, N or 1), x (n, N)."""
    return _sum(stored(product(A, x[None])), axis=1)


def _sum(x, axis):
    """Enclose the sum of non-empty Intervals."""
    return Interval(*rounding.outward_sum(x.lo, x.hi, axis))


def _plus(x, y):
    return minus(x, Interval(-y.hi, -y.lo))


def _stack(*parts):
    return jax.tree.map(lambda *a: jnp.concatenate(a), *parts)


def _rows(x):
    return jax.tree.map(lambda a: a.reshape(-1, a.shape[-1]), x)


def _part(x, first, count):
    return jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, first, count), x)


def _where(condition, x, y):
    return Interval(jnp.where(condition, x.lo, y.lo), jnp.where(condition, x.hi, y.hi))


def _joint(M, p, h, X):
    """Tighten the box by all rows. Where they contradict each other, by fewer of the newest p rows.

    All but one are tried, then none, then (p > 2) one alone. To blame is a row without which alone the contradiction ends, and one that
    alone contradicts the older rows and the box, if these agree. Returns the states, who is blamed, and where there is a contradiction
    but nobody to blame.
    """
    r, N = M.shape[0], X.shape[1]
    eye = np.eye(p, dtype=bool)
    kept = jnp.asarray(np.concatenate([np.ones((1, p), bool), ~eye, np.zeros((1, p), bool), eye if p > 2 else eye[:0]]))
    implied = stored(_transform(M[r - p :], X))  # what the box says of the newest rows adds nothing
    newest = h[r - p :]

    def more(carry):
        i, contradiction, *_ = carry
        return (i == 0) | ((i < kept.shape[0]) & jnp.any(contradiction))

    def attempt(carry):
        i, contradiction, fits, found = carry
        rows = _stack(h[: r - p], _where(kept[i][:, None], newest, implied))
        box = tighten(M, rows, X, STEPS + 6 * X.shape[0])
        fit = ~jnp.any(box.is_empty, 0)
        found = _where(fit & ((i == 0) | (contradiction & (i <= p))), box, found)
        return i + 1, jnp.where(i == 0, ~fit, contradiction), fits.at[i].set(fit), found

    start = 0, jnp.zeros(N, bool), jnp.zeros((kept.shape[0], N), bool), X
    _, contradiction, fits, found = jax.lax.while_loop(more, attempt, start)
    without, none = fits[1 : p + 1], fits[p + 1]
    alone = fits[p + 2 :] if p > 2 else without[::-1] if p == 2 else fits[:1]
    single = jnp.sum(without, 0) == 1
    blamed = (contradiction & none)[None] & ((single[None] & without) | ~alone)
    return _where(contradiction & ~single, X, found), blamed, contradiction & ~jnp.any(blamed, 0)


def _sequential(systems, p, h, X):
    """Compare the newest row's systems with the reference: the box and the systems of older rows. Source: step i of the paper.

    Returns as `_joint`; older rows that contradict the box are a fault of nobody in particular, as are newest ones that only contradict
    each other.
    """
    boxes = stored(solutions(systems, h))
    old, new = boxes[:-p], boxes[-p:]
    reference = Interval(most([X.lo, *old.lo]), -most([-X.hi, *(-old.hi)]))
    lost = jnp.any(reference.lo > reference.hi, 0)
    unbounded = ~jnp.all(jnp.isfinite(X.lo) & jnp.isfinite(X.hi), 0)  # the first window: its first system is all there is
    reference = stored(_where(lost, _where(unbounded, boxes[0], X), reference))
    gap = jnp.maximum(new.lo - reference.hi[None], reference.lo[None] - new.hi)
    blamed = stored(most(list(jnp.moveaxis(gap, 1, 0)))) > 0
    taken = _where(blamed[:, None], Interval(-jnp.inf, jnp.inf), new)
    state = stored(Interval(most([reference.lo, *taken.lo]), -most([-reference.hi, *(-taken.hi)])))
    torn = jnp.any(state.lo > state.hi, 0)
    return _where(torn, reference, state), blamed, lost | torn
