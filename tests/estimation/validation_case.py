"""The model of Alhaj-Dibo, Maquin, Ragot 2004, section 5, recordings of it, and what is asked of them."""

import numpy as np

import jaxbound as jb
from jaxbound.models.intervals import stacked


def paper():
    """Return the model of section 5."""
    A = [[0.45, -0.29, [0.19, 0.21]], [[-0.084, -0.076], 0.66, -0.08], [0.12, [0.114, 0.126], 0.37]]
    C = [[-5.25, [-1.576, -1.423], 1.2], [[0.949, 1.051], 0.2, -5]]
    return jb.interval_system(A, [[1], [-0.8], [[0.949, 1.051]]], C)


def record(rng, m, count, T=91, kind="steps"):
    """Draw recordings (u, x, y) with parameters anew each sample, half of the time at vertices."""
    steps = np.repeat(rng.uniform(-3, 3, (count, T // 10 + 1)), 10, 1)[:, :T, None]
    u = steps if kind == "steps" else rng.uniform(-2, 2, (count, T, 1))
    x, y = np.zeros((count, T, m.n)), np.zeros((count, T, m.p))
    x[:, 0] = rng.normal(size=(count, m.n))

    def draw(X):
        lo, hi = np.asarray(X.lo), np.asarray(X.hi)
        share = rng.random((count, *lo.shape))
        share = np.where(rng.random((count, 1, 1)) < 0.5, share, share < 0.5)
        return lo + share * (hi - lo)

    for k in range(T):
        y[:, k] = np.einsum("kij,kj->ki", draw(m.C), x[:, k])
        if k + 1 < T:
            x[:, k + 1] = np.einsum("kij,kj->ki", draw(m.A), x[:, k]) + np.einsum(
                "kij,kj->ki", draw(m.B), u[:, k]
            )
    return u, x, y


def inside(found, x, start=2):
    """Say for every sample whether the true state is in the enclosure."""
    return ((np.asarray(found.state.lo) <= x) & (x <= np.asarray(found.state.hi))).all(-1)[:, start:]


def width(found):
    return float((np.asarray(found.state.hi) - np.asarray(found.state.lo))[:, 2:].mean())


def window_systems(m, u, y):
    """Return M (12, 9) and h (.., 12) of all windows of three samples."""
    k = np.arange(2, y.shape[1])
    ends = [[-b * u[:, k - j] for j in (2, 1)] for b in (np.asarray(m.B.lo)[:, 0], np.asarray(m.B.hi)[:, 0])]
    samples = [y[:, k - j] for j in (2, 1, 0)]
    right = [
        np.concatenate([*(f(a, b) for a, b in zip(*ends, strict=True)), *samples], -1)
        for f in (np.minimum, np.maximum)
    ]
    return stacked(m, 2), jb.interval(*right)


def reference_width(m, u, y):
    """Return the mean width of step 1, which is .573 in the golden run: what widths are compared by, as they
    grow with |x|.

    Of some 256 windows, four at a time: a size that other tests compile.
    """
    M, h = window_systems(m, u, y)
    four, lo, hi = (
        M[np.array([range(9)] * 4)],
        *(np.asarray(end)[..., :9].reshape(-1, 9) for end in (h.lo, h.hi)),
    )
    some = np.linspace(0, len(lo) - 1, 256).astype(int).reshape(-1, 4)
    return float(np.mean([jb.solve_interval(four, jb.interval(lo[k], hi[k]), "hbr").x.wid for k in some]))


def faulty(y, size, sensors=(0, 1)):
    """Add faults to y1 on 20..30 and to y2 on 50..60, as in the paper."""
    bad, truth = y.copy(), np.zeros(y.shape, bool)
    for sensor, first in ((0, 20), (1, 50)):
        truth[:, first : first + 11, sensor] = sensor in sensors
    bad[truth] += size
    return bad, truth
