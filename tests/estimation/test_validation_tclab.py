"""Data validation of real recordings: parameter intervals from runs of two days, judged on a run of a third
day.
"""

import numpy as np
import pandas as pd
import pytest

import jaxbound as jb

NOISE, PUSHED = 0.5, 0.1
"""Bounds in degC: of a sensor, and of what first-order dynamics leave out in a step of three seconds."""


def run(shared, name, every=1):
    """Return heaters (T, 2) in percent and temperatures (T, 2) in degC above the first ones, every three
    seconds.
    """
    table = pd.read_csv(shared(f"data/tclab/{name}.csv"), skipinitialspace=True).to_numpy()[::every]
    return table[:, 1:3], table[:, 3:5] - table[0, 3:5]


@pytest.fixture(scope="module")
def plant(shared):
    """Return (model, u, y): the hull of two least-squares fits as parameter intervals, and the unseen run."""
    fits = []
    for u, y in (run(shared, "mimo_prbs_3s"), run(shared, "mimo_energy_1s", 3)):
        fits.append(np.linalg.lstsq(np.hstack([y[:-1], u[:-1]]), y[1:], rcond=None)[0].T)
    lo, hi = np.min(fits, 0), np.max(fits, 0)
    middle, radius = (lo + hi) / 2, (hi - lo) / 2
    only = lambda i, j: [[float(radius[i, j]) if (a, b) == (i, j) else 0 for b in range(4)] for a in range(2)]
    each = {f"{i}{j}": np.array(only(i, j)) for i in range(2) for j in range(4)}
    uncertain = [jb.Uncertainty(f"p{k}", A=v[:, :2].tolist(), B=v[:, 2:].tolist()) for k, v in each.items()]
    A, B = middle[:, :2].tolist(), middle[:, 2:].tolist()
    pushed = ([[1, 0], [0, 1]], PUSHED)
    model = jb.LinearSystem(A, B, [[1, 0], [0, 1]], noise=NOISE, disturbance=pushed, uncertainties=uncertain)
    return model, *run(shared, "mimo_hybrid_3s")


def validate(model, u, y):
    """Validate recordings with windows of five samples; the first state is what the first samples say."""
    return jb.validate(model, u, y, horizon=4, x0=jb.interval(y[:, 0] - NOISE, y[:, 0] + NOISE))


@pytest.mark.long(by_day="estimation/test_validation::test_the_paper_s_system")
def test_enclosures_hold_on_the_unseen_run_and_a_bias_is_located_and_corrected(plant):
    model, u, y = plant
    onsets = np.arange(20, 190, 10)
    many = lambda x: np.repeat(x[None], len(onsets), 0)
    after = np.arange(len(y)) >= onsets[:, None]
    still = after & (np.arange(len(y)) < onsets[:, None] + 5)

    healthy = validate(model, many(u), many(y))
    assert not (np.asarray(healthy.status) == jb.Status.FAULT).any()
    lost = many(y)
    lost[..., 0] = np.where(still, np.nan, lost[..., 0])
    holds = validate(model, many(u), lost).output
    assert ((np.asarray(holds.lo) - NOISE <= many(y)) & (many(y) <= np.asarray(holds.hi) + NOISE))[
        :, 4:
    ].all()

    biased = many(y)
    biased[..., 0] += 2.0 * after
    found = validate(model, many(u), biased)
    first = np.array([np.asarray(found.faulty)[i, o : o + 3, 0] for i, o in enumerate(onsets)])
    print(
        f"located at once {first[:, 0].mean():.0%}, within three samples {first.any(1).mean():.0%} of "
        f"{len(onsets)} onsets"
    )
    assert not np.asarray(found.faulty)[~after].any() and not np.asarray(found.faulty)[..., 1][still].any()
    assert first[:, 0].mean() >= 0.8 and first.any(1).mean() >= 0.9
    at = np.asarray(found.faulty)[..., 0] & still
    lo, hi = (np.asarray(end)[..., 0][at] for end in (found.corrected.lo, found.corrected.hi))
    true = many(y)[..., 0][at]
    assert ((lo - NOISE <= true) & (true <= hi + NOISE)).all()
    off = np.abs((lo + hi) / 2 - true).max()
    print(
        f"{at.sum()} samples located: corrected {np.mean(hi - lo):.2f} degC wide, its centre off by "
        f"{off:.2f} at most"
    )
    assert off < 2.0  # nearer than the biased sample
