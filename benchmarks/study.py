"""Scenarios a second of a Monte-Carlo study (section 5, Adrot 2000): the fused kernel, recordings with
`detect`, an adversary, and NumPy.

python -m benchmarks.study [--scenarios 1000000]
"""

import time

import numpy as np

import jaxbound as jb
from benchmarks import opponents, timing
from jaxbound.cli.demonstration import demo_model

SAMPLES, HOLD = 200, 20


def clocked(run):
    """Return (seconds, CPU seconds, result) of one call."""
    wall, cpu = time.perf_counter(), time.process_time()
    out = run()
    return time.perf_counter() - wall, time.process_time() - cpu, out


def in_numpy(scenarios, rng, blocked):
    """Simulate and test in NumPy, blocks of scenarios side by side; return the FAULT share while the fault
    acts.
    """
    hits = total = 0
    A, noise, tolerance = np.array([[0.8, 1], [0, 0.2]]), np.array([0.1, 0.01]), np.array([0.02, 0.1])
    for first in range(0, scenarios, 512):
        N = min(512, scenarios - first)
        u = np.repeat(rng.uniform(-1, 1, (SAMPLES // HOLD, N)), HOLD, 0)
        x, y = np.zeros((N, 2)), np.empty((SAMPLES, N, 2))
        for k in range(SAMPLES):
            t = np.stack([x[:, 0], x[:, 0] + x[:, 1]], 1)
            y[k] = t * (1 + tolerance * rng.uniform(-1, 1, t.shape)) + noise * rng.uniform(-1, 1, t.shape)
            x = x @ A.T
            x[:, 1] += u[k]
        y[100:, :, 0] += 0.2
        laid = (
            np.ascontiguousarray(u.T).reshape(-1, 1),
            np.ascontiguousarray(y.transpose(1, 0, 2)).reshape(-1, 2),
        )
        status = blocked.run(*laid, proof=True).reshape(N, SAMPLES)
        hits, total = hits + int((status[:, 101:] == jb.Status.FAULT).sum()), total + N * 99
    return hits / total


def figures(scenarios):
    """Measure everything; return a table and ratios."""
    model = demo_model()
    fault = jb.Fault("y1", "bias", 0.2, 100)
    first, first_cpu, _ = clocked(lambda: jb.study(model, fault, 4096, 0, samples=SAMPLES))
    table, speed = {"first call": {"s": round(first, 2), "CPU s": round(first_cpu, 2)}}, {}

    def entry(name, count, run, rate=None):
        wall, cpu, out = clocked(run)
        speed[name] = count * SAMPLES / wall
        table[name] = {
            "scenarios": count,
            "s": round(wall, 2),
            "CPU s": round(cpu, 2),
            "million samples/s": round(speed[name] / 1e6, 3),
            "million samples/s of CPU time": round(count * SAMPLES / cpu / 1e6, 3),
        }
        if isinstance(out, float):
            table[name]["rate"] = round(out, 4)
        else:
            row = out.to_pandas().iloc[0]
            table[name] |= {"rate": round(row.rate, 4), "false alarms": out.false_alarms}
        return out

    for at in ("uniform", "vertices"):
        entry(
            f"study, {at}",
            scenarios,
            lambda at=at: jb.study(model, fault, scenarios, 1, samples=SAMPLES, at=at),
        )
    few = max(scenarios // 500, 256)
    long = jb.parity_relations(model, 6)
    jb.study(model, fault, 655, 0, long, samples=SAMPLES)
    entry(
        "study, windows of 7 samples, through recordings",
        few,
        lambda: jb.study(model, fault, few, 1, long, samples=SAMPLES),
    )
    jb.study(model, fault, 256, 0, samples=SAMPLES, at="adversarial")
    entry(
        "study, adversary of 240 steps",
        few,
        lambda: jb.study(model, fault, few, 1, samples=SAMPLES, at="adversarial"),
    )
    blocked = opponents.Blocked(np.float64)
    in_numpy(512, np.random.default_rng(0), blocked)
    entry("NumPy, side by side", 10 * few, lambda: in_numpy(10 * few, np.random.default_rng(1), blocked))
    ratios = {"study / NumPy": speed["study, uniform"] / speed["NumPy, side by side"]}
    return table, {name: round(x, 1) for name, x in ratios.items()}


if __name__ == "__main__":
    table, ratios = figures(timing.option("--scenarios", 1_000_000))
    timing.save("study", {"samples of a scenario": SAMPLES, "ratios": ratios, "float64": table})
