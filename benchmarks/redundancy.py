"""Relations under unknown inputs (Ragot 1993): speed of bases and banks, and what the joint test sees that
single relations do not.

python -m benchmarks.redundancy [--windows 2000000]
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import timing

A = [[0, 0, 0, 0, 0], [0, "4/5", 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 1]]
B = [[1, 0], [1, 0], [2, 1], [1, 0], [1, 1]]
C = [[1, 1, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 1, 0]]
F = [1, 1, 0, 0, 1]
NOISE = "1/20"


def stable():
    """Return the paper's example with its unstable mode at 0.8."""
    return jb.LinearSystem(A, B, C, unknown_inputs=F, noise=NOISE)


@jax.jit
def elementwise(u, y):
    """One memory-bound relation: reads every sample once and writes one number a window."""
    return u[:, 0] + u[:, 1] + y[:, 0] * y[:, 1] + y[:, 2] * y[:, 3]


def bases():
    """Milliseconds for a basis, a bank and isolability of the example, warm."""
    m, out = stable(), {}
    runs = {
        "basis, window": lambda: jb.redundancy(m),
        "basis, elimination": lambda: jb.redundancy(m, "elimination"),
        "bank of nine": lambda: jb.structured_relations(m),
        "isolability": lambda: jb.isolability(m),
    }
    for name, run in runs.items():
        _, median, fastest, slowest = timing.clock(run, 15)
        out[name] = {"ms": round(1e3 * median, 2), "spread": [round(1e3 * t, 2) for t in (fastest, slowest)]}
    return out


def banks(windows):
    """Windows a second of the nine-relation bank against nine memory-bound passes."""
    m = stable()
    bank, rng = jb.structured_relations(m), np.random.default_rng(0)
    u, y = (jnp.asarray(rng.normal(size=(windows, c))) for c in (2, 4))
    runs = {
        "nine elementwise passes": lambda: [elementwise(u, y) for _ in range(9)],
        "detect with the bank": lambda: jb.detect(bank, u, y).words,
    }
    rate, table = {}, {}
    for name, run in runs.items():
        first, median, fastest, slowest = timing.clock(run, 5)
        rate[name] = windows / median / 1e6
        table[name] = {
            "million windows/s": round(rate[name], 2),
            "spread": [round(windows / t / 1e6, 2) for t in (slowest, fastest)],
            "first call s": round(first, 2),
        }
    return {
        "bank / nine passes": round(rate["detect with the bank"] / rate["nine elementwise passes"], 2),
        "rates": table,
    }


def sizes(T=2000):
    """Share of windows in which a bias is seen, by single relations of the minimal basis, the bank of nine,
    and the joint test.
    """
    m, rng = stable(), np.random.default_rng(1)
    basis, bank, joint = jb.redundancy(m), jb.structured_relations(m), jb.parity_relations(m, 3)
    out = {}
    u, v = rng.normal(size=(T, 2)), 10 * rng.normal(size=(T, 1))
    for signal in m.outputs + m.inputs:
        scalar = min(
            (float(2 * width(row, m) / abs(at_one)) for row, at_one in responses(basis, signal)),
            default=np.inf,
        )
        row = {
            "guaranteed, relations of the basis alone": round(scalar, 4),
            "guaranteed, joint": round(float(jb.detectable(m, signal, 3)), 4),
            "guaranteed, joint, 20 samples": round(float(jb.detectable(m, signal, 19)), 4),
        }
        for size in (0.05, 0.1, 0.2, 0.4):
            shift = size * (
                np.arange(len(m.inputs)) == (m.inputs.index(signal) if signal in m.inputs else -1)
            )
            y = np.array(jb.simulate(m, u + shift, jax.random.key(3), unknown_input=v).y)
            y += size * (np.arange(m.p) == (m.outputs.index(signal) if signal in m.outputs else -1))
            seen = [
                float(np.mean(jb.detect(r, u, y).status[3:] == jb.Status.FAULT)) for r in (basis, bank, joint)
            ]
            row[f"bias {size}: basis, bank, joint"] = [round(x, 3) for x in seen]
        out[signal] = row
    return out


def responses(relations, signal):
    """Yield (row, response to a constant fault of the signal) of the relations that have one."""
    j = relations.names.index(signal)
    for row in relations.rows:
        if steady := sum(row[j]):
            yield row, steady


def width(row, m):
    """Return the largest value that noise gives a relation."""
    return sum(abs(c) * m.noise[i] for i, p in enumerate(row[: m.p]) for c in p)


if __name__ == "__main__":
    start = time.perf_counter()
    count = timing.option("--windows", 2_000_000)
    timing.save("redundancy", {"windows": count, "bases": bases(), "bank": banks(count), "sizes": sizes()})
    print(f"{time.perf_counter() - start:.0f} s")
