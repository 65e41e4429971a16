"""The pages: every public name is documented, what they take from the README is there, and they build without a warning."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jaxbound as jb

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def documented():
    for page in PAGES:
        for path in re.findall(r"^::: (jaxbound[\w.]*)$", page.read_text(), re.M):
            thing = jb
            for part in path.split(".")[1:]:
                thing = getattr(thing, part)
            yield path, thing


@pytest.mark.parametrize("module", [jb, jb.sets], ids=lambda m: m.__name__)
def test_every_public_name_has_its_place_in_the_reference(module):
    things = [thing for _, thing in documented()]
    missing = [n for n in module.__all__ if n != "sets" and not any(getattr(module, n) is t for t in things)]
    assert not missing, f"add to docs/api: {missing}"


def test_nothing_is_documented_twice():
    paths = [path for path, _ in documented()]
    assert len(paths) == len(set(paths)) and len({id(t) for _, t in documented()}) == len(paths)


def test_sections_taken_from_the_readme_are_there():
    pytest.importorskip("mkdocs")
    hooks = script("hooks")
    taken = [heading for page in PAGES for heading in re.findall(r"<!-- README: (.+?) -->", page.read_text())]
    assert taken and all(hooks.section(heading) for heading in taken)


def test_docstrings_become_paragraphs_and_examples():
    pytest.importorskip("griffe")
    text = "Do it.\n\nReturns:\n    A thing: good.\n\nEncloses: all\n    of it.\n\nExample:\n    >>> 1\n    1"
    out = script("docstrings").readable(text)
    assert "**Returns**  A thing: good." in out and "**Encloses**  all of it." in out.replace("\n", " ") and "Examples:\n    >>> 1" in out


@pytest.mark.long
def test_pages_build_without_a_warning(tmp_path):
    for package in ("mkdocs", "material", "mkdocstrings"):
        pytest.importorskip(package)
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", ROOT / "mkdocs.yml", "-d", tmp_path / "site"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "jaxbound.LinearSystem" in (tmp_path / "site" / "api" / "models.html").read_text()


def test_links_of_the_readme_work_from_a_page():
    pytest.importorskip("mkdocs")
    moved = script("hooks").moved
    text = "![a](notebooks/a.png) [b](docs/start.md) [c](Makefile) [d](https://x.y)"
    assert moved(text, "../") == "![a](../notebooks/a.png) [b](../start.md) c [d](https://x.y)"
