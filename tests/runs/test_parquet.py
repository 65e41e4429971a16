"""Recordings in Parquet: what is read, in which order, and a sentence for everything that is wrong."""

import decimal
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import jaxbound as jb
from jaxbound.recordings.parquet import open_parquet
from jaxbound.recordings.read import read

MODEL = jb.LinearSystem([["0.5"]], [[1]], [[1]], dt=0.5, noise=0.1)
ONE = jb.LinearSystem([["0.5"]], None, [[1]], dt=60, noise=0.1)


def table(n=12, first=0, **changes):
    """Return n samples of MODEL's signals from number `first` on."""
    k = np.arange(first, first + n)
    return pa.table({"t": 0.5 * k, "u1": np.sin(k), "y1": np.cos(k), **changes})


@pytest.fixture
def folder(tmp_path):
    """Return a function that writes tables as files of a folder."""

    def write(options=(), **tables):
        for name, content in tables.items():
            path = tmp_path / "data" / (name.replace("__", "/") + ".parquet")
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(content, path, **dict(options))
        return tmp_path / "data"

    return write


class TestReading:
    def test_a_folder_is_one_recording(self, folder):
        r = read(folder(a=table(5), b=table(7, 5)), MODEL)
        np.testing.assert_array_equal(r.time, 0.5 * np.arange(12))
        np.testing.assert_array_equal(r.u[:, 0], np.sin(np.arange(12)))
        np.testing.assert_array_equal(r.y[:, 0], np.cos(np.arange(12)))
        assert (
            not len(r.starts)
            and r.hints == ()
            and r.stamps is None
            and r.source == "data"
            and r.label(3) == "1.5 s"
        )

    def test_files_follow_each_other_by_name_as_people_count(self, folder):
        path = folder(
            **{
                "run-10": table(3, 5),
                "run-9": table(5),
                "run-9b": table(0),
                "_notes": pa.table({"x": [1]}),
                ".hidden": table(1),
                "z__run-1": table(4, 8),
            }
        )
        source = open_parquet(path, MODEL)
        assert [source.name(f) for f in source.files] == [
            "run-9.parquet",
            "run-9b.parquet",
            "run-10.parquet",
            "z/run-1.parquet",
        ]
        np.testing.assert_array_equal(read(path, MODEL).time, 0.5 * np.arange(12))
        assert source.row(4) == "row 5 of run-9.parquet" and source.row(5) == "row 1 of run-10.parquet"

    @pytest.mark.parametrize("groups", [1, 4, 100])
    def test_chunks_hold_every_sample_once(self, folder, groups, rng):
        cuts = np.sort(rng.integers(0, 100, 3))
        parts = {
            f"p{i}": table(b - a, a) for i, (a, b) in enumerate(zip([0, *cuts], [*cuts, 100], strict=True))
        }
        source = open_parquet(folder({"row_group_size": groups}, **parts), MODEL)
        for size in (1, 7, 100, 1000):
            first, stop = np.sort(rng.choice(101, 2, replace=False))
            pieces = list(source.chunks(int(first), int(stop), size))
            assert [start for start, _ in pieces] == list(range(first, stop, size)) and all(
                piece.samples <= size for _, piece in pieces
            )
            got = np.concatenate([piece.time for _, piece in pieces])
            np.testing.assert_array_equal(got, 0.5 * np.arange(first, stop))

    @pytest.mark.parametrize(
        "column, expected",
        [
            (pa.array([1, 2, None], pa.int16()), [1, 2, np.nan]),
            (pa.array([True, False, True]), [1, 0, 1]),
            (pa.array([decimal.Decimal("0.1"), None, decimal.Decimal("2.5")]), [0.1, np.nan, 2.5]),
            (pa.array([1.5, float("nan"), None]), [1.5, np.nan, np.nan]),
            (pa.nulls(3), [np.nan] * 3),
        ],
    )
    def test_numbers_of_any_type(self, folder, column, expected):
        np.testing.assert_array_equal(read(folder(a=table(3, u1=column)), MODEL).u[:, 0], expected)

    def test_float32_is_tested_in_the_type_it_was_rounded_to(self, folder):
        y = np.cos(np.arange(12)).astype(np.float32)
        r = read(folder(a=table(y1=y)), MODEL)
        assert r.y.dtype == np.float32 and r.u.dtype == np.float64  # inputs are taken as they were recorded
        np.testing.assert_array_equal(r.y[:, 0], y)

    def test_what_is_computed_from_float32_counts_as_float32(self, folder):
        model = jb.LinearSystem([["0.5"]], [[1]], [[1]], dt=0.5, noise=0.1, columns={"y1": "= top - bottom"})
        part = table().drop(["y1"])
        for name, values in (("top", np.arange(12, dtype=np.float32)), ("bottom", np.arange(12.0))):
            part = part.append_column(name, pa.array(values))
        assert read(folder(a=part), model).y.dtype == np.float32

    def test_only_what_the_model_names_is_needed_in_every_file(self, folder):
        path = folder(a=table(5, spare=["x"] * 5), b=table(7, 5))
        assert len(read(path, MODEL).time) == 12

    def test_names_with_dots_and_dashes(self, folder):
        model = jb.LinearSystem(
            [["0.5"]], [[1]], [[1]], dt=0.5, noise=0.1, columns={"y1": "tank.level [m]", "u1": "tank.level"}
        )
        r = read(
            folder(a=pa.table({"t": [0, 0.5], "tank.level": [1.0, 2.0], "tank.level [m]": [3.0, 4.0]})), model
        )
        np.testing.assert_array_equal(np.column_stack([r.u, r.y]), [[1, 3], [2, 4]])

    def test_pandas_is_not_imported(self, folder):
        path = folder(a=table(), b=table(3, 12))
        code = f"""
import sys
from jaxbound import LinearSystem
from jaxbound.recordings.read import read
r = read({str(path)!r}, LinearSystem([[0.5]], [[1]], [[1]], dt=0.5, noise=0.1))
print(len(r.time), "pandas" in sys.modules)
"""
        assert (
            subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
            == "15 False\n"
        )


STAMPS = np.datetime64("2017-09-12T23:58:00") + 60 * np.arange(4).astype("timedelta64[s]")
EPOCH = STAMPS.astype("datetime64[s]").astype(np.int64)


class TestTime:
    @pytest.mark.parametrize(
        "column",
        [
            pa.array(STAMPS),
            pa.array(STAMPS.astype("datetime64[ms]")),
            pa.array(STAMPS.astype("datetime64[ns]")),
            pa.array(STAMPS.astype("datetime64[us]"), pa.timestamp("us", "Europe/Berlin")),
            pa.array([str(s) for s in STAMPS]),
            pa.array([f"{s}Z" for s in STAMPS]),
            pa.array(EPOCH),
            pa.array(EPOCH * 1000),
            pa.array(EPOCH * 10.0**6),
        ],
        ids=lambda c: f"{c.type} {c[0]}",
    )
    def test_time_stamps(self, folder, column):
        cut = lambda a, b: pa.table({"time": column[a:b], "y1": np.arange(a, b, dtype=float)})
        path = folder(a=cut(0, 3), b=cut(3, 4))
        r = read(path, ONE)
        np.testing.assert_array_equal(r.time, 60.0 * np.arange(4))
        np.testing.assert_array_equal(r.stamps, STAMPS)
        source = open_parquet(path, ONE)
        late = source.read(3, 4)
        assert late.time[0] == 180 and source.stamp(180.0) == STAMPS[3]
        assert any("shown in UTC" in hint for hint in r.hints) == (
            getattr(column.type, "tz", None) is not None
        )
        text = column[3].as_py()
        assert r.label(3) == (text if isinstance(text, str) else "2017-09-13 00:01:00")

    def test_dates(self, folder):
        model = jb.LinearSystem([["0.5"]], None, [[1]], dt=86400, noise=0.1)
        days = pa.array(np.arange("2020-02-27", "2020-03-03", dtype="datetime64[D]"))
        assert read(folder(a=pa.table({"date": days, "y1": np.arange(5.0)})), model).time[4] == 4 * 86400

    def test_an_index_of_pandas(self, tmp_path):
        import pandas as pd

        for name in (None, "when"):
            frame = pd.DataFrame({"y1": np.arange(4.0)}, index=pd.DatetimeIndex(STAMPS, name=name))
            frame.to_parquet(tmp_path / "a.parquet")
            model = (
                ONE
                if name is None
                else jb.LinearSystem([["0.5"]], None, [[1]], dt=60, noise=0.1, columns={"time": "when"})
            )
            np.testing.assert_array_equal(read(tmp_path / "a.parquet", model).stamps, STAMPS)

    @pytest.mark.parametrize("write", [lambda t: t, lambda t: t.astype(str)], ids=["stamps", "texts"])
    def test_a_column_of_time_stamps_is_the_time_whatever_it_is_called(self, folder, write):
        stamps = STAMPS[:4] + np.array([0, 0, 60, 60], "timedelta64[m]")
        r = read(
            folder(a=pa.table({"remark": ["x"] * 4, "Messbeginn": write(stamps), "y1": [1.0, 2, 3, 4]})), ONE
        )
        np.testing.assert_array_equal(r.stamps, stamps)
        assert r.starts == (2,)

    def test_without_time_the_rows_are_dt_apart(self, folder):
        r = read(folder(a=pa.table({"y1": [1.0, 2.0]}), b=pa.table({"y1": [3.0]})), ONE)
        np.testing.assert_array_equal(r.time, [0, 60, 120])
        assert r.hints[:1] == (
            "the recording has no time column: the rows are taken to be dt = 60 s apart, and none to be "
            "missing",
        )

    def test_a_gap_between_files_splits_the_recording(self, folder):
        r = read(folder(a=table(5), b=table(7, 8)), MODEL)
        assert (
            r.starts == (5,) and "gap" in r.hints[0] and "2 s before row 1 of b.parquet (4 s)" in r.hints[0]
        )

    def test_a_repeated_last_row_splits_the_recording(self, folder):
        r = read(folder(a=table(5), b=table(7, 4)), MODEL)
        assert r.starts == (5,) and "repeats the time of the row before" in r.hints[0]


def half(content):
    """Return a table with y1 in half precision."""
    return content.set_column(2, "y1", pa.array(np.ones(len(content), np.float16)))


def twice(content):
    return content.append_column("y1", pa.array(np.ones(len(content))))


STUCK = pa.array([0.5 * k for k in range(12)][::-1])
BAD = {
    "missing column": (dict(a=table().drop(["y1"])), r"data/a.parquet: the recording has no column 'y1'"),
    "missing column later": (
        dict(a=table(5), b=table(7, 5).drop(["y1"])),
        r"data/b.parquet: the recording has no column 'y1'.*, as the files before it have "
        r"\(first a.parquet\)",
    ),
    "other type later": (
        dict(a=table(5), b=table(7, 5, y1=np.arange(7))),
        "data/b.parquet: column 'y1' is of type int64, of type double in a.parquet: all files of a folder "
        "need",
    ),
    "other time later": (
        dict(a=table(5), b=table(7, 5, t=STAMPS.repeat(2)[:7])),
        "'t' is of type timestamp.ms., of type double in a",
    ),
    "time later only": (
        dict(a=table(5).drop(["t"]), b=table(7, 5)),
        "column 't' is of type double, not used in a.parquet",
    ),
    "time at first only": (
        dict(a=table(5), b=table(7, 5).drop(["t"])),
        "b.parquet: column 't' is not used, of type double in a.parquet",
    ),
    "text": (dict(a=table(y1=["1"] * 12)), r"column 'y1' holds text \(string\): numbers are needed"),
    "list": (dict(a=table(y1=[[1.0]] * 12)), r"column 'y1' holds values of type list.*: numbers are needed"),
    "time stamps for a signal": (
        dict(a=table(4, y1=STAMPS)),
        r"column 'y1' holds values of type timestamp\[ms\]: numbers are needed",
    ),
    "half precision": (dict(a=half(table())), "column 'y1' is in half precision"),
    "time of day": (
        dict(a=table(2, t=pa.array([0, 1], pa.time32("s")))),
        "the time column 't' holds values of type time32",
    ),
    "text for time": (
        dict(a=table(2, t=["noon", "midnight"])),
        "the time column 't' holds texts like 'noon': write it as time stamps",
    ),
    "no time in a row": (
        dict(a=table(3), b=table(2, 3, t=pa.array([1.5, None]))),
        "row 2 of b.parquet has no time: every row needs one",
    ),
    "infinity": (
        dict(a=table(3), b=table(2, 3, y1=[1.0, -np.inf])),
        "row 2 of b.parquet of column 'y1' is infinite or too large",
    ),
    "huge whole numbers": (
        dict(a=table(3, y1=[0, 2**53 + 1, 1])),
        "column 'y1' of .* holds whole numbers too large for a float",
    ),
    "no row": (dict(a=table(0)), "no row of data: a recording has at least two"),
    "one row": (dict(a=table(1), b=table(0)), "one row of data: a recording has at least two"),
    "another dt": (
        dict(a=table(t=np.arange(12.0))),
        "the model has dt = 0.5 s, but the rows of the recording are 1 s apart",
    ),
    "newest first": (
        dict(a=table(t=STUCK)),
        "the rows run backwards in time, the newest first: sort them by time",
    ),
    "irregular": (
        dict(a=table(t=np.cumsum([0.5, 0.7, 0.5, 0.7, 0.7, 0.5, 0.3, 0.5, 0.5, 0.3, 0.7, 0.5]))),
        "the recording is not regular",
    ),
    "two columns": (dict(a=twice(table())), "2 columns are called 'y1'"),
    "clock backwards between files": (
        dict(a=table(5, 7), b=table(7)),
        "b.parquet begins at 0 s, before the end of a.parquet at 5.5 s: files follow each other by name",
    ),
}


class TestBad:
    @pytest.mark.parametrize("case", BAD)
    def test_one_clear_sentence(self, folder, case):
        tables, message = BAD[case]
        with pytest.raises(ValueError, match=message) as caught:
            read(folder(**tables), MODEL)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("name", ["a", "b"])
    def test_a_truncated_file(self, folder, name):
        path = folder(a=table(5), b=table(7, 5))
        content = (path / f"{name}.parquet").read_bytes()
        for length in (4, 100, len(content) - 1):
            (path / f"{name}.parquet").write_bytes(content[:length])
            with pytest.raises(
                ValueError, match=f"{name}.parquet is a truncated Parquet file: its end is missing"
            ):
                read(path, MODEL)
        for content in (b"", b"PAR", b"t,u1,y1\n0,1,2\n"):
            (path / f"{name}.parquet").write_bytes(content)
            with pytest.raises(ValueError, match=f"{name}.parquet is no Parquet file"):
                read(path, MODEL)

    def test_a_damaged_file(self, folder):
        path = folder({"compression": "gzip"}, a=table(), b=table(5000, 12))
        content = bytearray((path / "b.parquet").read_bytes())
        for at in (20, len(content) // 2, len(content) - 60):
            broken = content.copy()
            broken[at : at + 40] = b"\xff" * 40
            (path / "b.parquet").write_bytes(broken)
            with pytest.raises(ValueError, match="b.parquet is a damaged Parquet file: ") as caught:
                read(path, MODEL)
            assert "\n" not in str(caught.value)

    def test_a_page_whose_checksum_is_not_that_of_its_content(self, folder):
        path = folder(
            {"compression": "none", "use_dictionary": False, "write_page_checksum": True}, a=table(200)
        )
        good = bytearray((path / "a.parquet").read_bytes())
        page = pq.read_metadata(path / "a.parquet").row_group(0).column(2)
        good[page.data_page_offset + page.total_compressed_size - 9] ^= (
            1  # a sample of y1: a number as good as any other
        )
        (path / "a.parquet").write_bytes(good)
        with pytest.raises(
            ValueError, match="a.parquet is a damaged Parquet file: .*CRC checksum verification failed"
        ):
            read(path, MODEL)

    def test_a_file_that_was_written_since_it_was_opened(self, folder):
        path = folder(a=table(), b=table(12, 12))
        source = open_parquet(path, MODEL)
        pq.write_table(table(12, 13), path / "b.parquet")
        assert len(source.read(0, 12).time) == 12
        with pytest.raises(
            ValueError, match="b.parquet has changed since it was opened: test it again once it is complete"
        ):
            source.read(0, 13)

    def test_folders_without_parquet(self, tmp_path):
        with pytest.raises(ValueError, match="is a folder without Parquet files: it is empty"):
            read(tmp_path, MODEL)
        (tmp_path / "a.csv").write_text("t,u1,y1\n")
        with pytest.raises(ValueError, match="is a folder without Parquet files: it has a.csv"):
            read(tmp_path, MODEL)
