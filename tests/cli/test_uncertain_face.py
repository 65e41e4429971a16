"""Models with uncertain parameters at the command line and in the report."""

import json
import re

import check_certificate
import numpy as np
import pytest
from uncertain_systems import EXAMPLE, model

import jaxbound as jb
from jaxbound.cli.main import main


@pytest.fixture
def path(tmp_path):
    jb.save_model(model("n2p1_paper_h3", noise=0.01), tmp_path / "m.toml")
    return tmp_path / "m.toml"


def test_info_lists_parameters_and_relations(path, capsys):
    assert main(["info", str(path)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "th in [-1, 1], varies" in out and "vt in [-1, 1], constant" in out
    assert "1 independent, polynomials of order 1 in 3 uncertain numbers" in out
    assert (
        "r1: (0.16 + 0.02 th[k-2]) y1[k-2] - (1 + 0.1 th[k-1]) y1[k-1] + y1[k] - (1 + 0.1 vt) u1[k-2] = 0"
        in out
    )


def test_a_report_shows_parameters_and_residuals_and_explain_proves_them(path, tmp_path, rng, capsys):
    u, x, y = rng.uniform(0, 2, (60, 1)), np.zeros(2), np.where(np.arange(60) == 30, 50.0, 0.0)
    for k in range(60):
        y[k] += x[0]
        x = np.array(EXAMPLE["A"]) @ x + np.array(EXAMPLE["B"]) @ u[k]
    np.savetxt(
        tmp_path / "d.csv",
        np.column_stack([np.arange(60), u, y]),
        delimiter=",",
        header="time,u1,y1",
        comments="",
    )
    assert main(["detect", str(path), str(tmp_path / "d.csv"), "--out", str(tmp_path / "out")]) == 1
    page = (tmp_path / "out" / "report.html").read_text()
    row = next(row for row in re.findall("<tr>(.*?)</tr>", page, re.S) if ">vt<" in row)
    assert re.findall("<t[hd][^>]*>(.*?)</t[hd]>", row) == ["vt", "-1", "1", "is constant", "C"]
    assert "polynomials of order 1 in 3 uncertain numbers" in page
    capsys.readouterr()
    for sample, says in (
        (30, ("FAULT proved", "violated", "is in [")),
        (20, ("parameters", "th[k-1]", "vt", "first state")),
    ):
        assert main(["explain", str(tmp_path / "out"), "--at", str(sample)]) == 0
        printed = capsys.readouterr().out
        assert all(x in printed for x in says)
        check_certificate.confirm(json.loads((tmp_path / "out" / f"certificate-{sample}.json").read_text()))
