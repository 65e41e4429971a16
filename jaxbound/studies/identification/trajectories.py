"""Trajectories of a model that explain whole recordings, by linear programs over all their samples.

Unknown are the first state of each stretch, the disturbance w_k of each step and the error v_k of each
reading:

    x_{k+1} = A x_k + B u_k + G w_k,    y_k = C x_k + D u_k + v_k,    |v_i| <= t noise_i,  |w_j| <= t limit_j

The least t explains a recording from start to end. No test that is sound calls a sample of it a FAULT under
bounds t times those of the model: the trajectory is a witness for each of its windows, and for an observer.
Numbers here are floats of HiGHS; verdicts under bounds that are rounded up prove them.
"""

import itertools
import math
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.models.window import model_matrices
from jaxbound.studies.identification.records import Record

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

Sizes: TypeAlias = dict[str, float]
"""{output: size}."""
Sparse: TypeAlias = Any
"""A sparse matrix of SciPy, which is imported where one is made."""
LEAST = 1e-9
"""The least reciprocal of a factor: no bounds are that wide."""
SOLVED, IMPOSSIBLE, UNLIMITED = 0, 2, 3
"""Ends of a linear program of SciPy."""
SETTLED = 100
"""Samples before a fault by which the state is known as well as it ever is."""
LONG = 500
"""Samples from which on an interior point costs less than the simplex: its time grows with their number."""
STEPS, PATIENCE = 1000, 60.0
"""Steps, and seconds, after which a program is given to another method: an interior point takes 10 to 30
steps where it ends, and one may search for its corner for ever.
"""
AWAKE = 0.5
"""Seconds between two looks at a program that runs."""
SMALLER = "fewer samples make programs smaller: give shorter recordings, or --recording every=1min"
"""The way out where programs are given up."""


class GivenUp(RuntimeError):
    """A linear program that no method ended within its limits of steps and time."""

    def __init__(self, readings: int) -> None:
        super().__init__(f"a linear program over {readings} readings reached its limits of steps and time")


def least_factor(model: LinearSystem, part: Record) -> float:
    """Return the least factor on the noise and the disturbances of a model that explains a recording.

    Args:
        model: without tolerances and uncertainties. part: (u (T, m), y (T, p), starts), NaN where a sample is
            missing; a state begins anew at each of `starts` and behind a missing input.

    Returns:
        The factor, inf where none will do: a step that no noise and no disturbance explains.

    Raises:
        GivenUp: a program did not end, as those of all functions here.
    """
    rows = _Rows.of(model, part)
    if not len(rows.left):
        return 0.0
    share = _extreme(rows, -rows.known, rows.left, np.zeros(len(rows.known)), np.zeros(len(rows.left)), 1.0)
    if math.isnan(share) or share < LEAST:
        return math.inf
    return 1 / share


def hidden_sizes(model: LinearSystem, part: Record, faults: Sequence[Fault]) -> Iterator[float]:
    """Yield the largest size, of either sign, of each fault that could be in a recording under the bounds of
    a model: any larger one, added to it, is seen by its last sample. inf: whatever the size.

    Args:
        model, part: as of `least_factor`; the bounds of the model must explain the recording. faults: biases
            or drifts from sample `start` on; their sizes are not read.
    """
    rows = _Rows.of(model, part)
    for fault in faults:
        acts, wrong = _fault(rows, model, fault)
        size = 0.0
        for sign in (1.0, -1.0):
            largest = sign * _extreme(rows, acts, wrong, rows.known, rows.left, sign)
            size = max(size, math.inf if math.isnan(largest) else abs(largest))
        yield size


def hidden_jumps(model: LinearSystem, before: int, within: int) -> Sizes:
    """Return {output: size} of a jump that noise can hide `within` so many samples from any test of all of
    them, `before` of which go before it; inf: whatever the size.
    """
    sizes = {}
    for name in model.outputs:
        sizes[name] = 2 * _hidden_at_rest(model, before + within, Fault(name, "bias", 1.0, before))
    return sizes


def sure_sizes(model: LinearSystem, before: int, within: int, after: int) -> tuple[Sizes, Sizes, Sizes]:
    """Return (jump, lasting, ramp), {output: size} each: errors of one output that no noise hides from an
    exact test of all samples; inf where there is none.

    A jump is seen `within` so many samples, a bias that lasts, and a ramp by its last size, `after` so many;
    as many as `before` go before each. On a recording without any noise an error of half the size is seen.
    """
    ramp = {}
    for name in model.outputs:
        drift = Fault(name, "drift", 1.0, before)
        ramp[name] = 2 * after * _hidden_at_rest(model, before + after, drift)
    return hidden_jumps(model, before, within), hidden_jumps(model, before, after), ramp


def _hidden_at_rest(model: LinearSystem, count: int, fault: Fault) -> float:
    """Return the largest hidden size of a fault in a recording of so many samples at the operating point."""
    u = np.tile(np.array(model.offset["u"], float), (count, 1))
    y = np.tile(np.array(model.offset["y"], float), (count, 1))
    (size,) = hidden_sizes(model, (u, y, np.zeros(0, int)), [fault])
    return size


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
        A, B, C, D, G = model_matrices(model, "ABCDG")
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
        B, D = model_matrices(model, "BD")
        acts = -course[rows.linked, None] * B[:, number]
        wrong = -course[:, None] * D[:, number]
    return acts.ravel(), wrong.ravel()[rows.present]


def _extreme(
    rows: _Rows, acts: np.ndarray, wrong: np.ndarray, known: np.ndarray, left: np.ndarray, sign: float
) -> float:
    """Return the largest sign * z, under the limits of disturbances and readings, of a number z in

        x_{k+1} - A x_k - G w_k + acts z = known,    |C x_k - wrong z - left| <= limit;

    inf where nothing limits it, nan where nothing will do. Raise GivenUp where no method says which.
    """
    from scipy.sparse import block_array, csr_array, diags_array, eye_array, hstack

    # a column for the error of each reading, in its limits: two rows that bound it are slower
    unit = np.where(rows.limit > 0, rows.limit, 1.0)
    count, seen = len(unit), diags_array(1 / unit) @ rows.seen
    states = seen.shape[1]
    apart, column = csr_array((count, rows.walks)), csr_array(-(wrong / unit)[:, None])
    equations = block_array(
        [[rows.dynamics, None, csr_array(acts[:, None])], [hstack([seen, apart]), eye_array(count), column]],
        format="csr",
    )
    most = np.concatenate(
        [np.full(states, np.inf), np.ones(rows.walks), rows.limit / unit, np.full(1, np.inf)]
    )
    program = {"c": np.append(np.zeros(len(most) - 1), -sign), "bounds": np.stack([-most, most], 1)}
    program |= {"A_eq": equations, "b_eq": np.concatenate([known, left / unit])}
    methods, ends = ["highs"], set()
    if len(rows.linked) > LONG:
        methods = ["highs-ipm", "highs"]
    for method, presolve in itertools.product(methods, (True, False)):
        steps = STEPS
        if method == "highs":  # the simplex takes some for each reading
            steps *= 1 + count // 50
        options = {"presolve": presolve, "maxiter": steps, "time_limit": PATIENCE}
        answer = _solved({**program, "method": method, "options": options})
        if answer.status == SOLVED:
            return sign * float(answer.x[-1])
        if answer.status == UNLIMITED:
            return math.inf
        ends.add(answer.status)
    if IMPOSSIBLE in ends:
        return math.nan
    raise GivenUp(count)


def _solved(program: dict[str, Any]) -> "OptimizeResult":
    """Return the answer of a linear program of SciPy; a thread of its own solves it, so that Ctrl-C and
    SIGTERM, which reach this one alone, need not wait for its end.
    """
    from scipy.optimize import linprog

    answers, troubles, under_way = [], [], threading.Lock()

    def solve() -> None:
        try:
            answers.append(linprog(**program))
        except Exception as trouble:
            troubles.append(trouble)
        under_way.release()

    under_way.acquire()
    solver = threading.Thread(target=solve, daemon=True)
    solver.start()
    try:
        while not under_way.acquire(timeout=AWAKE):  # a join that Ctrl-C ends takes its thread for ended
            pass
    except BaseException:
        solver.join(AWAKE)  # a thread that ends while Python does may crash it
        raise
    for trouble in troubles:
        raise trouble
    return answers[0]
