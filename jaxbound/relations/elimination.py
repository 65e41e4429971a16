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

from collections.abc import Sequence
from fractions import Fraction

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix
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
    E = linalg.left_null_space(F) if F[0] else _identity(model.n)
    columns = linalg.row_reduce(C)[1]
    hidden = tuple(j for j in range(model.n) if j not in columns)
    measured = len(outputs)
    P = _measured_first(C, columns, hidden)
    EP, EAP = linalg.matmul(E, P) if E else (), linalg.matmul(linalg.matmul(E, model.A), P) if E else ()
    E1, E2 = tuple(r[:measured] for r in EP), tuple(r[measured:] for r in EP)
    if linalg.rank(E2) < len(hidden):
        CF = linalg.matmul(model.C, F)
        raise ValueError(
            f"the elimination needs rank(C F) = rank F, so that each unknown input shows in the next "
            f"outputs: rank(C F) is "
            f"{linalg.rank(CF)}, rank F is {len(F[0])}; use method='window'"
        )
    y = _signals(model, outputs)
    Q = _solving(E2)
    E1, EAP, EB = (
        linalg.matmul(Q, E1),
        linalg.matmul(Q, EAP),
        linalg.matmul(Q, linalg.matmul(E, model.B)) if model.m else tuple(() for _ in Q),
    )
    given = [
        _sum(
            shift.apply(tuple(r[:measured] for r in EAP), y, model.p + model.m),
            shift.apply(EB, _inputs(model), model.p + model.m),
        ),
        shift.apply(E1, y, model.p + model.m),
    ]
    split = len(E) - len(hidden)
    later = shift.minus_shift(given[1], given[0])  # q E1 y - A1 y - B u = A2 w - (0, q w)
    z, b = list(later[:split]), tuple(tuple(tuple(-c for c in p) for p in row) for row in later[split:])
    C, A = (tuple(r[measured:] for r in part) for part in (EAP[:split], EAP[split:]))
    while True:
        order = sorted(range(len(z)), key=lambda i: shift.degree(z[i]))
        z, C = [z[i] for i in order], tuple(C[i] for i in order)
        found, z, C = _relations(z, C)
        rows += found
        if not z:
            return tuple(rows)
        A, C, b, z = _step(A, C, b, z)


def _relations(z: Sequence[Row], C: Matrix) -> tuple[list[Row], list[Row], Matrix]:
    """Return the relations among z = C x, and the independent rows that are left."""
    if not C or not C[0]:
        return list(z), [], ()
    backward = linalg.left_null_space(
        C[::-1]
    )  # reversed: each relation is led by the row that depends on those before it
    null = [row[::-1] for row in backward]
    led: set[int] = set()
    relations: list[Row] = []
    for row in _echelon(null):
        led.add(max(i for i, x in enumerate(row) if x))
        relations += shift.apply((row,), z, len(z[0]))
    keep = [i for i in range(len(z)) if i not in led]
    return relations, [z[i] for i in keep], tuple(C[i] for i in keep)


def _echelon(rows):
    """Return a basis of the row space whose rows end at different columns."""
    return [row[::-1] for row in linalg.row_reduce([row[::-1] for row in rows])[0]] if rows else []


def _step(A, C, b, z):
    """Replace a part of the state by z: return (A, C, b, z) of what is left. Source: (16)-(20)."""
    n, width, first = len(A), len(z[0]), linalg.row_reduce(C)[1]
    second = tuple(j for j in range(n) if j not in first)
    change = _measured_first(C, first, second)  # x = change (z, x2)
    back = linalg.inverse(change)
    moved, drive = linalg.matmul(linalg.matmul(back, A), change), shift.apply(back, b, width)
    k = len(z)
    part = lambda rows, low, high: tuple(r[low:high] for r in rows)
    known = _sum(shift.apply(part(moved[:k], 0, k), z, width), drive[:k])
    left = shift.minus_shift(z, known)
    return (
        part(moved[k:], k, n),
        part(moved[:k], k, n),
        _sum(shift.apply(part(moved[k:], 0, k), z, width), drive[k:]),
        left,
    )


def _measured_first(C, columns, hidden):
    """Return P with x = P (C x, x of the hidden columns); C has full row rank on `columns`."""
    n = len(columns) + len(hidden)
    rows = list(C) + [tuple(Fraction(int(j == i)) for j in range(n)) for i in hidden]
    return linalg.inverse(rows)


def _solving(E2):
    """Return Q, regular, with Q E2 = (0, I)."""
    width, rows = len(E2[0]) if E2 else 0, len(E2)
    if not width:
        return _identity(rows)
    bottom = linalg.row_reduce(linalg.transpose(E2))[1]
    inverse = linalg.inverse([E2[i] for i in bottom])
    spread = lambda values, at: tuple(
        sum((v for v, i in zip(values, at, strict=True) if i == j), Fraction(0)) for j in range(rows)
    )
    Q = []
    for i in range(rows):
        if i not in bottom:
            share = linalg.matmul((E2[i],), inverse)[0]
            Q.append(tuple(a - b for a, b in zip(_identity(rows)[i], spread(share, bottom), strict=True)))
    return tuple(Q) + tuple(spread(row, bottom) for row in inverse)


def _independent_columns(F):
    """Return F without the columns that depend on others."""
    return tuple(tuple(row[j] for j in linalg.row_reduce(F)[1]) for row in F) if F[0] else F


def _independent_outputs(model):
    """Return the outputs whose rows of C are independent, and the relations that the others give at once."""
    kept = list(linalg.row_reduce(linalg.transpose(model.C))[1])
    rows: list[Row] = []
    y = _signals(model, range(model.p))
    for row in _echelon(linalg.left_null_space(model.C)):
        rows += shift.apply((row,), y, model.p + model.m)
    return kept, rows


def _signals(model, outputs):
    """Return y - D u of some outputs as rows over (y, u)."""
    unit = lambda j: tuple((Fraction(1),) if i == j else () for i in range(model.p))
    return [unit(i) + tuple(shift.trim((-x,)) for x in model.D[i]) for i in outputs]


def _inputs(model):
    return [
        ((),) * model.p + tuple((Fraction(1),) if i == j else () for i in range(model.m))
        for j in range(model.m)
    ]


def _sum(a, b):
    return tuple(tuple(map(shift.add, r, s)) for r, s in zip(a, b, strict=True))


def _identity(n):
    return tuple(tuple(Fraction(int(i == j)) for j in range(n)) for i in range(n))
