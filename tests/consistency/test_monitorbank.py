"""Banks of tests: one verdict of several, under conditions, also where nobody knows the mode."""

import itertools
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.consistency import monitor
from jaxbound.consistency.monitorbank import combined
from jaxbound.models.watched import NO, UNKNOWN, YES
from jaxbound.recordings.recording import Recording
from jaxbound.runs.judges import Carried
from jaxbound.runs.loop import Laps
from jaxbound.sets.floats.kernel import is_sparing
from jaxbound.sets.floats.status import Status

M, C, U, F = Status.MISSING, Status.CONSISTENT, Status.UNDECIDED, Status.FAULT
PLANT = jb.LinearSystem([["1/2"]], None, [[1]], noise="0.3")
MODES = ("mode == 1", "load > 0", "otherwise")
GAINS = {None: Fraction(1, 2), "mode == 1": Fraction(3, 4), "load > 0": Fraction(-1, 2)}
TESTS = (
    {"name": "always", "horizon": 1, "factor": 6},
    {"name": "first", "horizon": 1, "when": "mode == 1", "model": {"matrices": {"A": [["3/4"]]}}},
    {"name": "first, longer", "horizon": 2, "when": "mode == 1", "model": {"matrices": {"A": [["3/4"]]}}},
    {"name": "second", "horizon": 1, "when": "load > 0", "model": {"matrices": {"A": [["-1/2"]]}}},
    {"name": "rest", "horizon": 1, "when": "otherwise", "model": {"matrices": {"A": [[0]]}}},
)


def contradicts(test, y):
    """Say exactly whether no first state explains the samples of a window, of a plant with one state."""
    gain, rho = GAINS.get(test.get("when"), Fraction(0)), Fraction(3, 10) * test.get("factor", 1)
    least, most = Fraction(-(10**9)), Fraction(10**9)
    for power, sample in enumerate(map(Fraction, y)):
        g = gain**power
        if g:
            ends = sorted([(sample - rho) / g, (sample + rho) / g])
            least, most = max(least, ends[0]), min(most, ends[1])
        elif abs(sample) > rho:
            return True
    return least > most


def refuted(k, y, knowledge, tests):
    """Say whether every choice of modes that may hold at sample k is refuted by a window within what is known
    as at k.

    knowledge: (T, 2) of the two conditions, NaN where unknown.
    """
    alike = lambda a, b: np.array_equal(knowledge[a], knowledge[b], equal_nan=True)
    begin = max((j + 1 for j in range(k) if not alike(j, k)), default=0)
    choices = [[bool(x)] if x == x else [False, True] for x in knowledge[k]]
    for truth in itertools.product(*choices):
        holding = {None, *(text for text, holds in zip(MODES[:2], truth, strict=True) if holds)}
        if not any(truth):
            holding.add("otherwise")
        caught = False
        for test in tests:
            first, when = k - test["horizon"], test.get("when")
            # where a condition is known a window may lie across a change of the other one
            since = begin
            if when is None:
                since = 0
            elif when != "otherwise" and not np.isnan(knowledge[k][MODES.index(when)]):
                known = knowledge[:, MODES.index(when)]
                since = max((j + 1 for j in range(k) if known[j] != known[k]), default=0)
            elif when == "otherwise" and not np.isnan(knowledge[k]).any():
                rest = (knowledge == 0).all(1)
                since = max((j + 1 for j in range(k) if not rest[j]), default=0)
            if when in holding and first >= since:
                caught |= contradicts(test, y[first : k + 1])
        if not caught:
            return False
    return True


def recording(rng, samples):
    """Return (y, mode, load) of random modes that last some samples and are unknown for some."""
    lasting = lambda values: np.repeat(rng.choice(values, samples), rng.integers(1, 6, samples))[:samples]
    y = np.round(rng.normal(size=samples) * rng.choice([0.3, 1.0, 3.0], samples), 3)
    return y, lasting([1.0, 2.0, np.nan]), lasting([0.0, 1.0, np.nan])


def frame(y, mode, load):
    return pd.DataFrame({"y1": y, "mode": mode, "load": load})


def test_a_fault_is_claimed_where_every_mode_that_may_hold_is_refuted_exactly(rng):
    y, mode, load = recording(rng, 400)
    res = jb.detect(jb.monitor(PLANT, TESTS), None, frame(y, mode, load))
    knowledge = np.stack([np.where(np.isnan(x), np.nan, x == 1) for x in (mode, load)], 1)
    expected = [refuted(k, y, knowledge, TESTS) for k in range(len(y))]
    unknown = np.isnan(knowledge).any(1)
    assert np.array_equal(res.status == F, expected)
    assert (res.status[unknown] == F).sum() > 5, "the case has proofs of unknown modes"
    assert (res.status[~unknown] == F).sum() > 5


def test_nothing_is_claimed_of_an_unknown_mode_where_there_may_be_others(rng):
    y, mode, load = recording(rng, 200)
    some = [test for test in TESTS[1:] if test["when"] != "otherwise"]
    res = jb.detect(jb.monitor(PLANT, some), None, frame(y, mode, load))
    surely = (mode == 1) | (load > 0)
    assert (res.status == F).any()
    assert not (res.status[~surely] == F).any()


@pytest.mark.parametrize(
    ("statuses", "together"),
    [
        ([M, M], M),
        ([C, M], C),
        ([C, C], C),
        ([U, C], U),
        ([M, U], U),
        ([F, C], F),
        ([M, F], F),
    ],
)
def test_one_status_of_several(statuses, together):
    modes = np.zeros((1, 0), np.int8)
    found = combined(np.array([statuses], np.int8), np.array([[0.5, 0.25]]), (-1, -1), modes, False)
    assert found.status.tolist() == [together]


def test_the_proof_with_the_least_margin_speaks():
    statuses = np.array([[F, F, C], [C, F, C], [C, C, C], [M, M, M]], np.int8)
    margins = np.array([[-1, -2, -3], [-9, -1, 0], [0.5, 0.75, 0.25], [np.nan] * 3])
    found = combined(statuses, margins, (-1, -1, -1), np.zeros((4, 0), np.int8), False)
    assert found.by.tolist() == [1, 1, 2, -1]


def test_the_margin_of_an_unknown_mode_is_that_of_the_mode_that_fits_best():
    modes = np.array([[UNKNOWN, UNKNOWN], [YES, NO]], np.int8)
    statuses, margins = np.array([[F, F], [F, M]], np.int8), np.array([[-3.0, -1.0], [-2.0, np.nan]])
    assert combined(statuses, margins, (0, 1), modes, True).margin.tolist() == [-1.0, -2.0]


@pytest.fixture(scope="module")
def mixed():
    """Return a bank of windows, lags and an observer, under conditions of an input."""
    model = jb.LinearSystem([[0.9]], [[0.1]], [[1]], noise=0.1, inputs="pump", outputs="height")
    tests = [
        {"name": "short", "horizon": 2},
        {"name": "slow", "lags": [0, 1, 4], "factor": 1.5, "when": "pump > 0.5"},
        {"name": "state", "observer": "zonotope", "when": "otherwise"},
    ]
    return model, jb.monitor(model, tests)


def driven(rng, model, samples=120):
    """Return (u, y) with a sensor that jumps in the second half."""
    u = np.repeat(rng.integers(0, 2, samples // 10), 10).astype(float)[:, None]
    y = np.asarray(jb.simulate(model, u, int(rng.integers(2**31))).y).copy()
    y[samples // 2 :] += rng.choice([-0.5, 0, 0.5], (samples // 2, 1))
    return u, y


def test_each_test_judges_as_it_does_alone(mixed, rng):
    model, bank = mixed
    u, y = driven(rng, model)
    res = jb.detect(bank, u, y, margins="exact")
    alone = jb.detect(jb.parity_relations(model, 2), u, y, margins="exact")
    assert np.array_equal(res.statuses[:, 0], alone.status)
    assert np.array_equal(res.test_margins[:, 0], alone.margin, equal_nan=True)
    on = u[:, 0] > 0.5
    watched = {"slow": on, "state": ~on}
    edges = np.flatnonzero(np.diff(on)) + 1
    wider = jb.parity_relations(model.replace(noise=0.15), lags=(0, 1, 4))
    for i, one in ((1, wider), (2, jb.observer(model))):
        masked = np.where(watched[res.names[i]][:, None], y, np.nan)
        blind = np.where(watched[res.names[i]][:, None], u, np.nan)
        own = jb.detect(one, blind, masked, starts=edges, margins="exact")
        own_status = np.where(watched[res.names[i]], own.status, M)
        assert np.array_equal(res.statuses[:, i], own_status)
    assert (res.statuses == F).any(0).all(), "each test proves something"


def test_sample_by_sample_it_says_the_same(mixed, rng):
    model, bank = mixed
    u, y = driven(rng, model)
    whole = jb.detect(bank, u, y, margins="exact")
    mon = jb.Monitor(bank)
    state, verdicts = mon.init(), []
    for k in range(len(y)):
        state, verdict = mon.step(state, u[k], y[k])
        verdicts.append(verdict)
    assert np.array_equal([v.status for v in verdicts], whole.status)
    assert np.array_equal([v.by for v in verdicts], whole.by)
    assert np.array_equal([v.margin for v in verdicts], whole.margin, equal_nan=True)


def test_a_batch_is_judged_recording_by_recording(mixed, rng):
    model, bank = mixed
    u, y = zip(*(driven(rng, model) for _ in range(2)), strict=True)
    together = jb.detect(bank, np.stack(u), np.stack(y))
    for i in range(2):
        alone = jb.detect(bank, u[i], y[i])
        assert np.array_equal(together.status[i], alone.status)
        assert np.array_equal(together.by[i], alone.by)
    first = together.tests["slow"]
    assert first.counts["FAULT"] == (together.statuses[..., 1] == F).sum()


def test_a_recording_of_a_batch_has_no_gap_where_the_mode_of_another_changes(mixed):
    """The other one's pump starts just where the sensor of this one jumps."""
    model, bank = mixed
    u, y = np.zeros((2, 40, 1)), np.full((2, 40, 1), 0.05)
    u[1, 20:], y[0, 20:] = 1, 1.0
    together, alone = jb.detect(bank, u, y), jb.detect(bank, u[0], y[0])
    assert alone.status[20] == F and alone.test_at(20) == together.test_at((0, 20)) == "state"
    assert together.explain((0, 20)).factor == alone.explain(20).factor
    for name in ("since", "margin"):
        own = getattr(together.tests["state"].observation, name)
        np.testing.assert_array_equal(own[0], getattr(alone.tests["state"].observation, name))
    assert (together.tests["state"].observation.since[1, 20:] == -1).all()


def test_a_model_with_tests_and_a_monitor_are_told_which_call_takes_them():
    plant = PLANT.replace(tests=TESTS[:1])
    with pytest.raises(TypeError, match=r"Monitor\(jaxbound\.monitor\(model\)\)"):
        jb.Monitor(plant)
    with pytest.raises(TypeError, match=r"margins\(parity_relations\(model\), u, y\)"):
        jb.margins(plant, None, [[0.0], [0.0]])
    with pytest.raises(TypeError, match=r"parameters\(parity_relations\(model\), u, y\)"):
        jb.parameters(plant, None, [[0.0], [0.0]])
    with pytest.raises(TypeError, match=r"monitor\.parts\['always'\]"):
        jb.margins(jb.monitor(plant), None, [[0.0], [0.0]])


def test_in_parts_whoever_judges_which_it_is_compiled_at_once(monkeypatch):
    """NumPy judges the first samples of a stream: in parts the bytes would depend on who made how many."""
    asked = []
    monkeypatch.setattr(monitor, "first_in_numpy", lambda *about: asked.append(is_sparing()) or 0)
    bank, y = jb.monitor(PLANT, TESTS[:1]), np.zeros((6, 1))
    recording = Recording.of(bank.model, None, y)
    judge = Carried(bank, bank.init(), 4, 0, Laps({}))
    assert len(list(judge((0, recording)))) == 2 and asked == [False, False]
