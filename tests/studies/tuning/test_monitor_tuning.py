"""Tuning a monitor: of a level that stays, readings within +-rho of it exist iff none are more than 2 rho
apart, so the smallest factor of each test is counted by hand.
"""

import json
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli.main import main

pytestmark = pytest.mark.compiled

RHO = Fraction(1, 10)
LEVEL = jb.LinearSystem([[1]], None, [[1]], noise=RHO, outputs="level", name="level")
JUMPS = {"name": "jumps", "horizon": 1, "factor": 2, "when": "mode == 1"}
MEANS = {"name": "lags", "lags": [0, 1, 3], "when": "otherwise"}
SLOW = {"name": "slow", "observer": "zonotope"}
BACK = {"jumps": (0, 1), "lags": (0, 1, 3)}


def day(rng, width):
    """Return a recording in mode 1, in mode 2, and in one that nobody knows."""
    level = 5 + width * rng.uniform(-1, 1, 30)
    return pd.DataFrame({"level": level, "mode": np.repeat([1.0, 2.0, np.nan], 10)})


def factor(frame, name):
    """Return the factor on RHO at which no window of a test, wholly in its mode, is refuted."""
    low = {"jumps": 0, "lags": 10}[name]
    apart = [np.ptp(frame.level[k - np.array(BACK[name])]) for k in range(low + max(BACK[name]), low + 10)]
    return max(apart) / 2 / float(RHO)


@pytest.fixture(scope="module")
def tuned():
    rng = np.random.default_rng(5)
    days = [day(rng, 0.3), day(rng, 0.2)]
    return days, jb.tune(jb.monitor(LEVEL, [JUMPS, MEANS]), days, days[0] + 1, safety=1.25)


@pytest.mark.parametrize("name", ["jumps", "lags"])
def test_each_test_gets_the_smallest_factor_of_its_windows_in_its_mode(tuned, name):
    days, found = tuned
    needs = [factor(frame, name) for frame in days]
    left_out = max(needs) / min(needs)
    assert float(found.factors[name]) == pytest.approx(max(needs) * left_out * 1.25, rel=2e-3)
    assert found.tests[name].factor == pytest.approx(left_out, rel=1e-6)


def test_no_healthy_sample_is_faulty_under_the_written_factors(tuned):
    days, found = tuned
    for frame in days:
        assert not jb.detect(jb.monitor(found.model), None, frame).counts["FAULT"]
    assert found.counts["FAULT"] == 0 and found.start == {"jumps": 2, "lags": 1}


def test_a_test_that_watches_nothing_keeps_its_factor(rng):
    frame = day(rng, 0.3)
    tests = [JUMPS, MEANS, {"name": "third", "horizon": 1, "factor": 3, "when": "mode == 3"}]
    found = jb.tune(jb.monitor(LEVEL, tests), [frame[:20]])
    assert found.factors["third"] == 3 and "third" not in found.tests
    assert any("'third' watches no healthy sample" in note for note in found.notes)


@pytest.mark.usefixtures("by_numpy")
def test_an_observer_gets_the_factor_at_which_it_follows_the_recording(rng):
    frame = day(rng, 0.3)
    found = jb.tune(jb.monitor(LEVEL, [SLOW]), frame, safety=1)
    faults = []
    for share in (1, Fraction(97, 100)):
        alone = jb.observer(LEVEL.replace(noise=RHO * found.factors["slow"] * share), "zonotope")
        faults.append(jb.detect(alone, None, frame).counts["FAULT"])
    assert faults[0] == 0 < faults[1]


@pytest.mark.parametrize("option", [{"bounds": "noise"}, {"weights": {"noise": 1}}, {"state": "x.npz"}])
def test_options_of_one_test_alone_are_refused(rng, option):
    with pytest.raises(ValueError, match="belongs to one test alone"):
        jb.tune(jb.monitor(LEVEL, [JUMPS]), day(rng, 0.3), **option)


def test_a_disturbance_that_a_factor_does_not_scale_is_refused(rng):
    pushed = jb.LinearSystem([[1]], None, [[1]], noise=RHO, disturbance=([[1]], [(0, 1)]), outputs="level")
    with pytest.raises(ValueError, match="test 'jumps': its factor widens the disturbance from -0.5 to 1.5"):
        jb.tune(jb.monitor(pushed, [JUMPS]), day(rng, 0.3))


def test_the_command_writes_the_factors_and_leaves_the_comments(tmp_path, rng, capsys):
    text = jb.models.modelfile.model_text(LEVEL.replace(tests=[JUMPS, MEANS]))
    text = text.replace("factor = 2\n", "factor = 2  # a guess\n")
    (tmp_path / "level.toml").write_text("# mine\n" + text)
    for name in ("a", "b"):
        day(rng, 0.3)[:20].to_csv(tmp_path / f"{name}.csv", index_label="time")
    files = [str(tmp_path / name) for name in ("level.toml", "a.csv", "b.csv")]
    out = tmp_path / "tuned.toml"
    assert main(["tune", *files, "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["healthy"]["FAULT"] == 0
    model = jb.load_model(out)
    assert {test.name: float(test.factor) for test in model.tests} == {
        name: one["factor"] for name, one in said["tests"].items()
    }
    assert out.read_text().startswith("# mine") and "# a guess" in out.read_text()
    assert main(["tune", *files, "--out", str(out), "--force"]) == 0
    assert "one factor a test" in capsys.readouterr().out
    assert main(["tune", *files, "--out", str(tmp_path / "no.toml"), "--bounds", "noise"]) == 2
    assert "--bounds is for one test" in capsys.readouterr().err and not (tmp_path / "no.toml").exists()
