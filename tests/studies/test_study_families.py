"""tune and study for every family of relations: what works counts and scales as it should, what cannot says
why.
"""

import functools
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.studies.montecarlo.records import count_recordings

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
    "constant": (STEADY, jb.parity_relations, "joint"),
    "uncertain": (MOVING, jb.parity_relations, "joint"),
    "bank": (EXACT, jb.redundancy, "joint"),
    "residual": (EXACT, lambda model: residual(), "joint"),
}


RARELY = {
    "uncertain": "long",
    "constant": "long",
    "long": "long",
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


SEVERAL = ({"name": "quick", "horizon": 1}, {"name": "slow", "horizon": 2, "factor": 2})


def test_a_monitor_sees_a_scenario_when_the_first_of_its_tests_does(tmp_path):
    """Each test alone is counted by the kernel of studies, the monitor by recordings."""
    about = dict(faults="y1:drift", n=60, key=3, sizes=[0.0, 0.03, 0.1], samples=40, onset=20)
    bank = jb.monitor(EXACT, SEVERAL)
    together = jb.study(EXACT, relations=bank, out=tmp_path / "all", rows=True, **about)
    delays = {"all": rows_of(tmp_path / "all").delay}
    for name, test in bank.parts.items():
        alone = jb.study(EXACT, relations=test, out=tmp_path / name, rows=True, **about)
        delays[name] = rows_of(tmp_path / name).delay
        assert together.by_test[name][0].detected.tolist() == alone.tallies[0].detected.tolist()
        assert together.by_test[name][0].delays.tolist() == alone.tallies[0].delays.tolist()
    first = np.fmin(delays["quick"], delays["slow"])
    np.testing.assert_array_equal(delays["all"], first)
    assert together.tallies[0].detected.tolist() == [0, *together.tallies[0].detected[1:].tolist()]
    assert (first != delays["quick"]).any() and (first != delays["slow"]).any()
    assert "share of slow" in together.to_pandas().columns


def rows_of(folder):
    return pd.concat([pd.read_parquet(file) for file in sorted((folder / "scenarios").iterdir())])


def test_a_test_with_a_condition_counts_where_it_watches():
    """A level that stays jumps by 10 rho at sample 5, in two scenarios of different modes."""
    level = jb.LinearSystem([[1]], [[0]], [[1]], noise="0.1")
    tests = (
        {"name": "on", "horizon": 1, "when": "u1 > 0"},
        {"name": "off", "horizon": 2, "when": "otherwise"},
    )
    u = np.stack([np.ones((10, 1)), np.zeros((10, 1))])
    y = np.repeat((np.arange(10.0) >= 5)[None, :, None], 2, 0)
    act, onset = SimpleNamespace(length=10), np.array([5, 5])
    hits, false, delay = count_recordings(jb.monitor(level, tests), act, u, y, onset)
    assert hits.tolist() == [[1, 1, 0], [2, 0, 2]], "the jump lies in one window of two samples, two of three"
    assert delay.tolist() == [[0, 0, -1], [0, -1, 0]] and not false.any()


def test_a_condition_on_a_column_that_no_scenario_has_is_refused():
    bank = jb.monitor(EXACT, [{"name": "cooling", "horizon": 1, "when": "valve > 0"}])
    with pytest.raises(ValueError, match="a study draws inputs alone, and test 'cooling'"):
        jb.study(EXACT, "y1:bias", 4, 0, bank, sizes=[1.0], samples=40)
