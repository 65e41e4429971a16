"""Is 0 in a zonotope that differs from window to window: jaxbound against NumPy written for whole arrays and
HiGHS, in one run; and the example of Ploix 2006 against set inversion by codac (pip install codac; left out
where it is missing).

python -m benchmarks.varying [--windows 65536] [--processor]

--processor measures seconds of the processor in place of the clock's: for a machine that others use as well.
All strips of one or two rows are tested; for more rows a search proposes the direction that refutes.
"""

import itertools
import math
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.sets.strips import varying

now = time.process_time if "--processor" in sys.argv else time.perf_counter
SHAPES = ((1, 5), (2, 4), (2, 10), (3, 12), (4, 16), (5, 20))
BLOCK = 2**11


def numpy_gauge(c, G):
    """Return the gauge of c (N, r), G (N, r, q): normals of all subsets of r - 1 generators by minors, then
    two products, whole arrays.
    """
    N, r, q = G.shape
    if r == 1:
        return abs(c[:, 0]) / abs(G[:, 0]).sum(1)
    subsets = np.array(list(itertools.combinations(range(q), r - 1)))
    chosen = G[:, :, subsets]  # (N, r, strips, r - 1)
    rows = [chosen[:, i] for i in range(r)]
    if r == 2:
        H = np.stack([-rows[1][..., 0], rows[0][..., 0]], -1)
    elif r == 3:
        H = np.cross(chosen[..., 0].transpose(0, 2, 1), chosen[..., 1].transpose(0, 2, 1))
    else:
        keep = [[j for j in range(r) if j != i] for i in range(r)]
        H = np.stack(
            [(-1) ** i * np.linalg.det(np.stack([rows[j] for j in keep[i]], -2)) for i in range(r)], -1
        )
    return (abs(H @ c[:, :, None])[..., 0] / abs(H @ G).sum(-1)).max(1)


class Program:
    """HiGHS, one model for all windows: is there |z| <= 1 with G z = -c? Only the coefficients are passed
    anew.
    """

    def __init__(self, r, q):
        import highspy

        self.solver, self.status = highspy.Highs(), highspy.HighsModelStatus
        for option, value in dict(output_flag=False, presolve="off", solver="simplex", threads=1).items():
            self.solver.setOptionValue(option, value)
        self.model = highspy.HighsLp()
        self.model.num_col_, self.model.num_row_ = q, r
        self.model.col_cost_, self.model.col_lower_, self.model.col_upper_ = (
            np.zeros(q),
            -np.ones(q),
            np.ones(q),
        )
        self.model.a_matrix_.start_ = np.arange(q + 1) * r
        self.model.a_matrix_.index_ = np.tile(np.arange(r), q)

    def run(self, c, G):
        """Return True where a window is infeasible, (N,), for c (N, r), G (N, r, q)."""
        out, columns = np.empty(len(c), bool), np.ascontiguousarray(G.transpose(0, 2, 1)).reshape(len(c), -1)
        for k in range(len(c)):
            self.model.row_lower_ = self.model.row_upper_ = -c[k]
            self.model.a_matrix_.value_ = columns[k]
            self.solver.passModel(self.model)
            self.solver.run()
            out[k] = self.solver.getModelStatus() == self.status.kInfeasible
        return out


searched, refutes, strip = map(jax.jit, (varying.farthest, varying.refutes, varying.strip))


def ours(blocks):
    """Return the proved margins of blocks (c (r, N), G (r, q, N), error (r, N)): < 0 is a proof."""
    if varying.few_strips(*blocks[0][1].shape[:2]):
        return [refutes(*block, strip(*block)) for block in blocks]
    return [refutes(*block, searched(*block)[0]) for block in blocks]


def timed(run, repeats):
    """Return (first call, median, fastest, slowest) seconds."""
    seconds = []
    for _ in range(repeats + 1):
        start = now()
        jax.block_until_ready(run())
        seconds.append(now() - start)
    return seconds[0], float(np.median(seconds[1:])), min(seconds[1:]), max(seconds[1:])


def figures(windows):
    out = {}
    for r, q in SHAPES:
        rng = np.random.default_rng(r)
        count = max(BLOCK, windows if r < 4 else windows // 2) // BLOCK * BLOCK
        G = rng.normal(size=(count // BLOCK, r, q, BLOCK))
        c = rng.normal(size=(count // BLOCK, r, BLOCK)) * q**0.5
        few = {1: 65536, 2: 20000, 3: 5000, 4: 400, 5: 40}[r]
        flat_c, flat_G = (np.moveaxis(x, -1, 1).reshape(count, *x.shape[1:-1])[:few] for x in (c, G))
        on_device = [(jnp.asarray(a), jnp.asarray(b), jnp.zeros_like(a)) for a, b in zip(c, G, strict=True)]
        host = np.concatenate(c, -1), np.concatenate(G, -1)
        run = lambda x=on_device: ours(x)
        first, median, fastest, slowest = timed(run, 7)
        _, whole, *_ = timed(lambda x=(flat_c, flat_G): numpy_gauge(*x), 3)
        program, some = Program(r, q), min(len(host[0].T), 2000)
        infeasible = program.run(host[0].T[:1], np.moveaxis(host[1], -1, 0)[:1])  # its first run loads it
        start = now()
        infeasible = program.run(host[0].T[:some], np.moveaxis(host[1], -1, 0)[:some])
        lp = (now() - start) / some
        margin = np.concatenate([np.asarray(x) for x in run()])[:some]
        mine, theirs = median / count, whole / len(flat_c)
        out[f"({r}, {q})"] = {
            "strips": math.comb(q, r - 1),
            "us a window": round(mine * 1e6, 4),
            "spread": [round(t / count * 1e6, 4) for t in (fastest, slowest)],
            "numpy us": round(theirs * 1e6, 3),
            "HiGHS us": round(lp * 1e6, 1),
            "ratio numpy": round(theirs / mine, 1),
            "ratio HiGHS": round(lp / mine, 1),
            "first call s": round(first, 1),
            "share outside": round(float((margin < 0).mean()), 3),
            "differs from HiGHS": int(((margin < 0) != infeasible).sum()),
        }
        print(f"({r}, {q})", out[f"({r}, {q})"], flush=True)
    return out


@timing.own_rounding()
def set_inversion(u, y, eps=0.25):
    """Return which windows of u (T, 1), y (T, 1) no parameters explain, by codac's SIVIA of the relation, and
    seconds a window.
    """
    import codac

    v = codac.VectorVar(3)
    box = codac.IntervalVector([[-1, 1]] * 3)
    out, start = [], time.perf_counter()
    for k in range(2, len(y)):
        a, b, c, d = (float(x) for x in (y[k - 2, 0], y[k - 1, 0], y[k, 0], u[k - 2, 0]))
        f = codac.AnalyticFunction(
            [v], (0.16 + 0.02 * v[0]) * a - (1 + 0.1 * v[1]) * b + c - (1 + 0.1 * v[2]) * d
        )
        paving = codac.sivia(box, f, codac.Interval(-1e-12, 1e-12), eps)
        left = [b for b in paving.boxes(codac.PavingInOut.outer) if not b.is_empty()]
        out.append(not left)
    return np.array(out), (time.perf_counter() - start) / len(out)


def example(samples=2**20):
    """Time the example of Ploix 2006: all windows of a long recording, and set inversion for a recording of
    100 samples as in the paper.
    """
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from uncertain_systems import model

    m = model("n2p1_paper_h3")
    r, rng = jb.parity_relations(m), np.random.default_rng(0)
    u = np.repeat(rng.uniform(0, 2, (samples // 16, 1)), 16, 0)
    y = np.array(jb.simulate(m, u, jax.random.key(0)).y)
    few, faulty = slice(0, 100), np.r_[10:40, 60:90]
    y[faulty] *= 0.5  # C1 halved
    out = {}
    _, median, *_ = timing.clock(lambda: jb.detect(r, u, y).status, 3)
    out["us a window"] = round(median / (samples - 2) * 1e6, 4)
    fault = jb.detect(r, u[few], y[few]).status[2:] == jb.Status.FAULT
    try:
        found, seconds = set_inversion(u[few], y[few])
    except ImportError:
        return out
    out |= {
        "codac us a window": round(seconds * 1e6, 1),
        "windows that differ": int((found != fault).sum()),
        "faults": int(fault.sum()),
    }
    return out | {"ratio": round(seconds * 1e6 / out["us a window"])}


if __name__ == "__main__":
    count = timing.option("--windows", 65536)
    timing.save(
        "varying",
        {
            "windows": count,
            "seconds": "of the processor" if now is time.process_time else "of the clock",
            "example of Ploix 2006": example(),
            "shapes": figures(count),
        },
    )
