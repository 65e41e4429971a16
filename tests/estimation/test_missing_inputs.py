"""Where an input is missing that acts on an output at once, nobody knows what a perfect sensor shows: bands
are entire there.
"""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb

OFFSET = {"u": [2], "y": [-3]}
PLANT = jb.LinearSystem(
    [["0.9", "0.2"], ["-0.1", "0.95"]],
    [[0], [1]],
    [[1, 0]],
    [["10"]],
    noise="0.1",
    disturbance=([[1], ["0.5"]], "0.02"),
    tolerance="0.01",
    offset=OFFSET,
)
GAIN = jb.Uncertainty("gain", D=[[1]], between=("-0.5", "0.5"))
MISSING = (12, 20, 29)
OTHERS = [pytest.param(method, marks=pytest.mark.long) for method in ("strips", "joint")]


def exact_run(model, gain):
    """Return (u, y, states, outputs of a perfect sensor) of 30 samples, exact but for their last rounding to
    floats.
    """
    A, B, C, D, G = (getattr(model, letter) for letter in "ABCDG")
    x, rows = [Fraction(3), Fraction(-2)], []
    for k in range(30):
        v, side = Fraction(k % 5 - 2), (-1) ** k
        true = C[0][0] * x[0] + C[0][1] * x[1] + (D[0][0] + gain) * v
        read = (1 + side * model.tolerance[0]) * true + side * model.noise[0]
        rows.append([float(v + 2), float(read - 3), *map(float, x), float(true - 3)])
        x = [A[i][0] * x[0] + A[i][1] * x[1] + B[i][0] * v + side * G[i][0] / 50 for i in range(2)]
    u, y, first, second, true = np.array(rows).T[:, :, None]
    return u, y, np.hstack([first, second]), true


@pytest.mark.parametrize("method", ["zonotope", *OTHERS])
@pytest.mark.parametrize(
    "model, gain, driven",
    [
        (PLANT, 0, True),
        (PLANT.replace(D=[[0]], uncertainties=GAIN), Fraction(1, 2), True),
        (PLANT.replace(D=[[0]]), 0, False),
    ],
    ids=["D", "uncertain D", "no D"],
)
def test_bands_are_entire_where_an_input_that_acts_at_once_is_missing(model, gain, driven, method):
    u, y, states, true = exact_run(model, gain)
    u[MISSING, :] = np.nan
    found = jb.detect(jb.observer(model, method=method), u, y)
    seen = found.observation
    assert found.counts["FAULT"] == 0
    for band, truth in (
        (seen.predicted, true),
        (seen.output, true),
        (found.readings, y),
        (seen.state, states),
    ):
        lo, hi = (np.asarray(end) for end in (band.lo, band.hi))
        assert ((lo <= truth) & (truth <= hi)).all()
    for band in (seen.predicted, seen.output, found.readings):
        assert (np.isinf([band.lo, band.hi])[:, MISSING] == driven).all()
    assert np.isfinite(found.readings.lo[[11, 19, 28]]).all(), "the samples before them are told as ever"
