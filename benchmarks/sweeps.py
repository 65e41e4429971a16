"""The same work by everybody, against its size: windows against the horizon, zonotopes against residuals,
functions against boxes.

A sweep returns {"title", "x", "sizes", "unit", "series": {who: {"rates", "first call s", "proved"}},
"failed": {who: why}}; a rate is None where a peer does not reach. What is proved is rounded outward or
checked; who does not, does less work.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbound as jb
from benchmarks import opponents, paving, strips, timing, varying
from benchmarks.peers import load

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles import MODELS, Plant, Windows  # noqa: E402
from systems import paper  # noqa: E402

__all__ = ["SWEEPS"]


class Series:
    """Rates of several parties over the sizes of a sweep."""

    def __init__(self, title, x, unit, sizes):
        jax.clear_caches()  # first calls compile, whatever ran before
        self.out = {"title": title, "x": x, "unit": unit, "sizes": list(sizes), "series": {}, "failed": {}}

    def time(self, who, size, count, run, proved, repeats=3):
        """Time a call that does `count` pieces of work; the first call is told apart: it compiles."""
        try:
            first, median, *_ = timing.clock(run, repeats)
        except (
            Exception
        ) as e:  # a peer that does not get along with this version of something is told, and left out
            if who.startswith("jaxbound"):
                raise
            self.out["failed"][who] = f"{type(e).__name__}: {e}".split("\n")[0]
            print(f"{self.out['title']}, {size}: {who} failed, {self.out['failed'][who]}", flush=True)
            return
        at = self.out["sizes"].index(size)
        mine = self.out["series"].setdefault(who, {"proved": proved, "rates": [], "first call s": []})
        for field, value in (("rates", float(f"{count / median:.4g}")), ("first call s", round(first, 3))):
            mine[field] += [None] * (at - len(mine[field])) + [value]
        print(
            f"{self.out['title']}, {size}: {who} {count / median:.4g} {self.out['unit']}, first call "
            f"{first:.2f} s",
            flush=True,
        )


def horizon(quick, gpu):
    """Windows a second of section 5 of Adrot 2000 against the samples of a window."""
    sizes = (1, 8) if quick else (1, 2, 3, 4, 6, 8, 12, 16, 20)
    found = Series("section 5 of Adrot 2000", "horizon", "windows/s", sizes)
    rng = np.random.default_rng(0)
    for s in sizes:
        count = (200_000 if s < 4 else 20_000) // (4 if quick else 1)
        u, y = rng.uniform(-1, 1, (count, 1)), rng.normal(size=(count, 2))
        relations = jb.parity_relations(paper(), horizon=s)
        found.time("jaxbound margins", s, count, lambda r=relations, u=u, y=y: jb.margins(r, u, y), False)
        if gpu:
            continue
        found.time("jaxbound detect", s, count, lambda r=relations, u=u, y=y: jb.detect(r, u, y).status, True)
        oracle = Windows(Plant(**MODELS["paper"]), s)
        few = 200 if quick else 2000
        cut = lambda x, few=few, s=s: np.moveaxis(
            np.lib.stride_tricks.sliding_window_view(x[: few + s], s + 1, 0), -1, 1
        )
        if relations.circuits:
            circuits = np.array([[float(v) for v in row] for row in relations.circuits])
            lower, upper = oracle.limits(cut(u, 20 * few), cut(y, 20 * few))
            size = abs(circuits).T
            gauge = lambda lo=lower, hi=upper, h=circuits.T, a=size: (
                abs((lo + hi) / 2 @ h) / ((hi - lo) / 2 @ a)
            ).max(1)
            found.time("NumPy, whole arrays", s, len(lower), gauge, False)
        lower, upper = oracle.limits(cut(u), cut(y))
        if load("HiGHS"):
            program = opponents.Feasibility(oracle.O)
            found.time(
                "HiGHS, reused model",
                s,
                len(lower),
                lambda p=program, lo=lower, hi=upper: p.run(lo, hi),
                False,
                1,
            )
    return found.out


def residuals(quick, gpu):
    """Zonotopes a second: is 0 inside, when the directions differ from one to the next, against the number of
    residuals.
    """
    sizes = (1, 2) if quick else (1, 2, 3, 4, 5)
    found = Series("0 in a zonotope, 4 generators a residual", "residuals", "zonotopes/s", sizes)
    if gpu:
        return found.out
    zonoopt, block = load("zonoopt"), 2**11
    for r in sizes:
        q, rng = 4 * r, np.random.default_rng(r)
        blocks = 1 if quick or r > 3 else 16
        G, c = rng.normal(size=(blocks, r, q, block)), rng.normal(size=(blocks, r, block)) * q**0.5
        device = [(jnp.asarray(a), jnp.asarray(b), jnp.zeros_like(a)) for a, b in zip(c, G, strict=True)]
        found.time("jaxbound membership", r, blocks * block, lambda x=device: varying.ours(x), True)
        few = {1: 2000, 2: 2000, 3: 1000, 4: 200, 5: 40}[r]
        flat_c, flat_G = (
            np.ascontiguousarray(c[0].T)[:few],
            np.ascontiguousarray(np.moveaxis(G[0], -1, 0))[:few],
        )
        found.time("NumPy, whole arrays", r, few, lambda c=flat_c, G=flat_G: varying.numpy_gauge(c, G), False)
        some = min(few, 100 if quick else 1000)
        if load("HiGHS"):
            program = varying.Program(r, q)
            found.time(
                "HiGHS, new matrix",
                r,
                some,
                lambda p=program, c=flat_c[:some], G=flat_G[:some]: p.run(c, G),
                False,
                1,
            )
        if zonoopt:
            from scipy.sparse import csc_matrix

            sets, zero = (
                [zonoopt.Zono(csc_matrix(g), v) for g, v in zip(flat_G[:some], flat_c, strict=False)],
                np.zeros(r),
            )
            found.time(
                "zonoopt contains_point",
                r,
                some,
                lambda z=sets, o=zero: [x.contains_point(o) for x in z],
                False,
                1,
            )
    return found.out


def boxes(quick, gpu):
    """Boxes a second through an inclusion function, 2 x^2 + y and x - y (Adrot 2000, Fig. 1), against how
    many there are.
    """
    sizes = (100, 10_000) if quick else (100, 1000, 10_000, 100_000, 1_000_000)
    found = Series("range of 2 x^2 + y, x - y", "boxes", "boxes/s", sizes)
    if gpu:
        return found.out
    immrax, intvalpy, codac, flint = (load(name) for name in ("immrax", "intvalpy", "codac", "python-flint"))
    f = lambda z: jnp.array(paving.figure_1(z))
    natural = jax.jit(jax.vmap(jb.inclusion(f)))
    sharp = jax.jit(jax.vmap(jb.inclusion(f, "best")))
    unrounded = jax.jit(jax.vmap(immrax.natif(f))) if immrax else None
    for n in sizes:
        lo = np.random.default_rng(0).uniform([-1, 1], [1, 2], (n, 2))
        hi = lo + 0.1
        box = jb.interval(lo, hi)
        found.time("jaxbound inclusion", n, n, lambda b=box: natural(b), True)
        if n <= 100_000:
            found.time("jaxbound inclusion, best", n, n, lambda b=box: sharp(b), True)
        if immrax:
            theirs = immrax.interval(lo, hi)
            found.time("immrax natif", n, n, lambda b=theirs: unrounded(b), False)
        if intvalpy:
            x, y = (intvalpy.Interval(lo[:, k].copy(), hi[:, k].copy()) for k in (0, 1))
            if n <= 10_000:
                found.time("intvalpy", n, n, lambda x=x, y=y: (2 * x**2 + y, x - y), False, 1)
        if n > 10_000:
            continue
        if codac:
            v = codac.VectorVar(2)
            g = codac.AnalyticFunction([v], [2 * codac.sqr(v[0]) + v[1], v[0] - v[1]])
            sets = [
                codac.IntervalVector([[a, b] for a, b in zip(*ends, strict=True)])
                for ends in zip(lo, hi, strict=True)
            ]
            found.time("codac", n, n, lambda g=g, s=sets: [g.eval(x) for x in s], True, 1)
        if flint:
            balls = [
                [flint.arb((a + b) / 2, (b - a) / 2) for a, b in zip(*ends, strict=True)]
                for ends in zip(lo, hi, strict=True)
            ]
            found.time("python-flint", n, n, lambda s=balls: [(2 * x**2 + y, x - y) for x, y in s], True, 1)
    return found.out


def limits(quick, gpu):
    """What the machine allows: one pass over the same bytes, and the share of it that section 5 reaches;
    arithmetic likewise.
    """
    count = 500_000 if quick else 10_000_000
    out = {"title": "share of the memory limit", "windows": count}
    rng = np.random.default_rng(0)
    for dtype in (np.float64, np.float32):
        u, y = (jnp.asarray(rng.normal(size=(count, c)).astype(dtype)) for c in (1, 2))
        relations = jb.parity_relations(paper())
        runs = {
            "one pass": lambda u=u, y=y: strips.elementwise(u, y),
            "margins": lambda r=relations, u=u, y=y: jb.margins(r, u, y),
        }
        if not gpu:
            runs["detect"] = lambda r=relations, u=u, y=y: jb.detect(r, u, y).status
            blocked, host = opponents.Blocked(dtype), (np.asarray(u), np.asarray(y))
            runs["NumPy, blocked"] = lambda b=blocked, h=host: b.run(*h)
        times = {who: timing.clock(run, 5) for who, run in runs.items()}
        table = {
            who: {"windows/s": float(f"{count / t[1]:.4g}"), "first call s": round(t[0], 3)}
            for who, t in times.items()
        }
        for who, t in times.items():
            table[who]["share of the memory limit"] = round(times["one pass"][1] / t[1], 3)
        if not gpu:
            table["margins"]["share of the arithmetic limit"] = round(
                _flops(relations, u, y) / times["margins"][1] / varying.peak() / 1e9, 3
            )
        out[np.dtype(dtype).name] = table
        print(np.dtype(dtype).name, table, flush=True)
    return out


def _flops(relations, u, y):
    """Return the operations of the compiled kernel, as its compiler counts them, for as many windows as u has
    samples.
    """
    few = 2**14
    counted = (
        jax.jit(lambda u, y: jb.margins(relations, u, y)).lower(u[:few], y[:few]).compile().cost_analysis()
    )
    return float(counted["flops"]) * len(u) / few


SWEEPS = {"limits": limits, "horizon": horizon, "residuals": residuals, "boxes": boxes}
