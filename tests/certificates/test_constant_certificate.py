"""Certificates of tolerances that keep one value over a window: the gains are part of the proof, and
fractions alone confirm it.
"""

import json
from fractions import Fraction

import check_certificate
import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.sets import Status


def confirmed(c):
    document = json.loads(c.to_json())
    check_certificate.confirm(document)
    return document


def recording(rng, model, count=40, size=10.0):
    """Return (u, y): a healthy plant, then one whose gains jump about."""
    u = rng.uniform(-1, 1, (count, 1)) * size
    y = np.array(jb.simulate(model, u, jax.random.key(int(rng.integers(2**31)))).y)
    y[count // 2 :] *= 1 + rng.uniform(-1, 1, (count - count // 2, 2)) * [0.02, 0.1]
    return u, y


@pytest.mark.parametrize(
    "change",
    [
        {},
        pytest.param(dict(tolerance=["1/50", 0]), marks=pytest.mark.long),
        pytest.param(dict(disturbance=([[0], [1]], "1/10"), resolution=0.01), marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("s", [1, pytest.param(3, marks=pytest.mark.long)])
def test_a_verdict_on_constant_gains_is_proved_by_fractions_whatever_it_is(rng, s, change):
    model = paper(constant_tolerance=True, **change)
    u, y = recording(rng, model)
    res = jb.detect(jb.parity_relations(model, s), u, y)
    for k in range(s, len(u), 2):
        c = res.explain(k)
        assert confirmed(c)["certificate"] == Status(int(res.status[k])).name and c.errors == {}
        assert c.factor == abs(c.residual) / c.width
    assert res.counts["FAULT"] and res.counts["CONSISTENT"]


def test_samples_that_gains_explain_only_if_they_change_are_a_fault(rng):
    anew, constant = (jb.parity_relations(paper(constant_tolerance=value), 1) for value in (False, True))
    u, y = recording(rng, anew.model, 60, 30.0)
    k = next(
        k
        for k in range(1, 60)
        if certify(constant, u[k - 1 : k + 1], y[k - 1 : k + 1]).proves == Status.FAULT
    )
    window = u[k - 1 : k + 1], y[k - 1 : k + 1]
    c = certify(constant, *window)
    assert certify(anew, *window).proves == Status.CONSISTENT
    assert confirmed(c)["certificate"] == "FAULT" and "cannot hold for any gains" in str(c)


def test_missing_samples_leave_a_proof():
    r = jb.parity_relations(paper(constant_tolerance=True), 2)
    y = np.array([[0, 0], [np.nan, 0], [0, np.nan]])
    assert confirmed(certify(r, np.array([[0.0], [np.nan], [0]]), y))["certificate"] == "CONSISTENT"


def test_a_gain_out_of_its_bounds_is_not_confirmed():
    r = jb.parity_relations(paper(constant_tolerance=True), 1)
    document = confirmed(certify(r, np.zeros((2, 1)), np.zeros((2, 2))))
    numbers, F = document["numbers"], Fraction
    gains = numbers["witness"]["gains"]
    numbers["sum"] = str(F(numbers["sum"]) - F(gains[0]) + 2)
    gains[0] = "2"
    with pytest.raises(ValueError, match="g0 is out of its bounds"):
        check_certificate.confirm(document)
