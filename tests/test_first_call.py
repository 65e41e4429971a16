"""What the first call of every verb hands to the compiler, which is nearly all that a user waits for: it must
not grow unseen.

Instructions and programs are counted, not seconds: they depend on no machine. After a change that is worth
it:

    python -m benchmarks.first_call --lowered tests/first_call.json
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from benchmarks import first_call

ROOT = Path(__file__).parents[1]
TABLE = json.loads((ROOT / "tests/first_call.json").read_text())
MEASURED = (
    ROOT / "benchmarks/first_call.json",
    ROOT / "benchmarks/first_call_before.json",
)  # the latest that there is


def counted(tmp_path, *options, **more):
    """Run the benchmark in a process of its own. more: variables of its environment."""
    kept = jax.config.jax_compilation_cache_dir or str(tmp_path / "kernels")
    settings = {"JAX_COMPILATION_CACHE_DIR": kept, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    subprocess.run(
        [sys.executable, "-m", "benchmarks.first_call", *options],
        cwd=ROOT,
        env={**os.environ, **settings, **more},
        check=True,
    )


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lowered")
    counted(folder, "--lowered", str(folder / "now.json"))
    return json.loads((folder / "now.json").read_text())


def grown(now, table):
    """Return a sentence for each case whose instructions or programs are more than half as many again."""
    return [
        f"{name}: {found} instead of {before} {what}"
        for name in table
        for found, before, what in zip(now[name], table[name], ("instructions", "programs"), strict=True)
        if found > 1.5 * before
    ]


def test_no_first_call_hands_half_as_much_again_to_the_compiler(found):
    assert set(found) == set(TABLE) and grown(found, TABLE) == []


def test_what_is_compiled_grows_at_most_with_the_horizon(tmp_path):
    families = "joint", "box", "disturbed"
    cases = ";".join(f"{family}{horizon}" for family in families for horizon in (10, 40))
    counted(tmp_path, "--lowered", str(tmp_path / "now.json"), "--only", cases, JAXBOUND_COMPILE="always")
    found = json.loads((tmp_path / "now.json").read_text())
    for family in families:
        assert 0 < found[f"{family}40"][0] <= 4 * found[f"{family}10"][0]


def test_growth_is_seen():
    assert grown({"a": [151, 2]}, {"a": [100, 2]}) == ["a: 151 instead of 100 instructions"]
    assert grown({"a": [150, 4]}, {"a": [100, 2]}) == ["a: 4 instead of 2 programs"]


LARGE = [name for name in first_call.CASES if name.endswith(("20", "40"))]


@pytest.mark.long(by_day="test_no_first_call_hands_half_as_much_again_to_the_compiler")
@pytest.mark.parametrize(
    "cases",
    [[name for name in first_call.CASES if name not in LARGE], LARGE],
    ids=["all", "20 samples and more"],
)
def test_no_optimised_program_grows_by_half(cases, tmp_path):
    counted(tmp_path, "--counts", "--out", str(tmp_path / "now"), "--only", ";".join(cases))
    now = json.loads((tmp_path / "now.json").read_text())["cases"]
    pair = lambda figures: [figures["instructions"], figures["compilations"]]
    latest = json.loads(next(path for path in MEASURED if path.exists()).read_text())["cases"]
    table = {
        name: pair(figures) for name, figures in latest.items() if "instructions" in figures and name in now
    }
    assert table and grown({name: pair(now[name]) for name in table}, table) == []
