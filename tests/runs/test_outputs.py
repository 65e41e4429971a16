"""What a command may write: never an input, never a file of somebody else, nothing half, and nothing beside
another command.
"""

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from interruptions import interrupted_descend
from streaming_case import recording, shrink, write
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main, pipe
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.runs import ask, fleet

pytestmark = pytest.mark.compiled

MODEL = "# bounds measured by hand\n"  # a comment that no program would write again


def csv_text(samples=60):
    return "t,u1,y1,y2\n" + "".join(
        f"{k / 100},0,{(-1) ** k * 0.05},{(-1) ** k * -0.005}\n" for k in range(samples)
    )


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Return a folder with a model that somebody commented, a healthy recording and a recording in Parquet;
    commands run in it.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    jb.save_model(paper(name="paper"), tmp_path / "model.toml")
    (tmp_path / "model.toml").write_text(MODEL + (tmp_path / "model.toml").read_text())
    (tmp_path / "run.csv").write_text(csv_text())
    shrink(monkeypatch)
    return tmp_path


@pytest.fixture
def parquet(place):
    write(place / "parts", *recording())
    return place


@contextmanager
def untouched(*paths):
    """Check that files keep their bytes."""
    before = {
        p: p.read_bytes()
        for path in paths
        for p in ([path] if path.is_file() else path.rglob("*"))
        if p.is_file()
    }
    assert before
    yield
    assert {p: p.read_bytes() for p in before} == before


def refused(args, sentence, capsys):
    capsys.readouterr()
    assert main.main(list(map(str, args))) == 2
    out, err = capsys.readouterr()
    assert out == "" and sentence in err and err.count("\n") == 1, err


SIGHUP = getattr(signal, "SIGHUP", None)  # Windows has none
DETECT = ["detect", "model.toml", "run.csv", "--out", "out"]
PARQUET = ["detect", "model.toml", "parts", "--out", "out"]
FIT = ["fit", "run.csv", "--inputs", "u1", "--outputs", "y1", "--recipe", "horizon=4", "--out"]
WRITTEN = {"verdicts.csv", "alarms.csv", "run.json", "tested_model.toml"}
TUNE = ["tune", "model.toml", "run.csv", "--steps", "0", "--out"]
NAMES = {
    "itself": lambda p, q: Path(p),
    "a link": lambda p, q: q.symlink_to(p),
    "a hard link": lambda p, q: q.hardlink_to(p),
}


class TestOneFile:
    @pytest.mark.parametrize("name", NAMES)
    @pytest.mark.parametrize(
        "args, victim",
        [
            ([*FIT], "run.csv"),
            ([*FIT, "new.toml", "--plot"], "run.csv"),
            ([*TUNE], "run.csv"),
            ([*TUNE], "model.toml"),
            ([*TUNE, "new.toml", "--plot"], "model.toml"),
            ([*TUNE, "new.toml", "--faulty", "model.toml", "--plot"], "run.csv"),
        ],
    )
    def test_an_input_is_never_an_output(self, place, capsys, args, victim, name):
        target = NAMES[name](place / victim, place / "other") or place / "other"
        with untouched(place / victim):
            refused([*args, target, "--force"], "an input is never an output", capsys)

    def test_the_name_in_other_letters_is_the_same_file_where_the_system_says_so(
        self, place, capsys, monkeypatch
    ):
        """A folder that does not tell RUN.csv from run.csv, as a second name of one file."""
        (place / "RUN.CSV").hardlink_to(place / "run.csv")
        with untouched(place / "run.csv"):
            refused([*FIT, "RUN.CSV", "--force"], "an input is never an output", capsys)

    def test_a_file_in_a_recording_that_is_a_folder_is_a_part_of_it(self, parquet, capsys):
        with untouched(parquet / "parts"):
            refused(
                ["tune", "model.toml", "parts", "--out", "parts/0.parquet", "--force"],
                "a part of parts",
                capsys,
            )
            refused(
                ["tune", "model.toml", "parts", "--out", "m.toml", "--plot", "parts/9.parquet"],
                "a part of parts",
                capsys,
            )

    @pytest.mark.parametrize(
        "args",
        [FIT, TUNE, [*FIT, "new.toml", "--plot"], [*TUNE, "new.toml", "--plot"]],
        ids=lambda a: f"{a[0]}{a[-1]}",
    )
    def test_what_is_there_is_replaced_with_force_only(self, place, capsys, args):
        (place / "mine").write_text(MODEL)
        with untouched(place / "mine"):
            refused([*args, "mine"], "mine exists: --force replaces it", capsys)
        assert not (place / "new.toml").exists()

    def test_force_replaces_it(self, place, capsys):
        (place / "mine.toml").write_text(MODEL)
        assert main.main([*TUNE, "mine.toml", "--force"]) == 0 and jb.load_model("mine.toml").n == 2

    def test_two_options_do_not_name_one_file(self, place, capsys):
        refused([*FIT, "a", "--plot", "./a"], "--out and --plot name the same file", capsys)

    @pytest.mark.posix("named pipes")
    def test_a_pipe_or_device_is_no_file_to_replace(self, place, capsys):
        os.mkfifo("pipe")  # never a device of the machine: a red test would replace it
        refused([*FIT, "pipe", "--force"], "must be a file to write", capsys)
        assert Path("pipe").is_fifo()

    def test_an_interrupted_search_replaces_its_own_file_and_no_other(self, place, capsys, monkeypatch):
        args = ["tune", "model.toml", "run.csv", "--steps", "20", "--out", "new.toml"]
        with monkeypatch.context() as patch:
            interrupted_descend(patch)
            assert main.main(args) == 130
        text = (place / "new.toml").read_text()
        (place / "new.toml").write_text(text + "# a thought\n")
        with untouched(place / "new.toml"):
            refused(args, "new.toml exists", capsys)
        (place / "new.toml").write_text(text)
        assert main.main(args) == 0 and "interrupted" not in (place / "new.toml").read_text()

    def test_a_full_disk_leaves_what_was_there(self, place, capsys, monkeypatch):
        (place / "mine.toml").write_text(MODEL)

        def full(fd):
            raise OSError(errno.ENOSPC, "No space left on device")

        monkeypatch.setattr(os, "fsync", full)
        with untouched(place / "mine.toml"):
            refused([*TUNE, "mine.toml", "--force"], "mine.toml: no space left on device", capsys)
        assert not [p for p in place.iterdir() if p.name.startswith(".")]

    @pytest.mark.parametrize(
        "args",
        [
            ["detect", "model.toml", "run.csv", "--out", ""],
            ["demo", "--out", ""],
            ["study", "model.toml", "--faults", "y1:bias", "--out", ""],
            ["fleet", "run.csv", "--out", ""],
            [*FIT, ""],
            [*FIT, "m.toml", "--plot", ""],
            [*TUNE, ""],
            ["explain", "", "--at", "3"],
            ["detect", "model.toml", "", "--out", "out"],
            ["detect", "", "run.csv", "--out", "out"],
            ["info", ""],
            ["detect", "model.toml", "-", "--state", ""],
        ],
        ids=lambda args: " ".join(args[-2:]),
    )
    def test_an_empty_name_is_none(self, place, capsys, args):
        before = sorted(p.name for p in place.iterdir())
        refused(args, "needs a name, not an empty text", capsys)
        assert sorted(p.name for p in place.iterdir()) == before


class TestFolder:
    @pytest.mark.parametrize(
        "name", ["verdicts.csv", "alarms.csv", "report.html", "run.json", "tested_model.toml"]
    )
    def test_somebody_elses_file_is_in_the_way(self, place, capsys, name):
        (place / "out").mkdir()
        (place / "out" / name).write_text("years of work")
        with untouched(place / "out"):
            refused(DETECT, f"out/{name} is in the way: it was not written by jaxbound", capsys)
        assert os.listdir(place / "out") == [name]

    @pytest.mark.posix("links that anybody may make")
    def test_a_link_is_no_file_of_ours(self, place, capsys):
        (place / "out").mkdir()
        (place / "out/verdicts.csv").symlink_to(place / "precious")
        (place / "precious").write_text("precious")
        with untouched(place / "precious"):
            refused(DETECT, "is in the way", capsys)
        assert (place / "out/verdicts.csv").is_symlink()

    @pytest.mark.parametrize(
        "name", [".jaxbound-lock", ".jaxbound.json", ".jaxbound-work", ".jaxbound-part-of-the-list"]
    )
    @pytest.mark.parametrize("link", ["a link", "a hard link", "a link to nothing", "a link to a folder"])
    def test_no_link_under_a_name_of_ours_is_followed(self, place, capsys, name, link):
        """Before, a link called .jaxbound-lock had its target emptied."""
        name = name.replace(".jaxbound-part-of-the-list", "..jaxbound.json.jaxbound-part")
        (place / "units.csv").write_text("unit,model,recording\nP,model.toml,run.csv\n")
        (place / "out").mkdir()
        (place / "precious").write_text("years of work")
        (place / "files").mkdir()
        (place / "files" / ".before").write_text("years of work")
        target = {"a link to nothing": "nothing", "a link to a folder": "files"}.get(link, "precious")
        NAMES["a hard link" if link == "a hard link" else "a link"](place / target, place / "out" / name)
        sentence = (
            "is no list of jaxbound's files"
            if (name, link) == (".jaxbound.json", "a hard link")
            else "is in the way"
        )
        with untouched(place / "precious", place / "files"):
            refused(DETECT, sentence, capsys)
            refused(["fleet", "units.csv", "--out", "out"], sentence, capsys)
        assert os.listdir(place / "out") == [name] and not (place / "nothing").exists()

    @pytest.mark.posix("links that anybody may make")
    def test_no_link_is_followed_by_a_share(self, parquet, capsys):
        (parquet / "out").mkdir()
        (parquet / "out/.jaxbound-lock").symlink_to(parquet / "model.toml")
        with untouched(parquet / "model.toml"):
            refused([*PARQUET, "--part", "1/2"], "is in the way", capsys)

    @pytest.mark.parametrize("folder", ["verdicts.parquet", "verdicts.partial"])
    @pytest.mark.parametrize("file", ["notes.txt", "part-00000.parquet", "deep/notes.txt"])
    def test_no_folder_is_removed_with_what_somebody_put_there(self, parquet, capsys, folder, file):
        path = parquet / "out" / folder / file
        path.parent.mkdir(parents=True)
        path.write_text("years of work")
        with untouched(parquet / "out"):
            refused(PARQUET, "was not written by jaxbound", capsys)
            assert main.main(DETECT) == 0  # CSV: the folder is not in the way, and stays

    def test_notes_put_among_verdicts_of_ours_stay(self, parquet, capsys):
        assert main.main(PARQUET) == 1
        (parquet / "out/verdicts.parquet/notes.txt").write_text("years of work")
        with untouched(parquet / "out/verdicts.parquet"):
            refused(PARQUET, "out/verdicts.parquet/notes.txt is in the way", capsys)
            assert main.main(DETECT) == 0

    def test_a_recording_inside_is_never_written_over(self, parquet, capsys):
        for name in ("verdicts.csv", "alarms.csv"):
            shutil.copytree(parquet / "parts", parquet / "out", dirs_exist_ok=True)
            (parquet / "out" / name).write_text(csv_text())
            with untouched(parquet / "out"):
                refused(
                    ["detect", "model.toml", f"out/{name}", "--out", "out"],
                    "an input is never an output",
                    capsys,
                )
        shutil.copytree(parquet / "parts", parquet / "in/verdicts.parquet")
        with untouched(parquet / "in"):
            refused(
                ["detect", "model.toml", "in/verdicts.parquet", "--out", "in"],
                "an input is never an output",
                capsys,
            )

    @pytest.mark.parametrize("out", ["parts", "parts/../parts", "link"])
    def test_a_recording_that_is_a_folder_takes_no_report(self, parquet, capsys, out):
        (parquet / "link").symlink_to("parts")
        (parquet / "units.csv").write_text("unit,model,recording\nA,model.toml,parts\n")
        many = ["fleet", "units.csv", "--out"]
        shares = ["--part", "1/1"], ["--merge"], ["--method", "validation"], []
        commands = [[*PARQUET[:3], "--out", out, *more] for more in shares]
        with untouched(parquet / "parts"):
            for command in (*commands, [*many, out], [*many, "fleet", "--state", out]):
                refused(command, "is read: an input is never an output, choose another folder", capsys)
        assert main.main([*PARQUET[:3], "--out", "parts-report"]) == 1

    def test_our_own_verdicts_are_an_input_too(self, place, capsys):
        """A list that names them gives no right to what is read."""
        assert main.main(DETECT) == 0
        with untouched(place / "out"):
            refused(
                ["detect", "model.toml", "out/verdicts.csv", "--out", "out"],
                "an input is never an output",
                capsys,
            )

    def test_standard_input_from_a_file_is_an_input(self, place, capsys):
        (place / "out").mkdir()
        (place / "out/verdicts.csv").write_text(csv_text())
        code = (
            "import sys; from jaxbound.cli.main import main; sys.exit(main(['detect', 'model.toml', '-', "
            "'--out', 'out']))"
        )
        with untouched(place / "out/verdicts.csv"), open("out/verdicts.csv") as f:
            done = subprocess.run([sys.executable, "-c", code], stdin=f, capture_output=True, text=True)
        assert done.returncode == 2 and "an input is never an output" in done.stderr

    def test_a_pipe_does_not_begin_in_somebody_elses_verdicts(self, place, capsys, monkeypatch):
        (place / "out").mkdir()
        (place / "out/verdicts.csv").write_text("years of work")
        monkeypatch.setattr(sys, "stdin", io.StringIO())
        with untouched(place / "out"):
            refused(["detect", "model.toml", "-", "--out", "out"], "out/verdicts.csv is in the way", capsys)

    @pytest.mark.parametrize("state", ["out/verdicts.csv", "out/../out/verdicts.csv", "model.toml"])
    def test_a_state_is_no_other_file(self, place, capsys, monkeypatch, state):
        monkeypatch.setattr(pipe, "arrivals", lambda *args: [csv_text().encode()])
        with untouched(place / "model.toml"):
            assert main.main(["detect", "model.toml", "-", "--out", "out", "--state", state]) == 2
        out, err = capsys.readouterr()
        assert (
            out == ""
            and ("an input is never" in err or "is where the verdicts are written" in err)
            and not (place / "out").exists()
        )

    def test_a_state_may_lie_in_a_folder_that_is_made(self, place, capsysbinary, monkeypatch):
        monkeypatch.setattr(pipe, "arrivals", lambda *args: [csv_text().encode()])
        assert main.main(["detect", "model.toml", "-", "--out", "out", "--state", "out/s.jsonl"]) == 0
        assert {p.name for p in (place / "out").iterdir()} == {
            ".jaxbound.json",
            "verdicts.csv",
            "s.jsonl",
            "run.json",
            "tested_model.toml",
        }

    def test_the_model_that_was_tested_may_be_tested_again(self, place, capsys):
        assert main.main(DETECT) == 0
        (place / "later.csv").write_text(csv_text(80))
        with untouched(place / "out/tested_model.toml"):
            assert main.main(["detect", "out/tested_model.toml", "later.csv", "--out", "out"]) == 0
        assert (place / "out/verdicts.csv").read_text().count("\n") == 81

    def test_what_was_changed_since_is_somebodys(self, place, capsys):
        assert main.main(DETECT) == 0
        (place / "out/alarms.csv").write_text((place / "out/alarms.csv").read_text() + "seen by Ann\n")
        with untouched(place / "out"):
            refused(
                DETECT,
                "out/alarms.csv is in the way: it was not written by jaxbound, or was changed since",
                capsys,
            )

    def test_a_copy_of_a_report_is_known_again(self, place, capsys):
        assert main.main(DETECT) == 0
        shutil.copytree(place / "out", place / "copy", copy_function=shutil.copyfile)
        assert main.main([*DETECT[:-1], "copy"]) == 0

    def test_other_kinds_of_verdicts_of_ours_are_replaced(self, parquet, capsys):
        for args, name in (
            (DETECT, "verdicts.csv"),
            (PARQUET, "verdicts.parquet"),
            (DETECT, "verdicts.csv"),
            (PARQUET, "verdicts.parquet"),
        ):
            main.main(args)
            assert [p.name for p in (parquet / "out").glob("verdicts*")] == [name]

    def test_a_list_that_is_none_is_refused(self, place, capsys):
        (place / "out").mkdir()
        (place / "out/.jaxbound.json").write_text("mine")
        with untouched(place / "out"):
            refused(DETECT, "is no list of jaxbound's files", capsys)

    @pytest.mark.parametrize(
        "args, name",
        [
            (["demo", "--runs", "1", "--out", "out"], "run.csv"),
            (["demo", "--runs", "1", "--out", "out"], "model.toml"),
            (["study", "model.toml", "--faults", "y1:bias", "--out", "out"], "summary.csv"),
            (["study", "model.toml", "--faults", "y1:bias", "--out", "out"], "report.html"),
            (["fleet", "units.csv", "--out", "out"], "fleet.csv"),
            (["fleet", "units.csv", "--out", "out"], "fleet.html"),
            ([*DETECT, "--method", "validation"], "alarms.csv"),
        ],
        ids=lambda x: x if isinstance(x, str) else x[0],
    )
    def test_no_command_replaces_what_it_did_not_write(self, place, capsys, args, name):
        (place / "units.csv").write_text("unit,model,recording\na,model.toml,run.csv\n")
        (place / "out").mkdir()
        (place / "out" / name).write_text("years of work")
        with untouched(place / "out"):
            refused(args, f"out/{name} is in the way", capsys)

    def test_the_table_of_a_fleet_is_an_input(self, place, capsys):
        (place / "out").mkdir()
        (place / "out/fleet.csv").write_text("unit,model,recording\na,../model.toml,../run.csv\n")
        with untouched(place / "out"):
            refused(["fleet", "out/fleet.csv", "--out", "out"], "an input is never an output", capsys)

    def test_a_study_leaves_rows_that_it_did_not_write(self, place, capsys):
        (place / "out/scenarios").mkdir(parents=True)
        (place / "out/scenarios/part-00000.parquet").write_text("years of work")
        with untouched(place / "out"):
            refused(
                [
                    "study",
                    "model.toml",
                    "--faults",
                    "y1:bias",
                    "--rows",
                    "--n",
                    "10",
                    "--scenario",
                    "samples=40",
                    "--out",
                    "out",
                ],
                "holds part-00000.parquet, which is not of this study",
                capsys,
            )

    def test_a_certificate_replaces_no_file_of_somebody(self, place, capsys):
        assert main.main(DETECT) == 0
        explain = ["explain", "out", "--at", "30"]
        assert main.main(explain) == 0 == main.main(explain)
        (place / "out/certificate-30.json").write_text("mine")
        with untouched(place / "out"):
            refused(explain, "--json prints the certificate instead", capsys)

    def test_a_report_that_cannot_be_written_into_says_so_without_options_of_others(
        self, place, capsys, monkeypatch
    ):
        assert main.main(DETECT) == 0
        monkeypatch.setattr(os, "access", lambda *args: False)
        refused(
            ["explain", "out", "--at", "30"],
            "cannot write into out: permission denied; --json prints",
            capsys,
        )

    def test_verdicts_of_the_library_replace_no_folder_of_somebody(self, parquet):
        (parquet / "out/verdicts.parquet").mkdir(parents=True)
        (parquet / "out/verdicts.parquet/notes.txt").write_text("years of work")
        with untouched(parquet / "out"), pytest.raises(ValueError, match="is in the way"):
            jb.detect_dataset(jb.parity_relations(paper()), parquet / "parts", parquet / "out")


class TestNothingHalf:
    def full(self, monkeypatch, after):
        """Let the disk be full after so many renamings of files in a report."""
        replace, left = os.replace, [after]

        def full(a, b):
            if ".jaxbound-work" in f"{a} {b}":
                left[0] -= 1
                if left[0] == -1:
                    raise OSError(errno.ENOSPC, "No space left on device", str(b))
            replace(a, b)

        monkeypatch.setattr(os, "replace", full)

    @pytest.mark.parametrize("after", range(4))
    def test_a_disk_that_is_full_in_the_end_leaves_the_older_report(self, place, capsys, monkeypatch, after):
        assert main.main(DETECT) == 0
        (place / "run.csv").write_text(
            csv_text(50)
        )  # other verdicts, another run.json: each has to leave its place, and one to take it
        before = {p.name: p.read_bytes() for p in (place / "out").iterdir() if p.name[0] != "."}
        with monkeypatch.context() as patch:
            self.full(patch, after)
            refused(DETECT, "no space left on device", capsys)
        assert {p.name: p.read_bytes() for p in (place / "out").iterdir() if p.name[0] != "."} == before
        assert main.main(DETECT) == 0 and (place / "out/verdicts.csv").read_text().count("\n") == 51

    def test_a_new_folder_is_gone_then(self, place, capsys, monkeypatch):
        self.full(monkeypatch, 2)
        refused(DETECT, "no space left on device", capsys)
        assert sorted(p.name for p in place.iterdir()) == ["model.toml", "run.csv"]

    @pytest.mark.posix("mount")
    def test_a_small_disk(self, place, capsys):
        """A mount point with room for verdicts, not for their report."""
        disk = place / "disk"
        disk.mkdir()
        if (
            os.geteuid()
            or subprocess.run(
                ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], capture_output=True
            ).returncode
        ):
            pytest.skip("mounting a small disk needs rights that are not given here")
        try:
            (place / "long.csv").write_text(csv_text(5000))
            (disk / "mine.txt").write_text("mine")
            refused(
                ["detect", "model.toml", "long.csv", "--out", disk], "disk: no space left on device", capsys
            )
            assert os.listdir(disk) == ["mine.txt"]
            assert main.main(["detect", "model.toml", "run.csv", "--out", str(disk)]) == 0
        finally:
            subprocess.run(["umount", disk], check=True)

    def test_a_second_command_is_kept_away_and_the_first_is_not_disturbed(self, place, capsys, monkeypatch):
        codes = []

        def meanwhile(*args, **options):
            codes.append(main.main(DETECT))

        monkeypatch.setattr(evaluation, "write_report", meanwhile)
        assert main.main(DETECT) == 0 and codes == [2]
        assert (
            f"another jaxbound, process {os.getpid()}, is writing into out: wait for it"
            in capsys.readouterr().err
        )
        assert (place / "out/verdicts.csv").exists() and not (place / "out/.jaxbound-lock").exists()

    def test_what_a_killed_command_left_is_found_and_removed(self, place, capsys):
        (place / "out/.jaxbound-work/.before").mkdir(parents=True)
        (place / "out/.jaxbound-work/verdicts.csv").write_text("half")
        (place / "out/.jaxbound-lock").write_text("4711")
        (place / "out/..jaxbound.json.jaxbound-part").write_text("half")
        (place / ".new.toml.jaxbound-part").write_text("half")
        assert main.main(DETECT) == 0 and main.main([*TUNE, "new.toml"]) == 0
        hidden = [p.name for p in (*place.iterdir(), *(place / "out").iterdir()) if p.name.startswith(".")]
        assert hidden == [".jaxbound.json"]

    def test_an_interrupted_move_into_place_is_taken_back(self, place, capsys, monkeypatch):
        replace = os.replace

        def stop(a, b):
            replace(a, b)
            if Path(b).name == "report.html" or Path(b) == Path("out/run.json"):
                raise KeyboardInterrupt

        monkeypatch.setattr(os, "replace", stop)
        assert main.main(DETECT) == 130 and not (place / "out/verdicts.csv").exists()


SLOW = """
import os, signal, sys, time
from jaxbound.cli import evaluation, main as cli
evaluation.write_report = lambda *a, **k: (sys.stdout.write("ready"), sys.stdout.flush(), time.sleep(60))
sys.exit(cli.main(["detect", "model.toml", "run.csv", "--out", "out"]))
"""


@pytest.mark.posix("signals between processes")
class TestSignals:
    @pytest.fixture(autouse=True)
    def heard(self):
        """Signals are as a terminal has them, also where the tests themselves run under nohup."""
        before = signal.signal(SIGHUP, signal.SIG_DFL)
        yield
        signal.signal(SIGHUP, before)

    def stopped_by(self, number, monkeypatch):
        monkeypatch.setattr(
            evaluation, "write_report", lambda *a, **k: (os.kill(os.getpid(), number), time.sleep(5))
        )
        return main.main(DETECT)

    @pytest.mark.parametrize("number, code", [(signal.SIGTERM, 143), (SIGHUP, 129)])
    def test_they_clean_up_as_ctrl_c_does(self, place, capsys, monkeypatch, number, code):
        before = signal.getsignal(number)
        assert self.stopped_by(number, monkeypatch) == code and signal.getsignal(number) == before
        assert (
            capsys.readouterr().err == "jaxbound: interrupted: nothing was written\n"
            and not (place / "out").exists()
        )

    def test_what_is_ignored_stays_ignored(self, place, capsys, monkeypatch):
        before = signal.signal(SIGHUP, signal.SIG_IGN)
        try:
            monkeypatch.setattr(evaluation, "write_report", lambda *a, **k: os.kill(os.getpid(), SIGHUP))
            assert main.main(DETECT) == 0 and (place / "out/verdicts.csv").exists()
        finally:
            signal.signal(SIGHUP, before)

    def test_a_second_signal_does_not_disturb_the_cleaning_up(self, place, capsys, monkeypatch):
        tidy = shutil.rmtree

        def again(*args, **options):
            os.kill(os.getpid(), signal.SIGTERM)
            tidy(*args, **options)

        def stop(*args, **options):
            monkeypatch.setattr(shutil, "rmtree", again)
            os.kill(os.getpid(), SIGHUP)
            time.sleep(5)

        monkeypatch.setattr(evaluation, "write_report", stop)
        assert main.main(DETECT) == 129 and not (place / "out").exists()

    def test_a_fleet_keeps_what_was_tested(self, place, capsys, monkeypatch):
        (place / "units.csv").write_text("unit,model,recording\na,model.toml,run.csv\nb,model.toml,run.csv\n")
        tested = fleet._tested

        def stop(*args, **how):
            if (place / "seen").exists():
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(5)
            (place / "seen").touch()
            return tested(*args, **how)

        monkeypatch.setattr(fleet, "_tested", stop)
        assert main.main(["fleet", "units.csv", "--out", "out"]) == 143
        assert "interrupted before its turn" in (place / "out/fleet.csv").read_text()

    def test_parts_of_a_large_recording_are_kept_and_gone_on_from(self, parquet, capsys, monkeypatch):
        calls, detect = [], jb.detect

        def stop(*args, **options):
            calls.append(1)
            if len(calls) == 4:
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(5)
            return detect(*args, **options)

        monkeypatch.setattr(ask, "detect", stop)
        assert main.main([*PARQUET, "--chunk", "1000"]) == 143
        assert "the same command goes on from there" in capsys.readouterr().err
        assert main.main([*PARQUET, "--chunk", "1000"]) == 1 and len(calls) < 4 + 7

    def test_killed_without_a_word_and_run_again(self, place, capsys):
        process = subprocess.Popen([sys.executable, "-c", SLOW], cwd=place, stdout=subprocess.PIPE)
        assert process.stdout.read(5) == b"ready"
        refused(DETECT, f"another jaxbound, process {process.pid}, is writing into out", capsys)
        late = time.monotonic() + 30  # the tables are written beside the report
        while not (place / "out/.jaxbound-work/verdicts.csv").exists() and time.monotonic() < late:
            time.sleep(0.02)
        process.kill()
        process.wait()
        process.stdout.close()
        assert (place / "out/.jaxbound-work/verdicts.csv").exists() and not (
            place / "out/verdicts.csv"
        ).exists()
        assert main.main(DETECT) == 0
        assert {p.name for p in (place / "out").iterdir()} == {
            ".jaxbound.json",
            "verdicts.csv",
            "alarms.csv",
            "run.json",
            "tested_model.toml",
        }

    @pytest.mark.parametrize("number, code", [(signal.SIGTERM, 143), (SIGHUP, 129)])
    def test_from_a_shell(self, place, number, code):
        process = subprocess.Popen(
            [sys.executable, "-c", SLOW], cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        assert process.stdout.read(5) == b"ready"
        process.send_signal(number)
        err = process.communicate(timeout=60)[1]
        assert (
            process.returncode == code
            and err == b"jaxbound: interrupted: nothing was written\n"
            and not (place / "out").exists()
        )


def test_models_and_states_are_written_whole(place, monkeypatch):
    (place / "other.toml").write_text(MODEL)
    monkeypatch.setattr(
        os, "fsync", lambda fd: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left on device"))
    )
    with untouched(place / "other.toml"), pytest.raises(OSError, match="No space"):
        jb.save_model(paper(), place / "other.toml")
    assert not list(place.glob(".other*"))


@pytest.mark.parametrize("link", ["a link", "a hard link"])
def test_what_lies_beside_a_file_that_is_written_is_not_followed(place, link):
    (place / "precious").write_text("years of work")
    NAMES[link](place / "precious", place / ".new.toml.jaxbound-part")
    with untouched(place / "precious"), pytest.raises(OSError, match="in the way"):
        jb.save_model(paper(), place / "new.toml")
    assert not (place / "new.toml").exists()


@pytest.mark.posix("links that anybody may make")
def test_links_in_the_place_of_what_is_kept_are_not_followed(place):
    (place / "kept").mkdir()
    (place / "first").write_bytes(b"")
    (place / "kept" / "b").hardlink_to(place / "first")  # as a backup does: another file takes this name
    Checkpoint(place / "kept" / "b", {}).save(x=np.zeros(2))
    assert (place / "first").read_bytes() == b""
    (place / "kept" / "a").symlink_to(place / "nothing")
    with pytest.raises(OSError, match="in the way"):
        Checkpoint(place / "kept" / "a", {}).save(x=np.zeros(2))
    assert not (place / "nothing").exists()


@pytest.mark.posix("named pipes")
def test_the_library_writes_into_a_pipe_and_does_not_replace_it(place):
    os.mkfifo("pipe")
    reader = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        jb.save_model(paper(), "pipe")
        assert b"[matrices]" in os.read(reader, 1 << 16) and Path("pipe").is_fifo()
    finally:
        os.close(reader)


def test_a_list_names_each_file_with_size_time_and_digest(place):
    assert main.main(DETECT) == 0
    listed = json.loads((place / "out/.jaxbound.json").read_text())["written by jaxbound"]
    assert set(listed) == WRITTEN
    assert all(np.shape(entries) == (1, 3) for entries in listed.values())
