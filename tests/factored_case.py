"""What tests of noise times a factor share: random models, recordings whose errors lie at vertices of their
bounds, and linear programs whose bounds follow the factors.
"""

import numpy as np
import pandas as pd
from scipy.optimize import linprog

import jaxbound as jb

FACTORS = {
    "1 + 0.5*abs(fan - 0.6)": lambda fan, load: 1 + 0.5 * abs(fan - 0.6),
    "maximum(0.2, minimum(load, 3))": lambda fan, load: np.maximum(0.2, np.minimum(load, 3)),
    "sqrt(abs(load)) + 2 * (fan > 0)": lambda fan, load: np.sqrt(abs(load)) + 2 * (fan > 0),
    "fan < 0.5": lambda fan, load: 1.0 * (fan < 0.5),
}


def case(rng, n, p, horizon=None, lags=None, g=0, mean=None):
    """Return (a model, its window, functions of its factors by output)."""
    rounded = lambda *shape: np.round(0.5 * rng.normal(size=shape), 2)
    A = rounded(n, n) + 0.4 * np.eye(n)
    A = np.round(A * min(1.0, 0.95 / max(abs(np.linalg.eigvals(A)).max(), 0.1)), 3)
    texts = rng.permutation(list(FACTORS))[:p]
    outputs = [f"T{i}" for i in range(p)]
    chosen = {outputs[i]: str(texts[i]) for i in range(p) if i == 0 or rng.random() < 0.5}
    model = jb.LinearSystem(
        A,
        rounded(n, 1),
        rounded(p, n) + np.eye(p, n),
        rounded(p, 1) if rng.random() < 0.5 else None,
        noise=np.round(rng.uniform(0.1, 0.5, p), 2),
        tolerance=np.round(rng.choice([0, 0.05], p), 2),
        resolution=rng.choice([0, 0.01], p),
        disturbance=(rounded(n, g), np.round(rng.uniform(0.02, 0.1, g), 2)) if g else None,
        inputs="fan",
        outputs=outputs,
        offset={"u": 0.25, "y": np.round(rng.normal(size=p), 1)},
        columns={"fan": "Fan [%]"},
        times=chosen,
    )
    if mean:  # of the first output, which has a factor, and whose samples weigh differently
        weights = [1, *[2] * (mean - 2), -1]
        averages = {"T0": [(weights, 0.6 * (2 * mean - 2) * float(model.noise[0]))]}
        model = model.replace(tolerance=[0, *model.tolerance[1:]], averages=averages)
    window = {"lags": lags} if lags else {"horizon": horizon}
    return model, window, {name: FACTORS[text] for name, text in chosen.items()}


def floats(matrix):
    rows = [list(map(float, row)) for row in matrix]
    return np.array(rows).reshape(len(rows), -1)


def recording(rng, model, factors, samples, excess):
    """Return (table, factors (T, p)) of a plant whose errors lie at vertices of bounds, times excess."""
    A, B, C, D, G = (floats(getattr(model, name)) for name in "ABCDG")
    fan, load = rng.uniform(0, 1.2, samples), rng.normal(0, 2, samples)
    f = np.ones((samples, model.p))
    for name, function in factors.items():
        f[:, model.outputs.index(name)] = function(fan, load)
    x, u, y = rng.normal(size=model.n), fan - float(model.offset["u"][0]), np.empty((samples, model.p))
    sign = lambda: rng.choice([-1.0, 1.0], model.p)
    for k in range(samples):
        t = C @ x + D[:, 0] * u[k]
        error = (np.array(model.noise, float) * f[k] + np.array(model.resolution, float)) * sign()
        y[k] = (1 + excess * sign() * np.array(model.tolerance, float)) * t + excess * error
        w = np.array([rng.choice([float(lo), float(hi)]) for lo, hi in model.disturbance])
        x = A @ x + B[:, 0] * u[k] + (G @ w if model.g else 0)
    y += np.array(model.offset["y"], float)
    table = pd.DataFrame({"Fan [%]": fan, "load": load})
    for i, name in enumerate(model.outputs):
        table[name] = y[:, i]
    return table, f


def gauge(model, window, u, y, f, unit):
    """Return the least t such that all half-widths times t explain samples u (s+1, 1), y, f (s+1, p); None
    where no sample is looked at. unit: roundoff of the samples.
    """
    A, B, C, D, G = (floats(getattr(model, name)) for name in "ABCDG")
    s, (n, p, g) = len(y) - 1, (model.n, model.p, model.g)
    lags = window.get("lags", range(s + 1))
    columns = n + s * g
    state, drive = np.eye(n, columns), np.zeros(n)  # x = state z + drive
    rows, sides, true = [], [], []

    def between(row, value, middle, half):
        for sign in (1, -1):  # sign (row z + value - middle) <= t half
            rows.append([*(sign * row), -half])
            sides.append(sign * (middle - value))

    for k in range(s + 1):
        deviation = u[k, 0] - float(model.offset["u"][0])
        true.append((C[0] @ state, C[0] @ drive + D[0, 0] * deviation))
        for i in range(p):
            if s - k not in lags or np.isnan(y[k, i]):
                continue
            sigma, d = float(model.tolerance[i]), y[k, i] - float(model.offset["y"][i])
            noise = float(model.noise[i]) * f[k, i]
            rho = noise + float(model.resolution[i]) + 4 * unit * (np.nanmax(abs(y[:, i])) + noise)
            ends = [(d + e) / (1 + theta) for e in (-rho, rho) for theta in (-sigma, sigma)]
            middle, half = (max(ends) + min(ends)) / 2, (max(ends) - min(ends)) / 2
            value = C[i] @ drive
            if D[i, 0]:
                value = value + D[i, 0] * deviation
            between(C[i] @ state, value, middle, half)
        if k < s:
            state, drive = A @ state, A @ drive + B[:, 0] * deviation
            if g:
                state[:, n + k * g : n + (k + 1) * g] += G
    for average in model.averages:
        weights, d = np.array(average.weights, float), y[:, 0] - float(model.offset["y"][0])
        size, most = np.abs(weights).sum(), float(model.noise[0]) * f[:, 0].max()
        slip = float(model.resolution[0]) + 4 * unit * (np.nanmax(abs(y[:, 0])) + most)
        for first in range(s + 2 - len(weights)):
            run = slice(first, first + len(weights))
            half = float(average.bound) * (np.abs(weights) @ f[run, 0]) / size + size * slip
            terms = list(zip(weights, true[run], strict=True))
            if not np.isnan(d[run]).any():
                row, value = (sum(w * one[part] for w, one in terms) for part in (0, 1))
                between(np.pad(row, (0, columns - len(row))), value, weights @ d[run], half)
    for j in range(s * g):
        lo, hi = map(float, model.disturbance[j % g])
        between(np.eye(columns)[n + j], 0.0, (lo + hi) / 2, (hi - lo) / 2)
    if not rows:
        return None
    cost = np.append(np.zeros(columns), 1.0)
    ends = [(None, None)] * columns + [(0, None)]
    best = linprog(cost, rows, sides, bounds=ends, method="highs")
    assert best.status == 0, best.message
    return best.fun
