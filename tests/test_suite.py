"""The tests themselves: each can fail. An assertion that only an `if` may reach is none where that is never
true.
"""

import ast
import re
import textwrap
from pathlib import Path

import pytest
from sources import BODIES, last_name, statements

HELPERS = ("assert", "check", "confirm", "fail", "raises", "warns")  # how calls begin that assert


def asserts(node):
    """Return whether a statement or an expression asserts, if only at times."""
    return any(isinstance(n, ast.Assert) or isinstance(n, ast.Call) and called(n) for n in ast.walk(node))


def called(call):
    return last_name(call.func).lstrip("_").startswith(HELPERS)


def leaves(statements):
    """Return whether the statements may go on to the next round of a loop, or out of it or of the test."""
    for s in statements:
        if isinstance(s, ast.Continue | ast.Break | ast.Return):
            return True
        if isinstance(s, ast.If) and (leaves(s.body) or leaves(s.orelse)):
            return True
    return False


def reached(statements):
    """Return whether one of the statements asserts, whichever way an `if` goes."""
    for i, s in enumerate(statements):
        if isinstance(s, ast.If):
            if reached(s.body) and reached(s.orelse):
                return True
            if leaves(s.body) and not reached(s.body) or leaves(s.orelse) and not reached(s.orelse):
                return False  # what follows is not reached where the test, or the round, ends here
            if leaves(s.body) or leaves(s.orelse):
                return reached(statements[i + 1 :])
        elif isinstance(s, ast.Try) and s.handlers and reached(s.orelse):
            if reached(s.body) or all(reached(handler.body) for handler in s.handlers):
                return True
        elif isinstance(s, ast.For | ast.While | ast.With | ast.Try):
            if isinstance(s, ast.With) and any(map(asserts, s.items)) or reached(s.body):
                return True
        elif not isinstance(s, ast.FunctionDef | ast.ClassDef) and asserts(s):
            return True
    return False


NEGATED = {
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
}


def negated(node):
    """Return the text of the opposite of a condition."""
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return ast.unparse(node.operand)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        opposite = NEGATED[type(node.ops[0])]()
        return ast.unparse(ast.Compare(node.left, [opposite], node.comparators))
    return ast.unparse(ast.UnaryOp(ast.Not(), node))


def holds_always(node, known=frozenset()):
    """Return whether an expression is true whatever happens, where the texts `known` are."""
    if ast.unparse(node) in known:
        return True
    if isinstance(node, ast.Constant | ast.JoinedStr):
        return bool(getattr(node, "value", True))
    if isinstance(node, ast.Tuple | ast.List | ast.Set | ast.Dict):
        return bool(ast.unparse(node).strip("()[]{}"))
    if isinstance(node, ast.Lambda | ast.GeneratorExp):
        return True
    if isinstance(node, ast.IfExp):
        return holds_always(node.body, known | {ast.unparse(node.test)}) or holds_always(
            node.orelse, known | {negated(node.test)}
        )  # one arm is enough: the test passes where that one is taken
    if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or):
        texts = {ast.unparse(value) for value in node.values}
        return any(holds_always(v, known) or negated(v) in texts for v in node.values)
    if isinstance(node, ast.BoolOp):
        return any(holds_always(v, known) for v in node.values)
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        return compares_nothing(node.left, node.ops[0], node.comparators[0])
    return False


def compares_nothing(left, operator, right):
    """Return whether a comparison holds for all values: a name with itself, a length with what is below 0."""
    if isinstance(left, ast.Name) and ast.unparse(left) == ast.unparse(right):
        return isinstance(operator, ast.Is | ast.LtE | ast.GtE)  # == of NaN may fail, and hashes may differ
    a_length = isinstance(left, ast.Call) and ast.unparse(left.func) == "len"
    counted = a_length and isinstance(right, ast.Constant)
    if counted and isinstance(operator, ast.GtE):
        return right.value <= 0
    return counted and isinstance(operator, ast.Gt) and right.value < 0


def branches(node, known=frozenset()):
    """Yield (assertion, texts of the conditions that hold there) below a node."""
    if isinstance(node, ast.Assert):
        yield node, known
    elif isinstance(node, ast.If):
        for s in node.body:
            yield from branches(s, known | {ast.unparse(node.test)})
        for s in node.orelse:
            yield from branches(s, known | {negated(node.test)})
    else:
        inner = frozenset() if isinstance(node, ast.For | ast.While | ast.FunctionDef) else known
        for child in (s for body in BODIES for s in getattr(node, body, ())):
            yield from branches(child, inner)


def vacuous(source):
    """Return {line: why} of tests that pass where nothing was asserted, and of assertions that hold whatever
    happens.
    """
    found, tree = {}, ast.parse(source)
    for node in statements(tree):
        if (
            isinstance(node, ast.FunctionDef)
            and node.name.startswith("test_")
            and any(map(asserts, node.body))
            and not reached(node.body)
        ):
            found[node.lineno] = (
                f"{node.name}: every assertion is under an if; count those that were reached, and assert the "
                f"count"
            )
    for assertion, known in branches(tree):
        if holds_always(assertion.test, known):
            found[assertion.lineno] = "an assertion, or an arm of it, that holds whatever happens"
    return found


WALL_CLOCKS = {"time", "time_ns", "perf_counter", "perf_counter_ns", "monotonic", "monotonic_ns"}


def reads_the_clock(node):
    """Return whether an expression asks how late it is."""
    calls = (ast.unparse(n.func) for n in ast.walk(node) if isinstance(n, ast.Call))
    return any(call.startswith("time.") and call[5:] in WALL_CLOCKS for call in calls)


def timed(source):
    """Return the lines of assertions that compare seconds of a clock on the wall, which a busy machine
    stretches: count calls (`counted_calls`) or traces, or compare CPU time.
    """
    if "time." not in source:
        return []
    tree, lines = ast.parse(source), []
    for function in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
        nodes = list(ast.walk(function))
        assigned = [n for n in nodes if isinstance(n, ast.Assign) and reads_the_clock(n.value)]
        clocks = {target.id for a in assigned for target in a.targets if isinstance(target, ast.Name)}
        for assertion in (n for n in nodes if isinstance(n, ast.Assert)):
            names = {n.id for n in ast.walk(assertion.test) if isinstance(n, ast.Name)}
            if names & clocks or reads_the_clock(assertion.test):
                lines.append(assertion.lineno)
    return lines


def untraced(source):
    """Return the names of tests that count traces where NumPy evaluates kernels, which traces none."""
    if "_cache_size" not in source or re.search(r"^pytestmark = .*(compiled|by_xla)", source, re.M):
        return []
    tests = (n for n in ast.parse(source).body if isinstance(n, ast.FunctionDef))
    marked = lambda test: any("compiled" in ast.unparse(mark) for mark in test.decorator_list)
    counts = lambda test: any(getattr(node, "attr", "") == "_cache_size" for node in ast.walk(test))
    return [test.name for test in tests if counts(test) and not marked(test)]


FILES = sorted(Path(__file__).parent.rglob("test_*.py"))


@pytest.mark.parametrize("wrong", [vacuous, timed, untraced])
def test_tests_can_fail_and_assert_no_seconds_on_the_wall(wrong):
    assert [(path.name, found) for path in FILES if (found := wrong(path.read_text()))] == []


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("start = time.perf_counter()\nf()\nassert time.perf_counter() - start < 1", 4),
        ("start = time.time()\ntook = time.time() - start\nassert took < 1", 4),
        ("start = time.process_time()\nassert time.process_time() - start < 1", None),
        ("late = time.monotonic() + 9\nwhile time.monotonic() < late:\n    f()\nassert g()", None),
    ],
)
def test_an_assertion_of_seconds_is_found(body, line):
    assert timed("def test_x():\n" + textwrap.indent(body, "    ")) == ([] if line is None else [line])


BAD = [
    "if x:\n    assert y",
    "for x in z:\n    if x:\n        check(y)",
    "assert y if x else True",
    "if x:\n    assert y\nelse:\n    pass",
    "for x in z:\n    if x:\n        continue\n    assert y",
    "if x:\n    return\nassert y",
    "try:\n    f()\nexcept E:\n    assert x",
    "assert y if x is None else x is not None",
    "if x is None:\n    assert x is None\nelse:\n    assert y",
    "assert x == 1 or x != 1",
    "assert y and len(x) >= 0",
    "assert (y, 'why')",
    "assert (y for y in x)",
    "assert x <= x",
    "assert f'{y}'",
]
GOOD = [
    "assert y",
    "if x:\n    assert y\nelse:\n    assert z",
    "if x:\n    assert y\nassert n",
    "try:\n    f()\nexcept E:\n    assert x\nelse:\n    assert y",
    "for x in z:\n    if x:\n        continue\n    assert y\nassert n",
    "if x:\n    assert z\n    return\nassert y",
    "assert y if x is None else x is not z",
    "if x is None:\n    x = f()\nassert x is not None",
    "assert x == 1 or y != 1",
    "assert y and len(x) >= 1",
    "assert x == x",
    "with pytest.raises(E):\n    f()",
    "f()",
]


@pytest.mark.parametrize("body", [*BAD, *GOOD])
def test_a_test_that_cannot_fail_is_found(body):
    assert bool(vacuous("def test_x():\n" + textwrap.indent(body, "    "))) == (body in BAD)


def test_a_count_of_traces_in_numpy_is_found():
    body = "def test_x():\n    assert f._cache_size() == 1\n"
    assert untraced(body) == ["test_x"] and not untraced("@pytest.mark.compiled\n" + body)
