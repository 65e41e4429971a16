"""What an accelerator does with windows, in ten minutes; on CPU the same with virtual devices.

What its arithmetic keeps to in both precisions; no false alarm where
every error lies at a bound; verdicts against those of one CPU device: each FAULT the same, nothing CONSISTENT
where the device was not examined; shares of the limits of its memory and of its arithmetic, of the way from
the host, and of the time that proving on the host takes at 0, 1 and 100 % faulty windows; long windows, a
study beside two cores, an observer, tuning. Figures are written after each stage: a run that is cut short
leaves those that it had.

python -m benchmarks.accelerator [--windows 1000000] [--vertices 1000000] [--scenarios 20000] [--devices 8]
What a card is asked for:
JAX_PLATFORMS=cuda,cpu python -m benchmarks.accelerator --windows 1e8 --vertices 1e8
"""

import os
import sys

if "--devices" in sys.argv or not os.environ.get("JAX_PLATFORMS"):
    wanted = sys.argv[sys.argv.index("--devices") + 1] if "--devices" in sys.argv else "8"
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={wanted}".strip()
    )

import json
import time
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing
from benchmarks.long_windows import FOUR
from benchmarks.twice import faulty
from jaxbound.consistency import drive, strips
from jaxbound.consistency.searched import judging_device
from jaxbound.sets.floats import probe
from jaxbound.sets.floats.examined import MANY, measure

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

WANTED = {"share of bandwidth": 0.5, "times two cores": 20.0, "million long windows/s": 20.0}
FEW = 100_000  # scenarios that the cores simulate beside a card
AT_ONCE = 10_000_000  # windows with errors at their bounds that are drawn at once


def at_vertices(windows, seed=0):
    """Return u, y of the paper's plant with every error at one of its bounds, in runs of 1000 samples."""
    runs = max(windows // 1000, 1)
    u = np.repeat(np.random.default_rng(seed).uniform(-1, 1, (runs, 50, 1)), 20, 1)
    return u, np.asarray(jb.simulate(paper(), u, jax.random.key(seed + 1), at="vertices").y)


def false_alarms(tests, vertices, kind):
    """Return {name of a test: FAULT windows} among so many windows without a fault whose every error lies at
    a bound.
    """
    found = dict.fromkeys(tests, 0)
    for seed, first in enumerate(range(0, vertices, AT_ONCE)):
        given = [x.astype(kind) for x in at_vertices(min(AT_ONCE, vertices - first), seed)]
        for name, relations in tests.items():
            found[name] += int((jb.detect(relations, *given).status == jb.Status.FAULT).sum())
    return found


def bandwidth(device, size=4 * 10**8):
    """Return the bytes a second at which one device reads and writes its memory: x + 1 of an array that no
    cache holds.
    """
    x = jax.device_put(np.zeros(size // 8), device)
    more = jax.jit(lambda x: x + 1)
    return 2 * x.nbytes / timing.clock(lambda: more(x), 5)[1]


def arithmetic(device, dtype, size=2**22, chains=4, length=64):
    """Return the operations a second of one device: chains of multiplications and additions of each number,
    unrolled, so that they fuse into one pass.
    """
    x = jax.device_put(np.linspace(0.1, 0.9, size, dtype=dtype), device)

    @jax.jit
    def chained(x):
        parts = [x * (k + 1) for k in range(chains)]
        for _ in range(length):
            parts = [part * x + 0.25 for part in parts]
        return sum(parts)

    return 2 * chains * length * size / timing.clock(lambda: chained(x), 5)[2]


def from_the_host(device, size=2**27):
    """Return the bytes a second that go from the host to one device."""
    x = np.ones(size // 8)
    return x.nbytes / timing.clock(lambda: jax.device_put(x, device), 5)[1]


def limits(device):
    """Return what binds one device."""
    return {
        "memory, GB/s": round(bandwidth(device) / 1e9, 1),
        "from the host, GB/s": round(from_the_host(device) / 1e9, 1),
        "float64, GFLOP/s": round(arithmetic(device, np.float64) / 1e9, 1),
        "float32, GFLOP/s": round(arithmetic(device, np.float32) / 1e9, 1),
    }


def of_the_limits(relations, u, y, device, limit):
    """Return figures of the kernel of strips alone, on one device whose memory holds the samples."""
    test = jax.device_put(relations.reading(y.dtype), device)
    given = [jax.device_put(x, device) for x in (u, y)]
    seconds = timing.clock(lambda: strips.verdicts(test, *given), 5)[1]
    moved = u.nbytes + y.nbytes + len(y) * (1 + y.itemsize)  # samples in, status and margin out
    cost = strips.verdicts.lower(test, *given).compile().cost_analysis() or {}
    operations = (cost[0] if isinstance(cost, list) else cost).get("flops", np.nan)
    peak = limit[f"{y.dtype.name}, GFLOP/s"] * 1e9
    return {
        "million/s": round(len(y) / seconds / 1e6, 1),
        "share of the memory's limit": round(moved / seconds / (limit["memory, GB/s"] * 1e9), 3),
        "operations a window": round(operations / len(y), 1),
        "share of the arithmetic limit": round(operations / seconds / peak, 3),
        "wanted of the memory's": WANTED["share of bandwidth"],
    }


def sent(relations, u, y):
    """Return how many times the bytes of a recording go to devices."""
    counts, spread = [], drive.on_devices

    def counted(kernel, constants, blocks, *rest):
        counts.extend(x.nbytes for block in blocks for x in block if isinstance(x, np.ndarray))
        return spread(kernel, constants, blocks, *rest)

    with patch.object(drive, "on_devices", counted):
        jb.detect(relations, u, y)
    return round(sum(counts) / (u.nbytes + y.nbytes), 2)


def proving(relations, u, y):
    """Return {share of faulty windows: share of the wall time that proving on the host takes}."""
    spent, found = [], {}
    names = ("_contradicted", "only_searched")
    whole = {name: getattr(drive, name) for name in names}

    def timed(name):
        def run(*given):
            start = time.perf_counter()
            out = whole[name](*given)
            spent.append(time.perf_counter() - start)
            return out

        return run

    for share in (0.0, 0.01, 1.0):
        outputs = faulty(y, share, relations.horizon + 1)
        jb.detect(relations, u, outputs)
        with patch.multiple(drive, **{name: timed(name) for name in names}):
            spent.clear()
            start = time.perf_counter()
            jb.detect(relations, u, outputs)
            total = time.perf_counter() - start
        found[f"{share:.0%}"] = round(sum(spent) / total, 3)
    return found


def beside_cores(scenarios):
    """Return seconds of a study on all devices of this process and on one CPU device, which has all cores,
    and their ratio.
    """
    run = lambda n: jb.study(paper(), "y1:bias", n, 0, sizes=[0.5], samples=200).tallies
    few, found = min(scenarios, FEW), {}
    for name, place, n in (
        ("here", nullcontext(), scenarios),
        ("cpu", jax.default_device(jax.local_devices(backend="cpu")[0]), few),
    ):
        with place:
            run(n)
            start = time.perf_counter()
            run(n)
            found[name] = (time.perf_counter() - start) / n
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    ratio = found["cpu"] * cores / 2 / found["here"]
    rates = {f"million samples/s, {name}": round(200 / seconds / 1e6, 2) for name, seconds in found.items()}
    return rates | {"times two cores": round(ratio, 2), "wanted": WANTED["times two cores"]}


def speed(run, windows):
    """Return millions a second, first call apart."""
    first, median, fastest, slowest = timing.clock(run, 3)
    return {
        "first s": round(first, 2),
        "million/s": [round(windows / t / 1e6, 2) for t in (median, slowest, fastest)],
    }


def judged(relations, u, y):
    """Return (the Result of all devices, what is to be 0 of it beside a CPU device alone)."""
    found = jb.detect(relations, u, y)
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        alone = jb.detect(relations, u, y).status
    fault, consistent = (found.status == kind for kind in (jb.Status.FAULT, jb.Status.CONSISTENT))
    searched = probe.searching_device()
    return found, {
        "FAULT that the CPU explains": int((fault & (alone == jb.Status.CONSISTENT)).sum()),
        "CONSISTENT that the CPU refutes": int((consistent & (alone == jb.Status.FAULT)).sum()),
        "CONSISTENT though nobody examined it": int(consistent.sum()) if searched else 0,
        "MISSING otherwise": int(((found.status == 0) != (alone == 0)).sum()),
    }


class Figures(dict):
    """Figures by stage, printed and written as they come."""

    def stage(self, name, work):
        """Do a stage and keep its figures and seconds; one that fails says why, and others go on."""
        start = time.perf_counter()
        try:
            self[name] = work()
        except (RuntimeError, NotImplementedError, MemoryError, ValueError) as e:
            self[name] = f"{type(e).__name__}: {str(e)[:300]}"
        self.setdefault("seconds", {})[name] = round(time.perf_counter() - start, 1)
        print(f"{self['seconds'][name]:7.1f} s  {name}: {self[name]}", flush=True)
        (Path(__file__).parent / "accelerator.json").write_text(json.dumps(self, indent=1) + "\n")
        return self[name]


def main():
    windows, vertices = timing.option("--windows", 10**6), timing.option("--vertices", 10**6)
    scenarios = timing.option("--scenarios", 20_000)
    devices, figures = (
        jax.local_devices(),
        Figures(machine=timing.machine(), devices=len(jax.local_devices())),
    )
    figures["load average"] = [round(x, 1) for x in os.getloadavg()]
    for dtype in (np.float32, np.float64):
        about = f"arithmetic, {np.dtype(dtype).name}"
        figures.stage(about, lambda dtype=dtype: examined(devices[0], dtype))
    figures["who judges"] = judging_device() or "CPU"
    limit = figures.stage("limits of the first device", lambda: limits(devices[0]))
    r, long = jb.parity_relations(paper()), jb.parity_relations(paper(), 15)
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(windows, 1)), rng.normal(size=(windows, 2))
    for kind in (np.float64, np.float32):
        with jax.enable_x64(kind is np.float64):
            name, some = np.dtype(kind).name, [x.astype(kind) for x in (u, y)]
            figures.stage(
                f"{name}: strips, the kernel alone",
                lambda some=some: of_the_limits(r, *some, devices[0], limit),
            )
            figures.stage(
                f"{name}: strips, from and to the host",
                lambda some=some: speed(lambda: jb.detect(r, *some).status, windows),
            )
            found, wrong = judged(r, *(x[:100_000] for x in some))
            figures.stage(f"{name}: to be 0, beside one CPU device", lambda wrong=wrong: wrong)
            alarms = figures.stage(
                f"{name}: false alarms at vertices, of {vertices}",
                lambda kind=kind: false_alarms({"short": r, "long": long}, vertices, kind),
            )
            assert not any(wrong.values()), wrong
            assert not any(alarms.values()), alarms
    some, four = max(windows // 20, 1000), jb.LinearSystem(**FOUR)
    inputs = rng.normal(size=(some, four.m))
    outputs = np.asarray(jb.simulate(four, inputs, jax.random.key(2)).y)
    rows = jb.parity_relations(four, 15)
    given = rng.uniform(-1, 1, (windows, 1))
    healthy = given, np.asarray(jb.simulate(paper(), given, jax.random.key(3)).y)
    figures.stage("margins", lambda: speed(lambda: jb.margins(r, u, y), windows))
    figures.stage(
        "times that a sample goes to a device",
        lambda: {"strips": sent(r, u, y), "16 samples": sent(rows, inputs, outputs)},
    )
    figures.stage("share of proving on the host, strips", lambda: proving(r, *healthy))
    figures.stage(
        "long windows, 32 rows, 4 states",
        lambda: (
            speed(lambda: jb.detect(rows, inputs, outputs).status, some)
            | {"wanted": WANTED["million long windows/s"]}
        ),
    )
    figures.stage(f"study of {scenarios} x 200, on the CPU", lambda: beside_cores(scenarios))
    figures.stage(
        "observer, on the CPU where nobody examined the device",
        lambda: speed(lambda: jb.detect(jb.observer(paper()), u[:20_000], y[:20_000]).status, 20_000),
    )
    few = tuple(x[:some] for x in healthy)
    figures.stage(
        "tune, windows looked at",
        lambda: speed(lambda: jb.tune(r, few, steps=100, safety=1).smallest, 100 * some),
    )
    stats = devices[0].memory_stats() or {}
    figures["peak MB of the first device"] = round(stats.get("peak_bytes_in_use", 0) / 1e6) or None
    timing.save("accelerator", figures)


def examined(device, dtype):
    """Return how many claims there are, and those that do not hold."""
    found = measure(device, dtype, MANY)
    return {
        "claims": len(found),
        "broken": {name: pair for name, pair in found.items() if not pair[0] <= pair[1]},
    }


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
