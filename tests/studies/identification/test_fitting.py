"""A model and its bounds from recordings: against least squares and linear programs worked out here, and a
plant that is known.
"""

import copy
import re

import numpy as np
import pandas as pd
import pytest
from oracles import Plant, Windows
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.models.modelfile import load_model, model_text, save_model
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification import regression
from jaxbound.studies.identification.bounds import verified
from jaxbound.studies.identification.candidates import Candidate
from jaxbound.studies.identification.recipe import recipe_of, recipe_text
from jaxbound.studies.identification.training import Training
from jaxbound.studies.identification.trial import Trial

A, B, C = [[0.8, 0.15], [-0.1, 0.6]], [[0.5], [0.3]], [[1, 0]]


def run(rng, T=120, noise=0.05, a=0.8, level=20.0):
    """Return (u, y) of y+ = a y + u / 2 around a level, with noise on the sensor."""
    u = np.repeat(rng.uniform(-1, 1, (T // 6 + 1, 1)), 6, 0)[:T]
    x = np.zeros(T)
    for k in range(T - 1):
        x[k + 1] = a * x[k] + 0.5 * u[k, 0]
    return u, (level + x + rng.uniform(-noise, noise, T))[:, None]


def plant_of(model):
    lists = lambda m: [list(row) for row in m]
    noise = [model.check.smallest[name] for name in model.outputs]
    offset = {side: list(values) for side, values in model.offset.items()}
    return Plant(lists(model.A), lists(model.B), lists(model.C), noise=noise, offset=offset)


def _mean_by_program(model, b, window, samples):
    """Return the least bound of the mean of errors of at most b each that explain a window of so many
    samples, by a linear program.
    """
    u, y = window
    response, forced = [np.ones(1)], [np.zeros(1)]
    a, drive = float(model.A[0][0]), np.array(model.B[0], float)
    offset = {side: np.array(values, float) for side, values in model.offset.items()}
    for k in range(samples - 1):
        response.append(a * response[-1])
        forced.append(a * forced[-1] + drive @ (u[k] - offset["u"]))
    O, f = np.concatenate(response), np.concatenate(forced) + offset["y"]
    # unknowns: the first state, and the mean; |y - f - O x| <= b, |mean(y - f - O x)| <= t
    left, mean = y[:, 0] - f, np.array([[O.mean(), 0]])
    rows = np.vstack([np.stack([O, 0 * O], 1), np.stack([-O, 0 * O], 1), -mean - [[0, 1]], mean - [[0, 1]]])
    right = np.concatenate([left + b, b - left, [-left.mean()], [left.mean()]])
    found = linprog([0, 1], rows, right, bounds=[(None, None), (0, None)], method="highs")
    assert found.status == 0
    return found.fun


def all_windows(u, y, s):
    return (np.stack([x[k : k + s + 1] for k in range(len(y) - s)]) for x in (u, y))


@pytest.mark.parametrize("at", [0, 30])
def test_a_recording_that_lacks_an_input_is_fitted(at, rng):
    records = [run(rng, 60) for _ in range(2)]
    for u, _ in records:
        u[at] = np.nan  # short windows that need it are UNDECIDED, whatever their bounds
    model = jb.fit(records, order=1, horizon=3)
    for u, y in records:
        counts = jb.detect(jb.parity_relations(model), u, y).counts
        assert not counts["FAULT"] and 0 < counts["UNDECIDED"] <= 3


class TestRegression:
    @pytest.mark.parametrize("direct", [False, True])
    def test_one_step_ahead_is_least_squares(self, rng, direct):
        u, y = rng.normal(size=(60, 2)), rng.normal(size=(60, 2))
        records = [(u[:25], y[:25], ()), (u[25:], y[25:], ())]
        same = regression.Scales(np.zeros(2), np.ones(2), np.zeros(2), np.ones(2))
        theta = regression.least_squares(regression.windows_of(records, same, 2), 2, direct)
        rows, targets = [], []
        for k in [*range(2, 25), *range(27, 60)]:
            rows.append([*y[k - 1], *y[k - 2], *(u[k] if direct else ()), *u[k - 1], *u[k - 2], 1.0])
            targets.append(y[k])
        np.testing.assert_allclose(
            theta, np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0], atol=1e-9
        )

    def test_windows_are_complete_and_cross_no_seam(self, rng):
        u, y, starts = rng.normal(size=(40, 1)), rng.normal(size=(40, 2)), np.array([11, 30])
        y[20, 1], u[35, 0] = np.nan, np.nan
        same = regression.Scales(np.zeros(1), np.ones(1), np.zeros(2), np.ones(2))
        found = regression.windows_of([(u, y, starts)], same, 3)
        whole = [
            k
            for k in range(37)
            if not {20, 35} & set(range(k, k + 4)) and not any(k < s <= k + 3 for s in (11, 30))
        ]
        np.testing.assert_array_equal(found.y, np.stack([y[k : k + 4] for k in whole]))
        np.testing.assert_array_equal(found.u, np.stack([u[k : k + 4] for k in whole]))

    def test_the_share_of_complete_windows_is_of_those_with_outputs(self, rng):
        u, y = rng.normal(size=(30, 1)), rng.normal(size=(30, 2))
        share = lambda *starts, horizon=3: regression.completeness([(u, y, np.array(starts, int))], horizon)
        assert share() == share(horizon=40) == 1
        y[10:20] = np.nan
        assert share() == 14 / 20 and share(10, 20) == 1
        u[25] = np.nan
        assert share(10, 20) == 10 / 14

    def test_the_window_residual_is_what_the_best_first_state_leaves(self, rng):
        theta, u, y = rng.normal(size=(7, 2)) / 3, rng.normal(size=(4, 6, 1)), rng.normal(size=(4, 6, 2))
        A1, A2, B1, B2 = theta[:2].T, theta[2:4].T, theta[4:5].T, theta[5:6].T
        free, forced = [], []
        for first in [*np.eye(4), np.zeros(4)]:  # the two outputs, and what the second one waits for
            now, later, out = np.tile(first[:2], (4, 1)), np.tile(first[2:], (4, 1)), []
            alone = not first.any()
            for j in range(6):
                out.append(now)
                drive = lambda b, j=j, alone=alone: alone * u[:, j] @ b.T
                now, later = later + now @ A1.T + drive(B1) + alone * theta[6], now @ A2.T + drive(B2)
            (forced if alone else free).append(np.stack(out, 1).reshape(4, -1))
        best = np.stack(
            [
                np.linalg.lstsq(np.stack([f[i] for f in free], 1), e, rcond=None)[1][0]
                for i, e in enumerate(y.reshape(4, -1) - forced[0])
            ]
        )
        e = regression._residuals(theta, u, y, np.ones(2), 2, False)
        np.testing.assert_allclose((e**2).sum(1), best, rtol=1e-8)

    def test_refining_never_widens_the_windows_nor_adds_growth(self, rng):
        u, y = run(rng, noise=0.3)
        scales = regression.scales_of([(u, y, ())])
        windows = regression.windows_of([(u, y, ())], scales, 8)
        theta = regression.least_squares(regression.windows_of([(u, y, ())], scales, 2), 2, False)
        finer, spread = regression.refined_coefficients(theta, windows, 2, False)
        assert spread[0] <= regression.window_spread(theta, windows, 2, False)[0]
        assert regression.growth(finer, 2) <= max(1, regression.growth(theta, 2))

    @pytest.mark.parametrize("direct", [False, True])
    def test_the_slopes_are_those_of_the_residuals(self, rng, direct):
        theta, weight = rng.normal(size=(9 + 2 * direct, 2)) / 3, np.array([0.5, 2.0])
        u, y = rng.normal(size=(5, 7, 2)), rng.normal(size=(5, 7, 2))
        of = lambda change: regression._residuals(theta + change, u, y, weight, 2, direct).ravel()
        columns = []
        for i in range(theta.size):
            step = np.zeros(theta.size)
            step[i] = 1e-6
            columns.append((of(step.reshape(theta.shape)) - of(-step.reshape(theta.shape))) / 2e-6)
        J = np.stack(columns, 1)
        H, g = regression._slopes(theta, u, y, weight, 2, direct)
        np.testing.assert_allclose(H, J.T @ J, atol=1e-6 * abs(H).max())
        np.testing.assert_allclose(g, J.T @ of(0 * theta), atol=1e-6 * abs(g).max())

    def test_a_model_that_explodes_is_no_error(self, rng):
        theta = np.array([[1e200], [1.0], [0.0]])
        windows = regression.CompleteWindows(
            rng.normal(size=(4, 9, 1)), rng.normal(size=(4, 9, 1)), np.zeros(4, int)
        )
        assert not np.isfinite(regression.window_residuals(theta, windows, 1, False)).all()


class TestModel:
    def test_a_known_plant_is_recovered(self, rng):
        model = jb.fit([run(rng, 60), run(rng, 60)], order=1, horizon=4)
        assert abs(float(model.A[0][0]) - 0.8) < 0.06 and abs(float(model.B[0][0]) - 0.5) < 0.1
        assert 0.03 < float(model.noise[0]) < 0.05 * 1.25 * 1.5

    def test_second_order_behaviour_is_recovered(self, rng):
        true = jb.LinearSystem(A, B, C)
        u = rng.uniform(-1, 1, (300, 1))
        x, y = np.zeros(2), np.zeros((300, 1))
        for k in range(300):
            y[k], x = np.array(C) @ x, np.array(A) @ x + np.array(B) @ u[k]
        model = jb.fit((u, y + rng.uniform(-0.01, 0.01, y.shape)), order=2, horizon=8)
        response = lambda m: [
            float(
                (
                    np.array(m.C, float)
                    @ np.linalg.matrix_power(np.array(m.A, float), j)
                    @ np.array(m.B, float)
                )[0, 0]
            )
            for j in range(8)
        ]
        np.testing.assert_allclose(response(model), response(true), atol=0.02)

    def test_the_smallest_bound_is_that_of_the_linear_program(self, rng):
        u, y = run(rng, T=90)
        model = jb.fit((u, y), order=1, horizon=4)
        gauge = Windows(plant_of(model), 4).gauge_by_program(*all_windows(u, y, 4))
        assert abs(gauge.max() - 1) < 1e-6

    def test_every_training_window_is_proved_consistent_and_with_a_little_less_not(self, rng):
        records = [run(rng, 60), run(rng, 60)]
        model = jb.fit(records, order=1, horizon=4, safety=1)
        r = jb.parity_relations(model)
        verdicts = np.concatenate([jb.detect(r, *record).status[4:] for record in records])
        assert r.horizon == 4 and (verdicts == Status.CONSISTENT).all()
        less = r.with_bounds({"noise": model.check.smallest["y1"] * (1 - 1e-6)})
        assert any((jb.detect(less, *record).status == Status.FAULT).any() for record in records)

    def test_the_bound_of_a_mean_is_the_smallest_that_explains_every_window(self, rng, tmp_path):
        u, y = run(rng, T=90, noise=0.1)
        model = jb.fit((u, y), order=1, horizon=4, average=5, safety=1.2)
        (one,), b, mean = model.averages, model.check.smallest["y1"], model.check.smallest_mean["y1"]
        assert (one.signal, len(one.weights), one.is_mean) == ("y1", 5, True) and mean < 0.8 * b
        wider = 1.2 * model.check.factor
        assert wider * mean <= float(one.bound) < wider * mean * 1.01
        assert (jb.detect(jb.parity_relations(model), u, y).status[4:] == Status.CONSISTENT).all()
        assert max(r["used"] for r in model.check.recordings) <= 1 / 1.2 + 1e-5
        explained = [
            _mean_by_program(model, b * (1 + 2e-6), window, 5)
            for window in zip(*all_windows(u, y, 4), strict=True)
        ]
        assert 0.98 * mean < max(explained) <= mean * (1 + 1e-9)
        save_model(model, tmp_path / "plant.toml")
        assert load_model(
            tmp_path / "plant.toml"
        ).averages == model.averages and "{samples = 5, bound = " in model_text(model)
        assert jb.fit((u, y), order=1, horizon=4).averages == ()

    def test_errors_that_do_not_average_out_get_no_bound_of_a_mean(self, rng):
        u, y = run(rng, T=90, noise=0.0)
        lasting = np.repeat(rng.choice([-0.1, 0.1], 9), 10)[:, None]
        model = jb.fit((u, y + lasting), order=1, horizon=4, average=2)
        assert model.averages == () and any("do not average out" in s for s in model.check.sentences)

    def test_the_constant_becomes_the_operating_point(self, rng):
        u, y = run(rng, level=350.0)
        model = jb.fit((u, y), order=1, horizon=4)
        rest = float(model.offset["y"][0]) - float(model.B[0][0]) / (1 - float(model.A[0][0])) * float(
            model.offset["u"][0]
        )
        assert abs(rest - 350) < 0.1  # where the plant stays without input

    def test_bounds_hold_for_the_model_as_it_is_saved(self, rng, tmp_path):
        u, y = run(rng, T=100)
        about = dict(dt=0.5, inputs=["pump"], outputs=["level"], units={"level": "m"}, name="tank")
        model = jb.fit((u, y), order=1, horizon=4, **about)
        save_model(model, tmp_path / "tank.toml")
        again = load_model(tmp_path / "tank.toml")
        assert again == model == copy.deepcopy(model)
        assert model_text(model) == f"{model_text(again)}\n[fit]\norder = 1\nhorizon = 4\n"
        repeated = jb.fit((u, y), tmp_path / "tank.toml", **about)
        assert model_text(repeated) == model_text(model)
        assert (again.horizon, again.dt, again.inputs, again.outputs, again.unit("level")) == (
            4,
            0.5,
            ("pump",),
            ("level",),
            "m",
        )
        assert max(len(str(float(x))) for row in (*again.A, *again.B) for x in row) <= 12
        assert again.provenance["noise"] == model.provenance["noise"]
        said = f"factor {model.check.factor:.3g} of what was left out, safety factor 1.25"
        assert again.provenance["noise"] == f"fitted to 100 samples in 1 recording, {said}"

    def test_an_input_may_act_at_once(self, rng):
        u = rng.uniform(-1, 1, (120, 1))
        y = 3 * u + rng.uniform(-0.01, 0.01, u.shape)
        slow, quick = (jb.fit((u, y), order=1, horizon=4, direct=d) for d in (False, True))
        assert quick.has_feedthrough and quick.noise[0] < 0.03 < slow.noise[0]

    def test_without_inputs(self, rng):
        x = 5 + 2 * 0.97 ** np.arange(80.0)[:, None]
        model = jb.fit((None, x + rng.uniform(-0.01, 0.01, x.shape)), order=1, horizon=4)
        assert model.m == 0 and model.noise[0] < 0.03


class TestStatic:
    def test_outputs_that_follow_inputs_at_once(self, rng, tmp_path):
        def day(count):
            u = rng.uniform(0, 10, (count, 2))
            return u, 3 + u @ np.array([[2.0, 0], [0.5, -1.0]]) + rng.uniform(-0.1, 0.1, (count, 2))

        records = [day(80), day(60)]
        model = jb.fit(records, order=0)
        np.testing.assert_allclose(np.array(model.D, float), [[2, 0.5], [0, -1]], atol=0.02)
        assert (model.n, model.horizon, model.check.order) == (0, 0, 0) and model.check.factor >= 1
        relations = jb.parity_relations(model)
        assert all(jb.detect(relations, *r).counts["CONSISTENT"] == len(r[1]) for r in records)
        smallest = [model.check.smallest[name] for name in model.outputs]
        u, y = (np.concatenate(x) for x in zip(*records, strict=True))
        left = _static_residual(model, u, y)
        assert np.max(np.abs(left) / smallest) == pytest.approx(1, rel=1e-6)
        size = 1.01 * model.check.steady["y1"]
        assert jb.detect(relations, u, y + [size, 0]).counts["FAULT"] == len(y)
        jb.save_model(model, tmp_path / "static.toml")
        assert jb.load_model(tmp_path / "static.toml") == model.replace()


def _static_residual(model, u, y):
    D, at_u, at_y = (np.array(x, float) for x in (model.D, model.offset["u"], model.offset["y"]))
    return y - at_y - (u - at_u) @ D.T


class TestRecordings:
    def test_missing_samples_and_seams_count_for_nothing(self, rng):
        u, y = run(rng)
        broken = y.copy()
        broken[40:43] = np.nan
        broken[80:] += 7.0  # another level: only because of the seam before it this does no harm to windows
        model = jb.fit((u, broken, np.array([80])), order=1, horizon=4)
        need = model.check.used[0]
        assert np.isnan(need[80:84]).all() and np.isfinite(need[84:]).all()

    def test_a_table_with_dates_is_cut_at_its_gaps(self, rng):
        u, y = run(rng, T=120)
        index = pd.date_range("2026-01-01", periods=120, freq="s").to_series()
        index.iloc[60:] += pd.Timedelta("1h")
        table = pd.DataFrame({"pump": u[:, 0], "level": y[:, 0], "other": "text"}, index=index)
        model = jb.fit([table], order=1, horizon=4, inputs="pump", outputs=["level"])
        plain = jb.fit((u, y, [60]), order=1, horizon=4)
        assert (
            (model.inputs, model.outputs) == (("pump",), ("level",))
            and model.A == plain.A
            and model.noise == plain.noise
        )

    def test_a_table_tells_its_period_as_a_file_does(self, rng, tmp_path):
        """Whatever its index: dt was 1, and the shell refused the model."""
        u, y = run(rng)
        table = pd.DataFrame({"valve": u[:, 0], "level": y[:, 0], "Time (s)": 3.0 * np.arange(len(y))})
        table.to_csv(tmp_path / "run.csv", index=False)
        of = dict(order=1, horizon=4, inputs="valve", outputs="level", held_out=0, method="least squares")
        for given in (table, table.set_axis(table.index + 5), table.set_index("Time (s)"), [table, table]):
            model = jb.fit(given, **of)
            assert model.dt == 3.0
        assert jb.read(tmp_path / "run.csv", model).dt == 3.0
        assert not (jb.detect(jb.parity_relations(model, 4), table).status == jb.Status.FAULT).any()


class TestLeftOut:
    OF = dict(order=1, horizon=4, method="least squares")

    def test_each_recording_is_judged_by_a_fit_to_the_others(self, rng):
        records = [run(rng, 60), run(rng, 80, noise=0.1), run(rng, 70)]
        check = jb.fit(records, **self.OF).check
        smallest = [check.smallest["y1"]]
        for i, (left, (u, y)) in enumerate(zip(check.left_out, records, strict=True)):
            others = jb.fit([*records[:i], *records[i + 1 :]], **self.OF, held_out=0)
            relations = jb.parity_relations(others).with_bounds({"noise": smallest})
            worst = 1 - np.nanmin(jb.detect(relations, u, y).margin)
            assert left.windows == len(y) - 4 and left.factor == pytest.approx(worst, rel=0.02)
            assert others.check.left_out == () and others.check.factor == 1

    def test_bounds_are_as_wide_as_recordings_ask_for_on_average(self, rng):
        """The widest is in the smallest bounds: what it asks for is not asked for once more."""
        model = jb.fit([run(rng, 60), run(rng, 60), run(rng, 60, a=0.6)], **self.OF)
        check = model.check
        asked = [max(one.factor, 1) for one in check.left_out]
        unlike = asked[-1]
        assert check.factor == pytest.approx(np.cbrt(np.prod(asked)) * np.sqrt(1.15))
        assert check.factor < unlike == max(asked)
        bound = float(model.noise[0] + model.resolution[0])
        assert bound == pytest.approx(check.factor * 1.25 * check.smallest["y1"], rel=0.01)
        assert check.held_out["growth"] == pytest.approx(unlike / 1.25)
        largest = max(np.nanmax(used) for used in check.held_out_used)
        assert largest == pytest.approx(unlike / check.factor / 1.25)
        assert f"factor {check.factor:.3g} of what was left out" in model.provenance["noise"]

    def test_means_are_as_wide_too(self, rng):
        records = [run(rng, 60), run(rng, 60, a=0.7)]
        model = jb.fit(records, **self.OF, average=4)
        (one,), check = model.averages, model.check
        bound = float(one.bound + model.resolution[0])
        assert bound == pytest.approx(check.factor * 1.25 * check.smallest_mean["y1"], rel=0.01)

    def test_others_that_do_not_move_carry_no_model(self, rng):
        moved, still = run(rng, 80), run(rng, 80)
        still = 0 * still[0], still[1]
        check = jb.fit([moved, still], **self.OF).check
        assert [one.why for one in check.left_out] == ["the others do not move all that it moves", ""]
        assert np.isnan(check.left_out[0].factor)
        assert check.factor == pytest.approx(1.15 * max(check.left_out[1].factor, 1))
        assert any(
            s.startswith("recording 1 says nothing of another day: the others") for s in check.sentences
        )

    def test_a_single_recording_is_cut_into_blocks(self, rng):
        u, y = run(rng)
        check = jb.fit((u, y), **self.OF, held_out=0.25).check
        assert [one.windows for one in check.left_out] == [26] * 4
        assert any("its 4 blocks of" in s for s in check.sentences)

    def test_a_recording_without_a_window_has_no_factor(self, rng):
        check = jb.fit([run(rng, 80), run(rng, 80), run(rng, 4)], **self.OF).check
        assert check.left_out[2].why == "it holds no window"


class TestObserver:
    OF = dict(order=1, method="least squares")

    @pytest.mark.compiled
    @pytest.mark.parametrize("observer", ["zonotope", pytest.param("joint", marks=pytest.mark.long)])
    def test_bounds_are_those_at_which_it_follows_every_recording(self, observer, rng):
        records = [run(rng, 60), run(rng, 50, noise=0.08)]
        model = jb.fit(records, **self.OF, observer=observer, safety=1)
        check = model.check
        assert model.horizon is None and model.lags is None and check.steady == {}
        assert model.extrapolation is None, "it rests on all samples before, inside and outside"
        assert "for an observer" in model.provenance["noise"]

        def follows(bound, recording, of=model):
            watch = jb.observer(of.replace(noise=bound, resolution=0), method=observer)
            return not jb.detect(watch, *recording).counts["FAULT"]

        smallest = check.smallest["y1"]
        assert all(follows(smallest, r) for r in records)
        assert not all(follows(0.985 * smallest, r) for r in records)
        for number, one in enumerate(check.left_out):
            others = jb.fit(records[1 - number], **self.OF, observer=observer, held_out=0)
            assert follows(one.factor * smallest, records[number], others)
            assert not follows(0.985 * one.factor * smallest, records[number], others)
        assert float(model.noise[0] + model.resolution[0]) == pytest.approx(check.factor * smallest, rel=0.01)
        size = check.jump["y1"]
        u, y = records[0]
        late = y + 1.05 * size * (np.arange(len(y)) >= 30)[:, None]
        assert jb.detect(jb.observer(model, method=observer), u, late).counts["FAULT"]

    @pytest.mark.compiled
    def test_windows_of_a_model_that_was_fitted_for_one_prove_no_fault(self, rng):
        u, y = run(rng, 60)
        model = jb.fit([(u, y), run(rng, 60)], **self.OF, observer="zonotope")
        said = jb.detect(jb.parity_relations(model), u, y).hints
        assert any("found from data for an observer" in hint for hint in said)
        assert not any("found from data" in hint for hint in jb.detect(jb.observer(model), u, y).hints)


COMMAND = re.compile(r"(--[a-z-]+ ?[\w.,:'-]*|jaxbound fit .*|\w+=.*|in --\w+)[^;]*$")


class TestCautions:
    def said(self, records, **options):
        """Return the cautions; each ends in what to do next, as a command or an argument."""
        sentences = jb.fit(records, **{"order": 1, "horizon": 4} | options).check.sentences
        assert all(COMMAND.search(sentence) for sentence in sentences), sentences
        return " | ".join(sentences)

    def test_nothing_to_say_of_good_recordings(self, rng):
        u, y = run(rng, 60)
        assert self.said([(u + 1, y + 2.5), run(rng, 60)], safety=2) == ""

    def test_recordings_that_are_alike(self, rng):
        """They ask for nothing, left out, and say nothing of a day that is not like them."""
        (u, y), other = run(rng, 60), run(rng, 60)
        assert "the 2 recordings are alike" in self.said([(u, y), other])
        assert "alike" not in self.said([(u + 1, y + 2.5), other])

    def test_an_input_that_never_moves(self, rng):
        u, y = run(rng)
        still = np.concatenate([u, 0 * u + 3], 1)
        assert "u2 never moves in these recordings" in self.said((still, y))
        with pytest.raises(ValueError, match=r"no input moves in these recordings \(u1\)"):
            self.said((0 * u + 3, y))

    def test_inputs_that_move_together(self, rng):
        u, y = run(rng)
        said = self.said((np.hstack([u, 2 * u + 1e-3 * rng.normal(size=u.shape)]), y))
        assert "u1 and u2 move together (correlation 1.000)" in said
        assert "move together" not in self.said((np.hstack([u, rng.normal(size=u.shape)]), y))

    def test_recordings_that_contradict_each_other(self, rng):
        said = self.said([run(rng, 60, noise=0.01), run(rng, 60, noise=0.4)])
        assert (
            "recording 2 needs bounds" in said
            and "times as wide as recording 1: they contradict each other" in said
        )

    def test_too_little_history(self, rng):
        said = self.said(run(rng, T=30))
        assert "hold only 6 windows of 5 samples that do not overlap" in said

    def test_nothing_left_out(self, rng):
        assert (
            "nothing was left out: what the monitor makes of data that it has not seen is unknown"
            in self.said(run(rng), held_out=0)
        )

    def test_a_blind_monitor(self, rng):
        said = self.said((rng.normal(size=(120, 1)), rng.normal(size=(120, 1))))
        assert said.startswith("the monitor is blind for y1: no jump below"), "what matters most is first"


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(order=-1), "order must be a whole number >= 0, or auto, not -1"),
        (dict(order=0, method="filters"), "a static model, order 0, is fitted by least squares"),
        (dict(horizon=1), r"horizon must be a whole number above the order \(1\), not 1"),
        (
            dict(observer="joint", average=2),
            "average is for windows: a fit for an observer looks at every sample",
        ),
        (dict(observer="sharp"), "observer: an observer is one of zonotope"),
        (dict(safety=0.9), "safety must be a factor >= 1, not 0.9"),
        (dict(average=6), "average must be a whole number from 2 to the 5 samples of a window, not 6"),
        (dict(average=True), "average must be a whole number from 2"),
        (dict(held_out=1), "held_out must be a share from 0 to below 1, not 1"),
        (dict(recordings=[]), "there is no recording"),
        (dict(recordings=[3]), r"recording 1 must be a pair \(u, y\), a DataFrame or a Recording, not int"),
        (dict(recordings=pd.DataFrame({"a": [1.0]})), r"recording 1 is a DataFrame: say with inputs"),
        (
            dict(recordings=pd.DataFrame({"a": [1.0], "b": [2.0]}), outputs=["A"], inputs="b"),
            "recording 1: y has no column 'A'",
        ),
        (
            dict(recordings=(np.zeros((9, 1)), np.zeros((8, 1)))),
            "recording 1: u and y must have the same number of samples: 9 and 8",
        ),
        (dict(recordings=(np.zeros((9, 1)), np.full((9, 1), np.inf))), "recording 1: y must be finite"),
        (dict(recordings=(np.zeros((9, 1)), np.full((9, 1), 5.0))), "y1 stands still in all recordings"),
        (
            dict(recordings=(None, np.arange(9.0)), order=3),
            "too few samples: 9, in 1 recording, hold 5 complete windows of 5 .* 6 steps for 4",
        ),
        (
            dict(recordings=(None, np.arange(4.0))),
            "too few samples: 4, in 1 recording, hold 0 complete windows of 5",
        ),
        (
            dict(recordings=(np.zeros((2, 9, 1)), np.zeros((2, 9, 1)))),
            "time must be its first axis: give several recordings as a list",
        ),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_sentence(change, message):
    with pytest.raises(ValueError, match=message):
        jb.fit(**{"recordings": [], "order": 1, "horizon": 4} | change)


def test_a_plant_that_fits_without_any_error_has_bounds_of_rounding(rng):
    u = rng.integers(-3, 4, (120, 1)).astype(float)
    model = jb.fit([(u, np.vstack([[[0.0]], u[:-1]]))], order=1, horizon=4, method="least squares")
    assert 0 < float(model.noise[0]) < 1e-9 and model.check.held_out["fault"] == 0


def test_bounds_that_never_hold_are_refused(rng):
    """The last ones that were tried were written."""

    class Never:
        def shares(self, model, records):
            return False, []

    u, y = run(rng)
    spec = jb.fit((u, y), order=1, horizon=4, method="least squares", held_out=0)._arguments()
    for name in ("noise", "resolution", "provenance", "averages", "disturbance"):
        spec.pop(name, None)
    trial = Trial(Candidate("least squares", spec, np.array([0.1])), np.array([0.1]), (), 0.0, 1)
    training = Training.of((u, y), None, None, None, {})
    with pytest.raises(ValueError, match="no bounds were found that are proved to hold"):
        verified(Never(), trial, training, 1.25)


def test_a_recipe_is_read_from_its_table_as_it_was_written(tmp_path):
    faults = (jb.Fault("y", "bias", 0.5, 3, 9), jb.Fault("y", "drift", 0.1))
    asked = recipe_of(None, {"order": 1, "observer": "joint", "disturbances": "auto", "see": faults})
    lines = [f"{name} = {text}" for name, text in recipe_text(asked).items()]
    (tmp_path / "plant.toml").write_text("\n".join(["[fit]", *lines]))
    again = recipe_of(tmp_path / "plant.toml", {})
    assert again.faults == faults and recipe_text(again) == recipe_text(asked)
