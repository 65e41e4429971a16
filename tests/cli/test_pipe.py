"""Verdicts on lines as they come: the same as of the file, whatever the pieces they come in, and however the
process ends.
"""

import contextlib
import errno
import io
import json
import re
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import evaluation, main
from jaxbound.cli import pipe as piped
from jaxbound.recordings.csvtext import sniff
from jaxbound.recordings.linetext import FEW, LineReader
from jaxbound.runs import journal, rows
from jaxbound.runs.ask import Ask
from jaxbound.runs.refusals import Refused

N = 300


@pytest.fixture(scope="module")
def samples():
    """Return (t, u, y): the paper's plant with a fault and missing samples, a gap, a repeated stamp and a
    clock that goes back.
    """
    rng, x, y = np.random.default_rng(0), np.zeros(2), np.empty((N, 2))
    u = np.repeat(rng.uniform(-1, 1, (N // 20, 1)).round(3), 20, 0)
    for k in range(N):
        y[k], x = (x[0], x[0] + x[1]), np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u[k, 0]])
    y = (y + rng.uniform(-0.9, 0.9, y.shape) * (abs(y) * [0.018, 0.09] + [0.1, 0.01])).round(5)
    y[150:200, 0] += 0.5
    y[[30, 31, 77], [0, 1, 1]] = np.nan
    t = 0.01 * np.arange(N)
    t[100:] += 0.5
    t[120:] -= 0.01
    t[220:] -= 1.0
    return t.round(2), u, y


def lines(samples, line="{:.2f},{},{},{}\n", head="t,u1,y1,y2\n"):
    """Return the text of a recording, a list of lines, the header first."""
    cell = lambda x: "" if np.isnan(x) else repr(float(x))
    return [head, *(line.format(t, *map(cell, (*u, *y))) for t, u, y in zip(*samples, strict=True))]


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(evaluation, "write_report", lambda *args, **options: None)
    monkeypatch.setattr(journal, "SYNCHRONOUS", "OFF")  # nobody cuts the power of a test
    jb.save_model(paper(), "model.toml")
    return tmp_path


@pytest.fixture
def pipe(capsysbinary, place):
    """Return a function that sends text, cut into pieces, and returns (exit code, stdout without its header,
    stderr).
    """

    def send(text, cuts=(), chunks=None, **changes):
        data = ("".join(text) if not isinstance(text, bytes) else text) if text is not None else b""
        data = data if isinstance(data, bytes) else data.encode()
        cuts = [0, *sorted(cuts), len(data)]
        capsysbinary.readouterr()
        pieces = chunks or [data[a:b] for a, b in zip(cuts, cuts[1:], strict=False)]
        model = changes.pop("model", "model.toml")
        test = {name: changes.pop(name) for name in ("method", "horizon", "lags") if name in changes}
        code = piped.judge_stream(piped.LiveRun(model, Ask(**test), **changes), pieces)
        out, err = (x.decode() for x in capsysbinary.readouterr())
        return code, out.removeprefix("time,status,margin\n"), err.replace("jaxbound: ", "")

    return send


def saved(path):
    """Return the memory in a checkpoint."""
    with contextlib.closing(sqlite3.connect(path)) as database:
        return json.loads(database.execute("SELECT memory FROM checkpoint").fetchone()[0])


def batch(place, text, name="batch", code=(0, 1)):
    """Return verdicts.csv of `jaxbound detect` on the same text as a file."""
    (place / "run.csv").write_text("".join(text))
    assert main.main(["detect", "model.toml", "run.csv", "--out", name]) in code
    return (place / name / "verdicts.csv").read_bytes()


class TestVerdicts:
    def test_they_are_those_of_the_file_whatever_the_pieces(self, samples, place, pipe, rng, capsysbinary):
        text = lines(samples)
        expected = batch(place, text)
        capsysbinary.readouterr()
        size = len("".join(text))
        for i, cuts in enumerate(([], range(0, size, 7), sorted(rng.integers(0, size, 40).tolist()))):
            code, out, err = pipe(text, cuts, out=place / f"pipe{i}")
            assert code == 1 and (place / f"pipe{i}/verdicts.csv").read_bytes() == expected
            assert out.splitlines() == [row.rpartition(",")[0] for row in expected.decode().splitlines()[1:]]
        assert (
            "line 102 comes 0.51 s after the sample before it" in err
            and "clock goes back by 0.99 s before sample 220" in err
        )
        assert (
            "Fault proved: " in err and "cannot be explained by any behaviour inside the bounds, in " in err
        )

    @pytest.mark.parametrize(
        "line, head",
        [
            ("{:.2f};{};{};{}\n", "t;u1;y1;y2\n"),
            ("{:.2f}\t{}\t{}\t{}\r\n", "t\tu1\ty1\ty2\r\n"),
        ],
    )
    def test_delimiters_and_decimal_commas(self, samples, place, pipe, line, head, capsysbinary):
        expected = batch(place, lines(samples))
        text = [x.replace(".", ",") for x in lines(samples, line, head)]
        pipe(["\ufeff", *text], range(0, 900, 11), out=place / "pipe")
        assert (place / "pipe/verdicts.csv").read_bytes() == expected

    @pytest.mark.parametrize(
        "form", ["%Y-%m-%d %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f", "%H:%M:%S.%f", "%d.%m.%Y,%H:%M:%S.%f"]
    )
    def test_time_stamps(self, samples, place, pipe, form, capsysbinary):
        t, u, y = samples
        stamps = (
            np.datetime64("2024-05-01T23:59:59", "ms") + (1000 * t).round().astype("timedelta64[ms]")
        ).astype(object)
        text = [
            f"{'day,' * form.count(',')}time,u1,y1,y2\n",
            *(
                f"{s.strftime(form)[:-4]},{line.partition(',')[2]}"
                for s, line in zip(stamps[:100], lines(samples)[1:], strict=False)
            ),
        ]
        expected = batch(place, text)
        pipe(text, range(0, len("".join(text)), 333), out=place / "pipe")
        assert (place / "pipe/verdicts.csv").read_bytes() == expected

    @pytest.mark.parametrize("scale", [1, 1000, 10**9])
    def test_an_epoch_and_no_time_at_all(self, samples, place, pipe, scale, capsysbinary):
        t, u, y = samples
        for i, first in enumerate(
            (lambda t: f"{round((1.7e9 + t) * 1000) * scale / 1000:.6f}", lambda t: "0")
        ):
            name = ("time", "ignored")[i]
            text = [
                f"{name},u1,y1,y2\n",
                *(f"{first(k / 100)},{x.partition(',')[2]}" for k, x in enumerate(lines(samples)[1:])),
            ]
            expected = batch(place, text, f"batch{i}")
            pipe(text, range(40, 5000, 400), out=place / f"pipe{i}")
            assert (place / f"pipe{i}/verdicts.csv").read_bytes() == expected

    def test_expressions_and_conditions(self, samples, place, pipe, capsysbinary):
        jb.save_model(paper(columns={"y1": "= half * 2", "where": "on == 1 and not y2 > 1000"}), "model.toml")
        t, u, y = samples
        on = (np.arange(N) // 37) % 3 > 0
        text = [
            "t,u1,half,y2,on\n",
            *(f"{t[k]:.2f},{u[k, 0]},{y[k, 0] / 2},{y[k, 1]},{int(on[k])}\n" for k in range(N)),
        ]
        expected = batch(place, text)
        first = capsysbinary.readouterr().out.decode()
        code, out, err = pipe(text, range(0, 9000, 501), out=place / "pipe")
        assert (place / "pipe/verdicts.csv").read_bytes() == expected and b"CONSISTENT" in expected
        aside = int(re.search(r"decided +\S+ % of (\d+) windows", first)[1])
        counts = saved(place / "pipe/monitor.sqlite")["sinks"]["counts"]
        assert N - 1 - counts["aside"] == aside

    def test_json_lines(self, samples, place, pipe):
        code, out, _ = pipe(lines(samples)[:12], json=True)
        rows = [json.loads(row) for row in out.splitlines()]
        assert (
            code == 0
            and len(rows) == 11
            and rows[0] == {"time": 0.0, "status": "MISSING", "margin": None, "ended": None}
        )
        res = jb.detect(jb.parity_relations(paper()), samples[1][:11], samples[2][:11])
        assert [r["margin"] for r in rows[1:]] == res.margin[1:].tolist()

    def test_json_lines_and_the_end_say_why_an_alarm_is_over(self, samples, place, pipe, rng):
        text = lines(samples)
        res = jb.detect(jb.parity_relations(paper()), samples[1][:220], samples[2][:220], starts=[100, 120])
        alarms = res.alarms()
        text = [text[0], *text[1:221]]
        for cuts in ((), sorted(rng.integers(0, len("".join(text)), 9).tolist())):
            _, out, err = pipe(text, cuts=cuts, json=True)
            said = {
                k: row["ended"] for k, row in enumerate(map(json.loads, out.splitlines())) if row["ended"]
            }
            assert said == {a.end + 1: a.ended for a in alarms if a.end < 219} and len(set(said.values())) > 1
            assert "ended because the onset left the window: repaired or lasting" in " ".join(err.split())

    def test_exit_codes(self, samples, place, pipe):
        text = lines(samples)
        assert pipe(text[:60])[0] == 0 and pipe(text)[0] == 1
        code, _, err = pipe([text[0], *(f"{k / 100:.2f},,,\n" for k in range(20))])
        assert (
            code == 3
            and "Too little evidence: only 0 of 19 windows (0 %) could be decided" in err
            and "20 samples: 20 MISSING" in err
        )

    def test_numbers_are_written_as_pyarrow_writes_them(self, rng):
        import pyarrow as pa

        x = np.concatenate(
            [
                rng.normal(size=300) * 10.0 ** rng.integers(-9, 15, 300),
                np.arange(-30, 30) / 100,
                [0.0, -0.0, 1e9, 1e-4, 1e300],
            ]
        )
        assert [rows.number_text(v) for v in x.tolist()] == pa.array(x).cast(pa.string()).to_pylist()

    def test_a_few_lines_are_read_as_many_are(self):
        layout = sniff("", b"t;u1;y1;y2\n0;1;2;3\n")
        reader = LineReader(replace(layout, skip=0), paper())
        for line in (b"0,1;2,5;1e3;-5", b"1;2;3.;4 ", b"1;;NaN; null", b"1;2;3;-1e-300", b'1;"2";3;4'):
            few, many = reader.read_few([line]), reader.read_few([line] * (FEW + 1))
            assert many.rows == FEW + 1 and not few.odd and not many.odd
            for name, x in few.columns.items():
                np.testing.assert_array_equal(np.repeat(x, FEW + 1), many.columns[name])
        for line in (b"1;2;3;1_0", b"1;2;3;0x1"):  # many are read a few at a time then
            assert [*reader.read_few([line]).odd] == ["y2"]
            with pytest.raises(ValueError):
                reader.read_few([line] * (FEW + 1))


class TestTroubles:
    def test_lines_that_cannot_be_read_are_left_out_with_a_sentence(self, samples, place, pipe):
        text = lines(samples)[:101]
        bad = {
            10: "0.1,1\n",
            20: "0.2,1,2,3,4\n",
            30: "0.29,1,ERR,2\n",
            40: "0.39,1,inf,2\n",
            50: ",1,2,3\n",
            60: "now,1,2,3\n",
            70: 'x"y,"1,2,3\n',
            80: text[0],
            90: "0.89,1_000,2,3\n",
        }
        spoilt = [bad.get(k, x) for k, x in enumerate(text)]
        spoilt.insert(95, "\n")
        code, out, err = pipe(spoilt, range(0, 4000, 700))
        said = [x for x in err.splitlines() if x.startswith("line") and "comes" not in x]
        assert [int(re.match(r"line (\d+)", x)[1]) for x in said] == [k + 1 for k in bad]
        for x, expected in zip(
            said,
            (
                "has 2 cells, the header has 4 columns",
                "has 5 cells",
                "of column 'y1' holds 'ERR', which is not a number",
                "of column 'y1' is infinite",
                "holds no time: left out",
                "of column 't' holds 'now'",
                "",
                "repeats what stands above the samples",
                "holds '1_000'",
            ),
            strict=True,
        ):
            assert expected in x
        assert "7 lines could not be read: left out, and no window spans them" in err
        status = {row.split(",")[0]: row.split(",")[1] for row in out.splitlines()}
        assert len(status) == 100 - len(bad)
        t, u, y = samples
        keep = np.setdiff1d(np.arange(100), [k - 1 for k in bad])
        res = jb.detect(
            jb.parity_relations(paper()), u[keep], y[keep], starts=np.flatnonzero(np.diff(keep) > 1) + 1
        )
        assert [jb.Status[s] for s in status.values()] == res.status.tolist()

    def test_many_sentences_of_a_kind_are_counted_not_said(self, place, pipe, samples):
        code, _, err = pipe([*lines(samples)[:30], *["x\n"] * 500])
        assert err.count("has 1 cells") == 20 and "500 lines could not be read" in err and code == 0

    def test_a_stream_without_one_line_that_can_be_read_has_a_table_without_rows(self, place, pipe):
        code, out, _ = pipe(["t,u1,y1,y2\n", *["x,y,z,w\n"] * 30], out=place / "out")
        assert (code, out) == (3, "") and (place / "out" / "run.json").exists()
        assert (place / "out" / "verdicts.csv").read_text() == "time,status,margin,suspect\n"

    @pytest.mark.parametrize(
        "text, message",
        [
            (b"", "standard input is empty"),
            (b"t,u1,y1,y2\n", "standard input ended before the first row of data"),
            (b"t,u1,y1\n0,0,0\n", "standard input: the recording has no column 'y2'"),
            (b"0,1,2,3\n0,0,0,0\n", "standard input: the first row must hold the names of the columns"),
            (b"PAR1\n\0\0\n", "standard input: this is a Parquet file"),
            (b"x" * 3_000_000, "a megabyte without a line end"),
            (
                b"t,u1,y1,y2\n" + b"".join(b"%d,0,0,0\n" % k for k in range(300)),
                "dt = 0.01 s, but the rows of the recording are 1 s apart",
            ),
        ],
    )
    def test_a_stream_that_is_none_is_refused(self, place, pipe, text, message):
        with pytest.raises(Refused, match=re.escape(message)):
            pipe(text, out=place / "out")

    @pytest.mark.parametrize(
        "options, message",
        [
            (["--method", "validation"], "validation reads a recording as a whole"),
            (["--chunk", "9"], "--chunk is for recordings"),
            (["--method", "exact"], "method must be one of"),
        ],
    )
    def test_options_for_recordings_are_refused(self, place, capsys, options, message):
        assert main.main(["detect", "model.toml", "-", *options]) == 2
        assert message in capsys.readouterr().err

    def test_files_still_need_a_folder_and_have_no_state(self, place, capsys):
        assert main.main(["detect", "model.toml", "run.csv"]) == 2
        assert "the following arguments are required: --out" in capsys.readouterr().err
        assert main.main(["detect", "model.toml", "run.csv", "--out", "x", "--state", "y"]) == 2
        assert "--state is for samples that come through a pipe" in capsys.readouterr().err

    def test_half_a_line_at_the_end_of_a_pipe_is_not_judged(self, samples, place, pipe):
        code, out, err = pipe("".join(lines(samples)[:20])[:-4])
        assert len(out.splitlines()) == 18 and "the last line has no line end" in err


def test_what_is_missing_is_counted_as_in_a_file(samples, place, pipe):
    """A window that lacks an input has a margin, UNDECIDED: what that claims was said of files alone."""
    t, u, y = (x[:60].copy() for x in samples)
    u[[10, 40]] = np.nan
    text = lines((t, u, y))
    batch(place, text)
    expected = [hint for hint in jb.read("run.csv", paper()).hints if "are missing" in hint]
    assert "2 of 60 samples of u1 are missing: windows that need one are judged as if" in expected[0]
    pipe(text[:30], state=place / "state")
    _, _, err = pipe(text[30:], state=place / "state")
    assert [line for line in err.splitlines() if "are missing" in line] == expected


class Killed(BaseException):
    """Raised where a process may be killed."""


AGAIN = ("from the beginning", "where it stopped", "where it stopped, no header", "somewhere before")
WITHIN = {"between lines": 1, "in the time": 4, "in a number": 9}


def restarts():
    """Yield (how lines go on, whether they have a time, bytes of the last line that were read), where
    something tells at which sample they go on.
    """
    for again in AGAIN:
        for timed in (True, False):
            for name, within in WITHIN.items():
                lost = again == "somewhere before" or again == "where it stopped, no header" and within == 4
                if timed or not lost:
                    label = f"{name}-{'time' if timed else 'no time'}-{again}"
                    yield pytest.param(again, timed, within, id=label)


class TestRestart:
    """A process that ends, is stopped or is killed at any point, and another one that goes on."""

    def test_a_signal_before_the_first_sample_is_an_end_as_any(self, place, pipe):
        code, out, err = pipe(None, chunks=[None], out=place / "out")
        assert (
            (code, out) == (3, "")
            and "Too little evidence: only 0 of " in err
            and "asked for. 0 samples" in err
        )

    @pytest.mark.parametrize(("again", "timed", "within"), list(restarts()))
    def test_after_a_signal_each_verdict_is_printed_once(self, samples, place, pipe, again, timed, within):
        text = [x if timed else x.partition(",")[2] for x in lines(samples)][:100]
        whole = pipe(text)[1]
        data = "".join(text).encode()
        cut = data.index(b"\n", 2000) + within
        _, first, _ = pipe(None, chunks=[data[:700], data[700:cut], None], state=place / "state")
        begun = data[:cut].rfind(b"\n") + 1
        rest = {
            "from the beginning": data,
            "where it stopped": text[0].encode() + data[begun:],
            "where it stopped, no header": data[cut:],
            "somewhere before": text[0].encode() + data[data.index(b"\n", 900) + 1 :],
        }[again]
        code, second, err = pipe(rest, range(5, len(rest), 97), state=place / "state")
        if not timed and again != "from the beginning":  # who knows what was lost between?
            row = whole.splitlines()[data[:cut].count(b"\n") - 1]
            whole = whole.replace(row, row.split(",")[0] + ",MISSING,")
        assert first + second == whole and "going on after" in err
        assert pipe(data, state=place / "state")[1] == ""  # everything was judged

    @pytest.mark.parametrize("again", ["from the beginning", "where it stopped"])
    def test_killed_at_any_point_the_file_is_as_if_nothing_had_been(
        self, samples, place, pipe, again, monkeypatch, rng
    ):
        """Every write and every replacement of a file is a point to be killed at, before it and, for writes,
        half-way.
        """
        text = lines(samples)[:120]
        data, read = "".join(text).encode(), 0
        pipe(text, out=place / "whole")
        expected = (place / "whole/verdicts.csv").read_bytes()
        points, save, write = [0], journal.Journal.save, rows._write_all

        def point():
            points[0] -= 1
            if points[0] == 0:
                raise Killed

        def saving(self, memory):
            point()
            save(self, memory)
            remembered[0] = read
            point()

        def writing(file, data):
            if points[0] == 2:
                file.write(data[: len(data) // 2])
            point(), point()
            write(file, data)
            point()

        monkeypatch.setattr(journal.Journal, "save", saving)
        monkeypatch.setattr(rows, "_write_all", writing)
        kills, remembered = 0, [0]

        def chunks(start):
            nonlocal read
            read = start
            while read < len(data):
                step = int(rng.integers(1, 400))
                piece, read = data[read : read + step], min(read + step, len(data))
                yield piece

        while True:
            points[0] = int(rng.integers(2, 15))
            try:
                pipe(
                    None,
                    chunks=chunks(0 if again == "from the beginning" else remembered[0]),
                    out=place / "out",
                )
                break
            except Killed:
                kills += 1
            assert kills < 1000
        assert kills > 3 and (place / "out/verdicts.csv").read_bytes() == expected

    def test_a_state_of_another_model_or_other_verdicts_is_refused(self, samples, place, pipe):
        text = lines(samples)[:50]
        pipe(text, out=place / "out")
        with pytest.raises(Refused, match="is of another method"):
            pipe(text, out=place / "out", method="box")
        (place / "out/verdicts.csv").write_text("time,status,margin,suspect\n" + "x" * 9000)
        with pytest.raises(Refused, match="does not hold the verdicts that"):
            pipe(text, out=place / "out")
        (place / "out/monitor.sqlite").write_text("{}")
        with pytest.raises(Refused, match="is no state of jaxbound detect"):
            pipe(text, out=place / "out")
        jb.save_model(paper(noise=[0.2, 0.2]), "model.toml")
        (place / "out/monitor.sqlite").unlink()
        with pytest.raises(
            Refused, match="verdicts.csv is in the way: it was not written by jaxbound, or was changed since"
        ):
            pipe(text, out=place / "out")
        (place / "out/verdicts.csv").unlink()
        assert pipe(text, out=place / "out")[0] == 0

    @pytest.mark.parametrize(
        "change, what",
        [
            ("noise", "model"),
            ("horizon", "horizon"),
            ("version", "version of jaxbound"),
            ("precision", "precision"),
        ],
    )
    def test_a_state_of_anything_else_is_refused(self, samples, place, pipe, monkeypatch, change, what):
        text = lines(samples)[:5]
        pipe(text, out=place / "out")
        kept, horizon = saved(place / "out/monitor.sqlite"), None
        if change == "noise":
            jb.save_model(paper(noise=["0.1", "0.0100001"]), "model.toml")
        elif change == "horizon":
            horizon = 2
        elif change == "version":
            monkeypatch.setattr(jb, "__version__", "0.0.1")
        else:
            monkeypatch.setattr("jax.dtypes.canonicalize_dtype", lambda kind: np.dtype(np.float32))
        with pytest.raises(
            Refused,
            match=f"monitor.sqlite is of another {what}: choose another place, or delete it to begin anew",
        ):
            pipe(text, out=place / "out", horizon=horizon)
        assert saved(place / "out/monitor.sqlite") == kept

    @pytest.mark.posix("locks of files")
    def test_a_file_system_without_locks_keeps_nobody_away(self, samples, place, pipe, monkeypatch):
        def none(file, operation):
            raise OSError(errno.ENOLCK, "No locks available")

        monkeypatch.setattr("fcntl.flock", none)
        text = lines(samples)[:5]
        code, out, _ = pipe(text, out=place / "out")
        assert code in (0, 1, 3) and (place / "out/verdicts.csv").read_text().count("\n") == len(text)

    @pytest.mark.posix("locks of files")
    def test_two_processes_do_not_write_one_file(self, place):
        with journal.Journal(place / "a", {}) as one, journal.Journal(place / "a", {}) as other:
            one.save({})
            with pytest.raises(Refused, match="another process is writing"):
                other.save({})
        text = rows.RowText()
        one, other = (rows.RowFile(place / "verdicts.csv", text, place / "a") for _ in range(2))
        for file in (one, other):
            file.fresh = b"x"
        one.flush()
        with pytest.raises(Refused, match="another process is writing"):
            other.flush()
        one.close()

    def test_a_state_of_an_earlier_jaxbound_is_refused(self, samples, place, pipe):
        text = lines(samples)[:5]
        (place / "old").write_text('{"identity": {}, "length": 0}')
        with pytest.raises(Refused, match="old is the state of an earlier jaxbound, from which this one"):
            pipe(text, state=place / "old")
        (place / "out").mkdir()
        (place / "out/monitor.jsonl").write_text('{"identity": {}, "length": 0}')
        with pytest.raises(Refused, match="monitor.jsonl is the state of an earlier jaxbound"):
            pipe(text, out=place / "out")
        (place / "out/monitor.jsonl").unlink()
        assert pipe(text, out=place / "out")[0] == 0

    def test_a_state_that_lacks_what_this_version_keeps_is_refused(self, samples, place, pipe):
        text = lines(samples)[:50]
        pipe(text, state=place / "old", alarm={"latch": True})
        with contextlib.closing(sqlite3.connect(place / "old")) as database:
            (memory,) = database.execute("SELECT memory FROM checkpoint").fetchone()
            database.execute("UPDATE checkpoint SET memory = ?", (memory.replace('"latest"', '"repairs"'),))
            database.commit()
        with pytest.raises(Refused, match="old is the state of an earlier jaxbound, from which this one"):
            pipe(text, state=place / "old", alarm={"latch": True})

    def test_a_database_of_another_program_is_refused(self, samples, place, pipe):
        with contextlib.closing(sqlite3.connect(place / "theirs")) as database:
            database.execute("CREATE TABLE checkpoint (a)")
            database.commit()
        kept = (place / "theirs").read_bytes()
        with pytest.raises(Refused, match="theirs is no state of jaxbound detect"):
            pipe(lines(samples)[:5], state=place / "theirs")
        assert (place / "theirs").read_bytes() == kept

    def test_another_header_is_refused(self, samples, place, pipe):
        text = lines(samples)[:50]
        pipe(text, state=place / "state")
        with pytest.raises(Refused, match="begins with another header than before, t, y2, y1, u1"):
            pipe(["t,y2,y1,u1\n", *text[1:]], state=place / "state")


def untimed(text):
    """Return lines without their first cell."""
    return [line.partition(",")[2] for line in text]


def dated(text):
    """Return lines with a clock that passes midnight, and no date."""
    begin = np.datetime64("2026-01-01T23:59:59.50")
    stamps = [str(begin + np.timedelta64(10 * k, "ms"))[11:] for k in range(len(text) - 1)]
    rows = [f"{stamp},{line}" for stamp, line in zip(stamps, untimed(text[1:]), strict=True)]
    return [text[0], *rows]


class TestSecondRecording:
    """The same command with another recording: it was left out unread, with the verdict of the first."""

    @pytest.fixture
    def healthy(self, samples):
        return lines(tuple(x[:90] for x in samples))

    @pytest.mark.parametrize("form", [list, untimed, dated])
    def test_the_same_again_is_skipped_and_nothing_is_concluded(self, healthy, place, pipe, form):
        text = form(healthy)
        for pieces in (text[:60], text):
            assert pipe(pieces, out=place / "out")[0] == 0
        expected = (place / "out/verdicts.csv").read_bytes()
        for again in (text, [text[0], *text[40:]] if form is list else text, text[:30]):
            code, out, err = pipe(again, range(5, 600, 37), out=place / "out")
            sentence = f"nothing is concluded: {len(again) - 1} lines were judged before and are skipped"
            assert (code, out) == (3, "") and sentence in err and "No fault" not in err
        code, out, err = pipe("", out=place / "out")
        assert (code, out) == (3, "") and "nothing is concluded: nothing came" in err
        assert (place / "out/verdicts.csv").read_bytes() == expected

    @pytest.mark.parametrize("first, stop", [(1, 90), (2, 60), (70, 90), (89, 90)])
    @pytest.mark.parametrize("form", [list, untimed])
    def test_rows_at_judged_times_with_other_values_are_refused(
        self, healthy, place, pipe, form, first, stop
    ):
        """From line `first` on every value is another one; the recording before is longer or shorter."""
        text = form(healthy)
        if form is untimed and first == 1:
            first = 2  # else nothing tells that the sender began again: it is judged, behind a seam
        other = [*text[:first], *(line.replace("\n", "1\n") for line in text[first:])]
        pipe(text[:stop], out=place / "out")
        kept = saved(place / "out/monitor.sqlite"), (place / "out/verdicts.csv").read_bytes()
        for again in (other, other[: max(first + 1, 5)]):
            with pytest.raises(Refused) as refused:
                pipe(again, out=place / "out")
            assert str(refused.value).startswith(f"line {first + 1}") and "another --out" in str(
                refused.value
            )
            assert (saved(place / "out/monitor.sqlite"), (place / "out/verdicts.csv").read_bytes()) == kept
        assert pipe(other, out=place / "other")[0] in (0, 1)

    def test_a_clock_that_restarts_is_refused_and_a_later_one_judged(self, samples, place, pipe):
        t, u, y = (x[:90] for x in samples)
        pipe(lines((t + 50, u, y)), out=place / "out")
        with pytest.raises(
            Refused, match=r"line 2, at 0.00, is no sample that was judged, though all up to 50.89"
        ):
            pipe(lines((t, u, y)), out=place / "out")
        code, out, err = pipe(lines((t + 60, u, y + 5)), out=place / "out")
        assert code == 1 and out.count("FAULT") > 50

    def test_what_could_not_be_read_is_known_again_too(self, healthy, place, pipe):
        text = [*healthy[:20], "0.19,x,1,1\n", *healthy[21:40], "0.39,?,1,1\n"]
        code, _, err = pipe(text, state=place / "state")
        assert "2 lines could not be read" in err
        spoilt = [*text[:10], "0.09,!,1,1\n", *text[11:], *healthy[41:60]]
        code, out, err = pipe(spoilt, state=place / "state")
        assert [row.split(",")[1] for row in out.splitlines()[:2]] == ["MISSING", "CONSISTENT"]
        assert "3 lines could not be read" in err and "39 lines were judged before and are skipped" in err

    def test_the_clock_of_a_recording_may_go_back(self, samples, place, pipe):
        text = lines(samples)
        whole = pipe(text)[1]
        for stop in (230, 260, 301):
            _, out, _ = pipe(text[:stop], state=place / "state")
            whole = whole.removeprefix(out)
        assert whole == "" and pipe(text, state=place / "state")[0] == 3


@pytest.mark.compiled
@pytest.mark.posix("signals between processes")
def test_live_in_another_process_killed_and_stopped(samples, place, kernels):
    """Verdicts come while the pipe is open; kill -9 and SIGTERM leave a file that the next process
    completes.
    """
    text = lines(samples)
    expected = batch(place, text)
    command = [sys.executable, "-m", "jaxbound.cli", "detect", "model.toml", "-", "--out", "out"]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)

    def live(process, *lines):
        """Write lines one by one and read one after each."""
        out = []
        for line in lines:
            process.stdin.write(line.encode())
            process.stdin.flush()
            out.append(process.stdout.readline().decode())
        return out

    with subprocess.Popen(command, **pipes) as process:
        assert live(process, "".join(text[:2])) == ["time,status,margin\n"]
        first = live(process, "", *text[2:100])
        process.send_signal(signal.SIGKILL)
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout.readline() == b"time,status,margin\n"
        process.stdout.readline()  # that of the last line before: it may not have been printed
        second = live(process, *text[100:200])
        process.send_signal(signal.SIGTERM)
        assert process.wait() == 1 and b"Fault proved" in process.stderr.read()
    with subprocess.Popen(command, **pipes) as process:
        out, _ = process.communicate("".join(text).encode())  # from the beginning
        assert process.returncode == 1
    printed = first + second + io.StringIO(out.decode()).readlines()[1:]
    assert printed == [row.rpartition(",")[0] + "\n" for row in expected.decode().splitlines()[1:]]
    assert (place / "out/verdicts.csv").read_bytes() == expected


def test_a_column_of_time_stamps_is_the_time_whatever_it_is_called():
    model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
    head = b"remark;Messbeginn;u1;y1\nshift 2;05.03.2024 08:00:00;1,5;2\n"
    reader = LineReader(sniff("", head), model)
    assert reader.plan.time == "Messbeginn" and reader.is_text
