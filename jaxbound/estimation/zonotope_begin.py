"""How an observer begins: the newest state as it follows from a few samples alone.

With h + 1 samples one above the other, x the first state and q = B v + w of all steps,

    m = O x + T q + D v + delta,    newest state = A^h x + S q.

K0 is a left inverse of O, K = A^h K0, both exact for the middle of the model, so that there

    newest state = K (m - D v - delta) + R q,    R = S - K T.

Within the bounds of the model A^j is off by at most W_j, W_(j+1) = (|A| + wide) W_j + wide |A^j|, which
bounds the errors of O, T and S; they act on |x| <= (I - |K0| wide_O)^-1 |K0| (|m| + s + |D v| + |T q|), and
on q.

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
from jaxbound.exact.linalg import Matrix, Rows
from jaxbound.exact.price import refuse_or_say
from jaxbound.models.intervals import IntervalSystem
from jaxbound.models.system import LinearSystem
from jaxbound.models.unknown_directions import Directions
from jaxbound.sets.floats import rounding

__all__ = ["least_horizon", "left_inverse", "price", "zonotope_begin"]

Fractions: TypeAlias = Sequence[Sequence[Fraction]]


class _Middle(NamedTuple):
    """The middle of a plant, exact, and how far its matrices may be from it.

    Fields: A (n, n), C (p, n): of the plant whose unknown inputs are taken out; off_A, off_C: bounds in
    float64; M (n, n), H (n, p): how they are taken out, or None without any; places: states that are 0 then.
    """

    A: Matrix
    off_A: np.ndarray
    C: Matrix
    off_C: np.ndarray
    M: Matrix | None
    H: Matrix | None
    places: tuple[int, ...]


class _Response(NamedTuple):
    """How the newest state follows from samples, inputs and disturbances at the middle of the model, exact.

    Fields: first (n, (h+1) p): K of samples alone; K: with the samples that take unknown inputs out; steps:
    for each step (n, n) how the state moves with that step's disturbance.
    """

    first: Matrix
    K: Matrix
    steps: tuple[Matrix, ...]
    samples: tuple[Matrix, ...]


class _Errors(NamedTuple):
    """Bounds of the errors that uncertain parameters make in O, T and S.

    Fields: state (h + 1 of (n, n)): of powers of A; seen (h + 1 of (p, n)): of C times them; reach: the size
    of C times them, errors included.
    """

    state: list[np.ndarray]
    seen: list[np.ndarray]
    reach: list[np.ndarray]


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


def least_horizon(
    linear: LinearSystem | None, system: IntervalSystem, directions: Directions | None = None
) -> int | None:
    """Return the smallest h with which h + 1 samples show all states, at the middle of the model; None if
    none does.

    Args:
        linear: the model, or None of an `interval_system`. directions: of unknown inputs; the states are then
            those that are ever shown. A state that A has forgotten by then need not be.
    """
    plant = _middle_plant(linear, system, directions)
    wanted, newest, reached = system.n - len(plant.places), plant.C, 0
    rows: list[Sequence[Fraction]] = []
    for h in range(system.n + 1):
        rows += _without(newest, plant.places)
        before, reached = reached, linalg.rank(rows)
        if reached == wanted:
            return h
        if directions is not None and _is_forgotten(linear, plant, rows, h):
            return h
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
    return linalg.rank([*rows, *_without(power, plant.places)]) == linalg.rank(rows)


def _middle_plant(
    linear: LinearSystem | None, system: IntervalSystem, directions: Directions | None
) -> _Middle:
    """Return the _Middle of a model; of unknown inputs the first way to take them out."""
    if directions is None or linear is None:
        (A, off_A), (C, off_C) = middle(system.A), middle(system.C)
        return _Middle(exactly(A), off_A, exactly(C), off_C, None, None, ())
    n, way = system.n, directions.ways[0]
    spread = linalg.zeros(n, n)
    for uncertainty in linear.uncertainties:
        rows = uncertainty.on("A")
        if rows:
            spread = _matrix_sum(spread, [[abs(x) for x in row] for row in rows])
    off_A = rounding.round_up(np.array(spread, object))
    return _Middle(
        linalg.matmul(way.M, linear.A),
        _sizes(way.M) * ROUNDED @ off_A * ROUNDED,
        linear.C,
        np.zeros((system.p, n)),
        way.M,
        way.H,
        directions.places,
    )


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
    places = _hidden_places(linear, plant, O, h, directions is not None)
    if places is None:
        return None
    K0 = left_inverse(O, np.tile(system.noise, h + 1), places)
    response = _response(plant, powers, K0)
    float64 = numbers(linear, system, np.dtype(np.float64))
    K, off_K = nearest(response.K, dtype)
    U, off_U = nearest(_of_inputs(response, system), dtype)
    W, off_W = nearest(
        _beside([linalg.matmul(x, exactly(np.asarray(float64.W))) for x in response.steps], system.n), dtype
    )
    w, off_w = nearest(_of_middle(response, float64), dtype)
    wide = _deviations(plant, system, powers, K0, response, float64)
    if wide is None:
        return None
    wide_K, wide_U, wide_w = wide

    def up(x: np.ndarray) -> np.ndarray:
        return rounding.round_up(x * ROUNDED, dtype)

    return Start(
        K,
        U,
        w[:, 0],
        W,
        wide_K=up(wide_K + off_K),
        wide_U=up(wide_U + off_U),
        wide=up(wide_w + off_w[:, 0] + off_W.sum(1)),
    )


def _hidden_places(
    linear: LinearSystem | None, plant: _Middle, O: Matrix, h: int, unknown_inputs: bool
) -> tuple[int, ...] | None:
    """Return the states that a left inverse of O leaves 0; None if O does not show the others."""
    n, thin = len(plant.A), _without(O, plant.places)
    if linalg.rank(thin) >= n - len(plant.places):
        return plant.places
    if not unknown_inputs or not _is_forgotten(linear, plant, thin, h):
        return None
    there = [j for j in range(n) if j not in plant.places]
    shown = {there[i] for i in linalg.row_reduce(thin)[1]}
    return tuple(j for j in range(n) if j not in shown)


def _response(plant: _Middle, powers: Sequence[Matrix], K0: Matrix) -> _Response:
    """Return the response at the middle of the model; R_j is how a disturbance at step j of h acts.

    R_j is A^(h-1-j) less the part that the samples behind it say of it: R_(j+1) A - K_(j+1) C.
    """
    p, h = len(plant.C), len(powers) - 1
    K = linalg.matmul(powers[h], K0)
    samples = [tuple(row[i * p : (i + 1) * p] for row in K) for i in range(h + 1)]
    R: list[Matrix] = []
    for j in reversed(range(h)):
        ahead = linalg.matmul(R[0], plant.A) if R else powers[0]
        R.insert(0, _matrix_difference(ahead, linalg.matmul(samples[j + 1], plant.C)))
    if plant.M is None or plant.H is None:
        return _Response(K, K, tuple(R), tuple(samples))
    # samples are steps, too: each takes out the unknown inputs before it
    for j in range(h):
        samples[j + 1] = _matrix_sum(samples[j + 1], linalg.matmul(R[j], plant.H))
    steps = tuple(linalg.matmul(x, plant.M) for x in R)
    return _Response(K, _beside(samples, len(K)), steps, tuple(samples))


def _of_inputs(response: _Response, system: IntervalSystem) -> Matrix:
    """Return (n, (h+1) m): how the newest state follows from the inputs of all samples."""
    B, D = exactly(middle(system.B)[0]), exactly(middle(system.D)[0])
    moved = [*(linalg.matmul(x, B) for x in response.steps), linalg.zeros(system.n, system.m)]
    through = [linalg.matmul(x, D) for x in response.samples]
    return _beside([_matrix_difference(a, b) for a, b in zip(moved, through, strict=True)], system.n)


def _of_middle(response: _Response, plant: Numbers) -> Matrix:
    """Return (n, 1): how far the middle of disturbances moves the newest state."""
    w = [Fraction(float(x)) for x in plant.w]
    total = linalg.zeros(len(w), 1)
    for step in response.steps:
        total = _matrix_sum(total, [(x,) for x in linalg.multiply(step, w)])
    return total


def _deviations(
    plant: _Middle,
    system: IntervalSystem,
    powers: Sequence[Matrix],
    K0: Matrix,
    response: _Response,
    float64: Numbers,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return bounds (n, (h+1) p), (n, (h+1) m), (n,) of what uncertain parameters add to the newest state,
    for each |m| + s, each |v|, and beside; None where they may add anything.
    """
    n, p, h = system.n, system.p, len(powers) - 1
    (B, off_B), (D, off_D) = middle(system.B), middle(system.D)
    size_M = np.eye(n) * ROUNDED
    size_H = np.zeros((n, p))
    if plant.M is not None and plant.H is not None:
        size_M, size_H = _sizes(plant.M) * ROUNDED, _sizes(plant.H) * ROUNDED
    errors = _errors(plant, powers)
    size_K0, size_K, first_K = _sizes(K0), _sizes(response.K), _sizes(response.first)
    O_off = np.concatenate(errors.seen)
    bound = _inverse_above(size_K0 @ O_off * ROUNDED)
    if bound is None:
        return None
    T, T_off = _staircase(errors.reach), _staircase(errors.seen)
    S_off = np.zeros((n, 0))
    if h:
        S_off = np.concatenate([errors.state[h - 1 - j] for j in range(h)], 1)
    B_all = _of_each_step(size_M @ (np.abs(B) + off_B), h, system.m)
    off_B_all = _of_each_step(off_B, h, system.m)
    D_all, off_D_all = np.kron(np.eye(h + 1), np.abs(D) + off_D), np.kron(np.eye(h + 1), off_D)
    H_all = np.concatenate([np.zeros((h * n, p)), np.kron(np.eye(h), size_H)], 1)
    pushed = np.tile(size_M @ (np.abs(float64.w) + np.abs(float64.W).sum(1) + float64.wide_w), h)
    steps = _sizes(_beside(response.steps, n))
    # errors act on the first state, which samples bound, and on what moves the state
    on_x, on_q = errors.state[h] + first_K @ O_off, S_off + first_K @ T_off
    of_x = on_x @ bound @ size_K0
    of_q = on_q + of_x @ T
    wide_U = of_q @ (B_all + H_all @ D_all) + steps @ off_B_all + size_K @ off_D_all + of_x @ D_all
    wide = of_q @ pushed + steps @ np.tile(float64.wide_w, h)
    return of_x + of_q @ H_all, wide_U, wide


def _errors(plant: _Middle, powers: Sequence[Matrix]) -> _Errors:
    """Return the errors that uncertain parameters make in powers of A, and in C times them."""
    n, h = len(plant.A), len(powers) - 1
    sizes = [_sizes(power) for power in powers]
    most_A = _sizes(plant.A) + plant.off_A
    size_C = _sizes(plant.C)
    most_C = size_C + plant.off_C
    state = [np.zeros((n, n))]
    for j in range(h):
        state.append(most_A @ state[j] + plant.off_A @ sizes[j])
    seen = [most_C @ off + plant.off_C @ size for off, size in zip(state, sizes, strict=True)]
    reach = [size_C @ size + off for off, size in zip(seen, sizes, strict=True)]
    return _Errors(state, seen, reach)


def _staircase(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Return ((h+1) p, h n): in row i and column j < i the block i - 1 - j of h + 1 blocks (p, n)."""
    h, (p, n) = len(blocks) - 1, blocks[0].shape
    out = np.zeros((h + 1, p, h, n))
    for i in range(h + 1):
        for j in range(i):
            out[i, :, j] = blocks[i - 1 - j]
    return out.reshape((h + 1) * p, h * n)


def _of_each_step(M: np.ndarray, h: int, last: int) -> np.ndarray:
    """Return M once for each of h steps, on a diagonal, with `last` columns of zeros behind."""
    return np.concatenate([np.kron(np.eye(h), M), np.zeros((h * len(M), last))], 1)


def left_inverse(O: Matrix, noise: np.ndarray, places: Sequence[int] = ()) -> Matrix:
    """Return K0 with K0 O x = x exactly, of least squares weighted by the noise of the rows, for x with 0 at
    some places.

    One elimination of (O, I) gives L with L O = I and N with N O = 0. Then K0 = L - L V N' (N V N')^-1 N, V =
    diag(1 / weights), which is (O' V^-1 O)^-1 O' V^-1, whose elimination would have twice the digits.
    """
    thin, columns = _without(O, places), len(O[0]) - len(places)
    unit = linalg.identity(len(O))
    reduced, _ = linalg.row_reduce([(*row, *more) for row, more in zip(thin, unit, strict=True)])
    L = [row[columns:] for row in reduced[:columns]]
    N = [row[columns:] for row in reduced[columns:]]
    K0: Fractions = L
    if N:
        weight = _weights(noise)
        VN = linalg.transpose([[x / v for x, v in zip(row, weight, strict=True)] for row in N])
        across = linalg.matmul(linalg.matmul(L, VN), linalg.inverse(linalg.matmul(N, VN)))
        K0 = _matrix_difference(L, linalg.matmul(across, N))
    rows = iter(K0)
    nothing = (Fraction(0),) * len(O)
    out = []
    for j in range(len(O[0])):
        out.append(nothing if j in places else tuple(next(rows)))
    return tuple(out)


def _weights(noise: np.ndarray) -> list[Fraction]:
    """Return weights 1 / noise^2 of rows, within twelve digits of each other; 1 where nothing has noise."""
    most = noise.max()
    if not most * 1e-6:
        return [Fraction(1)] * len(noise)
    return [Fraction(float(x)) for x in 1 / np.maximum(noise / most, 1e-6) ** 2]


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
    M = np.asarray(M + 1e-6 * np.abs(M).sum(1, keepdims=True))
    rest = M - X @ M - np.eye(n)
    if not ((M >= 0).all() and (rest > 1e-9 * (M + X @ M + np.eye(n))).all()):
        return None
    return M


def _sizes(rows: Rows) -> np.ndarray:
    """Return the magnitudes of exact rows, to nearest in float64."""
    floats = np.array([[float(x) for x in row] for row in rows], float).reshape(len(rows), -1)
    return np.asarray(np.abs(floats))


def _without(rows: Fractions, places: Sequence[int]) -> list[tuple[Fraction, ...]]:
    """Return rows without some columns."""
    return [tuple(x for j, x in enumerate(row) if j not in places) for row in rows]


def _matrix_difference(a: Fractions, b: Fractions) -> Matrix:
    """Return a matrix less another."""
    return tuple(tuple(x - y for x, y in zip(*pair, strict=True)) for pair in zip(a, b, strict=True))


def _matrix_sum(a: Fractions, b: Fractions) -> Matrix:
    """Return a matrix plus another."""
    return tuple(tuple(x + y for x, y in zip(*pair, strict=True)) for pair in zip(a, b, strict=True))


def _beside(blocks: Sequence[Fractions], n: int) -> Matrix:
    """Return matrices of n rows side by side."""
    return tuple(tuple(x for block in blocks for x in block[i]) for i in range(n))
