"""What it costs that every FAULT is decided twice: detect with and without the second decision, processor
time by turns, in one run, where no window, one of a hundred and every one is faulty.

python -m benchmarks.twice [--only "strips;bank"] [--unexamined]

Healthy recordings should cost less than 3 % more; where every window is faulty, strips should take as long as
blocked NumPy needs for the same sums (20 million windows a second on section 5), and searched windows less
than 30 % more. --unexamined: as beside a card that nobody examined, whose verdicts the host cuts down to what
it proves; the share is then that of all that the host does for it. The search is the CPU's here: beside a
fast card the seconds of the host stay and the share grows.
"""

import contextlib
import sys
import time
from pathlib import Path
from unittest.mock import patch

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from lying_device import unexamined  # noqa: E402

ROUNDS = 5
SHARES = 0.0, 0.01, 1.0
SECTION_5 = jb.LinearSystem(
    [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01]
)
DISTURBED = SECTION_5.replace(tolerance=0, disturbance=([[1], [1]], 0.02))
SHAKY = SECTION_5.replace(
    uncertainties=[
        jb.Uncertainty("a", A=[["0.02", 0], [0, "0.01"]]),
        jb.Uncertainty("b", A=[[0, "0.05"], [0, 0]]),
    ]
)
CONSTANT = SECTION_5.replace(constant_tolerance=True)
CASES = {  # name: (relations, method, windows)
    "strips": (lambda: jb.parity_relations(SECTION_5), "joint", 2_000_000),
    "bank": (lambda: jb.redundancy(SECTION_5), "box", 1_000_000),
    "long, 16 samples": (lambda: jb.parity_relations(SECTION_5, 15), "joint", 50_000),
    "long, disturbed": (lambda: jb.parity_relations(DISTURBED, 15), "joint", 20_000),
    "long, 41 samples": (lambda: jb.parity_relations(SECTION_5, 40), "joint", 20_000),
    "constant, short": (lambda: jb.parity_relations(CONSTANT, 2), "joint", 20_000),
    "constant, long": (lambda: jb.parity_relations(CONSTANT, 20), "joint", 5_000),
    "uncertain": (lambda: jb.parity_relations(SHAKY), "joint", 20_000),
    "observer": (lambda: jb.observer(DISTURBED), "observer", 12_000),
    "observer, joint": (lambda: jb.observer(DISTURBED, method="joint"), "observer", 6_000),
}


def once():
    """Return patches that leave the second decision out."""
    return (
        patch(
            "jaxbound.consistency.drive._contradicted",
            lambda test, u, y, starts, size: np.ones(len(starts), bool),
        ),
        patch(
            "jaxbound.consistency.drive._Gathering._proved",
            lambda self, part, block, judged: judged[: len(self.filling.outs) + 1],
        ),
        patch(
            "jaxbound.estimation.set_observer.doubtful",
            lambda watch, carry, samples, fault: np.zeros_like(fault),
        ),
    )


def seconds(relations, method, u, y):
    """Return (processor seconds of a detection, its Result)."""
    begun = time.process_time()
    found = jb.detect(relations, u, y, method=method)
    return time.process_time() - begun, found


def faulty(healthy, share, window):
    """Return outputs with faults in about a share of the windows, of so many samples each."""
    rng = np.random.default_rng(1)
    wrong = healthy + 8 * rng.normal(size=healthy.shape)
    if share == 1:
        return wrong
    where = np.zeros(healthy.shape[:-1], bool)
    if share:
        where.reshape(-1)[:: round(window / share)] = True
    return np.where(where[..., None], wrong, healthy)


def compared(relations, method, u, y, beside):
    """Return ((once, twice) in s, share of FAULT), the least of some rounds by turns; beside: the context of
    the second.
    """
    times = np.full((2, ROUNDS), np.inf)
    seconds(relations, method, u, y)
    with beside():
        seconds(relations, method, u, y)
    for k in range(ROUNDS):
        first, second, third = once()
        with first, second, third:
            times[0, k], alone = seconds(relations, method, u, y)
        with beside():
            times[1, k], found = seconds(relations, method, u, y)
        faults = [x.status == jb.Status.FAULT for x in (alone, found)]
        assert (faults[0] == faults[1]).all()
    return times.min(1), float((found.status == jb.Status.FAULT).mean())


def main():
    """Print the table."""
    print(timing.machine())
    chosen = sys.argv[sys.argv.index("--only") + 1].split(";") if "--only" in sys.argv else CASES
    beside = unexamined if "--unexamined" in sys.argv else contextlib.nullcontext
    columns = [f"{share:.0%} faulty: us a window, once / twice | share of the host" for share in SHARES]
    print(f"| | {' | '.join(columns)} | FAULT |\n|---|{'---|---|' * len(SHARES)}---|")
    for name in chosen:
        make, method, count = CASES[name]
        relations = make()
        rng = np.random.default_rng(0)
        shape = (count // 60, 60, 1) if "observer" in name else (count, 1)
        u = rng.normal(size=shape)
        healthy = np.array(jb.simulate(relations.model, u, jax.random.key(0), at="uniform").y)
        cells, found = [], []
        for wanted in SHARES:
            y = faulty(healthy, wanted, relations.horizon + 1)
            (alone, both), share = compared(relations, method, u, y, beside)
            cells += [
                f"{1e6 * alone / count:.3g} / {1e6 * both / count:.3g}",
                f"{100 * (1 - alone / both):.0f} %",
            ]
            found.append(f"{share:.3f}")
        print(f"| {name} | {' | '.join(cells)} | {', '.join(found)} |", flush=True)


if __name__ == "__main__":
    main()
