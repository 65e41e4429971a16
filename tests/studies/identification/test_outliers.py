"""Numbers for a missing sample among healthy ones: refused by name where they alone widen bounds, and told
apart from what a plant does.
"""

import re

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.studies.identification.outliers import outliers

NOWHERE = np.zeros(0, int)
AT = [60, 61, 62, 200]


def heater(seed, count=400, late=1, noise=0.1):
    """Return (u, y, starts) of a temperature that follows steps of a heater."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([20.0, 40.0, 60.0, 80.0], count // 20 + 1), 20)[:count]
    acts = np.concatenate([np.full(late - 1, u[0]), u])
    x, y = 35.0, []
    for k in range(count):
        y.append(x + rng.uniform(-noise, noise))
        x = 0.93 * x + 0.035 * acts[k] + 1.4
    return u[:, None], np.round(y, 2)[:, None], NOWHERE


def marked(records, order=1, delay=1):
    """Return (samples of inputs, samples of outputs) that are named in the first recording; None: none."""
    found = outliers(records, order, delay)
    if found is None:
        return None
    (u, y), *_ = found.marks
    return np.flatnonzero(u.any(1)).tolist(), np.flatnonzero(y.any(1)).tolist()


@pytest.mark.parametrize("number", [-999.0, 0.0, 150.0, -1766.2, 9999.0])
@pytest.mark.parametrize("side", [0, 1])
def test_a_number_for_missing_is_named_wherever_it_stands(number, side):
    records = [heater(1), heater(2)]
    for record in records:
        record[side][AT] = number
    named = [[], []]
    named[side] = AT
    assert marked(records) == tuple(named)
    assert marked(records, 2) == tuple(named)


@pytest.mark.parametrize("at", [[0], [399], list(range(100, 120)), list(range(7, 400, 33))])
def test_single_ones_runs_and_many_of_one_number_are_named(at):
    records = [heater(1), heater(2)]
    records[0][1][at] = 0.0
    assert marked(records) == ([], at)


def test_two_numbers_and_two_signals_are_named():
    records = [heater(1), heater(2)]
    records[0][1][[60, 90]] = [[-999.0], [9999.0]]
    records[0][0][250] = -999.0
    assert marked(records) == ([250], [60, 90])


@pytest.mark.parametrize("late", [1, 3])
def test_late_inputs_are_named_where_they_stand(late):
    records = [heater(1, late=late), heater(2, late=late)]
    records[0][0][250] = 9999.0
    assert marked(records, delay=late) == ([250], [])


def test_what_a_plant_does_is_no_outlier():
    """Dead time that the model does not have, a coarse recorder, pulses of an input, noise with a heavy tail:
    each makes a few samples err far more than others, and is seen in the samples behind.
    """
    rng = np.random.default_rng(0)
    late, coarse = [heater(1, late=5), heater(2, late=5)], [heater(3), heater(4)]
    for _, y, _ in coarse:
        y[:] = np.round(y / 5) * 5
    pulses = []
    for _ in range(2):
        u, x, y = np.zeros((600, 1)), 0.0, []
        u[rng.choice(600, 4, replace=False)] = 50.0
        for k in range(600):
            y.append([x + rng.uniform(-0.01, 0.01)])
            x = 0.9 * x + 0.1 * float(u[k - 3, 0])
        pulses.append((u, np.array(y), NOWHERE))
    heavy = [heater(7), heater(8)]
    for _, y, _ in heavy:
        y += 0.1 * rng.standard_t(3, y.shape)
    for records in (late, coarse, pulses, heavy):
        for order in (1, 2, 3):
            assert marked(records, order) is None
    for _, y, _ in late:  # nor does a transient hide one
        y[200] = -999.0
    assert marked(late) == ([], [200])


def table(seed):
    u, y, _ = heater(seed)
    times = pd.date_range("2026-03-02", periods=len(y), freq="60s")
    return pd.DataFrame({"heater": u[:, 0], "T out": y[:, 0]}, times)


def fitted(tables, **about):
    return jb.fit(tables, order=1, horizon=8, inputs=["heater"], outputs=["T"], method="windows", **about)


def test_a_fit_refuses_until_it_is_told():
    """The sentence has samples, the number, and a condition that leaves them out: it works; so does one that
    says that they were measured.
    """
    tables = [table(1), table(2)]
    for one in tables:
        one.iloc[AT, 1] = -999.0
    with pytest.raises(ValueError, match="T is -999 in 8 of 800 samples") as refused:
        fitted(tables, columns={"T": "T out"})
    assert "2026-03-02 01:00:00" in str(refused.value) and "03:20:00" in str(refused.value)
    leaving, passing = re.findall('"([^"]+)"', str(refused.value))
    model = fitted(tables, columns={"T": "T out", "where": leaving})
    assert float(model.noise[0]) < 0.2 and not any("-999" in x for x in model.check.sentences)
    kept = fitted(tables, columns={"T": "T out", "where": passing})
    assert float(kept.noise[0]) > 100
    blind, told, *_ = kept.check.sentences
    assert blind.startswith("the monitor is blind") and told.startswith("T is -999 in 8 of 800 samples")


def test_means_that_a_number_spoils_are_named():
    """The condition is asked about what was recorded, so it is one that all spoiled means fail."""
    tables = [table(1), table(2)]
    for one in tables:
        one.iloc[AT, 1] = -999.0
    every = {"columns": {"T": "T out"}, "recording": {"every": "5min"}}
    with pytest.raises(ValueError, match="T is .* in 4 of 160 samples") as refused:
        fitted(tables, **every)
    leaving = re.findall('"([^"]+)"', str(refused.value))[0]
    every["columns"]["where"] = leaving
    assert leaving.startswith("`T out` > ") and float(fitted(tables, **every).noise[0]) < 20


def test_the_condition_is_right_after_a_change_of_units():
    tables = [table(1), table(2)]
    tables[0].iloc[AT, 1] = -999.0
    kelvin = {"T": "= `T out` + 273.15", "where": "heater > 0"}
    with pytest.raises(ValueError, match="T is -725.85 in 4 of 800") as refused:
        fitted(tables, columns=kelvin)
    leaving = re.findall('"([^"]+)"', str(refused.value))[0]
    assert leaving.startswith("(heater > 0) and ")
    assert float(fitted(tables, columns=kelvin | {"where": leaving}).noise[0]) < 0.2
