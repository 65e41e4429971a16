"""Moving bounds by gradient: what the worst windows need, as a smooth function of the bounds, and some steps
of an optimiser on it.

With values b of the moved bounds and lambda_k(b) the factor on them at which window k just becomes
consistent, every direction b / |b| has its own smallest bounds lambda(b) b, lambda = max over k of lambda_k,
so that the width to be made small is free of the size of b:

    log(w b) + log lambda(b),                          with a smooth maximum T log sum exp(log lambda_k / T),
    T falling.

lambda_k comes from the factor t_k on all half-widths: log lambda_k = log t_k / e_k, e_k = -d log t_k / d
log(size of b). That is exact where all bounds move (e = 1) and to first order else, near t_k = 1; the steps
stay there. Only the worst windows matter to it. Of faulty windows j it is the share outside, with a smooth
step, that is made large:

    mean over j of sigmoid((log lambda_j(b) - log lambda(b) - log safety) / tau).
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.reading import Reading
from jaxbound.diagnosis.detection import margins
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.unrolled import stored
from jaxbound.sets.strips.separation import Frame, separation_margin
from jaxbound.sets.strips.strips import strip_margin
from jaxbound.studies.tuning.parametrization import Moving, Sizes, unflatten

if TYPE_CHECKING:
    import optax

LogFactors: TypeAlias = tuple[jax.Array, tuple[jax.Array, ...]]
"""log t (N,) of windows, and its slopes, arrays (., N) of a row a bound."""
Faulty: TypeAlias = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""u (T, m), y (T, p), ends (blocks, N) of faulty windows, and which of them count."""
State: TypeAlias = "tuple[jax.Array, optax.OptState]"
Best: TypeAlias = tuple[jax.Array, jax.Array]
"""Logarithms of the best values, and what they are chosen by."""

BLOCK = 2**13  # faulty windows a step looks at
T = 0.03, 1e-4  # temperature of the maximum, at the first and the last step
TAU = 0.5, 0.02  # of the step from inside to outside
RATE = 0.1, 0.0  # of the default optimiser, on logarithms of bounds
TIE = 0.01  # weight of the width where faulty windows count


class Pace(NamedTuple):
    """Steps in all, steps between two looks at all windows, and the (first, last) factor on what the
    optimiser says; between them half a period of a cosine.
    """

    steps: int
    every: int
    rate: tuple[float, float]


class Seen(NamedTuple):
    """Windows as a step sees them: `log_factors` of them, and which count, (N,) bool."""

    factors: LogFactors
    present: jax.Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Objective:
    """The numbers of a step beside the windows.

    Fields: test, the Reading of parity relations; relations, if uncertain ones take its place; log_safety;
    fixed, select, weights, most,
    sizes: of a Moving.
    """

    test: Reading | None
    fixed: jax.Array
    select: jax.Array
    weights: jax.Array
    most: jax.Array
    log_safety: jax.Array
    sizes: Sizes = field(metadata={"static": True})
    relations: UncertainRelations | None = field(metadata={"static": True})


def objective_of(
    relations: ParityRelation | UncertainRelations, moved: Moving, safety: float, dtype: np.dtype
) -> Objective:
    """Return the Objective of tuning the bounds `moved` of relations for recordings of a float dtype."""
    fixed, select, weights, most = (
        jax.device_put(np.asarray(x, dtype)) for x in (moved.fixed, moved.select, moved.weights, moved.most)
    )
    own = cast(UncertainRelations, relations) if relations.uncertain else None
    test = None if own else jax.device_put(relations.reading(dtype))
    log_safety = jax.device_put(np.log(np.asarray(safety, dtype)))
    return Objective(test, fixed, select, weights, most, log_safety, moved.sizes, own)


@lru_cache(maxsize=1)
def default_optimizer() -> "optax.GradientTransformation":
    """Return Adam with steps of 1: `descend` makes them fall from RATE to nothing, whatever the number of
    steps, without compiling anew.
    """
    import optax

    return optax.adam(1.0)


def descend(
    problem: Objective,
    optimizer: "optax.GradientTransformation",
    pace: Pace,
    state: State,
    first: int,
    healthy: tuple[jax.Array, jax.Array, np.ndarray],
    faulty: Faulty | None,
) -> tuple[State, jax.Array]:
    """Make the steps until the next look at all windows, as far as there are that many.

    Args:
        optimizer: an optax.GradientTransformation. state: (z (b,), the logarithms of the
            values; that of the optimizer). first: number of the first step.
        healthy: (u (s + 1, m, K), y (s + 1, p, K), present (K,)): the worst windows; present is False where
            a column only fills up.
        faulty: None, or (u (T, m), y (T, p), ends (blocks, N), present (blocks, N)): one block a step, in
            turn.

    Returns:
        (state, z): after the steps, and the best values on the way, scaled so that these healthy windows are
        just consistent.
    """
    u, y, present = healthy
    best = state[0], jnp.full((), jnp.inf, state[0].dtype)
    for number in range(first, min(first + pace.every, pace.steps)):
        inside, outside = Seen(log_factors(state[0], problem, u, y), present), None
        if faulty is not None:
            outside = _of_faulty(state[0], problem, faulty, number, len(y))
        turn = number, number / pace.steps
        state, best = _advance(optimizer, problem, (state, best), turn, pace.rate, inside, outside)
    return state, best[0]


def _of_faulty(z: jax.Array, problem: Objective, faulty: Faulty, number: int, samples: int) -> Seen:
    """Return the block of faulty windows whose turn it is in a step."""
    u, y, ends, real = faulty
    block = number % len(ends)
    taken_u, taken_y = _windows_at(u, y, ends[block], samples)
    return Seen(log_factors(z, problem, taken_u, taken_y), real[block])


def log_factors(z: jax.Array, problem: Objective, u: jax.Array, y: jax.Array) -> LogFactors:
    """Return log t (N,) of windows u (s + 1, m, N), y (s + 1, p, N) under the values exp(z), and its slopes,
    arrays (., N) of b rows.

    Forward mode: a sum over windows, as reverse mode has it, would be fused with the kernel, which is slow.
    Strips take a fraction of the time to compile for one bound after the other; a search is made once for
    all.
    """
    every = np.eye(len(z), dtype=z.dtype)
    if problem.test is None or isinstance(problem.test.shape, Frame):
        log_t, slopes = _slopes_along(z, problem, u, y, every)
        return log_t, (slopes,)
    found = [_slopes_along(z, problem, u, y, along[None]) for along in every]
    return found[0][0], tuple(slope for _, slope in found)


@jax.jit
def _slopes_along(
    z: jax.Array, problem: Objective, u: jax.Array, y: jax.Array, along: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return log t (N,) and its derivatives (k, N) along k directions."""

    def log_t(z: jax.Array) -> jax.Array:
        return jnp.log(jnp.maximum(jnp.nan_to_num(_factors(jnp.exp(z), problem, u, y)), 1e-9))

    def pushed(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(log_t, (z,), (v,))

    pair: tuple[jax.Array, jax.Array] = jax.vmap(pushed, out_axes=(None, 0))(along)
    return pair


@partial(jax.jit, static_argnums=3)
def _windows_at(u: jax.Array, y: jax.Array, ends: jax.Array, samples: int) -> tuple[jax.Array, jax.Array]:
    """Return the windows u (s + 1, m, N), y (s + 1, p, N) that end at some samples of u (T, m), y (T, p)."""
    at = ends[None] + jnp.arange(-samples + 1, 1)[:, None]
    return jnp.moveaxis(u[at], 1, 2), jnp.moveaxis(y[at], 1, 2)


@partial(jax.jit, static_argnums=0)
def _advance(
    optimizer: "optax.GradientTransformation",
    problem: Objective,
    carry: tuple[State, Best],
    turn: tuple[int, float],
    rate: tuple[float, float],
    inside: Seen,
    outside: Seen | None,
) -> tuple[State, Best]:
    """Make one step. turn: its number, and the share of the steps made."""
    (z, inner), best = carry
    _, share = turn
    slope, hard, found = gradient(z, problem, turn, inside, outside)
    updates, after = optimizer.update(jnp.where(jnp.isfinite(slope), slope, 0), inner, z)
    fall = rate[1] + (rate[0] - rate[1]) * 0.5 * (1 + jnp.cos(jnp.pi * share))
    better = found < best[1]
    best = jnp.where(better, z + hard, best[0]), jnp.where(better, found, best[1])
    return (jnp.minimum(z + updates * fall + hard, jnp.log(problem.most)).astype(z.dtype), after), best


def gradient(
    z: jax.Array, problem: Objective, turn: tuple[int, float], inside: Seen, outside: Seen | None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (gradient (b,), logarithm of the factor that these healthy windows need, what the best values
    are chosen by).

    Args:
        turn: the number of the step, and the share of the steps made. inside, outside: healthy and faulty
            windows.
    """
    number, share = turn
    needed, across = _scaled(inside.factors)
    needed = jnp.where(inside.present, needed, -jnp.inf)
    hard, cool = jnp.max(needed), _falling(T, share)
    soft = cool * jax.nn.logsumexp(needed / cool)
    up = across @ jax.nn.softmax(needed / cool)
    sizes = problem.weights * jnp.exp(z)
    narrow = sizes / jnp.sum(sizes) + up
    if outside is None:
        return narrow, hard, jnp.log(jnp.sum(sizes)) + hard
    outer, through = _scaled(outside.factors)
    tau, real = _falling(TAU, share), outside.present
    beyond = jax.nn.sigmoid((outer - soft - problem.log_safety) / tau)
    rate = jnp.where(real, beyond * (1 - beyond) / tau, 0) / jnp.sum(real)
    later = -jnp.asarray(number, z.dtype)  # blocks differ: the last values are taken
    return TIE * narrow - through @ rate + jnp.sum(rate) * up, hard, later


def _scaled(factors: LogFactors) -> tuple[jax.Array, jax.Array]:
    """Return the logarithm of the factor on all values that each window needs, and its gradient."""
    log_t, slopes = factors
    joined = jnp.concatenate(slopes)
    elasticity = jnp.clip(-jnp.sum(joined, 0), 0.05, None)
    return log_t / elasticity, joined / elasticity[None]


def _factors(values: jax.Array, problem: Objective, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the factors t (N,) on all half-widths."""
    bounds = unflatten(problem.fixed + problem.select @ values, problem.sizes)
    if problem.relations is not None:
        windows = (jnp.moveaxis(x, 2, 0) for x in (u, y))
        return 1 - margins(problem.relations.with_bounds(bounds), *windows)[:, -1]
    assert problem.test is not None, "parity relations, in place of uncertain ones"
    test = replace(problem.test, tolerance=bounds["tolerance"], noise=bounds["noise"])
    if "disturbance" in bounds:
        test = replace(test, disturbance=bounds["disturbance"])
    mid, rad, _, known, _ = test.block(u[: test.lags], y)
    if isinstance(test.shape, Frame):
        return 1 - separation_margin(test.shape, mid, rad, known)
    mid, rad = stored((mid, rad))
    return 1 - strip_margin(test.strips, mid, rad, known)


def _falling(ends: tuple[float, float], share: float) -> float:
    """Return the number that falls from ends[0] to ends[1] in equal ratios."""
    number: float = ends[0] * (ends[1] / ends[0]) ** share
    return number
