"""Errors that average out: bounds on sums of consecutive samples are rows of the same exact test."""

import json
from dataclasses import replace
from fractions import Fraction
from functools import cache

import check_certificate
import highspy
import jax
import numpy as np
import pytest
from agreement import certificates_hold, monitor_agrees

import jaxbound as jb
from jaxbound.models.modelfile import load_model, save_model

PLANT = dict(A=[["0.9", "0.1"], [0, "0.8"]], B=[["0.1"], ["0.2"]], C=[[1, 0], [0, 1]], noise=[0.5, 0.25], offset={"y": [20, 0]})
WALK = ([[1], ["0.5"]], 0.1)
CASES = {  # short windows by circuits, long ones by search, with disturbances, lags, other weights and what is rounded away
    "short": (dict(averages={"y1": {3: 0.2}}), dict(horizon=2)),
    "long": (dict(averages={"y1": {4: 0.2}, "y2": {2: 0.15}}), dict(horizon=6)),
    "disturbed": (dict(averages={"y1": {4: 0.2}, "w1": {3: 0.04}}, disturbance=WALK, resolution=0.05), dict(horizon=5)),
    "lags": (dict(averages={"y1": {3: 0.2}, "w1": [([1, -1], 0.1)]}, disturbance=WALK), dict(lags=(0, 1, 6))),
    "weights": (dict(averages={"y1": [([1, -2, 1], 0.4), (["1/3", "2/3"], 0.3)]}), dict(horizon=3)),
}
SAMPLES = 60


@cache
def relations(kind):
    more, window = CASES[kind]
    return jb.parity_relations(jb.LinearSystem(**PLANT, **more), **window)


@cache
def detected(kind):
    r = relations(kind)
    rng = np.random.default_rng(5)
    u = rng.uniform(-1, 1, (SAMPLES, 1))
    inside = r.model.replace(averages=tuple(replace(a, bound=a.bound * Fraction(9, 10)) for a in r.model.averages))
    y = np.array(jb.simulate(inside, u, jax.random.key(1)).y)  # at 0.9 of the averages: none of them is just kept
    y[SAMPLES // 2 :, 0] += rng.uniform(-1, 1, SAMPLES - SAMPLES // 2) * np.linspace(0.5, 4, SAMPLES - SAMPLES // 2)
    y[8:10, 0] = np.nan
    return u, y, jb.detect(r, u, y)


def consistent(model, s, lags, u, y, scale=1.0):
    """Say whether a first state, errors and disturbances explain a window, by a linear program with them all as unknowns."""
    solver = highspy.Highs()
    solver.silent()
    A, B, C, G = (np.array([[float(x) for x in row] for row in M]).reshape(len(M), -1) for M in (model.A, model.B, model.C, model.G))
    free = lambda bound: solver.addVariable(-bound * scale, bound * scale)
    x = [solver.addVariable(-highspy.kHighsInf, highspy.kHighsInf) for _ in range(len(A))]
    errors, walks = {}, {}
    dot = lambda row, values: sum((float(a) * v for a, v in zip(row, values, strict=True)), 0 * x[0])
    runs = [(a, j) for a in model.averages for j in range(s + 1) if j + 1 >= len(a.weights)]
    averaged = {(a.signal, i) for a, j in runs if a.signal in model.outputs and s - j in lags for i in range(j + 1 - len(a.weights), j + 1)}
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
        mine = [(errors if a.signal in model.outputs else walks).get((a.signal, i)) for i in range(j + 1 - len(a.weights), j + 1)]
        if any(v is None for v in mine) or (a.signal in model.outputs and s - j not in lags):
            continue
        rounded = float(model.resolution[model.outputs.index(a.signal)]) if a.signal in model.outputs else 0.0
        bound = (float(a.bound) + rounded * float(sum(map(abs, a.weights)))) * scale
        total = sum((float(f) * v for f, v in zip(a.weights, mine, strict=True)), 0 * x[0])
        solver.addConstr(total <= bound)
        solver.addConstr(total >= -bound)
    solver.run()
    return solver.getModelStatus() == highspy.HighsModelStatus.kOptimal


@pytest.mark.parametrize("kind", CASES)
def test_verdicts_and_margins_are_those_of_a_linear_program(kind):
    u, y, res = detected(kind)
    r = relations(kind)
    s, lags = r.horizon, r.lags or range(r.horizon + 1)
    assert res.counts["UNDECIDED"] == 0 and res.counts["FAULT"] > 3 and res.counts["CONSISTENT"] > 3
    for k in range(s, SAMPLES, 5):
        part = slice(k - s, k + 1)
        assert consistent(r.model, s, lags, u[part], y[part]) == (res.status[k] == jb.Status.CONSISTENT)
        if res.margin[k] < 0.99:
            near = [consistent(r.model, s, lags, u[part], y[part], (1 - res.margin[k]) * f) for f in (1 - 1e-4, 1 + 1e-4)]
            assert near == [False, True]
    unproved = np.asarray(jb.margins(r, u, y))
    seen = ~np.isnan(unproved) & ~np.isnan(res.margin)
    np.testing.assert_allclose(unproved[seen], res.margin[seen], atol=1e-7)


@pytest.mark.parametrize("kind", ["short", "lags"])
def test_a_monitor_says_the_same(kind):
    monitor_agrees(relations(kind), *detected(kind))


@pytest.mark.parametrize("kind", CASES)
def test_certificates_are_checked_by_fractions_alone(kind):
    certificates_hold(detected(kind)[2])


def test_a_certificate_with_another_bound_of_an_average_is_refused():
    res = detected("long")[2]
    told = json.loads(res.explain(int(np.argmax(res.status == jb.Status.FAULT))).to_json())
    assert any(Fraction(x) for x in told["numbers"]["relation"]["a"])
    change = told["numbers"]["averages"][0]
    told["numbers"]["sum"] = str(Fraction(told["numbers"]["sum"]) + 1 - Fraction(change["bound"]))
    change["bound"] = "1"
    with pytest.raises(ValueError, match="residual, width or factor"):
        check_certificate.confirm(told)


@pytest.mark.parametrize(("kind", "dtype"), [*((kind, np.float64) for kind in CASES), ("short", np.float32), ("lags", np.float32)])
def test_what_is_simulated_keeps_its_averages_and_is_no_fault(kind, dtype):
    r = relations(kind)
    u = np.random.default_rng(7).uniform(-1, 1, (8, 300, 1)).astype(dtype)
    for at in ("uniform", "vertices"):
        run = jb.simulate(r.model, u, jax.random.key(3), at=at)
        for a in r.model.averages:
            drawn = run.noise[..., r.model.outputs.index(a.signal)] if a.signal in r.model.outputs else run.disturbance[..., 0]
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
    assert "averages = [{samples = 4, bound = 0.2}]" in (tmp_path / "model.toml").read_text() or kind != "disturbed"
    assert model != model.replace(averages=None)


def test_tune_scales_averages_too():
    r = relations("short")
    u = np.random.default_rng(0).uniform(-1, 1, (300, 1))
    y = np.asarray(jb.simulate(r.model, u, jax.random.key(0)).y)
    found = jb.tune(r, (u, y), steps=0, safety=1.0)
    assert 0.3 < float(found.model.averages[0].bound) / 0.2 < 1 and found.model.averages[0].weights == r.model.averages[0].weights
    only = jb.tune(r, (u, y), steps=0, bounds=["average"], safety=1.0)
    assert only.model.noise == r.model.noise and float(only.model.averages[0].bound) < 0.2
    res = jb.detect(jb.parity_relations(only.model, 2), u, y)
    assert res.counts["FAULT"] == 0


@pytest.mark.parametrize(
    ("more", "said"),
    [(dict(averages={"z": {3: 1}}), "speak of 'z'"), (dict(averages={"y1": {1: 1}}), ">= 2"), (dict(averages={"y1": {3: -1}}), ">= 0"),
     (dict(averages={"y1": [([0, 1], 1)]}), "other than 0"), (dict(averages={"y1": {3: 1}}, tolerance=0.1), "tolerance to be 0"),
     (dict(averages={"w1": {3: 1}}, disturbance=WALK, constant_tolerance=True, tolerance=0.1), "do not go together"),
     (dict(averages={"w1": {2: 0.1}}, disturbance=(WALK[0], [[0.5, 1]])), "no constant w1"), (dict(averages=[3]), "like")],
)  # fmt: skip
def test_what_are_no_averages_is_refused(more, said):
    with pytest.raises(ValueError, match=said):
        jb.LinearSystem(**PLANT, **more)


def test_other_methods_and_banks_look_at_single_samples():
    r = relations("short")
    for method in ("box", "paving"):
        with pytest.raises(ValueError, match="averages are tested by method 'joint'"):
            jb.detect(r, np.zeros((9, 1)), np.zeros((9, 2)), method=method)
    with pytest.raises((ValueError, NotImplementedError), match="averages"):
        jb.detect(jb.structured_relations(r.model), np.zeros((9, 1)), np.zeros((9, 2)))
