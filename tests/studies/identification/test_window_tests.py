"""Windows chosen by recordings that are left out."""

import json
import re

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.identification import window_tests
from jaxbound.studies.identification.means import lowered
from jaxbound.studies.identification.window_tests import WindowChoice, best_test

FEW = (WindowChoice(4), WindowChoice(12), WindowChoice(12, average=4), WindowChoice(12, lags=(0, 1, 4, 12)))


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(window_tests, "WINDOWS", FEW)


def recorded(rng, T=90):
    u, true = rng.uniform(-1, 1, (T, 1)), np.zeros((T, 1))
    for k in range(1, T):
        true[k] = 0.8 * true[k - 1] + 0.5 * u[k - 1]
    return u, true + rng.uniform(-0.05, 0.05, (T, 1))


def test_the_test_that_sees_the_smallest_errors_is_taken_and_proved(rng):
    records = [recorded(rng), recorded(rng)]
    shares = []
    model = jb.fit(records, order=1, test="auto", method="least squares", progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1
    tests = model.check.tests
    assert [test.window for test in tests if test.window.average is None] == [FEW[0], FEW[1], FEW[3]]
    best = min(tests, key=lambda test: test.blindness)
    assert (model.horizon, model.lags) == (best.window.horizon, best.window.lags)
    assert bool(model.averages) == (best.window.average is not None)
    assert model.check.factor == pytest.approx(best.factor, rel=1e-3)
    assert model.check.smallest == pytest.approx(best.smallest, rel=1e-6)
    assert model.check.jump == pytest.approx(best.jump, rel=0.02)  # bounds are rounded up
    for record in records:
        counts = jb.detect(jb.parity_relations(model), *record).counts
        assert counts["FAULT"] == counts["UNDECIDED"] == 0


def test_windows_that_lack_samples_count_in_the_bounds_of_the_test_that_is_taken(rng):
    records = [recorded(rng), recorded(rng)]
    u, y = records[0]
    y[40], y[44] = y[40] + 0.5, np.nan
    model = jb.fit(records, order=1, test="auto", method="least squares")
    (best,) = [test for test in model.check.tests if test.blindness == best_test(model.check.tests).blindness]
    about = best.window.about | {"average": best.window.average}
    alone = jb.fit(records, order=1, method="least squares", **about)
    assert (model.A, model.noise, model.averages) == (alone.A, alone.noise, alone.averages)
    assert model.check.held_out == pytest.approx(alone.check.held_out)


def test_each_test_has_the_factor_of_a_fit_for_it(rng):
    records = [recorded(rng), recorded(rng)]
    tests = jb.fit(records, order=1, test="auto", method="least squares").check.tests
    for test in tests[:2]:
        alone = jb.fit(records, order=1, method="least squares", horizon=test.window.horizon)
        assert alone.check.factor == pytest.approx(test.factor, rel=1e-6)
        assert alone.check.steady == pytest.approx(test.steady, rel=0.02)


def test_windows_longer_than_a_recording_are_not_tried(rng):
    tests = jb.fit([recorded(rng, 40), recorded(rng, 11)], order=1, test="auto").check.tests
    assert best_test(tests).window.horizon <= 12
    short = jb.fit([recorded(rng, 11), recorded(rng, 11)], order=1, test="auto").check.tests
    assert [test.window for test in short] == [FEW[0]]


@pytest.mark.parametrize(
    "options, sentence",
    [
        (dict(test="best"), "test must be None or auto or bank, not 'best'"),
        (dict(horizon=9), "test = 'auto' chooses windows: leave horizon out, or test"),
        (dict(lags=[0, 5]), "test = 'auto' chooses windows: leave lags out, or test"),
        (dict(average=4), "test = 'auto' chooses windows: leave average out, or test"),
        (dict(observer="joint"), "test = 'auto' chooses windows: leave observer out, or test"),
        (dict(order=0), "a static model, order 0, is tested sample by sample: leave test out"),
    ],
)
def test_beside_another_choice_of_windows_it_is_refused(options, sentence, rng):
    with pytest.raises(ValueError, match=re.escape(sentence)):
        jb.fit(recorded(rng, 40), **dict(test="auto") | options)


def test_long_windows_of_which_hardly_one_is_complete_are_not_tried(rng):
    """Bounds that explain a few windows are far too small for the others."""
    u, y = recorded(rng, 400)
    y[:360:11] = np.nan
    model = jb.fit((u, y), order=1, test="auto", method="least squares")
    assert [test.window for test in model.check.tests] == [window_tests.WINDOWS[0]]


def test_the_command_shows_each_test_with_its_factor(rng, tmp_path, capsys):
    from jaxbound.cli.main import main

    files = []
    for name in ("a.csv", "b.csv"):
        u, y = recorded(rng)
        np.savetxt(tmp_path / name, np.hstack([u, y]), delimiter=",", header="u,y", comments="", fmt="%.6f")
        files.append(str(tmp_path / name))
    given = ["fit", *files, "--inputs", "u", "--outputs", "y", "--dt", "1", "--recipe"]
    given += ["order=1,test=auto,method=least squares", "--force", "--out", str(tmp_path / "m.toml")]
    assert main([*given, "--json"]) == 0
    tests = json.loads(capsys.readouterr().out)["tests"]
    assert [test["chosen"] for test in tests].count(True) == 1
    assert main(given) == 0
    shown = capsys.readouterr().out
    for test, words in zip(tests, ("5 samples", "13 samples"), strict=False):
        line = next(line for line in shown.splitlines() if line.startswith(f"test: {words} "))
        assert f"needs {test['factor']:.3g} times; by least squares;" in line
    assert shown.count(" chosen: needs") == 1


def test_bounds_of_means_are_the_same_whether_hard_windows_are_asked_first_or_all(rng):
    asks = rng.uniform(1, 40, (300, 2))  # a window is explained if its weighted bounds reach 1

    def explained(bounds):
        against = np.flatnonzero(asks @ bounds < 1)
        hard.extend(against[:1])
        return not len(against)

    def hard_ones(bounds):
        assert tuple(bounds) not in refused, "what was refused is asked again"
        holds = bool((asks[hard] @ bounds >= 1).all())
        if not holds:
            refused.add(tuple(bounds))
        return holds

    found, refused = [], set()
    for first in (None, hard_ones):
        hard = []
        found.append(lowered(np.array([0.6, 0.9]), explained, lambda share: None, first))
    np.testing.assert_array_equal(*found)
    assert (asks @ found[0]).min() == pytest.approx(1, rel=0.02) and len(hard) < 20
