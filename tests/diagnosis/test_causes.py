"""The cause of an alarm: faults that explain each of its windows, or only some; extrapolation is said."""

import numpy as np
import pytest
from pytest import approx

import jaxbound as jb

FAULTS = jb.NamedFault("u is off", input="u"), jb.NamedFault("y2 is off", output="y2")

NONE = "none of the named faults explains this in all"


@pytest.fixture(scope="module")
def two_faults():
    """Return a Result of one alarm: first u is off by 1, which y1 and y2 show, then y2 alone by 2."""
    model = jb.LinearSystem(
        None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=FAULTS, ranges={"u": [0, 1]}
    )
    u = np.array([[0.5], [0.5], [0.5], [3.0], [0.5]])
    y = np.array([[0.5, 0.5], [1.5, 1.5], [1.5, 1.5], [3.0, 5.0], [0.5, 2.5]])
    return jb.detect(jb.parity_relations(model, 0), u, y)


def test_faults_that_explain_some_of_the_windows_are_counted(two_faults):
    found = two_faults.diagnose(1, 4)
    assert not found.explains and found.windows == (1, 2, 3, 4)
    assert found.partly == {"u is off": (1, 2), "y2 is off": (3, 4)}
    sizes = "u is off 2 (+0.9 to +1.1 of u), y2 is off 2 (+1.9 to +2.1 of y2)"
    said = f"4 windows that were looked at; of these {sizes}"
    assert str(found).startswith(f"{NONE} {said}")
    sizes = found.to_dict()["partly_sizes"]
    assert sizes == {"u is off": approx([0.9, 1.1]), "y2 is off": approx([1.9, 2.1])}


def test_what_explains_some_windows_has_the_sizes_that_they_ask_for():
    model = jb.LinearSystem(
        None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=FAULTS[:1], ranges={"u": [0, 1]}
    )
    y = [[1.5, 1.5], [2.5, 2.5], [5.0, 0.0]]  # off by 1 and by 2; the last one nothing explains
    found = jb.detect(jb.parity_relations(model, 0), [[0.5]] * 3, y).diagnose(0, 2)
    assert "of these u is off 2 (+0.9 to +2.1 of u)" in str(found)


def test_windows_that_are_looked_at_are_spread_over_the_alarm_beside_the_worst():
    model = jb.LinearSystem(None, None, None, [[1]], noise=0.1, inputs=["u"], faults=FAULTS[:1])
    y = np.full((21, 1), 2.0)
    y[1] = 9
    found = jb.detect(jb.parity_relations(model, 0), np.zeros((21, 1)), y).diagnose(0, 20)
    assert found.windows == (0, 1, 7, 14, 20)


def test_a_cause_that_rests_on_extrapolation_says_so(two_faults):
    assert two_faults.diagnose(1, 2).outside == ""
    found = two_faults.diagnose(3, 4)
    assert found.first == "y2 is off: +1.9 to +2.1 of y2"
    assert str(found).endswith("rest on extrapolation, u at 3, training up to 1")


def test_a_cause_of_the_physical_quantity_leaves_detection_its_own_signals():
    """A coil heats by its valve times the fan; the product as an input changes what is tested."""
    plain = jb.LinearSystem(None, None, None, [[2, 1]], noise=0.1, inputs=["heat", "fan"])
    leaks = jb.NamedFault("valve leaks", input="heat", times="fan", sign="+")
    shut = jb.NamedFault("valve is off", input="heat")
    named = plain.replace(faults=[leaks, shut])
    u = np.array([[0.2, 0.5], [0.4, 1.0], [0.1, 2.0], [0.3, 1.5]])
    y = u @ [[2.0], [1.0]] + 2 * 0.3 * u[:, 1:]
    res, other = (jb.detect(jb.parity_relations(m, 3), u, y) for m in (named, plain))
    assert res.status[-1] == jb.Status.FAULT and np.array_equal(res.margin, other.margin, equal_nan=True)
    found = res.explain(3).diagnose()
    assert found.first.startswith("valve leaks: +0.2") and len(found.explains) == 1
