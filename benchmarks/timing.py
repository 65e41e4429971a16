"""Measure and report the same way everywhere: compile apart from run, medians, peers in one process, ratios
first.
"""

import ctypes
import ctypes.util
import json
import platform
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)


@contextmanager
def own_rounding():
    """Keep what a peer does to the processor's rounding mode to a block, or to a function that this
    decorates.

    Importing codac sets it to upward, and so do its functions; jaxbound refuses to prove anything then.
    """
    library = ctypes.CDLL(ctypes.util.find_library("m"))
    mode = library.fegetround()
    try:
        yield
    finally:
        library.fesetround(mode)


def clock(run, repeats=7):
    """Return (first call, median, fastest, slowest) seconds of `run`, blocking on its result."""
    times = []
    with own_rounding():
        for _ in range(repeats + 1):
            start = time.perf_counter()
            jax.block_until_ready(run())
            times.append(time.perf_counter() - start)
    return times[0], float(np.median(times[1:])), min(times[1:]), max(times[1:])


def machine():
    """Return what the figures were measured on."""
    device = jax.devices()[0]
    name = next(
        (line.split(":")[1].strip() for line in _cpuinfo() if line.startswith("model name")),
        platform.processor(),
    )
    return {
        "device": f"{device.platform} {device.device_kind}",
        "cpu": name,
        "cores": len(_affinity()),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "numpy": np.__version__,
    }


def _cpuinfo():
    path = Path("/proc/cpuinfo")
    return path.read_text().splitlines() if path.exists() else []


def _affinity():
    import os

    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count())


def save(name, figures):
    """Print figures as json and write them beside the benchmarks."""
    out = {"machine": machine(), **figures}
    (Path(__file__).parent / f"{name}.json").write_text(json.dumps(out, indent=1) + "\n")
    print(json.dumps(out, indent=1))


def option(flag, default):
    """Return the integer after a flag on the command line."""
    return int(float(sys.argv[sys.argv.index(flag) + 1])) if flag in sys.argv else default
