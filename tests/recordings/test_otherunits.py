"""Columns that may be in another unit than others: who is suspected by the numbers, and who is not."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.recordings.otherunits import other_units
from jaxbound.recordings.read import read_signals

T = 400
ROOM = "T_room"


def walk(rng, level=20.0, spread=2.0):
    x = np.cumsum(rng.normal(size=T))
    return level + spread * (x - x.mean()) / x.std()


@pytest.mark.parametrize(
    ("level", "factor", "shift", "text"),
    [
        (20, 1.8, 32, "1.8 * T_room + 32, as degF of degC"),
        (20, 1, 273.15, "T_room + 273.15, as kelvin of degC"),
        (295, 1.8, -459.67, "1.8 * T_room - 459.67, as degF of kelvin"),
        (0.5, 100, 0, "100 * T_room, as percent of a fraction or kPa of bar"),
        (40, 6.8948, 0, "6.89476 * T_room, as kPa of psi"),
        (30, 3.6, 0, "3.6 * T_room, as m3/h of l/s or km/h of m/s"),
        (30, 60, 0, "60 * T_room, as l/min of l/s"),
        (30, 16.667, 0, "16.6667 * T_room, as l/min of m3/h"),
    ],
)
def test_a_column_that_is_another_in_another_unit_is_named(rng, level, factor, shift, text):
    x = walk(rng, level, level / 9)
    y = factor * x + shift + 0.003 * factor * level / 9 * rng.normal(size=T)
    y[7] = np.nan
    others = [walk(rng, 50, 10), np.arange(T) % 2]
    found = list(other_units(["other", "on", "b", ROOM], np.stack([*others, y, x], 1)))
    assert found == [("b", f"b is {text}: it may be in another unit")]
    assert not list(other_units(["b [degF]", "T [degC]"], np.stack([y, x], 1))), "the names say it"
    assert len(list(other_units(["b [bar]", "T [bar]"], np.stack([y, x], 1)))) == 1


def test_two_sensors_of_a_temperature_need_not_agree_to_the_last_digit(rng):
    x = walk(rng)
    beside = x + 0.1 * rng.normal(size=T)
    ((name, _),) = other_units(["a", "b"], np.stack([x, 1.8 * beside + 32], 1))
    assert name == "b"
    assert not list(other_units(["a", "b"], np.stack([x, 60 * beside], 1))), "a factor alone is anything"


def test_what_is_alike_by_chance_is_not_named(rng):
    """Columns of one plant follow each other by other factors, and from other levels."""
    x = walk(rng)
    follows = [x, 2 * x, 1.8 * x + 40, x + 270, 55 * x, 0.4 * x + 60, walk(rng, 68, 3.6), walk(rng, 293.15)]
    assert not list(other_units([f"c{i}" for i in range(8)], np.stack(follows, 1)))
    far = np.stack([walk(rng, 9000, 20_000), x], 1)
    assert not list(other_units(["far", "x"], far)), "no column is another by itself"
    early, still = np.where(np.arange(T) < 99, x, np.nan), np.where(np.arange(T) < 99, 5.0, x)
    assert not list(other_units(["still", "early"], np.stack([still, early], 1))), "nothing shows it there"
    assert not list(other_units([], np.zeros((T, 0)))) and not list(
        other_units(["a"], np.full((T, 1), np.nan))
    )


def test_a_fraction_among_percents_is_named(rng):
    share, percent = rng.random(T), 100 * rng.random(T)
    found = dict(other_units(["valve1", "valve2", "x1", "x2"], np.stack([share, percent] * 2, 1)))
    assert list(found) == ["valve1"] and "may be a fraction where the other is in percent" in found["valve1"]
    ((name, sentence),) = other_units(["valve [%]", "fan"], np.stack([share, percent], 1))
    assert name == "valve [%]" and sentence.endswith("it may be a fraction, though its name says percent")
    switch = (share > 0.5).astype(float)
    assert not list(other_units(["valve1", "valve2"], np.stack([switch, percent], 1)))


def test_look_and_fit_say_it(tmp_path, rng):
    x, heat = walk(rng), rng.integers(0, 9, T)
    rows = [f"{k},{heat[k]},{x[k]:.3f},{1.8 * x[k] + 32:.3f}" for k in range(T)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["time,heat,a,b", *rows, ""]))
    (column,) = [column for column in jb.look(path).columns if "unit?" in column.marks]
    assert column.name == "b" and "as degF of degC" in column.findings[-1].sentence
    (recording,) = read_signals(path, ["heat"], ["a", "b"], dt=1.0)
    assert any("b is 1.8 * a + 32" in hint for hint in recording.hints)
