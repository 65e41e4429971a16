"""Which part failed? Relations that ignore chosen faults, and what single faults can be told apart by them.

A fault of a sensor adds an arbitrary signal to its output, one of an actuator to its input. A relation
ignores it if the fault, taken as one more unknown input, is eliminated like the others. So for every set of
faults there is a minimal basis of the relations that ignore it.

    weak       the relation reacts to the fault at all
    constant   it goes on reacting while the fault stays as it is: the coefficients do not vanish at q = 1

Source: Ragot, Maquin, Kratz 1993, (21)-(22); structured residuals: Gertler 1991; achievable specifications:
Varga 2017.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from math import comb

import numpy as np

from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.relations import shift
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy, basis, redundancy
from jaxbound.relations.shift import Row
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

SUBSETS = 20_000
BANK = 24
"""Relations up to which a bank keeps every relation of minimal support."""
SOMEWHERE = Fraction(1_000_003)
"""A value of q at which supports are looked for; every relation that is found is then worked out for all
q.
"""


def structured_relations(
    model: ModelLike, insensitive_to: Sequence[str | Sequence[str]] | None = None
) -> Redundancy:
    """Return a bank of relations, each of which ignores the faults of some signals.

    Args:
        model: a LinearSystem, unknown inputs included.
        insensitive_to: a list with a tuple of names of inputs and outputs for each part of the bank, () for
            all relations. None: the relations that react to as few signals as they can; of more than 24 those
            that tell the signals apart best.

    Returns:
        A Redundancy: for each tuple a minimal basis of all relations that ignore its signals, whatever the
            fault.

    Raises:
        ValueError: no relation ignores such a tuple, a name that the model does not have, too many relations
            to choose from.

    Example:
        >>> from jaxbound import LinearSystem
        >>> m = LinearSystem([["1/2"]], [[1]], [[1], [2]])
        >>> print(structured_relations(m, [("u1",), ("y1",)]).text())
        r1: 2 y1 - y2 = 0
        r2: (2 q - 1) y2 - 4 u1 = 0
    """
    model = as_model(model)
    if insensitive_to is None:
        return _best(model)
    rows: list[Row] = []
    ignored: list[tuple[str, ...]] = []
    for names in insensitive_to:
        if isinstance(names, str):
            names = (names,)
        part = _relations_ignoring(model, names)
        if not part:
            raise ValueError(
                f"no relation ignores {listed(names, str)}: that many unknown signals can explain whatever "
                f"is left"
            )
        rows += part
        ignored += [tuple(names)] * len(part)
    return Redundancy(model, tuple(rows), tuple(ignored))


def _relations_ignoring(model: LinearSystem, names: Sequence[str]) -> tuple[Row, ...]:
    """Return a minimal basis of the relations that ignore the faults of some signals."""
    F, D_v = linalg.transpose(model.F), linalg.transpose(model.D_v)
    for name in names:
        through, direct = _fault_columns(model, name)
        F, D_v = (*F, through), (*D_v, direct)
    rows = basis(model, _rows_of_columns(F, model.n), _rows_of_columns(D_v, model.p))
    return tuple(sorted(map(shift.presentable_row, rows), key=shift.degree))


def _fault_columns(model: LinearSystem, name: str) -> tuple[Vector, Vector]:
    """Return the columns of F and D_v of a fault of one signal, taken as an unknown input."""
    if name in model.inputs:
        j = model.inputs.index(name)
        return tuple(row[j] for row in model.B), tuple(row[j] for row in model.D)
    if name in model.outputs:
        return (Fraction(0),) * model.n, linalg.identity(model.p)[model.outputs.index(name)]
    raise ValueError(f"the model has no signal {name!r}: it has {listed(model.outputs + model.inputs, str)}")


def _rows_of_columns(columns: Matrix, count: int) -> Matrix:
    """Return the rows of a matrix given by its columns, so many, even where there is no column."""
    if not columns:
        return ((),) * count
    return linalg.transpose(columns)


def _minimal_supports(rows: Sequence[Row]) -> list[tuple[int, ...]]:
    """Return the minimal supports of the combinations of rows."""
    numbers = linalg.row_reduce([shift.at(row, SOMEWHERE) for row in rows])[0] if rows else ()
    if not numbers:
        return []
    orthogonal = linalg.left_null_space(linalg.transpose(numbers))
    a = _rows_of_columns(orthogonal, len(numbers[0]))
    if comb(len(a), len(a) - len(numbers) + 1) > SUBSETS:
        raise ValueError(
            "too many relations to choose from: say which faults each part of the bank is to ignore"
        )
    supports = []
    for h in circuits(a):
        supports.append(tuple(j for j, x in enumerate(h) if x))
    return supports


def _best(model: LinearSystem) -> Redundancy:
    """Return the relations of fewest signals; of many, those that tell signals apart."""
    names = model.outputs + model.inputs
    banked = []
    for support in _minimal_supports(basis(model)):
        without = tuple(name for j, name in enumerate(names) if j not in support)
        banked.append((_relations_ignoring(model, without)[0], without))
    banked.sort(key=_shortest_first)
    if len(banked) > BANK:
        weak, _ = _reactions([row for row, _ in banked], len(names))
        banked = [banked[i] for i in _telling(weak)]
    rows, ignored = zip(*banked, strict=True) if banked else ((), ())
    return Redundancy(model, rows, ignored)


def _shortest_first(banked: tuple[Row, tuple[str, ...]]) -> tuple[int, list[bool]]:
    """Return the key by which relations of a bank are sorted: few samples, then the first signals."""
    row, _ = banked
    return shift.degree(row), [not p for p in row]


def _telling(reacts: np.ndarray) -> list[int]:
    """Return BANK of the relations, added one by one so that the closest pair of columns is as different as
    possible.
    """
    left, taken = list(range(len(reacts))), list[int]()
    pairs = list(combinations(range(reacts.shape[1]), 2))

    def distances_with(i: int) -> list[int]:
        chosen = reacts[[*taken, i]]
        return sorted(int((chosen[:, a] != chosen[:, b]).sum()) for a, b in pairs)

    for _ in range(BANK):
        best = max(left, key=distances_with)
        taken.append(best)
        left.remove(best)
    return sorted(taken)


@readable
@dataclass(frozen=True, eq=False)
class Signatures:
    """Which relation reacts to which single fault.

    Fields: relations: labels (R,); faults: names (N,); weak, constant: (R, N) bool, whether it reacts at all,
    and to a constant fault too.
    """

    relations: tuple[str, ...]
    faults: tuple[str, ...]
    weak: np.ndarray
    constant: np.ndarray

    @property
    def distance(self) -> int:
        """The smallest number of relations in which two faults differ; 0 where two cannot be told apart by
        whether relations react.
        """
        pairs = combinations(range(len(self.faults)), 2)
        return min((int((self.weak[:, i] != self.weak[:, j]).sum()) for i, j in pairs), default=0)

    @property
    def columns(self) -> dict[str, str]:
        """{fault: text with a sign for each relation}: 1 reacts, t only to changes of the fault, 0 not."""
        signs = np.where(self.constant, "1", np.where(self.weak, "t", "0"))
        return {name: "".join(signs[:, j]) for j, name in enumerate(self.faults)}

    def text(self) -> str:
        """Return the table, a relation a line."""
        signs = np.where(self.constant, "1", np.where(self.weak, "t", "."))
        return _text_table(self.faults, self.relations, signs)


def signatures(relations: Redundancy | ParityRelation) -> Signatures:
    """Return the table of which relation reacts to which single fault of an output or input.

    Args:
        relations: from `redundancy`, `structured_relations` or `parity_relations`.

    Returns:
        Signatures.

    Raises:
        TypeError: anything else.

    Example:
        >>> from jaxbound import LinearSystem
        >>> m = LinearSystem([[1]], [[1]], [[1], [2]])
        >>> print(signatures(structured_relations(m, [("u1",), ("y1",)])).text())
            y1 y2 u1
        r1   1  1  .
        r2   .  t  1
    """
    linear = getattr(getattr(relations, "relations", relations), "linear", None)
    if linear is None:
        raise TypeError(
            f"signatures needs relations, not {type(relations).__name__}: "
            f"signatures(structured_relations(model))"
        )
    rows = [_as_row(linear, h, k) for h, k in zip(linear.W, linear.K, strict=True)]
    names = linear.model.outputs + linear.model.inputs
    return Signatures(tuple(f"r{i + 1}" for i in range(len(rows))), names, *_reactions(rows, len(names)))


def _as_row(r: ParityRelation, h: Vector, k: Vector) -> Row:
    """Return one relation of a window as polynomials."""
    p, m = r.model.p, r.model.m
    row = []
    for i in range(p):
        row.append(shift.trim(h[i : (r.horizon + 1) * p : p]))
    for j in range(m):
        row.append(shift.trim([-x for x in k[j::m]]))
    return tuple(row)


def _reactions(rows: Sequence[Row], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (weak, constant), (R, width) bool."""
    weak, constant = np.zeros((len(rows), width), bool), np.zeros((len(rows), width), bool)
    for r, row in enumerate(rows):
        weak[r] = [bool(p) for p in row]
        constant[r] = [bool(sum(p)) for p in row]  # at q = 1
    return weak, constant


@readable
@dataclass(frozen=True, eq=False)
class Isolability:
    """Single faults of outputs and inputs that can be seen and told apart, if each may do what it likes.

    Fields: faults: names (N,); detectable (N,), isolable (N, N) bool: some relation reacts to fault i, and
    ignores fault j too;
    detectable_constant, isolable_constant: the same with a reaction to a constant fault; degree (N, N) int:
    the fewest samples less one that such a relation needs, -1 where there is none.
    """

    faults: tuple[str, ...]
    detectable: np.ndarray
    isolable: np.ndarray
    detectable_constant: np.ndarray
    isolable_constant: np.ndarray
    degree: np.ndarray

    def text(self) -> str:
        """Return a table: 1 where the fault of the row shows although that of the column is ignored, t only
        its changes.
        """
        signs = np.where(self.isolable_constant, "1", np.where(self.isolable, "t", "."))
        np.fill_diagonal(signs, "-")
        seen = np.where(self.detectable_constant, "1", np.where(self.detectable, "t", "."))
        return _text_table(("seen", *self.faults), self.faults, np.column_stack([seen, signs]))


def isolability(model: ModelLike) -> Isolability:
    """Return which single faults are detectable, and which pairs can be told apart, weakly and for constant
    faults.

    Args:
        model: a LinearSystem, unknown inputs included. Bounds do not matter here: see `detectable` for sizes.

    Returns:
        An Isolability.

    Example:
        >>> from jaxbound import LinearSystem
        >>> print(isolability(LinearSystem([[1]], [[1]], [[1], [2]])).text())
           seen y1 y2 u1
        y1    1  -  t  1
        y2    1  t  -  1
        u1    1  1  1  -
    """
    model = as_model(model)
    names = model.outputs + model.inputs
    count = len(names)
    weak, constant = np.zeros((count, count), bool), np.zeros((count, count), bool)
    degree = np.full((count, count), -1)
    for j, name in enumerate(names):
        rows = _relations_ignoring(model, (name,))
        seen, steady = _reactions(rows, count)
        weak[:, j], constant[:, j] = seen.any(0), steady.any(0)
        for i in range(count):
            degree[i, j] = min((shift.degree(row) for row in rows if row[i]), default=-1)
    seen, steady = _reactions(redundancy(model).rows, count)
    return Isolability(names, np.any(seen, 0), weak, np.any(steady, 0), constant, degree)


def _text_table(columns: Sequence[str], rows: Sequence[str], cells: np.ndarray) -> str:
    """Return a table as text, columns as wide as their names."""
    width = max(map(len, rows), default=0)
    lines = [" ".join([" " * width, *columns]).rstrip()]
    for label, line in zip(rows, cells, strict=True):
        marks = [mark.rjust(len(name)) for mark, name in zip(line, columns, strict=True)]
        lines.append(" ".join([label.ljust(width), *marks]).rstrip())
    return "\n".join(lines)
