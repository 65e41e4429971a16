"""Recordings from CSV: what is read, and a sentence for everything that is wrong."""

import contextlib
import csv
import datetime
import threading

import numpy as np
import pandas as pd
import pyarrow.csv
import pytest

import jaxbound as jb
from jaxbound.recordings.read import read_signals
from jaxbound.recordings.recording import Recording
from jaxbound.runs.verdictfiles import AlarmColumns, write_alarms, write_verdicts

MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1, resolution=1)
TWO = jb.LinearSystem(
    [[0.5]],
    [[1]],
    [[1], [2]],
    dt=60,
    noise=0.1,
    resolution=1,
    inputs=["pump"],
    outputs=["level", "flow"],
    columns={"pump": "Pump [%]"},
)
ROWS = [(0.0, 1.0, 2.0), (0.5, 1.5, 2.5), (1.0, 2.0, 3.5), (1.5, 0.0, 4.25)]


def text_of(rows=ROWS, header="t,u1,y1", delimiter=","):
    return "\n".join([header, *(delimiter.join(map(str, row)) for row in rows)]) + "\n"


@pytest.fixture
def read(tmp_path):
    """Return a function that reads a recording from text or bytes."""

    def reading(text, model=MODEL, name="data.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return jb.read(path, model)

    return reading


class TestFormats:
    def check(self, r):
        np.testing.assert_array_equal(r.time, [0, 0.5, 1, 1.5])
        np.testing.assert_array_equal(r.u[:, 0], [1, 1.5, 2, 0])
        np.testing.assert_array_equal(r.y[:, 0], [2, 2.5, 3.5, 4.25])

    def test_plain(self, read):
        r = read(text_of())
        self.check(r)
        assert r.stamps is None and r.hints == () and r.u.shape == (4, 1) and r.y.shape == (4, 1)

    def test_stray_blanks_and_extra_columns_in_any_order(self, read):
        rows = [("x", y, 7, f" {u}", f" {t}") for t, u, y in ROWS]
        self.check(read(text_of(rows, "remark, y1 ,  spare,u1 , t (s)")))

    @pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
    def test_line_ends(self, read, end):
        self.check(read(text_of().replace("\n", end)))
        unended = read(text_of([*ROWS, (2, 0, 0)]).rstrip("\n").replace("\n", end))
        self.check(unended)
        assert unended.hints[0].startswith("row 6, the last, has no line end")

    @pytest.mark.parametrize("delimiter", [";", "\t"])
    @pytest.mark.parametrize("decimal", [",", "."])
    def test_delimiter_and_decimal(self, read, delimiter, decimal):
        rows = [[str(x).replace(".", decimal) for x in row] for row in ROWS]
        self.check(read(text_of(rows, delimiter.join(["t", "u1", "y1"]), delimiter)))

    def test_decimal_comma_that_shows_late(self, read):
        rows = [(k, 0, 0) for k in range(400)] + [(400, "0,5", "1,5")]
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1, noise=0.1)
        assert read(text_of(rows, "t;u1;y1", ";"), model).y[-1, 0] == 1.5

    def test_byte_order_mark_quotes_blank_lines_and_excel_first_line(self, read):
        self.check(read(b"\xef\xbb\xbf" + text_of(header='"t", "u1", "y1"').encode()))
        self.check(read("\n\n" + text_of().replace("\n0.5", "\n\n0.5")))
        self.check(read("sep=;\n" + text_of(header="t;u1;y1", delimiter=";")))

    def test_windows_1252_is_read_with_a_hint(self, read):
        r = read(text_of([(*row, "°") for row in ROWS], "t,u1,y1,Außentemperatur").encode("cp1252"))
        self.check(r)
        assert "Windows-1252" in r.hints[0]

    def test_columns_by_the_names_of_the_model(self, read):
        r = read("time,flow,Pump [%],level\n0,1,2,3\n60,4,5,6\n", TWO)
        np.testing.assert_array_equal(r.u, [[2], [5]])
        np.testing.assert_array_equal(r.y, [[3, 1], [6, 4]])

    def test_signal_name_serves_if_the_column_is_absent(self, read):
        assert read("time,flow,pump,level\n0,1,2,3\n60,4,5,6\n", TWO).u[1, 0] == 5

    def test_floats_are_read_exactly(self, read, rng):
        x = rng.normal(size=500) * 10.0 ** rng.integers(-200, 200, 500)
        model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        np.testing.assert_array_equal(
            read(text_of(enumerate(map(repr, x.tolist())), "t,y1"), model).y[:, 0], x
        )

    def test_model_without_inputs(self, read):
        assert read("t,y1\n0,1\n1,2\n", jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)).u.shape == (2, 0)

    def test_tclab_with_its_jitter(self, shared):
        model = jb.LinearSystem(
            [[0.5]], None, [[1], [1]], dt=3, noise=0.1, outputs=["Temperature 1", "Temperature 2"]
        )
        r = jb.read(shared("data/tclab/mimo_hybrid_3s.csv"), model)
        assert (
            r.y.shape == (201, 2) and r.y[1, 1] == 16.35 and r.label(1) == "3 s" and r.label(50) == "150.09 s"
        )
        assert "multiple of 0.01" in r.hints[0] and "`resolution = 0.005`" in r.hints[0]


class TestMissing:
    @pytest.mark.parametrize(
        "cell", ["", " ", "NaN", "nan", " NaN", "null", "NULL", "NA", " NA", "N/A", '""']
    )
    def test_cells_that_mean_missing(self, read, cell):
        r = read(text_of([(0, 1, 2), (0.5, 1, cell), (1, 1, 3)]))
        assert np.isnan(r.y[1, 0]) and not np.isnan(r.y[[0, 2], 0]).any()
        assert r.hints == (
            "1 of 3 samples of y1 are missing: the windows around them are judged without them",
        )

    def test_what_a_window_claims_that_lacks_an_input_is_said(self, read):
        """UNDECIDED with a margin near 1 read as proved."""
        r = read(text_of([(0.5 * k, "" if k == 3 else 1, 1) for k in range(9)]))
        judged = jb.detect(jb.parity_relations(MODEL, 2), r)
        assert judged.status.tolist() == [0, 0, 1, 1, 2, 2, 1, 1, 1]
        (said,) = (hint for hint in r.hints if "u1" in hint)
        assert said.startswith("1 of 9 samples of u1 are missing: windows that need one are judged as if")
        assert said.endswith("else UNDECIDED or MISSING: their margins are of the rest only")

    def test_long_runs_are_fine(self, read):
        r = read(text_of([(0.5 * k, 1, "" if 10 <= k < 90 else k) for k in range(100)]))
        assert np.isnan(r.y).sum() == 80


class TestTime:
    @pytest.mark.parametrize(
        "form",
        [
            "%Y-%m-%d %H:%M:%S",
            "%Y-%m-%dT%H:%M:%S",
            "%Y-%m-%dT%H:%M:%SZ",
            "%Y-%m-%dT%H:%M:%S+02:00",
            "%Y-%m-%d %H:%M",
            "%Y/%m/%d %H:%M:%S",
            "%m/%d/%Y %H:%M",
            "%m/%d/%Y %H:%M:%S",
            "%d.%m.%Y %H:%M",
            "%d.%m.%Y %H:%M:%S",
            "%d-%b-%Y %H:%M:%S",
            "%m/%d/%Y %I:%M:%S %p",
            "%d/%m/%Y %H:%M",
            "%m/%d/%y %H:%M",
            "%Y%m%d %H%M%S",
            "%Y-%m-%d %H:%M:%S.%f",
            "%d.%m.%Y %H:%M:%S.%f",
            "%d.%m.%Y %H:%M:%S,%f",
        ],
    )
    def test_time_stamps(self, read, form):
        first = datetime.datetime(2017, 9, 12, 23, 30)
        stamps = [
            (first + datetime.timedelta(minutes=k)).strftime(form) for k in range(60)
        ]  # over midnight: the day must be found
        r = read(text_of([(s, 1, k, k) for k, s in enumerate(stamps)], "Zeit;pump;level;flow", ";"), TWO)
        np.testing.assert_array_equal(r.time, 60.0 * np.arange(60))
        shift = np.timedelta64(2, "h") if "+02" in form else np.timedelta64(0, "h")
        assert (
            r.stamps[31] + shift == np.datetime64("2017-09-13T00:01")
            and r.label(31) == stamps[31]
            and r.axis is r.stamps
        )

    def test_stamps_without_leading_zeros(self, read):
        rows = [(f"9/12/2017 {k // 60}:{k % 60:02d}", 1, k, -k) for k in range(180)]
        r = read(text_of(rows, "Datetime,pump,level,flow"), TWO)
        assert r.stamps[61] == np.datetime64("2017-09-12T01:01")
        assert r.hints == (
            "time stamps like '9/12/2017 0:00' are read as month/day/year; they could also be "
            "day/month/year: say which by time_format, like '%d/%m/%Y' "
            "(--recording, or [recording] of the model file)",
        )

    def test_jitter_of_milliseconds(self, read):
        rows = [(f"2020-01-01 00:{k:02d}:00.{7 * k % 10:03d}", 1, 2, 3) for k in range(60)]
        assert abs(read(text_of(rows, "time,pump,level,flow"), TWO).time[1] - 60.007) < 1e-9

    def test_fractions_that_appear_only_sometimes(self, read):
        rows = [
            (f"12.09.2017 10:00:0{k // 2}{'.5' if k % 2 else '.0' if k == 0 else ''}", 1, 2)
            for k in range(10)
        ]
        np.testing.assert_array_equal(read(text_of(rows)).time, 0.5 * np.arange(10))

    def test_a_clock_that_passes_midnight(self, read):
        rows = [(f"{(23 * 60 + 50 + k) // 60 % 24:02d}:{(50 + k) % 60:02d}:00", 1, 2, 3) for k in range(20)]
        r = read(text_of(rows, "time,pump,level,flow"), TWO)
        np.testing.assert_array_equal(r.time, 60.0 * np.arange(20))
        assert (
            r.stamps is None
            and r.hints[0] == "time stamps like '23:50:00' have no day: a gap of whole days cannot be seen"
        )

    @pytest.mark.parametrize("scale, unit", [(1, ""), (1000, "ms"), (10**6, "us"), (10**9, "ns")])
    def test_epochs(self, read, scale, unit):
        r = read(
            text_of(
                [((1_505_174_400 + 60 * k) * scale, 1, 2, 3) for k in range(5)], "timestamp,pump,level,flow"
            ),
            TWO,
        )
        np.testing.assert_array_equal(r.time, 60.0 * np.arange(5))
        assert r.stamps[1] == np.datetime64("2017-09-12T00:01") and r.label(1) == "2017-09-12 00:01:00"
        assert [h for h in r.hints if "epoch" in h] == (
            [f"the time column is read as an epoch in {unit}"] if unit else []
        )

    def test_no_time_column(self, read):
        r = read("u1,y1\n1,2\n3,4\n5,6\n")
        np.testing.assert_array_equal(r.time, [0, 0.5, 1])
        assert (
            r.hints
            == (
                "the file has no time column: the rows are taken to be dt = 0.5 s apart, and none to be "
                "missing",
            )
            and r.written is None
        )

    @pytest.mark.parametrize(
        "header", ["Zeitstempel", "Horodatage", "Fecha y hora", "Tidspunkt", "час", "时间", "when"]
    )
    def test_a_column_of_time_stamps_is_the_time_in_any_language(self, read, header):
        """Before, such a file with a gap was taken to be one without: windows across it were proved to be
        faulty.
        """
        self.with_a_gap(read, header, "05.03.2024 08:{:02d}:00")

    def test_time_stamps_without_separators_are_found_too(self, read):
        self.with_a_gap(read, "Kell", "20240305T08{:02d}00")

    def with_a_gap(self, read, header, form):
        rows = [(form.format(k), "shift 2", "1,5", 2, 3) for k in (0, 1, 2, 40, 41, 42, 43)]
        r = read(text_of(rows, f"{header};remark;pump;level;flow", ";"), TWO)
        assert list(r.starts) == [3] and r.time[3] == 2400 and r.label(3) == form.format(40)

    def test_two_columns_of_time_stamps_are_refused_where_none_is_called_like_time(self, read):
        with pytest.raises(
            ValueError,
            match="the columns 'a', 'b' hold time stamps: say which is the time, with `time` among the "
            "columns",
        ):
            read("a,b,u1,y1\n10:00:00,11:00:00,1,2\n10:00:01,11:00:01,1,2\n")

    @pytest.mark.parametrize(
        "header, day",
        [("Datum;Uhrzeit", "05.03.2024"), ("Date;Time", "2024-03-05"), ("Kuupäev;Kell", "20240305")],
    )
    @pytest.mark.parametrize("named", [{}, {"time": 1}])
    def test_a_day_in_a_column_of_its_own_shows_gaps_of_days(self, read, header, day, named):
        """Before, `Date;Time` was read by the clock alone: windows across a gap of two days were tested as if
        there were none.
        """
        days = [day] * 3 + [day.replace("05", "07")] * 3
        text = f"{header};u1;y1\n" + "".join(f"{d};08:00:0{k};1;2\n" for k, d in enumerate(days))
        columns = {key: header.split(";")[at] for key, at in named.items()}
        r = read(text, jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1, noise=0.1, columns=columns))
        assert list(r.starts) == [3] and r.time[3] == 2 * 86400 + 3 and r.label(3) == f"{days[3]} 08:00:03"

    def test_a_day_far_from_a_clock_is_not_taken_for_its_own(self, read):
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=1, noise=0.1)
        clocks = ("23:59:59", "00:00:00", "00:00:01")
        text = "clock,u1,y1,installed\n" + "".join(f"{clock},1,2,2019-01-01\n" for clock in clocks)
        assert list(read(text.replace("clock", "Time"), model).time) == [0, 1, 2]

    def test_days_of_a_daily_recording_need_no_clock(self, read):
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=86400, noise=0.1)
        text = "Date,sunrise,u1,y1\n" + "".join(f"2024-03-0{k},06:{k}0:00,1,2\n" for k in range(1, 6))
        assert read(text, model).label(1) == "2024-03-02"

    def test_two_days_beside_a_clock_are_refused(self, read):
        with pytest.raises(
            ValueError,
            match="'Time' holds times without a day, and the columns 'Date', 'datum' hold days: keep one of "
            "them",
        ):
            read(
                "Date,Time,datum,u1,y1\n2024-03-05,10:00:00,2024-03-06,1,2\n2024-03-05,10:00:01,2024-03-06,1,2\n"
            )

    def test_the_time_column_that_the_model_names(self, read):
        model = jb.LinearSystem([[0.5]], None, [[1]], dt=2, noise=0.1, columns={"time": "seconds"})
        np.testing.assert_array_equal(read("time,seconds,y1\n0,0,1\n1,2,1\n", model).time, [0, 2])

    def test_an_index_of_stamps_without_a_name(self, read):
        assert read(",u1,y1\n2020-01-01 00:00:00.0,1,2\n2020-01-01 00:00:00.5,1,2\n").time[1] == 0.5


BAD = {
    "missing column": (
        "t,u1,z1\n0,1,2\n0.5,1,2\n",
        "the recording has no column 'y1'; did you mean 'z1'",
    ),
    "missing column, and one like it that the input has": (
        "t,u1\n0,1\n0.5,1\n",
        "the recording has no column 'y1': it has 't', 'u1'",
    ),
    "text in a number column": (
        text_of([*ROWS, (2.0, "off", 3)]),
        "row 6 of column 'u1' holds 'off', which is not a number: leave",
    ),
    "several words": (
        text_of([*ROWS, (2.0, "off", 3), (2.5, 1, "No Data"), (3.0, "off", 3)]),
        "leave the row out by `where`; 2 more cells hold 'No Data', 'off', too",
    ),
    "header below": (
        "Logger 7\n\nt;u1;z1\n0;1;2\n",
        "no column 'u1'.*; the header must be the first row: row 1 has 1 cell, row 3 has 3",
    ),
    "decimals or thousands": (
        't,u1,y1\n0,1,"2,500"\n0.5,1,2\n',
        "row 2 of column 'y1' holds '2,500'.* thousands",
    ),
    "units alone below the header": ("t,u1,y1\ns,%,m\n0,1,2\n", "one row of data"),
    "all NaN": (
        text_of([(0, 1, "NaN"), (0.5, 1, ""), (1, 1, "NA")]),
        "column 'y1' holds no number at all: all 3 cells",
    ),
    "empty file": ("", "the file is empty"),
    "only blanks": (" \n\n", "the file is empty"),
    "header only": ("t,u1,y1\n", "a header but no row of data"),
    "header only, no line end": ("t,u1,y1", "a header but no row of data"),
    "no header": ("0,1,2\n0.5,1,2\n", "the first row must hold the names of the columns: it holds numbers"),
    "one row": ("t,u1,y1\n0,1,2\n", "one row of data: a recording has at least two"),
    "too few cells": (text_of([*ROWS, (2.0, 1), (2.5, 1, 2)]), "row 6 has 2 cells, the header has 3 columns"),
    "too many cells": (
        text_of([*ROWS, (2.0, 1, 2, 3), (2.5, 1, 2)]),
        "row 6 has 4 cells, the header has 3 columns",
    ),
    "irregular time": (
        text_of([(t, 1, 2) for t in (0, 0.5, 1.2, 1.7, 1.9, 2.4, 3.2, 3.5, 3.99, 4.09, 4.99)]),
        r"not regular: 6 of 10 steps differ from dt = 0.5 s by more than 20%; row 6 \(1.9 s\), for one, "
        r"comes 0.2 s after",
    ),
    "newest first": (
        text_of([(-0.5 * k, 1, 2) for k in range(9)]),
        "the rows run backwards in time, the newest first",
    ),
    "rounded stamps": (
        text_of([(k // 3, 1, k) for k in range(9)]),
        "0 s apart: more than half of the rows repeat the time",
    ),
    "wrong dt": (
        text_of([(k, 1, 2) for k in range(9)]),
        "dt = 0.5 s, but the rows .* are 1 s apart: fit again, with healthy recordings 1 s apart$",
    ),
    "time in ms": (
        text_of([(500 * k, 1, 2) for k in range(9)]),
        "dt = 0.5 s, but .* 500 s apart: is its time in ms?",
    ),
    "blank time": (
        text_of([(0, 1, 2), ("", 1, 2), ("", 1, 2), ("", 1, 2), (1, 1, 2)]),
        "row 3 has no time: every row needs one, 3 do not",
    ),
    "time that is none": (
        text_of([("now", 1, 2), ("then", 1, 2)]),
        "row 2 of the time column is 'now': neither seconds nor",
    ),
    "mixed time stamps": (
        text_of([("12.09.2017 10:00", 1, 2), ("later", 1, 2), ("12.09.2017 10:01", 1, 2)]),
        "row 3 of the time column is 'later': not a time stamp like the first",
    ),
    "duplicate column": (
        "t,y1,u1,y1\n0,1,2,3\n0.5,1,2,3\n",
        "2 columns are called 'y1': a signal needs exactly one",
    ),
    "infinity": (
        text_of([*ROWS, (2.0, "inf", 3)]),
        "row 6 of column 'u1' is infinite or too large for a number",
    ),
    "beyond floats": (text_of([*ROWS, (2.0, 1, "-1e999")]), "row 6 of column 'y1' is infinite or too large"),
    "UTF-16 without mark": (text_of().encode("utf-16-le"), "this is a binary file, or text in UTF-16"),
    "binary": (bytes(range(256)) * 9, "this is a binary file"),
    "binary without zeros": (bytes(range(128, 256)) * 9, "this is not a text file"),
    "zip": (b"PK\x03\x04" + bytes(100), "this is a zip file or an Excel workbook, not text"),
    "gzip": (b"\x1f\x8b" + bytes(100), "this is a gzip file"),
}


class TestBad:
    @pytest.mark.parametrize("case", BAD)
    def test_one_clear_sentence(self, read, case):
        data, message = BAD[case]
        with pytest.raises(ValueError, match=message) as caught:
            read(data)
        assert "data.csv: " in str(caught.value) and "\n" not in str(caught.value)

    def test_time_column_that_the_model_names_and_the_file_lacks(self, read):
        model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, columns={"time": "stamp"})
        with pytest.raises(ValueError, match="no column 'stamp'; did you mean 'stamps'"):
            read("stamps,y1\n0,1\n1,1\n", model)

    def test_standard_input_is_refused(self):
        with pytest.raises(ValueError, match="standard input is read by `jaxbound detect MODEL.toml -`"):
            jb.read("-", MODEL)

    def test_parquet_under_another_name_is_read(self, read, tmp_path):
        import pyarrow as pa
        import pyarrow.parquet as pq

        pq.write_table(
            pa.table({"t": [0.0, 0.5, 1.0], "u1": [1.0, 2.0, 3.0], "y1": [4.0, None, 6.0]}),
            tmp_path / "real.parquet",
        )
        r = read((tmp_path / "real.parquet").read_bytes())
        np.testing.assert_array_equal(r.y[:, 0], [4, np.nan, 6])
        assert r.time[1] == 0.5 and "1 of 3 samples of y1 are missing" in r.hints[0]

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="there is no data file"):
            jb.read(tmp_path / "none.csv", MODEL)

    def test_unusual_but_finite_numbers_pass(self, read):
        assert read(text_of([(0, 1e308, -1e308), (0.5, 5e-324, 0), (1, 0, 1)])).u[0, 0] == 1e308


class TestRounding:
    def hints(self, read, y, resolution=0):
        model = jb.LinearSystem([[0.5]], None, [[1]], dt=1, noise=0.1, resolution=resolution)
        return read(text_of(enumerate(y), "t,y1"), model).hints

    @pytest.mark.parametrize("decimals", [0, 1, 3, 6])
    def test_decimals_are_seen(self, read, rng, decimals):
        y = np.round(rng.normal(size=300) * 30, decimals)
        (hint,) = self.hints(read, y)
        assert (
            f"multiple of {10.0**-decimals:.6g}," in hint
            and f"`resolution = {10.0**-decimals / 2:.6g}`" in hint
        )

    def test_steps_of_a_converter_are_seen(self, read, rng):
        (hint,) = self.hints(read, (20 + 0.489 * rng.integers(0, 40, 300)).tolist())
        assert "`resolution = 0.2445`" in hint

    def test_a_stated_resolution_is_enough(self, read, rng):
        y = np.round(rng.normal(size=300), 3)
        assert self.hints(read, y, "0.0005") == () and len(self.hints(read, y, "0.0004")) == 1

    def test_full_floats_are_not_called_rounded(self, read, rng):
        assert self.hints(read, rng.normal(size=300)) == ()

    def test_outputs_of_one_step_share_a_sentence(self, read, rng):
        model = jb.LinearSystem([[0.5]], None, [[1], [1]], dt=1, noise=0.1)
        rows = [(k, *x) for k, x in enumerate(np.round(rng.normal(size=(50, 2)), 2))]
        (hint,) = read(text_of(rows, "t,y1,y2"), model).hints
        assert "every sample of y1, y2 is" in hint


class TestWriting:
    def result(self, n=400):
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1)
        u = np.zeros((n, 1))
        y = np.zeros((n, 1))
        y[200:203], y[300] = 5.0, np.nan
        return jb.detect(jb.parity_relations(model), u, y), u, y

    def test_verdicts_read_back(self, tmp_path):
        import pandas as pd

        res, u, y = self.result()
        write_verdicts(tmp_path / "v.csv", res, Recording(u, y, time=0.5 * np.arange(400)))
        table = pd.read_csv(tmp_path / "v.csv")
        assert list(table) == ["time", "status", "margin", "suspect"]
        np.testing.assert_array_equal(table.time, 0.5 * np.arange(400))
        assert [jb.Status[s] for s in table.status] == list(res.status)
        np.testing.assert_array_equal(table.margin, res.margin)
        np.testing.assert_array_equal(table.suspect, res.suspect)

    @pytest.mark.parametrize("comma", ["", ","])
    def test_verdicts_keep_the_time_of_the_file(self, read, tmp_path, comma):
        stamps = [f"12.09.2017{comma} 10:00:0{k // 2}.{5 * (k % 2)}" for k in range(8)]
        if comma:  # a text that needs quotes: written by hand, no format of ours
            import pyarrow as pa

            r = Recording(
                np.zeros((8, 1)), np.zeros((8, 1)), time=0.5 * np.arange(8), written=pa.array(stamps)
            )
        else:
            r = read(text_of([(s, 0, 0) for s in stamps]))
        write_verdicts(tmp_path / "v.csv", jb.detect(jb.parity_relations(MODEL), r.u, r.y), r)
        with open(tmp_path / "v.csv", newline="") as f:
            assert [row[0] for row in csv.reader(f)] == ["time", *stamps]

    def test_verdicts_without_a_recording_count_samples(self, tmp_path):
        write_verdicts(tmp_path / "v.csv", self.result()[0])
        assert (tmp_path / "v.csv").read_text().splitlines()[3].startswith("2,CONSISTENT,")

    def test_alarms(self, tmp_path):
        res, u, y = self.result()
        write_alarms(
            tmp_path / "a.csv", res.alarms(), Recording(u, y, time=0.5 * np.arange(400)), AlarmColumns(0.5)
        )
        header, *rows = (line.split(",") for line in (tmp_path / "a.csv").read_text().splitlines())
        first = dict(zip(header, rows[0], strict=True))
        a = res.alarms()[0]
        assert (
            len(rows) == len(res.alarms())
            and float(first["start"]) == 0.5 * a.start == 100.0
            and int(first["windows"]) == a.windows
        )
        assert (
            float(first["duration_s"]) == 0.5 * (a.end - a.start + 1)
            and float(first["factor"]) == 1 - a.depth
        )

    def test_no_alarms_is_a_header(self, tmp_path):
        write_alarms(
            tmp_path / "a.csv",
            [],
            Recording(np.zeros((4, 0)), np.zeros((4, 1)), time=np.arange(4.0)),
            AlarmColumns(1),
        )
        header = "start,end,duration_s,first_sample,last_sample,windows,depth,factor,worst,ended"
        assert (tmp_path / "a.csv").read_text().splitlines() == [header]


class NamesAlone:
    """The least that a model of a user says of its signals."""

    inputs, outputs, columns, m, p, dt, name = (), ("y1",), {}, 0, 1, 2.0, "own"

    def column(self, signal):
        return signal

    def unit(self, signal):
        return ""


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    "model", [NamesAlone(), jb.interval_system([[(0.4, 0.5)]], None, [[1]])], ids=["names", "no dt"]
)
def test_a_model_need_not_state_resolution_or_sampling_period(tmp_path, kind, model):
    table = pd.DataFrame({"time": np.arange(20) * 2.0, "y1": np.linspace(0, 1, 20)})
    if kind == "csv":
        table.to_csv(tmp_path / "run.csv", index=False)
    else:
        table.to_parquet(tmp_path / "run.parquet")
    run = jb.read(tmp_path / f"run.{kind}", model)
    assert run.samples == 20 and run.dt == 2.0
    assert run.time[-1] == 38.0


@pytest.mark.parametrize("cell", ["2.5", "two"])
def test_no_thread_of_a_parser_holds_a_file_that_was_read(tmp_path, monkeypatch, cell):
    """One that lets go of it while the interpreter ends aborts the process: a wrong exit code."""
    path = tmp_path / "run.csv"
    path.write_text(f"y\n1.5\n{cell}\n")
    read_csv, held = pyarrow.csv.read_csv, []

    def late(lines, *options):
        held.append(lines)
        threading.Timer(0.05, held.clear).start()
        return read_csv(lines, *options)

    monkeypatch.setattr(pyarrow.csv, "read_csv", late)
    with contextlib.suppress(ValueError):
        read_signals([path], [], ["y"])
    assert not held
