"""Types: what is public says what it takes and returns, and the checker of a user who installs the package
sees it.
"""

import ast
import importlib.resources
import inspect
import pydoc
from pathlib import Path

import jaxbound as jb

PACKAGE = Path(__file__).parent.parent / "jaxbound"
FILES = sorted(PACKAGE.rglob("*.py"))


def unannotated(body, method=False):
    """Yield the names of public functions that leave a parameter or their value without a type."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from (f"{node.name}.{name}" for name in unannotated(node.body, method=True))
        if isinstance(node, ast.FunctionDef) and (
            not node.name.startswith("_") or (method and node.name.startswith("__"))
        ):
            a = node.args
            given = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(x for x in (a.vararg, a.kwarg) if x)][method:]
            if node.returns is None or any(x.annotation is None for x in given):
                yield node.name


def test_what_is_public_says_its_types():
    found = [(str(path), name) for path in FILES for name in unannotated(ast.parse(path.read_text()).body)]
    assert found == []


def test_a_missing_annotation_is_found():
    source = (
        "def f(x: int, *y) -> int: ...\ndef g(x: int): ...\nclass C:\n    @property\n    def "
        "size(self): ...\ndef _h(x): ..."
    )
    assert list(unannotated(ast.parse(source).body)) == ["f", "g", "C.size"]


def test_the_checker_of_a_user_is_told_that_there_are_types():
    assert importlib.resources.files("jaxbound").joinpath("py.typed").is_file()


def test_a_signature_names_the_alias_of_arrays_and_not_its_parts():
    """What NumPy makes an array of is spelled by it in 300 letters, for each argument anew."""
    called = {name: getattr(jb, name) for name in jb.__all__ if name != "sets"}
    for name, thing in list(called.items()):
        for member in vars(thing) if inspect.isclass(thing) else ():
            if not member.startswith("_") and callable(method := getattr(thing, member)):
                called[f"{name}.{member}"] = method
    spelled = [name for name, thing in called.items() if "numpy._typing" in str(inspect.signature(thing))]
    assert len(called) > 60 and spelled == []


def test_help_on_detect_fits_on_half_a_page():
    lines = pydoc.plain(pydoc.render_doc(jb.detect)).splitlines()
    assert len(lines) < 45 and max(map(len, lines)) < 350
