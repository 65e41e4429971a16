"""`jaxbound example`: files to try the commands on, the same each time, and true to what is said of them."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.cli import main
from jaxbound.cli.examples import EXAMPLES, JUMP, ONSET


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    return tmp_path


def table(path):
    return np.loadtxt(path, delimiter=",", skiprows=1)


def test_the_laboratory_keeps_its_bounds_and_has_one_fault(place, capsys):
    assert main.main(["example", "heater"]) == 0
    assert sorted(p.name for p in (place / "heater").glob("[!.]*")) == sorted(EXAMPLES["heater"].files)
    model = jb.load_model("heater/truth.toml")
    relations = jb.parity_relations(model)
    for name in ("healthy_1.csv", "healthy_2.csv", "healthy_3.csv"):
        res = jb.detect(relations, jb.read(f"heater/{name}", model))
        assert res.counts["CONSISTENT"] == 199 and res.counts["FAULT"] == 0
    healthy, faulty = table("heater/healthy_3.csv"), table("heater/jump.csv")
    wrong = faulty - healthy
    assert (
        not wrong[:, [0, 1, 2, 4]].any()
        and not wrong[:ONSET].any()
        and (abs(wrong[ONSET:, 3] - JUMP) < 0.011).all()
    )
    res = jb.detect(relations, jb.read("heater/jump.csv", model))
    assert not res.status[:ONSET].tolist().count(jb.Status.FAULT) and res.status[ONSET] == jb.Status.FAULT


def test_files_are_the_same_each_time_and_nothing_of_others_is_replaced(place, capsys):
    assert main.main(["example", "tank"]) == 0 and main.main(["example", "tank", "--out", "again"]) == 0
    assert (place / "tank/tank.csv").read_bytes() == (place / "again/tank.csv").read_bytes()
    res = jb.detect(jb.parity_relations(m := jb.load_model("tank/tank.toml")), jb.read("tank/tank.csv", m))
    assert (res.status[:200] != jb.Status.FAULT).all() and (res.status[200:260] == jb.Status.FAULT).any()
    assert (
        f" {EXAMPLES['tank'].first}\n" in capsys.readouterr().out
        and "--test horizon=15" in EXAMPLES["tank"].first
    )
    relations, run = jb.parity_relations(m, 15), jb.read("tank/tank.csv", m)
    proved = [
        certify(relations, run.u[k - 15 : k + 1], run.y[k - 15 : k + 1]).proves
        for k in (199, *range(200, 260, 7), 280)
    ]
    assert [p == jb.Status.FAULT for p in proved] == [False] + [True] * 9 + [
        False
    ]  # windows of 2 samples see the ends alone
    (place / "again/tank.csv").write_text("mine")
    assert main.main(["example", "tank", "--out", "again"]) == 2
    assert "again/tank.csv" in capsys.readouterr().err and (place / "again/tank.csv").read_text() == "mine"


def test_names_are_listed_and_an_unknown_one_is_a_sentence(capsys):
    assert main.main(["example"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in EXAMPLES)
    assert main.main(["example", "boiler"]) == 2
    assert capsys.readouterr().err == "jaxbound: there is no example 'boiler': choose one of heater, tank\n"
