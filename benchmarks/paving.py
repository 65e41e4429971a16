"""Boxes a second: adaptive bisection of Fig. 1 for 5 000 targets, and the paper's own eight variables of
section 5; set inversion against codac's SIVIA (pip install codac; a plain Python SIVIA where it is missing);
windows with constant tolerances a second.

python -m benchmarks.paving [--targets 5000] [--windows 1000]
"""

import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.sets.intervals.interval import Interval, interval, matmul

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

BOX = ([-1.0, 1.0], [2.0, 3.0])


def internal_form(z, y, tolerance, rho, W):
    """Enclose W mu, mu = (theta y + rho delta) / (1 + theta) with z = (theta / tolerance, delta), (9) of
    Adrot 2000.
    """
    rows = len(y)
    theta = z[:rows] * interval(tolerance)
    return matmul(Interval(W, W), (theta * interval(y) + interval(rho) * z[rows:]) / (1 + theta))


def figure_1(z):
    return [2 * z[0] ** 2 + z[1], z[0] - z[1]]


def numpy_adaptive(targets, depth=18):
    """The same frontier in NumPy: batched over targets, level by level, without outward rounding. Returns
    boxes evaluated.
    """
    lo, hi = (np.repeat(np.array(b)[:, None], len(targets), 1) for b in BOX)
    owner, evaluated = np.arange(len(targets)), 0
    for level in range(depth):
        evaluated += lo.shape[1]
        near = np.maximum(np.maximum(lo[0], -hi[0]), 0)
        far = np.maximum(-lo[0], hi[0])
        t = targets[owner].T
        keep = (
            (2 * near * near + lo[1] <= t[0])
            & (t[0] <= 2 * far * far + hi[1])
            & (lo[0] - hi[1] <= t[1])
            & (t[1] <= hi[0] - lo[1])
        )
        lo, hi, owner = np.repeat(lo[:, keep], 2, 1), np.repeat(hi[:, keep], 2, 1), np.repeat(owner[keep], 2)
        axis = level % 2
        middle = (lo[axis, ::2] + hi[axis, ::2]) / 2
        hi[axis, ::2], lo[axis, 1::2] = middle, middle
    return evaluated


def python_sivia(lo, hi, region, eps):
    """Set inversion one box at a time: the area of the inner boxes and of inner and boundary boxes. Without
    outward rounding.
    """
    (a_lo, b_lo), (a_hi, b_hi) = region
    waiting, inner, boundary = [(lo[0], hi[0], lo[1], hi[1])], 0.0, 0.0
    while waiting:
        x, X, y, Y = waiting.pop()
        near, far = max(x, -X, 0.0), max(-x, X)
        p, P, q, Q = 2 * near * near + y, 2 * far * far + Y, x - Y, X - y
        if p > a_hi or P < a_lo or q > b_hi or Q < b_lo:
            continue
        if a_lo <= p and P <= a_hi and b_lo <= q and Q <= b_hi:
            inner += (X - x) * (Y - y)
        elif max(X - x, Y - y) <= eps:
            boundary += (X - x) * (Y - y)
        elif X - x >= Y - y:
            waiting += [(x, (x + X) / 2, y, Y), ((x + X) / 2, X, y, Y)]
        else:
            waiting += [(x, X, y, (y + Y) / 2), (x, X, (y + Y) / 2, Y)]
    return inner, inner + boundary


@timing.own_rounding()
def peer_sivia(regions, eps):
    """Return the peer's name, its median seconds for all regions, and the areas (inner, outer) that it
    reaches.
    """
    try:
        import codac
    except ImportError:
        run = lambda: [python_sivia(*BOX, r, eps) for r in regions]
        return ("plain Python SIVIA", timing.clock(run, 3)[1], run())
    x = codac.VectorVar(2)
    f = codac.AnalyticFunction([x], [2 * codac.sqr(x[0]) + x[1], x[0] - x[1]])
    start = codac.IntervalVector([list(pair) for pair in zip(*BOX, strict=True)])
    pave = lambda r: codac.sivia(
        start, f, codac.IntervalVector([list(pair) for pair in zip(*r, strict=True)]), eps
    )
    area = lambda boxes: sum(b.volume() for b in boxes)
    reached = []
    for r in regions:
        found = pave(r)
        inner = area(found.boxes(codac.PavingInOut.inner))
        reached.append((inner, inner + area(found.boxes(codac.PavingInOut.bound))))
    return "codac SIVIA", timing.clock(lambda: [pave(r) for r in regions], 3)[1], reached


def inversion(box, count, eps):
    """Pave {z : figure_1(z) in a region} for `count` regions until the areas are bracketed as closely as by
    the peer.
    """
    rng = np.random.default_rng(1)
    mid = rng.uniform([2, -3], [8, 0], (count, 2))
    regions = [(tuple(m - 1), tuple(m + 1)) for m in mid]
    name, seconds, reached = peer_sivia(regions, eps)
    goal = np.mean([outer - inner for inner, outer in reached])
    target = jb.interval(mid - 1, mid + 1)
    volume = lambda b: float(np.prod(np.asarray(b.hi) - np.asarray(b.lo), 1).sum()) / count
    for depth in range(8, 60):
        run = lambda depth=depth: jb.pave(
            figure_1, box, target, solutions="all", max_depth=depth, max_boxes=10**9
        )
        found = run()
        if volume(found.boxes) <= goal:
            break
    first, median, *_ = timing.clock(lambda: run().evaluated, 3)
    inner = volume(found.witness)
    return {
        "peer": name,
        "regions": count,
        "mean area, peer": [float(np.mean([r[k] for r in reached])) for k in (0, 1)],
        "mean area": [inner, inner + volume(found.boxes)],
        "boxes": int(found.evaluated.sum()),
        "peer seconds": round(seconds, 4),
        "seconds": round(median, 4),
        "times faster": round(seconds / median, 1),
    }


def constant_tolerance(s, windows):
    """Windows a second of section 5 with a theta that is constant over the window, margins included."""
    model = paper(constant_tolerance=True)
    relations = jb.parity_relations(model, horizon=s)
    rng = np.random.default_rng(2)
    u, key = rng.uniform(-1, 1, (windows, 1)), jax.random.key(0)
    y = np.asarray(jb.simulate(paper(), u, key).y) * 1.0
    run = lambda: jb.detect(relations, u, y)
    first, median, *_ = timing.clock(lambda: run().status, 3)
    return {
        "windows": windows,
        "counts": run().counts,
        "first call s": round(first, 2),
        "windows/s": round(windows / median),
    }


def section_5(windows):
    """Draw windows that the joint test rejects and the box test accepts; return pave's arguments."""
    rng = np.random.default_rng(0)
    relations = jb.parity_relations(paper())
    u, y = rng.uniform(-1, 1, (400_000, 1)), rng.normal(0, 1, (400_000, 2))
    only = (jb.detect(relations, u, y).status == jb.Status.FAULT) & (
        jb.detect(relations, u, y, "box").status != jb.Status.FAULT
    )
    only[0] = False
    picked = np.flatnonzero(only)[:windows]
    Y = np.concatenate([y[picked - 1], y[picked]], 1)
    target = np.asarray(relations.external(u, y))[picked]
    each = lambda x: np.broadcast_to(x, (len(picked), *np.shape(x)))
    W = np.array([[float(x) for x in row] for row in relations.W])
    return target, (Y, each(np.tile([0.02, 0.1], 2)), each(np.tile([0.1, 0.01], 2)), each(W))


def main():
    count, windows = timing.option("--targets", 5000), timing.option("--windows", 1000)
    rng = np.random.default_rng(0)
    z = rng.uniform(*BOX, (count, 2))
    targets = np.stack([2 * z[:, 0] ** 2 + z[:, 1], z[:, 0] - z[:, 1]], 1)
    box = jb.interval(*map(np.array, BOX))
    out = {}
    found = jb.pave(figure_1, box, targets, q=10)
    first, median, *_ = timing.clock(lambda: jb.pave(figure_1, box, targets, q=10).evaluated, 5)
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
    search = lambda: jb.pave(figure_1, box, targets)
    found = search()
    _, median, *_ = timing.clock(lambda: search().evaluated, 3)
    out["search for solutions, Fig. 1"] = {
        "targets": count,
        "proved": float(np.mean(found.status == jb.Status.CONSISTENT)),
        "boxes a target": float(found.evaluated.mean()),
        "targets/s": round(count / median),
    }
    out["set inversion, one region"] = inversion(box, 1, 0.0005)
    out["set inversion, batch"] = inversion(box, 32, 0.002)
    for s in (1, 2, 4):
        out[f"constant tolerance, horizon {s}"] = constant_tolerance(s, 20_000)
    timing.save("paving", out)


if __name__ == "__main__":
    main()
