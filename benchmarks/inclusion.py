"""Inclusion functions: what compiling one costs, and boxes a second against the plain function at points.

python -m benchmarks.inclusion [--boxes 100000]
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import timing
from jaxbound.sets import inclusion, interval

W1, W2 = (np.random.default_rng(0).normal(size=shape) for shape in ((6, 4), (2, 6)))


def tanks(x):
    """Step of two double tanks."""
    q = 0.25 * jnp.sqrt(x)
    inflow = jnp.stack([jnp.full((), 0.125, x.dtype), q[0], jnp.full((), 0.0625, x.dtype), q[2]])
    return x + 0.5 * (inflow - q)


def network(x):
    """Two layers with tanh."""
    return W2 @ jnp.tanh(W1 @ x)


def oscillator(x):
    """Twenty steps of a Van der Pol oscillator."""
    step = lambda c, _: (c + 0.01 * jnp.stack([c[1], (1 - c[0] ** 2) * c[1] - c[0]]), None)
    return jax.lax.scan(step, x[:2], None, length=20)[0]


def main():
    """Measure and save."""
    count = timing.option("--boxes", 100_000)
    lo = np.random.default_rng(1).uniform(1, 2, (count, 4))
    boxes, out = interval(lo, lo + 0.01), {}
    jax.block_until_ready(jax.jit(jnp.sin)(1.0))
    for f in (tanks, network, oscillator):
        _, points, *_ = timing.clock(lambda f=f: jax.vmap(jax.jit(f))(lo))
        for method in ("natural", "mean_value", "best"):
            F = inclusion(f, method)
            start = time.perf_counter()
            jax.block_until_ready(F(boxes[0]))
            first = time.perf_counter() - start
            _, other, *_ = timing.clock(lambda F=F: F(boxes[1]))
            batch = jax.jit(jax.vmap(F))
            compiled, median, *_ = timing.clock(lambda batch=batch: batch(boxes), 5)
            out[f"{f.__name__}, {method}"] = {
                "first call s": round(first, 2),
                "next box ms": round(other * 1e3, 2),
                "million boxes/s": round(count / median / 1e6, 3),
                "compile of a batch s": round(compiled - median, 2),
                "slower than points": round(median / points, 1),
            }
    timing.save("inclusion", out)


if __name__ == "__main__":
    main()
