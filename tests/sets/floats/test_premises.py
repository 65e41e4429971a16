"""What proofs rest on beside rounding: each premise is asked, and its refusal comes where it does not
hold."""

import jax
import numpy as np
import pytest
from corners import DTYPES

from jaxbound.sets.floats import examined, probe, unrolled

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
CPU = jax.devices("cpu")[0]
QUOTIENTS, CALLS = "quotients that are not one number for all uses", "calls that are not kept apart"


@pytest.fixture
def fresh(monkeypatch):
    """Have the probe compiled and run anew, and forget what it found."""
    kernel = examined._kernel.__wrapped__
    monkeypatch.setattr(examined, "_kernel", jax.jit(lambda *given: kernel(*given)))
    probe._found.cache_clear()
    yield monkeypatch
    probe._found.cache_clear()


def broken(monkeypatch, premise):
    """Let the house's own means do nothing, as a compiler that sees through them would."""
    if premise == QUOTIENTS:
        monkeypatch.setattr(unrolled, "stored", lambda x: x)
    else:
        monkeypatch.setattr(examined, "_squared", lambda a: a * a)
        monkeypatch.setattr(unrolled, "apart", jax.jit)


@pytest.mark.parametrize("premise", [QUOTIENTS, CALLS])
@each_dtype
def test_the_probe_finds_a_premise_that_does_not_hold(fresh, premise, dtype):
    broken(fresh, premise)
    found = examined.measure(CPU, np.dtype(dtype))
    assert [name for name, (value, most) in found.items() if not value <= most] == [premise]


@pytest.mark.parametrize("premise", [QUOTIENTS, CALLS])
def test_a_premise_that_does_not_hold_is_refused_with_versions_and_advice(fresh, premise):
    broken(fresh, premise)
    with pytest.raises(RuntimeError) as refusal:
        probe.refuse_unverified()
    said = str(refusal.value)
    assert (
        premise in said and f"jaxlib {jax.lib.__version__}" in said and "install" in said and "\n" not in said
    )


# versions: known by name, or asked for more numbers


def test_a_version_that_is_not_listed_is_asked_for_thousands_of_numbers_in_one_sentence(fresh):
    asked = []
    fresh.setattr(probe, "VERSIONS", ())
    fresh.setattr(probe, "broken", lambda device, dtype, count: asked.append(count) or "")
    with pytest.warns(UserWarning, match=rf"jaxlib {jax.lib.__version__} is not among the versions") as said:
        probe.refuse_unverified()
    assert len(said) == 1 and "\n" not in str(said[0].message) and asked == [examined.MANY]
    fresh.setattr(probe, "VERSIONS", examined.VERSIONS + [jax.lib.__version__])
    probe._found.cache_clear()
    probe.refuse_unverified()  # a warning would be an error
    assert asked == [examined.MANY, examined.FEW]


def test_the_installed_version_was_examined_or_says_so():
    """The lowest that pyproject.toml allows is listed; 0.11.1 is neither listed nor installed."""
    versions = examined.VERSIONS
    assert "0.8.0" in versions and "0.11.1" not in versions and jax.lib.__version__ != "0.11.1"
