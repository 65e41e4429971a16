"""Do bounds from a few days hold on the next one: fits as a user makes them, judged by days that they have
not seen.

    python -m benchmarks.tomorrow        ten minutes of one core; writes tomorrow.json, prints a table
    python -m benchmarks.tomorrow --repeats 10 --unseen 20
    python -m benchmarks.tomorrow --quick           one small fit: does it run
    python -m benchmarks.tomorrow --factors         the factor alone, of windows of 16 samples
    python -m benchmarks.tomorrow --curves          curves of detection, and their picture

Days of a heater whose room is another one each day, of a building in 30 days of spring (its weather is an
input, the sun is none), of two tanks (not linear), and of four states whose sensors drift. `jb.fit` gets 2,
3, 5 or 8 of 30, at random, and no option. All tests that it wrote then judge days that it has not seen. The
need of a window is the factor on the bounds as written that explains it, 1 less its margin: above 1 a healthy
day has a false alarm, and n days promise that at most 1 in n + 1 has one. From noon on a sensor has a bias,
or the first input loses some of its effect: the share of windows that are FAULT with the bounds as written,
and with bounds as wide, or as narrow, as the unseen healthy days ask for ("at zero": nobody knows them).

Factors: how many of 200 fresh days need more of the smallest bounds than the factor that `fit` states, and
than it times the safety of 1.25. Curves: a bias from noon on, seen by windows and by four statistics whose
thresholds are set on the fresh days themselves, so that they raise an alarm on as many of them as the windows
do.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

import jaxbound as jb
from benchmarks import timing
from benchmarks.contrast import table
from jaxbound.plots.canvas import GRID, canvas, style

T, NOON, FRESH, HORIZON = 240, 120, 200, 15
HOUR = 24 * np.arange(T) / T
DAYS = 2, 3, 5, 8
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
HEADER = (
    "plant, days",
    "factor",
    "need, median",
    "worst",
    "days with an alarm",
    "promise",
    "FAULT, healthy",
    "inside",
    "outside",
    "bias",
    "at zero",
    "loss",
    "at zero",
)
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


def dead_time(rng: np.random.Generator, acts: np.ndarray) -> Day:
    """A first order, whose input acts after 5 samples; its load is another one each day."""
    u = inputs(rng, rng.uniform(-1, 1), 1.0)
    load, x, y = 0.05 * rng.uniform(-1, 1), 0.0, np.zeros((T, 1))
    late = np.concatenate([np.full((4, 1), u[0, 0]), u])
    for k in range(T):
        y[k] = x
        x = 0.9 * x + 0.2 * acts[k] * late[k, 0] + load
    return u, noisy(y, 0.1, rng)


def tanks(rng: np.random.Generator, acts: np.ndarray) -> Day:
    """Two tanks, one above the other: outflows go with the root of the level."""
    u = inputs(rng, rng.uniform(0.8, 1.2), 0.3)
    h, y = np.array([1.0, 1.0]), np.zeros((T, 2))
    for k in range(T):
        y[k] = h
        out = 0.1 * np.sqrt(np.maximum(h, 0))
        h = h + np.array([0.1 * acts[k] * u[k, 0] - out[0], out[0] - out[1]])
    return u, noisy(y, 0.01, rng)


def oscillator(rng: np.random.Generator, acts: np.ndarray) -> Day:
    """A hardly damped second order, pushed by something that nobody measures."""
    u = inputs(rng, 0.0, rng.uniform(0.5, 1.5))
    x, y = np.zeros(2), np.zeros((T, 1))
    for k in range(T):
        y[k] = x[0]
        push = acts[k] * u[k, 0] + 0.05 * rng.uniform(-1, 1)
        x = np.array([1.85 * x[0] - 0.95 * x[1] + 0.1 * push, x[0]])
    return u, noisy(y, 0.05, rng)


def drifting(rng: np.random.Generator, acts: np.ndarray) -> Day:
    """Four lags in a row, two of them measured, with sensors that drift by the hour."""
    u = inputs(rng, rng.uniform(-1, 1), 1.0)
    x, drift, y = np.zeros(4), 0.05 * rng.uniform(-1, 1, 2), np.zeros((T, 2))
    for k in range(T):
        y[k] = x[[1, 3]] + drift
        drift = np.clip(drift + 0.002 * rng.uniform(-1, 1, 2), -0.1, 0.1)
        x = 0.8 * x + 0.2 * np.concatenate([acts[k] * u[k], x[:-1]])
    return u, noisy(y, 0.02, rng)


def heater(rng: np.random.Generator, acts: np.ndarray) -> Day:
    """A heater (%) and a thermometer on it (degC): two states, radiation, and a room whose temperature is
    another one each day, and drifts.
    """
    u = inputs(rng, rng.uniform(30, 60), 30)
    room, x, y = rng.uniform(19, 25), np.full(2, 25.0) + rng.uniform(0, 15), np.zeros((T, 1))
    for k in range(T):
        y[k] = x[1]
        room += 0.03 * rng.uniform(-1, 1)
        radiated = 4e-10 * ((x[0] + 273) ** 4 - (room + 273) ** 4)
        warmed = 0.03 * acts[k] * u[k, 0] - 0.025 * (x[0] - room) - radiated
        x = x + np.array([warmed, 0.15 * (x[0] - x[1])])
    return u, noisy(y, 0.15, rng)


def alone(day: Callable[[np.random.Generator, np.ndarray], Day]) -> "Season":
    """Return the season of days that know nothing of each other."""

    def season(rng: np.random.Generator, acts: np.ndarray, count: int) -> Day:
        us, ys = zip(*(day(rng, acts) for _ in range(count)), strict=True)
        return np.stack(us), np.stack(ys)

    return season


def building(rng: np.random.Generator, acts: np.ndarray, count: int) -> Day:
    """A room and its walls, 30 days of spring: temperature outside (degC) and heating (0 to 1, by a
    thermostat with a profile of the day) are inputs; sun, wind and people are none.
    """
    sun = np.maximum(np.sin(np.pi * (HOUR - 6) / 12), 0)
    state, anomaly, us, ys = np.array([17.0, 16.0]), 0.0, [], []
    for number in range(count):
        anomaly = 0.7 * anomaly + 2.0 * rng.standard_normal()
        clear, wind = rng.uniform(0, 1), rng.uniform(0.9, 1.1)
        people = rng.uniform(0.5, 1) * (number % 7 < 5) * ((HOUR >= 8) & (HOUR < 18))
        swing = (2 + 4 * clear) * np.sin(np.pi * (HOUR - 9) / 12)
        outside = 2 + number / 3 + anomaly + swing
        free = 0.010 * clear * sun + 0.004 * people
        heat, y, _ = room(state, outside, wind, free, acts)
        _, _, state = room(state, outside, wind, free, np.ones(T))  # tomorrow follows a healthy day
        us.append(np.stack([outside, heat], 1))
        ys.append(noisy(y, 0.05, rng))
    return np.stack(us), np.stack(ys)


def room(
    x: np.ndarray, outside: np.ndarray, wind: float, free: np.ndarray, acts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (heating, temperature (T, 1), state behind them) of a day that begins in a state.

    Args:
        wind: factor on what is lost to the outside. free: what warms the room beside its heating.
    """
    wanted = np.where((HOUR >= 6) & (HOUR < 22), 21.0, 17.0)
    heat, y = np.zeros(T), np.zeros((T, 1))
    for k in range(T):
        y[k] = x[0]
        heat[k] = np.clip(0.8 * (wanted[k] - x[0]), 0, 1)
        lost = 0.004 * wind * (x[0] - outside[k]) + 0.03 * (x[0] - x[1])
        warmed = 0.16 * acts[k] * heat[k] + free[k] - lost
        x = x + np.array([warmed, 0.004 * (x[0] - x[1]) - 0.0004 * (x[1] - outside[k])])
    return heat, y, x


Season = Callable[[np.random.Generator, np.ndarray, int], Day]
PLANTS: dict[str, Season] = {
    "dead time": alone(dead_time),
    "two tanks": alone(tanks),
    "oscillator": alone(oscillator),
    "four states, drift": alone(drifting),
    "heater": alone(heater),
    "building": building,
}
CURVES = tuple(PLANTS)[:4]


class Faults(NamedTuple):
    """Faults from noon on: a bias of the first sensor, and the share of its effect that an actuator loses."""

    bias: float
    loss: float


JUDGED = {
    "heater": Faults(3.0, 0.25),
    "building": Faults(0.6, 0.4),
    "two tanks": Faults(0.08, 0.2),
    "four states, drift": Faults(0.25, 0.3),
}
"""The plants of the table."""


def days(plant: str, count: int, seed: int, loss: float = 0.0) -> Day:
    """Return (u (count, T, m), y (count, T, p)). loss: of what the input does, from noon on."""
    acts = np.where(np.arange(T) < NOON, 1.0, 1 - loss)
    return PLANTS[plant](np.random.default_rng(seed), acts, count)


def trial(plant: str, count: int, seed: int) -> dict[str, float]:
    """Return the factor of one fit to so many days, and the shares of FRESH days that need more."""
    model = jb.fit(list(zip(*days(plant, count, seed), strict=True)), horizon=HORIZON)
    smallest = [model.check.smallest[name] for name in model.outputs]
    relations = jb.parity_relations(model.replace(noise=smallest, resolution=0, extrapolation=None))
    need, _, _ = needs(relations, days(plant, FRESH, 10_000 + seed))
    worst, factor = np.nanmax(need, 1), model.check.factor
    factors = {"beyond it": factor, "with safety": 1.25 * factor, "safety alone": 1.25}
    return {"factor": factor} | {name: float((worst > most).mean()) for name, most in factors.items()}


def factors(repeats: int) -> None:
    """Measure the factors, and print their table."""
    rows = []
    for plant in CURVES:
        for count in DAYS[:3]:
            trials = [trial(plant, count, 100 * count + r) for r in range(repeats)]
            means = {name: np.mean([one[name] for one in trials]) for name in trials[0]}
            rows.append((f"{plant}, {count}", *(f"{mean:.3f}" for mean in means.values())))
    table(("plant, days", *means), rows)


def needs(model: jb.LinearSystem, day: Day) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (need, whether it is a FAULT, whether it lies outside of training) of all windows (count, T)."""
    found = jb.detect(model, *day, margins="exact")
    need = np.where(found.status == jb.Status.MISSING, np.nan, 1 - found.margin)
    return need, found.status == jb.Status.FAULT, found.outside > 0


def fitted(plant: str, count: int, seed: int, unseen: int = 22, **options) -> tuple:
    """Return (model, (u, y) of days that it has not seen, their numbers): fitted to so many days of 30."""
    u, y = days(plant, 30, seed)
    order = np.random.default_rng(seed).permutation(30)
    seen, rest = order[:count], order[count : count + unseen]
    model = jb.fit([(u[i], y[i]) for i in seen], **options)
    return model, (u[rest], y[rest]), rest


def judged(plant: str, count: int, seed: int, unseen: int = 22, **options) -> dict[str, float]:
    """Return the figures of one fit to so many days of 30, on so many of the others."""
    model, (u, y), rest = fitted(plant, count, seed, unseen, **options)
    need, fault, out = needs(model, (u, y))
    tested = ~np.isnan(need)
    worst = np.nanmax(need, 1)

    def share(those: np.ndarray) -> float:
        return float(fault[those].mean()) if those.any() else 0.0

    figures = {
        "factor": model.check.factor,
        "need, median": float(np.median(worst)),
        "worst": float(worst.max()),
        "days with an alarm": float(fault.any(1).mean()),
        "healthy": share(tested),
        "inside": share(tested & ~out),
        "outside": share(tested & out),
        "worst inside": float(need[tested & ~out].max(initial=0)),
        "windows outside": float(out[tested].mean()),
    }
    biased = y.copy()
    biased[:, NOON:, 0] += JUDGED[plant].bias
    weak = tuple(x[rest] for x in days(plant, 30, seed, JUDGED[plant].loss))
    for name, day in {"bias": (u, biased), "loss": weak}.items():
        more, fault, _ = needs(model, day)
        tested = ~np.isnan(more[:, NOON:])
        figures[name] = float(fault[:, NOON:][tested].mean())
        figures[f"{name}, at zero"] = float((more[:, NOON:][tested] > worst.max()).mean())
    return figures


def row(plant: str, count: int, fits: list[dict[str, float]]) -> tuple[str, ...]:
    """Return the row of the table of fits to so many days: means, of days above 1 with their error."""
    mean = {name: float(np.nanmean([one[name] for one in fits])) for name in fits[0]}
    alarms = np.array([one["days with an alarm"] for one in fits])
    error = alarms.std(ddof=1) / np.sqrt(len(alarms)) if len(alarms) > 1 else np.nan
    numbers = [f"{mean[name]:.2f}" for name in ("factor", "need, median", "worst")]
    numbers += [f"{alarms.mean():.2f} +- {error:.2f}", f"{1 / (count + 1):.2f}"]
    numbers += [f"{mean[name]:.3f}" for name in ("healthy", "inside", "outside")]
    numbers += [f"{mean[name]:.2f}" for name in ("bias", "bias, at zero", "loss", "loss, at zero")]
    return f"{plant}, {count}", *numbers


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


def curves() -> None:
    """Measure and draw what is seen of a bias."""
    found = {plant: power(plant, 5, 11) for plant in CURVES}
    for plant, seen in found.items():
        print(plant, {name: np.round(x, 3).tolist() for name, x in seen.items()}, flush=True)
    timing.save("tomorrow_curves", {"sizes": SIZES, "power": found})
    draw(found, Path(__file__).parent / "figures" / "tomorrow.png")


def main() -> None:
    """Measure, print the table and write the file."""
    if "--curves" in sys.argv:
        curves()
        return
    if "--factors" in sys.argv:
        factors(timing.option("--repeats", 6))
        return
    repeats, unseen = timing.option("--repeats", 3), timing.option("--unseen", 22)
    counts, plants = DAYS, JUDGED
    if "--quick" in sys.argv:
        repeats, unseen, counts, plants = 1, 4, DAYS[:1], {"heater": JUDGED["heater"]}
    fits: dict[str, list[dict[str, float]]] = {}
    for plant in plants:
        for count in counts:
            found = [judged(plant, count, 100 * count + r, unseen) for r in range(repeats)]
            fits[f"{plant}, {count}"] = found
            print(row(plant, count, found), flush=True)
    every = [one for found in fits.values() for one in found]
    correlation = rank_correlation(*(np.array([one[name] for one in every]) for name in ("factor", "worst")))
    promise = {}
    for count in counts:
        alarms = [one["days with an alarm"] for plant in plants for one in fits[f"{plant}, {count}"]]
        promise[count] = {"days with an alarm": float(np.mean(alarms)), "promise": 1 / (count + 1)}
    timing.save("tomorrow", {"fits": fits, "promise": promise, "rank correlation": correlation})
    rows = [row(plant, count, fits[f"{plant}, {count}"]) for plant in plants for count in counts]
    table(HEADER, rows)


if __name__ == "__main__":
    main()
