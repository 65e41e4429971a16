"""Data validation: where can the state be, which sensor does not fit, and what should it have said?

Every window is an interval linear system in its states (`models.intervals.stacked`). The states found so far, propagated by the model,
are a box; the newest samples are tested against it one by one and together; a sensor that does not fit is left out from there on, and the
interval that the state gives for its output stands in for it.

What is promised: if the first window is fault-free (or x0 holds), the parameters are within bounds and every faulty sample was found, the
true state is inside. A fault too small to be proved is accepted, and may move the enclosure past the true state. Nobody can promise more.

Source: Alhaj-Dibo, Maquin, Ragot 2004.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models.intervals import as_intervals, stacked
from jaxbound.models.multimodel import MultiModel
from jaxbound.sets.interval import Interval, intersection, interval
from jaxbound.sets.interval import sum as interval_sum
from jaxbound.sets.linear_hull import tighten
from jaxbound.sets.linear_kernels import enclose, factor, minus, over, preconditioner, product, times
from jaxbound.sets.status import Status

__all__ = ["Validation", "validate"]

EXCHANGES = 60
_held = jax.lax.optimization_barrier


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Validation:
    """What `validate` found, time first: entry k comes from the window that ends at sample k.

    Fields: state Interval (..., T, n). output Interval (..., T, p): what a perfect sensor would show. residual Interval (..., T, p): the
    sample minus what the samples before it allow; a sensor is faulty where it excludes 0, or where all sensors together contradict the
    model and leaving this one out alone resolves it. faulty (..., T, p) bool. corrected Interval (..., T, p): `output`, where a sample was
    accepted also within what it says; corrected.mid is the point value. status (..., T) int8, see `Status`: FAULT is a proof that
    not all samples of the window fit the model, those before being as accepted; UNDECIDED: nothing was proved; MISSING: the first s.
    """

    state: Interval
    output: Interval
    residual: Interval
    faulty: jax.Array
    corrected: Interval
    status: jax.Array


def validate(model, u, y, horizon=None, method="joint", x0=None):
    """Enclose the state over time, find the sensor that does not fit, and say what it should have shown.

    Args:
        model: `interval_system(...)`, a LinearSystem (uncertain parameters, tolerance, noise, disturbance; no unknown inputs), or a
            MultiModel (joint only; its .state holds the states of all sub-models).
        u: (..., T, m) or None. y: (..., T, p); NaN: that sample is absent. Recordings on leading axes run side by side.
        horizon: s of windows of s + 1 samples; None: the smallest with s >= n / p and p (s + 1) > n.
        method: "joint": the newest samples, the older ones and the propagated state at once, by the hull of their linear programs.
            "sequential": the paper's square systems, one for each further row, against a reference; wider, faster.
        x0: Interval (..., n) that holds the first state. None: the first window is taken to be fault-free, and must be complete.

    Returns:
        A Validation.

    Encloses: every state of every behaviour within the bounds that gives the samples accepted as sound, rounding included.

    Raises:
        ValueError: shapes that do not fit, a first window that does not bound the state, an unknown method. TypeError: no model.

    Source: Alhaj-Dibo, Maquin, Ragot 2004, (6)-(11). Its correction by the centre of (11) is not a proof and is not offered: the point
    value is `corrected.mid`, and goes nowhere.

    Example:
        >>> from jaxbound import interval_system
        >>> m = interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)
        >>> y = np.tile(10 - 9 * 0.9 ** np.arange(8)[:, None], 2)
        >>> y[5, 1] += 2
        >>> validate(m, np.ones((8, 1)), y).faulty[5].tolist()
        [False, True]
    """
    m = model.joined() if isinstance(model, MultiModel) else as_intervals(model)
    if method not in ("joint", "sequential"):
        raise ValueError(f"method must be 'joint' or 'sequential', not {method!r}")
    y = np.asarray(y, m.A.dtype)
    if y.ndim < 2 or y.shape[-1] != m.p:
        raise ValueError(f"y must have shape (..., T, {m.p}), time before outputs: its shape is {y.shape}")
    *lead, T, _ = y.shape
    u = np.zeros((*y.shape[:-1], 0), y.dtype) if u is None else np.asarray(u, y.dtype)
    if u.shape[-1:] != (m.m,) or u.shape[:-1] != y.shape[:-1]:
        raise ValueError(f"u must have shape {(*y.shape[:-1], m.m)} to fit y and the model: its shape is {u.shape}")
    if not np.isfinite(u).all():
        raise ValueError(f"validate needs every input: {(~np.isfinite(u)).sum()} samples of u are missing or infinite")
    if np.isinf(y).any():
        raise ValueError(f"y must be numbers, or NaN where a sample is absent: {np.isinf(y).sum()} are infinite")
    s = horizon
    if s is None:
        s = max(-(-m.n // m.p), 1)
        s += m.p * (s + 1) <= m.n
    if isinstance(model, MultiModel) and method == "sequential":
        raise ValueError("a MultiModel has another matrix in every window: use method='joint'")
    if not isinstance(s, (int, np.integer)) or s < 1 or T <= s:
        raise ValueError(f"horizon must be a whole number >= 1 with more samples than it ({T}), not {s!r}")
    if x0 is None and np.isnan(y[..., : s + 1, :]).any():
        raise ValueError(f"the first {s + 1} samples must be complete, or x0 must say where the first state is")
    count = int(np.prod(lead))
    last = lambda a: np.moveaxis(a.reshape(count, T, a.shape[-1]), 0, -1)  # (T, ., N)
    start = interval(np.full((m.n, 1), -np.inf), np.full((m.n, 1), np.inf))
    if x0 is not None:
        x0 = interval(x0)
        if x0.shape[-1:] != (m.n,):
            raise ValueError(f"x0 needs one interval for each of {m.n} states: its shape is {x0.shape}")
        start = jax.tree.map(lambda a: jnp.moveaxis(jnp.broadcast_to(a, (*lead, m.n)).reshape(count, m.n), 0, -1), x0)
    arrays = {"A": m.A, "B": m.B, "C": m.C, "D": m.D, "w": m.w, "u0": m.offset["u"], "y0": m.offset["y"]}
    arrays |= {"noise": jnp.asarray(m.noise, y.dtype), "tolerance": jnp.asarray(m.tolerance, y.dtype)}
    arrays["weight"] = jax.tree.map(last, model.columns(u)) if isinstance(model, MultiModel) else None
    found, bounded = _run(arrays, stacked(m, s), last(u), last(y), start, int(s), method, x0 is None)
    if not np.asarray(bounded).all():
        raise ValueError(f"{(~np.asarray(bounded)).sum()} of {count} first windows do not bound the state: give x0, or a longer horizon")
    first = lambda a: jnp.moveaxis(a, -1, 0).reshape(*lead, *a.shape[:-1])
    return jax.tree.map(first, found)


def _transform(A, x):
    """Enclose A x for A (r, n), x (n, N)."""
    return interval_sum(_held(product(A[..., None], x[None])), axis=1)


def _plus(x, y):
    return minus(x, Interval(-y.hi, -y.lo))


def _said(arrays, u, y):
    """Return what the samples say of C x, (T, p, N), and the drive B u + w, (T, n, N)."""
    T, N = y.shape[0], y.shape[2]
    flat = lambda a: jnp.moveaxis(a, 0, 1).reshape(a.shape[1], T * N)
    back = lambda x: jax.tree.map(lambda a: jnp.moveaxis(a.reshape(a.shape[0], T, N), 1, 0), x)
    point = lambda a: Interval(a, a)
    v = minus(point(flat(u)), arrays["u0"][:, None])
    drive = (
        _plus(_transform(arrays["B"], v), arrays["w"][:, None])
        if u.shape[1]
        else _plus(interval(jnp.zeros((1, T * N), u.dtype)), arrays["w"][:, None])
    )
    e, theta = arrays["noise"][:, None], arrays["tolerance"][:, None]
    seen = minus(minus(point(flat(y)), arrays["y0"][:, None]), Interval(-e, e))
    seen = over(seen, minus(interval(jnp.ones_like(theta)), Interval(-theta, theta)))
    if u.shape[1]:
        seen = minus(seen, _transform(arrays["D"], v))
    return back(_held(seen)), back(_held(drive))


@partial(jax.jit, static_argnames=("s", "method", "unknown"))
def _run(arrays, M, u, y, start, s, method, unknown):
    n, p, (T, _, N) = arrays["A"].shape[0], arrays["C"].shape[0], y.shape
    absent = jnp.isnan(y)
    said, drive = _said(arrays, u, jnp.where(absent, 0, y))
    M = M[..., None]
    stack = lambda *parts: jax.tree.map(lambda *a: jnp.concatenate(a), *parts)
    rows = lambda x: jax.tree.map(lambda a: a.reshape(-1, N), x)
    at = lambda x, k: jax.tree.map(lambda a: a[k], x)

    def show(k, x):
        """Enclose C x at sample k; the columns of C may be weighted by the input."""
        return _transform(arrays["C"], x if arrays["weight"] is None else _held(product(x, at(arrays["weight"], k))))

    def matrix(k):
        if arrays["weight"] is None:
            return M
        w = jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, k - s, s + 1).reshape(1, -1, N), arrays["weight"])
        moves = jax.tree.map(lambda a: jnp.broadcast_to(a, (*a.shape[:2], N)), M[: s * n])
        return _held(stack(moves, product(M[s * n :], w)))

    def predict(x, k):
        return _held(_plus(_transform(arrays["A"], x), at(drive, k)))

    def right(k, seen):
        moved = jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, k - s, s), drive)
        return stack(rows(Interval(-moved.hi, -moved.lo)), rows(seen))

    def known(k, X, seen, gone):
        """Put in for an absent sample what the box says of it, which adds nothing."""
        each = [show(k - s + j, X[j * n : (j + 1) * n]) for j in range(s + 1)]
        implied = Interval(jnp.stack([r.lo for r in each]), jnp.stack([r.hi for r in each]))
        return _held(Interval(jnp.where(gone, implied.lo, seen.lo), jnp.where(gone, implied.hi, seen.hi)))

    if unknown:
        h = right(s, jax.tree.map(lambda a: a[: s + 1], said))
        C = preconditioner(M)
        X = enclose(
            factor(times(C, M)), times(C, h), "hbr", Interval(*(jnp.full(((s + 1) * n, N), b, y.dtype) for b in (-jnp.inf, jnp.inf)))
        )
        bounded = jnp.all(jnp.isfinite(X.lo) & jnp.isfinite(X.hi), 0)
    else:
        parts = [jax.tree.map(lambda a: jnp.broadcast_to(a, (n, N)), start)]
        for j in range(s):
            parts.append(predict(parts[-1], j))
        X, bounded = stack(*parts), jnp.ones(N, bool)
    systems = _square_systems(M, (s + 1) * n) if method == "sequential" else None

    def window(carry, k):
        X, gone, begun = carry  # the states of the last window; (s, p, N): its samples left out
        shifted = stack(X[n:], predict(X[s * n :], k - 1))
        X = Interval(jnp.where(begun, shifted.lo, X.lo), jnp.where(begun, shifted.hi, X.hi))
        seen = jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, k - s, s + 1), said)
        gone = jnp.concatenate([gone, absent[k][None]])
        residual = minus(seen[s], show(k, X[s * n :]))
        alone = ((residual.lo > 0) | (residual.hi < 0)) & ~gone[s]
        gone = gone.at[s].set(gone[s] | alone)
        judge = partial(_joint, matrix(k), p) if method == "joint" else partial(_sequential, systems, p)
        X, together, unclear = judge(right(k, known(k, X, seen, gone)), X)
        faulty = alone | (together & ~gone[s])
        gone = gone.at[s].set(gone[s] | faulty | unclear[None])
        output = show(k, X[s * n :])
        corrected = intersection(output, Interval(jnp.where(gone[s], -jnp.inf, seen.lo[s]), jnp.where(gone[s], jnp.inf, seen.hi[s])))
        lost = corrected.is_empty
        corrected = Interval(jnp.where(lost, output.lo, corrected.lo), jnp.where(lost, output.hi, corrected.hi))
        usable = jnp.where(absent[k], jnp.nan, 0)
        out = (
            X[s * n :],
            output,
            Interval(residual.lo + usable, residual.hi + usable),
            faulty,
            corrected,
            jnp.any(faulty, 0) | unclear,
        )
        return _held((X, gone[1:], jnp.ones((), bool))), out

    gone = absent[:s]
    _, (state, output, residual, faulty, corrected, fault) = jax.lax.scan(window, (X, gone, jnp.zeros((), bool)), jnp.arange(s, T))
    du = (
        _transform(arrays["D"], minus(Interval(*[jnp.moveaxis(u, 0, 1).reshape(u.shape[1], T * N)] * 2), arrays["u0"][:, None]))
        if u.shape[1]
        else None
    )
    add = interval(jnp.zeros((T, p, N), y.dtype)) if du is None else jax.tree.map(lambda a: jnp.moveaxis(a.reshape(p, T, N), 1, 0), du)
    shown = lambda x: _plus(_plus(x, add[s:]), arrays["y0"][None, :, None])
    before = lambda x, fill: jax.tree.map(lambda a, b: jnp.concatenate([jnp.full((s, *a.shape[1:]), b, a.dtype), a]), x, fill)
    entire = Interval(-jnp.inf, jnp.inf)
    status = jnp.where(fault, Status.FAULT, jnp.where(jnp.all(absent[s:], 1), Status.MISSING, Status.UNDECIDED)).astype(jnp.int8)
    found = Validation(before(state, entire), before(shown(output), entire), before(residual, entire), before(faulty, False),
                       before(shown(corrected), entire), before(status, int(Status.MISSING)))  # fmt: skip
    return found, bounded


def _joint(M, p, h, X):
    """Tighten the box by all rows; where they contradict each other, by all but one of the newest p.

    Returns the states, who is blamed, and where nobody can be: then the newest rows are left out.
    """
    N, r = X.shape[1], M.shape[0]
    found = _held(tighten(M, h, X, EXCHANGES))
    contradiction = _held(jnp.any(found.is_empty, 0))
    implied = interval_sum(_held(product(M[r - p :], X[None])), axis=1)  # what the box says of the newest rows: adds nothing
    dropped = np.eye(p, dtype=bool)[..., None]
    wide = lambda a: jnp.broadcast_to(a[:, None], (a.shape[0], p, N))

    def search():
        end = lambda a, b: jnp.concatenate([wide(a[: r - p]), jnp.where(dropped, wide(b), wide(a[r - p :]))]).reshape(r, -1)
        box = jax.tree.map(lambda a: wide(a).reshape(a.shape[0], -1), X)
        matrix = M if M.shape[2] == 1 else jax.tree.map(lambda a: jnp.tile(a, (1, 1, p)), M)
        each = tighten(matrix, Interval(end(h.lo, implied.lo), end(h.hi, implied.hi)), box, EXCHANGES)
        return jax.tree.map(lambda a: a.reshape(-1, p, N), each)

    each = jax.lax.cond(jnp.any(contradiction), search, lambda: jax.tree.map(wide, X))
    fits = ~jnp.any(each.is_empty, 0)
    single = contradiction & (jnp.sum(fits, 0) == 1)
    blamed = single[None] & fits
    take = lambda a, b: jnp.where(single[None], jnp.sum(jnp.where(blamed[None], a, 0), 1), b)
    choice = lambda all_rows, a, b: jnp.where(contradiction[None], take(a, b), all_rows)
    lost = contradiction & ~jnp.any(fits, 0)
    box = Interval(choice(found.lo, each.lo, X.lo), choice(found.hi, each.hi, X.hi))
    return box, blamed | lost[None], contradiction & ~single & ~lost


def _square_systems(M, size):
    """Prepare the square systems: the first rows, then each further row in place of the last of them. Source: step i of the paper."""
    rows = np.array([[*range(size - 1), last] for last in range(size - 1, M.shape[0])])

    def prepare(square):
        C = preconditioner(square)
        return C, factor(times(C, square))

    return rows, *jax.vmap(prepare)(M[rows])


def _sequential(systems, p, h, X):
    """Compare each newest row's system with the reference: the box and the systems of older rows."""
    rows, C, F = systems

    def solve(C, F, h):
        b = times(C, h)
        return intersection(enclose(F, b, "hbr", X), enclose(F, b, "gauss", X))

    boxes = list(jax.vmap(solve)(C, F, h[rows]))
    reference, old = X, boxes[: len(boxes) - p]
    for box in old:
        tighter = _held(intersection(reference, box))
        lost = jnp.any(tighter.is_empty, 0)[None]
        reference = Interval(jnp.where(lost, reference.lo, tighter.lo), jnp.where(lost, reference.hi, tighter.hi))
    blamed, state = [], reference
    for box in boxes[len(boxes) - p :]:
        blamed.append(jnp.any(intersection(reference, box).is_empty, 0))
        tighter = _held(intersection(state, box))
        lost = jnp.any(tighter.is_empty, 0)[None]
        state = Interval(jnp.where(lost, state.lo, tighter.lo), jnp.where(lost, state.hi, tighter.hi))
    return state, jnp.stack(blamed), jnp.zeros(X.shape[1], bool)
