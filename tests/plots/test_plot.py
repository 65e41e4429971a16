"""Pictures of tables and banks: drawn for what they say, and readable whatever the length of a recording."""

import numpy as np
import pytest
from systems import paper

import jaxbound as jb


def labels(axis):
    return [t.get_text() for t in axis.get_ticklabels()]


def test_a_table_of_signatures_is_drawn_row_by_row():
    table = jb.signatures(jb.structured_relations(paper(), [("y1",), ("u1",)]))
    (ax,) = jb.plot(table).axes
    assert labels(ax.xaxis) == ["y1", "y2", "u1"] and labels(ax.yaxis) == list(table.relations)
    level = np.asarray(ax.collections[0].get_array()).reshape(len(table.relations), 3)
    np.testing.assert_array_equal(level, table.weak.astype(int) + table.constant)


def test_isolability_is_drawn_with_what_shows_at_all():
    (ax,) = jb.plot(found := jb.isolability(paper())).axes
    level = np.asarray(ax.collections[0].get_array()).reshape(3, 4)
    np.testing.assert_array_equal(level[:, 0], found.detectable.astype(int) + found.detectable_constant)
    assert labels(ax.xaxis)[0] == "no other" and level[0, 1] == level[1, 2] == -1


@pytest.mark.parametrize("T", [40, 9000])
def test_a_bank_shows_every_violation_and_every_candidate(T):
    y = np.zeros((T, 2))
    y[30, 0] = 9.0
    res = jb.detect(jb.structured_relations(paper()), np.zeros((T, 1)), y)
    top, bottom = jb.plot(res).axes
    for ax, on in ((top, res.violated), (bottom, res.candidates)):
        drawn = np.asarray(ax.collections[0].get_array()).reshape(on.shape[1], -1)
        np.testing.assert_array_equal(drawn.any(1), on.any(0))
        assert drawn.shape[1] == min(T, 1200)
    assert labels(bottom.yaxis) == ["y1", "y2", "u1"]


def test_residuals_from_elsewhere_need_no_model():
    fig = jb.plot(jb.evaluate(np.eye(3) * 9, [1, 1, 1], np.eye(3)))
    assert [labels(ax.yaxis) for ax in fig.axes] == [["r1", "r2", "r3"], ["f1", "f2", "f3"]]
    with pytest.raises(ValueError, match="a plot shows one recording"):
        jb.plot(jb.detect(jb.redundancy(paper()), np.zeros((2, 9, 1)), np.zeros((2, 9, 2))))


def test_sets_in_the_plane_are_drawn_with_their_outlines():
    Z = jb.zonotope([1.0, 2.0], [[1.0, 0.5, 0.2], [0.0, 1.0, -0.4]])
    C = jb.sets.intersection(Z, jb.sets.interval([2.8], [3.1]), [[1.0, 1.0]])
    (ax,) = jb.plot([Z, C]).axes
    outer, inner = (line.get_xydata() for line in ax.lines)
    assert len(outer) == 7 and np.ptp(outer, 0).round(9).tolist() == [3.4, 2.8]
    assert abs(inner.sum(1).min() - 2.8) < 0.02 and abs(inner.sum(1).max() - 3.1) < 0.02
    with pytest.raises(ValueError, match="linear_map"):
        jb.plot(jb.zonotope([0.0], [[1.0]]))
