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
from jaxbound.exact.linalg import Vector
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.relations import shift
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy, basis, redundancy
from jaxbound.relations.shift import Row
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

__all__ = [
    "Isolability",
    "Signatures",
    "Structure",
    "isolability",
    "signatures",
    "structured_relations",
    "structures",
]

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
        names = (names,) if isinstance(names, str) else tuple(names)
        found = _ignoring(model, names)
        if not found:
            raise ValueError(
                f"no relation ignores {listed(names, str)}: that many unknown signals can explain whatever "
                f"is left"
            )
        rows += found
        ignored += [names] * len(found)
    return Redundancy(model, tuple(rows), tuple(ignored))


def _ignoring(model: LinearSystem, names: Sequence[str]) -> tuple[Row, ...]:
    """Return a minimal basis of the relations that ignore the faults of some signals."""
    F, D_v = [list(row) for row in model.F], [list(row) for row in model.D_v]
    for name in names:
        if name in model.inputs:
            j = model.inputs.index(name)
            through, direct = [row[j] for row in model.B], [row[j] for row in model.D]
        elif name in model.outputs:
            through, direct = [Fraction(0)] * model.n, [Fraction(int(o == name)) for o in model.outputs]
        else:
            raise ValueError(
                f"the model has no signal {name!r}: it has {listed(model.outputs + model.inputs, str)}"
            )
        for row, x in zip(F + D_v, through + direct, strict=True):
            row.append(x)
    found = basis(model, tuple(map(tuple, F)), tuple(map(tuple, D_v)))
    return tuple(sorted(map(shift.presentable, found), key=shift.degree))


def _supports(rows: Sequence[Row], columns: Sequence[int]) -> list[tuple[int, ...]]:
    """Return the minimal supports (tuples of positions in `columns`) of the combinations of rows that do not
    vanish there.
    """
    at_once = [tuple(shift.at(row, SOMEWHERE)[c] for c in columns) for row in rows]
    numbers = linalg.row_reduce(at_once)[0] if at_once else ()
    if not numbers:
        return []
    null = linalg.left_null_space(linalg.transpose(numbers))  # what is orthogonal to all of them
    a = linalg.transpose(null) if null else tuple(() for _ in columns)
    if comb(len(a), len(a) - len(numbers) + 1) > SUBSETS:
        raise ValueError(
            "too many relations to choose from: say which faults each part of the bank is to ignore"
        )
    return [tuple(j for j, x in enumerate(h) if x) for h in circuits(a)]


def _best(model: LinearSystem) -> Redundancy:
    names = model.outputs + model.inputs
    rows, ignored = [], []
    for support in _supports(basis(model), range(len(names))):
        without = tuple(name for j, name in enumerate(names) if j not in support)
        found = _ignoring(model, without)
        rows.append(found[0])
        ignored.append(without)
    order = sorted(range(len(rows)), key=lambda i: (shift.degree(rows[i]), [not p for p in rows[i]]))
    if len(order) > BANK:
        order = _chosen([[bool(p) for p in rows[i]] for i in order], order)
    return Redundancy(model, tuple(rows[i] for i in order), tuple(ignored[i] for i in order))


def _chosen(table: Sequence[Sequence[bool]], order: list[int]) -> list[int]:
    """Return BANK of the relations, added one by one so that the closest pair of columns is as different as
    possible.
    """
    reacts, left = np.array(table), list(range(len(order)))
    taken: list[int] = []
    pairs = list(combinations(range(reacts.shape[1]), 2))
    apart = lambda chosen: sorted((reacts[chosen][:, [i]] != reacts[chosen][:, [j]]).sum() for i, j in pairs)
    for _ in range(BANK):
        best = max(left, key=lambda i: apart([*taken, i]))
        taken.append(best)
        left.remove(best)
    return [order[i] for i in sorted(taken)]


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
        return _table(
            "", self.faults, self.relations, np.where(self.constant, "1", np.where(self.weak, "t", "."))
        )


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
    if isinstance(relations, ParityRelation):
        relations = Redundancy(
            relations.model,
            tuple(_as_row(relations, h, k) for h, k in zip(relations.W, relations.K, strict=True)),
            (),
        )
    if not isinstance(relations, Redundancy):
        raise TypeError(
            f"signatures needs relations, not {type(relations).__name__}: "
            f"signatures(structured_relations(model))"
        )
    weak, constant = _reactions(relations.rows, len(relations.names))
    return Signatures(tuple(f"r{i + 1}" for i in range(relations.count)), relations.names, weak, constant)


def _as_row(r: ParityRelation, h: Vector, k: Vector) -> Row:
    """Return one relation of a window as polynomials."""
    p, m = r.model.p, r.model.m
    outputs = [shift.trim(h[i : (r.horizon + 1) * p : p]) for i in range(p)]
    return (*outputs, *(shift.trim([-x for x in k[j::m]]) for j in range(m)))


def _reactions(rows: Sequence[Row], width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (weak, constant), (R, width) bool."""
    weak = np.array([[bool(p) for p in row] for row in rows], bool).reshape(len(rows), width)
    return weak, np.array([[bool(sum(p)) for p in row] for row in rows], bool).reshape(len(rows), width)


@readable
@dataclass(frozen=True, eq=False)
class Isolability:
    """What single faults of outputs and inputs can be seen and told apart, if each may do what it likes.

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
        return _table("", ("seen", *self.faults), self.faults, np.column_stack([seen, signs]))


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
    weak, constant, degree = (
        np.zeros((count, count), bool),
        np.zeros((count, count), bool),
        np.full((count, count), -1),
    )
    for j, name in enumerate(names):
        rows = _ignoring(model, (name,))
        seen, steady = _reactions(rows, count)
        weak[:, j], constant[:, j] = seen.any(0), steady.any(0)
        for i in range(count):
            degree[i, j] = min((shift.degree(row) for row in rows if row[i]), default=-1)
    seen, steady = _reactions(redundancy(model).rows, count)
    return Isolability(names, np.any(seen, 0), weak, np.any(steady, 0), constant, degree)


@dataclass(frozen=True)
class Structure:
    """A set of faults to which a relation can react, and to no other.

    Fields: faults: names; count: how many independent relations ignore all others; order: the sum of their
    degrees in a minimal basis;
    least_degree: the smallest degree of a relation that reacts to exactly these; constant: some such relation
    reacts to each of them for good.
    """

    faults: tuple[str, ...]
    count: int
    order: int
    least_degree: int
    constant: bool


def structures(model: ModelLike, faults: Sequence[str] | None = None) -> list[Structure]:
    """Return every achievable weak structure: each set of faults to which some relation reacts, and to no
    other of `faults`.

    Args:
        model: a LinearSystem. faults: names of the signals that may fail; None: all outputs and inputs.

    Raises:
        ValueError: an unknown name, too many sets.

    Example:
        >>> from jaxbound import LinearSystem
        >>> [s.faults for s in structures(LinearSystem([["1/2"]], [[1]], [[1], [2]]), ("y1", "u1"))]
        [('y1',), ('u1',), ('y1', 'u1')]
    """
    model = as_model(model)
    names = model.outputs + model.inputs
    faults = names if faults is None else tuple(faults)
    columns = [names.index(name) for name in faults if name in names]
    if len(columns) < len(faults):
        _ignoring(model, faults)
    unions: set[frozenset[int]] = {frozenset()}
    minimal = _supports(basis(model), columns)
    for support in minimal:
        unions |= {old | set(support) for old in unions}
        if len(unions) > SUBSETS:
            raise ValueError(f"more than {SUBSETS} sets of faults: name fewer faults")
    out = []
    for union in sorted((sorted(x) for x in unions if x), key=lambda x: (len(x), x)):
        rows = _ignoring(model, tuple(f for j, f in enumerate(faults) if j not in union))
        reacts = lambda rows, union=union: {j for j in union for row in rows if row[columns[j]]}
        degrees = [shift.degree(row) for row in rows]
        least = next(
            d
            for d in sorted(degrees)
            if reacts([r for r, e in zip(rows, degrees, strict=True) if e <= d]) == set(union)
        )
        steady = all(any(sum(row[columns[j]]) for row in rows) for j in union)
        out.append(Structure(tuple(faults[j] for j in union), len(rows), sum(degrees), least, steady))
    return out


def _table(corner: str, columns: Sequence[str], rows: Sequence[str], cells: np.ndarray) -> str:
    width = max([len(corner), *map(len, rows)])
    head = [corner.ljust(width), *columns]
    lines = [
        [label.ljust(width), *(c.rjust(len(name)) for c, name in zip(line, columns, strict=True))]
        for label, line in zip(rows, cells, strict=True)
    ]
    return "\n".join(" ".join(line).rstrip() for line in [head, *lines])
