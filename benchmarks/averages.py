"""What bounds of means bring on recordings of real plants: faults seen at no false alarm, with and without
them.

    python -m benchmarks.averages        some minutes of one core; needs the recordings in the shared folder

Data and training are those of `benchmarks.contrast`. A model is fitted with the bound of each error alone, or
with that of the mean of so many errors in a row beside it (`fit(average=)`); all bounds are then widened
together by the least factor with which no window of the unseen healthy recording is a FAULT. So every line
has no false alarm, neither in training nor on the unseen recording, and its `factor` says how far that
recording went beyond the bounds of training: one that had to be known.

The heater stands twice: fitted from nothing, and as the model of its physics in the shared folder
(`benchmarks.memory`), with bounds found in the same way.

TCLab: the unseen half of a recording, with a jump of 1 or 2 degC on one sensor (share of onsets seen within
ten samples), a bias from the beginning on (share of windows), and a ramp of 0.05 degC a sample (what it has
reached when it is seen). Air-handling unit: windows of the day whose heating valve leaks, and of the unseen
healthy day with a bias on the heat (fan share times degF).
"""

from functools import partial

import jax
import numpy as np

import jaxbound as jb
from benchmarks import contrast, memory, timing
from jaxbound.studies.identification.means import smallest_means

NEAR = 10
CASES = {
    "15 samples": (14, (None, 8, 15)),
    "31 samples": (30, (None, 8, 16)),
    "61 samples": (60, (None, 16, 32)),
}


def fitted(training: list, options: dict, horizon: int, average: int | None):
    """Return (model, need): need(u, y, starts) is the factor on the bounds with which each window is
    explained, NaN for none.
    """
    about = dict(
        inputs=contrast.names(options["inputs"]),
        outputs=contrast.names(options["outputs"]),
        direct=options["direct"],
    )
    model = jb.fit(
        training, order=options["order"], horizon=horizon, safety=1.0, average=average, held_out=0.3, **about
    )
    relations = jb.parity_relations(model)
    return (
        model,
        lambda u, y, starts=(): (
            1
            - np.asarray(
                jb.detect(
                    relations, np.broadcast_to(u, (*y.shape[:-1], u.shape[-1])), y, starts=starts
                ).margin
            )
        ),
    )


def physics(training: list, horizon: int, average: int | None):
    """Return the same for the heater's physics: the smallest bounds of training, and of the means beside
    them.
    """
    model = memory.heater(memory.recordings()[0], 0, 0).replace(horizon=horizon)
    least = lambda relations: [1 - np.asarray(jb.detect(relations, u, y).margin) for u, y, _ in training]
    bound = max(float(np.nanmax(x)) for x in least(jb.parity_relations(model)))
    bounds = np.full(model.p, bound)
    if average is not None:
        fine = lambda relations: all(
            not (np.asarray(jb.detect(relations, u, y).status) == jb.Status.FAULT).any()
            for u, y, _ in training
        )
        means = smallest_means(model, bounds, average, fine, lambda share: None)
        model = model.replace(
            averages={name: {average: x} for name, x in zip(model.outputs, means, strict=True)}
        )
    model = model.replace(noise=bound)
    relations = jb.parity_relations(model)
    return (
        model,
        lambda u, y, starts=(): (
            1 - np.asarray(jb.detect(relations, np.broadcast_to(u, (*y.shape[:-1], 2)), y).margin)
        ),
    )


def row(model, need, training, healthy) -> tuple[dict, float]:
    """Return what a model says of itself, and the factor with which neither training nor the healthy
    recording has a FAULT.
    """
    factor = max(float(np.nanmax(need(*r))) for r in (*training, healthy))
    means = {a.signal: float(a.bound) for a in model.averages}
    noise = {
        name: float(x + r) for name, x, r in zip(model.outputs, model.noise, model.resolution, strict=True)
    }
    return {"bounds": noise, "means": means, "factor": factor}, factor


def tclab(horizon: int, average: int | None, known: bool = False) -> dict:
    """Return what is seen of faults of the heater's sensors; known: by its physics."""
    training, (u, y, _), half = contrast.tclab()
    u, y = u[half:], y[half:]
    model, need = (
        physics(training, horizon, average) if known else fitted(training, contrast.TCLAB, horizon, average)
    )
    out, factor = row(model, need, training, (u, y, ()))
    limit, k = factor * (1 + 1e-9), np.arange(len(y))
    seen = lambda wrong: need(u, y + wrong) > limit
    for i, name in enumerate(("T1", "T2")):
        one = np.eye(2)[i]
        found: dict = {}
        onsets = np.arange(horizon, len(y) - NEAR, 2)
        for size in (1, 2):
            hits = seen(size * (k >= onsets[:, None])[..., None] * one)
            found[f"jump {size}"] = float(
                np.mean([hits[j, o : o + NEAR].any() for j, o in enumerate(onsets)])
            )
        for size in (1, 2, 4, 8):
            found[f"always {size}"] = float(seen(size * np.ones((len(y), 1)) * one)[horizon:].mean())
        starts = np.arange(0, 40, 5)
        hits = seen(0.05 * np.maximum(0, k - starts[:, None])[..., None] * one)
        reached = [
            0.05 * (row.argmax() - a) if row.any() else np.inf for row, a in zip(hits, starts, strict=True)
        ]
        found["ramp"] = float(np.median(reached))
        out[name] = {what: x if np.isfinite(x) else None for what, x in found.items()}
    return out


def air(horizon: int, average: int | None) -> dict:
    """Return the share of windows of a leaking valve's day that are a FAULT."""
    training, healthy, leak = [contrast.ahu(20), contrast.ahu(21)], contrast.ahu(23), contrast.ahu(12)
    model, need = fitted(training, contrast.AHU, horizon, average)
    out, factor = row(model, need, training, healthy)
    share = lambda told: float((told[np.isfinite(told)] > factor * (1 + 1e-9)).mean())
    u, y, starts = healthy
    return (
        out
        | {"leak": share(need(*leak))}
        | {f"always {size}": share(need(u, y + size, starts)) for size in (0.5, 1, 2)}
    )


def table(results: dict) -> list[str]:
    """Return the lines of two Markdown tables."""
    shown = lambda x: "never" if x is None else f"{x:.2g}"
    sizes = "jump 1, 2 | always 2, 4, 8 | ramp"
    lines = [
        f"| heater | window | mean of | widened by | T1 {sizes} | T2 {sizes} |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for plant, name, r in ((who, *pair) for who in ("fitted", "physics") for pair in results[who].items()):
        cells = [plant, *name.split(", "), f"{r['factor']:.2f}"]
        for t in ("T1", "T2"):
            cells += [
                " / ".join(f"{100 * r[t][f'{what} {size}']:.0f} %" for size in sizes)
                for what, sizes in (("jump", (1, 2)), ("always", (2, 4, 8)))
            ]
            cells.append(shown(r[t]["ramp"]))
        lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "| air-handling unit, window | mean of | widened by | leak | always 0.5, 1, 2 |",
        "|---|---|---|---|---|",
    ]
    for name, r in results["air-handling unit"].items():
        cells = [*name.split(", "), f"{r['factor']:.2f}", f"{100 * r['leak']:.0f} %"]
        cells.append(" / ".join(f"{100 * r[f'always {size}']:.0f} %" for size in (0.5, 1, 2)))
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Measure, print the tables and write the file."""
    jax.config.update("jax_enable_x64", True)
    plants = {"fitted": tclab, "physics": partial(tclab, known=True), "air-handling unit": air}
    results: dict = {plant: {} for plant in plants}
    for window, (horizon, averages) in CASES.items():
        for average in averages:
            name = f"{window}, {average or 'none'}"
            for plant, measure in plants.items():
                results[plant][name] = measure(horizon, average)
                print(plant, name, results[plant][name], flush=True)
    print("\n".join(table(results)))
    timing.save("averages", results)


if __name__ == "__main__":
    main()
