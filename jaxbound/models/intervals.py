"""Linear models whose matrices are intervals, and their static form: one interval linear system in the states
of a window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias, cast

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Number, columns_of
from jaxbound.models.fingerprint import fingerprint
from jaxbound.models.signals import Each, named, sensors
from jaxbound.models.system import LinearSystem
from jaxbound.models.times import refuse_factors
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.text.objects import readable

Entries: TypeAlias = Interval | np.ndarray | Sequence[Sequence[Any]]
"""A matrix: an Interval, or rows whose entries are numbers or pairs (lo, hi)."""

Moves: TypeAlias = tuple[Interval, Interval, Interval, Interval]


@readable
@dataclass(frozen=True, eq=False)
class IntervalSystem:
    """x+ = A x + B u + w, y = (1 + theta)(C x + D u) + e with every entry in its interval, drawn anew each
    sample. See `interval_system`.

    Fields: A (n, n), B (n, m), C (p, n), D (p, m), w (n,): Intervals; tolerance, noise: (p,) bounds of
    |theta| and |e|, rounded up; offset {"u": (m,), "y": (p,)} Intervals; inputs, outputs, states: names;
    moves: combinations of the rows of x+ = A x + B u + w that say more than these rows do, as (E (e, n), K
    (e, n), H (e, m), d (e,)) with 0 in E x - K x+ + H u + d, or None: (A, I, B, w).
    """

    A: Interval
    B: Interval
    C: Interval
    D: Interval
    w: Interval
    tolerance: np.ndarray
    noise: np.ndarray
    offset: Mapping[str, Interval]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    moves: Moves | None = None

    name = "interval system"
    """The name in messages: an interval system has no name of its own."""
    dt = None
    """Of an interval system nobody knows the sampling period."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IntervalSystem) and fingerprint(self) == fingerprint(other)

    def __hash__(self) -> int:
        return hash(fingerprint(self))

    @property
    def n(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def m(self) -> int:
        """Number of inputs."""
        return self.B.shape[1]

    @property
    def p(self) -> int:
        """Number of outputs."""
        return self.C.shape[0]

    @property
    def resolution(self) -> tuple[float, ...]:
        """The steps of the recorder: none is stated that could be too small."""
        return (np.inf,) * self.p

    @property
    def columns(self) -> dict[str, str]:
        """The columns that are stated: none."""
        return {}

    def column(self, signal: str) -> str:
        """Return the column of a recording that holds a signal: its name."""
        return signal

    def unit(self, signal: str) -> str:
        """Return no unit: none is stated."""
        return ""


def interval_system(
    A: Entries,
    B: Entries | None,
    C: Entries,
    *,
    noise: Each = 0.0,
    tolerance: Each = 0.0,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    states: Sequence[str] | None = None,
) -> IntervalSystem:
    """Build a model from interval matrices: x+ = [A] x + [B] u, y = [C] x.

    Args:
        A, B, C: (n, n), (n, m), (p, n): Intervals, or rows whose entries are numbers or pairs (lo, hi). B
            None: no inputs. A float means its shortest decimal, so that [0.19, 0.21] holds 19/100 and 21/100.
        noise, tolerance: absolute and relative bounds of the sensors, one number or one per output.
        inputs, outputs, states: names; default u1.., y1.., x1...

    Returns:
        An IntervalSystem, for `validate`.

    Raises:
        ValueError: shapes that do not fit, lo > hi, a number that is not finite.

    Source: Alhaj-Dibo, Maquin, Ragot 2004, (1).

    Example:
        >>> m = interval_system([[0.5, [0.1, 0.2]], [0, 0.4]], [[1], [0]], [[1, 1]])
        >>> m.n, m.m, m.p, m.outputs
        (2, 1, 1, ('y1',))
    """
    A, C = _entries("A", A), _entries("C", C)
    n, p = A.shape[0], C.shape[0]
    B = _interval_of_zeros(n, 0) if B is None else _entries("B", B)
    for name, X, shape in (("A", A, (n, n)), ("B", B, (n, B.shape[1])), ("C", C, (p, n))):
        if X.shape != shape:
            raise ValueError(f"{name} must have shape {shape} to fit A, B and C: its shape is {X.shape}")
    m = B.shape[1]
    output_names = named("outputs", outputs, p, "y")
    bounds = sensors(output_names, tolerance, noise, None, False)
    return IntervalSystem(
        A,
        B,
        C,
        D=_interval_of_zeros(p, m),
        w=_interval_of_zeros(n),
        tolerance=_floats_above(bounds.tolerance),
        noise=_floats_above(bounds.noise),
        offset={"u": _interval_of_zeros(m), "y": _interval_of_zeros(p)},
        inputs=named("inputs", inputs, m, "u"),
        outputs=output_names,
        states=named("states", states, n, "x"),
    )


def _interval_of_zeros(*shape: int) -> Interval:
    return interval(np.zeros(shape))


def _entries(name: str, rows: Entries) -> Interval:
    """Return rows of numbers and pairs as an Interval, rounded outward from their decimals."""
    if isinstance(rows, Interval):
        if len(rows.shape) != 2:
            raise ValueError(f"{name} must be a matrix: its shape is {rows.shape}")
        if not (np.isfinite(rows.lo).all() and np.isfinite(rows.hi).all()):
            raise ValueError(f"{name} must have finite bounds in every entry")
        return rows
    try:
        ends = [list(map(_pair, row)) for row in rows]
    except (ValueError, TypeError) as e:
        raise ValueError(f"{name}: {e}") from None
    width = len(ends[0]) if ends else 0
    pairs = [pair for row in ends for pair in row]
    if not width or any(len(row) != width for row in ends) or any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"{name} needs rows of one length whose entries are numbers or pairs (lo, hi)")
    if any(lo > hi for lo, hi in pairs):
        raise ValueError(f"{name}: lo must be <= hi in every entry")
    lo, hi = np.array(pairs, object).T
    return _outward(lo.reshape(-1, width), hi.reshape(-1, width))


def _pair(x: object) -> tuple[Fraction, ...]:
    """Return the ends of an entry exactly: a number twice, or the numbers of a sequence."""
    if isinstance(x, list | tuple | np.ndarray) and np.ndim(x):
        return tuple(linalg.rational(end) for end in x)
    exact = linalg.rational(cast("Number", x))
    return exact, exact


def _floats_above(values: Sequence[Fraction]) -> np.ndarray:
    """Return exact numbers as floats, rounded up, in an array that nobody writes."""
    out = rounding.round_up(np.array(values, object))
    out.setflags(write=False)
    return out


def _outward(lo: object, hi: object) -> Interval:
    """Return arrays, or rows, of exact numbers as an Interval, rounded outward."""
    return interval(rounding.round_down(np.array(lo, object)), rounding.round_up(np.array(hi, object)))


def as_intervals(
    model: LinearSystem | IntervalSystem, unknown_inputs: bool = False, factors: bool = False
) -> IntervalSystem:
    """Return a model as an IntervalSystem: uncertain parameters become the interval hulls of the matrices
    they act on.

    Args:
        unknown_inputs: whether there may be some; they are left out. factors: whether the caller knows
            factors on the noise; they are left out.

    Raises:
        ValueError: unknown inputs, a model without states. TypeError: no model.
    """
    if isinstance(model, IntervalSystem):
        return model
    if not hasattr(model, "uncertainties"):
        raise TypeError(
            f"observers and validate need a LinearSystem or an interval_system, not {type(model).__name__}"
        )
    if not model.n:
        raise ValueError("observers and validate take models with states: use jb.detect for others")
    if model.d and not unknown_inputs:
        raise ValueError("validate takes no unknown inputs: use jb.observe, jb.unknown_inputs or jb.detect")
    if not factors:
        refuse_factors(model)
    left = _combinations(model)
    moves = None
    if left is not None:
        pushed = _pushed(model, linalg.matmul(left, model.G))
        moves = _hull(model, "A", left), _outward(left, left), _hull(model, "B", left), pushed
    return IntervalSystem(
        A=_hull(model, "A"),
        B=_hull(model, "B"),
        C=_hull(model, "C"),
        D=_hull(model, "D"),
        w=_pushed(model, model.G),
        tolerance=_floats_above(model.tolerance),
        noise=_floats_above([a + b for a, b in zip(model.noise, model.resolution, strict=True)]),
        offset={side: _outward(list(point), list(point)) for side, point in model.offset.items()},
        inputs=model.inputs,
        outputs=model.outputs,
        states=model.states,
        moves=moves,
    )


def _hull(model: LinearSystem, letter: str, left: Matrix | None = None) -> Interval:
    """Return the hull of a matrix of a model, or of left times it."""
    middle: Matrix = getattr(model, letter)
    if not middle or not middle[0]:
        return _interval_of_zeros(len(left or middle), 0)
    spread = [rows for u in model.uncertainties if (rows := u.on(letter))]
    if left:
        middle, spread = linalg.matmul(left, middle), [linalg.matmul(left, rows) for rows in spread]
    centre = np.array(middle, object)
    # each parameter lies in [-1, 1]: what it adds to an entry is at most its magnitude
    radius = 0 * centre
    for rows in spread:
        radius = radius + abs(np.array(rows, object))
    return _outward(centre - radius, centre + radius)


def _pushed(model: LinearSystem, G: Matrix) -> Interval:
    """Return an enclosure of G w over all disturbances w."""
    low, high = [], []
    for row in G:
        lowest, highest = Fraction(0), Fraction(0)
        for g, (lo, hi) in zip(row, model.disturbance, strict=True):
            # exact over the box of w: entries of w are free of each other
            lowest += min(g * lo, g * hi)
            highest += max(g * lo, g * hi)
        low.append(lowest)
        high.append(highest)
    return _outward(low, high)


def _combinations(model: LinearSystem) -> Matrix | None:
    """Return rows L (e, n) such that L (A x + B u + G d - x+) = 0 uses that the disturbances are fewer than
    the states; None if not.

    A box around G d forgets that its entries move together. With T G = [I, 0]', T regular, nothing is lost
    where A and B are certain; where they are not, T would widen what is certain of a single row: all rows
    stay, those without any disturbance are added.
    """
    n = model.n
    moving = [j for j, (lo, hi) in enumerate(model.disturbance) if lo < hi]  # the others are known
    G = columns_of(model.G, moving)
    rank = linalg.rank(G)
    # nothing is pushed, or all states are: no combination is free of it
    if rank in (0, n):
        return None
    columns = linalg.beside(G, linalg.identity(n))
    basis = linalg.row_reduce(columns)[1]  # columns of G first
    T = linalg.inverse(columns_of(columns, basis))
    if rank == len(moving) and not any(u.on("A") or u.on("B") for u in model.uncertainties):
        return T
    return linalg.identity(n) + T[rank:]


def stacked(model: IntervalSystem, horizon: int, moves: Moves | None = None) -> Interval:
    """Return M of the static form M x = h, x the states of a window of horizon + 1 samples: first [A, -I]
    rows, then the C rows.

    h holds -B u - w, then what each sample says of C x. moves: rows [E, -K] in place of [A, -I], see
    `IntervalSystem`.

    Returns:
        An Interval (s n + (s+1) p, (s+1) n), or s e rows for e moves.

    Source: Alhaj-Dibo, Maquin, Ragot 2004, (4)-(6).
    """
    s, n, p = horizon, model.n, model.p
    E, K = model.A, interval(np.eye(n).astype(model.A.dtype))
    if moves:
        E, K = moves[:2]
    e = E.shape[0]
    M = np.zeros((2, s * e + (s + 1) * p, (s + 1) * n), model.A.dtype)  # lowest, highest
    for j in range(s):
        rows = slice(j * e, (j + 1) * e)
        M[:, rows, j * n : (j + 1) * n] = E.lo, E.hi
        # -[lo, hi] = [-hi, -lo]
        M[:, rows, (j + 1) * n : (j + 2) * n] = -np.asarray(K.hi), -np.asarray(K.lo)
    for j in range(s + 1):
        rows = slice(s * e + j * p, s * e + (j + 1) * p)
        M[:, rows, j * n : (j + 1) * n] = model.C.lo, model.C.hi
    return interval(M[0], M[1])
