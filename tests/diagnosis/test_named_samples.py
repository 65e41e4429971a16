"""Samples are named by their number or by their time, and alarms know both."""

import datetime
import math

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb

T = 40
MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, dt=20)
START = "2026-01-01"
INDEXES = {
    "dates": pd.date_range(START, periods=T, freq="20s"),
    "dates of a zone": pd.date_range(START, periods=T, freq="20s", tz="Europe/Berlin"),
    "numpy": np.datetime64(START, "ns") + np.arange(T) * np.timedelta64(20, "s"),
    "spans": pd.timedelta_range(0, periods=T, freq="20s"),
    "seconds": np.arange(T) * 20.0 + 100,
}


def judged(index=None, relations=None):
    """Return the Result of a bias of 2 from sample 10 to 13."""
    y = np.zeros((T, 1))
    y[10:14] = 2.0
    if index is None:
        return jb.detect(relations or jb.parity_relations(MODEL, 2), np.zeros((T, 1)), y)
    table = pd.DataFrame(np.hstack([np.zeros((T, 1)), y]), columns=["u1", "y1"], index=index)
    return jb.detect(relations or jb.parity_relations(MODEL, 2), table)


@pytest.fixture(scope="module")
def results():
    return {name: judged(index) for name, index in INDEXES.items()}


def test_an_alarm_knows_its_times_as_the_index_has_them(results):
    for name, index in INDEXES.items():
        alarm = results[name].alarms()[0]
        assert alarm.times == (index[alarm.start], index[alarm.end]), name
        first, last = (str(x).replace("T", " ").removesuffix(".000000000") for x in alarm.times)
        assert f"times='{first} to {last}'" in repr(alarm), name


def test_an_alarm_prints_what_it_knows_and_nothing_else():
    """No NaN, no empty name, no number with sixteen digits."""
    plain, named = judged().alarms()[0], judged().alarms(rule=jb.AlarmRule(suspects=True))[0]
    assert plain.times == () and "times" not in repr(plain)
    for alarm in (plain, named):
        assert not any(word in repr(alarm) for word in ("nan", "''", "()", "None", "np."))
        assert alarm.ended in repr(alarm) and "<td>None</td>" not in alarm._repr_html_()
    assert f"depth={float(f'{plain.depth:.4g}')}," in repr(plain) and "size" not in repr(plain)
    assert f"suspects={named.suspects}, size={named.size:.4g}" in repr(named) and not math.isnan(named.size)
    spelled = repr(plain.errors)
    assert plain.errors["y1"] != float(plain.errors["y1"]) and len(spelled) < 30, "exact, and short to read"


def test_a_window_is_explained_by_its_time(results):
    said = str(results["dates"].explain(11))
    times = {
        "dates": (
            f"{START} 00:03:40",
            f"{START}T00:03:40",
            pd.Timestamp(f"{START} 00:03:40"),
            np.datetime64(f"{START}T00:03:40"),
            datetime.datetime(2026, 1, 1, 0, 3, 40),
            f"{START} 00:03:41",  # nearest to it
            f"{START} 00:03:40Z",
        ),
        "dates of a zone": (f"{START} 00:03:40", "2025-12-31 23:03:40+00:00", INDEXES["dates of a zone"][11]),
        "numpy": (f"{START} 00:03:40", INDEXES["numpy"][11]),
        "spans": ("220 s", "00:03:40", INDEXES["spans"][11], datetime.timedelta(minutes=3, seconds=40)),
        "seconds": ("320 s", "320s", "320.0"),
    }
    for name, every in times.items():
        for at in (*every, 11, "11", -29, np.int64(11), jnp.asarray(11)):
            assert str(results[name].explain(at)) == said, (name, at)
    faults = results["dates"].diagnose(f"{START} 00:03:40", f"{START} 00:04:00")
    assert str(faults) == str(results["dates"].diagnose(11, 12))


def test_a_window_that_is_not_there_is_refused_in_a_sentence(results):
    of_bank = judged(relations=jb.structured_relations(MODEL))
    watched = judged(INDEXES["dates"], jb.monitor(MODEL, tests=[{"name": "short", "horizon": 2}]))
    for res in (results["dates"], judged(), of_bank, watched):
        for at in (9999, 40, -41):
            with pytest.raises(ValueError, match=f"no sample {at}: the recording has 40, numbered from 0"):
                res.explain(at)
        with pytest.raises(ValueError, match="10.5 is no number of a sample: give a whole one, or a time"):
            res.explain(10.5)
        with pytest.raises(ValueError, match="there is one recording, name the sample alone"):
            res.explain((0, 1))
    with pytest.raises(
        ValueError, match=r"lies at 2026-01-02: the nearest is at 2026-01-01 00:13:00;.* runs from"
    ):
        results["dates"].explain("2026-01-02")
    with pytest.raises(ValueError, match="'noon' names no sample: give its number, or its time, like '2026-"):
        results["numpy"].explain("noon")
    with pytest.raises(ValueError, match="'200 s' names no sample: nothing here tells times"):
        judged().explain("200 s")
    with pytest.raises(ValueError, match="no sample 40"):
        watched.test_at(40)
    with pytest.raises(ValueError, match="no sample 40"):
        of_bank.names(40)
    assert watched.test_at(f"{START} 00:03:40") == watched.test_at(11)


def test_of_recordings_side_by_side_one_is_named_first():
    batch = jb.detect(jb.parity_relations(MODEL, 2), np.zeros((3, T, 1)), np.ones((3, T, 1)))
    assert batch.explain((2, 11)).at == (2, 11)
    with pytest.raises(ValueError, match=r"11 names no window: there are \(3,\) recordings.* like \(0, 39\)"):
        batch.explain(11)
    with pytest.raises(ValueError, match="there is no recording 3: the batch has 3, numbered from 0"):
        batch.explain((3, 11))
