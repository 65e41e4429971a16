"""The door of every verb: what has names is taken by them, rows by their labels, and what is missing stays
missing.
"""

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals

MODEL = jb.LinearSystem([[0.5]], [[1]], [[1], [2]], noise=0.1, inputs=["valve"], outputs=["level", "flow"])
U, Y = np.arange(6.0)[:, None], np.arange(12.0).reshape(6, 2)
SECONDS = pd.date_range("2024-01-01", periods=6, freq="s")


def frame(index=None):
    """Return one table of all signals, columns shuffled."""
    return pd.DataFrame({"flow": Y[:, 1], "note": "text", "valve": U[:, 0], "level": Y[:, 0]}, index)


def starts(index, model=MODEL):
    return Recording.of(model, frame(index)).starts.tolist()


class Polars:
    """What jaxbound sees of a polars.DataFrame: names, no index, no iloc, `to_pandas`."""

    def __init__(self, columns):
        self._columns = columns

    columns = property(lambda self: list(self._columns))

    def to_pandas(self):
        return pd.DataFrame(self._columns)


class Arrow:
    """Anything else that speaks the Arrow protocol."""

    def __init__(self, table):
        self.column_names, self._table = table.column_names, table

    def __arrow_c_stream__(self, requested_schema=None):
        return self._table.__arrow_c_stream__(requested_schema)


class Labelled:
    """What jaxbound sees of a labelled xarray.DataArray of two dimensions."""

    def __init__(self, values, rows, columns):
        self.dims, self._table = ("time", "signal"), pd.DataFrame(values, rows, columns)

    def __array__(self, *args, **kwargs):
        raise AssertionError("taken by position")

    def to_pandas(self):
        return self._table


def arrow(kind="Table"):
    pa = pytest.importorskip("pyarrow")
    columns = {"flow": Y[:, 1], "valve": [0, 1, 2, None, 4, 5], "level": Y[:, 0]}
    return getattr(pa, "table" if kind == "Table" else "record_batch")(columns)


def xarray(kind):
    xr = pytest.importorskip("xarray")
    both = np.column_stack([Y[:, 1], U[:, 0], Y[:, 0]])
    if kind == "Dataset":
        return xr.Dataset(
            {n: ("time", x) for n, x in zip(["flow", "valve", "level"], both.T, strict=True)},
            {"time": SECONDS},
        )
    data = xr.DataArray(both, {"time": SECONDS, "signal": ["flow", "valve", "level"]}, ("time", "signal"))
    return data if kind == "DataArray" else data.T


def polars():
    pl = pytest.importorskip("polars")
    return pl.DataFrame({"flow": Y[:, 1], "time": SECONDS, "valve": [0, 1, 2, None, 4, 5], "level": Y[:, 0]})


ORDER = ["flow", "valve", "level"]
TABLES = {
    "pandas": frame,
    "dict": lambda: {"flow": Y[:, 1], "valve": U[:, 0], "level": Y[:, 0]},
    "structured": lambda: np.rec.fromarrays([Y[:, 1], U[:, 0], Y[:, 0]], names=ORDER),
    "polars-like": lambda: Polars({"flow": Y[:, 1], "valve": U[:, 0], "level": Y[:, 0]}),
    "arrow protocol": lambda: Arrow(arrow()),
    "labelled": lambda: Labelled(np.column_stack([Y[:, 1], U[:, 0], Y[:, 0]]), SECONDS, ORDER),
    "labelled, transposed": lambda: Labelled(np.stack([Y[:, 1], U[:, 0], Y[:, 0]]), ORDER, SECONDS),
    "pyarrow": arrow,
    "record batch": lambda: arrow("RecordBatch"),
    "polars": polars,
    "xarray": lambda: xarray("Dataset"),
    "DataArray": lambda: xarray("DataArray"),
    "DataArray, transposed": lambda: xarray("transposed"),
}


class TestNames:
    @pytest.mark.parametrize("kind", TABLES)
    def test_signals_are_taken_by_name_whatever_the_library(self, kind):
        found = Recording.of(MODEL, TABLES[kind]())
        np.testing.assert_array_equal(found.y, Y)
        present = ~np.isnan(found.u)
        np.testing.assert_array_equal(found.u[present], U[present])
        assert (~present).sum() == (kind in ("arrow protocol", "pyarrow", "record batch", "polars")), (
            "a null is a missing sample"
        )

    def test_one_table_may_serve_as_both(self):
        table = frame(SECONDS)
        for given in ((table,), (table, table)):
            np.testing.assert_array_equal(Recording.of(MODEL, *given).u, U)

    def test_a_series_with_a_name_is_taken_by_it(self):
        one = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, outputs=["level"])
        np.testing.assert_array_equal(Recording.of(one, None, frame()["level"]).y, Y[:, :1])
        np.testing.assert_array_equal(Recording.of(one, None, pd.Series(Y[:, 0])).y, Y[:, :1])
        with pytest.raises(ValueError, match="y has no column 'level': it has 'flow'"):
            Recording.of(one, None, frame()["flow"])

    def test_what_has_names_that_are_not_understood_is_refused(self):
        class Lazy:
            columns = ("level", "flow")

        with pytest.raises(
            ValueError,
            match="y is a Lazy of test_recording, whose names are not understood: give a DataFrame of pandas",
        ):
            Recording.of(MODEL, U, Lazy())

    def test_signals_called_u_and_y_are_columns_of_a_table_all_the_same(self):
        model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, inputs=["u"], outputs=["y"])

        class Dataset(dict):
            u, y = np.zeros((1, 9)), np.zeros((1, 9))

        np.testing.assert_array_equal(Recording.of(model, Dataset(u=U[:, 0], y=Y[:, 0])).y, Y[:, :1])

    def test_columns_of_different_lengths_are_refused(self):
        with pytest.raises(
            ValueError, match="the columns of u must have the same number of samples: they have 5 to 6"
        ):
            Recording.of(MODEL, {"valve": U[:5, 0], "level": Y[:, 0], "flow": Y[:, 1]})

    def test_dates_are_no_numbers(self):
        with pytest.raises(ValueError, match="y must be numbers, not times"):
            Recording.of(MODEL, U, frame().assign(flow=SECONDS, level=SECONDS))

    def test_u_alone_is_no_recording(self):
        with pytest.raises(ValueError, match="y is missing: give u and y, or one table or Recording"):
            Recording.of(MODEL, U)

    def test_a_recording_serves_another_model_by_name(self):
        other = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, inputs=["level"], outputs=["valve"])
        again = Recording.of(other, Recording.of(MODEL, U, Y, [3]))
        assert again.starts.tolist() == [3]
        np.testing.assert_array_equal(again.u, Y[:, :1])
        np.testing.assert_array_equal(again.y, U)


class TestMissing:
    @pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64])
    def test_a_masked_sample_is_missing(self, dtype):
        masked = np.ma.masked_values(np.where(Y == 5, -9999, Y).astype(dtype), -9999)
        found = Recording.of(MODEL, np.ma.masked_equal(U, 2.0), masked)
        np.testing.assert_array_equal(np.isnan(found.y), Y == 5)
        np.testing.assert_array_equal(np.isnan(found.u), U == 2)
        assert found.y.dtype == (np.float32 if dtype == np.float32 else np.float64)
        np.testing.assert_array_equal(found.y[Y != 5], Y[Y != 5])

    def test_masked_columns_of_a_dict_are_missing(self):
        given = {"valve": U[:, 0], "level": np.ma.masked_equal(Y[:, 0], 4.0), "flow": Y[:, 1]}
        found = Recording.of(MODEL, given)
        assert np.argwhere(np.isnan(found.y)).tolist() == [[2, 0]] and "1 samples of outputs" in repr(found)


class TestTime:
    @pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
    def test_gaps_of_an_index_of_dates_are_seams(self, zone):
        morning = pd.date_range(
            "2024-03-31", periods=60, freq="5min", tz=zone
        )  # the clock is put forward in between: no seam
        index = morning.append(pd.date_range("2024-04-02", periods=9, freq="5min", tz=zone))
        table = pd.DataFrame({"valve": 0.0, "level": 0.0, "flow": 0.0}, index)
        model = Signals(MODEL.inputs, MODEL.outputs, {}, 300.0)
        assert Recording.of(model, table).starts.tolist() == [60]
        assert Recording.of(model, table.set_axis(index - index[0]), starts=[7]).starts.tolist() == [7, 60]

    @pytest.mark.parametrize(
        "index, seams",
        [
            (pd.Index([0, 1, 2, 7, 8, 9]), [3]),
            (pd.Index([0.0, 1, 2, 3, 4, 9.0]), [5]),
            (pd.Index([0, 1, 2, 0, 1, 2]), [3]),
            (pd.RangeIndex(4, 10), []),
            (pd.Index(list("abcdef")), []),
            (pd.Index(list("aaabbb")), [3]),
            (
                pd.PeriodIndex(SECONDS[[0, 1, 2, 3, 4]].append(SECONDS[-1:] + pd.Timedelta("1h")), freq="s"),
                [5],
            ),
        ],
    )
    def test_an_index_tells_its_gaps(self, index, seams):
        assert starts(index) == seams

    @pytest.mark.parametrize(
        "step, sentence",
        [
            (
                "100s",
                "the model has dt = 1 s, but the rows of the recording are 100 s apart: fit again, "
                "with healthy recordings 100 s apart",
            ),
            ("-1s", "the rows run backwards in time, the newest first: sort them by time"),
        ],
    )
    def test_another_sampling_period_is_refused_as_in_the_shell(self, step, sentence):
        with pytest.raises(ValueError, match=sentence):
            starts(pd.date_range("2024-01-01", periods=6, freq=step))

    def test_dates_that_are_objects_of_python_tell_gaps_too(self):
        late = (SECONDS + pd.to_timedelta([0, 0, 0, 60, 60, 60], "s")).to_pydatetime()
        assert starts(pd.Index(late, dtype=object)) == [3]
        assert Recording.of(MODEL, frame().assign(when=pd.Series(late, dtype=object))).starts.tolist() == [3]

    def test_no_row_is_no_recording_but_no_mistake(self):
        assert Recording.of(MODEL, frame(SECONDS).iloc[:0]).y.shape == (0, 2)

    def test_a_row_without_a_time_is_refused(self):
        with pytest.raises(
            ValueError, match="the index has no time in 1 of 6 rows, the first is row 2: leave them out"
        ):
            starts(SECONDS.where(np.arange(6) != 2))

    def test_times_as_text_are_refused(self):
        with pytest.raises(
            ValueError,
            match="the index holds times as text: turn it into times with pandas.to_datetime first",
        ):
            starts(SECONDS.strftime("%d.%m.%Y %H:%M:%S"))

    @pytest.mark.parametrize(
        "name, convert, sentence",
        [
            ("time", lambda t: t, None),
            ("when", lambda t: t, None),
            ("time", lambda t: (t - t[0]) / pd.Timedelta("1s"), None),
            (
                "time",
                lambda t: t.strftime("%d.%m.%Y %H:%M:%S"),
                "the time column 'time' holds text: turn it into times with pandas",
            ),
            (
                "Beginn",
                lambda t: t.strftime("%d.%m.%Y %H:%M:%S"),
                "the time column 'Beginn' holds text: turn it into times with pandas",
            ),
        ],
    )
    def test_a_time_column_serves_a_table_without_an_index(self, name, convert, sentence):
        late = SECONDS + pd.to_timedelta([0, 0, 0, 60, 60, 60], "s")
        given = Polars({"level": Y[:, 0], "flow": Y[:, 1], "valve": U[:, 0], name: convert(late)})
        if sentence is None:
            assert Recording.of(MODEL, given).starts.tolist() == [3]
        else:
            with pytest.raises(ValueError, match=sentence):
                Recording.of(MODEL, given)

    @pytest.mark.parametrize(
        "clock", [lambda t: t.time, lambda t: t - t.normalize()], ids=["of Python", "differences"]
    )
    @pytest.mark.parametrize("day", [lambda t: t.date, lambda t: t.normalize()], ids=["of Python", "times"])
    def test_a_day_and_a_clock_are_one_time(self, day, clock):
        late = SECONDS + pd.to_timedelta([0, 0, 0, 1, 1, 1], "D")
        r = Recording.of(MODEL, frame().assign(day=day(late), clock=clock(late)))
        assert r.starts.tolist() == [3] and r.index[3] == late[3]

    @pytest.mark.parametrize(
        "model", [MODEL, MODEL.replace(columns={"time": "when"})], ids=["called", "named"]
    )
    def test_days_and_times_of_something_else_are_not_joined(self, model):
        """A day of installation and a running time, beside the time itself or the days of a daily
        recording.
        """
        late = SECONDS + pd.to_timedelta([0, 0, 0, 60, 60, 60], "s")
        other = frame().assign(
            installed=pd.Timestamp("2020-01-01"), runtime=pd.to_timedelta(7 * np.arange(6), "s")
        )
        name = "when" if "time" in model.columns else "time"
        assert Recording.of(model, other.assign(**{name: late})).starts.tolist() == [3]
        daily = pd.date_range("2024-01-01", periods=6, freq="D")
        r = Recording.of(model.replace(dt=86400.0), other.drop(columns="installed").assign(**{name: daily}))
        assert (r.index == daily).all()

    def test_times_of_day_alone_are_refused(self):
        with pytest.raises(
            ValueError,
            match="'clock' holds times without a day, and no column holds the days: add one, or index by "
            "times",
        ):
            Recording.of(MODEL, frame().assign(clock=SECONDS.time))
        with pytest.raises(
            ValueError, match="the columns 'clock', 'a', 'b' hold time stamps: say which is the time"
        ):
            Recording.of(MODEL, frame().assign(clock=SECONDS.time, a=SECONDS.date, b=SECONDS.date))

    def test_a_column_that_is_only_called_like_a_time_is_refused_as_in_a_file(self):
        """Nothing tells it from times of shuffled rows; before, both were ignored."""
        table = frame().assign(T=[20.0, 20.1, 20.1, 20.0, 19.9, 20.0])
        with pytest.raises(
            ValueError, match="the time is taken from 'T': where that is none, rename it or leave it out"
        ):
            Recording.of(MODEL, table)
        assert Recording.of(MODEL, table.set_axis(SECONDS)).index is not None, "an index of dates goes before"

    def test_the_time_column_that_the_model_names_is_checked(self):
        model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, outputs=["level"], columns={"time": "clock"})
        given = {"level": Y[:, 0], "clock": 1.7e9 + np.array([0.0, 1, 2, 3, 60, 61])}
        assert Recording.of(model, given).starts.tolist() == [4]
        with pytest.raises(ValueError, match="the rows of the recording are 100 s apart"):
            Recording.of(model, given | {"clock": np.arange(6) * 100.0})


class TestRows:
    def test_rows_of_two_tables_are_paired_by_their_labels(self):
        u, y = frame(SECONDS)[["valve"]], frame(SECONDS)[["level", "flow"]]
        for found in (
            Recording.of(MODEL, u, y.iloc[[0, 1, 4, 5]]),
            Recording.of(MODEL, u.iloc[[0, 1, 4, 5]], y),
        ):
            np.testing.assert_array_equal(found.u[:, 0], [0, 1, 4, 5])
            np.testing.assert_array_equal(found.y, Y[[0, 1, 4, 5]])
            assert found.starts.tolist() == [2] and found.index.equals(SECONDS[[0, 1, 4, 5]])

    def test_rows_in_another_order_are_those_of_y(self):
        found = Recording.of(MODEL, frame(SECONDS)[["valve"]].iloc[::-1], frame(SECONDS))
        np.testing.assert_array_equal(found.u, U)

    def test_zones_of_one_instant_agree(self):
        u = frame(SECONDS.tz_localize("UTC")).iloc[:4]
        found = Recording.of(MODEL, u, frame(SECONDS.tz_localize("UTC").tz_convert("Asia/Tokyo")))
        np.testing.assert_array_equal(found.u[:, 0], found.y[:, 0] / 2)
        assert len(found.u) == 4

    @pytest.mark.parametrize(
        "u, y, sentence",
        [
            (
                SECONDS + pd.Timedelta("1s"),
                SECONDS,
                "different rows: 2024-01-01 00:00:06 is in the index of u only, 2024-01-01 00",
            ),
            (
                SECONDS,
                SECONDS.tz_localize("UTC"),
                "u and y have different rows: 2024-01-01 00:00:00 is in the index of u only",
            ),
            (
                SECONDS,
                None,
                "different rows: .* is in the index of u only, 0 in that of y only: .*give arrays to pair "
                "them one by one",
            ),
            (
                SECONDS[[0, 1, 1, 2, 3, 4]],
                SECONDS,
                "u and y have different indexes, and 2024-01-01 00:00:01 is twice in that of u",
            ),
        ],
    )
    def test_rows_that_do_not_belong_together_are_refused(self, u, y, sentence):
        with pytest.raises(ValueError, match=sentence):
            Recording.of(MODEL, frame(u), frame(y))

    def test_labels_that_tell_no_time_leave_a_seam_where_rows_were_left_out(self):
        u, y = frame(list("abcdef")), frame(list("abcdef")).iloc[[0, 1, 3, 4]]
        assert Recording.of(MODEL, u, y).starts.tolist() == [2]

    def test_two_tables_without_labels_are_paired_by_their_times(self):
        later = SECONDS + pd.Timedelta("2s")
        u, y = (
            Polars({"time": SECONDS, "valve": U[:, 0]}),
            {"time": later[:4], "level": Y[2:, 0], "flow": Y[2:, 1]},
        )
        found = Recording.of(MODEL, u, {k: x[:4] for k, x in y.items()})
        np.testing.assert_array_equal(found.u[:, 0], [2, 3, 4, 5])
        assert (
            Recording.of(
                MODEL,
                Polars({"valve": U[:, 0]}),
                Polars({"level": Y[:, 0], "flow": Y[:, 1], "time": SECONDS}),
            ).dt
            == 1
        )

    def test_more_rows_without_labels_are_refused(self):
        with pytest.raises(ValueError, match="the same number of samples: 6 and 5"):
            Recording.of(MODEL, frame(), frame().iloc[:5])


def test_arrays_are_not_copied():
    found = Recording.of(MODEL, U, Y)
    assert found.u is U and found.y is Y
