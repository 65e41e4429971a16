"""A window as one static equation: the two static forms, exact.

| paper | here | |
|---|---|---|
| C_{s,0} | O | rows of the outputs on the first state, ((s+1)p, n) |
| H_{s,0} | H | rows of the outputs on the inputs, ((s+1)p, l) |
| | V | rows of the outputs on the disturbances w_k .. w_{k+s-1}, ((s+1)p, gs) |
| | G_v | rows of the outputs on the unknown inputs v_k .. v_{k+s-1}, and v_{k+s} too if D_v is not zero |
| L_0, M, N | L, M, N | outputs on all states; dynamics; inputs |

Rows are time-major: y_k, then y_{k+1}, ... The inputs are u_k .. u_{k+s-1}, and u_{k+s} too if the model has
feedthrough D.

Source: Adrot, Maquin, Ragot 2000, (3), (10), (12).
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import chain, starmap
from operator import mul

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector, Whole
from jaxbound.models.rows import Row, WindowRows
from jaxbound.models.system import LinearSystem

ZERO = Fraction(0)


def input_lags(model: LinearSystem, horizon: int) -> int:
    """Return how many samples of u a window of s + 1 outputs depends on: s, or s + 1 with feedthrough."""
    return horizon + 1 if model.has_feedthrough else horizon


def unknown_lags(model: LinearSystem, horizon: int) -> int:
    """Return how many samples of v a window of s + 1 outputs depends on: s, or s + 1 with D_v."""
    if not model.d:
        return 0
    return horizon + 1 if model.has_direct_unknown else horizon


@lru_cache(maxsize=64)
def window_rows(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None = None) -> WindowRows:
    """Return the rows of a model's windows of horizon + 1 samples. lags: see `parity_relations`."""
    sums = tuple(bounded.weighted_sum(model.outputs) for bounded in model.averages)
    return WindowRows(model.p, model.g, horizon, lags, sums)


def unbounded(model: LinearSystem, horizon: int) -> Matrix:
    """Return [O G_v], all that has no bound; its first rows are those of a shorter horizon, filled up with
    zeros.
    """
    blocks = _outputs_on_state(model, horizon)
    through = _toeplitz(blocks, model.F, model.D_v, unknown_lags(model, horizon))
    return linalg.beside(tuple(chain.from_iterable(blocks)), through)


@lru_cache(maxsize=8)
def _outputs_on_state(model: LinearSystem, horizon: int) -> tuple[Matrix, ...]:
    """Return C, CA, .., CA^s."""
    out = [model.C]
    for _ in range(horizon):
        out.append(linalg.matmul(out[-1], model.A))
    return tuple(out)


def _toeplitz(outputs_on_state: Sequence[Matrix], drive: Matrix, direct: Matrix, lags: int) -> Matrix:
    """Return the rows of the outputs on a signal that acts by `drive` on the state and by `direct` on the
    outputs, `lags` samples of it.
    """
    width, p = len(direct[0]), len(direct)
    if not width:
        return ((),) * (p * len(outputs_on_state))
    responses = [direct]  # to one sample, so many samples later
    for block in outputs_on_state[:-1]:
        responses.append(linalg.matmul(block, drive) if drive else linalg.zeros(p, width))
    rows: list[Vector] = []
    for j in range(len(outputs_on_state)):
        # sample k acts on y_j by its response j - k samples later; later ones not at all
        past = [responses[j - k] for k in range(min(j + 1, lags))]
        later = linalg.zeros(p, width * (lags - len(past)))
        rows += linalg.beside(*past, later)
    return tuple(rows)


def first_form(model: LinearSystem, horizon: int) -> tuple[Matrix, Matrix]:
    """Return (O, H) with Y = O x_k + H U for an exact plant. Source: (3)."""
    blocks = _outputs_on_state(model, horizon)
    return tuple(chain.from_iterable(blocks)), _toeplitz(blocks, model.B, model.D, input_lags(model, horizon))


def disturbance_form(model: LinearSystem, horizon: int) -> Matrix:
    """Return V with Y = O x_k + H U + V w for an exact plant."""
    none = linalg.zeros(model.p, model.g)  # a disturbance acts on the next state first
    return _toeplitz(_outputs_on_state(model, horizon), model.G, none, horizon)


@lru_cache(maxsize=8)  # a matrix of 61 samples holds some ten thousand fractions
def unknowns(model: LinearSystem, horizon: int) -> tuple[tuple[Whole, ...], tuple[Whole, ...]]:
    """Return (E, K): all that bounds speak of in a window, on its unknowns and inputs, for an exact plant.

    The rows are the (s+1)p true outputs Y and the gs disturbances w, which count as rows of their own: (Y, w)
    = E (x_k, w, v) + K U, E = [O V G_v; 0 I 0], K = [H; 0]; then those of bounded sums, a = F (Y, w):
    weighted sums of rows before.
    """
    O, H = first_form(model, horizon)
    V = disturbance_form(model, horizon)
    G_v = tuple(row[model.n :] for row in unbounded(model, horizon))
    count = model.g * horizon
    # the disturbances as rows of their own: 1 at themselves
    own = linalg.beside(
        linalg.zeros(count, model.n), linalg.identity(count), linalg.zeros(count, len(G_v[0]))
    )
    E = linalg.beside(O, V, G_v) + own
    K = H + linalg.zeros(count, model.m * input_lags(model, horizon))
    return _with_sums(model, horizon, E), _with_sums(model, horizon, K)


@lru_cache(maxsize=64)
def actions(model: LinearSystem, horizon: int, on_states: Vector, on_outputs: Vector) -> tuple[Whole, ...]:
    """Return the rows of `unknowns` on s + 1 samples of a signal that acts on states and on outputs."""
    drive, direct = (tuple((x,) for x in column) for column in (on_states, on_outputs))
    rows = _toeplitz(_outputs_on_state(model, horizon), drive, direct, horizon + 1)
    return _with_sums(model, horizon, rows + linalg.zeros(model.g * horizon, horizon + 1))


def _with_sums(model: LinearSystem, horizon: int, single: Matrix) -> tuple[Whole, ...]:
    """Return the rows of single samples with those of bounded sums behind them."""
    rows = window_rows(model, horizon)
    whole = list(starmap(Whole, map(linalg.integers, single)))
    if not rows.of_sums:
        return tuple(whole)
    # one denominator for all: sums of rows are sums of whole numbers
    numbers, over = linalg.over_one(whole)
    for row in rows.of_sums:
        terms = rows.terms(row)
        weights, under = linalg.integers([term.weight for term in terms])
        columns = zip(*(numbers[term.row] for term in terms), strict=True)
        whole.append(Whole(tuple(sum(map(mul, weights, column)) for column in columns), under * over))
    return tuple(whole)


class ParameterForm:
    """(E, K) of `unknowns` where a parameter of the plant is another from a sample on: A + f dA, B + f
    dB, C + f dC. Call it with f and that sample.

    Args:
        coefficients: {letter: its coefficient in that matrix}. kind: Fraction for exact arrays (rows, .) of
            Fractions, float for arrays of floats.
    """

    def __init__(
        self, model: LinearSystem, horizon: int, coefficients: Mapping[str, Matrix], kind: type
    ) -> None:
        self.horizon, self.zero, self.n = horizon, kind(0), model.n
        g, d, m = model.g, model.d, model.m
        letters = "A", "B", "C", "D", "G", "F", "D_v"
        self.before = dict(zip(letters, model_matrices(model, letters, kind), strict=True))
        self.changes = {letter: _array(rows, kind) for letter, rows in coefficients.items()}
        widths = {
            "w": (g, horizon),
            "v": (d, unknown_lags(model, horizon)),
            "u": (m, input_lags(model, horizon)),
        }
        self.at, self.width = {}, model.n  # columns of each sample of a signal, and of all
        for signal, (width, lags) in widths.items():
            if signal == "u":
                self.known = self.width
            self.at[signal] = [
                slice(self.width + width * k, self.width + width * (k + 1)) for k in range(lags)
            ]
            self.width += width * lags
        self.disturbances = g * horizon
        rows = window_rows(model, horizon)
        spread = [_spread(rows, row) for row in rows.of_sums]
        self.sums = _array(spread, kind).reshape(len(spread), rows.single)

    def __call__(self, size: Fraction | float, since: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Return (E, K), arrays."""
        after = dict(self.before)
        for letter, change in self.changes.items():
            after[letter] = self.before[letter] + size * change
        # the state as rows over all unknowns: first of itself, then moved on sample by sample
        state: np.ndarray = np.full((self.n, self.width), self.zero)
        state[:, : self.n] += np.eye(self.n, dtype=int)
        rows = []
        for k in range(self.horizon + 1):
            now = self.before
            if k >= since:
                now = after
            rows.append(self._moved(k, now["C"] @ state, {"v": now["D_v"], "u": now["D"]}))
            if k == self.horizon:
                break
            state = self._moved(k, now["A"] @ state, {"w": now["G"], "v": now["F"], "u": now["B"]})
        own: np.ndarray = np.full((self.disturbances, self.width), self.zero)
        own[:, self.n : self.n + len(own)] += np.eye(len(own), dtype=int)
        single = np.concatenate([*rows, own])
        # adding the zero keeps Fractions where a product has no terms
        whole = np.concatenate([single, self.sums @ single + self.zero])
        return whole[:, : self.known], whole[:, self.known :]

    def _moved(self, k: int, rows: np.ndarray, by: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return rows with what sample k of some signals adds; by: {signal: its matrix}."""
        rows = rows + self.zero  # an array of its own, of Fractions also where a product of nothing is 0
        for signal, matrix in by.items():
            if k < len(self.at[signal]):
                rows[:, self.at[signal][k]] += matrix
        return rows


def model_matrices(model: LinearSystem, letters: Iterable[str], kind: type = float) -> list[np.ndarray]:
    """Return matrices of a model in floats, or as Fractions, (rows, columns) where either may be 0."""
    n, m, p, g, d = model.n, model.m, model.p, model.g, model.d
    # without rows or columns a matrix has lost its width
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m), "G": (n, g), "F": (n, d), "D_v": (p, d)}
    return list(map(lambda name: _array(getattr(model, name), kind).reshape(shapes[name]), letters))


def _array(rows: Sequence[Sequence[Fraction]], kind: type) -> np.ndarray:
    """Return a matrix as an array of floats, or of Fractions."""
    dtype: type = object
    if kind is float:
        dtype = float
    return np.array([list(map(kind, row)) for row in rows], dtype)


def _spread(rows: WindowRows, row: Row) -> list[Fraction]:
    """Return a row's weight of each row that speaks of one sample."""
    weights = [ZERO] * rows.single
    for term in rows.terms(row):
        weights[term.row] = term.weight
    return weights


def second_form(model: LinearSystem, horizon: int) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return (L, M, N, H) with Y = L X + H U and M X = N U for an exact plant, X = (x_k, .., x_{k+s}, v_k,
    ..). Source: (10)-(12).
    """
    s, n, m, d = horizon, model.n, model.m, model.d
    lags, unknown = input_lags(model, s), unknown_lags(model, s)
    L, M, N, H = [], [], [], []
    for j in range(s + 1):
        for i in range(model.p):
            L.append(_block_row(s + 1, n, {j: model.C[i]}) + _block_row(unknown, d, {j: model.D_v[i]}))
            H.append(_block_row(lags, m, {j: model.D[i]}))
    for j in range(s):
        for i, one in enumerate(linalg.identity(n)):
            step = {j: model.A[i], j + 1: linalg.scale(one, -1)}
            M.append(_block_row(s + 1, n, step) + _block_row(unknown, d, {j: model.F[i]}))
            N.append(_block_row(lags, m, {j: linalg.scale(model.B[i], -1)}))
    return tuple(L), tuple(M), tuple(N), tuple(H)


def _block_row(count: int, width: int, blocks: Mapping[int, Vector]) -> Vector:
    """Return a row of so many blocks of one width, zeros where none is given."""
    row: list[Fraction] = []
    for j in range(count):
        row += blocks.get(j, (ZERO,) * width)
    return tuple(row)
