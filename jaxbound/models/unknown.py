"""Unknowns that act on a plant without any bound: unknown inputs, parameters without trusted bounds, and
states that no equation determines.
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import TypeAlias, cast

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, MatrixLike, Number
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.text.names import listed

__all__ = ["Bounded", "Coupling", "decoupled", "explicit", "unbounded_inputs", "without_descriptor"]

ZERO = Fraction(0)

Coupling: TypeAlias = MatrixLike | tuple[MatrixLike, MatrixLike]
"""How unknown inputs are given: F, or (F, D_v)."""
Bounded: TypeAlias = tuple[MatrixLike, Number | Sequence[Number | Sequence[Number]] | np.ndarray]
"""How a disturbance is given: (G, bound)."""


def unbounded_inputs(given: Coupling | None, n: int, p: int) -> tuple[Matrix, Matrix]:
    """Return F (n, d) and D_v (p, d) from F or a pair (F, D_v); None: none.

    Raises ValueError naming what does not fit.
    """
    if given is None:
        return tuple(() for _ in range(n)), tuple(() for _ in range(p))
    pair = len(given) == 2 and np.asarray(given[0], object).ndim == 2
    first, second = (
        cast("tuple[MatrixLike, MatrixLike]", given) if pair else (cast("MatrixLike", given), None)
    )
    F = _matrix("F", first)
    if len(F) != n:
        raise ValueError(f"F of the unknown inputs needs one row per state ({n}): it has {len(F)}")
    D_v = ((ZERO,) * len(F[0]),) * p if second is None else _matrix("D_v", second)
    if (len(D_v), len(D_v[0])) != (p, len(F[0])):
        shape = (len(D_v), len(D_v[0]))
        raise ValueError(
            f"D_v of the unknown inputs must have shape {(p, len(F[0]))} to fit C and F: its shape is {shape}"
        )
    return F, D_v


def decoupled(
    uncertainties: Sequence[Uncertainty], names: str | Sequence[str], F: Matrix, D_v: Matrix
) -> tuple[tuple[Uncertainty, ...], Matrix, Matrix]:
    """Treat some uncertainties as unknown inputs: return (the other uncertainties, F, D_v).

    A parameter v acts as v [dA dB; dC dD] (x; u) = v [L; L'] (R x + S u), with as many columns of [L; L'] as
    the rank of the matrix; v times the last factor is an unknown input. Source: golden recipe (a) for Ragot
    1993.

    Raises ValueError for a name that no uncertainty has.
    """
    names = (names,) if isinstance(names, str) else tuple(names)
    known = [u.name for u in uncertainties]
    if strange := [name for name in names if name not in known]:
        raise ValueError(
            f"decouple names {strange[0]!r}, but the uncertainties are {listed(known) or 'none'}"
        )
    n, p = len(F), len(D_v)
    rows = [list(row) for row in F + D_v]
    for u in uncertainties:
        if u.name in names:
            wide = lambda pair, u=u: next(
                (len(getattr(u, o)[0]) for o in pair if getattr(u, o) is not None), 0
            )
            part = lambda letter, count, pair, u=u, wide=wide: (
                getattr(u, letter) or ((ZERO,) * wide(pair),) * count
            )
            whole = [a + b for a, b in zip(part("A", n, "AC"), part("B", n, "BD"), strict=True)]
            whole += [a + b for a, b in zip(part("C", p, "AC"), part("D", p, "BD"), strict=True)]
            for j in linalg.row_reduce(whole)[1]:
                for row, x in zip(rows, whole, strict=True):
                    row.append(x[j])
    rest = tuple(u for u in uncertainties if u.name not in names)
    return rest, tuple(map(tuple, rows[:n])), tuple(map(tuple, rows[n:]))


def explicit(
    E: Matrix, A: Matrix, B: Matrix, C: Matrix, D: Matrix, G: Matrix, F: Matrix, D_v: Matrix
) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix, Matrix, Matrix, tuple[int, ...] | None]:
    """Bring E z+ = A z + B u + G w + F v, y = C z + D u + D_v v into the form of a model: return (A, B, C, D,
    G, F, D_v, states).

    E (r, n) may be singular and need not be square. The new state x is what E determines, the reduced rows of
    E times z; the rest of z is driven by no equation and becomes unknown inputs. An equation without z+ is
    solved for one of them. `states` are the numbers of the entries of z that x consists of, None where it
    mixes them. Source: Ragot 1993, (5)-(7), by exact elimination instead of singular values.

    Raises:
        ValueError: an equation without z+ that restricts the state, or puts a disturbance into an output.
    """
    r, n = len(E), len(E[0])
    unit = lambda i, count: tuple(Fraction(int(i == j)) for j in range(count))
    reduced, pivots = linalg.row_reduce([tuple(row) + unit(i, r) for i, row in enumerate(E)])
    kept = tuple(j for j in pivots if j < n)
    x, T = [row[:n] for row in reduced[: len(kept)]], [row[n:] for row in reduced]
    back = linalg.inverse(x + [unit(j, n) for j in range(n) if j not in kept])
    rows = [a + b + g + f for a, b, g, f in zip(A, B, G, F, strict=True)]
    widths = len(B[0]), len(G[0]), len(F[0])
    rows = [linalg.matmul((row[:n],), back)[0] + row[n:] for row in linalg.matmul(T, rows)]
    outputs = [
        linalg.matmul((c,), back)[0] + d + (ZERO,) * widths[1] + v for c, d, v in zip(C, D, D_v, strict=True)
    ]
    ends = [sum((len(kept), *widths[:i])) for i in range(4)]
    in_order = lambda row: (
        row[: len(kept)] + row[n:] + row[len(kept) : n]
    )  # x, u, w, then all that is unknown
    rows, outputs = [in_order(row) for row in rows], [in_order(row) for row in outputs]
    without = [row[ends[2] :] + row[: ends[2]] for row in rows[len(kept) :]]
    unknown = len(rows[0]) - ends[2]
    solved = {}
    for row, j in zip(*linalg.row_reduce(without), strict=True):
        if j >= unknown:
            raise ValueError(
                "an equation without x+ restricts the states themselves: use it, or its shifted form, to "
                "remove a state first"
            )
        solved[j] = row[unknown:] + row[:unknown]
    for part in (rows, outputs):
        for i, row in enumerate(part):
            for j, other in solved.items():
                row = tuple(a - row[ends[2] + j] * b for a, b in zip(row, other, strict=True))
            part[i] = row
    if any(any(row[ends[1] : ends[2]]) for row in outputs):
        raise ValueError(
            "an equation without x+ puts a disturbance into an output: give it as noise of that output "
            "instead"
        )
    left = [ends[2] + j for j in range(unknown) if j not in solved]
    cut = lambda part, i: tuple(row[ends[i - 1] if i else 0 : ends[i]] for row in part)
    rows = rows[: len(kept)]
    pick = lambda part: tuple(tuple(row[j] for j in left) for row in part)
    states = kept if all(sum(map(bool, row)) == 1 for row in x) else None
    return (
        cut(rows, 0),
        cut(rows, 1),
        cut(outputs, 0),
        cut(outputs, 1),
        cut(rows, 2),
        pick(rows),
        pick(outputs),
        states,
    )


def without_descriptor(
    E: MatrixLike,
    A: MatrixLike | None,
    B: MatrixLike | None,
    C: MatrixLike | None,
    D: MatrixLike | None,
    disturbance: Bounded | None,
    given: Coupling | None,
    states: str | Sequence[str] | None,
) -> tuple[Matrix, Matrix, Matrix, Matrix, Bounded | None, Coupling | None, list[str] | None]:
    """Return (A, B, C, D, disturbance, unknown_inputs, states) of a model without E from the fields of one
    with it, see `explicit`.

    Raises ValueError: shapes that do not fit, and as `explicit`.
    """
    descriptor, exact_A, exact_C = _matrix("E", E), _matrix("A", A), _matrix("C", C)
    r, n, p = len(descriptor), len(descriptor[0]), len(exact_C)
    exact_B = _matrix("B", B) if B is not None and np.size(np.asarray(B, object)) else ((),) * r
    m = len(exact_B[0])
    exact_D = _matrix("D", D) if D is not None and np.size(np.asarray(D, object)) else ((ZERO,) * m,) * p
    G = ((),) * r if disturbance is None else _matrix("G", disturbance[0])
    shapes = ((r, n), (r, m), (p, n), (p, m), (r, len(G[0])))
    for letter, M, shape in zip("ABCDG", (exact_A, exact_B, exact_C, exact_D, G), shapes, strict=True):
        if (len(M), len(M[0])) != shape:
            raise ValueError(
                f"{letter} must have shape {shape} to fit E, {(r, n)}: its shape is {(len(M), len(M[0]))}"
            )
    called = (states,) if isinstance(states, str) else states
    if called is not None and len(called) != n:
        raise ValueError(f"states needs {n} names, one for each: {len(called)} given")
    F, D_v = unbounded_inputs(given, r, p)
    *plant, F, D_v, numbers = explicit(descriptor, exact_A, exact_B, exact_C, exact_D, G, F, D_v)
    names = [called[j] for j in numbers] if called is not None and numbers is not None else None
    kept_A, kept_B, kept_C, kept_D, G = plant
    return (
        kept_A,
        kept_B,
        kept_C,
        kept_D,
        None if disturbance is None else (G, disturbance[1]),
        (F, D_v) if D_v[0] else None,
        names,
    )


def _matrix(letter: str, given: MatrixLike | None) -> Matrix:
    try:
        return linalg.matrix(cast("MatrixLike", given))  # None is refused there
    except (ValueError, TypeError) as e:
        raise ValueError(
            f"{letter}{' of the unknown inputs' if letter in ('F', 'D_v') else ''}: {e}"
        ) from None
