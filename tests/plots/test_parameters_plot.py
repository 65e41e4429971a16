"""The picture of a set of parameters: every box is in it, for each pair of parameters."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.estimation import ParameterSet
from jaxbound.plots.canvas import to_png


def set_of(q, rng, count=40, status="found"):
    names = tuple("abcdefg"[:q])
    lo = rng.uniform(0, 0.5, (count, q))
    hi = lo + rng.uniform(0.01, 0.4, (count, q))
    bounds = dict.fromkeys(names, (-1.0, 2.0))
    relations = jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1))
    return ParameterSet(names, lo, hi, bounds, status, 9, 100, {}, relations)


@pytest.mark.parametrize("q, charts", [(2, 1), (3, 3), (4, 6), (6, 6)])
def test_each_pair_of_parameters_has_a_chart_with_every_box(rng, q, charts):
    found = set_of(q, rng)
    fig = jb.plot(found)
    axes = [ax for ax in fig.axes if ax.get_visible()]
    assert len(axes) == charts and to_png(fig)[:4] == b"\x89PNG"
    assert axes[0].get_xlabel() == "a   (of -1 to 2)" and axes[0].get_ylabel() == "b   (of -1 to 2)"
    drawn = {tuple(np.ravel(path.get_extents().extents)) for path in axes[0].collections[0].get_paths()}
    boxes = {tuple(np.append(lo[:2], hi[:2])) for lo, hi in zip(found.lo, found.hi, strict=True)}
    assert drawn == boxes
    (left, right), (lo, hi) = axes[0].get_xlim(), found.hull["a"]
    assert left < lo < hi < right and right - left < 1.5 * (hi - lo)


@pytest.mark.parametrize("q", [1, 2])
def test_an_empty_set_is_told_as_a_fault(rng, q):
    fig = jb.plot(set_of(q, rng, 0, "FAULT"))
    words = [text.get_text() for text in fig.axes[0].texts]
    assert words == ["no value is left"] and fig.axes[0].get_xlim()[0] < -1 < 2 < fig.axes[0].get_xlim()[1]
    to_png(fig)


def test_one_parameter_is_drawn_within_its_bounds(rng):
    found = set_of(1, rng)
    ax = jb.plot(found).axes[0]
    title = ax.get_title("left")
    assert title == "Parameters that may explain all 9 windows: 100 % of the volume"
    assert len(ax.patches) == len(found.lo)
    assert ax.get_xlim()[0] < -1 and ax.get_xlim()[1] > 2
