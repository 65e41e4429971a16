"""The directions in which unknown inputs may carry the state, and the ones that outputs of one sample show.

Inputs without a bound, x+ = A x + F v + .., move a state that is known into a subspace of which nothing is
known. Outputs y = C x + .. show a part of it, the rest goes on through A. The smallest subspace S that holds
all of this, from any start on,

    S  >=  range F + A N,      N = the part of S that no output shows = S & ker C,

does not depend on time. So with x_0 = the state less anything of S, before a sample, and m = C x, for every
such x

    x  =  M x_0 + H m + (anything of N),      M = (I - Y)(I - H C),   M S = 0,   C M + C H C = C,

H working S out of as many outputs as show it, Y taking the part N away, C Y = 0. What M x_0 + H m follows is
a plant without unknown inputs, and no less is known of its outputs. All numbers are exact; A may be
uncertain, C may not.

Source: Basile, Marro 1992, 4.1 (the least conditioned invariant that holds range F); Kitanidis 1987 (filters
that unknown inputs do not disturb, for N = 0: rank C F = rank F).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, islice

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector, columns_of
from jaxbound.models.more_states import more_states
from jaxbound.models.system import LinearSystem

WAYS, TRIED = 16, 200
"""Sets of outputs that S is worked out of, at most: where one of them is missing, another is taken. And how
many are tried.
"""
ZERO = Fraction(0)


@dataclass(frozen=True)
class Way:
    """One way to take S out of a sample. Fields: outputs: those that are used up; M (n, n), H (n, p): see the
    module, exact.
    """

    outputs: tuple[int, ...]
    M: Matrix
    H: Matrix


@dataclass(frozen=True)
class Directions:
    """The subspaces S and N of a model.

    Fields: rows: a basis of S in reduced echelon form; hidden: of N; ways: the first one where all outputs
    are there.
    """

    rows: Matrix
    hidden: Matrix
    ways: tuple[Way, ...]

    @property
    def before(self) -> tuple[bool, ...]:
        """Of which states nothing is known before a sample, (n,)."""
        return tuple(any(column) for column in zip(*self.rows, strict=True))

    @property
    def after(self) -> tuple[bool, ...]:
        """Of which states nothing is known after a sample, (n,)."""
        return tuple(any(column) for column in zip(*self.hidden, strict=True)) or (False,) * len(self.rows[0])

    @property
    def places(self) -> tuple[int, ...]:
        """The states that M x_0 + H m has 0 at, as many as N has dimensions."""
        return tuple(next(i for i, x in enumerate(row) if x) for row in self.hidden)


def unknown_directions(model: LinearSystem) -> Directions | None:
    """Return the Directions of a model with D_v = 0 (see `with_direct_states`); None if no unknown input
    moves a state.

    Raises:
        ValueError: uncertain parameters that act on the outputs, unknown inputs that explain whatever the
            outputs show.
    """
    moves = [model.A]
    for u in model.uncertainties:
        moved = u.on("A")
        if moved is not None:
            moves.append(moved)
        if model.d and u.C is not None and any(map(any, u.C)):
            raise ValueError(
                f"an observer of unknown inputs needs certain outputs, and {u.name!r} acts on C: decouple "
                f"it, or make C certain"
            )
    columns = [c for c in linalg.transpose(model.F) if any(c)]
    if not columns:
        return None
    rows, hidden = _smallest(model, moves, columns)
    if linalg.rank(_seen(model.C, rows)) == model.p:
        raise ValueError(_nothing_left(model, moves))
    return Directions(rows, hidden, _ways(model, rows, hidden))


def _smallest(
    model: LinearSystem, moves: Sequence[Matrix], columns: Sequence[Vector]
) -> tuple[Matrix, Matrix]:
    """Return bases (S, N), rows in reduced echelon form."""
    rows = linalg.row_reduce(columns)[0]
    while True:
        hidden: Matrix = ()
        if rows:
            unseen = linalg.left_null_space(_seen(model.C, rows))
            # combinations of S that outputs show as 0
            hidden = linalg.row_reduce(linalg.matmul(unseen, rows))[0]
        wider = list(rows)
        if hidden:
            for A in moves:
                wider += linalg.matmul(hidden, linalg.transpose(A))
        grown = linalg.row_reduce(wider)[0]
        # subspaces grow by a dimension at least, or not at all: n steps end it
        if len(grown) == len(rows):
            return rows, hidden
        rows = grown


def _seen(C: Matrix, rows: Matrix) -> Matrix:
    """Return the parts of directions that outputs show, one row each."""
    return linalg.matmul(rows, linalg.transpose(C))


def _ways(model: LinearSystem, rows: Matrix, hidden: Matrix) -> tuple[Way, ...]:
    """Return the ways to take S out of a sample, those that amplify the errors of sensors least first."""
    loud = []
    for noise, resolution, tolerance in zip(model.noise, model.resolution, model.tolerance, strict=True):
        loud.append(float(noise + resolution + tolerance))
    quiet = sorted(range(model.p), key=lambda i: loud[i])
    seen = _seen(model.C, rows)
    kept = linalg.row_reduce(linalg.transpose(seen))[1]  # directions that outputs show, and differently
    S = linalg.transpose([rows[j] for j in kept])
    identity, Y = linalg.identity(model.n), _on_hidden(hidden, model.n)
    ways: list[Way] = []
    for outputs in islice(combinations(quiet, len(kept)), TRIED):
        chosen = linalg.transpose(columns_of([seen[j] for j in kept], outputs))
        # these outputs show less of S than all do
        if linalg.rank(chosen) < len(kept):
            continue
        columns = dict(zip(outputs, linalg.transpose(linalg.matmul(S, linalg.inverse(chosen))), strict=True))
        none = (ZERO,) * model.n
        H = linalg.transpose([columns.get(i, none) for i in range(model.p)])
        M = _less(identity, linalg.matmul(H, model.C))
        M, H = _less(M, linalg.matmul(Y, M)), _less(H, linalg.matmul(Y, H))
        ways.append(Way(tuple(sorted(outputs)), M, H))
    # quiet outputs were tried first; how loud a way is, its H alone says
    ways.sort(key=lambda way: _amplified(way.H, loud))
    return tuple(ways[:WAYS])


def _on_hidden(hidden: Matrix, n: int) -> Matrix:
    """Return Y (n, n), which takes the part N away: each row of its basis at the place where it has its 1."""
    columns = dict.fromkeys(range(n), (ZERO,) * n)
    for row in hidden:
        place = next(i for i, x in enumerate(row) if x)
        columns[place] = row
    return linalg.transpose([columns[j] for j in range(n)])


def _amplified(H: Matrix, loud: Sequence[float]) -> float:
    """Return the size of what errors of sensors do to the states."""
    total = 0.0
    for row in H:
        for x, size in zip(row, loud, strict=True):
            total += abs(float(x)) * size
    return total


def _nothing_left(model: LinearSystem, moves: Sequence[Matrix]) -> str:
    """Return the sentence that says which unknown inputs explain everything, as few of them as do."""
    columns = dict(enumerate(linalg.transpose(model.F), 1))
    # each that can go without a change goes: those that stay explain everything together
    for j in reversed(list(columns)):
        fewer = [c for i, c in columns.items() if i != j and any(c)]
        if fewer and linalg.rank(_seen(model.C, _smallest(model, moves, fewer)[0])) == model.p:
            del columns[j]
    named = ", ".join(map(str, columns))
    which = f"unknown inputs {named} together explain"
    if len(columns) == 1:
        which = f"unknown input {named} alone explains"
    return (
        f"{which} whatever the {model.p} outputs show, in an observer as in windows of any horizon: "
        "measure one more signal, or give bounds (disturbance=...)"
    )


def with_direct_states(model: LinearSystem) -> LinearSystem:
    """Return the model with one more state for each unknown input that acts on an output at once."""
    direct = [j for j, column in enumerate(linalg.transpose(model.D_v)) if any(column)]
    if not direct:
        return model
    k, n = len(direct), model.n
    columns = columns_of(model.F, direct), columns_of(model.D_v, direct)
    none = linalg.zeros(n, k), linalg.zeros(model.p, k)
    names = [f"unknown input {j + 1}" for j in direct]
    changes = more_states(model, names, lambda _: columns, lambda _: none, linalg.zeros(k, k))
    # What acted on an output at once now acts on its own state, which the next step brings.
    others = [[ZERO if j in direct else x for j, x in enumerate(row)] for row in model.F]
    own = linalg.identity(model.d)
    changes["unknown_inputs"] = [*others, *(own[j] for j in direct)]
    return model.replace(**changes)


def _less(a: Matrix, b: Matrix) -> Matrix:
    """Return a - b."""
    return tuple(linalg.add_multiple(row, -1, other) for row, other in zip(a, b, strict=True))
