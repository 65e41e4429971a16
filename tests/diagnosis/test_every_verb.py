"""Every public verb and command with a monitor of three tests, two of them of a mode, in place of one test:
it works, or one sentence says why it takes none.
"""

import jax
import numpy as np
import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.sklearn import Detector

TESTS = [
    {"name": "always", "horizon": 1, "factor": 3},
    {"name": "idle", "horizon": 2, "when": "u1 < 0"},
    {"name": "busy", "horizon": 1, "when": "otherwise", "model": {"matrices": {"A": [["3/5"]]}}},
]
FAULT = jb.Fault("y1", "bias", 1.0)
WORKS = "it works"
NO_MODEL = "LinearSystem.*, not MonitorBank"
VERBS = {
    "detect": (lambda p: jb.detect(p.watch, p.u, p.y), WORKS),
    "detect, of a file": (lambda p: jb.detect(p.watch, "run.csv"), WORKS),
    "detect, of a batch": (lambda p: jb.detect(p.watch, p.u[None], p.y[None]), WORKS),
    "detect, of a method": (
        lambda p: jb.detect(p.watch, p.u, p.y, "box"),
        "monitor takes neither method nor",
    ),
    "detect_dataset": (lambda p: jb.detect_dataset(p.watch, "run.parquet", "kept"), WORKS),
    "Monitor": (lambda p: jb.Monitor(p.watch).run(jb.Monitor(p.watch).init(), p.u, p.y), WORKS),
    "assess": (lambda p: jb.assess(p.watch, [(p.u, p.healthy)], [(p.u, p.y)]), WORKS),
    "tune": (lambda p: jb.tune(p.watch, (p.u, p.healthy)), WORKS),
    "study": (lambda p: jb.study(p.plant, FAULT, 4, KEY, p.watch, samples=6, sizes=[1]), WORKS),
    "margins": (
        lambda p: jb.margins(p.watch, p.u, p.y),
        r"one test, .*: margins\(monitor.parts\['always'\], u",
    ),
    "margins, their gradient": (
        lambda p: jax.grad(lambda y: jb.margins(p.watch, p.u, y).sum())(p.healthy),
        "margins takes one test, not a monitor of several",
    ),
    "parameters": (lambda p: jb.parameters(p.watch, p.u, p.y), "parameters takes one test, not a monitor of"),
    "evaluate": (lambda p: jb.evaluate(p.watch, p.u, p.y), "signatures must be a table"),
    "fit, of a model": (lambda p: jb.fit((p.u, p.healthy), add=p.plant), WORKS),
    "fit, of a monitor": (lambda p: jb.fit((p.u, p.healthy), add=p.watch), NO_MODEL),
    "fit": (lambda p: jb.fit(p.watch), "must be a pair .*, not MonitorBank"),
    "unknown_inputs": (lambda p: jb.unknown_inputs(p.watch, p.u, p.y), NO_MODEL),
    "observe": (lambda p: jb.observe(p.watch, p.u, p.y), NO_MODEL),
    "observer": (lambda p: jb.observer(p.watch), NO_MODEL),
    "validate": (lambda p: jb.validate(p.watch, p.u, p.y), NO_MODEL),
    "read": (lambda p: jb.read("run.csv", p.watch), WORKS),
    "Detector": (lambda p: Detector(p.watch).fit(p.rows), "model must be a LinearSystem, all of whose tests"),
    "Detector, of its model": (lambda p: Detector(p.plant).fit(p.rows).predict(p.rows), WORKS),
    "detectable": (lambda p: jb.detectable(p.watch, FAULT), WORKS),
    "plot": (lambda p: jb.plot(p.watch), "plot draws .*, not MonitorBank"),
    "plot, of its verdicts": (lambda p: jb.plot(p.found), WORKS),
    "signatures": (lambda p: jb.signatures(p.watch), "signatures needs relations, not MonitorBank"),
    "isolability": (lambda p: jb.isolability(p.watch), NO_MODEL),
    "monitor": (lambda p: jb.monitor(p.watch), NO_MODEL),
    "parity_relations": (lambda p: jb.parity_relations(p.watch), NO_MODEL),
    "redundancy": (lambda p: jb.redundancy(p.watch), NO_MODEL),
    "save_model": (lambda p: jb.save_model(p.watch, "again.toml"), NO_MODEL),
    "simulate": (lambda p: jb.simulate(p.watch, p.u, KEY), NO_MODEL),
    "structured_relations": (lambda p: jb.structured_relations(p.watch), NO_MODEL),
    "suggest_lags": (lambda p: jb.suggest_lags(p.watch, 4), NO_MODEL),
    "with_faults": (lambda p: jb.with_faults(p.watch, "y1:bias"), NO_MODEL),
    "Result, explain": (lambda p: p.found.explain(25), WORKS),
    "Result, alarms": (lambda p: p.found.alarms(rule=jb.AlarmRule(k=2, n=3)), WORKS),
    "Result, to_pandas": (lambda p: p.found.to_pandas(), WORKS),
    "Result, exact margins": (lambda p: p.found.exact, WORKS),
}
KEY = jax.random.key(0)
WITHOUT_A_TEST = set(
    "AlarmRule Fault LinearSystem MultiModel NamedFault Recipe Recording Status Uncertainty compile "
    "from_control from_scipy inclusion interval interval_system linearize load_model look membership pave "
    "residual sets solve_interval strips use_cache zonotope".split()
)
"""Public names that build what a test is made of, or know no plant."""
COMMANDS = {
    "detect": "plant.toml run.csv --out page",
    "explain": "page --at 25",
    "verify": "page/certificate-25.json --model plant.toml --data run.csv",
    "info": "plant.toml",
    "evaluate": "plant.toml --healthy healthy.csv --faulty run.csv",
    "fleet": "units.csv --out units",
    "tune": "plant.toml healthy.csv --out tuned.toml",
    "study": "plant.toml --faults y1:bias --n 4 --samples 6 --out counts",
    "parameters": "plant.toml run.csv --out narrowed.toml",
    "fit": "healthy.csv --recipe plant.toml --out again.toml",
}
CODES = {"detect": 1, "fleet": 1}
SENTENCES = {
    "parameters": "has none: give the model uncertainties=",
    "fit": "no table [fit] as `fit` writes it",
}
WITHOUT_A_MODEL = {"demo", "example", "look"}


class Place:
    """A monitor in two modes, and recordings in a folder: healthy, or y1 and y2 jump at 22."""

    def __init__(self):
        self.plant = jb.LinearSystem([[0.5]], [[1]], [[1], [1]], noise=[0.1, 0.1], tests=TESTS)
        self.watch = jb.monitor(self.plant)
        rng, x = np.random.default_rng(1), np.zeros(30)
        self.u = np.where(np.arange(30) // 6 % 2, 1.0, -1.0)[:, None] * rng.uniform(0.5, 1, (30, 1))
        for k, u in enumerate(self.u[:-1, 0]):
            x[k + 1] = (0.6 if u >= 0 else 0.5) * x[k] + u
        self.healthy = x[:, None] + rng.uniform(-0.05, 0.05, (30, 2))
        self.y = self.healthy.copy()
        self.y[12, 0], self.y[22:, 0] = np.nan, self.y[22:, 0] + 3
        self.rows = np.concatenate([self.u, self.healthy], 1)
        self.found = jb.detect(self.watch, self.u, self.y)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    found = Place()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("every"))
        patch.setattr(main, "_configure", lambda: None)
        for name, y in (("healthy", found.healthy), ("run", found.y)):
            table = pd.DataFrame(np.concatenate([found.u, y], 1), columns=["u1", "y1", "y2"])
            table.to_csv(f"{name}.csv", index=False)
            table.to_parquet(f"{name}.parquet")
        table = {"unit": ["a", "b"], "model": ["plant.toml"] * 2, "recording": ["run.csv", "healthy.csv"]}
        pd.DataFrame(table).to_csv("units.csv", index=False)
        jb.save_model(found.plant, "plant.toml")
        yield found


@pytest.mark.parametrize("name", VERBS)
def test_a_verb_takes_a_monitor_of_several_tests_or_says_why_not(place, name):
    verb, says = VERBS[name]
    if says is WORKS:
        assert verb(place) is not None
        return
    with pytest.raises((ValueError, TypeError), match=says) as refused:
        verb(place)
    assert len(str(refused.value)) < 400 and "\n" not in str(refused.value)


def test_healthy_samples_of_both_modes_are_consistent_and_a_jump_is_a_fault(place):
    assert (place.found.status[1:22] == jb.Status.CONSISTENT).all() and place.found.status[
        0
    ] == jb.Status.MISSING
    assert place.found.status[22] == jb.Status.FAULT and len(set(place.found.by[22:])) == 3
    assert jb.detect(place.watch, place.u, place.healthy).counts["FAULT"] == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_takes_a_model_with_several_tests_or_says_why_not(place, name, capsys):
    code = main.main([name, *COMMANDS[name].split()])
    error = capsys.readouterr().err
    assert code == (2 if name in SENTENCES else CODES.get(name, 0)), error
    assert SENTENCES.get(name, "") in " ".join(error.split())


def test_no_verb_and_no_command_is_left_out():
    assert {name.partition(",")[0] for name in VERBS} == {*jb.__all__, "Detector"} - WITHOUT_A_TEST
    assert set(COMMANDS) | WITHOUT_A_MODEL == {command.NAME for command in main.COMMANDS}
