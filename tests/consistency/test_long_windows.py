"""Windows whose circuits are too many to enumerate: the verdict of the linear program, proved, whatever the
block and the gaps.
"""

import json
from fractions import Fraction
from itertools import pairwise

import check_certificate
import jax
import numpy as np
import pytest
from boundary import agree, at_boundary, last, moved, numbers, prepared
from oracles import MODELS, Plant, Windows, draw, rational_matrix
from systems import paper

import jaxbound as jb
from jaxbound.consistency import exchange
from jaxbound.sets.floats.status import Status

LONG = [("section 5", 20), ("tclab", 15), ("six states", 10)]
FULL = [
    pytest.param(*case, n, marks=mark)
    for case in LONG
    for n, mark in ((1000, pytest.mark.long), (10_000, pytest.mark.long))
]


@pytest.mark.parametrize("name, horizon, count", [(*LONG[0], 90), *FULL])
def test_the_verdict_is_that_of_the_program(name, horizon, count, shared, rng):
    r, oracle, u, y = prepared(numbers(name, shared), horizon, count, rng)
    assert r.frame is not None
    res = jb.detect(r, u, y)
    share = agree(last(res.status), oracle.slack(u, y))
    print(
        f"{count} windows, {share:.3f} of them FAULT, {(last(res.status) == Status.UNDECIDED).sum()} "
        f"UNDECIDED"
    )
    assert 0.2 < share < 0.8
    near = np.zeros(res.status.shape, bool)
    near[: count // 3] = True
    assert (abs(last(res.measured(near))[: count // 3]) < 0.05).mean() > 0.9


def test_the_margin_is_the_gauge_of_the_program(rng):
    r, oracle, u, y = prepared(MODELS["paper"], 20, 60, rng)
    np.testing.assert_allclose(
        last(jb.detect(r, u, y, margins="exact").margin),
        1 - oracle.gauge_by_program(u, y),
        rtol=1e-7,
        atol=1e-9,
    )


@pytest.mark.usefixtures("as_compiled")
def test_the_margin_is_exact_where_the_search_comes_to_its_last_step():
    """A sensor that is stuck: rows that tie take more exchanges than the compiled search makes."""
    means = {"y1": {3: "0.15"}, "w1": {2: "0.005"}}
    plant = paper(noise=["0.3", "0.2"], tolerance=0, disturbance=([[1], ["0.5"]], "0.01"), averages=means)
    y = np.array([[0.4, 1.6], [1.5, 1.6], [1.6, 1.6], [1.7, 1.6], [1.7, 1.6]])
    res = jb.detect(jb.parity_relations(plant, 4), np.full((5, 1), 0.2), y)
    assert res.margin[-1] == pytest.approx(float(1 - res.explain(4).factor), rel=1e-9)


def test_margins_say_what_detect_says(rng):
    r, _, u, y = prepared(MODELS["paper"], 20, 150, rng)
    res = jb.detect(r, u, y, margins="exact")
    assert (last(res.status) != Status.UNDECIDED).all()
    np.testing.assert_allclose(
        last(np.asarray(jb.margins(r, u, y))), last(res.margin), rtol=1e-10, atol=1e-11
    )


@pytest.mark.long(by_day="diagnosis/test_uncertain_margins::test_margins_change_with_bounds_and_data")
def test_gradients_of_margins_are_those_of_finite_differences(rng):
    r, u = jb.parity_relations(paper(), 20), rng.uniform(-1, 1, (60, 1))
    y = np.array(jb.simulate(paper(), u, jax.random.key(int(rng.integers(2**31)))).y) + 0.3 * rng.normal(
        size=(60, 2)
    )
    total = jax.jit(lambda bounds, y: jb.margins(r.with_bounds(bounds), jax.numpy.asarray(u), y)[20:].sum())
    by_bounds, by_y = jax.jit(jax.grad(total, (0, 1)))(r.bounds, y)
    for name, i in ((name, i) for name in r.bounds for i in range(2)):
        up, down = (
            total({**r.bounds, name: r.bounds[name] + sign * 1e-7 * np.eye(2)[i]}, y) for sign in (1, -1)
        )
        np.testing.assert_allclose(by_bounds[name][i], (up - down) / 2e-7, rtol=1e-4, atol=1e-5)
    for k in (5, 25, 40):
        up, down = (total(r.bounds, y + sign * 1e-7 * np.eye(60)[k][:, None]) for sign in (1, -1))
        np.testing.assert_allclose(by_y[k].sum(), (up - down) / 2e-7, rtol=1e-4, atol=1e-5)


def exact_value(plant, s, u, y, inner, outer, h, dtype):
    """Return (|value|, width) of the combination h of relations on one window, worked out by python-flint
    from the model alone.
    """
    E, K = plant.equation(s)
    ends, reach = plant.ends(s, u, y, dtype)
    R = rational_matrix([E[j] for j in outer]) * rational_matrix([E[i] for i in inner]).inv()
    whole = dict.fromkeys(inner, Fraction(0)) | {j: Fraction(float(x)) for j, x in zip(outer, h, strict=True)}
    for a, row in enumerate(R.tolist()):
        for i, x in zip(inner, row, strict=True):
            whole[i] -= Fraction(float(h[a])) * Fraction(int(x.p), int(x.q))
    used = [(x, i) for i, x in whole.items() if x]
    value = sum((x * ((ends[i][0] + ends[i][1]) / 2 - reach[i]) for x, i in used), Fraction(0))
    return abs(value), sum((abs(x) * (ends[i][1] - ends[i][0]) / 2 for x, i in used), Fraction(0))


def random_plant(rng):
    """Return a plant of the shape of section 5: stable or not, of any size, with identical rows, zero noise
    or a dead mode at times.
    """
    radius = rng.choice([0.0, 0.3, 0.9, 1.0, 1.2, 1.5])
    turn, size = rng.uniform(0, np.pi), 10.0 ** rng.integers(-6, 7, 4)
    A = (
        radius
        * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        @ np.diag([1, rng.choice([1, 1e-4, 1e-9])])
    )
    similar = np.diag([size[0], 1])
    C = rng.normal(size=(2, 2))
    C = np.array([C[0], C[0]]) if rng.random() < 0.2 else C
    A, C = similar @ A @ np.linalg.inv(similar), np.diag(size[2:]) @ C @ np.linalg.inv(similar)
    digits = lambda a: [[float(f"{x:.6g}") for x in row] for row in a]
    noise = [float(f"{v:.3g}") for v in size[2:] * rng.choice([0, 0.01, 1], 2)]
    return dict(
        A=digits(A),
        B=digits(size[1] * rng.normal(size=(2, 1))),
        C=digits(C),
        noise=noise,
        tolerance=rng.choice([0, 0.02], 2).tolist(),
    )


@pytest.mark.parametrize(
    "dtype, models",
    [
        (np.float64, 2),
        pytest.param(np.float64, 40, marks=pytest.mark.long),
        pytest.param(np.float32, 20, marks=pytest.mark.long),
    ],
)
def test_every_fault_of_a_random_plant_is_one_in_exact_arithmetic(dtype, models, rng):
    """One of the directions that were searched proves it, by rationals that know nothing of the kernel;
    spectral radius up to 1.5.
    """
    faults = others = 0
    for _ in range(models):
        model = random_plant(rng)
        plant = Plant(**model)
        r = jb.parity_relations(jb.LinearSystem(**model), 20)
        if r.frame is None:  # a state that hardly shows leaves few circuits: nothing is searched for
            continue
        u, centre, y = draw(plant, 20, 12, rng, spread=2.0)
        y[:4] = moved(
            centre[:4], y[:4], at_boundary(r, u[:4], centre[:4], y[:4], 4) * (1 + 1e-6 * rng.normal(size=4))
        )
        u, y = u.astype(dtype), y.astype(dtype)
        result, test = jb.detect(r, u, y), r.reading(dtype)
        status = last(result.status)
        fill = lambda x: np.repeat(np.moveaxis(x, 0, 2), 86, 2)[..., :1024]
        one = np.ones(1024, dtype)
        unproved = np.flatnonzero(status == Status.FAULT)
        h = np.asarray(exchange.candidates(test, one, fill(u[:, : test.lags]), fill(y))[0])
        exact = {
            w: exact_value(plant, 20, u[w], y[w], r.frame.inner, r.frame.outer, h[:, 86 * w], dtype)
            for w in unproved
        }
        unproved = [w for w, (value, width) in exact.items() if value <= width]
        for w in unproved:  # decided in whole numbers
            document = json.loads(result.explain((int(w), 20)).to_json())
            check_certificate.confirm(document)
            assert document["certificate"] == "FAULT", (model, w)
        faults, others = faults + (status == Status.FAULT).sum(), others + (status == Status.CONSISTENT).sum()
    print(f"{faults} FAULT, {others} CONSISTENT")
    assert faults > models and others > models


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.long)])
@pytest.mark.parametrize("at", ["vertices", "uniform"])
def test_fault_free_windows_raise_no_fault(dtype, at, rng):
    u = np.repeat(rng.uniform(-1, 1, (15, 10, 1)), 40, 1).astype(dtype)
    res = jb.detect(
        jb.parity_relations(paper(), 20),
        u,
        jb.simulate(paper(), u, jax.random.key(int(rng.integers(2**31))), at=at).y,
    )
    assert res.counts["FAULT"] == 0 and res.counts["MISSING"] == 15 * 20
    assert (
        at == "vertices" or res.counts["UNDECIDED"] < 0.001 * res.counts["CONSISTENT"]
    )  # long windows at vertices lie on the boundary


@pytest.mark.parametrize(
    "dtype, step", [(np.float64, 1e-9), pytest.param(np.float32, 1e-2, marks=pytest.mark.long)]
)
def test_verdicts_are_sharp(dtype, step, rng):
    """Outside the boundary by `step` is FAULT, inside CONSISTENT; the boundary is the program's, not ours."""
    oracle = Windows(Plant(**MODELS["paper"]), 20, dtype)
    r = jb.parity_relations(paper(), 20)
    u, centre, y = draw(oracle.plant, 20, 60, rng, level=3.0)
    factor, side = at_boundary(r, u, centre, y, 30), rng.choice([-1, 1], 60)
    u, y = u.astype(dtype), moved(centre, y, factor * (1 + 3 * side * step)).astype(dtype)
    gauge = oracle.gauge_by_program(u, y)
    status, clear = last(jb.detect(r, u, y).status), abs(gauge - 1) > step
    assert clear.mean() > 0.9 and (abs(gauge - 1) < 10 * step).mean() > 0.9
    wrong = np.where(gauge > 1, Status.CONSISTENT, Status.FAULT)
    assert not (status == wrong)[clear].any()
    found = np.mean(status[clear] == np.where(gauge > 1, Status.FAULT, Status.CONSISTENT)[clear])
    print(f"{found:.3f} decided at {step:g}")
    assert found > 0.99


@pytest.mark.compiled
def test_verdicts_do_not_depend_on_the_block_or_the_position_in_it(rng):
    r, samples = jb.parity_relations(paper(), 20), 3000
    u = rng.uniform(-1, 1, (samples, 1))
    y = np.array(jb.simulate(paper(), u, jax.random.key(int(rng.integers(2**31)))).y)
    y += np.repeat(rng.choice([0, 0.05, 0.3], (samples // 50, 1)), 50, 0) * rng.normal(size=y.shape)
    y[rng.random(y.shape) < 0.001] = np.nan
    bounded, whole = jb.detect(r, u, y), jb.detect(r, u, y, margins="exact")
    assert min(whole.counts["FAULT"], whole.counts["CONSISTENT"]) > 100
    np.testing.assert_array_equal(bounded.status, whole.status)
    cuts = [0, 1, 37, 1024, 1100, 2049, samples - 20]
    for a, b in pairwise(cuts):
        part = jb.detect(r, u[a : b + 20], y[a : b + 20])
        np.testing.assert_array_equal(part.status[20:], whole.status[a + 20 : b + 20])
        part = jb.detect(r, u[a : b + 20], y[a : b + 20], margins="exact")
        np.testing.assert_array_equal(part.status[20:], whole.status[a + 20 : b + 20])
        found, expected = part.margin[20:], whole.margin[a + 20 : b + 20]
        gone = np.isnan(y[a : b + 20]).any(1)
        lacking = np.array([gone[k - 20 : k + 1].any() for k in range(20, len(gone))], bool)
        np.testing.assert_array_equal(found[~lacking], expected[~lacking])
        # sums in NumPy may round otherwise for another number of windows
        np.testing.assert_allclose(found[lacking], expected[lacking], rtol=1e-9)


@pytest.mark.compiled
def test_nothing_is_traced_again_for_another_recording_or_model(rng):
    u, y = rng.uniform(-1, 1, (300, 1)), rng.normal(size=(300, 2))
    jb.detect(jb.parity_relations(paper(), 20), u, y)
    traced = exchange.candidates._cache_size(), exchange.proved_margins._cache_size()
    other = paper(
        A=[[0.7, 0.3], [0.1, 0.4]],
        B=[[0.5], [2]],
        tolerance=0.05,
        noise=[1, 2],
        offset={"y": [3, 4]},
        resolution=0.1,
    )
    jb.detect(jb.parity_relations(other, 20), u[:77], y[:77])
    jb.detect(jb.parity_relations(other, 20).with_bounds({"noise": 3.0}), u, y)
    assert traced == (exchange.candidates._cache_size(), exchange.proved_margins._cache_size())


def test_the_first_samples_and_the_seams_of_a_batch_are_missing(rng):
    u, y = rng.uniform(-1, 1, (3, 40, 1)), rng.normal(size=(3, 40, 2))
    res = jb.detect(jb.parity_relations(paper(), 20), u, y)
    assert (res.status[:, :20] == Status.MISSING).all() and np.isnan(res.margin[:, :20]).all()
    assert (res.status[:, 20:] != Status.MISSING).all()


def test_an_infinite_sample_is_refused():
    y = np.zeros((30, 2))
    y[3, 1] = np.inf
    with pytest.raises(ValueError, match="y must be finite .* 'y2' at sample 3"):
        jb.detect(jb.parity_relations(paper(), 20), np.zeros((30, 1)), y)


def test_each_missing_output_gives_the_verdict_of_the_program_without_its_row(rng):
    r, oracle, u, y = prepared(MODELS["paper"], 20, 42 * 12, rng)
    y.reshape(len(y), -1)[np.arange(len(y)), np.arange(len(y)) % 42] = np.nan
    share = agree(last(jb.detect(r, u, y).status), oracle.slack(u, y))
    assert 0.2 < share < 0.8


@pytest.mark.parametrize(
    "name, horizon", [("section 5", 20), pytest.param("six states", 10, marks=pytest.mark.long)]
)
def test_many_missing_outputs_give_the_verdict_of_the_program_without_them(name, horizon, shared, rng):
    """Half of the windows lack rows on which the search is built, some lack all but a few."""
    r, oracle, u, y = prepared(numbers(name, shared), horizon, 400, rng)
    flat = y.reshape(len(y), -1)
    rows = flat.shape[1]
    flat[rng.random(flat.shape) < rng.choice([0.1, 0.4, 0.7], (len(y), 1))] = np.nan
    flat[:200, r.frame.inner] = np.nan
    known = (
        np.isfinite(flat).sum(1) > oracle.plant.n
    )  # any n + 1 samples are related: no row of these models is without information
    status = last(jb.detect(r, u, y).status)
    agree(status[known], oracle.slack(u[known], y[known]))
    np.testing.assert_array_equal(status[~known], Status.MISSING)
    assert known.mean() > 0.9 and (np.isfinite(flat).sum(1) < rows / 2).mean() > 0.2


@pytest.mark.parametrize(
    "name, horizon, gone",
    [
        ("section 5", 20, [7]),
        pytest.param("section 5", 20, [0, 6, 7, 19], marks=pytest.mark.long),
        pytest.param("tclab", 15, [2, 14], marks=pytest.mark.long),
    ],
)
def test_missing_inputs_are_unknown_like_the_state(name, horizon, gone, shared, rng):
    r, oracle, u, y = prepared(numbers(name, shared), horizon, 300, rng)
    y[rng.random(y.shape) < 0.05] = np.nan
    columns = [k * oracle.plant.m for k in gone]
    slack = oracle.slack(
        np.where(np.isin(np.arange(horizon + 1), gone)[:, None] & (np.arange(oracle.plant.m) == 0), 0, u),
        y,
        free=columns,
    )
    u[:, gone, 0] = np.nan
    status = last(jb.detect(r, u, y).status)
    agree(status, slack)
    assert 0.2 < (status == Status.FAULT).mean() < 0.8


def test_a_frame_without_an_input_serves_only_windows_that_it_fits(rng):
    """Two windows lack the same input; the first lacks all rows that input acts on, and its frame keeps the
    input.
    """
    u = rng.uniform(-1, 1, (2, 21, 1))
    y = np.array(jb.simulate(paper(), u, jax.random.key(int(rng.integers(2**31)))).y)
    u[:, 19], y[:, 0, 1], y[0, 20], y[1, 15] = np.nan, np.nan, np.nan, np.nan
    assert (last(jb.detect(jb.parity_relations(paper(), 20), u, y).status) == Status.CONSISTENT).all()
