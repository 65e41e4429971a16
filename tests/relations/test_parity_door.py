"""What parity_relations accepts, refuses, chooses and prints; bounds that are changed afterwards."""

import jax
import numpy as np
import pytest
from oracles import MODELS
from systems import paper

import jaxbound as jb

ONE_OUTPUT = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0]], noise=0.1)


def test_horizon_chosen_for_section_5_is_one():
    assert jb.parity_relations(paper()).horizon == 1


@pytest.mark.parametrize(
    "C, expected",
    [
        ([[1, 0]], 2),  # one output needs as many earlier samples as there are states
        ([[1, 0], [1, 0]], 0),  # two equal sensors check each other at once
        ([[1, 0], [1, 0], [0, 1]], 1),  # the third needs the dynamics
        ([[0, 1]], 1),  # sees a single state of its own
        ([[1, 0], [0, 1]], 1),
    ],
)
def test_horizon_chosen_is_the_smallest_that_checks_every_output(C, expected):
    assert jb.parity_relations(jb.LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], C)).horizon == expected


def test_the_horizon_of_the_model_is_the_default():
    m = paper(horizon=3, tolerance=0)
    assert (m.horizon, jb.parity_relations(m).horizon, jb.parity_relations(m, 2).horizon) == (3, 3, 2)
    assert repr(m).endswith("horizon 3)") and "horizon" not in repr(paper())
    assert jb.detectable(m, "y1").horizon == 3 and jb.detectable(m, "y1", 2).horizon == 2


def test_horizon_too_small_names_the_smallest():
    with pytest.raises(
        ValueError,
        match=r"horizon 1 gives no relation: 2 samples .* 2 states; the smallest horizon with one is 2",
    ):
        jb.parity_relations(jb.LinearSystem(**ONE_OUTPUT), horizon=1)


def test_the_smallest_horizon_named_has_a_relation():
    assert jb.parity_relations(jb.LinearSystem(**ONE_OUTPUT), horizon=2).count == 1


def test_where_circuits_are_too_many_a_frame_takes_their_place():
    few, many = jb.parity_relations(paper(), horizon=6), jb.parity_relations(paper(), horizon=30)
    assert len(few.circuits) == len(few.circuits_known) == 14 * 13 * 12 // 6 and few.frame is None
    assert many.circuits == many.circuits_known == () and many.count == len(many.frame.outer) == 60


@pytest.mark.parametrize("horizon", [-1, 1.5, True, "2", np.float64(1)])
def test_a_horizon_that_is_no_whole_number_is_refused(horizon):
    with pytest.raises(ValueError, match="horizon must be a whole number >= 0"):
        jb.parity_relations(paper(), horizon=horizon)


def test_a_numpy_integer_is_a_horizon():
    assert jb.parity_relations(paper(), horizon=np.int32(2)).horizon == 2


def test_an_unknown_form_is_refused():
    with pytest.raises(ValueError, match="form must be 'first' or 'second', not 'third'"):
        jb.parity_relations(paper(), form="third")


def test_something_that_is_no_model_is_refused():
    with pytest.raises(TypeError, match="a LinearSystem.* not dict"):
        jb.parity_relations(ONE_OUTPUT)


def test_text_is_what_the_paper_prints():
    assert jb.parity_relations(paper()).text() == (
        "r1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0\nr2: 4 y2[k-1] - 10 y1[k] + 5 y2[k] - 5 u1[k-1] = 0"
    )


def test_text_of_circuits_has_one_line_each():
    lines = jb.parity_relations(paper()).text(circuits=True).split("\n")
    assert len(lines) == 4 and lines[0] == "c1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0"
    assert any(line.endswith("4 y1[k-1] - 30 y1[k] + 25 y2[k] - 25 u1[k-1] = 0") for line in lines)


def test_text_uses_the_names_of_the_model():
    m = paper(inputs=("valve",), outputs=("flow", "level"))
    assert (
        jb.parity_relations(m).text().split("\n")[1]
        == "r2: 4 level[k-1] - 10 flow[k] + 5 level[k] - 5 valve[k-1] = 0"
    )


def test_text_shows_the_newest_input_with_feedthrough():
    m = jb.LinearSystem(
        [["1/2"]], [[1]], [[1]], [[2]], noise=0.1
    )  # y+ = x/2 + u + 2 u+ = (y - 2 u) / 2 + u + 2 u+
    assert jb.parity_relations(m).text() == "r1: y1[k-1] - 2 y1[k] + 4 u1[k] = 0"


def test_text_without_inputs_speaks_of_outputs_only():
    assert (
        jb.parity_relations(jb.LinearSystem([["1/2"]], None, [[1]], noise=0.1)).text()
        == "r1: y1[k-1] - 2 y1[k] = 0"
    )


def test_external_without_inputs_needs_no_u():
    r = jb.parity_relations(jb.LinearSystem([["1/2"]], None, [[1]], noise=0.1))
    np.testing.assert_allclose(np.asarray(r.external(None, [[4.0], [1.0], [3.0]]))[1:, 0], [2, -5])


@pytest.mark.compiled
def test_external_keeps_leading_axes(rng):
    r, u, y = (
        jb.parity_relations(paper(), horizon=2),
        rng.normal(size=(2, 3, 9, 1)),
        rng.normal(size=(2, 3, 9, 2)),
    )
    whole = np.asarray(r.external(u, y))
    assert whole.shape == (2, 3, 9, 4)
    np.testing.assert_array_equal(whole[1, 2], r.external(u[1, 2], y[1, 2]))


@pytest.mark.parametrize(
    "bounds, message",
    [
        ({"gain": 1.0}, r"bounds are \['noise', 'tolerance'\], not \['gain'\]"),
        ({"noise": [1.0, 2.0, 3.0]}, r"noise needs one number or one per output \(2\): its shape is \(3,\)"),
        ({"noise": [0.1, -0.1]}, r"noise must be in \[0, inf\): output 'y2' has -0.1"),
        ({"noise": float("nan")}, "output 'y1' has nan"),
        ({"noise": float("inf")}, "output 'y1' has inf"),
        ({"tolerance": [0.1, 1.0]}, r"tolerance must be in \[0, 1\): output 'y2' has 1"),
    ],
)
def test_with_bounds_refuses_and_says_why(bounds, message):
    with pytest.raises(ValueError, match=message):
        jb.parity_relations(paper()).with_bounds(bounds)


def test_with_bounds_gives_the_verdicts_of_a_model_with_these_bounds(rng):
    u, y = rng.uniform(-1, 1, (400, 1)), rng.normal(size=(400, 2))
    changed = jb.parity_relations(paper()).with_bounds({"noise": [0.5, 0.2], "tolerance": 0.05})
    direct = jb.parity_relations(paper(noise=[0.5, 0.2], tolerance=0.05))
    a, b = jb.detect(changed, u, y), jb.detect(direct, u, y)
    np.testing.assert_array_equal(a.status, b.status)
    np.testing.assert_array_equal(a.margin, b.margin)
    assert (a.status != jb.detect(jb.parity_relations(paper()), u, y).status).any()


def test_with_bounds_leaves_the_relation_it_came_from_alone():
    r = jb.parity_relations(paper())
    r.with_bounds({"noise": 9.0})
    np.testing.assert_array_equal(r.bounds["noise"], [0.1, 0.01])


def test_bounds_do_not_follow_an_array_that_is_written_later():
    noise = np.array([0.5, 0.2])
    r = jb.parity_relations(paper()).with_bounds({"noise": noise})
    noise[:] = 0
    assert r.bounds["noise"].tolist() == [0.5, 0.2]


@pytest.mark.parametrize("change", [{}, {"noise": np.array([0.5, 0.2])}, {"disturbance": 0.2}])
def test_the_bounds_of_relations_are_not_written(change):
    r = jb.parity_relations(paper(disturbance=([[1], [0]], 0.1))).with_bounds(change)
    for bound in r.bounds.values():
        with pytest.raises(ValueError, match="read-only"):
            bound[0] = 0


def test_with_bounds_keeps_the_bound_that_is_not_named():
    r = jb.parity_relations(paper()).with_bounds({"noise": 9.0})
    np.testing.assert_array_equal(r.bounds["tolerance"], [0.02, 0.1])
    np.testing.assert_array_equal(r.bounds["noise"], [9, 9])


@pytest.mark.parametrize("name", MODELS)
def test_relations_are_a_pytree_of_their_bounds(name):
    r = jb.parity_relations(jb.LinearSystem(**MODELS[name]))
    leaves, tree = jax.tree.flatten(r)
    assert len(leaves) == 2
    assert jax.tree.unflatten(tree, leaves).W == r.W
