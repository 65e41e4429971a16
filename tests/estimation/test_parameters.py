"""Constant parameters by a whole recording: the true ones are never lost, a fault leaves none.

The plants are worked out in fractions here. Whether a window can be explained with given parameters is said
by intervals of one unknown state in fractions, or by a linear program of HiGHS.
"""

from fractions import Fraction
from itertools import pairwise, product

import highspy
import linear_programs
import numpy as np
import pandas as pd
import pytest
from oracles import fractions, times

import jaxbound as jb
from jaxbound.consistency import parameter_boxes
from jaxbound.consistency.twice import Doubtful
from jaxbound.estimation import parameter_search
from jaxbound.sets.floats.kernel import is_outside_xla


def fixed(name, lo, hi, **parts):
    return jb.Uncertainty(name, **parts, between=(lo, hi), varying=False)


NOISE = Fraction(1, 20)
PLANTS = {  # matrices at 0 of all parameters, parameters
    "pole and gain": (
        dict(A=[[0]], B=[[0]], C=[[1]]),
        [fixed("a", "0.4", "0.9", A=[[1]]), fixed("b", "0.5", "2", B=[[1]])],
    ),
    "gain of a sensor": (
        dict(A=[["0.7"]], B=[[1]], C=[[0], [1]]),
        [fixed("c", "0.8", "1.2", C=[[1], [0]])],
    ),
    "second order": (
        dict(A=[[0, 1], ["-0.45", 0]], B=[[0], [0]], C=[[1, 0]]),
        [fixed("a2", "0.9", "1.3", A=[[0, 0], [0, 1]]), fixed("g", "0.5", "1.5", B=[[0], [1]])],
    ),
    "two outputs, four relations": (
        dict(A=[[0, "0.3"], ["-0.2", "0.6"]], B=[[1], ["0.5"]], C=[[1, 0], [0, 1]]),
        [fixed("a", "0.3", "0.8", A=[[1, 0], [0, 0]])],
    ),
}
HORIZON = {"pole and gain": 1, "gain of a sensor": 1, "second order": 2, "two outputs, four relations": 2}


def model_of(plant):
    matrices, parameters = PLANTS[plant]
    return jb.LinearSystem(**matrices, noise=NOISE, uncertainties=parameters)


RELATIONS = {name: jb.parity_relations(model_of(name), HORIZON[name]) for name in PLANTS}


def at(plant, values):
    """Return the matrices of a plant with these values of its parameters, exact."""
    matrices, parameters = PLANTS[plant]
    found = {letter: fractions(rows) for letter, rows in matrices.items()}
    for p in parameters:
        for letter in found:
            for i, row in enumerate(getattr(p, letter) or ()):
                found[letter][i] = [
                    x + values[p.name] * d for x, d in zip(found[letter][i], row, strict=True)
                ]
    return found


def simulated(plant, values, rng, T, extreme=True):
    """Return (u, y) of a healthy recording, noises at their bounds or anywhere within."""
    m = at(plant, values)
    u = [Fraction(int(x), 4) for x in rng.integers(-4, 5, T)]
    x = [[Fraction(int(v), 8)] for v in rng.integers(-8, 9, len(m["A"]))]
    y = []
    for now in u:
        clean = times(m["C"], x)
        noise = rng.choice([-1, 1], len(clean)) if extreme else rng.uniform(-1, 1, len(clean))
        y.append([row[0] + NOISE * Fraction(float(e)) for row, e in zip(clean, noise, strict=True)])
        moved = times(m["A"], x)
        x = [[a[0] + b[0] * now] for a, b in zip(moved, m["B"], strict=True)]
    return np.array([[float(v)] for v in u]), np.array([[float(v) for v in row] for row in y])


def drawn(plant, rng):
    """Return exact values of the parameters within their bounds, on the bounds now and then."""
    values = {}
    for p in PLANTS[plant][1]:
        share = Fraction(int(rng.integers(0, 65)), 64)
        values[p.name] = p.between[0] + share * (p.between[1] - p.between[0])
    return values


def lost(rng, count, T=(20, 60)):
    """Return the number of random recordings whose true parameters are not in their set, and of those that
    gave an empty one.
    """
    missed = empty = 0
    names = list(PLANTS)
    for number in range(count):
        plant = names[number % len(names)]
        values = drawn(plant, rng)
        length = int(rng.integers(*T))
        u, y = simulated(plant, values, rng, length, extreme=bool(rng.integers(2)))
        found = jb.parameters(RELATIONS[plant], u, y, precision=0.2, budget=400)
        missed += not found.contains(values)
        empty += found.status == "FAULT"
    return missed, empty


def test_the_true_parameters_are_never_lost(rng):
    assert lost(rng, 4, (8, 14)) == (0, 0)


@pytest.mark.long(by_day="test_the_true_parameters_are_never_lost")
def test_the_true_parameters_of_a_thousand_recordings_are_never_lost(rng):
    assert lost(rng, 1000) == (0, 0)


def explains_exactly(u, y, a, b):
    """Say whether x+ = a x + b u, y = x + noise explains every window of two samples: in fractions."""
    slack = NOISE + 4 * Fraction(2) ** -53 * (max(abs(Fraction(float(v))) for v in y.ravel()) + NOISE)
    for (u0, y0), (_, y1) in pairwise(zip(u[:, 0], y[:, 0], strict=True)):
        known = b * Fraction(float(u0))
        lo, hi = Fraction(float(y0)) - slack, Fraction(float(y0)) + slack
        least, most = a * lo + known, a * hi + known
        if Fraction(float(y1)) - slack > most or Fraction(float(y1)) + slack < least:
            return False
    return True


@pytest.mark.parametrize("extreme", [True, False])
def test_every_value_that_explains_all_windows_is_in_the_set_first_order(rng, extreme):
    values = {"a": Fraction(7, 10), "b": Fraction(13, 10)}
    u, y = simulated("pole and gain", values, rng, 14, extreme)
    found = jb.parameters(RELATIONS["pole and gain"], u, y)
    points = []
    for p in PLANTS["pole and gain"][1]:  # around the true value, which all windows are explained by
        lo, hi = found.hull[p.name]
        every = [values[p.name] + Fraction(hi - lo) * k / 12 for k in range(-15, 16)]
        points.append([x for x in every if p.between[0] <= x <= p.between[1]])
    explained = held = 0
    for p in product(*points):
        explains = explains_exactly(u, y, *p)
        inside = bool(((found.lo <= p) & (p <= found.hi)).all(1).any())
        assert inside or not explains
        explained, held = explained + explains, held + inside
    assert 0 < explained <= held < len(points[0]) * len(points[1])  # the set leaves something out
    assert extreme or explained > 0.5 * held  # and is not far from the exact one


def explains_by_programs(plant, values, u, y, s, noise):
    """Say whether a linear program finds a state for every window of s + 1 samples."""
    m = {
        letter: np.array([[float(x) for x in row] for row in rows])
        for letter, rows in at(plant, values).items()
    }
    n = len(m["A"])
    for first in range(len(y) - s):
        solver = linear_programs.solver()
        for _ in range(n):
            solver.addVar(-highspy.kHighsInf, highspy.kHighsInf)
        on_state, known = np.eye(n), np.zeros(n)
        for k in range(s + 1):
            for row, shown in zip(m["C"], y[first + k], strict=True):
                h, c = row @ on_state, row @ known
                solver.addRow(shown - noise - c, shown + noise - c, n, np.arange(n), h)
            on_state, known = m["A"] @ on_state, m["A"] @ known + m["B"] @ u[first + k]
        if not linear_programs.is_feasible(solver):
            return False
    return True


@pytest.mark.parametrize("plant", ["second order", "two outputs, four relations"])
def test_every_value_that_linear_programs_explain_is_in_the_set(rng, plant):
    values = drawn(plant, rng)
    s = HORIZON[plant]
    u, y = simulated(plant, values, rng, 25, extreme=False)
    found = jb.parameters(RELATIONS[plant], u, y)
    assert found.contains(values)
    explained = left_out = 0
    for _ in range(60):
        share = rng.uniform(-0.1, 1.1, len(found.names))
        point = {}
        for p, t, (lo, hi) in zip(PLANTS[plant][1], share, found.hull.values(), strict=True):
            value = Fraction(float(lo + t * (hi - lo)))
            point[p.name] = min(max(value, p.between[0]), p.between[1])
        inside = found.contains(point)
        # what only the tolerance of the program explains is asked of nobody
        explains = explains_by_programs(plant, point, u, y, s, float(NOISE) * (1 - 1e-5))
        assert inside or not explains
        explained, left_out = explained + explains, left_out + (not inside)
    assert explained and left_out


def test_the_hull_is_as_close_to_the_exact_set_as_the_precision_says(rng):
    """One unknown, windows of two samples: the exact ends are found in fractions by halving."""
    pole = fixed("a", "0.4", "0.9", A=[[1]])
    r = jb.parity_relations(jb.LinearSystem([[0]], [[1]], [[1]], noise=NOISE, uncertainties=[pole]), 1)
    values = {"a": Fraction(7, 10), "b": Fraction(1)}
    u, y = simulated("pole and gain", values, rng, 12, extreme=False)
    precision = 1 / 64
    lo, hi = jb.parameters(r, u, y, precision=precision).hull["a"]

    def end(outside):
        inside = values["a"]
        for _ in range(40):
            middle = (inside + outside) / 2
            if explains_exactly(u, y, middle, Fraction(1)):
                inside = middle
            else:
                outside = middle
        return inside

    least, most = end(Fraction(2, 5)), end(Fraction(9, 10))
    assert Fraction(lo) <= least < values["a"] < most <= Fraction(hi)
    assert hi - lo <= (1 + 2 * precision) * float(most - least)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_parameter_outside_its_range_leaves_none(rng, plant):
    values = drawn(plant, rng)
    first = PLANTS[plant][1][0]
    values[first.name] = first.between[1] + (first.between[1] - first.between[0]) / 2
    u, y = simulated(plant, values, rng, 80)
    found = jb.parameters(RELATIONS[plant], u, y)
    assert found.status == "FAULT" and len(found.lo) == 0 and found.hull == {} and found.share == 0
    assert found.refuted and all(boxes > 0 for boxes in found.refuted.values())


def test_a_bias_of_a_sensor_leaves_none_though_each_window_alone_is_explained(rng):
    plant, s = "pole and gain", 1
    u, y = simulated(plant, drawn(plant, rng), rng, 150, extreme=False)
    assert jb.parameters(RELATIONS[plant], u, y).status == "found"
    y = y + 1.5
    each = jb.detect(RELATIONS[plant], u, y, budget=10_000).status[s:]
    found = jb.parameters(RELATIONS[plant], u, y)
    assert found.status == "FAULT" and (each == jb.Status.FAULT).mean() < 0.5


@pytest.mark.compiled
def test_what_numpy_does_not_confirm_is_kept(rng, monkeypatch):
    plant = "pole and gain"
    values = drawn(plant, rng)
    u, y = simulated(plant, values, rng, 30)
    real = parameter_boxes.PolynomialBoxes.looked

    def lying(self, *given):
        look = real(self, *given)
        if is_outside_xla():
            return look
        wrong = np.where(rng.random(look.margin.shape) < 0.2, -1.0, look.margin)
        return look._replace(margin=wrong)

    monkeypatch.setattr(parameter_boxes.PolynomialBoxes, "looked", lying)
    with pytest.warns(Doubtful, match="boxes of parameters"):
        found = jb.parameters(RELATIONS[plant], u, y, budget=100)
    assert found.contains(values)


def test_windows_across_a_gap_or_without_a_sample_are_left_aside(rng):
    plant = "pole and gain"
    values = drawn(plant, rng)
    parts = [simulated(plant, values, rng, 30) for _ in range(2)]
    u, y = (np.concatenate(x) for x in zip(*parts, strict=True))
    y[10] = np.nan
    found = jb.parameters(RELATIONS[plant], u, y, starts=[30])
    assert found.contains(values) and found.windows == 59 - 1 - 2
    u[40] = np.nan
    assert jb.parameters(RELATIONS[plant], u, y, starts=[30]).windows == 59 - 1 - 2 - 1


def test_a_search_that_ends_early_holds_the_true_parameters(rng):
    plant = "second order"
    values = drawn(plant, rng)
    u, y = simulated(plant, values, rng, 60)
    whole = jb.parameters(RELATIONS[plant], u, y)
    short = jb.parameters(RELATIONS[plant], u, y, budget=7)
    calls = []

    def stop(share):
        calls.append(share)
        if len(calls) == 3:
            raise KeyboardInterrupt

    stopped = jb.parameters(RELATIONS[plant], u, y, progress=stop)
    for found, status in ((whole, "found"), (short, "budget ended"), (stopped, "interrupted")):
        assert found.status == status and found.contains(values)
    assert whole.share < stopped.share and whole.share < short.share and short.evaluated <= 7
    assert calls[-1] == 1 and calls == sorted(calls)


@pytest.mark.parametrize("moment", range(1, 12))
def test_an_interruption_at_any_moment_loses_nothing(rng, monkeypatch, moment):
    plant = "pole and gain"
    values = drawn(plant, rng)
    u, y = simulated(plant, values, rng, 30)
    real, calls = parameter_boxes.PolynomialBoxes.looked, []

    def interrupted(self, *given):
        calls.append(1)
        if len(calls) == moment:
            raise KeyboardInterrupt
        return real(self, *given)

    monkeypatch.setattr(parameter_boxes.PolynomialBoxes, "looked", interrupted)
    found = jb.parameters(RELATIONS[plant], u, y)
    assert found.status == "interrupted" and found.contains(values)


def test_long_recordings_are_asked_in_parts_and_whole_at_the_end(rng, monkeypatch):
    plant = "pole and gain"
    values = drawn(plant, rng)
    u, y = simulated(plant, values, rng, 60, extreme=False)
    monkeypatch.setattr(parameter_search, "LOOKED", 8)
    found = jb.parameters(RELATIONS[plant], u, y)
    assert found.contains(values) and found.share < 0.1
    y[37] += 9.0  # no window of the first level has it, and there is no second one
    assert jb.parameters(RELATIONS[plant], u, y, budget=1).status == "FAULT"


@pytest.mark.parametrize("count, horizons", [(1, [1]), pytest.param(5, [1, 2], marks=pytest.mark.long)])
def test_errors_of_every_kind_lose_nothing(rng, count, horizons):
    """Tolerances, noise, a disturbance and a quantised recording about an operating point, all at their
    bounds; two outputs.
    """
    gain, leak = fixed("k", "0.5", "1.5", B=[["0.5"]]), fixed("leak", "0", "0.3", A=[[-1]])
    m = jb.LinearSystem(
        [["0.9"]],
        [[0]],
        [[1], ["0.5"]],
        tolerance=["0.02", 0],
        noise=["0.01", "0.02"],
        resolution=["0.005", 0],
        disturbance=([[1]], [("-0.01", "0.03")]),
        offset={"u": [2], "y": [10, 5]},
        uncertainties=[gain, leak],
    )
    relations = {s: jb.parity_relations(m, s) for s in horizons}
    for _ in range(count):
        k, lost = Fraction(int(rng.integers(50, 151)), 100), Fraction(int(rng.integers(0, 31)), 100)
        x, u, y = Fraction(int(rng.integers(-8, 9)), 4), [], []
        for now in rng.integers(-4, 5, int(rng.integers(10, 20))).tolist():
            theta, n1, n2 = (int(e) for e in rng.choice([-1, 1], 3))
            first = (1 + theta * Fraction(2, 100)) * x + n1 * Fraction(1, 100) + 10
            y.append([float(Fraction(round(first * 100), 100)), float(x / 2 + n2 * Fraction(2, 100) + 5)])
            u.append([2.0 + now])
            w = Fraction(int(rng.choice([-1, 3])), 100)
            x = (Fraction(9, 10) - lost) * x + k / 2 * now + w
        for r in relations.values():
            found = jb.parameters(r, u, y, precision=0.2, budget=40)
            assert found.contains({"k": k, "leak": lost}) and found.status != "FAULT"
            assert found.share < 0.5


def test_an_offset_of_unknown_size_is_a_constant_unknown_beside_an_input_that_is_1(rng):
    """As docs/monitor.md says: an offset within .5 that keeps its value; by linear programs in state and
    offset.
    """
    m = jb.LinearSystem(
        [["0.9"]],
        [[1, 0]],
        [[1]],
        D=[[0, 0]],
        noise=NOISE,
        inputs=["fan", "one"],
        columns={"one": "= 1 + 0*fan"},
        uncertainties=[fixed("offset", "-0.5", "0.5", D=[[0, 1]])],
    )
    fan, x, offset, s, wide = rng.uniform(-1, 1, 60), [0.0], rng.uniform(-0.5, 0.5), 2, float(NOISE)
    for now in fan[:-1]:
        x.append(0.9 * x[-1] + now)
    y = np.array(x) + offset + rng.uniform(-wide, wide, 60)
    y[40:] += 0.15
    relations = jb.parity_relations(m, s)
    found = jb.detect(relations, pd.DataFrame({"fan": fan, "y1": y})).status
    for k in range(s, 60):
        solver = linear_programs.solver()
        solver.addVar(-highspy.kHighsInf, highspy.kHighsInf)
        solver.addVar(-0.5, 0.5)
        moved = 0.0
        for i in range(s + 1):
            shown = y[k - s + i] - moved
            solver.addRow(shown - wide, shown + wide, 2, np.arange(2), np.array([0.9**i, 1.0]))
            moved = 0.9 * moved + fan[k - s + i]
        assert (found[k] == jb.Status.CONSISTENT) == linear_programs.is_feasible(solver)
    assert (found == jb.Status.FAULT).any() and (found[s:40] == jb.Status.CONSISTENT).all()
    ones = np.stack([fan, np.ones(60)], 1)
    day = jb.parameters(relations, ones[:40], y[:40, None])
    assert day.contains({"offset": offset}) and day.share < 0.5
    assert jb.parameters(relations, ones[:40], y[:40, None] - offset + 0.7).status == "FAULT"


def test_a_load_of_a_day_is_a_state_that_stays_with_a_reading_of_its_bound(rng):
    """As docs/monitor.md says: the observer of a whole day, by linear programs in state and load."""
    wide, most, T = float(NOISE), 0.5, 20
    m = jb.LinearSystem(
        [["0.9", 1], [0, 1]],
        [[1], [0]],
        [[1, 0], [0, 1]],
        noise=[NOISE, "0.5"],
        inputs="fan",
        outputs=["y", "load"],
        columns={"load": "= 0*fan"},
    )

    def explained(fan, y):
        solver = linear_programs.solver()
        solver.addVar(-highspy.kHighsInf, highspy.kHighsInf)
        solver.addVar(-most, most)
        moved = pushed = 0.0
        for i, shown in enumerate(y):
            near = np.array([0.9**i, pushed])
            solver.addRow(shown - moved - wide, shown - moved + wide, 2, np.arange(2), near)
            moved, pushed = 0.9 * moved + fan[i], 0.9 * pushed + 1
        return linear_programs.is_feasible(solver)

    watching = jb.observer(m, restart=False)
    for load in (rng.uniform(-most, most), 0.8):
        fan, x = rng.uniform(-1, 1, T), [0.0]
        for now in fan[:-1]:
            x.append(0.9 * x[-1] + now + load)
        day = pd.DataFrame({"fan": fan, "y": np.array(x) + rng.uniform(-wide, wide, T)})
        y = day["y"].to_numpy()
        seen = jb.detect(watching, day).status == jb.Status.FAULT
        for k in np.flatnonzero(seen):
            assert not explained(fan[: k + 1], y[: k + 1])
        assert seen[-1] == (load > most)


def test_parameters_that_vary_may_be_anything_at_each_sample(rng):
    a, b = PLANTS["pole and gain"][1]
    b = jb.Uncertainty("b", B=b.B, between=("1.2", "1.4"))
    r = jb.parity_relations(jb.LinearSystem([[0]], [[0]], [[1]], noise=NOISE, uncertainties=[a, b]), 2)
    x, y, u = 0.5, [], rng.choice([-1.0, 1.0], (80, 1))
    for now in u[:, 0]:
        y.append([x + rng.uniform(-0.05, 0.05)])
        x = 0.7 * x + rng.choice([1.2, 1.4]) * now
    found = jb.parameters(r, u, y)
    assert found.names == ("a",) and found.contains({"a": 0.7}) and found.share < 0.5
    assert found.model.uncertainties[1] == b


def test_a_residual_says_the_same_of_its_constant_unknowns(rng):
    plant = "pole and gain"
    values = drawn(plant, rng)
    u, y = simulated(plant, values, rng, 10, extreme=False)
    equation = lambda z, u, y: y[1, 0] - z[2] - z[0] * (y[0, 0] - z[3]) - z[1] * u[0, 0]
    box = jb.interval([0.4, 0.5, -0.05, -0.05], [0.9, 2.0, 0.05, 0.05])
    r = jb.residual(equation, box, horizon=1)
    found = jb.parameters(r, u, y, precision=1 / 4, constant={"a": 0, "b": 1})
    same = jb.parameters(RELATIONS[plant], u, y, precision=1 / 4)
    assert found.contains(values)
    for name in ("a", "b"):
        width = same.hull[name][1] - same.hull[name][0]
        assert np.allclose(found.hull[name], same.hull[name], atol=0.2 * width)
    assert jb.parameters(r, u, y + 1.5, constant={"a": 0, "b": 1}).status == "FAULT"
    with pytest.raises(ValueError, match="with_bounds"):
        _ = found.model


def test_float32_recordings_lose_nothing(rng):
    plant = "second order"
    for _ in range(2):
        values = drawn(plant, rng)
        u, y = simulated(plant, values, rng, 40)
        found = jb.parameters(RELATIONS[plant], u.astype(np.float32), y.astype(np.float32), budget=300)
        assert found.contains(values)


@pytest.mark.long(by_day="test_the_true_parameters_are_never_lost")
def test_grey_boxes_have_their_time_constant_estimated(rng):
    import jax.numpy as jnp

    heater = lambda x, u, p: jnp.array([p["rate"] * (u[0] - x[0])])
    m = jb.linearize(
        heater,
        [0.0],
        [0.0],
        dt=1.0,
        region={"x": 2, "u": 1},
        parameters={"rate": ("0.2", "0.3")},
        varying=False,
        noise=0.01,
    )
    u, x, y = rng.choice([-1.0, 1.0], (60, 1)).repeat(3, 0), 0.0, []
    for now in u[:, 0]:
        y.append([x + rng.uniform(-0.01, 0.01)])
        x = now + (x - now) * np.exp(-0.24)
    found = jb.parameters(jb.parity_relations(m), u, y)
    assert found.contains({"rate": 0.24}) and found.share < 0.5


def test_the_narrowed_model_sees_faults_that_the_first_one_explains(rng):
    plant = "pole and gain"
    values = {"a": Fraction(7, 10), "b": Fraction(13, 10)}
    u, y = simulated(plant, values, rng, 200)
    found = jb.parameters(RELATIONS[plant], u, y)
    narrowed = found.model
    for p, old in zip(narrowed.uncertainties, PLANTS[plant][1], strict=True):
        lo, hi = (Fraction(x) for x in found.hull[p.name])
        assert old.between[0] <= p.between[0] <= lo < values[p.name] < hi <= p.between[1] <= old.between[1]
        assert p.between[1] - p.between[0] <= Fraction(1001, 1000) * (hi - lo) and not p.varying
    assert narrowed.provenance["model"] == "a, b narrowed by 199 windows of a recording"
    assert narrowed.noise == model_of(plant).noise and narrowed.A != model_of(plant).A
    u, y = simulated(plant, {"a": Fraction(7, 10), "b": Fraction(16, 10)}, rng, 100)
    before = jb.detect(RELATIONS[plant], u, y).status
    after = jb.detect(jb.parity_relations(narrowed, 1), u, y).status
    assert (before == jb.Status.FAULT).sum() == 0 < (after == jb.Status.FAULT).sum()
    empty = jb.parameters(RELATIONS[plant], u, y + 1.5)
    with pytest.raises(ValueError, match="no parameters are left"):
        _ = empty.model


def test_a_parameter_that_no_window_depends_on_keeps_its_bounds(rng):
    plant = "pole and gain"
    u, y = simulated(plant, drawn(plant, rng), rng, 30)
    found = jb.parameters(RELATIONS[plant], 0 * u, np.zeros_like(y))
    assert found.status == "found" and found.share == 1 and found.evaluated == 1
    assert found.hull == found.bounds and found.bounds["a"] == pytest.approx((0.4, 0.9), abs=1e-15)


MODEL = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
VARYING = MODEL.replace(uncertainties=[jb.Uncertainty("th", A=[["0.1"]])])
R = RELATIONS["pole and gain"]
EQUATION = jb.residual(lambda z, u, y: y[0, 0] - z[0], jb.interval([0.0, -1.0], [1.0, 1.0]))
FEW = [[0.0]] * 4


@pytest.mark.parametrize(
    "call, error, words",
    [
        (lambda: jb.parameters(MODEL, FEW, FEW), TypeError, "parity_relations(model)"),
        (lambda: jb.parameters(jb.parity_relations(MODEL), FEW, FEW), ValueError, "ParityRelation has none"),
        (lambda: jb.parameters(jb.redundancy(MODEL), FEW, FEW), ValueError, "has none"),
        (lambda: jb.parameters(jb.observer(MODEL), FEW, FEW), ValueError, "an observer has none"),
        (lambda: jb.parameters(jb.parity_relations(VARYING), FEW, FEW), ValueError, "th may have another"),
        (lambda: jb.parameters(R, FEW, FEW, constant={"a": 0}), ValueError, "for residuals"),
        (lambda: jb.parameters(R, FEW[:1], FEW[:1]), ValueError, "no window of 2 samples is whole"),
        (lambda: jb.parameters(R, FEW, np.full((4, 1), np.nan)), ValueError, "4 samples without"),
        (lambda: jb.parameters(R, [FEW] * 2, [FEW] * 2), ValueError, "takes one recording"),
        (lambda: jb.parameters(R, FEW, [[0.0], [np.inf], [0.0], [0.0]]), ValueError, "inf"),
        (lambda: jb.parameters(R, FEW, FEW, budget=0), ValueError, "budget must be"),
        (lambda: jb.parameters(R, FEW, FEW, precision=0), ValueError, "precision must be"),
        (lambda: jb.parameters(EQUATION, FEW, FEW), ValueError, "which of the 2 unknowns"),
        (lambda: jb.parameters(EQUATION, FEW, FEW, constant={"c": 2}), ValueError, "0 to 1"),
        (lambda: jb.parameters(R, FEW, FEW).contains({"a": 1}), ValueError, "the parameters are"),
    ],
)
def test_refusals_say_what_to_do(call, error, words):
    with pytest.raises(error) as refused:
        call()
    assert words in str(refused.value) and "\n" not in str(refused.value)


def test_the_set_is_told_in_a_few_lines(rng):
    plant = "pole and gain"
    u, y = simulated(plant, drawn(plant, rng), rng, 40)
    found = jb.parameters(RELATIONS[plant], u, y)
    lines = repr(found).splitlines()
    assert lines[0] == f"ParameterSet: found, {len(found.lo)} boxes from 39 windows"
    assert lines[1].startswith("  a: [") and lines[1].endswith("of [0.4, 0.9]") and len(lines) == 5
