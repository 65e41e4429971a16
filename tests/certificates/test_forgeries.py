"""Certificates that say something false: the checker believes nothing but multipliers and witnesses."""

import json
from fractions import Fraction

import check_certificate
import numpy as np
import pytest
from ploix_experiment import record
from test_certificate import refused
from uncertain_systems import relations

import jaxbound as jb
from jaxbound.certificates import verify
from jaxbound.certificates.interface import certify

MEANS = jb.LinearSystem([[0.9]], [[0.5]], [[1]], noise=0.2, averages={"y1": {4: 0.05}})
BIASED = np.full((8, 1), 0.15)


def summed(document):
    """Return the document with the sum of its numbers made right again."""
    document["numbers"].pop("sum")
    check_certificate.numbers(document["numbers"], seen := [])
    document["numbers"]["sum"] = str(sum(seen))
    return document


def averaged_fault():
    """Return the certificate of a bias that only the mean of four samples shows."""
    c = certify(
        jb.parity_relations(MEANS, 7), np.zeros((8, 1)), np.where(np.arange(8)[:, None] < 4, BIASED, -BIASED)
    )
    document = json.loads(c.to_json(errors=False))
    assert document["certificate"] == "FAULT" and any(x != "0" for x in document["numbers"]["relation"]["a"])
    return document


def test_the_samples_of_averages_are_those_that_are_shown():
    document = averaged_fault()
    document["numbers"]["y"] = [["0"]] * 8
    assert refused(summed(document))


def test_a_parameter_cannot_be_listed_twice(rng):
    u, y = record(rng, "n2p1_paper_h3", 1, "uniform")
    document = json.loads(certify(relations("n2p1_paper_h3", noise=0.01), u[0, 50:53], y[0, 50:53]).to_json())
    assert document["certificate"] == "CONSISTENT" and not refused(document)
    document["numbers"]["variables"].append(document["numbers"]["variables"][0])
    document["numbers"]["parameters"].append("0")
    assert refused(summed(document))


@pytest.mark.parametrize("field, value", [("recorder", "-0.05"), ("floor", "-1/10"), ("recorder", "0.1")])
def test_what_a_recorder_rounds_away_cannot_be_chosen(field, value):
    r = jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise="1/10"), 1)
    for y in ([[1.0], [0.52]], [[1.0], [0.9]]):
        document = json.loads(certify(r, np.zeros((2, 0)), np.array(y)).to_json(errors=False))
        document["numbers"][field] = value
        relation = document["numbers"]["relation"]
        del document["numbers"]["sum"]
        # residual and width follow from the relation, whatever the bounds
        c = check_certificate.numbers(document["numbers"], [])
        h = [x for row in c["relation"]["h"] for x in row]
        sizes = [
            c["noise"][0] + c["recorder"] * (max(abs(v) for (v,) in c["y"]) + c["noise"][0]) + c["floor"]
        ] * 2
        width = sum(abs(x) * size for x, size in zip(h, sizes, strict=True))
        relation |= {"width": str(width), "factor": str(abs(Fraction(relation["residual"])) / width)}
        document["certificate"] = "FAULT" if abs(Fraction(relation["residual"])) > width else "CONSISTENT"
        if document["certificate"] == "FAULT":
            document["numbers"]["witness"] = None
        document["numbers"]["sum"] = "0"
        assert refused(summed(document))


@pytest.mark.parametrize("said", ["the sensor T7 is broken", "", None])
def test_a_statement_is_what_is_proved(said):
    document = averaged_fault()
    assert not refused(document)
    document["statement"] = said
    assert refused(document)


def test_the_smallest_error_of_a_sensor_is_neither_less_nor_more_nor_said_twice(rng):
    r = jb.parity_relations(jb.LinearSystem([[1]], None, [[1], [1]], tolerance=["1/2", 0], noise="1/8"), 0)
    document = json.loads(certify(r, np.zeros((1, 0)), np.array([[1.0, -3.0]])).to_json())
    assert not refused(document)
    for field, value in (
        ("enough", "1000"),
        ("smallest", "-1/10"),
        ("output", "-1"),
        ("output", "1/2"),
        ("output", "1"),
    ):
        wrong = json.loads(json.dumps(document))
        wrong["numbers"]["errors"][0][field] = value
        assert refused(summed(wrong)), field
    document["numbers"]["errors"] *= 2
    assert refused(summed(document))


def test_a_number_that_would_keep_a_checker_busy_is_refused_at_once():
    document = averaged_fault()
    document["numbers"]["noise"] = ["1e999999999"]
    assert refused(document)


@pytest.mark.parametrize("gains", [None, []])
def test_a_tolerance_that_keeps_its_value_needs_a_gain(gains):
    """Without gains shown, each reading would have one of its own, as where the tolerance may vary."""
    plant = dict(A=[[1.0]], B=None, C=[[1]], tolerance=0.1, noise=0.01)
    y = np.array([[10.0], [10.9]])
    constant, varying = (jb.LinearSystem(**plant, constant_tolerance=kept) for kept in (True, False))
    proved = [certify(jb.parity_relations(m, 1), np.zeros((2, 0)), y) for m in (constant, varying)]
    assert [c.proves.name for c in proved] == ["FAULT", "CONSISTENT"]
    document = json.loads(proved[1].to_json())
    document["numbers"] |= {"constant": "1", "relation": None}
    document["numbers"]["witness"]["gains"] = gains
    assert refused(summed(document))
    with pytest.raises((TypeError, ValueError)):
        verify(document, constant, None, y)
