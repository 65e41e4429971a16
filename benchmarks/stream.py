"""Verdicts as the samples come: the same as of the file, how late, how fast, in how much memory, and after a
kill.

python -m benchmarks.stream [--rows 1000000] [--long 100000] [--live 10000] [--realtime] [--observer]

On a busy machine latency is that of the other processes. With --realtime (for root, on Linux) what measures
it comes before them. With --observer the same of a set observer, on the first model alone.
"""

import json
import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np

import jaxbound as jb
from benchmarks import timing

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from systems import paper  # noqa: E402

OBSERVER = "--observer" in sys.argv
SHARED = Path(os.environ.get("JAXBOUND_SHARED", ROOT.parent / "shared"))


def fitted():
    """Return the model of a temperature control lab that was fitted to a recording, 4 states; None where it
    is absent.
    """
    path = SHARED / "data/tclab/model.json"
    if not path.exists():
        return None
    spec = json.loads(path.read_text())
    return jb.LinearSystem(spec["A"], spec["B"], spec["C"], noise=spec["noise_bound"]["s4"], dt=0.001)


def write(path, model, rows):
    """Write a CSV of healthy samples with a short fault in the middle."""
    rng = np.random.default_rng(0)
    A, B, C = (np.array(m, float) for m in (model.A, model.B, model.C))
    u = np.repeat(rng.uniform(-1, 1, (rows // 20 + 1, model.m)).round(6), 20, 0)[:rows]
    x, y = np.zeros(model.n), np.empty((rows, model.p))
    for k in range(rows):
        y[k], x = C @ x, A @ x + B @ u[k]
    sigma, delta = (np.array(b, float) for b in (model.tolerance, model.noise))
    y += rng.uniform(-0.98, 0.98, y.shape) * (0.98 * sigma * abs(y) + delta)
    y[rows // 2 : rows // 2 + 40, 0] += 2 * delta[0]
    form = ["%.3f", *["%.6f"] * model.m, *["%.9f"] * model.p]
    header = ",".join(("time", *model.inputs, *model.outputs))
    np.savetxt(
        path,
        np.column_stack([model.dt * np.arange(rows), u, y]),
        fmt=form,
        delimiter=",",
        header=header,
        comments="",
    )


def with_gaps(data, model):
    """Return lines of a CSV in which one output of a hundred is missing."""
    rng = np.random.default_rng(1)
    head, *lines = data.splitlines()
    first = 1 + model.m
    out = [head]
    for line in lines:
        cells = line.split(b",")
        for at in first + np.flatnonzero(rng.uniform(size=model.p) < 0.01):
            cells[at] = b"nan"
        out.append(b",".join(cells))
    return b"\n".join(out) + b"\n"


def command(data, horizon, *options):
    program = shutil.which("jaxbound", path=Path(sys.executable).parent)
    program = [program] if program else [sys.executable, "-m", "jaxbound.cli"]
    windows = () if horizon is None else ("--test", f"horizon={horizon}")
    return [
        *program,
        "detect",
        "model.toml",
        data,
        *(("--method", "observer") if OBSERVER else windows),
        *options,
    ]


def start(folder, horizon, *options, stdout=subprocess.DEVNULL):
    return subprocess.Popen(
        command("-", horizon, *options),
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=stdout,
        stderr=subprocess.DEVNULL,
        bufsize=0,
    )


def resident(process):
    """Return the resident memory of a process now, in MB."""
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return round(next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024)


def written(path):
    """Return how many verdicts a file holds."""
    return path.read_bytes().count(b"\n") - 1 if path.exists() else 0


def feed(process, data):
    """Write to a process in another thread; it may end before."""

    def run():
        view = memoryview(data)
        try:
            while view:
                view = view[process.stdin.write(view) :]
        except (BrokenPipeError, ValueError):
            pass

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def through(folder, horizon, data, rows):
    """Send a whole recording; return seconds, CPU seconds and memory after a tenth, a half and all of it."""
    before, begun, memory = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), []
    with open(folder / "stdout", "wb") as out:
        process = start(folder, horizon, "--out", "pipe", stdout=out)
        shares = (0.1, 0.5, 1)
        at = [data.rindex(b"\n", 0, int(share * len(data))) + 1 for share in shares]
        for a, b, share in zip([0, *at], at, shares, strict=False):
            feed(process, data[a:b]).join()
            while written(folder / "pipe/verdicts.csv") < int(share * rows) - 1000:
                time.sleep(0.05)
            time.sleep(0.3)
            memory.append(resident(process))
        process.stdin.close()
        process.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "seconds": round(time.perf_counter() - begun, 2),
        "CPU s": round(cpu, 2),
        "MB after a tenth, a half, all": memory,
    }


def killed(folder, horizon, data, rows, again):
    """Kill a run in the middle, go on, and return how many verdicts there were."""
    out = folder / f"killed-{again}"
    process = start(folder, horizon, "--out", out.name)
    feeding = feed(process, data)
    while written(out / "verdicts.csv") < rows // 2:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdin.close()
    feeding.join()
    there = written(out / "verdicts.csv")
    with closing(sqlite3.connect(out / "monitor.sqlite")) as database:
        ((memory,),) = database.execute("SELECT memory FROM checkpoint")
    position = json.loads(memory)["source"]
    taken = position["number"]  # lines, the header too: a sender that goes on sends what follows
    rest = data if again == "beginning" else b"\n".join(data.split(b"\n")[taken:])
    if again != "beginning" and position["tail"]:
        rest = data.split(b"\n", 1)[0] + b"\n" + rest
    process = start(folder, horizon, "--out", out.name)
    feed(process, rest).join()
    process.stdin.close()
    process.wait()
    return there


def live(folder, horizon, data, count, *options):
    """Send lines at 1 kHz; return the seconds from before the write to when the verdict is read."""
    process = start(folder, horizon, *options, stdout=subprocess.PIPE)
    lines, out, late = data.splitlines(keepends=True)[: count + 1], process.stdout.fileno(), []

    def answer():
        got = b""
        while not got.endswith(b"\n"):
            got += os.read(out, 1 << 12)

    process.stdin.write(lines[0])
    due = time.perf_counter()
    for line in lines[1:]:
        due = max(due + 0.001, time.perf_counter())
        while (wait := due - time.perf_counter()) > 0:
            time.sleep(wait)
        sent = time.perf_counter()
        process.stdin.write(line)
        answer()
        late.append(time.perf_counter() - sent)
    process.stdin.close()
    process.wait()
    process.stdout.close()
    return spread(late[len(late) // 10 :])


def stepping(relations, data, count):
    """Return the seconds of the first step and the spread of the others."""
    values = np.loadtxt(
        data.splitlines()[1 : count + 1],
        delimiter=",",
        usecols=range(1, 1 + relations.model.m + relations.model.p),
    )
    u, y = np.split(values, [relations.model.m], 1)
    mon = jb.Monitor(relations)
    state, seconds, cpu = mon.init(), [], []
    for k in range(len(y)):
        begun, busy = time.perf_counter(), time.process_time()
        state, _ = mon.step(state, u[k], y[k])
        seconds.append(time.perf_counter() - begun)
        cpu.append(time.process_time() - busy)
    first = seconds[0]
    return {
        "first s": round(first, 2),
        **spread(seconds[len(seconds) // 10 :]),
        "CPU us, median": round(1e6 * float(np.median(cpu))),
    }


@contextmanager
def undisturbed():
    """Run before all other processes if --realtime asks for it."""
    if "--realtime" not in sys.argv:
        yield
        return
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def spread(seconds):
    return {
        f"{name} us": round(1e6 * float(np.percentile(seconds, q)))
        for name, q in (("p50", 50), ("p99", 99), ("p99.9", 99.9))
    }


def measured(model, horizon, rows, count):
    """Return all figures of one model."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        jb.save_model(model, folder / "model.toml")
        write(folder / "run.csv", model, rows)
        data, relations = (
            (folder / "run.csv").read_bytes(),
            jb.observer(model) if OBSERVER else jb.parity_relations(model, horizon),
        )
        begun = time.perf_counter()
        subprocess.run(command("run.csv", horizon, "--out", "batch"), cwd=folder, stdout=subprocess.DEVNULL)
        batch = time.perf_counter() - begun
        expected = (folder / "batch/verdicts.csv").read_bytes()
        figures = {"horizon": relations.horizon, "rows": rows, "seconds as a file": round(batch, 2)}
        figures["through the pipe"] = through(folder, horizon, data, rows)
        same = lambda name: (folder / name / "verdicts.csv").read_bytes() == expected
        figures["same verdicts.csv, byte by byte"] = same("pipe")
        printed = (folder / "stdout").read_bytes()
        figures["same on stdout"] = printed == expected.replace(b",suspect\n", b"\n").replace(
            b",true\n", b"\n"
        ).replace(b",false\n", b"\n")
        for again in ("beginning", "onwards"):
            there = killed(folder, horizon, data, rows, again)
            figures[
                f"killed after, then from the {again}"
                if again == "beginning"
                else "killed after, then onwards"
            ] = there
            figures[f"same verdicts.csv, {again}"] = same(f"killed-{again}")
        with undisturbed():
            figures["live at 1 kHz"] = live(folder, horizon, data, count)
            figures["live at 1 kHz, with --out"] = live(folder, horizon, data, count, "--out", "live")
            figures["Monitor.step"] = stepping(relations, data, count)
            gaps = with_gaps(b"".join(data.splitlines(keepends=True)[: count + 1]), model)
            figures["live at 1 kHz, 1 % of the outputs missing"] = live(folder, horizon, gaps, count)
            figures["Monitor.step, 1 % of the outputs missing"] = stepping(relations, gaps, count)
        return figures


def main():
    rows, long, count = (
        timing.option("--rows", 1_000_000),
        timing.option("--long", 100_000),
        timing.option("--live", 10_000),
    )
    figures = {
        "realtime": "--realtime" in sys.argv,
        "load": [round(x, 1) for x in os.getloadavg()],
        "section 5, observer" if OBSERVER else "section 5, s = 1": measured(
            paper(dt=0.001), None, rows, count
        ),
    }
    if OBSERVER:
        timing.save("stream_observer", figures)
        return
    model = fitted()
    if model is None:
        figures["2 inputs, 2 outputs, s = 15"] = f"not measured: {SHARED} is absent"
    else:
        figures["2 inputs, 2 outputs, s = 15"] = measured(model, 15, long, count)
    timing.save("stream", figures)


if __name__ == "__main__":
    main()
