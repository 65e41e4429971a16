"""The command line: exit codes, one clear sentence for what is wrong, and a report completely or not at
all.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.consistency import interface
from jaxbound.models.modelfile import load_model, save_model, template
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.verdictfiles import VerdictTable

HEADER = "t,u1,y1,y2"
FILES = {"verdicts.csv", "alarms.csv", "report.html", "run.json", "tested_model.toml", ".jaxbound.json"}


def rows(n=60, fault=(), missing=()):
    """Return CSV lines of the paper's system without any error, with a bias of 1 on y1 at the samples
    `fault`.
    """
    x, out = np.zeros(2), []
    for k in range(n):
        u = 1.0 if (k // 20) % 2 else -0.5
        y1, y2 = x[0] + (k in fault), x[0] + x[1]
        out.append(f"{k / 100:g},{u},{'' if k in missing else y1},{'' if k in missing else y2}")
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u])
    return out


@pytest.fixture(autouse=True)
def unconfigured(monkeypatch, tmp_path_factory):
    """Leave jax's configuration as conftest set it; keep tracebacks of internal errors out of the way."""
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(main.tempfile, "tempdir", str(tmp_path_factory.mktemp("temp")))


@pytest.fixture
def place(tmp_path):
    """Return a folder with good.csv, faulty.csv and model.toml."""
    save_model(paper(name="paper"), tmp_path / "model.toml")
    (tmp_path / "good.csv").write_text("\n".join([HEADER, *rows()]) + "\n")
    (tmp_path / "faulty.csv").write_text("\n".join([HEADER, *rows(fault=range(30, 33))]) + "\n")
    return tmp_path


def run(place, *args, capsys):
    """Run the command line; return (code, stdout, stderr)."""
    code = main.main(
        [
            str(place / a) if str(a).endswith((".toml", ".csv", ".parquet")) or a == "out" else str(a)
            for a in args
        ]
    )
    return code, *capsys.readouterr()


class TestDetect:
    def test_no_fault_is_0(self, place, capsys):
        code, out, err = run(place, "detect", "model.toml", "good.csv", "--out", "out", capsys=capsys)
        assert code == 0 and err == "" and out.startswith("No fault found: the model explains all 59 windows")
        assert {p.name for p in (place / "out").iterdir()} == FILES

    def test_fault_is_1(self, place, capsys):
        code, out, _ = run(place, "detect", "model.toml", "faulty.csv", "--out", "out", capsys=capsys)
        assert code == 1 and "Fault proved: " in out and "would need bounds" in out and "report.html" in out
        verdicts = (place / "out/verdicts.csv").read_text().splitlines()
        assert (
            verdicts[0] == "time,status,margin,suspect"
            and len(verdicts) == 61
            and verdicts[1].startswith("0,MISSING,,false")
        )
        assert any(line.startswith("0.3,FAULT,-") and line.endswith(",true") for line in verdicts)

    def test_verdicts_are_those_of_the_library(self, place, capsys):
        run(
            place,
            "detect",
            "model.toml",
            "faulty.csv",
            "--out",
            "out",
            "--test",
            "horizon=2,method=box",
            capsys=capsys,
        )
        data = np.genfromtxt(place / "faulty.csv", delimiter=",", skip_header=1)
        res = jb.detect(jb.parity_relations(paper(), 2), data[:, 1:2], data[:, 2:], method="box")
        written = [line.split(",")[1] for line in (place / "out/verdicts.csv").read_text().splitlines()[1:]]
        assert written == [jb.Status(int(s)).name for s in res.status]

    def test_too_little_evidence_is_3(self, place, capsys):
        (place / "holes.csv").write_text("\n".join([HEADER, *rows(missing=range(5, 50)), ""]))
        args = ("detect", "model.toml", "holes.csv", "--out", "out")
        code, out, _ = run(place, *args, capsys=capsys)
        assert code == 3 and out.startswith("Too little evidence: only 13 of 59 windows (22 %)")
        assert run(place, *args, "--min-coverage", "0.2", capsys=capsys)[0] == 0

    def test_box_alone_proves_no_health(self, place, capsys):
        assert (
            run(place, "detect", "model.toml", "good.csv", "--out", "out", "--method", "box", capsys=capsys)[
                0
            ]
            == 3
        )

    def test_all_fault_says_what_does_not_fit(self, place, capsys):
        save_model(paper(tolerance=0, noise="0.000001"), place / "model.toml")
        lines = [f"{k / 100},0,{k % 7},{k % 3}" for k in range(50)]
        (place / "wild.csv").write_text("\n".join([HEADER, *lines, ""]))
        code, out, _ = run(place, "detect", "model.toml", "wild.csv", "--out", "out", capsys=capsys)
        assert code == 1 and re.search(
            r"the model or its bounds do not fit this recording: all bounds times .* would", out
        )

    def test_json_is_the_only_thing_on_stdout(self, place, capsys):
        code, out, err = run(
            place, "detect", "model.toml", "faulty.csv", "--out", "out", "--json", capsys=capsys
        )
        found = json.loads(out)
        assert code == found["exit_code"] == 1 and found["verdict"] == "fault" and err == ""
        assert (
            sum(found["counts"].values()) == found["samples"] == 60
            and found["worst"]["factor"] > 1
            and found["alarms"] >= 1
        )

    def test_alarm_needs_k_of_n(self, place, capsys):
        counts = []
        for alarm in ("1/1", "1/50", "40/50"):
            code, out, _ = run(
                place,
                "detect",
                "model.toml",
                "faulty.csv",
                "--out",
                "out",
                "--json",
                "--alarm",
                alarm,
                capsys=capsys,
            )
            counts.append(json.loads(out)["alarms"])
            assert code == 1  # alarms group proofs, they do not unmake them
        assert counts[1] == 1 and counts[2] == 0

    def test_a_second_run_replaces_the_files_and_leaves_others(self, place, capsys):
        (place / "out").mkdir()
        (place / "out/mine.txt").write_text("mine")
        for data in ("good.csv", "faulty.csv"):
            run(place, "detect", "model.toml", data, "--out", "out", capsys=capsys)
        assert "FAULT" in (place / "out/verdicts.csv").read_text() and {
            p.name for p in (place / "out").iterdir()
        } == FILES | {"mine.txt"}
        assert {p.name for p in place.iterdir()} == {
            "model.toml",
            "good.csv",
            "faulty.csv",
            "out",
        }  # no working folder is left

    def test_names_are_neither_markup_nor_html(self, place, capsys):
        evil = "[red]<script>alert(1)</script>[/red]"
        save_model(paper(name=evil, units={"y1": evil}, provenance={"noise": evil}), place / "model.toml")
        code, _, _ = run(place, "detect", "model.toml", "faulty.csv", "--out", "out", capsys=capsys)
        page = (place / "out/report.html").read_text()
        assert code == 1 and page.count("<script") == 3 and "&lt;script&gt;" in page
        assert evil in run(place, "info", "model.toml", capsys=capsys)[1]

    def test_tclab_is_healthy_and_a_jump_is_not(self, shared, tmp_path, capsys):
        d = json.loads(shared("data/tclab/model.json").read_text())
        lines = shared("data/tclab/mimo_hybrid_3s.csv").read_text().splitlines()
        first = [float(x) for x in lines[1].split(",")[3:]]
        names = {"inputs": ["Heater 1", "Heater 2"], "outputs": ["Temperature 1", "Temperature 2"]}
        m = jb.LinearSystem(
            d["A"],
            d["B"],
            d["C"],
            dt=d["dt"],
            noise=d["noise_bound"]["s4"],
            resolution="0.005",
            offset={"y": first},
            **names,
        )
        save_model(m, tmp_path / "model.toml")
        jump = [
            ",".join(
                c if i != 3 or not 100 < k < 130 else str(float(c) + 3) for i, c in enumerate(line.split(","))
            )
            for k, line in enumerate(lines)
        ]
        for name, text, expected in (("good.csv", lines, 0), ("jump.csv", jump, 1)):
            (tmp_path / name).write_text("\n".join([*text, ""]))
            assert (
                run(
                    tmp_path,
                    "detect",
                    "model.toml",
                    name,
                    "--out",
                    "out",
                    "--test",
                    "horizon=4",
                    capsys=capsys,
                )[0]
                == expected
            )


def csv_text(lines, header=HEADER):
    return "\n".join([header, *lines]) + "\n"


TIMED = rows()
BAD_DATA = {
    "missing column": (csv_text(TIMED, "t,u1,y1,y3"), "no column 'y2'; did you mean"),
    "text in a number column": (
        csv_text([*TIMED, "0.6,1,broken,2"]),
        "row 62 of column 'y1' holds 'broken', which is not a number",
    ),
    "all NaN": (csv_text([f"{k / 100},1,NaN,1" for k in range(30)]), "column 'y1' holds no number at all"),
    "empty file": ("", "the file is empty"),
    "header only": (HEADER + "\n", "a header but no row of data"),
    "one row": (csv_text(TIMED[:1]), "one row of data"),
    "newest first": (csv_text(TIMED[::-1]), "the rows run backwards in time, the newest first"),
    "wrong dt": (
        csv_text([f"{k},1,1,1" for k in range(30)]),
        "the model has dt = 0.01 s, but the rows of the recording are 1 s apart",
    ),
    "duplicate column": (csv_text([r + ",1" for r in TIMED], HEADER + ",y1"), "2 columns are called 'y1'"),
    "infinity": (csv_text([*TIMED, "0.6,1,inf,2"]), "row 62 of column 'y1' is infinite or too large"),
    "ragged": (csv_text([*TIMED[:-1], "0.59,1", "0.6,1,1,1"]), "row 61 has 2 cells, the header has 4"),
    "binary": (bytes(range(128, 192)) + bytes(64), "binary file"),
    "Parquet inside, truncated": (
        b"PAR1" + bytes(64),
        "bad.csv is a truncated Parquet file: its end is missing",
    ),
}
BAD_MODEL = {
    "wrong shapes": (("[1, 0],", "[1, 0, 2],"), "rows have different lengths"),
    "shapes that do not fit": (
        ("C = [\n    [1, 0],\n    [1, 1],\n]", "C = [[1, 0, 0], [1, 1, 0]]"),
        "C must have shape",
    ),
    "negative bound": (("noise = 0.1", "noise = -0.1"), "noise must be >= 0: output 'y1' has -0.1"),
    "tolerance of 1": (("tolerance = 0.1", "tolerance = 1"), "tolerance is relative and must be below 1"),
    "no output": (("C = [\n    [1, 0],\n    [1, 1],\n]", "C = []"), "the model has no output"),
    "a field that is unknown": (
        ("noise = 0.1", "niose = 0.1"),
        "unknown field 'niose'; did you mean 'noise'",
    ),
    "TOML syntax": (("dt = 0.01", "dt = 0.01.2"), "not valid TOML: .*line 2"),
    "not a number": (("noise = 0.1", 'noise = "low"'), "'low' is not a finite number"),
    "another dt": (
        ("dt = 0.01", "dt = 0.02"),
        "the model has dt = 0.02 s, but the rows of the recording are 0.01 s apart",
    ),
}
DETECT = ["detect", "model.toml", "good.csv", "--out", "out"]
BAD_USAGE = {
    "missing model": (["detect", "none.toml", "good.csv", "--out", "out"], "there is no model file"),
    "missing data": (["detect", "model.toml", "none.csv", "--out", "out"], "there is no data file"),
    "folder for a model": (
        ["detect", ".", "good.csv", "--out", "out"],
        r"\. is a folder: a model file is needed",
    ),
    "folder without Parquet": (
        ["detect", "model.toml", "texts", "--out", "out"],
        "texts is a folder without Parquet files: it has a.csv",
    ),
    "empty folder": (
        ["detect", "model.toml", "empty", "--out", "out"],
        "empty is a folder without Parquet files: it is empty",
    ),
    "standard input": (["detect", "model.toml", "-", "--out", "out"], "standard input is empty"),
    "no Parquet": (
        ["detect", "model.toml", "text.parquet", "--out", "out"],
        "text.parquet is no Parquet file",
    ),
    "horizon 0": ([*DETECT, "--test", "horizon=0"], "horizon 0 gives no relation.* horizon with one is 1"),
    "window longer than the data": (
        ["detect", "tiny.toml", "short.csv", "--out", "out", "--test", "horizon=5"],
        "has 4 samples, one window needs 6",
    ),
    "alarm 3/2": (
        [*DETECT, "--alarm", "3/2"],
        "--alarm needs a rule k/n with 1 <= k <= n, like 3/5, or plain, not '3/2'",
    ),
    "alarm without n": ([*DETECT, "--alarm", "3"], "--alarm needs a rule k/n"),
    "unknown method": ([*DETECT, "--method", "best"], "method must be one of windows, box, observer"),
    "a method that is gone": (
        [*DETECT, "--method", "paving"],
        "'paving' is gone: \"windows\" decides the same",
    ),
    "horizon in words": ([*DETECT, "--test", "horizon=two"], "horizon of --test must be a whole number >= 0"),
    "horizon of another script": (
        [*DETECT, "--test", "horizon=\u0663"],
        "horizon of --test must be a whole number >= 0",
    ),
    "coverage with an underscore": ([*DETECT, "--min-coverage", "0_0.5"], "--min-coverage needs a share"),
    "sizes with an underscore": (
        [*DETECT, "--alarm", "least=1_0"],
        "least of --alarm: '1_0' is not a finite number",
    ),
    "coverage of 2": ([*DETECT, "--min-coverage", "2"], "--min-coverage needs a share"),
    "chunks of CSV": ([*DETECT, "--chunk", "9"], "--chunk is for Parquet: good.csv is read as a whole"),
    "no overlap of CSV": (
        [*DETECT, "--overlap", "0"],
        "--overlap is for Parquet: good.csv is read as a whole",
    ),
    "chunk of nothing": ([*DETECT, "--chunk", "0"], "--chunk needs a whole number >= 1"),
    "unknown option": (
        [*DETECT, "--speed", "9"],
        "there is no option --speed of jaxbound detect",
    ),
    "no --out": (["detect", "model.toml", "good.csv"], "the following arguments are required: --out"),
    "unknown command": (["detekt"], r"there is no command 'detekt' \(did you mean detect\?\)"),
    "fit without outputs": (["fit", "good.csv", "--out", "m.toml"], "--outputs is needed: the columns that"),
    "info of nothing": (["info"], "needs either a model file or --template"),
    "info of windows of a device": (["info", "--device", "--test", "horizon=3"], "none is given"),
    "out is a file": (
        ["detect", "model.toml", "good.csv", "--out", "good.csv"],
        "good.csv is a file: a folder is needed",
    ),
    "out below a file": (
        ["detect", "model.toml", "good.csv", "--out", "good.csv/out"],
        "cannot write into good.csv/out: not a directory",
    ),
}


class TestBadInput:
    def refused(self, place, args, message, capsys, monkeypatch):
        monkeypatch.chdir(place)
        before = sorted(p.name for p in place.iterdir())
        code = main.main(args)
        out, err = capsys.readouterr()
        assert code == 2 and out == "", err
        assert re.search(message, err), err
        assert err.startswith("jaxbound: ") and err.count("\n") == 1 and "Traceback" not in err
        assert sorted(p.name for p in place.iterdir()) == before  # no folder, no working files

    @pytest.mark.parametrize("case", BAD_DATA)
    def test_data(self, place, case, capsys, monkeypatch):
        data, message = BAD_DATA[case]
        (place / "bad.csv").write_bytes(data if isinstance(data, bytes) else data.encode())
        self.refused(
            place, ["detect", "model.toml", "bad.csv", "--out", "new/out"], message, capsys, monkeypatch
        )

    @pytest.mark.parametrize("case", BAD_MODEL)
    def test_model(self, place, case, capsys, monkeypatch):
        (old, new), message = BAD_MODEL[case]
        text = (place / "model.toml").read_text()
        assert old in text
        (place / "model.toml").write_text(text.replace(old, new, 1))
        self.refused(place, DETECT, message, capsys, monkeypatch)

    @pytest.mark.parametrize("case", BAD_USAGE)
    def test_usage(self, place, case, capsys, monkeypatch):
        args, message = BAD_USAGE[case]
        (place / "text.parquet").write_text("t,u1,y1,y2")
        (place / "empty").mkdir()
        (place / "texts").mkdir()
        (place / "texts/a.csv").write_text("t,u1,y1,y2")
        save_model(jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.01, noise=0.1), place / "tiny.toml")
        (place / "short.csv").write_text(csv_text(TIMED[:4]))
        self.refused(place, args, message, capsys, monkeypatch)

    def test_a_refusal_leaves_an_older_report_as_it_is(self, place, capsys, monkeypatch):
        run(place, "detect", "model.toml", "good.csv", "--out", "out", capsys=capsys)
        before = {p.name: p.read_bytes() for p in (place / "out").iterdir()}
        (place / "bad.csv").write_text(HEADER)
        self.refused(
            place, ["detect", "model.toml", "bad.csv", "--out", "out"], "no row of data", capsys, monkeypatch
        )
        assert {p.name: p.read_bytes() for p in (place / "out").iterdir()} == before

    def test_huge_values_are_judged_not_crashed_on(self, place, capsys):
        lines = rows()
        lines[30] = "0.3,1e308,1e308,-1e308"
        (place / "huge.csv").write_text(csv_text(lines))
        code, out, err = run(place, "detect", "model.toml", "huge.csv", "--out", "out", capsys=capsys)
        assert code in (0, 1) and err == "" and "Traceback" not in out

    def test_runs_of_nan_are_fine(self, place, capsys):
        (place / "holes.csv").write_text(csv_text(rows(missing=range(10, 20))))
        code, out, _ = run(place, "detect", "model.toml", "holes.csv", "--out", "out", capsys=capsys)
        assert code == 0 and "10 of 60 samples of y1 are missing" in out

    def test_a_full_disk_is_no_internal_error(self, place, capsys, monkeypatch):
        def full(*args, **kwargs):
            raise OSError(28, "No space left on device", "verdicts.csv")

        monkeypatch.setattr(VerdictTable, "add", full)
        self.refused(place, DETECT, "out: no space left on device", capsys, monkeypatch)


class TestOtherEnds:
    def test_interrupted_is_130_and_leaves_nothing(self, place, capsys, monkeypatch):
        def stop(*args, **kwargs):
            raise KeyboardInterrupt

        monkeypatch.setattr(evaluation, "write_report", stop)
        code, out, err = run(place, "detect", "model.toml", "good.csv", "--out", "out", capsys=capsys)
        assert (code, out, err) == (130, "", "jaxbound: interrupted: nothing was written\n")
        assert {p.name for p in place.iterdir()} == {"model.toml", "good.csv", "faulty.csv"}

    def test_our_own_mistake_is_70_with_a_traceback_in_a_file(self, place, capsys, monkeypatch):
        monkeypatch.setattr(evaluation, "write_report", lambda *a, **k: 1 / 0)
        code, out, err = run(place, "detect", "model.toml", "good.csv", "--out", "out", capsys=capsys)
        assert (
            code == 70 and out == "" and err.count("\n") == 1 and "internal error, ZeroDivisionError" in err
        )
        assert "division by zero" in Path(re.search(r"\S+\.txt", err)[0]).read_text()
        assert not (place / "out").exists()

    def test_help_and_version(self, capsys):
        for args, text in (
            (["--version"], f"jaxbound {jb.__version__}"),
            (["--help"], "exit codes: 0 no fault, 1 fault found"),
            (["detect", "--help", "all"], "--min-coverage"),
        ):
            assert main.main(args) == 0
            assert text in " ".join(capsys.readouterr().out.split())

    def test_info(self, place, capsys):
        code, out, _ = run(place, "info", "model.toml", capsys=capsys)
        assert code == 0
        for part in (
            "paper",
            "A 2x2, B 2x1, C 2x2, D zero",
            "y1 0.02, y2 0.1",
            "origin not stated",
            "2 independent, 4 combinations",
            "r1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0",
        ):
            assert part in out
        assert re.search(
            r"tolerance +y1 0.02, y2 0.1 +\(origin|tolerance +none$", out, re.M
        ) and not re.search(r"none +\(origin", out)
        assert "20 combinations" in run(place, "info", "model.toml", "--test", "horizon=2", capsys=capsys)[1]

    def test_template_is_a_model(self, tmp_path, capsys):
        assert main.main(["info", "--template"]) == 0
        out = capsys.readouterr().out
        (tmp_path / "m.toml").write_text(out)
        assert out == template() and load_model(tmp_path / "m.toml").p == 2


@pytest.fixture
def shell(place):
    """Return (arguments of a process, its environment): the real program with a cache of its own, but for the
    fonts it has found.
    """
    environment = {
        k: v
        for k, v in os.environ.items()
        if k not in ("JAX_PLATFORMS", "JAX_ENABLE_X64", "JAX_COMPILATION_CACHE_DIR")
    }
    return [sys.executable, "-m", "jaxbound"], {
        **environment,
        "XDG_CACHE_HOME": str(place / "cache"),
        "MPLCONFIGDIR": matplotlib.get_cachedir(),
    }


class TestShell:
    def test_help_and_version_wait_for_no_import(self):
        code = """
import sys
from jaxbound.cli.main import main
for command in ("", "demo", "detect", "explain", "fleet", "fit", "tune", "study", "info"):
    main([*command.split(), "--help"])
main(["--version"])
print(*sys.modules, file=sys.stderr)
"""
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
        )
        heavy = {"jax", "numpy", "pandas", "matplotlib", "scipy", "pyarrow", "rich", "jinja2", "optax"}
        assert heavy & {name.partition(".")[0] for name in done.stderr.split()} == set()
        shown = " ".join(done.stdout.split())
        for method in (*interface.METHODS[1:], VALIDATION):
            assert f"method={method} (" in shown

    def test_no_command_waits_for_an_import_that_it_can_do_without(self, place):
        code = """
import sys
from jaxbound.cli import main
from jaxbound.sets.floats.kernel import outside_xla
main._configure = lambda: None
numpy = outside_xla()  # nothing is compiled, and what is imported is the same
numpy.__enter__()
main.main("detect model.toml faulty.csv --out out -q".split())
print(*sys.modules, file=sys.stderr)
fit = "fit good.csv --inputs u1 --outputs y1,y2 --recipe order=1,horizon=2,held_out=0,method=windows"
main.main(f"{fit} --out fitted.toml -q".split())
print(*sys.modules, file=sys.stderr)
main.main("study model.toml --faults y1:bias --sizes 1 --n 20 --scenario samples=20 --out study -q".split())
print(*sys.modules, file=sys.stderr)
"""
        settings = {**os.environ, "JAX_ENABLE_X64": "1"}
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=place, env=settings, capture_output=True, text=True, timeout=300
        )
        lines = [line.split() for line in done.stderr.splitlines()][-3:]
        detect, fit, study = ({name.partition(".")[0] for name in line} for line in lines)
        assert fit.isdisjoint({"pandas", "matplotlib", "scipy", "optax"})
        assert detect.isdisjoint({"pandas", "matplotlib", "scipy", "optax"})
        assert "jaxbound.runs" in lines[0] and "jaxbound.studies" not in lines[0]
        assert study.isdisjoint({"pandas", "optax"})
        assert all(
            (place / name).exists() for name in ("out/report.html", "fitted.toml", "study/report.html")
        )

    def test_a_run_from_the_shell(self, place, shell):
        args, environment = shell
        args = [*args, "detect", "model.toml", "faulty.csv", "--out", "out", "--json"]
        environment = environment | {"JAXBOUND_COMPILE": "always"}
        done = subprocess.run(args, env=environment, cwd=place, capture_output=True, text=True, timeout=120)
        assert done.returncode == 1 and done.stderr == "" and json.loads(done.stdout)["verdict"] == "fault"
        assert any((place / "cache/jaxbound").iterdir())  # compiled kernels are kept
        assert "float64" in (place / "out/report.html").read_text()

    def test_an_unwritable_cache_is_no_trouble(self, place, shell):
        args, environment = shell
        environment["XDG_CACHE_HOME"] = str(place / "good.csv")
        args = [*args, "detect", "model.toml", "none.csv", "--out", "out"]
        done = subprocess.run(args, env=environment, cwd=place, capture_output=True, text=True, timeout=120)
        assert (
            done.returncode == 2
            and done.stderr == "jaxbound: there is no data file none.csv\n"
            and done.stdout == ""
        )

    @pytest.mark.posix("signals between processes")
    def test_ctrl_c(self, place, shell):
        args, environment = shell
        code = """
import signal, sys, time
from jaxbound.cli import evaluation, main as cli
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell makes background jobs ignore it
evaluation.write_report = lambda *a, **k: (sys.stdout.write("ready"), sys.stdout.flush(), time.sleep(60))
sys.exit(cli.main(["detect", "model.toml", "good.csv", "--out", "out"]))
"""
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            env=environment,
            cwd=place,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert process.stdout.read(5) == b"ready"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert process.returncode == 130 and err == b"jaxbound: interrupted: nothing was written\n"
        assert {p.name for p in place.iterdir()} == {"model.toml", "good.csv", "faulty.csv", "cache"}
