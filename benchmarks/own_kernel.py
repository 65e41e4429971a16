"""What a kernel of one's own would bring: the strip test and the fixed projection of long windows in C,
called by XLA (jax.ffi), beside the kernels that XLA compiles and one pass over the same bytes.

python -m benchmarks.own_kernel [--windows 4000000]

Needs a C compiler, `cc`, and GNU C's options; writes nothing but benchmarks/own_kernel.json. All rates are
those of one thread: processor time of calls by turns, the least of many.
"""

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_multi_thread_eigen=false"

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxbound as jb  # noqa: E402
from benchmarks import timing  # noqa: E402
from jaxbound.consistency.strips import verdicts  # noqa: E402
from jaxbound.sets.floats import rounding  # noqa: E402
from jaxbound.sets.floats.kernel import WIDE  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

BLOCK = 2**16
ROWS, STATES = 32, 4
OPTIONS = [
    "-O3",
    "-march=native",
    "-mprefer-vector-width=512",
    "-fno-trapping-math",
    "-fno-math-errno",
    "-fopenmp-simd",
]


def library(folder, dtype):
    """Return the C kernels of a float type, compiled."""
    path = Path(folder) / f"own_{np.dtype(dtype).name}.so"
    of = {"float64": "double", "float32": "float"}[np.dtype(dtype).name]
    source = Path(__file__).with_suffix(".c")
    macros = [f"-DT={of}", f"-DSTATES={STATES}", f"-I{jax.ffi.include_dir()}"]
    subprocess.run(["cc", *OPTIONS, *macros, "-shared", "-fPIC", "-o", path, source], check=True)
    return ctypes.CDLL(str(path))


def numbers(reading, dtype):
    """Return the numbers that `strips` takes, in its order."""
    strips, (tolerance, noise) = reading.strips, (np.asarray(x) for x in (reading.tolerance, reading.noise))
    H, offsets = np.zeros((4, 4)), [*np.asarray(reading.offset_y), *np.asarray(reading.offset_u)]
    for c, rows in enumerate(strips.supports):
        H[c, list(rows)] = strips.h[c] / (1 - tolerance[np.array(rows) % 2])
    gamma, floor = rounding.folded_error(strips.h.shape[1] + strips.k.shape[1], dtype)
    ulps = 4 * rounding.unit(dtype)
    rho = noise + np.asarray(reading.resolution) + ulps * noise + rounding.tiny(dtype)
    still = np.abs(H) @ np.abs(np.tile(offsets[:2], 2)) + np.abs(strips.k[:, 0] * offsets[2])
    floor = floor * (1 + np.abs(H).max())
    parts = H.ravel(), strips.k[:, 0], still, tolerance / (1 + tolerance), rho, offsets, [ulps, gamma, floor]
    return np.concatenate(parts).astype(dtype)


def least(runs, repeats=60):
    """Return {name: CPU seconds of one call}, the least of calls by turns."""
    seconds = dict.fromkeys(runs, np.inf)
    for _ in range(repeats):
        for name, run in runs.items():
            start = time.process_time()
            jax.block_until_ready(run())
            seconds[name] = min(seconds[name], time.process_time() - start)
    return seconds


@jax.jit
def one_pass(u, y):
    """One pass over the bytes of the strip test, its result included."""
    return u[:-1, 0] + y[:-1, 0] * y[1:, 1]


def strip_test(dtype):
    """Return the figures of the strip test."""
    rng = np.random.default_rng(0)
    reading = jb.parity_relations(paper()).reading(dtype)
    u = jnp.asarray(rng.normal(size=(BLOCK + 1, 1)), dtype)
    y = jnp.asarray(np.asarray(jb.simulate(paper(), np.asarray(u, float), 0).y), dtype)
    kinds = jax.ShapeDtypeStruct((BLOCK,), np.int8), jax.ShapeDtypeStruct((BLOCK,), dtype)
    own, constants = (
        jax.jit(jax.ffi.ffi_call(f"strips_{np.dtype(dtype).name}", kinds)),
        numbers(reading, dtype),
    )
    ours, theirs = verdicts(reading, u, y), own(u, y, constants)
    same = float(np.mean(np.asarray(ours[0]) == np.asarray(theirs[0])))
    return {
        "same statuses": same,
        **rates(
            {
                "one pass over the same bytes": lambda: one_pass(u, y),
                "status and margin, XLA": lambda: verdicts(reading, u, y),
                "status and margin, C": lambda: own(u, y, constants),
            }
        ),
    }


@jax.jit
def rows_once(z):
    """One pass over the bytes of the projection, its result included."""
    return sum(z[i] for i in range(ROWS))


@jax.jit
def by_dot(z, P, R, r):
    return jnp.max(jnp.abs(z - R @ (P @ z)) - r[:, None], 0)


def unrolled(z, P, R, r):
    """The same as elementwise sums, which fuse into one pass."""
    rows = [z[i] for i in range(ROWS)]
    d = [sum(P[s, i] * rows[i] for i in range(ROWS)) for s in range(STATES)]
    worst = -jnp.inf
    for i, row in enumerate(rows):
        rest = jnp.abs(row - sum(R[i, s] * d[s] for s in range(STATES))) - r[i]
        worst = jnp.where(rest > worst, rest, worst)
    return worst


def projection_test(dtype):
    """Return the figures of the fixed projection."""
    rng = np.random.default_rng(1)
    R = rng.normal(size=(ROWS, STATES))
    given = rng.normal(size=(ROWS, BLOCK)), np.linalg.pinv(R), R, np.full(ROWS, 2.0)
    z, P, R, r = (jnp.asarray(x, dtype) for x in given)
    host, M = np.asarray(z), np.eye(ROWS, dtype=dtype) - np.asarray(R) @ np.asarray(P)
    own = jax.jit(
        jax.ffi.ffi_call(f"projection_{np.dtype(dtype).name}", jax.ShapeDtypeStruct((BLOCK,), dtype))
    )
    fused = jax.jit(unrolled, compiler_options=WIDE)
    off = float(np.max(np.abs(np.asarray(own(z, P, R, r)) - np.asarray(by_dot(z, P, R, r)))))
    return {
        "largest difference": off,
        **rates(
            {
                "one pass over the same bytes": lambda: rows_once(z),
                "XLA, elementwise sums": lambda: fused(z, P, R, r),
                "XLA, products": lambda: by_dot(z, P, R, r),
                "NumPy, one 32 x 32 product": lambda: (np.abs(M @ host) - np.asarray(r)[:, None]).max(0),
                "C": lambda: own(z, P, R, r),
            }
        ),
    }


def rates(runs):
    """Return {name: {million windows/s, share of one pass}} of runs, the first of them that pass."""
    seconds = least(runs)
    limit = next(iter(seconds.values()))
    return {
        name: {"million windows/CPU s": round(BLOCK / s / 1e6, 1), "share of one pass": round(limit / s, 2)}
        for name, s in seconds.items()
    }


def main():
    if shutil.which("cc") is None:
        print("no C compiler, cc: nothing is measured")
        return
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        for dtype in (np.float64, np.float32):
            name = np.dtype(dtype).name
            compiled = library(folder, dtype)
            for kernel in ("strips", "projection"):
                capsule = jax.ffi.pycapsule(getattr(compiled, kernel))
                jax.ffi.register_ffi_target(f"{kernel}_{name}", capsule, platform="cpu")
            figures[name] = {"strips": strip_test(dtype), "projection": projection_test(dtype)}
    timing.save("own_kernel", figures)


if __name__ == "__main__":
    main()
