"""A look at a recording before there is a model: what it says of whatever is wrong with one."""

import os
import shlex

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.plots.every import plot
from jaxbound.recordings import look as looking
from jaxbound.recordings.signals import Signals

T = 120


def frame(rng):
    table = pd.DataFrame({"Time": pd.date_range("2026-03-01 08:00", periods=T, freq="3s")})
    table["Heater [%]"] = np.repeat([0.0, 60.0, 20.0, 80.0], 30)
    table["wind"] = (350.0 + np.arange(T) + np.round(rng.normal(size=T), 1)) % 360
    table["pulses"] = (65_402 + 5 * np.arange(T)) % 65_536
    table["total"] = 1000 + np.cumsum(rng.integers(0, 3, T))
    table["T"] = np.round(20 + np.cumsum(rng.normal(size=T)), 1)
    table["T2"] = 20 + rng.normal(size=T)
    table.loc[40:69, "T2"] = table["T2"][40]
    table.loc[7, "T2"] = -9999
    table.loc[[3, 4], "T"] = np.nan
    table["state"] = "running"
    return table


@pytest.fixture
def path(tmp_path, rng):
    frame(rng).to_csv(tmp_path / "run.csv", index=False)
    return tmp_path / "run.csv"


def marks(found):
    return {column.name: [finding.mark for finding in column.findings] for column in found.columns}


def test_each_column_is_told(path):
    found = jb.look(path)
    assert found.how == "UTF-8, cells between ',', names in row 1"
    assert (found.time, found.samples, found.dt) == ("Time", T, 3.0)
    assert (found.first, found.last) == ("2026-03-01 08:00:00", "2026-03-01 08:05:57")
    columns = {column.name: column for column in found.columns}
    assert (columns["Heater [%]"].unit, columns["T"].missing, columns["state"].kind) == ("%", 2, "text")
    assert columns["T"].resolution == pytest.approx(0.1) and columns["Heater [%]"].high == 80
    assert marks(found) == {
        "Heater [%]": [],
        "wind": ["angle?"],
        "pulses": ["counter?"],
        "total": ["counter?"],
        "T": [],
        "T2": ["no number?", "frozen"],
        "state": [],
    }


def test_the_command_is_one_to_go_on_with(path, capsys, tmp_path):
    found = jb.look(path)
    entries = "'wind=angle(wind),pulses=rate(pulses, 65536),total=rate(total),T,T2'"
    assert found.command == f"jaxbound fit {path} --inputs 'Heater [%]' --outputs {entries} --out plant.toml"
    assert dict(found.rows())["go on"] == found.command


def test_names_of_what_a_plant_is_told_and_of_what_surrounds_it_are_those_of_inputs(rng):
    names = ["Cooling Set Point", "FCV SP", "valve_cmd", "Outdoor Air", "Supply Air", "spin", "Temperatur"]
    found = jb.look({name: rng.uniform(0, 1, 60) for name in names}, dt=1)
    inputs, _, outputs = found.command.partition(" --inputs ")[2].partition(" --outputs ")
    assert inputs == f"'{','.join(names[:4])}'"
    assert outputs.startswith(f"'{','.join(names[4:])}' ")


@pytest.mark.parametrize("kind", ["parquet", "folder", "table"])
def test_every_kind_of_recording_looks_the_same(tmp_path, rng, kind):
    table = frame(rng)
    table.to_csv(tmp_path / "run.csv", index=False)
    data = table
    if kind != "table":
        data = tmp_path / "run.parquet" if kind == "parquet" else tmp_path / "run"
        (tmp_path / "run").mkdir()
        table[:50].to_parquet(tmp_path / "run" / "1.parquet")
        table[50:].to_parquet(tmp_path / "run" / "2.parquet")
        table.to_parquet(tmp_path / "run.parquet")
    one, other = jb.look(tmp_path / "run.csv"), jb.look(data)
    assert [str(column.plain()) for column in one.columns] == [
        str(column.plain()) for column in other.columns
    ]
    assert (one.samples, one.dt, one.first, one.time) == (other.samples, other.dt, other.first, other.time)


def test_a_column_that_cannot_be_read_does_not_hide_the_others(tmp_path):
    lines = ["time,a,b,c", *(f"{k},{k % 5}.5,{k % 7},{k % 3}" for k in range(40))]
    lines[9] = "8,3.5,inf,2"
    (tmp_path / "run.csv").write_text("\n".join([*lines, ""]))
    found = jb.look(tmp_path / "run.csv")
    columns = {column.name: column for column in found.columns}
    assert [columns[name].kind for name in "abc"] == ["number", "unread", "number"]
    assert "row 10 of column 'b' is infinite" in columns["b"].findings[0].sentence
    assert "b" not in found.command.split("--outputs")[1].split(" --out ")[0]


def test_words_in_few_cells_are_proposed_for_missing_samples(tmp_path):
    lines = ["time,a,b", *(f"{k},{k % 5}.5,{k % 7}" for k in range(40))]
    lines[9] = "8,3.5,Bad"
    (tmp_path / "run.csv").write_text("\n".join([*lines, ""]))
    found = jb.look(tmp_path / "run.csv")
    b = found.columns[1]
    assert (b.kind, b.missing, b.findings[0].mark) == ("number", 1, "words")
    assert 'missing = ["Bad"]' in found.table and "--recording missing=Bad" in found.command
    run = jb.read(tmp_path / "run.csv", Signals((), ("b",), {}, 1.0), recording={"missing": "Bad"})
    assert np.isnan(run.y[8, 0])


def test_numbers_in_a_notation_of_their_own_are_not_proposed_for_missing_samples(tmp_path):
    cells = [f"{k}.5 %" if k % 4 == 0 else f"{k}.5" for k in range(40)]
    (tmp_path / "run.csv").write_text(
        "time,u,y\n" + "".join(f"{60 * k},1,{y}\n" for k, y in enumerate(cells))
    )
    found = jb.look(tmp_path / "run.csv")
    assert "missing" not in found.table and found.columns[1].marks == ["not read"]


def test_a_counter_of_rows_is_no_signal_and_a_row_a_tag_is_suspected(tmp_path):
    lines = ["time,n,a", *(f"{k},{k + 7},{k % 5}.5" for k in range(40))]
    (tmp_path / "run.csv").write_text("\n".join([*lines, ""]))
    found = jb.look(tmp_path / "run.csv")
    assert found.columns[0].marks == ["count?"] and "--outputs a --out" in found.command
    lines = ["time,tag,value", *(f"{k},{tag},{k % 5}.5" for k in range(40) for tag in "abc")]
    (tmp_path / "run.csv").write_text("\n".join([*lines, ""]))
    assert any("--long tag,value" in hint for hint in jb.look(tmp_path / "run.csv").hints)


def test_what_is_wrong_with_the_file_is_said_as_it_is(tmp_path):
    (tmp_path / "run.csv").write_text("time,a,b\n0,1,2\n1,2,3,4\n2,3,4\n")
    with pytest.raises(ValueError, match="row 3 has 4 cells, the header has 3 columns"):
        jb.look(tmp_path / "run.csv")


def test_steps_that_vary_get_an_interval_and_no_time_a_period(tmp_path):
    time = np.cumsum(np.tile([1, 2, 4], 30))
    rows = [f"{t},{k % 5}.5" for k, t in enumerate(time)]
    (tmp_path / "run.csv").write_text("\n".join(["time,a", *rows, ""]))
    found = jb.look(tmp_path / "run.csv")
    assert "--every 5s" in found.command and any("steps vary" in hint for hint in found.hints)
    (tmp_path / "bare.csv").write_text("\n".join(["a", *(f"{k % 5}.5" for k in range(40)), ""]))
    found = jb.look(tmp_path / "bare.csv")
    assert found.dt is None and found.time is None and "--dt SECONDS" in found.command
    assert "--dt 2" in jb.look(tmp_path / "bare.csv", dt=2).command


def test_gaps_are_told(tmp_path):
    rows = [f"{k + 50 * (k > 20)},{k % 5}.5" for k in range(40)]
    (tmp_path / "run.csv").write_text("\n".join(["time,a", *rows, ""]))
    assert any("gap of 51 s" in hint for hint in jb.look(tmp_path / "run.csv").hints)


def test_many_columns_stay_readable_at_80_letters(tmp_path, rng):
    names = [f"AHU number {k}: a long name of a column" for k in range(100)]
    pd.DataFrame(np.round(rng.normal(size=(30, 100)), 3), columns=names).to_csv(tmp_path / "run.csv")
    found = jb.look(tmp_path / "run.csv", dt=1)
    cells = list(found.cells())
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    assert sum(widths) + 4 * (len(widths) - 1) <= 80
    assert len(cells) < 50 and cells[-1][0].endswith("more") and len(set(cells[1][:1])) == 1
    assert len(found.command) < 1000


def test_the_command_prints_and_draws(path, tmp_path, capsys):
    assert main.main(["look", str(path), "--out", str(tmp_path / "run.html")]) == 0
    shown = capsys.readouterr().out
    assert "run.csv: 120 samples of 6 columns of numbers" in shown and "go on" in shown
    page = (tmp_path / "run.html").read_text()
    assert "Heater [%]" in page and "angle?" in page and "image/png" in page
    assert main.main(["look", str(path), "--out", str(tmp_path / "run.html")]) == 2  # not without --force
    assert main.main(["look", str(path), "--json"]) == 0
    assert '"mark": "counter?"' in capsys.readouterr().out


@pytest.fixture
def standard_input(tmp_path):
    """Return a function that lets a process read these bytes from its standard input."""
    before = os.dup(0)

    def send(data):
        (tmp_path / "sent").write_bytes(data)
        file = os.open(tmp_path / "sent", os.O_RDONLY)
        os.dup2(file, 0)
        os.close(file)

    yield send
    os.dup2(before, 0)
    os.close(before)


def test_a_stream_looks_like_a_file(path, standard_input, capsys, monkeypatch):
    assert main.main(["look", str(path)]) == 0
    shown = capsys.readouterr().out
    standard_input(path.read_bytes())
    assert main.main(["look", "-"]) == 0
    command = shown.replace(shlex.quote(str(path)), "FILE").replace("run.csv:", "standard input:")
    assert capsys.readouterr().out.split() == command.split()
    standard_input(b"")
    assert main.main(["look", "-"]) == 2
    assert capsys.readouterr().err == "jaxbound: the file is empty\n"
    monkeypatch.setattr(looking, "ENOUGH", 1 << 12)
    standard_input(path.read_bytes())
    found = jb.look("-")
    assert found.samples < T and found.hints[0].endswith("came and it had not ended: only these are shown")


def test_a_column_without_numbers_and_one_column_are_said_in_words(tmp_path):
    table = pd.DataFrame({"time": np.arange(5.0), "a": np.arange(5.0), "b": np.full(5, np.nan)})
    found = jb.look(table)
    assert [list(row[:2]) for row in found.cells()] == [["column", "range"], ["a", "0 .. 4"], ["b", ""]]
    assert found.columns[1].cells(9)[3] == "5 missing"
    assert jb.look(table[["time", "a"]]).extent == "5 samples of 1 column of numbers"


def test_a_picture_has_a_chart_of_each_column(path):
    figure = plot(jb.look(path))
    titles = [ax.get_title(loc="left") for ax in figure.axes if ax.get_visible()]
    assert len(titles) == 6 and titles[1].startswith("wind") and "angle?" in titles[1]


def test_fit_names_columns_that_are_no_levels(path):
    (run,) = jb.recordings.read.read_signals(path, ["pulses"], ["wind", "T"])
    assert [hint for hint in run.hints if "pulses=rate(pulses, 65536)" in hint]
    assert [hint for hint in run.hints if "wind=angle(wind)" in hint]
    (run,) = jb.recordings.read.read_signals(path, [("n", "= rate(pulses, 65536)")], ["T"])
    assert not [hint for hint in run.hints if "which is no level" in hint]


def test_the_table_to_keep_says_how_the_file_was_read(tmp_path):
    lines = [
        "TOA5;station",
        "Zeit;Pumpe;T",
        "TS;;degC",
        *(f"{k},5;{('ON', 'OFF')[k % 12 > 3]};{k % 7},25" for k in range(60)),
    ]
    (tmp_path / "run.csv").write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))
    found = jb.look(tmp_path / "run.csv")
    assert found.how.endswith("cells between ';', decimal comma, names in row 2")
    assert found.table.splitlines()[0] == "[recording]" and 'delimiter = ";"' in found.table
    assert {column.name: (column.low, column.high) for column in found.columns} == {
        "Pumpe": (0, 1),
        "T": (0.25, 6.25),
    }
    assert found.dt == 1 and "--inputs Pumpe --outputs T" in found.command
    with open(tmp_path / "model.toml", "w") as f:
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1, noise=0.1, inputs=["Pumpe"], outputs=["T"])
        jb.save_model(model, f.name)
    (tmp_path / "model.toml").write_text((tmp_path / "model.toml").read_text() + found.table + "\n")
    again = jb.read(tmp_path / "run.csv", jb.load_model(tmp_path / "model.toml"))
    assert again.samples == 60 and again.u[:5, 0].tolist() == [1, 1, 1, 1, 0]
