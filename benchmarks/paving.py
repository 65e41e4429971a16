"""Boxes a second: adaptive bisection of Fig. 1 for 5 000 targets, and the paper's own eight variables of section 5.

python -m benchmarks.paving [--targets 5000] [--windows 1000]
"""

import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.diagnosis.gridding import internal_form

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

BOX = ([-1.0, 1.0], [2.0, 3.0])


def figure_1(z):
    return [2 * z[0] ** 2 + z[1], z[0] - z[1]]


def numpy_adaptive(targets, depth=18):
    """The same frontier in NumPy: batched over targets, level by level, without outward rounding. Returns boxes evaluated."""
    lo, hi = (np.repeat(np.array(b)[:, None], len(targets), 1) for b in BOX)
    owner, evaluated = np.arange(len(targets)), 0
    for level in range(depth):
        evaluated += lo.shape[1]
        near = np.maximum(np.maximum(lo[0], -hi[0]), 0)
        far = np.maximum(-lo[0], hi[0])
        t = targets[owner].T
        keep = (2 * near * near + lo[1] <= t[0]) & (t[0] <= 2 * far * far + hi[1]) & (lo[0] - hi[1] <= t[1]) & (t[1] <= hi[0] - lo[1])
        lo, hi, owner = np.repeat(lo[:, keep], 2, 1), np.repeat(hi[:, keep], 2, 1), np.repeat(owner[keep], 2)
        axis = level % 2
        middle = (lo[axis, ::2] + hi[axis, ::2]) / 2
        hi[axis, ::2], lo[axis, 1::2] = middle, middle
    return evaluated


def section_5(windows):
    """Draw windows that the joint test rejects and the box test accepts; return pave's arguments."""
    rng = np.random.default_rng(0)
    relations = jb.parity_relations(paper())
    u, y = rng.uniform(-1, 1, (400_000, 1)), rng.normal(0, 1, (400_000, 2))
    only = (jb.detect(relations, u, y).status == jb.Status.FAULT) & (jb.detect(relations, u, y, "box").status != jb.Status.FAULT)
    only[0] = False
    picked = np.flatnonzero(only)[:windows]
    Y = np.concatenate([y[picked - 1], y[picked]], 1)
    target = np.asarray(relations.external(u, y))[picked]
    each = lambda x: np.broadcast_to(x, (len(picked), *np.shape(x)))
    W = np.array([[float(x) for x in row] for row in relations.W])
    return target, (Y, Y, each(np.tile([0.02, 0.1], 2)), each(np.tile([0.1, 0.01], 2)), each(W), each(W))


def main():
    count, windows = timing.option("--targets", 5000), timing.option("--windows", 1000)
    rng = np.random.default_rng(0)
    z = rng.uniform(*BOX, (count, 2))
    targets = np.stack([2 * z[:, 0] ** 2 + z[:, 1], z[:, 0] - z[:, 1]], 1)
    box = jb.interval(*map(np.array, BOX))
    out = {}
    found = jb.pave(figure_1, box, targets)
    first, median, *_ = timing.clock(lambda: jb.pave(figure_1, box, targets).evaluated, 5)
    boxes = int(found.evaluated.sum())
    _, numpy_median, *_ = timing.clock(lambda: numpy_adaptive(targets), 5)
    out["adaptive, Fig. 1"] = {
        "targets": count,
        "boxes": boxes,
        "million boxes/s": round(boxes / median / 1e6, 2),
        "NumPy million boxes/s": round(numpy_adaptive(targets) / numpy_median / 1e6, 2),
        "false rejections": int((found.status == jb.Status.FAULT).sum()),
    }
    edge = np.ones(8)
    target, args = section_5(windows)
    eight = jb.interval(-edge, edge)
    for q in (2, 3):
        start = time.perf_counter()
        found = jb.pave(internal_form, eight, target, q=q, args=args, max_boxes=10**9)
        spent = time.perf_counter() - start
        out[f"adaptive, section 5, r <= {q - 1}"] = {
            "windows": len(target),
            "rejected share": float(np.mean(found.status == jb.Status.FAULT)),
            "boxes a window": float(found.evaluated.mean()),
            "largest": int(found.evaluated.max()),
            "million boxes/s": round(found.evaluated.sum() / spent / 1e6, 2),
        }
    jb.pave(internal_form, eight, jnp.asarray(target), "uniform", q=4, args=args)
    start = time.perf_counter()
    found = jb.pave(internal_form, eight, jnp.asarray(target), "uniform", q=4, args=args)
    spent = time.perf_counter() - start
    out["uniform q = 4, section 5"] = {
        "windows": len(target),
        "boxes": int(found.evaluated.sum()),
        "million boxes/s": round(found.evaluated.sum() / spent / 1e6, 2),
        "rejected share": float(np.mean(found.status == jb.Status.FAULT)),
    }
    timing.save("paving", out)


if __name__ == "__main__":
    main()
