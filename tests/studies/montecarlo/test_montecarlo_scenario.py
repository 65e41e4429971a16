"""Studies against what others computed: golden rates, an independent simulation with a linear program, and
the smallest sizes that hide.
"""

import os
import subprocess
import sys

import highspy
import jax
import linear_programs
import numpy as np
import pytest
from oracles import MODELS, Plant, Windows, floats
from study_case import EXACT, GUST, simple, simulated
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.strips import strip_margin

FAULTS = {
    "A": jb.Fault("y2", "tolerance", 0.16, 20, 60),
    "B": jb.Fault("y1", "noise", 0.35, 80, 120),
    "C": jb.Fault("y1", "bias", 0.2, 140, 180),
}


def standard_error(tally):
    """Return the standard error of the rate of a study's only size, from its interval."""
    sums = (
        getattr(tally, name) for name in ("hits", "windows", "squares", "crossed", "squared", "scenarios")
    )
    hits, windows, squares, crossed, squared, n = (int(x[0]) for x in sums)
    rate = hits / windows
    return rate, (n / (n - 1) * (squares - 2 * rate * crossed + rate**2 * squared)) ** 0.5 / windows


@pytest.mark.long(by_day="diagnosis/test_scenario::test_detection_rate_grows_with_the_horizon_as_golden")
@pytest.mark.parametrize("hold", [10, 20, 50])
def test_rates_are_the_golden_ones(hold, golden, rng):
    expected = golden["p0"]["scenario_mc"][f"hold{hold}"]
    runs = 30_000
    res = jb.study(paper(), FAULTS.values(), 3 * runs, int(rng.integers(2**32)), samples=201, hold=hold)
    assert res.false_alarms[0] == 0
    for name, tally in zip(FAULTS, res.tallies, strict=True):
        rate, error = standard_error(tally)
        error *= (
            1 + runs / expected["runs"]
        ) ** 0.5  # golden's scenarios are as many as it says, and as different
        print(f"hold {hold} {name}: {rate:.4f} golden {expected[name]['rate_joint']:.4f}")
        assert abs(rate - expected[name]["rate_joint"]) < 4.5 * error and error < 0.03 * rate
        if "run_detect_joint" in expected[name]:
            share, seen = expected[name]["run_detect_joint"], tally.detected[0] / runs
            assert abs(seen - share) < 4.5 * (share * (1 - share) / expected["runs"]) ** 0.5 + 0.003


@pytest.mark.long(by_day="diagnosis/test_scenario::test_detection_rate_grows_with_the_horizon_as_golden")
@pytest.mark.parametrize("horizon", [2, 3, 4, 6])
def test_rates_grow_with_the_horizon_as_golden(horizon, golden, rng):
    """Golden has 1000 runs a horizon; longer windows go through recordings and `detect`."""
    runs = 4000
    relations = jb.parity_relations(paper(), horizon)
    res = jb.study(paper(), FAULTS.values(), 3 * runs, int(rng.integers(2**32)), relations, samples=201)
    expected = golden["p0"]["float_and_horizon"]["horizon"][f"s{horizon}"]["rate"]
    assert res.false_alarms[0] == 0
    for name, tally in zip(FAULTS, res.tallies, strict=True):
        rate, error = standard_error(tally)
        print(f"s {horizon} {name}: {rate:.4f} golden {expected[name]:.4f}")
        assert abs(rate - expected[name]) < 4.5 * error * (1 + runs / 1000) ** 0.5


def test_an_independent_simulation_and_a_linear_program_find_as_many(rng):
    """One window of each of 3000 recordings of a plain NumPy program, 150 .. 175 samples in, judged by
    HiGHS.
    """
    runs = 3000
    fault = lambda k, y, rng: y + (k >= 140) * np.array([0.2, 0])
    u, y = simulated(rng, runs, 176, 20, fault)
    at = rng.integers(150, 175, runs)
    window = at[:, None] + np.arange(2)
    pick = lambda a: np.take_along_axis(a, window[..., None], 1)
    slack = Windows(Plant(**MODELS["paper"]), 1).slack(pick(u), pick(y))
    expected = float((slack > 0).mean())
    res = jb.study(paper(), FAULTS["C"], 20_000, int(rng.integers(2**32)), samples=201)
    rate, error = standard_error(res.tallies[0])
    print(f"study {rate:.4f}, program {expected:.4f}")
    assert abs(rate - expected) < 4.5 * (error**2 + rate * (1 - rate) / runs) ** 0.5


@pytest.mark.parametrize(("name", "at"), [("offsets", "vertices"), ("gust", "uniform")])
def test_nothing_healthy_is_ever_called_fault(name, at, rng):
    """Before a fault, after it, and without one; an actuator's fault leaves a state that no healthy plant
    would have.
    """
    model, s = jb.LinearSystem(**MODELS.get(name, GUST)), 1
    relations, fault = jb.parity_relations(model, s), jb.Fault("u1", "bias", 9.0, 40, 60)
    res = jb.study(model, [fault], 8192, int(rng.integers(2**32)), relations, samples=100, at=at)
    false, clean = res.false_alarms
    assert false == 0 and clean == 8192 * (40 - s + 40 - s) and res.tallies[0].detected[0] > 4000


@pytest.mark.long(
    by_day="studies/test_study_families::test_a_study_finds_what_is_large_and_alarms_nobody_else"
)
@pytest.mark.parametrize("at", ["uniform", "vertices"])
def test_no_false_alarm_in_ten_million_healthy_windows(at, rng):
    for name in ("paper", "offsets", "gust", "feedthrough", "three states"):
        res = jb.study(
            jb.LinearSystem(**MODELS.get(name, GUST)),
            (),
            60_000,
            int(rng.integers(2**32)),
            samples=200,
            at=at,
        )
        print(at, name, res.false_alarms)
        assert res.false_alarms[0] == 0 and res.false_alarms[1] > 1e7


@pytest.mark.long(by_day="consistency/test_long_windows::test_verdicts_are_sharp")
def test_a_plain_comparison_would_be_wrong_at_the_vertices(rng):
    """Healthy windows with every unknown at a bound: a plain comparison calls some per cent of them outside,
    the proof none.
    """
    u = np.repeat(rng.uniform(-1, 1, (500, 10, 1)), 20, 1)
    relations = jb.parity_relations(paper())
    run = jb.simulate(paper(), u, jax.random.key(int(rng.integers(2**32))), at="vertices")
    y = np.asarray(run.y)
    test = relations.reading(np.float64)
    bare = jb.parity_relations(paper()).with_bounds(relations.bounds)
    pairs = [[u[:, :-1, 0]], [u[:, 1:, 0]]], [[y[:, :-1, 0], y[:, :-1, 1]], [y[:, 1:, 0], y[:, 1:, 1]]]
    mid, rad = [], []
    for row in pairs[1]:  # without the few ulps that a recorder may lose
        for value, sigma, rho in zip(row, test.tolerance, test.noise, strict=True):
            e = 1 / ((1 - sigma) * (1 + sigma))
            mid.append(e * (value + sigma * np.clip(value, -rho, rho)))
            rad.append(e * (rho + sigma * np.maximum(abs(value), rho)))
    wrong = float(
        (np.asarray(strip_margin(test.shape, *map(jax.numpy.stack, (mid, rad, [pairs[0][0][0]])))) < 0).mean()
    )
    print(f"plain comparison: {100 * wrong:.2f} % of {pairs[0][0][0].size} windows wrongly outside")
    assert 0.003 < wrong < 0.1
    assert not (jb.detect(bare, u, y).status == Status.FAULT).any()


@pytest.mark.long(
    by_day="studies/test_study_families::test_a_study_finds_what_is_large_and_alarms_nobody_else"
)
def test_every_kind_of_model_and_fault_is_counted_without_a_false_alarm(rng):
    """Long windows, uncertain parameters, unknown inputs, constant gains, sensors without noise: through
    recordings.
    """
    uncertain = simple(uncertainties=[jb.Uncertainty("k", B=[[0.1]], varying=False)])
    kinds = [
        "y1:bias",
        "y1:drift",
        "y1:gain",
        "y1:noise",
        "y1:tolerance",
        "y1:stuck",
        "y1:dropout",
        "u1:bias",
        "u1:dropout",
    ]
    res = jb.study(
        simple(constant_tolerance=True), kinds, 9 * 20, int(rng.integers(2**32)), samples=40, sizes=[0.9]
    )
    assert res.false_alarms[0] == 0 and res.settings["engine"] == "written"
    shares = {t.label: int(x.detected[0]) for t, x in zip(res.trials, res.tallies, strict=True)}
    assert (
        shares["y1:dropout"] == 0
        and min(shares[k] for k in ("y1:bias", "y1:drift", "y1:stuck", "u1:bias")) > 10
    )
    for model in (
        uncertain,
        simple(noise=0),
        simple(C=[[1], [1]], unknown_inputs=[[1]], noise=[0.1, 0.1], tolerance=[0, 0]),
    ):
        res = jb.study(
            model, ["y1:bias"], 30, int(rng.integers(2**32)), samples=40, sizes=[1.5], at="vertices"
        )
        assert res.false_alarms[0] == 0 and res.tallies[0].detected[0] > 20


@pytest.mark.long(
    by_day="studies/montecarlo/test_montecarlo::test_counts_are_those_of_detect_on_the_same_recordings"
)
def test_the_same_rates_through_recordings(rng):
    """Both ways of a study on one model: fused, and written out because a resolution stands in for the
    noise.
    """
    fused = jb.study(
        simple(), ["y1:tolerance", "y1:bias"], 8000, int(rng.integers(2**32)), samples=50, sizes=[0.4]
    )
    written = jb.study(
        simple(constant_tolerance=True, tolerance=0), ["y1:bias"], 2000, 5, samples=50, sizes=[0.25]
    )
    plain = jb.study(simple(tolerance=0), ["y1:bias"], 8000, 6, samples=50, sizes=[0.25])
    assert (
        fused.settings["engine"] == plain.settings["engine"] == "counted"
        and written.settings["engine"] == "written"
    )
    (a, one), (b, two) = standard_error(written.tallies[0]), standard_error(plain.tallies[0])
    assert 0.02 < a < 0.98 and abs(a - b) < 4.5 * (one**2 + two**2) ** 0.5


def hidden_at(model, size, samples, s):
    """Return the least t at which noises in their bounds keep every window of a scenario with a bias of y1
    within t times its widths.

    One linear program over the noises of all samples and a state for each window; the trajectory itself drops
    out. HiGHS.
    """
    plant = Plant(**model)
    O = floats(plant.window(s)[0])
    p, n, count = plant.p, plant.n, samples - s
    noise = np.array([float(x) for x in plant.noise])
    columns = samples * p + count * n + 1
    rows, upper = [], []
    for k in range(count):
        for j in range(s + 1):
            for i in range(p):
                row = np.zeros(columns)
                row[(k + j) * p + i] = 1
                row[samples * p + k * n : samples * p + (k + 1) * n] = -O[j * p + i]
                shift = size if i == 0 else 0.0
                for sign in (1, -1):
                    bound = sign * row
                    bound[-1] = -noise[i]
                    rows.append(bound)
                    upper.append(-sign * shift)
    lp = highspy.HighsLp()
    M = np.array(rows)
    lp.num_col_, lp.num_row_ = columns, len(rows)
    cost = np.zeros(columns)
    cost[-1] = 1
    lp.col_cost_ = cost
    limit = np.r_[np.tile(noise, samples), np.full(count * n, np.inf), np.inf]
    lp.col_lower_, lp.col_upper_ = -limit, limit
    lp.row_lower_, lp.row_upper_ = np.full(len(rows), -np.inf), np.array(upper)
    lp.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    lp.a_matrix_.start_ = np.arange(0, M.size + 1, columns)
    lp.a_matrix_.index_, lp.a_matrix_.value_ = np.tile(np.arange(columns), len(rows)), M.ravel()
    solver = linear_programs.solver()
    solver.passModel(lp)
    assert linear_programs.is_feasible(solver)
    return solver.getObjectiveValue()


@pytest.mark.long(by_day="studies/test_study_families::test_an_adversary_says_which_tests_it_knows")
def test_the_adversary_hides_whatever_a_linear_program_can_hide():
    """A bias from the first sample on, windows of four samples, scenarios of twelve: up to 2 % below the size
    that the program hides.
    """
    model, samples, s = EXACT, 12, 3
    low, high = 0.1, 3.0
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if hidden_at(model, middle, samples, s) <= 1 else (low, middle)
    relations = jb.parity_relations(jb.LinearSystem(**model), s)
    sizes = [0.98 * low, 1.0005 * low]
    res = jb.study(
        jb.LinearSystem(**model),
        "y1:bias",
        40,
        1,
        relations,
        samples=samples,
        onset=0,
        sizes=sizes,
        at="adversarial",
    )
    print(
        f"hidden up to {low:.4f}, guaranteed for one window {res.trials[0].guaranteed:.4f}: "
        f"{res.tallies[0].detected}"
    )
    assert res.tallies[0].detected.tolist() == [0, 20] and low <= res.trials[0].guaranteed


@pytest.mark.parametrize(
    ("devices", "count"), [(2, 2000), *(pytest.param(n, 40_000, marks=pytest.mark.long) for n in (2, 4, 8))]
)
def test_counts_are_the_same_on_many_devices(devices, count, kernels):
    """Blocks sharded over virtual devices of a process of its own, and one block after the other in this
    one.
    """
    code = (
        "import jax; jax.config.update('jax_enable_x64', True); import jaxbound as jb;"
        "m = jb.LinearSystem([[0.8]], [[1]], [[1]], noise=0.1, tolerance=0.005);"
        f"r = jb.study(m, ['y1:bias', 'u1:bias'], {count}, 3, sizes=[0.1, 0.4], samples=40, at='vertices');"
        "print(jax.local_device_count(), [{k: x.tolist() for k, x in t.arrays().items()} for t in r.tallies])"
    )
    env = os.environ | {
        "XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}",
        "JAX_PLATFORMS": "cpu",
    }
    out = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    ).stdout
    here = jb.study(simple(), ["y1:bias", "u1:bias"], count, 3, sizes=[0.1, 0.4], samples=40, at="vertices")
    assert out == f"{devices} {[{k: x.tolist() for k, x in t.arrays().items()} for t in here.tallies]}\n"


def test_an_adversary_hides_every_fault_below_the_guaranteed_size_and_none_above():
    """A window's worth of samples: the guaranteed size is exact then. A longer scenario can only be harder to
    hide in.
    """
    model = jb.LinearSystem(**EXACT)
    sure = float(jb.detectable(model, "y1", 1, 10))
    res = jb.study(
        model,
        "y1:bias",
        64,
        1,
        samples=2,
        onset=0,
        sizes=[0.5 * sure, 0.98 * sure, 1.001 * sure, 1.2 * sure],
        at="adversarial",
    )
    assert res.tallies[0].detected.tolist() == [0, 0, 16, 16]
    assert abs(res.trials[0].guaranteed / sure - 1) < 1e-9


def test_bounds_that_are_not_the_plants_show_as_false_alarms():
    """A monitor that believes in half the noise: the study says how often it is wrong."""
    monitor = jb.parity_relations(simple(noise=0.05))
    false, clean = jb.study(simple(), (), 4096, 0, monitor, samples=60).false_alarms
    assert 0.01 < false / clean < 0.5


def test_in_float32_nothing_healthy_is_fault_either(rng):
    """Also where a context of the calling thread says so: the blocks run in other threads."""
    with jax.enable_x64(False):
        res = jb.study(
            simple(),
            jb.Fault("y1", "bias", 0.5, 40),
            8192,
            int(rng.integers(2**32)),
            samples=60,
            at="vertices",
        )
    assert (
        res.settings["dtype"] == "float32"
        and res.false_alarms == (0, 8192 * 39)
        and res.tallies[0].detected[0] > 8000
    )
