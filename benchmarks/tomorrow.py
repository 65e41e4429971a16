"""Do bounds from a few days hold on the next one: factors of days that were left out, against the needs of
fresh days.

    python -m benchmarks.tomorrow        about ten minutes of one core; writes tomorrow.json, prints tables
    python -m benchmarks.tomorrow --repeats 3
    python -m benchmarks.tomorrow --repeats 0       the curves of detection alone, and their picture

Four plants are simulated, each day at another operating point: a first order with dead time, two tanks (not
linear), an oscillator, and four states whose sensors drift. `jb.fit` sees 2, 3 or 5 days; its factor is set
beside what FRESH days need of the smallest bounds: how many need more than the factor (1 / (n + 1) is what n
days promise at best), and more than the factor times the safety of 1.25. Then a sensor's bias begins at noon:
the share of days in which it is seen, by windows and by four statistics whose thresholds are set on the
fresh days themselves, so that they raise an alarm on as many of them as the windows do.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.plots.canvas import GRID, canvas, style

T, FRESH, HORIZON = 240, 200, 15
DAYS = 2, 3, 5
SIZES = 0.5, 1, 1.5, 2, 3, 4, 6, 8
"""Biases, in units of the smallest bound."""
LINES = {
    "windows": ("#16324f", "o-"),
    "Kalman filter": ("#b33c00", "s--"),
    "chi-square of 16 errors": ("#e69f00", "^--"),
    "CUSUM": ("#56b4e9", "v--"),
    "isolation forest": ("#8a8f98", "x--"),
}
"""Colour and line of each curve of the picture."""
Day = tuple[np.ndarray, np.ndarray]


def inputs(rng: np.random.Generator, level: float, reach: float) -> np.ndarray:
    """Steps of 10 to 40 samples around the level of the day."""
    u = np.zeros(T)
    at = 0
    while at < T:
        length = int(rng.integers(10, 41))
        u[at : at + length] = level + reach * rng.uniform(-1, 1)
        at += length
    return u[:, None]


def noisy(y: np.ndarray, bound: float, rng: np.random.Generator) -> np.ndarray:
    return y + bound * rng.uniform(-1, 1, y.shape)


def dead_time(rng: np.random.Generator) -> Day:
    """A first order, whose input acts after 5 samples; its load is another one each day."""
    u = inputs(rng, rng.uniform(-1, 1), 1.0)
    load, x, y = 0.05 * rng.uniform(-1, 1), 0.0, np.zeros((T, 1))
    acts = np.concatenate([np.full((4, 1), u[0, 0]), u])
    for k in range(T):
        y[k] = x
        x = 0.9 * x + 0.2 * acts[k, 0] + load
    return u, noisy(y, 0.1, rng)


def tanks(rng: np.random.Generator) -> Day:
    """Two tanks, one above the other: outflows go with the root of the level."""
    u = inputs(rng, rng.uniform(0.8, 1.2), 0.3)
    h, y = np.array([1.0, 1.0]), np.zeros((T, 2))
    for k in range(T):
        y[k] = h
        out = 0.1 * np.sqrt(np.maximum(h, 0))
        h = h + np.array([0.1 * u[k, 0] - out[0], out[0] - out[1]])
    return u, noisy(y, 0.01, rng)


def oscillator(rng: np.random.Generator) -> Day:
    """A hardly damped second order, pushed by something that nobody measures."""
    u = inputs(rng, 0.0, rng.uniform(0.5, 1.5))
    x, y = np.zeros(2), np.zeros((T, 1))
    for k in range(T):
        y[k] = x[0]
        push = u[k, 0] + 0.05 * rng.uniform(-1, 1)
        x = np.array([1.85 * x[0] - 0.95 * x[1] + 0.1 * push, x[0]])
    return u, noisy(y, 0.05, rng)


def drifting(rng: np.random.Generator) -> Day:
    """Four lags in a row, two of them measured, with sensors that drift by the hour."""
    u = inputs(rng, rng.uniform(-1, 1), 1.0)
    x, drift, y = np.zeros(4), 0.05 * rng.uniform(-1, 1, 2), np.zeros((T, 2))
    for k in range(T):
        y[k] = x[[1, 3]] + drift
        drift = np.clip(drift + 0.002 * rng.uniform(-1, 1, 2), -0.1, 0.1)
        x = 0.8 * x + 0.2 * np.concatenate([u[k], x[:-1]])
    return u, noisy(y, 0.02, rng)


PLANTS: dict[str, Callable[[np.random.Generator], Day]] = {
    "dead time": dead_time,
    "two tanks": tanks,
    "oscillator": oscillator,
    "four states, drift": drifting,
}


def days(plant: str, count: int, seed: int) -> Day:
    """Return (u (count, T, m), y (count, T, p))."""
    rng = np.random.default_rng(seed)
    us, ys = zip(*(PLANTS[plant](rng) for _ in range(count)), strict=True)
    return np.stack(us), np.stack(ys)


def trial(plant: str, count: int, seed: int, **options) -> dict[str, float]:
    """Return the figures of one fit to so many days."""
    u, y = days(plant, count, seed)
    model = jb.fit(list(zip(u, y, strict=True)), horizon=HORIZON, **options)
    smallest = np.array([model.check.smallest[name] for name in model.outputs])
    relations = jb.parity_relations(model.replace(noise=smallest.tolist(), resolution=0))
    fresh = days(plant, FRESH, 10_000 + seed)
    need = np.nanmax(1 - jb.detect(relations, *fresh, margins="exact").margin, axis=-1)
    factor = model.check.factor
    return {
        "order": model.check.order,
        "delay": model.check.delay,
        "factor": factor,
        "needed": float(np.quantile(need, 1 - 1 / (count + 1))),
        "beyond": float((need > factor).mean()),
        "with safety": float((need > 1.25 * factor).mean()),
        "blind": float((need > 1.25).mean()),
    }


def one_step(trained: Day, fresh: Day, order: int = 2) -> np.ndarray:
    """Return errors (count, T, p) one step ahead of a regression, over their standard deviations."""

    def regressors(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        past = [np.roll(x, lag, 1) for x in (u, y) for lag in range(1, order + 1)]
        return np.concatenate([*past, np.ones((*y.shape[:2], 1))], 2)

    def flat(x: np.ndarray) -> np.ndarray:
        return x[:, order:].reshape(-1, x.shape[2])

    theta = np.linalg.lstsq(flat(regressors(*trained)), flat(trained[1]), rcond=None)[0]
    spread = (flat(trained[1]) - flat(regressors(*trained)) @ theta).std(0)
    errors = (fresh[1] - regressors(*fresh) @ theta) / spread
    errors[:, :order] = 0
    return errors


def chi_square(trained: Day, fresh: Day) -> np.ndarray:
    """Return (count, T): squares of errors one step ahead, summed over a window."""
    squares = (one_step(trained, fresh) ** 2).sum(2)
    total = np.cumsum(np.pad(squares, ((0, 0), (HORIZON + 1, 0))), 1)
    return total[:, HORIZON + 1 :] - total[:, : -HORIZON - 1]


def cusum(trained: Day, fresh: Day) -> np.ndarray:
    """Return (count, T): the largest sum of errors one step ahead beyond half a standard deviation."""
    errors = one_step(trained, fresh)
    high = low = np.zeros((len(errors), errors.shape[2]))
    statistic = np.zeros(errors.shape[:2])
    for k in range(errors.shape[1]):
        high = np.maximum(high + errors[:, k] - 0.5, 0)
        low = np.maximum(low - errors[:, k] - 0.5, 0)
        statistic[:, k] = np.maximum(high, low).max(1)
    return statistic


def forest(trained: Day, fresh: Day) -> np.ndarray:
    """Return (count, T): the score of an isolation forest that sees three samples of all signals."""
    from sklearn.ensemble import IsolationForest

    def seen(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        both = np.concatenate([u, y], 2)
        return np.concatenate([both, np.roll(both, 1, 1), np.roll(both, 2, 1)], 2)[:, 2:]

    features = seen(*trained)
    found = IsolationForest(random_state=0).fit(features.reshape(-1, features.shape[2]))
    score = -found.score_samples(seen(*fresh).reshape(-1, features.shape[2])).reshape(len(fresh[1]), -1)
    return np.pad(score, ((0, 0), (2, 0)), constant_values=score.min())


RATIOS = 10.0 ** np.arange(-7, 3)
"""Variances of what moves each state, in units of those of the outputs, of which the likeliest is taken."""


def innovations(model: jb.LinearSystem, ratio: float, fresh: Day) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (count, T, p) one step ahead of a Kalman filter of the model, each over its standard
    deviation and apart from the others, and the logarithms (T,) of what these deviations multiply to.

    Outputs have variances of 1 in units of their bounds; those of states are `ratio` in the same units.
    """
    A, B, C, D = (np.array(getattr(model, name), float) for name in "ABCD")
    unit = np.array([model.check.smallest[name] for name in model.outputs])
    C, D = C / unit[:, None], D.reshape(model.p, model.m) / unit[:, None]
    y = (fresh[1] - np.array(model.offset["y"], float)) / unit
    u = fresh[0] - np.array(model.offset["u"], float)
    # a state moves by as much as shows in an output
    Q = ratio * np.diag(1 / np.maximum((C**2).sum(0), 1e-12).clip(min=(C**2).sum(0).max() * 1e-6))
    x, P = np.zeros((len(u), model.n)), 1e6 * Q / ratio
    errors, logs = np.zeros(y.shape), np.zeros(T)
    for k in range(T):
        S = C @ P @ C.T + np.eye(model.p)
        root = np.linalg.cholesky(S)
        e = y[:, k] - x @ C.T - u[:, k] @ D.T
        errors[:, k] = np.linalg.solve(root, e.T).T
        logs[k] = np.log(np.diag(root)).sum()
        gain = np.linalg.solve(S, C @ P).T
        x, P = x + e @ gain.T, P - gain @ C @ P
        x, P = x @ A.T + u[:, k] @ B.T, A @ P @ A.T + Q
    return errors, logs


def kalman(model: jb.LinearSystem, trained: Day, fresh: Day) -> np.ndarray:
    """Return (count, T): squares of innovations of a Kalman filter, summed over a window. It has the model of
    the windows, and the variances with which the training days are likeliest.
    """

    def unlikely(ratio: float) -> float:
        errors, logs = innovations(model, ratio, trained)
        errors, logs = errors[:, HORIZON:], logs[HORIZON:]
        level = (errors**2).mean()  # the likeliest variance of outputs
        return float(0.5 * np.log(level) * model.p + logs.mean())

    errors, _ = innovations(model, min(RATIOS, key=unlikely), fresh)
    squares = (errors**2).sum(2)
    squares[:, :HORIZON] = 0  # it has not settled
    total = np.cumsum(np.pad(squares, ((0, 0), (HORIZON + 1, 0))), 1)
    return total[:, HORIZON + 1 :] - total[:, : -HORIZON - 1]


STATISTICS = {"chi-square of 16 errors": chi_square, "CUSUM": cusum, "isolation forest": forest}


def power(plant: str, count: int, seed: int) -> dict[str, list[float]]:
    """Return, for each method, the share of days in which a bias of each of SIZES is seen."""
    trained, fresh = days(plant, count, seed), days(plant, FRESH, 10_000 + seed)
    model = jb.fit(list(zip(*trained, strict=True)), horizon=HORIZON)
    relations, bound = jb.parity_relations(model), model.check.smallest[model.outputs[0]]
    false = jb.detect(relations, *fresh).status == jb.Status.FAULT
    allowed = max(int(false.any(1).sum()), 1)
    faulty = []
    for size in SIZES:
        wrong = fresh[1].copy()
        wrong[:, T // 2 :, 0] += size * bound
        faulty.append((fresh[0], wrong))
    windows = [(jb.detect(relations, *each).status == jb.Status.FAULT).any(1) for each in faulty]
    seen = {"false alarms, of days": [allowed / FRESH], "windows": [float(x.mean()) for x in windows]}
    statistics = {"Kalman filter": partial(kalman, model)} | STATISTICS
    for name, statistic in statistics.items():
        limit = np.sort(statistic(trained, fresh).max(1))[-allowed]
        seen[name] = [float((statistic(trained, each).max(1) > limit).mean()) for each in faulty]
    return seen


def draw(curves: dict[str, dict[str, list[float]]], path: Path) -> None:
    """Draw the shares of days in which a bias is seen against its size, a panel for each plant."""
    fig = canvas((9.5, 6.2))
    with style():
        panels = fig.subplots(2, 2, sharex=True, sharey=True).ravel()
        for axes, (plant, seen) in zip(panels, curves.items(), strict=True):
            for name, (colour, line) in LINES.items():
                share = 100 * np.array(seen[name])
                axes.plot(SIZES, share, line, color=colour, lw=2 if name == "windows" else 1.3, label=name)
            alarms = 100 * seen["false alarms, of days"][0]
            axes.set_title(f"{plant}: alarms on {alarms:g} % of healthy days")
            axes.set_xscale("log", base=2)
            axes.set_xticks(SIZES, [f"{size:g}" for size in SIZES])
            axes.minorticks_off()
            axes.grid(color=GRID)
            axes.set_ylim(-3, 103)
        for axes in panels[2:]:
            axes.set_xlabel("bias from noon on, in units of the smallest bound")
        for axes in panels[::2]:
            axes.set_ylabel("fresh days on which it is seen, %")
        fig.legend(
            *panels[0].get_legend_handles_labels(), loc="upper center", ncols=len(LINES), frameon=False
        )
        fig.subplots_adjust(left=0.07, right=0.985, top=0.9, bottom=0.08, hspace=0.2, wspace=0.06)
        fig.savefig(path, dpi=110)


def rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Return Spearman's."""
    ranks = [np.argsort(np.argsort(each)) for each in (x, y)]
    return float(np.corrcoef(*ranks)[0, 1])


def main() -> None:
    """Measure, print the tables and write the file."""
    repeats = timing.option("--repeats", 10)
    rows: dict[str, dict[str, list[dict[str, float]]]] = {}
    print("| plant | days | factor | needed (quantile) | days beyond it | promise | with 1.25 | 1.25 alone |")
    for plant in PLANTS if repeats else ():
        for count in DAYS:
            trials = [trial(plant, count, 100 * count + r) for r in range(repeats)]
            rows.setdefault(plant, {})[str(count)] = trials
            mean = {name: np.mean([t[name] for t in trials]) for name in trials[0]}
            print(
                f"| {plant} | {count} | {mean['factor']:.2f} | {mean['needed']:.2f} | {mean['beyond']:.3f} | "
                f"{1 / (count + 1):.3f} | {mean['with safety']:.4f} | {mean['blind']:.4f} |",
                flush=True,
            )
    if repeats:
        every = [t for plant in rows.values() for trials in plant.values() for t in trials]
        both = [np.array([t[name] for t in every]) for name in ("factor", "needed")]
        correlation = rank_correlation(*both)
        print(f"rank correlation of factor and need, {len(every)} fits: {correlation:.2f}")
        found = {plant: trial(plant, 5, 7, order="auto", delay="auto") for plant in PLANTS}
        for plant, one in found.items():
            print(f"order and delay of {plant}: {one['order']}, {one['delay']}")
        timing.save("tomorrow", {"trials": rows, "rank correlation": correlation, "structure": found})
    curves = {plant: power(plant, 5, 11) for plant in PLANTS}
    for plant, seen in curves.items():
        print(plant, {name: np.round(x, 3).tolist() for name, x in seen.items()}, flush=True)
    timing.save("tomorrow_curves", {"sizes": SIZES, "power": curves})
    draw(curves, Path(__file__).parent / "figures" / "tomorrow.png")


if __name__ == "__main__":
    main()
