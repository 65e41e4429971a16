"""Noise times a factor of each sample: verdicts are those of linear programs whose bounds follow it."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from factored_case import case, gauge, recording

import jaxbound as jb
from jaxbound.certificates.verification import verify
from jaxbound.consistency.check import contradicted_by
from jaxbound.consistency.reading import gather
from jaxbound.sets.floats.status import Status

CLEAR = {np.float64: 1e-6, np.float32: 2e-3}
"""Distance from the boundary from which on no verdict is wrong by how samples are rounded for a program."""
DECIDED = {np.float64: 1e-6, np.float32: 3e-2}
"""Distance from the boundary from which on rounding leaves none UNDECIDED."""
KINDS = {
    "strips": dict(n=1, p=1, horizon=2),
    "circuits in a scan": dict(n=2, p=2, horizon=2),
    "search": dict(n=2, p=2, horizon=7),
    "search with disturbances": dict(n=2, p=2, horizon=4, g=1),
    "lags": dict(n=2, p=2, lags=(0, 1, 2, 4, 8)),
    "means": dict(n=2, p=2, horizon=5, mean=4),
}


AT_NIGHT = "search with disturbances"
BY_DAY = [pytest.param(kind, marks=pytest.mark.long) if kind == AT_NIGHT else kind for kind in KINDS]


def drawn(kind):
    """Return (rng, (model, window, factors)): the plant of this kind, one in all tests, whose kernels are
    compiled once.
    """
    rng = np.random.default_rng(list(kind.encode()))
    return rng, case(rng, **KINDS[kind])


def judged(relations, window, table, f, dtype=np.float64):
    """Return the status of all windows, each compared with a linear program."""
    model = relations.model
    typed = table.astype({name: dtype for name in model.outputs})
    exact, bounds = (jb.detect(relations, typed, margins=margins) for margins in ("exact", "bounds"))
    s, y = relations.horizon, typed[list(model.outputs)].to_numpy(dtype)
    u = table[["Fan [%]"]].to_numpy()
    for k in range(s, len(y)):
        stretch = slice(k - s, k + 1)
        unit = np.finfo(dtype).eps / 2
        t = gauge(model, window, u[stretch], y[stretch].astype(float), f[stretch], unit)
        if t is not None and abs(t - 1) > CLEAR[dtype]:
            expected = Status.FAULT if t > 1 else Status.CONSISTENT
            for status in (exact.status[k], bounds.status[k]):
                open_ = status == Status.UNDECIDED and abs(t - 1) <= DECIDED[dtype]
                assert status == expected or open_, (k, t, status)
    return exact.status


@pytest.mark.parametrize(
    "kind, dtype",
    [(kind, np.float64) for kind in KINDS]
    + [(kind, np.float32) for kind in KINDS if kind != AT_NIGHT]
    + [pytest.param(AT_NIGHT, np.float32, marks=pytest.mark.long)],
)
def test_verdicts_are_those_of_linear_programs(kind, dtype):
    rng, (model, window, factors) = drawn(kind)
    relations = jb.parity_relations(model, **window)
    seen = set()
    for excess in (0.5, 1.0, 1.6, 4.0):
        table, f = recording(rng, model, factors, 40, excess)
        status = judged(relations, window, table, f, dtype)
        seen |= set(status.tolist())
        if excess <= (0.5 if model.averages else 1.0):
            assert not (status == Status.FAULT).any(), "errors within their bounds"
    assert {Status.CONSISTENT, Status.FAULT} <= seen


@pytest.mark.parametrize("kind", ["strips", "search"])
def test_missing_samples_and_factors_silence_what_needs_them(kind):
    rng, (model, window, _) = drawn(kind)
    model, factors = model.replace(times={"T0": "1 + load**2"}), {"T0": lambda fan, load: 1 + load**2}
    table, f = recording(rng, model, factors, 60, 2.5)
    table.loc[20, "T0"] = np.nan
    whole = table.copy()
    table.loc[40, "load"] = np.nan  # what a factor is missing for is missing itself
    whole.loc[40, "T0"] = np.nan
    relations = jb.parity_relations(model, **window)
    found, expected = jb.detect(relations, table), jb.detect(relations, whole)
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_array_equal(found.margin, expected.margin)
    judged(relations, window, whole, f)


@pytest.mark.parametrize("kind", BY_DAY)
def test_a_factor_of_one_changes_no_verdict(kind):
    rng, (model, window, factors) = drawn(kind)
    for dtype in (np.float64, np.float32)[: 1 if "search" in kind else 2]:
        table, _ = recording(rng, model, factors, 200, 1.4)
        table = table.astype({name: dtype for name in model.outputs})
        ones = {name: "1 + 0*load" for name in model.outputs}
        plain = jb.parity_relations(model.replace(times=None), **window)
        times = jb.parity_relations(model.replace(times=ones), **window)
        for method in ("joint", "box")[: 1 if model.averages else 2]:
            ways = dict(method=method, margins="exact")
            one, other = jb.detect(plain, table, **ways), jb.detect(times, table, **ways)
            np.testing.assert_array_equal(one.status, other.status)
            # the mean of factors is rounded, each factor is not
            if relations_are_searched(plain) and method == "joint" and not model.averages:
                np.testing.assert_array_equal(one.margin, other.margin)
            # compilers are free to contract sums of strips in another order
            np.testing.assert_allclose(one.margin, other.margin, rtol=0, atol=40 * np.finfo(dtype).eps)


def relations_are_searched(relations):
    return relations.frame is not None


@pytest.mark.parametrize("kind", BY_DAY)
def test_samples_one_by_one_give_the_same_verdicts(kind):
    rng, (model, window, factors) = drawn(kind)
    table, _ = recording(rng, model, factors, 40, 1.5)
    relations = jb.parity_relations(model, **window)
    whole = jb.detect(relations, table, margins="exact")
    monitor = jb.Monitor(relations)
    state, status, margin = monitor.init(), [], []
    for k in range(len(table)):
        state, verdict = monitor.run(state, table.iloc[k : k + 1].reset_index(drop=True))
        status.append(verdict.status[0])
        margin.append(verdict.margin[0])
    np.testing.assert_array_equal(status, whole.status)
    # sums of NumPy end in other digits where windows stand beside each other
    np.testing.assert_allclose(margin, whole.margin, rtol=1e-12)
    for first in (0, 11):  # and in bursts
        state, verdict = monitor.run(monitor.init(), table.iloc[first:].reset_index(drop=True))
        end = first + relations.horizon
        np.testing.assert_allclose(verdict.margin[relations.horizon :], whole.margin[end:], rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_certificates_are_confirmed_and_those_of_other_factors_are_not(kind):
    rng, (model, window, factors) = drawn(kind)
    model = model.replace(**window)
    quiet, _ = recording(rng, model, factors, 30, 0.5)
    loud, _ = recording(rng, model, factors, 30, 4.0)
    table = pd.concat([quiet, loud], ignore_index=True)
    relations = jb.parity_relations(model)
    found = jb.detect(relations, table, margins="exact")
    seen = set()
    for k in (int(np.nanargmin(found.margin)), int(np.nanargmax(found.margin))):
        certificate = found.explain(k)
        assert certificate.proves == found.status[k]
        document = certificate.to_dict()
        verify(document, model, table)
        seen.add(document["certificate"])
        wider = {name: f"2*({text})" for name, text in model.times.items()}
        with pytest.raises(ValueError, match="something else"):
            verify(document, model.replace(times=wider), table)
        with pytest.raises(ValueError, match="factors|number of the proof|times_noise|missing or unknown"):
            verify(document, model.replace(times=None), table)
    assert seen == {"FAULT", "CONSISTENT"}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("kind", ["strips", "circuits in a scan", "search", "means"])
def test_fractions_say_the_same_where_bounds_are_as_thin_as_rounding(kind, dtype):
    rng, (plant, window, _) = drawn(kind)
    seen = set()
    for noise in (0.0, 1e-300, 2.0**-20):
        model = plant.replace(noise=noise, resolution=0, tolerance=0, times={"T0": "load**2"}, **window)
        model = model.replace(averages=[replace(one, bound=3 * Fraction(noise)) for one in model.averages])
        table, _ = recording(rng, model, {"T0": lambda fan, load: load**2}, 30, 1.0)
        outputs = list(model.outputs)
        table.loc[20:, outputs] += 1e-6 * rng.normal(size=(10, model.p))
        table = table.astype({name: dtype for name in outputs})
        found = jb.detect(jb.parity_relations(model), table)
        for k in np.flatnonzero((found.status == Status.FAULT) | (found.status == Status.CONSISTENT)):
            assert found.explain(int(k)).proves == found.status[k], k
        seen |= set(found.status.tolist())
    assert {Status.FAULT, Status.CONSISTENT} <= seen


@pytest.mark.parametrize("kind", ["strips", "circuits in a scan"])
def test_a_second_look_at_strips_knows_the_factors(kind):
    rng, (model, window, _) = drawn(kind)
    counts = []
    for text in ("2 + 0*load", "0.25 + 0*load", "abs(load)"):
        times = model.replace(times={"T0": text}, resolution=0.01)
        table, _ = recording(rng, model, {"T0": lambda fan, load: 1 + 0 * load}, 200, 1.5)
        relations = jb.parity_relations(times, **window)
        found, given = jb.detect(relations, table), jb.Recording.of(times, table)
        test, s = relations.test("joint", np.float64), relations.horizon
        seen = test.contradicted(given.u, given.y, np.arange(len(table) - s))
        np.testing.assert_array_equal(seen, found.status[s:] == Status.FAULT)
        counts.append(seen.sum())
    assert counts[0] < counts[1], "wide bounds, then narrow ones"


@pytest.mark.parametrize("kind", ["search", "search with disturbances", "means"])
def test_easy_windows_know_the_factors(kind):
    rng = np.random.default_rng(29)
    model, window, _ = case(rng, **(KINDS[kind] | {"g": 0}))
    quiet, _ = recording(rng, model, {}, 60, 0.5)
    narrow = model.replace(times={name: "0.25 + 0*load" for name in model.outputs}, resolution=0, tolerance=0)
    for margins in ("exact", "bounds"):
        found = jb.detect(jb.parity_relations(narrow, **window), quiet, margins=margins)
        s = found.relations.horizon
        assert (found.status[s:] == Status.FAULT).all()


def test_a_combination_contradicts_by_the_factors_alone():
    rng = np.random.default_rng(23)
    model, window, _ = case(rng, **KINDS["search"])
    within, beyond = (recording(rng, model, {}, 30, excess)[0] for excess in (0.7, 1.1))
    table = pd.concat([within, beyond], ignore_index=True)
    seen = {}
    for text in ("1 + 0*load", "4 + 0*load", "0.5 + 0*load"):
        times = model.replace(times={name: text for name in model.outputs}, resolution=0)
        relations = jb.parity_relations(times, **window)
        reading, given = relations.reading(np.float64), jb.Recording.of(times, table)
        s, outer = relations.horizon, np.asarray(reading.frame.outer)
        starts = np.arange(len(table) - s)
        u, y = gather(given.u, given.y, starts, reading.lags, s)
        if not seen:  # the combinations that speak most against windows whose factor is 1
            plain = jb.detect(relations, table, margins="exact")
            h = np.array([plain.explain(int(k + s)).h for k in starts], float).T[outer]
        seen[text] = contradicted_by(reading, u, y, h)
    one, four, half = seen.values()
    assert one.any() and (four <= one).all() and (one <= half).all()
    assert four.sum() < one.sum() < half.sum()


def beside_vertices(kind):
    """Return (relations, table, Result): at vertices margins have two slopes."""
    rng, (model, window, factors) = drawn(kind)
    table, _ = recording(rng, model, factors, 40, 1.2)
    table[list(model.outputs)] += 0.02 * rng.normal(size=(40, model.p))
    relations = jb.parity_relations(model, **window)
    return relations, table, jb.detect(relations, table, margins="exact")


@pytest.mark.parametrize("kind", ["strips", "search", "means"])
def test_margins_are_those_of_detect(kind):
    relations, table, found = beside_vertices(kind)
    np.testing.assert_allclose(jb.margins(relations, table), found.margin, atol=1e-9)


@pytest.mark.long(
    by_day="consistency/test_missing_data::test_gradient_by_the_bounds_equals_finite_differences"
)
@pytest.mark.parametrize("kind", ["strips", "search"])
def test_margins_have_derivatives(kind):
    import jax

    relations, table, found = beside_vertices(kind)
    given = jb.Recording.of(relations.model, table)
    k = int(np.nanargmin(found.margin))
    bounds = relations.bounds

    def margin(noise):
        return jb.margins(relations.with_bounds({"noise": noise}), given.u, given.y)[k]

    slope = jax.grad(margin)(bounds["noise"])
    step = 1e-6
    ahead = margin(bounds["noise"] + step) - margin(bounds["noise"] - step)
    np.testing.assert_allclose(ahead / (2 * step), slope.sum(), rtol=1e-3)


def test_half_of_a_bound_times_two_is_the_bound():
    rng = np.random.default_rng(17)
    model = jb.LinearSystem([[0.9]], [[1]], [[1]], noise="1/2", inputs="fan", outputs="T")
    halved = model.replace(noise="1/4", times={"T": "2 + 0*fan"})
    u, y = rng.normal(size=(200, 1)), rng.normal(size=(200, 1))
    for horizon in (1, 8):
        one, other = (jb.detect(jb.parity_relations(m, horizon), u, y) for m in (model, halved))
        np.testing.assert_array_equal(one.status, other.status)
        k = int(np.nanargmin(one.margin))
        assert one.explain(k).factor == other.explain(k).factor
    assert tuple(other.explain(k).window.claim["noise"]) == (Fraction(1, 4),)


def test_what_a_vanishing_disturbance_adds_to_noise_is_not_times_a_factor():
    model = jb.LinearSystem([[0.9]], None, [[1]], noise=0.1, disturbance=([[1]], 1e-290), outputs="T")
    times = model.replace(times={"T": "load"})
    assert jb.parity_relations(model, 3)._moving is not None
    assert jb.parity_relations(times, 3)._moving is None
    still = times.replace(disturbance=([[1]], 0))
    assert jb.parity_relations(still, 3)._moving.model.times == times.times


def test_samples_taken_late_or_early_are_no_fault_of_a_bank_of_means_and_bounds_that_follow(rng):
    """The level is read up to .3 s off: by as much as it moves then, which bounds of one test follow, and of
    which the other knows the largest, and the largest mean of four.
    """
    T = 160
    pump = np.repeat(rng.uniform(-1, 1, T // 8) ** 3, 8)
    level, pace = np.zeros(T), np.zeros(T)
    for k in range(T):
        pace[k] = pump[k] - 0.1 * level[k]
        if k + 1 < T:
            level[k + 1] = level[k] + pace[k]
    signs = rng.choice([-1.0, 1.0], (2, T))
    error = 0.3 * signs[0] * pace + 0.05 * signs[1]
    mean = np.abs(np.convolve(error, np.full(4, 0.25), "valid")).max() + 1e-12
    constant = {"noise": abs(error).max() + 1e-12, "averages": [{"samples": 4, "bound": mean}]}
    tests = [{"name": "follows"}, {"name": "means", "model": {"outputs": [{"name": "level", **constant}]}}]
    model = jb.LinearSystem(
        [["0.9"]],
        [[1]],
        [[1]],
        noise="0.05",
        times={"level": "1 + 6*abs(pace)"},
        inputs="pump",
        outputs="level",
        horizon=11,
        tests=tests,
    )
    table = pd.DataFrame({"pump": pump, "pace": pace, "level": level + error})
    for kind in (np.float64, np.float32):
        healthy = jb.detect(model, table.astype({"level": kind}))
        assert healthy.counts["FAULT"] == 0 and set(healthy.tests) == {"follows", "means"}
        assert all(np.nanmin(one.margin) < 0.5 for one in healthy.tests.values())
    faulty = jb.detect(model, table.assign(level=table["level"] + 1.0 * (np.arange(T) > 80)))
    assert all(one.counts["FAULT"] for one in faulty.tests.values())
