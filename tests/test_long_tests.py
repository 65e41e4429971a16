"""Long tests run at night, and each names a small one that guards the same by day."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent
BY_NIGHT = (TESTS / "by_night.txt").read_text().splitlines()


def functions_of(path):
    """Return {name: function} of the tests of a file."""
    tree = ast.walk(ast.parse(path.read_text()))
    functions = (node for node in tree if isinstance(node, ast.FunctionDef))
    return {f.name: f for f in functions if f.name.startswith("test_")}


FILES = {str(p.relative_to(TESTS).with_suffix("")): functions_of(p) for p in sorted(TESTS.rglob("test_*.py"))}


def by_day(function):
    """Return what the mark of a long function says; "" where it says nothing, None where it has none."""
    for decorator in function.decorator_list:
        text = ast.unparse(decorator)
        if text.startswith("pytest.mark.long"):
            return decorator.keywords[0].value.value if isinstance(decorator, ast.Call) else ""
    return None


def test_every_long_test_names_a_small_one_by_day():
    unknown = []
    for file, functions in FILES.items():
        for name, function in functions.items():
            stated = by_day(function)
            place, _, sibling = (stated or "").rpartition("::")
            small = FILES.get(place or file, {}).get(sibling)
            if stated is not None and (small is None or by_day(small) is not None):
                unknown.append((file, name, stated))
    assert unknown == []


def test_what_runs_by_night_is_there_and_is_one_of_several_cases():
    """`.ci/night.py` writes these names; a whole function is marked where it stands."""
    assert BY_NIGHT == sorted(set(BY_NIGHT))
    for name in BY_NIGHT:
        path, *_, function = name.partition("[")[0].split("::")
        assert "[" in name and function in FILES[path.removeprefix("tests/").removesuffix(".py")], name
