"""Every family and verb as digests of its bits, to compare two versions of the code with.

Run: python -m benchmarks.same_bits --save before.json            on the one
     python -m benchmarks.same_bits --against before.json         on the other; exit code 1 where bits differ
     python -m benchmarks.same_bits --only observer,study ...     only cases whose names hold one of these

A digest covers type, shape and bytes of every array that a verb returns, a NaN counting as any other NaN, and
the text of certificates, tables and files. Recordings are simulated from fixed keys: healthy at first, with a
bias in the first output from the middle on.
"""

import dataclasses
import functools
import hashlib
import json
import re
import sys
import tempfile
import traceback
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb

jax.config.update("jax_enable_x64", True)

PAPER = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0], [1, 1]])
ERRORS = dict(tolerance=[0.02, 0.1], noise=[0.1, 0.01])
SLOW_PLANT = dict(A=[[0.97, 0.02], [0, 0.95]], B=[[0.1], [0.2]], C=[[1, 0], [1, 1]], noise=[0.05, 0.1])
PUSHED = dict(disturbance=([[1], [0.5]], 0.01))
UNSURE = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0]])
GAIN = dict(name="c", C=[[0.1, 0]], varying=False)
POLE = dict(name="a", A=[[0.1, 0], [0, 0]])
TYPES = np.float64, np.float32


def model(*parts, parameters=(), **changes):
    """Return a LinearSystem of these matrices, bounds and uncertain parameters."""
    numbers = functools.reduce(lambda a, b: a | b, parts, {}) | changes
    return jb.LinearSystem(**numbers, uncertainties=[jb.Uncertainty(**p) for p in parameters])


def recording(plant, samples=300, size=0.5, dtype=np.float64, key=0, **options):
    """Return (u, y) of a plant, with a bias in the first output in the second half and one missing sample."""
    rng = np.random.default_rng(key)
    u = np.repeat(rng.uniform(-1, 1, (-(-samples // 10), plant.m)), 10, 0)[:samples].astype(dtype)
    y = np.array(jb.simulate(plant, u, key, **options).y)
    y[samples // 2 :, 0] += size
    y[samples // 4, -1] = np.nan
    return u, y


FAMILIES = {
    "short": (lambda: model(PAPER, ERRORS), {}),
    "four samples": (lambda: model(PAPER, ERRORS), {"horizon": 3}),
    "lags": (lambda: model(PAPER, ERRORS), {"lags": (0, 2, 5)}),
    "averages": (
        lambda: model(PAPER, PUSHED, noise=[0.3, 0.2], averages={"y1": {3: 0.15}, "w1": {2: 0.005}}),
        {"horizon": 4},
    ),
    "disturbance": (lambda: model(PAPER, ERRORS, PUSHED), {"horizon": 4}),
    "long": (lambda: model(SLOW_PLANT), {"horizon": 15}),
    "long, disturbance": (lambda: model(SLOW_PLANT, PUSHED), {"horizon": 12}),
    "constant tolerance": (lambda: model(PAPER, ERRORS, constant_tolerance=True), {"horizon": 2}),
    "constant tolerance, long": (
        lambda: model(SLOW_PLANT, tolerance=0.02, constant_tolerance=True),
        {"horizon": 6},
    ),
    "resolution": (lambda: model(PAPER, resolution="1/300"), {"horizon": 2}),
    "offset": (lambda: model(PAPER, ERRORS, offset={"u": [1], "y": [20, 10]}), {}),
    "unknown input": (lambda: model(PAPER, ERRORS, unknown_inputs=[[1], [0]]), {"horizon": 3}),
    "no state": (
        lambda: model(A=None, B=None, C=None, D=[[1, 2], [1, 2], [0, 1]], noise=0.2),
        {"horizon": 0},
    ),
    "uncertain": (lambda: model(UNSURE, parameters=[POLE, GAIN], noise=0.05, tolerance=0.01), {"horizon": 2}),
    "uncertain, joint": (
        lambda: model(UNSURE, parameters=[dict(POLE, varying=False), GAIN], noise=0.02, tolerance=0.01),
        {"horizon": 3},
    ),
}
OBSERVERS = {
    "zonotope": {},
    "latched": {"restart": False, "weight": 1.0},
    "strips": {"method": "strips"},
    "joint": {"method": "joint", "window": 8},
}
CASES = {}


def case(name):
    """Add a function without arguments to CASES; its result is what is compared."""

    def add(run):
        CASES[name] = run
        return run

    return add


def family_cases(name, build, window):
    """Add the cases of a family of relations: verdicts, margins, certificates and what tells of them."""
    size = 3.0 if name == "no state" else 0.5

    def relations():
        return jb.parity_relations(build(), **window)

    for dtype in TYPES:
        label = f"detect {name} {np.dtype(dtype).name}"
        case(label)(lambda dtype=dtype: jb.detect(relations(), *recording(build(), size=size, dtype=dtype)))
    case(f"detect {name} box")(lambda: jb.detect(relations(), *recording(build(), size=size), method="box"))
    case(f"margins {name}")(lambda: jb.margins(relations(), *recording(build(), size=size)))
    case(f"text {name}")(lambda: relations().text())

    @case(f"explain {name}")
    def explain():
        found = jb.detect(relations(), *recording(build(), 60, size=size))
        return [found.explain(at).to_json() for at in (25, 35)]

    @case(f"vertices {name}")
    def vertices():
        return jb.detect(relations(), *recording(build(), 100, 0.0, at="vertices"))

    @case(f"monitor {name}")
    def monitor():
        watch = jb.Monitor(relations())
        u, y = recording(build(), 60, size=size)
        state, verdicts = watch.init(), []
        for a, b in zip(u, y, strict=True):
            state, verdict = watch.step(state, a, b)
            verdicts.append(verdict)
        return verdicts


def observer_cases(name, options):
    """Add the cases of a method of observers."""

    def plant():
        return model(SLOW_PLANT, PUSHED)

    for samples in (40, 300):
        case(f"observer {name} detect {samples}")(
            lambda samples=samples: jb.detect(jb.observer(plant(), **options), *recording(plant(), samples))
        )
    case(f"observer {name} observe")(lambda: jb.observe(plant(), *recording(plant(), 80), **options))

    @case(f"observer {name} batch")
    def batch():
        u, y = recording(plant(), 50)
        return jb.observe(plant(), np.stack([u] * 3), np.stack([y, y + 0.01, y - 0.5]), **options)

    if name != "joint":
        uncertain = lambda: model(UNSURE, parameters=[GAIN], noise=0.05, A=[[0.8, 0.1], [0.1, 0.2]])
        case(f"observer {name} uncertain")(
            lambda: jb.observe(uncertain(), *recording(uncertain(), 60), **options)
        )


for _name, (_build, _window) in FAMILIES.items():
    family_cases(_name, _build, _window)
for _name, _options in OBSERVERS.items():
    observer_cases(_name, _options)


@case("detect uncertain by boxes")
def uncertain_boxes():
    plant = FAMILIES["uncertain"][0]()
    relations = jb.parity_relations(plant, horizon=2)
    return jb.detect(relations, *recording(plant, 40), budget=200)


@case("bank")
def bank():
    plant = model(PAPER, ERRORS)
    relations = jb.structured_relations(plant)
    found = jb.detect(relations, *recording(plant))
    return found, jb.signatures(relations).text(), jb.isolability(plant).text(), relations.text()


@case("redundancy")
def redundancy():
    plant = model(PAPER, ERRORS, unknown_inputs=[[1], [0]])
    return [jb.redundancy(plant, method).text() for method in ("window", "elimination")]


@case("residual")
def residual():
    drift = lambda z, u, y: y[1, 0] - (1 + z[0]) * y[0, 0] ** 2 - z[1]
    relations = jb.residual(drift, jb.interval([-0.01, -0.1], [0.01, 0.1]), horizon=1)
    y = np.array([0.5, 0.3, 0.1, 0.0, 0.6, 0.3])[:, None]
    return jb.detect(relations, None, y)


@case("evaluate")
def evaluate():
    residuals = np.random.default_rng(4).normal(size=(40, 3)) * [1.0, 2.0, 3.0]
    table = np.array([[1, 0, 1], [0, 1, 1], [1, 1, 0]])
    return jb.evaluate(residuals, np.array([2.0, 3.0, 4.0]), table)


@case("validate")
def validate():
    return jb.validate(model(SLOW_PLANT, PUSHED), *recording(model(SLOW_PLANT, PUSHED), 80))


@case("validate interval system")
def validate_interval():
    system = jb.interval_system([[(0.78, 0.82)]], [[1]], [[1]], noise=0.1)
    u = np.ones((40, 1))
    y = np.cumsum(0.8 ** np.arange(40))[:, None] - 1
    y[30:] += 2
    return jb.validate(system, u, y)


@case("unknown inputs")
def unknown_inputs():
    plant = FAMILIES["unknown input"][0]()
    return jb.unknown_inputs(plant, *recording(plant, 60), horizon=3)


@case("detectable")
def detectable():
    plant = model(SLOW_PLANT, PUSHED)
    kinds = "y1", "y2", "u1"
    return [
        jb.detectable(plant, kind, **window)
        for kind in kinds
        for window in ({"horizon": 6}, {"lags": (0, 4, 8)})
    ]


@case("suggest lags")
def suggest_lags():
    return repr(jb.suggest_lags(model(SLOW_PLANT, PUSHED)))


@case("study")
def study():
    faults = [jb.Fault("y1", "bias", 0.5, 20), jb.Fault("y2", "drift", 0.05, 20)]
    return jb.study(model(PAPER, ERRORS), faults, 50, 1, samples=60)


@case("study long")
def study_long():
    faults = [jb.Fault("y1", "bias", 0.5, 20)]
    plant = model(SLOW_PLANT, PUSHED)
    return jb.study(plant, faults, 20, 2, jb.parity_relations(plant, horizon=12), samples=60)


@case("study observer")
def study_observer():
    plant = model(SLOW_PLANT, PUSHED)
    return jb.study(plant, [jb.Fault("y1", "bias", 0.5, 20)], 8, 3, jb.observer(plant), samples=60)


@case("tune")
def tune():
    plant = model(PAPER, ERRORS)
    return jb.tune(jb.parity_relations(plant), recording(plant, size=0.0), recording(plant, key=3), steps=30)


@case("fit")
def fit():
    plant = model(SLOW_PLANT, PUSHED)
    return jb.fit(recording(plant, 600, 0.0), order=2, horizon=8)


@case("fit windows")
def fit_windows():
    plant = model(SLOW_PLANT, PUSHED)
    return jb.fit(recording(plant, 600, 0.0), order=1, horizon=4, method="windows", average=4)


@case("simulate")
def simulate():
    plants = [model(PAPER, ERRORS, PUSHED), FAMILIES["uncertain"][0](), FAMILIES["averages"][0]()]
    faults = [jb.Fault("y1", "drift", 0.1, 10)]
    rows = [(p, at) for p in plants for at in ("uniform", "vertices")]
    return [jb.simulate(p, np.ones((40, 1)), 7, at=at, faults=faults) for p, at in rows]


@case("linearize")
def linearize():
    near = {"x": 0.2, "u": 0.1}
    return jb.linearize(lambda x, u: u - 0.5 * abs(x) ** 1.5, [1.0], [0.5], dt=2.0, region=near, noise=0.005)


@case("sets")
def sets():
    rng = np.random.default_rng(5)
    Z = jb.zonotope(rng.normal(size=2), rng.normal(size=(2, 5)))
    box = jb.interval([-1.0, 0.5], [1.0, 2.0])
    A = jb.interval(np.eye(2) * 3 - 0.1, np.eye(2) * 3 + 0.1)
    return (
        jb.membership(Z, rng.normal(size=(50, 2)) * 3),
        jb.strips(Z),
        jb.inclusion(lambda z: z[0] * jax.numpy.exp(z[1]) - z[0] ** 2)(box),
        jb.solve_interval(A, jb.interval([0.9, 1.9], [1.1, 2.1])),
        jb.pave(lambda z: z[0] ** 2 + z[1] ** 2, box, np.array([1.0])),
    )


@case("model file")
def model_file():
    texts = []
    with tempfile.TemporaryDirectory() as folder:
        for build, _ in FAMILIES.values():
            jb.save_model(build(), f"{folder}/m.toml")
            again = jb.load_model(f"{folder}/m.toml")
            texts.append((Path(f"{folder}/m.toml").read_text(), again == build()))
    return texts


@case("files")
def files():
    """Return what the commands and Parquet write of a recording: texts and tables, without times of day."""
    import pandas as pd

    from jaxbound.cli.main import main

    plant = model(SLOW_PLANT, PUSHED, dt=1.0)
    u, y = recording(plant, 400)
    table = pd.DataFrame({"t": np.arange(400.0), "u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jb.save_model(plant, folder / "m.toml")
        table.to_csv(folder / "run.csv", index=False)
        table.to_parquet(folder / "run.parquet")
        for suffix in ("csv", "parquet"):
            for method in ("joint", "observer"):
                out = folder / f"{suffix}-{method}"
                run = [
                    "detect",
                    folder / "m.toml",
                    folder / f"run.{suffix}",
                    "--method",
                    method,
                    "--out",
                    out,
                    "-q",
                ]
                main([str(x) for x in run])
        tables = {
            str(p.relative_to(folder)): _table_of(p, pd)
            for p in sorted(folder.glob("*-*/**/*"))
            if p.name in ("verdicts.csv", "alarms.csv") or p.suffix == ".parquet"
        }
    return tables


def _table_of(path, pd):
    """Return the columns of a file of verdicts or alarms, as text."""
    return (pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)).to_csv(index=False)


def digest(x):
    """Return a hex digest of the bits of a result."""
    state = hashlib.blake2b(digest_size=16)
    _feed(state, x, 0)
    return state.hexdigest()


def _feed(state, x, depth):
    if depth > 12:
        raise ValueError("a result is nested too deeply")
    if hasattr(x, "dtype") and hasattr(x, "shape"):
        a = np.asarray(x) if not jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else np.zeros(0)
        if a.dtype.kind == "f":
            a = np.where(np.isnan(a), np.asarray(np.nan, a.dtype), a)
        text = repr(a.tolist()) if a.dtype == object else a.tobytes()
        state.update(f"{a.dtype}{a.shape}".encode() + (text.encode() if isinstance(text, str) else text))
    elif isinstance(x, dict):
        for key in sorted(x, key=str):
            state.update(str(key).encode())
            _feed(state, x[key], depth + 1)
    elif isinstance(x, jb.LinearSystem):
        with tempfile.TemporaryDirectory() as folder:
            jb.save_model(x, f"{folder}/m.toml")
            state.update(Path(f"{folder}/m.toml").read_bytes())
    elif dataclasses.is_dataclass(x) and not isinstance(x, type):
        for field in dataclasses.fields(x):
            if field.name in SKIPPED:
                continue
            state.update(field.name.encode())
            _feed(state, getattr(x, field.name), depth + 1)
    elif isinstance(x, (list, tuple)):
        state.update(f"{len(x)}".encode())
        for part in x:
            _feed(state, part, depth + 1)
    else:
        state.update(re.sub(r" at 0x[0-9a-f]+", "", repr(x)).encode())


SKIPPED = {"evaluated", "relations", "model", "recording", "seconds", "plan", "made"}
"""Fields that are what a verb was asked with, or seconds."""


def main(arguments):
    """Compute digests of all cases, or of those that are asked for; save or compare them."""
    options = dict(zip(arguments[::2], arguments[1::2], strict=True))
    wanted = options.get("--only", "").split(",")
    found = {}
    for name, run in CASES.items():
        if not any(word in name for word in wanted):
            continue
        try:
            found[name] = digest(run())
        except Exception as error:
            found[name] = f"{type(error).__name__}: {error}"
            if "--trace" in options:
                traceback.print_exc()
        print(f"{name}: {found[name]}", flush=True)
    if "--save" in options:
        Path(options["--save"]).write_text(json.dumps(found, indent=1) + "\n")
    if "--against" not in options:
        return 0
    before = json.loads(Path(options["--against"]).read_text())
    differ = [name for name in found if name in before and found[name] != before[name]]
    print(f"{len(found)} cases, {len(differ)} differ", *differ, sep="\n  ")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
