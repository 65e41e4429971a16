"""Every draw of a test can be repeated: from a seed of its own, or of its name; nothing from fresh
entropy.
"""

import ast
from pathlib import Path

import hypothesis
import pytest
from sources import last_name

SEEDED = {"default_rng", "Generator", "PCG64", "SeedSequence", "Random", "RandomState"}
FRESH = {"urandom", "uuid1", "uuid4", "token_bytes", "token_hex", "randbytes", "SystemRandom", "entropy"}
CLOCKS = {"time", "time_ns", "perf_counter", "perf_counter_ns", "monotonic"}
MODULES = {
    "random": {"Random"},
    "np.random": {"default_rng", "Generator", "PCG64", "SeedSequence", "RandomState"},
}
ALLOWED = {"conftest.py"}  # where JAXBOUND_SEED=fresh is read


def fresh_draws(text):
    """Return (line, what) of what draws from fresh entropy in Python source."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute):
            if node.attr in FRESH:
                yield node.lineno, node.attr
            if last_name(node.value) != "random":
                continue
            if (owner := ast.unparse(node.value)) in MODULES and node.attr not in MODULES[owner]:
                yield node.lineno, f"{owner}.{node.attr}"
        if not isinstance(node, ast.Call):
            continue
        name = last_name(node.func)
        given = [*node.args, *(k.value for k in node.keywords)]
        if name in SEEDED and (not given or ast.unparse(given[0]) == "None"):
            yield node.lineno, f"{name} without a seed"
        if name in (*SEEDED, "key", "PRNGKey", "seed"):
            inner = [call for x in given for call in ast.walk(x) if isinstance(call, ast.Call)]
            if any(last_name(call.func) in CLOCKS for call in inner):
                yield node.lineno, f"{name} of a clock"


def test_no_test_draws_from_fresh_entropy():
    folder = Path(__file__).parent
    found = [
        (p.name, *draw)
        for p in sorted(folder.rglob("*.py"))
        if p.name not in ALLOWED
        for draw in fresh_draws(p.read_text())
    ]
    assert found == [] and any(fresh_draws((folder / "conftest.py").read_text()))


@pytest.mark.parametrize(
    "line",
    [
        "np.random.default_rng()",
        "rng = default_rng(None)",
        "np.random.default_rng(int(np.random.SeedSequence().entropy))",
        "random.random()",
        "np.random.normal(size=3)",
        "jax.random.key(time.time_ns())",
        "os.urandom(8)",
        "random.Random()",
    ],
)
def test_a_new_fresh_draw_would_be_found(line):
    assert list(fresh_draws(line))


@pytest.mark.parametrize(
    "line",
    [
        "np.random.default_rng(3)",
        "jax.random.normal(key)",
        "random.Random(11)",
        "jax.random.key(int(rng.integers(9)))",
    ],
)
def test_seeded_draws_are_left_alone(line):
    assert not list(fresh_draws(line))


def test_hypothesis_draws_from_the_names_of_tests():
    assert hypothesis.settings().derandomize
