"""Every verb on one healthy recording with a gap, an excluded stretch, a missing sample and shuffled columns,
in whatever a user holds it.

The gap is a jump of the plant, the excluded stretch nonsense: a verb that forgets one, or takes a column by
position, finds a fault.
"""

import tempfile
from functools import cache

import jax
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording

T, GAP, OFF, LOST = 40, 14, slice(22, 27), (33, 1)
STARTS = [GAP, OFF.start, OFF.stop]
PIECES = [slice(0, GAP), slice(GAP, OFF.start), slice(OFF.stop, T)]
TIME = pd.date_range("2024-01-01", periods=T, freq="s") + pd.to_timedelta(
    np.where(np.arange(T) < GAP, 0, 3600), "s"
)
KINDS = (
    "pandas",
    "two frames",
    "polars-like",
    "pyarrow",
    "dict",
    "masked",
    "recording",
    "jb.read of a CSV",
    "jb.read of Parquet",
)
PLANT = dict(
    A=[[0.8, 0.5], [0, 0.2]],
    B=[[0], [1]],
    C=[[1, 0], [0, 1]],
    noise=[0.1, 0.1],
    inputs=["valve"],
    outputs=["level", "flow"],
)
WHERE = {"where": "mode == 'on'"}
MISSING = np.isin(
    np.arange(T), [0, *range(OFF.start, OFF.stop), *STARTS]
)  # windows of two samples that are none


def plant(**changes):
    return jb.LinearSystem(**PLANT | {"columns": WHERE} | changes)


def course(v=None):
    """Return healthy u, x, y: the plant is elsewhere after the gap, and its sensors show anything in the
    excluded stretch.
    """
    rng = np.random.default_rng(1)
    u, x = np.repeat(rng.uniform(-3, 3, (T // 4, 1)), 4, 0), np.zeros((T + 1, 2))
    for k in range(T):
        if k in (GAP, OFF.stop):
            x[k] = rng.uniform(20, 40, 2)
        x[k + 1] = np.array(PLANT["A"], float) @ x[k] + [v[k] if v is not None else 0, u[k, 0]]
    y = x[:-1] + rng.uniform(-0.09, 0.09, (T, 2))
    y[OFF] = 1e3 * rng.normal(size=y[OFF].shape)
    return u, x[:-1], y


class Polars:
    """What jaxbound sees of a polars.DataFrame."""

    def __init__(self, frame):
        self._frame = frame.reset_index()

    columns = property(lambda self: list(self._frame.columns))

    def to_pandas(self):
        return self._frame


def held(kind, u, y):
    """Return what a user passes: (u, y, starts) or one table."""
    lost = y.copy()
    lost[LOST] = np.nan
    mode = np.where(np.isin(np.arange(T), np.arange(OFF.start, OFF.stop)), "off", "on")
    frame = pd.DataFrame(
        {"flow": lost[:, 1], "mode": mode, "valve": u[:, 0], "level": lost[:, 0]}, TIME.rename("time")
    )
    if kind == "masked":
        off = np.zeros((T, 1), bool)
        off[OFF] = True
        y = np.where(np.isnan(lost), -9999, lost)
        return np.ma.array(u, mask=off), np.ma.array(y, mask=off | (y == -9999)), STARTS
    if kind == "recording":
        return Recording.of(plant(), frame), None, ()
    if kind.startswith("jb.read"):
        return stored(kind, frame), None, ()
    if kind == "pyarrow":
        import pyarrow as pa

        return pa.Table.from_pandas(frame.reset_index()), None, ()
    if kind == "two frames":
        return frame[["valve"]].iloc[::-1], frame[["mode", "flow", "level"]], ()
    one = {"pandas": frame, "polars-like": Polars(frame), "dict": frame.reset_index().to_dict("list")}[kind]
    if kind == "dict":
        one["time"] = pd.DatetimeIndex(one["time"])
    return one, None, ()


def stored(kind, frame):
    """Return what `jb.read` makes of a file that holds a table, its dates in a column."""
    with tempfile.TemporaryDirectory() as folder:
        if kind.endswith("CSV"):
            frame.to_csv(path := f"{folder}/run.csv")
        else:
            frame.reset_index().to_parquet(path := f"{folder}/run.parquet")
        return jb.read(path, plant())


@pytest.fixture(params=KINDS)
def given(request):
    u, _, y = course()
    return held(request.param, u, y)


def clean(u, y):
    """Return (u, y, starts) as plain arrays that say the same."""
    u, y = u.copy(), y.copy()
    u[OFF], y[OFF], y[LOST] = np.nan, np.nan, np.nan
    return u, y, STARTS


@cache
def apart(verdicts):
    """Return what a function of (u, y) gives for the clean pieces, MISSING or NaN between them."""
    u, y, _ = clean(*course()[::2])
    found = [verdicts(u[p], y[p]) for p in PIECES]
    nothing = np.full(
        (OFF.stop - OFF.start, *found[0].shape[1:]),
        0 if found[0].dtype.kind in "iu" else np.nan,
        found[0].dtype,
    )
    return np.concatenate([found[0], found[1], nothing, found[2]])


def status_of(u, y):
    return jb.detect(jb.parity_relations(plant(), 1), u, y).status


def margin_of(u, y):
    return jb.detect(jb.parity_relations(plant(), 1), u, y).margin


def margins_of(u, y):
    return np.asarray(jb.margins(jb.parity_relations(plant(), 1), u, y))


def violated_of(u, y):
    return jb.detect(jb.structured_relations(plant()), u, y).violated.astype(np.int8)


def test_detect(given):
    u, y, starts = given
    r = jb.parity_relations(plant(), 1)
    res = jb.detect(r, u, y, starts=starts)
    np.testing.assert_array_equal(res.status, apart(status_of))
    np.testing.assert_array_equal(res.margin, apart(margin_of))
    assert res.counts["FAULT"] == 0 and (res.status[~MISSING] != 0).all() and (res.status[MISSING] == 0).all()


def test_margins(given):
    u, y, starts = given
    r = jb.parity_relations(plant(), 1)
    found = np.asarray(jb.margins(r, u, y, starts=starts))
    np.testing.assert_array_equal(found, apart(margins_of))
    assert np.nanmin(found) > 0


def test_the_forms_of_a_relation(given):
    u, y, starts = given
    r = jb.parity_relations(plant(), 1)
    outside, inside = np.asarray(r.external(u, y, starts)), r.internal(u, y, starts)
    plain = np.where(MISSING[:, None], np.nan, r.external(*clean(*course()[::2])[:2]))
    np.testing.assert_array_equal(outside, plain)
    known = ~np.isnan(outside)
    assert (
        known.sum() > 50
        and ((np.asarray(inside.lo) <= outside) & (outside <= np.asarray(inside.hi)))[known].all()
    )


def test_a_bank(given):
    u, y, starts = given
    bank = jb.structured_relations(plant())
    res = jb.detect(bank, u, y, starts=starts)
    np.testing.assert_array_equal(res.violated, apart(violated_of).astype(bool))
    assert res.counts["FAULT"] == 0


@pytest.fixture(scope="module")
def own():
    """Return a residual, one for all ways of holding a recording: it compiles once."""
    f = lambda z, u, y: y[1, 1] - z[1] - 0.2 * (y[0, 1] - z[0]) - u[0, 0]
    return jb.residual(
        f, jb.interval([-0.1, -0.1], [0.1, 0.1]), 1, inputs=["valve"], outputs=["level", "flow"]
    )


@pytest.mark.parametrize("kind", ["two frames", "masked", "jb.read of a CSV", "jb.read of Parquet"])
def test_a_residual(kind, own):
    r, (u, y, starts) = own, held(kind, *course()[::2])
    shown = Recording.of(plant(), u, y, starts)  # a residual has no `where`
    res = jb.detect(r, shown)
    u, y, starts = clean(*course()[::2])
    np.testing.assert_array_equal(res.status, np.where(MISSING, 0, jb.detect(r, u, y).status))
    assert res.counts["FAULT"] == 0 and res.counts["CONSISTENT"] > 20
    np.testing.assert_array_equal(np.isnan(np.asarray(r.external(shown))).any(-1), res.status == 0)


@pytest.mark.parametrize("size", [1, 9, T])
def test_a_monitor_in_pieces_of_any_size(given, size):
    u, y, starts = given
    r = jb.parity_relations(plant(), 1)
    if hasattr(u, "to_pandas"):
        u = u.to_pandas().set_index("time")
    elif isinstance(u, dict):
        u = pd.DataFrame(u).set_index("time")
    monitor, status = jb.Monitor(r), []
    state = monitor.init()
    if hasattr(u, "outputs"):
        cut = lambda k: (u.cut(k, k + size), None)
    elif y is None:
        cut = lambda k: (u.iloc[k : k + size], None)
    elif hasattr(y, "iloc"):
        cut = lambda k: (u.sort_index().iloc[k : k + size], y.iloc[k : k + size])
    else:
        cut = lambda k: (u[k : k + size], y[k : k + size])
    for k in range(0, T, size):
        state, verdict = monitor.run(state, *cut(k), starts=[s - k for s in starts if k <= s < k + size])
        status.append(verdict.status)
    np.testing.assert_array_equal(np.concatenate(status), apart(status_of))


def test_a_monitor_takes_rows_by_name_and_by_their_time():
    u, _, y = course()
    r = jb.parity_relations(plant(), 1)
    table, monitor, status = held("pandas", u, y)[0], jb.Monitor(r), []
    state = monitor.init()
    for k in range(T):
        row = table.iloc[k]
        state, verdict = monitor.step(state, row, row if k % 2 else None)
        status.append(verdict.status)
    np.testing.assert_array_equal(status, jb.detect(r, table).status)
    state, verdict = monitor.step(monitor.init(), {"valve": 0.0}, {"flow": 2.0, "mode": "on", "level": 1.0})
    np.testing.assert_array_equal(state.y, [[1.0, 2.0]])


@pytest.mark.parametrize(
    "index", [pd.RangeIndex(T), pd.Index(np.arange(T) / 10), TIME - TIME[0], TIME.tz_localize("UTC")]
)
def test_a_monitor_sees_rows_that_are_left_out_between_two_calls(index):
    u, _, y = course()
    r = jb.parity_relations(plant(dt=0.1) if index.dtype == float else plant(), 1)
    table = held("pandas", u, y)[0].set_axis(index)
    monitor = jb.Monitor(r)
    state, status = monitor.init(), []
    for rows in (slice(0, 5), slice(5, 9), slice(11, 14), slice(14, 22), slice(27, T)):
        state, verdict = monitor.run(state, table.iloc[rows])
        status.append(verdict.status)
    missing = np.flatnonzero(np.concatenate(status) == jb.Status.MISSING).tolist()
    assert missing == [0, 9, *([12] if isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)) else []), 20]


@pytest.mark.parametrize("kind", KINDS)
def test_unknown_inputs(kind):
    v = np.random.default_rng(2).normal(size=T)
    u, _, y = course(v)
    model = plant(unknown_inputs=[[1], [0]])
    found = jb.unknown_inputs(model, *held(kind, u, y)[:2], starts=held(kind, u, y)[2], horizon=1).values
    lo, hi = np.asarray(found.lo)[:, 0], np.asarray(found.hi)[:, 0]
    inside = np.delete(np.arange(T), OFF)
    assert ((lo <= v) & (v <= hi))[inside].all()
    assert (
        np.isinf(lo[[GAP - 1, *range(OFF.start - 1, OFF.stop), T - 1]]).all()
        and np.isfinite(lo[: LOST[0] - 1]).sum() > 20
    )


def test_validate(given):
    u, y, starts = given
    _, x, _ = course()
    found = jb.validate(plant(), u, y, horizon=2, method="sequential", starts=starts)
    state, status = found.state, np.asarray(found.status)
    inside = ((np.asarray(state.lo) <= x) & (x <= np.asarray(state.hi))).all(-1)
    assert inside[np.delete(np.arange(T), OFF)].all() and not np.asarray(found.faulty).any()
    begin = np.isin(np.arange(T), [0, 1, GAP, GAP + 1, *range(OFF.start, OFF.stop), OFF.stop, OFF.stop + 1])
    np.testing.assert_array_equal(status == jb.Status.MISSING, begin)
    assert (status != jb.Status.FAULT).all() and np.isfinite(np.asarray(state.lo)[~begin]).all()


@cache
def tuned():
    """Return how much narrower bounds the clean recording allows."""
    return jb.tune(jb.parity_relations(plant(), 1), clean(*course()[::2]), steps=0).scale


def test_tune(given):
    healthy = given if given[1] is not None else given[0]
    assert jb.tune(jb.parity_relations(plant(), 1), healthy, steps=0).scale == tuned() <= 1


@pytest.mark.parametrize(
    "kind", ["pandas", "polars-like", "masked", "recording", "jb.read of a CSV", "jb.read of Parquet"]
)
def test_fit(kind):
    u, _, y = course()
    given = held(kind, u, y)
    options = dict(
        order=1, horizon=2, inputs=["valve"], outputs=["level", "flow"], held_out=0, method="least squares"
    )
    model = jb.fit(given if given[1] is not None else given[0], **options, columns=WHERE)
    plain = jb.fit(clean(u, y), **options)
    assert (
        model.A == plain.A
        and model.noise == plain.noise
        and max(map(float, plain.noise)) < 1
        and model.dt == 1
    )


FITTED = dict(
    order=1, horizon=2, inputs=["valve"], outputs=["level", "flow"], held_out=0, method="least squares"
)
GAIN = [jb.Uncertainty("gain", B=[[0], [0.05]])]
VERBS = {
    "detect": lambda table: jb.detect(jb.parity_relations(plant(), 1), table),
    "a bank": lambda table: jb.detect(jb.structured_relations(plant()), table),
    "margins": lambda table: jb.margins(jb.parity_relations(plant(), 1), table),
    "external": lambda table: jb.parity_relations(plant(), 1).external(table),
    "a residual": lambda table: jb.detect(
        jb.residual(
            lambda z, u, y: y[1, 1] - z[0], jb.interval([-1e9], [1e9]), 1, ["valve"], ["level", "flow"]
        ),
        table,
    ),
    "validate": lambda table: jb.validate(plant(), table, horizon=2, method="sequential"),
    "observe": lambda table: jb.observe(plant(), table),
    "unknown_inputs": lambda table: jb.unknown_inputs(plant(unknown_inputs=[[1], [0]]), table, horizon=1),
    "tune": lambda table: jb.tune(jb.parity_relations(plant(), 1), table, steps=0),
    "fit, of a model": lambda table: jb.fit(table, add=plant(), most=1e9),
    "fit": lambda table: jb.fit(table, **FITTED, dt=1.0),
    "a source": lambda table: open_source(table, plant()).read(),
}


SENTENCE = (
    r"^(recording( 1)?: )?(the (rows|recording|model|index) |\d+ of \d+ rows go back|you gave dt = 1 s, but)"
)


@pytest.mark.parametrize("rows", ["every second", "reversed", "shuffled"])
@pytest.mark.parametrize("verb", VERBS)
def test_rows_that_do_not_follow_each_other_are_refused(verb, rows):
    """A column of times beside an index of row numbers: they were taken to be a sampling period apart."""
    if verb == "a residual":
        rows = "shuffled"  # it states no period
    u, _, y = course()
    table = pd.DataFrame(
        {"valve": u[:, 0], "level": y[:, 0], "flow": y[:, 1], "Time (s)": np.arange(T) * 1.0, "mode": "on"}
    )
    at = {
        "every second": slice(None, None, 2),
        "reversed": slice(None, None, -1),
        "shuffled": np.random.default_rng(1).permutation(T),
    }
    with pytest.raises(ValueError, match=SENTENCE):
        VERBS[verb](table.iloc[at[rows]])
    with pytest.raises(ValueError, match=SENTENCE):
        VERBS[verb](table.drop(columns="Time (s)").iloc[at[rows]])


@pytest.mark.parametrize(
    "rows", [slice(None, None, 2), slice(None, None, -1), np.random.default_rng(1).permutation(T)]
)
@pytest.mark.parametrize("size", [1, 2, 5, T])
def test_a_monitor_joins_no_rows_that_do_not_follow_each_other(rows, size):
    u, _, y = course()
    table = pd.DataFrame(
        {"valve": u[:, 0], "level": y[:, 0], "flow": y[:, 1], "Time (s)": np.arange(T) * 1.0, "mode": "on"}
    )
    monitor = jb.Monitor(jb.parity_relations(plant(), 1))
    for part in (
        table.iloc[rows],
        table.drop(columns="Time (s)").iloc[rows],
        table.drop(columns="Time (s)").set_index(TIME).iloc[rows],
    ):
        state, joined = monitor.init(), 0
        for k in range(0, len(part), size):
            state, verdict = monitor.run(state, part.iloc[k : k + size])
            joined += int((verdict.status != jb.Status.MISSING).sum())
        assert joined <= np.count_nonzero(np.diff(np.arange(T)[rows]) == 1)


def test_simulate_takes_inputs_by_name():
    u, _, _ = course()
    model = plant(inputs=["valve", "heat"], B=[[0, 1], [1, 0]])
    both = np.concatenate([u, 2 * u], 1)
    table = pd.DataFrame({"heat": both[:, 1], "valve": both[:, 0]})
    key = jax.random.key(0)
    np.testing.assert_array_equal(jb.simulate(model, table, key).u, both)


def test_a_study_takes_inputs_by_name():
    u, _, _ = course()
    model = plant(inputs=["valve", "heat"], B=[[0, 1], [1, 0]])
    both = np.concatenate([u, 2 * u], 1)
    table = pd.DataFrame({"heat": both[:, 1], "valve": both[:, 0]})
    counts = [jb.study(model, (), 8, 0, samples=T, inputs=x).settings["inputs"] for x in (table, both)]
    assert counts[0] == counts[1]


def test_evaluate_takes_residuals_by_name_and_a_mask_for_missing():
    values = np.array([[0.1, 5.0], [0.2, 0.3], [9.0, 9.0]])
    hull, table = pd.Series({"b": 1.0, "a": 10.0}), pd.DataFrame({"f": [0, 1], "g": [1, 1]}, index=["a", "b"])
    named = pd.DataFrame({"b": values[:, 0], "a": values[:, 1]})
    res = jb.evaluate(named, hull, table)
    np.testing.assert_array_equal(res.status, [1, 1, 3])
    assert res.names(2) == ("f", "g") and res.index is named.index
    masked = np.ma.array(values, mask=values == 9.0)
    np.testing.assert_array_equal(jb.evaluate(masked, [1.0, 10.0], [[1, 0], [1, 1]]).status, [1, 1, 0])
    with pytest.raises(ValueError, match="the hull has no column 'b'"):
        jb.evaluate(named, pd.Series({"a": 1.0, "c": 1.0}), table)


def test_an_operating_range_is_taken_by_name():
    model = plant(tolerance=[0.01, 0.2])
    one = jb.detectable(model, "level", 1, operating_range={"flow": 1.0, "level": 50.0})
    assert (
        one
        == jb.detectable(model, "level", 1, operating_range=[50.0, 1.0])
        == jb.detectable(model, "level", 1, operating_range=pd.Series({"flow": 1.0, "level": 50.0}))
    )
    with pytest.raises(ValueError, match="operating_range has no column 'flow'"):
        jb.detectable(model, "level", 1, operating_range={"level": 50.0})
