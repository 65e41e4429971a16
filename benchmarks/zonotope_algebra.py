"""Operations on many zonotopes a second: jaxbound, rounded outward, beside plain NumPy, zonoopt and the limit.

python -m benchmarks.zonotope_algebra [--sets 100000]
"""

import importlib
import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import timing
from jaxbound import sets
from jaxbound.sets import Interval, Zonotope

FEW = 300  # sets for libraries that take one at a time


@jax.jit
def one_pass(G):
    """Read and write all generators once: what memory allows."""
    return 2.0 * G


def work(n, q, rng):
    """Return {operation: (jaxbound for one set, NumPy for all, zonoopt for one)}."""
    M, v, C, gain = rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=(1, n)), rng.normal(size=(n, 1))
    strip, keep = Interval(jnp.full(1, -1.0), jnp.full(1, 1.0)), 2 * n - n

    def girard(c, G):
        size = np.abs(G)
        order = np.argsort(-(size.sum(1) - size.max(1)), axis=1)
        G = np.take_along_axis(G, order[:, None], 2)
        box = np.abs(G[:, :, keep:]).sum(2)
        return np.concatenate([G[:, :, :keep], box[:, :, None] * np.eye(n)], 2)

    def meet(c, G):
        L = gain
        return c - (c @ C.T) @ L.T, np.concatenate([G - L @ (C @ G), np.broadcast_to(L, (len(G), n, 1))], 2)

    twice = lambda c, G: (c + c, np.concatenate([G, G], 2))
    common = lambda c, G: (c, np.concatenate([M @ G, -G], 2), c - c @ M.T)
    return {
        "linear_map": (lambda Z: sets.linear_map(M, Z, v), lambda c, G: (c @ M.T + v, M @ G), lambda z, Z: z.affine_map(Z, M, v)),
        "minkowski_sum": (lambda Z: sets.minkowski_sum(Z, Z), twice, lambda z, Z: z.minkowski_sum(Z, Z)),
        "reduce_order girard": (lambda Z: sets.reduce_order(Z, 2), girard, lambda z, Z: Z.reduce_order(2 * n)),
        "reduce_order last": (lambda Z: sets.reduce_order(Z, 2, "last"), None, None),
        "strip_intersection": (lambda Z: sets.strip_intersection(Z, strip, C, gain), meet, None),
        "intersection": (lambda Z: sets.intersection(Z, Z, M), common, lambda z, Z: z.intersection(Z, Z, M)),
        "interval_hull": (sets.interval_hull, lambda c, G: np.abs(G).sum(2), lambda z, Z: Z.bounding_box()),
    }  # fmt: skip


def figures(count, n, q):
    rng = np.random.default_rng(0)
    c, G = rng.normal(size=(count, n)), rng.normal(size=(count, n, q))
    Z = Zonotope(jnp.asarray(c), jnp.asarray(G))
    _, limit, *_ = timing.clock(lambda: one_pass(Z.generators))
    peer, table = zonoopt(), {"one pass over the generators, million sets/s": round(count / limit / 1e6, 2)}
    for name, (ours, numpy, theirs) in work(n, q, rng).items():
        run = jax.jit(jax.vmap(ours))
        first, median, *_ = timing.clock(lambda run=run: run(Z))
        row = {
            "million sets/s": round(count / median / 1e6, 3),
            "first call s": round(first - median, 2),
            "share of one pass": round(limit / median, 2),
        }
        if numpy is not None:
            _, slow, *_ = timing.clock(lambda f=numpy: f(c, G), 3)
            row["ratio to NumPy"] = round(slow / median, 2)
        if theirs is not None and peer is not None:
            row["ratio to zonoopt"] = against(peer, theirs, c, G, median / count)
        table[name] = row
    return table


def zonoopt():
    """Return the module of a peer, if it is installed."""
    try:
        return importlib.import_module("zonoopt")
    except ImportError:
        return None


def against(peer, theirs, c, G, ours):
    """Return how many times as long one call of the peer takes, or what it says."""
    made = [peer.Zono(G[i], c[i]) for i in range(min(FEW, len(c)))]
    start = time.perf_counter()
    try:
        for Z in made:
            theirs(peer, Z)
    except (AttributeError, TypeError, RuntimeError, ValueError) as e:
        return str(e)[:80]
    return round((time.perf_counter() - start) / len(made) / ours, 1)


if __name__ == "__main__":
    count = timing.option("--sets", 100_000)
    timing.save(
        "zonotope_algebra", {f"{n} x {q}": figures(max(count // size, 100), n, q) for n, q, size in ((2, 8, 1), (4, 20, 2), (20, 60, 40))}
    )
