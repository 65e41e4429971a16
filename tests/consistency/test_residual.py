"""A user's own residual: verdicts agree with exact answers, with the joint test, and never accuse what the
bounds explain.
"""

from fractions import Fraction

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound import Status
from jaxbound.certificates.residual_certificate import ResidualCertificate

BOX = jb.interval([-0.125, -0.0625], [0.125, 0.0625])


def growth(z, u, y):
    """y+ = y + 0.25 (1 + z0) y (1 - y) + u + z1: growth with an uncertain rate and an error."""
    return y[1, 0] - y[0, 0] - 0.25 * (1 + z[0]) * y[0, 0] * (1 - y[0, 0]) - u[0, 0] - z[1]


OWN = jb.residual(growth, BOX, 1)
"""One for all tests: its programs are written down once."""


def exactly(u, y):
    """Return how far inside (> 0) the window is: growth is affine in z, so that its range is an interval with
    rational ends.
    """
    a, b, v = Fraction(float(y[0, 0])), Fraction(float(y[1, 0])), Fraction(float(u[0, 0]))
    lean = a * (1 - a) / 4
    return abs(lean) / 8 + Fraction(1, 16) - abs(b - a - lean - v)


def windows(rng, count):
    u, y = rng.uniform(-0.05, 0.05, (count, 1)), rng.uniform(0.2, 0.4, (count, 1))
    y[1:, 0] += rng.choice([0, 0, 0.1, -0.2], count - 1)
    return u, y


@pytest.mark.parametrize("count", [24, pytest.param(250, marks=pytest.mark.long)])
def test_every_verdict_agrees_with_the_exact_one(rng, count):
    u, y = windows(rng, count)
    status = jb.detect(OWN, u, y).status
    assert status[0] == Status.MISSING
    inside = np.array([exactly(u[k - 1 : k + 1], y[k - 1 : k + 1]) for k in range(1, len(y))])
    assert (inside[status[1:] == Status.CONSISTENT] >= 0).all() and (
        inside[status[1:] == Status.FAULT] < 0
    ).all()
    clear = abs(inside) > 1e-6
    assert (
        (status[1:][clear] != Status.UNDECIDED).all()
        and (status[1:] == Status.FAULT).mean() > 0.1
        and (inside > 0).mean() > 0.2
    )


def test_unknowns_at_their_bounds_raise_no_fault(rng):
    y, u = np.empty((2, 20, 1)), rng.uniform(-0.02, 0.02, (2, 20, 1))
    y[:, 0, 0] = rng.uniform(0.2, 0.8, 2)
    for k in range(19):
        z = rng.choice([-1, 1], (2, 2)) * np.array([0.125, 0.0625])
        y[:, k + 1, 0] = (
            y[:, k, 0] + 0.25 * (1 + z[:, 0]) * y[:, k, 0] * (1 - y[:, k, 0]) + u[:, k, 0] + z[:, 1]
        )
    result = jb.detect(OWN, u, y)
    assert result.status.shape == (2, 20) and result.counts["FAULT"] == 0 and np.isnan(result.margin).all()


@pytest.mark.parametrize(
    "s, T",
    [
        (1, 30),
        pytest.param(1, 60, marks=pytest.mark.long),
        pytest.param(2, 400, marks=[pytest.mark.long, pytest.mark.compiled]),  # solves
    ],
)
def test_it_agrees_with_the_joint_test_of_a_linear_model(rng, s, T):
    model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
    u, y = rng.uniform(-0.1, 0.1, (T, 1)), rng.uniform(-0.15, 0.15, (T, 1)) * (1 if s == 2 else 2)
    joint = jb.detect(jb.parity_relations(model, horizon=s), u, y)
    parity = lambda z, u, y: [y[k + 1, 0] - z[k + 1] - 0.5 * (y[k, 0] - z[k]) - u[k, 0] for k in range(s)]
    own = jb.detect(jb.residual(parity, jb.interval([-0.1] * (s + 1), [0.1] * (s + 1)), s), u, y)
    clear = abs(joint.margin) > 1e-6
    assert (own.status[clear] == joint.status[clear]).mean() > 0.99
    assert not ((own.status == Status.FAULT) & (joint.status == Status.CONSISTENT)).any()
    assert not ((own.status == Status.CONSISTENT) & (joint.status == Status.FAULT)).any()
    assert (own.status == Status.FAULT).any() and (own.status == Status.CONSISTENT).any()


def test_a_missing_sample_makes_its_windows_missing_and_a_batch_equals_its_recordings(rng):
    u, y = windows(rng, 60)
    y[20], u[40] = np.nan, np.nan
    r = OWN
    alone = jb.detect(r, u, y).status
    assert np.flatnonzero(alone == Status.MISSING).tolist() == [0, 20, 21, 40, 41]
    both = jb.detect(r, np.stack([u, u]), np.stack([y, y + 0.01])).status
    assert (both[0] == alone).all() and (both[1] == jb.detect(r, u, y + 0.01).status).all()


def test_float32_recordings_are_judged_as_recorded(rng):
    u, y = (x.astype(np.float32) for x in windows(rng, 200))
    result = jb.detect(OWN, u, y)
    inside = np.array([exactly(u[k - 1 : k + 1], y[k - 1 : k + 1]) for k in range(1, 200)])
    assert (inside[result.status[1:] == Status.CONSISTENT] >= 0).all() and (
        inside[result.status[1:] == Status.FAULT] < 0
    ).all()
    assert (result.status[1:][abs(inside) > 1e-4] != Status.UNDECIDED).all()


def test_explain_shows_unknowns_that_explain_a_window_or_how_many_boxes_exclude_it():
    y = np.array([[0.5], [0.6], [0.9]])
    result = jb.detect(OWN, np.zeros((3, 1)), y)
    assert result.status.tolist() == [Status.MISSING, Status.CONSISTENT, Status.FAULT]
    witness = result.explain(1).witness
    z = np.asarray(witness.mid)
    assert abs(float(growth(z, np.zeros((2, 1)), y[:2]))) < 1e-9 and (np.asarray(witness.hi) <= BOX.hi).all()
    assert str(result.explain(1)).startswith("explained by the unknowns (")
    assert isinstance(
        result.explain(2), ResidualCertificate
    ) and "no value of the unknowns explains it after" in str(result.explain(2))
    assert len(result.alarms()) == 1 and result.alarms()[0].candidates == ()
    with pytest.raises(ValueError, match="window 0 is MISSING"):
        result.explain(0)


def test_constant_parameters_are_one_value_over_the_window(rng):
    f = lambda z, u, y: [y[k + 1, 0] - (1 + z[0]) * y[k, 0] for k in range(2)]
    box = jb.interval([-0.5], [0.5])
    y = np.array([[1.0], [1.25], [1.5625], [1.7]])
    status = jb.detect(jb.residual(f, box, 2), None, y).status
    assert status.tolist()[3] == Status.FAULT and status[2] != Status.FAULT  # 1.25 twice; 1.25, then 1.088


def test_dataframes_bring_names_and_columns_can_be_chosen(rng):
    u, y = windows(rng, 30)
    frame = pd.DataFrame({"noise": 0.0, "level": y[:, 0]})
    want = jb.detect(OWN, u, y)
    named = jb.residual(growth, BOX, 1, inputs=["valve"], outputs=["level"])
    result = jb.detect(named, pd.DataFrame({"valve": u[:, 0]}), frame)
    assert (
        (result.status == want.status).all()
        and named.count == 1
        and result.relations.model.outputs == ("level",)
    )
    assert want.relations.model.outputs == ("y1",) and (result.to_pandas().index == frame.index).all()


def test_relation_texts_bounds_and_nominal_residuals():
    r = OWN
    assert r.text() == "growth(z, u[k-1..k], y[k-1..k]) = 0 for some z in [-0.125, 0.125] x [-0.0625, 0.0625]"
    assert r.bounds["parameters"].tolist() == [[-0.125, 0.125], [-0.0625, 0.0625]]
    wider = r.with_bounds({"parameters": [[-0.125, 0.125], [-10, 10]]})
    y = np.array([[0.5], [0.9], [0.2]])
    assert (
        jb.detect(r, np.zeros((3, 1)), y).counts["FAULT"] == 2
        and jb.detect(wider, np.zeros((3, 1)), y).counts["CONSISTENT"] == 2
    )
    u, y = np.array([[0.0], [0.1], [0.2], [0.3]]), np.array([[0.5], [0.9], [0.2], [0.4]])
    external, before = np.asarray(r.external(u, y)), y[:-1]
    assert np.isnan(external[0]).all()
    assert abs(external[1:] - (y[1:] - before - before * (1 - before) / 4 - u[:-1])).max() < 1e-12


def test_the_nominal_residual_of_a_plant_without_inputs():
    r = jb.residual(lambda z, u, y: y[1, 0] - z[0] * y[0, 0], jb.interval([0.5], [1.5]), 1)
    assert np.asarray(r.external(None, [[1.0], [2.0], [4.0]]))[1:, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: jb.residual(3.0, BOX), TypeError, "residual needs a function of"),
        (
            lambda: jb.residual(growth, jb.interval([-np.inf], [1.0])),
            ValueError,
            "bounded, non-empty Interval of shape",
        ),
        (
            lambda: jb.residual(growth, jb.interval(0.0, 1.0)),
            ValueError,
            r"of shape \(n,\): its shape is \(\)",
        ),
        (lambda: jb.residual(growth, jb.interval([1.0], [0.0])), ValueError, "lo must be <= hi"),
        (lambda: jb.residual(growth, BOX, horizon=1.5), ValueError, "horizon must be a whole number"),
        (lambda: jb.residual(growth, BOX, outputs=["a", "a"]), ValueError, "outputs must be different names"),
        (lambda: OWN.count, ValueError, "name them"),
        (
            lambda: OWN.with_bounds({"noise": 1}),
            ValueError,
            r"the bounds of a residual are \['parameters'\]",
        ),
        (
            lambda: OWN.with_bounds({"parameters": [1, 2]}),
            ValueError,
            r"shape \(2, 2\): its shape is \(2,\)",
        ),
        (
            lambda: jb.detect(OWN, [[0.0]] * 3, [[np.inf]] * 3),
            ValueError,
            "y must be finite",
        ),
        (
            lambda: jb.detect(OWN, [[0.0]] * 3, [[1.0]] * 2),
            ValueError,
            "same number of samples",
        ),
        (
            lambda: jb.detect(OWN, [[0.0]] * 3, [[1.0]] * 3, method="box"),
            ValueError,
            "'box' is for parity relations",
        ),
        (
            lambda: jb.detect(OWN, [[0.0]] * 3, [[1.0]] * 3, budget=0),
            ValueError,
            "budget must be a whole number of boxes",
        ),
        (
            lambda: jb.detect(jb.residual(lambda z, u, y: [], BOX, 1), None, [[1.0]] * 3),
            ValueError,
            "f must return at least one float",
        ),
        (
            lambda: jb.detect(jb.residual(lambda z, u, y: jnp.argmax(y), BOX, 1), None, [[1.0]] * 3),
            ValueError,
            "at least one float, not 1",
        ),
    ],
    ids=range(15),
)
def test_what_cannot_be_a_residual_is_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()
