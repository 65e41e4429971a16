"""Measure solve_interval on 9 x 9 systems against python-flint's ball solver, codac's and intvalpy's
eliminations, in one run.

    python -m benchmarks.linear_systems [--systems 20000] [--repeats 7] [--few 300]

Codac eliminates without preconditioning, which is our precondition="none"; flint, and codac behind its
preconditioner, compare with "midpoint". Beside each ratio of times stands the ratio of widths, theirs over
ours. CPU time of the process holds on a machine that others use. Rounds of all solvers take turns, and the
fastest round counts, so that all meet the same neighbours.
"""

import time

import numpy as np

from benchmarks import timing
from benchmarks.timing import option, save

METHODS = (("gauss", "none"), ("gauss", "midpoint"), ("hbr", "midpoint"), ("intersection", "midpoint"))
OPPONENT_OF = {"none": ("codac", "intvalpy"), "midpoint": ("python-flint", "codac preconditioned")}
TABLE = ("gauss", "krawczyk", "gauss_seidel", "hbr", "intersection")


def systems(count, n=9, width=0.01, seed=0):
    """Return (lo, hi) of matrices near the identity and of right-hand sides."""
    rng = np.random.default_rng(seed)
    A = np.eye(n) + 0.1 * rng.normal(size=(count, n, n))
    b = rng.normal(size=(count, n))
    return (A - width, A + width), (b - width, b + width)


def ours(M, h, method, precondition):
    """Return a solver of all systems at once."""
    import jax

    import jaxbound as jb

    M, h = jb.interval(*M), jb.interval(*h)

    def run():
        found = jax.block_until_ready(jb.solve_interval(M, h, method, precondition=precondition))
        return lambda: np.asarray(found.x.wid)

    return run


def flint(M, h):
    """Return a solver by python-flint's arb_mat.solve, balls built beforehand."""
    from flint import arb, arb_mat

    ball = lambda lo, hi: arb((lo + hi) / 2, (hi - lo) / 2 * (1 + 1e-15))
    pack = lambda lo, hi: arb_mat(
        [[ball(float(a), float(b)) for a, b in zip(r, s, strict=True)] for r, s in zip(lo, hi, strict=True)]
    )
    built = [(pack(M[0][k], M[1][k]), pack(h[0][k][:, None], h[1][k][:, None])) for k in range(len(M[0]))]

    def one(A, b):
        try:
            return A.solve(b)
        except ZeroDivisionError:  # not proved regular: the work was done all the same
            return None

    def run():
        solved = [one(A, b) for A, b in built]
        return lambda: np.array(
            [
                np.full(len(M[0][0]), np.inf) if x is None else [2 * float(e.rad()) for e in x.entries()]
                for x in solved
            ]
        )

    return run


@timing.own_rounding()
def codac(M, h, preconditioned):
    """Return a solver by codac's Gauss elimination contractor, from a box that says nothing."""
    from codac import CtcGaussElim, CtcLinearPrecond, Interval, IntervalMatrix, IntervalVector

    contractor, n = CtcGaussElim(), len(h[0][0])
    contractor = CtcLinearPrecond(contractor) if preconditioned else contractor
    vector = lambda lo, hi: [Interval(float(a), float(b)) for a, b in zip(lo, hi, strict=True)]
    built = []
    for k in range(len(M[0])):
        A = IntervalMatrix([vector(lo, hi) for lo, hi in zip(M[0][k], M[1][k], strict=True)])
        built.append((A, IntervalVector(vector(h[0][k], h[1][k]))))

    def run():
        solved = []
        for A, b in built:
            x = IntervalVector(n)
            contractor.contract(A, x, b)
            solved.append(x)
        return lambda: np.array([[x[i].diam() for i in range(n)] for x in solved])

    return run


def intvalpy(M, h):
    """Return a solver by intvalpy's Gauss elimination."""
    import intvalpy as ip

    built = [(ip.Interval(M[0][k], M[1][k]), ip.Interval(h[0][k], h[1][k])) for k in range(len(M[0]))]

    def run():
        solved = [ip.linear.Gauss(A, b) for A, b in built]
        return lambda: np.array([np.asarray(x.b, float) - np.asarray(x.a, float) for x in solved])

    return run


def fastest(solvers, repeats):
    """Return {name: (wall, cpu, widths)}, seconds of the fastest round, in turns."""
    best = {}
    for _ in range(repeats):
        for name, run in solvers.items():
            wall, cpu = time.perf_counter(), time.process_time()
            with timing.own_rounding():
                found = run()
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            old = best.get(name, (np.inf, np.inf))
            best[name] = (min(wall, old[0]), min(cpu, old[1]), found)
    with timing.own_rounding():
        return {name: (wall, cpu, found()) for name, (wall, cpu, found) in best.items()}


def excess(n=4, count=256, widths=(0.001, 0.01, 0.05, 0.2)):
    """Return the median of width / width of the exact hull - 1 per method and relative width of the
    coefficients.
    """
    import jaxbound as jb

    rng, table = np.random.default_rng(1), {}
    A, b = 3 * np.eye(n) + 0.5 * rng.normal(size=(count, n, n)), rng.normal(size=(count, n))
    for width in widths:
        R, r = width * np.abs(A), width * np.abs(b)
        M, h = jb.interval(A - R, A + R), jb.interval(b - r, b + r)
        hull = jb.solve_interval(M, h, "hull")
        row = {method: jb.solve_interval(M, h, method) for method in TABLE} | {
            "gauss, not preconditioned": jb.solve_interval(M, h, "gauss", precondition="none")
        }
        proved = np.all([np.asarray(x.status) == 1 for x in (hull, *row.values())], 0)
        table[f"{100 * width:g} %"] = {"of systems": round(float(proved.mean()), 2)} | {
            name: float(f"{np.median(np.asarray(x.x.wid)[proved] / np.asarray(hull.x.wid)[proved]) - 1:.2g}")
            for name, x in row.items()
        }
    return table


def main():
    """Print and save the figures."""
    count, repeats, few = option("--systems", 20000), option("--repeats", 7), option("--few", 300)
    M, h = systems(count)
    part = [tuple(end[:few] for end in X) for X in (M, h)]
    solvers, absent, first = {}, [], {}
    for name, build in {
        "python-flint": lambda: flint(*part),
        "codac": lambda: codac(*part, False),
        "codac preconditioned": lambda: codac(*part, True),
        "intvalpy": lambda: intvalpy(*part),
    }.items():
        try:
            solvers[name] = build()
        except ImportError:
            absent.append(name)
    for pair in METHODS:
        start = time.perf_counter()
        solvers[pair] = ours(M, h, *pair)
        solvers[pair]()
        first[pair] = time.perf_counter() - start
    best, figures = fastest(solvers, repeats), {}
    each = lambda name: np.array(best[name][:2]) / (count if name in METHODS else few)
    for method, precondition in METHODS:
        pair, ratios = (method, precondition), {}
        for name in OPPONENT_OF[precondition]:
            if name in best:
                wall, cpu = (each(name) / each(pair)).tolist()
                theirs, mine = best[name][2], best[pair][2][:few]
                both = np.isfinite(theirs) & np.isfinite(mine)
                ratios[name] = {
                    "wall": round(wall, 2),
                    "cpu": round(cpu, 2),
                    "width": round(float(np.median(theirs[both] / mine[both])), 4),
                }
        wall, cpu = each(pair)
        figures[f"{method}, {precondition}"] = {
            "times faster than": ratios,
            "systems_per_s": round(1 / wall),
            "systems_per_cpu_s": round(1 / cpu),
            "first_call_s": round(first[pair], 2),
        }
    figures["peers_us_a_system"] = {
        name: [round(1e6 * t, 1) for t in each(name).tolist()] for name in best if name not in METHODS
    }
    save(
        "linear_systems",
        {
            "systems": count,
            "size": "9 x 9",
            "not installed": absent,
            **figures,
            "excess width, 4 x 4, median": excess(),
        },
    )


if __name__ == "__main__":
    main()
