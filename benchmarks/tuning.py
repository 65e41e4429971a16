"""Measure jb.tune on section 5 of Adrot 2000, s = 1: a thousand steps on a million healthy windows, alone and
against faulty ones.

    python -m benchmarks.tuning [--windows 1000000] [--steps 1000] [--faulty 1000000] [--programs 400]

A step looks at the worst windows (and at a block of the faulty ones); every ten steps all windows are looked
at. Beside it what one look at everything costs, and the width that a linear program over all bounds and
states finds on a part of the recording small enough for it.
"""

import time

import jax
import numpy as np

import jaxbound as jb
from benchmarks.timing import option, save

PAPER = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0], [1, 1]])
TRUE = dict(tolerance=[0.02, 0.1], noise=[0.1, 0.01])


def recording(windows, seed, faults=()):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (windows // 50 + 2, 1)), 50, 0)[: windows + 1]
    return u, np.asarray(
        jb.simulate(jb.LinearSystem(**PAPER, **TRUE), u, jax.random.key(seed), faults=faults).y
    )


def timed(relations, healthy, faulty, steps):
    """Return wall and CPU seconds, what a first call of ten steps took, which compiles, and the
    TuneResult.
    """
    start = time.perf_counter()
    jb.tune(relations, healthy, faulty, steps=10, safety=1)
    first = time.perf_counter() - start
    start, used = time.perf_counter(), time.process_time()
    found = jb.tune(relations, healthy, faulty, steps=steps, safety=1)
    return time.perf_counter() - start, time.process_time() - used, first, found


def main():
    windows, steps, programs = option("--windows", 10**6), option("--steps", 1000), option("--programs", 400)
    guess = jb.LinearSystem(**PAPER, tolerance=[0.05, 0.05], noise=[0.05, 0.05])
    relations = jb.parity_relations(guess, 1)
    healthy = recording(windows, 0)
    figures = {"windows": windows, "steps": steps}
    start = time.perf_counter()
    for _ in range(5):
        jb.detect(relations, *healthy)
    figures["one look at all windows, s"] = (time.perf_counter() - start) / 5
    for count in (None, windows // 10, option("--faulty", windows)):
        fault = jb.Fault("y1", kind="bias", size=0.8, start=0)
        faulty = None if count is None else recording(count, 1, (fault,))
        wall, cpu, first, found = timed(relations, healthy, faulty, steps)
        figures["healthy alone" if count is None else f"against {count} faulty"] = {
            "seconds": wall,
            "CPU seconds": cpu,
            "before, ten steps with compilation": first,
            "scale": found.scale,
            "bounds": {k: np.asarray(v).tolist() for k, v in found.bounds.items()},
            "counts": found.counts,
            "caught": found.caught,
            "width at the start and at the end": [found.history["width"][0], found.history["width"][-1]],
        }
    figures["program"] = program(healthy, programs)
    save("tuning", figures)


def program(healthy, count):
    """Return the width of tune and of the linear program over noise and states, without tolerance, on the
    first windows.
    """
    from tests.studies.tuning_case import smallest_width, windows_of

    from tests.oracles import Plant

    noise = [0.1, 0.1]
    u, y = healthy[0][: count + 1], healthy[1][: count + 1]
    start = time.perf_counter()
    best, _ = smallest_width(
        Plant(**PAPER, noise=noise), 1, *windows_of(1, u, y), {"noise": np.array([10.0, 10.0])}
    )
    seconds = time.perf_counter() - start
    found = jb.tune(
        jb.parity_relations(jb.LinearSystem(**PAPER, noise=noise), 1),
        (u, y),
        steps=1000,
        calibrate=0,
        safety=1,
    )
    mine = float(found.smallest["noise"].sum() * 10)
    return {
        "windows": count,
        "width of the linear program": best,
        "of tune, relative": mine / best,
        "seconds of the program": seconds,
    }


if __name__ == "__main__":
    main()
