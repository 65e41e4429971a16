"""The house: imports point down, files stay small, what is public is documented."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import jaxbound as jb

PACKAGE = Path(jb.__file__).parent
FLOORS = {"sets": 0, "models": 1, "relations": 2, "diagnosis": 3, "studies": 4}
FACE = 5
FILES = sorted(PACKAGE.rglob("*.py"))


def floor_of(parts):
    return FLOORS.get(parts[0], FACE) if parts else FACE


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            yield from (f"{node.module}.{a.name}" for a in node.names)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_down(path):
    here = path.relative_to(PACKAGE).with_suffix("").parts
    if here == ("__init__",):
        return
    for name in imported(path):
        if name.split(".")[0] == "jaxbound" and name != "jaxbound.__version__":
            there = tuple(name.split(".")[1:])
            assert floor_of(there) <= floor_of(here), f"{'/'.join(here)} imports {name} from a floor above"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_private_jax_and_no_file_over_400_lines(path):
    text = path.read_text()
    assert "jax._src" not in text
    assert text.count("\n") <= 400


@pytest.mark.parametrize("module", [jb, jb.sets], ids=lambda m: m.__name__)
def test_every_public_name_has_a_docstring(module):
    for name in module.__all__:
        thing = getattr(module, name)
        assert inspect.getdoc(thing), f"{module.__name__}.{name} has no docstring"
        if inspect.isclass(thing) and thing.__module__.startswith("jaxbound"):
            for member, value in vars(thing).items():
                if not member.startswith("_") and (inspect.isfunction(value) or isinstance(value, property)):
                    assert inspect.getdoc(value), f"{name}.{member} has no docstring"


def test_import_loads_nothing_heavy_beyond_jax():
    code = (
        "import sys, jax; before = set(sys.modules); import jaxbound;"
        "print([m for m in set(sys.modules) - before if m.split('.')[0] in ('pandas', 'matplotlib', 'pyarrow', 'rich', 'scipy')])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_import_makes_no_arrays_and_changes_no_configuration():
    code = "import jax; x64 = jax.config.jax_enable_x64; import jaxbound; print(len(jax.live_arrays()), jax.config.jax_enable_x64 == x64)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["0", "True"]
