"""The paper's scenario: how often each fault is seen, against golden Monte-Carlo rates."""

from functools import cache

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status

pytestmark = pytest.mark.compiled

RUNS, SAMPLES = 3000, 201
FAULTS = {
    "A": jb.Fault("y2", "tolerance", 0.16, 20, 60),
    "B": jb.Fault("y1", "noise", 0.35, 80, 120),
    "C": jb.Fault("y1", "bias", 0.2, 140, 180),
}


@pytest.fixture(scope="module")
def scenario(module_seed):
    """Return a function hold -> (u, y) of 3000 runs with the three faults, drawn once."""
    drawn = {}

    def draw(hold):
        if hold not in drawn:
            rng = np.random.default_rng(module_seed + hold)
            u = np.repeat(rng.uniform(-1, 1, (RUNS, SAMPLES // hold + 1, 1)), hold, 1)[:, :SAMPLES]
            t = jb.simulate(paper(), u, jax.random.key(module_seed + hold), faults=list(FAULTS.values()))
            drawn[hold] = np.asarray(t.u), np.asarray(t.y)
        return drawn[hold]

    return draw


@pytest.fixture(scope="module")
def found(scenario):
    """Return a function that gives FAULT (runs, T), worked out once."""

    @cache
    def detect(horizon, hold=20, method="joint"):
        u, y = (x[: 1000 if horizon > 4 else RUNS] for x in scenario(hold))
        return (
            jb.detect(jb.parity_relations(paper(), horizon=horizon), u, y, method=method).status
            == Status.FAULT
        )

    return detect


def check(fault, name, horizon, expected, golden_runs):
    """Compare the rate over windows wholly inside the fault with a golden rate, within 4.5 standard errors of
    both (blocks: runs).
    """
    of_runs = fault[:, FAULTS[name].start + horizon : FAULTS[name].stop].mean(1)
    error = of_runs.std() * (1 / len(of_runs) + 1 / golden_runs) ** 0.5
    print(
        f"{name} s={horizon}: {of_runs.mean():.4f}, golden {expected:.4f}, "
        f"{(of_runs.mean() - expected) / error:+.1f} standard errors"
    )
    assert abs(of_runs.mean() - expected) < 4.5 * error
    assert error < 0.05 * expected


@pytest.mark.parametrize("method", ["joint", "box"])
@pytest.mark.parametrize("hold", [10, 20, 50])
@pytest.mark.parametrize("name", FAULTS)
def test_detection_rate_is_the_golden_one(name, hold, method, found, golden):
    expected = golden["p0"]["scenario_mc"][f"hold{hold}"]
    check(found(1, hold, method), name, 1, expected[name][f"rate_{method}"], expected["runs"])


@pytest.mark.parametrize("row", [1, 3])
@pytest.mark.parametrize("name", FAULTS)
def test_without_a_sample_of_y2_the_surviving_circuit_finds_as_much_as_golden(name, row, scenario, golden):
    """Row 1 is y2 of the older sample of a window (the paper's y2(k)), row 3 that of the newer one."""
    u, y = scenario(20)
    holes = y.copy()
    holes[:, ::2, 1] = np.nan  # windows that end at an even sample lack the newer one, the others the older
    seen = jb.detect(jb.parity_relations(paper(), horizon=1), u, holes).status == Status.FAULT
    inside = np.arange(FAULTS[name].start + 1, FAULTS[name].stop)
    those = inside[inside % 2 == (row == 1)]
    seen[:, inside] = seen[:, np.resize(those, len(inside))]
    expected = golden["p0"]["scenario_mc"]["hold20"]
    check(seen, name, 1, expected[name]["rate_per_circuit_drop_col"][row], expected["runs"])


@pytest.mark.parametrize("horizon", [1, 2, 3, 4, 6])
def test_detection_rate_grows_with_the_horizon_as_golden(horizon, found, golden):
    fault = found(horizon)
    for name in FAULTS:
        check(
            fault,
            name,
            horizon,
            golden["p0"]["float_and_horizon"]["horizon"][f"s{horizon}"]["rate"][name],
            1000,
        )


@pytest.mark.parametrize("horizon", [1, 3])
def test_windows_without_a_faulty_sample_are_never_called_fault(horizon, found):
    touched = np.zeros(SAMPLES, bool)
    for f in FAULTS.values():
        touched[f.start : f.stop + horizon] = True
    fault = found(horizon)
    assert not fault[:, ~touched].any()
    assert fault[:, touched].any()


def test_every_window_that_the_box_finds_is_found_jointly_and_more(found):
    box, joint = found(1, method="box"), found(1)
    assert not (box & ~joint).any()
    assert joint.sum() > 1.2 * box.sum()
