"""The time of the rows of a table: whatever holds it, rows that do not follow each other are never taken for
rows that do.
"""

import datetime
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import Signals

T = 24
MODEL = jb.LinearSystem([["0.5"]], [[1]], [[1]], noise="0.01", dt=3, inputs="u", outputs="T1")
DATES = pd.Timestamp("2024-01-01 08:00") + pd.to_timedelta(3 * np.arange(T), "s")
COUNTS = 3 * np.arange(T)
objects = lambda items: pd.Series(list(items), dtype=object)
arrow = lambda: pd.Series(DATES).astype(pd.ArrowDtype(pytest.importorskip("pyarrow").timestamp("us")))
TIMES = {
    "dates": ("when", lambda: DATES),
    "dates of a zone": ("when", lambda: DATES.tz_localize("Europe/Berlin")),
    "seconds": ("Time (s)", lambda: COUNTS.astype(float)),
    "whole seconds": ("time", lambda: COUNTS),
    "epoch in ms": ("timestamp", lambda: 1_700_000_000_000 + 1000 * COUNTS),
    "numbers as text": ("Time (s)", lambda: [str(k) for k in COUNTS]),
    "decimal commas": ("Zeit", lambda: [f"{k},0" for k in COUNTS]),
    "categories of dates": ("when", lambda: pd.Series(pd.Categorical(DATES))),
    "categories of numbers": ("time", lambda: pd.Series(pd.Categorical(COUNTS))),
    "numbers as objects": ("time", lambda: objects(map(int, COUNTS))),
    "decimals": ("time", lambda: objects(Decimal(int(k)) for k in COUNTS)),
    "numbers that may be null": ("time", lambda: pd.Series(COUNTS, dtype="Int64")),
    "dates of Python": ("when", lambda: objects(DATES.to_pydatetime())),
    "dates of Arrow": ("when", arrow),
    "time spans": ("elapsed", lambda: pd.to_timedelta(COUNTS, "s")),
    "time spans of Python": ("time", lambda: objects(datetime.timedelta(seconds=int(k)) for k in COUNTS)),
    "dates of NumPy": ("when", lambda: objects(DATES.to_numpy("datetime64[s]"))),
    "time spans of NumPy": ("time", lambda: objects(COUNTS.astype("timedelta64[s]"))),
    "numbers as bytes": ("Time (s)", lambda: objects(str(k).encode() for k in COUNTS)),
    "periods": ("when", lambda: pd.PeriodIndex(DATES, freq="s")),
    "digits": ("time", lambda: DATES.strftime("%Y%m%d%H%M%S").astype(int)),
}
COUNTING = (
    "whole seconds",
    "epoch in ms",
    "numbers as text",
    "numbers as bytes",
    "categories of numbers",
    "numbers as objects",
    "numbers that may be null",
    "digits",
)
"""What an index without a name would count the samples by."""
LABELS = {
    "range": lambda: pd.RangeIndex(T),
    "whole numbers": lambda: pd.Index(np.arange(T) + 7),
    "whole numbers as objects": lambda: pd.Index(list(range(T)), dtype=object),
    "numbers as text": lambda: pd.Index([str(k) for k in range(T)]),
    "categories": lambda: pd.CategoricalIndex(range(T)),
    "categories of text": lambda: pd.CategoricalIndex([str(k) for k in range(T)]),
    "intervals": lambda: pd.IntervalIndex.from_breaks(pd.date_range("2024-01-01", periods=T + 1, freq="3s")),
}
ROWS = {
    "all": np.arange(T),
    "behind the first": np.arange(5, T),
    "gap": np.r_[0:9, 15:T],
    "every second": np.arange(0, T, 2),
    "reversed": np.arange(T)[::-1],
    "shuffled": np.random.default_rng(5).permutation(T),
    "some left out": np.delete(np.arange(T), [2, 3, 8, 16]),
}


def signals():
    return pd.DataFrame({"u": np.arange(T) / 7, "T1": np.arange(T) / 3})


def timed(kind):
    name, times = TIMES[kind]
    times = times()
    return signals().assign(**{name: times if isinstance(times, pd.Series) else pd.Series(times)})


def refuse_joined(rows, *given, model=MODEL, understood=True):
    """Fail where rows that are not neighbours are taken to follow each other, or where a regular recording is
    refused.
    """
    apart = np.flatnonzero(np.diff(rows) != 1) + 1
    try:
        found = Recording.of(model, *given)
    except ValueError:
        assert len(apart) > len(rows) / 2 or not understood, "refused, though its rows are regular"
        return
    assert found.samples == len(rows)
    assert set(apart) <= set(found.starts.tolist()), "rows are joined that do not follow each other"
    assert set(found.starts.tolist()) == set(apart), "rows are cut that follow each other"


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("kind", TIMES)
def test_a_column_or_an_index_of_times_tells_which_rows_follow_each_other(kind, rows):
    table, name = timed(kind), TIMES[kind][0]
    part = table.iloc[ROWS[rows]]
    forms = {
        "column": part,
        "numbered anew": part.reset_index(drop=True),
        "named index": part.set_index(name),
        "labelled": part.set_axis([f"row {k}" for k in ROWS[rows]]),
    }
    for form in forms.values():
        refuse_joined(ROWS[rows], form)
        refuse_joined(ROWS[rows], form, model=Signals(("u",), ("T1",), {"time": name}, 3.0))
    refuse_joined(ROWS[rows], part.set_index(name).rename_axis(None), understood=kind not in COUNTING)


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("kind", LABELS)
def test_an_index_of_numbers_alone_tells_it_in_whatever_form(kind, rows):
    refuse_joined(ROWS[rows], signals().set_axis(LABELS[kind]()).iloc[ROWS[rows]])


@pytest.mark.parametrize("rows", ROWS)
@pytest.mark.parametrize("kind", ["dates", "seconds", "whole seconds"])
def test_two_tables_are_told_by_the_time_of_either(kind, rows):
    name = TIMES[kind][0]
    for whole in (timed(kind), timed(kind).set_index(name)):
        part, time = whole.iloc[ROWS[rows]], [c for c in whole if c == name]
        u, y, plain_u, plain_y = part[["u", *time]], part[["T1", *time]], part[["u"]], part[["T1"]]
        for given in (
            (u, y),
            (u, plain_y),
            (plain_u, y),
            (u, plain_y.to_numpy()),
            (part["u"], part["T1"]),
            (whole[["u", *time]], y),
        ):
            refuse_joined(ROWS[rows], *given)


class TestRefused:
    @pytest.mark.parametrize(
        "table, sentence",
        [
            (
                lambda: timed("seconds").iloc[::2],
                "the model has dt = 3 s, but the rows .* 6 s apart: .*; the time is taken from 'Time .s.'",
            ),
            (lambda: timed("dates").iloc[::-1], "the rows run backwards in time, the newest first"),
            (
                lambda: signals().iloc[::2],
                "the index counts in steps of 2, as if rows were left out. If these are seconds, call",
            ),
            (
                lambda: signals().iloc[::3],
                "the index counts in steps of 3, as if rows were left out",
            ),  # dt, but not of this index
            (
                lambda: signals().set_axis(DATES.time),
                "the index holds times without a day: add the days, or leave it out with",
            ),
            (
                lambda: signals().assign(time=DATES.time),
                "the time column 'time' holds times without a day, and no column holds the days",
            ),
            (
                lambda: signals().assign(time=np.where(np.arange(T) == 4, np.nan, COUNTS)),
                "no time in 1 of 24 rows, the first is row 4",
            ),
            (
                lambda: signals().set_axis([*map(str, range(T - 1)), "end"]),
                "the index holds numbers and other labels: give the times of the",
            ),
            (
                lambda: signals().set_axis(pd.Index([str(t).encode() for t in DATES], dtype=object)),
                "the index holds times as text: turn it into times with pandas.to_datetime first",
            ),
            (
                lambda: signals().set_axis(
                    pd.Index([DATES[k].timetuple()[:6] for k in range(T)], tupleize_cols=False)
                ),
                "the index holds labels of type tuple, of which none tells a time: turn them into times",
            ),
            (
                lambda: signals().assign(day=DATES.date, clock=DATES.strftime("%H:%M:%S")),
                "the column 'clock' holds text: turn it into times with pandas.to_timedelta first",
            ),
            (
                lambda: signals().assign(day=DATES.strftime("%Y-%m-%d"), clock=DATES.time),
                "the column 'day' holds text: turn it into times with pandas.to_datetime first",
            ),
            (
                lambda: signals().assign(T1=pd.Series([10**400] * T, dtype=object)),
                "column 'T1' holds a number that is too large to compute with",
            ),
            (
                lambda: signals().assign(time=pd.Series([10**400 + k for k in range(T)], dtype=object)),
                "the index holds a number that is too large to compute with",
            ),
            (
                lambda: signals().set_axis(DATES.as_unit("s") + np.timedelta64(500 * 365, "D")),
                "the index has the time 2523-.*: only the years 1678 to 2261 can be told",
            ),
            (
                lambda: [signals(), signals()],
                "u is a list of 2, the first a DataFrame of pandas: give one recording at a time",
            ),
        ],
    )
    def test_what_does_not_fit_is_refused_in_a_sentence(self, table, sentence):
        with pytest.raises(ValueError, match=sentence):
            jb.detect(jb.parity_relations(MODEL), table())

    def test_what_takes_no_path_says_who_reads_it(self):
        sentence = r"u is the text 'run.csv': a file is read first, with jaxbound.read\('run.csv', model\)"
        with pytest.raises(ValueError, match=sentence):
            jb.Recording.of(MODEL, "run.csv")

    def test_what_a_file_refuses_a_table_refuses(self, tmp_path):
        for rows in ("every second", "reversed", "shuffled"):
            table = timed("seconds").iloc[ROWS[rows]]
            table.to_csv(tmp_path / "run.csv", index=False)
            for door in (
                lambda: jb.read(tmp_path / "run.csv", MODEL),
                lambda table=table: Recording.of(MODEL, table),
            ):
                with pytest.raises(ValueError, match="apart|backwards|go back in time"):
                    door()

    def test_columns_of_one_name_do_not_hide_the_time(self):
        table = timed("seconds").assign(a=1, b=2).set_axis(["u", "T1", "Time (s)", "note", "note"], axis=1)
        refuse_joined(ROWS["gap"], table.iloc[ROWS["gap"]].reset_index(drop=True))
        with pytest.raises(ValueError, match="2 columns are called 'Time .s.'"):
            Recording.of(
                MODEL, table.assign(x=1).set_axis([*table.columns[:3], "note", "note", "Time (s)"], axis=1)
            )

    def test_a_time_that_is_index_and_column_is_one(self):
        refuse_joined(ROWS["gap"], timed("whole seconds").set_index("time", drop=False).iloc[ROWS["gap"]])


class TestUnits:
    def unit(self, begin):
        return signals().set_axis(pd.date_range(begin, periods=T, freq="3s", name="time"))

    def test_rows_of_several_units_are_refused(self):
        both = pd.concat(
            {"a": self.unit("2024-01-01"), "b": self.unit("2024-01-01 00:01:12")}, names=["unit"]
        )
        for table in (both, both.swaplevel(), both["T1"]):
            with pytest.raises(
                ValueError,
                match="the index has the levels .*: a recording is one sequence of samples; give one unit at "
                "a",
            ):
                Recording.of(MODEL, signals()["u"].to_numpy(), table) if table.ndim == 1 else Recording.of(
                    MODEL, table
                )

    @pytest.mark.parametrize("rows", ROWS)
    def test_one_unit_is_told_by_its_time(self, rows):
        one = pd.concat({"a": self.unit("2024-01-01")}, names=["unit"])
        refuse_joined(ROWS[rows], one.iloc[ROWS[rows]])

    def test_where_labels_repeat_those_of_one_follow_each_other(self):
        labels = np.repeat(["a", "b"], T // 2)
        for index in (labels, pd.CategoricalIndex(labels)):
            assert Recording.of(MODEL, signals().set_axis(index)).starts.tolist() == [T // 2]


class TestOthers:
    @pytest.mark.parametrize("rows", ["gap", "reversed"])
    def test_coordinates_beside_a_dimension_tell_the_time(self, rows):
        xr = pytest.importorskip("xarray")
        part = signals().iloc[ROWS[rows]]
        array = xr.DataArray(
            part[["T1", "u"]].to_numpy(),
            {"time": ("sample", DATES[ROWS[rows]]), "signal": ["T1", "u"]},
            ("sample", "signal"),
        )
        for given in (
            (array,),
            (array.T,),
            (array.sel(signal="u", drop=True).rename("u"), array.sel(signal="T1", drop=True).rename("T1")),
        ):
            refuse_joined(ROWS[rows], *given)

    @pytest.mark.parametrize("rows", ["gap", "every second"])
    def test_tables_in_a_pair_are_read_as_tables(self, rows):
        class Pair:
            u, y = (
                timed("dates").iloc[ROWS[rows]][["u", "when"]],
                timed("dates").iloc[ROWS[rows]][["T1", "when"]],
            )

        refuse_joined(ROWS[rows], Pair())

    @pytest.mark.parametrize("rows", ["gap", "every second", "shuffled"])
    def test_arrow_tables_of_any_time(self, rows):
        pa = pytest.importorskip("pyarrow")
        part = signals().iloc[ROWS[rows]]
        seconds = COUNTS[ROWS[rows]]
        kinds = [
            pa.array(seconds, pa.timestamp("s")),
            pa.array(seconds * 1.0),
            pa.array(list(map(str, seconds))).dictionary_encode(),
            pa.array([Decimal(int(s)) for s in seconds]),
        ]
        for time in kinds:
            refuse_joined(
                ROWS[rows], pa.table({"u": part["u"].to_numpy(), "T1": part["T1"].to_numpy(), "time": time})
            )
