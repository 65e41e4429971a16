"""Is a point in a zonotope, is a constrained zonotope empty: jaxbound against HiGHS with a reused model, and
whoever else is installed.

python -m benchmarks.zonotopes [--largest 1000] [--sets 5000] [--seconds 3] [--processor]
(pip install zonoopt linrax mpax for the others; what is absent is reported as absent; pycvxset was on no
index at hand)

--processor measures seconds of the processor in place of the clock's: for a machine that others use as well.
All are kept to one thread of OpenBLAS, as HiGHS is to one of its own: a second one only helps, if at all,
where nothing else runs.

Generators are normal, twice as many as dimensions; points lie on rays drawn afresh, at a known factor of the
boundary, as many inside as
outside: "far" 5 to 50 % away from it, "near" within 1e-6 (1e-9 to 1e-6). The factor at the boundary is the
middle of jaxbound's two proved bounds, "known within" half their distance (checked against HiGHS in
tests/sets/zonotopes); no point is nearer than twice that. An answer is wrong if it is not that of the factor;
a peer that says nothing, or fails, is counted apart.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is first imported

import importlib
import importlib.metadata
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import timing
from jaxbound import sets
from jaxbound.sets.zonotopes import gauges, proof

POINTS, DIMENSIONS = 1000, tuple(n for n in (2, 5, 10, 20, 50, 100) if n >= timing.option("--smallest", 2))
LARGE = {500: 16, 1000: 4}
"""Points of one set in so many dimensions."""
SECONDS = timing.option("--seconds", 3)  # of a peer a row
PATIENCE = 20.0
"""Seconds after which HiGHS may give up on one point."""
now = time.process_time if "--processor" in sys.argv else time.perf_counter


class Program:
    """HiGHS, one model for all points of a set: is there |x| <= 1 with M x = d? Only the right-hand side is
    passed anew.
    """

    def __init__(self, M):
        import highspy

        m, q = M.shape
        self.highs, self.rows = highspy.Highs(), np.arange(m, dtype=np.int32)
        for option, value in dict(output_flag=False, presolve="off", solver="simplex", threads=1).items():
            self.highs.setOptionValue(option, value)
        model = highspy.HighsLp()
        model.num_col_, model.num_row_ = q, m
        model.col_cost_, model.col_lower_, model.col_upper_ = np.zeros(q), -np.ones(q), np.ones(q)
        model.row_lower_ = model.row_upper_ = np.zeros(m)
        model.a_matrix_.start_, model.a_matrix_.index_ = np.arange(q + 1) * m, np.tile(np.arange(m), q)
        model.a_matrix_.value_ = np.ascontiguousarray(M.T).ravel()
        self.highs.passModel(model)
        statuses = highspy.HighsModelStatus
        self.says = {statuses.kOptimal: 1, statuses.kInfeasible: -1}

    def __call__(self, d):
        """Return 1 if there is one, -1 if not, 0 if HiGHS does not say."""
        self.highs.changeRowsBounds(len(d), self.rows, d, d)
        self.highs.setOptionValue(
            "time_limit", self.highs.getRunTime() + PATIENCE
        )  # its clock counts all runs
        self.highs.run()
        return self.says.get(self.highs.getModelStatus(), 0)


def zonoopt(M):
    from scipy.sparse import csc_matrix

    Z = importlib.import_module("zonoopt").Zono(csc_matrix(M), np.zeros(len(M)))
    return lambda d: 1 if Z.contains_point(d) else -1


def linrax(M):
    solve, q = importlib.import_module("linrax").linprog, M.shape[1]
    run = jax.jit(
        lambda d: solve(jnp.zeros(q), jnp.eye(q), jnp.full(q, 2.0), jnp.asarray(M), d + M.sum(1))[1].success
    )
    return lambda d: 1 if run(d) else -1


def mpax(M):
    peer, q = importlib.import_module("mpax"), M.shape[1]
    solver = peer.raPDHG(eps_abs=1e-9, eps_rel=1e-9, iteration_limit=20_000)
    empty = jnp.zeros((0, q)), jnp.zeros(0)
    run = jax.jit(
        lambda d: (
            solver.optimize(
                peer.create_lp(jnp.zeros(q), jnp.asarray(M), d, *empty, -jnp.ones(q), jnp.ones(q), False)
            ).termination_status
        )
    )
    return lambda d: {2: 1, 3: -1}.get(int(run(d)), 0)  # 2 optimal, 3 infeasible


PEERS = {"zonoopt": zonoopt, "linrax": linrax, "mpax": mpax}


def versions():
    """Return {peer: its version, or that it is not installed}."""
    found = {}
    for name in ("highspy", *PEERS):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def drawn(rng, M, d, near):
    """Move d (S, N, m) to known factors of the boundary of M [-1, 1]^q; return (them, the factors, what these
    are known within).
    """
    image = proof.image(M)
    found = gauges.gauge_bounds(image, image.scaled(d), tight=True)
    middle = (found.upper + found.lower) / 2
    within = float(((found.upper - found.lower) / (2 * middle)).max())
    away = (
        np.maximum(10.0 ** rng.uniform(-8.9, -6, middle.shape), 2 * within)
        if near
        else rng.uniform(0.05, 0.5, middle.shape)
    )
    t = 1 + np.where(np.arange(middle.size).reshape(middle.shape) % 2, 1, -1) * away
    return d * (t / middle)[..., None], t, within


def clock(run, repeats):
    """Return (first call, median, fastest, slowest) seconds."""
    times = []
    for _ in range(repeats + 1):
        start = now()
        run()
        times.append(now() - start)
    return times[0], float(np.median(times[1:])), min(times[1:]), max(times[1:])


def judged(answers, t):
    expected = np.where(t > 1, -1, 1)
    return {
        "decided": round(float((answers != 0).mean()), 4),
        "wrong": int(((answers != 0) & (answers != expected)).sum()),
    }


def peer_row(make, M, d, t, ours):
    """Time a peer on as many of the points as fit the time, one set for all of d (N, n)."""
    try:
        ask = make(M)
        if len(M) <= 100:
            ask(d[0])
        answers, start = [], now()
        for point in d:
            answers.append(ask(point))
            if now() - start > SECONDS:
                break
        seconds = (now() - start) / len(answers)
    except Exception as e:  # a peer that is absent or fails is reported as such
        return f"{type(e).__name__}: {e}"[:100]
    return {**beside(seconds, ours), "of": len(answers), **judged(np.array(answers), t[: len(answers)])}


def beside(seconds, ours):
    return {"us a test": round(seconds * 1e6, 1), "ratio": round(seconds / ours, 1)}


def containment(n, many_sets, near, rng):
    S, N = (100, POINTS // 100) if many_sets else (1, LARGE.get(n, POINTS))
    G = rng.normal(size=(S, n, 2 * n))
    d, t, within = drawn(rng, G, rng.normal(size=(S, N, n)), near)
    Z = sets.zonotope(np.zeros((S, n)), G)
    answers = sets.contains(Z, d).answer
    first, median, fastest, slowest = clock(lambda: sets.contains(Z, d), 5 if n < 50 else 2)
    ours = median / (S * N)
    row = {
        "us a test": round(ours * 1e6, 2),
        "spread": [round(x / (S * N) * 1e6, 2) for x in (fastest, slowest)],
        "known within": float(f"{within:.2g}"),
        **judged(answers, t),
    }
    if many_sets:
        few = max(1, min(S, 5))
        start = now()
        answers = np.array(
            [
                [program(v) for v in points]
                for program, points in ((Program(g), points) for g, points in zip(G[:few], d, strict=False))
            ]
        )
        return row | {
            "HiGHS": {
                **beside((now() - start) / answers.size, ours),
                "of": answers.size,
                **judged(answers, t[:few]),
            }
        }
    row["HiGHS"] = peer_row(Program, G[0], d[0], t[0], ours)
    return row | (
        {name: peer_row(make, G[0], d[0, :50], t[0, :50], ours) for name, make in PEERS.items()}
        if n <= 100
        else {}
    )


def emptiness(n, q, k, count, rng):
    """Constrained zonotopes within 1e-6 of being just empty."""
    A, b = rng.normal(size=(count, k, q)), rng.normal(size=(count, k))
    b, t, within = (x[:, 0] if np.ndim(x) else x for x in drawn(rng, A, b[:, None], True))
    C = sets.constrained_zonotope(np.zeros((count, n)), rng.normal(size=(count, n, q)), A, b)
    answers = sets.is_empty(C).answer
    _, median, *_ = clock(lambda: sets.is_empty(C), 1)
    few = 200
    start = now()
    theirs = np.array([Program(np.asarray(C.constraints[i]))(np.asarray(C.offsets[i])) for i in range(few)])
    seconds = (now() - start) / few
    row = {
        "us a test": round(median / count * 1e6, 1),
        "known within": float(f"{within:.2g}"),
        **judged(-answers, t),
    }
    return row | {"HiGHS": {**beside(seconds, median / count), "of": few, **judged(theirs, t[:few])}}


if __name__ == "__main__":
    largest, rng, table = timing.option("--largest", 1000), np.random.default_rng(0), {}
    begin = now()
    for n in [n for n in (*DIMENSIONS, *LARGE) if n <= largest]:
        for many_sets in (False, True)[: 2 if n <= 100 else 1]:
            for near in (False, True):
                name = (
                    f"{n} dimensions, {'100 sets x 10 points' if many_sets else 'one set'}, "
                    f"{'within 1e-6' if near else 'far'}"
                )
                table[name] = containment(n, many_sets, near, rng)
                print(f"{now() - begin:.0f} s:", name, table[name], flush=True)
    for shape in ((2, 6, 1), (5, 15, 5), (20, 60, 20)):
        name = "emptiness, {} states, {} generators, {} constraints".format(*shape)
        table[name] = emptiness(*shape, timing.option("--sets", 5000), rng)
        print(f"{now() - begin:.0f} s:", name, table[name], flush=True)
    timing.save(
        "zonotopes",
        {
            "peers": versions(),
            "seconds": "of the processor" if now is time.process_time else "of the clock",
            **table,
        },
    )
