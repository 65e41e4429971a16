"""Long windows of whole recordings, of which most are easy: verdicts a second of processor time.

`detect` as it is (a projection settles easy windows, a search the others) against the search alone, against
one fixed projection in NumPy, which settles fewer windows and proves nothing, and against two solvers of
programs: HiGHS with a reused model and moreau's compiled batches, both within their tolerances. Calls by
turns, the least of several.

python -m benchmarks.easy_windows [--windows 1000000] [--search 50000] [--programs 2000]
"""

import sys
import time
from pathlib import Path

import numpy as np

import jaxbound as jb
from benchmarks import opponents, timing
from benchmarks.long_windows import FOUR

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from boundary import GUST  # noqa: E402
from oracles import MODELS, Plant, Windows  # noqa: E402

LAGS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 17, 22, 29, 37, 48, 60)
HEATER = FOUR, {"horizon": 15}
"""The model of two heaters in a laboratory, windows of 16 samples."""
WIDER = 1.25
"""How much wider bounds are than the errors of healthy sensors."""


def uniform(rng, shape):
    return rng.uniform(-1, 1, shape) / WIDER


def vertices(rng, shape):
    return rng.choice([-1.0, 1.0], shape) / WIDER


def half(rng, shape):
    """Return errors with 1.33 bounds more in the first output of the second half."""
    e = uniform(rng, shape)
    e[shape[0] // 2 :, 0] += 2 / 1.5
    return e


def stretches(rng, shape):
    """Return errors with two bounds more in the first output, in every second hundred samples."""
    e = uniform(rng, shape)
    e[np.arange(shape[0]) // 100 % 2 == 1, 0] += 2
    return e


CASES = {
    "heater, uniform x 1.25": (*HEATER, uniform),
    "heater, vertices x 1.25": (*HEATER, vertices),
    "heater, T1 + 2 degC in half": (*HEATER, half),
    "heater, T1 + 3 degC in every second 100 samples": (*HEATER, stretches),
    "section 5, 21 samples": (MODELS["paper"], {"horizon": 20}, uniform),
    "section 5, 21 samples, vertices x 1.25": (MODELS["paper"], {"horizon": 20}, vertices),
    "section 5 with a disturbance, 21 samples": (GUST, {"horizon": 20}, uniform),
    "section 5 with a disturbance, 21 samples, vertices x 1.25": (GUST, {"horizon": 20}, vertices),
    "heater, 16 lags of 61 samples": (FOUR, {"lags": LAGS}, uniform),
}


def recorded(spec, samples, errors, rng):
    """Return (u, y) of a recording: inputs as large as bounds are, errors as shares of these."""
    A, B, C = (np.array(spec[key], float) for key in "ABC")
    u = 20 * rng.normal(size=(samples, B.shape[1]))
    driven = u @ B.T
    if "disturbance" in spec:
        G, bound = spec["disturbance"]
        driven += bound * rng.uniform(-1, 1, (samples, 1)) @ np.array(G, float).T / WIDER
    y, x = np.empty((samples, len(C))), np.zeros(len(A))
    for k, now in enumerate(driven):
        y[k] = C @ x
        x = A @ x + now
    sigma, rho = (np.broadcast_to(spec.get(key, 0), len(C)) for key in ("tolerance", "noise"))
    return u, y + errors(rng, y.shape) * (rho + sigma * abs(y))


def at_boundary(spec, s, count, rng):
    """Return windows u (N, s + 1, m), y (N, s + 1, p) within 1e-3 of the boundary: errors of each scaled so
    that its factor is 1 + 1e-3 or 1 - 1e-3, half of them consistent.
    """
    relations = jb.parity_relations(jb.LinearSystem(**spec), s)
    u, y = recorded(spec, count * (s + 1), uniform, rng)
    healthy = recorded(spec, count * (s + 1), lambda rng, shape: np.zeros(shape), np.random.default_rng(0))[1]
    u, y, healthy = (x.reshape(count, s + 1, -1) for x in (u, y, healthy))
    factor = 1 - jb.detect(relations, u, y, margins="exact").margin[:, -1]
    wanted = 1 + 1e-3 * rng.choice([-1.0, 1.0], count)
    return u, healthy + (y - healthy) * (wanted / factor)[:, None, None]


class Projected:
    """One fixed projection of windows in NumPy: which of them the first state of least squares explains,
    without any rounding outward. Blocks stay in the cache, one thread.
    """

    BLOCK = 2**11

    def __init__(self, oracle):
        O, bound = oracle.O, np.tile(oracle.noise, oracle.s + 1)
        P = np.eye(len(O)) - O @ np.linalg.pinv(O)
        self.s, self.rows = oracle.s, (P / bound[:, None]).astype(float)
        self.inputs = -self.rows @ oracle.H

    def run(self, u, y):
        """Return (T - s,) bool of a recording u (T, m), y (T, p)."""
        count, s = len(y) - self.s, self.s
        lags = self.inputs.shape[1] // u.shape[1]
        out = np.empty(count, bool)
        for first in range(0, count, self.BLOCK):
            stop = min(first + self.BLOCK, count)
            Y = np.concatenate([y[first + j : stop + j].T for j in range(s + 1)])
            U = np.concatenate([u[first + j : stop + j].T for j in range(lags)])
            e = self.rows @ Y
            e += self.inputs @ U
            np.abs(e, out=e)
            out[first:stop] = e.max(0) <= 1
        return out


def least(calls, repeats=5):
    """Return {name: (processor time, wall time)}, the least of calls by turns, behind one call each."""
    times = {}
    for name, call in calls.items():
        call()
        times[name] = [np.inf, np.inf]
    for _ in range(repeats):
        for name, call in calls.items():
            wall, cpu = time.perf_counter(), time.process_time()
            call()
            spent = time.process_time() - cpu, time.perf_counter() - wall
            times[name] = np.minimum(times[name], spent)
    return times


def figures(spec, window, errors, count, searched, programs):
    """Return the rates of one case, in millions of windows a second."""
    rng = np.random.default_rng(0)
    relations = jb.parity_relations(jb.LinearSystem(**spec), **window)
    s = relations.horizon
    u, y = recorded(spec, count + s, errors, rng)
    some = slice(0, searched + s)
    start = time.process_time()
    result = jb.detect(relations, u, y)
    first = time.process_time() - start
    calls = {
        "detect": lambda: jb.detect(relations, u, y),
        "search alone": lambda: jb.detect(relations, u[some], y[some], margins="exact"),
    }
    counts = {"detect": count, "search alone": searched}
    others = {}
    if "horizon" in window:
        oracle = Windows(Plant(**spec), s)
        at = np.linspace(0, count - 1, programs).astype(int)
        lower, upper = oracle.limits(*(x[at[:, None] + np.arange(s + 1)] for x in (u, y)))
        others = solvers(oracle.O, lower, upper, result.status[at + s] == jb.Status.FAULT)
    if "horizon" in window and "disturbance" not in spec:
        projected = Projected(oracle)
        calls["NumPy, one projection"] = lambda: projected.run(u, y)
        counts["NumPy, one projection"] = count
    times = least(calls)
    alone = jb.detect(relations, u[some], y[some], margins="exact").status
    rates = {name: counts[name] / times[name] for name in calls}
    out = {"windows": count, "first call, CPU s": round(first, 2)}
    for name, (cpu, wall) in rates.items():
        out[name] = {"M/CPU s": round(cpu / 1e6, 3), "M/s": round(wall / 1e6, 3)}
    for name, (rate, found) in others.items():
        out[name] = {"M/CPU s": round(rate / 1e6, 5), "disagreements": int(found)}
    out["detect / search alone"] = round(rates["detect"][0] / rates["search alone"][0], 2)
    if "NumPy, one projection" in rates:
        out["detect / NumPy"] = round(rates["detect"][0] / rates["NumPy, one projection"][0], 2)
        out["settled by NumPy"] = round(float(projected.run(u, y).mean()), 4)
    out["statuses that differ from the search"] = int((alone != result.status[some]).sum())
    out["FAULT"] = round(result.counts["FAULT"] / count, 4)
    out["UNDECIDED"] = result.counts["UNDECIDED"]
    return out


def solvers(M, lower, upper, fault):
    """Return {name: (programs a CPU second, verdicts that differ)} of those that are installed."""
    found = {}
    for name, kind in {"HiGHS": opponents.Feasibility, "moreau": opponents.Batched}.items():
        try:
            program = kind(M)
        except ImportError:
            continue
        program.run(lower[:8], upper[:8])
        cpu = time.process_time()
        infeasible = program.run(lower, upper)
        found[name] = len(lower) / (time.process_time() - cpu), int((infeasible != fault).sum())
    return found


def near(count, programs):
    """Return the rates of windows within 1e-3 of the boundary, each a recording of its own."""
    spec, window = HEATER
    relations = jb.parity_relations(jb.LinearSystem(**spec), **window)
    u, y = at_boundary(spec, relations.horizon, count, np.random.default_rng(0))
    times = least(
        {
            "detect": lambda: jb.detect(relations, u, y),
            "search alone": lambda: jb.detect(relations, u, y, margins="exact"),
        }
    )
    both = [jb.detect(relations, u, y, margins=kind) for kind in ("bounds", "exact")]
    oracle = Windows(Plant(**spec), relations.horizon)
    fault = both[0].status[:programs, -1] == jb.Status.FAULT
    out = {"windows": count}
    for name, (cpu, wall) in times.items():
        out[name] = {"M/CPU s": round(count / cpu / 1e6, 3), "M/s": round(count / wall / 1e6, 3)}
    for name, (rate, found) in solvers(oracle.O, *oracle.limits(u[:programs], y[:programs]), fault).items():
        out[name] = {"M/CPU s": round(rate / 1e6, 5), "disagreements": int(found)}
    out["detect / search alone"] = round(times["search alone"][0] / times["detect"][0], 2)
    out["statuses that differ from the search"] = int((both[0].status != both[1].status).sum())
    out["FAULT"] = round(both[0].counts["FAULT"] / count, 4)
    return out


if __name__ == "__main__":
    count = timing.option("--windows", 1_000_000)
    searched, programs = timing.option("--search", 50_000), timing.option("--programs", 2000)
    found = {name: figures(*case, count, searched, programs) for name, case in CASES.items()}
    found["heater, within 1e-3 of the boundary"] = near(searched, programs)
    timing.save("easy_windows", found)
