"""Time in files: gaps, repeated and backward stamps split a recording, with a sentence; the rest of the way
to a report follows.
"""

import csv
import datetime

import numpy as np
import pandas as pd
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.models.modelfile import save_model
from jaxbound.recordings.live import Readings
from jaxbound.recordings.pipetext import PipeText
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals
from jaxbound.recordings.tabletime import instants_of
from jaxbound.recordings.timestamps import instant_of, since_epoch

MODEL = jb.LinearSystem([[0.5]], None, [[1]], dt=60, noise=0.1, resolution=1)
SPLIT = ": the recording is split there, and windows across are MISSING"
START = datetime.datetime(2017, 9, 12, 23, 30)


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a recording of y1 with these stamps."""

    def reading(stamps, header="time"):
        path = tmp_path / "data.csv"
        path.write_text("\n".join([f"{header};y1", *(f"{s};{k % 7}" for k, s in enumerate(stamps))]) + "\n")
        return jb.read(path, MODEL)

    return reading


def minutes(form, *spans):
    """Return stamps of the minutes of each span (first, last)."""
    return [
        (START + datetime.timedelta(minutes=m)).strftime(form)
        for first, last in spans
        for m in range(first, last)
    ]


class TestSplit:
    def test_a_gap(self, read):
        r = read(minutes("%Y-%m-%d %H:%M:%S", (0, 50), (100, 130), (131, 150)))
        assert r.starts.tolist() == [50, 80] and len(r.y) == 99
        assert r.hints == (
            f"the recording has 2 gaps, the longest, 3060 s, before row 52 (2017-09-13 01:10:00){SPLIT}",
        )

    @pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%m/%d/%Y %H:%M"])
    def test_day_and_month_are_told_apart_in_spite_of_gaps(self, read, form):
        first = datetime.datetime(
            2017, 1, 2, 23, 0
        )  # 2 January or 1 February: one reading jumps by a month at midnight
        stamps = [
            (first + datetime.timedelta(minutes=m)).strftime(form) for m in [*range(30), *range(35, 200)]
        ]
        r = read(stamps)
        assert r.starts.tolist() == [30] and r.stamps[100] == np.datetime64("2017-01-03T00:45")

    def test_a_clock_without_date_over_midnight(self, read):
        r = read(minutes("%H:%M:%S", (0, 40), (50, 90)))
        assert r.starts.tolist() == [40] and r.time[-1] == 89 * 60

    def test_repeated_rows(self, read):
        r = read(minutes("%Y-%m-%d %H:%M", (0, 10), (9, 30)))
        assert r.starts.tolist() == [10]
        assert r.hints == (f"row 12 (2017-09-12 23:39) repeats the time of the row before it{SPLIT}",)

    def test_a_clock_that_is_set_back(self, read):
        r = read(minutes("%Y-%m-%d %H:%M", (0, 100), (40, 140)))
        assert r.starts.tolist() == [100] and r.label(100) == "2017-09-13 00:10"
        assert r.hints == (f"the clock goes back by 3540 s before row 102 (2017-09-13 00:10){SPLIT}",)

    @pytest.mark.parametrize("scale", [1, 1000])
    def test_numbers(self, read, scale):
        r = read([(1_505_174_400 + 60 * k) * scale for k in [*range(30), *range(90, 99)]], "timestamp")
        assert r.starts.tolist() == [30] and r.label(30) == "2017-09-12 01:30:00"

    def test_seconds_that_run_back_have_labels(self, read):
        r = read([60 * k for k in [*range(100, 130), *range(20)]], "t")
        assert r.starts.tolist() == [30] and r.label(29) == "7740 s"

    @pytest.mark.parametrize(
        "form", ["%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M:%SZ", "%d.%m.%Y %H:%M", "%Y%m%d %H%M%S"]
    )
    def test_years_that_cannot_be_told_are_refused_with_their_row(self, read, form):
        """NumPy and pyarrow take another year for them, and the time of day with it."""
        for far in (1677, 2262, 2500, 9999):
            stamps = minutes(form, (0, 20))
            stamps[7] = START.replace(year=far).strftime(form)
            with pytest.raises(ValueError, match=f"row 9 has the time {far}-.*: only the years 1678 to 2261"):
                read(stamps)

    def test_jitter_is_none(self, read, rng):
        r = read(60 * np.arange(200) + rng.uniform(-5, 5, 200), "t")
        assert len(r.starts) == 0 and r.hints == ()


def test_detect_says_missing_across_a_gap_and_hints_at_a_frozen_sensor(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(main, "_configure", lambda: None)
    rng, x, lines = np.random.default_rng(3), np.zeros(2), []
    for k in range(400):
        u = rng.uniform(-1, 1)
        y1, y2 = x[0] + rng.uniform(-0.09, 0.09), x.sum() + rng.uniform(-0.009, 0.009)
        lines.append((k, *map(float, (u, 0.25 if 300 <= k < 360 else y1, y2))))
        x = np.array([0.8 * x[0] + x[1], 0.2 * x[1] + u])
    lines = [line for line in lines if not 150 <= line[0] < 210]
    save_model(paper(dt=1), tmp_path / "m.toml")
    (tmp_path / "d.csv").write_text(
        "t,u1,y1,y2\n" + "".join(",".join(map(repr, line)) + "\n" for line in lines)
    )
    code = main.main(
        ["detect", str(tmp_path / "m.toml"), str(tmp_path / "d.csv"), "--out", str(tmp_path / "out")]
    )
    with open(tmp_path / "out" / "verdicts.csv", newline="") as f:
        status = [row["status"] for row in csv.DictReader(f)]
    assert [k for k, s in enumerate(status) if s == "MISSING"] == [0, 150]
    assert (
        code == 1 and "FAULT" not in status[:240]
    )  # healthy until the sensor freezes, on both sides of the hole
    printed, page = capsys.readouterr().out, (tmp_path / "out" / "report.html").read_text()
    for text in (
        "the recording has a gap of 61 s before row 152 (210 s)",
        "y1 stays at exactly 0.25 for 60 samples from 300 s to 359 s",
    ):
        assert text in page and text[:40] in " ".join(printed.split())


@pytest.mark.parametrize("form", ["%Y%m%d%H%M%S", "%Y%m%d%H%M"])
@pytest.mark.parametrize("door", ["csv", "parquet", "pipe", "table"])
def test_digits_of_time_stamps_are_no_seconds(tmp_path, door, form):
    """Across a full hour, with a gap: the steps of the numbers are 100, 4100 and 700, those of the time 60
    and 480 s.
    """
    stamps = pd.Timestamp("2024-01-01 08:57") + pd.to_timedelta([0, 1, 2, 3, 4, 12, 13, 14], "min")
    table = pd.DataFrame({"time": stamps.strftime(form).astype(np.int64), "level": np.arange(8.0)})
    model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, outputs=["level"], dt=60)
    if door == "pipe":
        said = []
        piece = PipeText(model, lambda kind, sentence: said.append(kind)).take(
            table.to_csv(index=False).encode()
        )
        assert (
            piece.starts.tolist() == [5]
            and piece.written.tolist() == table["time"].tolist()
            and said == ["seam"]
        )
        return
    path = tmp_path / f"run.{door}"
    if door == "csv":
        table.to_csv(path, index=False)
    elif door == "parquet":
        table.to_parquet(path, index=False)
    r = Recording.of(model, table) if door == "table" else jb.read(path, model)
    assert r.starts.tolist() == [5] and r.time[5] - r.time[4] == 480 and (r.stamps == stamps.to_numpy()).all()


def test_other_numbers_of_as_many_digits_are_what_they_are():
    for values in (
        [123456789012.0, 123456789013.0],
        [20241301000000.0],
        [20240101000000.5],
        [20240101000000.0, 20240132000000.0],
    ):
        np.testing.assert_array_equal(since_epoch(np.array(values)), values)


WRITTEN = {
    "dates": [f"2017-09-12 08:{k:02}:00.5" for k in range(6)],
    "dates of a region": [f"9/13/2017 8:{k:02}" for k in range(6)],
    "seconds": [str(60.0 * k + 7) for k in range(6)],
    "an epoch in ms": [str(1505203200500 + 60000 * k) for k in range(6)],
}


@pytest.mark.parametrize("kind", WRITTEN)
def test_instants_are_those_of_single_times_in_files_tables_parquet_pipes_and_readings(kind, tmp_path):
    cells, model = WRITTEN[kind], Signals((), ("y1",), {}, 60.0)
    expected = [instant_of(cell) for cell in cells]
    lines = [f"{cell},{k}\n" for k, cell in enumerate(cells)]
    (tmp_path / "run.csv").write_text("time,y1\n" + "".join(lines))
    whole = jb.read(tmp_path / "run.csv", model)
    table = pd.read_csv(tmp_path / "run.csv", index_col="time", parse_dates=kind.startswith("dates"))
    table.reset_index().to_parquet(tmp_path / "run.parquet")
    parts = open_source(tmp_path / "run.parquet", model)
    pipe = PipeText(model, lambda kind, sentence: None)
    pieces = [pipe.take(("time,y1\n" + "".join(lines[:2])).encode())]
    pipe = PipeText(model, lambda kind, sentence: None, pipe.memory())
    pieces.append(pipe.take("".join(lines[2:]).encode()))
    readings = Readings(model, [table.iloc[k : k + 1].reset_index() for k in range(6)])
    pieces_read = [piece for _, piece in readings.pieces(readings.raw)]
    found = {
        "file": whole.instants,
        "index": instants_of(whole.index, 6, 60.0),
        "table": instants_of(Recording.of(model, table).index, 6, 60.0),
        "parquet": np.concatenate([parts.read(0, 3).instants, parts.read(3, 6).instants]),
        "pipe": np.concatenate([piece.instants for piece in pieces]),
        "readings": np.concatenate([piece.instants for piece in pieces_read]),
    }
    assert not any(len(piece.starts) for piece in pieces_read)
    for where, instants in found.items():
        assert instants.tolist() == expected, where
