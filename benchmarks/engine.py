"""Work spread by dask beside one process: the same bytes, processor seconds, memory, workers killed at random, and on after a death.

Recordings of three sizes, a fleet and a study are each done by one process, by workers, by workers of which some are killed, and recordings
by a command that is killed with its scheduler and given again. What a worker costs before its first task (imports, compiled kernels) is in
all figures; the law of processor seconds by rows says what is left of it where there is much to do.

python -m benchmarks.engine [--rows 100000000] [--units 2000] [--samples 10000] [--scenarios 1000000] [--workers 2] [--kills 20]
"""

import hashlib
import os
import random
import re
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

import jaxbound as jb
from benchmarks import fleet, timing
from benchmarks.parquet import resident
from benchmarks.scale import generate, linked, paper

EVERY = 0.2  # seconds between two looks at the processes
PAUSE = 15.0  # seconds that all workers live before one is killed: work has to be done in between
WRITTEN = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d \+0000|[\d.]+ (m?s|min)\b|\d[\d.,]* million")  # what a page says of its own time
CHOOSE = random.Random(18)


def workers_of(pid):
    """Return the process ids of the workers that a command started, youngest last."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            told = stat.with_name("cmdline").read_bytes()
        except (OSError, ValueError):
            continue
        if parent == pid and b"spawn_main" in told:
            found.append(int(stat.parent.name))
    return sorted(found)


def run(argv, folder, workers=0, kills=0, die=None):
    """Run a command; return its figures.

    Args:
        workers: that it starts. kills: of them to kill while it runs.
    """
    before, start, peaks, killed, died = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), {}, 0, False
    with open(folder / "stdout", "w+") as said, open(folder / "stderr", "w+") as err:
        process = subprocess.Popen([sys.executable, "-m", "jaxbound.cli", *map(str, argv)], cwd=folder, stdout=said, stderr=err)
        last = time.perf_counter()
        while process.poll() is None:
            time.sleep(EVERY)
            alive = workers_of(process.pid)
            for pid in (process.pid, *alive):
                peaks.setdefault(pid, []).append(resident(pid) / 1024)
            if len(alive) < workers:
                last = time.perf_counter()
            if killed < kills and time.perf_counter() - last > PAUSE:
                victim = CHOOSE.choice(alive)
                os.kill(victim, signal.SIGKILL)
                killed, last = killed + 1, time.perf_counter()
            if die is not None and die():
                process.kill()
                died = True
        err.seek(0)
        if process.returncode not in (0, 1) and not died:
            raise RuntimeError(err.read())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    command, *others = (x for _, x in sorted(peaks.items()))
    flat = [[round(max(x[: len(x) // 2])), round(max(x[len(x) // 2 :]))] for x in others if len(x) > 20]
    return {
        "seconds": round(time.perf_counter() - start, 1),
        "processor s": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1),
        "peak MB": round(max(command)),
        "peak MB of each worker, first half and second": flat,
        "killed": killed,
    }


def digest(out):
    """Return a digest of what a command wrote, but for the times at which it did."""
    whole = hashlib.sha256()
    for p in sorted(out.rglob("*")):
        if p.is_file() and p.suffix in (".parquet", ".csv", ".html") and "report" not in p.name:
            whole.update(p.name.encode() + WRITTEN.sub(b"", p.read_bytes()) if p.suffix == ".html" else p.name.encode() + p.read_bytes())
    return whole.hexdigest()


def compared(name, argv, folder, workers, kills, partial=None):
    """Return figures of one command by one process, by workers, with kills, and killed itself half way and given again.

    Args:
        argv: without --out. partial: function of the folder that says how much is kept there, from 0 to 1; None: no second attempt.
    """
    outs = {kind: folder / f"{name}-{kind}" for kind in ("one", "workers", "kills", "again")}
    warm = ["--workers", str(workers)]
    found = {
        "one process": run([*argv, "--out", outs["one"]], folder),
        "workers": run([*argv, "--out", outs["workers"], *warm], folder, workers),
    }
    whole = digest(outs["one"])
    same = {"workers": digest(outs["workers"]) == whole}
    killed, runs = 0, 0
    while killed < kills and runs < 10:
        shutil.rmtree(outs["kills"], ignore_errors=True)
        found["kills"] = run([*argv, "--out", outs["kills"], *warm], folder, workers, kills - killed)
        killed, runs = killed + found["kills"]["killed"], runs + 1
        same["kills"] = same.get("kills", True) and digest(outs["kills"]) == whole
    if partial is not None:
        run([*argv, "--out", outs["again"], *warm], folder, workers, die=lambda: partial(outs["again"]) > 0.4)
        left = partial(outs["again"])
        found["again"] = run([*argv, "--out", outs["again"], *warm], folder, workers) | {"kept of the first attempt": round(left, 2)}
        same["again"] = digest(outs["again"]) == whole
    ratio = found["workers"]["processor s"] / found["one process"]["processor s"]
    for out in outs.values():
        shutil.rmtree(out, ignore_errors=True)
    return {**found, "same bytes": same, "kills": killed, "runs with kills": runs, "processor s, workers / one process": round(ratio, 3)}


def law(rows, seconds, wanted=1e9):
    """Return (seconds before the first row, seconds a million rows, seconds of the rows that are wanted), by least squares."""
    slope, start = np.polyfit(np.array(rows) / 1e6, seconds, 1)
    return {
        "start s": round(float(start), 1),
        "s a million rows": round(float(slope), 4),
        "s of 10^9": round(float(start + slope * wanted / 1e6)),
    }


def main():
    rows, workers, kills = timing.option("--rows", 100_000_000), timing.option("--workers", 2), timing.option("--kills", 20)
    units, samples, scenarios = timing.option("--units", 2000), timing.option("--samples", 10_000), timing.option("--scenarios", 10**6)
    sizes, figures = [rows // 4, rows // 2, rows], {}
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        folder = Path(folder)
        jb.save_model(paper(), folder / "model.toml")
        generate(folder / "run", rows)
        kept = lambda out: len(list((out / "verdicts.partial").glob("part-*.parquet"))) / -(-rows // 1_000_000)
        for size in sizes:
            data = linked(folder, f"first {size}", -(-size // 1_000_000))
            largest = size == rows
            figures[f"{size} rows"] = compared("detect", ["detect", "model.toml", data], folder, workers, kills if largest else 0,
                                               kept if largest else None)  # fmt: skip
        shutil.rmtree(folder / "run")
        models = [fleet.unit_model(i) for i in range(units)]
        fleet.write(folder, models, *fleet.simulate(models, samples))
        figures[f"fleet of {units}"] = compared("fleet", ["fleet", "csv.csv"], folder, workers, max(kills // 5, 1))
        study = ["study", "model.toml", "--faults", "y1:bias,y2:bias", "--n", scenarios, "--seed", 1, "--rows"]
        figures[f"study of {scenarios}"] = compared("study", study, folder, workers, max(kills // 5, 1))
    spent = lambda who: [figures[f"{size} rows"][who]["processor s"] for size in sizes]
    laws = {who: law(sizes, spent(who)) for who in ("one process", "workers")}
    timing.save(
        "engine", {"workers": workers, "load average": [round(x, 1) for x in os.getloadavg()], "processor seconds by rows": laws, **figures}
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
