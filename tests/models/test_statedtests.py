"""Tests that a model states: read, refused and written again, and the models that they rest on."""

import re
from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.diagnosis.hints import outgrown_by
from jaxbound.models.modelfile import changed_text, load_model, model_text
from jaxbound.models.testmodels import model_of

PLANT = """
dt = 0.5
horizon = 4
[[inputs]]
name = "pump"
[[outputs]]
name = "height"
noise = 0.1
tolerance = 0.02
[[disturbances]]
bound = [0, 0.2]
[matrices]
A = [[0.9]]
B = [[0.1]]
C = [[1]]
G = [[1]]
"""
TESTS = """
[[test]]
name = "short"
[[test]]
name = "slow"
lags = [0, 1, 4]
factor = 1.5
when = "pump > 0.5"
[[test]]
name = "state"
observer = "joint"
latched = true
window = 16
when = "otherwise"
[test.model.matrices]
A = [["1/3"]]
[[test.model.outputs]]
name = "height"
noise = 0.25
"""


@pytest.fixture
def load(tmp_path):
    """Return a function that loads a model from the text of a file."""

    def loaded(text):
        path = tmp_path / "m.toml"
        path.write_text(text)
        return load_model(path)

    return loaded


def test_tests_of_a_file_read_back_as_they_are_written(load):
    model = load(PLANT + TESTS)
    assert [test.name for test in model.tests] == ["short", "slow", "state"]
    assert load(model_text(model)) == model
    assert model != model.replace(tests=None)


def test_other_bounds_keep_the_tests_of_a_file_and_its_comments():
    text = PLANT + "# why\n" + TESTS
    model = load_of(text)
    changed = changed_text(text, model.replace(noise=0.2))
    assert "# why" in changed
    assert load_of(changed) == model.replace(noise=0.2)


def load_of(text):
    from jaxbound.models.modelfile import _parsed

    return _parsed(text, None)


def test_a_factor_widens_all_bounds_but_the_resolution(load):
    model = load(PLANT.replace("noise = 0.1", "noise = 0.1\nresolution = 0.01") + TESTS)
    wide = model_of(model, model.tests[1])
    assert wide.noise == (Fraction("0.15"),)
    assert wide.tolerance == (Fraction("0.03"),)
    assert wide.disturbance == ((Fraction("-0.05"), Fraction("0.25")),)
    assert wide.resolution == model.resolution
    assert wide.lags == (0, 1, 4)


def test_a_test_has_numbers_of_its_own_and_the_rest_of_the_file(load):
    model = load(PLANT + TESTS)
    own = model_of(model, model.tests[2])
    assert own.A == ((Fraction(1, 3),),)
    assert own.B == model.B
    assert own.noise == (Fraction("0.25"),)
    assert own.tolerance == model.tolerance
    assert own.tests == ()


@pytest.mark.parametrize(
    ("tests", "sentence"),
    [
        ('[[test]]\nname = "a"\nhorzon = 3', "'horzon'; did you mean 'horizon'"),
        ("[[test]]\nhorizon = 3", "number 1 of test needs a name"),
        ('[[test]]\nname = "a"\n[[test]]\nname = "a"', "two tests are called 'a'"),
        ('[[test]]\nname = "a"\nhorizon = 3\nlags = [0, 1]', "has horizon and lags"),
        ('[[test]]\nname = "a"\nlags = [1, 2]', "0 among them"),
        ('[[test]]\nname = "a"\nfactor = 0', "factor of test 'a' must be above 0"),
        ('[[test]]\nname = "a"\nwindow = 8', "window of test 'a' is for an observer"),
        ('[[test]]\nname = "a"\nwhen = "pump = 1"', "one = is no comparison"),
        ('[[test]]\nname = "a"\nwhen = "otherwise"', "no other test has a condition"),
        ("[[tets]]\nname = 3", "did you mean 'test'"),
    ],
)
def test_what_is_no_test_is_refused_in_a_sentence(load, tests, sentence):
    with pytest.raises(ValueError, match=sentence):
        load(PLANT + tests)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"dt": 2}, "has dt 2.0, the file 0.5"),
        ({"outputs": [{"name": "level"}]}, "outputs has no 'level'"),
        ({"where": "pump > 0"}, "where is for the whole file"),
        ({"matrices": {"Z": [[1]]}}, "unknown field 'Z'"),
    ],
)
def test_a_model_of_other_samples_is_refused(load, changes, sentence):
    model = load(PLANT).replace(tests=[{"name": "a", "model": changes}])
    with pytest.raises(ValueError, match=f"the model of test 'a'.*{sentence}|{sentence}"):
        model_of(model, model.tests[0])


def test_numbers_given_in_python_are_their_shortest_decimals(load):
    stated = {"name": "a", "factor": 1.1, "model": {"outputs": [{"name": "height", "noise": 0.3}]}}
    model = load(PLANT).replace(tests=[stated])
    assert model_of(model, model.tests[0]).noise == (Fraction("0.33"),)
    assert load_of(model_text(model)) == model


@pytest.mark.parametrize("window", [{"horizon": 3}, {"lags": [0, 1, 3]}])
def test_a_monitor_of_a_model_without_tests_is_its_windows(window, rng):
    model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, **window)
    y = rng.uniform(-0.2, 0.2, (12, 1))
    alone, res = jb.detect(jb.parity_relations(model), None, y), jb.detect(jb.monitor(model), None, y)
    np.testing.assert_array_equal(res.status, alone.status)
    np.testing.assert_array_equal(res.margin, alone.margin)
    with pytest.raises(ValueError, match="a monitor needs tests"):
        jb.monitor(model, [])


def test_a_monitor_of_a_model_that_states_nothing_sees_what_lasts(rng):
    """Windows of two samples see no error of .5 that lasts; the lags beside them do, whatever the noise."""
    model = jb.LinearSystem([["0.9"]], [["0.1"]], [[1]], noise=0.1)
    bank, lags = jb.monitor(model), jb.suggest_lags(model)
    assert [test.name for test in bank.plant.tests] == ["windows", "lags"]
    assert bank.plant.tests[1].lags == tuple(lags)
    y = 1.2 * lags.sizes[lags]["y1"] + rng.uniform(-0.05, 0.05, (40, 1))
    res = jb.detect(bank, np.zeros((40, 1)), y)
    assert res.status[-1] == jb.Status.FAULT and res.status[1] != jb.Status.MISSING
    assert jb.detect(jb.parity_relations(model), np.zeros((40, 1)), y).counts["FAULT"] == 0
    assert "lags 0, 1, 2" in repr(bank)


@pytest.mark.parametrize(
    "bounds, names",
    [
        ({"tolerance": 0.01}, ["windows", "long"]),
        ({"horizon": 4}, ["windows"]),
    ],
)
def test_what_nothing_says_is_watched_by_longer_windows(bounds, names):
    model = jb.LinearSystem([["0.9"]], [["0.1"]], [[1]], noise=0.1, **bounds)
    assert [test.name for test in jb.monitor(model).plant.tests] == names


OTHER = PLANT.replace("0.9", "0.8").replace("noise = 0.1", "noise = 0.3")


def test_a_test_takes_the_model_of_another_file_beside_its_own(load, tmp_path):
    """It is the model of that file, and goes with what is saved: the other file is not asked again."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/other.toml").write_text(OTHER)
    model = load(PLANT + '[[test]]\nname = "a"\nmodel = "sub/other.toml"\nfactor = 2\n')
    own = model_of(model, model.tests[0])
    assert own.A == ((Fraction("0.8"),),) and own.noise == (Fraction("0.6"),)
    assert own.horizon == 4 and own.tolerance == (Fraction("0.04"),)
    text = model_text(model)
    assert "other.toml" not in text and load_of(text) == model
    written = (tmp_path / "m.toml").read_text()
    assert load_of(changed_text(written, model)) == model, "it may be written into another folder"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            OTHER.replace('"pump"', '"valve"'),
            "other.toml has inputs ('valve',), this file ('pump',): all tests",
        ),
        (OTHER.replace("dt = 0.5", "dt = 2"), "other.toml has dt 2.0, this file 0.5: all tests"),
        (OTHER.replace("dt = 0.5", 'dt = 0.5\nevery = "500ms"'), "other.toml has columns {'every': '500ms'}"),
        (OTHER + '[[test]]\nname = "b"\n', "states tests of its own: name a file with one model"),
        (OTHER + '[[test]]\nname = "b"\nmodel = "m.toml"\n', "here one model is needed"),
        (OTHER.replace("[[disturbances]]\nbound = [0, 0.2]", "").replace("G = [[1]]", ""), "leaves out what"),
        (None, "there is no model file"),
    ],
)
def test_another_file_of_other_signals_is_refused_in_one_sentence(load, tmp_path, text, sentence):
    if text is not None:
        (tmp_path / "other.toml").write_text(text)
    with pytest.raises(ValueError, match=f"model of test 'a': .*{re.escape(sentence)}"):
        load(PLANT + '[[test]]\nname = "a"\nmodel = "other.toml"\n')


def test_lags_beyond_the_windows_that_bounds_were_fitted_to_are_said():
    """As longer windows are; a test that states bounds has those of its own windows."""
    tests = [{"name": "far", "lags": [0, 4]}, {"name": "long", "horizon": 4}]
    tests += [{**test, "name": f"own {test['name']}", "factor": 1.5} for test in tests]
    how = dict(dt=1, noise=0.1, provenance={"noise": "fitted to 3 recordings"}, tests=tests)
    for window, outgrown in (({"horizon": 1}, ["far", "long"]), ({"lags": [0, 2]}, ["far", "long"])):
        bank = jb.monitor(jb.LinearSystem([[0.5]], None, [[1]], **how, **window))
        assert [name for name in bank.parts if outgrown_by(bank, name)] == outgrown
