"""The interval of true values behind a sample, against the four vertices of theta and delta in exact
rationals.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import Plant

from jaxbound.models import sensor

SENSORS = [
    (0, 0.1, 0, 0),
    (0.02, 0.1, 0, 0),
    (0.1, 0.01, 0, 0),
    (0.1, 0.01, 0.25, 0),
    (0.05, 0.2, 0, 12.5),
    (0.9, 0.3, 0, -3),
    (0, 0, 0, 0),
    (0.3, 0, 0, 1000),
]


@jax.jit
def compiled(y, *bounds):
    return sensor.true_value(y, *bounds, jnp.nan_to_num(abs(y), posinf=jnp.inf).max(0, keepdims=True))


def interval(samples, sigma, noise, resolution, offset, dtype):
    """Return mid, rad, scale (s + 1, N) of windows samples (s + 1, N), compiled."""
    return [
        np.asarray(v)
        for v in compiled(
            samples.astype(dtype), *(np.asarray(v, dtype) for v in (sigma, noise, resolution, offset))
        )
    ]


def samples_of(noise, offset, rng, count=120):
    """Return windows (2, N) around the offset on every scale, with samples on the edges of the cases |y| =
    noise.
    """
    y = rng.normal(size=(2, count)) * 10 ** rng.uniform(-4, 4, count) + offset
    y[0, :5] = np.array([-noise, -noise / 2, 0, noise / 2, noise]) + offset
    return y


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("sigma, noise, resolution, offset", SENSORS)
def test_interval_is_that_of_the_four_vertices_to_rounding(sigma, noise, resolution, offset, dtype, rng):
    y = samples_of(noise, offset, rng).astype(dtype)
    numbers = [
        Fraction(float(dtype(v))) for v in (sigma, noise, resolution, offset)
    ]  # as the kernel sees them
    plant = Plant(
        [[1]],
        None,
        [[1]],
        tolerance=numbers[0],
        noise=numbers[1],
        resolution=numbers[2],
        offset={"y": numbers[3]},
    )
    mid, rad, scale = interval(y, sigma, noise, resolution, offset, dtype)
    u = float(np.finfo(dtype).eps) / 2
    for i in range(y.shape[1]):
        for j, (lo, hi) in enumerate(plant.true_values(y[:, i : i + 1], dtype)):
            assert abs(Fraction(float(mid[j, i])) - (lo + hi) / 2) <= 16 * u * scale[j, i] + 1e-37
            assert abs(Fraction(float(rad[j, i])) - (hi - lo) / 2) <= 16 * u * scale[j, i] + 1e-37


@pytest.mark.parametrize("sigma, noise, resolution, offset", SENSORS)
def test_scale_is_at_least_the_magnitudes_that_rounding_is_relative_to(sigma, noise, resolution, offset, rng):
    y = samples_of(noise, offset, rng)
    _, rad, scale = interval(y, sigma, noise, resolution, offset, np.float64)
    assert (scale >= ((abs(y) + abs(offset)) * (1 + sigma) / (1 - sigma**2) + rad) * (1 - 1e-14)).all()


@pytest.mark.parametrize("sigma, noise, resolution, offset", SENSORS)
def test_every_radius_is_positive(sigma, noise, resolution, offset):
    assert (
        interval(np.full((2, 3), float(offset)), sigma, noise, resolution, offset, np.float64)[1] > 0
    ).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_sample_is_known_to_four_roundoffs_of_the_largest_in_its_window(dtype):
    _, rad, _ = interval(np.array([[1000.0], [1.0]]), 0, 0, 0, 0, dtype)
    np.testing.assert_allclose(rad, np.full((2, 1), 1000 * 2 * np.finfo(dtype).eps), rtol=1e-6)


def test_a_missing_sample_has_no_middle_and_leaves_the_others_alone(rng):
    y = rng.normal(size=(3, 50))
    gone = y.copy()
    gone[1] = np.nan
    mid, rad, scale = interval(gone, 0.02, 0.1, 0, 0, np.float64)
    kept_mid, kept_rad, _ = interval(y[[0, 2]], 0.02, 0.1, 0, 0, np.float64)
    assert np.isnan(mid[1]).all() and np.isnan(scale[1]).all() and np.isfinite(rad).all()
    np.testing.assert_array_equal(mid[[0, 2]], kept_mid)
    np.testing.assert_array_equal(rad[[0, 2]], kept_rad)
