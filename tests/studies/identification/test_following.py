"""Bounds that follow the operating point: the factor that `fit` writes, and how it is chosen."""

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.factors import read_factor
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification.following import leverage_text

NO_STARTS = np.zeros(0, int)


def curved_day(rng, middle, curve):
    """A static plant whose curve a line cannot follow: errors grow away from the middle of training."""
    u = middle + rng.uniform(-1, 1, (150, 1))
    return u, u + curve * u**2 + rng.uniform(-0.01, 0.01, (150, 1))


def test_the_text_is_the_quadratic_form_of_the_inverse_covariance(rng):
    mixed = np.array([[2.0, 0.3, 0], [0.5, 40.0, 0], [0, 0, 0]])
    u = rng.normal(size=(400, 3)) @ mixed + [5.0, -300.0, 7.0]
    record = u, rng.normal(size=(400, 1)), NO_STARTS
    names = ("fan", "room air", "still")
    written = read_factor(leverage_text([record], names, names, 0.3))
    assert set(written.columns) == {"fan", "room air"}
    moving = u[:, :2]
    off = moving - moving.mean(0)
    expected = np.sqrt(1 + 0.3 * np.einsum("ti,ij,tj->t", off, np.linalg.inv(np.cov(moving.T)), off) / 2)
    factor = written.values({"fan": u[:, 0], "room air": u[:, 1]})
    np.testing.assert_allclose(factor, expected, rtol=0.02)
    assert (factor >= 1).all()


def test_auto_follows_where_errors_grow_away_from_training(rng):
    days = [curved_day(rng, middle, 0.5) for middle in (0.0, 0.1, -0.1)]
    constant, model = (jb.fit(days, order=0, follow=follow) for follow in (0, "auto"))
    assert constant.check.follows.weight == 0 and not constant.times
    assert model.check.follows.weight > 0 and set(model.times) == {"y1"}
    assert float(model.noise[0]) < float(constant.noise[0])
    relations = jb.parity_relations(model, 0)
    for u, y in days:
        assert (jb.detect(relations, u, y).status == Status.CONSISTENT).all()


def test_errors_are_stated_as_seen_under_the_widest_bounds_of_training(rng):
    days = [curved_day(rng, middle, 0.5) for middle in (0.0, 0.1)]
    model = jb.fit(days, order=0, follow=0.3)
    most = model.check.follows.most
    factor = read_factor(model.times["y1"])
    every = np.concatenate([u[:, 0] for u, _ in days])
    assert most == factor.values({"u1": every}).max() > 1
    sizes = jb.detectable(model, "y1", horizon=0, factors={"y1": most})
    assert model.check.jump["y1"] == pytest.approx(float(sizes), rel=1e-3)


@pytest.mark.parametrize(
    "options, sentence",
    [
        ({"follow": -0.1}, "follow must be a number >= 0, or auto, not -0.1"),
        ({"follow": "much"}, "follow must be a number >= 0, or auto, not 'much'"),
    ],
)
def test_what_cannot_follow_is_refused(rng, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        jb.fit([curved_day(rng, 0.0, 0.5)], **({"order": 0} | options))


def test_inputs_in_which_an_output_is_recorded_are_not_followed(rng):
    u, y = curved_day(rng, 0.0, 0.5)
    table = pd.DataFrame({"a": u[:, 0], "b": y[:, 0]})
    about = dict(order=0, inputs="load", outputs="flow", columns={"load": "= a + b", "flow": "b"})
    with pytest.raises(ValueError, match="no input that bounds could follow, none that rests on no output"):
        jb.fit(table, follow=0.1, **about)
    model = jb.fit(table, follow="auto", **about)
    assert not model.times and model.check.recipe.follow == "auto"
    assert any("none that rests on no output: they are constant" in x for x in model.check.sentences)


def test_auto_says_why_bounds_stay_constant(rng):
    model = jb.fit([curved_day(rng, 0.0, 0.5)], order=0, follow="auto", held_out=0)
    assert not model.times
    assert "no recording says, left out, how strongly bounds have to follow" in " ".join(
        model.check.sentences
    )
