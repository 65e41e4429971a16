"""How an observer begins: the newest state as it follows from a few samples alone.

With h + 1 samples one above the other, x_0 the first state, O of rows C A^j, and q = B v + w of all steps,

    m = O x_0 + T q + D v + delta,    newest state = A^h x_0 + S q.

K0 is a left inverse of O, K = A^h K0, both exact for the middle of the model, so that there

    newest state = K (m - D v - delta) + R q,    R = S - K T,    x_0 = K0 (m - D v - delta) - K0 T q.

Parameters that deviate from the middle by dA, dB, .. act as more disturbance, q + dA x + dB v, and as more
error of a sample, delta + dC x + dD v: what they move is below |R| (|dA| |x| + |dB| |v|) + |K| (|dC| |x| +
|dD| |v|), x the states of all samples. |x| is below |A^j| |x_0| and what else moves it; |x_0| is below the
same bound of its own equation, |x_0| <= a + N |x_0|, so |x_0| <= (I - N)^-1 a.

With unknown inputs all of this is said of the plant x+ = M (A x + B v + w) + H (m - D v - delta of the next
sample), see `models.unknown_directions`: M A takes the place of A, and q holds samples, too.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple, TypeAlias

import numpy as np

from jaxbound.estimation.zonotope_numbers import ROUNDED, exactly, middle, nearest, numbers
from jaxbound.estimation.zonotope_steps import Numbers, Start
from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Rows, columns_of
from jaxbound.exact.price import refuse_or_say
from jaxbound.models.intervals import IntervalSystem
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import Directions
from jaxbound.sets.floats import rounding

Fractions: TypeAlias = Sequence[Sequence[Fraction]]


class _Middle(NamedTuple):
    """The middle of a plant, exact, and how far its matrices may be from it.

    Fields: A (n, n), C (p, n): of the plant whose unknown inputs are taken out; off_A, off_C: bounds in
    float64, the first before they are; M (n, n), H (n, p): how they are taken out; kept: states that are not
    0 then.
    """

    A: Matrix
    off_A: np.ndarray
    C: Matrix
    off_C: np.ndarray
    M: Matrix
    H: Matrix
    kept: tuple[int, ...]


class _Response(NamedTuple):
    """How a state follows from samples and disturbances at the middle of the model, exact.

    Fields: steps: for each of h steps (n, n) how the state moves with that step's disturbance; samples: for
    each of h + 1 samples (n, p) how with that sample.
    """

    steps: tuple[Matrix, ...]
    samples: tuple[Matrix, ...]


def price(n: int, p: int, horizon: int | None) -> None:
    """Refuse an observer whose beginning would take too long, or say how long it takes.

    Args:
        n, p: states and outputs. horizon: None: the least that can do.

    Raises:
        ValueError: more than ten minutes, extrapolated from 8 to 32 states on one core: right within a factor
            of two or so.
    """
    steps = -(-n // max(p, 1)) if horizon is None else horizon + 1
    seconds = 2.5e-6 * n * steps * p * (steps * p + n) * (1 + (steps * n / 10.0) ** 1.2)
    refuse_or_say(
        seconds,
        f"the equations of how {n} states follow from {steps} samples",
        "reduce the model first, or measure more of its states",
    )


def beginning_horizon(
    linear: LinearSystem | None, system: IntervalSystem, directions: Directions | None = None
) -> int | None:
    """Return the smallest h with which h + 1 samples show all states, at the middle of the model; None if
    none does.

    Args:
        linear: the model, or None of an `interval_system`. directions: of unknown inputs; the states are then
            those that are ever shown. A state that A has forgotten by then need not be.
    """
    plant = _middle_plant(linear, system, directions)
    newest, reached = plant.C, -1
    rows: Matrix = ()
    for h in range(system.n + 1):
        rows += columns_of(newest, plant.kept)
        before, reached = reached, linalg.rank(rows)
        if reached == len(plant.kept) or (directions is not None and _is_forgotten(linear, plant, rows, h)):
            return h
        # one more sample shows no more states, so none ever will (Cayley, Hamilton)
        if reached == before and directions is None:
            return None
        newest = linalg.matmul(newest, plant.A)
    return None


def _is_forgotten(linear: LinearSystem | None, plant: _Middle, rows: Fractions, h: int) -> bool:
    """Return whether rows show all of x_0 that A^h makes anything of; only asked of a certain A."""
    if linear is None or any(u.A is not None for u in linear.uncertainties):
        return False
    power = linalg.identity(len(plant.A))
    for _ in range(h):
        power = linalg.matmul(power, plant.A)
    return linalg.rank([*rows, *columns_of(power, plant.kept)]) == linalg.rank(rows)


def _middle_plant(
    linear: LinearSystem | None, system: IntervalSystem, directions: Directions | None
) -> _Middle:
    """Return the _Middle of a model; of unknown inputs the first way to take them out."""
    (A, off_A), (C, off_C), n = middle(system.A), middle(system.C), system.n
    every = tuple(range(n))
    if directions is None or linear is None:
        unit, nothing = linalg.identity(n), linalg.zeros(n, system.p)
        return _Middle(exactly(A), off_A, exactly(C), off_C, unit, nothing, every)
    way, spread = directions.ways[0], linalg.zeros(n, n)
    for uncertainty in linear.uncertainties:
        rows = uncertainty.on("A")
        if rows:
            spread = _plus(spread, [list(map(abs, row)) for row in rows])
    off_A = rounding.round_up(np.array(spread, object))
    kept = tuple(j for j in every if j not in directions.places)
    return _Middle(linalg.matmul(way.M, linear.A), off_A, linear.C, 0 * off_C, way.M, way.H, kept)


def zonotope_begin(
    linear: LinearSystem | None,
    system: IntervalSystem,
    h: int,
    dtype: np.dtype,
    directions: Directions | None = None,
) -> Start | None:
    """Return how the newest state follows from h + 1 samples alone, see the module.

    Args:
        linear: the model, or None of an `interval_system`. system: with intervals as its entries. directions:
            of unknown inputs, or None.

    Returns:
        The Start; None if samples do not show the state, or parameters are too uncertain for it.
    """
    plant = _middle_plant(linear, system, directions)
    powers = [linalg.identity(system.n)]
    for _ in range(h):
        powers.append(linalg.matmul(plant.A, powers[-1]))
    O = tuple(row for power in powers for row in linalg.matmul(plant.C, power))
    kept = _shown_states(linear, plant, O, h, directions is not None)
    if kept is None:
        return None
    K0 = left_inverse(O, np.tile(system.noise, h + 1), kept)
    response = _response(plant, h, linalg.matmul(powers[h], K0), h)
    float64 = numbers(linear, system, np.dtype(np.float64))
    K, off_K = nearest(linalg.beside(*response.samples), dtype)
    B, D = exactly(middle(system.B)[0]), exactly(middle(system.D)[0])
    moved = [*(linalg.matmul(x, B) for x in response.steps), linalg.zeros(system.n, system.m)]
    through = [linalg.matmul(x, D) for x in response.samples]
    U, off_U = nearest(_plus(linalg.beside(*moved), linalg.beside(*through), -1), dtype)
    pushes = exactly(np.asarray(float64.W))
    nothing = linalg.zeros(system.n, 0)  # no step lies between one sample and itself
    W, off_W = nearest(linalg.beside(nothing, *(linalg.matmul(x, pushes) for x in response.steps)), dtype)
    middles = linalg.multiply(linalg.beside(nothing, *response.steps), exactly(np.tile(float64.w, (1, h)))[0])
    w, off_w = nearest(linalg.transpose([middles]), dtype)
    wide = _deviations(plant, system, powers, K0, response, float64)
    if wide is None:
        return None
    off = np.concatenate([off_K, off_U, off_w + off_W.sum(1, keepdims=True)], 1)
    wide_K, wide_U, wide_w = np.split(
        rounding.round_up((wide + off) * ROUNDED, dtype), [K.shape[1], K.shape[1] + U.shape[1]], 1
    )
    return Start(K, U, w[:, 0], W, wide_K, wide_U, wide_w[:, 0])


def _shown_states(
    linear: LinearSystem | None, plant: _Middle, O: Matrix, h: int, unknown_inputs: bool
) -> tuple[int, ...] | None:
    """Return the states that a left inverse of O does not leave 0; None if O does not show what it must."""
    thin = columns_of(O, plant.kept)
    shown = linalg.row_reduce(thin)[1]
    if len(shown) == len(plant.kept) or (unknown_inputs and _is_forgotten(linear, plant, thin, h)):
        return tuple(plant.kept[i] for i in shown)
    return None


def _response(plant: _Middle, h: int, K: Matrix, number: int) -> _Response:
    """Return the response of state `number` of h + 1, K (n, (h+1) p) times the samples but for disturbances.

    R_j, how a disturbance at step j acts, is R_(j+1) A - K_(j+1) C, and 1 more where the state is the next.
    """
    n, p = len(plant.A), len(plant.C)
    samples = [tuple(row[i * p : (i + 1) * p] for row in K) for i in range(h + 1)]
    R: list[Matrix] = []
    for j in reversed(range(h)):
        ahead = linalg.matmul(R[0], plant.A) if R else linalg.zeros(n, n)
        if j + 1 == number:
            ahead = _plus(ahead, linalg.identity(n))
        R.insert(0, _plus(ahead, linalg.matmul(samples[j + 1], plant.C), -1))
    # samples are steps, too: each takes out the unknown inputs before it
    for j in range(h):
        samples[j + 1] = _plus(samples[j + 1], linalg.matmul(R[j], plant.H))
    return _Response(tuple(linalg.matmul(x, plant.M) for x in R), tuple(samples))


def _deviations(
    plant: _Middle,
    system: IntervalSystem,
    powers: Sequence[Matrix],
    K0: Matrix,
    newest: _Response,
    float64: Numbers,
) -> np.ndarray | None:
    """Return bounds (n, (h+1) (p + m) + 1) of what uncertain parameters add to the newest state, for each |m|
    + s, each |v|, and beside; None where they may add anything. newest: its response.
    """
    n, m, p, h = system.n, system.m, system.p, len(powers) - 1
    (B, off_B), (D, off_D) = middle(system.B), middle(system.D)
    B, D = np.abs(B) + off_B, np.abs(D) + off_D
    # bounds are (.., n + (h+1) p + (h+1) m + 1), what they are for each |x_0|, |m| + s, |v|, and beside
    of = np.eye(n + (h + 1) * (p + m) + 1)
    first, seen, v, one = np.split(of, [n, n + (h + 1) * p, len(of) - 1])
    v = v.reshape(h + 1, m, len(of))
    seen = D @ v + seen.reshape(h + 1, p, len(of))
    pushed = (np.abs(float64.w) + np.abs(float64.W).sum(1) + float64.wide_w)[:, None] * one
    x = _reach(plant, powers, first, seen, B @ v[:-1] + pushed)
    on_x = _acting(newest, plant.off_C @ x, plant.off_A @ x[:-1])
    off = on_x + _acting(newest, off_D @ v, off_B @ v[:-1] + float64.wide_w[:, None] * one)
    if on_x[:, :n].any():
        moved = B @ v[:-1] + pushed + plant.off_A @ x[:-1]
        of_first = _acting(_response(plant, h, K0, 0), seen + plant.off_C @ x, moved)
        bound = _inverse_above(of_first[:, :n] * ROUNDED)
        if bound is None:
            return None
        off += off[:, :n] @ bound @ of_first
    return np.asarray(off[:, n:])


def _reach(
    plant: _Middle, powers: Sequence[Matrix], first: np.ndarray, seen: np.ndarray, moved: np.ndarray
) -> np.ndarray:
    """Return bounds of all states: what A^j makes of the first one, and what samples and steps add."""
    A, M, H = _sizes(plant.A), _sizes(plant.M), _sizes(plant.H)
    x, rest = [first], 0 * first
    for j, power in enumerate(powers[1:]):
        rest = A @ rest + M @ (plant.off_A @ x[j] + moved[j]) + H @ seen[j + 1]
        x.append(_sizes(power) @ first + rest)
    return np.stack(x)


def _acting(response: _Response, samples: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the bound of what errors of samples (h+1, p, .) and of steps (h, n, .) make of a state."""
    width, nothing = samples.shape[-1], linalg.zeros(len(response.samples[0]), 0)
    K, R = _sizes(linalg.beside(*response.samples)), _sizes(linalg.beside(nothing, *response.steps))
    return np.asarray(K @ samples.reshape(-1, width) + R @ steps.reshape(-1, width))


def left_inverse(O: Matrix, noise: np.ndarray, kept: Sequence[int]) -> Matrix:
    """Return K0 with K0 O x = x exactly, of least squares weighted by the noise of the rows, for x that is 0
    but at `kept`. Weights are within twelve digits of each other, all 1 where nothing has noise.

    One elimination of (O, I) gives L with L O = I and N with N O = 0. Then K0 = L - L V N' (N V N')^-1 N, V =
    diag(1 / weights), which is (O' V^-1 O)^-1 O' V^-1, whose elimination would have twice the digits.
    """
    reduced, _ = linalg.row_reduce(linalg.beside(columns_of(O, kept), linalg.identity(len(O))))
    K0, N = (
        columns_of(rows, range(len(kept), len(kept) + len(O)))
        for rows in (reduced[: len(kept)], reduced[len(kept) :])
    )
    if N:
        most = noise.max() if noise.max() * 1e-6 else 1.0
        # exact numbers from here on: K0 has to cancel x_0 without a rest
        weight = [Fraction(x) for x in (1 / np.maximum(noise / most, 1e-6) ** 2).tolist()]
        VN = linalg.transpose([[x / v for x, v in zip(row, weight, strict=True)] for row in N])
        across = linalg.matmul(linalg.matmul(K0, VN), linalg.inverse(linalg.matmul(N, VN)))
        K0 = _plus(K0, linalg.matmul(across, N), -1)
    rows, nothing = dict(zip(kept, K0, strict=True)), (Fraction(0),) * len(O)
    return tuple(rows.get(j, nothing) for j in range(len(O[0])))


def _inverse_above(X: np.ndarray) -> np.ndarray | None:
    """Return a matrix M >= (I - X)^-1, entry by entry, for X >= 0; None if it is not proved to exist.

    If (I - X) M >= I for some M >= 0 then I - X has a non-negative inverse (its off-diagonal is <= 0), which
    M is not below.
    """
    n = len(X)
    try:
        M = np.linalg.inv(np.eye(n) - X)
    except np.linalg.LinAlgError:
        return None
    # a little more than the inverse, so that rounding leaves (I - X) M >= I to be seen
    M = np.asarray(M + 1e-6 * np.abs(M).sum(1, keepdims=True))
    rest = M - X @ M - np.eye(n)
    if not ((M >= 0).all() and (rest > 1e-9 * (M + X @ M + np.eye(n))).all()):
        return None
    return M


def _sizes(rows: Rows) -> np.ndarray:
    """Return the magnitudes of exact rows, to nearest in float64."""
    floats = np.array([[float(x) for x in row] for row in rows], float).reshape(len(rows), -1)
    return np.asarray(np.abs(floats))


def _plus(a: Fractions, b: Fractions, factor: int = 1) -> Matrix:
    """Return a matrix plus a factor times another."""
    return tuple(linalg.add_multiple(x, factor, y) for x, y in zip(a, b, strict=True))
