"""Several tests from one fit: each earns its place, and each is the fit that it would be alone."""

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.models.testmodels import model_of
from jaxbound.studies.identification import bank, disturbances, window_tests
from jaxbound.studies.identification.bank import earned
from jaxbound.studies.identification.bounds import rounded_up
from jaxbound.studies.identification.following import WEIGHTS
from jaxbound.studies.identification.trial import factor_of, largest_of
from jaxbound.studies.identification.window_tests import JudgedTest, WindowChoice

SPANS = {"y1": 10.0}


def judged(horizon, jump, steady, blindness):
    sizes = {"y1": jump}, {"y1": steady}
    return JudgedTest(WindowChoice(horizon), "windows", 1.0, {}, {}, *sizes, blindness)


def test_a_test_that_sees_clearly_smaller_errors_earns_its_place():
    short, long = judged(15, 1.0, 9.0, 2.0), judged(60, 3.0, 7.0, 1.0)
    assert earned([short, long], 3, SPANS) == (long, short)


def test_a_test_that_sees_hardly_smaller_errors_does_not():
    best, other = judged(15, 1.0, 9.0, 1.0), judged(60, 0.81, 7.3, 2.0)
    assert earned([best, other], 3, SPANS) == (best,)


def test_a_test_that_sees_what_no_other_sees_earns_its_place():
    blind, seeing = judged(15, 1.0, np.inf, 1.0), judged(60, 4.0, 7.0, 2.0)
    assert earned([blind, seeing], 3, SPANS) == (blind, seeing)


def test_an_observer_earns_its_place_by_a_ramp_and_stands_behind_windows():
    short = judged(15, 1.0, 9.0, 1.0)._replace(ramp={"y1": 8.0})
    sizes = {"y1": 2.0}, {"y1": 8.0}
    watching = JudgedTest(
        WindowChoice(0, observer="joint"), "windows", 1.0, {}, {}, *sizes, np.inf, {"y1": 5.0}
    )
    assert earned([watching, short], 3, SPANS) == (short, watching)
    assert earned([watching._replace(ramp={"y1": 7.0}), short], 3, SPANS) == (short,)


def test_a_short_test_earns_its_place_where_a_long_one_has_no_verdict_on_many_samples():
    short, long = judged(7, 4.0, 9.0, 2.0)._replace(reach=0.7), judged(60, 1.0, 2.0, 1.0)
    assert earned([short, long._replace(reach=0.2)], 3, SPANS) == (long._replace(reach=0.2), short)
    assert earned([short, long._replace(reach=0.6)], 3, SPANS) == (long._replace(reach=0.6),)


def test_a_test_that_asks_for_wider_bounds_of_all_must_be_worth_it():
    """One factor is that of the bank: what a test sees that asks for much, the others pay for."""
    short, long = judged(15, 1.0, 9.0, 1.0), judged(60, 4.0, 6.0, 2.0)
    calm, wide = (1.0, 1.0, 1.0), (1.0, 4.0, 4.0)
    assert (
        earned([short._replace(left_out=calm), long._replace(left_out=calm)], 3, SPANS)[1].window.horizon
        == 60
    )
    # seen at its own factor, 6.0 is what the short one never shows; beside it the jump would be 2.5
    long = long._replace(left_out=wide, factor=factor_of(wide, 3))
    short = short._replace(left_out=calm, factor=factor_of(calm, 3))
    assert earned([short, long], 3, SPANS) == (short,)


def test_a_bank_asks_of_each_recording_what_its_widest_test_does():
    one, other = (1.0, 2.0, np.nan), (3.0, 1.0, np.nan)
    assert largest_of([one, other])[:2] == (3.0, 2.0)
    assert factor_of(largest_of([one, other]), 3) > max(factor_of(one, 3), factor_of(other, 3))


@pytest.fixture(scope="module")
def recordings():
    """Return three recordings of a slow plant, by steps of an input that acts less where it is large: a model
    of it errs more, the longer it looks.
    """
    plant = jb.LinearSystem([[0.97]], [[0.05]], [[1]], noise=0.1)
    made = []
    for number in range(3):
        key, other = jax.random.split(jax.random.key(number))
        u = np.repeat(np.asarray(jax.random.uniform(key, (12, 1))) * 8, 20, 0)
        made.append((u, np.asarray(jb.simulate(plant, u - 0.09 * u**2, other).y)))
    return made


@pytest.fixture(scope="module")
def fitted(recordings):
    return jb.fit(recordings, order=1, method="least squares", safety=1.25)


def test_a_fit_for_a_bank_states_the_tests_of_its_monitor(fitted, recordings, tmp_path):
    jb.save_model(fitted, tmp_path / "plant.toml")
    bank = jb.monitor(tmp_path / "plant.toml")
    assert len(bank.names) > 1
    assert set(bank.names) <= {test.window.text for test in fitted.check.tests}
    for u, y in recordings:
        assert jb.detect(bank, u, y).counts["FAULT"] == 0


def test_each_test_of_the_bank_is_the_fit_for_its_windows(fitted, recordings):
    by_name = {test.window.text: test for test in fitted.check.tests}
    for test in fitted.tests[1:]:
        window = by_name[test.name].window
        about = window.about | {"average": window.average}
        alone = jb.fit(recordings, order=1, method=by_name[test.name].method, **about)
        own = model_of(fitted, test)
        assert (own.A, own.B, own.horizon, own.lags) == (alone.A, alone.B, alone.horizon, alone.lags)
        assert by_name[test.name].smallest == pytest.approx(alone.check.smallest, rel=1e-9)


def test_all_tests_of_a_bank_have_one_factor(fitted):
    """What each recording asks of the test that asks most, whatever a test by itself would need."""
    chosen = [fitted, *(model_of(fitted, test) for test in fitted.tests[1:])]
    by_name = {test.window.text: test for test in fitted.check.tests}
    for name, model in zip([test.name for test in fitted.tests], chosen, strict=True):
        assert model.left_out == fitted.left_out
        bound = rounded_up(fitted.check.factor * 1.25 * by_name[name].smallest["y1"])
        assert float(model.noise[0] + model.resolution[0]) == pytest.approx(bound, rel=2e-3)
    asked = [one.factor for one in fitted.check.left_out]
    assert factor_of(asked, 3) == fitted.check.factor


def test_an_observer_is_tried_beside_the_windows_with_disturbances_of_its_own(recordings, monkeypatch):
    monkeypatch.setattr(window_tests, "WINDOWS", (WindowChoice(15),))
    monkeypatch.setattr(disturbances, "SETTINGS", (disturbances.Setting(0, 0.05),))
    recordings = [(u[:120], y[:120]) for u, y in recordings]
    options = dict(order=1, method="least squares", observer="zonotope", disturbances="auto")
    model = jb.fit(recordings, test="bank", **options)
    windows, watching = model.check.tests
    assert windows.window == WindowChoice(15)
    assert watching.steady["y1"] < 0.8 * windows.steady["y1"]
    # what the bank sees is what the test of it sees that sees most; what none sees is said
    assert model.check.steady == watching.steady and model.check.jump["y1"] <= watching.jump["y1"]
    assert watching.steady["y1"] < model.check.moved["y1"] < windows.steady["y1"]
    assert not any("may stay unseen" in sentence for sentence in model.check.sentences)
    own = model_of(model, model.tests[1])
    assert own.disturbance and not model.disturbance
    assert own.noise[0] + own.resolution[0] < model.noise[0] + model.resolution[0]
    assert (model.tests[1].observer, dict(model.tests[1].options)) == ("zonotope", {"latched": True})
    assert jb.detect(jb.monitor(model), *recordings[0]).counts["FAULT"] == 0


@pytest.fixture(scope="module")
def jittering():
    """Return two recordings of a slow plant whose samples are taken late or early, by half a period at most:
    its sensor errs by as much as the plant moves then, which an input drives.
    """
    made = []
    for number in range(2):
        rng = np.random.default_rng(number)
        u, x = np.repeat(rng.uniform(-1, 1, (15, 1)) ** 3, 6, 0), np.zeros((90, 1))
        for k in range(89):
            x[k + 1] = 0.97 * x[k] + u[k]
        moves = u - 0.03 * x
        made.append((u, x + 0.5 * rng.uniform(-1, 1, x.shape) * moves + rng.uniform(-0.01, 0.01, x.shape)))
    return made


def test_tests_whose_bounds_follow_compete_with_constant_ones(jittering, monkeypatch, tmp_path):
    windows = WindowChoice(3), WindowChoice(5, average=3), WindowChoice(5)
    monkeypatch.setattr(window_tests, "WINDOWS", windows)
    monkeypatch.setattr(bank, "GAIN", 2.0)  # whatever is not worse as a whole joins
    model = jb.fit(jittering, order=1, method="least squares", test="bank", follow="auto")
    shown = [test.window for test in model.check.tests]
    assert {window.constant for window in shown} == set(windows)
    assert {window.follow for window in shown} <= {0, *WEIGHTS}
    jb.save_model(model, tmp_path / "plant.toml")
    loaded = jb.load_model(tmp_path / "plant.toml")
    own = {test.name: model_of(loaded, test) for test in loaded.tests}
    assert any(one.times and one.averages for one in own.values())
    for name, one in own.items():
        assert bool(one.times) == ("(follow " in name)
        assert one.left_out == model.left_out  # one factor for all
    assert factor_of([one.factor for one in model.check.left_out], 2) == model.check.factor
    for u, y in jittering:
        assert jb.detect(tmp_path / "plant.toml", u, y).counts["FAULT"] == 0


def test_where_nothing_is_left_out_bounds_of_a_bank_do_not_follow_unless_by_a_weight(jittering, monkeypatch):
    monkeypatch.setattr(window_tests, "WINDOWS", (WindowChoice(7),))
    options = dict(order=1, method="least squares", test="bank", held_out=0)
    model = jb.fit(jittering, follow="auto", **options)
    assert not model.times
    assert "no recording says, left out, how strongly" in " ".join(model.check.sentences)
    (by_weight,) = jb.fit(jittering, follow=0.2, **options).check.tests
    assert by_weight.window.follow == 0.2


@pytest.mark.parametrize("options, horizon", [({"held_out": 0}, 15), ({"horizon": 6}, 6)])
def test_windows_are_those_of_one_test_where_they_are_given_or_nothing_can_choose(
    recordings, options, horizon
):
    short = [(u[:60], y[:60]) for u, y in recordings]
    model = jb.fit(short, order=1, method="least squares", **options)
    assert (model.horizon, model.tests, model.check.tests) == (horizon, (), ())


def test_windows_of_one_test_are_taken_where_no_left_out_part_says_how_wide_bounds_must_be(
    recordings, monkeypatch
):
    monkeypatch.setattr(window_tests, "WINDOWS", (WindowChoice(7),))
    parts, still = [], np.ones((120, 1))
    for number, (u, y) in enumerate(recordings[:2]):  # each moves an input that rests in the other
        parts.append((np.hstack([u[:120], still][:: 1 - 2 * number]), y[:120]))
    model = jb.fit(parts, order=1, method="least squares")
    assert all(one.why for one in model.check.left_out)
    assert (model.horizon, model.tests, model.check.tests) == (15, (), ())


def test_a_bank_of_one_test_is_its_windows(recordings, monkeypatch):
    monkeypatch.setattr(window_tests, "WINDOWS", (WindowChoice(5), WindowChoice(7)))
    monkeypatch.setattr(bank, "GAIN", 0.0)
    short = [(u[:60], y[:60]) for u, y in recordings]
    model = jb.fit(short, order=1, method="least squares")
    assert model.tests == () and len(model.check.tests) == 2 and model.horizon in (5, 7)


@pytest.mark.parametrize(
    "more, words",
    [
        ({"horizon": 20}, "chooses windows: leave horizon out"),
        ({"order": 0}, "a static model"),
        ({"disturbances": "auto", "see": jb.Fault("z", "bias", 1)}, "no signal 'z'"),
    ],
)
def test_what_does_not_go_with_a_bank_is_refused(recordings, more, words):
    with pytest.raises(ValueError, match=words):
        jb.fit(recordings, test="bank", **more)
