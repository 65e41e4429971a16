"""Work spread by dask beside one process: the same bytes, processor seconds, memory, workers killed at
random, and on after a death.

Recordings of three sizes, a fleet and a study are each done by one process and by workers; the largest
recording, the fleet and the study by workers of which some are killed, and the recording by a command that is
killed with its scheduler and given again. Each step says in a line what it found, so that a run that is cut
short has told something. Processor seconds are those of all processes of a command. The law of them by rows
keeps apart what workers cost before their first row (imports, kernels from the cache, what is read twice
where tasks meet).

python -m benchmarks.engine [--rows 100000000] [--units 2000] [--samples 10000] [--scenarios 1000000]
[--workers 2] [--kills 20]
    [--minutes 12]: what would begin too late is left out, and said to be; the law needs sizes of four million
    rows a worker and more

At the default sizes about 5 GB of disk in $TMPDIR, all of it removed at the end.
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
from benchmarks.scale import FILE, generate, linked, paper
from jaxbound.workers.engine import TASKS

EVERY = 0.2  # seconds between two looks at the processes
PAUSE = 2.0  # seconds that all workers live before one is killed: work has to be done in between
STARTED = 1.6  # processor seconds after which a worker is no longer one that comes up
RUNS = 10  # of one command with kills, at most
AGAIN = 0.4  # of the parts are there when a command is killed
WRITTEN = re.compile(
    rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d \+0000|[\d.]+ (m?s|min)\b|\d[\d.,]* million"
)  # what a page says of its own time
CHOOSE = random.Random(18)
BEGUN = time.perf_counter()


def say(text):
    """Print a line at once, with the minutes and seconds since the beginning."""
    minutes, seconds = divmod(int(time.perf_counter() - BEGUN), 60)
    print(f"[{minutes:2d}:{seconds:02d}] {text}", flush=True)


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


def used(pid):
    """Return the processor seconds of a process."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run(argv, folder, workers=0, kills=0, done=None, die=False):
    """Run a command; return its figures.

    Args:
        workers: that it starts. kills: of them to kill while it runs, each time after all lived for a while.
        done: function that says how much is there, from 0 to 1: then some more has to be there before the
            next kill, too.
        die: whether the command itself is killed, half way.
    """
    before, start, memory, killed, died = (
        resource.getrusage(resource.RUSAGE_CHILDREN),
        time.perf_counter(),
        {},
        0,
        False,
    )
    with open(folder / "stdout", "w+") as said, open(folder / "stderr", "w+") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "jaxbound.cli", *map(str, argv)], cwd=folder, stdout=said, stderr=err
        )
        last, there = time.perf_counter(), 0.0
        while process.poll() is None:
            time.sleep(EVERY)
            alive, now = workers_of(process.pid), time.perf_counter()
            for pid in (process.pid, *alive):
                memory.setdefault(pid, []).append((resident(pid) / 1024, resident(pid, "VmRSS") / 1024))
            if len(alive) < workers or min(map(used, alive), default=0.0) < STARTED:
                last = now
            if killed < kills and now - last > PAUSE and (done is None or done() > there):
                os.kill(CHOOSE.choice(alive), signal.SIGKILL)
                killed, last, there = killed + 1, now, done() if done else 0.0
            if die and done() > AGAIN:
                process.kill()
                died = True
        err.seek(0)
        gave_up = (
            killed > 0 and process.returncode == 2
        )  # killed while they were started: a sentence, and the same command goes on
        if process.returncode not in (0, 1) and not died and not gave_up:
            raise RuntimeError(err.read())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    command, *others = (x for _, x in sorted(memory.items()))
    resting = [[now for _, now in x] for x in others if len(x) > 40]
    halves = [[round(max(x[: len(x) // 2])), round(max(x[len(x) // 2 :]))] for x in resting]
    return {
        "seconds": round(time.perf_counter() - start, 1),
        "processor s": round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1),
        "peak MB": round(max(peak for peak, _ in command)),
        "peak MB of each worker": [round(max(peak for peak, _ in x)) for x in others],
        "MB of each worker, most in the first half and in the second": halves,
        "killed": killed,
        "gave up": gave_up,
    }


def digest(out):
    """Return a digest of what a command wrote, but for the times at which it did."""
    whole = hashlib.sha256()
    for p in sorted(out.rglob("*")):
        if p.is_file() and p.suffix in (".parquet", ".csv", ".html") and "report" not in p.name:
            whole.update(
                p.name.encode() + WRITTEN.sub(b"", p.read_bytes())
                if p.suffix == ".html"
                else p.name.encode() + p.read_bytes()
            )
    return whole.hexdigest()


def parts(folder):
    """Return {name of a part: when it was written}."""
    return {p.name: p.stat().st_mtime_ns for p in folder.glob("part-*.parquet")}


def compared(name, argv, folder, workers, kills, done=None, again=False):
    """Return figures of one command by one process, by workers, with kills, and killed itself half way and
    given again.

    Args:
        argv: without --out. done: function of an output folder that says how much is there, from 0 to 1,
            where that can be told.
        again: whether the command is killed, too.
    """
    out, whole, same = folder / f"{name}-out", "", {}
    warm = ["--workers", str(workers)]
    found: dict = {"kills": 0}
    part = None if done is None else lambda: done(out)

    def noted(kind, before=None, **how):
        nonlocal whole
        by = [] if kind == "one process" else warm
        figures = run([*argv, "--out", out, *by], folder, workers if by else 0, **how)
        found[kind] = found.get(kind, []) + [figures] if kind == "workers, some killed" else figures
        if figures["gave up"]:
            say(f"{name}, {kind}: gave up after {figures['seconds']} s; given again")
            return
        whole = whole or digest(out)
        same[kind] = same.get(kind, True) and digest(out) == whole
        if before is not None:
            found["of these not made again"] = len(
                before.items() & parts(out / "verdicts.parquet").items()
            ) / len(before)
        shutil.rmtree(out)
        told = f"{figures['seconds']} s, {figures['processor s']} processor s, peak {figures['peak MB']} MB"
        told += f", workers {max(figures['peak MB of each worker'])} MB" if by else ""
        told += f", {figures['killed']} killed" if figures["killed"] else ""
        say(f"{name}, {kind}: {told}" + ("" if kind == "one process" else f"; same bytes: {same[kind]}"))

    noted("one process")
    noted("workers")
    found["processor s, workers / one process"] = round(
        found["workers"]["processor s"] / found["one process"]["processor s"], 3
    )
    say(f"{name}: workers / one process: {found['processor s, workers / one process']} of processor seconds")
    while found["kills"] < kills and len(found.get("workers, some killed", ())) < RUNS:
        noted("workers, some killed", kills=kills - found["kills"], done=part)
        *_, last = found["workers, some killed"]
        found["kills"] += last["killed"]
        if not last["killed"]:
            say(f"{name}: {found['kills']} workers killed, not {kills}: it is done before")
            break
    if again:
        run([*argv, "--out", out, *warm], folder, workers, done=part, die=True)
        found["made before the command was killed"] = round(done(out), 2)
        before = parts(out / "verdicts.partial")
        say(f"{name}: command and scheduler killed with {done(out):.0%} of the parts made; given again:")
        noted("given again", before=before)
    return found | {"same bytes": same}


def law(rows, seconds, wanted=1e9):
    """Return (seconds before the first row, seconds a million rows, hours of a core for the rows that are
    wanted), by least squares.
    """
    slope, start = np.polyfit(np.array(rows) / 1e6, seconds, 1)
    hours = (start + slope * wanted / 1e6) / 3600
    return {
        "start s": round(float(start), 1),
        "s a million rows": round(float(slope), 4),
        "core hours of 10^9 rows": round(float(hours), 3),
    }


def laws(figures, sizes):
    """Return the law of processor seconds by rows of one process and of workers, and the ratio of their
    slopes; and say it.
    """
    spent = lambda who: [figures[f"{size} rows"][who]["processor s"] for size in sizes]
    found: dict = {who: law(sizes, spent(who)) for who in ("one process", "workers")}
    slopes = [found[who]["s a million rows"] for who in ("workers", "one process")]
    found["a row more, workers / one process"] = round(slopes[0] / slopes[1], 3)
    for who in ("one process", "workers"):
        start, slope, hours = found[who].values()
        say(
            f"law of {who}: {start} s + {slope} s a million rows (processor seconds): {hours} h of one core "
            f"for 10^9 rows"
        )
    say(f"a row more costs workers {found['a row more, workers / one process']} of what it costs one process")
    return found


def main():
    rows, workers, kills = (
        timing.option("--rows", 100_000_000),
        timing.option("--workers", 2),
        timing.option("--kills", 20),
    )
    units, samples, scenarios = (
        timing.option("--units", 2000),
        timing.option("--samples", 10_000),
        timing.option("--scenarios", 10**6),
    )
    end = 60 * timing.option("--minutes", 12)
    sizes, figures, left_out = [rows // 4, rows // 2, rows], {"workers": workers, "load average": load()}, []

    def step(name, about, *args, **how):
        """Do and keep one comparison, if there is time; a rough guess of how long it takes: as long as all
        before.
        """
        if time.perf_counter() - BEGUN > end * about:
            say(f"{name}: left out, {int(end * (1 - about) / 60)} minutes are wanted for it")
            left_out.append(name)
            return
        figures[name] = compared(name, *args, **how)

    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        folder = Path(folder)
        jb.save_model(paper(), folder / "model.toml")
        study = [
            "study",
            "model.toml",
            "--faults",
            "y1:bias,y2:bias",
            "--n",
            scenarios,
            "--seed",
            1,
            "--rows",
        ]
        step(f"study of {scenarios}", 1, study, folder, workers, max(kills // 5, 1))
        say(f"writing a fleet of {units} units with {samples} samples each")
        (folder / "fleet").mkdir()
        models = [fleet.unit_model(i) for i in range(units)]
        fleet.write(folder / "fleet", models, *fleet.simulate(models, samples))
        step(f"fleet of {units}", 0.9, ["fleet", "fleet/csv.csv"], folder, workers, max(kills // 5, 1))
        shutil.rmtree(folder / "fleet")
        say(f"writing {rows} rows")
        generate(folder / "run", rows)
        for i, size in enumerate(sizes):
            data, largest = linked(folder, f"first {size}", -(-size // FILE)), size == rows
            made = lambda out, count=-(-size // FILE): len(parts(out / "verdicts.partial")) / count
            step(
                f"{size} rows",
                (0.7, 0.6, 0.5)[i],
                ["detect", "model.toml", data],
                folder,
                workers,
                kills * largest,
                made,
                largest,
            )
            # fewer parts are fewer tasks, and what tasks read twice would look like a price of rows
            measured = [
                size for size in sizes if f"{size} rows" in figures and size >= TASKS * workers * FILE
            ]
            if len(measured) > 1:
                figures["processor seconds by rows"] = laws(figures, measured)
    timing.save("engine", figures | {"left out": left_out, "load average at the end": load()})


def load():
    """Return the load average of the machine."""
    return [round(x, 1) for x in os.getloadavg()]


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
