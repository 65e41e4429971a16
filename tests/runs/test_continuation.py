"""A fleet whose recordings come in several files, one after the other: what is said is what is said of one
file.
"""

import itertools
import json
from hashlib import blake2b

import jax
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.runs.ask import Ask
from jaxbound.runs.fleet import FleetTest, Unit, detect_fleet

T, CUTS = 90, (0, 37, 40, 90)
START = pd.Timestamp("2026-03-01")


@pytest.fixture(scope="module")
def plant():
    """Return a model and T samples of it, of which y2 drifts from 45 on; with a missing sample at 38 and a
    gap behind 60.
    """
    m = jb.LinearSystem(
        [["0.9", "0.05"], [0, "0.9"]],
        [[0], ["0.1"]],
        [[1, 0], [0, 1]],
        noise="0.1",
        disturbance=([[1, 0], [0, 1]], "0.005"),
        dt=1,
        inputs="u1",
        outputs=["y1", "y2"],
    )
    rng, x, y = np.random.default_rng(5), np.zeros(2), np.zeros((T, 2))
    u = rng.uniform(0, 2, (T, 1)).round(3)
    for k in range(T):
        y[k], x = (
            x,
            np.array([0.9 * x[0] + 0.05 * x[1], 0.9 * x[1] + 0.1 * u[k, 0]]) + rng.uniform(-0.004, 0.004, 2),
        )
    y = (y + rng.uniform(-0.09, 0.09, y.shape)).round(6)
    y[45:, 1] += 0.02 * np.arange(T - 45)
    y[38, 0] = np.nan
    seconds = np.arange(T) + 7 * (np.arange(T) >= 60)
    return m, pd.DataFrame(
        {"time": START + pd.to_timedelta(seconds, "s"), "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]}
    )


def fleet(folder, tables, state=None, **how):
    """Write recordings, a file each, and return the UnitResults and Results of a fleet of them."""
    units, kept = [], {}
    for i, table in enumerate(tables):
        table.to_csv(folder / f"{i}.csv", index=False)
        units.append(Unit(f"unit {i}", folder / "plant.toml", folder / f"{i}.csv"))
    page = lambda unit, res, *about: kept.update({unit.name: (res, *about)}) or ""
    return list(detect_fleet(units, FleetTest(Ask(**how), state=state), page)), kept


@pytest.mark.parametrize(
    "how",
    [
        {"horizon": 3},
        {"method": "observer"},
        {"method": "observer", "options": {"restart": False}},
        {"method": "observer", "options": {"method": "joint", "window": 8}},
    ],
)
@pytest.mark.parametrize("units", [1, 3])
def test_recordings_in_several_files_are_judged_as_one(plant, tmp_path, how, units):
    model, table = plant
    jb.save_model(model, tmp_path / "plant.toml")
    tables = [table.assign(y1=table["y1"] + 0.001 * i) for i in range(units)]
    found: dict = {}
    for first, stop in zip(CUTS, CUTS[1:], strict=False):
        results, kept = fleet(
            tmp_path, [one.iloc[first:stop] for one in tables], state=tmp_path / "state", **how
        )
        assert not any(
            hint.startswith("the recording begins anew") for r in results for hint in r.summary.hints
        )
        for result in results:
            res, recording = kept[result.unit.name][:2]
            known = len(res.status) - (stop - first)
            assert (
                np.asarray(res.status)[:known] == jb.Status.MISSING
            ).all() and result.summary.counts == res.counts
            assert recording.label(known) == str(table["time"][first])
            found.setdefault(result.unit.name, []).append((res.status[known:], res.margin[known:]))
    jb.save_model(model, tmp_path / "plant.toml")
    _, whole = fleet(tmp_path, tables, **how)
    for name, parts in found.items():
        status, margin = (np.concatenate(x) for x in zip(*parts, strict=True))
        np.testing.assert_array_equal(status, whole[name][0].status)
        np.testing.assert_allclose(margin, whole[name][0].margin, rtol=1e-9, atol=1e-12)
        assert jb.Status.FAULT in status[45:]


def test_the_same_recording_again_is_judged_as_it_was_and_what_does_not_follow_begins_anew(plant, tmp_path):
    model, table = plant
    jb.save_model(model, tmp_path / "plant.toml")
    say = lambda first, stop: fleet(
        tmp_path, [table.iloc[first:stop]], method="observer", state=tmp_path / "state"
    )
    say(0, 30)
    (once,), _ = say(30, 60)
    (twice,), _ = say(30, 60)
    assert once.summary.plain() == twice.summary.plain() and once.summary.counts["FAULT"]
    (gap,), _ = say(60, 90)
    assert (
        any("which ended 8 s before its first sample" in hint for hint in gap.summary.hints)
        and gap.summary.found.samples == 30
    )
    (back,), _ = say(0, 30)
    assert any("s after its first sample" in hint for hint in back.summary.hints)
    jb.save_model(model.replace(noise="0.2"), tmp_path / "plant.toml")
    (other,), _ = say(30, 60)
    assert other.verdict == "not tested" and "is of another model" in other.summary.sentence


ALIKE = "泵仝丄", "泵唅下"
"""Names whose digests of 32 bits are one, with a readable part that is nothing for either."""


def test_each_unit_has_a_file_of_its_own_that_names_it(plant, tmp_path):
    """Two of 21 575 units shared a file: one was joined behind the samples of the other, a healthy FAULT."""
    model, table = plant
    state = tmp_path / "state"
    jb.save_model(model, tmp_path / "plant.toml")

    def say(first, stop, *names):
        table.iloc[first:stop].to_csv(tmp_path / "run.csv", index=False)
        units = [Unit(name, tmp_path / "plant.toml", tmp_path / "run.csv") for name in names]
        return list(detect_fleet(units, FleetTest(Ask(horizon=3), state=state)))

    say(0, 10, *ALIKE)
    files = sorted(state.iterdir())
    assert len(files) == 2
    files[0].write_bytes(files[1].read_bytes())
    sentences = " ".join(r.summary.sentence for r in say(10, 20, *ALIKE) if r.verdict == "not tested")
    assert f"{files[0]} is of unit" in sentences and "delete it to begin anew" in sentences
    former = state / f"_-{blake2b(ALIKE[0].encode(), digest_size=4).hexdigest()}.npz"
    files[1].rename(former)
    files[0].unlink()
    for found in say(10, 20, *ALIKE):
        assert (
            found.verdict == "not tested" and f"{former} was written by an earlier" in found.summary.sentence
        )
    former.unlink()
    assert {found.verdict for found in say(10, 20, *ALIKE)} == {"no fault"}


def test_what_rests_on_a_recording_before_says_so(plant, tmp_path, capsys, monkeypatch):
    model, table = plant
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    jb.save_model(model, "plant.toml")
    (tmp_path / "units.csv").write_text("unit,model,recording\npump,plant.toml,run.csv\n")
    for first, stop, code in ((0, 48, 0), (48, 60, 1)):
        table.iloc[first:stop].to_csv("run.csv", index=False)
        more = ("--method", "observer", "--state", "state", "--out", f"out{first}", "--json")
        assert main.main(["fleet", "units.csv", *more]) == code
    (unit,) = json.loads(capsys.readouterr().out.split("\n}\n")[1] + "\n}\n")["units"]
    assert unit["verdict"] == "fault" and unit["first_alarm"].startswith("2026-03-01")
    assert "a recording before" in next((tmp_path / "out48/units").iterdir()).read_text()


def test_a_certificate_of_an_observer_that_goes_on_speaks_of_samples_that_are_there(plant, tmp_path):
    model, table = plant
    jb.save_model(model, tmp_path / "plant.toml")
    fleet(tmp_path, [table.iloc[:48]], method="observer", state=tmp_path / "state")
    _, kept = fleet(tmp_path, [table.iloc[48:60]], method="observer", state=tmp_path / "state")
    res = kept["unit 0"][0]
    at = int(np.flatnonzero(res.status == jb.Status.FAULT)[0])
    assert (res.observation.status[3:] == res.status[3:]).all()
    try:
        assert res.explain(at).proves == jb.Status.FAULT
    except NotImplementedError as e:
        assert "rests on all since a recording before" in str(e)


@pytest.mark.parametrize("how", [{"horizon": 3}, {"method": "observer"}])
@pytest.mark.parametrize("stored", ["csv", "parquet"])
def test_a_recording_without_times_begins_anew(plant, tmp_path, how, stored):
    """Nothing says that it follows: a healthy recording of another day was FAULT behind it."""
    model, table = plant
    jb.save_model(model, tmp_path / "plant.toml")
    table = table.drop(columns="time")
    for first, stop in ((0, 20), (30, 45)):
        path = tmp_path / f"run.{stored}"
        part = table.iloc[first:stop]
        part.to_csv(path, index=False) if stored == "csv" else part.to_parquet(path, index=False)
        (found,) = detect_fleet(
            [Unit("unit", tmp_path / "plant.toml", path)], FleetTest(Ask(**how), state=tmp_path / "state")
        )
        hint = (
            "the recording begins anew, as if there were none before, which has no times: nobody knows "
            "whether it follows"
        )
        assert (hint in found.summary.hints) == (first > 0)
    assert found.summary.found.samples == 15 and found.summary.counts["FAULT"] == 0


def test_units_are_read_in_the_precision_of_the_caller(plant, tmp_path):
    """A thread reads them: workers of a fleet, whose precision is that of a context, took another one."""
    model, table = plant
    jb.save_model(model, tmp_path / "plant.toml")
    with jax.enable_x64(False):
        _, kept = fleet(tmp_path, [table.iloc[:30]], method="observer")
    assert kept["unit 0"][0].relations.plant.dtype == np.float32


MEANS = jb.LinearSystem(
    [[0.5]], [[1]], [[1]], noise=0.3, dt=420, columns={"every": "7min", "where": "on > 0"}, horizon=2
)


@pytest.fixture(scope="module")
def seconds():
    """Return samples of MEANS at 10 s over midnight, with a fault, a sample that is lacking and a hole."""
    rng = np.random.default_rng(0)
    u, y = rng.uniform(-1, 1, 20), np.zeros(20)
    for k in range(1, 20):
        y[k] = 0.5 * y[k - 1] + u[k - 1]
    y[12:15] += 3
    table = pd.DataFrame({"time": pd.date_range("2026-03-01 22:58:30", periods=840, freq="10s"), "on": 1})
    table = table.assign(u1=np.repeat(u, 42), y1=np.repeat(y, 42))
    table.loc[690:694, "on"] = 0
    return table.drop(index=[70, *range(430, 433)]).reset_index(drop=True)


@pytest.mark.parametrize("stored", ["csv", "parquet"])
@pytest.mark.parametrize("cuts", [[400], [170, 172, 174, 300], [427, 430, 700], [2, 5, 60, 90]])
def test_an_interval_that_a_cut_splits_is_judged_as_in_one_file(tmp_path, seconds, stored, cuts):
    """It was missing on both sides. In recordings that hold no interval, or no window, nothing is lost."""
    jb.save_model(MEANS, tmp_path / "m.toml")
    path = tmp_path / f"run.{stored}"

    def say(first, stop, state):
        part, kept = seconds.iloc[first:stop], {}
        part.to_csv(path, index=False) if stored == "csv" else part.to_parquet(path, index=False)
        page = lambda unit, res, recording, *about: kept.update(res=res, recording=recording) or ""
        (found,) = detect_fleet([Unit("A", tmp_path / "m.toml", path)], FleetTest(state=state), page)
        if not kept:
            assert "too short" in found.summary.sentence or "one window needs 3" in found.summary.sentence
            return {}
        assert not any("begins anew" in hint for hint in found.summary.hints)
        res, recording = kept["res"], kept["recording"]
        fresh = range(res.known, recording.samples)
        return {recording.label(k): (int(res.status[k]), str(res.margin[k])) for k in fresh}

    whole = say(0, len(seconds), None)
    assert {status for status, _ in whole.values()} == {0, 1, 3}
    parts = {}
    for first, stop in itertools.pairwise([0, *cuts, len(seconds)]):
        once = say(first, stop, tmp_path / "state")
        assert once.keys().isdisjoint(parts)
        parts |= once
    assert say(first, stop, tmp_path / "state") == once  # the same again
    unsaid = [*whole][: len(whole) - len(parts)]
    assert len(unsaid) <= 2 and not any(whole.pop(time)[0] for time in unsaid)  # warming up
    assert parts == whole


def test_a_recording_of_before_takes_nothing_of_what_is_kept(tmp_path, seconds):
    jb.save_model(MEANS, tmp_path / "m.toml")
    unit = Unit("A", tmp_path / "m.toml", tmp_path / "run.csv")
    samples = []
    for first, stop in ((400, 650), (0, 300), (500, 800)):
        seconds.iloc[first:stop].to_csv(unit.recording, index=False)
        (alone,) = detect_fleet([unit])
        (found,) = detect_fleet([unit], FleetTest(state=tmp_path / "state"))
        samples.append(found.summary.found.samples - alone.summary.found.samples)
    assert samples[:2] == [0, 0]
    # two samples that were judged, two intervals that are not whole, between them those without a row
    assert samples[2] == 2 + 2 + (500 - 300) // 42
