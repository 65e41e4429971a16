"""Live sources: a generator of recordings in one file, judged by the shell and in Python as a file is."""

import io
import json
import os
import sqlite3
from contextlib import closing

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main, pipe, signals
from jaxbound.recordings.live import Readings
from jaxbound.runs.refusals import Refused

MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
T = 40
PLANT = """
import numpy as np
y = 0.5 ** np.arange({stop})
y[20:] += 1.0
time = np.arange({stop}.0) + 50 * (np.arange({stop}) >= 30)

def readings(model):
    assert model.outputs == ("y1",)
    k = {first}
    for count in [1, 1, 3, 8, 1, 5, 100]:
        if k < len(y):
            yield {{"time": time[k : k + count], "y1": y[k : k + count]}}
        k += count
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    jb.save_model(MODEL, "model.toml")
    write(0, T)
    return tmp_path


def write(first, stop):
    with open("plant.py", "w") as file:
        file.write(PLANT.format(first=first, stop=stop))


def plant(model=MODEL):
    """Return what the file yields."""
    names = {}
    exec(PLANT.format(first=0, stop=T), names)
    return names["readings"](model)


def expected():
    y = 0.5 ** np.arange(T)
    y[20:] += 1.0
    return jb.detect(jb.parity_relations(MODEL), None, y[:, None], starts=[30])


def rows(text):
    return [row.split(",")[1] for row in text.splitlines()[1:]]


def test_the_shell_judges_a_generator_in_a_file(place, capsysbinary):
    assert main.main(["detect", "model.toml", "plant.py:readings", "--out", "out"]) == 1
    names = [jb.Status(s).name for s in expected().status]
    out, err = (text.decode() for text in capsysbinary.readouterr())
    assert rows(out) == rows((place / "out/verdicts.csv").read_text()) == names
    assert "a gap of 51 s before sample 30" in err
    assert json.loads((place / "out/run.json").read_text())["data"].endswith("plant.py:readings")


@pytest.mark.parametrize("again", ["from the beginning", "where it stopped", "somewhere before"])
def test_a_live_source_goes_on_where_it_was_stopped(place, capsysbinary, again):
    write(0, 25)
    main.main(["detect", "model.toml", "plant.py:readings", "--out", "out"])
    write({"from the beginning": 0, "where it stopped": 25, "somewhere before": 11}[again], T)
    assert main.main(["detect", "model.toml", "plant.py:readings", "--out", "out"]) == 1
    found = rows((place / "out/verdicts.csv").read_text())
    assert found == [jb.Status(s).name for s in expected().status]
    with closing(sqlite3.connect(place / "out/monitor.sqlite")) as database:
        ((memory,),) = database.execute("SELECT memory FROM checkpoint")
    assert json.loads(memory)["source"]["samples"] == T
    assert (b"were judged before and are skipped" in capsysbinary.readouterr().err) == (
        again != "where it stopped"
    )


def test_a_live_source_that_says_something_else_is_refused(place, capsysbinary):
    """Readings at times that were judged were left out, whatever they said."""
    command = ["detect", "model.toml", "plant.py:readings", "--out", "out"]
    assert main.main(command) == 1
    assert main.main(command) == 3
    err = capsysbinary.readouterr().err.decode()
    assert "nothing is concluded: 40 samples were judged before and are skipped" in err
    kept = (place / "out/verdicts.csv").read_bytes()
    source = (place / "plant.py").read_text()
    (place / "plant.py").write_text(source.replace("y[20:] += 1.0", "y[20:] += 2.0"))
    assert main.main(command) == 2
    err = capsysbinary.readouterr().err.decode()
    assert (
        "a reading at 20 s is no sample that was judged, though all up to 89 s were: another recording" in err
    )
    assert (place / "out/verdicts.csv").read_bytes() == kept


DATED = """
import numpy as np, pandas as pd
y = 0.5 ** np.arange(40.0)
y[20:] += 1.0
table = pd.DataFrame({"y1": y}, index=pd.date_range("2026-01-01", periods=40, freq="1s"))

def readings(model):
    for k in range(0, 40, 3):
        yield table.iloc[k : k + 3]
"""


def test_readings_with_dates_are_judged_and_written_as_text(place, capsysbinary):
    """A few rows with dates were no numbers: the run ended with an error."""
    (place / "plant.py").write_text(DATED)
    for options in ([], ["--json", "--alarm", "1/1"]):
        command = ["detect", "model.toml", "plant.py:readings", "--out", f"out{len(options)}"]
        assert main.main([*command, *options]) == 1
    lines = capsysbinary.readouterr().out.decode().splitlines()
    assert (
        lines[40].startswith("2026-01-01 00:00:39,FAULT") and rows("\n".join(lines[:41])).count("FAULT") == 20
    )
    assert json.loads(lines[-1])["time"] == "2026-01-01 00:00:39"
    assert (
        (place / "out3/alarms.csv").read_text().splitlines()[1].startswith("2026-01-01 00:00:20,2026-01-01")
    )


def test_python_judges_a_generator_as_it_comes_and_as_a_whole():
    monitor = jb.Monitor(jb.parity_relations(MODEL))
    state, status = monitor.init(), []
    for _, piece in Readings(MODEL, plant()).pieces(plant()):
        state, verdicts = monitor.run(state, piece)
        status += verdicts.status.tolist()
    assert status == expected().status.tolist()
    whole = jb.read(plant(), MODEL)
    assert whole.starts.tolist() == [30]
    found = jb.detect(jb.parity_relations(MODEL), whole)
    np.testing.assert_array_equal(found.status, expected().status)
    np.testing.assert_array_equal(found.margin, expected().margin)


AVERAGED = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, dt=3, columns={"every": "3s"})
MEANS = """
import numpy as np
y = 0.1 * np.sin(np.arange(360.0))
y[250:] += 1.0
time = 1.7e9 + np.arange(360.0)

def readings(model):
    for k in range({first}, {stop}, 7):
        yield {{"time": time[k : min(k + 7, {stop})], "y1": y[k : min(k + 7, {stop})]}}
"""


@pytest.fixture
def averaged(place):
    """Return the Recording of the means of what a live source sends until the end, read as a table."""
    jb.save_model(AVERAGED, "model.toml")
    names = {}
    exec(MEANS.format(first=0, stop=360), names)
    index = pd.to_datetime(names["time"], unit="s")
    return jb.Recording.of(AVERAGED, pd.DataFrame({"y1": names["y"]}, index=index))


def test_a_generator_that_ends_is_read_as_means(averaged):
    names = {}
    exec(MEANS.format(first=0, stop=360), names)
    read = jb.read(names["readings"](AVERAGED), AVERAGED)
    np.testing.assert_allclose(read.y, averaged.y, rtol=1e-12)
    np.testing.assert_array_equal(read.stamps, averaged.stamps)
    assert read.starts.tolist() == averaged.starts.tolist()
    with pytest.raises(ValueError, match="jb.read"):
        jb.detect(jb.parity_relations(AVERAGED), names["readings"](AVERAGED))


@pytest.mark.parametrize("again", [0, 203])
def test_means_of_a_live_source_that_stopped_go_on(averaged, place, again):
    for first, stop in ((0, 203), (again, 360)):
        (place / "plant.py").write_text(MEANS.format(first=first, stop=stop))
        main.main(["detect", "model.toml", "plant.py:readings", "--out", "out"])
    expected = jb.detect(jb.parity_relations(AVERAGED), averaged).status
    found = rows((place / "out/verdicts.csv").read_text())
    assert "FAULT" in found and found == [jb.Status(s).name for s in expected[: len(found)]]
    assert len(found) >= len(expected) - 1  # the last interval may not be over


def test_what_is_no_live_source_is_refused(place, capsys):
    assert main.main(["detect", "model.toml", "plant.py:nothing", "--out", "out"]) == 2
    assert "plant.py has no function nothing" in capsys.readouterr().err
    assert main.main(["detect", "model.toml", "none.py:readings", "--out", "out"]) == 2
    assert "there is no data file none.py:readings" in capsys.readouterr().err
    with pytest.raises(ValueError, match="there is no reading"):
        jb.read(iter(()), MODEL)


def test_a_generator_that_fails_says_so_and_what_came_before_is_kept(place):
    def broken():
        yield {"time": [0.0], "y1": [1.0]}
        yield {"time": [1.0], "nothing": [1.0]}

    with pytest.raises(Refused, match="'y1'"):
        pipe.judge_stream(
            pipe.LiveRun("model.toml", data="plant.py:readings", out=place / "out"), pipe_of(broken())
        )
    assert rows((place / "out/verdicts.csv").read_text()) == ["MISSING"]


def pipe_of(readings):
    """Return what arrives of readings, through the thread that waits for them."""
    return signals.arrivals(readings, signals.Ends(None))


class TestWithoutPosix:
    """Where the system cannot wait for a file, a thread waits in its place."""

    def test_bytes_of_a_pipe_come_through_a_thread(self, monkeypatch):
        monkeypatch.setattr(signals, "CAN_WAIT", False)
        reading, writing = os.pipe()
        os.write(writing, b"t,y1\n0,1\n")
        with signals.ends() as end:
            assert end.woken is None
            found = signals.arrivals(reading, end)
            assert next(found) == b"t,y1\n0,1\n"
            os.write(writing, b"1,")
            assert next(found) == b"1,"
            os.close(writing)
            assert list(found) == []
        os.close(reading)

    def test_a_signal_ends_it(self, monkeypatch):
        monkeypatch.setattr(signals, "CAN_WAIT", False)
        reading, writing = os.pipe()
        with signals.ends() as end:
            found = signals.arrivals(reading, end)
            os.write(writing, b"x")
            assert next(found) == b"x"
            end.asked.set()
            assert list(found) == [None]
        os.close(writing), os.close(reading)

    def test_verdicts_are_the_same(self, place, monkeypatch, capsysbinary):
        text = b"time,y1\n" + b"".join(f"{k},{0.5**k + (k >= 20)}\n".encode() for k in range(T))
        pipe.judge_stream(pipe.LiveRun("model.toml", out=place / "a"), [text])
        monkeypatch.setattr(signals, "CAN_WAIT", False)
        reading, writing = os.pipe()
        os.write(writing, text)
        os.close(writing)
        with signals.ends() as end:
            pipe.judge_stream(pipe.LiveRun("model.toml", out=place / "b"), signals.arrivals(reading, end))
        os.close(reading)
        assert (place / "a/verdicts.csv").read_bytes() == (place / "b/verdicts.csv").read_bytes()
        assert io.BytesIO(capsysbinary.readouterr().out).readline() == b"time,status,margin\n"


def test_readings_one_by_one_are_set_aside_as_their_table_is():
    model = MODEL.replace(dt=1, columns={"where": "fan > 0"})
    fan = np.isin(np.arange(T), (7, 8, 20), invert=True) * 1.0
    columns = {"time": np.arange(T) * 1.0, "y1": 0.5 ** np.arange(T), "fan": fan}
    readings = ({name: x[k : k + 1] for name, x in columns.items()} for k in range(T))
    relations = jb.parity_relations(model, 2)
    one_by_one, whole = jb.detect(relations, jb.read(readings, model)), jb.detect(relations, columns)
    np.testing.assert_array_equal(one_by_one.status, whole.status)
