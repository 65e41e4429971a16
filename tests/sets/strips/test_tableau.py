"""The search on a tableau, where inner rows are more than relations: the factor and its two witnesses,
against linear programs.
"""

import numpy as np
import pytest
from scipy.optimize import linprog

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips.tableau import tableau_search

C, K, N = 4, 9, 24
search = kernel(tableau_search, static_argnums=5)


def factor(R, z, radius, present):
    """Return the least t with |d_i| <= t r_i and |z_j - R_j d| <= t r_j for the rows that are there, by a
    linear program.
    """
    rows = np.concatenate([R[present[:C]], np.eye(K)])
    r = np.concatenate([radius[:C][present[:C]], radius[C:]])[:, None]
    target = np.concatenate([z[present[:C]], np.zeros(K)])
    found = linprog(
        np.eye(K + 1)[-1],
        np.vstack([np.hstack([rows, -r]), np.hstack([-rows, -r])]),
        np.concatenate([target, -target]),
        bounds=[(None, None)] * K + [(0, None)],
        method="highs",
    )
    assert found.status == 0
    return found.fun


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_factor_is_that_of_a_linear_program_and_both_witnesses_show_it(rng, dtype):
    R = rng.normal(size=(C, K)).astype(dtype)
    R[rng.random(R.shape) < 0.3] = 0
    z, radius = rng.normal(size=(C, N)).astype(dtype), rng.uniform(0.1, 2, (C + K, N)).astype(dtype)
    present = np.concatenate([rng.random((C, N)) < 0.8, np.ones((K, N), bool)])
    present[0] = True
    z = np.where(present[:C], z, 0)
    h, d, done = map(np.asarray, search(R, z, radius, present, np.ones(N, dtype), 200))
    assert done.all() and d.shape == (K, N) and (abs(h).max(0) == 1).all()
    close = 1e-9 if dtype == np.float64 else 2e-3
    for w in range(N):
        t = factor(R.astype(float), *(x[:, w].astype(float) for x in (z, radius)), present[:, w])
        beyond = abs(h[:, w]) @ radius[:C, w] + abs(h[:, w] @ R) @ radius[C:, w]
        assert abs(abs(h[:, w] @ z[:, w]) / beyond - t) < close, "dual"
        errors = np.concatenate([np.where(present[:C, w], z[:, w] - R @ d[:, w], 0), d[:, w]])
        assert (abs(errors) <= (t + close) * radius[:, w]).all(), "primal"
