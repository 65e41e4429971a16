"""The demonstration: rates beside the reference, and a report that detect repeats."""

import jax
import pytest

import jaxbound as jb
from jaxbound.cli import demonstration as demo
from jaxbound.cli import main
from jaxbound.models.modelfile import load_model
from jaxbound.recordings.read import read


@pytest.fixture(scope="module")
def rates():
    """Return the detection rates of 400 runs."""
    return demo.detection_rates(400, jax.random.key(11))


def test_rates_are_those_of_the_reference(rates):
    for name, found in rates[0].items():
        for rate, reference in zip(found, demo.REFERENCE[name], strict=True):
            assert (
                abs(rate - reference) < 0.03
            )  # 400 runs of 39 dependent windows: about four standard deviations


def test_reference_is_golden(golden):
    for name, (joint, box) in demo.REFERENCE.items():
        rates = golden["p0"]["scenario_mc"]["hold20"][name]
        assert abs(rates["rate_joint"] - joint) < 5.1e-4 and abs(rates["rate_box"] - box) < 5.1e-4


def test_joint_test_sees_more_and_never_errs(rates):
    assert all(joint > box for joint, box in rates[0].values()) and rates[1] == (0, 400 * 77)


def test_the_run_is_written_exactly(tmp_path):
    run = demo.demo_run(jax.random.key(0))
    demo.write_run(tmp_path / "run.csv", run)
    r = read(tmp_path / "run.csv", demo.demo_model())
    assert (r.u == run.u).all() and (r.y == run.y).all() and r.hints == () and abs(r.time[-1] - 2) < 1e-12


def test_command_writes_a_report_that_detect_repeats(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(main, "_configure", lambda: None)
    assert main.main(["demo", "--out", str(tmp_path / "out"), "--runs", "400"]) == 0
    out = capsys.readouterr().out
    assert (
        "reference" in out
        and "0.150" in out
        and "jaxbound detect" in out
        and str(tmp_path / "out" / "report.html") in out
    )
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {
        "model.toml",
        "run.csv",
        "verdicts.csv",
        "alarms.csv",
        "report.html",
        "run.json",
        "tested_model.toml",
        "figure_1.png",
        "figure_2.png",
        ".jaxbound.json",
    }
    assert load_model(tmp_path / "out" / "model.toml").A == demo.demo_model().A
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count('<figure><img alt="') == 2 and "How often are these faults seen?" in page
    assert (
        main.main(
            [
                "detect",
                str(tmp_path / "out/model.toml"),
                str(tmp_path / "out/run.csv"),
                "--out",
                str(tmp_path / "again"),
            ]
        )
        == 1
    )
    assert (tmp_path / "again/verdicts.csv").read_bytes() == (tmp_path / "out/verdicts.csv").read_bytes()
    assert jb.parity_relations(demo.demo_model()).horizon == 1
