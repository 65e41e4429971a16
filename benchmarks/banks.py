"""One monitor of four tests, windows, lags, means and an observer, beside the same tests one by one:
`jaxbound detect` of Parquet and CSV, a step of a Monitor, and the first verdict where nothing is compiled.

python -m benchmarks.banks [--rows 1000000] [--steps 2000] [--here]

With --here only what one process does: `jb.detect` of arrays, and the Monitor. Seconds are of whole commands,
compiled kernels kept, but for "nothing compiled": 1 000 rows, an empty folder of kernels. Processor seconds
depend less on what else the machine does.
"""

import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq

import jaxbound as jb
from benchmarks import timing
from benchmarks.parquet import run

SAMPLES = {"dt": 0.01, "disturbance": (((0.01,), (0.01,)), 0.1)}
MEANS = [{"name": name, "averages": [{"samples": 8, "bound": 0.09}]} for name in ("y1", "y2")]
TESTS = (
    {"name": "windows", "horizon": 15},
    {"name": "lags", "lags": (0, 1, 2, 4, 8, 16, 32)},
    {"name": "means", "horizon": 15, "model": {"outputs": MEANS}},
    {"name": "observer", "observer": "zonotope"},
)
FEW = 1000  # rows of the first verdict
FORMATS = "parquet", "csv"


def plant(tests=TESTS):
    """Return a plant of two states and two sensors that states tests."""
    matrices = [[0.8, 0.1], [0, 0.5]], [[0], [1]], [[1, 0], [1, 1]]
    return jb.LinearSystem(*matrices, noise=[0.1, 0.1], tests=tests, **SAMPLES)


def recording(rows):
    """Return (u, y) of the plant, with one error in the middle."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (-(-rows // 20), 1)), 20, 0)[:rows]
    fault = jb.Fault("y1", "bias", 0.5, rows // 2, rows // 2 + 50)
    return u, np.asarray(jb.simulate(plant(), u, jax.random.key(0), x0=np.zeros(2), faults=[fault]).y)


def write(folder, name, u, y):
    """Write a recording as Parquet and as CSV."""
    columns = {"time": np.round(0.01 * np.arange(len(u)), 2), "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]}
    table = pa.table(columns)
    pq.write_table(table, folder / f"{name}.parquet")
    pcsv.write_csv(table, folder / f"{name}.csv")


def models():
    """Return {name: the tests of its file}: the monitor of all, and each alone."""
    return {"bank": TESTS, **{test["name"]: (test,) for test in TESTS}}


def commands(folder):
    """Return {format: {name: figures}} of the recording "run", kernels kept."""
    found = {}
    for form in FORMATS:
        found[form] = {}
        for name in models():
            files = {"model": f"{name}.toml", "data": f"run.{form}"}
            run(folder, "first", **files)
            found[form][name] = run(folder, f"{name}-{form}", **files)
            print(form, name, found[form][name], flush=True)
    return found


def cold(folder):
    """Return {name: seconds} of the first verdicts of a few rows, nothing compiled, and once more."""
    found = {}
    for name in models():
        with tempfile.TemporaryDirectory() as cache:
            files = {"model": f"{name}.toml", "data": "few.csv", "cache": cache}
            first = run(folder, f"{name}-cold", **files)
            again = run(folder, f"{name}-warm", **files)
        found[name] = {"nothing compiled": first, "again": again}
        print("first", name, found[name], flush=True)
    return found


def in_memory(u, y):
    """Return {name: processor seconds} of `jb.detect` of arrays, compiled before."""
    found = {}
    for name, tests in models().items():
        bank = jb.monitor(plant(tests))
        each = []
        for _ in range(2):
            start = time.process_time()
            jb.detect(bank, u, y)
            each.append(time.process_time() - start)
        found[name] = {"processor s": round(each[1], 2)}
        print("in memory", name, found[name], flush=True)
    return found


def steps(u, y):
    """Return {name: median milliseconds of a sample} of a Monitor."""
    found = {}
    for name, tests in models().items():
        watch = jb.Monitor(jb.monitor(plant(tests)))
        state, each = watch.init(), []
        for k in range(len(u)):
            start = time.perf_counter()
            state, _ = watch.step(state, u[k], y[k])
            each.append(time.perf_counter() - start)
        found[name] = round(1000 * float(np.median(each[len(each) // 10 :])), 3)
    return found


def beside(found, key):
    """Return what the monitor needs over what its tests need one by one."""
    parts = [found[test["name"]][key] for test in TESTS]
    return round(found["bank"][key] / sum(parts), 2)


def shell(u, y):
    """Return the figures of commands."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for name, tests in models().items():
            jb.save_model(plant(tests), folder / f"{name}.toml")
        write(folder, "run", u, y)
        write(folder, "few", u[:FEW], y[:FEW])
        figures = {"commands": commands(folder), "first verdict": cold(folder)}
    for form in FORMATS:
        found = figures["commands"][form]
        figures[f"{form}: bank over parts"] = {key: beside(found, key) for key in ("seconds", "processor s")}
    return figures


def main():
    """Measure, save the figures and print them."""
    rows, count = timing.option("--rows", 1_000_000), timing.option("--steps", 2000)
    u, y = recording(rows)
    found = in_memory(u, y)
    figures = {"rows": rows, "in memory": found, "bank over parts": beside(found, "processor s")}
    figures["monitor, ms a sample"] = steps(u[:count], y[:count])
    if "--here" not in sys.argv:
        figures |= shell(u, y)
    timing.save("banks", figures)


if __name__ == "__main__":
    main()
