"""Measure jb.validate on the system of Alhaj-Dibo, Maquin, Ragot 2004: windows a second, and what faults of
each size do.

    python -m benchmarks.validation [--recordings 2048] [--joint 128] [--trials 64]

The limit of "sequential": four systems of 9 unknowns whose matrices never change, so that a window is 4 x 9 x
9 x 3 = 972 multiplications and additions (the middle of C h, its radius, and what the other unknowns add) and
27 interval products: with four of them a cycle at 2.5 GHz 0.1 microseconds a core. What is measured besides
is the walk through memory between some forty kernels a window.

Faults on y1 in 20..30, on y2 in 50..60, or on both in 20..30, are given in units of the mean width of the
first of the paper's systems, whose recomputed value is .573 where a fault of 1 is one unit.
"""

import time

import numpy as np

from benchmarks.timing import option, save

T, S = 91, 2
SIZES = (0.5, 1, 2, 3, 4, 6, 12)
PLACES = {"y1": ((0, 20),), "y2": ((1, 50),), "both": ((0, 20), (1, 20))}


def model():
    import jaxbound as jb

    A = [[0.45, -0.29, [0.19, 0.21]], [[-0.084, -0.076], 0.66, -0.08], [0.12, [0.114, 0.126], 0.37]]
    C = [[-5.25, [-1.576, -1.423], 1.2], [[0.949, 1.051], 0.2, -5]]
    return jb.interval_system(A, [[1], [-0.8], [[0.949, 1.051]]], C)


def recordings(m, count, seed=0):
    """Return (u, x, y): steps, parameters anew each sample."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3, 3, (count, T // 10 + 1)), 10, 1)[:, :T, None]
    x, y = np.zeros((count, T, m.n)), np.zeros((count, T, m.p))
    x[:, 0] = rng.normal(size=(count, m.n))
    draw = lambda X: np.asarray(X.lo) + rng.random((count, *X.shape)) * (np.asarray(X.hi) - np.asarray(X.lo))
    for k in range(T):
        y[:, k] = np.einsum("kij,kj->ki", draw(m.C), x[:, k])
        if k + 1 < T:
            x[:, k + 1] = np.einsum("kij,kj->ki", draw(m.A), x[:, k]) + np.einsum(
                "kij,kj->ki", draw(m.B), u[:, k]
            )
    return u, x, y


def speed(method, count, repeats=5):
    import jaxbound as jb

    m = model()
    u, x, y = recordings(m, count)
    rows = []
    for _ in range(repeats + 1):
        wall, cpu = time.perf_counter(), time.process_time()
        found = jb.validate(m, u, y, method=method)
        rows.append((time.perf_counter() - wall, time.process_time() - cpu))
    windows = count * (T - S)
    wall, cpu = np.median(rows[1:], 0)
    return {
        "recordings": count,
        "windows_per_s": round(windows / wall),
        "windows_per_cpu_s": round(windows / cpu),
        "fastest_windows_per_s": round(windows / min(r[0] for r in rows[1:])),
        "first_call_s": round(rows[0][0], 2),
        "first_call_cpu_s": round(rows[0][1], 2),
        "mean_width": round(float((found.state.hi - found.state.lo)[:, S:].mean()), 4),
    }


def unit(m, u, y):
    """Return the size of a fault of 1: the scale of the signals against that of the recomputed run."""
    import jaxbound as jb
    from jaxbound.models.intervals import stacked

    k = np.arange(S, T)
    ends = [[-b * u[:, k - j] for j in (2, 1)] for b in (np.asarray(m.B.lo)[:, 0], np.asarray(m.B.hi)[:, 0])]
    samples = y[:, k - 2], y[:, k - 1][..., :1]
    right = [
        np.concatenate([*(f(a, b) for a, b in zip(*ends, strict=True)), *samples], -1)
        for f in (np.minimum, np.maximum)
    ]
    return float(jb.solve_interval(stacked(m, S)[:9], jb.interval(*right), "gauss").x.wid.mean()) / 0.573


def table(method, count):
    """Return {place: {size: shares}}: faulty samples found and blamed, sound samples blamed, windows with the
    state inside.
    """
    import jaxbound as jb

    m = model()
    u, x, y = recordings(m, count, seed=1)
    one, out = unit(m, u, y), {}
    for place, where in PLACES.items():
        for size in SIZES:
            truth = np.zeros(y.shape, bool)
            for sensor, first in where:
                truth[:, first : first + 11, sensor] = True
            found = jb.validate(m, u, y + size * one * truth, method=method)
            faulty, fault = np.asarray(found.faulty), np.asarray(found.status) == jb.Status.FAULT
            inside = ((np.asarray(found.state.lo) <= x) & (x <= np.asarray(found.state.hi))).all(-1)[:, S:]
            shares = faulty[truth].mean(), fault[truth.any(-1)].mean(), faulty[~truth].mean(), inside.mean()
            row = dict(
                zip(
                    ("located", "detected", "wrongly_blamed", "inside"),
                    (round(float(v), 4) for v in shares),
                    strict=True,
                )
            )
            out.setdefault(place, {})[str(size)] = row
            print(f"{method:10s} {place:4s} f={size:<4}", row)
    return out


def main():
    speeds = {
        "sequential": speed("sequential", option("--recordings", 2048)),
        "joint": speed("joint", option("--joint", 128), 3),
    }
    tables = {method: table(method, option("--trials", 64)) for method in ("sequential", "joint")}
    save("validation", {"speed": speeds, "faults": tables})


if __name__ == "__main__":
    main()
