"""Given filters: the regression against one written out here, stretch by stretch, with the first states as
unknowns of their own.
"""

import numpy as np
import pytest
from scipy.signal import lfilter

import jaxbound as jb
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification import filters, regression

POLES = [0.9, 0.6]


def plant(rng, T, B, D, level=20.0, noise=0.0):
    """Return (u, y) of y = level + D u + x1 + x2, x+ = a x + B u, from a first state that is not 0."""
    u = rng.normal(size=(T, B.shape[2]))
    y = level + u @ D.T + noise * rng.uniform(-1, 1, (T, len(D)))
    for a, b in zip(POLES, B, strict=True):
        y += lfilter([0, 1], [1, -a], u @ b.T, axis=0) + rng.normal(size=len(D)) * a ** np.arange(T)[:, None]
    return u, y


def same_scales(m, p):
    return regression.Scales(np.zeros(m), np.ones(m), np.zeros(p), np.ones(p))


@pytest.mark.parametrize("direct", [True, False])
def test_a_plant_of_this_form_is_recovered(rng, monkeypatch, direct):
    monkeypatch.setattr(filters, "RIDGE", 0.0)
    B, D = rng.normal(size=(2, 2, 3)), rng.normal(size=(2, 3)) * direct
    records = [(*plant(rng, T, B, D), np.zeros(0, int)) for T in (80, 60)]
    found = filters.filtered(records, same_scales(3, 2), POLES, direct)
    for got, true in zip(found, (B, D, np.full(2, 20.0)), strict=False):
        np.testing.assert_allclose(got, true, atol=1e-8)
    assert (found[3] < 1e-8).all()


def test_each_stretch_has_its_own_first_states_and_missing_outputs_are_left_out(rng, monkeypatch):
    monkeypatch.setattr(filters, "RIDGE", 0.0)
    u, y = rng.normal(size=(90, 2)), rng.normal(size=(90, 1))
    u[40, 1], y[60, 0] = np.nan, np.nan
    B, D, c, _ = filters.filtered([(u, y, np.array([25]))], same_scales(2, 1), POLES, True)
    rows, targets = [], []
    stretches = [(0, 25), (25, 40), (41, 90)]
    for number, (first, stop) in enumerate(stretches):
        columns = [
            u[first:stop],
            *(lfilter([0, 1], [1, -a], u[first:stop], axis=0) for a in POLES),
            np.ones((stop - first, 1)),
        ]
        free = np.zeros((stop - first, 2 * len(stretches)))
        free[:, 2 * number : 2 * number + 2] = np.array(POLES) ** np.arange(stop - first)[:, None]
        known = ~np.isnan(y[first:stop, 0])
        rows.append(np.hstack([*columns, free])[known])
        targets.append(y[first:stop, 0][known])
    theta = np.linalg.lstsq(np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    np.testing.assert_allclose(np.concatenate([D[0], B[0, 0], B[1, 0], c]), theta[:7], atol=1e-9)


def test_poles_fade_within_the_window(rng):
    for s in (4, 15, 60):
        poles = filters.poles_of(3, s)
        assert poles == sorted(poles, reverse=True) and all(0 < a**s <= 0.051 for a in poles)


def test_no_state_follows_a_lasting_error(rng):
    """The reason for this kind: a leak that the plant's own slow pole would hide is FAULT in every window."""
    B, D = np.array([[[0.05]], [[0.2]]]), np.array([[0.3]])
    u, y = plant(rng, 400, B, D, noise=0.1)
    model = jb.fit((u, y), order=2, horizon=30, direct=True, method="filters", held_out=0)
    assert (
        model.check.method == "filters"
        and model.check.steady["y1"] < 1.0
        and (model.n, model.horizon) == (2, 30)
    )
    healthy, leak = (plant(rng, 200, B, D, level, 0.1) for level in (20.0, 21.0))
    r = jb.parity_relations(model)
    assert (jb.detect(r, *leak).status[30:] == Status.FAULT).all()
    assert not (jb.detect(r, *healthy).status == Status.FAULT).any()
