"""The whole way on recordings of real plants, by the documented commands: fit, detect, evaluate.

    heater    the laboratory with two heaters: trained on mimo_prbs_3s and the first half of mimo_hybrid_3s;
              unseen: its second half, as it is and with biases and ramps of one sensor from several onsets on
    ahu       an air-handling unit in occupied hours: trained on two healthy days; unseen: a third one, as it
              is and with a bias of the supply air temperature, and a day on which the heating valve leaks
    engine    42 residuals of a turbocharged engine in 8 modes, with the published structure of which fault
              moves which residual: bounds are 1.25 times the hull of the first half of the healthy samples
    skab      the Skoltech Anomaly Benchmark: trained on its folder anomaly-free; unseen: all other files

Bounds are those that `fit` writes, without `tune`, as in docs/monitor.md; a delay counts from the onset of a
fault, those that are not seen as never. Of
skab also F1, the false alarm rate FAR and the missed alarm rate MAR over the rows of all files, from their
column `anomaly`: FAR = FP/(FP + TN), MAR = FN/(FN + TP), F1 = 2 TP/(2 TP + FP + FN). A row is an alarm where
its window is a FAULT; one that no verdict covers is none.

Of the engine each sample is judged by its residuals alone. A fault is a candidate where every residual that
is violated has it in its row ("violated"), or where those that are violated are its column, no more and no
less ("signature"): isolated right with the true one alone, ambiguous with others, wrong without it.
This is `jb.evaluate` and no monitor: its tests look at one plant each in their own way, and no field of a
model file holds a structure of residuals that were worked out elsewhere.

python -m benchmarks.plants heater|ahu|engine [--data FOLDER]
python -m benchmarks.plants skab --data FOLDER [--inputs A,B] [--outputs C,D] [--every 5s] [--order 2]
    [--horizon 15]
"""

import argparse
import contextlib
import csv
import io
import json
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd

import jaxbound as jb
from benchmarks import timing
from benchmarks.contrast import SHARED, percent, table
from jaxbound.cli import main as command_line
from jaxbound.sets.floats.status import Status

HALF = 101  # samples of the heater's second recording that are seen
ONSETS = range(20, 81, 10)  # of faults in those that are not
FAULTS = {
    **{f"T{n} + {size:g} degC": (n, size, 0.0) for n in (1, 2) for size in (1.0, 2.0, 3.0)},
    **{f"T{n} + {slope:g} degC a sample": (n, 0.0, slope) for n in (1, 2) for slope in (0.05, 0.1)},
}
HEATERS = "--inputs", "Q1=Heater 1,Q2=Heater 2", "--outputs", "T1=Temperature 1,T2=Temperature 2"

OCCUPIED = "Occupancy Mode Indicator"  # the hours that count: faults are there from the first of them on
SUPPLY = "AHU: Supply Air Temperature"
FAN, COOLING = "`AHU: Supply Air Fan Speed Control Signal`", "`AHU: Cooling Coil Valve Control Signal`"
UNIT = (
    "--inputs",
    f"heat=`AHU: Heating Coil Valve Control Signal`,cool={COOLING},cool2={COOLING}**2,fan={FAN},"
    "Tmix=`AHU: Mixed Air Temperature`,Tret=`AHU: Return Air Temperature`",
    "--outputs",
    f"flow={FAN}*(`{SUPPLY}`-`AHU: Mixed Air Temperature`)",
    *("--recipe", "direct=true"),
    *("--where", f"`{OCCUPIED}`==1 and `AHU: Supply Air Fan Status`==1"),
)

ENGINE_SAFETY = 1.25
KINDS = "right", "ambiguous", "wrong"
ENGINE_HEADER = ("mode", "samples", "FAULT", *KINDS, *(f"{kind}, signature" for kind in KINDS))
HEADER = "recording", "alarms", "of windows", "faults seen", "median delay, samples"


class Way:
    """The commands that were run in a folder, and their seconds: {command: (of the clock, of processors)}."""

    def __init__(self, folder):
        self.folder, self.seconds = Path(folder), {}
        self.model = self.folder / "plant.toml"

    def command(self, *words, codes=(0,)):
        """Run one command line; return what it printed."""
        words, printed = [str(word) for word in words], io.StringIO()
        start, cpu = time.perf_counter(), time.process_time()
        with contextlib.redirect_stdout(printed):
            code = command_line.main(words)
        if code not in codes:
            sys.exit(f"jaxbound {words[0]} ended with exit code {code}")
        before = self.seconds.get(words[0], (0, 0))
        spent = time.perf_counter() - start, time.process_time() - cpu
        self.seconds[words[0]] = tuple(a + b for a, b in zip(before, spent, strict=True))
        return printed.getvalue()

    def fit(self, files, *options):
        """Find the model and its bounds, print what was found."""
        print(self.command("fit", *files, *options, "--out", self.model), flush=True)

    def detect(self, file):
        """Return the verdicts of a recording, columns time and status among others."""
        report = self.folder / "report"
        self.command("detect", self.model, file, "--out", report, codes=(0, 1, 3))
        with open(report / "verdicts.csv") as f:
            return list(csv.DictReader(f))

    def evaluate(self, faulty, *options):
        """Return [counts of a faulty recording] at the bounds as they are."""
        found = json.loads(self.command("evaluate", self.model, "--faulty", *faulty, *options, "--json"))
        return found["models"][str(self.model)]["recordings"]


def healthy_row(name, verdicts):
    """Return a row of the table from the verdicts of a recording without faults."""
    tested = [row["status"] for row in verdicts if row["status"] != "MISSING"]
    return name, percent(tested.count("FAULT") / len(tested)), len(tested), "", ""


def faulty_row(name, cases):
    """Return a row of the table from the counts of recordings with one kind of fault."""
    windows = sum(case["faulty_windows"] for case in cases)
    faults = sum(case["faults"] for case in cases)
    delays = [delay for case in cases for delay in case["delays"]]
    delay = np.median(delays + [np.inf] * (faults - len(delays)))
    shown = f"{delay:g}" if np.isfinite(delay) else "never"
    share = sum(case["faulty_in_alarm"] for case in cases) / windows
    return name, percent(share), windows, f"{len(delays)} of {faults}", shown


def heater(way, data):
    """Return the rows of the table."""
    prbs, hybrid = data / "mimo_prbs_3s.csv", data / "mimo_hybrid_3s.csv"
    header, *rows = hybrid.read_text().splitlines()
    first, second = way.folder / "first.csv", way.folder / "second.csv"
    first.write_text("\n".join([header, *rows[:HALF], ""]))
    second.write_text("\n".join([header, *rows[HALF:], ""]))
    way.fit([prbs, first], *HEATERS)

    whole, files, kinds = pd.read_csv(second, skipinitialspace=True), [], []
    for kind, (sensor, size, slope) in FAULTS.items():
        for onset in ONSETS:
            since = np.arange(len(whole)) - onset
            wrong = np.where(since >= 0, size + slope * (since + 1), 0.0)
            column = f"Temperature {sensor}"
            faulty = whole.assign(**{column: whole[column] + wrong, "faulty": (since >= 0).astype(int)})
            files.append(way.folder / f"fault{len(files)}.csv")
            faulty.to_csv(files[-1], index=False)
            kinds.append(kind)
    grouped = defaultdict(list)
    for kind, case in zip(kinds, way.evaluate(files, "--labels", "faulty"), strict=True):
        grouped[kind].append(case)
    unseen = healthy_row("second half, healthy", way.detect(second))
    return [unseen, *(faulty_row(kind, cases) for kind, cases in grouped.items())]


def ahu(way, data):
    """Return the rows of the table."""
    header, *rows = (data / "szvav_four_days.csv").read_text().splitlines()
    days = {}
    for day in (12, 20, 21, 23):
        days[day] = way.folder / f"{day}.csv"
        days[day].write_text("\n".join([header, *(row for row in rows if row.startswith(f"9/{day}/2017"))]))
    way.fit([days[20], days[21]], *UNIT)

    third, faulty = pd.read_csv(days[23]), {}
    for size in (2, 3, 5):
        name = f"9/23, supply air + {size} degF"
        faulty[name] = way.folder / f"bias{size}.csv"
        third.assign(**{SUPPLY: third[SUPPLY] + size}).to_csv(faulty[name], index=False)
    faulty["9/12, heating valve leaks"] = days[12]
    cases = way.evaluate(faulty.values(), "--labels", OCCUPIED)
    unseen = healthy_row("9/23, healthy", way.detect(days[23]))
    return [unseen, *(faulty_row(name, [case]) for name, case in zip(faulty, cases, strict=True))]


def engine(data):
    """Return the rows of the table of isolation."""
    stored = np.load(data / "residuals.npz", allow_pickle=True)
    residuals, names = stored["res"], [str(name) for name in stored["modes"]]
    mode, structure = stored["mode"], stored["fsm"][:, 1:].astype(bool)
    healthy = np.flatnonzero(mode == 0)
    train, unseen = np.split(healthy, [len(healthy) // 2])
    low, high = residuals[train].min(0), residuals[train].max(0)
    half = ENGINE_SAFETY * (high - low) / 2
    hull = np.stack([(low + high) / 2 - half, (low + high) / 2 + half], 1)
    res = jb.evaluate(residuals, hull, pd.DataFrame(structure.astype(int), columns=names[1:]))
    outside = (residuals < hull[:, 0]) | (residuals > hull[:, 1])
    signature = (outside[:, :, None] == structure).all(1)
    rows = []
    for number, name in enumerate(names):
        here = unseen if number == 0 else np.flatnonzero(mode == number)
        fault = res.status[here] == Status.FAULT
        row = [name, len(here), percent(fault.mean())]
        for candidates in (res.candidates[here], signature[here]):
            row += isolated(candidates[fault], number - 1, len(here))
        rows.append(tuple(row))
    return rows


def isolated(candidates, true, count):
    """Return the shares of samples, of a mode with so many, that are isolated right, ambiguously and wrongly;
    true: number of the fault, -1: none, of which nothing is right.
    """
    if true < 0:
        return ["", "", percent(candidates.any(1).sum() / count)]
    named, alone = candidates[:, true], candidates.sum(1) == 1
    parts = named & alone, named & ~alone, ~named
    return [percent(part.sum() / count) for part in parts]


def skab(way, data, options):
    """Return (rows of the table, F1, FAR and MAR). options: of `fit`."""
    training = sorted(data.rglob("anomaly-free/*.csv"))
    unseen = sorted(set(data.rglob("*/*.csv")) - set(training))
    if not training or not unseen:
        sys.exit(f"{data} needs a folder anomaly-free with CSV files, and others beside it with faults")
    way.fit(training, *options)
    cases, folders = way.evaluate(unseen, "--labels", "anomaly"), defaultdict(list)
    for file, case in zip(unseen, cases, strict=True):
        folders[file.parent.name].append(case)
    dt, truth, alarms = jb.load_model(way.model).dt, [], []
    for file in unseen:
        rows = pd.read_csv(file, sep=";", parse_dates=["datetime"])
        truth.append(rows["anomaly"] == 1)
        alarms.append(alarm_rows(rows["datetime"], way.detect(file), dt))
    found = outlier_scores(np.concatenate(truth), np.concatenate(alarms))
    return [faulty_row(name, cases) for name, cases in folders.items()], found


def alarm_rows(times, verdicts, dt):
    """Return (T,) bool, the rows of a file whose verdict is FAULT. verdicts: rows of verdicts.csv, each of
    the dt seconds from its time on.
    """
    judged = pd.DataFrame(verdicts)
    starts = pd.to_datetime(judged["time"]).to_numpy()
    at = np.searchsorted(starts, times.to_numpy(), "right") - 1
    since = (times.to_numpy() - starts[np.maximum(at, 0)]) / np.timedelta64(1, "s")
    return (at >= 0) & (since < dt) & (judged["status"] == "FAULT").to_numpy()[at]


def outlier_scores(truth, alarms):
    """Return {F1, FAR, MAR} of (T,) bools."""
    count = lambda rows: int(np.count_nonzero(rows))
    tp, fp = count(truth & alarms), count(~truth & alarms)
    fn, tn = count(truth & ~alarms), count(~truth & ~alarms)
    return {"F1": 2 * tp / (2 * tp + fp + fn), "FAR": fp / (fp + tn), "MAR": fn / (fn + tp)}


def arguments(words):
    parser = argparse.ArgumentParser("python -m benchmarks.plants", description=__doc__.split("\n")[0])
    parser.add_argument("plant", choices=("heater", "ahu", "engine", "skab"), nargs="?", default="heater")
    parser.add_argument("--data", type=Path, help="its folder (default: that of the shared recordings)")
    of_skab = parser.add_argument_group("skab, as of jaxbound fit")
    of_skab.add_argument("--inputs", default="Voltage,Temperature", help="default: %(default)s")
    outputs = "Accelerometer1RMS,Current,`Volume Flow RateRMS`"
    of_skab.add_argument("--outputs", default=outputs, help="default: %(default)s")
    of_skab.add_argument("--every", default="5s", help="rows are one or two seconds apart (default: 5s)")
    of_skab.add_argument("--order", default="2", help="default: 2")
    of_skab.add_argument("--horizon", default="15", help="default: 15")
    args = parser.parse_args(words)
    if args.plant == "skab" and args.data is None:
        parser.error("skab needs --data: the folder data of github.com/waico/SKAB")
    return args


def main(words=None):
    """Measure one plant, save the figures and print the table."""
    args, scores, header = arguments(words), {}, HEADER
    with tempfile.TemporaryDirectory() as folder:
        way = Way(folder)
        if args.plant == "skab":
            options = [
                word for name in ("inputs", "outputs", "every") for word in (f"--{name}", getattr(args, name))
            ]
            options += ["--recipe", f"order={args.order},horizon={args.horizon}"]
            rows, scores = skab(way, args.data, options)
        elif args.plant == "heater":
            rows = heater(way, args.data or SHARED / "tclab")
        elif args.plant == "engine":
            rows, header = engine(args.data or SHARED / "engine"), ENGINE_HEADER
        else:
            rows = ahu(way, args.data or SHARED / "ahu")
    seconds = {name: [round(x, 1) for x in spent] for name, spent in way.seconds.items()}
    figures = {"plant": args.plant, "seconds, processor": seconds, **scores}
    figures["rows"] = [dict(zip(header, row, strict=True)) for row in rows]
    timing.save("plants", figures)
    print()
    table(header, rows)
    for name, score in scores.items():
        print(f"{name} {score:.3f}" if name == "F1" else f"{name} {percent(score)}")


if __name__ == "__main__":
    main()
