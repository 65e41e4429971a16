"""Sliding windows of data validation: one loop over time, all recordings side by side on the last axis.

A window holds s + 1 samples. It starts from the box of the window before, moved on by the model; the newest
samples are tested against it; what does not fit is left out, here and in the windows to come, and what the
box implies stands in for it.
"""

from collections.abc import Mapping
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.unrolled import most, stored
from jaxbound.sets.linear_systems.ends import added, interval_of, negative, none, product, subtracted, total
from jaxbound.sets.linear_systems.fixed_systems import Prepared, solutions
from jaxbound.sets.linear_systems.hull import tighten

STEPS = 20
"""Exchanges at most for one bound of the joint method, beside six for each unknown."""

ValidationPlant: TypeAlias = Mapping[str, jax.Array]
"""Ends of A, B, C, D, w, u0, y0, perhaps H, d (see `IntervalSystem`), and factor: 1 / (1 + theta)."""


Numbers = TypeVar("Numbers", np.ndarray, jax.Array)
Tree = TypeVar("Tree")


class ValidationCarry(NamedTuple, Generic[Numbers]):
    """The states and samples that windows of N recordings hand on, of NumPy between kernels.

    Fields: X (2, (s+1) n, N) ends that hold the states of the next window. gone (s, p, N): its samples but
    the newest that are left out. moved: these samples, ends (2, s, p, N), if any may have been moved; else
    None.
    """

    X: Numbers
    gone: Numbers
    moved: Numbers | None


class ValidationSamples(NamedTuple, Generic[Numbers]):
    """T samples of N recordings, as kernels take them; on the host recordings come first.

    Fields: u (T, 2, m, N) ends of inputs. y, error (T, p, N): outputs, and the bounds of their errors, see
    `sensor.largest_error`. weight (T, 2, n, N): ends that multiply the columns of C, or None.
    """

    u: Numbers
    y: Numbers
    error: Numbers
    weight: Numbers | None


class _Signalled(NamedTuple):
    """The signals of a model as samples show them.

    Fields: absent (T, p, N); ends (2, T, ., N) seen of C x, pushed of H u + d, drive of B u + w, through of
    D u + y0.
    """

    absent: jax.Array
    seen: jax.Array
    pushed: jax.Array
    drive: jax.Array
    through: jax.Array


def _signalled(plant: ValidationPlant, samples: ValidationSamples[jax.Array]) -> _Signalled:
    """Return the signals that samples show."""
    u, y = jnp.moveaxis(samples.u, 1, 0), samples.y
    absent = jnp.isnan(y)
    v = subtracted(u, _along(plant, "u0"))
    nothing = jnp.zeros((2, 1, 1, 1), y.dtype)

    def on_inputs(name: str) -> jax.Array:
        """Enclose the product of a matrix and the inputs."""
        if not u.shape[2]:
            return nothing
        return total(product(plant[name][:, None, ..., None], v[:, :, None]), axis=3)

    def wide(x: jax.Array) -> jax.Array:
        return jnp.broadcast_to(x, (2, u.shape[1], x.shape[2], u.shape[3]))

    through = on_inputs("D")
    point = jnp.where(absent, 0, y)[None] * jnp.asarray([-1, 1], y.dtype)[:, None, None, None]
    seen = product(
        added(subtracted(point, _along(plant, "y0")), samples.error[None]), _along(plant, "factor")
    )
    pushed = drive = added(on_inputs("B"), _along(plant, "w"))
    if "H" in plant:
        pushed = added(on_inputs("H"), _along(plant, "d"))
    seen = subtracted(seen, through)
    pushed, drive, through = wide(pushed), wide(drive), wide(added(through, _along(plant, "y0")))
    return _Signalled(absent, *stored((seen, pushed, drive, through)))


def _along(plant: ValidationPlant, name: str) -> jax.Array:
    """Return numbers of signals (2, m) as (2, T, m, N) takes them."""
    return plant[name][:, None, :, None]


@kernel(static_argnames=("s", "centre"))
def begun(
    plant: ValidationPlant,
    systems: Prepared | None,
    start: jax.Array | None,
    samples: ValidationSamples[jax.Array],
    s: int,
    centre: bool,
) -> ValidationCarry[jax.Array]:
    """Return the carry before the first window of N recordings, of which samples are s + 1 at least.

    Args:
        start: ends (2, n, N) that hold the first state, or None. systems: for "joint", where there is no
            start, the rows of the first window as one system, perhaps without the newest samples.
    """
    known = _signalled(plant, samples)
    gone, moved = known.absent[:s], None
    if centre:
        moved = known.seen[:, :s]
    if start is not None:
        return ValidationCarry(_states_from(plant, known, start, s), gone, moved)
    if systems is not None:
        right = jnp.concatenate([_rows(negative(known.pushed[:, :s])), _rows(known.seen[:, : s + 1])], 1)
        X = solutions(systems, interval_of(right[:, : systems.C.shape[2]]))[:, 0]
    else:
        X = jnp.full((2, (s + 1) * plant["A"].shape[1], gone.shape[-1]), jnp.inf, known.seen.dtype)
    return ValidationCarry(X, gone, moved)


def _states_from(plant: ValidationPlant, known: _Signalled, start: jax.Array, s: int) -> jax.Array:
    """Return the states of s + 1 samples, from bounds of the first on."""

    def later(x: jax.Array, drive: jax.Array) -> tuple[jax.Array, jax.Array]:
        return _predict(plant, x, drive), x

    last, before = jax.lax.scan(later, start, jnp.moveaxis(known.drive[:, :s], 1, 0))
    return jnp.concatenate([_rows(jnp.moveaxis(before, 0, 1)), last], 1)


Slid: TypeAlias = tuple[ValidationCarry[Numbers], Numbers, Numbers]
_State: TypeAlias = tuple[ValidationCarry[jax.Array], Slid[jax.Array]]


@kernel(static_argnames=("s", "method", "centre"))
def slide(
    plant: ValidationPlant,
    M: jax.Array,
    systems: Prepared | None,
    samples: ValidationSamples[jax.Array],
    carry: ValidationCarry[jax.Array],
    first: int,
    stop: int,
    s: int,
    method: str,
    centre: bool,
) -> Slid[jax.Array]:
    """Validate N recordings, the windows that end at samples first, first + 1, .., stop - 1.

    Args:
        M: ends (2, r, (s+1) n, 1), see `intervals.stacked`. systems: the square systems of M for
            "sequential". carry: before the first window.
        centre: whether a faulty sample is moved to the middle of what it should have shown, and taken for
            sound: nothing is proved then.

    Returns:
        (carries, found, blamed): the carries (T + 1, ...) before each window, and behind the last one; ends
        found (T, 2, n + 3 p, N) of states, outputs, residuals and corrected samples; blamed (T, p + 1, N)
        bool: the faulty sensors, and whether the samples contradict the model. Infinite and False before the
        first window and from stop on.
    """
    signals = _signalled(plant, samples)
    weight = None
    if samples.weight is not None:
        weight = jnp.moveaxis(samples.weight, 1, 0)
    n, p, (T, _, N) = plant["A"].shape[1], plant["C"].shape[1], signals.absent.shape

    def show(x: jax.Array, first: jax.Array) -> jax.Array:
        """Enclose C x for the states x (2, j, n, N) of samples first, first + 1, .."""
        if weight is not None:
            x = stored(product(x, _part(weight, first, x.shape[1])))
        return stored(total(product(plant["C"][:, None, ..., None], x[:, :, None]), axis=3))

    def contradictions(h: jax.Array, X: jax.Array, k: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return (states, who is blamed, where nobody is) of right sides h of all rows."""
        if method != "joint":
            assert systems is not None  # as said above
            return _sequential(systems, p, h, X)
        rows = M
        if weight is not None:
            rows = weighted(M, _part(weight, k - s, s + 1), p)
        return _joint(rows, p, h, X)

    def window(k: jax.Array, state: _State) -> _State:
        carry, (carries, ends_of_all, blamed) = state
        X, gone, moved = carry
        newest = _part(signals.seen, k, 1)
        if moved is not None:
            samples = jnp.concatenate([moved, newest], 1)
        else:
            samples = _part(signals.seen, k - s, s + 1)
        gone = jnp.concatenate([gone, _part(signals.absent, k, 1, 0)])
        implied = show(X.reshape(2, s + 1, n, N), k - s)
        residual = stored(subtracted(newest[:, 0], implied[:, s]))
        alone = ((residual[0] < 0) | (residual[1] < 0)) & ~gone[s]
        # left out before all rows are met: it would make them contradict each other
        gone = gone.at[s].set(gone[s] | alone)
        moves = _rows(negative(_part(signals.pushed, k - s, s)))
        h = stored(jnp.concatenate([moves, _rows(jnp.where(gone, implied, samples))], 1))
        X, together, unclear = contradictions(h, X, k)
        faulty = alone | (together & ~gone[s])
        gone = gone.at[s].set(gone[s] | faulty | unclear[None])
        output = show(X[:, None, s * n :], k)[:, 0]
        # a sound sample is what the sensor said and the model allows, both
        corrected = jnp.where(gone[s], output, jnp.minimum(output, newest[:, 0]))
        # a sample that was accepted may still miss what all rows together imply
        corrected = jnp.where(none(corrected), output, corrected)
        if centre:
            # as the paper does: nothing is proved of a sample that was moved
            shift = jnp.where(faulty, _mid(output) - _mid(newest[:, 0]), 0)
            gone = gone.at[s].set(gone[s] & ~faulty)
            moved = jnp.concatenate([samples[:, 1:s], newest + jnp.stack([-shift, shift])[:, None]], 1)
        through = signals.through[:, k]
        now = X[:, s * n :], added(output, through), residual, added(corrected, through)
        out = stored(jnp.concatenate(now, 1))
        wrong = jnp.concatenate([faulty, (jnp.any(faulty, 0) | unclear)[None]])
        # the window moves on by one sample: its first state is forgotten
        X = jnp.concatenate([X[:, n:], _predict(plant, X[:, s * n :], signals.drive[:, k])], 1)
        carry = ValidationCarry(X, gone[1:], moved)
        return carry, (_put(carries, k + 1, carry), ends_of_all.at[k].set(out), blamed.at[k].set(wrong))

    # each window's own, so that a FAULT can be followed again from the one before
    carries = jax.tree.map(lambda x: jnp.zeros((T + 1, *x.shape), x.dtype), carry)
    ends_of_all = jnp.full((T, 2, n + 3 * p, N), jnp.inf, signals.seen.dtype)
    blamed = jnp.zeros((T, p + 1, N), bool)
    start: _State = carry, (_put(carries, first, carry), ends_of_all, blamed)
    out: _State = jax.lax.fori_loop(first, stop, window, start)
    return out[1]


def _put(all: Tree, k: jax.Array | int, one: Tree) -> Tree:
    """Return arrays with another entry k on their first axis."""
    out: Tree = jax.tree.map(lambda x, value: x.at[k].set(value), all, one)
    return out


def weighted(M: jax.Array, weight: jax.Array, p: int) -> jax.Array:
    """Multiply the columns of the C rows of M, ends (2, r, (s+1) n, 1), the last p (s+1), by weight (2, s+1,
    n, N).
    """
    _, s, _, N = weight.shape
    moves = M[:, : -p * s]
    moves = jnp.broadcast_to(moves, (*moves.shape[:3], N))
    return stored(jnp.concatenate([moves, product(M[:, -p * s :], weight.reshape(2, 1, -1, N))], 1))


def _transform(A: jax.Array, x: jax.Array) -> jax.Array:
    """Enclose A x for ends A (2, r, n, N or 1), x (2, n, N)."""
    return stored(total(product(A, x[:, None]), axis=2))


def _predict(plant: ValidationPlant, x: jax.Array, drive: jax.Array) -> jax.Array:
    """Enclose the states one sample later."""
    return stored(added(_transform(plant["A"][..., None], x), drive))


def _rows(x: jax.Array) -> jax.Array:
    """Return ends (2, j, r, N) of j samples as rows of one window."""
    return x.reshape(2, -1, x.shape[-1])


def _part(x: jax.Array, first: jax.Array, count: int, axis: int = 1) -> jax.Array:
    """Return so many samples of an array."""
    return jax.lax.dynamic_slice_in_dim(x, first, count, axis)


def _mid(x: jax.Array) -> jax.Array:
    """Return the middle of ends."""
    return 0.5 * x[1] - 0.5 * x[0]


_Attempt: TypeAlias = tuple[jax.Array | int, jax.Array, jax.Array, jax.Array]
"""The number of the next choice of rows, where all rows contradict, which choices fit, the states."""


def _joint(M: jax.Array, p: int, h: jax.Array, X: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Tighten the box by all rows. Where they contradict each other, by fewer of the newest p rows.

    All but one are tried, then none, then (p > 2) one alone. To blame is a row without which alone the
    contradiction ends, and one that alone contradicts the older rows and the box, if these agree. Returns the
    states, who is blamed, and where there is a contradiction but nobody to blame.
    """
    r, (_, n, N) = M.shape[1], X.shape
    choices = jnp.asarray(_choices(p))
    implied = _transform(M[:, r - p :], X)  # what the box says of the newest rows adds nothing
    newest = h[:, r - p :]

    def goes_on(state: _Attempt) -> jax.Array:
        i, contradiction, *_ = state
        return (i == 0) | ((i < len(choices)) & jnp.any(contradiction))

    def attempt(state: _Attempt) -> _Attempt:
        i, contradiction, fits, states = state
        rows = jnp.concatenate([h[:, : r - p], jnp.where(choices[i][:, None], newest, implied)], 1)
        tight = tighten(interval_of(M), interval_of(rows), interval_of(X), STEPS + 6 * n)
        box = jnp.stack([-tight.lo, tight.hi])
        fit = ~jnp.any(none(box), 0)
        states = jnp.where(fit & ((i == 0) | (contradiction & (i <= p))), box, states)
        return i + 1, jnp.where(i == 0, ~fit, contradiction), fits.at[i].set(fit), states

    start: _Attempt = 0, jnp.zeros(N, bool), jnp.zeros((len(choices), N), bool), X
    _, contradiction, fits, states = jax.lax.while_loop(goes_on, attempt, start)
    without, last = fits[1 : p + 1], fits[p + 1]
    if p > 2:
        alone = fits[p + 2 :]
    elif p == 2:
        alone = without[::-1]  # without the one is the other alone
    else:
        alone = fits[:1]
    # two rows, either of which ends the contradiction, blame nobody
    single = jnp.sum(without, 0) == 1
    blamed = (contradiction & last)[None] & ((single[None] & without) | ~alone)
    return jnp.where(contradiction & ~single, X, states), blamed, contradiction & ~jnp.any(blamed, 0)


def _choices(p: int) -> np.ndarray:
    """Return (c, p) bool: which of the newest rows each attempt takes."""
    eye = np.eye(p, dtype=bool)
    rows = [np.ones((1, p), bool), ~eye, np.zeros((1, p), bool)]
    if p > 2:
        rows.append(eye)
    return np.concatenate(rows)


def _sequential(
    systems: Prepared, p: int, h: jax.Array, X: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compare the newest row's systems with the reference: the box and the systems of older rows. Source:
    step i of the paper.

    Returns as `_joint`; older rows that contradict the box are a fault of nobody in particular, as are newest
    ones that only contradict each other.
    """
    boxes = jnp.moveaxis(stored(solutions(systems, interval_of(h))), 1, 0)  # (q, 2, n, N)
    old, new = boxes[:-p], boxes[-p:]
    reference = _least([X, *old])
    # older rows contradict the box: it alone is the reference then
    lost = jnp.any(none(reference), 0)
    unbounded = ~jnp.all(jnp.isfinite(X), (0, 1))  # the first window: its first system is all there is
    reference = stored(jnp.where(lost, jnp.where(unbounded, boxes[0], X), reference))
    apart = -(new + negative(reference)[None])
    sides = [apart[:, side, i] for side in (0, 1) for i in range(X.shape[1])]
    blamed = stored(most(sides)) > 0
    taken = jnp.where(blamed[:, None, None], jnp.inf, new)
    state = stored(_least([reference, *taken]))
    torn = jnp.any(none(state), 0)
    return jnp.where(torn, reference, state), blamed, lost | torn


def _least(parts: list[jax.Array]) -> jax.Array:
    """Return the least of several ends."""
    return -most([-x for x in parts])
