"""tune and study for every family of relations: what works counts and scales as it should, what cannot says
why.
"""

import functools

import numpy as np
import pytest

import jaxbound as jb

PLAIN = jb.LinearSystem([["0.5"]], None, [[1]], noise="0.1", tolerance="0.02")
EXACT = PLAIN.replace(tolerance=["0"])
STEADY = PLAIN.replace(constant_tolerance=True)
MOVING = EXACT.replace(uncertainties=(jb.Uncertainty("a", A=[["0.05"]]),))


def recurrence(z, u, y):
    """y+ = 0.5 y, each sample with an error in z."""
    return (y[1:, 0] - z[1:]) - 0.5 * (y[:-1, 0] - z[:-1])


def residual():
    return jb.residual(recurrence, jb.interval([-0.1, -0.1], [0.1, 0.1]), 1)


TWICE = jb.LinearSystem(
    [["0.5"]], None, [[1], [1]], noise="0.1"
)  # so many relations of 25 samples that they are searched


STUDIED = {
    "long": (TWICE, lambda model: jb.parity_relations(model, 24), "joint"),
    "short": (EXACT, jb.parity_relations, "joint"),
    "box": (EXACT, jb.parity_relations, "box"),
    "paving": (EXACT, jb.parity_relations, "paving"),
    "constant": (STEADY, jb.parity_relations, "joint"),
    "uncertain": (MOVING, jb.parity_relations, "joint"),
    "bank": (EXACT, jb.redundancy, "joint"),
    "residual": (EXACT, lambda model: residual(), "joint"),
}


RARELY = {
    "uncertain": "slow",
    "constant": "long",
    "long": "long",
    "paving": "long",
    "residual": "long",
}  # for the time that they take


@functools.cache
def studied(family):
    model, build, method = STUDIED[family]
    return jb.study(
        model, "y1:bias", 4, 0, build(model), sizes=[0.0, 5.0], samples=40, onset=30, method=method
    )


@pytest.mark.parametrize(
    "family", [pytest.param(f, marks=getattr(pytest.mark, RARELY[f])) if f in RARELY else f for f in STUDIED]
)
def test_a_study_finds_what_is_large_and_alarms_nobody_else(family):
    res = studied(family)
    (tally,) = res.tallies
    assert (
        tally.detected.tolist() == [0, 2]
        and res.false_alarms[0] == 0
        and res.settings["method"] == STUDIED[family][2]
    )


def test_the_joint_test_guarantees_what_no_other_does():
    joint, box = (studied(family).trials[0] for family in ("short", "box"))
    assert joint.guaranteed > 0 and np.isnan(box.guaranteed)


def test_a_study_of_the_linearised_test_is_refused():
    with pytest.raises(ValueError, match="proves no FAULT, which is what a study counts"):
        jb.study(MOVING, "y1:bias", 4, 0, jb.parity_relations(MOVING), samples=12, method="linearized")


def test_a_study_of_a_residual_cannot_be_taken_up(tmp_path):
    with pytest.raises(TypeError, match="cannot be kept and taken up"):
        jb.study(EXACT, "y1:bias", 4, 0, residual(), sizes=[5.0], samples=12, out=tmp_path / "kept")


def test_banks_of_one_model_are_told_apart_by_their_relations(tmp_path):
    model = jb.LinearSystem([["0.5"]], None, [[1], [1]], noise="0.1")
    go = lambda bank: jb.study(model, "y1:bias", 4, 0, bank, sizes=[5.0], samples=12, out=tmp_path / "kept")
    go(jb.structured_relations(model, [("y1",)]))
    with pytest.raises(ValueError, match="another"):
        go(jb.structured_relations(model, [("y2",)]))


def test_an_adversary_says_which_tests_it_knows():
    with pytest.raises(NotImplementedError, match="test by strips, down whose margin it goes"):
        jb.study(EXACT, "y1:bias", 4, 0, residual(), sizes=[5.0], samples=12, at="adversarial")


@pytest.mark.parametrize("family", ["short", "constant", "uncertain"])
def test_tuned_bounds_are_the_smallest_that_explain_the_data(family):
    model, build, _ = STUDIED[family]
    y = np.array([[1.0], [0.8], [0.3], [0.2], [0.05]])
    res = jb.tune(build(model), (None, y), steps=0)
    assert (
        res.counts["FAULT"] == 0 and not (jb.detect(res.relations, None, y).status == jb.Status.FAULT).any()
    )
    less = res.relations.with_bounds({name: 0.99 * np.asarray(b) for name, b in res.smallest.items()})
    assert (jb.detect(less, None, y).status == jb.Status.FAULT).any()


@pytest.mark.parametrize(
    "relations, says",
    [
        (jb.redundancy(EXACT), "tune that, and build the bank of the tuned .model"),
        (residual(), "no margin to scale or to derive"),
        (EXACT, "tune needs relations"),
    ],
    ids=["bank", "residual", "model"],
)
def test_what_cannot_be_tuned_says_why_and_what_to_do(relations, says):
    with pytest.raises(TypeError, match=says):
        jb.tune(relations, (None, [[1.0], [0.8], [0.3]]), steps=0)


def test_a_gradient_of_constant_gains_is_refused_with_its_reason():
    with pytest.raises(NotImplementedError, match="no derivative: tune with steps=0"):
        jb.tune(jb.parity_relations(STEADY), (None, [[1.0], [0.8], [0.3]]), steps=2)
