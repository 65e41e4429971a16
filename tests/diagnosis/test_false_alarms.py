"""No false alarm, ever: millions of fault-free windows with unknowns at their bounds, large levels, float32;
and still sharp.
"""

import jax
import numpy as np
import pytest
from oracles import MODELS, Plant, Windows, draw
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status

RUNS, SAMPLES = 500, 201
SHARP = {
    "paper": (1e-11, 2e-4),
    "three states": (1e-11, 2e-4),
    "offsets": (1e-11, 1e-3),
}  # float64, float32; signals around 3 and 12


@pytest.fixture(scope="module")
def at_vertices(module_seed):
    """Return fault-free recordings of the paper's system with unknowns at their bounds."""
    u = np.random.default_rng(module_seed).uniform(-1, 1, (RUNS, SAMPLES, 1))
    return jb.simulate(paper(), u, jax.random.key(module_seed), at="vertices")


def new_key(rng):
    return jax.random.key(int(rng.integers(2**31)))


@pytest.mark.parametrize(
    "dtype, at, runs",
    [
        (np.float64, "vertices", 250),
        *(
            pytest.param(dtype, at, 2500, marks=pytest.mark.long)
            for dtype in (np.float64, np.float32)
            for at in ("vertices", "uniform")
        ),
    ],
)
def test_a_million_fault_free_windows_raise_no_fault(dtype, at, runs, rng):
    """Horizons 1 and 2 of 2500 runs: a million windows a case; by day a tenth."""
    u = np.repeat(rng.uniform(-1, 1, (runs, 11, 1)), 20, 1)[:, :SAMPLES].astype(dtype)
    t = jb.simulate(paper(), u, new_key(rng), at=at)
    windows, worst = 0, np.inf
    for horizon in (1, 2):
        res = jb.detect(jb.parity_relations(paper(), horizon=horizon), t.u, t.y)
        assert res.margin.dtype == dtype
        assert res.counts["FAULT"] == 0
        assert res.counts["MISSING"] == runs * horizon
        windows += res.counts["CONSISTENT"] + res.counts["UNDECIDED"]
        worst = min(worst, res.margin[:, horizon:].min())
    print(f"{windows} windows, {res.counts}, smallest margin {worst:.3g}")
    assert windows == runs * (2 * SAMPLES - 3)


def test_a_double_recording_in_single_precision_raises_no_fault(at_vertices):
    u, y = np.asarray(at_vertices.u), np.asarray(at_vertices.y)
    with jax.enable_x64(False):
        res = jb.detect(jb.parity_relations(paper()), u, y)
    assert res.margin.dtype == np.float32 and res.counts["FAULT"] == 0
    assert res.counts["CONSISTENT"] > 40_000


def test_a_recording_in_half_precision_is_refused_for_its_unstated_rounding():
    with pytest.raises(ValueError, match="half precision: convert it to float32 and state in `resolution`"):
        jb.detect(jb.parity_relations(paper()), np.zeros((9, 1)), np.zeros((9, 2), np.float16))


def test_unknowns_at_their_bounds_lie_on_the_boundary(at_vertices):
    """So that the test above is a hard one: a plain comparison calls some of these windows outside."""
    assert (
        np.asarray(jb.margins(jb.parity_relations(paper(), horizon=1), at_vertices.u, at_vertices.y))[:, 1:]
        < 1e-12
    ).sum() > 200


LEVELS = {
    "difference of levels": (
        dict(A=[[1, 1e-3], [0, 1]], B=[[1e-6], [1e-3]], C=[[1, -1], [1e3, -999]], noise=[1e-3, 1e-2]),
        [1e6, 1e6],
    ),
    "unstable": (
        dict(A=[[1.25, 0.3], [0, 1.1]], B=[[0.5], [1]], C=[[1, 0], [1, -1]], noise=[1e-3, 1e-4]),
        [1e3, -2e3],
    ),
    "unstable, tolerant": (
        dict(
            A=[[1.25, 0.3], [0, 1.1]],
            B=[[0.5], [1]],
            C=[[1, 0], [1, -1]],
            tolerance=[0.01, 0.02],
            noise=[1e-3, 0],
        ),
        [1e3, -2e3],
    ),
    "far offset": (
        dict(
            A=[[0.9, 0], [0.1, 0.5]],
            B=[[1], [0]],
            C=[[1, 0], [1, 1]],
            noise=[1e-6, 1e-3],
            offset={"u": [1e6], "y": [1e6, -1e6]},
        ),
        [0, 0],
    ),
    "no noise": (dict(A=[[0.9, 0.2], [0.1, 0.5]], B=[[1], [0]], C=[[1, 0], [1, 1]]), [5, -3]),
    "thirds": (
        dict(
            A=[["1/3", "2/3"], ["-1/7", "8/9"]],
            B=[["1/11"], ["1/13"]],
            C=[["1/3", "-1/3"], ["1/7", 0]],
            noise=["1/3", "1e-9"],
        ),
        [1e5, -1e5],
    ),
}


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("case", LEVELS)
def test_large_levels_raise_no_fault_and_still_show_a_gross_one(case, dtype, rng):
    spec, x0 = LEVELS[case]
    model = jb.LinearSystem(**spec)
    u = (rng.uniform(-1, 1, (200, 60, 1)) + [float(v) for v in Plant(**spec).offset_u]).astype(dtype)
    t = jb.simulate(model, u, new_key(rng), x0=np.array(x0, dtype), at="vertices")
    assert np.isfinite(np.asarray(t.y)).all()
    for horizon in (1, 2):
        counts = jb.detect(jb.parity_relations(model, horizon=horizon), t.u, t.y).counts
        print(f"horizon {horizon}: {counts}")
        assert counts["FAULT"] == 0
    y = np.array(t.y)
    y[:, 30, 1] += abs(y).max() / 2
    assert (jb.detect(jb.parity_relations(model, horizon=1), u, y).status[:, 30] == Status.FAULT).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(
    "name, horizon",
    [
        ("paper", 2),
        ("offsets", 1),
        pytest.param("paper", 1, marks=pytest.mark.long),
        pytest.param("three states", 2, marks=pytest.mark.long),
    ],
)
def test_verdicts_are_sharp(name, horizon, dtype, rng):
    """Just outside is FAULT and just inside is CONSISTENT in at least 99 of 100 windows: by 1e-11 in float64,
    2e-4 in float32.
    """
    sharp, oracle = SHARP[name][dtype == np.float32], Windows(Plant(**MODELS[name]), horizon, dtype)
    u, centre, y = draw(oracle.plant, horizon, 3_000, rng, level=3.0)
    factor = oracle.crossing(u, centre, y)
    found = np.isfinite(factor)
    assert found.mean() > 0.9
    sign = rng.choice([-1, 1], len(y))
    factor = np.where(found, factor, 1) * (1 + sign * sharp * rng.uniform(1, 40, len(y)))
    u, y = u.astype(dtype), (centre + factor[:, None, None] * (y - centre)).astype(dtype)
    gauge = oracle.gauge(u, y)
    outside, inside = (
        (gauge > 1 + sharp) & (gauge < 1 + 10 * sharp),
        (gauge < 1 - sharp) & (gauge > 1 - 10 * sharp),
    )
    status = jb.detect(jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon=horizon), u, y).status[
        :, -1
    ]
    undecided = abs(gauge - 1)[status == Status.UNDECIDED]
    print(
        f"{outside.sum()} just outside, {inside.sum()} just inside; farthest undecided "
        f"{undecided.max(initial=0):.1e}"
    )
    assert outside.sum() > 200 and inside.sum() > 200
    assert (status[outside] == Status.FAULT).mean() >= 0.99
    assert (status[inside] == Status.CONSISTENT).mean() >= 0.99
    assert not (status[gauge < 1 - 1e-12] == Status.FAULT).any()
    assert not (status[gauge > 1 + 1e-12] == Status.CONSISTENT).any()
