"""Windows a second of section 5 (Adrot 2000): jaxbound against blocked NumPy, naive NumPy, HiGHS and the
memory bandwidth.

python -m benchmarks.strips [--windows 10000000]

Samples are random, so that nearly every window is faulty and is decided twice; the share of the limit is that
of a healthy recording, in seconds of the clock and of the processor, the least of calls by turns.
"""

import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import opponents, timing

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402


@jax.jit
def elementwise(u, y):
    """One pass that reads the same bytes and writes the same bytes as margins."""
    return u[:, 0] + y[:, 0] * y[:, 1]


def figures(windows, dtype):
    rng = np.random.default_rng(0)
    u, y = (jnp.asarray(rng.normal(size=(windows, c)).astype(dtype)) for c in (1, 2))
    host_u, host_y = np.asarray(u), np.asarray(y)
    relations = jb.parity_relations(paper())
    blocked = opponents.Blocked(dtype)
    runs = {
        "elementwise pass": lambda: elementwise(u, y),
        "jaxbound margins": lambda: jb.margins(relations, u, y),
        "jaxbound detect (status and margin)": lambda: jb.detect(relations, u, y).status,
        "numpy blocked margins": lambda: blocked.run(host_u, host_y),
        "numpy blocked statuses": lambda: blocked.run(host_u, host_y, proof=True),
        "numpy naive margins": lambda: opponents.naive(host_u, host_y),
    }
    table, rate = {}, {}
    for name, run in runs.items():
        first, median, fastest, slowest = timing.clock(run, 3 if "naive" in name else 7)
        rate[name] = windows / median / 1e6
        table[name] = {
            "million windows/s": round(rate[name], 1),
            "spread": [round(windows / t / 1e6, 1) for t in (slowest, fastest)],
            "first call s": round(first, 3),
        }
    few = min(windows, 20_000)
    program = opponents.LinearProgram()
    start = time.perf_counter()
    infeasible = program.run(host_u[: few + 1].astype(float), host_y[: few + 1].astype(float))
    rate["HiGHS, reused model"] = few / (time.perf_counter() - start) / 1e6
    table["HiGHS, reused model"] = {"million windows/s": round(rate["HiGHS, reused model"], 4)}
    agree = float(
        np.mean(
            (jb.detect(relations, u[: few + 1], y[: few + 1]).status[1:] == jb.Status.FAULT) == infeasible
        )
    )
    close = np.nanmax(
        abs(np.asarray(jb.margins(relations, u[:few], y[:few])) - blocked.run(host_u[:few], host_y[:few]))
    )
    margins, detect = rate["jaxbound margins"], rate["jaxbound detect (status and margin)"]
    ratios = {
        "margins / blocked NumPy": margins / rate["numpy blocked margins"],
        "margins / naive NumPy": margins / rate["numpy naive margins"],
        "margins / HiGHS": margins / rate["HiGHS, reused model"],
        "margins / elementwise pass": margins / rate["elementwise pass"],
        "detect / blocked NumPy statuses": detect / rate["numpy blocked statuses"],
        "cost of proof (margins / detect)": margins / detect,
    }
    return {
        "ratios": {k: round(v, 2) for k, v in ratios.items()},
        "rates": table,
        "agreement with HiGHS": agree,
        "largest difference to NumPy margins": float(close),
    }


def share_of_limit(windows, dtype, repeats=9):
    """Return what share of one elementwise pass over the same bytes a healthy recording reaches."""
    u = np.random.default_rng(0).normal(size=(windows, 1))
    y = np.asarray(jb.simulate(paper(), u, 0).y)
    u, y = jnp.asarray(u.astype(dtype)), jnp.asarray(y.astype(dtype))
    relations = jb.parity_relations(paper())
    runs = {
        "pass": lambda: elementwise(u, y),
        "margins": lambda: jb.margins(relations, u, y),
        "detect": lambda: jb.detect(relations, u, y).status,
    }
    least = {name: [np.inf, np.inf] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            wall, cpu = time.perf_counter(), time.process_time()
            jax.block_until_ready(run())
            taken = time.perf_counter() - wall, time.process_time() - cpu
            least[name] = list(map(min, least[name], taken))
    shares = {}
    for name in ("margins", "detect"):
        for kind, limit, seconds in zip(("clock", "processor"), least["pass"], least[name], strict=True):
            shares[f"{name}, {kind}"] = round(limit / seconds, 2)
    return shares


def horizons(windows=200_000):
    """Rate against the number of circuits."""
    rng = np.random.default_rng(1)
    u, y = rng.normal(size=(windows, 1)), rng.normal(size=(windows, 2))
    out = {}
    for s in (1, 2, 3, 4, 6):
        relations = jb.parity_relations(paper(), horizon=s)
        first, median, *_ = timing.clock(lambda r=relations: jb.detect(r, u, y).status, 3)
        out[s] = {
            "circuits": len(relations.circuits),
            "million windows/s": round(windows / median / 1e6, 2),
            "first call s": round(first, 2),
        }
    return out


if __name__ == "__main__":
    count = timing.option("--windows", 10_000_000)
    timing.save(
        "strips",
        {
            "windows": count,
            "share of the limit": {
                np.dtype(d).name: share_of_limit(count, d) for d in (np.float64, np.float32)
            },
            **{np.dtype(d).name: figures(count, d) for d in (np.float64, np.float32)},
            "horizons": horizons(),
        },
    )
