"""Signals that one column moves: what an actuator does wrong shows in every signal that is computed from it.

    e(c + f) - e(c) = f e_1 + f^2 e_2 + ..,    e_i: polynomials in the columns

A model with the inputs cool and cool2 = cool*cool has one actuator behind both.
"""

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import comb
from typing import TypeAlias

from jaxbound.models.system import LinearSystem
from jaxbound.recordings.expressions import expression, is_expression

Polynomial: TypeAlias = Mapping[tuple[str, ...], Fraction]
"""{columns that are multiplied, in order, each as often as its power: coefficient}."""
ONE: Polynomial = {(): Fraction(1)}
LARGEST = 8
"""Power beyond which an expression counts as none of polynomials: it is multiplied out."""


@dataclass(frozen=True)
class Follower:
    """A signal that is computed from a column.

    Fields: signal: its name; is_input; number: of the input or output; column: that moves it; powers: (e_1,
    e_2, ..); None: it is no polynomial in that column. products: whether the whole signal is e_1 times the
    column.
    """

    signal: str
    is_input: bool
    number: int
    column: str
    powers: tuple[Polynomial, ...] | None
    products: bool = False


def followers(model: LinearSystem, name: str) -> tuple[Follower, ...]:
    """Return the signals that an error of an input moves: itself, and all that are computed from its column.

    Example:
        >>> model = LinearSystem([[0.5]], [[1, 2]], [[1]], inputs=["cool", "cool2"], noise=1,
        ...     columns={"cool": "valve", "cool2": "= valve**2"})
        >>> [(f.signal, f.powers) for f in followers(model, "cool")][1]
        ('cool2', ({('valve',): Fraction(2, 1)}, {(): Fraction(1, 1)}))
    """
    own, column = model.inputs.index(name), model.column(name).strip()
    if is_expression(column):
        return (Follower(name, True, own, "", (ONE,)),)
    moved = []
    for is_input, signals in ((True, model.inputs), (False, model.outputs)):
        for number, signal in enumerate(signals):
            text = model.column(signal).strip()
            if text == column:
                moved.append(Follower(signal, is_input, number, column, (ONE,)))
            elif is_expression(text) and column in expression(text).columns:
                powers = _powers(text, column)
                products = powers is not None and _is_product(text, column)
                moved.append(Follower(signal, is_input, number, column, powers, products))
    return tuple(moved)


@lru_cache(256)
def _powers(text: str, column: str) -> tuple[Polynomial, ...] | None:
    """Return (e_1, e_2, ..) of an expression; None where it is no polynomial."""
    whole = _expanded(text)
    if whole is None:
        return None
    highest = max(columns.count(column) for columns in whole)
    powers: list[dict[tuple[str, ...], Fraction]] = [{} for _ in range(highest)]
    for columns, coefficient in whole.items():
        others, degree = tuple(c for c in columns if c != column), columns.count(column)
        for i in range(1, degree + 1):
            # the binomial theorem: c^n moved by f has comb(n, i) c^(n - i) f^i
            key = tuple(sorted((*others, *[column] * (degree - i))))
            powers[i - 1][key] = powers[i - 1].get(key, Fraction(0)) + comb(degree, i) * coefficient
    return tuple(powers)


def _is_product(text: str, column: str) -> bool:
    """Return whether an expression is its column times something that does not hold it."""
    whole = _expanded(text)
    return whole is not None and all(columns.count(column) == 1 for columns in whole)


@lru_cache(256)
def _expanded(text: str) -> Polynomial | None:
    """Return an expression multiplied out; None where it is more than sums, products and whole powers."""
    read = expression(text)
    try:
        return _multiplied_out(read.tree, read.names)
    except (RecursionError, NotImplementedError):
        return None


def _multiplied_out(node: ast.expr, names: Mapping[str, str]) -> Polynomial:
    """Return the polynomial of a node; names: {name in the tree: column}."""
    match node:
        case ast.Constant(value=int(value) | float(value)):
            # the decimal as it is written, not the float beside it
            return {(): Fraction(str(value))}
        case ast.Name():
            return {(names[node.id],): Fraction(1)}
        case ast.UnaryOp(op=ast.UAdd()):
            return _multiplied_out(node.operand, names)
        case ast.UnaryOp(op=ast.USub()):
            return _times(_multiplied_out(node.operand, names), {(): Fraction(-1)})
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int(power))) if 1 <= power <= LARGEST:
            base = _multiplied_out(node.left, names)
            result = base
            for _ in range(power - 1):
                result = _times(result, base)
            return result
        case ast.BinOp():
            return _joined(node.op, _multiplied_out(node.left, names), _multiplied_out(node.right, names))
    raise NotImplementedError


def _joined(op: ast.operator, a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a op b."""
    if isinstance(op, ast.Mult):
        return _times(a, b)
    if isinstance(op, ast.Div) and set(b) == {()} and b[()]:
        return _times(a, {(): 1 / b[()]})
    if isinstance(op, ast.Sub):
        b = _times(b, {(): Fraction(-1)})
    elif not isinstance(op, ast.Add):
        raise NotImplementedError
    total = dict(a)
    for columns, coefficient in b.items():
        total[columns] = total.get(columns, Fraction(0)) + coefficient
    return total


def _times(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a times b."""
    product: dict[tuple[str, ...], Fraction] = {}
    for one, x in a.items():
        for two, y in b.items():
            columns = tuple(sorted((*one, *two)))
            product[columns] = product.get(columns, Fraction(0)) + x * y
    return product
