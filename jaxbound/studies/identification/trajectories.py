"""Trajectories of a model that explain whole recordings, by linear programs over all their samples.

Unknown are the first state of each stretch, the disturbance w_k of each step and the error v_k of each
reading:

    x_{k+1} = A x_k + B u_k + G w_k,    y_k = C x_k + D u_k + v_k,    |v_i| <= t noise_i,  |w_j| <= t limit_j

The least t explains a recording from start to end. No test that is sound calls a sample of it a FAULT under
bounds t times those of the model: the trajectory is a witness for each of its windows, and for an observer.
Numbers here are floats of HiGHS; verdicts under bounds that are rounded up prove them.
"""

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.records import Record

__all__ = ["added_fault", "hidden_size", "least_factor", "refuse_kind", "sure_sizes"]

Sizes: TypeAlias = dict[str, float]
"""{output: size}."""
Sparse: TypeAlias = Any
"""A sparse matrix of SciPy, which is imported where one is made."""
SEEN = ("bias", "drift")
"""Kinds of faults that enter a recording linearly."""
LONG = 500
"""Samples from which on an interior point costs less than the simplex: its time grows with their number."""


def least_factor(model: LinearSystem, part: Record) -> float:
    """Return the least factor on the noise and the disturbances of a model that explains a recording.

    Args:
        model: without tolerances and uncertainties. part: (u (T, m), y (T, p), starts), NaN where a sample is
            missing; a state begins anew at each of `starts` and behind a missing input.

    Returns:
        The factor, inf where none will do: a step that no noise and no disturbance explains.
    """
    from scipy.sparse import block_array, csr_array, eye_array

    rows = _Rows.of(model, part)
    if not len(rows.left):
        return 0.0
    one = eye_array(rows.walks)
    within, ones = csr_array(-rows.limit[:, None]), csr_array(-np.ones((rows.walks, 1)))
    upper = block_array(
        [
            [rows.seen, None, within],
            [-rows.seen, None, within],
            [None, one, ones],
            [None, -one, ones],
        ]
    )
    left = np.concatenate([rows.left, -rows.left, np.zeros(2 * rows.walks)])
    acts = np.zeros(len(rows.known))
    return _extreme(rows, upper, left, acts, 1.0, walk=(None, None), last=(0, None))


def hidden_size(model: LinearSystem, part: Record, fault: Fault) -> float:
    """Return the largest size, of either sign, of a fault that could be in a recording under the bounds of a
    model: any larger one, added to it, is seen by its last sample. inf: whatever the size.

    Args:
        model, part: as of `least_factor`; the bounds of the model must explain the recording. fault: a bias
            or a drift from sample `start` on; its size is not read.
    """
    from scipy.sparse import block_array, csr_array

    rows = _Rows.of(model, part)
    acts, wrong = _fault(rows, model, fault)
    column, apart = csr_array(wrong[:, None]), csr_array((len(wrong), rows.walks))
    upper = block_array([[rows.seen, apart, -column], [-rows.seen, apart, column]])
    left = np.concatenate([rows.limit + rows.left, rows.limit - rows.left])
    sizes = []
    for sign in (1.0, -1.0):
        largest = _extreme(rows, upper, left, acts, -sign, walk=(-1, 1), last=(None, None))
        sizes.append(abs(largest))
    return max(sizes)


def sure_sizes(model: LinearSystem, before: int, within: int, after: int) -> tuple[Sizes, Sizes, Sizes]:
    """Return (jump, lasting, ramp), {output: size} each: errors of one output that no noise hides from an
    exact test of all samples; inf where there is none.

    A jump is seen `within` so many samples, a bias that lasts, and a ramp by its last size, `after` so many;
    as many as `before` go before each. On a recording without any noise an error of half the size is seen.
    """
    jump, lasting, ramp = {}, {}, {}
    for name in model.outputs:
        bias, drift = Fault(name, "bias", 1.0, before), Fault(name, "drift", 1.0, before)
        jump[name] = 2 * hidden_size(model, _rest(model, before + within), bias)
        lasting[name] = 2 * hidden_size(model, _rest(model, before + after), bias)
        ramp[name] = 2 * after * hidden_size(model, _rest(model, before + after), drift)
    return jump, lasting, ramp


def _rest(model: LinearSystem, count: int) -> Record:
    """Return a recording of so many samples at the operating point."""
    u = np.tile(np.array(model.offset["u"], float), (count, 1))
    y = np.tile(np.array(model.offset["y"], float), (count, 1))
    return u, y, np.zeros(0, int)


def added_fault(part: Record, model: LinearSystem, fault: Fault, sign: float) -> Record:
    """Return a recording that no bounds explain under which a fault, of its size and this sign, is seen by
    the last sample.
    """
    u, y, starts = part
    wrong = sign * fault.size * _course(len(y), fault)
    if fault.signal in model.outputs:
        y = y + wrong[:, None] * (np.array(model.outputs) == fault.signal)
    else:
        u = u + wrong[:, None] * (np.array(model.inputs) == fault.signal)
    return u, y, starts


def _course(T: int, fault: Fault) -> np.ndarray:
    """Return the course (T,) of a bias, or a drift, of size 1."""
    since = np.arange(T) - fault.start
    if fault.kind == "drift":
        return np.asarray(np.maximum(since + 1.0, 0.0))
    return np.where(since < 0, 0.0, 1.0)


def refuse_kind(fault: Fault) -> None:
    """Raise ValueError for a fault that does not enter a recording linearly."""
    if fault.kind not in SEEN or not fault.size:
        raise ValueError(
            f"see: bounds are chosen for a bias or a drift of some size, not for {fault.signal}:{fault.kind} "
            f"of size {fault.size:g}"
        )


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a recording, over the states (T n), and the disturbances in units of their limits.

    Fields:
        linked: numbers of the samples that the next one follows. dynamics, known: x_{k+1} - A x_k - G w_k is
            known, for these. present: the readings that were measured, as numbers k p + i. seen, left, limit:
            C x is what is left of each without D u, but for the limit. walks: how many disturbances.
    """

    linked: np.ndarray
    dynamics: Sparse
    known: np.ndarray
    present: np.ndarray
    seen: Sparse
    left: np.ndarray
    limit: np.ndarray
    walks: int

    @classmethod
    def of(cls, model: LinearSystem, part: Record) -> "_Rows":
        """Return the rows of a recording under a model."""
        from scipy.sparse import csr_array, eye_array, hstack, kron

        u, y, starts = part
        T = len(y)
        A, B, C, D, G = (_floats(model, letter) for letter in "ABCDG")
        u, y = u - np.array(model.offset["u"], float), y - np.array(model.offset["y"], float)
        low, high = np.array(model.disturbance, float).reshape(-1, 2).T
        lost = np.isnan(u).any(1)
        follows = ~lost[:-1]
        follows[np.asarray(starts, int) - 1] = False
        linked = np.flatnonzero(follows)

        after, now = csr_array(eye_array(T, k=1))[linked], csr_array(eye_array(T))[linked]
        pushed = kron(eye_array(len(linked)), G * ((high - low) / 2))
        dynamics = hstack([kron(after, eye_array(model.n)) - kron(now, A), -pushed], format="csr")
        known = u[linked] @ B.T + G @ ((high + low) / 2)

        target = y - np.nan_to_num(u) @ D.T
        target[lost] = np.where(D.any(1), np.nan, target[lost])
        present = np.flatnonzero(~np.isnan(target))
        seen = csr_array(kron(eye_array(T), C))[present]
        limit = np.array([float(x + r) for x, r in zip(model.noise, model.resolution, strict=True)])
        return cls(
            linked,
            dynamics,
            known.ravel(),
            present,
            seen,
            target.ravel()[present],
            np.tile(limit, T)[present],
            len(linked) * model.g,
        )


def _fault(rows: _Rows, model: LinearSystem, fault: Fault) -> tuple[np.ndarray, np.ndarray]:
    """Return (acts, wrong): what a fault of size 1 takes from each equation, and adds to each reading."""
    T = rows.present[-1] // model.p + 1
    course = _course(T, fault)
    acts, wrong = np.zeros((len(rows.linked), model.n)), np.zeros((T, model.p))
    if fault.signal in model.outputs:
        wrong[:, model.outputs.index(fault.signal)] = course
    else:
        number = model.inputs.index(fault.signal)
        acts = -course[rows.linked, None] * _floats(model, "B")[:, number]
        wrong = -course[:, None] * _floats(model, "D")[:, number]
    return acts.ravel(), wrong.ravel()[rows.present]


def _floats(model: LinearSystem, letter: str) -> np.ndarray:
    """Return a matrix of a model in floats, (rows, columns) where either may be 0."""
    n, m, p, g = model.n, model.m, model.p, model.g
    sizes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m), "G": (n, g)}
    return np.array(getattr(model, letter), float).reshape(sizes[letter])


def _extreme(
    rows: _Rows,
    upper: Sparse,
    left: np.ndarray,
    acts: np.ndarray,
    cost: float,
    walk: tuple[float | None, float | None],
    last: tuple[float | None, float | None],
) -> float:
    """Return the last variable where cost times it is least, under upper <= left; inf where nothing limits it
    or nothing will do.

    Args:
        acts: of the last variable in the equations. walk, last: limits of a disturbance, of the last
            variable.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, hstack

    equations = hstack([rows.dynamics, csr_array(acts[:, None])], format="csr")
    count = equations.shape[1] - 1
    limits = [(None, None)] * (count - rows.walks) + [walk] * rows.walks + [last]
    aim = np.append(np.zeros(count), cost)
    method = "highs"
    if len(rows.linked) > LONG:
        method = "highs-ipm"
    answer = linprog(aim, upper, left, equations, rows.known, bounds=limits, method=method)
    if answer.x is None or answer.status:
        return math.inf
    return float(answer.x[-1])
