"""Measure solve_interval on 9 x 9 systems against python-flint's ball solver and codac's Gauss elimination, in one run.

    python -m benchmarks.linear_systems [--systems 20000] [--repeats 5]

Wall time and CPU time of the process are both given: the second holds on a machine that others use.
"""

import time

import numpy as np

from benchmarks.timing import option, save


def systems(count, n=9, width=0.01, seed=0):
    """Return (lo, hi) of matrices near the identity and of right-hand sides."""
    rng = np.random.default_rng(seed)
    A = np.eye(n) + 0.1 * rng.normal(size=(count, n, n))
    b = rng.normal(size=(count, n))
    return (A - width, A + width), (b - width, b + width)


def ours(M, h, method, repeats):
    """Return (compile, wall, cpu) seconds, the last two a system, medians over the repeats."""
    import jax

    import jaxbound as jb

    M, h = jb.interval(*M), jb.interval(*h)
    run = lambda: jax.block_until_ready(jb.solve_interval(M, h, method))
    start = time.perf_counter()
    run()
    first, rows = time.perf_counter() - start, []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        rows.append((time.perf_counter() - wall, time.process_time() - cpu))
    return first, *(np.median(rows, 0) / len(M))


def _clocked(solve, count):
    wall, cpu = time.perf_counter(), time.process_time()
    for k in range(count):
        solve(k)
    return (time.perf_counter() - wall) / count, (time.process_time() - cpu) / count


def flint(M, h, count):
    """Return (wall, cpu) seconds a system of python-flint's arb_mat.solve, balls built beforehand; None where it is not installed."""
    try:
        from flint import arb, arb_mat
    except ImportError:
        return None
    ball = lambda lo, hi: arb((lo + hi) / 2, (hi - lo) / 2 * (1 + 1e-15))
    pack = lambda lo, hi: arb_mat([[ball(float(a), float(b)) for a, b in zip(r, s, strict=True)] for r, s in zip(lo, hi, strict=True)])
    built = [(pack(M[0][k], M[1][k]), pack(h[0][k][:, None], h[1][k][:, None])) for k in range(count)]

    def solve(k):
        try:
            built[k][0].solve(built[k][1])
        except ZeroDivisionError:  # not proved regular: the work was done all the same
            pass

    return _clocked(solve, count)


def codac(M, h, count):
    """Return (wall, cpu) seconds a system of codac's Gauss elimination contractor; None where it is not installed."""
    try:
        from codac import CtcGaussElim, Interval, IntervalMatrix, IntervalVector
    except ImportError:
        return None
    contractor, n = CtcGaussElim(), len(h[0][0])
    built = []
    for k in range(count):
        A = IntervalMatrix(
            [[Interval(float(a), float(b)) for a, b in zip(r, s, strict=True)] for r, s in zip(M[0][k], M[1][k], strict=True)]
        )
        b = IntervalVector([Interval(float(a), float(c)) for a, c in zip(h[0][k], h[1][k], strict=True)])
        built.append((A, IntervalVector(n), b))
    return _clocked(lambda k: contractor.contract(*built[k]), count)


def main():
    """Print and save the figures."""
    count, repeats = option("--systems", 20000), option("--repeats", 5)
    M, h = systems(count)
    peers = {"python-flint": flint(M, h, min(count, 500)), "codac": codac(M, h, min(count, 500))}
    figures = {}
    for method in ("gauss", "hbr", "intersection"):
        first, wall, cpu = ours(M, h, method, repeats)
        ratios = {name: {"wall": round(p[0] / wall, 2), "cpu": round(p[1] / cpu, 2)} for name, p in peers.items() if p}
        figures[method] = {"times faster than": ratios, "systems_per_s": round(1 / wall), "systems_per_cpu_s": round(1 / cpu),
                           "first_call_s": round(first, 2)}  # fmt: skip
    figures["peers_us_a_system"] = {name: [round(1e6 * t, 1) for t in p] if p else "not installed" for name, p in peers.items()}
    save("linear_systems", {"systems": count, "size": "9 x 9", **figures})


if __name__ == "__main__":
    main()
