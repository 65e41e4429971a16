"""Unknowns that act on a plant without any bound: unknown inputs, parameters without trusted bounds, and
states that no equation determines.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias, cast

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, MatrixLike, Number, Vector, columns_of
from jaxbound.models.numbers import entries_of, exact_matrix
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.text.names import listed

Coupling: TypeAlias = MatrixLike | tuple[MatrixLike, MatrixLike]
"""How unknown inputs are given: F, or (F, D_v)."""
Bounded: TypeAlias = tuple[MatrixLike, Number | Sequence[Number | Sequence[Number]] | np.ndarray]
"""How a disturbance is given: (G, bound)."""


class Given(NamedTuple):
    """A plant as it is given; the fields are arguments of a LinearSystem."""

    A: MatrixLike | None
    B: MatrixLike | None
    C: MatrixLike | None
    D: MatrixLike | None
    disturbance: Bounded | None
    unknown_inputs: Coupling | None


class Matrices(NamedTuple):
    """The matrices of x+ = A x + B u + G w + F v, y = C x + D u + D_v v, exact."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    G: Matrix
    F: Matrix
    D_v: Matrix


def unbounded_inputs(given: Coupling | None, n: int, p: int) -> tuple[Matrix, Matrix]:
    """Return F (n, d) and D_v (p, d) from F or a pair (F, D_v); None: none.

    Raises ValueError naming what does not fit.
    """
    if given is None:
        return tuple(() for _ in range(n)), tuple(() for _ in range(p))
    on_states, on_outputs = _parts(given)
    F = exact_matrix("F of the unknown inputs", on_states)
    if len(F) != n:
        raise ValueError(f"F of the unknown inputs needs one row per state ({n}): it has {len(F)}")
    if on_outputs is None:
        return F, linalg.zeros(p, len(F[0]))
    D_v = exact_matrix("D_v of the unknown inputs", on_outputs)
    if (len(D_v), len(D_v[0])) != (p, len(F[0])):
        shape = (len(D_v), len(D_v[0]))
        raise ValueError(
            f"D_v of the unknown inputs must have shape {(p, len(F[0]))} to fit C and F: its shape is {shape}"
        )
    return F, D_v


def _parts(given: Coupling) -> tuple[MatrixLike, MatrixLike | None]:
    """Return F and D_v, None where there is F alone."""
    if len(given) == 2 and np.asarray(given[0], object).ndim == 2:
        F, D_v = cast("tuple[MatrixLike, MatrixLike]", given)
        return F, D_v
    return cast("MatrixLike", given), None


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
    trusted: list[Uncertainty] = []
    for u in uncertainties:
        if u.name not in names:
            trusted.append(u)
            continue
        on_states, on_outputs = _independent_columns(u, len(F), len(D_v))
        F, D_v = linalg.beside(F, on_states), linalg.beside(D_v, on_outputs)
    return tuple(trusted), F, D_v


def _independent_columns(u: Uncertainty, n: int, p: int) -> tuple[Matrix, Matrix]:
    """Return the columns (n, k), (p, k) that span all that a parameter moves in x+ and in y."""
    m = _width(u.B, u.D)
    whole = linalg.beside(
        (u.A or linalg.zeros(n, n)) + (u.C or linalg.zeros(p, n)),
        (u.B or linalg.zeros(n, m)) + (u.D or linalg.zeros(p, m)),
    )
    # as many columns as the rank: more unknown inputs would take relations away
    pivots = linalg.row_reduce(whole)[1]
    columns = tuple(tuple(row[j] for j in pivots) for row in whole)
    return columns[:n], columns[n:]


def _width(*matrices: Matrix | None) -> int:
    """Return the number of columns of the first matrix that is there; 0 without one."""
    for rows in matrices:
        if rows is not None:
            return len(rows[0])
    return 0


def explicit(E: Matrix, given: Matrices) -> tuple[Matrices, tuple[int, ...] | None]:
    """Bring E z+ = A z + B u + G w + F v, y = C z + D u + D_v v into the form of a model: return (its
    matrices, states).

    E (r, n) may be singular and need not be square. The new state x is what E determines, the reduced rows of
    E times z; the rest of z is driven by no equation and becomes unknown inputs. An equation without z+ is
    solved for one of them. `states` are the numbers of the entries of z that x consists of, None where it
    mixes them. Source: Ragot 1993, (5)-(7), by exact elimination instead of singular values.

    Raises:
        ValueError: an equation without z+ that restricts the state, or puts a disturbance into an output.
    """
    A, B, C, D, G, F, D_v = given
    r, n, k_u, k_w = len(E), len(E[0]), len(B[0]), len(G[0])
    reduced, pivots = linalg.row_reduce(linalg.beside(E, linalg.identity(r)))
    determined = tuple(j for j in pivots if j < n)
    k = len(determined)
    x = tuple(row[:n] for row in reduced[:k])  # the new state is this times z
    T = tuple(row[n:] for row in reduced)  # T E = [x; 0]
    free = tuple(row for j, row in enumerate(linalg.identity(n)) if j not in determined)
    back = linalg.inverse(x + free)  # z = back (new state, what nothing drives)

    # columns in the order: new state, u, w, and then all that is unknown
    stated = k + k_u + k_w
    on_state, on_outputs = linalg.matmul(linalg.matmul(T, A), back), linalg.matmul(C, back)
    state, driven = range(k), range(k, n)
    B, G, F = (linalg.matmul(T, M) for M in (B, G, F))
    rows = linalg.beside(columns_of(on_state, state), B, G, columns_of(on_state, driven), F)
    no_w = linalg.zeros(len(C), k_w)
    outputs = linalg.beside(columns_of(on_outputs, state), D, no_w, columns_of(on_outputs, driven), D_v)

    solved = _solved(rows[k:], stated)
    rows, outputs = _eliminated(rows[:k], solved), _eliminated(outputs, solved)
    inputs, disturbances = range(k, k + k_u), range(k + k_u, stated)
    if any(map(any, columns_of(outputs, disturbances))):
        raise ValueError(
            "an equation without x+ puts a disturbance into an output: give it as noise of that output "
            "instead"
        )
    # what an equation without x+ determines is unknown no more
    left = [j for j in range(stated, stated + n - k + len(D_v[0])) if j not in solved]
    # a state that is one entry of z keeps its name
    is_picked = all(sum(map(bool, row)) == 1 for row in x)
    solved_for = Matrices(
        A=columns_of(rows, state),
        B=columns_of(rows, inputs),
        C=columns_of(outputs, state),
        D=columns_of(outputs, inputs),
        G=columns_of(rows, disturbances),
        F=columns_of(rows, left),
        D_v=columns_of(outputs, left),
    )
    return solved_for, determined if is_picked else None


def _solved(equations: Matrix, known: int) -> dict[int, Vector]:
    """Solve equations, row times (known entries, unknown ones) = 0, for unknown entries.

    Returns:
        {number of an unknown entry: its row, 1 there and 0 at the others}.
    """
    solved = {}
    reduced, pivots = linalg.row_reduce([row[known:] + row[:known] for row in equations])
    for row, j in zip(reduced, pivots, strict=True):
        unknown = len(row) - known
        if j >= unknown:
            raise ValueError(
                "an equation without x+ restricts the states themselves: use it, or its shifted form, to "
                "remove a state first"
            )
        # back in the order of the rows that it will be taken out of
        solved[known + j] = row[unknown:] + row[:unknown]
    return solved


def _eliminated(rows: Matrix, solved: Mapping[int, Vector]) -> Matrix:
    """Return rows without the entries that equations are solved for."""
    out = []
    for row in rows:
        for j, equation in solved.items():
            row = linalg.add_multiple(row, -row[j], equation)
        out.append(row)
    return tuple(out)


def without_descriptor(
    E: MatrixLike, given: Given, states: str | Sequence[str] | None
) -> tuple[Given, list[str] | None]:
    """Return (the plant without E, its states) of one with it, see `explicit`.

    Raises ValueError: shapes that do not fit, and as `explicit`.
    """
    descriptor, A, C = exact_matrix("E", E), exact_matrix("A", given.A), exact_matrix("C", given.C)
    r, n, p = len(descriptor), len(descriptor[0]), len(C)
    B = entries_of("B", given.B) or linalg.zeros(r, 0)
    m = len(B[0])
    D = entries_of("D", given.D) or linalg.zeros(p, m)
    G, bound = linalg.zeros(r, 0), None
    if given.disturbance is not None:
        G, bound = exact_matrix("G", given.disturbance[0]), given.disturbance[1]
    shapes = ((r, n), (r, m), (p, n), (p, m), (r, len(G[0])))
    for letter, M, shape in zip("ABCDG", (A, B, C, D, G), shapes, strict=True):
        if (len(M), len(M[0])) != shape:
            raise ValueError(
                f"{letter} must have shape {shape} to fit E, {(r, n)}: its shape is {(len(M), len(M[0]))}"
            )
    names = [states] if isinstance(states, str) else states
    if names is not None and len(names) != n:
        raise ValueError(f"states needs {n} names, one for each: {len(names)} given")
    unknown = unbounded_inputs(given.unknown_inputs, r, p)
    kept, numbers = explicit(descriptor, Matrices(A, B, C, D, G, *unknown))
    bounded = None if bound is None else (kept.G, bound)
    coupling = (kept.F, kept.D_v) if kept.D_v[0] else None
    plain = Given(kept.A, kept.B, kept.C, kept.D, bounded, coupling)
    if names is None or numbers is None:
        return plain, None
    return plain, [names[j] for j in numbers]
