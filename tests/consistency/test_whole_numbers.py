"""Windows that floats cannot decide although they are far from the boundary: sensors without noise, and
numbers that overflow.
"""

import json
from fractions import Fraction

import check_certificate
import numpy as np
import pytest
from oracles import Plant

import jaxbound as jb
from jaxbound.consistency.whole_numbers import exact_strip_margins
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.strips import status_of

LONG = 20  # samples before the last: of the sizes of section 5 in other tests of long windows
TURN = dict(A=[[0.6, -0.8], [0.8, 0.6]], B=[[0], [1]], C=[[1, 0], [1, 1]])
MODELS = {
    "turning": TURN,
    "one bare sensor": TURN | dict(noise=[0.1, 0], tolerance=[0.02, 0]),
    "nearly bare": TURN | dict(noise=[1e-13, 1e-14], offset={"u": [1.5], "y": [12.5, "1/3"]}),
    "relative only": TURN | dict(tolerance=[0.02, 0], disturbance=([[0], [1]], [[0, "1e-12"]])),
    "unseen mode": dict(A=[[0, 1], [1, 0]], B=[[0], [1]], C=[[1, 1], [2, 2]]),
}


def windows(plant, s, count, rng, dtype, size=1.0):
    """Return u (N, s + 1, m), y (N, s + 1, p) of exact plants without any error, every third with a fault of
    some 1e-3 or of its size.
    """
    us, ys = [], []
    for i in range(count):
        u = (size * rng.uniform(-1, 1, (s + 1, plant.m))).astype(dtype)
        x = [Fraction(float(v)) for v in size * rng.normal(size=plant.n)]
        middle = [[(lo + hi) / 2 for lo, hi in plant.disturbance]] * s
        known = [[Fraction(float(v)) - o for v, o in zip(row, plant.offset_u, strict=True)] for row in u]
        y = plant.trajectory(x, known, w=middle if plant.g else ())
        y = np.array([[float(v + o) for v, o in zip(row, plant.offset_y, strict=True)] for row in y])
        if i % 3 == 0:
            y[-1] += size * rng.choice([1e-3, 1]) * rng.choice([-1, 1])
        us.append(u), ys.append(y)
    return np.array(us).astype(dtype), np.array(ys).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", MODELS)
def test_strips_of_a_sensor_without_noise_are_decided_as_exact_circuits_are(name, dtype, rng):
    plant, relations = Plant(**MODELS[name]), jb.parity_relations(jb.LinearSystem(**MODELS[name]), 2)
    u, y = windows(plant, 2, 12, rng, dtype)
    y[3, 1, 0] = np.nan
    found, circuits = jb.detect(relations, u, y), plant.circuits(2)
    for w in range(12):
        present = [h for h in circuits if w != 3 or not h[plant.p]]
        gauge = plant.gauge(2, u[w], y[w], dtype, present)
        assert found.status[w, -1] == (Status.FAULT if gauge > 1 else Status.CONSISTENT), (w, float(gauge))
        assert abs(1 - found.margin[w, -1] - float(gauge)) <= 1e-2 * (1 + float(gauge))
    assert {Status.FAULT, Status.CONSISTENT} == set(found.status[:, -1])


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
def test_a_long_window_of_a_sensor_without_noise_is_decided(dtype, rng):
    plant, relations = Plant(**TURN), jb.parity_relations(jb.LinearSystem(**TURN), LONG)
    assert relations.frame is not None
    u, y = windows(plant, LONG, 9, rng, dtype)
    y[4, 3, 1] = np.nan
    found = jb.detect(relations, u, y)
    np.testing.assert_array_equal(
        found.status[:, -1], [Status.FAULT, Status.CONSISTENT, Status.CONSISTENT] * 3
    )
    for w in range(3):
        check_certificate.confirm(document := json.loads(found.explain((w, LONG)).to_json()))
        assert document["certificate"] == Status(found.status[w, -1]).name


@pytest.mark.parametrize("horizon", [2, LONG])
def test_a_monitor_decides_them_alike(horizon, rng):
    plant, relations = Plant(**TURN), jb.parity_relations(jb.LinearSystem(**TURN), horizon)
    u, y = (x[0] for x in windows(plant, 40, 1, rng, float))
    whole, mon = jb.detect(relations, u, y, margins="exact"), jb.Monitor(relations)
    state, first = mon.run(mon.init(), u[:30], y[:30])
    _, rest = mon.run(state, u[30:], y[30:])
    np.testing.assert_array_equal(np.concatenate([first.status, rest.status]), whole.status)
    np.testing.assert_allclose(np.concatenate([first.margin, rest.margin]), whole.margin, rtol=1e-9)
    assert not (whole.status == Status.UNDECIDED).any() and (whole.status == Status.FAULT).sum() == 1


@pytest.mark.parametrize("horizon", [1, LONG])
def test_a_complete_window_of_huge_numbers_is_decided_and_never_missing(horizon, rng):
    model = TURN | dict(noise=["1e306", "1e306"])
    plant, relations = (
        Plant(**TURN, noise=[Fraction(10) ** 306] * 2),
        jb.parity_relations(jb.LinearSystem(**model), horizon),
    )
    u, y = windows(plant, horizon, 6, rng, float, size=2e307)
    found = jb.detect(relations, u, y)
    np.testing.assert_array_equal(found.status[1:, -1][[0, 1, 3, 4]], Status.CONSISTENT)
    assert (found.status[:, -1] != Status.MISSING).all() and (found.status[:, -1] != Status.UNDECIDED).all()


def test_windows_on_the_boundary_of_wide_bounds_stay_undecided_and_cost_nothing(rng):
    """Thin is a matter of bounds against samples: with ordinary noise nothing is done twice."""
    from jaxbound.consistency import whole_numbers

    relations = jb.parity_relations(jb.LinearSystem(**TURN, noise=0.1, tolerance=0.02), 1)
    test = relations.reading(np.float64)
    y = rng.uniform(-1000, 1000, (2, 2, 50))
    assert not whole_numbers.thin(test, np.zeros((2, 1, 50)), y).any()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_margins_on_the_host_are_read_without_compiling_for_their_number(dtype):
    tiny = np.finfo(dtype).smallest_subnormal
    found = status_of(np.array([-1, -tiny, 0, tiny, np.inf, -np.inf, np.nan], dtype))
    assert isinstance(found, np.ndarray) and found.dtype == np.int8
    F, U, C, M = Status.FAULT, Status.UNDECIDED, Status.CONSISTENT, Status.MISSING
    assert found.tolist() == [F, F, U, C, C, F, M]


def test_tolerances_whose_fractions_are_long_are_decided(rng):
    """The denominator of 1e-7 as a float is 2^76: no number of 64 bits."""
    plant = Plant(**TURN | dict(tolerance=[1e-7, 3e-9]))
    r = jb.parity_relations(jb.LinearSystem(**TURN | dict(tolerance=[1e-7, 3e-9])))
    u, y = windows(plant, r.horizon, 30, rng, np.float64)
    margin = exact_strip_margins(
        r,
        r.reading(np.float64),
        (r.circuits, r.circuits_known),
        np.moveaxis(u, 0, -1)[:1],
        np.moveaxis(y, 0, -1),
    )
    assert (margin[1::3] > 0).all() and (margin[2::3] > 0).all() and (margin[::3] < 0).mean() > 0.5


def test_an_infinite_recording_of_a_sensor_without_tolerance_is_refused_in_one_sentence():
    m = jb.LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], noise=[0.1, 0.01])
    r = jb.parity_relations(m, horizon=20)
    with pytest.raises(ValueError, match="y must be finite"):  # and nothing warns
        jb.detect(r, np.zeros((30, 1)), np.full((30, 2), np.inf))
