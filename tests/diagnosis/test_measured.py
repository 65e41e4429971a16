"""Margins of long windows: proved bounds where a window is easy, exact ones where somebody looks."""

from fractions import Fraction
from functools import cache

import jax
import numpy as np
import pytest
from oracles import MODELS
from systems import paper

import jaxbound as jb
from jaxbound.consistency import interface
from jaxbound.diagnosis import measuring
from jaxbound.sets.floats.status import Status

pytestmark = pytest.mark.usefixtures("many", "as_compiled")

T = 260
GUST = MODELS["paper"] | dict(disturbance=([[0], [1]], 0.05))
LONG = {
    "plain": (MODELS["paper"], {"horizon": 20}, np.float64),
    "float32": (MODELS["paper"], {"horizon": 20}, np.float32),
    "disturbed": (GUST, {"horizon": 6}, np.float64),
    "lags": (MODELS["paper"], {"lags": (0, 1, 2, 3, 4, 5, 6, 8, 10, 13, 16)}, np.float64),
}


@cache
def detected(name):
    """Return relations, u, y, starts and both Results: of two recordings with faults, missing samples and a
    gap.
    """
    numbers, windows, dtype = LONG[name]
    r, rng = jb.parity_relations(jb.LinearSystem(**numbers), **windows), np.random.default_rng(11)
    u = rng.uniform(-1, 1, (2, T, 1)).astype(dtype)
    y = np.array(jb.simulate(r.model, u, jax.random.key(3), at="uniform").y)
    y[0, 150:, 0] += 3.0
    y[1, 90:130, 1] += np.linspace(0, 2, 40)
    y[rng.random(y.shape) < 0.002] = np.nan
    u[1, 70] = np.nan
    starts = (60,)
    return r, u, y, starts, *(jb.detect(r, u, y, starts=starts, margins=kind) for kind in ("bounds", "exact"))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name == "lags" else name for name in LONG]
)
def test_verdicts_are_the_same_and_bounds_lie_on_the_side_of_the_verdict(name):
    r, *_, bounded, exact = detected(name)
    assert r.frame is not None and (bounded.margins, exact.margins) == ("bounds", "exact")
    np.testing.assert_array_equal(bounded.status, exact.status)
    assert min(bounded.counts[x] for x in ("FAULT", "CONSISTENT", "MISSING")) > 20
    slack = 1e-9 if bounded.margin.dtype == np.float64 else 1e-4
    inside, outside = bounded.status == Status.CONSISTENT, bounded.status == Status.FAULT
    assert (bounded.margin[inside] > 0).all() and (bounded.margin[outside] < 0).all()
    assert (bounded.margin[inside] <= exact.margin[inside] + slack).all()
    low, size = exact.margin[outside], abs(exact.margin[outside])
    assert (bounded.margin[outside] >= low - slack * (1 + size)).all()
    assert (bounded.margin[inside] < exact.margin[inside] - slack).any()  # else nothing was settled at once
    np.testing.assert_array_equal(np.isnan(bounded.margin), np.isnan(exact.margin))


def test_a_bound_is_no_larger_than_the_margin_in_fractions():
    *_, bounded, _ = detected("plain")
    for k in np.flatnonzero(bounded.status[0] == Status.CONSISTENT)[::40]:
        certificate = bounded.explain((0, int(k)))
        assert certificate.proves == Status.CONSISTENT
        margin = 1 - Fraction(certificate.factor)  # a margin that was searched for is rounded
        assert Fraction(float(bounded.margin[0, k])) <= margin + Fraction(1, 10**12)


@pytest.mark.parametrize("name", ["plain", "float32"])
def test_what_is_looked_at_is_exact(name):
    *_, bounded, exact = detected(name)
    assert bounded.alarms() == exact.alarms() and len(bounded.alarms()) > 1
    assert bounded.worst == exact.worst
    fault = exact.status == Status.FAULT
    np.testing.assert_array_equal(bounded.reported[fault], exact.margin[fault])
    np.testing.assert_array_equal(bounded.reported[~fault], bounded.margin[~fault])
    np.testing.assert_array_equal(bounded.exact, exact.margin)
    assert bounded.hints == exact.hints


def test_the_tightest_of_healthy_windows_is_found_without_searching_all(monkeypatch):
    r, u, y, *_ = detected("plain")
    bounded, exact = (jb.detect(r, u[0, :150], y[0, :150], margins=kind) for kind in ("bounds", "exact"))
    assert not bounded.counts["FAULT"]
    searched, exact_margins = [], measuring.exact_margins

    def counted(*given):
        searched.append(len(given[-1]))
        return exact_margins(*given)

    monkeypatch.setattr(measuring, "exact_margins", counted)
    monkeypatch.setattr(measuring, "FIRST", 8)
    assert bounded.worst == (int(np.nanargmin(exact.margin)), np.nanmin(exact.margin))
    assert 0 < sum(searched) < bounded.counts["CONSISTENT"] / 2


def test_certificates_are_the_same_whatever_settled_the_window():
    *_, bounded, exact = detected("plain")
    for status in (Status.FAULT, Status.CONSISTENT):
        for k in np.flatnonzero(bounded.status[0] == status)[[0, 7, 30]]:
            assert bounded.explain((0, int(k))).to_json() == exact.explain((0, int(k))).to_json()


def test_verdicts_do_not_depend_on_what_stands_beside_a_window():
    r, u, y, starts, whole, _ = detected("plain")
    backwards = jb.detect(r, u[::-1], y[::-1], starts=starts)
    np.testing.assert_array_equal(backwards.status[::-1], whole.status)
    s = r.horizon
    for first, stop in ((60, 61 + s), (75, 190), (120, T)):  # the first is one window alone
        part = jb.detect(r, u[:, first:stop], y[:, first:stop])
        np.testing.assert_array_equal(part.status[:, s:], whole.status[:, first + s : stop])


def test_few_windows_are_searched(monkeypatch):
    r, u, y, starts, bounded, exact = detected("plain")
    windows = 2 * (T - r.horizon)
    monkeypatch.setattr(interface, "MANY", windows)
    assert jb.detect(r, u, y, starts=starts).margins == "bounds"
    monkeypatch.setattr(interface, "MANY", windows + 1)
    few = jb.detect(r, u, y, starts=starts)
    assert few.margins == "exact"
    np.testing.assert_array_equal(few.margin, exact.margin)


def test_what_the_search_leaves_open_is_decided_whatever_margins_are_asked_for():
    """A sensor without noise beside a tolerance shows a signal that decays to nothing: bounds of one window
    are 1e12 times as wide as others, and a search in floats ends nowhere.
    """
    A, C = np.array([[-0.79, -0.34], [0.39, 0.51]]), np.array([[-0.38, 0.83], [0.86, -0.13]])
    model = jb.LinearSystem(A, None, C, tolerance=["0.05", "0.01"], noise=[0, "0.567"])
    rng, x, y = np.random.default_rng(19), np.array([1.0, -2.0]), []
    for _ in range(110):
        gains = 1 + 1.3 * np.array([0.05, 0.01]) * rng.choice([-1, 1], 2)
        y.append(C @ x * gains + [0, 0.7371] * rng.choice([-1, 1], 2))
        x = A @ x
    relations, y = jb.parity_relations(model, 20), np.array(y[80:])
    bounded, exact = (jb.detect(relations, None, y, margins=kind) for kind in ("bounds", "exact"))
    np.testing.assert_array_equal(exact.status, bounded.status)
    assert (exact.status[20:] == Status.FAULT).all() and exact.margins == "exact"
    monitor = jb.Monitor(relations)
    np.testing.assert_array_equal(monitor.run(monitor.init(), None, y)[1].status, exact.status)


def test_a_plant_without_inputs_has_exact_margins_where_somebody_looks():
    model = jb.LinearSystem([["0.9", "0.1"], [0, "0.7"]], None, [[1, 0], [1, 1]], noise=["0.1", "0.1"])
    relations, y = jb.parity_relations(model, 8), np.zeros((2, 60, 2))
    y[1, 40:, 0] += 3
    bounded, exact = (jb.detect(relations, None, y, margins=kind) for kind in ("bounds", "exact"))
    assert bounded.margins == "bounds" and bounded.counts["FAULT"]
    assert bounded.alarms() == exact.alarms() and bounded.worst == exact.worst
    np.testing.assert_array_equal(bounded.exact, exact.margin)


def test_results_say_which_margins_they_have():
    u, y = np.zeros((30, 1)), np.zeros((30, 2))
    short, known = jb.parity_relations(paper(), 1), jb.parity_relations(paper(), 14)
    kinds = {
        jb.detect(short, u, y).margins,
        jb.detect(short, u, y, method="box").margins,
        jb.detect(jb.structured_relations(paper()), u, y).margins,
        jb.detect(jb.observer(paper()), u, y).margins,
        jb.detect(known, u, y, margins="exact").margins,
    }
    assert kinds == {"exact"} and jb.detect(known, u, y).margins == "bounds"
    *_, bounded, exact = detected("plain")
    assert "at most" in repr(bounded) and "at most" not in repr(exact)
    one = jb.detect(known, u, y)
    assert one.to_pandas().attrs == {"margins": "bounds"}
    assert jb.detect(known, u[:12], y[:12]).worst is None  # no window is complete
    with pytest.raises(ValueError, match="margins must be one of auto, bounds, exact, not 'all'"):
        jb.detect(short, u, y, margins="all")
