"""The parser: near words, completion, and options that stand in their command's file alone."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxbound.cli import main

CLI = Path(main.__file__).parent


@pytest.mark.parametrize(
    "line, sentence",
    [
        ("detct plant.toml", "there is no command 'detct' (did you mean detect?); see jaxbound --help"),
        ("weather", "there is no command 'weather'; see jaxbound --help"),
        (
            "fleet units.csv --ot fleet",  # --out, which is required, is not what one has to hear of
            "there is no option --ot of jaxbound fleet (did you mean --out?); see jaxbound fleet --help",
        ),
        (
            "detect m.toml d.csv --tset=3 --out o",
            "there is no option --tset of jaxbound detect (did you mean --test?); see jaxbound detect --help",
        ),
        (
            "info --zzz",
            "there is no option --zzz of jaxbound info; see jaxbound info --help",
        ),
        (
            "evaluate m.toml good.csv --healthy d.csv",
            "jaxbound evaluate has no use for good.csv; see jaxbound evaluate --help",
        ),
        (
            "fleet units.csv --out f --recording every=15min",
            "--recording is said by [recording] of each unit's model file; see jaxbound fleet --help",
        ),
        (
            "fit a.csv --out m.toml b.csv -z",
            "jaxbound fit has no use for b.csv -z; see jaxbound fit --help",
        ),
    ],
)
def test_an_unknown_word_is_answered_by_the_nearest_in_one_sentence(line, sentence, capsys):
    assert main.main(line.split()) == 2
    assert capsys.readouterr() == ("", f"jaxbound: {sentence}\n")


def test_what_looks_like_an_option_may_be_a_value_or_a_short_form():
    args = main._parse(
        ["study", "m.toml", "--faults", "y:bias", "--out", "o", "--scenario", "input_range=-1:1"]
    )
    assert args.scenario == {"input_range": "-1:1"}
    assert main._parse(["tune", "m.toml", "h.csv", "--out", "o", "--te", "horizon=3"]).test == {"horizon": 3}
    assert str(main._parse(["info", "--", "--m.toml"]).model) == "--m.toml"


@pytest.mark.parametrize(
    "line, name, words",
    [
        ("fit a.csv --add m.toml", "data", ["a.csv", "m.toml"]),
        ("fit --add a.csv m.toml", "data", ["a.csv", "m.toml"]),
        ("fit a.csv --outputs y b.csv --out m.toml c.csv", "data", ["a.csv", "b.csv", "c.csv"]),
        ("tune m.toml --out o a.csv --json b.csv", "healthy", ["a.csv", "b.csv"]),
        ("tune m.toml a.csv --out o b.csv", "healthy", ["a.csv", "b.csv"]),
        ("detect m.toml --out o a.csv", "data", "a.csv"),
        ("detect --out o m.toml a.csv", "data", "a.csv"),
        ("parameters m.toml --json a.csv", "data", "a.csv"),
        ("info --json m.toml", "model", "m.toml"),
        ("example --out d heater", "name", "heater"),
    ],
)
def test_options_may_stand_between_files(line, name, words):
    found = getattr(main._parse(line.split()), name)
    assert (list(map(str, found)) if isinstance(found, list) else str(found)) == words


def completed(line, folder):
    """Return the words that the shell is offered behind a line."""
    pytest.importorskip("argcomplete")
    found = folder / "completions"
    environment = os.environ | {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(found),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run(
        [sys.executable, "-m", "jaxbound.cli"], env=environment, cwd=folder, timeout=60, check=True
    )
    return {word.strip() for word in found.read_text().split("\n")}


def test_completion_yields_commands_options_choices_and_files(tmp_path):
    (tmp_path / "plant.toml").touch()
    assert completed("jaxbound de", tmp_path) == {"demo", "detect"}
    assert completed("jaxbound detect --me", tmp_path) == {"--merge"}
    assert completed("jaxbound detect --l", tmp_path) == {""}, "spellings of before"
    assert completed("jaxbound info pl", tmp_path) == {"plant.toml"}


def test_the_list_of_commands_names_no_option():
    own = {"--help", "--version", "-v", "--verbose"}  # of the program, and for its tracebacks
    text = (CLI / "main.py").read_text()
    for name, parser in main.commands().items():
        for action in parser._actions:
            assert not [o for o in action.option_strings if f'"{o}"' in text and o not in own], name


def test_a_new_option_is_written_in_its_commands_file_alone(monkeypatch):
    monkeypatch.setitem(main.info.OPTIONS.help, "--colour NAME", "of the curtains")
    monkeypatch.setattr(main.info, "run", lambda args: 40 + len(args.colour))
    monkeypatch.setattr(main, "_configure", lambda: None)
    assert main.main(["info", "--colour", "ab"]) == 42


def test_nobody_builds_a_namespace_by_hand():
    files = [*CLI.rglob("*.py"), *(CLI.parents[1] / "tests").rglob("*.py")]
    call = "argparse.Namespace" + "("
    assert len(files) > 100 and not [path for path in files if call in path.read_text()]
