"""The fleet: every unit gets its row whatever happens to the others, the worst first, and one shape compiles
once.
"""

import csv
import json
import math
import re

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.consistency import strips
from jaxbound.models.modelfile import save_model
from jaxbound.recordings.read import read
from jaxbound.runs import ask, fleet
from jaxbound.runs.fleet import Unit, UnitResult, detect_fleet, fleet_verdict, read_manifest, worst_first
from jaxbound.runs.summary import Summary, Window


def unit_model(rng):
    near = lambda x: float(f"{x * rng.uniform(0.9, 1.1):.4g}")
    return paper(
        A=[[near(0.8), near(1)], [0, near(0.2)]],
        B=[[0], [near(1)]],
        C=[[near(1), 0], [near(1), near(1)]],
        dt=1,
    )


def recorded(model, rng, samples=120, bias=0.0):
    """Return CSV text of a healthy run with errors just inside the bounds, y1 biased in the second half."""
    A, B, C = (np.array([[float(x) for x in row] for row in a]) for a in (model.A, model.B, model.C))
    x, lines = np.zeros(2), ["t,u1,y1,y2"]
    for k in range(samples):
        u, error = rng.uniform(-1, 1), 0.99 * rng.uniform(-1, 1, 4)
        y = (1 + error[:2] * [0.02, 0.1]) * (C @ x) + error[2:] * [0.1, 0.01]
        y[0] += bias * (k >= samples // 2)
        lines.append(f"{k},{u!r},{float(y[0])!r},{float(y[1])!r}")
        x = A @ x + B[:, 0] * u
    return "\n".join(lines) + "\n"


@pytest.fixture(autouse=True)
def unconfigured(monkeypatch):
    monkeypatch.setattr(main, "_configure", lambda: None)


@pytest.fixture
def plant(tmp_path):
    """Return a folder with a manifest of units that are healthy, faulty, silent, and wrong in several
    ways.
    """
    rng = np.random.default_rng(7)
    units = ["good", "small", "large", "silent", "no-model", "no-data", "bad-model", "bad-data", "short"]
    for name in units:
        model = unit_model(rng)
        save_model(model, tmp_path / f"{name}.toml")
        text = recorded(model, rng, bias={"small": 2.0, "large": 9.0}.get(name, 0.0))
        if name == "silent":
            text = (
                "\n".join(
                    line if k < 3 else line.rsplit(",", 2)[0] + ",,"
                    for k, line in enumerate(text.splitlines())
                )
                + "\n"
            )
        (tmp_path / f"{name}.csv").write_text(text)
    (tmp_path / "no-model.toml").unlink()
    (tmp_path / "no-data.csv").unlink()
    (tmp_path / "bad-model.toml").write_text("dt = 1\n")
    (tmp_path / "bad-data.csv").write_text("t,u1,y1\n0,1,2\n")
    (tmp_path / "short.csv").write_text("t,u1,y1,y2\n0,1,2,3\n")
    manifest(tmp_path, units)
    return tmp_path


def manifest(folder, units, name="fleet.csv"):
    (folder / name).write_text("unit,model,recording\n" + "".join(f"{u},{u}.toml,{u}.csv\n" for u in units))
    return folder / name


def command(folder, *options, name="fleet.csv"):
    return main.main(["fleet", str(folder / name), "--out", str(folder / "out"), *options])


def table(folder):
    with open(folder / "out" / "fleet.csv", newline="", encoding="utf-8") as f:
        return {row["unit"]: row for row in csv.DictReader(f)}


class TestCommand:
    def test_every_unit_gets_its_row_the_worst_first(self, plant, capsys):
        assert command(plant) == 1
        rows = table(plant)
        assert list(rows)[:2] == ["large", "small"] and list(rows)[-2:] == ["silent", "good"]
        assert [r["verdict"] for r in rows.values()] == ["fault"] * 2 + ["not tested"] * 5 + [
            "too little evidence",
            "no fault",
        ]
        sentences = {
            "no-model": "there is no model file",
            "no-data": "there is no data file",
            "bad-model": "the table [matrices] is missing",
            "bad-data": "no column 'y2'",
            "short": "the file has one row of data",
        }
        assert all(text in rows[unit]["sentence"] for unit, text in sentences.items())
        assert (
            float(rows["large"]["margin"])
            < float(rows["small"]["margin"])
            < 0
            < float(rows["good"]["margin"])
        )
        assert (
            rows["large"]["first_alarm"] == "60 s"
            and rows["good"]["FAULT"] == "0"
            and rows["no-data"]["margin"] == ""
        )
        out = capsys.readouterr().out
        assert out.startswith(
            "9 units listed: 2 with a proved fault, 1 with no fault found, 1 with too little evidence, "
            "5 could not be tested; the worst is large."
        )
        page = (plant / "out" / "fleet.html").read_text()
        links = re.findall('href="(units/[^"]*)"', page)
        assert len(links) == page.count('data-verdict="fault"') > 0 and all(
            "Fault proved" in (plant / "out" / link).read_text() for link in links
        )
        assert page.index(">large<") < page.index(">small<") < page.index(">no-data<") < page.index(">good<")

    @pytest.mark.parametrize(
        "units, code",
        [
            (["good"], 0),
            (["good", "small"], 1),
            (["good", "no-data"], 2),
            (["silent", "no-data"], 2),
            (["good", "silent"], 3),
            (["no-data", "small", "silent"], 1),
        ],
    )
    def test_the_exit_code_tells_the_worst(self, plant, units, code):
        manifest(plant, units)
        assert command(plant) == code

    def test_a_unit_is_judged_as_by_detect_alone(self, plant):
        for result in detect_fleet(read_manifest(manifest(plant, ["good", "small", "silent"]))):
            model = jb.load_model(result.unit.model)
            r = read(result.unit.recording, model)
            alone = jb.detect(jb.parity_relations(model), r.u, r.y)
            assert result.summary.counts == alone.counts
            assert result.margin == np.nanmin(alone.margin) and result.summary.alarms == len(alone.alarms())

    def test_json(self, plant, capsys):
        assert command(plant, "--json") == 1
        found = json.loads(capsys.readouterr().out)
        assert found["verdict"] == "fault" and found["exit_code"] == 1
        assert [u["unit"] for u in found["units"]] == list(table(plant)) and found["units"][2][
            "margin"
        ] is None

    def test_a_gap_and_a_frozen_sensor_are_told(self, plant):
        lines = (plant / "good.csv").read_text().splitlines()
        y = lines[21].split(",")[2]
        frozen = [",".join([*row[:2], y, row[3]]) for row in (line.split(",") for line in lines[21:51])]
        (plant / "good.csv").write_text("\n".join([*lines[:21], *frozen, *lines[51:80], *lines[95:]]) + "\n")
        manifest(plant, ["good"])
        command(plant)
        row = table(plant)["good"]
        assert (
            row["MISSING"] == "2"
            and "the recording has a gap of 16 s" in row["hints"]
            and "for 30 samples" in row["hints"]
        )

    def test_an_interrupt_keeps_what_was_tested(self, plant, monkeypatch, capsys):
        detect, calls = ask.detect, []

        def interrupted(*args, **kwargs):
            calls.append(1)
            if len(calls) == 2:
                raise KeyboardInterrupt
            return detect(*args, **kwargs)

        monkeypatch.setattr(ask, "detect", interrupted)
        assert command(plant) == 130
        rows = table(plant)
        assert (
            rows["good"]["verdict"] == "no fault"
            and rows["large"]["sentence"] == "interrupted before its turn"
        )
        assert "1 of 9 units were tested" in capsys.readouterr().err

    def test_trouble_of_our_own_costs_one_unit_only(self, plant, monkeypatch):
        opened = fleet.open_source
        monkeypatch.setattr(
            fleet, "open_source", lambda path, m: {}["oops"] if "no-data" in m.name else opened(path, m)
        )
        save_model(paper(name="no-data"), plant / "no-data.toml")
        manifest(plant, ["good", "no-data", "small"])
        assert command(plant) == 1
        assert table(plant)["no-data"]["sentence"] == "internal error, please report it: KeyError: 'oops'"

    def test_names_are_text_not_markup(self, plant, capsys):
        (plant / "fleet.csv").write_text("unit,model,recording\n<b>[red]P,good.toml,good.csv\n")
        assert command(plant) == 0
        assert (
            "&lt;b&gt;[red]P" in (plant / "out" / "fleet.html").read_text()
            and "<b>[red]P" in capsys.readouterr().out
        )


@pytest.mark.compiled
def test_models_of_one_shape_share_one_compilation(tmp_path):
    rng = np.random.default_rng(1)
    units = [f"P{i}" for i in range(12)]
    for i, name in enumerate(units):
        model = unit_model(rng)
        save_model(model, tmp_path / f"{name}.toml")
        (tmp_path / f"{name}.csv").write_text(
            recorded(model, rng, 40 + 10 * i)
        )  # and recordings of any length
    chosen = read_manifest(manifest(tmp_path, units))
    before = strips.verdicts._cache_size()
    first = list(detect_fleet(chosen[:1]))
    traced = strips.verdicts._cache_size()
    rest = list(detect_fleet(chosen[1:]))
    assert traced <= before + 1 and strips.verdicts._cache_size() == traced
    assert [r.verdict for r in first + rest] == ["no fault"] * 12


def test_units_may_share_a_model_which_is_loaded_once(plant, monkeypatch):
    loaded, load = [], fleet.load_model
    monkeypatch.setattr(fleet, "load_model", lambda path: loaded.append(path) or load(path))
    units = [Unit(f"{k}", plant / "good.toml", plant / "good.csv") for k in range(5)]
    shares = []
    assert [r.verdict for r in detect_fleet(units, progress=shares.append)] == ["no fault"] * 5
    assert len(loaded) == 1 and shares == [0.2, 0.4, 0.6, 0.8, 1.0]


class TestManifest:
    def test_toml_is_the_same(self, plant):
        blocks = "".join(
            f'[[units]]\nunit = "{u}"\nmodel = "{u}.toml"\nrecording = "{u}.csv"\n' for u in ("good", "small")
        )
        (plant / "fleet.toml").write_text(blocks)
        assert read_manifest(plant / "fleet.toml") == read_manifest(manifest(plant, ["good", "small"]))

    @pytest.mark.parametrize(
        "text",
        [
            "recording;unit;model\nr.csv;P 1;m.toml\n",
            "unit\tmodel\trecording\nP 1\tm.toml\tr.csv\n",
            "\n unit , model , recording \n\n P 1 , m.toml , r.csv \n\n",
            '\ufeffunit,model,recording\r\n"P 1",m.toml,r.csv\r\n',
        ],
    )
    def test_spreadsheets_write_it_in_many_ways(self, tmp_path, text):
        (tmp_path / "m.csv").write_bytes(text.encode())
        assert read_manifest(tmp_path / "m.csv") == [Unit("P 1", tmp_path / "m.toml", tmp_path / "r.csv")]

    @pytest.mark.parametrize(
        "name, text, message",
        [
            ("m.csv", "", "the manifest is empty: it needs the columns unit, model, recording"),
            ("m.csv", "unit,model,recording\n", "the manifest names no unit: it has a header but no row"),
            (
                "m.csv",
                "unit,model,recording,site\nP,m,r,s\n",
                "the manifest has the unknown column 'site'; known columns are unit, model",
            ),
            ("m.csv", "unit,model\nP,m\n", "the manifest has no column 'recording'"),
            ("m.csv", "unit,unit,model,recording\nP,P,m,r\n", "the manifest has 2 columns 'unit'"),
            ("m.csv", "unit,model,recording\nP,m.toml\n", "row 2 has 2 cells, the header has 3 columns"),
            ("m.csv", "unit,model,recording\nP,,r.csv\n", "row 2 has no model"),
            (
                "m.csv",
                "unit,model,recording\nP,m,r\nQ,m,r\nP,m,s\n",
                "row 4 names unit 'P', as row 2 does: every unit needs a name of its own",
            ),
            ("m.csv", "P,m.toml,r.csv\n", "the manifest has the unknown column 'P'"),
            ("m.toml", "", "the manifest names no unit"),
            ("m.toml", "units = 3", "units must be a list of blocks"),
            ("m.toml", "[[unit]]\nunit = 'P'", "the manifest has the unknown field 'unit'"),
            (
                "m.toml",
                "[[units]]\nunit = 1\nmodel = 'm'\nrecording = 'r'",
                "unit of number 1 of units must be text in quotes, not 1",
            ),
            ("m.toml", "[[units]]\nunit = 'P'\nmodel = 'm'", "number 1 of units has no column 'recording'"),
            ("m.toml", "[[units", "this is not valid TOML"),
        ],
    )
    def test_what_is_wrong_is_said_and_nothing_is_written(self, tmp_path, capsys, name, text, message):
        (tmp_path / name).write_text(text)
        assert command(tmp_path, name=name) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert message in said and name in said and not (tmp_path / "out").exists()

    def test_no_such_manifest(self, tmp_path, capsys):
        assert command(tmp_path) == 2
        assert "there is no manifest" in capsys.readouterr().err
        (tmp_path / "m.csv").write_bytes(b"\xff\xfe\x00")
        assert command(tmp_path, name="m.csv") == 2


def test_the_order_is_by_verdict_then_margin():
    unit = lambda verdict, margin=math.nan: UnitResult(
        Unit(f"{verdict} {margin}", None, None), Summary(verdict, "", worst=Window(0, "", margin))
    )
    ordered = [
        unit("fault", -5.0),
        unit("fault", -0.1),
        unit("fault"),
        unit("not tested"),
        unit("too little evidence", 0.5),
        unit("no fault", 0.1),
        unit("no fault", 0.9),
    ]
    assert worst_first(ordered[::-1]) == ordered
    assert (
        fleet_verdict(ordered[3:])[:2] == ("not tested", 2)
        and fleet_verdict(ordered[4:])[1] == 3
        and fleet_verdict(ordered[5:])[1] == 0
    )
