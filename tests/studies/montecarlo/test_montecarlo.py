"""Studies: what is counted, that nothing healthy is, and that the counts do not depend on how the work was
done.
"""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from study_case import simple

import jaxbound as jb
from jaxbound.sets.floats.status import Status
from jaxbound.studies.montecarlo import kernel, montecarlo, recursion, scenarios

OPTIONS = dict(sizes=[0.1, 0.4, 5.0], samples=60)


@pytest.fixture(scope="module")
def found():
    """Return a study of one fault of a simple model, 10 000 scenarios: three blocks, the last not full."""
    return jb.study(simple(), "y1:bias", 10_000, 3, **OPTIONS)


def tallies(res):
    return [{name: x.tolist() for name, x in t.arrays().items()} for t in res.tallies]


def recordings(res, block=0):
    """Return the recordings of one block of a study of `simple`, with the onsets and sizes."""
    model, trial = res.model, res.trials[0]
    dtype = np.float64
    ground = scenarios.Ground(model, jb.parity_relations(model), res.samples, np.ones(1))
    room = ground.largest_room([trial], dtype)
    course = kernel.Course(res.samples, res.settings["hold"], res.at == "vertices")
    numbers = np.arange(block * kernel.BLOCK, (block + 1) * kernel.BLOCK, dtype=np.uint32)
    key = np.array(res.settings["key"][0], np.uint32)
    limits = np.array(res.settings["input range"])
    plant, act = recursion.plant_of(model, room, dtype), scenarios.act_of(trial, model, dtype)
    scene = kernel.Scene(plant, act, limits, None, key, course)
    u, y, onset = map(np.asarray, kernel.replay_block(scene, numbers))
    return u, y, onset, np.asarray(trial.sizes)[numbers % len(trial.sizes)]


def test_counts_are_those_of_detect_on_the_same_recordings(found):
    T, s, total = (
        found.samples,
        found.horizon,
        {name: np.zeros(3, int) for name in ("hits", "windows", "detected", "clean")},
    )
    for block in range(3):
        u, y, onset, size = recordings(found, block)
        fault = jb.detect(jb.parity_relations(found.model), u, y).status == Status.FAULT
        for i in range(min(kernel.BLOCK, 10_000 - block * kernel.BLOCK)):
            cell, window = found.trials[0].sizes.tolist().index(size[i]), np.arange(s, T)
            inside = window - s >= onset[i]
            total["hits"][cell] += fault[i, s:][inside].sum()
            total["windows"][cell] += inside.sum()
            total["detected"][cell] += fault[i, s:].any()
            total["clean"][cell] += (window < onset[i]).sum()
            assert not fault[i, : onset[i]].any()
    for name, expected in total.items():
        np.testing.assert_array_equal(getattr(found.tallies[0], name), expected)
    assert found.false_alarms == (0, total["clean"].sum())


def test_inputs_move_over_the_range_that_the_model_states(found):
    assert found.settings["input range"] == [[-1.0, 1.0]]
    moved = jb.study(simple().replace(ranges={"u1": (3, 7)}), "y1:bias", 3, 3, **OPTIONS)
    u = recordings(moved)[0]
    assert moved.settings["input range"] == [[3.0, 7.0]] and u.min() >= 3 and u.max() <= 7 and np.ptp(u) > 3.9
    assert jb.study(
        simple().replace(ranges={"u1": (3, 7)}), "y1:bias", 3, 3, input_range=(0, 1), **OPTIONS
    ).settings["input range"] == [[0, 1]]
    still = jb.study(simple().replace(ranges={"u1": (3, 3)}), "y1:bias", 3, 3, **OPTIONS)
    assert still.settings["input range"] == [[-1.0, 1.0]], "of an input that never moved nothing is known"


def test_recordings_hold_the_fault_and_nothing_else(found):
    u, y, onset, size = recordings(found)
    assert (
        len(np.unique(u)) > 5000
        and (abs(u) <= 1).all()
        and (u[:, :20] == u[:, :1]).all()
        and (u[:, 20] != u[:, 19]).all()
    )
    assert onset.min() == 15 and onset.max() == 29
    state, within = np.zeros(len(y)), True
    for k in range(
        60
        # an independent recursion: what y is beyond it lies in the bounds, shifted by the size from the onset
        # on
    ):
        error = y[:, k, 0] - state - np.where(k >= onset, size, 0)
        within &= bool((abs(error) <= 0.1 + 0.005 * abs(state) + 1e-12).all())
        state = 0.8 * state + u[:, k, 0]
    assert within


def test_shares_grow_with_the_size_up_to_the_guaranteed_one(found):
    frame = found.to_pandas()
    sure = float(found.trials[0].guaranteed)
    assert 0.4 < sure < 5 and frame.share.is_monotonic_increasing and frame.rate.is_monotonic_increasing
    assert frame.rate.iloc[-1] == 1 and frame.delay_90.iloc[-1] <= found.horizon
    assert ((frame.share_lo <= frame.share) & (frame.share <= frame.share_hi)).all()
    assert frame.scenarios.tolist() == [3334, 3333, 3333]


def test_half_of_all_and_nine_tenths_have_their_delays(found):
    spread = np.array([[6.0, 1, 2, 1], [4, 3, 1, 0], [4, 1, 0, 0]])  # of ten, the last of them also missed
    tally = copy(found.tallies[0])
    tally.delays, tally.scenarios, tally.detected = spread, np.full(3, 10), spread.sum(1)
    frame = replace(found, tallies=(tally,)).to_pandas()
    assert frame.delay_median.tolist() == [0, 1, 1] and frame.delay_90.tolist() == [2, np.inf, np.inf]


def test_delays_add_up_to_all_scenarios(found):
    delays = found.delays()
    assert delays.scenarios.sum() == 10_000 and (delays.delay.dropna() >= 0).all()
    tally = found.tallies[0]
    np.testing.assert_array_equal(tally.delays.sum(1), tally.detected)


def test_longer_studies_begin_with_the_same_scenarios(found):
    short = jb.study(simple(), "y1:bias", 4096, 3, **OPTIONS)
    assert short.tallies[0].detected.sum() < found.tallies[0].detected.sum()
    again = jb.study(simple(), "y1:bias", 10_000, 3, **OPTIONS)
    assert tallies(again) == tallies(found)
    assert tallies(jb.study(simple(), "y1:bias", 10_000, 4, **OPTIONS)) != tallies(found)


def test_an_interrupted_study_goes_on_and_ends_with_the_same_counts(found, tmp_path, monkeypatch):
    monkeypatch.setattr(montecarlo, "EVERY", 0.0)

    def stop(share):
        if share > 0.3:
            raise KeyboardInterrupt

    run = lambda n=10_000, **more: jb.study(
        simple(), "y1:bias", n, 3, out=tmp_path / "kept", **OPTIONS, **more
    )
    with pytest.raises(KeyboardInterrupt, match="1 of 3 blocks of scenarios are kept"):
        run(progress=stop)
    shares = []
    assert tallies(run(progress=shares.append)) == tallies(found)
    assert shares == [2 / 3, 1]
    assert tallies(run()) == tallies(found)
    with pytest.raises(
        ValueError, match="study.npz is of another n: choose another place, or delete it to begin anew"
    ):
        run(n=9_000)
    with (
        monkeypatch.context() as patch,
        pytest.raises(ValueError, match="study.npz is of another version of jaxbound: choose"),
    ):
        patch.setattr(jb, "__version__", "0.0.1")
        run()
    engine = (
        montecarlo._engine
    )  # a block is larger where there are more devices: counts of another machine cannot be gone on with
    with (
        monkeypatch.context() as patch,
        pytest.raises(ValueError, match="study.npz is of another block: choose"),
    ):
        patch.setattr(montecarlo, "_engine", lambda *made: (engine(*made)[0], 64))
        run()
    (tmp_path / "kept" / "study.npz").write_bytes(b"PK")
    with pytest.raises(ValueError, match="is damaged"):
        run()


def test_rows_of_single_scenarios_say_what_the_counts_say(found, tmp_path, monkeypatch):
    import pandas as pd

    monkeypatch.setattr(montecarlo, "PART", 2)
    res = jb.study(simple(), "y1:bias", 10_000, 3, out=tmp_path, rows=True, **OPTIONS)
    rows = pd.read_parquet(tmp_path / "scenarios")
    assert len(list((tmp_path / "scenarios").iterdir())) == 2
    assert (
        rows.scenario.tolist() == list(range(10_000))
        and rows.fault_windows.sum() == res.tallies[0].hits.sum()
    )
    assert rows.groupby("size").delay.count().tolist() == found.tallies[0].detected.tolist()


@pytest.mark.parametrize(
    ("sentence", "options"),
    [
        ("the model has", dict(faults="y7:bias")),
        ("finite numbers", dict(sizes=[np.nan])),
        ("a tolerance fault needs an output", dict(faults="u1:tolerance")),
        ("n must be a whole number >= 1", dict(n=0)),
        ("at least the number of faults", dict(n=1, faults=["y1:bias", "u1:bias"])),
        ("at must be one of", dict(at="corners")),
        ("must start at a sample", dict(onset=(50, 80))),
        ("has no window", dict(samples=1)),
        ("sizes speak of y2:bias", dict(sizes={"y2:bias": [1]})),
        ("inputs must have shape", dict(inputs=np.zeros(5))),
        ("must not be missing", dict(inputs=np.full((60, 1), np.nan))),
        ("lo <= hi", dict(input_range=(1, -1))),
        ("needs a pair", dict(input_range=(1, 2, 3))),
        ("confidence must be between", dict(confidence=95)),
    ],
)
def test_bad_input_is_refused_in_a_sentence(sentence, options):
    with pytest.raises(ValueError, match=sentence):
        jb.study(**(dict(model=simple(), faults="y1:bias", n=10, key=0, samples=60) | options))


def test_relations_of_other_signals_and_things_that_are_none_are_refused():
    with pytest.raises(ValueError, match="other signals"):
        jb.study(simple(), "y1", 10, 0, jb.parity_relations(simple(outputs=["T"])))
    with pytest.raises(TypeError, match="needs relations"):
        jb.study(simple(), "y1", 10, 0, simple())
    with pytest.raises(NotImplementedError, match="adversary needs"):
        jb.study(simple(noise=0), "y1", 10, 0, at="adversarial")


def test_a_picture_shows_every_fault_with_its_guaranteed_size(found):
    fig = jb.plot(found)
    left, right = fig.axes
    assert left.get_title(loc="left") == "y1:bias" and len(right.lines) == 3
    assert any(
        line.get_xdata()[0] == found.trials[0].guaranteed
        for line in left.lines
        if len(set(line.get_xdata())) == 1
    )
