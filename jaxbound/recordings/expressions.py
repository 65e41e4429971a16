"""Signals and conditions that are computed from the columns of a recording: `= Tsup - Tmix`, `fan > 0 and
occupied == 1`.

The notation is that of pandas.DataFrame.eval, arithmetic and comparisons only; a name with blanks or signs in
it stands in backticks. It is parsed here and computed in NumPy, so that a model file cannot run anything
else.
"""

import ast
import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from jaxbound.text.names import listed, quoted

__all__ = [
    "TIMES",
    "Expression",
    "expression",
    "fails",
    "find_column",
    "is_expression",
    "likely",
    "missing_column",
]

TIMES = (
    r"(date[ _-]?time|time[ _-]?stamp|time|zeit(stempel|punkt)?|horodatage|heure|fecha y "
    r"hora|hora|tiempo|tijd|tijdstip|tid|czas)\b.*",
    r"t(\s*[\[(/,].*)?",
    r"(date|datum|fecha|data)\b.*",
)
"""What a column of times is called, the likeliest first; in a language that is not here, dates are known by
what they are.
"""

FUNCTIONS = {
    name: getattr(np, name)
    for name in (
        "abs",
        "sqrt",
        "exp",
        "expm1",
        "log",
        "log1p",
        "log10",
        "sin",
        "cos",
        "tan",
        "arcsin",
        "arccos",
        "arctan",
        "arctan2",
        "sinh",
        "cosh",
        "tanh",
        "arcsinh",
        "arccosh",
        "arctanh",
        "floor",
        "ceil",
    )
}
ARITHMETIC = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.FloorDiv: np.floor_divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
}
LOGIC = {ast.And: np.logical_and, ast.Or: np.logical_or}
COMPARISONS = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
ALLOWED = (
    ast.Expression,
    ast.BinOp,
    ast.UnaryOp,
    ast.BoolOp,
    ast.Compare,
    ast.Call,
    ast.Name,
    ast.Load,
    ast.Constant,
    ast.Not,
    *ARITHMETIC,
    *LOGIC,
    *COMPARISONS,
)
LARGEST = int(np.finfo(float).max)
PIECES = re.compile(r"""'[^']*'|"[^"]*"|`[^`]*`|&|\|""")


@dataclass(frozen=True, eq=False)
class Expression:
    """A number, or yes and no, for each sample. Build it with `expression`.

    Fields: text: as written, without the leading "="; columns: names of the columns that it needs; texts:
    those of them that are compared with text; names: the columns by the names that stand for them in the
    tree.
    """

    text: str
    columns: tuple
    texts: frozenset
    names: dict
    tree: ast.expr

    def among(self, present: Iterable[str]) -> "Expression":
        """Return the same Expression with the columns as they are called in a recording, where blanks at the
        ends do not count.

        Raises:
            ValueError: a column is not there.
        """
        found = {c: find_column(c, present, f"the recording, for {self.text!r},") for c in self.columns}
        return Expression(
            self.text,
            tuple(dict.fromkeys(found.values())),
            frozenset(found[c] for c in self.texts),
            {key: found[c] for key, c in self.names.items()},
            self.tree,
        )

    def values(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return (N,) floats, NaN where a column that is needed has no value or where the result is no finite
        number; yes is 1, no 0.

        Args:
            columns: {name: (N,) floats, datetime64, or texts as objects, None where there is none}.

        Raises:
            ValueError: a time or a text where a number is needed, a text that is no date beside a time.
        """
        for name in self.columns:
            if (columns[name].dtype.kind in "MO") != (name in self.texts):
                kind = {
                    "M": "is a time: compare it with a date in quotes",
                    "O": "holds text: compare it with text in quotes",
                }.get(columns[name].dtype.kind, "holds numbers: compare it with a number")
                raise ValueError(f"{self.text!r}: column {name!r} {kind}")
        with np.errstate(all="ignore"):
            try:
                out = self._value(columns)
            except TypeError:
                raise ValueError(f"{self.text!r}: a time or a text stands where a number is needed") from None
            out = np.where(out, 1.0, 0.0) if np.asarray(out).dtype == bool else np.asarray(out, np.float64)
        known = np.isfinite(out)
        for name in self.columns:
            x = columns[name]
            known = known & ~_is_missing(x)
        return np.where(known, out, np.nan)

    def _value(self, columns):
        """Return the value of the tree, without recursion: a sum of thousands of terms is as many levels
        deep.
        """
        found: dict[int, Any] = {}
        waiting = [self.tree]
        while waiting:
            node = waiting[-1]
            parts = _parts(node)
            missing = [x for x in parts if id(x) not in found]
            if missing:
                waiting += missing
                continue
            found[id(node)] = self._combined(node, [found.pop(id(x)) for x in parts], columns)
            waiting.pop()
        return found[id(self.tree)]

    def _combined(self, node: Any, parts, columns):
        """Return the value of a node from those of its parts."""
        if isinstance(node, ast.Constant):
            value: Any = node.value
            return value if isinstance(value, str) else np.float64(value)
        if isinstance(node, ast.Name):
            return columns[self.names[node.id]]
        if isinstance(node, ast.Call):
            return FUNCTIONS[ast.unparse(node.func)](*parts)
        if isinstance(node, ast.BoolOp):
            return reduce(LOGIC[type(node.op)], parts)
        if isinstance(node, ast.Compare):
            return reduce(
                np.logical_and,
                (self._compared(op, a, b) for op, a, b in zip(node.ops, parts, parts[1:], strict=False)),
            )
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return np.logical_not(*parts)
        return ARITHMETIC[type(node.op)](*(x.astype(float) if x.dtype == bool else x for x in parts))

    def _compared(self, op, a, b):
        texts, kinds = (
            [x for x in (a, b) if isinstance(x, str)],
            {x.dtype.kind for x in (a, b) if not isinstance(x, str)},
        )
        if texts and "O" in kinds and not isinstance(op, (ast.Eq, ast.NotEq)):
            raise ValueError(f"{self.text!r}: text has no order, compare {texts[0]!r} with == or != only")
        if texts and "M" in kinds:
            try:
                a, b = (np.datetime64(x) if isinstance(x, str) else x for x in (a, b))
            except ValueError:
                raise ValueError(
                    f"{self.text!r}: {texts[0]!r} is no date: write it like '2017-09-20' or '2017-09-20 "
                    f"08:00'"
                ) from None
        return COMPARISONS[type(op)](a, b)


def _parts(node):
    """Return the operands of a node."""
    match node:
        case ast.Call():
            return node.args
        case ast.BoolOp():
            return node.values
        case ast.Compare():
            return [node.left, *node.comparators]
        case ast.UnaryOp():
            return [node.operand]
        case ast.BinOp():
            return [node.left, node.right]
    return []


def fails(values: np.ndarray) -> np.ndarray:
    """Return (N,) bool: where a condition with these values does not hold, or has none."""
    return ~(np.nan_to_num(values) != 0)


def is_expression(column: str) -> bool:
    """Return whether the column of a signal is an expression: whether it begins with "="."""
    return column.lstrip().startswith("=")


def expression(text: str) -> Expression:
    """Read an expression over the columns of a recording.

    Args:
        text: columns, numbers, + - * / // % **, comparisons (chained ones too), and, or, not, & and | for and
            and or, abs, sqrt, exp, log, sin, ... A leading "=" does not count. Text columns and times may be
            compared with text in quotes.

    Returns:
        An Expression.

    Raises:
        ValueError: anything else, or no column at all.

    Example:
        >>> e = expression("= `Supply Temp` - mixed")
        >>> e.columns, e.values({"Supply Temp": np.array([72.5, np.nan]), "mixed": np.array([70.0, 70.0])})
        (('Supply Temp', 'mixed'), array([2.5, nan]))
    """
    text = text.strip().removeprefix("=").strip()
    ticked: dict[str, str] = {}

    def plain(piece):
        word = piece[0]
        if word[0] == "`":
            return f" {ticked.setdefault(word[1:-1].strip(), f'_{len(ticked)}_in_backticks')} "
        return {"&": " and ", "|": " or "}.get(word, word)

    code = PIECES.sub(plain, text)
    try:
        tree = ast.parse(code.strip(), mode="eval").body
    except (RecursionError, MemoryError):
        raise ValueError(
            f"the expression {quoted(text)} cannot be read, too long or too deep: compute it beforehand, "
            f"as a column"
        ) from None
    except (SyntaxError, ValueError) as e:
        if "too many nested" in str(e):
            raise ValueError(
                f"the expression {quoted(text)} cannot be read, nested too deeply: compute it beforehand, as "
                f"a column"
            ) from None
        wrong = (
            "one = is no comparison, write =="
            if re.search(r"(?<![<>=!])=(?!=)", code)
            else ("names with blanks, colons or other signs stand in backticks, like `Supply Temp`")
        )
        raise ValueError(f"the expression {quoted(text)} cannot be read: {wrong}") from None
    called, texts = _checked(text, tree)
    names = {
        node.id: node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called
    }
    names |= {key: name for name, key in ticked.items()}
    if not names:
        raise ValueError(f"the expression {text!r} names no column")
    return Expression(
        text, tuple(dict.fromkeys(names.values())), frozenset(names[x] for x in texts), names, tree
    )


def _checked(text, tree):
    """Return (ids of the nodes that name a function, names that are compared with text); refuse what an
    expression may not hold.
    """
    called, texts, strings = set(), set(), set()
    for node in ast.walk(tree):
        if not isinstance(node, ALLOWED):
            _refuse(
                text,
                {ast.Attribute: "an attribute", ast.MatMult: "@"}.get(
                    type(node), f"what Python calls {type(node).__name__}"
                ),
            )
        if isinstance(node, ast.Call):
            if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS or node.keywords:
                _refuse(text, f"the function {ast.unparse(node.func)}")
            name: Any = node.func
            if len(node.args) != (2 if name.id == "arctan2" else 1):
                raise ValueError(f"the expression {text!r} gives {name.id} {len(node.args)} numbers")
            called.add(id(node.func))
        if isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
            for a, b in zip(sides, sides[1:], strict=False):
                for one, other in ((a, b), (b, a)):
                    if (
                        isinstance(one, ast.Constant)
                        and isinstance(one.value, str)
                        and isinstance(other, ast.Name)
                    ):
                        texts.add(other.id)
                        strings.add(id(one))
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and id(node) not in strings
            and not isinstance(node.value, (int, float))
        ):
            if isinstance(node.value, str):
                raise ValueError(
                    f"the expression {text!r} holds the text {node.value!r}: text can only be compared with "
                    f"a column"
                )
            _refuse(text, f"{node.value!r}")
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, (int, float))
            and not abs(node.value) <= LARGEST
        ):
            raise ValueError(f"the expression {quoted(text)} holds a number beyond the range of floats")
    return called, texts


def _refuse(text, what):
    raise ValueError(
        f"the expression {text!r} holds {what}: there are columns, numbers, + - * / // % **, comparisons, "
        f"and, or, not, and "
        f"the functions {', '.join(FUNCTIONS)}"
    )


def find_column(wanted: str, present: Iterable[str], where: str) -> str:
    """Return a column as it is called among those present: by its name, or by it without blanks at the ends.

    Raises:
        ValueError: it is not there, or there twice.
    """
    found = [c for c in present if c == wanted] or [c for c in present if str(c).strip() == wanted.strip()]
    if not found:
        raise ValueError(missing_column(wanted, present, where))
    if len(found) > 1:
        raise ValueError(f"{len(found)} columns are called {quoted(wanted)}: a signal needs exactly one")
    return found[0]


def missing_column(wanted: str, present: Iterable[str], where: str, kind: str = "column") -> str:
    """Return the sentence for a column, or what else of a kind, that is not there, with the nearest name."""
    near = difflib.get_close_matches(
        wanted, [str(c) for c in present if len(str(c)) < 200][:10_000], n=1, cutoff=0.5
    )
    here = listed(list(map(str, present)))
    if near:
        return f"{where} has no {kind} {quoted(wanted)}; did you mean {quoted(near[0])}? It has {here}."
    return f"{where} has no {kind} {quoted(wanted)}: it has {here}"


def likely(names: Iterable[str], patterns: Iterable[str]) -> list[str]:
    """Return those of the names that follow one of the patterns, in the order of the patterns."""
    return [
        name for pattern in patterns for name in names if re.fullmatch(pattern, str(name).lower().strip())
    ]


def _is_missing(column):
    """Return which cells of a column hold nothing: None, NaT or NaN."""
    if column.dtype == object:
        return column == None  # noqa: E711 (cell by cell)
    if column.dtype.kind == "M":
        return np.isnat(column)
    return np.isnan(column)
