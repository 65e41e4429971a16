"""jaxbound beside an isolation forest and fixed thresholds, on the same healthy training data and the same
unseen data.

TCLab: trained on mimo_prbs_3s and the first half of mimo_hybrid_3s; unseen: its second half, as it is and
with jumps of one sensor at every onset. Air-handling unit: trained on the occupied hours of 9/20 and 9/21;
unseen: 9/23, healthy, and 9/12, a heating coil's valve that leaks. Nothing but the training data is known to
any method, beside the options printed here, none of which looks at a fault.

    jaxbound    fit, then tune: FAULT windows of horizon + 1 samples
    forest      scikit-learn's isolation forest, default settings, on the same windows, all signals in a row;
                contamination as stated; the mean of five seeds
    3 sigma     one-step error of a least-squares ARX of the same order and signals, outside 3 standard
    deviations of the training's
    largest     the same, outside the largest of the training's times the safety factor that jaxbound has: the
    rule that its bounds follow

A jump counts as seen if an alarm comes within the stated number of samples from its onset; "no jump" is how
often one comes there without
any: what a method that cries wolf catches by chance.

python -m benchmarks.contrast
"""

import sys
import time
from pathlib import Path

import numpy as np

import jaxbound as jb
from benchmarks import timing
from jaxbound.recordings.read import read_signals
from jaxbound.sets.floats.status import Status
from jaxbound.studies.assessment import peers
from jaxbound.studies.identification.regression import windows_without

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
SEEDS = range(5)
NEAR = 5  # samples

TCLAB = dict(
    inputs=["Heater 1", "Heater 2"],
    outputs=["Temperature 1", "Temperature 2"],
    order=2,
    horizon=14,
    direct=False,
    safety=1.25,
)
OCCUPIED = "`Occupancy Mode Indicator`==1"
FAN, COOL = "`AHU: Supply Air Fan Speed Control Signal`", "`AHU: Cooling Coil Valve Control Signal`"
SUPPLY, MIXED = "`AHU: Supply Air Temperature`", "`AHU: Mixed Air Temperature`"
AHU = dict(
    inputs=[
        ("heat", "AHU: Heating Coil Valve Control Signal"),
        ("cool", COOL[1:-1]),
        ("cool2", f"= {COOL}*{COOL}"),
        ("fan", FAN[1:-1]),
        ("Tmix", MIXED[1:-1]),
        ("Tret", "AHU: Return Air Temperature"),
    ],
    outputs=[("heating", f"= {FAN}*({SUPPLY}-{MIXED})")],
    order=2,
    horizon=30,
    direct=True,
    safety=1.25,
)


def names(signals):
    return [s if isinstance(s, str) else s[0] for s in signals]


def tclab():
    """Return (training recordings, hybrid run, number of its first unseen sample); recordings are (u, y,
    starts).
    """
    files = [SHARED / "tclab" / f"mimo_{name}_3s.csv" for name in ("prbs", "hybrid")]
    prbs, hybrid = ((r.u, r.y, r.starts) for r in read_signals(files, TCLAB["inputs"], TCLAB["outputs"]))
    half = len(hybrid[1]) // 2
    return [prbs, (hybrid[0][:half], hybrid[1][:half], np.zeros(0, int))], hybrid, half


def ahu(day):
    """Return (u, y, starts) of the occupied hours of a day."""
    where = f"{OCCUPIED} and '2017-09-{day}' <= Datetime < '2017-09-{day + 1}'"
    (r,) = read_signals(
        SHARED / "ahu" / "szvav_four_days.csv", AHU["inputs"], AHU["outputs"], {"where": where}
    )
    kept = np.flatnonzero(~r.excluded)
    part = slice(kept[0], kept[-1] + 1)
    return r.u[part], r.y[part], [k - part.start for k in r.starts if part.start < k < part.stop]


class Bounds:
    """jaxbound: fit, tune, detect."""

    def __init__(self, training, options):
        o = options
        start, cpu = time.perf_counter(), time.process_time()
        about = dict(inputs=names(o["inputs"]), outputs=names(o["outputs"]))
        model = jb.fit(
            [(u, y) for u, y, _ in training],
            order=o["order"],
            horizon=o["horizon"],
            direct=o["direct"],
            safety=o["safety"],
            **about,
        )
        tuned = jb.tune(jb.parity_relations(model), training, safety=o["safety"])
        self.relations = jb.parity_relations(tuned.model)
        self.about = {
            "noise": dict(zip(tuned.model.outputs, map(float, tuned.model.noise), strict=True)),
            "kind": model.check.method,
            "seconds": time.perf_counter() - start,
            "cpu seconds": time.process_time() - cpu,
        }

    def alarms(self, u, y, starts=()):
        """Return (..., T) bool, True where FAULT. Args: u (T, m), y (..., T, p)."""
        return jb.detect(self.relations, u, y, starts=starts).status == Status.FAULT


class Forest:
    """An isolation forest on windows."""

    def __init__(self, training, options, contamination, seed):
        self.horizon = options["horizon"]
        self.forest = peers.Forest([samples(*one) for one in training], self.horizon, contamination, seed)

    def alarms(self, u, y, starts=()):
        """Return (..., T) bool."""
        batch = y.reshape(-1, *y.shape[-2:])
        return np.stack([self.needs(u, one) > 1 for one in batch]).reshape(y.shape[:-1])

    def needs(self, u, y):
        """Return (T,): windows across gaps too, `complete` leaves them out."""
        return self.forest.needs(samples(u, y, ()))


class Threshold:
    """A fixed threshold on the one-step error of a least-squares ARX model with a constant."""

    def __init__(self, training, options, rule):
        self.errors = peers.OneStep([samples(*one) for one in training], options["order"], options["direct"])
        self.limit = 3 * self.errors.sigma if rule == "3 sigma" else options["safety"] * self.errors.largest

    def alarms(self, u, y, starts=()):
        """Return (..., T) bool."""
        return (abs(self.errors.errors(u, y)) > self.limit).any(-1)


def complete(y, starts, horizon):
    """Return (T,) bool: a window of horizon + 1 samples ends here, across no gap and with all outputs."""
    ends = np.zeros(len(y), bool)
    ends[horizon + windows_without(np.isnan(y).any(1), starts, horizon)] = True
    return ends


def samples(u, y, starts):
    return peers.Samples(u, y, np.asarray(starts, int))


def methods(training, options):
    """Yield (name, list of detectors whose figures are averaged)."""
    yield "jaxbound", [Bounds(training, options)]
    for contamination in ("auto", 0.001):
        yield f"forest, {contamination}", [Forest(training, options, contamination, seed) for seed in SEEDS]
    for rule in ("3 sigma", "largest"):
        yield rule, [Threshold(training, options, rule)]


def jumps(detector, u, y, first, horizon, output, size):
    """Return {within NEAR, within a window: share of onsets from sample `first` on that are seen; median
    delay; share without a jump}.
    """
    onsets = np.arange(first, len(y) - NEAR + 1)
    faulty = np.repeat(y[None], len(onsets), 0)
    faulty[..., output] += size * (np.arange(len(y)) >= onsets[:, None])
    at, beyond = onsets[:, None] + np.arange(horizon + 1), ((0, 0), (0, horizon))
    alarm = np.take_along_axis(np.pad(detector.alarms(u, faulty), beyond), at, 1)
    healthy = np.pad(detector.alarms(u, y)[None], beyond)[0][at]
    delay = np.where(alarm.any(1), alarm.argmax(1) + 1.0, np.inf)
    return {
        "onsets": len(onsets),
        "near": alarm[:, :NEAR].any(1).mean(),
        "window": alarm.any(1).mean(),
        "delay": float(np.median(delay)),
        "no jump": healthy[:, :NEAR].any(1).mean(),
    }


def mean(rows):
    return {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}


def percent(x):
    return f"{100 * x:.3g} %"


def table(header, rows):
    widths = [max(len(str(row[i])) for row in (header, *rows)) for i in range(len(header))]
    for row in (header, *rows):
        print(
            "  ".join(
                str(cell).ljust(w) if i == 0 else str(cell).rjust(w)
                for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            )
        )
    print()


def main():
    figures, shown = {}, {}
    training, (u, y, starts), half = tclab()
    ends = complete(y, starts, TCLAB["horizon"]) & (np.arange(len(y)) >= half + TCLAB["horizon"])
    rows, found = [], {}
    for name, detectors in methods(training, TCLAB):
        f = getattr(detectors[0], "about", {}) | {
            "false alarms": np.mean([d.alarms(u, y)[ends].mean() for d in detectors])
        }
        for output, label in enumerate(("T1", "T2")):
            for size in (2.0, 1.0):
                f[f"{label} +{size:g}"] = mean(
                    [jumps(d, u, y, half, TCLAB["horizon"], output, size) for d in detectors]
                )
        found[name], first = f, f["T1 +2"]
        rows.append(
            (
                name,
                percent(f["false alarms"]),
                percent(first["no jump"]),
                percent(first["near"]),
                f"{first['delay']:g}",
                *(
                    percent(f[jump][within])
                    for jump, within in (
                        ("T1 +1", "near"),
                        ("T1 +1", "window"),
                        ("T2 +2", "near"),
                        ("T2 +1", "near"),
                    )
                ),
            )
        )
        shown["TCLab", name] = (detectors[0].alarms(u, y) & ends)[half:]
    print(
        f"TCLab: {int(ends.sum())} unseen healthy windows; jumps at {len(y) - NEAR + 1 - half} onsets, seen "
        f"within {NEAR} samples"
    )
    table(
        (
            "method",
            "false alarms",
            "no jump",
            "T1 +2",
            "median delay",
            "T1 +1",
            "T1 +1 in a window",
            "T2 +2",
            "T2 +1",
        ),
        rows,
    )
    figures["tclab"] = {"options": TCLAB, "windows": int(ends.sum()), "methods": found}

    training, unseen = [ahu(20), ahu(21)], {"healthy": ahu(23), "faulty": ahu(12)}
    rows, found = [], {}
    for name, detectors in methods(training, AHU):
        f = dict(getattr(detectors[0], "about", {}))
        for day, (u, y, starts) in unseen.items():
            ends = complete(y, starts, AHU["horizon"])
            alarm = [d.alarms(u, y, starts) for d in detectors]
            f[day] = float(np.mean([a[ends].mean() for a in alarm]))
            first = [np.flatnonzero(a & ends) for a in alarm]
            f[f"{day} first"] = float(np.median([x[0] if len(x) else np.inf for x in first]))
            shown[f"AHU {day}", name] = alarm[0] & ends
        found[name] = f
        rows.append((name, percent(f["healthy"]), percent(f["faulty"]), f"{f['faulty first']:g} min"))
    print(
        "Air-handling unit, occupied hours: 9/23 healthy, 9/12 with a leaking valve; minutes to the first "
        "alarm"
    )
    table(("method", "false alarms 9/23", "alarms 9/12", "first alarm 9/12"), rows)
    figures["ahu"] = {"options": AHU, "methods": found}
    picture(shown)
    sys.stdout.flush()
    timing.save("contrast", figures)


def picture(shown):
    """Write figures/contrast.png: where each method raises an alarm."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    titles = {
        "TCLab": "TCLab, second half of the hybrid run, healthy: every mark is a false alarm",
        "AHU healthy": "Air-handling unit, 9/23, occupied hours, healthy: every mark is a false alarm",
        "AHU faulty": "Air-handling unit, 9/12, occupied hours, leaking valve: blank is missed",
    }
    names = list(dict.fromkeys(name for _, name in shown))
    fig = Figure((11, 6.5))
    FigureCanvasAgg(fig)
    for ax, (data, title) in zip(fig.subplots(3, 1), titles.items(), strict=True):
        for i, name in enumerate(names):
            alarm = shown[data, name]
            ax.vlines(
                np.flatnonzero(alarm),
                i - 0.38,
                i + 0.38,
                color="#d55e00" if data == "AHU faulty" else "#333333",
                lw=0.9,
            )
        ax.set_yticks(range(len(names)), names)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_xlim(0, len(shown[data, names[0]]))
        ax.set_title(title, loc="left", fontsize=10)
        ax.set_xlabel("sample")
    fig.tight_layout()
    folder = Path(__file__).parent / "figures"
    folder.mkdir(exist_ok=True)
    fig.savefig(folder / "contrast.png", dpi=110)


if __name__ == "__main__":
    main()
