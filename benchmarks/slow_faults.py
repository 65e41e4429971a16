"""Who sees a sensor that drifts while the weather changes and the load steps: bounds, a Kalman filter and
CUSUM, with the truth known.

    python -m benchmarks.slow_faults        about half an hour of one core; writes slow_faults.json, prints
    the table

The plant: two heated blocks that lose heat to each other and to the air around, which wanders by at most 0.02
degC a sample; a coarse thermometer of the air; a load that nobody measures, up to 0.01 degC a sample on each
block; heaters that step now and then. Everything lies inside the stated bounds, so that sets and windows
raise no false alarm by proof. Healthy recordings are of three kinds:

    still       errors, air and load drawn anew at each sample, uniform within 0.8 of their bounds
    changing    the air goes up and down as on a day, and the load stays for 80 samples at one of 0.8 of its
    bounds
    worst       the same at the bounds themselves, and every sensor at one of its bounds at each sample

The Kalman filter knows the matrices and the variance of everything that is drawn in still weather. A
threshold is the largest value that a statistic takes on healthy recordings: of the first two kinds, or, where
the name ends in "all", of all three, which is what the bounds promise. On fresh ones the alarms are counted,
and so they are if the threshold was found in still weather alone. Recordings are the same for all methods.
Windows, whose work is the largest, are looked at at every eighth sample; FIRST samples are nobody's.
"""

import inspect
import time
from collections.abc import Callable

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.estimation.methods import OBSERVERS

T, FIRST, ONSET, EVERY = 480, 60, 200, 8
LEARNT, FRESH, FAULTY = 256, 64, 16
"""Healthy recordings of a kind that thresholds are found on, and that alarms are counted on; recordings of
each fault.
"""
LIMITS = np.array([0.01, 0.01, 0.02])
KINDS = "still", "changing", "worst"
SIZES = 0.5, 1, 1.5, 2, 3, 4
RATES = 0.005, 0.02
AIR = dict(
    A=[["0.985", "0.005", "0.01"], ["0.005", "0.985", "0.01"], [0, 0, 1]],
    B=[["0.005", 0], [0, "0.005"], [0, 0]],
    C=[[1, 0, 0], [0, 1, 0], [0, 0, 1]],
)
PLANT = jb.LinearSystem(
    **AIR,
    dt=10,
    inputs=["Q1", "Q2"],
    outputs=["T1", "T2", "air"],
    noise=["0.3", "0.3", "0.5"],
    disturbance=([[1, 0, 0], [0, 1, 0], [0, 0, 1]], ["0.01", "0.01", "0.02"]),
    name="two blocks",
)
TRUTH = PLANT.replace(
    B=[[*b, *g] for b, g in zip(PLANT.B, np.eye(3, dtype=int).tolist(), strict=True)],
    D=None,
    inputs=["Q1", "Q2", "w1", "w2", "w3"],
    disturbance=None,
    offset=None,
)
"""The plant with what disturbs it as inputs, so that it can be given."""
SHARE = 0.8
"""Of its bounds that a plant uses on most days: what a safety factor of 1.25 leaves."""
LAGS = 0, 1, 2, 3, 5, 7, 10, 15, 22, 33, 48

Beyond = Callable[[np.ndarray, np.ndarray], np.ndarray]


def recordings(kind: str, count: int, seed: int, heater: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return u (N, T, 2), y (N, T, 3) of recordings of a kind; from ONSET on the first heater gives so much
    of what it is told.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    u = np.stack([np.stack([_steps(rng) for _ in range(2)], 1) for _ in range(count)])
    if kind == "still":
        w = rng.uniform(-1, 1, (count, T, 3))
    else:
        k, phase = np.arange(T), rng.uniform(0, 2 * np.pi, (count, 1))
        w = np.repeat(rng.choice([-1.0, 1.0], (count, T // 80, 3)), 80, 1)
        w[..., 2] = np.sign(np.sin(2 * np.pi * k / T + phase))
    real = u * np.where(np.arange(T) < ONSET, 1.0, [[heater], [1.0]]).T
    worst = kind == "worst"
    share = 0.999 if worst else SHARE
    given = np.concatenate([real, share * LIMITS * w], -1)
    first = [20, 20, 0] + rng.uniform(-3, 3, (count, 3))
    truth = TRUTH.replace(noise=[share * float(x) for x in TRUTH.noise])
    drawn = jb.simulate(truth, given, seed, x0=first, at="vertices" if worst else "uniform")
    return u, np.array(drawn.y)


def _steps(rng):
    """Return (T,): a load in percent that stays for 40 to 120 samples."""
    lengths = rng.integers(40, 121, T // 40)
    return np.repeat(rng.uniform(0, 60, len(lengths)), lengths)[:T]


def wrong(shape: str, size: float) -> np.ndarray:
    """Return (T, 3): what T1 shows too much; a jump at ONSET, from the start on, or a drift of so much a
    sample from ONSET on.
    """
    k = np.arange(T)
    course = {"jump": k >= ONSET, "always": np.ones(T), "drift": np.maximum(k - ONSET + 1, 0)}[shape]
    return size * np.outer(course, [1, 0, 0])


def window(**options: object) -> Beyond:
    """Return `beyond` of windows, at every EVERY-th sample."""
    relations = jb.parity_relations(PLANT, **options)
    s = relations.horizon
    ends = np.arange(-(-max(s, FIRST) // EVERY) * EVERY, T, EVERY)

    def beyond(u, y):
        cut = lambda x: np.stack([x[:, e - s : e + 1] for e in ends], 1)
        out = np.zeros(y.shape[:2], bool)
        out[:, ends] = np.asarray(jb.detect(relations, cut(u), cut(y)).status)[..., -1] == jb.Status.FAULT
        return out

    return beyond


def observed(**options: object) -> Beyond:
    """Return `beyond` of an observer of the healthy plant."""
    return lambda u, y: np.asarray(jb.observe(PLANT, u, y, **options).status) == jb.Status.FAULT


def enclosed(**options: object) -> Beyond:
    """Return `beyond` of an observer that takes the error of T1 for a state: its interval does not hold 0, or
    nothing is left.
    """
    model = jb.with_faults(PLANT, "T1:drift", rate="0.02")

    def beyond(u, y):
        found = jb.observe(model, u, y, **options)
        error = found.state[..., 3]
        return (np.asarray(found.status) == jb.Status.FAULT) | (error.lo > 0) | (error.hi < 0)

    return beyond


class Kalman:
    """A Kalman filter of the plant, with the variances of what is drawn; bias: with the error of T1 as a
    state that wanders.
    """

    def __init__(self, bias: float = 0.0) -> None:
        real = lambda M: np.array([[float(x) for x in row] for row in M])
        self.A, self.B, self.C = (real(getattr(PLANT, x)) for x in "ABC")
        self.Q, self.R = (np.diag((SHARE * np.array(x)) ** 2 / 3) for x in (LIMITS, [0.3, 0.3, 0.5]))
        self.bias = bias
        if bias:
            self.A, self.Q = np.pad(self.A, (0, 1)), np.pad(self.Q, (0, 1))
            self.A[3, 3], self.Q[3, 3] = 1.0, bias**2
            self.B, self.C = np.pad(self.B, ((0, 1), (0, 0))), np.hstack([self.C, [[1], [0], [0]]])

    def run(self, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return innovations (N, T, 3) of covariance 1, and states over their standard deviations (N, T,
        n).
        """
        n = len(self.A)
        x, P = np.zeros((len(y), n)), np.diag([1e4] * 3 + [9.0] * (n - 3))
        e, z = np.zeros(y.shape), np.zeros((*y.shape[:2], n))
        for k in range(y.shape[1]):
            S = self.C @ P @ self.C.T + self.R
            gain = np.linalg.solve(S, self.C @ P).T
            off = y[:, k] - x @ self.C.T
            e[:, k] = np.linalg.solve(np.linalg.cholesky(S), off.T).T
            x, P = x + off @ gain.T, (np.eye(n) - gain @ self.C) @ P
            z[:, k] = x / np.sqrt(np.diag(P))
            x, P = x @ self.A.T + u[:, k] @ self.B.T, self.A @ P @ self.A.T + self.Q
        return e, z


def chi_square(samples: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the statistic |sum of the last innovations|^2 / samples."""

    def statistic(u, y):
        total = np.cumsum(np.pad(Kalman().run(u, y)[0], ((0, 0), (samples, 0), (0, 0))), 1)
        return (((total[:, samples:] - total[:, :-samples]) / np.sqrt(samples)) ** 2).sum(-1)

    return statistic


def cusum(drift: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the statistic of a two-sided CUSUM of each innovation (Page 1954): g = max(0, g + |e| - drift),
    the largest.
    """

    def statistic(u, y):
        e, up, out = Kalman().run(u, y)[0], 0.0, []
        e[:, :FIRST] = 0
        for k in range(e.shape[1]):
            both = np.concatenate([e[:, k], -e[:, k]], -1)
            up = np.maximum(0, up + both - drift)
            out.append(up.max(-1))
        return np.stack(out, 1)

    return statistic


def bias_state(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the estimated error of T1 over its standard deviation."""
    return abs(Kalman(0.02 / np.sqrt(3)).run(u, y)[1][..., 3])


SETS: dict[str, Beyond] = {"windows, 16 samples": window(horizon=15), "windows, 11 of 49": window(lags=LAGS)}
for one in OBSERVERS:
    how = {"method": one} if "method" in inspect.signature(jb.observe).parameters else {}
    SETS[f"observer, {one}"] = observed(**how)
    SETS[f"with_faults, {one}"] = enclosed(**how)
STATISTICS = {
    "chi-square, 1 sample": chi_square(1),
    "chi-square, sum of 16": chi_square(16),
    "chi-square, sum of 64": chi_square(64),
    "CUSUM, k 0.1": cusum(0.1),
    "CUSUM, k 0.5": cusum(0.5),
    "Kalman, error a state": bias_state,
}


def row(beyond: Beyond) -> dict:
    """Return what a method sees of every fault, and its false alarms on fresh healthy recordings of each
    kind.
    """
    late = np.arange(T) >= FIRST
    out: dict = {
        "false alarms": {
            kind: float((beyond(*recordings(kind, FRESH, 1)) & late).any(1).mean()) for kind in KINDS
        }
    }
    u, y = recordings("changing", FAULTY, 2)
    healthy = beyond(u, y) & late
    after = np.arange(T) >= ONSET
    for shape, sizes in (("jump", SIZES), ("always", SIZES), ("drift", RATES)):
        out[shape] = {}
        for size in sizes:
            out[shape][size] = _seen(
                beyond(u, y + wrong(shape, size)) & (late if shape == "always" else after), healthy
            )
    out["heater at 80 %"] = _seen(beyond(*recordings("changing", FAULTY, 2, 0.8)) & after, healthy)
    return out


def _seen(alarms, healthy):
    """Return {"share", "delay"} of recordings; one that has an alarm without the fault counts as not seen.
    delay: median of all.
    """
    hit = alarms.any(1) & ~healthy.any(1)
    delay = np.where(hit, alarms.argmax(1) - ONSET, np.inf)
    middle = float(np.sort(delay)[(len(delay) - 1) // 2])
    return {"share": float(hit.mean()), "delay": middle if np.isfinite(middle) else None}


def smallest(found: dict) -> float | None:
    """Return the smallest size that is seen in 9 of 10 recordings, as are all above it."""
    sizes = list(found)
    missed = [i for i, size in enumerate(sizes) if found[size]["share"] < 0.9]
    first = missed[-1] + 1 if missed else 0
    return float(sizes[first]) if first < len(sizes) else None


def table(results: dict) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [
        "| method | false alarms: still / changing / worst | jump | always | drift 0.005 | 0.02 | heater at "
        "80 % | us a sample |",
        "|---|---|---|---|---|---|---|---|",
    ]
    shown = lambda x: "never" if x is None else f"{x:g}"
    for name, r in results.items():
        wolf = " / ".join(f"{100 * x:.0f} %" for x in r["false alarms"].values())
        drift = [_reached(d["delay"], rate) for rate, d in r["drift"].items()]
        heater = r["heater at 80 %"]
        cells = [
            name,
            wolf,
            shown(smallest(r["jump"])),
            shown(smallest(r["always"])),
            *drift,
            shown(heater["delay"]),
            f"{r['us']:.3g}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _reached(delay, rate):
    """Return what a drift has reached when it is seen, and when."""
    return "never" if delay is None else f"{rate * (delay + 1):.2g} ({delay:g})"


def main() -> None:
    """Measure, print the table and write the file."""
    jax.config.update("jax_enable_x64", True)
    learnt = {kind: recordings(kind, LEARNT, 0) for kind in KINDS}
    methods, limits, still = dict(SETS), {}, {}
    for name, statistic in STATISTICS.items():
        most = {kind: float(statistic(*given)[:, FIRST:].max()) for kind, given in learnt.items()}
        for label, kinds in ((name, KINDS[:2]), (f"{name}, all", KINDS)):
            limits[label] = max(most[kind] for kind in kinds)
            methods[label] = lambda u, y, f=statistic, limit=limits[label]: f(u, y) > limit
        still[name] = {
            kind: float((statistic(*recordings(kind, FRESH, 1))[:, FIRST:] > most["still"]).any(1).mean())
            for kind in KINDS
        }
    results = {}
    for name, beyond in methods.items():
        u, y = recordings("still", FAULTY, 3)
        beyond(u, y)  # compiled
        start = time.process_time()
        beyond(u, y)
        spent = 1e6 * (time.process_time() - start) / y[..., 0].size
        results[name] = row(beyond) | {
            "us": spent * (EVERY if name.startswith("windows") else 1),
            "limit": limits.get(name),
        }
        print(table({name: results[name]})[-1], flush=True)
    print(
        "\n".join(
            [
                "",
                *table(results),
                "",
                "threshold from still weather alone: recordings with a false alarm",
                str(still),
            ]
        )
    )
    timing.save("slow_faults", {"methods": results, "threshold from still weather alone": still})


if __name__ == "__main__":
    main()
