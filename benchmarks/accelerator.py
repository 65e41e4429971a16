"""What an accelerator has to show before it may prove, in one run; on CPU the same with virtual devices, and the door stays shut.

The examination of its arithmetic in both precisions; no false alarm where every error lies at a bound; verdicts against those of one CPU
device; windows a second of strips, long windows, a study, an observer and tuning. Nothing is claimed of a device that this did not run on.

python -m benchmarks.accelerator [--windows 1000000] [--vertices 1000000] [--scenarios 20000] [--devices 8]
"""

import os
import sys

if "--devices" in sys.argv or not os.environ.get("JAX_PLATFORMS"):
    wanted = sys.argv[sys.argv.index("--devices") + 1] if "--devices" in sys.argv else "8"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={wanted}".strip()

from pathlib import Path

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.diagnosis.again import decided_again
from jaxbound.sets.floats import probe
from jaxbound.sets.floats.examination import examination

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402


class Unexamined:
    """A card that nobody has examined: the door has to stay shut."""

    platform, device_kind, compute_capability = "gpu", "NVIDIA of next year", "99.0"


def at_vertices(windows):
    """Return u, y of the paper's plant with every error at one of its bounds, in runs of 1000 samples."""
    runs = max(windows // 1000, 1)
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (runs, 50, 1)), 20, 1)
    return u, np.asarray(jb.simulate(paper(), u, jax.random.key(1), at="vertices").y)


def speed(run, windows):
    """Return millions a second, first call apart."""
    first, median, fastest, slowest = timing.clock(run, 3)
    return {"first s": round(first, 2), "million/s": [round(windows / t / 1e6, 2) for t in (median, slowest, fastest)]}


def judged(relations, u, y):
    """Return the statuses of all devices, and on how many windows a CPU device alone says something that contradicts them."""
    found = jb.detect(relations, u, y)
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        alone = jb.detect(relations, u, y).status
    proved = lambda x: (x == jb.Status.FAULT) | (x == jb.Status.CONSISTENT)
    return found, int((proved(found.status) & proved(alone) & (found.status != alone)).sum()), int((found.status != alone).sum())


def main():
    windows, vertices = timing.option("--windows", 10**6), timing.option("--vertices", 10**6)
    scenarios = timing.option("--scenarios", 20_000)
    devices, figures = jax.local_devices(), {}
    for dtype in (np.float32, np.float64):
        for device in devices[:: len(devices) - 1 or 1]:
            found = examination(device, dtype)
            broken = {name: pair for name, pair in found.items() if not pair[0] <= pair[1]}
            figures[f"examination of {device}, {np.dtype(dtype).name}"] = {"claims": len(found), "broken": broken}
    figures["may prove"] = {str(probe.kind_of_device(d)): probe.verified(d) for d in devices}
    figures["premises"] = probe.PREMISES.get(probe.kind_of_device(devices[0])["platform"], ("unknown",))
    assert not probe.verified(Unexamined()), "the door is open to what nobody has examined"
    if not all(map(probe.verified, devices)):
        figures["verdicts"] = "refused: this device is not in EXAMINED; margins alone were measured"
    r, long = jb.parity_relations(paper()), jb.parity_relations(paper(), 15)
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(windows, 1)), rng.normal(size=(windows, 2))
    figures["margins"] = speed(lambda: jb.margins(r, u, y), windows)
    if all(map(probe.verified, devices)):
        for precision in (True, False):
            with jax.enable_x64(precision):
                name, kind = ("float64", np.float64) if precision else ("float32", np.float32)
                given, some = [x.astype(kind) for x in at_vertices(vertices)], [x.astype(kind) for x in (u, y)]
                alarms = {n: int((jb.detect(x, *given).status == jb.Status.FAULT).sum()) for n, x in (("short", r), ("long", long))}
                found, contradicted, differ = judged(r, *(x[:100_000] for x in some))
                figures[name] = {"false alarms at vertices": alarms, "contradicted by one CPU device": contradicted,
                                 "other than one CPU device": differ, "decided again on the CPU": decided_again(found),
                                 "strips": speed(lambda some=some: jb.detect(r, *some).status, windows)}  # fmt: skip
                assert not any(alarms.values()) and not contradicted
        some = windows // 20
        figures["long windows"] = speed(lambda: jb.detect(long, u[:some], y[:some]).status, some)
        figures["study"] = speed(lambda: jb.study(paper(), "y1:bias", scenarios, 0, sizes=[0.5], samples=200).tallies, scenarios * 200)
        figures["observer"] = speed(lambda: jb.detect(jb.observer(paper()), u[:20_000], y[:20_000]).status, 20_000)
    stats = devices[0].memory_stats() or {}
    figures["peak MB of the first device"] = round(stats.get("peak_bytes_in_use", 0) / 1e6) or None
    timing.save("accelerator", {"devices": len(devices), "load average": [round(x, 1) for x in os.getloadavg()], **figures})


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    main()
