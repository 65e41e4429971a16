"""Fields on the command line: --test, --alarm and what they replaced, with every command that takes them."""

import io
import json
import sys

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import fields, main
from jaxbound.diagnosis.alarmrule import AlarmRule, stated_rule
from jaxbound.models.statedalarms import ALARMS

MODEL = """
dt = 1
[[inputs]]
name = "pump"
range = [-1, 2]
[[outputs]]
name = "height"
noise = 0.1
[[uncertainty]]
name = "valve"
varying = false
B = [[0.0]]
[alarms]
rule = "2/2"
least = 0.2
acknowledged = "seen.txt"
latch = true
[matrices]
A = [[0.5]]
B = [[1]]
C = [[1]]
[[test]]
name = "jumps"
horizon = 1
[[test]]
name = "slow"
observer = "zonotope"
factor = 3
"""
CERTAIN = MODEL.replace(MODEL[MODEL.index("[[unc") : MODEL.index("[alarms]")], "")
BARE = CERTAIN[: CERTAIN.index("[alarms]")] + CERTAIN[CERTAIN.index("[matrices]") :]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with plant.toml and run.csv, whose sensor jumps a little at 20, and much from 40 on."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    u, x = np.tile([0.0, 1.0], 30), np.zeros(60)
    for k in range(59):
        x[k + 1] = 0.5 * x[k] + u[k]
    y = x.copy()
    y[20] += 0.3
    healthy = pd.DataFrame({"time": np.arange(60.0), "pump": u, "height": x})
    y[40:44] += [3, -3, 3, -3]
    recorded = healthy.assign(height=y)
    healthy.to_csv("healthy.csv", index=False)
    recorded.to_csv("run.csv", index=False)
    recorded.to_parquet("run.parquet")
    (tmp_path / "units.csv").write_text("unit,model,recording\nA,plant.toml,run.csv\n")
    (tmp_path / "plant.toml").write_text(BARE)
    return tmp_path


def shell(capsys, line):
    """Type a line; return (exit code, stdout, stderr)."""
    capsys.readouterr()
    return main.main(line.split()), *capsys.readouterr()


@pytest.mark.parametrize("data", ["run.csv", "run.parquet"])
def test_detect_takes_one_test_of_the_model_by_its_name(data, place, capsys):
    code, out, err = shell(capsys, f"detect plant.toml {data} --out out --test jumps --json")
    assert code == 1 and list(json.loads(out)["tests"]) == ["jumps"] and not err
    assert shell(capsys, "explain out --at 20 --json")[0] == 0, "the report knows which test it was"
    code, out, _ = shell(capsys, f"detect plant.toml {data} --out slow --test slow --json")
    found = json.loads(out)["tests"]
    assert code == 1 and list(found) == ["slow"] and found["slow"]["first_fault"] == 40


def test_a_pipe_takes_one_test_by_its_name(place, capfd, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))
    with open("run.csv") as file:
        monkeypatch.setattr(main.detect, "STDIN", "-")
        from jaxbound.cli import pipe

        monkeypatch.setattr(pipe, "arrivals", lambda raw, end: [file.read().encode()])
        assert main.main("detect plant.toml - --test slow --json".split()) == 1
    lines = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert {line["test"] for line in lines} == {None, "slow"} and lines[20]["status"] != "FAULT"


def test_a_fleet_takes_one_test_by_its_name(place, capsys):
    _, out, _ = shell(capsys, "fleet units.csv --out fleet --test slow --json")
    assert list(json.loads(out)["units"][0]["tests"]) == ["slow"]
    code, out, _ = shell(capsys, "fleet units.csv --out fleet --test rain --json")
    assert code == 2 and "no test 'rain' in this model: it states 'jumps', 'slow'" in out


def test_evaluate_takes_one_test_by_its_name(place, capsys):
    line = "evaluate plant.toml --healthy healthy.csv --faulty run.csv --json --test"
    seen = {}
    for name in ("jumps", "slow"):
        code, out, err = shell(capsys, f"{line} {name}")
        assert code == 0, err
        seen[name] = out
    assert seen["jumps"] != seen["slow"]


def test_study_takes_one_test_by_its_name(place, capsys):
    line = "study plant.toml --faults height:bias --sizes 0.2 --n 8 --scenario samples=20 --json --out"
    seen = {}
    for name in ("jumps", "slow"):
        code, out, err = shell(capsys, f"{line} {name} --test {name}")
        assert code == 0 and not err, err
        seen[name] = json.loads(out)["cells"][0]["detected"]
    assert seen["jumps"] > seen["slow"], seen
    code, out, err = shell(capsys, f"{line} s2 --test rain")
    assert code == 2 and err.count("\n") == 1
    assert "plant.toml: there is no test 'rain' in this model: it states 'jumps', 'slow'" in err


def test_tune_finds_the_factor_of_one_test_and_keeps_the_others(place, capsys):
    code, _, err = shell(capsys, "tune plant.toml healthy.csv --out tuned.toml --test slow")
    assert code == 0, err
    jumps, slow = jb.load_model("tuned.toml").tests
    assert jumps.factor == 1 and slow.factor < 3 and slow.observer == "zonotope"


def test_info_shows_one_test(place, capsys):
    _, out, _ = shell(capsys, "info plant.toml --test slow")
    assert "test slow" in out and "test jumps" not in out
    (place / "plant.toml").write_text(BARE + '[alarms]\nrule = "3/5"\nlatch = true\n')
    assert "rule 3/5, latch True" in shell(capsys, "info plant.toml")[1]
    assert json.loads(shell(capsys, "info plant.toml --json")[1])["alarms"] == {"rule": "3/5", "latch": True}


def test_explain_takes_a_test_that_did_not_speak(place, capsys):
    assert shell(capsys, "detect plant.toml run.csv --out out")[0] == 1
    for name in ("jumps", "slow"):
        code, out, err = shell(capsys, f"explain out --at 42 --test {name} --json")
        assert code == 0 and json.loads(out)["test"] == name, err
    code, _, err = shell(capsys, "explain out --at 42 --test rain")
    assert code == 2 and "no test 'rain' in this report: it has 'jumps', 'slow'" in err
    shell(capsys, "detect plant.toml run.csv --out plain --test horizon=1")
    code, _, err = shell(capsys, "explain plain --at 42 --test jumps")
    assert code == 2 and "no test 'jumps' in this report: it is of one test without a name" in err


def test_parameters_take_plain_windows_alone(place, capsys):
    (place / "plant.toml").write_text(MODEL)
    code, _, err = shell(capsys, "parameters plant.toml healthy.csv --test jumps")
    assert code == 2 and "parameters are narrowed by plain windows: give --test horizon=30" in err


@pytest.mark.parametrize(
    ("test", "asked"),
    [
        ("horizon=2", "horizon 2"),
        ("lags=0,1", "lags"),
        ("method=box,horizon=2", "box"),
        ("observer=joint,window=8,order=5,latched=true,weight=1", "observer"),
        ("horizon=2,factor=4", "bounds four times as wide"),
        ("horizon=1,when=pump > -1", "a condition"),
    ],
)
def test_a_test_is_said_by_its_fields(test, asked, place, capsys):
    code = main.main(["detect", "plant.toml", "run.csv", "--out", "out", "--json", "--test", test])
    found = json.loads(capsys.readouterr().out)
    assert code == 1
    if asked in ("bounds four times as wide", "a condition"):
        assert found["method"] == "monitor" and list(found["tests"]) == ["asked"]
        assert found["tests"]["asked"]["first_fault"] == {"horizon=2,factor=4": 40}.get(test, 20)
    else:
        assert found["method"] == {"box": "box", "observer": "observer"}.get(asked, "joint")
        assert "tests" not in found


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("--test rain", "plant.toml: there is no test 'rain' in this model: it states 'jumps', 'slow'"),
        ("--test name=slow,horizon=3", "--test slow names a test, which says all: leave the rest out"),
        (
            "--test hight=3",
            "--test has the unknown field 'hight'; did you mean 'weight'? known fields are name, horizon, ",
        ),
        ("--test horizon=3,horizon=4", "--test says horizon twice"),
        ("--test ,", "--test needs fields, like a=1,b=2: not ','"),
        ("--test margins=some", "margins of --test must be one of auto, bounds, exact, not 'some'"),
        ("--test method=best", "method must be one of windows, box, observer, validation, not 'best'"),
        ("--test method=box,factor=2", "--test: method=box takes no observer, no factor and no condition"),
        ("--alarm 3", "--alarm needs a rule k/n with 1 <= k <= n, like 3/5, or plain, not '3'"),
        ("--alarm 1/1,latc=true", "--alarm has the unknown field 'latc'; did you mean 'latch'?"),
        ("--alarm latch=maybe", "latch of --alarm must be true or false, not 'maybe'"),
        ("--alarm merge=soon", "merge: "),
        ("--alarm least.depth=1", "a least size is one of an output: 'depth' is none of 'height'"),
        ("--alarm acknowledged=none.txt", "acknowledged ends alarms that latch: give latch, too"),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(line, says, place, capsys):
    code, out, err = shell(capsys, f"detect plant.toml run.csv --out out {line}")
    assert code == 2 and says in err and err.count("\n") == 1 and not (place / "out").exists()


@pytest.mark.parametrize("field", ["margins=exact", "outside=undecided"])
def test_a_command_that_claims_no_faults_refuses_fields_of_claims(field, place, capsys):
    for line in ("study plant.toml --faults height:bias --sizes 3 --n 8", "tune plant.toml healthy.csv"):
        code, _, err = shell(capsys, f"{line} --out out --test {field}")
        assert code == 2 and f"{field.partition('=')[0]} is for detect and fleet, leave it out" in err


@pytest.mark.parametrize("who", ["0", "four", "nobody=1", "10000"])
def test_workers_are_a_number_or_an_address(who, place, capsys):
    code, _, err = shell(capsys, f"fleet units.csv --out out --workers {who}")
    assert code == 2 and "--workers needs their number, 1 to 9999, or an address, like tcp://host:8786" in err


def test_a_model_without_tests_says_so(place, capsys):
    (place / "plant.toml").write_text(BARE[: BARE.index("[[test]]")])
    code, _, err = shell(capsys, "detect plant.toml run.csv --out out --test slow")
    assert code == 2 and "it states none; say one by fields, like horizon=30" in err


def alarms(capsys, line):
    """Return how many alarms a command counts."""
    return json.loads(shell(capsys, line)[1])["alarms"]


def test_detect_takes_the_rule_of_the_model_and_the_shell_wins(place, capsys):
    assert alarms(capsys, "detect plant.toml run.csv --out out --json --test horizon=1") == 2
    (place / "plant.toml").write_text(BARE + '[alarms]\nrule = "6/6"\n')
    for data in ("run.csv", "run.parquet"):
        line = f"detect plant.toml {data} --out out --json --test horizon=1"
        rules = "", "--alarm 1/1", "--alarm hold=30", "--alarm 1/1,hold=30"
        counts = [alarms(capsys, f"{line} {rule}") for rule in rules]
        assert counts == [0, 2, 0, 1], "one field does not take the others away"


def test_a_fleet_takes_the_rule_of_each_model(place, capsys):
    (place / "plant.toml").write_text(BARE + '[alarms]\nrule = "6/6"\n')
    line = "fleet units.csv --out out --json --test horizon=1"
    assert json.loads(shell(capsys, line)[1])["units"][0]["alarms"] == 0
    assert json.loads(shell(capsys, f"{line} --alarm 1/1")[1])["units"][0]["alarms"] == 2


def test_a_pipe_tells_alarms_by_the_rule_of_the_model(place, capfd):
    from jaxbound.cli.pipe import LiveRun, judge_stream

    data = (place / "run.csv").read_bytes()
    judge_stream(LiveRun("plant.toml"), [data])
    assert "# alarm" not in capfd.readouterr().out
    (place / "plant.toml").write_text(BARE + "[alarms]\nlatch = true\n")
    judge_stream(LiveRun("plant.toml"), [data])
    assert capfd.readouterr().out.count("# alarm 1 begins") == 1


def test_evaluate_counts_by_the_rule_of_the_model(place, capsys):
    (place / "plant.toml").write_text(CERTAIN)
    line = "evaluate plant.toml --healthy healthy.csv --faulty run.csv --json --test jumps"
    said = shell(capsys, line)[1]
    assert "without acknowledged, least" in said and json.loads(said)["hints"]
    assert shell(capsys, f"{line} --alarm 2/2")[1].replace(" ", "")[:400] == said.replace(" ", "")[:400]


def test_the_table_of_alarms_is_written_as_it_was_read(place):
    (place / "plant.toml").write_text(CERTAIN)
    model = jb.load_model("plant.toml")
    jb.save_model(model, "again.toml")
    assert jb.load_model("again.toml") == model and model.alarms["least"] == 0.2
    rule = stated_rule(None, model, "there/plant.toml")
    assert (rule.k, rule.n, rule.latch, str(rule.acknowledged)) == (2, 2, True, "there/seen.txt")
    assert stated_rule({"rule": "1/1"}, model, "").k == 1
    assert stated_rule({"rule": "plain"}, model, "") == AlarmRule()
    assert stated_rule({"rule": "plain", "merge": 4}, model, "") == AlarmRule(merge=4)
    assert {"k", "n", *ALARMS} - {"rule"} == set(AlarmRule.__dataclass_fields__)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("detect --horizon 1", "--horizon: the next version takes only --test horizon=1"),
        (
            "detect --method observer --observer joint --span 8 --order 5 --latched",
            "--observer, --span, --order, --latched: the next version takes only --test "
            "observer=joint,window=8,order=5,latched=true",
        ),
        (
            "detect --horizon 1 --margins exact --outside undecided --latch --least height=0.2 --suspects",
            "--horizon, --margins, --outside, --latch, --least, --suspects: the next version takes only "
            "--test horizon=1,margins=exact,outside=undecided --alarm "
            "latch=true,least.height=0.2,suspects=true",
        ),
        (
            "detect --lags 0,1 --merge-alarms 10min",
            "--lags, --merge-alarms: the next version takes only --test lags=0,1 --alarm merge=10min",
        ),
    ],
)
def test_spellings_of_before_say_in_one_sentence_what_is_typed_now(line, sentence, place, capsys):
    command, old = line.split(" ", 1)
    code, out, err = shell(capsys, f"{command} plant.toml run.csv --out old --json {old}")
    assert err.splitlines()[0] == f"jaxbound: {sentence}" and err.count("next version") == 1
    now = sentence.partition("takes only ")[2]
    method = "--method observer" if "--method" in old else ""
    assert shell(capsys, f"{command} plant.toml run.csv --out new --json {method} {now}")[0] == code == 1
    for name in ("verdicts.csv", "alarms.csv"):
        assert (place / "new" / name).read_bytes() == (place / "old" / name).read_bytes()


def test_a_test_by_another_file_needs_no_rule_of_alarms_there(place):
    (place / "winter.toml").write_text(BARE[: BARE.index("[[test]]")].replace("noise = 0.1", "noise = 0.4"))
    text = BARE + '[[test]]\nname = "winter"\nmodel = "winter.toml"\n[alarms]\nrule = "3/5"\n'
    (place / "plant.toml").write_text(text)
    model = jb.load_model("plant.toml")
    assert dict(model.tests[-1].changes) == {"outputs": [{"name": "height", "noise": "0.4"}]}
    assert model.alarms == {"rule": "3/5"}


def test_method_and_a_rule_of_alarms_are_typed_as_ever(place, capsys):
    code, out, err = shell(capsys, "detect plant.toml run.csv --out o --method box --alarm 2/3 --json")
    assert code == 1 and not err and json.loads(out)["method"] == "box"


def test_a_command_has_eight_options_of_every_day_and_fifteen_in_all():
    for name, parser in main.commands().items():
        (rare,) = [action.rare for action in parser._actions if hasattr(action, "rare")]
        shown = [a for a in parser._actions if a.option_strings and a.help != "==SUPPRESS=="]
        assert len(shown) <= 15 and len([a for a in shown if a.dest not in rare]) <= 8, name


@pytest.mark.parametrize("command", ["detect", "study", "evaluate"])
def test_help_shows_the_options_of_every_day_and_with_all_the_others(command, capsys):
    _, short, _ = shell(capsys, f"{command} --help")
    _, whole, _ = shell(capsys, f"{command} --help all")
    assert "--workers" not in short.replace("--help", "") or command == "evaluate"
    assert "--json" in whole and len(whole) > len(short) and "options more" in short
    for word in fields.OLD["test"].split():
        assert f"--{word.partition(':')[0]} " not in whole
