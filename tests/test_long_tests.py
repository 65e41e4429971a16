"""Long tests run at night, and each names a small one that guards the same by day."""

import ast
from pathlib import Path

import pytest
from sources import statements

TESTS = Path(__file__).parent
BY_NIGHT = (TESTS / "by_night.txt").read_text().splitlines()


def functions_of(path):
    """Return {name: function} of the tests of a file."""
    functions = (s for s in statements(ast.parse(path.read_text())) if isinstance(s, ast.FunctionDef))
    return {f.name: f for f in functions if f.name.startswith("test_")}


@pytest.fixture(scope="module")
def files():
    """Return {file: {name: function}} of all tests."""
    return {str(p.relative_to(TESTS).with_suffix("")): functions_of(p) for p in TESTS.rglob("test_*.py")}


def by_day(function):
    """Return what the mark of a long function says; "" where it says nothing, None where it has none."""
    for decorator in function.decorator_list:
        text = ast.unparse(decorator)
        if text.startswith("pytest.mark.long"):
            return decorator.keywords[0].value.value if isinstance(decorator, ast.Call) else ""
    return None


def test_every_long_test_names_a_small_one_by_day(files):
    unknown = []
    for file, functions in files.items():
        for name, function in functions.items():
            stated = by_day(function)
            place, _, sibling = (stated or "").rpartition("::")
            small = files.get(place or file, {}).get(sibling)
            if stated is not None and (small is None or by_day(small) is not None):
                unknown.append((file, name, stated))
    assert unknown == []


def test_what_runs_by_night_is_there_and_is_one_of_several_cases(files):
    """`.ci/night.py` writes these names; a whole function is marked where it stands."""
    assert BY_NIGHT == sorted(set(BY_NIGHT))
    for name in BY_NIGHT:
        path, *_, function = name.partition("[")[0].split("::")
        assert "[" in name and function in files[path.removeprefix("tests/").removesuffix(".py")], name


def test_every_claim_has_a_case_by_day(never_by_day):
    """Seen by collecting, so where a mark or `by_night.txt` comes from does not matter."""
    print(*never_by_day, sep="\n")
    assert never_by_day == []
