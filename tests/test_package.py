"""What is handed on: the archive of the sources holds what its tests need, the README works on an index page,
versions agree.
"""

import importlib.util
import re
import tomllib
from pathlib import Path

import jaxbound as jb

ROOT = Path(__file__).parents[1]


def description(*args):
    spec = importlib.util.spec_from_file_location("package_setup", ROOT / "setup.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.description(*args)


def test_every_folder_and_file_of_the_sources_is_in_the_archive():
    stated = (ROOT / "MANIFEST.in").read_text()
    taken = set(re.findall(r"^graft (\S+)", stated, re.M)) | {
        name for line in re.findall(r"^include (.+)", stated, re.M) for name in line.split()
    }
    kept = {"jaxbound", "pyproject.toml", "setup.py", "MANIFEST.in"}  # by setuptools itself
    made = {line.strip("/") for line in (ROOT / ".gitignore").read_text().split()} | {
        ".git",
        "PKG-INFO",
        "setup.cfg",
        "shared",
    }
    there = {p.name for p in ROOT.iterdir() if not p.name.endswith((".egg-info", "_cache", ".pyc"))}
    assert there - kept - made <= taken and taken <= there


def test_the_readme_has_no_link_that_leads_nowhere_on_an_index_page():
    text = "![p](a/b.png)\n[docs](docs/x.md) [web](https://a.b/c) `jb.x`"
    assert description(text, None) == "\ndocs [web](https://a.b/c) `jb.x`"
    assert description(text, "https://host/r") == (
        "![p](https://host/r/raw/main/a/b.png)\n[docs](https://host/r/blob/main/docs/x.md) "
        "[web](https://a.b/c) `jb.x`"
    )
    assert not re.findall(r"\]\((?!https?:|#)", description((ROOT / "README.md").read_text(), None))


def test_versions_and_licence_are_stated_alike():
    cited = dict(re.findall(r"^(\w+): (.+)$", (ROOT / "CITATION.cff").read_text(), re.M))
    project = (ROOT / "pyproject.toml").read_text()
    assert cited["version"] == jb.__version__ and f'license = "{cited["license"]}"' in project


def test_continuous_integration_calls_what_is_there():
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.M)
    assert {"lowest", "newest"} <= set(targets) and set(re.findall(r"which: (\w+)", text)) == {
        "lowest",
        "newest",
    }
    assert all((ROOT / script).is_file() for script in re.findall(r"run: (\.ci/\w+)", text))
    assert "--durations=40" in (ROOT / ".ci" / "run").read_text()
    assert set(re.findall(r"\b(\w+)-latest", text)) == {"ubuntu", "macos", "windows"}


def test_every_mark_that_leaves_tests_out_runs_in_a_scheduled_job():
    """Long tests run at night, in shares that together leave none out."""
    nightly = (ROOT / ".github" / "workflows" / "nightly.yml").read_text()
    assert "schedule:" in nightly and "make long WHERE=" in nightly
    folders, ignored = (set(re.findall(pattern, nightly)) for pattern in (r" (tests/\w+)", r"=(tests/\w+)"))
    assert folders == ignored and all((ROOT / folder).is_dir() for folder in folders)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    left_out = re.findall(r"not (\w+)", project["tool"]["pytest"]["ini_options"]["addopts"])
    assert left_out == ["long"]


def test_what_builds_the_package_is_there_for_its_tests():
    """They import setup.py, and Python 3.12 and newer bring no setuptools."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert set(stated["build-system"]["requires"]) <= set(stated["project"]["optional-dependencies"]["test"])


def test_targets_of_make_leave_the_package_editable():
    """Installed without --editable, a copy takes its place: all later targets would test what was."""
    installs = re.findall(r"pip install .*", (ROOT / "Makefile").read_text())
    assert len(installs) == 4 and all(" --editable " in line for line in installs)
