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
from jaxbound.certificates.checker.command import main as checker
from jaxbound.certificates.interface import certify
from jaxbound.cli import main

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


MODES = """
name = "plant"
dt = 1
[[outputs]]
name = "y"
noise = 0.1
[matrices]
A = [["0.9"]]
C = [[1]]
[[test]]
name = "cooling"
horizon = 2
when = "valve > 0"
[[test]]
name = "rest"
horizon = 2
when = "otherwise"
[test.model.matrices]
A = [["0.5"]]
"""


@pytest.fixture
def at_rest(tmp_path):
    """Return (its folder, result): a plant at rest, which the model of another mode contradicts, that cools
    from sample 8 on; of three samples nobody knows the mode.
    """
    (tmp_path / "m.toml").write_text(MODES)
    y = [8 * 0.5**k for k in range(8)] + [5 * 0.9**k for k in range(8)]
    valve = ["0"] * 8 + [""] * 3 + ["1"] * 5
    rows = [f"{k},{a!r},{v}" for k, (a, v) in enumerate(zip(y, valve, strict=True))]
    (tmp_path / "d.csv").write_text("time,y,valve\n" + "\n".join(rows) + "\n")
    bank = jb.monitor(tmp_path / "m.toml")
    return tmp_path, jb.detect(bank, jb.read(tmp_path / "d.csv", bank.model))


def both_say(folder, document):
    """Return the exit code of `jaxbound verify`, and that of the checker beside it."""
    (folder / "c.json").write_text(json.dumps(document))
    about = [str(folder / "c.json"), "--model", str(folder / "m.toml"), "--data", str(folder / "d.csv")]
    return main.main(["verify", *about]), checker(about)


def test_a_certificate_of_a_monitor_names_its_test_and_is_confirmed(at_rest, capsys):
    folder, result = at_rest
    assert result.counts["FAULT"] == 0
    for k, test, beside in ((5, "rest", 1), (14, "cooling", 0)):
        document = json.loads(result.explain(k).to_json())
        assert document["test"] == result.test_at(k) == test
        assert both_say(folder, document) == (0, beside)
    assert "model of a test is more than this script reads" in capsys.readouterr().err


@pytest.mark.parametrize(
    "k, test, why", [(5, "cooling", "does not hold at 3 s"), (10, "rest", "another mode may hold, at 8 s")]
)
def test_a_fault_by_a_test_whose_condition_is_not_known_to_hold_is_refused(at_rest, k, test, why, capsys):
    folder, result = at_rest
    stated = {"A": [["0.9"]]} if test == "cooling" else {"A": [["0.5"]]}
    own = jb.LinearSystem(**stated, B=None, C=[[1]], noise="0.1", outputs=["y"], dt=1, name="plant")
    y = np.asarray(result.y)
    document = jb.detect(jb.parity_relations(own, 2), None, y).explain(k).to_dict()
    assert document["certificate"] == "FAULT"
    assert both_say(folder, document | {"test": test}) == (1, 1)
    err = capsys.readouterr().err
    assert why in err and ("not known to hold at sample 3" in err) == (test == "cooling")
    assert both_say(folder, document) == (1, 1)
    assert "the certificate names no test" in capsys.readouterr().err


def test_certificates_in_python_are_of_the_bounds_of_their_test():
    plant = dict(A=[["0.9"]], B=None, C=[[1]], noise="0.1")
    y = [[1.0], [0.9], [0.81], [2.0], [0.7]]
    stated = jb.LinearSystem(**plant, tests=[{"name": "a", "horizon": 1, "factor": "0.5"}, {"name": "b"}])
    for model in (stated, jb.LinearSystem(**plant)):  # of a model without tests one is made
        certificate = jb.detect(jb.monitor(model), None, y).explain(3)
        assert certificate.test in ("a", "windows")
        verify(json.loads(certificate.to_json()), model, None, y)


CLOCKS = {
    "seconds": ("time", [str(k + 600 * (k > 4)) for k in range(10)]),
    "stamps": ("logged", [f"2026-03-01T00:00:{k + 20 * (k > 4):02}" for k in range(10)]),
    "an hour back": ("t", [f"2026-03-01T00:00:0{k}+0{1 + (k > 4)}:00" for k in range(10)]),
    "an offset that begins": ("t", [f"2026-03-01T00:00:0{k}" + "+00:00" * (k > 4) for k in range(10)]),
    "not read here": ("when", [f"1.3.2026 00:00:{k + 20 * (k > 4):02}" for k in range(10)]),
}


STEADY = {
    "no gap": ("Time [s]", [str(k) for k in range(10)]),
    "an epoch": ("timestamp", [str(1_772_323_200_000 + 1000 * k) for k in range(10)]),
    "one offset": ("stamped", [f"2026-03-01T00:00:0{k}+01:00" for k in range(10)]),
    "a count": ("shift", [str(10 + 2 * k) for k in range(10)]),
}


@pytest.mark.parametrize("kind", [*CLOCKS, *STEADY])
def test_the_checker_beside_jaxbound_sees_a_gap_that_no_name_tells(kind, tmp_path, capsys):
    called, times = {**CLOCKS, **STEADY}[kind]
    y = [3 * 0.9**k for k in range(5)] + [50 * 0.9**k for k in range(5)]
    rows = [f"{time},{a!r},{k % 3}" for k, (time, a) in enumerate(zip(times, y, strict=True))]
    (tmp_path / "d.csv").write_text(f"{called},y,state\n" + "\n".join(rows) + "\n")
    (tmp_path / "m.toml").write_text(MODES.split("[[test]]")[0])
    model = jb.load_model(tmp_path / "m.toml")
    document = jb.detect(jb.parity_relations(model, 2), None, np.array(y)[:, None]).explain(5).to_dict()
    assert document["certificate"] == "FAULT"
    codes = both_say(tmp_path, document)
    assert codes == ((0, 0) if kind in STEADY else (1, 1)), capsys.readouterr().err
    if kind == "no gap":
        (tmp_path / "d.csv").write_text(f"{called},y,date\n" + "\n".join(rows) + "\n")
        assert both_say(tmp_path, document)[1] == 1
        assert "Time [s] and date look like times" in capsys.readouterr().err


def test_windows_of_a_model_with_tests_are_confirmed_by_the_model_of_their_report(at_rest, capsys):
    folder, _ = at_rest
    run = ["detect", str(folder / "m.toml"), str(folder / "d.csv"), "--out", str(folder / "r"), "-q"]
    main.main([*run, "--test", "horizon=2"])
    assert main.main(["explain", str(folder / "r"), "--at", "5"]) == 0
    about = [str(folder / "r/certificate-5.json"), "--data", str(folder / "d.csv")]
    for model, code in ((folder / "r/tested_model.toml", 0), (folder / "m.toml", 1)):
        assert main.main(["verify", *about, "--model", str(model)]) == code
        assert checker([*about, "--model", str(model)]) == code
