"""`jaxbound explain`: a window of a report by number or time, its certificate for people and as JSON, or one
clear sentence.
"""

import json
import os
import shutil

import check_certificate
import numpy as np
import pyarrow.parquet as pq
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.cli.certificate_text import certificate_text
from jaxbound.cli.explanation import explain_window
from jaxbound.models.modelfile import save_model
from jaxbound.recordings.csvfiles import CsvFile
from jaxbound.sets.floats.status import Status

FAULTY = range(30, 33)


def table(stamps=None, n=60):
    """Return (header, rows) of the paper's system with a bias of 1 on y1 at the samples FAULTY; a gap of 5
    samples before sample 50.
    """
    x, rows = np.zeros(2), []
    for k in range(n):
        u = 1.0 if (k // 20) % 2 else -0.5
        rows.append(
            [
                stamps(k + 5 * (k >= 50)) if stamps else f"{(k + 5 * (k >= 50)) / 100:g}",
                u,
                x[0] + (k in FAULTY),
                x[0] + x[1],
            ]
        )
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u])
    return ["time", "u1", "y1", "y2"], rows


def csv(path, stamps=None, sep=","):
    header, rows = table(stamps)
    path.write_text("\n".join(sep.join(map(str, row)) for row in [header, *rows]) + "\n", encoding="utf-8")


@pytest.fixture(autouse=True)
def unconfigured(monkeypatch, tmp_path_factory):
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(main.tempfile, "tempdir", str(tmp_path_factory.mktemp("temp")))


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """Return a folder with a report made by the command line, once."""
    place = tmp_path_factory.mktemp("explained")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(main, "_configure", lambda: None)
        save_model(paper(name="paper", units={"y1": "bar"}), place / "model.toml")
        csv(place / "run.csv")
        assert (
            main.main(
                ["detect", str(place / "model.toml"), str(place / "run.csv"), "--out", str(place / "out")]
            )
            == 1
        )
    return place


@pytest.fixture
def place(reported, tmp_path):
    """Return a fresh copy of the report; its recording stays where it was."""
    shutil.copytree(reported / "out", tmp_path / "out")
    return tmp_path


def explain(place, at, *options, capsys):
    code = main.main(["explain", str(place / "out"), "--at", at, *options])
    return code, *capsys.readouterr()


def test_a_fault_is_explained_in_words_and_written_as_json(place, capsys):
    code, out, err = explain(place, "31", capsys=capsys)
    assert code == 0 and err == ""
    assert out.startswith("FAULT proved: the window from 0.3 s to 0.31 s, sample 31\n")
    for part in (
        "violated",
        "and the bounds allow ±",
        "times the stated ones",
        "y1 wrong?",
        " bar of this sensor alone, another at each sample, would explain the window",
    ):
        assert part in out
    document = json.loads((place / "out/certificate-31.json").read_text())
    assert document["names"]["sample"] == 31 and document["names"]["times"] == ["0.3 s", "0.31 s"]
    check_certificate.confirm(document)


def test_a_consistent_window_is_explained_by_a_behaviour(place, capsys):
    code, out, _ = explain(place, "0.1 s", capsys=capsys)
    assert code == 0 and out.startswith("CONSISTENT proved: the window from 0.09 s to 0.1 s, sample 10\n")
    assert (
        "first state" in out
        and "of the bounds are used" in out
        and "explained by" not in out
        and out.count("\n") < 10
    )
    for option in ("--all", "-v"):
        code, out, _ = explain(place, "0.1 s", option, capsys=capsys)
        assert (
            code == 0
            and out.index("first state") < out.index("explained by")
            and "0.09 s" in out.split("explained by")[1]
        )
    assert (
        explain(place, "0.1 s", "-q", capsys=capsys)[1]
        == "CONSISTENT proved: the window from 0.09 s to 0.1 s, sample 10\n"
    )


def test_json_goes_to_stdout_and_nothing_is_written(place, capsys):
    before = sorted(p.name for p in (place / "out").iterdir())
    code, out, err = explain(place, "0.31", "--json", capsys=capsys)
    document = json.loads(out)
    assert (code, err, document["names"]["sample"]) == (0, "", 31) and before == sorted(
        p.name for p in (place / "out").iterdir()
    )
    check_certificate.confirm(document)


def test_the_cause_of_a_fault_comes_first(place, capsys):
    code, out, _ = explain(place, "31", capsys=capsys)
    assert code == 0 and out.splitlines()[1].startswith("cause")
    assert "bias of y1: +" in out and " bar of y1 explains it" in out
    code, out, err = explain(place, "31", "--cause", "--json", capsys=capsys)
    found = json.loads(out)
    assert (code, err, found["windows"], found["not_weighed"]) == (0, "", [31], {})
    assert [entry["fault"] for entry in found["explains"]][0] == "bias of y1"
    assert 0 < found["explains"][0]["size"] <= 1  # the bias that was put in is 1


def test_faults_are_named_by_another_file(place, capsys):
    save_model(paper(faults=[jb.NamedFault("y2 is off", output="y2", sign="+")]), place / "named.toml")
    code, out, _ = explain(place, "31", "--cause", "--faults", str(place / "named.toml"), capsys=capsys)
    assert code == 0 and out.startswith("none of the named faults explains this\n") and "y2 is off" in out
    save_model(paper(), place / "named.toml")
    code, out, err = explain(place, "31", "--cause", "--faults", str(place / "named.toml"), capsys=capsys)
    assert (code, out) == (2, "") and "names no fault: write [[fault]] above each of them" in err
    code, out, err = explain(place, "10", "--cause", capsys=capsys)
    assert (code, out) == (2, "") and "there is nothing to diagnose" in err


def test_every_window_has_the_verdict_of_the_report(place):
    header, rows = table()
    data = np.array(rows, dtype=float)
    res = jb.detect(jb.parity_relations(paper()), data[:, 1:2], data[:, 2:], starts=[50])
    for k in [*range(1, 50), *range(51, 60)]:  # a gap lies before sample 50
        explained = explain_window(place / "out", str(k), lambda stage, share: None)
        c, sample = explained.certificate, explained.sample
        assert (
            sample == k
            and c.status == res.status[k]
            and float(c.factor) == pytest.approx(1 - res.margin[k], abs=1e-9)
        )


@pytest.mark.parametrize(
    "at, sentence",
    [
        ("0", "sample 0 is too early: the first window ends at sample 1, 0.01 s"),
        ("60", "there is no sample 60: the recording has 60, numbered from 0"),
        ("-1", "there is no sample -1: the recording has 60, numbered from 0"),
        ("noon", "--at noon names no sample: give its number, or its time as alarms.csv has it, like 0 s"),
        (
            "0.53 s",
            "no sample lies at 0.53 s: the nearest is at 0.55 s; the recording runs from 0 s to 0.64 s",
        ),
        ("50", "0.55 s (sample 50): a window across a gap in time is MISSING"),
    ],
)
def test_what_names_no_window_is_refused_in_a_sentence(place, at, sentence, capsys):
    code, out, err = explain(place, at, capsys=capsys)
    assert (code, out) == (2, "") and err == f"jaxbound: {sentence}\n"


class TestWhatIsGone:
    def test_no_report(self, tmp_path, capsys):
        code, _, err = explain(tmp_path, "1", capsys=capsys)
        assert code == 2 and "holds no report of jaxbound detect: there is no run.json in it" in err

    def test_a_recording_that_moved(self, place, reported, tmp_path, capsys):
        self._edit(place, data=str(tmp_path / "elsewhere.csv"))
        code, _, err = explain(place, "1", capsys=capsys)
        assert (
            code == 2
            and f"the recording of this report, {tmp_path / 'elsewhere.csv'}, is no longer there: put it "
            f"back, or run"
            in err
        )

    def test_a_recording_that_changed(self, place, tmp_path, capsys):
        csv(tmp_path / "other.csv", stamps=str)
        self._edit(place, data=str(tmp_path / "other.csv"))
        code, _, err = explain(place, "1", capsys=capsys)
        assert code == 2 and "has changed since: run jaxbound detect again" in err

    def test_a_recording_that_was_edited_at_the_same_size(self, reported, tmp_path, capsys):
        shutil.copytree(reported / "out", tmp_path / "out")
        shutil.copy2(reported / "run.csv", tmp_path / "out")
        self._edit(tmp_path, data="run.csv")
        assert explain(tmp_path, "31", capsys=capsys)[0] == 0
        recording = tmp_path / "out/run.csv"
        state, text = recording.stat(), recording.read_text()
        recording.write_text(text.replace("0.58,", "0.59,", 1))
        os.utime(recording, ns=(state.st_atime_ns, state.st_mtime_ns))
        assert recording.stat().st_size == state.st_size and recording.read_text() != text
        code, out, err = explain(tmp_path, "31", capsys=capsys)
        assert code == 2 and out == "" and f"{recording}, has changed since: run jaxbound detect again" in err

    def test_a_model_that_was_edited(self, place, capsys):
        model = place / "out/tested_model.toml"
        model.write_text(model.read_text().replace("noise = 0.1\n", "noise = 0.2\n"))
        code, _, err = explain(place, "31", capsys=capsys)
        assert code == 2 and "tested_model.toml, has changed since: run jaxbound detect again" in err

    def test_a_recording_that_is_written_while_it_is_tested(self, reported, tmp_path, monkeypatch, capsys):
        shutil.copy(reported / "run.csv", tmp_path)
        read, path = CsvFile.whole, tmp_path / "run.csv"

        def late(source, progress):
            path.write_text(path.read_text().replace("0.58,", "0.59,", 1))
            return read(source, progress)

        monkeypatch.setattr(CsvFile, "whole", late)
        assert (
            main.main(
                [
                    "detect",
                    str(reported / "model.toml"),
                    str(tmp_path / "run.csv"),
                    "--out",
                    str(tmp_path / "out"),
                ]
            )
            == 1
        )
        capsys.readouterr()
        code, _, err = explain(tmp_path, "31", capsys=capsys)
        assert code == 2 and "has changed since" in err

    def test_a_report_of_before_the_digest(self, place, capsys):
        note = place / "out/run.json"
        found = json.loads(note.read_text())
        note.write_text(json.dumps({name: found[name] for name in ("data", "bytes", "method", "horizon")}))
        code, _, err = explain(place, "31", capsys=capsys)
        assert (
            code == 2
            and "keeps no digest of the recording" in err
            and "run jaxbound detect again on a file" in err
        )

    def test_a_damaged_note(self, place, capsys):
        for text in ("{", "[]", '{"data": "x"}'):
            (place / "out/run.json").write_text(text)
            code, _, err = explain(place, "1", capsys=capsys)
            assert code == 2 and "run.json is damaged" in err and "run jaxbound detect again" in err

    def test_a_report_that_holds_its_recording_may_move(self, reported, tmp_path, capsys):
        out = tmp_path / "first"
        out.mkdir()
        shutil.copy(reported / "run.csv", out)
        shutil.copy(reported / "model.toml", out)
        assert main.main(["detect", str(out / "model.toml"), str(out / "run.csv"), "--out", str(out)]) == 1
        out.rename(tmp_path / "out")
        assert explain(tmp_path, "31", capsys=capsys)[0] == 0

    @staticmethod
    def _edit(place, **changes):
        note = place / "out/run.json"
        note.write_text(json.dumps(json.loads(note.read_text()) | changes))


@pytest.mark.parametrize(
    "stamps, at",
    [
        (lambda k: f"2017-09-12 08:{k // 60:02d}:{k % 60:02d}", "2017-09-12 08:00:31"),
        (lambda k: f"2017-09-12T08:{k // 60:02d}:{k % 60:02d}", "2017-09-12T08:00:31"),
        (lambda k: f"12.09.2017 08:{k // 60:02d}:{k % 60:02d}", "12.09.2017 08:00:31"),
        (lambda k: f"{1505203200 + k}", "2017-09-12 08:00:31"),
    ],
)
def test_time_stamps_are_understood_as_they_are_written(stamps, at, tmp_path, capsys):
    save_model(paper(dt=1), tmp_path / "model.toml")
    csv(tmp_path / "run.csv", stamps)
    assert (
        main.main(
            [
                "detect",
                str(tmp_path / "model.toml"),
                str(tmp_path / "run.csv"),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 1
    )
    capsys.readouterr()
    code, out, err = explain(tmp_path, at, "--json", capsys=capsys)
    assert code == 0 and json.loads(out)["names"]["sample"] == 31, err


@pytest.mark.parametrize("dated", [False, True])
def test_parquet_is_read_where_it_is_needed(dated, tmp_path, capsys):
    import pandas as pd

    header, rows = table()
    frame = pd.DataFrame([[float(row[0]), *row[1:]] for row in rows], columns=header)
    if dated:
        frame["time"] = pd.Timestamp("2017-09-12 08:00") + pd.to_timedelta(frame["time"].round(9), unit="s")
    (tmp_path / "parts").mkdir()
    for i in range(2):
        frame[30 * i : 30 * i + 30].to_parquet(tmp_path / f"parts/part-{i}.parquet")
    save_model(paper(), tmp_path / "model.toml")
    assert (
        main.main(
            ["detect", str(tmp_path / "model.toml"), str(tmp_path / "parts"), "--out", str(tmp_path / "out")]
        )
        == 1
    )
    capsys.readouterr()
    for at in ("30", "2017-09-12 08:00:00.300" if dated else "0.3 s"):  # the window lies across two files
        code, out, err = explain(tmp_path, at, "--json", capsys=capsys)
        document = json.loads(out)
        assert (
            code == 0 and document["names"]["sample"] == 30 and document["certificate"] == Status.FAULT.name
        ), err
        check_certificate.confirm(document)
    code, _, err = explain(tmp_path, "50", capsys=capsys)
    assert code == 2 and "a window across a gap in time is MISSING" in err
    edited, state = tmp_path / "parts/part-0.parquet", (tmp_path / "parts/part-0.parquet").stat()
    at = pq.read_metadata(edited).row_group(0).column(2).data_page_offset + 40
    data = bytearray(edited.read_bytes())
    data[at] ^= 1
    edited.write_bytes(data)
    os.utime(edited, ns=(state.st_atime_ns, state.st_mtime_ns))
    code, out, err = explain(tmp_path, "30", capsys=capsys)
    assert (code, out) == (2, "") and "has changed since: run jaxbound detect again" in err


def test_a_number_that_could_be_a_time_says_so(tmp_path, capsys):
    model = jb.LinearSystem(
        [[0.5]], [[0.5]], [[1]], noise=0.1, dt=3, name="slow", inputs=["Q"], outputs=["T"]
    )
    save_model(model, tmp_path / "model.toml")
    rows = [f"{3 * k},0,{1.0 * (k == 20)}" for k in range(40)]
    (tmp_path / "run.csv").write_text("\n".join(["time,Q,T", *rows]) + "\n")
    assert (
        main.main(
            [
                "detect",
                str(tmp_path / "model.toml"),
                str(tmp_path / "run.csv"),
                "--out",
                str(tmp_path / "out"),
            ]
        )
        == 1
    )
    command = f"the first at 60 s: jaxbound explain {tmp_path / 'out'} --at 60s\n"
    assert command in capsys.readouterr().out
    assert (
        "asked for" in (said := explain(tmp_path, "20", capsys=capsys)[1])
        and "sample 20; for the time write --at 20s\n" in said
    )
    timed = explain(tmp_path, "60s", capsys=capsys)[1]
    assert (
        "sample 20\n" in timed
        and "asked for" not in timed
        and said.split("violated")[1] == timed.split("violated")[1]
    )
    assert "another at each sample, would explain the window, no smaller ones" in said and "Q wrong?" in said
    assert explain(tmp_path, "60", capsys=capsys)[2].endswith(
        "numbered from 0; for the time write --at 60s\n"
    )


@pytest.mark.parametrize(
    "options",
    [
        ("--test", "horizon=6"),
        ("--test", "lags=0,3,6"),
        pytest.param(("--method", "observer"), marks=pytest.mark.long),
    ],
)
def test_a_fault_beyond_the_bounds_as_fitted_is_no_proof_of_a_fault(tmp_path, options, capsys):
    still = ([[1, 0], [0, 1]], 0)  # nothing is disturbed, but an observer is of the sizes of other tests
    fitted = {"noise": "fitted to healthy data"}
    model = paper(name="paper", horizon=3, provenance=fitted, disturbance=still)
    save_model(model, tmp_path / "model.toml")
    csv(tmp_path / "run.csv")
    files = [str(tmp_path / name) for name in ("model.toml", "run.csv")]
    assert main.main(["detect", *files, "--out", str(tmp_path / "out"), *options]) == 3
    assert capsys.readouterr().out.startswith("Outside the bounds as fitted: ")
    faults = [
        k
        for k, line in enumerate((tmp_path / "out/verdicts.csv").read_text().splitlines()[1:])
        if ",FAULT," in line
    ]
    code, out, _ = explain(tmp_path, str(faults[0]), capsys=capsys)
    assert code == 0 and out.startswith("FAULT outside the bounds as fitted: the window from ")
    assert "an error that lasts longer" in " ".join(out.split())
    assert main.main(["detect", *files, "--out", str(tmp_path / "out"), "--test", "horizon=3"]) == 1
    capsys.readouterr()
    assert explain(tmp_path, str(faults[0]), capsys=capsys)[1].startswith("FAULT proved: ")


def test_what_takes_long_shows_how_far_it_is(place, capsys, monkeypatch):
    """The relations of a long window, and an exact program for each signal."""
    from contextlib import contextmanager

    from jaxbound.cli import explain as command

    steps = []

    @contextmanager
    def bars(stages):
        yield lambda stage, share: steps.append((stages.index(stage), share))

    monkeypatch.setattr(command, "progress_bars", bars)
    assert explain(place, "30", capsys=capsys)[0] == 0
    assert steps == sorted(steps) and {(0, 1.0), (1, 1.0)} <= set(steps)
    assert len([share for stage, share in steps if stage == 1]) > 2
    steps.clear()
    assert explain(place, "30", "--json", capsys=capsys)[0] == 0
    assert steps[-1] == (1, 0.0), "no candidates for whoever wants JSON"


def test_causes_come_by_plausibility_and_those_beyond_their_range_are_counted(tmp_path):
    """The readings say what a bias of .5 says, and an input that is off by five times its range."""
    model = jb.LinearSystem(
        [["0.5"]],
        [["0.1"]],
        [[1], [2]],
        noise=["0.01", "1.2"],
        horizon=1,
        inputs=["valve"],
        outputs=["T", "wide"],
        ranges={"valve": (0, 1)},
        units={"T": "K"},
    )
    u, y = np.zeros((2, 1)), np.array([[1.0, 2.0], [1.0, 1.0]])
    certificate = jb.detect(jb.parity_relations(model), u, y).explain(1)
    found = certificate.diagnose()
    assert found.explains[-1].fault.name == "offset of valve" and found.shares["offset of valve"] > 1
    said = str(found)
    assert said.endswith("; 1 more by sizes beyond the range in training: offset of valve")
    assert "so would" not in said and " K of T explains it" in said
    assert found.to_dict()["beyond_range"] == ["offset of valve"]
    wrong = [row for row in certificate_text(certificate, 1, ["0 s", "1 s"])[1] if "wrong?" in row[0]]
    assert [name for name, _ in wrong] == ["T wrong?", "valve wrong?", "wide wrong?"], "the likeliest first"
    assert " K of this sensor alone" in wrong[0][1]
