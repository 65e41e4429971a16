"""The tests themselves: each can fail. An assertion that only an `if` may reach is none where that is never
true.
"""

import ast
import textwrap
from pathlib import Path

import pytest

HELPERS = ("assert", "check", "confirm", "fail", "raises", "warns")  # how calls begin that assert


def asserts(node):
    """Return whether a statement or an expression asserts, if only at times."""
    return any(isinstance(n, ast.Assert) or isinstance(n, ast.Call) and called(n) for n in ast.walk(node))


def called(call):
    return ast.unparse(call.func).split(".")[-1].lstrip("_").startswith(HELPERS)


def reached(statements):
    """Return whether one of the statements asserts, whichever way an `if` goes."""
    for s in statements:
        if isinstance(s, ast.If):
            if reached(s.body) and reached(s.orelse):
                return True
        elif isinstance(s, ast.For | ast.While | ast.With | ast.Try):
            if isinstance(s, ast.With) and any(map(asserts, s.items)) or reached(s.body):
                return True
        elif not isinstance(s, ast.FunctionDef | ast.ClassDef) and asserts(s):
            return True
    return False


def vacuous(source):
    """Return {line: why} of tests that pass where nothing was asserted, and of assertions that hold whatever
    happens.
    """
    found = {}
    for node in ast.walk(ast.parse(source)):
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
        if isinstance(node, ast.Assert) and isinstance(node.test, ast.IfExp):
            arms = [
                arm
                for arm in (node.test.body, node.test.orelse)
                if isinstance(arm, ast.Constant) and arm.value
            ]
            if arms:
                found[node.lineno] = "an assertion of a constant: put the assertion under an if"
    return found


@pytest.mark.parametrize("path", sorted(Path(__file__).parent.rglob("test_*.py")), ids=lambda p: p.stem)
def test_tests_can_fail(path):
    assert not vacuous(path.read_text())


BAD = [
    "if x:\n    assert y",
    "for x in z:\n    if x:\n        check(y)",
    "assert y if x else True",
    "if x:\n    assert y\nelse:\n    pass",
]
GOOD = [
    "assert y",
    "if x:\n    assert y\nelse:\n    assert z",
    "if x:\n    assert y\nassert n",
    "with pytest.raises(E):\n    f()",
    "f()",
]


@pytest.mark.parametrize("body", [*BAD, *GOOD])
def test_a_test_that_cannot_fail_is_found(body):
    assert bool(vacuous("def test_x():\n" + textwrap.indent(body, "    "))) == (body in BAD)
