"""What an accelerator has to show before it may prove, in one run; on CPU the same with virtual devices, and
the door stays shut.

The examination of its arithmetic in both precisions; no false alarm where every error lies at a bound;
verdicts against those of one CPU device; strips and the memory's bandwidth, long windows, a study beside two
cores, an observer, tuning, memory. Nothing is claimed of a device that this did not run on. A card that
nobody has examined shows its examination and margins alone; with --admit, and where the examination in
float64 broke nothing, it counts as examined for this run: what it judges is measured then, not to be
believed.

python -m benchmarks.accelerator [--windows 1000000] [--vertices 1000000] [--scenarios 20000] [--devices 8]
[--admit]

What a card is asked for: --windows 1e8 --vertices 1e9 --scenarios 1e6 --admit.
"""

import os
import sys

if "--devices" in sys.argv or not os.environ.get("JAX_PLATFORMS"):
    wanted = sys.argv[sys.argv.index("--devices") + 1] if "--devices" in sys.argv else "8"
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={wanted}".strip()
    )

import time
from contextlib import nullcontext
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing
from benchmarks.long_windows import FOUR
from jaxbound.consistency import strips
from jaxbound.diagnosis.spot_checks import decided_again
from jaxbound.sets.floats import probe
from jaxbound.sets.floats.examination import examination

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

WANTED = {"share of bandwidth": 0.5, "times two cores": 20.0, "million long windows/s": 20.0}
FEW = 100_000  # scenarios that the cores simulate beside a card
AT_ONCE = 10_000_000  # windows with errors at their bounds that are drawn at once


class Unexamined:
    """A card that nobody has examined: the door has to stay shut."""

    platform, device_kind, compute_capability = "gpu", "NVIDIA of next year", "99.0"


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


def of_memory_speed(relations, u, y, device):
    """Return figures of the kernel of strips alone, on one device whose memory holds the samples."""
    test = jax.device_put(relations.reading(y.dtype), device)
    given = [jax.device_put(x, device) for x in (u, y)]
    seconds = timing.clock(lambda: strips.verdicts(test, *given), 5)[1]
    moved = u.nbytes + y.nbytes + len(y) * (1 + y.itemsize)  # samples in, status and margin out
    share = moved / seconds / bandwidth(device)
    return {
        "million/s": round(len(y) / seconds / 1e6, 1),
        "share of the bandwidth of x + 1": round(share, 3),
        "wanted": WANTED["share of bandwidth"],
    }


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
    """Return the statuses of all devices, and on how many windows a CPU device alone says something that
    contradicts them.
    """
    found = jb.detect(relations, u, y)
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        alone = jb.detect(relations, u, y).status
    proved = lambda x: (x == jb.Status.FAULT) | (x == jb.Status.CONSISTENT)
    return (
        found,
        int((proved(found.status) & proved(alone) & (found.status != alone)).sum()),
        int((found.status != alone).sum()),
    )


def main():
    windows, vertices = timing.option("--windows", 10**6), timing.option("--vertices", 10**6)
    scenarios = timing.option("--scenarios", 20_000)
    devices, figures = jax.local_devices(), {}
    for dtype in (np.float32, np.float64):
        for device in devices[:: len(devices) - 1 or 1]:
            found = examination(device, dtype)
            broken = {name: pair for name, pair in found.items() if not pair[0] <= pair[1]}
            figures[f"examination of {device}, {np.dtype(dtype).name}"] = {
                "claims": len(found),
                "broken": broken,
            }
    assert not probe.verified(Unexamined()), "the door is open to what nobody has examined"
    figures["premises"] = probe.PREMISES.get(probe.kind_of_device(devices[0])["platform"], ("unknown",))
    figures["may prove"] = {str(probe.kind_of_device(d)): probe.verified(d) for d in devices}
    if (
        "--admit" in sys.argv
        and not all(map(probe.verified, devices))
        and not figures[f"examination of {devices[0]}, float64"]["broken"]
    ):
        kind = probe.kind_of_device(devices[0])
        probe.EXAMINED |= {" ".join(x for x in (kind["platform"], kind["capability"]) if x)}
        figures["admitted for this run"] = sorted(probe.EXAMINED)
    proves = all(map(probe.verified, devices))
    if not proves:
        figures["verdicts"] = "refused: this device is not in EXAMINED; margins alone were measured"
    r, long = jb.parity_relations(paper()), jb.parity_relations(paper(), 15)
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(windows, 1)), rng.normal(size=(windows, 2))
    figures["margins"] = speed(lambda: jb.margins(r, u, y), windows)
    figures["strips, the kernel alone"] = of_memory_speed(r, u, y, devices[0])
    if proves:
        for precision in (True, False):
            with jax.enable_x64(precision):
                name, kind = ("float64", np.float64) if precision else ("float32", np.float32)
                if not all(map(probe.verified, devices)):
                    figures[name] = "refused: the door asks for float64 here"
                    continue
                some = [x.astype(kind) for x in (u, y)]
                alarms = false_alarms({"short": r, "long": long}, vertices, kind)
                found, contradicted, differ = judged(r, *(x[:100_000] for x in some))
                figures[name] = {
                    "windows at vertices": vertices,
                    "false alarms at vertices": alarms,
                    "contradicted by one CPU device": contradicted,
                    "other than one CPU device": differ,
                    "decided again on the CPU": decided_again(found),
                    "strips, from and to the host": speed(
                        lambda some=some: jb.detect(r, *some).status, windows
                    ),
                }
                assert not any(alarms.values()) and not contradicted
        some, four = windows // 20, jb.LinearSystem(**FOUR)
        inputs = rng.normal(size=(some, four.m))
        outputs = np.asarray(jb.simulate(four, inputs, jax.random.key(2)).y)
        rows = jb.parity_relations(four, 15)
        figures["long windows, 32 rows, 4 states"] = speed(
            lambda: jb.detect(rows, inputs, outputs).status, some
        ) | {"wanted": WANTED["million long windows/s"]}
        figures[f"study of {scenarios} x 200"] = beside_cores(scenarios)
        figures["observer"] = speed(
            lambda: jb.detect(jb.observer(paper()), u[:20_000], y[:20_000]).status, 20_000
        )
        given = rng.uniform(-1, 1, (some, 1))
        healthy = given, np.asarray(jb.simulate(paper(), given, jax.random.key(3)).y)
        figures["tune, windows looked at"] = speed(
            lambda: jb.tune(r, healthy, steps=100, safety=1).smallest, 100 * some
        )
    stats = devices[0].memory_stats() or {}
    figures["peak MB of the first device"] = round(stats.get("peak_bytes_in_use", 0) / 1e6) or None
    timing.save(
        "accelerator",
        {"devices": len(devices), "load average": [round(x, 1) for x in os.getloadavg()], **figures},
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
