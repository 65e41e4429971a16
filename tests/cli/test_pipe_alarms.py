"""Alarms by a rule of lines as they come: those of the file, told in lines of their own, once."""

import json

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.cli import pipe as piped
from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.runs import journal
from jaxbound.runs.refusals import Refused

RULES = {
    "--alarm 2/3": AlarmRule(2, 3),
    "--alarm merge=6": AlarmRule(merge=6),
    "--alarm latch=true": AlarmRule(latch=True),
    "--alarm latch=true,acknowledged=seen.txt": AlarmRule(latch=True, acknowledged="seen.txt"),
    "--alarm 2/4,suspects=true,least.y1=0.25": AlarmRule(2, 4, suspects=True, least={"y1": 0.25}),
}


@pytest.fixture(scope="module")
def text():
    """Return lines of the paper's plant: its first sensor is wrong twice, its second once, up to the end."""
    rng, x, N = np.random.default_rng(1), np.zeros(2), 230
    u, y = np.repeat(rng.uniform(-1, 1, (N // 10, 1)), 10, 0), np.empty((N, 2))
    for k in range(N):
        y[k], x = (x[0], x[0] + x[1]), np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y += rng.uniform(-0.9, 0.9, y.shape) * (abs(y) * [0.018, 0.09] + [0.1, 0.01])
    y[90:110, 0] += 0.6
    y[150:153, 0] += 0.6
    y[200:, 1] += 0.9
    y[95, 0] = np.nan
    samples = pd.DataFrame({"t": 0.5 * np.arange(N), "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    return samples.to_csv(index=False, lineterminator="\n").splitlines(keepends=True)


@pytest.fixture
def place(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")  # nobody cuts the power of a test
    model = jb.LinearSystem(
        [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01], dt=0.5
    )
    jb.save_model(model, "model.toml")
    (tmp_path / "run.csv").write_text("".join(text))
    (tmp_path / "seen.txt").write_text("52\n60.2, J. Smith: seen\n101\n101.3\n200\n")
    return tmp_path


@pytest.fixture
def send(capsysbinary, place):
    """Return a function that sends lines in pieces of some lines and returns the lines on stdout."""

    def sent(lines, size=1000, rule=None, **changes):
        capsysbinary.readouterr()
        pieces = ["".join(lines[k : k + size]).encode() for k in range(0, len(lines), size)]
        piped.judge_stream(piped.LiveRun("model.toml", alarm=rule, **changes), pieces)
        return capsysbinary.readouterr().out.decode().splitlines()

    return sent


def table(path):
    """Return the lines of alarms.csv without its header, those of a file in the order in which they begin."""
    header, *rows = path.read_text().splitlines()
    return header, sorted(rows, key=lambda row: int(row.split(",")[3]))


@pytest.mark.parametrize("options", RULES)
def test_alarms_are_those_of_the_file_whatever_the_pieces(text, place, send, options, capsysbinary):
    main.main(["detect", "model.toml", "run.csv", "--out", "file", *options.split()])
    expected = table(place / "file/alarms.csv")
    assert len(expected[1]) > 1
    lines = []
    for size in (1, 7, 1000):
        lines.append(send(text, size, RULES[options], out=place / f"pipe{size}"))
        assert table(place / f"pipe{size}/alarms.csv") == expected
    assert lines[0] == lines[1] == lines[2]


@pytest.mark.parametrize("options", RULES)
def test_an_alarm_goes_on_after_a_kill_and_after_an_end(
    text, place, send, options, monkeypatch, capsysbinary
):
    rule = RULES[options]
    expected = send(text, 9, rule, out=place / "whole", json=True)

    class Killed(BaseException):
        """Raised where a process is killed."""

    printed = send(text[:98], 9, rule, out=place / "out", json=True)  # it ends within an alarm
    for last in (104, 113, 155, 210):

        def dying(self, memory, save=journal.Journal.save, last=last):
            save(self, memory)
            if memory["source"]["samples"] >= last:
                raise Killed

        with monkeypatch.context() as patched, pytest.raises(Killed):
            patched.setattr(journal.Journal, "save", dying)
            send(text, 9, rule, out=place / "out", json=True)
        printed += capsysbinary.readouterr().out.decode().splitlines()
    printed += send(text, 9, rule, out=place / "out", json=True)
    assert printed == expected
    assert (place / "out/alarms.csv").read_text() == (place / "whole/alarms.csv").read_text()


def test_a_line_tells_that_an_alarm_begins_and_ends(text, place, send):
    plain, told = send(text[:130]), send(text[:130], rule=AlarmRule(suspects=True))
    alarms = jb.detect(
        jb.parity_relations(jb.load_model("model.toml")), jb.read("run.csv", jb.load_model("model.toml"))
    ).alarms(rule=AlarmRule(suspects=True))
    notices = [line for line in told if line.startswith("#")]
    assert [line for line in told if not line.startswith("#")] == plain
    first = alarms[0]
    assert notices[0] == f"# alarm 1 begins at {first.start / 2:g}, suspect {first.suspect}"
    assert told[told.index(notices[0]) - 1] == plain[1 + first.start]
    assert notices[1] == f"# alarm 1 ends at {first.end / 2:g}, suspect {first.suspect}: {first.ended}"
    lines = [json.loads(line) for line in send(text[:130], rule=AlarmRule(suspects=True), json=True)]
    begin, end, *_ = [line for line in lines if "alarm" in line]
    assert begin == {
        "alarm": "begin",
        "number": 1,
        "sample": first.start,
        "time": first.start / 2,
        "suspect": first.suspect,
    }
    assert (end["sample"], end["windows"], end["ended"]) == (first.end, first.windows, first.ended)


def test_another_rule_than_that_of_the_state_is_refused(text, place, send):
    send(text[:40], rule=AlarmRule(2, 3), out=place / "out")
    for rule in (None, AlarmRule(2, 4)):
        with pytest.raises(Refused, match="is of a(nother)? rule of alarms"):
            send(text, rule=rule, out=place / "out")


def test_an_operator_acknowledges_while_samples_come(text, place, capsysbinary):
    rule, seen = AlarmRule(latch=True, acknowledged="seen.txt"), place / "seen.txt"
    seen.write_text("")

    def pieces():
        for k in range(0, 130, 10):
            yield "".join(text[k : k + 10]).encode()
            if k == 110:
                seen.write_text("soon\n53.5\n")

    assert piped.judge_stream(piped.LiveRun("model.toml", alarm=rule, json=True), pieces()) == 1
    out, err = capsysbinary.readouterr()
    told = [line for line in map(json.loads, out.decode().splitlines()) if "alarm" in line]
    ends = [(line["time"], line["ended"]) for line in told if line["alarm"] == "end"]
    assert set(ends) == {(59.0, "acknowledged")}, "what is known of samples that were judged stands"
    assert err.decode().count("a line begins with no time: a time of the time column is 'soon'") == 1


def test_the_cause_stands_in_lines_tables_and_the_summary(text, place, send, capsysbinary):
    model = jb.load_model("model.toml").replace(faults=[jb.NamedFault("probe slips", output="y1")])
    jb.save_model(model, "model.toml")
    (place / "run.csv").write_text("".join(text[:130]))
    rule = AlarmRule(2, 3, suspects=True)
    lines = [json.loads(line) for line in send(text[:130], 9, rule, out=place / "out", json=True)]
    told = [(line["alarm"], line["cause"]) for line in lines if line.get("alarm")]
    main.main("detect model.toml run.csv --out file --alarm 2/3,suspects=true --json".split())
    summary = json.loads(capsysbinary.readouterr().out)
    causes = pd.read_csv("file/alarms.csv", keep_default_na=False).cause.tolist()
    assert causes == pd.read_csv("out/alarms.csv", keep_default_na=False).cause.tolist()
    assert causes[0].startswith("probe slips: +0.") and told[0][1].startswith("probe slips: +0.")
    assert told[1] == ("end", causes[0]) != ("end", told[0][1])  # of the worst window, not of the first
    assert ("end", causes[0]) in told and summary["first_cause"] == causes[0]
