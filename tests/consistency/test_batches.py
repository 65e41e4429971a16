"""Recordings in any shape and form give the same verdicts: batches, chunks, DataFrames, lists, float32;
nothing is traced twice.
"""

import jax
import numpy as np
import pandas as pd
import pytest
from oracles import MODELS, Plant
from systems import paper

import jaxbound as jb
from jaxbound.consistency import strips
from jaxbound.sets.floats.status import Status


def recording(shape, rng, name="paper"):
    """Return u, y around the operating point, quiet and loud by turns, with holes: MISSING, CONSISTENT and
    FAULT all occur.
    """
    plant, samples = Plant(**MODELS[name]), shape[-1]
    size = np.repeat(10 ** rng.uniform(-3, 0.5, (*shape[:-1], samples // 8 + 1, 1)), 8, -2)[..., :samples, :]
    u = rng.uniform(-1, 1, (*shape, plant.m)) * size + [float(v) for v in plant.offset_u]
    y = rng.normal(size=(*shape, plant.p)) * size + [float(v) for v in plant.offset_y]
    y[rng.random(y.shape) < 0.05] = np.nan
    return u, y


def same(a, b):
    np.testing.assert_array_equal(a.status, b.status)
    np.testing.assert_array_equal(a.margin, b.margin)


@pytest.mark.parametrize("method", ["joint", "box"])
@pytest.mark.parametrize("name, horizon", [("paper", 1), ("paper", 3), ("offsets", 1)])
def test_a_batch_gives_the_verdicts_of_its_recordings_one_by_one(name, horizon, method, rng):
    r = jb.parity_relations(jb.LinearSystem(**MODELS[name]), horizon=horizon)
    u, y = recording((2, 3, 40), rng, name)
    whole = jb.detect(r, u, y, method=method)
    assert whole.status.shape == whole.margin.shape == (2, 3, 40)
    for i in np.ndindex(2, 3):
        one = jb.detect(r, u[i], y[i], method=method)
        np.testing.assert_array_equal(whole.status[i], one.status)
        np.testing.assert_array_equal(whole.margin[i], one.margin)
    assert set(np.unique(whole.status)) >= {
        Status.MISSING,
        Status.CONSISTENT if method == "joint" else Status.UNDECIDED,
        Status.FAULT,
    }


def test_one_input_serves_a_batch_of_outputs(rng):
    u, y = recording((5, 30), rng)
    r = jb.parity_relations(paper(), horizon=2)
    same(jb.detect(r, u[0], y), jb.detect(r, np.repeat(u[:1], 5, 0), y))


def test_one_output_serves_a_batch_of_inputs(rng):
    u, y = recording((5, 30), rng)
    r = jb.parity_relations(paper(), horizon=2)
    same(jb.detect(r, u, y[:1]), jb.detect(r, u, np.repeat(y[:1], 5, 0)))


def test_margins_of_a_batch_equal_those_one_by_one(rng):
    r, (u, y) = jb.parity_relations(paper(), horizon=2), recording((2, 3, 30), rng)
    whole = jb.margins(r, u, y)
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(whole[i], jb.margins(r, u[i], y[i]))


def test_margins_are_the_same_traced_and_not(rng):
    r, (u, y) = jb.parity_relations(paper(), horizon=2), recording((3, 30), rng)
    plain, traced = jb.margins(r, u, y), jax.jit(lambda u, y: jb.margins(r, u, y))(u, y)
    assert np.isnan(np.asarray(traced)[:, :2]).all()
    np.testing.assert_allclose(plain, traced, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("horizon", [1, 3])
def test_verdicts_do_not_depend_on_where_a_block_ends(horizon, rng):
    """Around every multiple of the block size a long recording says what a short one of the same samples
    says.
    """
    r = jb.parity_relations(paper(), horizon=horizon)
    block = r.test("joint", np.float64).block
    assert block == (2**17 if horizon == 1 else 2**12)
    for samples in (
        block - 1,
        block,
        block + 1,
        block + horizon - 1,
        block + horizon,
        block + horizon + 1,
        2 * block + horizon + 5,
    ):
        u, y = recording((samples,), rng)
        long = jb.detect(r, u, y)
        for seam in range(block, samples + 1, block):
            part = slice(max(seam - 20, 0), min(seam + 20, samples))
            short = jb.detect(r, u[part], y[part])
            np.testing.assert_array_equal(long.status[part][horizon:], short.status[horizon:])
            np.testing.assert_array_equal(long.margin[part][horizon:], short.margin[horizon:])
        tail = jb.detect(r, u[-30:], y[-30:])
        np.testing.assert_array_equal(long.status[-20:], tail.status[-20:])


def test_a_batch_across_a_block_end_is_seamless(rng):
    r, (u, y) = jb.parity_relations(paper(), horizon=3), recording((5, 7001), rng)
    whole = jb.detect(r, u, y)
    for i in range(5):
        np.testing.assert_array_equal(whole.status[i], jb.detect(r, u[i], y[i]).status)


@pytest.mark.compiled
def test_recordings_of_other_lengths_do_not_trace_again(rng):
    r = jb.parity_relations(paper(), horizon=2)
    jb.detect(r, *recording((50,), rng))
    traced = strips.verdicts._cache_size()
    for shape in ((51,), (2**14 + 77,), (3, 4, 20), (2,)):
        jb.detect(r, *recording(shape, rng))
    assert strips.verdicts._cache_size() == traced


@pytest.mark.compiled
@pytest.mark.parametrize("horizon", [1, 2])
def test_a_second_model_of_the_same_shape_does_not_trace_again(horizon, rng):
    u, y = recording((50,), rng)
    jb.detect(jb.parity_relations(paper(), horizon=horizon), u, y)
    traced = strips.verdicts._cache_size()
    other = paper(
        A=[[0.7, 0.3], [0.1, 0.4]],
        B=[[0.5], [2]],
        tolerance=0.05,
        noise=[1, 2],
        offset={"y": [3, 4]},
        resolution=0.1,
    )
    jb.detect(jb.parity_relations(other, horizon=horizon), u, y)
    jb.detect(jb.parity_relations(other, horizon=horizon).with_bounds({"noise": 3.0}), u, y)
    assert strips.verdicts._cache_size() == traced


def test_float32_stays_float32(rng):
    u, y = (v.astype(np.float32) for v in recording((50,), rng))
    r = jb.parity_relations(paper())
    res = jb.detect(r, u, y)
    assert {x.dtype for x in (res.margin, res.y, jb.margins(r, u, y), r.external(u, y))} == {
        np.dtype(np.float32)
    }


def test_the_input_takes_the_type_of_the_output(rng):
    u, y = recording((50,), rng)
    assert jb.detect(jb.parity_relations(paper()), u, y.astype(np.float32)).margin.dtype == np.float32


def test_columns_of_a_frame_are_found_by_name(rng):
    u, y = recording((40,), rng)
    index = pd.date_range("2024-01-01", periods=40, freq="10ms")
    frame = pd.DataFrame({"y2": y[:, 1], "other": 1.0, "u1": u[:, 0], "y1": y[:, 0]}, index=index)
    r = jb.parity_relations(paper())
    res = jb.detect(r, frame, frame)
    same(res, jb.detect(r, u, y))
    assert res.index is frame.index


def test_columns_may_have_names_of_their_own(rng):
    u, y = recording((40,), rng)
    frame = pd.DataFrame({"T in": y[:, 0], "T out": y[:, 1], "valve": u[:, 0]})
    r = jb.parity_relations(paper(columns={"y1": "T in", "y2": "T out", "u1": "valve"}))
    same(jb.detect(r, frame, frame), jb.detect(r, u, y))


def test_a_series_serves_a_single_channel(rng):
    u, y = recording((40,), rng)
    r = jb.parity_relations(paper())
    same(jb.detect(r, pd.Series(u[:, 0]), y), jb.detect(r, u, y))


def test_integers_and_lists_are_numbers(rng):
    u, y = rng.integers(-2, 3, (40, 1)), rng.integers(-2, 3, (40, 2))
    r = jb.parity_relations(paper())
    expected = jb.detect(r, u.astype(float), y.astype(float))
    same(jb.detect(r, u, y), expected)
    same(jb.detect(r, u.tolist(), y.tolist()), expected)
    same(jb.detect(r, jax.numpy.asarray(u), jax.numpy.asarray(y)), expected)
    same(jb.detect(r, u[:, 0], y), expected)


@pytest.mark.parametrize(
    "change, error, message",
    [
        (dict(u=None), ValueError, "u is missing: the model has the inputs u1"),
        (dict(u=np.zeros((9, 1))), ValueError, "u and y must have the same number of samples: 9 and 10"),
        (
            dict(y=np.zeros((10, 3))),
            ValueError,
            r"y must have shape \(\.\.\., T, 2\), time first, .* y1, y2: its shape is \(10, 3\)",
        ),
        (
            dict(y=np.zeros((2, 10, 2)), u=np.zeros((3, 10, 1))),
            ValueError,
            r"the leading axes of u \(3, 10, 1\) and y \(2, 10, 2\) do not fit",
        ),
        (dict(y=[["a", "b"]] * 10), ValueError, "y must be numbers"),
        (
            dict(y=np.where(np.arange(20).reshape(10, 2) == 7, np.inf, 0)),
            ValueError,
            "y must be finite .* 1 of 20 .* in 'y2' at sample 3",
        ),
        (
            dict(u=np.where(np.arange(10)[:, None] == 4, -np.inf, 0)),
            ValueError,
            "u must be finite .* first in 'u1' at sample 4",
        ),
        (
            dict(y=pd.DataFrame({"y1": [0.0] * 10, "z2": [0.0] * 10})),
            ValueError,
            "y has no column 'y2'; did you mean 'z2'",
        ),
        (
            dict(y=pd.DataFrame({"y1": [0.0] * 10, "other": [0.0] * 10})),
            ValueError,
            "y has no column 'y2': it has 'y1', 'other'",  # y1 has its use
        ),
        (
            dict(method="zonotope"),
            ValueError,
            "method must be one of joint, box, not 'zonotope'",
        ),
        (
            dict(method="linearized"),
            ValueError,
            "method 'linearized' is gone: \"joint\" neglects nothing",
        ),
        (dict(method="paving"), ValueError, "'paving' is gone: \"joint\" decides the same windows exactly"),
        (dict(budget=3), ValueError, "budget belongs to residuals and uncertain parameters"),
        (dict(r=3), TypeError, r"detect needs relations, not int: detect\(parity_relations\(model\), u, y\)"),
        (dict(r="nowhere.toml"), FileNotFoundError, "there is no model file nowhere.toml"),
    ],
)
def test_what_does_not_fit_is_refused(change, error, message):
    given = dict(r=jb.parity_relations(paper()), u=np.zeros((10, 1)), y=np.zeros((10, 2))) | change
    with pytest.raises(error, match=message):
        jb.detect(given.pop("r"), given.pop("u"), given.pop("y"), **given)


def test_box_fault_implies_joint_fault_and_box_is_never_consistent_with_several_relations(rng):
    r, (u, y) = jb.parity_relations(paper(), horizon=2), recording((20_000,), rng)
    box, joint = (jb.detect(r, u, y, method=m) for m in ("box", "joint"))
    assert (joint.status[box.status == Status.FAULT] == Status.FAULT).all()
    assert (box.status == Status.FAULT).sum() > 1000 and (
        (joint.status == Status.FAULT) & (box.status != Status.FAULT)
    ).sum() > 100
    assert not (box.status == Status.CONSISTENT).any()


def test_box_with_a_single_relation_is_the_joint_test(rng):
    r = jb.parity_relations(paper(C=[[1, 0]], tolerance=0.02, noise=0.1))
    u, y = rng.uniform(-1, 1, (500, 1)), rng.normal(size=(500, 1)) / 3
    assert r.count == 1
    same(jb.detect(r, u, y, method="box"), jb.detect(r, u, y))


def test_progress_runs_to_one(rng):
    seen = []
    jb.detect(jb.parity_relations(paper(), horizon=3), *recording((40_000,), rng), progress=seen.append)
    assert len(seen) == 10 and seen == sorted(seen) and seen[-1] == 1


def test_an_infinite_sample_is_refused_even_where_only_short_circuits_use_it():
    """sets/strips.py pads a short circuit with 0 * scale of its first row: NaN if that is infinite, which
    passes for absent data.
    """
    m = jb.LinearSystem(
        [[0.5, 0, 0], [0, 0.8, 1], [0, 0, 0.2]], [[0], [0], [1]], [[1, 0, 0], [0, 1, 0]], noise=0.1
    )
    y = np.zeros((3, 2))
    y[0, 0] = np.inf
    with pytest.raises(ValueError, match="y must be finite"):
        jb.detect(jb.parity_relations(m, horizon=2), np.zeros((3, 1)), y)


def test_a_missing_value_of_a_nullable_column_is_a_missing_sample():
    frame = pd.DataFrame({"y1": pd.array([0.0, None, 0.0, 0.0], dtype="Float64"), "y2": [0.0] * 4})
    status = jb.detect(jb.parity_relations(paper()), np.zeros((4, 1)), frame).status
    assert status[3] == Status.CONSISTENT


def test_complex_samples_are_refused():
    with pytest.raises(ValueError, match="y must be numbers"):
        jb.detect(jb.parity_relations(paper()), np.zeros((4, 1)), np.zeros((4, 2)) + 1j)


def test_external_has_one_row_a_sample_for_a_recording_shorter_than_a_window():
    assert np.shape(jb.parity_relations(paper(), horizon=3).external(np.zeros((2, 1)), np.zeros((2, 2)))) == (
        2,
        6,
    )


def test_traced_margins_of_a_recording_shorter_than_a_window_are_nan():
    r = jb.parity_relations(paper(), horizon=3)
    assert np.isnan(jax.jit(lambda y: jb.margins(r, np.zeros((2, 1)), y))(np.zeros((2, 2)))).all()
