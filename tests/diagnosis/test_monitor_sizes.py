"""Sizes that a monitor is sure to see: of two sensors of one state, y1 - y2 of a sample alone shows a bias
from twice both noises on, 0.4 times the factor of the test.
"""

import json
import math

import pytest

import jaxbound as jb
from jaxbound.cli.main import main

PAIR = jb.LinearSystem([["1/2"]], None, [[1], [1]], noise="0.1", name="pair")
ALWAYS = {"name": "always", "horizon": 0, "factor": 3}
FIRST = {"name": "first", "horizon": 0, "when": "mode == 1"}
REST = {"name": "rest", "horizon": 0, "factor": 2, "when": "otherwise"}
WIDE = {"name": "wide", "horizon": 0, "factor": 9, "when": "mode == 1"}
SLOW = {"name": "slow", "observer": "joint"}


@pytest.mark.parametrize(
    ("tests", "size", "test"),
    [
        ([ALWAYS], 1.2, "always"),
        ([ALWAYS, FIRST], 1.2, "always"),
        ([ALWAYS, FIRST, WIDE, REST], 0.8, "rest"),
        ([FIRST, REST], 0.8, "rest"),
        ([FIRST], math.inf, ""),
    ],
)
def test_what_is_seen_in_every_mode_is_guaranteed(tests, size, test):
    found = jb.detectable(jb.monitor(PAIR, tests), "y1")
    assert found == pytest.approx(size, rel=1e-6) and found.test == test
    expected = {one["name"]: 0.4 * one.get("factor", 1) for one in tests}
    assert dict(found.tests) == pytest.approx(expected, rel=1e-6)


def test_tests_whose_sizes_nobody_knows_do_not_count():
    found = jb.detectable(jb.monitor(PAIR, [SLOW, ALWAYS]), "y1")
    assert found.test == "always" and list(found.tests) == ["always"]
    with pytest.raises(NotImplementedError, match="counted by jb.study"):
        jb.detectable(jb.monitor(PAIR, [SLOW]), "y1")


@pytest.mark.parametrize("option", [{"horizon": 1}, {"lags": [0, 1]}, {"method": "observer"}])
def test_windows_of_one_test_are_refused(option):
    with pytest.raises(ValueError, match="a monitor has tests of its own"):
        jb.detectable(jb.monitor(PAIR, [ALWAYS]), "y1", **option)


def test_factors_that_no_test_has_are_refused():
    with pytest.raises(ValueError, match="factors on the noise of no output"):
        jb.detectable(jb.monitor(PAIR, [ALWAYS]), "y1", factors={"y1": 2})


def test_info_says_which_test_sees_an_error_first(tmp_path, capsys):
    file = tmp_path / "pair.toml"
    jb.save_model(PAIR.replace(tests=[ALWAYS, FIRST, REST]), file)
    assert main(["info", str(file), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["guaranteed_by_tests"]["y2"]
    assert said["size"] == pytest.approx(0.8) and said["test"] == "rest"
    assert main(["info", str(file)]) == 0
    assert "y1: 0.8, by rest (always 1.2, first 0.4, rest 0.8)" in capsys.readouterr().out
