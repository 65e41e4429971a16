"""Errors that average out: bounds on sums of consecutive samples are rows of the same exact test."""

import json
from dataclasses import replace
from fractions import Fraction
from functools import cache, partial

import check_certificate
import highspy
import jax
import linear_programs
import numpy as np
import pytest
from agreement import certificates_hold, monitor_agrees

import jaxbound as jb
from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.exchange import candidates
from jaxbound.consistency.projection import _of_stretch
from jaxbound.consistency.reading import gather
from jaxbound.models.modelfile import load_model, save_model

PLANT = dict(
    A=[["0.9", "0.1"], [0, "0.8"]],
    B=[["0.1"], ["0.2"]],
    C=[[1, 0], [0, 1]],
    noise=[0.5, 0.25],
    offset={"y": [20, 0]},
)
WALK = ([[1], ["0.5"]], 0.1)
MEAN = ["1/3"] * 3
# short windows by circuits, long ones by search, with disturbances, lags, other weights and what is rounded
# away
CASES = {
    "short": (
        dict(averages={"y1": [(MEAN, 0.2), ([1, -2, 1], 0.4), (["1/3", "2/3"], 0.3)]}),
        dict(horizon=2),
    ),
    "disturbed": (
        dict(averages={"y1": {4: 0.2}, "y2": {2: 0.15}, "w1": {3: 0.04}}, disturbance=WALK, resolution=0.05),
        dict(horizon=5),
    ),
    "lags": (dict(averages={"y1": {3: 0.2}, "w1": [([1, -1], 0.1)]}, disturbance=WALK), dict(lags=(0, 1, 6))),
}
SAMPLES, RUNS = 60, (8, 100, 1)
SLOW = pytest.mark.long  # one more search compiled each


@cache
def relations(kind):
    more, window = CASES[kind]
    return jb.parity_relations(jb.LinearSystem(**PLANT, **more), **window)


@cache
def detected(kind):
    r = relations(kind)
    rng = np.random.default_rng(5)
    u = rng.uniform(-1, 1, (SAMPLES, 1))
    inside = r.model.replace(
        averages=tuple(replace(a, bound=a.bound * Fraction(9, 10)) for a in r.model.averages)
    )
    y = np.array(
        jb.simulate(inside, np.resize(u, RUNS), jax.random.key(1)).y[0, :SAMPLES]
    )  # at 0.9 of the averages: none is just kept
    y[SAMPLES // 2 :, 0] += rng.uniform(-1, 1, SAMPLES - SAMPLES // 2) * np.linspace(
        0.5, 4, SAMPLES - SAMPLES // 2
    )
    y[8:10, 0] = np.nan
    return u, y, jb.detect(r, u, y, margins="exact")


def consistent(model, s, lags, u, y, scale=1.0):
    """Say whether a first state, errors and disturbances explain a window, by a linear program with them all
    as unknowns.
    """
    solver = linear_programs.solver()
    A, B, C, G = (
        np.array([[float(x) for x in row] for row in M]).reshape(len(M), -1)
        for M in (model.A, model.B, model.C, model.G)
    )
    free = lambda bound: solver.addVariable(-bound * scale, bound * scale)
    x = [solver.addVariable(-highspy.kHighsInf, highspy.kHighsInf) for _ in range(len(A))]
    errors, walks = {}, {}
    dot = lambda row, values: sum((float(a) * v for a, v in zip(row, values, strict=True)), 0 * x[0])
    runs = [(a, j) for a in model.averages for j in range(s + 1) if j + 1 >= len(a.weights)]
    averaged = {
        (a.signal, i)
        for a, j in runs
        if a.signal in model.outputs and s - j in lags
        for i in range(j + 1 - len(a.weights), j + 1)
    }
    for j in range(s + 1):
        for i, name in enumerate(model.outputs):
            rho = float(model.noise[i] + model.resolution[i])
            if np.isnan(y[j, i]) or not (s - j in lags or (name, j) in averaged):
                continue
            errors[name, j] = solver.addVariable(-highspy.kHighsInf, highspy.kHighsInf)
            solver.addConstr(errors[name, j] + dot(C[i], x) == y[j, i] - float(model.offset["y"][i]))
            if s - j in lags:
                solver.addConstr(errors[name, j] <= rho * scale)
                solver.addConstr(errors[name, j] >= -rho * scale)
        if j < s:
            now = [free(float(hi)) for _, hi in model.disturbance]
            walks |= {(f"w{c + 1}", j): v for c, v in enumerate(now)}
            following = [solver.addVariable(-highspy.kHighsInf, highspy.kHighsInf) for _ in x]
            for k, new in enumerate(following):
                drive = sum((float(g) * v for g, v in zip(G[k], now, strict=True)), 0 * new)
                solver.addConstr(new == dot(A[k], x) + drive + float(B[k] @ u[j]))
            x = following
    for a, j in runs:
        mine = [
            (errors if a.signal in model.outputs else walks).get((a.signal, i))
            for i in range(j + 1 - len(a.weights), j + 1)
        ]
        if any(v is None for v in mine) or (a.signal in model.outputs and s - j not in lags):
            continue
        rounded = float(model.resolution[model.outputs.index(a.signal)]) if a.signal in model.outputs else 0.0
        bound = (float(a.bound) + rounded * float(sum(map(abs, a.weights)))) * scale
        total = sum((float(f) * v for f, v in zip(a.weights, mine, strict=True)), 0 * x[0])
        solver.addConstr(total <= bound)
        solver.addConstr(total >= -bound)
    return linear_programs.is_feasible(solver)


@pytest.mark.parametrize("kind", CASES)
def test_verdicts_and_the_size_of_margins_are_those_of_a_linear_program(kind):
    u, y, res = detected(kind)
    r = relations(kind)
    s, lags = r.horizon, r.lags or range(r.horizon + 1)
    assert res.counts["UNDECIDED"] == 0 and res.counts["FAULT"] > 3 and res.counts["CONSISTENT"] > 3
    for k in range(s, SAMPLES, 5):
        part = slice(k - s, k + 1)
        assert consistent(r.model, s, lags, u[part], y[part]) == (res.status[k] == jb.Status.CONSISTENT)
        if res.margin[k] < 0.99:
            near = [
                consistent(r.model, s, lags, u[part], y[part], (1 - res.margin[k]) * f)
                for f in (1 - 1e-4, 1 + 1e-4)
            ]
            assert near == [False, True]


@pytest.mark.parametrize("kind", ["disturbed", pytest.param("lags", marks=SLOW)])
@pytest.mark.usefixtures("many", "as_compiled")
def test_windows_that_are_settled_first_have_margins_that_a_linear_program_confirms(kind):
    u, y, exact = detected(kind)
    r = relations(kind)
    res, s, lags = jb.detect(r, u, y), r.horizon, r.lags or range(r.horizon + 1)
    np.testing.assert_array_equal(res.status, exact.status)
    bounds = {jb.Status.CONSISTENT: 0, jb.Status.FAULT: 0}
    for k in range(s, SAMPLES, 3):
        part = slice(k - s, k + 1)
        inside, factor = res.status[k] == jb.Status.CONSISTENT, 1 - res.margin[k]
        if abs(res.margin[k] - exact.margin[k]) > 1e-6:  # else no bound
            bounds[jb.Status(int(res.status[k]))] += 1
        factor *= 1 + (2 * inside - 1) * 1e-6
        assert consistent(r.model, s, lags, u[part], y[part], factor) == inside
    assert min(bounds.values()) > 0


def test_a_stretch_is_settled_with_the_inputs_that_runs_add_up():
    r = relations("disturbed")
    u = np.random.default_rng(6).uniform(-90, 90, (SAMPLES, 1))
    y = np.array(jb.simulate(r.model, np.resize(u, RUNS), jax.random.key(2)).y)[0, :SAMPLES]
    given = r.test("joint", y.dtype).easy.stretches.constants
    proved = np.concatenate([np.zeros(r.horizon), _of_stretch(given, u, y)])
    assert (proved > 0).mean() > 0.4
    for k in np.flatnonzero(proved > 0)[::9]:
        part = slice(k - r.horizon, k + 1)
        factor = (1 - proved[k]) * (1 + 1e-9)
        assert consistent(r.model, r.horizon, range(r.horizon + 1), u[part], y[part], factor)


def test_combinations_of_runs_contradict_in_numpy_what_has_no_solution(rng):
    """No FAULT is left to whole numbers; nothing CONSISTENT is contradicted, neither by what speaks most
    against it nor by any other combination.
    """
    u, y, exact = detected("disturbed")
    test = relations("disturbed").test("joint", y.dtype)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(test), "exactly", lambda *_: pytest.fail("a hint proves nothing"))
        found = [jb.detect(relations("disturbed"), u, y, margins=margins) for margins in ("bounds", "exact")]
    for res in found:
        np.testing.assert_array_equal(res.status, exact.status)
    # sensors that lean to one side: means are what binds
    quiet = relations("disturbed").model.replace(averages=None, noise=[0.01, 0.01])
    lean = np.repeat(rng.choice([-1, 1], SAMPLES // 4), 4) * np.linspace(0.1, 0.6, SAMPLES)
    y = np.array(jb.simulate(quiet, u, jax.random.key(2)).y) + lean[:, None] * [1, 0]
    exact = jb.detect(relations("disturbed"), u, y, margins="exact")
    ends = np.resize(np.flatnonzero(exact.status == jb.Status.CONSISTENT), test.block)
    assert exact.margin[ends].min() < 0.1
    windows = gather(u, y, ends - test.horizon, test.lags, test.horizon)
    worst = np.asarray(candidates(test.constants, np.ones(test.block), *windows)[0])
    kept = [rng.normal(size=worst.shape) * (rng.random(worst.shape) < share) for share in (0.1, 0.4, 1)]
    for h in (worst, *kept):
        assert not contradicted_by(test.reading, *windows, h).any()


@pytest.mark.parametrize("kind", ["short", "disturbed", pytest.param("lags", marks=SLOW)])
def test_unproved_margins_are_those_of_detect(kind):
    u, y, res = detected(kind)
    unproved = np.asarray(jb.margins(relations(kind), u, y))
    seen = ~np.isnan(unproved) & ~np.isnan(res.margin)
    np.testing.assert_allclose(unproved[seen], res.margin[seen], atol=1e-7)


def drawn(rng):
    """Return (a random model with averages, arguments of its windows): stable or not, of outputs,
    disturbances or both.
    """
    n, p, g = (int(x) for x in (rng.integers(1, 4), rng.integers(1, 4), rng.integers(0, 3)))
    A = rng.normal(size=(n, n))
    A = (A * rng.choice([0.5, 0.9, 1.0, 1.05]) / abs(np.linalg.eigvals(A)).max()).round(3)
    B, C, G = (rng.normal(size=shape).round(2) for shape in ((n, 1), (p, n), (n, g)))
    s = int(rng.integers(n + 1, 9))
    averages = {}
    for _ in range(rng.integers(1, 4)):
        signal = str(rng.choice([*(f"y{i + 1}" for i in range(p)), *(f"w{j + 1}" for j in range(g))]))
        length = int(rng.integers(2, min(s + 1, 6) + 1))
        weights = rng.integers(-3, 4, length)
        weights[[0, -1]] = rng.choice([-2, -1, 1, 2], 2)
        mean = bool(rng.random() < 0.6)
        size = (0.3 if signal[0] == "y" else 0.1) * (1 if mean else abs(weights).sum())
        f = [Fraction(1, length)] * length if mean else weights.tolist()
        averages.setdefault(signal, []).append((f, round(rng.uniform(0.05, 0.8) * size, 3)))
    walks = {"disturbance": (G, rng.uniform(0.02, 0.2, g).round(2))} if g else {}
    model = jb.LinearSystem(
        A,
        B,
        C,
        noise=rng.uniform(0.1, 0.5, p).round(2),
        resolution=rng.choice([0, 0.02], p),
        offset={"y": rng.normal(size=p).round(1)},
        averages=averages,
        **walks,
    )
    lags = sorted({0, s, *rng.integers(0, s + 1, s).tolist()}) if rng.random() < 0.3 else None
    return model, {"horizon": s} if lags is None else {"lags": lags}


def compared(rng, models, each=12):
    """Return (windows of random models judged by a linear program too, how many have a missing sample, how
    many a FAULT).
    """
    windows = broken = faults = 0
    for _ in range(models):
        model, how = drawn(rng)
        try:
            r = jb.parity_relations(model, **how)
        except ValueError as e:
            assert "relation" in str(e)
            continue
        s, T = r.horizon, r.horizon + 40
        lags = r.lags or range(s + 1)
        u = rng.uniform(-1, 1, (T, 1))
        y = np.array(jb.simulate(model, u, int(rng.integers(2**31))).y)
        y += rng.normal(size=y.shape) * np.geomspace(0.01, 3, T)[:, None] * [float(x) for x in model.noise]
        y[rng.random(y.shape) < 0.02] = np.nan
        found = jb.detect(r, u, y, margins="exact")
        seen = np.flatnonzero(found.status != jb.Status.MISSING)
        for k in rng.permutation(seen)[:each]:
            part = slice(k - s, k + 1)
            say = partial(consistent, model, s, lags, u[part], y[part])
            gauge = 1 - float(found.margin[k])
            assert found.status[k] != jb.Status.UNDECIDED or abs(gauge - 1) < 1e-9
            if abs(gauge - 1) > 1e-5:
                assert say(1.0) == (found.status[k] == jb.Status.CONSISTENT)
            if gauge > 1e-2:
                assert [say(gauge * f) for f in (1 - 1e-4, 1 + 1e-4)] == [False, True]
            windows, faults = windows + 1, faults + int(found.status[k] == jb.Status.FAULT)
            broken += int(np.isnan(y[part]).any())
    print(
        f"{windows} windows of random models, all as a linear program says; {faults} FAULT, {broken} with a "
        f"missing sample"
    )
    return windows, broken, faults


@pytest.mark.long(by_day="test_verdicts_and_the_size_of_margins_are_those_of_a_linear_program")
def test_random_models_agree_with_linear_programs(rng):
    windows, broken, faults = compared(rng, 6, 20)
    assert windows >= 60 and broken and 0.1 * windows < faults < 0.95 * windows


@pytest.mark.long(by_day="test_verdicts_and_the_size_of_margins_are_those_of_a_linear_program")
def test_many_random_models_agree_with_linear_programs(rng):
    windows, broken, faults = compared(rng, 150, 20)
    assert windows >= 2000 and broken > 100 and 0.1 * windows < faults < 0.95 * windows


@pytest.mark.parametrize("kind", ["short", pytest.param("lags", marks=SLOW)])
def test_a_monitor_says_the_same(kind):
    monitor_agrees(relations(kind), *detected(kind))


@pytest.mark.parametrize("kind", CASES)
def test_certificates_are_checked_by_fractions_alone(kind):
    certificates_hold(detected(kind)[2])


def test_a_certificate_with_another_bound_of_an_average_is_refused():
    res = detected("disturbed")[2]
    told = json.loads(res.explain(int(np.argmax(res.status == jb.Status.FAULT))).to_json())
    assert any(Fraction(x) for x in told["numbers"]["relation"]["a"])
    change = told["numbers"]["averages"][0]
    told["numbers"]["sum"] = str(Fraction(told["numbers"]["sum"]) + 1 - Fraction(change["bound"]))
    change["bound"] = "1"
    with pytest.raises(ValueError, match="residual, width or factor"):
        check_certificate.confirm(told)


@pytest.mark.parametrize(
    ("kind", "dtype"),
    [
        *((kind, np.float64) for kind in CASES),
        ("short", np.float32),
        pytest.param("lags", np.float32, marks=pytest.mark.long),
    ],
)
def test_what_is_simulated_keeps_its_averages_and_is_no_fault(kind, dtype):
    r = relations(kind)
    u = np.random.default_rng(7).uniform(-1, 1, RUNS).astype(dtype)
    for at in ("uniform", "vertices"):
        run = jb.simulate(r.model, u, jax.random.key(3), at=at)
        for a in r.model.averages:
            drawn = (
                run.noise[..., r.model.outputs.index(a.signal)]
                if a.signal in r.model.outputs
                else run.disturbance[..., 0]
            )
            flip = np.array([float(x) for x in a.weights])[::-1]
            sums = np.abs([np.convolve(v, flip, "valid") for v in np.asarray(drawn, np.float64)])
            assert 0.8 * float(a.bound) < sums.max() <= float(a.bound)
        assert jb.detect(r, u, run.y).counts["FAULT"] == 0


def test_averages_make_small_lasting_errors_visible():
    plain = jb.LinearSystem(**PLANT, disturbance=WALK)
    model = plain.replace(averages={"y1": {8: 0.1}, "y2": {8: 0.05}})
    sizes = [float(jb.detectable(m, "y1", 7)) for m in (plain, model)]
    assert sizes[1] < 0.95 * sizes[0] and jb.suggest_lags(model, 3, longest=8).sizes[0, 1, 8]["y1"] > 0


def test_model_files_and_copies_keep_averages(tmp_path):
    for kind in CASES:
        model = relations(kind).model
        save_model(model, tmp_path / "model.toml")
        assert load_model(tmp_path / "model.toml") == model == model.replace(name="model")
    assert (
        "averages = [{samples = 4, bound = 0.2}]" in (tmp_path / "model.toml").read_text()
        or kind != "disturbed"
    )
    assert model != model.replace(averages=None)


@pytest.mark.compiled
def test_tune_scales_averages_too():
    r = relations("short")
    u = np.random.default_rng(0).uniform(-1, 1, (SAMPLES, 1))
    y = np.asarray(jb.simulate(r.model, u, jax.random.key(0)).y)
    found = jb.tune(r, (u, y), steps=0, safety=1.0)
    assert (
        0.3 < float(found.model.averages[0].bound) / 0.2 < 1
        and found.model.averages[0].weights == r.model.averages[0].weights
    )
    only = jb.tune(r, (u, y), steps=0, bounds=["average"], safety=1.0)
    assert only.model.noise == r.model.noise and float(only.model.averages[0].bound) < 0.2
    res = jb.detect(jb.parity_relations(only.model, 2), u, y)
    assert res.counts["FAULT"] == 0


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (dict(averages={"z": {3: 1}}), "speak of 'z'"),
        (dict(averages={"y1": {1: 1}}), ">= 2"),
        (dict(averages={"y1": {3: -1}}), ">= 0"),
        (dict(averages={"y1": [([0, 1], 1)]}), "other than 0"),
        (dict(averages={"y1": {3: 1}}, tolerance=0.1), "tolerance to be 0"),
        (
            dict(averages={"w1": {3: 1}}, disturbance=WALK, constant_tolerance=True, tolerance=0.1),
            "do not go together",
        ),
        (dict(averages={"w1": {2: 0.1}}, disturbance=(WALK[0], [[0.5, 1]])), "no constant w1"),
        (dict(averages=[3]), "like"),
    ],
)
def test_what_are_no_averages_is_refused(more, said):
    with pytest.raises(ValueError, match=said):
        jb.LinearSystem(**PLANT, **more)


def test_other_methods_and_banks_look_at_single_samples():
    r = relations("short")
    with pytest.raises(ValueError, match="averages are tested by method 'joint'"):
        jb.detect(r, np.zeros((9, 1)), np.zeros((9, 2)), method="box")
    with pytest.raises((ValueError, NotImplementedError), match="averages"):
        jb.detect(jb.structured_relations(r.model), np.zeros((9, 1)), np.zeros((9, 2)))
