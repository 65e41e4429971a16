"""`jaxbound detect` on Parquet larger than one would hold in memory: peak memory, seconds apart, a kill at
half, two sizes of a chunk.

python -m benchmarks.parquet [--rows 20000000] [--file 1000000] [--observer]

With --observer the same of a set observer, which carries on from part to part.
"""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import jaxbound as jb
from benchmarks import timing

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

OBSERVER = "--observer" in sys.argv
START = np.datetime64("2020-01-01T00:00:00", "us")


def generate(folder, rows, size):
    """Write the paper's plant as files of `size` rows that continue each other, with a bias of 0.3 on y1 for
    50 samples in each.
    """
    model, rng, x = paper(), np.random.default_rng(0), np.zeros(2)
    A, B = (np.array(m, float) for m in (model.A, model.B))
    folder.mkdir(parents=True)
    for i, first in enumerate(range(0, rows, size)):
        n = min(size, rows - first)
        u = np.repeat(rng.uniform(-1, 1, (n // 20 + 1, 1)), 20, 0)[:n]
        run = jb.simulate(
            model, u, jax.random.key(i), x0=x, faults=[jb.Fault("y1", "bias", 0.3, n // 2, n // 2 + 50)]
        )
        x = A @ np.asarray(run.x)[-1] + B @ u[-1]
        time = START + 10_000 * np.arange(first, first + n)
        columns = {"time": time, "u1": u[:, 0], **{f"y{j + 1}": np.asarray(run.y)[:, j] for j in range(2)}}
        pq.write_table(pa.table(columns), folder / f"run-{i}.parquet")


def command(out, *options, model="model.toml", data="run"):
    """Return the command line of one run."""
    jaxbound = shutil.which("jaxbound", path=Path(sys.executable).parent) or "jaxbound"
    method = ("--method", "observer") if OBSERVER else ()
    return [jaxbound, "detect", model, data, "--out", out, "--json", *method, *options]


def run(folder, out, *options, cache=None, **files):
    """Return seconds, processor seconds, peak memory in MB, the seconds of each stage and the counts of one
    run to its end. cache: the folder of compiled kernels, None: that of the user; files: as of `command`.
    """
    start, before, peak = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN), 0
    env = dict(os.environ)
    if cache is not None:
        env |= {"XDG_CACHE_HOME": str(cache), "JAX_COMPILATION_CACHE_DIR": str(cache)}
    with open(folder / "stdout", "w+") as said, open(folder / "stderr", "w+") as err:
        words = command(out, *options, **files)
        process = subprocess.Popen(words, cwd=folder, env=env, stdout=said, stderr=err)
        while (
            process.poll() is None
        ):  # the usage that wait returns would count this process's memory before the program began
            peak = max(peak, resident(process.pid))
            time.sleep(0.02)
        seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        said.seek(0), err.seek(0)
        if process.returncode not in (0, 1):
            raise RuntimeError(err.read())
        found = json.load(said)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "seconds": round(seconds, 2),
        "processor s": round(used, 2),
        "peak MB": round(peak / 1024),
        "apart": found["seconds"],
        "counts": found["counts"],
    }


def resident(pid, which="VmHWM"):
    """Return the resident memory of a process in kB: the largest so far, or what it is now (VmRSS)."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith(which)), 0)


def kill_at_half(folder, out, parts):
    """Start a run, kill it once half of the parts are there, and return how many there were."""
    process = subprocess.Popen(command(out), cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    there = lambda: len(list((folder / out / "verdicts.partial").glob("part-?????.parquet")))
    while there() < parts // 2 and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    return there()


def same(a, b):
    """Return whether two folders of verdicts hold the same bytes of time, status, margin and suspect."""
    files = [sorted(p.glob("*.parquet")) for p in (a, b)]
    return len(files[0]) == len(files[1]) and all(
        pq.read_table(x).equals(pq.read_table(y)) for x, y in zip(*files, strict=True)
    )


def main():
    rows, size = timing.option("--rows", 20_000_000), timing.option("--file", 1_000_000)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        jb.save_model(paper(), folder / "model.toml")
        generate(folder / "run", rows, size)
        stored = sum(p.stat().st_size for p in (folder / "run").iterdir())
        whole = run(folder, "large")
        small = run(folder, "small", "--chunk", "1000")
        parts = len(list((folder / "large/verdicts.parquet").iterdir()))
        killed = kill_at_half(folder, "resumed", parts)
        resumed = run(folder, "resumed")
        verdicts = [folder / out / "verdicts.parquet" for out in ("large", "small", "resumed")]
        timing.save(
            "parquet_observer" if OBSERVER else "parquet",
            {
                "rows": rows,
                "files": -(-rows // size),
                "stored MB": round(stored / 1e6),
                "chunk 1000000": whole,
                "chunk 1000": small,
                "same verdicts": same(*verdicts[:2]),
                "killed after parts": [killed, parts],
                "resumed": resumed,
                "same verdicts resumed": same(verdicts[0], verdicts[2]),
                "written MB": round(sum(p.stat().st_size for p in verdicts[0].iterdir()) / 1e6),
            },
        )


if __name__ == "__main__":
    main()
