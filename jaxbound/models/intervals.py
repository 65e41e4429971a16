"""Linear models whose matrices are intervals, and their static form: one interval linear system in the states
of a window.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias, cast

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Number, Vector
from jaxbound.models.fingerprint import fingerprint
from jaxbound.models.signals import Each
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.text.objects import readable

__all__ = ["IntervalSystem", "as_intervals", "interval_system", "stacked"]

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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IntervalSystem) and fingerprint(self) == fingerprint(other)

    def __hash__(self) -> int:
        return hash(fingerprint(self))

    n = property(lambda self: self.A.shape[0], doc="Number of states.")
    m = property(lambda self: self.B.shape[1], doc="Number of inputs.")
    p = property(lambda self: self.C.shape[0], doc="Number of outputs.")

    @property
    def name(self) -> str:
        """The name in messages: an interval system has no name of its own."""
        return "interval system"

    @property
    def resolution(self) -> tuple[float, ...]:
        """The steps of the recorder: none is stated that could be too small."""
        return (np.inf,) * self.p

    @property
    def dt(self) -> None:
        """The sampling period: not stated."""
        return None

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
    B = interval(np.zeros((n, 0))) if B is None else _entries("B", B)
    for name, X, shape in (("A", A, (n, n)), ("B", B, (n, B.shape[1])), ("C", C, (p, n))):
        if X.shape != shape:
            raise ValueError(f"{name} must have shape {shape} to fit A, B and C: its shape is {X.shape}")
    m = B.shape[1]
    noise, tolerance = _upper(_numbers("noise", noise, p)), _upper(_numbers("tolerance", tolerance, p))
    if (tolerance >= 1).any():
        raise ValueError("tolerance is relative and must be below 1 (2 % is 0.02)")
    zero = lambda *shape: interval(np.zeros(shape))
    names = lambda given, count, letter: (
        tuple(given) if given is not None else tuple(f"{letter}{i + 1}" for i in range(count))
    )
    called = names(inputs, m, "u"), names(outputs, p, "y"), names(states, n, "x")
    for field, some, count in zip(("inputs", "outputs", "states"), called, (m, p, n), strict=True):
        if len(some) != count:
            raise ValueError(f"{field} needs {count} names, one for each: {len(some)} given")
    return IntervalSystem(
        A, B, C, zero(p, m), zero(n), tolerance, noise, {"u": zero(m), "y": zero(p)}, *called
    )


def _numbers(field: str, value: Each, count: int) -> list[Fraction]:
    given = (
        [value] * count
        if isinstance(value, str) or np.asarray(value, object).ndim == 0
        else list(cast("Sequence[Number]", value))
    )
    if len(given) != count:
        raise ValueError(f"{field} needs one number, or one for each of {count} outputs: {len(given)} given")
    try:
        values = [linalg.rational(cast("Number", v)) for v in given]
    except (ValueError, TypeError) as e:
        raise ValueError(f"{field}: {e}") from None
    if any(v < 0 for v in values):
        raise ValueError(f"{field} must be >= 0: {float(min(values)):g} is not")
    return values


def _entries(name: str, rows: Entries) -> Interval:
    """Return rows of numbers and pairs as an Interval, rounded outward from their decimals."""
    if isinstance(rows, Interval):
        if len(rows.shape) != 2:
            raise ValueError(f"{name} must be a matrix: its shape is {rows.shape}")
        if not (np.isfinite(rows.lo).all() and np.isfinite(rows.hi).all()):
            raise ValueError(f"{name} must have finite bounds in every entry")
        return rows
    pair = lambda x: x if isinstance(x, (list, tuple, np.ndarray)) and np.ndim(x) else (x, x)
    try:
        ends = [[tuple(linalg.rational(v) for v in pair(x)) for x in row] for row in rows]
    except (ValueError, TypeError) as e:
        raise ValueError(f"{name}: {e}") from None
    if (
        not ends
        or any(len(row) != len(ends[0]) or not row for row in ends)
        or any(len(x) != 2 for row in ends for x in row)
    ):
        raise ValueError(f"{name} needs rows of one length whose entries are numbers or pairs (lo, hi)")
    if any(lo > hi for row in ends for lo, hi in row):
        raise ValueError(f"{name}: lo must be <= hi in every entry")
    return _outward([[x[0] for x in row] for row in ends], [[x[1] for x in row] for row in ends])


def _upper(values: Sequence[Fraction]) -> np.ndarray:
    """Return exact numbers as floats, rounded up, in an array that nobody writes."""
    out = rounding.round_up(np.array(values, object))
    out.setflags(write=False)
    return out


def _outward(lo, hi):
    return interval(rounding.round_down(np.array(lo, object)), rounding.round_up(np.array(hi, object)))


def as_intervals(model: LinearSystem | IntervalSystem, unknown_inputs: bool = False) -> IntervalSystem:
    """Return a model as an IntervalSystem: uncertain parameters become the interval hulls of the matrices
    they act on.

    Args:
        unknown_inputs: whether there may be some; they are left out.

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

    def hull(letter, left=None):
        """Return the hull of a matrix, or of left times it."""
        middle, spread = getattr(model, letter), [rows for u in model.uncertainties if (rows := u.on(letter))]
        if not middle or not middle[0]:
            return interval(np.zeros((len(left or middle), 0)))
        if left:
            middle, spread = linalg.matmul(left, middle), [linalg.matmul(left, s) for s in spread]
        radius = [
            [sum((abs(s[i][j]) for s in spread), Fraction(0)) for j in range(len(row))]
            for i, row in enumerate(middle)
        ]
        move = lambda sign: [
            [x + sign * r for x, r in zip(a, b, strict=True)] for a, b in zip(middle, radius, strict=True)
        ]
        return _outward(move(-1), move(1))

    def pushed(G):
        ends = [
            [sorted((g * lo, g * hi)) for g, (lo, hi) in zip(row, model.disturbance, strict=True)]
            for row in G
        ]
        return _outward(*([sum((e[side] for e in row), Fraction(0)) for row in ends] for side in (0, 1)))

    w, left = pushed(model.G), _combinations(model)
    moves = (
        None
        if left is None
        else (hull("A", left), _outward(left, left), hull("B", left), pushed(linalg.matmul(left, model.G)))
    )
    noise = _upper([a + b for a, b in zip(model.noise, model.resolution, strict=True)])
    offset = {
        k: _outward(list(v), list(v)) if len(v) else interval(np.zeros(0)) for k, v in model.offset.items()
    }
    A, B, C, D = (hull(letter) for letter in "ABCD")
    return IntervalSystem(
        A,
        B,
        C,
        D,
        w,
        _upper(model.tolerance),
        noise,
        offset,
        model.inputs,
        model.outputs,
        model.states,
        moves,
    )


def _combinations(model: LinearSystem) -> Sequence[Vector] | None:
    """Return rows L (e, n) such that L (A x + B u + G d - x+) = 0 uses that the disturbances are fewer than
    the states; None if not.

    A box around G d forgets that its entries move together. With T G = [I, 0]', T regular, nothing is lost
    where A and B are certain; where they are not, T would widen what is certain of a single row: all rows
    stay, those without any disturbance are added.
    """
    moving = [
        j for j, (lo, hi) in enumerate(model.disturbance) if lo < hi
    ]  # of the others nothing is unknown
    G, n, g = [[row[j] for j in moving] for row in model.G], model.n, len(moving)
    if not g or linalg.rank(G) in (0, n):
        return None
    unit = [tuple(Fraction(i == j) for j in range(n)) for i in range(n)]
    columns = [(*row, *one) for row, one in zip(G, unit, strict=True)]
    basis = linalg.row_reduce(columns)[1]  # columns of G first
    T = linalg.inverse([[row[j] for j in basis] for row in columns])
    free = T[linalg.rank(G) :]
    if linalg.rank(G) == g and not any(u.on("A") or u.on("B") for u in model.uncertainties):
        return T
    return [*unit, *free]


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
    E, K = moves[:2] if moves else (model.A, interval(np.eye(n).astype(model.A.dtype)))
    e, out = E.shape[0], []
    for side, other in (("lo", "hi"), ("hi", "lo")):
        M = np.zeros((s * e + (s + 1) * p, (s + 1) * n), model.A.dtype)
        for j in range(s + 1):
            if j < s:
                M[j * e : (j + 1) * e, j * n : (j + 1) * n] = getattr(E, side)
                M[j * e : (j + 1) * e, (j + 1) * n : (j + 2) * n] = -np.asarray(getattr(K, other))
            M[s * e + j * p : s * e + (j + 1) * p, j * n : (j + 1) * n] = getattr(model.C, side)
        out.append(M)
    return interval(*out)
