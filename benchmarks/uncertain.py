"""Uncertain parity relations: exact null spaces beside python-flint's, and how the time to build relations
grows.

Run: python -m benchmarks.uncertain [--largest 2000] [--repeats 3] [--windows 32768]
--largest: unknowns of the largest system that python-flint, whose elimination is dense, is given (the
largest, of 1980, takes ten seconds). --windows: how many windows `detect` is timed on; 0 leaves that out
(compiling it for many relations takes minutes).
"""

import sys
import time
from functools import partial
from pathlib import Path

import flint
import jax
import numpy as np

import jaxbound as jb
from benchmarks.timing import option, save
from jaxbound.exact.sparse import null_space
from jaxbound.relations.annihilator import constraints
from jaxbound.relations.polynomial import PolynomialMatrix, monomials
from jaxbound.relations.uncertain_window import uncertain_window

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from uncertain_systems import SYSTEMS, entry, model  # noqa: E402


def best(run, repeats):
    """Return the fastest of some runs, in seconds, and the last result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        out = run()
        times.append(time.perf_counter() - start)
    return min(times), out


def _solved(E, order, unknowns):
    """Return the equations of an order of the search and a basis of their solutions."""
    equations = constraints(E, order)[0]
    return equations, null_space(equations, unknowns)


def kernels(name, repeats, largest):
    """Return a row for each order of the search: sizes, and seconds for the same null space."""
    m, _, h = model(name), *SYSTEMS[name][1:]
    _, E, _, _ = uncertain_window(m, h - 1)
    used = [i for i in range(E.variables) if any(a[i] for a in E.terms)]
    E = PolynomialMatrix(
        E.rows, E.columns, len(used), {tuple(a[i] for i in used): x for a, x in E.terms.items()}
    )
    rows = []
    for step in jb.parity_relations(m, horizon=h - 1).steps:
        unknowns = E.rows * len(monomials(E.variables, step.order))
        ours, (equations, solutions) = best(partial(_solved, E, step.order, unknowns), repeats)
        row = {
            "order": step.order,
            "unknowns": unknowns,
            "equations": step.equations,
            "kernel": len(solutions),
            "seconds": ours,
        }
        if unknowns <= largest:
            dense = flint.fmpz_mat(len(equations), unknowns)
            for i, equation in enumerate(equations):
                for k, x in equation.items():
                    dense[i, k] = x
            theirs, (_, nullity) = best(dense.nullspace, 1 if unknowns > 500 else repeats)
            assert nullity == len(solutions)
            row |= {"python_flint_seconds": theirs, "times_faster": theirs / ours}
        rows.append(row)
    return rows


def six_states(outputs, varying):
    """Return a chain of six states with four parameters."""
    A = np.diag([0.8, 0.7, 0.6, 0.5, 0.75, 0.65]) + np.diag([0.2] * 5, 1) + np.diag([0.1] * 5, -1)
    C = entry((outputs, 6), *[(i, j, 1) for i, j in enumerate((0, 2, 4)[:outputs])])
    names = {
        "k1": dict(A=entry((6, 6), (0, 1, 0.05))),
        "k2": dict(A=entry((6, 6), (2, 3, 0.05))),
        "k3": dict(A=entry((6, 6), (4, 3, 0.05))),
        "gain": dict(C=entry((outputs, 6), (0, 0, 0.05))),
    }
    B = entry((6, 1), (3, 0, 1))
    return jb.LinearSystem(
        A,
        B,
        C,
        uncertainties=[jb.Uncertainty(n, varying=n in varying, **where) for n, where in names.items()],
    )


def building(m, horizon, repeats):
    """Return the size of relations, the seconds to build them, and the windows a second that `detect`
    decides.
    """
    seconds, r = best(lambda: jb.parity_relations(m, horizon=horizon), repeats)
    unknowns, windows, speed = max(step.unknowns for step in r.steps), option("--windows", 2**15), {}
    if windows:
        t = jb.simulate(m, np.random.default_rng(1).uniform(0, 2, (windows, 1)), jax.random.key(1))
        u, y = np.asarray(t.u), np.asarray(t.y)
        compiling, _ = best(lambda: jb.detect(r, u, y).status, 1)
        run, _ = best(lambda: jb.detect(r, u, y).status, repeats)
        speed = {"windows_per_second": windows / run, "compile_seconds": compiling - run}
    return {
        "horizon": r.horizon,
        "relations": r.count,
        "order": r.order,
        "monomials": len(r.exponents),
        "largest_system": unknowns,
        "seconds": seconds,
        **speed,
    }


def main():
    repeats, largest = option("--repeats", 3), option("--largest", 2000)
    figures = {"null_spaces": {name: kernels(name, repeats, largest) for name in SYSTEMS}}
    figures["papers_model"] = [building(model("n2p1_paper_h3"), s, repeats) for s in range(2, 8)]
    sizes = [(x["horizon"] + 1, x["seconds"]) for x in figures["papers_model"]]
    figures["growth"] = float(
        np.polyfit([h for h, _ in sizes], np.log2([t for _, t in sizes]), 1)[0]
    )  # doublings a sample
    figures["six_states"] = {
        f"{outputs} outputs, varying: {', '.join(varying) or 'none'}": building(
            six_states(outputs, varying), None, 1
        )
        for outputs, varying in ((3, ()), (3, ("k1", "gain")), (3, ("k1", "k2", "k3", "gain")), (2, ()))
    }
    save("uncertain", figures)


if __name__ == "__main__":
    main()
