"""A model is widened by healthy recordings: just enough, for every family, and not by a fault."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.studies.identification.adding import widen

T = 40
DATES = pd.date_range("2026-03-02 07:00", periods=T, freq="min")


def course(rng, error, size=0.1, at=()):
    """Return (u, y) of the plant below, errors within `size`; at these samples an error is added."""
    u, x = rng.uniform(-1, 1, (T, 1)), np.zeros(T)
    for k in range(T - 1):
        x[k + 1] = 0.5 * x[k] + u[k, 0]
    y = x[:, None] + rng.uniform(-size, size, (T, 1))
    y[list(at)] += error
    return u, y


def plant(**about):
    """Return a plant that is read from dated tables."""
    about = {"noise": [0.1], "horizon": 4, "dt": 60, "inputs": ["u"], "outputs": ["y"]} | about
    return jb.LinearSystem([["0.5"]], [[1]], [[1]], **about)


def table(u, y):
    """Return samples as a table with dates."""
    return pd.DataFrame({"u": u[:, 0], "y": y[:, 0], "mode": np.arange(T) < 30}, index=DATES)


def faults(model, day):
    """Return how many samples of a day a model's monitor refutes."""
    parts = day if isinstance(day, tuple) else (day,)
    return jb.detect(jb.monitor(model), *parts).counts["FAULT"]


def test_a_day_that_is_held_changes_nothing(rng):
    model = plant(ranges={"u": (-1, 1)})
    widened = widen(model, table(*course(rng, 0)))
    assert widened.model is model and widened.factor == 1 and not widened.changed
    assert list(widened.rows()) == [("test: windows", "its bounds hold, and stay")]


def test_a_day_without_a_window_is_refused(rng):
    with pytest.raises(ValueError, match="recording 1: the recording has 4 samples, one window needs 5"):
        widen(plant(), table(*course(rng, 0))[:4])


def test_bounds_grow_just_enough_and_sizes_with_them(rng):
    day = table(*course(rng, 0.25, size=0.04, at=(20,)))
    model = plant(provenance={"noise": "fitted"})
    widened = widen(model, day)
    noise = widened.model.noise[0]
    relations = jb.parity_relations(widened.model)
    assert jb.detect(relations, day).counts["CONSISTENT"] == T - 4
    narrower = model.replace(noise=[noise * Fraction("0.998")])
    assert faults(narrower, day) and not faults(widened.model, day)
    assert widened.model.provenance["noise"] == "fitted; widened by recording 1"
    (jump,), (wider,) = widened.before[0].values(), widened.after[0].values()
    assert wider / jump == pytest.approx(widened.factor) == pytest.approx(float(noise) / 0.1)
    said = dict(widened.rows())
    assert "recording 1 at 2026-03-02 07:2" in said["test: windows"] and "now from" in said["cost: y"]


def test_a_window_on_the_boundary_is_proved_to_be_held():
    model = jb.LinearSystem([["0.5"]], None, [[1]], noise=["0.2"], horizon=1)
    day = None, [[1.0], [0.8], [0.3]]  # |y[k-1] - 2 y[k]| is 3 noise
    assert jb.detect(jb.parity_relations(model), *day).counts["UNDECIDED"]
    widened = widen(model, day)
    assert widened.factor == 1.001
    assert jb.detect(jb.parity_relations(widened.model), *day).counts["CONSISTENT"] == 2


def test_each_test_grows_by_its_own_factor(rng):
    tests = [{"name": "short", "horizon": 1}, {"name": "long", "horizon": 8, "factor": "1.5"}]
    model = plant(noise=[0.12], tests=tests)
    day = table(*course(rng, 0.45, at=(20,)))
    assert faults(model, day)
    widened = widen(model, day, most=20)
    factors = {test.name: float(test.factor) for test in widened.model.tests}
    assert not faults(widened.model, day) and widened.model.noise == model.noise
    assert factors == {
        name: pytest.approx(grown.factor * (1.5 if name == "long" else 1), rel=1e-3)
        for name, grown in widened.tests.items()
    }
    assert len(set(grown.factor for grown in widened.tests.values())) == 2


FAMILIES = {
    "lags": dict(tests=[{"name": "lags", "lags": [0, 1, 3]}]),
    "means": dict(averages={"y": {4: 0.05}}),
    "bounds that follow": dict(times={"y": "1 + abs(u)"}),
    "tolerance": dict(tolerance=[0.02]),
    "resolution": dict(resolution=[0.05]),
    "a disturbance off 0": dict(disturbance=([[1]], [(0, 0.02)])),
    "an uncertain parameter": dict(
        uncertainties=[jb.Uncertainty("a", A=[[1]], between=(-0.01, 0.01))], horizon=2
    ),
    "an observer": dict(tests=[{"name": "set", "observer": "zonotope", "latched": True}]),
    "numbers of its own": dict(tests=[{"name": "own", "horizon": 2, "model": {"horizon": 2}}]),
    "a condition": dict(
        tests=[{"name": "on", "when": "mode > 0", "horizon": 2}, {"name": "off", "when": "otherwise"}]
    ),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_that_a_file_states_is_widened(family, rng):
    model = plant(**FAMILIES[family])
    day = table(*course(rng, 0.35, size=0.04, at=(19, 20, 21)))
    assert faults(model, day), "else nothing is asked for"
    widened = widen(model, day, most=20)
    assert widened.factor > 1 and not faults(widened.model, day)
    assert widen(widened.model, day).model is widened.model


def test_an_unknown_mode_asks_no_test_for_wider_bounds(rng):
    tests = [{"name": "on", "when": "mode > 0"}, {"name": "off", "when": "otherwise", "factor": 20}]
    u, y = course(rng, 1.0, at=(20,))
    day = table(u, y).assign(mode=np.nan)
    widened = widen(plant(tests=tests), day)
    assert widened.factor == 1, "off explains it"
    tests[1]["factor"] = 1
    with pytest.raises(ValueError, match="refutes a sample whose mode is not known, whatever the mode"):
        widen(plant(tests=tests), day)


def test_fit_widens_a_model_and_takes_nothing_that_makes_a_new_one(rng):
    day = course(rng, 0.25, size=0.04, at=(20,))
    widened = jb.fit(day, add=plant())
    assert widened.factor == widen(plant(), day).factor > 1
    with pytest.raises(ValueError, match="needs bounds .* times as wide"):
        jb.fit(day, add=plant(), most=1.05)
    for about in ({"order": 1}, {"inputs": ["u"]}, {"recipe": "plant.toml"}):
        with pytest.raises(ValueError, match=f"add widens a model as it is: leave {next(iter(about))} out"):
            jb.fit(day, add=plant(), **about)
    with pytest.raises(ValueError, match="most is for add"):
        jb.fit(day, most=2)


def test_a_fault_is_refused_by_its_time_and_learnt_on_demand(rng):
    day = table(*course(rng, 2.0, at=(20,)))
    with pytest.raises(
        ValueError, match=r"recording 1 at 2026-03-02 07:2\d:00 \(sample 2\d\) needs bounds"
    ) as e:
        widen(plant(), day)
    most = float(str(e.value).rpartition("--most ")[2])
    assert 3 < widen(plant(), day, most=most).factor <= most


def test_the_region_of_training_grows_by_what_is_there(rng):
    u, y = course(rng, 0)
    low, high = -0.5, 2.0
    widened = widen(plant(ranges={"u": (low, high)}), [(u, y), (u, y)])
    assert widened.factor == 1 and widened.changed
    assert tuple(map(float, widened.model.ranges["u"])) == (u.min(), high)
    assert "-0.5 to 2, now -" in dict(widened.rows())["training: u"]


def test_bounds_for_an_observer_are_widened_for_it(rng, tmp_path):
    recipe = {"order": 1, "observer": "zonotope", "held_out": 0, "method": "least squares"}
    model = jb.fit(course(rng, 0, size=0.02), inputs=["u"], outputs=["y"], **recipe)
    jb.save_model(model, tmp_path / "plant.toml")
    day = course(rng, 0.15, size=0.02, at=(20,))
    assert jb.detect(jb.observer(model), *day).counts["FAULT"]
    widened = widen(tmp_path / "plant.toml", day, most=20)
    assert list(widened.tests) == ["observer zonotope"] and widened.factor > 1
    assert not jb.detect(jb.observer(widened.model), *day).counts["FAULT"]
    with pytest.raises(ValueError, match="for an observer: state it"):
        widen(jb.load_model(tmp_path / "plant.toml"), day)


@pytest.mark.parametrize("error", [0.0, 0.25])
def test_a_day_outside_of_training_is_held_by_the_bounds_that_it_then_has(rng, error):
    """Outside bounds are wider; the region grows only where bounds inside hold the day, too, or grow."""
    u, y = course(rng, error, size=0.04, at=(20,))
    model = plant(ranges={"u": (-0.01, 0.01)}, extrapolation=3)
    widened = widen(model, (u, y))
    assert not faults(widened.model, (u, y)) and widened.factor == 1
    assert widened.changed == (not error)
    tight = model.replace(extrapolation="1.02")
    if error:
        assert faults(tight, (u, y))
        widened = widen(tight, (u, y))
        assert widened.factor > 1 and widened.ranges and not faults(widened.model, (u, y))
