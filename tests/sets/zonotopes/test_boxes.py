"""Intervals wherever sets are taken: enclosures hold the box, decisions are of the box itself or refused."""

import jax
import numpy as np
import pytest

from jaxbound import sets

BOX = sets.interval([-1.0, 0.0], [1.0, 3.0])
THIRD = sets.interval([0.1, 0.0], [0.3, 1.0])  # its middle is no float
Z = sets.zonotope([0.0, 1.0], [[1.0, 0.5], [0.0, 1.0]])


def test_enclosures_of_a_box_hold_its_corners():
    corners = np.array([[0.1, 0.0], [0.3, 1.0], [0.1, 1.0], [0.3, 0.0]])
    near = 0.2 * 1e-9 + corners * (1 - 1e-9)  # of a corner itself rounding may leave it open
    assert sets.contains(sets.minkowski_sum(THIRD, Z), near + np.asarray(Z.center)).yes.all()
    M = np.array([[1.0, 1.0], [1.0, -1.0]])
    for points, answer in ((near @ M, "yes"), (corners @ M, "no")):
        found = getattr(sets.contains(sets.linear_map(M, THIRD), points), answer)
        assert found.all() if answer == "yes" else not found.any()
    assert sets.contains(sets.convex_hull(THIRD, sets.from_interval(BOX)), near).yes.all()
    assert 1.3 <= float(sets.support(THIRD, [1.0, 1.0])) < 1.3 + 1e-12
    assert (sets.interval_hull(THIRD) == THIRD).all()


def test_intersections_take_a_box_on_either_side():
    for found in (sets.intersection(BOX, Z), sets.intersection(Z, BOX), sets.intersection(BOX, Z, np.eye(2))):
        assert sets.contains(found, [[0.0, 1.0], [5.0, 1.0]]).yes.tolist() == [True, False]
    assert sets.strip_intersection(BOX, sets.interval([0.0], [0.5]), [[1.0, 0.0]]).center.shape == (2,)


def test_decisions_are_of_the_box_itself():
    assert sets.contains(sets.zonotope([0.0, 1.5], np.diag([1.0, 1.5])), BOX).yes
    assert sets.contains(BOX, sets.zonotope([0.0, 1.0], np.eye(2) / 2)).yes
    assert sets.contains(BOX, sets.interval([0.0, 1.0], [1.0, 2.0])).all()
    assert sets.intersects(BOX, Z).yes and sets.is_empty(BOX).no
    assert sets.membership(BOX, [[0.0, 1.5], [2.0, 1.5]]).tolist() == [1.0, -1.0]
    assert sets.volume(BOX) == 6 and len(sets.strips(BOX)[0]) == 2


def test_a_box_that_is_no_zonotope_in_floats_is_refused():
    for ask in (lambda: sets.intersects(THIRD, Z), lambda: sets.membership(THIRD, [[0.2, 0.5]])):
        with pytest.raises(ValueError, match="no zonotope in floats: take from_interval"):
            ask()
    with pytest.raises(TypeError, match="from_interval makes one"):
        sets.zonotope(BOX, np.eye(2))
    with pytest.raises(TypeError, match="inside jit"):
        jax.jit(lambda box: sets.is_empty(box).yes)(BOX)
