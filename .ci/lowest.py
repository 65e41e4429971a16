"""Print the lowest versions that pyproject.toml states, of the package and of its tests, as constraints of
pip.
"""

import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
for requirement in [*project["dependencies"], *project["optional-dependencies"]["test"]]:
    lowest, *others = requirement.split(",")
    name, stated, version = lowest.partition(">=")
    if not stated or not all(other.startswith("!=") for other in others):
        raise SystemExit(
            f"pyproject.toml must state one lowest version, and nothing else but versions left out: "
            f"{requirement}"
        )
    print(f"{name}=={version}")
