"""Certificates are proofs that anybody can check: with the standard library's fractions, without jaxbound."""

import json
import math
import re
from fractions import Fraction

import check_certificate
import numpy as np
import pytest
from certificate_cases import PLANTS, plant, window
from oracles import MODELS, Plant, Windows, draw
from systems import paper

import jaxbound as jb
from jaxbound.certificates.checker.claim import checksum
from jaxbound.certificates.exact_window import exact_window
from jaxbound.certificates.interface import certify
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.sets.floats.status import Status


def certificates(name, status, count, rng):
    """Return `count` certificates of random windows of a plant."""
    relations, gaps = plant(name)
    found = []
    while len(found) < count:
        u, y = window(relations, gaps, rng, bias=10 ** rng.uniform(0, 1.5) if status == Status.FAULT else 0.0)
        c = certify(relations, u, y)
        assert status == Status.FAULT or c.status == status
        found += [c] if c.status == status else []
    return found


def corrupted(document, rng, where=lambda path: True):
    """Return the document with one digit of one number changed."""
    places = []

    def visit(tree, path):
        if isinstance(tree, (dict, list)):
            for key, branch in tree.items() if isinstance(tree, dict) else enumerate(tree):
                visit(branch, (*path, key))
        elif isinstance(tree, str) and where(path):
            places.append((path, tree))

    visit(document["numbers"], ())
    path, text = places[rng.integers(len(places))]
    at = rng.choice([i for i, c in enumerate(text) if c.isdigit()])
    wrong = text[:at] + rng.choice([d for d in "0123456789" if d != text[at]]) + text[at + 1 :]
    out = json.loads(json.dumps(document))
    branch = out["numbers"]
    for key in path[:-1]:
        branch = branch[key]
    branch[path[-1]] = wrong
    return out


def refused(document):
    """Return whether the script refuses the document."""
    try:
        check_certificate.confirm(document)
    except (ArithmeticError, LookupError, TypeError, ValueError):
        return True
    return False


@pytest.mark.parametrize(
    "count", [3, pytest.param(40, marks=pytest.mark.long), pytest.param(200, marks=pytest.mark.long)]
)
@pytest.mark.parametrize("name", PLANTS)
def test_every_certificate_is_confirmed_and_one_wrong_digit_is_caught(name, count, rng):
    for status in (Status.FAULT, Status.CONSISTENT):
        for i, c in enumerate(certificates(name, status, count, rng)):
            document = json.loads(c.to_json(errors=i % 20 == 0))
            assert document["certificate"] == status.name
            check_certificate.confirm(document)
            assert refused(corrupted(document, rng))


@pytest.mark.parametrize("name", PLANTS)
def test_a_wrong_digit_in_the_proof_is_caught_by_mathematics_alone(name, rng):
    """The sum of all numbers is made right again: what is left is the proof itself."""
    (fault,), (healthy,) = (
        certificates(name, status, 1, rng) for status in (Status.FAULT, Status.CONSISTENT)
    )
    proof = {
        Status.FAULT: ("h", "g", "k", "residual", "width", "factor"),
        Status.CONSISTENT: ("state", "outputs"),
    }
    for c in (fault, healthy):
        document, fields = json.loads(c.to_json()), proof[c.status]
        total = lambda document: sum(_flat({k: v for k, v in document["numbers"].items() if k != "sum"}))
        assert checksum([total(document)]) == Fraction(document["numbers"]["sum"])
        for _ in range(6):
            wrong = corrupted(
                document,
                rng,
                lambda path, fields=fields: path[0] in ("relation", "witness") and path[1] in fields,
            )
            wrong["numbers"]["sum"] = str(total(wrong))
            assert refused(wrong)


def _flat(tree):
    check_certificate.numbers(tree, seen := [])
    return seen


def test_the_sum_of_numbers_of_many_digits_is_written(rng):
    """The denominators of 150 samples have thousands of digits together, more than Python writes as text."""
    A = [["0.7", "0.123456789012345"], ["-0.123456789012345", "0.987654321098765"]]
    m = jb.LinearSystem(A, None, [[1, 0]], noise=0.1, horizon=150)
    y = np.round(rng.uniform(-0.1, 0.1, (151, 1)), 3)
    y[75:] += 1
    document = json.loads(certify(jb.parity_relations(m), np.zeros((151, 0)), y).to_json())
    check_certificate.confirm(document)
    assert document["certificate"] == "FAULT" and refused(corrupted(document, rng))


def test_the_other_verdict_is_not_confirmed(rng):
    for status, other in ((Status.FAULT, "CONSISTENT"), (Status.CONSISTENT, "FAULT")):
        (c,) = certificates("two residuals", status, 1, rng)
        assert refused(json.loads(c.to_json()) | {"certificate": other})


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_exact_window_is_what_the_kernel_reads(dtype, rng):
    relations, _ = plant("leak")
    u, y = (x.astype(dtype) for x in window(relations, 0.1, rng))
    rows = relations.reading(dtype, "box").block(u[..., None], y[..., None])
    for limits, mid, rad in zip(exact_window(relations, u, y).limits, rows[0], rows[1], strict=True):
        mid, rad = float(np.ravel(mid)[0]), float(np.ravel(rad)[0])
        assert np.isnan(mid) == (limits is None)
        if limits is not None:
            size, ulps = max(map(abs, limits)), 64 * float(np.finfo(dtype).eps)
            assert (
                abs(mid - float(sum(limits)) / 2) <= ulps * size
                and abs(rad - float(limits[1] - limits[0]) / 2) <= ulps * size
            )


@pytest.mark.parametrize("name, horizon", [("paper", 1), ("offsets", 1), ("three states", 2)])
def test_the_smallest_error_of_a_sensor_is_where_a_linear_program_turns(name, horizon, rng):
    relations, oracle = (
        jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon),
        Windows(Plant(**MODELS[name]), horizon),
    )
    u, _, y = draw(oracle.plant, horizon, 25, rng, level=1.0, spread=20.0)
    bounds, checked = oracle.noise, 0

    def slack(i, error):
        oracle.noise = bounds + error * (np.arange(len(bounds)) == i)
        return oracle.slack(window_u[None], window_y[None])[0]

    for window_u, window_y in zip(u, y, strict=True):
        c = certify(relations, window_u, window_y)
        for i, (output, e) in enumerate(c.errors.items()):
            if c.status == Status.FAULT:
                assert slack(i, 0.9999 * float(e) if e < math.inf else 1e6) > 0, output
                assert e == math.inf or slack(i, 1.0001 * float(e)) < 0, output
                checked += 1
    assert checked > 10


def test_a_bias_points_at_its_sensor(rng):
    """Six states, three outputs: where only one sensor alone can be wrong, it is mostly the one that is."""
    relations, _ = plant("six states")
    u, y = window(relations, 0.0, rng)
    y[5:, 1] += 5.0
    c = certify(relations, u, y)
    assert c.candidates[0] == "y2" and c.errors["y2"] <= 5 + 2 * 0.2


def test_an_error_beyond_the_reading_itself():
    """The limit of a reading changes its slope where it passes zero: the error is exact there too."""
    relations = jb.parity_relations(
        jb.LinearSystem([[1]], None, [[1], [1]], tolerance=["1/2", 0], noise="1/8"), 0
    )
    c = certify(relations, np.zeros((1, 0)), np.array([[1.0, -3.0]]))
    # y2 says t <= -3 + 1/8; y1 - e - 1/8 - .. must reach that: 1 - 1/8 - e <= -(23/8) (1 - 1/2)
    tiny = Fraction(1, 10**12)
    assert abs(c.errors["y1"] - (Fraction(7, 8) + Fraction(23, 16))) < tiny
    # y1 says t >= (7/8) / (3/2); y2 + 1/8 + e must reach that
    assert abs(c.errors["y2"] - (3 - Fraction(1, 8) + Fraction(7, 12))) < tiny


def test_the_certificate_agrees_with_the_verdict_under_disturbance(rng):
    relations = jb.parity_relations(paper(disturbance=([[0], [1]], [[-0.02, 0.05]])), 2)
    windows = [window(relations, 0.03, rng, bias=float(b)) for b in rng.uniform(0, 3, 60)]
    res = jb.detect(relations, *(np.stack(x) for x in zip(*windows, strict=True)))
    assert {Status.FAULT, Status.CONSISTENT} <= set(res.status[:, 2].tolist())
    for i, (status, margin) in enumerate(zip(res.status[:, 2], res.margin[:, 2], strict=True)):
        if status in (Status.FAULT, Status.CONSISTENT) and not np.isnan(res.u[i]).any():
            c = res.explain((i, 2))
            assert c.status == c.proves == status and float(c.factor) == pytest.approx(1 - margin, rel=1e-9)


@pytest.mark.parametrize("name", ["disturbance"])
def test_the_certificate_agrees_with_the_verdict_of_a_long_window(name, rng):
    """A search may stop at a relation that proves the verdict before it has the tightest one: its factor is a
    bound from below.
    """
    relations, gaps = plant(name)
    windows = [window(relations, gaps, rng, bias=float(b)) for b in rng.uniform(0, 4, 9)]
    res = jb.detect(relations, *(np.stack(x) for x in zip(*windows, strict=True)), margins="exact")
    s = relations.horizon
    decided = np.flatnonzero(np.isin(res.status[:, s], (Status.FAULT, Status.CONSISTENT)))
    assert len(decided) > 6
    for i in decided.tolist():
        c = res.explain((i, s))
        assert c.proves == res.status[i, s] and 1 - res.margin[i, s] <= float(c.factor) * (1 + 1e-7)


def test_a_witness_tells_disturbances_and_missing_inputs(rng):
    relations, _ = plant("leak")
    u, y = window(relations, 0.0, rng)
    u[1, 0] = np.nan
    c = certify(relations, u, y)
    assert len(c.disturbances) == 4 and len(c.outputs) == 5 and len(c.inputs) == 5
    assert all(0 <= a <= Fraction(float("0.04")) for a, _ in c.disturbances)
    assert c.inputs[0] == tuple(map(Fraction, u[0].tolist())) and isinstance(c.inputs[1][0], Fraction)
    assert str(c).startswith("explained by the first state (")


def test_an_undecided_window_is_settled_exactly():
    """Circuits that need the missing input are silent, so detect cannot say CONSISTENT; the certificate
    can.
    """
    r = jb.parity_relations(paper(), 2)
    u, y = np.zeros((3, 1)), np.zeros((3, 2))
    u[1] = np.nan
    res = jb.detect(r, u, y)
    c = res.explain(2)
    assert c.status == Status.UNDECIDED and c.proves == Status.CONSISTENT and c.errors == {"y1": 0, "y2": 0}
    check_certificate.confirm(json.loads(c.to_json()))


def test_single_precision_is_certified_with_its_own_rounding(rng):
    r = jb.parity_relations(paper(resolution="1/300"), 1)
    u, y = (
        np.concatenate(x).astype(np.float32)
        for x in zip(*(window(r, 0.0, rng, 2.0 * (i % 2)) for i in range(20)), strict=True)
    )
    res = jb.detect(r, u, y)
    assert {Status.FAULT, Status.CONSISTENT} <= set(res.status.tolist()) and res.y.dtype == np.float32
    for k in range(1, 40, 2):
        if res.status[k] != Status.UNDECIDED:
            assert res.explain(k).proves == res.status[k]
            check_certificate.confirm(json.loads(res.explain(k).to_json()))


def test_a_disturbance_that_cannot_vary_is_an_equality(rng):
    for bound in ([[0, 0]], [["0.1", "0.1"]]):
        relations = jb.parity_relations(paper(disturbance=([[0], [1]], bound)), 2)
        for bias in (0.0, 5.0):
            c = certify(relations, *window(relations, 0.0, rng, bias))
            check_certificate.confirm(json.loads(c.to_json()))


def test_times_units_and_samples_are_named(rng):
    r = jb.parity_relations(paper(units={"y1": "°C"}, inputs="valve"), 1)
    res = jb.detect(r, np.zeros((5, 1)), np.zeros((5, 2)))
    names = json.loads(res.explain(3).to_json(times=["0.02 s", "0.03 s"]))["names"]
    assert names["units"] == {"y1": "°C"} and names["inputs"] == ["valve"]
    assert names["sample"] == [3] and names["times"] == ["0.02 s", "0.03 s"]


def test_numbers_are_exact_text(rng):
    (c,) = certificates("leak", Status.CONSISTENT, 1, rng)
    numbers = c.to_dict()["numbers"]
    assert numbers["offset_y"] == ["12.5", "-3.1", "1/3"] and numbers["A"] == [["1.02", "0.1"], ["0", "0.7"]]
    given = [v for row in c.window.y for v in [row] if v is not None]
    assert [Fraction(x) for row in numbers["y"] for x in row if x is not None] == given
    assert re.fullmatch(
        r"-?\d+(\.\d+)?", numbers["witness"]["state"][0]
    )  # few digits: the witness is rounded where it may be


def test_alarms_know_what_single_sensor_could_be_wrong(rng):
    u, y = np.zeros((30, 1)), np.zeros((30, 2))
    y[20:22, 0] += 2.0
    res = jb.detect(jb.parity_relations(paper()), u, y)
    (alarm,) = res.alarms()
    assert alarm.errors == res.explain(alarm.worst).errors and alarm.candidates[0] == "y1"
    assert 1.5 < alarm.errors["y1"] <= 2
    assert res.explain(-1).at == (29,) and res.explain(np.int64(21)).factor == res.explain(21).factor
    batch = jb.detect(jb.parity_relations(paper()), np.stack([u, u]), np.stack([0 * y, y])).alarms()
    assert [a.errors for a in batch] == [alarm.errors]
    with pytest.raises(ValueError, match="this alarm came without the result it was found in"):
        _ = Alarm(1, 2, 1, -1.0, 1).errors


def test_what_has_no_certificate_yet_is_refused():
    class Other:
        horizon = 1

    with pytest.raises(
        NotImplementedError, match="certificates are given for relations that detect knows, not Other"
    ):
        certify(Other(), np.zeros((2, 1)), np.zeros((2, 2)))
    r = jb.parity_relations(paper())
    with pytest.raises(
        NotImplementedError, match="the verdict of window 1 rests on more than its samples and bounds"
    ):
        certify(r, np.zeros((2, 1)), np.zeros((2, 2)), status=Status.FAULT)
    with pytest.raises(ValueError, match="window 1 is MISSING: there is nothing to explain"):
        certify(r, np.zeros((2, 1)), np.full((2, 2), np.nan))


def test_a_window_that_does_not_move_is_explained():
    m = jb.LinearSystem([[1]], None, [[1]], noise=0.1)
    c = certify(jb.parity_relations(m, 2), np.zeros((3, 0)), np.full((3, 1), 3.0))
    assert c.proves == Status.CONSISTENT and c.relation
