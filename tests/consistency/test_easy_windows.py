"""Easy windows: what a projection and a few clipped steps prove is so in exact arithmetic."""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest
from boundary import GUST, SIX, at_boundary, moved
from oracles import MODELS, Plant, as_recording, draw, times

import jaxbound as jb
from jaxbound.consistency import projection
from jaxbound.consistency.interface import LinearRelations as Relations
from jaxbound.sets.strips.projection import projected_margin

SHIFTED = MODELS["paper"] | dict(offset={"u": 3e5, "y": [1e7, -1e6]}, tolerance=0)
"""Where rounding counts: readings are a thousand million times their bounds."""
CASES = {
    "paper": (MODELS["paper"], 20),
    "shifted": (SHIFTED, 12),
    "six": (SIX, 6),
    "gust": (GUST, 8),
}
COUNT = 60


class Case(NamedTuple):
    """A plant, its relations, and the windows u (N, s + 1, m), y (N, s + 1, p) of one recording."""

    plant: Plant
    relations: Relations
    u: np.ndarray
    y: np.ndarray


class Exact(NamedTuple):
    """A window in fractions: z of the outer rows; the radii of outer and of inner rows."""

    z: list[Fraction]
    outer: list[Fraction]
    inner: list[Fraction]


@pytest.fixture(params=CASES)
def case(request, rng):
    spec, s = CASES[request.param]
    plant, relations = Plant(**spec), jb.parity_relations(jb.LinearSystem(**spec), s)
    u, centre, y = draw(plant, s, COUNT, rng)
    factor = at_boundary(relations, u, centre, y) * (
        1 + rng.choice([-1, 1], COUNT) * 10 ** rng.uniform(-2, -0.05, COUNT)
    )
    return Case(plant, relations, u, moved(centre, y, factor))


def exact(case, number):
    """Return one window in fractions, from its samples, the plant's bounds and the exact R of the frame."""
    frame, s = case.relations.frame, case.relations.horizon
    ends, reach = case.plant.ends(s, case.u[number], case.y[number])
    mid = [(a + b) / 2 - c for (a, b), c in zip(ends, reach, strict=True)]
    radius = [(b - a) / 2 for a, b in ends]
    through = times(frame.R, [[mid[i]] for i in frame.inner])
    z = [mid[i] - x[0] for i, x in zip(frame.outer, through, strict=True)]
    return Exact(z, [radius[i] for i in frame.outer], [radius[i] for i in frame.inner])


def largest_use(case, window, d):
    """Return max |e| / radius of a window of which d explains what it can."""
    through = times(case.relations.frame.R, [[x] for x in d])
    outer = [abs(z - x[0]) / r for z, x, r in zip(window.z, through, window.outer, strict=True)]
    return max(outer + [abs(x) / r for x, r in zip(d, window.inner, strict=True)])


def easy(case):
    """Return the two tests of easy windows."""
    return case.relations.test("joint", case.y.dtype).easy


def test_a_projection_explains_what_it_calls_consistent_in_exact_arithmetic(case):
    test, s = easy(case).stretches, case.relations.horizon
    given = test.projection
    columns = projection.columns_of(test.constants, as_recording(case.u), as_recording(case.y))
    margins = np.asarray(projected_margin(given, columns))[:: s + 1]
    P = [[Fraction(float(x)) for x in row[: len(given.outer)]] for row in given.step]
    found = np.flatnonzero(margins > 0)
    assert 0 < len(found) < COUNT
    for number in found:
        window = exact(case, number)
        d = [x[0] for x in times(P, [[x] for x in window.z])]
        assert Fraction(float(margins[number])) <= 1 - largest_use(case, window, d)


def test_combinations_contradict_what_they_call_a_fault_in_exact_arithmetic(case):
    test = easy(case).windows
    u, y = (np.moveaxis(x, 0, 2).copy() for x in (case.u[:, : test.lags], case.y))
    margins, h = map(np.asarray, projection._of_windows(test.constants, u, y))
    found = np.flatnonzero(margins < 0)
    assert 0 < len(found) < COUNT
    confirmed = test._contradicted((u, y), h, np.arange(COUNT))
    for number in np.flatnonzero((margins < 0) | confirmed):
        window, own = exact(case, number), [Fraction(float(x)) for x in h[:, number]]
        value = abs(sum(a * b for a, b in zip(own, window.z, strict=True)))
        back = [abs(x[0]) for x in times(list(zip(*case.relations.frame.R, strict=True)), [[x] for x in own])]
        width = sum(abs(a) * r for a, r in zip(own, window.outer, strict=True))
        width += sum(a * r for a, r in zip(back, window.inner, strict=True))
        assert value > width
        if margins[number] < 0:
            assert margins[number] >= float(1 - value / width) - 1e-9
    assert (confirmed[found]).all()
