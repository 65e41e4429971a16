"""Signals and conditions that are computed from the columns of a recording: `= Tsup - Tmix`, `fan > 0 and
occupied == 1`.

The notation is that of pandas.DataFrame.eval, arithmetic and comparisons only; a name with blanks or signs in
it stands in backticks. It is parsed here and computed in NumPy, so that a model file cannot run anything
else.
"""

import ast
import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NoReturn

import numpy as np

from jaxbound.text.names import listed, quoted
from jaxbound.text.units import UNITS_OF_TIME, same_unit, without_unit

TIMES = (
    r"(date[ _-]?time|time[ _-]?stamp|time|zeit(stempel|punkt)?|horodatage|heure|fecha y "
    r"hora|hora|tiempo|tijd|tijdstip|tid|czas)\b.*",
    r"t(\s*[\[(/,].*)?",
    rf"(time|time[ _-]?stamp|zeit)_({UNITS_OF_TIME})|t_([mun]s|sec)|hh:?mm(:?ss)?",  # T_min is a temperature
    r"(date|datum|fecha|data)\b.*",
)
"""What a column of times is called, the likeliest first; in a language that is not here, dates are known by
what they are.
"""

TIME_OF_DAY, TIME_SINCE_START, PI = "time_of_day", "time_since_start", "pi"
CLOCK = TIME_OF_DAY, TIME_SINCE_START, PI
"""Names that an expression may use beside columns, unless a column is called so: seconds since midnight of
the recording's own clock, seconds since the first sample of the recording, and a number.
"""
STEP = "= seconds since the sample before"
"""A name that a rate needs, which no column has: NaN where the sample before does not count."""
ANGLE, RATE = "angle", "rate"
PERIODIC = SIN, COS = "sin", "cos"
WRAPS = 0.1
"""Share of its range up to which a counter that falls has run over: beyond, it may have begun anew."""
QUARTER = np.pi / 2  # of a turn: an angle that moves on by more may have gone the other way
FULL_TURN = "2 * pi"
LATE = 1.2
"""Usual steps from which on the sample before is too long ago for a rate."""

Operation = Callable[..., np.ndarray]
Value = np.ndarray | np.generic | str
"""What a node of an expression stands for: cells of a column, a number, a text in quotes."""

NAMES_OF_FUNCTIONS = """
    abs sqrt exp expm1 log log1p log10 sin cos tan arcsin arccos arctan arctan2 sinh cosh tanh arcsinh arccosh
    arctanh floor ceil minimum maximum
""".split()
OF_TWO = ("arctan2", "minimum", "maximum")
"""Functions of two numbers; the others take one, an angle and a rate one or two."""


def angle(x: np.ndarray, turn: float = 360.0) -> np.ndarray:
    """Return an angle in radians. turn: the number that is once around."""
    return x * (2 * np.pi / turn)


def rate(step: np.ndarray, x: np.ndarray, over: float | None = None) -> np.ndarray:
    """Return by how much a counter grows in a second, (N,); NaN at the first sample and where it falls.

    Args:
        step: (N,) seconds since the sample before. x: (N,) its counts. over: the count at which it begins at
            0 again, like 65536: a fall by which it then grew less than a tenth of that is none.
    """
    grown = np.diff(x, prepend=np.nan)
    if over is not None:
        again = grown + over
        grown = np.where((grown < 0) & (again <= WRAPS * over), again, grown)
    grows: np.ndarray = np.where(grown < 0, np.nan, grown) / step
    return grows


def turning(step: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return by how much an angle grows in a second, (N,) radians, the shorter way around: by 2 degrees from
    359 to 1. NaN at the first sample and where it is more than a quarter of a turn.

    Args:
        step: (N,) seconds since the sample before. x: (N,) radians.
    """
    turned = np.diff(x, prepend=np.nan)
    turned = turned - 2 * np.pi * np.rint(turned / (2 * np.pi))
    turns: np.ndarray = np.where(abs(turned) > QUARTER, np.nan, turned) / step
    return turns


FUNCTIONS: dict[str, Operation] = {name: getattr(np, name) for name in NAMES_OF_FUNCTIONS}
FUNCTIONS |= {ANGLE: angle, RATE: rate}
ARITHMETIC: dict[type[ast.operator | ast.unaryop], Operation] = {
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
LOGIC: dict[type[ast.boolop], Operation] = {ast.And: np.logical_and, ast.Or: np.logical_or}
COMPARISONS: dict[type[ast.cmpop], Operation] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
NODES = (ast.Expression, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.Call, ast.Name, ast.Load)
ALLOWED = (*NODES, ast.Constant, ast.Not, *ARITHMETIC, *LOGIC, *COMPARISONS)
LARGEST = int(np.finfo(float).max)
PIECES = re.compile(r"""'[^']*'|"[^"]*"|`[^`]*`|&|\|""")
WORDS = {"&": " and ", "|": " or "}
KINDS = {
    "M": "is a time: compare it with a date in quotes",
    "O": "holds text: compare it with text in quotes",
}
"""What is said of a column of this kind of dtype that is used as a number."""
NEAR = 200, 10_000
"""Characters of a name, and names, among which the nearest one is looked for."""


@dataclass(frozen=True, eq=False)
class Expression:
    """A number, or yes and no, for each sample. Build it with `expression`.

    Fields: text: as written, without the leading "="; columns: names of the columns that it needs; texts:
    those of them that are compared with text; names: the columns by the names that stand for them in the
    tree; clock: those of the columns that are no columns of the recording but told by its clock, see `CLOCK`.
    """

    text: str
    columns: tuple[str, ...]
    texts: frozenset[str]
    names: Mapping[str, str]
    tree: ast.expr
    clock: frozenset[str] = frozenset()

    @property
    def read(self) -> tuple[str, ...]:
        """Names of the columns that are read of a recording."""
        return tuple(c for c in self.columns if c not in self.clock)

    @property
    def looks_back(self) -> bool:
        """Whether the value of a sample needs the sample before it."""
        return STEP in self.columns

    def among(self, present: Iterable[str]) -> "Expression":
        """Return the same Expression with the columns as they are called in a recording, where blanks at the
        ends do not count.

        Raises:
            ValueError: a column is not there.
        """
        where = f"the recording, for {self.text!r},"
        present = list(present)
        there = {str(c).strip() for c in present}
        clock = frozenset(c for c in self.columns if c in (*CLOCK, STEP) and c not in there)
        called = {c: c if c in clock else find_column(c, present, where) for c in self.columns}
        return Expression(
            self.text,
            tuple(dict.fromkeys(called.values())),
            frozenset(called[c] for c in self.texts),
            {key: called[c] for key, c in self.names.items()},
            self.tree,
            clock,
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
            self._check_kind(name, columns[name].dtype.kind)
        with np.errstate(all="ignore"):
            try:
                out = np.asarray(self._value(columns))
            except TypeError:
                raise ValueError(f"{self.text!r}: a time or a text stands where a number is needed") from None
            out = out.astype(np.float64)
        known = np.isfinite(out)
        for name in self.columns:
            known = known & ~_is_missing(columns[name])
        return np.where(known, out, np.nan)

    def _check_kind(self, name: str, kind: str) -> None:
        """Raise ValueError if a column of numbers is compared with text, or one of another kind is not."""
        is_number = kind not in "MO"
        if is_number == (name in self.texts):
            wrong = KINDS.get(kind, "holds numbers: compare it with a number")
            raise ValueError(f"{self.text!r}: column {name!r} {wrong}")

    def _value(self, columns: Mapping[str, np.ndarray]) -> Value:
        """Return the value of the tree.

        Without recursion: a sum of thousands of terms is as many levels deep.
        """
        nodes = [self.tree]
        for node in nodes:
            nodes += _operands(node)
        values: dict[int, Value] = {}
        for node in reversed(nodes):  # operands first
            parts = [values.pop(id(x)) for x in _operands(node)]
            values[id(node)] = self._combined(node, parts, columns)
        return values[id(self.tree)]

    def _combined(self, node: ast.expr, parts: Sequence[Value], columns: Mapping[str, np.ndarray]) -> Value:
        """Return the value of a node from those of its operands."""
        match node:
            case ast.Constant(value=str(text)):
                return text
            case ast.Constant(value=int(number) | float(number)):
                return np.float64(number)
            case ast.Name():
                column = columns[self.names[node.id]]
                if column.dtype.kind == "f":
                    return column.astype(np.float64, copy=False)
                return column
            case ast.Call():
                called = _calls(node)
                operation = FUNCTIONS[called]
                if called == RATE:
                    parts = [columns[STEP], *parts]
                if called == RATE and _calls(node.args[0]) == ANGLE:
                    operation = turning
                return operation(*parts)
            case ast.BoolOp():
                return reduce(LOGIC[type(node.op)], parts)
            case ast.Compare():
                pairs = zip(node.ops, parts[:-1], parts[1:], strict=True)
                return reduce(np.logical_and, [self._compared(op, a, b) for op, a, b in pairs])
            case ast.UnaryOp(op=ast.Not()):
                return np.asarray(np.logical_not(np.asarray(parts[0])))
            case ast.UnaryOp() | ast.BinOp():
                return ARITHMETIC[type(node.op)](*map(_as_number, parts))
        raise AssertionError(f"{node} was let through")

    def _compared(self, op: ast.cmpop, a: Value, b: Value) -> np.ndarray:
        """Return a op b; beside a time a text in quotes is a date."""
        texts = [x for x in (a, b) if isinstance(x, str)]
        kinds = [x.dtype.kind for x in (a, b) if not isinstance(x, str)]
        if texts and "O" in kinds and not isinstance(op, ast.Eq | ast.NotEq):
            raise ValueError(f"{self.text!r}: text has no order, compare {texts[0]!r} with == or != only")
        if texts and "M" in kinds:
            try:
                a, b = _as_date(a), _as_date(b)
            except ValueError:
                raise ValueError(
                    f"{self.text!r}: {texts[0]!r} is no date: write it like '2017-09-20' or '2017-09-20 "
                    f"08:00'"
                ) from None
        return COMPARISONS[type(op)](a, b)


def derived(
    names: Iterable[str],
    count: int,
    since: np.ndarray | None,
    stamps: np.ndarray | None,
    dt: float | None = None,
) -> dict[str, np.ndarray]:
    """Return {name: (N,) floats} of names of `CLOCK`, and `STEP`.

    Args:
        names: those that are needed. count: N. since: (N,) s since the first sample of the recording, or None
            where nothing tells it. stamps: (N,) datetime64, or None. dt: sampling period in s, None: not
            known.

    Raises:
        ValueError: no dates for a time of day, no times at all.
    """
    values: dict[str, np.ndarray] = {}
    for name in names:
        if name == PI:
            values[name] = np.full(count, np.pi)
        elif name == TIME_OF_DAY:
            if stamps is None:
                raise ValueError(
                    f"{name} needs dates: the recording's times have none, or there are no times"
                )
            values[name] = (stamps - stamps.astype("datetime64[D]")) / np.timedelta64(1, "s")
        elif since is None:
            what = {STEP: RATE}.get(name, name)
            raise ValueError(f"{what} needs the times of the samples: give a column of them")
        elif name == STEP:
            values[name] = _steps(np.asarray(since, float), dt)
        else:
            values[name] = np.asarray(since, float)
    return values


def _steps(since: np.ndarray, dt: float | None) -> np.ndarray:
    """Return (N,) seconds since the sample before, NaN behind a gap and where the clock does not go on.

    Without dt no step is a gap: of means, see `means.grid_of`, none behind a hole counts.
    """
    steps = np.diff(since, prepend=np.nan)
    return np.where((steps > 0) & (steps <= LATE * (dt or np.inf)), steps, np.nan)


def _as_number(x: Value) -> Value:
    """Return yes and no as 1 and 0, and a number as it is."""
    if not isinstance(x, str) and x.dtype == bool:
        return x.astype(float)
    return x


def _as_date(x: Value) -> Value:
    if isinstance(x, str):
        return np.datetime64(x)
    return x


def _operands(node: ast.expr) -> Sequence[ast.expr]:
    """Return the operands of a node."""
    if isinstance(node, ast.Call):
        return node.args
    return [x for x in ast.iter_child_nodes(node) if isinstance(x, ast.expr)]


def fails(values: np.ndarray) -> np.ndarray:
    """Return (N,) bool: where a condition with these values does not hold, or has none."""
    return np.asarray(np.nan_to_num(values) == 0)


def is_expression(column: str) -> bool:
    """Return whether the column of a signal is an expression: whether it begins with "="."""
    return column.lstrip().startswith("=")


def expression(text: str) -> Expression:
    """Read an expression over the columns of a recording.

    Args:
        text: columns, numbers, + - * / // % **, comparisons (chained ones too), and, or, not, & and | for and
            and or, abs, sqrt, minimum, maximum, exp, log, sin, ... A leading "=" does not count. Text columns
            and times may be compared with text in quotes. Names of `CLOCK` need no column.

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
    ticked: dict[str, str] = {}  # column: the name that stands for it in the tree

    def as_python(piece: re.Match[str]) -> str:
        word = piece[0]
        if word[0] == "`":
            return f" {ticked.setdefault(word[1:-1].strip(), f'_{len(ticked)}_in_backticks')} "
        return WORDS.get(word, word)

    tree = _parsed(text, PIECES.sub(as_python, text).strip())
    for node in ast.walk(tree):  # a number, whatever columns are called
        if isinstance(node, ast.Call) and _calls(node) == ANGLE:
            if list(map(ast.unparse, node.args[1:])) == [FULL_TURN]:
                node.args[1] = ast.Constant(2 * np.pi)
    nodes = list(ast.walk(tree))
    _check_nodes(text, nodes)
    texts, strings = _compared_with_text(nodes)
    _check_constants(text, nodes, strings)
    functions = {id(node.func): ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    names = {node.id: node.id for node in nodes if isinstance(node, ast.Name) and id(node) not in functions}
    names |= {key: column for column, key in ticked.items()}
    if not names:
        raise ValueError(f"the expression {text!r} names no column")
    columns = tuple(dict.fromkeys(names.values()))
    if RATE in functions.values():
        columns = (*columns, STEP)
    return Expression(text, columns, frozenset(names[x] for x in texts), names, tree)


def with_angles(names: Iterable[str], columns: Mapping[str, str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return (names, columns) in which two signals stand for one that is an angle: its sine and its cosine.

    Args:
        names: of signals. columns: {signal: column or "= expression"}.

    Example:
        >>> with_angles(["wind", "T"], {"wind": "= angle(WD)"})
        (('wind sin', 'wind cos', 'T'), {'wind sin': '= sin(angle(WD))', 'wind cos': '= cos(angle(WD))'})
    """
    every: list[str] = []
    called = dict(columns)
    for name in names:
        text = columns.get(name, "").strip().removeprefix("=").strip()
        if not text.startswith(ANGLE) or not is_expression(columns[name]) or not _is_angle(text):
            every.append(name)
            continue
        del called[name]
        for part in PERIODIC:
            every.append(f"{name} {part}")
            called[f"{name} {part}"] = f"= {part}({text})"
    return tuple(every), called


def _is_angle(text: str) -> bool:
    """Return whether an expression is an angle and nothing else."""
    whole = expression(f"{SIN}({text})").tree
    assert isinstance(whole, ast.Call)
    return _calls(whole.args[0]) == ANGLE


def _calls(node: ast.AST) -> str:
    """Return the name of the function that a node calls, "" where it calls none."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id
    return ""


def _parsed(text: str, code: str) -> ast.expr:
    """Return the tree of Python's code for a text."""
    wrong = ""
    try:
        return ast.parse(code, mode="eval").body
    except (RecursionError, MemoryError):
        wrong = ", too long or too deep: compute it beforehand, as a column"
    except (SyntaxError, ValueError) as e:
        if "too many nested" in str(e):
            wrong = ", nested too deeply: compute it beforehand, as a column"
        elif re.search(r"(?<![<>=!])=(?!=)", code):
            wrong = ": one = is no comparison, write =="
        else:
            wrong = ": names with blanks, colons or other signs stand in backticks, like `Supply Temp`"
    raise ValueError(f"the expression {quoted(text)} cannot be read{wrong}")


def _check_nodes(text: str, nodes: Iterable[ast.AST]) -> None:
    """Raise ValueError if an expression holds more than columns, numbers, operations and known functions."""
    for node in nodes:
        if isinstance(node, ast.Attribute):
            _refuse_part(text, "an attribute")
        if isinstance(node, ast.MatMult):
            _refuse_part(text, "@")
        if not isinstance(node, ALLOWED):
            _refuse_part(text, f"what Python calls {type(node).__name__}")
        if not isinstance(node, ast.Call):
            continue
        if not isinstance(node.func, ast.Name) or node.func.id not in FUNCTIONS or node.keywords:
            _refuse_part(text, f"the function {ast.unparse(node.func)}")
        name, count = node.func.id, len(node.args)
        if name in (ANGLE, RATE):
            _check_second(text, node, name)
        elif count != 1 + (name in OF_TWO):
            raise ValueError(f"the expression {text!r} gives {name} {count} numbers")
    _refuse_bare_angle(text, nodes)


def _check_second(text: str, node: ast.Call, name: str) -> None:
    """Raise ValueError if an angle or a rate is of no column, or if the number behind it is none above 0."""
    first, *others = node.args or [node.func]
    if not node.args or not any(isinstance(part, ast.Name) for part in ast.walk(first)):
        raise ValueError(f"the expression {text!r} gives {name} no column")
    if others and name == RATE and _calls(first) == ANGLE:
        raise ValueError(f"the expression {text!r}: the angle says what is once around: rate takes it alone")
    for other in others:
        number = getattr(other, "value", None)
        if len(others) > 1 or not isinstance(number, int | float) or not number > 0:
            like = {ANGLE: "400 of gon or 2*pi", RATE: "65536"}[name]
            raise ValueError(
                f"the expression {text!r}: behind the column {name} takes one number above 0, like {like}"
            )


def _refuse_bare_angle(text: str, nodes: Iterable[ast.AST]) -> None:
    """Raise ValueError if an angle is a number of its own: it jumps where nothing does."""
    inside: set[int] = set()
    angles: list[ast.Call] = []
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        if _calls(node) in PERIODIC:
            inside.update(map(id, ast.walk(node)))
        if _calls(node) == RATE:
            inside.add(id(node.args[0]))
        if _calls(node) == ANGLE:
            angles.append(node)
    if any(id(node) not in inside for node in angles):
        raise ValueError(
            f"the expression {text!r}: an angle jumps where it is once around, so it is no signal by itself: "
            f"take sin(angle(..)) and cos(angle(..)), or a signal that is angle(..) and nothing else; "
            f"rate(angle(..)) is how fast it turns"
        )


def _compared_with_text(nodes: Iterable[ast.AST]) -> tuple[set[str], set[int]]:
    """Return (names that are compared with text, ids of the nodes of these texts)."""
    names, strings = set(), set()
    for node in nodes:
        if not isinstance(node, ast.Compare):
            continue
        sides = [node.left, *node.comparators]
        pairs = list(zip(sides[:-1], sides[1:], strict=True))
        for one, other in pairs + [(b, a) for a, b in pairs]:
            is_text = isinstance(one, ast.Constant) and isinstance(one.value, str)
            if is_text and isinstance(other, ast.Name):
                names.add(other.id)
                strings.add(id(one))
    return names, strings


def _check_constants(text: str, nodes: Iterable[ast.AST], strings: set[int]) -> None:
    """Raise ValueError if a constant is neither a number within floats nor one of the texts `strings`."""
    for node in nodes:
        if not isinstance(node, ast.Constant):
            continue
        value = node.value
        if isinstance(value, int | float):
            if not abs(value) <= LARGEST:
                raise ValueError(f"the expression {quoted(text)} holds a number beyond the range of floats")
        elif id(node) in strings:
            continue
        elif isinstance(value, str):
            raise ValueError(
                f"the expression {text!r} holds the text {value!r}: text can only be compared with a column"
            )
        else:
            _refuse_part(text, f"{value!r}")


def _refuse_part(text: str, what: str) -> NoReturn:
    raise ValueError(
        f"the expression {text!r} holds {what}: there are columns, numbers, + - * / // % **, comparisons, "
        f"and, or, not, and the functions {', '.join(FUNCTIONS)}; names with brackets, points or other signs "
        f"stand in backticks, like `Supply Temp`"
    )


def find_column(wanted: str, present: Iterable[str], where: str, used: Iterable[str] = ()) -> str:
    """Return a column as it is called among those present: by its name, or by it without blanks at the ends.

    Args:
        used: columns that have a use, as of another signal: none of them is proposed in place of one that is
            not there.

    Raises:
        ValueError: it is not there, or there twice.
    """
    called = [c for c in present if c == wanted]
    if not called:
        called = [c for c in present if str(c).strip() == wanted.strip()]
    if not called:
        raise ValueError(missing_column(wanted, present, where, used=used))
    if len(called) > 1:
        raise ValueError(f"{len(called)} columns are called {quoted(wanted)}: a signal needs exactly one")
    return called[0]


def missing_column(
    wanted: str, present: Iterable[str], where: str, kind: str = "column", used: Iterable[str] = ()
) -> str:
    """Return the sentence for a column, or what else of a kind, that is not there, with the nearest name of
    those that have no use yet.
    """
    names = list(map(str, present))
    longest, most = NEAR
    taken = {str(name).strip() for name in used}
    free = [name for name in names if name.strip() not in taken]
    other = _in_another_unit(wanted, free)
    if other:
        return f"{where} has {kind} {other} in the place of {quoted(wanted)}"
    near = difflib.get_close_matches(wanted, [c for c in free if len(c) < longest][:most], n=1, cutoff=0.5)
    here = listed(names)
    if near:
        stands = ""
        if re.search("[,=]", near[0]):
            stands = " In the shell a name with a comma or an equal sign stands in backticks."
        return (
            f"{where} has no {kind} {quoted(wanted)}; did you mean {quoted(near[0])}?{stands} It has {here}."
        )
    return f"{where} has no {kind} {quoted(wanted)}: it has {here}"


def _in_another_unit(wanted: str, names: Iterable[str]) -> str:
    """Return the end of a sentence on a column of the same name but for its unit, "" where there is none."""
    name, unit = without_unit(wanted)
    for there in names:
        called, stated = without_unit(there)
        if not stated or called.strip() != name.strip() or there == wanted:
            continue
        if unit and not same_unit(unit, stated):
            return f"{quoted(there)}, in another unit: convert it, as one signal has one unit,"
        return f"{quoted(there)}, with a unit in its name: give the name as it stands there,"
    return ""


def likely(names: Iterable[str], patterns: Iterable[str]) -> list[str]:
    """Return those of the names that follow one of the patterns, in the order of the patterns."""
    lower = {name: str(name).lower().strip() for name in names}
    return [name for pattern in patterns for name in lower if re.fullmatch(pattern, lower[name])]


def _is_missing(column: np.ndarray) -> np.ndarray:
    """Return (N,) bool: the cells of a column that hold nothing, None, NaT or NaN."""
    empty: np.ndarray
    if column.dtype == object:
        empty = column == None  # noqa: E711, cell by cell
    elif column.dtype.kind == "M":
        empty = np.isnat(column)
    else:
        empty = np.isnan(column)
    return empty
