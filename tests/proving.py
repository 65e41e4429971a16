"""Every public name that proves something, with a call of it, and those that prove nothing on a device;
`python proving.py` tries all.

A name that is in neither table fails `test_probe.py`: whoever adds one says which it is.
"""

import json
import tempfile
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb
from jaxbound import sets

MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
LEAKING = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, unknown_inputs=[[1]])
FIXED = jb.LinearSystem(
    [[0]], None, [[1]], noise=0.1, uncertainties=[jb.Uncertainty("a", A=[[1]], varying=False)]
)


def square(z):
    return z * z


def doors():
    """Return {name: a call that proves something}; what it needs is built here, so that only the call itself
    can refuse.
    """
    r, y = jb.parity_relations(MODEL), np.array([[0.05], [0.0], [0.05]])
    box, M = jb.interval(np.zeros(1), np.ones(1)), jb.interval_system([[0.5]], None, [[1]])
    Z, F = jb.zonotope([0.0], [[1.0]]), jb.inclusion(square)
    fixed = jb.parity_relations(FIXED)
    monitor = lambda: jb.Monitor(r)
    return {
        "detect": lambda: jb.detect(r, None, y),
        "detect_dataset": lambda: dataset(r),
        "assess": lambda: jb.assess(r, [(None, y)]),
        "monitor": lambda: jb.monitor(MODEL, [{"name": "slow", "observer": "zonotope"}]),
        "Monitor": monitor,
        "observer": lambda: jb.observer(MODEL),
        "observe": lambda: jb.observe(MODEL, None, y),
        "parameters": lambda: jb.parameters(fixed, None, y),
        "unknown_inputs": lambda: jb.unknown_inputs(LEAKING, None, y, horizon=1),
        "validate": lambda: jb.validate(M, None, y),
        "linearize": lambda: jb.linearize(lambda x, u: -x * x, [1.0], region={"x": 0.1}),
        "inclusion": lambda: F(box),
        "inclusion.continuous": lambda: F.continuous(box),
        "inclusion.jacobian": lambda: F.jacobian(box),
        "pave": lambda: jb.pave(square, box, np.array([0.25])),
        "pave, excluding": lambda: jb.pave(square, box, np.array([2.0]), q=2),
        "solve_interval": lambda: jb.solve_interval(np.eye(1), np.ones(1)),
        "membership": lambda: jb.membership(Z, y),
        "sets.support": lambda: sets.support(Z, [1.0]),
        "study": lambda: jb.study(MODEL, [jb.Fault("y1", "bias", 1.0, 4)], 2, 0, samples=8),
        "tune": lambda: jb.tune(r, (None, y), steps=0),
        "fit": lambda: jb.fit((None, np.sin(np.arange(40.0))[:, None]), order=2, horizon=3),
    }


def dataset(relations):
    import pandas as pd

    with tempfile.TemporaryDirectory() as folder:
        pd.DataFrame({"y1": [1.0, 0.5, 0.9, 0.45]}).to_parquet(f"{folder}/run.parquet")
        try:
            return jb.detect_dataset(relations, f"{folder}/run.parquet", f"{folder}/out")
        finally:
            left = [p.name for p in Path(folder).rglob("*")]
            assert left == ["run.parquet"] or "verdicts.parquet" in left, left


OF_SETS = {
    "inclusion",
    "inclusion.continuous",
    "inclusion.jacobian",
    "pave",
    "pave, excluding",
    "solve_interval",
    "membership",
    "sets.support",
}
"""Doors that take arrays where these are, and prove there or refuse."""

EXACT_OR_UNPROVED = {
    # values; their methods speak of what was proved already, or in exact rationals
    "AlarmRule",
    "Result",
    "Fault",
    "NamedFault",
    "Recipe",
    "LinearSystem",
    "MultiModel",
    "Recording",
    "Status",
    "Uncertainty",
    "read",
    # exact rationals on the host
    "detectable",
    "from_control",
    "from_scipy",
    "interval",
    "interval_system",
    "isolability",
    "load_model",
    "look",
    "parity_relations",
    "redundancy",
    "residual",
    "save_model",
    "signatures",
    "strips",
    "structured_relations",
    "with_faults",
    "zonotope",
    # a setting
    "compile",
    # no proof is claimed; evaluate compares residuals with a hull, as sure as the hull is
    "evaluate",
    "margins",
    "plot",
    "sets",
    "simulate",
    "suggest_lags",
    "use_cache",
}


def answers():
    """Return {name of a door: why it refused, in its words, or None where it answered}."""
    found = {}
    for name, call in doors().items():
        try:
            call()
            found[name] = None
        except RuntimeError as e:
            found[name] = str(e)
    return found


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print(json.dumps(answers()))
