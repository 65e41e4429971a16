"""What pyproject.toml states: each package that is imported, and one lowest version of each, that `make
lowest` then tests.
"""

import subprocess
import sys
import tomllib
from pathlib import Path

from sources import imports

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "jaxbound").rglob("*.py"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_every_package_that_is_imported_is_declared():
    declared = {requirement.partition(">=")[0] for requirement in PROJECT["dependencies"]}
    found = (
        {module.split(".")[0] for path in FILES for module, _ in imports(path)}
        - set(sys.stdlib_module_names)
        - {"jaxbound"}
    )
    optional = PROJECT["optional-dependencies"]
    extras = {"sklearn", *(line.partition(">=")[0] for line in optional["dask"] + optional["shell"])}
    assert found == declared | extras  # what not everybody needs


def test_each_lowest_version_is_stated_once():
    lines = subprocess.run(
        [sys.executable, ROOT / ".ci" / "lowest.py"], capture_output=True, text=True, check=True
    ).stdout.split()
    names = [line.partition("==")[0] for line in lines]
    assert (
        len(set(names))
        == len(names)
        == len(PROJECT["dependencies"]) + len(PROJECT["optional-dependencies"]["test"])
    )
    assert all(
        version[0].isdigit() and set(version) <= set("0123456789.")
        for version in (line.partition("==")[2] for line in lines)
    )
