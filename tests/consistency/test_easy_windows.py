"""Easy windows: what a projection and a few clipped steps prove is so in exact arithmetic, by a hair too.

Errors of each window grow until its verdict turns: there, what rounding loses decides. A bound of rounding
that is left out is seen where readings, or inputs, are a thousand million times their bounds.
"""

import zlib
from fractions import Fraction
from functools import cache
from typing import NamedTuple

import jax
import numpy as np
import pytest
from boundary import GUST, SIX, moved
from oracles import MODELS, Plant, as_recording, draw, times

import jaxbound as jb
from jaxbound.consistency import projection
from jaxbound.consistency.interface import LinearRelations as Relations
from jaxbound.sets.strips import projection as steps

SHIFTED = MODELS["paper"] | dict(offset={"u": 3e5, "y": [1e7, -1e6]}, tolerance=0)
"""Where rounding of readings counts: they are a thousand million times their bounds."""
DRIVEN = MODELS["paper"] | dict(offset={"u": "100000000/3"}, tolerance=0)
"""Where rounding of inputs counts."""
CASES = {
    "paper": (MODELS["paper"], 8, np.float64),
    "shifted": (SHIFTED, 8, np.float64),
    "driven": (DRIVEN, 8, np.float64),
    "six": (SIX, 6, np.float64),
    "gust": (GUST, 8, np.float64),
    "single": (MODELS["paper"], 8, np.float32),
}
COUNT = 24
HALVINGS = 60


class Case(NamedTuple):
    """A plant, its relations, and windows: u (N, s + 1, m); y (N, s + 1, p) behind errors, centre without."""

    plant: Plant
    relations: Relations
    u: np.ndarray
    centre: np.ndarray
    y: np.ndarray


class Exact(NamedTuple):
    """A window in fractions: z of the outer rows; the radii of outer and of inner rows."""

    z: list[Fraction]
    outer: list[Fraction]
    inner: list[Fraction]


@cache
def drawn(name):
    """Return the Case of a name."""
    spec, s, dtype = CASES[name]
    plant, relations = Plant(**spec), jb.parity_relations(jb.LinearSystem(**spec), s)
    u, centre, y = draw(plant, s, COUNT, np.random.default_rng(zlib.crc32(name.encode())), level=1.0)
    return Case(plant, relations, u.astype(dtype), centre, y)


AT_NIGHT = "paper", "six"
"""Cases that another one is harder than: `shifted` is the plant of `paper`."""
BY_DAY = [pytest.param(name, marks=pytest.mark.long) if name in AT_NIGHT else name for name in CASES]


@pytest.fixture(params=BY_DAY)
def case(request):
    return drawn(request.param)


class Threshold(NamedTuple):
    """Samples (N, s + 1, p) before and behind where verdicts turn; turned (N,): of which windows they do."""

    before: np.ndarray
    behind: np.ndarray
    turned: np.ndarray


def at_threshold(case, proves):
    """Return the Threshold of a function that says of y which windows it decides."""

    def samples(factor):
        return moved(case.centre, case.y, factor).astype(case.u.dtype)

    low, high = np.zeros(COUNT), np.full(COUNT, 64.0)
    first = proves(samples(low))
    turned = proves(samples(high)) != first
    assert turned.mean() > 0.5
    for _ in range(HALVINGS):
        factor = (low + high) / 2
        same = proves(samples(factor)) == first
        low, high = np.where(same, factor, low), np.where(same, high, factor)
    return Threshold(samples(low), samples(high), turned)


def exact(case, y, number):
    """Return one window in fractions, from its samples, the plant's bounds and the exact R of the frame."""
    frame, s = case.relations.frame, case.relations.horizon
    ends, reach = case.plant.ends(s, case.u[number], y[number], case.u.dtype)
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


def against(case, window, h):
    """Return (|h z|, what bounds allow of it) of a combination of outer rows."""
    value = abs(sum(a * b for a, b in zip(h, window.z, strict=True)))
    across = list(zip(*case.relations.frame.R, strict=True))
    width = sum(abs(a) * r for a, r in zip(h, window.outer, strict=True))
    width += sum(abs(x[0]) * r for x, r in zip(times(across, [[x] for x in h]), window.inner, strict=True))
    return value, width


def easy(case):
    """Return the two tests of easy windows."""
    return case.relations.test("joint", case.u.dtype).easy


def by_window(x):
    """Return windows (N, s + 1, c) as kernels take them that gather: (s + 1, c, N)."""
    return np.moveaxis(x, 0, 2).copy()


def with_explanation(margin_of):
    """Return a compiled function that returns (margin, d) where `margin_of` returns a margin alone."""

    def explained(given, u, y):
        tried, errors = [], steps._errors

        def noted(R, z, d):
            tried.append(d)
            return errors(R, z, d)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(steps, "_errors", noted)
            margin = margin_of(given, u, y)
        return margin, tried[-1]

    return jax.jit(explained)


@with_explanation
def of_part(given, u, y):
    rows = projection.rows_of(given, *given.reading.windows(u, y))
    return steps.clipped_margin(given.projection, rows, stretch=True)[0]


@with_explanation
def of_windows(given, u, y):
    return steps.clipped_margin(given.projection, projection.rows_of(given, u, y))[0]


@pytest.mark.parametrize("kind", ["stretches", "windows"])
def test_clipped_steps_explain_what_they_call_consistent_in_exact_arithmetic(case, kind):
    given, s = getattr(easy(case), kind).constants, case.relations.horizon
    u = by_window(case.u[:, : case.plant.lags(s)])

    def found(y):
        if kind == "windows":
            return map(np.asarray, of_windows(given, u, by_window(y)))
        every = of_part(given, as_recording(case.u), as_recording(y))
        return (np.asarray(x)[..., :: s + 1] for x in every)

    y, _, turned = at_threshold(case, lambda y: next(found(y)) > 0)
    margins, d = found(y)
    for number in np.flatnonzero(turned):
        own = [Fraction(float(x)) for x in d[:, number]]
        assert 0 < Fraction(float(margins[number])) <= 1 - largest_use(case, exact(case, y, number), own)


def test_combinations_contradict_what_they_call_a_fault_in_exact_arithmetic(case):
    test, s = easy(case).windows, case.relations.horizon
    u = by_window(case.u[:, : case.plant.lags(s)])

    def found(y):
        return map(np.asarray, projection._of_windows(test.constants, u, by_window(y)))

    def contradicted(y):
        _, h = found(y)
        return test.refuted(u, by_window(y), h)

    _, behind, turned = at_threshold(case, lambda y: next(found(y)) < 0)
    assert contradicted(behind)[turned].all()
    for y in (behind, at_threshold(case, contradicted).behind):
        margins, h = found(y)
        for number in np.flatnonzero((margins < 0) | contradicted(y)):
            own = [Fraction(float(x)) for x in h[:, number]]
            value, width = against(case, exact(case, y, number), own)
            assert value > width
            if margins[number] < 0:
                assert Fraction(float(margins[number])) >= 1 - value / width
    far = moved(case.centre, case.y, np.full(COUNT, 64.0)).astype(case.u.dtype)
    margins, h = found(far)
    for number in (beyond := np.flatnonzero(margins < 0)[::6]):  # rounding counts for little there
        value, width = against(case, exact(case, far, number), [Fraction(float(x)) for x in h[:, number]])
        assert 1 - value / width <= Fraction(float(margins[number])) <= (1 - value / width) / 2
    assert len(beyond)
