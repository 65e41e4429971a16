"""Seconds of `jaxbound fleet` on units of one shape with numbers of their own; where they go; how often a
kernel is traced.

Every 20th unit has a biased sensor for 200 samples. No healthy unit may have a FAULT.

python -m benchmarks.fleet [--units 2000] [--samples 10000]
"""

import csv
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

import jaxbound as jb
from benchmarks import timing
from jaxbound.consistency import strips
from jaxbound.recordings.read import read
from jaxbound.runs.fleet import detect_fleet, read_manifest

FAULTY = 20
RNG = np.random.default_rng(0)


def unit_model(i):
    """Return a model of the paper's shape with entries of four digits."""
    near = lambda x: float(f"{x * RNG.uniform(0.9, 1.1):.4g}")
    return jb.LinearSystem(
        [[near(0.8), near(1)], [0, near(0.2)]],
        [[0], [near(1)]],
        [[near(1), 0], [near(1), near(1)]],
        tolerance=[0.02, 0.1],
        noise=[0.1, 0.01],
        resolution=0.0005,
        name=f"unit {i}",
    )


def simulate(models, samples):
    """Return u (T, N) and y (T, N, 2) of all units at once, rounded to the decimals of a recorder."""
    array = lambda name: np.array([[[float(x) for x in row] for row in getattr(m, name)] for m in models])
    A, B, C = map(array, "ABC")
    count = len(models)
    u = np.repeat(RNG.uniform(-1, 1, (samples // 20 + 1, count)).round(3), 20, 0)[:samples]
    x, y = np.zeros((count, 2)), np.empty((samples, count, 2))
    for k in range(samples):
        y[k] = np.einsum("npi,ni->np", C, x)
        x = np.einsum("nij,nj->ni", A, x) + B[:, :, 0] * u[k][:, None]
    y *= 1 + RNG.uniform(-1, 1, y.shape) * [0.02, 0.1]
    y += RNG.uniform(-1, 1, y.shape) * [0.1, 0.01]
    y[samples // 2 : samples // 2 + 200, ::FAULTY, 0] += 2
    return u, y.round(3)


def write(folder, models, u, y):
    """Write model files, recordings and two manifests, one of CSV and one of Parquet files."""
    time_column = pa.array(np.arange(len(u), dtype=float))
    for i, m in enumerate(models):
        jb.save_model(m, folder / f"m{i}.toml")
        table = pa.table({"t": time_column, "u1": u[:, i], "y1": y[:, i, 0], "y2": y[:, i, 1]})
        pyarrow.csv.write_csv(table, folder / f"r{i}.csv")
        pyarrow.parquet.write_table(table, folder / f"r{i}.parquet")
    for kind in ("csv", "parquet"):
        with open(folder / f"{kind}.csv", "w", newline="") as f:
            rows = [(f"P-{i}", f"m{i}.toml", f"r{i}.{kind}") for i in range(len(models))]
            csv.writer(f).writerows([("unit", "model", "recording"), *rows])


def shell(folder, kind):
    """Return the seconds of one run of the command with an empty compilation cache, on the clock and of all
    cores, and its table.
    """
    spent = lambda: sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    program = shutil.which("jaxbound", path=Path(sys.executable).parent) or "jaxbound"
    command = [program, "fleet", f"{kind}.csv", "--out", f"out-{kind}"]
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / f"cache-{kind}")}
    start, before = time.perf_counter(), spent()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    seconds = {"wall": round(time.perf_counter() - start, 1), "cpu": round(spent() - before, 1)}
    if done.returncode != 1:
        raise RuntimeError(done.stderr or done.stdout)
    with open(folder / f"out-{kind}" / "fleet.csv", newline="", encoding="utf-8") as f:
        return seconds, list(csv.DictReader(f))


def check(table, count):
    """Refuse a false alarm or a missed fault."""
    found = {row["unit"] for row in table if row["verdict"] == "fault"}
    expected = {f"P-{i}" for i in range(0, count, FAULTY)}
    healthy = {row["unit"] for row in table if row["verdict"] == "no fault"}
    if found != expected or len(healthy) != count - len(expected):
        raise AssertionError(f"faults found in {sorted(found ^ expected)[:5]}, which is wrong")


def stages(folder, units):
    """Return milliseconds a unit of each stage alone, one after the other."""
    seconds = dict.fromkeys(("model", "relations", "read csv", "read parquet", "detect"), 0.0)
    for unit in units:
        lap = [time.perf_counter()]
        model = jb.load_model(unit.model)
        lap.append(time.perf_counter())
        relations = jb.parity_relations(model)
        lap.append(time.perf_counter())
        r = read(unit.recording, model)
        lap.append(time.perf_counter())
        read(unit.recording.with_suffix(".parquet"), model)
        lap.append(time.perf_counter())
        jb.detect(relations, r.u, r.y, starts=r.starts)
        lap.append(time.perf_counter())
        for name, spent in zip(seconds, np.diff(lap), strict=True):
            seconds[name] += spent
    return {name: round(1e3 * s / len(units), 2) for name, s in seconds.items()}


def main():
    count, samples = timing.option("--units", 2000), timing.option("--samples", 10_000)
    models = [unit_model(i) for i in range(count)]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write(folder, models, *simulate(models, samples))
        wall = {}
        for kind in ("csv", "parquet"):
            wall[kind], table = shell(folder, kind)
            check(table, count)
        units = read_manifest(folder / "csv.csv")[: min(count, 100)]
        before = strips.verdicts._cache_size()
        list(detect_fleet(units))
        traces = strips.verdicts._cache_size() - before
        alone = stages(folder, units)
    timing.save(
        "fleet",
        {
            "units": count,
            "samples a unit": samples,
            "seconds of the whole command": wall,
            "milliseconds a unit, one stage after the other": alone,
            "traces of the kernel": traces,
        },
    )


if __name__ == "__main__":
    main()
