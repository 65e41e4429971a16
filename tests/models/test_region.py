"""The region of training: a plain loop over windows says of each how far it lies outside."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.models.region import Region

RANGES = {"valve": ("0", "0.39"), "pump": (2, 2)}


def plant(D=None, **changes):
    """Return a plant of three inputs: the second never moved in training, of the third nothing is stated."""
    given = dict(noise="0.1", inputs=["valve", "pump", "sun"], ranges=RANGES, units={"valve": "bar"})
    return jb.LinearSystem([["0.5"]], [[1, 1, 1]], [[1]], D, **{**given, **changes})


def looped(u, missing, horizon, reads_last, ranges):
    """Return (share, by, reading) of one recording, sample by sample."""
    share, by, reading = np.full(len(u), np.nan), np.full(len(u), -1), np.full(len(u), np.nan)
    for k in np.flatnonzero(~missing):
        share[k] = 0
        for j, (lo, hi) in enumerate(ranges):
            for x in u[k - horizon : k + reads_last, j]:
                over = max(lo - x, x - hi)
                if over > 1e-6 * (hi - lo) + 1e-6 and over > 0:
                    own = over / (hi - lo) if hi > lo else np.inf
                    if own > share[k]:
                        share[k], by[k], reading[k] = own, j, x
    return share, by, reading


def drawn(rng, shape):
    """Return inputs that leave the ranges at times, with samples missing."""
    u = np.stack([rng.uniform(0, 0.39, shape), np.full(shape, 2.0), rng.uniform(-9, 9, shape)], -1)
    u[rng.random(shape) < 0.03, 0] = 1.25
    u[rng.random(shape) < 0.02, 0] = -0.5
    u[rng.random(shape) < 0.01, 1] = 2.5
    u[rng.random((*shape, 3)) < 0.05] = np.nan
    u[:, :35], u[:, 110, 1] = [0.39, 2.0, 0.0], 2.5  # one of each kind, whatever was drawn
    return u


@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize("horizon", [1, 2, 7, 16])
def test_windows_are_as_far_outside_as_the_samples_that_they_read(direct, horizon, rng):
    model = plant([[1, 0, 0]] if direct else None)
    relations = jb.parity_relations(model, horizon)
    u, y = drawn(rng, (3, 120)), rng.normal(size=(3, 120, 1))
    y[rng.random(y.shape) < 0.05] = np.nan
    res = jb.detect(relations, u, y, starts=[40, 41, 90])
    region = [(0.0, 0.39), (2.0, 2.0)]
    for i in range(3):
        missing = res.status[i] == jb.Status.MISSING
        share, by, reading = looped(u[i], missing, horizon, int(direct), region)
        np.testing.assert_array_equal(res.outside[i], share)
        np.testing.assert_array_equal(res.outside_by[i], by)
        np.testing.assert_array_equal(res.departure.reading[i], reading)
    assert np.isposinf(res.outside).any() and (res.outside == 0).any(), "each kind of window is there"


def test_a_sample_counts_in_the_windows_that_read_it_and_in_no_other():
    u = np.full((12, 3), [0.1, 2.0, 0.0])
    u[5, 0] = 0.78
    y = np.zeros((12, 1))
    past = jb.detect(jb.parity_relations(plant(), 2), u, y).outside
    both = jb.detect(jb.parity_relations(plant([[1, 0, 0]]), 2), u, y).outside
    # without feedthrough the newest input of a window is in none of its equations
    assert np.flatnonzero(past > 0).tolist() == [6, 7] and np.flatnonzero(both > 0).tolist() == [5, 6, 7]
    np.testing.assert_array_equal(past[6:8], (0.78 - 0.39) / 0.39)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_rounding_is_no_excess_and_what_is_more_is_one(kind):
    """Ranges are of numbers in float64; the next recording of the same samples may be in float32."""
    lo, hi = 300.1, 300.3
    model = plant(ranges={"valve": (lo, hi), "pump": (0.1, 0.1)})
    relations = jb.parity_relations(model, 1)
    outside = []
    for x, other in ((hi, 0.1), (lo, 0.1), (hi + 1e-8, 0.1), (hi + 1e-3, 0.1), (lo, 0.1001)):
        u = np.tile(np.array([x, other, 0], kind), (4, 1))
        outside.append(float(jb.detect(relations, u, np.zeros((4, 1), kind)).outside[-1]))
    assert outside[:3] == [0, 0, 0] and 0 < outside[3] < 0.01 and outside[4] == np.inf


@pytest.mark.parametrize("count", [1, 511, 512, 513, 2000])
def test_one_sample_of_many_is_not_overlooked(count, rng):
    """Long recordings are first asked whether any sample leaves the ranges, many samples at once."""
    region = Region.of(jb.parity_relations(plant([[1, 0, 0]]), 1))
    for at in {0, count // 2, count - 1}:
        u = np.full((count, 3), [0.2, 2.0, 0.0])
        u[rng.random((count, 3)) < 0.1] = np.nan
        u[at, 0] = 0.4
        found = region.departure(u, np.zeros(count, bool))
        assert np.flatnonzero(found.share > 0).tolist() == [at, at + 1][: count - at]


def test_factors_on_bounds_are_no_inputs(rng):
    """They stand behind the inputs in the samples, and move as the inputs do."""
    u, y = drawn(rng, (1, 120))[0], rng.normal(size=(120, 1))
    plain = plant(outputs="level")
    model = plant(outputs="level", times={"level": "1 + abs(sun)"})
    table = dict(zip(("valve", "pump", "sun", "level"), (*u.T, y[:, 0]), strict=True))
    res, other = (jb.detect(jb.parity_relations(m, 2), table) for m in (model, plain))
    tested = (res.status != jb.Status.MISSING) & (other.status != jb.Status.MISSING)
    assert res.u.shape[-1] == 4 and (res.outside[tested] > 0).any()
    np.testing.assert_array_equal(res.outside[tested], other.outside[tested])


def test_without_ranges_nothing_is_said():
    u, y = np.full((9, 3), 50.0), np.zeros((9, 1))
    res = jb.detect(jb.parity_relations(plant(ranges=None), 2), u, y)
    assert res.departure is None and res.beyond is None
    assert np.isnan(res.outside).all() and (res.outside_by == -1).all()
    assert "outside" not in res.to_pandas() and "training" not in repr(res)


def test_an_observer_says_it_of_the_step_that_led_to_the_sample():
    u, x = np.zeros((12, 3)), np.zeros((12, 1))
    u[5, 0] = 0.78
    x[6:, 0] = 0.78 * 0.5 ** np.arange(6)
    ranges = {"valve": (0, "0.39")}
    for direct, y, samples in ((None, x, [6]), ([[1, 0, 0]], x + u[:, :1], [5, 6])):
        res = jb.detect(jb.observer(plant(direct, ranges=ranges)), u, y)
        assert np.flatnonzero(res.outside > 0).tolist() == samples


@pytest.mark.parametrize(
    "by, reading, said",
    [
        (0, 1.0, "valve at 1 bar, training up to 0.39 bar"),
        (0, -0.5, "valve at -0.5 bar, training from 0 bar"),
        (0, 0.390001, "valve at 0.390001 bar, training up to 0.39 bar"),
        (0, 123456.7, "valve at 123457 bar, training up to 0.39 bar"),
        (1, 2.5, "pump at 2.5, training always at 2"),
    ],
)
def test_words(by, reading, said):
    assert Region.of(jb.parity_relations(plant(), 1)).words(by, reading) == said
