"""What is recorded on change: the last value stands, a stated deadband is a bound, another is suspected."""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.recordings.hints import rounding_hints
from jaxbound.recordings.recordingformat import RecordingFormat, with_format
from jaxbound.recordings.suspects import least_change, suspicions
from jaxbound.sets.floats.status import Status

BAND = 0.3
PLANT = jb.LinearSystem([[0.9]], [[0.2]], [[1]], noise=0.05, horizon=6, inputs=["u"], outputs=["y"])


def plant(**stated):
    return PLANT.replace(columns=with_format({}, {"hold": "1h"} | stated))


def on_change(path, rng, count=400):
    """Write a healthy run of the plant: y where it left what was written by more than the deadband."""
    u = np.repeat(rng.uniform(-5, 5, count // 40), 40)
    rows, last, x = ["time,u,y"], np.inf, 0.0
    for k in range(count):
        now, cell = x + float(rng.uniform(-0.05, 0.05)), ""
        x = 0.9 * x + 0.2 * u[k]
        if abs(now - last) > BAND:
            last, cell = now, str(now)
        if cell or k % 40 == 0 or k + 1 == count:
            rows.append(f"{k},{u[k]},{cell}")
    path.write_text("\n".join([*rows, ""]))
    return path


def held(x, band):
    """Return what a recorder with a deadband writes of numbers."""
    out, last = x.copy(), x[0]
    for k, now in enumerate(x):
        last = out[k] = now if abs(now - last) > band else last
    return out


def test_a_stated_deadband_bounds_what_is_held_and_nothing_less_does(tmp_path, rng):
    for _ in range(5):
        path = on_change(tmp_path / "run.csv", rng)
        stated = jb.detect(plant(deadband=BAND), jb.read(path, plant(deadband=BAND))).status
        assert (stated[PLANT.horizon :] == Status.CONSISTENT).all() and len(stated) == 400
        less = jb.detect(plant(deadband="y:0.1"), jb.read(path, plant(deadband="y:0.1"))).status
        assert (less == Status.FAULT).sum() > 20


def test_the_deadband_is_the_resolution_unless_that_says_more(tmp_path):
    stated = plant(deadband={"y": "0.3"})
    assert stated.resolution == (Fraction(3, 10),)
    assert stated.replace(resolution=0.35).resolution == (Fraction(7, 20),)
    jb.save_model(stated, tmp_path / "plant.toml")
    assert jb.load_model(tmp_path / "plant.toml") == stated
    with pytest.raises(ValueError, match="'y', 0.05, is below its deadband, 0.3: .* 0.35 in all"):
        stated.replace(resolution=0.05)
    with pytest.raises(ValueError, match="'u' is none"):
        plant(deadband="u:0.3")
    for wrong in ("y:", "0", "-1", "y", "1e400", "1e-400"):
        with pytest.raises(ValueError, match="deadband of .recording. must be a number above 0"):
            RecordingFormat.of({"deadband": wrong})
    (hint,) = rounding_hints(stated, np.arange(40)[:, None] / 10)
    assert "add `resolution = 0.35`" in hint


def test_fit_takes_the_deadband_as_part_of_its_bounds_and_writes_it_once(tmp_path, rng):
    path = on_change(tmp_path / "run.csv", rng)
    asked = dict(inputs=["u"], outputs=["y"], dt=1.0, order=1, horizon=6)
    plain = jb.fit(path, recording={"hold": "1h"}, **asked)
    model = jb.fit(path, recording={"hold": "1h", "deadband": BAND}, **asked)
    assert model.resolution == (Fraction(3, 10),) and "deadband" in model.provenance["resolution"]
    bound = plain.noise[0] + plain.resolution[0]
    assert model.noise[0] == max(bound - model.resolution[0], 0)
    wide = jb.fit(path, recording={"hold": "1h", "deadband": 2}, **asked)
    assert (wide.noise, wide.resolution) == ((0,), (2,)), "no bound is below the deadband"
    jb.save_model(model, tmp_path / "plant.toml")
    assert jb.load_model(tmp_path / "plant.toml") == jb.LinearSystem.replace(model)
    (hint,) = [x for x in jb.read(path, plant()).hints if "deadband" in x]
    assert "perhaps y:0.30" in hint and not any("deadband" in x for x in jb.read(path, model).hints)


def test_an_input_that_is_written_on_change_has_no_bound_by_itself(tmp_path, rng):
    path = on_change(tmp_path / "run.csv", rng)
    swapped = jb.LinearSystem([[0.9]], [[0.2]], [[1]], noise=1, inputs=["y"], outputs=["u"])
    swapped = swapped.replace(columns=with_format({}, {"hold": "1h", "deadband": "1"}))
    (hint,) = [x for x in jb.read(path, swapped).hints if "deadband" in x]
    assert hint.startswith("inputs changed by a deadband or more, perhaps y:0.30")


def test_who_stands_still_and_then_changes_by_as_much_is_suspected(rng):
    walk = np.cumsum(rng.normal(size=900) * 0.1)
    assert BAND < least_change(held(walk, BAND)) < 1.05 * BAND
    assert [kind for kind, _ in suspicions("y", "y", held(walk, BAND))] == ["on change"]
    others = [
        walk,
        np.round(walk / 2, 1),  # a recorder that rounds
        np.repeat(walk[::10], 10),  # one that asks a slow sensor
        np.repeat(rng.uniform(0, 100, 90), 10),  # what somebody sets
        np.repeat(np.arange(90), 10) % 7 * 0.37,
    ]
    assert not any(list(suspicions("y", "y", x)) for x in others)
