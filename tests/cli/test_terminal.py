"""What reaches a terminal, a pipe, a page or a spreadsheet: whole, printable, and never a formula."""

import os
import re
import shlex
import subprocess
import sys
import threading

import numpy as np
import pytest

from jaxbound.cli import main, terminal
from jaxbound.cli.fleet_table import write_fleet
from jaxbound.cli.main import COMMANDS
from jaxbound.models.modelfile import load_model, template
from jaxbound.plots.canvas import canvas, style, to_png
from jaxbound.recordings.expressions import expression, missing_column
from jaxbound.recordings.read import read
from jaxbound.runs.fleet import Unit, UnitResult
from jaxbound.runs.summary import Summary, Window
from jaxbound.text.characters import cell, clipped, printable
from jaxbound.text.names import listed


def shell(command, folder):
    """Return (exit code, stdout, stderr) of a command line in which $J is jaxbound."""
    env = os.environ | {"J": f"{sys.executable} -m jaxbound.cli"}
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=env, capture_output=True, timeout=120, check=False
    )
    return done.returncode, done.stdout, done.stderr


@pytest.fixture
def model(tmp_path):
    (tmp_path / "m.toml").write_text(template())
    return tmp_path


@pytest.mark.posix("a shell and /dev/full")
def test_a_full_device_is_a_sentence_and_exit_code_2(model):
    code, _, err = shell("$J info --template > /dev/full", model)
    assert code == 2 and err == b"jaxbound: cannot write to standard output: no space left on device\n"


@pytest.mark.posix("a shell")
@pytest.mark.parametrize("end", [">&-", "2>&- >/dev/null", "| head -c 1 > /dev/null; exit ${PIPESTATUS[0]}"])
def test_a_closed_end_is_no_trouble_and_leaves_the_exit_code_alone(model, end):
    code, _, err = shell(f"$J info --template {end}", model)
    assert code == 0 and err == b""


def test_letters_that_stdout_cannot_show_are_escaped(model):
    (model / "e.toml").write_text(template().replace("level", "niveäu"))
    code, out, err = shell("PYTHONIOENCODING=ascii $J info e.toml", model)
    assert code == 0 and err == b"" and b"nive\\xe4u" in out


def test_control_characters_of_names_reach_no_terminal(model, capsys):
    (model / "e.toml").write_text(template().replace("level", "\\u001b[2Jlevel\\u009b"))
    assert main.main(["info", str(model / "e.toml")]) == 0
    out = capsys.readouterr().out
    assert "\\x1b[2Jlevel\\x9b" in out and printable(out, "\n") == out
    (model / "r.csv").write_text("\x1b[2Ja,b\n1,2\n3,4\n")
    assert main.main(["detect", str(model / "m.toml"), str(model / "r.csv"), "--out", str(model / "o")]) == 2
    err = capsys.readouterr().err
    assert "x1b[2Ja" in err and printable(err, "\n") == err


@pytest.mark.posix("named pipes")
def test_a_recording_comes_through_a_pipe_as_from_its_file(model):
    text = "time,Pump [%],level,flow\n" + "".join(f"{k},50,1.{k},0.{k}\n" for k in range(9))
    (model / "r.csv").write_text(text)
    os.mkfifo(model / "pipe")
    sender = threading.Thread(target=lambda: (model / "pipe").write_text(text))
    sender.start()
    m = load_model(model / "m.toml")
    piped, whole = read(model / "pipe", m), read(model / "r.csv", m)
    sender.join()
    np.testing.assert_array_equal(piped.y, whole.y)
    assert piped.source == "pipe"


@pytest.mark.posix("a shell")
def test_detect_takes_a_process_substitution(model):
    (model / "r.csv").write_text("time,Pump [%],level,flow\n0,50,1,1\n")
    code, _, err = shell("$J detect m.toml <(cat r.csv) --out o", model)
    assert code == 2 and b"/dev/fd/" in err and b"one row of data" in err


def test_a_header_of_a_hundred_thousand_columns_is_read(model):
    names = ["time", "Pump [%]", "level", "flow", *(f"column{i}" for i in range(100_000))]
    row = lambda k: ",".join([str(k), "50", "1", "0.5", *["0"] * 100_000])
    (model / "wide.csv").write_text("\n".join([",".join(names), *map(row, range(3)), ""]))
    assert read(model / "wide.csv", load_model(model / "m.toml")).y.tolist() == [[1, 0.5]] * 3


def test_sentences_name_a_few_of_many_names():
    said = missing_column("y", [f"column{i}" for i in range(100_000)], "the recording")
    assert (
        len(said) < 400
        and "99988 more" in said
        and len(missing_column("y" * 10**5, ["x" * 10**5], "the recording")) < 400
    )
    assert listed(["a"] * 13, str).count("a") == 13 and len(clipped("x" * 10**6)) < 2100


@pytest.mark.parametrize("terms", [900, 1500])
def test_a_sum_of_many_terms_is_computed(terms):
    x = {"a": np.array([1.0, 2.0])}
    assert expression(" + ".join(["a"] * terms)).values(x).tolist() == [terms, 2 * terms]


@pytest.mark.parametrize(
    "text",
    [
        "a + " + "9" * 310,
        "a > 1e400",
        "a" + " + 9" * 10**6,
        "(" * 300 + "a",
        "-" * 10**5 + "a",
        "abs(" * 90 + "a" + ")" * 90 + " + " + "9" * 5000,
    ],
)
def test_an_expression_beyond_all_measure_is_refused_in_a_sentence(text):
    with pytest.raises(ValueError, match="the expression .* (holds|cannot be read)") as e:
        expression(text)
    assert len(str(e.value)) < 600


@pytest.mark.parametrize("name", ["=1+1", "+1", "-1", "@x", "\t=x", "\r=x"])
def test_no_cell_of_fleet_csv_is_a_formula(tmp_path, name):
    unit = Unit(name, tmp_path / "m.toml", tmp_path / "r.csv")
    write_fleet(
        tmp_path, [UnitResult(unit, Summary("not tested", f"{name} is not there", worst=Window(0, "", -3.0)))]
    )
    import csv

    with open(tmp_path / "fleet.csv", newline="") as f:
        row = list(csv.DictReader(f))[0]
    shown = repr(name)[1:-1] if name[0] in "\t\r" else f"'{name}"
    assert row["unit"] == shown and row["sentence"] == f"{shown} is not there" and row["margin"] == "-3.0"
    assert cell("pump 7") == "pump 7"


def test_a_name_with_dollar_signs_is_drawn_as_it_is():
    with style():
        fig = canvas((2, 1))
        fig.text(0, 0, r"$\no$ such thing $")
        fig.text(0, 0, r"$\nonsense{$")
    assert to_png(fig).startswith(b"\x89PNG")


def test_too_little_memory_is_a_sentence(capsys, monkeypatch, model):
    def greedy(path):
        raise MemoryError("Unable to allocate 8 TiB")

    monkeypatch.setattr("jaxbound.cli.window.load_model", greedy)
    assert main.main(["info", str(model / "m.toml")]) == 2
    assert "more memory than there is" in capsys.readouterr().err


def test_no_command_shows_the_help_on_stdout_and_asks_on_stderr(capsys):
    assert main.main([]) == 2
    out, err = capsys.readouterr()
    assert (
        out.startswith("usage: jaxbound")
        and all(re.search(rf"\n    {name}\s", out) for name in main.commands())
        and err.count("\n") == 1
    )


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.NAME)
def test_every_command_has_examples_that_its_parser_takes_and_a_word_on_every_parameter(command, capsys):
    name = command.NAME
    for line, about in command.EXAMPLES:
        words = shlex.split(line.rpartition("| ")[2].removesuffix(" > plant.toml"))
        assert about and main._parse(words[1:]).run is command.run and words[0] == "jaxbound"
    assert main.main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert "examples:\n  " in out and "exit code" in out and "-q, --quiet" in out and "-v, --verbose" in out
    assert all(action.help for action in main.commands()[name]._actions)


def test_long_work_is_reported_now_and_then_where_there_is_no_terminal(capsys, monkeypatch):
    now = iter([0.0, 1.0, 59.0, 61.0, 62.0, 130.0])
    monkeypatch.setattr(terminal.time, "monotonic", lambda: next(now))
    with terminal.progress_bars(("read", "test")) as step:
        for stage, share in (("read", 0.5), ("test", 0.1), ("test", 0.25), ("test", 0.3), ("test", 0.9)):
            step(stage, share)
    said = "jaxbound: test 25%, 61 s after the start\njaxbound: test 90%, 130 s after the start\n"
    assert capsys.readouterr().err == said


def test_quiet_prints_the_first_line_and_verbose_each_stage(model, capsys):
    assert main.main(["info", str(model / "m.toml"), "-q"]) == 0
    assert capsys.readouterr() == ("tank\n", "")
    assert main.main(["info", str(model / "m.toml"), "-v"]) == 0
    out, err = capsys.readouterr()
    assert (
        out.count("\n") > 10
        and err.startswith("jaxbound: relations, 0.")
        and terminal.LOUDNESS.get() == terminal.NORMAL
    )
    assert main.main(["info", str(model / "m.toml"), "-v", "-q"]) == 2


def test_an_internal_error_says_its_traceback_with_v(model, capsys, monkeypatch):
    monkeypatch.setattr("jaxbound.cli.window.load_model", lambda path: 1 / 0)
    monkeypatch.setattr(main.tempfile, "tempdir", str(model))
    assert main.main(["info", str(model / "m.toml")]) == 70 and "Traceback" not in capsys.readouterr().err
    assert (
        main.main(["info", str(model / "m.toml"), "-v"]) == 70
        and "ZeroDivisionError" in capsys.readouterr().err
    )


def test_the_log_of_long_work_is_kept_from_who_wants_one_line(caplog):
    import logging

    log = logging.getLogger("jaxbound")
    for loudness, said in ((terminal.QUIET, []), (terminal.NORMAL, ["half done"])):
        caplog.clear()
        with main._keep_log(loudness):
            log.warning("half done")
        assert [record.getMessage() for record in caplog.records] == said
    assert log.level == logging.NOTSET


@pytest.mark.posix
def test_what_a_compiled_library_prints_by_itself_reaches_no_output():
    """C holds it back where its output is a file: it must not come later either."""
    program = (
        "import ctypes; from jaxbound.cli.terminal import hushed; print('before')\n"
        "with hushed():\n    ctypes.CDLL(None).puts(b'a solver')\nprint('behind')"
    )
    env = os.environ.copy()
    env.pop("PYTHONUNBUFFERED", None)  # C would hold nothing back
    line = [sys.executable, "-c", program]
    done = subprocess.run(line, env=env, capture_output=True, check=True, timeout=60)
    assert done.stdout.split() == [b"before", b"behind"]
