"""A plant with a start-up and three modes, watched by one monitor: no false alarm, and no missed proof where
nobody knows the mode.

A room is heated, cooled or left alone; for half an hour after its fan starts the air is not mixed yet. Each
mode has matrices of its own, and noise of its own width. A run begins with the start-up and then changes its
mode at random; half of its errors are at their bounds. The log says the mode, but for stretches of a third of
the samples, within which the mode stays the same, as docs/monitor.md has it.

And the log says another mode than the one that holds: what wrong conditions cost. Other runs, a tenth as
many, get a bias of the room's sensor from a random sample on. Unknown modes are then asked of linear
programs, too: each window of each mode that may hold has one, its states and errors the unknowns.

python -m benchmarks.modes [--samples 1000000] [--programs 1000] [--seed 0]
"""

import sys
import time
from pathlib import Path

import highspy
import numpy as np
import pandas as pd

import jaxbound as jb
from benchmarks import timing
from jaxbound.sets.floats.status import Status

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from linear_programs import is_feasible, solver  # noqa: E402

RUN = 1000  # samples from one start of the fan to the next
STARTING = 30  # samples of the start-up
NOISE = np.array([0.3, 0.2])
INSIDE = 1 - 1e-9  # a simulation rounds: its errors stay so far inside
NEAR = 1e-6  # of the boundary, within which HiGHS may tell otherwise
C = np.array([[1.0, 0.0], [0.0, 1.0]])
MODES = {
    # condition: A, B, factor on the noise
    f"age < {STARTING}": ([["0.9", "0.05"], ["0.1", "0.8"]], [["0"], ["0.5"]], 3),
    f"age >= {STARTING} and mode == 1": ([["0.95", "0.04"], ["0.02", "0.85"]], [["0"], ["1.5"]], 1),
    f"age >= {STARTING} and mode == 2": ([["0.95", "0.04"], ["0.02", "0.8"]], [["0"], ["-2"]], "1.5"),
    "otherwise": ([["0.98", "0.01"], ["0.05", "0.9"]], [["0"], ["0"]], 1),
}
HORIZONS = 1, 6
SIZES = 0.5, 1.0, 2.0


def tests():
    """Return the tests of the monitor: short and long windows of each mode."""
    stated = []
    for when, (A, B, factor) in MODES.items():
        for horizon in HORIZONS:
            own = {"matrices": {"A": A, "B": B}}
            name = f"{when}, {horizon + 1} samples"
            stated.append({"name": name, "horizon": horizon, "factor": factor, "when": when, "model": own})
    return stated


def room():
    """Return the model of the room, that of its first mode."""
    A, B, _ = next(iter(MODES.values()))
    names = {"inputs": "valve", "outputs": ["room", "supply"]}
    return jb.LinearSystem(A, B, C.tolist(), noise=NOISE.tolist(), **names)


def simulated(rng, runs, samples=RUN):
    """Return (u, y, mode, known) of runs, (runs, samples, ..): the number of the mode that holds, and whether
    the log says it. Modes change between stretches alone, of which each is known, or not, as a whole.
    """
    A, B, width = zip(*MODES.values(), strict=True)
    A, B, width = np.array(A, float), np.array(B, float), np.array(width, float)
    mode, known = np.zeros((runs, samples), int), np.ones((runs, samples), bool)
    for r in range(runs):
        first, said = STARTING, True
        while first < samples:
            last = first + rng.integers(5, 80)
            mode[r, first:last] = rng.integers(1, len(MODES))
            said = not said or rng.random() < 0.5  # two unknown ones would be one, with two modes
            known[r, first:last] = said
            first = last
        if rng.random() < 0.2:  # the log may have missed the start, too
            known[r, : rng.integers(1, STARTING)] = False
    u = np.repeat(rng.uniform(-0.5, 1, (runs, samples // 10 + 1)), 10, 1)[:, :samples, None]
    u = np.maximum(u, 0)  # shut for a third of the time
    x, truth = rng.normal(20, 5, (runs, 2)), np.empty((runs, samples, 2))
    for k in range(samples):
        truth[:, k] = x @ C.T
        now = mode[:, k]
        x = np.einsum("rij,rj->ri", A[now], x) + np.einsum("rij,rj->ri", B[now], u[:, k])
    error = rng.uniform(-1, 1, truth.shape)
    error = np.where(rng.random((runs, samples, 1)) < 0.5, np.sign(error), error)
    return u, truth + INSIDE * error * NOISE * width[mode][..., None], mode, known


def logged(u, y, mode, known):
    """Return (table, starts) of runs that are laid end to end; what is unknown is NaN: the mode, or at the
    start the age, too.
    """
    runs, samples = mode.shape
    age = np.broadcast_to(np.arange(samples), mode.shape)
    said = np.where(known, mode % 3, np.nan)
    columns = {
        "age": np.where(known | (age >= STARTING), age, np.nan),
        "mode": np.where(age < STARTING, np.where(known, 0, np.nan), said),
        "valve": u[..., 0],
        "room": y[..., 0],
        "supply": y[..., 1],
    }
    table = pd.DataFrame({name: values.ravel() for name, values in columns.items()})
    return table, np.arange(samples, runs * samples, samples)


def biased(rng, y, size):
    """Return (y, onset (runs,)) with a bias of the room's sensor, as a multiple of its bound."""
    onset = rng.integers(STARTING, y.shape[1] // 2, len(y))
    late = np.arange(y.shape[1]) >= onset[:, None]
    wrong = y.copy()
    wrong[..., 0] += size * NOISE[0] * rng.choice([-1, 1], (len(y), 1)) * late
    return wrong, onset


def judged(bank, table, starts):
    """Return (Result, seconds of processors)."""
    start = time.process_time()
    res = jb.detect(bank, table, starts=starts)
    return res, time.process_time() - start


def shares(status, chosen):
    """Return the counts of some samples: how many there are, have a verdict, are FAULT."""
    some = status[chosen]
    found = {"samples": some.size, "judged": int((some != Status.MISSING).sum())}
    return found | {"FAULT": int((some == Status.FAULT).sum())}


class Program:
    """Linear programs of windows of one mode: the least factor on the noise that explains a window."""

    def __init__(self, number, horizon):
        A, B, factor = list(MODES.values())[number]
        self.A, self.B = np.array(A, float), np.array(B, float)
        self.rho, self.horizon = NOISE * float(factor), horizon
        powers = [C @ np.linalg.matrix_power(self.A, k) for k in range(horizon + 1)]
        self.free = np.concatenate(powers)

    def factor(self, u, y):
        """Return it; u (horizon + 1, 1), y (horizon + 1, 2)."""
        x, forced = np.zeros(2), np.empty_like(y)
        for k in range(len(y)):
            forced[k], x = C @ x, self.A @ x + self.B @ u[k]
        rest = (y - forced).ravel()
        rho = np.tile(self.rho, len(y))
        program = solver()
        infinity = highspy.kHighsInf
        for cost, least in ((0.0, -infinity), (0.0, -infinity), (1.0, 0.0)):
            program.addCol(cost, least, infinity, 0, np.zeros(0, np.int32), np.zeros(0))
        columns = np.arange(3, dtype=np.int32)
        for row, target, width in zip(self.free, rest, rho, strict=True):
            program.addRow(target, infinity, 3, columns, np.array([*row, width]))
            program.addRow(-infinity, target, 3, columns, np.array([*row, -width]))
        assert is_feasible(program)
        return program.getInfo().objective_function_value


def by_programs(k, u, y, said, begin, programs):
    """Return whether windows within [begin, k] refute every mode that may hold, None near the boundary.

    said: number of the modes that may hold at k.
    """
    answers = []
    for number in said:
        factors = [0.0]
        for program in programs[number]:
            first = k - program.horizon
            if first >= begin:
                factors.append(program.factor(u[first : k + 1], y[first : k + 1]))
        answers.append(max(factors))
    least = min(answers)
    if abs(least - 1) < NEAR:
        return None
    return least > 1


def compared(rng, status, table, unknown, run, count):
    """Return how often programs tell otherwise than the verdicts of samples whose mode is unknown."""
    programs = [[Program(number, h) for h in HORIZONS] for number in range(len(MODES))]
    age, mode = table["age"].to_numpy(), table["mode"].to_numpy()
    u, y = table[["valve"]].to_numpy(), table[["room", "supply"]].to_numpy()
    # half of those that are FAULT: faults that are large enough for every mode are few
    faulty = np.flatnonzero(unknown & (status == Status.FAULT))
    chosen = [rng.choice(faulty, min(count // 2, len(faulty)), replace=False)]
    chosen.append(rng.choice(np.flatnonzero(unknown), count - len(chosen[0])))
    edges = np.diff(unknown, prepend=False) | (np.arange(len(status)) % run == 0)
    edges |= np.diff(np.isnan(age), prepend=False) | (age == STARTING)
    found = {"asked": count, "FAULT": 0, "near the boundary": 0, "otherwise": 0}
    for k in np.concatenate(chosen):
        begin = np.flatnonzero(edges[: k + 1])[-1]
        modes = range(len(MODES)) if np.isnan(age[k]) else range(1, len(MODES))
        assert np.isnan(mode[k])
        answer = by_programs(k, u, y, modes, begin, programs)
        if answer is None:
            found["near the boundary"] += 1
        else:
            found["FAULT"] += int(answer)
            found["otherwise"] += int(answer != (status[k] == Status.FAULT))
    return found


def healthy(bank, rng, runs, samples=RUN):
    """Return the counts of runs without a fault, and the seconds of processors."""
    u, y, mode, known = simulated(rng, runs, samples)
    res, seconds = judged(bank, *logged(u, y, mode, known))
    found = {}
    for name, some in (("mode known", known), ("mode unknown", ~known)):
        found[name] = shares(res.status, some.ravel())
    found["seconds"] = round(seconds, 2)
    everywhere = np.ones_like(known)
    res, seconds = judged(bank, *logged(u, y, mode, everywhere))
    found["no mode left unknown"] = shares(res.status, everywhere.ravel())
    found["no mode left unknown"]["seconds"] = round(seconds, 2)
    other = np.where(mode > 0, mode % 3 + 1, 0)
    res, _ = judged(bank, *logged(u, y, other, everywhere))
    found["the log says another mode"] = shares(res.status, mode.ravel() > 0)
    return found


def faulty(bank, rng, runs, size, count, samples=RUN):
    """Return the counts of runs with a bias, and of the programs of some samples."""
    u, y, mode, known = simulated(rng, runs, samples)
    y, onset = biased(rng, y, size)
    table, starts = logged(u, y, mode, known)
    res, _ = judged(bank, table, starts)
    late = np.arange(samples) >= onset[:, None]
    fault = (res.status == Status.FAULT).reshape(late.shape)
    found = {"runs": runs, "with an alarm": int((fault & late).any(1).sum())}
    found["alarms before"] = int((fault & ~late).sum())
    for name, some in (("mode known", known & late), ("mode unknown", ~known & late)):
        found[name] = shares(res.status, some.ravel())
    found["programs"] = compared(rng, res.status, table, ~known.ravel(), samples, count)
    return found


def main():
    rng, bank = np.random.default_rng(timing.option("--seed", 0)), jb.monitor(room(), tests())
    runs, count = timing.option("--samples", 1_000_000) // RUN, timing.option("--programs", 1000)
    healthy(bank, rng, 2)  # compiles
    figures = {"healthy": healthy(bank, rng, runs), "faults": {}}
    for size in SIZES:
        figures["faults"][f"{size:g} bounds"] = faulty(bank, rng, max(runs // 10, 1), size, count)
    timing.save("modes", figures)


if __name__ == "__main__":
    main()
