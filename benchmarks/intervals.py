"""Sound interval operations against the same formulas without rounding, and against flint, codac and mpmath,
in one run.

python -m benchmarks.intervals [--count 4000000]

The unrounded peer has the formulas of immrax 0.3.8, whose many dependencies are not needed for them, written
here as `UNROUNDED`; its sin, a switch of branches under vmap, is replaced by selects that do the same.
"""

import math
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import timing
from jaxbound import sets
from jaxbound.sets.intervals.interval import Interval


def mul(x, y):
    a, b, c, d = x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1]
    return jnp.minimum(jnp.minimum(a, b), jnp.minimum(c, d)), jnp.maximum(
        jnp.maximum(a, b), jnp.maximum(c, d)
    )


def div(x, y):
    apart = ((y[0] > 0) & (y[1] > 0)) | ((y[0] < 0) & (y[1] < 0))
    return mul(x, (jnp.where(apart, 1 / y[1], -jnp.inf), jnp.where(apart, 1 / y[0], jnp.inf)))


def sqr(x):
    a, b = x[0] * x[0], x[1] * x[1]
    return jnp.where((x[0] < 0) & (x[1] > 0), 0, jnp.minimum(a, b)), jnp.maximum(a, b)


def sin(x):
    """Return the range of sin: at its ends where the cosines agree and half a turn is not exceeded, 1 or -1
    otherwise.
    """
    lo, hi = x
    low, high, rises, ends_rising = jnp.sin(lo), jnp.sin(hi), jnp.cos(lo) >= 0, jnp.cos(hi) >= 0
    half, whole = hi - lo <= jnp.pi, hi - lo <= 2 * jnp.pi
    same, least, most = rises == ends_rising, jnp.minimum(low, high), jnp.maximum(low, high)
    lower = jnp.where(
        half, jnp.where(same | rises, least, -1), jnp.where(whole & rises & ~ends_rising, least, -1)
    )
    return lower, jnp.where(
        half, jnp.where(same | ~rises, most, 1), jnp.where(whole & ~rises & ends_rising, most, 1)
    )


def cut(f):
    """Return the range of an increasing f on numbers >= 0, without a bound elsewhere."""
    return lambda x: (jnp.where(x[0] < 0, -jnp.inf, f(x[0])), jnp.where(x[0] < 0, -jnp.inf, f(x[1])))


def increasing(f):
    return lambda x: (f(x[0]), f(x[1]))


UNROUNDED = SimpleNamespace(
    add=lambda x, y: (x[0] + y[0], x[1] + y[1]),
    sub=lambda x, y: (x[0] - y[1], x[1] - y[0]),
    mul=mul,
    div=div,
    sqr=sqr,
    sin=sin,
    sqrt=cut(jnp.sqrt),
    log=cut(jnp.log),
    exp=increasing(jnp.exp),
    asin=increasing(jnp.arcsin),
    atan=increasing(jnp.arctan),
    tanh=increasing(jnp.tanh),
)


def compound(ops, x, y, z, one, two):
    """Ten operations: z sqrt(1 + ((x y + z) / (x + 2) - y^2)^2)."""
    t = ops.sub(ops.div(ops.add(ops.mul(x, y), z), ops.add(x, two)), ops.sqr(y))
    return ops.mul(ops.sqrt(ops.add(ops.sqr(t), one)), z)


BINARY, UNARY = ("add", "sub", "mul", "div"), ("sqr", "sqrt", "exp", "log", "sin", "asin", "atan", "tanh")


def large_arrays(count, dtype):
    """Time each operation and the compound kernel on arrays; ratio: throughput of jaxbound over the peer's,
    run by run.
    """
    peer, rng = UNROUNDED, np.random.default_rng(0)
    raw = []
    for low in (0.1, 0.2, 0.3):
        lo = rng.uniform(low, low + 0.3, count).astype(dtype)
        raw.append((jnp.asarray(lo), jnp.asarray((lo + rng.uniform(0, 0.2, count)).astype(dtype))))
    constants = [(jnp.full(count, v, dtype),) * 2 for v in (1, 2)]
    ours = [Interval(*ends) for ends in (*raw, *constants)]
    theirs = [*raw, *constants]
    kernels = {op: (lambda ops, x, y, z, one, two, op=op: getattr(ops, op)(x, y)) for op in BINARY}
    kernels |= {op: (lambda ops, x, y, z, one, two, op=op: getattr(ops, op)(x)) for op in UNARY}
    kernels["compound of 10"] = compound
    table = {}
    for name, kernel in kernels.items():
        run = (
            jax.jit(lambda *a, kernel=kernel: kernel(sets, *a)),
            jax.jit(lambda *a, kernel=kernel: kernel(peer, *a)),
        )
        times = [
            [seconds_of(f, a) for f, a in zip(run, (ours, theirs), strict=True)] for _ in range(16)
        ]  # in turns: a load meets both
        first, *rest = np.array(times)
        median, fastest, slowest = np.median(rest, 0), np.min(rest, 0), np.max(rest, 0)
        speed = lambda t: round(count / t / 1e6, 1)
        table[name] = {"ratio": round(float(np.median([b / a for a, b in rest])), 2)}
        for k, side in enumerate(("jaxbound", "unrounded")):
            table[name][side] = {
                "million intervals/s": speed(median[k]),
                "first call s": round(first[k], 3),
                "spread": [speed(slowest[k]), speed(fastest[k])],
            }
        ratio = table[name]["ratio"]
        print(f"{np.dtype(dtype).name} {name}: {ratio:.2f}", flush=True)
    return table


def seconds_of(f, arguments):
    start = time.perf_counter()
    jax.block_until_ready(f(*arguments))
    return time.perf_counter() - start


@timing.own_rounding()
def scalar_libraries():
    """Return {library: {operation: seconds}} of libraries that work on one interval at a time."""
    out = {}
    add = {"add": lambda a, b: a + b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b}
    try:
        from flint import arb

        out["flint"] = (
            {**add, "exp": lambda a, b: a.exp(), "sin": lambda a, b: a.sin(), "log": lambda a, b: a.log()},
            arb(0.3, 0.1),
            arb(0.5, 0.1),
        )
    except ImportError:
        print("flint is not installed")
    try:
        import codac

        out["codac"] = {**add, **of_first(codac)}, codac.Interval(0.2, 0.4), codac.Interval(0.4, 0.6)
    except ImportError:
        print("codac is not installed")
    try:
        from mpmath import iv

        out["mpmath"] = {**add, **of_first(iv)}, iv.mpf([0.2, 0.4]), iv.mpf([0.4, 0.6])
    except ImportError:
        print("mpmath is not installed")
    return {
        library: {op: seconds(f, a, b) for op, f in functions.items()}
        for library, (functions, a, b) in out.items()
    }


def of_first(library):
    """Return exp, sin and log of the first of two arguments."""
    apply = lambda f: lambda a, b: f(a)
    return {op: apply(getattr(library, op)) for op in ("exp", "sin", "log")}


def seconds(f, a, b, count=20_000):
    """Return the least seconds a call of five runs."""
    best = math.inf
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(count):
            f(a, b)
        best = min(best, (time.perf_counter() - start) / count)
    return best


def main():
    count = timing.option("--count", 4_000_000)
    arrays = {np.dtype(d).name: large_arrays(count, d) for d in (np.float64, np.float32)}
    scalar = {}
    for library, times in scalar_libraries().items():
        for op, t in times.items():
            ours = arrays["float64"][op]["jaxbound"]["million intervals/s"]
            scalar.setdefault(library, {})[op] = {
                "ratio": round(ours * 1e6 * t, 1),
                "million intervals/s": round(1e-6 / t, 3),
            }
    ratios = {name: {op: row["ratio"] for op, row in table.items()} for name, table in arrays.items()}
    scalar_ratios = {
        library: {op: row["ratio"] for op, row in rows.items()} for library, rows in scalar.items()
    }
    timing.save(
        "intervals",
        {
            "ratios": {"to unrounded": ratios, "to one interval at a time": scalar_ratios},
            "count": count,
            "arrays": arrays,
            "one interval at a time": scalar,
        },
    )


if __name__ == "__main__":
    main()
