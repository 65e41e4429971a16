"""The elimination of Ragot, Maquin, Kratz 1993: first the unknown inputs, then the measured states, then what
is left step by step.

| paper | here | |
|---|---|---|
| E | E | left annihilator of F, (2)-(4a) |
| P | P | x = P (y, w), w the states that no output shows, (9) |
| Q | Q | Q E_2 = (0, I), (10)-(12) |
| A_r, C_r, y_r | A, C, z | x+ = A x + b, z = C x: b and z are polynomials in q of the signals, (14) |

A step (16)-(20) with the corrections that the paper needs: rows of C that depend on others give a relation at
once and are left out, and the elimination goes on until no state is left or C = 0 (stopping at a scalar state
loses a relation of the paper's own example).
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models.system import LinearSystem
from jaxbound.relations import shift
from jaxbound.relations.shift import Row

__all__ = ["eliminate"]


def eliminate(model: LinearSystem) -> tuple[Row, ...]:
    """Return the rows of polynomials of all relations of a model; see `redundancy.redundancy` for when it
    refuses.
    """
    if model.has_direct_unknown:
        raise ValueError(
            "the elimination is for unknown inputs that act on the state only, and D_v is not zero; use "
            "method='window'"
        )
    F = _independent_columns(model.F)
    outputs, rows = _independent_outputs(model)
    C = tuple(model.C[i] for i in outputs)
    E = linalg.identity(model.n)
    if F[0]:
        E = linalg.left_null_space(F)
    columns = linalg.row_reduce(C)[1]
    hidden = tuple(j for j in range(model.n) if j not in columns)
    measured = len(outputs)
    P = _measured_first(C, columns, hidden)
    EP, EAP, EB = _products(E, P, model)
    E2 = _columns(EP, measured, model.n)
    if linalg.rank(E2) < len(hidden):
        raise ValueError(
            f"the elimination needs rank(C F) = rank F, so that each unknown input shows in the next "
            f"outputs: rank(C F) is "
            f"{linalg.rank(linalg.matmul(model.C, F))}, rank F is {len(F[0])}; use method='window'"
        )
    Q = _solving(E2)
    E1, EAP, EB = linalg.matmul(Q, _columns(EP, 0, measured)), linalg.matmul(Q, EAP), linalg.matmul(Q, EB)
    y, width = _signals(model, outputs), model.p + model.m
    through = shift.apply(_columns(EAP, 0, measured), y, width)
    driven = shift.apply(EB, _inputs(model), width)
    # q E1 y - A1 y - B u = A2 w - (0, q w)
    later = shift.minus_shift(shift.apply(E1, y, width), _sum(through, driven))
    split = len(E) - len(hidden)
    z, b = list(later[:split]), tuple(_negative(row) for row in later[split:])
    moved = _columns(EAP, measured, model.n)
    C, A = moved[:split], moved[split:]
    while True:
        order = sorted(range(len(z)), key=lambda i: shift.degree(z[i]))
        z, C = [z[i] for i in order], tuple(C[i] for i in order)
        found, z, C = _relations(z, C)
        rows += found
        if not z:
            return tuple(rows)
        A, C, b, z = _step(A, C, b, z)


def _products(E: Matrix, P: Matrix, model: LinearSystem) -> tuple[Matrix, Matrix, Matrix]:
    """Return (E P, E A P, E B)."""
    if not E:
        return (), (), ()
    EB = linalg.matmul(E, model.B) if model.m else linalg.zeros(len(E), 0)
    return linalg.matmul(E, P), linalg.matmul(linalg.matmul(E, model.A), P), EB


def _columns(rows: Matrix, low: int, high: int) -> Matrix:
    """Return some columns of a matrix."""
    return tuple(row[low:high] for row in rows)


def _negative(row: Row) -> Row:
    """Return a row of polynomials times -1."""
    return tuple(tuple(-c for c in p) for p in row)


def _relations(z: Sequence[Row], C: Matrix) -> tuple[list[Row], list[Row], Matrix]:
    """Return the relations among z = C x, and the independent rows that are left."""
    if not C or not C[0]:
        return list(z), [], ()
    # reversed: each relation is led by the row that depends on those before it
    backward = linalg.left_null_space(C[::-1])
    null = [row[::-1] for row in backward]
    led: set[int] = set()
    relations: list[Row] = []
    for row in _echelon(null):
        led.add(max(i for i, x in enumerate(row) if x))
        relations += shift.apply((row,), z, len(z[0]))
    keep = [i for i in range(len(z)) if i not in led]
    return relations, [z[i] for i in keep], tuple(C[i] for i in keep)


def _echelon(rows: Sequence[Vector]) -> list[Vector]:
    """Return a basis of the row space whose rows end at different columns."""
    if not rows:
        return []
    backward = [row[::-1] for row in rows]
    return [row[::-1] for row in linalg.row_reduce(backward)[0]]


def _step(
    A: Matrix, C: Matrix, b: Sequence[Row], z: Sequence[Row]
) -> tuple[Matrix, Matrix, tuple[Row, ...], list[Row]]:
    """Return (A, C, b, z) of the states that are left when z takes the place of some. Source: (16)-(20)."""
    n, width, first = len(A), len(z[0]), linalg.row_reduce(C)[1]
    second = tuple(j for j in range(n) if j not in first)
    change = _measured_first(C, first, second)  # x = change (z, x2)
    back = linalg.inverse(change)
    moved, drive = linalg.matmul(linalg.matmul(back, A), change), shift.apply(back, b, width)
    k = len(z)
    replaced, kept = moved[:k], moved[k:]
    known = _sum(shift.apply(_columns(replaced, 0, k), z, width), drive[:k])
    pushed = _sum(shift.apply(_columns(kept, 0, k), z, width), drive[k:])
    left = list(shift.minus_shift(z, known))
    return _columns(kept, k, n), _columns(replaced, k, n), pushed, left


def _measured_first(C: Matrix, columns: Sequence[int], hidden: Sequence[int]) -> Matrix:
    """Return P with x = P (C x, x of the hidden columns); C has full row rank on `columns`."""
    own = linalg.identity(len(columns) + len(hidden))
    return linalg.inverse([*C, *(own[i] for i in hidden)])


def _solving(E2: Matrix) -> Matrix:
    """Return Q, regular, with Q E2 = (0, I)."""
    rows, own = len(E2), linalg.identity(len(E2))
    if not E2 or not E2[0]:
        return own
    bottom = linalg.row_reduce(linalg.transpose(E2))[1]
    inverse = linalg.inverse([E2[i] for i in bottom])
    Q = []
    for i in range(rows):
        if i not in bottom:
            share = linalg.matmul((E2[i],), inverse)[0]
            Q.append(linalg.add_multiple(own[i], -1, _spread(share, bottom, rows)))
    for row in inverse:
        Q.append(_spread(row, bottom, rows))
    return tuple(Q)


def _spread(values: Vector, at: Sequence[int], count: int) -> Vector:
    """Return a row of so many numbers, some of them given and 0 elsewhere."""
    row = [Fraction(0)] * count
    for i, value in zip(at, values, strict=True):
        row[i] = value
    return tuple(row)


def _independent_columns(F: Matrix) -> Matrix:
    """Return F without the columns that depend on others."""
    if not F[0]:
        return F
    independent = linalg.row_reduce(F)[1]
    return tuple(tuple(row[j] for j in independent) for row in F)


def _independent_outputs(model: LinearSystem) -> tuple[list[int], list[Row]]:
    """Return the outputs whose rows of C are independent, and the relations that the others give at once."""
    kept = list(linalg.row_reduce(linalg.transpose(model.C))[1])
    rows: list[Row] = []
    y = _signals(model, range(model.p))
    for row in _echelon(linalg.left_null_space(model.C)):
        rows += shift.apply((row,), y, model.p + model.m)
    return kept, rows


def _signals(model: LinearSystem, outputs: Iterable[int]) -> list[Row]:
    """Return y - D u of some outputs as rows over (y, u)."""
    rows = []
    for i in outputs:
        direct = tuple(shift.trim((-x,)) for x in model.D[i])
        rows.append(_unit(i, model.p) + direct)
    return rows


def _inputs(model: LinearSystem) -> list[Row]:
    """Return u as rows over (y, u)."""
    return [((),) * model.p + _unit(j, model.m) for j in range(model.m)]


def _unit(i: int, count: int) -> Row:
    """Return a row of polynomials: 1 at one place, 0 elsewhere."""
    return tuple((Fraction(1),) if j == i else () for j in range(count))


def _sum(a: Sequence[Row], b: Sequence[Row]) -> tuple[Row, ...]:
    """Return the sum of two matrices of polynomials."""
    return tuple(tuple(map(shift.add, r, s)) for r, s in zip(a, b, strict=True))
