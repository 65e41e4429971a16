"""Set observers of models whose noise is times a factor: proved against linear programs over all samples,
whose bounds follow it.
"""

import numpy as np
import pytest
from factored_case import case, gauge, recording

import jaxbound as jb
from jaxbound.certificates.verification import verify
from jaxbound.sets.floats.status import Status

PLANT = dict(n=2, p=2, horizon=6, g=1)
METHODS = {
    "zonotope": {},
    "strips": {},
    "joint": {"window": 8},
}
EDGE = 1e-6
"""Distance from the boundary within which the rounding of a linear program may tell otherwise."""


def followed(model, method, **options):
    return jb.observer(model, method, **(METHODS[method] | options))


@pytest.mark.usefixtures("searched_in_numpy")
@pytest.mark.parametrize("method", METHODS)
def test_a_fault_is_one_by_a_linear_program_over_all_samples(method, rng):
    seen = 0
    for excess in (1.0, 1.5, 4.0):
        model, window, factors = case(rng, **PLANT)
        table, f = recording(rng, model, factors, 24, excess)
        status = jb.detect(followed(model, method, restart=False), table).status
        faults = np.flatnonzero(status == Status.FAULT)
        if excess <= 1:
            assert not len(faults), "errors within their bounds"
            continue
        seen += len(faults)
        if len(faults):
            k = int(faults[0])
            u, y = table[["Fan [%]"]].to_numpy()[: k + 1], table[list(model.outputs)].to_numpy()[: k + 1]
            assert gauge(model, {"horizon": k}, u, y, f[: k + 1], 2.0**-53) > 1 - EDGE
    assert seen, "the second and third recording speak against their models"


@pytest.mark.parametrize("method", METHODS)
def test_float32_knows_the_factors_too(method, rng):
    model, _, factors = case(rng, **PLANT)
    quiet, _ = recording(rng, model, factors, 40, 1.0)
    found = jb.detect(followed(model, method), quiet.astype(np.float32))
    assert not found.counts["FAULT"]


@pytest.mark.parametrize("method", METHODS)
def test_wide_factors_explain_and_narrow_ones_refute(method, rng):
    model, _, _ = case(rng, **PLANT)
    model = model.replace(resolution=0, tolerance=0, times=None)
    table, _ = recording(rng, model, {}, 40, 1.0)
    outputs = dict.fromkeys(model.outputs, "0.02 + 0*load")
    narrow = jb.detect(followed(model.replace(times=outputs), method), table)
    wide = jb.detect(
        followed(model.replace(times=dict.fromkeys(model.outputs, "1 + load**2")), method), table
    )
    assert narrow.counts["FAULT"] > 5 and not wide.counts["FAULT"]


def test_a_factor_throughout_is_another_noise(rng):
    model, _, _ = case(rng, **PLANT)
    model = model.replace(times=None, resolution=0)
    table, _ = recording(rng, model, {}, 60, 1.3)
    times = model.replace(times=dict.fromkeys(model.outputs, "2 + 0*load"))
    noise = model.replace(noise=[2 * x for x in model.noise])
    one, other = (jb.detect(followed(m, "zonotope"), table) for m in (times, noise))
    np.testing.assert_array_equal(one.status, other.status)
    np.testing.assert_allclose(one.margin, other.margin, atol=1e-9)


def test_a_resolution_is_not_times_the_factor(rng):
    model, _, _ = case(rng, n=1, p=1, horizon=1)
    model = model.replace(times={"T0": "0*load"}, tolerance=0, noise=5, resolution=0.5)
    table, _ = recording(rng, model, {"T0": lambda fan, load: 0 * load}, 40, 1.0)
    assert not jb.detect(followed(model, "zonotope"), table).counts["FAULT"]
    alone = jb.detect(followed(model.replace(noise=0, times=None), "zonotope"), table)
    with_factor = jb.detect(followed(model, "zonotope"), table)
    np.testing.assert_allclose(with_factor.margin, alone.margin, atol=1e-9)


@pytest.mark.parametrize("method", ["zonotope", "joint"])
def test_samples_one_by_one_give_the_same_verdicts(method, rng):
    model, _, factors = case(rng, **PLANT)
    table, _ = recording(rng, model, factors, 20, 1.5)
    watch = followed(model, method)
    whole, monitor = jb.detect(watch, table), jb.Monitor(watch)
    state, status = monitor.init(), []
    for k in range(len(table)):
        state, verdict = monitor.run(state, table.iloc[k : k + 1].reset_index(drop=True))
        status.append(verdict.status[0])
    np.testing.assert_array_equal(status, whole.status)


def test_a_sample_whose_factor_is_missing_is_missing(rng):
    model, _, _ = case(rng, **PLANT)
    model = model.replace(times=dict.fromkeys(model.outputs, "1 + load**2"))
    table, _ = recording(rng, model, {}, 40, 1.4)
    whole = table.copy()
    table.loc[20, "load"] = np.nan
    whole.loc[20, list(model.outputs)] = np.nan
    found, expected = (jb.detect(followed(model, "zonotope"), x) for x in (table, whole))
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_array_equal(found.margin, expected.margin)


def test_the_proof_of_a_fault_knows_the_factors(rng):
    model, _, factors = case(rng, **PLANT)
    quiet, _ = recording(rng, model, factors, 20, 0.3)
    quiet.loc[15:, list(model.outputs)] += [9.0, -9.0]
    found = jb.detect(followed(model, "zonotope"), quiet)
    k = int(np.flatnonzero(found.status == Status.FAULT)[0])
    document = found.explain(k).to_dict()
    verify(document, model, quiet)
    wider = {name: f"100*({text})" for name, text in model.times.items()}
    with pytest.raises(ValueError, match="something else"):
        verify(document, model.replace(times=wider), quiet)


def test_sizes_that_an_observer_sees_grow_with_the_stated_factor():
    shaken = [[1]], 0.1
    model = jb.LinearSystem([["0.5"]], [[1]], [[1]], noise=0.1, times={"y1": "1 + u1**2"}, disturbance=shaken)
    plain = jb.detectable(model.replace(times=None, noise=0.3), "y1", method="observer")
    for watched in (model, jb.observer(model)):
        assert float(jb.detectable(watched, "y1", method="observer", factors={"y1": 3})) == pytest.approx(
            plain
        )
        with pytest.raises(ValueError, match="give factors, the largest value of each"):
            jb.detectable(watched, "y1", method="observer")


@pytest.mark.long(by_day="test_sizes_that_an_observer_sees_grow_with_the_stated_factor")
def test_fit_and_tune_find_bounds_of_an_observer_that_follow(rng):
    u = rng.uniform(-1, 1, (160, 1))
    x, y = 0.0, np.zeros((160, 1))
    for k in range(160):
        y[k] = x + (0.02 + 0.1 * u[k, 0] ** 2) * rng.uniform(-1, 1)
        x = 0.8 * x + u[k, 0]
    days = [(u[:80], y[:80]), (u[80:], y[80:])]
    model = jb.fit(days, order=1, horizon=4, method="least squares", observer="zonotope", follow=0.3)
    assert model.times and model.check.follows.most > 1
    tuned = jb.tune(jb.observer(model), days)
    assert tuned.model.times == model.times
    for day in days:
        assert not jb.detect(jb.observer(tuned.model), *day).counts["FAULT"]
