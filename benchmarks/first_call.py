"""What a user waits for before the first verdict: each verb and family in a process of its own, nothing
compiled yet, and all kept.

python -m benchmarks.first_call [--only "joint1;validate"] [--out NAME] [--against NAME] [--counts]

For every case: seconds and CPU seconds of the first call after the imports, once with an empty folder of
compiled kernels and once with a full one; compilations; instructions of the optimised programs, which do not
depend on what else the machine does. Cases that end in a number are windows of so many samples and one: how a
kernel grows with the horizon. --out: the figures go to benchmarks/NAME.json; of --only, beside those of the
other cases that are there. --against: they are printed beside those of an earlier run.
--counts: only what can be counted, in one process. Commands of the shell are measured whole, from start to
exit.
"""

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from pathlib import Path

import jax
import matplotlib
import numpy as np

import jaxbound as jb
from benchmarks import timing

HERE = Path(__file__).parent
NAME = "first_call"
HORIZONS = (1, 2, 5, 10, 20, 40)
LARGE = 600  # instructions of a program that takes more than half a second to compile

PLANT = dict(
    A=[[0.5, 0.25], [0, 0.25]], B=[[0], [1]], C=[[1, 0], [1, 1]], noise=[0.1, 0.1], tolerance=[0.02, 0.02]
)
GAIN = dict(A=[[0.5]], B=[[1]], C=[[1]], noise=0.1)
HEATER = dict(
    A=[[0.95, 0.02, 0.01, 0], [0.02, 0.95, 0, 0.01], [0.03, 0, 0.97, 0], [0, 0.03, 0, 0.97]],
    B=[[0.05, 0], [0, 0.04], [0, 0], [0, 0]],
    C=[[0, 0, 1, 0], [0, 0, 0, 1]],
    noise=[0.3, 0.3],
    tolerance=[0.01, 0.01],
)
POLE = jb.Uncertainty("a", A=[[0.05]])
POLE_AND_INPUT = [jb.Uncertainty("a", A=[[0.05, 0], [0, 0]]), jb.Uncertainty("b", B=[[0], [0.1]])]


def recording(model, samples=400, healthy=False):
    """Return (u, y): random inputs, errors within their bounds; from half-time on all sensors are wrong,
    unless it is healthy.
    """
    rng = np.random.default_rng(0)
    A, B, C, noise, tolerance = (
        np.array(getattr(model, name), float) for name in ("A", "B", "C", "noise", "tolerance")
    )
    u, x, y = rng.uniform(-1, 1, (samples, model.m)), np.zeros(model.n), np.empty((samples, model.p))
    for k in range(samples):
        y[k] = (1 + tolerance * rng.uniform(-1, 1, model.p)) * (C @ x) + noise * rng.uniform(-1, 1, model.p)
        x = A @ x + B @ u[k]
    y[samples // 2 :] += 0 if healthy else 0.7
    return u, y


def detect(plant, horizon=None, method="joint", relations=jb.parity_relations, missing=False, **more):
    """Return the first `detect` of a plant, ready to be called."""
    model = jb.LinearSystem(**plant, **more)
    u, y = recording(model)
    r = relations(model) if horizon is None else relations(model, horizon)
    if missing:
        y[50, 0] = np.nan
    return lambda: jb.detect(r, u, y, method=method)


def residual():
    grow = lambda z, u, y: y[1, 0] - (0.5 + z[0]) * y[0, 0] - u[0, 0] - z[1]
    r = jb.residual(grow, jb.interval([-0.05, -0.2], [0.05, 0.2]), 1, inputs=["u1"], outputs=["y1"])
    u, y = recording(jb.LinearSystem(**GAIN))
    return lambda: jb.detect(r, u, y)


def margins(horizon, gradient=False):
    model = jb.LinearSystem(**PLANT)
    u, y = recording(model)
    r = jb.parity_relations(model, horizon)
    if gradient:
        return lambda: np.asarray(jax.grad(lambda scale: jax.numpy.nansum(jb.margins(r, u, y * scale)))(1.0))
    return lambda: np.asarray(jb.margins(r, u, y))


def validate(plant):
    model = jb.LinearSystem(**plant)
    u, y = recording(model)
    return lambda: jb.validate(model, u, y)


def observe():
    model = jb.LinearSystem(**PLANT, disturbance=([[1], [0]], [0.01]))
    u, y = recording(model)
    watch = jb.observer(model)
    return lambda: jb.detect(watch, u, y)


def unknown_inputs():
    model = jb.LinearSystem(**PLANT, unknown_inputs=[[0], [1]])
    u, y = recording(model)
    return lambda: jb.unknown_inputs(model, u, y)


def study():
    model = jb.LinearSystem(**PLANT)
    return lambda: jb.study(model, "y1:bias", 64, 1, samples=60)


def tune():
    model = jb.LinearSystem(**PLANT)
    r, data = jb.parity_relations(model, 2), recording(model, healthy=True)
    return lambda: jb.tune(r, data)


def fit():
    data = recording(jb.LinearSystem(**HEATER), 400, healthy=True)
    return lambda: jb.fit([data], dt=1.0, horizon=30)


def monitor():
    model = jb.LinearSystem(**PLANT)
    r, (u, y) = jb.parity_relations(model, 1), recording(model)

    def run():
        watch = jb.Monitor(r)
        state, _ = watch.step(watch.init(), u[0], y[0])
        return watch.step(state, u[1], y[1])

    return run


def explain():
    model = jb.LinearSystem(**PLANT)
    r, (u, y) = jb.parity_relations(model, 1), recording(model)
    return lambda: jb.detect(r, u, y).explain(250)


def growing(name, **more):
    return {f"{name}{h}": lambda h=h: detect(PLANT, h, **more) for h in HORIZONS}


CASES: dict[str, Callable[[], Callable[[], object]]] = {
    **growing("joint"),
    **growing("box", method="box"),
    **growing("disturbed", disturbance=([[1], [0]], [0.01])),
    "short4": lambda: detect(PLANT, 4),
    "heater15": lambda: detect(HEATER, 15),
    "heater15_missing": lambda: detect(HEATER, 15, missing=True),
    "heater15_disturbed": lambda: detect(HEATER, 15, disturbance=(np.eye(4).tolist(), [0.01] * 4)),
    "constant1": lambda: detect(PLANT, 1, constant_tolerance=True),
    "constant3": lambda: detect(PLANT, 3, constant_tolerance=True),
    "uncertain1": lambda: detect(GAIN, 1, uncertainties=[POLE]),
    "uncertain2": lambda: detect(PLANT, 2, uncertainties=POLE_AND_INPUT),
    "bank": lambda: detect(PLANT, relations=jb.structured_relations),
    "residual": residual,
    "margins1": lambda: margins(1),
    "margins12": lambda: margins(12),
    "gradient1": lambda: margins(1, True),
    "gradient12": lambda: margins(12, True),
    "validate": lambda: validate(PLANT),
    "validate_heater": lambda: validate(HEATER),
    "observer": observe,
    "unknown_inputs": unknown_inputs,
    "study": study,
    "tune": tune,
    "fit": fit,
    "monitor": monitor,
    "explain": explain,
}

ALIKE = (
    "joint2",
    "joint5",
    "joint20",
    "box2",
    "box5",
    "box20",
    "disturbed1",
    "disturbed2",
    "disturbed5",
    "disturbed20",
    "heater15_missing",
    "heater15_disturbed",
    "constant1",
    "gradient12",
    "validate_heater",
    "monitor",
    "explain",
    "tune",
)
"""Cases that begin with the programs of others, or take long to count: they are compiled when somebody asks,
and not counted in the test of every day.
"""

COMMANDS = {
    "--version": "--version",
    "info": "info model.toml",
    "detect": "detect model.toml run.csv --out report",
    "detect, validation": "detect model.toml run.csv --out validated --method validation",
    "explain": "explain report --at 210",
    "fit": "fit good.csv --inputs u1 --outputs y1,y2 --recipe horizon=15 --out fitted.toml --force",
    "tune": "tune model.toml good.csv --out tuned.toml --force",
    "study": "study model.toml --faults y1:bias --n 2000 --out study",
}


@contextmanager
def compilations():
    """Yield a list that gets the seconds of each compilation."""
    found = []

    def listen(event, seconds, **about):
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(seconds)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def measured(name, dumped):
    """Return the figures of the first call of a case in this process; dumped: the folder that XLA writes its
    programs to, or None.
    """
    jax.clear_caches()
    jax.device_put(np.zeros(3)).block_until_ready()
    run = CASES[name]()
    earlier = set(programs(dumped))
    with compilations() as found:
        wall, cpu = time.perf_counter(), time.process_time()
        run()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    out = {"s": round(wall, 2), "CPU s": round(cpu, 2), "compilations": len(found)}
    if dumped:
        counts = {path: _lines(path) for path in programs(dumped) if path not in earlier}
        largest = sorted(counts, key=counts.get, reverse=True)[:3]
        named = [[re.sub(r"module_\d+\.(jit_)?|\.cpu.*", "", path.name), counts[path]] for path in largest]
        out |= {"instructions": sum(counts.values()), "largest": named}
    return out


def _lines(path):
    """Return how many instructions the text of a program has."""
    return sum(" = " in line and not line.startswith("#") for line in path.read_text().splitlines())


class Enough(BaseException):
    """A program is too large to be compiled in a test."""


def lowered(name):
    """Return [instructions, programs] that the first call of a case hands to the compiler, up to the first of
    more than LARGE.

    That one is not compiled: counting takes a moment, and depends on no machine. A folder of compiled kernels
    has to be in use.
    """
    counts, lock = [], threading.Lock()  # the driver may compile in several threads
    with tempfile.TemporaryDirectory() as folder:

        def listen(event, **about):
            if event != "/jax/compilation_cache/compile_requests_use_cache":
                return
            with lock:
                waiting = sorted(Path(folder).iterdir())
                while waiting and not (counts and counts[-1] > LARGE):
                    counts.append(_lines(waiting[0]))
                    waiting.pop(0).unlink()
                if counts[-1] > LARGE:
                    raise Enough

        run = CASES[name]()
        jax.clear_caches()  # what another case compiled is compiled again
        jax.config.update("jax_dump_ir_to", folder)
        jax.monitoring.register_event_listener(listen)
        try:
            with suppress(Enough):
                run()
        finally:
            jax.monitoring.unregister_event_listener(listen)
            jax.config.update("jax_dump_ir_to", None)
    return [sum(counts), len(counts)]


def programs(dumped):
    """Return the files of the optimised programs in a folder."""
    return list(Path(dumped).glob("*after_optimizations.txt")) if dumped else []


def case(name):
    """Return the figures of a case, each first call in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        kept, dumped = Path(folder) / "kernels", Path(folder) / "programs"
        settings = {"JAX_COMPILATION_CACHE_DIR": str(kept), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
        settings["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
        dump = {"XLA_FLAGS": f"--xla_dump_to={dumped} --xla_dump_hlo_as_text --xla_dump_hlo_pass_re=none"}
        command = [sys.executable, "-m", "benchmarks.first_call", "--case", name]
        return _asked([*command, "--dumped", str(dumped)], settings | dump)[name] | {
            "warm": _asked(command, settings)[name]
        }


def counted(names):
    """Return the figures of cases of which only counts are wanted: one after the other in a process that
    forgets what it compiled.

    The first of them counts the probe of the device too, some 60 instructions.
    """
    with tempfile.TemporaryDirectory() as folder:
        dump = {
            "XLA_FLAGS": f"--xla_dump_to={folder} --xla_dump_hlo_as_text --xla_dump_hlo_pass_re=none",
            "JAX_COMPILATION_CACHE_DIR": "",
        }
        return _asked(
            [sys.executable, "-m", "benchmarks.first_call", "--case", ";".join(names), "--dumped", folder],
            dump,
        )


def _asked(command, settings):
    done = subprocess.run(
        command, env={**os.environ, **settings}, stdout=subprocess.PIPE, check=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def commands(names, repeats=3):
    """Return {command: seconds and CPU seconds, of the first run and the least of the later ones, from start
    to exit}.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        model = jb.LinearSystem(**PLANT, dt=0.01, columns={"time": "time"})
        jb.save_model(model, folder / "model.toml")
        u, y = recording(model)
        table = np.column_stack([0.01 * np.arange(len(u)), u, y])
        for name, rows in (("run.csv", table), ("good.csv", table[: len(u) // 2])):
            np.savetxt(folder / name, rows, delimiter=",", header="time,u1,y1,y2", comments="")
        kept = {
            k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"
        }  # else Python compiles every file at each start
        settings = {
            **kept,
            "XDG_CACHE_HOME": str(folder / "cache"),
            "MPLCONFIGDIR": matplotlib.get_cachedir(),
        }
        out = {}
        for name in names:
            runs = []
            for _ in range(1 + repeats):
                if name == "study":
                    subprocess.run(["rm", "-rf", str(folder / "study")], check=True)
                wall, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
                done = subprocess.run(
                    [sys.executable, "-m", "jaxbound.cli", *COMMANDS[name].split()],
                    cwd=folder,
                    env=settings,
                    capture_output=True,
                    text=True,
                )
                if done.returncode not in (0, 1):
                    raise RuntimeError(done.stderr)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                runs.append((round(time.perf_counter() - wall, 2), round(cpu, 2)))
            least = dict(zip(("s", "CPU s"), map(min, zip(*runs[1:], strict=True)), strict=True))
            out[f"jaxbound {name}"] = {"s": runs[0][0], "CPU s": runs[0][1], "warm": least}
        return out


def comparison(before, now):
    """Return lines of a table: what each case took before, and what it takes now."""
    rows = [f"{'':24s} {'instructions':>16s} {'compilations':>14s} {'cold CPU s':>14s} {'warm CPU s':>14s}"]
    for name, figures in now.items():
        old, text = before.get(name, {}), ""
        for key, width in (("instructions", 16), ("compilations", 14), ("CPU s", 14)):
            text += f"{old.get(key, '-')} > {figures.get(key, '-')}".rjust(width + 1)
        warm = f"{old.get('warm', {}).get('CPU s', '-')} > {figures.get('warm', {}).get('CPU s', '-')}"
        rows.append(f"{name:24s}{text} {warm:>14s}")
    return rows


def main():
    parser = argparse.ArgumentParser("python -m benchmarks.first_call", description=__doc__.split("\n")[0])
    every = [*CASES, *(f"jaxbound {name}" for name in COMMANDS)]
    parser.add_argument("--only", default=";".join(every), metavar="NAME;NAME", help="; ".join(every))
    parser.add_argument(
        "--out", default=NAME, metavar="NAME", help="benchmarks/NAME.json is written (default: first_call)"
    )
    parser.add_argument(
        "--against", metavar="NAME", help="benchmarks/NAME.json of an earlier run, to compare with"
    )
    parser.add_argument(
        "--counts",
        action="store_true",
        help="only instructions and compilations, all in one process, no commands",
    )
    parser.add_argument(
        "--lowered",
        metavar="FILE",
        help="count what is handed to the compiler instead, as tests/test_first_call.py does",
    )
    parser.add_argument(
        "--case", metavar="NAME;NAME", help="what the process of a case, or of several, is asked"
    )
    parser.add_argument("--dumped", help="and where XLA writes its programs")
    args = parser.parse_args()
    if args.case:
        print(json.dumps({name: measured(name, args.dumped) for name in args.case.split(";")}))
        return
    wanted, found = [name.strip() for name in args.only.split(";") if name.strip()], {}
    if unknown := [name for name in wanted if name not in every]:
        parser.error(f"--only does not know {', '.join(unknown)}")
    cases = [name for name in wanted if name in CASES]
    if args.lowered:
        found = {name: lowered(name) for name in cases if name not in ALIKE}
        Path(args.lowered).write_text(json.dumps(found, indent=1) + "\n")
        return
    if args.counts:
        found = counted(cases)
    else:
        for name in cases:
            found[name] = case(name)
            print(name, json.dumps(found[name]), file=sys.stderr, flush=True)
        found |= commands([name.removeprefix("jaxbound ") for name in wanted if name not in CASES])
    load, kept = round(os.getloadavg()[0], 1), HERE / f"{args.out}.json"
    if len(wanted) < len(every) and kept.exists():
        found = json.loads(kept.read_text())["cases"] | found
        found = {name: found[name] for name in every if name in found}
    timing.save(args.out, {"load of the machine": load, "cases": found})
    if args.against:
        before = json.loads((HERE / f"{args.against}.json").read_text())["cases"]
        print("\n".join(comparison(before, found)))


if __name__ == "__main__":
    main()
