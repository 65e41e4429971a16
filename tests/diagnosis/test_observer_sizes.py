"""What a settled observer sees of a fault: sizes from one recording, held against many; a study counts
samples, not windows.
"""

import jax
import numpy as np
import pytest

import jaxbound as jb

PLANT = jb.LinearSystem(
    [["0.9", "0.05"], [0, "0.9"]],
    [[0], ["0.1"]],
    [[1, 0], [0, 1]],
    noise="0.1",
    disturbance=([[1, 0], [0, 1]], [["-0.004", "0.006"], ["-0.005", "0.005"]]),
    offset={"u": 2, "y": [20, -3]},
    inputs="heat",
    outputs=["T1", "T2"],
)


@pytest.fixture(scope="module")
def watch():
    return jb.observer(PLANT)  # of the sizes that tests of the command compile


@pytest.fixture(scope="module")
def least(watch):
    return jb.detectable(watch, "T1")


def test_a_fault_of_that_size_is_seen_by_then_whatever_the_errors(watch, least):
    size = least
    assert (
        size.horizon in size.sizes
        and min(size.sizes.values()) == pytest.approx(size)
        and size < jb.detectable(PLANT, "T1", horizon=3)
    )
    u = 2 + np.random.default_rng(0).normal(size=(20, 100, 1))
    y = [
        jb.simulate(PLANT, u, jax.random.key(key), at=at).y for key, at in enumerate(("vertices", "uniform"))
    ]
    fault = 1.001 * float(size) * (np.arange(100)[:, None] >= 60) * [1, 0]
    wrong = np.concatenate([np.concatenate(y) + sign * fault for sign in (1, -1)])
    status = jb.detect(watch, np.concatenate([u] * 4), wrong).status
    assert size.horizon < 40 and (status[:, :60] != jb.Status.FAULT).all()
    assert (status[:, 60 : 61 + size.horizon] == jb.Status.FAULT).any(1).all()


def test_half_of_it_may_hide_where_errors_are_in_the_middle(watch):
    """Without any error the shift itself is what is off: half the size is at the edge."""
    size = float(jb.detectable(watch, "T2"))
    x, y = np.zeros(2), np.empty((2, 150, 2))
    for k in range(150):
        y[:, k], x = x + [20, -3], np.array([[0.9, 0.05], [0, 0.9]]) @ x + [0.001, 0]
    y[:, 80:, 1] += size * np.array([[0.49], [0.51]])
    status = jb.detect(watch, np.full((2, 150, 1), 2.0), y).status
    assert (status == jb.Status.FAULT).any(1).tolist() == [False, True]


def test_drifts_and_actuators_and_what_is_not_worked_out(watch):
    drift, heat = (
        jb.detectable(watch, jb.Fault("T1", "drift")),
        jb.detectable(PLANT, "heat", method="observer"),
    )
    assert 0 < drift < 0.02 < heat < jb.detectable(PLANT, "heat", horizon=2) and drift.horizon > 20
    for options, says in (({"horizon": 3}, "are for windows"), ({"operating_range": 3}, "are for windows")):
        with pytest.raises(ValueError, match=says):
            jb.detectable(watch, "T1", **options)
    with pytest.raises(ValueError, match="no signal 'T9'"):
        jb.detectable(watch, "T9")
    with pytest.raises(ValueError, match="method must be joint or observer, not 'box'"):
        jb.detectable(PLANT, "T1", method="box")
    with pytest.raises(NotImplementedError, match=r"kind 'gain' is counted by jb\.study"):
        jb.detectable(watch, jb.Fault("T1", "gain", 0.1))
    with pytest.raises(NotImplementedError, match="certain models without tolerances"):
        jb.detectable(
            jb.LinearSystem([["0.5"]], None, [[1]], noise="0.1", tolerance="0.1"), "y1", method="observer"
        )


@pytest.mark.long(by_day="test_a_fault_of_that_size_is_seen_by_then_whatever_the_errors")
def test_a_study_of_an_observer_counts_no_false_alarm_and_every_sample_of_the_fault(watch, least):
    size = float(least)
    found = jb.study(
        PLANT,
        ["T1:bias"],
        8,
        0,
        watch,
        samples=50,
        sizes=[0.05 * size, 1.01 * size],
        onset=30,
        at="vertices",
    )
    table = found.to_pandas()
    assert found.false_alarms == (0, 8 * 30) and found.settings["method"] == "observer"
    assert table["share"].tolist()[1] == 1 and table["delay_90"].tolist()[1] <= least.horizon
    assert table["windows"].tolist() == [4 * 20] * 2


def test_verbs_that_need_windows_say_so(watch):
    u, y = np.full((20, 1), 2.0), np.full((20, 2), 0.0)
    res = jb.detect(watch, u, y + [20, -3])
    for work, kind, says in (
        (lambda: jb.margins(watch, u, y), NotImplementedError, "margins are those of windows"),
        (
            lambda: jb.detect(watch, u, y, method="box"),
            ValueError,
            "takes neither method nor budget",
        ),
        (
            lambda: jb.study(PLANT, ["T1:bias"], 9, 0, watch, at="adversarial"),
            NotImplementedError,
            "an adversary needs a test by strips",
        ),
    ):
        with pytest.raises(kind, match=says):
            work()
    assert len(jb.plot(res.observation, y=res.y).axes) == 4 and jb.plot(res).axes
