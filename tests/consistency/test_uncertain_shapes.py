"""Verdicts of uncertain models without states, and with states that no output shows."""

import jax
import numpy as np
from uncertain_systems import EXAMPLE, entry

import jaxbound as jb
from jaxbound import Status


def test_a_static_model_is_decided_as_the_parameter_allows(rng):
    """y1 = (1 + k) u1 + 2 u2, y2 = (3 + 2 k) u1 + 4 u2, k in [0, 0.2], noise 0.1: some k must suit both
    outputs.
    """
    k = jb.Uncertainty("k", D=[[1, 0], [2, 0]], between=(0, "0.2"))
    m = jb.LinearSystem(None, None, None, [[1, 2], [3, 4]], noise=0.1, uncertainties=[k])
    u = rng.uniform(0.5, 2, (2000, 2))
    y = (
        u @ np.array([[1, 3], [2, 4]])
        + rng.uniform(-0.05, 0.25, (2000, 1)) * u[:, :1] * [1, 2]
        + rng.uniform(-0.15, 0.15, (2000, 2))
    )
    rest, slope = y - u @ np.array([[1, 3], [2, 4]]), u[:, :1] * [1, 2]
    room = np.minimum(((rest + 0.1) / slope).min(1), 0.2) - np.maximum(((rest - 0.1) / slope).max(1), 0)
    status = jb.detect(jb.parity_relations(m), u, y).status
    clear = abs(room) > 1e-9
    assert np.array_equal((status == Status.FAULT)[clear], (room < 0)[clear])
    assert 0.2 < (room < 0).mean() < 0.8 and (status[clear & (room > 0)] != Status.UNDECIDED).mean() > 0.99


def test_a_state_that_no_output_shows_changes_no_verdict(rng):
    parameters = lambda n: [
        jb.Uncertainty("th", A=entry((n, n), (0, 0, 0.1))),
        jb.Uncertainty("vt", C=entry((1, n), (0, 0, 0.1)), varying=False),
    ]
    small = jb.LinearSystem(**EXAMPLE, noise=0.01, uncertainties=parameters(2))
    A = [[0.8, 1, 0], [0, 0.2, 0], [0.3, 0, 0.9]]
    bigger = jb.LinearSystem(A, [[0], [1], [1]], [[1, 0, 0]], noise=0.01, uncertainties=parameters(3))
    t = jb.simulate(
        bigger,
        rng.uniform(0, 2, (300, 1)),
        jax.random.key(5),
        x0=[0, 0, 7],
        faults=[jb.Fault("y1", size=1.5, start=100, stop=120)],
    )
    expected, found = (jb.detect(jb.parity_relations(m), t.u, t.y) for m in (small, bigger))
    assert np.array_equal(found.status, expected.status) and (found.status == Status.FAULT).any()
    np.testing.assert_array_equal(found.margin, expected.margin)
