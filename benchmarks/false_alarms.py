"""No false alarm, and sharp: fault-free windows drawn within bounds, half of them with every unknown at a
bound.

python -m benchmarks.false_alarms [--windows 20000000]
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import timing

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

RUNS, SAMPLES = 5000, 201
GUST = dict(disturbance=([[0], [1]], 0.1))
LONG = {
    "horizon 20": (paper(), 20),
    "disturbance, horizon 2": (paper(**GUST), 2),
    "disturbance, horizon 6": (paper(**GUST), 6),
}


def inputs(key, dtype):
    """Return u (RUNS, SAMPLES, 1), piecewise constant in [-1, 1]."""
    levels = jax.random.uniform(key, (RUNS, SAMPLES // 20 + 1, 1), dtype, -1, 1)
    return jnp.repeat(levels, 20, 1)[:, :SAMPLES]


def healthy(model, windows, dtype, horizon):
    """Count verdicts of `windows` fault-free windows, half uniform, half at vertices."""
    relations, key = (
        jb.parity_relations(model, horizon),
        jax.random.key(np.random.SeedSequence().entropy % 2**31),
    )
    counts, nearest, done = np.zeros(4, np.int64), np.inf, 0
    while done < windows:
        for at in ("uniform", "vertices"):
            key, k_u, k_s = jax.random.split(key, 3)
            u = inputs(k_u, dtype)
            result = jb.detect(relations, u, jb.simulate(model, u, k_s, at=at).y)
            counts += np.bincount(result.status.ravel(), minlength=4)
            part = slice(
                None if relations.frame is None else 20
            )  # margins has no blocks of long windows in parallel
            nearest = min(nearest, float(np.nanmin(jb.margins(relations, u[part], result.y[part]))))
            done += RUNS * (SAMPLES - horizon)
    return {
        "windows": int(counts[1:].sum()),
        "FAULT": int(counts[3]),
        "UNDECIDED": int(counts[2]),
        "smallest unproved margin": nearest,
    }


def sharpness(dtype, step, count=200_000):
    """Move windows to a gauge of 1 + step and 1 - step; return the shares proved FAULT and CONSISTENT.

    A window is moved along the ray from an exact trajectory through random data; where the gauge is reached
    is found by bisection.
    """
    relations = jb.parity_relations(paper())
    rng = np.random.default_rng(0)
    y, u = rng.normal(0, 1, (count, 2, 2)), rng.normal(0, 1, (count, 2, 1))
    O, H = np.array([[1, 0], [1, 1], [0.8, 1], [0.8, 1.2]]), np.array([0, 0, 0, 1])
    driven = np.outer(u[:, 0, 0], H)
    state = np.linalg.lstsq(O, (y.reshape(count, 4) - driven).T, rcond=None)[0]
    exact = ((O @ state).T + driven).reshape(count, 2, 2)
    shares = []
    for side, wanted in ((1 + step, jb.Status.FAULT), (1 - step, jb.Status.CONSISTENT)):
        low, high = np.zeros(count), np.full(count, 1e6)
        for _ in range(100):
            middle = (low + high) / 2
            inside = (
                1 - np.asarray(jb.margins(relations, u, exact + (y - exact) * middle[:, None, None]))[:, 1]
                < side
            )
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        moved = exact + (y - exact) * low[:, None, None]
        shares.append(
            float(np.mean(jb.detect(relations, u.astype(dtype), moved.astype(dtype)).status[:, 1] == wanted))
        )
    return {"step": step, "outside FAULT": shares[0], "inside CONSISTENT": shares[1]}


if __name__ == "__main__":
    windows = timing.option("--windows", 20_000_000)
    out = {}
    for dtype, steps in ((np.float64, (1e-9, 1e-12)), (np.float32, (1e-2, 1e-3, 1e-4))):
        name = np.dtype(dtype).name
        out[name] = {
            "horizon 1": healthy(paper(), windows, dtype, 1),
            "horizon 3": healthy(paper(), windows // 20, dtype, 3),
        }
        for case, (model, horizon) in LONG.items():
            out[name][case] = healthy(model, windows // 10, dtype, horizon)
        out[name]["sharpness"] = [sharpness(dtype, step) for step in steps]
    timing.save("false_alarms", out)
