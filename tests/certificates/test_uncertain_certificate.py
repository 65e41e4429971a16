"""Certificates of models with uncertain parameters: confirmed by plain fractions, refused with one wrong
digit.
"""

import json

import check_certificate
import numpy as np
import pytest
from ploix_experiment import record
from test_certificate import _flat, corrupted, refused
from uncertain_systems import EXAMPLE, TWO, VT, relations

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.sets.floats.status import Status

NOISY = dict(noise=[0.02, 0.05], tolerance=[0.01, 0], disturbance=([[0.1], [0], [0.2]], [[-0.05, 0.1]]))
PROOF = ("h", "g", "k", "direction", "low", "high", "at", "state", "outputs")


long = lambda *x: pytest.param(*x, marks=pytest.mark.long)


def detected(rng, name, budget=None, runs=2, **changes):
    """Return the Result of recordings that are faulty in part."""
    dC = np.zeros((len(relations(name).model.C), relations(name).model.n))
    dC[0] += rng.uniform(-0.5, 0.5, len(dC[0]))
    u, y = record(rng, name, runs, "uniform", **(changes or dict(dC=dC)))
    if changes or name == TWO:
        y[:, 40:70] += rng.uniform(-1, 1, (runs, 30, y.shape[-1])) * (0.5 if name == TWO else 2)
    return jb.detect(relations(name, **changes), u, y, budget=budget)


def check_round_trips(rng, res, count, status):
    """Confirm certificates of random windows of that status, refuse them with a digit changed; return the
    largest number of leaves.
    """
    places, leaves = np.argwhere(res.status == status), 0
    assert len(places) >= min(count, 20)
    for at in rng.permutation(places)[:count]:
        c = res.explain(tuple(at.tolist()))
        assert c.proves == c.status == status
        check_round_trip(rng, c)
        leaves = max(leaves, len(c.leaves))
    return leaves


def check_round_trip(rng, c):
    document = json.loads(c.to_json())
    check_certificate.confirm(document)
    assert refused(corrupted(document, rng))
    wrong = corrupted(document, rng, lambda path: bool(set(path) & set(PROOF)))
    assert refused(summed(wrong))
    assert refused(document | {"certificate": "FAULT" if c.proves == Status.CONSISTENT else "CONSISTENT"})


def summed(document):
    """Return the document with the sum of its numbers made right again."""
    document["numbers"]["sum"] = str(sum(_flat({k: v for k, v in document["numbers"].items() if k != "sum"})))
    return document


def test_a_wrong_digit_is_caught(rng):
    r = relations("n2p1_paper_h3", noise=0.01, tolerance=0.02)
    u, y = record(rng, "n2p1_paper_h3", 6, "uniform")
    y += rng.uniform(-0.01, 0.01, y.shape)
    for i in range(6):
        u, y = (x.astype(np.float32) for x in (u, y)) if i == 3 else (u, y)
        healthy = certify(r, u[i, 50:53], y[i, 50:53])
        fault = certify(r, u[i, 50:53], y[i, 50:53] + np.array([[0], [0], [5 + 5 * rng.random()]], y.dtype))
        assert (healthy.proves, fault.proves) == (Status.CONSISTENT, Status.FAULT)
        check_round_trip(rng, healthy), check_round_trip(rng, fault)


@pytest.mark.parametrize(
    "name, changes, runs, count",
    [
        (TWO, {}, 2, 3),
        ("n2p1_paper_h3", dict(noise=0.01, tolerance=0.02), 2, 3),
        long("n2p1_paper_h3", dict(noise=0.01, tolerance=0.02), 20, 100),
        *(
            long(*x, 16, 100)
            for x in (("n3p2_mixed3_h3", NOISY), ("n3p2_mixed3_h3", {}), ("n3p2_var3_h2", {}))
        ),
    ],
)
def test_verdicts_of_one_and_many_parameters_are_confirmed_and_a_wrong_digit_is_caught(
    rng, name, changes, runs, count
):
    res = detected(rng, name, runs=runs, **changes)
    for status in (Status.FAULT, Status.CONSISTENT):
        check_round_trips(rng, res, count, status)


@pytest.mark.long(by_day="test_the_witness_is_within_the_users_bounds")
def test_a_witness_settles_windows_whose_relations_are_not_proved_to_say_all(rng):
    res = detected(rng, "n3p2_inv3_h3")
    assert res.counts["CONSISTENT"] == 0
    check_round_trips(rng, res, 20, Status.FAULT)
    healthy = [k for k in range(5, 10) if res.status[0, k] == Status.UNDECIDED]
    assert len(healthy) > 2
    for k in healthy:
        c = res.explain((0, k))
        assert c.proves == Status.CONSISTENT
        check_round_trip(rng, c)


@pytest.mark.parametrize("name", [TWO, long("n3p2_mixed3_h3")])
def test_a_bisection_is_confirmed_box_by_box(rng, name):
    joint, paved = (detected(np.random.default_rng(5), name, budget, runs=2) for budget in (None, 300))
    won = (paved.status == Status.FAULT) & (joint.status == Status.UNDECIDED)
    assert won.sum() > 5
    with pytest.raises(
        NotImplementedError,
        match="neither a contradiction nor a behaviour is at hand .* a larger budget= of boxes goes on",
    ):
        joint.explain(tuple(np.argwhere(won)[0].tolist()))
    leaves = check_round_trips(
        rng,
        jb.Result(np.where(won, paved.status, 0), paved.margin, "joint", paved.relations, paved.u, paved.y),
        5,
        3,
    )
    assert leaves > 1
    found = (paved.status == Status.CONSISTENT) & (joint.status == Status.UNDECIDED)
    if found.any():
        check_round_trips(
            rng,
            jb.Result(np.where(found, 1, 0), paved.margin, "joint", paved.relations, paved.u, paved.y),
            1,
            1,
        )


def test_a_lost_sample_is_not_part_of_the_proof(rng):
    r = jb.parity_relations(relations("n2p1_paper_h3", noise=0.01).model, horizon=3)
    u, y = record(rng, "n2p1_paper_h3", 1, "uniform")
    u, y = u[0, 17:21], y[0, 17:21].copy()
    y[0] = np.nan
    for shift, proved in ((0, Status.CONSISTENT), (5, Status.FAULT)):
        y[3] += shift
        c = certify(r, u, y)
        document = json.loads(c.to_json())
        check_certificate.confirm(document)
        assert c.proves == proved and document["numbers"]["y"][0] == [None]


def test_a_parameter_that_is_left_out_is_missed(rng):
    u, y = record(rng, "n2p1_paper_h3", 1, "uniform")
    document = json.loads(certify(relations("n2p1_paper_h3", noise=0.01), u[0, 50:53], y[0, 50:53]).to_json())
    assert document["numbers"]["parameters"].pop() != document["numbers"]["variables"].pop()
    assert refused(summed(document))


def test_the_witness_is_within_the_users_bounds(rng):
    gain = jb.Uncertainty("gain", C=[[1, 0]], between=(2, 3), varying=False)
    m = jb.LinearSystem(EXAMPLE["A"], EXAMPLE["B"], [[0, 0]], noise=0.01, uncertainties=[gain])
    r, u, x, y = jb.parity_relations(m), rng.uniform(0, 2, (3, 1)), np.ones(2), []
    for k in range(3):
        y.append([2.5 * x[0] + rng.uniform(-0.01, 0.01)])
        x = np.array(EXAMPLE["A"]) @ x + np.array(EXAMPLE["B"]) @ u[k]
    c = certify(r, u, np.array(y))
    assert (
        c.proves == Status.CONSISTENT
        and 2 <= c.parameters["gain", None] <= 3
        and str(c).startswith("explained by gain = 2.")
    )
    assert len(c.state) == 2 and c.errors == {} and c.candidates == () and c.relation == ""


def test_models_without_states_or_without_inputs_have_certificates(rng):
    """y = (1 + k) u, k in [0, 0.2]; x+ = (0.5 + 0.1 a) x."""
    static = jb.LinearSystem(
        None,
        None,
        None,
        [[1], [1]],
        noise=0.1,
        uncertainties=[jb.Uncertainty("k", D=[[1], [1]], between=(0, "0.2"))],
    )
    free = jb.LinearSystem(
        [["0.5"]], None, [[1]], noise=0.1, uncertainties=[jb.Uncertainty("a", A=[["0.1"]])]
    )
    for m, u, healthy, faulty in (
        (static, [[2.0]], [[2.3, 2.25]], [[2.3, 1.8]]),
        (free, [[], []], [[1.0], [0.7]], [[1.0], [0.9]]),
    ):
        r = jb.parity_relations(m)
        for y, proved in ((healthy, Status.CONSISTENT), (faulty, Status.FAULT)):
            c = certify(r, np.array(u), np.array(y))
            assert c.proves == proved
            check_round_trip(rng, c)


def test_without_inputs_verdicts_are_those_of_the_certificates(rng):
    m = jb.LinearSystem([["0.5"]], None, [[1]], noise=0.1, uncertainties=[jb.Uncertainty("a", A=[["0.1"]])])
    y = 0.5 ** np.arange(12)[:, None] + rng.uniform(-0.2, 0.2, (12, 1))
    res = jb.detect(jb.parity_relations(m), None, y)
    assert all(
        res.explain(k).proves == res.status[k] for k in range(1, 12) if res.status[k] != Status.UNDECIDED
    )
    assert (res.status[1:] != Status.UNDECIDED).sum() > 8


def test_what_is_not_proved_is_said(rng):
    m = jb.LinearSystem(**EXAMPLE, noise=0.1, uncertainties=[jb.Uncertainty(**VT)])
    r = jb.parity_relations(m)
    with pytest.raises(ValueError, match="window 2 is MISSING"):
        certify(r, np.zeros((3, 1)), np.full((3, 1), np.nan))
