"""The door of constrained zonotopes."""

import jax
import numpy as np
import pytest

from jaxbound import sets
from jaxbound.sets.floats.kernel import kernel


def test_a_constrained_zonotope_is_a_tree_of_four_arrays():
    C = sets.constrained_zonotope(np.zeros((7, 2)), np.ones((7, 2, 5)), np.ones((7, 1, 5)), np.zeros((7, 1)))
    assert [leaf.shape for leaf in jax.tree.leaves(C)] == [(7, 2), (7, 2, 5), (7, 1, 5), (7, 1)]


def test_the_box_around_a_set_that_is_proved_empty_is_empty():
    """One coordinate proves it, and the other has no point either; a set that is not empty keeps its box."""
    A, b = [[[1.0, 1.0]]] * 3, [[3.0], [2.5], [1.0]]
    C = sets.constrained_zonotope(np.zeros((3, 2)), [[[1.0, 2.0], [0.0, 0.0]]] * 3, A, b)
    box = kernel(jax.vmap(sets.interval_hull))(C)
    np.testing.assert_array_equal(box.lo[:2], np.inf)
    np.testing.assert_array_equal(box.hi[:2], -np.inf)
    np.testing.assert_array_equal((abs(box).lo[:2], abs(box).hi[:2]), (box.lo[:2], box.hi[:2]))
    assert box.lo[2, 0] <= 1 and 2 <= box.hi[2, 0] and box.lo[2, 1] <= 0 <= box.hi[2, 1]


@pytest.mark.parametrize(
    ("dtype", "expected"), [(np.float32, np.float32), (np.float64, np.float64), (int, np.float64)]
)
def test_all_four_arrays_share_one_float_dtype(dtype, expected):
    C = sets.constrained_zonotope(
        np.zeros(1, dtype), np.ones((1, 2), dtype), np.ones((1, 2), dtype), np.zeros(1, dtype)
    )
    assert {leaf.dtype for leaf in jax.tree.leaves(C)} == {np.dtype(expected)}


@pytest.mark.parametrize(
    ("center", "generators", "A", "b", "message"),
    [
        ([0.0, 0.0], [[1.0]], [[1.0]], [0.0], r"shapes are \(2,\), \(1, 1\), \(1, 1\) and \(1,\)"),
        ([0.0], [[1.0, 2.0]], [[1.0]], [0.0], r"A \(\.\.\., k, q\)"),
        ([0.0], [[1.0]], [[1.0]], [0.0, 1.0], r"b \(\.\.\., k\)"),
        ([0.0], [[1.0]], [[np.nan]], [0.0], "A must be finite: 1 of 1"),
        ([0.0], [[1.0]], [[[1.0]]] * 2, [[0.0]] * 2, "as many constraints as centers"),
    ],
)
def test_the_factory_refuses_what_is_no_constrained_zonotope(center, generators, A, b, message):
    with pytest.raises(ValueError, match=message):
        sets.constrained_zonotope(center, generators, A, b)
