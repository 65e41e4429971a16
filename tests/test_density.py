"""The gate of density, `.ci/density.py`: what it counts, and that a room denser than its budget fails."""

import importlib.util
import json
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("density", ROOT / ".ci" / "density.py")
density = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(density)

TOY = '''
"""A room."""

from typing import Any


def level(tank: Any, shut: bool) -> float:
    """Return what the tank holds."""
    return 0.0 if shut else tank.level


class Tank:
    """A tank of water."""

    area = 2.0  # m^2
    heights = [k / 2 for k in range(4)]
    volume = lambda self, height: self.area * height
'''


@pytest.fixture
def toy(tmp_path):
    """Return a function that writes a package of one file and its budget, and returns their folder."""

    def written(budget, text=TOY):
        for folder in ("jaxbound/water", ".ci"):
            (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / "jaxbound" / "water" / "tank.py").write_text(textwrap.dedent(text))
        (tmp_path / ".ci" / "density.json").write_text(json.dumps({"water": budget}))
        return tmp_path

    return written


FOUND = {"conditionals": 143, "comprehensions": 143, "lambdas": 143, "any": 1, "sentences": 1}


def test_within_its_budget_a_package_passes(toy, capsys):
    assert density.main([str(toy(FOUND))]) == 0
    assert "water" in capsys.readouterr().out


@pytest.mark.parametrize("measure", FOUND)
def test_one_above_the_budget_fails_and_names_the_room_and_the_measure(measure, toy, capsys):
    lower = {**FOUND, measure: FOUND[measure] - 1}
    assert density.main([str(toy(lower))]) == 1
    said = capsys.readouterr().out.strip().splitlines()[-1]
    assert said.startswith(f"water: {measure} {FOUND[measure]}, the budget is {FOUND[measure] - 1}")


def test_a_room_without_a_budget_may_hold_nothing_dense(toy):
    assert density.main([str(toy({}))]) == 1
    assert density.main([str(toy({}, '"""A room."""\nx = 1\n'))]) == 0


@pytest.mark.parametrize(
    ("text", "measure"),
    [
        ("x = 1  # fmt: skip\n", "skips"),
        ("x = '" + 110 * "-" + "'\n", "wide"),
        ("def f():\n    found = 1\n" + 11 * "    g()\n" + "    return found\n", "locals"),
        ('def f():\n    """Who calls."""\n', "sentences"),
    ],
)
def test_every_count_sees_its_kind(text, measure, toy):
    rooms = density.table(toy({}, text) / "jaxbound")
    assert {m: rooms["water"][m] for m in density.COUNTS if rooms["water"][m]} == {measure: 1}


def test_budgets_are_lowered_and_never_raised():
    row = {measure: 5 for measure in (*density.RATES, *density.COUNTS)}
    before = {"water": {**row, "wide": 3, "skips": 9}}
    assert density.lowered({"water": row}, before) == {"water": {**row, "wide": 3}}
    assert density.lowered({"fire": row}, before) == {"fire": row}


def test_types_of_relations_are_asked_where_they_are_defined_alone(toy):
    asking = "def f(x):\n    return isinstance(x, str | Windows)\n"
    package = toy({}, "class Relations: ...\n\n\nclass Windows(Relations): ...\n\n\n" + asking) / "jaxbound"
    assert density.table(package)["water"]["families"] == 0
    (package / "elsewhere.py").write_text(asking)
    density.families.cache_clear()
    assert density.table(package)["."]["families"] == 1
