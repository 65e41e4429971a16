"""Operations on many zonotopes a second: jaxbound, rounded outward, beside plain NumPy, zonoopt, codac and
the limit.

python -m benchmarks.zonotope_algebra [--sets 100000]
(pip install zonoopt codac for the others)

The limit of an operation is the time in which memory moves what it reads and what it writes, at the speed of
one pass that doubles all generators. NumPy works on the whole batch and is not rounded; zonoopt takes one set
at a time and is not rounded; codac maps and adds boxes, one at a time, rounded outward.
"""

import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import peers, timing
from jaxbound import sets
from jaxbound.sets import Interval, Zonotope

FEW = 300  # sets for libraries that take one at a time


@jax.jit
def one_pass(G):
    """Read and write all generators once: what memory allows."""
    return 2.0 * G


def work(n, q, rng):
    """Return {operation: (jaxbound for one set, NumPy for all, zonoopt for one)}."""
    M, v, C, gain = (
        rng.normal(size=(n, n)),
        rng.normal(size=n),
        rng.normal(size=(1, n)),
        rng.normal(size=(n, 1)),
    )
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
        "linear_map": (
            lambda Z: sets.linear_map(M, Z, v),
            lambda c, G: (c @ M.T + v, M @ G),
            lambda z, Z: z.affine_map(Z, M, v),
        ),
        "minkowski_sum": (lambda Z: sets.minkowski_sum(Z, Z), twice, lambda z, Z: z.minkowski_sum(Z, Z)),
        "reduce_order girard": (
            lambda Z: sets.reduce_order(Z, 2),
            girard,
            lambda z, Z: Z.reduce_order(2 * n),
        ),
        "reduce_order last": (lambda Z: sets.reduce_order(Z, 2, "last"), None, None),
        "strip_intersection": (lambda Z: sets.strip_intersection(Z, strip, C, gain), meet, None),
        "intersection": (lambda Z: sets.intersection(Z, Z, M), common, lambda z, Z: z.intersection(Z, Z, M)),
        "interval_hull": (sets.interval_hull, lambda c, G: np.abs(G).sum(2), lambda z, Z: Z.bounding_box()),
    }


def boxes(n, rng):
    """Return {operation: codac's of one box}, rounded outward."""
    codac, M = peers.load("codac"), rng.normal(size=(n, n))
    if codac is None:
        return {}
    with timing.own_rounding():
        matrix, box = (
            codac.IntervalMatrix(np.stack([M, M], 2).tolist()),
            codac.IntervalVector([[-1.0, 1.0]] * n),
        )
    return {"linear_map": lambda: matrix * box, "minkowski_sum": lambda: box + box}


def size(tree):
    return sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(tree))


def figures(count, n, q):
    rng = np.random.default_rng(0)
    c, G = rng.normal(size=(count, n)), rng.normal(size=(count, n, q))
    Z = Zonotope(jnp.asarray(c), jnp.asarray(G))
    _, limit, *_ = timing.clock(lambda: one_pass(Z.generators))
    speed = 2 * size(Z.generators) / limit
    table, zonoopt, codac = {"memory, GB/s": round(speed / 1e9, 1)}, peers.load("zonoopt"), boxes(n, rng)
    for name, (ours, numpy, theirs) in work(n, q, rng).items():
        run = jax.jit(jax.vmap(ours))
        first, median, *_ = timing.clock(lambda run=run: run(Z))
        row = {
            "million sets/s": round(count / median / 1e6, 3),
            "first call s": round(first - median, 2),
            "share of the limit": round((size(Z) + size(jax.eval_shape(run, Z))) / speed / median, 2),
        }
        if numpy is not None:
            _, slow, *_ = timing.clock(lambda f=numpy: f(c, G), 3)
            row["ratio to NumPy"] = round(slow / median, 2)
        if theirs is not None and zonoopt is not None:
            made = [zonoopt.Zono(G[i], c[i]) for i in range(min(FEW, count))]
            row["ratio to zonoopt"] = against([partial(theirs, zonoopt, one) for one in made], median / count)
        if name in codac:
            row["ratio to codac, boxes"] = against([codac[name]] * FEW, median / count)
        table[name] = row
    return table


@timing.own_rounding()
def against(calls, ours):
    """Return how many times as long one call of a peer takes, or what it says."""
    start = time.perf_counter()
    try:
        for call in calls:
            call()
    except (AttributeError, TypeError, RuntimeError, ValueError) as e:
        return str(e)[:80]
    return round((time.perf_counter() - start) / len(calls) / ours, 1)


if __name__ == "__main__":
    count = timing.option("--sets", 100_000)
    here, absent = peers.present()
    timing.save(
        "zonotope_algebra",
        {
            "peers": {name: here.get(name, "not installed") for name in ("zonoopt", "codac")},
            **{
                f"{n} x {q}": figures(max(count // less, 100), n, q)
                for n, q, less in ((2, 8, 1), (4, 20, 2), (20, 60, 40))
            },
        },
    )
