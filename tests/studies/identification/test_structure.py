"""Order and delay by recordings that are left out: found again where they are known."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.identification.orders import acting_otherwise
from jaxbound.studies.identification.structure import chained, delayed

POLES = {1: [0.85], 2: [1.5, -0.7]}
ACTS = {1: [1.0], 2: [0.5, 0.3]}


def recorded(order, delay, rng, T=150):
    u = np.repeat(rng.uniform(-1, 1, T // 8 + 1), 8)[:T]
    acts, true = np.concatenate([np.zeros(delay - 1), u]), np.zeros(T)
    for k in range(T):
        for lag, (a, b) in enumerate(zip(POLES[order], ACTS[order], strict=True), 1):
            if k >= lag:
                true[k] += a * true[k - lag] + b * acts[k - lag]
    return u[:, None], (true + rng.uniform(-0.1, 0.1, T))[:, None]


@pytest.mark.parametrize("order, delay", [(1, 6), pytest.param(2, 1, marks=pytest.mark.long)])
def test_order_and_delay_are_found(order, delay, rng):
    records = [recorded(order, delay, rng) for _ in range(3)]
    model = jb.fit(records, order="auto", horizon=15, delay="auto", method="windows")
    assert (model.check.order, model.check.delay) == (order, delay)
    assert model.n == order + delay - 1
    assert all(jb.detect(jb.parity_relations(model), *r).counts["FAULT"] == 0 for r in records)


def test_inputs_that_act_sooner_or_later_than_the_model_has_it_are_told(rng):
    u, y = recorded(1, 1, rng)
    sooner = [(u[:-1], y[1:], np.array([], int))]  # the same sample
    assert acting_otherwise([(u, y, np.array([], int))], 2, 1, False) == []
    (said,) = acting_otherwise(sooner, 2, 1, False)
    assert "the same sample" in said and said.endswith("fit again with --recipe direct=true")
    assert acting_otherwise(sooner, 2, 1, True) == []
    (said,) = acting_otherwise([(*recorded(1, 4, rng), np.array([], int))], 1, 1, False)
    assert "4 samples later" in said and said.endswith("--recipe delay=4")
    (said,) = acting_otherwise([(u, y, np.array([], int))], 2, 5, False)
    assert "act 1 sample later" in said
    assert acting_otherwise([(u[:, :0], y, np.array([], int))], 2, 1, False) == []
    assert acting_otherwise([(u[:9], y[:9], np.array([], int))], 2, 1, False) == []


def test_inputs_wait_in_states_of_their_own(rng):
    A, B, C = [[0.5, 0.2], [0, 0.3]], [[1.0, 2], [0, 1]], [[1.0, 0]]
    late = chained({"A": A, "B": B, "C": C}, 4)
    u = rng.normal(size=(30, 2))
    (moved,) = delayed([(u, np.zeros((30, 1)), np.array([], int))], 4)
    assert np.isnan(moved[0][:3]).all() and np.array_equal(moved[0][3:], u[:-3])

    def outputs(model, u):
        A, B, C = (np.array(model[name], float) for name in "ABC")
        x, y = np.zeros(len(A)), []
        for now in u:
            y.append(C @ x)
            x = A @ x + B @ now
        return np.array(y)

    plain = outputs({"A": A, "B": B, "C": C}, np.nan_to_num(moved[0]))
    np.testing.assert_allclose(outputs(late, u), plain, atol=1e-12)
    assert chained({"A": A, "B": B, "C": C}, 1)["A"] is A


def test_inputs_before_a_gap_do_not_act_behind_it():
    u, y = np.arange(6.0)[:, None], np.zeros((6, 1))
    (moved,) = delayed([(u, y, np.array([3]))], 3)
    np.testing.assert_array_equal(moved[0][:, 0], [np.nan, np.nan, 0, np.nan, np.nan, 3])


@pytest.mark.parametrize(
    "options, sentence",
    [
        (dict(delay=0), "delay must be a whole number >= 1, or auto, not 0"),
        (dict(order="best"), "order must be a whole number >= 0, or auto, not 'best'"),
        (dict(delay=2, direct=True), "direct inputs act at once"),
        (dict(order="auto", horizon=1), "horizon must be a whole number above the order"),
    ],
)
def test_what_cannot_be_chosen_is_refused(options, sentence, rng):
    with pytest.raises(ValueError, match=sentence):
        jb.fit(recorded(1, 1, rng, 40), **options)


def test_of_unseen_days_fewer_have_a_false_alarm_than_the_promise():
    from benchmarks.tomorrow import judged

    found = judged("building", 3, 7, 6, method="least squares", horizon=15)
    assert found["days with an alarm"] <= 1 / 4 and found["worst"] <= 1 < 2 * found["worst"]
    assert found["bias"] > found["healthy"] and found["loss"] > found["healthy"]


@pytest.mark.long(by_day="test_of_unseen_days_fewer_have_a_false_alarm_than_the_promise")
@pytest.mark.parametrize("count, plants", [(2, 4), (3, 2), (5, 2), (8, 2)])
def test_so_many_days_keep_their_promise(count, plants):
    """Fits without an option, and the same with bounds half as wide, which keep none."""
    from benchmarks.tomorrow import JUDGED, fitted

    alarms = []
    for plant in list(JUDGED)[:plants]:
        model, day, _ = fitted(plant, count, 100 * count)
        tests = [dataclasses.replace(test, factor=test.factor / 2) for test in model.tests]
        found = [jb.detect(one, *day).status for one in (model, model.replace(tests=tests))]
        alarms.append([(status == jb.Status.FAULT).any(1).mean() for status in found])
    (kept, narrow), error = np.mean(alarms, 0), np.std(alarms, 0, ddof=1)[0] / np.sqrt(len(alarms))
    assert kept <= 1 / (count + 1) + 2 * error < narrow


def test_sentences_say_an_option_once():
    """In Python it is a field of the same name."""
    package = Path(jb.__file__).parent
    twice = re.compile(r"--(?:[a-z]+ (?=\w+=))?(\w+)[= ][^ ,]+, \"?\s*f?\"?\1=")
    assert twice.search("--recipe order=auto, order='auto'") and twice.search("--most 5, most=5")
    assert [path.name for path in package.rglob("*.py") if twice.search(path.read_text())] == []
