"""Windows a second where circuits are too many to enumerate: jaxbound's exchange search against HiGHS with a
reused model.

Errors are up to three times the bounds, a third of the windows is healthy. Wall time and the CPU time of the
process, both as ratios: the second holds on a machine that others use too (both cores count, HiGHS uses one).
HiGHS answers within its tolerance of 1e-7.

python -m benchmarks.long_windows [--windows 50000] [--programs 3000]
"""

import sys
import time
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb
from benchmarks import opponents, timing
from jaxbound.consistency import exchange
from jaxbound.sets.strips.separation import exchange_search

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "diagnosis"))
from boundary import GUST, SIX  # noqa: E402
from oracles import MODELS, Plant, Windows, draw  # noqa: E402

FOUR = dict(
    A=[
        [1.524825, -0.086529, 1, 0],
        [0.051043, 0.644157, 0, 1],
        [-0.527038, 0.080686, 0, 0],
        [-0.044875, 0.338076, 0, 0],
    ],
    B=[[-0.000443, 0.001075], [-0.000459, 0.004037], [0.003588, -0.00095], [0.000133, 0.000891]],
    C=[[1, 0, 0, 0], [0, 1, 0, 0]],
    noise=1.5,
)
CASES = {
    "4 states, 2 outputs, s = 15": (FOUR, 15),
    "section 5, s = 20": (MODELS["paper"], 20),
    "6 states, 3 outputs, s = 10": (SIX, 10),
    "section 5 with a disturbance, s = 6": (GUST, 6),
    "section 5 with a disturbance, s = 20": (GUST, 20),
}


@jax.jit
def done_after(test, one, u, y, steps):
    """Return which windows a search of so many steps is done with."""
    image = exchange.imaged(test, one, u, y)
    return exchange_search(test.frame.R, image.z, image.radius, image.present, one, steps)[2]


def exchanges(relations, u, y):
    """Return the mean and the largest number of exchanges that the first windows take, by bisection on the
    cap.
    """
    size = relations.test("joint", y.dtype).block
    test, one = relations.reading(y.dtype), np.ones(size)
    block = [
        np.ascontiguousarray(np.moveaxis(x[:size, :lags], 0, 2))
        for x, lags in ((u, test.lags), (y, relations.horizon + 1))
    ]
    low, high = np.zeros(size, int), np.full(size, 400)
    while (high - low > 1).any():
        for cap in np.unique((low + high) // 2):
            done = np.asarray(done_after(test, one, *block, int(cap)))
            high, low = np.where(done, np.minimum(high, cap), high), np.where(done, low, np.maximum(low, cap))

    return float(high.mean()), int(high.max())


def figures(spec, s, windows, programs):
    plant = Plant(**spec)
    u, _, y = draw(plant, s, windows, np.random.default_rng(0))
    relations = jb.parity_relations(jb.LinearSystem(**spec), s)
    start = time.perf_counter()
    jb.detect(relations, u[:1], y[:1])
    first = time.perf_counter() - start
    jb.detect(relations, u, y)
    ours = []
    for _ in range(3):
        wall, cpu = time.perf_counter(), time.process_time()
        result = jb.detect(relations, u, y)
        ours.append((time.perf_counter() - wall, time.process_time() - cpu))
    status = result.status[:, -1]
    oracle = Windows(plant, s)
    lower, upper = oracle.limits(u[:programs], y[:programs])
    program = opponents.Feasibility(oracle.O)
    wall, cpu = time.perf_counter(), time.process_time()
    infeasible = program.run(lower, upper)
    theirs = time.perf_counter() - wall, time.process_time() - cpu
    differ = np.flatnonzero((status[:programs] == jb.Status.FAULT) != infeasible)
    rate = [windows / float(np.median([t[i] for t in ours])) for i in (0, 1)]
    other = [programs / t for t in theirs]
    mean, most = exchanges(relations, u, y)
    return {
        "ratio, wall": round(rate[0] / other[0], 1),
        "ratio, CPU": round(rate[1] / other[1], 1),
        "windows/s": round(rate[0]),
        "spread": [round(windows / t) for t in (max(ours)[0], min(ours)[0])],
        "windows/CPU s": round(rate[1]),
        "HiGHS windows/s": round(other[0]),
        "first call s": round(first, 2),
        "rows, unknowns": list(oracle.O.shape),
        "exchanges, mean and most": [round(mean, 1), most],
        "FAULT": float(np.mean(status == jb.Status.FAULT)),
        "UNDECIDED": int((status == jb.Status.UNDECIDED).sum()),
        "disagreements with HiGHS": len(differ),
        "disagreements where a strict program is clear": _clear(
            oracle, u[differ], y[differ], status[differ] == jb.Status.FAULT
        ),
    }


def _clear(oracle, u, y, fault):
    """Return how many windows a program with strict tolerances decides the other way."""
    if not len(y):
        return 0
    slack = oracle.slack(u, y)
    return int(((abs(slack) > 1e-9) & ((slack > 0) != fault)).sum())


if __name__ == "__main__":
    count, programs = timing.option("--windows", 50_000), timing.option("--programs", 3000)
    timing.save(
        "long_windows",
        {"windows": count, **{name: figures(*case, count, programs) for name, case in CASES.items()}},
    )
